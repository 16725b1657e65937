"""Penetration depth of two polytopes in about a microsecond, by a small expanding polytope in flat arrays.

The method is the same as in `epa_robust`, for overlapping polytopes without radii. The corners of both polytopes are
moved to the world once. The faces are rows of 64, so one comparison of eight vectors finds the nearest face, or all
faces visible from a new point. Half-edges connect the faces. Unusual cases (too many faces, a rim that does not close,
pieces that do not overlap) return UNSETTLED, and the careful search decides them.

References
----------
van den Bergen (2001), "Proximity queries and penetration depth computation on 3D game objects".
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels._numba import signature
from loewner._kernels.codes import DEPTH_FOUND, UNSETTLED
from loewner._kernels.columns import POINTS_FROM, POINTS_TO
from loewner._kernels.linalg3 import across, cross, dot, minus, negated, plus, scaled
from loewner._kernels.narrow.epa_robust import DEPTH_ACCURACY, WITNESS_WINDOW, plane_with_care
from loewner._kernels.narrow.gjk_robust import rounding_error
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import rotation_of
from loewner._kernels.simd.vectors import broadcast, load, mask_of, maximum, minimum, movemask, select, store
from loewner._kernels.tolerances import POSITION_ROUNDINGS

# Maximum number of corners of a polytope. With more corners, transforming all of them to the world frame takes more
# time than it saves.
MAX_CORNERS = 1024
MAX_FACES = 64  # Maximum number of faces: a mask has one bit per face. Hulls of 20 points need 20 to 30 faces.
MAX_POINTS = MAX_FACES // 2 + 2  # Number of points of a closed surface of MAX_FACES triangles, by Euler's formula.

# Offsets into the workspace of floats. First come the corners of A and then the corners of B (x, y and z, each in a row
# of MAX_CORNERS numbers), then the normals and offsets of the faces (in rows of MAX_FACES numbers), and then the points
# of A - B (each in a row of _POINT_ROW numbers).
_A = 0
_B = _A + 3 * MAX_CORNERS
_NX = _B + 3 * MAX_CORNERS
_NY = _NX + MAX_FACES
_NZ = _NY + MAX_FACES
_OFFSET = _NZ + MAX_FACES
_POINT = _OFFSET + MAX_FACES
_POINT_ROW = 4
_LANE = _POINT + _POINT_ROW * MAX_POINTS
FLOATS = _LANE + 8

# Offsets into the workspace of integers. Side s of face f is the half-edge with the number 4 f + s. For each half-edge,
# the workspace holds the twin and the first point. For each point, it holds the corners of A and B, and the new face
# whose rim edge starts at the point. For each edge of the rim, it holds the half-edge beyond the rim, and the first
# point of the edge.
_TWIN = 0
_ORIGIN = _TWIN + 4 * MAX_FACES
_CORNER_A = _ORIGIN + 4 * MAX_FACES
_CORNER_B = _CORNER_A + MAX_POINTS
_START = _CORNER_B + MAX_POINTS
_RIM = _START + MAX_POINTS
_RIM_FROM = _RIM + 3 * MAX_FACES
# Input of `proven_depth`: the mask of the faces, the number of points, and the numbers of vectors that hold the corners
# of A and of B.
_LEFT = _RIM_FROM + 3 * MAX_FACES
INTEGERS = _LEFT + 4

# A face has no reliable direction if the cross product of two sides is no longer than FLAT_FACE times the square of the
# longer one.
FLAT_FACE = 1e-10

# Largest amount, in barycentric coordinates, by which rounding may place the foot of the perpendicular from the origin
# outside its face.
FOOT_SLACK = 1e-9

# Indices of the four points of the first shell, and also of its four faces.
_P0, _P1, _P2, _P3 = 0, 1, 2, 3

# Twins of the half-edges of the first shell. Each face has three entries that are used and a fourth that is not; the
# points of the faces are (1 2 3), (0 3 2), (0 1 3) and (0 2 1).
_FIRST_TWINS = (13, 5, 9, 0, 10, 1, 12, 0, 14, 2, 4, 0, 6, 0, 8, 0)

THIRD = 1.0 / 3.0
SQRT3 = 1.7320508075688772


@intrinsic
def _highest(typingctx, x):
    """Return the largest of eight lanes."""
    return _reduced(x, ">")


@intrinsic
def _lowest(typingctx, x):
    """Return the smallest of eight lanes."""
    return _reduced(x, "<")


def _reduced(x, comparison):
    def generate(context, builder, sig, args):
        value = args[0]
        i32 = ir.IntType(32)
        nothing = ir.Constant(value.type, ir.Undefined)
        for half in (4, 2, 1):
            low, high = (
                builder.shuffle_vector(
                    value, nothing, ir.Constant(ir.VectorType(i32, half), list(range(first, first + half)))
                )
                for first in (0, half)
            )
            value = builder.select(builder.fcmp_ordered(comparison, low, high), low, high)
            nothing = ir.Constant(value.type, ir.Undefined)
        return builder.extract_element(value, ir.Constant(i32, 0))

    return signature(types.float64, x), generate


@intrinsic
def _first_bit(typingctx, x):
    """Return the number of the lowest set bit; 64 if no bit is set."""

    def generate(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return signature(types.int64, types.int64), generate


@inline
def _place(P, shift, W, at):
    """Write a polytope's corners, rotated and shifted, in whole vectors; return the number of vectors."""
    first = P.layout[P.piece, POINTS_FROM]
    vectors = (P.layout[P.piece, POINTS_TO] - first) // 8
    R = rotation_of(P)
    for c in range(vectors):
        i = 3 * (first + 8 * c)  # see `pieces.support`
        px, py, pz = load(P.points, i), load(P.points, i + 8), load(P.points, i + 16)
        store(W, at + 8 * c, px * R[0] + py * R[1] + pz * R[2] + shift[0])
        store(W, at + MAX_CORNERS + 8 * c, px * R[3] + py * R[4] + pz * R[5] + shift[1])
        store(W, at + 2 * MAX_CORNERS + 8 * c, px * R[6] + py * R[7] + pz * R[8] + shift[2])
    return vectors


