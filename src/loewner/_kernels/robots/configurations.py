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
from loewner._kernels.codes import AMBIGUOUS, BY_INNER, BY_OUTER, BY_SPHERE, COLLIDING, EXACT, FREE, OPEN, UNSURE
from loewner._kernels.columns import BOUNDS, CACHE_LINE
from loewner._kernels.narrow import certificate, exact, pair_list
from loewner._kernels.narrow.certificate import BLOCK
from loewner._kernels.narrow.exact import exact_piece_pair
from loewner._kernels.narrow.gjk_robust import rounding_error
from loewner._kernels.narrow.pair_list import fill, pair_list_at
from loewner._kernels.pieces.pack import pieces_of, placed, problem_of, shift_between
from loewner._kernels.pieces.shapes import reach
from loewner._kernels.robots.placement import (
    MOST,
    Counts,
    bounds_at,
    bounds_standing,
    near,
    place,
    placement_at,
    placement_size,
    stand,
)
from loewner._kernels.simd.memory import bytes_at, floats_at, integers_at, lines, whole_lines
from loewner._kernels.simd.vectors import SINGLE_LANES, lowest_bit
from loewner._kernels.tolerances import UP
from loewner._kernels.trees import piece_tree

WAITING = 512  # piece pairs that may wait for the exact search

GROUPS = MOST // SINGLE_LANES  # of sixteen configurations, in a block


_LIST, _NUMBERS, _WAITING = pair_list.size(BLOCK), 8 * BLOCK, pair_list.size(WAITING)
_PIECES = _LIST
_FOUND = _PIECES + 2 * _NUMBERS
_TIER = _FOUND + 2 * _NUMBERS
_NORMALS = _TIER + BLOCK
_AT_WAITING = _NORMALS + 3 * _NUMBERS
_DIRECTIONS = _AT_WAITING + _WAITING
_LIVE = _DIRECTIONS + 3 * 8 * WAITING
_VERDICTS = _LIVE + CACHE_LINE
_STEPS = _VERDICTS + 2 * MOST
_TREE = _STEPS + whole_lines(8 * piece_tree.STEPS)
_EXACT = _TREE + whole_lines(8 * piece_tree.NUMBERS)
_WAY = _EXACT + exact.SIZE


class Query(NamedTuple):
    """What is asked, and where to work.

    Attributes
    ----------
    mode : CERTIFY or EXACT
    first_hit : 1 if the first collision ends it, else 0
    pack, problem : handles of the pieces, see `pieces.pack`, and of what to check, see `pack.problem_of`
    counts : how much there is of everything
    hits : where to count the collisions found, by pair
    work : address of the memory that the functions named ``_..._of`` divide up
    """

    mode: Any
    first_hit: Any
    pack: Any
    problem: Any
    counts: Any
    hits: Any
    work: Any


@inline
def size(counts):
    """Bytes that a query works in."""
    return _WAY + lines(8 * MOST * counts.dof) + placement_size(counts)


@inline
def _listed_of(work):
    """PairList: piece pairs for the certificate.

    `pair` is the number of the pair of bodies times S plus the configuration; pieces and poses are rows of the
    placement.
    """
    return pair_list_at(work, BLOCK)


@inline
def _pieces_a_of(work):
    """The listed pieces of a, by their rows in the packed pieces: int64, shape (BLOCK,)."""
    return integers_at(work + _PIECES, (BLOCK,))


@inline
def _pieces_b_of(work):
    """Those of b."""
    return integers_at(work + _PIECES + _NUMBERS, (BLOCK,))


@inline
def _tier_of(work):
    """What the certificate says of each listed pair: int8, shape (BLOCK,)."""
    return bytes_at(work + _TIER, (BLOCK,))


@inline
def _normals_of(work):
    """The contact normals that it writes: shape (3 * BLOCK,)."""
    return floats_at(work + _NORMALS, (3 * BLOCK,))


@inline
def _waiting_of(work):
    """PairList: piece pairs that wait for the exact search, by their rows in the packed pieces."""
    return pair_list_at(work + _AT_WAITING, WAITING)


@inline
def _directions_of(work):
    """The normals of those that wait: shape (WAITING, 3)."""
    return floats_at(work + _DIRECTIONS, (WAITING, 3))


@inline
def _live_of(work):
    """Configurations that may still be free, as bits: int64, shape (GROUPS,)."""
    return integers_at(work + _LIVE, (GROUPS,))


@inline
def _verdicts_of(work):
    """Verdicts of the configurations: int8, shape (MOST,)."""
    return bytes_at(work + _VERDICTS, (MOST,))


@inline
def _tiers_of(work):
    """What settled them: int8, shape (MOST,)."""
    return bytes_at(work + _VERDICTS + MOST, (MOST,))


