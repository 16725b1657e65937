"""Distances of ranges of pairs: certified bounds, an estimate, and on request the exact value.

All distances are signed, with penetration depths negative. The distance of two bodies is the minimum over their piece
pairs.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, inline_by_value, njit
from loewner._kernels.codes import DEPTH_FOUND, NEAREST, OVERLAPPING, TOUCHING, UNSETTLED
from loewner._kernels.columns import COLUMNS, ELLIPSOID, FRAME_CENTER, FRAME_FACTOR, KIND, POLYTOPE
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.ellipsoids.signed_distance import descend_eight, is_round, round_distance, support
from loewner._kernels.linalg3 import apply, dot, minus, plus, product, scaled, selected
from loewner._kernels.narrow import epa_fast
from loewner._kernels.narrow.epa_fast import overlap_depth
from loewner._kernels.narrow.epa_robust import CONTACT_ACCURACY, DEPTH_ACCURACY, NO_VOLUME, penetration, workspace
from loewner._kernels.narrow.gjk_fast import ENTRIES, begin, measure
from loewner._kernels.narrow.gjk_robust import run, swollen_radii, write_simplex
from loewner._kernels.narrow.surface_boxes import is_surface
from loewner._kernels.narrow.surface_distance import SIZE as SURFACE_SIZE
from loewner._kernels.narrow.surface_distance import surface_distance
from loewner._kernels.pieces.pack import pieces_of, placed
from loewner._kernels.pieces.shapes import prefetch_points, radius
from loewner._kernels.pipeline.bounds import (
    ABOVE,
    BELOW,
    F_INNER,
    F_OUTER,
    INSIDE,
    LANES,
    LATE,
    NORMAL,
    PAIR,
    PIECE_A,
    PIECE_B,
    POSE_A,
    POSE_B,
    QUEUE,
    ROT_A,
    ROT_B,
    ROUND_DISTANCE,
    ROUND_GAP,
    ROUND_RESULT,
    ROWS,
    SHIFT,
    SIZE,
    Operands,
    enqueue,
    estimated_distance,
    next_pieces,
    three,
    write_bounds,
)
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.simd.memory import Arena, floats, floats_at, integers, integers_at, raw
from loewner._kernels.simd.support import LINE, ask_line
from loewner._kernels.simd.vectors import LANES as EIGHT
from loewner._kernels.simd.vectors import broadcast, gather_transpose, load, mask_of, select, sqrt, store
from loewner._kernels.tolerances import POSITION_ROUNDINGS, UNIT_ROUNDOFF
from loewner._kernels.trees import piece_tree

SEED_ROUNDS = 3  # from one center to the nearest of the other body and back

KEPT = 4  # rows of the scratch array from SHIFT on, and from BELOW on, that are kept for an unsettled lane

POSE_ENTRIES = 16  # of a pose

AHEAD = 2  # lanes between the prefetch of a piece's vertices and their use

# A distance is settled when its bounds are this close, relative to the lengths involved.
SETTLED = 1e-9

# Curved pieces other than ellipsoids and balls may tie in every direction: the depth found is then correct to rounding,
# but the 1,500 points of the expanding polytope only prove it to 4e-4. Such a depth is returned: it belongs to a plane
# and two witnesses, and is never less than the true one.
SETTLED_CURVED = 1e-3

# Allowed difference between a depth and its witnesses, relative to the same lengths.
WITNESSES = 1e-5

SETTLED_DISTANCE, NOT_SETTLED = 0, 1


class Bounds(NamedTuple):
    """Bounds on the distance of each pair of bodies, and its estimate: arrays of shape (n,)."""

    lower: Any
    upper: Any
    estimate: Any


class Exact(NamedTuple):
    """Exact distances, an entry or a row for each pair of bodies.

    Attributes
    ----------
    distance : ndarray, shape (n,)
    witness_a, witness_b : ndarray, shape (n, 3)
        World points of a and b that attain it.
    normal : ndarray, shape (n, 3)
        Unit vector from a to b.
    status : ndarray of int8, shape (n,)
        SETTLED_DISTANCE or NOT_SETTLED.
    pieces : ndarray of int64, shape (n, 2), or empty
        Rows of the two pieces that attain it, on request.
    """

    distance: Any
    witness_a: Any
    witness_b: Any
    normal: Any
    status: Any
    pieces: Any


class Searches(NamedTuple):
    """Memory of the fast searches: ENTRIES of `gjk_fast`, both arrays of `epa_fast`, and a result.

    The result is a normal and two witnesses, nine numbers. `surfaces` is the address of memory for `surface_distance`.
    """

    vertices: Any
    faces: Any
    edges: Any
    result: Any
    surfaces: Any


MEMORY = Arena(
    scratch=floats(ROWS * LANES),  # of the bounds
    queue=integers(QUEUE, LANES),  # of piece pairs
    searches=Arena(
        Searches, vertices=floats(ENTRIES), faces=floats(epa_fast.FLOATS), edges=integers(epa_fast.INTEGERS),
        result=floats(9), surfaces=raw(SURFACE_SIZE),
    ),
)  # fmt: skip
_BYTES = MEMORY.size()
scratch_of, queue_of, searches_of = MEMORY.accessors("scratch queue searches")


class Left(NamedTuple):
    """Piece pairs that the fast searches did not settle, for `measure_left`.

    Attributes
    ----------
    pieces : ndarray of int64, shape (m, LATE)
        The rows of the queue from PAIR to INSIDE.
    values : ndarray, shape (m, 2 * KEPT)
        The kept entries of the scratch array.
    """

    pieces: Any
    values: Any


@njit()
def _distance_with_care(A, B, shift, n, error, inside, work, result):
    """Signed distance and gap if the fast search did not find them; the witnesses belong to the cores."""
    G = np.empty((4, 9))
    weights = np.empty(4)
    d = np.empty(3)
    k = 4
    lower, upper = -np.inf, -np.inf
    status = TOUCHING
    if not inside:
        status, lower, upper, k = run(A, B, shift, n, 0.0, False, G, weights, np.empty(3), d)
    ra, rb = radius(A), radius(B)
    # "Apart" must be proven, since a stalled search may have found separate points of overlapping cores.
    if k < 4 and upper + ra + rb > 4.0 * error and lower + ra + rb > 0.0 and status != UNSETTLED:
        write_simplex(G, k, weights, d, result)
        return upper, upper - lower
    # The depth sought is the upper bound, from the support plane of its normal. Only a graze needs more accuracy, to be
    # distinguished from a gap; deep in a curved piece this is not achievable, and requesting it degrades the witnesses.
    shallow, deep = penetration(A, B, shift, DEPTH_ACCURACY, work, result)
    graze = k < 4 and deep != NO_VOLUME and deep <= SETTLED / POSITION_ROUNDINGS * error
    if graze:
        shallow, deep = penetration(A, B, shift, CONTACT_ACCURACY, work, result)
    if deep != NO_VOLUME:
        if graze:
            # An expanding polytope that does not contain the origin need not contain its foot in the nearest face
            # either; GJK's points may be better.
            before = result.copy()
            missed = _miss(result, -deep)
            write_simplex(G, k, weights, d, result)
            for c in range(3):
                result[c] = before[c]
            if not _miss(result, -deep) < missed:
                for c in range(3, len(result)):
                    result[c] = before[c]
        return -deep - ra - rb, deep - shallow
    if upper + ra + rb > 4.0 * error:
        # The cores are apart after all: use GJK's result, with its gap.
        write_simplex(G, k, weights, d, result)
        return upper, upper - lower
    if k == 4:
        # Only possible by rounding: a flat simplex that seemed to contain the origin.
        return -np.inf, np.inf
    nx, ny, nz = result[0], result[1], result[2]
    write_simplex(G, k, weights, d, result)
    result[0], result[1], result[2] = nx, ny, nz
    return -ra - rb, 0.0


@njit()
def _miss(result, distance):
    """Deviation of the two points from being `distance` apart along the normal."""
    squared = 0.0
    for c in range(3):
        squared += (result[6 + c] - result[3 + c] - distance * result[c]) ** 2
    return np.sqrt(squared)


@inline
def _is_curved(P):
    return P.layout[P.piece, KIND] > POLYTOPE


@inline_by_value
def _eight(S, row, lane):
    """A vector of three consecutive rows, for eight lanes."""
    k = row * LANES + lane
    return load(S, k), load(S, k + LANES), load(S, k + 2 * LANES)


@inline_by_value
def _put_eight(S, row, lane, v):
    for c in range(3):
        store(S, (row + c) * LANES + lane, v[c])


@inline_by_value
def _placed_eight(S, rotation, pieces, queue, side, lane):
    """Factors of eight ellipsoids in the world's axes, and their centers minus their bodies' translations."""
    table, at = pieces.table, side * LANES + lane
    R = _eight(S, rotation, lane) + _eight(S, rotation + 3, lane) + _eight(S, rotation + 6, lane)
    first = gather_transpose(table, COLUMNS, queue, at, FRAME_CENTER)
    last = gather_transpose(table, COLUMNS, queue, at, FRAME_FACTOR + 1)
    return product(R, (first[3], *last)), apply(R, (first[0], first[1], first[2]))


@njit()
def _measure_round(count, queue, a, b, S, distance):
    """Measure the queued pairs of ellipsoids, eight at a time; pairs that need more care get an infinite gap."""
    for lane in range(count, (count + EIGHT - 1) // EIGHT * EIGHT):  # whole vectors, as in `write_bounds`
        queue[PIECE_A, lane], queue[PIECE_B, lane] = queue[PIECE_A, count - 1], queue[PIECE_B, count - 1]
    for first in range(0, count, EIGHT):
        bits = 0
        for lane in range(first, min(first + EIGHT, count)):
            wide_a = a.layout[queue[PIECE_A, lane], KIND] == ELLIPSOID
            wide_b = b.layout[queue[PIECE_B, lane], KIND] == ELLIPSOID
            if wide_a and wide_b and S[BELOW * LANES + lane] < distance[queue[PAIR, lane]]:
                bits |= 1 << (lane - first)
        if bits == 0:
            store(S, ROUND_GAP * LANES + first, broadcast(np.inf))
            continue
        FA, one = _placed_eight(S, ROT_A, a, queue, PIECE_A, first)
        FB, two = _placed_eight(S, ROT_B, b, queue, PIECE_B, first)
        two = plus(two, _eight(S, SHIFT, first))
        n = _eight(S, NORMAL, first)
        length = sqrt(dot(n, n))
        n = selected((length > 0.0) & (length < np.inf), scaled(1.0 / length, n), (0.0, 0.0, 1.0))
        size = load(S, SIZE * LANES + first)
        n, h, slope, proven = descend_eight(FA, FB, minus(two, one), n, size, mask_of(bits))
        store(S, ROUND_DISTANCE * LANES + first, -h)
        store(S, ROUND_GAP * LANES + first, select(proven, slope, np.inf))
        _put_eight(S, ROUND_RESULT, first, n)
        _put_eight(S, ROUND_RESULT + 3, first, plus(one, support(FA, n)))
        _put_eight(S, ROUND_RESULT + 6, first, minus(two, support(FB, n)))


@njit()
def measure_near(count, queue, operands, S, searches, exact):
    """Exact distances by the fast searches; unsettled lanes go to the front of the queue's last two rows."""
    a, b = pieces_of(operands.a), pieces_of(operands.b)
    Ta, Tb = borrowed(operands.poses_a), borrowed(operands.poses_b)
    queue, S, distance, result = borrowed(queue), borrowed(S), borrowed(exact.distance), borrowed(searches.result)
    vertices, faces, edges = borrowed(searches.vertices), borrowed(searches.faces), borrowed(searches.edges)
    _measure_round(count, queue, a, b, S, distance)
    late = 0
    for lane in range(count):
        if lane + AHEAD < count:
            prefetch_points(a.layout, a.points, queue[PIECE_A, lane + AHEAD])
            prefetch_points(b.layout, b.points, queue[PIECE_B, lane + AHEAD])
        if not S[BELOW * LANES + lane] < distance[queue[PAIR, lane]]:
            continue
        if S[ROUND_GAP * LANES + lane] < np.inf:
            for c in range(9):
                result[c] = S[(ROUND_RESULT + c) * LANES + lane]
            value, gap = S[ROUND_DISTANCE * LANES + lane], S[ROUND_GAP * LANES + lane]
            _record(lane, queue, Ta, S, value, gap, SETTLED, 0.0, 0.0, result, exact)
            continue
        A = placed(a, queue[PIECE_A, lane], Ta, queue[POSE_A, lane])
        B = placed(b, queue[PIECE_B, lane], Tb, queue[POSE_B, lane])
        shift, n = three(S, SHIFT, lane), three(S, NORMAL, lane)
        size = S[SIZE * LANES + lane]
        if is_surface(A) or is_surface(B):
            ra, rb = radius(A), radius(B)
            k, above = queue[PAIR, lane], S[ABOVE * LANES + lane]
            limit = above if above < distance[k] else distance[k]
            # Slightly more than the ellipsoids' bounds, for the bounds' rounding; they stretch with poses, and radii do
            # not.
            limit = max(limit, 0.0) * (1.0 + SETTLED) + SETTLED * size + swollen_radii(A, B)
            value, gap = surface_distance(A, B, n, limit, faces, edges, searches.surfaces, result)
            if value == np.inf and not distance[k] <= above:
                exact.status[k] = NOT_SETTLED  # the ellipsoids prove that something is nearer
                continue
            value = value - ra - rb
            if value < 0.0:  # a depth is a lower bound in spite of rounding
                value = min(value + position_error(size, UNIT_ROUNDOFF), 0.0)
            _record(lane, queue, Ta, S, value, gap, SETTLED, ra, rb, result, exact)
            continue
        if is_round(A) and is_round(B):
            value, gap = round_distance(A, B, n, size, result)
            _record(lane, queue, Ta, S, value, gap, SETTLED, 0.0, 0.0, result, exact)
            continue
        plain = not (_is_curved(A) or _is_curved(B))
        if plain and S[F_OUTER * LANES + lane] * S[F_INNER * LANES + lane] < 1.0:  # they seem to overlap
            searched, shallow, deep = overlap_depth(A, B, n, faces, edges, result)
            if searched == DEPTH_FOUND:
                _record(lane, queue, Ta, S, -deep, deep - shallow, SETTLED, 0.0, 0.0, result, exact)
                continue
        error = position_error(size, UNIT_ROUNDOFF)
        ends = begin(A, B, shift, vertices)
        status, below, above = measure(A, B, shift, vertices, ends, n, error, -np.inf, np.inf, result)
        ra, rb = radius(A), radius(B)
        # Cores whose inner ellipsoids prove an overlap are not apart: a gap found by a search was rounding.
        if status == NEAREST and above - ra - rb <= S[ABOVE * LANES + lane] + SETTLED * size:
            _record(lane, queue, Ta, S, above - ra - rb, above - below, SETTLED, ra, rb, result, exact)
        else:
            queue[LATE, late], queue[INSIDE, late] = lane, status == OVERLAPPING
            late += 1
    return late


