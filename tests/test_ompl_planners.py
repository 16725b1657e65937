"""OMPL's planners: their paths are proven too, and OMPL is judged by the checker alone."""

import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

from families import translation
from gantry import LEFT, RIGHT, UP, clearance, gantry
from loewner import (
    Body,
    CollisionChecker,
    MissingExtraError,
    PlanningError,
    Scene,
    UnknownNameError,
    Verdict,
    planners,
)

RESOLUTION = 0.02


@pytest.fixture(autouse=True)
def _ompl_is_there():
    pytest.importorskip("ompl")


NAMES = (
    "AORRTC", "BFMT", "BITstar", "BKPIECE1", "FMT", "InformedRRTstar", "KPIECE1", "LBKPIECE1", "PRM", "PRMstar", "RRT",
    "RRTConnect", "RRTstar", "SORRTstar",
)  # fmt: skip


def in_time(*asked, **options):
    """A plan in a time that some planners use up, and with more of it on a machine that is busy."""
    for timeout in (0.1, 4.0):
        with suppress(PlanningError):
            return planners.plan(*asked, timeout=timeout, **options)
    return planners.plan(*asked, timeout=40.0, **options)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("simplify", [False, pytest.param(True, marks=pytest.mark.verify)])
def test_every_planner_goes_around_the_wall(checker, name, simplify):
    """Paths start and end where they should, stay within the limits, and never touch the wall."""
    path = in_time(checker, LEFT, RIGHT, joints="slide", planner=name, resolution=RESOLUTION, simplify=simplify)
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, RIGHT])
    np.testing.assert_array_equal(path[:, 2], UP)
    assert (np.abs(path[:, :2]) <= 1).all()
    assert path[:, 1].max() > 0.5
    assert clearance(path) > 0
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()


def test_motions_may_be_looked_at_instead(checker):
    """Between two configurations that are looked at the ball may cut the wall's corner by less than half a step."""
    path = planners.plan(
        checker, LEFT, RIGHT, joints="slide", planner="RRTConnect", certified=False, resolution=RESOLUTION
    )
    assert clearance(path) > -RESOLUTION / 2
    assert checker.valid_edges(path[:-1], path[1:], RESOLUTION).all()


def test_equal_seeds_give_equal_paths(checker):
    """In one process, one after the other, with another between."""
    first, other, second = (
        planners.plan(checker, LEFT, RIGHT, joints="slide", planner="RRTConnect", seed=seed) for seed in (5, 6, 5)
    )
    np.testing.assert_array_equal(first, second)
    assert first.shape != other.shape or (first != other).any()


def test_goals_may_be_turns_away(checker):
    """OMPL's planners take joints without limits by their values, and end exactly at the goal."""
    goal = np.array([0.5, -0.5, UP + 4 * np.pi])
    path = planners.plan(checker, LEFT, goal, planner="RRTConnect")
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, goal])


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


@pytest.mark.parametrize("name", ["RRTConnect", "RRT", "RRTstar"])
def test_no_path_is_an_error(robot, name):
    """Where the wall leaves no gap; a path that only comes near the goal does not count."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    with pytest.raises(PlanningError, match=rf"none by {name} within 0\.1 s"):
        planners.plan(CollisionChecker(robot, scene), LEFT, RIGHT, joints="slide", planner=name, timeout=0.1)


def test_paths_are_checked_again(checker):
    """A planner that takes every motion for free finds the way through the wall; the error names the motion."""
    from ompl import base, geometric

    class Anything(base.MotionValidator):
        def checkMotion(self, *_):
            return True

    def careless(information):
        information.setMotionValidator(Anything(information))
        return geometric.RRTConnect(information)

    message = (
        "path of OMPL's planner: .* from row 0 to row 1, on which (ball|rod) and wall collide .* at the fraction 0"
    )
    for certified in (True, False):
        with pytest.raises(PlanningError, match=message):
            planners.plan(checker, LEFT, RIGHT, joints="slide", planner=careless, certified=certified)


def test_missing_package_is_named(checker, monkeypatch):
    """Without OMPL the error names the package to install."""
    monkeypatch.setitem(sys.modules, "ompl", None)
    for ask in (
        lambda: planners.plan(checker, LEFT, RIGHT, planner="RRTConnect"),
        lambda: planners.space_information(checker),
    ):
        with pytest.raises(MissingExtraError, match=r"OMPL: pip install \"loewner\[planners\]\""):
            ask()
    assert len(planners.plan(checker, LEFT, RIGHT)) >= 2  # the compiled planner needs none


@pytest.mark.parametrize(
    ("name", "message"),
    [("RRTconnect", "did you mean 'RRTConnect'"), ("PathSimplifier", "planner: expected one of AORRTC, BFMT")],
)
def test_unknown_planners(checker, name, message):
    """A planner that OMPL does not have is refused with those that it has."""
    with pytest.raises(UnknownNameError, match=message):
        planners.plan(checker, LEFT, RIGHT, planner=name)


def test_what_cannot_be_settled_is_not_free(checker, undecided):
    """A configuration without a proof is never passed through."""
    information = planners.space_information(checker, joints="slide", fixed=LEFT)
    state = information.allocState()
    state[0:2] = LEFT[:2].tolist()
    assert information.isValid(state)
    assert information.checkMotion(state, state)
    undecided(checker)
    assert not information.isValid(state)
    assert not information.checkMotion(state, state)


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
    proofs = planners.space_information(checker, joints=["y", "x"], fixed=LEFT, certified=True)
    moves = [proofs.checkMotion(a, b) for a, b in zip(states[:-1], states[1:], strict=True)]
    np.testing.assert_array_equal(moves, checker.certify_edges(Q[:-1], Q[1:]).verdict == Verdict.FREE)


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
        "print(planners.plan(checker, [0, 0, 0], [0.5, 0.5, 1.0], planner='RRTConnect').shape[1])\n"
        "information = planners.space_information(checker)\n"
        "del information\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == "3\n"
    assert "nanobind" not in done.stderr
    assert "RRTConnect" not in done.stderr
