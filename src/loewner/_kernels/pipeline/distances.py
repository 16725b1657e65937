"""Certified bounds on the distance of two bodies, estimates of it, and the exact value.

All distances are signed: negative is the penetration depth. A body's distance is the least over its
piece pairs.
"""

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import AMBIGUOUS, COLLIDING, FREE
from loewner._kernels.ellipsoids.contact import (
    POSITION_ROUNDINGS,
    SHAPE_ROUNDINGS,
    gap_bound,
    nearness,
    newton_step,
    normal_at,
    outward_width,
    polynomials,
)
from loewner._kernels.ellipsoids.signed_distance import is_round, round_distance
from loewner._kernels.linalg3 import UNIT_ROUNDOFF, apply, dot, rotated_shape
from loewner._kernels.narrow.epa_fast import SETTLED as DEPTH_SETTLED
from loewner._kernels.narrow.epa_fast import overlap_depth
from loewner._kernels.narrow.epa_fast import workspace as depth_workspace
from loewner._kernels.narrow.epa_robust import CONTACT_ACCURACY, DEPTH_ACCURACY, FLAT, penetration, workspace
from loewner._kernels.narrow.gjk_fast import INSIDE, NEAREST, begin, measure
from loewner._kernels.narrow.gjk_fast import workspace as points_workspace
from loewner._kernels.narrow.gjk_robust import TOUCHING, UNSETTLED, run
from loewner._kernels.pieces.pack import pieces_of, placed
from loewner._kernels.pieces.shapes import (
    INNER_CENTER,
    INNER_SHAPE,
    INNER_SIGMA,
    KIND,
    OUTER_CENTER,
    OUTER_SHAPE,
    POLYTOPE,
    REACH,
    prefetch_points,
    radius,
)
from loewner._kernels.pipeline.verdicts import row_of
from loewner._kernels.trees import piece_tree

WALKED = 16  # piece pairs taken from the trees at a time: the distance bound is no older than that
SEED_ROUNDS = 3  # from one center to the nearest of the other body and back

BOUND_STEPS = 12  # Newton steps for the contact function of a single pair
POLISH_ROUNDS = 4  # rounds n <- (near point of b) - (near point of a) that tighten a bound

# Rows of the scratch array of the bounds: one per quantity, one column per piece pair (lane), see `certificate`. An
# ellipsoid's nine rows are its center and its shape matrix.
LANES = 32
# Literals: as typed numbers they would save compiling a few small functions more than once, and cost the loops over the
# lanes their vectors (bounds then take twice as long).
ROT_A, ROT_B, OUTER_A, OUTER_B, INNER_A, INNER_B = 0, 9, 18, 27, 36, 45
SHIFT, SIZE, SIGMA_A, SIGMA_B = 54, 57, 58, 59
BELOW, NORMAL, F_OUTER, WIDTH, ABOVE, F_INNER = 60, 61, 64, 65, 66, 67
P, Q, R, POLYNOMIALS, TRIED, PN, QN, WIDTH_P, WIDTH_Q = 68, 74, 80, 83, 91, 94, 97, 100, 101
CENTER_A, CENTER_B = TRIED, PN  # needed only before those are
ROWS = 102

# Rows of the queue: which pair, pieces and poses each lane stands for; lanes that the fast search could not settle.
PAIR, PIECE_A, PIECE_B, POSE_A, POSE_B, LATE = 0, 1, 2, 3, 4, 5
QUEUE = 6

KEPT = 4  # rows of the scratch array from SHIFT on, and from BELOW on, that are kept of a lane that is left

AHEAD = 2  # lanes between asking for a piece's vertices and their use

# A distance is settled when its bounds are this close, relative to the lengths involved.
SETTLED = 1e-9

# Curved pieces other than ellipsoids and balls may tie in every direction: the depth found is then right to rounding,
# but the 1,500 points of the expanding polytope prove it to 4e-4 only. Such a depth is returned: it is that of
# a plane and two witnesses, never less than the true one.
SETTLED_CURVED = 1e-3

# What the witnesses of a depth may miss it by, of the same lengths.
WITNESSES = 1e-5

