"""Cut surfaces into parts: proofs of motions replace each piece by a box, and small boxes leave more free space."""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import count
from weakref import WeakKeyDictionary

import numpy as np

from loewner._kernels import columns
from loewner._validate import Bools, Floats, Ints
from loewner.bodies.boxes import least_box_axes
from loewner.bodies.flat_faces import flat_faces
from loewner.bodies.layout import starts
from loewner.bodies.pack import Packed, Prepared, joined, some
from loewner.bodies.surface_trees import SurfaceTree, surface_trees
from loewner.bodies.surfaces import surface_pieces
from loewner.errors import GeometryError

# Limits on the parts of a surface, and of all surfaces of a pack together: each part takes a millisecond to make.
MOST_PARTS, ALL_PARTS = 128, 1024

# Thickness assumed for a flat part, relative to the whole.
THICKNESS = 0.01

# When a part is cut in two, each side gets at least one in this many triangles; with several faces, one face. With 16,
# cuts leave parts of three quarters over and over, and no more is proven.
LEAST_SHARE = 4

# Certified log-volume gap of the ellipsoids around parts: a loose one, since proofs use the boxes.
TOLERANCE = 1e-2

# Parts of surfaces by tree, with the limit on their number; None for a surface that cannot be cut.
_known: WeakKeyDictionary[SurfaceTree, tuple[int, Prepared | None]] = WeakKeyDictionary()


def in_parts(packed: Packed, bodies: Bools) -> Packed:
    """Cut the surfaces of bodies into parts, each a piece of its own; a pack without surfaces is returned as it is.

    Parts of a solid cover only its surface. A body that starts outside and stays clear of all parts stays outside.

    Parameters
    ----------
    packed : Packed
    bodies : ndarray of bool
        Bodies whose surfaces are cut.
    """
    of_piece = np.repeat(bodies, np.diff(packed.piece_start))
    standing = [i for i in packed.trees if of_piece[i]]
    # A power of two, so that adding a surface does not always cut all others anew.
    most = MOST_PARTS
    while most * len(standing) > ALL_PARTS:
        most //= 2
    cut = {i: _parts_of(packed, i, most) for i in standing}
    rows: list[Prepared] = []
    counts, done = np.ones(len(packed.layout), dtype=np.int64), 0
    for i, parts in cut.items():
        if parts is not None:
            rows += [_as_they_are(packed, done, i), parts]
            counts[i], done = len(parts.layout), i + 1
    if not rows:
        return packed
    rows.append(_as_they_are(packed, done, len(packed.layout)))
    return replace(joined(rows), piece_start=starts(counts)[packed.piece_start]).packed()


def _as_they_are(packed: Packed, first: int, last: int) -> Prepared:
    return some(packed, np.arange(first, last), np.array([0, last - first]))


def _parts_of(packed: Packed, i: int, most: int) -> Prepared | None:
    """Return the parts of a surface, made once; None if it is a single part, or if a part is too small for kernels."""
    tree = packed.trees[i]
    known = _known.get(tree)
    if known is None or known[0] != most:
        try:
            known = most, _cut(packed, i, most)
        except GeometryError:
            known = most, None
        _known[tree] = known
    return known[1]


def _cut(packed: Packed, i: int, most: int) -> Prepared | None:
    row, radius = packed.layout[i], float(packed.frames[i, 0])
    vertices = packed.points[row[columns.POINTS_FROM] : row[columns.POINTS_TO]]
    triangles = packed.triangles[packed.triangle_start[i] : packed.triangle_start[i + 1]]
    if min(len(triangles), most) < 2:
        return None
    # The triangles of a cloud are points.
    single = bool((triangles == triangles[:, :1]).all())
    faces = np.zeros(len(triangles), dtype=np.int64) if single else flat_faces(vertices, triangles)
    made = []
    corners = vertices[triangles[:, :1] if single else triangles].transpose(2, 1, 0)
    for part in _cut_up(np.ascontiguousarray(corners), faces, radius, most):
        pieces = surface_pieces("part", vertices, triangles[part], radius, False, TOLERANCE)
        trees = surface_trees(pieces.layout, pieces.points, pieces.triangles, pieces.triangle_start)
        made.append(Prepared(**vars(pieces), maps={}, trees=trees))
    return joined(made)


