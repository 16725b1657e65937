"""How paths bend towards another body: second derivatives along the normal of a plane, at eight configurations.

The bound A of `motion_bounds` adds up what all joints do in all directions. What can spoil a plane is only the part of
the second derivative that points towards the other body, and it is known wherever a configuration has been placed: with
the angular velocity w_j of joint j, its angular acceleration w'_j, and a point o_j of its axis, all as seen from the
other body, a point x has the second derivative

    sum over j of w_j × (w_j × (x - o_j)) + w'_j × (x - o_j) + 2 sum over l before j of w_l × (w_j × (x - o_j)),

and likewise for joints that slide. Along a normal it is a linear function of x, whose largest value over an ellipsoid
is known. See docs/certified.md, "Directed bends".
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import ACROSS, ALONG, BALL, FLOATING, OUTER_RADIUS, PLANAR, PRISMATIC, ROTATION
from loewner._kernels.ellipsoids.contact import outward_width
from loewner._kernels.linalg3 import (
    along,
    apply,
    apply_transposed,
    cross,
    dot,
    image,
    minus,
    one_norm,
    plus,
    scaled,
)
from loewner._kernels.robots.kinematics import axis_of, direction_of, rotation_of_link, translation_of_link
from loewner._kernels.robots.motion_bounds import UPWARD, shared_joints, steepest
from loewner._kernels.robots.sweeps import outer_center, outer_shape
from loewner._kernels.simd.vectors import broadcast, load, store

# Relative errors of the terms, from rounding and from rotations that are accepted as orthonormal.
TERMS = 1e-4  # derived 1.1e-5, certified.md B52

# A share of the largest |f''| of f = n · x'': from the second derivatives of a chain's joints, or for constant rates.
REMAINDER, REMAINDER_STRAIGHT = 6.0, 2.0


@inline
def _difference(course, c, k, order):
    if order == 1:
        return course[k + 1, c] - course[k, c]
    return (course[k + 2, c] - course[k + 1, c]) - (course[k + 1, c] - course[k, c])


@inline
def _derivative(course, c, t, order):
    """The first or second derivative of a column, by Horner's scheme for Bernstein polynomials."""
    degree = course.shape[0] - 1 - order
    if degree < 0:
        return broadcast(0.0)
    s, power, binomial, value = 1.0 - t, broadcast(1.0), 1.0, broadcast(_difference(course, c, 0, order))
    for k in range(1, degree + 1):
        power = power * t
        binomial = binomial * (degree - k + 1) / k
        value = value * s + binomial * _difference(course, c, k, order) * power
    return value * (degree + 1.0 if order == 1 else (degree + 1.0) * (degree + 2.0))


@inline
def _turning_vector(course, at):
    """Constant angular velocity, in the frame that turns, between two orientations, whose scalar product is >= 0."""
    w, x, y, z = course[0, at], -course[0, at + 1], -course[0, at + 2], -course[0, at + 3]
    p, i, j, k = course[1, at], course[1, at + 1], course[1, at + 2], course[1, at + 3]
    real = w * p - x * i - y * j - z * k
    a, b, c = w * i + x * p + y * k - z * j, w * j - x * k + y * p + z * i, w * k + x * j - y * i + z * p
    sine = np.sqrt(a * a + b * b + c * c)
    scale = 2.0 * np.arctan2(sine, real) / sine if sine > 0.0 else 0.0
    return broadcast(scale * a), broadcast(scale * b), broadcast(scale * c)


@inline
def _add_turn(sums, n, x, radius, w, turning, o):
    """Add a joint that turns at w, with angular acceleration `turning`, about an axis through o."""
    e, r, value, size = sums
    own = cross(n, w)
    k = plus(cross(plus(e, own), w), cross(n, turning))
    off = minus(x, o)
    return plus(e, scaled(2.0, own)), plus(r, k), value + dot(k, off), size + one_norm(k) * (one_norm(off) + radius)


@inline
def _add_slide(sums, n, slide):
    """Add a joint that slides, with its velocity and acceleration."""
    s, sliding = slide
    e, r, value, size = sums
    return e, r, value + (dot(e, s) + dot(n, sliding)), size + one_norm(e) * one_norm(s) + one_norm(sliding)


@inline
def _in_world(W, link, v):
    return apply(rotation_of_link(W, link), v) if link >= 0 else v


@inline
def _slide(tree, W, course, t, link, sign):
    """Velocity and acceleration with which a joint slides."""
    kind, at, above, constants = tree.kind[link], tree.column[link], tree.parent[link], tree.constants
    zero = broadcast(0.0)
    s, sliding = (zero, zero, zero), (zero, zero, zero)
    if kind == PRISMATIC:
        by = sign * tree.multiplier[link]
        d = _in_world(W, above, direction_of(constants, link, ACROSS))
        s = scaled(_derivative(course, at, t, 1) * by, d)
        sliding = scaled(_derivative(course, at, t, 2) * by, d)
    elif kind == PLANAR:
        for k in range(2):
            d = _in_world(W, above, direction_of(constants, link, ACROSS if k == 0 else ALONG))
            s = along(s, _derivative(course, at + k, t, 1) * sign, d)
            sliding = along(sliding, _derivative(course, at + k, t, 2) * sign, d)
    elif kind == FLOATING:
        for k in range(3):
            d = (
                broadcast(constants[link, ROTATION + k]), broadcast(constants[link, ROTATION + 3 + k]),
                broadcast(constants[link, ROTATION + 6 + k]),
            )  # fmt: skip
            d = _in_world(W, above, d)
            s = along(s, _derivative(course, at + k, t, 1) * sign, d)
            sliding = along(sliding, _derivative(course, at + k, t, 2) * sign, d)
    return s, sliding


