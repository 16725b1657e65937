"""Verdicts for ranges of pairs: lists of piece pairs for the certificate, then the open ones one by one.

The k-th pair of a batch of shape (s0, s1, ...) uses row Σ index_d · stride_d of each operand
(two bodies, two pose arrays): broadcasting without copies.
"""

import numpy as np

from loewner._kernels import lanes, trees
from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.exact import exact_piece_pair
from loewner._kernels.handles import arrays_of
from loewner._kernels.lanes import (
    BLOCK,
    LISTS,
    OPEN_LANE,
    OUT_NORMAL,
    PAIR,
    PIECE_A,
    PIECE_B,
    POSE_A,
    POSE_B,
    ROWS,
)
from loewner._kernels.pair_search import scratch
from loewner._kernels.rigid import RIGID, fault
from loewner._kernels.shapes import REACH, prefetch_points
from loewner._kernels.vectors import SINGLE_LANES
from loewner._kernels.verdicts import AMBIGUOUS, BY_INNER, BY_OUTER, BY_SPHERE, COLLIDING, EXACT, FREE, OPEN, TIERS

# What `_flush` found in a block, from which the next one may start otherwise: mostly pairs far apart; mostly pairs
# that single precision could not settle. Or a pose that is no rigid motion.
FAR, CLOSE = 1, 2
FAULTY = -1


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


@njit()
def is_identity(T):
    """Tell whether an operand has one pose only and that does nothing."""
    if T.shape[0] != 1:
        return False
    for r in range(4):
        for c in range(4):
            if T[0, r, c] != (1.0 if r == c else 0.0):
                return False
    return True


