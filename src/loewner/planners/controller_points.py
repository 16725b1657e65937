"""Read the points of a trajectory for a controller, and make the curve that the controller executes between them."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _elementary, _validate
from loewner._base._files import read_regular, shown
from loewner._base._matrices import image, product
from loewner._base._nodes import Node, read_json, read_yaml, some
from loewner._base._pictures import POINTS, curves, pictured
from loewner._base._plausible import warn
from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.errors import FileError, InputError
from loewner.planners import messages
from loewner.planners.controllers import columns_of, write
from loewner.planners.trajectory_files import RATES, WRITTEN, Rows, rows_of_table, saved_rows, table_of, with_ending
from loewner.robots import Robot
from loewner.robots.description.robot import joints_above
from loewner.robots.proofs.courses import CURVE_ROUNDINGS
from loewner.robots.proofs.curves import Curve, form_of

# Endings of files with points, and the largest file [bytes].
ENDINGS = (".csv", ".json", ".yaml", ".yml")
MOST_BYTES = 2**28

# Allowed distance of each value from the first point when a trajectory starts [rad or m]: MoveIt's default.
START_TOLERANCE = 0.01

# The same for a robot that holds a body, whose pose in the link would otherwise be wrong by as much.
HELD_TOLERANCE = 1e-9

# Allowed rounding errors: the difference between the times of the joints and of a base [s]; the deviation of a planar
# motion from its plane [m, or a cosine]; and the deviation of a quaternion's norm from 1, in files with few digits.
SAME_TIME, IN_PLANE, NORMS = 1e-9, 1e-6, 1e-2

# The identity as a position and a quaternion x, y, z, w.
IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

# Advice for a message that places a base that the robot does not have.
WITHOUT_BASE = (
    "; for a robot without values of {0}: place it there, by Robot.placed or a fixed joint in its URDF, and remove the "
    "entry from the message; or put it on a base of this name that moves, by Robot.add_base"
)


@dataclass(frozen=True, eq=False)
class Origin:
    """Other contents of the message from which the points were read.

    Attributes
    ----------
    place : str
        The keys in the message that lead to the points.
    stated : dict
        Values from the message's start state, by column.
    sources : dict
        Keys of the message from which the values in `stated` come, by column.
    assumed : tuple of str
        Columns for which neither the file nor `others` has values. They keep the robot's defaults, which are mostly 0.
    touching : dict
        Links that a carried body may touch, by the name of the body.
    free : tuple of str
        Bodies that the robot carries in another part of the message, but not while it follows these points. Queries
        raise an error if the scene has attached such a body.
    straight : tuple of str
        Columns of a base, which are interpolated by straight lines although other columns have velocities.
    """

    place: str = ""
    stated: dict[str, float] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    free: tuple[str, ...] = ()
    touching: dict[str, tuple[str, ...]] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    straight: tuple[str, ...] = ()


class ControllerPoints:
    """Timed points that a joint trajectory controller, such as ros2_control's, interpolates.

    The controller uses straight lines between points that have only positions, cubic polynomials between points with
    velocities, and quintic polynomials between points with velocities and accelerations.

    Parameters
    ----------
    times : array_like, shape (n,)
        Increasing times, in seconds.
    positions : array_like, shape (n, dof)
        Positions in radians or metres.
    velocities, accelerations : array_like, shape (n, dof), optional
        Velocities [rad/s or m/s] and accelerations [rad/s² or m/s²] at these times. Accelerations require velocities.
    names : sequence of str, optional
        Names of the columns. By default the columns are in the order of `Robot.configuration_names`.
    start_time : float
        Seconds that are added to the times, unless a query has an argument `t0`; as for `Trajectory`.

    Attributes
    ----------
    origin : Origin
        Other contents of the message from which the points were read.
    carried : dict
        Maps the name of each body that the robot carries, according to a message, to the link that carries the body.
        Queries refuse the points unless the scene has attached these bodies to these links.

    Raises
    ------
    InputError
        If shapes differ, a number is not finite, there are fewer than two points, or times do not increase.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> points = ControllerPoints([0.0, 1.0], [[0.0, 0.0], [1.0, 0.5]], velocities=np.zeros((2, 2)))
    >>> CollisionChecker(Robot.from_urdf("arm.urdf")).certify_trajectory(points).verdict
    <Verdict.FREE: 0>
    """

    def __init__(
        self,
        times: ArrayLike,
        positions: ArrayLike,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
        *,
        names: Sequence[str] | None = None,
        start_time: float = 0.0,
    ) -> None:
        self.start_time = _validate.real(start_time, "start_time")
        self.carried: dict[str, str] = {}
        self.origin = Origin()
        self.times = _validate.finite_array(times, "times", ("n",))
        if len(self.times) < 2:
            raise InputError(f"times: expected two or more, found {len(self.times)}")
        _validate.increasing(self.times, "times")
        if accelerations is not None and velocities is None:
            raise InputError("accelerations: expected velocities with them, found none")
        texts = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        if names is not None and not texts:
            raise InputError(f"names: expected a list of texts, found {type(names).__name__}")
        self.names = None if names is None else tuple(names)
        count, dof = len(self.times), None if self.names is None else len(self.names)
        self.positions = _validate.finite_array(positions, "positions", (count, "dof" if dof is None else dof))
        self.velocities, self.accelerations = (
            None if rates is None else _validate.finite_array(rates, name, self.positions.shape)
            for rates, name in ((velocities, "velocities"), (accelerations, "accelerations"))
        )

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, robot: Robot | None = None, others: ArrayLike | None = None
    ) -> ControllerPoints:
        """Read points from a file that was written for a controller.

        Parameters
        ----------
        path : path
            A ``.json`` or ``.yaml`` file with a ROS ``trajectory_msgs/JointTrajectory``, which may be part of a message
            of MoveIt or of a controller's action. Alternatively, a ``.csv`` file with a column ``time``, a column for
            each joint and, optionally, columns ``NAME velocity`` and ``NAME acceleration`` for each joint. Files
            written by `Trajectory.save` can be read as well.
        robot : Robot, optional
            Columns are added for the values of this robot that the file does not name; these values do not change. The
            motion of a base (a multi-DOF trajectory) is read for a floating or planar joint of this robot.
        others : array_like, shape (dof,), optional
            A configuration of the robot with the values for the added columns. Default: the message's start state, and
            `Robot.configuration()` for all other values. A joint that an earlier trajectory of the message has moved
            keeps its last value, even if `others` is given.

        Returns
        -------
        ControllerPoints

        Raises
        ------
        FileError
            If the file does not exist, contains no such points, or contains several trajectories (see `load_all`). If
            the file has a duplicate key, a key that is unknown in its message, or a value of the wrong kind. If a
            message contains motions or joint values that do not fit the robot, or that cannot be read without `robot`.
        InputError
            If the file has another extension, or `others` is given without `robot` or is not a configuration of the
            robot.
        MissingExtraError
            If PyYAML is needed but not installed.

        Warns
        -----
        UserWarning
            If the message describes bodies of the world, which are not read. If the message names another robot. If a
            goal lets the controller deviate from the path. If the trajectory does not begin at the message's start
            state.

        Examples
        --------
        >>> from pathlib import Path
        >>> _ = Path("moves.csv").write_text("time,rail,elbow\\n0,0,0\\n2,0.5,1\\n")
        >>> ControllerPoints.load("moves.csv")
        ControllerPoints(2 points, 2 joints, positions)
        """
        (points,) = cls._loaded(path, robot, others, only=True)
        return points

    @classmethod
    def load_all(
        cls, path: str | os.PathLike[str], *, robot: Robot | None = None, others: ArrayLike | None = None
    ) -> list[ControllerPoints]:
        """Read all trajectories of a file, in order, with the same errors and warnings as `load`.

        Joints that a trajectory does not name keep their values from the previous trajectory, or from the message's
        states. The attribute `carried` of each trajectory lists the bodies that the robot carries during this
        trajectory.

        Parameters
        ----------
        path, robot, others
            As for `load`.

        Returns
        -------
        list of ControllerPoints

        Examples
        --------
        >>> import json
        >>> from pathlib import Path
        >>> point = [{"positions": [k], "time_from_start": {"sec": k, "nanosec": 0}} for k in range(3)]
        >>> first, second = ({"joint_names": ["rail"], "points": point[k : k + 2]} for k in range(2))
        >>> _ = Path("two.json").write_text(json.dumps({"trajectory": [{"joint_trajectory": first},
        ...                                                            {"joint_trajectory": second}]}))
        >>> ControllerPoints.load_all("two.json")
        [ControllerPoints(2 points, 1 joint, positions), ControllerPoints(2 points, 1 joint, positions)]
        """
        return cls._loaded(path, robot, others)

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        joints: Sequence[str] | None = None,
        names: Mapping[str, str] | Sequence[str] | None = None,
        controllers: str | os.PathLike[str] | None = None,
    ) -> None:
        """Write the points to a file, which `load` reads back.

        The file contains neither `carried` nor `origin`, and only a ``.csv`` file contains `start_time`.

        Parameters
        ----------
        path : path
            A ``.csv`` file contains all numbers in full precision. A ``.json`` or ``.yaml`` file contains a ROS
            ``trajectory_msgs/JointTrajectory``, whose times are rounded to nanoseconds. If this may change a time,
            prove the points that you read back from the file.
        joints, names, controllers
            As for `Trajectory.save`. Points without names need `names`.

        Raises
        ------
        InputError
            As for `Trajectory.save`. If a message would contain the same time twice, or a negative time. If a base
            moves in straight lines while joints have velocities, because no file format can express this.
        UnknownNameError, FileError, MissingExtraError
            As for `Trajectory.save`.

        Warns
        -----
        UserWarning
            As for `Trajectory.save`; and if the robot carries bodies, which the file does not contain.

        Examples
        --------
        >>> points = ControllerPoints([0.0, 1.0], [[0.0, 0.0], [1.0, 0.5]], names=["rail", "elbow"])
        >>> points.save("elbow.yaml", joints=["elbow"])
        >>> ControllerPoints.load("elbow.yaml").positions
        array([[0. ],
               [0.5]])
        """
        target = with_ending(path, WRITTEN)
        columns, called = columns_of(self.names, self.positions.shape[1], joints, names)
        rows = {"positions": self.positions, "velocities": self.velocities, "accelerations": self.accelerations}
        held = {kind: array[:, columns] for kind, array in rows.items() if array is not None}
        moves = np.any([(array != array[0]).any(axis=0) for array in held.values()], axis=0)
        moving = [self.names[k] for k in np.array(columns)[moves]] if self.names else []
        straight = [name for name in moving if name in self.origin.straight]
        if straight:
            raise InputError(
                f"joints: expected columns that are interpolated alike, found {some(straight)}, which move straight; "
                "joints= leaves them out"
            )
        if self.carried:
            warn(f"{shown(target)}: the file does not contain that the robot carries {some(sorted(self.carried))}")

        def text(chosen: list[int], named: Sequence[str]) -> str:
            parts = {kind: array[:, chosen] for kind, array in held.items()}
            if target.suffix.lower() == ".csv":
                return table_of(named, self.times, list(parts.values()), self.start_time)
            return messages.written(named, self.times, parts, target.suffix.lower())

        write(target, called, moves.tolist(), controllers, text)

    @classmethod
    def _loaded(
        cls, path: str | os.PathLike[str], robot: Robot | None, others: ArrayLike | None, only: bool = False
    ) -> list[ControllerPoints]:
        """Read all trajectories of a file; if `only`, the file must contain a single one."""
        source = _validate.path(path, "path")
        suffix, name = source.suffix.lower(), shown(source)
        if suffix not in ENDINGS:
            raise InputError(f"path: expected a name that ends in {', '.join(ENDINGS)}, found {name}")
        if robot is not None:
            _validate.instance(robot, "robot", Robot)
        elif others is not None:
            raise InputError("others: expected a configuration of robot=, found no robot")
        q = None if robot is None or others is None else robot.checked_one(others, "others")
        what = "points of a trajectory"
        data = read_regular(source, what, MOST_BYTES)
        try:
            if suffix == ".csv":
                return [cls._of_rows(rows_of_table(data.decode("utf-8-sig")))._completed(robot, q)]
            if suffix == ".json":
                root: Node = read_json(data, source, what)
            else:  # a recorded message ends with a separator line
                root = read_yaml(data.rstrip().removesuffix(b"---"), source, what, merges=True)
            if root.kind == "mapping" and {"blended", "jumps"} & root.mapping(None).keys():
                return [cls._of_rows(saved_rows(root))._completed(robot, q)]
            message = messages.read(root)
            if only and len(message.parts) > 1:
                raise InputError(
                    f"expected one trajectory, found {len(message.parts)} with points "
                    f"({some(part.place for part in message.parts)}); ControllerPoints.load_all reads them all"
                )
            return cls._of_message(message, name, robot, q)
        except FileError:
            raise
        except InputError as error:
            raise FileError(f"{name}: {error}") from None
        except (ValueError, OverflowError, csv.Error) as error:
            raise FileError(f"{name}: expected {what}, found: {_validate.short(str(error))}") from None

    @classmethod
    def _of_rows(cls, rows: Rows) -> ControllerPoints:
        return cls(rows.times, rows.knots, rows.rates, rows.bends, names=rows.names, start_time=rows.start_time)

    @classmethod
    def _of_message(
        cls, found: messages.Message, name: str, robot: Robot | None, others: Floats | None
    ) -> list[ControllerPoints]:
        """Make the points of each trajectory of a message, and warn about parts that are not read."""
        if not found.parts:
            raise InputError("expected points of a trajectory, found none")
        told = list(found.warnings)
        if robot is not None:
            foreign = [other for other in dict.fromkeys(found.robots) if other != robot.name]
            told += [f"it is for the robot {other!r}, and is read for {robot.name!r}" for other in foreign]
        if found.around:
            around = some(found.around)
            told.append(f"the message has a world of its own ({around}), which is not read; a scene gives obstacles")
        for text in told:
            warn(f"{name}: {text}")
        carried = {body for part in found.parts for body in part.start.carried}
        if carried:
            warn(f"{name}: shapes and poses of bodies that the message attaches ({some(sorted(carried))}) are not read")
        return [_points_of(part, found.bodies, name, robot, others) for part in found.parts]

    def _completed(
        self, robot: Robot | None, others: Floats | None, stated: dict[str, float] | None = None
    ) -> ControllerPoints:
        """Add columns for the values of a robot that the points do not name; these values do not change.

        The added values come from `others` or, without `others`, from the message and the robot's defaults. A value
        with which an earlier part of the message ended comes before `others`.
        """
        if robot is None or self.names is None:
            return self
        missing = [k for k, name in enumerate(robot.configuration_names) if name not in self.names]
        added = [robot.configuration_names[k] for k in missing]
        if others is not None:
            sources, stated = self.origin.sources, stated or {}
            stated = {name: value for name, value in stated.items() if sources[name].startswith(messages.END)}
            others = np.array([stated.get(name, x) for name, x in zip(robot.configuration_names, others, strict=True)])
        q = robot.configuration(stated) if others is None else others
        points = self._beside(np.tile(q[missing], (len(self.times), 1)), added)
        used = {name: stated[name] for name in added if name in stated} if stated else {}
        assumed = tuple(name for name in added if name not in used) if others is None else ()
        points.origin = replace(self.origin, stated=used, assumed=assumed)
        return points

    def _beside(self, positions: Floats, names: Sequence[str]) -> ControllerPoints:
        """Return the points with further columns, whose velocities and accelerations are 0."""
        old = self.velocities, self.accelerations
        rates = [None if rate is None else np.hstack([rate, np.zeros_like(positions)]) for rate in old]
        return self._with(np.hstack([self.positions, positions]), rates, [*(self.names or ()), *names])

    def _with(self, positions: Floats, rates: Sequence[Floats | None], names: Sequence[str] | None) -> ControllerPoints:
        """Return a copy of the points with other columns or rates."""
        points = ControllerPoints(self.times, positions, *rates, names=names, start_time=self.start_time)
        points.carried, points.origin = self.carried, self.origin
        return points

    def __repr__(self) -> str:
        kind = "positions" if self.velocities is None else "cubic" if self.accelerations is None else "quintic"
        joints = "1 joint" if self.positions.shape[1] == 1 else f"{self.positions.shape[1]} joints"
        return f"ControllerPoints({len(self.times)} points, {joints}, {kind})"

    @pictured
    def _repr_html_(self) -> str:
        from scipy.interpolate import BPoly  # takes longer to import than everything else here

        curve = _form(self, "points")
        t = np.linspace(curve.times[0], curve.times[-1], POINTS)
        return curves(self.names, t, BPoly(np.moveaxis(curve.courses, 1, 0), curve.times)(t))


def executed(points: ControllerPoints, derivatives: int) -> ControllerPoints:
    """Return the points with their positions and only the first 0, 1 or 2 derivatives, which `points` must have."""
    kept = [rate if k < derivatives else None for k, rate in enumerate((points.velocities, points.accelerations))]
    return points._with(points.positions, kept, points.names)


@form_of.register(ControllerPoints)
def _form(given: ControllerPoints, name: str) -> Curve:
    """Make the curve that the controller executes; see `CollisionChecker.certify_trajectory`."""
    T = np.diff(given.times)[:, None]
    q0, q1 = given.positions[:-1], given.positions[1:]
    points, size = [q0, q1], np.maximum(np.abs(q0), np.abs(q1))
    if given.velocities is not None:
        v0, v1 = given.velocities[:-1] * T, given.velocities[1:] * T
        size = size + np.maximum(np.abs(v0), np.abs(v1))
        points = [q0, q0 + v0 / 3, q1 - v1 / 3, q1]
        if given.accelerations is not None:
            a0, a1 = given.accelerations[:-1] * T**2, given.accelerations[1:] * T**2
            size = size + np.maximum(np.abs(a0), np.abs(a1))
            points = [
                q0, q0 + v0 / 5, q0 + 2 * v0 / 5 + a0 / 20, q1 - 2 * v1 / 5 + a1 / 20, q1 - v1 / 5, q1,
            ]  # fmt: skip
    courses = np.stack(points, axis=1)
    for k in [given.names.index(name) for name in given.origin.straight] if given.names else []:
        courses[:, :, k] = q0[:, k, None] + (q1 - q0)[:, k, None] * np.linspace(0, 1, courses.shape[1])
        courses[:, -1, k] = q1[:, k]
    carried = (*given.carried.items(), *((body, "") for body in given.origin.free))
    return Curve(given.names, given.times, courses, CURVE_ROUNDINGS * size, carried)


# -- messages -----------------------------------------------------------------------------------


def _points_of(
    part: messages.Part, bodies: set[str], name: str, robot: Robot | None, others: Floats | None
) -> ControllerPoints:
    """Make the points of one trajectory of a message, with the state in which it begins."""
    _expect_begin(part, name)
    if part.placed is not None:
        if robot is None:
            raise InputError(
                f"expected one trajectory of joints with one value each, found a multi-DOF trajectory, which "
                f"moves {some(part.placed.names)} ({part.place}); give robot="
            )
        points = _with_base(part, part.placed, robot)
    else:
        assert part.joints is not None
        points = _of_joints(part.joints)
    points.carried = {body: link for body, (link, _) in part.start.carried.items()}
    touching = {body: touched for body, (_, touched) in part.start.carried.items()}
    free = tuple(sorted(bodies - points.carried.keys()))
    stated, sources = _stated(part, points, name, robot)
    points.origin = replace(points.origin, place=part.place, touching=touching, free=free, sources=sources)
    return points._completed(robot, others, stated)


def _of_joints(motion: messages.Motion) -> ControllerPoints:
    """Make the points of joints with one value each."""
    rates = [motion.rows.get(kind) for kind in RATES]
    return ControllerPoints(motion.times, motion.rows["positions"], *rates, names=motion.names)


def _with_base(part: messages.Part, placed: messages.Motion, robot: Robot) -> ControllerPoints:
    """Combine the motion of joints with one value and the motion of a base, which moves straight between its points."""
    held, times = part.joints, placed.times
    if held is not None and (len(held.times) != len(times) or not (np.abs(held.times - times) <= SAME_TIME).all()):
        raise InputError(
            f"expected the same times for the joints and for {some(placed.names)}, found others ({part.place})"
        )
    names, values = [], []
    for k, joint in enumerate(placed.names):
        joint_columns = _columns_of(joint, placed.rows["transforms"][:, k], robot)
        names += list(joint_columns)
        values += list(joint_columns.values())
    base = np.stack(values, axis=1)
    twice = [column for column in names if held is not None and column in held.names]
    if twice:
        raise InputError(f"expected one motion of each joint, found {some(twice)} twice ({part.place})")
    if held is None:
        return ControllerPoints(times, base, names=names)
    curved = "velocities" in held.rows
    if curved and any(f"{joint}/qw" in robot.configuration_names for joint in placed.names):
        turning = [n for n, column in zip(names, values, strict=True) if "/q" in n and np.ptp(column) != 0]
        if turning:
            raise InputError(
                f"expected a base that does not turn, as the joints have velocities, found {some(turning)} "
                f"that change ({part.place}); remove the velocities, or let a planar joint turn"
            )
    points = _of_joints(held)._beside(base, names)
    points.origin = Origin(straight=tuple(names) if curved else ())
    return points


def _columns_of(joint: str, T: Floats, robot: Robot) -> dict[str, Floats]:
    """Return the columns of a floating or planar joint for transforms: positions and quaternions x, y, z, w."""
    column_names = robot.configuration_names
    norms = np.linalg.norm(T[:, 3:], axis=1)
    if not (np.abs(norms - 1) < NORMS).all():
        raise InputError(f"expected quaternions of norm 1 for {joint}, found the norm {norms.max():g}")
    if f"{joint}/x" in column_names and f"{joint}/qw" in column_names:
        turned = T[:, [6, 3, 4, 5]] / norms[:, None]
        flips = np.cumprod(np.append(1.0, np.where((turned[1:] * turned[:-1]).sum(axis=1) < 0, -1.0, 1.0)))
        values = np.hstack([T[:, :3], turned * flips[:, None]])
        return {f"{joint}/{axis}": values[:, k] for k, axis in enumerate(("x", "y", "z", "qw", "qx", "qy", "qz"))}
    if f"{joint}/theta" in column_names:
        _expect_upright(joint, robot)
        if np.abs(T[:, [2, 3, 4]]).max() > IN_PLANE:
            raise InputError(f"expected motions of the planar joint {joint} in its plane, found others")
        theta = np.unwrap(2 * _elementary.arctan2(T[:, 5], T[:, 6]))
        return {f"{joint}/x": T[:, 0], f"{joint}/y": T[:, 1], f"{joint}/theta": theta}
    raise InputError(
        f"expected joints of {robot.name!r} with a position and an orientation (floating or planar), found a "
        f"multi-DOF trajectory that moves {joint!r}; Robot.add_base adds such a joint"
    )


def _expect_upright(joint: str, robot: Robot) -> None:
    """Refuse a planar joint whose axis is not z, because its values are not the position and heading of a message."""
    column = robot.configuration_names.index(f"{joint}/x")
    q = np.repeat(robot.configuration()[None], 2, axis=0)
    q[0, column : column + 3], q[1, column : column + 3] = 0.0, (1.0, 2.0, 0.5)
    # Robot.add_base makes three joints instead of one.
    for link in np.flatnonzero((robot.tree.kind == columns.PLANAR) & (robot.tree.column == column)).tolist():
        before, after = robot.forward_kinematics(q)[:, link]
        moved = image(before[:3, :3].T, after[:3, 3] - before[:3, 3])
        turned = product(before[:3, :3].T, after[:3, :3])
        if np.abs([*(moved - [1.0, 2.0, 0.0]), turned[1, 0] - np.sin(0.5), turned[2, 2] - 1]).max() > IN_PLANE:
            raise InputError(f"expected the axis 0 0 1 of the planar joint {joint}, found another one")


def _expect_begin(part: messages.Part, name: str) -> None:
    """Warn if a trajectory does not begin at the message's start state."""
    held = sorted(part.start.carried)
    tolerance = HELD_TOLERANCE if held else START_TOLERANCE
    if part.placed is not None:
        begin = dict(zip(part.placed.names, part.placed.rows["transforms"][0], strict=True))
        far = [
            joint for joint, T in part.start.places.items() if joint in begin and _is_far(T, begin[joint], tolerance)
        ]
        if far:
            warn(
                f"{name}: {part.place} does not begin where the message has left {some(far)}; it does not contain the "
                "way between them"
            )
    if part.joints is None:
        return
    first = dict(zip(part.joints.names, part.joints.rows["positions"][0].tolist(), strict=True))
    stated = {joint: value for joint, value in part.start.joints.items() if joint in first}
    away = [joint for joint, value in stated.items() if not abs(value - first[joint]) <= tolerance]
    if away:
        states = ", ".join(f"{joint} = {stated[joint]:g}" for joint in away)
        start = ", ".join(f"{joint} = {first[joint]:g}" for joint in away)
        warn(
            f"{name}: the start state has {states}, and the first point {start}; the trajectory does not "
            "contain the way between them"
            + (f", on which the robot holds {some(held)} as in the start state" if held else "")
        )


