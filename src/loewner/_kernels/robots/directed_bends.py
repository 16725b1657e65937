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
from loewner._kernels.columns import ACROSS, ALONG, BALL, FLOATING, PLANAR, PRISMATIC, REVOLUTE, ROTATION
from loewner._kernels.ellipsoids.contact import outward_width
from loewner._kernels.linalg3 import (
    along,
    apply,
    apply_transposed,
    cross,
    dot,
    image,
    minus,
    plus,
    scaled,
)
from loewner._kernels.robots.kinematics import axis_of, direction_of, rotation_of_link, translation_of_link
from loewner._kernels.robots.motion_bounds import UPWARD, shared_joints, steepest
from loewner._kernels.robots.sweeps import outer_center, outer_shape
from loewner._kernels.simd.vectors import LANES, absolute, broadcast, load, store

# Relative errors of the terms, from rounding and from rotations that are accepted as orthonormal.
TERMS = 1e-4  # derived 1.1e-5, certified.md B52

# Vectors of a joint at eight configurations: angular velocity and velocity, then their derivatives.
_TURN, _SLIDE, _TURNING, _SLIDING, RATES = 0, 3 * LANES, 6 * LANES, 9 * LANES, 12 * LANES

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
def _in_world(W, link, v):
    return apply(rotation_of_link(W, link), v) if link >= 0 else v


@inline
def _store_three(V, at, v):
    store(V, at, v[0])
    store(V, at + LANES, v[1])
    store(V, at + 2 * LANES, v[2])


@inline
def _load_three(V, at):
    return load(V, at), load(V, at + LANES), load(V, at + 2 * LANES)


@inline
def _slide(tree, W, course, t, link, order):
    """First or second derivative of the place to which a joint slides."""
    kind, at, above, constants = tree.kind[link], tree.column[link], tree.parent[link], tree.constants
    zero = broadcast(0.0)
    slide = zero, zero, zero
    if kind == PRISMATIC:
        slide = scaled(_derivative(course, at, t, order) * tree.multiplier[link], direction_of(constants, link, ACROSS))
    elif kind == PLANAR:
        slide = scaled(_derivative(course, at, t, order), direction_of(constants, link, ACROSS))
        slide = along(slide, _derivative(course, at + 1, t, order), direction_of(constants, link, ALONG))
    elif kind == FLOATING:
        slide = apply(
            direction_of(constants, link, ROTATION) + direction_of(constants, link, ROTATION + 3)
            + direction_of(constants, link, ROTATION + 6),
            (_derivative(course, at, t, order), _derivative(course, at + 1, t, order),
             _derivative(course, at + 2, t, order)),
        )  # fmt: skip
    return _in_world(W, above, slide)


@njit()
def write_rates(tree, W, course, times, V):
    """Write how joints turn and slide at eight configurations, in the axes of the world.

    Parameters
    ----------
    tree : Tree
    W : ndarray
        Poses of the links at these configurations.
    course : ndarray, shape (degree + 1, dof)
    times : ndarray, shape (8,)
        Their fractions.
    V : ndarray
        Receives RATES numbers per link. On straight motions the second half of them is neither written nor read.
    """
    t = load(times, 0)
    straight = course.shape[0] == 2
    for link in range(tree.kind.size):
        kind, column, at = tree.kind[link], tree.column[link], link * RATES
        if kind == PRISMATIC or kind == PLANAR or kind == FLOATING:
            _store_three(V, at + _SLIDE, _slide(tree, W, course, t, link, 1))
            if not straight:
                _store_three(V, at + _SLIDING, _slide(tree, W, course, t, link, 2))
        if kind == REVOLUTE or kind == PLANAR:
            axis = apply(rotation_of_link(W, link), axis_of(tree.constants, link))
            c, by = column + (2 if kind == PLANAR else 0), tree.multiplier[link]
            _store_three(V, at + _TURN, scaled(_derivative(course, c, t, 1) * by, axis))
            if not straight:
                _store_three(V, at + _TURNING, scaled(_derivative(course, c, t, 2) * by, axis))
        elif kind == FLOATING or kind == BALL:
            v = _turning_vector(course, column + (3 if kind == FLOATING else 0))
            _store_three(V, at + _TURN, apply(rotation_of_link(W, link), v))


