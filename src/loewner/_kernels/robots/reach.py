"""Inverse kinematics: find configurations at which a link has a given pose, by damped Newton steps from eight seeds.

The kernel takes the chain of joints from the root to the link as rows of two tables:

chain : ndarray of int64, shape (L, 3)
    MOVES_OF_LINK, 1 if the joint may move; KIND_OF_LINK, its kind; and COLUMN_OF_LINK, the first of the joint's values
    among the K values that the chain reads.
constants : ndarray, shape (L, CHAIN_CONSTANTS)
    The constants of `kinematics`, then MULTIPLIER, OFFSET, and AXIS, the axis of a turning joint in the frame that it
    moves.
ranges : ndarray, shape (3, K)
    LEAST and MOST are the limits, and HOW describes how a value moves. HELD keeps the value of the start. WRAPS is an
    angle that is the same after a whole turn. FAR is a length without limits, whose seeds are multiples of the distance
    from the start to the target. TURNS is the first entry of a quaternion, and REST its other entries. All other values
    are PLAIN.

All quantities are in the frame of the target. The link's deviation has six coordinates: three of its origin, then three
of its rotation E = S Z. Here, Z is a turn about the z axis (spin), and S is the smallest turn that takes the z axis to
its image c (tilt). With half angles, these coordinates are algebraic: the tilt is (-c_y, c_x) √(2 / (1 + c_z)), of
length 2 sin(tilt / 2), and the spin is 2 sin(spin / 2). If the link turns with ω, the image c moves with ω × c, and the
spin grows with ω · (z + c) / (1 + c_z), because S turns perpendicular to z + c. A coordinate counts by its excess over
the tolerance; within the tolerance, it does not count.

References
----------
Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method (IEEE T-RO 27, 2011): the squared
damping is proportional to the squared error, so the last steps are Newton's.
"""

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.columns import (
    ACROSS,
    ALONG,
    AXIS,
    BALL,
    COLUMN_OF_LINK,
    FAR,
    FLOATING,
    HELD,
    HOW,
    KIND_OF_LINK,
    LEAST,
    MOST,
    MOVES_OF_LINK,
    MULTIPLIER,
    OFFSET,
    PLANAR,
    PRISMATIC,
    REST,
    REVOLUTE,
    ROTATION,
    TRANSLATION,
    TURNS,
    WRAPS,
)
from loewner._kernels.linalg3 import along, apply, cross, dot, image, plus, product, scaled
from loewner._kernels.robots.kinematics import by_quaternion, nine, triple_of, turned_by
from loewner._kernels.simd.vectors import (
    ALL,
    LANES,
    absolute,
    broadcast,
    load,
    maximum,
    minimum,
    movemask,
    next_lane,
    select,
    sqrt,
    store,
)

# Largest error of a link that has reached its target: REACHED [rad] for its angle, and REACHED (1 + d) [m] for its
# position, where d is the sum of the absolute values of the target's coordinates. Rounding errors are far smaller.
REACHED = 1e-10

# The squared damping is DAMPING times the squared error, plus LEAST_DAMPING. Values of DAMPING from 0.01 to 0.1 worked
# well for five arms.
DAMPING, LEAST_DAMPING = 0.02, 1e-24

LONGEST = 1.0  # Largest turn of a joint [rad], or slide of a joint with limits [m], in one step.

# PATIENCE is the number of steps between two checks of a seed. A seed is abandoned unless its squared error is less
# than GAIN times its squared error at the previous check.
PATIENCE, GAIN = 6, 0.7

# Two solutions count as the same if their difference in each value is less than this [rad or m].
SAME = 1e-4

FAULTS = 6  # Number of coordinates of a link's deviation from its target.
TWO_PI = 2.0 * np.pi


@inline
def _add_twist(twists, column, turn, shift):
    """Add a motion of the link to the twist of a value: its angular velocity, and its velocity at the origin."""
    at = column * (FAULTS * LANES)
    for r in range(3):
        store(twists, at + r * LANES, load(twists, at + r * LANES) + shift[r])
        store(twists, at + (3 + r) * LANES, load(twists, at + (3 + r) * LANES) + turn[r])


