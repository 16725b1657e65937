"""Penetration depth of two polytopes in about a microsecond: a small expanding polytope held in flat arrays.

The method is that of `epa`, for plain polytopes that overlap: both sets of corners are moved to the world once,
the faces are rows of 64, so that one comparison of eight vectors finds the nearest face or all faces
that a new point sees, and faces know each other by half-edges. Whatever is out of the ordinary (too many
faces, a rim that does not close, pieces that do not overlap) is handed back UNSETTLED, for the careful
search to decide.

References
----------
van den Bergen (2001), "Proximity queries and penetration depth computation on 3D game objects".
"""

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic

from loewner._kernels._jit import inline, njit
from loewner._kernels.ellipsoids.contact import POSITION_ROUNDINGS
from loewner._kernels.narrow.epa_robust import DEPTH_ACCURACY, WITNESS_WINDOW
from loewner._kernels.narrow.gjk_robust import rounding_error
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import POINTS_FROM, POINTS_TO, rotation_of
from loewner._kernels.simd.vectors import broadcast, load, mask, maximum, minimum, movemask, select, store

SETTLED, UNSETTLED = 0, 1

MAX_CORNERS = 1024  # of either polytope; above, moving all corners to the world costs more than it saves
MAX_FACES = 64  # one bit each in the masks; hulls of 20 points need 20 to 30
MAX_POINTS = MAX_FACES // 2 + 2  # by Euler's formula

# Flat work space: first corners of A and of B (x, y and z in rows of MAX_CORNERS), then the faces' normals and offsets
# (rows of MAX_FACES), then the points of A - B (rows of POINT_ROW).
_A = 0
_B = _A + 3 * MAX_CORNERS
_NX = _B + 3 * MAX_CORNERS
_NY = _NX + MAX_FACES
_NZ = _NY + MAX_FACES
_OFFSET = _NZ + MAX_FACES
_POINT = _OFFSET + MAX_FACES
_POINT_ROW = 4
_LANE = _POINT + _POINT_ROW * MAX_POINTS
_FLOATS = _LANE + 8

# The same for integers: a half-edge is 4 face + side; its twin, and the point it starts from; for each point its
# corners of A and B, and the new face whose rim edge starts there; the rim, as half-edges beyond it and first points.
_TWIN = 0
_ORIGIN = _TWIN + 4 * MAX_FACES
_CORNER_A = _ORIGIN + 4 * MAX_FACES
_CORNER_B = _CORNER_A + MAX_POINTS
_START = _CORNER_B + MAX_POINTS
_RIM = _START + MAX_POINTS
_RIM_FROM = _RIM + 3 * MAX_FACES
_INTEGERS = _RIM_FROM + 3 * MAX_FACES

# A face whose normal is shorter than this, relative to its longest side squared, has no direction worth the name.
FLAT_FACE = 1e-10

# How far outside its face, in barycentric coordinates, the origin's foot may be found by rounding alone.
FOOT_SLACK = 1e-9

THIRD = 1.0 / 3.0
SQRT3 = 1.7320508075688772


@intrinsic
def _highest(typingctx, x):
    """Largest of eight lanes."""
    return _reduced(x, ">")


