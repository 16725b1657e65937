"""Motions from start to goal: OMPL's planners, with every state and every motion judged by a `CollisionChecker`.

OMPL is imported when a function here is called, and not before: ``pip install "loewner[planners]"``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner import _validate
from loewner._guard import guarded
from loewner._plausible import FARTHEST_LIMIT
from loewner._validate import Floats, Ints
from loewner.errors import ConvergenceError, InputError, MissingExtraError, PlanningError, installing
from loewner.robots import CollisionChecker, Robot

# How far a configuration may be outside a limit and still count as on it: what OMPL allows, for rounding.
ON_LIMIT = float(np.finfo(np.float64).eps)

# OMPL takes shares of the extent strictly between 0 and 1.
SMALLEST_SHARE = 1e-12

# Configurations and pairs that a message names at most.
NAMED = 5


@guarded
def plan(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    joints: str | Iterable[str] | None = None,
    planner: str | Callable[[Any], Any] = "RRTConnect",
    timeout: float = 10.0,
    resolution: float = 0.05,
    simplify: bool = True,
    seed: int = 0,
) -> Floats:
    """Find a motion free of collisions.

    Parameters
    ----------
    checker : CollisionChecker
    start : array_like, shape (dof,)
    goal : array_like, shape (dof,) or (goals, dof)
        Where to go; of several, any one will do. Those that cannot be reached for a reason that shows at once
        (outside the limits, colliding) are left out, as long as one remains.
    joints : str or iterable of str, optional
        A group, or names of joints: these move, and all others keep the values of `start`. Default: all.
    planner : str or callable
        A class of ``ompl.geometric``, such as "RRTConnect", "BITstar" or "PRM"; or a function that takes the
        ``SpaceInformation`` and returns a planner, set up as you like.
    timeout : float
        Seconds to search; simplifying comes on top. Planners that seek a shortest path take all of them.
    resolution : float
        Largest Euclidean distance of two configurations that are checked along a motion, in the units of the joints.
    simplify : bool
        Shorten and smooth what was found.
    seed : int
        Equal seeds give equal paths, as long as the planner ends by itself before the timeout. OMPL keeps one seed
        for the process: this sets it.

    Returns
    -------
    ndarray, shape (k, dof)
        Configurations from `start` to a goal; between two of them each joint runs straight. The whole path has been
        checked once more, by `CollisionChecker.valid_edges`, after OMPL was done.

    Raises
    ------
    PlanningError
        If start or all goals are outside the limits or collide (the message names joints or pairs), if no path was
        found in time, or if the path found did not pass the last check.
    InputError
        If an argument has the wrong shape or value, a goal moves a joint that is not among `joints`, or one of `joints`
        is a planar or floating joint, which has no limits to search within.
    UnknownNameError
        If there is no such group, joint or planner.
    MissingExtraError
        If OMPL is not installed.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> path = plan(CollisionChecker(Robot.from_urdf("arm.urdf")), [0.0, 0.0], [2.0, 0.0], joints="rail")
    >>> path[[0, -1]]
    array([[0., 0.],
           [2., 0.]])
    """
    timeout = _validate.positive_scalar(timeout, "timeout")
    seed, simplify = _validate.whole_number(seed, "seed", 0, 2**32 - 2), _validate.flag(simplify, "simplify")
    make = _planner(planner)
    robot = _checker(checker).robot
    q, goals = robot.checked_one(start, "start"), np.atleast_2d(robot.checked(goal, "goal"))
    if goals.ndim != 2 or len(goals) == 0:
        raise InputError(
            f"goal: expected shape ({robot.dof},) or (goals, {robot.dof}), found {_validate.shape_text(np.shape(goal))}"
        )
    space = _Space.of(checker, joints, q, goals, resolution)
    # Limits before all else: to values in degrees, nothing else that could be said would be to the point.
    _refuse_start(space.outside(q))
    goals_inside = space.usable(goals, space.outside)
    space.check_still(goals_inside)
    _refuse_start(space.fault(q))
    goals = space.usable(goals, space.fault)
    with _quietly():
        _ompl("util").RNG.setSeed(int(seed) + 1)  # 0 is none to OMPL
        found = _search(space, make, q, goals, timeout, simplify)
    _check_path(space, found, q, goals)
    return found


@guarded
def space_information(
    checker: CollisionChecker,
    *,
    joints: str | Iterable[str] | None = None,
    fixed: ArrayLike | None = None,
    resolution: float = 0.05,
) -> Any:
    """An OMPL ``SpaceInformation`` whose states and motions the checker judges, for planners of your own.

    Parameters
    ----------
    checker : CollisionChecker
        Changes of its scene count from the next state that is checked on.
    joints : str or iterable of str, optional
        A group, or names of joints: the dimensions of the state space, in the order of the robot's
        `configuration_names`. Default: all.
    fixed : array_like, shape (dof,), optional
        What the other joints keep. Default: `Robot.configuration`'s, all 0.
    resolution : float
        As for `plan`, in the units of the joints.

    Returns
    -------
    ompl.base.SpaceInformation
        Set up, over a ``RealVectorStateSpace`` whose dimensions bear the names of the joints, bounded by their limits.
        A joint that turns without limit is bounded to half a turn to both sides of its value in `fixed`. A joint
        whose limits are equal does not move, and is no dimension.

    Raises
    ------
    InputError, UnknownNameError, MissingExtraError
        As for `plan`.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> information = space_information(CollisionChecker(Robot.from_urdf("arm.urdf")), joints="rail")
    >>> information.getStateDimension(), information.getStateSpace().getBounds().high[0]
    (1, 2.0)
    """
    _ompl("base")
    robot = _checker(checker).robot
    q = robot.configuration() if fixed is None else robot.checked_one(fixed, "fixed")
    return _Space.of(checker, joints, q, q[None], resolution).information()


@dataclass(frozen=True, eq=False)
class _Space:
    """The joints that move, and what the others keep."""

    checker: CollisionChecker
    columns: Ints
    still: Floats
    lower: Floats
    upper: Floats
    resolution: float

    @classmethod
    def of(
        cls,
        checker: CollisionChecker,
        joints: str | Iterable[str] | None,
        q: Floats,
        goals: Floats,
        resolution: float,
    ) -> _Space:
        """The space of some joints; where one has no limits it reaches half a turn beyond start and goals."""
        step = _validate.positive_scalar(resolution, "resolution")
        robot = checker.robot
        columns = _columns(robot, joints)
        ends = np.vstack([q, goals])
        # What some programs write for no limit, 1e16 or the largest number, is none to search within either.
        below, above = robot.lower > -FARTHEST_LIMIT, robot.upper < FARTHEST_LIMIT
        lower = np.where(below, robot.lower, np.maximum(ends.min(axis=0) - np.pi, robot.lower))[columns]
        upper = np.where(above, robot.upper, np.minimum(ends.max(axis=0) + np.pi, robot.upper))[columns]
        moving = lower < upper
        if not moving.any():
            raise InputError("joints: expected one or more that can move, found none")
        return cls(checker, columns[moving], q, lower[moving], upper[moving], step)

    def configurations(self, values: ArrayLike) -> Floats:
        """Whole configurations, shape (..., dof), from values of the moving joints, shape (..., columns)."""
        values = np.asarray(values)
        Q = np.empty((*values.shape[:-1], len(self.still)))
        Q[:] = self.still
        Q[..., self.columns] = values
        return Q

    def check_still(self, goals: Floats) -> None:
        """Refuse goals that differ from the start where nothing moves."""
        differs = (goals != self.still).any(axis=0)
        differs[self.columns] = False
        if differs.any():
            column = int(differs.argmax())
            goal = goals[(goals != self.still)[:, column].argmax(), column]
            raise InputError(
                f"goal: expected the start's value, {self.still[column]:g}, of {self._name(column)}, which is not "
                f"among the joints that move; found {goal:g}"
            )

    def outside(self, q: Floats) -> str:
        """Which joints that move are outside their limits; "" if none is."""
        values = q[self.columns]
        outside = np.flatnonzero((values < self.lower - ON_LIMIT) | (values > self.upper + ON_LIMIT))
        named = ", ".join(
            f"{self._name(self.columns[k])} = {values[k]:g} outside {self.lower[k]:g} .. {self.upper[k]:g}"
            for k in outside[:NAMED]
        )
        return named + (f", and {len(outside) - NAMED} more" if len(outside) > NAMED else "")

    def fault(self, q: Floats) -> str:
        """Why a configuration cannot be on a path: it is outside the limits, or collides; "" if it can."""
        outside = self.outside(q)
        if outside:
            return outside
        try:
            if not self.checker.collide(q):
                return ""
            pairs = [f"{contact.name_a} and {contact.name_b}" for contact in self.checker.pairs(q)]
        except ConvergenceError as error:
            return f"one that cannot be proven free: {error}"
        more = f", and {len(pairs) - NAMED} more pairs" if len(pairs) > NAMED else ""
        return f"a collision of {', '.join(pairs[:NAMED])}{more}"

    def usable(self, goals: Floats, fault: Callable[[Floats], str]) -> Floats:
        """Those goals that have no fault of a kind."""
        faults = [fault(q) for q in goals]
        good = goals[[not fault for fault in faults]]
        if len(good):
            return good
        if len(goals) == 1:
            raise PlanningError(f"goal: expected a free configuration within the limits, found {faults[0]}")
        listed = "; ".join(f"goal[{k}]: {fault}" for k, fault in enumerate(faults[:NAMED]))
        more = f"; and {len(goals) - NAMED} more" if len(goals) > NAMED else ""
        raise PlanningError(f"goal: expected a free configuration within the limits, found none: {listed}{more}")

    def free(self, q: Floats) -> bool:
        """Whether a configuration is proven free; what cannot be settled is not."""
        try:
            return not self.checker.collide(q)
        except ConvergenceError:
            return False

    def free_between(self, Q0: Floats, Q1: Floats) -> bool:
        """Whether straight motions are all proven free, at the resolution."""
        try:
            return bool(np.all(self.checker.valid_edges(Q0, Q1, self.resolution)))
        except ConvergenceError:
            return False

    def information(self) -> Any:
        """The space as OMPL takes it."""
        base = _ompl("base")
        space = base.RealVectorStateSpace(0)
        for column, lower, upper in zip(self.columns, self.lower, self.upper, strict=True):
            space.addDimension(self._name(column), float(lower), float(upper))
        information = base.SpaceInformation(space)
        count = len(self.columns)

        def valid(state: Any) -> bool:
            return space.satisfiesBounds(state) and self.free(self.configurations(state[0:count]))

        information.setStateValidityChecker(valid)
        information.setMotionValidator(_motion_validator()(information, self))
        # Planners that divide motions by themselves take a share of the space's extent.
        information.setStateValidityCheckingResolution(
            float(np.clip(self.resolution / information.getMaximumExtent(), SMALLEST_SHARE, 1 - SMALLEST_SHARE))
        )
        information.setup()
        return information

    def _name(self, column: int) -> str:
        return self.checker.robot.configuration_names[column]


def _search(
    space: _Space, make: Callable[[Any], Any], q: Floats, goals: Floats, timeout: float, simplify: bool
) -> Floats:
    """OMPL's path from a configuration to one of the goals."""
    base, geometric = _ompl("base"), _ompl("geometric")
    count = len(space.columns)
    information = space.information()
    problem, region = base.ProblemDefinition(information), base.GoalStates(information)
    state = information.allocState()
    for values, add in [(q, problem.addStartState), *((goal, region.addState) for goal in goals)]:
        state[0:count] = values[space.columns].tolist()
        add(state)  # takes a copy
    problem.setGoal(region)
    planner = make(information)
    if not isinstance(planner, base.Planner):
        raise InputError(
            f"planner: expected a function that returns a planner of OMPL, found {_validate.short(planner)}"
        )
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(timeout)
    # A path that only comes near the goal is a solution to OMPL, and none here.
    if not problem.hasExactSolution():
        raise PlanningError(
            f"expected a path from start to goal, found none by {planner.getName()} within {timeout:g} s"
        )
    path = problem.getSolutionPath()
    if simplify:
        geometric.PathSimplifier(information).simplifyMax(path)
    return space.configurations([state[0:count] for state in path.getStates()])


