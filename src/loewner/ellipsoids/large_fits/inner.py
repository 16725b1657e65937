"""Find the largest ellipsoid inside very many half-spaces, or half-spaces in high dimension, in NumPy.

The interior-point method is Zhang and Gao's (2003, doi:10.1137/S1052623401397230), as in `_kernels.fits.mvie`. With the
multipliers y and the slacks z, E² = (Aᵀ Y A)⁻¹ = L Lᵀ, T = A L and h_i = |T_i|, a step solves systems with the matrix

    S = diag(2 h z / y) + (T Tᵀ)∘(T Tᵀ),

which has a row for each half-space and, apart from its diagonal, the low rank n (n + 1) / 2. The matrix is factorised
directly, or with Woodbury's identity if that costs less.

Few half-spaces touch the ellipsoid. The interior-point method works on a subset, from which half-spaces far from the
ellipsoid are dropped by a heuristic. A pass over all half-spaces then finds the half-spaces that cut the ellipsoid, and
adds them. A solution for the subset that also lies inside all other half-spaces is the answer, and its multipliers
prove it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from math import fsum
from typing import Any

import numpy as np

from loewner._base import _memory, _validate
from loewner._base._validate import Bools, Floats, Ints
from loewner._native import entries
from loewner.ellipsoids.large_fits import dense
from loewner.ellipsoids.large_fits.dense import LARGEST_SYSTEM, ROUNDING, Reporter, blocks, lower_root, solver_of
from loewner.ellipsoids.polytopes import FLATNESS

# Size of the first working set and largest number of half-spaces added per round, both divided by n. A round may always
# double the set, because all half-spaces are needed if all touch the ellipsoid.
FIRST, MORE = 10, 10
# Largest numbers of rounds, of rounds in which half-spaces may be dropped by a guess, and of interior-point steps.
MAX_ROUNDS, BOLD_ROUNDS, MAX_STEPS = 100, 20, 60
# The guess drops half-spaces whose slack exceeds their reach by FAR times the gap divided by n.
FAR = 4.0
# Half-spaces are dropped only if their share of the multipliers is less than LOSS and the gap is less than CLOSE times
# n.
LOSS, CLOSE = 0.1, 0.2
# Multipliers below this share of the largest multiplier are left out of the proof.
NOTHING = 1e-30
# The next round starts at the last center, or at a point between the first center and the last center. Along this line,
# the start is at most this share of the way to the first boundary of a half-space.
INSIDE = 0.9


@dataclass
class _WorkingSet:
    """Some of the half-spaces {x : R x <= 1}, with their multipliers."""

    index: Ints
    y: Floats
    bold: bool = True  # half-spaces are dropped by a guess, until the volume grows although half-spaces were added

    def keep(self, rows: Bools) -> None:
        self.index, self.y = self.index[rows], self.y[rows]

    def add(self, index: Ints) -> None:
        self.index = np.concatenate([self.index, index])
        self.y = np.concatenate([self.y, np.full(len(index), self.y.mean())])


@dataclass(frozen=True)
class _Inside:
    """An ellipsoid x + root B (B: unit ball), and a bound on log(largest volume / its volume) for the working set."""

    x: Floats
    root: Floats
    gap: float
    steps: int

    @property
    def volume(self) -> float:
        return float(np.linalg.slogdet(self.root)[1])


def largest_inside(
    A: Floats, b: Floats, center: Floats, frame: Floats, tol: float, reporter: Reporter
) -> tuple[Floats, Floats, Floats, int]:
    """Find the center, lower triangular factor, multipliers and steps of the largest ellipsoid in {x : A x <= b}.

    `center` is the analytic center, and `frame` whitens the half-spaces about it; both come from `entries.center_in`.
    The result is correct only up to rounding errors; `proven` computes how good it is. If no ellipsoid was found, the
    factor is zero.
    """
    _memory.expect_room_for_blas(4 * A.nbytes)  # for R, and as much again for each step and for its linear system
    n = A.shape[1]
    distinct, lam = _distinct(A, b), np.zeros(len(A))
    if len(distinct) < len(A):
        A, b = A[distinct], b[distinct]
    slack = b - A @ center
    R = (A @ frame) / slack[:, None]
    active = _first(R)
    target = 0.25 * tol if len(active.index) == len(R) else max(0.25 * tol, 0.02 * n)
    x, steps, volume = np.zeros(n), 0, np.inf
    for turn in range(MAX_ROUNDS):
        fit = _solve(R[active.index], x, active, target, reporter)
        steps += fit.steps
        if not fit.gap < np.inf:  # the intersection is unbounded, or nearly unbounded
            if len(active.index) == len(R):
                break
            active = _WorkingSet(np.arange(len(R)), np.ones(len(R)), bold=False)
            x = np.zeros(n)
            continue
        ratio = _ratios(R, fit)
        shrink = float(ratio.min())
        gap = fit.gap - n * np.log(shrink) if shrink > 0.0 else np.inf
        reporter.reached(gap)
        if gap <= 0.5 * tol or turn == MAX_ROUNDS - 1:
            break
        # Added half-spaces cannot enlarge the ellipsoid; if it grew, half-spaces that were dropped mattered.
        if fit.volume - fit.gap > volume or turn > BOLD_ROUNDS:
            active.bold = False
        volume = fit.volume
        cut = np.setdiff1d(np.flatnonzero(ratio < 1.0), active.index)
        if len(cut) == 0 and fit.gap > target:
            if not active.bold:
                break  # rounding allows no further improvement
            active.bold = False
        most = max(MORE * n, len(active.index))
        if finish := len(cut) <= most and gap < 0.05 * n:
            target = 0.25 * tol
        else:
            target = max(0.25 * tol, min(target, 0.1 * min(gap, n)))
        active.add(cut if finish or len(cut) <= most else cut[np.argpartition(ratio[cut], most)[:most]])
        # The start moves back towards the first center, which is inside all half-spaces.
        x = fit.x * min(1.0, INSIDE / max(float((R[active.index] @ fit.x).max()), 1e-300))
    else:
        return center, np.zeros((n, n)), lam, steps
    if not fit.gap < np.inf:
        return center, np.zeros((n, n)), lam, steps
    lam[distinct[active.index]] = active.y * np.linalg.norm(R[active.index] @ fit.root, axis=1) / slack[active.index]
    factor = frame @ fit.root
    return center + frame @ fit.x, lower_root(factor.T), lam, steps


def _distinct(A: Floats, b: Floats) -> Ints:
    """Find the rows that repeat no other row; rows are compared if their products with one vector are nearly equal."""
    key = A @ np.random.default_rng(0).normal(size=A.shape[1]) + b
    order = np.argsort(key, kind="stable")
    close = np.flatnonzero(np.diff(key[order]) <= 1e-12 * np.abs(key[order[1:]]))
    one, other = order[close], order[close + 1]
    again = other[(b[one] == b[other]) & (A[one] == A[other]).all(axis=1)]
    return np.delete(np.arange(len(A)), again)


def _first(R: Floats) -> _WorkingSet:
    """Select the nearest half-spaces, overall and along each axis, and more until their intersection is bounded."""
    m, n = R.shape
    if m <= 2 * FIRST * n:
        return _WorkingSet(np.arange(m), np.ones(m))
    nearest = np.argpartition(-np.einsum("ij,ij->i", R, R), FIRST * n)[: FIRST * n]
    index = np.unique(np.concatenate([nearest, R.argmax(axis=0), R.argmin(axis=0)]))
    for _ in range(4 * n):
        direction = _way_out(R[index])
        if direction is None:
            return _WorkingSet(index, np.ones(len(index)))
        index = np.union1d(index, np.argpartition(-(R @ direction), n)[:n])
    return _WorkingSet(np.arange(m), np.ones(m))


def _way_out(R: Floats) -> Floats | None:
    """Find a direction in which {x : R x <= 1} is unbounded, or None."""
    n = R.shape[1]
    x, frame, direction = np.zeros(n), np.empty((n, n)), np.empty(n)
    if entries.center_in(R, np.ones(len(R)), x, frame, direction, FLATNESS) == 0:  # proven bounded
        return None
    return direction if direction.any() else np.asarray(np.linalg.svd(R)[2][-1])


def _ratios(R: Floats, found: _Inside) -> Floats:
    """Compute the factors by which the ellipsoid may grow before each half-space cuts it."""
    ratio = np.empty(len(R))
    for some, block in blocks(R):
        ratio[some] = (1.0 - block @ found.x) / np.linalg.norm(block @ found.root, axis=1)
    return ratio


# -- the interior point ---------------------------------------------------------------------------


def _solve(A: Floats, x: Floats, active: _WorkingSet, target: float, reporter: Reporter) -> _Inside:
    """Find the largest ellipsoid in {x : A x <= 1}, where A has the rows of `active`, starting from a point inside.

    Half-spaces are dropped from `active`. At the end, `active` has the multipliers of the result.
    """
    n = A.shape[1]
    index, y = active.index, active.y.copy()
    d, z = 1.0 - A @ x, np.empty(0)
    best, since_best = _Inside(x, np.zeros((n, n)), np.inf, 0), 0
    for step in range(MAX_STEPS):
        reporter.report()
        root = dense.root_of_inverse((A * y[:, None]).T @ A)
        if root is None:
            break
        T = A @ root.T
        h = np.sqrt(np.einsum("ij,ij->i", T, T))
        if step == 0:
            # Start with the largest multiple of the ellipsoid that is inside.
            shrink = float((d / h).min())
            y /= shrink * shrink
            h, T, root = h * shrink, T * shrink, root * shrink
            z = np.maximum(0.1 * d, d - h)
        shrink = float((d / h).min())
        gap = _balanced_gap(T, d, y * h) - n * np.log(shrink)
        since_best += 1
        if gap < best.gap or step == 0:
            best, since_best = _Inside(x, root.T * shrink, gap, step), 0
            active.index, active.y = index, y
        if gap <= target or (since_best > 8 and best.gap < 1.0):
            break
        if active.bold and gap < CLOSE * n:
            keep = d <= h * shrink * (1.0 + FAR * gap / n)
            lam = y * h
            if keep.sum() < 0.8 * len(keep) and lam[~keep].sum() < LOSS * lam.sum():
                A, T, index = A[keep], T[keep], index[keep]
                d, h, y, z = d[keep], h[keep], y[keep], z[keep]
        moved = _step(A, T, d, h, y, z)
        if moved is None:
            break
        x, y, z = x + moved[0], moved[1], moved[2]
        d = 1.0 - A @ x
    return _Inside(best.x, best.root, best.gap, step)


def _step(A: Floats, T: Floats, d: Floats, h: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Compute a step of x, and new y and z, by Mehrotra's predictor and corrector; None if singular to rounding."""
    solve = _factorised(T, 2.0 * h * z / y)
    if solve is None:
        return None
    P = (2.0 * h[:, None] * solve((h + z)[:, None] * A) - y[:, None] * A).T
    matrix = P @ A
    if not np.isfinite(matrix).all():
        return None
    r1, r2 = np.asarray(-A.T @ (y * h)), np.asarray(d - h - z)
    mean = float((y * z).mean())
    worst = max(mean, float(np.abs(r2).max()))

    def direction(r3: Any) -> tuple[Floats, Floats, Floats]:
        r23 = r2 - r3 / y
        dx = np.linalg.solve(matrix, r1 + P @ r23)
        dy = solve(2.0 * h * (A @ dx - r23))
        return dx, dy, np.asarray(r3 / y - z * dy / y)

    def room_of(dx: Floats, dy: Floats, dz: Floats) -> tuple[float, float]:
        return dense.room(y, dy), min(dense.room(z, dz), dense.room(d, -(A @ dx)))

    try:
        dx, dy, dz = direction(-y * z)
        to_y, to_z = (min(1.0, t) for t in room_of(dx, dy, dz))
        after = float(((y + to_y * dy) * (z + to_z * dz)).mean())
        mu = max(mean * (after / mean) ** 3, dense.CENTRING_FLOOR)
        dx, dy, dz = direction(mu - y * z - dy * dz)
    except np.linalg.LinAlgError:
        return None
    share = min(dense.STEP_CAP, max(0.75, 1.0 - worst))
    to_y, to_z = (min(1.0, share * t) for t in room_of(dx, dy, dz))
    return np.asarray(to_z * dx), np.asarray(y + to_y * dy), np.asarray(z + to_z * dz)


