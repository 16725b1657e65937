"""Trajectories along planned paths for Panda: blends beside stops, limits of jerk, and TOPP-RA and Ruckig beside them.

    python benchmarks/trajectories.py --data FILE [--every N] [--out FOLDER]

FILE is the set of 700 problems that docs/scenes.md describes. Results go to benchmarks/results/<machine>/, or to
FOLDER. If toppra and ruckig are installed (pip install toppra ruckig), toppra is asked for times along the blended
paths, and ruckig for motions between the corners.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

import report
from clock import threads_set_to
from loewner import PlanningError, Robot, planners, read_motion_bench_maker
from loewner.planners import Trajectory
from motion_bench_maker import Task
from robot_samples import panda_for
from samples import Array

HERE = Path(__file__).parent
# Limits of acceleration: what the maker of the arm states (rad/s², the finger m/s²), and those of `trajectory`.
STATED = [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0, 1.0]
LIMITS = {"stated": STATED, "default": None}
# Limits of jerk, in units of the limits of acceleration: the maker's.
JERK = 500.0
# A motion of Ruckig leaves the straight line if it is farther from it than this (rad), at so many times.
OFF_LINE, TIMES = 1e-6, 200
# Where TOPP-RA holds limits, beside the ends of blends; and where what it found is looked at.
GRID, LOOKS = 800, 20_000
SAMPLES = 2_000


@dataclass(frozen=True)
class Result:
    """One path with one set of limits.

    Attributes
    ----------
    corners, blends : int
    stopping, blended : float
        Seconds that the robot takes.
    stopping_ms, blended_ms : float
        Milliseconds to find that out: the best of several.
    colliding : int
        Samples of the blended trajectory that collide.
    toppra_share, toppra_ms, toppra_excess : float or None
        TOPP-RA on the same curve: seconds as a share of `blended`, milliseconds, and the largest acceleration as a
        multiple of the limit.
    smooth_stopping, smooth_blended : float
        Seconds with limits of jerk.
    smooth_blends : int
    smooth_excess : float
        The largest velocity, acceleration or jerk of both, at any real time, as a multiple of its limit.
    smooth_verdict : int
        Verdict of the blended one.
    ruckig_share, ruckig_off : float, int or None
        Seconds of Ruckig for the motions on which it stays on the straight line, as a share of those of `trajectory`;
        and the number of motions on which it does not.
    """

    group: str
    limits: str
    corners: int
    blends: int
    stopping: float
    blended: float
    stopping_ms: float
    blended_ms: float
    colliding: int
    toppra_share: float | None
    toppra_ms: float | None
    toppra_excess: float | None
    smooth_stopping: float
    smooth_blended: float
    smooth_blends: int
    smooth_excess: float
    smooth_verdict: int
    ruckig_share: float | None
    ruckig_off: int | None


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=14, help="every Nth problem of a group; 1 for all")
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    robot = arm.robot
    results = options.out or HERE / "results" / report.machine_name(report.machine())
    with threads_set_to(1):
        problems = [p for p in read_motion_bench_maker(options.data) if p.index % options.every == 0]
        found = [result for problem in problems for result in measured(Task.of(problem, robot))]
    write(found, results / "mbm-trajectories.csv")
    for name in LIMITS:
        print(summary(name, [result for result in found if result.limits == name]))
    return 0


def measured(task: Task) -> list[Result]:
    """Both trajectories of the path that `plan` finds, for each set of limits; none of paths without corners."""
    if not task.solvable:
        return []
    try:
        path = planners.plan(task.checker, task.start, task.usable_goals, joints=task.problem.joint_names, timeout=5.0)
    except PlanningError:
        return []
    robot, found = task.checker.robot, []
    for name, limits in LIMITS.items() if len(path) > 2 else ():
        stopping, stopping_ms = best(lambda a=limits: planners.trajectory(robot, path, acceleration=a))
        blended, blended_ms = best(
            lambda a=limits: planners.trajectory(robot, path, acceleration=a, checker=task.checker)
        )
        hits = task.checker.collide(blended.positions(np.linspace(0, blended.duration, SAMPLES)))
        acceleration = robot.velocity if limits is None else np.array(limits)
        rival = by_toppra(robot, blended, acceleration)
        found.append(
            Result(
                task.problem.group, name, len(path) - 2, len(blended.blends), stopping.duration, blended.duration,
                stopping_ms, blended_ms, int(hits.sum()), *(rival or (None, None, None)),
                *smooth(task, path, acceleration),
            )
        )  # fmt: skip
    return found


def best(make: Any, rounds: int = 5) -> tuple[Trajectory, float]:
    """What a call returns, and the milliseconds of the fastest of several."""
    seconds = []
    for _ in range(rounds):
        began = time.perf_counter()
        made = make()
        seconds.append(time.perf_counter() - began)
    return made, 1e3 * min(seconds)


def smooth(task: Task, path: Array, acceleration: Array) -> list[Any]:
    """Trajectories with limits of jerk, and Ruckig's motions between the corners."""
    robot, jerk = task.checker.robot, JERK * acceleration
    stopping = planners.trajectory(robot, path, acceleration=acceleration, jerk=jerk)
    blended = planners.trajectory(robot, path, acceleration=acceleration, jerk=jerk, checker=task.checker)
    excess = max(largest_share(moved, (robot.velocity, acceleration, jerk)) for moved in (stopping, blended))
    verdict = int(task.checker.certify_trajectory(blended, tolerance=1e-7).verdict)
    rival = by_ruckig(robot, path, acceleration, jerk) or (None, None)
    return [stopping.duration, blended.duration, len(blended.blends), excess, verdict, *rival]


