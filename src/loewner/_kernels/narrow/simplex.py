"""Closest point of a simplex to the origin: the inner step of GJK.

The first k rows of ``S`` (4, 9) are the simplex. Each row holds a point of the Minkowski difference A - B, then its
points of A and of B. Each solver keeps the rows that support the closest point, writes their barycentric weights to
``weights`` and the closest point to ``v``, and returns the number of remaining rows. If four rows remain, the origin is
inside.

The signs of dot products determine the region (Ericson, Real-Time Collision Detection, 2005, section 5.1). Every answer
is a point of the simplex, even if rounding changes signs, so |v| is always an upper bound on the distance. GJK proves
the lower bound separately.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.linalg3 import along, cross, dot, minus
from loewner._kernels.tolerances import LEAST_SQUARE, UNIT_ROUNDOFF

# Error of each of the two volumes that `_beyond` compares, as a multiple of u L³. Here, u is the unit roundoff, and L
# is the largest sum of a point's absolute coordinates.
FACE_ERROR = 64.0  # certified.md B15


@inline
def row(S, k):
    """Point k of the simplex."""
    return S[k, 0], S[k, 1], S[k, 2]


@njit()
def _keep(S, target, source):
    if target != source:
        for j in range(9):
            S[target, j] = S[source, j]


@njit()
def _combine(S, k, weights, v):
    for j in range(3):
        v[j] = 0.0
    for i in range(k):
        for j in range(3):
            v[j] += weights[i] * S[i, j]


@njit()
def segment_weight(a, b):
    """Weight of b in the point of the segment ab that is closest to the origin."""
    d = minus(b, a)
    squared = dot(d, d)
    if squared <= 0.0:
        return 0.0
    # Compute the weight from the end nearer to the origin, where the dot product loses no digits.
    t = -dot(a, d) / squared if dot(a, a) <= dot(b, b) else 1.0 - dot(b, d) / squared
    return min(1.0, max(0.0, t))


@njit(forceinline=False)
def triangle_weights(a, b, c):
    """Barycentric weights of the point of a triangle that is closest to the origin."""
    ab, ac = minus(b, a), minus(c, a)
    d1, d2 = -dot(ab, a), -dot(ac, a)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    d3, d4 = -dot(ab, b), -dot(ac, b)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    d5, d6 = -dot(ab, c), -dot(ac, c)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    # The signs of three weights, each computed from the normal and one edge, separate the regions of the edges from the
    # region of the face. On curved pieces, triangles become tiny but stay away from the origin. Each product here is
    # therefore chosen to have a small factor.
    bc, n = minus(c, b), cross(ab, ac)
    weight_c = dot(n, cross(a, ab))
    if weight_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = segment_weight(a, b)
        return 1.0 - t, t, 0.0
    weight_b = dot(n, cross(ac, c))
    if weight_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = segment_weight(a, c)
        return 1.0 - t, 0.0, t
    weight_a = dot(n, cross(b, bc))
    if weight_a <= 0.0 and d4 >= d3 and d5 >= d6:
        t = segment_weight(b, c)
        return 0.0, 1.0 - t, t
    total = weight_a + weight_b + weight_c
    if not (total > 0.0 and weight_a >= 0.0 and weight_b >= 0.0 and weight_c >= 0.0):
        # The triangle is too thin to have an accurate normal. The nearest point of its edges is then just as good.
        return _best_edge(a, b, c)
    return weight_a / total, weight_b / total, weight_c / total


@njit(forceinline=False)
def _best_edge(a, b, c):
    t, u, w = segment_weight(a, b), segment_weight(b, c), segment_weight(c, a)
    on_ab, on_bc, on_ca = along(a, t, minus(b, a)), along(b, u, minus(c, b)), along(c, w, minus(a, c))
    p, q, r = dot(on_ab, on_ab), dot(on_bc, on_bc), dot(on_ca, on_ca)
    if p <= q and p <= r:
        return 1.0 - t, t, 0.0
    if q <= r:
        return 0.0, 1.0 - u, u
    return w, 0.0, 1.0 - w


@njit()
def _compact(S, k, weights, v):
    """Drop the rows with weight zero, and compute the closest point."""
    m = 0
    for i in range(k):
        if weights[i] > 0.0:
            _keep(S, m, i)
            weights[m] = weights[i]
            m += 1
    _combine(S, m, weights, v)
    return m


@njit()
def _beyond(S, i, j, k, opposite, doubt):
    """Return whether the origin may be on the outer side of face ijk.

    `doubt` bounds the rounding error of the two volumes compared. A superfluous face costs only a little time, but a
    missing face may cost the right answer: in a flat tetrahedron, all four faces must be tried.
    """
    ux = S[j, 0] - S[i, 0]
    uy = S[j, 1] - S[i, 1]
    uz = S[j, 2] - S[i, 2]
    wx = S[k, 0] - S[i, 0]
    wy = S[k, 1] - S[i, 1]
    wz = S[k, 2] - S[i, 2]
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    inner = nx * (S[opposite, 0] - S[i, 0]) + ny * (S[opposite, 1] - S[i, 1]) + nz * (S[opposite, 2] - S[i, 2])
    origin = -(nx * S[i, 0] + ny * S[i, 1] + nz * S[i, 2])
    return not ((inner > doubt and origin > doubt) or (inner < -doubt and origin < -doubt))


@njit(forceinline=False)
def closest(S, k, weights, v):
    """Reduce the simplex to the part that contains its point closest to the origin."""
    if k == 1:
        weights[0] = 1.0
        _combine(S, 1, weights, v)
        return 1
    if k == 2:
        t = segment_weight(row(S, 0), row(S, 1))
        weights[0] = 1.0 - t
        weights[1] = t
        return _compact(S, 2, weights, v)
    if k == 3:
        wa, wb, wc = triangle_weights(row(S, 0), row(S, 1), row(S, 2))
        weights[0] = wa
        weights[1] = wb
        weights[2] = wc
        return _compact(S, 3, weights, v)
    largest = 0.0
    for i in range(4):
        largest = max(largest, abs(S[i, 0]) + abs(S[i, 1]) + abs(S[i, 2]))
    doubt = FACE_ERROR * UNIT_ROUNDOFF * largest * largest * largest
    best = np.inf
    b0 = 0.0
    b1 = 0.0
    b2 = 0.0
    b3 = 0.0
    for face in range(4):
        i = 0 if face != 0 else 1
        j = 1 if face > 1 else 2
        m = 2 if face == 3 else 3
        if _beyond(S, i, j, m, face, doubt):
            wa, wb, wc = triangle_weights(row(S, i), row(S, j), row(S, m))
            x = wa * S[i, 0] + wb * S[j, 0] + wc * S[m, 0]
            y = wa * S[i, 1] + wb * S[j, 1] + wc * S[m, 1]
            z = wa * S[i, 2] + wb * S[j, 2] + wc * S[m, 2]
            squared = x * x + y * y + z * z
            if squared < best:
                best = squared
                b0 = wa if i == 0 else 0.0
                b1 = wa if i == 1 else (wb if j == 1 else 0.0)
                b2 = wb if j == 2 else (wc if m == 2 else 0.0)
                b3 = wc if m == 3 else 0.0
    if best == np.inf:
        v[0] = 0.0
        v[1] = 0.0
        v[2] = 0.0
        return 4
    weights[0] = b0
    weights[1] = b1
    weights[2] = b2
    weights[3] = b3
    return _compact(S, 4, weights, v)


@njit(forceinline=False)
def weigh_inside(S, weights, v):
    """Write the weights of the origin, which is in the tetrahedron S, or of a nearest point if S is too flat."""
    total = 0.0
    for i in range(4):
        j, k, m = (1 if i == 0 else 0), (2 if i < 2 else 1), (3 if i < 3 else 2)
        weights[i] = abs(dot(row(S, j), cross(row(S, k), row(S, m))))
        total += weights[i]
    for i in range(4):
        weights[i] = weights[i] / total if total > 0.0 else 0.25
    _combine(S, 4, weights, v)
    best = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    for i in range(4):
        j, k, m = (1 if i == 0 else 0), (2 if i < 2 else 1), (3 if i < 3 else 2)
        a, b, c = row(S, j), row(S, k), row(S, m)
        wa, wb, wc = triangle_weights(a, b, c)
        near = combined(wa, a, wb, b, wc, c)
        if dot(near, near) < best:
            best = dot(near, near)
            weights[i], weights[j], weights[k], weights[m] = 0.0, wa, wb, wc


@inline
def combined(wa, a, wb, b, wc, c):
    """A weighted sum of three points."""
    return (
        wa * a[0] + wb * b[0] + wc * c[0],
        wa * a[1] + wb * b[1] + wc * c[1],
        wa * a[2] + wb * b[2] + wc * c[2],
    )


@njit()
def _without(d, ex, ey, ez):
    """Remove the component of d along e, twice: the second pass removes the rounding of the first."""
    squared = ex * ex + ey * ey + ez * ez
    if squared > 0.0:
        for _ in range(2):
            t = (d[0] * ex + d[1] * ey + d[2] * ez) / squared
            d[0] -= t * ex
            d[1] -= t * ey
            d[2] -= t * ez


@njit(forceinline=False)
def direction(S, k, v, d):
    """Compute the unit normal d of the simplex's feature, on the side away from the origin.

    The closest point v is a weighted sum of points whose rounding errors are relative to their size. Close to contact,
    the direction of v is therefore noise. The feature itself still has a normal to full precision, perpendicular to the
    edge or the triangle. Returns the offset d·x of the feature, which is the distance of the origin; 0 if the feature
    has no normal.
    """
    for j in range(3):
        d[j] = v[j] if k != 1 else S[0, j]
    if k == 3:
        ux, uy, uz = S[1, 0] - S[0, 0], S[1, 1] - S[0, 1], S[1, 2] - S[0, 2]
        wx, wy, wz = S[2, 0] - S[0, 0], S[2, 1] - S[0, 1], S[2, 2] - S[0, 2]
        nx = uy * wz - uz * wy
        ny = uz * wx - ux * wz
        nz = ux * wy - uy * wx
        side = nx * S[0, 0] + ny * S[0, 1] + nz * S[0, 2]
        sign = 1.0 if side >= 0.0 else -1.0
        d[0], d[1], d[2] = sign * nx, sign * ny, sign * nz
        _unit(d)
        # The computed normal of a thin triangle is only roughly perpendicular to the edges. Remove its components along
        # two edges, the longer edge last.
        if ux * ux + uy * uy + uz * uz > wx * wx + wy * wy + wz * wz:
            _without(d, wx, wy, wz)
            _without(d, ux, uy, uz)
        else:
            _without(d, ux, uy, uz)
            _without(d, wx, wy, wz)
    elif k == 2:
        _unit(d)
        _without(d, S[1, 0] - S[0, 0], S[1, 1] - S[0, 1], S[1, 2] - S[0, 2])
    if not _unit(d):
        return 0.0
    return d[0] * S[0, 0] + d[1] * S[0, 1] + d[2] * S[0, 2]


@njit()
def _unit(d):
    squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    if not LEAST_SQUARE < squared < np.inf:
        return False
    length = np.sqrt(squared)
    d[0] /= length
    d[1] /= length
    d[2] /= length
    return True
