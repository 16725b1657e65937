"""Largest ellipsoid inside {x : A x <= b} from any interior point: find the center first, then apply `mvie`."""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.codes import STALLED, UNBOUNDED
from loewner._kernels.fits.dense import householder_triangle, invert_lower, multiply_lower
from loewner._kernels.fits.mvce import ROUNDING
from loewner._kernels.fits.mvie import inscribe, solve_primal_dual

MAX_CENTERING = 500


@njit()
def whiten(A, slack, work, frame):
    """Lower triangular `frame` with Σ (frameᵀ a/s)(frameᵀ a/s)ᵀ = 1 over the rows; False if the rows lack rank.

    The method is QR, because the Gram matrix would square the aspect ratio. The columns are taken in reverse order,
    which makes the frame lower triangular.
    """
    m, n = A.shape
    for i in range(m):
        for j in range(n):
            work[i, j] = A[i, n - 1 - j] / slack[i]
    if not householder_triangle(work, m, n):
        return False
    low = np.zeros((n, n))
    for j in range(n):
        for k in range(j + 1):
            low[j, k] = work[n - 1 - j, n - 1 - k]
        if not abs(low[j, j]) > 0.0:
            return False
    invert_lower(low, frame, n)
    return True


@njit()
def center_in(A, b, x, frame, shift, negligible):
    """Move `x` close to the analytic center of {A x <= b} by Newton's method, with whitening in every step.

    A Newton decrement below 1 proves that the log barrier has a minimum, so the polytope is bounded (Nesterov and
    Nemirovskii 1994). A step along which no slack shrinks proves that the polytope is unbounded; its direction is
    written to `shift`, which is zero if the rows lack rank.

    Returns a code; `frame` is the whitening of the last point.
    """
    m, n = A.shape
    slack = np.empty(m)
    work = np.empty((m, n))
    rates = np.empty(m)
    z = np.empty(n)
    for _ in range(MAX_CENTERING):
        for i in range(m):
            value = b[i]
            for j in range(n):
                value -= A[i, j] * x[j]
            if not value > 0.0:
                return STALLED
            slack[i] = value
        if not whiten(A, slack, work, frame):
            shift[:] = 0.0
            return UNBOUNDED
        # In this frame, the Hessian is the identity, so the Newton step is minus the sum of the rows.
        for j in range(n):
            z[j] = 0.0
        for i in range(m):
            for j in range(n):
                for k in range(j, n):
                    z[j] -= frame[k, j] * A[i, k] / slack[i]
        decrement = 0.0
        for j in range(n):
            decrement += z[j] * z[j]
            shift[j] = 0.0
            for k in range(j + 1):
                shift[j] += frame[j, k] * z[k]
        decrement = np.sqrt(decrement)
        fastest = 0.0
        slowest = 0.0
        for i in range(m):
            value = 0.0
            for j in range(n):
                value += A[i, j] * shift[j]
            rates[i] = value / slack[i]
            fastest = max(fastest, rates[i])
            slowest = min(slowest, rates[i])
        if decrement < 0.5:
            return 0
        if fastest <= negligible * -slowest:
            return UNBOUNDED
        # Choose the factor t of the step that maximises Σ log(1 - t rate), by Newton's method in one variable. All
        # logarithms must remain finite, so t stays below 1 / fastest.
        t = min(1.0, 0.9 / max(fastest, 1e-300))
        for _ in range(30):
            slope = 0.0
            curve = 0.0
            for i in range(m):
                value = rates[i] / (1.0 - t * rates[i])
                slope -= value
                curve += value * value
            change = slope / curve
            if t + change >= 1.0 / max(fastest, 1e-300):
                change = 0.9 * (1.0 / max(fastest, 1e-300) - t)
            if t + change <= 0.0:
                change = -0.5 * t
            t += change
            if abs(change) <= 0.01 * t:
                break
        for j in range(n):
            x[j] += t * shift[j]
    return STALLED


@njit()
def fit_halfspaces(A, b, x, tol, negligible, center, factor, shift):
    """Largest ellipsoid in {z : A z <= b} with unit rows, from the interior point `x`, which is overwritten.

    Returns (code, gap, iterations).
    """
    m, n = A.shape
    frame = np.empty((n, n))
    code = center_in(A, b, x, frame, shift, negligible)
    if code != 0:
        return code, np.inf, 0
    rows = np.empty((m, n))
    slack = np.empty(m)
    slack_low = np.empty(m)
    lam = np.empty(m)
    local = np.empty(n)
    low = np.empty((n, n))
    gap = np.inf
    iterations = 0
    for _ in range(3):
        for i in range(m):
            slack[i] = b[i]
            for j in range(n):
                slack[i] -= A[i, j] * x[j]
            for j in range(n):
                value = 0.0
                for k in range(j, n):
                    value += frame[k, j] * A[i, k]
                rows[i, j] = value / slack[i]
        gap, steps = solve_primal_dual(rows, m, n, 0.25 * tol, local, low, lam)
        iterations += steps
        if not gap < np.inf:
            return STALLED, gap, iterations
        multiply_lower(frame, low, factor, n)
        for j in range(n):
            value = 0.0
            for k in range(j + 1):
                value += frame[j, k] * local[k]
            center[j] = x[j] + value
        for i in range(m):
            value = b[i]
            error = abs(b[i])
            for j in range(n):
                value -= A[i, j] * center[j]
                error += abs(A[i, j] * center[j])
            error *= (n + 2) * ROUNDING
            lam[i] /= slack[i]  # Convert the multiplier of the scaled row to the multiplier of the unit row.
            slack_low[i] = value - error
            slack[i] = value + error
        gap = inscribe(A, slack_low, slack, factor, lam)
        if gap <= tol:
            return 0, gap, iterations
        # A poor starting point can cost digits, so solve the problem again in the coordinates of the result.
        for j in range(n):
            x[j] = center[j]
            for k in range(n):
                frame[j, k] = factor[j, k] if k <= j else 0.0
    return STALLED, gap, iterations
