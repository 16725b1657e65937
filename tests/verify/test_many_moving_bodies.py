"""A hundred thousand motions and 300 plans among moving bodies: samples refute no free one, and confirm collisions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from families import translation
from loewner import Body, CollisionChecker, PlanningError, Scene, Verdict, planners
from motion_oracle import example
from test_moving_bodies import turned
from test_plans_in_time import check

pytestmark = pytest.mark.verify

MOTIONS = 2_000
PROBLEMS = 100


def conveyors(rng):
    """Ten parts on two belts in front of the robot, again and again."""
    scene = Scene(margin=0.005)
    for k in range(10):
        scene.add(f"part {k}", Body.box(rng.uniform(0.03, 0.15, 3)))
        x, z = 0.35 + 0.25 * (k % 2), rng.uniform(0.1, 0.6)
        first, last = translation(x=x, y=-1.5, z=z), translation(x=x, y=1.5, z=z)
        shift = rng.uniform(0.0, 10.0)
        times = np.array([0.0, 5.0, 10.0]) + shift
        scene.follow(f"part {k}", times, [first, last, first], repeat=True)
    return scene


def turning_rods(rng):
    """Three rods that turn about axes in the reach of the robot."""
    scene = Scene()
    for k in range(3):
        scene.add(f"rod {k}", Body.box([0.9, 0.02, 0.02]).transformed(translation(x=0.3)))
        at = rng.normal(size=3) * 0.4 + [0.0, 0.0, 0.5]
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        T = np.tile(np.eye(4), (5, 1, 1))
        T[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 5)[:, None] * axis).as_matrix()
        T[:, :3, 3] = at
        T[-1] = T[0]
        scene.follow(f"rod {k}", np.linspace(0.0, rng.uniform(0.5, 4.0), 5), T, repeat=True)
    return scene


def anything(rng):
    """Boxes and capsules that turn and wander about the robot, some of them again and again."""
    scene = Scene()
    for k in range(6):
        scene.add(f"body {k}", Body.capsule(0.04, 0.3) if k % 2 else Body.box(rng.uniform(0.05, 0.25, 3)))
        T = turned(rng, 4, 0.3)
        way = rng.normal(size=3) * [1.0, 1.0, 0.3]
        T[:, :3, 3] += way / np.linalg.norm(way) * rng.uniform(0.7, 1.1) + [0.0, 0.0, 0.4]
        if k >= 3:
            T = np.concatenate([T, T[::-1]])
        scene.follow(f"body {k}", np.cumsum(rng.uniform(0.1, 1.5, len(T))), T, repeat=k >= 3)
    return scene


@pytest.mark.parametrize("kind", [conveyors, turning_rods, anything])
def test_a_hundred_thousand_motions_in_time(kind):
    """Free motions are sampled, some of them ten thousand times; collisions are confirmed."""
    panda = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    counts, samples, f = np.zeros(3, dtype=int), 0, np.linspace(0.0, 1.0, 65)
    for seed in range(17):
        rng = np.random.default_rng(seed)
        checker = CollisionChecker(panda, kind(rng))
        a = panda.random_configurations(MOTIONS, seed)
        b = np.clip(
            a + rng.normal(size=a.shape) * rng.choice([0.0, 0.05, 0.3], size=(MOTIONS, 1)), panda.lower, panda.upper
        )
        t0 = rng.uniform(-2.0, 20.0, MOTIONS)
        t1 = t0 + rng.uniform(0.0, 1.5, MOTIONS)
        found = checker.certify_edges(a, b, t0=t0, t1=t1)
        counts += np.bincount(found.verdict, minlength=3)
        free = np.flatnonzero(found.verdict == Verdict.FREE)
        Q = panda.between(a[free, None], b[free, None], f)
        t = t0[free, None] + f * (t1 - t0)[free, None]
        assert not checker.collide(Q, t).any()
        samples += t.size
        fine = np.linspace(0.0, 1.0, 10_001)
        for k in free[:6]:
            assert not checker.collide(panda.between(a[k], b[k], fine), t0[k] + fine * (t1[k] - t0[k])).any()
        hit = np.flatnonzero(found.verdict == Verdict.COLLIDING)
        at = found.fraction[hit]
        assert checker.collide(panda.between(a[hit], b[hit], at), t0[hit] + at * (t1 - t0)[hit]).all()
    free, colliding, ambiguous = counts.tolist()
    print(f"{kind.__name__}: {free} free, {colliding} colliding, {ambiguous} ambiguous; {samples} samples of free ones")
    assert ambiguous <= counts.sum() / 1000
    assert min(free, colliding) > 1000


@pytest.mark.parametrize("kind", [conveyors, turning_rods, anything])
def test_no_plan_is_refuted(kind):
    """A thousand samples of each motion, at starts of all kinds, with errors of joints, limits of time and seeds."""
    robot = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    fine, solved = np.linspace(0.0, 1.0, 1001), 0
    for seed in range(PROBLEMS):
        rng = np.random.default_rng(seed)
        checker = CollisionChecker(robot, kind(rng))
        begin = float(rng.choice([0.0, rng.uniform(-5.0, 5.0), 1e4, 1.7e9]))
        velocity = robot.velocity * rng.uniform(0.1, 1.5)
        Q = robot.random_configurations(400, seed=seed)
        Q = Q[~checker.collide(Q, begin)]
        if len(Q) < 2:
            continue
        error = float(rng.choice([0.0, 0.005]))
        options = {"velocity": velocity, "joint_error": error, "max_iterations": 2000, "timeout": 1e3, "seed": seed}
        if rng.random() < 0.3:
            options["arrive_by"] = begin + 1.5 * float((np.abs(Q[-1] - Q[0]) / velocity).max())
        try:
            found = planners.plan(checker, Q[0], Q[-1], start_time=begin, **options)
        except PlanningError:
            continue
        solved += 1
        check(checker, found, Q[0], Q[-1], velocity, begin, error)
        assert begin + found.duration <= options.get("arrive_by", np.inf)
        for k in range(len(found.times) - 1):
            t = found.times[k] + fine * (found.times[k + 1] - found.times[k])
            assert not checker.collide(found.positions(np.minimum(t, found.duration)), begin + t).any()
    assert solved > 0.4 * PROBLEMS
