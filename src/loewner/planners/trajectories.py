"""Assign times to a path within velocity, acceleration and jerk limits, and prove the blends at its corners.

Without jerk limits, a trajectory consists of pieces of constant acceleration. Along a motion, the robot accelerates,
keeps its speed and decelerates. Across a corner, it follows a parabola. All pieces have closed forms, so the limits
hold at every instant, not only on a grid. docs/design/trajectories.md describes the alternatives that were considered.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._files import shown
from loewner._base._guard import guarded
from loewner._base._pictures import POINTS, curves, pictured
from loewner._base._plausible import warn
from loewner._base._read_only import KeepsReadOnly, protected
from loewner._base._validate import Bools, FloatOrFloats, Floats, Ints
from loewner._kernels import tolerances
from loewner.errors import FileError, InputError, MissingExtraError, PlanningError
from loewner.planners import brakes, messages
from loewner.planners.controllers import columns_of, write
from loewner.planners.jerk_limited import CUBIC_ROUNDINGS, JerkLimited, shortest
from loewner.planners.joint_limits import JointLimits, limits_of
from loewner.planners.judge import Judge, checked_checker, refuse_unfree
from loewner.planners.kept_lines import KeptLine, Line, angle_of, kept_lines
from loewner.planners.straights import BLEND_ROUNDINGS, SHORTEST, Straights
from loewner.planners.trajectory_files import ENDINGS, OTHERS, WRITTEN, Rows, read, with_ending, written
from loewner.robots import CertifiedTrajectory, CollisionChecker, Robot
from loewner.robots.checking.edges import checked_path
from loewner.robots.description.robot import exported_rates
from loewner.robots.proofs.curves import Curve, form_of

# Number of sizes that are tried for a blend, each half the previous size. If no size is proven, the robot stops.
HALVINGS = 5

# Shortest duration of half a blend [s], unless an adjacent motion is shorter. Without this limit, blends at nearly
# straight corners would take almost no time.
LEAST_BLEND = 1e-3

# A row counts as lying on the straight line between its neighbours if it deviates from the line by at most the share
# ROUNDED of its values.
ROUNDED = 1e-15

# Least time between a row added for a rate and any other row, in multiples of the shortest phase that rounding permits.
# SPACED applies to trajectories with limited jerk, which controllers interpolate by quintics. SPACED_WITHOUT_JERK
# applies to all others, whose rows have less noise. If the limits are unknown, because the trajectory was read from a
# file, added rows are at least CLOSEST periods from any knot.
SPACED, SPACED_WITHOUT_JERK, CLOSEST = 1.3, 0.5, 0.05  # certified.md, "Rounding of limits"

# Rows that are less than a nanosecond apart are merged, because times in a message are whole nanoseconds.
NANOSECOND = 1e-9

# Number of corners whose blends are chosen together. The effort grows quadratically with this number, and distant
# corners hardly affect each other.
CHOSEN_AT_A_TIME = 32

# The largest share of a motion that a blend may take. The rest is needed to change the speed.
LARGEST_SHARE = 0.49

# Largest number of rows on a straight line that are merged into one motion.
MOST_MERGED = 4096

# Allowed deviation of a file's rows from constant acceleration, for each joint: FILE_TOLERANCE times the joint's range,
# plus FILE_ROUNDINGS times the sum of the joint's largest value and the distance covered at its largest velocity in the
# total duration.
FILE_TOLERANCE, FILE_ROUNDINGS = 1e-9, 64.0 * tolerances.UNIT_ROUNDOFF


@dataclass(frozen=True, eq=False)
class Trajectory(KeepsReadOnly):
    """The position of a robot as a function of time. `trajectory` and `plan` make trajectories, and `load` reads them.

    Between two consecutive `times`, accelerations are constant or, if the jerk is limited, change linearly. In a
    trajectory from `plan` with `start_time`, or through joint targets (`of_targets`), velocities are constant between
    `times`, and jump at `times`.

    Attributes
    ----------
    names : tuple of str
        Names of the columns, as in `Robot.configuration_names`.
    times : ndarray, shape (n,)
        Times in seconds from the start; the first is 0.
    knots, rates : ndarray, shape (n, dof)
        Positions [rad or m] and velocities [rad/s or m/s] at these times. The robot starts and ends at rest, except in
        plans in time, at the start of a brake, and at the end of a `time_path` with an `end_velocity`. At jumps,
        ``rates`` contains the velocities after the jump.
    blended : ndarray of bool, shape (n - 1,)
        For each interval, whether the robot cuts a corner. In all other intervals, the robot is on the path.
    bends : ndarray, shape (n, dof), or None
        Accelerations at these times [rad/s² or m/s²] if the jerk is limited. Otherwise None, because accelerations
        jump.
    jumps : bool
        Whether velocities jump at these times. If ``bends`` is None, velocities are constant in between. Otherwise,
        ``bends`` are the accelerations just after these times, and accelerations change linearly in between, as they do
        when braking through joint targets (`stop_at`).
    start_time : float
        Time at which the trajectory starts, in seconds on the clock of bodies that follow motions (`Scene.follow`).
        `CollisionChecker.certify_trajectory` uses this time by default. For a trajectory ``moved``,
        ``dataclasses.replace(moved, start_time=4.0)`` is the same trajectory with its start at 4 s.
    spacing : float
        Least time [s] between a row that `save` adds for ``rate=`` and any other row. Because of rounding, closer rows
        would break the limits. The spacing is 0 if the limits are unknown, as for a trajectory from a file.

    Examples
    --------
    >>> from loewner import Robot
    >>> moved = trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [1, 0], [1, 2]], velocity=1.0, acceleration=2.0)
    >>> moved
    Trajectory(4 s, 2 joints, stops at 1 corner, 0 blends)
    >>> moved.stops, moved.positions([0.0, 0.75, 4.0])
    (array([1.5]), array([[0. , 0. ],
           [0.5, 0. ],
           [1. , 2. ]]))
    """

    names: tuple[str, ...]
    times: Floats
    knots: Floats
    rates: Floats
    blended: Bools
    bends: Floats | None = None
    jumps: bool = False
    start_time: float = 0.0
    spacing: float = 0.0

    @classmethod
    def _straight(cls, names: tuple[str, ...], times: Floats, knots: Floats, start_time: float = 0.0) -> Trajectory:
        """Make a trajectory whose velocities are constant between its times, and jump there."""
        rates = np.zeros(knots.shape)
        rates[:-1] = np.diff(knots, axis=0) / np.diff(times)[:, None]
        return cls(names, times, knots, rates, np.zeros(len(times) - 1, dtype=bool), None, True, start_time)

    @classmethod
    def of_targets(cls, robot: Robot, targets: ArrayLike, dt: float, *, start_time: float = 0.0) -> Trajectory:
        """Move straight from one joint target to the next, like a controller that receives one target per period.

        Parameters
        ----------
        robot : Robot
        targets : array_like, shape (n, dof)
            The first target is the robot's position at the start.
        dt : float
            Seconds from each target to the next.
        start_time : float
            Value of the attribute `start_time`.

        Returns
        -------
        Trajectory
            Velocities are constant between targets, and jump at targets. The trajectory may end in motion.

        Raises
        ------
        InputError
            If an argument has the wrong shape or value, or the robot has a floating or ball joint.

        Examples
        --------
        >>> from loewner import Robot
        >>> chunk = Trajectory.of_targets(Robot.from_urdf("arm.urdf"), [[0, 0], [0.02, 0.01], [0.04, 0.01]], dt=0.02)
        >>> chunk.positions(0.03)
        array([0.03, 0.01])
        """
        rows = checked_rows(robot, targets)
        period, begin = _validate.positive_scalar(dt, "dt"), _validate.real(start_time, "start_time")
        with np.errstate(over="ignore", invalid="ignore"):  # refused below
            times: Floats = period * np.arange(len(rows), dtype=np.float64)
            motion = cls._straight(robot.configuration_names, times, rows, begin)
        if not np.isfinite(motion.rates).all():
            raise InputError(f"dt: expected a period with finite velocities between targets, found {period:g}")
        return protected(motion)

    def __repr__(self) -> str:
        if self.jumps:
            count = len(self.blended)
            return f"Trajectory({self.duration:.4g} s, {len(self.names)} joints, {count} motion{'s' * (count != 1)})"
        stops, blends = len(self.stops), len(self.blends)
        return (
            f"Trajectory({self.duration:.4g} s, {len(self.names)} joints, stops at {stops} "
            f"corner{'s' * (stops != 1)}, {blends} blend{'s' * (blends != 1)})"
        )

    @pictured
    def _repr_html_(self) -> str:
        t = np.linspace(0.0, self.duration, POINTS)
        return curves(self.names, t, self.positions(t))

    @property
    def duration(self) -> float:
        """Time from start to end, in seconds."""
        return float(self.times[-1])

    @property
    def stops(self) -> Floats:
        """Times, between start and end, at which the robot rests at a corner."""
        inside = self.blended[:-1] & self.blended[1:]  # at which a blend reverses
        return np.asarray(self.times[1:-1][~self.rates[1:-1].any(axis=1) & ~inside])

    @property
    def blends(self) -> Floats:
        """Times at which each blend begins and ends, shape (blends, 2)."""
        changes = np.diff(self.blended.astype(np.int8), prepend=0, append=0)
        return np.stack([self.times[changes == 1], self.times[changes == -1]], axis=1)

    def positions(self, t: ArrayLike) -> Floats:
        """Compute the configurations at given times.

        Parameters
        ----------
        t : array_like, shape (...)
            Times in seconds, from 0 to `duration`.

        Returns
        -------
        ndarray, shape (..., dof)

        Raises
        ------
        InputError
            If a time is not a number, or is outside the trajectory.

        Examples
        --------
        >>> from loewner import Robot
        >>> trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [2, 0]], acceleration=1.0).positions(1.5)
        array([1., 0.])
        """
        return self._positions(*self._pieces(t))

    def _positions(self, k: Any, x: Floats, T: Floats) -> Floats:
        if self.bends is not None and not self.jumps:
            return self._cubics(k, x, T)
        # Weighted means of control points stay in the points' convex hull, and are exact at both ends.
        (a, *inner, b), y = self._control_points(k, T), 1 - x
        if len(inner) == 0:
            return np.asarray(y * a + x * b)
        if len(inner) == 1:
            return np.asarray(y**2 * a + 2 * x * y * inner[0] + x**2 * b)
        return np.asarray(y**3 * a + 3 * x * y**2 * inner[0] + 3 * x * x * y * inner[1] + x**3 * b)

    def velocities(self, t: ArrayLike) -> Floats:
        """Compute the velocities at given times. At a jump, the result is the velocity after the jump.

        Parameters
        ----------
        t : array_like, shape (...)
            As for `positions`.

        Returns
        -------
        ndarray, shape (..., dof)
            Velocities [rad/s or m/s].

        Examples
        --------
        >>> from loewner import Robot
        >>> trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [2, 0]], acceleration=1.0).velocities([0.0, 0.5, 1.5])
        array([[0. , 0. ],
               [0.5, 0. ],
               [1. , 0. ]])
        """
        return self._velocities(*self._pieces(t))

    def _velocities(self, k: Any, x: Floats, T: Floats) -> Floats:
        m = k + (T[..., 0] > 0)
        if self.jumps and self.bends is not None:
            middle = self.rates[k] + x * T * (self.bends[k] + self._bent(k, x, T)) / 2
            return np.asarray(np.where(x < 1, middle, self.rates[m]))
        if self.jumps:
            return np.asarray(np.where(x < 1, self.rates[k], self.rates[m]))
        velocities: Floats = (1 - x) * self.rates[k] + x * self.rates[m]
        if self.bends is not None:
            velocities += x * (1 - x) * (T / 2) * (self.bends[k] - self.bends[m])
        return velocities

    def accelerations(self, t: ArrayLike) -> Floats:
        """Compute the accelerations at given times. At a jump, the result is the acceleration after the jump.

        Parameters
        ----------
        t : array_like, shape (...)
            As for `positions`.

        Returns
        -------
        ndarray, shape (..., dof)
            Accelerations [rad/s² or m/s²].

        Examples
        --------
        >>> from loewner import Robot
        >>> trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [2, 0]], acceleration=1.0).accelerations([0.0, 1.5, 3.0])
        array([[ 1.,  0.],
               [ 0.,  0.],
               [-1.,  0.]])
        """
        return self._accelerations(*self._pieces(t))

    def _accelerations(self, k: Any, x: Floats, T: Floats) -> Floats:
        m = k + (T[..., 0] > 0)
        if self.jumps and self.bends is not None:
            return np.asarray(np.where(x < 1, self._bent(k, x, T), self.bends[m]))
        if self.jumps:
            return np.zeros((*k.shape, len(self.names)))
        if self.bends is not None:
            return np.asarray((1 - x) * self.bends[k] + x * self.bends[m])
        change = self.rates[m] - self.rates[k]
        return np.asarray(np.divide(change, T, out=np.zeros_like(change), where=T > 0))

    @overload
    def sample(self, rate: float, *, full: Literal[False] = False) -> tuple[Floats, Floats]: ...

    @overload
    def sample(self, rate: float, *, full: Literal[True]) -> tuple[Floats, Floats, Floats, Floats]: ...

    def sample(self, rate: float, *, full: bool = False) -> tuple[Floats, ...]:
        """Sample the trajectory at a constant rate: return times, and the positions at these times.

        Parameters
        ----------
        rate : float
            Samples per second.
        full : bool
            Also return velocities and accelerations.

        Returns
        -------
        times : ndarray, shape (m,)
            Multiples of 1 / rate, and the end of the trajectory. A multiple less than 1 ns before the end is omitted.
        positions : ndarray, shape (m, dof)
        velocities, accelerations : ndarray, shape (m, dof)
            The arrays that `velocities` and `accelerations` return; only if `full` is true.

        Raises
        ------
        InputError
            If the rate is not a number above 0 and at most 1e9, or the samples do not fit into memory.

        Examples
        --------
        >>> from loewner import Robot
        >>> moved = trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [2, 0]], acceleration=1.0)
        >>> moved.sample(1.0)
        (array([0., 1., 2., 3.]), array([[0. , 0. ],
               [0.5, 0. ],
               [1.5, 0. ],
               [2. , 0. ]]))
        """
        times = self._ticks(rate)
        if not _validate.flag(full, "full"):
            return times, self.positions(times)
        return times, self.positions(times), self.velocities(times), self.accelerations(times)

    def to_drake(self, robot: Robot) -> Any:
        """Convert the trajectory to Drake, for a robot from `Robot.from_drake`. Columns are in the order of the plant.

        Parameters
        ----------
        robot : Robot
            A robot whose joints have one value each.

        Returns
        -------
        pydrake.trajectories.PiecewisePolynomial
            The same trajectory, up to rounding. For other libraries, use the configurations
            ``robot.exported(trajectory.positions(t))``.

        Raises
        ------
        InputError
            If the trajectory is for another robot. If the robot is not from `Robot.from_drake`, or has quaternions. If
            velocities jump and also change between jumps, as in a brake through joint targets.
        MissingExtraError
            If Drake is not installed.

        Examples
        --------
        >>> polynomial = moved.to_drake(robot)  # doctest: +SKIP
        """
        if not isinstance(robot, Robot) or robot.configuration_names != self.names:
            raise InputError(f"robot: expected the robot of the trajectory, found {_validate.short(robot)}")
        rates, knots = exported_rates(robot, self.rates).T, robot.exported(self.knots).T
        self._expect_no_turns()
        try:
            from pydrake.trajectories import PiecewisePolynomial
        except ImportError:
            raise MissingExtraError("trajectories of Drake need pydrake: pip install drake") from None
        if self.jumps:
            return PiecewisePolynomial.FirstOrderHold(self.times, knots)
        return PiecewisePolynomial.CubicHermite(self.times, knots, rates)

    def part(self, name: str) -> Trajectory:
        """Return the motion of one of several joined robots (`Robot.join`), with this robot's names and the same times.

        Parameters
        ----------
        name : str
            The robot's name in `Robot.join`, or "outer/inner" for a robot that was joined twice.

        Returns
        -------
        Trajectory
            The columns whose names begin with ``name/``, without this prefix. A proof for one robot does not cover the
            other robots, so prove the whole trajectory. `stops` are the times at which this robot rests. `blends` are
            the intervals in which at least one of the robots cuts a corner.

        Raises
        ------
        UnknownNameError
            If no name begins with ``name/``.

        Examples
        --------
        >>> from loewner import Robot
        >>> arm = Robot.from_urdf("arm.urdf")
        >>> both = trajectory(Robot.join({"left": arm, "right": arm}), [[0, 0, 0, 0], [1, 0, 0, 2]], velocity=1.0)
        >>> both.part("right").names, both.part("right").positions(both.duration)
        (('rail', 'elbow'), array([0., 2.]))
        """
        part_names = dict.fromkeys(each[:k] for each in self.names for k, letter in enumerate(each) if letter == "/")
        _validate.known(name, "part", part_names)
        columns = [k for k, each in enumerate(self.names) if each.startswith(f"{name}/")]
        return self._of(columns, [self.names[k].removeprefix(f"{name}/") for k in columns])

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        joints: Sequence[str] | None = None,
        names: Mapping[str, str] | Sequence[str] | None = None,
        controllers: str | os.PathLike[str] | None = None,
        rate: float | None = None,
        message: bool = False,
    ) -> None:
        """Write times, positions, velocities and, if the jerk is limited, accelerations to a file in full precision.

        Parameters
        ----------
        path : path
            A ``.csv`` file has a column ``time`` and, for each joint, a column of positions and a column ``NAME
            velocity``. If the jerk is limited, it also has a column ``NAME acceleration`` for each joint. The column
            ``blend`` is 1 if the robot cuts a corner between this row and the next. `load` reads ``.csv`` and ``.json``
            files. A ``.yaml`` file contains a ROS ``trajectory_msgs/JointTrajectory`` with the positions and velocities
            at whole nanoseconds. Each row is moved to the nearest nanosecond, rows at the same nanosecond are merged,
            and the end is rounded up. Accelerations that jump are not written: without them, a controller interpolates
            only positions and velocities, and follows the trajectory exactly. Unless `start_time` is 0, a ``.csv`` file
            contains it in a comment in the first line. A message does not contain it.
        joints : sequence of str, optional
            Names of the columns to write, in this order. Default: all columns. If you omit columns, a proof of the
            whole trajectory holds only if the omitted joints also follow the trajectory, at the same times.
        names : mapping or sequence of str, optional
            Names of the columns in the file: a mapping from the trajectory's names to new names, or a list with a name
            for each written column.
        controllers : path, optional
            A YAML file of ros2_control or MoveIt that lists controllers. A separate file is written for each
            controller, such as ``moved.arm_controller.yaml`` for ``path="moved.yaml"`` and the controller
            ``arm_controller``. It contains the controller's joints, in the controller's order. Each column whose values
            change must belong to a controller that accepts trajectories. Unless the controller allows partial goals,
            the columns must include all of its joints, or none.
        rate : float, optional
            Also write rows at this rate [1/s], for programs that connect rows with straight lines. By default, the rows
            are the knots, between which accelerations are constant or change linearly. If velocities jump, the robot
            moves straight between knots, and files contain only positions. Rows closer than ``spacing`` to other rows
            are omitted, because their rounding would break the limits. With limited jerk, this affects rows near the
            knots. If the period of `rate` is shorter than ``spacing``, only every second or third row is written, or
            even fewer. `sample` returns all rows.
        message : bool
            Whether a ``.json`` file contains a JointTrajectory message, as a ``.yaml`` file does.
            `ControllerPoints.load` reads such a message.

        Raises
        ------
        InputError
            If the file has another extension, the rate is not a number from 0 to 1e9, or `message` is true for a
            ``.csv`` file. If names are repeated, or a name would count as another kind of column in a ``.csv`` file. If
            the controllers and the columns do not match. If velocities jump and also change between jumps.
        UnknownNameError
            If `joints` or `names` has a name that the trajectory lacks.
        FileError
            If a file cannot be written (an existing file is left unchanged), or if the list of controllers cannot be
            read.
        MissingExtraError
            If ``controllers`` is given and PyYAML is not installed.

        Warns
        -----
        UserWarning
            If a controller in the list has unknown settings, or does not interpolate between points. If the period of
            `rate` is shorter than ``spacing``.

        Examples
        --------
        >>> from loewner import Robot
        >>> moved = trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [2, 0]], acceleration=1.0)
        >>> moved.save("moved.csv")
        >>> print(open("moved.csv").readline().strip())
        time,rail,elbow,rail velocity,elbow velocity,blend
        >>> moved.save("moved.yaml", joints=["rail"], names={"rail": "axis_1"})
        >>> print(open("moved.yaml").readline().strip())
        joint_names: ["axis_1"]
        """
        self._expect_no_turns()
        target = with_ending(path, WRITTEN)
        suffix = target.suffix.lower()
        if _validate.flag(message, "message") and suffix == ".csv":
            raise InputError("message: expected False for a .csv file, found True; messages are .json or .yaml files")
        columns, called = columns_of(self.names, len(self.names), joints, names)
        saved = self._of(columns, called or self.names)
        if rate is not None:
            saved = saved._with_ticks(rate)
        moves = (saved.knots != saved.knots[0]).any(axis=0) | saved.rates.any(axis=0)

        def text(chosen: list[int], named: Sequence[str]) -> str:
            return saved._of(chosen, named)._text(suffix, message)

        write(target, saved.names, moves.tolist(), controllers, text)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a file written by `save`.

        Parameters
        ----------
        path : path

        Returns
        -------
        Trajectory

        Raises
        ------
        FileError
            If the file does not exist, or does not contain a trajectory.
        InputError
            If the name does not end in ``.csv`` or ``.json``.

        Examples
        --------
        >>> from loewner import Robot
        >>> trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [2, 0]], acceleration=1.0).save("moved.json")
        >>> Trajectory.load("moved.json")
        Trajectory(3 s, 2 joints, stops at 0 corners, 0 blends)
        """
        source = with_ending(path, ENDINGS, OTHERS)
        loaded = cls._of_rows(read(source))
        fault = loaded._fault()
        if fault:
            raise FileError(f"{shown(source)}: expected {fault}")
        return protected(loaded)

    def certify(
        self, checker: CollisionChecker, *, tolerance: float = 1e-5, joint_error: ArrayLike = 0.0, proof: bool = False
    ) -> CertifiedTrajectory:
        """Prove that the robot is free of collisions at every instant, with `CollisionChecker.certify_trajectory`.

        Parameters
        ----------
        checker : CollisionChecker
            A checker for a robot whose columns have the trajectory's names.
        tolerance : float
            As for `CollisionChecker.certify_trajectory`, in metres.
        joint_error : float or array_like, shape (dof,)
            Radians or metres by which each value may deviate from the trajectory at any time.
        proof : bool
            Also write a `Proof`, as `CollisionChecker.certify_trajectory` does.

        Returns
        -------
        CertifiedTrajectory

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot
        >>> robot = Robot.from_urdf("arm.urdf")
        >>> trajectory(robot, [[0, 0], [2, 0]], acceleration=1.0).certify(CollisionChecker(robot)).verdict
        <Verdict.FREE: 0>
        """
        certify = checked_checker(checker).certify_trajectory
        return certify(self, tolerance=tolerance, joint_error=joint_error, proof=proof)

    def stop_at(
        self,
        t: float,
        *,
        how: str = "path",
        acceleration: ArrayLike | None = None,
        jerk: ArrayLike | None = None,
        limits: JointLimits | None = None,
        beyond: bool = False,
    ) -> Trajectory:
        """Return a brake that begins at a given time, either along the path, or joint by joint and off the path.

        Parameters
        ----------
        t : float
            Time at which the robot begins to brake, in seconds from 0 to `duration`.
        how : str
            ``"path"``: the robot stays on the path of the trajectory, and stops as soon as the limits of all joints
            allow. It does not brake on blends. ``"joints"``: each joint brakes independently (see `brake`).
        acceleration, jerk : float or array_like, shape (dof,), optional
            Limits of acceleration [rad/s² or m/s²] and of jerk [rad/s³ or m/s³]. Default: from `limits`. Without a jerk
            limit, accelerations jump. With ``how="path"`` and a trajectory from `trajectory`, the limits must be at
            least as high as the trajectory's limits, and jerk limits must be given if and only if the trajectory has
            them.
        limits : JointLimits, optional
        beyond : bool
            Whether the robot may continue in a straight line beyond the end of a trajectory that ends in motion.

        Returns
        -------
        Trajectory
            The motion from the configuration at `t` to rest. Its `start_time` is `t` plus the `start_time` of the
            trajectory.

        Raises
        ------
        InputError
            If an argument has the wrong shape or value, or a joint that moves has no limit.
        PlanningError
            If the trajectory ends in motion before the robot can stop on its path, and `beyond` is False. If the limits
            are too low to stay on the path.
        UnknownNameError
            If `how` is neither ``"path"`` nor ``"joints"``.

        See Also
        --------
        brake : Brakes from a state.

        Notes
        -----
        On a path through joint targets, a brake slows down time along the path. With jerk limits, the same slowdown is
        used for all motions on which the robot brakes. Velocities still jump at targets, so the limits hold only
        between targets. On any other path, the robot slows down on straight lines, and passes blends at the reduced
        speed. If no body moves, a brake along a path that is proven free is also proven. All other brakes require a
        separate proof (`certify`).

        Examples
        --------
        >>> from loewner import Robot
        >>> moved = trajectory(Robot.from_urdf("arm.urdf"), [[0, 0], [4, 2]], velocity=1.0, acceleration=2.0)
        >>> moved.stop_at(2.0, acceleration=2.0).knots  # from 1 rad/s: 0.5 s and 0.25 rad
        array([[1.75 , 0.875],
               [2.   , 1.   ]])
        >>> moved.stop_at(2.0, acceleration=[2.0, 4.0], how="joints").times
        array([0.   , 0.125, 0.5  ])
        """
        at, further = _validate.real(t, "t"), _validate.flag(beyond, "beyond")
        on_path = _validate.choice(how, "how", ("path", "joints")) == "path"
        moves = (self.knots != self.knots[0]).any(axis=0) | self.rates.any(axis=0)
        strongest, most = brakes.brake_limits(self.names, moves, None, limits, acceleration, jerk)
        q, dq, ddq = self.positions(at), self.velocities(at), self.accelerations(at)
        jumps = on_path and self.jumps and self.bends is None and len(self.times) > 1
        if jumps:
            timed_brake = brakes.braked_on_motions(self.knots, self.times, at, strongest, most, further)
        elif not (on_path and moves.any()):
            timed_brake = brakes.braked(self.names, q, dq, ddq, strongest, most)
        elif self.jumps or (self.bends is None) != (most is None):
            kind = "that is a brake through joint targets" if self.jumps else f"with{'out' * (most is not None)} them"
            raise InputError(
                "jerk: expected limits of jerk if and only if the trajectory has them, to brake on its path, found a "
                f"trajectory {kind}"
            )
        else:
            ahead = self.times > at
            knots, rates = np.vstack([q, self.knots[ahead]]), np.vstack([dq, self.rates[ahead]])
            bends = None if self.bends is None else np.vstack([ddq, self.bends[ahead]])
            blended = self.blended[len(self.blended) - ahead.sum() :]
            rest = brakes.Timed(np.append(at, self.times[ahead]), knots, rates, blended, bends)
            timed_brake = brakes.braked_on_curve(rest, strongest, most, further)
        return protected(Trajectory(self.names, *timed_brake, jumps, self.start_time + at))

    # -- inside -------------------------------------------------------------------------------

    def _pieces(self, t: ArrayLike) -> tuple[Any, Floats, Floats]:
        """Return the piece of each time, and its fraction and duration, which have an additional axis for joints."""
        at = _validate.finite_array(t, "t", ("...",))
        if at.size and not (at.min() >= 0 and at.max() <= self.duration):
            worst = float(at.min() if at.min() < 0 else at.max())
            raise InputError(f"t: expected times from 0 to {self.duration!r}, found {worst!r}")
        _validate.fits_memory(40 * at.size * (len(self.names) + 2), f"{at.size} times")
        k = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, max(len(self.times) - 2, 0))
        T = self.times[np.minimum(k + 1, len(self.times) - 1)] - self.times[k]
        x = np.divide(at - self.times[k], T, out=np.zeros_like(at), where=T > 0)
        return k, x[..., None], T[..., None]

    def _expect_no_turns(self) -> None:
        """Refuse a trajectory whose velocities jump and change between jumps, which other formats cannot represent."""
        if self.jumps and self.bends is not None:
            raise InputError(
                "expected velocities that do not jump, or are constant between jumps, found a brake through joint "
                "targets; use `sample`"
            )

    def _control_points(self, k: Any, T: Floats) -> tuple[Floats, ...]:
        """Return the control points of pieces: straight motions, parabolas or cubics."""
        m = k + (T[..., 0] > 0)
        a, b = self.knots[k], self.knots[m]
        if self.bends is None:
            return (a, b) if self.jumps else (a, a + self.rates[k] * (T / 2), b)
        ahead = self.rates[k] * (T / 3)
        last = a + 2 * ahead + self.bends[k] * (T * T / 6) if self.jumps else b - self.rates[m] * (T / 3)
        return a, a + ahead, last, b

    def _bent(self, k: Any, x: Floats, T: Floats) -> Floats:
        """Return accelerations on pieces whose velocities jump. The final position determines the last acceleration."""
        bends: Any = self.bends
        way = self.knots[k + (T[..., 0] > 0)] - self.knots[k] - self.rates[k] * T
        end = np.divide(6 * way, T * T, out=3 * bends[k], where=T > 0) - 2 * bends[k]
        return np.asarray((1 - x) * bends[k] + x * end)

    def _cubics(self, k: Any, x: Floats, T: Floats) -> Floats:
        """Return positions on cubic pieces, computed from the nearer end to keep rounding errors on lines small."""
        m, z = k + (T[..., 0] > 0), np.minimum(x, 1 - x)
        near, far, away = 3 * z * (1 - z) ** 2, 3 * z * z * (1 - z), z * z * z
        a, b, first, last = self.knots[k], self.knots[m], self.rates[k] * (T / 3), self.rates[m] * (T / 3)
        way = (far + away) * (b - a)
        from_a, from_b = a + ((near * first - far * last) + way), b - ((near * last - far * first) + way)
        return np.asarray(np.where(x < 0.5, from_a, from_b))

    def _ticks(self, rate: float) -> Floats:
        """Return the multiples of a period within the duration, and the end."""
        rate = _validate.positive_scalar(rate, "rate")
        count = self.duration * rate
        _validate.fits_memory(int(min(count, 2.0**60)) * 40 * (len(self.names) + 2), f"{count:.3g} samples")
        if rate * NANOSECOND > 1:
            raise InputError(f"rate: expected at most {1 / NANOSECOND:g} samples per second, found {rate:g}")
        times = np.arange(math.floor(count) + 1) / rate
        before = (times < self.duration) & ((times == 0) | (self.duration - times >= NANOSECOND))
        return np.append(times[before], self.duration)

    def _with_ticks(self, rate: float) -> Trajectory:
        """Return the same trajectory with additional knots at a constant rate."""
        ticks = self._ticks(rate)[:-1]
        # Between two rows at almost the same time, velocities, accelerations or jerks would be mostly rounding errors.
        closest = self.spacing or CLOSEST / rate
        every = math.ceil(closest * rate * (1 - SHORTEST))
        if every > 1:
            warn(
                f"rate: expected at most {1 / closest:.4g} rows per second, since rounding would break the limits at "
                f"more, found {rate:g}; one of {every} is written, and sample returns all"
            )
        ticks = ticks[:: max(every, 1)]
        after = np.searchsorted(self.times, ticks)
        apart = np.minimum(self.times[after] - ticks, ticks - self.times[np.maximum(after - 1, 0)]) >= closest
        times = np.union1d(self.times, ticks[apart])
        blended = self.blended[np.searchsorted(self.times, times[:-1], side="right") - 1]
        bends = None if self.bends is None else self.accelerations(times)
        return replace(
            self, times=times, knots=self.positions(times), rates=self.velocities(times), blended=blended, bends=bends
        )

    def _shortest(self, fastest: Floats, strongest: FloatOrFloats = np.inf, jerk: FloatOrFloats | None = None) -> float:
        """Return the shortest time between two rows such that rounding breaks no limit."""
        size = np.abs(self.knots).max(axis=0) + np.abs(self.rates).max(axis=0) * self.duration
        return shortest(size, fastest, strongest, np.inf if jerk is None else jerk)

    def _spaced(self, fastest: Floats, strongest: Floats, most: Floats | None) -> Trajectory:
        """Return the same trajectory with the spacing that its limits require, and with read-only arrays."""
        spacing = (SPACED_WITHOUT_JERK if most is None else SPACED) * self._shortest(fastest, strongest, most)
        return protected(replace(self, spacing=spacing))

    def _of(self, columns: list[int], names: Sequence[str]) -> Trajectory:
        """Return the given columns under other names."""
        bends = None if self.bends is None else self.bends[:, columns]
        knots, rates = self.knots[:, columns], self.rates[:, columns]
        return protected(replace(self, names=tuple(names), knots=knots, rates=rates, bends=bends))

    def _text(self, suffix: str, message: bool) -> str:
        """Return the contents of a file."""
        if not message and suffix in ENDINGS:
            rates, blended = (None, None) if self.jumps else (self.rates, self.blended)
            held = Rows(self.names, self.times, self.knots, rates, blended, self.bends, self.start_time)
            return written(held, suffix)
        times, pieces = self._at_nanoseconds()
        rows = {"positions": self._positions(*pieces)}
        if not self.jumps:
            rows["velocities"] = self._velocities(*pieces)
        if self.bends is not None:
            rows["accelerations"] = self._accelerations(*pieces)
        return messages.written(self.names, times, rows, suffix)

    def _at_nanoseconds(self) -> tuple[Floats, tuple[Any, Floats, Floats]]:
        """Return the times of a message's rows and, like `_pieces`, the piece of each row and its place on the piece.

        The rows are evaluated at rounded times, so that the limits hold although times are rounded. Each inner row is
        evaluated on the longer one of the two pieces at its knot, even if its rounded time is on the shorter piece.
        Otherwise, a controller's curve between rows could depart from the longer piece. The end is rounded up, so that
        the robot is at rest at the end.
        """
        times = messages.nanoseconds(self.times)
        if self.duration - times[-1] > 4 * np.spacing(self.duration):
            times[-1:] = messages.nanoseconds(self.times[-1:] + NANOSECOND)
        times, first = np.unique(times, return_index=True)
        k, x, T = self._pieces(np.append(times[:-1], self.duration))
        if not self.jumps and len(times) > 2:
            lengths, before, after = np.diff(self.times), first[1:-1] - 1, first[2:] - 1
            k[1:-1] = np.where(lengths[before] > lengths[after], before, after)
            T[1:-1] = lengths[k[1:-1], None]
            x[1:-1, 0] = (times[1:-1] - self.times[k[1:-1]]) / lengths[k[1:-1]]
        return times, (k, x, T)

    @classmethod
    def _of_rows(cls, rows: Rows) -> Trajectory:
        if rows.rates is None or rows.blended is None:
            with np.errstate(over="ignore", invalid="ignore"):  # infinite results are refused
                return cls._straight(rows.names, rows.times, rows.knots, rows.start_time)
        return cls(rows.names, rows.times, rows.knots, rows.rates, rows.blended, rows.bends, start_time=rows.start_time)

    def _fault(self) -> str:
        """Describe the first requirement that a trajectory violates, or return ""."""
        n, dof = self.times.size, len(self.names)
        columns = [self.knots, self.rates] + ([] if self.bends is None else [self.bends])
        shapes = [a.shape for a in (self.times, self.blended, *columns)]
        if n == 0 or dof == 0 or shapes != [(n,), (n - 1,), *[(n, dof)] * len(columns)]:
            return "a time, a position and a velocity of every joint in each row, found something else"
        if not all(np.isfinite(a).all() for a in (self.times, np.array(self.start_time), *columns)):
            return "finite numbers, found others"
        T = np.diff(self.times)
        if self.times[0] != 0 or not (T > 0).all():
            return "times that start at 0 and increase, found others"
        if self.jumps:
            return ""
        if self.bends is None:
            return self._jump(self.knots, self.rates, 0.0, "constant accelerations")
        bent = np.diff(self.bends, axis=0) * T[:, None] ** 2 / 12
        linear = "accelerations that change linearly"
        return self._jump(self.rates, self.bends, 0.0, linear) or self._jump(self.knots, self.rates, bent, linear)

    def _jump(self, values: Floats, rates: Floats, bent: FloatOrFloats, wanted: str) -> str:
        """Describe the first row that is not the previous row plus the integral of linear rates, minus `bent`."""
        T = np.diff(self.times)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # overflow is refused
            off = np.abs(np.diff(values, axis=0) - (rates[1:] + rates[:-1]) * T / 2 + bent)
            size = np.abs(values).max(axis=0) + np.abs(rates).max(axis=0) * self.duration
            bad = ~(off <= FILE_TOLERANCE * np.ptp(values, axis=0) + FILE_ROUNDINGS * size)
        for k, joint in np.argwhere(bad)[:1]:
            return f"{wanted} between rows, found others of {self.names[joint]} after the time {self.times[k]:.15g}"
        return ""


