"""Certified bounds on the distance of two pieces, eight pairs at a time, and an estimate of the distance.

All distances are signed: a penetration depth is a negative distance.

Each stage processes the whole queue and passes its results to the next stage in memory. Keeping eight pairs in
registers from the first stage to the last took 1.5 times as long, because each step of a stage waits for the previous
step.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import AMBIGUOUS, COLLIDING, FREE
from loewner._kernels.columns import COLUMNS, INNER_SHAPE, INNER_SIGMA, OUTER_CENTER, OUTER_SHAPE
from loewner._kernels.ellipsoids.contact import (
    farther_normal,
    gap_bound,
    nearness,
    newton_step,
    normal_at,
    outward_width,
    polynomials,
)
from loewner._kernels.linalg3 import apply, dot, minus, plus, rotated_shape, selected, trace
from loewner._kernels.narrow import pair_list
from loewner._kernels.narrow.certificate import bounds_of, pose_of, pose_of_one, size_between
from loewner._kernels.pieces.pack import pieces_of
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.simd.memory import Arena, floats, held
from loewner._kernels.simd.vectors import (
    LANES,
    gather_transpose,
    halves_swapped,
    load,
    mask_of,
    maximum,
    minimum,
    movemask,
    select,
    spread_row,
    sqrt,
    store,
)
from loewner._kernels.tolerances import SHAPE_ROUNDINGS, UNIT_ROUNDOFF
from loewner._kernels.trees import piece_tree

QUEUED = 32  # Maximum number of piece pairs in a queue; these pairs are bounded together.
WALKED = 16  # Maximum number of pairs that the trees yield at a time; a small number keeps the distance bound current.

BOUND_STEPS = 12  # Maximum number of Newton steps that maximise a contact function; it must be even.
POLISH_ROUNDS = 3  # Number of Newton rounds that tighten a bound by improving the direction between the near points.

# Mask of the lanes that hold the inner ellipsoids if a single pair is bounded. The first four lanes then hold its outer
# ellipsoids.
INNER_LANES = 0xF0


class Operands(NamedTuple):
    """Both operands of a query: for each, the handle of its pieces (see `pieces.pack`) and its poses."""

    a: Any
    poses_a: Any
    b: Any
    poses_b: Any


class Queue(NamedTuple):
    """Piece pairs that are bounded together, and their bounds: each array has one entry or column per pair.

    Attributes
    ----------
    pairs : PairList
    shift : ndarray, shape (3, QUEUED)
        Vector from the translation of a's pose to the translation of b's pose.
    size : ndarray, shape (QUEUED,)
        Sum of the lengths from which positions are computed.
    below, above : ndarray, shape (QUEUED,)
        Bounds on the signed distance.
    normal : ndarray, shape (3, QUEUED)
        The direction, from a to b, that proves the lower bound.
    contact : ndarray, shape (QUEUED,)
        Product of the maxima of the two contact functions, for the outer and for the inner ellipsoids.
    estimate : ndarray, shape (QUEUED,)
        The distance estimated from both contact functions; it is negative if and only if `contact` is below 1.
    """

    pairs: Any
    shift: Any
    size: Any
    below: Any
    above: Any
    normal: Any
    contact: Any
    estimate: Any


QUEUE = Arena(
    Queue, pairs=pair_list.arena(QUEUED), shift=floats(3, QUEUED), size=floats(QUEUED), below=floats(QUEUED),
    above=floats(QUEUED), normal=floats(3, QUEUED), contact=floats(QUEUED), estimate=floats(QUEUED),
)  # fmt: skip


class Side(NamedTuple):
    """One piece of every pair: each array has one entry or column per pair.

    Attributes
    ----------
    R : ndarray, shape (9, QUEUED)
        The rotation of its pose.
    outer, inner : ndarray, shape (9, QUEUED)
        Centers and shape matrices of the piece's outer and inner ellipsoids.
    sigma : ndarray, shape (QUEUED,)
        Lower bound on the least semi-axis of the inner ellipsoid.
    center, shape : ndarray, shape (3, QUEUED) and (6, QUEUED)
        The outer or the inner ellipsoid in world axes, with its center relative to the translation of the pose.
    """

    R: Any
    outer: Any
    inner: Any
    sigma: Any
    center: Any
    shape: Any


class Search(NamedTuple):
    """State of the search for bounds: each array has one entry or column per pair.

    Attributes
    ----------
    r
        Vector from the first to the second center.
    cubic, quadratic, s
        The polynomials of the contact function, see `polynomials`, and the argument s at which it is greatest.
    F, offset
        The contact function of the outer ellipsoids at s, and the offset of their centers along the contact normal.
    n, length, gap
        The last direction that was tried, its length, and the bound that it gives.
    Pn, Qn, width_p, width_q
        Products of the shapes P and Q with n; for upper bounds, also the errors of the widths, per length of n.
    """

    r: Any
    cubic: Any
    quadratic: Any
    s: Any
    F: Any
    offset: Any
    n: Any
    length: Any
    gap: Any
    Pn: Any
    Qn: Any
    width_p: Any
    width_q: Any


SIDE = Arena(
    Side, R=floats(9, QUEUED), outer=floats(9, QUEUED), inner=floats(9, QUEUED), sigma=floats(QUEUED),
    center=floats(3, QUEUED), shape=floats(6, QUEUED),
)  # fmt: skip
SEARCH = Arena(
    Search, r=floats(3, QUEUED), cubic=floats(4, QUEUED), quadratic=floats(3, QUEUED), s=floats(QUEUED),
    F=floats(QUEUED), offset=floats(QUEUED), n=floats(3, QUEUED), length=floats(QUEUED), gap=floats(QUEUED),
    Pn=floats(3, QUEUED), Qn=floats(3, QUEUED), width_p=floats(QUEUED), width_q=floats(QUEUED),
)  # fmt: skip
MEMORY = Arena(queue=QUEUE, a=SIDE, b=SIDE, search=SEARCH)
_BYTES = MEMORY.size()
queue_of, _a_of, _b_of, _search_of = MEMORY.accessors("queue a b search")
_side_at, (_a_at, _b_at) = SIDE.whole(), MEMORY.addresses("a b")


@njit()
def next_pieces(pair, pose_a, pose_b, body_b, operands, reach, steps, numbers, work):
    """Fill the front of the queue with the next piece pairs that a walk finds within `reach`; return their number."""
    a, b, pairs = pieces_of(operands.a), pieces_of(operands.b), queue_of(work).pairs
    count = piece_tree.more(a, b, body_b, reach, steps, numbers, pairs.piece_a[:WALKED], pairs.piece_b[:WALKED])
    pairs.pair[:count] = pair
    pairs.pose_a[:count] = pose_a
    pairs.pose_b[:count] = pose_b
    return count


@inline
def load_three(rows, at):
    """Load a vector of three rows for eight pairs."""
    return load(rows, at), load(rows, QUEUED + at), load(rows, 2 * QUEUED + at)


@inline
def _load_six(rows, at):
    return load_three(rows, at) + load_three(rows, 3 * QUEUED + at)


@inline
def _store_rows(rows, at, v):
    for c in range(len(v)):
        store(rows, c * QUEUED + at, v[c])


def _loading(fetch, pose_of, alone):
    """Make a function that loads many pairs, or a single pair."""

    @inline
    def load_side(pieces, poses, pose_rows, piece_rows, at, side):
        """Read eight pieces; return their poses and reaches."""
        pose = pose_of(borrowed(poses), pose_rows, at, True)
        near = bounds_of(fetch(pieces.table, COLUMNS, piece_rows, at, OUTER_CENTER))
        columns = fetch(pieces.table, COLUMNS, piece_rows, at, OUTER_SHAPE)
        store(side.sigma, at, columns[INNER_SIGMA - OUTER_SHAPE])
        outer = near.outer_center + columns[:6]
        inner = near.inner_center + fetch(pieces.table, COLUMNS, piece_rows, at, INNER_SHAPE)[:6]
        _store_rows(side.R, at, pose.R)
        for c in range(9):
            store(side.outer, c * QUEUED + at, select(mask_of(INNER_LANES), inner[c], outer[c]) if alone else outer[c])
            store(side.inner, c * QUEUED + at, inner[c])
        return pose, near.reach

    @njit()
    def load_pairs(count, operands, work):
        """Read the queued pairs.

        A single pair has four lanes for its outer ellipsoids and four for its inner ellipsoids, so one pass processes
        both.
        """
        queue = queue_of(work)
        a, b, pairs = pieces_of(operands.a), pieces_of(operands.b), queue.pairs
        for at in range(0, count, LANES):
            pose_a, reach_a = load_side(a, operands.poses_a, pairs.pose_a, pairs.piece_a, at, _a_of(work))
            pose_b, reach_b = load_side(b, operands.poses_b, pairs.pose_b, pairs.piece_b, at, _b_of(work))
            _store_rows(queue.shift, at, minus(pose_b.t, pose_a.t))
            store(queue.size, at, size_between(pose_a, reach_a, pose_b, reach_b))

    return load_pairs


_load_many, _load_one = _loading(gather_transpose, pose_of, False), _loading(spread_row, pose_of_one, True)


@njit()
def _turn(count, inner, address):
    """Rotate the outer or the inner ellipsoids of one side into world axes."""
    side = _side_at(address)
    ellipsoids = side.inner if inner else side.outer
    for at in range(0, count, LANES):
        R = _load_six(side.R, at) + load_three(side.R, 6 * QUEUED + at)
        _store_rows(side.shape, at, rotated_shape(R, _load_six(ellipsoids, 3 * QUEUED + at)))
        _store_rows(side.center, at, apply(R, load_three(ellipsoids, at)))


@njit()
def _place(count, inner, work):
    """Place the outer or the inner ellipsoids of the queued pairs."""
    _turn(count, inner, _a_at(work))
    _turn(count, inner, _b_at(work))
    queue, a, b, search = queue_of(work), _a_of(work), _b_of(work), _search_of(work)
    for at in range(0, count, LANES):
        apart = minus(load_three(b.center, at), load_three(a.center, at))
        _store_rows(search.r, at, plus(load_three(queue.shift, at), apart))


@njit()
def _find_best(count, work):
    """Find the maxima of the contact functions, for all pairs side by side: each step waits for the previous one.

    If two steps lead back to their start, which happens when only the last bits change, all later steps would do the
    same. Skipping the later steps therefore does not change a bit of the result.
    """
    a, b, search = _a_of(work), _b_of(work), _search_of(work)
    for at in range(0, count, LANES):
        P, Q, r = _load_six(a.shape, at), _load_six(b.shape, at), load_three(search.r, at)
        cubic, quadratic, s = polynomials(P, Q, r)
        _store_rows(search.cubic, at, cubic)
        _store_rows(search.quadratic, at, quadratic)
        store(search.s, at, s)
    for _ in range(BOUND_STEPS // 2):
        moved = 0
        for at in range(0, count, LANES):
            cubic = load_three(search.cubic, at) + (load(search.cubic, 3 * QUEUED + at),)
            quadratic = load_three(search.quadratic, at)
            s = load(search.s, at)
            t = newton_step(cubic, quadratic, newton_step(cubic, quadratic, s))
            store(search.s, at, t)
            moved |= movemask((t < s) | (t > s))
        if moved == 0:
            break


@inline
def _between_points(r, a, Pn, b, Qn):
    """Return the vector from the point a P n of one ellipsoid to the point r - b Q n of the other."""
    return r[0] - b * Qn[0] - a * Pn[0], r[1] - b * Qn[1] - a * Pn[1], r[2] - b * Qn[2] - a * Pn[2]


@inline
def _put_widths(search, at, P, Q, n, squared):
    """Store the widths along n, rounded outward, and P n and Q n, for the next round."""
    hp, Pn = outward_width(P, n, squared)
    hq, Qn = outward_width(Q, n, squared)
    _store_rows(search.Pn, at, Pn)
    _store_rows(search.Qn, at, Qn)
    store(search.width_p, at, hp)
    store(search.width_q, at, hq)
    return hp, hq


@njit()
def _first_lower_bounds(count, work):
    """Bound each distance along the contact normal; write F and the centers' offset; return whether a bound is > 0."""
    queue, a, b, search, positive = queue_of(work), _a_of(work), _b_of(work), _search_of(work), 0
    for at in range(0, count, LANES):
        P, Q, r = _load_six(a.shape, at), _load_six(b.shape, at), load_three(search.r, at)
        F, n = normal_at(P, Q, r, load(search.s, at))
        # If the ellipsoids are concentric, n is zero. It is then replaced, because any direction gives a valid bound.
        n = selected(dot(n, n) > 0.0, n, (1.0, 0.0, 0.0))
        squared = dot(n, n)
        hp, hq = _put_widths(search, at, P, Q, n, squared)
        length = sqrt(squared)
        offset = dot(n, r)
        bound = gap_bound(offset, hp, hq, length, load(queue.size, at))
        store(queue.below, at, bound)
        store(search.gap, at, bound)
        store(search.length, at, length)
        store(search.F, at, F)
        store(search.offset, at, offset / length)
        _store_rows(queue.normal, at, n)
        positive |= movemask(bound > 0.0)
    return positive != 0


