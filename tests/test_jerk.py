"""Trajectories with limited jerk: limits hold at every real time, blends are proven, stops are as fast as can be."""

import contextlib
import json
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import BPoly, CubicHermiteSpline

from families import translation
from loewner import Body, CollisionChecker, FileError, InputError, Scene, UnknownNameError, Verdict
from loewner.planners import ControllerPoints, JointLimits, Trajectory, plan, trajectory
from loewner.planners.jerk_limited import JerkLimited
from loewner.planners.joint_limits import limits_of
from loewner.planners.judge import Judge
from loewner.planners.profiles import Limits, phases, ramp, ramp_way, reached
from loewner.planners.trajectories import corners_of
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.curves import curve_of
from motion_oracle import FINGERS, example, free_configurations, ring, steps, written
from sampling import examples
from test_trajectories import dense, in_blend, limits, off_polyline, paths

jerks = arrays(np.float64, 3, elements=st.floats(0.05, 5e3))


def extremes(times, knots, rates):
    """Largest velocities, accelerations and jerks of the cubics with these values and rates, shape (dof,) each.

    In closed form: the ends of each piece, and the place where its acceleration is zero.
    """
    T, way = np.diff(times)[:, None], np.diff(knots, axis=0)
    v0, v1 = rates[:-1] * T, rates[1:] * T
    cubic, square = v0 + v1 - 2 * way, 3 * way - 2 * v0 - v1
    with np.errstate(divide="ignore", invalid="ignore"):
        x = np.nan_to_num(np.clip(-square / (3 * cubic), 0, 1))
    inside = v0 + (2 * square + 3 * cubic * x) * x
    velocity, acceleration = [v0, v1, inside] / T, [2 * square, 2 * square + 6 * cubic] / T**2
    return [np.abs(found).max(axis=(0, 1), initial=0.0) for found in (velocity, acceleration, [6 * cubic / T**3])]


def least(path, limits):
    """The shortest phase of trajectories on a path."""
    moves = (path != path[0]).any(axis=0)
    along = JerkLimited.of(path[corners_of(path)], *(np.where(moves, limit, np.inf) for limit in limits.values())).along
    return along[0].least if along else 0.0


def assert_lawful(moved, path, velocity, acceleration, jerk):
    """Limits at every real time, without any allowance; ends; rest; and the path wherever no corner is cut."""
    for found, limit in zip(
        extremes(moved.times, moved.knots, moved.rates), (velocity, acceleration, jerk), strict=True
    ):
        assert (found <= limit).all()
    T = np.diff(moved.times)[:, None]
    assert (np.abs(moved.bends) <= acceleration).all()
    assert (np.abs(np.diff(moved.bends, axis=0) / T) <= jerk).all()
    # The stored rates and accelerations follow from each other.
    assert np.diff(moved.rates, axis=0) == pytest.approx(
        (moved.bends[1:] + moved.bends[:-1]) * T / 2, rel=1e-6, abs=1e-9
    )
    assert not moved.rates[[0, -1]].any()
    assert not moved.bends[[0, -1]].any()
    assert (moved.positions([0.0, moved.duration]) == path[[0, -1]]).all()
    t = dense(moved, 12)
    Q = moved.positions(t)
    assert off_polyline(path, Q[~in_blend(moved, t)]).max() <= 1e-12
    assert (path.min(axis=0) - 1e-15 <= Q).all()
    assert (path.max(axis=0) + 1e-15 >= Q).all()


# -- laws ---------------------------------------------------------------------------------------


@examples(15, 40)
@given(path=paths, velocity=limits, acceleration=limits, jerk=jerks)
def test_stops_at_corners(robot, path, velocity, acceleration, jerk):
    """Within limits and on the path at every time, at rest and without acceleration at each corner."""
    moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration, jerk=jerk)
    assert_lawful(moved, path, velocity, acceleration, jerk)
    assert len(moved.blends) == 0
    assert not moved.velocities(moved.stops).any()
    assert not moved.accelerations(moved.stops).any()
    slower = trajectory(robot, path, velocity=velocity, acceleration=acceleration).duration
    assert moved.duration >= slower * (1 - 1e-9)


@examples(15, 40)
@given(path=paths, velocity=limits, acceleration=limits, jerk=jerks, share=st.floats(0.0, 0.49))
def test_blends_at_corners(robot, alone, path, velocity, acceleration, jerk, share):
    """Blends keep the limits, are never slower than stops, and are proven as the cubics that they are."""
    given_limits = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
    moved = trajectory(robot, path, checker=alone, blend=share, **given_limits)
    assert_lawful(moved, path, velocity, acceleration, jerk)
    assert moved.duration <= trajectory(robot, path, **given_limits).duration * (1 + 1e-9)
    assert len(moved.times) == 1 or moved.certify(alone).verdict == Verdict.FREE


