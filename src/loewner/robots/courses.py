"""Courses, that is, motions as arrays of control points, shape (N, degree + 1, dof); see `motion_path`."""

from __future__ import annotations

import math

import numpy as np

from loewner._validate import Floats
from loewner.robots.robot import Robot, interpolated, on_the_way


def straight(robot: Robot, a: Floats, b: Floats) -> Floats:
    """Make courses of the straight motions between configurations a and b, shape (N, dof); see `Robot.between`."""
    courses = np.empty((len(a), 2, robot.dof))  # for one motion, `np.stack` takes four times as long
    courses[:, 0], courses[:, 1] = a, on_the_way(robot, a, b)
    return courses


def configurations(robot: Robot, courses: Floats, fractions: Floats) -> Floats:
    """Evaluate each course at a fraction of its own, shape (N,): configurations of shape (N, dof)."""
    degree = courses.shape[1] - 1
    if degree == 1:
        return interpolated(robot, courses[:, 0], courses[:, 1], fractions[:, None])
    t = fractions[:, None]
    weights = [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)]
    Q: Floats = np.einsum("knc,nkc->nc", np.broadcast_to(weights, (degree + 1, *courses[:, 0].shape)), courses)
    for columns in robot._quaternions.values():
        Q[:, columns] /= np.linalg.norm(Q[:, columns], axis=1, keepdims=True)
    return Q
