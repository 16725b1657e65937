"""Scratch memory of the stages of a query, which the caller owns, so that no query allocates.

Only the address is passed from function to function, and each takes the fields that it uses: a record of arrays costs
Numba a second of compilation for every call that passes it.
"""

from loewner._kernels._jit import njit
from loewner._kernels.narrow import exact, gjk_batch, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.simd.memory import Arena, floats, integers, raw, small_integers

# Entries of `carried_of`: the number of pairs held for the search, and their half of the list; the number of pairs
# waiting for the s at the maximum of the contact function, and of pairs waiting for the batch GJK.
N_HELD, HALF, N_UNSURE, N_WALKING, CARRIED = 0, 1, 2, 3, 4

MEMORY = Arena(
    listed=pair_list.arena(BLOCK),  # the piece pairs of a block
    ahead=pair_list.arena(BLOCK),  # pairs that a later block will need, to be prefetched
    unsure=pair_list.arena(BLOCK),  # pairs that wait for a certificate at the best s
    held=pair_list.arena(2 * BLOCK),  # pairs waiting for the exact search: one half is searched, the other is filled
    tier=small_integers(BLOCK),  # the certificate's result for each listed pair
    normals=floats(3 * BLOCK),  # contact normals that the certificate writes: all x, all y, all z
    held_normals=floats(2 * 3 * BLOCK),  # normals of the held pairs
    carried=integers(CARRIED),  # numbers that one block hands to the next
    walk=raw(gjk_batch.WORKSPACE.size()),
    exact=raw(exact.SIZE),
)
SIZE = MEMORY.size()  # bytes
listed_of, ahead_of, unsure_of, held_of, tier_of, normals_of, held_normals_of, carried_of, walk_of, exact_of = (
    MEMORY.accessors("listed ahead unsure held tier normals held_normals carried walk exact")
)


@njit()
def workspace_size():
    """Number of bytes of a query's memory."""
    return SIZE