def _cut_up(triangles: Floats, faces: Ints, radius: float, most: int) -> list[Ints]:
    """Return the triangle indices of each part; the part with the emptiest box is cut, repeatedly.

    Parameters
    ----------
    triangles : ndarray, shape (3, corners, n)
        Coordinates come first.
    faces : ndarray of int, shape (n,)
        Face of each triangle. A face is cut only if it is alone in its part. The boards of a shelf are thus separated,
        even if they intersect, however fine their triangles are.
    radius : float
        Radius around the triangles, in metres.
    most : int
        Largest number of parts.
    """
    numbers = count()  # of parts with equal boxes the older one comes first
    # Flat boxes are given a volume too, partly filled by triangles: triangles in one plane may be far apart.
    thick = THICKNESS * float(np.ptp(triangles, axis=(1, 2)).max())
    filled = thick * _areas(triangles)

    def entry(part: Ints) -> tuple[float, int, Ints, Floats, Floats]:
        own = triangles[:, :, part]
        turned = (least_box_axes(own).T @ own.reshape(3, -1)).reshape(own.shape)
        lower, upper = turned.min(axis=1), turned.max(axis=1)
        box = _volumes(lower.min(axis=1), upper.max(axis=1), 2 * radius + thick)
        empty = float(box - filled[part].sum()) if len(part) > 1 else 0.0
        return -empty, next(numbers), part, lower, upper

    parts = [entry(faces.argsort(kind="stable"))]
    while len(parts) < most and parts[0][0] < 0:
        _, _, part, lower, upper = heapq.heappop(parts)
        for piece in _cut_in_two(lower, upper, faces[part], 2 * radius + thick):
            heapq.heappush(parts, entry(part[piece]))
    return [part for _, _, part, _, _ in parts]


def _cut_in_two(lower: Floats, upper: Floats, faces: Ints, thick: float) -> tuple[Ints, Ints]:
    """Split triangles, sorted by face, in two parts, by the cut across an axis that gives the smallest boxes."""
    first, many = np.flatnonzero(np.diff(faces, prepend=-1)), len(faces)
    if len(first) == 1:
        first = np.arange(many)
    elif len(first) < many:
        lower, upper = np.minimum.reduceat(lower, first, axis=1), np.maximum.reduceat(upper, first, axis=1)
    least = max(len(first) // LEAST_SHARE, 1)
    found = []
    for order in (lower + upper).argsort(axis=1, kind="stable"):
        low, high = lower[:, order], upper[:, order]
        volumes = _of_first(low, high, thick)[:-1] + _of_first(low[:, ::-1], high[:, ::-1], thick)[-2::-1]
        at = least + int(volumes[least - 1 : len(order) - least].argmin())
        found.append((float(volumes[at - 1]), order[:at]))
    chosen = np.zeros(len(first), dtype=bool)
    chosen[min(found, key=lambda one: one[0])[1]] = True
    of_first = np.repeat(chosen, np.diff(first, append=many))
    return np.flatnonzero(of_first), np.flatnonzero(~of_first)


def _of_first(lower: Floats, upper: Floats, thick: float) -> Floats:
    """Compute the volumes of the boxes around the first box, the first two boxes, the first three boxes, ..."""
    return _volumes(np.minimum.accumulate(lower, axis=1), np.maximum.accumulate(upper, axis=1), thick)


def _volumes(lower: Floats, upper: Floats, thick: float) -> Floats:
    return np.asarray((upper - lower + thick).prod(axis=0))


def _areas(triangles: Floats) -> Floats:
    """Compute the area of each triangle; points have area 0."""
    if triangles.shape[1] == 1:
        return np.zeros(triangles.shape[2])
    a, b, c = triangles.transpose(1, 2, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2
