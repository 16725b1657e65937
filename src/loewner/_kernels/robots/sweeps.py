"""Seven intervals of a motion side by side: bounds of bodies, and pairs that are certainly apart in between.

In each interval, a point stays within `grow` of its chord. A body therefore stays within the hull of its bounds at both
ends, widened by `grow`: a ball about a segment, a box, or a half-space that contains both ellipsoids.

In a row of vectors, a quantity at the eight configurations takes STRIDE numbers; the first eight count. Reading from
the second number on yields the later end of each interval, with the last lane unused.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.columns import OUTER_CENTER, OUTER_RADIUS, OUTER_SHAPE
from loewner._kernels.ellipsoids.contact import normal_at, outward_width, position_error
from loewner._kernels.linalg3 import apply, apply_transposed, dot, minus, plus, rotated_shape, trace
from loewner._kernels.robots.kinematics import rotation_of_link, translation_of_link
from loewner._kernels.robots.placement import HALF_X, HALF_Y, HALF_Z, WIDE, X, Y, Z
from loewner._kernels.simd.vectors import (
    LANES,
    absolute,
    broadcast,
    highest,
    load,
    lowest,
    maximum,
    minimum,
    movemask,
    next_lanes,
    scatter_transpose,
    share_of_roots,
    sqrt,
    store,
)
from loewner._kernels.tolerances import SHAPE_ROUNDINGS, UNIT_ROUNDOFF
from loewner._kernels.trees.boxes import lowered, raised
from loewner._kernels.trees.piece_tree import BEND

INTERVALS = LANES - 1
EVERY = (1 << INTERVALS) - 1

STRIDE = 2 * LANES

# Offsets of the numbers of a body. For each configuration: the center and the half-widths of the body's box. For each
# interval: the middle of the chord of the center's path, half the length of this chord, and the middle and the
# half-widths of a box. For all intervals together: the middle and the half-widths of a box.
_MIDDLE = 6 * STRIDE
_HALF_CHORD = _MIDDLE + 3 * LANES
_BOX = _HALF_CHORD + LANES
_WHOLE = _BOX + 6 * LANES
BODY = _WHOLE + LANES

SWEPT, PLACED_PIECES, PLACED = 1, 2, 4  # Bits for the data of a body that are written: bounds, pieces, poses.

# Offsets of the numbers of a group of static bodies, see `records.MotionTables`.
_MARGIN = 6 * LANES
_SIZE = 7 * LANES
GROUP = 8 * LANES

# Offsets of the numbers of a piece: the center and the shape matrix of its outer ellipsoid.
_SHAPE = 3 * STRIDE
PIECE = 9 * STRIDE

# Fraction by which radii and half-widths are enlarged, to allow for rounding, and for poses that are accepted as rigid
# although they stretch lengths slightly.
STRETCH = 1e-5  # certified.md B31
WIDER = 1.0 + STRETCH

TINY = 1e-300


class Swept(NamedTuple):
    """Flat arrays that `sweep`, `place_body` and `place_pieces` write.

    Attributes
    ----------
    poses : ndarray, shape (LANES * moving bodies, 4, 4)
    bodies : ndarray, BODY numbers per body
    pieces : ndarray, PIECE numbers per piece
    done : ndarray of int64, an entry per body
        Bits of the parts that have been written; the caller sets them to 0 for each block.
    links : ndarray
        Output of the kinematics.
    numbers : ndarray of int64, shape (LANES,)
    """

    poses: Any
    bodies: Any
    pieces: Any
    done: Any
    links: Any
    numbers: Any


@inline
def _store_three(rows, at, v):
    store(rows, at, v[0])
    store(rows, at + STRIDE, v[1])
    store(rows, at + 2 * STRIDE, v[2])


@inline
def _load_three(rows, at):
    return load(rows, at), load(rows, at + STRIDE), load(rows, at + 2 * STRIDE)


@inline
def _store_six(rows, at, Q):
    _store_three(rows, at, (Q[0], Q[1], Q[2]))
    _store_three(rows, at + 3 * STRIDE, (Q[3], Q[4], Q[5]))


@inline
def _load_six(rows, at):
    return _load_three(rows, at) + _load_three(rows, at + 3 * STRIDE)


@inline
def outer_shape(table, p):
    """Shape matrix of the outer ellipsoid of a piece, in a table like `Pieces.hot`."""
    k = OUTER_SHAPE
    return table[p, k], table[p, k + 1], table[p, k + 2], table[p, k + 3], table[p, k + 4], table[p, k + 5]


@inline
def outer_center(table, p):
    """Center of the outer ellipsoid of a piece."""
    return table[p, OUTER_CENTER], table[p, OUTER_CENTER + 1], table[p, OUTER_CENTER + 2]


@inline
def _place_piece(hot, p, R, t, rows):
    """Write the center and the shape of a piece; return both."""
    center = plus(apply(R, outer_center(hot, p)), t)
    Q = rotated_shape(R, outer_shape(hot, p))
    _store_three(rows, p * PIECE, center)
    _store_six(rows, p * PIECE + _SHAPE, Q)
    return center, Q


@inline
def place_pieces(problem, pieces, body, to):
    """Write the centers and shapes of all pieces of a body."""
    to.done[body] |= PLACED_PIECES
    link = problem.link[body]
    R, t = rotation_of_link(to.links, link), translation_of_link(to.links, link)
    for p in range(pieces.piece_start[body], pieces.piece_start[body + 1]):
        _place_piece(pieces.hot, p, R, t, to.pieces)


@inline
def place_body(problem, body, to):
    """Write the poses of a moving body."""
    to.done[body] |= PLACED
    link, zero, one, nought = problem.link[body], broadcast(0.0), broadcast(1.0), 0
    R, t = rotation_of_link(to.links, link), translation_of_link(to.links, link)
    for lane in range(LANES):
        to.numbers[lane] = body * LANES + lane
    upper = (R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1])
    scatter_transpose(to.poses, 16, to.numbers, nought, nought, upper)
    lower = (R[6], R[7], R[8], t[2], zero, zero, zero, one)
    scatter_transpose(to.poses, 16, to.numbers, nought, 8, lower)


@inline
def sweep(problem, pieces, body, to):
    """Write bounds of a moving body over the intervals, from the placed links."""
    link = problem.link[body]
    R, t = rotation_of_link(to.links, link), translation_of_link(to.links, link)
    p = pieces.piece_start[body]
    simple = pieces.piece_start[body + 1] - p == 1
    to.done[body] = SWEPT | PLACED_PIECES if simple else SWEPT
    ball, at = problem.ball, body * BODY
    if simple:
        center, Q = _place_piece(pieces.hot, p, R, t, to.pieces)
        slack = SHAPE_ROUNDINGS * trace(Q)
        half = sqrt(Q[0] + slack), sqrt(Q[3] + slack), sqrt(Q[5] + slack)
    else:
        center = plus(apply(R, (ball[body, 0], ball[body, 1], ball[body, 2])), t)
        wide = broadcast(ball[body, 3])
        half = wide, wide, wide
    _store_three(to.bodies, at, center)
    _store_three(to.bodies, at + 3 * STRIDE, half)
    later = next_lanes(center[0]), next_lanes(center[1]), next_lanes(center[2])
    way = minus(later, center)
    store(to.bodies, at + _HALF_CHORD, 0.5 * sqrt(dot(way, way)))
    for c in range(3):
        first, wide = center[c], half[c]
        low, high = first - wide, first + wide
        least, most = lowest(low), highest(high)
        to.bodies[at + _WHOLE + c], to.bodies[at + _WHOLE + 3 + c] = 0.5 * (least + most), 0.5 * (most - least)
        low, high = minimum(low, next_lanes(low)), maximum(high, next_lanes(high))
        store(to.bodies, at + _MIDDLE + c * LANES, 0.5 * (first + later[c]))
        store(to.bodies, at + _BOX + c * LANES, 0.5 * (low + high))
        store(to.bodies, at + _BOX + (3 + c) * LANES, 0.5 * (high - low))


@inline
def near_group(groups, g, body, keep, skew, clear, to):
    """Bits of the static bodies of a group that a moving body may come near in any interval.

    Bodies must be farther apart than the sum of `keep`, their margins times 1 + skew, and an error of positions times
    `clear`.
    """
    k, at = g * GROUP, body * BODY + _WHOLE
    keep = (1.0 + skew) * load(groups, k + _MARGIN) + keep
    keep = keep + clear * position_error(load(groups, k + _SIZE), UNIT_ROUNDOFF)
    x = absolute(load(groups, k) - to.bodies[at])
    y = absolute(load(groups, k + LANES) - to.bodies[at + 1])
    z = absolute(load(groups, k + 2 * LANES) - to.bodies[at + 2])
    k += 3 * LANES
    far = x > (load(groups, k) + (keep + to.bodies[at + 3])) * WIDER
    far = far | (y > (load(groups, k + LANES) + (keep + to.bodies[at + 4])) * WIDER)
    far = far | (z > (load(groups, k + 2 * LANES) + (keep + to.bodies[at + 5])) * WIDER)
    return ~movemask(far)


@inline
def near_standing(problem, body, k, keep, to):
    """Bits of the intervals in which a moving body may come within `keep` of the static body in row k."""
    at, still = body * BODY, problem.standing
    r = minus(_middle(to, at), (np.float64(still[k, X]), np.float64(still[k, Y]), np.float64(still[k, Z])))
    far = load(to.bodies, at + _HALF_CHORD) + (problem.ball[body, 3] + np.float64(still[k, WIDE]) + keep)
    far = far * WIDER
    near = EVERY & ~movemask(dot(r, r) > far * far)
    if near != 0:
        box = at + _BOX
        x = absolute(load(to.bodies, box) - np.float64(still[k, X]))
        y = absolute(load(to.bodies, box + LANES) - np.float64(still[k, Y]))
        z = absolute(load(to.bodies, box + 2 * LANES) - np.float64(still[k, Z]))
        box += 3 * LANES
        clear = x > (load(to.bodies, box) + (np.float64(still[k, HALF_X]) + keep)) * WIDER
        clear = clear | (y > (load(to.bodies, box + LANES) + (np.float64(still[k, HALF_Y]) + keep)) * WIDER)
        clear = clear | (z > (load(to.bodies, box + 2 * LANES) + (np.float64(still[k, HALF_Z]) + keep)) * WIDER)
        near &= ~movemask(clear)
    return near


@inline
def _middle(to, at):
    """Middles of a body's chords."""
    k = at + _MIDDLE
    return load(to.bodies, k), load(to.bodies, k + LANES), load(to.bodies, k + 2 * LANES)


