"""Read position, velocity, acceleration and jerk limits from joint_limits.yaml, and find the limits of a trajectory."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._files import read_regular, shown
from loewner._base._nodes import Node, read_yaml, some
from loewner._base._plausible import doubt_about_limits, doubt_about_velocity, warn
from loewner._base._read_only import KeepsReadOnly, protected
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns as tree_columns
from loewner.errors import InputError, UnknownNameError
from loewner.robots import Robot

# If no acceleration limit is given, a joint reaches its velocity limit in this time [s].
UP_IN = 1.0

# A configuration outside a limit by no more than this rounding error counts as on the limit, as in OMPL.
ON_LIMIT = float(np.finfo(np.float64).eps)

# The largest file [bytes].
MOST_BYTES = 2**24

# Kinds of limits in a file, and the attribute of `JointLimits` for each kind.
KINDS = {"velocity": "velocity", "acceleration": "acceleration", "deceleration": "acceleration", "jerk": "jerk"}

# Keys of a joint. The last keys do not affect trajectories: MoveIt and ros2_control use them for forces, gains and
# angles that wrap around.
KEYS = (
    *(key for kind in KINDS for key in (f"max_{kind}", f"has_{kind}_limits")),
    *("min_position", "max_position", "has_position_limits"),
    *("has_soft_limits", "soft_lower_limit", "soft_upper_limit"),
    *("max_effort", "has_effort_limits", "angle_wraparound", "k_position", "k_velocity"),
)

# Key of the table of joints, and keys of the scaling factors next to it.
TABLE = "joint_limits"
FACTORS = {kind: f"default_{kind}_scaling_factor" for kind in ("velocity", "acceleration")}


@dataclass(frozen=True, eq=False)
class JointLimits(KeepsReadOnly):
    """Limits of a robot's joint values. `load` reads limits from the ``joint_limits.yaml`` of MoveIt or ros2_control.

    Attributes
    ----------
    names : tuple of str
        Names of the columns, as in `Robot.configuration_names`.
    lower, upper : ndarray, shape (dof,)
        Limits of position [rad or m].
    velocity, acceleration, jerk : ndarray, shape (dof,)
        Limits of velocity [rad/s or m/s], acceleration [rad/s² or m/s²] and jerk [rad/s³ or m/s³]; infinite where there
        is no limit.

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
        """Read limits from a file. They replace the URDF's limits of the same joints.

        Parameters
        ----------
        path : path
            A YAML file with the key ``joint_limits``. The key may be nested within ROS parameters, and may occur
            several times for different joints. For each joint, ``has_velocity_limits: true`` and ``max_velocity`` give
            a limit, and ``has_velocity_limits: false`` means that the velocity is unlimited. Limits of acceleration,
            deceleration and jerk have the same form. ``min_position`` and ``max_position`` limit positions, and soft
            limits narrow this range. Limits of a mimicking joint apply to the joint that it mimics, except for position
            limits, which cause a warning instead. Angles may be tagged ``!degrees``.
        robot : Robot
        scaled : bool
            Multiply the limits of velocity and acceleration by the file's default scaling factors, which are at most 1.

        Returns
        -------
        JointLimits

        Raises
        ------
        FileError
            If the file does not exist, contains no limits, or contains a joint or a key twice. If a joint has an
            unknown key or a malformed limit. If a scaling factor is not next to ``joint_limits``.
        UnknownNameError
            If the file names a joint that the robot lacks. The message lists all such joints, and the robot's joints.
        MissingExtraError
            If PyYAML is not installed.

        Warns
        -----
        UserWarning
            If limits of a revolute joint are probably in degrees. If the file contains other tables next to
            ``joint_limits``. If the file contains position limits of joints that mimic other joints. Each warning is
            issued at most once.

        Examples
        --------
        >>> from pathlib import Path
        >>> _ = Path("limits.yaml").write_text("joint_limits: {rail: {min_position: 0.5, max_acceleration: 3}}")
        >>> JointLimits.load("limits.yaml", Robot.from_urdf("arm.urdf")).lower
        array([ 0.5, -inf])
        """
        source = _validate.path(path, "path")
        _validate.instance(robot, "robot", Robot)
        flag, what = _validate.flag(scaled, "scaled"), "limits of joints"
        root = read_yaml(read_regular(source, what, MOST_BYTES), source, what, merges=True)
        limits, doubts = _read(root, robot, flag)
        if doubts:
            warn(f"{shown(source)}: {doubts[0]}" + (f" ({len(doubts) - 1} more like it)" if len(doubts) > 1 else ""))
        return limits


