"""Certified bounds on the distance of two pieces, 32 pairs at a time, and what is read off them: estimates.

All distances are signed: negative is the penetration depth.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, inline_by_value, njit
from loewner._kernels.codes import AMBIGUOUS, COLLIDING, FREE
from loewner._kernels.columns import INNER_CENTER, INNER_SHAPE, INNER_SIGMA, OUTER_CENTER, OUTER_SHAPE, REACH
from loewner._kernels.ellipsoids.contact import (
    farther_normal,
    gap_bound,
    nearness,
    newton_step,
    normal_at,
    outward_width,
    polynomials,
)
from loewner._kernels.linalg3 import apply, dot, rotated_shape
from loewner._kernels.pieces.pack import pieces_of
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.simd.vectors import broadcast, mask_of, select, store
from loewner._kernels.tolerances import SHAPE_ROUNDINGS, UNIT_ROUNDOFF
from loewner._kernels.trees import piece_tree

WALKED = 16  # piece pairs taken from the trees at a time: the distance bound is no older than that

BOUND_STEPS = 12  # Newton steps for the contact function of a single pair; an even number
POLISH_ROUNDS = 3  # rounds that tighten a bound: Newton's method for the direction of the near points

# Rows of the scratch array of the bounds: one per quantity, one column per piece pair (lane), see `certificate`. An
# ellipsoid's nine rows are its center and its shape matrix.
LANES = 32
# Functions that take one are `inline_by_value`: otherwise loops over the lanes lose their vectors, and bounds take
# twice as long.
ROT_A, ROT_B, OUTER_A, OUTER_B, INNER_A, INNER_B = 0, 9, 18, 27, 36, 45
SHIFT, SIZE, SIGMA_A, SIGMA_B = 54, 57, 58, 59
BELOW, NORMAL, F_OUTER, WIDTH, ABOVE, F_INNER = 60, 61, 64, 65, 66, 67
P, Q, R, POLYNOMIALS, TRIED, PN, QN, WIDTH_P, WIDTH_Q = 68, 74, 80, 83, 91, 94, 97, 100, 101
CENTER_A, CENTER_B = TRIED, PN  # needed only before those are
GAP, LENGTH = TRIED, TRIED + 1  # of the last direction that was tried, for the lower bound; needed only before TRIED is
# What `distances` finds of pairs of ellipsoids, eight at a time: their distance, a bound on its error (infinite: not
# found), and the normal and both witnesses.
ROUND_DISTANCE, ROUND_GAP, ROUND_RESULT = 102, 103, 104
ROWS = 113

# A single pair has eight lanes for itself: the outer ellipsoids take the first four, the inner ones the others.
SINGLE, INNER_LANE, INNER_LANES = 8, 4, 0xF0

# Rows of the queue: which pair, pieces and poses each lane stands for. The last two have an entry for each lane that
# the fast searches of `distances` could not settle: whether its cores overlap for sure, and which lane it is.
PAIR, PIECE_A, PIECE_B, POSE_A, POSE_B, INSIDE, LATE = 0, 1, 2, 3, 4, 5, 6
QUEUE = 7


class Operands(NamedTuple):
    """Both operands of a query: of each the handle of its pieces, see `pieces.pack`, and its poses."""

    a: Any
    poses_a: Any
    b: Any
    poses_b: Any


@inline
def enqueue(queue, lane, pair, piece_a, piece_b, pose_a, pose_b):
    """Let a lane stand for a piece pair."""
    queue[PAIR, lane] = pair
    queue[PIECE_A, lane] = piece_a
    queue[PIECE_B, lane] = piece_b
    queue[POSE_A, lane] = pose_a
    queue[POSE_B, lane] = pose_b


@njit()
def next_pieces(pair, pose_a, pose_b, body_b, operands, reach, steps, numbers, queue):
    """Fill the front of the queue with the next piece pairs that a walk leaves within `reach`; how many."""
    a, b = pieces_of(operands.a), pieces_of(operands.b)
    found = piece_tree.more(a, b, body_b, reach, steps, numbers, queue[PIECE_A, :WALKED], queue[PIECE_B, :WALKED])
    queue[PAIR, :found] = pair
    queue[POSE_A, :found] = pose_a
    queue[POSE_B, :found] = pose_b
    return found


@inline_by_value
def _put(S, row, lane, source, at, column, count):
    for c in range(count):
        S[(row + c) * LANES + lane] = source[at, column + c]


@inline_by_value
def three(S, row, lane):
    """A vector of three consecutive rows."""
    k = row * LANES + lane
    return S[k], S[k + LANES], S[k + 2 * LANES]


@inline_by_value
def _six(S, row, lane):
    return three(S, row, lane) + three(S, row + 3, lane)


@inline_by_value
def _put_three(S, row, lane, v):
    k = row * LANES + lane
    S[k] = v[0]
    S[k + LANES] = v[1]
    S[k + 2 * LANES] = v[2]


@inline_by_value
def _put_six(S, row, lane, Q):
    _put_three(S, row, lane, (Q[0], Q[1], Q[2]))
    _put_three(S, row + 3, lane, (Q[3], Q[4], Q[5]))


@inline_by_value
def _world_lane(S, lane, rotation, ellipsoid, shape, center):
    """Shape matrix and center of an ellipsoid in the world's axes, the center relative to its body's translation."""
    R = _six(S, rotation, lane) + three(S, rotation + 6, lane)
    _put_six(S, shape, lane, rotated_shape(R, _six(S, ellipsoid + 3, lane)))
    _put_three(S, center, lane, apply(R, three(S, ellipsoid, lane)))


# One loop each: the compiler vectorises loops with few stores.


@njit()
def _outer_a(S, count):
    for lane in range(count):
        _world_lane(S, lane, ROT_A, OUTER_A, P, CENTER_A)


@njit()
def _outer_b(S, count):
    for lane in range(count):
        _world_lane(S, lane, ROT_B, OUTER_B, Q, CENTER_B)


@njit()
def _inner_a(S, count):
    for lane in range(count):
        _world_lane(S, lane, ROT_A, INNER_A, P, CENTER_A)


@njit()
def _inner_b(S, count):
    for lane in range(count):
        _world_lane(S, lane, ROT_B, INNER_B, Q, CENTER_B)


@njit()
def _between(S, count):
    """Vector between the centers."""
    for lane in range(count):
        ax, ay, az = three(S, CENTER_A, lane)
        bx, by, bz = three(S, CENTER_B, lane)
        x, y, z = three(S, SHIFT, lane)
        _put_three(S, R, lane, (x + (bx - ax), y + (by - ay), z + (bz - az)))


@njit()
def _polynomials(S, count):
    for lane in range(count):
        p, q, r = _six(S, P, lane), _six(S, Q, lane), three(S, R, lane)
        cubic, quadratic, s = polynomials(p, q, r)
        _put_three(S, POLYNOMIALS, lane, (cubic[0], cubic[1], cubic[2]))
        S[(POLYNOMIALS + 3) * LANES + lane] = cubic[3]
        _put_three(S, POLYNOMIALS + 4, lane, quadratic)
        S[(POLYNOMIALS + 7) * LANES + lane] = s


@njit()
def _newton(S, count):
    """All steps to the maximum of F. One loop over the lanes per two steps: unrolled ones would not be vectorised.

    Where two steps lead back to where they began, as they do when all that is left to change are the last bits, so do
    all others: the rest is left out, and what comes out is the same to the bit.
    """
    for _ in range(BOUND_STEPS // 2):
        moved = 0
        for lane in range(count):
            k = POLYNOMIALS * LANES + lane
            cubic = S[k], S[k + LANES], S[k + 2 * LANES], S[k + 3 * LANES]
            quadratic = three(S, POLYNOMIALS + 4, lane)
            s = S[k + 7 * LANES]
            t = newton_step(cubic, quadratic, newton_step(cubic, quadratic, s))
            S[k + 7 * LANES] = t
            moved += t != s
        if moved == 0:
            break


@inline
def _between_points(r, a, pn, b, qn):
    """From the point a P n of one ellipsoid to the point r - b Q n of the other."""
    return r[0] - b * qn[0] - a * pn[0], r[1] - b * qn[1] - a * pn[1], r[2] - b * qn[2] - a * pn[2]


@inline_by_value
def _widths(S, lane, p, q, n, squared):
    """Outward widths along n; with P n and Q n they are kept for the next round."""
    hp, pn = outward_width(p, n, squared)
    hq, qn = outward_width(q, n, squared)
    _put_three(S, PN, lane, pn)
    _put_three(S, QN, lane, qn)
    S[WIDTH_P * LANES + lane] = hp
    S[WIDTH_Q * LANES + lane] = hq
    return hp, hq


@njit()
def _first_lower_bounds(S, count):
    """The bound by the contact normal, F, and the centers' offset along the normal."""
    for lane in range(count):
        p, q, r = _six(S, P, lane), _six(S, Q, lane), three(S, R, lane)
        F, n = normal_at(p, q, r, S[(POLYNOMIALS + 7) * LANES + lane])
        some = dot(n, n) > 0.0  # concentric: any direction gives a valid bound
        n = n[0] if some else 1.0, n[1] if some else 0.0, n[2] if some else 0.0
        squared = dot(n, n)
        hp, hq = _widths(S, lane, p, q, n, squared)
        length = np.sqrt(squared)
        offset = dot(n, r)
        bound = gap_bound(offset, hp, hq, length, S[SIZE * LANES + lane])
        S[BELOW * LANES + lane] = bound
        S[GAP * LANES + lane] = bound
        S[LENGTH * LANES + lane] = length
        S[F_OUTER * LANES + lane] = F
        S[WIDTH * LANES + lane] = offset / length
        _put_three(S, NORMAL, lane, n)


