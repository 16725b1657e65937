"""Improve paths in rounds, which search within a bound on the cost, polish the results, and keep the cheapest path."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._log import log
from loewner._base._read_only import KeepsReadOnly
from loewner._base._validate import Floats, Ints, fits_memory
from loewner._kernels import codes
from loewner._kernels.columns import BOUND, ITERATION, RANDOM, STATE, STEP
from loewner._native import entries
from loewner.errors import InputError, PlanningError
from loewner.planners import compiled
from loewner.planners.clearing import Clearing
from loewner.planners.compiled import Growth
from loewner.planners.departures import Departures
from loewner.planners.judge import Judge
from loewner.planners.searches import Search
from loewner.planners.space import Space
from loewner.robots import Proof, Robot

# A search samples an ellipsoid, whose paths cost more than the straight path by at most SLACK times the best path's
# excess. SLACK exceeds 1 because polishing shortens new paths.
SLACK = 1.5

# First and largest number of iterations of a search, and the factors by which this number changes after a failure and
# after a success.
FIRST_SEARCH, MOST_SEARCH = 100, 512
AFTER_FAILURE, AFTER_SUCCESS = 1.5, 0.7

# Length of a tree's longest motion, as a share of the best cost.
SHARE = 1 / 4

# Number of polishing steps for a new path, for a polished path that costs less than PROMISING times the best cost, and
# for the best path in each round.
QUICK_STEPS, MORE_STEPS, BEST_STEPS = 24, 60, 24
PROMISING = 1.2

# Number of rows that a path may gain.
ROOM = 64

# A path is not improved if its cost exceeds the cost of the straight path by at most the share NOTHING_LEFT.
NOTHING_LEFT = 1e-9

# Limit on weights and on their inverses. Beyond this limit, squares of costs could overflow.
LARGEST_WEIGHT = 1e9

# Smallest clearance [m]. With a smaller clearance, the gradient of the cost near obstacles might overflow.
LEAST_CLEARANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Improve:
    """How `plan_full` improves a path: up to a limit on the time or on the rounds, or not at all if there is no limit.

    Parameters
    ----------
    seconds : float, optional
        Improve until this time has passed since the beginning of the call. The first path is returned in any case. If
        only ``iterations`` is given, the limit on the time is the timeout of the search.
    iterations : int, optional
        Limit on the number of rounds. Equal numbers of rounds and equal seeds lead to equal paths, unless the time runs
        out first.
    weights : array_like, shape (dof,), optional
        Factors of the joint values in the cost: a motion costs the Euclidean norm of its weighted changes. Weights make
        metres and radians comparable. A joint with a large weight moves little. Default: 1 for each value.
    clearance : float, optional
        Distance [m] that the path should keep from the bodies of the scene where possible. The clearance is a
        preference, not a constraint. At smaller distances, a motion costs up to ten times its length. At least
        half of the rounds move the path away from the bodies. If the distance must be kept everywhere, use
        `Scene.margin` instead.

    Raises
    ------
    InputError
        If a value is wrong, or a clearance is given without a limit.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> from loewner.planners import Improve, plan_full
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> plan_full(checker, [0.0, 0.0], [1.0, 1.0], Improve(iterations=20, weights=[1.0, 0.1])).cost
    1.004987562112089
    """

    seconds: float | None = None
    iterations: int | None = None
    weights: ArrayLike | None = None
    clearance: float | None = None

    def __post_init__(self) -> None:
        if self.seconds is not None:
            self._set("seconds", _validate.positive_scalar(self.seconds, "seconds or improve_for", zero=True))
        if self.iterations is not None:
            self._set("iterations", _validate.whole_number(self.iterations, "iterations or improve_iterations", 0))
        if self.clearance is not None:
            clearance = _validate.positive_scalar(self.clearance, "clearance")
            if clearance < LEAST_CLEARANCE:
                raise InputError(f"clearance: expected at least {LEAST_CLEARANCE:g} m, found {clearance:g}")
            if not self._wanted:
                raise InputError(
                    "clearance: expected improve_for or improve_iterations (seconds or iterations of Improve) with it"
                )
            self._set("clearance", clearance)

    def _set(self, name: str, value: float) -> None:
        object.__setattr__(self, name, value)

    @property
    def _wanted(self) -> bool:
        """Whether the path is improved at all."""
        return bool(self.seconds or self.iterations)


@dataclass(frozen=True, eq=False, repr=False)
class Plan(KeepsReadOnly):
    """The result of `plan_full`: a path with its cost, and a lower bound on the cost of every path to the goals.

    The cost of a motion is the Euclidean norm of the weighted changes of joint values, and the cost of the path is the
    sum over its motions. If a clearance was given, the cost is higher near obstacles.

    Attributes
    ----------
    path : ndarray, shape (k, dof)
        The path, as `plan` returns it.
    cost : float
        Cost of the path.
    bound : float
        Lower bound on the cost of every path from the start to one of the goals. The bound is the least cost of a
        straight motion to any free goal within the limits; the motion itself need not be free. For a `PoseGoal` the
        bound is 0, since configurations that were not tried may reach the pose at a lower cost.
    iterations : int
        Number of rounds that tried to improve the path.
    seconds : float
        Duration of the call, excluding the writing of a proof.
    proof : Proof or None
        A proof that the path is free, if one was requested.
    clearance : float or None
        Least distance [m] between the robot and the unattached bodies of the scene, at 128 or more points of the path.
        The distance is infinite if there are no such bodies, and None if no clearance was requested.
    approach : int or None
        The row of the path at which the approach of a `PoseGoal` begins, if there is an approach.
    retreat : ndarray, shape (k, dof), or None
        The path of the goal's retreat, which begins at the end of `path`.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> from loewner.planners import Improve, plan_full
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> found = plan_full(checker, [0.0, 0.0], [2.0, 0.0], Improve(iterations=20), joints="rail")
    >>> found.cost, found.gap < 1e-12
    (2.0, True)
    """

    path: Floats
    cost: float
    bound: float
    iterations: int
    seconds: float
    proof: Proof | None = None
    clearance: float | None = None
    approach: int | None = None
    retreat: Floats | None = None

    @property
    def gap(self) -> float:
        """The excess of the cost over the bound, divided by the bound. No path is cheaper by more than the excess."""
        if self.cost == self.bound:
            return 0.0
        return float((self.cost - self.bound) / self.bound) if self.bound > 0.0 else math.inf

    def __repr__(self) -> str:
        kept = "" if self.clearance is None else f"clearance {self.clearance:.3g} m, "
        return (
            f"Plan({len(self.path)} configurations, cost {self.cost:.6g} >= {self.bound:.6g}, {kept}"
            f"{self.iterations} iterations, {self.seconds:.3g} s)"
        )


@dataclass(frozen=True, eq=False)
class Improvement:
    """Options for improving a path.

    Attributes
    ----------
    weights : ndarray, shape (dof,)
    most : int
        Number of rounds.
    began, deadline : float
        When the call began, and when to return, on the monotonic clock.
    clearance : float
        Distance from obstacles below which the cost rises [m], or 0 if the cost does not rise.
    seed : int
    """

    weights: Floats
    most: int
    began: float
    deadline: float
    clearance: float
    seed: int

    @classmethod
    def of(cls, robot: Robot, improve: Improve, search: Search, seed: int) -> Improvement:
        """Check the options that depend on the robot and the search. The time is counted from this call."""
        began, most, seconds = time.monotonic(), improve.iterations, improve.seconds
        if improve._wanted and search.planner is not None:
            raise InputError(
                "planner: expected none with improve_for or improve_iterations, which use the compiled planner"
            )
        if not improve._wanted or seconds == 0:
            most = 0
        until = began + (search.timeout if seconds is None else seconds)
        weights = _checked_weights(robot, improve.weights)
        return cls(weights, 2**62 if most is None else most, began, until, improve.clearance or 0.0, seed)

    def plan(
        self, path: Floats, ends: Departures, goals: Floats, iterations: int, others: bool, clearing: Clearing | None
    ) -> Plan:
        """Make the full result for a path to one of the given free goals. With `others`, further goals may exist."""
        kept = {goal.tobytes() for goal in goals}
        targets = ends.goals[[goal.tobytes() in kept for goal in ends.free_goals]]
        cost = cost_of(self.weights, path) if clearing is None else clearing.cost_of(path)
        rounded = 1 - (len(self.weights) + 4) * np.finfo(float).eps
        bound = 0.0 if others else least_cost(ends.space, self.weights, ends.start, targets) * rounded
        least = None if clearing is None else clearing.least_distance(path)
        return Plan(path, cost, min(bound, cost), iterations, time.monotonic() - self.began, clearance=least)


def _checked_weights(robot: Robot, given: ArrayLike | None) -> Floats:
    """Check a user's weights."""
    if given is None:
        return np.ones(robot.dof)
    weights = _validate.finite_array(given, "weights", (robot.dof,))
    for k in np.flatnonzero((weights > LARGEST_WEIGHT) | (weights < 1 / LARGEST_WEIGHT))[:1]:
        raise InputError(
            f"weights: expected numbers from {1 / LARGEST_WEIGHT:g} to {LARGEST_WEIGHT:g}, found {weights[k]:g} for "
            f"{robot.configuration_names[k]}"
        )
    return weights


