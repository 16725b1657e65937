"""The exact answer for one piece pair: a quick search first, then the careful GJK, then the expanding polytope."""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.contact import POSITION_ROUNDINGS
from loewner._kernels.epa import CONTACT_ACCURACY, FLAT, penetration, workspace
from loewner._kernels.gjk import APART, TOUCH_ROUNDINGS, TOUCHING, UNSETTLED, run, swollen_radii
from loewner._kernels.pair_search import INSIDE, near, put_pair, quick
from loewner._kernels.shapes import radius
from loewner._kernels.verdicts import AMBIGUOUS, BY_SEARCH, COLLIDING, FREE, OPEN


@inline
def exact_piece_pair(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, margin, size, nx, ny, nz, W):
    """Settle one piece pair that the ellipsoids left ambiguous.

    Parameters
    ----------
    size : float
        Lengths that the positions are made of: both reaches and the difference of the translations (1-norm).
    nx, ny, nz : float
        Direction from a to b to start from: the contact normal of the outer ellipsoids.
    W : ndarray
        `pair_search.scratch`.

    Returns
    -------
    verdict, tier : int
        AMBIGUOUS with tier OPEN if the search could not settle it.
    """
    dx = Tb[kb, 0, 3] - Ta[ka, 0, 3]
    dy = Tb[kb, 1, 3] - Ta[ka, 1, 3]
    dz = Tb[kb, 2, 3] - Ta[ka, 2, 3]
    if not nx * nx + ny * ny + nz * nz > 0.0:
        nx, ny, nz = 1.0, 0.0, 0.0
    status = UNSETTLED
    error = POSITION_ROUNDINGS * size
    if margin == 0.0 and radius(ta, la, i) == 0.0 and radius(tb, lb, j) == 0.0:
        ends_a, ends_b = put_pair(la, xa, i, Ta, ka, lb, xb, j, Tb, kb, dx, dy, dz, W)
        status, nx, ny, nz = quick(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error
        )
    if status == UNSETTLED:
        return _settled_with_care(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, margin, error, nx, ny, nz, W
        )
    return FREE if status == APART else COLLIDING, BY_SEARCH


@njit()
def _settled_with_care(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, margin, error, nx, ny, nz, W):
    """Settle a pair with radii or a margin, or one that the quick search left; verdict and tier."""
    radii = radius(ta, la, i) + radius(tb, lb, j)
    swollen = swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb)
    if margin > 0.0 or radii > 0.0:
        ends_a, ends_b = put_pair(la, xa, i, Ta, ka, lb, xb, j, Tb, kb, dx, dy, dz, W)
        status, _, _ = near(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error,
            margin + radii, margin + swollen, np.empty(9),
        )  # fmt: skip
        if status == APART:
            return FREE, BY_SEARCH
        if status in (TOUCHING, INSIDE):
            return COLLIDING, BY_SEARCH
    status, _, _, _ = run(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, nx, ny, nz, margin, True,
        np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3),
    )  # fmt: skip
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
    if -deep - swollen - error > margin:
        return FREE, BY_SEARCH
    if shallow + swollen >= -margin - TOUCH_ROUNDINGS * error:
        return COLLIDING, BY_SEARCH
    return AMBIGUOUS, OPEN
