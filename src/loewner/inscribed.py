"""Ellipsoids inside the solid that a closed triangle mesh bounds, each proven to lie in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from loewner import _validate
from loewner._guard import guarded
from loewner._native import entries
from loewner._validate import Floats
from loewner.errors import InputError
from loewner.polytopes import writeable

# The least closed surface is that of a tetrahedron.
FEWEST_TRIANGLES = 4


@guarded
def inscribed_ellipsoids(vertices: ArrayLike, triangles: ArrayLike, count: int) -> tuple[Floats, Floats]:
    """Find a few ellipsoids that lie inside a closed mesh and together hold much of its volume.

    Parameters
    ----------
    vertices : array_like, shape (v, 3)
        In metres.
    triangles : array_like of int, shape (t, 3)
        Vertices of each triangle, at least four triangles. The mesh is taken to be closed, with triangles that agree
        about their common edges, which is not checked here. It may meet itself, have several parts, cavities and
        triangles without area; its triangles may all be turned inside out.
    count : int
        How many ellipsoids at most.

    Returns
    -------
    centers : ndarray, shape (k, 3)
    factors : ndarray, shape (k, 3, 3)
        Lower triangular: the ellipsoid is {c + F z : |z| <= 1}. The largest is first; ``k <= count``, and 0 if
        none of a sensible size was found.

    Raises
    ------
    InputError
        On wrong shapes, entries that are not finite, indices of vertices that are not there, or a wrong count.

    Notes
    -----
    Inside are the points that the surface winds around, whatever the direction. No triangle meets an ellipsoid exactly
    as it is stored, whatever the rounding, and a point of it is inside: so all of it is. How good the ellipsoids are is
    not proven. The first is close to the largest one where the solid is convex.

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
        raise InputError(
            f"triangles: expected shape (t, 3) with t >= {FEWEST_TRIANGLES}, "
            f"found {_validate.shape_text(corners.shape)}"
        )
    if corners.min() < 0 or corners.max() >= len(x):
        raise InputError(f"triangles: expected indices of {len(x)} vertices, found {corners.min()} to {corners.max()}")
    most = _validate.whole_number(count, "count", 1)
    centers, factors = np.zeros((most, 3)), np.zeros((most, 3, 3))
    found = entries.inscribed_ellipsoids(x, corners, centers, factors)
    return centers[:found].copy(), factors[:found].copy()