SETTLED_DISTANCE, NOT_SETTLED = 0, 1


@inline
def _put(S, row, lane, source, at, column, count):
    for c in range(count):
        S[(row + c) * LANES + lane] = source[at, column + c]


@inline
def _three(S, row, lane):
    k = row * LANES + lane
    return S[k], S[k + LANES], S[k + 2 * LANES]


@inline
def _six(S, row, lane):
    return _three(S, row, lane) + _three(S, row + 3, lane)


@inline
def _put_three(S, row, lane, v):
    k = row * LANES + lane
    S[k] = v[0]
    S[k + LANES] = v[1]
    S[k + 2 * LANES] = v[2]


@inline
def _put_six(S, row, lane, Q):
    _put_three(S, row, lane, (Q[0], Q[1], Q[2]))
    _put_three(S, row + 3, lane, (Q[3], Q[4], Q[5]))


@inline
def _world_lane(S, lane, rotation, ellipsoid, shape, center):
    """Shape matrix and center of an ellipsoid in the world's axes, the center relative to its body's translation."""
    R = _six(S, rotation, lane) + _three(S, rotation + 6, lane)
    _put_six(S, shape, lane, rotated_shape(R, _six(S, ellipsoid + 3, lane)))
    _put_three(S, center, lane, apply(R, _three(S, ellipsoid, lane)))


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
        ax, ay, az = _three(S, CENTER_A, lane)
        bx, by, bz = _three(S, CENTER_B, lane)
        x, y, z = _three(S, SHIFT, lane)
        _put_three(S, R, lane, (x + (bx - ax), y + (by - ay), z + (bz - az)))


@njit()
def _polynomials(S, count):
    for lane in range(count):
        p, q, r = _six(S, P, lane), _six(S, Q, lane), _three(S, R, lane)
        cubic, quadratic, s = polynomials(p, q, r)
        _put_three(S, POLYNOMIALS, lane, (cubic[0], cubic[1], cubic[2]))
        S[(POLYNOMIALS + 3) * LANES + lane] = cubic[3]
        _put_three(S, POLYNOMIALS + 4, lane, quadratic)
        S[(POLYNOMIALS + 7) * LANES + lane] = s


@njit()
def _newton(S, count):
    """All steps to the maximum of F. One loop over the lanes per step: unrolled steps would not be vectorised."""
    for _ in range(BOUND_STEPS):
        for lane in range(count):
            k = POLYNOMIALS * LANES + lane
            cubic = S[k], S[k + LANES], S[k + 2 * LANES], S[k + 3 * LANES]
            S[k + 7 * LANES] = newton_step(cubic, _three(S, POLYNOMIALS + 4, lane), S[k + 7 * LANES])


@inline
def _between_points(r, a, pn, b, qn):
    """From the point a P n of one ellipsoid to the point r - b Q n of the other."""
    return r[0] - b * qn[0] - a * pn[0], r[1] - b * qn[1] - a * pn[1], r[2] - b * qn[2] - a * pn[2]


@inline
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
        p, q, r = _six(S, P, lane), _six(S, Q, lane), _three(S, R, lane)
        F, n = normal_at(p, q, r, S[(POLYNOMIALS + 7) * LANES + lane])
        some = dot(n, n) > 0.0  # concentric: any direction gives a valid bound
        n = n[0] if some else 1.0, n[1] if some else 0.0, n[2] if some else 0.0
        squared = dot(n, n)
        hp, hq = _widths(S, lane, p, q, n, squared)
        length = np.sqrt(squared)
        offset = dot(n, r)
        S[BELOW * LANES + lane] = gap_bound(offset, hp, hq, length, S[SIZE * LANES + lane])
        S[F_OUTER * LANES + lane] = F
        S[WIDTH * LANES + lane] = offset / length
        _put_three(S, NORMAL, lane, n)


