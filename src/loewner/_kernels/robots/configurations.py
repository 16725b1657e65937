"""Is a robot at a configuration free: blocks of configurations, side by side through all pairs of bodies.

The work of a block, cheapest first:

place
    the links by forward kinematics; of each moving piece the ellipsoids in world coordinates, so that no pair has to
    turn them again.
cull
    bounding spheres and boxes of each pair of bodies, sixteen configurations at a time.
certify
    the ellipsoids of the piece pairs that are left, by `lanes`, whatever configurations they belong to.
search
    what is then open, exactly, pair by pair.

A configuration that was found colliding takes no further part. Pairs are taken in an order that the caller chooses:
those that hit most often first.

Rows of the block: S configurations, S a multiple of sixteen. Body b that moves has its pose at configuration s in row
b S + s, piece p its ellipsoids in row p S + s; those that stand still follow, one row each.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import (
    AMBIGUOUS,
    BY_INNER,
    BY_OUTER,
    BY_SEARCH,
    BY_SPHERE,
    COLLIDING,
    EXACT,
    FREE,
    OPEN,
)
from loewner._kernels.ellipsoids.contact import SHAPE_ROUNDINGS
from loewner._kernels.linalg3 import apply, dot, minus, plus, rotated_shape, trace
from loewner._kernels.narrow import certificate as lanes
from loewner._kernels.narrow.certificate import (
    BLOCK,
    LISTS,
    OUT_NORMAL,
    PAIR,
    PIECE_A,
    PIECE_B,
    POSE_A,
    POSE_B,
    POSITION_ERROR,
    ROWS,
    SINGLE_ROUNDOFF,
    UNSURE,
)
from loewner._kernels.narrow.exact import exact_piece_pair, workspace
from loewner._kernels.narrow.gjk_robust import rounding_error
from loewner._kernels.pieces.pack import checking_of, pieces_of, placed, shift_between
from loewner._kernels.pieces.shapes import (
    HOT,
    INNER_CENTER,
    INNER_SHAPE,
    OUTER_CENTER,
    OUTER_RADIUS,
    OUTER_SHAPE,
    REACH,
    reach,
)
from loewner._kernels.robots.kinematics import POSE, place_links, workspace_size
from loewner._kernels.simd.vectors import (
    LANES,
    SINGLE_LANES,
    absolute,
    broadcast,
    load,
    load_single,
    lowest_bit,
    movemask,
    scatter_transpose,
    scatter_transpose_rounded,
    sqrt,
    store_rounded,
)
from loewner._kernels.trees import piece_tree as trees

MOST = 64  # configurations in a block

# What a body's row of bounds holds: center, how far a sphere about it must be from another one, half widths.
X, Y, Z, WIDE, HALF_X, HALF_Y, HALF_Z, BOUNDS = 0, 1, 2, 3, 4, 5, 6, 8

# Lengths and bounds are rounded up by this factor before they go to single precision.
UP = 1.0 + 2.0**-22

# What centers may be off by after rounding to single precision, relative to the lengths that they are made of; and a
# length far below all others that keeps squares from underflowing.
OFF, LEAST = POSITION_ERROR * SINGLE_ROUNDOFF, 1e-15

# Piece pairs that may wait for the exact search, and the columns of their list.
WAITING = 512
PAIR_NUMBER, STATE, A_PIECE, B_PIECE, T_A, T_B, ENTRIES = 0, 1, 2, 3, 4, 5, 6

# Piece pairs are listed for the certificate by their rows in the block; and here by their pieces.
BY_PIECE_A, BY_PIECE_B = 0, 1


@inline
def _place_piece(hot, p, R, t, S, at, numbers, rows):
    """Write the ellipsoids of piece p at eight configurations; returns center, length and squared half widths."""
    outer = plus(apply(R, (hot[p, OUTER_CENTER], hot[p, OUTER_CENTER + 1], hot[p, OUTER_CENTER + 2])), t)
    inner = plus(apply(R, (hot[p, INNER_CENTER], hot[p, INNER_CENTER + 1], hot[p, INNER_CENTER + 2])), t)
    k = OUTER_SHAPE
    P = rotated_shape(R, (hot[p, k], hot[p, k + 1], hot[p, k + 2], hot[p, k + 3], hot[p, k + 4], hot[p, k + 5]))
    k = INNER_SHAPE
    Q = rotated_shape(R, (hot[p, k], hot[p, k + 1], hot[p, k + 2], hot[p, k + 3], hot[p, k + 4], hot[p, k + 5]))
    length = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + hot[p, REACH]) * UP
    radius = hot[p, OUTER_RADIUS] * UP
    first, second = (*outer, broadcast(radius), *inner, length), OUTER_SHAPE + 6
    third = INNER_SHAPE + 6
    for lane in range(LANES):
        numbers[lane] = p * S + at + lane
    zero = np.int64(0)
    scatter_transpose_rounded(rows, HOT, numbers, zero, zero, first)
    scatter_transpose_rounded(
        rows, HOT, numbers, zero, OUTER_SHAPE, (*P, broadcast(hot[p, second]), broadcast(hot[p, second + 1]))
    )
    scatter_transpose_rounded(
        rows, HOT, numbers, zero, INNER_SHAPE, (*Q, broadcast(hot[p, third] * UP), broadcast(0.0))
    )
    slack = SHAPE_ROUNDINGS * trace(P)
    return outer, length, (P[0] + slack, P[3] + slack, P[5] + slack)


@inline
def _place(tree, Q, first, last, S, link, ball, piece_start, hot, W, numbers, T, rows, bounds):
    """Place all that moves at the configurations first .. last; vectors are filled up with repeats of the last."""
    zero, one = broadcast(0.0), broadcast(1.0)
    nought = np.int64(0)
    for at in range(0, min(S, last + 1 - first), LANES):
        for lane in range(LANES):
            numbers[lane] = min(first + at + lane, last)
        place_links(tree, Q, numbers, nought, W)
        for body in range(link.size):
            k = link[body] * (POSE * LANES)
            R = (
                load(W, k), load(W, k + LANES), load(W, k + 2 * LANES),
                load(W, k + 3 * LANES), load(W, k + 4 * LANES), load(W, k + 5 * LANES),
                load(W, k + 6 * LANES), load(W, k + 7 * LANES), load(W, k + 8 * LANES),
            )  # fmt: skip
            t = load(W, k + 9 * LANES), load(W, k + 10 * LANES), load(W, k + 11 * LANES)
            for lane in range(LANES):
                numbers[lane] = body * S + at + lane
            scatter_transpose(T, 16, numbers, nought, nought, (R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1]))
            scatter_transpose(T, 16, numbers, nought, np.int64(8), (R[6], R[7], R[8], t[2], zero, zero, zero, one))
            p = piece_start[body]
            center, length, squares = _place_piece(hot, p, R, t, S, at, numbers, rows)
            off = OFF * length + LEAST
            wide = off + ball[body, 3] * UP
            half = off + UP * sqrt(squares[0]), off + UP * sqrt(squares[1]), off + UP * sqrt(squares[2])
            if piece_start[body + 1] - p > 1:
                for other in range(p + 1, piece_start[body + 1]):
                    _place_piece(hot, other, R, t, S, at, numbers, rows)
                center = plus(apply(R, (ball[body, 0], ball[body, 1], ball[body, 2])), t)
                length = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + ball[body, 4]) * UP
                wide = wide + OFF * length
                half = wide, wide, wide
            k = body * BOUNDS * S + at
            store_rounded(bounds, k + X * S, center[0])
            store_rounded(bounds, k + Y * S, center[1])
            store_rounded(bounds, k + Z * S, center[2])
            store_rounded(bounds, k + WIDE * S, wide * UP)
            store_rounded(bounds, k + HALF_X * S, half[0] * UP)
            store_rounded(bounds, k + HALF_Y * S, half[1] * UP)
            store_rounded(bounds, k + HALF_Z * S, half[2] * UP)


@inline
def _stand(S, moving, moving_pieces, poses, ellipsoids, T, rows):
    """Write what stands still behind what moves in a block of S configurations."""
    for k in range(len(poses)):
        for entry in range(16):
            T[moving * S + k, entry // 4, entry % 4] = poses[k, entry]
    for k in range(len(ellipsoids)):
        for entry in range(HOT):
            rows[moving_pieces * S + k, entry] = ellipsoids[k, entry]


class Bounds(NamedTuple):
    """Of one body at sixteen configurations: center of a ball and a box about it, radius, half widths."""

    center: Any
    radius: Any
    half: Any


@inline
def _near(a, b, keep, live):
    """Of the configurations `live`, as bits, those at which the bounds of two bodies are not apart by `keep`."""
    r = minus(b.center, a.center)
    far = (a.radius + b.radius) + keep
    far = far * np.float32(UP)
    clear = dot(r, r) * np.float32(1.0 - 16.0 * SINGLE_ROUNDOFF) > far * far
    live = live & ~movemask(clear)
    if live != 0:
        up = np.float32(UP)
        clear = absolute(r[0]) > ((a.half[0] + b.half[0]) + keep) * up
        clear = clear | (absolute(r[1]) > ((a.half[1] + b.half[1]) + keep) * up)
        clear = clear | (absolute(r[2]) > ((a.half[2] + b.half[2]) + keep) * up)
        live = live & ~movemask(clear)
    return live


@inline
def _bounds_at(bounds, at, S):
    """Bounds of a body that moves."""
    return Bounds(
        (load_single(bounds, at + X * S), load_single(bounds, at + Y * S), load_single(bounds, at + Z * S)),
        load_single(bounds, at + WIDE * S),
        (
            load_single(bounds, at + HALF_X * S),
            load_single(bounds, at + HALF_Y * S),
            load_single(bounds, at + HALF_Z * S),
        ),
    )


@inline
def _still(standing, k):
    """Bounds of a body that stands still, at all configurations."""
    return Bounds(
        (broadcast(standing[k, X]), broadcast(standing[k, Y]), broadcast(standing[k, Z])),
        broadcast(standing[k, WIDE]),
        (broadcast(standing[k, HALF_X]), broadcast(standing[k, HALF_Y]), broadcast(standing[k, HALF_Z])),
    )


@inline
def _put(L, G, count, code, i, j, S, moving_pieces, pose_a, pose_b):
    """List pieces i and j, the first of which moves."""
    s = code % S
    L[PAIR * BLOCK + count] = code
    L[PIECE_A * BLOCK + count] = i * S + s
    L[PIECE_B * BLOCK + count] = j * S + s if j < moving_pieces else moving_pieces * (S - 1) + j
    L[POSE_A * BLOCK + count] = pose_a
    L[POSE_B * BLOCK + count] = pose_b
    G[BY_PIECE_A * BLOCK + count] = i
    G[BY_PIECE_B * BLOCK + count] = j


@inline
def _fill(count, L):
    """Repeat the last listed pair up to whole vectors."""
    for lane in range(count, (count + SINGLE_LANES - 1) // SINGLE_LANES * SINGLE_LANES):
        for row in range(PIECE_A, POSE_B + 1):
            L[row * BLOCK + lane] = L[row * BLOCK + count - 1]


@inline
def _hit(s, tier, live, verdicts, tiers):
    """A configuration that collides takes no further part."""
    live[s // SINGLE_LANES] &= ~(np.int64(1) << (s % SINGLE_LANES))
    verdicts[s] = COLLIDING
    tiers[s] = tier


@inline
def _leave(s, verdicts, tiers):
    verdicts[s] = AMBIGUOUS
    tiers[s] = OPEN


@njit()
def _improve(held, a, T, L, tier, V, live, verdicts, tiers, hits, waiting):
    """Certify the pairs that wait once more, at the best s in double precision, margin 0."""
    for first in range(0, held, BLOCK):
        count = min(BLOCK, held - first)
        for lane in range(count):
            entry = waiting[first + lane]
            L[PIECE_A * BLOCK + lane], L[PIECE_B * BLOCK + lane] = entry[A_PIECE], entry[B_PIECE]
            L[POSE_A * BLOCK + lane], L[POSE_B * BLOCK + lane] = entry[T_A], entry[T_B]
        _fill(count, L)
        if not lanes.certify_best(count, 0.0, a.hot, T, True, a.hot, T, True, L, tier, V):
            tier[:count] = OPEN
        for lane in range(count):
            s = waiting[first + lane, STATE]
            if verdicts[s] == COLLIDING:
                continue
            if tier[lane] == BY_INNER:
                _hit(s, BY_INNER, live, verdicts, tiers)
                hits[waiting[first + lane, PAIR_NUMBER]] += 1
            elif tier[lane] == OPEN:
                _leave(s, verdicts, tiers)
            elif tiers[s] < BY_OUTER:
                tiers[s] = BY_OUTER


@njit()
def _search(held, a, T, margins, live, verdicts, tiers, hits, waiting, N, work):
    """Settle the pairs that wait by the exact searches."""
    for n in range(held):
        s = waiting[n, STATE]
        if verdicts[s] == COLLIDING:
            continue
        p = waiting[n, PAIR_NUMBER]
        A, B = placed(a, waiting[n, A_PIECE], T, waiting[n, T_A]), placed(a, waiting[n, B_PIECE], T, waiting[n, T_B])
        shift = shift_between(A, B)
        widest = max(abs(shift[0]), abs(shift[1]), abs(shift[2]))
        if widest - rounding_error(A, B, shift) > reach(A) + reach(B) + margins[p]:
            # Far beyond what single precision tells, where the squares of the search overflow.
            tiers[s] = max(tiers[s], BY_OUTER)
            continue
        verdict, tier = exact_piece_pair(A, B, margins[p], (N[n, 0], N[n, 1], N[n, 2]), work)
        if verdict == COLLIDING:
            _hit(s, BY_SEARCH, live, verdicts, tiers)
            hits[p] += 1
        elif verdict == AMBIGUOUS:
            _leave(s, verdicts, tiers)
        elif tiers[s] < tier:
            tiers[s] = tier


@njit()
def _settle_waiting(mode, held, a, T, margins, L, tier, V, live, verdicts, tiers, hits, waiting, N, work):
    """Settle the pairs that wait; none are left."""
    if mode == EXACT:
        _search(held, a, T, margins, live, verdicts, tiers, hits, waiting, N, work)
    else:
        _improve(held, a, T, L, tier, V, live, verdicts, tiers, hits, waiting)
    return np.int64(0)


@njit()
def _certify(
    mode, keep, count, S, a, rows, T, margins, L, G, tier, V, live, verdicts, tiers, hits, waiting, N, held, work
):  # fmt: skip
    """Certify listed piece pairs; those left join the ones that wait, and the number of these is returned."""
    hot, rows, T, L, G, tier, V = (
        borrowed(a.hot), borrowed(rows), borrowed(T), borrowed(L), borrowed(G), borrowed(tier), borrowed(V),
    )  # fmt: skip
    _fill(count, L)
    done = False
    if keep == 0.0 and len(a.single) > 0:
        done = lanes.single_certify(count, False, rows, T, False, rows, T, False, L, tier, V)
    if not done:
        for lane in range(count):
            L[PIECE_A * BLOCK + lane] = G[BY_PIECE_A * BLOCK + lane]
            L[PIECE_B * BLOCK + lane] = G[BY_PIECE_B * BLOCK + lane]
        _fill(count, L)
        if not lanes.certify_best(count, keep, hot, T, True, hot, T, True, L, tier, V):
            tier[:count] = OPEN  # a link that is bent by overflow: nothing is proven about it
    for lane in range(count):
        code = L[PAIR * BLOCK + lane]
        s = code % S
        if verdicts[s] == COLLIDING:
            continue
        if tier[lane] == BY_INNER:
            _hit(s, BY_INNER, live, verdicts, tiers)
            hits[code // S] += 1
        elif tier[lane] == BY_OUTER:
            tiers[s] = max(tiers[s], BY_OUTER)
        elif tier[lane] != BY_SPHERE and (mode == EXACT or tier[lane] == UNSURE):
            waiting[held, PAIR_NUMBER] = code // S
            waiting[held, STATE] = s
            waiting[held, A_PIECE], waiting[held, B_PIECE] = G[BY_PIECE_A * BLOCK + lane], G[BY_PIECE_B * BLOCK + lane]
            waiting[held, T_A], waiting[held, T_B] = L[POSE_A * BLOCK + lane], L[POSE_B * BLOCK + lane]
            for row in range(3):
                N[held, row] = V[(OUT_NORMAL + row) * BLOCK + lane]
            held += 1
        elif tier[lane] == OPEN:
            _leave(s, verdicts, tiers)
    # Last of all: it makes lists of its own in L.
    if held > WAITING - BLOCK:
        held = _settle_waiting(mode, held, a, T, margins, L, tier, V, live, verdicts, tiers, hits, waiting, N, work)
    return held


@njit()
def check_states(mode, start, stop, Q, fractions, pack, problem, out, tiers_out, hits):
    """Settle the configurations start .. stop: rows of Q, or until the first collision on the way from Q[0] to Q[1].

    Parameters
    ----------
    mode : int
        CERTIFY or EXACT.
    Q : ndarray, shape (N, dof)
        Configurations; or the two ends of a motion.
    fractions : ndarray, shape (0,) or (N,)
        Of the motion, one for each configuration; none if Q are configurations themselves.
    pack : int
        Handle of the packed bodies, see `handles`: those that move, each in the frame of its link, then the others.
    problem : int
        Handle of the rest, see `handles.checking_of`.
    out : ndarray of int8, shape (N,)
        Receives verdicts; AMBIGUOUS in mode EXACT means that the search did not settle a configuration.
    tiers_out : ndarray of int8, shape (N,)
        Receives the tier that settled a configuration: the costliest any pair needed if it is free, the one that
        found the collision otherwise.
    hits : ndarray of int64, shape (pairs,)
        Collisions found are added here, by pair.

    Returns
    -------
    int
        Configurations up to here are settled; less than `stop` if a motion met a collision.
    """
    a = pieces_of(pack)
    tree, link, ball, pairs, margins, order, standing, standing_rows, standing_poses = checking_of(problem)
    moving, still = link.size, len(standing)
    piece_start = a.piece_start
    moving_pieces = piece_start[moving]
    moves = fractions.size > 0
    most = np.int64(SINGLE_LANES if stop - start <= SINGLE_LANES else MOST)
    # A motion that collides mostly does so at one of its first configurations.
    S = np.int64(SINGLE_LANES if moves else most)
    way = np.empty((most if moves else 0, Q.shape[1]))
    numbers = np.empty(LANES, np.int64)
    W = np.empty(workspace_size(len(tree[0]), Q.shape[1]))
    T = np.empty((moving * most + still, 4, 4))
    rows = np.empty((moving_pieces * most + len(standing_rows), HOT), np.float32)
    bounds = np.empty(moving * BOUNDS * most, np.float32)
    _stand(S, moving, moving_pieces, standing_poses, standing_rows, T, rows)

    L = np.empty(LISTS * BLOCK, np.int64)
    G = np.empty(2 * BLOCK, np.int64)
    tier = np.empty(BLOCK, np.int8)
    V = np.empty(ROWS * BLOCK)
    live = np.empty(MOST // SINGLE_LANES, np.int64)
    verdicts = np.empty(MOST, np.int8)
    tiers = np.empty(MOST, np.int8)
    waiting = np.empty((WAITING, ENTRIES), np.int64)
    N = np.empty((WAITING, 3))
    steps = np.empty(trees.STEPS, np.int64)
    walk = np.empty(trees.NUMBERS)
    found_a = np.empty(BLOCK, np.int64)
    found_b = np.empty(BLOCK, np.int64)
    work = workspace()
    first = np.int64(start)
    while first < stop:
        last = min(first + S, stop) - 1
        for k in range(first, last + 1 if moves else first):
            for c in range(Q.shape[1]):
                straight = Q[0, c] + fractions[k] * (Q[1, c] - Q[0, c])
                way[k - first, c] = straight if fractions[k] != 1.0 else Q[1, c]
        at = np.int64(0) if moves else first
        _place(
            tree, way if moves else Q, at, at + (last - first), S, link, ball, piece_start, a.hot, W, numbers, T, rows,
            bounds,
        )  # fmt: skip
        for group in range(S // SINGLE_LANES):
            rest = max(min(last + 1 - first - group * SINGLE_LANES, SINGLE_LANES), 0)
            live[group] = (np.int64(1) << rest) - 1
        verdicts[:] = FREE
        tiers[:] = BY_SPHERE
        count = np.int64(0)
        held = np.int64(0)
        keep = 0.0
        for number in range(len(order)):
            p = order[number]
            one, other = pairs[p, 0], pairs[p, 1]
            if margins[p] != keep:
                # The lists are of one margin.
                if count > 0:
                    held = _certify(
                        mode, keep, count, S, a, rows, T, margins, L, G, tier, V, live, verdicts, tiers, hits,
                        waiting, N, held, work,
                    )  # fmt: skip
                    count = np.int64(0)
                keep = margins[p]
            up = np.float32(keep * UP)
            i, j = piece_start[one], piece_start[other]
            simple = piece_start[one + 1] - i == 1 and piece_start[other + 1] - j == 1
            for group in range(S // SINGLE_LANES):
                if live[group] == 0:
                    continue
                at = group * SINGLE_LANES
                here = _bounds_at(bounds, one * BOUNDS * S + at, S)
                if other < moving:
                    near = _near(here, _bounds_at(bounds, other * BOUNDS * S + at, S), up, live[group])
                else:
                    near = _near(here, _still(standing, other - moving), up, live[group])
                while near != 0:
                    s = at + lowest_bit(near)
                    near &= near - 1
                    pose_a = one * S + s
                    pose_b = other * S + s if other < moving else moving * (S - 1) + other
                    code = p * S + s
                    if simple:
                        _put(L, G, count, code, i, j, S, moving_pieces, pose_a, pose_b)
                        count += 1
                    else:
                        trees.begin(a, one, T, pose_a, a, other, T, pose_b, steps, walk)
                    more = not simple
                    while more or count == BLOCK:
                        if count == BLOCK:
                            held = _certify(
                                mode, keep, count, S, a, rows, T, margins, L, G, tier, V, live, verdicts, tiers, hits,
                                waiting, N, held, work,
                            )  # fmt: skip
                            count = np.int64(0)
                        if more and verdicts[s] != COLLIDING:
                            found = trees.more(a, a, other, keep, steps, walk, found_a[: BLOCK - count], found_b)
                            for c in range(found):
                                _put(L, G, count + c, code, found_a[c], found_b[c], S, moving_pieces, pose_a, pose_b)
                            count += found
                            more = found > 0
                        else:
                            more = False
        if count > 0:
            held = _certify(
                mode, keep, count, S, a, rows, T, margins, L, G, tier, V, live, verdicts, tiers, hits,
                        waiting, N, held, work,
            )  # fmt: skip
        if held > 0:
            _settle_waiting(mode, held, a, T, margins, L, tier, V, live, verdicts, tiers, hits, waiting, N, work)
        for s in range(last + 1 - first):
            out[first + s] = verdicts[s]
            tiers_out[first + s] = tiers[s]
        if moves:
            for s in range(last + 1 - first):
                if verdicts[s] == COLLIDING:
                    return last + 1
        first += S
        if most > S:
            S = most
            _stand(S, moving, moving_pieces, standing_poses, standing_rows, T, rows)
    return stop