@given(path=paths, velocity=limits, acceleration=limits, jerk=jerks)
@settings(max_examples=20)
def test_limits_in_rational_arithmetic(robot, alone, path, velocity, acceleration, jerk):
    """The cubics that the stored numbers define keep the limits without any rounding."""
    moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration, jerk=jerk, checker=alone)
    exact = [[[Fraction(x) for x in row] for row in array.tolist()] for array in (moved.knots, moved.rates)]
    times = [Fraction(t) for t in moved.times.tolist()]
    for k in range(len(times) - 1):
        T = times[k + 1] - times[k]
        for j in range(3):
            (q0, q1), (v0, v1) = ((array[k][j], array[k + 1][j]) for array in exact)
            cubic, square = (v0 + v1) * T - 2 * (q1 - q0), 3 * (q1 - q0) - (2 * v0 + v1) * T
            assert abs(6 * cubic) <= Fraction(jerk[j]) * T**3
            assert max(abs(2 * square), abs(2 * square + 6 * cubic)) <= Fraction(acceleration[j]) * T**2
            x = -square / (3 * cubic) if cubic else Fraction(0)
            inside = [v0 * T + (2 * square + 3 * cubic * x) * x] if 0 < x < 1 else []
            assert max(abs(v) for v in (v0 * T, v1 * T, *inside)) <= Fraction(velocity[j]) * T


def seven_phases(way, v, a, j):
    """The duration of the fastest motion from rest to rest, as in the literature."""
    edge, up = (math.sqrt(v / j), 2 * math.sqrt(v / j)) if v * j < a * a else (a / j, a / j + v / a)
    if way >= v * up:
        return 2 * up + (way / v - up)
    if way < 2 * a**3 / j**2:
        return 4 * (way / (2 * j)) ** (1 / 3)
    edge = a / j
    return 2 * (edge / 2 + math.sqrt(edge * edge / 4 + way / a))


@given(
    way=st.floats(1e-9, 2.0), velocity=st.floats(0.01, 10.0), acceleration=st.floats(0.01, 100.0),
    jerk=st.floats(0.01, 1e4),
)  # fmt: skip
def test_one_motion_is_optimal(robot, way, velocity, acceleration, jerk):
    """One motion takes the time of the seven phases, but for the shortest phase that rounding permits."""
    moved = trajectory(robot, [[0, 0, 0], [way, 0, 0]], velocity=velocity, acceleration=acceleration, jerk=jerk)
    best = seven_phases(way, velocity, acceleration, jerk)
    shortest = least(np.array([[0, 0, 0], [way, 0, 0]]), {"v": velocity, "a": acceleration, "j": jerk})
    assert best * (1 - 1e-9) <= moved.duration <= best * (1 + 2e-6) + 4 * shortest


CASES = {
    "all limits": (4.0, 1.0, 1.0, 2.0, 4 + 1 + 0.5, 7),
    "no constant acceleration": (4.0, 0.5, 10.0, 2.0, 8 + 1.0, 5),
    "no constant speed": (6.0, 10.0, 1.0, 1.0, 6.0, 6),
    "neither": (2.0, 10.0, 10.0, 1.0, 4.0, 4),
    "a millionth": (1e-6, 10.0, 10.0, 1e3, 4 * (1e-9 / 2) ** (1 / 3), 4),
}


@pytest.mark.parametrize("case", CASES)
def test_phases_of_one_motion(robot, case):
    """Which of the seven phases a motion has depends on the limits that it reaches."""
    way, velocity, acceleration, jerk, seconds, count = CASES[case]
    moved = trajectory(robot, [[0, 0, 0], [way, 0, 0]], velocity=velocity, acceleration=acceleration, jerk=jerk)
    assert moved.duration == pytest.approx(seconds, rel=1e-5)
    assert seven_phases(way, velocity, acceleration, jerk) == pytest.approx(seconds)
    assert len(moved.times) == count + 1


rates = st.floats(1e-3, 1e3)


@given(
    length=st.floats(1e-6, 10.0), gain=rates, jerk=st.one_of(rates, st.just(math.inf)), first=st.floats(0.0, 1.0),
    share=st.floats(0.0, 1.0), least=st.floats(1e-9, 1e-3),
)  # fmt: skip
def test_profiles(length, gain, jerk, first, share, least):
    """Phases cover the length and join the speeds; each keeps the limits, and none is shorter than the least."""
    limits = Limits(gain, jerk, least)
    first = min(first, length / least)
    lowest = 0.0 if ramp_way(0.0, first, limits) <= length else first
    last = min(lowest + share * (reached(length, limits, first) - lowest), length / least)
    assume(ramp_way(min(first, last), max(first, last), limits) <= length)
    speed, acceleration, covered = first, 0.0, 0.0
    for phase in phases(length, limits, first, last):
        assert phase.seconds >= least * (1 - 1e-9)
        assert abs(phase.acceleration) <= gain * (1 + 1e-9)
        assert 0 <= phase.speed <= 1 + 1e-12
        slope = (phase.acceleration - acceleration) / phase.seconds
        assert abs(slope) <= jerk * (1 + 1e-9)
        T = phase.seconds
        assert phase.speed == pytest.approx(speed + (acceleration + phase.acceleration) * T / 2, abs=1e-9)
        assert phase.way == pytest.approx(speed * T + (acceleration / 2 + slope * T / 6) * T * T, rel=1e-6, abs=1e-12)
        speed, acceleration, covered = phase.speed, phase.acceleration, covered + phase.way
    assert (speed, acceleration) == (last, 0.0)
    assert covered == pytest.approx(length, rel=1e-9)


