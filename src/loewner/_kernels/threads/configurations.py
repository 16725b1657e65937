"""Configurations of a robot in tiles of thousands: one thread per configuration, body, pair of bodies or survivor.

Each step of a tile is a separate kernel, because a thread that took all steps would need too many registers:

place_links
    Forward kinematics, with bounds on the error of each link's rotation and translation.
place_body
    A ball and a box about each moving body.
cull_pair
    The list of the pairs of bodies whose bounds are not apart.
certify_survivor
    The ellipsoids of the pieces of a listed pair, and the list of the pieces that they leave open.
search_survivor
    The exact search on two such pieces.
conclude
    The verdicts; open configurations go to a list for the CPU.

In a tile of S configurations, with S a power of two, equal entries of all configurations lie side by side: entry r of
link l at configuration s is at ``(l * LINK_NUMBERS + r) * S + s``, and entry r of body b at ``(b * BOUNDS + r) * S +
s``.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import AMBIGUOUS, APART, BY_INNER, BY_OUTER, BY_SPHERE, COLLIDING, FREE, OPEN, TOUCHING
from loewner._kernels.columns import (
    ACROSS,
    BALL_NUMBERS,
    BALL_RADIUS,
    BALL_REACH,
    BENT,
    BODY_INTEGERS,
    BOUNDS,
    COLUMN_OF_LINK,
    COSINE,
    FIRST_PIECE,
    HOT,
    KIND_OF_LINK,
    LAST_PIECE,
    LINK_AT,
    LINK_CONSTANTS,
    LINK_INTEGERS,
    LINK_NUMBERS,
    LINK_OF_BODY,
    MULTIPLIER,
    OFFSET,
    OUTER_CENTER,
    OUTER_SHAPE,
    PARENT_OF_LINK,
    PRISMATIC,
    REVOLUTE,
    ROTATION,
    SHIFT_OFF,
    SINE,
    TRANSLATION,
    TURN_OFF,
)
from loewner._kernels.linalg3 import along, apply, image, minus, one_norm, plus, product, rotated_shape, trace, turned
from loewner._kernels.narrow.certificate import SHAPE_ERROR, Pose, tier_of_one
from loewner._kernels.robots.placement import HALF_X, HALF_Y, HALF_Z, WIDE, Bounds, X, Y, Z, near
from loewner._kernels.simd.scalars import (
    add_to,
    eight_at,
    holds,
    integer_at,
    lane_of,
    number_at,
    put_byte,
    put_integer,
    put_number,
    raise_to,
    word_at,
)
from loewner._kernels.simd.trig import SINGLE_LARGEST, sine_cosine_single
from loewner._kernels.simd.vectors import absolute, maximum, minimum, select, sqrt
from loewner._kernels.threads.pairs import MOST_PIECE_PAIRS, append
from loewner._kernels.threads.searches import core_at, relative, search
from loewner._kernels.tolerances import LEAST, OFF, SINGLE_ROUNDOFF, UP

# Number of the extra column next to a placed body's bounds. This column holds the largest position error of any point
# of the body [m].
ASTRAY = 7

# Allowed error of a link's pose in the frame of another link, in roundings times the lengths.
COMPOSED = 24.0  # certified.md B63

# Allowed errors. JOINT_TURN is the error that each joint adds to a rotation, in roundings (spectral norm), and
# VALUE_TURN is the additional error for each radian of the joint's value. JOINT_SHIFT is the error that each joint adds
# to a translation, in roundings times the lengths from which the translation is computed.
JOINT_TURN = 40.0  # certified.md B45
VALUE_TURN = 8.0  # certified.md B46
JOINT_SHIFT = 20.0  # certified.md B47

# States of a configuration while its pairs are checked. The state is a number that never decreases.
SO_FAR_FREE, LEFT_OPEN, HIT = 0, 1, 2


@inline
def _three(constants, k):
    return number_at(constants, k), number_at(constants, k + 1), number_at(constants, k + 2)


@inline
def _nine(constants, k):
    return _three(constants, k) + _three(constants, k + 3) + _three(constants, k + 6)


@inline
def _rotation_at(placed, row, S, s):
    """Load nine numbers of a tile, by rows."""
    at = row * S + s
    return (
        number_at(placed, at), number_at(placed, at + S), number_at(placed, at + 2 * S), number_at(placed, at + 3 * S),
        number_at(placed, at + 4 * S), number_at(placed, at + 5 * S), number_at(placed, at + 6 * S),
        number_at(placed, at + 7 * S), number_at(placed, at + 8 * S),
    )  # fmt: skip


@inline
def _vector_at(placed, row, S, s):
    """Load three numbers of a tile."""
    at = row * S + s
    return number_at(placed, at), number_at(placed, at + S), number_at(placed, at + 2 * S)


@inline
def _put_link(placed, link, S, s, R, t, turn_off, shift_off):
    """Write a placed link."""
    at = link * LINK_NUMBERS * S + s
    put_number(placed, at, R[0])
    put_number(placed, at + S, R[1])
    put_number(placed, at + 2 * S, R[2])
    put_number(placed, at + 3 * S, R[3])
    put_number(placed, at + 4 * S, R[4])
    put_number(placed, at + 5 * S, R[5])
    put_number(placed, at + 6 * S, R[6])
    put_number(placed, at + 7 * S, R[7])
    put_number(placed, at + 8 * S, R[8])
    put_number(placed, at + 9 * S, t[0])
    put_number(placed, at + 10 * S, t[1])
    put_number(placed, at + 11 * S, t[2])
    put_number(placed, at + TURN_OFF * S, turn_off)
    put_number(placed, at + SHIFT_OFF * S, shift_off)


@njit()
def place_links(thread, S, Q, spans, dof, links, joints, constants, placed):
    """Place the links at one configuration, and bound the rounding errors (docs/certified.md, B45 to B47).

    Parameters
    ----------
    thread : int
        The configuration: a row of Q.
    S : int
        Number of configurations per tile.
    Q : float32, shape (n, dof)
        The configurations, rounded to single precision if the caller passed doubles.
    spans : float32, shape (n, dof), or the address 0
        `motions.SPAN` times the largest magnitudes from which values were interpolated (B64).
    joints : int32, shape (links, LINK_INTEGERS)
        Parent, kind and column of each link, see `robots.kinematics`. Only the kinds FIXED, REVOLUTE and PRISMATIC are
        allowed.
    constants : float32, shape (links, LINK_CONSTANTS)
        The constants of each link. Column BENT of the first links holds, in roundings, the deviation of the robot's
        rotations from orthonormal ones.
    placed : float32
        Receives the links of the tile.
    """
    link = 0
    while link < links:
        joint, c = joints + 4 * LINK_INTEGERS * link, constants + 4 * LINK_CONSTANTS * link
        R, t = _nine(c, ROTATION), _three(c, TRANSLATION)
        lengths = one_norm(t)
        turn_off, shift_off = number_at(c, BENT), lane_of(0.0)
        kind = integer_at(joint, KIND_OF_LINK)
        if kind in (REVOLUTE, PRISMATIC):
            at, by = thread * dof + integer_at(joint, COLUMN_OF_LINK), number_at(c, MULTIPLIER)
            moved, offset = number_at(Q, at) * by, number_at(c, OFFSET)
            value, values = moved + offset, absolute(moved) + absolute(offset)
            if spans != 0:
                values = values + number_at(spans, at) * absolute(by)
            if kind == REVOLUTE:
                sine, cosine = sine_cosine_single(value)
                R = turned(R, sine, _nine(c, SINE), cosine, _nine(c, COSINE))
                # If an angle is too large or NaN, its error is unknown, and counts as infinite.
                turn_off = turn_off + select(values < SINGLE_LARGEST, VALUE_TURN * values, lane_of(np.inf))
            else:
                t = along(t, value, _three(c, ACROSS))
                lengths = lengths + values
        above = integer_at(joint, PARENT_OF_LINK)
        if above >= 0:
            A = _rotation_at(placed, above * LINK_NUMBERS, S, thread)
            b = _vector_at(placed, above * LINK_NUMBERS + LINK_AT, S, thread)
            off = number_at(placed, (above * LINK_NUMBERS + TURN_OFF) * S + thread)
            # Because of LEAST, an infinite error remains infinite even if the lengths are 0.
            shift_off = number_at(placed, (above * LINK_NUMBERS + SHIFT_OFF) * S + thread) + off * (lengths + LEAST)
            lengths = lengths + one_norm(b)
            turn_off = turn_off + off
            t = image(A, b, t)
            R = product(A, R)
        _put_link(placed, link, S, thread, R, t, turn_off + JOINT_TURN, shift_off + JOINT_SHIFT * lengths)
        link += 1


@inline
def _placed_center(rows, piece, first, R, t):
    """Position of the center of an ellipsoid, given by its first column in the piece's row."""
    return plus(apply(R, _three(rows, HOT * piece + first)), t)


