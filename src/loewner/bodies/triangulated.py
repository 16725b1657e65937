"""Triangulate pieces and ellipsoids, for pictures and for formats that have only triangles."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from itertools import combinations

import numpy as np

from loewner._kernels import columns
from loewner._validate import Floats, Ints
from loewner.bodies.kinds import CURVED, Kind
from loewner.bodies.pack import Packed

Mesh = tuple[Floats, Ints]

# Bodies with more pieces than this have coarser ellipsoids: 320 instead of 1280 triangles each.
MANY_PIECES = 16

# Corners of the circles of cylinders and cones.
SEGMENTS = 48

# A unit icosahedron: the corners of three golden rectangles, and triangles counter-clockwise from outside.
_GOLDEN = (1 + 5**0.5) / 2
_CORNERS = np.array([[-1, _GOLDEN, 0], [1, _GOLDEN, 0], [-1, -_GOLDEN, 0], [1, -_GOLDEN, 0]]) / np.hypot(1, _GOLDEN)
_ICOSAHEDRON = np.vstack([_CORNERS, np.roll(_CORNERS, 1, axis=1), np.roll(_CORNERS, 2, axis=1)])


def of_pieces(packed: Packed) -> list[Mesh]:
    """Triangulate the surface of each piece; the corners on a curved piece lie on its surface."""
    return [of_piece(packed, number) for number in range(len(packed.layout))]


def ellipsoids_of(packed: Packed, which: str) -> tuple[Floats, Floats]:
    """Return the centers and factors of all inner, or all outer, ellipsoids."""
    if which == "inner":
        return packed.inner_center, packed.inner_factor
    return packed.outer_center, packed.outer_factor


def of_ellipsoids(packed: Packed, which: str) -> dict[int, Mesh]:
    """Triangulate each inner, or each outer, ellipsoid, keyed by piece index; an inner one may be a point."""
    centers, factors = ellipsoids_of(packed, which)
    unit, triangles = ball(3 if len(centers) <= MANY_PIECES else 2)
    return {k: (unit @ F.T + c, triangles) for k, (c, F) in enumerate(zip(centers, factors, strict=True)) if F.any()}


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """Join several meshes into one."""
    points: list[Floats] = []
    triangles: list[Ints] = []
    total = 0
    for vertices, faces in meshes:
        points.append(vertices)
        triangles.append(faces + total)
        total += len(vertices)
    if not points:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    return np.concatenate(points), np.concatenate(triangles)


@lru_cache(maxsize=4)
def ball(subdivisions: int) -> Mesh:
    """Triangulate the unit ball: the triangles of an icosahedron, repeatedly divided into four."""
    vertices, triangles = _ICOSAHEDRON, _faces(_ICOSAHEDRON)
    for _ in range(subdivisions):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        ends, which = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
        middles = vertices[ends].sum(axis=1)
        ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
        a, b, c = triangles.T
        vertices = np.vstack([vertices, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
        triangles = np.concatenate([np.column_stack(t) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles


def _faces(corners: Floats) -> Ints:
    """List the triangles of an icosahedron: all triples of neighbouring corners, counter-clockwise from outside."""
    near = corners @ corners.T > 0.4  # neighbours have 1/sqrt(5), all others less than 0
    all_near = (three for three in combinations(range(12), 3) if near[np.ix_(three, three)].all())
    threes = [three if np.linalg.det(corners[list(three)]) > 0 else three[::-1] for three in all_near]
    return np.array(threes, dtype=np.int64)


def of_piece(packed: Packed, number: int) -> Mesh:
    """Triangulate the surface of one piece."""
    row, frame = packed.layout[number], packed.frames[number]
    if row[columns.KIND] <= columns.POLYTOPE:
        triangles = packed.triangles[packed.triangle_start[number] : packed.triangle_start[number + 1]]
        return packed.points[row[columns.POINTS_FROM] : row[columns.POINTS_TO]], triangles
    return _curved(CURVED[int(row[columns.KIND])], float(frame[0]), frame[1:4], frame[4:].reshape(3, 3))


def _curved(kind: Kind, rounding: float, center: Floats, factor: Floats) -> Mesh:
    """Triangulate a curved piece: the image of a unit shape, with a ball added."""
    if kind.top is None and kind.core is None and not kind.is_ball:
        raise ValueError(f"{kind.name}: expected a row of CURVED with is_ball, top or core, found none of them")
    unit, triangles = ball(3) if kind.top is None else _cylinder(kind.top)
    if kind.core is None:
        return unit @ factor.T + center, triangles
    lengths = np.linalg.norm(factor, axis=0)
    half = kind.core * lengths[2]
    core = np.where(unit[:, 2:] >= 0, half, -half) * [0.0, 0.0, 1.0]
    return (rounding * unit + core) @ (factor / lengths).T + center, triangles


def _cylinder(top: float) -> Mesh:
    """Triangulate the solid between two circles, of radius 1 at z = -1 and of radius `top` at z = 1."""
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = (np.column_stack([r * circle, np.full(SEGMENTS, z)]) for r, z in ((1.0, -1.0), (top, 1.0)))
    at = np.arange(SEGMENTS)
    after = (at + 1) % SEGMENTS
    bottom, lid = np.full(SEGMENTS, 2 * SEGMENTS), np.full(SEGMENTS, 2 * SEGMENTS + 1)
    triangles = [(at, after, at + SEGMENTS), (after, after + SEGMENTS, at + SEGMENTS),
                 (bottom, after, at), (lid, at + SEGMENTS, after + SEGMENTS)]  # fmt: skip
    return np.vstack([low, high, [[0, 0, -1], [0, 0, 1]]]), np.concatenate([np.column_stack(t) for t in triangles])
