"""Scratch memory for the stages of a query; the caller owns it, so that no query allocates.

Functions pass only the address, and each takes the fields that it uses. A record of arrays would cost Numba a second of
compilation in every call that passes it.
"""

from loewner._kernels._jit import njit
from loewner._kernels.narrow import exact, gjk_batch, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.simd.memory import Arena, floats, integers, raw, small_integers

# Indices of the entries of `carried_of`: the number of pairs held for the search, the half of the list that contains
# these pairs, the number of pairs that wait for the maximum of the contact function, and the number of pairs that wait
# for the batch GJK.
N_HELD, HALF, N_UNSURE, N_WALKING, CARRIED = 0, 1, 2, 3, 4

MEMORY = Arena(
    listed=pair_list.arena(BLOCK),  # The piece pairs of the current block.
    ahead=pair_list.arena(BLOCK),  # Pairs of a later block, whose data are prefetched.
    unsure=pair_list.arena(BLOCK),  # Pairs waiting to be certified at the maximum of the contact function.
    # Pairs waiting for the exact search: one half is searched while the other half is filled.
    held=pair_list.arena(2 * BLOCK),
    tier=small_integers(BLOCK),  # The result of the certificate for each listed pair.
    normals=floats(3 * BLOCK),  # Contact normals that the certificate writes: first all x, then all y, then all z.
    held_normals=floats(2 * 3 * BLOCK),  # Contact normals of the held pairs.
    carried=integers(CARRIED),  # Numbers that one block passes to the next.
    walk=raw(gjk_batch.WORKSPACE.size()),
    exact=raw(exact.SIZE),
)
SIZE = MEMORY.size()  # Size of the memory in bytes.
listed_of, ahead_of, unsure_of, held_of, tier_of, normals_of, held_normals_of, carried_of, walk_of, exact_of = (
    MEMORY.accessors("listed ahead unsure held tier normals held_normals carried walk exact")
)


@njit()
def workspace_size():
    """Number of bytes of memory that a query needs."""
    return SIZE
