"""Trajectories: on the path that was proven, within limits at every time, as fast as they allow; and files of them."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from families import translation
from gantry import RADIUS, UP, gantry, gantry_robot
from loewner import Body, CollisionChecker, FileError, InputError, PlanningError, Robot, Scene, Verdict, planners
from loewner.planners import Trajectory, trajectories, trajectory
from loewner.planners.judge import Judge
from loewner.planners.straights import Straights
from motion_oracle import AFLOAT, FINGERS, example, free_configurations, ring, steps, written
from sampling import examples

# What is promised of limits: beyond the last digits only where a phase is so short that times round.
OF_VELOCITY, OF_ACCELERATION = 1e-9, 1e-6

values = st.floats(-1.0, 1.0).map(lambda x: round(x, 3))
paths = st.integers(2, 7).flatmap(lambda k: arrays(np.float64, (k, 3), elements=values))
limits = arrays(np.float64, 3, elements=st.floats(0.05, 20.0))


@pytest.fixture
def moved(robot):
    """A trajectory with one stop."""
    return trajectory(robot, [[0, 0, 0], [0.5, 0, 1], [0.5, 0.5, 0]], velocity=1.0, acceleration=3.0)


def dense(moved, between=40):
    """Times all over a trajectory, those at which accelerations jump and the next ones among them."""
    steps = np.linspace(moved.times[:-1], moved.times[1:], between, axis=1).ravel() if len(moved.times) > 1 else [0.0]
    return np.unique(np.append(steps, moved.times))


def off_polyline(path, points):
    """How far points are from a polyline."""
    best, block = np.full(len(points), np.inf), max(1, 2**15 // max(1, len(points)))
    for first in range(0, len(path) - 1, block):
        corners = np.asarray(path[first : first + block + 1], dtype=float)
        a, way = corners[:-1, None], np.diff(corners, axis=0)[:, None]
        squared = (way * way).sum(axis=2)
        s = np.clip(((points - a) * way).sum(axis=2) / np.where(squared > 0, squared, 1.0), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + s[..., None] * way - points, axis=2).min(axis=0))
    return best


def in_blend(moved, t):
    """Which times are inside a blend."""
    return np.any([(t > a) & (t < b) for a, b in moved.blends], axis=0) if len(moved.blends) else np.zeros(len(t), bool)


def assert_lawful(moved, path, velocity, acceleration):
    """Limits, ends, rest, smoothness, and the path wherever no corner is cut."""
    t = dense(moved)
    Q = moved.positions(t)
    assert (np.abs(moved.velocities(t)) <= velocity * (1 + OF_VELOCITY)).all()
    assert (np.abs(moved.accelerations(t)) <= acceleration * (1 + OF_ACCELERATION)).all()
    assert (moved.positions(0.0) == path[0]).all()
    assert (moved.positions(moved.duration) == path[-1]).all()
    assert not moved.velocities([0.0, moved.duration]).any()
    assert off_polyline(path, Q[~in_blend(moved, t)]).max() <= 1e-12
    assert (path.min(axis=0) - 1e-15 <= Q).all()
    assert (path.max(axis=0) + 1e-15 >= Q).all()
    # Velocities are what positions change by.
    T, rates = np.diff(moved.times)[:, None], moved.rates
    assert np.abs(np.diff(moved.knots, axis=0) - T * (rates[1:] + rates[:-1]) / 2).max(initial=0.0) <= 1e-12


# -- laws ---------------------------------------------------------------------------------------


@given(path=paths, velocity=limits, acceleration=limits)
def test_stops_at_corners(robot, path, velocity, acceleration):
    """Within limits and exactly on the path at every time, from rest to rest."""
    moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration)
    assert_lawful(moved, path, velocity, acceleration)
    assert len(moved.blends) == 0
    assert not moved.velocities(moved.stops).any()


@given(path=paths, velocity=limits, acceleration=limits, share=st.floats(0.0, 0.49))
def test_blends_at_corners(robot, alone, path, velocity, acceleration, share):
    """Blends keep the limits, and are never slower than stops."""
    moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration, checker=alone, blend=share)
    assert_lawful(moved, path, velocity, acceleration)
    stopping = trajectory(robot, path, velocity=velocity, acceleration=acceleration)
    assert moved.duration <= stopping.duration * (1 + 1e-9)


@given(way=st.floats(1e-3, 2.0), velocity=st.floats(0.01, 10.0), acceleration=st.floats(0.01, 100.0))
def test_one_motion_is_optimal(robot, way, velocity, acceleration):
    """One motion takes the time of the trapezoid, or of the triangle, in closed form."""
    moved = trajectory(robot, [[-1, 0, 0], [way - 1, 0, 0]], velocity=velocity, acceleration=acceleration)
    way = way - 1 + 1  # as it is in floating point
    ramp = velocity / acceleration
    best = way / velocity + ramp if way >= velocity * ramp else 2 * math.sqrt(way / acceleration)
    assert moved.duration == pytest.approx(best, rel=1e-6)
    assert moved.duration >= best * (1 - 1e-9)


@given(path=paths, velocity=limits, acceleration=limits, more=st.floats(1.0, 5.0), joint=st.integers(0, 2))
def test_monotone_in_limits(robot, path, velocity, acceleration, more, joint):
    """With stops at corners, a higher limit never makes it slower; twice the speed and four times the rest is half."""
    needed = trajectory(robot, path, velocity=velocity, acceleration=acceleration).duration
    higher = np.ones(3)
    higher[joint] = more
    for factors in ((higher, 1.0), (1.0, higher)):
        faster = trajectory(robot, path, velocity=velocity * factors[0], acceleration=acceleration * factors[1])
        assert faster.duration <= needed * (1 + 1e-6)
    twice = trajectory(robot, path, velocity=2 * velocity, acceleration=4 * acceleration)
    assert twice.duration == pytest.approx(needed / 2, rel=1e-9, abs=1e-12)


def test_corner_in_closed_form(robot, alone):
    """A right angle at full speed all the way: the blend is as large as the acceleration asks for."""
    moved = trajectory(robot, [[-1, 0, 0], [0, 0, 0], [0, 1, 0]], velocity=1.0, acceleration=5.0, checker=alone)
    assert len(moved.stops) == 0
    # A ramp at each end; half a blend takes v / 2a, as does the way to the corner.
    assert moved.duration == pytest.approx(2 * (1 / 5 + 0.9 - 0.1) + 0.2, rel=1e-9)
    ((begin, end),) = moved.blends
    assert end - begin == pytest.approx(0.2)
    assert np.abs(moved.accelerations((begin + end) / 2)[:2]) == pytest.approx([5.0, 5.0])


def test_reversal(robot, alone):
    """A path that turns back on itself is followed, and its blend stays on it."""
    path = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0]], dtype=float)
    moved = trajectory(robot, path, velocity=1.0, acceleration=2.0, checker=alone)
    assert off_polyline(path, moved.positions(dense(moved))).max() <= 1e-12


def test_rows_on_a_straight_are_one_motion(robot):
    """A path that was divided, or holds rows twice, is the same trajectory as without."""
    ends = np.array([[-0.7, 0.1, 0.3], [0.9, -0.2, 0.4], [0.9, 0.8, -1.0]])
    whole = trajectory(robot, ends, velocity=1.0, acceleration=2.0)
    rows = np.concatenate([np.linspace(a, b, 9) for a, b in zip(ends[:-1], ends[1:], strict=True)])
    divided = trajectory(robot, rows, velocity=1.0, acceleration=2.0)
    assert divided.duration == pytest.approx(whole.duration, rel=1e-12)
    assert len(divided.stops) == 1
    back = trajectory(robot, [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], velocity=1.0, acceleration=2.0)
    assert len(back.stops) == 1  # straight, but not on


def test_nowhere_to_go(robot, alone):
    """A path that stays is a trajectory of no duration, which can be asked and sampled."""
    moved = trajectory(robot, [[0.1, 0.2, 0.3]] * 3, checker=alone)
    assert moved.duration == 0.0
    assert (moved.positions([0.0, 0.0]) == [[0.1, 0.2, 0.3]] * 2).all()
    assert not moved.velocities(0.0).any()
    assert not moved.accelerations(0.0).any()
    times, Q = moved.sample(100.0)
    assert (times == [0.0]).all()
    assert (Q == [[0.1, 0.2, 0.3]]).all()


def test_many_rows_on_a_straight(robot):
    """However finely a motion is divided, it is one."""
    rows = np.linspace([-0.3, 0.1, 0.7], [0.9, -0.2, 0.4], 3000)
    assert len(trajectory(robot, rows, velocity=1.0).stops) == 0


def test_rows_next_to_each_other(robot):
    """Motions that take less than the last digit of the time leave times that increase, and both ends as they are."""
    path = np.array([[-1, 0, 0], [1, 0, 0], [1, 1e-40, 0], [1, -1e-60, 0], [0.5, 0, 0], [0.5, 0, 1e-50]])
    moved = trajectory(robot, path, velocity=1.0, acceleration=1e3)
    assert (np.diff(moved.times) > 0).all()
    assert (moved.positions([0.0, moved.duration]) == path[[0, -1]]).all()


def test_only_joints_that_move_need_limits(robot):
    """What stands still takes no part in the limits."""
    moved = trajectory(robot, [[0, 0, 0], [1, 0, 0]], velocity=[1.0, 1e-3, 1e-3], acceleration=[1.0, 1e-3, 1e-3])
    assert moved.duration == pytest.approx(2.0)


# -- proven blends ------------------------------------------------------------------------------


def around(robot, *plates):
    """The ball alone, with thin plates: (x, y, angle)."""
    scene = Scene()
    for k, (x, y, angle) in enumerate(plates):
        T = translation(x, y)
        T[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        scene.add(f"plate {k}", Body.box([1e-4, 0.3, 0.3]), T)
    return CollisionChecker(replace(robot, bodies={"ball": Body.sphere(RADIUS)}), scene)


FIRST, CORNER, LAST = np.array([[-0.4, 0, 0]]), np.zeros((1, 3)), np.array([[0, 0.4, 0]])


@pytest.mark.parametrize("chords", [1, 2, 4, 8, 16])
def test_a_plate_in_the_bulge(robot, chords):
    """A plate that the blend touches, and none of so many chords of it: only the second derivative tells of it."""
    off = 0.4 / (4 * chords**2) * math.sqrt(2)  # of the blend from its chord, along the diagonal
    # Beside the middle of the first chord: where the blend is farthest from it, towards the outside.
    s = 0.5 / chords
    point = (1 - s) ** 2 * FIRST[0] + s**2 * LAST[0]
    way = -2 * (1 - s) * FIRST[0] + 2 * s * LAST[0]
    out = np.array([way[1], -way[0]]) / np.hypot(*way[:2])
    for share, blocked in ((0.5, True), (-1.5, False)):
        x, y = point[:2] + (RADIUS + 0.5e-4 - share * off * np.abs(out @ [1, -1]) / math.sqrt(2)) * out
        checker = around(robot, (x, y, math.atan2(out[1], out[0])))
        t = np.linspace(0, 1, 20001)[:, None]
        hit = checker.collide((1 - t) ** 2 * FIRST + 2 * t * (1 - t) * CORNER + t**2 * LAST).any()
        assert hit == blocked
        free = Judge.of(checker, 0.0).proven(np.stack([FIRST, CORNER, LAST], axis=1))
        assert free[0] == (not blocked)


def sampled(first, corner, last, count):
    """Points of blends, shape (count, blends, dof)."""
    s = np.linspace(0, 1, count)[:, None, None]
    return (1 - s) ** 2 * first + 2 * s * (1 - s) * corner + s**2 * last


def test_blends_of_an_arm(rng):
    """No blend of a Panda that is proven collides at one of 1,000 samples, and those of some proven chords do."""
    arm = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    checker = CollisionChecker(arm, ring(rng, 14, 0.3, 0.9, 0.2))
    first = np.repeat(free_configurations(checker, 60), 5, axis=0)
    corner = steps(arm, rng, first, 0.4)
    last = steps(arm, rng, corner, 0.4)
    free = Judge.of(checker, 0.0).proven(np.stack([first, corner, last], axis=1))
    assert free.any()
    hit = checker.collide(sampled(first, corner, last, 1000)).any(axis=0)
    assert hit.any()
    assert not (free & hit).any()
    bare = checker.certify_edges(first, last).verdict == Verdict.FREE
    assert (bare & hit).any()
    # Nearly everything that can be proven is.
    assert free.sum() >= 0.9 * (~hit).sum()


@pytest.mark.parametrize("jerk", [None, 0.5])
def test_a_blend_gets_smaller_or_becomes_a_stop(robot, jerk):
    """At a bead nearer and nearer to the path, inside its corner, blends get smaller, and none ever touches it."""
    turn = math.radians(20)
    path = np.array([[-1, 0, 0], [0, 0, 0], [math.cos(turn), math.sin(turn), 0]])
    across, sizes = (math.pi + turn) / 2, []
    for gap in (0.3, 0.03, 0.01, 0.003, 1e-4):
        far = (RADIUS + 0.001 + gap) / math.cos(turn / 2)
        scene = Scene()
        scene.add("bead", Body.sphere(0.001), translation(far * math.cos(across), far * math.sin(across)))
        checker = CollisionChecker(replace(robot, bodies={"ball": Body.sphere(RADIUS)}), scene)
        moved = trajectory(checker.robot, path, velocity=1.0, acceleration=0.05, jerk=jerk, checker=checker)
        assert not checker.collide(moved.positions(dense(moved, 2000))).any()
        assert len(moved.blends) + len(moved.stops) == 1
        sizes.append(np.ptp(moved.blends) if len(moved.blends) else 0.0)
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 0
    assert sizes[-1] == 0.0


def test_path_of_a_planner(robot):
    """What `plan` returns is followed, and every sample of the trajectory is free."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    checker = CollisionChecker(robot, scene)
    path = planners.plan(checker, [-0.5, -0.5, np.pi / 2], [0.5, -0.5, np.pi / 2], joints="slide")
    moved = trajectory(robot, path, velocity=1.0, checker=checker)
    assert len(moved.blends) > 0
    assert not checker.collide(moved.positions(dense(moved, 500))).any()
    assert_lawful(moved, path, 1.0, 1.0)