def limits_of(
    robot: Robot,
    rows: Floats,
    given: JointLimits | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
    jerk: ArrayLike | None,
) -> tuple[Floats, Floats, Floats | None]:
    """Return velocity, acceleration and optional jerk limits, shape (dof,); limits of unmoved joints are infinite.

    The positions of a path are checked against the given limits.
    """
    if given is not None and not (isinstance(given, JointLimits) and given.names == robot.configuration_names):
        actual = f"those of {', '.join(given.names)}" if isinstance(given, JointLimits) else type(given).__name__
        raise InputError(f"limits: expected planners.JointLimits of {robot.name!r}, found {actual}")
    if given is not None:
        _expect_within(robot, rows, given)
    moves = (rows != rows[0]).any(axis=0)
    velocity_limits = robot.velocity if given is None else given.velocity
    fastest = velocity_limits if velocity is None else per_joint(velocity, "velocity", robot.dof)
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
    strongest = limits_by_name("acceleration", acceleration, (robot, given), fastest / UP_IN)
    steepest = limits_by_name("jerk", jerk, (robot, given), np.full(robot.dof, np.inf))
    fastest, strongest, steepest = (np.where(moves, each, np.inf) for each in (fastest, strongest, steepest))
    return fastest, strongest, None if jerk is None and np.isinf(steepest).all() else steepest


def _expect_within(robot: Robot, rows: Floats, given: JointLimits) -> None:
    """Raise an InputError if a row is outside the position limits.

    Blends and profiles stay within the convex hull of the rows. If the file does not change a limit, the hard limit of
    the joint applies, because a plan may start outside the soft limits.
    """
    lower, upper = position_limits(robot, given)
    for row, k in np.argwhere(beyond(rows, lower, upper))[:1]:
        raise InputError(
            f"path: expected positions within limits=, found {given.names[k]} = {rows[row, k]:.9g} outside "
            f"{lower[k]:.9g} .. {upper[k]:.9g}"
        )


def limits_by_name(name: str, limit: ArrayLike | None, sources: Iterable[Any], otherwise: Floats) -> Floats:
    """Return one limit per joint: the given limit, or the last finite limit of the joint in the sources."""
    if limit is not None:
        return per_joint(limit, name, len(otherwise))
    for source_limits in (getattr(source, name) for source in sources if source is not None):
        otherwise = np.where(np.isfinite(source_limits), source_limits, otherwise)
    return otherwise


def per_joint(limit: ArrayLike, name: str, dof: int) -> Floats:
    """Check a positive number, or one positive number per joint, and return one number per joint."""
    array = _validate.positive_array(limit, name, ("...",))
    if array.shape not in ((), (dof,)):
        raise InputError(f"{name}: expected one number or shape ({dof},), found {_validate.shape_text(array.shape)}")
    return np.broadcast_to(array, dof)


def _holders(top: Node, beside: list[Node]) -> list[dict[str, Node]]:
    """Find the mappings with a table of joints at any depth. Nodes that lead to no table are added to `beside`."""
    leads: dict[int, bool] = {}  # whether a table is below a node; an alias may refer to a node above it

    def leading(node: Node) -> bool:
        if node.kind != "mapping":
            return False
        if id(node.raw) not in leads:
            leads[id(node.raw)] = False
            keys = node.mapping(None)
            leads[id(node.raw)] = True in [TABLE in keys, *map(leading, keys.values())]
        return leads[id(node.raw)]

    holders: dict[int, dict[str, Node]] = {}
    waiting = [top] if leading(top) else []
    seen: set[int] = set()
    while waiting:
        node = waiting.pop()
        if id(node.raw) in seen:
            continue
        seen.add(id(node.raw))
        keys = node.mapping(None)
        if TABLE in keys:
            holders[id(node.raw)] = keys
        for key, held in keys.items():
            if leading(held) and key != TABLE:
                waiting.append(held)
            elif TABLE not in keys or key not in (TABLE, *FACTORS.values()):
                beside.append(held)
    return list(holders.values())