def _factorised(T: Floats, diagonal: Floats) -> Callable[[Floats], Floats] | None:
    """Make a solver of (diag(diagonal) + (T Tᵀ)∘(T Tᵀ)) X = B; None if the matrix is singular to rounding."""
    k, n = T.shape
    rank = n * (n + 1) // 2
    if k * (k / 3 + n) <= rank * (k + rank / (3 * k)) and k <= LARGEST_SYSTEM:
        matrix = T @ T.T
        matrix *= matrix
        return solver_of(matrix, diagonal)
    _validate.fits_memory(8 * rank * (2 * k + rank), f"the largest ellipsoid in {k} half-spaces of dimension {n}")
    first, second = np.tril_indices(n)
    V = T[:, first] * T[:, second] * np.where(first == second, 1.0, np.sqrt(2.0))
    scaled = V / diagonal[:, None]
    inner = solver_of(V.T @ scaled, 1.0)
    if inner is None:
        return None
    return lambda B: np.asarray(((B - V @ inner(scaled.T @ B)).T / diagonal).T)


# -- the proof ------------------------------------------------------------------------------------


def _balanced_gap(T: Floats, d: Floats, lam: Floats) -> float:
    """Compute the gap of the unit ball for rows T with slacks d, to rounding; see `proven`."""
    n = T.shape[1]
    balanced = _balanced(T, lam, T.T @ lam)
    if balanced is None:
        return np.inf
    weighted = T * (balanced / np.linalg.norm(T, axis=1))[:, None]
    half = dense.half_log_det(weighted.T @ T)
    return float(n * np.log(balanced @ d / n) - 2.0 * half) if half > -np.inf else np.inf


