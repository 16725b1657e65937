"""Code shared by the readers of all formats: refuse files, cut polygons into triangles, join and place meshes."""

import math
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from loewner._base._matrices import image
from loewner._base._validate import Floats, Ints

Triangles = Ints

# Limit on the vertices, and on the triangles, of a mesh; a file of 2 GiB holds about this number. The limit is needed
# because a short file can use the same vertices a million times.
MOST = 50_000_000


# Limit on the corners of a polygon that is cut ear by ear, since the time grows with the square of their number.
MOST_CORNERS = 10_000

# Number of polygon corners examined at a time; a larger number takes more memory and no less time.
_TOGETHER = 1 << 17

# Number of corners about which fans are tried before a polygon is cut ear by ear.
_TRIES = 8

# In a polygon of extent 1, rounding may reverse a triangle if twice its area is below this number.
_ROUNDING = 1e-12

# A corner this close to a line, relative to the coordinates, may lie on the line, since coordinates in files have at
# most seven digits.
_NOISE = 1e-6

# A function by which readers report doubtful content; it takes a text and the place in the file.
Tell = Callable[[str, str], None]

_NO_PLANE = (
    "expected flat polygons that do not cross themselves, found one that has no triangulation; it is read as the "
    "triangles about its first corner, which contain it and may contain more"
)


class Refusal(Exception):
    """The reason why a file is refused, and the line if it is known."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


def expect(holds: object, message: str, line: int | None = None) -> None:
    """Refuse the file unless `holds` is true."""
    if not holds:
        raise Refusal(message, line)


def quoted(token: bytes | str) -> str:
    """Make a part of a file printable and short, for a message."""
    text = token.decode("latin-1") if isinstance(token, bytes) else token
    return ascii(text if len(text) <= 40 else text[:40] + "...")


def fans(corners: Ints, sizes: Ints) -> Triangles:
    """Cut polygons, whose corners are concatenated in `corners`, into fans of triangles about their first corners."""
    count = sizes - 2
    expect(count.sum() <= MOST, f"expected at most {MOST} triangles, found {count.sum()}")
    first = np.repeat(np.cumsum(sizes) - sizes, count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)


def cut(vertices: Floats, corners: Ints, sizes: Ints, tell: Tell, place: Callable[[int], str]) -> Triangles:
    """Cut polygons into triangles, in order: a fan about the first corner, unless the fan leaves the polygon.

    The triangles of a polygon together have the boundary of the polygon, and all face the same side. The triangles
    therefore form the polygon and cover each of its points once, however they were found. A polygon for which no such
    triangles are found keeps its fan, whose triangles contain the polygon.

    Parameters
    ----------
    vertices : ndarray, shape (v, 3)
    corners, sizes : ndarray of int
        The corners of all polygons, concatenated, and the number of corners of each.
    place : callable
        Called with the number of a polygon; returns the polygon's place in the file.
    """
    triangles = fans(corners, sizes)
    if sizes.max(initial=3) == 3:
        return triangles
    starts = np.cumsum(sizes) - sizes
    x, y, z = vertices.T.copy()
    for n in np.unique(sizes[sizes > 3]).tolist():
        same = np.flatnonzero(sizes == n)
        step = max(_TOGETHER // n, 1)
        for some in (same[k : k + step] for k in range(0, len(same), step)):
            rings = corners[starts[some] + np.arange(n)[:, None]]
            doubtful = np.flatnonzero(_may_leave(x[rings], y[rings], z[rings]))
            ring_triangles, uncut = _cut_rings(vertices[rings[:, doubtful].T])
            which = some[doubtful]  # a polygon of n corners has n - 2 triangles
            triangles[(starts - 2 * np.arange(len(sizes)))[which, None] + np.arange(n - 2)] = rings[
                ring_triangles, doubtful[:, None, None]
            ]
            for k in uncut:
                tell(_NO_PLANE, place(int(which[k])))
    return triangles


def _may_leave(x: Floats, y: Floats, z: Floats) -> NDArray[np.bool_]:
    """Return whether triangles of a polygon's fan may face opposite sides; coordinates have the shape (n, polygons)."""
    x, y, z = x[1:] - x[0], y[1:] - y[0], z[1:] - z[0]
    a, b, c = y[:-1] * z[1:] - z[:-1] * y[1:], z[:-1] * x[1:] - x[:-1] * z[1:], x[:-1] * y[1:] - y[:-1] * x[1:]
    facing = a * a.sum(axis=0) + b * b.sum(axis=0) + c * c.sum(axis=0)
    leaves: NDArray[np.bool_] = ~(facing.min(axis=0) > 0)
    return leaves


