"""Cut surfaces into parts; proofs of motions replace each part with its convex hull."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from loewner._base._matrices import product, slices
from loewner._base._validate import Bools, Floats
from loewner._kernels import columns
from loewner._native import entries
from loewner.bodies.flat_faces import flat_faces
from loewner.bodies.layout import kernel_of_parts, laid_out
from loewner.bodies.pack import Packed, Prepared, as_one, some
from loewner.bodies.surface_trees import SurfaceTree, around_point, around_sums
from loewner.ellipsoids.polytopes import Polytope, heights_about_mean
from loewner.errors import GeometryError

# Number of parts of a surface. If the hulls of two parts meet, a proof of a motion continues with the parts' triangles.
PARTS = 6

# Limits on the number of small parts: of one surface, and of all surfaces of a problem together.
MOST_PARTS, ALL_PARTS = 128, 1024

# A large part keeps only its farthest corners in these 74 directions, since searches take longer with more corners. The
# directions are short integer vectors, so that they are the same on all processors.
_SHORT = np.indices((5, 5, 5)).reshape(3, -1).T - 2
WAYS = _SHORT[np.isin((_SHORT**2).sum(axis=1), (1, 2, 3, 5, 6))].astype(float)

# The vertices of a hull are moved outward in steps of this size, relative to the hull's size. A step exceeds the
# rounding.
ROUNDED = 1e-12

# Number of products computed at a time.
AT_ONCE = 1_000_000

# Parts of surfaces, keyed by the surface's tree and by the limit on the number of parts; None for a surface that cannot
# be cut.
_known: WeakKeyDictionary[SurfaceTree, dict[int, Packed | None]] = WeakKeyDictionary()


def in_parts(packs: Sequence[Packed], most: int = PARTS) -> list[Packed]:
    """Cut the surfaces of bodies into parts, which become pieces; a body without surfaces is returned unchanged.

    The parts of a solid cover only its surface. If the parts of two bodies never meet during a motion, the bodies stay
    apart, provided that neither body is inside the other at the start.

    Parameters
    ----------
    packs : sequence of Packed
        One body each.
    most : int
        Limit on the number of parts of a surface.
    """
    return [_in_parts(pack, most) if pack.trees else pack for pack in packs]


def in_small_parts(packs: Sequence[Packed]) -> list[Packed]:
    """Cut the surfaces of bodies into small parts; the total number of parts is limited."""
    surfaces, most = sum(len(pack.trees) for pack in packs), MOST_PARTS
    # The limit is only halved, so that it rarely changes when a surface is added: a new limit would require cutting all
    # other surfaces again.
    while most * surfaces > ALL_PARTS:
        most //= 2
    return in_parts(packs, max(most, PARTS))


def in_open_parts(packs: Sequence[Packed], still: Bools) -> list[Packed]:
    """Cut the surfaces of static bodies into small parts; a body with a solid is returned unchanged."""
    chosen = [
        stands and bool(pack.trees) and not (pack.layout[:, columns.KIND] == columns.SOLID).any()
        for pack, stands in zip(packs, still.tolist(), strict=True)
    ]
    cut = iter(in_small_parts([pack for pack, is_cut in zip(packs, chosen, strict=True) if is_cut]))
    return [next(cut) if is_cut else pack for pack, is_cut in zip(packs, chosen, strict=True)]


def _in_parts(packed: Packed, most: int) -> Packed:
    """Return a body with its surfaces in parts."""
    rows: list[Packed] = []
    done = 0
    for i in packed.trees:
        parts = _parts_of(packed, i, most)
        if parts is not None:
            rows += [*_as_they_are(packed, done, i), parts]
            done = i + 1
    if not rows:
        return packed
    rows += _as_they_are(packed, done, len(packed.layout))
    return rows[0] if len(rows) == 1 else as_one(rows)


def _as_they_are(packed: Packed, first: int, last: int) -> list[Packed]:
    if first == last:
        return []
    return [some(packed, np.arange(first, last), np.array([0, last - first])).packed()]


def _parts_of(packed: Packed, i: int, most: int) -> Packed | None:
    """Return the parts of a surface as a body, kept for later calls; None if the surface cannot be cut."""
    parts_by_count = _known.setdefault(packed.trees[i], {})
    if most not in parts_by_count:
        parts_by_count[most] = _cut(packed, i, most)
    return parts_by_count[most]


def _cut(packed: Packed, i: int, most: int) -> Packed | None:
    vertices, triangles, radius = packed.points_of(i), packed.triangles_of(i), float(packed.frames[i, 0])
    total = len(triangles)
    if min(total, most) < 2:
        return None
    # The triangles of a cloud are points.
    single = bool((triangles == triangles[:, :1]).all())
    faces = np.zeros(total, dtype=np.int64) if single else flat_faces(vertices, triangles)
    order, start = faces.argsort(kind="stable"), np.empty(most + 1, dtype=np.int64)
    boxes, centers, shapes = np.empty((most, 24)), np.empty((most, 3)), np.empty((most, 3, 3))
    each = 1 if single else 3
    corners = vertices[triangles[order, :each]].reshape(total, 3 * each).T.copy()
    count = entries.cut_up(corners.reshape(-1), faces, radius, most, order, start, boxes, centers, shapes)
    if count < 2:
        return None
    points, first = corners.T.reshape(-1, 3), each * start[:count]
    local = np.arange(each * total).reshape(-1, each) - np.repeat(first, np.diff(start[: count + 1]))[:, None]
    pieces = laid_out(
        columns.SURFACE,
        (points[first], np.repeat(around_point(radius)[None], count, axis=0)),
        (centers[:count], around_sums(shapes[:count], np.full(count, radius))),
        np.full((count, 2), [0.0, np.inf]),
        point_start=each * start[: count + 1], points=points, radius=radius,
        triangle_start=start[: count + 1].copy(), triangles=np.ascontiguousarray(np.broadcast_to(local, (total, 3))),
    )  # fmt: skip
    tree = packed.trees[i]
    prepared_pieces = Prepared(**vars(pieces), maps={}, trees=dict.fromkeys(range(count), tree))
    around = [box.reshape(3, 8).T for box in boxes[:count]]
    if not single:
        parts = (np.unique(triangles[order[start[k] : start[k + 1]]]) for k in range(count))
        around = [_hull_around(vertices[part], box) for part, box in zip(parts, around, strict=True)]
    reach = float(packed.kernel.table[i, columns.REACH])
    return Packed.with_kernel(prepared_pieces, kernel_of_parts(pieces, tree, around, reach))


def _hull_around(points: Floats, box: Floats) -> Floats:
    """Make a few points whose hull is certain to contain the given points.

    The new points are the vertices of a hull, scaled up about their middle c. The hull is around all points or, if
    there are many, around the farthest points in the directions `WAYS`. By the lemma of docs/containment.md, a point p
    lies in the hull of the scaled vertices v if, for each face with normal n, n·(p - c) is at most the least n·(v - c)
    over the face's vertices. If there are many points in one plane, the corners of the box around the points are used
    instead, because the points then have no hull with faces.
    """
    if len(points) <= len(box):
        return points
    chosen = points
    if len(points) > len(WAYS):
        sides = np.ptp(points, axis=0)
        chosen = points[np.unique(product(points, (WAYS / np.where(sides > 0, sides, 1.0)).T).argmax(axis=0))]
    try:
        hull = Polytope.from_points(chosen)
    except GeometryError:
        return points if len(points) <= len(WAYS) else box
    center, heights = heights_about_mean(hull)
    if not heights.min() > 0:
        return box
    rows, away = hull.normals / heights[:, None], (points - center).T
    farthest = max(float(product(rows[some], away).max()) for some in slices(len(rows), AT_ONCE // len(points)))
    return np.asarray(center + (hull.vertices - center) * (1 + ROUNDED * (np.rint((farthest - 1) / ROUNDED) + 2)))