@form_of.register(Trajectory)
def _form(given: Trajectory, name: str) -> Curve:
    """Make the curve of parabolas or cubics between knots; see `CollisionChecker.certify_trajectory`."""
    T, roundings = np.diff(given.times)[:, None], BLEND_ROUNDINGS if given.bends is None else CUBIC_ROUNDINGS
    courses = np.stack(given._control_points(np.arange(len(T)), T), axis=1)
    return Curve(given.names, given.times, courses, roundings * np.abs(courses).max(axis=1))


@guarded
def trajectory(
    robot: Robot,
    path: ArrayLike,
    *,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    jerk: ArrayLike | None = None,
    limits: JointLimits | None = None,
    checker: CollisionChecker | None = None,
    blend: float = 0.4,
    line: str | Line | Iterable[str | Line] | None = None,
) -> Trajectory:
    """Assign times to a path, such that the robot moves as fast as its limits allow, optionally with limited jerk.

    Without a checker, the robot follows the path exactly and stops at every corner. With a checker, blends cut the
    corners. Blends are parabolas or, if the jerk is limited, cubic polynomials, and are proven free of collisions at
    every instant. If no blend can be proven at a corner, the robot stops there.

    Parameters
    ----------
    robot : Robot
    path : array_like, shape (k, dof)
        Two or more configurations, for example from `plan`. Each joint value changes linearly from one configuration to
        the next.
    velocity : float or array_like, shape (dof,), optional
        Velocity limits [rad/s or m/s]. Default: from `limits`, or from the URDF (`Robot.velocity`).
    acceleration : float or array_like, shape (dof,), optional
        Acceleration limits [rad/s² or m/s²]. Default: from `limits`, or from a URDF of version 1.2. A joint without an
        acceleration limit reaches its velocity limit in one second.
    jerk : float or array_like, shape (dof,), optional
        Jerk limits [rad/s³ or m/s³]. Default: from `limits`, or from a URDF of version 1.2. Without jerk limits,
        accelerations jump.
    limits : JointLimits, optional
        Limits from a file. The path must be within the position limits.
    checker : CollisionChecker, optional
        A checker for this robot. With a checker, every motion of the path must be provably free.
    blend : float
        The fraction of a motion that a blend at either end may take, from 0 (stop at every corner) to 0.49. Without a
        checker, `blend` has no effect.
    line : str, Line or iterable, optional
        One or several links that stay on straight lines, for example on a path from `straight`. If you give a name, the
        link keeps a line on the whole path, within 0.1 mm and 1 mrad. With a `Line`, you can set the rows of the path
        and the tolerances. The link provably stays within the tolerances at every instant, including on blends. The
        robot stops at the ends of a line.

    Returns
    -------
    Trajectory
        The robot is at rest at both ends. `Trajectory.stops` and `Trajectory.blends` describe how the robot takes the
        corners.

    Raises
    ------
    InputError
        If an argument has the wrong shape or value, a joint that moves has no velocity limit, or the path is outside
        `limits`. If the robot has a floating or ball joint, whose orientations do not change linearly, or the checker
        or the limits belong to another robot.
    PlanningError
        If, with a checker, a motion of the path is not proven free. The message names the motion and a pair of bodies.
        If a link does not provably keep its line on a motion of the path. The message states the deviation.
    UnknownNameError
        If the robot has no link of this name.

    See Also
    --------
    plan : Finds paths. straight : Finds paths on which a link keeps a line.
    time_path : Assigns times among moving bodies.

    Notes
    -----
    If the robot stops at every corner, the trajectory is the fastest one along the path. Without jerk limits, the
    acceleration is constant on a blend. With jerk limits, the acceleration is zero at both ends of a blend. Every blend
    is as fast as the limits and the neighbouring motions allow. Each joint stays within its limits at every instant, up
    to rounding. If the jerk is limited, a millionth of each limit is reserved for rounding errors, and for an arm, no
    phase is shorter than about half a millisecond.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> path = [[0.0, 0.0], [1.0, 0.5], [2.0, 0.0]]
    >>> trajectory(robot, path, velocity=1.0, acceleration=2.0)
    Trajectory(3 s, 2 joints, stops at 1 corner, 0 blends)
    >>> trajectory(robot, path, velocity=1.0, acceleration=2.0, checker=CollisionChecker(robot))
    Trajectory(2.5 s, 2 joints, stops at 0 corners, 1 blend)
    >>> trajectory(robot, path, velocity=1.0, acceleration=2.0, jerk=20.0, checker=CollisionChecker(robot))
    Trajectory(2.6 s, 2 joints, stops at 0 corners, 1 blend)
    """
    rows = checked_rows(robot, path)
    share = checked_blend(blend)
    if checker is not None and checked_checker(checker).robot is not robot:
        raise InputError("checker: expected one of this robot, found one of another; pass `checker.robot`")
    lines = kept_lines(line, rows)
    numbers = corners_of(rows, sorted({at for each in lines for at in (each.first, each.last)}))
    rows = rows[numbers]
    fastest, strongest, most = limits_of(robot, rows, limits, velocity, acceleration, jerk)
    judge = None if checker is None else Judge.of(checker, 0.0)
    if judge is not None and len(rows) > 1:
        refuse_unfree(judge, rows, "path")
    motions = Straights.of(rows, fastest, strongest) if most is None else JerkLimited.of(rows, fastest, strongest, most)
    kept = [_on_line(robot, each, rows, numbers) for each in lines]
    halves = np.zeros(max(len(rows) - 2, 0)) if judge is None else blends_of(motions, judge, share, kept)
    return Trajectory(robot.configuration_names, *motions.timed(halves))._spaced(fastest, strongest, most)


