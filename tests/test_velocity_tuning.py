"""Times for a path among bodies that move: the path and all limits are kept, and the whole is proven."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from families import translation
from gantry import LEFT, RIGHT, UP, gantry_robot
from loewner import Body, CollisionChecker, InputError, PlanningError, Scene, Verdict, planners
from sampling import examples, quick
from test_plans_in_time import gate

SAMPLES = 1001
FAST, STRONG = np.array([1.0, 1.5, 2.0]), np.array([2.0, 3.0, 4.0])
HASTE = {"velocity": FAST, "acceleration": STRONG}

# Limits may be exceeded by this share, for rounding of times and positions.
ROUNDED = 1e-9


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """A ball that slides along x and y, and a rod that turns beside it."""
    return gantry_robot(tmp_path_factory.mktemp("gantry"))


def exact(array):
    """Fractions that equal floating-point numbers."""
    return [[Fraction(x) for x in row] for row in array.tolist()]


def largest(found):
    """The largest velocities, accelerations and jerks of each joint at any real time, computed in fractions.

    They are those of the polynomials through the positions and velocities at both ends of each piece, which a
    controller follows. A velocity is largest at an end of a piece, or where the acceleration is zero.
    """
    knots, rates, times = exact(found.knots), exact(found.rates), [Fraction(t) for t in found.times.tolist()]
    most = np.zeros((3, len(found.names)), dtype=object)
    for k in range(len(times) - 1):
        T = times[k + 1] - times[k]
        for j in range(len(found.names)):
            a, b, u, v = knots[k][j], knots[k + 1][j], rates[k][j], rates[k + 1][j]
            jerk = 6 * (u + v) / T**2 - 12 * (b - a) / T**3
            start = 6 * (b - a) / T**2 - (4 * u + 2 * v) / T
            if found.bends is None:  # the cubic polynomial is a parabola, up to rounding
                start, jerk = (v - u) / T, Fraction(0)
            speeds = [u, v]
            if jerk and 0 < -start / jerk < T:
                speeds.append(u - start * start / jerk / 2)
            reached = max(map(abs, speeds)), max(abs(start), abs(start + jerk * T)), abs(jerk)
            most[:, j] = [max(pair) for pair in zip(most[:, j], reached, strict=True)]
    return most


def check(checker, path, found, begin=0.0, jerk=None, joint_error=0.0):
    """All laws of times for a path, but for the time of arrival."""
    np.testing.assert_array_equal(found.knots[[0, -1]], np.asarray(path)[[0, -1]])
    assert not found.rates[0].any()
    assert not found.knots.flags.writeable
    assert found.start_time == begin
    assert found._fault() == ""
    speed, push, change = largest(found)
    assert (speed <= FAST * (1 + ROUNDED)).all()
    assert (push <= STRONG * (1 + ROUNDED)).all()
    if jerk is not None:
        assert (change <= jerk).all()
    assert found.certify(checker, joint_error=joint_error).verdict == Verdict.FREE
    t = np.linspace(0.0, found.duration, SAMPLES)
    assert not checker.collide(found.positions(t), begin + t).any()


# -- known answers ----------------------------------------------------------------------------


def test_the_robot_passes_as_the_gate_opens(slider):
    """The gate is 0.1 m past the ball at 2.7 s; at full speed it is at the gate after 0.6 s of 1.5 s: 3.6 s in all."""
    checker = CollisionChecker(slider, gate())
    found = planners.time_path(checker, [LEFT, RIGHT], start_time=0.0, **HASTE)
    check(checker, [LEFT, RIGHT], found)
    assert 3.6 < found.duration < 3.65


@pytest.mark.parametrize("jerk", [None, 20.0])
def test_nothing_in_the_way(slider, jerk):
    """In a still scene, and where the gate is open, times are those of `trajectory`."""
    fastest = planners.trajectory(slider, [LEFT, RIGHT], jerk=jerk, **HASTE)
    for scene, begin in ((Scene(), -4.0), (gate(), 3.0), (gate(1.7e9), 1.7e9 + 1.0)):
        checker = CollisionChecker(slider, scene)
        found = planners.time_path(checker, [LEFT, RIGHT], start_time=begin, jerk=jerk, **HASTE)
        check(checker, [LEFT, RIGHT], found, begin, jerk=jerk)
        assert found.duration == pytest.approx(fastest.duration, rel=1e-12)
        assert found.spacing == pytest.approx(fastest.spacing, rel=1e-5)


@pytest.mark.parametrize(("forth", "back"), [(0.5, 0.1), (0.3, 0.1), (0.7, 0.3)])
def test_a_path_that_reverses_keeps_its_blend(slider, forth, back):
    """In the middle of the blend, velocities are zero, but nothing rests there."""
    scene, far = Scene(), translation(9.0)
    scene.add("bird", Body.sphere(0.1))
    scene.follow("bird", [0.0, 1.0], [far, translation(9.5)])
    path = [LEFT, LEFT + [forth, 0, 0], LEFT + [forth - back, 0, 0]]
    checker = CollisionChecker(slider, scene)
    found = planners.time_path(checker, path, start_time=0.0, velocity=1.0, acceleration=1.0)
    assert found._fault() == ""
    assert all((most <= 1 + ROUNDED).all() for most in largest(found)[:2])
    assert found.certify(checker).verdict == Verdict.FREE
    assert found.duration <= planners.trajectory(slider, path, velocity=1.0, acceleration=1.0).duration


def test_corners_are_passed_without_a_stop(slider):
    """A path around a post has blends, and keeps them; without blends, the robot stops."""
    scene = gate()
    scene.add("post", Body.box([0.1, 0.1, 1.0]), translation(x=-0.35))
    checker, path = CollisionChecker(slider, scene), [LEFT, LEFT + [0.3, 0.0, 0.2], RIGHT + [0.0, 1.0, 0.2]]
    found = planners.time_path(checker, path, start_time=2.0, **HASTE)
    check(checker, path, found, 2.0)
    assert len(found.blends) == 1
    stopped = planners.time_path(checker, path, start_time=2.0, blend=0.0, **HASTE)
    check(checker, path, stopped, 2.0)
    assert len(stopped.blends) == 0
    assert stopped.duration > found.duration


@pytest.mark.parametrize("step", quick(0.05, 0.01))
def test_the_robot_goes_slower_where_it_cannot_wait(slider, step):
    """A ball comes to the start at 0.8 s; another is where the path ends until 3 s, and no later start is free."""
    scene = Scene()
    scene.add("behind", Body.sphere(0.1))
    scene.follow("behind", [0.0, 1.5], [translation(-1.5, -0.5), translation(-0.5, -0.5)])
    scene.add("ahead", Body.sphere(0.1))
    scene.follow("ahead", [0.0, 3.0, 4.0], [translation(0.5, -0.5), translation(0.5, -0.5), translation(0.5, 1.0)])
    checker, path = CollisionChecker(slider, scene), [LEFT, RIGHT]
    fastest = planners.trajectory(slider, path, **HASTE)
    for wait in np.arange(0.0, 5.0, step):
        waits = checker.certify_edges(LEFT, LEFT, t0=0.0, t1=wait).verdict == Verdict.FREE
        assert not (waits and checker.certify_trajectory(fastest, t0=wait).verdict == Verdict.FREE)
    found = planners.time_path(checker, path, start_time=0.0, **HASTE)
    check(checker, path, found)
    assert found.duration < 4.2


# -- times of arrival and velocities there ----------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.0, 0.3, 1.0])
def test_the_robot_arrives_at_a_given_time(slider, speed):
    """At this time the robot is at the last configuration, at the given velocity; saved, it is the same."""
    checker = CollisionChecker(slider, gate(7.0))
    for begin, at in ((5.0, 9.5), (5.25, 20.0), (7.0, 9.3)):
        velocity = np.array([speed, 0.0, 0.0])
        found = planners.time_path(
            checker, [LEFT, RIGHT], start_time=begin, arrive_at=at, end_velocity=velocity, **HASTE
        )
        check(checker, [LEFT, RIGHT], found, begin)
        np.testing.assert_allclose(found.rates[-1], velocity, atol=1e-12)
        assert begin + found.duration == pytest.approx(at, abs=1e-12)


def test_an_end_velocity_is_saved(slider, tmp_path):
    """Files contain the velocity at the end."""
    found = planners.time_path(
        CollisionChecker(slider, gate()), [LEFT, RIGHT], start_time=3.0, end_velocity=[0.5, 0.0, 0.0], **HASTE
    )
    assert found.duration == pytest.approx(0.5 + (1.0 - 0.25 - 0.1875) + 0.25, rel=1e-12)
    for name in ("found.csv", "found.json"):
        found.save(tmp_path / name)
        again = planners.Trajectory.load(tmp_path / name)
        np.testing.assert_array_equal(again.rates, found.rates)
        assert again.start_time == 3.0


def test_a_time_at_which_the_end_is_blocked(slider):
    """The gate closes at the end of the path: the robot does not arrive later, and the message names the gate."""
    scene = Scene()
    scene.add("gate", Body.box([0.1, 1.0, 1.0]))
    scene.follow("gate", [4.0, 5.0], [translation(0.5, 1.0), translation(0.5, -0.5)])
    checker = CollisionChecker(slider, scene)
    check(checker, [LEFT, RIGHT], planners.time_path(checker, [LEFT, RIGHT], start_time=0.0, arrive_at=4.0, **HASTE))
    with pytest.raises(PlanningError, match=r"backward from the end .* ball and gate .* are in the way at 6 s"):
        planners.time_path(checker, [LEFT, RIGHT], start_time=0.0, arrive_at=6.0, **HASTE)


# -- limits of jerk, and errors of joints ---------------------------------------------------------------


@pytest.mark.parametrize("jerk", [5.0, 20.0, 300.0])
def test_jerk_is_limited(slider, jerk):
    """Accelerations change linearly, and all limits hold at every instant, also with a given time of arrival."""
    checker, path = CollisionChecker(slider, gate()), [LEFT, LEFT + [0.3, 0.6, 0.5], RIGHT]
    found = planners.time_path(checker, path, start_time=0.0, jerk=jerk, **HASTE)
    assert found.bends is not None
    check(checker, path, found, jerk=jerk)
    found = planners.time_path(checker, path, start_time=0.0, jerk=jerk, arrive_at=9.0, **HASTE)
    check(checker, path, found, jerk=jerk)
    assert found.duration == pytest.approx(9.0, abs=1e-12)


def test_averages_that_would_cut_a_corner(slider):
    """A path that turns a millimetre beside a post is followed with a stop, since its averaged blend is not free."""
    scene = gate()
    scene.add("post", Body.box([0.4, 0.4, 1.0]), translation(x=-0.2, y=0.2))
    checker = CollisionChecker(slider, scene)
    path = [[-0.501, -0.5, UP], [-0.501, 0.501, UP], [0.5, 0.501, UP]]
    smooth = planners.time_path(checker, path, start_time=0.0, **HASTE)
    check(checker, path, smooth)
    found = planners.time_path(checker, path, start_time=0.0, jerk=10.0, **HASTE)
    check(checker, path, found, jerk=10.0)
    assert len(found.blends) == 0


def test_errors_of_joints_are_covered(slider):
    """With an error of a centimetre the gate has to be opened by a centimetre more, and all deviations are free."""
    checker, path, error = CollisionChecker(slider, gate()), [LEFT, RIGHT], 0.01
    found = planners.time_path(checker, path, start_time=0.0, joint_error=error, **HASTE)
    check(checker, path, found, joint_error=error)
    t, rng = np.linspace(0.0, found.duration, SAMPLES), np.random.default_rng(0)
    assert not checker.collide(found.positions(t) + error * rng.choice([-1.0, 1.0], (SAMPLES, 3)), t).any()


# -- random problems -----------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), jerk=st.sampled_from([None, 30.0]))
@examples(4, 20)
def test_random_bodies_are_not_met(slider, seed, jerk):
    """Balls wander; the distance of each to the robot's ball follows from their centres, at dense times."""
    rng, scene = np.random.default_rng(seed), Scene()
    for k in range(3):
        times = np.sort(rng.uniform(0.0, 5.0, 3))
        scene.add(f"ball {k}", Body.sphere(0.2))
        scene.follow(f"ball {k}", times, [translation(*rng.uniform(-1.2, 1.2, 2)) for _ in times])
    checker, path = CollisionChecker(slider, scene), rng.uniform(-1.0, 1.0, (3, 3))
    found, told = None, ""
    try:
        found = planners.time_path(checker, path, start_time=0.0, jerk=jerk, **HASTE)
    except PlanningError as error:
        told = str(error)
    if found is None:
        assert "ball " in told  # it names what is in the way
        return
    check(checker, path, found, jerk=jerk)
    t = np.linspace(0.0, found.duration, SAMPLES)
    for motion in scene.following.values():
        apart = np.linalg.norm(found.positions(t)[:, :2] - motion.poses(t)[:, :2, 3], axis=1)
        assert apart.min() > 0.3


