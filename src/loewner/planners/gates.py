"""Decide how far a chunk of joint targets may run: up to the last target with proven motions and a proven brake."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._elementary import arccos
from loewner._base._read_only import protected
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import codes, tolerances
from loewner.errors import InputError
from loewner.planners.brakes import Brakes, Timed, brake_limits
from loewner.planners.joint_limits import JointLimits, position_limits
from loewner.planners.judge import TOLERANCE, checked_checker
from loewner.planners.trajectories import Trajectory, expect_straight
from loewner.queries.pose_paths import PoseBounds, PosePath
from loewner.robots import CollisionChecker
from loewner.robots.checker import prepared_of
from loewner.robots.checking import verdicts
from loewner.robots.checking.distances import nearest_columns
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs import in_time, motions
from loewner.robots.proofs.contacts import OFF
from loewner.robots.proofs.courses import CURVE_ROUNDINGS, configurations, elevated
from loewner.robots.proofs.curves import joint_errors
from loewner.robots.proofs.motions import Limit
from loewner.robots.proofs.proof_models import model_of
from loewner.robots.proofs.written_proofs import Proof, proof_of

# Time scales that are tried if a chunk is not free at its own speed: a half, a quarter and an eighth.
SCALES = (0.5, 0.25, 0.125)

# Times that differ by at most the share SAME_TICK of a period belong to the same tick.
SAME_TICK = 1e-6

# Upper limit on quotients that may be infinite: more periods than any chunk has.
MANY = 2.0**31

# Bounds count as within older bounds only if they are narrower by more than rounding errors. The threshold is WITHIN
# times the sum of 1, the time [s] and the largest coordinate of the body [m].
WITHIN = 1e-12

# Rounding error of the angle between two quaternions [rad], which is computed from a cosine near 1.
TURNED = 1e-6

# Smallest limit on the steps for proving a brake as a whole: more steps than one interval takes with one pair.
LEAST_STEPS = 64

# Largest deviation of a brake from the straight motions that it follows, as a share of the joint values.
ROUNDED = 64.0 * tolerances.UNIT_ROUNDOFF  # certified.md, "Brakes", derives 40 of the 64

# Measured positions and velocities.
State: TypeAlias = tuple[Floats, Floats]


class GateState(IntEnum):
    """How much of a chunk may be executed.

    GO: all targets. PREFIX: the first `GateAnswer.steps` targets. BRAKE: no targets, only the brake. INSIDE: no
    targets; nothing can be proven, because the robot is already in contact, or nearer to a body than the margin.

    Examples
    --------
    >>> [state.name for state in GateState]
    ['GO', 'PREFIX', 'BRAKE', 'INSIDE']
    """

    GO = 0
    PREFIX = 1
    BRAKE = 2
    INSIDE = 3


@dataclass(frozen=True, eq=False, repr=False)
class GateAnswer(_validate.Brief):
    """The answer of a gate: how far a chunk of joint targets may run.

    Attributes
    ----------
    state : GateState
    steps : int
        Number of targets that may be executed. The motions to these targets, and a brake from each target, are proven
        free.
    scale : float
        1 if all targets may be executed. Otherwise, the largest of the scales 1/2, 1/4 and 1/8 such that all targets
        may be executed with periods of dt / scale. The scale is 0 if even 1/8 does not suffice, if the limit on the
        work is reached first, or if the reason is "limits".
    reason : str
        The reason why not all targets may be executed. "contact": the robot collides on the way to a target. "brake":
        the robot collides while it brakes, or the chunk has no target beyond the latency. "may be hit": no collision
        was found, but a body away from its given pose or a deviation of the robot may cause one, or the robot is too
        near contact for a proof. "limits": a target is outside the limits or too fast. "budget": the limit on the work
        was reached. For GO, the reason is empty.
    names : tuple of str
        The pair of bodies, or the joint, to which the reason applies; empty if there is no such pair or joint.
    distance, normal : float, ndarray of shape (3,)
        The distance between the two bodies where the proof fails [m], negative if they overlap, and the direction
        towards the second body. Both are computed for bodies at their given poses, and are NaN if there is no pair.
    brake : Trajectory
        The brake to execute after `steps` targets (and the gate's `latency`) if no new answer arrives by then. If the
        state is BRAKE, order this brake immediately.
    is_proven : bool
        Whether ``brake`` is proven free. As a rule, this is the case if an earlier chunk was proven, the robot is still
        in the proven tube, and the world is still within its bounds; `Gate.check` describes an exception.
    work : int
        Number of steps that the proofs took; see `CollisionChecker.certify_edges`.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, Scene
    >>> gate = Gate(CollisionChecker(Robot.from_urdf("arm.urdf"), Scene()), acceleration=2.0)
    >>> answer = gate.check([0.0, 0.0], [0.0, 0.0], [[0.01, 0.0], [0.02, 0.0]], dt=0.02)
    >>> answer.state.name, answer.steps, round(answer.brake.start_time, 9)
    ('GO', 2, 0.04)
    >>> print(answer.brake.knots[-1])  # 0.5 m/s, and 2 m/s²
    [0.0825 0.    ]
    """

    state: GateState
    steps: int
    scale: float
    reason: str
    names: tuple[str, ...]
    distance: float
    normal: Floats
    brake: Trajectory
    is_proven: bool
    work: int


class _World(NamedTuple):
    """The places of the scene's bodies, on which proofs depend, and the version of everything else."""

    structure: int
    poses: Floats
    following: dict[str, PosePath]
    bounds: dict[str, PoseBounds]


class _Block(NamedTuple):
    """Where a proof fails: the reason, the pair (-1 for none), the configuration, the time, and the joint, if any."""

    reason: str
    pair: int
    q: Floats
    t: float
    joint: str = ""


class _Stop(NamedTuple):
    """A motion or a brake of a chunk that is not proven free. It is not tried again while the world is the same.

    Attributes
    ----------
    tick : int
        The tick at which the motion or the brake begins.
    needed : int
        Number of targets on which the motion or the brake depends.
    block : _Block
    """

    tick: int
    needed: int
    block: _Block


class _Chunk(NamedTuple):
    """A chunk, and how far it is proven.

    Attributes
    ----------
    rows : ndarray, shape (n + 1, dof)
        The configuration at which the chunk begins, and the targets.
    rates : ndarray, shape (n + 1, dof)
        Velocities at the rows, from the motions that end there.
    before : ndarray, shape (dof,)
        The target before the first row, if the chunk has begun.
    dt, t0 : float
    motions : int
        Number of proven motions, counted from the first motion.
    first, braked : int
        The first and the last tick of a range; the brakes from all ticks in this range are proven.
    ends : ndarray of int64, shape (n + 1,)
        For each tick, how many targets the chunk had when the brake from the tick was proven. If the brake goes beyond
        these targets, it continues along the last motion, even if targets were added later.
    world : _World
    motion_stop, brake_stop : _Stop, optional
    """

    rows: Floats
    rates: Floats
    before: Floats
    dt: float
    t0: float
    motions: int
    first: int
    braked: int
    ends: Ints
    world: _World
    motion_stop: _Stop | None = None
    brake_stop: _Stop | None = None

    def from_tick(self, j: int) -> _Chunk:
        """Return the same chunk, with ticks counted from a later tick."""
        stops = [
            stop and stop._replace(tick=stop.tick - j, needed=stop.needed - j)
            for stop in (self.motion_stop, self.brake_stop)
        ]
        return self._replace(
            rows=self.rows[j:], rates=self.rates[j:], before=self.rows[j - 1] if j > 0 else self.before,
            t0=self.t0 + j * self.dt, motions=max(self.motions - j, 0), first=self.first - j, braked=self.braked - j,
            ends=self.ends[j:] - j, motion_stop=stops[0], brake_stop=stops[1],
        )  # fmt: skip


class Gate:
    """Decide in a control loop how far chunks of joint targets may run, so that the robot can still brake.

    A chunk may run up to a target if the straight motions to this target are proven free, together with a brake from
    each target on the way. The proofs cover all deviations within `joint_error` and `velocity_error`, and all places of
    bodies within their bounds (`Scene.follow`, `Scene.move`). The claim is that nothing collides until the robot is at
    rest. A body may still run into the resting robot. A gate is not a safety function in the sense of IEC 61508 or ISO
    13849.

    Parameters
    ----------
    checker : CollisionChecker
        A checker whose scene may change between checks.
    limits : planners.JointLimits, optional
        Limits of position, velocity, acceleration and jerk. Default: the limits of the robot.
    brake : {"joints", "path"}
        How the robot brakes. "joints": each joint brakes as fast as its limits allow, as with most controllers, and the
        robot leaves the path. "path": the robot stays on the path, and slows down until it rests.
    horizon : float, optional
        Only targets within this time [s] are examined. Default: all targets.
    interpolation : {"linear"}
        How the controller moves from one target to the next.
    joint_error : float or array_like, shape (dof,)
        Radians or metres by which the robot may deviate from the straight motions and from the braking motions.
    velocity_error : float or array_like, shape (dof,)
        Rad/s or m/s by which the robot's velocity may differ from the chunk's velocity when the robot begins to brake.
    latency : float
        Seconds between the order to brake and the beginning of the brake; in the meantime, the robot continues along
        the chunk. The latency is rounded up to whole periods.
    steps : int, optional
        Limit on the work of a check, in steps of the proofs (`CollisionChecker.certify_edges`). Default: no limit.
    acceleration, jerk : float or array_like, shape (dof,), optional
        Limits that replace the values in `limits`. Without a jerk limit, accelerations jump.
    tolerance : float
        As for `CollisionChecker.certify_edges`, in metres.

    Raises
    ------
    InputError
        If an argument has the wrong type, shape or value, a joint has no acceleration limit, or the robot has a
        floating or ball joint.
    UnknownNameError
        If `brake` or `interpolation` is not one of the listed words.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.4], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> gate = Gate(CollisionChecker(Robot.from_urdf("arm.urdf"), scene), acceleration=2.0)
    >>> rail = np.linspace(0.02, 1.0, 50)  # 1 m/s at 50 Hz, into the post
    >>> answer = gate.check([0.0, 0.0], [1.0, 0.0], np.column_stack([rail, np.zeros(50)]), dt=0.02)
    >>> print(answer.state.name, answer.reason, answer.names)
    PREFIX brake ('cart', 'post')
    >>> answer.steps, answer.is_proven, round(answer.brake.duration, 9)
    (42, True, 0.5)
    """

    def __init__(
        self,
        checker: CollisionChecker,
        limits: JointLimits | None = None,
        *,
        brake: str = "joints",
        horizon: float | None = None,
        interpolation: str = "linear",
        joint_error: ArrayLike = 0.0,
        velocity_error: ArrayLike = 0.0,
        latency: float = 0.0,
        steps: int | None = None,
        acceleration: ArrayLike | None = None,
        jerk: ArrayLike | None = None,
        tolerance: float = TOLERANCE,
    ) -> None:
        self._checker = checked_checker(checker)
        robot = checker.robot
        expect_straight(robot)
        _validate.choice(interpolation, "interpolation", ("linear",))
        self._on_path = _validate.choice(brake, "brake", ("joints", "path")) == "path"
        self._horizon = math.inf if horizon is None else _validate.positive_scalar(horizon, "horizon")
        self._error = joint_errors(robot, joint_error)
        self._rate_error = joint_errors(robot, velocity_error, "velocity_error")
        self._latency = _validate.positive_scalar(latency, "latency", zero=True)
        self._steps = codes.NO_LIMIT if steps is None else _validate.whole_number(steps, "steps", 1)
        self._left = self._steps  # steps that the proofs of the current check may still take
        self._tolerance = _validate.positive_scalar(tolerance, "tolerance")
        moves = np.ones(robot.dof, dtype=bool)
        self._strongest, self._jerk = brake_limits(robot.configuration_names, moves, robot, limits, acceleration, jerk)
        velocity_limits = robot.velocity if limits is None else limits.velocity
        self._fastest = np.where(np.isnan(velocity_limits), np.inf, velocity_limits)
        self._lower, self._upper = position_limits(robot, limits)
        self._last: _Chunk | None = None  # proven for all poses that the chunk's world allows
        self._drift = 0.0  # growth of bounds within the tolerance of a tick
        self._now = -math.inf

    @property
    def checker(self) -> CollisionChecker:
        """The checker whose robot and scene are judged."""
        return self._checker

    def __repr__(self) -> str:
        return f"Gate({self._checker!r}, brakes {'on the path' if self._on_path else 'joint by joint'})"

    def check(
        self, q: ArrayLike, dq: ArrayLike, targets: ArrayLike, dt: float, time: float | None = None
    ) -> GateAnswer:
        """Judge a chunk of targets before it is executed, or again at each tick of its execution.

        Parameters
        ----------
        q, dq : array_like, shape (dof,)
            Measured positions and velocities.
        targets : array_like, shape (n, dof)
            The robot should be at the first target after `dt`, at the second one after 2 dt, and so on. To continue the
            chunk at the next tick, begin with the second target; only new motions and brakes are then proven.
        dt : float
            Seconds between targets.
        time : float, optional
            The time of this tick, in seconds on the clock of the scene's moving bodies; it must not run backwards.
            Required if bodies move or have bounds that grow with time. The state of a slow robot may fit several ticks
            of the chunk, and with a latency, the time decides between these ticks. Without the time, brakes of earlier
            answers count as unproven in this case.

        Returns
        -------
        GateAnswer

        Raises
        ------
        InputError
            If an argument has the wrong shape or is not finite, or if the time runs backwards or is missing. After such
            an error, the brake of the last answer is the safe motion.

        Notes
        -----
        Proofs of earlier checks are reused if the targets continue unchanged, and the measured state is within
        `joint_error` and `velocity_error` of the proven motion. In addition, the scene must be unchanged, or each body
        must be within its earlier bounds. Otherwise, everything is proven again.
        """
        robot = self._checker.robot
        period, now = _validate.positive_scalar(dt, "dt"), self._time(time)
        state = _validate.finite_array(q, "q", (robot.dof,)), _validate.finite_array(dq, "dq", (robot.dof,))
        rows = _validate.finite_array(targets, "targets", (None, robot.dof))
        if len(rows) == 0:
            raise InputError("targets: expected one row or more, found none")
        if not math.isfinite(8.0 * (abs(now) + period * (1 + len(rows)))):
            raise InputError(f"dt: expected a period with which the last target is at a finite time, found {period:g}")
        with np.errstate(over="ignore"):
            speeds = np.diff(np.vstack([state[0], rows]), axis=0) / period
        if not np.isfinite(speeds).all():
            raise InputError(f"targets: expected finite velocities between targets, found others with dt = {period:g}")
        robot.checked(rows, "targets")  # warns if values may be in degrees
        ready, world = self._present()
        if ready.paths is not None and time is None:
            raise InputError("time: expected the time of the tick, since bodies of the scene move or grow, found none")
        self._now, self._left = now, self._steps
        within = math.ceil(min(self._horizon / period, len(rows)) * (1 - SAME_TICK))
        return self._judged(ready, world, state, rows[: max(within, 1)], period, now)

    def proof(self) -> Proof:
        """Write the proof of the last chunk that may run. Other programs can verify the proof without this library.

        Writing a proof takes far longer than a check, so do it outside the control loop.

        Returns
        -------
        Proof
            The proof contains the chunk's motions up to the last target with a proven brake, followed by all pieces of
            the brakes in the order of the ticks. The proof allows all motions the same deviation as the brakes.

        Raises
        ------
        InputError
            If no chunk may run, if the scene has changed since the last check, or if its bodies move or have bounds
            that grow with time.
        ConvergenceError
            If the bounds that the proof format uses do not suffice for a proof.

        See Also
        --------
        CollisionChecker.certify_trajectory : Proves the chunk and one brake as curves, even among moving bodies.

        Examples
        --------
        >>> from loewner import CollisionChecker, Robot, Scene
        >>> gate = Gate(CollisionChecker(Robot.from_urdf("arm.urdf"), Scene()), acceleration=2.0)
        >>> answer = gate.check([0.0, 0.0], [0.0, 0.0], [[0.01, 0.0], [0.02, 0.0]], dt=0.02)
        >>> len(gate.proof().verify().motions)  # two motions, and two brakes of one piece each
        4
        """
        last = self._last
        if last is None:
            raise InputError("proof: expected a chunk that may run, found none")
        ready, world = self._present()
        model = model_of(ready)
        if not (_is_within(world, last.world, self._now) and _is_same(world, last.world)):
            raise InputError("proof: expected the scene of the last chunk that may run, found one that has changed")
        lines = np.stack([last.rows[: last.braked], last.rows[1 : last.braked + 1]], axis=1)
        brake_pieces, error = [], self._error.copy()
        ticks = np.arange(max(last.first, 0), last.braked + 1)
        for j in ticks.tolist():
            brake = self._brakes(last, np.array([j]), int(last.ends[j]))
            brake_pieces.append(self._pieces(ready, brake, None if self._on_path else last.rates[j][None])[0])
            error = error if self._on_path else np.maximum(error, self._error + self._farther(last.rates[j]))
        brakes = np.concatenate(brake_pieces)
        courses = np.concatenate([elevated(lines, brakes.shape[1] - 2), brakes])
        error += (ROUNDED + CURVE_ROUNDINGS) * np.abs(courses).max()
        return proof_of(model, ready, courses, error, None)

    def _present(self) -> tuple[Problem, _World]:
        """Return the pairs and the world at one moment, even if another thread is changing the scene."""
        while True:
            ready = prepared_of(self._checker, timed=True)
            scene = self._checker.scene
            world = _World(ready.structure_version, ready.standing.poses, scene.following, scene.bounds)
            if scene.version == ready.version:
                return ready, world

    def _time(self, given: float | None) -> float:
        """Check the time of a tick."""
        if given is None:
            return 0.0
        time = _validate.real(given, "time")
        if time < self._now:
            raise InputError(
                f"time: expected one that is no earlier than the last one, {self._now:.9g}, found {time:.9g}"
            )
        return time

    # -- the order of a check -----------------------------------------------------------------

    def _judged(self, ready: Problem, world: _World, state: State, wanted: Floats, dt: float, now: float) -> GateAnswer:
        """Prove the new part of a chunk, and return the answer."""
        late = self._periods(dt)
        self._drift = SAME_TICK * dt * max((bounds.rate for bounds in world.bounds.values()), default=0.0)
        count, joint = self._within_limits(state[0], wanted, dt)
        before, holds, is_sure = self._here(world, state, now)
        successors = (self._going_on(old, wanted[:count], dt, world) for old in before)
        chunk = next((successor for successor in successors if successor is not None), None)
        if chunk is None or not holds:
            if not verdicts.free(ready.as_given, self._placed(ready, state[0][None], now))[0]:
                self._last = None
                met = _Block("contact", -1, state[0], now)
                return self._answer(ready, GateState.INSIDE, 0, 0.0, met, self._stop(state, now), False)
            if chunk is None:
                rows = np.vstack([state[0], wanted[:count]])
                ends = np.zeros(len(rows), dtype=np.int64)
                chunk = _Chunk(rows, _rates(rows, state[1], dt), rows[0], dt, now, 0, late + 1, late, ends, world)
            else:  # continue from the last command, which differs from q by up to the error
                chunk = chunk._replace(
                    t0=now, motions=0, first=late + 1, braked=late, motion_stop=None, brake_stop=None
                )
        chunk, block = self._proven(ready, chunk)
        if block is None and count < len(wanted):
            block = _Block("limits", -1, wanted[count], now, joint)
        if block is None and len(chunk.rows) - 1 <= late:  # an order to brake would take effect after the last target
            block = _Block("brake", -1, chunk.rows[-1], now)
        steps, scale = max(chunk.braked - late, 0), 1.0 if block is None else self._scale(ready, chunk, block)
        if block is None or steps > 0:
            self._last = chunk
            reached = GateState.GO if block is None else GateState.PREFIX
            return self._answer(ready, reached, steps, scale, block, self._brake_from(chunk, chunk.braked), True)
        # This chunk may not run, so the robot continues along the last accepted chunk until it brakes. With a latency,
        # the place of the brake depends on the tick, so the tick must be certain.
        for old in before if late == 0 else before[: int(is_sure)]:
            if holds and old.first <= late <= old.braked:
                return self._answer(ready, GateState.BRAKE, 0, scale, block, self._brake_from(old, late), True)
        proven = late == 0 and self._stops_free(ready, state, now)
        return self._answer(ready, GateState.BRAKE, 0, scale, block, self._stop(state, now), proven)

    def _periods(self, dt: float) -> int:
        """Return the latency in whole periods."""
        return math.ceil(min(self._latency / dt * (1 - SAME_TICK), MANY))

    def _within_limits(self, q: Floats, wanted: Floats, dt: float) -> tuple[int, str]:
        """Return how many targets are within the limits, and the name of the joint that exceeds its limits first."""
        robot = self._checker.robot
        speeds = np.abs(np.diff(np.vstack([q, wanted]), axis=0)) / dt
        with np.errstate(over="ignore"):
            speeds[0] -= self._error / dt  # the last command may differ from q by the error
        beyond = (wanted < self._lower) | (wanted > self._upper) | (speeds > self._fastest * (1 + SAME_TICK))
        rows, columns = np.nonzero(beyond)
        return (int(rows[0]), robot.configuration_names[columns[0]]) if len(rows) else (len(wanted), "")

    def _here(self, world: _World, state: State, now: float) -> tuple[list[_Chunk], bool, bool]:
        """Return the last chunk, counted from each tick at which the robot may be, beginning with the likeliest tick.

        Also return whether the chunk's proofs still hold, and whether the first tick is certain. A robot that executes
        the answers is never beyond the proven motions.
        """
        last = self._last
        if last is None:
            return [], False, False
        ticks, tick, holds = range(last.motions + 1), round(min((now - last.t0) / last.dt, MANY)), True
        if world.following or world.bounds:
            early = abs(last.t0 + tick * last.dt - now)
            on_time = early <= SAME_TICK * last.dt
            ticks = range(tick, tick + 1) if on_time and 0 <= tick <= last.motions else range(0)
            # Proofs hold for bounds that begin to grow slightly earlier, but not for bodies elsewhere on their motions.
            holds = early == 0.0 or all(path.rests for path in world.following.values())
        q, dq = state
        off = (np.abs(q - last.rows) > self._error) | (np.abs(dq - last.rates) > self._rate_error)
        near = np.asarray(~off.any(axis=1))
        # If the robot is slow, its state fits several ticks. If the given time advances, the time decides between these
        # ticks, even if no body moves.
        near_ticks = [j for j in ticks if near[j]]
        away: Floats = np.abs(q - last.rows).max(axis=1)
        near_ticks.sort(key=lambda j: -1.0 if 0 < j == tick else float(away[j]))
        is_sure = len(near_ticks) == 1 or (tick > 0 and near_ticks[:1] == [tick])
        here = [last.from_tick(j) for j in near_ticks]
        if not (world.following or world.bounds):  # proofs hold at all times, so the chunk may begin at the given time
            here = [chunk._replace(t0=now) for chunk in here]
        return here, holds and _is_within(world, last.world, now), is_sure

    def _going_on(self, old: _Chunk, wanted: Floats, dt: float, world: _World) -> _Chunk | None:
        """Append new targets to a chunk that continues. Return None if the targets differ from the chunk's targets.

        New targets are proven in the present world. If the present world is within the older world, the proofs of the
        older targets hold in the present world, too.
        """
        old_targets, n = old.rows[1:], len(wanted)
        common = min(len(old_targets), n)
        if common == 0 or dt != old.dt or not np.array_equal(old_targets[:common], wanted[:common]):
            return None
        rows, braked = np.vstack([old.rows[:1], wanted]), min(old.braked, n)
        if self._on_path:  # do not count brakes that were proven on a longer path
            braked -= int((old.ends[max(old.first, 0) : max(braked + 1, 0)] > n).sum())
        same = _is_same(world, old.world)  # stops after the last target are dropped, since new targets may follow
        stops = [stop if same and stop and stop.needed <= n else None for stop in (old.motion_stop, old.brake_stop)]
        return old._replace(
            rows=rows, rates=_rates(rows, old.rates[0], dt), motions=min(old.motions, n), braked=braked,
            ends=np.append(old.ends[: n + 1], np.zeros(max(n - len(old_targets), 0), dtype=np.int64)), world=world,
            motion_stop=stops[0], brake_stop=stops[1],
        )  # fmt: skip

    def _proven(self, ready: Problem, chunk: _Chunk) -> tuple[_Chunk, _Block | None]:
        """Prove motions, and then the brakes from their ends, as far as they are free."""
        n = len(chunk.rows) - 1
        block: _Block | None = None
        stop = chunk.motion_stop
        if stop is not None and stop.tick == chunk.motions < n:
            block = stop.block
        elif chunk.motions < n:
            courses = np.stack([chunk.rows[chunk.motions : -1], chunk.rows[chunk.motions + 1 :]], axis=1)
            begin: Floats = chunk.t0 + chunk.dt * np.arange(float(chunk.motions), float(n))
            error = self._error + ROUNDED * np.abs(chunk.rows).max() if self._on_path else self._error
            free, block = self._first_block(ready, courses, error, begin, begin + chunk.dt)
            m = chunk.motions + free
            chunk = chunk._replace(motions=m, motion_stop=_stop(m, m + 1, block))
        ticks = np.arange(max(chunk.braked + 1, chunk.first, 0), chunk.motions + 1)
        if len(ticks) == 0:
            return chunk, block
        stop = chunk.brake_stop
        if stop is not None and stop.tick == ticks[0] and stop.needed <= n:
            return chunk, stop.block
        ends = chunk.ends.copy()
        ends[ticks], chunk = n, chunk._replace(ends=ends)
        brakes = self._brakes(chunk, ticks, n)
        if self._on_path and ready.paths is None:
            # If no body moves, proven motions are free at all times, and so are brakes on these motions.
            open_ones = np.flatnonzero(brakes.needed - 1 > chunk.motions)
            ticks, brakes = ticks[open_ones], brakes.only(open_ones)
        error, tried, end = np.tile(self._error, (len(ticks), 1)), np.arange(len(ticks)), len(ticks)
        starts: Floats = chunk.t0 + chunk.dt * ticks.astype(np.float64)
        if not self._on_path:
            error += self._farther(chunk.rates[ticks])
            tried = np.flatnonzero(~self._wholes(ready, brakes, chunk.rates[ticks], error, starts))
        # A long brake that fails usually fails at its end, so the ends are proven first. A robot at rest needs no
        # halvings.
        long = tried if self._on_path else tried[brakes.counts[tried] > 2]
        still = np.repeat(brakes.states[long, brakes.counts[long] - 1, :1], 2, axis=1)
        at_rest = starts[long] + brakes.durations[long]
        standing, at_end = self._first_block(ready, still, error[long], at_rest, at_rest)
        if at_end is not None:
            end = int(long[standing])
            tried = tried[tried < end]
        rates = None if self._on_path else chunk.rates[ticks[tried]]
        courses, seconds, first = self._pieces(ready, brakes.only(tried), rates)
        owner = np.repeat(np.arange(len(tried)), np.diff(first))
        after = np.cumsum(seconds)
        after += (starts[tried] - np.append(0.0, after)[first[:-1]])[owner]
        owner = tried[owner]
        free, other = self._first_block(ready, courses, error[owner], after - seconds, after)
        k = end if other is None else int(owner[free])
        other = at_end if other is None else other
        if other is None:
            return chunk._replace(braked=chunk.motions), block
        block, tick = other._replace(reason="brake") if other.reason == "contact" else other, int(ticks[k])
        needed = int(brakes.needed[k]) - 1 if self._on_path else tick
        # With more targets, a brake beyond the last target would take a different way.
        stop = _stop(tick, needed, block) if needed <= n else None
        return chunk._replace(braked=tick - 1, brake_stop=stop), block

    def _first_block(
        self, ready: Problem, courses: Floats, error: Floats, begin: Floats, end: Floats
    ) -> tuple[int, _Block | None]:
        """Prove courses in order; return the number of free ones, and where the next one fails."""
        if len(courses) == 0:
            return 0, None
        if self._left <= 0:
            return 0, _Block("budget", -1, courses[0, 0], float(begin[0]))
        owner, low, high, times, cut, off = self._divided(ready, courses, error, begin, end)
        answers = self._settled(ready, cut, off, Limit(self._left, np.array([0, len(cut)])))
        for k in np.flatnonzero(answers.verdicts != codes.FREE)[:1]:
            share = 0.0 if np.isnan(answers.fractions[k]) else float(answers.fractions[k])
            at = np.array([low[k] + share * (high[k] - low[k])])
            q = configurations(self._checker.robot, courses[owner[k]][None], at)[0]
            t = float(times[k, 0] + share * (times[k, 1] - times[k, 0]))
            hit = verdicts.classified(ready.as_given, codes.EXACT, self._placed(ready, q[None], t)).verdicts[0]
            reason = "contact" if hit == codes.COLLIDING else "budget" if self._left <= 0 else "may be hit"
            return int(owner[k]), _Block(reason, int(answers.pairs[k]), q, t)
        return len(courses), None

    def _wholes(self, ready: Problem, brakes: Brakes, rates: Floats, error: Floats, begin: Floats) -> Bools:
        """Try to prove each brake as one course, which takes a single interval if no obstacle is near.

        Each brake may take about as many steps as one interval takes. If the remaining steps do not suffice for all
        brakes, no brake is tried.
        """
        free, steps = np.zeros(len(rates), dtype=bool), max(len(ready.pairs), LEAST_STEPS)
        chosen = np.flatnonzero(brakes.counts > 2)
        if len(chosen) == 0 or self._left < steps * len(rates):
            return free
        until = np.zeros(len(chosen))
        if ready.paths is not None and self._rate_error.any():
            until = self._stopping_time(np.abs(rates[chosen]) + self._rate_error).max(axis=1)
        wholes = brakes.only(chosen)
        courses, off = wholes.whole(self._jerk is not None, until)
        end = begin[chosen] + np.maximum(until, wholes.durations)
        owner, _, _, _, cut, allowed = self._divided(ready, courses, error[chosen] + off, begin[chosen], end)
        first = np.searchsorted(owner, np.arange(len(chosen) + 1))
        answers = self._settled(ready, cut, allowed, Limit(steps, first))
        free[chosen] = np.bincount(owner[answers.verdicts != codes.FREE], minlength=len(chosen)) == 0
        return free

    def _settled(self, ready: Problem, courses: Floats, off: Floats | None, limit: Limit) -> motions.Found:
        """Prove courses, and count the steps."""
        clear = np.full(len(courses), self._drift) if self._drift > 0.0 else motions.NO_CLEARANCES
        answers = motions.settle(ready, courses, self._tolerance, off, clear, limit)
        self._left -= int(answers.work[:, motions.STEPS].sum())
        return answers

    def _divided(
        self, ready: Problem, courses: Floats, error: Floats, begin: Floats, end: Floats
    ) -> tuple[Ints, Floats, Floats, Floats, Floats, Floats | None]:
        """Divide courses where bodies' motions change; return the fields of `in_time.Pieces`."""
        off: Floats | None = error + OFF * np.abs(courses).max(axis=1) if error.any() else None
        n = len(courses)
        if ready.paths is None:
            return np.arange(n), np.zeros(n), np.ones(n), np.stack([begin, end], axis=1), courses, off
        off = np.zeros((n, courses.shape[2])) if off is None else off
        return in_time.pieces(self._checker.robot, ready.paths, courses, off, begin, end)

    def _scale(self, ready: Problem, chunk: _Chunk, block: _Block) -> float:
        """Find the largest time scale at which a chunk is proven; 0 if there is none."""
        short = len(chunk.rows) - 1 <= self._periods(chunk.dt)
        if short or block.reason == "limits" or (block.reason != "brake" and ready.paths is None):
            return 0.0  # slower motions would meet the same obstacle
        for scale in SCALES:
            dt = chunk.dt / scale
            late = self._periods(dt)
            slower = _Chunk(
                chunk.rows, _rates(chunk.rows, scale * chunk.rates[0], dt), chunk.rows[0], dt, chunk.t0, 0, late + 1,
                late, chunk.ends, chunk.world,
            )  # fmt: skip
            if self._proven(ready, slower)[1] is None:
                return scale
        return 0.0

    # -- brakes -------------------------------------------------------------------------------

    def _brakes(self, chunk: _Chunk, ticks: Ints, end: int) -> Brakes:
        """Brake from ticks. Brakes on the path pass the first `end` targets and then continue along the last motion."""
        if not self._on_path:
            return self._by_joint(chunk.rows[ticks], chunk.rates[ticks])
        rows, ticks = np.vstack([chunk.before, chunk.rows[: end + 1]]), ticks + 1
        at: Floats = chunk.dt * np.arange(float(len(rows)))
        return Brakes.on_path(rows, at, at[ticks], self._strongest, self._jerk, beyond=True)

    def _brake_from(self, chunk: _Chunk, tick: int) -> Trajectory:
        brake = self._brakes(chunk, np.array([tick]), int(chunk.ends[tick])).one()
        return self._trajectory(brake, chunk.t0 + tick * chunk.dt, self._on_path)

    def _stop(self, state: State, now: float) -> Trajectory:
        """Brake from a measured state, joint by joint."""
        return self._trajectory(self._by_joint(*(x[None] for x in state)).one(), now, False)

    def _by_joint(self, Q: Floats, V: Floats) -> Brakes:
        return Brakes.by_joint(Q, V, np.zeros_like(Q), self._strongest, self._jerk)

    def _stops_free(self, ready: Problem, state: State, now: float) -> bool:
        """Return whether a brake from a measured, free state is proven."""
        courses, seconds, _ = self._pieces(ready, self._by_joint(*(x[None] for x in state)), state[1][None])
        end = now + np.cumsum(seconds)
        error = self._error + self._farther(state[1])
        return self._first_block(ready, courses, error, end - seconds, end)[1] is None

    def _pieces(self, ready: Problem, brakes: Brakes, rates: Floats | None) -> tuple[Floats, Floats, Ints]:
        """Return pieces of brakes, extended until a robot with velocity errors rests. On the path, `rates` is None."""
        courses, seconds, first = brakes.courses(self._jerk is not None or rates is None)
        if rates is None or not self._rate_error.any():
            return courses, seconds, first
        later = self._stopping_time(np.abs(rates) + self._rate_error).max(axis=1) - brakes.durations
        if ready.paths is None:  # extend only brakes from rest, which have no pieces
            later[np.diff(first) > 0] = 0.0
        rests = np.flatnonzero(later > 0.0)
        ends = brakes.states[rests, np.maximum(brakes.counts[rests] - 1, 0), 0]
        courses = np.insert(courses, first[rests + 1], ends[:, None], axis=0)
        return courses, np.insert(seconds, first[rests + 1], later[rests]), first + np.append(0, np.cumsum(later > 0.0))

    def _farther(self, rates: Floats) -> Floats:
        """Bound how much farther joints move while braking if their velocities are wrong by the velocity error."""
        fast, v = np.abs(rates) + self._rate_error, np.abs(rates)
        return np.asarray((fast * self._stopping_time(fast) - v * self._stopping_time(v)) / 2.0)

    def _stopping_time(self, v: Floats) -> Floats:
        if self._jerk is None:
            return v / self._strongest
        ramped = v <= self._strongest**2 / self._jerk
        return np.where(ramped, 2.0 * np.sqrt(v / self._jerk), v / self._strongest + self._strongest / self._jerk)

    def _trajectory(self, made: Timed, start: float, jumps: bool) -> Trajectory:
        if self._jerk is None and not jumps:
            made = made._replace(bends=None)
        return protected(Trajectory(self._checker.robot.configuration_names, *made, jumps, start))

    # -- answers ------------------------------------------------------------------------------

    def _placed(self, ready: Problem, Q: Floats, t: float) -> Floats:
        return np.array(in_time.with_bodies(ready, Q, np.full(len(Q), t)), order="C")

    def _answer(
        self, ready: Problem, state: GateState, steps: int, scale: float, block: _Block | None, brake: Trajectory,
        proven: bool,
    ) -> GateAnswer:  # fmt: skip
        """Make an answer with the pair, its distance and its normal."""
        reason, away, normal = "", math.nan, np.full(3, np.nan)
        names: tuple[str, ...] = ()
        if block is not None:
            reason = block.reason
            pair = [block.pair] if block.pair >= 0 else np.arange(len(ready.pairs) if reason == "contact" else 0)
            if len(pair):
                alone, q = ready.as_given.only(np.array(pair)), self._placed(ready, block.q[None], block.t)
                _, _, away, bodies, _, _, normal = (c[0] for c in nearest_columns(alone, q, True, care=False))
                names, away = tuple(ready.names[k] for k in bodies.tolist()), float(away)
            elif reason == "limits":
                names = (block.joint,)
        work = self._steps - self._left
        return GateAnswer(state, steps, scale, reason, names, away, normal, brake, proven, work)


# -- chunks and worlds ----------------------------------------------------------------------------


def _rates(rows: Floats, dq: Floats, dt: float) -> Floats:
    """Compute the velocities at the ticks of a chunk."""
    return np.vstack([dq, np.diff(rows, axis=0) / dt])


def _stop(tick: int, needed: int, block: _Block | None) -> _Stop | None:
    """Record where a proof failed, unless more work might let it succeed."""
    return None if block is None or block.reason == "budget" else _Stop(tick, needed, block)


def _is_same(new: _World, old: _World) -> bool:
    """Return whether a world that is within an older world allows exactly the same places of bodies."""
    return new.bounds == old.bounds and np.array_equal(new.poses, old.poses)


def _is_within(new: _World, old: _World, now: float) -> bool:
    """Return whether an older world allows all places that bodies may have from now on."""
    if new.structure != old.structure or new.following.keys() != old.following.keys():
        return False
    resting = {name for name, path in new.following.items() if path.rests and name in new.bounds}
    exact = len(new.poses) - len(resting)  # resting bodies with bounds are the last ones
    if not np.array_equal(new.poses[:exact], old.poses[:exact]):
        return False
    return all(
        _path_is_within(path, new.bounds.get(name), old.following[name], old.bounds.get(name), now)
        for name, path in new.following.items()
    )


def _path_is_within(
    path: PosePath, bounds: PoseBounds | None, old: PosePath, allowed: PoseBounds | None, now: float
) -> bool:
    same = path is old or (
        path.repeat == old.repeat and np.array_equal(path.times, old.times)
        and np.array_equal(path.positions, old.positions) and np.array_equal(path.quaternions, old.quaternions)
    )  # fmt: skip
    if same and bounds == allowed:
        return True
    if bounds is None or allowed is None or not (same or (path.rests and old.rests)):
        return False
    if max(bounds.since, allowed.since) > now or bounds.speed > allowed.speed or bounds.turn > allowed.turn:
        return False
    # From now on, both bounds grow linearly, and the older bounds grow at least as fast.
    away = float(np.linalg.norm(path.positions[0] - old.positions[0]))
    turned = 0.0
    if not same and not np.array_equal(path.quaternions[0], old.quaternions[0]):
        turned = 2.0 * float(arccos(min(1.0, abs(float(path.quaternions[0] @ old.quaternions[0]))))) + TURNED
    away = 0.0 if same else away
    more = WITHIN * (1.0 + abs(now) + float(np.abs(path.positions[0]).max()))
    off = away + bounds.metres + bounds.speed * (now - bounds.since) + more
    turned += bounds.radians + bounds.turn * (now - bounds.since)
    is_near = off <= allowed.metres + allowed.speed * (now - allowed.since)
    return bool(is_near and turned <= allowed.radians + allowed.turn * (now - allowed.since))
