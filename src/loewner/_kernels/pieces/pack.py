"""Packed pieces, and what to check, by one number: see `records`."""

from loewner._kernels._jit import borrowed, inline
from loewner._kernels.records import ENTRIES, MotionTables, Pieces, Placed, Problem, Tree
from loewner._kernels.simd.memory import floats_at, integers_at, singles_at


@inline
def pieces_of(handle):
    """The arrays of a packed set from its handle."""
    t = integers_at(handle, (12, ENTRIES))
    return Pieces(
        table=floats_at(t[0, 0], (t[0, 1], t[0, 2])),
        layout=integers_at(t[1, 0], (t[1, 1], t[1, 2])),
        points=floats_at(t[2, 0], (t[2, 1],)),
        piece_start=integers_at(t[3, 0], (t[3, 1],)),
        hot=floats_at(t[4, 0], (t[4, 1], t[4, 2])),
        single=singles_at(t[5, 0], (t[5, 1], t[5, 2])),
        groups=floats_at(t[6, 0], (t[6, 1],)),
        children=integers_at(t[7, 0], (t[7, 1],)),
        roots=integers_at(t[8, 0], (t[8, 1],)),
        vertices=singles_at(t[9, 0], (t[9, 1],)),
        parts=floats_at(t[10, 0], (t[10, 1], t[10, 2])),
        part_start=integers_at(t[11, 0], (t[11, 1],)),
    )


@inline
def placed(pieces, piece, poses, row):
    """One piece at one pose; the caller keeps the arrays alive."""
    return Placed(borrowed(pieces.table), borrowed(pieces.layout), borrowed(pieces.points), piece, borrowed(poses), row)


@inline
def shift_between(A, B):
    """World vector from the translation of one placed piece to that of the other."""
    return (
        B.poses[B.row, 0, 3] - A.poses[A.row, 0, 3],
        B.poses[B.row, 1, 3] - A.poses[A.row, 1, 3],
        B.poses[B.row, 2, 3] - A.poses[A.row, 2, 3],
    )


@inline
def problem_of(handle):
    """What `configurations` checks, from the handle of its arrays."""
    t = integers_at(handle, (14, ENTRIES))
    tree = Tree(
        integers_at(t[0, 0], (t[0, 1],)),
        integers_at(t[1, 0], (t[1, 1],)),
        integers_at(t[2, 0], (t[2, 1],)),
        floats_at(t[3, 0], (t[3, 1],)),
        floats_at(t[4, 0], (t[4, 1],)),
        floats_at(t[5, 0], (t[5, 1], t[5, 2])),
    )
    return Problem(
        tree,
        integers_at(t[6, 0], (t[6, 1],)),
        floats_at(t[7, 0], (t[7, 1], t[7, 2])),
        integers_at(t[8, 0], (t[8, 1], t[8, 2])),
        floats_at(t[9, 0], (t[9, 1],)),
        integers_at(t[10, 0], (t[10, 1],)),
        singles_at(t[11, 0], (t[11, 1], t[11, 2])),
        singles_at(t[12, 0], (t[12, 1], t[12, 2])),
        floats_at(t[13, 0], (t[13, 1], t[13, 2])),
    )


@inline
def motion_tables_of(handle):
    """What `motions` needs besides, from the handle of its arrays."""
    t = integers_at(handle, (7, ENTRIES))
    return MotionTables(
        integers_at(t[0, 0], (t[0, 1],)),
        integers_at(t[1, 0], (t[1, 1],)),
        floats_at(t[2, 0], (t[2, 1], t[2, 2])),
        floats_at(t[3, 0], (t[3, 1], t[3, 2])),
        floats_at(t[4, 0], (t[4, 1],)),
        integers_at(t[5, 0], (t[5, 1],)),
        floats_at(t[6, 0], (t[6, 1],)),
    )
