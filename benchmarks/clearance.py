"""Distances of robots and their gradients: how fast, how right, beside pinocchio with Coal.

    python benchmarks/clearance.py [--quick] [--out FOLDER]

Panda among ten obstacles, one thread: bounds, exact distances, exact distances with gradients, of a batch and one
configuration a call; beside `computeDistances` with the Jacobians of the nearest pair. Then gradients beside central
differences: those that differ by more than 1e-5 have a kink within the step, which is counted.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import report
from clock import race, threads_set_to, timed
from loewner import CollisionChecker
from report import Row
from rivals import Missing
from robot_rivals import Pinocchio
from robot_samples import Sample, obstacles, panda, talos
from samples import Array

COUNT, SINGLES, RIVALS, DIFFERENCES = 20_000, 500, 500, 200
QUICK = 50
STEP = 1e-6
LARGE = 1e-5


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument("--out", type=Path, help="folder for results")
    asked = parser.parse_args(arguments)
    facts = report.machine()
    kept = Path("out/benchmarks") if asked.quick else Path(__file__).parent / "results" / report.machine_name(facts)
    results = asked.out or kept
    with threads_set_to(1):
        rows = speed(panda(), asked.quick)
        report.show("distances of a robot: one thread", rows)
        figures = [differences(sample, name, asked.quick) for name, sample in (("panda", panda()), ("talos", talos()))]
    for entry in figures:
        print("  " + ", ".join(f"{key}: {value:.3g}" if isinstance(value, float) else f"{key}: {value}"
                               for key, value in entry.items()))  # fmt: skip
    report.write(results / "clearance.csv", rows, facts)
    (results / "clearance.json").write_text(json.dumps({"machine": facts, "differences": figures}, indent=1) + "\n")
    return 0


def speed(arm: Sample, quick: bool) -> list[Row]:
    """Batches, one configuration a call, and the rival one by one, as its interface has it."""
    checker = CollisionChecker(arm.robot, obstacles(0))
    Q = arm.robot.random_configurations(QUICK if quick else COUNT, 1)
    singles, few = Q[: QUICK if quick else SINGLES], Q[: QUICK if quick else RIVALS]
    rounds = 1 if quick else 5
    ours: dict[str, tuple[Array, dict[str, bool]]] = {
        "bounds": (Q, {}),
        "exact": (Q, {"exact": True}),
        "exact with gradient": (Q, {"exact": True, "gradient": True}),
    }
    measures = {name: timed(partial(checker.distance, X, **options), len(X)) for name, (X, options) in ours.items()}

    def one_by_one(**options: bool) -> list[Any]:
        return [checker.distance(q, **options) for q in singles]

    for name, (_, options) in ours.items():
        measures[f"{name}, one a call"] = timed(partial(one_by_one, **options), len(singles))
    rival_name, told = "pinocchio computeDistances, Jacobians", ""
    try:
        rival = Pinocchio(checker, arm.urdf)
        X = rival.configurations(few)
        measures["rival"] = timed(partial(with_jacobians, rival, X), len(few))
        theirs = np.array([rival.distance(q) for q in X])
        distances = checker.distance(few, exact=True).distance
        free = (theirs > 0) | (distances > 0)
        differing = int((np.abs(theirs - distances)[free] > 1e-5).sum())
        told = f"{differing} of {free.sum()} free configurations differ by more than 10 um"
    except Missing as missing:
        print(f"rival not run: {missing}")
    costs = race(measures, rounds)
    theirs_cost = costs.pop("rival", None)
    return [
        Row(name, "distance", cost, rival_name, theirs_cost if "exact" in name else None, COUNT,
            note=told if name == "exact" else "")
        for name, cost in costs.items()
    ]  # fmt: skip


def with_jacobians(rival: Pinocchio, X: Array) -> list[Any]:
    """Distances, and how the two witnesses of the nearest pair move with the configuration."""
    pin, model, data = rival._pin, rival.model, rival.data
    found = []
    for q in X:
        rival.distance(q)
        results = rival.geometry_data.distanceResults
        nearest = min(range(len(results)), key=lambda k: results[k].min_distance)
        pin.computeJointJacobians(model, data, q)
        pair = rival.geometry.collisionPairs[nearest]
        joints = (rival.geometry.geometryObjects[k].parentJoint for k in (pair.first, pair.second))
        found.append([pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.WORLD) for joint in joints])
    return found


def differences(sample: Sample, name: str, quick: bool) -> dict[str, Any]:
    """Gradients beside central differences at configurations where nothing touches."""
    checker = CollisionChecker(sample.robot, obstacles(0))
    Q = sample.robot.random_configurations(10 if quick else DIFFERENCES, 2)
    found = checker.distance(Q, exact=True, gradient=True)
    errors, kinks = [], 0
    for column in range(sample.robot.dof):
        step = np.zeros(sample.robot.dof)
        step[column] = STEP
        after, before = checker.distance(Q + step, exact=True), checker.distance(Q - step, exact=True)
        error = np.abs((after.distance - before.distance) / (2 * STEP) - found.gradient[:, column])
        one_sided = np.abs(after.distance - 2 * found.distance + before.distance) / STEP
        kinks += int(((error > LARGE) & (one_sided > LARGE)).sum())
        errors.append(error)
    error = np.concatenate(errors)
    return {
        "robot": name, "derivatives": len(error), "median error": float(np.median(error)),
        "larger than 1e-5": int((error > LARGE).sum()), "of these with a kink": kinks,
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
