"""Bodies: unions of convex pieces, each with its inner and outer ellipsoid.

A `Body` is one; `Bodies` is a packed sequence of them for batches. Both are read-only. A body is
moved by handing a pose to a query; the fits are never computed again.

`body` holds these two, `pack` and `layout` the arrays behind them, `files` the ``.npz``.
"""

from loewner.bodies.body import Bodies, Body, Piece
from loewner.bodies.kinds import CURVED
from loewner.bodies.layout import ARRAYS, LARGEST, SMALLEST, KernelArrays, PieceArrays, arrays_of
from loewner.bodies.pack import Packed, take

__all__ = [
    "ARRAYS",
    "CURVED",
    "LARGEST",
    "SMALLEST",
    "Bodies",
    "Body",
    "KernelArrays",
    "Packed",
    "Piece",
    "PieceArrays",
    "arrays_of",
    "take",
]