def _is_far(T: Floats, other: Floats, tolerance: float) -> bool:
    """Return whether two poses, given as positions and quaternions, differ by more than the tolerance [m, rad]."""
    turned = 1 - abs(float(np.dot(T[3:], other[3:]) / (np.linalg.norm(T[3:]) * np.linalg.norm(other[3:]))))
    return not (np.abs(T[:3] - other[:3]).max() <= tolerance and turned <= tolerance**2 + 1e-15)  # and roundings


def _stated(
    part: messages.Part, points: ControllerPoints, name: str, robot: Robot | None
) -> tuple[dict[str, float], dict[str, str]]:
    """Return a message's values for columns that the points do not name, and each value's key.

    A value that belongs to no column is refused. Without a robot, it is accepted if it is 0.
    """
    named, start = set(points.names or ()), part.start
    mimics = {} if robot is None else {joint: followed for joint, (followed, _) in robot.mimics.items()}
    beside = {
        joint: value for joint, value in start.joints.items()
        if joint not in named and mimics.get(joint) not in {*named, *start.joints}
    }  # fmt: skip
    places = {joint: T for joint, T in start.places.items() if (T != IDENTITY).any()}
    if robot is None:
        _refuse_beside(beside, places, start.sources)
        return {}, {}
    _doubt_mimics(start.joints, robot, name)
    column_names = set(robot.configuration_names)
    alone = [joint for joint in beside if joint in mimics]
    if alone:
        raise InputError(
            f"expected values of joints with values of their own, found {some(alone)}, which mimics "
            f"{some(mimics[joint] for joint in alone)}; add the value of the joint that is mimicked"
        )
    lacking = [joint for joint in beside if joint not in column_names]
    if lacking:
        raise InputError(
            f"expected a state of the robot {robot.name!r}, found values of joints that it lacks: "
            f"{some(lacking)}; the state belongs to a larger robot: read that robot, or remove these names from the "
            "message"
        )
    stated, sources = dict(beside), {joint: start.sources.get(joint, "") for joint in beside}
    for joint, T in places.items():
        if not any(column.startswith(f"{joint}/") for column in column_names):
            raise InputError(
                f"expected a state of the robot {robot.name!r}, found {joint} away from the identity "
                f"({start.sources.get(joint, '')}){WITHOUT_BASE.format(joint)}"
            )
        columns = _columns_of(joint, T[None], robot)
        stated |= {column: float(value[0]) for column, value in columns.items() if column not in named}
        sources |= dict.fromkeys(columns, start.sources.get(joint, ""))
    return stated, sources


