"""Both fits of convex pieces given by vertices and face normals, for one piece or a range of pieces."""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import FLAT, STALLED
from loewner._kernels.fits.dense import multiply_lower
from loewner._kernels.fits.many import MANY, frame_map, highest, lowest, lowest_above, reaches, solve_with_few
from loewner._kernels.fits.mvce import ROUNDING, fit_outer
from loewner._kernels.fits.mvie import inscribe, solve_primal_dual
from loewner._kernels.tolerances import FACE_ROUNDING, FACE_WIDTH


@inline
def face_slacks(vertices, normal, center):
    """Bounds on the slack of one face at `center`, from the face's own vertices.

    Returns (low, high): `low` is a lower bound on the smallest n·(v - c) of the face's own vertices, and `high` is an
    upper bound on the largest n·(v - c) of all vertices. docs/containment.md explains why `low` proves containment.
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
    doubt = (n + 2) * noise  # The n + 2 roundings are one for v - c, n for the products and sums, and one to spare.
    return low - doubt, top + doubt


@njit()
def slacks_by_map(vertices, normals, center, frame, columns, nodes, low, high):
    """Do the work of `face_slacks` for a piece with many vertices, from the map's candidates for each face.

    The largest offsets along the axes bound the noise for all vertices.
    """
    n = vertices.shape[1]
    reach = np.empty(n)
    reaches(vertices, center, reach)
    for i in range(len(normals)):
        normal = normals[i]
        top = highest(vertices, frame, columns, nodes, normal, center)
        bottom = lowest(vertices, frame, columns, nodes, normal, center)
        noise = 0.0
        for k in range(n):
            noise += abs(normal[k]) * reach[k]
        noise *= ROUNDING
        edge = top - (FACE_WIDTH * (top - bottom) + FACE_ROUNDING * noise)
        doubt = (n + 2) * noise
        low[i] = lowest_above(vertices, frame, columns, nodes, normal, center, edge) - doubt
        high[i] = top + doubt


@njit()
def fit_inner(vertices, normals, tol, outer_center, outer_factor, center, factor):
    """Largest ellipsoid inside the piece, computed in the coordinates of its outer ellipsoid.

    In these coordinates, the piece lies between the balls of radius 1/n and 1 (John), so it is never thin. Returns
    (code, gap, iterations).
    """
    m, n = normals.shape
    A = np.empty((m, n))
    lam = np.empty(m)
    low = np.empty((n, n))
    x = np.empty(n)
    slack_low = np.empty(m)
    slack_high = np.empty(m)
    many = n == 3 and len(vertices) > MANY
    if many:
        columns, nodes = frame_map(vertices, outer_center, outer_factor)
        slacks_by_map(vertices, normals, outer_center, outer_factor, columns, nodes, slack_low, slack_high)
    else:
        columns, nodes = np.empty(0, np.int64), np.empty(0)
    for i in range(m):
        if not many:
            _, slack_high[i] = face_slacks(vertices, normals[i], outer_center)
        if not slack_high[i] > 0.0:
            return STALLED, np.inf, 0
        for j in range(n):
            value = 0.0
            for k in range(j, n):
                value += outer_factor[k, j] * normals[i, k]
            A[i, j] = value / slack_high[i]
    if many:
        gap, iterations = solve_with_few(A, tol, x, low, lam)
    else:
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
        lam[i] /= slack_high[i]  # Convert the multiplier of the scaled row to the multiplier of the unit normal.
        if not many:
            slack_low[i], slack_high[i] = face_slacks(vertices, normals[i], center)
    if many:
        slacks_by_map(vertices, normals, center, outer_factor, columns, nodes, slack_low, slack_high)
    gap = inscribe(normals, slack_low, slack_high, factor, lam)
    return (0 if gap <= tol else STALLED), gap, iterations


@njit()
def fit_range(
    first, last, vert_start, vertices, face_start, normals, tol, flatness, inner_c, inner_F, outer_c, outer_F, info
):
    """Write both fits of the pieces first..last-1 to their rows of the output arrays.

    Threads call this function on separate ranges, because it does not hold the interpreter lock. Such functions compile
    in a quarter of the time that `prange` takes, and run as fast.

    `info` (P, 5) receives the outer code and gap, the inner code and gap, and the iterations of both.
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