def cost_of(weights: Floats, path: Floats) -> float:
    """Compute the cost of a path."""
    ways = weights * (path[1:] - path[:-1])
    return float(np.sqrt((ways * ways).sum(axis=1)).sum())


def least_cost(space: Space, weights: Floats, start: Floats, goals: Floats) -> float:
    """Compute the cost of the straight path from the start to the nearest goal."""
    ways = weights * (space.unwound(start, goals) - start)
    return float(np.sqrt((ways * ways).sum(axis=1).min()))


@dataclass(eq=False)
class Polish:
    """A path that is being polished, in the form that `polish_path` needs."""

    judge: Judge
    box: Floats
    rows: Floats
    count: int
    state: Ints
    size: Floats
    cost: float

    @classmethod
    def of(cls, judge: Judge, box: Floats, path: Floats, seed: int) -> Polish:
        """Copy a path whose motions are all free."""
        fits_memory(16 * (len(path) + ROOM) * path.shape[1], f"a path of {len(path)} configurations")
        rows, state = np.empty((len(path) + ROOM, path.shape[1])), np.zeros(STATE, dtype=np.int64)
        rows[: len(path)] = path
        state[RANDOM] = seed
        return cls(judge, box, rows, len(path), state, np.array([0.5]), cost_of(box[2], path))

    def on(self, most: int) -> int:
        """Polish up to this total number of steps. Return MET if only a straight motion is left."""
        if self.count > 2:
            ends, points = np.empty((2, self.rows.shape[1])), np.empty_like(self.rows)
            self.count = entries.polish_path(
                self.count, most, *self.judge.asked(), self.rows, self.box, self.state, self.size, ends, points
            )
            self.cost = cost_of(self.box[2], self.path)
        return codes.MET if self.count == 2 else codes.SPENT

    @property
    def path(self) -> Floats:
        """The path so far."""
        return self.rows[: self.count]


