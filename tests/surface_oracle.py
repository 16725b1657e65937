"""Independent truth about surfaces: do two placed triangle meshes collide, and how far apart are they?

Nothing here uses `loewner`. A mesh is vertices, faces, and whether what it winds around is solid; a pose is the
affine map that its doubles say. Compiled floating point settles what is beyond doubt by an error bound far above the
rounding, and whole numbers settle the rest: doubles are whole numbers once a power of two is taken out.

======================  ==============================================================================
`triangles_meet`        two triangles of whole numbers, segments and points among them, exactly
`squared_distance`      of the same, as a fraction
`Mesh`                  a mesh with a tree of boxes, its components, and whether it is closed
`collides`              whether placed meshes collide, for one pair and many poses
`contains`              whether placed points are on a mesh or where its winding number is not zero
`distance`              of two placed meshes' surfaces: every triangle against every other one
======================  ==============================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from math import isqrt
from typing import NamedTuple

import numba
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Point = tuple[int, int, int]
Triangle = tuple[Point, Point, Point]

EPS = float(np.finfo(float).eps)
# Answers of the compiled part.
APART, MEET, OPEN = 0, 1, 2
# How far the boxes of the tree are widened, as a share of the lengths involved: rounding is a ten-thousandth of it.
PAD = 1e-11
LEAF = 4
# Deep enough for two trees of 2**60 triangles, as halves are of equal size.
STACK = 512
# Directions of rays: no edge or face of a mesh that people make is along them.
RAYS = np.array(
    [[0.6123, 0.7361, 0.2887], [-0.3917, 0.5221, 0.7571], [0.8291, -0.1873, 0.5267], [-0.2713, -0.6647, 0.6959]]
)


# -- whole numbers -----------------------------------------------------------------------------


def _minus(p: Point, q: Point) -> Point:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def _cross(u: Point, v: Point) -> Point:
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


def _dot(u: Point, v: Point) -> int:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _sign(x: int) -> int:
    return (x > 0) - (x < 0)


def _volume(p: Point, q: Point, r: Point, s: Point) -> int:
    """Six times the signed volume of a tetrahedron."""
    return _dot(_minus(q, p), _cross(_minus(r, p), _minus(s, p)))


def _edges(t: Triangle) -> tuple[tuple[Point, Point], ...]:
    return (t[0], t[1]), (t[1], t[2]), (t[2], t[0])


def triangles_meet(s: Triangle, t: Triangle) -> bool:
    """Whether two triangles have a point in common; equal corners, and corners on a line, are allowed.

    Of two that meet, an edge of one meets the other: where they cross, their common segment ends at an edge of one;
    where one lies within the other, all its edges do.
    """
    return any(_edge_meets(p, q, t) for p, q in _edges(s)) or any(_edge_meets(p, q, s) for p, q in _edges(t))


def _edge_meets(p: Point, q: Point, t: Triangle) -> bool:
    """Whether the segment from p to q, or the point where they are equal, meets a triangle."""
    a, b, c = t
    n = _cross(_minus(b, a), _minus(c, a))
    if n == (0, 0, 0):
        return _segments_meet(p, q, *_longest(t))
    start, end = _sign(_dot(n, _minus(p, a))), _sign(_dot(n, _minus(q, a)))
    if start * end > 0:
        return False
    if start == end == 0:
        return _meet_in_plane(p, q, t, n)
    sides = {_sign(_volume(p, q, u, v)) for u, v in _edges(t)}
    return not {-1, 1} <= sides


def _longest(t: Triangle) -> tuple[Point, Point]:
    """The segment that a triangle of no area is."""
    return max(_edges(t), key=lambda e: _dot(_minus(*e), _minus(*e)))


def _meet_in_plane(p: Point, q: Point, t: Triangle, n: Point) -> bool:
    """The same in the plane of the triangle, whose normal is n: the coordinate along which n is longest is dropped."""
    drop = max(range(3), key=lambda k: abs(n[k]))
    i, j = (k for k in range(3) if k != drop)

    def turn(u: Point, v: Point, w: Point) -> int:
        return _sign((v[i] - u[i]) * (w[j] - u[j]) - (v[j] - u[j]) * (w[i] - u[i]))

    within = {turn(u, v, p) for u, v in _edges(t)}
    return not {-1, 1} <= within or any(_segments_meet(p, q, u, v) for u, v in _edges(t))


def _segments_meet(p: Point, q: Point, a: Point, b: Point) -> bool:
    """Whether two segments, points among them, have a point in common."""
    u, v, r = _minus(q, p), _minus(b, a), _minus(a, p)
    n = _cross(u, v)
    if n != (0, 0, 0):
        square = _dot(n, n)
        return _dot(r, n) == 0 and 0 <= _dot(_cross(r, v), n) <= square and 0 <= _dot(_cross(r, u), n) <= square
    along = u if u != (0, 0, 0) else v
    if _cross(r, along) != (0, 0, 0):
        return False
    if along == (0, 0, 0):
        return p == a
    (p0, p1), (a0, a1) = (sorted((_dot(x, along), _dot(y, along))) for x, y in ((p, q), (a, b)))
    return p0 <= a1 and a0 <= p1


def squared_distance(s: Triangle, t: Triangle) -> Fraction:
    """Square of the distance of two triangles, in the square of their unit."""
    if triangles_meet(s, t):
        return Fraction(0)
    corners = [_point_squared(p, u) for one, u in ((s, t), (t, s)) for p in one]
    crossed = [_crossed_squared(p, q, a, b) for p, q in _edges(s) for a, b in _edges(t)]
    return min(x for x in corners + crossed if x is not None)


def _point_squared(p: Point, t: Triangle) -> Fraction:
    """Square of the distance of a point from a triangle."""
    a, b, c = t
    n = _cross(_minus(b, a), _minus(c, a))
    if n != (0, 0, 0) and all(_dot(_cross(_minus(v, u), _minus(p, u)), n) >= 0 for u, v in _edges(t)):
        return Fraction(_dot(n, _minus(p, a)) ** 2, _dot(n, n))
    return min(_point_segment_squared(p, u, v) for u, v in _edges(t))


def _point_segment_squared(p: Point, a: Point, b: Point) -> Fraction:
    u, r = _minus(b, a), _minus(p, a)
    along, length = _dot(u, r), _dot(u, u)
    if along <= 0:
        return Fraction(_dot(r, r))
    if along >= length:
        return Fraction(_dot(_minus(p, b), _minus(p, b)))
    return Fraction(_dot(r, r)) - Fraction(along * along, length)


def _crossed_squared(p: Point, q: Point, a: Point, b: Point) -> Fraction | None:
    """Square of the distance of two segments that are nearest within both; None if they are nearest at an end."""
    u, v, r = _minus(q, p), _minus(b, a), _minus(a, p)
    n = _cross(u, v)
    square = _dot(n, n)
    if square and 0 <= _dot(_cross(r, v), n) <= square and 0 <= _dot(_cross(r, u), n) <= square:
        return Fraction(_dot(r, n) ** 2, square)
    return None


def whole(values: Sequence[float]) -> tuple[list[int], int]:
    """Doubles as whole numbers, times two to the power that comes with them."""
    ratios = [float(x).as_integer_ratio() for x in values]
    shift = max((d.bit_length() - 1 for _, d in ratios), default=0)
    return [n << (shift - d.bit_length() + 1) for n, d in ratios], -shift


class Placed:
    """Vertices of two meshes, each at its pose, as points of whole numbers in one unit: two to the power `exponent`."""

    def __init__(self, meshes: Sequence[Mesh], poses: Sequence[np.ndarray]) -> None:
        self._meshes = meshes
        self._rotation, self._translation, exponents = [], [], []
        for mesh, T in zip(meshes, poses, strict=True):
            R, turned = whole(np.asarray(T, float)[:3, :3].ravel())
            t, moved = whole(np.asarray(T, float)[:3, 3])
            exponents.append((turned + mesh.exponent, moved))
            self._rotation.append(R)
            self._translation.append(t)
        self.exponent = min(min(e) for e in exponents)
        self._up = [(a - self.exponent, b - self.exponent) for a, b in exponents]
        self._known: tuple[dict[int, Point], ...] = tuple({} for _ in meshes)

    def vertex(self, side: int, k: int) -> Point:
        known = self._known[side]
        if k not in known:
            (x, y, z), _ = whole_at(self._meshes[side].vertices[k], self._meshes[side].exponent)
            known[k] = self._moved(side, x, y, z, 1)
        return known[k]

    def _moved(self, side: int, x: int, y: int, z: int, shifted: int) -> Point:
        R, t, (up, up_t) = self._rotation[side], self._translation[side], self._up[side]
        a, b, c = (
            ((R[3 * i] * x + R[3 * i + 1] * y + R[3 * i + 2] * z) << up) + shifted * (t[i] << up_t) for i in range(3)
        )
        return a, b, c

    def turned(self, side: int, direction: Point) -> Point:
        """A direction of a mesh's own frame, in the world; of any length."""
        return self._moved(side, *direction, 0)

    def triangle(self, side: int, face: int) -> Triangle:
        i, j, k = (int(v) for v in self._meshes[side].faces[face])
        return self.vertex(side, i), self.vertex(side, j), self.vertex(side, k)


