"""Follow a straight line with a link, by joint motions that are proven to stay within a tolerance of the line.

The chain of joints is described in `reach`. Eight configurations on the line are sought at a time, at equal steps. The
deviations of the eight motions that lead to these configurations are bounded (B55 of docs/certified.md). The motions
before the first failure are kept. The bounds also determine the next step.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import FOLLOWED, HALF_TURN, STOPPED, TILTED, TOO_FAR
from loewner._kernels.columns import (
    ACROSS,
    ALONG,
    AXIS,
    BALL,
    COLUMN_OF_LINK,
    FLOATING,
    HELD,
    HOW,
    KIND_OF_LINK,
    LEAST,
    MOST,
    MULTIPLIER,
    OFFSET,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    ROTATION,
    TRANSLATION,
)
from loewner._kernels.elementary import arc_tangent
from loewner._kernels.linalg3 import apply, cross, dot, minus, plus, product, scaled
from loewner._kernels.pieces.pack import kept_axis_of
from loewner._kernels.robots.kinematics import by_quaternion, nine, triple_of, turned_by
from loewner._kernels.robots.reach import FAULTS, REACHED, deviation_of, follow, move
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.simd.vectors import (
    ALL,
    LANES,
    absolute,
    broadcast,
    load,
    maximum,
    minimum,
    movemask,
    sqrt,
    store,
)
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# Bound on the rounding error of a deviation, in units of n (1 + D² + θ²) q for rotations, and of L times as much for
# positions; certified.md explains the letters.
LINE_ROUNDINGS = 256.0 * UNIT_ROUNDOFF  # certified.md B55

SPARE = 1e-9  # Relative allowance for the rounding of third derivatives and of lengths, see docs/certified.md.

MIDDLE = 0.125  # Largest value of s (1 - s) / 2. A second derivative times MIDDLE bounds the distance from the chord.

# Maximum number of Newton steps to a configuration; from a good first guess, three steps are enough.
STEPS = 32

# An axis counts as brought back if it deviates by at most (1 + NEARLY) times the tolerance.
NEARLY = 0.01

# The next motions are expected to use the fraction SHARE of the tolerance. From one attempt to the next, motions may
# become longer by at most the factor GROWTH, and shorter by at most the factor SHRINKING.
SHARE, GROWTH, SHRINKING = 0.85, 4.0, 64.0

# Length of the shortest motion, as a fraction of the line (LEAST_MOTION), and length of the longest line [m] (LONGEST),
# whose shortest motions are about 0.15 m long.
LEAST_MOTION, LONGEST = 2.0**-16, 1e4

# Largest angle [rad] by which a line of poses may turn. At half a turn, rounding would decide which way around is
# shorter.
LARGEST_ANGLE = np.pi - 1e-6


class Line(NamedTuple):
    """A line of poses: the position moves along a straight line, and the rotation turns about a fixed axis.

    At the fraction u, the position is `start` + u `way`, and the rotation is `rotation` + sin(u `angle`) `sine` +
    (1 - cos(u `angle`)) `cosine`.
    """

    start: Any
    way: Any
    rotation: Any
    angle: Any
    sine: Any
    cosine: Any


class Wanted(NamedTuple):
    """Tolerances of the position [m], of rotation matrices in the Frobenius norm, and of the cosine of a kept axis."""

    position: Any
    rotation: Any
    cosine: Any
    axis: Any  # Axis of the link.
    direction: Any  # Direction in the world.


class Moved(NamedTuple):
    """A point of the chain at eight moving configurations, with derivatives with respect to the motion's fraction."""

    t: Any
    turn: Any  # Angular velocity.
    bend: Any  # Derivative of the angular velocity.
    pull: Any  # Second derivative of the position.
    third: Any  # Bound on the third derivative of the position over the whole motion.
    angle: Any  # Sum of the turns of all joints.
    length: Any  # Sum of all lengths.


class Strays(NamedTuple):
    """Bounds on eight motions: largest deviations, the least cosine, and the share of the tolerance that each takes.

    `bends` is the share that is proportional to the square of a motion's length, and `twists` the share that is
    proportional to its cube.
    """

    position: Any
    rotation: Any
    cosine: Any
    bends: Any
    twists: Any