@given(gain=rates, jerk=rates, least=st.floats(1e-9, 1e-1), a=st.floats(0, 1), b=st.floats(0, 1))
def test_ramps_grow(gain, jerk, least, a, b):
    """A larger change of speed takes no less time, which bisection relies on, and none is faster than the limits."""
    limits = Limits(gain, jerk, least)
    small, large = (2 * edge + flat for edge, flat in (ramp(min(a, b), limits), ramp(max(a, b), limits)))
    assert small <= large * (1 + 1e-12)
    fastest = max(a, b) / gain + gain / jerk if max(a, b) >= gain * gain / jerk else 2 * math.sqrt(max(a, b) / jerk)
    assert fastest * (1 - 1e-12) <= large <= fastest + 4 * least


@examples(15, 40)
@given(path=paths, velocity=limits, acceleration=limits, jerk=jerks, more=st.floats(1.0, 5.0), joint=st.integers(0, 2))
def test_monotone_in_limits(robot, path, velocity, acceleration, jerk, more, joint):
    """With stops, a higher limit makes it no slower; scaled limits scale the time."""
    given_limits = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
    needed = trajectory(robot, path, **given_limits).duration
    higher = np.ones(3)
    higher[joint] = more
    for name in given_limits:
        raised = given_limits | {name: given_limits[name] * higher}
        assert trajectory(robot, path, **raised).duration <= needed * (1 + 1e-5) + 4 * len(path) * least(path, raised)
    twice = trajectory(robot, path, velocity=2 * velocity, acceleration=4 * acceleration, jerk=8 * jerk)
    assert twice.duration == pytest.approx(needed / 2, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("checked", [False, True])
def test_without_a_limit_of_jerk_it_is_the_old_one(robot, alone, checked):
    """A jerk limit that is hardly one costs hardly anything; without it nothing changes linearly."""
    path, checker = np.array([[-0.7, 0.1, 0.3], [0.9, -0.2, 0.4], [0.9, 0.8, -1.0]]), alone if checked else None
    jumps = trajectory(robot, path, velocity=1.0, acceleration=2.0, checker=checker)
    assert jumps.bends is None
    smooth = trajectory(robot, path, velocity=1.0, acceleration=2.0, jerk=1e9, checker=checker)
    assert smooth.duration == pytest.approx(jumps.duration, rel=1e-3)
    assert smooth.duration > jumps.duration


def test_corner_in_closed_form(robot, alone):
    """A right angle at full speed all the way: half the blend takes as long as the acceleration and jerk need."""
    path = [[-1, 0, 0], [0, 0, 0], [0, 1, 0]]
    moved = trajectory(robot, path, velocity=1.0, acceleration=5.0, jerk=50.0, checker=alone)
    assert len(moved.stops) == 0
    ((begin, end),) = moved.blends
    assert end - begin == pytest.approx(0.3, rel=1e-5)
    assert moved.duration == pytest.approx(2 * (0.3 + 0.7) + 0.3, rel=1e-5)
    assert np.abs(moved.accelerations((begin + end) / 2)[:2]) == pytest.approx([5.0, 5.0], rel=1e-5)


def test_reversal(robot, alone):
    """A path that turns back is followed; the instant of rest within its blend is no stop."""
    path = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0]], dtype=float)
    moved = trajectory(robot, path, velocity=1.0, acceleration=20.0, jerk=10.0, checker=alone)
    assert len(moved.blends) == 1
    assert len(moved.stops) == 0
    assert off_polyline(path, moved.positions(dense(moved))).max() <= 1e-12


def test_rows_on_a_straight_are_one_motion(robot):
    """A path that was divided, or holds rows twice, is the same trajectory as without."""
    ends = np.array([[-0.7, 0.1, 0.3], [0.9, -0.2, 0.4], [0.9, 0.8, -1.0]])
    rows = np.concatenate([np.linspace(a, b, 9) for a, b in zip(ends[:-1], ends[1:], strict=True)])
    whole, divided = (trajectory(robot, q, velocity=1.0, acceleration=2.0, jerk=9.0) for q in (ends, rows))
    assert divided.duration == pytest.approx(whole.duration, rel=1e-12)
    assert len(divided.stops) == 1


def test_nowhere_to_go(robot, alone):
    """A path that stays is a trajectory of no duration, which can be evaluated, sampled and saved."""
    moved = trajectory(robot, [[0.1, 0.2, 0.3]] * 3, jerk=1.0, checker=alone)
    assert moved.duration == 0.0
    times, Q, V, A = moved.sample(100.0, full=True)
    assert (times == [0.0]).all()
    assert (Q == [[0.1, 0.2, 0.3]]).all()
    assert not V.any()
    assert not A.any()