def test_certify_passes_its_tolerance_on(robot):
    """The ball passes a wall at 1 µm: less than the default tolerance, but more than a smaller one."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    checker, x = CollisionChecker(replace(robot, bodies={"ball": Body.sphere(RADIUS)}), scene), -0.05 - RADIUS - 1e-6
    moved = trajectory(robot, [[x - 0.5, -0.5, 0], [x, 0, 0], [x - 0.5, 0.5, 0]], velocity=1.0)
    assert moved.certify(checker).verdict == checker.certify_trajectory(moved).verdict == Verdict.AMBIGUOUS
    assert moved.certify(checker, tolerance=1e-7).verdict == Verdict.FREE
    with pytest.raises(InputError, match="tolerance: expected"):
        moved.certify(checker, tolerance=0.0)


# -- limits and arguments -----------------------------------------------------------------------


def limited(velocity, kind="prismatic"):
    """A robot of one joint."""
    return (
        f'<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="{kind}"><parent link="a"/>'
        f'<child link="b"/><limit lower="-1" upper="1" effort="1" {velocity}/></joint></robot>'
    )


def test_velocities_of_a_urdf(tmp_path):
    """`Robot.velocity` is the URDF's limit, NaN where there is none above 0, and not to be changed."""
    assert written(tmp_path, limited('velocity="0.25"')).velocity.tolist() == [0.25]
    for none in ("", 'velocity="0"', 'velocity="inf"'):
        assert np.isnan(written(tmp_path, limited(none)).velocity).all(), none
    with pytest.warns(UserWarning, match=r"ignored, .*: <limit velocity> \(line 1\)"):
        assert np.isnan(written(tmp_path, limited('velocity="-1"')).velocity).all()
    with pytest.warns(UserWarning, match="planar"):
        assert np.isnan(written(tmp_path, limited('velocity="1"', "planar")).velocity).all()
    with pytest.raises(InputError, match="velocity"):
        written(tmp_path, limited('velocity="fast"'))
    with pytest.raises(ValueError, match="read-only"):
        written(tmp_path, limited('velocity="0.25"')).velocity[0] = 1.0


