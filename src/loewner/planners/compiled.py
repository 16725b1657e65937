"""Call the kernels of RRT-Connect and of shortening: allocate their memory, and turn error codes into exceptions."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from loewner._base._matrices import lengths
from loewner._base._validate import Floats, Ints, fits_memory
from loewner._kernels import codes
from loewner._kernels.columns import GAP, GOALS, ITERATION, MOTIONS, RANDOM, ROWS, STARTS, STATE, STEP, TREE_ROWS
from loewner._kernels.records import Search, table_of
from loewner._native import entries
from loewner.errors import PlanningError
from loewner.planners import ompl_planners, searches
from loewner.planners.judge import TOLERANCE, Judge
from loewner.planners.space import Space
from loewner.queries.pairs import Verdict
from loewner.robots.proofs.proofs import ProofOptions, prove_by_rules

# Length of a tree's longest motion, divided by the square root of the angle by which an axis to keep may tilt. On
# longer motions, the axis would tilt further.
KEPT = 2.0

# Initial capacity of trees, in configurations.
CAPACITY = 2048

# First and largest number of iterations, or of cuts, between two checks of the clock and of interrupts. Fewer
# iterations are done if they would take longer than A_WHILE [s].
FIRST, AT_A_TIME = 64, 512
A_WHILE = 0.01

# Default number of cuts to try: more cuts gain little, and take longer than the search itself.
CUTS = 60

# Number of motions between the trees that are examined for the error message if the search fails.
BETWEEN = 64

# Number of configurations that a path may gain while it is shortened.
MOST_ROOM = 4096


@dataclass(eq=False)
class Growth:
    """Two trees that kernels grow.

    Attributes
    ----------
    space : Space
    judge : Judge
    goals : ndarray, shape (goals, dof)
    search : Search
        The data that the kernels read and write.
    """

    space: Space
    judge: Judge
    goals: Floats
    search: Search

    def __post_init__(self) -> None:
        self.state: Ints = self.search.state
        self._table = table_of(self.search)

    @classmethod
    def of(
        cls, space: Space, judge: Judge, start: Floats, goals: Floats, seed: int, weights: Floats | None = None
    ) -> Growth:
        """Plant the trees; `weights` are factors for differences between values of the joints that move."""
        joints = len(space.columns)
        search = Search(
            np.empty(7, dtype=np.int64), np.empty(2), space.columns, space.turning.astype(np.int64),
            space.lower.copy(), space.upper.copy(), np.empty(joints), np.empty(joints),
            np.ones(joints) if weights is None else weights, np.empty(3), np.zeros(STATE, dtype=np.int64),
            np.ascontiguousarray(start), _trees(joints, max(CAPACITY, 2 * len(goals))),
        )  # fmt: skip
        growth = cls(space, judge, np.ascontiguousarray(goals), search).rooted(seed)
        longest = search.reach[STEP] if weights is None else lengths(search.upper - search.lower)
        growth.judge = judge.up_to(float(longest))
        if judge.kept is not None:
            search.reach[STEP] = min(search.reach[STEP], KEPT * math.sqrt(judge.kept.angle))
        return growth

    def rooted(self, seed: int) -> Growth:
        """Restart the search from the start and the goals."""
        entries.begin_search(self._table.ctypes.data, self.goals, seed)
        return self

    def on(self, most: int) -> int:
        """Grow the trees until they meet, for at most `most` iterations in total; return the outcome."""
        self.search.handles[:], self.search.lengths[:] = self.judge.asked()
        while (outcome := entries.connect_trees(self._table.ctypes.data, most)) == codes.FULL:
            trees = self.search.trees
            more = _trees(len(self.space.columns), 2 * trees.shape[1])
            more[:, : trees.shape[1]] = trees
            self.search = self.search._replace(trees=more)
            self._table = table_of(self.search)
        return int(outcome)

    def path(self) -> Floats:
        """Return the path through both trees."""
        judge, path = self.judge, np.empty((int(self.state[ROWS]), len(self.search.start)))
        turned = entries.path_through(self._table.ctypes.data, path)
        # The path differs slightly from the judged motions, because whole turns are rounded and steps are counted from
        # the start. Moreover, if proofs assume a free start, the scene may have changed since the start was checked.
        if (turned or judge.resolution or judge.ready.starts_matter) and not judge.free(path[:-1], path[1:]).all():
            raise PlanningError(
                "expected a path that is free as a whole, found one that is not: try another seed or a finer resolution"
            )
        return path


def _trees(joints: int, capacity: int) -> Floats:
    """Allocate two trees with room for `capacity` configurations each."""
    rows = 2 * joints + TREE_ROWS
    fits_memory(8 * rows * capacity, f"trees of {capacity} configurations")
    return np.empty((rows, capacity))


def find_path(space: Space, judge: Judge, start: Floats, goals: Floats, search: searches.Search, seed: int) -> Floats:
    """Find a path, shape (k, dof), from a configuration to one of several goals, and simplify it if requested.

    Raises
    ------
    PlanningError
        If no path was found within the iterations or in time.
    """
    if search.planner is not None:
        return ompl_planners.find_path(space, judge, start, goals, search, seed)
    path = _connected(Growth.of(space, judge, start, goals, seed), search._most, search.timeout)
    return shortened(judge, path, max_iterations=CUTS, seed=seed) if search.simplify else path


def _connected(growth: Growth, max_iterations: int, timeout: float) -> Floats:
    """Grow the trees until they meet, and return the path through both (RRT-Connect)."""
    state = growth.state
    began: float | None = None  # after the first call, in which Numba may compile
    outcome, portion = codes.SPENT, min(FIRST, AT_A_TIME)
    while outcome != codes.MET:
        done = int(state[ITERATION])
        if done == max_iterations:
            raise PlanningError(_how_far(growth, f"within {max_iterations} iterations", "max_iterations"))
        if began is not None and time.monotonic() - began > timeout:
            raise PlanningError(_how_far(growth, f"within {timeout:g} s ({done} iterations)", "timeout"))
        called = time.monotonic()
        outcome = growth.on(min(done + portion, max_iterations))
        now = time.monotonic()
        portion = min(2 * portion, AT_A_TIME) if now - called < A_WHILE else max(portion // 2, 1)
        began = began or now
    return growth.path()


def _how_far(growth: Growth, spent: str, option: str) -> str:
    """Make the message of a search that found no path."""
    state, gap = growth.state, growth.search.reach[GAP]
    from_start, from_goals = state[[STARTS, GOALS]].tolist()
    near = "neither grew"
    if np.isfinite(gap):
        near = f"the trees came within {gap:.3g} (in the units of the joints) of each other"
    return (
        f"expected a path from start to goal, found none {spent}: of {state[MOTIONS]} motions tried, the free ones "
        f"make a tree of {from_start} configurations from the start and one of {from_goals} from the goals; {near}. "
        f"{_what_is_between(growth)}There may be no path; a larger {option}, or another seed, may help"
    )


def _what_is_between(growth: Growth) -> str:
    """Describe the collisions of motions between configurations that are spread over both trees."""
    judge, counts = growth.judge, growth.state[[STARTS, GOALS]].tolist()
    if judge.resolution:
        return ""
    spread = [np.unique(np.linspace(0, count - 1, BETWEEN, dtype=np.int64)) for count in counts]
    halves = np.split(growth.search.trees[:-TREE_ROWS], 2)
    first, last = (nodes[:, numbers].T for nodes, numbers in zip(halves, spread, strict=True))
    with np.errstate(over="ignore"):  # if squares of differences overflow, any node will do
        nearest = lengths(first[:, None] - last).argmin(axis=1)
    a, b = growth.space.configurations(first), growth.space.configurations(last[nearest])
    answers, parts = prove_by_rules(judge.ready, a, b, ProofOptions(TOLERANCE, judge.joint_error)), []
    close = f"come within {TOLERANCE:g} m of their margin"
    for verdict, how in ((codes.COLLIDING, "collide"), (codes.AMBIGUOUS, close)):
        pairs, often = np.unique(answers.pairs[answers.verdicts == verdict], return_counts=True)
        if len(pairs):
            names = " and ".join(judge.ready.names[k] for k in judge.ready.pairs[pairs[often.argmax()]])
            parts.append(f"{often.sum()} are {Verdict(verdict).name}, mostly since {names} {how}")
    return f"Of {len(a)} motions between the trees, {', and '.join(parts)}. " if parts else ""


def shortened(judge: Judge, path: Floats, *, max_iterations: int, seed: int) -> Floats:
    """Return a shorter path with the same ends. The judge accepts all motions of the given path, and of the result."""
    count = len(path)
    judge = judge.up_to(float(np.sum(judge.checker.robot.distances(path[:-1], path[1:]))))
    handles = judge.asked()
    room = count + min(max_iterations, MOST_ROOM)
    fits_memory(8 * room * path.shape[1], f"a path of {room} configurations")
    rows, state = np.empty((room, path.shape[1])), np.zeros(STATE, dtype=np.int64)
    rows[:count] = path
    state[RANDOM] = seed
    ends, points = np.empty((2, path.shape[1])), np.empty((2, path.shape[1]))
    done = -1
    while done < max_iterations and count > 2 and done != state[ITERATION]:
        done = int(state[ITERATION])
        count = entries.shorten_path(count, min(done + AT_A_TIME, max_iterations), *handles, rows, state, ends, points)
    return rows[:count].copy()
