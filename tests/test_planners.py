"""Planners: paths that are free, from start to goal, or an error that says why there is none."""

import subprocess
import sys

import numpy as np
import pytest

from families import translation
from gantry import RADIUS, gantry
from loewner import (
    Body,
    CollisionChecker,
    ConvergenceError,
    InputError,
    MissingExtraError,
    PlanningError,
    Robot,
    Scene,
    UnknownNameError,
    planners,
)

RESOLUTION = 0.02

FLOATING = """<robot name="f"><link name="world"/>
<link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="arm"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="fly" type="floating"><parent link="world"/><child link="ball"/></joint>
<joint name="bend" type="revolute"><parent link="ball"/><child link="arm"/><origin xyz="1 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>"""

UP = np.pi / 2  # the rod beside the ball, along y
LEFT, RIGHT = np.array([-0.5, -0.5, UP]), np.array([0.5, -0.5, UP])
IN_WALL = np.array([0.0, -0.5, UP])


@pytest.fixture(autouse=True)
def _ompl_is_there():
    pytest.importorskip("ompl")


@pytest.fixture
def robot(tmp_path):
    urdf, srdf = gantry(tmp_path)
    return Robot.from_urdf(urdf, srdf=srdf)


@pytest.fixture
def scene():
    """A wall along y, 0.1 m thick, that ends at y = 0.5."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    return scene


@pytest.fixture
def checker(robot, scene):
    return CollisionChecker(robot, scene)


def clearance(path, until=0.5):
    """Least distance of the ball to the wall, by geometry in the plane, on the path in steps of 1 mm or less."""
    steps = [np.linspace(a, b, 2000) for a, b in zip(path[:-1], path[1:], strict=True)]
    x, y = np.concatenate(steps)[:, :2].T
    return np.hypot(np.maximum(np.abs(x) - 0.05, 0), np.maximum(y - until, 0)).min() - RADIUS


NAMES = (
    "AORRTC", "BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "PRM", "PRMstar", "RRT",
    "RRTConnect", "RRTstar", "SORRTstar",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("simplify", [False, True])
def test_every_planner_goes_around_the_wall(checker, name, simplify):
    """Paths start and end where they should, stay within the limits, and pass the wall's end."""
    path = planners.plan(
        checker, LEFT, RIGHT, joints="slide", planner=name, timeout=0.4, resolution=RESOLUTION, simplify=simplify
    )
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, RIGHT])
    np.testing.assert_array_equal(path[:, 2], UP)
    assert (np.abs(path[:, :2]) <= 1).all()
    assert path[:, 1].max() > 0.5
    # Between two configurations that are checked the ball may cut the wall's corner by less than half a step.
    assert clearance(path) > -RESOLUTION / 2
    assert checker.valid_edges(path[:-1], path[1:], RESOLUTION).all()


def test_simplified_paths_are_shorter(checker):
    """Simplifying shortens a path, but never below the shortest way around the wall."""
    long, short = (
        planners.plan(checker, LEFT, RIGHT, joints="slide", resolution=RESOLUTION, simplify=s) for s in (False, True)
    )
    length = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in (long, short)]
    assert length[1] < length[0]
    # The ball has to pass above the wall's end, at (0, 0.5 + RADIUS), give or take half a step.
    assert length[1] >= 2 * np.hypot(0.5, 1.0 + RADIUS - RESOLUTION / 2)


def test_equal_seeds_give_equal_paths(checker):
    """In one process, one after the other, with another between."""
    first, other, second = (planners.plan(checker, LEFT, RIGHT, joints="slide", seed=seed) for seed in (5, 6, 5))
    np.testing.assert_array_equal(first, second)
    assert first.shape != other.shape or (first != other).any()


def test_all_joints_move_by_default(checker):
    """The rod's joint turns without limits, and the goal may be turns away."""
    goal = np.array([0.5, -0.5, UP + 4 * np.pi])
    path = planners.plan(checker, LEFT, goal, resolution=RESOLUTION)
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, goal])


def test_names_of_joints_and_of_one_joint(checker):
    """Joints by name; what is not named keeps the start's value."""
    turned = np.array([-0.5, -0.5, 2.0])
    for joints in ("turn", ["turn"]):
        path = planners.plan(checker, LEFT, turned, joints=joints)
        np.testing.assert_array_equal(path[:, :2], LEFT[:2] + np.zeros((len(path), 2)))


def test_any_of_several_goals_will_do(checker):
    """Goals in the wall or outside the limits are passed over."""
    outside = np.array([1.5, 0.0, UP])
    path = planners.plan(checker, LEFT, [IN_WALL, outside, RIGHT], joints="slide")
    np.testing.assert_array_equal(path[-1], RIGHT)


def test_start_is_the_goal(checker):
    """From a configuration to itself the path stays there, and has two rows at least."""
    path = planners.plan(checker, LEFT, LEFT, joints="slide")
    np.testing.assert_array_equal(path, [LEFT] * len(path))
    assert len(path) >= 2