@inline
def _put_bounds(bounds, body, S, s, center, wide, half, astray):
    """Write the bounds of a body, rounded up, and its position error."""
    at = body * BOUNDS * S + s
    put_number(bounds, at + X * S, center[0])
    put_number(bounds, at + Y * S, center[1])
    put_number(bounds, at + Z * S, center[2])
    put_number(bounds, at + WIDE * S, wide * UP)
    put_number(bounds, at + HALF_X * S, half[0] * UP)
    put_number(bounds, at + HALF_Y * S, half[1] * UP)
    put_number(bounds, at + HALF_Z * S, half[2] * UP)
    put_number(bounds, at + ASTRAY * S, astray)


@njit()
def place_body(thread, S, log_S, placed, bodies, balls, rows, bounds):
    """Write a ball and a box about one moving body at one configuration.

    Parameters
    ----------
    thread : int
        The body times S plus the configuration, where S is 2 ** log_S.
    placed : float32
        The links of the tile.
    bodies : int32, shape (moving bodies, BODY_INTEGERS)
        Link, first piece, and the piece after the last.
    balls : float32, shape (moving bodies, BALL_NUMBERS)
        Documented in `records.Problem`; radius and reach are rounded up.
    rows : float32, shape (pieces, HOT)
        Rows in the frames of their links.
    bounds : float32
        Receives the bounds of the tile.
    """
    body, s = thread >> log_S, thread & (S - 1)
    link = integer_at(bodies, BODY_INTEGERS * body + LINK_OF_BODY) * LINK_NUMBERS
    R, t = _rotation_at(placed, link, S, s), _vector_at(placed, link + LINK_AT, S, s)
    reach = number_at(balls, BALL_NUMBERS * body + BALL_REACH)
    turn_off, shift_off = number_at(placed, (link + TURN_OFF) * S + s), number_at(placed, (link + SHIFT_OFF) * S + s)
    astray = SINGLE_ROUNDOFF * UP * (turn_off * reach + shift_off)
    off = OFF * (one_norm(t) + reach) * UP + LEAST + astray
    center = plus(apply(R, _three(balls, BALL_NUMBERS * body)), t)
    wide = number_at(balls, BALL_NUMBERS * body + BALL_RADIUS) + off
    half = lane_of(0.0), lane_of(0.0), lane_of(0.0)
    piece, last = pieces_of(bodies, body)
    while piece < last:
        r = minus(_placed_center(rows, piece, OUTER_CENTER, R, t), center)
        shape = eight_at(rows, HOT * piece + OUTER_SHAPE)
        Q = rotated_shape(R, (shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]))
        slack = SHAPE_ERROR * SINGLE_ROUNDOFF * trace(Q)
        half = (
            _wider(absolute(r[0]) + sqrt(Q[0] + slack), half[0]),
            _wider(absolute(r[1]) + sqrt(Q[3] + slack), half[1]),
            _wider(absolute(r[2]) + sqrt(Q[5] + slack), half[2]),
        )
        piece += 1
    half = _narrower(UP * half[0] + off, wide), _narrower(UP * half[1] + off, wide), _narrower(UP * half[2] + off, wide)
    _put_bounds(bounds, body, S, s, center, wide, half, astray)


