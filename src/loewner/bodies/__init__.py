"""Bodies: unions of convex pieces, each with its inner and outer ellipsoid.

A `Body` is one union; `Bodies` packs a sequence of bodies for batched queries. Both are read-only. `body` defines these
two classes, and `pack` and `layout` define the arrays behind them. `primitives` and `kinds` make curved pieces;
`surfaces` and `surface_trees` make pieces that consist of triangles. `flat_faces` finds coplanar triangles, and `boxes`
orients bounding boxes. `parts` cuts surfaces into parts, which proofs replace with their hulls. `triangulated` makes
triangles for pictures, `sensed` makes clouds, voxels and terrain, and `depth_images` makes points from depth images.
`files`, `native_files`, `octrees` and `exports` read and write files, and `checks` checks arrays from files.
`cover_fits` covers a body with a few elements; `cover_proofs` and `elements` prove that the elements contain the body.
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
from loewner.bodies.layout import ARRAYS, PieceArrays, arrays_of
from loewner.bodies.pack import Packed
from loewner.bodies.triangulated import for_pictures

__all__ = [
    "ARRAYS",
    "CURVED",
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
]