@inline
def _carried(m, r, size):
    """Advance the point by a vector r that is fixed in the current frame and at most `size` long."""
    pull = plus(plus(m.pull, cross(m.bend, r)), cross(m.turn, cross(m.turn, r)))
    third = m.third + size * (m.angle * m.angle * m.angle)
    return Moved(plus(m.t, r), m.turn, m.bend, pull, third, m.angle, m.length + size)


@inline
def _slid(m, direction, value, rate, size):
    """Advance the point by a slide."""
    m = _carried(m, scaled(value, direction), size)
    pull = plus(m.pull, scaled(2.0 * rate, cross(m.turn, direction)))
    third = m.third + 3.0 * absolute(rate) * (m.angle * m.angle)
    return Moved(m.t, m.turn, m.bend, pull, third, m.angle, m.length)


@inline
def _swung(m, axis, rate):
    """Advance the point by a turn."""
    b = scaled(rate, axis)
    bend = plus(m.bend, cross(m.turn, b))
    return Moved(m.t, plus(m.turn, b), bend, m.pull, m.third, m.angle + absolute(rate), m.length)


@apart
def _followed(chain, constants, q, d):
    """Rotation and motion of the link at eight configurations q that move at the rates d, both by columns."""
    zero, one = broadcast(0.0), broadcast(1.0)
    nothing = zero, zero, zero
    R = one, zero, zero, zero, one, zero, zero, zero, one
    m = Moved(nothing, nothing, nothing, nothing, zero, zero, zero)
    for link in range(len(chain)):
        what, at = chain[link, KIND_OF_LINK], chain[link, COLUMN_OF_LINK] * LANES
        multiplier, offset = constants[link, MULTIPLIER], constants[link, OFFSET]
        r = triple_of(constants, link, TRANSLATION)
        m = _carried(m, apply(R, r), sqrt(dot(r, r)))
        if what == REVOLUTE:
            R = product(R, turned_by(constants, link, load(q, at) * multiplier + offset))
            m = _swung(m, apply(R, triple_of(constants, link, AXIS)), load(d, at) * multiplier)
        elif what == PRISMATIC:
            value, rate = load(q, at) * multiplier, load(d, at) * multiplier
            size = absolute(value) + 0.5 * absolute(rate) + abs(offset)
            m = _slid(m, apply(R, triple_of(constants, link, ACROSS)), value + offset, rate, size)
            R = product(R, nine(constants, link, ROTATION))
        elif what == PLANAR:
            x, dx, y, dy = load(q, at), load(d, at), load(q, at + LANES), load(d, at + LANES)
            m = _slid(m, apply(R, triple_of(constants, link, ACROSS)), x, dx, absolute(x) + 0.5 * absolute(dx))
            m = _slid(m, apply(R, triple_of(constants, link, ALONG)), y, dy, absolute(y) + 0.5 * absolute(dy))
            R = product(R, turned_by(constants, link, load(q, at + 2 * LANES)))
            m = _swung(m, apply(R, triple_of(constants, link, AXIS)), load(d, at + 2 * LANES))
        else:
            R = product(R, nine(constants, link, ROTATION))
            if what == FLOATING:
                r = load(q, at), load(q, at + LANES), load(q, at + 2 * LANES)
                m = _carried(m, apply(R, r), sqrt(dot(r, r)))
                at += 3 * LANES
            if what in (FLOATING, BALL):
                w, x, y, z = load(q, at), load(q, at + LANES), load(q, at + 2 * LANES), load(q, at + 3 * LANES)
                R = product(R, by_quaternion(w, x, y, z))
    return R, m


@inline
def _less(M, N):
    """Difference M - N of two matrices."""
    return minus(M[:3], N[:3]) + minus(M[3:6], N[3:6]) + minus(M[6:], N[6:])


@inline
def _times(t, M):
    """Product t M of a number and a matrix."""
    return scaled(t, M[:3]) + scaled(t, M[3:6]) + scaled(t, M[6:])


@inline
def _norm(M):
    """Frobenius norm of a matrix."""
    return sqrt(dot(M[:3], M[:3]) + dot(M[3:6], M[3:6]) + dot(M[6:], M[6:]))


