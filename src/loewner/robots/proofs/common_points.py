"""Find points well inside two bodies, and vertices that prove that the points are inside; see docs/proof-format.md."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies import Packed
from loewner.queries._exact import cross, dot, minus, placed

# A point is well inside two pieces if its distance from their boundaries is at least the share WELL_INSIDE of the
# depth.
WELL_INSIDE = 0.05

# AWAY contains the distances from the witnesses within which points are sought, in multiples of the depth. Curved
# pieces get more planes at most ROUNDS times.
AWAY, ROUNDS = (4.0, 256.0, 2.0**16), 24

# Lengths below the share LEAST of the pieces' size are rounding errors.
LEAST = 1e-15

# If only planes within ROUNDED times the size of a piece are considered, rounding errors in the planes matter.
ROUNDED = 1e-9

# A step away from a point, in multiples of the point's depth. The step avoids the middle of a hull, which lies in faces
# of many tetrahedra.
BESIDE = np.array([0.17, 0.08, -0.23])

# Number of a hull's vertices from which tetrahedra are tried, and number of tetrahedra from each vertex.
APEXES, TRIANGLES = 4, 2


def blocks(packs: Sequence[Packed], poses: Floats, near: Floats) -> Iterator[bytes]:
    """Yield the contents of possible proofs that two bodies have a common point, the likeliest points first.

    Parameters
    ----------
    packs : sequence of Packed
        The bodies, with their surfaces cut into parts.
    poses : ndarray, shape (2, 4, 4)
    near : ndarray, shape (2, 3)
        Witnesses of the depth; see `loewner.distance`.
    """
    middle, chosen = near.mean(axis=0), list[tuple[int, _Piece]]()
    for packed, T in zip(packs, poses, strict=True):
        pieces = [_Piece(packed, k, T, middle) for k in range(len(packed.layout))]
        best = int(np.argmax([piece.depth(middle) for piece in pieces]))
        chosen.append((best, pieces[best]))
    (i, a), (j, b) = chosen
    for step in _steps(a, b, near):
        for first in a.vertices_about(middle + step):
            for second in b.vertices_about(middle + step):
                yield struct.pack("<12I6d", 0, i, *first, 1, j, *second, *middle, *step)


def _steps(a: _Piece, b: _Piece, near: Floats) -> Iterator[Floats]:
    """Yield steps from the middle of the witnesses to points that may be in two pieces, first to points well inside."""
    middle, half = near.mean(axis=0), (near[1] - near[0]) / 2
    scale = max(2.0 * float(np.linalg.norm(half)), LEAST * (a.size + b.size))
    if (depth := min(a.depth(middle), b.depth(middle))) > WELL_INSIDE * scale:
        yield depth * BESIDE
    for away in AWAY:
        step, depth = _innermost(a, b, middle, scale, away)
        if depth > 0.0:
            yield step + depth * BESIDE
            break
    yield from (np.zeros(3), half, -half)


def _innermost(a: _Piece, b: _Piece, middle: Floats, scale: float, away: float) -> tuple[Floats, float]:
    """Find roughly the deepest point inside two pieces, as a step from the middle, and its depth; 0 if there is none.

    The planes around the pieces make a linear program, with lengths in multiples of `scale` from the middle. Curved
    pieces get more planes near the program's solutions.
    """
    from scipy.optimize import linprog

    reach = 3.0 * away * scale  # planes farther away are beyond all points that are sought
    planes = np.concatenate([piece.near_planes(middle, reach) for piece in (a, b)])
    curved = [piece for piece in (a, b) if piece.kind != columns.POLYTOPE]
    best, deepest = np.zeros(3), 0.0
    for _ in range(ROUNDS):
        rows = np.column_stack([planes[:, :3], np.ones(len(planes))])
        solution = linprog([0.0, 0.0, 0.0, -1.0], rows, planes[:, 3] / scale, bounds=[(-away, away)] * 4)
        if solution.x is None or solution.x[3] <= deepest:
            break
        step = scale * solution.x[:3]
        more = np.concatenate([*(piece.planes(middle + step) for piece in curved), planes[:0]])
        more[:, 3] += more[:, :3] @ step
        depth = float((np.concatenate([planes, more]) @ np.append(-step, 1.0)).min()) / scale
        if depth > deepest:
            best, deepest = step, depth
        if deepest > solution.x[3] / 2:
            break
        planes = np.concatenate([planes, more])
    return best, scale * deepest


class _Piece:
    """A piece in the world: its kind, radius and size, the points of its core, and faces or the factor of its image.

    A surface or a cloud counts as the ball about its corner nearest to `near`. A plane is a row with a unit outward
    normal and the plane's distance from a point; for `faces`, the point is `place`.
    """

    def __init__(self, packed: Packed, k: int, T: Floats, near: Floats) -> None:
        frame = packed.frames[k]
        self.kind, self.radius = int(packed.layout[k, columns.KIND]), float(frame[0])
        M, s = T[:3, :3], T[:3, 3]
        center, self.factor = M @ frame[1:4] + s, M @ frame[4:].reshape(3, 3)
        self.points, self.four = center[None], (0, 0, 0, 0)
        self.own, self.T = packed.points_of(k), T
        if self.kind <= columns.SURFACE:
            corners = np.unique(self.own + 0.0, axis=0) @ M.T + s  # in the order of the model
            best = int(((corners - near) ** 2).sum(axis=1).argmin())
            self.kind, self.points, self.four = columns.POINT, corners[best, None], (best,) * 4
        elif self.kind == columns.SEGMENT:
            self.four = 0, 1, 0, 0
            self.points = center + np.outer([-1.0, 1.0], self.factor[:, 2])
        elif self.kind == columns.POLYTOPE:
            self.points = self.own @ M.T + s
            self.triangles = packed.triangles_of(k)
            self.faces, self.place = _turned(packed.planes_of(k), np.linalg.inv(M)), s
        extent = np.abs(self.points).max() + np.abs(self.factor).max()
        self.size = float(extent + self.radius)

    def depth(self, x: Floats) -> float:
        """Return the least distance from a point to the planes near the point; negative outside."""
        return float(self.planes(x)[:, 3].min())

    def near_planes(self, x: Floats, reach: float) -> Floats:
        """Return the planes within `reach` of a point; if rounding matters at this `reach`, faces have exact planes."""
        planes = self.planes(x)
        planes = planes[planes[:, 3] < reach + LEAST * self.size]
        if self.kind != columns.POLYTOPE or reach > ROUNDED * self.size:
            return planes
        corners = self.points[self.triangles]
        n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        n /= np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]
        away, exact_planes = ((corners[:, 0] - x) * n).sum(axis=1), []
        for triangle in self.triangles[away < reach + ROUNDED * self.size]:
            (o, p, q, r), unit = placed([(np.eye(4), x), *((self.T, self.own[k]) for k in triangle)])
            normal = cross(minus(q, p), minus(r, p))
            length = math.isqrt(dot(normal, normal)) or 1
            exact_planes.append([*(y / length for y in normal), dot(normal, minus(p, o)) / length * float(unit)])
        return np.array(exact_planes, dtype=np.float64).reshape(-1, 4)

    def planes(self, x: Floats) -> Floats:
        """Return planes around the piece that are tight near a point."""
        if self.kind == columns.POLYTOPE:
            return np.column_stack([self.faces[:, :3], self.faces[:, 3] - self.faces[:, :3] @ (x - self.place)])
        if self.kind in (columns.POINT, columns.SEGMENT):
            along = self.points[-1] - self.points[0]
            share = (x - self.points[0]) @ along / max(float(along @ along), 1e-300)
            n = x - self.points[0] - min(max(share, 0.0), 1.0) * along
            length = float(np.linalg.norm(n))
            if length == 0.0:  # any perpendicular direction
                n = np.cross(along, np.eye(3)[np.argmin(np.abs(along))]) if along.any() else np.eye(3)[0]
            return np.append(n / np.linalg.norm(n), self.radius - length)[None]
        back = np.linalg.inv(self.factor)
        u = back @ (x - self.points[0])
        across = np.append(u[:2], 0.0) / np.hypot(*u[:2]) if u[:2].any() else np.eye(3)[0]
        up = np.eye(3)[2]
        rows = {
            columns.ELLIPSOID: [u / np.linalg.norm(u) if u.any() else up],
            columns.CYLINDER: [across, up, -up],
            columns.CONE: [2.0 * across + up, -up],
        }[self.kind]  # written proofs refuse other kinds
        return _turned(np.column_stack([rows, 1.0 - rows @ u]), back)

    def vertices_about(self, point: Floats) -> Iterator[tuple[int, ...]]:
        """Yield sets of four core points that may prove that a point belongs to the piece."""
        if self.kind != columns.POLYTOPE:
            yield self.four
            return
        # The ray from a vertex through the point leaves the hull through a triangle. The vertex and the triangle form a
        # tetrahedron that contains the point. The best tetrahedron has its faces far from the point.
        rated = []
        for apex in np.argsort(-((self.points - point) ** 2).sum(axis=1), kind="stable")[:APEXES].tolist():
            a, b, c = (self.points[self.triangles] - self.points[apex]).transpose(1, 0, 2)
            normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
            volume = (a * normals[0]).sum(axis=1)
            weights = normals @ (point - self.points[apex]) / np.where(volume == 0.0, 1.0, volume)
            least = np.minimum(weights.min(axis=0), 1.0 - weights.sum(axis=0))
            least[volume == 0.0] = -np.inf
            rated += [(float(least[k]), apex, k) for k in np.argsort(-least, kind="stable")[:TRIANGLES].tolist()]
        for _, apex, k in sorted(rated, reverse=True)[: APEXES * TRIANGLES // 2]:
            yield (apex, *self.triangles[k].tolist())


def _turned(planes: Floats, back: Any) -> Floats:
    """Convert planes for vectors u = back v to planes for v."""
    n = planes[:, :3] @ back
    return np.asarray(np.column_stack([n, planes[:, 3]]) / np.linalg.norm(n, axis=1)[:, None])
