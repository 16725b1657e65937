"""Define `plan` and `shorten`, which use the compiled planner, or one of OMPL's planners if it is named."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Literal, TypedDict, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats
from loewner.errors import ConvergenceError, InputError, PlanningError
from loewner.planners import bases, compiled, improving, ompl_planners
from loewner.planners.departures import Departures
from loewner.planners.drives import Drive
from loewner.planners.in_time import Times, plan_in_time
from loewner.planners.judge import TOLERANCE, Judge, checked_checker, refuse_unfree
from loewner.planners.kept_axes import KeptAxis
from loewner.planners.pose_goals import PoseGoal, joints_of
from loewner.planners.space import Space, checked_ends
from loewner.planners.trajectories import Trajectory
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checking.edges import checked_path
from loewner.robots.description.robot import chain_to
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.proof_models import model_of
from loewner.robots.proofs.written_proofs import proof_of


class Common(TypedDict, total=False):
    """Options of `plan` for paths and for trajectories."""

    joints: str | Iterable[str] | None
    joint_error: ArrayLike
    max_iterations: int | None
    timeout: float
    simplify: bool
    seed: int


class OfPaths(improving.Options, total=False):
    """Options of `plan` for paths that few calls name."""

    keep: tuple[str, str | ArrayLike, ArrayLike, float] | None
    proof: bool


class Options(OfPaths, Common, total=False):
    """All options of `plan` for paths except `full`."""

    planner: str | Callable[[Any], Any] | None
    certified: bool
    resolution: float


class Rare(OfPaths, Times, bases.Options, total=False):
    """Options of `plan` that few calls name."""


@overload
def plan(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike | PoseGoal,
    *,
    full: Literal[False] = ...,
    **options: Unpack[Options],
) -> Floats: ...
@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike | PoseGoal, *, full: Literal[True],
    **options: Unpack[Options],
) -> improving.Plan: ...  # fmt: skip
@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike | PoseGoal, *, start_time: float,
    velocity: ArrayLike | None = ..., arrive_by: float | None = ..., **options: Unpack[Common],
) -> Trajectory: ...  # fmt: skip
@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike, *, base: bases.Kind, radius: float | None = ...,
    reverse: bool = ..., proof: bool = ..., **options: Unpack[Common],
) -> Drive: ...  # fmt: skip
@guarded
def plan(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike | PoseGoal,
    *,
    joints: str | Iterable[str] | None = None,
    planner: str | Callable[[Any], Any] | None = None,
    certified: bool = True,
    joint_error: ArrayLike = 0.0,
    resolution: float = 0.05,
    max_iterations: int | None = None,
    timeout: float = 10.0,
    simplify: bool = True,
    seed: int = 0,
    full: bool = False,
    **rare: Unpack[Rare],
) -> Floats | improving.Plan | Trajectory | Drive:
    """Find a path from start to goal that is proven free of collisions everywhere, or a trajectory in time.

    Parameters
    ----------
    checker : CollisionChecker
        Bodies attached in its scene move with the robot.
    start : array_like, shape (dof,)
    goal : array_like, shape (dof,) or (goals, dof), or PoseGoal
        One goal or several, or poses of a link; reaching any of them is enough. Goals that are obviously unreachable
        (outside the limits, or colliding) are ignored, as long as one remains.
    joints : str or iterable of str, optional
        A group, or names of joints. These joints move; all remaining joints keep the values of `start`. Default: all.
    keep : (link, axis, direction, angle), optional
        An axis of the link ("x", "y", "z" or a vector) must stay within an angle [rad] of a direction of the world, as
        of a cup that must not be spilt. This is proven for every motion of the path itself, without joint errors. Only
        the compiled planner can do it.
    planner : str or callable, optional
        Default: the compiled RRT-Connect. Otherwise the name of a class of ``ompl.geometric``, such as "BITstar" or
        "PRM"; or a function that takes the ``SpaceInformation`` and returns an OMPL planner that you have set up.
    certified : bool
        Prove every motion free with `CollisionChecker.certify_edges`; otherwise sample motions in steps.
    joint_error : float or array_like, shape (dof,)
        Radians or metres by which each value may deviate from the path: every motion is proven for all such deviations,
        also of the joints that do not move. With a joint error, contact at the ends is not allowed.
    resolution : float
        For motions that are not proven, the largest Euclidean distance between two successive checked configurations,
        in the units of the joints. OMPL planners that divide motions themselves always use it.
    max_iterations : int, optional
        Number of random configurations that the compiled planner draws before it gives up. Default: no limit, so that
        only the timeout ends the search.
    timeout : float
        Time limit of the search, in seconds; simplifying takes additional time. OMPL planners that seek a shortest path
        always use the whole time.
    simplify : bool
        Shorten the path. Paths of OMPL planners are also smoothed, by OMPL's path simplifier.
    seed : int
        Equal seeds give equal paths, unless the timeout ends the search. With an OMPL planner, this sets OMPL's seed,
        which applies to the whole process.
    full : bool
        Return a `Plan`, which contains the path, its cost and a lower bound on the cost.
    proof : bool, optional
        With `full`: also write a `Proof` of the path, as `CollisionChecker.certify_edges` does. Default: False.
    improve_for : float, optional
        Improve the path until this number of seconds has passed since the call began; the first path is returned in any
        case. Default: do not improve it, unless `improve_iterations` is given.
    improve_iterations : int, optional
        Limit on the number of rounds of improvement; equal numbers and seeds give equal paths, unless the time is over
        before. Without `improve_for`, the time is `timeout`.
    weights : array_like, shape (dof,), optional
        Factors of the joint values in the cost, which improvement lowers: the cost of a motion is the Euclidean norm of
        the weighted changes. They make metres and radians comparable; a joint with a large weight moves little.
        Default: one for each value.
    clearance : float, optional
        Distance [m] that the path should keep from the bodies of the scene where it can, without being forced to. With
        `improve_for` or `improve_iterations`: nearer to them a motion costs up to ten times its length, and half of the
        rounds move the path away from them. For a distance that must be kept everywhere, use `Scene.margin`.
    start_time : float, optional
        Plan in time, from this number of seconds on; required if bodies of the scene follow motions (`Scene.follow`).
        With it, only `joints`, `joint_error`, `max_iterations`, `timeout`, `simplify` and `seed` may be given as well.
    velocity : float or array_like, shape (dof,), optional
        In time, the largest velocity of each value [rad/s or m/s]. Default: the URDF's limits (`Robot.velocity`).
    arrive_by : float, optional
        In time, the latest arrival [s], on the same clock as `start_time`. Default, and at most: four times as long as
        the joints need to cross their ranges, after the end of all motions; of motions that repeat, two periods count.
    base : {"differential", "car"}, optional
        Plan for a mobile base that cannot drive sideways, on the joints x, y and theta of `Robot.footprint` or
        `Robot.add_base`; at theta = 0, forwards is along x. The point that drives is the origin of the base: put it
        midway between the driven wheels of a differential base, and in the middle of the rear axle of a car. Nothing
        else moves, so the goal has the start's values of all other joints. With it, only `radius`, `reverse`,
        `joint_error`, `max_iterations` (poses from which the search goes on), `timeout`, `simplify`, `seed` (which
        changes nothing) and `proof` may be given as well.
    radius : float, optional
        Least radius of a car's turns [m]; required for a car.
    reverse : bool, optional
        Whether the base may drive backwards. Default: True. Without it, a car's arcs may turn by more than half a turn.

    Returns
    -------
    ndarray, shape (k, dof), or Plan
        Configurations from `start` to a goal; each joint value changes linearly from one configuration to the next. A
        joint that turns without limits takes the shorter way around, so it ends at the goal's value or whole turns from
        it (with OMPL's planners, always at the goal's value). It ends with the approach of a `PoseGoal`.
    Trajectory
        If `start_time` is given. Between its times the robot moves straight at a constant rate, or waits. Its times
        count from its own `start_time`, at which ``checker.certify_trajectory(found)`` proves it FREE. Every velocity
        is at most its limit, up to two units of rounding.
    Drive
        If `base` is given: arcs, straight lines and turns in place, as a whole proven FREE. It ends at the goal, or
        whole turns from it.

    Raises
    ------
    PlanningError
        If a pose cannot be reached (the message states how near the link came), or has no free approach or retreat (the
        message counts the reasons); if the start or all goals are outside
        the limits or collide (the message names joints, or pairs and depths), or
        do not keep the axis, or
        are not proven free within the joint error (the message states the largest error that is proven); if no short
        motion along the contact normal ends a contact at the start, or begins a contact at the goal; if no path was
        found within the iterations or in time (the message reports how far the search got, and which pairs prevent the
        motions between the trees); or if OMPL's path fails the
        final check (the message names the motion). In time also if the start collides at the start time (the message
        names pairs and depths), or no goal can be reached by the latest arrival within the velocities.
    InputError
        If an argument has the wrong shape or value, a goal moves a joint that is not among `joints`, or one of `joints`
        is a planar, floating or ball joint, which has no limits to search within; or as for `certify_edges` if a proof
        is requested.
    ConvergenceError
        As for `certify_edges`, if a proof is requested. The plan without it is the error's `partial`.
    UnknownNameError
        If there is no such group, joint or planner.
    MissingExtraError
        If one of OMPL's planners is requested and OMPL is not installed.

    See Also
    --------
    roadmap : For many queries in one scene. trajectory : Assigns times to the path. time_path : Assigns times among
        bodies that move, which a drive can follow.

    Notes
    -----
    If `Scene.leave` allows a contact at the start, the first motion moves the touching body straight away from the
    other body, along the contact normal. If `Scene.reach` allows a contact at the goal, the last motion moves the body
    straight towards the other body.

    The compiled planner is the balanced RRT-Connect of Kuffner and LaValle (ICRA 2000) with the dynamic domain of
    Yershova et al. (ICRA 2005). A motion of a tree is at most as long as a twelfth of the diagonal of the limits.

    Each round of improvement searches the configurations through which a cheaper path may lead (Gammell et al., IROS
    2014), and polishes the new path and the best one: corners are cut or moved, and single joints are straightened.
    With a clearance, the cost of a motion is its weighted length times the mean of 1 + 9 (1 - d / clearance)² along it,
    with the distance d of the robot from the scene's bodies that are not attached to it, where this is less than the
    clearance.

    In time, the direct motion is tried first, and then the path through the scene without the moving bodies, at several
    starts and speeds. If none of them is proven, two trees grow, forward in time from the start and backward from the
    goals at several times of arrival (Grothe et al., "ST-RRT*", ICRA 2022). The result is shortened, but need not
    arrive as early as possible. Contact that `Scene.leave` or `Scene.reach` would permit counts as a collision.

    For a base, A* searches a lattice of arcs, lines and turns in place (hybrid A*: Dolgov et al., IJRR 2010) until one
    of its poses is connected to the goal by a way of Reeds and Shepp, of Dubins if the base may not reverse, or by a
    turn, a line and a turn. Then such ways replace parts of the path where they are shorter. Contact that `Scene.leave`
    or `Scene.reach` would permit counts as a collision.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> path = plan(CollisionChecker(Robot.from_urdf("arm.urdf")), [0.0, 0.0], [2.0, 0.0], joints="rail")
    >>> path
    array([[0., 0.],
           [2., 0.]])
    >>> plan(CollisionChecker(Robot.from_urdf("arm.urdf")), [0.0, 0.0], [2.0, 0.0], start_time=5.0, velocity=0.5)
    Trajectory(4 s, 2 joints, 1 motion)
    """
    resolution = _validate.positive_scalar(resolution, "resolution")
    timeout = _validate.positive_scalar(timeout, "timeout")
    most = compiled.UNLIMITED if max_iterations is None else max_iterations
    max_iterations = _validate.whole_number(most, "max_iterations", 1, compiled.UNLIMITED)
    seed, simplify = _validate.whole_number(seed, "seed", 0, 2**32 - 2), _validate.flag(simplify, "simplify")
    step = 0.0 if _validate.flag(certified, "certified") else resolution
    make = None if planner is None else ompl_planners.named(planner)
    full, robot = _validate.flag(full, "full"), checked_checker(checker).robot
    times: Any = {name: rare.pop(name) for name in Times.__optional_keys__ if name in rare}  # type: ignore[misc]
    timed = any(value is not None for value in times.values())
    of_base: Any = {
        name: rare.pop(name)  # type: ignore[misc]
        for name in bases.Options.__optional_keys__
        if name in rare
    }
    driving = of_base.get("base") is not None
    better, keep = None, rare.pop("keep", None)
    proof = _validate.flag(rare.pop("proof", False), "proof")
    if proof and timed:
        raise InputError(
            "proof: plans in time have no proofs yet, and start_time=, arrive_by= or velocity= makes one; leave out "
            "proof=, and each motion is proven all the same; certify_trajectory proves the trajectory again"
        )
    if proof and not full and not driving:
        raise InputError("proof=True needs full=True: the proof is an attribute of the Plan")
    if proof and step:
        raise InputError("proof=True needs certified=True: sampled motions have no proof")
    if rare or full:
        better = improving.Improvement.of(robot, rare, full, make is None, timeout)
    given = {"planner": make is not None, "certified=False": step > 0, "full=True": full, "keep": keep is not None}
    others = [*(name for name, is_given in given.items() if is_given), *rare]
    if timed:
        _expect_in_time(times, others + ["base"] * driving)
    reverse = _validate.flag(of_base.get("reverse", True), "reverse")
    if driving or of_base.get("radius") is not None or not reverse:
        _expect_of_base(driving, others + ["joints"] * (joints is not None))
        return bases.plan_base(
            checker, start, goal, of_base, joint_error=joint_error, max_iterations=max_iterations, timeout=timeout,
            simplify=simplify, proof=proof,
        )  # fmt: skip
    posed = isinstance(goal, PoseGoal)
    if joints is None and isinstance(goal, PoseGoal):
        joints = joints_of(goal, robot)  # fingers that hold something keep their places
    if timed:
        return plan_in_time(
            checker, start, goal, times, joints=joints, joint_error=joint_error, max_iterations=max_iterations,
            timeout=timeout, simplify=simplify, seed=seed,
        )  # fmt: skip
    kept = None if keep is None else _kept(keep, robot, joints, make is None)
    judge = Judge.of(checker, step, joint_error, kept)
    q, goals, names, approaches = checked_ends(checker, start, goal, joints, judge)
    space, begins = Space.of_start(checker, joints, q, goals), goals
    model = model_of(judge.ready) if proof else None
    ends = Departures.of(space, judge, q, goals)
    q, goals = ends.free_start, space.checked_goals(ends.free_start, ends.free_goals, judge, names)
    if kept is not None:
        goals = kept.checked(robot, q, goals)
    rounds, clearing = 0, None
    if make is not None:
        found = ompl_planners.search(space, make, q, goals, timeout, resolution, judge, simplify, seed)
    else:
        found = compiled.connect(space, judge, q, goals, max_iterations=max_iterations, timeout=timeout, seed=seed)
        if simplify:
            found = compiled.shortened(judge, found, max_iterations=compiled.CUTS, seed=seed)
        if better is not None:
            clearing = better.clearing(judge)
            found, rounds = improving.improved(space, judge, found, goals, better, seed, clearing)
    path = ends.joined(found)
    follows: dict[str, Any] = {}
    if approaches is not None:
        path, row, retreat = approaches.joined(judge, path, space.unwound(path[-1], begins))
        if retreat is not None:
            retreat.flags.writeable = False
        follows = {"approach": row, "retreat": retreat}
    if kept is not None and not kept.on(path[:-1], path[1:]).all():
        raise PlanningError("path: expected motions into and out of contact that keep the axis, found others")
    if better is None or not full:
        return path
    made = replace(better.plan(path, ends, goals, rounds, posed, clearing), **follows)
    if model is None:
        return made
    off = np.zeros(robot.dof) if judge.joint_error is None else judge.joint_error
    try:
        moves = straight(robot, path[:-1], path[1:])
        deeper = None if off.any() else TOLERANCE
        return replace(made, proof=proof_of(model, judge.ready, moves, off, deeper))
    except ConvergenceError as error:
        raise ConvergenceError(str(error), partial=made) from None


def _expect_in_time(times: Times, others: list[str]) -> None:
    """Check that the start time is given, and no arguments of paths."""
    if times.get("start_time") is None:
        raise InputError("start_time: expected it with velocity or arrive_by, found none")
    if others:
        raise InputError(
            f"start_time: expected no {' or '.join(others)} with it; plans in time are proven and shortened, by a "
            "search of their own"
        )


def _expect_of_base(driving: bool, others: list[str]) -> None:
    """Check that a base is given, and no arguments of other plans."""
    if not driving:
        raise InputError("base: expected it with radius or reverse, found none")
    if others:
        raise InputError(
            f"base: expected no {' or '.join(others)} with it; drives are proven, by a search of their own"
        )


def _kept(keep: Any, robot: Robot, joints: str | Iterable[str] | None, compiled: bool) -> KeptAxis:
    """Check the argument `keep`."""
    listed = _validate.listed(keep, "keep", wanted="(link, axis, direction, angle)")
    if len(listed) != 4:
        raise InputError(f"keep: expected (link, axis, direction, angle), found {_validate.short(keep)}")
    if not compiled:
        raise InputError("keep: expected the compiled planner with it, found one of OMPL's planners")
    return KeptAxis.of(*listed[1:]).along(chain_to(robot, listed[0], joints), listed[0])


@guarded
def shorten(
    checker: CollisionChecker,
    path: ArrayLike,
    *,
    certified: bool = True,
    joint_error: ArrayLike = 0.0,
    resolution: float = 0.05,
    max_iterations: int = compiled.CUTS,
    seed: int = 0,
) -> Floats:
    """Shorten a path by removing corners, or cutting them off, wherever the straight motion is free.

    Parameters
    ----------
    checker : CollisionChecker
    path : array_like, shape (k, dof)
        Two or more configurations. Between successive configurations, joint values change linearly and orientations
        follow the shorter arc.
    certified, joint_error, resolution
        As for `plan`; `resolution` is in the units of the joints.
    max_iterations : int
        Number of cuts to try, each between two points drawn at random.
    seed : int
        Equal seeds give equal paths.

    Returns
    -------
    ndarray, shape (m, dof)
        A path with the same ends.

    Raises
    ------
    PlanningError
        If a motion of the path is not free; the message names the motion and the pair that collides.
    InputError
        If an argument has the wrong shape or value.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> shorten(checker, [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])
    array([[0., 0.],
           [2., 0.]])
    """
    resolution = _validate.positive_scalar(resolution, "resolution")
    step = 0.0 if _validate.flag(certified, "certified") else resolution
    max_iterations = _validate.whole_number(max_iterations, "max_iterations", 0, compiled.UNLIMITED)
    seed = _validate.whole_number(seed, "seed", 0, 2**32 - 2)
    rows = checked_path(checked_checker(checker).robot, path)
    judge = Judge.of(checker, step, joint_error)
    refuse_unfree(judge, rows, "path")
    return compiled.shortened(judge, rows, max_iterations=max_iterations, seed=seed)