def test_motions_of_very_different_lengths(robot, alone):
    """Motions shorter than the last digit of the others leave times that increase, limits kept, and both ends."""
    path = np.array([[-1, 0, 0], [1, 0, 0], [1, 1e-40, 0], [1, -1e-60, 0], [0.5, 0, 0], [0.5, 0, 1e-12]])
    for checker in (None, alone):
        moved = trajectory(robot, path, velocity=1.0, acceleration=1e3, jerk=1e5, checker=checker)
        assert (np.diff(moved.times) > 0).all()
        assert_lawful(moved, path, 1.0, 1e3, 1e5)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_joints_far_from_zero(robot):
    """A joint with a large value has longer phases, since its positions are less accurate; limits are kept."""
    path = np.array([[0, 0, 1e6], [0.5, 0, 1e6 + 1], [0, 0.5, 1e6]])
    moved = trajectory(robot, path, velocity=1.0, acceleration=10.0, jerk=1e3)
    for found, limit in zip(extremes(moved.times, moved.knots, moved.rates), (1.0, 10.0, 1e3), strict=True):
        assert (found <= limit).all()


def test_short_motions_between_blends(robot, alone):
    """What blends leave of short motions is passed so slowly that it takes no less than the shortest phase."""
    path = 1e-3 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0], [2, 2, 0]]) + [10.0, 0.0, 0.0]
    given_limits = {"velocity": np.full(3, 10.0), "acceleration": np.full(3, 1e6), "jerk": np.full(3, 1e10)}
    moved = trajectory(robot, path, checker=alone, blend=0.49, **given_limits)
    assert len(moved.blends) == 3
    assert np.diff(moved.times).min() >= least(path, given_limits) * (1 - 1e-9)
    for found, limit in zip(extremes(moved.times, moved.knots, moved.rates), given_limits.values(), strict=True):
        assert (found <= limit).all()


def test_long_trajectories_of_short_motions(robot):
    """Late in a long trajectory times are less accurate, and limits are kept nevertheless."""
    path = np.zeros((3001, 3))
    path[1::2, 0] = 1e-3
    moved = trajectory(robot, path, velocity=1.0, acceleration=1e4, jerk=1e14)
    for found, limit in zip(extremes(moved.times, moved.knots, moved.rates), (1.0, 1e4, 1e14), strict=True):
        assert (found <= limit).all()


def test_courses_are_the_trajectory(robot, smooth):
    """What is proven, piece by piece, are the positions that are computed."""
    curve, s = curve_of(robot, smooth, "curve"), np.linspace(0, 1, 7)
    for k, course in enumerate(curve.courses):
        t = smooth.times[k] + s * (smooth.times[k + 1] - smooth.times[k])
        values = configurations(robot, np.broadcast_to(course, (7, *course.shape)), s)
        assert values == pytest.approx(smooth.positions(np.minimum(t, smooth.duration)), abs=1e-14)


def test_limits_that_are_never_reached(robot, alone):
    """Very high limits of velocity or acceleration make no difference."""
    path = [[0, 0, 0], [0.5, 0, 1], [0.5, 0.5, 0]]
    for checker, unequal in ((None, [1e3, 1e90, 1e80]), (alone, 1e80)):
        expected = trajectory(robot, path, velocity=1e3, acceleration=1e3, jerk=10.0, checker=checker)
        for velocity, acceleration in ((1e12, 1e3), (1e3, 1e12), (1e12, 1e12), (unequal, 1e3)):
            moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration, jerk=10.0, checker=checker)
            assert moved.duration == pytest.approx(expected.duration, rel=1e-4)


@pytest.mark.parametrize(("velocity", "jerk"), [(1.0, 5e-324), (1.0, 1e-250)])
def test_jerk_out_of_range(robot, velocity, jerk):
    """Limits that no time can be computed from are refused."""
    with pytest.raises(InputError, match="jerk"):
        trajectory(robot, [[0, 0, 0], [1, 1, 0]], velocity=velocity, acceleration=1.0, jerk=jerk)


# -- proven blends ------------------------------------------------------------------------------


def test_blends_of_an_arm(rng):
    """No blend of a Panda that is proven collides at one of 1,000 samples; most of the others do."""
    arm = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    checker = CollisionChecker(arm, ring(rng, 14, 0.3, 0.9, 0.2))
    first = free_configurations(checker, 120)
    corner = steps(arm, rng, first, 0.4)
    judge, s = Judge.of(checker, 0.0), np.linspace(0, 1, 1000)
    free, hit = [], []
    for rows in np.stack([first, corner, steps(arm, rng, corner, 0.4)], axis=1):
        moved = JerkLimited.of(rows, np.full(8, 2.0), np.full(8, 3.0), np.full(8, 40.0))
        half = np.minimum(moved.wanted, 0.49 * moved.straights.lengths.min())
        free.append(judge.proven(moved.courses(half)[0]).all())
        knots, ways, shares = (array[0] for array in moved._bends(half))
        curve = CubicHermiteSpline(np.append(0.0, np.cumsum(shares + 1e-300)), knots, ways)
        hit.append(checker.collide(curve(s)).any())
    free, hit = np.array(free), np.array(hit)
    assert hit.any()
    assert not (free & hit).any()
    assert free.sum() >= 0.9 * (~hit).sum()