@njit()
def _polish_lower_bounds(S, count):
    """One round n <- (near point of b) - (near point of a), kept where it tightens the bound."""
    for lane in range(count):
        r = _three(S, R, lane)
        a = 1.0 / S[WIDTH_P * LANES + lane]
        b = 1.0 / S[WIDTH_Q * LANES + lane]
        n = _between_points(r, a, _three(S, PN, lane), b, _three(S, QN, lane))
        squared = dot(n, n)
        hp, hq = _widths(S, lane, _six(S, P, lane), _six(S, Q, lane), n, squared)
        bound = gap_bound(dot(n, r), hp, hq, np.sqrt(squared), S[SIZE * LANES + lane])
        best = S[BELOW * LANES + lane]
        better = bound > best and best > 0.0  # near points of ellipsoids that overlap say nothing
        m = _three(S, NORMAL, lane)
        S[BELOW * LANES + lane] = bound if better else best
        _put_three(S, NORMAL, lane, (n[0] if better else m[0], n[1] if better else m[1], n[2] if better else m[2]))


@njit()
def _first_upper_bounds(S, count):
    """The bound by the common point or the two near points, and F."""
    for lane in range(count):
        p, q, r = _six(S, P, lane), _six(S, Q, lane), _three(S, R, lane)
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
        n = _three(S, TRIED, lane)
        size = S[SIZE * LANES + lane]
        squared = dot(n, n)
        length = np.sqrt(squared)
        hp, pn = outward_width(p, n, squared)
        hq, qn = outward_width(q, n, squared)
        # Divide by a little more than the width, so that rounding cannot push the points outside: the slack, at least
        # 128 roundings, covers those of the quotient too.
        a = 1.0 / (hp + S[WIDTH_P * LANES + lane] * length)
        b = 1.0 / (hq + S[WIDTH_Q * LANES + lane] * length)
        n = _between_points(_three(S, R, lane), a, pn, b, qn)
        distance = np.sqrt(dot(n, n)) * (1.0 + 8.0 * UNIT_ROUNDOFF) + SHAPE_ROUNDINGS * size
        best = S[ABOVE * LANES + lane]
        S[ABOVE * LANES + lane] = distance if distance < best else best
        _put_three(S, TRIED, lane, n)


@njit()
def _bounds(count, queue, ta, Ta, tb, Tb, S):
    """Both bounds for the queued piece pairs."""
    queue, S, ta, Ta, tb, Tb = borrowed(queue), borrowed(S), borrowed(ta), borrowed(Ta), borrowed(tb), borrowed(Tb)
    padded = (count + 7) // 8 * 8
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
    _outer_a(S, padded)
    _outer_b(S, padded)
    _between(S, padded)
    _polynomials(S, padded)
    _newton(S, padded)
    _first_lower_bounds(S, padded)
    for _ in range(POLISH_ROUNDS):
        _polish_lower_bounds(S, padded)
    _inner_a(S, padded)
    _inner_b(S, padded)
    _between(S, padded)
    _polynomials(S, padded)
    _newton(S, padded)
    _first_upper_bounds(S, padded)
    for _ in range(POLISH_ROUNDS):
        _polish_upper_bounds(S, padded)
    for lane in range(count):
        if not S[BELOW * LANES + lane] > -np.inf:  # NaN from an overflow: the weakest bound is still a bound
            S[BELOW * LANES + lane] = -2.0 * S[SIZE * LANES + lane]


@inline
def estimated_distance(F_outer, F_inner, width):
    """Distance that the two contact functions suggest; negative exactly if F_outer F_inner < 1.

    √F is the factor by which both ellipsoids must grow to touch. The geometric mean g of the outer
    and the inner factor is taken for the pieces' own; pieces whose width along the normal times g
    equals the centers' offset along it are apart by offset (1 - 1/g).
    """
    g = np.sqrt(np.sqrt(max(F_outer * F_inner, 0.0)))
    return width * (1.0 - 1.0 / g) if g > 0.0 else -np.inf


