"""Settle, in exact integers, pairs of surfaces that the kernels cannot decide because of rounding.

Poses and corners are floats, so the coordinates of all placed corners are integer multiples of one small unit.
Determinants of integers are exact, and their signs are therefore certain. Settling a pair with Python's integers takes
a thousand times as long as in a kernel, about a millisecond, but hardly any pair requires this.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction
from typing import TypeAlias

import numpy as np

from loewner._base._validate import Floats, Ints
from loewner._kernels import codes, columns
from loewner._native import entries

# The plan, the rows, the handle and poses of a, and the handle and poses of b; arrays are in C order. See
# `_kernels/pipeline/verdicts.py`.
Operands: TypeAlias = tuple[Ints, Ints, int, Floats, int, Floats]

Vector: TypeAlias = tuple[int, int, int]

# At most this many undecided pairs of triangles are examined. If there are more, the pair of surfaces stays AMBIGUOUS
# unless one of the examined pairs of triangles meets.
ROOM = 20_000

# Directions of rays. They are tried one after another, since a ray that meets an edge gives no answer.
RAYS = (
    (1, 2, 3),
    (-3, 1, 2),
    (2, -3, 1),
    (-1, -5, 7),
    (7, -1, -5),
    (-5, 7, 1),
    (11, 3, -2),
    (-2, 11, -3),
    (3, -2, -11),
)

# Allowance for rounding when selecting the triangles that a ray could meet, relative to the lengths involved.
_GENEROUS = 1e-9


def verdict(margin: float, k: int, operands: Operands) -> int:
    """Settle pair k, for which the fallback returned INEXACT."""
    plan, rows, pack_a, poses_a, pack_b, poses_b = operands
    listed = np.empty((ROOM, 6), dtype=np.int64)
    count = entries.open_triangles(margin, k, plan, rows, pack_a, poses_a, pack_b, poses_b, listed)
    parts: dict[tuple[int, int], Part] = {}
    for piece_a, piece_b, row_a, row_b, triangle_a, triangle_b in listed[:count].tolist():
        for key in ((pack_a, piece_a), (pack_b, piece_b)):
            if key not in parts:
                parts[key] = Part(*key)
        a, b = parts[pack_a, piece_a], parts[pack_b, piece_b]
        T, S = poses_a.reshape(-1, 4, 4)[row_a], poses_b.reshape(-1, 4, 4)[row_b]
        if triangle_a < 0:
            if a.holds_part_of(b, T, S) or b.holds_part_of(a, S, T):
                return codes.COLLIDING
        else:
            reach = Fraction(margin) + Fraction(a.radius) + Fraction(b.radius)
            corners = [(T, p) for p in a.corners(triangle_a)] + [(S, p) for p in b.corners(triangle_b)]
            points, unit = placed(corners)
            if within(points[:3], points[3:], reach / unit):
                return codes.COLLIDING
    return codes.FREE if count <= ROOM else codes.AMBIGUOUS


class Part:
    """A piece: triangles of a surface, and a point of each connected part."""

    def __init__(self, pack: int, piece: int) -> None:
        self.kind, self.radius, self.triangles, self.points = entries.exact_parts(pack, piece)

    def corners(self, triangle: int) -> Floats:
        """Return the corners of a triangle, shape (3, 3)."""
        return np.asarray(self.triangles[triangle].reshape(3, 3))

    def holds_part_of(self, other: Part, T: Floats, S: Floats) -> bool:
        """Return whether this solid or its surface contains the first vertex of a connected part of another piece."""
        return self.kind == columns.SOLID and any(self._holds(point, T, S) for point in other.points)

    def _holds(self, point: Floats, T: Floats, S: Floats) -> bool:
        """Return whether the solid at pose T contains a point of another body at pose S."""
        corners = self.triangles[np.isfinite(self.triangles[:, 0])].reshape(-1, 3, 3)
        near = corners @ T[:3, :3].T + (T[:3, 3] - S[:3, 3]) - S[:3, :3] @ point
        middle = near.mean(axis=1)
        reach = np.linalg.norm(near - middle[:, None], axis=2).max(axis=1)
        reach += _GENEROUS * (np.abs(near).max() + np.abs(T[:3, 3]).max() + np.abs(corners).max())
        for ray in RAYS:
            way = np.array(ray) / math.hypot(*ray)
            along = middle @ way
            aside = np.linalg.norm(middle - along[:, None] * way, axis=1)
            crossed = np.flatnonzero((aside <= reach) & (along >= -reach))
            is_inside = _windings(ray, (T, corners[crossed]), (S, point))
            if is_inside is not None:
                return is_inside
        raise AssertionError("expected a ray that shows whether a point is inside, found none")


def placed(points: list[tuple[Floats, Floats]]) -> tuple[list[Vector], Fraction]:
    """Place points at poses; return their coordinates as integer multiples of a unit, and the unit in metres."""
    turn = _digits([T[:3, :3] for T, _ in points])
    place = _digits([p for _, p in points])
    all_digits = max(turn + place, _digits([T[:3, 3] for T, _ in points]))
    vectors = []
    for T, p in points:
        x, y, z = (_whole(float(c), place) for c in p)
        rows = [[_whole(float(entry), turn) for entry in row[:3]] for row in T[:3]]
        turned = [(a * x + b * y + c * z) << (all_digits - turn - place) for a, b, c in rows]
        vectors.append(tuple(u + _whole(float(t), all_digits) for u, t in zip(turned, T[:3, 3], strict=True)))
    return vectors, Fraction(1, 1 << all_digits)  # type: ignore[return-value]


def _digits(arrays: list[Floats]) -> int:
    """Return the largest number of binary digits after the point among all floats of the arrays."""
    numbers = np.concatenate([np.ravel(a) for a in arrays])
    numbers = numbers[numbers != 0]
    return max(0, 53 - int(np.frexp(numbers)[1].min())) if len(numbers) else 0


def _whole(x: float, digits: int) -> int:
    """Return the integer x times 2 to the power of `digits`."""
    top, bottom = x.as_integer_ratio()
    return (top << digits) // bottom


def minus(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: Vector, b: Vector) -> int:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def meet(a: list[Vector], b: list[Vector]) -> bool:
    """Return whether two triangles, segments or points have a point in common.

    Two such sets have no common point if and only if an axis separates them strictly. It suffices to try the face
    normals of the set of all differences between their points or, if this set is flat, the normals of the plane or line
    that contains the set.
    """
    return not any(
        max(dot(n, p) for p in a) < min(dot(n, p) for p in b) or max(dot(n, p) for p in b) < min(dot(n, p) for p in a)
        for n in _axes(a, b)
    )


def _axes(a: list[Vector], b: list[Vector]) -> Iterator[Vector]:
    edges = [minus(t[(k + 1) % 3], t[k]) for t in (a, b) for k in range(3)]
    edges = [e for e in edges if any(e)]
    between = minus(b[0], a[0])
    normals = [n for n in (cross(e, f) for e, f in itertools.combinations(edges, 2)) if any(n)]
    yield from normals
    if normals:
        yield from (cross(normals[0], e) for e in edges)
    elif edges:
        yield edges[0]
        yield cross(edges[0], cross(edges[0], between))
    else:
        yield between


def within(a: list[Vector], b: list[Vector], reach: Fraction) -> bool:
    """Return whether the distance between two triangles is at most `reach`."""
    if meet(a, b):
        return True
    edges_a, edges_b = ([(t[k], t[(k + 1) % 3]) for k in range(3)] for t in (a, b))
    squares = itertools.chain(
        (_to_segment(p, *edge) for p in a for edge in edges_b),
        (_to_segment(p, *edge) for p in b for edge in edges_a),
        (_to_face(p, t) for one, t in ((a, b), (b, a)) for p in one),
        (_between_lines(*one, *other) for one in edges_a for other in edges_b),
    )
    return reach > 0 and any(square is not None and square <= reach * reach for square in squares)


def _to_segment(p: Vector, a: Vector, b: Vector) -> Fraction:
    """Compute the squared distance from a point to a segment."""
    e, w = minus(b, a), minus(p, a)
    squared, along = dot(e, e), dot(w, e)
    foot = min(max(along, 0), squared)  # The foot point is a + e foot / squared.
    return Fraction(dot(w, w)) - (Fraction((2 * along - foot) * foot, squared) if squared else 0)


def _to_face(p: Vector, t: list[Vector]) -> Fraction | None:
    """Compute a point's squared distance from a triangle's plane; None if the foot point is outside the triangle."""
    n = cross(minus(t[1], t[0]), minus(t[2], t[0]))
    if not any(n) or any(dot(cross(minus(t[(k + 1) % 3], t[k]), minus(p, t[k])), n) < 0 for k in range(3)):
        return None
    return Fraction(dot(n, minus(p, t[0])) ** 2, dot(n, n))


def _between_lines(a: Vector, b: Vector, c: Vector, d: Vector) -> Fraction | None:
    """Compute the squared distance of two lines; None if they are parallel, or a foot point is outside its segment."""
    u, v, r = minus(b, a), minus(d, c), minus(c, a)
    n = cross(u, v)
    squared = dot(n, n)
    if squared == 0:
        return None
    if not (0 <= dot(cross(r, v), n) <= squared and 0 <= dot(cross(r, u), n) <= squared):
        return None
    return Fraction(dot(r, n) ** 2, squared)


def _windings(ray: Vector, surface: tuple[Floats, Floats], place: tuple[Floats, Floats]) -> bool | None:
    """Return whether a surface winds around a point, judged by a ray; None if the ray meets an edge."""
    T, triangles = surface
    (x, *corners), _ = placed([place, *((T, p) for p in triangles.reshape(-1, 3))])
    count = 0
    for n in range(0, len(corners), 3):
        a, b, c = (minus(p, x) for p in corners[n : n + 3])
        signs = [_sign(dot(ray, cross(p, q))) for p, q in ((a, b), (b, c), (c, a))]
        if min(signs) < 0 < max(signs):
            continue
        volume = dot(a, cross(b, c))
        if 0 in signs:
            # The start of the ray may lie in the triangle; or the triangle may be edge-on, and then the ray may miss
            # it.
            if volume == 0 and meet([(0, 0, 0)] * 3, [a, b, c]):
                return True
            if _may_cross(ray, a, b, c):
                return None
            continue
        if volume == 0:
            return True
        if (volume > 0) == (signs[0] > 0):
            count += signs[0]
    return count != 0


def _may_cross(ray: Vector, a: Vector, b: Vector, c: Vector) -> bool:
    """Return whether a ray from the origin meets a triangle."""
    far = 1 + max(abs(x) for p in (a, b, c) for x in p) * 2
    end = (ray[0] * far, ray[1] * far, ray[2] * far)
    return meet([(0, 0, 0), end, end], [a, b, c])


def _sign(x: int) -> int:
    return (x > 0) - (x < 0)
