"""Plans among bodies that move: every motion is proven at its own times, and no joint is faster than its limit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from families import translation
from gantry import LEFT, RIGHT, gantry_robot
from loewner import Body, CollisionChecker, FileError, InputError, PlanningError, Robot, Scene, Verdict, planners
from motion_oracle import AFLOAT
from sampling import examples
from test_moving_bodies import moving_scene

SAMPLES = 1001


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """A ball that slides along x and y, and a rod that turns beside it."""
    return gantry_robot(tmp_path_factory.mktemp("gantry"))


def gate(opens=2.0, margin=0.0):
    """A wall across the whole range of the ball, which sinks out of the way within a second."""
    scene = Scene(margin=margin)
    scene.add("gate", Body.box([0.1, 6.0, 1.0]))
    scene.follow("gate", [opens, opens + 1.0], [translation(y=y) for y in (-1.5, -4.5)])
    return scene


def check(checker, found, start, goal, velocity, begin, joint_error=0.0):
    """All laws of a plan in time."""
    assert found.jumps
    assert found.times[0] == 0.0
    T = np.diff(found.times)
    assert (T > 0).all()
    assert not found.knots.flags.writeable
    np.testing.assert_array_equal(found.knots[0], start)
    assert (np.abs(found.knots[-1] - np.atleast_2d(goal)).max(axis=1) == 0).any()
    assert (np.abs(np.diff(found.knots, axis=0)) <= velocity * T[:, None]).all()
    assert (np.abs(found.rates) <= velocity * (1 + 2**-52)).all()
    a, b, t = found.knots[:-1], found.knots[1:], begin + found.times
    proven = checker.certify_edges(a, b, t0=t[:-1], t1=t[1:], joint_error=joint_error)
    assert (proven.verdict == Verdict.FREE).all()
    assert checker.certify_trajectory(found, t0=begin, joint_error=joint_error).verdict == Verdict.FREE
    x = np.linspace(0.0, found.duration, SAMPLES)
    assert not checker.collide(found.positions(x), begin + x).any()


# -- known answers ----------------------------------------------------------------------------


def test_the_robot_waits_until_the_gate_opens(slider):
    """No earlier than the gate allows, and not much later: at y = 0.15 it is open at 2.483 s, 0.65 m remain."""
    checker = CollisionChecker(slider, gate())
    found = planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    check(checker, found, LEFT, RIGHT, 1.0, 0.0)
    assert 3.13 < found.duration < 3.8
    early = CollisionChecker(slider, gate(opens=-5.0))
    found = planners.plan(early, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    check(early, found, LEFT, RIGHT, 1.0, 0.0)
    assert len(found.times) == 2
    assert found.duration == pytest.approx(1.0, rel=1e-8)


def test_a_later_start_has_its_own_clock(slider):
    """Times count from the start of the plan, and bodies follow the scene's clock, even in seconds since 1970."""
    for begin in (-3.0, 1.7, 1.7e9):
        checker = CollisionChecker(slider, gate(begin + 2.0))
        found = planners.plan(checker, LEFT, RIGHT, start_time=begin, velocity=1.0)
        check(checker, found, LEFT, RIGHT, 1.0, begin)
        assert 3.13 < found.duration < 3.8


def test_the_robot_makes_way(slider):
    """A ball comes along and would hit the robot at the start after 0.3 s; the goal is where it comes from."""
    scene = Scene()
    scene.add("other", Body.sphere(0.1))
    scene.follow("other", [0.0, 1.5], [translation(y=-0.5), translation(x=-1.5, y=-0.5)])
    checker = CollisionChecker(slider, scene)
    a, b = LEFT * [1, 1, -1], RIGHT * [1, 1, -1]
    found = planners.plan(checker, a, b, start_time=0.0, velocity=1.0)
    check(checker, found, a, b, 1.0, 0.0)
    assert 1.0 <= found.duration < 2.5


def test_waiting_is_a_motion(slider):
    """With x alone there is no way around: the robot waits at some time, or goes slowly."""
    checker = CollisionChecker(slider, gate())
    found = planners.plan(checker, LEFT, RIGHT, joints="x", start_time=0.0, velocity=1.0)
    check(checker, found, LEFT, RIGHT, 1.0, 0.0)
    assert 3.3 < found.duration < 3.5
    np.testing.assert_array_equal(found.knots[:, 1:], np.broadcast_to(LEFT[1:], (len(found.knots), 2)))


