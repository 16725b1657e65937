"""Proofs of many motions and plans, each verified by the program that shares nothing with the library."""

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import checker_oracle
from checker_oracle import composed_bodies, random_robot, random_scene, simple_bodies
from families import FAMILIES, near_contact, pieces, stretch
from loewner import (
    Body,
    CollisionChecker,
    ConvergenceError,
    PlanningError,
    Verdict,
    collide,
    distance,
    planners,
    prove,
    read_motion_bench_maker,
)
from loewner.verify import verify
from motion_oracle import example, free_configurations, ring, steps
from oracles import hull, pack
from test_second_checker import agrees  # noqa: F401

pytestmark = [pytest.mark.verify, pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")]

ROBOTS, PLANS = 200, 100

# Pairs of each of the fifteen families; a hundredth of the proofs are also given to the program in C.
PAIRS = 1_600

ARMS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf"),
    "talos": ("talos_data/robots/talos_full_v2.urdf", "talos_data/srdf/talos.srdf"),
}


def test_motions_of_robots_at_random(tmp_path, monkeypatch):
    """All kinds of joints and pieces, margins and joint errors: what is written is verified.

    Without a joint error, a proof is written of every motion that is free.
    """
    monkeypatch.setattr(checker_oracle, "KINDS", ("revolute", "continuous", "prismatic", "planar", "fixed", "revolute"))
    seen = Counter()
    for seed in range(ROBOTS):
        rng = np.random.default_rng([36, seed])
        bodies = [*simple_bodies(rng), *composed_bodies(rng)] if seed % 2 else simple_bodies(rng)
        robot = random_robot(rng, tmp_path, int(rng.integers(2, 7)), bodies)
        if not robot.bodies or robot.dof == 0:
            continue
        checker = CollisionChecker(robot, random_scene(rng, robot, int(rng.integers(0, 6)), bodies))
        error = float(rng.choice([0.0, 0.0, 1e-3, 1e-2]))
        Q = free_configurations(checker, 4, seed)
        ends = steps(robot, rng, Q, float(rng.choice([0.03, 0.2, 1.0]))) if len(Q) else Q
        for a, b in zip(Q, ends, strict=True):
            try:
                proof = checker.certify_edges(a, b, joint_error=error, proof=True).proof
            except ConvergenceError:
                assert error > 0.0
                seen["coarse"] += 1
                continue
            if proof is not None:
                assert verify(proof.data).sizes["pairs"] == len(checker.checked_pairs)
                seen["verified"] += 1
    print("proofs of motions at random:", dict(seen))
    assert seen["verified"] > ROBOTS
    assert seen["coarse"] < seen["verified"] / 20


@pytest.mark.parametrize("family", FAMILIES)
def test_pairs(family, agrees):  # noqa: F811
    """Every verdict of pairs has a proof that is verified, a third of them within 1e-12 to 1e-2 of contact."""
    hulls = [hull(points) for points in pieces(family, 100, 36)]
    pool, made = pack(hulls), [Body.from_points(each.vertices) for each in hulls]
    rng = np.random.default_rng([36, *family.encode()])
    ia, ib = rng.integers(len(made), size=(2, PAIRS))
    Ta, Tb = near_contact(rng, pool, ia, pool, ib, grazing=0.3, stretch=stretch(family))
    colliding = [collide(made[ia[k]], Ta[k], made[ib[k]], Tb[k]) for k in range(PAIRS)]
    seen = Counter()
    for k in range(PAIRS):
        proof = prove(made[ia[k]], Ta[k], made[ib[k]], Tb[k])
        report = verify(proof.data)
        assert (report.common is not None) == (proof.verdict == Verdict.COLLIDING)
        if (proof.verdict == Verdict.COLLIDING) != colliding[k]:  # nearer than rounding, which counts as touching
            assert 0.0 < distance(made[ia[k]], Ta[k], made[ib[k]], Tb[k], exact=True).distance < 1e-12
            assert colliding[k]
            seen["touching within rounding"] += 1
        seen[proof.verdict] += 1
        if k % 100 == 0:
            depth = -distance(made[ia[k]], Ta[k], made[ib[k]], Tb[k], exact=True).distance
            seen["refused in C"] += not agrees(proof.data, exactly=not 0.0 < depth < 1e-7)
    print(f"pairs of {family}:", dict(seen))
    assert min(seen[Verdict.FREE], seen[Verdict.COLLIDING]) > PAIRS / 10


def verified(checker, plan):
    """The size of a plan's proof, once it is verified to be about this checker and the whole path."""
    report = verify(plan.proof.data)
    assert report.model == checker.model_hash
    assert len(report.motions) == len(plan.path) - 1
    assert all(joined for _, joined, _, _ in report.motions[1:])
    return plan.proof.size


@pytest.mark.filterwarnings("ignore:.*states that place the base")
@pytest.mark.parametrize("name", ["ur5", "talos", "panda on a base"])
def test_plans_of_robots(name):
    """Proofs of a hundred plans of an arm, a humanoid, and an arm on a mobile base with sliding joints are verified."""
    robot, sizes, wide = example(*ARMS[name.split()[0]]), [], 0
    if "base" in name:
        robot = robot.add_base("planar", [[-2.0, 2.0], [-2.0, 2.0]])
    for seed in range(PLANS):
        checker = CollisionChecker(robot, ring(np.random.default_rng([37, seed]), 10, 0.5, 1.5, 0.3))
        start, *goals = free_configurations(checker, 12, seed)[:6]
        for goal in goals:
            try:
                plan = planners.plan(checker, start, goal, full=True, proof=True)
            except PlanningError:
                continue
            except ConvergenceError as error:
                assert "hulls of parts" in str(error)  # noqa: PT017
                wide += 1
                continue
            sizes.append(verified(checker, plan))
        if len(sizes) >= PLANS:
            break
    print(
        f"{name}: {len(sizes)} plans verified, {np.median(sizes):.0f} bytes in the median, {max(sizes)} at most; "
        f"{wide} without a proof"
    )
    assert len(sizes) >= PLANS
    assert wide <= PLANS / 20


@pytest.mark.skipif("LOEWNER_MBM" not in os.environ, reason="LOEWNER_MBM names no file of MotionBenchMaker problems")
def test_motion_bench_maker():
    """The proof of every plan is verified and takes at most 10 kB."""
    robot, sizes = example(*ARMS["panda"]), []
    for problem in read_motion_bench_maker(Path(os.environ["LOEWNER_MBM"])):
        columns = [robot.configuration_names.index(name) for name in problem.joint_names]
        Q = np.tile(robot.configuration({"panda_finger_joint1": 0.04}), (1 + len(problem.goals), 1))
        Q[:, columns] = np.vstack([problem.start, problem.goals])
        checker = CollisionChecker(robot, problem.scene)
        try:
            plan = planners.plan(checker, Q[0], Q[1:], joints=list(problem.joint_names), full=True, proof=True)
        except PlanningError:
            continue
        sizes.append(verified(checker, plan))
    print(f"{len(sizes)} plans verified, {np.median(sizes):.0f} bytes in the median, {max(sizes)} at most")
    assert len(sizes) >= 620
    assert max(sizes) <= 10_000