def largest_share(moved: Trajectory, limits: Sequence[Array]) -> float:
    """The largest velocity, acceleration or jerk of the cubics through the knots, as a multiple of its limit."""
    pieces = CubicHermiteSpline(moved.times, moved.knots, moved.rates)
    T = np.diff(moved.times)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = np.nan_to_num(np.clip(-pieces.c[1] / (3 * pieces.c[0]), 0, T))  # where the acceleration is 0
    speeds = [(3 * pieces.c[0] * t + 2 * pieces.c[1]) * t + pieces.c[2] for t in (0 * T, T, turning)]
    accelerations = [6 * pieces.c[0] * t + 2 * pieces.c[1] for t in (0 * T, T)]
    found = zip((speeds, accelerations, [6 * pieces.c[0]]), limits, strict=True)
    return max(float((np.abs(values) / limit).max()) for values, limit in found)


def by_ruckig(robot: Robot, path: Array, acceleration: Array, jerk: Array) -> tuple[float | None, int] | None:
    """Ruckig's seconds, with phase synchronisation, as a share, and the number of its motions that leave the line."""
    try:
        import ruckig
    except ImportError:
        return None
    ours, theirs, off = 0.0, 0.0, 0
    for a, b in zip(path[:-1], path[1:], strict=True):
        given = ruckig.InputParameter(robot.dof)
        given.current_position, given.target_position = a.tolist(), b.tolist()
        given.max_velocity, given.max_acceleration = robot.velocity.tolist(), acceleration.tolist()
        given.max_jerk, given.synchronization = jerk.tolist(), ruckig.Synchronization.Phase
        found = ruckig.Trajectory(robot.dof)
        if ruckig.Ruckig(robot.dof).calculate(given, found) < 0:
            continue
        Q = np.array([found.at_time(t)[0] for t in np.linspace(0, found.duration, TIMES)])
        shares = (Q - a) @ (b - a) / ((b - a) @ (b - a))
        if np.abs(a + shares[:, None] * (b - a) - Q).max() > OFF_LINE:
            off += 1
            continue
        theirs += found.duration
        ours += planners.trajectory(robot, [a, b], acceleration=acceleration, jerk=jerk).duration
    return theirs / ours if ours else None, off


class Curve:
    """The way of a trajectory as toppra takes it: by seconds at full speed, so that the first derivative has no jumps.

    Over a blend it turns at a constant rate.
    """

    def __init__(self, moved: Trajectory, velocity: Array) -> None:
        self.dof, self.waypoints = len(moved.names), None
        ways = np.diff(moved.knots, axis=0)
        middles = moved.knots[:-1] + moved.rates[:-1] * np.diff(moved.times)[:, None] / 2
        halves = np.abs(np.stack([middles - moved.knots[:-1], moved.knots[1:] - middles]) / velocity)
        lengths = halves.max(axis=2).sum(axis=0)
        self.starts = np.concatenate([[0.0], np.cumsum(lengths)])
        self.path_interval = np.array([0.0, self.starts[-1]])
        straight = ~moved.blended[:, None]
        self.knots = moved.knots
        self.first = np.where(straight, ways, 2 * (middles - moved.knots[:-1])) / lengths[:, None]
        last = np.where(straight, ways, 2 * (moved.knots[1:] - middles)) / lengths[:, None]
        self.second = (last - self.first) / lengths[:, None]

    def __call__(self, s: Any, order: int = 0) -> Array:
        s = np.asarray(s, dtype=float)
        k = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, len(self.first) - 1)
        h = (s - self.starts[k])[..., None]
        if order == 0:
            return np.asarray(self.knots[k] + h * self.first[k] + h * h * self.second[k] / 2)
        return np.asarray(self.first[k] + h * self.second[k] if order == 1 else self.second[k])