@njit()
def _polish_lower_bounds(count, work):
    """Polish each bound by one round, and keep the result where it tightens the bound."""
    queue, a, b, search = queue_of(work), _a_of(work), _b_of(work), _search_of(work)
    for at in range(0, count, LANES):
        r, P, Q = load_three(search.r, at), _load_six(a.shape, at), _load_six(b.shape, at)
        Pn, Qn = load_three(search.Pn, at), load_three(search.Qn, at)
        hp, hq = load(search.width_p, at), load(search.width_q, at)
        y = _between_points(r, 1.0 / hp, Pn, 1.0 / hq, Qn)
        n = farther_normal(P, Q, y, Pn, Qn, hp, hq, load(search.length, at), load(search.gap, at))
        squared = dot(n, n)
        hp, hq = _put_widths(search, at, P, Q, n, squared)
        length = sqrt(squared)
        bound = gap_bound(dot(n, r), hp, hq, length, load(queue.size, at))
        store(search.gap, at, bound)
        store(search.length, at, length)
        best = load(queue.below, at)
        better = (bound > best) & (best > 0.0)  # Near points of overlapping ellipsoids have no meaning.
        store(queue.below, at, select(better, bound, best))
        _store_rows(queue.normal, at, selected(better, n, load_three(queue.normal, at)))