def blends_of(motions: Straights | JerkLimited, judge: Judge, share: float, kept: Sequence[KeptLine] = ()) -> Floats:
    """Choose a blend size for each corner, such that all blends are proven and the motion is as fast as possible.

    At either end of a motion, a blend takes at most the given share of the motion. Blends on `kept` lines keep these
    lines.
    """
    halves = np.zeros(max(len(motions.straights.rows) - 2, 0))
    return _shortest(motions, _proven_blends(judge, motions, share, kept)) if share and len(halves) else halves


@guarded
def brake(
    robot: Robot,
    q: ArrayLike,
    dq: ArrayLike,
    ddq: ArrayLike | None = None,
    *,
    acceleration: ArrayLike | None = None,
    jerk: ArrayLike | None = None,
    limits: JointLimits | None = None,
    start_time: float = 0.0,
) -> Trajectory:
    """Return a brake joint by joint: each joint stops in the shortest time that its limits allow, and then rests.

    If a trajectory is cancelled, a controller that limits decelerations stops in this way. The robot leaves its path,
    so prove the brake (`Trajectory.certify`). `Trajectory.stop_at` can also brake on the path.

    Parameters
    ----------
    robot : Robot
    q, dq : array_like, shape (dof,)
        Positions [rad or m] and velocities [rad/s or m/s] when the robot begins to brake.
    ddq : array_like, shape (dof,), optional
        Accelerations at that time [rad/s² or m/s²], which must not exceed the limits. They are used only if the jerk is
        limited. Default: 0.
    acceleration : float or array_like, shape (dof,), optional
        Limits of deceleration. Default: from `limits`, or from the URDF. A joint that moves must have a limit.
    jerk : float or array_like, shape (dof,), optional
        Limits of jerk [rad/s³ or m/s³]. Default: from `limits`, or from the URDF. Without jerk limits, accelerations
        jump.
    limits : JointLimits, optional
        Limits from a file. Limits of velocity and position have no effect.
    start_time : float
        Time at which the brake begins, in seconds on the clock of bodies that follow motions.

    Returns
    -------
    Trajectory
        The motion from `q` to rest.

    Raises
    ------
    InputError
        If an argument has the wrong shape or value, if a joint that moves has no limit, or if the robot has a floating
        or ball joint.

    See Also
    --------
    Trajectory.stop_at : Brakes on the path of a trajectory, or joint by joint.

    Notes
    -----
    If n joints move, a brake has at most n pieces of constant acceleration or, if the jerk is limited, at most 3 n
    pieces of constant jerk. With a jerk limit, accelerations cannot jump. Therefore, the velocity of a joint may rise
    at first, even above its limit, but by no more than the jerk limit makes unavoidable.

    Examples
    --------
    >>> from loewner import Robot
    >>> stop = brake(Robot.from_urdf("arm.urdf"), [0.0, 0.0], [1.0, -0.5], acceleration=2.0)
    >>> stop.times, stop.knots[-1]  # 1 m/s and 2 m/s²: 0.5 s and 0.25 m
    (array([0.  , 0.25, 0.5 ]), array([ 0.25  , -0.0625]))
    """
    expect_straight(robot)
    at, names = robot.checked_one(q), robot.configuration_names
    rate = _validate.finite_array(dq, "dq", (robot.dof,))
    bend = np.zeros(robot.dof) if ddq is None else _validate.finite_array(ddq, "ddq", (robot.dof,))
    moves = (rate != 0) | (bend != 0)
    strongest, most = brakes.brake_limits(names, moves, robot, limits, acceleration, jerk)
    timed_brake = brakes.braked(names, at, rate, bend, strongest, most)
    return protected(Trajectory(names, *timed_brake, False, _validate.real(start_time, "start_time")))


