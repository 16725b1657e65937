"""Plan among moving bodies: search in space and time, and prove motions at the times at which they happen.

A state is a configuration followed by a time [s], which counts from the start of the plan. The direct motion is tried
first. Next, a path that is planned without the moving bodies is tried with several starting times and speeds. Finally,
two trees grow: one forward in time from the start, and one backward from the goals. Motions are proven in batches,
since the overhead of a call takes as long as the proofs of ten motions.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._read_only import protected
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import codes
from loewner.errors import InputError, PlanningError
from loewner.planners import compiled
from loewner.planners.joint_limits import limits_of
from loewner.planners.judge import TOLERANCE, Judge
from loewner.planners.pose_goals import PoseGoal
from loewner.planners.searches import Search, checked_search, checked_seed
from loewner.planners.space import Space, Task, touching
from loewner.planners.straights import BLEND_ROUNDINGS
from loewner.planners.trajectories import Trajectory, expect_straight
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checker import prepared_of, without_motions
from loewner.robots.checking import verdicts
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs import in_time, motions
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.curves import joint_errors
from loewner.robots.proofs.proofs import ProofOptions, refuse_starts

# Share of each velocity limit that is reserved for rounding errors of times.
SLACK = 1e-9

# The default horizon is CROSSINGS times the time to cross all ranges, after PERIODS periods of motions that repeat.
CROSSINGS, PERIODS = 4.0, 2.0

# Longest allowed time to cross all ranges [s], more than thirty years. A longer time must be due to a wrong unit.
SLOWEST = 1e9

# Largest allowed spacing of floating-point times near the start, as a share of the time to cross all ranges.
COARSEST = 1e-6

# Largest number of changes in a body's repeated motion during a plan. Each change divides the robot's motions.
MOST_KNOTS = 2**14

# For the path through the static scene: the number of later starts that are tried within the horizon, and the longer
# durations that are tried, in multiples of the shortest duration.
STARTS, SLOWER = 12, (1.5, 2.0, 3.0)

# Numbers per round: sampled configurations, motions of a branch towards a sample, and new times of arrival.
DRAWN, MOTIONS, ARRIVALS = 8, 3, 4

# SHARE: the longest motion of a tree, as a share of the time to cross all ranges. GROWTH: the factor by which the
# horizon grows in a round, up to the given horizon. ALONG: the share of configurations that are sampled near the path.
# NEAR: how close to the path these configurations are. HASTY: the share of branches at full speed.
SHARE, GROWTH, ALONG, NEAR, HASTY = 1 / 6, 1.2, 0.5, 0.1, 0.5

# Limits of shortening: the number of rounds, the number of successive rounds without success, and the least relative
# gain. SAVED: for each change that a round tries, the share of the possible gain in time.
ROUNDS, IDLE, GAIN = 6, 2, 1e-3
SAVED = (1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.0, 0.0)

# Number of motions of a candidate that are proven before its other motions.
FEW = 3

# Number of values that a search for nearest states handles at a time: about 100 MB.
LARGE = 2**22

# Number of periods for which waiting at the start is examined, for an error message.
SLOTS = 64


@dataclass(frozen=True, eq=False)
class TimedJudge:
    """Prove motions between states.

    Attributes
    ----------
    robot : Robot
        The robot alone, without moving bodies.
    ready : Problem
        One consistent state of the scene, with the motions of bodies.
    begin : float
        Start of the plan [s].
    limit : float
        Latest arrival, counted from the start [s].
    fastest, joint_error : ndarray, shape (dof,)
    """

    robot: Robot
    ready: Problem
    begin: float
    limit: float
    fastest: Floats
    joint_error: Floats

    def seconds(self, a: Floats, b: Floats) -> Floats:
        """Compute the durations of motions between states at full speed."""
        ways = np.abs(b[..., :-1] - a[..., :-1]) / self.fastest
        return np.asarray(ways.max(axis=-1) * (1.0 + SLACK))

    def free(self, a: Floats, b: Floats) -> Bools:
        """Return which motions between states, shape (N, dof + 1) each, are proven free and not too fast.

        `CollisionChecker.certify_trajectory` repeats this proof for the result.
        """
        t0, t1, free = self.begin + a[:, -1], self.begin + b[:, -1], np.zeros(len(a), dtype=bool)
        at = np.flatnonzero((t0 < t1) & (b[:, -1] <= self.limit))
        ways = np.abs(b[at, :-1] - a[at, :-1])
        at = at[(ways <= self.fastest * (b[at, -1:] - a[at, -1:])).all(axis=1)]
        if len(at) == 0:
            return free
        courses = straight(self.robot, a[at, :-1], b[at, :-1])
        off, begin = BLEND_ROUNDINGS * np.abs(courses).max(axis=1) + self.joint_error, np.arange(len(at))
        if self.ready.paths is not None:
            cut = in_time.pieces(self.robot, self.ready.paths, courses, off, t0[at], t1[at])
            courses, off, begin = cut.courses, cut.off, np.flatnonzero(np.diff(cut.owner, prepend=-1))
        answers = motions.settle(self.ready, courses, TOLERANCE, off)
        refuse_starts(self.ready, courses[:, 0], answers)
        free[at] = np.logical_and.reduceat(answers.verdicts == codes.FREE, begin)
        return free

    def free_at(self, states: Floats) -> Bools:
        """Return which states are free."""
        return in_time.free_at(self.ready, self._with_bodies(states), self.begin + states[:, -1])

    def touching(self, state: Floats) -> str:
        """Describe the contacts in a state; return "" if there are none."""
        contacts, doubt = verdicts.contacts(self.ready, self._with_bodies(state[None])[0], self.begin + state[-1])
        return doubt or touching(contacts)

    def waiting(self, q: Floats) -> str:
        """Describe the first body that comes too close to a robot that waits at the start."""
        if self.ready.paths is None:
            return ""
        t, Q = self.begin + self.limit * np.linspace(0.0, 1.0, SLOTS + 1) ** 2, np.tile(q, (SLOTS, 1))
        answers = in_time.prove_edges(
            self.robot, self.ready, self.ready.paths, (Q, Q), (t[:-1], t[1:]), ProofOptions(TOLERANCE, self.joint_error)
        )
        for k in np.flatnonzero((answers.verdicts != codes.FREE) & (answers.pairs >= 0))[:1]:
            one, other = (self.ready.names[n] for n in self.ready.pairs[answers.pairs[k]])
            return f"; at the start, {one} and {other} come too near after {t[k]:.15g} s"
        return ""

    def _with_bodies(self, states: Floats) -> Floats:
        Q, t = np.ascontiguousarray(states[:, :-1]), self.begin + states[:, -1]
        return np.ascontiguousarray(in_time.with_bodies(self.ready, Q, t))


@guarded
def plan_in_time(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike | PoseGoal,
    start_time: float,
    *,
    velocity: ArrayLike | None = None,
    arrive_by: float | None = None,
    joints: str | Iterable[str] | None = None,
    joint_error: ArrayLike = 0.0,
    search: Search | None = None,
    seed: int = 0,
) -> Trajectory:
    """Plan a trajectory from start to goal among moving bodies, and prove it free of collisions as a whole.

    Parameters
    ----------
    checker, start, joints, joint_error, seed
        As for `plan`.
    goal : array_like, shape (dof,) or (goals, dof), or PoseGoal
        As for `plan`; a `PoseGoal` must not have an approach or a retreat.
    start_time : float
        When the trajectory begins, in seconds on the clock of the bodies' motions (`Scene.follow`).
    velocity : float or array_like, shape (dof,), optional
        The largest velocity of each value [rad/s or m/s]. Default: the URDF's limits (`Robot.velocity`).
    arrive_by : float, optional
        The latest arrival [s], on the same clock as `start_time`. The default, which is also the upper limit, is the
        end of all bodies' motions plus four times the time in which the joints can cross their ranges. A repeated
        motion counts as ended after two periods.
    search : Search, optional
        The fields `max_iterations`, `timeout` and `simplify` apply. The field `planner` must not be set. Motions are
        always proven.

    Returns
    -------
    Trajectory
        Between the trajectory's times, the robot moves straight at a constant rate, or waits. The times are relative to
        the trajectory's `start_time`. For this start time, ``checker.certify_trajectory`` also proves the trajectory
        FREE. No velocity exceeds its limit by more than two units of rounding.

    Raises
    ------
    PlanningError
        As for `plan`. Also if the start collides at the start time, or if no goal can be reached by the latest arrival
        within the velocity limits. For a collision, the message names pairs and depths.
    InputError, UnknownNameError
        As for `plan`.

    See Also
    --------
    time_path : Assigns times to a path among moving bodies, within the limits of the robot's drives.

    Notes
    -----
    The direct motion is tried first. Next, the path through the scene without the moving bodies is tried at several
    starting times and speeds. If no attempt is proven, two trees grow: one forward in time from the start, and one
    backward from the goals at several times of arrival (Grothe et al., "ST-RRT*", ICRA 2022). The result is shortened,
    but it may arrive later than necessary. A contact counts as a collision even if `Scene.leave` or `Scene.reach`
    permits it.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> plan_in_time(checker, [0.0, 0.0], [2.0, 0.0], 5.0, velocity=0.5)
    Trajectory(4 s, 2 joints, 1 motion)
    """
    search, seed = checked_search(search), checked_seed(seed)
    search._refuse("start_time")
    task = Task.of(checker, start, goal, joints)
    q, goal = task.start, task.goal
    robot, still = checker.robot, without_motions(checker)
    expect_straight(robot, "start_time")
    if isinstance(goal, PoseGoal) and not (goal.approach is None and goal.retreat is None):
        raise InputError("goal: expected no approach or retreat in a plan in time, found one; plan them separately")
    judge_of_still = Judge.of(still, 0.0, joint_error)
    goals, names, _ = task.goals(judge_of_still)
    space = Space.of_start(still, task.joints, q, goals)
    judge = _judge(checker, space, start_time, velocity, arrive_by, joint_error)
    first = np.append(q, 0.0)
    goals = space.unwound(q, space.checked_goals(q, goals, judge_of_still, names))
    if not judge.free_at(first[None])[0]:
        raise PlanningError(
            f"start: expected a configuration that is free at the start time {judge.begin:.15g} s, found a collision "
            f"of {judge.touching(first)}"
        )
    needs = judge.seconds(first, np.column_stack([goals, np.zeros(len(goals))]))
    if needs.min() == 0.0:
        return protected(Trajectory._straight(robot.configuration_names, np.zeros(1), q[None], judge.begin))
    if needs.min() > judge.limit:
        raise PlanningError(
            f"arrive_by: expected {judge.begin + needs.min():.9g} s or later, since the nearest goal takes at least "
            f"{needs.min():.6g} s within the velocity limits; found {judge.begin + judge.limit:.15g} s"
        )
    ends = np.column_stack([goals, needs])
    direct = np.flatnonzero(judge.free(np.broadcast_to(first, ends.shape), ends))
    rng, rows = np.random.default_rng(seed), None
    if len(direct):
        rows = np.stack([first, ends[direct[needs[direct].argmin()]]])
    else:
        path = compiled.find_path(space, judge_of_still, q, goals, search, seed)
        rows = _started(judge, path)
        if rows is None:
            rows = _Trees(space, judge, first, ends, path, rng).connected(search._most, search.timeout)
        if search.simplify:
            rows = _shortened(judge, rows, float(needs.min()), rng)
    trajectory = Trajectory._straight(robot.configuration_names, rows[:, -1].copy(), rows[:, :-1].copy(), judge.begin)
    return protected(replace(trajectory, spacing=trajectory._shortest(judge.fastest)))


def _judge(
    checker: CollisionChecker, space: Space, start_time: float, velocity: ArrayLike | None, arrive_by: float | None,
    joint_error: ArrayLike,
) -> TimedJudge:  # fmt: skip
    """Check the options of a plan in time."""
    robot, ready = checker.robot, prepared_of(checker, timed=True)
    begin = _validate.real(start_time, "start_time")
    moved = space.still.copy()
    moved[space.columns] = np.inf  # every moving joint differs from `still`
    fastest = limits_of(robot, np.stack([space.still, moved]), None, velocity, None, None)[0]
    crossing = float(((space.upper - space.lower) / fastest[space.columns]).max())
    if not crossing <= SLOWEST:
        raise InputError(f"velocity: expected joints that cross their ranges in {SLOWEST:g} s, found {crossing:g} s")
    limit = CROSSINGS * crossing + horizon_of(ready, begin)
    if arrive_by is not None:
        last = _validate.real(arrive_by, "arrive_by")
        if not last > begin:
            raise InputError(f"arrive_by: expected a time after start_time, {begin:.15g}, found {last:.15g}")
        limit = min(limit, last - begin)
        while begin + limit > last:
            limit = float(np.nextafter(limit, 0.0))
    for name, path in checker.scene.following.items():
        if path.repeat and limit / path.period * len(path.times) > MOST_KNOTS:
            raise InputError(
                f"start_time: expected bodies that reach at most {MOST_KNOTS} of their times in the {limit:.3g} s of a "
                f"plan, found {name!r}, whose motion repeats after {path.period:g} s; give an earlier arrive_by"
            )
    if not np.spacing(max(abs(begin), abs(begin + limit))) <= COARSEST * crossing:
        raise InputError(
            f"start_time: expected a time to which motions of {crossing:.3g} s can be added, found {begin:.15g}"
        )
    return TimedJudge(robot, ready, begin, limit, fastest, joint_errors(robot, joint_error))


def horizon_of(ready: Problem, begin: float) -> float:
    """Return how long bodies still move after the start of a plan. A repeated motion counts for `PERIODS` periods."""
    paths = () if ready.paths is None else ready.paths.paths
    spans = [PERIODS * path.period if path.repeat else max(float(path.times[-1]) - begin, 0.0) for path in paths]
    return max(spans, default=0.0)


def _started(judge: TimedJudge, path: Floats) -> Floats | None:
    """Follow a path at several starting times and speeds; return the states of the first proven arrival."""
    path = path[np.append(True, (np.diff(path, axis=0) != 0).any(axis=1))]
    states = np.column_stack([path, np.zeros(len(path))])
    states[1:, -1] = np.cumsum(judge.seconds(states[:-1], states[1:]))
    tried = []
    for slow in (1.0, *SLOWER):
        tried.append(states.copy())
        tried[-1][:, -1] *= slow
    for k in range(1, STARTS + 1):
        tried.append(np.concatenate([states[:1], states]))
        tried[-1][1:, -1] += (judge.limit - states[-1, -1]) * (k / STARTS) ** 2
    tried = [rows for rows in tried if rows[-1, -1] <= judge.limit]
    free_ways = _free_among(judge, tried[:1]) or _free_among(judge, tried[1:])
    return min(free_ways, key=lambda rows: float(rows[-1, -1]), default=None)


def _free_among(judge: TimedJudge, tried: list[Floats], known: Floats | None = None) -> list[Floats]:
    """Return the candidates whose motions are all proven free. Motions between successive `known` rows count as proven.

    A few motions of each candidate are proven first, because most candidates fail there.
    """
    before = set() if known is None else {a.tobytes() + b.tobytes() for a, b in zip(known[:-1], known[1:], strict=True)}
    left = [
        [k for k in range(len(rows) - 1) if rows[k].tobytes() + rows[k + 1].tobytes() not in before] for rows in tried
    ]
    for few in (FEW, None):
        counts = [len(numbers[:few]) for numbers in left]
        if sum(counts) == 0:
            continue
        a, b = (
            np.concatenate([rows[np.array(at[:few], dtype=np.int64) + k] for rows, at in zip(tried, left, strict=True)])
            for k in (0, 1)
        )
        free = np.split(judge.free(a, b), np.cumsum(counts)[:-1])
        kept = [k for k, of_rows in enumerate(free) if of_rows.all()]
        tried, left = [tried[k] for k in kept], [left[k][FEW:] for k in kept]
    return tried


class _Tree:
    """States that free motions connect with a start or, in a tree that grows backward, with goals."""

    def __init__(self, judge: TimedJudge, roots: Floats, ahead: bool, longest: float) -> None:
        self.judge, self.states, self.ahead, self.longest = judge, roots, ahead, longest
        self.parents = np.full(len(roots), -1)

    def add(self, states: Floats, parents: Ints) -> None:
        """Add states with their parents."""
        self.states, self.parents = np.concatenate([self.states, states]), np.concatenate([self.parents, parents])

    def nearest(self, states: Floats) -> Ints:
        """For each given state, find the nearest node from which the state can be reached in time, or -1."""
        if len(states) > 1 and states.size * len(self.states) > LARGE:
            return np.concatenate([self.nearest(state[None]) for state in states])
        ways = np.abs(states[:, None, :-1] - self.states[None, :, :-1]) / self.judge.fastest
        lapse = (states[:, None, -1] - self.states[:, -1]) * (1.0 if self.ahead else -1.0)
        costs = np.sqrt((ways * ways).sum(axis=-1)) + lapse
        costs[ways.max(axis=-1) * (1.0 + SLACK) > lapse] = np.inf
        best = costs.argmin(axis=1)
        return np.where(np.isfinite(costs[np.arange(len(states)), best]), best, -1)

    def grow(self, at: Ints, states: Floats, most: int) -> tuple[Ints, Bools]:
        """Grow from nodes towards states, as far as motions are free, by at most `most` motions per branch.

        Returns
        -------
        tips : ndarray of int64
            The last node of each branch.
        reached : ndarray of bool
            Whether the branch reached the state itself.
        """
        a = self.states[at]
        counts = np.maximum(np.ceil(self.judge.seconds(a, states) / self.longest), 1).astype(np.int64)
        used = np.minimum(counts, most)
        owner, begin = np.repeat(np.arange(len(at)), used), np.cumsum(used) - used
        number = np.arange(len(owner)) - begin[owner]
        share = ((number + 1) / counts[owner])[:, None]
        points = np.where(share == 1.0, states[owner], a[owner] + share * (states - a)[owner])
        before = np.where((number == 0)[:, None], a[owner], np.roll(points, 1, axis=0))
        free = self.judge.free(before, points) if self.ahead else self.judge.free(points, before)
        passed = np.minimum.reduceat(np.where(free, used[owner], number), begin)
        kept = number < passed[owner]
        first = len(self.states) + np.cumsum(kept) - 1
        self.add(points[kept], np.where(number == 0, at[owner], first - 1)[kept])
        ends = np.where(passed > 0, first[begin + np.maximum(passed, 1) - 1], at)
        return ends, passed == counts

    def branch(self, node: int) -> list[int]:
        """List the nodes from a given node to its root."""
        nodes = [node]
        while self.parents[nodes[-1]] >= 0:
            nodes.append(int(self.parents[nodes[-1]]))
        return nodes


@dataclass(eq=False)
class _Trees:
    """Two trees that grow until they meet: one from the start, and one from goals at times that are added.

    Attributes
    ----------
    space : Space
    judge : TimedJudge
    first : ndarray, shape (dof + 1,)
        The start.
    ends : ndarray, shape (goals, dof + 1)
        The goals at the earliest times at which the robot could reach them.
    path : ndarray, shape (k, dof)
        A path from the start to a goal, which moving bodies may block.
    """

    space: Space
    judge: TimedJudge
    first: Floats
    ends: Floats
    path: Floats
    rng: np.random.Generator

    def __post_init__(self) -> None:
        space, judge = self.space, self.judge
        longest = SHARE * float(((space.upper - space.lower) / judge.fastest[space.columns]).max())
        self.forward = _Tree(judge, self.first[None], True, longest)
        self.backward = _Tree(judge, self.ends[:0], False, longest)

    def connected(self, most: int, timeout: float) -> Floats:
        """Grow the trees until they meet; return the states from the start to a goal.

        Raises
        ------
        PlanningError
            If the trees do not meet within `most` configurations, or in time.
        """
        began, drawn = time.monotonic(), 0
        window, blocked = 2.0 * float(self.ends[:, -1].min()), ""
        while drawn < most and time.monotonic() - began < timeout:
            window = min(GROWTH * window, self.judge.limit)
            blocked = self._arrive(window) or blocked
            samples = self._drawn(window)
            drawn += DRAWN
            if len(samples) == 0 or len(self.backward.states) == 0:
                continue
            trees = (self.forward, self.backward)
            if len(self.forward.states) > len(self.backward.states):
                trees = trees[::-1]  # the smaller tree grows
            states = self._met(*trees, samples)
            if states is not None:
                return states
        judge, late = self.judge, self.judge.begin + self.judge.limit
        spent = f"within {most} iterations" if drawn >= most else f"within {timeout:g} s ({drawn} iterations)"
        ahead, back = len(self.forward.states), len(self.backward.states)
        trees_of = f"trees of {ahead} states from the start and {back} from the goals"
        if back == 0:
            trees_of = f"no goal that is free at a time of arrival{blocked}"
        raise PlanningError(
            f"expected motions from start to goal between {judge.begin:.15g} s and {late:.15g} s, found none {spent}: "
            f"{trees_of}{judge.waiting(self.first[:-1])}. There may be none; a later arrive_by, a larger "
            "max_iterations or timeout, or another seed, may help"
        )

    def _arrive(self, window: float) -> str:
        """Add goals at random times. If a goal is not free, describe the contact."""
        new = self.ends[self.rng.integers(len(self.ends), size=ARRIVALS)]
        new[:, -1] += self.rng.random(ARRIVALS) * np.maximum(window - new[:, -1], 0.0)
        new = new[new[:, -1] <= self.judge.limit]
        good = self.judge.free_at(new)
        self.backward.add(new[good], np.full(int(good.sum()), -1))
        if good.all():
            return ""
        k = int(good.argmin())
        return f"; at {self.judge.begin + new[k, -1]:.15g} s there is a collision of {self.judge.touching(new[k])}"

    def _drawn(self, window: float) -> Floats:
        """Draw states that can be reached from the start, and from which a goal can be reached within `window`."""
        space, rng, judge, dof = self.space, self.rng, self.judge, len(self.first) - 1
        samples = np.zeros((DRAWN, dof + 1))
        samples[:, :dof] = space.configurations(rng.uniform(space.lower, space.upper, (DRAWN, len(space.columns))))
        along = rng.random(DRAWN) < ALONG
        place = rng.random(DRAWN) * (len(self.path) - 1)
        k = np.minimum(place.astype(np.int64), len(self.path) - 2)
        on = self.path[k] + (place - k)[:, None] * (self.path[k + 1] - self.path[k])
        near = np.where(along, NEAR * rng.random(DRAWN), 1.0)[:, None]
        samples[along, :dof] = (on + near * (samples[:, :dof] - on))[along]
        low = judge.seconds(self.first, samples)
        high = window - judge.seconds(samples[:, None], self.ends).min(axis=1)
        samples[:, -1] = low + rng.random(DRAWN) * (high - low)
        return np.asarray(samples[low <= high])

    def _met(self, one: _Tree, other: _Tree, samples: Floats) -> Floats | None:
        """Grow one tree towards samples, and from there towards the other tree. Return the way if the trees meet."""
        at = one.nearest(samples)
        at, samples = at[at >= 0], samples[at >= 0]
        if len(at) == 0:
            return None
        near, hasty = one.states[at], self.rng.random(len(at)) < HASTY
        haste = self.judge.seconds(near, samples) * (1.0 if one.ahead else -1.0)
        samples[hasty, -1] = (near[:, -1] + haste)[hasty]
        tips, _ = one.grow(at, samples, MOTIONS)
        tips = np.unique(tips)
        to = other.nearest(one.states[tips])
        tips, to = tips[to >= 0], to[to >= 0]
        if len(tips) == 0:
            return None
        tips, met = one.grow(tips, other.states[to], 2**20)
        best: Floats | None = None
        for tip, k in zip(tips[met].tolist(), to[met].tolist(), strict=True):
            # The tip equals the other tree's node k.
            halves = one.states[one.branch(tip)[::-1]], other.states[other.branch(k)[1:]]
            rows = np.concatenate(halves) if one.ahead else np.concatenate(halves)[::-1]
            best = rows if best is None or rows[-1, -1] < best[-1, -1] else best
        return best


def _shortened(judge: TimedJudge, rows: Floats, least: float, rng: np.random.Generator) -> Floats:
    """Cut corners in space and time: arrive earlier if this is proven, or otherwise move along a shorter way."""
    idle, enough = 0, least * (1.0 + GAIN)
    for _ in range(ROUNDS):
        if idle == IDLE or rows[-1, -1] <= enough:
            break
        cuts = np.sort(rng.random((len(SAVED), 2)) * rows[-1, -1], axis=1).tolist()
        tried = [_changed(judge, rows, begin, end, share) for (begin, end), share in zip(cuts, SAVED, strict=True)]
        if idle == 0:  # also cut single corners, and remove waits
            waits = (rows[1:, :-1] == rows[:-1, :-1]).all(axis=1)
            at = rows[:, -1]
            pairs = np.concatenate([[at[:-2], at[2:]], [at[:-1][waits], at[1:][waits]]], axis=1).T.tolist()
            tried += [_changed(judge, rows, begin, end, 1.0) for begin, end in pairs]
        arrival, length = _costs(judge, rows)
        improvements = [(*_costs(judge, new), k, new) for k, new in enumerate(_free_among(judge, tried, rows))]
        improvements = [
            one for one in improvements
            if one[0] < arrival * (1 - GAIN) or (one[0] <= arrival and one[1] < length * (1 - GAIN))
        ]  # fmt: skip
        idle = 0 if improvements else idle + 1
        if improvements:
            rows = min(improvements)[3]
    return rows


def _changed(judge: TimedJudge, rows: Floats, begin: float, end: float, share: float) -> Floats:
    """Move straight between two times, and save a share of the time that the straight motion leaves unused."""
    times, at = rows[:, -1], np.array([begin, end])
    k = np.minimum(np.searchsorted(times, at, side="right") - 1, len(rows) - 2)
    two = rows[k] + ((at - times[k]) / (times[k + 1] - times[k]))[:, None] * (rows[k + 1] - rows[k])
    two[:, -1] = at
    first, last = int(np.searchsorted(times, begin - SLACK)), int(np.searchsorted(times, end + SLACK))
    saved = share * max(end - begin - float(judge.seconds(two[0], two[1])), 0.0)
    two = two[: 1 if saved == end - begin else 2]  # if no time is left between the two states, keep one
    changed: Floats = np.concatenate([rows[:first], two, rows[last:]])
    changed[first + 1 :, -1] -= saved
    changed[0], changed[-1, :-1] = rows[0], rows[-1, :-1]
    return changed


def _costs(judge: TimedJudge, rows: Floats) -> tuple[float, float]:
    """Compute the time of arrival, and the length in seconds."""
    ways = np.diff(rows[:, :-1], axis=0) / judge.fastest
    return float(rows[-1, -1]), float(np.sqrt((ways * ways).sum(axis=1)).sum())