@njit()
def _polish_lower_bounds(S, count):
    """One round, kept where it tightens the bound."""
    for lane in range(count):
        r, p, q = three(S, R, lane), _six(S, P, lane), _six(S, Q, lane)
        pn, qn, hp, hq = three(S, PN, lane), three(S, QN, lane), S[WIDTH_P * LANES + lane], S[WIDTH_Q * LANES + lane]
        y = _between_points(r, 1.0 / hp, pn, 1.0 / hq, qn)
        n = farther_normal(p, q, y, pn, qn, hp, hq, S[LENGTH * LANES + lane], S[GAP * LANES + lane])
        squared = dot(n, n)
        hp, hq = _widths(S, lane, p, q, n, squared)
        length = np.sqrt(squared)
        bound = gap_bound(dot(n, r), hp, hq, length, S[SIZE * LANES + lane])
        S[GAP * LANES + lane] = bound
        S[LENGTH * LANES + lane] = length
        best = S[BELOW * LANES + lane]
        better = bound > best and best > 0.0  # near points of ellipsoids that overlap say nothing
        m = three(S, NORMAL, lane)
        S[BELOW * LANES + lane] = bound if better else best
        _put_three(S, NORMAL, lane, (n[0] if better else m[0], n[1] if better else m[1], n[2] if better else m[2]))


