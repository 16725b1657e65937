"""Read a trajectory's points for controllers, and make the curve that controllers execute between the points."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner import _json, _tables, _validate
from loewner._files import read_regular, shown
from loewner._pictures import POINTS, curves, pictured
from loewner._plausible import warn
from loewner._validate import Floats
from loewner.errors import FileError, InputError
from loewner.planners import messages
from loewner.planners.joint_limits import expect_robot
from loewner.robots import Robot
from loewner.robots.courses import CURVE_ROUNDINGS
from loewner.robots.curves import Curve, form_of
from loewner.scene_files.yaml_scenes import yaml_data

# Endings of files with points, and the largest file [bytes].
ENDINGS = (".csv", ".json", ".yaml", ".yml")
MOST_BYTES = 2**28

# A robot may be this far from the first point when a trajectory starts, in each value [rad or m]: MoveIt's default.
START_TOLERANCE = 0.01

TIMES = ("time", "time_from_start")
VELOCITY, ACCELERATION, BLEND = " velocity", " acceleration", "blend"


class ControllerPoints:
    """Timed points that a joint trajectory controller, such as ros2_control's, interpolates.

    If points have only positions, the controller interpolates them by straight lines; if they also have velocities, by
    cubic polynomials; if they also have accelerations, by quintic polynomials.

    Parameters
    ----------
    times : array_like, shape (n,)
        Increasing times, in seconds.
    positions : array_like, shape (n, dof)
        Radians or metres.
    velocities, accelerations : array_like, shape (n, dof), optional
        Rates at the same times, in radians or metres per second and per second squared; accelerations require
        velocities.
    names : sequence of str, optional
        Names of the columns. By default the columns are in the order of `Robot.configuration_names`.
    start_time : float
        Seconds that are added to the times, unless a query is given another `t0`; as for `Trajectory`.

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
        self.times = _validate.finite_array(times, "times", ("n",))
        if len(self.times) < 2 or not (np.diff(self.times) > 0).all():
            raise InputError(
                f"times: expected two or more that increase, found {_validate.shape_text(self.times.shape)}"
            )
        if accelerations is not None and velocities is None:
            raise InputError("accelerations: expected velocities with them, found none")
        texts = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        if names is not None and not texts:
            raise InputError(f"names: expected a list of texts, found {type(names).__name__}")
        self.names = None if names is None else tuple(names)
        self.positions = _validate.finite_array(positions, "positions", ("n", "dof"))
        dof = self.positions.shape[1] if self.names is None else len(self.names)
        self.velocities = None if velocities is None else _validate.finite_array(velocities, "velocities", ("n", "dof"))
        self.accelerations = (
            None if accelerations is None else _validate.finite_array(accelerations, "accelerations", ("n", "dof"))
        )
        for name in ("positions", "velocities", "accelerations"):
            array = getattr(self, name)
            if array is not None and array.shape != (len(self.times), dof):
                found = _validate.shape_text(array.shape)
                raise InputError(f"{name}: expected shape ({len(self.times)}, {dof}), found {found}")

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, robot: Robot | None = None, others: ArrayLike | None = None
    ) -> ControllerPoints:
        """Read points from a file that was written for a controller.

        Parameters
        ----------
        path : path
            A ``.json`` or ``.yaml`` file with a ROS ``trajectory_msgs/JointTrajectory``, by itself or within another
            message; or a ``.csv`` file whose columns are ``time``, the joints' names and optionally ``NAME velocity``
            and ``NAME acceleration`` for each joint. Files written by `Trajectory.save` can be read as well.
        robot : Robot, optional
            Add columns for the values of this robot that the file does not name; they do not change.
        others : array_like, shape (dof,), optional
            A configuration of the robot, with the values for these columns. Default: `Robot.configuration()`.

        Returns
        -------
        ControllerPoints

        Raises
        ------
        FileError
            If the file does not exist, contains no such points, or has a key twice; if a message contains more than
            the points of one trajectory: a second trajectory, a motion of a base (a multi-DOF trajectory), bodies
            attached to the robot, or a start state with values of joints that the points do not name. Such values are
            allowed if they are 0, which is the default of `others`. If you give `others`, they are ignored.
        InputError
            If the file has any other extension, or `others` is given without `robot` or is not its configuration.
        MissingExtraError
            If PyYAML is needed and not installed.

        Warns
        -----
        UserWarning
            If the message has bodies in a world of its own, which are not read, or if the trajectory does not begin at
            the message's start state.

        Examples
        --------
        >>> from pathlib import Path
        >>> _ = Path("moves.csv").write_text("time,rail,elbow\\n0,0,0\\n2,0.5,1\\n")
        >>> ControllerPoints.load("moves.csv")
        ControllerPoints(2 points, 2 joints, positions)
        """
        source = _validate.path(path, "path")
        suffix, name = source.suffix.lower(), shown(source)
        if suffix not in ENDINGS:
            raise InputError(f"path: expected a name that ends in {', '.join(ENDINGS)}, found {name}")
        if robot is not None:
            expect_robot(robot)
        elif others is not None:
            raise InputError("others: expected a configuration of robot=, found no robot")
        q = None if robot is None or others is None else robot.checked_one(others, "others")
        data = read_regular(source, "points of a trajectory", MOST_BYTES)
        try:
            if suffix == ".csv":
                points = cls._of_table(data.decode("utf-8-sig"))
            else:
                # A recorded message ends with a separator line.
                text = data if suffix == ".json" else data.rstrip().removesuffix(b"---")
                held = _json.parsed(text, name) if suffix == ".json" else yaml_data(text, source)
                points = cls._of_message(held, name, robot, q)
        except FileError:
            raise
        except KeyError as error:
            raise FileError(f"{name}: expected points of a trajectory, found no {error}") from None
        except InputError as error:
            raise FileError(f"{name}: {error}") from None
        except (ValueError, TypeError, OverflowError, RecursionError, AttributeError, csv.Error) as error:
            raise FileError(f"{name}: expected points of a trajectory, found: {_validate.short(str(error))}") from None
        return points if robot is None else points._completed(robot, robot.configuration() if q is None else q)

    @classmethod
    def _of_table(cls, text: str) -> ControllerPoints:
        """Read points from a table with a header."""
        start_time, text = _tables.start_of(text)
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), strict=True) if row]
        header = rows[0] if rows else []
        if not header or header[0] not in TIMES or len(set(header)) < len(header):
            raise ValueError(f"the header {','.join(header)}, where time and different joints should be named")
        table = np.array([[float(cell) for cell in row] for row in rows[1:]], dtype=np.float64)
        names = [name for name in header[1:] if name != BLEND and not name.endswith((VELOCITY, ACCELERATION))]
        held, used = set(header), [VELOCITY, ACCELERATION]
        rates = [name + kind for kind in used if any(name + kind in held for name in names) for name in names]
        odd = [name for name in rates if name not in held] + sorted(held - {header[0], BLEND, *names, *rates})
        if odd:
            what = "no column" if odd[0] not in held else "no joint for the column"
            raise InputError(f"expected a velocity or acceleration for all joints or none, found {what} {odd[0]!r}")
        table = table.reshape(-1, len(header))

        def columns(kind: str) -> Any:
            wanted = [name + kind for name in names]
            return table[:, [header.index(name) for name in wanted]] if set(wanted) & set(header) else None

        derivatives = columns(VELOCITY), columns(ACCELERATION)
        return cls(table[:, 0], columns(""), *derivatives, names=names, start_time=start_time)

    @classmethod
    def _of_message(cls, held: Any, name: str, robot: Robot | None, others: Floats | None) -> ControllerPoints:
        """Read points from a message or from a file written by `Trajectory.save`."""
        if isinstance(held, dict) and ("blended" in held or "jumps" in held):
            arrays = held["positions"], held.get("velocities"), held.get("accelerations")
            return cls(held["times"], *arrays, names=held["names"], start_time=held.get("start_time", 0.0))
        found = messages.parts(held)
        message = _only_trajectory(found, name)
        if message is None:
            raise KeyError("points")
        points = cls._of_trajectory(message)
        _expect_all_used(found, points, name, robot, others)
        if found.around:
            around = messages.around(found.around)
            warn(f"{name}: the message has a world of its own ({around}), which is not read; a scene gives obstacles")
        return points

    @classmethod
    def _of_trajectory(cls, message: dict[Any, Any]) -> ControllerPoints:
        """Read the points of a JointTrajectory."""
        points = message["points"]

        def rows(kind: str) -> Any:
            given = [point.get(kind) or None for point in points]
            if any(given) and not all(given):
                raise ValueError(f"{kind} of some points only")
            return given if any(given) else None

        times = [_seconds(point["time_from_start"]) for point in points]
        positions, velocities, accelerations = rows("positions"), rows("velocities"), rows("accelerations")
        if positions is None:
            raise KeyError("positions")
        return cls(times, positions, velocities, accelerations, names=message["joint_names"])

    def _completed(self, robot: Robot, others: Floats) -> ControllerPoints:
        """Add columns for the values of a robot that the points do not name; these do not move."""
        missing = [k for k, name in enumerate(robot.configuration_names) if self.names and name not in self.names]
        if self.names is None or not missing:
            return self
        shape = len(self.times), len(missing)
        positions = np.hstack([self.positions, np.broadcast_to(others[missing], shape)])
        rates = [
            None if held is None else np.hstack([held, np.zeros(shape)])
            for held in (self.velocities, self.accelerations)
        ]
        names = [*self.names, *(robot.configuration_names[k] for k in missing)]
        return ControllerPoints(self.times, positions, *rates, names=names, start_time=self.start_time)

    def __repr__(self) -> str:
        kind = "positions" if self.velocities is None else "cubic" if self.accelerations is None else "quintic"
        return f"ControllerPoints({len(self.times)} points, {self.positions.shape[1]} joints, {kind})"

    @pictured
    def _repr_html_(self) -> str:
        from scipy.interpolate import BPoly  # takes longer to import than everything else here

        curve = _form(self, "points")
        t = np.linspace(curve.times[0], curve.times[-1], POINTS)
        return curves(self.names, t, BPoly(np.moveaxis(curve.courses, 1, 0), curve.times)(t))


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
    return Curve(given.names, given.times, np.stack(points, axis=1), CURVE_ROUNDINGS * size)


