"""Convex pieces as kernels see them: rows of three arrays, and what a row can answer.

A packed set of pieces is a tuple of nine arrays:

``table`` (P, COLUMNS) float64
    One row per piece; the columns are named below. Lengths in metres, body frame.
``layout`` (P, 5) int64
    Kind, first and last+1 column of its points, first and last+1 column of its planes.
``points`` (3, V), ``planes`` (4, F) float64
    Vertices, and faces as (unit outward normal, offset): n·x <= offset. Each piece's share is padded
    with repeats to a multiple of `PAD` columns, which the searches below take at a time.
``piece_start`` (n+1,) int64
    Body i owns pieces piece_start[i] .. piece_start[i+1].
``hot`` (P, HOT) float64
    The first columns of ``table`` once more, packed for streaming through millions of pieces.
``groups`` (48 G,) float64, ``children`` (8 G,) int64, ``roots`` (n,) int64
    Trees over the pieces of bodies that have many, see `trees`.

Every piece is a core plus a ball: a polytope (its vertices), or the image c + F·C of a unit shape
C (ball, cylinder, cone, segment, point), and a rounding radius (zero but for a capsule and a sphere,
whose cores are a segment and a point).
"""

import numpy as np

from loewner._kernels._jit import inline

POLYTOPE, ELLIPSOID, CYLINDER, CONE, SEGMENT, POINT = 0, 1, 2, 3, 4, 5

OUTER_CENTER, OUTER_SHAPE = 0, 3
OUTER_RADIUS = 9  # upper bound on the largest semi-axis of the outer ellipsoid
REACH = 10  # upper bound on the distance of any point of the piece or its ellipsoids from the body's origin
INNER_CENTER, INNER_SHAPE = 12, 15
INNER_SIGMA = 21  # lower bound on the smallest semi-axis of the inner ellipsoid
OUTER_SIGMA = 22  # the same of the outer ellipsoid
HOT = 24  # the columns up to here are all that the vectorised stages read: three cache lines
ROUNDING = 24  # radius of the ball added to the core
FRAME_CENTER, FRAME_FACTOR = 25, 28  # c and F (row by row) of the image of a unit shape
COLUMNS = 37

PAD = 4

KIND, POINTS_FROM, POINTS_TO, PLANES_FROM, PLANES_TO = 0, 1, 2, 3, 4


@inline
def farthest(points, start, stop, x, y, z):
    """Column of the point with the largest dot product.

    Four independent searches side by side: one alone would wait for each comparison in turn.
    """
    i0 = start
    i1 = start
    i2 = start
    i3 = start
    m0 = -np.inf
    m1 = -np.inf
    m2 = -np.inf
    m3 = -np.inf
    for i in range(start, stop, 4):
        value = points[0, i] * x + points[1, i] * y + points[2, i] * z
        if value > m0:
            m0 = value
            i0 = i
        value = points[0, i + 1] * x + points[1, i + 1] * y + points[2, i + 1] * z
        if value > m1:
            m1 = value
            i1 = i + 1
        value = points[0, i + 2] * x + points[1, i + 2] * y + points[2, i + 2] * z
        if value > m2:
            m2 = value
            i2 = i + 2
        value = points[0, i + 3] * x + points[1, i + 3] * y + points[2, i + 3] * z
        if value > m3:
            m3 = value
            i3 = i + 3
    if m1 > m0:
        m0 = m1
        i0 = i1
    if m3 > m2:
        m2 = m3
        i2 = i3
    return i2 if m2 > m0 else i0


@inline
def least_slack(planes, start, stop, x, y, z):
    """Smallest offset - n·x over the planes start .. stop; the same four searches."""
    m0 = np.inf
    m1 = np.inf
    m2 = np.inf
    m3 = np.inf
    for i in range(start, stop, 4):
        m0 = min(m0, planes[3, i] - (planes[0, i] * x + planes[1, i] * y + planes[2, i] * z))
        m1 = min(m1, planes[3, i + 1] - (planes[0, i + 1] * x + planes[1, i + 1] * y + planes[2, i + 1] * z))
        m2 = min(m2, planes[3, i + 2] - (planes[0, i + 2] * x + planes[1, i + 2] * y + planes[2, i + 2] * z))
        m3 = min(m3, planes[3, i + 3] - (planes[0, i + 3] * x + planes[1, i + 3] * y + planes[2, i + 3] * z))
    return min(min(m0, m1), min(m2, m3))


@inline
def unit_support(kind, x, y, z):
    """Farthest point of a unit shape: ball, cylinder, cone (apex at +1, base at -1) or segment."""
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
    # The cone's base circle and its apex compete: |xy| - z against z.
    if length == 0.0:
        return 0.0, 0.0, np.copysign(1.0, z)
    if z > length - z:
        return 0.0, 0.0, 1.0
    return x / length, y / length, -1.0