@njit()
def _first_upper_bounds(S, count):
    """The bound by the common point or the two near points, and F."""
    for lane in range(count):
        p, q, r = _six(S, P, lane), _six(S, Q, lane), three(S, R, lane)
        s = S[(POLYNOMIALS + 7) * LANES + lane]
        size = S[SIZE * LANES + lane]
        sigma_a = S[SIGMA_A * LANES + lane]
        sigma_b = S[SIGMA_B * LANES + lane]
        F, n = normal_at(p, q, r, s)
        level, best, depth = nearness(p, q, r, n, s, sigma_a, sigma_b, size)
        # NaN: the centers are points of the ellipsoids too.
        centers = np.sqrt(dot(r, r)) * (1.0 + 8.0 * UNIT_ROUNDOFF)
        best = best if best < np.inf else centers + SHAPE_ROUNDINGS * size
        deep = -(depth if depth > 0.0 else 0.0)
        S[ABOVE * LANES + lane] = deep if level <= 1.0 else best
        S[F_INNER * LANES + lane] = F
        # What rounding of P n and Q n adds to their levels, per length of n.
        S[WIDTH_P * LANES + lane] = SHAPE_ROUNDINGS * (p[0] + p[3] + p[5]) / sigma_a
        S[WIDTH_Q * LANES + lane] = SHAPE_ROUNDINGS * (q[0] + q[3] + q[5]) / sigma_b
        _put_three(S, TRIED, lane, n)


@njit()
def _polish_upper_bounds(S, count):
    """One round of the same for the upper bound; a bound that is a depth already is not touched."""
    for lane in range(count):
        p, q = _six(S, P, lane), _six(S, Q, lane)
        n = three(S, TRIED, lane)
        size = S[SIZE * LANES + lane]
        squared = dot(n, n)
        length = np.sqrt(squared)
        hp, pn = outward_width(p, n, squared)
        hq, qn = outward_width(q, n, squared)
        # Divide by a little more than the width, so that rounding cannot push the points outside: the slack, at least
        # 128 roundings, covers those of the quotient too.
        a = 1.0 / (hp + S[WIDTH_P * LANES + lane] * length)
        b = 1.0 / (hq + S[WIDTH_Q * LANES + lane] * length)
        y = _between_points(three(S, R, lane), a, pn, b, qn)
        distance = np.sqrt(dot(y, y)) * (1.0 + 8.0 * UNIT_ROUNDOFF) + SHAPE_ROUNDINGS * size
        best = S[ABOVE * LANES + lane]
        S[ABOVE * LANES + lane] = distance if distance < best else best
        _put_three(S, TRIED, lane, farther_normal(p, q, y, pn, qn, hp, hq, length, dot(n, y) / length))