def _doubt_mimics(state: dict[str, float], robot: Robot, name: str) -> None:
    """Warn if a state has contradictory values for a joint and a joint that mimics it."""
    tree, rows = robot.tree, {joint: k for k, joint in enumerate(joints_above(robot))}
    for joint, (followed, factor) in robot.mimics.items():
        if joint in state and followed in state:
            expected = factor * state[followed] + float(tree.offset[rows[joint]])
            if not abs(state[joint] - expected) <= START_TOLERANCE:
                warn(
                    f"{name}: expected {joint} = {expected:g}, since it mimics {followed} = {state[followed]:g}, found "
                    f"{state[joint]:g}, which is not used"
                )


def _refuse_beside(beside: dict[str, float], places: dict[str, Floats], sources: dict[str, str]) -> None:
    """Refuse values of a state that are unused because no robot is given, unless they are 0."""
    told = [f"{joint} = {value:g}" for joint, value in beside.items() if value != 0]
    told += [f"{joint} away from the identity" for joint in places]
    if told:
        where = some(dict.fromkeys(sources.get(joint, "") for joint in (*beside, *places)))
        raise InputError(
            f"expected a state of the joints that the points name, found {', '.join(told)} ({where}); give "
            "robot=, whose other joints then keep the values of the state or of others="
        )
