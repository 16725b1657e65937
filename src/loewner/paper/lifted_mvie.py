"""Find the smallest ellipsoid around points as the largest ellipsoid in a polytope of one more dimension (appendix B).

The method is used to check `loewner.mvce`. It is slower, since the lifted problem has dimension n + 1 and two
half-spaces per point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._kernels import codes
from loewner._native import entries
from loewner.ellipsoids.fits import DEFAULT_TOLERANCE, Fit, certified_fit, checked_tolerance
from loewner.ellipsoids.polytopes import FLATNESS, check_enough, flat_error, writeable


@guarded
def mvce_by_lifted_mvie(points: ArrayLike, tol: float = DEFAULT_TOLERANCE) -> Fit:
    """Find the smallest ellipsoid around points, by the paper's reduction to an inscribed ellipsoid.

    Parameters
    ----------
    points : array_like, shape (m, n)
        The points in metres, with m > n >= 1.
    tol : float
        Largest allowed `Fit.gap`, a number in [1e-12, 1].

    Returns
    -------
    Fit
        The fit. Despite rounding, its ellipsoid contains every point exactly.

    Raises
    ------
    InputError
        If the shape is wrong, entries are not finite, or the tolerance is out of range.
    GeometryError
        If there are fewer than n + 1 points, or all points lie in a hyperplane.
    ConvergenceError
        If the certified gap exceeds `tol`.

    References
    ----------
    The paper, appendix B.

    Examples
    --------
    >>> from loewner import paper
    >>> fit = paper.mvce_by_lifted_mvie([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    >>> fit.ellipsoid.semi_axes.round(4)
    array([1.4142, 1.4142])
    """
    x = writeable(_validate.finite_array(points, "points", ("m", "n")))
    check_enough(x, "points")
    tolerance = checked_tolerance(tol)
    m, n = x.shape
    code, _, _, _, origin, frame, local = entries.to_unit_size(x, FLATNESS)
    if code == codes.FLAT:
        raise flat_error("points", x)
    # Find the MVIE of {z : |(v, 1)·z| <= 1} in dimension n + 1, where v are the points, and cut its polar at height 1.
    lifted = np.column_stack([local, np.ones(m)])
    z, low, multipliers = np.empty(n + 1), np.empty((n + 1, n + 1)), np.empty(2 * m)
    gap, iterations = entries.solve_primal_dual(
        np.concatenate([lifted, -lifted]), 2 * m, n + 1, 0.25 * tolerance, z, low, multipliers
    )
    if not np.isfinite(gap):
        return certified_fit("mvce_by_lifted_mvie", origin, frame, gap, iterations, tolerance)
    # The MVIE {xᵀ B x <= 1} has B⁻¹ = low lowᵀ = [[P, p], [pᵀ, s]], and {xᵀ B⁻¹ x <= 1} contains every (v, 1). Its cut
    # at height 1 has the center -P⁻¹ p and the matrix P / (1 - s + pᵀ P⁻¹ p). With P = R Rᵀ, p = R r and s = rᵀr + t²,
    # these are the center -R⁻ᵀ r and the matrix P / (1 - t²).
    R, r, t = low[:n, :n], low[n, :n], low[n, n]
    inverse = np.linalg.inv(R)
    factor = frame @ (np.sqrt(1.0 - t * t) * np.linalg.qr(inverse).R.T)
    factor *= np.sign(np.diagonal(factor))
    center = origin - frame @ (inverse.T @ r)
    # The multipliers are the duals of the MVIE. A point's dual weight is the sum of the multipliers of its two
    # half-spaces.
    weights = multipliers[:m] + multipliers[m:]
    error = entries.enclose(x, center, factor)
    gap = entries.outer_gap(x, np.arange(m), weights, m, center, factor, error) if error >= 0 else np.inf
    return certified_fit("mvce_by_lifted_mvie", center, factor, gap, iterations, tolerance)
