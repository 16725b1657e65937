"""Read a trajectory's points for controllers, and make the curve that controllers execute between the points."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner import _tables, _validate
from loewner._files import read_regular, shown
from loewner._pictures import POINTS, curves, pictured
from loewner.errors import FileError, InputError
from loewner.robots.courses import CURVE_ROUNDINGS
from loewner.robots.curves import Curve, form_of
from loewner.scene_files.yaml_scenes import yaml_data

# Endings of files with points; the largest file [bytes]; how deeply a trajectory may be nested in other messages.
ENDINGS = (".csv", ".json", ".yaml", ".yml")
MOST_BYTES = 2**28
DEEPEST = 6

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
    def load(cls, path: str | os.PathLike[str]) -> ControllerPoints:
        """Read points from a file that was written for a controller.

        Parameters
        ----------
        path : path
            A ``.json`` or ``.yaml`` file with a ROS ``trajectory_msgs/JointTrajectory``, by itself or within another
            message; or a ``.csv`` file whose columns are ``time``, the joints' names and optionally ``NAME velocity``
            and ``NAME acceleration`` for each joint. Files written by `Trajectory.save` can be read as well.

        Returns
        -------
        ControllerPoints

        Raises
        ------
        FileError
            If the file does not exist, or contains no such points.
        InputError
            If the file has any other extension.
        MissingExtraError
            If PyYAML is needed and not installed.

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
        data = read_regular(source, "points of a trajectory", MOST_BYTES)
        try:
            if suffix == ".csv":
                return cls._of_table(data.decode("utf-8-sig"))
            # A recorded message ends with a separator line.
            held = json.loads(data) if suffix == ".json" else yaml_data(data.rstrip().removesuffix(b"---"), source)
            return cls._of_message(held)
        except FileError:
            raise
        except KeyError as error:
            raise FileError(f"{name}: expected points of a trajectory, found no {error}") from None
        except InputError as error:
            raise FileError(f"{name}: {error}") from None
        except (ValueError, TypeError, OverflowError, RecursionError, AttributeError, csv.Error) as error:
            raise FileError(f"{name}: expected points of a trajectory, found: {_validate.short(str(error))}") from None

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
    def _of_message(cls, held: Any) -> ControllerPoints:
        """Read points from a message or from a file written by `Trajectory.save`."""
        if isinstance(held, Mapping) and ("blended" in held or "jumps" in held):
            arrays = held["positions"], held.get("velocities"), held.get("accelerations")
            return cls(held["times"], *arrays, names=held["names"], start_time=held.get("start_time", 0.0))
        message = _message(held, DEEPEST)
        if message is None:
            raise KeyError("points")
        points = message["points"]

        def rows(kind: str) -> Any:
            given = [point.get(kind) or None for point in points]
            if any(given) and not all(given):
                raise ValueError(f"{kind} of some points only")
            return given if any(given) else None

        times = [_seconds(point["time_from_start"]) for point in points]
        if rows("positions") is None:
            raise KeyError("positions")
        return cls(times, rows("positions"), rows("velocities"), rows("accelerations"), names=message["joint_names"])

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


def _message(held: Any, depth: int) -> Any:
    """Find the first trajectory with points in a message, however it is wrapped; None if there is none."""
    if isinstance(held, Mapping) and held.get("joint_names") and held.get("points"):
        return held
    inner = held.values() if isinstance(held, Mapping) else held if isinstance(held, list) else ()
    found = (_message(each, depth - 1) for each in inner if depth > 0)
    return next((each for each in found if each is not None), None)


def _seconds(given: Any) -> float:
    """Convert a duration, in ROS's form or as a number, to seconds."""
    if not isinstance(given, Mapping):
        return float(given)
    whole = given["sec"] if "sec" in given else given["secs"]
    return float(whole) + 1e-9 * float(given["nanosec"] if "nanosec" in given else given["nsecs"])