@njit()
def _first_upper_bounds(count, work):
    """Bound each distance by a common point or two near points, and estimate it; return whether a bound is > 0."""
    queue, a, b, search, positive = queue_of(work), _a_of(work), _b_of(work), _search_of(work), 0
    for at in range(0, count, LANES):
        P, Q, r = _load_six(a.shape, at), _load_six(b.shape, at), load_three(search.r, at)
        s, size = load(search.s, at), load(queue.size, at)
        sigma_a, sigma_b = load(a.sigma, at), load(b.sigma, at)
        F, n = normal_at(P, Q, r, s)
        level, best, depth = nearness(P, Q, r, n, s, sigma_a, sigma_b, size)
        # If the bound is NaN or infinite, use the distance between the centers, because the centers are also points of
        # the ellipsoids.
        centers = sqrt(dot(r, r)) * (1.0 + 8.0 * UNIT_ROUNDOFF)
        best = select(best < np.inf, best, centers + SHAPE_ROUNDINGS * size)
        best = select(level <= 1.0, -maximum(depth, 0.0), best)
        store(queue.above, at, best)
        # The rounding errors of P n and Q n change the levels of points by at most these amounts times the length of n.
        store(search.width_p, at, SHAPE_ROUNDINGS * trace(P) / sigma_a)
        store(search.width_q, at, SHAPE_ROUNDINGS * trace(Q) / sigma_b)
        _store_rows(search.n, at, n)
        contact, estimate = _estimated(load(search.F, at), F, load(search.offset, at))
        store(queue.contact, at, contact)
        store(queue.estimate, at, estimate)
        positive |= movemask(best > 0.0)
    return positive != 0


