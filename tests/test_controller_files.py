"""Files that controllers take: some columns, other names, one for each controller, and limits in exact arithmetic."""

import contextlib
import csv
import json
import warnings
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import BPoly

from gantry import LEFT, RIGHT
from loewner import CollisionChecker, FileError, InputError, Robot, UnknownNameError, Verdict, planners
from loewner.planners import ControllerPoints, Trajectory, trajectory
from sampling import examples
from test_plans_in_time import gate

JERK = 30.0
NAMES = ("x", "y", "turn")

numbers = st.floats(-1e3, 1e3).map(lambda x: x + 0.0)
labels = st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S")), min_size=1, max_size=8)


@pytest.fixture(scope="module")
def moved(robot):
    """A trajectory with limited jerk, on which all columns move."""
    path = [[0, 0, 0], [0.5, 0.1, 1], [0.5, 0.5, 0]]
    return trajectory(robot, path, velocity=1.0, acceleration=3.0, jerk=JERK)


@pytest.fixture(scope="module")
def arms():
    """Two arms beside each other."""
    slide = """<robot name="arm"><link name="rail"/>
    <link name="cart"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
    <link name="hand"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
    <joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="2" velocity="1"/></joint>
    <joint name="lift" type="prismatic"><parent link="cart"/><child link="hand"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="2" velocity="1"/></joint></robot>"""
    arm, T = Robot.from_urdf(text=slide), np.eye(4)
    T[1, 3] = 1.0
    return arm, Robot.join({"left": arm, "right": arm}, {"right": T})


# -- columns and names --------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".csv", ".json"])
@pytest.mark.parametrize("jerk", [None, JERK])
@given(order=st.permutations(range(3)), count=st.integers(1, 3), mapped=st.booleans())
@settings(max_examples=8)
def test_a_file_holds_the_columns_that_are_named(robot, tmp_path_factory, ending, jerk, order, count, mapped):
    """Columns come in the order of joints=, by the names of names=, and their numbers are the trajectory's."""
    whole = trajectory(robot, [[0, 0, 0], [0.5, 0, 1], [0.5, 0.5, 0]], velocity=1.0, acceleration=3.0, jerk=jerk)
    chosen = [NAMES[k] for k in order[:count]]
    called = [f"axis {name}" for name in chosen]
    file = tmp_path_factory.mktemp("files") / f"part{ending}"
    whole.save(file, joints=chosen, names=dict(zip(chosen, called, strict=True)) if mapped else called)
    read, columns = Trajectory.load(file), list(order[:count])
    assert read.names == tuple(called)
    assert (read.times == whole.times).all()
    assert (read.knots == whole.knots[:, columns]).all()
    assert (read.rates == whole.rates[:, columns]).all()
    assert (read.bends is None) == (jerk is None)
    assert jerk is None or (read.bends == whole.bends[:, columns]).all()


def test_a_part_is_no_whole_trajectory(moved, robot, alone, tmp_path):
    """A checker refuses a file of some columns, or of other names, and lists the joints that are missing."""
    moved.save(tmp_path / "part.csv", joints=["y", "x"])
    with pytest.raises(InputError, match="found none for turn"):
        Trajectory.load(tmp_path / "part.csv").certify(alone)
    moved.save(tmp_path / "named.csv", names={"turn": "wrist"})
    with pytest.raises(InputError, match="the unknown wrist"):
        Trajectory.load(tmp_path / "named.csv").certify(alone)
    moved.save(tmp_path / "mixed.json", joints=["turn", "x", "y"])
    assert Trajectory.load(tmp_path / "mixed.json").certify(alone).verdict == Verdict.FREE


@pytest.mark.parametrize("flag", ["nan", "0.5", "-1"])
def test_a_blend_is_0_or_1(tmp_path, flag):
    """Any other number is an error of the file, not a blend."""
    (tmp_path / "blend.csv").write_text(f"time,a,a velocity,blend\n0,0,0,{flag}\n1,0.5,1,0\n")
    for kind in (Trajectory, ControllerPoints):
        with pytest.raises(FileError, match=f"column 'blend': expected 0 or 1, found {flag}"):
            kind.load(tmp_path / "blend.csv")


