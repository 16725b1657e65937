"""Define `plan`, `plan_full` and `shorten`, which use the compiled planner or a named planner of OMPL."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Literal, TypedDict, Unpack, overload

from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._read_only import protected
from loewner._base._validate import Floats
from loewner.errors import ConvergenceError, InputError, PlanningError
from loewner.planners import bases, compiled, improving, in_time
from loewner.planners.clearing import Clearing
from loewner.planners.departures import Departures
from loewner.planners.drives import Drive
from loewner.planners.improving import Improve, Improvement, Plan
from loewner.planners.judge import TOLERANCE, Judge, checked_checker, refuse_unfree
from loewner.planners.kept_axes import KeptAxis, parts_of
from loewner.planners.pose_goals import PoseGoal
from loewner.planners.searches import UNLIMITED, Search, checked_search, checked_seed
from loewner.planners.space import Space, Task
from loewner.planners.trajectories import Trajectory
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checking.edges import checked_path
from loewner.robots.description.robot import chain_to
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.proof_models import model_of
from loewner.robots.proofs.written_proofs import proof_of

# An axis to keep: the link, the axis, the direction and the angle [rad].
Keep = tuple[str, str | ArrayLike, ArrayLike, float]

# Options of `plan` that select another function.
TIMED, DRIVING = {"start_time", "velocity", "arrive_by"}, {"base", "radius"}


class OfSearch(TypedDict, total=False):
    """The fields of `Search` as options of `plan`."""

    planner: str | Callable[[Any], Any] | None
    certified: bool
    resolution: float
    max_iterations: int | None
    timeout: float
    simplify: bool


class OfImprove(TypedDict, total=False):
    """The fields of `Improve` as options of `plan`."""

    improve_for: float | None
    improve_iterations: int | None
    weights: ArrayLike | None
    clearance: float | None


class OfAll(OfSearch, total=False):
    """Options of `plan` for paths, trajectories and drives."""

    joint_error: ArrayLike
    search: Search | None
    seed: int


class OfPaths(OfAll, OfImprove, total=False):
    """Options of `plan` for paths."""

    joints: str | Iterable[str] | None
    keep: Keep | None
    proof: bool


class Others(OfSearch, OfImprove, total=False):
    """All other options of `plan`: the fields of `Search` and `Improve`, and options that select another function."""

    full: bool
    proof: bool
    start_time: float | None
    velocity: ArrayLike | None
    arrive_by: float | None
    base: bases.Kind | None
    radius: float | None
    reverse: bool


@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike | PoseGoal, *, full: Literal[False] = ...,
    **options: Unpack[OfPaths],
) -> Floats: ...  # fmt: skip
@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike | PoseGoal, *, full: Literal[True],
    **options: Unpack[OfPaths],
) -> Plan: ...  # fmt: skip
@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike | PoseGoal, *, start_time: float,
    velocity: ArrayLike | None = ..., arrive_by: float | None = ..., joints: str | Iterable[str] | None = ...,
    **options: Unpack[OfAll],
) -> Trajectory: ...  # fmt: skip
@overload
def plan(
    checker: CollisionChecker, start: ArrayLike, goal: ArrayLike, *, base: bases.Kind, radius: float | None = ...,
    reverse: bool = ..., proof: bool = ..., **options: Unpack[OfAll],
) -> Drive: ...  # fmt: skip
@guarded
def plan(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike | PoseGoal,
    *,
    joints: str | Iterable[str] | None = None,
    keep: Keep | None = None,
    joint_error: ArrayLike = 0.0,
    search: Search | None = None,
    seed: int = 0,
    **others: Unpack[Others],
) -> Floats | Plan | Trajectory | Drive:
    """Plan a path from start to goal, and prove that all motions of the path are free of collisions.

    Parameters
    ----------
    checker : CollisionChecker
        Bodies that are attached in the checker's scene move with the robot.
    start : array_like, shape (dof,)
    goal : array_like, shape (dof,) or (goals, dof), or PoseGoal
        One goal or several, or poses of a link. The path leads to any one of them. Goals that are obviously unreachable
        (outside the limits, or colliding) are ignored, as long as one goal remains.
    joints : str or iterable of str, optional
        A group, or names of joints. These joints move; all remaining joints keep the values of `start`. Default: all
        joints.
    keep : (link, axis, direction, angle), optional
        An axis of the link ("x", "y", "z" or a vector) must stay within an angle [rad] of a direction in the world, for
        example to avoid spilling a cup. The angle is proven for every motion of the path; joint errors are not taken
        into account. Only the compiled planner supports this option.
    joint_error : float or array_like, shape (dof,)
        Radians or metres by which each value may deviate from the path. Every motion is proven for all such deviations,
        including deviations of joints that do not move. With a joint error, the path must not begin or end in contact.
    search : Search, optional
        The planner, its limits, and whether it proves its motions. Default: ``Search()``.
    seed : int
        Equal seeds lead to equal paths, unless the timeout ends the search. With an OMPL planner, this argument sets
        OMPL's seed, which applies to the whole process. The seed has no effect on drives, whose search is not random.
    planner, certified, resolution, max_iterations, timeout, simplify : optional
        Single fields of `search`, which replace the values in `search`.
    full, proof, improve_for, improve_iterations, weights, clearance : optional
        Improve the path as `plan_full` does; ``improve_for`` and ``improve_iterations`` are the `seconds` and the
        `iterations` of `Improve`. With ``full=True``, the result is a `Plan`.
    start_time, velocity, arrive_by : optional
        Plan among moving bodies, as `plan_in_time` does.
    base, radius, reverse : optional
        Plan for a mobile base, as `plan_drive` does.

    Returns
    -------
    ndarray, shape (k, dof)
        Configurations from `start` to a goal. Each joint value changes linearly from one configuration to the next. A
        joint that turns without limits takes the shorter direction, and may end at a value that differs from the goal's
        value by whole turns (but not with OMPL's planners). If a `PoseGoal` has an approach, the path ends with the
        approach.
    Plan, Trajectory or Drive
        The result of `plan_full` with ``full=True``, of `plan_in_time` with `start_time`, or of `plan_drive` with
        `base`.

    Raises
    ------
    PlanningError
        If a pose cannot be reached, or has no free approach or retreat. If the start or all goals are outside the
        limits, collide, do not keep the axis, or are not proven free within the joint error. If no short motion along
        the contact normal ends a contact at the start, or begins a contact at the goal. If no path was found within the
        iterations or in time, or if OMPL's path fails the final check. The message gives the reason with numbers: for
        example, how close to the pose the link came, which joints are at fault, which pairs collide and how deeply, the
        largest error that is proven, or the motion that fails. If the search failed, the message states how far it got,
        and which pairs prevent motions between the trees.
    InputError
        If an argument has the wrong shape or value, or options exclude each other. If a goal moves a joint that is not
        among `joints`. If one of `joints` is a planar, floating or ball joint, because such a joint has no limits for a
        search.
    UnknownNameError
        If a group, a joint or the planner is unknown.
    MissingExtraError
        If an OMPL planner is requested but OMPL is not installed.

    See Also
    --------
    plan_full : Improves the path. plan_in_time : Plans among moving bodies. plan_drive : Plans for mobile bases.
    roadmap : For many queries in one scene. trajectory : Assigns times to the path.

    Notes
    -----
    If `Scene.leave` allows a contact at the start, the first motion moves one of the touching bodies straight away from
    the other one, along the contact normal. If `Scene.reach` allows a contact at the goal, the last motion moves one
    body straight towards the other one.

    The compiled planner is the balanced RRT-Connect of Kuffner and LaValle (ICRA 2000) with the dynamic domain of
    Yershova et al. (ICRA 2005). No motion of a tree is longer than a twelfth of the diagonal of the box that the limits
    form.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> path = plan(CollisionChecker(Robot.from_urdf("arm.urdf")), [0.0, 0.0], [2.0, 0.0], joints="rail")
    >>> path
    array([[0., 0.],
           [2., 0.]])
    """
    for name in others.keys() - Others.__optional_keys__:
        raise TypeError(f"plan() got an unexpected keyword argument {name!r}")
    options: dict[str, Any] = {name: value for name, value in others.items() if value is not None}
    of_search: Any = {name: value for name, value in others.items() if name in OfSearch.__optional_keys__}
    of_path = [name for name in options if name in OfImprove.__optional_keys__]
    search = replace(checked_search(search), **of_search)
    full, proof = (_validate.flag(others.get(name, False), name) for name in ("full", "proof"))
    reverse = _validate.flag(others.get("reverse", True), "reverse")
    seed, task = checked_seed(seed), Task.of(checker, start, goal, joints)
    arguments: Any = {"start": task.start, "goal": task.goal, "joint_error": joint_error, "search": search}
    timed, driving = options.keys() & TIMED, options.keys() & DRIVING or not reverse
    refused = ["full=True"] * full + ["keep"] * (keep is not None) + of_path
    if timed:
        if proof:
            raise InputError(
                "proof: expected none with start_time=, arrive_by= or velocity=, since plans in time have no written "
                "proofs yet; each motion is proven in any case, and certify_trajectory proves the trajectory again"
            )
        if "start_time" not in timed:
            raise InputError("start_time: expected it with velocity or arrive_by, found none")
        search._refuse("start_time", refused + ["base"] * bool(driving))
        arguments |= {name: options[name] for name in timed}
        return in_time.plan_in_time(checker, joints=task.joints, seed=seed, **arguments)
    if driving:
        if "base" not in options:
            raise InputError("base: expected it with radius or reverse, found none")
        search._refuse("base", refused + ["joints"] * (joints is not None))
        arguments |= {"base": options["base"], "radius": options.get("radius"), "reverse": reverse, "proof": proof}
        return bases.plan_drive(checker, **arguments)  # the seed has no effect, since the search is not random
    if proof and not full:
        raise InputError("proof=True needs full=True: the proof is an attribute of the Plan")
    improve = None
    if full or of_path:
        rounds = {"improve_for": "seconds", "improve_iterations": "iterations"}
        improve = Improve(**{rounds.get(name, name): options[name] for name in of_path})
        if of_path == ["weights"] and not full:
            raise InputError("weights: expected improve_for, improve_iterations or full=True with them")
    path_or_plan: Floats | Plan = _planned(task, keep, joint_error, search, seed, improve, full, proof)
    return path_or_plan


@guarded
def plan_full(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike | PoseGoal,
    improve: Improve | None = None,
    *,
    joints: str | Iterable[str] | None = None,
    keep: Keep | None = None,
    joint_error: ArrayLike = 0.0,
    search: Search | None = None,
    seed: int = 0,
    proof: bool = False,
) -> Plan:
    """Plan a path and improve it, if requested. Return the path with its cost, a lower bound on costs, and a proof.

    Parameters
    ----------
    checker, start, goal, joints, keep, joint_error, search
        As for `plan`.
    improve : Improve, optional
        The time for improving the path, and the cost of motions. Default: do not improve the path.
    seed : int
        Equal seeds and iterations lead to equal paths, unless the time runs out first.
    proof : bool
        Also write a `Proof` of the path, as `CollisionChecker.certify_edges` does.

    Returns
    -------
    Plan
        The path as `plan` returns it, with its cost, and the approach and the retreat of a `PoseGoal`.

    Raises
    ------
    PlanningError, UnknownNameError, MissingExtraError
        As for `plan`.
    InputError
        As for `plan`, and as for `certify_edges` if a proof is requested.
    ConvergenceError
        As for `certify_edges`, if a proof is requested. The attribute `partial` of the error is the plan without a
        proof.

    Notes
    -----
    Each round of improvement searches among the configurations through which a cheaper path may lead (Gammell et al.,
    IROS 2014). Next, the new path and the best path are polished: corners are cut or moved, and single joints are
    straightened. With a clearance, the cost of a motion is its weighted length times the mean of 1 + 9 (1 - d /
    clearance)² along the motion. Here, d is the robot's distance from the nearest unattached body of the scene, or the
    clearance if that is smaller.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> from loewner.planners import Improve
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> found = plan_full(checker, [0.0, 0.0], [2.0, 0.0], Improve(iterations=20), joints="rail", proof=True)
    >>> found.cost, found.gap < 1e-12, len(found.proof.motions)
    (2.0, True, 1)
    """
    proof, search = _validate.flag(proof, "proof"), checked_search(search)
    better = _validate.instance(Improve() if improve is None else improve, "improve", Improve, "planners")
    seed, task = checked_seed(seed), Task.of(checker, start, goal, joints)
    full_plan: Plan = _planned(task, keep, joint_error, search, seed, better, True, proof)
    return full_plan


def _planned(
    task: Task, keep: Keep | None, joint_error: ArrayLike, search: Search, seed: int, improve: Improve | None,
    full: bool, proof: bool,
) -> Any:  # fmt: skip
    """Plan a path, and improve it as requested. Return a `Plan` if `full` is set."""
    checker, robot, q = task.checker, task.checker.robot, task.start
    if proof and not search.certified:
        raise InputError("proof=True needs certified=True: sampled motions have no proof")
    better = None if improve is None else Improvement.of(robot, improve, search, seed)
    kept = None if keep is None else _kept(keep, robot, task.joints, search.planner is None)
    judge = Judge.of(checker, search._step, joint_error, kept)
    begins, names, approaches = task.goals(judge)
    space = Space.of_start(checker, task.joints, q, begins)
    model = model_of(judge.ready) if proof else None
    ends = Departures.of(space, judge, q, begins)
    q, goals = ends.free_start, space.checked_goals(ends.free_start, ends.free_goals, judge, names)
    if kept is not None:
        goals = kept.checked(robot, q, goals)
    free_path, rounds, clearing = compiled.find_path(space, judge, q, goals, search, seed), 0, None
    if better is not None and search.planner is None:
        clearing = Clearing.of(judge, better.weights, better.clearance) if better.clearance else None
        free_path, rounds = improving.improved(space, judge, free_path, goals, better, clearing)
    path = ends.joined(free_path)
    follows: dict[str, Any] = {}
    if approaches is not None:
        path, row, retreat = approaches.joined(judge, path, space.unwound(path[-1], begins))
        follows = {"approach": row, "retreat": retreat}
    if kept is not None and not kept.on(path[:-1], path[1:]).all():
        raise PlanningError("path: expected motions into and out of contact that keep the axis, found others")
    if better is None or not full:
        return path
    full_plan = better.plan(path, ends, goals, rounds, isinstance(task.goal, PoseGoal), clearing)
    full_plan = protected(replace(full_plan, **follows))
    if model is None:
        return full_plan
    try:
        moves = straight(robot, path[:-1], path[1:])
        deeper = TOLERANCE if judge.joint_error is None else None
        return replace(full_plan, proof=proof_of(model, judge.ready, moves, judge.errors, deeper))
    except ConvergenceError as error:
        raise ConvergenceError(str(error), partial=full_plan) from None


def _kept(keep: Any, robot: Robot, joints: str | Iterable[str] | None, compiled: bool) -> KeptAxis:
    """Check the argument `keep`."""
    link, *axis = parts_of(keep, "(link, axis, direction, angle)")
    if not compiled:
        raise InputError("keep: expected the compiled planner with it, found one of OMPL's planners")
    return KeptAxis.of(*axis).along(chain_to(robot, link, joints), link)


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
    """Shorten a path: remove or cut off corners if the resulting straight motions are free.

    Parameters
    ----------
    checker : CollisionChecker
    path : array_like, shape (k, dof)
        Two or more configurations. Between successive configurations, joint values change linearly and orientations
        follow the shorter arc.
    certified, joint_error, resolution
        As for `plan`; `resolution` is in the units of the joints.
    max_iterations : int
        Number of cuts to try, each between two random points.
    seed : int
        Equal seeds lead to equal paths.

    Returns
    -------
    ndarray, shape (m, dof)
        A path with the same ends.

    Raises
    ------
    PlanningError
        If a motion of the path is not free. The message names the motion and the pair that collides.
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
    search, seed = Search(certified=certified, resolution=resolution), checked_seed(seed)
    max_iterations = _validate.whole_number(max_iterations, "max_iterations", 0, UNLIMITED)
    rows = checked_path(checked_checker(checker).robot, path)
    judge = Judge.of(checker, search._step, joint_error)
    refuse_unfree(judge, rows, "path")
    return compiled.shortened(judge, rows, max_iterations=max_iterations, seed=seed)