@njit()
def _polish_upper_bounds(count, work):
    """Polish each upper bound by one round, except bounds that are already depths."""
    queue, a, b, search = queue_of(work), _a_of(work), _b_of(work), _search_of(work)
    for at in range(0, count, LANES):
        P, Q, n = _load_six(a.shape, at), _load_six(b.shape, at), load_three(search.n, at)
        size = load(queue.size, at)
        squared = dot(n, n)
        length = sqrt(squared)
        hp, Pn = outward_width(P, n, squared)
        hq, Qn = outward_width(Q, n, squared)
        # Divide by slightly more than the width, so that rounding cannot push the points out of the ellipsoids. The
        # slack of at least 128 roundings also covers the rounding errors of the quotient.
        level_p = 1.0 / (hp + load(search.width_p, at) * length)
        level_q = 1.0 / (hq + load(search.width_q, at) * length)
        y = _between_points(load_three(search.r, at), level_p, Pn, level_q, Qn)
        distance = sqrt(dot(y, y)) * (1.0 + 8.0 * UNIT_ROUNDOFF) + SHAPE_ROUNDINGS * size
        store(queue.above, at, minimum(distance, load(queue.above, at)))
        _store_rows(search.n, at, farther_normal(P, Q, y, Pn, Qn, hp, hq, length, dot(n, y) / length))


