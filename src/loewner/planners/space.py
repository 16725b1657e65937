"""Define the space that planners search (the moving joints and their limits), and check starts and goals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._validate import Bools, Floats, Ints, some
from loewner.errors import InputError, PlanningError
from loewner.planners.joint_limits import beyond, with_start
from loewner.planners.judge import TOLERANCE, Judge, checked_checker
from loewner.planners.pose_goals import Approaches, PoseGoal
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checker import prepared_of
from loewner.robots.checking import distances, verdicts
from loewner.robots.description.robot import named_joints, unlimited
from loewner.robots.proofs import tracking
from loewner.robots.proofs.proofs import ProofOptions, prove_by_rules
from loewner.scenes.scene import Contact

# A deviation below A_HAIR, in the units of the joints, is probably a rounding error.
A_HAIR = 1e-4

# Largest number of configurations and pairs that a message names.
NAMED = 5

# Largest joint error that is tried for an error message [rad or m]. If no obstacle is near, larger errors would only
# overflow.
MOST_ERROR = 1e9


@dataclass(frozen=True, eq=False)
class Space:
    """The moving joints with their ranges, and the values of the joints that do not move.

    Attributes
    ----------
    checker : CollisionChecker
    columns : ndarray of int64, shape (joints,)
        Columns of the moving joints in configurations.
    still : ndarray, shape (dof,)
        A configuration with the values of the joints that do not move.
    lower, upper : ndarray, shape (joints,)
        Range to search: the limits. For joints without limits, the range extends half a turn beyond the start and the
        goals.
    turning : ndarray of bool, shape (joints,)
        Whether a joint has no limits and returns to the same place after a whole turn.
    """

    checker: CollisionChecker
    columns: Ints
    still: Floats
    lower: Floats
    upper: Floats
    turning: Bools

    @classmethod
    def of(cls, checker: CollisionChecker, joints: str | Iterable[str] | None, q: Floats, goals: Floats) -> Space:
        """Make the space of the given joints. A joint without limits may go half a turn beyond start and goals."""
        robot = checker.robot
        moving = _columns(robot, joints)
        lower, upper = robot.lower, robot.upper
        below, above, turning = unlimited(robot)
        if below.any() or above.any():
            least, most = np.minimum(goals.min(axis=0), q), np.maximum(goals.max(axis=0), q)
            lower = np.where(below, np.maximum(least - np.pi, lower), lower)
            upper = np.where(above, np.minimum(most + np.pi, upper), upper)
        moving = moving[lower[moving] < upper[moving]]
        if len(moving) == 0:
            raise InputError("joints: expected one or more that can move, found none")
        return cls(checker, moving, q, lower[moving], upper[moving], turning[moving])

    @classmethod
    def of_start(cls, checker: CollisionChecker, joints: str | Iterable[str] | None, q: Floats, goals: Floats) -> Space:
        """Make the space of a plan, whose start may be between the soft and the hard limits; see `with_start`."""
        space = cls.of(checker, joints, q, goals)
        lower, upper = with_start(checker.robot, space.columns, q, space.lower, space.upper)
        return replace(space, lower=lower, upper=upper)

    def configurations(self, values: ArrayLike) -> Floats:
        """Make whole configurations, shape (..., dof), from values of the moving joints, shape (..., columns)."""
        values = np.asarray(values)
        Q = np.empty((*values.shape[:-1], len(self.still)))
        Q[:] = self.still
        Q[..., self.columns] = values
        return Q

    def unwound(self, Q0: Floats, Q1: Floats) -> Floats:
        """Bring the unlimited turning joints of Q1 as near to the values of Q0 as possible, by whole turns."""
        if not self.turning.any():
            return Q1
        at = self.columns[self.turning]
        turns = np.zeros(np.broadcast_shapes(Q0.shape, Q1.shape))
        turns[..., at] = np.rint((Q1[..., at] - Q0[..., at]) / (2 * np.pi))
        return np.where(turns == 0, Q1, Q1 - 2 * np.pi * turns)

    def checked_goals(self, q: Floats, goals: Floats, judge: Judge, names: list[str]) -> Floats:
        """Check the start, and return the goals that a quick check does not exclude. Messages contain the goals' names.

        Limits are checked first, because for values in degrees, any other message would be misleading.

        Raises
        ------
        PlanningError
            If the start or all goals are outside the limits, or collide within the judge's joint error.
        InputError
            If a goal moves a joint that does not move in this space.
        """
        Q = np.concatenate([q[None], goals])
        within = self.inside(Q)
        faults, inside = [""] * len(goals), within[1:]
        if not within.all():
            _refuse_start(self.outside(q))
            faults = [self.outside(goal) for goal in goals]
        if not inside.any():
            raise _no_goal(faults, names)
        self.check_still(goals[inside], "goal", "the start's value", "the joints that move")
        free = self.free_among(Q[within])
        if judge.joint_error is not None:
            free &= judge.free(Q[within], Q[within])
        if not free[0]:
            _refuse_start(self._fault(q, judge) + self._cure(q))
        good: Floats = goals[inside][free[1:]]
        if len(good):
            return good
        # Only the goals that the message names are examined closely, because the number of goals may be in the
        # thousands.
        named = [fault or self._fault(goal, judge) for fault, goal in zip(faults[:NAMED], goals[:NAMED], strict=True)]
        raise _no_goal(named + faults[NAMED:], names)

    def inside(self, Q: Floats) -> Bools:
        """Return which configurations have all moving joints within their limits, up to rounding."""
        return np.asarray(~beyond(Q[:, self.columns], self.lower, self.upper).any(axis=1))

    def outside(self, q: Floats) -> str:
        """Describe the moving joints that are outside their limits; return "" if there are none."""
        values = q[self.columns]
        outside = np.flatnonzero(beyond(values, self.lower, self.upper))
        texts = (
            f"{self.name(self.columns[k])} = {values[k]:g} outside {self.lower[k]:g} .. {self.upper[k]:g}"
            + _by_a_hair(max(self.lower[k] - values[k], values[k] - self.upper[k]))
            for k in outside
        )
        return some(texts, NAMED)

    def free(self, q: Floats) -> bool:
        """Return whether a configuration is proven free. An unsettled configuration counts as not free."""
        return verdicts.is_free(prepared_of(self.checker), q)

    def free_among(self, Q: Floats) -> Bools:
        """Return which configurations of a batch are proven free. Unsettled configurations count as not free."""
        return verdicts.free(prepared_of(self.checker), np.array(Q, order="C"))  # kernels do not accept views

    def name(self, column: int) -> str:
        """Return the name of a column of configurations."""
        return self.checker.robot.configuration_names[column]

    def check_still(self, Q: Floats, what: str, kept: str, joints: str) -> None:
        """Refuse configurations that differ from `still` in joints that do not move.

        The strings are parts of messages. `what` may have a placeholder for the number of a configuration.
        """
        differs = self.still != Q
        differs[:, self.columns] = False
        if differs.any():
            column = int(differs.any(axis=0).argmax())
            k = int(differs[:, column].argmax())
            value = Q[k, column]
            raise InputError(
                f"{what.format(k)}: expected {kept}, {self.still[column]:g}, of {self.name(column)}, which is not "
                f"among {joints}; found {value:g}{_by_a_hair(abs(value - self.still[column]))}"
            )

    def _fault(self, q: Floats, judge: Judge) -> str:
        """Explain why a configuration that is within the limits but not free cannot be on a path."""
        contacts, doubt = verdicts.contacts(prepared_of(self.checker), q)
        if doubt:
            return f"one that cannot be proven free: {doubt}"
        if not contacts and judge.joint_error is not None:
            return self._too_near(q, judge, judge.joint_error)
        if not contacts:
            return "a collision that a second check does not confirm: the scene has changed"
        rules = judge.joint_error is not None and len(judge.ready.ruled)
        return f"a collision of {touching(contacts)}" + (
            "; with a joint error, contact at the ends is not allowed" if rules else ""
        )

    def _cure(self, q: Floats) -> str:
        """For a message, explain how to allow a contact of a link and a body, and name their margin; or return ""."""
        scene, links = self.checker.scene, self.checker.robot.link_names
        for contact in verdicts.contacts(prepared_of(self.checker), q)[0]:
            a, b = contact.name_a, contact.name_b
            if (a in links) != (b in links) and not {a, b} & {*scene.attachments}:
                margin = scene.margin_of(a, b)
                allowing = f"scene.allow({a!r}, {b!r}), or allow in a scene file"
                return f"; {f'margin {1e3 * margin:g} mm; ' * (margin > 0)}if they may touch: {allowing}"
        return ""

    def _too_near(self, q: Floats, judge: Judge, error: Floats) -> str:
        """Explain why a free configuration is not proven free within the joint error.

        The largest error and the pair depend on the proportions of the given errors, but not on their size.
        """
        ready, at, size = judge.ready, q[None], error.max()
        weights = error / size
        largest = tracking.largest(ready, at, at, weights, MOST_ERROR, TOLERANCE)
        if largest >= MOST_ERROR:
            return f"one that is proven free within joint errors of {largest:g}, but not of {size:g}"
        unproven = max(tracking.NEAR * largest, tracking.FIRST)
        pair = prove_by_rules(ready, at, at, ProofOptions(TOLERANCE, unproven * weights)).pairs
        nearest = distances.nearest(ready.only(pair), q, True, False)
        a, b = nearest.names
        stated = 0.995 * largest  # does not exceed the largest error after rounding to three digits
        allowed = f"{stated:.3g}" if (error == error[0]).all() else f"{stated / size:.3g} times the given ones"
        return (
            f"one that is proven free only within joint errors of {allowed}: {a} and {b} are "
            f"{1e3 * nearest.distance:.3g} mm apart"
        )


def touching(contacts: Sequence[Contact]) -> str:
    """Describe contacts for a message."""
    return some((f"{each.name_a} and {each.name_b} ({_depth(each.distance)})" for each in contacts), NAMED)


def _depth(distance: float) -> str:
    """Describe the signed distance of two bodies that are in contact, or closer than their margin."""
    size = f"{1e3 * abs(distance):.3g} mm"
    return f"{size} deep" if distance <= 0 else f"within their margin, {size} apart"


@dataclass(frozen=True, eq=False)
class Task:
    """The checked start and goal of a plan, as a user gave them.

    Attributes
    ----------
    checker : CollisionChecker
    start : ndarray, shape (dof,)
    goal : ndarray, shape (goals, dof), or PoseGoal
    joints : str or list of str, optional
        The joints that move. For a `PoseGoal`, the default is the joints that move its link.
    """

    checker: CollisionChecker
    start: Floats
    goal: Floats | PoseGoal
    joints: str | list[str] | None

    @classmethod
    def of(
        cls, checker: CollisionChecker, start: ArrayLike, goal: ArrayLike | PoseGoal,
        joints: str | Iterable[str] | None = None,
    ) -> Task:  # fmt: skip
        """Check the arguments of a function that plans."""
        robot = checked_checker(checker).robot
        q, named = robot.checked_one(start, "start"), _validate.group_or_names(joints, "joints")
        if isinstance(goal, PoseGoal):
            return cls(checker, q, goal, goal._joints(robot) if named is None else named)
        return cls(checker, q, _checked_goals(robot, goal), named)

    def goals(self, judge: Judge) -> tuple[Floats, list[str], Approaches | None]:
        """Return the goals, shape (goals, dof), their names, and the approaches to them.

        If a pose has an approach or a retreat, the judge checks these lines. The goals are then the configurations at
        which the approaches begin.
        """
        if isinstance(self.goal, PoseGoal):
            return self.goal._found(judge, self.start, self.joints)
        return self.goal, [f"goal[{k}]" for k in range(len(self.goal))], None


def _checked_goals(robot: Robot, goal: ArrayLike) -> Floats:
    """Check one goal or several, given as configurations."""
    expected = f"({robot.dof},) or (goals, {robot.dof})"
    if not isinstance(goal, str):  # a string is refused where configurations are checked
        shape = _validate.plain_array(goal, "goal").shape
        if shape[-2:] == (4, 4) and robot.dof != 4:
            raise InputError(
                f"goal: expected configurations, shape {expected}, or for poses of a link planners.PoseGoal(link, T); "
                f"found poses, shape {_validate.shape_text(shape)}"
            )
    goals = np.atleast_2d(robot.checked(goal, "goal"))
    if goals.ndim != 2 or len(goals) == 0:
        raise InputError(f"goal: expected shape {expected}, found {_validate.shape_text(goals.shape)}")
    return goals


def _by_a_hair(excess: float) -> str:
    """Return an addition to a message in which two numbers may look equal."""
    return f" (by {excess:.1g}: clip or copy it)" if excess < A_HAIR else ""


def _no_goal(faults: list[str], names: list[str]) -> PlanningError:
    """Make the error for the case that every goal has a fault."""
    if names == ["goal[0]"]:
        return PlanningError(f"goal: expected a free configuration within the limits, found {faults[0]}")
    listed = some((f"{name}: {fault}" for name, fault in zip(names, faults, strict=True)), NAMED, "; ")
    return PlanningError(f"goal: expected a free configuration within the limits, found none: {listed}")


def _refuse_start(fault: str) -> None:
    if fault:
        raise PlanningError(f"start: expected a free configuration within the limits, found {fault}")


def _columns(robot: Robot, joints: str | Iterable[str] | None) -> Ints:
    """Return the columns of a group, of the given joints or of all joints, in ascending order."""
    names = named_joints(robot, joints)
    for name in names:
        if name not in robot.configuration_names:
            raise InputError(
                f"joints: expected joints of one value each, found {name!r}, which is planar or floating, or a ball "
                "joint, and has no limits to search within; name the joints that are to move"
            )
    return np.flatnonzero([name in names for name in robot.configuration_names])