def _balanced(T: Floats, lam: Floats, rest: Floats) -> Floats | None:
    """Compute λ (1 - T w) with (Σ λ t tᵀ) w = Σ λ t = `rest`, so that the sum becomes 0; None if a λ turns negative."""
    try:
        w = np.linalg.solve((T * lam[:, None]).T @ T, rest)
    except np.linalg.LinAlgError:
        return None
    factors = 1.0 - T @ w
    return lam * factors if (factors >= 0.0).all() else None


def proven(
    A: Floats, b: Floats, center: Floats, factor: Floats, lam: Floats, balanced: bool = True
) -> tuple[Floats, float]:
    """Scale `factor` until the ellipsoid is certainly inside every half-space; return the factor and its certified gap.

    The factor is scaled block by block, as in `_kernels.fits.mvie.inscribe`.

    For the gap, let T be the computed product of A and the factor L; each row of T is off by at most `hidden` of its
    length. Let d be the slacks, t = λᵀd, M = Σ λ T Tᵀ / |T| with trace τ and least eigenvalue μ, and r = Lᵀ Σ λ a,
    which is not quite zero. A point x with T x <= d has |x| <= 2 t / (μ - |r|), because μ |x| <= Σ λ |T x| <= 2 t + |r|
    |x|. Any ellipsoid F inside, about c, therefore has tr(F M) <= t + |r| |c|, and its log-volume exceeds the ball's by
    at most n log((t + |r| |c|) / n) - log det M. Rounding changes M by at most τ times the sum of 2.1 `hidden` and √n
    (k + n + 10) u in the nuclear norm. Because r is multiplied by n², rounding errors of r would be too large, so the
    sum in r is computed exactly.

    If the center is given (not `balanced`), c = 0 and λ is used unchanged.
    """
    n = A.shape[1]
    if not factor.any():
        return factor, np.inf
    low, high = np.empty(len(A)), np.empty(len(A))
    for part, block in blocks(A):
        value = b[part] - block @ center
        error = (n + 2) * ROUNDING * (np.abs(b[part]) + np.abs(block) @ np.abs(center))
        low[part], high[part] = value - error, value + error
    for attempt in range(4):
        scale, hidden = _scale(A, low, factor)
        if not 0.0 < scale < np.inf:
            return factor, np.inf
        if attempt > 0 and scale >= 1.0:
            break
        if attempt == 3:
            return factor, np.inf
        # Each scaled entry is rounded once, which moves a row by up to u |a| |L|.
        factor = factor * (scale * (1.0 - 4.0 * ROUNDING - 2.0 * (attempt + 1) / (n + 2) * hidden))
    support = np.flatnonzero(lam > NOTHING * lam.max(initial=0.0))
    A, d, weights = A[support], high[support], lam[support] / lam.max(initial=1e-300)
    T, rest = A @ factor, 0.0
    if balanced:
        repaired = _balanced(T, weights, T.T @ weights)
        if repaired is not None:  # balance again, since T is rounded
            repaired = _balanced(T, repaired, factor.T @ _exact_sum(A, repaired))
        if repaired is None:
            return factor, np.inf
        weights, total = repaired, _exact_sum(A, repaired)
        rest = float(np.linalg.norm(factor.T @ total))
        rest += (n + 4) * ROUNDING * float(np.linalg.norm(np.abs(factor.T) @ np.abs(total)))
    return factor, _certified(T, d, weights, hidden, rest)


