"""Plans that keep an axis of a link near a direction: at every sample, by a bound that mutants break."""

import numpy as np
import pytest

from interpreted_kernels import interpreted, source_of
from loewner import CollisionChecker, InputError, PlanningError, Scene, UnknownNameError, planners
from loewner.robots.description.robot import chain_to
from test_lines import ARMS, DENSE, cases, with_bodies
from test_reach import example

ANGLE = 0.3


@pytest.fixture(scope="module")
def sampled():
    """Motions, an axis and a direction for each, and the least cosine of samples."""
    rng, made = np.random.default_rng(3), []
    for robot, link, q0, q1 in cases():
        kept = rng.normal(size=(2, 3))
        kept /= np.linalg.norm(kept, axis=1, keepdims=True)
        R = robot.forward_kinematics(q0 + DENSE[:, None] * (q1 - q0))[:, robot.link_names.index(link), :3, :3]
        made.append((chain_to(robot, link), kept, q0, q1, (R @ kept[0] @ kept[1]).min()))
    return made


def broken(kernel, sampled):
    """How many motions have samples below the bound, and the least difference of the two."""
    gaps = []
    for chain, (axis, direction), q0, q1, least in sampled:
        q, d = (0.5 * (q0 + q1))[chain.columns], (q1 - q0)[chain.columns]
        gaps.append(least - kernel.least_cosine(chain.links, chain.constants, tuple(axis), tuple(direction), q, d))
    return sum(gap < 0 for gap in gaps), min(gaps)


def test_bound_holds(sampled):
    """No sample is below the bound, which is attained up to 1e-5."""
    count, least = broken(interpreted("robots.lines"), sampled)
    assert count == 0
    assert least < 1e-5


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.5 * absolute(slope)", "0.49 * absolute(slope)"),
        ("0.125 * absolute(bend)", "0.1 * absolute(bend)"),
        ("+ (1.0 + SPARE) * cube / 48.0", ""),
        ("dot(direction, a) - fall", "dot(direction, a)"),
        ("dot(direction, cross(m.turn, a))", "dot(direction, m.turn)"),
    ],
)
def test_mutants_of_the_bound_are_found(old, new, sampled):
    """If a factor or a term of the bound is dropped, some sample is below it."""
    text = source_of("robots.lines")
    assert text.count(old) == 1
    assert broken(interpreted("robots.lines", text.replace(old, new)), sampled)[0] > 0


@pytest.fixture(scope="module")
def upright():
    """A checker of an arm, and configurations at which the hand's z axis points in one direction."""
    robot, link = ARMS["turning"]
    T = np.tile(robot.forward_kinematics(np.full(6, 0.4))[robot.link_names.index(link)], (12, 1, 1))
    up = T[0, :3, 2].copy()
    T[:, :3, 3] += np.random.default_rng(5).uniform(-0.4, 0.4, (12, 3))
    found = robot.reach(link, T, tolerance=[0, 0, 0, 0, 0, np.inf])
    return with_bodies(robot), up, found.configuration[found.reached]


def tilt(robot, path, up):
    """The largest angle between the hand's z axis and a direction, of samples of a path."""
    Q = robot.between(path[:-1, None], path[1:, None], np.linspace(0, 1, 100))
    number = robot.link_names.index("hand")
    return np.arccos(np.minimum(robot.forward_kinematics(Q)[..., number, :3, 2] @ up, 1.0)).max()


@pytest.mark.parametrize("options", [{}, {"simplify": False}, {"improve_iterations": 3}, {"certified": False}])
def test_plans_keep_the_axis(upright, options):
    """No sample of a path tilts the hand by more than the angle, although some straight motion does."""
    checker, up, ends = upright
    solved = bent = 0
    for q, goal in zip(ends[:-1], ends[1:], strict=True):
        bent += tilt(checker.robot, np.array([q, goal]), up) > ANGLE
        try:
            path = planners.plan(checker, q, goal, keep=("hand", "z", up, ANGLE), max_iterations=300, **options)
        except PlanningError:
            continue
        solved += 1
        assert np.array_equal(path[[0, -1]], [q, goal])
        assert tilt(checker.robot, path, up) <= ANGLE
    assert solved >= 3
    assert bent >= 3


def test_ur5_with_its_tool_down():
    """All pairs that can be connected are: wrist 2 on one side, the sum of three joints within a turn."""
    robot = example("ur_description/urdf/ur5_robot.urdf")
    checker = CollisionChecker(robot, Scene())
    rng = np.random.default_rng(0)
    down = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (12, 1, 1))
    angle, radius = rng.uniform(0, 2 * np.pi, 12), rng.uniform(0.35, 0.6, 12)
    down[:, :3, 3] = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.1, 0.5, 12)], axis=1)
    found = robot.reach("tool0", down, checker=checker)
    ends = found.configuration[found.reached]
    side, turn = np.sin(ends[:, 4]) > 0, np.rint(ends[:, 1:4].sum(axis=1) / np.pi)
    pairs = [(a, b) for a in range(len(ends)) for b in range(a) if side[a] == side[b] and turn[a] == turn[b]]
    assert len(pairs) >= 5
    for a, b in pairs:
        path = planners.plan(checker, ends[a], ends[b], keep=("tool0", "z", [0, 0, -1], 0.2), max_iterations=3000)
        Q = robot.between(path[:-1, None], path[1:, None], np.linspace(0, 1, 50))
        assert robot.forward_kinematics(Q)[..., robot.link_names.index("tool0"), 2, 2].max() <= -np.cos(0.2)


def test_ends_that_do_not_keep_the_axis(upright):
    """They are errors that state the angle; a goal among several is left out."""
    checker, up, ends = upright
    tilted = np.full(6, 0.9)
    with pytest.raises(PlanningError, match=r"start: expected hand to keep within 0.3 rad .*, found \d"):
        planners.plan(checker, tilted, ends[0], keep=("hand", "z", up, ANGLE))
    with pytest.raises(PlanningError, match=r"goal: expected hand to keep within 0.3 rad .*, found \d"):
        planners.plan(checker, ends[0], tilted, keep=("hand", "z", up, ANGLE))
    path = planners.plan(checker, ends[0], [tilted, ends[0]], keep=("hand", "z", up, ANGLE))
    assert np.array_equal(path[-1], ends[0])


def test_bad_input(upright):
    """Each bad argument is refused with its name."""
    checker, up, ends = upright
    for keep in (("hand", "z", up), ("hand", "w", up, 0.1), ("hand", "z", 0 * up, 0.1), ("hand", "z", up, 0.0), 3):
        with pytest.raises((InputError, UnknownNameError), match="keep"):
            planners.plan(checker, ends[0], ends[1], keep=keep)
    with pytest.raises(UnknownNameError, match="link"):
        planners.plan(checker, ends[0], ends[1], keep=("hands", "z", up, 0.1))
    with pytest.raises(InputError, match="keep: expected the compiled planner"):
        planners.plan(checker, ends[0], ends[1], keep=("hand", "z", up, 0.1), planner="RRT")
