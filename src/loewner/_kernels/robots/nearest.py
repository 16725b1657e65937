"""Distance of a robot from contact at many configurations: bounds, and the exact distance of the nearest pair.

Configurations are processed sixteen at a time. Balls and boxes bound the distance of every pair of bodies from below,
and the ellipsoids of the seemingly nearest pair bound the least distance from above. Only pairs that may be nearer are
examined: first by their ellipsoids, and then, if exact distances are requested, by the searches.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import BOUNDS
from loewner._kernels.linalg3 import dot, minus
from loewner._kernels.narrow import pair_list
from loewner._kernels.pieces.pack import pieces_of, problem_of
from loewner._kernels.pipeline import distances
from loewner._kernels.pipeline.bounds import QUEUED, Operands, next_pieces, queue_of, write_bounds
from loewner._kernels.pipeline.distances import (
    NOT_SETTLED,
    SETTLED,
    SETTLED_DISTANCE,
    Exact,
    late_of,
    measure_late,
    measure_near,
    queued_at,
)
from loewner._kernels.robots.placement import (
    MOST,
    PAIRS,
    PLACEMENT,
    bounds_at,
    bounds_standing,
    counts_of,
    place_body,
    place_joints,
    placement_of,
    stand,
)
from loewner._kernels.simd.memory import Arena, Place, floats, integers, small_integers
from loewner._kernels.simd.vectors import (
    LANES,
    SINGLE_LANES,
    absolute,
    broadcast,
    load_rounded,
    lowest_bit,
    maximum,
    movemask,
    select,
    sqrt,
    store,
)
from loewner._kernels.tolerances import SINGLE_ROUNDOFF, UP
from loewner._kernels.trees import piece_tree

S = SINGLE_LANES  # Number of configurations in a block.

# Factor that lowers a lower bound in single precision by more than its rounding error.
DOWN = 1.0 - 16.0 * SINGLE_ROUNDOFF  # certified.md B43

MEMORY = Arena(
    distances=distances.MEMORY,
    bodies=integers(QUEUED),  # For each queued piece pair: the pair of bodies to which it belongs.
    seeds=floats(S),  # For each configuration: the pair of bodies with the least bound.
    low=floats(S),
    high=floats(S),
    exact=Arena(
        Exact, distance=floats(S), witness_a=floats(S, 3), witness_b=floats(S, 3), normal=floats(S, 3),
        status=small_integers(S), pieces=integers(S, 2),
    ),
    steps=integers(piece_tree.STEPS),
    numbers=floats(piece_tree.NUMBERS),
    least=floats(S * PAIRS),  # Lower bounds on the distances of the pairs of bodies.
    placement=PLACEMENT,
)  # fmt: skip
_distances_of, _bodies_of, _seeds_of, _low_of, _high_of, _exact_of, _steps_of, _numbers_of, _least_of, _placement_of = (
    MEMORY.accessors("distances bodies seeds low high exact steps numbers least placement")
)
(_placement_at,), _size = MEMORY.addresses("placement"), MEMORY.sizing()


@njit()
def memory_of_nearest(pack, problem_handle, dof):
    """Number of scratch bytes for `nearest_pairs`."""
    return _size(counts_of(pieces_of(pack), problem_of(problem_handle), dof))


@inline
def _least_distances(a, b):
    """Lower bounds on the signed distance of two bodies at sixteen configurations, by their balls and boxes.

    Where squares overflow, the bound is -inf, which always holds: the bodies are far apart, but not infinitely far.
    """
    r, up, down, nought = minus(b.center, a.center), np.float32(UP), np.float32(DOWN), np.float32(0.0)
    balls = sqrt(dot(r, r)) * down - (a.radius + b.radius) * up
    x = absolute(r[0]) * down - (a.half[0] + b.half[0]) * up
    y = absolute(r[1]) * down - (a.half[1] + b.half[1]) * up
    z = absolute(r[2]) * down - (a.half[2] + b.half[2]) * up
    u, v, w = maximum(x, nought), maximum(y, nought), maximum(z, nought)
    boxes = sqrt(u * u + v * v + w * w) * down
    bounds = maximum(balls, select(boxes > nought, boxes, maximum(maximum(x, y), z)))
    return select(bounds < np.float32(np.inf), bounds, np.float32(-np.inf))


@inline
def _may_be_nearer(least, p, upper, live):
    """Bits of the configurations at which the distance of a pair may be below the upper bounds."""
    cut = load_rounded(upper, 0)
    return live & ~movemask(load_rounded(least, p * S) > cut + absolute(cut) * np.float32(1e-6))


@inline
def _pose_row(body, s, moving):
    return body * S + s if body < moving else moving * (MOST - 1) + body


@njit()
def _bound(count, operands, place):
    """Bound the queued piece pairs, and merge the bounds into the results of their configurations.

    Where balls and boxes give better bounds than ellipsoids, their bounds are used. Therefore, a pair that would be
    skipped in another order of pairs, because it is farther than `upper`, does not lower the result here either.
    """
    write_bounds(count, operands, queued_at(_distances_of(place)))
    queue, bodies = queue_of(queued_at(_distances_of(place))), _bodies_of(place)
    least, lower, upper = _least_of(place), _low_of(place), _high_of(place)
    for k in range(count):
        s = queue.pairs.pair[k]
        lower[s] = min(lower[s], max(queue.below[k], least[bodies[k] * S + s]))
        upper[s] = min(upper[s], queue.above[k])


@njit()
def _measure(count, operands, place):
    """Measure the queued piece pairs exactly, and merge the distances into the results of their configurations."""
    work, exact = _distances_of(place), _exact_of(place)
    write_bounds(count, operands, queued_at(work))
    late = measure_near(count, operands, work, exact)
    if late > 0:
        measure_late(late, operands, queued_at(work), late_of(work), exact)


@njit()
def _take(turn, count, operands, place):
    """Measure queued piece pairs: bounds in the first turn, exact distances in the second."""
    if count > 0:
        if turn == 1:
            _measure(count, operands, place)
        else:
            _bound(count, operands, place)


@njit()
def _walk(turn, p, s, body_a, row_a, body_b, row_b, operands, place):
    """Measure the piece pairs of two bodies that may be the nearest at a configuration; one body has many pieces."""
    pieces = pieces_of(operands.a)
    queued, steps, numbers = queued_at(_distances_of(place)), _steps_of(place), _numbers_of(place)
    upper, distance = _high_of(place), _exact_of(place).distance
    poses = operands.poses_a
    piece_tree.begin(pieces, body_a, poses, row_a, pieces, body_b, poses, row_b, steps, numbers)
    while True:
        cut = upper[s] + SETTLED * numbers[piece_tree.SIZE]
        if turn == 1:
            cut = min(cut, distance[s] + SETTLED * numbers[piece_tree.SIZE])
        count = next_pieces(s, row_a, row_b, body_b, operands, max(cut, 0.0), steps, numbers, queued)
        if count == 0:
            return
        _bodies_of(place)[:count] = p
        _take(turn, count, operands, place)


@njit()
def nearest_pairs(wanted, start, stop, Q, pack, problem_handle, memory, numbers, vectors, pieces_out, status):
    """Bound the least distance of all pairs at the configurations start .. stop, and measure it exactly on request.

    Parameters
    ----------
    wanted : bool
        Whether the exact distance is requested; if not, it and the last three arrays are not written.
    Q : ndarray, shape (N, dof)
    pack, problem_handle : int
        Documented in `configurations.check_configurations`.
    memory : int
        Address of `memory_of_nearest()` bytes to write to; only one thread may use them at a time.
    numbers : ndarray, shape (3, N), or (2, N) without exact distances
        Receives lower bounds, upper bounds and exact distances.
    vectors : ndarray, shape (3, N, 3)
        Receives the witnesses on a and on b, and the normals, see `distances.Exact`.
    pieces_out : ndarray of int64, shape (N, 2)
        Receives the rows of the nearest pieces.
    status : ndarray of int8, shape (N,)
        Receives SETTLED_DISTANCE or NOT_SETTLED.
    """
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    counts = counts_of(pieces, problem, Q.shape[1])
    moving, total = counts.moving, len(problem.pairs)
    piece_start, roots = pieces.piece_start, pieces.roots
    place = Place(memory, counts)
    least, to, at_placement = _least_of(place), _placement_of(place), _placement_at(place)
    operands = Operands(pack, to.poses, pack, to.poses)
    queued, bodies = queue_of(queued_at(_distances_of(memory))).pairs, _bodies_of(memory)
    seeds, low, high, exact = _seeds_of(memory), _low_of(memory), _high_of(memory), _exact_of(memory)
    stand(problem, counts, to)
    for first in range(start, stop, S):
        last = min(first + S, stop) - 1
        here = last + 1 - first
        _place(pack, problem_handle, at_placement, counts, Q, first, last)
        _bound_pairs(problem, to.bounds, moving, least, seeds)
        for s in range(S):
            low[s] = high[s] = exact.distance[s] = np.inf
            exact.status[s], exact.pieces[s, 0] = SETTLED_DISTANCE, -1
        for s in range(here):
            p = np.int64(seeds[s])
            one, other = problem.pairs[p, 0], problem.pairs[p, 1]
            row_a, row_b = _pose_row(one, s, moving), _pose_row(other, s, moving)
            pair_list.put(queued, s, s, piece_start[one], piece_start[other], row_a, row_b)
            bodies[s] = p
        _bound(here, operands, place)
        live = (1 << here) - 1
        for turn in range(2 if wanted else 1):
            count = 0
            for p in range(total):
                one, other = problem.pairs[p, 0], problem.pairs[p, 1]
                near = _may_be_nearer(least, p, high, live)
                while near != 0:
                    s = lowest_bit(near)
                    near &= near - 1
                    row_a, row_b = _pose_row(one, s, moving), _pose_row(other, s, moving)
                    if roots[one] >= 0 or roots[other] >= 0:
                        _take(turn, count, operands, place)
                        count = 0
                        _walk(turn, p, s, one, row_a, other, row_b, operands, place)
                        continue
                    for i in range(piece_start[one], piece_start[one + 1]):
                        for j in range(piece_start[other], piece_start[other + 1]):
                            pair_list.put(queued, count, s, i, j, row_a, row_b)
                            bodies[count] = p
                            count += 1
                            if count == QUEUED:
                                _take(turn, count, operands, place)
                                count = 0
            _take(turn, count, operands, place)
        for s in range(here):
            k = first + s
            numbers[0, k], numbers[1, k] = low[s], high[s]
            if wanted:
                numbers[2, k] = exact.distance[s]
                status[k] = exact.status[s] if exact.pieces[s, 0] >= 0 else NOT_SETTLED
                for c in range(2):
                    pieces_out[k, c] = exact.pieces[s, c]
                for c in range(3):
                    vectors[0, k, c], vectors[1, k, c] = exact.witness_a[s, c], exact.witness_b[s, c]
                    vectors[2, k, c] = exact.normal[s, c]


@njit()
def near_pairs(within, start, stop, Q, pack, problem_handle, memory, listed, count):
    """List the pairs of bodies that, by balls and boxes, may be within a distance at configurations start .. stop.

    Parameters
    ----------
    within : float
    listed : ndarray of int64, shape (room, 2)
        Receives the rows of a configuration and a pair, starting at row `count`; only the rows that fit are listed.
    The other parameters are documented in `nearest_pairs`.

    Returns
    -------
    count : int
        Number of rows found so far; only the rows that fit are listed.
    """
    problem = problem_of(problem_handle)
    counts = counts_of(pieces_of(pack), problem, Q.shape[1])
    place = Place(memory, counts)
    least, seeds, to, at_placement = _least_of(place), _seeds_of(memory), _placement_of(place), _placement_at(place)
    stand(problem, counts, to)
    for first in range(start, stop, S):
        last = min(first + S, stop) - 1
        _place(pack, problem_handle, at_placement, counts, Q, first, last)
        _bound_pairs(problem, to.bounds, counts.moving, least, seeds)
        for p in range(counts.pairs):
            for s in range(last + 1 - first):
                if not least[p * S + s] > within:
                    if count < len(listed):
                        listed[count, 0], listed[count, 1] = first + s, p
                    count += 1
    return count


@inline
def _place(pack, problem_handle, at_placement, counts, Q, first, last):
    """Place the moving bodies at the configurations first .. last, at most sixteen."""
    problem, to = problem_of(problem_handle), placement_of(Place(at_placement, counts))
    for lane in range(0, last + 1 - first, LANES):
        place_joints(problem, Q, first + lane, last, to)
        for body in range(counts.moving):
            place_body(pack, problem_handle, at_placement, counts, body, S, lane)


@inline
def _bound_pairs(problem, bounds, moving, least, seeds):
    """Write lower bounds for all pairs, and the pair with the least bound, at sixteen configurations."""
    best, which = broadcast(np.float32(np.inf)), broadcast(np.float32(0.0))
    for p in range(len(problem.pairs)):
        one, other = problem.pairs[p, 0], problem.pairs[p, 1]
        a = bounds_at(bounds, one * BOUNDS * S, S)
        if other < moving:
            lower = _least_distances(a, bounds_at(bounds, other * BOUNDS * S, S))
        else:
            lower = _least_distances(a, bounds_standing(problem.standing, other - moving))
        store(least, p * S, lower)
        nearer = lower < best
        best, which = select(nearer, lower, best), select(nearer, broadcast(np.float32(p)), which)
    store(seeds, 0, which)