# -- arguments ----------------------------------------------------------------------------------


def checked_rows(robot: Robot, path: ArrayLike) -> Floats:
    """Check a user's path."""
    expect_straight(robot)
    return checked_path(robot, path)


def expect_straight(robot: Robot, name: str = "robot") -> None:
    """Raise an error unless the argument `name` is a robot whose joint values change linearly along motions."""
    _validate.instance(robot, "robot", Robot)
    if not robot.runs_straight:
        raise InputError(
            f"{name}: expected joints whose values run straight, found a floating or ball joint in {robot.name!r}, "
            "whose orientations do not"
        )


def checked_blend(blend: float) -> float:
    """Check the argument `blend`, the share of a motion that a blend at either end may take."""
    share = _validate.positive_scalar(blend, "blend", zero=True)
    if share > LARGEST_SHARE:
        raise InputError(f"blend: expected a share from 0 to {LARGEST_SHARE:g}, found {share:g}")
    return share


def corners_of(rows: Floats, ends: Sequence[int] = ()) -> Ints:
    """Return the indices of the path's ends, its corners and the given ends of lines, without repeated rows.

    Rows on a straight line are corners only if they are ends of lines.
    """
    moved = np.flatnonzero(np.append(True, (np.diff(rows, axis=0) != 0).any(axis=1)))
    rows, needed = rows[moved], {int(at) for at in _at_or_before(moved, ends)}
    kept = [0]
    for k in range(1, len(rows) - 1):
        between = rows[kept[-1] + 1 : k + 1]
        straight = len(between) <= MOST_MERGED and _on_straight(rows[kept[-1]], rows[k + 1], between)
        if k in needed or not straight:
            kept.append(k)
    return np.asarray(moved[[*kept, len(rows) - 1]] if len(rows) > 1 else moved)


