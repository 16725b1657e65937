"""Whole robots in a scene, beside pinocchio with Coal on the same convex shapes and pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clock import ALL_THREADS, Cost, race, threads_set_to, timed
from loewner import CollisionChecker
from report import REQUIRED, Row
from rivals import Missing
from robot_rivals import TREE, Pinocchio
from robot_samples import Sample, around, obstacles, panda, talos
from samples import Array
from threads import QUICK_STEPS, STEPS, machine_allows

COUNT, QUICK = 10_000, 200
# Configurations that are asked about one by one.
SINGLES = 2_000
SIZES, QUICK_SIZES = (1, 3, 10, 30, 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000), (1, 10, 100)
# A batch is repeated until so many configurations are through, so that short ones can be timed.
LEAST_STATES = 2_000
# Answers may differ for configurations that are so near to touching, in metres.
TOUCHING = 1e-7


@dataclass(frozen=True)
class Course:
    """A checker and the configurations it is asked about."""

    name: str
    checker: CollisionChecker
    urdf: Path
    Q: Array


def run(quick: bool, folder: Path) -> list[Row]:
    count = QUICK if quick else COUNT
    rounds = 2 if quick else 5
    try:
        arm, humanoid = panda(), talos()
    except Missing as missing:
        return [Row("panda, 10 obstacles", "collide", None, "pinocchio", None, count, note=f"not run: {missing}")]
    course = cluttered(arm, count)
    body, alone = humanoid.robot, CollisionChecker(humanoid.robot)
    few = count // 4
    return [
        *beside_pinocchio(course, rounds, REQUIRED["robot vs AABB tree"]),
        *one_by_one(course, rounds),
        two_threads(course, quick),
        *beside_pinocchio(Course("talos alone", alone, humanoid.urdf, body.random_configurations(few, 1)), rounds),
        *beside_pinocchio(
            Course("talos alone, near half_sitting", alone, humanoid.urdf, around(body, "half_sitting", few, 1)), rounds
        ),
    ]


def cluttered(arm: Sample, count: int) -> Course:
    """Panda among boxes and hulls, at random configurations."""
    checker = CollisionChecker(arm.robot, obstacles(0))
    return Course("panda, 10 obstacles", checker, arm.urdf, arm.robot.random_configurations(count, 1))


def beside_pinocchio(course: Course, rounds: int, required: float | None = None) -> list[Row]:
    """One batch of ours beside every way to ask pinocchio."""
    checker, Q, n = course.checker, course.Q, len(course.Q)
    ours = checker.collide(Q)
    case = f"{course.name}: batch"
    us = timed(partial(checker.collide, Q), n)
    try:
        rival = Pinocchio(checker, course.urdf)
    except Missing as missing:
        cost = race({"us": us}, rounds)["us"]
        return [Row(case, "collide", cost, "pinocchio", None, n, required, note=f"not run: {missing}")]
    X = rival.configurations(Q)
    cost = race({"us": us} | {name: timed(partial(way, X), n) for name, way in rival.ways.items()}, rounds)
    about = f"{len(checker.checked_pairs)} pairs, {ours.mean():.0%} colliding; {shares(checker, Q)}"
    return [
        Row(
            case, "collide", cost["us"], f"pinocchio, {name}", cost[name], n, required if name == TREE else None,
            *differing(rival, X, ours, way(X), about),
        )
        for name, way in rival.ways.items()
    ]  # fmt: skip


def one_by_one(course: Course, rounds: int) -> list[Row]:
    """One configuration per call from Python."""
    Q = course.Q[:SINGLES]
    ours = course.checker.collide(Q)
    case = f"{course.name}: one per call"

    def each() -> list[bool]:
        return [course.checker.collide(q) for q in Q]

    try:
        rival = Pinocchio(course.checker, course.urdf)
    except Missing as missing:
        cost = race({"us": timed(each, len(Q))}, rounds)["us"]
        return [Row(case, "collide", cost, "pinocchio", None, len(Q), note=f"not run: {missing}")]
    X = rival.configurations(Q)
    ways = {name: rival.ways[name] for name in rival.single}
    cost = race({"us": timed(each, len(Q))} | {k: timed(partial(way, X), len(Q)) for k, way in ways.items()}, rounds)
    return [
        Row(case, "collide", cost["us"], f"pinocchio, {name}", cost[name], len(Q), None,
            *differing(rival, X, ours, way(X), ""))
        for name, way in ways.items()
    ]  # fmt: skip


def two_threads(course: Course, quick: bool) -> Row:
    """The same batch on one thread and on two, by wall time."""
    case = f"{course.name}: two threads"
    if ALL_THREADS < 2:
        return Row(case, "two threads", None, "one thread", None, len(course.Q), note="not run: one thread allowed")

    def on(threads: int) -> Array:
        with threads_set_to(threads):
            return course.checker.collide(course.Q)

    rounds = 2 if quick else 7
    cost = race({str(t): timed(partial(on, t), len(course.Q)) for t in (1, 2)}, rounds)
    allowed = machine_allows(QUICK_STEPS if quick else STEPS, rounds)
    note = f"plain arithmetic gains {allowed:.2f} times by two threads"
    return Row(
        case, "two threads", cost["2"], "one thread", cost["1"], len(course.Q), None, int((on(1) != on(2)).sum()), note,
        True,
    )  # fmt: skip


def batches(quick: bool, folder: Path) -> list[Row]:
    """Cost of a configuration against the size of the batch."""
    sizes, rounds = (QUICK_SIZES, 2) if quick else (SIZES, 5)
    try:
        course = cluttered(panda(), max(sizes))
    except Missing as missing:
        return [Row("batch of 1", "collide", None, "pinocchio", None, 1, note=f"not run: {missing}")]
    checker, Q = course.checker, course.Q
    theirs, name, note = None, "pinocchio", "pinocchio: its fastest way, whose cost no batch changes"
    try:
        rival = Pinocchio(checker, course.urdf)
        X = rival.configurations(Q[:LEAST_STATES])
        cost = race({k: timed(partial(way, X), len(X)) for k, way in rival.ways.items()}, rounds)
        fastest = min(cost, key=lambda k: cost[k].cpu)
        theirs, name = cost[fastest], f"pinocchio, {fastest}"
    except Missing as missing:
        note = f"not run: {missing}"
    rows = []
    for size in sizes:
        again = max(1, LEAST_STATES // size) if not quick else 2
        calls: dict[str, Callable[[Array], Any]] = {"classify": checker.classify, "collide": checker.collide}
        parts = [Q[k * size : (k + 1) * size] for k in range(min(again, len(Q) // size))]
        ours: dict[str, Cost] = race(
            {us: timed(partial(_through, call, parts), size * len(parts)) for us, call in calls.items()}, rounds
        )
        rows += [Row(f"batch of {size}", us, cost, name, theirs, size, note=note) for us, cost in ours.items()]
    return rows


def _through(call: Callable[[Array], Any], parts: list[Array]) -> None:
    for Q in parts:
        call(Q)


def shares(checker: CollisionChecker, Q: Array) -> str:
    """What settled the configurations."""
    settled = checker.tiers(Q)
    counts = asdict(settled).items()
    return ", ".join(f"{name.replace('_', ' ')} {count / settled.total:.1%}" for name, count in counts)


def differing(rival: Pinocchio, X: Array, ours: Array, theirs: Array, about: str) -> tuple[int, str]:
    """How many answers differ, those of touching configurations apart, and a note."""
    gaps = np.array([rival.distance(X[k]) for k in np.flatnonzero(ours != theirs)])
    touching = int((np.abs(gaps) <= TOUCHING).sum())
    apart = [f"{touching} more differ within {TOUCHING:g} m of touching"] if touching else []
    return len(gaps) - touching, "; ".join([about] * bool(about) + apart)