def test_own_planner(checker):
    """A function may make the planner."""
    from ompl import geometric

    made = []

    def make(information):
        made.append(geometric.RRTConnect(information))
        made[0].setRange(0.2)
        return made[0]

    path = planners.plan(checker, LEFT, RIGHT, joints="slide", planner=make, simplify=False)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.2 + 1e-12
    assert made[0].getRange() == 0.2


# -- no path ------------------------------------------------------------------------------------


def test_colliding_start_and_goal_name_the_pairs(checker):
    """A start or goal in collision is refused with the pairs that meet."""
    with pytest.raises(PlanningError, match="start: .* collision of ball and wall, rod and wall"):
        planners.plan(checker, [-0.12, -0.5, 0.0], RIGHT)
    with pytest.raises(PlanningError, match="goal: .* collision of ball and wall"):
        planners.plan(checker, LEFT, IN_WALL, joints="slide")
    with pytest.raises(PlanningError, match=r"goal: .* found none: goal\[0\]: .*wall.*; goal\[1\]: x = 2 outside -1"):
        planners.plan(checker, LEFT, [IN_WALL, [2, 0, UP]], joints="slide")


def test_outside_the_limits(checker):
    """A start or goal outside the joint limits is refused with joint, value and limits."""
    with pytest.raises(PlanningError, match=r"start: .* x = -1\.5 outside -1 \.\. 1, y = 2 outside"):
        planners.plan(checker, [-1.5, 2.0, 0.0], RIGHT)
    with pytest.raises(PlanningError, match=r"goal: .* y = 7 outside -1 \.\. 1"):
        planners.plan(checker, LEFT, [0.5, 7.0, UP])


def test_limits_are_looked_at_before_all_else(checker):
    """To start and goal in degrees, what the joints that stay differ by is not to the point."""
    start, goal = np.degrees([0.1, 0.2, UP]), np.degrees([0.3, 0.2, -UP])
    with (
        pytest.warns(UserWarning, match="in millimetres|in degrees"),
        pytest.raises(PlanningError, match=r"start: .* x = 5\.7.* outside -1 \.\. 1"),
    ):
        planners.plan(checker, start, goal, joints="slide")
    with pytest.raises(PlanningError, match=r"goal: .* x = 17.* outside -1 \.\. 1"):
        planners.plan(checker, LEFT, goal, joints="slide")
    with pytest.raises(InputError, match="expected the start's value"):
        planners.plan(checker, LEFT, [0.5, -0.5, 0.0], joints="slide")


