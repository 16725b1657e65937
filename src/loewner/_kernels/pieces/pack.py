"""Packed pieces behind one number, see `records`."""

from loewner._kernels._jit import borrowed, inline
from loewner._kernels.records import MOTION_WORDS, KeptAxis, MotionTables, Pieces, Placed, PlaneModel, Problem, Tree
from loewner._kernels.simd.memory import reader, record_kind

pieces_of = reader(record_kind(Pieces, "F2 I2 F1 I1 F2 S2 F1 I1 I1 S1 F2 I1"))
_tree = record_kind(Tree, "I1 I1 I1 F1 F1 F2")
tree_of = reader(_tree)
problem_of = reader(record_kind(Problem, _tree, "I1 F2 I2 F1 I1 S2 S2 F2"))
kept_axis_of = reader(record_kind(KeptAxis, "I2 F2 F2 I1 F2"))
plane_model_of = reader(record_kind(PlaneModel, "F1 F2 I2 F2 I2 F2 F2 I2 F1 I2 F2"))
motion_tables_of = reader(record_kind(MotionTables, MOTION_WORDS))


@inline
def placed(pieces, piece, poses, row):
    """One piece at one pose; the caller must keep the arrays alive."""
    return Placed(borrowed(pieces.table), borrowed(pieces.layout), borrowed(pieces.points), piece, borrowed(poses), row)


@inline
def shift_between(A, B):
    """World vector from the translation of A to the translation of B."""
    return (
        B.poses[B.row, 0, 3] - A.poses[A.row, 0, 3],
        B.poses[B.row, 1, 3] - A.poses[A.row, 1, 3],
        B.poses[B.row, 2, 3] - A.poses[A.row, 2, 3],
    )
