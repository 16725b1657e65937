"""Paths on MotionBenchMaker's problems, proven and sampled, beside OMPL with our checker and with pinocchio."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

import motion_bench_maker
from clock import Cost
from loewner import PlanningError, Verdict, planners
from motion_bench_maker import RIVALS, Task
from report import REQUIRED, Row
from rivals import Missing
from robot_rivals import Pinocchio
from robot_samples import Sample
from samples import Array

# Steps that finished paths are looked at in, rad; and those that what is proven is looked at in.
STEPS = (0.05, 0.02, 0.01)
FINE = 1e-3
# OMPL gives up after so many seconds; such a plan counts as having taken them.
LIMIT = 5.0
ROUNDS = 3  # the best of so many counts
# Motions of one problem that are asked about again, at most.
MOST_MOTIONS = 400
DEPTHS = 20  # configurations of a motion that collides whose depth is measured


@dataclass
class Times:
    """Seconds of processor time of one contestant, a problem each."""

    seconds: list[float] = field(default_factory=list)
    solved: int = 0

    def cost(self, share: float) -> Cost:
        """Time that this share of the problems took at most."""
        seconds = float(np.percentile(self.seconds, 100 * share))
        return Cost(seconds, seconds)

    @property
    def mean(self) -> Cost:
        seconds = float(np.mean(self.seconds))
        return Cost(seconds, seconds)

    def __str__(self) -> str:
        shares = (f"{name} {1e3 * self.cost(s).cpu:.3g}" for name, s in (("median", 0.5), ("95 %", 0.95), ("max", 1.0)))
        return f"{self.solved} of {len(self.seconds)} solved; ms: {', '.join(shares)}, mean {1e3 * self.mean.cpu:.3g}"


def ours(tasks: Sequence[Task]) -> tuple[list[Row], dict[str, list[Array]]]:
    """Our planner on all problems, proven and sampled, then shortening; and the finished paths."""
    ways: dict[str, dict[str, Any]] = {"proven": {}}
    ways |= {f"{s:g} rad": {"certified": False, "resolution": s} for s in STEPS}
    times = {name: Times() for name in ways}
    shortening, before, after = Times(), 0.0, 0.0
    finished: dict[str, list[Array]] = {name: [] for name in ways}
    for task in tasks:
        joints = list(task.problem.joint_names)
        for name, options in ways.items():
            ask = partial(planners.plan, task.checker, task.start, task.goals, joints=joints, simplify=False, **options)
            seconds, path = best(ask)
            times[name].seconds.append(seconds)
            finished[name].append(None if path is None else path)
            times[name].solved += path is not None
            if path is None:
                continue
            seconds, short = best(partial(planners.shorten, task.checker, path, **options))
            # What was judged in steps may not pass in the other order; then it stays as it is.
            finished[name][-1] = path if short is None else short
            if name == "proven":
                shortening.seconds.append(seconds)
                shortening.solved += 1
                before, after = before + way(task, path), after + way(task, short)
    rows = [
        *rows_of("plan, proven", times["proven"], "plan at 0.05 rad", times["0.05 rad"]),
        *rows_of(
            "shorten, proven", shortening, "", None,
            f"mean length {before / len(shortening.seconds):.3g} rad before, {after / len(shortening.seconds):.3g} after",
        ),
    ]  # fmt: skip
    return rows, finished


def rows_of(
    us: str, mine: Times, rival: str, theirs: Times | None, note: str = "", goal: float | None = None
) -> list[Row]:
    """Median, mean and the 95th percentile."""
    said = f"ours: {mine}" + ("" if theirs is None else f". {rival}: {theirs}") + (f". {note}" if note else "")
    kinds: dict[str, Callable[[Times], Cost]] = {
        "median": lambda t: t.cost(0.5), "mean": lambda t: t.mean, "95 %": lambda t: t.cost(0.95)
    }  # fmt: skip
    return [
        Row(
            f"a plan, {kind}", us, of(mine), rival, None if theirs is None else of(theirs), len(mine.seconds),
            goal if kind == "median" else None, None, said,
        )
        for kind, of in kinds.items()
    ]  # fmt: skip


def best(ask: Callable[[], Array]) -> tuple[float, Array | None]:
    """Processor time of a call, the best of some; and what it found."""
    least, found = np.inf, None
    for _ in range(ROUNDS):
        began = time.process_time()
        try:
            found = ask()
        except PlanningError:
            found = None
        least = min(least, time.process_time() - began)
    return least, found


def way(task: Task, path: Array) -> float:
    """Length of a path."""
    return float(np.sum(task.checker.robot.distances(path[:-1], path[1:])))


# -- rivals ------------------------------------------------------------------------------------


def beside_ompl(tasks: Sequence[Task], arm: Sample) -> list[Row]:
    """Our planner, OMPL's with our checker, OMPL's with pinocchio, on each problem in turn."""
    mine, sampled, theirs = Times(), Times(), {name: Times() for name in RIVALS}
    try:
        for seed, task in enumerate(tasks, 1):
            joints = list(task.problem.joint_names)
            ask = partial(planners.plan, task.checker, task.start, task.goals, joints=joints, simplify=False)
            seconds, path = best(ask)
            mine.seconds.append(seconds)
            mine.solved += path is not None
            began = time.process_time()
            try:
                ask(planner="RRTConnect", certified=False, timeout=LIMIT, seed=seed)
                sampled.solved += 1
            except PlanningError:
                pass
            sampled.seconds.append(time.process_time() - began)
            rival = Pinocchio(task.checker, arm.urdf)
            for name in RIVALS:
                seconds, solved = with_pinocchio(task, rival, name, seed)
                theirs[name].seconds.append(seconds)
                theirs[name].solved += solved
    except Missing as missing:
        return [Row("a plan", "plan", None, "OMPL", None, 0, note=f"not run: {missing}")]
    fastest = min(RIVALS, key=lambda name: np.median(theirs[name].seconds))
    return [
        *rows_of("plan, proven", mine, "OMPL, our checker", sampled, goal=REQUIRED["plan vs OMPL"]),
        *rows_of(
            "plan, proven", mine, f"OMPL, pinocchio, {fastest}", theirs[fastest],
            f"given up after {motion_bench_maker.MOST_MOTIONS} motions; the other manager: {theirs[_other(fastest)]}",
            REQUIRED["plan vs pinocchio"],
        ),
    ]  # fmt: skip


def _other(name: str) -> str:
    return next(other for other in RIVALS if other != name)


def with_pinocchio(task: Task, rival: Pinocchio, name: str, seed: int) -> tuple[float, bool]:
    """OMPL's RRT-Connect with pinocchio's verdicts; making pinocchio's configurations is not counted."""
    judge = motion_bench_maker.Judge(task, rival, name)
    making, make = 0.0, rival.configurations

    def counted(Q: Array) -> Array:
        nonlocal making
        began = time.process_time()
        found = make(Q)
        making += time.process_time() - began
        return found

    rival.configurations = counted  # type: ignore[method-assign]
    try:
        began = time.process_time()
        solved = motion_bench_maker.plan(task, judge, seed, [])
        return time.process_time() - began - making, solved
    finally:
        rival.configurations = make  # type: ignore[method-assign]