def _at_or_before(numbers: Ints, ends: Sequence[int]) -> Ints:
    """Find the ends of lines among the indices of kept rows. A repeated row counts as its first occurrence."""
    return np.searchsorted(numbers, np.array(ends, dtype=np.int64), side="right") - 1


def _on_straight(a: Floats, b: Floats, between: Floats) -> bool:
    """Return whether rows lie on the straight line from a to b, in order, up to rounding."""
    way = b - a
    j = np.abs(way).argmax()
    if way[j] == 0:
        return False
    shares = (between[:, j] - a[j]) / way[j]
    ordered = (np.diff(shares, prepend=0.0, append=1.0) >= 0).all()
    off = np.abs(a + shares[:, None] * way - between)
    return bool(ordered and (off <= ROUNDED * np.maximum(np.abs(a), np.abs(b))).all())


# -- blends -------------------------------------------------------------------------------------


def _proven_blends(
    judge: Judge, motions: Straights | JerkLimited, share: float, kept: Sequence[KeptLine]
) -> list[Floats]:
    """Find the proven blend sizes for each corner, in descending order. The last size is 0, which is a stop."""
    straights, lengths = motions.straights, motions.straights.lengths
    shorter = np.minimum(lengths[:-1], lengths[1:])
    halves = np.minimum(np.maximum(motions.wanted, LEAST_BLEND), share * shorter)
    speeds = np.maximum(np.abs(straights.full[:-1]), np.abs(straights.full[1:]))
    astray = BLEND_ROUNDINGS * speeds * motions.duration(np.zeros(len(halves)))
    astray += judge.errors
    roundings = BLEND_ROUNDINGS if isinstance(motions, Straights) else CUBIC_ROUNDINGS
    proven = []
    for _ in range(HALVINGS):
        courses = motions.courses(halves)
        # Largest deviation, including errors of computed positions: docs/certified.md, "Blends".
        off = roundings * np.abs(courses).max(axis=2) + astray[:, None]
        free = judge.proven(courses.reshape(-1, *courses.shape[2:]), off.reshape(-1, off.shape[-1]))
        free = free.reshape(off.shape[:2]).all(axis=1) & (halves > SHORTEST * shorter)
        for on in kept:
            free &= _keeps(on, motions, halves, off)
        proven.append(np.where(free, halves, 0.0))
        halves = halves / 2
    return [np.append(sizes[sizes > 0], 0.0) for sizes in np.transpose(proven)]


