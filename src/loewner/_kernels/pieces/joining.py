"""Join bodies of several packs, for Python and for C: their arrays are copied, not computed again."""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import CACHE_LINE, COLUMNS, HOT, LAYOUT, PARTS, POINTS_FROM, POINTS_TO, WIDE
from loewner._kernels.pieces.pack import pieces_of
from loewner._kernels.records import ENTRIES, Pieces
from loewner._kernels.simd.memory import held, integers_at

ROWS = 6 * WIDE  # Number of entries of `groups` for each group; see `trees.boxes`.
LINE = CACHE_LINE // 8  # Number of words in a cache line.
TABLE = -(-ENTRIES * len(Pieces._fields) // LINE) * LINE


@njit()
def join_bodies(chosen, block):
    """Make one pack from bodies, in order.

    Parameters
    ----------
    chosen : ndarray of int64, shape (n, 2)
        The handle of a pack, and the number of a body in that pack.
    block : ndarray
        Receives the table of the pack, followed by the arrays. Each array starts at a cache line, and the block itself
        must begin at one. Without a block, only its size is computed.

    Returns
    -------
    int
        Number of words of the block.
    """
    pieces = numbers = groups = parts = 0
    single, has_parts = True, False
    for k in range(len(chosen)):
        pack = pieces_of(chosen[k, 0])
        first, last, number, end, _, count = _ends(pack, chosen[k, 1])
        pieces, numbers, groups = pieces + last - first, numbers + end - number, groups + count
        single &= first == last or len(pack.single) > 0
        has_parts |= len(pack.part_start) > 0
        for piece in range(first if len(pack.part_start) > 0 else last, last):
            parts += pack.part_start[PARTS * piece + 2] - pack.part_start[PARTS * piece]
    start, words = np.int64(block.ctypes.data), TABLE
    table = np.empty(TABLE, np.int64)
    row = 0
    for rows, columns, size in (
        (pieces, COLUMNS, 8), (pieces, LAYOUT, 8), (numbers, 1, 8), (len(chosen) + 1, 1, 8), (pieces, HOT, 8),
        (pieces * single, HOT, 4), (ROWS * groups, 1, 8), (WIDE * groups, 1, 8), (len(chosen), 1, 8),
        (numbers * single, 1, 4), (parts, HOT, 8), (PARTS * pieces * has_parts, 1, 8),
    ):  # fmt: skip
        table[row], table[row + 1], table[row + 2] = start + 8 * words, rows, columns
        words += (rows * columns * size + CACHE_LINE - 1) // CACHE_LINE * LINE
        row += ENTRIES
    if len(block) > 0:
        for k in range(row):
            integers_at(start, (TABLE,))[k] = table[k]
        _fill(pieces_of(start), chosen)
    held(block)
    return words


@inline
def _ends(pack, body):
    """Beginning and end of a body's pieces, then of its numbers in `points`, and the end of its groups."""
    first, last = pack.piece_start[body], pack.piece_start[body + 1]
    number = 3 * pack.layout[first, POINTS_FROM] if first < len(pack.layout) else len(pack.points)
    end = 3 * pack.layout[last, POINTS_FROM] if last < len(pack.layout) else len(pack.points)
    level, groups = last - first, 0
    while pack.roots[body] >= 0 and level > 1:
        level = (level + WIDE - 1) // WIDE
        groups += level
    return first, last, number, end, pack.roots[body] + 1 - groups, groups


@inline
def _copy(source, first, last, to, at):
    for k in range(last - first):
        to[at + k] = source[first + k]


@inline
def _copy_rows(source, first, last, to, at):
    for k in range(last - first):
        for column in range(source.shape[1]):
            to[at + k, column] = source[first + k, column]


@njit()
def _fill(made, chosen):
    """Copy the arrays of the bodies, with all indices moved."""
    piece = number = group = part = 0
    made.piece_start[0] = 0
    for k in range(len(chosen)):
        pack = pieces_of(chosen[k, 0])
        first, last, from_number, end, from_group, groups = _ends(pack, chosen[k, 1])
        _copy_rows(pack.table, first, last, made.table, piece)
        _copy_rows(pack.hot, first, last, made.hot, piece)
        _copy_rows(pack.layout, first, last, made.layout, piece)
        _copy(pack.points, from_number, end, made.points, number)
        if len(made.single) > 0:
            _copy_rows(pack.single, first, last, made.single, piece)
            _copy(pack.vertices, from_number, end, made.vertices, number)
        _copy(pack.groups, ROWS * from_group, ROWS * (from_group + groups), made.groups, ROWS * group)
        for n in range(last - first):
            made.layout[piece + n, POINTS_FROM] += (number - from_number) // 3
            made.layout[piece + n, POINTS_TO] += (number - from_number) // 3
            if len(made.part_start) > 0:
                part = _copy_parts(pack, first + n, made, piece + n, part)
        for n in range(WIDE * groups):
            # A negative child encodes a piece, and any other child is the number of a group. An unused place holds -1
            # or encodes a piece. Because -1 also encodes piece 0, it is shifted if the body begins with piece 0.
            child = pack.children[WIDE * from_group + n]
            if child >= 0:
                child += group - from_group
            elif child != -1 or first == 0:
                child -= piece - first
            made.children[WIDE * group + n] = child
        piece, number, group = piece + last - first, number + end - from_number, group + groups
        made.roots[k] = group - 1 if groups > 0 else -1
        made.piece_start[k + 1] = piece


@inline
def _copy_parts(pack, source, made, piece, part):
    """Copy the rows of a piece's parts; a piece without parts keeps zeros: a nonzero end marks a surface."""
    at, to = PARTS * source, PARTS * piece
    first, last = (pack.part_start[at], pack.part_start[at + 2]) if len(pack.part_start) > 0 else (0, 0)
    for n in range(PARTS):
        made.part_start[to + n] = part + pack.part_start[at + n] - first if last > first else 0
    _copy_rows(pack.parts, first, last, made.parts, part)
    return part + last - first
