"""Smallest ellipsoid around points (MVCE): dual interior point, active set, containment after rounding.

The dual of the problem (Titterington 1975) is to maximise log det Σ u_i q_i q_iᵀ over u >= 0, Σ u = 1, with q = (1, x).
With w_i = q_iᵀ M⁻¹ q_i, its optimality conditions are w + s = N and u s = 0, where N = n + 1. The Newton matrix is
diag(s/u) plus V Vᵀ, where V_i = svec(W_i W_iᵀ), W_i = L⁻¹ q_i and M = L Lᵀ. Each step is Mehrotra's (1992): a predictor
without any centring, then a corrector with the centring that the predictor allows.

The method differs from Mehrotra's in these points:

1. The rank of V Vᵀ is N(N+1)/2 for any number of points. Woodbury's identity reduces the m x m system to this size, so
   that a step takes O(m) operations; predictor and corrector share the factorisation.
2. The steps do not enforce Σ u = 1. The sum follows from the optimality conditions, and the weights are divided by
   the sum at the end.
3. The iteration stops when the gap defined below is small enough. This test needs no small residuals.
4. The extreme points of Kumar and Yıldırım (2005) give the coordinates in which the problem is solved.
5. For many points, an active set is used. Each round adds the farthest point of each of 2n sectors, and drops light
   points inside. The first rounds are solved loosely.

For any u, let c and S be the weighted mean and covariance, and κ the largest value of (x-c)ᵀ S⁻¹ (x-c) over the points.
Then {(x-c)ᵀ S⁻¹ (x-c) <= κ} holds every point, and log(volume / smallest volume) <= n/2 log(κ/n): Todd, Minimum-Volume
Ellipsoids (2016), chapter 2.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import FLAT, STALLED
from loewner._kernels.elementary import exponential, logarithm
from loewner._kernels.fits.dense import (
    Counts,
    cholesky,
    counts_of,
    fill_upper,
    householder_triangle,
    invert_lower,
    multiply_lower,
    normal_cholesky,
    normal_solve,
    solve_lower,
    svec,
)
from loewner._kernels.simd.memory import Arena, Place, floats, held, sizes_of

ROUNDING = 2.0**-53  # The unit roundoff of float64.

# Largest fraction of the way to the boundary that a step covers; closer to it, s/u would be too large to be useful.
STEP_CAP = 0.9999
# Least value of the centring parameter; below it, the products u s would be mere rounding noise.
CENTRING_FLOOR = 1e-15
MAX_ITERATIONS = 100
MAX_ROUNDS = 200
# In n dimensions, the solver receives all points at once if there are at most DIRECT_LIMIT + 2 n² of them. From about
# 60 points on, an active set is faster.
DIRECT_LIMIT = 64
# A point leaves the active set if its weight is at most LIGHT and its squared radius, in the coordinates in which the
# current ellipsoid is the unit ball, is at most NEAR.
LIGHT = 1e-6
NEAR = 0.8


class _Memory(NamedTuple):
    """Memory of a solution: for m points, N = n + 1 and p = N (N + 1) / 2.

    Attributes
    ----------
    L : ndarray, shape (N, N)
        Lower factor of M.
    W : ndarray, shape (N,)
        The vector L⁻¹ q of one point.
    V : ndarray, shape (m, p)
        A row svec(W Wᵀ) for each point.
    K : ndarray, shape (p, p)
        Upper factor of I + Vᵀ diag(u/s) V.
    w, s : ndarray, shape (m,)
        The values qᵀ M⁻¹ q, and the slacks below N that the method assigns to them.
    du, ds : ndarray, shape (m,)
        Steps; until the step is known, `ds` holds the term of the products u s.
    rhs, z : ndarray, shape (m,) and (p,)
        Right sides.
    """

    L: Any
    W: Any
    V: Any
    K: Any
    w: Any
    s: Any
    du: Any
    ds: Any
    rhs: Any
    z: Any


_m, _n, _p = sizes_of(Counts)
_MEMORY = Arena(
    _Memory, L=floats(_n, _n), W=floats(_n), V=floats(_m, _p), K=floats(_p, _p), w=floats(_m), s=floats(_m),
    du=floats(_m), ds=floats(_m), rhs=floats(_m), z=floats(_p),
)  # fmt: skip
_memory_of, _size = _MEMORY.whole(), _MEMORY.sizing()


@inline
def step_inside(step, x, dx):
    """Shorten a step along which x > 0 would turn negative."""
    return min(step, -x / dx) if dx < 0.0 else step


@inline
def centring(mean, x, dx, to_x, y, dy, to_y, m):
    """Mehrotra's centring: the mean of the products x y, times the cube of the share that the predictor leaves."""
    to_x = min(1.0, to_x)
    to_y = min(1.0, to_y)
    after = 0.0
    for i in range(m):
        after += (x[i] + to_x * dx[i]) * (y[i] + to_y * dy[i])
    after /= m
    return max(mean * (after / mean) ** 3, CENTRING_FLOOR)