@njit()
def measure_late(late, queue, operands, S, exact):
    """Exact distances of the lanes that the fast search did not settle; only they need the large workspace."""
    a, b, Ta, Tb = pieces_of(operands.a), pieces_of(operands.b), operands.poses_a, operands.poses_b
    faces, edges = epa_fast.workspace()
    result, work = np.empty(9), workspace(True)
    for m in range(late):
        lane, inside = queue[LATE, m], queue[INSIDE, m] == 1
        if not S[BELOW * LANES + lane] < exact.distance[queue[PAIR, lane]]:
            continue
        A = placed(a, queue[PIECE_A, lane], Ta, queue[POSE_A, lane])
        B = placed(b, queue[PIECE_B, lane], Tb, queue[POSE_B, lane])
        shift, n = three(S, SHIFT, lane), three(S, NORMAL, lane)
        error = position_error(S[SIZE * LANES + lane], UNIT_ROUNDOFF)
        curved = _is_curved(A) or _is_curved(B)
        if inside and not curved:
            searched, shallow, deep = overlap_depth(A, B, n, faces, edges, result)
            if searched == DEPTH_FOUND:
                _record(lane, queue, Ta, S, -deep, deep - shallow, SETTLED, 0.0, 0.0, result, exact)
                continue
        value, gap = _distance_with_care(A, B, shift, n, error, inside, work, result)
        tolerance = SETTLED_CURVED if curved and value < 0.0 else SETTLED
        ra, rb = radius(A), radius(B)
        if value < 0.0 and not _miss(result, value + ra + rb) <= WITNESSES * S[SIZE * LANES + lane]:
            tolerance = -1.0  # a depth that its witnesses do not confirm
        _record(lane, queue, Ta, S, value, gap, tolerance, ra, rb, result, exact)