@inline_by_value
def _spread(S, row, value):
    """Give the lanes of a single pair one value."""
    store(S, row * LANES, broadcast(value))


@inline_by_value
def _halves(S, row, outer, inner):
    """Give the lanes of a single pair two values: one for the outer ellipsoids, one for the inner ones."""
    store(S, row * LANES, select(mask_of(INNER_LANES), broadcast(inner), broadcast(outer)))


@njit()
def _load_one(queue, operands, S):
    """What the bounds take of a single piece pair: its outer and its inner ellipsoids are worked on at once."""
    queue, S, Ta, Tb = borrowed(queue), borrowed(S), borrowed(operands.poses_a), borrowed(operands.poses_b)
    ta, tb = pieces_of(operands.a).table, pieces_of(operands.b).table
    i, j, ka, kb = queue[PIECE_A, 0], queue[PIECE_B, 0], queue[POSE_A, 0], queue[POSE_B, 0]
    for r in range(3):
        for c in range(3):
            _spread(S, ROT_A + 3 * r + c, Ta[ka, r, c])
            _spread(S, ROT_B + 3 * r + c, Tb[kb, r, c])
    apart = 0.0
    for c in range(3):
        shift = Tb[kb, c, 3] - Ta[ka, c, 3]
        _spread(S, SHIFT + c, shift)
        apart += abs(shift)
    _spread(S, SIZE, apart + ta[i, REACH] + tb[j, REACH])
    for c in range(3):
        _halves(S, OUTER_A + c, ta[i, OUTER_CENTER + c], ta[i, INNER_CENTER + c])
        _halves(S, OUTER_B + c, tb[j, OUTER_CENTER + c], tb[j, INNER_CENTER + c])
    for c in range(6):
        _halves(S, OUTER_A + 3 + c, ta[i, OUTER_SHAPE + c], ta[i, INNER_SHAPE + c])
        _halves(S, OUTER_B + 3 + c, tb[j, OUTER_SHAPE + c], tb[j, INNER_SHAPE + c])
    _spread(S, SIGMA_A, ta[i, INNER_SIGMA])
    _spread(S, SIGMA_B, tb[j, INNER_SIGMA])


@njit()
def _take_inner(S):
    """Let a single pair's inner ellipsoids, and where F is greatest for them, take the place of the outer ones."""
    for row in range(P, R + 3):
        _spread(S, row, S[row * LANES + INNER_LANE])
    _spread(S, POLYNOMIALS + 7, S[(POLYNOMIALS + 7) * LANES + INNER_LANE])


@njit()
def _load(count, padded, queue, operands, S):
    """What the bounds take of the queued piece pairs."""
    queue, S, Ta, Tb = borrowed(queue), borrowed(S), borrowed(operands.poses_a), borrowed(operands.poses_b)
    ta, tb = pieces_of(operands.a).table, pieces_of(operands.b).table
    for lane in range(padded):
        # Whole vectors: what is left over is filled up with the last pair.
        k = min(lane, count - 1)
        i, j, ka, kb = queue[PIECE_A, k], queue[PIECE_B, k], queue[POSE_A, k], queue[POSE_B, k]
        for r in range(3):
            for c in range(3):
                S[(ROT_A + 3 * r + c) * LANES + lane] = Ta[ka, r, c]
                S[(ROT_B + 3 * r + c) * LANES + lane] = Tb[kb, r, c]
        apart = 0.0
        for c in range(3):
            shift = Tb[kb, c, 3] - Ta[ka, c, 3]
            S[(SHIFT + c) * LANES + lane] = shift
            apart += abs(shift)
        S[SIZE * LANES + lane] = apart + ta[i, REACH] + tb[j, REACH]
        _put(S, OUTER_A, lane, ta, i, OUTER_CENTER, 3)
        _put(S, OUTER_B, lane, tb, j, OUTER_CENTER, 3)
        _put(S, INNER_A, lane, ta, i, INNER_CENTER, 3)
        _put(S, INNER_B, lane, tb, j, INNER_CENTER, 3)
        _put(S, OUTER_A + 3, lane, ta, i, OUTER_SHAPE, 6)
        _put(S, OUTER_B + 3, lane, tb, j, OUTER_SHAPE, 6)
        _put(S, INNER_A + 3, lane, ta, i, INNER_SHAPE, 6)
        _put(S, INNER_B + 3, lane, tb, j, INNER_SHAPE, 6)
        S[SIGMA_A * LANES + lane] = ta[i, INNER_SIGMA]
        S[SIGMA_B * LANES + lane] = tb[j, INNER_SIGMA]


