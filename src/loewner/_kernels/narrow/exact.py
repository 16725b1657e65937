"""The exact answer for one piece pair by the fast searches; `pipeline.fallback` settles the pairs left open."""

from loewner._kernels._jit import apart, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    APART,
    BY_PLANE,
    BY_SEARCH,
    COLLIDING,
    FREE,
    OPEN,
    OVERLAPPING,
    TOUCHING,
    UNSETTLED,
)
from loewner._kernels.linalg3 import dot
from loewner._kernels.narrow.gjk_fast import MEMORY, begin, decide, measure, result_of, vertices_of
from loewner._kernels.narrow.gjk_robust import rounding_error, swollen_radii
from loewner._kernels.narrow.surface_boxes import is_surface
from loewner._kernels.narrow.surface_meets import surface_pair
from loewner._kernels.narrow.surface_walk import SIZE as SURFACE_SIZE
from loewner._kernels.narrow.surface_walk import left_of
from loewner._kernels.pieces.pack import pieces_of, placed, shift_between
from loewner._kernels.pieces.shapes import radius

SIZE = max(MEMORY.size(), SURFACE_SIZE)  # Size [bytes] of the memory to which `exact_piece_pair` writes.


@apart
def exact_piece_pair(pack_a, i, poses_a, ka, pack_b, j, poses_b, kb, margin, n, steps, memory):
    """Settle one piece pair that the ellipsoids left ambiguous.

    The function takes handles, because placed pieces would add many arguments to a call that is not inlined.

    Parameters
    ----------
    pack_a, pack_b : int
        Handles of the pieces.
    i, j : int
        Numbers of the pieces A and B in the packs.
    poses_a, poses_b : ndarray, shape (n, 4, 4)
    ka, kb : int
        Rows of the poses of A and B.
    margin : float
        Distance that the pieces must keep; at least 0.
    n : tuple of 3 float
        First direction from A to B: the contact normal of the outer ellipsoids.
    steps : int
        Limit on the steps, see `surface_pair`.
    memory : int
        Address of SIZE bytes of scratch memory.

    Returns
    -------
    verdict, tier : int
        The verdict is AMBIGUOUS, and the tier OPEN, if the searches could not settle the pair.
    taken : int
        Number of steps that walks through surfaces took.
    """
    A, B = placed(pieces_of(pack_a), i, poses_a, ka), placed(pieces_of(pack_b), j, poses_b, kb)
    if is_surface(A) or is_surface(B):
        near, far = margin + (radius(A) + radius(B)), margin + swollen_radii(A, B)
        verdict, _ = surface_pair(A, B, near, far, memory, memory, 0, steps)
        return verdict, OPEN if verdict == AMBIGUOUS else BY_SEARCH, steps - left_of(memory)[0]
    if not dot(n, n) > 0.0:
        n = (1.0, 0.0, 0.0)
    shift = shift_between(A, B)
    error = rounding_error(A, B, shift)
    radii = radius(A) + radius(B)
    status, points = UNSETTLED, 1
    W = vertices_of(memory)
    ends = begin(A, B, shift, W)
    if margin == 0.0 and radii == 0.0:
        status, n, points = decide(A, B, shift, W, ends, n, error)
    if status == UNSETTLED:
        verdict, tier = _by_distance(A, B, shift, W, ends, n, error, margin, radii, memory)
        return verdict, tier, 0
    return FREE if status == APART else COLLIDING, BY_PLANE if points == 0 else BY_SEARCH, 0


@njit()
def _by_distance(A, B, shift, W, ends, n, error, margin, radii, memory):
    """Settle a pair with radii or a margin, or a pair that `decide` left open; separate to keep code short."""
    result = result_of(memory)
    status, _, _ = measure(A, B, shift, W, ends, n, error, margin + radii, margin + swollen_radii(A, B), result)
    if status == APART:
        return FREE, BY_SEARCH
    if status in (TOUCHING, OVERLAPPING):
        return COLLIDING, BY_SEARCH
    return AMBIGUOUS, OPEN
