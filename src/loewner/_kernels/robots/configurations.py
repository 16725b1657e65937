"""Decide whether configurations of a robot are free; a block passes through all pairs of bodies side by side.

The steps for a block, cheapest first:

place
    Forward kinematics places the links. The ellipsoids of each moving piece are computed in world coordinates, so that
    no pair has to rotate them again (`placement`).
cull
    Bounding spheres and boxes of each pair of bodies are compared, sixteen configurations at a time.
certify
    `narrow.certificate` tests the ellipsoids of the remaining piece pairs, across configurations.
search
    Exact searches settle the pairs that are still open, one by one.

A configuration that was found colliding is skipped from then on, and a motion ends at its first collision. The caller
chooses the order of the pairs: the pairs that collide most often come first.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    BY_INNER,
    BY_OUTER,
    BY_SPHERE,
    CERTIFY,
    COLLIDING,
    EXACT,
    FREE,
    NO_LIMIT,
    OPEN,
    UNSURE,
)
from loewner._kernels.columns import BOUNDS
from loewner._kernels.narrow import certificate, exact, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.exact import exact_piece_pair
from loewner._kernels.narrow.gjk_robust import rounding_error
from loewner._kernels.narrow.pair_list import fill
from loewner._kernels.narrow.surface_parts import has_parts, parts_tier
from loewner._kernels.pieces.pack import pieces_of, placed, problem_of, shift_between
from loewner._kernels.pieces.shapes import reach
from loewner._kernels.robots.placement import (
    DOF,
    MOST,
    MOVING,
    PLACEMENT,
    bounds_at,
    bounds_standing,
    counts_of,
    near,
    near_once,
    place_body,
    place_body_once,
    place_joints,
    stand,
)
from loewner._kernels.simd.memory import Arena, floats, integers, raw, small_integers
from loewner._kernels.simd.scalars import word_at
from loewner._kernels.simd.vectors import LANES, SINGLE_LANES, lowest_bit
from loewner._kernels.tolerances import UP
from loewner._kernels.trees import piece_tree

WAITING = 512  # Maximum number of piece pairs that wait for the exact search.

GROUPS = MOST // SINGLE_LANES  # Number of groups of sixteen configurations in a block.

# Maximum number of pairs of bodies that are culled together, and number of pairs with which a small batch starts: these
# first pairs usually collide, and the other pairs are then skipped.
TOGETHER, FIRST = 64, 4


MEMORY = Arena(
    # The field `pair` holds MOST p + s for pair p at configuration s; the other fields hold rows of the placement.
    listed=pair_list.arena(BLOCK),
    pieces_a=integers(BLOCK),  # Pieces of the listed pairs, as rows of the packed pieces.
    pieces_b=integers(BLOCK),
    found_a=integers(BLOCK),  # Pieces found in trees.
    found_b=integers(BLOCK),
    tier=small_integers(BLOCK),  # Tiers of the listed pairs, written by the certificate.
    normals=floats(3 * BLOCK),  # Contact normals of the listed pairs, written by the certificate.
    # Piece pairs that wait for the exact search; the pieces are given by their rows in the packed pieces.
    waiting=pair_list.arena(WAITING),
    directions=floats(WAITING, 3),  # Contact normals of the waiting pairs.
    live=integers(GROUPS),  # For each group, a mask of the configurations that may still be free.
    verdicts=small_integers(MOST),  # Verdicts of the configurations.
    tiers=small_integers(MOST),  # Tiers by which the configurations were settled.
    steps=integers(piece_tree.STEPS),
    numbers=floats(piece_tree.NUMBERS),
    exact=raw(exact.SIZE),
    # Pairs of bodies that the bounds leave open: MOST p + s for pair p and the first configuration s of a group.
    codes=integers(TOGETHER * GROUPS),
    masks=integers(TOGETHER * GROUPS),  # Masks of the configurations in the group for which the pair is open.
    way=floats(MOST, DOF),  # Configurations of a motion.
    placed=integers(MOVING),  # For each moving body, whether it has been placed.
    placement=PLACEMENT,
)
_listed_of, _pieces_a_of, _pieces_b_of, _found_a_of, _found_b_of, _tier_of, _normals_of, _waiting_of = MEMORY.accessors(
    "listed pieces_a pieces_b found_a found_b tier normals waiting"
)
_directions_of, _live_of, _verdicts_of, _tiers_of, _steps_of, _numbers_of, _exact_of = MEMORY.accessors(
    "directions live verdicts tiers steps numbers exact"
)
_codes_of, _masks_of, _way_of, _placed_of, _placement_of = MEMORY.accessors("codes masks way placed placement")
(_placement_at,), _size = MEMORY.addresses("placement"), MEMORY.sizing()


class Query(NamedTuple):
    """A query, and its memory.

    Attributes
    ----------
    mode : CERTIFY or EXACT
    first_hit : 1 if the first collision ends the query, otherwise 0
    pack, problem : handles of the pieces, see `pieces.pack`, and of the problem, see `pack.problem_of`
    counts : numbers of bodies, pieces, pairs and links
    hits : counts of the collisions found, by pair
    work : address of `MEMORY`
    """

    mode: Any
    first_hit: Any
    pack: Any
    problem: Any
    counts: Any
    hits: Any
    work: Any


@inline
def _pair(code):
    """Return the pair of bodies of an entry in a list."""
    return code // MOST


@inline
def _configuration(code):
    """Return the configuration of an entry in a list."""
    return code % MOST


@inline
def _hit(query, s, pair, tier):
    """Mark a configuration as colliding, so that it is skipped from now on."""
    live = _live_of(query.work)
    live[s // SINGLE_LANES] &= ~(1 << (s % SINGLE_LANES))
    if query.first_hit != 0:
        live[:] = 0
    _verdicts_of(query.work)[s] = COLLIDING
    _tiers_of(query.work)[s] = tier
    query.hits[pair] += 1


@inline
def _mark_open(query, s):
    """Mark a configuration as having an unsettled pair, unless the configuration collides."""
    _verdicts_of(query.work)[s] = AMBIGUOUS
    _tiers_of(query.work)[s] = OPEN


@inline
def _ended(query):
    """Return whether no configuration is left to check."""
    live, rest = _live_of(query.work), 0
    for group in range(GROUPS):
        rest |= live[group]
    return rest == 0


@njit()
def _improve(query, held):
    """Certify the waiting pairs again, at the best s in double precision, for margin 0."""
    work = query.work
    pieces = pieces_of(query.pack)
    hot, poses = pieces.hot, _placement_of(query).poses
    listed, waiting, tier, normals = _listed_of(work), _waiting_of(work), _tier_of(work), _normals_of(work)
    verdicts, tiers = _verdicts_of(work), _tiers_of(work)
    for first in range(0, held, BLOCK):
        count = min(BLOCK, held - first)
        for lane in range(count):
            pair_list.copy(listed, lane, waiting, first + lane)
        fill(listed, count)
        if not certificate.certify_best(count, 0.0, hot, poses, True, hot, poses, True, listed, tier, normals):
            tier[:count] = OPEN
        for lane in range(count):
            code = waiting.pair[first + lane]
            s = _configuration(code)
            if verdicts[s] == COLLIDING:
                continue
            if tier[lane] == OPEN and has_parts(pieces):
                i, j = waiting.piece_a[first + lane], waiting.piece_b[first + lane]
                tier[lane] = parts_tier(
                    pieces, i, poses, waiting.pose_a[first + lane], pieces, j, poses, waiting.pose_b[first + lane], 0.0
                )
            if tier[lane] == BY_INNER:
                _hit(query, s, _pair(code), BY_INNER)
            elif tier[lane] == OPEN:
                _mark_open(query, s)
            elif tiers[s] < BY_OUTER:
                tiers[s] = BY_OUTER


@njit()
def _search(query, held):
    """Settle the waiting pairs by the exact searches."""
    work, pieces, margins = query.work, pieces_of(query.pack), problem_of(query.problem).margins
    poses, waiting, N = _placement_of(query).poses, _waiting_of(work), _directions_of(work)
    verdicts, tiers = _verdicts_of(work), _tiers_of(work)
    for n in range(held):
        code = waiting.pair[n]
        s, p = _configuration(code), _pair(code)
        if verdicts[s] == COLLIDING:
            continue
        A = placed(pieces, waiting.piece_a[n], poses, waiting.pose_a[n])
        B = placed(pieces, waiting.piece_b[n], poses, waiting.pose_b[n])
        margin, shift = margins[p], shift_between(A, B)
        widest = max(abs(shift[0]), abs(shift[1]), abs(shift[2]))
        if widest - rounding_error(A, B, shift) > reach(A) + reach(B) + margin:
            # The pieces are apart. The search is skipped, because its squares may exceed the range of single precision.
            tiers[s] = max(tiers[s], BY_OUTER)
            continue
        verdict, tier, _ = exact_piece_pair(
            query.pack, waiting.piece_a[n], poses, waiting.pose_a[n], query.pack, waiting.piece_b[n], poses,
            waiting.pose_b[n], margin, (N[n, 0], N[n, 1], N[n, 2]), NO_LIMIT, _exact_of(work),
        )  # fmt: skip
        if verdict == COLLIDING:
            _hit(query, s, p, tier)
            if query.first_hit != 0:
                return
        elif verdict == AMBIGUOUS:
            _mark_open(query, s)
        elif tiers[s] < tier:
            tiers[s] = tier


@apart
def _settle_waiting(query, held):
    """Settle all waiting pairs."""
    if query.mode == EXACT:
        _search(query, held)
    else:
        _improve(query, held)
    return 0


@njit()
def _certify(query, keep, count, held):
    """Certify listed piece pairs, append the open ones to the waiting pairs, and return the number of waiting pairs."""
    work, pieces = query.work, pieces_of(query.pack)
    placement = _placement_of(query)
    poses, rows = placement.poses, placement.ellipsoids
    listed, tier, normals = _listed_of(work), _tier_of(work), _normals_of(work)
    pieces_a, pieces_b, waiting, directions = (
        _pieces_a_of(work), _pieces_b_of(work), _waiting_of(work), _directions_of(work),
    )  # fmt: skip
    verdicts, tiers = _verdicts_of(work), _tiers_of(work)
    fill(listed, count)
    done = False
    if keep == 0.0 and len(pieces.single) > 0:
        done = certificate.single_certify(
            count, False, rows, poses, False, rows, poses, False, listed, listed, tier, normals
        )
    if not done:
        for lane in range(count):
            listed.piece_a[lane], listed.piece_b[lane] = pieces_a[lane], pieces_b[lane]
        fill(listed, count)
        if not certificate.certify_best(
            count, keep, pieces.hot, poses, True, pieces.hot, poses, True, listed, tier, normals
        ):
            tier[:count] = OPEN  # An overflow made the pose of a link non-rigid, so no pair in the list is proven.
    refined = query.mode == CERTIFY and has_parts(pieces)
    for lane in range(count):
        code = listed.pair[lane]
        s = _configuration(code)
        if verdicts[s] == COLLIDING:
            continue
        if refined and tier[lane] == OPEN:
            tier[lane] = parts_tier(
                pieces, pieces_a[lane], poses, listed.pose_a[lane], pieces, pieces_b[lane], poses, listed.pose_b[lane],
                problem_of(query.problem).margins[_pair(code)],
            )  # fmt: skip
        if tier[lane] == BY_INNER:
            _hit(query, s, _pair(code), BY_INNER)
        elif tier[lane] == BY_OUTER:
            tiers[s] = max(tiers[s], BY_OUTER)
        elif tier[lane] != BY_SPHERE and (query.mode == EXACT or tier[lane] == UNSURE):
            pair_list.put(
                waiting, held, code, pieces_a[lane], pieces_b[lane], listed.pose_a[lane],
                listed.pose_b[lane],
            )  # fmt: skip
            for row in range(3):
                directions[held, row] = normals[row * BLOCK + lane]
            held += 1
        elif tier[lane] == OPEN:
            _mark_open(query, s)
    if _ended(query):
        return 0
    # Waiting pairs are settled last, because settling them overwrites `listed`.
    if held > WAITING - BLOCK:
        held = _settle_waiting(query, held)
    return held


@inline
def _list(work, count, code, i, j, S, moving_pieces, pose_a, pose_b):
    """List piece i, which moves, and piece j."""
    s = _configuration(code)
    row_b = j * S + s if j < moving_pieces else moving_pieces * (MOST - 1) + j
    pair_list.put(_listed_of(work), count, code, i * S + s, row_b, pose_a, pose_b)
    _pieces_a_of(work)[count] = i
    _pieces_b_of(work)[count] = j


@inline
def _place_few(query, body, S, alone):
    """Place a moving body at one configuration or at eight, unless it is already placed."""
    placed, address = _placed_of(query), _placement_at(query)
    if placed[body] == 0:
        placed[body] = 1
        if alone:
            place_body_once(query.pack, query.problem, address, query.counts, body, S)
        else:
            place_body(query.pack, query.problem, address, query.counts, body, S, 0)


@njit()
def _place_next(query, start, stop, S, alone):
    """Place the bodies of the pairs start .. stop of the order if `start` is 0, otherwise all bodies that are left."""
    problem, moving = problem_of(query.problem), query.counts.moving
    if start > 0:
        for body in range(moving):
            _place_few(query, body, S, alone)
        return
    for number in range(start, stop):
        for side in range(2):
            body = problem.pairs[problem.order[number], side]
            if body < moving:
                _place_few(query, body, S, alone)


@inline
def _cull(query, start, stop, groups, S):
    """List the pairs among start .. stop of the order that bounds leave open, without branches; return their number."""
    problem, counts = problem_of(query.problem), query.counts
    bounds, live = _placement_of(query).bounds, _live_of(query.work)
    codes, masks = _codes_of(query), _masks_of(query)
    noted = np.uint64(0)
    for number in range(start, stop):
        p = problem.order[number]
        one, other = problem.pairs[p, 0], problem.pairs[p, 1]
        up = np.float32(problem.margins[p] * UP)
        for group in range(groups):
            at = group * SINGLE_LANES
            here = bounds_at(bounds, one * BOUNDS * S + at, S)
            if other < counts.moving:
                meet = near(here, bounds_at(bounds, other * BOUNDS * S + at, S), up, live[group])
            else:
                meet = near(here, bounds_standing(problem.standing, other - counts.moving), up, live[group])
            codes[noted] = p * MOST + at
            masks[noted] = meet
            noted += np.uint64(meet != 0)
    return np.int64(noted)


@inline
def _cull_once(query, start, stop, S):
    """Do the work of `_cull` at the first configuration only."""
    problem, moving = problem_of(query.problem), query.counts.moving
    bounds, standing, codes, masks = _placement_of(query).bounds, problem.standing, _codes_of(query), _masks_of(query)
    order, pairs, margins = problem.order.ctypes.data, problem.pairs.ctypes.data, problem.margins
    noted = np.uint64(0)
    for number in range(start, stop):
        p = word_at(order, number)
        one, other = word_at(pairs, 2 * p), word_at(pairs, 2 * p + 1)
        up = np.float32(margins[np.uint64(p)] * UP)
        if other < moving:
            meet = near_once(bounds, one, S, bounds, other, S, up)
        else:
            meet = near_once(bounds, one, S, standing, other - moving, 1, up)
        codes[noted] = p * MOST
        masks[noted] = 1
        noted += np.uint64(meet)
    return np.int64(noted)


@njit()
def _settle_block(query, Q, first, last, S):
    """Settle the configurations in the rows first .. last of Q, at most S of them, into `verdicts` and `tiers`.

    Both entry points use this function, so that it is compiled only once.
    """
    work, counts, pieces, problem = query.work, query.counts, pieces_of(query.pack), problem_of(query.problem)
    placement = _placement_of(query)
    piece_start, roots = pieces.piece_start, pieces.roots
    moving, moving_pieces, live = counts.moving, counts.moving_pieces, _live_of(work)
    codes, masks = _codes_of(work), _masks_of(work)
    verdicts = _verdicts_of(work)
    # If the block has few configurations, first place the bodies of the first pairs, and settle these pairs.
    few, alone = last - first < LANES, last == first
    if few:
        place_joints(problem, Q, first, last, placement)
        _placed_of(query)[:] = 0
    else:
        for at in range(0, last + 1 - first, LANES):
            place_joints(problem, Q, first + at, last, placement)
            for body in range(moving):
                place_body(query.pack, query.problem, _placement_at(query), counts, body, S, at)
    for group in range(GROUPS):
        rest = max(min(last + 1 - first - group * SINGLE_LANES, SINGLE_LANES), 0)
        live[group] = (1 << rest) - 1
    verdicts[:] = FREE
    _tiers_of(work)[:] = BY_SPHERE
    groups = (last - first) // SINGLE_LANES + 1
    count, held, keep = 0, 0, 0.0
    start, together, total = 0, FIRST if few else TOGETHER, len(problem.order)
    while start < total:
        stop = min(start + together, total)
        if few and start <= FIRST:
            _place_next(query, start, stop, S, alone)
        for n in range(_cull_once(query, start, stop, S) if alone else _cull(query, start, stop, groups, S)):
            p = _pair(codes[n])
            one, other = problem.pairs[p, 0], problem.pairs[p, 1]
            if problem.margins[p] != keep:
                # All pairs in a list must have the same margin.
                if count > 0:
                    held = _certify(query, keep, count, held)
                    count = 0
                keep = problem.margins[p]
            listed_whole = roots[one] < 0 and roots[other] < 0
            at = _configuration(codes[n])
            meet = masks[n] & live[at // SINGLE_LANES]
            while meet != 0:
                s = at + lowest_bit(meet)
                meet &= meet - 1
                pose_a = one * S + s
                pose_b = other * S + s if other < moving else moving * (MOST - 1) + other
                code = p * MOST + s
                if listed_whole:
                    for i in range(piece_start[one], piece_start[one + 1]):
                        for j in range(piece_start[other], piece_start[other + 1]):
                            _list(work, count, code, i, j, S, moving_pieces, pose_a, pose_b)
                            count += 1
                            if count == BLOCK:
                                held = _certify(query, keep, count, held)
                                count = 0
                else:
                    count, held = _walk(query, keep, code, one, other, pose_a, pose_b, S, count, held)
        if few and count > 0:
            held = _certify(query, keep, count, held)
            count = 0
            if held > 0:
                held = _settle_waiting(query, held)
        if _ended(query):
            return
        start, together = stop, min(2 * together, TOGETHER)
    if count > 0:
        held = _certify(query, keep, count, held)
    if held > 0:
        _settle_waiting(query, held)


@njit()
def _walk(query, keep, code, one, other, pose_a, pose_b, S, count, held):
    """List the piece pairs that the trees of two bodies leave open at a configuration; return `count` and `held`."""
    work, counts, pieces = query.work, query.counts, pieces_of(query.pack)
    poses, verdicts, s = _placement_of(query).poses, _verdicts_of(work), _configuration(code)
    steps, numbers, found_a, found_b = _steps_of(work), _numbers_of(work), _found_a_of(work), _found_b_of(work)
    piece_tree.begin(pieces, one, poses, pose_a, pieces, other, poses, pose_b, steps, numbers)
    while verdicts[s] != COLLIDING:
        pair_count = piece_tree.more(pieces, pieces, other, keep, steps, numbers, found_a[: BLOCK - count], found_b)
        if pair_count == 0:
            break
        for c in range(pair_count):
            _list(work, count + c, code, found_a[c], found_b[c], S, counts.moving_pieces, pose_a, pose_b)
        count += pair_count
        if count == BLOCK:
            held = _certify(query, keep, count, held)
            count = 0
    return count, held


@njit()
def memory_size(pack, problem_handle, dof):
    """Number of scratch bytes for `check_configurations` and `check_motion`."""
    return _size(counts_of(pieces_of(pack), problem_of(problem_handle), dof))


@njit()
def check_configurations(mode, start, stop, Q, pack, problem_handle, out, tiers_out, hits, memory):
    """Settle the configurations start .. stop.

    Parameters
    ----------
    mode : int
        CERTIFY or EXACT.
    Q : ndarray, shape (N, dof)
    pack : int
        Handle of the packed bodies, see `pieces.pack`: moving bodies, each in the frame of its link, then static
        bodies.
    problem_handle : int
        Handle of the problem, see `pack.problem_of`.
    out : ndarray of int8, shape (N,)
        Receives verdicts; AMBIGUOUS in mode EXACT means that the search did not settle a configuration.
    tiers_out : ndarray of int8, shape (N,)
        Receives the tier that settled each configuration. For a free configuration, it is the costliest tier that any
        pair needed; otherwise, it is the tier that found the collision.
    hits : ndarray of int64, shape (pairs,)
        The number of collisions found is added here, by pair.
    memory : int
        Address of `memory_size()` scratch bytes; only one thread may use them at a time.
    """
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    counts = counts_of(pieces, problem, Q.shape[1])
    query = Query(mode, 0, pack, problem_handle, counts, hits, memory)
    verdicts, tiers = _verdicts_of(memory), _tiers_of(memory)
    S = SINGLE_LANES if stop - start <= SINGLE_LANES else MOST
    stand(problem, counts, _placement_of(query))
    for first in range(start, stop, S):
        last = min(first + S, stop) - 1
        _settle_block(query, Q, first, last, S)
        for s in range(last + 1 - first):
            out[first + s] = verdicts[s]
            tiers_out[first + s] = tiers[s]


@njit()
def check_motion(start, end, fractions, pack, problem_handle, out, hits, memory):
    """Settle configurations on the straight motion from `start` to `end` exactly, until the first collision.

    Parameters
    ----------
    start, end : ndarray, shape (dof,)
    fractions : ndarray, shape (N,)
        Fractions of the motion at which its configurations lie: 0 is the start, 1 the end.
    pack, problem_handle, hits, memory
        Documented in `check_configurations`.
    out : ndarray of int8, shape (N,)
        If there is no collision, receives FREE, or AMBIGUOUS where the search did not settle a configuration.

    Returns
    -------
    verdict : int
        COLLIDING if a configuration collides, FREE if all are free, AMBIGUOUS if no collision was found but some are
        unsettled.
    settled : int
        Number of configurations checked.
    """
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    dof, total = len(start), len(fractions)
    counts = counts_of(pieces, problem, dof)
    query = Query(EXACT, 1, pack, problem_handle, counts, hits, memory)
    verdicts, way = _verdicts_of(memory), _way_of(query)
    stand(problem, counts, _placement_of(query))
    # A colliding motion usually collides at one of its first configurations.
    verdict, first, some = FREE, 0, LANES
    while first < total:
        last = min(first + some, total) - 1
        for k in range(first, last + 1):
            for c in range(dof):
                straight = start[c] + fractions[k] * (end[c] - start[c])
                way[k - first, c] = straight if fractions[k] != 1.0 else end[c]
        S = SINGLE_LANES if last - first < SINGLE_LANES else MOST
        _settle_block(query, way, 0, last - first, S)
        for s in range(last + 1 - first):
            if verdicts[s] == COLLIDING:
                return COLLIDING, last + 1
            if verdicts[s] == AMBIGUOUS:
                verdict = AMBIGUOUS
            out[first + s] = verdicts[s]
        first, some = last + 1, MOST
    return verdict, total
