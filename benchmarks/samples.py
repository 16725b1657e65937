"""What the benchmarks run on: pairs of hulls, placed at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import linprog

from clock import threads_set_to
from loewner import Bodies
from loewner.paper import dataset

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Pairs:
    """Pairs of bodies with their poses.

    Attributes
    ----------
    name : str
    bodies : Bodies
        All that occur.
    a, b : ndarray of int, shape (n,)
        Which of them meet.
    Ta, Tb : ndarray, shape (n, 4, 4)
    still : bool
        Whether every Ta is the identity, so that ours need not be told.
    """

    name: str
    bodies: Bodies
    a: Array
    b: Array
    Ta: Array
    Tb: Array
    still: bool = False

    @cached_property
    def first(self) -> Bodies:
        """``bodies[a]``, a copy of every one: what the queries take."""
        return self.bodies[self.a]

    @cached_property
    def second(self) -> Bodies:
        return self.bodies[self.b]

    def __len__(self) -> int:
        return len(self.a)

    def part(self, chosen: Array | slice) -> Pairs:
        """Some of the pairs, over the same bodies."""
        return Pairs(
            self.name, self.bodies, self.a[chosen], self.b[chosen], self.Ta[chosen], self.Tb[chosen], self.still
        )

    def arguments(self) -> tuple[Bodies, Array | None, Bodies, Array]:
        """What `loewner.classify` and its like take."""
        return self.first, None if self.still else self.Ta, self.second, self.Tb


def fitted(point_sets: Sequence[Array] | Array) -> Bodies:
    """Hulls and fits on all threads: what is timed comes afterwards."""
    with threads_set_to(None):
        return Bodies.from_points(list(point_sets))


def rotations(rng: np.random.Generator, count: int) -> Array:
    """Uniform rotations, shape (count, 3, 3), from unit quaternions (wxyz)."""
    w, x, y, z = (q := rng.normal(size=(4, count))) / np.linalg.norm(q, axis=0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)


def poses(rotation: Array, translation: Array) -> Array:
    T = np.tile(np.eye(4), (len(rotation), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation, translation
    return T


def shifts(rng: np.random.Generator, count: int, largest: float = dataset.LARGEST_SHIFT) -> Array:
    """Uniform in [0, largest], along [1, 1, 1]."""
    return rng.uniform(0, largest, size=(count, 1)) * np.ones(3) / np.sqrt(3.0)


def paper_pairs(count: int, density: str = "volume", seed: int = 0, turned: bool = True) -> Pairs:
    """The paper's pairs of hulls of 20 points, every hull used once.

    The points are isotropic, so turning each hull changes nothing about the pairs; without it all rotations are
    the identity, which few users' are.
    """
    drawn = dataset.sample(count, seed, density)
    shift = drawn.shift[:, None] * np.ones(3) / np.sqrt(3.0)
    bodies = fitted([*drawn.points_1, *(drawn.points_2 - shift[:, None])])
    a = np.arange(count)
    if not turned:
        still = np.tile(np.eye(3), (count, 1, 1))
        Ta, Tb = poses(still, np.zeros((count, 3))), poses(still, shift)
        return Pairs(f"distinct hulls, {density}, shifted only", bodies, a, count + a, Ta, Tb, still=True)
    rng = np.random.default_rng(seed + 1)
    Ta, Tb = poses(rotations(rng, count), np.zeros((count, 3))), poses(rotations(rng, count), shift)
    return Pairs(f"distinct hulls, {density}", bodies, a, count + a, Ta, Tb)


def repeated_pairs(count: int, hulls: int = 100, seed: int = 0) -> Pairs:
    """A few hulls in many poses, as a planner meets them: all shapes stay in the processor's cache."""
    rng = np.random.default_rng(seed)
    drawn = dataset.sample(hulls, seed, "volume")
    bodies = fitted(drawn.points_1)
    a, b = rng.integers(hulls, size=(2, count))
    Ta, Tb = poses(rotations(rng, count), np.zeros((count, 3))), poses(rotations(rng, count), shifts(rng, count))
    return Pairs(f"{hulls} hulls in many poses", bodies, a, b, Ta, Tb)


def many_vertices(vertices: int, power: float, hulls: int, count: int, seed: int = 0) -> Pairs:
    """Hulls of so many points, all of them vertices, on |x|^p + |y|^p + |z|^p = 1.

    power 2 is the sphere, whose two ellipsoids close in on each other as vertices are added; power 4 lies halfway to
    the cube, and its two ellipsoids stay apart.
    """
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(hulls, vertices, 3))
    x /= (np.abs(x) ** power).sum(axis=2, keepdims=True) ** (1 / power)
    bodies = fitted(x)
    # Every hull meets one other, in as many poses: one call per two hulls, and no copies of large ones.
    a = np.arange(count) % hulls
    a.sort()
    b = (a + 1) % hulls
    Ta, Tb = poses(rotations(rng, count), np.zeros((count, 3))), poses(rotations(rng, count), shifts(rng, count, 2.5))
    return Pairs(f"{vertices} vertices, power {power:g}", bodies, a, b, Ta, Tb)


def clearance(A: Array, B: Array) -> float:
    """Widest slab between two point sets, by a linear program; negative if they overlap.

    Slow and independent of both sides: the judge where answers differ. Normals are scaled by their largest entry.
    """
    # max t  with  n·b - n·a >= t  through a free level h:  n·a <= h,  n·b >= h + t,  |n|_inf <= 1.
    rows = np.block([[A, -np.ones((len(A), 1)), np.zeros((len(A), 1))], [-B, np.ones((len(B), 2))]])
    bounds = [(-1, 1)] * 3 + [(None, None)] * 2
    best = -np.inf
    # |n| <= 1 admits n = 0 and t = 0: fix one entry at a time to ±1, so that overlaps get a negative t.
    for axis in range(3):
        for sign in (-1, 1):
            fixed = [*bounds]
            fixed[axis] = (sign, sign)
            found = linprog([0, 0, 0, 0, -1], A_ub=rows, b_ub=np.zeros(len(rows)), bounds=fixed, method="highs")
            if not found.success:
                raise ArithmeticError(f"linear program: {found.message}")
            best = max(best, -found.fun)
    return float(best)


def world_vertices(p: Pairs, k: int) -> tuple[Array, Array]:
    """Vertices of both hulls of one pair, in the world."""
    return tuple(
        body.pieces[0].vertices @ T[:3, :3].T + T[:3, 3] for body, T in ((p.first[k], p.Ta[k]), (p.second[k], p.Tb[k]))
    )
