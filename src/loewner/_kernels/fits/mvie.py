"""Largest ellipsoid inside a polytope (MVIE): Zhang and Gao's primal-dual method, in O(m) per step.

Zhang and Gao, On numerical solution of the maximum volume ellipsoid problem, SIAM J. Optim. 14 (2003): the unknowns are
the center x, and one multiplier y and one slack z per face; the shape follows as E² = (Aᵀ Y A)⁻¹.

The method differs from theirs in these points:

1. The Newton system is m x m: a diagonal plus a matrix of rank n(n+1)/2. Woodbury's identity turns it into one Cholesky
   factorisation of size n(n+1)/2.
2. Predictor and corrector (Mehrotra 1992) share this factorisation, and multipliers have a separate step length. The
   plain rule with one step length is used only where these steps fail (`solve_primal_dual`).
3. The first ellipsoid is scaled until it is inside the polytope.
4. The iteration stops when the ellipsoid, shrunk until it is inside, has a small certified gap. This gap needs no small
   residuals.

Certificate. In coordinates in which the ellipsoid is the unit ball, with rows a_i and slacks d_i >= 0 at its center,
take any λ >= 0 with Σ λ_i a_i = 0. For a feasible ellipsoid F (symmetric positive definite) around any point, Σ λ_i |F
a_i| <= λᵀd, and |F a_i| >= u_iᵀ F a_i with u_i = a_i/|a_i|. With M = Σ λ_i a_i u_iᵀ, this implies tr(F M) <= λᵀd. Hence
log det F <= n log(λᵀd / n) - log det M: this bound is the gap.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, njit
from loewner._kernels.elementary import logarithm
from loewner._kernels.fits.dense import (
    Counts,
    cholesky,
    counts_of,
    fill_upper,
    inverse_transposed_upper,
    normal_cholesky,
    normal_solve,
    reversed_cholesky,
    solve_general,
    solve_lower,
    solve_lower_transposed,
    svec,
)
from loewner._kernels.fits.mvce import CENTRING_FLOOR, MAX_ITERATIONS, ROUNDING, STEP_CAP, centring, step_inside
from loewner._kernels.simd.memory import Arena, Place, floats, held, sizes_of


@njit()
def balanced_gap(rows, slack, lam, m, n):
    """Certified gap of the unit ball for faces `rows` (m, n) with `slack` at the origin; `lam` is repaired in place.

    The repair λ <- λ (1 - rows w), (Σ λ a aᵀ) w = Σ λ a, makes Σ λ_i a_i = 0. The gap is infinite if a λ turns
    negative.
    """
    M = np.zeros((n, n))
    w = np.zeros(n)
    for i in range(m):
        for j in range(n):
            t = lam[i] * rows[i, j]
            w[j] += t
            for k in range(j + 1):
                M[j, k] += t * rows[i, k]
    if not cholesky(M, n):
        return np.inf
    solve_lower(M, w, n)
    solve_lower_transposed(M, w, n)
    for j in range(n):
        for k in range(j + 1):
            M[j, k] = 0.0
    total = 0.0
    for i in range(m):
        t = 1.0
        norm2 = 0.0
        for j in range(n):
            t -= rows[i, j] * w[j]
            norm2 += rows[i, j] * rows[i, j]
        if not t >= 0.0:
            return np.inf
        lam[i] *= t
        total += lam[i] * slack[i]
        weight = lam[i] / np.sqrt(norm2)
        for j in range(n):
            t = weight * rows[i, j]
            for k in range(j + 1):
                M[j, k] += t * rows[i, k]
    if not cholesky(M, n):
        return np.inf
    log_det = 0.0
    for j in range(n):
        log_det += 2.0 * logarithm(M[j, j])
    return n * logarithm(total / n) - log_det


class _Memory(NamedTuple):
    """Memory of a run: for m faces a, in n dimensions, with p = n (n + 1) / 2.

    Attributes
    ----------
    U : ndarray, shape (n, n)
        Upper factor of E⁻² = Aᵀ Y A.
    T : ndarray, shape (m, n)
        Rows U⁻¹ a: faces in the coordinates in which the ellipsoid is the unit ball.
    V : ndarray, shape (m, p)
        A row svec(U⁻¹ a (U⁻¹ a)ᵀ) for each face.
    K : ndarray, shape (p, p)
        Upper factor of the matrix of Woodbury's identity.
    C : ndarray, shape (n, p)
        K⁻¹ Vᵀ ((h+z) / (2 h z) ∘ Y A), transposed.
    P : ndarray, shape (m, n)
        The matrix (2 y h ∘ T - Y A), solved by the m x m matrix.
    PA, lhs : ndarray, shape (n, n)
        Pᵀ A, the matrix of the system for dx; and the copy of it that is solved.
    h, d : ndarray, shape (m,)
        The values |E a|, and the slacks of the center: the ellipsoid is inside where h <= d.
    y, z : ndarray, shape (m,)
        Multipliers and slacks.
    dx, dy, dz : ndarray, shape (n,), (m,), (m,)
        Steps.
    rhs, q : ndarray, shape (m,) and (p,)
        Right sides.
    """

    U: Any
    T: Any
    V: Any
    K: Any
    C: Any
    P: Any
    PA: Any
    lhs: Any
    h: Any
    d: Any
    y: Any
    z: Any
    dx: Any
    dy: Any
    dz: Any
    rhs: Any
    q: Any


_m, _n, _p = sizes_of(Counts)
_MEMORY = Arena(
    _Memory, U=floats(_n, _n), T=floats(_m, _n), V=floats(_m, _p), K=floats(_p, _p), C=floats(_n, _p),
    P=floats(_m, _n), PA=floats(_n, _n), lhs=floats(_n, _n), h=floats(_m), d=floats(_m), y=floats(_m), z=floats(_m),
    dx=floats(_n), dy=floats(_m), dz=floats(_m), rhs=floats(_m), q=floats(_p),
)  # fmt: skip
_memory_of, _size = _MEMORY.whole(), _MEMORY.sizing()


@njit()
def solve_primal_dual(A, m, n, tol, x, low, lam):
    """Largest ellipsoid in {z : A z <= 1} (rows near unit size); fills center, lower factor and multipliers.

    Long steps are tried first. For about one piece in 300,000, they go around in circles. Such a piece is solved by the
    plain method of Zhang and Gao, with one step length and no corrector, which takes a few more steps.

    Returns (gap, iterations); a gap above `tol` means that the iteration stopped early.
    """
    counts = counts_of(m, n)
    memory = np.empty(_size(counts), np.uint8)
    place = Place(memory.ctypes.data, counts)
    gap, iterations = _iterate(place, A, tol, x, low, lam, False)
    if not gap <= tol:
        careful_gap, more = _iterate(place, A, tol, x, low, lam, True)
        if careful_gap <= gap or not gap < np.inf:
            gap, iterations = careful_gap, iterations + more
        else:
            gap, iterations = _iterate(place, A, tol, x, low, lam, False)
    held(memory)
    return gap, iterations


@njit()
def _iterate(place, A, tol, x, low, lam, careful):
    """Run the primal-dual method once, from a fixed start, with long steps or careful steps."""
    m, n, work = place.counts.m, place.counts.n, _memory_of(place)
    y, h = work.y, work.h
    for i in range(m):
        work.d[i] = y[i] = 1.0
        work.dy[i] = work.dz[i] = 0.0
    for j in range(n):
        x[j] = 0.0
    best = np.inf
    since_best = 0
    gap = np.inf
    for iteration in range(MAX_ITERATIONS):
        is_definite, shrink = _assemble(place, A)
        if not is_definite:
            return gap, iteration
        if iteration == 0:
            _begin(place, shrink)
            shrink = 1.0
        # Certify shrink * E in coordinates in which this ellipsoid is the unit ball (λ may have any scale).
        for i in range(m):
            lam[i] = y[i] * h[i]
        gap = balanced_gap(work.T, work.d, lam, m, n) - n * logarithm(shrink)
        if gap < best:
            best = gap
            since_best = 0
        else:
            since_best += 1
        if gap <= tol or (since_best > 8 and best < 1.0):
            inverse_transposed_upper(work.U, low, n)
            for j in range(n):
                for k in range(j + 1):
                    low[j, k] *= shrink
            return gap, iteration
        if not _factor(place, A) or not _step(place, A, x, careful):
            return gap, iteration
    return gap, MAX_ITERATIONS


@njit()
def _assemble(place, A):
    """Compute and factor E⁻²; fill T and h.

    Returns whether E⁻² is positive definite, and the largest multiple of the ellipsoid about its center that is inside.
    """
    m, n, work = place.counts.m, place.counts.n, _memory_of(place)
    A, U, T, h, d, y = borrowed(A), work.U, work.T, work.h, work.d, work.y
    # Here, E² = (Aᵀ Y A)⁻¹ = L Lᵀ with L = U⁻ᵀ, a~ = Lᵀ a = U⁻¹ a, and h = |a~|.
    fill_upper(U, 0.0, n)
    for i in range(m):
        for j in range(n):
            t = y[i] * A[i, j]
            for k in range(j, n):
                U[j, k] += t * A[i, k]
    if not reversed_cholesky(U, n):
        return False, 0.0
    shrink = np.inf
    for i in range(m):
        norm2 = 0.0
        for j in range(n - 1, -1, -1):
            value = A[i, j]
            for k in range(j + 1, n):
                value -= U[j, k] * T[i, k]
            value /= U[j, j]
            T[i, j] = value
            norm2 += value * value
        h[i] = np.sqrt(norm2)
        shrink = min(shrink, d[i] / h[i])
    return True, shrink


@njit()
def _begin(place, shrink):
    """Begin with the largest multiple of the first ellipsoid that is inside the polytope."""
    m, n, work = place.counts.m, place.counts.n, _memory_of(place)
    U, T, h, y = work.U, work.T, work.h, work.y
    for j in range(n):
        for k in range(j, n):
            U[j, k] /= shrink
    for i in range(m):
        y[i] /= shrink * shrink
        h[i] *= shrink
        for j in range(n):
            T[i, j] *= shrink
        work.z[i] = max(0.1, work.d[i] - h[i])


@njit()
def _factor(place, A):
    """Fill V, K, C, P and PA, for predictor and corrector; False if K is not positive definite."""
    m, n, p, work = place.counts.m, place.counts.n, place.counts.p, _memory_of(place)
    A, V, K, C, P, PA, h, y, z = borrowed(A), work.V, work.K, work.C, work.P, work.PA, work.h, work.y, work.z
    for i in range(m):
        svec(work.T[i], V, i, n)
    # Compute K = I + Uᵀ D⁻¹ U with D = 2 y h z and U = y V, and C = K⁻¹ Vᵀ ((h+z) / (2 h z) ∘ Y A).
    fill_upper(K, 1.0, p)
    for j in range(n):
        for a in range(p):
            C[j, a] = 0.0
    for i in range(m):
        weight = y[i] / (2.0 * h[i] * z[i])
        for j in range(p):
            t = weight * V[i, j]
            for k in range(j, p):
                K[j, k] += t * V[i, k]
        weight *= h[i] + z[i]
        for j in range(n):
            t = weight * A[i, j]
            for a in range(p):
                C[j, a] += t * V[i, a]
    if not normal_cholesky(K, p):
        return False
    for j in range(n):
        normal_solve(K, C[j], p)
    # Compute P = (2 y h ∘ T - Y A)ᵀ, whose row i is (y/z) (h a_i - Cᵀ v_i), and then P A.
    for j in range(n):
        for k in range(n):
            PA[j, k] = 0.0
    for i in range(m):
        for j in range(n):
            value = h[i] * A[i, j]
            for a in range(p):
                value -= C[j, a] * V[i, a]
            P[i, j] = value * y[i] / z[i]
            for k in range(n):
                PA[j, k] += P[i, j] * A[i, k]
    return True


@njit()
def _step(place, A, x, careful):
    """Change x, y, z and d by a predictor and a corrector, or by a careful step; False if the system is singular."""
    m, n, work = place.counts.m, place.counts.n, _memory_of(place)
    A, y, z, dx, dy, dz = borrowed(A), work.y, work.z, work.dx, work.dy, work.dz
    mean = 0.0
    for i in range(m):
        mean += y[i] * z[i]
    mean /= m
    worst = mean
    if careful:
        mu = max(min(0.5, mean) * mean, CENTRING_FLOOR)
    else:
        is_solved, to_y, to_z, worst = _direction(place, A, 0.0, worst)
        if not is_solved:
            return False
        mu = centring(mean, y, dy, to_y, z, dz, to_z, m)
    is_solved, to_y, to_z, worst = _direction(place, A, mu, worst)
    if not is_solved:
        return False
    share = min(STEP_CAP, max(0.75, 1.0 - worst))
    if careful:
        to_y = min(to_y, to_z)
        to_z = to_y
    to_y = min(1.0, share * to_y)
    to_z = min(1.0, share * to_z)
    for j in range(n):
        x[j] += to_z * dx[j]
    for i in range(m):
        y[i] += to_y * dy[i]
        z[i] += to_z * dz[i]
        move = 1.0
        for j in range(n):
            move -= A[i, j] * x[j]
        work.d[i] = move
        dy[i] = 0.0
        dz[i] = 0.0
    return True


@njit()
def _direction(place, A, mu, worst):
    """Solve for the steps dx, dy and dz, with the products of dy and dz so far.

    Returns whether the system could be solved, the largest step length for y, the largest step length for x and z, and
    the larger of `worst` and the residuals of h + z = d.
    """
    m, n, p, work = place.counts.m, place.counts.n, place.counts.p, _memory_of(place)
    A, V, P, PA, lhs, h, d = borrowed(A), work.V, work.P, work.PA, work.lhs, work.h, work.d
    y, z, dx, dy, dz, rhs, q = work.y, work.z, work.dx, work.dy, work.dz, work.rhs, work.q
    # The residuals are R1 = -Aᵀ(y h), R2 = d - h - z, R3 = mu - y z - dy dz (with the previous dy and dz), and R23 = R2
    # - R3/y.
    for j in range(n):
        dx[j] = 0.0
    for i in range(m):
        r2 = d[i] - h[i] - z[i]
        worst = max(worst, abs(r2))
        r3 = mu - y[i] * z[i] - dy[i] * dz[i]
        dz[i] = r3 / y[i]
        rhs[i] = r2 - dz[i]
        for j in range(n):
            dx[j] += P[i, j] * rhs[i] - A[i, j] * y[i] * h[i]
    for j in range(n):
        for k in range(n):
            lhs[j, k] = PA[j, k]
    if not solve_general(lhs, dx, n):
        return False, 0.0, 0.0, worst
    # The steps are du = G⁻¹ [2 y h ∘ (A dx - R23)], dy = y du, and dz = R3/y - z du.
    for a in range(p):
        q[a] = 0.0
    for i in range(m):
        value = -rhs[i]
        for j in range(n):
            value += A[i, j] * dx[j]
        rhs[i] = value
        value *= y[i] / z[i]
        for a in range(p):
            q[a] += value * V[i, a]
    normal_solve(work.K, q, p)
    to_y = np.inf
    to_z = np.inf
    for i in range(m):
        value = rhs[i]
        for a in range(p):
            value -= V[i, a] * q[a] / (2.0 * h[i])
        du = value / z[i]
        dy[i] = y[i] * du
        dz[i] -= z[i] * du
        to_y = step_inside(to_y, y[i], dy[i])
        to_z = step_inside(to_z, z[i], dz[i])
        move = 0.0
        for j in range(n):
            move += A[i, j] * dx[j]
        if move > 0.0:
            to_z = min(to_z, d[i] / move)
    return True, to_y, to_z, worst


@njit()
def inscribe(normals, slack_low, slack_high, factor, lam):
    """Scale `factor` until the ellipsoid is certainly inside every face, then certify the remaining gap.

    `slack_low` and `slack_high` bound b - A c from both sides for the center as it is stored. A computed entry of Lᵀ a
    errs by at most (n + 1) u |L|ᵀ|a|. Returns the certified gap, which is infinite if no positive scale exists.
    """
    m, n = normals.shape
    rows = np.empty((m, n))
    hidden = 0.0
    for attempt in range(4):
        scale = np.inf
        hidden = 0.0
        for i in range(m):
            norm2 = 0.0
            doubt2 = 0.0
            for j in range(n):
                value = 0.0
                bound = 0.0
                for k in range(j, n):
                    value += factor[k, j] * normals[i, k]
                    bound += abs(factor[k, j] * normals[i, k])
                rows[i, j] = value
                norm2 += value * value
                doubt2 += bound * bound
            reach = np.sqrt(norm2) * (1.0 + (n + 3) * ROUNDING)
            doubt = np.sqrt(doubt2) * (n + 2) * ROUNDING
            scale = min(scale, slack_low[i] * (1.0 - 2.0 * ROUNDING) / ((reach + doubt) * (1.0 + 2.0 * ROUNDING)))
            hidden = max(hidden, doubt / reach)
        if not scale > 0.0 or not scale < np.inf:
            return np.inf
        if attempt > 0 and scale >= 1.0:
            break
        if attempt == 3:
            return np.inf
        # Each scaled entry is rounded once, which moves Lᵀ a by up to u |L|ᵀ|a|.
        scale *= 1.0 - 4.0 * ROUNDING - 2.0 * (attempt + 1) / (n + 2) * hidden
        for j in range(n):
            for k in range(j + 1):
                factor[j, k] *= scale
    return balanced_gap(rows, slack_high, lam, m, n) + 2.0 * n * hidden
