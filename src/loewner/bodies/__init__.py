"""Bodies: unions of convex pieces, each with its inner and outer ellipsoid.

A `Body` is one; `Bodies` is a packed sequence of them for batches. Both are read-only. A body is
moved by handing a pose to a query; the fits are never computed again.

`body` holds these two, `pack` the arrays behind them, `layout` what kernels see of the arrays, `files` the ``.npz``.
"""

from loewner.bodies.body import Bodies, Body, Piece
from loewner.bodies.files import FORMAT, VERSION
from loewner.bodies.layout import LARGEST, SMALLEST, KernelArrays
from loewner.bodies.pack import ARRAYS, KIND_NAMES, Packed, take
from loewner.bodies.pack import arrays_of as _arrays

__all__ = [
    "ARRAYS",
    "FORMAT",
    "KIND_NAMES",
    "LARGEST",
    "SMALLEST",
    "VERSION",
    "Bodies",
    "Body",
    "Ints",
    "KernelArrays",
    "Packed",
    "Piece",
    "Progress",
    "_arrays",
    "take",
]