@inline
def _fill(count, L):
    """Repeat the last listed pair up to whole vectors."""
    for lane in range(count, (count + SINGLE_LANES - 1) // SINGLE_LANES * SINGLE_LANES):
        for row in range(PIECE_A, POSE_B + 1):
            L[row * BLOCK + lane] = L[row * BLOCK + count - 1]


@njit()
def _culled(count, margin, a, Ta, moved_a, b, Tb, moved_b, single, L, tier):
    """Drop the pairs whose bounding spheres are apart from the lists; how many are left, -1 for a faulty pose."""
    done = single and lanes.single_spheres(count, margin, a[5], Ta, moved_a, b[5], Tb, moved_b, L, tier)
    if not (done or lanes.spheres(count, margin, a[4], Ta, moved_a, b[4], Tb, moved_b, L, tier)):
        return -1
    left = 0
    for lane in range(count):
        for row in range(PAIR, POSE_B + 1):
            L[row * BLOCK + left] = L[row * BLOCK + lane]
        left += tier[lane] != BY_SPHERE
    return left


@njit()
def _improved(count, a, Ta, moved_a, b, Tb, moved_b, L, tier, V):
    """Certify the lanes left UNSURE once more, at the best s. How many there were, -1 for a faulty pose."""
    unsure = 0
    for lane in range(count):
        unsure += tier[lane] == lanes.UNSURE
    if unsure == 0:
        return 0
    again = np.empty(LISTS * BLOCK, np.int64)
    unsure = 0
    for lane in range(count):
        for row in range(PIECE_A, POSE_B + 1):
            again[row * BLOCK + unsure] = L[row * BLOCK + lane]
        again[PAIR * BLOCK + unsure] = lane
        unsure += tier[lane] == lanes.UNSURE
    _fill(unsure, again)
    tiers = np.empty(BLOCK, np.int8)
    W = np.empty(ROWS * BLOCK)
    if not lanes.certify_best(unsure, 0.0, a[4], Ta, moved_a, b[4], Tb, moved_b, again, tiers, W):
        return -1
    for n in range(unsure):
        lane = again[PAIR * BLOCK + n]
        tier[lane] = tiers[n]
        for row in range(ROWS):
            V[row * BLOCK + lane] = W[row * BLOCK + n]
    return unsure


@njit()
def _flush(mode, margin, distinct, hint, moved_a, moved_b, a, Ta, b, Tb, count, L, tier, V, W, out, tally):
    """Settle the listed piece pairs and merge them into the verdicts of their pairs.

    `distinct` says that the list is of consecutive pairs of bodies, one piece pair each.

    Takes and returns FAR | CLOSE as a hint how to start with the next block, or returns FAULTY.
    """
    ta, la, xa = borrowed(a[0]), borrowed(a[1]), borrowed(a[2])
    tb, lb, xb = borrowed(b[0]), borrowed(b[1]), borrowed(b[2])
    Ta, Tb, L, tier, V, W = borrowed(Ta), borrowed(Tb), borrowed(L), borrowed(tier), borrowed(V), borrowed(W)
    listed = count
    _fill(count, L)
    single = len(a[5]) > 0 and len(b[5]) > 0 and hint & CLOSE == 0
    if hint & FAR:
        count = _culled(count, margin, a, Ta, moved_a, b, Tb, moved_b, single, L, tier)
        if count < 0:
            return FAULTY
        if count == 0:
            tally[BY_SPHERE] += listed
            return hint
        _fill(count, L)
    unsure = 0
    if margin > 0.0:
        if not lanes.certify_best(count, margin, a[4], Ta, moved_a, b[4], Tb, moved_b, L, tier, V):
            return FAULTY
    else:
        done = single and lanes.single_certify(count, a[5], Ta, moved_a, b[5], Tb, moved_b, L, tier, V)
        if not (done or lanes.certify(count, a[4], Ta, moved_a, b[4], Tb, moved_b, L, tier, V)):
            return FAULTY
        unsure = _improved(count, a, Ta, moved_a, b, Tb, moved_b, L, tier, V)
        if unsure < 0:
            return FAULTY

    # Without branches: nobody can predict how the next pair comes out.
    far, outer, left = listed - count, 0, 0
    for lane in range(count):
        far += tier[lane] == BY_SPHERE
        outer += tier[lane] == BY_OUTER
        left += tier[lane] == OPEN
    tally[BY_SPHERE] += far
    tally[BY_OUTER] += outer
    tally[BY_INNER] += listed - far - outer - left
    unsettled = np.int8(FREE if mode == EXACT else AMBIGUOUS)
    first = L[PAIR * BLOCK]
    if distinct and count == listed:
        for lane in range(count):
            out[first + lane] = np.int8(COLLIDING) * (tier[lane] == BY_INNER) + unsettled * (tier[lane] == OPEN)
    else:
        for lane in range(count):
            k = L[PAIR * BLOCK + lane]
            verdict = np.int8(COLLIDING) * (tier[lane] == BY_INNER) + unsettled * (tier[lane] == OPEN)
            before = out[k]
            out[k] = before if (before == COLLIDING) | (verdict == FREE) else verdict
    if mode != EXACT:
        tally[OPEN] += left
    elif left > 0:
        left = 0
        for lane in range(count):
            L[OPEN_LANE * BLOCK + left] = lane
            left += tier[lane] == OPEN
        for n in range(left):
            lane = L[OPEN_LANE * BLOCK + n]
            prefetch_points(la, xa, L[PIECE_A * BLOCK + lane])
            prefetch_points(lb, xb, L[PIECE_B * BLOCK + lane])
        for n in range(left):
            lane = L[OPEN_LANE * BLOCK + n]
            k = L[PAIR * BLOCK + lane]
            if out[k] == COLLIDING:
                continue
            i, j = L[PIECE_A * BLOCK + lane], L[PIECE_B * BLOCK + lane]
            ka, kb = L[POSE_A * BLOCK + lane], L[POSE_B * BLOCK + lane]
            size = ta[i, REACH] + tb[j, REACH]
            for r in range(3):
                size += abs(Tb[kb, r, 3] - Ta[ka, r, 3])
            at = OUT_NORMAL * BLOCK + lane
            nx, ny, nz = V[at], V[at + BLOCK], V[at + 2 * BLOCK]
            verdict, t = exact_piece_pair(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, margin, size, nx, ny, nz, W)
            tally[t] += 1
            if verdict != FREE:
                out[k] = verdict
    return FAR * (2 * far > listed) | CLOSE * ((2 * unsure > count) | (hint & CLOSE != 0))


@inline
def _put(L, count, k, i, j, ka, kb):
    L[PAIR * BLOCK + count] = k
    L[PIECE_A * BLOCK + count] = i
    L[PIECE_B * BLOCK + count] = j
    L[POSE_A * BLOCK + count] = ka
    L[POSE_B * BLOCK + count] = kb


@inline
def _list(mode, margin, hint, moved_a, moved_b, k, ia, ka, ib, kb, a, Ta, b, Tb, count, L, tier, V, W, out, tally):
    """List the piece pairs of pair k, and settle the list whenever it is full; how many wait in it, and the hint."""
    if a[8][ia] >= 0 or b[8][ib] >= 0:
        return _list_many(
            mode, margin, hint, moved_a, moved_b, k, ia, ka, ib, kb, a, Ta, b, Tb, count, L, tier, V, W, out, tally
        )
    start_a, start_b = a[3], b[3]
    for i in range(start_a[ia], start_a[ia + 1]):
        for j in range(start_b[ib], start_b[ib + 1]):
            if out[k] == COLLIDING:
                break
            _put(L, count, k, i, j, ka, kb)
            count += 1
            if count == BLOCK:
                hint = _flush(
                    mode, margin, False, hint, moved_a, moved_b, a, Ta, b, Tb, count, L, tier, V, W, out, tally
                )
                count = np.int64(0)
    return count, hint


@njit()
def _list_many(mode, margin, hint, moved_a, moved_b, k, ia, ka, ib, kb, a, Ta, b, Tb, count, L, tier, V, W, out, tally):
    """As `_list`, where a body has many pieces: only the pairs that their trees leave."""
    # The trees may leave none, and nobody else would then look at the poses.
    if fault(Ta[ka])[0] != RIGID or fault(Tb[kb])[0] != RIGID:
        return count, FAULTY
    steps = np.empty(trees.STEPS, np.int64)
    numbers = np.empty(trees.NUMBERS)
    found_a = np.empty(BLOCK, np.int64)
    found_b = np.empty(BLOCK, np.int64)
    trees.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
    while out[k] != COLLIDING:
        found = trees.more(a, b, ib, margin, steps, numbers, found_a, found_b)
        if found == 0:
            break
        for c in range(found):
            _put(L, count, k, found_a[c], found_b[c], ka, kb)
            count += 1
            if count == BLOCK:
                hint = _flush(
                    mode, margin, False, hint, moved_a, moved_b, a, Ta, b, Tb, count, L, tier, V, W, out, tally
                )
                count = np.int64(0)
    return count, hint


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

    Returns
    -------
    bool
        False if one of the poses is no rigid motion; nothing then holds.
    """
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    V = np.empty(ROWS * BLOCK)
    L = np.empty(LISTS * BLOCK, np.int64)
    tier = np.empty(BLOCK, np.int8)
    W = scratch()
    la, lb, start_a, start_b = a[1], b[1], a[3], b[3]
    moved_a, moved_b = not is_identity(Ta), not is_identity(Tb)
    hint = 0
    count = np.int64(0)  # typed: a constant would have `_flush` compiled twice
    if shape.shape[0] == 1 and len(start_a) == len(la) + 1 and len(start_b) == len(lb) + 1:
        # One piece a body, one axis: the lists are arithmetic progressions.
        for first in range(start, stop, BLOCK):
            count = min(BLOCK, stop - first)
            for lane in range(count):
                L[PAIR * BLOCK + lane] = first + lane
                L[PIECE_A * BLOCK + lane] = (first + lane) * body_a[0]
                L[PIECE_B * BLOCK + lane] = (first + lane) * body_b[0]
                L[POSE_A * BLOCK + lane] = (first + lane) * pose_a[0]
                L[POSE_B * BLOCK + lane] = (first + lane) * pose_b[0]
                out[first + lane] = FREE
            hint = _flush(mode, margin, True, hint, moved_a, moved_b, a, Ta, b, Tb, count, L, tier, V, W, out, tally)
            if hint == FAULTY:
                return False
        return True
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
        count, hint = _list(
            mode, margin, hint, moved_a, moved_b, k, ia, ka, ib, kb, a, Ta, b, Tb, count, L, tier, V, W, out, tally
        )
        if hint == FAULTY:
            return False
    if count > 0:
        hint = _flush(mode, margin, False, hint, moved_a, moved_b, a, Ta, b, Tb, count, L, tier, V, W, out, tally)
    return hint != FAULTY


@njit()
def settle_listed(mode, margin, rows_a, rows_b, body_step, pose_step, pack, T, out, tally):
    """Settle pairs of one set of bodies, listed by number; the poses are known to be rigid.

    Parameters
    ----------
    rows_a, rows_b : ndarray of int64, shape (m,)
        The two bodies of each pair.
    body_step, pose_step : int
        1 if each body has its own pieces, its own pose; 0 if all share one.
    mode, margin, pack, T, out, tally
        As for `settle_range`.
    """
    V = np.empty(ROWS * BLOCK)
    L = np.empty(LISTS * BLOCK, np.int64)
    tier = np.empty(BLOCK, np.int8)
    W = scratch()
    moved = not is_identity(T)
    hint = 0
    count = np.int64(0)
    total = rows_a.shape[0]
    if len(pack[3]) == len(pack[1]) + 1:
        # One piece a body.
        for first in range(0, total, BLOCK):
            count = min(BLOCK, total - first)
            for lane in range(count):
                L[PAIR * BLOCK + lane] = first + lane
                L[PIECE_A * BLOCK + lane] = rows_a[first + lane] * body_step
                L[PIECE_B * BLOCK + lane] = rows_b[first + lane] * body_step
                L[POSE_A * BLOCK + lane] = rows_a[first + lane] * pose_step
                L[POSE_B * BLOCK + lane] = rows_b[first + lane] * pose_step
                out[first + lane] = FREE
            hint = _flush(mode, margin, True, hint, moved, moved, pack, T, pack, T, count, L, tier, V, W, out, tally)
        return
    for k in range(total):
        out[k] = FREE
        ia, ka = rows_a[k] * body_step, rows_a[k] * pose_step
        ib, kb = rows_b[k] * body_step, rows_b[k] * pose_step
        count, hint = _list(
            mode, margin, hint, moved, moved, k, ia, ka, ib, kb, pack, T, pack, T, count, L, tier, V, W, out, tally
        )
    if count > 0:
        _flush(mode, margin, False, hint, moved, moved, pack, T, pack, T, count, L, tier, V, W, out, tally)


@njit()
def settle_one(mode, margin, a, Ta, b, Tb):
    """Verdict of one pair of bodies, given by their handles (see `handles`), or -1 if a pose is no rigid motion."""
    plan = np.zeros((5, 1), np.int64)
    plan[0, 0] = 1
    out = np.empty(1, np.int8)
    tally = np.zeros(TIERS, np.int64)
    if settle_range(
        mode,
        margin,
        np.int64(0),
        np.int64(1),
        plan,
        arrays_of(a),
        Ta.reshape((1, 4, 4)),
        arrays_of(b),
        Tb.reshape((1, 4, 4)),
        out,
        tally,
    ):
        return np.int64(out[0])
    return np.int64(-1)
