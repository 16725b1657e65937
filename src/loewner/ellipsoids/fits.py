"""Compute Löwner–John ellipsoids: the largest inside a polytope (`mvie`) and the smallest around points (`mvce`).

Every fit has a `gap`, a computed bound on log(volume / optimal volume). The bound holds for the ellipsoid as returned,
which has been scaled so that containment holds despite rounding. A fit that misses its tolerance raises an error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._log import MANY_PIECES, logged
from loewner._base._read_only import KeepsReadOnly
from loewner._base._threads import in_shares
from loewner._base._validate import Floats, Ints, Progress
from loewner._kernels import codes
from loewner._native import entries
from loewner.ellipsoids import polytopes
from loewner.ellipsoids.ellipsoids import Ellipsoids, trusted
from loewner.ellipsoids.large_fits import inner as large_inner
from loewner.ellipsoids.large_fits import outer as large_outer
from loewner.ellipsoids.large_fits.dense import Reporter, inverse_of, lower_root
from loewner.ellipsoids.polytopes import FLATNESS, Polytope, center_error, check_enough, check_size, writeable
from loewner.errors import ConvergenceError, GeometryError, InputError

# The paper's tolerance: volumes within a factor of e^0.0001.
DEFAULT_TOLERANCE = 1e-4
# If `large_fits` did not converge, the kernel for m half-spaces in dimension n is tried, provided m n^4 is at most this
# number. The kernel then takes a few seconds at most.
MANY_FOR_KERNEL = 1e10
# Below this tolerance, the certificate itself is rounding noise.
SMALLEST_TOLERANCE = 1e-12

# For the outer ellipsoid, `large_fits` is faster if the dimension is at least HIGH_DIMENSION, or if it is at least
# MIDDLE_DIMENSION and the number of points times the fourth power of the dimension reaches MANY_POINTS. For the inner
# ellipsoid, it is faster if the number of half-spaces times the third power of the dimension reaches MANY_HALFSPACES.
# See the measurements in docs/design/fits.md.
HIGH_DIMENSION, MIDDLE_DIMENSION, MANY_POINTS, MANY_HALFSPACES = 15, 5, 1.5e8, 4e5


@dataclass(frozen=True, eq=False, repr=False)
class Fit(_validate.Brief, KeepsReadOnly):
    """A fitted ellipsoid, with a bound on the difference between its volume and the optimal volume.

    Attributes
    ----------
    ellipsoid : Ellipsoids
        The ellipsoid, whose factor is lower triangular.
    gap : float
        Certified bound on ``|log(volume / optimal volume)|``, at most the requested tolerance.
    iterations : int
        Number of steps of the interior-point method and, in high dimension, of the coordinate ascent before it.
    weights : ndarray, shape (m,), or None
        With ``mvce(points, weights=True)``: the weight of each point in the proof that no smaller ellipsoid contains
        the points. The weights are nonnegative and sum to 1. The weighted mean of the points nearly equals the
        ellipsoid's center, and the weighted covariance of the points nearly equals the ellipsoid's shape matrix divided
        by the dimension.

    Examples
    --------
    >>> fit = mvce([[0, 0], [2, 0], [0, 2], [2, 2]])
    >>> fit.ellipsoid.center.round(6), fit.gap <= 1e-4
    (array([1., 1.]), True)
    """

    ellipsoid: Ellipsoids
    gap: float
    iterations: int
    weights: Floats | None = None


@guarded
def mvce(
    points: ArrayLike,
    tol: float = DEFAULT_TOLERANCE,
    *,
    center: ArrayLike | None = None,
    weights: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Find the smallest ellipsoid around points (minimum-volume circumscribed ellipsoid).

    Parameters
    ----------
    points : array_like, shape (m, n)
        Points in metres, with m > n >= 1.
    tol : float
        Largest allowed `Fit.gap`, a number in [1e-12, 1].
    center : array_like, shape (n,), or a number
        A prescribed center, such as ``center=0`` for the origin; n points then suffice if they and the center do not
        lie in a hyperplane. By default, the center that makes the ellipsoid smallest is found.
    weights : bool
        Whether to return the weights of the points as well; these weights form an optimal design for experiments at the
        points.
    progress : callable, optional
        Called as ``progress(done, 100)`` from time to time, where `done` is the percentage of the requested digits
        that has been reached.

    Returns
    -------
    Fit
        The fit; the stored ellipsoid contains every point exactly, despite rounding.

    Raises
    ------
    InputError
        If the shape is wrong, entries are not finite, or the tolerance is out of range.
    GeometryError
        If there are fewer than n + 1 points, or all points lie in a hyperplane; a given center counts as an additional
        point.
    ConvergenceError
        If the requested gap was not reached.

    Notes
    -----
    The dual is solved by an interior-point method, with an active set when there are many points. In high dimension, or
    with very many points, coordinate ascent comes first, and points that cannot touch the ellipsoid are dropped. The
    fit needs memory for a few numbers per point and for a copy of up to an eighth of the points; the interior-point
    method needs up to 0.8 GB more. For the paper's reduction to an inscribed ellipsoid, use `mvce_by_lifted_mvie` of
    ``loewner.paper``.

    The weights form a D-optimal design of experiments at the points, for a linear model with a constant term
    (Titterington). That is, the weights maximise the determinant of the information matrix: the determinant's logarithm
    is below its maximum by at most twice the gap. With ``center=0``, the model has no constant term.

    References
    ----------
    Todd, Minimum-Volume Ellipsoids (2016); Kumar and Yıldırım (2005), doi:10.1007/s10957-005-2653-6; Todd and Yıldırım
    (2007), doi:10.1016/j.dam.2007.02.013; Harman and Pronzato (2007), doi:10.1016/j.spl.2006.05.014; Khachiyan (1996),
    doi:10.1287/moor.21.2.307; Titterington (1975), doi:10.1093/biomet/62.2.313.

    Examples
    --------
    >>> fit = mvce([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    >>> fit.ellipsoid.semi_axes.round(4)
    array([1.4142, 1.4142])
    >>> mvce([[1, 1], [1, -1], [-1, 1], [-1, -1], [0, 0]], weights=True).weights.round(3)
    array([0.25, 0.25, 0.25, 0.25, 0.  ])
    >>> mvce([[3, 0], [0, 1]], center=0).ellipsoid.semi_axes.round(4)
    array([3., 1.])
    """
    x = _validate.finite_array(points, "points", ("m", "n"))
    fixed_center = _checked_center(center, x.shape[1])
    check_enough(x, "points", given=fixed_center)
    tolerance = checked_tolerance(tol)
    reporter = Reporter(_validate.reporter(progress), tolerance)
    m, n = x.shape
    is_large = n >= HIGH_DIMENSION or (n >= MIDDLE_DIMENSION and m * n**4 >= MANY_POINTS)
    if _validate.flag(weights, "weights") or fixed_center is not None or is_large:
        c, factor, gap, iterations, u = large_outer.smallest_around(x, tolerance, fixed_center, reporter)
        fit = certified_fit("mvce", c, factor, gap, iterations, tolerance, reporter)
        u.setflags(write=False)
        return replace(fit, weights=u) if weights else fit
    x, c, factor = writeable(x), np.empty(n), np.empty((n, n))
    code, gap, iterations, _, _, _ = entries.fit_outer(x, tolerance, FLATNESS, c, factor)
    if code == codes.FLAT:
        raise polytopes.flat_error("points", x)
    return certified_fit("mvce", c, factor, gap, iterations, tolerance, reporter)


