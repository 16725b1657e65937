"""Straight lines bent free by gradients: MotionBenchMaker's problems, exact and smooth distances, finite differences.

    python benchmarks/path_optimisation.py --data FILE [--count 100] [--points 32] [--out FOLDER]

FILE is the set of 700 problems in JSON that docs/scenes.md describes. Of the problems whose straight line collides,
`count` are taken, spread over all groups. SciPy's L-BFGS-B minimises the squared length of the path and what its points
lack of a distance, until all motions between its points are proven free. What differs is the distance and its gradient:

    exact                 `distance(exact=True, gradient=True)`
    smooth                `clearance(gradient=True)`
    finite differences    `distance(exact=True)`, at one configuration more for each joint
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize

import report
from clock import threads_set_to
from loewner import CollisionChecker, Verdict, read_motion_bench_maker
from motion_bench_maker import Task
from robot_samples import panda_for
from samples import Array

KEEP = 0.01  # metres
ARM = slice(0, 7)
STEP = 1e-6  # rad
MOST = 100  # iterations

# Metres that are kept: the smooth distance is below the exact one by what ellipsoids are larger than their pieces.
AIMS = {"exact": 2 * KEEP, "smooth, softness 5 mm": -2 * KEEP, "finite differences": 2 * KEEP}

Distances = Callable[[CollisionChecker, Array], tuple[Array, Array]]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--count", type=int, default=100, help="problems")
    parser.add_argument("--points", type=int, default=32, help="points of a path")
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    facts = report.machine()
    results = options.out or Path(__file__).parent / "results" / report.machine_name(facts)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    with threads_set_to(1):
        tasks = colliding([Task.of(problem, arm.robot) for problem in read_motion_bench_maker(options.data)])
        chosen = [tasks[k] for k in np.linspace(0, len(tasks) - 1, min(options.count, len(tasks))).astype(int)]
        rows = [raced(name, chosen, options.points) for name in AIMS]
    show(rows, len(chosen))
    results.mkdir(parents=True, exist_ok=True)
    written = {"machine": facts, "problems": len(chosen), "rows": rows}
    (results / "path-optimisation.json").write_text(json.dumps(written, indent=1) + "\n")
    return 0


def colliding(tasks: Sequence[Task]) -> list[Task]:
    """Problems whose ends are free and whose straight line to the first goal is not."""
    found = []
    for task in tasks:
        if task.start_free and len(task.usable_goals):
            verdict = task.checker.certify_edges(task.start, task.usable_goals[0]).verdict
            if verdict == Verdict.COLLIDING:
                found.append(task)
    return found


@dataclass
class Bending:
    """One problem on its way."""

    checker: CollisionChecker
    path: Array
    distances: Distances
    aim: float
    evaluations: int = 0

    def with_inner(self, inner: Array) -> Array:
        path = self.path.copy()
        path[1:-1, ARM] = inner.reshape(len(path) - 2, -1)
        return path

    def cost(self, inner: Array) -> tuple[float, Array]:
        """Squared length, what the points lack of the distance asked for, and the gradient of both."""
        self.evaluations += 1
        path = self.with_inner(inner)
        steps, gradient = np.diff(path, axis=0), np.zeros_like(path)
        gradient[:-1] -= 2 * steps
        gradient[1:] += 2 * steps
        distance, slopes = self.distances(self.checker, path)
        lacking = np.maximum(self.aim - distance, 0.0) / KEEP
        gradient -= (2 / KEEP) * lacking[:, None] * slopes
        return float((steps**2).sum() + (lacking**2).sum()), gradient[1:-1, ARM].ravel()

    def is_free(self, inner: Array) -> bool:
        path = self.with_inner(inner)
        return bool((self.checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all())

    def stop_if_free(self, inner: Array) -> None:
        if self.is_free(inner):
            raise StopIteration


def exact(checker: CollisionChecker, Q: Array) -> tuple[Array, Array]:
    found = checker.distance(Q, exact=True, gradient=True)
    return found.distance, found.gradient


def smooth(checker: CollisionChecker, Q: Array) -> tuple[Array, Array]:
    return checker.clearance(Q, gradient=True)


def by_differences(checker: CollisionChecker, Q: Array) -> tuple[Array, Array]:
    """Forward differences by the joints of the arm, all in one batch."""
    moved = np.repeat(Q[:, None], 1 + ARM.stop, axis=1)
    for joint in range(ARM.stop):
        moved[:, 1 + joint, joint] += STEP
    found = checker.distance(moved, exact=True).distance
    slopes = np.zeros_like(Q)
    slopes[:, ARM] = (found[:, 1:] - found[:, :1]) / STEP
    return found[:, 0], slopes


DISTANCES: dict[str, Distances] = dict(zip(AIMS, (exact, smooth, by_differences), strict=True))


def raced(name: str, tasks: Sequence[Task], points: int) -> dict[str, Any]:
    """Bend all lines with one kind of distance."""
    free, evaluations, seconds, longer = [], [], [], []
    for task in tasks:
        goal = task.usable_goals[0]
        line = task.start + np.linspace(0, 1, points)[:, None] * (goal - task.start)
        bending = Bending(task.checker, line, DISTANCES[name], AIMS[name])
        start = time.perf_counter()
        found = minimize(
            bending.cost, line[1:-1, ARM].ravel(), jac=True, method="L-BFGS-B",
            bounds=list(zip(np.tile(task.checker.robot.lower[ARM], points - 2),
                            np.tile(task.checker.robot.upper[ARM], points - 2), strict=True)),
            callback=bending.stop_if_free, options={"maxiter": MOST},
        )  # fmt: skip
        seconds.append(time.perf_counter() - start)
        free.append(bending.is_free(found.x))
        evaluations.append(bending.evaluations)
        bent = bending.with_inner(found.x)
        longer.append(length(bent) / length(line))
    solved = np.array(free)
    return {
        "distance": name,
        "solved": int(solved.sum()),
        "evaluations, median": float(np.median(evaluations)),
        "milliseconds, median": 1e3 * float(np.median(seconds)),
        "milliseconds, median of solved": 1e3 * float(np.median(np.array(seconds)[solved])) if solved.any() else None,
        "seconds, all": float(np.sum(seconds)),
        "longer than the line, median": float(np.median(np.array(longer)[solved])) if solved.any() else None,
    }


def length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def show(rows: Sequence[dict[str, Any]], problems: int) -> None:
    table = Table(box=SIMPLE_HEAD, title=f"straight lines of {problems} problems, bent")
    for heading in rows[0]:
        table.add_column(heading)
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(width=140).print(table)


if __name__ == "__main__":
    sys.exit(main())