@njit()
def _distance_with_care(A, B, shift, n, error, inside, work, result):
    """Signed distance and gap where the fast search did not find them; the witnesses are those of the cores."""
    G = np.empty((4, 9))
    weights = np.empty(4)
    d = np.empty(3)
    k = 4
    lower, upper = -np.inf, -np.inf
    status = TOUCHING
    if not inside:
        status, lower, upper, k = run(A, B, shift, n, 0.0, False, G, weights, np.empty(3), d)
    ra, rb = radius(A), radius(B)
    if k < 4 and upper + ra + rb > 4.0 * error and status != UNSETTLED:
        _write(G, k, weights, d, result)
        return upper, upper - lower
    # The depth sought is the upper bound: the support plane of the normal that comes with it. Only a graze needs more,
    # to be told from a gap; deep in a curved piece so much is not to be had, and asking for it spoils the witnesses.
    shallow, deep = penetration(A, B, shift, DEPTH_ACCURACY, work, result)
    graze = k < 4 and deep != FLAT and deep <= SETTLED / POSITION_ROUNDINGS * error
    if graze:
        shallow, deep = penetration(A, B, shift, CONTACT_ACCURACY, work, result)
    if deep != FLAT:
        if graze:
            # An expanding polytope that does not hold the origin need not hold the origin's foot in
            # its nearest face either; GJK's points may be the better ones.
            normal, points = result[:3].copy(), result[3:].copy()
            missed = _miss(result, -deep)
            _write(G, k, weights, d, result)
            result[:3] = normal
            if not _miss(result, -deep) < missed:
                result[3:] = points
        return -deep - ra - rb, deep - shallow
    if upper + ra + rb > 4.0 * error:
        # Cores that are apart after all: what GJK has, with the gap it has.
        _write(G, k, weights, d, result)
        return upper, upper - lower
    if k == 4:
        # Impossible but for rounding: a flat simplex that passed for one with the origin inside.
        return -np.inf, np.inf
    nx, ny, nz = result[0], result[1], result[2]
    _write(G, k, weights, d, result)
    result[0], result[1], result[2] = nx, ny, nz
    return -ra - rb, 0.0


@njit()
def _miss(result, distance):
    """How far the two points are from lying `distance` apart along the normal."""
    squared = 0.0
    for c in range(3):
        squared += (result[6 + c] - result[3 + c] - distance * result[c]) ** 2
    return np.sqrt(squared)


@njit()
def _write(G, k, weights, d, result):
    """Normal and witnesses of the simplex that `run` ended with."""
    for c in range(3):
        result[c] = -d[c]
    for c in range(6):
        result[3 + c] = 0.0
        for row in range(k):
            result[3 + c] += weights[row] * G[row, 3 + c]


@njit()
def _next_pieces(k, ka, kb, a, b, ib, reach, steps, numbers, queue):
    """Fill the front of the queue with the next piece pairs that a walk leaves within `reach`; how many."""
    found = piece_tree.more(a, b, ib, reach, steps, numbers, queue[1, :WALKED], queue[2, :WALKED])
    queue[0, :found] = k
    queue[3, :found] = ka
    queue[4, :found] = kb
    return found


@inline
def _is_curved(P):
    return P.layout[P.piece, KIND] > POLYTOPE


@njit()
def _measure_near(count, queue, a, Ta, b, Tb, S, W, D, K, result, out):
    """Exact distances by the fast search; the lanes it leaves go to the front of the queue's last row."""
    Ta, Tb = borrowed(Ta), borrowed(Tb)
    queue, S, W, result, distance = borrowed(queue), borrowed(S), borrowed(W), borrowed(result), borrowed(out[3])
    D, K = borrowed(D), borrowed(K)
    late = 0
    for lane in range(count):
        if lane + AHEAD < count:
            prefetch_points(a.layout, a.points, queue[PIECE_A, lane + AHEAD])
            prefetch_points(b.layout, b.points, queue[PIECE_B, lane + AHEAD])
        if not S[BELOW * LANES + lane] < distance[queue[PAIR, lane]]:
            continue
        A = placed(a, queue[PIECE_A, lane], Ta, queue[POSE_A, lane])
        B = placed(b, queue[PIECE_B, lane], Tb, queue[POSE_B, lane])
        shift, n = _three(S, SHIFT, lane), _three(S, NORMAL, lane)
        size = S[SIZE * LANES + lane]
        if is_round(A) and is_round(B):
            value, gap = round_distance(A, B, n, size, result)
            _record(lane, queue, Ta, S, value, gap, SETTLED, 0.0, 0.0, result, out)
            continue
        plain = not (_is_curved(A) or _is_curved(B))
        if plain and S[F_OUTER * LANES + lane] * S[F_INNER * LANES + lane] < 1.0:  # they overlap, by the look of it
            searched, shallow, deep = overlap_depth(A, B, n, D, K, result)
            if searched == DEPTH_SETTLED:
                _record(lane, queue, Ta, S, -deep, deep - shallow, SETTLED, 0.0, 0.0, result, out)
                continue
        error = POSITION_ROUNDINGS * size
        ends = begin(A, B, shift, W)
        status, below, above = measure(A, B, shift, W, ends, n, error, -np.inf, np.inf, result)
        if status == NEAREST:
            ra, rb = radius(A), radius(B)
            _record(lane, queue, Ta, S, above - ra - rb, above - below, SETTLED, ra, rb, result, out)
        else:
            queue[LATE, late] = 2 * lane + (status == INSIDE)
            late += 1
    return late