class _LateError(Exception):
    """The time limit has passed."""


@dataclass(eq=False)
class Rounds:
    """Rounds of improvement, in an order that the seed determines.

    Attributes
    ----------
    growth : Growth
    best : Polish
        The cheapest path so far.
    box : ndarray, shape (3, dof)
        See `_kernels.robots.polishing.Work`.
    idle : ndarray of int64, shape (k,)
        Indices of the joints with equal values at the start and at all goals, in order of decreasing weight; empty if
        all values are equal.
    least : float
        Cost of the straight path.
    longest : float
        Length of a tree's longest motion in a search without a bound on the cost.
    seed : int
    deadline : float
    searches : int
        Iterations of the next search.
    portion : int
        Iterations between two checks of the clock and of interrupts.
    """

    growth: Growth
    best: Polish
    box: Floats
    idle: Ints
    least: float
    longest: float
    seed: int
    deadline: float
    searches: int = FIRST_SEARCH
    portion: int = compiled.FIRST

    def run(self, number: int) -> None:
        """Run one round."""
        growth, box = self.growth, self.box.copy()
        # Odd rounds keep idle joints still: at first all of them, then the heavier half, and so on.
        halvings = number // 2 % len(self.idle).bit_length() if len(self.idle) else 0
        resting = self.idle[: len(self.idle) >> halvings] if number % 2 else self.idle[:0]
        search, columns = growth.search, growth.space.columns[resting]
        ranges = search.lower, search.upper, search.turning
        before = [values.copy() for values in ranges]
        search.lower[resting] = search.upper[resting] = search.start[columns]
        search.turning[resting], box[2, columns] = 0, 0.0
        self._search(number, box)
        for values, old in zip(ranges, before, strict=True):
            values[:] = old
        self._on(self.best, BEST_STEPS)
        self.best = self._resting(self.best)

    def _search(self, number: int, box: Floats) -> None:
        """Search for another path, and keep it if it is cheaper after polishing."""
        growth, best, seed = self.growth.rooted(self.seed + number), self.best, self.seed + number
        growth.search.reach[STEP] = min(self.longest, SHARE * best.cost)
        growth.search.reach[BOUND] = self.least + SLACK * (best.cost - self.least)
        if self._on(growth, self.searches) != codes.MET:
            self.searches = min(int(AFTER_FAILURE * self.searches), MOST_SEARCH)
            return
        self.searches = max(int(AFTER_SUCCESS * self.searches), FIRST_SEARCH)
        try:
            polish = Polish.of(growth.judge, box, growth.path(), seed)
        except PlanningError:  # the path as a whole is not free
            return
        self._on(polish, QUICK_STEPS)
        if polish.cost < PROMISING * best.cost:
            self._on(polish, MORE_STEPS)
        if polish.cost < best.cost:
            self.best = polish

    def _resting(self, found: Polish) -> Polish:
        """Keep idle joints still on the whole path, as far as the path remains free."""
        for k in self.growth.space.columns[self.idle]:
            path, box = found.path.copy(), found.box.copy()
            if (path[:, k] == path[0, k]).all():
                continue
            path[:, k], box[2, k] = path[0, k], 0.0
            if found.judge.free(path[:-1], path[1:]).all():
                found = Polish.of(found.judge, box, path, int(found.state[RANDOM]))
        return found

    def _on(self, work: Growth | Polish, steps: int) -> int:
        """Let a kernel work in portions, which do not change the result; return the kernel's code."""
        outcome, last = codes.SPENT, int(work.state[ITERATION]) + steps
        while outcome != codes.MET and (done := int(work.state[ITERATION])) < last:
            called = time.monotonic()
            if called > self.deadline:
                raise _LateError
            outcome = work.on(min(done + self.portion, last))
            quick = time.monotonic() - called < compiled.A_WHILE
            self.portion = min(2 * self.portion, compiled.AT_A_TIME) if quick else max(self.portion // 2, 1)
        return outcome


def improved(
    space: Space, judge: Judge, path: Floats, goals: Floats, asked: Improvement, clearing: Clearing | None
) -> tuple[Floats, int]:
    """Improve a path to one of several free goals; return the path and the number of rounds.

    The judge accepts all motions of the given path, and of the result. With a clearance, at most half of the rounds and
    of the time are used to shorten the path, and the rest is used to move the path away from obstacles.
    """
    if clearing is None or asked.most == 0:
        return _shorter(space, judge, path, goals, asked)
    now = time.monotonic()
    first = replace(asked, most=asked.most // 2, deadline=now + 0.5 * (asked.deadline - now))
    shorter, done = _shorter(space, judge, path, goals, first)
    best = min(shorter, path, key=clearing.cost_of)  # the shortest path may be nearest to obstacles
    path, more = clearing.cleared(space, best, asked.most - done, asked.deadline)
    return path, done + more


def _shorter(space: Space, judge: Judge, path: Floats, goals: Floats, asked: Improvement) -> tuple[Floats, int]:
    """Make a path shorter."""
    seed, least = asked.seed, least_cost(space, asked.weights, path[0], goals)
    enough = least * (1 + NOTHING_LEFT)
    if asked.most == 0 or cost_of(asked.weights, path) <= enough:
        return path, 0
    box, at = np.zeros((3, path.shape[1])), space.columns
    box[0, at] = np.where(space.turning, -np.inf, space.lower)
    box[1, at] = np.where(space.turning, np.inf, space.upper)
    box[2, at] = asked.weights[at]
    growth = Growth.of(space, judge, path[0], goals, seed, box[2, at])
    same = (goals[:, at] == path[0, at]).all(axis=0)
    idle = np.flatnonzero(same & ~same.all())
    idle = idle[np.argsort(-asked.weights[at[idle]], kind="stable")]
    best = Polish.of(growth.judge, box, path, seed)
    rounds = Rounds(growth, best, box, idle, least, float(growth.search.reach[STEP]), seed, asked.deadline)
    done = 0
    try:
        while done < asked.most and rounds.best.cost > enough:
            cost = rounds.best.cost
            rounds.run(done + 1)
            done += 1
            if rounds.best.cost < cost:
                log.info("round %d of improvement: cost %.6g, at least %.6g", done, rounds.best.cost, least)
    except _LateError:
        pass
    return rounds.best.path.copy(), done
