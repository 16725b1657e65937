"""Limits of position, velocity, acceleration and jerk: ROS's joint_limits.yaml, and the limits of one trajectory."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner import _validate
from loewner._files import read_regular, shown
from loewner._kernels import columns as tree_columns
from loewner._plausible import doubt_about_limits, doubt_about_velocity, warn
from loewner._read_only import KeepsReadOnly
from loewner._validate import Bools, Floats
from loewner.errors import FileError, InputError, UnknownNameError
from loewner.robots import Robot
from loewner.scene_files.yaml_scenes import yaml_data

# Seconds in which a joint reaches its velocity limit, if no acceleration limit is given.
UP_IN = 1.0

# How far a configuration may be outside a limit and still count as on it: what OMPL allows, for rounding.
ON_LIMIT = float(np.finfo(np.float64).eps)

# The largest file [bytes], and how deeply the limits may be nested in ROS's parameters.
MOST_BYTES = 2**24
DEEPEST = 8

# Kinds of limits in a file, and the attribute that each of them bounds.
KINDS = {"velocity": "velocity", "acceleration": "acceleration", "deceleration": "acceleration", "jerk": "jerk"}

# Keys of a joint. The last ones are allowed, since MoveIt and ros2_control have them, but do not affect trajectories.
KEYS = (
    *(key for kind in KINDS for key in (f"max_{kind}", f"has_{kind}_limits")),
    *("min_position", "max_position", "has_position_limits", "max_effort", "has_effort_limits", "angle_wraparound"),
    *("has_soft_limits", "soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
)


@dataclass(frozen=True, eq=False)
class JointLimits(KeepsReadOnly):
    """Limits of a robot's values; read by `load` from the ``joint_limits.yaml`` of MoveIt or ros2_control.

    Attributes
    ----------
    names : tuple of str
        As `Robot.configuration_names`.
    lower, upper : ndarray, shape (dof,)
        Limits of position [rad or m].
    velocity, acceleration, jerk : ndarray, shape (dof,)
        In rad or m per second, per second squared and per second cubed. All limits are infinite where there are none.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "joint_limits: {elbow: {has_jerk_limits: true, max_jerk: 50.0, max_velocity: 2}}"
    >>> _ = Path("joint_limits.yaml").write_text("default_velocity_scaling_factor: 0.5\\n" + text)
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> limits = JointLimits.load("joint_limits.yaml", robot)
    >>> limits.velocity, limits.jerk, JointLimits.load("joint_limits.yaml", robot, scaled=True).velocity
    (array([1., 2.]), array([inf, 50.]), array([0.5, 1. ]))
    """

    names: tuple[str, ...]
    lower: Floats
    upper: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats

    @classmethod
    def load(cls, path: str | os.PathLike[str], robot: Robot, *, scaled: bool = False) -> JointLimits:
        """Read limits from a file; they replace the URDF's limits of the same joints.

        Parameters
        ----------
        path : path
            A YAML file with the key ``joint_limits``, also within ROS's parameters. For each joint,
            ``has_velocity_limits: true`` and ``max_velocity`` give a limit, and ``has_velocity_limits: false`` means
            that there is none; likewise for accelerations, decelerations and jerk, and for ``min_position`` and
            ``max_position``. A limit of a joint that mimics another bounds the other joint; its positions are ignored.
        robot : Robot
        scaled : bool
            Multiply velocities and accelerations by the file's default scaling factors, which are at most 1.

        Returns
        -------
        JointLimits

        Raises
        ------
        FileError
            If the file does not exist, contains no limits, a key of a joint is unknown, or a limit is malformed.
        UnknownNameError
            If the robot lacks a joint of the file; the message lists such joints and the robot's.
        MissingExtraError
            If PyYAML is not installed.

        Warns
        -----
        UserWarning
            Once, if limits of a joint that turns are probably in degrees.

        Examples
        --------
        >>> from pathlib import Path
        >>> _ = Path("limits.yaml").write_text("joint_limits: {rail: {min_position: 0.5, max_acceleration: 3}}")
        >>> JointLimits.load("limits.yaml", Robot.from_urdf("arm.urdf")).lower
        array([ 0.5, -inf])
        """
        source = _validate.path(path, "path")
        expect_robot(robot)
        holder = _holder(yaml_data(read_regular(source, "limits of joints", MOST_BYTES), source), DEEPEST)
        if holder is None:
            raise FileError(f"{shown(source)}: expected the key joint_limits with joints below it, found none")
        try:
            limits, doubts = _read(holder, robot, _validate.flag(scaled, "scaled"))
        except InputError as error:
            raise FileError(f"{shown(source)}: {error}") from None
        except UnknownNameError as error:
            raise UnknownNameError(f"{shown(source)}: {error}") from None
        if doubts:
            warn(f"{shown(source)}: {doubts[0]}" + (f" ({len(doubts) - 1} more like it)" if len(doubts) > 1 else ""))
        return limits


def expect_robot(robot: Robot) -> None:
    """Raise an InputError for anything but a robot."""
    if not isinstance(robot, Robot):
        raise InputError(f"robot: expected loewner.Robot, found {type(robot).__name__}")


def limits_of(
    robot: Robot,
    rows: Floats,
    given: JointLimits | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
    jerk: ArrayLike | None,
) -> tuple[Floats, Floats, Floats | None]:
    """Return limits of velocity, acceleration and perhaps jerk, shape (dof,); infinite for joints that do not move.

    The positions of a path are checked against given limits.
    """
    if given is not None and not (isinstance(given, JointLimits) and given.names == robot.configuration_names):
        found = f"those of {', '.join(given.names)}" if isinstance(given, JointLimits) else type(given).__name__
        raise InputError(f"limits: expected planners.JointLimits of {robot.name!r}, found {found}")
    if given is not None:
        _expect_within(robot, rows, given)
    moves = (rows != rows[0]).any(axis=0)
    known = robot.velocity if given is None else given.velocity
    fastest = known if velocity is None else _per_joint(robot, velocity, "velocity")
    unknown = moves & ~np.isfinite(fastest)
    if unknown.any():
        names = ", ".join(name for name, none in zip(robot.configuration_names, unknown, strict=True) if none)
        removed = given is not None and np.isfinite(robot.velocity[unknown]).all()
        where = "above 0 in the URDF" + ("" if given is None else " or in limits=")
        where = "in limits=, whose file removed the URDF's (has_velocity_limits: false)," if removed else where
        raise InputError(
            f"velocity: expected a limit of each joint that moves, found none {where} for {names}; "
            f"give velocity=, one number or {robot.dof}"
        )
    strongest = np.where(np.isfinite(robot.acceleration), robot.acceleration, fastest / UP_IN)
    if acceleration is not None:
        strongest = _per_joint(robot, acceleration, "acceleration")
    if given is not None and acceleration is None:
        strongest = np.where(np.isfinite(given.acceleration), given.acceleration, strongest)
    most = None if jerk is None else np.where(moves, _per_joint(robot, jerk, "jerk"), np.inf)
    known = np.where(np.isnan(robot.jerk), np.inf, robot.jerk)
    if given is not None:
        known = np.where(np.isfinite(given.jerk), given.jerk, known)
    if jerk is None and np.isfinite(known[moves]).any():
        most = np.where(moves, known, np.inf)
    return np.where(moves, fastest, np.inf), np.where(moves, strongest, np.inf), most


def _expect_within(robot: Robot, rows: Floats, given: JointLimits) -> None:
    """Raise an InputError for a position outside the limits; blends and profiles stay within the hull of the rows.

    Where the file does not change a limit, the hard limit of the joint counts: a plan may start outside the soft ones.
    """
    lower = np.where(given.lower == robot.lower, robot.hard_lower, given.lower)
    upper = np.where(given.upper == robot.upper, robot.hard_upper, given.upper)
    for row, k in np.argwhere((rows < lower - ON_LIMIT) | (rows > upper + ON_LIMIT))[:1]:
        raise InputError(
            f"path: expected positions within limits=, found {given.names[k]} = {rows[row, k]:.9g} outside "
            f"{lower[k]:.9g} .. {upper[k]:.9g}"
        )


def _per_joint(robot: Robot, limit: ArrayLike, name: str) -> Floats:
    """Check positive numbers, one or one per joint, and return one per joint."""
    array = _validate.positive_array(limit, name, ("...",))
    if array.shape not in ((), (robot.dof,)):
        raise InputError(
            f"{name}: expected one number or shape ({robot.dof},), found {_validate.shape_text(array.shape)}"
        )
    return np.broadcast_to(array, robot.dof)


def _holder(held: Any, depth: int) -> Any:
    """Find the first mapping with limits of joints, however it is wrapped; None if there is none."""
    if not isinstance(held, Mapping) or depth == 0:
        return None
    if isinstance(held.get("joint_limits"), Mapping):
        return held
    found = (_holder(each, depth - 1) for each in held.values())
    return next((each for each in found if each is not None), None)


def _read(holder: Mapping[Any, Any], robot: Robot, scaled: bool) -> tuple[JointLimits, list[str]]:
    """Return the limits, and why some may be in degrees."""
    columns = {name: (k, 1.0) for k, name in enumerate(robot.configuration_names)}
    columns |= {name: (columns[joint][0], factor) for name, (joint, factor) in robot.mimics.items() if joint in columns}
    limits = {kind: np.full(robot.dof, np.nan) for kind in ("lower", "upper", *KINDS.values())}
    _expect_joints(list(holder["joint_limits"]), columns)
    turns, doubts = _turning(robot), []
    for name, entry in holder["joint_limits"].items():
        if not isinstance(entry, Mapping) or not entry:
            raise InputError(f"{name}: expected limits by their names, found {_validate.short(entry)}")
        for key in entry:
            if key not in KEYS:
                raise InputError(str(_validate.unknown_name(f"{name}: key", key, KEYS)))
        k, factor = columns[name]
        own = {}
        for kind, attribute in KINDS.items():
            limit = own[kind] = _limit(entry, name, kind, f"max_{kind}", np.inf, _validate.positive_scalar)
            if limit is not None and factor != 0:
                limits[attribute][k] = np.fmin(limits[attribute][k], limit / abs(factor))
        for attribute, key, none in (("lower", "min_position", -np.inf), ("upper", "max_position", np.inf)):
            limit = own[attribute] = _limit(entry, name, "position", key, none, _validate.real)
            if limit is not None and name not in robot.mimics:
                limits[attribute][k] = limit
        if turns[k]:
            lower, upper, velocity = (own[kind] or 0.0 for kind in ("lower", "upper", "velocity"))
            texts = doubt_about_limits(lower, upper), doubt_about_velocity(velocity)
            doubts += [f"{name}: expected {text}" for text in texts if text]
    for attribute, known in (("lower", robot.lower), ("upper", robot.upper), ("velocity", robot.velocity)):
        limits[attribute] = np.where(np.isnan(limits[attribute]), known, limits[attribute])
    for k in np.flatnonzero(limits["lower"] > limits["upper"])[:1]:
        found = f"{limits['lower'][k]:g} and {limits['upper'][k]:g}"
        raise InputError(f"{robot.configuration_names[k]}: expected min_position <= max_position, found {found}")
    for kind in ("velocity", "acceleration"):
        key = f"default_{kind}_scaling_factor"
        factor = _validate.positive_scalar(holder.get(key, 1.0), key)
        if scaled and factor > 1:
            raise InputError(f"{key}: expected at most 1 with scaled=True, found {factor:g}")
        limits[kind] = limits[kind] * (factor if scaled else 1.0)
    for array in limits.values():
        array[np.isnan(array)] = np.inf
        array.setflags(write=False)
    return JointLimits(robot.configuration_names, **limits), doubts


def _expect_joints(names: list[Any], known: Mapping[str, Any]) -> None:
    """Raise an UnknownNameError that names all joints that the robot lacks."""
    unknown = [name for name in names if name not in known]
    if unknown:
        more = ", ".join(map(_validate.short, unknown[1 : _validate.LISTED]))
        more += f" and {len(unknown) - _validate.LISTED} more" if len(unknown) > _validate.LISTED else ""
        error = _validate.unknown_name("joint", unknown[0], known)
        raise UnknownNameError(f"{error}" + (f"; also unknown: {more}" if more else ""))


def _turning(robot: Robot) -> Bools:
    """Return which values are angles of all joints that follow them, shape (dof,)."""
    kind, column, turning = robot.tree.kind, robot.tree.column, np.zeros(robot.dof, dtype=bool)
    turning[column[kind == tree_columns.REVOLUTE]] = True
    turning[column[(kind != tree_columns.REVOLUTE) & (kind != tree_columns.FIXED)]] = False
    return turning


def _limit(
    entry: Mapping[Any, Any], joint: str, kind: str, key: str, none: float, check: Callable[[Any, str], float]
) -> float | None:
    """Return a limit of a joint: `none` if its entry declares that there is none, None if it declares nothing."""
    has, value = entry.get(f"has_{kind}_limits"), entry.get(key)
    if has is not None and not _validate.flag(has, f"{joint}: has_{kind}_limits"):
        return none
    if value is not None:
        return check(value, f"{joint}: {key}")
    if has and kind != "position":
        raise InputError(f"{joint}: expected {key} with has_{kind}_limits, found none")
    return None