@apart
def follow(chain, constants, base, q, twists):
    """Pose of the link at eight configurations in the frame of the target, and twists of the moving values."""
    nothing = broadcast(0.0), broadcast(0.0), broadcast(0.0)
    R, t = base
    for k in range(twists.size // LANES):
        store(twists, k * LANES, broadcast(0.0))
    for link in range(len(chain)):
        what, moves, column = chain[link, KIND_OF_LINK], chain[link, MOVES_OF_LINK] == 1, chain[link, COLUMN_OF_LINK]
        at, multiplier = column * LANES, constants[link, MULTIPLIER]
        t = image(R, t, triple_of(constants, link, TRANSLATION))
        if what == REVOLUTE:
            R = product(R, turned_by(constants, link, load(q, at) * multiplier + constants[link, OFFSET]))
            if moves:
                turn = scaled(multiplier, apply(R, triple_of(constants, link, AXIS)))
                _add_twist(twists, column, turn, cross(t, turn))
        elif what == PRISMATIC:
            slide = apply(R, triple_of(constants, link, ACROSS))
            t = along(t, load(q, at) * multiplier + constants[link, OFFSET], slide)
            R = product(R, nine(constants, link, ROTATION))
            if moves:
                _add_twist(twists, column, nothing, scaled(multiplier, slide))
        elif what == PLANAR:
            x = apply(R, triple_of(constants, link, ACROSS))
            y = apply(R, triple_of(constants, link, ALONG))
            t = along(along(t, load(q, at), x), load(q, at + LANES), y)
            R = product(R, turned_by(constants, link, load(q, at + 2 * LANES)))
            if moves:
                turn = apply(R, triple_of(constants, link, AXIS))
                _add_twist(twists, column, nothing, x)
                _add_twist(twists, column + 1, nothing, y)
                _add_twist(twists, column + 2, turn, cross(t, turn))
        elif what in (FLOATING, BALL):
            R = product(R, nine(constants, link, ROTATION))
            if what == FLOATING:
                t = image(R, t, (load(q, at), load(q, at + LANES), load(q, at + 2 * LANES)))
                if moves:
                    _add_twist(twists, column, nothing, (R[0], R[3], R[6]))
                    _add_twist(twists, column + 1, nothing, (R[1], R[4], R[7]))
                    _add_twist(twists, column + 2, nothing, (R[2], R[5], R[8]))
                at, column = at + 3 * LANES, column + 3
            # Here, a quaternion counts as three values: turns about the axes of the joint's frame before the quaternion
            # is applied.
            if moves:
                x, y, z = (R[0], R[3], R[6]), (R[1], R[4], R[7]), (R[2], R[5], R[8])
                _add_twist(twists, column, x, cross(t, x))
                _add_twist(twists, column + 1, y, cross(t, y))
                _add_twist(twists, column + 2, z, cross(t, z))
            turn = by_quaternion(load(q, at), load(q, at + LANES), load(q, at + 2 * LANES), load(q, at + 3 * LANES))
            R = product(R, turn)
        else:
            R = product(R, nine(constants, link, ROTATION))
    return R, t


@inline
def _fault(x, tolerance):
    """Excess of a coordinate over its tolerance, and 1 if the coordinate counts; NaN counts."""
    within = absolute(x) < tolerance
    beyond = x - select(x > 0.0, broadcast(tolerance), broadcast(-tolerance))
    return select(within, 0.0, beyond), select(within, broadcast(0.0), broadcast(1.0))


@inline
def deviation_of(R, t, tolerance):
    """Deviations of eight poses from the target: six coordinates, which of them count, and rows that turn twists."""
    one = broadcast(1.0)
    x, y, z = R[2], R[5], R[8]
    opposite = 1.0 + z < 1e-6
    height = maximum(1.0 + z, 1e-6)
    g = sqrt(2.0 / height)
    k = 0.5 * g / height
    # If the link's z axis is opposite to the target's z axis, all turns that align the two axes are equally short.
    first, second = select(opposite, 2.0, -(y * g)), x * g
    cosine, sine = (R[0] + R[4]) / height, (R[3] - R[1]) / height
    half = maximum(0.5 + 0.5 * cosine, 1e-12)
    spin = select(cosine < -1.0 + 1e-12, broadcast(2.0), sine / sqrt(half))
    rate = sqrt(half) / height
    rows = (
        (g * z + k * y * y, -(k * x * y), -(g * x)),
        (-(k * x * y), g * z + k * x * x, -(g * y)),
        (rate * x, rate * y, rate * (one + z)),
    )
    f0, c0 = _fault(t[0], tolerance[0])
    f1, c1 = _fault(t[1], tolerance[1])
    f2, c2 = _fault(t[2], tolerance[2])
    f3, c3 = _fault(first, tolerance[3])
    f4, c4 = _fault(second, tolerance[4])
    f5, c5 = _fault(spin, tolerance[5])
    return (f0, f1, f2, f3, f4, f5), (c0, c1, c2), (scaled(c3, rows[0]), scaled(c4, rows[1]), scaled(c5, rows[2]))


@inline
def _to_rows(ranges, t, fault, counts, rows, q, twists):
    """Turn twists into derivatives of the six coordinates; a value that is pressed against its limit does not move."""
    for column in range(ranges.shape[1]):
        at = column * (FAULTS * LANES)
        turn = load(twists, at + 3 * LANES), load(twists, at + 4 * LANES), load(twists, at + 5 * LANES)
        shift = plus((load(twists, at), load(twists, at + LANES), load(twists, at + 2 * LANES)), cross(turn, t))
        J = (
            counts[0] * shift[0], counts[1] * shift[1], counts[2] * shift[2],
            dot(rows[0], turn), dot(rows[1], turn), dot(rows[2], turn),
        )  # fmt: skip
        value = load(q, column * LANES)
        slope = (
            J[0] * fault[0] + J[1] * fault[1] + J[2] * fault[2] + J[3] * fault[3] + J[4] * fault[4] + J[5] * fault[5]
        )
        stuck = ((value >= ranges[MOST, column]) & (slope < 0.0)) | ((value <= ranges[LEAST, column]) & (slope > 0.0))
        for r in range(FAULTS):
            store(twists, at + r * LANES, select(stuck, 0.0, J[r]))


@inline
def _factor_entry(matrix, r, c):
    """Offset of an entry in a lower triangle that is stored by rows."""
    return (r * (r + 1) // 2 + c) * LANES


@inline
def _solved(columns, twists, fault, damping, matrix):
    """Solve (J Jᵀ + damping) y = -fault by L D Lᵀ."""
    for r in range(FAULTS):
        for c in range(r + 1):
            total = broadcast(0.0)
            for column in range(columns):
                at = column * (FAULTS * LANES)
                total = total + load(twists, at + r * LANES) * load(twists, at + c * LANES)
            store(matrix, _factor_entry(matrix, r, c), total)
    for c in range(FAULTS):
        pivot = load(matrix, _factor_entry(matrix, c, c)) + damping
        for m in range(c):
            entry = load(matrix, _factor_entry(matrix, c, m))
            pivot = pivot - entry * entry * load(matrix, _factor_entry(matrix, m, m))
        pivot = maximum(pivot, 1e-3 * damping)
        store(matrix, _factor_entry(matrix, c, c), pivot)
        inverse = 1.0 / pivot
        for r in range(c + 1, FAULTS):
            entry = load(matrix, _factor_entry(matrix, r, c))
            for m in range(c):
                scale = load(matrix, _factor_entry(matrix, m, m)) * load(matrix, _factor_entry(matrix, c, m))
                entry = entry - load(matrix, _factor_entry(matrix, r, m)) * scale
            store(matrix, _factor_entry(matrix, r, c), entry * inverse)
    y0 = -fault[0]
    y1 = -fault[1] - load(matrix, 1 * LANES) * y0
    y2 = -fault[2] - load(matrix, 3 * LANES) * y0 - load(matrix, 4 * LANES) * y1
    y3 = -fault[3] - load(matrix, 6 * LANES) * y0 - load(matrix, 7 * LANES) * y1 - load(matrix, 8 * LANES) * y2
    y4 = -fault[4] - load(matrix, 10 * LANES) * y0 - load(matrix, 11 * LANES) * y1 - load(matrix, 12 * LANES) * y2
    y4 = y4 - load(matrix, 13 * LANES) * y3
    y5 = -fault[5] - load(matrix, 15 * LANES) * y0 - load(matrix, 16 * LANES) * y1 - load(matrix, 17 * LANES) * y2
    y5 = y5 - load(matrix, 18 * LANES) * y3 - load(matrix, 19 * LANES) * y4
    y5 = y5 / load(matrix, 20 * LANES)
    y4 = y4 / load(matrix, 14 * LANES) - load(matrix, 19 * LANES) * y5
    y3 = y3 / load(matrix, 9 * LANES) - load(matrix, 13 * LANES) * y4 - load(matrix, 18 * LANES) * y5
    y2 = y2 / load(matrix, 5 * LANES) - load(matrix, 8 * LANES) * y3 - load(matrix, 12 * LANES) * y4
    y2 = y2 - load(matrix, 17 * LANES) * y5
    y1 = y1 / load(matrix, 2 * LANES) - load(matrix, 4 * LANES) * y2 - load(matrix, 7 * LANES) * y3
    y1 = y1 - load(matrix, 11 * LANES) * y4 - load(matrix, 16 * LANES) * y5
    y0 = y0 / load(matrix, 0) - load(matrix, LANES) * y1 - load(matrix, 3 * LANES) * y2 - load(matrix, 6 * LANES) * y3
    y0 = y0 - load(matrix, 10 * LANES) * y4 - load(matrix, 15 * LANES) * y5
    return y0, y1, y2, y3, y4, y5


@inline
def _step(ranges, y, q, twists):
    """Move eight configurations by Jᵀ y, shortened so that no joint moves too far, and kept within the limits."""
    most = broadcast(LONGEST)
    for column in range(ranges.shape[1]):
        at = column * (FAULTS * LANES)
        move = load(twists, at) * y[0] + load(twists, at + LANES) * y[1] + load(twists, at + 2 * LANES) * y[2]
        move = move + load(twists, at + 3 * LANES) * y[3] + load(twists, at + 4 * LANES) * y[4]
        move = move + load(twists, at + 5 * LANES) * y[5]
        store(twists, at, move)
        if ranges[HOW, column] != FAR:
            most = maximum(absolute(move), most)
    scale = LONGEST / most
    for column in range(ranges.shape[1]):
        at, how = column * LANES, ranges[HOW, column]
        if how == TURNS:
            _turn(q, at, scale, twists)
        elif how not in (REST, HELD):
            value = load(q, at) + scale * load(twists, FAULTS * at)
            store(q, at, maximum(minimum(value, ranges[MOST, column]), ranges[LEAST, column]))


@inline
def move(ranges, t, deviation, error, q, twists, matrix):
    """Take a damped Newton step at eight configurations, from the results of `follow` and `deviation_of`."""
    fault, counts, rows = deviation
    _to_rows(ranges, t, fault, counts, rows, q, twists)
    damping = DAMPING * error + LEAST_DAMPING
    _step(ranges, _solved(ranges.shape[1], twists, fault, damping, matrix), q, twists)


@inline
def _turn(q, at, scale, twists):
    """Turn quaternions by three small angles."""
    w, x, y, z = load(q, at), load(q, at + LANES), load(q, at + 2 * LANES), load(q, at + 3 * LANES)
    half = 0.5 * scale
    a, b = half * load(twists, FAULTS * at), half * load(twists, FAULTS * (at + LANES))
    c = half * load(twists, FAULTS * (at + 2 * LANES))
    w, x, y, z = (
        w - a * x - b * y - c * z, x + a * w + b * z - c * y, y + b * w + c * x - a * z, z + c * w + a * y - b * x
    )  # fmt: skip
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    store(q, at, scale * w)
    store(q, at + LANES, scale * x)
    store(q, at + 2 * LANES, scale * y)
    store(q, at + 3 * LANES, scale * z)


@inline
def _seeded(ranges, start, seeds, row, far, q, lane):
    """Begin a lane at a seed; for angles that wrap, and for lengths without limits, seeds are offsets."""
    for column in range(ranges.shape[1]):
        how, value = ranges[HOW, column], seeds[row, column]
        if how == HELD:
            value = start[column]
        elif how == WRAPS:
            value = start[column] + value
            if value > ranges[MOST, column]:
                value -= TWO_PI
            if value < ranges[LEAST, column]:
                value += TWO_PI
        elif how == FAR:
            value = start[column] + far * value
        if how not in (TURNS, REST):
            value = min(max(value, ranges[LEAST, column]), ranges[MOST, column])
        q[column * LANES + lane] = value


@inline
def _unwound(ranges, start, q, lane, out):
    """Write the configuration of a lane, with angles that wrap as near to the start as the limits allow."""
    sign = 1.0
    for column in range(ranges.shape[1]):
        how, value = ranges[HOW, column], q[column * LANES + lane]
        if how == WRAPS:
            nearer = value + TWO_PI * np.rint((start[column] - value) / TWO_PI)
            if nearer > ranges[MOST, column]:
                nearer -= TWO_PI
            if nearer < ranges[LEAST, column]:
                nearer += TWO_PI
            if nearer <= ranges[MOST, column]:
                value = nearer
        elif how == TURNS:
            cosine = 0.0
            for k in range(column, column + 4):
                cosine += q[k * LANES + lane] * start[k]
            sign = 1.0 if cosine >= 0.0 else -1.0
        out[column] = sign * value if how in (TURNS, REST) else value


@inline
def _is_new(ranges, found, count):
    """Return whether the last configuration found differs from all configurations before it."""
    for other in range(count):
        same = True
        for column in range(ranges.shape[1]):
            apart = abs(found[count, column] - found[other, column])
            if ranges[HOW, column] == WRAPS:
                apart = min(apart, abs(apart - TWO_PI))
            same = same and apart < SAME
        if same:
            return False
    return True


@inline
def _one_pose(pose, chained, chain, constants, ranges, tolerance, targets, starts, seeds, found, counts, nearest, work):
    """Reach one pose: fill its rows of `found` and `nearest`, and its entry of `counts`."""
    q, twists, matrix, squares, marks = work
    values, most = ranges.shape[1], found.shape[1]
    T, start = targets[pose], starts[pose]
    base = (
        (
            broadcast(T[0, 0]), broadcast(T[1, 0]), broadcast(T[2, 0]), broadcast(T[0, 1]), broadcast(T[1, 1]),
            broadcast(T[2, 1]), broadcast(T[0, 2]), broadcast(T[1, 2]), broadcast(T[2, 2]),
        ),
        (
            broadcast(-T[0, 0] * T[0, 3] - T[1, 0] * T[1, 3] - T[2, 0] * T[2, 3]),
            broadcast(-T[0, 1] * T[0, 3] - T[1, 1] * T[1, 3] - T[2, 1] * T[2, 3]),
            broadcast(-T[0, 2] * T[0, 3] - T[1, 2] * T[1, 3] - T[2, 2] * T[2, 3]),
        ),
    )  # fmt: skip
    accept = REACHED * (1.0 + abs(T[0, 3]) + abs(T[1, 3]) + abs(T[2, 3]))
    for column in range(values):
        store(q, column * LANES, broadcast(start[column]))
    R, t = follow(chain, constants, base, q, twists)
    store(squares, 0, sqrt(dot(t, t)))
    far = 1.0 + squares[0]
    # The first seed is the start configuration. The second seed is the solution for the previous pose, if that pose
    # belongs to the same chain of poses and has a solution.
    follows = pose % chained > 0 and counts[pose - 1] > 0
    if follows:
        for column in range(values):
            if ranges[HOW, column] != HELD:
                q[column * LANES + 1] = nearest[pose - 1, column]
    for column in range(values):
        nearest[pose, column] = start[column]
    for r in range(3):
        nearest[pose, values + r] = np.inf
    at, count, least, step = 0, 0, np.inf, 0
    fresh, live = ALL - 1 - 2 * follows, ALL
    store(marks, 0, broadcast(np.inf))
    while True:
        while fresh:
            lane, fresh = next_lane(fresh)
            if at < len(seeds):
                _seeded(ranges, start, seeds, at, far, q, lane)
                marks[lane] = np.inf
                at += 1
            else:
                live &= ~(1 << lane)
        if live == 0:
            break
        R, t = follow(chain, constants, base, q, twists)
        deviation = deviation_of(R, t, tolerance)
        fault = deviation[0]
        shift = fault[0] * fault[0] + fault[1] * fault[1] + fault[2] * fault[2]
        tilt, spin = fault[3] * fault[3] + fault[4] * fault[4], fault[5] * fault[5]
        error = shift + tilt + spin
        reached = movemask((shift <= accept * accept) & (tilt + spin <= REACHED * REACHED)) & live
        step += 1
        if reached or step % PATIENCE == 0:
            store(squares, 0, shift)
            store(squares, LANES, tilt)
            store(squares, 2 * LANES, spin)
            store(squares, 3 * LANES, error)
            fresh = reached
            if step % PATIENCE == 0:
                # Because the comparison is negated, a seed whose error is not finite is abandoned, too.
                fresh = live & (~movemask(error < GAIN * load(marks, 0)) | reached)
                store(marks, 0, error)
            left = fresh
            while left:
                lane, left = next_lane(left)
                if reached >> lane & 1:
                    _unwound(ranges, start, q, lane, found[pose, count])
                    count += _is_new(ranges, found[pose], count)
                if squares[3 * LANES + lane] < least and (count == 0 or reached >> lane & 1 and count == 1):
                    least = -1.0 if count else squares[3 * LANES + lane]
                    _unwound(ranges, start, q, lane, nearest[pose])
                    for r in range(3):
                        nearest[pose, values + r] = np.sqrt(squares[r * LANES + lane])
                if count == most:
                    break
            if count == most:
                break
        move(ranges, t, deviation, error, q, twists, matrix)
    counts[pose] = count


@njit()
def reach_poses(
    chain, constants, ranges, tolerance, targets, starts, seeds, chained, first, last, found, counts, nearest
):
    """Find configurations for the poses first .. last.

    Parameters
    ----------
    chain, constants, ranges : ndarray
        Described at the beginning of this module.
    tolerance : ndarray, shape (6,)
        Tolerances of the six coordinates.
    targets : ndarray, shape (n, 4, 4)
    starts : ndarray, shape (n, K)
    seeds : ndarray, shape (s, K)
    chained, first, last : int64
        A pose starts from the answer for the previous pose, except that every `chained`-th pose begins a new chain. The
        answers do not depend on `first` and `last` if these are multiples of `chained`.
    found : ndarray, shape (n, most, K)
        Receives distinct solutions; the search for a pose ends when it has `most` solutions.
    counts : ndarray of int64, shape (n,)
        Receives the number of solutions for each pose.
    nearest : ndarray, shape (n, K + 3)
        Receives the first solution, or else the configuration that came nearest. The last three entries are its excess
        over the tolerance: in metres for the position, and 2 sin(angle / 2) for tilt and for spin.
    """
    values = ranges.shape[1]
    work = (
        np.empty(values * LANES), np.empty(values * FAULTS * LANES), np.empty(21 * LANES), np.empty(4 * LANES),
        np.empty(LANES),
    )  # fmt: skip
    for pose in range(first, last):
        _one_pose(
            pose, chained, chain, constants, ranges, tolerance, targets, starts, seeds, found, counts, nearest, work
        )