def test_a_still_scene(slider):
    """Nothing moves, and the plan still keeps to the velocities; the continuous joint goes the shorter way."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    checker = CollisionChecker(slider, scene)
    goal = RIGHT + [0.0, 0.0, 2 * np.pi]
    found = planners.plan(checker, LEFT, goal, start_time=7.0, velocity=[1.0, 2.0, 3.0])
    check(checker, found, LEFT, RIGHT, np.array([1.0, 2.0, 3.0]), 7.0)
    same = planners.plan(checker, LEFT, LEFT, start_time=7.0, velocity=1.0)
    assert same.times.tolist() == [0.0]


def test_several_goals_and_poses(slider):
    """The goal that is reached is one of them; a pose of a link is as good as a configuration."""
    checker = CollisionChecker(slider, gate())
    goals = np.array([RIGHT, LEFT + [0.0, 0.2, 0.0], RIGHT + [0.1, 0.1, 0.3]])
    found = planners.plan(checker, LEFT, goals, start_time=0.0, velocity=1.0)
    check(checker, found, LEFT, goals, 1.0, 0.0)
    assert found.duration == pytest.approx(0.2, rel=1e-8)
    pose = slider.forward_kinematics(RIGHT)[slider.link_names.index("ball")]
    found = planners.plan(checker, LEFT, planners.PoseGoal("ball", pose), start_time=0.0, velocity=1.0)
    check(checker, found, LEFT, found.knots[-1], 1.0, 0.0)
    np.testing.assert_allclose(found.knots[-1, :2], RIGHT[:2], atol=1e-6)


def test_deviations_are_covered(slider):
    """The direct motion passes a ball at 0.05 m; with a larger error of y the robot goes around it, or waits for it."""
    scene = Scene()
    scene.add("other", Body.sphere(0.1))
    scene.follow("other", [0.0, 2.0, 2.5], [translation(y=-0.25), translation(y=-0.25), translation(y=3.0)])
    checker = CollisionChecker(slider, scene)
    a, b = LEFT * [1, 1, -1], RIGHT * [1, 1, -1]
    assert len(planners.plan(checker, a, b, start_time=0.0, velocity=1.0).times) == 2
    errors = np.array([0.01, 0.06, 0.01])
    found = planners.plan(checker, a, b, start_time=0.0, velocity=1.0, joint_error=errors)
    check(checker, found, a, b, 1.0, 0.0, errors)
    assert len(found.times) > 2
    assert planners.plan(checker, a, b, start_time=2.6, velocity=1.0, joint_error=errors).jumps


# -- laws -------------------------------------------------------------------------------------


@given(st.integers(0, 2**31))
@examples(5, 12)
def test_every_motion_is_proven_and_no_joint_too_fast(slider, seed):
    """Among bodies that wander and turn, some of them again and again; the same seed finds the same plan."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(slider, moving_scene(rng, 3))
    begin, velocity = rng.uniform(-1.0, 3.0), rng.uniform(0.5, 3.0, 3)
    Q = rng.uniform(-1, 1, (40, 3)) * [1, 1, 3]
    start = Q[~checker.collide(Q, begin)]
    if len(start) == 0:
        return
    options = {"start_time": begin, "velocity": velocity, "max_iterations": 800, "seed": seed % 1000}
    try:
        found = planners.plan(checker, start[0], start[-1], **options)
    except PlanningError:
        return
    check(checker, found, start[0], found.knots[-1], velocity, begin)
    turns = (found.knots[-1] - start[-1]) / [1, 1, 2 * np.pi]
    np.testing.assert_allclose(turns, [0, 0, round(turns[2])], atol=1e-12)
    again = planners.plan(checker, start[0], start[-1], **options)
    np.testing.assert_array_equal(again.knots, found.knots)
    np.testing.assert_array_equal(again.times, found.times)


def test_arrival_is_in_time(slider):
    """Never after `arrive_by`, by no rounding; what cannot be reached by then is an error."""
    checker = CollisionChecker(slider, gate())
    for last in (3.6, 3.9, 10.0):
        for begin in (0.0, 0.1):
            found = planners.plan(checker, LEFT, RIGHT, start_time=begin, velocity=1.0, arrive_by=last)
            assert begin + found.duration <= last
    with pytest.raises(PlanningError, match=r"arrive_by: expected 1 s or later, .*; found 0\.9 s"):
        planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0, arrive_by=0.9)
    with pytest.raises(PlanningError, match=r"between 0 s and 2 s, found none within 200 iterations: trees of \d+"):
        planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0, arrive_by=2.0, max_iterations=200)


