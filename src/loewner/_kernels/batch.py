"""Verdicts for ranges of pairs: a queue that feeds piece pairs to the vectorised stages, then the rest one by one.

The k-th pair of a batch of shape (s0, s1, ...) uses row Σ index_d · stride_d of each operand
(two bodies, two pose arrays): broadcasting without copies.
"""

import numpy as np

from loewner._kernels import lanes, trees
from loewner._kernels._jit import inline, njit
from loewner._kernels.contact import maximize, nearness, rotated, separation
from loewner._kernels.exact import exact_piece_pair
from loewner._kernels.lanes import (
    CENTER_A,
    CENTER_B,
    IN_DISTANCE,
    IN_DOUBT,
    IN_LEVEL,
    IN_NORMAL,
    IN_POINT,
    LANES,
    NEAR,
    OFFSET,
    OUT_BOUND,
    OUT_DOUBT,
    OUT_NORMAL,
    RADII,
    REACHES,
    ROT_A,
    ROT_B,
    ROWS,
    SHAPE_A,
    SHAPE_B,
    SHIFT,
    SIGMA_A,
    SIGMA_B,
    SIZE,
)
from loewner._kernels.shapes import (
    INNER_CENTER,
    INNER_SHAPE,
    INNER_SIGMA,
    OUTER_CENTER,
    OUTER_RADIUS,
    OUTER_SHAPE,
    REACH,
)
from loewner._kernels.verdicts import (
    AMBIGUOUS,
    BY_INNER,
    BY_OUTER,
    BY_SPHERE,
    COLLIDING,
    EXACT,
    FREE,
    OPEN,
)

REFINING_STEPS = 12  # Newton steps for the few lanes whose guess may not be good enough


@inline
def row_of(k, shape, strides):
    """Row an operand contributes to pair k."""
    if shape.shape[0] == 1:
        return k * strides[0]
    row = 0
    rest = k
    for d in range(shape.shape[0] - 1, -1, -1):
        above = rest // shape[d]
        row += (rest - above * shape[d]) * strides[d]
        rest = above
    return row


@inline
def _copy(S, row, lane, source, at, column, count):
    for c in range(count):
        S[(row + c) * LANES + lane] = source[at, column + c]


@inline
def _move(S, target, lane, row, count):
    for c in range(count):
        S[(row + c) * LANES + target] = S[(row + c) * LANES + lane]


@inline
def _fill(S, row, count, used, padded):
    """Repeat lane 0 in the lanes between `used` and `padded`, so that vectors are whole and all numbers sane."""
    for lane in range(used, padded):
        for c in range(count):
            S[(row + c) * LANES + lane] = S[(row + c) * LANES]


@inline
def _padded(count):
    """Round up to whole vectors, so that the compiler's remainder loop has nothing to do."""
    return (count + 7) // 8 * 8


@njit()
def _lane_shapes(S, lane, posed):
    """World shape matrices of one lane."""
    p = (
        S[SHAPE_A * LANES + lane], S[(SHAPE_A + 1) * LANES + lane], S[(SHAPE_A + 2) * LANES + lane],
        S[(SHAPE_A + 3) * LANES + lane], S[(SHAPE_A + 4) * LANES + lane], S[(SHAPE_A + 5) * LANES + lane],
    )  # fmt: skip
    q = (
        S[SHAPE_B * LANES + lane], S[(SHAPE_B + 1) * LANES + lane], S[(SHAPE_B + 2) * LANES + lane],
        S[(SHAPE_B + 3) * LANES + lane], S[(SHAPE_B + 4) * LANES + lane], S[(SHAPE_B + 5) * LANES + lane],
    )  # fmt: skip
    if posed:
        a = S[ROT_A * LANES + lane : (ROT_A + 9) * LANES : LANES]
        b = S[ROT_B * LANES + lane : (ROT_B + 9) * LANES : LANES]
        p = rotated(a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], p[0], p[1], p[2], p[3], p[4], p[5])
        q = rotated(b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8], q[0], q[1], q[2], q[3], q[4], q[5])
    return p, q