def _read(root: Node, robot: Robot, scaled: bool) -> tuple[JointLimits, list[str]]:
    """Return the limits, and the reasons why some of them may be in degrees."""
    beside: list[Node] = []
    holders = _holders(root, beside)
    if not holders:
        raise root.error("expected the key joint_limits with joints below it, found none")
    for held in beside:
        for name in {held.key.rpartition("/")[2]} & set(FACTORS.values()):
            raise held.error(f"expected {name} beside joint_limits, found it elsewhere")
    if beside:
        warn(f"{root.file}: not read, since they are no limits of joints: {some(held.key for held in beside)}")
    limits = {kind: np.full(robot.dof, np.nan) for kind in KINDS.values()}
    lower, upper = limits["lower"], limits["upper"] = robot.lower.copy(), robot.upper.copy()
    entries: dict[str, tuple[Node, dict[str, float]]] = {}
    factors = [_factors(holder, scaled) for holder in holders]
    for holder, of_table in zip(holders, factors, strict=True):
        for name, entry in holder[TABLE].mapping(None).items():
            if name in entries:
                raise entry.error(
                    f"expected each joint once, found {name} again, first in line {entries[name][0].line}"
                )
            entries[name] = entry, of_table
    if not entries:
        raise root.error("expected joints below joint_limits, found none")
    columns = {name: (k, 1.0) for k, name in enumerate(robot.configuration_names)}
    columns |= {name: (columns[joint][0], factor) for name, (joint, factor) in robot.mimics.items() if joint in columns}
    _expect_joints(str(root.file), list(entries), columns)
    turns, doubts, followed = _turning(robot), [], []
    scales = {kind: np.ones(robot.dof) for kind in FACTORS}
    for name, (entry, of_table) in entries.items():
        (k, by), own = columns[name], _limits_of_joint(entry)
        for kind, attribute in KINDS.items():
            if kind in own and by != 0:
                limits[attribute][k] = np.fmin(limits[attribute][k], own[kind] / abs(by))
        for kind in scales:
            scales[kind][k] = min(scales[kind][k], of_table[kind])
        if name in robot.mimics:
            followed += [name] if any(np.isfinite(own.get(kind, np.inf)) for kind in ("lower", "upper")) else []
        else:
            lower[k] = max(own.get("lower", lower[k]), own.get("soft_lower", -np.inf))
            upper[k] = min(own.get("upper", upper[k]), own.get("soft_upper", np.inf))
        if turns[k]:
            plain = {kind: value if np.isfinite(value) else 0.0 for kind, value in own.items()}
            low, high, velocity = (plain.get(kind, 0.0) for kind in ("lower", "upper", "velocity"))
            texts = doubt_about_limits(low, high), doubt_about_velocity(velocity)
            doubts += [f"{name}: expected {text}" for text in texts if text]
    if followed:
        warn(f"{root.file}: not read: positions of joints that mimic others, {some(followed)}; limit those they mimic")
    limits["velocity"] = np.where(np.isnan(limits["velocity"]), robot.velocity, limits["velocity"])
    followed_here = [columns[joint][0] for joint, _ in robot.mimics.values() if joint in columns]
    # If other joints mimic a joint, their velocity limits in the URDF also apply to this joint.
    limits["velocity"][followed_here] = np.fmin(limits["velocity"], robot.velocity)[followed_here]
    for k in np.flatnonzero(lower > upper)[:1]:
        bounds = f"{lower[k]:g} and {upper[k]:g}"
        raise root.error(f"{robot.configuration_names[k]}: expected min_position <= max_position, found {bounds}")
    for kind, factors_of in scales.items():
        # The factors of a single table also apply to joints that the file does not name.
        rest = factors[0][kind] if len(factors) == 1 else 1.0
        named = np.isin(np.arange(robot.dof), [columns[name][0] for name in entries])
        limits[kind] = limits[kind] * np.where(named, factors_of, rest)
    for array in limits.values():
        array[np.isnan(array)] = np.inf
    return protected(JointLimits(robot.configuration_names, **limits)), doubts


def _factors(holder: dict[str, Node], scaled: bool) -> dict[str, float]:
    """Return the scaling factors next to a table, or factors of 1 if scaling is not requested."""
    factors = {}
    for kind, key in FACTORS.items():
        factor = holder[key].number() if key in holder else 1.0
        if not factor > 0 or (scaled and factor > 1):
            raise holder[key].error(f"expected a factor above 0{' and at most 1' if scaled else ''}, found {factor:g}")
        factors[kind] = factor if scaled else 1.0
    return factors


