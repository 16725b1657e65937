"""Convex pieces for kernels: rows of three arrays, and functions of a row.

A packed set of pieces is a tuple of twelve arrays:

``table`` (P, COLUMNS) float64
    One row per piece; the columns are named in `columns`. Lengths are in metres, in the body frame.
``layout`` (P, 4) int64
    Kind, first and last+1 column of the piece's points; for a surface, also the address of its table
    (`narrow.surface_boxes`).
``points`` (3 V,) float64
    Vertices in blocks, see `pieces.support`. Repeats of the last vertex fill the last block of each piece, so that a
    piece is one run of cache lines. A large polytope (MAPPED) has the blocks and nodes of its `directions` instead.
``piece_start`` (n+1,) int64
    Body i has the pieces piece_start[i] .. piece_start[i+1].
``hot`` (P, HOT) float64
    A copy of the first columns of ``table``, packed for streaming through millions of pieces.
``single`` (P, HOT) float32
    ``hot`` in single precision, with bounds rounded to the safe side. The array has no rows if a piece is too large or
    too small for sixth powers of lengths in single precision.
``groups`` (48 G,) float64, ``children`` (8 G,) int64, ``roots`` (n,) int64
    Trees over the pieces of bodies that have many pieces, see `trees`.
``vertices`` (3 V,) float32
    ``points`` in single precision if ``single`` has rows; otherwise empty.
``parts`` (R, HOT) float64, ``part_start`` (3 P,) int64
    If any piece is a surface: ellipsoids around parts of surfaces and inside solids, in rows as in ``hot``; and, for
    each piece, the starts of its outer and inner ellipsoids, and their end. Otherwise empty.

Every piece is the sum of a core and a ball. The core is a polytope (its vertices), a surface (triangles; its points are
the corners of a box around it, and prove no contact), or the image c + F·C of a unit shape C (ball, cylinder, cone,
segment, point). The radius of the ball is called the rounding radius. It is zero except for capsules (whose core is a
segment), spheres (whose core is a point), and surfaces with a radius.
"""

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.columns import (
    BLOCK,
    CONE,
    CYLINDER,
    ELLIPSOID,
    FRAME_CENTER,
    FRAME_FACTOR,
    KIND,
    MAPPED,
    POINT,
    POINTS_FROM,
    POINTS_TO,
    POLYTOPE,
    REACH,
    ROUNDING,
    SEGMENT,
    SURFACE,
)
from loewner._kernels.linalg3 import apply, apply_transposed
from loewner._kernels.pieces.directions import candidates
from loewner._kernels.pieces.support import LINE, entry_of, farthest
from loewner._kernels.simd.vectors import prefetch, prefetch_far


@inline
def farthest_vertex(layout, points, piece, n):
    """Index in `points` of a polytope's farthest vertex along a direction."""
    start, stop = layout[piece, POINTS_FROM], layout[piece, POINTS_TO]
    if layout[piece, KIND] == MAPPED:
        start, stop = candidates(points, start, 3 * stop, n[0], n[1], n[2])
    return entry_of(farthest(points, start, stop, n))


@inline
def radius(P):
    """Rounding radius of a piece; the table is read only for kinds that have a radius."""
    kind = P.layout[P.piece, KIND]
    return P.table[P.piece, ROUNDING] if kind >= SEGMENT or kind <= SURFACE else 0.0


@inline
def reach(P):
    """Upper bound on the distance of any point of the piece from its body's origin."""
    return P.table[P.piece, REACH]


@inline
def prefetch_points(layout, points, piece):
    """Prefetch the vertices of a small polytope."""
    if layout[piece, KIND] == POLYTOPE:
        for at in range(3 * layout[piece, POINTS_FROM], 3 * layout[piece, POINTS_TO], LINE):
            prefetch(points, at)


SINGLES = 2 * LINE  # Number of single-precision numbers in a cache line.
FEW_LINES = 5