@inline
def _record(lane, queue, Ta, S, value, gap, tolerance, ra, rb, result, exact):
    """Merge the exact distance of two pieces, and the gap between its bounds, into the result of their pair.

    `result` holds the normal and the witnesses, relative to a's translation and without the rounding radii ra and rb.
    """
    k, ka = queue[PAIR, lane], queue[POSE_A, lane]
    # The ellipsoids' own bound may be better. A value far below it is invalid, regardless of its own bounds.
    gap = min(gap, abs(value - S[BELOW * LANES + lane]))
    if not gap <= tolerance * S[SIZE * LANES + lane]:
        exact.status[k] = NOT_SETTLED
    if value < exact.distance[k]:
        exact.distance[k] = value
        for c in range(3):
            exact.normal[k, c] = result[c]
            exact.witness_a[k, c] = result[3 + c] + ra * result[c] + Ta[ka, c, 3]
            exact.witness_b[k, c] = result[6 + c] - rb * result[c] + Ta[ka, c, 3]
        if len(exact.pieces) > 0:
            exact.pieces[k, 0], exact.pieces[k, 1] = queue[PIECE_A, lane], queue[PIECE_B, lane]


@njit()
def _leave(late, queue, S, kept, left):
    """Note the unsettled lanes for `measure_left`, from row `kept` of the lists on; return the end."""
    for m in range(late):
        lane = queue[LATE, m]
        for row in range(PAIR, INSIDE):
            left.pieces[kept, row] = queue[row, lane]
        left.pieces[kept, INSIDE] = queue[INSIDE, m]
        for row in range(KEPT):
            left.values[kept, row] = S[(SHIFT + row) * LANES + lane]
            left.values[kept, KEPT + row] = S[(BELOW + row) * LANES + lane]
        kept += 1
    return kept