@njit()
def solve_dual(X, m, n, tol, u, center, low):
    """Solve for the m points X (m, n), near unit size; fill weights, center and factor.

    Returns (gap, iterations); a gap above `tol` means that the iteration stopped early.
    """
    counts = counts_of(m, n + 1)
    memory = np.empty(_size(counts), np.uint8)
    gap, iterations = _iterate(Place(memory.ctypes.data, counts), borrowed(X), n, tol, borrowed(u), center, low)
    held(memory)
    return gap, iterations


@njit()
def _iterate(place, X, n, tol, u, center, low):
    """Do the work of `solve_dual`, in memory that the caller provides."""
    m, work = place.counts.m, _memory_of(place)
    for i in range(m):
        u[i] = 1.0 / m
    gap = np.inf
    best = np.inf
    since_best = 0
    for iteration in range(MAX_ITERATIONS):
        is_definite, total, largest = _assemble(place, X, n, u)
        if not is_definite:
            return np.inf, iteration
        kappa = total * largest - 1.0
        gap = 0.5 * n * logarithm(kappa / n)
        if gap < best:
            best = gap
            since_best = 0
        else:
            since_best += 1
        if gap <= tol or since_best > 8 or not gap < np.inf:
            root = np.sqrt(kappa / total)
            for j in range(n):
                center[j] = work.L[j + 1, 0] / work.L[0, 0]
                for k in range(j + 1):
                    low[j, k] = work.L[j + 1, k + 1] * root
                for k in range(j + 1, n):
                    low[j, k] = 0.0
            for i in range(m):
                u[i] /= total
            return gap, iteration
        if iteration == 0:
            for i in range(m):
                work.s[i] = max(0.1 * (n + 1), n + 1 - work.w[i])
        if not _factor(place, u):
            return gap, iteration
        _step(place, u)
    return np.inf, MAX_ITERATIONS


@njit()
def _assemble(place, X, n, u):
    """Compute and factor M; fill w and V.

    Returns whether M is positive definite, Σ u, and the largest w.
    """
    m, N, work = place.counts.m, place.counts.n, _memory_of(place)
    L, W, V, w = work.L, work.W, work.V, work.w
    # Factor M = Σ u q qᵀ = L Lᵀ, where q = (1, x). Up to the factor √(Σ u), the first column of L holds the mean, and
    # the other columns hold the Cholesky factor of the covariance.
    for j in range(N):
        for k in range(j + 1):
            L[j, k] = 0.0
    total = 0.0
    for i in range(m):
        ui = u[i]
        total += ui
        for j in range(n):
            t = ui * X[i, j]
            L[j + 1, 0] += t
            for k in range(j + 1):
                L[j + 1, k + 1] += t * X[i, k]
    L[0, 0] = total
    if not cholesky(L, N):
        return False, total, np.inf
    largest = 0.0
    for i in range(m):
        W[0] = 1.0
        for j in range(n):
            W[j + 1] = X[i, j]
        solve_lower(L, W, N)
        w[i] = svec(W, V, i, N)
        largest = max(largest, w[i])
    return True, total, largest


@njit()
def _factor(place, u):
    """Factor K = I + Vᵀ diag(u/s) V, once for predictor and corrector (Woodbury); False if K is not definite."""
    m, p, work = place.counts.m, place.counts.p, _memory_of(place)
    K, V, s = work.K, work.V, work.s
    fill_upper(K, 1.0, p)
    for i in range(m):
        weight = u[i] / s[i]
        for j in range(p):
            t = weight * V[i, j]
            for k in range(j, p):
                K[j, k] += t * V[i, k]
    return normal_cholesky(K, p)