def test_velocity_of_a_joint_that_others_mimic(tmp_path):
    """A joint may be no faster than those that mimic it can follow."""
    slow = FINGERS.replace('lower="-0.1" upper="0.1"', 'lower="-0.1" upper="0.1" velocity="0.3"')
    assert written(tmp_path, slow.replace('multiplier="-1"', 'multiplier="-3"')).velocity == pytest.approx([0.1])
    both = slow.replace('lower="0" upper="0.1"', 'lower="0" upper="0.1" velocity="0.05"')
    assert written(tmp_path, both).velocity.tolist() == [0.05]


def test_default_limits(tmp_path):
    """Velocities come from the URDF; accelerations reach them in one second."""
    moved = trajectory(written(tmp_path, limited('velocity="0.25"')), [[0.0], [1.0]])
    assert np.abs(moved.velocities(dense(moved))).max() == pytest.approx(0.25)
    assert np.abs(moved.accelerations(dense(moved))).max() == pytest.approx(0.25)
    with pytest.raises(InputError, match=r"found none above 0 in the URDF for j; give velocity="):
        trajectory(written(tmp_path, limited("")), [[0.0], [1.0]])


BAD = {
    "path": ([[0, 0, 0]], [0, 0, 0], [[0, 0], [1, 1]], [[0, 0, np.nan], [0, 0, 0]], "path", None, []),
    "velocity": (0.0, -1.0, np.nan, np.inf, [1.0, 1.0], [1.0, 1.0, 0.0], "fast", True),
    "acceleration": (0.0, -1.0, np.nan, np.inf, [1.0, 1.0], [1.0, 1.0, 0.0], "fast", True),
    "jerk": (0.0, -1.0, np.nan, np.inf, [1.0, 1.0], [1.0, 1.0, 0.0], "fast", True),
    "blend": (-0.1, 0.5, np.nan, "much", None),
    "checker": ("checker", 1, object()),
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, bad in BAD.items() for value in bad])
def test_bad_arguments(robot, name, value):
    """Every argument that is wrong is named."""
    arguments = {"path": [[0, 0, 0], [1, 0, 0]], "velocity": 1.0, name: value}
    with pytest.raises(InputError, match=name):
        trajectory(robot, **arguments)


