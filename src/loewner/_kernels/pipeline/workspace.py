"""What the stages of a query write to, in memory that the caller keeps: no query allocates.

Only the address goes from function to function. Each takes from it what it uses: a record of arrays costs Numba a
second of compiling for every call that hands it on.
"""

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import CACHE_LINE
from loewner._kernels.narrow import exact, gjk_batch, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.pair_list import pair_list_at
from loewner._kernels.simd.memory import bytes_at, floats_at, integers_at

# Entries of `carried_of`: how many pairs are held for the search, and in which half of the list; how many wait for the
# s at the maximum of the contact function, and how many for the batch GJK.
N_HELD, HALF, N_UNSURE, N_WALKING, CARRIED = 0, 1, 2, 3, 4

_LIST, _NORMALS = pair_list.size(BLOCK), 8 * 3 * BLOCK
_HELD = 3 * _LIST
_TIER = _HELD + 2 * _LIST
_AT_NORMALS = _TIER + BLOCK
_CARRIED = _AT_NORMALS + 3 * _NORMALS
_WALK = _CARRIED + CACHE_LINE
_EXACT = _WALK + gjk_batch.SIZE

SIZE = _EXACT + exact.SIZE  # bytes


@njit()
def workspace_size():
    """Tell Python how many bytes a query's memory has to have."""
    return SIZE


@inline
def listed_of(work):
    """PairList: the piece pairs of a block."""
    return pair_list_at(work, BLOCK)


@inline
def ahead_of(work):
    """PairList: what a later block will need; its pairs are not used."""
    return pair_list_at(work + _LIST, BLOCK)


@inline
def unsure_of(work):
    """PairList: piece pairs that wait for a certificate at the best s."""
    return pair_list_at(work + 2 * _LIST, BLOCK)


@inline
def held_of(work):
    """PairList: piece pairs that wait for the exact search, in two halves: one is searched while the other fills."""
    return pair_list_at(work + _HELD, 2 * BLOCK)


@inline
def tier_of(work):
    """What the certificate says of each listed pair: int8, shape (BLOCK,)."""
    return bytes_at(work + _TIER, (BLOCK,))


@inline
def normals_of(work):
    """Contact normals that the certificate writes, all x, all y, all z: shape (3 * BLOCK,)."""
    return floats_at(work + _AT_NORMALS, (3 * BLOCK,))


@inline
def held_normals_of(work):
    """Those of the pairs held: shape (2 * 3 * BLOCK,)."""
    return floats_at(work + _AT_NORMALS + _NORMALS, (2 * 3 * BLOCK,))


@inline
def carried_of(work):
    """What is carried from block to block: int64, shape (CARRIED,)."""
    return integers_at(work + _CARRIED, (CARRIED,))


@inline
def walk_of(work):
    """Address of a workspace of `gjk_batch`."""
    return work + _WALK


@inline
def exact_of(work):
    """Address of a workspace of `exact`."""
    return work + _EXACT