@inline
def core_support(table, layout, points, piece, x, y, z):
    """Farthest point of a piece's core along a direction, both in the body frame."""
    kind = layout[piece, KIND]
    if kind == POLYTOPE:
        i = farthest(points, layout[piece, POINTS_FROM], layout[piece, POINTS_TO], x, y, z)
        return points[0, i], points[1, i], points[2, i]
    row = table[piece]
    if kind == POINT:
        return row[FRAME_CENTER], row[FRAME_CENTER + 1], row[FRAME_CENTER + 2]
    f = FRAME_FACTOR
    ux, uy, uz = unit_support(
        kind,
        row[f] * x + row[f + 3] * y + row[f + 6] * z,
        row[f + 1] * x + row[f + 4] * y + row[f + 7] * z,
        row[f + 2] * x + row[f + 5] * y + row[f + 8] * z,
    )
    c = FRAME_CENTER
    return (
        row[c] + row[f] * ux + row[f + 1] * uy + row[f + 2] * uz,
        row[c + 1] + row[f + 3] * ux + row[f + 4] * uy + row[f + 5] * uz,
        row[c + 2] + row[f + 6] * ux + row[f + 7] * uy + row[f + 8] * uz,
    )


@inline
def core_height(table, layout, points, piece, T, t, x, y, z):
    """Support value of a rotated (not translated) core along a direction in the world's axes."""
    u = T[t, 0, 0] * x + T[t, 1, 0] * y + T[t, 2, 0] * z
    v = T[t, 0, 1] * x + T[t, 1, 1] * y + T[t, 2, 1] * z
    w = T[t, 0, 2] * x + T[t, 1, 2] * y + T[t, 2, 2] * z
    if layout[piece, KIND] == POLYTOPE:
        i = farthest(points, layout[piece, POINTS_FROM], layout[piece, POINTS_TO], u, v, w)
        return points[0, i] * u + points[1, i] * v + points[2, i] * w
    a, b, c = core_support(table, layout, points, piece, u, v, w)
    return a * u + b * v + c * w


@inline
def placed_support(table, layout, points, piece, T, t, x, y, z):
    """Farthest point of a rotated (not translated) core along a direction in the world's axes."""
    a, b, c = core_support(
        table,
        layout,
        points,
        piece,
        T[t, 0, 0] * x + T[t, 1, 0] * y + T[t, 2, 0] * z,
        T[t, 0, 1] * x + T[t, 1, 1] * y + T[t, 2, 1] * z,
        T[t, 0, 2] * x + T[t, 1, 2] * y + T[t, 2, 2] * z,
    )
    return (
        T[t, 0, 0] * a + T[t, 0, 1] * b + T[t, 0, 2] * c,
        T[t, 1, 0] * a + T[t, 1, 1] * b + T[t, 1, 2] * c,
        T[t, 2, 0] * a + T[t, 2, 1] * b + T[t, 2, 2] * c,
    )


@inline
def inside_by(table, layout, planes, piece, x, y, z):
    """How far inside a piece a point of the body frame lies: a lower bound, negative outside.

    For a polytope the distance to the nearest face plane; for the others a bound that is positive
    exactly inside.
    """
    kind = layout[piece, KIND]
    row = table[piece]
    if kind == POLYTOPE:
        return least_slack(planes, layout[piece, PLANES_FROM], layout[piece, PLANES_TO], x, y, z)
    # Coordinates in the unit shape's frame; the columns of F are orthogonal for every primitive
    # but scaled, so the inverse is Fᵀ over squared column lengths.
    f = FRAME_FACTOR
    px = x - row[FRAME_CENTER]
    py = y - row[FRAME_CENTER + 1]
    pz = z - row[FRAME_CENTER + 2]
    if kind == POINT:
        return row[ROUNDING] - np.sqrt(px * px + py * py + pz * pz)
    s0 = row[f] * row[f] + row[f + 3] * row[f + 3] + row[f + 6] * row[f + 6]
    s1 = row[f + 1] * row[f + 1] + row[f + 4] * row[f + 4] + row[f + 7] * row[f + 7]
    s2 = row[f + 2] * row[f + 2] + row[f + 5] * row[f + 5] + row[f + 8] * row[f + 8]
    w = (row[f + 2] * px + row[f + 5] * py + row[f + 8] * pz) / s2
    if kind == SEGMENT:
        w = min(1.0, max(-1.0, w))
        dx = px - w * row[f + 2]
        dy = py - w * row[f + 5]
        dz = pz - w * row[f + 8]
        return row[ROUNDING] - np.sqrt(dx * dx + dy * dy + dz * dz)
    u = (row[f] * px + row[f + 3] * py + row[f + 6] * pz) / s0
    v = (row[f + 1] * px + row[f + 4] * py + row[f + 7] * pz) / s1
    if kind == ELLIPSOID:
        return (1.0 - np.sqrt(u * u + v * v + w * w)) * np.sqrt(min(s0, min(s1, s2)))
    radial = np.sqrt(u * u + v * v)
    if kind == CYLINDER:
        return min((1.0 - radial) * np.sqrt(min(s0, s1)), (1.0 - abs(w)) * np.sqrt(s2))
    # Cone: the slanted side |xy| <= (1 - z)/2 and the base z >= -1.
    side = (0.5 * (1.0 - w) - radial) * np.sqrt(min(s0, min(s1, s2))) * 0.7
    return min(side, (1.0 + w) * np.sqrt(s2))