@pytest.mark.parametrize("name", ["RRTConnect", "RRT", "RRTstar"])
def test_no_path_is_an_error(robot, name):
    """Where the wall leaves no gap; a path that only comes near the goal does not count."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    with pytest.raises(PlanningError, match=rf"none by {name} within 0\.2 s"):
        planners.plan(CollisionChecker(robot, scene), LEFT, RIGHT, joints="slide", planner=name, timeout=0.2)


def test_paths_are_checked_again(checker):
    """A planner that takes every motion for free finds the straight way through the wall, and is found out."""
    from ompl import base, geometric

    class Anything(base.MotionValidator):
        def checkMotion(self, *_):
            return True

    def careless(information):
        information.setMotionValidator(Anything(information))
        return geometric.RRTConnect(information)

    with pytest.raises(PlanningError, match="fails when it is checked again"):
        planners.plan(checker, LEFT, RIGHT, joints="slide", planner=careless)


def test_what_cannot_be_settled_is_not_free(checker, monkeypatch):
    """A configuration without a proof is never passed through."""

    def unsettled(*_, **__):
        raise ConvergenceError("not settled")

    information = planners.space_information(checker, joints="slide", fixed=LEFT)
    state = information.allocState()
    state[0:2] = LEFT[:2].tolist()
    assert information.isValid(state)
    assert information.checkMotion(state, state)
    monkeypatch.setattr(checker, "collide", unsettled)
    monkeypatch.setattr(checker, "valid_edges", unsettled)
    assert not information.isValid(state)
    assert not information.checkMotion(state, state)
    with pytest.raises(PlanningError, match="start: .*cannot be proven free: not settled"):
        planners.plan(checker, LEFT, RIGHT)


# -- bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"joints": "slid"}, UnknownNameError, "did you mean 'slide'"),
        ({"joints": ["x", "z"]}, UnknownNameError, "joints: expected one of x, y, turn; found 'z'"),
        ({"joints": []}, InputError, "joints: expected one or more, found none"),
        ({"joints": "nothing"}, InputError, "found none in group 'nothing'"),
        ({"joints": "y"}, InputError, r"goal: .*-0\.5, of x, .*found 0\.5"),
        ({"planner": "RRTconnect"}, UnknownNameError, "did you mean 'RRTConnect'"),
        ({"planner": "PathSimplifier"}, UnknownNameError, "planner: expected one of AORRTC, BFMT"),
        ({"timeout": 0}, InputError, "timeout: expected a finite number > 0"),
        ({"resolution": -1.0}, InputError, "resolution: expected a finite number > 0"),
        ({"seed": -1}, InputError, "seed: expected an integer"),
        ({"seed": 0.5}, InputError, "seed: expected an integer"),
    ],
)
def test_bad_options(checker, options, error, message):
    """Every bad option is refused by its name, with what was expected."""
    with pytest.raises(error, match=message):
        planners.plan(checker, LEFT, RIGHT, **options)


def test_bad_configurations(checker, robot):
    """Start and goals of wrong shapes, and what is no checker, are refused by name."""
    with pytest.raises(InputError, match=r"start: expected one configuration, shape \(3,\)"):
        planners.plan(checker, [LEFT], RIGHT)
    with pytest.raises(InputError, match=r"goal: expected shape \(\.\.\., 3\)"):
        planners.plan(checker, LEFT, RIGHT[:2])
    with pytest.raises(InputError, match=r"goal: expected shape \(3,\) or \(goals, 3\), found \(0, 3\)"):
        planners.plan(checker, LEFT, np.zeros((0, 3)))
    with pytest.raises(InputError, match="checker: expected loewner.CollisionChecker, found Robot"):
        planners.plan(robot, LEFT, RIGHT)


def test_floating_joints_have_no_limits_to_search_within(tmp_path):
    """They can stand still, but not be planned over."""
    (tmp_path / "f.urdf").write_text(FLOATING)
    robot = Robot.from_urdf(tmp_path / "f.urdf")
    checker = CollisionChecker(robot)
    q, goal = robot.configuration(), robot.configuration({"bend": 0.5})
    with pytest.raises(InputError, match="found 'fly', which is planar or floating"):
        planners.plan(checker, q, goal)
    np.testing.assert_array_equal(planners.plan(checker, q, goal, joints="bend")[-1], goal)


def test_missing_package_is_named(checker, monkeypatch):
    """Without OMPL the error names the package to install."""
    monkeypatch.setitem(sys.modules, "ompl", None)
    for ask in (lambda: planners.plan(checker, LEFT, RIGHT), lambda: planners.space_information(checker)):
        with pytest.raises(MissingExtraError, match=r"OMPL: pip install \"loewner\[planners\]\""):
            ask()


# -- space_information --------------------------------------------------------------------------


def test_states_and_motions_are_the_checkers(checker, scene, rng):
    """What OMPL is told agrees with the checker, also after the scene has changed."""
    information = planners.space_information(checker, joints=["y", "x"], fixed=LEFT, resolution=RESOLUTION)
    space = information.getStateSpace()
    assert [space.getDimensionName(k) for k in range(space.getDimension())] == ["x", "y"]
    states = [information.allocState() for _ in range(60)]
    values = rng.uniform(-1, 1, (60, 2))
    for state, value in zip(states, values, strict=True):
        state[0:2] = value.tolist()
    Q = np.column_stack([values, np.full(60, LEFT[2])])
    seen = []
    for x in (0.0, 0.6):
        scene.move("wall", translation(x, -1.5))
        valid = [information.isValid(state) for state in states]
        np.testing.assert_array_equal(valid, ~checker.collide(Q))
        moves = [information.checkMotion(a, b) for a, b in zip(states[:-1], states[1:], strict=True)]
        np.testing.assert_array_equal(moves, checker.valid_edges(Q[:-1], Q[1:], RESOLUTION))
        assert 0 < sum(valid) < 60
        assert 0 < sum(moves) < 59
        seen.append(valid)
    assert seen[0] != seen[1]


def test_bounds_are_the_limits(checker):
    """A state outside them is not valid; a joint without limits has half a turn to both sides."""
    information = planners.space_information(checker, fixed=LEFT)
    bounds = information.getStateSpace().getBounds()
    np.testing.assert_allclose(bounds.low, [-1, -1, -np.pi / 2])
    np.testing.assert_allclose(bounds.high, [1, 1, 3 * np.pi / 2])
    state = information.allocState()
    state[0:3] = [-1.01, -0.5, 1.0]
    assert not information.isValid(state)
    state[0:3] = [-0.99, -0.5, 1.0]
    assert information.isValid(state)


def test_planning_is_silent_and_frees_all(tmp_path):
    """OMPL writes nothing, and no object of its bindings is left to complain about when the program ends."""
    gantry(tmp_path)
    program = (
        "import loewner; from loewner import planners\n"
        "robot = loewner.Robot.from_urdf('gantry.urdf')\n"
        "checker = loewner.CollisionChecker(robot)\n"
        "print(planners.plan(checker, [0, 0, 0], [0.5, 0.5, 1.0]).shape[1])\n"
        "information = planners.space_information(checker)\n"
        "del information\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "3\n"
    assert "nanobind" not in done.stderr
    assert "RRTConnect" not in done.stderr
