"""Is a robot at a configuration free: blocks of configurations, side by side through all pairs of bodies.

The work of a block, cheapest first:

place
    the links by forward kinematics; of each moving piece the ellipsoids in world coordinates, so that no pair has to
    rotate them again (`placement`).
cull
    bounding spheres and boxes of each pair of bodies, sixteen configurations at a time.
certify
    the ellipsoids of the piece pairs that are left, by `narrow.certificate`, whatever configurations they belong to.
search
    what is then open, exactly, pair by pair.

A configuration that was found colliding takes no further part, and a motion ends at its first collision. Pairs are
taken in an order that the caller chooses: those that hit most often first.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    BY_INNER,
    BY_OUTER,
    BY_SPHERE,
    COLLIDING,
    EXACT,
    FREE,
    OPEN,
)
from loewner._kernels.narrow import certificate, exact, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.exact import exact_piece_pair
from loewner._kernels.narrow.gjk_robust import rounding_error
from loewner._kernels.narrow.pair_list import fill, pair_list_at
from loewner._kernels.pieces.pack import pieces_of, placed, problem_of, shift_between
from loewner._kernels.pieces.shapes import reach
from loewner._kernels.robots.placement import (
    BOUNDS,
    MOST,
    UP,
    Counts,
    bounds_at,
    bounds_standing,
    near,
    place,
    placement_at,
    placement_size,
    stand,
)
from loewner._kernels.simd.memory import bytes_at, floats_at, integers_at, lines
from loewner._kernels.simd.vectors import SINGLE_LANES, lowest_bit
from loewner._kernels.trees import piece_tree

WAITING = 512  # piece pairs that may wait for the exact search

GROUPS = MOST // SINGLE_LANES  # of sixteen configurations, in a block


class Block(NamedTuple):
    """What the work of a block writes to.

    Attributes
    ----------
    placement : Placement
    listed : PairList
        Piece pairs for the certificate: `pair` is the number of the pair of bodies times S plus the configuration;
        pieces and poses are rows of the placement.
    pieces_a, pieces_b : ndarray of int64, shape (BLOCK,)
        The same piece pairs by their rows in the packed pieces.
    tier : ndarray of int8, shape (BLOCK,)
    normals : ndarray, shape (3 * BLOCK,)
        What the certificate says of each.
    waiting : PairList
        Piece pairs that wait for the exact search, by their rows in the packed pieces.
    directions : ndarray, shape (WAITING, 3)
        The normals of these.
    live : ndarray of int64, shape (GROUPS,)
        Configurations that may still be free, as bits.
    verdicts, tiers : ndarray of int8, shape (MOST,)
        Of the configurations.
    way : ndarray, shape (MOST, dof)
        Configurations of a motion.
    steps, numbers, found_a, found_b : ndarray
        For the trees of bodies of many pieces.
    exact : exact.Workspace
    """

    placement: Any
    listed: Any
    pieces_a: Any
    pieces_b: Any
    tier: Any
    normals: Any
    waiting: Any
    directions: Any
    live: Any
    verdicts: Any
    tiers: Any
    way: Any
    steps: Any
    numbers: Any
    found_a: Any
    found_b: Any
    exact: Any


_LIST, _NUMBERS, _WAITING = pair_list.size(BLOCK), 8 * BLOCK, pair_list.size(WAITING)
_TIER = _LIST + 4 * _NUMBERS
_NORMALS = _TIER + BLOCK
_AT_WAITING = _NORMALS + 3 * _NUMBERS
_DIRECTIONS = _AT_WAITING + _WAITING
_LIVE = _DIRECTIONS + 3 * 8 * WAITING
_VERDICTS = _LIVE + 64
_STEPS = _VERDICTS + 2 * MOST
_TREE = _STEPS + lines.py_func(8 * piece_tree.STEPS)
_EXACT = _TREE + lines.py_func(8 * piece_tree.NUMBERS)
_FIXED = _EXACT + exact.SIZE


@inline
def size(counts):
    """Bytes of a block."""
    return _FIXED + lines(8 * MOST * counts.dof) + placement_size(counts)


@inline
def _block_at(address, counts):
    """The block at an address."""
    way = address + _FIXED
    return Block(
        placement_at(way + lines(8 * MOST * counts.dof), counts),
        pair_list_at(address, BLOCK),
        integers_at(address + _LIST, (BLOCK,)),
        integers_at(address + _LIST + _NUMBERS, (BLOCK,)),
        bytes_at(address + _TIER, (BLOCK,)),
        floats_at(address + _NORMALS, (3 * BLOCK,)),
        pair_list_at(address + _AT_WAITING, WAITING),
        floats_at(address + _DIRECTIONS, (WAITING, 3)),
        integers_at(address + _LIVE, (GROUPS,)),
        bytes_at(address + _VERDICTS, (MOST,)),
        bytes_at(address + _VERDICTS + MOST, (MOST,)),
        floats_at(way, (MOST, counts.dof)),
        integers_at(address + _STEPS, (piece_tree.STEPS,)),
        floats_at(address + _TREE, (piece_tree.NUMBERS,)),
        integers_at(address + _LIST + 2 * _NUMBERS, (BLOCK,)),
        integers_at(address + _LIST + 3 * _NUMBERS, (BLOCK,)),
        exact.workspace_at(address + _EXACT),
    )


class Query(NamedTuple):
    """What is asked of a block: CERTIFY or EXACT; whether the first collision ends it; the pieces, what to check, and
    where to count the collisions found, by pair."""

    mode: Any
    first_hit: Any
    pieces: Any
    problem: Any
    hits: Any


@inline
def _hit(query, s, pair, tier, block):
    """A configuration that collides takes no further part."""
    block.live[s // SINGLE_LANES] &= ~(np.int64(1) << (s % SINGLE_LANES))
    if query.first_hit:
        block.live[:] = 0
    block.verdicts[s] = COLLIDING
    block.tiers[s] = tier
    query.hits[pair] += 1


@inline
def _leave(s, block):
    block.verdicts[s] = AMBIGUOUS
    block.tiers[s] = OPEN


@inline
def _ended(query, block):
    """Whether no configuration of a motion needs to be looked at any more."""
    return query.first_hit and not block.live.any()


@njit()
def _improve(query, S, held, block):
    """Certify the pairs that wait once more, at the best s in double precision, margin 0."""
    hot, poses, waiting = query.pieces.hot, block.placement.poses, block.waiting
    for first in range(0, held, BLOCK):
        count = min(BLOCK, held - first)
        for lane in range(count):
            pair_list.copy(block.listed, lane, waiting, first + lane)
        fill(block.listed, count)
        if not certificate.certify_best(
            count, 0.0, hot, poses, True, hot, poses, True, block.listed, block.tier, block.normals
        ):
            block.tier[:count] = OPEN
        for lane in range(count):
            code = waiting.pair[first + lane]
            s = code % S
            if block.verdicts[s] == COLLIDING:
                continue
            if block.tier[lane] == BY_INNER:
                _hit(query, s, code // S, BY_INNER, block)
            elif block.tier[lane] == OPEN:
                _leave(s, block)
            elif block.tiers[s] < BY_OUTER:
                block.tiers[s] = BY_OUTER


@njit()
def _search(query, S, held, block):
    """Settle the pairs that wait by the exact searches."""
    poses, waiting, N = block.placement.poses, block.waiting, block.directions
    for n in range(held):
        code = waiting.pair[n]
        s, p = code % S, code // S
        if block.verdicts[s] == COLLIDING:
            continue
        A = placed(query.pieces, waiting.piece_a[n], poses, waiting.pose_a[n])
        B = placed(query.pieces, waiting.piece_b[n], poses, waiting.pose_b[n])
        margin, shift = query.problem.margins[p], shift_between(A, B)
        widest = max(abs(shift[0]), abs(shift[1]), abs(shift[2]))
        if widest - rounding_error(A, B, shift) > reach(A) + reach(B) + margin:
            # Far beyond what single precision tells, where the squares of the search overflow.
            block.tiers[s] = max(block.tiers[s], BY_OUTER)
            continue
        verdict, tier = exact_piece_pair(A, B, margin, (N[n, 0], N[n, 1], N[n, 2]), block.exact)
        if verdict == COLLIDING:
            _hit(query, s, p, tier, block)
            if query.first_hit:
                return
        elif verdict == AMBIGUOUS:
            _leave(s, block)
        elif block.tiers[s] < tier:
            block.tiers[s] = tier


@inline
def _settle_waiting(query, S, held, block):
    """Settle the pairs that wait; none are left."""
    if query.mode == EXACT:
        _search(query, S, held, block)
    else:
        _improve(query, S, held, block)
    return np.int64(0)


@njit()
def _certify(query, keep, count, S, held, block):
    """Certify listed piece pairs; those left join the ones that wait, and the number of these is returned."""
    pieces, listed, tier = query.pieces, block.listed, block.tier
    poses, rows = block.placement.poses, block.placement.ellipsoids
    fill(listed, count)
    done = False
    if keep == 0.0 and len(pieces.single) > 0:
        done = certificate.single_certify(
            count, False, rows, poses, False, rows, poses, False, listed, listed, tier, block.normals
        )
    if not done:
        for lane in range(count):
            listed.piece_a[lane], listed.piece_b[lane] = block.pieces_a[lane], block.pieces_b[lane]
        fill(listed, count)
        if not certificate.certify_best(
            count, keep, pieces.hot, poses, True, pieces.hot, poses, True, listed, tier, block.normals
        ):
            tier[:count] = OPEN  # a link that is bent by overflow: nothing is proven about it
    for lane in range(count):
        code = listed.pair[lane]
        s = code % S
        if block.verdicts[s] == COLLIDING:
            continue
        if tier[lane] == BY_INNER:
            _hit(query, s, code // S, BY_INNER, block)
        elif tier[lane] == BY_OUTER:
            block.tiers[s] = max(block.tiers[s], BY_OUTER)
        elif tier[lane] != BY_SPHERE and (query.mode == EXACT or tier[lane] == certificate.UNSURE):
            pair_list.put(
                block.waiting, held, code, block.pieces_a[lane], block.pieces_b[lane], listed.pose_a[lane],
                listed.pose_b[lane],
            )  # fmt: skip
            for row in range(3):
                block.directions[held, row] = block.normals[row * BLOCK + lane]
            held += 1
        elif tier[lane] == OPEN:
            _leave(s, block)
    if _ended(query, block):
        return np.int64(0)
    # Last of all: it makes lists of its own in `listed`.
    if held > WAITING - BLOCK:
        held = _settle_waiting(query, S, held, block)
    return held


@inline
def _list(block, count, code, i, j, S, moving_pieces, pose_a, pose_b):
    """List pieces i and j, the first of which moves."""
    s = code % S
    row_b = j * S + s if j < moving_pieces else moving_pieces * (S - 1) + j
    pair_list.put(block.listed, count, code, i * S + s, row_b, pose_a, pose_b)
    block.pieces_a[count] = i
    block.pieces_b[count] = j


@njit()
def _settle_block(query, Q, first, last, S, counts, block):
    """Settle the configurations in the rows first .. last of Q, at most S of them, into `block.verdicts` and `tiers`.

    One function for both entries, compiled once.
    """
    pieces, problem = query.pieces, query.problem
    piece_start, poses = pieces.piece_start, block.placement.poses
    moving, moving_pieces, live = counts.moving, counts.moving_pieces, block.live
    place(problem, pieces, Q, first, last, S, block.placement)
    for group in range(GROUPS):
        rest = max(min(last + 1 - first - group * SINGLE_LANES, SINGLE_LANES), 0)
        live[group] = (np.int64(1) << rest) - 1
    block.verdicts[:] = FREE
    block.tiers[:] = BY_SPHERE
    count = np.int64(0)
    held = np.int64(0)
    keep = 0.0
    for number in range(len(problem.order)):
        p = problem.order[number]
        one, other = problem.pairs[p, 0], problem.pairs[p, 1]
        if problem.margins[p] != keep:
            # The lists are of one margin.
            if count > 0:
                held = _certify(query, keep, count, S, held, block)
                count = np.int64(0)
            keep = problem.margins[p]
        up = np.float32(keep * UP)
        i, j = piece_start[one], piece_start[other]
        simple = piece_start[one + 1] - i == 1 and piece_start[other + 1] - j == 1
        for group in range(S // SINGLE_LANES):
            if live[group] == 0:
                continue
            at = group * SINGLE_LANES
            bounds = block.placement.bounds
            here = bounds_at(bounds, one * BOUNDS * S + at, S)
            if other < moving:
                meet = near(here, bounds_at(bounds, other * BOUNDS * S + at, S), up, live[group])
            else:
                meet = near(here, bounds_standing(problem.standing, other - moving), up, live[group])
            while meet != 0:
                s = at + lowest_bit(meet)
                meet &= meet - 1
                pose_a = one * S + s
                pose_b = other * S + s if other < moving else moving * (S - 1) + other
                code = p * S + s
                if simple:
                    _list(block, count, code, i, j, S, moving_pieces, pose_a, pose_b)
                    count += 1
                else:
                    piece_tree.begin(
                        pieces, one, poses, pose_a, pieces, other, poses, pose_b, block.steps, block.numbers
                    )
                more = not simple
                while more or count == BLOCK:
                    if count == BLOCK:
                        held = _certify(query, keep, count, S, held, block)
                        count = np.int64(0)
                    if more and block.verdicts[s] != COLLIDING:
                        found = piece_tree.more(
                            pieces, pieces, other, keep, block.steps, block.numbers, block.found_a[: BLOCK - count],
                            block.found_b,
                        )  # fmt: skip
                        for c in range(found):
                            _list(
                                block, count + c, code, block.found_a[c], block.found_b[c], S, moving_pieces, pose_a,
                                pose_b,
                            )  # fmt: skip
                        count += found
                        more = found > 0
                    else:
                        more = False
        if _ended(query, block):
            return
    if count > 0:
        held = _certify(query, keep, count, S, held, block)
    if held > 0:
        _settle_waiting(query, S, held, block)


@inline
def _counts(pieces, problem, dof):
    """How much there is of everything."""
    moving = problem.link.size
    return Counts(
        problem.tree.parent.size, dof, moving, pieces.piece_start[moving], len(problem.standing),
        len(problem.standing_rows),
    )  # fmt: skip


@njit()
def memory_size(pack, problem_handle, dof):
    """Bytes that the two entries below write to."""
    return size(_counts(pieces_of(pack), problem_of(problem_handle), dof))


@njit()
def check_configurations(mode, start, stop, Q, pack, problem_handle, out, tiers_out, hits, memory):
    """Settle the configurations start .. stop.

    Parameters
    ----------
    mode : int
        CERTIFY or EXACT.
    Q : ndarray, shape (N, dof)
    pack : int
        Handle of the packed bodies, see `pieces.pack`: those that move, each in the frame of its link, then the others.
    problem_handle : int
        Handle of the rest, see `pack.problem_of`.
    out : ndarray of int8, shape (N,)
        Receives verdicts; AMBIGUOUS in mode EXACT means that the search did not settle a configuration.
    tiers_out : ndarray of int8, shape (N,)
        Receives the tier that settled a configuration: the costliest any pair needed if it is free, the one that
        found the collision otherwise.
    hits : ndarray of int64, shape (pairs,)
        Collisions found are added here, by pair.
    memory : int
        Address of `memory_size` bytes to write to; one thread uses them at a time.
    """
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    counts = _counts(pieces, problem, Q.shape[1])
    block = _block_at(memory, counts)
    query = Query(mode, np.int64(0), pieces, problem, hits)
    S = np.int64(SINGLE_LANES if stop - start <= SINGLE_LANES else MOST)
    stand(problem, S, counts, block.placement)
    for first in range(start, stop, S):
        last = min(first + S, stop) - 1
        _settle_block(query, Q, first, last, S, counts, block)
        for s in range(last + 1 - first):
            out[first + s] = block.verdicts[s]
            tiers_out[first + s] = block.tiers[s]


@njit()
def check_motion(start, end, fractions, pack, problem_handle, out, hits, memory):
    """Settle configurations on the straight way from `start` to `end` exactly, until the first collision.

    Parameters
    ----------
    start, end : ndarray, shape (dof,)
    fractions : ndarray, shape (N,)
        Which configurations: 0 is the start, 1 the end.
    pack, problem_handle, hits, memory
        As for `check_configurations`.
    out : ndarray of int8, shape (N,)
        Receives, if there is no collision, FREE or AMBIGUOUS: the search did not settle that configuration.

    Returns
    -------
    verdict : int
        COLLIDING: there is one. FREE: all are. AMBIGUOUS: none was found, and some are not settled.
    settled : int
        Configurations looked at.
    """
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    dof, total = len(start), len(fractions)
    counts = _counts(pieces, problem, dof)
    block = _block_at(memory, counts)
    query = Query(np.int64(EXACT), np.int64(1), pieces, problem, hits)
    # A motion that collides mostly does so at one of its first configurations.
    S = np.int64(SINGLE_LANES)
    stand(problem, S, counts, block.placement)
    verdict, first = np.int64(FREE), np.int64(0)
    while first < total:
        last = min(first + S, total) - 1
        for k in range(first, last + 1):
            for c in range(dof):
                straight = start[c] + fractions[k] * (end[c] - start[c])
                block.way[k - first, c] = straight if fractions[k] != 1.0 else end[c]
        _settle_block(query, block.way, np.int64(0), last - first, S, counts, block)
        for s in range(last + 1 - first):
            if block.verdicts[s] == COLLIDING:
                return np.int64(COLLIDING), last + 1
            if block.verdicts[s] == AMBIGUOUS:
                verdict = np.int64(AMBIGUOUS)
            out[first + s] = block.verdicts[s]
        first += S
        if S < MOST and total > MOST:
            S = np.int64(MOST)
            stand(problem, S, counts, block.placement)
    return verdict, total
