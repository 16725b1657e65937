"""Verdicts for ranges of pairs: the certificate for lists of piece pairs, then exact searches for the pairs left open.

In a batch of shape (s0, s1, ...), pair k uses row Σ index_d · stride_d of each operand (two bodies, two pose arrays).
The strides broadcast the operands without copies.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    BY_INNER,
    BY_OUTER,
    BY_PLANE,
    BY_SEARCH,
    BY_SPHERE,
    CERTIFY,
    COLLIDING,
    EXACT,
    FREE,
    NO_LIMIT,
    OPEN,
    RIGID,
    TOUCHING,
    UNSETTLED,
    UNSURE,
)
from loewner._kernels.columns import LAYOUT
from loewner._kernels.narrow import certificate, gjk_batch, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.exact import exact_piece_pair
from loewner._kernels.narrow.pair_list import fill
from loewner._kernels.narrow.surface_parts import has_parts, parts_tier
from loewner._kernels.pieces.pack import pieces_of
from loewner._kernels.pieces.rigid import fault
from loewner._kernels.pieces.shapes import prefetch_vertices, prefetch_vertices_far
from loewner._kernels.pipeline.workspace import (
    HALF,
    N_HELD,
    N_UNSURE,
    N_WALKING,
    ahead_of,
    carried_of,
    exact_of,
    held_normals_of,
    held_of,
    listed_of,
    normals_of,
    tier_of,
    unsure_of,
    walk_of,
)
from loewner._kernels.simd.vectors import SINGLE_LANES, prefetch
from loewner._kernels.trees import piece_tree

# Hints that one block passes to the next; they are also flags of `_flush`. FAR: the bounding spheres of most pairs are
# apart. CLOSE: single precision could not settle most pairs.
FAR, CLOSE = 1, 2

DISTINCT = 4  # Flag: no pair of bodies is listed twice, because each body is one piece.
CONSECUTIVE = 8  # Flag: the listed pairs have consecutive indices.
PREFETCHING = 16  # Flag: the list `ahead` contains the entries of a later block.
BEST = 32  # Flag: the listed pairs need the maximum of the contact function; the first guesses of s missed it.

AHEAD = 6  # Number of piece pairs by which the vertices of a piece pair are prefetched before they are used.

LEAD = 2 * BLOCK  # Number of piece pairs by which the rows of a piece pair are prefetched before their use.

ENOUGH = BLOCK // 2  # Number of unsure pairs that, once collected, are certified at the best s.


class Query(NamedTuple):
    """A query: the mode (CERTIFY or EXACT) and the margin; for each operand, the handle of its pieces, its poses, and
    whether any pose moves them.
    """

    mode: Any
    margin: Any
    a: Any
    poses_a: Any
    moved_a: Any
    b: Any
    poses_b: Any
    moved_b: Any


@inline
def row_of(k, shape, strides):
    """Return the row that an operand contributes to pair k."""
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
    """Return an entry of a flat array by an unsigned index, because a signed index might count from the end."""
    return array[np.uint64(place)]


@njit()
def is_identity(T):
    """Return whether an operand has only one pose, which is the identity."""
    if T.shape[0] != 1:
        return False
    for r in range(4):
        for c in range(4):
            if T[0, r, c] != (1.0 if r == c else 0.0):
                return False
    return True


@njit()
def _culled(query, flags, count, single, work):
    """Drop listed pairs whose bounding spheres are apart; return whether poses are rigid, and how many are left."""
    a, b = pieces_of(query.a), pieces_of(query.b)
    listed, ahead, tier = listed_of(work), ahead_of(work), tier_of(work)
    prefetching = flags & PREFETCHING != 0
    done = single and certificate.single_spheres(
        count, query.margin, prefetching, a.single, query.poses_a, query.moved_a, b.single, query.poses_b,
        query.moved_b, listed, ahead, tier,
    )  # fmt: skip
    done = done or certificate.spheres(
        count, query.margin, prefetching, a.hot, query.poses_a, query.moved_a, b.hot, query.poses_b, query.moved_b,
        listed, ahead, tier,
    )  # fmt: skip
    left = 0
    if not done:
        return False, left
    for lane in range(count):
        pair_list.copy(listed, left, listed, lane)
        left += tier[lane] != BY_SPHERE
    return True, left


@njit()
def _put_aside(count, listed, tier, waiting, unsure):
    """Append the UNSURE pairs to the list `unsure`, which holds `waiting` pairs; return its new length."""
    for lane in range(count):
        if tier[lane] == UNSURE:
            pair_list.copy(unsure, waiting, listed, lane)
            waiting += 1
    return waiting


@njit()
def _improved(query, count, work):
    """Certify UNSURE lanes again, at the maximum of the contact function; return False if a pose is not rigid."""
    a, b = pieces_of(query.a), pieces_of(query.b)
    again = ahead_of(work)  # This list may be overwritten, because its pairs have already been prefetched.
    unsure = _put_aside(count, listed_of(work), tier_of(work), 0, again)
    fill(again, unsure)
    tiers = np.empty(BLOCK, np.int8)
    normals = np.empty(3 * BLOCK)
    if not certificate.certify_best(
        unsure, 0.0, a.hot, query.poses_a, query.moved_a, b.hot, query.poses_b, query.moved_b, again, tiers, normals,
    ):  # fmt: skip
        return False
    n = 0
    for lane in range(count):
        if tier_of(work)[lane] == UNSURE:
            tier_of(work)[lane] = tiers[n]
            for row in range(3):
                normals_of(work)[row * BLOCK + lane] = normals[row * BLOCK + n]
            n += 1
    return True


@njit()
def _search(query, turn, count, fresh, last, work, out, tally):
    """Settle the open piece pairs in one half of the list by the exact searches.

    Pairs of small polytopes that the first plane does not separate wait until enough have been collected to fill the
    registers of the batch GJK. If `last` is 1, none are left waiting.

    Parameters
    ----------
    turn, count : int
        The half, and the number of its pairs.
    fresh : int
        Number of pairs in the other half. The vertices of such pairs are prefetched between the searches, because a
        burst of prefetches would delay the searches.
    last : int
        1 if these are the last pairs, otherwise 0.
    """
    a, b = pieces_of(query.a), pieces_of(query.b)
    Ta, Tb = borrowed(query.poses_a), borrowed(query.poses_b)
    held, N = held_of(work), held_normals_of(work)
    together = query.margin == 0.0 and len(a.single) > 0 and len(b.single) > 0
    at, way = turn * BLOCK, turn * (3 * BLOCK)
    other = BLOCK - at
    walking = carried_of(work)[N_WALKING]
    for n in range(max(count, fresh)):
        if n < fresh:
            prefetch_vertices_far(a.layout, a.vertices, _entry(held.piece_a, other + n))
            prefetch_vertices_far(b.layout, b.vertices, _entry(held.piece_b, other + n))
        if n + AHEAD < count:
            prefetch_vertices(a.layout, a.vertices, _entry(held.piece_a, at + n + AHEAD))
            prefetch_vertices(b.layout, b.vertices, _entry(held.piece_b, at + n + AHEAD))
        if n >= count:
            continue
        k = _entry(held.pair, at + n)
        if _entry(out, k) == COLLIDING:
            continue
        i, j = _entry(held.piece_a, at + n), _entry(held.piece_b, at + n)
        ka, kb = _entry(held.pose_a, at + n), _entry(held.pose_b, at + n)
        normal = _entry(N, way + n), _entry(N, way + BLOCK + n), _entry(N, way + 2 * BLOCK + n)
        if not (together and gjk_batch.takes(a.layout, i) and gjk_batch.takes(b.layout, j)):
            _search_one(query, k, i, j, ka, kb, normal, work, out, tally)
            continue
        gjk_batch.put(walk_of(work), walking, k, i, j, ka, kb, normal)
        free = gjk_batch.plane(
            a.single, a.layout, a.vertices, i, Ta, ka, b.single, b.layout, b.vertices, j, Tb, kb, normal
        )
        tally[BY_PLANE] += free
        walking += not free
        if walking == SINGLE_LANES:
            _walk(query, walking, work, out, tally)
            walking = 0
    if last != 0 and walking > 0:
        _walk(query, walking, work, out, tally)
        walking = 0
    carried_of(work)[N_WALKING] = walking


@njit()
def _walk(query, count, work, out, tally):
    """Settle up to sixteen pairs of small polytopes."""
    a, b = pieces_of(query.a), pieces_of(query.b)
    walk = gjk_batch.workspace_at(walk_of(work))
    listed, N, statuses = walk.listed, walk.directions, walk.found
    if count >= gjk_batch.FEW:
        gjk_batch.settle(
            count, a.single, a.layout, a.vertices, query.poses_a, query.moved_a, b.single, b.layout, b.vertices,
            query.poses_b, query.moved_b, walk_of(work),
        )  # fmt: skip
    else:
        statuses[:count] = UNSETTLED
    for n in range(count):
        k = listed.pair[n]
        if statuses[n] == UNSETTLED:
            normal = N[n], N[SINGLE_LANES + n], N[2 * SINGLE_LANES + n]
            _search_one(
                query, k, listed.piece_a[n], listed.piece_b[n], listed.pose_a[n], listed.pose_b[n], normal, work, out,
                tally,
            )  # fmt: skip
        else:
            tally[BY_SEARCH] += 1
            if statuses[n] == TOUCHING:
                out[k] = COLLIDING


@inline
def _search_one(query, k, i, j, ka, kb, normal, work, out, tally):
    """Settle one open piece pair of any kind."""
    verdict, tier, _ = exact_piece_pair(
        query.a, i, query.poses_a, ka, query.b, j, query.poses_b, kb, query.margin, normal, NO_LIMIT, exact_of(work)
    )
    tally[tier] += 1
    # Meanwhile, another piece pair of the same bodies may have been found colliding.
    if verdict != FREE and out[k] != COLLIDING:
        out[k] = verdict


@njit()
def _flush(query, flags, count, work, out, tally):
    """Certify the listed piece pairs and merge them into the verdicts of their pairs.

    Open pairs are held for the exact search in one half of a list while the next block is certified, so that their
    vertices arrive in the meantime. The few pairs that need the best s wait until they fill registers, and so do pairs
    for the batch GJK (see `_search`). If the list is not DISTINCT, no pair waits: an immediate result may make the
    other piece pairs unnecessary.

    Returns
    -------
    rigid : bool
        Whether all poses are rigid motions.
    hints : int
        FAR | CLOSE; the hints determine how the next block starts.
    """
    a, b = pieces_of(query.a), pieces_of(query.b)
    Ta, Tb = borrowed(query.poses_a), borrowed(query.poses_b)
    listed, tier, carried = listed_of(work), tier_of(work), carried_of(work)
    total, hints = count, flags & (FAR | CLOSE)
    fill(listed, count)
    single = len(a.single) > 0 and len(b.single) > 0 and flags & CLOSE == 0
    if flags & FAR:
        rigid, count = _culled(query, flags, count, single, work)
        if not rigid:
            return False, hints
        if count == 0:
            tally[BY_SPHERE] += total
            return True, hints
        fill(listed, count)
    unsure = 0
    if query.margin > 0.0 or flags & BEST:
        if not certificate.certify_best(
            count, query.margin, a.hot, Ta, query.moved_a, b.hot, Tb, query.moved_b, listed, tier, normals_of(work)
        ):
            return False, hints
    else:
        prefetching = flags & (PREFETCHING | FAR) == PREFETCHING
        done = single and certificate.single_certify(
            count, prefetching, a.single, Ta, query.moved_a, b.single, Tb, query.moved_b, listed, ahead_of(work), tier,
            normals_of(work),
        )  # fmt: skip
        done = done or certificate.certify(
            count, prefetching, a.hot, Ta, query.moved_a, b.hot, Tb, query.moved_b, listed, ahead_of(work), tier,
            normals_of(work),
        )  # fmt: skip
        if not done:
            return False, hints
        for lane in range(count):
            unsure += tier[lane] == UNSURE
        if flags & DISTINCT and carried[N_UNSURE] + unsure <= BLOCK:
            if unsure > 0:
                carried[N_UNSURE] = _put_aside(count, listed, tier, carried[N_UNSURE], unsure_of(work))
        elif unsure > 0 and not _improved(query, count, work):
            return False, hints

    if query.mode == CERTIFY and (has_parts(a) or has_parts(b)):
        for lane in range(count):
            if tier[lane] == OPEN:
                tier[lane] = parts_tier(
                    a, listed.piece_a[lane], Ta, listed.pose_a[lane], b, listed.piece_b[lane], Tb, listed.pose_b[lane],
                    query.margin,
                )  # fmt: skip
    # The loops avoid branches, because a processor could not predict the results of the pairs.
    far, outer, inner, left = total - count, 0, 0, 0
    for lane in range(count):
        far += tier[lane] == BY_SPHERE
        outer += tier[lane] == BY_OUTER
        inner += tier[lane] == BY_INNER
        left += tier[lane] == OPEN
    tally[BY_SPHERE] += far
    tally[BY_OUTER] += outer
    tally[BY_INNER] += inner
    unsettled = np.int8(FREE if query.mode == EXACT else AMBIGUOUS)
    if flags & CONSECUTIVE and count == total:
        begin = np.uint64(listed.pair[0])  # The index is unsigned for the reason given in `pair_list`.
        for lane in range(count):
            verdict = np.int8(COLLIDING) * (tier[lane] == BY_INNER) + unsettled * (tier[lane] == OPEN)
            out[begin + np.uint64(lane)] = verdict
    else:
        for lane in range(count):
            k = listed.pair[lane]
            verdict = np.int8(COLLIDING) * (tier[lane] == BY_INNER) + unsettled * (tier[lane] == OPEN)
            before = out[k]
            out[k] = before if (before == COLLIDING) | (verdict == FREE) else verdict
    hints = FAR * (2 * far > total) | CLOSE * ((2 * unsure > count) | (flags & CLOSE != 0))
    if query.mode != EXACT:
        tally[OPEN] += left
        return True, hints
    turn = 1 - carried[HALF]
    held = _hold(a, b, count, turn, work)
    if flags & DISTINCT:
        _search(query, carried[HALF], carried[N_HELD], held, 0, work, out, tally)
        carried[N_HELD], carried[HALF] = held, turn
    elif held > 0:
        _search(query, turn, held, 0, 1, work, out, tally)
    return True, hints


@inline
def _hold(a, b, count, turn, work):
    """Copy the OPEN pairs, with their normals, to one half of the list of held pairs; return their number."""
    listed, tier, held, at, way = listed_of(work), tier_of(work), held_of(work), turn * BLOCK, turn * (3 * BLOCK)
    # Find the open pairs first, without copying: few pairs are open, and copying a pair takes many instructions.
    open_pairs = 0
    for lane in range(count):
        held.pair[np.uint64(at + open_pairs)] = lane
        open_pairs += tier[lane] == OPEN
    for n in range(open_pairs):
        lane = _entry(held.pair, at + n)
        pair_list.copy(held, at + n, listed, lane)
        for row in range(3):
            held_normals_of(work)[np.uint64(way + row * BLOCK + n)] = _entry(normals_of(work), row * BLOCK + lane)
        prefetch(a.layout, _entry(listed.piece_a, lane) * LAYOUT)
        prefetch(b.layout, _entry(listed.piece_b, lane) * LAYOUT)
    return open_pairs


@inline
def _steps(row, at, more, first, step):
    """Write an arithmetic progression to one row of a list."""
    to = np.uint64(at)
    for lane in range(more):
        row[to + np.uint64(lane)] = first + lane * step


@inline
def _progressions(work, at, more, k, first, step):
    """List pairs k .. k + more, whose rows of bodies and poses are arithmetic progressions; list later ones in `ahead`.

    Later entries beyond the end of an axis are not used, and prefetching them does no harm.
    """
    listed, ahead = listed_of(work), ahead_of(work)
    _steps(listed.pair, at, more, k, 1)
    _steps(listed.piece_a, at, more, first[0], step[0])
    _steps(listed.piece_b, at, more, first[1], step[1])
    _steps(listed.pose_a, at, more, first[2], step[2])
    _steps(listed.pose_b, at, more, first[3], step[3])
    _steps(ahead.piece_a, at, more, first[0] + LEAD * step[0], step[0])
    _steps(ahead.piece_b, at, more, first[1] + LEAD * step[1], step[1])
    _steps(ahead.pose_a, at, more, first[2] + LEAD * step[2], step[2])
    _steps(ahead.pose_b, at, more, first[3] + LEAD * step[3], step[3])


@inline
def _picked(row, later, more, rows, side, k, stop, step):
    """Write the listed rows for pairs k .. k + more to the start of `row`, and the rows of later pairs to `later`."""
    begin = np.uint64(k)
    for lane in range(more):
        row[np.uint64(lane)] = rows[side, begin + np.uint64(lane)] * step
    for lane in range(min(more, stop - k - LEAD)):
        later[np.uint64(lane)] = rows[side, begin + np.uint64(LEAD + lane)] * step


@inline
def rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b):
    """Return the rows of a, b and their poses for pair k."""
    if rows.shape[1] > 0:
        return rows[0, k] * body_a[0], rows[1, k] * body_b[0], rows[0, k] * pose_a[0], rows[1, k] * pose_b[0]
    return row_of(k, shape, body_a), row_of(k, shape, body_b), row_of(k, shape, pose_a), row_of(k, shape, pose_b)


@njit()
def settle_range(mode, margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out, tally, memory):
    """Settle pairs start .. stop.

    One function handles all cases, including single pairs, because the code below would be compiled again for each
    additional function that calls it.

    Parameters
    ----------
    mode : int
        CERTIFY or EXACT.
    margin : float
        Distance that pairs must keep; at least 0.
    plan : ndarray of int64, shape (5, d)
        The batch shape, followed by the strides, in rows, of a, Ta, b and Tb along the axes of the batch.
    rows : ndarray of int64, shape (2, m) or (2, 0)
        If not empty, pair k takes row rows[0, k] of a and row rows[1, k] of b, and d is 1; strides then lead from one
        listed row to the next.
    pack_a, pack_b : int
        Handles of packed pieces, see `pieces.pack`.
    Ta, Tb : ndarray, shape (..., 4, 4), one batch axis
    out : ndarray of int8
        Receives the verdicts. In mode EXACT, AMBIGUOUS means that the search did not settle the pair.
    tally : ndarray of int64, shape (TIERS,)
        The number of piece pairs settled by each tier is added to this array.
    memory : int
        Address of `workspace.SIZE` scratch bytes; only one thread may use them at a time.

    Returns
    -------
    bool
        False if one of the poses is not a rigid motion; in that case, no result is valid.
    """
    work = memory
    carried_of(work)[:] = 0
    query = Query(mode, margin, pack_a, Ta, not is_identity(Ta), pack_b, Tb, not is_identity(Tb))
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    if len(a.piece_start) == len(a.layout) + 1 and len(b.piece_start) == len(b.layout) + 1:
        # If every body is one piece, the index of a body is also the index of its piece, so no lookup is needed.
        listed, ahead, carried = listed_of(work), ahead_of(work), carried_of(work)
        last = shape.shape[0] - 1
        step = body_a[last], body_b[last], pose_a[last], pose_b[last]
        hints = 0
        k = start
        while k < stop:
            count = 0
            while count < BLOCK and k < stop:
                more = min(BLOCK - count, stop - k)
                if rows.shape[1] > 0:
                    _steps(listed.pair, count, more, k, 1)
                    _picked(listed.piece_a, ahead.piece_a, more, rows, 0, k, stop, step[0])
                    _picked(listed.piece_b, ahead.piece_b, more, rows, 1, k, stop, step[1])
                    _picked(listed.pose_a, ahead.pose_a, more, rows, 0, k, stop, step[2])
                    _picked(listed.pose_b, ahead.pose_b, more, rows, 1, k, stop, step[3])
                else:
                    # Along the last axis of the batch, the rows of bodies and poses are arithmetic progressions.
                    more = min(more, shape[last] - k % shape[last])
                    first = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
                    _progressions(work, count, more, k, first, step)
                count += more
                k += more
            out[k - count : k] = FREE
            flags = hints | DISTINCT | CONSECUTIVE | PREFETCHING * (k + LEAD <= stop)
            rigid, hints = _flush(query, flags, count, work, out, tally)
            if not rigid:
                return False
            waiting = carried[N_UNSURE]
            if waiting >= ENOUGH or (waiting > 0 and k == stop):
                # Certify the waiting pairs in the memory of this block. Their results must not become hints, because
                # they do not predict the results of later blocks.
                carried[N_UNSURE] = 0
                for lane in range(waiting):
                    pair_list.copy(listed, lane, unsure_of(work), lane)
                if not _flush(query, DISTINCT | BEST, waiting, work, out, tally)[0]:
                    return False
        if carried[N_HELD] + carried[N_WALKING] > 0:
            _search(query, carried[HALF], carried[N_HELD], 0, 1, work, out, tally)
        return True

    # If a body has many pieces, use the trees.
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    found_a = np.empty(BLOCK, np.int64)
    found_b = np.empty(BLOCK, np.int64)
    hints, filled = 0, 0
    for k in range(start, stop):
        ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
        # Check the poses here: if the trees exclude all piece pairs, no test of a piece pair will check the poses.
        if (a.roots[ia] >= 0 or b.roots[ib] >= 0) and (fault(Ta[ka])[0] != RIGID or fault(Tb[kb])[0] != RIGID):
            return False
        out[k] = FREE
        piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
        while out[k] != COLLIDING:
            more = piece_tree.more(a, b, ib, query.margin, steps, numbers, found_a, found_b)
            if more == 0:
                break
            for c in range(more):
                pair_list.put(listed_of(work), filled, k, found_a[c], found_b[c], ka, kb)
                filled += 1
                if filled == BLOCK:
                    rigid, hints = _flush(query, hints, filled, work, out, tally)
                    if not rigid:
                        return False
                    filled = 0
    return filled == 0 or _flush(query, hints, filled, work, out, tally)[0]