def test_accelerations_alone_are_no_trajectory(tmp_path):
    """They are not dropped: the motion between the positions would be another one than the file describes."""
    (tmp_path / "bent.csv").write_text("time,a,a acceleration\n0,0,5\n1,1,-5\n")
    with pytest.raises(FileError, match="expected accelerations beside velocities and blends, found them alone"):
        Trajectory.load(tmp_path / "bent.csv")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"joints": ["x", "z"]}, UnknownNameError, "joints: expected one of x, y, turn; found 'z'"),
        ({"joints": ["x", "x"]}, InputError, "joints: expected different names, found x again"),
        ({"joints": []}, InputError, "joints: expected different names, found none"),
        ({"joints": "x"}, InputError, "joints: expected a list of names"),
        ({"joints": [0]}, UnknownNameError, "joints"),
        ({"names": {"z": "a"}}, UnknownNameError, "names: expected one of x, y, turn; found 'z'"),
        ({"names": ["a"]}, InputError, "names: expected 3, one for each column, found 1"),
        ({"names": "abc"}, InputError, "names: expected a mapping or a list of names"),
        ({"names": {"x": "y"}}, InputError, "names: expected different names, found y again"),
        ({"names": {"x": ""}}, InputError, "names: expected printable names"),
        ({"names": {"x": " a"}}, InputError, "names: expected printable names"),
        ({"names": ["a", "b", 3]}, InputError, "names: expected printable names"),
        (
            {"names": {"x": "blend"}},
            InputError,
            "names: expected names that a .csv file reads as joints, found 'blend'",
        ),
        ({"names": {"x": "y velocity"}}, InputError, "names: expected names that a .csv file reads"),
    ],
)
def test_bad_columns_and_names(moved, tmp_path, options, error, message):
    """Names that are unknown, repeated, or of another kind are refused, and nothing is written."""
    points = ControllerPoints(moved.times, moved.knots, moved.rates, names=moved.names)
    for each in (moved, points):
        with pytest.raises(error, match=message):
            each.save(tmp_path / "a.csv", **options)
    assert list(tmp_path.iterdir()) == []


def test_points_without_names_need_them(tmp_path):
    """A file has names; points of a user may have none."""
    points = ControllerPoints([0.0, 1.0], [[0.0, 1.0], [1.0, 2.0]])
    with pytest.raises(InputError, match="names: expected the names"):
        points.save(tmp_path / "a.yaml")
    with pytest.raises(InputError, match="joints: expected points with names"):
        points.save(tmp_path / "a.yaml", joints=["x"])
    points.save(tmp_path / "a.yaml", names=["p", "q"])
    assert ControllerPoints.load(tmp_path / "a.yaml").names == ("p", "q")


# -- points -------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".csv", ".json", ".yaml"])
@given(data=st.data(), count=st.integers(2, 4), rates=st.integers(0, 2), begin=st.sampled_from([0.0, 2.5]))
@examples(6, 15)
def test_points_are_read_back_equal(tmp_path_factory, ending, data, count, rates, begin):
    """A .csv file holds all numbers; a message holds times of whole nanoseconds, and no start time."""
    names = data.draw(st.lists(labels.map(lambda text: f"j{text}"), min_size=2, max_size=2, unique=True))
    steps = data.draw(st.lists(st.integers(1, 10**10), min_size=count, max_size=count, unique=True))
    times = np.array([k // 10**9 + 1e-9 * (k % 10**9) for k in sorted(steps)])
    rows = [data.draw(arrays(np.float64, (count, 2), elements=numbers)) for _ in range(rates + 1)]
    points = ControllerPoints(times, *rows, names=names, start_time=begin if ending == ".csv" else 0.0)
    file = tmp_path_factory.mktemp("points") / f"points{ending}"
    points.save(file)
    read = ControllerPoints.load(file)
    assert read.names == tuple(names)
    assert read.start_time == points.start_time
    for kind in ("times", "positions", "velocities", "accelerations"):
        ours, theirs = getattr(points, kind), getattr(read, kind)
        assert (ours is None) == (theirs is None)
        assert ours is None or (ours == theirs).all(), kind
    read.save(file)
    assert (ControllerPoints.load(file).times == read.times).all()


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, 1e-10], "at least a nanosecond apart in a message, found 0.0 and 1e-10"),
        ([-1.0, 0.0], "expected 0 to 2147483648 s in a message, found -1"),
        ([0.0, 3e9], "expected 0 to 2147483648 s in a message, found 3e\\+09"),
    ],
)
def test_times_that_no_message_holds(tmp_path, times, message):
    """Two rows never become one time; a duration is within 32 bits. A .csv file holds them all."""
    points = ControllerPoints(times, [[0.0], [1.0]], names=["x"])
    with pytest.raises(InputError, match=message):
        points.save(tmp_path / "a.yaml")
    points.save(tmp_path / "a.csv")
    assert ControllerPoints.load(tmp_path / "a.csv").times.tolist() == times