@njit()
def directed_bends(tree, tables, hot, W, V, straight, link, fixed, piece, n, out):
    """Write the largest second derivatives along n of a piece's points, relative to another body.

    Parameters
    ----------
    tree : Tree
    tables : MotionTables
    hot : ndarray
        Outer ellipsoids of pieces, in the frames of their bodies.
    W : ndarray
        Poses of the links at eight configurations.
    V : ndarray
        The rates of joints there, see `write_rates`.
    straight : bool
        Whether the course is straight.
    link, fixed : int
        The piece's link and that of the other body, -1 if it stands.
    piece : int
    n : tuple of 3 float
        Unit normal in the other body's frame.
    out : ndarray, shape (8,)
        Receives them, but for `error_of_terms`.
    """
    n = broadcast(n[0]), broadcast(n[1]), broadcast(n[2])
    if fixed >= 0:
        n = apply(rotation_of_link(W, fixed), n)
    zero = broadcast(0.0)
    R, center = rotation_of_link(W, link), outer_center(hot, piece)
    center = broadcast(center[0]), broadcast(center[1]), broadcast(center[2])
    x = image(R, translation_of_link(W, link), center)
    e, r, value = (zero, zero, zero), (zero, zero, zero), zero
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    path, up, down = tables.path_link, tables.path_start[link] + shared, 0
    if fixed >= 0:
        down = tables.path_start[fixed + 1] - tables.path_start[fixed] - shared
    # In the order seen from the other body: its own joints from its end on, backward, then the piece's.
    for k in range(down + tables.path_start[link + 1] - up):
        sign, number = (1.0, up + k - down) if k >= down else (-1.0, tables.path_start[fixed + 1] - 1 - k)
        joint = path[number]
        kind, at, before = tree.kind[joint], joint * RATES, e
        if kind != PRISMATIC:
            off = minus(x, translation_of_link(W, joint))
            w = scaled(sign, _load_three(V, at + _TURN))
            own = cross(n, w)
            f = cross(plus(e, own), w)
            if not straight and kind != FLOATING and kind != BALL:
                f = plus(f, cross(n, scaled(sign, _load_three(V, at + _TURNING))))
            e, r, value = along(e, 2.0, own), plus(r, f), value + dot(f, off)
        if kind == PRISMATIC or kind == PLANAR or kind == FLOATING:
            # Seen from the other body, its own joints turn first, and the piece's slide first.
            if sign > 0.0:
                value = value + dot(before, _load_three(V, at + _SLIDE))
            else:
                value = value - dot(e, _load_three(V, at + _SLIDE))
            if not straight:
                value = value + sign * dot(n, _load_three(V, at + _SLIDING))
    width, _ = outward_width(outer_shape(hot, piece), apply_transposed(R, r), dot(r, r))
    store(out, 0, value + width)


