"""Surfaces in parts, for proofs of motions: these see a piece as a box around it, and small boxes leave more free."""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import count
from weakref import WeakKeyDictionary

import numpy as np

from loewner._kernels import columns
from loewner._validate import Floats, Ints
from loewner.bodies.layout import starts
from loewner.bodies.pack import Packed, Prepared, joined, some
from loewner.bodies.surface_trees import SurfaceTree, surface_trees
from loewner.bodies.surfaces import surface_pieces
from loewner.errors import GeometryError

# Parts of a surface, and of all surfaces of a pack together: each takes a millisecond to make.
MOST_PARTS, ALL_PARTS = 128, 1024

# What a flat part counts as thick, relative to the whole.
THICKNESS = 0.01

# Certified log-volume gap of the ellipsoids around parts: a box is what counts.
TOLERANCE = 1e-2

# Of surfaces, by their trees: so many parts at most, or None of one that cannot be cut.
_known: WeakKeyDictionary[SurfaceTree, tuple[int, Prepared | None]] = WeakKeyDictionary()


def in_parts(packed: Packed, first: int) -> Packed:
    """The same bodies, with surfaces cut into parts, each a piece of its own; the same pack if there are none.

    Parts of a solid are of its surface alone: what stays clear of all of them stays outside if it was outside once.

    Parameters
    ----------
    packed : Packed
    first : int
        Number of the first body whose surfaces are cut.
    """
    standing = [i for i in packed.trees if i >= packed.piece_start[first]]
    # A power of two, lest each surface that is added has all others cut anew.
    most = MOST_PARTS
    while most * len(standing) > ALL_PARTS:
        most //= 2
    cut = {i: _parts_of(packed, i, most) for i in standing}
    rows: list[Prepared] = []
    counts, done = np.ones(len(packed.layout), dtype=np.int64), 0
    for i, parts in cut.items():
        if parts is not None:
            rows += [_as_they_are(packed, done, i), parts]
            counts[i], done = len(parts.layout), i + 1
    if not rows:
        return packed
    rows.append(_as_they_are(packed, done, len(packed.layout)))
    return replace(joined(rows), piece_start=starts(counts)[packed.piece_start]).packed()


def _as_they_are(packed: Packed, first: int, last: int) -> Prepared:
    return some(packed, np.arange(first, last), np.array([0, last - first]))


def _parts_of(packed: Packed, i: int, most: int) -> Prepared | None:
    """Parts of a surface, made once; None if they would be one, or if one of them is too small for kernels."""
    tree = packed.trees[i]
    known = _known.get(tree)
    if known is None or known[0] != most:
        try:
            known = most, _cut(packed, i, most)
        except GeometryError:
            known = most, None
        _known[tree] = known
    return known[1]


def _cut(packed: Packed, i: int, most: int) -> Prepared | None:
    row, radius = packed.layout[i], float(packed.frames[i, 0])
    vertices = packed.points[row[columns.POINTS_FROM] : row[columns.POINTS_TO]]
    triangles = packed.triangles[packed.triangle_start[i] : packed.triangle_start[i + 1]]
    if min(len(triangles), most) < 2:
        return None
    # The triangles of a cloud are points.
    corners = triangles[:, :1] if (triangles == triangles[:, :1]).all() else triangles
    made = []
    for part in _halved(vertices[corners], radius, most):
        pieces = surface_pieces("part", vertices, triangles[part], radius, False, TOLERANCE)
        trees = surface_trees(pieces.layout, pieces.points, pieces.triangles, pieces.triangle_start)
        made.append(Prepared(**vars(pieces), maps={}, trees=trees))
    return joined(made)


def _halved(triangles: Floats, radius: float, most: int) -> list[Ints]:
    """Numbers of the triangles of each part: the one with most empty box is halved, across one of its axes.

    Parameters
    ----------
    triangles : ndarray, shape (n, corners, 3)
    radius : float
        Around them, in metres.
    most : int
        Parts.
    """
    numbers = count()  # of parts with equal boxes the older one comes first
    # Flat boxes have volume, too, and triangles fill it: what lies in one plane may be far apart there.
    thick = THICKNESS * float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    filled = thick * _areas(triangles)

    def entry(part: Ints) -> tuple[float, int, Ints, Floats]:
        points = triangles[part].reshape(-1, 3)
        off = points - points.mean(axis=0)
        turned = (off @ np.linalg.eigh(off.T @ off)[1]).reshape(len(part), -1, 3)
        empty = float((_sides(turned, radius) + thick).prod() - filled[part].sum()) if len(part) > 1 else 0.0
        return -empty, next(numbers), part, turned

    parts = [entry(np.arange(len(triangles)))]
    while len(parts) < most and parts[0][0] < 0:
        _, _, part, turned = heapq.heappop(parts)
        for half in _halves(turned, radius):
            heapq.heappush(parts, entry(part[half]))
    return [part for _, _, part, _ in parts]


def _halves(turned: Floats, radius: float) -> tuple[Ints, Ints]:
    """Two halves of some triangles, across the axis that leaves their boxes least surface; of points, the longest."""

    def surface(half: Ints) -> float:
        sides = _sides(turned[half], radius)
        return float(sides @ np.roll(sides, 1))

    middle = len(turned) // 2
    axes = turned.sum(axis=1).T[-1 if turned.shape[1] == 1 else 0 :]
    orders = [np.argpartition(along, middle) for along in axes]
    halves = [(order[:middle], order[middle:]) for order in orders]
    return min(halves, key=lambda two: surface(two[0]) + surface(two[1]))


def _areas(triangles: Floats) -> Floats:
    """Of each; points have none."""
    if triangles.shape[1] == 1:
        return np.zeros(len(triangles))
    a, b, c = triangles.transpose(1, 0, 2)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2


def _sides(points: Floats, radius: float) -> Floats:
    """Of the box around points, shape (..., 3), with a radius."""
    return np.asarray(np.ptp(points.reshape(-1, 3), axis=0) + 2 * radius)