@inline
def line_between(R0, t0, R1, t1):
    """Line between two poses of floats, by the shorter way around."""
    rows, images = (R0[:3], R0[3:6], R0[6:]), (R1[:3], R1[3:6], R1[6:])
    xx, yy, zz = dot(images[0], rows[0]), dot(images[1], rows[1]), dot(images[2], rows[2])
    xy, yx = dot(images[0], rows[1]), dot(images[1], rows[0])
    xz, zx = dot(images[0], rows[2]), dot(images[2], rows[0])
    yz, zy = dot(images[1], rows[2]), dot(images[2], rows[1])
    axis = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
    sine, cosine = np.sqrt(dot(axis, axis)), 0.5 * (xx + yy + zz - 1.0)
    angle = arc_tangent(sine, cosine)
    if cosine < 0.0:  # Near half a turn, `axis` is short, and a column of E + Eᵀ - 2 cos(angle) I is long.
        if xx >= yy and xx >= zz:
            column, sign = (2.0 * (xx - cosine), xy + yx, xz + zx), axis[0]
        elif yy >= zz:
            column, sign = (xy + yx, 2.0 * (yy - cosine), yz + zy), axis[1]
        else:
            column, sign = (xz + zx, yz + zy, 2.0 * (zz - cosine)), axis[2]
        axis = scaled(1.0 if sign >= 0.0 else -1.0, column)
    length = np.sqrt(dot(axis, axis))
    x, y, z = scaled(1.0 / length if length > 0.0 else 0.0, axis)
    skew = 0.0, -z, y, z, 0.0, -x, -y, x, 0.0
    turned = product(skew, R0)
    return Line(t0, minus(t1, t0), R0, angle, turned, product(skew, turned))


@inline
def _rotation_at(line, u):
    """The line's rotation at eight fractions."""
    half_sine, half_cosine = sine_cosine(0.5 * line.angle * u)
    s, c = 2.0 * half_sine * half_cosine, 2.0 * half_sine * half_sine
    a, b, e = line.rotation, line.sine, line.cosine
    return (
        a[0] + s * b[0] + c * e[0], a[1] + s * b[1] + c * e[1], a[2] + s * b[2] + c * e[2],
        a[3] + s * b[3] + c * e[3], a[4] + s * b[4] + c * e[4], a[5] + s * b[5] + c * e[5],
        a[6] + s * b[6] + c * e[6], a[7] + s * b[7] + c * e[7], a[8] + s * b[8] + c * e[8],
    )  # fmt: skip


@inline
def _position_at(line, u):
    """The line's position at eight fractions."""
    p, way = line.start, line.way
    return p[0] + u * way[0], p[1] + u * way[1], p[2] + u * way[2]


@inline
def _bent(R, m):
    """The second derivative of the rotation, ([bend] + [turn]²) R."""
    a, b = m.bend, m.turn
    square = dot(b, b)
    return product(
        (
            b[0] * b[0] - square, b[0] * b[1] - a[2], b[0] * b[2] + a[1],
            b[1] * b[0] + a[2], b[1] * b[1] - square, b[1] * b[2] - a[0],
            b[2] * b[0] - a[1], b[2] * b[1] + a[0], b[2] * b[2] - square,
        ),
        R,
    )  # fmt: skip


