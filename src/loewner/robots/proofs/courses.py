"""Courses, that is, motions as arrays of control points, shape (N, degree + 1, dof); see `motion_path`."""

from __future__ import annotations

import math

import numpy as np

from loewner._base._matrices import lengths, power
from loewner._base._validate import Floats
from loewner._kernels import tolerances
from loewner.robots.description.robot import Robot, interpolated, on_the_way

# Bound on the error of control points that are converted from another form, relative to their largest numbers.
CURVE_ROUNDINGS = 128.0 * tolerances.UNIT_ROUNDOFF  # certified.md B51


def straight(robot: Robot, a: Floats, b: Floats) -> Floats:
    """Make courses of the straight motions between configurations a and b, shape (N, dof); see `Robot.between`."""
    courses = np.empty((len(a), 2, robot.dof))  # for one motion, `np.stack` takes four times as long
    courses[:, 0], courses[:, 1] = a, on_the_way(robot, a, b)
    return courses


def configurations(robot: Robot, courses: Floats, fractions: Floats) -> Floats:
    """Compute the configuration of each course at its own fraction, shape (N,); the result has shape (N, dof)."""
    degree = courses.shape[1] - 1
    if degree == 1:
        return interpolated(robot, courses[:, 0], courses[:, 1], fractions[:, None])
    t = fractions[:, None]
    Q = np.zeros(courses[:, 0].shape)
    for k in range(degree + 1):  # as in C (`evaluate` in `queries.c`), so that both give the same bits
        Q += math.comb(degree, k) * power(t, k) * power(1 - t, degree - k) * courses[:, k]
    for columns in robot._quaternions.values():
        Q[:, columns] /= lengths(Q[:, columns])[:, None]
    return Q


def at_fractions(courses: Floats, fractions: Floats) -> Floats:
    """Compute values of all courses at the same fractions, shape (m,), by de Casteljau's scheme: shape (N, m, dof)."""
    points, t = np.repeat(courses[:, None], len(fractions), axis=1), fractions[:, None, None]
    while points.shape[2] > 1:
        points = (1 - t) * points[:, :, :-1] + t * points[:, :, 1:]
    return np.asarray(points[:, :, 0])


def elevated(points: Floats, by: int) -> Floats:
    """Raise the degree of courses without changing their motions."""
    for _ in range(by):
        degree = points.shape[1] - 1
        share = (np.arange(1, degree + 1) / (degree + 1))[:, None]
        inner = share * points[:, :-1] + (1 - share) * points[:, 1:]
        points = np.concatenate([points[:, :1], inner, points[:, -1:]], axis=1)
    return points


def between(robot: Robot, courses: Floats, low: Floats, high: Floats) -> Floats:
    """Return the part of each course between two fractions, shape (N,) each; see `parts` for curved courses."""
    if courses.shape[1] > 2:
        return parts(courses, low, high)
    return np.stack([interpolated(robot, courses[:, 0], courses[:, 1], f[:, None]) for f in (low, high)], axis=1)


def parts(courses: Floats, low: Floats, high: Floats) -> Floats:
    """Return the part of each course between two fractions, shape (N,) each, by de Casteljau's scheme."""
    degree, cut_courses = courses.shape[1] - 1, np.empty_like(courses)
    for k in range(degree + 1):
        points = courses
        for step in range(degree):
            t = (high if step < k else low)[:, None, None]
            points = (1.0 - t) * points[:, :-1] + t * points[:, 1:]
        cut_courses[:, k] = points[:, 0]
    return cut_courses
