"""Verdicts for ranges of pairs: lists of piece pairs for the certificate, then the exact searches for the open ones.

The k-th pair of a batch of shape (s0, s1, ...) uses row Σ index_d · stride_d of each operand
(two bodies, two pose arrays): broadcasting without copies.
"""

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    BY_INNER,
    BY_OUTER,
    BY_PLANE,
    BY_SEARCH,
    BY_SPHERE,
    COLLIDING,
    EXACT,
    FREE,
    OPEN,
)
from loewner._kernels.narrow import certificate as lanes
from loewner._kernels.narrow import gjk_batch as walk
from loewner._kernels.narrow.certificate import (
    BLOCK,
    LATER,
    LISTS,
    PAIR,
    PIECE_A,
    PIECE_B,
    POSE_A,
    POSE_B,
    ROWS,
)
from loewner._kernels.narrow.exact import exact_piece_pair, workspace
from loewner._kernels.pieces.pack import pieces_of, placed
from loewner._kernels.pieces.poses import RIGID, fault
from loewner._kernels.pieces.shapes import LAYOUT, prefetch_vertices, prefetch_vertices_far
from loewner._kernels.simd.support import prefetch
from loewner._kernels.simd.vectors import SINGLE_LANES
from loewner._kernels.trees import piece_tree as trees

# What `_flush` found in a block, from which the next one may start otherwise: mostly pairs far apart; mostly pairs
# that single precision could not settle. Or a pose that is no rigid motion.
FAR, CLOSE = 1, 2
FAULTY = -1

AHEAD = 6  # piece pairs between asking for their vertices and their use

LEAD = 2 * BLOCK  # piece pairs between asking for their rows and their use

# Said to `_flush` besides: the list is of bodies of one piece, no pair twice; of consecutive ones; it tells what comes
# later; and it is of pairs that need the best s.
DISTINCT, CONSECUTIVE, ASKING, BEST = 4, 8, 16, 32

HALF = (POSE_B + 1) * BLOCK  # of the list of pairs that are open: one is searched while the other fills

# What is carried from block to block: how many pairs are held for the search, in which half of the list; wait for the
# best s; wait for a walk.
HELD, TURN, WAITING, WALKING, STATES = 0, 1, 2, 3, 4

ENOUGH = BLOCK // 2  # pairs that need the best s are settled when so many have come together


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
def _entry(array, place):
    """An entry of a flat array, not counted from the end: a signed place might be."""
    return array[np.uint64(place)]


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
def _culled(count, margin, asking, pack_a, Ta, moved_a, pack_b, Tb, moved_b, single, L, tier):
    """Drop the pairs whose bounding spheres are apart from the lists; how many are left, -1 for a faulty pose."""
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    done = single and lanes.single_spheres(count, margin, asking, a.single, Ta, moved_a, b.single, Tb, moved_b, L, tier)
    if not (done or lanes.spheres(count, margin, asking, a.hot, Ta, moved_a, b.hot, Tb, moved_b, L, tier)):
        return -1
    left = 0
    for lane in range(count):
        for row in range(PAIR, POSE_B + 1):
            L[row * BLOCK + left] = L[row * BLOCK + lane]
        left += tier[lane] != BY_SPHERE
    return left


@njit()
def _wait(count, waiting, L, tier, U):
    """Copy the listed pairs that are UNSURE to a list that `waiting` pairs are in already; how many are in it then."""
    for lane in range(count):
        if tier[lane] == lanes.UNSURE:
            for row in range(PAIR, POSE_B + 1):
                U[row * BLOCK + waiting] = L[row * BLOCK + lane]
            waiting += 1
    return waiting


@njit()
def _improved(count, pack_a, Ta, moved_a, pack_b, Tb, moved_b, L, tier, V):
    """Certify the lanes left UNSURE once more, at the best s; False for a faulty pose."""
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    again = np.empty(LISTS * BLOCK, np.int64)
    unsure = _wait(count, np.int64(0), L, tier, again)
    _fill(unsure, again)
    tiers = np.empty(BLOCK, np.int8)
    W = np.empty(ROWS * BLOCK)
    if not lanes.certify_best(unsure, 0.0, a.hot, Ta, moved_a, b.hot, Tb, moved_b, again, tiers, W):
        return False
    n = 0
    for lane in range(count):
        if tier[lane] == lanes.UNSURE:
            tier[lane] = tiers[n]
            for row in range(ROWS):
                V[row * BLOCK + lane] = W[row * BLOCK + n]
            n += 1
    return True