@inline
def _turn(tree, W, course, t, link, sign):
    """Angular velocity and acceleration with which a joint turns."""
    kind, at, zero = tree.kind[link], tree.column[link], broadcast(0.0)
    w, turning = (zero, zero, zero), (zero, zero, zero)
    if kind in (FLOATING, BALL):
        v = _turning_vector(course, at + 3 if kind == FLOATING else at)
        w = scaled(sign, apply(rotation_of_link(W, link), v))
    elif kind != PRISMATIC:
        c, by = (at + 2, sign) if kind == PLANAR else (at, sign * tree.multiplier[link])
        axis = apply(rotation_of_link(W, link), axis_of(tree.constants, link))
        w = scaled(_derivative(course, c, t, 1) * by, axis)
        turning = scaled(_derivative(course, c, t, 2) * by, axis)
    return w, turning


@njit()
def directed_bends(tree, tables, hot, W, course, times, link, fixed, piece, n, bend, out):
    """Bound the second derivatives along n of the points of a piece, relative to another body.

    Parameters
    ----------
    tree : Tree
    tables : MotionTables
    hot : ndarray
        Outer ellipsoids of pieces, in the frames of their bodies.
    W : ndarray
        Poses of the links at eight configurations.
    course : ndarray, shape (degree + 1, dof)
    times : ndarray, shape (8,)
        The fractions of the course at which they are.
    link, fixed : int
        The piece's link and that of the other body, -1 if it stands.
    piece : int
    n : tuple of 3 float
        Unit normal in the other body's frame.
    bend : float
        Bound of `motion_bounds.ways_between`.
    out : ndarray, shape (8,)
        Receives upper bounds.
    """
    t = load(times, 0)
    normal = broadcast(n[0]), broadcast(n[1]), broadcast(n[2])
    if fixed >= 0:
        normal = apply(rotation_of_link(W, fixed), normal)
    zero = broadcast(0.0)
    center = outer_center(hot, piece)
    x = broadcast(center[0]), broadcast(center[1]), broadcast(center[2])
    x = image(rotation_of_link(W, link), translation_of_link(W, link), x)
    radius = hot[piece, OUTER_RADIUS]
    sums = (zero, zero, zero), (zero, zero, zero), zero, zero
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    path, up, down = tables.path_link, tables.path_start[link] + shared, 0
    if fixed >= 0:
        down = tables.path_start[fixed + 1] - tables.path_start[fixed] - shared
    # In the order seen from the other body: its own joints from its end on, backward, then the piece's.
    for k in range(down + tables.path_start[link + 1] - up):
        sign, at = (1.0, up + k - down) if k >= down else (-1.0, tables.path_start[fixed + 1] - 1 - k)
        joint = path[at]
        kind = tree.kind[joint]
        slides = kind == PRISMATIC or kind == PLANAR or kind == FLOATING
        if slides and k >= down:
            sums = _add_slide(sums, normal, _slide(tree, W, course, t, joint, sign))
        if kind != PRISMATIC:
            w, turning = _turn(tree, W, course, t, joint, sign)
            sums = _add_turn(sums, normal, x, radius, w, turning, translation_of_link(W, joint))
        if slides and k < down:
            sums = _add_slide(sums, normal, _slide(tree, W, course, t, joint, sign))
    _, r, value, size = sums
    r = apply_transposed(rotation_of_link(W, link), r)
    width, _ = outward_width(outer_shape(hot, piece), r, dot(r, r))
    store(out, 0, value + width + TERMS * (size + width + bend))


@njit()
def bend_of_bend(tree, tables, rates, course, width, body, link, fixed, bend):
    """Bound the second derivative of what `directed_bends` bounds: the fourth derivative of a body's points.

    Parameters
    ----------
    tree, tables
    rates : Rates
        On the course, or on the part that is considered.
    course : ndarray
        Control points of that part.
    width : float
        Share of the whole course.
    body, link, fixed : int
        As for `motion_bounds.ways_between`, whose bound `bend` is.
    bend : float

    Returns
    -------
    float
        Infinite if it is not bounded: orientations on courses of degree 2 or more.
    """
    degree = course.shape[0] - 1
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    turn = slide = turning = far = third = fourth = slide_third = slide_fourth = 0.0
    for side in range(2 if fixed >= 0 else 1):
        end = link if side == 0 else fixed
        for k in range(tables.path_start[end] + shared, tables.path_start[end + 1]):
            joint = tables.path_link[k]
            turn, slide = turn + rates.turn[joint], slide + rates.slide[joint]
            turning, far = turning + rates.turning[joint], far + rates.far[joint]
            kind, at, by = tree.kind[joint], tree.column[joint], abs(tree.multiplier[joint])
            if degree == 1:
                continue
            if kind == FLOATING or kind == BALL:
                return np.inf
            count = 3 if kind == PLANAR else 1
            for c in range(count):
                three, four = by * steepest(course, at + c, 3, width), by * steepest(course, at + c, 4, width)
                if kind == PRISMATIC or (kind == PLANAR and c < 2):
                    slide_third, slide_fourth = slide_third + three, slide_fourth + four
                else:
                    third, fourth = third + three, fourth + four
    if degree == 1:
        return REMAINDER_STRAIGHT * bend * turn * turn * UPWARD
    reach = 0.0
    for k in range(len(tables.path_link)):
        reach = max(reach, tables.reach[body, tables.path_link[k]])
    rest = (reach + far) * (8.0 * turn * third + fourth)
    rest += 4.0 * (slide * third + slide_third * turn) + slide_fourth
    return (REMAINDER * bend * (turn * turn + turning) + rest) * UPWARD
