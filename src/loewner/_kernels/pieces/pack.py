"""Packed pieces by one number: a call from Python costs 150 ns for every array it hands over, 20 ns for a number.

A handle is the address of a small table: for each array of a packed set (see `shapes`) its address and its shape.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from loewner._kernels._jit import borrowed, inline

ENTRIES = 3  # address, rows, columns (1 for a flat array)


def table_of(arrays: Any) -> Any:
    """What a handle points to; arrays and table must outlive the handle."""
    rows = [(array.ctypes.data, array.shape[0], array.shape[1] if array.ndim == 2 else 1) for array in arrays]
    return np.array(rows, dtype=np.int64)


class Pieces(NamedTuple):
    """Packed pieces of a set of bodies; the arrays are described in `shapes`."""

    table: Any
    layout: Any
    points: Any
    piece_start: Any
    hot: Any
    single: Any
    groups: Any
    children: Any
    roots: Any
    vertices: Any


class Placed(NamedTuple):
    """Row `piece` of packed pieces at pose `row` of an array of poses, shape (N, 4, 4)."""

    table: Any
    layout: Any
    points: Any
    piece: Any
    poses: Any
    row: Any


@intrinsic
def _integers(typingctx, address):
    def generate(context, builder, sig, args):
        return builder.inttoptr(args[0], ir.IntType(64).as_pointer())

    return signature(types.CPointer(types.int64), types.int64), generate


@intrinsic
def _floats(typingctx, address):
    def generate(context, builder, sig, args):
        return builder.inttoptr(args[0], ir.DoubleType().as_pointer())

    return signature(types.CPointer(types.float64), types.int64), generate


@intrinsic
def _singles(typingctx, address):
    def generate(context, builder, sig, args):
        return builder.inttoptr(args[0], ir.FloatType().as_pointer())

    return signature(types.CPointer(types.float32), types.int64), generate


@inline
def pieces_of(handle):
    """The arrays of a packed set from its handle."""
    t = carray(_integers(handle), (10, ENTRIES))
    return Pieces(
        table=carray(_floats(t[0, 0]), (t[0, 1], t[0, 2])),
        layout=carray(_integers(t[1, 0]), (t[1, 1], t[1, 2])),
        points=carray(_floats(t[2, 0]), (t[2, 1],)),
        piece_start=carray(_integers(t[3, 0]), (t[3, 1],)),
        hot=carray(_floats(t[4, 0]), (t[4, 1], t[4, 2])),
        single=carray(_singles(t[5, 0]), (t[5, 1], t[5, 2])),
        groups=carray(_floats(t[6, 0]), (t[6, 1],)),
        children=carray(_integers(t[7, 0]), (t[7, 1],)),
        roots=carray(_integers(t[8, 0]), (t[8, 1],)),
        vertices=carray(_singles(t[9, 0]), (t[9, 1],)),
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
def checking_of(handle):
    """What `states` checks, from the handle of its arrays.

    Returns
    -------
    tree : tuple of six ndarray
        See `kinematics`.
    link : ndarray of int64, shape (moving bodies,)
    ball : ndarray, shape (moving bodies, 5)
        Center and radius of a ball about each, in its frame, and the reach: how far the ball goes from the origin.
    pairs : ndarray of int64, shape (pairs, 2)
        Bodies, the first of which moves.
    margins : ndarray, shape (pairs,)
    order : ndarray of int64, shape (pairs,)
        In which pairs are taken.
    standing : ndarray of float32, shape (standing bodies, BOUNDS)
    standing_rows : ndarray of float32, shape (their pieces, HOT)
        Ellipsoids in world coordinates.
    standing_poses : ndarray, shape (standing bodies, 16)
    """
    t = carray(_integers(handle), (14, ENTRIES))
    tree = (
        carray(_integers(t[0, 0]), (t[0, 1],)),
        carray(_integers(t[1, 0]), (t[1, 1],)),
        carray(_integers(t[2, 0]), (t[2, 1],)),
        carray(_floats(t[3, 0]), (t[3, 1],)),
        carray(_floats(t[4, 0]), (t[4, 1],)),
        carray(_floats(t[5, 0]), (t[5, 1], t[5, 2])),
    )
    return (
        tree,
        carray(_integers(t[6, 0]), (t[6, 1],)),
        carray(_floats(t[7, 0]), (t[7, 1], t[7, 2])),
        carray(_integers(t[8, 0]), (t[8, 1], t[8, 2])),
        carray(_floats(t[9, 0]), (t[9, 1],)),
        carray(_integers(t[10, 0]), (t[10, 1],)),
        carray(_singles(t[11, 0]), (t[11, 1], t[11, 2])),
        carray(_singles(t[12, 0]), (t[12, 1], t[12, 2])),
        carray(_floats(t[13, 0]), (t[13, 1], t[13, 2])),
    )
