"""Compute the overlap, the contact function and near points of two ellipsoids.

Every function takes two `Ellipsoids`, single or batches, and broadcasts their batch shapes. Only the difference between
the centers is used, so a distant world origin costs no accuracy. All quantities are scaled to the size of the
ellipsoids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats, Ints
from loewner._kernels import codes
from loewner._native import entries
from loewner.ellipsoids.ellipsoids import Ellipsoids
from loewner.errors import ConvergenceError, GeometryError, InputError

NEAR_POINT_METHODS = {"rimon-boyd": codes.RIMON_BOYD, "lin-han": codes.LIN_HAN, "center-line": codes.CENTER_LINE}


@dataclass(frozen=True, repr=False)
class NearPoints(_validate.Brief):
    """The near points of pairs of ellipsoids.

    Attributes
    ----------
    point_1, point_2 : ndarray, shape (..., 3)
        A point on the first ellipsoid and a point on the second, in metres. If an overlap was found, the two points are
        equal and lie in both ellipsoids.
    distance : ndarray, shape (...)
        ``|point_2 - point_1|``, in metres; 0 if an overlap was found.
    iterations : ndarray of int, shape (...)
        Number of steps; 1 for the closed-form methods.

    Examples
    --------
    >>> a = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1])
    >>> b = Ellipsoids.from_semi_axes([5, 0, 0], [2, 1, 1])
    >>> near = near_points(a, b)
    >>> near.point_1.round(6) + 0.0, near.point_2.round(6) + 0.0, round(float(near.distance), 6)
    (array([1., 0., 0.]), array([3., 0., 0.]), 2.0)
    """

    point_1: Floats
    point_2: Floats
    distance: Floats
    iterations: Ints


@guarded
def overlap(E1: Ellipsoids, E2: Ellipsoids) -> NDArray[np.bool_]:
    """Decide whether ellipsoids overlap; touching counts.

    Parameters
    ----------
    E1, E2 : Ellipsoids
        Ellipsoids in 3-D; batches broadcast.

    Returns
    -------
    ndarray of bool, shape (...)
        The answers, computed in plain float64 arithmetic; for proven answers, see `loewner.classify`.

    Raises
    ------
    InputError
        If an argument is not 3-D or batch shapes do not broadcast.

    Notes
    -----
    The contact function is compared with 1. The paper's method, `paper.overlap_by_eigenvalue`, solves an eigenproblem
    instead; it requires ``from loewner import paper``.

    References
    ----------
    Perram and Wertheim (1985), doi:10.1016/0021-9991(85)90171-8.

    Examples
    --------
    >>> a = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1])
    >>> b = Ellipsoids.from_semi_axes([2.5, 0, 0], [2, 1, 1])
    >>> bool(overlap(a, b))
    True
    """
    return np.asarray(contact_function(E1, E2) <= 1.0)[()]


@guarded
def contact_function(E1: Ellipsoids, E2: Ellipsoids) -> Floats:
    """Maximise Perram and Wertheim's contact function; two ellipsoids overlap if and only if the maximum is at most 1.

    F = max over s in [0, 1] of s(1-s) rᵀ[(1-s)Q1 + sQ2]⁻¹ r. Scaling both ellipsoids about their
    centers by sqrt(F) makes them touch.

    Parameters
    ----------
    E1, E2 : Ellipsoids
        Ellipsoids in 3-D; batches broadcast.

    Returns
    -------
    ndarray, shape (...)
        Values of F, dimensionless and >= 0.

    Raises
    ------
    InputError
        If an argument is not 3-D or batch shapes do not broadcast.

    Examples
    --------
    >>> a = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1])
    >>> b = Ellipsoids.from_semi_axes([4, 0, 0], [1, 2, 3])
    >>> round(float(contact_function(a, b)), 9)  # if both were twice as large, they would touch
    4.0
    """
    pair = PairArrays(E1, E2, "contact_function")
    value = np.empty(len(pair.offset))
    entries.contact_of_pairs(pair.offset, pair.F1, pair.F2, value)
    _expect_numbers(value, "contact_function")
    return value.reshape(pair.batch)[()]


@guarded
def near_points(E1: Ellipsoids, E2: Ellipsoids, method: str = "lin-han", angle: float = 0.01) -> NearPoints:
    """Find near points of two ellipsoids, or of pairs of ellipsoids.

    Parameters
    ----------
    E1, E2 : Ellipsoids
        Ellipsoids in 3-D; batches broadcast.
    method : {"lin-han", "rimon-boyd", "center-line"}
        "lin-han": the true nearest points, to within `angle`. "rimon-boyd": the point on each ellipsoid that growing
        level surfaces of the other ellipsoid touch first. "center-line": the points where the segment between the
        centers crosses the surfaces. The last two methods are closed forms, and their distance is never below the true
        distance. "center-line" detects an overlap only if a point of the segment is in both ellipsoids.
    angle : float
        For "lin-han", in radians: at both points, the outward normal and the direction to the other point differ by at
        most this angle. The paper uses 0.01; with 1e-8, the relative error of the distance is about 1e-16, or the
        rounding error of float64 if that is larger. If the search reaches this angle before it detects a shallow
        overlap, a small distance is returned.

    Returns
    -------
    NearPoints

    Raises
    ------
    InputError
        If an argument is not 3-D, batch shapes do not broadcast, or `angle` is not a number > 0.
    UnknownNameError
        If the method is not one of the three listed.
    ConvergenceError
        If a pair did not reach `angle`; no results are then returned, not even for the other pairs.

    References
    ----------
    Lin and Han (2002), doi:10.1137/S1052623401396510; Rimon and Boyd (1997), doi:10.1023/A:1007960531949.

    Examples
    --------
    >>> a = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1])
    >>> b = Ellipsoids.from_semi_axes([5, 0, 0], [2, 1, 1])
    >>> near_points(a, b).distance.round(12).item()
    2.0
    """
    code = NEAR_POINT_METHODS[_validate.choice(method, "method", NEAR_POINT_METHODS)]
    tolerance = _validate.positive_scalar(angle, "angle")
    pair = PairArrays(E1, E2, "near_points")
    n = len(pair.offset)
    x1, x2, distance = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    iterations, status = np.empty(n, np.int64), np.empty(n, np.int64)
    entries.near_points_of_pairs(code, pair.offset, pair.F1, pair.F2, tolerance, x1, x2, distance, iterations, status)
    failed = np.flatnonzero(status == codes.UNCONVERGED)
    if failed.size:
        raise ConvergenceError(
            f"near_points: expected every pair to reach {tolerance:g} rad, found {failed.size} of {n} that did not "
            f"(first at index {failed[0]}); allow a larger angle"
        )
    _expect_numbers(distance, "near_points")
    batch, k = pair.batch, pair.scale[:, None]
    point_1, point_2 = ((pair.c1 + k * x).reshape(*batch, 3) for x in (x1, x2))
    return NearPoints(point_1, point_2, (pair.scale * distance).reshape(batch)[()], iterations.reshape(batch)[()])


class PairArrays:
    """Checked pairs of ellipsoids, as a flat batch in the form that kernels take.

    Lengths are divided by a power of two near the pair's size. The division is exact, and keeps squares and cubes of
    lengths in the range of float64.

    Attributes
    ----------
    batch : tuple of int
        Broadcast batch shape, which is flattened to n in the arrays below.
    c1 : ndarray, shape (n, dim)
        First centers, in metres.
    scale : ndarray, shape (n,)
        The power of two by which each pair's lengths are divided, in metres.
    offset : ndarray, shape (n, dim)
        (c2 - c1) / scale.
    F1, F2 : ndarray, shape (n, dim, dim)
        Factors / scale.
    """

    def __init__(self, E1: Ellipsoids, E2: Ellipsoids, caller: str, dim: int | None = 3) -> None:
        for name, E in (("E1", E1), ("E2", E2)):
            _validate.instance(E, name, Ellipsoids)
            if not E.factor.any(axis=(-2, -1)).all():
                raise GeometryError(
                    f"{name}: expected ellipsoids with an interior, found a point, such as the inner one of a surface"
                )
        if E1.dim != E2.dim:
            raise InputError(f"{caller}: expected ellipsoids of one dimension, found {E1.dim} and {E2.dim}")
        if dim is not None and E1.dim != dim:
            raise InputError(f"{caller}: expected ellipsoids in {dim}-D, found dimension {E1.dim}")
        self.batch = _validate.broadcast({"E1": E1.batch_shape, "E2": E2.batch_shape})
        n = E1.dim
        self.c1 = self._flat(E1.center, n)
        F1, F2 = self._flat(E1.factor, n, n), self._flat(E2.factor, n, n)
        largest = np.maximum(np.abs(F1).max(axis=(1, 2), initial=0.0), np.abs(F2).max(axis=(1, 2), initial=0.0))
        self.scale = np.ldexp(1.0, np.minimum(np.frexp(largest)[1], 1023))  # 2^1024 overflows
        with np.errstate(over="ignore"):
            self.offset = (self._flat(E2.center, n) - self.c1) / self.scale[:, None]
        if not np.isfinite(self.offset).all():
            raise InputError(f"{caller}: expected a finite distance between centers, found an infinite one")
        self.F1, self.F2 = F1 / self.scale[:, None, None], F2 / self.scale[:, None, None]

    def _flat(self, x: Floats, *tail: int) -> Floats:
        return np.ascontiguousarray(np.broadcast_to(x, (*self.batch, *tail)).reshape(-1, *tail))


def _expect_numbers(x: Floats, caller: str) -> None:
    """Raise an error if results are outside the range of float64."""
    if not np.isfinite(x).all():
        pair = f"a larger one in pair {int(np.isfinite(x).argmin())}"
        raise ConvergenceError(f"{caller}: expected ratios of lengths that float64 can square, found {pair}")