def _scale(A: Floats, low: Floats, factor: Floats) -> tuple[float, float]:
    """Compute the factor by which the ellipsoid may certainly grow, and the largest relative error of a length."""
    n = A.shape[1]
    scale, hidden = np.inf, 0.0
    size = np.abs(factor)
    for some, block in blocks(A):
        doubt = (n + 2) * ROUNDING * np.linalg.norm(np.abs(block) @ size, axis=1)
        reach = np.linalg.norm(block @ factor, axis=1) * (1.0 + (n + 3) * ROUNDING)
        slack = low[some] * (1.0 - 2.0 * ROUNDING)
        scale = min(scale, float((slack / ((reach + doubt) * (1.0 + 2.0 * ROUNDING))).min()))
        hidden = max(hidden, float((doubt / reach).max()))
    return scale, hidden


def _certified(T: Floats, d: Floats, lam: Floats, hidden: float, rest: float) -> float:
    """Compute the gap that `proven` derives."""
    k, n = T.shape
    lengths = np.linalg.norm(T, axis=1)
    weighted = T * (lam / lengths)[:, None]
    M = weighted.T @ T
    half = dense.half_log_det(M)
    if not half > -np.inf:
        return np.inf
    trace, total = float(lam @ lengths), float(lam @ d)
    turned = trace * (2.1 * hidden + 2.0 * np.sqrt(n) * (k + n + 10) * ROUNDING)
    least = 0.99 * float(np.linalg.eigvalsh(M)[0]) - 1e-11 * trace - turned
    if not max(10.0 * turned, 2.0 * rest) < least:
        return np.inf
    total += 2.02 * rest * total / (least - rest)
    gap = n * np.log(total / n) - 2.0 * half
    return float(gap + 1.1 * turned / least + n * (k + n + 8) * ROUNDING)


def _exact_sum(A: Floats, lam: Floats) -> Floats:
    """Compute Σ λ a, with each number rounded once: products of 26-bit halves are exact, and `fsum` sums exactly."""
    products = [p[:, None] * q for p in _halves(lam) for q in _halves(A)]
    return np.array([fsum(chain.from_iterable(p[:, j].tolist() for p in products)) for j in range(A.shape[1])])


def _halves(x: Floats) -> tuple[Floats, Floats]:
    """Split x into two numbers of 26 bits each whose sum is x (Veltkamp)."""
    big = x * (2.0**27 + 1.0)
    high = big - (big - x)
    return high, x - high
