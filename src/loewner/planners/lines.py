"""Define `straight`: motions of the joints along which a link provably follows a straight line."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _elementary, _validate
from loewner._base._guard import guarded
from loewner._base._validate import Bools, Floats
from loewner._kernels import codes, columns
from loewner._native import entries
from loewner.errors import InputError, PlanningError
from loewner.planners.joint_limits import beyond, with_start
from loewner.planners.judge import TOLERANCE, Judge, checked_checker
from loewner.planners.kept_axes import KeptAxis, parts_of
from loewner.planners.kept_lines import POSITION, ROTATION, Line, chord_of
from loewner.queries.pairs import Verdict
from loewner.robots import CollisionChecker, Robot
from loewner.robots.description.reaching import Chain, refuse_far, refuse_unsteady, targets_of
from loewner.robots.description.robot import chain_to
from loewner.robots.proofs.contacts import deeper_than_ends
from loewner.robots.proofs.proofs import ProofOptions, prove_by_rules

# Messages report a singularity if a singular value of the Jacobian is below SINGULAR [m, rad].
SINGULAR = 0.02


@guarded
def straight(
    checker: CollisionChecker,
    start: ArrayLike,
    link: str,
    T: ArrayLike,
    *,
    position: float = POSITION,
    rotation: float = ROTATION,
    joints: str | Iterable[str] | None = None,
    keep: tuple[str | ArrayLike, ArrayLike, float] | None = None,
) -> Floats:
    """Move a link straight to a pose. The motion is proven straight and free of collisions at every instant.

    The line leads from the pose of the link at `start` to the pose `T`. The origin of the link moves along a straight
    line, and the link turns at a constant rate about a fixed axis, in the shorter direction.

    Parameters
    ----------
    checker : CollisionChecker
    start : array_like, shape (dof,)
    link : str
    T : array_like, shape (4, 4)
        Pose T_world_link at the end, with its translation in metres.
    position, rotation : float
        Largest allowed deviations of the link from the pose at the same fraction of the line, in metres and radians, at
        least 1e-9 each.
    joints : str or iterable of str, optional
        A group, or names of joints. Only these joints move. Default: all joints that move the link.
    keep : (axis, direction, angle), optional
        In addition, an axis of the link ("x", "y", "z" or a vector) must stay within an angle [rad] of a direction in
        the world, for example to avoid spilling a cup. The limit on the angle holds at every instant, including all
        deviations from the line.

    Returns
    -------
    ndarray, shape (k, dof)
        Configurations, beginning with `start`. Each joint value changes linearly from one configuration to the next.

    Raises
    ------
    PlanningError
        If the link cannot follow the line because of a limit or a singularity, if a motion is not proven free, or if
        the axis leaves its angle. The message names joints or bodies, and states at which fraction of the line the
        fault occurs.
    InputError
        If an argument has the wrong shape or value, if the line turns the link by half a turn, or if a floating or ball
        joint would have to move.
    UnknownNameError
        If the robot has no such link, joint or group.

    See Also
    --------
    Robot.reach : Finds a start. plan : Finds a path to a configuration that reaches a pose.

    Notes
    -----
    Each motion is divided until a bound on its deviation is within the tolerances; docs/certified.md derives this
    bound. The motions are proven by `CollisionChecker.certify_edges`, so `Scene.leave` and `Scene.reach` apply.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> pose = robot.forward_kinematics([0.5, 1.0])[1]
    >>> straight(CollisionChecker(robot), [0.0, 1.0], "cart", pose).round(9)
    array([[0. , 1. ],
           [0.5, 1. ]])
    """
    robot = checked_checker(checker).robot
    q = robot.checked_one(start, "start")
    kept = None if keep is None else KeptAxis.of(*parts_of(keep, "(axis, direction, angle)"))
    target = _validate.pose(T, "T")
    chain = chain_to(robot, link, joints)
    line, judge = Line(link, position=position, rotation=rotation), Judge.of(checker, 0.0)
    u, Q, fault = followed(robot, chain, q, line, target, kept)
    if fault is not None:
        raise PlanningError(f"line: expected {link} {fault[0]}, found {fault[1]}")
    if block := block_of(judge, u, Q):
        raise PlanningError(f"line: expected a free line of {link}, found that {block}")
    return Q


def followed(
    robot: Robot, chain: Chain, q: Floats, line: Line, target: Floats, kept: KeptAxis | None = None
) -> tuple[Floats, Floats, tuple[str, str] | None]:
    """Follow a line from its link's current pose to a target, ignoring collisions, and `first` and `last` of the line.

    Returns
    -------
    u : ndarray, shape (k,)
        Fractions of the line.
    Q : ndarray, shape (k, dof)
        Configurations at these fractions.
    fault : (str, str) or None
        If the link cannot follow the line: the expectation and the fault, for an error message.
    """
    target = targets_of(target[None])[0]
    refuse_far(chain, target, q)
    chain = _from_start(robot, chain, q, line.link)
    wanted = np.array([line.position, chord_of(line.rotation), -np.inf, *np.zeros(6)])
    if kept is not None:
        wanted[2:] = _elementary.cos(kept.angle), *kept.axis, *kept.direction
    outcome, rows = entries.follow_line(*chain[:3], q[chain.columns], target, wanted)
    fault = None if outcome == codes.FOLLOWED else _fault(robot, chain, outcome, rows, q, line.link, kept)
    Q = np.repeat(q[None], len(rows), axis=0)
    Q[:, chain.columns] = rows[:, 2:]
    return rows[:, 0], Q, fault


def _from_start(robot: Robot, chain: Chain, q: Floats, link: str) -> Chain:
    """Refuse joints whose values do not change linearly, and a start outside the limits (see `with_start`)."""
    refuse_unsteady(chain, link)
    ranges, values = chain.ranges.copy(), q[chain.columns]
    ends = [columns.LEAST, columns.MOST]
    ranges[ends] = with_start(robot, chain.columns, q, *ranges[ends])
    outside = beyond(values, *ranges[ends])
    if outside.any():
        raise PlanningError(
            f"start: expected a configuration within the limits, found {_named(robot, chain, outside, q)} outside"
        )
    return chain._replace(ranges=ranges)


def _fault(
    robot: Robot, chain: Chain, outcome: int, rows: Floats, q: Floats, link: str, kept: KeptAxis | None
) -> tuple[str, str]:
    """Explain why the kernel cannot follow a line: return the expectation and the fault."""
    if outcome == codes.HALF_TURN:
        raise InputError("T: expected a turn of less than half a turn, found half a turn; add a pose in between")
    if outcome == codes.TOO_FAR:
        raise InputError("T: expected a line of at most 10 km; add a pose in between")
    if kept is not None and outcome == codes.TILTED:
        u, cosine = rows[-2:][rows[-2:, 1].argmin(), :2]
        return (
            f"to keep within {kept.angle:g} rad of the direction on the whole line",
            f"{np.arccos(np.clip(cosine, -1, 1)):.6g} rad at the fraction {u:.4g}",
        )
    last = q.copy()
    last[chain.columns] = rows[-2, 2:]
    return _stopped(robot, chain, rows[-2, 0], last, link)


def _named(robot: Robot, chain: Chain, which: Bools, q: Floats) -> str:
    """List values of a chain, for messages."""
    places = chain.columns[np.flatnonzero(which)].tolist()
    return ", ".join(f"{robot.configuration_names[k]} = {q[k]:.6g}" for k in places)


def _stopped(robot: Robot, chain: Chain, u: float, q: Floats, link: str) -> tuple[str, str]:
    """Explain why a line cannot be followed beyond a fraction."""
    values, (least, most) = q[chain.columns], chain.ranges[[columns.LEAST, columns.MOST]]
    room = np.minimum(1e-2, 0.01 * (most - least))
    limited = (values - least < room) | (most - values < room)
    J = robot.jacobian(q, link)[:, chain.columns[chain.moving]]
    smallest = float(np.linalg.svd(J, compute_uv=False)[min(J.shape) - 1]) if min(J.shape) == 6 else 0.0
    reasons = [f"at or near limits: {_named(robot, chain, limited, q)}"] if limited.any() else []
    if smallest < SINGULAR:
        reasons.append(
            "fewer than six joints move it" if min(J.shape) < 6 else f"singular, or the end of its reach (smallest "
            f"singular value of the Jacobian {smallest:.2g})"
        )  # fmt: skip
    why = "; ".join(reasons) or "the joints would have to jump"
    return "to follow the line to its end", f"that it cannot go on beyond the fraction {u:.4g}: {why}"


def block_of(judge: Judge, u: Floats, Q: Floats) -> str:
    """Explain which motion of a line is not free under the scene's contact rules. Return "" if all motions are free."""
    left = np.flatnonzero(~judge.free(Q[:-1], Q[1:]))
    if len(left) == 0:
        return ""
    if judge.kept is not None and not judge.kept.on(Q[:-1], Q[1:]).all():
        return "the axis does not keep its direction"
    answers = prove_by_rules(judge.ready, Q[left], Q[left + 1], ProofOptions(TOLERANCE, judge.joint_error))
    if (answers.verdicts == Verdict.FREE).all():
        if (deeper := deeper_than_ends(judge.ready, Q, left, TOLERANCE)) is not None:
            row, a, b = deeper
            return f"{a} and {b} get into deeper contact than at the ends, at the fraction {u[row]:.4g}"
        return ""
    answers.expect_short(Q[left], Q[left + 1])
    worst, told = int((answers.verdicts != Verdict.FREE).argmax()), answers.of_shape((len(left),), judge.ready)
    k, (a, b) = left[worst], told.names[worst]
    how = "collide" if told.verdict[worst] == Verdict.COLLIDING else f"come within {TOLERANCE:g} m of their margin"
    fraction = u[k] + told.fraction[worst] * (u[k + 1] - u[k])
    return f"{a} and {b} {how} at the fraction {fraction:.4g}"