@inline
def near_in_world(problem, body, other, keep, to):
    """Bits of the intervals in which two moving bodies may come within `keep` of each other, seen from the world."""
    a, b = body * BODY, other * BODY
    for k in range(_WHOLE, _WHOLE + 3):
        wide = to.bodies[a + k + 3] + to.bodies[b + k + 3]
        if abs(to.bodies[a + k] - to.bodies[b + k]) > (wide + keep) * WIDER:
            return 0
    r = minus(_middle(to, a), _middle(to, b))
    far = load(to.bodies, a + _HALF_CHORD) + load(to.bodies, b + _HALF_CHORD)
    far = (far + (problem.ball[body, 3] + problem.ball[other, 3] + keep)) * WIDER
    return EVERY & ~movemask(dot(r, r) > far * far)


@inline
def _near_balls(rows, at, center, radii, keep):
    """Bits of intervals in which a ball (center in the rows from `at`) may come within `keep` of a static ball."""
    first, last = _load_three(rows, at), _load_three(rows, at + 1)
    way = minus(last, first)
    r = 0.5 * (first[0] + last[0]), 0.5 * (first[1] + last[1]), 0.5 * (first[2] + last[2])
    r = minus(r, center)
    far = (0.5 * sqrt(dot(way, way)) + (radii + keep)) * WIDER
    return EVERY & ~movemask(dot(r, r) > far * far)


