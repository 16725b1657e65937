"""Courses: the configurations that a motion passes, and the parts of a course.

A course of degree d is an array of shape (d + 1, dof), the control points of a Bézier curve over the fractions from 0
to 1. A straight motion has degree 1: its values change linearly, and its orientations turn at a constant rate. On a
course of a higher degree, values are polynomials, and quaternions are polynomials that are scaled to norm 1.

Control points bound a curve and its derivatives: a polynomial stays within the convex hull of its control points, and
the control points of its derivative are the differences of neighbours times d.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.robots.kinematics import quaternion_of
from loewner._kernels.simd.vectors import rounded_product

SMALL_ANGLE = 1e-6  # rad; below it the chord equals the arc
SMALLEST_SINE = 1e-12


@inline
def _slerp(course, at, t, Q, row):
    """Write the quaternion on the arc between two, which are at most a right angle apart."""
    cosine = 0.0
    for k in range(at, at + 4):
        cosine += course[0, k] * course[1, k]
    angle = np.arccos(min(cosine, 1.0))
    sine = max(np.sin(angle), SMALLEST_SINE)
    of_p, of_q = 1.0 - t, t
    if angle >= SMALL_ANGLE:
        of_p, of_q = np.sin((1.0 - t) * angle) / sine, np.sin(t * angle) / sine
    for k in range(at, at + 4):
        Q[row, k] = of_p * course[0, k] + of_q * course[1, k]


@inline
def _scale_to_unit(Q, row, at):
    squares = 0.0
    for k in range(at, at + 4):
        squares += Q[row, k] * Q[row, k]
    norm = np.sqrt(squares)
    for k in range(at, at + 4):
        Q[row, k] /= norm


@inline
def _polynomial(course, c, t):
    """Value of a column at a fraction, by Horner's scheme for Bernstein polynomials."""
    degree = course.shape[0] - 1
    s, power, binomial, value = 1.0 - t, 1.0, 1.0, course[0, c]
    for k in range(1, degree + 1):
        power *= t
        binomial = binomial * (degree - k + 1) / k
        value = value * s + binomial * power * course[k, c]
    return value


@njit()
def configuration_at(tree, course, t, Q, row):
    """Write the configuration at a fraction of a course to a row of Q.

    Parameters
    ----------
    tree : Tree
    course : ndarray, shape (degree + 1, dof)
        Among q and -q, which are the same orientation, a quaternion is the one nearer to the previous row.
    t : float
        From 0 to 1.
    Q : ndarray, shape (N, dof)
    row : int
    """
    straight = course.shape[0] == 2
    for c in range(course.shape[1]):
        if straight:
            a, b = course[0, c], course[1, c]
            Q[row, c] = a + rounded_product(t, b - a) if t != 1.0 else b
        else:
            Q[row, c] = _polynomial(course, c, t)
    for link in range(tree.kind.size):
        at = quaternion_of(tree, link)
        if at >= 0:
            if straight:
                _slerp(course, at, t, Q, row)
            _scale_to_unit(Q, row, at)


@njit()
def write_part(course, low, high, scratch, part):
    """Write the control points of a part of a course, by de Casteljau's scheme.

    Parameters
    ----------
    course : ndarray, shape (degree + 1, dof)
    low, high : float
        The fractions at which the part begins and ends.
    scratch : ndarray, shape (degree + 1,)
    part : ndarray, shape (degree + 1, dof)
        Receives them.
    """
    degree = course.shape[0] - 1
    for c in range(course.shape[1]):
        for k in range(degree + 1):
            for i in range(degree + 1):
                scratch[i] = course[i, c]
            for step in range(degree):
                t = high if step < k else low
                for i in range(degree - step):
                    scratch[i] = (1.0 - t) * scratch[i] + t * scratch[i + 1]
            part[k, c] = scratch[0]
