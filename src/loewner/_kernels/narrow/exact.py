"""The exact answer for one piece pair by the fast searches; what they leave open is for `careful`."""

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import AMBIGUOUS, BY_PLANE, BY_SEARCH, COLLIDING, FREE, OPEN
from loewner._kernels.ellipsoids.contact import POSITION_ROUNDINGS
from loewner._kernels.narrow.gjk_fast import INSIDE, near, put_pair, quick
from loewner._kernels.narrow.gjk_robust import APART, TOUCHING, UNSETTLED, swollen_radii
from loewner._kernels.pieces.shapes import radius


@inline
def exact_piece_pair(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, margin, size, nx, ny, nz, W, result):
    """Settle one piece pair that the ellipsoids left ambiguous.

    Parameters
    ----------
    size : float
        Lengths that the positions are made of: both reaches and the difference of the translations (1-norm).
    nx, ny, nz : float
        Direction from a to b to start from: the contact normal of the outer ellipsoids.
    W, result : ndarray
        `pair_search.scratch`, and room for nine numbers.

    Returns
    -------
    verdict, tier : int
        AMBIGUOUS with tier OPEN if the searches could not settle it.
    """
    dx = Tb[kb, 0, 3] - Ta[ka, 0, 3]
    dy = Tb[kb, 1, 3] - Ta[ka, 1, 3]
    dz = Tb[kb, 2, 3] - Ta[ka, 2, 3]
    if not nx * nx + ny * ny + nz * nz > 0.0:
        nx, ny, nz = 1.0, 0.0, 0.0
    error = POSITION_ROUNDINGS * size
    radii = radius(ta, la, i) + radius(tb, lb, j)
    status, points = UNSETTLED, 1
    ends_a, ends_b = put_pair(la, xa, i, Ta, ka, lb, xb, j, Tb, kb, dx, dy, dz, W)
    if margin == 0.0 and radii == 0.0:
        status, nx, ny, nz, points = quick(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error
        )
    if status == UNSETTLED:
        return _by_distance(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error, margin,
            radii, result,
        )  # fmt: skip
    return FREE if status == APART else COLLIDING, BY_PLANE if points == 0 else BY_SEARCH


@njit()
def _by_distance(
    ta,
    la,
    xa,
    i,
    Ta,
    ka,
    tb,
    lb,
    xb,
    j,
    Tb,
    kb,
    dx,
    dy,
    dz,
    W,
    ends_a,
    ends_b,
    nx,
    ny,
    nz,
    error,
    margin,
    radii,
    result,
):
    """Settle a pair with radii or a margin, or one that `quick` left; apart from the rest, which is to be short."""
    swollen = swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb)
    status, _, _ = near(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error,
        margin + radii, margin + swollen, result,
    )  # fmt: skip
    if status == APART:
        return FREE, BY_SEARCH
    if status in (TOUCHING, INSIDE):
        return COLLIDING, BY_SEARCH
    return AMBIGUOUS, OPEN