@njit()
def _step(place, u):
    """Change u and s by a predictor and a corrector."""
    m, work = place.counts.m, _memory_of(place)
    s, du, ds = work.s, work.du, work.ds
    mean = 0.0
    for i in range(m):
        mean += u[i] * s[i]
    mean /= m
    for i in range(m):
        ds[i] = 0.0
    to_u, to_s = _direction(place, u)
    mu = centring(mean, u, du, to_u, s, ds, to_s, m)
    for i in range(m):
        ds[i] = (mu - du[i] * ds[i]) / u[i]
    to_u, to_s = _direction(place, u)
    share = min(STEP_CAP, max(0.9, 1.0 - mean * m))
    to_u = min(1.0, share * to_u)
    to_s = min(1.0, share * to_s)
    for i in range(m):
        u[i] += to_u * du[i]
        s[i] += to_s * ds[i]


@njit()
def _direction(place, u):
    """Solve for the steps `du` and `ds`; return how far u and s may go along them.

    The equations are (V Vᵀ + diag(s/u)) du = w - N + (mu - du ds)/u and ds = (mu - du ds)/u - s - (s/u) du. On entry,
    `ds` holds the term with mu.
    """
    m, N, p, work = place.counts.m, place.counts.n, place.counts.p, _memory_of(place)
    V, w, s, du, ds, rhs, z = work.V, work.w, work.s, work.du, work.ds, work.rhs, work.z
    for j in range(p):
        z[j] = 0.0
    for i in range(m):
        rhs[i] = w[i] - N + ds[i]
        t = u[i] / s[i] * rhs[i]
        for j in range(p):
            z[j] += t * V[i, j]
    normal_solve(work.K, z, p)
    to_u = np.inf
    to_s = np.inf
    for i in range(m):
        t = rhs[i]
        for j in range(p):
            t -= V[i, j] * z[j]
        du[i] = u[i] / s[i] * t
        ds[i] += -s[i] - t
        to_u = step_inside(to_u, u[i], du[i])
        to_s = step_inside(to_s, s[i], ds[i])
    return to_u, to_s


@njit()
def spread_points(points, flatness, chosen, origin, frame):
    """Choose 2n points that are far apart, and derive a frame: Kumar and Yıldırım (2005), section 4.1.

    The two extreme points are chosen along one direction after another, each orthogonal to the differences found so
    far. `origin` becomes the mean of the chosen points. `frame` becomes a lower triangular matrix whose parallelepiped
    is about as large as the hull in every direction, even if the hull is thin. In these coordinates, the points have
    unit size.

    Returns (code, axis, width, size). The code is FLAT if the width along direction `axis` is at most `flatness` times
    the first width, or below the rounding of the coordinates.
    """
    m, n = points.shape
    basis = np.zeros((n, n))
    differences = np.empty((n, n))
    direction = np.empty(n)
    size = 0.0  # Largest absolute value of a coordinate; its rounding error affects every width.
    widest = 0.0
    for j in range(n):
        # Take the coordinate axis that the basis covers least so far. Make this axis orthogonal to the basis in two
        # passes, because a single pass loses digits.
        longest = -1.0
        axis = 0
        for k in range(n):
            rest = 1.0
            for r in range(j):
                rest -= basis[r, k] * basis[r, k]
            if rest > longest:
                longest = rest
                axis = k
        for k in range(n):
            direction[k] = 0.0
        direction[axis] = 1.0
        orthonormalise(direction, basis, j, n)
        low_value = np.inf
        high_value = -np.inf
        low_at = 0
        high_at = 0
        for i in range(m):
            value = 0.0
            for k in range(n):
                value += direction[k] * (points[i, k] - points[0, k])
            if value < low_value:
                low_value = value
                low_at = i
            if value > high_value:
                high_value = value
                high_at = i
        if j == 0:
            for i in range(m):
                for k in range(n):
                    size = max(size, abs(points[i, k]))
        width = high_value - low_value
        for k in range(n):
            differences[j, k] = points[high_at, k] - points[low_at, k]
            basis[j, k] = differences[j, k]
        norm = 0.0
        for k in range(n):
            norm += basis[j, k] * basis[j, k]
        widest = max(widest, np.sqrt(norm))
        # Rounding alone can cause a width of up to 2 n times the rounding error of the largest coordinate.
        if not width > max(flatness * widest, 4.0 * n * ROUNDING * size):
            return FLAT, j, width, widest
        orthonormalise(basis[j], basis, j, n)
        chosen[2 * j] = low_at
        chosen[2 * j + 1] = high_at
    for k in range(n):
        total = 0.0
        for j in range(2 * n):
            total += points[chosen[j], k] - points[chosen[0], k]
        origin[k] = points[chosen[0], k] + total / (2 * n)
    if not householder_triangle(differences, n, n):
        return FLAT, n - 1, 0.0, widest
    for j in range(n):
        for k in range(n):
            frame[j, k] = differences[k, j] if k <= j else 0.0
    return 0, 0, 0.0, widest


