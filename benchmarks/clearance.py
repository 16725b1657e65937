"""Distances of robots, bounds that are smooth, and their gradients: how fast, how right, beside pinocchio with Coal.

    python benchmarks/clearance.py [--only SECTION ...] [--quick] [--out FOLDER]

Sections, all on one thread:

    speed          Panda among ten obstacles: bounds, smooth clearance, exact distance, with and without gradients, of a
                   batch and one configuration a call; beside `computeDistances` with the Jacobians of the nearest pair
    answers        a million configurations: is a clearance above the exact distance, is that outside its bounds
    differences    gradients beside central differences, at 1,000 configurations of five robots. Of those that differ by
                   more than 1e-5 it is counted how many have a kink within the step
    pairs          wrenches of 10,000 pairs of bodies of all shapes beside central differences, likewise
    crowd          20,000 ellipsoids that overlap, with depths and normals; 40,000 of these pairs by number; each beside
                   the same by copies of bodies and poses, a row for each pair
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import report
from clock import Cost, race, threads_set_to, timed
from loewner import Bodies, Body, CollisionChecker, distance, overlapping_pairs
from report import Row
from rivals import Missing
from robot_rivals import Pinocchio
from robot_samples import Sample, five, obstacles, panda
from samples import Array, poses, rotations

SECTIONS = ("speed", "crowd", "answers", "differences", "pairs")
COUNT, SINGLES, RIVALS = 20_000, 500, 500
ANSWERS, AT_ONCE, DIFFERENCES, PAIRS = 1_000_000, 50_000, 200, 10_000
QUICK = 50
GRAINS, FILLED, LISTED = 20_000, 0.68, 40_000  # FILLED: share of the volume, overlaps counted twice
STEP = 1e-6
QUATERNION = ("qw", "qx", "qy", "qz")
LARGE = 1e-5


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS, help="sections; all if not given")
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument("--out", type=Path, help="folder for results")
    asked = parser.parse_args(arguments)
    facts = report.machine()
    kept = Path("out/benchmarks") if asked.quick else Path(__file__).parent / "results" / report.machine_name(facts)
    results = asked.out or kept
    figures: dict[str, list[dict[str, Any]]] = {}
    with threads_set_to(1):
        if "speed" in asked.only:
            rows = speed(panda(), asked.quick)
            report.show("distances of a robot: one thread", rows)
            report.write(results / "clearance.csv", rows, facts)
        if "crowd" in asked.only:
            rows = crowd(asked.quick)
            report.show("depths of a crowd, distances of listed pairs: one thread", rows)
            report.write(results / "clearance-crowd.csv", rows, facts)
        if "answers" in asked.only:
            figures["answers"] = [answers(panda(), asked.quick)]
        if "differences" in asked.only:
            figures["differences"] = [
                differences(sample, name, what, asked.quick)
                for name, sample in five().items()
                for what in ("exact", "smooth")
            ]
        if "pairs" in asked.only:
            figures["pairs"] = [wrenches(asked.quick)]
    for section, entries in figures.items():
        for entry in entries:
            told = (
                f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in entry.items()
            )
            print(f"{section}: " + ", ".join(told))
    if figures:
        results.mkdir(parents=True, exist_ok=True)
        (results / "clearance.json").write_text(json.dumps({"machine": facts, **figures}, indent=1) + "\n")
    return 0


def crowd(quick: bool) -> list[Row]:
    """Depths of all overlaps in one call, and distances of listed pairs, beside copies of bodies and poses."""
    n, rng = QUICK if quick else GRAINS, np.random.default_rng(0)
    axes = rng.uniform(0.3, 1.0, size=(n, 3))
    side = np.cbrt(4 / 3 * np.pi * axes.prod(axis=1).sum() / FILLED)
    grains, T = Bodies.ellipsoids(axes), poses(rotations(rng, n), rng.uniform(0, side, size=(n, 3)))
    found = overlapping_pairs(grains, T, depth=True)
    listed = found.pairs[np.sort(rng.permutation(len(found))[:LISTED])]

    def copied(pairs: Array) -> tuple[Any, ...]:
        i, j = pairs.T
        return grains[i], T[i], grains[j], T[j]

    def by_copies(pairs: Array, exact: bool) -> Any:
        return distance(*copied(pairs), exact=exact)

    measures = {
        "depths": timed(lambda: overlapping_pairs(grains, T, depth=True), 1),
        "depths by copies": timed(lambda: by_copies(overlapping_pairs(grains, T), True), 1),
    }
    beforehand = copied(listed)
    for name, exact in (("bounds", False), ("exact", True)):
        measures[name] = timed(partial(distance, grains, T, grains, T, exact=exact, pairs=listed), 1)
        measures[f"{name} by copies"] = timed(partial(by_copies, listed, exact), 1)
        measures[f"{name} beforehand"] = timed(partial(distance, *beforehand, exact=exact), 1)
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
    measures["smooth"] = timed(partial(checker.clearance, Q), len(Q))
    measures["smooth with gradient"] = timed(partial(checker.clearance, Q, gradient=True), len(Q))

    def one_by_one(query: Callable[..., Any], **options: bool) -> list[Any]:
        return [query(q, **options) for q in singles]

    for name, (_, options) in ours.items():
        measures[f"{name}, one a call"] = timed(partial(one_by_one, checker.distance, **options), len(singles))
    measures["smooth with gradient, one a call"] = timed(
        partial(one_by_one, checker.clearance, gradient=True), len(singles)
    )
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


def answers(arm: Sample, quick: bool) -> dict[str, Any]:
    """How often bounds do not hold."""
    checker = CollisionChecker(arm.robot, obstacles(0))
    count = QUICK if quick else ANSWERS
    above = outside = other_sign = 0
    short: list[Array] = []
    for seed, first in enumerate(range(0, count, AT_ONCE)):
        Q = arm.robot.random_configurations(min(AT_ONCE, count - first), 10 + seed)
        bounds, exact, smooth = checker.distance(Q), checker.distance(Q, exact=True).distance, checker.clearance(Q)
        above += int((smooth > exact).sum())
        outside += int(((bounds.lower > exact) | (exact > bounds.upper)).sum())
        other_sign += int(((exact <= 0) != checker.collide(Q)).sum())
        short.append(exact - smooth)
    return {
        "configurations": count, "clearance above exact": above, "exact outside bounds": outside,
        "sign other than that of collide": other_sign,
        "clearance short by, median": float(np.median(np.concatenate(short))),
    }  # fmt: skip


def differences(sample: Sample, name: str, what: str, quick: bool) -> dict[str, Any]:
    """Gradients by the configuration beside central differences."""
    checker = CollisionChecker(sample.robot, obstacles(0))
    Q = sample.robot.random_configurations(10 if quick else DIFFERENCES, 2)
    quaternions = [k for k, kind in enumerate(sample.robot.configuration_names) if kind.split("/")[-1] in QUATERNION]
    if what == "exact":
        found = checker.distance(Q, exact=True, gradient=True)
        value, gradient = found.distance, found.gradient
    else:
        value, gradient = checker.clearance(Q, gradient=True)

    def of(X: Array) -> Array:
        return checker.distance(X, exact=True).distance if what == "exact" else checker.clearance(X)

    errors, kinks = [], 0
    for column in range(sample.robot.dof):
        if column in quaternions:  # of norm 1: no step along one entry leads to another orientation alone
            continue
        step = np.zeros(sample.robot.dof)
        step[column] = STEP
        after, before = of(Q + step), of(Q - step)
        error = np.abs((after - before) / (2 * STEP) - gradient[:, column])
        one_sided = np.abs(after - 2 * value + before) / STEP
        kinks += int(((error > LARGE) & (one_sided > LARGE)).sum())
        errors.append(error)
    return summary({"robot": name, "of": what}, np.concatenate(errors), kinks)


def wrenches(quick: bool) -> dict[str, Any]:
    """Wrenches of exact distances of pairs of bodies beside central differences by six motions."""
    rng = np.random.default_rng(5)
    count = QUICK if quick else PAIRS
    bodies = shapes(rng)
    Ta, Tb = (poses(rotations(rng, count), rng.normal(size=(count, 3)) * 0.3) for _ in range(2))
    Tb[:, :3, 3] += rng.normal(size=(count, 3))
    chosen = rng.integers(len(bodies), size=(2, count))
    a, b = (bodies[row] for row in chosen)
    found = distance(a, Ta, b, Tb, exact=True)
    errors, kinks, deep, worst = [], 0, 0, 0.0
    for k in range(6):
        after, before = (distance(a, Ta, b, moved(Tb, k, step), exact=True).distance for step in (STEP, -STEP))
        error = np.abs((after - before) / (2 * STEP) - found.wrench[:, k])
        one_sided = np.abs(after - 2 * found.distance + before) / STEP
        kinked = one_sided > LARGE
        kinks += int(((error > LARGE) & kinked).sum())
        # The normal of a depth of curved pieces is known to about the root of the depth's accuracy.
        deep += int(((error > LARGE) & ~kinked & (found.distance < 0)).sum())
        worst = max(worst, float(error[~kinked].max()))
        errors.append(error)
    touching = int((found.distance <= 0).sum())
    told = summary({"pairs": count, "overlapping": touching}, np.concatenate(errors), kinks)
    return told | {"of these without, overlapping": deep, "largest without a kink": worst}


def shapes(rng: np.random.Generator) -> Bodies:
    """Bodies of all kinds."""
    return Bodies([
        Body.box([0.2, 0.4, 0.6]), Body.sphere(0.3), Body.ellipsoid([0.1, 0.3, 0.5]), Body.cylinder(0.2, 0.5),
        Body.cone(0.3, 0.5), Body.capsule(0.15, 0.5), Body.from_points(rng.normal(size=(12, 3)) * 0.2),
        Body.from_points(rng.normal(size=(200, 3)) * 0.2),
    ])  # fmt: skip


def moved(T: Array, k: int, step: float) -> Array:
    """Poses after a small motion along (or about) an axis of the world."""
    twist = np.zeros(6)
    twist[k] = step
    turn = Rotation.from_rotvec(twist[3:]).as_matrix()
    after = T.copy()
    after[:, :3] = turn @ T[:, :3]
    after[:, :3, 3] += twist[:3]
    return after


def summary(about: dict[str, Any], errors: Array, kinks: int) -> dict[str, Any]:
    """How far gradients are from differences."""
    return about | {
        "derivatives": len(errors), "median error": float(np.median(errors)),
        "larger than 1e-5": int((errors > LARGE).sum()), "of these with a kink": kinks,
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
