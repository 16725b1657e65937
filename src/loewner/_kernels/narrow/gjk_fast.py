"""The fast searches for two placed pieces: GJK with the simplex in registers.

The vertices of small polytopes are moved to the world once per pair. A round then takes two searches through vectors of
points and about forty products. Both `decide` and `measure` prove their results in the same way as `gjk_robust.run`, by
a support plane clear of the origin or by points of the pieces. If no proof succeeds, they return UNSETTLED, and
`gjk_robust.run` takes over.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; Ericson, Real-Time Collision Detection (2005), section 5.1.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import APART, NEAREST, OVERLAPPING, TOUCHING, UNSETTLED
from loewner._kernels.columns import BLOCK, KIND, LARGE, POINTS_FROM, POINTS_TO, POLYTOPE
from loewner._kernels.linalg3 import along, cross, dot, minus, negated, plus, scaled
from loewner._kernels.narrow.gjk_robust import DISTANCE_TOLERANCE, ERROR_SHARE
from loewner._kernels.narrow.simplex import segment_weight, triangle_weights
from loewner._kernels.pieces.shapes import placed_support, rotation_of
from loewner._kernels.pieces.support import entry_of, farthest, place_vertices
from loewner._kernels.simd.memory import Arena, floats
from loewner._kernels.tolerances import LEAST_SQUARE, UNIT_ROUNDOFF

DECIDE_ROUNDS = 24
# Maximum number of rounds of `measure`. Polytopes usually need six rounds, and at most twelve; for curved pieces, the
# search converges linearly.
MEASURE_ROUNDS = 64

# A support point that is already in the simplex ends the search. The result counts as the distance only if the bounds
# on the distance then differ by at most LAST_GAP times the rounding error of a height.
LAST_GAP = 16.0

# If the squared sine of a triangle's angle at the newest point is below THIN, the normal is made orthogonal to the two
# edges at this point.
THIN = 1e-4

# The second direction of a search is a weighted mean of two unit vectors: the first direction, which has the weight
# KEPT, and the direction of the first point. Weights from 0.5 to 0.8 work equally well.
KEPT = 0.7

# Error of a determinant of three points, and error of the sum of four determinants, as multiples of u L³. Here, u is
# the unit roundoff, and L is the largest sum of a point's absolute coordinates.
VOLUME_ERROR = 64.0  # certified.md B16, B17

# The scratch array begins with PLACED columns for the placed vertices of both pieces. From the index _PATH on, it has
# six numbers for each round of `measure`: the two support points.
PLACED = 2 * LARGE
_PATH = 3 * PLACED

ENTRIES = _PATH + 6 * MEASURE_ROUNDS

# Memory of a search: the scratch array, and the result of `measure`.
MEMORY = Arena(vertices=floats(ENTRIES), result=floats(9))
vertices_of, result_of = MEMORY.accessors("vertices result")


@inline
def place_piece(P, shift, W, at):
    """Place the vertices of a small polytope in W from column `at`; return the end, which is `at` for other pieces."""
    if P.layout[P.piece, KIND] != POLYTOPE:
        return at
    start, stop = P.layout[P.piece, POINTS_FROM], P.layout[P.piece, POINTS_TO]
    place_vertices(P.points, start, stop, rotation_of(P), shift, W, at)
    return at + (stop - start)


@inline
def begin(A, B, shift, W):
    """Place the vertices of two pieces, if they are small polytopes; return the columns of W where each piece ends."""
    end_a = place_piece(A, (0.0, 0.0, 0.0), W, 0)
    return end_a, place_piece(B, shift, W, end_a)


@inline
def _supports(A, B, shift, W, ends, n):
    """Find the points of A and of B whose difference is least along n."""
    end_a, end_b = ends
    if end_a > 0:
        k = entry_of(farthest(W, 0, end_a, negated(n)))
        a = W[k], W[k + BLOCK], W[k + 2 * BLOCK]
    else:
        a = placed_support(A, negated(n))
    if end_b > end_a:
        k = entry_of(farthest(W, end_a, end_b, n))
        b = W[k], W[k + BLOCK], W[k + 2 * BLOCK]
    else:
        b = plus(placed_support(B, n), shift)
    return a, b


@inline
def _edge(a, b):
    """Reduce a simplex of two points: return how many are kept, and the direction from the origin to the kept part."""
    u = minus(b, a)
    if dot(u, a) < 0.0:
        return 2, cross(cross(u, a), u)
    return 1, a


@inline
def decide(A, B, shift, W, ends, n, error):
    """Decide most pairs of plain cores (no radii, no margin) in a few rounds, all in registers.

    The signs of a few products decide how the simplex moves; no closest point is computed. Results are proven in the
    same way as in `gjk_robust.run`: by a support plane clear of the origin, or by a tetrahedron that contains the
    origin beyond rounding. All other pairs are UNSETTLED and go to `measure`.

    Parameters
    ----------
    A, B : Placed
    shift : tuple of 3 float
        Vector from A's translation to B's translation.
    W : ndarray
        The `vertices` of `MEMORY`, filled by `begin`.
    ends : tuple of 2 int
        Result of `begin`.
    n : tuple of 3 float
        First direction, from A to B; not zero.
    error : float
        Result of `gjk_robust.rounding_error`.

    Returns
    -------
    status : int
        APART, TOUCHING or UNSETTLED.
    n : tuple of 3 float
        The last direction of the search, from A to B.
    points : int
        Number of points of the simplex; 0 if the first direction settled the pair.
    """
    first = n
    p = negated(n)
    k = 0
    # The simplex consists of the newest point a and up to three older points: b, c and e.
    b = c = e = (0.0, 0.0, 0.0)
    largest = 0.0
    for _ in range(DECIDE_ROUNDS):
        u, v = _supports(A, B, shift, W, ends, p)
        a = minus(u, v)
        plane = dot(p, a)
        length = np.sqrt(dot(p, p))
        if plane > error * length:
            return APART, negated(p), k
        largest = max(largest, abs(a[0]) + abs(a[1]) + abs(a[2]))
        if k == 0:
            k = 1
            b = a
            # As in `measure`, search between the first direction and the direction of the first point.
            kept = KEPT / length
            rest = (1.0 - KEPT) / np.sqrt(dot(a, a))
            p = kept * p[0] + rest * a[0], kept * p[1] + rest * a[1], kept * p[2] + rest * a[2]
            continue
        if k == 3:
            # Seen from the new point, b, c and e are in counter-clockwise order. The determinants f, g and h are
            # positive if the origin lies beyond the face that the new point forms with b and c, with c and e, and with
            # e and b, respectively.
            doubt = VOLUME_ERROR * UNIT_ROUNDOFF * largest * largest * largest
            ab, ac, ae = minus(b, a), minus(c, a), minus(e, a)
            face_bc = cross(ab, ac)
            f = -dot(face_bc, a)
            g = -dot(cross(ac, ae), a)
            h = -dot(cross(ae, ab), a)
            if f <= 0.0 and g <= 0.0 and h <= 0.0:
                volume = abs(dot(face_bc, ae))
                # The fourth determinant, for the base b, c, e, follows from f + g + h + base = -volume. The origin is
                # inside if all four determinants are negative beyond their rounding errors.
                if f < -doubt and g < -doubt and h < -doubt and volume + (f + g + h) > doubt:
                    return TOUCHING, negated(p), k
                return UNSETTLED, negated(p), k
            if f >= g and f >= h:
                pass
            elif g >= h:
                b, c = c, e
            else:
                b, c = e, b
            k = 2
        if k == 1:
            k, p = _edge(a, b)
            if k == 2:
                c = b
            b = a
        else:
            ab, ac = minus(b, a), minus(c, a)
            normal = cross(ab, ac)
            if dot(cross(normal, ac), a) < 0.0:
                if dot(ac, a) < 0.0:
                    b = c
                k, p = _edge(a, b)
                if k == 2:
                    c = b
                b = a
            elif dot(cross(ab, normal), a) < 0.0:
                k, p = _edge(a, b)
                if k == 2:
                    c = b
                b = a
            else:
                # The origin is inside the prism over the triangle. Keep the triangle, and order its points so that they
                # are counter-clockwise when seen from the origin.
                k = 3
                if dot(normal, a) <= 0.0:
                    p = negated(normal)
                    e, c = c, b
                else:
                    p = normal
                    e = b
                b = a
        if not dot(p, p) > 0.0:
            return UNSETTLED, first, k
    return UNSETTLED, negated(p), k


@inline
def _triangle(a, p, q):
    """Find the part of a triangle that is nearest to the origin, if the newest point a belongs to this part.

    Returns
    -------
    part : int
        0 for a, 1 for the edge ap, 2 for the edge aq, 3 for the inside; -1 if the part does not contain a, or if
        rounding prevents a decision.
    n : tuple of 3 float
        Normal of the part, away from the origin; unless the triangle is thin, it is orthogonal to the part to full
        precision.
    """
    u, w = minus(p, a), minus(q, a)
    along_p, along_q = dot(a, u), dot(a, w)
    n, across_p, across_q = cross(u, w), cross(a, u), cross(a, w)
    # Barycentric coordinates of the origin's projection onto the plane of the triangle, times |n|².
    of_q = dot(n, across_p)
    of_p = -dot(n, across_q)
    if of_p > 0.0 and of_q > 0.0:
        if of_p + of_q > dot(n, n):
            return -1, a
        return 3, scaled(np.copysign(1.0, dot(n, a)), n)
    if along_p >= 0.0 and along_q >= 0.0:
        return 0, a
    if of_q <= 0.0 and along_p < 0.0:
        return 1 if dot(p, u) > 0.0 else -1, cross(u, across_p)
    if of_p <= 0.0 and along_q < 0.0:
        return 2 if dot(q, w) > 0.0 else -1, cross(w, across_q)
    return -1, a


@njit()
def _squared_distance(a, p, q):
    """Squared distance of the origin from a triangle whose newest point a belongs to the nearest part."""
    part, n = _triangle(a, p, q)
    if part < 0:
        return np.inf
    height = dot(n, a)
    return height * height / dot(n, n)


@njit()
def _nearest_face(beyond_e, beyond_b, beyond_c, a, b, c, e):
    """Nearest face at the newest point a among the faces with the origin beyond: 0 for abc, 1 for ace, 2 for aeb."""
    d0 = _squared_distance(a, b, c) if beyond_e > 0.0 else np.inf
    d1 = _squared_distance(a, c, e) if beyond_b > 0.0 else np.inf
    d2 = _squared_distance(a, e, b) if beyond_c > 0.0 else np.inf
    if d0 <= d1 and d0 <= d2:
        return 0
    return 1 if d1 <= d2 else 2


@njit()
def _squared_off(n, u, w):
    """Remove the components of n along two edges, the longer edge last; do so twice, because the first pass rounds."""
    if dot(u, u) > dot(w, w):
        u, w = w, u
    over_u, over_w = 1.0 / dot(u, u), 1.0 / dot(w, w)
    for _ in range(2):
        n = along(n, -(over_u * dot(n, u)), u)
        n = along(n, -(over_w * dot(n, w)), w)
    return n


def measuring(supports):
    """Make a search that finds support points by a function like `_supports`."""

    @inline
    def search(A, B, shift, W, ends, n, error, reach, far, result):
        """Search as `measure` does, from any n; also return the last direction, a unit vector from A to B."""
        if not LEAST_SQUARE < dot(n, n) < np.inf:
            n = (1.0, 0.0, 0.0)
        p = scaled(-1.0 / np.sqrt(dot(n, n)), n)
        first = p
        k = 0
        # Points of the simplex, the newest one first, and the rounds in which they were added.
        b = c = e = (0.0, 0.0, 0.0)
        from_b = from_c = from_e = 0
        largest = 0.0
        lower = -np.inf
        length = np.inf
        status = UNSETTLED
        for r in range(MEASURE_ROUNDS):
            o = p
            if r == 1:
                # The first direction is already good, whereas the direction of the first point is poor. Searching along
                # a direction between them saves a round.
                o = (
                    KEPT * first[0] + (1.0 - KEPT) * p[0],
                    KEPT * first[1] + (1.0 - KEPT) * p[1],
                    KEPT * first[2] + (1.0 - KEPT) * p[2],
                )
            s, t = supports(A, B, shift, W, ends, o)
            m = _PATH + 6 * r
            W[m], W[m + 1], W[m + 2] = s
            W[m + 3], W[m + 4], W[m + 5] = t
            a = minus(s, t)
            plane = dot(p, a)
            closed = length - plane <= DISTANCE_TOLERANCE * length + ERROR_SHARE * error
            if r == 1:
                if closed:
                    continue  # The new point is no nearer, and `plane` is no bound, because o differs from p.
            else:
                if plane - error > lower:
                    lower = plane - error
                if lower > far:
                    status = APART
                    break
                if k > 0:
                    if closed:
                        status = NEAREST
                        break
                    if a == b or (k > 1 and a == c) or (k > 2 and a == e):
                        if length - lower <= LAST_GAP * error:
                            status = NEAREST
                        break
            largest = max(largest, abs(a[0]) + abs(a[1]) + abs(a[2]))
            if k == 0:
                k = 1
                n = a
            elif k == 1:
                k, n = _edge(a, b)
                if k == 2:
                    c, from_c = b, from_b
            else:
                if k == 3:
                    ab, ac, ae = minus(b, a), minus(c, a), minus(e, a)
                    face_bc = cross(ab, ac)
                    # If `beyond_e` is positive, the origin lies beyond the face opposite e.
                    volume = dot(face_bc, ae)
                    sign = np.copysign(1.0, volume)
                    beyond_e = sign * dot(face_bc, a)
                    beyond_b = sign * dot(cross(ac, ae), a)
                    beyond_c = sign * dot(cross(ae, ab), a)
                    count = (beyond_e > 0.0) + (beyond_b > 0.0) + (beyond_c > 0.0)
                    if count == 0:
                        doubt = VOLUME_ERROR * UNIT_ROUNDOFF * largest * largest * largest
                        # The determinant of the base must also be negative beyond its rounding error, because rounding
                        # decides the sign of the volume if the tetrahedron is flat.
                        base = -(abs(volume) + beyond_e + beyond_b + beyond_c)
                        if beyond_e < -doubt and beyond_b < -doubt and beyond_c < -doubt and base < -doubt:
                            status = OVERLAPPING
                        break
                    if count == 1:
                        face = (beyond_b > 0.0) + 2 * (beyond_c > 0.0)
                    else:
                        face = _nearest_face(beyond_e, beyond_b, beyond_c, a, b, c, e)
                    if face == 1:
                        b, from_b = e, from_e
                    elif face == 2:
                        c, from_c = e, from_e
                part, n = _triangle(a, b, c)
                if part < 0:
                    break
                if part == 3:
                    k = 3
                    u, w = minus(b, a), minus(c, a)
                    if dot(n, n) < THIN * (dot(u, u) * dot(w, w)):
                        n = _squared_off(n, u, w)
                    e, from_e = c, from_c
                    c, from_c = b, from_b
                elif part == 0:
                    k = 1
                else:
                    k = 2
                    if part == 1:
                        c, from_c = b, from_b
            squared = dot(n, n)
            if not LEAST_SQUARE < squared < np.inf:
                break
            b, from_b = a, r
            before = length
            p = scaled(1.0 / np.sqrt(squared), n)
            length = dot(p, b)
            if length <= reach:
                status = TOUCHING
                break
            # Leave the pair to `gjk_robust.run` if the search makes no progress, or if the gap is within the rounding
            # errors of the dot products.
            if not (4.0 * error < length < before):
                break
        if status == NEAREST:
            weight_b, weight_c, weight_e = 1.0, 0.0, 0.0
            if k == 2:
                weight_c = segment_weight(b, c)
                weight_b = 1.0 - weight_c
            elif k == 3:
                weight_b, weight_c, weight_e = triangle_weights(b, c, e)
            result[0], result[1], result[2] = negated(p)
            for m in range(6):
                result[3 + m] = (
                    weight_b * W[_PATH + 6 * from_b + m]
                    + weight_c * W[_PATH + 6 * from_c + m]
                    + weight_e * W[_PATH + 6 * from_e + m]
                )
        return status, lower, length, negated(p)

    return search


_measure = measuring(_supports)


@inline
def measure(A, B, shift, W, ends, n, error, reach, far, result):
    """Compute the distance of two cores, or decide on which side of a margin it is.

    Each round keeps the part of the simplex nearest to the origin and searches along the normal of this part (see
    `simplex.direction`), as `gjk_robust.run` does.

    Parameters
    ----------
    A, B, shift, W, ends, n, error
        Documented in `decide`.
    reach, far : float
        The search stops once the distance is known to be at most `reach`, or more than `far`; use -inf and inf to
        obtain the distance itself.
    result : ndarray, shape (9,)
        For NEAREST, receives the unit normal from A to B and the two nearest points.

    Returns
    -------
    status : int
        NEAREST, APART (more than `far`), TOUCHING (at most `reach`), OVERLAPPING or UNSETTLED.
    lower, upper : float
        Bounds on the distance of the cores.
    """
    status, lower, length, _ = measure_along(A, B, shift, W, ends, n, error, reach, far, result)
    return status, lower, length


@inline
def measure_along(A, B, shift, W, ends, n, error, reach, far, result):
    """Measure as `measure` does; also return the last direction, which separates the cores if they are APART."""
    return _measure(A, B, shift, W, ends, n, error, reach, far, result)
