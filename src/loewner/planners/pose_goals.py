"""Define `PoseGoal`, a pose of a link as the goal of a path, with straight lines to it and away from it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._matrices import image
from loewner._base._validate import Bools, Floats
from loewner.errors import InputError, PlanningError
from loewner.planners.judge import Judge, checked_checker, refuse_unfree
from loewner.planners.kept_lines import Line
from loewner.planners.lines import block_of, followed
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checking.verdicts import contacts, free
from loewner.robots.description.reaching import MOST_SEEDS, checked_tolerance
from loewner.robots.description.robot import chain_to

# Largest number of configurations that are tried as goals. Free configurations, and nearer ones, are tried first.
MOST_GOALS = 16

# A goal in contact with an approach or a retreat counts as TOUCHING goals, since proofs under contact rules take twenty
# times as long.
TOUCHING = 4

# A displacement: the frame of its vector ("link" or "world"), and the vector, shape (3,) [m].
Displacement = tuple[str, Floats]
FRAMES = ("link", "world")


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """Poses of a link as the goal of `plan` or `Roadmap.path`. The link must reach one of them, in any configuration.

    Parameters
    ----------
    link : str
    T : array_like, shape (..., 4, 4)
        One pose T_world_link in metres, or several poses, such as candidates for a grasp. The link must reach any one
        of them.
    tolerance : array_like, shape (6,), optional
        Largest deviations from a pose, as for `Robot.reach`.
    seeds : int
        As for `Robot.reach`. More seeds find more configurations.
    approach, retreat : float, array_like, shape (3,), or (str, array_like), optional
        Straight lines along which the link moves to the goal and away from it. Each line is given by the link's
        displacement in metres: a vector in the frame of the link at the goal, or ``("world", vector)`` in the frame of
        the world. A number is a distance along the link's z axis. An approach moves forward along this axis, and a
        retreat moves back. The link does not rotate.

    Notes
    -----
    A configuration is accepted only if the link can follow the approach and the retreat, as for `straight`, and both
    motions are proven free. The path of `plan` ends with the approach. With ``full=True``, ``Plan.approach`` is the row
    at which the approach begins, and ``Plan.retreat`` is the path of the retreat. The lines are proven in the scene for
    which the path is planned. After a change to the scene, for example by `Scene.attach`, call `retreat_path` to prove
    the retreat again.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, planners
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> pose = robot.forward_kinematics([1.0, 0.5])[2]
    >>> planners.plan(CollisionChecker(robot), [0.0, 0.0], planners.PoseGoal("forearm", pose)).round(9)
    array([[0. , 0. ],
           [1. , 0.5]])
    >>> pose = robot.forward_kinematics([1.0, 0.5])[1]
    >>> goal = planners.PoseGoal("cart", pose, approach=[0.25, 0.0, 0.0], retreat=("world", [-0.5, 0.0, 0.0]))
    >>> found = planners.plan(CollisionChecker(robot), [0.0, 0.0], goal, full=True)
    >>> found.path[found.approach :].round(9), found.retreat.round(9)
    (array([[0.75, 0.  ],
           [1.  , 0.  ]]), array([[1. , 0. ],
           [0.5, 0. ]]))
    """

    link: str
    T: ArrayLike
    tolerance: ArrayLike | None = None
    seeds: int = 64
    approach: float | ArrayLike | tuple[str, ArrayLike] | None = None
    retreat: float | ArrayLike | tuple[str, ArrayLike] | None = None

    def __post_init__(self) -> None:
        poses = _validate.poses(self.T, "T")
        if poses.size == 0:
            raise InputError("T: expected one pose or more, found none")
        object.__setattr__(self, "T", poses.copy())
        _validate.expect_name(self.link, "link: expected the name of a link")
        if self.tolerance is not None:
            checked_tolerance(self.tolerance)
        _validate.whole_number(self.seeds, "seeds", 1, MOST_SEEDS)
        for name, sign in (("approach", 1.0), ("retreat", -1.0)):
            displacement = getattr(self, name)
            object.__setattr__(self, name, None if displacement is None else _displacement(displacement, name, sign))

    @guarded
    def configurations(
        self, checker: CollisionChecker, start: ArrayLike, joints: str | Iterable[str] | None = None
    ) -> Floats:
        """Find configurations that reach the goal.

        Free configurations precede colliding ones. Within each group, configurations nearer to `start` come first.

        Parameters
        ----------
        checker : CollisionChecker
        start : array_like, shape (dof,)
            Joints keep these values if they do not move the link, or are not among `joints`.
        joints : str or iterable of str, optional
            As for `plan`.

        Returns
        -------
        ndarray, shape (goals, dof)
            At most sixteen configurations. Colliding configurations are included only if fewer than sixteen
            configurations are free. If the goal has an approach or a retreat, these motions are free for all
            configurations.

        Raises
        ------
        PlanningError
            If no pose is reached, or if no configuration has a free approach and retreat. The message states how close
            to a pose the link came, or how often each reason applies.
        InputError, UnknownNameError
            As for `Robot.reach`.
        """
        begin = checked_checker(checker).robot.checked_one(start, "start")
        Q, _, approaches = self._found(Judge.of(checker, 0.0), begin, _validate.group_or_names(joints, "joints"))
        return Q if approaches is None else np.array([rows[-1] for rows in approaches.rows])

    @guarded
    def approach_path(
        self, checker: CollisionChecker, q: ArrayLike, joints: str | Iterable[str] | None = None
    ) -> Floats:
        """Find the straight approach to a configuration, proven free in the current scene.

        Parameters
        ----------
        checker : CollisionChecker
        q : array_like, shape (dof,)
            The configuration at the goal.
        joints : str or iterable of str, optional
            As for `straight`.

        Returns
        -------
        ndarray, shape (k, dof)
            Configurations, ending with `q`.

        Raises
        ------
        InputError
            If the goal has no approach; or as for `straight`.
        PlanningError
            If the link cannot follow the line, or the line is not free.
        UnknownNameError
            As for `straight`.

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot, planners
        >>> goal = planners.PoseGoal("cart", np.eye(4), approach=[0.5, 0, 0])
        >>> goal.approach_path(CollisionChecker(Robot.from_urdf("arm.urdf")), [1.0, 0.0]).round(9)
        array([[0.5, 0. ],
               [1. , 0. ]])
        """
        return self._line(checker, q, joints, "approach")

    @guarded
    def retreat_path(
        self, checker: CollisionChecker, q: ArrayLike, joints: str | Iterable[str] | None = None
    ) -> Floats:
        """Find the straight retreat from a configuration, proven free in the current scene.

        Parameters
        ----------
        checker : CollisionChecker
        q : array_like, shape (dof,)
            The configuration at the goal, or a similar one, for example with the fingers opened.
        joints : str or iterable of str, optional
            As for `straight`.

        Returns
        -------
        ndarray, shape (k, dof)
            Configurations, beginning with `q`.

        Raises
        ------
        InputError
            If the goal has no retreat; or as for `straight`.
        PlanningError
            If the link cannot follow the line, or the line is not free.
        UnknownNameError
            As for `straight`.

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot, planners
        >>> goal = planners.PoseGoal("cart", np.eye(4), retreat=("world", [0.5, 0, 0]))
        >>> goal.retreat_path(CollisionChecker(Robot.from_urdf("arm.urdf")), [1.0, 0.0]).round(9)
        array([[1. , 0. ],
               [1.5, 0. ]])
        """
        return self._line(checker, q, joints, "retreat")

    # -- inside -------------------------------------------------------------------------------

    def _line(self, checker: CollisionChecker, q: ArrayLike, joints: str | Iterable[str] | None, name: str) -> Floats:
        """Find the approach or the retreat."""
        robot = checked_checker(checker).robot
        displacement = getattr(self, name)
        if displacement is None:
            raise InputError(f"{name}: expected PoseGoal(..., {name}=...), found none")
        judge, at_goal = Judge.of(checker, 0.0), robot.checked_one(q, "q")
        rows, kind, why = _along(judge, at_goal, self.link, joints, displacement, name == "approach")
        if kind:
            raise PlanningError(f"{name}: expected a free line that {self.link} can follow, found that {why}")
        return rows

    def _joints(self, robot: Robot) -> list[str]:
        """Return the joints that move the link, the default for plans. Other joints (fingers) keep their values."""
        chain = chain_to(robot, self.link)
        moving = set(chain.columns[chain.moving].tolist())
        return [name for name in robot.joint_names if moving & set(range(robot.dof)[robot._columns[name]])]

    def _found(
        self, judge: Judge, begin: Floats, joints: str | Iterable[str] | None
    ) -> tuple[Floats, list[str], Approaches | None]:
        """Find the configurations. For messages, name each one by its pose and its number among the pose's solutions.

        With an approach or a retreat, return the configurations at which the approaches begin.
        """
        poses = np.asarray(self.T).reshape(-1, 4, 4)
        reached = judge.checker.robot.reach(
            self.link, poses, joints=joints, start=begin, seeds=self.seeds, checker=judge.checker, all=True,
            tolerance=self.tolerance,
        )  # fmt: skip
        Q = np.concatenate(reached.solutions)
        if len(Q) == 0:
            nearest = int((reached.residual**2).sum(axis=1).argmin())
            shift, turn = reached.residual[nearest].tolist()
            which = "a pose" if len(poses) == 1 else f"one of {len(poses)} poses"
            raise PlanningError(
                f"goal: expected {which} that {self.link} can reach within the limits, found none; the nearest attempt "
                f"of {self.seeds + 1} is {1e3 * shift:.3g} mm and {turn:.3g} rad away"
                + (f" from pose {nearest}" if len(poses) > 1 else "")
            )
        good = np.concatenate([np.arange(len(x)) < n for x, n in zip(reached.solutions, reached.free, strict=True)])
        order = np.lexsort((np.linalg.norm(Q - begin, axis=1), ~good))
        names = [
            f"solution {k} of pose {pose}" for pose, of_it in enumerate(reached.solutions) for k in range(len(of_it))
        ]
        if self.approach is None and self.retreat is None:
            return np.asarray(Q[order[:MOST_GOALS]]), [names[k] for k in order[:MOST_GOALS]], None
        kept, approaches = self._with_lines(judge, Q[order], good[order], joints)
        return np.array([rows[0] for rows in approaches.rows]), [names[order[k]] for k in kept], approaches

    def _with_lines(
        self, judge: Judge, Q: Floats, good: Bools, joints: str | Iterable[str] | None
    ) -> tuple[list[int], Approaches]:
        """Find the first configurations that have a free approach and a free retreat.

        Raises
        ------
        PlanningError
            If there are no such configurations. The message counts the reasons.
        """
        kept, room = list[int](), MOST_GOALS
        approaches, reasons = Approaches(judge, [], []), dict[str, list[str]]()
        may_touch = judge.joint_error is None and len(judge.ready.ruled) > 0
        lines: list[tuple[str, Any, Judge]] = [
            ("approach", self.approach, judge), ("retreat", self.retreat, replace(judge, kept=None))
        ]  # fmt: skip
        for k, q in enumerate(Q):
            rows_by_name: dict[str, Floats] = {"approach": q[None], "retreat": q[None]}
            kind, why = ("", "") if good[k] or may_touch else ("in collision", "")
            for name, displacement, of in lines:
                if displacement is not None and not kind:
                    rows_by_name[name], kind, why = _along(of, q, self.link, joints, displacement, name == "approach")
                    kind = kind and f"{kind} the {name}"
            if kind:
                if kind == "in collision" and kind not in reasons:
                    why = "".join(f"{each.name_a} and {each.name_b}" for each in contacts(judge.ready, q)[0][:1])
                reasons.setdefault(kind, []).append(why)
                continue
            kept.append(k)
            approaches.rows.append(rows_by_name["approach"])
            approaches.retreats.append(None if self.retreat is None else rows_by_name["retreat"])
            room -= 1 if good[k] else TOUCHING
            if room <= 0:
                break
        if kept:
            return kept, approaches
        wanted = " and ".join(name for name, displacement, _ in lines if displacement is not None)
        told = ", ".join(f"{len(whys)} {kind}" + (f" ({whys[0]})" if whys[0] else "") for kind, whys in reasons.items())
        raise PlanningError(
            f"goal: expected a configuration with a free {wanted} of {self.link}, found {len(Q)} that reach the goal: "
            f"{told}"
        )


class Approaches(NamedTuple):
    """Straight lines at the ends of paths to the goals of a `PoseGoal`.

    Attributes
    ----------
    judge : Judge
        The judge that accepted the lines.
    rows : list of ndarray, shape (k, dof)
        For each goal, the approach, or a single configuration if there is no approach.
    retreats : list of ndarray, shape (k, dof), or None
        For each goal, the retreat.
    """

    judge: Judge
    rows: list[Floats]
    retreats: list[Floats | None]

    def joined(self, judge: Judge, path: Floats, goals: Floats) -> tuple[Floats, int | None, Floats | None]:
        """Append an approach to a path; also return the row at which it begins, and the retreat. Either may be None.

        Parameters
        ----------
        judge : Judge
        path : ndarray, shape (k, dof)
        goals : ndarray, shape (goals, dof)
            The goals. Values of joints without limits are shifted by whole turns towards the end of the path.

        Raises
        ------
        PlanningError
            If a line is not proven free after these shifts, which are rounded, in the state of the scene to which
            `judge` refers.
        """
        k = int(np.abs(goals - path[-1]).max(axis=1).argmin())
        approach, retreat = self.rows[k], self.retreats[k]
        if judge is not self.judge or (path[-1] != approach[0]).any():
            turns, judge = goals[k] - approach[0], replace(judge, kept=None)
            approach = np.concatenate([path[-1:], approach[1:] + turns])
            retreat = None if retreat is None else retreat + turns
            for name, rows in (("approach", approach), ("retreat", retreat)):
                if rows is not None and len(rows) > 1:
                    refuse_unfree(judge, rows, name)
        row = len(path) - 1 if len(approach) > 1 else None
        return np.concatenate([path, approach[1:]]), row, retreat


def _displacement(given: Any, name: str, sign: float) -> Displacement:
    """Check an approach or a retreat. A number, multiplied by `sign`, is a displacement along z."""
    frame = "link"
    if isinstance(given, tuple) and len(given) == 2 and isinstance(given[0], str):
        frame, given = _validate.choice(given[0], f"{name}, frame", FRAMES), given[1]
    elif isinstance(given, int | float | np.number):
        given = [0.0, 0.0, sign * _validate.positive_scalar(given, name)]
    vector = _validate.finite_array(given, name, (3,))
    if not vector.any():
        raise InputError(f"{name}: expected a displacement other than 0, found {_validate.short(given)}")
    return frame, vector.copy()


def _along(
    judge: Judge, q: Floats, link: str, joints: Any, given: Displacement, to_goal: bool
) -> tuple[Floats, str, str]:
    """Follow a displacement that ends or begins at a configuration.

    Returns
    -------
    ndarray, shape (k, dof)
        In the order of the motion.
    str, str
        A heading for the message, and the reason, if the motion is not free.
    """
    robot, (frame, vector) = judge.checker.robot, given
    T = robot.forward_kinematics(q)[robot.link_names.index(link)].copy()
    way = vector if frame == "world" else image(T[:3, :3], vector)
    T[:3, 3] += -way if to_goal else way
    u, Q, fault = followed(robot, chain_to(robot, link, joints), q, Line(link), T)
    if fault is not None:
        return Q, "unable to follow", fault[1].removeprefix("that ")
    if to_goal:
        u, Q = 1.0 - u[::-1], Q[::-1].copy()
    outer = Q[:1] if to_goal else Q[-1:]
    if len(judge.ready.ruled) and not free(judge.ready, outer.copy())[0]:
        return Q, "blocked on", f"contact where the line {'begins' if to_goal else 'ends'}"
    block = block_of(judge, u, Q)
    return Q, "blocked on" if block else "", block