@inline_by_value
def _some_positive(S, row, count):
    """Whether a quantity is positive for one of the first lanes."""
    found = False
    for lane in range(count):
        found |= S[row * LANES + lane] > 0.0
    return found


@njit()
def write_bounds(count, queue, operands, S):
    """Both bounds for the queued piece pairs, to the scratch array."""
    S = borrowed(S)
    if count == 1:
        padded = SINGLE
        _load_one(queue, operands, S)
    else:
        padded = (count + 7) // 8 * 8
        _load(count, padded, queue, operands, S)
    _outer_a(S, padded)
    _outer_b(S, padded)
    _between(S, padded)
    _polynomials(S, padded)
    _newton(S, padded)
    _first_lower_bounds(S, padded)
    # Where no bound is positive, no round changes one: they are of overlapping ellipsoids, or depths.
    if _some_positive(S, BELOW, count):
        for _ in range(POLISH_ROUNDS):
            _polish_lower_bounds(S, padded)
    if count == 1:
        _take_inner(S)
    else:
        _inner_a(S, padded)
        _inner_b(S, padded)
        _between(S, padded)
        _polynomials(S, padded)
        _newton(S, padded)
    _first_upper_bounds(S, padded)
    if _some_positive(S, ABOVE, count):
        for _ in range(POLISH_ROUNDS):
            _polish_upper_bounds(S, padded)
    for lane in range(count):
        if not S[BELOW * LANES + lane] > -np.inf:  # NaN from an overflow: the weakest bound is still a bound
            S[BELOW * LANES + lane] = -2.0 * S[SIZE * LANES + lane]


@inline
def estimated_distance(S, lane):
    """Distance that a lane's two contact functions suggest; negative exactly if their product is below 1.

    √F is the factor by which both ellipsoids must grow to touch. The geometric mean g of the outer
    and the inner factor is taken for the pieces' own; pieces whose width along the normal times g
    equals the centers' offset along it are apart by offset (1 - 1/g).
    """
    F_outer, F_inner, width = S[F_OUTER * LANES + lane], S[F_INNER * LANES + lane], S[WIDTH * LANES + lane]
    g = np.sqrt(np.sqrt(max(F_outer * F_inner, 0.0)))
    return width * (1.0 - 1.0 / g) if g > 0.0 else -np.inf


@njit()
def _decide(margin, count, queue, operands, S, out):
    """Decide the queued piece pairs by the estimate."""
    write_bounds(count, queue, operands, S)
    for lane in range(count):
        k = queue[PAIR, lane]
        if S[BELOW * LANES + lane] > margin or out[k] == COLLIDING:
            continue
        # NaN counts as colliding, as it should never arise and must not free anybody.
        if not estimated_distance(S, lane) > margin:
            out[k] = COLLIDING


@njit()
def estimate_range(margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out):
    """Decide the pairs left AMBIGUOUS in `out` by the estimate, the product of their two contact functions.

    Operands as in `verdicts`.
    """
    operands = Operands(pack_a, Ta, pack_b, Tb)
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    S = np.empty(ROWS * LANES)
    queue = np.empty((QUEUE, LANES), np.int64)
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    count = 0
    for k in range(start, stop):
        if out[k] != AMBIGUOUS:
            continue
        out[k] = FREE
        ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
        if a.roots[ia] >= 0 or b.roots[ib] >= 0:
            if count > 0:
                _decide(margin, count, queue, operands, S, out)
                count = 0
            piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
            while out[k] != COLLIDING:
                found = next_pieces(k, ka, kb, ib, operands, margin, steps, numbers, queue)
                if found == 0:
                    break
                _decide(margin, found, queue, operands, S, out)
            continue
        for i in range(a.piece_start[ia], a.piece_start[ia + 1]):
            for j in range(b.piece_start[ib], b.piece_start[ib + 1]):
                enqueue(queue, count, k, i, j, ka, kb)
                count += 1
                if count == LANES:
                    _decide(margin, count, queue, operands, S, out)
                    count = 0
    if count > 0:
        _decide(margin, count, queue, operands, S, out)