def _check_path(space: _Space, found: Floats, q: Floats, goals: Floats) -> None:
    """Trust nothing that comes back: limits, ends and all motions once more."""
    values = found[:, space.columns]
    ends = (found[0] == q).all() and (found[-1] == goals).all(axis=1).any()
    inside = (values >= space.lower - ON_LIMIT).all() and (values <= space.upper + ON_LIMIT).all()
    if not (len(found) > 1 and ends and inside and space.free_between(found[:-1], found[1:])):
        raise PlanningError(
            "expected a path that is free at every step, found one that fails when it is checked again; "
            "another seed, or a finer resolution, may help"
        )


def _refuse_start(fault: str) -> None:
    if fault:
        raise PlanningError(f"start: expected a free configuration within the limits, found {fault}")


def _columns(robot: Robot, joints: str | Iterable[str] | None) -> Ints:
    """Columns of a group, of some joints or of all, in ascending order."""
    if isinstance(joints, str):
        if joints not in robot.groups and joints not in robot.joint_names:
            raise _validate.unknown_name("joints", joints, (*robot.groups, *robot.joint_names))
        names = list(robot.groups.get(joints, (joints,)))
    else:
        names = list(robot.joint_names) if joints is None else _validate.listed(joints, "joints")
    if not names:
        raise InputError(
            "joints: expected one or more, found none" + (f" in group {joints!r}" if isinstance(joints, str) else "")
        )
    for name in names:
        if not isinstance(name, str) or name not in robot.joint_names:
            raise _validate.unknown_name("joints", name, robot.joint_names)
        if name not in robot.configuration_names:
            raise InputError(
                f"joints: expected joints of one value each, found {name!r}, which is planar or floating and has no "
                "limits to search within; name the joints that are to move"
            )
    return np.flatnonzero([name in names for name in robot.configuration_names])