@njit()
def _refined_outer(S, lane, posed):
    """Try again to separate the outer ellipsoids of one lane, with s iterated to the maximum."""
    p, q = _lane_shapes(S, lane, posed)
    x, y, z = S[OFFSET * LANES + lane], S[(OFFSET + 1) * LANES + lane], S[(OFFSET + 2) * LANES + lane]
    _, _, nx, ny, nz = maximize(*p, *q, x, y, z, REFINING_STEPS)
    S[OUT_NORMAL * LANES + lane] = nx
    S[(OUT_NORMAL + 1) * LANES + lane] = ny
    S[(OUT_NORMAL + 2) * LANES + lane] = nz
    return separation(*p, *q, x, y, z, nx, ny, nz, S[SIZE * LANES + lane])


@njit()
def _refined_inner(S, lane, posed, x, y, z):
    """Try again to find a common point of the inner ellipsoids of one lane; their centers are (x, y, z) apart."""
    p, q = _lane_shapes(S, lane, posed)
    _, s, nx, ny, nz = maximize(*p, *q, x, y, z, REFINING_STEPS)
    level, _, _, ax, ay, az, bx, by, bz = nearness(
        *p, *q, x, y, z, nx, ny, nz, s, S[SIGMA_A * LANES + lane], S[SIGMA_B * LANES + lane], S[SIZE * LANES + lane]
    )
    S[IN_NORMAL * LANES + lane] = nx
    S[(IN_NORMAL + 1) * LANES + lane] = ny
    S[(IN_NORMAL + 2) * LANES + lane] = nz
    S[IN_POINT * LANES + lane] = 0.5 * (ax + bx)
    S[(IN_POINT + 1) * LANES + lane] = 0.5 * (ay + by)
    S[(IN_POINT + 2) * LANES + lane] = 0.5 * (az + bz)
    return level


@njit()
def _center_offset(ta, i, Ta, ka, tb, j, Tb, kb, column):
    """World vector from a's to b's ellipsoid center; the translations are subtracted first."""
    ax, ay, az = ta[i, column], ta[i, column + 1], ta[i, column + 2]
    bx, by, bz = tb[j, column], tb[j, column + 1], tb[j, column + 2]
    x = (Tb[kb, 0, 3] - Ta[ka, 0, 3]) + (
        (Tb[kb, 0, 0] * bx + Tb[kb, 0, 1] * by + Tb[kb, 0, 2] * bz)
        - (Ta[ka, 0, 0] * ax + Ta[ka, 0, 1] * ay + Ta[ka, 0, 2] * az)
    )
    y = (Tb[kb, 1, 3] - Ta[ka, 1, 3]) + (
        (Tb[kb, 1, 0] * bx + Tb[kb, 1, 1] * by + Tb[kb, 1, 2] * bz)
        - (Ta[ka, 1, 0] * ax + Ta[ka, 1, 1] * ay + Ta[ka, 1, 2] * az)
    )
    z = (Tb[kb, 2, 3] - Ta[ka, 2, 3]) + (
        (Tb[kb, 2, 0] * bx + Tb[kb, 2, 1] * by + Tb[kb, 2, 2] * bz)
        - (Ta[ka, 2, 0] * ax + Ta[ka, 2, 1] * ay + Ta[ka, 2, 2] * az)
    )
    return x, y, z


