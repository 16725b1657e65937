"""How fast and how bent the ways of points are on a motion, and what rounding can do to them: bounds, rounded outward.

Between two configurations joint values run straight, so every joint turns or slides at a constant rate. Seen from one
body, the points of another one move by the joints between the two. With w the rates of turning joints, s those of
sliding ones and R how far the body gets from a joint's axis, a point's speed is at most the sum of all w R and s, and
its second derivative at most

    A = sum over turning joints j of R_j w_j (w_j + 2 W_j) + sum over sliding joints j of 2 s_j W_j

with W_j the sum of the rates of the turning joints between j and the body that is taken to stand still. A planar joint
is one that slides and then one that turns, seen from its parent; and so is a floating one, of which a ball joint is
what turns. docs/certified.md, "Motions".
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import BALL, FIXED, FLOATING, PLANAR, PRISMATIC
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# What forward kinematics rounds a position by, for each joint of the chain, in units of the chain's length.
JOINT_ROUNDINGS = 128.0 * UNIT_ROUNDOFF  # derived 64, certified.md B24

# What the value of a joint is off by when it is interpolated, in units of the values that go into it.
VALUE_ROUNDINGS = 16.0 * UNIT_ROUNDOFF  # derived 7, certified.md B25

# What an angle does to the entries of a rotation, in the Frobenius norm.
TURN = 1.5  # derived 1.42, certified.md B26

# Angle [rad] that an interpolated quaternion is off by: rounding, and in units of how far the ends are from norm 1.
SLERP_ROUNDINGS = 256.0 * UNIT_ROUNDOFF  # derived 64, certified.md B27
NORM_SHARE = 16.0  # derived 6.2, certified.md B28

# What poses accepted as rigid stretch ways by, and the few dozen roundings that rates and bounds are formed by.
STRETCH = 1e-5  # derived 3.2e-6, certified.md B29
UPWARD = 1.0 + STRETCH

SMALLEST_TURN = 1e-15  # rad; more than an angle between two equal quaternions is off by


class Rates(NamedTuple):
    """What joints do on a motion: arrays with an entry a link.

    Attributes
    ----------
    turn : rad that the joint turns by
    slide : m that it slides by
    far : m that it is from 0, at most, if it slides
    """

    turn: Any
    slide: Any
    far: Any


class Ways(NamedTuple):
    """Bounds on the ways of a body's points, as seen from another body.

    Attributes
    ----------
    bend : norm of the second derivative
    speed : norm of the first derivative
    """

    bend: Any
    speed: Any


@inline
def _larger_norm(a, b, c, x, y, z):
    return np.sqrt(max(a * a + b * b + c * c, x * x + y * y + z * z))


@inline
def norm_of_quaternion(ends, row, at):
    """Length of the quaternion in the columns at .. at + 4."""
    w, x, y, z = ends[row, at], ends[row, at + 1], ends[row, at + 2], ends[row, at + 3]
    return np.sqrt(w * w + x * x + y * y + z * z)


@inline
def _arc(ends, at):
    """Angle [rad] of the rotation between two quaternions, or more; and how far they are from norm 1."""
    p, q = norm_of_quaternion(ends, 0, at), norm_of_quaternion(ends, 1, at)
    squares, same = 0.0, True
    for k in range(4):
        a, b = ends[0, at + k] / p, ends[1, at + k] / q
        squares += (a - b) * (a - b)
        same = same and ends[0, at + k] == ends[1, at + k]
    angle = 4.0 * np.arcsin(min(np.sqrt(squares) / 2.0, 1.0))
    return 0.0 if same else angle * UPWARD + SMALLEST_TURN, max(abs(p - 1.0), abs(q - 1.0))


@inline
def _angle_off(off, at):
    """Angle [rad] that a rotation is off by, at most, whose quaternion may be off by the entries at .. at + 4."""
    w, x, y, z = off[at], off[at + 1], off[at + 2], off[at + 3]
    # Made a unit again it is off by twice as much, and a chord c of unit quaternions is an angle of up to π c.
    return 2.0 * np.pi * np.sqrt(w * w + x * x + y * y + z * z)


@njit()
def rates_of(tree, ends, rates):
    """Write the rates of all joints between two configurations; returns what rounding does to poses.

    Parameters
    ----------
    tree : Tree
    ends : ndarray, shape (2, dof)
    rates : Rates

    Returns
    -------
    travel : float
        Sum of how far all sliding joints are from 0, at most [m].
    angles, places : float
        Sum of what the angles of all joints [rad], and what the places of all sliding joints [m], are off by when they
        are interpolated in floating point.
    """
    travel, angles, places = 0.0, 0.0, 0.0
    for link in range(tree.kind.size):
        kind, at, by, off = tree.kind[link], tree.column[link], tree.multiplier[link], tree.offset[link]
        turn, slide, far = 0.0, 0.0, 0.0
        if kind == FIXED:
            pass
        elif kind == FLOATING:
            slide = _larger_norm(
                ends[1, at] - ends[0, at], ends[1, at + 1] - ends[0, at + 1], ends[1, at + 2] - ends[0, at + 2],
                0.0, 0.0, 0.0,
            )  # fmt: skip
            far = _larger_norm(
                ends[0, at], ends[0, at + 1], ends[0, at + 2], ends[1, at], ends[1, at + 1], ends[1, at + 2]
            )  # fmt: skip
            turn, astray = _arc(ends, at + 3)
            angles += SLERP_ROUNDINGS + NORM_SHARE * astray
            places += 2.0 * VALUE_ROUNDINGS * far
        elif kind == BALL:
            turn, astray = _arc(ends, at)
            angles += SLERP_ROUNDINGS + NORM_SHARE * astray
        elif kind == PLANAR:
            slide = _larger_norm(ends[1, at] - ends[0, at], ends[1, at + 1] - ends[0, at + 1], 0.0, 0.0, 0.0, 0.0)
            far = _larger_norm(ends[0, at], ends[0, at + 1], 0.0, ends[1, at], ends[1, at + 1], 0.0)
            turn = abs(ends[1, at + 2] - ends[0, at + 2])
            angles += VALUE_ROUNDINGS * max(abs(ends[0, at + 2]), abs(ends[1, at + 2]))
            places += 2.0 * VALUE_ROUNDINGS * far
        else:
            way = abs(by * (ends[1, at] - ends[0, at]))
            most = abs(by) * max(abs(ends[0, at]), abs(ends[1, at])) + abs(off)
            if kind == PRISMATIC:
                slide, far = way, most
                places += VALUE_ROUNDINGS * most
            else:
                turn = way
                angles += VALUE_ROUNDINGS * most
        rates.turn[link], rates.slide[link], rates.far[link] = turn * UPWARD, slide * UPWARD, far * UPWARD
        travel += far * UPWARD
    return travel, angles, places


@njit()
def write_strays(tree, off, rates, strays):
    """Write how far joints may be from a motion, as `Rates`.

    Parameters
    ----------
    tree : Tree
    off : ndarray, shape (dof,)
        How far each value may be from the motion's at the same fraction.
    rates : Rates
        Of the motion.
    strays : Rates
        Receives by how much joints may be turned and slid away from it; `far` holds on the way there as well.

    Returns
    -------
    float
        By how much farther from 0 all sliding joints together may be [m].
    """
    travel = 0.0
    for link in range(tree.kind.size):
        kind, at, by = tree.kind[link], tree.column[link], tree.multiplier[link]
        turn, slide = 0.0, 0.0
        if kind == FIXED:
            pass
        elif kind == FLOATING:
            slide = _larger_norm(off[at], off[at + 1], off[at + 2], 0.0, 0.0, 0.0)
            turn = _angle_off(off, at + 3)
        elif kind == BALL:
            turn = _angle_off(off, at)
        elif kind == PLANAR:
            slide, turn = _larger_norm(off[at], off[at + 1], 0.0, 0.0, 0.0, 0.0), off[at + 2]
        elif kind == PRISMATIC:
            slide = abs(by) * off[at]
        else:
            turn = abs(by) * off[at]
        strays.turn[link], strays.slide[link] = turn * UPWARD, slide * UPWARD
        strays.far[link] = rates.far[link] + slide * UPWARD
        travel += slide * UPWARD
    return travel


@inline
def uncertainty(tables, travel, angles, places):
    """How far a computed point of the robot may be from where it is on the real motion [m].

    Returns
    -------
    off : float
    length : float
        Of the chain [m].
    turned : float
        What computed rotations are off by, as a share of what they turn.
    """
    length = tables.chain[1] + travel
    turned = JOINT_ROUNDINGS * tables.chain[0] + TURN * angles
    return turned * length + 2.0 * places, length, turned


@inline
def _common(tables, a, b):
    """How many joints, from the world on, the paths of two links share."""
    start_a, start_b = tables.path_start[a], tables.path_start[b]
    most = min(tables.path_start[a + 1] - start_a, tables.path_start[b + 1] - start_b)
    k = 0
    while k < most and tables.path_link[start_a + k] == tables.path_link[start_b + k]:
        k += 1
    return k


@njit()
def ways_between(tables, rates, body, link, fixed):
    """How a body's points move as seen from a link.

    Parameters
    ----------
    tables : MotionTables
    rates : Rates
    body : int
        The one that moves.
    link, fixed : int
        Its link, and the one that is taken to stand still; -1 is the world.

    Returns
    -------
    Ways
    """
    shared = _common(tables, link, fixed) if link >= 0 and fixed >= 0 else 0
    up_from = tables.path_start[link] + shared if link >= 0 else 0
    up_to = tables.path_start[link + 1] if link >= 0 else 0
    down_from = tables.path_start[fixed] + shared if fixed >= 0 else 0
    down_to = tables.path_start[fixed + 1] if fixed >= 0 else 0
    reach = tables.reach
    every = 0.0  # rates of the turning joints between here and the body that stands still
    for k in range(up_from, up_to):
        every += rates.turn[tables.path_link[k]]
    for k in range(down_from, down_to):
        every += rates.turn[tables.path_link[k]]
    rest, travel, bend, speed = every, 0.0, 0.0, 0.0
    for k in range(up_to - 1, up_from - 1, -1):
        joint = tables.path_link[k]
        turn, slide = rates.turn[joint], rates.slide[joint]
        rest = max(rest - turn, 0.0)
        far = turn * (reach[body, joint] + travel)
        bend += far * (turn + 2.0 * rest) + 2.0 * slide * rest
        speed += far + slide
        travel += rates.far[joint]
    for k in range(down_from, down_to):
        joint = tables.path_link[k]
        turn, slide = rates.turn[joint], rates.slide[joint]
        # Seen from this side, the joint slides first.
        bend += 2.0 * slide * rest
        rest = max(rest - turn, 0.0)
        travel += rates.far[joint]
        far = turn * (reach[body, joint] + travel)
        bend += far * (turn + 2.0 * rest)
        speed += far + slide
    # What `rest` lost in the differences: a few roundings of the whole, for each joint.
    return Ways((bend + 1e-12 * every * speed) * UPWARD, speed * UPWARD)
