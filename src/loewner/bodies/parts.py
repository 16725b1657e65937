"""Cut surfaces into parts: proofs of motions replace each piece by a box, and small boxes leave more free space."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from loewner._kernels import columns
from loewner._native import entries
from loewner._validate import Bools
from loewner.bodies.flat_faces import flat_faces
from loewner.bodies.layout import PieceArrays, kernel_of_parts
from loewner.bodies.pack import Packed, Prepared, as_one, some
from loewner.bodies.surface_trees import SurfaceTree, around_point, around_sums

# Limits on the parts of a surface, and of all surfaces of a problem together.
MOST_PARTS, ALL_PARTS = 128, 1024

# Parts of surfaces by tree, with the limit on their number; None for a surface that cannot be cut.
_known: WeakKeyDictionary[SurfaceTree, tuple[int, Packed | None]] = WeakKeyDictionary()


def in_parts(packs: Sequence[Packed], bodies: Bools) -> list[Packed]:
    """Cut the surfaces of bodies into parts, each a piece of its own; a body without surfaces is returned as it is.

    Parts of a solid cover only its surface. A body that starts outside and stays clear of all parts stays outside.

    Parameters
    ----------
    packs : sequence of Packed
        One body each.
    bodies : ndarray of bool
        Bodies whose surfaces are cut.
    """
    surfaces = sum(len(pack.trees) for pack, chosen in zip(packs, bodies.tolist(), strict=True) if chosen)
    # A power of two, so that adding a surface does not always cut all others anew.
    most = MOST_PARTS
    while most * surfaces > ALL_PARTS:
        most //= 2
    return [
        _in_parts(pack, most) if chosen and pack.trees else pack for pack, chosen in zip(packs, bodies, strict=True)
    ]


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
    """Return the parts of a surface, made once, as a body; None if it is a single part."""
    tree = packed.trees[i]
    known = _known.get(tree)
    if known is None or known[0] != most:
        known = _known[tree] = most, _cut(packed, i, most)
    return known[1]


def _cut(packed: Packed, i: int, most: int) -> Packed | None:
    row, radius = packed.layout[i], float(packed.frames[i, 0])
    vertices = packed.points[row[columns.POINTS_FROM] : row[columns.POINTS_TO]]
    triangles = packed.triangles[packed.triangle_start[i] : packed.triangle_start[i + 1]]
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
    layout = np.zeros((count, 5), dtype=np.int64)
    layout[:, columns.KIND] = columns.SURFACE
    layout[:, columns.POINTS_FROM], layout[:, columns.POINTS_TO] = first, each * start[1 : count + 1]
    local = np.arange(each * total).reshape(-1, each) - np.repeat(first, np.diff(start[: count + 1]))[:, None]
    frames = np.zeros((count, 13))
    frames[:, 0] = radius
    pieces = PieceArrays(
        layout=layout,
        points=points,
        planes=np.zeros((0, 4)),
        piece_start=np.array([0, count], dtype=np.int64),
        frames=frames,
        triangles=np.ascontiguousarray(np.broadcast_to(local, (total, 3))),
        triangle_start=start[: count + 1].copy(),
        inner_center=points[first],
        inner_factor=np.repeat(around_point(radius)[None], count, axis=0),
        outer_center=centers[:count],
        outer_factor=around_sums(shapes[:count], np.full(count, radius)),
        gaps=np.full((count, 2), [0.0, np.inf]),
    )
    tree = packed.trees[i]
    made = Prepared(**vars(pieces), maps={}, trees=dict.fromkeys(range(count), tree))
    return Packed.with_kernel(made, kernel_of_parts(pieces, tree, boxes[:count]))
