"""Find ellipsoids that are proven to lie inside the solid bounded by a closed triangle mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats, Ints
from loewner._base._workspaces import workspace
from loewner._kernels.columns import NODE_BITS
from loewner._native import entries
from loewner.ellipsoids.polytopes import writeable
from loewner.errors import InputError
from loewner.meshes.triangles import FramedTree

# The smallest closed surface is a tetrahedron.
FEWEST_TRIANGLES = 4

# A tree in the mesh's own coordinates is used under two conditions, since its boxes are stored in single precision: the
# mesh's distance from the origin is at most FAR times its size, and squares and cubes of lengths stay in range.
FAR = 1e3
SMALL, LARGE = 1e-10, 1e10


@guarded
def inscribed_ellipsoids(
    vertices: ArrayLike, triangles: ArrayLike, count: int, tree: tuple[NDArray[Any], Ints] | None = None
) -> tuple[Floats, Floats]:
    """Find a few ellipsoids that lie inside a closed mesh and together cover much of its volume.

    Parameters
    ----------
    vertices : array_like, shape (v, 3)
        Vertices in metres.
    triangles : array_like of int, shape (t, 3)
        Vertex indices of at least four triangles. The mesh is assumed to be closed, with triangles consistently
        oriented at common edges; this assumption is not checked. The mesh may intersect itself, may have several parts,
        cavities and triangles without area, and may be inside out as a whole.
    count : int
        The largest number of ellipsoids.
    tree : tuple of ndarray, optional
        Boxes of a tree over these triangles, and the table of its arrays; by default a tree is built.

    Returns
    -------
    centers : ndarray, shape (k, 3)
    factors : ndarray, shape (k, 3, 3)
        Lower triangular factors F of the ellipsoids {c + F z : |z| <= 1}, the largest ellipsoid first. ``k <= count``,
        and k is 0 if no ellipsoid of a sensible size was found.

    Raises
    ------
    InputError
        If shapes are wrong, entries are not finite, indices are out of range, or `count` is not a positive integer.

    Notes
    -----
    A point is inside if the surface winds around it, in either direction. Despite rounding, no triangle meets a stored
    ellipsoid, and one point of the ellipsoid is inside the solid, so the whole ellipsoid is inside. The ellipsoids are
    not proven to be the largest possible; in a convex solid, the first ellipsoid is close to the largest.

    References
    ----------
    Deits and Tedrake (2015), doi:10.1007/978-3-319-16595-0_7.

    Examples
    --------
    >>> vertices = [[0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 3]]
    >>> centers, factors = inscribed_ellipsoids(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], 1)
    >>> centers.round(2)
    array([[0.75, 0.75, 0.75]])
    """
    x = writeable(_validate.finite_array(vertices, "vertices", ("v", 3)))
    corners = writeable(_validate.integer_array(triangles, "triangles"))
    if corners.ndim != 2 or corners.shape[1] != 3 or len(corners) < FEWEST_TRIANGLES:
        shape = _validate.shape_text(corners.shape)
        raise InputError(f"triangles: expected shape (t, 3) with t >= {FEWEST_TRIANGLES}, found {shape}")
    if corners.min() < 0 or corners.max() >= len(x):
        raise InputError(f"triangles: expected indices of {len(x)} vertices, found {corners.min()} to {corners.max()}")
    most = _validate.whole_number(count, "count", 1)
    centers, factors = np.zeros((most, 3)), np.zeros((most, 3, 3))
    origin, scale = np.zeros(3), 1.0
    if tree is None or not _near(*_extent(tree[0])):
        framed_tree = FramedTree.of(x[corners].reshape(-1, 3))
        origin, scale, tree = framed_tree.origin, framed_tree.scale, (framed_tree.arrays[0], framed_tree.table)
    size, far = _extent(tree[0])
    memory = workspace(entries.points_memory())
    k = entries.inscribed_ellipsoids(tree[1].ctypes.data, size, far, origin, scale, centers, factors, memory)
    return centers[:k].copy(), factors[:k].copy()


def _extent(boxes: NDArray[Any]) -> tuple[float, float]:
    """Return half the longest edge of the box around a tree, and the largest coordinate."""
    middle, half = boxes[: 6 << NODE_BITS : 1 << NODE_BITS].astype(float).reshape(2, 3)
    return float(half.max()), float((np.abs(middle) + half).max())


def _near(size: float, far: float) -> bool:
    return far <= FAR * size and SMALL < size < LARGE
