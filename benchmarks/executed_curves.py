"""What runs when a proven path is executed: rivals' curves and ours through a controller, and how many of them collide.

    python benchmarks/executed_curves.py --data FILE [--every N] [--out FOLDER]

FILE is the set of 700 problems that docs/scenes.md describes. Each plan is proven free as a polyline. Then each way to
execute it gives a curve, which is sampled about every 0.001 rad and proven by `certify_trajectory`. Results go to
benchmarks/results/<machine>/, or to FOLDER. The packages toppra and ruckig are needed for the rows that they make.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline

import report
from clock import Cost, race, threads_set_to, timed
from loewner import CollisionChecker, PlanningError, Robot, Verdict, planners, read_motion_bench_maker
from loewner.planners import ControllerPoints, Trajectory
from motion_bench_maker import Task
from rivals import Missing
from robot_samples import panda_for
from samples import Array

HERE = Path(__file__).parent
# Limits of acceleration of MoveIt's configuration of the Panda [rad/s²], and what the finger gets [m/s²], which rests.
ACCELERATION = np.array([3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0, 1.0])
# Limit of the jerk for Ruckig, as a multiple of the acceleration [1/s].
JERK = 10.0
# MoveIt's default deviation from corners, and a tenth of it [rad over all joints].
TOLERANCES = (0.1, 0.01)
# Corners that are straighter, or nearer to a reversal, have no arc (cosine of the angle).
STRAIGHT = 0.999999
# The longest arc that one polynomial stands for [rad].
ARC = 0.25
POINTS = (10, 20, 50)
STEP = 1e-3  # between samples, rad over all joints
SHARES = np.arange(50) / 50  # of each piece of a curve, to measure its length
DEPTHS = 150  # colliding samples of a curve whose depth is measured, at most
ROUNDS = 2
# Instants closer together are one [s].
SAME = 1e-9
PUBLISHED = 0.317
SOURCE = "a cubic piece by sums of squares, arm of 12 joints, their machine: Amice et al., arXiv:2310.16603, slides"
PACKAGES = ("loewner", "numpy", "scipy", "toppra", "ruckig")


@dataclass(frozen=True)
class Curve:
    """A curve that a robot executes.

    `proven` is the curve as `certify_trajectory` takes it, a joint of which may differ from the curve by `error` [rad].
    `at` computes configurations at times without loewner; `times` are the ends of the pieces.
    """

    proven: Any
    at: Callable[[Array], Array]
    times: Array
    degree: int = 3
    error: float = 0.0

    @classmethod
    def controlled(cls, points: ControllerPoints) -> Curve:
        """What ros2_control's joint_trajectory_controller interpolates: lines, or cubics if there are velocities."""
        times, Q = points.times, points.positions
        if points.velocities is not None:
            return cls(points, CubicHermiteSpline(times, Q, points.velocities), times)
        return cls(points, lambda t: np.stack([np.interp(t, times, q) for q in Q.T], axis=1), times, 1)

    def samples(self) -> Array:
        """Configurations about `STEP` apart, and the ends of pieces."""
        fine = np.append((self.times[:-1, None] + np.diff(self.times)[:, None] * SHARES).ravel(), self.times[-1])
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.at(fine), axis=0), axis=1)))
        even = np.interp(np.linspace(0.0, lengths[-1], int(np.ceil(lengths[-1] / STEP)) + 1), lengths, fine)
        return np.ascontiguousarray(self.at(np.union1d(even, self.times)))


@dataclass(frozen=True)
class Plan:
    """A path that is proven free, shape (k, dof), and what moves along it."""

    task: Task
    path: Array

    @property
    def robot(self) -> Robot:
        return self.task.checker.robot

    @cached_property
    def times(self) -> Array:
        """Times of the corners at full speed."""
        return np.append(0.0, np.cumsum((np.abs(np.diff(self.path, axis=0)) / self.robot.velocity).max(axis=1)))

    @cached_property
    def stops(self) -> Trajectory:
        return planners.trajectory(self.robot, self.path, acceleration=ACCELERATION)

    @cached_property
    def blends(self) -> Trajectory:
        return planners.trajectory(self.robot, self.path, acceleration=ACCELERATION, checker=self.task.checker)


# -- ways to execute a path --------------------------------------------------------------------


def polyline(plan: Plan) -> Curve:
    return Curve.controlled(ControllerPoints(plan.times, plan.path))


def clamped(plan: Plan) -> Curve:
    curve = CubicSpline(plan.times, plan.path, bc_type="clamped")
    return Curve(curve, curve, curve.x)


