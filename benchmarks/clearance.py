"""Distances of robots and their gradients, beside pinocchio with Coal; depths of crowds and of listed pairs.

    python benchmarks/clearance.py [--quick] [--only robots | crowd] [--out FOLDER]

Crowd, one thread: 20,000 ellipsoids, which overlap, with depths and normals, and 40,000 of these pairs by number; each
beside the same by copies of bodies and poses, a row for each pair.

Robots: Panda among ten obstacles, one thread: bounds, exact distances, exact distances with gradients, of a batch and
one configuration a call; beside `computeDistances` with the Jacobians of the nearest pair. Then gradients beside
central differences: those that differ by more than 1e-5 have a kink within the step, which is counted.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import loewner
import report
from clock import Cost, race, threads_set_to, timed
from loewner import CollisionChecker
from report import Row
from rivals import Missing
from robot_rivals import Pinocchio
from robot_samples import Sample, obstacles, panda, talos
from samples import Array, poses, rotations

COUNT, SINGLES, RIVALS, DIFFERENCES = 20_000, 500, 500, 200
QUICK = 50
GRAINS, FILLED, LISTED = 20_000, 0.68, 40_000  # FILLED: share of the volume, overlaps counted twice
STEP = 1e-6
LARGE = 1e-5


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument("--only", choices=["robots", "crowd"], help="one of the two parts; without, both")
    parser.add_argument("--out", type=Path, help="folder for results")
    asked = parser.parse_args(arguments)
    facts = report.machine()
    kept = Path("out/benchmarks") if asked.quick else Path(__file__).parent / "results" / report.machine_name(facts)
    results = asked.out or kept
    with threads_set_to(1):
        if asked.only != "robots":
            rows = crowd(asked.quick)
            report.show("depths of a crowd, distances of listed pairs: one thread", rows)
            report.write(results / "clearance_crowd.csv", rows, facts)
        if asked.only != "crowd":
            robots(asked.quick, results, facts)
    return 0


def robots(quick: bool, results: Path, facts: dict[str, Any]) -> None:
    """Distances of robots and their gradients."""
    rows = speed(panda(), quick)
    report.show("distances of a robot: one thread", rows)
    figures = [differences(sample, name, quick) for name, sample in (("panda", panda()), ("talos", talos()))]
    for entry in figures:
        print("  " + ", ".join(f"{key}: {value:.3g}" if isinstance(value, float) else f"{key}: {value}"
                               for key, value in entry.items()))  # fmt: skip
    report.write(results / "clearance.csv", rows, facts)
    (results / "clearance.json").write_text(json.dumps({"machine": facts, "differences": figures}, indent=1) + "\n")


def crowd(quick: bool) -> list[Row]:
    """Depths of all overlaps in one call, and distances of listed pairs, beside copies of bodies and poses."""
    n, rng = QUICK if quick else GRAINS, np.random.default_rng(0)
    axes = rng.uniform(0.3, 1.0, size=(n, 3))
    side = np.cbrt(4 / 3 * np.pi * axes.prod(axis=1).sum() / FILLED)
    grains, T = loewner.Bodies.ellipsoids(axes), poses(rotations(rng, n), rng.uniform(0, side, size=(n, 3)))
    found = loewner.overlapping_pairs(grains, T, depth=True)
    listed = found.pairs[np.sort(rng.permutation(len(found))[:LISTED])]

    def copied(pairs: Array) -> tuple[Any, ...]:
        i, j = pairs.T
        return grains[i], T[i], grains[j], T[j]

    def by_copies(pairs: Array, exact: bool) -> Any:
        return loewner.distance(*copied(pairs), exact=exact)

    measures = {
        "depths": timed(lambda: loewner.overlapping_pairs(grains, T, depth=True), 1),
        "depths by copies": timed(lambda: by_copies(loewner.overlapping_pairs(grains, T), True), 1),
    }
    beforehand = copied(listed)
    for name, exact in (("bounds", False), ("exact", True)):
        measures[name] = timed(partial(loewner.distance, grains, T, grains, T, exact=exact, pairs=listed), 1)
        measures[f"{name} by copies"] = timed(partial(by_copies, listed, exact), 1)
        measures[f"{name} beforehand"] = timed(partial(loewner.distance, *beforehand, exact=exact), 1)
    costs = race(measures, 1 if quick else 5)
    truth = by_copies(found.pairs, True)
    differing = int((np.abs(truth.distance - found.distance) > 1e-9).sum())

    def row(case: str, us: str, name: str, rival: str, other: str, items: int, differing: int | None = None) -> Row:
        ours, theirs = (Cost(costs[k].wall / items, costs[k].cpu / items) for k in (name, other))
        note = f"{1000 * costs[name].cpu:.1f} ms beside {1000 * costs[other].cpu:.1f} ms"
        return Row(case, us, ours, rival, theirs, items, differing=differing, note=note)

    case = f"{n} ellipsoids, {len(found)} overlaps"
    rows = [row(case, "overlapping_pairs(depth=True)", "depths", "then distance by copies", "depths by copies",
                len(found), differing)]  # fmt: skip
    for name in ("bounds", "exact"):
        for rival, text in (("by copies", "broadcast, copies made"), ("beforehand", "broadcast, copies made before")):
            rows.append(row(f"{len(listed)} listed pairs, {name}", "distance(pairs=)", name, text, f"{name} {rival}",
                            len(listed)))  # fmt: skip
    return rows


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