def _only_trajectory(found: messages.Message, name: str) -> dict[Any, Any] | None:
    """Return the trajectory of a message, None if there is none; refuse motions and bodies beside it."""
    if found.multi_dof:
        joints = [
            str(joint) for _, held in found.multi_dof for joint in held.get("joint_names") or ["an unnamed joint"]
        ]
        raise FileError(
            f"{name}: expected one trajectory of joints with one value each, found a multi-DOF trajectory with points, "
            f"which moves {', '.join(joints[: messages.LISTED])} ({messages.places(found.multi_dof)})"
        )
    if len(found.trajectories) > 1:
        raise FileError(
            f"{name}: expected one trajectory, found {len(found.trajectories)} with points "
            f"({messages.places(found.trajectories)}); write each to a file of its own"
        )
    if found.attached:
        raise FileError(
            f"{name}: expected a robot that carries nothing, found attached bodies: "
            f"{messages.carried(found.attached)}; attach them in the scene, and remove them from the message"
        )
    return found.trajectories[0][1] if found.trajectories else None


def _expect_all_used(
    found: messages.Message, points: ControllerPoints, name: str, robot: Robot | None, others: Floats | None
) -> None:
    """Refuse a start state with values that are not used, and warn if it is not where the points begin.

    A value of a joint that the points do not name is used if it is equal to the default, and replaced if the caller
    gives values of such joints.
    """
    first = dict(zip(points.names or (), points.positions[0].tolist(), strict=True))
    values = found.values()
    stated = {joint for joint, _ in values}
    mimics = {} if robot is None else {joint: followed for joint, (followed, _) in robot.mimics.items()}
    beside = [
        (joint, value) for joint, value in values if joint not in first and mimics.get(joint) not in {*first, *stated}
    ]
    lacking = [joint for joint, _ in beside if robot and joint not in {*robot.configuration_names, *mimics}]
    if robot is not None and lacking:
        raise FileError(
            f"{name}: expected a state of the robot {robot.name!r}, found values of joints that it lacks: "
            f"{', '.join(lacking[: messages.LISTED])}; the state belongs to a larger robot: read that robot, or remove "
            "these names from the message"
        )
    dropped = [f"{joint} = {value:g}" for joint, value in beside if others is None and value != 0]
    columns = () if robot is None else robot.configuration_names
    without = [joint for joint in found.placed() if not any(column.startswith(f"{joint}/") for column in columns)]
    placed = without if others is not None else found.placed()
    if dropped or placed:
        told = ", ".join([*dropped, *(f"{joint} away from the identity" for joint in placed)])
        raise FileError(
            f"{name}: expected a state of the joints that the points name, found {told} "
            f"({messages.places([*found.states, *found.multi_dof_states])}){_advice(robot, dropped, placed, without)}"
        )
    away = [(joint, value) for joint, value in found.values(before=True) if _is_off(value, first.get(joint))]
    if away:
        states = ", ".join(f"{joint} = {value:g}" for joint, value in away)
        start = ", ".join(f"{joint} = {first[joint]:g}" for joint in dict(away))
        warn(
            f"{name}: the start state has {states}, and the first point {start}; the trajectory does not "
            "contain the way between them"
        )