def test_a_base_that_moves_straight_is_refused_and_carried_bodies_are_mentioned(tmp_path):
    """A message would interpolate the base like the joints; it does not hold what the robot carries."""
    points = ControllerPoints([0.0, 1.0], [[0.0, 0.0], [1.0, 1.0]], np.zeros((2, 2)), names=["x", "base/x"])
    points.origin = replace(points.origin, straight=("base/x",))
    with pytest.raises(InputError, match="joints: .* found base/x, which move straight"):
        points.save(tmp_path / "a.yaml")
    points.save(tmp_path / "a.yaml", joints=["x"])
    points.carried = {"can": "hand"}
    with pytest.warns(UserWarning, match="does not contain that the robot carries can"):
        points.save(tmp_path / "a.yaml", joints=["x"])


# -- limits -------------------------------------------------------------------------------------


def of_file(file):
    """Times, positions, velocities and perhaps accelerations of a file: the written decimals, as fractions."""
    if file.suffix == ".csv":
        header, *rows = csv.reader(file.read_text().splitlines())
        table = [[Fraction(cell) for cell in row] for row in rows]
        at = [[k for k, name in enumerate(header) if name.endswith(kind)] for kind in (" velocity", " acceleration")]
        columns = [range(1, 1 + len(at[0])), *at[: 1 + bool(at[1])]]
        return [row[0] for row in table], [[[row[k] for k in kind] for row in table] for kind in columns]
    points = json.loads(file.read_text(), parse_float=Fraction, parse_int=Fraction)["points"]
    times = [point["time_from_start"]["sec"] + point["time_from_start"]["nanosec"] / 10**9 for point in points]
    kinds = ("positions", "velocities", "accelerations")
    return times, [[point[kind] for point in points] for kind in kinds if kind in points[0]]


def polynomial(T, first, last):
    """Coefficients in the share of the time T of the cubic or quintic that a controller makes of two rows."""
    (q0, v0, *a0), (q1, v1, *a1) = first, last
    d, v0, v1 = q1 - q0, v0 * T, v1 * T
    if not a0:
        return [q0, v0, 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d]
    (a,), (b,) = ([each * T**2 for each in ends] for ends in (a0, a1))
    fifth = 6 * d - 3 * (v0 + v1) - (a - b) / 2
    return [q0, v0, a / 2, 10 * d - 6 * v0 - 4 * v1 - (3 * a - b) / 2, -15 * d + 8 * v0 + 7 * v1 + (3 * a - 2 * b) / 2,
            fifth]  # fmt: skip


def extreme(coefficients):
    """A value at least as large as a polynomial on [0, 1]: its own at the ends and, all but exactly, at its extrema."""
    slope = [k * c for k, c in enumerate(coefficients)][1:]
    size = max(map(abs, slope), default=0)
    roots = np.roots([float(c / size) for c in slope[::-1]]) if size else []
    at = [Fraction(0), Fraction(1), *(Fraction(float(x.real)) for x in np.atleast_1d(roots) if 0 < x.real < 1)]
    return max(abs(sum(c * x**k for k, c in enumerate(coefficients))) for x in at)


def excesses(file, limits, quintic):
    """For each limit, the largest share by which the controller's curve exceeds it, as fractions."""
    times, columns = of_file(file)
    columns, worst = columns if quintic else columns[:2], [Fraction(-1)] * len(limits)
    for k in range(len(times) - 1):
        T = times[k + 1] - times[k]
        for joint in range(len(columns[0][0])):
            piece = polynomial(T, *([kind[row][joint] for kind in columns] for row in (k, k + 1)))
            for power, limit in enumerate(limits, 1):
                piece = [j * c for j, c in enumerate(piece)][1:]
                worst[power - 1] = max(worst[power - 1], extreme(piece) / T**power / Fraction(limit) - 1)
    return worst, min(b - a for a, b in zip(times, times[1:], strict=False))


