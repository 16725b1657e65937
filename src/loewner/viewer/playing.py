"""Play paths on a page: find the robot's position at each time, where it collides, and where it is proven free."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from loewner._base._validate import Floats, Ints, some
from loewner._kernels import codes
from loewner.errors import InputError
from loewner.planners import Trajectory
from loewner.queries.pairs import Verdict
from loewner.queries.pose_paths import PosePath
from loewner.robots import CertifiedTrajectory, CollisionChecker, Robot
from loewner.robots.checker import prepared_of
from loewner.robots.checking.edges import checked_path
from loewner.robots.checking.verdicts import classified
from loewner.robots.proofs import approaches, curves
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.in_time import with_bodies
from loewner.viewer.drawing import VERDICT_COLOURS, Rgb
from loewner.viewer.page import TEXT

# Speed at which a path without times is played, measured by `Robot.distances` [rad/s or m/s].
PACE = 1.0

# Number of evenly spaced times at which the page checks for collisions.
LOOKS = 201

# Colours and names of the results. Elsewhere, an unsettled result (AMBIGUOUS) counts as colliding.
COLOURS = (VERDICT_COLOURS[Verdict.FREE], VERDICT_COLOURS[Verdict.COLLIDING], (119, 119, 119))
NAMES = ("FREE", "COLLIDING", "UNDECIDED")

# Number of parts into which a path without times is divided for its proof, so that a bar shows where it is not free.
PARTS = 60

# Radians or metres by which the ends of the parts may deviate from the path.
ROUNDING = 1e-9

# Words for a part, by its verdict. Samples show where the robot collides within the part.
PROVEN = {Verdict.FREE: "free throughout", Verdict.COLLIDING: "collides within", Verdict.AMBIGUOUS: "open in"}

# Number of colliding or unsettled stretches that are listed.
MOST_STRETCHES = 4


class Path:
    """A path of timed configurations, with constant speed from each configuration to the next.

    Parameters
    ----------
    robot : Robot
    rows : ndarray, shape (n, dof)
        At least two configurations.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Seconds from the first configuration to each configuration.
    duration : float
        Seconds from the first configuration to the last; 0 if all configurations are equal.
    start_time : float
        Start time on the clock of bodies that follow motions, in seconds; 0 for a path.
    """

    start_time = 0.0

    def __init__(self, robot: Robot, rows: Floats) -> None:
        self._robot, self._rows = robot, rows
        lengths = np.asarray(robot.distances(rows[:-1], rows[1:]))
        self.times = np.concatenate([[0.0], np.cumsum(lengths / PACE)])
        self.duration = float(self.times[-1])

    def positions(self, t: Any) -> Floats:
        """Return the configurations at times from 0 to `duration`, shape (..., dof)."""
        at, k = _located(t, self.times)
        length = self.times[k + 1] - self.times[k]
        share = np.divide(at - self.times[k], length, out=np.ones_like(at), where=length > 0)
        return self._robot.between(self._rows[k], self._rows[k + 1], share)


class Standing:
    """A robot that stays in place while bodies move, from the first time of their motions to the last.

    Attributes
    ----------
    q : ndarray, shape (dof,)
        The configuration of the robot, which the page changes.
    duration, start_time : float
        Seconds, as for `Path`.
    """

    def __init__(self, motions: Iterable[PosePath], q: Floats) -> None:
        times = np.concatenate([motion.times for motion in motions])
        self.q, self.start_time = q, float(times.min())
        self.duration = float(times.max()) - self.start_time

    def positions(self, t: Any) -> Floats:
        """Return the configuration at each of the times, shape (..., dof)."""
        return np.broadcast_to(self.q, (*np.shape(t), len(self.q)))


class Executed:
    """A curve in time that is not a `Path`, such as the points that a controller follows.

    Parameters
    ----------
    robot : Robot
    given : ControllerPoints, PPoly, BPoly or BSpline
        As for `CollisionChecker.certify_trajectory`.

    Attributes
    ----------
    given
        The curve that was passed.
    duration, start_time : float
        Seconds, as for `Path`. The start time is the curve's first time plus the curve's own start time, if it has one.
    """

    def __init__(self, robot: Robot, given: Any) -> None:
        self._robot, self.given = robot, given
        self._curve = curves.started(robot, given, "trajectory")
        self.start_time = float(self._curve.times[0])
        self.duration = float(self._curve.times[-1]) - self.start_time

    def positions(self, t: Any) -> Floats:
        """Return the configurations at times from 0 to `duration`, shape (..., dof)."""
        times = self._curve.times - self.start_time
        at, k = _located(t, times)
        shares = np.clip((at - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)
        Q = configurations(self._robot, self._curve.courses[k.ravel()], shares.ravel())
        return Q.reshape(*at.shape, Q.shape[-1])


Way = Trajectory | Path | Standing | Executed


def _located(t: Any, times: Floats) -> tuple[Floats, Ints]:
    """Check that times are between 0 and the last of `times`, and find the part that contains each time."""
    at = np.asarray(t, dtype=float)
    if not ((at >= 0.0) & (at <= times[-1])).all():
        raise InputError(f"t: expected seconds from 0 to {times[-1]:.15g}, found {at.tolist()}")
    return at, np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)


def checked_way(robot: Robot, path: Any, trajectory: Any) -> Trajectory | Path | Executed | None:
    """Return the path to play. Raise an InputError if both arguments are given, or the path is for another robot."""
    if path is not None and trajectory is not None:
        raise InputError("path, trajectory: expected one of the two, found both")
    if isinstance(path, Trajectory):
        return _checked(robot, path, "path")
    if path is not None:
        return Path(robot, checked_path(robot, path))
    return None if trajectory is None else _checked(robot, trajectory, "trajectory")


def _checked(robot: Robot, trajectory: Any, name: str) -> Trajectory | Executed:
    if not isinstance(trajectory, Trajectory):
        if curves.form_of(trajectory, name) is not None:
            return Executed(robot, trajectory)
        raise InputError(
            f"{name}: expected loewner.planners.Trajectory, ControllerPoints or a curve of SciPy, found "
            f"{type(trajectory).__name__}; planners.trajectory makes one of a path, and path= plays configurations"
        )
    if trajectory.names != robot.configuration_names:
        raise InputError(
            f"{name}: expected one of {robot.name!r}, for {', '.join(robot.configuration_names)}; found one for "
            f"{', '.join(trajectory.names)}"
        )
    return trajectory


def found_along(checker: CollisionChecker, way: Way) -> Ints:
    """Return the verdicts at LOOKS evenly spaced times from start to end; an unsettled verdict is AMBIGUOUS."""
    times = np.linspace(0.0, way.duration, LOOKS)
    ready = prepared_of(checker, timed=True)
    Q = np.ascontiguousarray(with_bodies(ready, way.positions(times), way.start_time + times))
    return classified(ready, codes.EXACT, Q).verdicts.astype(np.int64)


class Proof(NamedTuple):
    """The proven verdicts along a path, part by part.

    Attributes
    ----------
    times : ndarray, shape (n + 1,)
        Times, in seconds since the start, at which the parts begin and end.
    verdicts : ndarray of int, shape (n,)
        The verdict for each part. FREE holds at every instant. An AMBIGUOUS part has no proof.
    fractions : ndarray, shape (n,)
        For a part that is not FREE, the fraction of the part at which its proof ended.
    """

    times: Floats
    verdicts: Ints
    fractions: Floats


def proven_along(checker: CollisionChecker, way: Way) -> Proof:
    """Prove the path free, part by part."""
    if isinstance(way, (Trajectory, Executed)):
        curve: CertifiedTrajectory = checker.certify_trajectory(way.given if isinstance(way, Executed) else way)
        segments = curve.segments
        return Proof(curve.times - way.start_time, np.asarray(segments.verdict), np.asarray(segments.fraction))
    times = np.linspace(0.0, way.duration, PARTS + 1)
    if isinstance(way, Path):
        times = np.unique(np.concatenate([way.times, times]))
    rows = way.positions(times)
    clock = way.start_time + times
    timed: Any = {"t0": clock[:-1], "t1": clock[1:]} if checker.scene.following else {}
    edges = checker.certify_edges(rows[:-1], rows[1:], joint_error=ROUNDING, **timed)
    return Proof(times, np.asarray(edges.verdict), np.asarray(edges.fraction))


def worst_along(checker: CollisionChecker, way: Way, proof: Proof) -> float:
    """Return the time, in seconds since the start, at which the distance of the nearest pair is smallest.

    For a path without times, only the sampled times and the times at which proofs ended are compared.
    """
    if isinstance(way, (Trajectory, Executed)):
        near = approaches.worst(checker, way.given if isinstance(way, Executed) else way)
        return min(max(float(near.time[near.nearest]) - way.start_time, 0.0), way.duration)
    ended = (proof.times[:-1] + proof.fractions * np.diff(proof.times))[proof.verdicts != Verdict.FREE]
    times = np.append(np.linspace(0.0, way.duration, curves.MEASURED), ended.clip(0.0, way.duration))
    distances = checker.distance(way.positions(times), way.start_time + times, exact=True)
    return float(times[np.argmin(distances.distance)])


def sampled_strip(found: Ints, duration: float) -> str:
    """Format the answers along the path as a coloured HTML bar, and describe the stretches that are not free."""
    times = np.linspace(0.0, duration, len(found))
    bars = [(NAMES[kind], COLOURS[kind], end - start) for kind, start, end in _stretches(found)]
    bad = [
        f"{NAMES[kind].lower()} {times[start]:.3g} .. {times[end - 1]:.3g} s"
        for kind, start, end in _stretches(found) if kind != Verdict.FREE
    ]  # fmt: skip
    return _strip("along", bars, f"{len(found)} samples: {some(bad, MOST_STRETCHES, '; ') or 'free'}")


def proof_strip(proof: Proof) -> str:
    """Format the proof along the path as a coloured HTML bar, and describe the stretches without a proof."""
    times, bars, bad = proof.times, [], []
    for kind, start, end in _stretches(proof.verdicts):
        verdict = Verdict(kind)
        bars.append((verdict.name, VERDICT_COLOURS[verdict], float(times[end] - times[start])))
        if verdict != Verdict.FREE:
            bad.append(f"{PROVEN[verdict]} {times[start]:.3g} .. {times[end]:.3g} s")
    return _strip("proof along", bars, f"proof: {some(bad, MOST_STRETCHES, '; ') or 'free at every instant'}")


def proven_at(proof: Proof, t: float) -> str:
    """Describe the proof for the part of the path that contains a time."""
    times, parts = proof.times, _stretches(proof.verdicts)
    kind, start, end = next((part for part in parts if t <= times[part[2]]), parts[-1])
    return f"{PROVEN[Verdict(kind)]} {times[start]:.3g} .. {times[end]:.3g} s"


def _strip(name: str, bars: Sequence[tuple[str, Rgb, float]], words: str) -> str:
    parts = "".join(
        f'<div data-loewner="{name} {kind}" style="flex:{share};background:rgb{colour}"></div>'
        for kind, colour, share in bars
    )
    return (
        f'<div style="{TEXT}"><div style="display:flex;height:0.7em;border-radius:3px;overflow:hidden">{parts}</div>'
        f'<div data-loewner="{name}">{escape(words)}</div></div>'
    )


def _stretches(found: Ints) -> list[tuple[int, int, int]]:
    """List the runs of equal answers: the answer, the first index, and the index after the last one."""
    cuts = [0, *(np.flatnonzero(np.diff(found)) + 1).tolist(), len(found)]
    return [(int(found[start]), start, end) for start, end in zip(cuts[:-1], cuts[1:], strict=True)]