@inline
def _farthest(W, at, vectors, n):
    """Return the number of the placed corner farthest along a direction."""
    x, y, z = n
    most = load(W, at) * x + load(W, at + MAX_CORNERS) * y + load(W, at + 2 * MAX_CORNERS) * z
    where = broadcast(0.0)
    for c in range(1, vectors):
        i = at + 8 * c
        value = load(W, i) * x + load(W, i + MAX_CORNERS) * y + load(W, i + 2 * MAX_CORNERS) * z
        where = select(value > most, broadcast(8.0 * c), where)
        most = maximum(value, most)
    lane = _first_bit(movemask(most >= broadcast(_highest(most)))) & 7
    store(W, _LANE, where)
    return np.int64(W[_LANE + lane]) + lane


@inline
def _corner(W, at, i):
    """Return placed corner i of the polytope whose corners start at `at`."""
    return W[at + i], W[at + MAX_CORNERS + i], W[at + 2 * MAX_CORNERS + i]


@inline
def _add_point(W, K, p, vectors_a, vectors_b, n):
    """Write the point of A - B farthest along a direction as point p; return its support value."""
    i = _farthest(W, _A, vectors_a, n)
    j = _farthest(W, _B, vectors_b, negated(n))
    K[_CORNER_A + p] = i
    K[_CORNER_B + p] = j
    point = minus(_corner(W, _A, i), _corner(W, _B, j))
    row = _POINT + _POINT_ROW * p
    W[row], W[row + 1], W[row + 2] = point
    return dot(point, n)


@inline
def _point(W, p):
    row = _POINT + _POINT_ROW * p
    return W[row], W[row + 1], W[row + 2]


@inline
def _normal(W, f):
    return W[_NX + f], W[_NY + f], W[_NZ + f]


@inline
def _corners(K, f):
    """Return the numbers of the three points of face f."""
    return K[_ORIGIN + 4 * f], K[_ORIGIN + 4 * f + 1], K[_ORIGIN + 4 * f + 2]


@inline
def _make_face(W, K, f, u, v, w):
    """Write face f with the corners u, v, w; return False if it is too thin to have a direction."""
    K[_ORIGIN + 4 * f], K[_ORIGIN + 4 * f + 1], K[_ORIGIN + 4 * f + 2] = u, v, w
    one, two, three = _point(W, u), _point(W, v), _point(W, w)
    a, b = minus(two, one), minus(three, one)
    n = cross(a, b)
    area = np.sqrt(dot(n, n))
    scale = 1.0 / area
    W[_NX + f], W[_NY + f], W[_NZ + f] = n[0] * scale, n[1] * scale, n[2] * scale
    W[_OFFSET + f] = dot(n, plus(plus(one, two), three)) * (THIRD * scale)
    return area > FLAT_FACE * max(dot(a, a), dot(b, b))