values = st.floats(-1.0, 1.0).map(lambda x: round(x, 3))
steps = arrays(np.float64, (3, 3), elements=values).filter(lambda path: (np.diff(path, axis=0) != 0).any(axis=1).all())


@pytest.mark.parametrize("ending", [".csv", ".json"])
@given(path=steps, jerk=st.floats(0.5, 5000.0), knot=st.integers(1, 20), near=st.floats(-5, -2.5), late=st.booleans())
@examples(4, 10)
def test_rows_keep_limits_in_fractions(robot, alone, tmp_path_factory, ending, path, jerk, knot, near, late):
    """Added rows, however near to a knot, keep the limits of cubics and quintics in exact arithmetic.

    Messages round times to nanoseconds, which costs a share of up to 12 ns over the shortest time between rows.
    """
    limits = (1.0, 3.0, jerk)
    whole = trajectory(robot, path, velocity=1.0, acceleration=3.0, jerk=jerk, checker=alone)
    at = whole.times[min(knot, len(whole.times) - 1)] + (1 if late else -1) * 10.0**near
    rate = max(round(8 / whole.duration * at), 1) / at if at > 1e-3 else 8 / whole.duration
    file = tmp_path_factory.mktemp("rows") / f"rows{ending}"
    whole.save(file, rate=rate, message=ending == ".json")
    for quintic in (False, True):
        worst, shortest = excesses(file, limits, quintic)
        allowed = 0 if ending == ".csv" else Fraction(12, 10**9) / shortest
        assert max(worst) <= allowed, (quintic, [float(share) for share in worst])


@given(path=steps, jerk=st.none() | st.floats(0.5, 5000.0), speed=st.floats(1e-3, 1.0))
@settings(max_examples=20)
def test_messages_leave_the_trajectory_by_less_than_a_nanosecond(robot, alone, tmp_path_factory, path, jerk, speed):
    """The controller's curve is as near to the trajectory as the way of a nanosecond, on long pieces, too."""
    limits = {"velocity": speed, "acceleration": 300.0, **({} if jerk is None else {"jerk": jerk})}
    whole = trajectory(robot, path, checker=alone, **limits)
    file = tmp_path_factory.mktemp("message") / "message.json"
    whole.save(file, message=True)
    points = ControllerPoints.load(file)
    rows = [points.positions, points.velocities, *([] if jerk is None else [points.accelerations])]
    t = np.minimum(np.linspace(points.times[:-1], points.times[1:], 20), whole.duration)
    for held in (rows, rows[:2]):
        curve = BPoly.from_derivatives(points.times, np.stack(held, axis=1))
        off = 1e-9 * speed + 1e-13 * (np.abs(whole.knots).max() + speed * whole.duration)
        assert np.abs(curve(t) - whole.positions(t)).max() <= off


@given(path=steps, knot=st.integers(1, 20), near=st.floats(-5, -2.5), late=st.booleans())
@settings(max_examples=10)
def test_rows_without_a_limit_of_jerk_add_a_millionth(robot, alone, tmp_path_factory, path, knot, near, late):
    """Rows near knots exceed limits by no more than the knots do, and a millionth."""
    whole = trajectory(robot, path, velocity=1.0, acceleration=3.0, checker=alone)
    at = whole.times[min(knot, len(whole.times) - 1)] + (1 if late else -1) * 10.0**near
    rate = max(round(8 / whole.duration * at), 1) / at if at > 1e-3 else 8 / whole.duration
    file = tmp_path_factory.mktemp("rows") / "rows.csv"
    whole.save(file)
    before, _ = excesses(file, (1.0, 3.0), False)
    whole.save(file, rate=rate)
    after, _ = excesses(file, (1.0, 3.0), False)
    assert all(share <= max(old, 0) + Fraction(1, 10**6) for share, old in zip(after, before, strict=True))