# -- refusals --------------------------------------------------------------------------------------


def test_without_times_the_body_is_named(slider):
    """A gate that stays closed, a latest arrival that is too early, and a start or a path that is not free."""
    checker = CollisionChecker(slider, gate())
    for wrong, error, message in (
        ({"arrive_by": 2.0}, PlanningError, r"between 0 s and 2 s .* ball and gate .* in the way at 0\.\d+ s"),
        ({"arrive_by": 1.0}, PlanningError, "arrive_by: expected 1.5 s or later"),
        ({"arrive_at": 1.0}, PlanningError, "arrive_at: expected 1.5 s or later"),
        ({"arrive_at": 4.0, "arrive_by": 5.0}, InputError, "arrive_at: expected no arrive_by"),
        ({"end_velocity": [0.0, 0.5, 0.0]}, InputError, "end_velocity: expected a velocity along the last motion"),
        ({"end_velocity": [-0.5, 0.0, 0.0]}, InputError, "end_velocity: expected a velocity along the last motion"),
        ({"end_velocity": [1.5, 0.0, 0.0]}, InputError, "end_velocity: expected one within the velocity limits"),
        ({"end_velocity": [0.9, 0.0, 0.0], "acceleration": 0.1}, InputError, "of which only 0.497 is reached"),
        ({"end_velocity": [0.5, 0.0, 0.0], "jerk": 9.0}, InputError, "end_velocity: expected no limit of jerk"),
        ({"end_velocity": [0.5]}, InputError, "end_velocity: expected shape"),
        ({"start_time": np.nan}, InputError, "start_time"),
        ({"blend": 0.6}, InputError, "blend: expected a share"),
        ({"joint_error": -1.0}, InputError, "joint_error: expected one number >= 0"),
        ({"path": [LEFT, LEFT]}, InputError, "path: expected two different configurations"),
        ({"path": [[0.0, -0.5, UP], RIGHT]}, PlanningError, "path: expected a start that is free at the start time"),
        ({"checker": slider}, InputError, "checker: expected loewner.CollisionChecker"),
    ):
        options = {"checker": checker, "path": [LEFT, RIGHT], "start_time": 0.0, **HASTE, **wrong}
        with pytest.raises(error, match=message):
            planners.time_path(**options)
    walled = gate()
    walled.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    with pytest.raises(PlanningError, match=r"path: expected free motions, .* (ball|rod) and wall"):
        planners.time_path(CollisionChecker(slider, walled), [LEFT, RIGHT], start_time=0.0, **HASTE)


def test_a_later_start_is_proven_anew(slider):
    """The proof holds for its start time: half a second earlier, the trajectory meets the gate."""
    checker = CollisionChecker(slider, gate())
    found = planners.time_path(checker, [LEFT, RIGHT], start_time=0.0, **HASTE)
    assert replace(found, start_time=-0.5).certify(checker).verdict == Verdict.COLLIDING