@njit()
def _flush(mode, margin, posed, a, Ta, b, Tb, count, pair, pi, pj, pa, pb, S, G, weights, v, d, out, tally):
    """Settle the queued lanes and merge them into the verdicts of their pairs.

    `pair`, `pi`, `pj`, `pa`, `pb` say for each lane which pair, pieces and poses it stands for; they are compacted
    along with the lanes.
    """
    ta, la, xa, fa, hot_a = a[0], a[1], a[2], a[3], a[5]
    tb, lb, xb, fb, hot_b = b[0], b[1], b[2], b[3], b[5]
    for lane in range(count):
        i, j, ka, kb = pi[lane], pj[lane], pa[lane], pb[lane]
        _copy(S, CENTER_A, lane, hot_a, i, OUTER_CENTER, 3)
        _copy(S, CENTER_B, lane, hot_b, j, OUTER_CENTER, 3)
        for c in range(3):
            S[(SHIFT + c) * LANES + lane] = Tb[kb, c, 3] - Ta[ka, c, 3]
        S[RADII * LANES + lane] = hot_a[i, OUTER_RADIUS] + hot_b[j, OUTER_RADIUS]
        S[REACHES * LANES + lane] = hot_a[i, REACH] + hot_b[j, REACH]
        if posed:
            for r in range(3):
                for c in range(3):
                    S[(ROT_A + 3 * r + c) * LANES + lane] = Ta[ka, r, c]
                    S[(ROT_B + 3 * r + c) * LANES + lane] = Tb[kb, r, c]
    padded = _padded(count)
    _fill(S, CENTER_A, SIZE - CENTER_A, count, padded)
    if posed:
        _fill(S, ROT_A, 18, count, padded)
        lanes.posed_near(S, padded)
    else:
        lanes.plain_near(S, padded)

    left = 0
    for lane in range(count):
        if S[NEAR * LANES + lane] > margin:
            tally[BY_SPHERE] += 1
            continue
        if left < lane:
            _move(S, left, lane, OFFSET, 3)
            _move(S, left, lane, SHIFT, 3)
            _move(S, left, lane, SIZE, 1)
            if posed:
                _move(S, left, lane, ROT_A, 18)
            pair[left], pi[left], pj[left], pa[left], pb[left] = pair[lane], pi[lane], pj[lane], pa[lane], pb[lane]
        _copy(S, SHAPE_A, left, hot_a, pi[left], OUTER_SHAPE, 6)
        _copy(S, SHAPE_B, left, hot_b, pj[left], OUTER_SHAPE, 6)
        left += 1
    if left == 0:
        return
    count = left
    padded = _padded(count)
    _fill(S, SHAPE_A, 12, count, padded)
    _fill(S, SHIFT, 3, count, padded)
    _fill(S, SIZE, 1, count, padded)
    _fill(S, OFFSET, 3, count, padded)
    # A margin needs the near points, and they the best s: then every lane iterates.
    full = margin > 0.0
    if posed:
        _fill(S, ROT_A, 18, count, padded)
        if full:
            lanes.posed_full_outer(S, padded)
        else:
            lanes.posed_outer(S, padded)
    elif full:
        lanes.plain_full_outer(S, padded)
    else:
        lanes.plain_outer(S, padded)

    left = 0
    for lane in range(count):
        if S[OUT_BOUND * LANES + lane] > margin:
            tally[BY_OUTER] += 1
            continue
        # Only where F can exceed 1 somewhere is there anything left to separate.
        if not S[OUT_DOUBT * LANES + lane] < 1.0 and _refined_outer(S, lane, posed) > margin:
            tally[BY_OUTER] += 1
            continue
        if out[pair[lane]] == COLLIDING:
            continue
        if left < lane:
            _move(S, left, lane, SHIFT, 3)
            _move(S, left, lane, SIZE, 1)
            _move(S, left, lane, OUT_BOUND, OUT_DOUBT + 1 - OUT_BOUND)
            if posed:
                _move(S, left, lane, ROT_A, 18)
            pair[left], pi[left], pj[left], pa[left], pb[left] = pair[lane], pi[lane], pj[lane], pa[lane], pb[lane]
        i, j = pi[left], pj[left]
        _copy(S, CENTER_A, left, hot_a, i, INNER_CENTER, 3)
        _copy(S, CENTER_B, left, hot_b, j, INNER_CENTER, 3)
        _copy(S, SHAPE_A, left, hot_a, i, INNER_SHAPE, 6)
        _copy(S, SHAPE_B, left, hot_b, j, INNER_SHAPE, 6)
        S[SIGMA_A * LANES + left] = hot_a[i, INNER_SIGMA]
        S[SIGMA_B * LANES + left] = hot_b[j, INNER_SIGMA]
        left += 1
    if left == 0:
        return
    count = left
    padded = _padded(count)
    _fill(S, SHAPE_A, OFFSET - SHAPE_A, count, padded)
    if posed:
        _fill(S, ROT_A, 18, count, padded)
        if full:
            lanes.posed_full_inner(S, padded)
        else:
            lanes.posed_inner(S, padded)
    elif full:
        lanes.plain_full_inner(S, padded)
    else:
        lanes.plain_inner(S, padded)

    for lane in range(count):
        k = pair[lane]
        if out[k] == COLLIDING:
            continue
        i, j, ka, kb = pi[lane], pj[lane], pa[lane], pb[lane]
        overlap = S[IN_LEVEL * LANES + lane] <= 1.0
        if full:
            overlap = overlap or S[IN_DISTANCE * LANES + lane] <= margin
        if not overlap and not S[IN_DOUBT * LANES + lane] > 1.0:
            x, y, z = _center_offset(ta, i, Ta, ka, tb, j, Tb, kb, INNER_CENTER)
            overlap = _refined_inner(S, lane, posed, x, y, z) <= 1.0
        if overlap:
            out[k] = COLLIDING
            tally[BY_INNER] += 1
        elif mode == EXACT:
            verdict, tier = exact_piece_pair(
                ta, la, xa, fa, i, Ta, ka, tb, lb, xb, fb, j, Tb, kb, margin,
                S[OUT_NORMAL * LANES + lane], S[(OUT_NORMAL + 1) * LANES + lane], S[(OUT_NORMAL + 2) * LANES + lane],
                S[IN_NORMAL * LANES + lane], S[(IN_NORMAL + 1) * LANES + lane], S[(IN_NORMAL + 2) * LANES + lane],
                S[IN_POINT * LANES + lane], S[(IN_POINT + 1) * LANES + lane], S[(IN_POINT + 2) * LANES + lane],
                G, weights, v, d,
            )  # fmt: skip
            tally[tier] += 1
            if verdict != FREE:
                out[k] = verdict
        else:
            tally[OPEN] += 1
            out[k] = AMBIGUOUS