def test_path_of_a_planner(robot):
    """What `plan` returns is followed in less time than with stops, and proven again as a curve."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    checker = CollisionChecker(robot, scene)
    path = plan(checker, [-0.5, -0.5, np.pi / 2], [0.5, -0.5, np.pi / 2], joints="slide")
    moved = trajectory(robot, path, velocity=1.0, jerk=10.0, checker=checker)
    assert len(moved.blends) > 0
    assert moved.duration < trajectory(robot, path, velocity=1.0, jerk=10.0).duration
    assert moved.certify(checker).verdict == Verdict.FREE
    assert_lawful(moved, path, 1.0, 1.0, 10.0)


# -- samples, files and controllers -------------------------------------------------------------


@pytest.fixture
def smooth(robot, alone):
    """A trajectory with a stop and a blend."""
    path = [[0, 0, 0], [0.5, 0, 1], [0.5, 0.5, 0], [0.5, 0.5, 0.9]]
    return trajectory(robot, path, velocity=1.0, acceleration=3.0, jerk=20.0, checker=alone, blend=0.2)


@pytest.fixture
def jumping(robot, alone):
    """The same without a limit of jerk."""
    path = [[0, 0, 0], [0.5, 0, 1], [0.5, 0.5, 0], [0.5, 0.5, 0.9]]
    return trajectory(robot, path, velocity=1.0, acceleration=3.0, checker=alone, blend=0.2)


def test_rates_are_derivatives(smooth):
    """Velocities and accelerations are the derivatives of positions."""
    t = np.sort(np.random.default_rng(0).uniform(1e-3, smooth.duration - 1e-3, 200))
    e = 1e-5
    slopes = (smooth.positions(t + e) - smooth.positions(t - e)) / (2 * e)
    assert smooth.velocities(t) == pytest.approx(slopes, abs=1e-6)
    slopes = (smooth.velocities(t + e) - smooth.velocities(t - e)) / (2 * e)
    assert smooth.accelerations(t) == pytest.approx(slopes, abs=1e-3)
    assert smooth.accelerations(t[:2].reshape(2, 1)).shape == (2, 1, 3)


def test_full_samples(smooth, jumping):
    """Full samples hold the arrays of the three methods, the end included."""
    for moved in (smooth, jumping):
        times, *arrays_found = moved.sample(50.0, full=True)
        assert times[-1] == moved.duration
        for found, method in zip(arrays_found, (moved.positions, moved.velocities, moved.accelerations), strict=True):
            assert (found == method(times)).all()
        assert len(moved.sample(50.0)) == 2
    with pytest.raises(InputError, match="full"):
        smooth.sample(50.0, full=1)


@pytest.mark.parametrize("ending", [".csv", ".json"])
@pytest.mark.parametrize("rate", [None, 7.0])
@examples(4, 10)
@given(path=paths, velocity=limits, acceleration=limits, jerk=jerks)
def test_files_hold_all(robot, alone, tmp_path_factory, ending, rate, path, velocity, acceleration, jerk):
    """A file is the trajectory again, bit for bit if no rows were added."""
    moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration, jerk=jerk, checker=alone)
    name = tmp_path_factory.mktemp("files") / f"moved{ending}"
    moved.save(name, rate=rate)
    read = Trajectory.load(name)
    t = dense(moved, 5)
    assert read.positions(t) == pytest.approx(moved.positions(t), abs=1e-12)
    assert read.accelerations(t) == pytest.approx(moved.accelerations(t), rel=1e-6, abs=1e-6)
    assert read.stops == pytest.approx(moved.stops)
    assert read.blends == pytest.approx(moved.blends)
    if rate is None:
        assert (read.bends == moved.bends).all()
        assert (read.knots == moved.knots).all()


@pytest.mark.parametrize("ending", [".csv", ".json"])
def test_accelerations_of_a_file_are_checked(smooth, tmp_path, ending):
    """A file is refused if its accelerations do not belong to its velocities, or its positions to both."""
    name = tmp_path / f"moved{ending}"
    for changed in (
        replace(smooth, bends=smooth.bends * (1 + 1e-6)),
        replace(smooth, rates=np.where(smooth.rates == smooth.rates.max(), smooth.rates * (1 + 1e-6), smooth.rates)),
        replace(smooth, knots=smooth.knots * (1 + 1e-6)),
    ):
        changed.save(name)
        with pytest.raises(FileError, match="accelerations that change linearly between rows"):
            Trajectory.load(name)
    replace(smooth, bends=None).save(name)
    with pytest.raises(FileError, match="constant accelerations"):
        Trajectory.load(name)
    smooth.save(name)
    text = name.read_text()
    name.write_text(text.replace("accelerations", "pushes").replace("turn acceleration", "turn jerk"))
    with pytest.raises(FileError):
        Trajectory.load(name)


def test_messages(smooth, jumping, tmp_path):
    """JSON and YAML messages have the same points; only continuous accelerations are written."""
    for moved, kind in ((smooth, "quintic"), (jumping, "cubic")):
        moved.save(tmp_path / "a.yaml", rate=10.0)
        moved.save(tmp_path / "a.json", rate=10.0, message=True)
        one, other = (ControllerPoints.load(tmp_path / name) for name in ("a.yaml", "a.json"))
        assert kind in repr(one)
        assert repr(one) == repr(other)
        for name in ("times", "positions", "velocities"):
            assert (getattr(one, name) == getattr(other, name)).all()
    held = json.loads((tmp_path / "a.json").read_text())
    assert list(held) == ["joint_names", "points"]
    assert held["points"][0]["time_from_start"] == {"sec": 0, "nanosec": 0}
    smooth.save(tmp_path / "b.json")
    assert (ControllerPoints.load(tmp_path / "b.json").accelerations == smooth.bends).all()
    for name, message in (("a.csv", True), ("a.json", "yes")):
        with pytest.raises(InputError, match="message"):
            smooth.save(tmp_path / name, message=message)


def test_which_controllers_follow(smooth, jumping):
    """Cubics through the knots are the trajectory; quintics only if accelerations are continuous; chords never."""
    for moved in (smooth, jumping):
        t = dense(moved, 9)
        Q, A = moved.positions(t), moved.accelerations(moved.times)
        cubic = CubicHermiteSpline(moved.times, moved.knots, moved.rates)
        data = np.stack([moved.knots, moved.rates, A], axis=1)
        quintic = BPoly.from_derivatives(moved.times, data)
        assert np.abs(cubic(t) - Q).max() <= 1e-12
        assert (np.abs(quintic(t) - Q).max() <= 1e-12) == (moved is smooth)
        assert np.abs(np.stack([np.interp(t, moved.times, q) for q in moved.knots.T], axis=1) - Q).max() > 1e-3


# -- limits from files --------------------------------------------------------------------------

MOVEIT = """
default_velocity_scaling_factor: 0.1
default_acceleration_scaling_factor: 0.5
joint_limits:
  x: {has_velocity_limits: true, max_velocity: 2.0, has_acceleration_limits: true, max_acceleration: 4, max_effort: 9}
  y: {has_velocity_limits: false, max_velocity: 2.0, has_jerk_limits: true, max_jerk: 30.0, has_position_limits: false}
  turn: {max_velocity: 1, max_acceleration: 5, has_deceleration_limits: true, max_deceleration: 3, max_position: 6}