def _asking(prefetch):
    """Make a prefetching function for one of the two caches."""

    @inline
    def ask(layout, vertices, piece):
        """Prefetch the vertices of a small polytope in single precision."""
        piece = np.uint64(piece)  # An unsigned index cannot count from the end of an array.
        if layout[piece, KIND] == POLYTOPE:
            first, last = 3 * layout[piece, POINTS_FROM], 3 * layout[piece, POINTS_TO] - 1
            # Prefetch three blocks without a branch, because `support.extent` also reads three blocks without a branch.
            for line in range(FEW_LINES):
                prefetch(vertices, min(first + line * SINGLES, last))
            for at in range(first + FEW_LINES * SINGLES, last, SINGLES):
                prefetch(vertices, at)
            prefetch(vertices, last)

    return ask


# Call the first function shortly before the vertices are used. Call the second function well in advance: it prefetches
# into the second-level cache, which has room for more requests.
prefetch_vertices, prefetch_vertices_far = _asking(prefetch), _asking(prefetch_far)


@inline
def unit_support(kind, x, y, z):
    """Farthest point of a unit shape along a direction: ball, cylinder, cone (apex at +1, base at -1) or segment."""
    if kind == ELLIPSOID:
        length = np.sqrt(x * x + y * y + z * z)
        if length == 0.0:
            return 0.0, 0.0, 1.0
        return x / length, y / length, z / length
    if kind == SEGMENT:
        return 0.0, 0.0, np.copysign(1.0, z)
    length = np.sqrt(x * x + y * y)
    if kind == CYLINDER:
        if length == 0.0:
            return 0.0, 0.0, np.copysign(1.0, z)
        return x / length, y / length, np.copysign(1.0, z)
    if kind == CONE:  # Along the direction, the height of the rim is |xy| - z, and the height of the apex is z.
        if length == 0.0:
            return 0.0, 0.0, np.copysign(1.0, z)
        if z > length - z:
            return 0.0, 0.0, 1.0
        return x / length, y / length, -1.0
    return np.nan, np.nan, np.nan  # For a kind without a branch above, the result is NaN, so that nothing is proven.


@inline
def core_support(P, n):
    """Farthest point of a piece's core along a direction, both in the body frame; the pose does not matter."""
    kind, p = P.layout[P.piece, KIND], P.piece
    if kind <= POLYTOPE:
        i = farthest_vertex(P.layout, P.points, p, n)
        return P.points[i], P.points[i + BLOCK], P.points[i + 2 * BLOCK]
    table, c, f = P.table, FRAME_CENTER, FRAME_FACTOR
    if kind == POINT:
        return table[p, c], table[p, c + 1], table[p, c + 2]
    ux, uy, uz = unit_support(
        kind,
        table[p, f] * n[0] + table[p, f + 3] * n[1] + table[p, f + 6] * n[2],
        table[p, f + 1] * n[0] + table[p, f + 4] * n[1] + table[p, f + 7] * n[2],
        table[p, f + 2] * n[0] + table[p, f + 5] * n[1] + table[p, f + 8] * n[2],
    )
    return (
        table[p, c] + table[p, f] * ux + table[p, f + 1] * uy + table[p, f + 2] * uz,
        table[p, c + 1] + table[p, f + 3] * ux + table[p, f + 4] * uy + table[p, f + 5] * uz,
        table[p, c + 2] + table[p, f + 6] * ux + table[p, f + 7] * uy + table[p, f + 8] * uz,
    )


@inline
def rotation_of(P):
    """Rotation of a placed piece, nine entries in row order."""
    T, t = P.poses, P.row
    return T[t, 0, 0], T[t, 0, 1], T[t, 0, 2], T[t, 1, 0], T[t, 1, 1], T[t, 1, 2], T[t, 2, 0], T[t, 2, 1], T[t, 2, 2]


@inline
def placed_support(P, n):
    """Farthest point of a rotated (not translated) core along a direction in world axes."""
    R = rotation_of(P)
    return apply(R, core_support(P, apply_transposed(R, n)))
