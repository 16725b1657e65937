"""Find points that two bodies have in common, well inside both, and vertices that show it: see docs/proof-format.md."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from loewner._kernels import columns
from loewner._validate import Floats, Ints
from loewner.bodies import Packed

# A point that is this share of the depth away from the boundaries of both pieces is well inside them.
WELL_INSIDE = 0.05

# How far from the witnesses points are sought, in multiples of the depth, and how often curved pieces get more planes.
AWAY, ROUNDS = (4.0, 256.0, 2.0**16), 24

# Lengths below this share of the pieces' size are rounding.
LEAST = 1e-15

# Vertices of a hull from which tetrahedra are tried.
APEXES = 3


def blocks(packs: Sequence[Packed], poses: Floats, near: Floats) -> Iterator[bytes]:
    """Make the contents of proofs that two bodies have a common point, likely ones first.

    Parameters
    ----------
    packs : sequence of Packed
        The bodies, without surfaces.
    poses : ndarray, shape (2, 4, 4)
    near : ndarray, shape (2, 3)
        Witnesses of the depth, see `loewner.distance`.
    """
    middle, chosen = near.mean(axis=0), list[tuple[int, _Piece]]()
    for packed, T in zip(packs, poses, strict=True):
        pieces = [_Piece(packed, k, T) for k in range(len(packed.layout))]
        best = int(np.argmax([piece.depth(middle) for piece in pieces]))
        chosen.append((best, pieces[best]))
    (i, a), (j, b) = chosen
    for point in _points(a, b, near):
        for first in a.vertices_about(point):
            for second in b.vertices_about(point):
                yield struct.pack("<12I3d", 0, i, *first, 1, j, *second, *point)


def _points(a: _Piece, b: _Piece, near: Floats) -> Iterator[Floats]:
    """Make points that may belong to two pieces, first one that is well inside both."""
    middle = near.mean(axis=0)
    scale = max(float(np.linalg.norm(near[1] - near[0])), LEAST * (a.size + b.size))
    if min(a.depth(middle), b.depth(middle)) > WELL_INSIDE * scale:
        yield middle
    for away in AWAY:
        found = _innermost(a, b, middle, scale, away)
        if found is not None:
            yield found
            break
    yield from (middle, *near)


def _innermost(a: _Piece, b: _Piece, middle: Floats, scale: float, away: float) -> Floats | None:
    """Find about the point that is deepest inside two pieces; None if none is inside.

    The planes around the pieces make a linear program, with lengths in multiples of `scale` from the middle. Curved
    pieces get more planes where its solutions are.
    """
    from scipy.optimize import linprog

    planes = np.concatenate([piece.planes(middle) for piece in (a, b)])
    best, deepest = None, 0.0
    for _ in range(ROUNDS):
        limits = (planes[:, 3] - planes[:, :3] @ middle) / scale
        near = limits < 3.0 * away  # the other planes are beyond all points that are sought
        rows = np.column_stack([planes[near, :3], np.ones(near.sum())])
        found = linprog([0.0, 0.0, 0.0, -1.0], rows, limits[near], bounds=[(-away, away)] * 4)
        if found.x is None or found.x[3] <= deepest:
            break
        point = middle + scale * found.x[:3]
        depth = min(a.depth(point), b.depth(point)) / scale
        if depth > deepest:
            best, deepest = point, depth
        if deepest > found.x[3] / 2:
            break
        planes = np.concatenate([planes, *(piece.planes(point) for piece in (a, b) if piece.kind != columns.POLYTOPE)])
    return best


class _Piece:
    """A piece in the world: its kind, radius and size, the points of its core, and planes or the factor of its image."""

    def __init__(self, packed: Packed, k: int, T: Floats) -> None:
        row, frame = packed.layout[k], packed.frames[k]
        self.kind, self.radius = int(row[columns.KIND]), float(frame[0])
        M, s = T[:3, :3], T[:3, 3]
        center, self.factor = M @ frame[1:4] + s, M @ frame[4:].reshape(3, 3)
        self.points = center[None]
        if self.kind == columns.SEGMENT:
            self.points = center + np.outer([-1.0, 1.0], self.factor[:, 2])
        elif self.kind == columns.POLYTOPE:
            self.points = packed.points[row[columns.POINTS_FROM] : row[columns.POINTS_TO]] @ M.T + s
            self.triangles = packed.triangles[packed.triangle_start[k] : packed.triangle_start[k + 1]]
            self.faces = _moved(packed.planes[slice(*row[3:])], np.linalg.inv(M), -np.linalg.solve(M, s))
        extent = np.abs(self.points).max() + np.abs(self.factor).max()
        self.size = float(extent + self.radius)

    def planes(self, x: Floats) -> Floats:
        """Planes around the piece, as rows of a unit normal and an offset, that are tight near a point."""
        if self.kind == columns.POLYTOPE:
            return self.faces
        if self.kind in (columns.POINT, columns.SEGMENT):
            along = self.points[-1] - self.points[0]
            share = (x - self.points[0]) @ along / max(float(along @ along), 1e-300)
            nearest = self.points[0] + min(max(share, 0.0), 1.0) * along
            n = x - nearest
            if not n.any():  # any direction across
                n = np.cross(along, np.eye(3)[np.argmin(np.abs(along))]) if along.any() else np.eye(3)[0]
            n = n / np.linalg.norm(n)
            return np.append(n, n @ nearest + self.radius)[None]
        back = np.linalg.inv(self.factor)
        u = back @ (x - self.points[0])
        across = np.append(u[:2], 0.0) / np.hypot(*u[:2]) if u[:2].any() else np.eye(3)[0]
        up = np.eye(3)[2]
        if self.kind == columns.ELLIPSOID:
            rows = [u / np.linalg.norm(u) if u.any() else up]
        elif self.kind == columns.CYLINDER:
            rows = [across, up, -up]
        else:
            rows = [2.0 * across + up, -up]
        return _moved(np.column_stack([rows, np.ones(len(rows))]), back, -back @ self.points[0])

    def depth(self, x: Floats) -> float:
        """How far the planes near a point are from it, at least; negative outside."""
        planes = self.planes(x)
        return float((planes[:, 3] - planes[:, :3] @ x).min())

    def vertices_about(self, point: Floats) -> Iterator[tuple[int, ...]]:
        """Name four points of the core that show that a point belongs to the piece."""
        if self.kind != columns.POLYTOPE:
            yield (0, len(self.points) - 1, 0, 0)
            return
        # The ray from a vertex through the point leaves the hull through a triangle.
        for apex in np.argsort(-((self.points - point) ** 2).sum(axis=1))[:APEXES].tolist():
            a, b, c = (self.points[self.triangles] - self.points[apex]).transpose(1, 0, 2)
            normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
            volume = (a * normals[0]).sum(axis=1)
            weights = normals @ (point - self.points[apex]) / np.where(volume == 0.0, 1.0, volume)
            least = np.minimum(weights.min(axis=0), 1.0 - weights.sum(axis=0))
            best = int(np.where(volume == 0.0, -np.inf, least).argmax())
            yield (apex, *self.triangles[best].tolist())


def _moved(planes: Floats, back: Floats, shift: Floats) -> Floats:
    """Planes n·u <= d about points u = back x + shift, as planes about x."""
    n = planes[:, :3] @ back
    return np.column_stack([n, planes[:, 3] - planes[:, :3] @ shift]) / np.linalg.norm(n, axis=1)[:, None]