@inline
def _rounding(chain, constants, q, d, squares):
    """Bound the rounding of rotations (B55); `squares` is one plus the sum of squared turns."""
    largest = broadcast(1.0)
    for column in range(q.size // LANES):
        largest = maximum(largest, absolute(load(q, column * LANES)) + 0.5 * absolute(load(d, column * LANES)))
    factor, offset = 1.0, 0.0
    for link in range(len(chain)):
        factor, offset = max(factor, abs(constants[link, MULTIPLIER])), max(offset, abs(constants[link, OFFSET]))
    return LINE_ROUNDINGS * (len(chain) + 1.0) * squares * (largest * factor + offset)


@inline
def gaps_of(chain, constants, line, wanted, u, q, still):
    """Deviations of the link's position and rotation from the line at eight configurations, and the axis's cosine.

    Parameters
    ----------
    chain, constants : ndarray
    line : Line
    wanted : Wanted
    u : vector
        Fractions of the line.
    q, still : ndarray
        Configurations by columns, and an array of zeros with the same shape.
    """
    R, m = _followed(chain, constants, q, still)
    off = minus(m.t, _position_at(line, u))
    return sqrt(dot(off, off)), _norm(_less(R, _rotation_at(line, u))), dot(wanted.direction, apply(R, wanted.axis))


@inline
def strays_of(chain, constants, line, wanted, before, after, u0, u1, q, d):
    """Bound how far the link strays from the line on eight motions; docs/certified.md derives the bounds.

    Parameters
    ----------
    chain, constants : ndarray
    line : Line
    wanted : Wanted
    before, after : tuple of 3 vector
        Results of `gaps_of` at the beginning and at the end of the motions.
    u0, u1 : vector
        Fractions of the line at the beginning and at the end of the motions.
    q, d : ndarray
        Configurations in the middle of the motions, and differences between their ends, by columns.

    Returns
    -------
    Strays
    """
    R, m = _followed(chain, constants, q, d)
    bent = _bent(R, m)
    share, L = line.angle * (u1 - u0), _rotation_at(line, 0.5 * (u0 + u1))
    bows = _times(share * share, _less(_less(line.rotation, _times(-1.0, line.cosine)), L))
    cube = m.angle * m.angle * m.angle
    rounding = _rounding(chain, constants, q, d, 1.0 + m.angle * m.angle + share * share)
    length = (1.0 + SPARE) * m.length
    bend, twist = MIDDLE * sqrt(dot(m.pull, m.pull)), 0.5 * (1.0 + SPARE) * MIDDLE * m.third
    turn_bend = MIDDLE * _norm(_less(bent, bows))
    turn_twist = 0.5 * (1.0 + SPARE) * MIDDLE * 1.4142135623730952 * (cube + share * share * share)
    tilt = MIDDLE * absolute(dot(wanted.direction, apply(bent, wanted.axis)))
    tilt_twist = 0.5 * (1.0 + SPARE) * MIDDLE * cube
    least = minimum(before[2], after[2])
    room = SHARE * maximum(least - wanted.cosine, 1e-300)
    of_position, of_rotation = SHARE * wanted.position, SHARE * wanted.rotation
    return Strays(
        maximum(before[0], after[0]) + bend + twist + rounding * length,
        maximum(before[1], after[1]) + turn_bend + turn_twist + rounding,
        least - tilt - tilt_twist - rounding,
        maximum(maximum(bend / of_position, turn_bend / of_rotation), tilt / room),
        maximum(maximum(twist / of_position, turn_twist / of_rotation), tilt_twist / room),
    )


@inline
def _approached(chain, constants, ranges, line, u, q, work):
    """Bring eight configurations to the line at the fractions u; return a mask of the lanes that arrived."""
    twists, matrix, exact = work
    R, p = _rotation_at(line, u), _position_at(line, u)
    base = (
        (R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]),
        (
            -(R[0] * p[0] + R[3] * p[1] + R[6] * p[2]),
            -(R[1] * p[0] + R[4] * p[1] + R[7] * p[2]),
            -(R[2] * p[0] + R[5] * p[1] + R[8] * p[2]),
        ),
    )
    accept = REACHED * (1.0 + absolute(p[0]) + absolute(p[1]) + absolute(p[2]))
    arrived = 0
    for _ in range(STEPS):
        R, t = follow(chain, constants, base, q, twists)
        deviation = deviation_of(R, t, exact)
        f = deviation[0]
        shift, turn = f[0] * f[0] + f[1] * f[1] + f[2] * f[2], f[3] * f[3] + f[4] * f[4] + f[5] * f[5]
        arrived = movemask((shift <= accept * accept) & (turn <= REACHED * REACHED))
        if arrived == ALL:
            break
        move(ranges, t, deviation, shift + turn, q, twists, matrix)
    return arrived


@inline
def _with_room(rows):
    """Copy the rows to an array with twice as many rows."""
    wide = np.empty((2 * len(rows), rows.shape[1]))
    for row in range(len(rows)):
        for column in range(rows.shape[1]):
            wide[row, column] = rows[row, column]
    return wide