@inline
def _wider(x, y):
    """The larger width; NaN if either is NaN."""
    return maximum(x, y) + 0.0 * x


@inline
def _narrower(x, y):
    """The smaller width; NaN if either is NaN."""
    return minimum(x, y) + 0.0 * x


@inline
def bounds_of(bounds, row, step):
    """Read bounds whose numbers begin at `row` and are `step` apart."""
    return Bounds(
        (
            number_at(bounds, row + X * step), number_at(bounds, row + Y * step), number_at(bounds, row + Z * step)
        ),
        number_at(bounds, row + WIDE * step),
        (
            number_at(bounds, row + HALF_X * step), number_at(bounds, row + HALF_Y * step),
            number_at(bounds, row + HALF_Z * step),
        ),
    )  # fmt: skip


@njit()
def cull_pair(thread, S, log_S, total, moving, pairs, margins, bounds, standing, state, survivors, capacity):
    """List a pair of bodies at one configuration unless their bounds are apart by the margin.

    Parameters
    ----------
    thread : int
        The pair times S plus the configuration, where S is 2 ** log_S.
    total : int
        Number of requested configurations in the tile.
    moving : int
        Number of moving bodies.
    pairs : int32, shape (pairs, 2)
        Indices of two bodies; the first body moves.
    margins : float32, shape (pairs,)
        Margins, rounded up.
    bounds : float32
        Bounds of the moving bodies in the tile.
    standing : float32, shape (static bodies, BOUNDS)
    state : int32, shape (S,)
        State of each configuration. If the list has no room for a pair, the configuration is left to the CPU.
    survivors : int32, shape (1 + capacity,)
        Receives the number of listed threads, which may be more than `capacity`, followed by the threads' numbers.
    """
    p, s = thread >> log_S, thread & (S - 1)
    if s >= total:
        return
    one, other = integer_at(pairs, 2 * p), integer_at(pairs, 2 * p + 1)
    here = bounds_of(bounds, one * BOUNDS * S + s, S)
    if other < moving:
        there = bounds_of(bounds, other * BOUNDS * S + s, S)
    else:
        there = bounds_of(standing, (other - moving) * BOUNDS, 1)
    if near(here, there, number_at(margins, p), 1) == 0:
        return
    at = add_to(survivors, 0, 1)
    if at < capacity:
        put_integer(survivors, 1 + at, thread)
    else:
        raise_to(state, s, LEFT_OPEN)


