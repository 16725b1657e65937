"""Bodies: unions of convex pieces, each with its inner and outer ellipsoid.

A `Body` is one such union; `Bodies` packs a sequence of bodies for batched queries. Both are read-only. To move a body,
pass a pose to a query; its ellipsoids are not fitted again.

`body` defines these two classes, `pack` and `layout` define the arrays behind them, and `files` defines the ``.npz``
format.
"""

from loewner.bodies.body import (
    Bodies,
    Body,
    Piece,
    bodies_of,
    body_of_file,
    body_of_polytopes,
    checksum_of,
    packed_of,
    reach_of,
)
from loewner.bodies.depth_images import camera_of, points_of
from loewner.bodies.kinds import CURVED
from loewner.bodies.layout import ARRAYS, LARGEST, SMALLEST, PieceArrays, arrays_of
from loewner.bodies.pack import Packed, take
from loewner.bodies.triangulated import for_pictures

__all__ = [
    "ARRAYS",
    "CURVED",
    "LARGEST",
    "SMALLEST",
    "Bodies",
    "Body",
    "Packed",
    "Piece",
    "PieceArrays",
    "arrays_of",
    "bodies_of",
    "body_of_file",
    "body_of_polytopes",
    "camera_of",
    "checksum_of",
    "for_pictures",
    "packed_of",
    "points_of",
    "reach_of",
    "take",
]
