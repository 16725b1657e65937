"""Bounds on the speed and the curvature of points on a course, and on their rounding, all rounded outward.

Relative to one body, the points of another body are moved by the joints between the two bodies. Let w be the rates of
turning joints, s the rates of sliding joints, and R the largest distance of the body from a joint's axis. The speed of
a point is then at most the sum of all w R and s, and its second derivative is at most

    A = sum over turning joints j of R_j (w_j (w_j + 2 W_j) + w'_j) + sum over sliding joints j of 2 s_j W_j + s'_j

where W_j is the sum of the rates of the turning joints between j and the reference body, and w' and s' are the largest
second derivatives of joint values, which are zero on straight motions. Seen from its parent, a planar joint is a
sliding joint followed by a turning joint, and a floating joint is a sliding joint followed by a ball joint. See
docs/certified.md, "Motions".
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import BALL, FIXED, FLOATING, PLANAR, PRISMATIC
from loewner._kernels.elementary import arc_sine
from loewner._kernels.pieces.pack import motion_tables_of, problem_of
from loewner._kernels.tolerances import STRETCH, UNIT_ROUNDOFF

# Bound on the rounding error of a position computed by forward kinematics, per joint of the chain, in units of the
# chain's length.
JOINT_ROUNDINGS = 128.0 * UNIT_ROUNDOFF  # certified.md B24

# Bound on the rounding error of a joint value computed from a course, in units of the degree of the course times the
# largest absolute value of its control points.
VALUE_ROUNDINGS = 16.0 * UNIT_ROUNDOFF  # certified.md B25

# Bound on the rounding error of the control points of a part of a course, in the same units as for a joint value.
PART_ROUNDINGS = 8.0 * UNIT_ROUNDOFF  # certified.md B50

# Factor that turns an error in a rotation's angle into a bound on the error of the rotation matrix, in the Frobenius
# norm.
TURN = 1.5  # certified.md B26

# Bounds on the error [rad] of the angle of an interpolated quaternion: the error from rounding, and the error per unit
# of the larger deviation of the norms of the two ends from 1.
SLERP_ROUNDINGS = 256.0 * UNIT_ROUNDOFF  # certified.md B27
NORM_SHARE = 16.0  # certified.md B28

UPWARD = 1.0 + STRETCH

# Bound [rad] on the absolute error of the computed angle between two quaternions. The quotients by the norms have
# errors of at most 2^-53 in total for each quaternion, and the angle is twice as large as the distance: 4.5e-16. The
# errors of the norms change the distance only by a relative amount, which UPWARD covers.
SMALLEST_TURN = 1e-15


# The component of every control point of a quaternion along the first control point must be more than LEAST_NORM times
# the largest norm of a control point. Otherwise, the orientation might turn arbitrarily fast. If the condition holds,
# any two quaternions of the course are less than 90° apart. For a part of the course, only this consequence is
# required.
LEAST_NORM = 0.75


class Rates(NamedTuple):
    """Bounds on the motions of joints on a course, or on a part of it: each array has one entry per link.

    Attributes
    ----------
    turn : angular velocity, rad over the whole course
    slide : velocity, m over the whole course
    far : distance from 0, m, of sliding joints
    turning, sliding : second derivatives of the angle and of the slide
    """

    turn: Any
    slide: Any
    far: Any
    turning: Any
    sliding: Any


class Ways(NamedTuple):
    """Bounds on the paths of a body's points, relative to another body.

    Attributes
    ----------
    bend : norm of the second derivative
    speed : norm of the first derivative
    turn, turning : sums of the angular velocities and accelerations of the joints between the two bodies
    travel : sum of the distances of sliding joints from 0
    """

    bend: Any
    speed: Any
    turn: Any
    turning: Any
    travel: Any


class _Derivatives(NamedTuple):
    """Largest norms, for 0 <= t <= 1, of several columns of a course and of their first and second derivatives."""

    size: Any
    first: Any
    second: Any


@inline
def _derivatives(course, at, count, width):
    """Bound the columns at .. at + count of a part of a course; the part is `width` times the whole course."""
    degree = course.shape[0] - 1
    sizes, firsts, seconds = 0.0, 0.0, 0.0
    for k in range(degree + 1):
        size, first, second = 0.0, 0.0, 0.0
        for c in range(at, at + count):
            size += course[k, c] * course[k, c]
            if k >= 1:
                step = course[k, c] - course[k - 1, c]
                first += step * step
                if k >= 2:
                    change = step - (course[k - 1, c] - course[k - 2, c])
                    second += change * change
        sizes, firsts, seconds = max(sizes, size), max(firsts, first), max(seconds, second)
    return _of_course(degree, width, np.sqrt(sizes), np.sqrt(firsts), np.sqrt(seconds))


@inline
def _derivatives_of_value(course, c, width):
    """Bound one column of a part of a course."""
    degree = course.shape[0] - 1
    size, first, second = abs(course[0, c]), 0.0, 0.0
    for k in range(1, degree + 1):
        step = course[k, c] - course[k - 1, c]
        size, first = max(size, abs(course[k, c])), max(first, abs(step))
        if k >= 2:
            second = max(second, abs(step - (course[k - 1, c] - course[k - 2, c])))
    return _of_course(degree, width, size, first, second)


@inline
def _of_course(degree, width, size, first, second):
    """Make `_Derivatives` of the largest differences of a part's control points, which may be rounded."""
    if degree == 1:
        return _Derivatives(size, first, 0.0)
    off = PART_ROUNDINGS * degree * size if width < 1.0 and first > 0.0 else 0.0
    first += 2.0 * off
    # Subtracting one difference from another loses digits.
    second += 4.0 * off + 4.0 * UNIT_ROUNDOFF * first
    return _Derivatives(size + off, degree * first / width, degree * (degree - 1) * second / (width * width))


