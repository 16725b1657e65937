"""Lines that a link keeps along trajectories: no instant strays farther than the tolerance, by bounds of curves."""

import sys
from math import comb
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gantry import gantry_robot
from loewner import CollisionChecker, InputError, PlanningError, UnknownNameError
from loewner.planners import Line, kept_lines, straight, trajectory
from motion_oracle import example
from sampling import examples
from test_lines import ARMS, TIGHT, with_bodies

CASES = {**ARMS, **{name: (robot, "tool") for name, robot in TIGHT.items()}}
DENSE = np.linspace(0.0, 1.0, 401)


@pytest.fixture(scope="module")
def slides(tmp_path_factory):
    """A checker of a ball that slides along x and y."""
    return CollisionChecker(gantry_robot(tmp_path_factory.mktemp("gantry")))


@pytest.fixture(scope="module")
def panda():
    return CollisionChecker(example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"))


def poses_of(robot, link, Q):
    return robot.forward_kinematics(Q)[..., robot.link_names.index(link), :, :]


def off_line(T0, T1, u, T):
    """Positions and rotation matrices of poses less those of a line at fractions, by SciPy."""
    turn = Rotation.from_matrix(T1[:3, :3] @ T0[:3, :3].T).as_rotvec()
    R = Rotation.from_rotvec(u[:, None] * turn).as_matrix() @ T0[:3, :3]
    return T[:, :3, 3] - T0[:3, 3] - u[:, None] * (T1[:3, 3] - T0[:3, 3]), T[:, :3, :3] - R


def strayed(robot, link, ends, Q, position, rotation):
    """Largest deviations of configurations from a line, as shares of the tolerances, at the nearest of many poses."""
    (T0, T1), T = poses_of(robot, link, ends), poses_of(robot, link, Q)
    way, turn = T1[:3, 3] - T0[:3, 3], Rotation.from_matrix(T1[:3, :3] @ T0[:3, :3].T).as_rotvec()
    # The nearest pose is known either by the position or by the rotation, up to a tolerance.
    if position * np.linalg.norm(turn) <= rotation * np.linalg.norm(way):
        guess, reach = (T[:, :3, 3] - T0[:3, 3]) @ way / (way @ way), position / np.linalg.norm(way)
    else:
        turns = Rotation.from_matrix(T[:, :3, :3] @ T0[:3, :3].T).as_rotvec()
        guess, reach = turns @ turn / (turn @ turn), rotation / np.linalg.norm(turn)
    worst = np.full(len(T), np.inf)
    for shift in np.linspace(-reach, reach, 101):
        off, turned = off_line(T0, T1, np.clip(guess + shift, 0, 1), T)
        angle = 2 * np.arcsin(np.minimum(np.linalg.norm(turned, axis=(1, 2)) / np.sqrt(8), 1.0))
        worst = np.minimum(worst, np.maximum(np.linalg.norm(off, axis=1) / position, angle / rotation))
    return worst.max()


def inside(moved):
    """Speeds at the middle of all pieces but the first and the last, and at the knots between."""
    return np.abs(np.concatenate([moved.rates[1:-1], moved.velocities((moved.times[1:] + moved.times[:-1])[1:-1] / 2)]))


# -- bounds -------------------------------------------------------------------------------------


def courses():
    """Random courses of all kinds of joints, with lines between the poses of two configurations."""
    rng = np.random.default_rng(5)
    for robot, link in CASES.values():
        for degree in (1, 2, 3):
            for size in (0.01, 0.3, 0.8):
                a = rng.uniform(-1.5, 1.5, robot.dof)
                b = a + size * rng.uniform(-1, 1, robot.dof)
                bulge = size * rng.uniform(-1, 1, (degree + 1, robot.dof)) * (degree > 1)
                points = a + np.linspace(0, 1, degree + 1)[:, None] * (b - a) + bulge
                yield robot, link, np.stack([a, b]), np.column_stack([points, np.linspace(0, 1, degree + 1) ** 2])


@pytest.fixture(scope="module")
def measured():
    """The courses beside the largest deviations and second differences of samples."""
    made = []
    for robot, link, ends, course in courses():
        degree, s = len(course) - 1, DENSE[:, None]
        at = sum(comb(degree, k) * s**k * (1 - s) ** (degree - k) * course[k] for k in range(degree + 1))
        off = off_line(*poses_of(robot, link, ends), at[:, -1], poses_of(robot, link, at[:, :-1]))
        off = [each.reshape(len(DENSE), -1) for each in off]
        largest = [np.linalg.norm(each, axis=1).max() for each in off]
        bends = [np.linalg.norm(np.diff(each, 2, axis=0), axis=1).max() * (len(DENSE) - 1) ** 2 for each in off]
        made.append((robot, link, ends, course[None], np.array([largest, bends])))
    return made


def broken(module, measured, most=None):
    """How many courses deviate more than by the bounds, and the least of bound over second difference.

    The search ends with a number of courses that do, if one is given.
    """
    count, tightest = 0, np.inf
    for robot, link, ends, course, (largest, bends) in measured:
        line = module.KeptLine.of(robot, module.Line(link, 0, 1), ends)
        bent, astray = (each[0] for each in line._bounds(course, np.zeros((1, robot.dof))))
        count += (bends > bent * (1 + 1e-4) + 1e-7).any()
        for parts in (1, 3):
            count += (largest > line._gaps(course, parts)[0] + astray + bent / (8 * parts**2)).any()
        if most is not None and count >= most:
            break
        tightest = min(tightest, *(bent / np.maximum(bends, 1e-9)))
    return count, tightest


def test_bounds_hold(measured):
    """No sample of a course deviates more than the bound, which single joints attain within 1 %."""
    count, tightest = broken(kept_lines, measured)
    assert count == 0
    assert tightest < 1.01


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2 * rate * turn + bend", "rate * turn + bend"),
        ("2 * rate * turn + bend", "2 * rate * turn"),
        ("pull + size * (turn * turn + turn_bend)", "pull + size * (turn * turn)"),
        ("pull + size * (turn * turn + turn_bend)", "pull + size * turn_bend"),
        ("turn, turn_bend, turn_off = turn + rate, turn_bend + bend", "turn, turn_bend, turn_off = rate, bend"),
        ("+ lengths(self.way) * u_bend", ""),
        ("turn * turn + turn_bend + line_bend", "turn * turn + turn_bend"),
        ("(abs(step.multiplier) * each[:, step.column]", "(each[:, step.column]"),
        ("degree * (degree - 1) * np", "degree * np"),
        ("size + value\n", "size\n"),
    ],
)
def test_mutants_of_the_bounds_are_found(old, new, measured, monkeypatch):
    """If a factor or a term of the bound is dropped, some course deviates more."""
    text = Path(kept_lines.__file__).read_text()
    assert text.count(old) == 1
    mutant = ModuleType("mutant")
    monkeypatch.setitem(sys.modules, "mutant", mutant)  # data classes look their module up
    exec(compile(text.replace(old, new), "mutant", "exec"), vars(mutant))
    assert broken(mutant, measured, most=1)[0] > 0


