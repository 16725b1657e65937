"""Define `PoseGoal`, a pose of a link as the goal of a path."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner import _validate
from loewner._guard import guarded
from loewner._validate import Floats
from loewner.errors import InputError, PlanningError
from loewner.planners.judge import checked_checker
from loewner.robots import CollisionChecker, Robot
from loewner.robots.reaching import MOST_SEEDS, checked_tolerance
from loewner.robots.robot import chain_to

# Configurations that are tried as goals at most: free ones first, then those nearest to the start.
MOST_GOALS = 16


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """Poses of a link as the goal of `plan` or `Roadmap.path`: any configuration at which the link has one of them.

    Parameters
    ----------
    link : str
    T : array_like, shape (..., 4, 4)
        One pose or several, such as candidates for a grasp; reaching any of them is enough. T_world_link, in metres.
    tolerance : array_like, shape (6,), optional
        Largest deviations from a pose, as for `Robot.reach`.
    seeds : int
        As for `Robot.reach`: more find more of the configurations.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, planners
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> pose = robot.forward_kinematics([1.0, 0.5])[2]
    >>> planners.plan(CollisionChecker(robot), [0.0, 0.0], planners.PoseGoal("forearm", pose)).round(9)
    array([[0. , 0. ],
           [1. , 0.5]])
    """

    link: str
    T: ArrayLike
    tolerance: ArrayLike | None = None
    seeds: int = 64

    def __post_init__(self) -> None:
        poses = _validate.poses(self.T, "T")
        if poses.size == 0:
            raise InputError("T: expected one pose or more, found none")
        object.__setattr__(self, "T", poses.copy())
        if not isinstance(self.link, str):
            raise InputError(f"link: expected the name of a link, found {_validate.short(self.link)}")
        if self.tolerance is not None:
            checked_tolerance(self.tolerance)
        _validate.whole_number(self.seeds, "seeds", 1, MOST_SEEDS)

    @guarded
    def configurations(
        self, checker: CollisionChecker, start: ArrayLike, joints: str | Iterable[str] | None = None
    ) -> Floats:
        """Find configurations that reach the goal: free ones first, then those nearest to the start.

        Parameters
        ----------
        checker : CollisionChecker
        start : array_like, shape (dof,)
            Joints that do not move the link, or are not among `joints`, keep these values.
        joints : str or iterable of str, optional
            As for `plan`.

        Returns
        -------
        ndarray, shape (goals, dof)
            At most sixteen, which collide only if there are too few free ones.

        Raises
        ------
        PlanningError
            If no pose is reached; the message states how near the link came.
        InputError, UnknownNameError
            As for `Robot.reach`.
        """
        return self._found(checker, start, joints)[0]

    def _found(
        self, checker: CollisionChecker, start: ArrayLike, joints: str | Iterable[str] | None
    ) -> tuple[Floats, list[str]]:
        """Find the configurations, and name each for messages: its pose, and its number among the pose's solutions."""
        robot, poses = checked_checker(checker).robot, np.asarray(self.T).reshape(-1, 4, 4)
        begin = robot.checked_one(start, "start")
        found = robot.reach(
            self.link,
            poses,
            joints=joints,
            start=begin,
            seeds=self.seeds,
            checker=checker,
            all=True,
            tolerance=self.tolerance,
        )
        Q = np.concatenate(found.solutions)
        if len(Q) == 0:
            nearest = int((found.residual**2).sum(axis=1).argmin())
            shift, turn = found.residual[nearest].tolist()
            which = "a pose" if len(poses) == 1 else f"one of {len(poses)} poses"
            raise PlanningError(
                f"goal: expected {which} that {self.link} can reach within the limits, found none; the nearest attempt "
                f"of {self.seeds + 1} is {1e3 * shift:.3g} mm and {turn:.3g} rad away"
                + (f" from pose {nearest}" if len(poses) > 1 else "")
            )
        free = np.concatenate([np.arange(len(x)) < n for x, n in zip(found.solutions, found.free, strict=True)])
        order = np.lexsort((np.linalg.norm(Q - begin, axis=1), ~free))
        names = [
            f"solution {k} of pose {pose}" for pose, of_it in enumerate(found.solutions) for k in range(len(of_it))
        ]
        return np.asarray(Q[order[:MOST_GOALS]]), [names[k] for k in order[:MOST_GOALS]]


def goals_of(
    goal: Any, checker: CollisionChecker, start: Floats, joints: str | Iterable[str] | None
) -> tuple[Any, list[str] | None]:
    """Return the configurations of a goal that is given by poses with their names, and any other goal as it is."""
    robot = checker.robot
    if isinstance(goal, PoseGoal):
        return goal._found(checker, start, joints)
    shape = _validate.plain_array(goal, "goal").shape
    if shape[-2:] == (4, 4) and robot.dof != 4:
        raise InputError(
            f"goal: expected configurations, shape ({robot.dof},) or (goals, {robot.dof}), or for poses of a link "
            f"planners.PoseGoal(link, T); found poses, shape {_validate.shape_text(shape)}"
        )
    return goal, None


def joints_of(goal: PoseGoal, robot: Robot) -> list[str]:
    """Return the names of the joints that move the link; `plan` moves these alone, unless it is given others."""
    chain = chain_to(robot, goal.link)
    moving = set(chain.columns[chain.moving].tolist())
    return [name for name in robot.joint_names if moving & set(range(robot.dof)[robot._columns[name]])]