@inline
def norm_of_quaternion(course, row, at):
    """Length of the quaternion in the columns at .. at + 4."""
    w, x, y, z = course[row, at], course[row, at + 1], course[row, at + 2], course[row, at + 3]
    return np.sqrt(w * w + x * x + y * y + z * z)


@inline
def _arc(ends, at):
    """Upper bound on the angle [rad] of the rotation between two quaternions, and their deviation from norm 1."""
    p, q = norm_of_quaternion(ends, 0, at), norm_of_quaternion(ends, 1, at)
    squares, same = 0.0, True
    for k in range(4):
        a, b = ends[0, at + k] / p, ends[1, at + k] / q
        squares += (a - b) * (a - b)
        same = same and ends[0, at + k] == ends[1, at + k]
    angle = 0.0 if same else 4.0 * arc_sine(min(np.sqrt(squares) / 2.0, 1.0)) * UPWARD + SMALLEST_TURN
    return angle, max(abs(p - 1.0), abs(q - 1.0))


@inline
def _orientation(course, at, width):
    """Bounds on the angular velocity, acceleration and rounding of the orientation in the columns at .. at + 4.

    The derivative of the unit quaternion p / |p| is at most p' / |p|, and p'' / |p| + 2 (p' / |p|)² bounds the turning
    part of its second derivative. Angles are twice as large. The rounding is in rad.
    """
    if course.shape[0] == 2:
        turn, astray = _arc(course, at)
        return turn, 0.0, SLERP_ROUNDINGS + NORM_SHARE * astray
    p = _derivatives(course, at, 4, width)
    # Every control point has a component of at least `least` along the first one, and so has every point of the curve.
    least = np.inf
    for k in range(course.shape[0]):
        reached = 0.0
        for c in range(at, at + 4):
            reached += course[k, c] * course[0, c]
        least = min(least, reached / norm_of_quaternion(course, 0, at))
    if not least > (LEAST_NORM * p.size if width == 1.0 else 0.0):
        return np.inf, np.inf, np.inf
    least *= 1.0 - STRETCH
    speed = p.first / least
    return 2.0 * speed, 2.0 * (p.second / least + 2.0 * speed * speed), SLERP_ROUNDINGS * p.size / least


@inline
def _angle_off(off, at):
    """Largest angle error [rad] of a rotation whose quaternion has the errors in columns at .. at + 4."""
    w, x, y, z = off[at], off[at + 1], off[at + 2], off[at + 3]
    # Normalisation doubles the error, and a chord c between unit quaternions means a rotation by at most π c.
    return 2.0 * np.pi * np.sqrt(w * w + x * x + y * y + z * z)