def test_courses_are_divided_until_they_are_proven(slides):
    """A course that needs many parts is proven, one that leaves the line is not, and joint errors count."""
    robot, link = TIGHT["turn and slide"], "tool"
    ends = np.array([[0.0, 0.0], [0.2, 0.1]])
    course = np.column_stack([ends, [0, 1]])[None]
    off = np.zeros((1, 2))
    _, found = kept_lines.KeptLine.of(robot, Line(link, 0, 1, 1.0, 1.0), ends).keeps(course, off)
    at = poses_of(robot, link, ends[0] + DENSE[:, None] * (ends[1] - ends[0]))
    exact = np.linalg.norm(off_line(*poses_of(robot, link, ends), DENSE, at)[0], axis=1).max()
    for share, wanted in ((1.001, True), (0.999, False)):
        line = kept_lines.KeptLine.of(robot, Line(link, 0, 1, share * exact, 1.0), ends)
        kept, bound = line.keeps(course, off)
        assert kept[0] == wanted
        assert (bound[0, 0] <= share * exact) == wanted
        assert not line.keeps(course, off + 0.01 * exact)[0]
    assert found[0, 0] > exact


# -- trajectories -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ARMS)
@examples(2, 5)
@given(
    seed=st.integers(0, 2**32 - 1), tolerance=st.sampled_from([1e-4, 1e-3, 1e-2]), jerk=st.sampled_from([None, 50.0])
)
def test_no_instant_strays(kind, seed, tolerance, jerk):
    """At every sample of a trajectory the link is within the tolerances of the line, and is not stopped on it."""
    robot, link = ARMS[kind]
    checker, rng = with_bodies(robot), np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, robot.dof)
    T = poses_of(robot, link, q + rng.uniform(-0.1, 0.1, robot.dof))
    try:
        path = straight(checker, q, link, T, position=tolerance, rotation=10 * tolerance)
    except PlanningError:
        return
    line = Line(link, position=tolerance, rotation=10 * tolerance)
    options = {"velocity": 1.0, "acceleration": 2.0, "jerk": jerk, "checker": checker}
    moved = trajectory(checker.robot, path, line=line, **options)
    Q = moved.positions(np.append(np.linspace(0, moved.duration, 500), moved.times))
    assert strayed(robot, link, path[[0, -1]], Q, tolerance, 10 * tolerance) <= 1 + 1e-2  # fractions have steps
    assert len(moved.stops) == 0
    assert moved.duration <= trajectory(checker.robot, path, **options).duration * (1 + 1e-9)
    if len(path) > 2:
        assert inside(moved).max(axis=1).min() > 1e-3