def _on_line(robot: Robot, line: Line, rows: Floats, numbers: Ints) -> KeptLine:
    """Find the line of a link, and refuse a path whose motions do not provably keep the line.

    Raises
    ------
    PlanningError
        If the link may leave the tolerances of the line on a motion.
    """
    first, last = _at_or_before(numbers, [line.first, line.last]).tolist()
    on = KeptLine.of(robot, replace(line, first=first, last=last), rows[first : last + 1])
    courses = np.column_stack([rows[first : last + 1], on.fractions])
    courses = np.stack([courses[:-1], courses[1:]], axis=1)
    good, deviations = on.keeps(courses, BLEND_ROUNDINGS * np.abs(courses[..., :-1]).max(axis=1))
    if not good.all():
        k = int(np.flatnonzero(~good)[(deviations[~good] / deviations[~good].max(axis=0)).max(axis=1).argmax()])
        raise PlanningError(
            f"line: expected {line.link} to keep within {line.position:g} m and {line.rotation:g} rad of the straight "
            f"line from row {line.first} to row {line.last}, found deviations of up to {deviations[k, 0]:.3g} m and "
            f"{angle_of(deviations[k, 1]):.3g} rad between rows {numbers[first + k]} and {numbers[first + k + 1]}"
        )
    return on


