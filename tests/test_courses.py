"""Motions along polynomials are proven as what they are: no sample refutes one, and bends matter."""

import math
from dataclasses import replace

import numpy as np
import pytest

from families import translation
from gantry import RADIUS, gantry_robot
from loewner import Body, CollisionChecker, Scene, Verdict
from loewner._kernels import codes
from loewner.robots.proofs import courses
from loewner.robots.proofs.proofs import prove
from motion_oracle import AFLOAT, example, free_configurations, ring, written
from sampling import quick_of

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS


def through(rng, robot, Q, degree, length):
    """Courses from configurations Q in random directions; quaternions turn a little."""
    step = rng.normal(size=(len(Q), degree + 1, robot.dof)) * np.minimum(robot.upper - robot.lower, 1.0)
    step *= length / np.linalg.norm(step, axis=2, keepdims=True)
    step[:, 0] = 0.0
    made = Q[:, None] + np.cumsum(step, axis=1)
    for at in robot._quaternions.values():
        made[:, :, at] = Q[:, None, at] + rng.uniform(-0.07, 0.07, (len(Q), degree + 1, 4))
    return made


def refuted(checker, found, samples=1000):
    """Which courses collide at one of so many fractions."""
    t = np.linspace(0.0, 1.0, samples)
    every = (np.broadcast_to(course, (samples, *course.shape)) for course in found)
    return np.array([checker.collide(courses.configurations(checker.robot, same, t)).any() for same in every], bool)


def assert_true(checker, made):
    """Hold verdicts against samples and `collide`; returns them."""
    found = prove(checker._ready(), made, 1e-5)
    assert not refuted(checker, made[found.verdicts == FREE]).any()
    hit = found.verdicts == COLLIDING
    assert checker.collide(courses.configurations(checker.robot, made[hit], found.fractions[hit])).all()
    assert np.isfinite(found.fractions[found.verdicts != FREE]).all()
    return found.verdicts


@pytest.mark.parametrize("degree", quick_of([2, 3, 5, codes.MOST_POINTS - 1], [3, codes.MOST_POINTS - 1]))
@pytest.mark.parametrize("length", [0.1, 0.6])
def test_polynomials_of_an_arm(rng, degree, length):
    """No course of a Panda that is proven is refuted by samples, every hit is one, and all are decided."""
    arm = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    checker = CollisionChecker(arm, ring(rng, 10, 0.4, 0.9, 0.25))
    verdicts = assert_true(checker, through(rng, arm, free_configurations(checker, 60), degree, length))
    assert (verdicts == FREE).any()
    assert (verdicts == COLLIDING).any()
    assert not (verdicts == AMBIGUOUS).any()


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_polynomials_afloat(tmp_path, rng, degree):
    """The same of quaternions, a planar joint and one that slides."""
    bodies = {"cart": Body.box([0.3, 0.2, 0.1]), "arm": Body.capsule(0.05, 0.3), "hand": Body.sphere(0.06)}
    checker = CollisionChecker(replace(written(tmp_path, AFLOAT), bodies=bodies), ring(rng, 12, 0.6, 1.6, 0.5))
    made = through(rng, checker.robot, free_configurations(checker, 80), degree, 0.4)
    verdicts = assert_true(checker, made)
    assert (verdicts == FREE).any()
    assert (verdicts == COLLIDING).any()


@pytest.mark.parametrize("degree", [2, 3, 7])
def test_a_straight_motion_of_a_higher_degree(rng, degree):
    """Control points evenly spread on a straight motion are that motion, and are settled alike."""
    arm = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    checker = CollisionChecker(arm, ring(rng, 10, 0.4, 0.9, 0.25))
    a, b = through(rng, arm, free_configurations(checker, 100), 1, 0.6).transpose(1, 0, 2)
    share = (np.arange(degree + 1) / degree)[:, None]
    found = prove(checker._ready(), a[:, None] * (1 - share) + b[:, None] * share, 1e-5)
    assert (found.verdicts == checker.certify_edges(a, b).verdict).all()


@pytest.fixture
def ball(tmp_path):
    """A ball that slides along x and y."""
    return replace(gantry_robot(tmp_path), bodies={"ball": Body.sphere(RADIUS)})


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-5, -1e-9, -1e-5, -1e-3])
@pytest.mark.parametrize("where", [0.1, 0.5, 0.77])
def test_a_plate_at_the_extremum_of_an_overshoot(ball, gap, where):
    """A cubic swings out between its ends, which are far from a thin plate, and comes as near as `gap` to it once."""
    # y(t) = -(t - where)^2 + (t - where)^3 / 10, with its largest value 0 at `where`; x runs straight.
    power = np.polynomial.Polynomial([-where, 1.0])
    y = -(power**2) + 0.1 * power**3
    c0, c1, c2, c3 = y.coef
    points = np.array([c0, c0 + c1 / 3, c0 + 2 * c1 / 3 + c2 / 3, c0 + c1 + c2 + c3])
    course = np.zeros((1, 4, 3))
    course[0, :, 0] = (np.arange(4) / 3 - where) * 1e-3
    course[0, :, 1] = points
    scene = Scene()
    scene.add("plate", Body.box([1.0, 1e-4, 1.0]), translation(0.0, RADIUS + 0.5e-4 + gap))
    found = prove(CollisionChecker(ball, scene)._ready(), course, 1e-6)
    assert found.verdicts[0] == (FREE if gap > 0 else COLLIDING) or (abs(gap) < 1e-6 and found.verdicts[0] != FREE)
    if gap < -1e-6:
        assert found.fractions[0] == pytest.approx(where, abs=math.sqrt(-gap) * 1.1)


def test_an_orientation_that_may_turn_arbitrarily_fast(tmp_path):
    """Quaternions on control points that are far from each other pass near zero: no proof is tried."""
    scene = Scene()
    scene.add("ball", Body.sphere(0.1), translation(50.0))
    checker = CollisionChecker(replace(written(tmp_path, AFLOAT), bodies={"cart": Body.sphere(0.1)}), scene)
    q = checker.robot.random_configurations(1, 0)
    made = np.repeat(q[:, None], 3, axis=1)
    at = checker.robot._quaternions["base"]
    made[0, :, at] = [[1, 0, 0, 0], [1e-9, 1, 0, 0], [-1, 0, 1e-9, 0]]
    assert prove(checker._ready(), made, 1e-5).verdicts[0] == codes.TOO_LONG