@inline
def orthonormalise(v, basis, j, n):
    """Make `v` orthogonal to the first j rows of `basis`, and of unit length."""
    for _ in range(2):
        for r in range(j):
            dot = 0.0
            for k in range(n):
                dot += v[k] * basis[r, k]
            for k in range(n):
                v[k] -= dot * basis[r, k]
    norm = 0.0
    for k in range(n):
        norm += v[k] * v[k]
    norm = np.sqrt(norm)
    for k in range(n):
        v[k] /= norm


@inline
def to_frame(point, origin, frame, out, n):
    """Coordinates of a point: frame⁻¹ (point - origin)."""
    for k in range(n):
        out[k] = point[k] - origin[k]
    solve_lower(frame, out, n)


@njit()
def farthest_by_sector(points, center, factor, threshold, best, best_at):
    """In one pass over all points, find the largest |factor⁻¹ (x - center)|² and the farthest point of each sector.

    A sector is the signed coordinate axis nearest to the point, so the 2n candidates lie in different directions. Only
    points above `threshold` are candidates.
    """
    m, n = points.shape
    y = np.empty(n)
    inverse = np.empty(n)
    for k in range(n):
        inverse[k] = 1.0 / factor[k, k]
    for j in range(2 * n):
        best[j] = threshold
        best_at[j] = -1
    largest = 0.0
    for i in range(m):
        norm2 = 0.0
        for k in range(n):
            value = points[i, k] - center[k]
            for r in range(k):
                value -= factor[k, r] * y[r]
            value *= inverse[k]
            y[k] = value
            norm2 += value * value
        if norm2 > largest:
            largest = norm2
        if norm2 > threshold:
            sector = 0
            longest = 0.0
            for k in range(n):
                if abs(y[k]) > longest:
                    longest = abs(y[k])
                    sector = 2 * k + (1 if y[k] < 0.0 else 0)
            if norm2 > best[sector]:
                best[sector] = norm2
                best_at[sector] = i
    return largest


@inline
def condition(factor, inverse, n):
    """‖ |L⁻¹| |L| ‖ in the Frobenius norm: the factor by which a triangular solve can magnify rounding."""
    total = 0.0
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(j, i + 1):
                value += abs(inverse[i, k]) * abs(factor[k, j])
            total += value * value
    return np.sqrt(total)


@njit()
def enclose(points, center, factor):
    """Scale `factor` until every point is certainly inside, with `center` and `factor` as they are stored.

    A computed y = L⁻¹ (x - c) is the exact solution for L (1 + δ), |δ| <= n u, and x - c has one rounding: the true
    length is at most |y| (1 + (1.5 n + 3) u B), where B = ‖ |L⁻¹| |L| ‖. The check uses (2n + 4) u B.

    Returns this relative error bound, or -1 if three rounds did not suffice.
    """
    m, n = points.shape
    inverse = np.empty((n, n))
    none = np.empty(2 * n)
    none_at = np.empty(2 * n, np.int64)
    invert_lower(factor, inverse, n)
    error = (2 * n + 4) * ROUNDING * condition(factor, inverse, n)
    for attempt in range(4):
        reach = np.sqrt(farthest_by_sector(points, center, factor, np.inf, none, none_at))
        if attempt > 0 and reach * (1.0 + error) <= 1.0:
            return error
        # Each scaled entry is rounded once, which again adds at most u B.
        scale = reach * (1.0 + error) * (1.0 + (attempt + 1) * 2.0 / (n + 2) * error)
        for j in range(n):
            for k in range(j + 1):
                factor[j, k] *= scale
    return -1.0