@njit()
def _room(kept, left):
    """Lists of unsettled pairs with room for another queue."""
    if kept + LANES <= len(left.pieces):
        return left
    more = Left(np.empty((2 * kept + LANES, LATE), np.int64), np.empty((2 * kept + LANES, 2 * KEPT)))
    # Written as loops, here and elsewhere: otherwise Numba would include code that raises an error if shapes differ.
    for n in range(kept):
        for c in range(LATE):
            more.pieces[n, c] = left.pieces[n, c]
        for c in range(2 * KEPT):
            more.values[n, c] = left.values[n, c]
    return more


@njit()
def _measure(wanted, count, queue, operands, S, searches, kept, left, bounds, exact):
    """Measure the queued piece pairs and merge them into the results of their pairs; return the unsettled ones."""
    write_bounds(count, queue, operands, S)
    lower, upper, estimate = bounds.lower, bounds.upper, bounds.estimate
    for lane in range(count):
        k = queue[PAIR, lane]
        below = S[BELOW * LANES + lane]
        above = S[ABOVE * LANES + lane]
        lower[k] = min(lower[k], below)
        upper[k] = min(upper[k], above)
        estimate[k] = min(estimate[k], max(below, min(above, estimated_distance(S, lane))))
    if wanted:
        late = measure_near(count, queue, operands, S, searches, exact)
        if late > 0:
            left = _room(kept, left)
            kept = _leave(late, queue, S, kept, left)
    return kept, left