def _planner(planner: str | Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A function that makes a planner."""
    if callable(planner):
        return planner
    base, geometric = _ompl("base"), _ompl("geometric")
    known = {
        name: each
        for name, each in sorted(vars(geometric).items())
        if isinstance(each, type) and issubclass(each, base.Planner)
    }
    if not isinstance(planner, str) or planner not in known:
        raise _validate.unknown_name("planner", planner, known)
    made: Callable[[Any], Any] = known[planner]
    return made


def _checker(checker: Any) -> CollisionChecker:
    if not isinstance(checker, CollisionChecker):
        raise InputError(f"checker: expected loewner.CollisionChecker, found {type(checker).__name__}")
    return checker


@cache
def _motion_validator() -> Any:
    """The class, made when OMPL is needed for the first time."""
    parent: Any = _ompl("base").MotionValidator

    class Motions(parent):  # type: ignore[misc]
        """Asks a `_Space` whether motions are free.

        It keeps no reference to the ``SpaceInformation``, which keeps one to it: the two would never be freed.
        """

        def __init__(self, information: Any, space: _Space) -> None:
            super().__init__(information)
            self._space, self._count = space, len(space.columns)

        def checkMotion(self, one: Any, other: Any) -> bool:
            Q = self._space.configurations([one[0 : self._count], other[0 : self._count]])
            return self._space.free_between(Q[0], Q[1])

    return Motions


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep OMPL from writing to standard output and standard error."""
    util = _ompl("util")
    level = util.getLogLevel()
    util.setLogLevel(util.LogLevel.LOG_NONE)
    try:
        yield
    finally:
        util.setLogLevel(level)


def _ompl(part: str) -> Any:
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise MissingExtraError(f"planners need OMPL: {installing('planners')}") from None
    return {"base": base, "geometric": geometric, "util": util}[part]