def _cut_rings(P: Floats) -> tuple[Ints, list[int]]:
    """Cut polygons, shape (polygons, n, 3).

    Returns
    -------
    triangles : ndarray of int, shape (polygons, n - 2, 3)
        Triangles, as numbers of corners.
    uncut : list of int
        The polygons for which no triangles were found except the fan about the first corner.
    """
    n = P.shape[1]
    fan = fans(np.arange(n), np.array([n]))
    triangles, uncut = np.tile(fan, (len(P), 1, 1)), []
    waiting = np.flatnonzero(np.isfinite(P).all(axis=(1, 2)))  # the other polygons are refused later
    size, flat = abs(P[waiting]).max(axis=(1, 2)), _in_plane(P[waiting] - P[waiting, :1])
    extent = abs(flat).max(axis=(1, 2))
    extent[extent == 0] = 1
    flat /= extent[:, None, None]
    left = np.arange(len(waiting))
    for k in range(min(n, _TRIES)):
        turned = (np.arange(n) + k) % n
        x, y = np.moveaxis(flat[left][:, turned] - flat[left, k : k + 1], 2, 0)
        within = (x[:, 1:-1] * y[:, 2:] - y[:, 1:-1] * x[:, 2:] >= -_ROUNDING).all(axis=1)
        triangles[waiting[left[within]]] = turned[fan]
        left = left[~within]
    expect(n <= MOST_CORNERS or not len(left), f"expected polygons with notches of {MOST_CORNERS} corners, found {n}")
    for i in left:
        ears = _ears(flat[i, :, 0], flat[i, :, 1], _NOISE * size[i] / extent[i])
        if ears is None:
            uncut.append(int(waiting[i]))
        else:
            triangles[waiting[i]] = ears
    return triangles, uncut


def _in_plane(P: Floats) -> Floats:
    """Drop a coordinate of polygons that begin at the origin; in the result, shape (polygons, n, 2), they turn left.

    Straight edges stay exactly straight, unlike in a projection along the normal.
    """
    unit = abs(P).max(axis=(1, 2))
    unit[unit == 0] = 1
    normals = np.cross(P[:, 1:-1] / unit[:, None, None], P[:, 2:] / unit[:, None, None])
    axis = abs(normals).sum(axis=1).argmax(axis=1)
    every = np.arange(len(P))
    turns_right = normals.sum(axis=1)[every, axis] < 0
    one, two = (axis + 1) % 3, (axis + 2) % 3
    one, two = np.where(turns_right, two, one), np.where(turns_right, one, two)
    return np.stack([P[every, :, one], P[every, :, two]], axis=2)