"""


def read_limits(folder, text, robot, **options):
    name = folder / "joint_limits.yaml"
    name.write_text(text)
    return JointLimits.load(name, robot, **options)


def test_limits_of_moveit(robot, tmp_path):
    """Each limit is the file's, none if the file says so, and otherwise the URDF's."""
    found = read_limits(tmp_path, MOVEIT, robot)
    assert found.names == robot.configuration_names
    assert found.velocity.tolist() == [2.0, np.inf, 1.0]
    assert found.acceleration.tolist() == [4.0, np.inf, 3.0]
    assert found.jerk.tolist() == [np.inf, 30.0, np.inf]
    assert found.lower.tolist() == [-1.0, -np.inf, -np.inf]
    assert found.upper.tolist() == [1.0, np.inf, 6.0]
    scaled = read_limits(tmp_path, MOVEIT, robot, scaled=True)
    assert scaled.velocity == pytest.approx([0.2, np.inf, 0.1])
    assert scaled.acceleration.tolist() == [2.0, np.inf, 1.5]
    assert scaled.jerk.tolist() == found.jerk.tolist()
    inside = "".join(f"    {line}\n" for line in MOVEIT.splitlines())
    nested = read_limits(tmp_path, f"/**:\n  ros__parameters:\n   robot_description_planning:\n{inside}", robot)
    assert nested.velocity.tolist() == found.velocity.tolist()


def test_limits_of_mimics(tmp_path):
    """A joint that mimics another bounds the rates of the other, by the factor between them."""
    fingers = written(tmp_path, FINGERS.replace('multiplier="-1"', 'multiplier="-2"'))
    ((mimic, (leader, factor)),) = fingers.mimics.items()
    assert factor == -2
    text = "joint_limits: {%s: {max_velocity: 3}, %s: {max_velocity: 4, max_jerk: 9, max_position: 0}}"
    with pytest.warns(UserWarning, match=f"not read: positions of joints that mimic others, {mimic};"):
        found = read_limits(tmp_path, text % (leader, mimic), fingers)
    assert found.velocity.tolist() == [2.0]
    assert found.jerk.tolist() == [4.5]
    assert found.upper.tolist() == fingers.upper.tolist()


def test_limits_are_kept(robot, alone, tmp_path):
    """A trajectory keeps a file's limits; joints without one of acceleration take a second, and of jerk have none."""
    found = read_limits(tmp_path, MOVEIT.replace("has_velocity_limits: false", "has_velocity_limits: true"), robot)
    path = np.array([[0, 0, 0], [0.5, 0.2, 1], [0.5, 0.8, 0]])
    moved = trajectory(robot, path, limits=found, checker=alone)
    assert_lawful(moved, path, found.velocity, [4.0, 2.0, 3.0], found.jerk)
    assert trajectory(robot, path, limits=found, jerk=1.0).duration > moved.duration
    only = trajectory(robot, [[0, 0, 0], [1, 0, 0]], limits=found)  # this joint has no limit of jerk
    assert only.bends is None
    assert np.abs(only.accelerations(0.0)).max() == 4.0
    for fastest in limits_of(robot, path, found, 0.5, 2.0, 8.0):
        assert np.isfinite(fastest).all()