def by_toppra(plan: Plan) -> Curve:
    """The path that toppra makes of waypoints as its documentation shows; its times do not change it."""
    try:
        from toppra import SplineInterpolator
    except ImportError:
        raise Missing("package toppra is not installed") from None
    curve = SplineInterpolator(np.linspace(0, 1, len(plan.path)), plan.path).cspl
    return Curve(curve, curve, curve.x)


def by_ruckig(synchronization: str, plan: Plan) -> Curve:
    """From corner to corner, at rest at each: cubics of all joints between the instants at which any jerk changes."""
    try:
        import ruckig
    except ImportError:
        raise Missing("package ruckig is not installed") from None
    moving = [plan.robot.configuration_names.index(name) for name in plan.task.problem.joint_names]
    dof = len(moving)
    limits = ruckig.InputParameter(dof)
    limits.max_velocity = plan.robot.velocity[moving].tolist()
    limits.max_acceleration = ACCELERATION[moving].tolist()
    limits.max_jerk = (JERK * ACCELERATION[moving]).tolist()
    limits.synchronization = getattr(ruckig.Synchronization, synchronization)
    motions, starts, knots = [], [0.0], [np.zeros(1)]
    for start, end in zip(plan.path[:-1, moving].tolist(), plan.path[1:, moving].tolist(), strict=True):
        limits.current_position, limits.target_position = start, end
        motion = ruckig.Trajectory(dof)
        result = ruckig.Ruckig(dof).calculate(limits, motion)
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise RuntimeError(f"Ruckig found no motion: {result}")
        instants = np.concatenate([np.cumsum(profile.t) for profile in motion.profiles[0]])
        instants = np.unique(instants[(instants > SAME) & (instants < motion.duration - SAME)])
        instants = np.append(instants[np.diff(instants, prepend=0.0) > SAME], motion.duration)
        knots.append(starts[-1] + instants)
        starts.append(starts[-1] + motion.duration)
        motions.append(motion)

    def states(t: Array) -> Array:
        """Positions and velocities, shape (n, 2, dof)."""
        out = np.zeros((len(t), 2, len(plan.path[0])))
        out[:, 0] = plan.path[0]
        numbers = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(motions) - 1)
        for row, k, time in zip(out, numbers.tolist(), t.tolist(), strict=True):
            row[:, moving] = motions[k].at_time(min(time - starts[k], motions[k].duration))[:2]
        return out

    times = np.concatenate(knots)
    held = states(times)
    return Curve(CubicHermiteSpline(times, held[:, 0], held[:, 1]), lambda t: states(t)[:, 0], times)


@dataclass(frozen=True)
class Part:
    """A line from `origin` along `way`, or an arc around `origin` that begins at `outward` and turns to `way`."""

    origin: Array
    way: Array
    length: float
    outward: Array | None = None
    radius: float = np.inf

    def at(self, s: Array, order: int = 0) -> Array:
        """Positions, or derivatives with respect to the length, at lengths since the part began."""
        s = np.asarray(s)[:, None]
        if self.outward is None:
            return (self.origin, np.zeros_like(s), np.zeros_like(s))[order] + (s, 1.0, 0.0)[order] * self.way
        turn = s / self.radius + order * np.pi / 2
        rates = self.radius ** (1 - order) * (self.outward * np.cos(turn) + self.way * np.sin(turn))
        return self.origin + rates if order == 0 else rates


def parts(path: Array, tolerance: float) -> list[Part]:
    """Lines, and arcs at the corners that stay within a tolerance of them and take at most half of each line.

    Kunz and Stilman (2012), "Time-optimal trajectory generation for path following with bounded acceleration and
    velocity", section IV; MoveIt's TOTG follows it.
    """
    found, at = [], path[0]

    def line(end: Array) -> None:
        length = float(np.linalg.norm(end - at))
        if length > SAME:
            found.append(Part(at, (end - at) / length, length))

    for before, corner, after in zip(path[:-2], path[1:-1], path[2:], strict=True):
        u, v = corner - before, after - corner
        lengths = np.linalg.norm(u), np.linalg.norm(v)
        u, v = u / lengths[0], v / lengths[1]
        if abs(u @ v) > STRAIGHT:
            line(corner)
            at = corner
            continue
        half = np.arccos(u @ v) / 2
        away = min(*lengths, 2 * tolerance * np.sin(half) / (1 - np.cos(half))) / 2
        radius = away / np.tan(half)
        center = corner + (v - u) / np.linalg.norm(v - u) * radius / np.cos(half)
        line(corner - away * u)
        found.append(Part(center, u, 2 * half * radius, (corner - away * u - center) / radius, radius))
        at = corner + away * v
    line(path[-1])
    return found