@njit()
def _measure_many(wanted, k, ia, ka, ib, kb, queue, operands, S, searches, kept, left, bounds, exact):
    """Measure a pair of bodies with many pieces: only the piece pairs that may be the nearest."""
    a, b = pieces_of(operands.a), pieces_of(operands.b)
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    piece_tree.begin(a, ia, operands.poses_a, ka, b, ib, operands.poses_b, kb, steps, numbers)
    # A first bound on the distance saves the walk most pairs.
    i, j = piece_tree.nearest_centers(a, ia, b, ib, numbers, SEED_ROUNDS)
    enqueue(queue, 0, k, i, j, ka, kb)
    found = 1
    while found > 0:
        kept, left = _measure(wanted, found, queue, operands, S, searches, kept, left, bounds, exact)
        cut = bounds.upper[k]
        if wanted:
            cut = min(cut, exact.distance[k] + SETTLED * numbers[piece_tree.SIZE])
        found = next_pieces(k, ka, kb, ib, operands, max(cut, 0.0), steps, numbers, queue)
    return kept, left


@inline
def _ask(pieces, piece, poses, row):
    """Prefetch a piece and its pose, which may be anywhere in memory, and arrive while the queue fills."""
    for at in range(0, COLUMNS, LINE):
        ask_line(pieces.table, piece * COLUMNS + at)
    ask_line(pieces.table, piece * COLUMNS + COLUMNS - 1)
    for at in range(0, POSE_ENTRIES, LINE):
        ask_line(poses, row * POSE_ENTRIES + at)


