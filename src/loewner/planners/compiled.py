"""Call the compiled RRT-Connect and shortening: allocate memory for their kernels, and turn codes into errors."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from loewner._base._low_discrepancy import irrationals
from loewner._base._matrices import lengths
from loewner._base._validate import Floats, Ints, fits_memory
from loewner._kernels import codes
from loewner._kernels.columns import GOALS, ITERATION, MOTIONS, OF_GOAL, OF_START, RANDOM, STARTS, STATE
from loewner._native import entries
from loewner.errors import PlanningError
from loewner.planners.judge import TOLERANCE, Judge
from loewner.planners.space import Space
from loewner.queries.pairs import Verdict
from loewner.robots.proofs.proofs import prove_by_rules

# The longest motion of a tree, as a share of the diagonal of the limits: 1 rad for a usual arm.
SHARE = 1 / 12

# The same with an axis to keep, over the square root of its angle: chords of longer motions leave the angle.
KEPT = 2.0

# Initial capacity of trees, in configurations.
CAPACITY = 2048

# Iterations and cuts between two checks of the clock and for an interrupt, initially and at most; there are fewer
# iterations if they would take longer than this [s].
FIRST, AT_A_TIME = 64, 512
A_WHILE = 0.01

# More iterations than any search makes.
UNLIMITED = 2**40

# Default number of cuts to try: more find little, and take longer than the search itself.
CUTS = 60

# Number of motions between the trees that are examined for the message of a search that found nothing.
BETWEEN = 64

# Number of configurations that a path may gain while it is shortened.
MOST_ROOM = 4096


class Trees(NamedTuple):
    """Two trees in the form that `_kernels.robots.planning.Trees` describes."""

    nodes: Floats
    parents: Ints
    domains: Floats

    @classmethod
    def of(cls, joints: int, capacity: int) -> Trees:
        """Allocate trees with room for this number of configurations each."""
        fits_memory(2 * capacity * 8 * (joints + 3), f"trees of {capacity} configurations")
        nodes, parents = np.empty((2, joints, capacity)), np.empty((2, capacity), dtype=np.int64)
        return cls(nodes, parents, np.empty((2, capacity)))

    def rooted(self, start: Floats, goals: Floats) -> Trees:
        """Add a start, shape (joints,), and goals, shape (goals, joints), as the roots of the trees."""
        count = len(goals)
        self.nodes[0, :, 0], self.nodes[1, :, :count] = start, goals.T
        self.parents[0, 0], self.parents[1, :count] = -1, -1
        self.domains[0, 0], self.domains[1, :count] = np.inf, np.inf
        return self

    @property
    def capacity(self) -> int:
        """Number of configurations that fit into each tree."""
        return int(self.nodes.shape[2])

    def grown(self) -> Trees:
        """Copy the trees, with room for twice as many configurations."""
        more = Trees.of(self.nodes.shape[1], 2 * self.capacity)
        for old, new in zip(self, more, strict=True):
            new[..., : self.capacity] = old
        return more

    def branch(self, tree: int, node: int) -> Floats:
        """Return the values from a node to its root."""
        numbers = []
        while node >= 0:
            numbers.append(node)
            node = int(self.parents[tree, node])
        values: Floats = self.nodes[tree][:, numbers].T
        return values


@dataclass(eq=False)
class Growth:
    """Two trees, and the arrays from which the kernel lets them grow.

    Attributes
    ----------
    space : Space
    judge : Judge
    start : ndarray, shape (dof,)
    goals : ndarray, shape (goals, dof)
    numbers, limits, reach
        `joints`, `limits` and `reach` of `connect_trees`.
    trees : Trees
    state, gap : ndarray
        See `connect_trees`.
    """

    space: Space
    judge: Judge
    start: Floats
    goals: Floats
    numbers: Ints
    limits: Floats
    reach: Floats
    trees: Trees
    state: Ints
    gap: Floats

    @classmethod
    def of(cls, space: Space, judge: Judge, start: Floats, goals: Floats, weights: Floats | None = None) -> Growth:
        """Allocate memory for the trees; `weights` are factors for differences of the joints that move."""
        joints, root = len(space.columns), start[space.columns]
        numbers, limits = np.empty((2, joints), dtype=np.int64), np.empty((5, joints))
        numbers[0], numbers[1] = space.columns, space.turning
        limits[0], limits[1] = space.lower, space.upper
        limits[0, space.turning] = root[space.turning] - np.pi
        limits[1, space.turning] = root[space.turning] + np.pi
        limits[4] = 1.0 if weights is None else weights
        low, high = limits[4] * limits[:2]
        longest = float(lengths(high - low)) * SHARE
        if judge.kept is not None:
            longest = min(longest, KEPT * math.sqrt(judge.kept.angle))
        judge = judge.up_to(float(lengths(limits[1] - limits[0])) * (SHARE if weights is None else 1.0))
        trees = Trees.of(joints, max(CAPACITY, 2 * len(goals)))
        state, gap = np.zeros(STATE, dtype=np.int64), np.array([np.inf])
        return cls(space, judge, start, goals, numbers, limits, np.array([longest, np.inf]), trees, state, gap)

    def rooted(self, seed: int) -> Growth:
        """Begin anew from the start and the goals."""
        at = self.space.columns
        self.trees.rooted(self.start[at], self.goals[:, at])
        self.limits[2], self.limits[3] = _sequence(len(at), seed)
        self.state[:], self.gap[0] = 0, np.inf
        self.state[STARTS], self.state[GOALS], self.state[RANDOM] = 1, len(self.goals), seed
        return self

    def on(self, most: int) -> int:
        """Let the trees grow until they meet, for at most this number of iterations in all; return the outcome."""
        outcome = codes.FULL
        while outcome == codes.FULL:
            points, ends = np.empty((4, len(self.space.columns))), np.array([self.start, self.start])
            outcome = entries.connect_trees(
                most, self.reach, *self.judge.asked(), self.numbers, self.limits, *self.trees, self.state, self.gap,
                ends, points, np.empty(self.trees.capacity),
            )  # fmt: skip
            if outcome == codes.FULL:
                self.trees = self.trees.grown()
        return int(outcome)

    def path(self) -> Floats:
        """Return the path through both trees."""
        return _path(self.space, self.judge, self.trees, self.state)


def connect(
    space: Space,
    judge: Judge,
    start: Floats,
    goals: Floats,
    *,
    max_iterations: int,
    timeout: float,
    seed: int,
) -> Floats:
    """Find a path from a configuration to one of several, shape (k, dof), by RRT-Connect.

    Raises
    ------
    PlanningError
        If no path was found within the iterations or in time.
    """
    growth = Growth.of(space, judge, start, goals).rooted(seed)
    state = growth.state
    began: float | None = None  # only after the first call, for which Numba may have to compile
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


def _sequence(joints: int, seed: int) -> tuple[Floats, Floats]:
    """Return strides and shifts of a low-discrepancy sequence; its k-th entry is the fraction of shift + k strides."""
    strides, shifts = irrationals(joints)
    return strides, np.modf(0.5 + seed * shifts)[0]


def _path(space: Space, judge: Judge, trees: Trees, state: Ints) -> Floats:
    """Return the path through both trees."""
    first, rest = trees.branch(0, int(state[OF_START]))[::-1], trees.branch(1, int(state[OF_GOAL]))
    turned = False
    if space.turning.any():
        turns = np.where(space.turning, np.rint((rest[0] - first[-1]) / (2 * np.pi)), 0.0)
        turned = bool(turns.any())
        rest = np.where(turns == 0, rest, rest - 2 * np.pi * turns)
    path = space.configurations(np.concatenate([first, rest]))
    # Whole turns are rounded, and steps are counted from the start, so the path differs slightly from the judged
    # motions. Also, where starts matter, they were checked in a scene that may have changed.
    if (turned or judge.resolution or judge.ready.starts_matter) and not judge.free(path[:-1], path[1:]).all():
        raise PlanningError(
            "expected a path that is free when it is checked as a whole, found one that is not; "
            "another seed, or a finer resolution, may help"
        )
    return path


def _how_far(growth: Growth, spent: str, option: str) -> str:
    """Make the message for a search that found nothing."""
    state, gap = growth.state, growth.gap
    from_start, from_goals = state[[STARTS, GOALS]].tolist()
    near = (
        f"the two came within {gap[0]:.3g} (in the units of the joints) of each other"
        if np.isfinite(gap[0]) else "neither grew"
    )  # fmt: skip
    return (
        f"expected a path from start to goal, found none {spent}: of {state[MOTIONS]} motions tried, the free ones "
        f"make a tree of {from_start} configurations from the start and one of {from_goals} from the goals; {near}. "
        f"{_what_is_between(growth)}There may be no path; a larger {option}, or another seed, may help"
    )


def _what_is_between(growth: Growth) -> str:
    """Describe what prevents motions from one tree to the other, from configurations spread over both."""
    judge, counts = growth.judge, growth.state[[STARTS, GOALS]].tolist()
    if judge.resolution:
        return ""
    spread = [np.unique(np.linspace(0, count - 1, BETWEEN, dtype=np.int64)) for count in counts]
    first, last = (growth.trees.nodes[tree][:, numbers].T for tree, numbers in enumerate(spread))
    nearest = lengths(first[:, None] - last).argmin(axis=1)
    a, b = growth.space.configurations(first), growth.space.configurations(last[nearest])
    found, parts = prove_by_rules(judge.ready, a, b, TOLERANCE, judge.joint_error), []
    close = f"come within {TOLERANCE:g} m of their margin"
    for verdict, how in ((codes.COLLIDING, "collide"), (codes.AMBIGUOUS, close)):
        pairs, often = np.unique(found.pairs[found.verdicts == verdict], return_counts=True)
        if len(pairs):
            names = " and ".join(judge.ready.names[k] for k in judge.ready.pairs[pairs[often.argmax()]])
            parts.append(f"{often.sum()} are {Verdict(verdict).name}, mostly since {names} {how}")
    return f"Of {len(a)} motions between the trees, {', and '.join(parts)}. " if parts else ""


def shortened(judge: Judge, path: Floats, *, max_iterations: int, seed: int) -> Floats:
    """Return a shorter path with the same ends; the judge has found all motions of both paths free."""
    count = len(path)
    judge = judge.up_to(float(np.sum(judge.checker.robot.distances(path[:-1], path[1:]))))
    asked = judge.asked()
    room = count + min(max_iterations, MOST_ROOM)
    fits_memory(8 * room * path.shape[1], f"a path of {room} configurations")
    rows, state = np.empty((room, path.shape[1])), np.zeros(STATE, dtype=np.int64)
    rows[:count] = path
    state[RANDOM] = seed
    ends, points = np.empty((2, path.shape[1])), np.empty((2, path.shape[1]))
    done = -1
    while done < max_iterations and count > 2 and done != state[ITERATION]:
        done = int(state[ITERATION])
        count = entries.shorten_path(count, min(done + AT_A_TIME, max_iterations), *asked, rows, state, ends, points)
    return rows[:count].copy()
