"""Proofs by ellipsoids of surfaces: outer ellipsoids around parts below the root, and inner ellipsoids in a solid."""

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import BY_INNER, BY_OUTER, BY_SPHERE, NO_LIMIT, OPEN
from loewner._kernels.columns import PART_INNER, PART_OUTER, PART_STOP, PARTS
from loewner._kernels.narrow import certificate
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.gjk_robust import lengths
from loewner._kernels.narrow.pair_list import arena, fill, put
from loewner._kernels.narrow.surface_points import OUTSIDE, within_either
from loewner._kernels.narrow.surface_walk import SIZE as WALK
from loewner._kernels.narrow.surface_walk import left_of
from loewner._kernels.pieces.pack import placed, shift_between
from loewner._kernels.simd.memory import held

CHUNK = 16  # Number of pairs that are tested at a time; small, because one of the first pairs usually decides.

_LISTED = arena(CHUNK)
_SIZE, _listed_at = _LISTED.size() // 8, _LISTED.whole()


@inline
def has_parts(pieces):
    """Return whether any of the packed pieces is a surface."""
    return len(pieces.part_start) > 0


@apart
def parts_tier(a, i, Ta, ka, b, j, Tb, kb, margin):
    """Return the tier of a piece pair that ellipsoids of whole pieces left open: BY_OUTER, BY_INNER, or still OPEN.

    Parameters
    ----------
    a, b : Pieces
    i, ka, j, kb : int
        Numbers of the pieces, and rows of their poses.
    margin : float
    """
    outer_a, inner_a, of_surface_a = _rows(a, i)
    outer_b, inner_b, of_surface_b = _rows(b, j)
    if not (of_surface_a or of_surface_b):
        return OPEN
    rows_a, rows_b = a.parts if of_surface_a else a.hot, b.parts if of_surface_b else b.hot
    memory, tier, normals = np.empty(_SIZE), np.empty(CHUNK, np.int8), np.empty(3 * BLOCK)
    listed = _listed_at(memory.ctypes.data)
    pair_tier = OPEN
    for turn in range(2):
        # First, test the pairs of inner ellipsoids: one overlapping pair is enough. Then, test the pairs of outer
        # ellipsoids: all pairs must be apart.
        first_a, end_a = inner_a if turn == 0 else outer_a
        first_b, end_b = inner_b if turn == 0 else outer_b
        wide, total = end_b - first_b, (end_a - first_a) * (end_b - first_b)
        apart_all = turn == 1
        for begin in range(0, total, CHUNK):
            count = min(CHUNK, total - begin)
            for n in range(count):
                put(listed, n, 0, first_a + (begin + n) // wide, first_b + (begin + n) % wide, ka, kb)
            fill(listed, count)
            if not certificate.certify_best(count, margin, rows_a, Ta, True, rows_b, Tb, True, listed, tier, normals):
                apart_all = False
                break
            for n in range(count):
                apart_all = apart_all and (tier[n] == BY_OUTER or tier[n] == BY_SPHERE)
                if turn == 0 and tier[n] == BY_INNER:
                    pair_tier = BY_INNER
            if pair_tier == BY_INNER or (turn == 1 and not apart_all):
                break
        if pair_tier == BY_INNER:
            break
        # Ellipsoids around triangles need not contain the volume that the triangles enclose, so neither piece may lie
        # within the other.
        if apart_all and _none_within(placed(a, i, Ta, ka), placed(b, j, Tb, kb)):
            pair_tier = BY_OUTER
    held(memory)
    return pair_tier


@njit()
def _none_within(A, B):
    """Return whether two pieces whose surfaces do not meet are proven not to lie within each other."""
    memory, shift = np.empty(WALK // 8), shift_between(A, B)
    left_of(memory.ctypes.data)[0] = NO_LIMIT
    location = within_either(A, B, shift, lengths(A, B, shift), memory.ctypes.data)
    held(memory)
    return location == OUTSIDE


@inline
def _rows(pieces, i):
    """First row and end of the outer and of the inner ellipsoids, and whether these belong to parts of a surface."""
    if has_parts(pieces):
        at = PARTS * i
        outer, inner, stop = (
            pieces.part_start[at + PART_OUTER], pieces.part_start[at + PART_INNER], pieces.part_start[at + PART_STOP],
        )  # fmt: skip
        if stop > 0:
            return (outer, inner), (inner, stop), True
    return (i, i + 1), (i, i + 1), False
