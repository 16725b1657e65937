"""Distances of ranges of pairs: certified bounds, an estimate and, on request, the exact value.

All distances are signed: a penetration depth is a negative distance. The distance of two bodies is the minimum over
their piece pairs.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import DEPTH_FOUND, NEAREST, OVERLAPPING, TOUCHING, UNSETTLED
from loewner._kernels.columns import COLUMNS, ELLIPSOID, FRAME_CENTER, FRAME_FACTOR, KIND, POLYTOPE
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.ellipsoids.signed_distance import descend_eight, is_round, round_distance, support
from loewner._kernels.linalg3 import apply, dot, minus, plus, product, scaled, selected
from loewner._kernels.narrow import epa_fast, pair_list
from loewner._kernels.narrow.certificate import pose_of
from loewner._kernels.narrow.epa_fast import overlap_depth
from loewner._kernels.narrow.epa_robust import CONTACT_ACCURACY, DEPTH_ACCURACY, NO_VOLUME, penetration, workspace
from loewner._kernels.narrow.gjk_fast import ENTRIES, begin, measure
from loewner._kernels.narrow.gjk_robust import run, swollen_radii, write_simplex
from loewner._kernels.narrow.surface_boxes import is_surface
from loewner._kernels.narrow.surface_distance import surface_distance
from loewner._kernels.narrow.surface_walk import SIZE as SURFACE_SIZE
from loewner._kernels.pieces.pack import pieces_of, placed
from loewner._kernels.pieces.shapes import prefetch_points, radius
from loewner._kernels.pieces.support import LINE
from loewner._kernels.pipeline.bounds import MEMORY as QUEUE_MEMORY
from loewner._kernels.pipeline.bounds import QUEUED, Operands, load_three, next_pieces, queue_of, write_bounds
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.simd.memory import Arena, floats, floats_at, held, integers, integers_at, raw
from loewner._kernels.simd.vectors import (
    LANES,
    broadcast,
    gather_transpose,
    load,
    mask_of,
    prefetch_far,
    select,
    sqrt,
    store,
)
from loewner._kernels.tolerances import POSITION_ROUNDINGS, UNIT_ROUNDOFF
from loewner._kernels.trees import piece_tree

# Number of rounds of the search for the first piece pair. A round goes from a center to the nearest center of the other
# body, and back from there.
SEED_ROUNDS = 3

POSE_ENTRIES = 16  # Number of entries of a pose.

AHEAD = 2  # Number of lanes by which the vertices of a piece are prefetched before they are used.

# Tolerance of distances: a distance is settled if its bounds differ by at most SETTLED times the lengths involved.
SETTLED = 1e-9

# Tolerance of depths if a piece is curved. A curved piece that is neither an ellipsoid nor a ball may have the same
# depth in every direction. The computed depth is then correct up to rounding, but the 1,500 points of the expanding
# polytope prove it only to 4e-4. The depth is returned nonetheless, because a plane and two witnesses attain it, and it
# is never less than the true depth.
SETTLED_CURVED = 1e-3

NEVER = -1.0  # Tolerance with which no distance is settled.

# Largest allowed deviation of the vector between two witnesses from the depth times the normal, relative to the lengths
# involved.
WITNESSES = 1e-5

SETTLED_DISTANCE, NOT_SETTLED = 0, 1

LEFT_INTEGERS, LEFT_FLOATS = 6, 8  # Numbers of columns of the two arrays of a `Left`.


class Bounds(NamedTuple):
    """Bounds on the distance of each pair of bodies, and an estimate of the distance: arrays of shape (n,)."""

    lower: Any
    upper: Any
    estimate: Any


class Exact(NamedTuple):
    """Exact distances: each array has one entry or row per pair of bodies.

    Attributes
    ----------
    distance : ndarray, shape (n,)
    witness_a, witness_b : ndarray, shape (n, 3)
        World points of a and b that attain the distance.
    normal : ndarray, shape (n, 3)
        Unit vector from a to b.
    status : ndarray of int8, shape (n,)
        SETTLED_DISTANCE or NOT_SETTLED.
    pieces : ndarray of int64, shape (n, 2), or empty
        Rows of the two pieces that attain the distance, on request.
    """

    distance: Any
    witness_a: Any
    witness_b: Any
    normal: Any
    status: Any
    pieces: Any


class Searches(NamedTuple):
    """Memory of the fast searches: ENTRIES of `gjk_fast`, both arrays of `epa_fast`, and a result.

    The result is a normal and two witnesses: nine numbers. `surfaces` is the address of memory for `surface_distance`.
    """

    vertices: Any
    faces: Any
    edges: Any
    result: Any
    surfaces: Any


class Round(NamedTuple):
    """Results for pairs of ellipsoids, eight at a time: each array has one entry or column per pair of the queue.

    The results are the distance, a bound on its error (infinite if no distance was found), the normal and both
    witnesses.
    """

    distance: Any
    gap: Any
    result: Any


class Measured(NamedTuple):
    """The distance of two pieces, or the negative of their depth.

    Attributes
    ----------
    value : float
    gap : float
        Difference between the upper and the lower bound on the value.
    tolerance : float
        The largest gap, relative to the lengths involved, at which the value is settled.
    radius_a, radius_b : float
        Rounding radii of the pieces; the witnesses have yet to be moved by these radii.
    """

    value: Any
    gap: Any
    tolerance: Any
    radius_a: Any
    radius_b: Any


class Late(NamedTuple):
    """Places in the queue of the pairs that the fast searches leave open, and whether their cores certainly overlap."""

    place: Any
    inside: Any


MEMORY = Arena(
    queued=QUEUE_MEMORY,
    round=Arena(Round, distance=floats(QUEUED), gap=floats(QUEUED), result=floats(9, QUEUED)),
    late=Arena(Late, place=integers(QUEUED), inside=integers(QUEUED)),
    searches=Arena(
        Searches, vertices=floats(ENTRIES), faces=floats(epa_fast.FLOATS), edges=integers(epa_fast.INTEGERS),
        result=floats(9), surfaces=raw(SURFACE_SIZE),
    ),
)  # fmt: skip
_BYTES, _QUEUE_BYTES = MEMORY.size(), QUEUE_MEMORY.size()
(queued_at,), (round_of, late_of, searches_of) = MEMORY.addresses("queued"), MEMORY.accessors("round late searches")


class Left(NamedTuple):
    """Piece pairs that the fast searches did not settle, for `measure_left`.

    Attributes
    ----------
    pieces : ndarray of int64, shape (m, LEFT_INTEGERS)
        The entries of the pair list, and whether the cores certainly overlap.
    values : ndarray, shape (m, LEFT_FLOATS)
        The shift, the size, the lower bound and the normal, copied from the queue.
    """

    pieces: Any
    values: Any


@njit()
def _distance_with_care(A, B, shift, n, error, inside, work, result):
    """Compute a signed distance and its gap where the fast search found none; the witnesses are points of the cores."""
    G = np.empty((4, 9))
    weights = np.empty(4)
    d = np.empty(3)
    k = 4
    lower, upper = -np.inf, -np.inf
    status = TOUCHING
    if not inside:
        status, lower, upper, k = run(A, B, shift, n, 0.0, False, G, weights, np.empty(3), d)
    ra, rb = radius(A), radius(B)
    # The cores must be proven apart, because a stalled search may return separate points of overlapping cores.
    if k < 4 and upper + ra + rb > 4.0 * error and lower + ra + rb > 0.0 and status != UNSETTLED:
        write_simplex(G, k, weights, d, result)
        return upper, upper - lower
    # The returned depth is the upper bound, which is measured to the support plane perpendicular to the returned
    # normal. A higher accuracy is needed only for a graze, to distinguish it from a gap. If curved pieces overlap
    # deeply, the higher accuracy is not achievable, and requesting it would make the witnesses worse.
    shallow, deep = penetration(A, B, shift, DEPTH_ACCURACY, work, result)
    graze = k < 4 and deep != NO_VOLUME and deep <= SETTLED / POSITION_ROUNDINGS * error
    if graze:
        shallow, deep = penetration(A, B, shift, CONTACT_ACCURACY, work, result)
    if deep != NO_VOLUME:
        if graze:
            # If an expanding polytope does not contain the origin, its nearest face may not contain the foot of the
            # perpendicular from the origin either. The witnesses from GJK may therefore be better.
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
        # The cores are apart after all: return the distance from GJK, and the gap between its bounds.
        write_simplex(G, k, weights, d, result)
        return upper, upper - lower
    if k == 4:
        # This case occurs only if rounding made a flat simplex seem to contain the origin.
        return -np.inf, np.inf
    nx, ny, nz = result[0], result[1], result[2]
    write_simplex(G, k, weights, d, result)
    result[0], result[1], result[2] = nx, ny, nz
    return -ra - rb, 0.0


@njit()
def _miss(result, distance):
    """Return by how much the vector between the two points differs from `distance` times the normal."""
    squared = 0.0
    for c in range(3):
        squared += (result[6 + c] - result[3 + c] - distance * result[c]) ** 2
    return np.sqrt(squared)


@inline
def _is_curved(P):
    return P.layout[P.piece, KIND] > POLYTOPE


@inline
def _column(rows, k):
    """Load a vector of the queue for one pair."""
    return rows[0, k], rows[1, k], rows[2, k]


@inline
def _placed_eight(R, pieces, rows, at):
    """Factors of eight ellipsoids in world axes, and their centers relative to the translations of their bodies."""
    first = gather_transpose(pieces.table, COLUMNS, rows, at, FRAME_CENTER)
    last = gather_transpose(pieces.table, COLUMNS, rows, at, FRAME_FACTOR + 1)
    return product(R, (first[3], *last)), apply(R, (first[0], first[1], first[2]))


@njit()
def _measure_round(count, operands, work, distance):
    """Measure the queued pairs of ellipsoids, eight at a time; a pair that needs more care gets an infinite gap."""
    a, b, queue, answers = pieces_of(operands.a), pieces_of(operands.b), queue_of(queued_at(work)), round_of(work)
    pairs = queue.pairs
    pair_list.fill(pairs, count)
    for first in range(0, count, LANES):
        bits = 0
        for k in range(first, min(first + LANES, count)):
            wide_a = a.layout[pairs.piece_a[k], KIND] == ELLIPSOID
            wide_b = b.layout[pairs.piece_b[k], KIND] == ELLIPSOID
            if wide_a and wide_b and queue.below[k] < distance[pairs.pair[k]]:
                bits |= 1 << (k - first)
        if bits == 0:
            store(answers.gap, first, broadcast(np.inf))
            continue
        pose_a = pose_of(borrowed(operands.poses_a), pairs.pose_a, first, True)
        pose_b = pose_of(borrowed(operands.poses_b), pairs.pose_b, first, True)
        FA, one = _placed_eight(pose_a.R, a, pairs.piece_a, first)
        FB, two = _placed_eight(pose_b.R, b, pairs.piece_b, first)
        two = plus(two, load_three(queue.shift, first))
        n = load_three(queue.normal, first)
        length = sqrt(dot(n, n))
        n = selected((length > 0.0) & (length < np.inf), scaled(1.0 / length, n), (0.0, 0.0, 1.0))
        size = load(queue.size, first)
        n, h, slope, proven = descend_eight(FA, FB, minus(two, one), n, size, mask_of(bits))
        store(answers.distance, first, -h)
        store(answers.gap, first, select(proven, slope, np.inf))
        result = n + plus(one, support(FA, n)) + minus(two, support(FB, n))
        for c in range(9):
            store(answers.result, c * QUEUED + first, result[c])


@inline
def _of_eight(eight, lane, result):
    """Extract the result of `_measure_round` for one pair of ellipsoids."""
    for c in range(9):
        result[c] = eight.result[c, lane]
    return Measured(eight.distance[lane], eight.gap[lane], SETTLED, 0.0, 0.0)


@inline
def _of_surfaces(A, B, lane, queue, known, searches):
    """Distance of a surface and another piece, provided that it is less than the `known` distance of their bodies."""
    ra, rb, size, above = radius(A), radius(B), queue.size[lane], queue.above[lane]
    limit = above if above < known else known
    # The limit is slightly larger than the bound from the ellipsoids, because that bound is rounded, and because poses
    # that are not exactly rigid stretch the bound but not the radii.
    limit = max(limit, 0.0) * (1.0 + SETTLED) + SETTLED * size + swollen_radii(A, B)
    value, gap = surface_distance(
        A, B, _column(queue.normal, lane), limit, searches.faces, searches.edges, searches.surfaces, searches.result
    )
    if value == np.inf and not known <= above:
        return Measured(np.inf, np.inf, NEVER, ra, rb)  # The ellipsoids prove a distance that the search missed.
    value = value - ra - rb
    if value < 0.0:  # Rounding must not make the returned depth larger than the true depth.
        value = min(value + position_error(size, UNIT_ROUNDOFF), 0.0)
    return Measured(value, gap, SETTLED, ra, rb)


@inline
def _of_balls(A, B, lane, queue, result):
    """Distance of two ellipsoids or balls that are not measured eight at a time."""
    value, gap = round_distance(A, B, _column(queue.normal, lane), queue.size[lane], result)
    return Measured(value, gap, SETTLED, 0.0, 0.0)


@inline
def _of_overlap(A, B, n, faces, edges, result):
    """Return whether two polytopes certainly overlap, and their depth if they do."""
    searched, shallow, deep = overlap_depth(A, B, n, faces, edges, result)
    return searched == DEPTH_FOUND, Measured(-deep, deep - shallow, SETTLED, 0.0, 0.0)


@inline
def _of_cores(A, B, lane, queue, searches):
    """Status and distance of any other pieces: NEAREST if the distance is found, otherwise another status."""
    shift, n, size = _column(queue.shift, lane), _column(queue.normal, lane), queue.size[lane]
    plain = not (_is_curved(A) or _is_curved(B))
    if plain and queue.contact[lane] < 1.0:  # The pieces probably overlap.
        settled, depth = _of_overlap(A, B, n, searches.faces, searches.edges, searches.result)
        if settled:
            return NEAREST, depth
    error = position_error(size, UNIT_ROUNDOFF)
    ends = begin(A, B, shift, searches.vertices)
    status, below, above = measure(A, B, shift, searches.vertices, ends, n, error, -np.inf, np.inf, searches.result)
    ra, rb = radius(A), radius(B)
    # A distance above the ellipsoids' upper bound is wrong because of rounding, for example a positive distance
    # although the inner ellipsoids overlap.
    if status == NEAREST and not above - ra - rb <= queue.above[lane] + SETTLED * size:
        status = UNSETTLED
    return status, Measured(above - ra - rb, above - below, SETTLED, ra, rb)


@njit()
def measure_near(count, operands, work, exact):
    """Measure the queued pairs exactly by the fast searches; list the pairs that these leave open, and return their
    number.
    """
    a, b = pieces_of(operands.a), pieces_of(operands.b)
    Ta, Tb = borrowed(operands.poses_a), borrowed(operands.poses_b)
    queue, eight, left, searches = queue_of(queued_at(work)), round_of(work), late_of(work), searches_of(work)
    pairs, distance, result = queue.pairs, borrowed(exact.distance), searches.result
    _measure_round(count, operands, work, distance)
    late = 0
    for lane in range(count):
        if lane + AHEAD < count:
            prefetch_points(a.layout, a.points, pairs.piece_a[lane + AHEAD])
            prefetch_points(b.layout, b.points, pairs.piece_b[lane + AHEAD])
        least = distance[pairs.pair[lane]]
        if not queue.below[lane] < least:
            continue
        A = placed(a, pairs.piece_a[lane], Ta, pairs.pose_a[lane])
        B = placed(b, pairs.piece_b[lane], Tb, pairs.pose_b[lane])
        status = NEAREST
        if eight.gap[lane] < np.inf:
            measured = _of_eight(eight, lane, result)
        elif is_surface(A) or is_surface(B):
            measured = _of_surfaces(A, B, lane, queue, least, searches)
        elif is_round(A) and is_round(B):
            measured = _of_balls(A, B, lane, queue, result)
        else:
            status, measured = _of_cores(A, B, lane, queue, searches)
        if status == NEAREST:
            _record(lane, queue, Ta, measured, result, exact)
        else:
            left.place[late], left.inside[late] = lane, status == OVERLAPPING
            late += 1
    return late


@njit()
def measure_late(late, operands, queued, left, exact):
    """Measure the pairs that the fast search left open; only these pairs need the large work space."""
    a, b, Ta, Tb = pieces_of(operands.a), pieces_of(operands.b), operands.poses_a, operands.poses_b
    queue = queue_of(queued)
    pairs = queue.pairs
    faces, edges = epa_fast.workspace()
    result, work = np.empty(9), workspace(True)
    for m in range(late):
        lane, inside = left.place[m], left.inside[m] == 1
        if not queue.below[lane] < exact.distance[pairs.pair[lane]]:
            continue
        A = placed(a, pairs.piece_a[lane], Ta, pairs.pose_a[lane])
        B = placed(b, pairs.piece_b[lane], Tb, pairs.pose_b[lane])
        shift, n = _column(queue.shift, lane), _column(queue.normal, lane)
        error = position_error(queue.size[lane], UNIT_ROUNDOFF)
        curved = _is_curved(A) or _is_curved(B)
        if inside and not curved:
            settled, depth = _of_overlap(A, B, n, faces, edges, result)
            if settled:
                _record(lane, queue, Ta, depth, result, exact)
                continue
        value, gap = _distance_with_care(A, B, shift, n, error, inside, work, result)
        tolerance = SETTLED_CURVED if curved and value < 0.0 else SETTLED
        ra, rb = radius(A), radius(B)
        missed = _miss(result, value + ra + rb)
        if np.isnan(missed) or (value < 0.0 and missed > WITNESSES * queue.size[lane]):
            tolerance = NEVER  # The witnesses do not confirm the depth, or some of their coordinates are NaN.
        _record(lane, queue, Ta, Measured(value, gap, tolerance, ra, rb), result, exact)


@inline
def _record(lane, queue, Ta, measured, result, exact):
    """Merge the exact distance of two pieces into the result of their pair.

    `result` holds the normal and the witnesses, relative to a's translation and without the rounding radii.
    """
    pairs = queue.pairs
    k, ka = pairs.pair[lane], pairs.pose_a[lane]
    value, gap, tolerance, ra, rb = measured
    # The ellipsoids' lower bound may be nearer to the value than the lower bound of the search. A value far below the
    # ellipsoids' bound is wrong, even if the search's own bounds agree.
    gap = min(gap, abs(value - queue.below[lane]))
    if not gap <= tolerance * queue.size[lane]:
        exact.status[k] = NOT_SETTLED
    if value < exact.distance[k]:
        exact.distance[k] = value
        for c in range(3):
            exact.normal[k, c] = result[c]
            exact.witness_a[k, c] = result[3 + c] + ra * result[c] + Ta[ka, c, 3]
            exact.witness_b[k, c] = result[6 + c] - rb * result[c] + Ta[ka, c, 3]
        if len(exact.pieces) > 0:
            exact.pieces[k, 0], exact.pieces[k, 1] = pairs.piece_a[lane], pairs.piece_b[lane]


@njit()
def _leave(late, work, kept, left):
    """List the pairs left by the fast search for `measure_left`, starting at row `kept`; return the end of the list."""
    queue, which = queue_of(queued_at(work)), late_of(work)
    for m in range(late):
        lane = which.place[m]
        for c in range(len(queue.pairs)):
            left.pieces[kept, c] = queue.pairs[c][lane]
        left.pieces[kept, len(queue.pairs)] = which.inside[m]
        for c in range(3):
            left.values[kept, c], left.values[kept, 5 + c] = queue.shift[c, lane], queue.normal[c, lane]
        left.values[kept, 3], left.values[kept, 4] = queue.size[lane], queue.below[lane]
        kept += 1
    return kept


@njit()
def _room(kept, left):
    """Return the lists in `left`, enlarged if necessary for the pairs of another queue."""
    if kept + QUEUED <= len(left.pieces):
        return left
    more = Left(np.empty((2 * kept + QUEUED, LEFT_INTEGERS), np.int64), np.empty((2 * kept + QUEUED, LEFT_FLOATS)))
    # Here and elsewhere, loops copy single entries. For an assignment of slices, Numba would also generate code that
    # raises a Python error if the shapes differ.
    for n in range(kept):
        for c in range(LEFT_INTEGERS):
            more.pieces[n, c] = left.pieces[n, c]
        for c in range(LEFT_FLOATS):
            more.values[n, c] = left.values[n, c]
    return more


@njit()
def _measure(wanted, count, operands, work, kept, left, bounds, exact):
    """Measure the queued piece pairs and merge them into the results of their pairs; return the pairs left so far."""
    write_bounds(count, operands, queued_at(work))
    queue, lower, upper, estimate = queue_of(queued_at(work)), bounds.lower, bounds.upper, bounds.estimate
    for lane in range(count):
        k, below, above = queue.pairs.pair[lane], queue.below[lane], queue.above[lane]
        lower[k] = min(lower[k], below)
        upper[k] = min(upper[k], above)
        estimate[k] = min(estimate[k], max(below, min(above, queue.estimate[lane])))
    if wanted:
        late = measure_near(count, operands, work, exact)
        if late > 0:
            left = _room(kept, left)
            kept = _leave(late, work, kept, left)
    return kept, left


@njit()
def _measure_many(wanted, k, ia, ka, ib, kb, operands, work, kept, left, bounds, exact):
    """Measure a pair of bodies, at least one with many pieces: only the piece pairs that may be the nearest."""
    a, b = pieces_of(operands.a), pieces_of(operands.b)
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    piece_tree.begin(a, ia, operands.poses_a, ka, b, ib, operands.poses_b, kb, steps, numbers)
    # Start with two pieces that are probably near each other: their distance is a bound that lets the walk skip most
    # pairs.
    i, j = piece_tree.nearest_centers(a, ia, b, ib, numbers, SEED_ROUNDS)
    pair_list.put(queue_of(queued_at(work)).pairs, 0, k, i, j, ka, kb)
    pair_count = 1
    while pair_count > 0:
        kept, left = _measure(wanted, pair_count, operands, work, kept, left, bounds, exact)
        cut = bounds.upper[k]
        if wanted:
            cut = min(cut, exact.distance[k] + SETTLED * numbers[piece_tree.SIZE])
        pair_count = next_pieces(k, ka, kb, ib, operands, max(cut, 0.0), steps, numbers, queued_at(work))
    return kept, left


@inline
def _ask(pieces, piece, poses, row):
    """Prefetch a piece and its pose, which may be anywhere in memory; they arrive while the queue fills."""
    for at in range(0, COLUMNS, LINE):
        prefetch_far(pieces.table, piece * COLUMNS + at)
    prefetch_far(pieces.table, piece * COLUMNS + COLUMNS - 1)
    for at in range(0, POSE_ENTRIES, LINE):
        prefetch_far(poses, row * POSE_ENTRIES + at)


@njit()
def memory_of_distances():
    """Number of bytes of memory for `distance_range`."""
    return _BYTES


@njit()
def distance_range(wanted, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, memory, numbers, vectors, status):
    """Compute the distances of pairs start .. stop.

    Parameters
    ----------
    wanted : bool
        Whether exact distances are requested; if not, exact distances, vectors and the status are not written.
    plan, rows, pack_a, Ta, pack_b, Tb
        The operands are documented in `verdicts`.
    memory : int
        Address of memory with the layout `MEMORY`, to write to; only one thread may use it at a time.
    numbers : ndarray, shape (4, n), or (3, n) without exact distances
        Receives lower bounds, upper bounds, estimates and exact distances.
    vectors : ndarray, shape (3, n, 3)
        Receives the witnesses on a and on b, and the normals, see `Exact`.
    status : ndarray of int8, shape (n,)
        See `Exact`.

    Returns
    -------
    pieces, values : ndarray
        The arrays of a `Left`; `measure_left` has to finish their pairs.
    """
    lower, upper, estimate = numbers[0], numbers[1], numbers[2]
    distance = numbers[3] if wanted else floats_at(memory, (0,))
    bounds = Bounds(lower, upper, estimate)
    exact = Exact(distance, vectors[0], vectors[1], vectors[2], status, integers_at(memory, (0, 2)))
    operands = Operands(pack_a, Ta, pack_b, Tb)
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    # The lists are empty at first. They lie in `memory`, because creating a new array, even an empty one, would
    # allocate memory in every query.
    left = Left(integers_at(memory, (0, LEFT_INTEGERS)), floats_at(memory, (0, LEFT_FLOATS)))
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
            kept, left = _measure(wanted, count, operands, memory, kept, left, bounds, exact)
            count = 0
            kept, left = _measure_many(wanted, k, ia, ka, ib, kb, operands, memory, kept, left, bounds, exact)
            continue
        for i in range(a.piece_start[ia], a.piece_start[ia + 1]):
            for j in range(b.piece_start[ib], b.piece_start[ib + 1]):
                pair_list.put(queue_of(queued_at(memory)).pairs, count, k, i, j, ka, kb)
                count += 1
                if rows.shape[1] > 0:
                    _ask(a, i, Ta, ka)
                    _ask(b, j, Tb, kb)
                if count == QUEUED:
                    kept, left = _measure(wanted, count, operands, memory, kept, left, bounds, exact)
                    count = 0
    kept, left = _measure(wanted, count, operands, memory, kept, left, bounds, exact)
    return left.pieces[:kept], left.values[:kept]  # Python would need a slow call to read a record.


@njit()
def measure_left(pieces, values, pack_a, Ta, pack_b, Tb, numbers, vectors, status):
    """Measure the piece pairs in a `Left` exactly; this function is compiled only when a `Left` has pairs."""
    operands = Operands(pack_a, Ta, pack_b, Tb)
    exact = Exact(numbers[3], vectors[0], vectors[1], vectors[2], status, np.empty((0, 2), np.int64))
    memory = np.empty(_QUEUE_BYTES // 8)
    queue = queue_of(memory.ctypes.data)
    late = Late(np.empty(QUEUED, np.int64), np.empty(QUEUED, np.int64))
    for first in range(0, len(pieces), QUEUED):
        count = min(QUEUED, len(pieces) - first)
        for k in range(count):
            row, kept = pieces[first + k], values[first + k]
            pair_list.put(queue.pairs, k, row[0], row[1], row[2], row[3], row[4])
            late.place[k], late.inside[k] = k, row[5]
            for c in range(3):
                queue.shift[c, k], queue.normal[c, k] = kept[c], kept[5 + c]
            queue.size[k], queue.below[k] = kept[3], kept[4]
        measure_late(count, operands, memory.ctypes.data, late, exact)
    held(memory)
