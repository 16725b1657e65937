"""Straight motions of a robot in tiles of intervals: a plane that separates two bodies proves a whole interval.

Each step is a separate kernel:

bound_motion
    The curvature of the paths of bodies' points, for one chain of joints.
list_probe, strike_motion
    The motions that collide at one of four configurations.
begin_motion
    The list of the first intervals of the remaining motions.
place_end
    The values at an end of an interval, for `configurations.place_links`, which `configurations.place_body` follows.
cull_interval
    The list of the pairs of bodies whose bounds are not apart in an interval.
certify_interval
    A plane between the outer ellipsoids of the pieces, and the list of the pieces that it leaves open.
search_interval
    The search for a plane, or for contact at an end of the interval.
halve_interval
    The list of the two halves of an interval that was not proven.

An interval has the number of a node of a binary tree: the whole motion is 1, and the halves of n are 2 n and 2 n + 1.
The ends of an interval are two neighbouring configurations of the tile. docs/certified.md derives the proofs under
"Motions" and "On a GPU".
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import APART, TOUCHING
from loewner._kernels.columns import (
    BOUNDS,
    CHAIN,
    CHAIN_INTEGERS,
    CHAIN_NUMBERS,
    HOT,
    LEVER,
    LOWER,
    OUTER_SHAPE,
    ROLES,
    TURNING_JOINT,
    UPPER,
)
from loewner._kernels.ellipsoids.contact import normal_at
from loewner._kernels.linalg3 import apply_symmetric, dot, minus, one_norm, plus, rotated_shape, scaled, trace
from loewner._kernels.narrow.certificate import SHAPE_ERROR, guess
from loewner._kernels.simd.scalars import (
    add_to,
    eight_at,
    holds,
    integer_at,
    lane_of,
    lane_of_integer,
    number_at,
    put_integer,
    put_number,
    raise_to,
)
from loewner._kernels.simd.vectors import absolute, maximum, sqrt
from loewner._kernels.threads.configurations import (
    HIT,
    LEFT_OPEN,
    SO_FAR_FREE,
    bounds_of,
    cell_at,
    from_lower,
    list_piece_pair,
    pieces_of,
    pose_in,
)
from loewner._kernels.threads.pairs import MOST_PIECE_PAIRS
from loewner._kernels.threads.searches import core_at, search
from loewner._kernels.tolerances import OFF, SINGLE_ROUNDOFF, UP

# A motion is first halved repeatedly until points deviate from their chords by at most FIRST_BEND [m], but at most
# MOST_HALVINGS times. An open interval that is the result of DEEPEST or more halvings is not halved again, but left to
# the CPU.
FIRST_BEND, MOST_HALVINGS, DEEPEST = 0.05, 6, 10

# Bound on the error of a joint's value between the ends of a motion, in units of `configurations.VALUE_TURN` times the
# larger magnitude of the values at the two ends.
SPAN = 2.0  # certified.md B64

# STRETCH bounds the relative rounding error of a computed bound on curvature, for up to a thousand joints. REST_ERROR
# bounds the error of a difference between two sums of rates, for each joint and in units of the roundoff times the
# larger sum.
STRETCH = 1e-3  # certified.md B65
REST_ERROR = 4.0  # certified.md B66

# Bound on the sum of two errors: the error of the distance between a chord's middle and the origin, and the error of
# half the chord's length. The unit is the roundoff times the sum of both numbers.
CHORD_ERROR = 8.0  # certified.md B67


@inline
def _interval_at(items, i):
    """Motion of an interval, its number in the tree, the fraction at which it begins, and its width."""
    motion, node = integer_at(items, 2 * i), integer_at(items, 2 * i + 1)
    parts = 1
    while 2 * parts <= node:
        parts *= 2
    width = 1.0 / lane_of_integer(parts)
    return motion, node, lane_of_integer(node - parts) * width, width


@njit()
def bound_motion(thread, most, total, dof, Q0, Q1, table, bends):
    """Bound the second derivative of a body's points relative to another body, on a straight motion.

    Parameters
    ----------
    thread : int
        The chain times `most` plus the motion.
    total : int
        Number of motions.
    Q0, Q1 : float32, shape (n, dof)
        Ends of the motions, rounded to single precision if the caller passed doubles.
    table : int64
        See `configurations.cell_at`.
    bends : float32, shape (chains, most)
        Receives the bound.
    """
    chain = np.int64(np.uint32(thread) // np.uint32(most))
    motion = thread - chain * most
    if motion >= total:
        return
    cell = cell_at(table)
    first, last = integer_at(cell.chain_start, chain), integer_at(cell.chain_start, chain + 1)
    every, bend, travel, speed = lane_of(0.0), lane_of(0.0), lane_of(0.0), lane_of(0.0)
    # Take the joints in the order from the upper body to the lower one, like `motion_bounds.ways_between`. The term of
    # a joint contains the sum of the turns of all joints after it, so a first loop runs backward to compute these sums.
    k = last - 1
    while k >= first:
        turn, slide, _ = _rates(cell, k, motion, dof, Q0, Q1)
        bend = bend + 2.0 * slide * every
        every = every + turn
        k -= 1
    rest = every
    k = first
    while k < last:
        turn, slide, far = _rates(cell, k, motion, dof, Q0, Q1)
        rest = maximum(rest - turn, lane_of(0.0))
        moved = turn * (number_at(cell.levers, CHAIN_NUMBERS * k + LEVER) + travel)
        bend = bend + moved * (turn + 2.0 * rest)
        speed = speed + moved
        travel = travel + far
        k += 1
    off = REST_ERROR * SINGLE_ROUNDOFF * lane_of_integer(last - first) * every * speed
    put_number(bends, thread, (bend + off) * (1.0 + STRETCH))


@inline
def _rates(cell, k, motion, dof, Q0, Q1):
    """Turn and slide of a joint on a motion, and the joint's largest distance from 0 if it slides."""
    at = motion * dof + integer_at(cell.joints, CHAIN_INTEGERS * k)
    by, offset = absolute(number_at(cell.levers, CHAIN_NUMBERS * k)), number_at(cell.levers, CHAIN_NUMBERS * k + 1)
    first, last = number_at(Q0, at), number_at(Q1, at)
    largest = maximum(absolute(first), absolute(last))
    way = by * (absolute(last - first) + 4.0 * SINGLE_ROUNDOFF * largest)
    nought = lane_of(0.0)
    if integer_at(cell.joints, CHAIN_INTEGERS * k + TURNING_JOINT) == 1:
        return way, nought, nought
    return nought, way, by * largest + absolute(offset)


