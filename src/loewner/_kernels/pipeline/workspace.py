"""What the stages of a query write to, in memory that the caller keeps: no query allocates."""

from typing import Any, NamedTuple

from loewner._kernels._jit import inline
from loewner._kernels.narrow import exact, gjk_batch, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.pair_list import pair_list_at
from loewner._kernels.simd.memory import LINE, bytes_at, floats_at, integers_at

# Entries of `Workspace.carried`: how many pairs are held for the search, in which half of the list; wait for the best
# s; wait for the batch GJK.
HELD, TURN, UNSURE, WALKING, CARRIED = 0, 1, 2, 3, 4


class Workspace(NamedTuple):
    """What `verdicts` writes to.

    Attributes
    ----------
    listed : PairList
        The piece pairs of a block.
    ahead : PairList
        What a later block will need; its pairs are not used.
    unsure : PairList
        Piece pairs that wait for a certificate at the best s.
    held : PairList
        Piece pairs that wait for the exact search: two halves, one searched while the other fills.
    tier : ndarray of int8, shape (BLOCK,)
        What the certificate says of each.
    normals : ndarray, shape (3 * BLOCK,)
        Contact normals that the certificate writes: all x, all y, all z.
    held_normals : ndarray, shape (2 * 3 * BLOCK,)
        Those of the pairs held.
    carried : ndarray of int64, shape (CARRIED,)
        What is carried from block to block.
    walk : gjk_batch.Workspace
    exact : exact.Workspace
    """

    listed: Any
    ahead: Any
    unsure: Any
    held: Any
    tier: Any
    normals: Any
    held_normals: Any
    carried: Any
    walk: Any
    exact: Any


_LIST, _NORMALS = pair_list.size(BLOCK), 8 * 3 * BLOCK
_HELD = 3 * _LIST
_TIER = _HELD + 2 * _LIST
_AT_NORMALS = _TIER + BLOCK
_CARRIED = _AT_NORMALS + 3 * _NORMALS
_WALK = _CARRIED + LINE
_EXACT = _WALK + gjk_batch.SIZE

SIZE = _EXACT + exact.SIZE  # bytes of a workspace


@inline
def workspace_at(address):
    """The workspace at an address."""
    return Workspace(
        pair_list_at(address, BLOCK),
        pair_list_at(address + _LIST, BLOCK),
        pair_list_at(address + 2 * _LIST, BLOCK),
        pair_list_at(address + _HELD, 2 * BLOCK),
        bytes_at(address + _TIER, (BLOCK,)),
        floats_at(address + _AT_NORMALS, (3 * BLOCK,)),
        floats_at(address + _AT_NORMALS + _NORMALS, (2 * 3 * BLOCK,)),
        integers_at(address + _CARRIED, (CARRIED,)),
        gjk_batch.workspace_at(address + _WALK),
        exact.workspace_at(address + _EXACT),
    )