@njit()
def _measure_late(late, queue, a, Ta, b, Tb, S, D, K, result, out):
    """Exact distances of the lanes that the fast search left; only they need the large work space."""
    work = workspace(True)
    for m in range(late):
        lane = queue[LATE, m] // 2
        inside = queue[LATE, m] % 2 == 1
        if not S[BELOW * LANES + lane] < out[3][queue[PAIR, lane]]:
            continue
        A = placed(a, queue[PIECE_A, lane], Ta, queue[POSE_A, lane])
        B = placed(b, queue[PIECE_B, lane], Tb, queue[POSE_B, lane])
        shift, n = _three(S, SHIFT, lane), _three(S, NORMAL, lane)
        error = POSITION_ROUNDINGS * S[SIZE * LANES + lane]
        curved = _is_curved(A) or _is_curved(B)
        if inside and not curved:
            searched, shallow, deep = overlap_depth(A, B, n, D, K, result)
            if searched == DEPTH_SETTLED:
                _record(lane, queue, Ta, S, -deep, deep - shallow, SETTLED, 0.0, 0.0, result, out)
                continue
        value, gap = _distance_with_care(A, B, shift, n, error, inside, work, result)
        tolerance = SETTLED_CURVED if curved and value < 0.0 else SETTLED
        ra, rb = radius(A), radius(B)
        if value < 0.0 and not _miss(result, value + ra + rb) <= WITNESSES * S[SIZE * LANES + lane]:
            tolerance = -1.0  # a depth whose witnesses do not bear it out
        _record(lane, queue, Ta, S, value, gap, tolerance, ra, rb, result, out)


@inline
def _record(lane, queue, Ta, S, value, gap, tolerance, ra, rb, result, out):
    """Merge the exact distance of two pieces, and how far the bounds on it are apart, into the result of their pair.

    `result` holds the normal and the witnesses, relative to a's translation and without the rounding radii ra and rb.
    """
    _, _, _, distance, witness_a, witness_b, normal, status = out
    k, ka = queue[PAIR, lane], queue[POSE_A, lane]
    # The ellipsoids' own bound may be the better one. A value far below it is none, whatever its own bounds say.
    gap = min(gap, abs(value - S[BELOW * LANES + lane]))
    if not gap <= tolerance * S[SIZE * LANES + lane]:
        status[k] = NOT_SETTLED
    if value < distance[k]:
        distance[k] = value
        for c in range(3):
            normal[k, c] = result[c]
            witness_a[k, c] = result[3 + c] + ra * result[c] + Ta[ka, c, 3]
            witness_b[k, c] = result[6 + c] - rb * result[c] + Ta[ka, c, 3]


@njit()
def _leave(late, queue, S, left, numbers, values):
    """Note the lanes that the fast search left for `measure_left`, from row `left` of the lists on; where they end."""
    for m in range(late):
        lane = queue[LATE, m] // 2
        for row in range(PAIR, LATE):
            numbers[left, row] = queue[row, lane]
        numbers[left, LATE] = queue[LATE, m] % 2
        for row in range(KEPT):
            values[left, row] = S[(SHIFT + row) * LANES + lane]
            values[left, KEPT + row] = S[(BELOW + row) * LANES + lane]
        left += 1
    return left