def by_totg(tolerance: float, plan: Plan) -> Curve:
    """MoveIt's path; the polynomials have its positions and two derivatives at the ends of short arcs."""
    made = parts(plan.path, tolerance)
    starts = np.append(0.0, np.cumsum([part.length for part in made]))
    knots, points, error = [0.0], [], 0.0
    for start, part in zip(starts, made, strict=False):
        count = max(int(np.ceil(part.length / part.radius / ARC)), 1)
        s = np.linspace(0.0, part.length, count + 1)
        h = part.length / count
        (q0, q1), (v0, v1), (a0, a1) = ((x[:-1], x[1:]) for x in (h**k * part.at(s, k) for k in range(3)))
        points.append([q0, q0 + v0 / 5, q0 + 2 * v0 / 5 + a0 / 20, q1 - 2 * v1 / 5 + a1 / 20, q1 - v1 / 5, q1])
        if part.outward is not None:
            # The sixth derivative is at most 1 / radius^5.
            error = max(error, part.radius * (h / part.radius) ** 6 / (64 * 720))
        knots += (start + s[1:]).tolist()

    def at(s: Array) -> Array:
        numbers = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(made) - 1)
        out = np.empty((len(s), plan.path.shape[1]))
        for k in np.unique(numbers):
            out[numbers == k] = made[k].at(s[numbers == k] - starts[k])
        return out

    return Curve(BPoly(np.concatenate(points, axis=1), np.array(knots)), at, np.array(knots), 5, error)


def spaced(kind: str, count: int, cubic: bool, plan: Plan) -> Curve:
    """Points of our trajectory at equal distances in time, through a controller."""
    moved: Trajectory = getattr(plan, kind)
    t = np.linspace(0.0, moved.duration, count)
    return Curve.controlled(ControllerPoints(t, moved.positions(t), moved.velocities(t) if cubic else None))


