"""Find the smallest ellipsoid around points in high dimension: coordinate ascent, then an interior-point method.

The dual maximises log det M over weights u >= 0, Σ u = 1, with M = Σ u_i q_i q_iᵀ and q = (1, x) of length N = n + 1;
if the center is given, q = x - center and N = n. With w_i = q_iᵀ M⁻¹ q_i the optimum has w <= N everywhere, and w = N
wherever u > 0.

- Coordinate ascent with away steps (Atwood 1973; Todd and Yıldırım 2007, doi:10.1016/j.dam.2007.02.013) moves weight to
  the point with the largest w or from the point with the smallest w, depending on which w is farther from N. Each step
  updates M⁻¹ and w by a term of rank one.
- A point with w below N times a bound that depends on max w alone has no weight at the optimum (Harman and Pronzato
  2007, doi:10.1016/j.spl.2006.05.014), and is dropped. The first rounds use a less cautious bound, so all points are
  tested again at the end.
- On the remaining points, Newton's method solves u s = 0, s = N - w. The method's matrix diag(s/u) + (W Wᵀ)∘(W Wᵀ) has
  a row for each point, not for each of the N (N + 1) / 2 entries of M as in `_kernels.fits.mvce`.

All three steps use only a working set. One pass over all points per round finds the points outside the ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loewner._base import _memory
from loewner._base._validate import Bools, Floats, Ints
from loewner.ellipsoids.large_fits import dense
from loewner.ellipsoids.large_fits.dense import LARGEST_SYSTEM, ROUNDING, Reporter, blocks, inverse_of, lower_root
from loewner.ellipsoids.polytopes import FLATNESS, flat_error

# Size of the first working set and largest number of points added per round, both divided by N.
FIRST, MORE = 10, 4
# Once the number of points that may touch the ellipsoid is at most ENOUGH times the size of the working set, the set
# takes all these points.
ENOUGH = 2
# Largest numbers of rounds, of rounds in which points may be dropped by a guess, and of interior-point steps.
MAX_ROUNDS, BOLD_ROUNDS, MAX_STEPS = 100, 30, 60
# Largest number of ascents, for sets in which too many points matter.
MAX_ASCENTS = 400
# Time of a step of the ascent, and of a step of the interior-point method, measured on one core [s]: a constant, and
# the time per number or multiplication. These constants, not clocks, decide when to change methods, so that results are
# reproducible.
ASCENT_STEP, ASCENT_NUMBER = 1.5e-5, 4.0e-10
NEWTON_STEP, NEWTON_FLOP, NEWTON_STEPS = 2.0e-4, 3.0e-11, 10
# The ascent may cost this share of the work that it saves the interior-point method.
SHARE = 0.35
# The interior-point method starts with the ascent's weights, plus this share spread evenly, which saves one step in
# eight.
EVEN = 0.2
# Weights that the interior-point method leaves below this share of the mean are set to 0.
NOTHING = 1e-9
# The interior-point method drops points only if together they contribute less than this to M, so that M stays regular.
LOSS = 0.5


@dataclass
class _WorkingSet:
    """Some of the points, in coordinates of unit size, with weights whose sum is 1."""

    index: Ints
    Q: Floats  # shape (k, N); the first column is ones, unless the center is given
    u: Floats
    lifted: int  # N - n, which is 0 if the center is given, and 1 otherwise
    bold: bool = True  # points are dropped by a guess, until a dropped point turns out to matter

    @property
    def dim(self) -> int:
        return int(self.Q.shape[1]) - self.lifted

    def gap(self, largest: float) -> float:
        """Compute the gap of the ellipsoid around the set, given the largest w."""
        return float(0.5 * self.dim * np.log((largest - self.lifted) / self.dim))

    def keep(self, rows: Bools) -> None:
        if not rows.all():
            self.index, self.Q, self.u = self.index[rows], self.Q[rows], self.u[rows]

    def add(self, index: Ints) -> None:
        self.index = np.concatenate([self.index, index])
        self.u = np.concatenate([self.u, np.zeros(len(index))])


def smallest_around(
    points: Floats, tol: float, given: Floats | None, reporter: Reporter
) -> tuple[Floats, Floats, float, int, Floats]:
    """Find the smallest ellipsoid around `points`: center, lower triangular factor, certified gap, steps, weights.

    The center is `given`, or free if `given` is None. The gap may be above `tol`, or infinite.

    Raises
    ------
    GeometryError
        If the points lie in a hyperplane.
    """
    _memory.expect_place(_memory.KERNELS, _memory.SCIPY)
    _memory.expect_room_for_blas()
    m, n = points.shape
    lifted = 1 if given is None else 0
    sample = _spaced(m, FIRST * (n + 1))
    origin, frame, chosen = _spread(points, sample, given)
    first_frame, unframe = frame, inverse_of(frame)

    def whitened(index: Ints) -> Floats:
        X = (points[index] - origin) @ unframe.T
        return np.column_stack([np.ones(len(index)), X]) if lifted else X

    first = np.union1d(sample, chosen)
    u = np.isin(first, chosen) / len(chosen)
    active = _WorkingSet(first, whitened(first), u, lifted)
    pool, names = points, None  # points that may touch the ellipsoid, and their indices (None for all points)
    target = 0.25 * tol if len(first) == m else max(0.25 * tol, 0.02 * n)
    steps = 0
    volume = -np.inf
    for turn in range(MAX_ROUNDS):
        taken, reached = _solve(active, target, reporter)
        steps += taken
        if not reached < np.inf:
            return origin, frame, np.inf, steps, np.zeros(m)
        center, factor = _ellipsoid(active, origin, frame)
        inverse = inverse_of(factor)
        # Added points need a larger ellipsoid; if the volume did not grow, points that were dropped mattered.
        volume, before = float(np.log(np.diagonal(factor)).sum()), volume
        if volume + reached < before or turn > BOLD_ROUNDS:
            active.bold = False
        radii = _squared_radii(pool, center, inverse)
        gap = 0.5 * n * np.log(radii.max())
        reporter.reached(gap)
        if gap <= 0.5 * tol:
            if names is None:
                break
            pool, names = points, None  # omitted points are tested once more; if any matters, there are no more guesses
            active.bold = False
            continue
        bound = _least_of_support(radii.max() * n + lifted, n + lifted, active.bold)
        may_touch = np.flatnonzero(lifted + n * radii >= bound)
        if finish := len(may_touch) <= ENOUGH * len(active.u):
            fresh = may_touch  # these points include all points that the optimum needs
        else:
            fresh = _farthest(pool, radii, center, inverse, np.exp(tol / n))
        fresh = np.setdiff1d(fresh if names is None else names[fresh], active.index)
        if len(fresh) == 0 and names is None and reached > target and frame is not first_frame:
            break  # rounding allows no further improvement
        if 8 * len(may_touch) <= len(pool):
            pool, names = pool[may_touch], may_touch if names is None else names[may_touch]
        # Change to the coordinates of this ellipsoid, since heavy tails skew the initial coordinates.
        origin, frame, unframe = center, factor, inverse
        active.add(fresh)
        active.Q = whitened(active.index)
        # No round is solved much more accurately than the present gap requires.
        target = 0.25 * tol if finish else max(0.25 * tol, min(target, 0.1 * gap))
    weights = np.zeros(m)
    weights[active.index] = active.u
    reach = np.sqrt(radii.max()) if names is None else np.inf
    factor, scale, error = _enclosing(factor, inverse, reach)
    return center, factor, _certified(points, weights, center, inverse / scale, error, lifted), steps, weights


# -- the start ------------------------------------------------------------------------------------


def _spaced(m: int, count: int) -> Ints:
    """Select at most `count` of m points, evenly spaced."""
    return np.arange(m) if m <= count else np.linspace(0, m - 1, count).astype(np.int64)


def _spread(points: Floats, sample: Ints, given: Floats | None) -> tuple[Floats, Floats, Ints]:
    """Find the origin, frame and indices of points far apart, like `_kernels.fits.mvce.spread_points`.

    If the center is given, the reflections of the points in the center count as well.

    A sample suffices if it is far from flat; otherwise all points are used.
    """
    m, n = points.shape
    size = max(float(points.max()), -float(points.min()), 0.0 if given is None else float(np.abs(given).max()))
    noise = 4.0 * n * ROUNDING * size
    few = points if len(sample) == m else points[sample]
    chosen, differences, narrowest = _extremes(few, noise, FLATNESS, given)
    if len(sample) < m:
        chosen = sample[chosen]
        if narrowest < 1e-6:
            chosen, differences, narrowest = _extremes(points, noise, FLATNESS, given)
    if narrowest == 0.0:
        raise flat_error("points", points if given is None else np.concatenate([points, 2 * given - points]))
    frame = lower_root(differences)
    if given is not None:
        return given, frame, np.unique(chosen)
    origin = points[chosen[0]] + (points[chosen] - points[chosen[0]]).mean(axis=0)
    return origin, frame, np.unique(chosen)


def _extremes(points: Floats, noise: float, flatness: float, given: Floats | None) -> tuple[Ints, Floats, float]:
    """Find Kumar and Yıldırım's 2n points, n differences, and the ratio of the least to the largest width; 0 if flat.

    About a given center, one point per direction suffices, since its reflection is the other point.
    """
    about = points[0] if given is None else given
    n = points.shape[1]
    basis, differences = np.zeros((n, n)), np.zeros((n, n))
    chosen = np.zeros(2 * n, np.int64)
    widest, narrowest = 0.0, np.inf
    small = [(0, points - about)] if points.size <= 2**22 else None
    for j in range(n):
        direction = np.zeros(n)
        direction[np.argmin((basis[:j] ** 2).sum(axis=0))] = 1.0
        direction = _orthonormal(direction, basis[:j])
        low, high = (np.inf, 0), (-np.inf, 0)
        for first, block in small or ((some.start, b - about) for some, b in blocks(points)):
            along = block @ direction
            if given is not None:
                along = np.abs(along)
            i, k = int(along.argmin()), int(along.argmax())
            low, high = min(low, (along[i], first + i)), max(high, (along[k], first + k))
        if given is not None:
            low = (-high[0], high[1])
        differences[j] = points[high[1]] - points[low[1]] if given is None else 2.0 * (points[high[1]] - given)
        widest = max(widest, float(np.linalg.norm(differences[j])))
        width = high[0] - low[0]
        if not width > max(flatness * widest, noise):
            return chosen, differences, 0.0
        # A width close to the noise is unreliable and counts as narrow.
        narrowest = min(narrowest, width if width > 100 * noise else 0.5 * flatness * widest)
        basis[j] = _orthonormal(differences[j], basis[:j])
        chosen[2 * j : 2 * j + 2] = low[1], high[1]
    return chosen, differences, narrowest / widest


def _orthonormal(v: Floats, basis: Floats) -> Floats:
    """Make `v` orthogonal to the rows of `basis`, twice because a single pass loses digits, and normalise it."""
    for _ in range(2):
        v = v - (basis @ v) @ basis
    return np.asarray(v / np.linalg.norm(v))


# -- the working set ------------------------------------------------------------------------------


def _solve(active: _WorkingSet, target: float, reporter: Reporter) -> tuple[int, float]:
    """Find weights of the working set to a gap of `target`, dropping inner points; return steps and gap reached."""
    n = active.dim
    spent, steps, gap = 0.0, 0, np.inf
    for _ in range(MAX_ASCENTS):
        reporter.report()
        root = dense.root_of_inverse((active.Q * active.u[:, None]).T @ active.Q)
        if root is None:
            return steps, np.inf
        W = active.Q @ root.T
        w = np.einsum("ij,ij->i", W, W)
        gap = active.gap(w.max())
        if gap <= target:
            return steps, gap
        may_touch = (w >= _least_of_support(w.max(), n + active.lifted, active.bold)) | (active.u > 0)
        if may_touch.sum() < 0.9 * len(w):
            active.keep(may_touch)
            w = w[may_touch]
        k = len(w)
        left = SHARE * NEWTON_STEPS * (NEWTON_STEP + NEWTON_FLOP * (k**3 / 3 + k**2 * n)) - spent
        each = ASCENT_STEP + ASCENT_NUMBER * active.Q.size
        if left < each and k <= LARGEST_SYSTEM:
            taken, gap = _interior_point(active, target, reporter)
            return steps + taken, gap
        count = n + 50 if k > LARGEST_SYSTEM else max(1, min(n + 50, int(left / each)))
        _ascend(active, root.T @ root, w, count, target)
        spent, steps = spent + count * each, steps + count
    return steps, gap


def _least_of_support(largest: float, N: int, bold: bool) -> float:
    """Bound the w below which u is zero at the optimum (Harman and Pronzato 2007), with an allowance, or guess this w.

    The theorem assumes the worst case, that the excess of the largest w over N is due to one direction; the bold guess
    assumes an Nth of that excess. In high dimension, the guess keeps far fewer points, and is nearly always right.
    """
    excess = max(largest - N, 0.0) / (N if bold else 1)
    bound = 1.0 + 0.5 * excess - 0.5 * np.sqrt(excess * (4.0 + excess - 4.0 / N))
    return float(N * bound * (1.0 - 1e-9))


def _ascend(active: _WorkingSet, inverse: Floats, w: Floats, count: int, target: float) -> None:
    """Take at most `count` steps towards the farthest point or away from the nearest point that has weight."""
    Q, u = active.Q, active.u.copy()
    N = Q.shape[1]
    if N == 1:  # on a line, the point farthest from the given center has all the weight
        active.u = np.where(np.arange(len(u)) == w.argmax(), 1.0, 0.0)
        return
    enough = active.lifted + active.dim * np.exp(2.0 * target / active.dim)
    nearest = np.where(u > 0, w, np.inf)
    for _ in range(count):
        j = int(w.argmax())
        if w[j] <= enough:
            break
        np.copyto(nearest, w)
        nearest[u <= 0] = np.inf
        k = int(nearest.argmin())
        if N - w[k] > w[j] - N:
            j = k
        # For a point at the center, w is 1, and rounding could flip the sign of w - 1; such a point loses all its
        # weight.
        share = max((w[j] - N) / (N * max(w[j] - 1.0, ROUNDING)), -u[j] / (1.0 - u[j]))
        g = inverse @ Q[j]
        z = Q @ g
        by = share / (1.0 - share + share * w[j])
        u *= 1.0 - share
        u[j] = max(u[j] + share, 0.0) if share > 0 or u[j] + share > 1e-15 else 0.0
        inverse -= np.outer(by * g, g)
        inverse /= 1.0 - share
        z *= z
        z *= by
        w -= z
        w /= 1.0 - share
    active.u = u / u.sum()


def _interior_point(active: _WorkingSet, target: float, reporter: Reporter) -> tuple[int, float]:
    """Solve like `_kernels.fits.mvce.solve_dual`, but with one matrix row per point; return steps and gap.

    Points that cannot have weight are dropped. At the end, the working set has the best weights of all steps.
    """
    N = active.Q.shape[1]
    index, Q = active.index, active.Q
    u, s = (1.0 - EVEN) * active.u + EVEN / len(Q), np.empty(0)
    best, since_best = np.inf, 0
    for step in range(MAX_STEPS):
        reporter.report()
        root = dense.root_of_inverse((Q * u[:, None]).T @ Q)
        if root is None:
            return step, best
        W = Q @ root.T
        w = np.einsum("ij,ij->i", W, W)
        total = float(u.sum())
        gap = active.gap(total * w.max())
        since_best += 1
        if gap < best:
            best, since_best = gap, 0
            active.index, active.Q, active.u = index, Q, np.where(u * len(u) > NOTHING * total, u, 0.0)
            active.u /= active.u.sum()
        if not gap < np.inf or gap <= target or since_best > 8:
            return step, best
        if step == 0:
            s = np.maximum(0.1 * N, N - w)
        keep = total * w >= _least_of_support(total * w.max(), N, active.bold)
        if keep.sum() < 0.9 * len(w) and u[~keep] @ w[~keep] < LOSS:
            index, Q, W, w, u, s = index[keep], Q[keep], W[keep], w[keep], u[keep], s[keep]
        moved = _newton_step(W, w, u, s)
        if moved is None:
            return step, best
        u, s = moved
    return MAX_STEPS, best


def _newton_step(W: Floats, w: Floats, u: Floats, s: Floats) -> tuple[Floats, Floats] | None:
    """Compute new weights and slacks by Mehrotra's predictor and corrector; None if singular to rounding."""
    k, N = W.shape
    matrix = W @ W.T
    matrix *= matrix
    solve = dense.solver_of(matrix, s / u)
    if solve is None:
        return None

    def direction(extra: Floats) -> tuple[Floats, Floats]:
        du = solve(w - N + extra)
        return du, extra - s - s / u * du

    mean = float(u @ s) / k
    du, ds = direction(np.zeros(k))
    after = float((u + min(1.0, dense.room(u, du)) * du) @ (s + min(1.0, dense.room(s, ds)) * ds)) / k
    mu = max(mean * (after / mean) ** 3, dense.CENTRING_FLOOR)
    du, ds = direction((mu - du * ds) / u)
    share = min(dense.STEP_CAP, max(0.9, 1.0 - mean * k))
    return u + min(1.0, share * dense.room(u, du)) * du, s + min(1.0, share * dense.room(s, ds)) * ds