@njit()
def _room(left, numbers, values):
    """Lists of what is left with room for a queue more."""
    if left + LANES <= len(numbers):
        return numbers, values
    more_numbers, more_values = np.empty((2 * left + LANES, QUEUE), np.int64), np.empty((2 * left + LANES, 2 * KEPT))
    more_numbers[:left] = numbers[:left]
    more_values[:left] = values[:left]
    return more_numbers, more_values


@njit()
def _measure(exact, count, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out):
    """Measure the queued piece pairs and merge them into the results of their pairs; how many are left by now."""
    _bounds(count, queue, a.table, Ta, b.table, Tb, S)
    lower, upper, estimate = out[0], out[1], out[2]
    for lane in range(count):
        k = queue[PAIR, lane]
        below = S[BELOW * LANES + lane]
        above = S[ABOVE * LANES + lane]
        lower[k] = min(lower[k], below)
        upper[k] = min(upper[k], above)
        guess = estimated_distance(S[F_OUTER * LANES + lane], S[F_INNER * LANES + lane], S[WIDTH * LANES + lane])
        estimate[k] = min(estimate[k], max(below, min(above, guess)))
    if exact:
        late = _measure_near(count, queue, a, Ta, b, Tb, S, spaces[0], spaces[2], spaces[3], spaces[1], out)
        left = _leave(late, queue, S, left, numbers, values)
    return left


@njit()
def _measure_many(exact, k, ia, ka, ib, kb, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out):
    """Measure a pair of bodies of which one has many pieces: only the piece pairs that may be the nearest."""
    upper, distance = out[1], out[3]
    steps = np.empty(piece_tree.STEPS, np.int64)
    places = np.empty(piece_tree.NUMBERS)
    piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, places)
    # A first bound on the distance spares the walk most pairs.
    i, j = piece_tree.nearest_centers(a, ia, b, ib, places, SEED_ROUNDS)
    queue[0, 0], queue[1, 0], queue[2, 0], queue[3, 0], queue[4, 0] = k, i, j, ka, kb
    found = np.int64(1)
    while found > 0:
        numbers, values = _room(left, numbers, values)
        left = _measure(exact, found, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out)
        cut = upper[k]
        if exact:
            cut = min(cut, distance[k] + SETTLED * places[piece_tree.SIZE])
        found = _next_pieces(k, ka, kb, a, b, ib, max(cut, 0.0), steps, places, queue)
    return left, numbers, values


@njit()
def distance_range(exact, start, stop, plan, pack_a, Ta, pack_b, Tb, lower, upper, estimate, distance,
                   witness_a, witness_b, normal, status):  # fmt: skip
    """Distances of pairs start .. stop.

    Operands as in `verdicts`; the last five arrays are written only if `exact`.

    Returns
    -------
    numbers, values : ndarray
        The piece pairs that the fast searches left, for `measure_left`: their pairs are not finished without it.
    """
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    S = np.empty(ROWS * LANES)
    queue = np.empty((QUEUE, LANES), np.int64)
    spaces = (points_workspace(), np.empty(9), *depth_workspace(exact))
    out = (lower, upper, estimate, distance, witness_a, witness_b, normal, status)
    numbers, values = np.empty((0, QUEUE), np.int64), np.empty((0, 2 * KEPT))
    count, left = np.int64(0), np.int64(0)
    for k in range(start, stop):
        ia = row_of(k, shape, body_a)
        ib = row_of(k, shape, body_b)
        ka = row_of(k, shape, pose_a)
        kb = row_of(k, shape, pose_b)
        lower[k] = np.inf
        upper[k] = np.inf
        estimate[k] = np.inf
        if exact:
            distance[k] = np.inf
            status[k] = SETTLED_DISTANCE
        numbers, values = _room(left, numbers, values)
        if a.roots[ia] >= 0 or b.roots[ib] >= 0:
            left = _measure(exact, count, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out)
            count = np.int64(0)
            left, numbers, values = _measure_many(
                exact, k, ia, ka, ib, kb, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out
            )
            continue
        for i in range(a.piece_start[ia], a.piece_start[ia + 1]):
            for j in range(b.piece_start[ib], b.piece_start[ib + 1]):
                queue[PAIR, count], queue[PIECE_A, count], queue[PIECE_B, count] = k, i, j
                queue[POSE_A, count], queue[POSE_B, count] = ka, kb
                count += 1
                if count == LANES:
                    left = _measure(exact, count, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out)
                    count = np.int64(0)
                    numbers, values = _room(left, numbers, values)
    left = _measure(exact, count, queue, a, Ta, b, Tb, S, spaces, left, numbers, values, out)
    return numbers[:left], values[:left]