def _checked_center(center: ArrayLike | None, n: int) -> Floats | None:
    if center is None:
        return None
    array = _validate.float_array(center, "center")
    fixed_center = _validate.finite_array(np.full(n, array) if array.ndim == 0 else array, "center", (n,))
    check_size(float(np.abs(fixed_center).max()), "center")
    return fixed_center


@guarded
def mvie(
    A: ArrayLike,
    b: ArrayLike | None = None,
    tol: float = DEFAULT_TOLERANCE,
    *,
    center: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Find the largest ellipsoid inside a polytope (maximum-volume inscribed ellipsoid).

    Parameters
    ----------
    A : array_like, shape (m, n)
        With `b`, the normals of the half-spaces {x : A x <= b}, one per row; without `b`, points whose convex hull is
        the polytope.
    b : array_like, shape (m,), optional
    tol : float
        Largest allowed `Fit.gap`, a number in [1e-12, 1].
    center : array_like, shape (n,), or a number, optional
        A prescribed center, such as ``center=0`` for the origin; allowed only with half-spaces. The intersection of the
        half-spaces need not be bounded, provided it contains no line through the center.
    progress : callable, optional
        Called as ``progress(done, 100)`` from time to time, where `done` is the percentage of the requested digits
        that has been reached.

    Returns
    -------
    Fit
        The fit; despite rounding, the stored ellipsoid lies inside every given half-space, or inside the hull of the
        points, without any tolerance.

    Raises
    ------
    InputError
        If shapes are wrong, entries are not finite, or the tolerance is out of range.
    GeometryError
        If the polytope is empty, flat or unbounded, or the given center is not inside.
    ConvergenceError
        If the requested gap was not reached.

    Notes
    -----
    The method is due to Zhang and Gao. In high dimension, or with very many half-spaces, it works on a subset:
    half-spaces that turn out to cut the ellipsoid are added, and distant half-spaces are removed. With a given center,
    the method of `mvce` finds the smallest ellipsoid around the polar points. The answer is the polar of that
    ellipsoid.

    References
    ----------
    Zhang and Gao (2003), doi:10.1137/S1052623401397230.

    Examples
    --------
    >>> fit = mvie([[1, 0], [-1, 0], [0, 1], [0, -1]], [3, 3, 1, 1])
    >>> fit.ellipsoid.semi_axes.round(4)
    array([3., 1.])
    >>> mvie([[1, 0], [-1, 0], [0, 1], [0, -1]], [3, 5, 1, 1], center=0).ellipsoid.semi_axes.round(4)
    array([3., 1.])
    """
    tolerance = checked_tolerance(tol)
    reporter = Reporter(_validate.reporter(progress), tolerance)
    if b is not None:
        rows, bounds = polytopes.check_halfspaces(A, b)
        fixed_center = _checked_center(center, rows.shape[1])
        if fixed_center is not None:
            return _mvie_about(fixed_center, rows, bounds, tolerance, reporter)
        return _mvie_of_halfspaces(rows, bounds, tolerance, reporter)
    if center is not None:
        raise InputError("center: expected half-spaces A, b with it, found no b")
    points = _validate.finite_array(A, "points", ("m", "n"))
    check_enough(points, "points")
    if points.shape[1] == 1:  # Qhull requires at least two dimensions; an interval is its own two half-spaces
        ends = np.array([points.max(), -points.min()])
        return _mvie_of_halfspaces(np.array([[1.0], [-1.0]]), ends, tolerance, reporter)
    piece = Polytope.from_points(points)
    starts = np.array([0, len(piece.vertices)]), np.array([0, len(piece.normals)])
    inner, _, info = _fit_all((starts[0], piece.vertices, starts[1], piece.normals), tolerance, None)
    return certified_fit("mvie", inner[0][0], inner[1][0], info[0, 3], int(info[0, 4]), tolerance, reporter)


def _mvie_of_halfspaces(A: Floats, b: Floats, tol: float, reporter: Reporter) -> Fit:
    n = A.shape[1]
    x = polytopes.interior_point(A, b)
    if len(A) * n**3 >= MANY_HALFSPACES:
        return _mvie_of_many_halfspaces(A, b, x, tol, reporter)
    center, factor, direction = np.empty(n), np.empty((n, n)), np.empty(n)
    code, gap, iterations = entries.fit_halfspaces(A, b, x, tol, FLATNESS, center, factor, direction)
    if code == codes.UNBOUNDED or (code != 0 and iterations == 0):
        raise center_error(code, A, direction)
    return certified_fit("mvie", center, factor, gap, iterations, tol, reporter)


def _mvie_of_many_halfspaces(A: Floats, b: Floats, x: Floats, tol: float, reporter: Reporter) -> Fit:
    m, n = A.shape
    frame, direction = np.empty((n, n)), np.empty(n)
    code = entries.center_in(A, b, x, frame, direction, FLATNESS)
    if code != 0:
        raise center_error(code, A, direction)
    center, factor, lam, iterations = large_inner.largest_inside(A, b, x, frame, tol, reporter)
    factor, gap = large_inner.proven(A, b, center, factor, lam)
    if gap > tol and m * n**4 <= MANY_FOR_KERNEL:
        # Nearly equal half-spaces exhaust the precision of the working set; the kernel has more precision.
        around, low = np.empty(n), np.empty((n, n))
        code, reached, more = entries.fit_halfspaces(A, b, x, tol, FLATNESS, around, low, direction)
        if code == 0:
            center, factor, gap, iterations = around, low, reached, iterations + more
    return certified_fit("mvie", center, factor, gap, iterations, tol, reporter)


def _mvie_about(center: Floats, A: Floats, b: Floats, tol: float, reporter: Reporter) -> Fit:
    """Find the largest ellipsoid about `center`, as the polar of the smallest one around the polar points."""
    slack = b - A @ center
    if not (slack > 0).all():
        i = int(slack.argmin())
        raise GeometryError(f"center: expected a point inside every half-space, found row {i} at slack {slack[i]:.3g}")
    with np.errstate(over="ignore"):  # infinite values are reported as too large
        polar, origin = A / slack[:, None], np.zeros(A.shape[1])
    check_size(float(np.abs(polar).max()), "A, b about the center, rows by slacks")
    try:
        half = max(0.5 * tol, SMALLEST_TOLERANCE)
        _, around, _, iterations, weights = large_outer.smallest_around(polar, half, origin, reporter)
    except GeometryError:  # the polar points lie in a hyperplane
        raise center_error(codes.UNBOUNDED, A, origin) from None
    factor, gap = large_inner.proven(A, b, center, lower_root(inverse_of(around)), weights / slack, balanced=False)
    return certified_fit("mvie", center, factor, gap, iterations, tol, reporter)


@guarded
def fit_pieces(
    vert_start: Ints,
    vertices: Floats,
    face_start: Ints,
    normals: Floats,
    tol: float = DEFAULT_TOLERANCE,
    progress: Progress | None = None,
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Fit inner and outer ellipsoids of many 3-D pieces, on all threads.

    Parameters
    ----------
    vert_start, face_start : ndarray of int, shape (P + 1,)
        Piece i has the vertices ``vert_start[i]:vert_start[i+1]`` and the faces ``face_start[i]:face_start[i+1]``.
    vertices : ndarray, shape (total vertices, 3)
        Vertices in metres.
    normals : ndarray, shape (total faces, 3)
        Outward normals from `polytopes.hulls`; up to rounding, each face passes through its own vertices. Slacks are
        measured from the vertices, which are exact, so no offsets are needed.
    tol : float
        Largest allowed `Fit.gap` of every fit.
    progress : callable, optional
        Called as ``progress(done, total)`` after each block.

    Returns
    -------
    inner_center (P, 3), inner_factor (P, 3, 3), outer_center (P, 3), outer_factor (P, 3, 3),
    inner_gap (P,), outer_gap (P,) : ndarray
        Factors are lower triangular with positive diagonals.

    Raises
    ------
    GeometryError, ConvergenceError
        If a piece cannot be fitted; the message gives the index of the piece.
    """
    tolerance, progress = checked_tolerance(tol), _validate.callback(progress, "progress")
    V = _validate.finite_array(vertices, "vertices", (None, 3))
    A = _validate.finite_array(normals, "normals", (None, 3))
    vs, fs = _starts(vert_start, "vert_start", len(V)), _starts(face_start, "face_start", len(A))
    if len(vs) != len(fs):
        raise InputError(f"face_start: expected {len(vs)} entries like vert_start, found {len(fs)}")
    inner, outer, info = _fit_all((vs, V, fs, A), tolerance, progress)
    bad = np.flatnonzero((info[:, 0] != 0) | (info[:, 2] != 0))
    if len(bad):
        i = int(bad[0])
        if info[i, 0] == codes.FLAT:
            raise GeometryError(f"piece {i}: expected vertices that span all 3 dimensions, found a flat piece")
        side, gap = ("outer", info[i, 1]) if info[i, 0] != 0 else ("inner", info[i, 3])
        raise ConvergenceError(f"piece {i}: the {side} ellipsoid reached a gap of {gap:.3g}, expected {tolerance:g}")
    return (*inner, *outer, info[:, 3].copy(), info[:, 1].copy())


def _fit_all(
    pieces: tuple[Ints, Floats, Ints, Floats], tol: float, progress: Progress | None
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats], Floats]:
    """Run the kernel over blocks of pieces, on the configured number of threads; see `fit_pieces`."""
    total, n = len(pieces[0]) - 1, pieces[1].shape[1]
    inner, outer = ((np.empty((total, n)), np.empty((total, n, n))) for _ in range(2))
    info, arrays = np.empty((total, 5)), [writeable(array) for array in pieces]

    def run(first: int, last: int) -> None:
        entries.fit_range(first, last, *arrays, tol, FLATNESS, *inner, *outer, info)

    with logged("fitting the ellipsoids of %d pieces", total, least=MANY_PIECES):
        in_shares(run, total, polytopes.LEAST_SHARE, most=polytopes.BLOCK, progress=progress)
    return inner, outer, info