@njit()
def _search(query, half, count, fresh, last, lists, state, out, tally):
    """Settle the open piece pairs listed in one half of S and N by the exact searches.

    Pairs of small polytopes that no plane separates at once wait for a walk, `state[WALKING]` of them, until they fill
    registers. None are left if these are the last.

    Parameters
    ----------
    half, count : int
        Which half, and how many pairs it has.
    fresh : int
        Pairs in the other half, whose vertices are asked for: between the searches, which a burst of it would hold up.
    last : bool
    """
    _, margin, pack_a, Ta, _, pack_b, Tb, _ = query
    _, _, _, S, N, _, desk = lists
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    Ta, Tb, S, N, state = borrowed(Ta), borrowed(Tb), borrowed(S), borrowed(N), borrowed(state)
    together = margin == 0.0 and len(a.single) > 0 and len(b.single) > 0
    at, way = half * HALF, half * (ROWS * BLOCK)
    other = HALF - at
    walking = state[WALKING]
    for n in range(max(count, fresh)):
        if n < fresh:
            prefetch_vertices_far(a.layout, a.vertices, _entry(S, other + PIECE_A * BLOCK + n))
            prefetch_vertices_far(b.layout, b.vertices, _entry(S, other + PIECE_B * BLOCK + n))
        if n + AHEAD < count:
            prefetch_vertices(a.layout, a.vertices, _entry(S, at + PIECE_A * BLOCK + n + AHEAD))
            prefetch_vertices(b.layout, b.vertices, _entry(S, at + PIECE_B * BLOCK + n + AHEAD))
        if n >= count:
            continue
        k = _entry(S, at + PAIR * BLOCK + n)
        if _entry(out, k) == COLLIDING:
            continue
        i, j = _entry(S, at + PIECE_A * BLOCK + n), _entry(S, at + PIECE_B * BLOCK + n)
        ka, kb = _entry(S, at + POSE_A * BLOCK + n), _entry(S, at + POSE_B * BLOCK + n)
        x, y, z = _entry(N, way + n), _entry(N, way + BLOCK + n), _entry(N, way + 2 * BLOCK + n)
        if not (together and walk.takes(a.layout, i) and walk.takes(b.layout, j)):
            _search_one(query, k, i, j, ka, kb, (x, y, z), desk, out, tally)
            continue
        walk.put(desk[0], walking, k, i, j, ka, kb, x, y, z)
        free = walk.plane(a.single, a.layout, a.vertices, i, Ta, ka, b.single, b.layout, b.vertices, j, Tb, kb, x, y, z)
        tally[BY_PLANE] += free
        walking += not free
        if walking == SINGLE_LANES:
            _walk(query, walking, desk, out, tally)
            walking = np.int64(0)
    if last and walking > 0:
        _walk(query, walking, desk, out, tally)
        walking = np.int64(0)
    state[WALKING] = walking


@njit()
def _walk(query, count, desk, out, tally):
    """Settle up to sixteen pairs of small polytopes."""
    _, _, pack_a, Ta, moved_a, pack_b, Tb, moved_b = query
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    L, N, _, found = desk[0]
    if count >= walk.FEW:
        walk.settle(
            count, a.single, a.layout, a.vertices, Ta, moved_a, b.single, b.layout, b.vertices, Tb, moved_b, desk[0]
        )
    else:
        found[:count] = walk.OPEN
    for n in range(count):
        k = L[PAIR * SINGLE_LANES + n]
        if found[n] == walk.OPEN:
            _search_one(
                query, k, L[PIECE_A * SINGLE_LANES + n], L[PIECE_B * SINGLE_LANES + n], L[POSE_A * SINGLE_LANES + n],
                L[POSE_B * SINGLE_LANES + n], (N[n], N[SINGLE_LANES + n], N[2 * SINGLE_LANES + n]), desk, out, tally,
            )  # fmt: skip
        else:
            tally[BY_SEARCH] += 1
            if found[n] == walk.TOUCHING:
                out[k] = COLLIDING