def saved(kind: str, plan: Plan) -> Curve:
    """The file that `Trajectory.save` writes, through a controller."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "moved.csv")
        getattr(plan, kind).save(file)
        return Curve.controlled(ControllerPoints.load(file))


WAYS: dict[str, Callable[[Plan], Curve]] = {
    "the polyline itself": polyline,
    "Ruckig, stop at each corner, time synchronisation": partial(by_ruckig, "Time"),
    "Ruckig, stop at each corner, phase synchronisation": partial(by_ruckig, "Phase"),
    "TOPP-RA on its spline through the corners": by_toppra,
    "clamped cubic spline through the corners": clamped,
    **{f"TOTG, tolerance {tolerance:g} rad": partial(by_totg, tolerance) for tolerance in TOLERANCES},
    **{
        f"our {kind}, {count} points, {'cubic' if cubic else 'linear'}": partial(spaced, kind, count, cubic)
        for kind in ("blends", "stops")
        for cubic in (False, True)
        for count in POINTS
    },
    **{f"our {kind}, saved knots, cubic": partial(saved, kind) for kind in ("blends", "stops")},
}  # fmt: skip


# -- what happens to them ----------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """One curve: its verdict, whether a sample collides, the largest depth [m], numbers of pieces, and seconds.

    The time of sampling is that of `collide` alone, without the time to compute the samples.
    """

    degree: int
    verdict: Verdict
    hit: bool
    depth: float
    pieces: int
    samples: int
    proof: Cost
    sampling: Cost


def judged(checker: CollisionChecker, curve: Curve) -> Found:
    Q = curve.samples()
    hits = checker.collide(Q)
    prove = partial(checker.certify_trajectory, curve.proven, joint_error=curve.error)
    costs = race({"proof": timed(prove, 1), "sampling": timed(partial(checker.collide, Q), 1)}, ROUNDS)
    depth = deepest(checker, Q[hits])
    return Found(curve.degree, prove().verdict, bool(hits.any()), depth, len(curve.times) - 1, len(Q), **costs)


def deepest(checker: CollisionChecker, Q: Array) -> float:
    """The largest depth [m] of some of the configurations, which all collide; NaN of none."""
    if len(Q) == 0:
        return np.nan
    return -float(checker.distance(Q[:: -(-len(Q) // DEPTHS)], exact=True).distance.min())


def summary(way: str, found: Sequence[Found], note: str) -> dict[str, Any]:
    """A row of results: counts, depths in mm, and times over the curves that are proven free."""
    free = [f for f in found if f.verdict == Verdict.FREE]
    depths = [1e3 * f.depth for f in found if f.hit]
    proof, sampling = (sum(getattr(f, key).cpu for f in free) for key in ("proof", "sampling"))
    piece = 1e6 * proof / sum(f.pieces for f in free) if free else None

    def median(values: Sequence[float]) -> float | None:
        return float(np.median(values)) if values else None

    return {
        "executed": way,
        "plans": len(found),
        "sampled_colliding": len(depths),
        "sampled_share": len(depths) / len(found) if found else None,
        **{verdict.name.lower(): sum(f.verdict == verdict for f in found) for verdict in Verdict},
        "free_but_sampled_colliding": sum(f.hit for f in free),
        "colliding_missed_by_samples": sum(f.verdict == Verdict.COLLIDING and not f.hit for f in found),
        "depth_median_mm": median(depths),
        "depth_largest_mm": max(depths, default=None),
        "pieces": median([f.pieces for f in free]),
        "proof_us_per_piece": piece,
        "proof_ms": median([1e3 * f.proof.cpu for f in free]),
        "samples": median([f.samples for f in free]),
        "sampling_ms": median([1e3 * f.sampling.cpu for f in free]),
        "sampling_over_proof": sampling / proof if free else None,
        "published_over_proof": 1e6 * PUBLISHED / piece if free and free[0].degree == 3 else None,
        "note": note,
    }


def planned(task: Task) -> Plan | None:
    """The path of our planner; None if there is none."""
    if not task.solvable:
        return None
    try:
        path = planners.plan(task.checker, task.start, task.usable_goals, joints=task.problem.joint_names, timeout=5.0)
    except PlanningError:
        return None
    return Plan(task, path)


def executed(tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """A row for each way to execute the paths of all problems."""
    found: dict[str, list[Found]] = {way: [] for way in WAYS}
    notes = dict.fromkeys(WAYS, "")
    for number, task in enumerate(tasks, 1):
        plan = planned(task)
        for way, make in WAYS.items() if plan is not None else ():
            try:
                found[way].append(judged(task.checker, make(plan)))
            except Missing as missing:
                notes[way] = f"not run: {missing}"
        if number % 50 == 0:
            print(f"{number} of {len(tasks)} problems", file=sys.stderr, flush=True)
    return [summary(way, found[way], notes[way]) for way in WAYS]


# Columns of the printed tables: heading, key of the row, format.
VERDICTS = (
    ("plans", "plans", "d"), ("sampled", "sampled_colliding", "d"), ("share", "sampled_share", ".1%"),
    ("free", "free", "d"), ("coll.", "colliding", "d"), ("amb.", "ambiguous", "d"),
    ("wrong", "free_but_sampled_colliding", "d"), ("missed", "colliding_missed_by_samples", "d"),
    ("mm", "depth_median_mm", ".2f"), ("most", "depth_largest_mm", ".1f"),
)  # fmt: skip
TIMES = (
    ("pieces", "pieces", ".0f"), ("us each", "proof_us_per_piece", ".1f"), ("ms", "proof_ms", ".3f"),
    ("samples", "samples", ".0f"), ("ms", "sampling_ms", ".2f"), ("ratio", "sampling_over_proof", ".1f"),
    ("0.3 s", "published_over_proof", ",.0f"),
)  # fmt: skip
LEGEND = f"""
wrong: FREE, but a sample collides; missed: COLLIDING, but no sample collides; mm, most: median and largest depth.
Times are processor times of curves that are proven free. 0.3 s: {PUBLISHED} s over our time for a piece;
{SOURCE}."""


def show(rows: Sequence[dict[str, Any]]) -> None:
    """Print the rows as two tables, of verdicts and of times."""
    for columns in (VERDICTS, TIMES):
        print(f"{'what runs':52}" + "".join(f"{heading:>9}" for heading, _, _ in columns))
        for row in rows:
            cells = ("-" if row[key] is None else format(row[key], form) for _, key, form in columns)
            print(f"{row['executed']:52}" + "".join(f"{cell:>9}" for cell in cells), row["note"])
        print()
    print(LEGEND.strip())


def write(rows: Sequence[dict[str, Any]], path: Path, facts: dict[str, Any], versions: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as out:
        last = {"packages": versions, "commit": facts["commit"], "date": facts["date"]}
        writer = csv.DictWriter(out, [*rows[0], *last], lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({key: f"{x:.4g}" if isinstance(x, float) else x for key, x in row.items()} | last)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=1, help="every Nth problem of a group; 1 for all")
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    robot = arm.robot
    facts = report.machine()
    versions = ", ".join(f"{name} {report.version_of(name) or 'missing'}" for name in PACKAGES)
    print(f"{versions}; {facts['processor']}, load {facts['load']}\n", flush=True)
    with threads_set_to(1):
        problems = [p for p in read_motion_bench_maker(options.data) if p.index % options.every == 0]
        rows = executed([Task.of(problem, robot) for problem in problems])
    show(rows)
    write(rows, (options.out or HERE / "results" / report.machine_name(facts)) / "executed-curves.csv", facts, versions)
    return 0


if __name__ == "__main__":
    sys.exit(main())