def test_messages_name_who_is_in_the_way(slider):
    """At the start: when, how deep, and who; at a goal that is never free; and at a start that is overrun."""
    scene = gate()
    checker = CollisionChecker(slider, scene)
    inside = LEFT * [0.1, 1, 1]
    with pytest.raises(PlanningError, match=r"free at the start time 1 s, found a collision of ball and gate \(100 mm"):
        planners.plan(checker, inside, RIGHT, start_time=1.0, velocity=1.0)
    with pytest.raises(PlanningError, match=r"no goal that is free.*; at .* s there is a collision of ball and gate"):
        planners.plan(checker, LEFT, inside, start_time=0.0, velocity=1.0, arrive_by=1.5, max_iterations=50)
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(x=0.5, y=-1.5))
    with pytest.raises(PlanningError, match=r"goal: expected a free configuration.*ball and wall \(150 mm deep\)"):
        planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    scene = Scene()
    scene.add("ram", Body.box([0.2, 4.0, 4.0]))
    scene.follow("ram", [0.0, 0.2], [translation(x=-1.5), translation(x=1.5)])
    with pytest.raises(PlanningError, match=r"at the start, ball and ram come too near after 0\.0"):
        planners.plan(CollisionChecker(slider, scene), LEFT, RIGHT, start_time=0.0, velocity=1.0, max_iterations=50)


def test_bad_input_is_refused(slider):
    """Each with what was expected and found."""
    checker = CollisionChecker(slider, gate())
    good = {"start_time": 0.0, "velocity": 1.0}
    for change, message in (
        ({"start_time": np.nan}, "start_time: expected"),
        ({"start_time": "now"}, "start_time: expected"),
        ({"start_time": 1e15}, "start_time: expected a time to which motions of .* can be added"),
        ({"velocity": -1.0}, "velocity"),
        ({"velocity": [1.0, 0.0, 1.0]}, "velocity"),
        ({"velocity": np.inf}, "velocity"),
        ({"velocity": 1e-300}, "velocity: expected joints that cross their ranges in 1e.09 s"),
        ({"velocity": [1.0, 1.0]}, "velocity: expected one number or shape"),
        ({"velocity": None}, "velocity: expected a limit of each joint that moves, found none"),
        ({"arrive_by": np.nan}, "arrive_by: expected"),
        ({"arrive_by": 0.0}, "arrive_by: expected a time after start_time, 0, found 0"),
        ({"arrive_by": -1.0}, "arrive_by: expected a time after start_time"),
        ({"start_time": None}, "start_time: expected it with velocity or arrive_by"),
        ({"certified": False}, "start_time: expected no certified=False with it"),
        ({"full": True}, "start_time: expected no full=True with it"),
        ({"full": True, "improve_for": 1.0}, "start_time: expected no full=True or improve_for with it"),
        ({"keep": ("ball", "z", [0, 0, 1], 0.1)}, "start_time: expected no keep with it"),
        ({"joint_error": -1.0}, "joint_error"),
        ({"joints": "turn"}, "goal: expected the start's value"),
    ):
        with pytest.raises(InputError, match=message):
            planners.plan(checker, LEFT, RIGHT, **(good | change))
    with pytest.raises(TypeError, match="hurry"):
        planners.plan(checker, LEFT, RIGHT, hurry=True, **good)
    with pytest.raises(InputError, match=r"follow motions \(gate\): .*planners.plan_in_time plans"):
        planners.plan(checker, LEFT, RIGHT)
    robot = Robot.from_urdf(text=AFLOAT).with_body("bar", Body.box([1.0, 0.05, 0.05]), parent="hand", joint="fixed")
    afloat = CollisionChecker(robot)
    q = afloat.robot.random_configurations(1)[0]
    with pytest.raises(InputError, match="values run straight"):
        planners.plan(afloat, q, q, joints="slide", **good)


def test_bodies_that_shake(slider):
    """A motion that repeats thousands of times during a plan is refused, since each time cuts the robot's motions."""
    scene = gate()
    scene.add("shaking", Body.box([0.1, 0.1, 0.1]))
    ends = [translation(0, 0, 5), translation(0, 0, 5.01), translation(0, 0, 5)]
    scene.follow("shaking", [0.0, 1e-5, 2e-5], ends, repeat=True)
    with pytest.raises(InputError, match="at most 16384 of their times .*'shaking'"):
        planners.plan(CollisionChecker(slider, scene), LEFT, RIGHT, start_time=0.0, velocity=1.0)


def test_a_changed_scene_is_planned_anew(slider):
    """A plan, then a body that stands in the way or no longer does: each plan is about the present scene."""
    scene = gate(opens=-5.0)
    checker = CollisionChecker(slider, scene)
    free = planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    scene.add("post", Body.box([0.2, 0.4, 0.4]), translation(0, -0.5))
    around = planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    check(checker, around, LEFT, RIGHT, 1.0, 0.0)
    assert len(around.times) > len(free.times) == 2
    scene.remove("post")
    again = planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    np.testing.assert_array_equal(again.knots, free.knots)


def test_a_search_ends_in_time(slider):
    """A timeout ends a search that cannot succeed."""
    checker = CollisionChecker(slider, gate())
    with pytest.raises(PlanningError, match=r"within 0\.05 s \(\d+ iterations\)"):
        planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0, arrive_by=2.0, timeout=0.05)