@njit()
def _search_one(query, k, i, j, ka, kb, n, desk, out, tally):
    """Settle one open piece pair, whatever its pieces."""
    _, margin, pack_a, Ta, _, pack_b, Tb, _ = query
    A, B = placed(pieces_of(pack_a), i, Ta, ka), placed(pieces_of(pack_b), j, Tb, kb)
    verdict, t = exact_piece_pair(A, B, margin, n, desk[1])
    tally[t] += 1
    # In a body of many pieces another pair may have been found colliding meanwhile.
    if verdict != FREE and out[k] != COLLIDING:
        out[k] = verdict


@njit()
def _flush(query, hint, count, state, lists, out, tally):
    """Certify the listed piece pairs and merge them into the verdicts of their pairs.

    Those left open wait for the exact search in one half of S and N while the next block is certified: their vertices
    then arrive meanwhile. The few that need the best s wait in U until they fill registers; so do those that need a
    walk (see `_search`). If the list is not DISTINCT nothing waits: what is found at once may spare the rest.

    Parameters
    ----------
    query : tuple
        Mode, margin; for each operand the handle of its pieces, its poses, and whether they move anything.
    state : ndarray of int64
        How many pairs are HELD for the search and in which half (TURN), are WAITING for the best s, and are WALKING.
    lists : tuple of ndarray
        L, the list; tier and V, what certificates write; S and N; U; and for the searches to write to:
        `gjk_batch.workspace` and `exact.workspace`.

    Returns
    -------
    hint : int
        FAR | CLOSE for how to start with the next block, or FAULTY.
    """
    mode, margin, pack_a, Ta, moved_a, pack_b, Tb, moved_b = query
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    L, tier, V, S, N, U, desk = lists
    L, tier, V, S, N, U = borrowed(L), borrowed(tier), borrowed(V), borrowed(S), borrowed(N), borrowed(U)
    Ta, Tb, state = borrowed(Ta), borrowed(Tb), borrowed(state)
    listed = count
    _fill(count, L)
    single = len(a.single) > 0 and len(b.single) > 0 and hint & CLOSE == 0
    if hint & FAR:
        count = _culled(count, margin, hint & ASKING != 0, pack_a, Ta, moved_a, pack_b, Tb, moved_b, single, L, tier)
        if count < 0:
            return FAULTY
        if count == 0:
            tally[BY_SPHERE] += listed
            return hint & (FAR | CLOSE)
        _fill(count, L)
    unsure = np.int64(0)  # typed: a constant would have functions compiled twice
    if margin > 0.0 or hint & BEST:
        if not lanes.certify_best(count, margin, a.hot, Ta, moved_a, b.hot, Tb, moved_b, L, tier, V):
            return FAULTY
    else:
        asking = hint & (ASKING | FAR) == ASKING
        done = single and lanes.single_certify(count, asking, a.single, Ta, moved_a, b.single, Tb, moved_b, L, tier, V)
        if not (done or lanes.certify(count, asking, a.hot, Ta, moved_a, b.hot, Tb, moved_b, L, tier, V)):
            return FAULTY
        for lane in range(count):
            unsure += tier[lane] == lanes.UNSURE
        if hint & DISTINCT and state[WAITING] + unsure <= BLOCK:
            if unsure > 0:
                state[WAITING] = _wait(count, state[WAITING], L, tier, U)
        elif unsure > 0 and not _improved(count, pack_a, Ta, moved_a, pack_b, Tb, moved_b, L, tier, V):
            return FAULTY

    # Without branches: nobody can predict how the next pair comes out.
    far, outer, inner, left = listed - count, 0, 0, 0
    for lane in range(count):
        far += tier[lane] == BY_SPHERE
        outer += tier[lane] == BY_OUTER
        inner += tier[lane] == BY_INNER
        left += tier[lane] == OPEN
    tally[BY_SPHERE] += far
    tally[BY_OUTER] += outer
    tally[BY_INNER] += inner
    unsettled = np.int8(FREE if mode == EXACT else AMBIGUOUS)
    first = L[PAIR * BLOCK]
    if hint & CONSECUTIVE and count == listed:
        begin = np.uint64(first)  # unsigned for the reason given at `_steps`
        for lane in range(count):
            verdict = np.int8(COLLIDING) * (tier[lane] == BY_INNER) + unsettled * (tier[lane] == OPEN)
            out[begin + np.uint64(lane)] = verdict
    else:
        for lane in range(count):
            k = L[PAIR * BLOCK + lane]
            verdict = np.int8(COLLIDING) * (tier[lane] == BY_INNER) + unsettled * (tier[lane] == OPEN)
            before = out[k]
            out[k] = before if (before == COLLIDING) | (verdict == FREE) else verdict
    hint = FAR * (2 * far > listed) | CLOSE * ((2 * unsure > count) | (hint & CLOSE != 0)) | hint & DISTINCT
    if mode != EXACT:
        tally[OPEN] += left
        return hint & (FAR | CLOSE)
    # First where they are: few are open, and each has much to copy.
    turn = 1 - state[TURN]
    at, way = turn * HALF, turn * (ROWS * BLOCK)
    held = np.int64(0)
    for lane in range(count):
        S[np.uint64(at + held)] = lane
        held += tier[lane] == OPEN
    for n in range(held):
        lane = _entry(S, at + n)
        for row in range(PAIR, POSE_B + 1):
            S[np.uint64(at + row * BLOCK + n)] = _entry(L, row * BLOCK + lane)
        for row in range(ROWS):
            N[np.uint64(way + row * BLOCK + n)] = _entry(V, row * BLOCK + lane)
        prefetch(a.layout, _entry(L, PIECE_A * BLOCK + lane) * LAYOUT)
        prefetch(b.layout, _entry(L, PIECE_B * BLOCK + lane) * LAYOUT)
    if hint & DISTINCT:
        _search(query, state[TURN], state[HELD], held, False, lists, state, out, tally)
        state[HELD], state[TURN] = held, turn
    elif held > 0:
        _search(query, turn, held, np.int64(0), True, lists, state, out, tally)
    return hint & (FAR | CLOSE)


