"""Robots of sliding joints beside a wall, for which fractions decide whether a whole motion is free.

Tool and wall are boxes along the axes, however they are made into bodies. They overlap in two of the axes for the whole
motion, so their distance is the gap along the third one, which is linear in time: what holds at both ends holds at
every moment.
"""

from collections import Counter
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from loewner import Body, CollisionChecker, Robot, Scene, Verdict

KINDS = ("box", "hull", "surface", "voxels")

# COLLIDING is what `collide` says of configurations as they are placed in doubles: two bodies that are apart by less
# than this share of the lengths may count as touching (docs/verification.md).
TOUCHING = Fraction(1, 10**12)

# Corners of a box in the order of their numbers in binary, and its faces with their normals outwards.
CORNERS = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([(f[0], f[i], f[i + 1]) for f in FACES for i in (1, 2)])


class Bounds(NamedTuple):
    """A body that is exactly the box between two corners of doubles, in its own frame."""

    body: Body
    low: np.ndarray
    high: np.ndarray


class Slide(NamedTuple):
    """A checker, motions of its robot, and what fractions need to know about them."""

    checker: CollisionChecker
    start: np.ndarray  # (motions, 3)
    end: np.ndarray
    tolerance: float
    size: float
    margin: float
    axis: int  # along which the gap is
    side: int  # of the tool on which the wall is, 1 or -1
    signs: np.ndarray  # of the joints' axes
    fixed: list[np.ndarray]  # translations that add up to the tool's frame at 0
    tool: Bounds
    wall: Bounds
    wall_at: np.ndarray

    def excess(self, q: list[Fraction], axis: int, side: int) -> Fraction:
        """By how much the gap on a side along an axis exceeds the margin, at a configuration of fractions."""
        tool = sum((Fraction(float(t[axis])) for t in self.fixed), int(self.signs[axis]) * q[axis])
        wall = Fraction(float(self.wall_at[axis]))
        near, far = (self.tool.high, self.wall.low) if side > 0 else (self.tool.low, self.wall.high)
        gap = side * (wall + Fraction(float(far[axis])) - tool - Fraction(float(near[axis])))
        return gap - Fraction(self.margin)

    def at(self, k: int, t: float) -> list[Fraction]:
        """The configuration at a fraction of a motion."""
        a, b = ([Fraction(float(x)) for x in row] for row in (self.start[k], self.end[k]))
        return [x + Fraction(t) * (y - x) for x, y in zip(a, b, strict=True)]

    def lengths(self) -> Fraction:
        """All lengths that rounding is relative to."""
        vectors = [*self.fixed, self.wall_at, self.start, self.end, self.tool.high, self.wall.high]
        return Fraction(float(sum(np.abs(v).max() for v in vectors)))


def body_of(rng: np.random.Generator, kind: str, cells: np.ndarray, size: float) -> Bounds:
    """A box of so many cells along each axis, of about a size in all."""
    edge = float(np.float16(rng.uniform(1, 2))) * 2.0 ** np.floor(np.log2(size / cells.max()))  # no product rounds
    if kind == "voxels":
        origin = -edge * rng.integers(0, cells + 1)
        return Bounds(Body.from_voxels(np.ones(cells, bool), edge, origin=origin), origin, origin + edge * cells)
    if kind == "box":
        sizes = cells * edge * rng.uniform(0.5, 1, 3)
        return Bounds(Body.box(sizes), -sizes / 2, sizes / 2)
    low = -cells * edge * rng.uniform(0, 1, 3)
    high = low + cells * edge
    corners = np.where(CORNERS, high, low)
    return Bounds(
        Body.from_points(corners) if kind == "hull" else Body.from_surface((corners, TRIANGLES)), low, high
    )  # fmt: skip