@inline
def near_moving(problem, body, other, keep, to, scratch):
    """Bits of the intervals in which two moving bodies may come within `keep` of each other, seen by the second one."""
    ball, link = problem.ball, problem.link[other]
    R, t = rotation_of_link(to.links, link), translation_of_link(to.links, link)
    _store_three(scratch, 0, apply_transposed(R, minus(_load_three(to.bodies, body * BODY), t)))
    center = ball[other, 0], ball[other, 1], ball[other, 2]
    return _near_balls(scratch, 0, center, ball[body, 3] + ball[other, 3], keep)


@inline
def see_piece(problem, p, other, to, scratch):
    """Write the center and the shape of a moving piece p relative to the body `other`, which also moves."""
    link = problem.link[other]
    _see_piece(p, rotation_of_link(to.links, link), translation_of_link(to.links, link), to, scratch)


@inline
def see_piece_standing(problem, p, k, to, scratch):
    """Write the center and the shape of a moving piece p relative to the static body in row k."""
    T = problem.standing_poses
    R = T[k, 0], T[k, 1], T[k, 2], T[k, 4], T[k, 5], T[k, 6], T[k, 8], T[k, 9], T[k, 10]
    _see_piece(p, R, (T[k, 3], T[k, 7], T[k, 11]), to, scratch)