# -- trajectories whose velocities jump -------------------------------------------------------


def test_files_give_back_the_plan(slider, tmp_path):
    """To the last bit, with the start time; readers of points see straight motions as well."""
    checker = CollisionChecker(slider, gate(3.3))
    found = planners.plan(checker, LEFT, RIGHT, start_time=1.3, velocity=1.0)
    assert checker.certify_trajectory(found).verdict == found.certify(checker).verdict == Verdict.FREE
    assert checker.certify_trajectory([found], t0=1.3)[0].times[0] == 1.3
    assert checker.first_contact(found).verdict == Verdict.FREE
    assert checker.certify_trajectory(found, t0=0.0).verdict == Verdict.COLLIDING
    for name in ("plan.csv", "plan.json"):
        found.save(tmp_path / name)
        loaded = planners.Trajectory.load(tmp_path / name)
        for attribute in ("times", "knots", "rates", "blended"):
            np.testing.assert_array_equal(getattr(loaded, attribute), getattr(found, attribute))
        assert loaded.jumps
        assert loaded.start_time == 1.3
        assert loaded.names == found.names
    found.save(tmp_path / "plan.yaml")
    found.save(tmp_path / "message.json", message=True)
    for name in ("plan.csv", "plan.json", "plan.yaml", "message.json"):
        points = planners.ControllerPoints.load(tmp_path / name)
        assert points.velocities is None
        np.testing.assert_array_equal(points.positions, found.knots)
        assert points.start_time == (0.0 if name in ("plan.yaml", "message.json") else 1.3)
        assert checker.certify_trajectory(points, t0=1.3).verdict == Verdict.FREE
        if points.start_time:
            assert checker.certify_trajectory(points).verdict == Verdict.FREE
    found.save(tmp_path / "dense.csv", rate=50.0)
    dense = planners.Trajectory.load(tmp_path / "dense.csv")
    x = np.linspace(0.0, found.duration, 500)
    np.testing.assert_allclose(dense.positions(x), found.positions(x), atol=1e-12)
    assert dense.start_time == 1.3
    rounded = planners.trajectory(slider, [LEFT, RIGHT], velocity=1.0, acceleration=1.0)
    for name in ("later.csv", "later.json"):
        replace(rounded, start_time=-2.5).save(tmp_path / name)
        assert planners.Trajectory.load(tmp_path / name).start_time == -2.5
        assert planners.ControllerPoints.load(tmp_path / name).start_time == -2.5
    for begin in ("nan", "x", ""):
        (tmp_path / "wrong.csv").write_text(f"# start_time: {begin}\ntime,x,y\n0,1,1\n1,2,2\n")
        for kind in (planners.Trajectory, planners.ControllerPoints):
            with pytest.raises(FileError):
                kind.load(tmp_path / "wrong.csv")
    for begin in ("true", '"4"', "1e999", "null"):
        (tmp_path / "wrong.json").write_text((tmp_path / "later.json").read_text().replace("-2.5", begin))
        for kind in (planners.Trajectory, planners.ControllerPoints):
            with pytest.raises(FileError):
                kind.load(tmp_path / "wrong.json")
    with pytest.raises(InputError, match="start_time"):
        checker.certify_trajectory(replace(rounded, start_time="soon"))
    for text in ("time,x,y\n0,1,1\n0,2,2\n", "time,x\n0,nan\n", "time,x\n", "time,x\n1,2\n2,3\n", "time,x\n0,1,2\n"):
        (tmp_path / "wrong.csv").write_text(text)
        with pytest.raises(FileError):
            planners.Trajectory.load(tmp_path / "wrong.csv")


def test_velocities_jump(slider):
    """At a knot the new velocity counts; at the end the robot rests."""
    checker = CollisionChecker(slider, gate())
    found = planners.plan(checker, LEFT, RIGHT, start_time=0.0, velocity=1.0)
    T = np.diff(found.times)
    np.testing.assert_array_equal(found.velocities(found.times), found.rates)
    np.testing.assert_array_equal(found.rates[-1], 0.0)
    middles = found.times[:-1] + T / 2
    np.testing.assert_allclose(found.positions(middles), (found.knots[:-1] + found.knots[1:]) / 2, atol=1e-12)
    np.testing.assert_array_equal(found.positions(found.times), found.knots)
    np.testing.assert_array_equal(found.velocities(middles), found.rates[:-1])
    assert not found.accelerations(middles).any()
    assert found.velocities(0.0).shape == found.accelerations(0.0).shape == (3,)
    assert repr(found) == f"Trajectory({found.duration:.4g} s, 3 joints, {len(T)} motions)"