def _limits_of_joint(entry: Node) -> dict[str, float]:
    """Return the limits of one joint, keyed by kind, "lower" or "upper". A limit that is not declared is infinite."""
    keys, limits = entry.mapping(None), {}
    if not keys:
        raise entry.error("expected limits by their names, found none")
    for key, held in keys.items():
        if key not in KEYS:
            raise held.error(str(_validate.unknown_name("key", key, KEYS)))
        if key.startswith("has_") or key == "angle_wraparound":
            held.flag()

    def given(key: str, has: str) -> float | None:
        """Return a limit, or None if there is no limit or the limit does not count."""
        counts = keys[has].flag() if has in keys else True
        return keys[key].angle() if key in keys and counts else None

    for kind in KINDS:
        key, has = f"max_{kind}", f"has_{kind}_limits"
        limit = given(key, has)
        if limit is not None and not limit > 0:
            raise keys[key].error(f"expected a number > 0, found {limit:g}")
        if limit is None and has in keys and keys[has].flag():
            raise entry.error(f"expected {key} with {has}, found none")
        if limit is not None or has in keys:
            limits[kind] = np.inf if limit is None else limit
    for kind, key, soft, none in (
        ("lower", "min_position", "soft_lower_limit", -np.inf),
        ("upper", "max_position", "soft_upper_limit", np.inf),
    ):
        limit, narrower = given(key, "has_position_limits"), given(soft, "has_soft_limits")
        if narrower is None and "has_soft_limits" in keys and keys["has_soft_limits"].flag():
            raise entry.error(f"expected {soft} with has_soft_limits, found none")
        if limit is None and "has_position_limits" in keys and not keys["has_position_limits"].flag():
            limit = none
        if limit is not None:
            limits[kind] = limit
        if narrower is not None:
            limits[f"soft_{kind}"] = narrower
    return limits


def _expect_joints(file: str, names: list[str], known: Mapping[str, Any]) -> None:
    """Raise an UnknownNameError that names all joints that the robot lacks."""
    unknown = [name for name in names if name not in known]
    if unknown:
        more = _validate.some(map(_validate.short, unknown[1:]))
        error = _validate.unknown_name("joint", unknown[0], known)
        raise UnknownNameError(f"{file}: {error}" + (f"; also unknown: {more}" if more else ""))


def _turning(robot: Robot) -> Bools:
    """Return which values are angles, shape (dof,), for the joint itself and for all joints that mimic it."""
    kind, column, turning = robot.tree.kind, robot.tree.column, np.zeros(robot.dof, dtype=bool)
    turning[column[kind == tree_columns.REVOLUTE]] = True
    turning[column[(kind != tree_columns.REVOLUTE) & (kind != tree_columns.FIXED)]] = False
    return turning


def beyond(values: Floats, lower: Floats, upper: Floats) -> Bools:
    """Return which values are outside their limits by more than rounding."""
    return np.asarray((values < lower - ON_LIMIT) | (values > upper + ON_LIMIT))


def with_start(robot: Robot, columns: Ints, q: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """If a motion's start is within the hard limits but outside the columns' ranges, warn and widen these ranges."""
    values = q[columns]
    hard = beyond(values, robot.hard_lower[columns], robot.hard_upper[columns])
    at = np.flatnonzero(beyond(values, lower, upper) & ~hard)
    if len(at) == 0:
        return lower, upper
    named = ", ".join(
        f"{robot.configuration_names[columns[k]]} = {values[k]:g} outside {lower[k]:g} .. {upper[k]:g}" for k in at
    )
    warn(f"start: expected a configuration within the soft limits, found {named}; it is within the hard limits")
    lower, upper = lower.copy(), upper.copy()
    lower[at], upper[at] = np.minimum(lower[at], values[at]), np.maximum(upper[at], values[at])
    return lower, upper


def position_limits(robot: Robot, limits: JointLimits | None) -> tuple[Floats, Floats]:
    """Return a robot's position limits: the limits that a file changed, and otherwise the hard limits."""
    if limits is None:
        return robot.hard_lower, robot.hard_upper
    lower = np.where(limits.lower == robot.lower, robot.hard_lower, limits.lower)
    upper = np.where(limits.upper == robot.upper, robot.hard_upper, limits.upper)
    return lower, upper