@njit()
def list_probe(thread, items):
    """List the second and the last quarter of a motion, so that its configurations at all four quarters are checked.

    Parameters
    ----------
    thread : int
        Twice the motion, or one more.
    items : int32, shape (2 motions, 2)
        Receives the motion and the node.
    """
    put_integer(items, 2 * thread, thread >> 1)
    put_integer(items, 2 * thread + 1, 5 + 2 * (thread & 1))


@njit()
def strike_motion(thread, items, found, state):
    """Set the state of a motion that collides at a configuration of the tile, whose state is in `found`."""
    if integer_at(found, thread) == HIT:
        raise_to(state, integer_at(items, 2 * (thread >> 1)), HIT)


@njit()
def begin_motion(thread, most, moving, bends, state, items, capacity):
    """List the first intervals of a motion.

    Parameters
    ----------
    thread : int
        The motion.
    state : int32
        State of each motion. If the list has no room for the intervals of a motion, the motion is left to the CPU.
    items : int32, shape (1 + 2 capacity,)
        Receives the number of intervals, followed by the motion and the node of each interval.
    """
    if integer_at(state, thread) == HIT:
        return
    bend = lane_of(0.0)
    body = 0
    while body < moving:
        bend = maximum(bend, number_at(bends, body * most + thread))
        body += 1
    parts, left = 1, 0.125 * bend
    while parts < 1 << MOST_HALVINGS and not holds(left <= FIRST_BEND):
        parts, left = 2 * parts, 0.25 * left
    at = add_to(items, 0, parts)
    if at + parts > capacity:
        raise_to(state, thread, LEFT_OPEN)
        # Fill the remaining rows: every row up to the capacity is read, so none may stay unset.
        parts = max(0, min(parts, capacity - at))
    k = 0
    while k < parts:
        put_integer(items, 1 + 2 * (at + k), thread)
        put_integer(items, 2 + 2 * (at + k), parts + k)
        k += 1