@inline
def _way_of(work, counts):
    """Configurations of a motion: shape (MOST, dof)."""
    return floats_at(work + _WAY, (MOST, counts.dof))


@inline
def _placement_of(work, counts):
    """Where everything is."""
    return placement_at(work + _WAY + lines(8 * MOST * counts.dof), counts)


@inline
def _hit(query, s, pair, tier):
    """A configuration that collides takes no further part."""
    live = _live_of(query.work)
    live[s // SINGLE_LANES] &= ~(np.int64(1) << (s % SINGLE_LANES))
    if query.first_hit != 0:
        live[:] = 0
    _verdicts_of(query.work)[s] = COLLIDING
    _tiers_of(query.work)[s] = tier
    query.hits[pair] += 1


@inline
def _mark_open(query, s):
    """A configuration that is not known to collide has a pair that nothing settled."""
    _verdicts_of(query.work)[s] = AMBIGUOUS
    _tiers_of(query.work)[s] = OPEN


@inline
def _ended(query):
    """Whether no configuration of a motion needs to be looked at any more."""
    if query.first_hit == 0:
        return False
    live, rest = _live_of(query.work), np.int64(0)
    for group in range(GROUPS):
        rest |= live[group]
    return rest == 0


@njit()
def _improve(query, S, held):
    """Certify the pairs that wait once more, at the best s in double precision, margin 0."""
    work = query.work
    hot, poses = pieces_of(query.pack).hot, _placement_of(work, query.counts).poses
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
            s = code % S
            if verdicts[s] == COLLIDING:
                continue
            if tier[lane] == BY_INNER:
                _hit(query, s, code // S, BY_INNER)
            elif tier[lane] == OPEN:
                _mark_open(query, s)
            elif tiers[s] < BY_OUTER:
                tiers[s] = BY_OUTER


@njit()
def _search(query, S, held):
    """Settle the pairs that wait by the exact searches."""
    work, pieces, margins = query.work, pieces_of(query.pack), problem_of(query.problem).margins
    poses, waiting, N = _placement_of(work, query.counts).poses, _waiting_of(work), _directions_of(work)
    verdicts, tiers = _verdicts_of(work), _tiers_of(work)
    for n in range(held):
        code = waiting.pair[n]
        s, p = code % S, code // S
        if verdicts[s] == COLLIDING:
            continue
        A = placed(pieces, waiting.piece_a[n], poses, waiting.pose_a[n])
        B = placed(pieces, waiting.piece_b[n], poses, waiting.pose_b[n])
        margin, shift = margins[p], shift_between(A, B)
        widest = max(abs(shift[0]), abs(shift[1]), abs(shift[2]))
        if widest - rounding_error(A, B, shift) > reach(A) + reach(B) + margin:
            # Far beyond what single precision tells, where the squares of the search overflow.
            tiers[s] = max(tiers[s], BY_OUTER)
            continue
        verdict, tier = exact_piece_pair(A, B, margin, (N[n, 0], N[n, 1], N[n, 2]), work + _EXACT)
        if verdict == COLLIDING:
            _hit(query, s, p, tier)
            if query.first_hit != 0:
                return
        elif verdict == AMBIGUOUS:
            _mark_open(query, s)
        elif tiers[s] < tier:
            tiers[s] = tier


@inline
def _settle_waiting(query, S, held):
    """Settle the pairs that wait; none are left."""
    if query.mode == EXACT:
        _search(query, S, held)
    else:
        _improve(query, S, held)
    return np.int64(0)


@njit()
def _certify(query, keep, count, S, held):
    """Certify listed piece pairs; those left join the ones that wait, and the number of these is returned."""
    work, pieces = query.work, pieces_of(query.pack)
    placement = _placement_of(work, query.counts)
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
            tier[:count] = OPEN  # a link that is bent by overflow: nothing is proven about it
    for lane in range(count):
        code = listed.pair[lane]
        s = code % S
        if verdicts[s] == COLLIDING:
            continue
        if tier[lane] == BY_INNER:
            _hit(query, s, code // S, BY_INNER)
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
        return np.int64(0)
    # Last of all: it makes lists of its own in `listed`.
    if held > WAITING - BLOCK:
        held = _settle_waiting(query, S, held)
    return held


@inline
def _list(work, count, code, i, j, S, moving_pieces, pose_a, pose_b):
    """List pieces i and j, the first of which moves."""
    s = code % S
    row_b = j * S + s if j < moving_pieces else moving_pieces * (S - 1) + j
    pair_list.put(_listed_of(work), count, code, i * S + s, row_b, pose_a, pose_b)
    _pieces_a_of(work)[count] = i
    _pieces_b_of(work)[count] = j


@njit()
def _settle_block(query, Q, first, last, S):
    """Settle the configurations in the rows first .. last of Q, at most S of them, into `verdicts` and `tiers`.

    One function for both entries, compiled once.
    """
    work, counts, pieces, problem = query.work, query.counts, pieces_of(query.pack), problem_of(query.problem)
    placement = _placement_of(work, counts)
    piece_start, poses, bounds = pieces.piece_start, placement.poses, placement.bounds
    moving, moving_pieces, live = counts.moving, counts.moving_pieces, _live_of(work)
    steps, numbers = integers_at(work + _STEPS, (piece_tree.STEPS,)), floats_at(work + _TREE, (piece_tree.NUMBERS,))
    found_a, found_b = integers_at(work + _FOUND, (BLOCK,)), integers_at(work + _FOUND + _NUMBERS, (BLOCK,))
    verdicts = _verdicts_of(work)
    place(problem, pieces, Q, first, last, S, placement)
    for group in range(GROUPS):
        rest = max(min(last + 1 - first - group * SINGLE_LANES, SINGLE_LANES), 0)
        live[group] = (np.int64(1) << rest) - 1
    verdicts[:] = FREE
    _tiers_of(work)[:] = BY_SPHERE
    count = np.int64(0)
    held = np.int64(0)
    keep = 0.0
    for number in range(len(problem.order)):
        p = problem.order[number]
        one, other = problem.pairs[p, 0], problem.pairs[p, 1]
        if problem.margins[p] != keep:
            # The lists are of one margin.
            if count > 0:
                held = _certify(query, keep, count, S, held)
                count = np.int64(0)
            keep = problem.margins[p]
        up = np.float32(keep * UP)
        i, j = piece_start[one], piece_start[other]
        simple = piece_start[one + 1] - i == 1 and piece_start[other + 1] - j == 1
        for group in range(S // SINGLE_LANES):
            if live[group] == 0:
                continue
            at = group * SINGLE_LANES
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
                    _list(work, count, code, i, j, S, moving_pieces, pose_a, pose_b)
                    count += 1
                else:
                    piece_tree.begin(pieces, one, poses, pose_a, pieces, other, poses, pose_b, steps, numbers)
                more = not simple
                while more or count == BLOCK:
                    if count == BLOCK:
                        held = _certify(query, keep, count, S, held)
                        count = np.int64(0)
                    if more and verdicts[s] != COLLIDING:
                        found = piece_tree.more(
                            pieces, pieces, other, keep, steps, numbers, found_a[: BLOCK - count],
                            found_b,
                        )  # fmt: skip
                        for c in range(found):
                            _list(
                                work, count + c, code, found_a[c], found_b[c], S, moving_pieces, pose_a,
                                pose_b,
                            )  # fmt: skip
                        count += found
                        more = found > 0
                    else:
                        more = False
        if _ended(query):
            return
    if count > 0:
        held = _certify(query, keep, count, S, held)
    if held > 0:
        _settle_waiting(query, S, held)


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
    query = Query(mode, np.int64(0), pack, problem_handle, counts, hits, memory)
    placement, verdicts, tiers = _placement_of(memory, counts), _verdicts_of(memory), _tiers_of(memory)
    S = np.int64(SINGLE_LANES if stop - start <= SINGLE_LANES else MOST)
    stand(problem, S, counts, placement)
    for first in range(start, stop, S):
        last = min(first + S, stop) - 1
        _settle_block(query, Q, first, last, S)
        for s in range(last + 1 - first):
            out[first + s] = verdicts[s]
            tiers_out[first + s] = tiers[s]


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
    query = Query(np.int64(EXACT), np.int64(1), pack, problem_handle, counts, hits, memory)
    placement, verdicts, way = _placement_of(memory, counts), _verdicts_of(memory), _way_of(memory, counts)
    # A motion that collides mostly does so at one of its first configurations.
    S = np.int64(SINGLE_LANES)
    stand(problem, S, counts, placement)
    verdict, first = np.int64(FREE), np.int64(0)
    while first < total:
        last = min(first + S, total) - 1
        for k in range(first, last + 1):
            for c in range(dof):
                straight = start[c] + fractions[k] * (end[c] - start[c])
                way[k - first, c] = straight if fractions[k] != 1.0 else end[c]
        _settle_block(query, way, np.int64(0), last - first, S)
        for s in range(last + 1 - first):
            if verdicts[s] == COLLIDING:
                return np.int64(COLLIDING), last + 1
            if verdicts[s] == AMBIGUOUS:
                verdict = np.int64(AMBIGUOUS)
            out[first + s] = verdicts[s]
        first += S
        if S < MOST and total > MOST:
            S = np.int64(MOST)
            stand(problem, S, counts, placement)
    return verdict, total