@inline
def _first_points(W, K, vectors_a, vectors_b, n):
    """Find points 0..3 of A - B: one along the unit vector n, and three along directions perpendicular to n."""
    u, v = across(n)
    v, half = scaled(0.5 * SQRT3, v), scaled(0.5, u)
    _add_point(W, K, _P0, vectors_a, vectors_b, n)
    _add_point(W, K, _P1, vectors_a, vectors_b, u)
    _add_point(W, K, _P2, vectors_a, vectors_b, minus(v, half))
    _add_point(W, K, _P3, vectors_a, vectors_b, minus(negated(v), half))


@inline
def _points_across(W, K, vectors_a, vectors_b, n):
    """Find points 0..3 of A - B again, for thin pieces or few corners, each in a direction across the previous ones."""
    _add_point(W, K, _P0, vectors_a, vectors_b, n)
    _add_point(W, K, _P1, vectors_a, vectors_b, negated(n))
    a, b = _point(W, _P0), _point(W, _P1)
    e = minus(b, a)
    if abs(e[0]) <= abs(e[1]) and abs(e[0]) <= abs(e[2]):
        p = 0.0, -e[2], e[1]
    elif abs(e[1]) <= abs(e[2]):
        p = e[2], 0.0, -e[0]
    else:
        p = -e[1], e[0], 0.0
    _farther_point(W, K, _P2, vectors_a, vectors_b, p)
    _farther_point(W, K, _P3, vectors_a, vectors_b, cross(e, minus(_point(W, _P2), a)))


@inline
def _farther_point(W, K, p, vectors_a, vectors_b, n):
    """Write point p: the farthest point along a direction or its opposite, the one that is farther from point 0."""
    height = dot(n, _point(W, _P0))
    against = _add_point(W, K, p + 1, vectors_a, vectors_b, negated(n))
    along = _add_point(W, K, p, vectors_a, vectors_b, n)
    if along - height < against + height:
        K[_CORNER_A + p] = K[_CORNER_A + p + 1]
        K[_CORNER_B + p] = K[_CORNER_B + p + 1]
        for c in range(3):
            W[_POINT + _POINT_ROW * p + c] = W[_POINT + _POINT_ROW * (p + 1) + c]


@inline
def _first_shell(W, K):
    """Make the four faces over points 0..3, facing outward; return False if they are too thin."""
    a, b, c, d = _point(W, _P0), _point(W, _P1), _point(W, _P2), _point(W, _P3)
    volume = dot(minus(d, a), cross(minus(b, a), minus(c, a)))
    one, two = (_P2, _P1) if volume < 0.0 else (_P1, _P2)
    # Face f lies opposite point f. The points `one` and `two` are swapped if necessary, so that the faces point
    # outward.
    fine = _make_face(W, K, _P0, one, two, _P3)
    fine = _make_face(W, K, _P1, _P0, _P3, two) and fine
    fine = _make_face(W, K, _P2, _P0, one, _P3) and fine
    fine = _make_face(W, K, _P3, _P0, two, one) and fine
    for edge in range(16):
        K[_TWIN + edge] = _FIRST_TWINS[edge]
    return fine


@inline
def _seen(W, live, point, error):
    """Mask of the faces that a point lies in front of."""
    x, y, z = point
    seen = 0
    for c in range(0, MAX_FACES, 8):
        if live >> c == 0:
            break
        height = load(W, _NX + c) * x + load(W, _NY + c) * y + load(W, _NZ + c) * z
        seen |= movemask(height > load(W, _OFFSET + c) + error) << c
    return seen & live


@inline
def _nearest(W, live):
    """Number and offset of the live face with the least offset."""
    least = broadcast(np.inf)
    for c in range(0, MAX_FACES, 8):
        if live >> c == 0:
            break
        least = minimum(select(mask_of(live >> c), load(W, _OFFSET + c), least), least)
    bound = _lowest(least)
    return _first_bit(_not_above(W, live, bound)), bound


@inline
def _not_above(W, live, bound):
    """Mask of the faces with an offset of at most `bound`."""
    mask = 0
    for c in range(0, MAX_FACES, 8):
        if live >> c == 0:
            break
        mask |= movemask(load(W, _OFFSET + c) <= bound) << c
    return mask & live


