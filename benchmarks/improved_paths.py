"""Paths improved for a time, beside the best of many seeds in the same time, of a thousand seeds, and OMPL's best.

    python benchmarks/improved_paths.py --data FILE [--every N] [--seeds N] [--ompl-every N] [--ompl-seconds S]

FILE is the set of 700 problems of MotionBenchMaker in JSON that docs/scenes.md describes. Every Nth problem of a group
is planned. Times are processor time of this process and count from the beginning of a call, including the first path.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from clock import threads_set_to
from loewner import PlanningError, planners, read_motion_bench_maker
from loewner.planners import improving
from motion_bench_maker import Task
from plans import way
from robot_samples import panda_for
from samples import Array

BUDGETS = (0.005, 0.01, 0.02, 0.05)  # s
SEEDS = 1000
TWENTY = 20
# Planners of OMPL that shorten their paths until the time is over.
OPTIMAL = ("BITstar", "RRTstar")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=1, help="every Nth problem of a group")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="seeds of the best known path")
    parser.add_argument(
        "--ompl-every", type=int, default=20, help="OMPL plans every Nth problem of a group; 0 for none"
    )
    parser.add_argument("--ompl-seconds", type=float, default=10.0, help="wall time of each of OMPL's planners")
    options = parser.parse_args(arguments)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    problems = [p for p in read_motion_bench_maker(options.data) if p.index % options.every == 0]
    improving.time = SimpleNamespace(monotonic=time.process_time)  # type: ignore[attr-defined]
    with threads_set_to(1):
        tasks = [task for problem in problems if (task := Task.of(problem, arm.robot)).solvable]
        found = [
            measured
            for task in tasks
            if (measured := Measured.of(task, options.seeds, options.ompl_every, options.ompl_seconds)) is not None
        ]
    print(f"{len(found)} of {len(tasks)} problems solved by the first seed")
    if found:
        print(*table(found), sep="\n")
    return 0


class Measured:
    """Costs of one problem.

    Attributes
    ----------
    improved, seeded : dict of float
        Cost after each time, improved and of the best seed.
    default : float
        Cost of the path that `plan` returns without options.
    bound, known, twenty : float
        Proven lower bound; the least cost of all seeds and of OMPL; of twenty seeds.
    ompl : float
        The least cost of OMPL's planners; NaN if they were not run.
    seconds : dict of float
        Processor time of the call for each time to improve; "plan" and "twenty" for the others.
    """

    def __init__(self) -> None:
        self.improved: dict[float, float] = {}
        self.seeded: dict[float, float] = {}
        self.seconds: dict[float | str, float] = {}
        self.default = self.bound = self.known = self.twenty = self.ompl = np.nan

    @classmethod
    def of(cls, task: Task, seeds: int, ompl_every: int, ompl_seconds: float) -> Measured | None:
        made, joints = cls(), list(task.problem.joint_names)

        def plan(**given: object) -> Array:
            return planners.plan(task.checker, task.start, task.goals, joints=joints, **given)  # type: ignore[call-overload]

        costs, seconds = [], []
        for seed in range(seeds):
            cost, spent = timed(lambda seed=seed: way(task, plan(seed=seed)))  # type: ignore[misc]
            if seed == 0 and not np.isfinite(cost):
                return None
            if seed == 0:  # it prepared the scene, which all of them share
                cost, spent = timed(lambda: way(task, plan()))
            costs.append(cost)
            seconds.append(spent)
        made.default, made.seconds["plan"] = costs[0], seconds[0]
        made.twenty, made.seconds["twenty"] = min(costs[:TWENTY]), sum(seconds[:TWENTY])
        made.known = min(costs)
        ended = np.cumsum(seconds)
        for budget in BUDGETS:
            made.seeded[budget] = min(costs[: max(int((ended <= budget).sum()), 1)])
            began = time.process_time()
            found = plan(improve_for=budget, full=True)
            made.seconds[budget] = time.process_time() - began
            made.improved[budget], made.bound = found.cost, found.bound  # type: ignore[attr-defined]
        if ompl_every and task.problem.index % ompl_every == 0:
            made.ompl = min(
                timed(lambda name=name: way(task, plan(planner=name, timeout=ompl_seconds)))[0]  # type: ignore[misc]
                for name in OPTIMAL
            )
            made.known = min(made.known, made.ompl)
        return made


def timed(run: Callable[[], float]) -> tuple[float, float]:
    """Cost of a path and processor time; an infinite cost if there is none."""
    began = time.process_time()
    try:
        cost = run()
    except PlanningError:
        cost = np.inf
    return cost, time.process_time() - began


def table(found: list[Measured]) -> list[str]:
    """Lines of a table: mean costs, as shares above the best known cost."""

    def line(name: str, costs: list[float], key: float | str) -> str:
        above = 100 * (np.array(costs) / [m.known for m in found] - 1)
        seconds = 1e3 * np.array([m.seconds[key] for m in found])
        over_bound = 100 * (np.array(costs) / [m.bound for m in found] - 1)
        return (
            f"{name:34}{above.mean():9.2f} %{np.percentile(above, 90):9.2f} %{above.max():9.2f} %"
            f"{over_bound.mean():10.2f} %{np.median(seconds):9.2f}{seconds.mean():9.2f}"
        )

    lines = [
        f"{'above the best known cost':34}{'mean':>11}{'90 %':>11}{'largest':>11}{'over bound':>12}"
        f"{'ms, med':>9}{'mean':>9}",
        line("plan", [m.default for m in found], "plan"),
        line("best of twenty seeds", [m.twenty for m in found], "twenty"),
    ]
    for budget in BUDGETS:
        lines.append(line(f"improve_for={budget:g}", [m.improved[budget] for m in found], budget))
        lines.append(line(f"best of the seeds in {budget:g} s", [m.seeded[budget] for m in found], budget))
    beside = [m for m in found if np.isfinite(m.ompl)]
    tried = [m for m in found if not np.isnan(m.ompl)]
    if tried:
        shares = [m.ompl / m.improved[BUDGETS[-1]] for m in beside]
        lines.append(
            f"OMPL's best of {' and '.join(OPTIMAL)}: {len(beside)} of {len(tried)} problems solved"
            + (f", {np.mean(shares):.3f} times the cost of improve_for={BUDGETS[-1]:g}" if beside else "")
        )
    return lines


if __name__ == "__main__":
    sys.exit(main())