@inline
def _see_piece(p, R, t, to, scratch):
    _store_three(scratch, 0, apply_transposed(R, minus(_load_three(to.pieces, p * PIECE), t)))
    back = R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]
    _store_six(scratch, _SHAPE, rotated_shape(back, _load_six(to.pieces, p * PIECE + _SHAPE)))


@inline
def write_box(rows, at, reach, box):
    """Write lower and upper bounds of a piece at all eight configurations, seen from a body with this reach.

    The center and the shape of the piece, starting at entry `at`, are relative to the body. The points of the body may
    be off by as much as an accepted pose moves them.
    """
    center, Q = _load_three(rows, at), _load_six(rows, at + _SHAPE)
    slack, size = SHAPE_ROUNDINGS * trace(Q), reach
    half = sqrt(Q[0] + slack), sqrt(Q[3] + slack), sqrt(Q[5] + slack)
    for c in range(3):
        box[c], box[3 + c] = lowest(center[c] - half[c]), highest(center[c] + half[c])
        size += max(abs(box[c]), abs(box[3 + c]))
    wide = BEND * reach + position_error(size, UNIT_ROUNDOFF)
    for c in range(3):
        box[c], box[3 + c] = lowered(box[c], wide), raised(box[3 + c], wide)


@inline
def near_piece(rows, at, radius, table, q, keep, nearer, live, out, to):
    """Bits of the intervals among `live` in which two ellipsoids may come within `keep` of each other.

    Parameters
    ----------
    rows, at :
        Center and shape of the moving piece, starting at entry `at`.
    radius : float
        Radius of a ball about the moving piece.
    table, q :
        The static piece is row q of a table like `Pieces.hot`.
    keep : float
    nearer : vector
        By how much the pieces may be nearer to each other than computed, at each configuration.
    live : int
        Bits of the intervals to test.
    out, to :
        Receives, starting at entry `to`, directions from the static piece to the moving piece. The further entries
        receive how far apart the ellipsoids may be along these directions at both ends, in units of the distance at
        which the ellipsoids touch.
    """
    center = outer_center(table, q)
    live &= _near_balls(rows, at, center, radius + table[q, OUTER_RADIUS], keep)
    if live != 0:
        Q = outer_shape(table, q)
        c0, c1 = minus(_load_three(rows, at), center), minus(_load_three(rows, at + 1), center)
        P0, P1 = _load_six(rows, at + _SHAPE), _load_six(rows, at + _SHAPE + 1)
        r = 0.5 * (c0[0] + c1[0]), 0.5 * (c0[1] + c1[1]), 0.5 * (c0[2] + c1[2])
        wide_p = P0[0] * r[0] * r[0] + P0[3] * r[1] * r[1] + P0[5] * r[2] * r[2]
        wide_p = wide_p + 2.0 * (P0[1] * r[0] * r[1] + P0[2] * r[0] * r[2] + P0[4] * r[1] * r[2])
        wide_q = Q[0] * r[0] * r[0] + Q[3] * r[1] * r[1] + Q[5] * r[2] * r[2]
        wide_q = wide_q + 2.0 * (Q[1] * r[0] * r[1] + Q[2] * r[0] * r[2] + Q[4] * r[1] * r[2])
        s = share_of_roots(maximum(wide_p, TINY), maximum(wide_q, TINY))
        _, n = normal_at(P0, Q, r, s)
        squared = dot(n, n)
        width, _ = outward_width(Q, n, squared)
        first, _ = outward_width(P0, n, squared)
        last, _ = outward_width(P1, n, squared)
        along_first, along_last = dot(n, c0), dot(n, c1)
        gap = minimum(along_first - first, along_last - last) - width
        length = sqrt(squared)
        live &= ~movemask(gap > length * (keep * WIDER))
        if live != 0:
            store(out, to, n[0])
            store(out, to + LANES, n[1])
            store(out, to + 2 * LANES, n[2])
            store(out, to + 3 * LANES, (along_first - length * nearer) / (first + width))
            store(out, to + 4 * LANES, (along_last - length * next_lanes(nearer)) / (last + width))
    return live