def test_other_robots(tmp_path, robot, alone):
    """A robot with orientations of its own, what is no robot, and another robot's checker are refused."""
    afloat = written(tmp_path, AFLOAT)
    q = afloat.configuration()
    with pytest.raises(InputError, match="floating"):
        trajectory(afloat, [q, q], velocity=1.0)
    with pytest.raises(InputError, match="robot"):
        trajectory("panda", [[0], [1]])
    with pytest.raises(InputError, match=r"checker\.robot"):
        trajectory(robot.disabling([]), [[0, 0, 0], [1, 0, 0]], velocity=1.0, checker=alone)


def test_limits_out_of_range(robot):
    """Ratios that no number holds are refused, not passed on as infinite times."""
    for velocity, acceleration in ((5e-324, 1.0), (1.0, 5e-324), (1e308, 1.0)):
        with pytest.raises(InputError, match="ratios"):
            trajectory(robot, [[0, 0, 0], [1, 1, 1e-300]], velocity=velocity, acceleration=acceleration)


def test_a_path_that_collides(robot):
    """With a checker the path has to be free; the message names motion and pair."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    path = [[-0.5, 0, np.pi], [-0.4, 0.2, np.pi], [0.5, 0, np.pi]]
    with pytest.raises(PlanningError, match="from row 1 to row 2.*wall"):
        trajectory(robot, path, velocity=1.0, checker=CollisionChecker(robot, scene))


# -- what is asked of a trajectory --------------------------------------------------------------


def test_times_of_any_shape(moved):
    """Positions, velocities and accelerations have the shape of the times, and each is as if it were alone."""
    t = np.linspace(0, moved.duration, 6).reshape(2, 3)
    for ask in (moved.positions, moved.velocities, moved.accelerations):
        assert ask(t).shape == (2, 3, 3)
        assert ask(0.5).shape == (3,)
        assert ask(np.empty((0, 4))).shape == (0, 4, 3)
        assert (ask(t)[1, 2] == ask(t[1, 2])).all()
        for bad in (-1e-9, moved.duration * (1 + 1e-12), np.nan, [0.0, np.inf], "now", None):
            with pytest.raises(InputError, match="t: expected"):
                ask(bad)


def test_stops_are_where_it_rests(moved):
    """At a stop the robot is at a corner, without velocity."""
    assert len(moved.stops) == 1
    assert (moved.positions(moved.stops[0]) == [0.5, 0, 1]).all()


@pytest.mark.parametrize("rate", [0.1, 3.0, 1000.0])
def test_samples(moved, rate):
    """Samples are at multiples of the period, and at the end."""
    times, Q = moved.sample(rate)
    assert times[:-1] == pytest.approx(np.arange(len(times) - 1) / rate)
    assert (np.diff(times) > 0).all()
    assert np.diff(times).max() <= 1 / rate * (1 + 1e-9)
    assert times[-1] == moved.duration
    assert (moved.positions(times) == Q).all()
    for bad in (0, -1.0, np.nan, np.inf, "100", None):
        with pytest.raises(InputError, match="rate"):
            moved.sample(bad)
    with pytest.raises(InputError, match="memory"):
        moved.sample(1e300)


# -- files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".csv", ".json", ".CSV"])
@pytest.mark.parametrize("rate", [None, 7.0])
@examples(4, 10)
@given(path=paths, velocity=limits, acceleration=limits)
def test_files_hold_all(robot, alone, tmp_path_factory, ending, rate, path, velocity, acceleration):
    """A file is the trajectory again, bit for bit if no rows were added."""
    moved = trajectory(robot, path, velocity=velocity, acceleration=acceleration, checker=alone)
    name = tmp_path_factory.mktemp("files") / f"moved{ending}"
    moved.save(name, rate=rate)
    read = Trajectory.load(name)
    assert read.names == robot.configuration_names
    t = dense(moved, 5)
    assert np.abs(read.positions(t) - moved.positions(t)).max() <= 1e-12
    assert read.stops == pytest.approx(moved.stops)
    if rate is None:
        for ours, theirs in ((moved.times, read.times), (moved.knots, read.knots), (moved.rates, read.rates)):
            assert (ours == theirs).all()
        assert (moved.blended == read.blended).all()


def test_files_for_other_programs(moved, tmp_path):
    """A CSV has names in its first row; JSON has lists by name."""
    moved.save(tmp_path / "a.csv", rate=100.0)
    with open(tmp_path / "a.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["time", "x", "y", "turn", "x velocity", "y velocity", "turn velocity", "blend"]
    assert float(rows[-1][0]) == moved.duration
    assert [float(entry) for entry in rows[0]] == [0.0] * 8
    moved.save(tmp_path / "a.json")
    held = json.loads((tmp_path / "a.json").read_text())
    assert list(held) == ["names", "times", "positions", "velocities", "blended"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "a.json"]


def spoiled(text, ending):
    """Files that are no trajectories: what is wrong, and the text."""
    yield "empty", ""
    yield "cut off", text[: len(text) // 2]
    yield "of something else", '{"a": 1}' if ending == ".json" else "a,b\n1,2\n"
    yield "NaN", text.replace("0.5", "NaN", 1)
    yield "text", text.replace("0.5", "zero" if ending == ".csv" else '"zero"', 1)
    yield "of another place", text.replace("0.5", "0.6", 1)
    if ending == ".csv":
        lines = text.splitlines(keepends=True)
        yield "backwards", "".join([lines[0], *reversed(lines[1:])])
        yield "no rows", lines[0]
        yield "open quotes", text.replace("time", '"time', 1)
        yield "one short", text.replace(",0\n", "\n", 1)
        yield "moving at the end", text.replace(lines[-1], lines[-2])
    else:
        yield "nested", "[" * 100000
        yield "beyond floats", text.replace("0.5", "1" + 400 * "0", 1)
        yield "one time", '{"names": ["x"], "times": 0.0, "positions": [[0]], "velocities": [[0]], "blended": []}'
        yield "no times", text.replace('"times"', '"instants"')
        yield "names of numbers", text.replace('"x"', "1")
        yield "blends of numbers", text.replace("false", "0", 1)


@pytest.mark.parametrize("ending", [".csv", ".json"])
def test_broken_files(moved, tmp_path, ending):
    """A file that holds no trajectory is refused by name."""
    name = tmp_path / f"moved{ending}"
    moved.save(name)
    good = name.read_text()
    for what, text in spoiled(good, ending):
        assert text != good, what
        name.write_text(text)
        with pytest.raises(FileError, match="moved"):
            Trajectory.load(name)
    name.write_bytes(b"\xff\xfe")
    with pytest.raises(FileError, match="moved"):
        Trajectory.load(name)
    with pytest.raises(FileError, match="missing"):
        Trajectory.load(tmp_path / f"missing{ending}")


@pytest.mark.parametrize("ending", [".csv", ".json"])
def test_no_joint_jumps_beside_one_that_is_far_away(ending, tmp_path):
    """A jump of a joint is compared with what that joint does: another one, however large its values, hides none."""
    times, still = np.array([0.0, 1.0, 2.0]), np.zeros((3, 2))
    name = tmp_path / f"moved{ending}"
    for far in (1e12, 1.0):
        knots = np.array([[far, 0.0], [far, 0.0], [far, 0.0]])
        trajectories.Trajectory(("far", "near"), times, knots, still, np.zeros(2, dtype=bool)).save(name)
        assert (Trajectory.load(name).knots == knots).all()
        knots[1:, 1] = 0.5
        trajectories.Trajectory(("far", "near"), times, knots, still, np.zeros(2, dtype=bool)).save(name)
        with pytest.raises(FileError, match="constant accelerations .* others of near after the time 0"):
            Trajectory.load(name)


def test_names_of_files(moved, tmp_path):
    """Other endings, and what is no path, are refused; a folder that is not there is a FileError."""
    for bad in ("moved", "moved.txt", "", None, 1):
        with pytest.raises(InputError, match="path"):
            moved.save(bad)
        with pytest.raises(InputError, match="path"):
            Trajectory.load(bad)
    with pytest.raises(FileError, match="could not be written"):
        moved.save(tmp_path / "nowhere" / "a.csv")
    with pytest.raises(InputError, match="rate"):
        moved.save(tmp_path / "a.csv", rate=0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[1, 2]", "expected a mapping, found a sequence of 2"),
        (
            '{"joint_names": ["a"], "points": [{"positions": [0], "time_from_start": 0}]}',
            "found 'joint_names'",
        ),
        ("{}", "expected the key names, found none"),
    ],
)
def test_points_of_other_programs_are_told_where_they_are_read(tmp_path, text, told):
    """`Trajectory.load` reads its own files only, and names the function that reads messages."""
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(FileError, match=told) as caught:
        Trajectory.load(tmp_path / "m.json")
    assert "planners.ControllerPoints.load reads messages" in str(caught.value)
    with pytest.raises(InputError, match=r"m.yaml; planners\.ControllerPoints\.load"):
        Trajectory.load("m.yaml")


def test_keys_that_occur_twice_in_a_saved_trajectory_are_refused(tmp_path):
    """Only the last of two values would be read; strings may contain anything that looks like a key."""
    (tmp_path / "m.json").write_text('{"names": ["a\\": {", "times"],\n "times": [],\n "t\\u0069mes": []}')
    with pytest.raises(FileError, match="m.json, line 3: expected each key once in a mapping, found 'times' again"):
        Trajectory.load(tmp_path / "m.json")


def test_a_change_after_the_path_was_proven(tmp_path, monkeypatch):
    """A post in the corner goes away, and one comes up on the path: no blend passes where the first one stood."""
    urdf, srdf = gantry(tmp_path)
    path = np.array([[-0.5, 0.0, UP], [0.0, 0.0, UP], [0.0, 0.5, UP]])

    def moved(checker):
        return trajectory(checker.robot, path, velocity=1.0, acceleration=1.0, checker=checker)

    def scene():
        made = Scene()
        made.add("post", Body.box([0.02, 0.02, 1.0]), translation(-0.115, 0.115))
        return made

    robot = Robot.from_urdf(urdf, srdf=srdf)
    expected = moved(CollisionChecker(robot, scene()))
    told = trajectories.refuse_unfree

    def and_then(*arguments):
        told(*arguments)
        late.move("post", translation(-0.5, 0.0))

    monkeypatch.setattr(trajectories, "refuse_unfree", and_then)
    late = scene()
    found = moved(CollisionChecker(robot, late))
    np.testing.assert_array_equal(found.knots, expected.knots)
    np.testing.assert_array_equal(found.blends, expected.blends)


@pytest.mark.verify
def test_thousands_of_corners(tmp_path, monkeypatch):
    """The effort grows with the number of corners, not with its square; what is chosen in parts is as good as ever."""
    checker = CollisionChecker(gantry_robot(tmp_path))
    x = np.linspace(-0.9, 0.9, 2002)
    path = np.stack([x, 0.01 * (np.arange(2002) % 2), np.full(2002, UP)], axis=1)

    def moved(rows):
        return trajectory(checker.robot, rows, velocity=1.0, acceleration=10.0, checker=checker)

    tried, duration = [], Straights.duration
    monkeypatch.setattr(Straights, "duration", lambda on, halves: tried.append(len(halves)) or duration(on, halves))
    assert len(moved(path).blends) == 2000
    assert sum(tried) < 3000 * len(path)
    in_parts = moved(path[:102])
    monkeypatch.setattr(trajectories, "CHOSEN_AT_A_TIME", 1000)
    assert in_parts.duration == pytest.approx(moved(path[:102]).duration, rel=0.01)