@njit()
def _queue_many(mode, margin, posed, k, ia, ka, ib, kb, a, Ta, b, Tb, count, pair, pi, pj, pa, pb, S, G, weights, v, d,
                out, tally):  # fmt: skip
    """Queue the piece pairs of pair k that the trees leave, settle full queues; returns how many wait."""
    steps = np.empty(trees.STEPS, np.int64)
    numbers = np.empty(trees.NUMBERS)
    found_a = np.empty(LANES, np.int64)
    found_b = np.empty(LANES, np.int64)
    trees.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
    while out[k] != COLLIDING:
        found = trees.more(a, b, ib, margin, steps, numbers, found_a, found_b)
        if found == 0:
            break
        for c in range(found):
            pair[count] = k
            pi[count] = found_a[c]
            pj[count] = found_b[c]
            pa[count] = ka
            pb[count] = kb
            count += 1
            if count == LANES:
                _flush(mode, margin, posed, a, Ta, b, Tb, count, pair, pi, pj, pa, pb, S, G, weights, v, d, out, tally)
                count = np.int64(0)
    return count


@njit()
def settle_range(mode, margin, start, stop, plan, a, Ta, b, Tb, out, tally):
    """Settle pairs start .. stop.

    Parameters
    ----------
    mode : int
        CERTIFY or EXACT.
    margin : float
        Distance that pairs must keep, >= 0.
    plan : ndarray of int64, shape (5, d)
        Batch shape, then the strides, in rows, of a, Ta, b and Tb along its axes.
    a, b : tuple of ndarray
        Packed pieces, see `shapes`.
    Ta, Tb : ndarray, shape (..., 4, 4), one batch axis
    out : ndarray of int8
        Receives the verdicts; AMBIGUOUS in mode EXACT means that the search did not settle the pair.
    tally : ndarray of int64, shape (TIERS,)
        Piece pairs settled by each tier are added here.
    """
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    S = np.empty(ROWS * LANES)
    G = np.empty((4, 9))
    weights = np.empty(4)
    v = np.empty(3)
    d = np.empty(3)
    pair = np.empty(LANES, np.int64)
    pi = np.empty(LANES, np.int64)
    pj = np.empty(LANES, np.int64)
    pa = np.empty(LANES, np.int64)
    pb = np.empty(LANES, np.int64)
    # Taken out of the tuples once: each time costs the counting of a reference.
    start_a, roots_a, start_b, roots_b = a[4], a[8], b[4], b[8]
    posed = not (_unturned(Ta) and _unturned(Tb))
    count = np.int64(0)  # typed: a constant would have `_flush` compiled twice
    # Walk the last axis by adding strides; only its end costs divisions.
    last = shape.shape[0] - 1
    here = shape[last]
    ia, ib, ka, kb = 0, 0, 0, 0
    for k in range(start, stop):
        out[k] = FREE
        if here == shape[last] or k == start:
            here = k % shape[last]
            ia = row_of(k, shape, body_a)
            ib = row_of(k, shape, body_b)
            ka = row_of(k, shape, pose_a)
            kb = row_of(k, shape, pose_b)
        else:
            ia += body_a[last]
            ib += body_b[last]
            ka += pose_a[last]
            kb += pose_b[last]
        here += 1
        if roots_a[ia] >= 0 or roots_b[ib] >= 0:
            count = _queue_many(mode, margin, posed, k, ia, ka, ib, kb, a, Ta, b, Tb, count, pair, pi, pj, pa, pb, S, G,
                                weights, v, d, out, tally)  # fmt: skip
            continue
        # Written out: a function for it would count references to all these arrays at each pair.
        for i in range(start_a[ia], start_a[ia + 1]):
            for j in range(start_b[ib], start_b[ib + 1]):
                if out[k] == COLLIDING:
                    break
                pair[count] = k
                pi[count] = i
                pj[count] = j
                pa[count] = ka
                pb[count] = kb
                count += 1
                if count == LANES:
                    _flush(mode, margin, posed, a, Ta, b, Tb, count, pair, pi, pj, pa, pb, S, G, weights, v, d, out,
                           tally)  # fmt: skip
                    count = np.int64(0)
    if count > 0:
        _flush(mode, margin, posed, a, Ta, b, Tb, count, pair, pi, pj, pa, pb, S, G, weights, v, d, out, tally)