def _advice(robot: Robot | None, dropped: list[str], placed: list[str], without: list[str]) -> str:
    """Return advice on values that a message states and that are not used.

    `placed` are bases away from the identity, and `without` those for which the robot, if one is given, has no values.
    """
    words = ""
    if dropped or robot is None or set(placed) - set(without):
        count = "" if robot is None else f" ({robot.dof} values)"
        words = (
            "; give the values of all joints that the points do not name: by robot= and others=, or by --others on the "
            f"command line. This is a whole configuration of the robot{count}; its values of joints that the points "
            "name are not used"
        )
    if without:
        words += (
            f"; for a robot without values of {', '.join(without)}: place it there, by Robot.placed or a fixed joint "
            "in its URDF, and remove the entry from the message; or put it on a base of this name that moves, by "
            "Robot.add_base, and give its values by others="
        )
    return words


def _is_off(value: float, first: float | None) -> bool:
    """Return whether a value of the start state is not the one with which the points begin, if they name its joint."""
    return first is not None and not abs(value - first) <= START_TOLERANCE


def _seconds(given: Any) -> float:
    """Convert a duration, in ROS's form or as a number, to seconds."""
    if not isinstance(given, dict):
        return float(given)
    whole = given["sec"] if "sec" in given else given["secs"]
    return float(whole) + 1e-9 * float(given["nanosec"] if "nanosec" in given else given["nsecs"])