def by_toppra(robot: Robot, moved: Trajectory, acceleration: Array) -> tuple[float, float, float] | None:
    """TOPP-RA's seconds as a share, its milliseconds, and how far it goes beyond the limits of acceleration."""
    try:
        from toppra import setup_logging
        from toppra.algorithm import TOPPRA
        from toppra.constraint import DiscretizationType, JointAccelerationConstraint, JointVelocityConstraint
        from toppra.interpolator import AbstractGeometricPath
    except ImportError:
        return None
    setup_logging("ERROR")
    path = type("Path", (Curve, AbstractGeometricPath), {"dof": 0, "path_interval": None, "waypoints": None})(
        moved, robot.velocity
    )
    began = time.perf_counter()
    constraints = [
        JointVelocityConstraint(np.stack([-robot.velocity, robot.velocity], axis=1)),
        JointAccelerationConstraint(
            np.stack([-acceleration, acceleration], axis=1), discretization_scheme=DiscretizationType.Interpolation
        ),
    ]
    grid = np.union1d(np.linspace(*path.path_interval, GRID), path.starts)
    found = TOPPRA(constraints, path, gridpoints=grid).compute_trajectory(0, 0)
    took = 1e3 * (time.perf_counter() - began)
    if found is None:
        return None
    excess = np.abs(found(np.linspace(0, found.duration, LOOKS), 2)) / acceleration
    return found.duration / moved.duration, took, float(excess.max())


def summary(name: str, found: Sequence[Result]) -> str:
    """A line for people."""
    if not found:
        return f"{name} limits: no path with corners"
    stopping, blended = (sum(getattr(result, key) for result in found) for key in ("stopping", "blended"))
    text = (
        f"{name} limits: {len(found)} paths, {sum(r.blends for r in found)} of {sum(r.corners for r in found)} corners "
        f"blended; {stopping / len(found):.2f} s with stops, {blended / len(found):.2f} s with blends "
        f"({blended / stopping:.3f}); found in {np.median([r.stopping_ms for r in found]):.2f} and "
        f"{np.median([r.blended_ms for r in found]):.1f} ms; {sum(r.colliding for r in found)} samples collide"
    )
    rivals = [r for r in found if r.toppra_share is not None]
    if rivals:
        shares, took, excess = (
            np.array([getattr(r, key) for r in rivals]) for key in ("toppra_share", "toppra_ms", "toppra_excess")
        )
        text += (
            f"; TOPP-RA: {np.median(shares):.3f} of the time (least {shares.min():.3f}), found in "
            f"{np.median(took):.0f} ms, with accelerations up to {np.median(excess):.2f} of the limits "
            f"(most {excess.max():.2f})"
        )
    else:
        text += "; without TOPP-RA, since toppra is not installed"
    stopping, blended = (sum(getattr(result, key) for result in found) for key in ("smooth_stopping", "smooth_blended"))
    text += (
        f"\n  with limits of jerk: {sum(r.smooth_blends for r in found)} corners blended; "
        f"{stopping / len(found):.2f} s with stops, {blended / len(found):.2f} s with blends "
        f"({blended / stopping:.3f}); at most {max(r.smooth_excess for r in found):.7f} of a limit at any time; "
        f"{sum(r.smooth_verdict == 0 for r in found)} of {len(found)} blended ones are proven free"
    )
    shares = np.array([r.ruckig_share for r in found if r.ruckig_share is not None])
    if not len(shares):
        return text + "; without Ruckig, since ruckig is not installed"
    return text + (
        f"; Ruckig takes {shares.min():.4f} to {shares.max():.4f} of the time with stops, and leaves the line on "
        f"{sum(r.ruckig_off or 0 for r in found)} motions"
    )


def write(found: Sequence[Result], path: Path) -> None:
    """All results as a CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Result)])
        writer.writeheader()
        writer.writerows(asdict(result) for result in found)


if __name__ == "__main__":
    sys.exit(main())