@njit()
def rates_of(tree, course, width, rates):
    """Write bounds on the rates of all joints on a course, or on a part; return bounds on the rounding of poses.

    Parameters
    ----------
    tree : Tree
    course : ndarray, shape (degree + 1, dof)
    width : float
        The part's share of the whole course: 1 for the whole course, whose control points are exact. Derivatives are
        with respect to the fraction of the whole course.
    rates : Rates

    Returns
    -------
    travel : float
        Largest sum of the distances of all sliding joints from 0 [m].
    angles, places : float
        Sums of the floating-point errors of the angles of all joints [rad], and of the positions of all sliding joints
        [m].
    """
    travel, angles, places = 0.0, 0.0, 0.0
    rounded = VALUE_ROUNDINGS * (course.shape[0] - 1)
    for link in range(tree.kind.size):
        kind, at, by, off = tree.kind[link], tree.column[link], tree.multiplier[link], tree.offset[link]
        turn, turning, slide, sliding, far = 0.0, 0.0, 0.0, 0.0, 0.0
        if kind == FIXED:
            pass
        elif kind == FLOATING:
            far, slide, sliding = _derivatives(course, at, 3, width)
            turn, turning, astray = _orientation(course, at + 3, width)
            angles += astray
            places += 2.0 * rounded * far
        elif kind == BALL:
            turn, turning, astray = _orientation(course, at, width)
            angles += astray
        elif kind == PLANAR:
            far, slide, sliding = _derivatives(course, at, 2, width)
            most, turn, turning = _derivatives_of_value(course, at + 2, width)
            angles += rounded * most
            places += 2.0 * rounded * far
        else:
            most, way, bend = _derivatives_of_value(course, at, width)
            most = abs(by) * most + abs(off)
            if kind == PRISMATIC:
                slide, sliding, far = abs(by) * way, abs(by) * bend, most
                places += rounded * most
            else:
                turn, turning = abs(by) * way, abs(by) * bend
                angles += rounded * most
        rates.turn[link], rates.slide[link], rates.far[link] = turn * UPWARD, slide * UPWARD, far * UPWARD
        rates.turning[link], rates.sliding[link] = turning * UPWARD, sliding * UPWARD
        travel += far * UPWARD
    return travel, angles, places


@njit()
def write_strays(tree, off, rates, strays):
    """Write how far joints may deviate from a motion, as `Rates`.

    Parameters
    ----------
    tree : Tree
    off : ndarray, shape (dof,)
        Allowed deviation of each value from the course at the same fraction.
    rates : Rates
        Rates of the course.
    strays : Rates
        Receives the amounts by which joints may turn and slide away from the course, at a constant rate. `far` also
        holds for all states in between.

    Returns
    -------
    slides : float
        Sum of the additional distances of all sliding joints from 0 [m].
    turns : float
        Sum of the additional angles of all turning joints [rad].
    """
    slides, turns = 0.0, 0.0
    for link in range(tree.kind.size):
        kind, at, by = tree.kind[link], tree.column[link], tree.multiplier[link]
        turn, slide = 0.0, 0.0
        if kind == FIXED:
            pass
        elif kind == FLOATING:
            slide = np.sqrt(off[at] ** 2 + off[at + 1] ** 2 + off[at + 2] ** 2)
            turn = _angle_off(off, at + 3)
        elif kind == BALL:
            turn = _angle_off(off, at)
        elif kind == PLANAR:
            slide, turn = np.sqrt(off[at] ** 2 + off[at + 1] ** 2), off[at + 2]
        elif kind == PRISMATIC:
            slide = abs(by) * off[at]
        else:
            turn = abs(by) * off[at]
        strays.turn[link], strays.slide[link] = turn * UPWARD, slide * UPWARD
        strays.far[link] = rates.far[link] + slide * UPWARD
        strays.turning[link], strays.sliding[link] = 0.0, 0.0
        slides += slide * UPWARD
        turns += turn * UPWARD
    return slides, turns


@inline
def uncertainty(tables, travel, angles, places):
    """Largest distance [m] between a computed point of the robot and the same point on the real motion.

    Returns
    -------
    off : float
    length : float
        Length of the chain [m].
    turned : float
        Relative error of lengths to which computed rotations are applied.
    """
    length = tables.chain[1] + travel
    turned = JOINT_ROUNDINGS * tables.chain[0] + TURN * angles
    return turned * length + 2.0 * places, length, turned


@inline
def shared_joints(tables, a, b):
    """Number of joints, counted from the world, that the paths to two links share."""
    start_a, start_b = tables.path_start[a], tables.path_start[b]
    most = min(tables.path_start[a + 1] - start_a, tables.path_start[b + 1] - start_b)
    k = 0
    while k < most and tables.path_link[start_a + k] == tables.path_link[start_b + k]:
        k += 1
    return k


