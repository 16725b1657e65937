"""Remove points on the robot, and on bodies that move with it, from a sensor's points."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._matrices import lengths
from loewner._base._validate import Bools, Floats
from loewner.bodies import Body
from loewner.errors import InputError
from loewner.queries.pairs import collide

# Boxes grow by the share ROUNDING of the lengths involved, which is far more than the rounding errors of their sides.
ROUNDING = 1e-9

# Balls are cached, since a camera's loop passes the same distance in each frame. Making a ball takes as long as testing
# thousands of points.
_ball = functools.lru_cache(maxsize=8)(Body.sphere)


@overload
def off_the_robot(
    self: Any, points: ArrayLike, q: ArrayLike, *,
    clear: float = ..., time: float | None = ..., mask: Literal[False] = ...,
) -> Floats: ...  # fmt: skip
@overload
def off_the_robot(
    self: Any, points: ArrayLike, q: ArrayLike, *, clear: float = ..., time: float | None = ..., mask: Literal[True],
) -> Bools: ...  # fmt: skip
def off_the_robot(
    self: Any, points: ArrayLike, q: ArrayLike, *, clear: float = 0.03, time: float | None = None, mask: bool = False
) -> Floats | Bools:  # fmt: skip
    """Keep a sensor's points that are neither on the robot nor on a body that the robot carries.

    A point is removed if it is inside, or within `clear` of, a link's body or a body that is attached to a link. With
    ``time``, points on bodies of the scene that follow motions are also removed, with the bodies at their poses for
    that time. All other points are kept; the test is exact.

    Parameters
    ----------
    points : array_like, shape (..., 3)
        Points in world coordinates, in metres: a list, or an organised cloud. Points that are not finite are dropped.
    q : array_like, shape (dof,)
        The configuration at which the points were measured.
    clear : float
        Distance in metres, > 0. It must exceed the sensor's noise and the error of the robot's own pose.
    time : float, optional
        Time in seconds, on the clock of the scene's motions. By default, points on bodies that follow motions are kept.
    mask : bool
        Return a mask of the points that are kept.

    Returns
    -------
    ndarray, shape (m, 3)
        The remaining points, in the same order; with `mask`, an ndarray of bool, shape (...).

    Raises
    ------
    InputError
        If a shape is wrong, ``q`` or ``time`` is not finite, or ``clear`` is not positive.
    ConvergenceError
        As for `collide`.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> checker = CollisionChecker(robot)
    >>> at_tool = robot.forward_kinematics([0.2, 0.0])[-1, :3, 3]
    >>> checker.off_the_robot([at_tool, [5.0, 0.0, 0.0], [np.nan, 0.0, 0.0]], [0.2, 0.0])
    array([[5., 0., 0.]])
    """
    cloud = _validate.float_array(points, "points")
    if cloud.shape[-1:] != (3,):
        raise InputError(f"points: expected shape (..., 3), found {_validate.shape_text(cloud.shape)}")
    reach = _validate.positive_scalar(clear, "clear")
    place = self.robot.checked_one(q)
    now = None if time is None else float(_validate.finite_array(time, "time", ()))

    flat = cloud.reshape(-1, 3)
    stays: Bools = np.asarray(np.isfinite(flat).all(axis=1))
    columns, ball = np.ascontiguousarray(flat.T), _ball(reach)
    for body, T in _moving(self, place, now):
        low, high = _box(body, T, reach)
        # Compare one coordinate after another, since most points are already outside the first range.
        near = np.flatnonzero(stays & (columns[0] >= low[0]) & (columns[0] <= high[0]))
        for k in (1, 2):
            near = near[(columns[k, near] >= low[k]) & (columns[k, near] <= high[k])]
        if len(near):
            balls = np.tile(np.eye(4), (len(near), 1, 1))
            balls[:, :3, 3] = flat[near]
            stays[near[collide(ball, balls, body, T)]] = False
    if _validate.flag(mask, "mask"):
        return np.asarray(stays.reshape(cloud.shape[:-1]))
    return np.asarray(flat[stays])


def _moving(checker: Any, q: Floats, time: float | None) -> Iterator[tuple[Body, Floats]]:
    """Yield the bodies whose points are removed, with their poses."""
    robot, scene = checker.robot, checker.scene
    poses = dict(zip(robot.link_names, robot.forward_kinematics(q), strict=True))
    for link, body in robot.bodies.items():
        yield body, poses[link]
    for name, held in scene.attachments.items():
        yield scene[name], poses[held.link] @ held.T_link_body
    if time is not None:
        for name, path in scene.following.items():
            yield scene[name], path.poses(time)


def _box(body: Body, T: Floats, reach: float) -> tuple[Floats, Floats]:
    """Compute a box that contains a placed body and its surroundings, from its outer ellipsoids."""
    outer = body.outer
    center = outer.center @ T[:3, :3].T + T[:3, 3]
    half = lengths(T[:3, :3] @ outer.factor) + reach
    half += ROUNDING * (np.abs(center) + half + np.abs(outer.center).sum(axis=-1, keepdims=True))
    return (center - half).min(axis=0), (center + half).max(axis=0)