def whole_at(values: np.ndarray, exponent: int) -> tuple[list[int], int]:
    """Doubles as whole numbers of a unit that divides them all."""
    numbers = []
    for x in values:
        n, d = float(x).as_integer_ratio()
        numbers.append(n << (-exponent - d.bit_length() + 1))
    return numbers, exponent


# -- meshes ------------------------------------------------------------------------------------


class Tree(NamedTuple):
    """What the compiled part sees of a mesh: triangles in the order of a tree of boxes."""

    corners: np.ndarray  # (faces, 3, 3)
    faces: np.ndarray  # (faces,): their numbers in the mesh
    low: np.ndarray  # (nodes, 3)
    high: np.ndarray  # (nodes, 3)
    first: np.ndarray  # (nodes,): of its triangles
    last: np.ndarray  # (nodes,): past them
    right: np.ndarray  # (nodes,): the left child comes next; 0 for a leaf
    seeds: np.ndarray  # (components, 3): a vertex of each
    solid: bool


class Mesh:
    """A triangle mesh; `solid` says whether what it winds around is, None that it is if the mesh is closed."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, solid: bool | None = None) -> None:
        self.vertices = np.ascontiguousarray(vertices, float).reshape(-1, 3)
        self.faces = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
        _, self.exponent = whole(self.vertices.ravel())
        welded = np.unique(self.vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)[self.faces]
        start, end = welded.ravel(), np.roll(welded, -1, axis=1).ravel()
        size = int(welded.max()) + 1
        directed = coo_matrix((np.ones(len(start)), (start, end)), shape=(size, size)).tocsr()
        # Every edge as often forth as back: then the winding number is the same wherever the ray goes.
        self.closed = abs(directed - directed.T).max() == 0
        self.solid = self.closed if solid is None else solid
        assert self.closed or not self.solid, "no winding number around an open mesh"
        label = connected_components(directed, directed=False)[1][welded[:, 0]]
        seeds = np.unique(label, return_index=True)[1]
        self.seeds = self.faces[seeds, 0]
        self.size = float(np.linalg.norm(np.ptp(self.vertices[np.unique(self.faces)], axis=0)))
        self.tree = self._tree()

    def _tree(self) -> Tree:
        corners = self.vertices[self.faces]
        low, high = corners.min(axis=1), corners.max(axis=1)
        middle = (low + high) / 2
        order = np.arange(len(corners))
        nodes: list[tuple[int, int, int]] = []
        boxes: list[tuple[np.ndarray, np.ndarray]] = []

        def grow(first: int, last: int) -> None:
            node, part = len(nodes), order[first:last]
            nodes.append((first, last, 0))
            boxes.append((low[part].min(axis=0), high[part].max(axis=0)))
            if last - first > LEAF:
                axis = int(np.argmax(np.ptp(middle[part], axis=0)))
                half = (last - first) // 2
                order[first:last] = part[np.argpartition(middle[part, axis], half)]
                grow(first, first + half)
                nodes[node] = first, last, len(nodes)
                grow(first + half, last)

        grow(0, len(corners))
        table = np.array(nodes, np.int64)
        bottom, top = (np.ascontiguousarray([box[k] for box in boxes]) for k in range(2))
        first, last, right = (np.ascontiguousarray(table[:, k]) for k in range(3))
        return Tree(
            np.ascontiguousarray(corners[order]), order, bottom, top, first, last, right,
            self.vertices[self.seeds], bool(self.solid),
        )  # fmt: skip


# -- compiled: beyond doubt, or open ------------------------------------------------------------


@numba.njit(cache=True, error_model="numpy")
def _cross3(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, error_model="numpy")
def _dot3(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, error_model="numpy")
def _parted(n, P, Q, slack):
    """Whether a plane across n lies between two triangles, whatever rounding did to them."""
    p0, p1, p2 = _dot3(n, P[0]), _dot3(n, P[1]), _dot3(n, P[2])
    q0, q1, q2 = _dot3(n, Q[0]), _dot3(n, Q[1]), _dot3(n, Q[2])
    gap = max(min(q0, q1, q2) - max(p0, p1, p2), min(p0, p1, p2) - max(q0, q1, q2))
    return gap > slack * (abs(n[0]) + abs(n[1]) + abs(n[2]))


@numba.njit(cache=True, error_model="numpy")
def _pierces(a, b, Q, doubt, work):
    """Whether the segment from a to b crosses the inside of a triangle beyond doubt."""
    u, v, w, n = work[0], work[1], work[2], work[3]
    for k in range(3):
        u[k], v[k] = Q[1, k] - Q[0, k], Q[2, k] - Q[0, k]
    _cross3(u, v, n)
    for k in range(3):
        u[k], v[k] = a[k] - Q[0, k], b[k] - Q[0, k]
    da, db = _dot3(n, u), _dot3(n, v)
    if not (min(da, db) < -doubt and max(da, db) > doubt):
        return False
    for k in range(3):
        w[k] = b[k] - a[k]
    least, most = np.inf, -np.inf
    for i in range(3):
        j = (i + 1) % 3
        for k in range(3):
            u[k], v[k] = Q[i, k] - a[k], Q[j, k] - a[k]
        _cross3(u, v, n)
        volume = _dot3(w, n)
        least, most = min(least, volume), max(most, volume)
    return least > doubt or most < -doubt


@numba.njit(cache=True, error_model="numpy")
def _judge(P, Q, err, work):
    """Whether two triangles meet, whose corners are known to `err` in each coordinate: APART, MEET or OPEN."""
    L = 0.0
    for k in range(3):
        origin = P[0, k]
        for i in range(3):
            P[i, k] -= origin
            Q[i, k] -= origin
            L = max(L, abs(P[i, k]), abs(Q[i, k]))
    slack = 8 * err + 32 * EPS * L
    n, u, v, m = work[4], work[5], work[6], work[7]
    for k in range(3):
        n[0] = n[1] = n[2] = 0.0
        n[k] = 1.0
        if _parted(n, P, Q, slack):
            return APART
    for k in range(3):
        u[k], v[k] = P[1, k] - P[0, k], P[2, k] - P[0, k]
    _cross3(u, v, n)
    if _parted(n, P, Q, slack):
        return APART
    for k in range(3):
        u[k], v[k] = Q[1, k] - Q[0, k], Q[2, k] - Q[0, k]
    _cross3(u, v, m)
    if _parted(m, P, Q, slack):
        return APART
    w = work[8]
    for i in range(3):
        for k in range(3):
            u[k] = P[(i + 1) % 3, k] - P[i, k]
        _cross3(n, u, w)
        if _parted(w, P, Q, slack):
            return APART
        for j in range(3):
            for k in range(3):
                v[k] = Q[(j + 1) % 3, k] - Q[j, k]
            _cross3(u, v, w)
            if _parted(w, P, Q, slack):
                return APART
            if i == 0:
                _cross3(m, v, w)
                if _parted(w, P, Q, slack):
                    return APART
    doubt = 1000 * (L * L * err + EPS * L * L * L)
    for i in range(3):
        if _pierces(P[i], P[(i + 1) % 3], Q, doubt, work) or _pierces(Q[i], Q[(i + 1) % 3], P, doubt, work):
            return MEET
    return OPEN


@numba.njit(cache=True, error_model="numpy")
def _place3(T, p, out):
    for i in range(3):
        out[i] = T[i, 0] * p[0] + T[i, 1] * p[1] + T[i, 2] * p[2] + T[i, 3]


@numba.njit(cache=True, error_model="numpy")
def _inverse(T):
    """Of the upper left three by three: by cofactors, which Numba compiles in a tenth of the time of LAPACK's."""
    M = np.empty((3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for c in range(3):
            d, e = (c + 1) % 3, (c + 2) % 3
            M[c, i] = T[j, d] * T[k, e] - T[j, e] * T[k, d]
    det = T[0, 0] * M[0, 0] + T[0, 1] * M[1, 0] + T[0, 2] * M[2, 0]
    for i in range(3):
        for c in range(3):
            M[i, c] /= det
    return M


@numba.njit(cache=True, error_model="numpy")
def _relative(Ta, Tb, X):
    """X = the map from b's frame to that of a."""
    M = _inverse(Ta)
    for i in range(3):
        for j in range(3):
            X[i, j] = M[i, 0] * Tb[0, j] + M[i, 1] * Tb[1, j] + M[i, 2] * Tb[2, j]
        X[i, 3] = 0.0
        for k in range(3):
            X[i, 3] += M[i, k] * (Tb[k, 3] - Ta[k, 3])


@numba.njit(cache=True, error_model="numpy")
def _boxes_apart(low_a, high_a, low_b, high_b, X, pad):
    """Whether the box around b's box at X lies beside a's box."""
    for i in range(3):
        center, half = X[i, 3] - 0.5 * (low_a[i] + high_a[i]), 0.5 * (high_a[i] - low_a[i])
        for k in range(3):
            center += X[i, k] * 0.5 * (low_b[k] + high_b[k])
            half += abs(X[i, k]) * 0.5 * (high_b[k] - low_b[k])
        if abs(center) > half + pad:
            return True
    return False


@numba.njit(cache=True, error_model="numpy")
def _largest(tree):
    most = 0.0
    for k in range(3):
        most = max(most, abs(tree.low[0, k]), abs(tree.high[0, k]))
    return most


@numba.njit(cache=True, error_model="numpy")
def _surfaces(a, Ta, b, Tb, every, found, work, stack):
    """Whether two surfaces meet: APART, MEET, or OPEN with the pairs of triangles in doubt in `found`.

    With `every`, pairs that meet are listed as well. Returns the answer and how many are listed.
    """
    X, Y = work[9:12], work[12:15]
    _relative(Ta, Tb, X)
    _relative(Tb, Ta, Y)
    scale = _largest(a) + _largest(b)
    for i in range(3):
        scale = max(scale, 2 * (_largest(a) + _largest(b)) + abs(Ta[i, 3]) + abs(Tb[i, 3]))
    pad, err = PAD * scale, 16 * EPS * scale
    P, Q = work[15:18, :3], work[18:21, :3]
    top, count, doubtful, seen = 1, 0, 0, APART
    stack[0, 0] = stack[0, 1] = 0
    while top > 0:
        top -= 1
        i, j = stack[top, 0], stack[top, 1]
        if _boxes_apart(a.low[i], a.high[i], b.low[j], b.high[j], X, pad):
            continue
        if _boxes_apart(b.low[j], b.high[j], a.low[i], a.high[i], Y, pad):
            continue
        if a.right[i] == 0 and b.right[j] == 0:
            for s in range(a.first[i], a.last[i]):
                for t in range(b.first[j], b.last[j]):
                    for k in range(3):
                        _place3(Ta, a.corners[s, k], P[k])
                        _place3(Tb, b.corners[t, k], Q[k])
                    answer = _judge(P, Q, err, work)
                    if answer == MEET and not every:
                        return MEET, 0
                    if answer != APART:
                        seen = MEET if answer == MEET else seen
                        doubtful += answer == OPEN
                        if count < len(found):
                            found[count, 0], found[count, 1] = a.faces[s], b.faces[t]
                        count += 1
            continue
        size_a, size_b = 0.0, 0.0
        for k in range(3):
            size_a = max(size_a, a.high[i, k] - a.low[i, k])
            size_b = max(size_b, b.high[j, k] - b.low[j, k])
        if b.right[j] == 0 or (a.right[i] != 0 and size_a > size_b):
            stack[top, 0], stack[top, 1] = a.right[i], j
            stack[top + 1, 0], stack[top + 1, 1] = i + 1, j
        else:
            stack[top, 0], stack[top, 1] = i, b.right[j]
            stack[top + 1, 0], stack[top + 1, 1] = i, j + 1
        top += 2
    if seen == MEET:
        return MEET, count
    return (OPEN if doubtful else APART), count


@numba.njit(cache=True, error_model="numpy")
def _crossings(mesh, x, err, d, found, work, stack):
    """Signed crossings of a ray from x, which is known to `err`, along d; and the triangles in doubt."""
    top, total, count = 1, 0, 0
    stack[0, 0] = 0
    n, V = work[0], work[15:18, :3]
    pad = 2 * err + PAD * (_largest(mesh) + abs(x[0]) + abs(x[1]) + abs(x[2]))
    while top > 0:
        top -= 1
        i = stack[top, 0]
        near, far = 0.0, np.inf
        for k in range(3):
            one, two = (mesh.low[i, k] - pad - x[k]) / d[k], (mesh.high[i, k] + pad - x[k]) / d[k]
            near, far = max(near, min(one, two)), min(far, max(one, two))
        # Rounding of these quotients is far below the padding over the smallest entry of a direction.
        if near > far:
            continue
        if mesh.right[i] != 0:
            stack[top, 0], stack[top + 1, 0] = mesh.right[i], i + 1
            top += 2
            continue
        for s in range(mesh.first[i], mesh.last[i]):
            L = 0.0
            for c in range(3):
                for k in range(3):
                    V[c, k] = mesh.corners[s, c, k] - x[k]
                    L = max(L, abs(V[c, k]))
            area = 50 * (L * err + EPS * L * L)
            least, most, flat = np.inf, -np.inf, 0.0
            for c in range(3):
                _cross3(V[c], V[(c + 1) % 3], n)
                side = _dot3(d, n)
                least, most = min(least, side), max(most, side)
                if c == 0:
                    flat = _dot3(n, V[2])
            if most > area and least < -area:
                continue
            doubt = 1000 * (L * L * err + EPS * L * L * L)
            if abs(flat) > doubt and (least > area or most < -area):
                if (flat > 0) == (least > area):
                    total += 1 if least > area else -1
                continue
            if count < len(found):
                found[count, 0] = mesh.faces[s]
            count += 1
    return total, count


@numba.njit(cache=True, error_model="numpy")
def _own_frame(T, x, mesh, out):
    """A point of the world in a mesh's own frame; returns a bound on its error."""
    M = _inverse(T)
    most = 2 * _largest(mesh)
    for k in range(3):
        most += abs(x[k]) + abs(T[k, 3])
    for i in range(3):
        out[i] = 0.0
        for k in range(3):
            out[i] += M[i, k] * (x[k] - T[k, 3])
    return 256 * EPS * most


@numba.njit(cache=True, error_model="numpy")
def _within(a, Ta, b, Tb, found, work, stack):
    """Whether a component of a lies where b's winding number is not zero; the surfaces are apart."""
    if not b.solid:
        return APART
    x, y = work[21], work[22]
    answer = APART
    for s in range(len(a.seeds)):
        _place3(Ta, a.seeds[s], x)
        err = _own_frame(Tb, x, b, y)
        outside = False
        for k in range(3):
            outside |= y[k] < b.low[0, k] - 2 * err or y[k] > b.high[0, k] + 2 * err
        if outside:
            continue
        known = False
        for r in range(len(RAYS)):
            total, count = _crossings(b, y, err, RAYS[r], found, work, stack)
            if count == 0:
                known = True
                if total != 0:
                    return MEET
                break
        if not known:
            answer = OPEN
    return answer


@numba.njit(cache=True, error_model="numpy")
def _settle(a, Ts_a, b, Ts_b, out):
    work, stack, found = np.empty((24, 4)), np.empty((STACK, 2), np.int64), np.empty((1, 2), np.int64)
    for n in range(len(out)):
        Ta, Tb = Ts_a[min(n, len(Ts_a) - 1)], Ts_b[min(n, len(Ts_b) - 1)]
        answer, _ = _surfaces(a, Ta, b, Tb, False, found, work, stack)
        if answer == APART:
            one = _within(a, Ta, b, Tb, found, work, stack)
            two = _within(b, Tb, a, Ta, found, work, stack) if one != MEET else APART
            answer = max(one, two) if MEET not in (one, two) else MEET
        out[n] = answer


# -- answers -----------------------------------------------------------------------------------


def collides(
    a: Mesh, Ta: np.ndarray, b: Mesh, Tb: np.ndarray, *, count: Callable[[int], object] | None = None
) -> np.ndarray:
    """Whether two meshes collide, one pose of each or as many of both; shape (n,). Touching is colliding.

    `count`, if given, is told how many poses needed whole numbers.
    """
    Ts_a, Ts_b = (np.ascontiguousarray(T, float).reshape(-1, 4, 4) for T in (Ta, Tb))
    out = np.empty(max(len(Ts_a), len(Ts_b)), np.int8)
    _settle(a.tree, Ts_a, b.tree, Ts_b, out)
    doubtful = np.flatnonzero(out == OPEN)
    for n in doubtful:
        out[n] = collides_exactly(a, Ts_a[min(n, len(Ts_a) - 1)], b, Ts_b[min(n, len(Ts_b) - 1)])
    if count is not None:
        count(len(doubtful))
    return out == MEET


def collides_exactly(a: Mesh, Ta: np.ndarray, b: Mesh, Tb: np.ndarray) -> bool:
    """The same for one pose; whole numbers decide every pair of triangles and every crossing that is in doubt."""
    placed = Placed((a, b), (Ta, Tb))
    answer, pairs = _listed(_surfaces, a.tree, Ta, b.tree, Tb, False)
    if answer == MEET or any(triangles_meet(placed.triangle(0, s), placed.triangle(1, t)) for s, t in pairs):
        return True
    return any(
        b_mesh.solid and any(_winding(placed, side, int(seed), b_mesh, T_own, T) != 0 for seed in a_mesh.seeds)
        for side, a_mesh, T_own, b_mesh, T in ((0, a, Ta, b, Tb), (1, b, Tb, a, Ta))
    )


def _listed(function: Callable, *arguments: object) -> tuple[int, np.ndarray]:
    """What a compiled function answers, and its whole list, however long."""
    work, stack = np.empty((24, 4)), np.empty((STACK, 2), np.int64)
    found = np.empty((64, 2), np.int64)
    answer, count = function(*arguments, found, work, stack)
    if count > len(found):
        found = np.empty((count, 2), np.int64)
        answer, count = function(*arguments, found, work, stack)
    return answer, found[:count].copy()


def _directions() -> Iterator[Point]:
    """Directions in whole numbers, as many as it takes: the first are those of the compiled rays, about."""
    for ray in RAYS:
        yield tuple(int(1024 * x) for x in ray)
    rng = np.random.default_rng(0)
    while True:
        yield tuple(int(x) for x in rng.integers(1, 1 << 20, 3) * rng.choice([-1, 1], 3))


def _winding(placed: Placed, side: int, seed: int, mesh: Mesh, T_own: np.ndarray, T: np.ndarray) -> int:
    """Winding number of the other mesh around a vertex of one that is not on it, up to its sign."""
    x, y, work = np.empty(3), np.empty(3), np.ascontiguousarray(T, float)
    _place3(np.ascontiguousarray(T_own, float), placed._meshes[side].vertices[seed], x)
    err = _own_frame(work, x, mesh.tree, y)
    start = placed.vertex(side, seed)
    for direction in _directions():
        total, faces = _listed(_crossings, mesh.tree, y, err, np.array(direction, float) / 2.0**20)
        along = placed.turned(1 - side, direction)
        crossings = [_crossing(start, along, placed.triangle(1 - side, int(f))) for f in faces[:, 0]]
        if None not in crossings:
            return total + sum(crossings)
    raise AssertionError("there is always another direction")


def _crossing(x: Point, d: Point, t: Triangle) -> int | None:
    """Sign of a ray's crossing of a triangle, 0 if it misses it, None if it meets an edge or runs along it.

    The ray starts on no triangle.
    """
    v = [_minus(p, x) for p in t]
    n = _cross(_minus(t[1], t[0]), _minus(t[2], t[0]))
    if n == (0, 0, 0):  # it has no area, so turning the ray a little decides: it is not crossed
        return 0 if _ray_misses(x, d, t) else None
    sides = [_sign(_dot(d, _cross(v[i], v[(i + 1) % 3]))) for i in range(3)]
    if {-1, 1} <= set(sides):
        return 0
    if 0 in sides:
        return 0 if any(sides) and _behind(d, v, n) else None
    return sides[0] if _sign(_dot(v[0], n)) == sides[0] else 0


def _behind(d: Point, v: Sequence[Point], n: Point) -> bool:
    """Whether the plane with normal n is crossed behind the start of the ray."""
    return _sign(_dot(v[0], n)) * _sign(_dot(d, n)) < 0


def _ray_misses(x: Point, d: Point, t: Triangle) -> bool:
    """Whether the line of a ray misses the segment that a triangle of no area is."""
    a, b = (_minus(p, x) for p in _longest(t))
    if _dot(d, _cross(a, b)) != 0:
        return True
    one, two = _cross(d, a), _cross(d, b)
    return (one != (0, 0, 0) or two != (0, 0, 0)) and _dot(one, two) > 0


def contains(mesh: Mesh, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether points of the world are on a placed mesh, or where its winding number is not zero if it is solid."""
    points = np.asarray(points, float).reshape(-1, 3)
    return np.array([bool(collides(mesh, T, Mesh(p, [[0, 0, 0]], False), np.eye(4))[0]) for p in points])


@numba.njit(cache=True, error_model="numpy")
def _segment_point(p, a, b, out):
    """Square of the distance of p from a segment, and the nearest point."""
    along, length = 0.0, 0.0
    for k in range(3):
        along += (p[k] - a[k]) * (b[k] - a[k])
        length += (b[k] - a[k]) * (b[k] - a[k])
    s = min(1.0, max(0.0, along / length)) if length > 0 else 0.0
    square = 0.0
    for k in range(3):
        out[k] = a[k] + s * (b[k] - a[k])
        square += (p[k] - out[k]) ** 2
    return square


@numba.njit(cache=True, error_model="numpy")
def _triangle_point(p, Q, out, work):
    """Square of the distance of p from a triangle."""
    u, v, n, w = work[0], work[1], work[2], work[3]
    best = np.inf
    for i in range(3):
        best = min(best, _segment_point(p, Q[i], Q[(i + 1) % 3], out))
    for k in range(3):
        u[k], v[k] = Q[1, k] - Q[0, k], Q[2, k] - Q[0, k]
    _cross3(u, v, n)
    square = _dot3(n, n)
    if square > 0:
        for i in range(3):
            for k in range(3):
                u[k], v[k] = Q[(i + 1) % 3, k] - Q[i, k], p[k] - Q[i, k]
            _cross3(u, v, w)
            if _dot3(w, n) < 0:
                return best
        for k in range(3):
            u[k] = p[k] - Q[0, k]
        best = min(best, _dot3(u, n) ** 2 / square)
    return best


@numba.njit(cache=True, error_model="numpy")
def _near_triangles(P, Q, work):
    """Square of the distance of two triangles that do not cross, about."""
    best = np.inf
    out = work[8]
    for i in range(3):
        best = min(best, _triangle_point(P[i], Q, out, work), _triangle_point(Q[i], P, out, work))
    u, v, r, n, w = work[0], work[1], work[2], work[3], work[4]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                u[k], v[k] = P[(i + 1) % 3, k] - P[i, k], Q[(j + 1) % 3, k] - Q[j, k]
                r[k] = Q[j, k] - P[i, k]
            _cross3(u, v, n)
            square = _dot3(n, n)
            if square > 0:
                _cross3(r, v, w)
                s = _dot3(w, n)
                _cross3(r, u, w)
                t = _dot3(w, n)
                if 0 <= s <= square and 0 <= t <= square:
                    best = min(best, _dot3(r, n) ** 2 / square)
    return best


@numba.njit(cache=True, error_model="numpy")
def _squares(A, B, out):
    """Squares of the distances of all triangles of one mesh from all of another, about; 0 where they cross.

    Infinite where their boxes show that others are nearer.
    """
    work = np.empty((24, 4))
    P, Q = np.empty((3, 3)), np.empty((3, 3))
    best = np.inf
    for i in range(len(A)):
        for j in range(len(B)):
            apart = 0.0
            for k in range(3):
                low_a, high_a = min(A[i, 0, k], A[i, 1, k], A[i, 2, k]), max(A[i, 0, k], A[i, 1, k], A[i, 2, k])
                low_b, high_b = min(B[j, 0, k], B[j, 1, k], B[j, 2, k]), max(B[j, 0, k], B[j, 1, k], B[j, 2, k])
                apart += max(0.0, low_b - high_a, low_a - high_b) ** 2
            out[i, j] = np.inf
            if apart > best * (1 + 1e-6):
                continue
            out[i, j] = _near_triangles(A[i], B[j], work)
            for c in range(3):
                for k in range(3):
                    P[c, k], Q[c, k] = A[i, c, k], B[j, c, k]
            if apart == 0 and _judge(P, Q, 0.0, work) == MEET:
                out[i, j] = 0.0
            best = min(best, out[i, j])


def distance(a: Mesh, Ta: np.ndarray, b: Mesh, Tb: np.ndarray) -> float:
    """Distance of two placed surfaces, correct to the last digits; 0 if they meet. For small meshes.

    All pairs of triangles in floating point; those that can be nearest are measured in whole numbers.
    """
    A, B = (m.vertices[m.faces] @ T[:3, :3].T + T[:3, 3] for m, T in ((a, Ta), (b, Tb)))
    squares = np.empty((len(A), len(B)))
    _squares(np.ascontiguousarray(A), np.ascontiguousarray(B), squares)
    lengths = max(np.abs(A).max(), np.abs(B).max())
    limit = (np.sqrt(squares.min()) * (1 + 1e-9) + 1e-12 * lengths) ** 2
    near = np.argwhere(squares <= limit)
    placed = Placed((a, b), (Ta, Tb))
    if len(near) > 2000:  # equal ones, mostly: the first of them are as good
        near = near[np.argsort(squares[tuple(near.T)], kind="stable")[:2000]]
    best = min(squared_distance(placed.triangle(0, int(s)), placed.triangle(1, int(t))) for s, t in near)
    return root(best * Fraction(2) ** (2 * placed.exponent))


@numba.njit(cache=True, error_model="numpy")
def _nearest(points, corners, out):
    work = np.empty((24, 4))
    for n in range(len(points)):
        best = np.inf
        for t in range(len(corners)):
            best = min(best, _triangle_point(points[n], corners[t], work[8], work))
        out[n] = np.sqrt(best)


def distances_of_points(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Distances of points from a surface, in its own frame, in floating point."""
    out = np.empty(len(points))
    _nearest(np.ascontiguousarray(points), mesh.tree.corners, out)
    return out


def root(square: Fraction) -> float:
    """Square root to the last digit."""
    if square == 0:
        return 0.0
    places = max(0, 128 - (square.numerator.bit_length() - square.denominator.bit_length()))
    places += places % 2
    low = isqrt((square.numerator << places) // square.denominator)
    return float(Fraction(low, 1 << (places // 2)))


def boundary(
    mesh: Mesh, T: np.ndarray, other: Mesh, T_other: np.ndarray, way: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Two poses of `other` less than `tolerance` apart: it collides at the first and is free at the second.

    From its pose, which has to collide, it goes along `way` to its end, which has to be free: else None. With a
    tolerance of 0 they are as near as doubles along the way can be.
    """

    def at(s: float) -> np.ndarray:
        moved = T_other.copy()
        moved[:3, 3] = T_other[:3, 3] + s * way
        return moved

    if not collides(mesh, T, other, at(0.0))[0] or collides(mesh, T, other, at(1.0))[0]:
        return None
    low, high, length = 0.0, 1.0, float(np.linalg.norm(way))
    while (high - low) * length > tolerance:
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if collides(mesh, T, other, at(middle))[0]:
            low = middle
        else:
            high = middle
    return at(low), at(high)
