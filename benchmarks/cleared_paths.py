"""Paths that keep away from obstacles (`plan` with `clearance=`), beside the first and the improved path.

    python benchmarks/cleared_paths.py --data FILE [--every N] [--clearance D] [--seconds S]

FILE is the set of 700 problems of MotionBenchMaker in JSON that docs/scenes.md describes. Every Nth problem of a group
is planned. Distances are of the robot from the scene's bodies, at 1,000 configurations of a path at equal steps.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from clock import threads_set_to
from loewner import CollisionChecker, PlanningError, planners, read_motion_bench_maker
from motion_bench_maker import Task
from robot_samples import panda_for
from samples import Array


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=10, help="every Nth problem of a group")
    parser.add_argument("--clearance", type=float, default=0.05, help="metres to keep")
    parser.add_argument("--seconds", type=float, default=0.1, help="time to improve a path")
    options = parser.parse_args(arguments)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    ways = {
        "first path": {},
        "improved": {"improve_for": options.seconds},
        "with a clearance": {"improve_for": options.seconds, "clearance": options.clearance},
    }
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in ways}
    with threads_set_to(1):
        for problem in read_motion_bench_maker(options.data):
            if problem.index % options.every or not (task := Task.of(problem, arm.robot)).solvable:
                continue
            try:
                for name, given in ways.items():
                    rows[name].append(measured(task, options.clearance, **given))
            except PlanningError:
                continue
    print(f"{len(rows['improved'])} paths; clearance {1e3 * options.clearance:g} mm, {options.seconds:g} s")
    print(f"{'':18}{'length':>8}{'least [mm]':>12}{'ends [mm]':>11}{'nearer':>9}{'ms':>8}{'rows':>6}{'proven':>8}")
    for name, found in rows.items():
        length, least, ends, nearer, seconds, count, proven = np.array(found).T
        print(
            f"{name:18}{length.mean():8.2f}{1e3 * np.median(least):12.2f}{1e3 * np.median(ends):11.2f}"
            f"{nearer.mean():9.1%}{1e3 * np.median(seconds):8.1f}{np.median(count):6.0f}{proven.all()!s:>8}"
        )
    return 0


def measured(task: Task, within: float, **given: float) -> tuple[float, ...]:
    """Length of a path, least distance on it and at its ends, share of configurations that are nearer than half the
    clearance, seconds, rows, and whether its motions are proven.
    """
    began = time.perf_counter()
    path = planners.plan(task.checker, task.start, task.goals, joints=list(task.problem.joint_names), **given)  # type: ignore[call-overload]
    seconds = time.perf_counter() - began
    distances = from_scene(task.checker, path, within)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    proven = (task.checker.certify_edges(path[:-1], path[1:]).verdict == 0).all()
    least, ends = distances.min(), min(distances[0], distances[-1])
    return length, least, ends, (distances < 0.5 * within).mean(), seconds, len(path), bool(proven)


def from_scene(checker: CollisionChecker, path: Array, within: float) -> Array:
    """Distances of the robot from the scene along a path, up to `within`."""
    at = np.concatenate([[0.0], np.linalg.norm(np.diff(path, axis=0), axis=1).cumsum()])
    Q = np.array([np.interp(np.linspace(0, at[-1], 1000), at, column) for column in path.T]).T
    near = checker.distance_by_pair(Q, within=within)
    others = np.isin(near.names, checker.scene.names).any(axis=1)
    found = np.full(len(Q), within)
    np.minimum.at(found, near.configuration[others], near.distance[others])
    return found


if __name__ == "__main__":
    sys.exit(main())