@inline
def _estimated(F_outer, F_inner, offset):
    """Return the product of two contact functions, and the estimated distance: negative if the product is below 1.

    √F is the factor by which both ellipsoids must grow to touch. The factor assumed for the pieces is g, the geometric
    mean of the factors of the outer and the inner ellipsoids. Let the offset be the distance of the centers along the
    normal. If g times the width of the pieces along the normal equals the offset, the pieces are offset (1 - 1/g)
    apart.
    """
    contact = F_outer * F_inner
    g = sqrt(sqrt(maximum(contact, 0.0)))
    return contact, select(g > 0.0, offset * (1.0 - 1.0 / g), -np.inf)


@njit()
def _take_inner(work):
    """For a single pair, replace the outer ellipsoids and their best s with the inner ellipsoids and their best s."""
    a, b, search = _a_of(work), _b_of(work), _search_of(work)
    for c in range(6):
        _swap_halves(a.shape, c * QUEUED)
        _swap_halves(b.shape, c * QUEUED)
    for c in range(3):
        _swap_halves(search.r, c * QUEUED)
    _swap_halves(search.s, 0)


@inline
def _swap_halves(rows, at):
    store(rows, at, halves_swapped(load(rows, at)))


@njit()
def write_bounds(count, operands, work):
    """Compute both bounds for the queued piece pairs. Copies of the last pair fill the last vector."""
    queue = queue_of(work)
    if count == 1:
        _load_one(count, operands, work)
    else:
        pair_list.fill(queue.pairs, count)
        _load_many(count, operands, work)
    _place(count, False, work)
    _find_best(count, work)
    # Here and below, skip the rounds if no bound is positive, because the rounds tighten only positive bounds.
    if _first_lower_bounds(count, work):
        for _ in range(POLISH_ROUNDS):
            _polish_lower_bounds(count, work)
    if count == 1:
        _take_inner(work)
    else:
        _place(count, True, work)
        _find_best(count, work)
    if _first_upper_bounds(count, work):
        for _ in range(POLISH_ROUNDS):
            _polish_upper_bounds(count, work)
    for k in range(count):
        if not queue.below[k] > -np.inf:  # After an overflow (NaN), use the weakest bound, which is always valid.
            queue.below[k] = -2.0 * queue.size[k]


@njit()
def _decide(margin, count, operands, work, out):
    """Decide the queued piece pairs by the estimate."""
    write_bounds(count, operands, work)
    queue = queue_of(work)
    for lane in range(count):
        k = queue.pairs.pair[lane]
        if queue.below[lane] > margin or out[k] == COLLIDING:
            continue
        # The estimate should never be NaN. If it is, the pair counts as colliding, because NaN must not make a pair
        # free.
        if not queue.estimate[lane] > margin:
            out[k] = COLLIDING


@njit()
def estimate_range(margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out):
    """Decide the pairs left AMBIGUOUS in `out` by the estimate, the product of their two contact functions.

    The operands are documented in `verdicts`.
    """
    operands = Operands(pack_a, Ta, pack_b, Tb)
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    memory = np.empty(_BYTES // 8)
    work = np.int64(memory.ctypes.data)
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
                _decide(margin, count, operands, work, out)
                count = 0
            piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
            while out[k] != COLLIDING:
                pair_count = next_pieces(k, ka, kb, ib, operands, margin, steps, numbers, work)
                if pair_count == 0:
                    break
                _decide(margin, pair_count, operands, work, out)
            continue
        for i in range(a.piece_start[ia], a.piece_start[ia + 1]):
            for j in range(b.piece_start[ib], b.piece_start[ib + 1]):
                pair_list.put(queue_of(work).pairs, count, k, i, j, ka, kb)
                count += 1
                if count == QUEUED:
                    _decide(margin, count, operands, work, out)
                    count = 0
    if count > 0:
        _decide(margin, count, operands, work, out)
    held(memory)
