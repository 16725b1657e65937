"""Courses: the configurations through which a motion passes, and the parts of a course.

A course of degree d is an array of shape (d + 1, dof), the control points of a Bézier curve over the fractions from 0
to 1. A straight motion has degree 1: its values change linearly, and its orientations turn at a constant rate. On a
course of a higher degree, values are polynomials, and quaternions are polynomials that are scaled to norm 1.

Control points bound a curve and its derivatives. A polynomial stays within the convex hull of its control points, and
the control points of its derivative are d times the differences of neighbouring control points.
"""

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.elementary import arc_cosine
from loewner._kernels.robots.kinematics import quaternion_of
from loewner._kernels.simd.trig import sine_of
from loewner._kernels.simd.vectors import LANES, load, rounded_product, select, sqrt, store

SMALL_ANGLE = 1e-6  # Angle [rad] below which an arc is replaced by its chord.
SMALL_COSINE = 1.0 - 4e-13  # Cosine of an angle that is certainly below SMALL_ANGLE.
SMALLEST_SINE = 1e-12


@inline
def _value(course, c, t):
    """Value of a column at one or eight fractions; polynomials by Horner's scheme for the Bernstein form."""
    degree = course.shape[0] - 1
    if degree == 1:
        a, b = course[0, c], course[1, c]
        return select(t >= 1.0, b, a + rounded_product(t, b - a))
    s, binomial = 1.0 - t, 1.0
    power, value = 1.0 + 0.0 * t, course[0, c] + 0.0 * t
    for k in range(1, degree + 1):
        power = power * t
        binomial = binomial * (degree - k + 1) / k
        value = value * s + binomial * power * course[k, c]
    return value


@inline
def _quaternion(course, at, t):
    """Unit quaternion at one or eight fractions: by a polynomial, or on the arc (at most 90°) between two ends."""
    if course.shape[0] == 2:
        cosine = 0.0
        for k in range(at, at + 4):
            cosine += course[0, k] * course[1, k]
        angle = arc_cosine(cosine) if cosine < SMALL_COSINE else 0.0
        of_p, of_q = 1.0 - t, t
        if angle >= SMALL_ANGLE:
            sine = max(sine_of(angle), SMALLEST_SINE)
            of_p, of_q = sine_of((1.0 - t) * angle) / sine, sine_of(t * angle) / sine
        w, x = of_p * course[0, at] + of_q * course[1, at], of_p * course[0, at + 1] + of_q * course[1, at + 1]
        y, z = of_p * course[0, at + 2] + of_q * course[1, at + 2], of_p * course[0, at + 3] + of_q * course[1, at + 3]
    else:
        w, x, y, z = (
            _value(course, at, t), _value(course, at + 1, t), _value(course, at + 2, t), _value(course, at + 3, t),
        )  # fmt: skip
    norm = sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


@njit()
def configuration_at(tree, course, t, Q, row):
    """Write the configuration at a fraction of a course to a row of Q.

    Parameters
    ----------
    tree : Tree
    course : ndarray, shape (degree + 1, dof)
        Control points of the course. The quaternions q and -q are the same orientation; each quaternion must be nearer
        to the quaternion of the previous row than its negative is.
    t : float
        From 0 to 1.
    Q : ndarray, shape (N, dof)
    row : int
    """
    for c in range(course.shape[1]):
        Q[row, c] = _value(course, c, t)
    for link in range(tree.kind.size):
        at = quaternion_of(tree, link)
        if at >= 0:
            Q[row, at], Q[row, at + 1], Q[row, at + 2], Q[row, at + 3] = _quaternion(course, at, t)


@apart
def configurations_at(tree, course, times, first, columns):
    """Write the configurations at the fractions times[first : first + 8] of a course to a flat array by columns."""
    t = load(times, first)
    for c in range(course.shape[1]):
        store(columns, c * LANES, _value(course, c, t))
    for link in range(tree.kind.size):
        at = quaternion_of(tree, link)
        if at >= 0:
            w, x, y, z = _quaternion(course, at, t)
            store(columns, at * LANES, w)
            store(columns, (at + 1) * LANES, x)
            store(columns, (at + 2) * LANES, y)
            store(columns, (at + 3) * LANES, z)


@njit()
def write_part(course, low, high, scratch, part):
    """Write the control points of a part of a course, by de Casteljau's scheme.

    Parameters
    ----------
    course : ndarray, shape (degree + 1, dof)
    low, high : float
        Fractions at which the part begins and ends.
    scratch : ndarray, shape (degree + 1,)
    part : ndarray, shape (degree + 1, dof)
        Receives the control points of the part.
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
