"""Both fits of convex pieces given by vertices and face normals: one, or a range of them."""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import FLAT, STALLED
from loewner._kernels.fits.dense import multiply_lower
from loewner._kernels.fits.hulls import FACE_ROUNDING, FACE_WIDTH
from loewner._kernels.fits.mvce import ROUNDING, fit_outer
from loewner._kernels.fits.mvie import inscribe, solve_primal_dual


@inline
def face_slacks(vertices, normal, center):
    """Bounds on the slack of one face at `center`, from the face's own vertices.

    Returns (low, high): low bounds from below the smallest n·(v - c) over the vertices that belong to the face,
    high from above the largest over all vertices. See docs/containment.md for why `low` proves containment.
    """
    m, n = vertices.shape
    top = -np.inf
    bottom = np.inf
    noise = 0.0
    for i in range(m):
        value = 0.0
        size = 0.0
        for k in range(n):
            t = normal[k] * (vertices[i, k] - center[k])
            value += t
            size += abs(t)
        top = max(top, value)
        bottom = min(bottom, value)
        noise = max(noise, size)
    noise *= ROUNDING
    edge = top - (FACE_WIDTH * (top - bottom) + FACE_ROUNDING * noise)
    low = top
    for i in range(m):
        value = 0.0
        for k in range(n):
            value += normal[k] * (vertices[i, k] - center[k])
        if value >= edge:
            low = min(low, value)
    doubt = (n + 2) * noise  # one rounding for v - c, n for the products and sums, one to spare
    return low - doubt, top + doubt


@njit()
def fit_inner(vertices, normals, tol, outer_center, outer_factor, center, factor):
    """Largest ellipsoid inside the piece, solved in the coordinates of its outer ellipsoid.

    There the piece lies between the balls of radius 1/n and 1 (John), so nothing is ever thin.
    Returns (code, gap, iterations).
    """
    m, n = normals.shape
    A = np.empty((m, n))
    lam = np.empty(m)
    low = np.empty((n, n))
    x = np.empty(n)
    slack_low = np.empty(m)
    slack_high = np.empty(m)
    for i in range(m):
        _, high = face_slacks(vertices, normals[i], outer_center)
        if not high > 0.0:
            return STALLED, np.inf, 0
        slack_high[i] = high
        for j in range(n):
            value = 0.0
            for k in range(j, n):
                value += outer_factor[k, j] * normals[i, k]
            A[i, j] = value / high
    gap, iterations = solve_primal_dual(A, m, n, 0.25 * tol, x, low, lam)
    if not gap < np.inf:
        return STALLED, gap, iterations
    multiply_lower(outer_factor, low, factor, n)
    for j in range(n):
        value = 0.0
        for k in range(j + 1):
            value += outer_factor[j, k] * x[k]
        center[j] = outer_center[j] + value
    for i in range(m):
        lam[i] /= slack_high[i]  # the multiplier of the scaled row, brought back to the unit normal
        slack_low[i], slack_high[i] = face_slacks(vertices, normals[i], center)
    gap = inscribe(normals, slack_low, slack_high, factor, lam)
    return (0 if gap <= tol else STALLED), gap, iterations


@njit()
def fit_range(
    first, last, vert_start, vertices, face_start, normals, tol, flatness, inner_c, inner_F, outer_c, outer_F, info
):
    """Both fits of pieces first..last-1, into their rows of the output arrays.

    Threads call it on ranges of their own (it holds no interpreter lock); that compiles in a quarter of the time that
    `prange` took here and runs as fast.

    `info` (P, 5): outer code, outer gap, inner code, inner gap, iterations of both.
    """
    for piece in range(first, last):
        V = vertices[vert_start[piece] : vert_start[piece + 1]]
        A = normals[face_start[piece] : face_start[piece + 1]]
        code, gap, steps, _, _, _ = fit_outer(V, tol, flatness, outer_c[piece], outer_F[piece])
        info[piece, 0] = code
        info[piece, 1] = gap
        info[piece, 2] = FLAT if code == FLAT else STALLED
        info[piece, 3] = np.inf
        info[piece, 4] = steps
        if code == 0 or gap < 1.0:
            code, gap, steps = fit_inner(V, A, tol, outer_c[piece], outer_F[piece], inner_c[piece], inner_F[piece])
            info[piece, 2] = code
            info[piece, 3] = gap
            info[piece, 4] += steps