@intrinsic
def _lowest(typingctx, x):
    """Smallest of eight lanes."""
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
    """Number of the lowest bit that is set; 64 if none is."""

    def generate(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return signature(types.int64, types.int64), generate


@intrinsic
def _lanes(typingctx, x):
    """Mask of eight lanes from the low eight bits of an integer."""

    def generate(context, builder, sig, args):
        return builder.bitcast(builder.trunc(args[0], ir.IntType(8)), ir.VectorType(ir.IntType(1), 8))

    return signature(mask, types.int64), generate


@inline
def _place(P, shift, W, at):
    """Write a polytope's corners, rotated and shifted, in whole vectors; returns how many vectors."""
    first = P.layout[P.piece, POINTS_FROM]
    vectors = (P.layout[P.piece, POINTS_TO] - first) // 8
    R = rotation_of(P)
    for c in range(vectors):
        i = 3 * (first + 8 * c)  # see `simd.support`
        px, py, pz = load(P.points, i), load(P.points, i + 8), load(P.points, i + 16)
        store(W, at + 8 * c, px * R[0] + py * R[1] + pz * R[2] + shift[0])
        store(W, at + MAX_CORNERS + 8 * c, px * R[3] + py * R[4] + pz * R[5] + shift[1])
        store(W, at + 2 * MAX_CORNERS + 8 * c, px * R[6] + py * R[7] + pz * R[8] + shift[2])
    return vectors


@inline
def _farthest(W, at, vectors, x, y, z):
    """Number of the placed corner farthest along a direction."""
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
def _add_point(W, K, p, vectors_a, vectors_b, x, y, z):
    """Write point p: the one of A - B farthest along a direction. Returns its support value."""
    i = _farthest(W, _A, vectors_a, x, y, z)
    j = _farthest(W, _B, vectors_b, -x, -y, -z)
    K[_CORNER_A + p] = i
    K[_CORNER_B + p] = j
    row = _POINT + _POINT_ROW * p
    px = W[_A + i] - W[_B + j]
    py = W[_A + MAX_CORNERS + i] - W[_B + MAX_CORNERS + j]
    pz = W[_A + 2 * MAX_CORNERS + i] - W[_B + 2 * MAX_CORNERS + j]
    W[row] = px
    W[row + 1] = py
    W[row + 2] = pz
    return px * x + py * y + pz * z


@inline
def _row(W, p):
    at = _POINT + _POINT_ROW * p
    return W[at], W[at + 1], W[at + 2]


@inline
def _make_face(W, K, f, u, v, w):
    """Write face f with the corners u, v, w; False if it is too thin to have a direction."""
    K[_ORIGIN + 4 * f] = u
    K[_ORIGIN + 4 * f + 1] = v
    K[_ORIGIN + 4 * f + 2] = w
    ux, uy, uz = _row(W, u)
    vx, vy, vz = _row(W, v)
    wx, wy, wz = _row(W, w)
    ax, ay, az = vx - ux, vy - uy, vz - uz
    bx, by, bz = wx - ux, wy - uy, wz - uz
    nx = ay * bz - az * by
    ny = az * bx - ax * bz
    nz = ax * by - ay * bx
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    scale = 1.0 / area
    W[_NX + f] = nx * scale
    W[_NY + f] = ny * scale
    W[_NZ + f] = nz * scale
    W[_OFFSET + f] = (nx * (ux + vx + wx) + ny * (uy + vy + wy) + nz * (uz + vz + wz)) * (THIRD * scale)
    return area > FLAT_FACE * max(ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz)


@inline
def _first_points(W, K, vectors_a, vectors_b, nx, ny, nz):
    """Points 0..3 of A - B: along the unit vector n, and three times square to it."""
    # Two unit vectors square to n (Duff and others 2017, "Building an orthonormal basis, revisited").
    sign = np.copysign(1.0, nz)
    s = -1.0 / (sign + nz)
    t = nx * ny * s
    ux, uy, uz = 1.0 + sign * nx * nx * s, sign * t, -sign * nx
    vx, vy, vz = 0.5 * SQRT3 * t, 0.5 * SQRT3 * (sign + ny * ny * s), -0.5 * SQRT3 * ny
    _add_point(W, K, 0, vectors_a, vectors_b, nx, ny, nz)
    _add_point(W, K, 1, vectors_a, vectors_b, ux, uy, uz)
    _add_point(W, K, 2, vectors_a, vectors_b, vx - 0.5 * ux, vy - 0.5 * uy, vz - 0.5 * uz)
    _add_point(W, K, 3, vectors_a, vectors_b, -vx - 0.5 * ux, -vy - 0.5 * uy, -vz - 0.5 * uz)


@inline
def _points_across(W, K, vectors_a, vectors_b, nx, ny, nz):
    """Points 0..3 of A - B once more, for pieces with few corners or thin ones: each across what is there already."""
    _add_point(W, K, 0, vectors_a, vectors_b, nx, ny, nz)
    _add_point(W, K, 1, vectors_a, vectors_b, -nx, -ny, -nz)
    ax, ay, az = _row(W, 0)
    bx, by, bz = _row(W, 1)
    ex, ey, ez = bx - ax, by - ay, bz - az
    if abs(ex) <= abs(ey) and abs(ex) <= abs(ez):
        px, py, pz = 0.0, -ez, ey
    elif abs(ey) <= abs(ez):
        px, py, pz = ez, 0.0, -ex
    else:
        px, py, pz = -ey, ex, 0.0
    _farther_point(W, K, 2, vectors_a, vectors_b, px, py, pz)
    cx, cy, cz = _row(W, 2)
    ux, uy, uz = cx - ax, cy - ay, cz - az
    _farther_point(W, K, 3, vectors_a, vectors_b, ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux)


@inline
def _farther_point(W, K, p, vectors_a, vectors_b, x, y, z):
    """Point p along a direction or against it, whichever is farther from point 0."""
    ax, ay, az = _row(W, 0)
    height = x * ax + y * ay + z * az
    against = _add_point(W, K, p + 1, vectors_a, vectors_b, -x, -y, -z)
    along = _add_point(W, K, p, vectors_a, vectors_b, x, y, z)
    if along - height < against + height:
        K[_CORNER_A + p] = K[_CORNER_A + p + 1]
        K[_CORNER_B + p] = K[_CORNER_B + p + 1]
        for c in range(3):
            W[_POINT + _POINT_ROW * p + c] = W[_POINT + _POINT_ROW * (p + 1) + c]


@inline
def _first_shell(W, K):
    """The four faces over points 0..3, facing outward; False if they are too thin."""
    ax, ay, az = _row(W, 0)
    bx, by, bz = _row(W, 1)
    cx, cy, cz = _row(W, 2)
    dx, dy, dz = _row(W, 3)
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    volume = (dx - ax) * (uy * vz - uz * vy) + (dy - ay) * (uz * vx - ux * vz) + (dz - az) * (ux * vy - uy * vx)
    one, two = (2, 1) if volume < 0.0 else (1, 2)
    # Face f lies opposite point f (points `one` and `two` swapped if need be).
    fine = _make_face(W, K, 0, one, two, 3)
    fine = _make_face(W, K, 1, 0, 3, two) and fine
    fine = _make_face(W, K, 2, 0, one, 3) and fine
    fine = _make_face(W, K, 3, 0, two, one) and fine
    # Sides: face 0 = (1 2 3), 1 = (0 3 2), 2 = (0 1 3), 3 = (0 2 1).
    _join(K, 0, 0, 3, 1)
    _join(K, 0, 1, 1, 1)
    _join(K, 0, 2, 2, 1)
    _join(K, 1, 0, 2, 2)
    _join(K, 1, 2, 3, 0)
    _join(K, 2, 0, 3, 2)
    return fine


@inline
def _join(K, f, e, g, h):
    K[_TWIN + 4 * f + e] = 4 * g + h
    K[_TWIN + 4 * g + h] = 4 * f + e


@inline
def _seen(W, live, x, y, z, error):
    """Mask of the faces in front of which the point lies."""
    seen = np.int64(0)
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
        least = minimum(select(_lanes(live >> c), load(W, _OFFSET + c), least), least)
    bound = _lowest(least)
    return _first_bit(_not_above(W, live, bound)), bound


@inline
def _not_above(W, live, bound):
    """Mask of the faces with an offset of at most `bound`."""
    found = np.int64(0)
    for c in range(0, MAX_FACES, 8):
        if live >> c == 0:
            break
        found |= movemask(load(W, _OFFSET + c) <= bound) << c
    return found & live


@inline
def _expand(W, K, live, seen, w):
    """Replace the faces seen from point w by a fan around it.

    Returns
    -------
    live : int
        Mask of the faces there are now, or 0 if the rim of what is seen is not one closed line, there is no room or
        a face is too thin.
    nearest : int
    least : float
        The face with the least offset, and that offset. It is sought among the old faces before the new
        ones are written, so that nothing waits for those.
    """
    nearest, least = _nearest(W, live & ~seen)
    count = 0
    rest = seen
    while rest != 0:
        f = _first_bit(rest)
        rest &= rest - 1
        for e in range(3):
            # Write every side, keep those whose other face stays: no branch to guess.
            twin = K[_TWIN + 4 * f + e]
            K[_RIM + count] = twin
            K[_RIM_FROM + count] = K[_ORIGIN + 4 * f + e]
            count += 1 - ((seen >> (twin >> 2)) & 1)
    unused = ~live | seen
    made = np.int64(0)
    fine = count >= 3
    last = np.int64(0)
    for r in range(count):
        if unused == 0:
            return np.int64(0), nearest, least
        last = _first_bit(unused)
        unused &= unused - 1
        made |= np.int64(1) << last
        twin = K[_RIM + r]
        u = K[_RIM_FROM + r]
        fine &= _make_face(W, K, last, u, K[_ORIGIN + twin], w)
        K[_TWIN + 4 * last] = twin
        K[_TWIN + twin] = 4 * last
        K[_START + u] = last
        offset = W[_OFFSET + last]
        if offset < least:
            nearest, least = last, offset
    # Walk along the rim; it must come back to where it began after all its edges and not before.
    back = 0
    g = last
    for _ in range(count):
        h = K[_START + K[_ORIGIN + 4 * g + 1]]
        K[_TWIN + 4 * g + 1] = 4 * h + 2
        K[_TWIN + 4 * h + 2] = 4 * g + 1
        g = h
        back += g == last
    if not fine or back != 1 or g != last:
        return np.int64(0), nearest, least
    return (live & ~seen) | made, nearest, least


@inline
def _foot(W, K, f):
    """Barycentric coordinates of the foot of the origin on face f."""
    ux, uy, uz = _row(W, K[_ORIGIN + 4 * f])
    vx, vy, vz = _row(W, K[_ORIGIN + 4 * f + 1])
    wx, wy, wz = _row(W, K[_ORIGIN + 4 * f + 2])
    nx, ny, nz = W[_NX + f], W[_NY + f], W[_NZ + f]
    a = _area(nx, ny, nz, vx, vy, vz, wx, wy, wz)
    b = _area(nx, ny, nz, wx, wy, wz, ux, uy, uz)
    c = _area(nx, ny, nz, ux, uy, uz, vx, vy, vz)
    total = a + b + c
    return a / total, b / total, c / total


@inline
def _area(nx, ny, nz, ux, uy, uz, vx, vy, vz):
    """Twice the area of the triangle (origin, u, v), seen along n."""
    ex, ey, ez = vx - ux, vy - uy, vz - uz
    return nx * (uy * ez - uz * ey) + ny * (uz * ex - ux * ez) + nz * (ux * ey - uy * ex)


@inline
def overlap_depth(A, B, n, W, K, result):
    """Depth of two polytopes that overlap.

    Parameters
    ----------
    A, B : Placed
    n : tuple of 3 float
        Where to look first: a normal from A to B, of any length.
    W, K : ndarray
        Work space, see `workspace`.
    result : ndarray, shape (9,)
        Receives the unit normal from A to B, and the witnesses relative to a's translation.

    Returns
    -------
    status : int
        UNSETTLED if the polytopes may be apart or anything is out of the ordinary.
    lower, upper : float
        Bounds on the depth to within rounding; `upper` is that of the support plane of the normal.
    """
    # Inlined, so that only three arrays are handed on: passing all of them costs as much as this does.
    shift = shift_between(A, B)
    error = rounding_error(A, B, shift)
    corners_a = A.layout[A.piece, POINTS_TO] - A.layout[A.piece, POINTS_FROM]
    corners_b = B.layout[B.piece, POINTS_TO] - B.layout[B.piece, POINTS_FROM]
    vectors_a = vectors_b = 0
    if max(corners_a, corners_b) <= MAX_CORNERS:
        vectors_a = _place(A, (0.0, 0.0, 0.0), W, _A)
        vectors_b = _place(B, shift, W, _B)
    return _placed_depth(vectors_a, vectors_b, error, n[0], n[1], n[2], W, K, result)


@njit()
def _placed_depth(vectors_a, vectors_b, error, nx, ny, nz, W, K, result):
    """`overlap_depth` of corners already placed, so many vectors of eight; none of them if they are too many."""
    if vectors_a == 0:
        return UNSETTLED, -np.inf, np.inf
    tolerance = error * (DEPTH_ACCURACY / POSITION_ROUNDINGS)
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not 0.0 < length < np.inf:
        nx, ny, nz, length = 0.0, 0.0, 1.0, 1.0
    nx, ny, nz = nx / length, ny / length, nz / length
    _first_points(W, K, vectors_a, vectors_b, nx, ny, nz)
    if not _first_shell(W, K):
        _points_across(W, K, vectors_a, vectors_b, nx, ny, nz)
        if not _first_shell(W, K):
            return UNSETTLED, -np.inf, np.inf
    live = np.int64(15)
    f, lower = _nearest(W, live)
    for used in range(4, MAX_POINTS):
        nx, ny, nz = W[_NX + f], W[_NY + f], W[_NZ + f]
        height = _add_point(W, K, used, vectors_a, vectors_b, nx, ny, nz)
        if height <= error:
            break
        # This face's own plane: another's may be as near already, but its normal is not the one at hand.
        if height - lower <= tolerance:
            if not _witness(W, K, live, f, lower + WITNESS_WINDOW * error, result):
                break
            return SETTLED, lower, height
        px, py, pz = _row(W, used)
        seen = _seen(W, live, px, py, pz, error) | (np.int64(1) << f)
        live, f, lower = _expand(W, K, live, seen, used)
        if live == 0:
            break
    return UNSETTLED, -np.inf, np.inf


@inline
def _witness(W, K, live, f, window, result):
    """Write the normal and the witnesses of face f, or of the face in the same plane that holds the origin's foot.

    False if the foot is in no face with an offset up to `window`.
    """
    a, b, c = _foot(W, K, f)
    inside = min(a, min(b, c))
    if not inside >= 0.0:
        # A parallelogram, the common face of two edges, is two triangles here; f may be the wrong one.
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
    result[0], result[1], result[2] = W[_NX + f], W[_NY + f], W[_NZ + f]
    u, v, w = K[_ORIGIN + 4 * f], K[_ORIGIN + 4 * f + 1], K[_ORIGIN + 4 * f + 2]
    for m in range(3):
        at = _A + MAX_CORNERS * m
        result[3 + m] = a * W[at + K[_CORNER_A + u]] + b * W[at + K[_CORNER_A + v]] + c * W[at + K[_CORNER_A + w]]
        at = _B + MAX_CORNERS * m
        result[6 + m] = a * W[at + K[_CORNER_B + u]] + b * W[at + K[_CORNER_B + v]] + c * W[at + K[_CORNER_B + w]]
    return True


@njit()
def workspace(wanted):
    """Arrays that `overlap_depth` writes to; one set serves any number of calls in turn."""
    return np.empty(_FLOATS if wanted else 1), np.empty(_INTEGERS if wanted else 1, np.int64)