@njit()
def follow_line(chain, constants, ranges, start, target, wanted):
    """Follow the line from the pose of the link at a configuration to a target pose.

    Parameters
    ----------
    chain, constants, ranges : ndarray
        Documented in `reach`; quaternions are held.
    start : ndarray, shape (K,)
    target : ndarray, shape (4, 4)
    wanted : ndarray, shape (9,)
        Tolerances of the position and the rotation, the least cosine, the axis and its direction, see `Wanted`.

    Returns
    -------
    int
        FOLLOWED if the line was followed; HALF_TURN or TOO_FAR if it cannot be followed. If the motion to the last row
        is not within the tolerances, TILTED if only the cosine is too small, otherwise STOPPED.
    ndarray, shape (n, 2 + K)
        For each configuration: the fraction of the line, the cosine, and the values.
    """
    values = ranges.shape[1]
    work = np.empty(values * FAULTS * LANES), np.empty(21 * LANES), np.zeros(FAULTS)
    q, middle, d, still = (
        np.empty(values * LANES), np.empty(values * LANES), np.empty(values * LANES), np.zeros(values * LANES)
    )  # fmt: skip
    # Fractions, deviations and cosines at nine configurations: the last one kept, and eight new ones.
    u, off, turned, cosines = np.zeros(LANES + 1), np.zeros(LANES + 1), np.zeros(LANES + 1), np.zeros(LANES + 1)
    bounds, rows = np.empty(3 * LANES), np.empty((64, 2 + values))
    need = Wanted(
        wanted[0], wanted[1], wanted[2], (wanted[3], wanted[4], wanted[5]), (wanted[6], wanted[7], wanted[8])
    )  # fmt: skip
    for column in range(values):
        rows[0, 2 + column] = start[column]
        store(q, column * LANES, broadcast(start[column]))
    R, m = _followed(chain, constants, q, still)
    for k in range(9):
        store(bounds, 0, R[k])
        turned[k] = bounds[0]
    for k in range(3):
        store(bounds, 0, m.t[k])
        off[k] = bounds[0]
    T = target
    line = line_between(
        (turned[0], turned[1], turned[2], turned[3], turned[4], turned[5], turned[6], turned[7], turned[8]),
        (off[0], off[1], off[2]),
        (T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2], T[2, 0], T[2, 1], T[2, 2]),
        (T[0, 3], T[1, 3], T[2, 3]),
    )
    store(cosines, 0, gaps_of(chain, constants, line, need, broadcast(0.0), q, still)[2])
    rows[0, 0], rows[0, 1] = 0.0, cosines[0]
    off[0] = turned[0] = 0.0
    if line.angle > LARGEST_ANGLE:
        return HALF_TURN, rows[:1]
    if not dot(line.way, line.way) <= LONGEST * LONGEST:
        return TOO_FAR, rows[:1]
    count, step = 1, 1.0
    while True:
        here = rows[count - 1, 0]
        left = np.ceil((1.0 - here) / step)
        if left <= LANES:
            step = (1.0 - here) / left
        u[0] = here
        for lane in range(LANES):
            u[lane + 1] = 1.0 if lane + 1.0 >= left else here + (lane + 1.0) * step
        for column in range(values):
            value, rate = rows[count - 1, 2 + column], 0.0
            if count > 1 and ranges[HOW, column] != HELD:
                rate = (value - rows[count - 2, 2 + column]) / (here - rows[count - 2, 0])
            for lane in range(LANES):
                guess = value + (u[lane + 1] - here) * rate
                q[column * LANES + lane] = min(max(guess, ranges[LEAST, column]), ranges[MOST, column])
        arrived = _approached(chain, constants, ranges, line, load(u, 1), q, work)
        for column in range(values):
            last = rows[count - 1, 2 + column]
            for lane in range(LANES):
                k, value = column * LANES + lane, q[column * LANES + lane]
                middle[k], d[k], last = 0.5 * (last + value), value - last, value
        after = gaps_of(chain, constants, line, need, load(u, 1), q, still)
        store(off, 1, after[0])
        store(turned, 1, after[1])
        store(cosines, 1, after[2])
        before = load(off, 0), load(turned, 0), load(cosines, 0)
        strays = strays_of(chain, constants, line, need, before, after, load(u, 0), load(u, 1), middle, d)
        near = movemask((strays.position <= need.position) & (strays.rotation <= need.rotation))
        kept = movemask(strays.cosine >= need.cosine)
        store(bounds, 0, strays.bends)
        store(bounds, LANES, strays.twists)
        if count + LANES > len(rows):
            rows = _with_room(rows)
        good, longest = 0, 1.0 / GROWTH
        for lane in range(LANES):
            rows[count, 0], rows[count, 1] = u[lane + 1], cosines[lane + 1]
            for column in range(values):
                rows[count, 2 + column] = q[column * LANES + lane]
            if arrived >> lane & 1 == 0:
                break
            wish = 1.0 + np.sqrt(bounds[lane])
            for _ in range(4):  # This iteration solves wish² = bends + twists / wish.
                wish = np.sqrt(bounds[lane] + bounds[LANES + lane] / wish + 1e-9)
            longest = max(longest, min(wish, SHRINKING))
            if near & kept & 1 << lane == 0:
                break
            count += 1
            good += 1
            if u[lane + 1] == 1.0:
                return FOLLOWED, rows[:count]
        off[0], turned[0], cosines[0] = off[good], turned[good], cosines[good]
        if good == 0:
            if step < LEAST_MOTION:
                return TILTED if near & ~kept & 1 else STOPPED, rows[: count + 1]
            longest = max(longest, 2.0 if arrived & 1 else 4.0)
        step /= longest


