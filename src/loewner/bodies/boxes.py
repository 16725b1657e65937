"""Find an orientation in which the box around points or triangles has a small surface area."""

from __future__ import annotations

from functools import cache

import numpy as np

from loewner._base import _elementary
from loewner._base._validate import Floats

# Largest number of triangles used to choose an orientation.
MOST_ASKED = 512

# Boxes are tried along this many of a hull's longest edges.
MOST_EDGES = 8

# Every side of a box counts as longer by this share of the longest side. Between two flat boxes of equal area, the more
# compact one is then chosen.
THICKNESS = 0.01


def least_box_axes(triangles: Floats) -> Floats:
    """Try several boxes around triangles, and return the axes of the box with the least surface area, as columns.

    Parameters
    ----------
    triangles : ndarray, shape (3, corners, n)
        Coordinates x, y and z of the corners. A point is passed as a triangle with one corner.

    Returns
    -------
    ndarray, shape (3, 3)
        Orthonormal up to rounding.
    """
    sample = triangles[:, :, :: -(-triangles.shape[2] // MOST_ASKED)]
    tried = _turns(sample)
    sides = np.ptp(tried.transpose(0, 2, 1) @ sample.reshape(3, -1), axis=2)
    flat = THICKNESS * sides.max(axis=1, keepdims=True)
    return np.asarray(tried[((sides + flat) * np.roll(sides + flat, 1, axis=1)).sum(axis=1).argmin()])


def _turns(triangles: Floats) -> Floats:
    """List candidate axes of boxes, shape (k, 3, 3): the axes of the frame, the principal axes, and axes along a face.

    The axes along a face begin with the normal of the largest triangle. All points are projected along this normal. The
    second axis follows an edge of the hull of the projections, because the smallest rectangle around points in a plane
    has a side along an edge of their hull.

    Freeman and Shapira (1975), Determining the minimum-area encasing rectangle for an arbitrary closed curve.
    """
    points = triangles.reshape(3, -1)
    off = points - points.mean(axis=1, keepdims=True)
    plain = np.stack([np.eye(3), np.linalg.eigh(off @ off.T)[1]])
    if triangles.shape[1] == 1:
        return plain
    a, b, c = triangles.transpose(1, 2, 0)
    normals = np.cross(b - a, c - a)
    normal = normals[(normals**2).sum(axis=1).argmax()]
    if not normal.any():
        return plain
    frame = np.linalg.qr(np.column_stack([normal / np.abs(normal).max(), np.eye(3)]))[0]
    along = _directions(off.T @ frame[:, 1:])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    seen = np.broadcast_to(frame[:, 0], (len(along), 3))
    return np.concatenate([plain, np.stack([seen, along @ frame[:, 1:].T, across @ frame[:, 1:].T], axis=2)])


@cache
def _looks() -> Floats:
    """Return directions, shape (2, k). The farthest points in these directions approximate a hull.

    An exact hull would need SciPy, whose import takes longer than this search.
    """
    angles = np.arange(64) * (np.pi / 32)
    return np.stack([_elementary.cos(angles), _elementary.sin(angles)])


def _directions(points: Floats) -> Floats:
    """Find unit vectors, shape (k, 2), along the longest edges of the approximate hull of points in a plane."""
    rim = points[(points @ _looks()).argmax(axis=0)]
    edges = np.roll(rim, -1, axis=0) - rim
    lengths = np.linalg.norm(edges, axis=1)
    longest = lengths.argsort(kind="stable")[-MOST_EDGES:]
    longest = longest[lengths[longest] > 0]
    return np.asarray(edges[longest] / lengths[longest, None])
