"""Play paths on a page: find the robot's position at each time, and where it collides along the path."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from loewner._kernels import codes
from loewner._validate import Floats, Ints
from loewner.errors import InputError
from loewner.planners import Trajectory
from loewner.queries import Verdict
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checker import prepared_of
from loewner.robots.edges import checked_path
from loewner.robots.in_time import with_bodies
from loewner.robots.verdicts import classified
from loewner.viewer.drawing import VERDICT_COLOURS, Rgb
from loewner.viewer.page import TEXT

# A path has no times: it is played at this speed, measured by `Robot.distances` [rad or m per second].
PACE = 1.0

# Number of evenly spaced times at which the page checks for collisions.
LOOKS = 201

# Results of these checks; an unsettled one, which counts as colliding elsewhere, has its own colour here.
FREE, COLLIDING, UNSETTLED = 0, 1, 2
COLOURS: dict[int, Rgb] = {
    FREE: VERDICT_COLOURS[Verdict.FREE],
    COLLIDING: VERDICT_COLOURS[Verdict.COLLIDING],
    UNSETTLED: (119, 119, 119),
}
# By verdict.
SEEN = np.array([FREE, COLLIDING, UNSETTLED])
NAMES = {FREE: "FREE", COLLIDING: "COLLIDING", UNSETTLED: "UNDECIDED"}

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
    duration : float
        Seconds from the first configuration to the last; 0 if all are equal.
    start_time : float
        When it starts, on the clock of bodies that follow motions: 0.
    """

    start_time = 0.0

    def __init__(self, robot: Robot, rows: Floats) -> None:
        self._robot, self._rows = robot, rows
        lengths = np.asarray(robot.distances(rows[:-1], rows[1:]))
        self._times = np.concatenate([[0.0], np.cumsum(lengths / PACE)])
        self.duration = float(self._times[-1])

    def positions(self, t: Any) -> Floats:
        """Return the configurations at times from 0 to `duration`, shape (..., dof)."""
        at = np.asarray(t, dtype=float)
        if not ((at >= 0.0) & (at <= self.duration)).all():
            raise InputError(f"t: expected seconds from 0 to {self.duration:g}, found {at.tolist()}")
        k = np.clip(np.searchsorted(self._times, at, side="right") - 1, 0, len(self._rows) - 2)
        length = self._times[k + 1] - self._times[k]
        share = np.divide(at - self._times[k], length, out=np.ones_like(at), where=length > 0)
        return self._robot.between(self._rows[k], self._rows[k + 1], share)


def checked_way(robot: Robot, path: Any, trajectory: Any) -> Trajectory | Path | None:
    """Return the path to play, from two parameters; InputError if both are given, or it is for a different robot."""
    if path is not None and trajectory is not None:
        raise InputError("path, trajectory: expected one of the two, found both")
    if isinstance(path, Trajectory):
        return _checked(robot, path, "path")
    if path is not None:
        return Path(robot, checked_path(robot, path))
    return None if trajectory is None else _checked(robot, trajectory, "trajectory")


def _checked(robot: Robot, trajectory: Any, name: str) -> Trajectory:
    if not isinstance(trajectory, Trajectory):
        raise InputError(
            f"{name}: expected loewner.planners.Trajectory, found {type(trajectory).__name__}; "
            "planners.trajectory makes one of a path, and path= plays configurations"
        )
    if trajectory.names != robot.configuration_names:
        raise InputError(
            f"{name}: expected one of {robot.name!r}, for {', '.join(robot.configuration_names)}; found one for "
            f"{', '.join(trajectory.names)}"
        )
    return trajectory


def found_along(checker: CollisionChecker, way: Trajectory | Path) -> Ints:
    """Return FREE, COLLIDING or UNSETTLED at each of LOOKS times, evenly spaced from start to end."""
    times = np.linspace(0.0, way.duration, LOOKS)
    ready = prepared_of(checker, timed=True)
    found, _ = classified(
        ready, codes.EXACT, np.ascontiguousarray(with_bodies(ready, way.positions(times), way.start_time + times))
    )
    return SEEN[found]


def strip(found: Ints, duration: float) -> str:
    """Format the answers along the path as a coloured HTML bar, and describe the stretches that are not free."""
    bars = "".join(
        f'<div data-loewner="along {NAMES[kind]}" style="flex:{end - start};background:rgb{COLOURS[kind]}"></div>'
        for kind, start, end in _stretches(found)
    )
    step = duration / (len(found) - 1)
    bad = [
        f"{NAMES[kind].lower()} {start * step:.3g} .. {(end - 1) * step:.3g} s"
        for kind, start, end in _stretches(found) if kind != FREE
    ]  # fmt: skip
    if len(bad) > MOST_STRETCHES:
        bad = [*bad[:MOST_STRETCHES], f"and {len(bad) - MOST_STRETCHES} more"]
    words = "; ".join(bad) or "free"
    return (
        f'<div style="{TEXT}"><div style="display:flex;height:0.7em;border-radius:3px;overflow:hidden">{bars}</div>'
        f'<div data-loewner="along">{escape(words)}: looked at {len(found)} times, not between them</div></div>'
    )


def _stretches(found: Ints) -> list[tuple[int, int, int]]:
    """List the runs of equal answers, each as the answer, the first index, and the index after the last."""
    cuts = [0, *(np.flatnonzero(np.diff(found)) + 1).tolist(), len(found)]
    return [(int(found[start]), start, end) for start, end in zip(cuts[:-1], cuts[1:], strict=True)]