@inline
def least_cosine(chain, constants, axis, direction, q, d):
    """Lower bound on the cosine between a kept axis and its direction, on eight motions given as in `strays_of`.

    The bound is the Taylor series about the middle, with a bound on its remainder.
    """
    R, m = _followed(chain, constants, q, d)
    a, cube = apply(R, axis), m.angle * m.angle * m.angle
    slope, bend = dot(direction, cross(m.turn, a)), dot(direction, apply(_bent(R, m), axis))
    fall = 0.5 * absolute(slope) + 0.125 * absolute(bend) + (1.0 + SPARE) * cube / 48.0
    return dot(direction, a) - fall - _rounding(chain, constants, q, d, 1.0 + m.angle * m.angle)


@njit()
def keeps_axis(handle, ends):
    """Return whether a motion provably keeps an axis, by bounds on eight equal parts of the motion.

    Parameters
    ----------
    handle : int
        Handle of a `records.KeptAxis`.
    ends : ndarray, shape (2, dof)
    """
    kept = kept_axis_of(handle)
    values, n = kept.columns.size, kept.numbers
    q, d = np.empty(values * LANES), np.empty(values * LANES)
    for column in range(values):
        value = ends[0, kept.columns[column]]
        part = (ends[1, kept.columns[column]] - value) / LANES
        for lane in range(LANES):
            q[column * LANES + lane], d[column * LANES + lane] = value + (lane + 0.5) * part, part
    axis, direction = (n[0, 1], n[0, 2], n[0, 3]), (n[0, 4], n[0, 5], n[0, 6])
    return movemask(least_cosine(kept.chain, kept.constants, axis, direction, q, d) >= n[0, 0]) == ALL


@njit()
def bring_back(handle, row):
    """Move a configuration, shape (dof,), until its axis is near the direction; return whether this succeeded."""
    kept = kept_axis_of(handle)
    values = kept.columns.size
    twists, matrix, tolerance = np.empty(values * FAULTS * LANES), np.empty(21 * LANES), np.empty(FAULTS)
    q, nothing = np.empty(values * LANES), (broadcast(0.0), broadcast(0.0), broadcast(0.0))
    for k in range(FAULTS):
        tolerance[k] = kept.numbers[0, 7] if k in (3, 4) else np.inf
    for column in range(values):
        store(q, column * LANES, broadcast(row[kept.columns[column]]))
    for _ in range(STEPS):
        R, t = follow(kept.chain, kept.constants, (nine(kept.numbers, 2, 0), nothing), q, twists)
        deviation = deviation_of(product(R, nine(kept.numbers, 1, 0)), t, tolerance)
        f = deviation[0]
        error = f[3] * f[3] + f[4] * f[4]
        if movemask(error <= (NEARLY * tolerance[3]) * (NEARLY * tolerance[3])) == ALL:
            for column in range(values):
                row[kept.columns[column]] = q[column * LANES]
            return True
        move(kept.ranges, t, deviation, error, q, twists, matrix)
    return False


@njit()
def keep_axis(handle, Q0, Q1, kept):
    """Write to `kept` which motions between rows of Q0 and Q1 provably keep an axis."""
    ends = np.empty((2, Q0.shape[1]))
    for row in range(len(Q0)):
        for column in range(Q0.shape[1]):
            ends[0, column], ends[1, column] = Q0[row, column], Q1[row, column]
        kept[row] = keeps_axis(handle, ends)
