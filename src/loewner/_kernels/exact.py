"""The exact answer for one piece pair: cheap certificates first, then GJK, then the expanding polytope."""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.epa import CONTACT_ACCURACY, penetration, workspace
from loewner._kernels.gjk import APART, TOUCH_ROUNDINGS, TOUCHING, rounding_error, run, swollen_radii
from loewner._kernels.shapes import INNER_CENTER, core_height, inside_by
from loewner._kernels.verdicts import AMBIGUOUS, BY_POINT, BY_SEARCH, BY_SUPPORT, COLLIDING, FREE, OPEN

# A hull's face plane may miss its own vertices by 1e-11 of the piece (`hulls.FACE_WIDTH`), so a point
# must lie four times deeper than that to be surely inside; 6000 rounding errors are 4.3e-11.
FACE_ROUNDINGS = 6000.0


@njit()
def support_gap(a, i, Ta, b, j, Tb, dx, dy, dz, nx, ny, nz):
    """Certified lower bound on the distance of two pieces along a direction from a to b."""
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not (0.0 < length < np.inf):
        return -np.inf
    nx /= length
    ny /= length
    nz /= length
    ahead = core_height(a[0], a[1], a[2], i, Ta, nx, ny, nz)
    behind = core_height(b[0], b[1], b[2], j, Tb, -nx, -ny, -nz)
    gap = (nx * dx + ny * dy + nz * dz) - ahead - behind - swollen_radii(a[0], i, Ta, b[0], j, Tb)
    return gap - rounding_error(a[0], i, b[0], j, dx, dy, dz)


@njit()
def holds_point(a, i, T, x, y, z, error):
    """Tell whether a point, relative to the body's translation, is surely inside a placed piece."""
    # Rᵀ maps the point back; it inverts R only as far as R is orthonormal, hence a check of the
    # way forth: the point tested is R y, within `error` of the point meant.
    u = T[0, 0] * x + T[1, 0] * y + T[2, 0] * z
    v = T[0, 1] * x + T[1, 1] * y + T[2, 1] * z
    w = T[0, 2] * x + T[1, 2] * y + T[2, 2] * z
    rx = T[0, 0] * u + T[0, 1] * v + T[0, 2] * w - x
    ry = T[1, 0] * u + T[1, 1] * v + T[1, 2] * w - y
    rz = T[2, 0] * u + T[2, 1] * v + T[2, 2] * w - z
    away = np.sqrt(rx * rx + ry * ry + rz * rz)
    return inside_by(a[0], a[1], a[3], i, u, v, w) > error + 2.0 * away


@njit()
def exact_piece_pair(a, i, Ta, b, j, Tb, margin, ox, oy, oz, ix, iy, iz, px, py, pz, S, weights, v, d):
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
    dx = Tb[0, 3] - Ta[0, 3]
    dy = Tb[1, 3] - Ta[1, 3]
    dz = Tb[2, 3] - Ta[2, 3]
    outer_gap = support_gap(a, i, Ta, b, j, Tb, dx, dy, dz, ox, oy, oz)
    if outer_gap > margin:
        return FREE, BY_SUPPORT
    inner_gap = support_gap(a, i, Ta, b, j, Tb, dx, dy, dz, ix, iy, iz)
    if inner_gap > margin:
        return FREE, BY_SUPPORT
    error = rounding_error(a[0], i, b[0], j, dx, dy, dz)
    c = INNER_CENTER
    table = a[0]
    x = px + Ta[0, 0] * table[i, c] + Ta[0, 1] * table[i, c + 1] + Ta[0, 2] * table[i, c + 2]
    y = py + Ta[1, 0] * table[i, c] + Ta[1, 1] * table[i, c + 1] + Ta[1, 2] * table[i, c + 2]
    z = pz + Ta[2, 0] * table[i, c] + Ta[2, 1] * table[i, c + 1] + Ta[2, 2] * table[i, c + 2]
    depth = error * FACE_ROUNDINGS
    if holds_point(a, i, Ta, x, y, z, depth) and holds_point(b, j, Tb, x - dx, y - dy, z - dz, depth):
        return COLLIDING, BY_POINT
    if inner_gap > outer_gap:
        ox, oy, oz = ix, iy, iz
    if not ox * ox + oy * oy + oz * oz > 0.0:
        ox, oy, oz = 1.0, 0.0, 0.0
    status, _, _, _ = run(
        a[0], a[1], a[2], i, Ta, b[0], b[1], b[2], j, Tb, dx, dy, dz, ox, oy, oz, margin, True, S, weights, v, d
    )
    if status == APART:
        return FREE, BY_SEARCH
    if status == TOUCHING:
        return COLLIDING, BY_SEARCH
    # Curved pieces that barely overlap can make GJK creep. The expanding polytope sees the same
    # contact from inside; its work space is made only here, where hardly any pair ever comes.
    work = workspace(True)
    shallow, deep = penetration(
        a[0], a[1], a[2], i, Ta, b[0], b[1], b[2], j, Tb, dx, dy, dz, CONTACT_ACCURACY,
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], np.empty(9),
    )  # fmt: skip
    radii = swollen_radii(a[0], i, Ta, b[0], j, Tb)
    if -deep - radii - error > margin:
        return FREE, BY_SEARCH
    if shallow + radii >= -margin - TOUCH_ROUNDINGS * error:
        return COLLIDING, BY_SEARCH
    return AMBIGUOUS, OPEN
