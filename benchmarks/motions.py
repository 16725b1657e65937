"""Motions proven free, beside the same motions looked at in steps; and paths made of them.

    python benchmarks/motions.py --data FILE [--every N] [--out FOLDER]

FILE is the set of 700 problems of MotionBenchMaker in JSON that docs/scenes.md describes. All of them are planned with
us; every Nth with OMPL's RRT-Connect too, on our checker and on pinocchio with Coal. Results go to
benchmarks/results/<machine>/, or to FOLDER.
"""

from __future__ import annotations

import argparse
import csv
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

import plans
import report
from clock import race, threads_set_to, timed
from loewner import CollisionChecker, Robot, Verdict, read_motion_bench_maker
from motion_bench_maker import Task
from report import REQUIRED, Row
from rivals import Missing
from robot_samples import obstacles, panda, panda_for
from samples import Array

COUNT, QUICK = 1_000, 20
LENGTHS = (0.25, 1.0, 2.0)  # rad, over all joints
STEPS = (0.05, 0.02)  # rad
FINGER = "panda_finger_joint1"
OPEN = 0.04  # m


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=7, help="ask rivals about every Nth problem of a group; 1 for all")
    parser.add_argument(
        "--only-every", type=int, default=1, help="leave out all but every Nth problem, for a short run"
    )
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    facts = report.machine()
    results = options.out or Path(__file__).parent / "results" / report.machine_name(facts)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    problems = [p for p in read_motion_bench_maker(options.data) if p.index % options.only_every == 0]
    with threads_set_to(1):
        tasks = [task for problem in problems if (task := Task.of(problem, arm.robot)).solvable]
        some = [task for task in tasks if task.problem.index % options.every == 0]
        print(f"{len(tasks)} problems that can be solved, {len(some)} of them for rivals too\n", flush=True)
        planned, finished = plans.ours(tasks)
        report.show("plans: processor time of a call", planned)
        hidden = plans.hidden(tasks, finished)
        print("finished paths with a collision that their samples missed:", *plans.table(hidden), "", sep="\n  ")
        asked = plans.asked(some)
        report.show("motions that RRT-Connect asks about, in batches, per motion", asked)
        rivals = plans.beside_ompl(some, arm)
        report.show("plans, beside OMPL's RRT-Connect", rivals)
    report.write(results / "mbm-plans.csv", [*planned, *asked, *rivals], facts)
    with open(results / "mbm-hidden.csv", "w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, list(asdict(hidden[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(asdict, hidden))
    return 0


def run(quick: bool, folder: Path) -> list[Row]:
    count, rounds = (QUICK, 2) if quick else (COUNT, 5)
    try:
        arm = panda()
    except Missing as missing:
        return [
            Row("panda, 10 obstacles", "certify_edges", None, "valid_edges", None, count, note=f"not run: {missing}")
        ]
    checker = CollisionChecker(arm.robot, obstacles(0))
    found: list[Row] = []
    for length in LENGTHS:
        start, end = motions(checker, count, length)
        free = checker.certify_edges(start, end).verdict == Verdict.FREE
        goal = REQUIRED["motions vs samples"] if length == 1.0 else None
        found += beside_samples(checker, f"{length:g} rad, free", start[free], end[free], rounds, goal)
        found += beside_samples(checker, f"{length:g} rad, from free starts", start, end, rounds)
    start, end = single_motions(checker)
    return [*found, *one_by_one(checker, start, end, rounds)]


def motions(checker: CollisionChecker, count: int, length: float) -> tuple[Array, Array]:
    """Motions of a length in random directions from free configurations, fingers open."""
    robot = checker.robot
    start = with_open_fingers(robot, robot.random_configurations(4 * count, 5))
    start = start[~checker.collide(start)][:count]
    way = np.random.default_rng(6).normal(size=start.shape)
    way[:, robot.configuration_names.index(FINGER)] = 0.0
    return start, start + way * length / np.linalg.norm(way, axis=1, keepdims=True)


def with_open_fingers(robot: Robot, Q: Array) -> Array:
    Q = Q.copy()
    Q[:, robot.configuration_names.index(FINGER)] = OPEN
    return Q


def single_motions(checker: CollisionChecker) -> tuple[Array, Array]:
    """A hundred free motions of a radian."""
    start, end = motions(checker, 200, 1.0)
    free = checker.certify_edges(start, end).verdict == Verdict.FREE
    return start[free][:100], end[free][:100]


def beside_samples(
    checker: CollisionChecker, case: str, start: Array, end: Array, rounds: int, goal: float | None = None
) -> list[Row]:
    """One batch, proven and looked at in steps of two lengths; what samples call free and is not, differs."""
    n = len(start)
    ours = checker.certify_edges(start, end)
    contestants = {"proven": timed(partial(checker.certify_edges, start, end), n)}
    contestants |= {f"{step}": timed(partial(checker.valid_edges, start, end, step), n) for step in STEPS}
    costs = race(contestants, rounds)
    shares = np.bincount(ours.verdict, minlength=3) / n
    note = (
        f"free {shares[0]:.1%}, colliding {shares[1]:.1%}, ambiguous {shares[2]:.2%}; "
        f"poses {ours.poses.mean():.1f} (most {ours.poses.max()}), "
        f"searches {ours.searches.mean():.1f} (most {ours.searches.max()})"
    )
    return [
        Row(
            case, "certify_edges", costs["proven"], f"valid_edges at {step}", costs[f"{step}"], n,
            goal if step == min(STEPS) else None,
            int((checker.valid_edges(start, end, step) != (ours.verdict == Verdict.FREE)).sum()), note,
        )
        for step in STEPS
    ]  # fmt: skip


def one_by_one(checker: CollisionChecker, start: Array, end: Array, rounds: int) -> list[Row]:
    """One motion a call."""

    def proven() -> None:
        for a, b in zip(start, end, strict=True):
            checker.certify_edges(a, b)

    def sampled(step: float) -> None:
        for a, b in zip(start, end, strict=True):
            checker.valid_edges(a, b, step)

    n = len(start)
    contestants = {"proven": timed(proven, n)} | {f"{step}": timed(partial(sampled, step), n) for step in STEPS}
    costs = race(contestants, rounds)
    case = "1 rad, free, one a call"
    return [
        Row(case, "certify_edges", costs["proven"], f"valid_edges at {step}", costs[f"{step}"], n) for step in STEPS
    ]


if __name__ == "__main__":
    sys.exit(main())
