"""Searches through points, and placement of points, eight at a time.

Points come in *blocks* of eight: eight x, eight y, eight z in a row of a flat array. The x of column i is at ``3 * (i -
i % 8) + i % 8``, and its y and z are 8 and 16 entries further. Ranges of columns start and end at multiples of eight.
"""

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.columns import BLOCK, CACHE_LINE
from loewner._kernels.linalg3 import apply, dot, plus
from loewner._kernels.simd.vectors import (
    broadcast,
    entry_at_highest,
    highest,
    load,
    maximum,
    numbers_from,
    select,
    store,
)

LINE = CACHE_LINE // 8  # Number of float64 values in a cache line.


@inline
def entry_of(column):
    """Entry of the x of a column in its flat array; y and z follow at distances of `BLOCK`."""
    return 3 * (column & ~(BLOCK - 1)) + (column & (BLOCK - 1))


@inline
def _block(points, column):
    """Load the eight points that start at a column."""
    at = 3 * column
    return load(points, at), load(points, at + BLOCK), load(points, at + 2 * BLOCK)


@inline
def farthest(points, start, stop, n):
    """Column of the point with the largest dot product with n.

    Columns start .. stop are searched, at least one block. Ties are always decided in the same way. If all products are
    NaN or -inf, the answer is still one of the columns.
    """
    best, at = broadcast(-np.inf), numbers_from(start)
    column = start
    while True:
        products = dot(_block(points, column), n)
        more = products > best
        best, at = select(more, products, best), select(more, numbers_from(column), at)
        column += BLOCK
        if column >= stop:
            return entry_at_highest(best, at)


@inline
def extent(points, start, stop, n):
    """Largest dot product of columns start .. stop with n, in single precision.

    The range has at least one block. Up to three blocks are read without a branch, because their number is hard to
    predict; if the range has fewer blocks, its last block is read again.
    """
    last = stop - BLOCK
    best = dot(_block(points, start), n)
    best = maximum(best, dot(_block(points, min(start + BLOCK, last)), n))
    best = maximum(best, dot(_block(points, min(start + 2 * BLOCK, last)), n))
    for column in range(start + 3 * BLOCK, stop, BLOCK):
        best = maximum(best, dot(_block(points, column), n))
    return highest(best)


@inline
def place_vertices(points, start, stop, R, t, placed, to):
    """Write R p + t for a range of columns, at least one block, to `placed`, starting at column `to`."""
    column, at = start, 3 * to
    while True:
        x, y, z = plus(apply(R, _block(points, column)), t)
        store(placed, at, x)
        store(placed, at + BLOCK, y)
        store(placed, at + 2 * BLOCK, z)
        column, at = column + BLOCK, at + 3 * BLOCK
        if column >= stop:
            return