@inline
def _expand(W, K, live, seen, w):
    """Replace the faces seen from point w by a fan around it.

    Returns
    -------
    live : int
        Mask of the current faces. The mask is 0 if the rim of the visible faces is not one closed line, if no row for a
        face is left, or if a face is too thin.
    nearest : int
    least : float
        The face with the least offset, and that offset. The old faces are searched before the new faces are written, so
        that this search need not wait for them.
    """
    nearest, least = _nearest(W, live & ~seen)
    count = 0
    rest = seen
    while rest != 0:
        f = _first_bit(rest)
        rest &= rest - 1
        for e in range(3):
            # To avoid a branch, write an entry for every side. The next side overwrites this entry unless the face
            # beyond the current side is kept.
            twin = K[_TWIN + 4 * f + e]
            K[_RIM + count] = twin
            K[_RIM_FROM + count] = K[_ORIGIN + 4 * f + e]
            count += 1 - ((seen >> (twin >> 2)) & 1)
    unused = ~live | seen
    fan = 0
    fine = count >= 3
    last = 0
    for r in range(count):
        if unused == 0:
            return 0, nearest, least
        last = _first_bit(unused)
        unused &= unused - 1
        fan |= 1 << last
        twin = K[_RIM + r]
        u = K[_RIM_FROM + r]
        fine &= _make_face(W, K, last, u, K[_ORIGIN + twin], w)
        K[_TWIN + 4 * last] = twin
        K[_TWIN + twin] = 4 * last
        K[_START + u] = last
        offset = W[_OFFSET + last]
        if offset < least:
            nearest, least = last, offset
    # Walk along the rim: the walk must return to its start after it has passed all edges of the rim, and not earlier.
    back = 0
    g = last
    for _ in range(count):
        h = K[_START + K[_ORIGIN + 4 * g + 1]]
        K[_TWIN + 4 * g + 1] = 4 * h + 2
        K[_TWIN + 4 * h + 2] = 4 * g + 1
        g = h
        back += g == last
    if not fine or back != 1 or g != last:
        return 0, nearest, least
    return (live & ~seen) | fan, nearest, least


@inline
def _foot(W, K, f):
    """Barycentric coordinates of the foot of the origin on face f."""
    u, v, w = _corners(K, f)
    one, two, three, n = _point(W, u), _point(W, v), _point(W, w), _normal(W, f)
    a, b, c = _area(n, two, three), _area(n, three, one), _area(n, one, two)
    total = a + b + c
    return a / total, b / total, c / total


@inline
def _area(n, u, v):
    """Twice the area of the triangle (origin, u, v), seen along n."""
    return dot(n, cross(u, minus(v, u)))


@inline
def overlap_depth(A, B, n, W, K, result):
    """Depth of two polytopes that overlap.

    Parameters
    ----------
    A, B : Placed
    n : tuple of 3 float
        Direction to try first: a normal from A to B, of any length.
    W, K : ndarray
        Workspace, see `workspace`.
    result : ndarray, shape (9,)
        Receives the unit normal from A to B, and the witnesses relative to a's translation.

    Returns
    -------
    status : int
        UNSETTLED if the polytopes may be apart, and in unusual cases.
    lower, upper : float
        Bounds on the depth, up to rounding; `upper` is the offset of the support plane with the returned normal.
    """
    # This function is inlined, because passing the arrays of A and B would take as long as the function itself.
    shift = shift_between(A, B)
    error = rounding_error(A, B, shift)
    corners_a = A.layout[A.piece, POINTS_TO] - A.layout[A.piece, POINTS_FROM]
    corners_b = B.layout[B.piece, POINTS_TO] - B.layout[B.piece, POINTS_FROM]
    vectors_a = vectors_b = 0
    if max(corners_a, corners_b) <= MAX_CORNERS:
        vectors_a = _place(A, (0.0, 0.0, 0.0), W, _A)
        vectors_b = _place(B, shift, W, _B)
    return _placed_depth(vectors_a, vectors_b, error, n, W, K, result)