@inline
def pieces_of(bodies, body):
    """First piece of a body, and the piece after its last."""
    row = BODY_INTEGERS * body
    return integer_at(bodies, row + FIRST_PIECE), integer_at(bodies, row + LAST_PIECE)


@inline
def _pose_of_body(placed, link, S, s):
    """Pose of a moving body."""
    R, t = _rotation_at(placed, link * LINK_NUMBERS, S, s), _vector_at(placed, link * LINK_NUMBERS + LINK_AT, S, s)
    return Pose(R, t, True)


@inline
def _identity():
    """Rotation and translation of a static body, whose numbers are in world coordinates."""
    on, off = lane_of(1.0), lane_of(0.0)
    return (on, off, off, off, on, off, off, off, on), (off, off, off)


@inline
def list_piece_pair(code, i, j, searches, capacity):
    """Append two pieces of a listed pair of bodies to the searches; return whether there was room."""
    # Stop counting when the list is full, because the number of piece pairs may be too large for an int32.
    if integer_at(searches, 0) >= capacity:
        return False
    at = add_to(searches, 0, 1)
    if at < capacity:
        put_integer(searches, 1 + 3 * at, code)
        put_integer(searches, 2 + 3 * at, i)
        put_integer(searches, 3 + 3 * at, j)
    return at < capacity


