"""Lists of piece pairs that the stages of a query pass to each other."""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.simd.memory import Arena, integers
from loewner._kernels.simd.vectors import SINGLE_LANES


class PairList(NamedTuple):
    """Five arrays of int64, with one entry per piece pair.

    Attributes
    ----------
    pair
        The pair of bodies, or of a body and a configuration, to which the piece pair belongs.
    piece_a, piece_b
        Rows of the packed pieces.
    pose_a, pose_b
        Rows of the poses.
    """

    pair: Any
    piece_a: Any
    piece_b: Any
    pose_a: Any
    pose_b: Any


def arena(capacity: int) -> Arena:
    """Memory of a list; the capacity must be a multiple of sixteen if `fill` is used."""
    return Arena(PairList, **{name: integers(capacity) for name in PairList._fields})


# The index is unsigned. A signed index could be negative and count from the end of the array; the check for this would
# prevent loops from being vectorised.
@inline
def put(listed, at, pair, piece_a, piece_b, pose_a, pose_b):
    """Write entry `at`."""
    at = np.uint64(at)
    listed.pair[at] = pair
    listed.piece_a[at] = piece_a
    listed.piece_b[at] = piece_b
    listed.pose_a[at] = pose_a
    listed.pose_b[at] = pose_b


@inline
def copy(target, to, source, at):
    """Copy entry `at` of one list to entry `to` of another list, or of the same list."""
    at = np.uint64(at)
    put(target, to, source.pair[at], source.piece_a[at], source.piece_b[at], source.pose_a[at], source.pose_b[at])


@inline
def fill(listed, count):
    """Fill whole vectors by repeating the last of `count` entries."""
    for lane in range(count, (count + SINGLE_LANES - 1) // SINGLE_LANES * SINGLE_LANES):
        copy(listed, lane, listed, count - 1)