def test_an_approach_of_a_panda_does_not_stop(panda):
    """A hand goes forward by 12 cm in less than half the time of stops, and stays within 0.1 mm of the line."""
    robot, q = panda.robot, panda.robot.configuration("default")
    T = poses_of(robot, "panda_hand", q).copy()
    T[:3, 3] += 0.12 * T[:3, 2]
    path = straight(panda, q, "panda_hand", T)
    assert len(path) > 5
    for jerk in (None, 100.0):
        options = {"acceleration": 2.0, "jerk": jerk}
        stopping = trajectory(robot, path, line="panda_hand", **options)
        moved = trajectory(robot, path, checker=panda, line="panda_hand", **options)
        assert len(stopping.stops) == len(path) - 2
        assert (len(moved.stops), len(moved.blends)) == (0, len(path) - 2)
        assert moved.duration < 0.5 * stopping.duration
        assert inside(moved).max(axis=1).min() > 1e-3
        Q = moved.positions(np.linspace(0, moved.duration, 1000))
        assert strayed(robot, "panda_hand", path[[0, -1]], Q, 1e-4, 1e-3) <= 1


def test_stops_at_the_ends_of_lines(slides):
    """The robot rests at both ends of a line, also within a straight motion, and cuts corners elsewhere."""
    rows = np.array([[0, 0, 0], [0.2, 0, 0], [0.5, 0, 0], [0.5, 0, 0], [0.5, 0.4, 0], [0, 0.4, 0.5]])
    options = {"velocity": 1.0, "acceleration": 2.0, "checker": slides}
    moved = trajectory(slides.robot, rows, line=Line("ball", 1, 3), **options)
    assert np.array_equal(moved.positions(moved.stops), rows[[1, 2]])
    assert len(moved.blends) == 1
    both = trajectory(slides.robot, rows, line=[Line("ball", 1, -3), Line("ball", 3, 4)], **options)
    assert np.array_equal(both.positions(both.stops), rows[[1, 2, 4]])
    assert len(trajectory(slides.robot, rows, **options).blends) == 2