def checked_tolerance(tol: float) -> float:
    """Check a gap in log-volume; see `mvce`."""
    value = _validate.positive_scalar(tol, "tol")
    if not SMALLEST_TOLERANCE <= value <= 1.0:
        raise InputError(f"tol: expected a gap in log-volume between {SMALLEST_TOLERANCE:g} and 1, found {value:g}")
    return value


def _starts(x: Ints, name: str, total: int) -> Ints:
    starts = writeable(_validate.integer_array(x, name))
    if starts.ndim != 1 or len(starts) < 1 or starts[0] != 0 or starts[-1] != total or (np.diff(starts) < 0).any():
        raise InputError(f"{name}: expected indices that rise from 0 to {total}, found {starts.ravel()[:8].tolist()}")
    return starts


def certified_fit(
    name: str, center: Floats, factor: Floats, gap: float, iterations: int, tol: float, reporter: Reporter | None = None
) -> Fit:
    """Wrap a kernel's result; raise if its gap is above the tolerance."""
    if not gap <= tol:
        raise ConvergenceError(
            f"{name}: reached a gap of {gap:.3g} in log-volume, expected {tol:g}; a thin body far from the origin "
            "may not have that many digits: ask for a larger tol, or move it to the origin"
        )
    if reporter is not None:
        reporter.done()
    return Fit(trusted(center, factor), float(max(gap, 0.0)), int(iterations))