# -- motions a planner asks about --------------------------------------------------------------


def asked(tasks: Sequence[Task]) -> list[Row]:
    """What OMPL's RRT-Connect asked, in batches of a problem: proven, and looked at in steps of two lengths."""
    steps = STEPS[:2]
    spent = dict.fromkeys(("proven", *steps), 0.0)
    verdicts, refuted, confirmed, wrong, total = np.zeros(3, dtype=int), 0, 0, dict.fromkeys(steps, 0), 0
    poses, searches = 0, 0
    for seed, task in enumerate(tasks, 1):
        seen: list[Array] = []
        motion_bench_maker.plan(task, motion_bench_maker.Judge(task), seed, seen)
        if not seen:
            continue
        start, end = np.stack(seen[:MOST_MOTIONS], axis=1)
        seconds, found = best(partial(task.checker.certify_edges, start, end))
        spent["proven"] += seconds
        free = found.verdict == Verdict.FREE
        for step in steps:
            seconds, valid = best(partial(task.checker.valid_edges, start, end, step))
            spent[step] += seconds
            wrong[step] += int((valid & (found.verdict == Verdict.COLLIDING)).sum())
        verdicts += np.bincount(found.verdict, minlength=3)
        total, poses, searches = total + len(start), max(poses, found.poses.max()), max(searches, found.searches.max())
        refuted += int((~task.checker.valid_edges(start[free], end[free], STEPS[-1])).sum())
        hit = found.verdict == Verdict.COLLIDING
        at = task.checker.robot.between(start[hit], end[hit], found.fraction[hit])
        confirmed += int(task.checker.collide(at).sum())
    note = (
        f"free {verdicts[0]}, colliding {verdicts[1]} ({confirmed} confirmed by collide), ambiguous {verdicts[2]}; "
        f"{refuted} free ones refuted in steps of {STEPS[-1]:g}; at most {poses} poses and {searches} searches a motion"
    )
    return [
        Row(
            "RRT-Connect's motions", "certify_edges", _each(spent["proven"], total), f"valid_edges at {step:g}",
            _each(spent[step], total), total, None, wrong[step], note + "; differing: sampled as free, and colliding",
        )
        for step in steps
    ]  # fmt: skip


