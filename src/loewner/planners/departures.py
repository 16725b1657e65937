"""Plan the motions out of contact at the start of a path, and into contact at its end, along the contact normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loewner._base._validate import Floats
from loewner._kernels import codes
from loewner.errors import PlanningError
from loewner.planners.judge import TOLERANCE, Judge
from loewner.planners.space import Space
from loewner.robots.checking.problem import Problem
from loewner.robots.checking.verdicts import contacts
from loewner.robots.proofs.proofs import ProofOptions, prove_by_rules
from loewner.scenes.scene import Contact

# Distances beyond the margin by which bodies are moved apart [m]. The first distance with a proven motion is used. The
# distances decrease because joints move bodies along curves, and shorter motions are straighter.
RISES = (0.02, 0.01, 0.005, 0.002)


@dataclass(frozen=True, eq=False)
class Departures:
    """The start and goals of a path, and a free configuration near each of them that is in contact.

    Attributes
    ----------
    space : Space
    start, goals : ndarray, shapes (dof,) and (goals, dof)
        As given by the user.
    free_start, free_goals : ndarray, of the same shapes
        Free configurations near `start` and `goals`. They equal `start` and `goals` if no contact has to end or begin.
    """

    space: Space
    start: Floats
    goals: Floats
    free_start: Floats
    free_goals: Floats

    @classmethod
    def of(cls, space: Space, judge: Judge, start: Floats, goals: Floats) -> Departures:
        """Find the free configurations in one consistent state of the scene. With a joint error, no contact is allowed.

        Raises
        ------
        PlanningError
            If the rules allow a contact at the start or at the only goal, but no motion out of or into the contact was
            found.
        """
        free_start, free_goals, ready, is_exact = start, goals, judge.ready, judge.joint_error is None
        if is_exact and ready.leaving.any():
            free_start, fault = _apart(space, ready, start, at_start=True)
            if fault:
                raise PlanningError(f"start: {fault}")
        if is_exact and ready.reaching.any():
            attempts = [_apart(space, ready, goal, at_start=False) for goal in goals]
            if all(fault for _, fault in attempts):
                raise PlanningError(f"goal: {attempts[0][1]}")
            free_goals = np.array([q for q, _ in attempts])
        return cls(space, start, goals, free_start, free_goals)

    def joined(self, path: Floats) -> Floats:
        """Extend a path between the free configurations by the motions out of contact and into contact."""
        ends = self.space.unwound(path[-1], self.free_goals)
        k = int(np.abs(ends - path[-1]).max(axis=1).argmin())
        rows = [path]
        if self.free_start is not self.start and (self.free_start != self.start).any():
            rows.insert(0, self.start[None])
        if (self.free_goals[k] != self.goals[k]).any():
            rows.append(self.space.unwound(path[-1], self.goals[k])[None])
        return np.concatenate(rows)


def _apart(space: Space, ready: Problem, q: Floats, *, at_start: bool) -> tuple[Floats, str]:
    """Return a free configuration that a proven motion connects with the contact q, or q and the fault."""
    checker = space.checker
    if space.free(q):  # the usual case; listing the contacts would take longer
        return q, ""
    allowed = ready.pairs[ready.leaving if at_start else ready.reaching]
    ruled = {frozenset(ready.names[k] for k in pair) for pair in allowed}
    touching, doubt = contacts(ready, q)
    # All other faults are reported by the check of all starts and goals.
    if doubt or not touching or any(frozenset((contact.name_a, contact.name_b)) not in ruled for contact in touching):
        return q, ""
    way = _way(space, ready, q, touching)
    for rise in RISES:
        far = max(
            rise + checker.scene.margin_of(contact.name_a, contact.name_b) - contact.distance for contact in touching
        )
        near = q + far * way
        if space.outside(near) or not space.free(near):
            continue
        first, last = (q, near) if at_start else (near, q)
        if prove_by_rules(ready, first[None], last[None], ProofOptions(TOLERANCE)).verdicts[0] == codes.FREE:
            return near, ""
    a, b = touching[0].name_a, touching[0].name_b
    return q, (
        f"expected a contact of {a} and {b} that a straight motion of up to {1e3 * RISES[0]:g} mm along the normal "
        f"{'ends' if at_start else 'begins'}, found none that is proven free; move there by motions of your own, "
        "proven by certify_edges, and plan between them"
    )


def _way(space: Space, ready: Problem, q: Floats, touching: tuple[Contact, ...]) -> Floats:
    """Compute how configurations change per metre if touching bodies separate along the normals, without turning.

    The change is the least-squares solution, since the joints may not allow exactly this motion.
    """
    robot = space.checker.robot
    poses = robot.forward_kinematics(q)
    rows, wanted = [], []
    for contact in touching:
        J = np.zeros((6, robot.dof))
        for name, x, sign in ((contact.name_a, contact.witness_a, 1.0), (contact.name_b, contact.witness_b, -1.0)):
            body = ready.names.index(name)
            if body < len(ready.link):
                link = int(ready.link[body])
                R, t = poses[link, :3, :3], poses[link, :3, 3]
                J += sign * robot.jacobian(q, robot.link_names[link], R.T @ (x - t))
        rows.append(J[:, space.columns])
        wanted.append(np.concatenate([-contact.normal, np.zeros(3)]))
    way: Floats = np.zeros(robot.dof)
    way[space.columns] = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=1e-6)[0]
    return way