@njit()
def settle_listed(mode, margin, rows_a, rows_b, body_step, pose_step, pack, T, out, tally):
    """Settle pairs of one set of bodies, listed by number.

    Parameters
    ----------
    rows_a, rows_b : ndarray of int64, shape (m,)
        The two bodies of each pair.
    body_step, pose_step : int
        1 if each body has its own pieces, its own pose; 0 if all share one.
    mode, margin, pack, T, out, tally
        As for `settle_range`.
    """
    S = np.empty(ROWS * LANES)
    G = np.empty((4, 9))
    weights = np.empty(4)
    v = np.empty(3)
    d = np.empty(3)
    pair = np.empty(LANES, np.int64)
    pi = np.empty(LANES, np.int64)
    pj = np.empty(LANES, np.int64)
    pa = np.empty(LANES, np.int64)
    pb = np.empty(LANES, np.int64)
    start, roots = pack[4], pack[8]
    posed = not _unturned(T)
    count = np.int64(0)
    for k in range(rows_a.shape[0]):
        out[k] = FREE
        ia, ka = rows_a[k] * body_step, rows_a[k] * pose_step
        ib, kb = rows_b[k] * body_step, rows_b[k] * pose_step
        if roots[ia] >= 0 or roots[ib] >= 0:
            count = _queue_many(mode, margin, posed, k, ia, ka, ib, kb, pack, T, pack, T, count, pair, pi, pj, pa, pb,
                                S, G, weights, v, d, out, tally)  # fmt: skip
            continue
        # Written out: a function for it would count references to all these arrays at each pair.
        for i in range(start[ia], start[ia + 1]):
            for j in range(start[ib], start[ib + 1]):
                if out[k] == COLLIDING:
                    break
                pair[count] = k
                pi[count] = i
                pj[count] = j
                pa[count] = ka
                pb[count] = kb
                count += 1
                if count == LANES:
                    _flush(mode, margin, posed, pack, T, pack, T, count, pair, pi, pj, pa, pb, S, G, weights, v, d, out,
                           tally)  # fmt: skip
                    count = np.int64(0)
    if count > 0:
        _flush(mode, margin, posed, pack, T, pack, T, count, pair, pi, pj, pa, pb, S, G, weights, v, d, out, tally)


@njit()
def _unturned(T):
    """Tell whether an operand has one pose only and that does not rotate."""
    if T.shape[0] != 1:
        return False
    for r in range(3):
        for c in range(3):
            if T[0, r, c] != (1.0 if r == c else 0.0):
                return False
    return True
