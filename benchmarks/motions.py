"""Motions proven free, beside the same motions looked at in steps."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from clock import race, timed
from loewner import CollisionChecker, Robot, Verdict
from report import REQUIRED, Row
from rivals import Missing
from robot_samples import obstacles, panda
from samples import Array

COUNT, QUICK = 1_000, 20
LENGTHS = (0.25, 1.0, 2.0)  # rad, over all joints
STEPS = (0.05, 0.02)  # rad
FINGER = "panda_finger_joint1"
OPEN = 0.04  # m


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