@njit()
def memory_of_distances():
    """Number of bytes of memory for `distance_range`."""
    return _BYTES


@njit()
def distance_range(wanted, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, memory, lower, upper, estimate, distance,
                   witness_a, witness_b, normal, status):  # fmt: skip
    """Distances of pairs start .. stop.

    Operands are as in `verdicts`; the arrays of `Exact`, the last five, are only written if `wanted`. `memory` is the
    address of `MEMORY` scratch bytes, which one thread uses at a time.

    Returns
    -------
    pieces, values : ndarray
        The arrays of a `Left`, for `measure_left`, which has to finish its pairs.
    """
    bounds = Bounds(lower, upper, estimate)
    exact = Exact(distance, witness_a, witness_b, normal, status, integers_at(memory, (0, 2)))
    operands = Operands(pack_a, Ta, pack_b, Tb)
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    S, queue, searches = scratch_of(memory), queue_of(memory), searches_of(memory)
    # No room at first: even an empty array made here would be an allocation for every query.
    left = Left(integers_at(memory, (0, LATE)), floats_at(memory, (0, 2 * KEPT)))
    count, kept = 0, 0
    for k in range(start, stop):
        ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
        lower[k] = np.inf
        upper[k] = np.inf
        estimate[k] = np.inf
        if wanted:
            distance[k] = np.inf
            status[k] = SETTLED_DISTANCE
        if a.roots[ia] >= 0 or b.roots[ib] >= 0:
            kept, left = _measure(wanted, count, queue, operands, S, searches, kept, left, bounds, exact)
            count = 0
            kept, left = _measure_many(
                wanted, k, ia, ka, ib, kb, queue, operands, S, searches, kept, left, bounds, exact
            )
            continue
        for i in range(a.piece_start[ia], a.piece_start[ia + 1]):
            for j in range(b.piece_start[ib], b.piece_start[ib + 1]):
                enqueue(queue, count, k, i, j, ka, kb)
                count += 1
                if rows.shape[1] > 0:
                    _ask(a, i, Ta, ka)
                    _ask(b, j, Tb, kb)
                if count == LANES:
                    kept, left = _measure(wanted, count, queue, operands, S, searches, kept, left, bounds, exact)
                    count = 0
    kept, left = _measure(wanted, count, queue, operands, S, searches, kept, left, bounds, exact)
    return left.pieces[:kept], left.values[:kept]  # not a record, which Python would make by a slow call


@njit()
def measure_left(pieces, values, pack_a, Ta, pack_b, Tb, distance, witness_a, witness_b, normal, status):
    """Exact distances of the piece pairs in a `Left`; only compiled when there is one."""
    operands = Operands(pack_a, Ta, pack_b, Tb)
    exact = Exact(distance, witness_a, witness_b, normal, status, np.empty((0, 2), np.int64))
    S = np.empty(ROWS * LANES)
    queue = np.empty((QUEUE, LANES), np.int64)
    for first in range(0, len(pieces), LANES):
        count = min(LANES, len(pieces) - first)
        for lane in range(count):
            for row in range(PAIR, LATE):
                queue[row, lane] = pieces[first + lane, row]
            queue[LATE, lane] = lane
            for row in range(KEPT):
                S[(SHIFT + row) * LANES + lane] = values[first + lane, row]
                S[(BELOW + row) * LANES + lane] = values[first + lane, KEPT + row]
        measure_late(count, queue, operands, S, exact)
