"""One question per call from Python: what a call costs beside Coal's and pinocchio's, in the same loops."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from clock import race, timed
from loewner.robots.checking.edges import coarse_first, steps
from report import Row
from rivals import CoalPython, Missing
from robot_rivals import Pinocchio
from robot_samples import panda
from robots import Course, cluttered, differing
from samples import Array, Pairs, repeated_pairs

CALLS, QUICK = 5_000, 500
MOTIONS, QUICK_MOTIONS = 300, 20

# Largest distance of two configurations of a motion that are checked.
RESOLUTION = 0.05


def run(quick: bool, folder: Path) -> list[Row]:
    count, rounds = (QUICK, 2) if quick else (CALLS, 7)
    p = repeated_pairs(count)
    verdicts = loewner.classify(*p.arguments())
    # Pairs that the ellipsoids part, and those that only the exact search settles.
    far, unsettled = (p.part(verdicts == v) for v in (loewner.Verdict.FREE, loewner.Verdict.AMBIGUOUS))
    rows = [
        of_pairs("collide, far apart", far, loewner.collide, "collide", rounds),
        of_pairs("collide, exact search", unsettled, loewner.collide, "collide", rounds),
        of_pairs("classify, any", p, loewner.classify, "collide", rounds),
        of_pairs("exact distance, any", p, partial(loewner.distance, exact=True), "distance", rounds),
    ]
    try:
        course = cluttered(panda(), max(count, 2 * MOTIONS))
        rival = Pinocchio(course.checker, course.urdf)
    except Missing as missing:
        return [
            *rows,
            Row("panda, 10 obstacles", "collide", None, "pinocchio", None, count, note=f"not run: {missing}"),
        ]
    motions = QUICK_MOTIONS if quick else MOTIONS
    return [*rows, of_configurations(course, rival, count // 4, rounds), of_motions(course, rival, motions, rounds)]


def of_pairs(case: str, p: Pairs, query: Callable[..., Any], of_coal: str, rounds: int) -> Row:
    """One query of pairs, one by one, beside Coal with objects made beforehand."""
    bodies = list(p.bodies)
    calls = [(bodies[i], A, bodies[j], B) for i, A, j, B in zip(p.a, p.Ta, p.b, p.Tb, strict=True)]

    def each() -> list[Any]:
        return [query(*call) for call in calls]

    us = timed(each, len(calls))
    name = getattr(query, "func", query).__name__
    try:
        coal = CoalPython(p)
    except Missing as missing:
        return Row(
            case, name, race({"us": us}, rounds)["us"], "Coal Python", None, len(calls), note=f"not run: {missing}"
        )
    cost = race({"us": us, "coal": coal.measured(of_coal)}, rounds)
    ours, theirs = each(), getattr(coal, of_coal)()
    if name == "distance":
        wrong = np.abs(np.array([d.distance for d in ours]) - theirs) > 1e-5
    elif name == "classify":  # an ambiguous pair may be either
        said = np.array(ours)
        wrong = (said != loewner.Verdict.AMBIGUOUS) & ((said == loewner.Verdict.COLLIDING) != theirs)
    else:
        wrong = np.array(ours) != theirs
    return Row(case, name, cost["us"], f"Coal Python, {of_coal}", cost["coal"], len(calls), None, int(np.sum(wrong)))


def of_configurations(course: Course, rival: Pinocchio, count: int, rounds: int) -> Row:
    """Configurations of a robot, one by one, beside the fastest way to ask pinocchio."""
    Q = course.Q[:count]
    X = rival.configurations(Q)
    collide, ours = course.checker.collide, list(Q)
    contestants = {"us": timed(lambda: [collide(q) for q in ours], count)}
    contestants |= {name: timed(partial(each_of, check, list(X)), count) for name, check in rival.single.items()}
    cost = race(contestants, rounds)
    fastest = min(rival.single, key=lambda name: cost[name].cpu)
    answers = collide(Q), np.array(each_of(rival.single[fastest], list(X)))
    return Row(
        "one configuration", "collide", cost["us"], f"pinocchio, {fastest}", cost[fastest], count, None,
        *differing(rival, X, *answers, course.name),
    )  # fmt: skip


def each_of(check: Callable[[Array, bool], bool], configurations: list[Array]) -> list[bool]:
    """Ask pinocchio about configurations one by one; it stops at the first contact of each."""
    return [check(x, True) for x in configurations]


def of_motions(course: Course, rival: Pinocchio, count: int, rounds: int) -> Row:
    """Motions, one by one, beside a loop over the same configurations in the same order, until one collides."""
    robot, checker = course.checker.robot, course.checker
    ends = list(zip(course.Q[:count], course.Q[count : 2 * count], strict=True))
    ways = [
        list(rival.configurations(robot.between(a, b, coarse_first(int(steps(robot.distances(a, b), RESOLUTION))))))
        for a, b in ends
    ]

    def each() -> list[bool]:
        return [checker.valid_edges(a, b, RESOLUTION) for a, b in ends]

    contestants = {"us": timed(each, count)}
    contestants |= {name: timed(partial(free_ways, check, ways), count) for name, check in rival.single.items()}
    cost = race(contestants, rounds)
    fastest = min(rival.single, key=lambda name: cost[name].cpu)
    wrong = int((np.array(each()) != free_ways(rival.single[fastest], ways)).sum())
    note = f"{course.name}, steps of {RESOLUTION:g}: {np.mean([len(way) for way in ways]):.0f} configurations a motion"
    return Row(
        "one motion", "valid_edges", cost["us"], f"pinocchio, {fastest}", cost[fastest], count, None, wrong,
        f"{note}, {np.mean(each()):.0%} free",
    )  # fmt: skip


def free_ways(check: Callable[[Array, bool], bool], ways: list[list[Array]]) -> list[bool]:
    """Whether pinocchio finds no collision on each way; it is not asked on after the first."""
    return [not any(check(x, True) for x in way) for way in ways]
