"""MotionBenchMaker's problems for Panda: validity, planning beside pinocchio with Coal, and what settles the states.

    python benchmarks/motion_bench_maker.py --data FILE [--every N] [--out FOLDER]

FILE is the set of 700 problems in JSON that docs/scenes.md describes; nothing else needs it. Results go to
benchmarks/results/<machine>/, or to FOLDER.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import figures
import report
from clock import Cost, threads_set_to
from loewner import CollisionChecker, Problem, Robot, read_motion_bench_maker
from loewner.robots.checking.edges import coarse_first
from report import REQUIRED, Row
from rivals import Missing
from robot_rivals import MANAGERS, Pinocchio
from robot_samples import Sample, panda_for
from samples import Array

HERE = Path(__file__).parent
# Fingers, m: open, since hulls of closed ones would hold what the goals are about to grasp. The file does not say.
FINGER = 0.04
# Distance of two configurations checked along a motion; rad over all joints.
RESOLUTION = 0.05
# A problem is given up after so many motions. A limit of time would stop contestants at different places.
MOST_MOTIONS = 5_000
RIVALS = tuple(MANAGERS)
# Both plan each problem so often, in turn; the best counts.
ROUNDS = 2
UNIFORM, LINE = 200, 100
ALL = "all groups"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="the problems, in JSON")
    parser.add_argument("--every", type=int, default=7, help="plan every Nth problem of a group; 1 for all")
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    facts = report.machine()
    results = options.out or HERE / "results" / report.machine_name(facts)
    arm = panda_for(options.data)
    if arm is None:
        return 0
    problems = read_motion_bench_maker(options.data)
    with threads_set_to(1):
        tasks = [Task.of(problem, arm.robot) for problem in problems]
        write_validity(validity(tasks, arm), results / "mbm-validity.csv")
        chosen = [task for task in tasks if task.solvable and task.problem.index % options.every == 0]
        rows = planning(chosen, arm)
        report.show("planning: RRT-Connect, time spent checking motions, per motion", rows)
        report.write(results / "mbm-planning.csv", rows, facts)
        found = settled(tasks, chosen)
    write_tiers(found, results / "mbm-tiers.csv")
    figures.tiers(found, results / "mbm-tiers.svg")
    return 0


@dataclass
class Task:
    """A problem as this robot sees it.

    Attributes
    ----------
    start_free : bool
    goal_free : ndarray of bool, shape (goals,)
    seen : list of ndarray
        Configurations on all motions that the planner asked about.
    """

    problem: Problem
    checker: CollisionChecker
    start: Array
    goals: Array
    start_free: bool
    goal_free: Array
    seen: list[Array] = field(default_factory=list)

    @classmethod
    def of(cls, problem: Problem, robot: Robot) -> Task:
        columns = [robot.configuration_names.index(name) for name in problem.joint_names]
        Q = np.tile(robot.configuration({"panda_finger_joint1": FINGER}), (1 + len(problem.goals), 1))
        Q[:, columns] = np.vstack([problem.start, problem.goals])
        checker = CollisionChecker(robot, problem.scene)
        free = ~checker.collide(Q)
        return cls(problem, checker, Q[0], Q[1:], bool(free[0]), free[1:])

    @property
    def usable_goals(self) -> Array:
        """Goals that are free and within the limits; OMPL waits for ever for one that is outside."""
        return self.goals[self.goal_free & _within(self.checker.robot, self.goals)]

    @property
    def solvable(self) -> bool:
        """Whether both ends are sound."""
        inside = bool(_within(self.checker.robot, self.start))
        return self.start_free and inside and len(self.usable_goals) > 0


def _within(robot: Robot, Q: Array) -> Array:
    return ((robot.lower <= Q) & (robot.upper >= Q)).all(axis=-1)


def by_group(tasks: Sequence[Task]) -> dict[str, list[Task]]:
    groups: dict[str, list[Task]] = {}
    for task in tasks:
        groups.setdefault(task.problem.group, []).append(task)
    return groups


# -- starts and goals --------------------------------------------------------------------------


@dataclass(frozen=True)
class Validity:
    """How many problems of a group have what it takes.

    Attributes
    ----------
    solvable : int
        Start and a goal are free and within the limits of the joints.
    differing : int or None
        Starts and goals that pinocchio judges otherwise.
    """

    group: str
    problems: int
    free_start: int
    free_goal: int
    solvable: int
    differing: int | None


def validity(tasks: Sequence[Task], arm: Sample) -> list[Validity]:
    rows = []
    for group, mine in by_group(tasks).items():
        rows.append(
            Validity(
                group,
                len(mine),
                sum(t.start_free for t in mine),
                sum(bool(t.goal_free.any()) for t in mine),
                sum(t.solvable for t in mine),
                differing_ends(mine, arm),
            )
        )
    return rows


def differing_ends(tasks: Sequence[Task], arm: Sample) -> int | None:
    count = 0
    try:
        for task in tasks:
            rival = Pinocchio(task.checker, arm.urdf)
            theirs = rival.ways["all pairs"](rival.configurations(np.vstack([task.start, task.goals])))
            count += report.differences(np.array([task.start_free, *task.goal_free]), ~theirs)
    except Missing:
        return None
    return count


def write_validity(rows: Sequence[Validity], path: Path) -> None:
    _write(path, [asdict(row) for row in rows])
    for row in rows:
        judged = "pinocchio not asked" if row.differing is None else f"{row.differing} judged otherwise by pinocchio"
        print(
            f"{row.group:18}{row.problems:4} problems, {row.free_start:4} starts free, {row.free_goal:4} goals free, "
            f"{row.solvable:4} with both and within limits; {judged}"
        )
    print(f"solvable: {sum(row.solvable for row in rows)} of {sum(row.problems for row in rows)}\n", flush=True)


# -- planning ----------------------------------------------------------------------------------


class Judge:
    """Judges motions, and keeps what it said, how long it took and, for our own, what was asked."""

    def __init__(self, task: Task, rival: Pinocchio | None = None, way: str = "") -> None:
        self._task, self._rival, self._way = task, rival, way
        self.wall = self.cpu = 0.0
        self.answers: list[bool] = []
        self.states = 0

    def free(self, a: Array, b: Array) -> bool:
        question = self._ours(a, b) if self._rival is None else self._theirs(a, b)
        wall, cpu = time.perf_counter(), time.process_time()
        answer = question()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        self.cpu, self.wall = self.cpu + cpu, self.wall + wall
        self.answers.append(answer)
        return answer

    def _ours(self, a: Array, b: Array) -> Callable[[], bool]:
        return partial(self._task.checker.valid_edges, a, b, RESOLUTION)

    def _theirs(self, a: Array, b: Array) -> Callable[[], bool]:
        """The same configurations in the same order. Their making is not counted."""
        X = self._rival.configurations(on_the_way(self._task.checker.robot, a, b))
        check = self._rival.single[self._way]

        def question() -> bool:
            for k, x in enumerate(X, 1):
                if check(x, True):
                    self.states += k
                    return False
            self.states += len(X)
            return True

        return question


def on_the_way(robot: Robot, a: Array, b: Array) -> Array:
    """What `valid_edges` checks."""
    parts = max(1, int(np.ceil(robot.distances(a, b) / RESOLUTION)))
    return robot.between(a, b, coarse_first(parts))


@dataclass
class Tally:
    """Sums over the problems of a group."""

    cost: dict[str, Cost] = field(default_factory=dict)
    motions: int = 0
    states: int = 0
    problems: int = 0
    solved: int = 0
    differing: dict[str, int] = field(default_factory=dict)

    def add(self, runs: dict[str, list[tuple[Judge, bool]]]) -> None:
        """The runs of one problem by contestant."""
        ours = runs["us"][0]
        self.problems += 1
        self.solved += ours[1]
        self.motions += len(ours[0].answers)
        self.states += max(judge.states for played in runs.values() for judge, _ in played)
        for name, played in runs.items():
            before = self.cost.get(name, Cost(0.0, 0.0))
            self.cost[name] = Cost(
                before.wall + min(judge.wall for judge, _ in played), before.cpu + min(judge.cpu for judge, _ in played)
            )
            differs = any((judge.answers, solved) != (ours[0].answers, ours[1]) for judge, solved in played)
            self.differing[name] = self.differing.get(name, 0) + differs


def planning(tasks: Sequence[Task], arm: Sample) -> list[Row]:
    """Every problem planned with us and with each rival, in turn."""
    if find_spec("ompl") is None:
        return [Row(ALL, "valid_edges", None, "pinocchio", None, 0, note="not run: package ompl is not installed")]
    tallies: dict[str, Tally] = {}
    for seed, task in enumerate(tasks, 1):
        try:
            rival = Pinocchio(task.checker, arm.urdf)
        except Missing as missing:
            return [Row(ALL, "valid_edges", None, "pinocchio", None, 0, note=f"not run: {missing}")]
        makers = {"us": partial(Judge, task)} | {way: partial(Judge, task, rival, way) for way in RIVALS}
        runs: dict[str, list[tuple[Judge, bool]]] = {name: [] for name in makers}
        for _ in range(ROUNDS):
            for name, make in makers.items():
                judge = make()
                asked: list[Array] = []
                runs[name].append((judge, plan(task, judge, seed, asked)))
                task.seen = asked
        for group in (task.problem.group, ALL):
            tallies.setdefault(group, Tally()).add(runs)
    return [row for group in sorted(tallies, key=lambda g: g == ALL) for row in _rows(group, tallies[group])]


def _rows(group: str, tally: Tally) -> list[Row]:
    def each(cost: Cost) -> Cost:
        return Cost(cost.wall / tally.motions, cost.cpu / tally.motions)

    looked = tally.states / tally.motions
    fastest = min(RIVALS, key=lambda way: tally.cost[way].cpu)
    note = (
        f"{tally.solved} of {tally.problems} problems solved; pinocchio looked at {looked:.1f} configurations a "
        f"motion, with {fastest} the fastest of its managers; items are motions; differing: problems whose search went "
        "another way"
    )
    return [
        Row(
            group, "valid_edges", each(tally.cost["us"]), f"pinocchio, {way}", each(tally.cost[way]), tally.motions,
            REQUIRED["planner"] if group == ALL else None, tally.differing[way], note,
        )
        for way in sorted(RIVALS, key=lambda way: tally.cost[way].cpu)
    ]  # fmt: skip


def plan(task: Task, judge: Judge, seed: int, asked: list[Array]) -> bool:
    """RRT-Connect of OMPL as it comes, over the joints of the problem; whether it found a way."""
    from ompl import base, geometric, util

    robot = task.checker.robot
    columns = [robot.configuration_names.index(name) for name in task.problem.joint_names]
    width = len(columns)
    space, bounds = base.RealVectorStateSpace(width), base.RealVectorBounds(width)
    for k, column in enumerate(columns):
        bounds.setLow(k, float(robot.lower[column]))
        bounds.setHigh(k, float(robot.upper[column]))
    space.setBounds(bounds)

    def configuration(state: Any) -> Array:
        q = task.start.copy()
        q[columns] = state[0:width]
        return q

    class Motions(base.MotionValidator):
        def checkMotion(self, one: Any, other: Any) -> bool:
            a, b = configuration(one), configuration(other)
            asked.append(np.array([a, b]))
            return judge.free(a, b)

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed)
    information = base.SpaceInformation(space)
    # Start and goals are known to be free, and other states are asked about as ends of motions.
    information.setStateValidityChecker(lambda state: True)
    information.setMotionValidator(Motions(information))
    information.setup()
    definition, goals = base.ProblemDefinition(information), base.GoalStates(information)
    state = information.allocState()
    for q, add in [(task.start, definition.addStartState), *((q, goals.addState) for q in task.usable_goals)]:
        state[0:width] = q[columns].tolist()
        add(state)
    definition.setGoal(goals)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(definition)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: len(judge.answers) >= MOST_MOTIONS))
    return bool(definition.hasExactSolution())


# -- what settles the states -------------------------------------------------------------------


def settled(tasks: Sequence[Task], planned: Sequence[Task]) -> list[dict[str, Any]]:
    """How many configurations each tier settled, by group and by where the configurations come from."""

    def uniform(task: Task) -> Array:
        Q = task.checker.robot.random_configurations(UNIFORM, task.problem.index)
        Q[:, task.checker.robot.configuration_names.index("panda_finger_joint1")] = FINGER
        return Q

    def line(task: Task) -> Array:
        return task.checker.robot.between(task.start, task.usable_goals[0], np.linspace(0, 1, LINE))

    def motions(task: Task) -> Array:
        return np.concatenate([on_the_way(task.checker.robot, a, b) for a, b in task.seen])

    sources: dict[str, tuple[Callable[[Task], Array], Iterable[Task]]] = {
        "uniform": (uniform, tasks),
        "straight line": (line, [task for task in tasks if task.solvable]),
        "planner": (motions, [task for task in planned if task.seen]),
    }
    rows = []
    for source, (configurations, chosen) in sources.items():
        for group, mine in by_group(list(chosen)).items():
            counts: dict[str, int] = {}
            for task in mine:
                for name, count in asdict(task.checker.tiers(configurations(task))).items():
                    counts[name] = counts.get(name, 0) + count
            rows.append({"states": source, "group": group, "configurations": sum(counts.values()), **counts})
    return rows


def write_tiers(rows: Sequence[dict[str, Any]], path: Path) -> None:
    _write(path, rows)
    for row in rows:
        counts = {name: count for name, count in row.items() if name.startswith(("free", "colliding"))}
        shares = ", ".join(
            f"{name.replace('_', ' ')} {count / row['configurations']:.1%}" for name, count in counts.items()
        )
        print(f"{row['states']:14}{row['group']:18}{row['configurations']:8}: {shares}")


def _write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    sys.exit(main())