def _ears(x: Floats, y: Floats, noise: float) -> Ints | None:
    """Cut ears off a polygon that turns left until nothing is left of it; None if at some point no ear is found.

    A corner that lies on a line with its neighbours, to within the noise, is cut off only if there is no other ear.
    """
    X, Y, n = x.tolist(), y.tolist(), len(x)
    after, before = [*range(1, n), 0], [n - 1, *range(n - 1)]

    def area(a: int, b: int, c: int) -> float:
        """Return twice the area of a triangle, negative if it turns right."""
        twice: float = (X[b] - X[a]) * (Y[c] - Y[a]) - (Y[b] - Y[a]) * (X[c] - X[a])
        return twice

    def height(b: int) -> float:
        """Return the least height of the triangle of a corner and its neighbours, at most 0 if it turns right."""
        a, c = before[b], after[b]
        A, B, C = (X[a], Y[a]), (X[b], Y[b]), (X[c], Y[c])
        longest = max(math.dist(A, B), math.dist(B, C), math.dist(C, A))
        return area(a, b, c) / longest if longest else 0.0

    def obstacle(a: int, b: int, c: int) -> int | None:
        """Return a corner in a triangle; a corner at the place of a, b or c counts if an edge leads inside from it."""
        near = inward
        if len(near) > 50:  # testing each corner takes less time if there are fewer
            px, py, xs, ys = x[inward], y[inward], (X[a], X[b], X[c]), (Y[a], Y[b], Y[c])
            near = inward[(min(xs) <= px) & (px <= max(xs)) & (min(ys) <= py) & (py <= max(ys))]
        for v in near.tolist():
            if v in (a, b, c) or area(a, b, v) < 0 or area(b, c, v) < 0 or area(c, a, v) < 0:
                continue
            for here, one, two in ((a, b, c), (b, c, a), (c, a, b)):
                if (X[v], Y[v]) == (X[here], Y[here]):
                    if any(area(here, one, w) > 0 and area(here, w, two) > 0 for w in (before[v], after[v])):
                        return int(v)
                    break
            else:
                return int(v)
        return None

    inward = np.array([b for b in range(n) if area(before[b], b, after[b]) <= 0], dtype=np.int64)
    obstacles: dict[tuple[int, int, int], int] = {}
    gone = [False] * n
    triangles: list[tuple[int, int, int]] = []
    b = misses = 0
    while len(triangles) < n - 3:
        ear = before[b], b, after[b]
        is_ear = area(*ear) > 0 and (ear not in obstacles or gone[obstacles[ear]])
        if is_ear and (v := obstacle(*ear)) is not None:
            is_ear, obstacles[ear] = False, v
        if not is_ear and misses == n - len(triangles):
            b = min((k for k in range(n) if not gone[k]), key=lambda k: abs(height(k)))
            if abs(height(b)) > noise:
                return None
            ear, is_ear, inward = (before[b], b, after[b]), True, inward[inward != b]
        if is_ear:
            a, _, c = ear
            triangles.append(ear)
            after[a], before[c], gone[b] = c, a, True
            misses, b = 0, after[c]
        else:
            misses, b = misses + 1, after[b]
    triangles.append((before[b], b, after[b]))
    return np.array(triangles) if height(b) >= -noise else None


def strip(corners: Ints) -> Triangles:
    """Return the triangles of a strip, all oriented like the first."""
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def joined(parts: Iterable[tuple[Floats, Triangles]]) -> tuple[Floats, Triangles]:
    """Join meshes into one; meshes with the same array of vertices share it. A result that is too large is refused."""
    vertices: list[Floats] = []
    triangles: list[Triangles] = []
    starts: dict[int, int] = {}  # first vertex of each array in `vertices`, keyed by the array's id
    v = t = 0
    for points, corners in parts:
        if id(points) not in starts:
            starts[id(points)] = v
            vertices.append(points)
            v += len(points)
        triangles.append(corners + starts[id(points)])
        t += len(corners)
        expect(v <= MOST, f"expected at most {MOST} vertices, found more")
        expect(t <= MOST, f"expected at most {MOST} triangles, found more")
    if not vertices:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    return np.concatenate(vertices), np.concatenate(triangles)


def placed(T: Floats, vertices: Floats, triangles: Triangles) -> tuple[Floats, Triangles]:
    """Move a mesh by an affine map; a map that mirrors also reverses triangles, so that the mesh is not inside out."""
    if np.linalg.det(T[:3, :3]) < 0:
        triangles = triangles[:, ::-1]
    return image(T[:3, :3], vertices) + T[:3, 3], triangles


def check_range(corners: Ints, count: int, what: str, line: int | None = None) -> None:
    """Refuse indices outside the range from 0 to count - 1."""
    if len(corners) and (corners.min() < 0 or corners.max() >= count):
        bad = corners[(corners < 0) | (corners >= count)][0]
        raise Refusal(f"expected {what} to name vertices 0..{count - 1}, found {bad}", line)
