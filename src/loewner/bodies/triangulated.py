"""Triangulate pieces and ellipsoids, for pictures and for formats that have only triangles."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from loewner._base._pictures import Shape
from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies.kinds import CURVED, Mesh, ball
from loewner.bodies.pack import Packed

# For a body with more pieces than this, ellipsoids have 320 triangles instead of 1280.
MANY_PIECES = 16


def of_pieces(packed: Packed) -> list[Mesh]:
    """Triangulate the surface of each piece; for a curved piece, the corners lie on the surface."""
    return [of_piece(packed, number) for number in range(len(packed.layout))]


def ellipsoids_of(packed: Packed, which: str) -> tuple[Floats, Floats]:
    """Return the centers and factors of all inner, or all outer, ellipsoids."""
    return getattr(packed, f"{which}_center"), getattr(packed, f"{which}_factor")


def of_ellipsoids(packed: Packed, which: str) -> dict[int, Mesh]:
    """Triangulate all inner, or all outer, ellipsoids that are not points; the keys are the indices of the pieces."""
    centers, factors = ellipsoids_of(packed, which)
    unit, triangles = ball(3 if len(centers) <= MANY_PIECES else 2)
    return {k: (unit @ F.T + c, triangles) for k, (c, F) in enumerate(zip(centers, factors, strict=True)) if F.any()}


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """Join several meshes into one."""
    points, triangles = zip((np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)), *meshes, strict=True)
    first = np.cumsum([0, *map(len, points)])
    return np.concatenate(points), np.concatenate([faces + k for faces, k in zip(triangles, first, strict=False)])


def for_pictures(packed: Packed, coarse: bool = False) -> Shape:
    """Triangulate all pieces in the frames of their bodies, coarsely if there are many bodies."""
    row, counts = packed.layout, np.diff(packed.triangle_start)
    corners = packed.points[packed.triangles + np.repeat(row[:, columns.POINTS_FROM], counts)[:, None]]
    radii = np.repeat(packed.frames[:, 0], counts)
    curved = np.flatnonzero(row[:, columns.KIND] > columns.POLYTOPE)
    coarse = coarse or len(curved) > MANY_PIECES
    meshes = (of_piece(packed, k, coarse) for k in curved.tolist())
    corners = np.concatenate([corners, *(vertices[triangles] for vertices, triangles in meshes)])
    return Shape(corners, np.append(radii, np.zeros(len(corners) - len(radii))), "")


def of_piece(packed: Packed, number: int, coarse: bool = False) -> Mesh:
    """Triangulate the surface of one piece; with `coarse`, a ball has 80 triangles."""
    row, frame = packed.layout[number], packed.frames[number]
    if row[columns.KIND] <= columns.POLYTOPE:
        return packed.points_of(number), packed.triangles_of(number)
    kind, rounding, center, factor = CURVED[int(row[columns.KIND])], frame[0], frame[1:4], frame[4:].reshape(3, 3)
    unit, triangles = ball(1) if coarse and kind.mesh is ball else kind.mesh()
    if kind.core is None:
        return unit @ factor.T + center, triangles
    lengths = np.linalg.norm(factor, axis=0)
    half = kind.core * lengths[2]
    core = np.where(unit[:, 2:] >= 0, half, -half) * [0.0, 0.0, 1.0]
    return (rounding * unit + core) @ (factor / lengths).T + center, triangles