@inline
def _put(L, count, k, i, j, ka, kb):
    L[PAIR * BLOCK + count] = k
    L[PIECE_A * BLOCK + count] = i
    L[PIECE_B * BLOCK + count] = j
    L[POSE_A * BLOCK + count] = ka
    L[POSE_B * BLOCK + count] = kb


# Both write to unsigned places: a signed one might count from the end, and vectors would be scattered one by one.
@inline
def _steps(L, row, at, more, first, step):
    """Put an arithmetic progression into one row of the lists; and into that of what comes later, if it has one."""
    to = np.uint64(row * BLOCK + at)
    for lane in range(more):
        L[to + np.uint64(lane)] = first + lane * step
    if row != PAIR:
        # Past the end of the axis nobody needs these: no harm in asking.
        later = np.uint64((LATER + row) * BLOCK + at)
        for lane in range(more):
            L[later + np.uint64(lane)] = first + (LEAD + lane) * step


@inline
def _picked(L, row, more, rows, side, k, stop, step):
    """The same for what pairs k .. k + more that are listed by number use, at the begin of the row."""
    to, later, begin = np.uint64(row * BLOCK), np.uint64((LATER + row) * BLOCK), np.uint64(k)
    for lane in range(more):
        L[to + np.uint64(lane)] = rows[side, begin + np.uint64(lane)] * step
    for lane in range(min(more, stop - k - LEAD)):
        L[later + np.uint64(lane)] = rows[side, begin + np.uint64(LEAD + lane)] * step


@inline
def rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b):
    """Rows of a, b and their poses that belong to pair k."""
    if rows.shape[1] > 0:
        return rows[0, k] * body_a[0], rows[1, k] * body_b[0], rows[0, k] * pose_a[0], rows[1, k] * pose_b[0]
    return row_of(k, shape, body_a), row_of(k, shape, body_b), row_of(k, shape, pose_a), row_of(k, shape, pose_b)