@njit()
def certify_survivor(
    thread, S, log_S, moving, bodies, pairs, margins, placed, bounds, rows, state, survivors, searches, capacity
):  # fmt: skip
    """Certify the ellipsoids of a listed pair of bodies, and list the pieces that they leave open.

    Parameters
    ----------
    thread : int
        Place in the list of survivors.
    moving, pairs, margins, placed, bounds, state, survivors, capacity
        Documented in `cull_pair` and `place_body`.
    bodies : int32, shape (bodies, BODY_INTEGERS)
        Documented in `place_body`; static bodies follow the moving bodies.
    rows : float32, shape (pieces, HOT)
        Rows of the pieces in the frames of their links, or in the world for static bodies.
    searches : int32, shape (1 + 3 capacity,)
        Receives the number of searches, followed by the survivor and two pieces for each search. If the list has no
        room for a search, the configuration is left to the CPU.
    """
    if thread >= min(integer_at(survivors, 0), capacity):
        return
    code = integer_at(survivors, 1 + thread)
    p, s = code >> log_S, code & (S - 1)
    if integer_at(state, s) == HIT:
        return
    one, other = integer_at(pairs, 2 * p), integer_at(pairs, 2 * p + 1)
    a = _pose_of_body(placed, integer_at(bodies, BODY_INTEGERS * one + LINK_OF_BODY), S, s)
    astray = number_at(bounds, (one * BOUNDS + ASTRAY) * S + s)
    R, t = _identity()
    b = Pose(R, t, True)
    if other < moving:
        b = _pose_of_body(placed, integer_at(bodies, BODY_INTEGERS * other + LINK_OF_BODY), S, s)
        astray = astray + number_at(bounds, (other * BOUNDS + ASTRAY) * S + s)
    more = astray * (UP / OFF)  # Adding `more` to the lengths raises the error allowed for positions by `astray`.
    i, last_a = pieces_of(bodies, one)
    first_b, last_b = pieces_of(bodies, other)
    pair_state = SO_FAR_FREE
    with_margin = holds(number_at(margins, p) > 0.0)
    if (last_a - i) * (last_b - first_b) > MOST_PIECE_PAIRS:
        pair_state, i = LEFT_OPEN, last_a
    while i < last_a:
        j = first_b
        while j < last_b and pair_state != HIT:
            tier = OPEN
            if not with_margin:  # With a margin, the near points must be computed from the best s, in double precision.
                tier = tier_of_one(a, rows + 4 * HOT * i, b, rows + 4 * HOT * j, more)
            if tier == BY_INNER:
                pair_state = HIT
            elif tier not in (BY_SPHERE, BY_OUTER) and not list_piece_pair(code, i, j, searches, capacity):
                pair_state = LEFT_OPEN
            j += 1
        i += 1
    if pair_state != SO_FAR_FREE:
        raise_to(state, s, pair_state)


class Cell(NamedTuple):
    """The data of a robot and its scene that searches and motions take: the number of moving bodies, and addresses.

    Attributes
    ----------
    moving, bodies, balls, pairs, margins, rows
        Documented in the functions above.
    cores, numbers, vertices
        Documented in `searches.core_at`.
    roles : int32, shape (pairs, ROLES)
        For each pair: the moving body, the body to whose frame planes are fixed, and the pair's row of `chain_start`.
    chain_start : int32, shape (chains + 1,)
        The joints between the bodies of chain k are rows chain_start[k] .. chain_start[k + 1] of `joints` and `levers`.
        The first chains lie between each moving body and the world.
    joints : int32, shape (n, CHAIN_INTEGERS)
    levers : float32, shape (n, CHAIN_NUMBERS)
        Multiplier, offset, and lever, rounded up.
    """

    moving: Any
    bodies: Any
    balls: Any
    pairs: Any
    margins: Any
    rows: Any
    cores: Any
    numbers: Any
    vertices: Any
    roles: Any
    chain_start: Any
    joints: Any
    levers: Any


@inline
def cell_at(table):
    """Read the record from a table of int64."""
    return Cell(
        word_at(table, 0), word_at(table, 1), word_at(table, 2), word_at(table, 3), word_at(table, 4),
        word_at(table, 5), word_at(table, 6), word_at(table, 7), word_at(table, 8), word_at(table, 9),
        word_at(table, 10), word_at(table, 11), word_at(table, 12),
    )  # fmt: skip