def _keeps(on: KeptLine, motions: Straights | JerkLimited, halves: Floats, off: Floats) -> Bools:
    """Return which blends a line allows: no blends at the line's ends, and between them, blends that keep the line."""
    good, first, last = np.ones(len(halves), dtype=bool), on.line.first, on.line.last
    good[[at - 1 for at in (first, last) if 0 < at <= len(halves)]] = False
    if last - first > 1:
        inside = slice(first, last - 1)
        courses = motions.part(first, last - 1).extended(on.fractions).courses(halves[inside])
        kept, _ = on.keeps(courses.reshape(-1, *courses.shape[2:]), off[inside].reshape(-1, off.shape[-1]))
        good[inside] = kept.reshape(courses.shape[:2]).all(axis=1)
    return good


def _shortest(motions: Straights | JerkLimited, proven: list[Floats]) -> Floats:
    """Choose one of the proven blend sizes for each corner, `CHOSEN_AT_A_TIME` corners at a time."""
    parts = []
    for first in range(0, len(proven), CHOSEN_AT_A_TIME):
        sizes = proven[first : first + CHOSEN_AT_A_TIME]
        parts.append(_shortest_part(motions.part(first, first + len(sizes)), sizes))
    halves, stops = np.concatenate(parts), np.zeros(len(proven))
    return stops if motions.duration(stops) < motions.duration(halves) else halves


def _shortest_part(motions: Straights | JerkLimited, proven: list[Floats]) -> Floats:
    """Choose blend sizes for a path with few corners, such that changing any single size does not save time."""
    halves = np.array([sizes[0] for sizes in proven])
    shortest = motions.duration(halves)
    improved = True
    while improved:
        improved = False
        for k, sizes in enumerate(proven):
            for half in sizes.tolist():
                other = halves.copy()
                other[k] = half
                needed = motions.duration(other)
                if needed < shortest * (1 - 1e-9):
                    halves, shortest, improved = other, needed, True
    return halves
