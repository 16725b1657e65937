"""Proofs of MotionBenchMaker's plans: bytes, time to make and to verify them.

    python benchmarks/proofs.py --data FILE [--every N]

FILE is the set of 700 problems in JSON that docs/scenes.md describes.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from clock import threads_set_to
from loewner import CollisionChecker, PlanningError, planners, read_motion_bench_maker
from loewner.verify import verify
from motion_bench_maker import Task
from robot_samples import panda_for

# The best of so many counts.
ROUNDS = 3


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=7, help="every Nth problem of a group; 1 for all")
    options = parser.parse_args(arguments)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    rows = []
    with threads_set_to(1):
        for problem in read_motion_bench_maker(options.data):
            task = Task.of(problem, arm.robot)
            if not task.solvable or problem.index % options.every:
                continue
            try:
                plan, planned = planned_in(task, list(problem.joint_names))
            except PlanningError:
                continue
            rows.append((planned, *measured(task.checker, plan.path)))
    print(f"{len(rows)} plans, all verified")
    table = np.array(rows)
    ratios = table[:, 1:3] / table[:, :1]
    names = ["plan, ms", "first proof, ms", "next proof, ms", "verify, ms", "bytes", "bytes of the model", "planes"]
    names += ["first proof / plan", "next proof / plan"]
    for name, column in zip(names, np.column_stack([table, ratios]).T, strict=True):
        factor = 1e3 if name.endswith("ms") else 1
        median, most = factor * np.median(column), factor * column.max()
        print(f"{name:20} median {median:10.4g}   95 % {factor * np.percentile(column, 95):10.4g}   most {most:10.4g}")
    return 0


def planned_in(task: Task, joints: list[str]) -> tuple[planners.Plan, float]:
    """A plan, and the best of its times in seconds."""
    best = np.inf
    for _ in range(ROUNDS):
        began = time.process_time()
        plan = planners.plan(task.checker, task.start, task.goals, joints=joints, full=True)
        best = min(best, time.process_time() - began)
    return plan, best


def measured(checker: CollisionChecker, path: np.ndarray) -> tuple[float, ...]:
    """Seconds to make the first proof and the next ones of a path, with the model made once, and to verify one.

    Then its bytes and those of its model, and its planes.
    """
    made, first = np.inf, 0.0
    for _ in range(ROUNDS):
        began = time.process_time()
        checker.certify_edges(path[:-1], path[1:])
        alone = time.process_time() - began
        began = time.process_time()
        proof = checker.certify_edges(path[:-1], path[1:], proof=True).proof
        made = min(made, time.process_time() - began - alone)
        first = first or made
    began = time.process_time()
    report = verify(proof.data)  # an error if it is refused
    verified = time.process_time() - began
    return first, made, verified, proof.size, len(proof.model), report.sizes["planes"]


if __name__ == "__main__":
    raise SystemExit(main())
