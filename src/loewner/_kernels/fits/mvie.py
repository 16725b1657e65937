"""Largest ellipsoid inside a polytope (MVIE): Zhang and Gao's primal-dual method, in O(m) per step.

Zhang and Gao, On numerical solution of the maximum volume ellipsoid problem, SIAM J. Optim. 14 (2003): the unknowns
are the center x, one multiplier y and one slack z per face; the shape follows as E² = (Aᵀ Y A)⁻¹. Their Newton
system is m x m, diagonal plus a matrix of rank n(n+1)/2; Woodbury's identity turns it into one Cholesky
factorisation of that size. Predictor and corrector (Mehrotra 1992) share it.

Certificate. In coordinates where the ellipsoid is the unit ball, with rows a_i and slacks d_i >= 0 at its center,
take any λ >= 0 with Σ λ_i a_i = 0. For a feasible ellipsoid F (symmetric positive definite) around any point,
Σ λ_i |F a_i| <= λᵀd, and |F a_i| >= u_iᵀ F a_i with u_i = a_i/|a_i|, so tr(F M) <= λᵀd with M = Σ λ_i a_i u_iᵀ, and
log det F <= n log(λᵀd / n) - log det M: that is the gap.
"""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.fits.dense import (
    cholesky,
    inverse_transposed_upper,
    normal_cholesky,
    normal_solve,
    reversed_cholesky,
    solve_general,
    solve_lower,
    solve_lower_transposed,
)
from loewner._kernels.fits.mvce import CENTRING_FLOOR, MAX_ITERATIONS, ROUNDING, SQRT2, STEP_CAP


