"""One pair of bodies for each thread: the certificate in single precision, for margin 0.

Pairs that single precision cannot decide become AMBIGUOUS, which claims nothing, and their numbers go to a list for the
CPU.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import AMBIGUOUS, BY_INNER, BY_OUTER, BY_SPHERE, COLLIDING, FREE, LEFT, OPEN
from loewner._kernels.columns import HOT
from loewner._kernels.narrow.certificate import Pose, tier_of_one
from loewner._kernels.pieces.rigid import is_rigid_single
from loewner._kernels.simd.scalars import (
    add_to,
    eight_at,
    holds,
    integer_at,
    lane_of,
    number_at,
    put_byte,
    put_integer,
    put_number,
)

ROW = 4 * HOT  # Number of bytes in the row of a piece.

# Maximum number of piece pairs that a thread checks. Bodies with more pieces have trees, which the CPU searches.
MOST_PIECE_PAIRS = 1024


@inline
def _with(verdict, of_piece_pair):
    """Combine the verdicts of piece pairs: the first of COLLIDING, LEFT, AMBIGUOUS and FREE that any pair has."""
    if verdict == COLLIDING or of_piece_pair == COLLIDING:
        return COLLIDING
    return max(verdict, of_piece_pair)


@inline
def _verdict_of(tier, of_open):
    """Verdict of a piece pair by its tier; `of_open` is the verdict of an OPEN pair."""
    if tier in (BY_SPHERE, BY_OUTER):
        return FREE
    if tier == BY_INNER:
        return COLLIDING
    return np.int64(of_open) if tier == OPEN else LEFT


@inline
def _pose_at(poses, row):
    """Read a pose from an array of poses, shape (n, 4, 4)."""
    p, q = eight_at(poses, 16 * row), eight_at(poses, 16 * row + 8)
    R, t = (p[0], p[1], p[2], p[4], p[5], p[6], q[0], q[1], q[2]), (p[3], p[7], q[3])
    return Pose(R, t, holds(is_rigid_single(p, q)))


@inline
def _row_of(k, plan, axes, operand):
    """Row that an operand contributes to pair k, as in `pipeline.verdicts.row_of`, for a plan of int32."""
    row = 0
    axis = axes - 1
    while axis > 0:
        length = integer_at(plan, axis)
        # Use 32-bit divisions: the numbers of pairs fit into 31 bits, and a 64-bit division takes a GPU four times as
        # long.
        above = np.int64(np.uint32(k) // np.uint32(length))
        row += (k - above * length) * integer_at(plan, operand * axes + axis)
        k = above
        axis -= 1
    return row + k * integer_at(plan, operand * axes)


@inline
def _rows_of_pair(k, plan, axes, rows, total):
    """Rows of a and its pose, and of b and its pose, for pair k."""
    if rows == 0:
        return (
            _row_of(k, plan, axes, 1),
            _row_of(k, plan, axes, 2),
            _row_of(k, plan, axes, 3),
            _row_of(k, plan, axes, 4),
        )
    a, b = integer_at(rows, k), integer_at(rows, total + k)
    return a * integer_at(plan, 1), a * integer_at(plan, 2), b * integer_at(plan, 3), b * integer_at(plan, 4)


@inline
def append(listed, number):
    """Append a number to a list whose first entry is the count of the other entries."""
    put_integer(listed, 1 + add_to(listed, 0, 1), number)


@inline
def _tell(k, verdict, verdicts, left):
    """Write the verdict of pair k, and list it if it is LEFT."""
    put_byte(verdicts, k, verdict if verdict != LEFT else AMBIGUOUS)
    if verdict == LEFT:
        append(left, k)


@njit()
def classify_pieces(thread, plan, axes, rows, total, packed_a, Ta, packed_b, Tb, of_open, verdicts, left):
    """Certify one pair of bodies with one piece each, for margin 0.

    Parameters
    ----------
    thread : int
        Number of the pair.
    plan : int32, shape (5, axes)
        Batch shape, and the strides of a, Ta, b and Tb along its axes, in rows, see `pipeline.verdicts.settle_range`.
    rows : int32, shape (2, total), or the address 0
        Rows of a and b for each pair, in place of the pair's number; `total` is the number of pairs.
    packed_a, packed_b : float32, shape (pieces, HOT)
    Ta, Tb : float32, shape (n, 4, 4)
    of_open : int
        AMBIGUOUS, or LEFT if the CPU can decide more than the ellipsoids can.
    verdicts : int8
        Receives the verdict.
    left : int32
        Receives the number of pairs that the CPU has to settle, followed by the pairs' numbers in any order.
    """
    i, pose_a, j, pose_b = _rows_of_pair(thread, plan, axes, rows, total)
    a, b = _pose_at(Ta, pose_a), _pose_at(Tb, pose_b)
    verdict = LEFT
    if a.rigid and b.rigid:
        verdict = _verdict_of(tier_of_one(a, packed_a + ROW * i, b, packed_b + ROW * j, lane_of(0.0)), of_open)
    _tell(thread, verdict, verdicts, left)


@njit()
def classify_bodies(
    thread, plan, axes, rows, total, packed_a, start_a, Ta, packed_b, start_b, Tb, of_open, verdicts, left
):  # fmt: skip
    """Certify one pair of bodies with any number of pieces, for margin 0.

    The parameters are documented in `classify_pieces`, except for the starts of the bodies' pieces, int32: body i has
    the pieces start[i] .. start[i + 1].
    """
    body_a, pose_a, body_b, pose_b = _rows_of_pair(thread, plan, axes, rows, total)
    a, b = _pose_at(Ta, pose_a), _pose_at(Tb, pose_b)
    i, last_a = integer_at(start_a, body_a), integer_at(start_a, body_a + 1)
    first_b, last_b = integer_at(start_b, body_b), integer_at(start_b, body_b + 1)
    verdict = FREE
    if not (a.rigid and b.rigid) or (last_a - i) * (last_b - first_b) > MOST_PIECE_PAIRS:
        verdict, i = LEFT, last_a
    while i < last_a:
        j = first_b
        while j < last_b and verdict != COLLIDING:
            tier = tier_of_one(a, packed_a + ROW * i, b, packed_b + ROW * j, lane_of(0.0))
            verdict = _with(verdict, _verdict_of(tier, of_open))
            j += 1
        i += 1
    _tell(thread, verdict, verdicts, left)


@njit()
def gather_rows(thread, width, rows, table, gathered):
    """Copy one entry of listed rows of a table of float32.

    Parameters
    ----------
    thread : int
        Index of the entry among all copied entries.
    width : int
        Number of entries per row.
    rows : int32
        Numbers of rows; row `rows[n]` of the table becomes row n of `gathered`.
    """
    row = np.int64(np.uint32(thread) // np.uint32(width))
    put_number(gathered, thread, number_at(table, integer_at(rows, row) * width + thread - row * width))


@njit()
def scatter_bytes(thread, rows, values, bytes_of_all):
    """Write one of the int32 values to the byte at the place in `rows`."""
    put_byte(bytes_of_all, integer_at(rows, thread), integer_at(values, thread))
