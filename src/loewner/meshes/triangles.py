"""Halve many triangles in space, cut them along planes, and compute their distances from points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loewner._base._matrices import dot, lengths, normals_of, power
from loewner._base._validate import Floats, Ints
from loewner._kernels import records
from loewner._native import entries

# A triangle whose height is less than this share of its longest edge has no reliable normal. Such a triangle is
# replaced with its edges, which contain the whole triangle up to that height.
SLIVER = 1e-12


def halved(triangles: Floats, edge: Ints) -> Floats:
    """Halve each triangle across the edge that starts at a given corner; all first halves precede the second halves."""
    row = np.arange(len(triangles))
    a, b, c = (triangles[row, (edge + k) % 3] for k in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def longest_edges(triangles: Floats) -> tuple[Floats, Ints]:
    """Find the length of each triangle's longest edge, and the corner at which that edge starts."""
    edges = lengths(triangles - np.roll(triangles, -1, axis=1))
    return edges.max(axis=1), edges.argmax(axis=1)


def unit_normals(triangles: Floats) -> Floats:
    """Compute right-handed unit normals; zero for slivers."""
    normals = normals_of(triangles)
    length = lengths(normals)
    sound = length > SLIVER * power(longest_edges(triangles)[0], 2)
    return np.where(sound[:, None], normals / np.where(sound, length, 1.0)[:, None], 0.0)


def cut(triangles: Floats, normals: Floats, offsets: Floats, rounding: float) -> tuple[Floats, Ints, Floats, Ints]:
    """Cut each triangle along a plane.

    Parameters
    ----------
    triangles : ndarray, shape (t, 3, 3)
    normals : ndarray, shape (t, 3)
        One plane {x : normal x = offset} per triangle.
    offsets : ndarray, shape (t,)
    rounding : float
        Corners within this distance of the plane count as lying in it. A triangle in the plane belongs to the side
        behind the triangle, since this side contains the solid that the triangle bounds.

    Returns
    -------
    below, above : ndarray, shapes (k, 3, 3)
        The parts below and above the planes; each array is followed by the indices of the triangles from which the
        parts come.
    """
    height = dot(triangles, normals[:, None]) - offsets[:, None]
    height[np.abs(height) <= rounding] = 0.0
    lower, upper = (height < 0).sum(axis=1), (height > 0).sum(axis=1)
    crossed = np.flatnonzero((lower > 0) & (upper > 0))
    in_plane = np.flatnonzero((lower == 0) & (upper == 0))
    facing = dot(normals_of(triangles[in_plane]), normals[in_plane]) > 0
    # Triangles in the plane are treated like triangles on one side.
    lower[in_plane[facing]] = upper[in_plane[~facing]] = 1
    whole_below = np.flatnonzero((lower > 0) & (upper == 0))
    whole_above = np.flatnonzero((upper > 0) & (lower == 0))

    # The corner `a` is alone on its side; the other two corners may lie in the plane.
    single_below = lower[crossed] == 1
    alone = np.where(single_below, (height[crossed] < 0).argmax(axis=1), (height[crossed] > 0).argmax(axis=1))
    (a, b, c), (ha, hb, hc) = (
        [values[crossed, (alone + k) % 3] for k in range(3)] for values in (triangles, height)
    )  # fmt: skip
    ab = np.where((hb == 0)[:, None], b, a + (b - a) * (ha / (ha - hb))[:, None])
    ac = np.where((hc == 0)[:, None], c, a + (c - a) * (ha / (ha - hc))[:, None])
    tips = np.stack([a, ab, ac], axis=1)
    rests = [(np.stack([ab, b, c], axis=1), hb != 0), (np.stack([ab, c, ac], axis=1), hc != 0)]

    parts, origins = [], []
    for whole, tip_here in ((whole_below, single_below), (whole_above, ~single_below)):
        picked = [(triangles[whole], whole), (tips[tip_here], crossed[tip_here])]
        picked += [(rest[there & ~tip_here], crossed[there & ~tip_here]) for rest, there in rests]
        parts.append(np.concatenate([part for part, _ in picked]))
        origins.append(np.concatenate([origin for _, origin in picked]))
    return parts[0], origins[0], parts[1], origins[1]


def squared_distances(points: Floats, triangles: Floats) -> Floats:
    """Compute squared distances of points, shape (n, 3), from one triangle each, shape (n, 3, 3), which may be thin."""
    squared = np.empty(len(points))
    entries.squared_distances_of(np.ascontiguousarray(points), np.ascontiguousarray(triangles), squared)
    return squared


@dataclass(frozen=True, eq=False)
class FramedTree:
    """A tree over triangles whose corners are measured from the center of their box and scaled by a power of two.

    The scaled size is near 1. Rounding is therefore relative to the size of the mesh, and single precision suffices for
    the boxes of the tree.

    Attributes
    ----------
    origin : ndarray, shape (3,)
    scale : float
    arrays : tuple of ndarray
        Boxes, children and blocks of the tree, the first corner, and the diagonals.
    numbers : ndarray of int64
        Index of the triangle at each place in the blocks.
    table : ndarray of int64
        Addresses of the arrays; kernels receive the address of this table.
    """

    origin: Floats
    scale: float
    arrays: tuple[Any, ...]
    numbers: Ints
    table: Ints

    @classmethod
    def of(cls, corners: Floats) -> FramedTree:
        """Build the tree over triangles given by their corners, shape (3 t, 3)."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        origin, scale = low / 2 + high / 2, 2.0 ** min(1000, -int(np.frexp((high - low).max())[1]))
        points = framed(corners, origin, scale)
        boxes, children, blocks, diagonals, _, numbers = entries.triangle_tree(
            points, np.arange(len(corners)).reshape(-1, 3)
        )
        arrays = boxes.astype(np.float32), children, blocks, points[0].copy(), diagonals.astype(np.float32)
        return cls(origin, scale, arrays, numbers, records.table_of(arrays))


def framed(points: Floats, origin: Floats, scale: float) -> Floats:
    """Convert points to the coordinates of a tree."""
    return np.ascontiguousarray((points - origin) * scale)