@apart
def _placed_depth(vectors_a, vectors_b, error, n, W, K, result):
    """Do the work of `overlap_depth` for placed corners, given by their numbers of vectors (0 if too many)."""
    if vectors_a == 0:
        return UNSETTLED, -np.inf, np.inf
    tolerance = error * (DEPTH_ACCURACY / POSITION_ROUNDINGS)
    length = np.sqrt(dot(n, n))
    if not 0.0 < length < np.inf:
        n, length = (0.0, 0.0, 1.0), 1.0
    n = n[0] / length, n[1] / length, n[2] / length
    _first_points(W, K, vectors_a, vectors_b, n)
    if not _first_shell(W, K):
        _points_across(W, K, vectors_a, vectors_b, n)
        if not _first_shell(W, K):
            return UNSETTLED, -np.inf, np.inf
    live = 15
    f, lower = _nearest(W, live)
    for used in range(4, MAX_POINTS):
        height = _add_point(W, K, used, vectors_a, vectors_b, _normal(W, f))
        if height <= error:
            break
        # Use the plane of this face, because another face may be just as near but have a different normal.
        if height - lower <= tolerance:
            if not _witness(W, K, live, f, lower + WITNESS_WINDOW * error, result):
                break
            K[_LEFT], K[_LEFT + 1], K[_LEFT + 2], K[_LEFT + 3] = live, used, vectors_a, vectors_b
            return DEPTH_FOUND, lower, height
        seen = _seen(W, live, _point(W, used), error) | (1 << f)
        live, f, lower = _expand(W, K, live, seen, used)
        if live == 0:
            break
    return UNSETTLED, -np.inf, np.inf


@inline
def _witness(W, K, live, f, window, result):
    """Write the normal and the witnesses of face f, or of the face in the same plane that contains the origin's foot.

    Returns False if no face with an offset up to `window` contains the foot.
    """
    a, b, c = _foot(W, K, f)
    inside = min(a, min(b, c))
    if not inside >= 0.0:
        # A parallelogram (a face spanned by two edges) consists of two triangles here, and f may be the one that does
        # not contain the foot of the perpendicular from the origin.
        rest = _not_above(W, live, window)
        while rest != 0:
            g = _first_bit(rest)
            rest &= rest - 1
            p, q, r = _foot(W, K, g)
            if min(p, min(q, r)) > inside:
                f, a, b, c = g, p, q, r
                inside = min(p, min(q, r))
    if not inside >= -FOOT_SLACK:
        return False
    result[0], result[1], result[2] = _normal(W, f)
    u, v, w = _corners(K, f)
    for m in range(3):
        at = _A + MAX_CORNERS * m
        result[3 + m] = a * W[at + K[_CORNER_A + u]] + b * W[at + K[_CORNER_A + v]] + c * W[at + K[_CORNER_A + w]]
        at = _B + MAX_CORNERS * m
        result[6 + m] = a * W[at + K[_CORNER_B + u]] + b * W[at + K[_CORNER_B + v]] + c * W[at + K[_CORNER_B + w]]
    return True


@njit()
def proven_depth(error, W, K, result):
    """Lower bound, up to `error`, on the depth that `overlap_depth` has just found; 0 if no depth is proven.

    The faces form a closed surface of points of A - B. If this surface winds around the origin at some distance, a ball
    about the origin lies in A - B (certified.md B49). The search continues until the ball touches a face of A - B
    itself, whose normal and witnesses are written to `result`.
    """
    live, first, vectors_a, vectors_b = K[_LEFT], K[_LEFT + 1], K[_LEFT + 2], K[_LEFT + 3]
    proven = 0.0
    for used in range(first, MAX_POINTS):
        sound, rest = True, live
        while rest != 0:
            sound &= _measure_face(W, K, _first_bit(rest), error)
            rest &= rest - 1
        if not sound:
            break
        f, lower = _nearest(W, live)
        if lower > proven:
            proven = lower
            _witness(W, K, live, f, lower + WITNESS_WINDOW * error, result)
        if _add_point(W, K, used, vectors_a, vectors_b, _normal(W, f)) - lower <= error:
            break
        seen = _seen(W, live, _point(W, used), error) | (1 << f)
        live, f, lower = _expand(W, K, live, seen, used)
        if live == 0:
            break
    return proven


@inline
def _measure_face(W, K, f, error):
    """Compute a face's normal and offset with more care; return whether the origin is certainly behind the face."""
    u, v, w = _corners(K, f)
    behind, nearest, n = plane_with_care(_point(W, u), _point(W, v), _point(W, w), error)
    W[_NX + f], W[_NY + f], W[_NZ + f] = n
    W[_OFFSET + f] = nearest
    return behind


@njit()
def workspace():
    """Return arrays to which `overlap_depth` writes; further calls can reuse them."""
    return np.empty(FLOATS), np.empty(INTEGERS, np.int64)
