"""The exact answer for one piece pair: cheap certificates first, then GJK, then the expanding polytope."""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.epa import CONTACT_ACCURACY, FLAT, penetration, workspace
from loewner._kernels.gjk import APART, TOUCH_ROUNDINGS, TOUCHING, quick, rounding_error, run, swollen_radii
from loewner._kernels.shapes import INNER_CENTER, ROUNDING, core_height, inside_by
from loewner._kernels.verdicts import AMBIGUOUS, BY_POINT, BY_SEARCH, BY_SUPPORT, COLLIDING, FREE, OPEN

# A hull's face plane may miss its own vertices by 1e-11 of the piece (`hulls.FACE_WIDTH`), so a point
# must lie four times deeper than that to be surely inside; 6000 rounding errors are 4.3e-11.
FACE_ROUNDINGS = 6000.0


@inline
def support_gap(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, nx, ny, nz):
    """Certified lower bound on the distance of two pieces along a direction from a to b."""
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not (0.0 < length < np.inf):
        return -np.inf
    nx /= length
    ny /= length
    nz /= length
    ahead = core_height(ta, la, xa, i, Ta, ka, nx, ny, nz)
    behind = core_height(tb, lb, xb, j, Tb, kb, -nx, -ny, -nz)
    gap = (nx * dx + ny * dy + nz * dz) - ahead - behind - swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb)
    return gap - rounding_error(ta, i, tb, j, dx, dy, dz)


@inline
def holds_point(ta, la, fa, i, T, t, x, y, z, error):
    """Tell whether a point, relative to the body's translation, is surely inside a placed piece."""
    # Rᵀ maps the point back; it inverts R only as far as R is orthonormal, hence a check of the
    # way forth: the point tested is R y, within `error` of the point meant.
    u = T[t, 0, 0] * x + T[t, 1, 0] * y + T[t, 2, 0] * z
    v = T[t, 0, 1] * x + T[t, 1, 1] * y + T[t, 2, 1] * z
    w = T[t, 0, 2] * x + T[t, 1, 2] * y + T[t, 2, 2] * z
    rx = T[t, 0, 0] * u + T[t, 0, 1] * v + T[t, 0, 2] * w - x
    ry = T[t, 1, 0] * u + T[t, 1, 1] * v + T[t, 1, 2] * w - y
    rz = T[t, 2, 0] * u + T[t, 2, 1] * v + T[t, 2, 2] * w - z
    away = np.sqrt(rx * rx + ry * ry + rz * rz)
    return inside_by(ta, la, fa, i, u, v, w) > error + 2.0 * away


@njit()
def exact_piece_pair(
    ta, la, xa, fa, i, Ta, ka, tb, lb, xb, fb, j, Tb, kb, margin, ox, oy, oz, ix, iy, iz, px, py, pz, S, weights, v, d
):
    """Settle one piece pair that the ellipsoids left ambiguous.

    Parameters
    ----------
    ox, oy, oz, ix, iy, iz : float
        Contact normals of the outer and of the inner ellipsoids.
    px, py, pz : float
        Point of both inner ellipsoids' neighbourhood, relative to a's inner center (world axes).

    Returns
    -------
    verdict, tier : int
        AMBIGUOUS with tier OPEN if the search could not settle it.
    """
    dx = Tb[kb, 0, 3] - Ta[ka, 0, 3]
    dy = Tb[kb, 1, 3] - Ta[ka, 1, 3]
    dz = Tb[kb, 2, 3] - Ta[ka, 2, 3]
    outer_gap = support_gap(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, ox, oy, oz)
    if outer_gap > margin:
        return FREE, BY_SUPPORT
    inner_gap = support_gap(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, ix, iy, iz)
    if inner_gap > margin:
        return FREE, BY_SUPPORT
    error = rounding_error(ta, i, tb, j, dx, dy, dz)
    c = INNER_CENTER
    x = px + Ta[ka, 0, 0] * ta[i, c] + Ta[ka, 0, 1] * ta[i, c + 1] + Ta[ka, 0, 2] * ta[i, c + 2]
    y = py + Ta[ka, 1, 0] * ta[i, c] + Ta[ka, 1, 1] * ta[i, c + 1] + Ta[ka, 1, 2] * ta[i, c + 2]
    z = pz + Ta[ka, 2, 0] * ta[i, c] + Ta[ka, 2, 1] * ta[i, c + 1] + Ta[ka, 2, 2] * ta[i, c + 2]
    depth = error * FACE_ROUNDINGS
    if holds_point(ta, la, fa, i, Ta, ka, x, y, z, depth) and holds_point(
        tb, lb, fb, j, Tb, kb, x - dx, y - dy, z - dz, depth
    ):
        return COLLIDING, BY_POINT
    if inner_gap > outer_gap:
        ox, oy, oz = ix, iy, iz
    if not ox * ox + oy * oy + oz * oz > 0.0:
        ox, oy, oz = 1.0, 0.0, 0.0
    if margin == 0.0 and ta[i, ROUNDING] == 0.0 and tb[j, ROUNDING] == 0.0:
        status, ox, oy, oz = quick(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, ox, oy, oz, error)
        if status == APART:
            return FREE, BY_SEARCH
        if status == TOUCHING:
            return COLLIDING, BY_SEARCH
    status, _, _, _ = run(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, ox, oy, oz, margin, True, S, weights, v, d
    )
    if status == APART:
        return FREE, BY_SEARCH
    if status == TOUCHING:
        return COLLIDING, BY_SEARCH
    # Curved pieces that barely overlap can make GJK creep. The expanding polytope sees the same
    # contact from inside; its work space is made only here, where hardly any pair ever comes.
    work = workspace(True)
    shallow, deep = penetration(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, CONTACT_ACCURACY,
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], np.empty(9),
    )  # fmt: skip
    if deep == FLAT:  # a sentinel, not a depth: it must not pass for a separation
        return AMBIGUOUS, OPEN
    radii = swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb)
    if -deep - radii - error > margin:
        return FREE, BY_SEARCH
    if shallow + radii >= -margin - TOUCH_ROUNDINGS * error:
        return COLLIDING, BY_SEARCH
    return AMBIGUOUS, OPEN