@njit()
def balanced_gap(rows, slack, lam, m, n):
    """Certified gap of the unit ball for faces `rows` (m, n) with `slack` at the origin; `lam` is repaired in place.

    The repair λ <- λ (1 - rows w), (Σ λ a aᵀ) w = Σ λ a, makes Σ λ_i a_i = 0; infinite if a λ turns negative.
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
        log_det += 2.0 * np.log(M[j, j])
    return n * np.log(total / n) - log_det


@njit()
def solve_primal_dual(A, m, n, tol, x, low, lam):
    """Largest ellipsoid in {z : A z <= 1} (rows near unit size); fills center, lower factor, multipliers.

    Long steps first. About one piece in 300,000 makes them circle; it gets the plain method of Zhang and Gao, with
    one step length and no corrector, which takes a few steps more.

    Returns (gap, iterations); a gap above `tol` means it stopped there.
    """
    gap, iterations = _iterate(A, m, n, tol, x, low, lam, False)
    if gap <= tol:
        return gap, iterations
    careful_gap, more = _iterate(A, m, n, tol, x, low, lam, True)
    if careful_gap <= gap or not gap < np.inf:
        return careful_gap, iterations + more
    return _iterate(A, m, n, tol, x, low, lam, False)


@njit()
def _iterate(A, m, n, tol, x, low, lam, careful):
    """One run of the primal-dual method, from the same start, with long steps or careful ones."""
    p = n * (n + 1) // 2
    U = np.empty((n, n))
    T = np.empty((m, n))
    V = np.empty((m, p))
    K = np.empty((p, p))
    C = np.empty((n, p))
    P = np.empty((m, n))
    PA = np.empty((n, n))
    PA2 = np.empty((n, n))
    h = np.empty(m)
    d = np.ones(m)
    y = np.ones(m)
    z = np.empty(m)
    dy = np.zeros(m)
    dz = np.zeros(m)
    q = np.empty(p)
    r23 = np.empty(m)
    dx = np.empty(n)
    best = np.inf
    since_best = 0
    gap = np.inf
    for j in range(n):
        x[j] = 0.0

    for iteration in range(MAX_ITERATIONS):
        # E² = (Aᵀ Y A)⁻¹ = L Lᵀ with L = U⁻ᵀ; a~ = Lᵀ a = U⁻¹ a; h = |a~|
        for j in range(n):
            for k in range(j, n):
                U[j, k] = 0.0
        for i in range(m):
            for j in range(n):
                t = y[i] * A[i, j]
                for k in range(j, n):
                    U[j, k] += t * A[i, k]
        if not reversed_cholesky(U, n):
            return gap, iteration
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
        if iteration == 0:
            # The largest multiple of the starting ellipsoid that is feasible.
            for j in range(n):
                for k in range(j, n):
                    U[j, k] /= shrink
            for i in range(m):
                y[i] /= shrink * shrink
                h[i] *= shrink
                for j in range(n):
                    T[i, j] *= shrink
                z[i] = max(0.1, d[i] - h[i])
            shrink = 1.0

        # Certificate of shrink * E, in its own coordinates (λ scales freely).
        for i in range(m):
            lam[i] = y[i] * h[i]
        gap = balanced_gap(T, d, lam, m, n) - n * np.log(shrink)
        if gap < best:
            best = gap
            since_best = 0
        else:
            since_best += 1
        if gap <= tol or (since_best > 8 and best < 1.0):
            inverse_transposed_upper(U, low, n)
            for j in range(n):
                for k in range(j + 1):
                    low[j, k] *= shrink
            return gap, iteration

        for i in range(m):
            a = 0
            for j in range(n):
                for k in range(j):
                    V[i, a] = SQRT2 * T[i, j] * T[i, k]
                    a += 1
                V[i, a] = T[i, j] * T[i, j]
                a += 1

        # K = I + Uᵀ D⁻¹ U with D = 2 y h z, U = y V;  C = K⁻¹ Vᵀ ((h+z) / (2 h z) ∘ Y A)
        for j in range(p):
            K[j, j] = 1.0
            for k in range(j + 1, p):
                K[j, k] = 0.0
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
            return gap, iteration
        for j in range(n):
            normal_solve(K, C[j], p)
        # P = (2 y h ∘ T - Y A)ᵀ, row i: (y/z) (h a_i - Cᵀ v_i);  and P A
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

        mean = 0.0
        for i in range(m):
            mean += y[i] * z[i]
        mean /= m
        worst = mean
        mu = 0.0
        to_y = 1.0
        to_z = 1.0
        for stage in range(2):
            if careful and stage == 0:
                mu = max(min(0.5, mean) * mean, CENTRING_FLOOR)
                continue
            # R1 = -Aᵀ(y h);  R2 = d - h - z;  R3 = mu - y z (- dy dz);  R23 = R2 - R3/y
            for j in range(n):
                dx[j] = 0.0
            for i in range(m):
                r2 = d[i] - h[i] - z[i]
                worst = max(worst, abs(r2))
                r3 = mu - y[i] * z[i] - dy[i] * dz[i]
                dz[i] = r3 / y[i]
                r23[i] = r2 - dz[i]
                for j in range(n):
                    dx[j] += P[i, j] * r23[i] - A[i, j] * y[i] * h[i]
            for j in range(n):
                for k in range(n):
                    PA2[j, k] = PA[j, k]
            if not solve_general(PA2, dx, n):
                return gap, iteration
            # du = G⁻¹ [2 y h ∘ (A dx - R23)];  dy = y du;  dz = R3/y - z du
            for a in range(p):
                q[a] = 0.0
            for i in range(m):
                value = -r23[i]
                for j in range(n):
                    value += A[i, j] * dx[j]
                r23[i] = value
                value *= y[i] / z[i]
                for a in range(p):
                    q[a] += value * V[i, a]
            normal_solve(K, q, p)
            to_y = np.inf
            to_z = np.inf
            for i in range(m):
                value = r23[i]
                for a in range(p):
                    value -= V[i, a] * q[a] / (2.0 * h[i])
                du = value / z[i]
                dy[i] = y[i] * du
                dz[i] -= z[i] * du
                if dy[i] < 0.0:
                    to_y = min(to_y, -y[i] / dy[i])
                if dz[i] < 0.0:
                    to_z = min(to_z, -z[i] / dz[i])
                move = 0.0
                for j in range(n):
                    move += A[i, j] * dx[j]
                if move > 0.0:
                    to_z = min(to_z, d[i] / move)
            if stage == 0:
                to_y = min(1.0, to_y)
                to_z = min(1.0, to_z)
                after = 0.0
                for i in range(m):
                    after += (y[i] + to_y * dy[i]) * (z[i] + to_z * dz[i])
                after /= m
                mu = max(mean * (after / mean) ** 3, CENTRING_FLOOR)
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
            d[i] = move
            dy[i] = 0.0
            dz[i] = 0.0
    return gap, MAX_ITERATIONS


@njit()
def inscribe(normals, slack_low, slack_high, factor, lam):
    """Scale `factor` until the ellipsoid is inside every face for certain, then certify what is left.

    `slack_low` and `slack_high` bound b - A c from both sides for the center as it stands. A computed entry of Lᵀ a
    errs by at most (n + 1) u |L|ᵀ|a|. Returns the certified gap, infinite if no positive scale exists.
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
        # The scaled entries round once each, which moves Lᵀ a by up to u |L|ᵀ|a|.
        scale *= 1.0 - 4.0 * ROUNDING - 2.0 * (attempt + 1) / (n + 2) * hidden
        for j in range(n):
            for k in range(j + 1):
                factor[j, k] *= scale
    return balanced_gap(rows, slack_high, lam, m, n) + 2.0 * n * hidden