@njit()
def settle_range(mode, margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out, tally):
    """Settle pairs start .. stop.

    One function for everything, single pairs included: what calls it would be compiled with all of it once more.

    Parameters
    ----------
    mode : int
        CERTIFY or EXACT.
    margin : float
        Distance that pairs must keep, >= 0.
    plan : ndarray of int64, shape (5, d)
        Batch shape, then the strides, in rows, of a, Ta, b and Tb along its axes.
    rows : ndarray of int64, shape (2, m) or (2, 0)
        If not empty, pair k is of a's row rows[0, k] and b's row rows[1, k], and d is 1: strides are then steps from
        one such row to the next.
    pack_a, pack_b : int
        Handles of packed pieces, see `handles`.
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
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    V = np.empty(ROWS * BLOCK)
    N = np.empty(2 * ROWS * BLOCK)
    L = np.empty(LISTS * BLOCK, np.int64)
    S = np.empty(2 * HALF, np.int64)
    U = np.empty(LISTS * BLOCK, np.int64)
    tier = np.empty(BLOCK, np.int8)
    desk = walk.workspace(), workspace()
    lists, again = (L, tier, V, S, N, U, desk), (U, tier, V, S, N, L, desk)
    query = mode, margin, pack_a, Ta, not is_identity(Ta), pack_b, Tb, not is_identity(Tb)
    listed = rows.shape[1] > 0
    # Typed: a constant would have `_flush` compiled twice.
    hint = np.int64(0)
    count = np.int64(0)
    state = np.zeros(STATES, np.int64)
    if len(a.piece_start) == len(a.layout) + 1 and len(b.piece_start) == len(b.layout) + 1:
        # One piece a body: nothing to look up.
        k = start
        while k < stop:
            count = np.int64(0)
            while count < BLOCK and k < stop:
                more = min(BLOCK - count, stop - k)
                last = shape.shape[0] - 1
                if listed:
                    _steps(L, PAIR, count, more, k, 1)
                    _picked(L, PIECE_A, more, rows, 0, k, stop, body_a[0])
                    _picked(L, PIECE_B, more, rows, 1, k, stop, body_b[0])
                    _picked(L, POSE_A, more, rows, 0, k, stop, pose_a[0])
                    _picked(L, POSE_B, more, rows, 1, k, stop, pose_b[0])
                else:
                    # Along the last axis the rows are arithmetic progressions.
                    more = min(more, shape[last] - k % shape[last])
                    ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
                    _steps(L, PAIR, count, more, k, 1)
                    _steps(L, PIECE_A, count, more, ia, body_a[last])
                    _steps(L, PIECE_B, count, more, ib, body_b[last])
                    _steps(L, POSE_A, count, more, ka, pose_a[last])
                    _steps(L, POSE_B, count, more, kb, pose_b[last])
                count += more
                k += more
            out[k - count : k] = FREE
            hint |= DISTINCT | CONSECUTIVE | ASKING * (k + LEAD <= stop)
            hint = _flush(query, hint, count, state, lists, out, tally)
            waiting = state[WAITING]
            if hint != FAULTY and (waiting >= ENOUGH or (waiting > 0 and k == stop)):
                # They say nothing about the blocks to come.
                state[WAITING] = 0
                if _flush(query, np.int64(DISTINCT | BEST), waiting, state, again, out, tally) == FAULTY:
                    hint = np.int64(FAULTY)
            if hint == FAULTY:
                return False
        if state[HELD] + state[WALKING] > 0:
            _search(query, state[TURN], state[HELD], np.int64(0), True, lists, state, out, tally)
        return True

    steps = np.empty(trees.STEPS, np.int64)
    numbers = np.empty(trees.NUMBERS)
    found_a = np.empty(BLOCK, np.int64)
    found_b = np.empty(BLOCK, np.int64)
    for k in range(start, stop):
        out[k] = FREE
        ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
        # The trees may leave no piece pair at all, and nobody else would then look at the poses.
        if (a.roots[ia] >= 0 or b.roots[ib] >= 0) and (fault(Ta[ka])[0] != RIGID or fault(Tb[kb])[0] != RIGID):
            return False
        trees.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
        while out[k] != COLLIDING:
            found = trees.more(a, b, ib, margin, steps, numbers, found_a, found_b)
            if found == 0:
                break
            for c in range(found):
                _put(L, count, k, found_a[c], found_b[c], ka, kb)
                count += 1
                if count == BLOCK:
                    hint = _flush(query, hint, count, state, lists, out, tally)
                    if hint == FAULTY:
                        return False
                    count = np.int64(0)
    if count > 0:
        hint = _flush(query, hint, count, state, lists, out, tally)
    return hint != FAULTY