@njit()
def measure_left(numbers, values, pack_a, Ta, pack_b, Tb, distance, witness_a, witness_b, normal, status):
    """Exact distances of the piece pairs that `distance_range` left; compiled only when there is one."""
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    S = np.empty(ROWS * LANES)
    queue = np.empty((QUEUE, LANES), np.int64)
    D, K = depth_workspace(True)
    out = (distance, distance, distance, distance, witness_a, witness_b, normal, status)  # the first three are not used
    for first in range(0, len(numbers), LANES):
        count = min(LANES, len(numbers) - first)
        for lane in range(count):
            queue[PAIR:LATE, lane] = numbers[first + lane, PAIR:LATE]
            queue[LATE, lane] = 2 * lane + numbers[first + lane, LATE]
            for row in range(KEPT):
                S[(SHIFT + row) * LANES + lane] = values[first + lane, row]
                S[(BELOW + row) * LANES + lane] = values[first + lane, KEPT + row]
        _measure_late(count, queue, a, Ta, b, Tb, S, D, K, np.empty(9), out)


@njit()
def estimate_range(margin, start, stop, plan, pack_a, Ta, pack_b, Tb, out):
    """Decide the pairs left AMBIGUOUS in `out` by the estimate, the product of their two contact functions."""
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    S = np.empty(ROWS * LANES)
    queue = np.empty((QUEUE, LANES), np.int64)
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    count = np.int64(0)
    for k in range(start, stop):
        if out[k] != AMBIGUOUS:
            continue
        out[k] = FREE
        ia = row_of(k, shape, body_a)
        ib = row_of(k, shape, body_b)
        ka = row_of(k, shape, pose_a)
        kb = row_of(k, shape, pose_b)
        if a.roots[ia] >= 0 or b.roots[ib] >= 0:
            if count > 0:
                _decide(margin, count, queue, a, Ta, b, Tb, S, out)
                count = np.int64(0)
            piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
            while out[k] != COLLIDING:
                found = _next_pieces(k, ka, kb, a, b, ib, margin, steps, numbers, queue)
                if found == 0:
                    break
                _decide(margin, found, queue, a, Ta, b, Tb, S, out)
            continue
        for i in range(a.piece_start[ia], a.piece_start[ia + 1]):
            for j in range(b.piece_start[ib], b.piece_start[ib + 1]):
                queue[PAIR, count], queue[PIECE_A, count], queue[PIECE_B, count] = k, i, j
                queue[POSE_A, count], queue[POSE_B, count] = ka, kb
                count += 1
                if count == LANES:
                    _decide(margin, count, queue, a, Ta, b, Tb, S, out)
                    count = np.int64(0)
    if count > 0:
        _decide(margin, count, queue, a, Ta, b, Tb, S, out)


@njit()
def _decide(margin, count, queue, a, Ta, b, Tb, S, out):
    """Decide the queued piece pairs by the estimate."""
    _bounds(count, queue, a.table, Ta, b.table, Tb, S)
    for lane in range(count):
        k = queue[PAIR, lane]
        if S[BELOW * LANES + lane] > margin or out[k] == COLLIDING:
            continue
        guess = estimated_distance(S[F_OUTER * LANES + lane], S[F_INNER * LANES + lane], S[WIDTH * LANES + lane])
        # NaN counts as colliding, as it should never arise and must not free anybody.
        if not guess > margin:
            out[k] = COLLIDING