# -- all points -----------------------------------------------------------------------------------


def _ellipsoid(active: _WorkingSet, origin: Floats, frame: Floats) -> tuple[Floats, Floats]:
    """Compute the center and factor of the ellipsoid with the boundary w = N."""
    X, u = active.Q[:, active.lifted :], active.u
    mean = u @ X if active.lifted else np.zeros(active.dim)
    offsets = X - mean
    # Use QR, since the matrix of second moments has the square of the condition number.
    return origin + frame @ mean, np.tril(frame @ lower_root(np.sqrt(len(mean) * u)[:, None] * offsets))


def _squared_radii(points: Floats, center: Floats, inverse: Floats) -> Floats:
    """Compute |inverse (x - center)|² for all points, block by block."""
    radii = np.empty(len(points))
    for some, block in blocks(points):
        y = (block - center) @ inverse.T
        np.einsum("ij,ij->i", y, y, out=radii[some])
    return radii


def _farthest(points: Floats, radii: Floats, center: Floats, inverse: Floats, threshold: float) -> Ints:
    """Select points above `threshold` in different directions: the MORE / 2 farthest points of each sector.

    There are two sectors for each axis of the ellipsoid, one in either direction; a point belongs to the nearest one.
    """
    n = points.shape[1]
    outside = np.flatnonzero(radii > threshold)
    many = 16 * MORE * (n + 1)
    if len(outside) > many:
        outside = outside[np.argpartition(radii[outside], -many)[-many:]]
    y = (points[outside] - center) @ inverse.T
    axis = np.abs(y).argmax(axis=1)
    sector = 2 * axis + (y[np.arange(len(y)), axis] < 0)
    order = np.lexsort((-radii[outside], sector))
    starts = np.flatnonzero(np.diff(sector[order], prepend=-1))
    place = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return np.sort(outside[order[place < MORE // 2]])


# -- the proof ------------------------------------------------------------------------------------


def _enclosing(factor: Floats, inverse: Floats, reach: float) -> tuple[Floats, float, float]:
    """Scale `factor` until it certainly contains every point; return factor, scale, and the rounding error of radii.

    With X = `inverse`, L the factor, d = x - c, y = L⁻¹ d, s > 0 and R = 1 - X L / s: X d / s = (1 - R) y. Since X is
    lower triangular, entry i of the computed X d errs by (i + 3) u |X| |d| <= (i + 3) u |X| |L| |y| in any order of
    summation. The entries of the computed R have errors of the same kind. Therefore, |y| (1 - error) is at most the
    computed |X d| / s.
    """
    n = len(factor)
    terms = 2.0 * np.arange(n)[:, None] + 10.0
    scale = reach
    for _ in range(6):
        if not scale < np.inf:
            break
        scaled = np.tril(factor * scale)
        off = np.linalg.norm(np.eye(n) - (inverse @ scaled) / scale)
        spread = np.linalg.norm(terms * (np.abs(inverse) @ np.abs(scaled))) / scale
        error = 1.01 * float(off + (spread + n + 4) * ROUNDING)
        if not error < 0.1:
            break
        if reach <= scale * (1.0 - error):
            return scaled, scale, error
        scale = reach * (1.0 + 1.02 * error + 8.0 * ROUNDING)
    return factor, reach, np.inf


def _certified(points: Floats, weights: Floats, center: Floats, inverse: Floats, error: float, lifted: int) -> float:
    """Certify log(volume / smallest volume) from weights of the points; see `_kernels.fits.mvce.outer_gap`.

    About a given center, second moments replace covariances.

    y is known up to a linear map 1 - R, |R| <= `error` in the Frobenius norm, and a shift of length `error`. The map
    changes ½ log det S by at most 1.1 √n errors. In the nuclear norm, the shift changes S by 3 errors, and the rounding
    of sums and of Cholesky's factors changes S by (2 k + 2 n + 16) u √n. Divided by twice the least eigenvalue of S,
    these changes bound the change of ½ log det S. The error of that eigenvalue is far below 1e-11, since S has trace 1.
    """
    if not error < 0.1:
        return np.inf
    n = len(center)
    support = np.flatnonzero(weights)
    y = (points[support] - center) @ inverse.T
    u = weights[support]
    if lifted:
        y -= u @ y
    S = (y * u[:, None]).T @ y
    half = dense.half_log_det(S)
    if not half > -np.inf:
        return np.inf
    k = len(support)
    least = 0.99 * float(np.linalg.eigvalsh(S)[0]) - 1e-11
    change = (3.0 * error + 2.0 * np.sqrt(n) * (k + n + 8) * ROUNDING) / least if least > 0 else np.inf
    if not change < 0.1:
        return np.inf
    gap = -half - 0.5 * n * np.log(n)
    return float(gap + 0.53 * change + 1.1 * np.sqrt(n) * error + n * (k + n + 8) * ROUNDING)