def test_limits_that_are_none(robot, tmp_path):
    """A joint without a velocity limit is named; limits of another robot, and other things, are refused."""
    found = read_limits(tmp_path, MOVEIT, robot)
    path = np.array([[0.0, 0, 0], [0, 1, 0]])
    with pytest.raises(InputError, match="velocity: .* found none above 0 in the URDF or in limits= for y"):
        trajectory(robot, path, limits=found)
    with pytest.raises(InputError, match="velocity: .* found none above 0 in the URDF for y"):
        trajectory(robot, path)
    limited = replace(robot, velocity=np.ones(3))
    with pytest.raises(InputError, match=r"velocity: .* whose file removed .* \(has_velocity_limits: false\), for y"):
        limits_of(limited, path, found, None, None, None)
    for bad in ("limits", 3, replace(found, names=("a", "b", "c"))):
        with pytest.raises(InputError, match="limits"):
            trajectory(robot, [[0, 0, 0], [1, 0, 0]], velocity=1.0, limits=bad)


BAD = {
    "joint_limits: {x: {max_velocity: 0}}": "x/max_velocity: expected a number > 0",
    "joint_limits: {x: {max_acceleration: -1}}": "x/max_acceleration: expected a number > 0",
    "joint_limits: {x: {max_jerk: .nan}}": "x/max_jerk: expected a finite number",
    "joint_limits: {x: {max_jerk: fast}}": "x/max_jerk: expected a finite number",
    "joint_limits: {x: {max_jerk: true}}": "x/max_jerk: expected a finite number",
    "joint_limits: {x: {has_jerk_limits: true}}": "x: expected max_jerk",
    "joint_limits: {x: {has_jerk_limits: 1, max_jerk: 2}}": "x/has_jerk_limits: expected true or false",
    "joint_limits: {x: {min_position: 2, max_position: 1}}": "min_position <= max_position",
    "joint_limits: {x: 3}": "x: expected a mapping",
    "joint_limits: 3": "joint_limits",
    "joint_limits: {x: {}}": "x: expected limits",
    "joint_limits: {x: {max_velocty: 1}}": "x/max_velocty: key: .*did you mean 'max_velocity'",
    "joint_limits: {x: {1: 1}}": "x/1: key: .* found '1'",
    "joint_limits: {x: {max_velocity: 1,\n max_velocity: 2}}": ", line 2: joint_limits/x: .* once .*'max_velocity'",
    "joint_limits: {x: {max_velocity: 1}, x: {max_velocity: 2}}": ", line 1: joint_limits: .* once .*'x' again",
    "joint_limits:\n  x: {max_velocity: 1}\njoint_limits: {}": ", line 3: expected each key once .*'joint_limits'",
    "limits: {x: {}}": "joint_limits",
    "[]": "expected the key joint_limits",
    "": "found an empty file",
    "joint_limits: {x: {max_velocity: 010}}": "octal in YAML 1.1, found 010",
    "joint_limits: {x: {max_velocity: 1_0}}": "expected a finite number, found '1_0'",
    "joint_limits: {x: {max_velocity: '1'}}": "expected a finite number, found '1'",
    "{a: {joint_limits: {x: {max_jerk: 1}}}, b: {joint_limits: {x: {max_jerk: 2}}}}": "joint once",
    "{default_velocity_scaling_factor: 0.5, a: {joint_limits: {x: {max_velocity: 1}}}}": "beside joint_limits",
    "joint_limits: {x: {has_soft_limits: true}}": "expected soft_lower_limit with has_soft_limits, found none",
    "joint_limits: {x: {max_velocity: 1}": "expected YAML",
    "{default_velocity_scaling_factor: 0, joint_limits: {}}": "default_velocity_scaling_factor",
    "{default_velocity_scaling_factor: -1, joint_limits: {}}": "default_velocity_scaling_factor",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_limits(robot, tmp_path, text):
    """A malformed file is refused by its name, and by the joint and the key."""
    with pytest.raises(FileError, match=f"joint_limits.yaml.*{BAD[text]}"):
        read_limits(tmp_path, text, robot)


def test_merged_keys_are_not_repeated_ones(robot, tmp_path):
    """A mapping may take keys from another and give one of them a new value (`<<` in YAML)."""
    text = "joint_limits:\n  x: &a {max_velocity: 1, max_jerk: 2}\n  y: {<<: *a, max_jerk: 3}\n"
    found = read_limits(tmp_path, text, robot)
    assert [found.jerk[robot.configuration_names.index(joint)] for joint in "xy"] == [2.0, 3.0]


def test_soft_limits_narrow_and_those_of_mimics_do_not_widen(robot, tmp_path):
    """Soft limits beyond the URDF's change nothing, and a mimic's entry leaves the joint that it follows its own."""
    text = "joint_limits: {x: {has_soft_limits: true, soft_lower_limit: -1.0e+3, soft_upper_limit: 0.125}}"
    found = read_limits(tmp_path, text, robot)
    k = robot.configuration_names.index("x")
    assert (found.lower[k], found.upper[k]) == (robot.lower[k], 0.125)
    fingers = replace(written(tmp_path, FINGERS), velocity=np.array([1.0]))
    ((mimic, _),) = fingers.mimics.items()
    for entry in ("max_velocity: 10000", "has_velocity_limits: false"):
        found = read_limits(tmp_path, f"joint_limits: {{{mimic}: {{{entry}}}}}", fingers)
        assert found.velocity.tolist() == fingers.velocity.tolist()


@pytest.mark.parametrize(
    "text",
    [
        "w: &a {b: *a, c: 1}",
        "a: &a {? [1] : 2}\nb: {<<: *a}",
        "p: {joint_limits: {x: {max_velocity: 1}}}\na0: &a0 {x: 1}\n"
        + "".join(f"a{k}: &a{k} {{x: *a{k - 1}, y: *a{k - 1}}}\n" for k in range(1, 25)),
        "a0: &a0 {joint_limits: {x: {max_velocity: no}}}\n"
        + "".join(f"a{k}: &a{k} {{x: *a{k - 1}}}\n" for k in range(1, 3000)),
    ],
)
@pytest.mark.filterwarnings("ignore:.*not read, since they are no limits")
def test_aliases_end(robot, tmp_path, text):
    """An alias within itself, keys that are lists, and aliases of aliases are read or refused, and soon."""
    with contextlib.suppress(FileError):
        read_limits(tmp_path, text, robot)


def test_merges_of_merges(robot, tmp_path):
    """A mapping that takes keys from one that takes keys, at two places."""
    text = "joint_limits:\n  x: &a {max_velocity: 1}\n  y: &b {<<: *a, max_jerk: 2}\n  turn: {<<: *b}\n"
    found = read_limits(tmp_path, text, robot)
    assert found.velocity.tolist() == [1.0, 1.0, 1.0]


def test_limits_of_unknown_joints(robot, tmp_path):
    """Joints that the robot lacks are refused, with the file and the joints that the robot has."""
    message = r"joint_limits.yaml: .*expected one of x, y, turn; found 'turns' \(did you mean 'turn'\?\)"
    with pytest.raises(UnknownNameError, match=message + "$"):
        read_limits(tmp_path, "joint_limits: {turns: {max_velocity: 1}}", robot)
    with pytest.raises(UnknownNameError, match=message + "; also unknown: 'z', '7'$"):
        read_limits(tmp_path, "joint_limits: {turns: {max_velocity: 1}, x: {max_velocity: 1}, z: {}, 7: {}}", robot)
    with pytest.raises(FileError, match="missing"):
        JointLimits.load(tmp_path / "missing.yaml", robot)
    with pytest.raises(InputError, match="robot"):
        JointLimits.load(tmp_path / "missing.yaml", "panda")


def test_limits_in_degrees(robot, tmp_path, recwarn):
    """Limits of a turning joint that are probably in degrees cause one warning; those of slides and usual ones none."""
    message = r"joint_limits.yaml: turn: expected limits in radians, found -180 \.\. 180; .* \(1 more like it\)"
    with pytest.warns(UserWarning, match=message):
        read_limits(tmp_path, "joint_limits: {turn: {min_position: -180, max_position: 180, max_velocity: 180}}", robot)
    with pytest.warns(UserWarning, match="turn: expected radians per second, found 180; is it in degrees"):
        read_limits(tmp_path, "joint_limits: {turn: {max_velocity: 180}}", robot)
    recwarn.clear()
    plain = "max_position: 6.28, min_position: -12.5, max_velocity: 49"
    none = "has_velocity_limits: false, has_position_limits: false, max_velocity: 180, max_position: 180"
    huge = "max_velocity: 1.0e+6, max_position: 1.0e+16"
    for entry in (plain, none, huge):
        slide = "max_velocity: 180, max_position: 180"
        read_limits(tmp_path, f"joint_limits: {{turn: {{{entry}}}, x: {{{slide}}}}}", robot)
    assert not recwarn.list


def test_scaling_factors(robot, tmp_path):
    """A factor above 1 is refused where it is used; 1 is allowed."""
    for kind in ("velocity", "acceleration"):
        text = f"{{default_{kind}_scaling_factor: %s, joint_limits: {{x: {{max_velocity: 2}}}}}}"
        assert read_limits(tmp_path, text % 1.5, robot).velocity[0] == 2.0
        assert read_limits(tmp_path, text % 1, robot, scaled=True).velocity[0] == 2.0
        with pytest.raises(
            FileError, match=f"joint_limits.yaml, line 1: default_{kind}_scaling_factor: expected .* at most 1"
        ):
            read_limits(tmp_path, text % 1.5, robot, scaled=True)


def test_paths_outside_limits(robot, alone, tmp_path):
    """A path outside a file's limits of position is refused with joint, value and limits, and one on them is not."""
    found = read_limits(tmp_path, "joint_limits: {y: {max_velocity: 1, min_position: -0.25, max_position: 0.5}}", robot)
    inside = [[0, 0, 0], [0.5, 0.5, 0.0], [0.0, -0.25, 0.0]]
    moved = trajectory(robot, inside, velocity=1.0, limits=found, checker=alone)
    assert len(moved.blends) == 1
    Q = moved.positions(dense(moved, 9))
    assert np.maximum(found.lower - Q, Q - found.upper).max() <= 1e-12
    for beyond, value in ((0.6, "0.6"), (-0.3, "-0.3")):
        path = [[0, 0, 0], [0.5, beyond, 0.0], [0.0, 0.0, 0.0]]
        with pytest.raises(InputError, match=rf"path: .* found y = {value} outside -0.25 \.\. 0.5"):
            trajectory(robot, path, velocity=1.0, limits=found)
        trajectory(robot, path, velocity=1.0)