@njit()
def place_end(thread, dof, Q0, Q1, items, Q, spans):
    """Write one value at an end of an interval, and SPAN times the largest magnitude from which it is computed.

    Parameters
    ----------
    thread : int
        The configuration times `dof` plus the value; the ends of interval i are configurations 2 i and 2 i + 1.
    items : int32
        The motion and the node of each interval of the tile.
    """
    slot = np.int64(np.uint32(thread) // np.uint32(dof))
    motion, _, begin, width = _interval_at(items, slot >> 1)
    at = motion * dof + thread - slot * dof
    first, last = number_at(Q0, at), number_at(Q1, at)
    where = begin + lane_of_integer(slot & 1) * width
    put_number(Q, thread, first + where * (last - first))
    put_number(spans, thread, SPAN * maximum(absolute(first), absolute(last)))


@inline
def _bend_of(bends, most, chain, motion, width):
    """How far the points of a chain's body deviate from their chords in an interval."""
    return 0.125 * (width * width) * number_at(bends, chain * most + motion)


@njit()
def cull_interval(
    thread, S, log_S, most, total, table, items, bounds, standing, bends, state, survivors, capacity, flags
):  # fmt: skip
    """List a pair of bodies in an interval unless their bounds are apart during the whole interval.

    Parameters
    ----------
    thread : int
        The pair times S / 2 plus the interval.
    most : int
        Number of motions in a row of `bends`.
    total : int
        Number of intervals in the tile.
    bounds, `standing`, survivors, capacity
        Documented in `configurations.cull_pair`.
    state, flags : int32
        States of motions, and whether each interval is open. If the list has no room for a pair, the interval is open.
    """
    p, i = thread >> (log_S - 1), thread & ((S >> 1) - 1)
    if i >= total:
        return
    motion, _, _, width = _interval_at(items, i)
    if integer_at(state, motion) != SO_FAR_FREE:
        return
    cell = cell_at(table)
    one, other = integer_at(cell.pairs, 2 * p), integer_at(cell.pairs, 2 * p + 1)
    keep = number_at(cell.margins, p) + _bend_of(bends, most, one, motion, width)
    a0 = bounds_of(bounds, one * BOUNDS * S + 2 * i, S)
    a1 = bounds_of(bounds, one * BOUNDS * S + 2 * i + 1, S)
    if other < cell.moving:
        keep = keep + _bend_of(bends, most, other, motion, width)
        b0 = bounds_of(bounds, other * BOUNDS * S + 2 * i, S)
        b1 = bounds_of(bounds, other * BOUNDS * S + 2 * i + 1, S)
    else:
        b0 = bounds_of(standing, (other - cell.moving) * BOUNDS, 1)
        b1 = b0
    if _apart_between(a0, b0, a1, b1, keep):
        return
    at = add_to(survivors, 0, 1)
    if at < capacity:
        put_integer(survivors, 1 + at, thread)
    else:
        raise_to(flags, i, 1)


@inline
def _beyond(x0, h0, x1, h1, keep):
    """Return whether boxes are apart along an axis at both ends, on the same side."""
    least0, least1 = (h0 + keep) * UP, (h1 + keep) * UP
    return ((x0 > least0) & (x1 > least1)) | ((-x0 > least0) & (-x1 > least1))


@inline
def _apart_between(a0, b0, a1, b1, keep):
    """Return whether bounds are apart by `keep` while their centers move along chords."""
    r0, r1 = minus(b0.center, a0.center), minus(b1.center, a1.center)
    h0, h1 = plus(b0.half, a0.half), plus(b1.half, a1.half)
    apart = _beyond(r0[0], h0[0], r1[0], h1[0], keep)
    apart = apart | _beyond(r0[1], h0[1], r1[1], h1[1], keep) | _beyond(r0[2], h0[2], r1[2], h1[2], keep)
    middle, way = scaled(0.5, plus(r0, r1)), scaled(0.5, minus(r1, r0))
    wide = maximum(a0.radius, a1.radius) + maximum(b0.radius, b1.radius)
    lengths = one_norm(middle) + one_norm(way)
    far = (wide + keep + sqrt(dot(way, way))) * (1.0 + 16.0 * SINGLE_ROUNDOFF) + CHORD_ERROR * SINGLE_ROUNDOFF * lengths
    return holds(apart | (dot(middle, middle) * (1.0 - 16.0 * SINGLE_ROUNDOFF) > far * far))


class _Asked(NamedTuple):
    """A pair of bodies in an interval: its number, motion and node; the bodies, their margin and their bend."""

    i: Any
    motion: Any
    node: Any
    upper: Any
    lower: Any
    margin: Any
    bend: Any


@inline
def _asked(cell, code, log_S, most, items, bends):
    """Read the record of a listed pair."""
    p, i = code >> (log_S - 1), code & ((1 << (log_S - 1)) - 1)
    motion, node, _, width = _interval_at(items, i)
    roles = cell.roles + 4 * ROLES * p
    bend = _bend_of(bends, most, integer_at(roles, CHAIN), motion, width)
    return _Asked(
        i, motion, node, integer_at(roles, UPPER), integer_at(roles, LOWER), number_at(cell.margins, p), bend
    )  # fmt: skip


@inline
def _ends_of(cell, asked, placed, S):
    """Poses of the upper body in the frame of the lower body at both ends, and the larger error of the two poses."""
    R0, t0, off0 = pose_in(cell, placed, asked.upper, asked.lower, asked.margin, S, 2 * asked.i)
    R1, t1, off1 = pose_in(cell, placed, asked.upper, asked.lower, asked.margin, S, 2 * asked.i + 1)
    return (R0, t0), (R1, t1), maximum(off0, off1)


@njit()
def certify_interval(
    thread, S, log_S, most, table, items, placed, bends, state, survivors, searches, capacity, flags
):  # fmt: skip
    """Test planes between the outer ellipsoids of a listed pair of bodies, and list the pieces that stay open.

    Parameters
    ----------
    thread : int
        Place in the list of survivors.
    placed, survivors, searches, capacity
        Documented in `configurations.certify_survivor`.
    """
    if thread >= min(integer_at(survivors, 0), capacity):
        return
    cell, code = cell_at(table), integer_at(survivors, 1 + thread)
    interval = _asked(cell, code, log_S, most, items, bends)
    if integer_at(state, interval.motion) == HIT:
        return
    first, last, off = _ends_of(cell, interval, placed, S)
    keep = interval.margin + interval.bend + off
    j, last_a = pieces_of(cell.bodies, interval.upper)
    first_b, last_b = pieces_of(cell.bodies, interval.lower)
    if (last_a - j) * (last_b - first_b) > MOST_PIECE_PAIRS:
        raise_to(state, interval.motion, LEFT_OPEN)
        j = last_a
    while j < last_a:
        k = first_b
        while k < last_b:
            lengths = maximum(one_norm(first[1]), one_norm(last[1])) + _reach(cell, j) + _reach(cell, k)
            apart = _ellipsoids_apart(cell, j, k, first, last, keep + OFF * lengths)
            if not apart and not list_piece_pair(code, j, k, searches, capacity):
                raise_to(flags, interval.i, 1)
            k += 1
        j += 1


@inline
def _reach(cell, piece):
    return eight_at(cell.rows, HOT * piece)[7]


@inline
def _ellipsoids_apart(cell, j, k, first, last, keep):
    """Return whether a plane separates the outer ellipsoids of piece k and of piece j at both poses."""
    shape, still = eight_at(cell.rows, HOT * j + OUTER_SHAPE), eight_at(cell.rows, HOT * k + OUTER_SHAPE)
    P = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    Q = still[0], still[1], still[2], still[3], still[4], still[5]
    P0, P1 = rotated_shape(first[0], P), rotated_shape(last[0], P)
    c0, c1 = from_lower(cell, j, k, first[0], first[1]), from_lower(cell, j, k, last[0], last[1])
    r = scaled(0.5, plus(c0, c1))
    _, n = normal_at(P0, Q, r, guess(P0, Q, r, 1e-30))
    squared = dot(n, n)
    width = _width(Q, n, squared)
    gap0 = dot(n, c0) - _width(P0, n, squared) - width
    gap1 = dot(n, c1) - _width(P1, n, squared) - width
    least = sqrt(squared) * keep * (1.0 + 16.0 * SINGLE_ROUNDOFF)
    # The squares of shorter normals may have lost digits.
    return holds((gap0 > least) & (gap1 > least) & (squared > 1e-12))


@inline
def _width(P, n, squared):
    """Compute `contact.outward_width` in single precision."""
    square = maximum(dot(apply_symmetric(P, n), n), lane_of(0.0)) + SHAPE_ERROR * SINGLE_ROUNDOFF * trace(P) * squared
    return sqrt(square) * (1.0 + 4.0 * SINGLE_ROUNDOFF)


@njit()
def search_interval(thread, S, log_S, most, table, items, placed, bends, state, searches, capacity, flags):
    """Search for a plane between two listed pieces in an interval; if none is found, test contact at the ends.

    Parameters
    ----------
    thread : int
        Place in the list of searches.
    placed, searches, capacity
        Documented in `configurations.certify_survivor`.
    state, flags : int32
        A motion with contact collides; an interval with neither a plane nor contact is open.
    """
    if thread >= min(integer_at(searches, 0), capacity):
        return
    code, j, k = (
        integer_at(searches, 3 * thread + 1), integer_at(searches, 3 * thread + 2), integer_at(searches, 3 * thread + 3)
    )  # fmt: skip
    cell = cell_at(table)
    interval = _asked(cell, code, log_S, most, items, bends)
    if integer_at(state, interval.motion) == HIT:
        return
    a, b = core_at(cell.cores, cell.numbers, cell.vertices, j), core_at(cell.cores, cell.numbers, cell.vertices, k)
    first, last, off = _ends_of(cell, interval, placed, S)
    n = scaled(0.5, plus(from_lower(cell, j, k, first[0], first[1]), from_lower(cell, j, k, last[0], last[1])))
    # First, search the hull of the piece at both ends of the interval; then search the piece at the later end. If the
    # motion begins with this interval, also search the piece at the first end.
    last_attempt = 2 if interval.node & (interval.node - 1) == 0 else 1
    attempt, keep = 0, interval.margin + interval.bend
    while attempt <= last_attempt:
        pose = last if attempt == 1 else first
        status = search(a, pose, last, attempt == 0, b, n, keep * UP, off)
        if status == APART and attempt == 0:
            return
        if status == TOUCHING and attempt > 0:
            raise_to(state, interval.motion, HIT)
            return
        attempt, keep = attempt + 1, interval.margin
    raise_to(flags, interval.i, 1)


@njit()
def halve_interval(thread, items, state, flags, halves, capacity):
    """List the halves of an open interval, unless its motion collides; intervals that are too short go to the CPU.

    Parameters
    ----------
    thread : int
        The interval.
    halves : int32, shape (1 + 2 capacity,)
        Receives the number of halves, followed by the motion and the node of each half.
    """
    motion, node = integer_at(items, 2 * thread), integer_at(items, 2 * thread + 1)
    if integer_at(flags, thread) == 0 or integer_at(state, motion) != SO_FAR_FREE:
        return
    if node >= 1 << DEEPEST:
        raise_to(state, motion, LEFT_OPEN)
        return
    at = add_to(halves, 0, 2)
    if at + 2 > capacity:
        raise_to(state, motion, LEFT_OPEN)
        return
    put_integer(halves, 1 + 2 * at, motion)
    put_integer(halves, 2 + 2 * at, 2 * node)
    put_integer(halves, 3 + 2 * at, motion)
    put_integer(halves, 4 + 2 * at, 2 * node + 1)