def slide(rng: np.random.Generator, count: int) -> Slide:
    """A robot and a wall at random, and motions along or towards it, or away, at gaps of 1e-12 to 1e-2 of the size."""
    size = 10 ** rng.uniform(-6, 6)
    axis, side = int(rng.integers(3)), int(rng.choice([-1, 1]))
    others = [k for k in range(3) if k != axis]
    tool = body_of(rng, str(rng.choice(KINDS)), rng.integers(1, 4, 3), size)
    flat = np.full(3, 12)
    flat[axis] = rng.integers(1, 3)
    wall = body_of(rng, str(rng.choice(KINDS)), flat, 30 * size)
    away = size * 10 ** rng.uniform(-1, 6) if rng.random() < 0.7 else 0.0
    fixed = [away * rng.uniform(-1, 1, 3), *(size * rng.uniform(-1, 1, (3, 3)) * (rng.random() < 0.5))]
    signs = rng.choice([-1, 1], 3)
    wall_at = sum(fixed) + size * rng.uniform(-1, 1, 3) - (wall.low + wall.high) / 2
    margin = float(size * 10 ** rng.uniform(-3, 0)) if rng.random() < 0.3 else 0.0

    rows = "".join(
        f'<joint name="j{k}" type="prismatic"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{" ".join(repr(float(x)) for x in fixed[k + 1])}"/>'
        f'<axis xyz="{" ".join(str(signs[k] * (i == k)) for i in range(3))}"/>'
        f'<limit lower="{-1e3 * size!r}" upper="{1e3 * size!r}"/></joint>'
        for k in range(3)
    )
    links = "".join(f'<link name="l{k}"/>' for k in range(4))
    base = np.eye(4)
    base[:3, 3] = fixed[0]
    robot = Robot.from_urdf(text=f'<robot name="slides">{links}{rows}</robot>').placed(base)
    robot = replace(robot, bodies={"l3": tool.body})
    scene, T_world_wall = Scene(margin=margin), np.eye(4)
    T_world_wall[:3, 3] = wall_at
    scene.add("wall", wall.body, T_world_wall)

    near = size * rng.choice([-1, 1], (2, count), p=[0.2, 0.8]) * 10 ** rng.uniform(-12, -2, (2, count))
    kind = rng.integers(4, size=count)
    near[1, kind == 0] = near[0, kind == 0]  # along the wall
    near[0, kind == 1] = size * rng.uniform(0.1, 3, (kind == 1).sum())  # towards it
    near[1, kind == 2] = size * rng.uniform(0.1, 3, (kind == 2).sum())  # away from it
    Q = np.empty((2, count, 3))
    zero = sum(fixed)
    for k in others:
        middle = wall_at[k] + (wall.low[k] + wall.high[k] - tool.low[k] - tool.high[k]) / 2 - zero[k]
        Q[:, :, k] = signs[k] * (middle + size * rng.uniform(-1, 1, (2, count)))
    face = wall_at[axis] + (wall.low[axis] if side > 0 else wall.high[axis])
    reach = tool.high[axis] if side > 0 else tool.low[axis]
    Q[:, :, axis] = signs[axis] * (face - side * (near + margin) - reach - zero[axis])
    return Slide(
        CollisionChecker(robot, scene), Q[0], Q[1], size * 10 ** rng.uniform(-5.5, -4.5), size, margin,
        axis, side, signs, fixed, tool, wall, wall_at,
    )  # fmt: skip


def judged(given: Slide) -> tuple[list[str], Counter[str]]:
    """What is wrong with the verdicts of some motions, and how many there were of each kind."""
    found = given.checker.certify_edges(given.start, given.end, tolerance=given.tolerance)
    wrong, counts = [], Counter[str]()
    touching = TOUCHING * given.lengths()
    for k, verdict in enumerate(found.verdict):
        ends = [given.at(k, t) for t in (0.0, 1.0)]
        for other in (n for n in range(3) if n != given.axis):
            assert all(given.excess(q, other, side) < -Fraction(given.margin) for q in ends for side in (-1, 1))
        gaps = [given.excess(q, given.axis, given.side) for q in ends]
        counts[Verdict(verdict).name] += 1
        if verdict == Verdict.FREE:
            counts["near"] += min(gaps) < Fraction(1e-6 * given.size)
            if min(gaps) <= 0:
                wrong.append(f"motion {k} is FREE, and meets the wall: {float(min(gaps) / Fraction(given.size)):g}")
        elif verdict == Verdict.COLLIDING:
            excess = given.excess(given.at(k, float(found.fraction[k])), given.axis, given.side)
            counts["rounded"] += excess > 0
            if excess > touching:
                wrong.append(f"motion {k} is COLLIDING at {found.fraction[k]}, and free there by {float(excess):g}")
    return wrong, counts