@inline
def pose_in(cell, placed, upper, lower, margin, S, s):
    """Pose of a moving body in the frame of another body, or in the world, for comparing distances with a margin.

    Returns
    -------
    R, t : tuple
    off : float
        Error of the body's points that is due to the kinematics, in metres (docs/certified.md, B63).
    """
    link = integer_at(cell.bodies, BODY_INTEGERS * upper + LINK_OF_BODY) * LINK_NUMBERS
    R, t = _rotation_at(placed, link, S, s), _vector_at(placed, link + LINK_AT, S, s)
    reach = number_at(cell.balls, BALL_NUMBERS * upper + BALL_REACH)
    off = number_at(placed, (link + TURN_OFF) * S + s) * reach + number_at(placed, (link + SHIFT_OFF) * S + s)
    if lower < cell.moving:
        link = integer_at(cell.bodies, BODY_INTEGERS * lower + LINK_OF_BODY) * LINK_NUMBERS
        P, d = _rotation_at(placed, link, S, s), _vector_at(placed, link + LINK_AT, S, s)
        turn_off, shift_off = (
            number_at(placed, (link + TURN_OFF) * S + s),
            number_at(placed, (link + SHIFT_OFF) * S + s),
        )
        off = off + (turn_off + COMPOSED) * (one_norm(minus(t, d)) + reach + margin) + shift_off
        R, t = relative(R, t, P, d)
    return R, t, SINGLE_ROUNDOFF * UP * off


@inline
def from_lower(cell, i, j, R, t):
    """Vector from the center of piece j to the center of piece i, which is at a pose in j's frame."""
    return minus(_placed_center(cell.rows, i, OUTER_CENTER, R, t), _three(cell.rows, HOT * j + OUTER_CENTER))


@njit()
def search_survivor(thread, S, log_S, table, placed, state, searches, capacity):
    """Search two listed pieces at one configuration, and raise the state of the configuration accordingly.

    Parameters
    ----------
    thread : int
        Place in the list of searches.
    table : int64
        See `cell_at`.
    placed, state, searches, capacity
        Documented in `certify_survivor`.
    """
    if thread >= min(integer_at(searches, 0), capacity):
        return
    code, i, j = (
        integer_at(searches, 3 * thread + 1), integer_at(searches, 3 * thread + 2), integer_at(searches, 3 * thread + 3)
    )  # fmt: skip
    p, s = code >> log_S, code & (S - 1)
    if integer_at(state, s) == HIT:
        return
    cell = cell_at(table)
    upper, lower = integer_at(cell.pairs, 2 * p), integer_at(cell.pairs, 2 * p + 1)
    margin = number_at(cell.margins, p)
    R, t, off = pose_in(cell, placed, upper, lower, margin, S, s)
    a, b = core_at(cell.cores, cell.numbers, cell.vertices, i), core_at(cell.cores, cell.numbers, cell.vertices, j)
    n = from_lower(cell, i, j, R, t)
    status = search(a, (R, t), (R, t), False, b, n, margin, off)
    if status != APART:
        raise_to(state, s, HIT if status == TOUCHING else LEFT_OPEN)


@njit()
def conclude(thread, first, state, dof, Q0, Q1, verdicts, left):
    """Write the verdict of configuration or motion `first + thread`, and list it if the CPU has to settle it.

    Parameters
    ----------
    thread : int
    Q0, Q1 : float32, shape (n, dof)
        Ends of the motion. If a number is not finite, the CPU refuses the motion, even if the number does not matter.
    """
    outcome = integer_at(state, thread)
    k = 0
    while k < dof:
        at = thread * dof + k
        if not holds((absolute(number_at(Q0, at)) < np.inf) & (absolute(number_at(Q1, at)) < np.inf)):
            outcome = LEFT_OPEN
        k += 1
    put_byte(verdicts, first + thread, COLLIDING if outcome == HIT else (AMBIGUOUS if outcome == LEFT_OPEN else FREE))
    if outcome == LEFT_OPEN:
        append(left, first + thread)
