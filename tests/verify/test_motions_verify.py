"""A hundred thousand motions held against samples a thousandth of a radian apart, and motions that only just touch."""

from dataclasses import replace

import numpy as np
import pytest

from loewner import Body, CollisionChecker, Verdict
from motion_oracle import AFLOAT, assert_true, example, free_configurations, refuted, ring, steps, written

pytestmark = [pytest.mark.verify, pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")]

COUNT = 25_000
STEP = 1e-3  # rad or m between samples
AT_ONCE = 500


def panda(tmp_path):
    """An arm among obstacles, with its fingers closing and opening."""
    return example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")


def ur5(tmp_path):
    return example("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf")


def gripper(tmp_path):
    """The fingers and the hand of an arm, all their pairs checked: what mostly slides."""
    robot = panda(tmp_path)
    hands = {name: body for name, body in robot.bodies.items() if "finger" in name or "hand" in name}
    return replace(robot, bodies=hands, disabled_pairs=frozenset())


def afloat(tmp_path):
    bodies = {
        "base": Body.sphere(0.15), "cart": Body.box([0.3, 0.2, 0.1]), "arm": Body.capsule(0.05, 0.3),
        "hand": Body.cone(0.06, 0.2),
    }  # fmt: skip
    return replace(written(tmp_path, AFLOAT), bodies=bodies)


MACHINES = {
    "panda": (panda, 0.4, 0.9),
    "ur5": (ur5, 0.4, 0.9),
    "gripper": (gripper, 0.3, 0.9),
    "afloat": (afloat, 0.6, 2.5),
}


def checker_of(name, tmp_path, rng):
    make, near, far = MACHINES[name]
    return CollisionChecker(make(tmp_path), ring(rng, 10, near, far, 0.25), skip_adjacent=True)


@pytest.mark.parametrize("name", MACHINES)
def test_no_motion_is_refuted(name, tmp_path):
    """FREE is free at samples 1e-3 apart, COLLIDING collides, and at most 1 in 1,000 is AMBIGUOUS."""
    rng = np.random.default_rng(7)
    checker = checker_of(name, tmp_path, rng)
    start = free_configurations(checker, COUNT)
    start = np.concatenate([start] * -(-COUNT // len(start)))[:COUNT]
    ends = steps(checker.robot, rng, start, 1.0)
    verdicts = np.concatenate([
        assert_true(checker, start[k : k + AT_ONCE], ends[k : k + AT_ONCE], samples=int(1 / STEP) + 1)
        for k in range(0, COUNT, AT_ONCE)
    ])  # fmt: skip
    shares = np.bincount(verdicts, minlength=3) / COUNT
    print(name, "free, colliding, ambiguous:", shares)
    assert shares[Verdict.FREE] > 0.05
    assert shares[Verdict.COLLIDING] > 0.02
    assert shares[Verdict.AMBIGUOUS] < 1e-3


@pytest.mark.parametrize("name", MACHINES)
def test_motions_that_only_just_touch(name, tmp_path):
    """Between a motion that is free and one that collides lies one that touches; none on the way is called wrong."""
    rng = np.random.default_rng(8)
    checker = checker_of(name, tmp_path, rng)
    robot = checker.robot
    start = free_configurations(checker, 400)
    a, b = steps(robot, rng, start, 0.7), steps(robot, rng, start, 0.7)
    first, second = (checker.certify_edges(start, end).verdict for end in (a, b))
    chosen = (first == Verdict.FREE) & (second == Verdict.COLLIDING)
    start, free, hit = start[chosen], a[chosen], b[chosen]
    assert len(start) >= 20
    at = checker.certify_edges(start, hit).fraction
    ambiguous = 0
    for _ in range(40):
        middle = robot.between(free, hit, 0.5)
        found = checker.certify_edges(start, middle)
        clear = found.verdict == Verdict.FREE
        collides = found.verdict == Verdict.COLLIDING
        where = robot.between(start[collides], middle[collides], found.fraction[collides])
        assert checker.collide(where).all()
        at[collides] = found.fraction[collides]
        ambiguous += int((~clear & ~collides).sum())
        # The nearest motion that collides says where to look.
        for k in np.flatnonzero(clear):
            for width in (1e-1, 1e-3, 1e-5, 1e-7):
                t = np.clip(at[k] + width * rng.uniform(-1, 1, 100), 0, 1)
                assert not checker.collide(robot.between(start[k], middle[k], t)).any()
        free[clear], hit[~clear] = middle[clear], middle[~clear]
    assert not refuted(checker, start, free, 2000).any()
    print(name, len(start), "pairs of motions, ambiguous on the way:", ambiguous)
