"""Move a path away from obstacles: the cost rises near obstacles, and points of the path move to lower costs."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from loewner._base._validate import Bools, Floats, Ints
from loewner.planners.judge import Judge
from loewner.planners.space import Space
from loewner.robots.checking import distances
from loewner.robots.checking.problem import Problem

# Additional cost of a motion in contact, as a multiple of its length.
RISE = 9.0

# Smallest number of motions into which a path is divided, and largest number of motions of the result.
MOTIONS, MOST_MOTIONS = 48, 400

# Steps of a point, as shares of a motion's length: the first step; the factor that changes the step after a success,
# and after a failure; and the step below which the point is no longer moved.
FIRST_STEP, LONGER, SHORTER, LEAST_STEP = 1.0, 1.5, 0.5, 1e-3

# A point is left out if the cost rises by at most the share TOLERATED.
TOLERATED = 1e-3

# Largest distance between the points at which motions are measured, as a share of the path's length.
SHARE = 1 / 128


@dataclass(frozen=True, eq=False)
class Clearing:
    """The cost of a path near obstacles.

    The cost of a motion is the integral of its weighted length times 1 + 9 (1 - d / wanted)². Here, d is the robot's
    distance from the nearest unattached body of the scene, but at most `wanted`. The integral is computed by the
    trapezoidal rule.

    Attributes
    ----------
    judge : Judge
    ready : Problem
        The pairs of two bodies, one that the robot moves and one that it does not move.
    weights : ndarray, shape (dof,)
    wanted : float
        The wanted distance, in metres.
    """

    judge: Judge
    ready: Problem
    weights: Floats
    wanted: float

    @classmethod
    def of(cls, judge: Judge, weights: Floats, wanted: float) -> Clearing:
        """Make the cost for the state of the scene that a judge uses."""
        ready = judge.ready
        return cls(judge, ready.only(np.flatnonzero((ready.pairs >= len(ready.link)).any(axis=1))), weights, wanted)

    def cost_of(self, path: Floats) -> float:
        """Compute the cost of a path."""
        lengths = self._lengths(path[:-1], path[1:])
        return float(self._costs(path[:-1], path[1:], SHARE * lengths.sum()).sum())

    def least_distance(self, path: Floats) -> float:
        """Compute the robot's least distance from the scene at the points where the cost is computed."""
        if len(self.ready.pairs) == 0:
            return np.inf
        lengths = self._lengths(path[:-1], path[1:])
        _, Q = self._points(path[:-1], path[1:], SHARE * lengths.sum())[:2]
        return float(np.min(distances.nearest(self.ready, Q, True, False).distance))

    def cleared(self, space: Space, path: Floats, most: int, deadline: float) -> tuple[Floats, int]:
        """Move a free path away from obstacles; also return the number of rounds.

        The result is the moved path if it is free and cheaper, and otherwise `path`. Points move for three quarters of
        the available time; the clock is checked between rounds.
        """
        if self.cost_of(path) <= self._lengths(path[:-1], path[1:]).sum() * (1.0 + TOLERATED):
            return path, 0
        began = time.monotonic()
        until = began + 0.75 * (deadline - began)
        moved = self._divided(path)
        rounds, steps = 0, np.full(len(moved), FIRST_STEP)
        while rounds < most and (steps[1:-1] > LEAST_STEP).any() and time.monotonic() < until:
            for first in (1, 2):
                rows = np.arange(first, len(moved) - 1, 2)
                self._move(moved, rows[steps[rows] > LEAST_STEP], steps, space)
            rounds += 1
        moved = self._thinned(moved, deadline)
        cheaper = self.cost_of(moved) < self.cost_of(path) and self.judge.free(moved[:-1], moved[1:]).all()
        return (moved if cheaper else path), rounds

    def _move(self, path: Floats, rows: Ints, steps: Floats, space: Space) -> None:
        """Move points that are not neighbours down the cost's gradient, if the move is free and lowers the cost."""
        if len(rows) == 0:
            return
        before, here, after = path[rows - 1], path[rows], path[rows + 1]
        sides = np.concatenate([before, after])
        at, slopes = self._densities(here, gradient=True)
        beside = self._densities(sides)[0].reshape(2, -1)
        lengths = self._lengths(np.concatenate([before, here]), np.concatenate([here, after])).reshape(2, -1)
        means, squares = 0.5 * (at + beside), self.weights**2
        apart = np.maximum(lengths, np.finfo(float).tiny)[:, :, None]
        pull = means[:, :, None] * ((here - np.stack([before, after])) / apart)  # a quotient of two zeros is 0 here
        down = -(0.5 * lengths.sum(axis=0)[:, None] * slopes / squares + pull.sum(axis=0))
        # Points move only sideways; otherwise, they would gather along the path where the cost is low.
        along = (after - before) * self.weights
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), np.finfo(float).tiny)
        down *= self.weights
        down -= (down * along).sum(axis=1, keepdims=True) * along
        down /= np.maximum(np.linalg.norm(down, axis=1, keepdims=True), np.finfo(float).tiny)
        there = here.copy()
        step = (steps[rows] * lengths.mean(axis=0))[:, None] * down / self.weights
        moved = (there + step)[:, space.columns]
        there[:, space.columns] = np.where(space.turning, moved, moved.clip(space.lower, space.upper))
        then = self._lengths(np.concatenate([before, there]), np.concatenate([there, after])).reshape(2, -1)
        cheaper = (then * 0.5 * (self._densities(there)[0] + beside)).sum(axis=0) < (lengths * means).sum(axis=0)
        cheaper &= self._free(before, there, after, cheaper)
        path[rows[cheaper]] = there[cheaper]
        steps[rows] *= np.where(cheaper, LONGER, SHORTER)

    def _free(self, before: Floats, there: Floats, after: Floats, chosen: Bools) -> Bools:
        """Return which points have free motions to both neighbours; only the `chosen` points are tried."""
        free = np.zeros(len(there), dtype=bool)
        a, b = np.concatenate([before[chosen], there[chosen]]), np.concatenate([there[chosen], after[chosen]])
        free[chosen] = self.judge.free(a, b).reshape(2, -1).all(axis=0)
        return free

    def _divided(self, path: Floats) -> Floats:
        """Divide the motions of a path into parts of about equal lengths."""
        lengths = self._lengths(path[:-1], path[1:])
        counts = np.maximum(np.ceil(MOTIONS * lengths / max(lengths.sum(), np.finfo(float).tiny)).astype(int), 1)
        if counts.sum() > MOST_MOTIONS:
            counts[:] = 1
        rows = [a + (b - a) * (np.arange(n) / n)[:, None] for a, b, n in zip(path[:-1], path[1:], counts, strict=True)]
        return np.concatenate([*rows, path[-1:]])

    def _thinned(self, path: Floats, deadline: float) -> Floats:
        """Remove points if the direct motion between their neighbours is free and costs hardly more."""
        path, left = path.copy(), True
        while left and len(path) > 2 and time.monotonic() < deadline:
            left = False
            for first in (1, 2):
                rows = np.arange(first, len(path) - 1, 2)
                if len(rows) == 0:
                    continue
                before, here, after = path[rows - 1], path[rows], path[rows + 1]
                part = SHARE * self._lengths(path[:-1], path[1:]).sum()
                with_it = self._costs(before, here, part) + self._costs(here, after, part)
                cheap = self._costs(before, after, part) <= (1.0 + TOLERATED) * with_it
                cheap[cheap] = self.judge.free(before[cheap], after[cheap])
                path, left = np.delete(path, rows[cheap], axis=0), left or bool(cheap.any())
        return path

    def _lengths(self, a: Floats, b: Floats) -> Floats:
        """Compute weighted lengths of motions."""
        return np.asarray(np.linalg.norm((b - a) * self.weights, axis=1))

    def _costs(self, a: Floats, b: Floats, part: float) -> Floats:
        """Compute the costs of motions, each divided into parts of at most the given length."""
        motion, Q, counts, at_end = self._points(a, b, part)
        means = np.bincount(motion, np.where(at_end, 0.5, 1.0) * self._densities(Q)[0], len(a)) / counts
        return np.asarray(self._lengths(a, b) * means)

    def _points(self, a: Floats, b: Floats, part: float) -> tuple[Ints, Floats, Ints, Bools]:
        """Divide motions; return the motion of each point, the points, the part counts, and which points are ends."""
        counts = np.maximum(np.ceil(self._lengths(a, b) / max(part, np.finfo(float).tiny)), 1).astype(int)
        motion = np.repeat(np.arange(len(a)), counts + 1)
        k = np.arange(len(motion)) - np.repeat(np.cumsum(counts + 1) - counts - 1, counts + 1)
        Q = a[motion] + (k / counts[motion])[:, None] * (b - a)[motion]
        return motion, Q, counts, (k == 0) | (k == counts[motion])

    def _densities(self, Q: Floats, gradient: bool = False) -> tuple[Floats, Floats]:
        """Compute the costs per length at configurations and, if requested, their gradients."""
        slopes = np.zeros_like(Q)
        if len(self.ready.pairs) == 0 or len(Q) == 0:
            return np.ones(len(Q)), slopes
        nearest = distances.nearest(self.ready, np.ascontiguousarray(Q), True, gradient)
        short = np.maximum(1.0 - np.maximum(nearest.distance, 0.0) / self.wanted, 0.0)
        if nearest.gradient is not None:
            slopes = (-2.0 * RISE / self.wanted * short)[:, None] * nearest.gradient
        return 1.0 + RISE * short * short, slopes