@pytest.mark.parametrize("jerk", [None, 20.0])
def test_blends_that_are_not_proven_are_halved(slides, jerk, monkeypatch):
    """A blend that leaves the line is halved until it is proven; the robot stops where none is."""
    rows = np.array([[0, 0, 0], [0.5, 0.1, 0], [1, 0, 0], [1.5, 0.1, 0], [2, 0, 0]]) - [1, 0, 0]
    options = {"velocity": 1.0, "acceleration": 0.2, "jerk": jerk, "checker": slides}
    line, keeps, sizes = Line("ball", position=0.2), kept_lines.KeptLine.keeps, []

    def nothing_long(self, courses, off):
        kept, found = keeps(self, courses, off)
        if courses.shape[1] > 2:
            size = np.ptp(courses[..., 0], axis=1)
            sizes.append(size.max())
            kept &= size < 0.05
        return kept, found

    whole = trajectory(slides.robot, rows, line=line, **options)
    monkeypatch.setattr(kept_lines.KeptLine, "keeps", nothing_long)
    less = trajectory(slides.robot, rows, line=line, **options)
    assert (len(whole.blends), len(less.blends)) == (3, 3)
    assert np.diff(less.blends, axis=1).max() < np.diff(whole.blends, axis=1).min()
    assert len(sizes) == 5
    monkeypatch.setattr(kept_lines.KeptLine, "keeps", lambda *a: (keeps(*a)[0] & (a[1].shape[1] == 2), keeps(*a)[1]))
    assert len(trajectory(slides.robot, rows, line=line, **options).stops) == 3


def test_paths_off_the_line_are_refused(slides):
    """The error states the deviation, which is exact for slides, and between which rows it is."""
    robot = slides.robot
    rows = np.array([[0, 0, 0], [0, 0, 0], [0.2, 0, 0], [0.5, 0.01, 0], [1, 0, 0.3]])
    with pytest.raises(
        PlanningError,
        match=r"line: expected ball to keep within 0.005 m and 0.001 rad .* from row 1 to row 4, found deviations of "
        r"up to 0.01 m and \S+ rad between rows [23] and [34]$",
    ):
        trajectory(robot, rows, velocity=1.0, line=Line("ball", 1, 4, position=5e-3))
    assert len(trajectory(robot, rows, velocity=1.0, line=Line("ball", position=0.0101)).stops) == 2
    with pytest.raises(PlanningError, match="rod to keep within .* rad between rows [23] and [34]"):
        trajectory(robot, rows, velocity=1.0, line=Line("rod", 0, 4, position=0.02, rotation=0.1))
    # Forward, back and forward again is on the line; farther than to its ends is not.
    rows = np.array([[0, 0, 0], [0.7, 0, 0], [0.3, 0, 0], [1, 0, 0]])
    assert len(trajectory(robot, rows, velocity=1.0, checker=slides, line="ball").blends) == 3 - 1
    with pytest.raises(PlanningError, match="up to 0.5 m"):
        trajectory(robot, [[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], velocity=1.0, line="ball")
    # A link that is to rest may rest.
    assert trajectory(robot, [[0, 0, 0], [0, 0, 1]], velocity=1.0, line="ball").duration > 0


def test_bad_input(slides):
    """Each bad argument is refused with its name."""
    robot, rows = slides.robot, [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]]
    with pytest.raises(UnknownNameError, match="link"):
        trajectory(robot, rows, velocity=1.0, line="hand")
    for line in (3, [3], [None]):
        with pytest.raises(InputError, match="line: expected"):
            trajectory(robot, rows, velocity=1.0, line=line)
    for first, last in ((0, 3), (2, 1), (1, 1), (-4, 2), (0, -4)):
        with pytest.raises(InputError, match="line: expected two of the 3 rows of the path"):
            trajectory(robot, rows, velocity=1.0, line=Line("ball", first, last))
    with pytest.raises(InputError, match="line: expected a turn of less than half a turn"):
        trajectory(robot, [[0, 0, 0], [0, 0, np.pi]], velocity=1.0, line="rod")
    with pytest.raises(InputError, match="link: expected one that the joints move"):
        trajectory(robot, rows, velocity=1.0, line="base")
    for options in ({"position": 0.0}, {"position": 1e-12}, {"rotation": 4.0}, {"rotation": np.nan}, {"first": 0.5}):
        with pytest.raises(InputError, match=f"{next(iter(options))}: expected"):
            Line("ball", **options)
    with pytest.raises(InputError, match="link: expected the name of a link, found 3"):
        Line(3)
    assert trajectory(robot, rows, velocity=1.0, line=[]).duration == trajectory(robot, rows, velocity=1.0).duration