@njit()
def outer_gap(points, index, u, count, center, factor, error):
    """Certified log(volume / smallest volume) of {c + L ball}, from dual weights on some of the points.

    Let y = L⁻¹ (x - c), and let S be the weighted covariance of all y. The optimum has at least the volume of √n S^½
    ball. The gap is therefore -½ log det S - n/2 log n, plus the amount that rounding can hide; `error` is the relative
    rounding error of y.
    """
    n = points.shape[1]
    mean = np.zeros(n)
    S = np.zeros((n, n))
    y = np.empty(n)
    total = 0.0
    for a in range(count):
        to_frame(points[index[a]], center, factor, y, n)
        total += u[a]
        for j in range(n):
            mean[j] += u[a] * y[j]
            for k in range(j + 1):
                S[j, k] += u[a] * y[j] * y[k]
    for j in range(n):
        mean[j] /= total
    for j in range(n):
        for k in range(j + 1):
            S[j, k] = S[j, k] / total - mean[j] * mean[k]
    if not cholesky(S, n):
        return np.inf
    log_det = 0.0
    for j in range(n):
        log_det += 2.0 * logarithm(S[j, j])
    return -0.5 * log_det - 0.5 * n * logarithm(n) + 2.0 * n * error


@njit()
def fit_outer(points, tol, flatness, center, factor):
    """Smallest ellipsoid around `points` (m, n), certified within `tol` in log-volume.

    Fills `center` and the lower triangular `factor`. Returns (code, gap, iterations, axis, width, size).
    """
    m, n = points.shape
    chosen = np.empty(2 * n, np.int64)
    origin = np.empty(n)
    frame = np.empty((n, n))
    code, axis, width, size = spread_points(points, flatness, chosen, origin, frame)
    if code != 0:
        return code, np.inf, 0, axis, width, size

    limit = DIRECT_LIMIT + 2 * n * n
    direct = m <= limit
    capacity = m if direct else 4 * limit
    index = np.empty(capacity, np.int64)
    X = np.empty((capacity, n))
    u = np.empty(capacity)
    count = m if direct else 0
    if direct:
        for i in range(m):
            index[i] = i
    else:
        for j in range(2 * n):
            is_listed = False
            for a in range(count):
                is_listed = is_listed or index[a] == chosen[j]
            if not is_listed:
                index[count] = chosen[j]
                count += 1
    for a in range(count):
        to_frame(points[index[a]], origin, frame, X[a], n)

    local_center = np.empty(n)
    low = np.empty((n, n))
    y = np.empty(n)
    far = np.empty(2 * n)
    far_at = np.empty(2 * n, np.int64)
    iterations = 0
    # The first rounds only search for the points that matter, so inaccurate solutions are good enough.
    inner_tol = 0.25 * tol if direct else max(0.25 * tol, 0.01)
    gap = np.inf
    for _ in range(MAX_ROUNDS):
        gap, steps = solve_dual(X, count, n, inner_tol, u, local_center, low)
        iterations += steps
        if not gap < np.inf:
            return STALLED, gap, iterations, 0, 0.0, size
        multiply_lower(frame, low, factor, n)
        for j in range(n):
            value = 0.0
            for k in range(j + 1):
                value += frame[j, k] * local_center[k]
            center[j] = origin[j] + value
        if direct:
            break
        # Points with a squared radius up to exp(tol / n) use at most half of the tolerance. In each sector, the
        # farthest of the other points joins the active set.
        reach = farthest_by_sector(points, center, factor, exponential(tol / n), far, far_at)
        fresh = 0
        for j in range(2 * n):
            is_listed = far_at[j] < 0
            for a in range(count):
                is_listed = is_listed or index[a] == far_at[j]
            if is_listed:
                far_at[j] = -1
            else:
                fresh += 1
        if fresh == 0:
            if inner_tol <= 0.25 * tol:
                break
            inner_tol = max(0.25 * tol, 0.01 * inner_tol)
            continue
        inner_tol = max(0.25 * tol, min(inner_tol, 0.1 * n * logarithm(reach)))
        kept = 0
        for a in range(count):
            inside = 0.0
            for k in range(n):
                y[k] = X[a, k] - local_center[k]
            solve_lower(low, y, n)
            for k in range(n):
                inside += y[k] * y[k]
            if u[a] > LIGHT or inside > NEAR:
                index[kept] = index[a]
                for k in range(n):
                    X[kept, k] = X[a, k]
                kept += 1
        count = kept
        for j in range(2 * n):
            if far_at[j] >= 0 and count < capacity:
                index[count] = far_at[j]
                to_frame(points[far_at[j]], origin, frame, X[count], n)
                count += 1

    error = enclose(points, center, factor)
    if error < 0.0:
        return STALLED, gap, iterations, 0, 0.0, size
    gap = outer_gap(points, index, u, count, center, factor, error)
    return (0 if gap <= tol else STALLED), gap, iterations, 0, 0.0, size
