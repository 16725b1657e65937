"""Plan with OMPL; a `CollisionChecker` judges every state and motion.

OMPL (``pip install "loewner[planners]"``) is imported only when a function of this module is called.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats
from loewner.errors import InputError, PlanningError
from loewner.planners.judge import Judge, checked_checker, free_now, refuse_unfree
from loewner.planners.searches import Search, named, ompl
from loewner.planners.space import Space
from loewner.robots import CollisionChecker

# OMPL accepts only shares of the extent strictly between 0 and 1.
SMALLEST_SHARE = 1e-12


@guarded
def space_information(
    checker: CollisionChecker,
    *,
    joints: str | Iterable[str] | None = None,
    fixed: ArrayLike | None = None,
    certified: bool = False,
    resolution: float = 0.05,
) -> Any:
    """Make an OMPL ``SpaceInformation`` for your own planners. The checker judges all states and motions.

    Parameters
    ----------
    checker : CollisionChecker
        Changes to the checker's scene take effect at the next checked state.
    joints : str or iterable of str, optional
        A group, or names of joints. These joints are the dimensions of the state space, in the order of the robot's
        `configuration_names`. Default: all joints.
    fixed : array_like, shape (dof,), optional
        Values that all remaining joints keep. Default: the values of `Robot.configuration`, all 0.
    certified : bool
        Whether to prove the motions that OMPL checks, as `plan` does. If false, the motions are sampled in steps.
    resolution : float
        As for `plan`, in the units of the joints.

    Returns
    -------
    ompl.base.SpaceInformation
        An object with a ``RealVectorStateSpace``. Its dimensions have the names of the joints, and are bounded by the
        joints' limits. A joint that turns without limits is restricted to half a turn on either side of its value in
        `fixed`. A joint whose limits are equal does not move, and is not a dimension.

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
    ompl("base")
    step = _validate.positive_scalar(resolution, "resolution")
    robot = checked_checker(checker).robot
    q = robot.configuration() if fixed is None else robot.checked_one(fixed, "fixed")
    judge = Judge.of(checker, 0.0 if _validate.flag(certified, "certified") else step)
    return _information(Space.of(checker, joints, q, q[None]), step, judge)


def find_path(space: Space, judge: Judge, q: Floats, goals: Floats, search: Search, seed: int) -> Floats:
    """Find a path from a configuration to one of the goals with OMPL.

    The judge decides whether the motions that OMPL checks are free, each in the state of the scene at the time of its
    check. Planners that divide motions themselves use the resolution of the search.

    Raises
    ------
    PlanningError
        If no path was found in time, or the path fails a second check.
    """
    base, geometric, count = ompl("base"), ompl("geometric"), len(space.columns)
    with _quietly():
        ompl("util").RNG.setSeed(int(seed) + 1)  # for OMPL, 0 means no seed
        information = _information(space, search.resolution, judge)
        problem, region = base.ProblemDefinition(information), base.GoalStates(information)
        state = information.allocState()
        for values, add in [(q, problem.addStartState), *((goal, region.addState) for goal in goals)]:
            state[0:count] = values[space.columns].tolist()
            add(state)  # takes a copy
        problem.setGoal(region)
        planner = named(search.planner)(information)
        if not isinstance(planner, base.Planner):
            raise InputError(
                f"planner: expected a function that returns an OMPL planner, found {_validate.short(planner)}"
            )
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(search.timeout)
        # For OMPL, a path that only comes close to the goal is also a solution. Such a path is refused here.
        if not problem.hasExactSolution():
            raise PlanningError(
                f"expected a path from start to goal, found none by {planner.getName()} within {search.timeout:g} s"
            )
        solution = problem.getSolutionPath()
        if search.simplify:
            geometric.PathSimplifier(information).simplifyMax(solution)
        path = space.configurations([state[0:count] for state in solution.getStates()])
    ends = (path[0] == q).all() and (path[-1] == goals).all(axis=1).any()
    if not (len(path) > 1 and ends and space.inside(path).all()):
        raise PlanningError("expected a path from start to goal within the limits, found another one: try another seed")
    refuse_unfree(judge.now(), path, "path of OMPL's planner")
    return path


def _information(space: Space, resolution: float, judge: Judge) -> Any:
    """Convert the space to the form that OMPL requires."""
    base = ompl("base")
    dimensions = base.RealVectorStateSpace(0)
    for column, lower, upper in zip(space.columns, space.lower, space.upper, strict=True):
        dimensions.addDimension(space.name(column), float(lower), float(upper))
    information = base.SpaceInformation(dimensions)
    count = len(space.columns)

    def valid(state: Any) -> bool:
        return dimensions.satisfiesBounds(state) and space.free(space.configurations(state[0:count]))

    information.setStateValidityChecker(valid)
    information.setMotionValidator(_motion_validator()(information, space, judge))
    # Planners that divide motions themselves express the resolution as a share of the space's extent.
    information.setStateValidityCheckingResolution(
        float(np.clip(resolution / information.getMaximumExtent(), SMALLEST_SHARE, 1 - SMALLEST_SHARE))
    )
    information.setup()
    return information


@cache
def _motion_validator() -> Any:
    """Make the class of the motion validator, when OMPL is first needed."""
    parent: Any = ompl("base").MotionValidator

    class Motions(parent):  # type: ignore[misc]
        """Check whether motions are free in the scene's current state.

        The validator keeps no reference to the ``SpaceInformation``, because the ``SpaceInformation`` refers to the
        validator. With references in both directions, neither object would ever be freed.
        """

        def __init__(self, information: Any, space: Space, judge: Judge) -> None:
            super().__init__(information)
            self._space, self._judge, self._count = space, judge, len(space.columns)

        def checkMotion(self, one: Any, other: Any) -> bool:
            Q = self._space.configurations([one[0 : self._count], other[0 : self._count]])
            return free_now(self._judge, Q[0], Q[1])

    return Motions


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep OMPL from writing to standard output and standard error."""
    util = ompl("util")
    level = util.getLogLevel()
    util.setLogLevel(util.LogLevel.LOG_NONE)
    try:
        yield
    finally:
        util.setLogLevel(level)