def _each(seconds: float, items: int) -> Cost:
    return Cost(seconds / max(items, 1), seconds / max(items, 1))


# -- what samples do not see -------------------------------------------------------------------


@dataclass
class Hidden:
    """Finished paths that collide between the configurations they were looked at."""

    way: str
    paths: int
    colliding: int
    undecided: int
    median_mm: float
    deepest_mm: float


def hidden(tasks: Sequence[Task], finished: dict[str, list[Array]]) -> list[Hidden]:
    """How many finished paths collide somewhere: those made in steps by proof, those proven in fine steps."""
    found = []
    for name, paths in finished.items():
        pairs = [(task, path) for task, path in zip(tasks, paths, strict=True) if path is not None]
        hits = undecided = 0
        depths: list[float] = []
        for task, path in pairs:
            if name == "proven":
                hits += not task.checker.valid_edges(path[:-1], path[1:], FINE).all()
                continue
            verdict = task.checker.certify_edges(path[:-1], path[1:]).verdict
            hits += bool((verdict == Verdict.COLLIDING).any())
            undecided += bool((verdict == Verdict.AMBIGUOUS).any() and not (verdict == Verdict.COLLIDING).any())
            deepest = [depth(task, path[k], path[k + 1]) for k in np.flatnonzero(verdict == Verdict.COLLIDING)]
            depths += [max(deepest)] if deepest else []
        median, most = (float(np.median(depths)), max(depths)) if depths else (0.0, 0.0)
        found.append(Hidden(name, len(pairs), hits, undecided, 1e3 * median, 1e3 * most))
    return found


def depth(task: Task, a: Array, b: Array) -> float:
    """How deep a motion goes, in metres, at the configurations that are looked at; 0 if they miss it."""
    steps = max(2, int(np.ceil(task.checker.robot.distances(a, b) / FINE)))
    Q = task.checker.robot.between(a, b, np.linspace(0, 1, steps))
    Q = Q[task.checker.collide(Q)]
    if len(Q) == 0:
        return 0.0
    return max(0.0, -float(task.checker.distance(Q[:: max(1, len(Q) // DEPTHS)], exact=True).distance.min()))


def table(found: Iterable[Hidden]) -> Iterator[str]:
    """Lines of a table of these."""
    yield f"{'motions':12}{'paths':>7}{'hidden collision':>18}{'share':>8}{'median':>11}{'deepest':>11}"
    for h in found:
        yield (
            f"{h.way:12}{h.paths:7}{h.colliding:18}{h.colliding / max(h.paths, 1):8.1%}"
            f"{h.median_mm:8.2f} mm{h.deepest_mm:8.2f} mm"
        )