@njit()
def fourth_derivative(tree, tables, rates, course, width, link, fixed, ways):
    """Bound the fourth derivatives of a body's points on a part of a course.

    Parameters
    ----------
    tree, tables
    rates : Rates
        On the part.
    course : ndarray
        Its control points.
    width : float
        Share of the whole course.
    link, fixed : int
        As for `motion_bounds.ways_between`.
    ways : Ways

    Returns
    -------
    float
        Infinite if they are not bounded: orientations on courses of degree 2 or more.
    """
    if course.shape[0] == 2:
        return REMAINDER_STRAIGHT * ways.bend * ways.turn * ways.turn * UPWARD
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    slide = third = fourth = slide_third = slide_fourth = 0.0
    for side in range(2 if fixed >= 0 else 1):
        end = link if side == 0 else fixed
        for k in range(tables.path_start[end] + shared, tables.path_start[end + 1]):
            joint = tables.path_link[k]
            kind, at, by = tree.kind[joint], tree.column[joint], abs(tree.multiplier[joint])
            if kind == FLOATING or kind == BALL:
                return np.inf
            slide += rates.slide[joint]
            for c in range(3 if kind == PLANAR else 1):
                three, four = by * steepest(course, at + c, 3, width), by * steepest(course, at + c, 4, width)
                if kind == PRISMATIC or (kind == PLANAR and c < 2):
                    slide_third, slide_fourth = slide_third + three, slide_fourth + four
                else:
                    third, fourth = third + three, fourth + four
    # No point is farther from a joint than all links are long.
    rest = (tables.chain[1] + ways.travel) * (8.0 * ways.turn * third + fourth)
    rest += 4.0 * (slide * third + slide_third * ways.turn) + slide_fourth
    return (REMAINDER * ways.bend * (ways.turn * ways.turn + ways.turning) + rest) * UPWARD


@inline
def error_of_terms(tables, ways, radius):
    """Bound the error of what `directed_bends` writes for a piece with an outer ellipsoid of this radius."""
    squares = ways.turn * ways.turn + ways.turning
    return TERMS * (squares * (tables.chain[1] + ways.travel + radius) + 2.0 * ways.turn * ways.speed + ways.bend)


@inline
def error_of_strays(tables, ways, astray, radius, width):
    """Bound what `directed_strays` leaves out within an interval of this width: its second derivative, and rounding."""
    size = tables.chain[1] + ways.travel + astray.travel + radius
    squares = ways.turn * ways.turn + ways.turning
    between = (astray.turn * size + astray.speed) * squares
    between += astray.turn * (2.0 * ways.turn * ways.speed + ways.bend)
    return between * width * width / 8.0 + TERMS * (astray.turn * size + astray.speed)


@njit()
def directed_strays(tree, tables, hot, W, strays, link, fixed, piece, n, out):
    """Bound how far a piece's points move along n, to first order, if joints deviate from eight configurations.

    Parameters
    ----------
    tree, tables, hot, W, link, fixed, piece, n
        As for `directed_bends`.
    strays : Rates
        Deviations of joints, see `motion_bounds.write_strays`.
    out : ndarray, shape (8,)
        Receives the bounds [m].
    """
    n = broadcast(n[0]), broadcast(n[1]), broadcast(n[2])
    if fixed >= 0:
        n = apply(rotation_of_link(W, fixed), n)
    R, center = rotation_of_link(W, link), outer_center(hot, piece)
    center = broadcast(center[0]), broadcast(center[1]), broadcast(center[2])
    x = image(R, translation_of_link(W, link), center)
    shape, total = outer_shape(hot, piece), broadcast(0.0)
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    for side in range(2 if fixed >= 0 else 1):
        end = link if side == 0 else fixed
        for k in range(tables.path_start[end] + shared, tables.path_start[end + 1]):
            joint = tables.path_link[k]
            kind, turn, slide = tree.kind[joint], strays.turn[joint], strays.slide[joint]
            if kind == PRISMATIC:
                d = _in_world(W, tree.parent[joint], direction_of(tree.constants, joint, ACROSS))
                total = total + absolute(dot(n, d)) * slide
            elif turn > 0.0 and (kind == REVOLUTE or kind == PLANAR):
                m = cross(n, apply(rotation_of_link(W, joint), axis_of(tree.constants, joint)))
                width, _ = outward_width(shape, apply_transposed(R, m), dot(m, m))
                total = total + (absolute(dot(m, minus(x, translation_of_link(W, joint)))) + width) * turn
                total = total + slide
            else:
                total = total + (turn * (tables.chain[1] + strays.far[joint]) + slide)
    store(out, 0, total)