@inline
def ways_between(tables, rates, body, link, fixed):
    """Bounds on the motion of a body's points relative to a link.

    Parameters
    ----------
    tables : MotionTables
    rates : Rates
    body : int
        The moving body.
    link, fixed : int
        The link of the body, and the reference link; -1 is the world.

    Returns
    -------
    Ways
    """
    shared = shared_joints(tables, link, fixed) if link >= 0 and fixed >= 0 else 0
    up_from = tables.path_start[link] + shared if link >= 0 else 0
    up_to = tables.path_start[link + 1] if link >= 0 else 0
    down_from = tables.path_start[fixed] + shared if fixed >= 0 else 0
    down_to = tables.path_start[fixed + 1] if fixed >= 0 else 0
    reach = tables.reach
    every = turning = 0.0  # Sums of the rates and accelerations of the turning joints between the two bodies.
    for k in range(up_from, up_to):
        every += rates.turn[tables.path_link[k]]
        turning += rates.turning[tables.path_link[k]]
    for k in range(down_from, down_to):
        every += rates.turn[tables.path_link[k]]
        turning += rates.turning[tables.path_link[k]]
    rest, travel, bend, speed = every, 0.0, 0.0, 0.0
    for k in range(up_to - 1, up_from - 1, -1):
        joint = tables.path_link[k]
        turn, slide = rates.turn[joint], rates.slide[joint]
        rest = max(rest - turn, 0.0)
        far = turn * (reach[body, joint] + travel)
        bend += far * (turn + 2.0 * rest) + 2.0 * slide * rest
        bend += rates.turning[joint] * (reach[body, joint] + travel) + rates.sliding[joint]
        speed += far + slide
        travel += rates.far[joint]
    for k in range(down_from, down_to):
        joint = tables.path_link[k]
        turn, slide = rates.turn[joint], rates.slide[joint]
        # On this side, a joint slides before it turns, so its own rotation counts as well.
        bend += 2.0 * slide * rest
        rest = max(rest - turn, 0.0)
        travel += rates.far[joint]
        far = turn * (reach[body, joint] + travel)
        bend += far * (turn + 2.0 * rest)
        bend += rates.turning[joint] * (reach[body, joint] + travel) + rates.sliding[joint]
        speed += far + slide
    # The subtractions that compute `rest` add an error of a few roundings of `every` for each joint.
    return Ways((bend + 1e-12 * every * speed) * UPWARD, speed * UPWARD, every * UPWARD, turning * UPWARD, travel)


@njit()
def course_bounds(problem_handle, tables_handle, courses, off, bounds):
    """Bound the motions of all moving bodies' points in the world on courses.

    Parameters
    ----------
    problem_handle, tables_handle : addresses
    courses : ndarray, shape (N, degree + 1, dof)
    off : ndarray, shape (N, dof)
        Allowed deviation of each value from the course at the same fraction.
    bounds : ndarray, shape (N, bodies, 4)
        Receives the norm of the second derivative [m], the angular velocity [rad], the distance by which points may
        deviate [m], and the error of computed positions [m]. The bounds are infinite if an orientation may turn
        arbitrarily fast.
    """
    problem, tables = problem_of(problem_handle), motion_tables_of(tables_handle)
    memory = np.zeros((10, len(problem.tree.kind)))
    rates = Rates(memory[0], memory[1], memory[2], memory[3], memory[4])
    strays = Rates(memory[5], memory[6], memory[7], memory[8], memory[9])
    for n in range(len(courses)):
        travel, angles, places = rates_of(problem.tree, courses[n], 1.0, rates)
        slides, _ = write_strays(problem.tree, off[n], rates, strays)
        error, length, turned = uncertainty(tables, travel + slides, angles, places)
        for body in range(len(problem.link)):
            ways = ways_between(tables, rates, body, problem.link[body], -1)
            astray = ways_between(tables, strays, body, problem.link[body], -1)
            bounds[n, body, 0], bounds[n, body, 1] = ways.bend, ways.turn
            bounds[n, body, 2] = (1.0 + 2.0 * (turned + tables.chain[2])) * astray.speed
            bounds[n, body, 3] = error + tables.chain[2] * length