@pytest.mark.parametrize("jerk", [None, 30.0])
def test_rows_keep_limits_of_times_for_a_path(robot, tmp_path, jerk):
    """A trajectory of `time_path` that waits for a gate knows its spacing, and rows near a knot keep the limits."""
    given = {"velocity": 1.0, "acceleration": 3.0, "jerk": jerk}
    whole = planners.time_path(CollisionChecker(robot, gate(1.0)), [LEFT, RIGHT], start_time=0.0, **given)
    assert 1e-4 < whole.spacing < 1e-2
    at = whole.times[len(whole.times) // 2] + 0.1 * whole.spacing
    worst = []
    for rate in (None, round(40 * at) / at):
        whole.save(tmp_path / "rows.csv", rate=rate)
        worst.append(excesses(tmp_path / "rows.csv", tuple(given.values())[: 2 if jerk is None else 3], False)[0])
    more = Fraction(1, 10**6) if jerk is None else 0
    assert all(share <= max(old, 0) + more for old, share in zip(*worst, strict=True))


def test_rows_are_apart(moved, tmp_path):
    """Rows are no nearer than the spacing, at any rate, and only rows that would be nearer are left out."""
    assert 1e-3 < moved.spacing < 1e-2
    for rate in (10.0, 100.0, 1000.0, 20000.0):
        with (
            contextlib.nullcontext() if rate < 1 / moved.spacing else pytest.warns(UserWarning, match="rows per second")
        ):
            moved.save(tmp_path / "rows.csv", rate=rate)
        times = Trajectory.load(tmp_path / "rows.csv").times
        added = ~np.isin(times, moved.times)
        gaps = np.diff(times)
        assert gaps[added[1:] | added[:-1]].min() >= min(moved.spacing, np.diff(moved.times).min())
        assert gaps.max() <= np.ceil(moved.spacing * rate) / rate + moved.spacing * (1 + 1e-9)
        assert np.isin(moved.times, times).all()


# -- times --------------------------------------------------------------------------------------


def test_samples_are_not_at_the_same_time(robot):
    """The end replaces a sample that is less than a nanosecond before it; faster sampling is refused."""
    whole = trajectory(robot, [[0, 0, 0], [0.5, 0, 0]], velocity=1.0, acceleration=3.0)
    for factor in (1 - 1e-12, 1.0, 1 + 1e-12, 1 + 1e-10):
        times, Q = whole.sample(7 / whole.duration * factor)
        assert len(times) == 8
        assert np.diff(times).min() >= 1e-9
        assert times[-1] == whole.duration
        assert (Q[-1] == whole.knots[-1]).all()
    with pytest.raises(InputError, match="rate: expected at most 1e\\+09 samples per second, found 2e\\+09"):
        trajectory(robot, [[0, 0, 0], [1e-9, 0, 0]], velocity=1.0, acceleration=1e9).sample(2e9)


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_rows_of_one_nanosecond_are_merged_in_messages(robot, tmp_path, suffix):
    """Knots within a nanosecond become one row of the trajectory, and the end is the goal, at rest."""
    tiny = [[0, 0, 0], [0.5, 0, 0], [0.5, 1e-19, 0], [0, 0, 0]]
    whole = trajectory(robot, tiny, velocity=1.0, acceleration=3.0)
    assert np.diff(whole.times).min() < 1e-9
    whole.save(tmp_path / f"a{suffix}", message=True)
    points = ControllerPoints.load(tmp_path / f"a{suffix}")
    assert len(points.times) < len(whole.times)
    assert np.diff(points.times).min() >= 0.9e-9
    assert (points.positions[[0, -1]] == whole.knots[[0, -1]]).all()
    assert not points.velocities[-1].any()
    at = np.minimum(points.times, whole.duration)
    assert points.positions == pytest.approx(whole.positions(at), abs=1e-15)


# -- two arms -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".csv", ".yaml"])
def test_two_arms_end_to_end(arms, tmp_path, ending):
    """Each controller gets its half; both halves together are the proven trajectory again."""
    arm, both = arms
    checker = CollisionChecker(both)
    path = planners.plan(checker, [0, 0, 1, 0.5], [1.0, 0.5, 0.2, 1.5])
    whole = trajectory(both, path, acceleration=2.0, jerk=JERK, checker=checker)
    assert whole.certify(checker).verdict == Verdict.FREE
    halves = []
    for side in ("left", "right"):
        half = whole.part(side)
        assert half.names == arm.configuration_names
        assert (half.times == whole.times).all()
        assert half.certify(CollisionChecker(arm)).verdict == Verdict.FREE
        with pytest.raises(InputError, match="the unknown slide, lift"):
            half.certify(checker)
        half.save(tmp_path / f"{side}{ending}")
        halves.append(ControllerPoints.load(tmp_path / f"{side}{ending}"))
    assert (halves[0].times == halves[1].times).all()
    arrays = [
        np.hstack([getattr(half, kind) for half in halves]) for kind in ("positions", "velocities", "accelerations")
    ]
    names = [f"{side}/{name}" for side in ("left", "right") for name in arm.configuration_names]
    again = ControllerPoints(halves[0].times, *arrays, names=names)
    assert checker.certify_trajectory(again).verdict == Verdict.FREE
    if ending == ".csv":
        assert (again.times == whole.times).all()
        assert (again.positions == whole.knots).all()
    else:
        assert again.positions == pytest.approx(whole.positions(np.minimum(again.times, whole.duration)), abs=1e-14)


def test_parts_have_names(arms, moved):
    """Unknown parts are refused, and the message lists the parts; nested ones have longer names."""
    _, both = arms
    nested = Robot.join({"cell": both, "other": both})
    whole = trajectory(nested, [np.zeros(8), np.arange(8) / 8], acceleration=1.0)
    assert whole.part("cell").part("left").names == whole.part("cell/left").names == ("slide", "lift")
    assert (whole.part("other/right").knots == whole.knots[:, nested.part("other/right").columns]).all()
    with pytest.raises(UnknownNameError, match="part: expected one of cell, cell/left, .* found 'left'"):
        whole.part("left")
    with pytest.raises(UnknownNameError, match="part: expected one of .there are none.; found 'left'"):
        moved.part("left")
    with pytest.raises(UnknownNameError):
        whole.part(0)
    with pytest.raises(InputError, match="do not begin with another one and a slash, found 'a', 'a/b'"):
        Robot.join({"a": both, "a/b": both})


# -- lists of controllers -----------------------------------------------------------------------

ROS2 = """
controller_manager:
  ros__parameters:
    update_rate: 500
    joint_state_broadcaster: {type: joint_state_broadcaster/JointStateBroadcaster}
    slide_controller: {type: joint_trajectory_controller/JointTrajectoryController}
    turn_controller: {type: joint_trajectory_controller/JointTrajectoryController}
    forward: {type: forward_command_controller/ForwardCommandController}
slide_controller:
  ros__parameters:
    joints: [y, x]
    command_interfaces: [position]
    state_interfaces: [position, velocity]
    constraints: {goal_time: 0.5, x: {trajectory: 0.1}}
turn_controller: {ros__parameters: {joints: [turn], interpolation_method: splines}}
forward: {ros__parameters: {joints: [x, y, turn], interface_name: position}}
"""
MOVEIT = """
trajectory_execution: {allowed_start_tolerance: 0.01}
moveit_controller_manager: moveit_simple_controller_manager/MoveItSimpleControllerManager
moveit_simple_controller_manager:
  controller_names: [slide_controller, turn_controller]
  slide_controller: {type: FollowJointTrajectory, action_ns: follow_joint_trajectory, default: true, joints: [y, x]}
  turn_controller: {type: FollowJointTrajectory, action_ns: follow_joint_trajectory, joints: [turn]}
"""
LIST = """
controller_list:
- {name: slide_controller, action_ns: follow_joint_trajectory, type: FollowJointTrajectory, joints: [y, x]}
- {name: turn_controller, action_ns: follow_joint_trajectory, type: FollowJointTrajectory, joints: [turn]}
"""
SPACES = ROS2.replace("\ncontroller_manager:", "\n/cell/controller_manager:").replace("\nslide_c", "\n/cell/slide_c")
SPACES = SPACES.replace("\nturn_c", "\n/cell/turn_c").replace("\nforward", "\n/cell/forward")


def saved(each, folder, text, target="moved.yaml", **options):
    """Save with a list of controllers, without warnings, and read all files by the names of their controllers."""
    (folder / "controllers.yaml").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        each.save(folder / target, controllers=folder / "controllers.yaml", **options)
    found = [file for file in folder.iterdir() if file.name.startswith("moved")]
    return {file.name: ControllerPoints.load(file) for file in sorted(found)}


@pytest.mark.parametrize(("text", "prefix"), [(ROS2, ""), (MOVEIT, ""), (LIST, ""), (SPACES, "cell_")])
@pytest.mark.parametrize("kind", ["trajectory", "points"])
def test_a_file_for_each_controller(moved, tmp_path, text, prefix, kind):
    """Files of ros2_control and MoveIt, with namespaces: each trajectory controller gets its joints in its order."""
    each = moved if kind == "trajectory" else ControllerPoints(moved.times, moved.knots, names=moved.names)
    found = saved(each, tmp_path, text)
    assert {name: points.names for name, points in found.items()} == {
        f"moved.{prefix}slide_controller.yaml": ("y", "x"),
        f"moved.{prefix}turn_controller.yaml": ("turn",),
    }
    for points in found.values():
        columns = [NAMES.index(name) for name in points.names]
        assert points.positions == pytest.approx(moved.knots[:, columns], abs=1e-8)


def test_columns_that_rest_need_no_controller(robot, tmp_path):
    """A column that moves must have a controller; one that rests may have none."""
    text = "arm: {type: joint_trajectory_controller/JointTrajectoryController, joints: [x, y]}"
    resting = trajectory(robot, [[0, 0, 0.3], [0.5, 0.2, 0.3]], velocity=1.0, acceleration=3.0)
    assert list(saved(resting, tmp_path, text)) == ["moved.arm.yaml"]
    turning = trajectory(robot, [[0, 0, 0.3], [0.5, 0.2, 0.4]], velocity=1.0, acceleration=3.0)
    with pytest.raises(InputError, match=r"controllers: expected .* trajectory of turn, found none .*arm .*: x, y"):
        saved(turning, tmp_path, text)
    found = saved(turning, tmp_path, text.replace("x, y", "a, b"), joints=["x", "y"], names={"x": "a", "y": "b"})
    assert found["moved.arm.yaml"].names == ("a", "b")


def test_partial_goals(moved, tmp_path):
    """A controller with a joint that the file lacks takes it only if it allows partial goals."""
    text = "arm: {ros__parameters: {joints: [x, y, turn, finger]}}"
    with pytest.raises(InputError, match=r"all joints of arm \(x, y, turn, finger\), found none for finger among x, y"):
        saved(moved, tmp_path, text)
    found = saved(moved, tmp_path, text.replace("]", "], allow_partial_joints_goal: true"))
    assert found["moved.arm.yaml"].names == NAMES


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("", FileError, "an empty file"),
        ("[1, 2]", FileError, "expected controllers with joints, found none"),
        ("arm: {joints: [x, x]}", FileError, "arm/joints: joints: expected different names, found x again"),
        ("arm: {joints: []}", FileError, "expected different names, found none"),
        ("arm: {joints: x}", FileError, "expected a sequence"),
        ("arm: {joints: [x, y, turn]}\n/arm: {joints: [x]}", FileError, "expected joints of this controller once"),
        ("controller_names: [arm]\nleg: {joints: [x, y, turn]}", FileError, "found no entry arm"),
        ("arm: {type: a/JointTrajectoryController}", FileError, "expected the joints of arm, found none"),
        (
            "arm: {type: GripperCommand, joints: [x, y, turn]}",
            InputError,
            "take a trajectory of x, y, turn, found none",
        ),
        ("a: &a {b: *a, c: *a}", FileError, "a/b: expected no alias within itself"),
        ("arm: {joints: [$(var prefix)x]}", FileError, "names of joints, found .*prefix.x; replace"),
        ("arm: {joints: &j [x, *j]}", FileError, "expected a name"),
        ("controller_list: [{joints: [x, y, turn]}]", FileError, "expected the key name"),
        ("controller_names: [leg]\narm: {joints: [x]}\nleg: {joints: [y, turn]}", InputError, "trajectory of x, found"),
        ("a/b: {joints: [x, y, turn]}\na_b: {joints: [x]}", InputError, "whose files have different names"),
    ],
)
def test_bad_lists_of_controllers(moved, tmp_path, text, error, message):
    """A list that is broken, or whose controllers do not take the trajectory, is refused, and nothing is written."""
    with pytest.raises(error, match=message):
        saved(moved, tmp_path, text)
    assert [file.name for file in tmp_path.iterdir()] == ["controllers.yaml"]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("stiffness: 3", "no known settings of arm: stiffness"),
        ("interpolation_method: none", "jumps from point to point"),
    ],
)
def test_settings_that_are_not_used_are_mentioned(moved, tmp_path, more, message):
    """Unknown settings, and a controller that does not interpolate, cause a warning."""
    (tmp_path / "list.yaml").write_text(f"arm: {{ros__parameters: {{joints: [x, y, turn], {more}}}}}")
    with pytest.warns(UserWarning, match=message):
        moved.save(tmp_path / "a.yaml", controllers=tmp_path / "list.yaml")
