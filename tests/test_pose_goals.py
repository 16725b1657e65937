"""Poses of a link as goals of paths: one of many is enough, and what cannot be reached is an error that says so."""

import numpy as np
import pytest

from families import translation
from gantry import LEFT, UP, gantry, wall
from loewner import (
    CollisionChecker,
    InputError,
    PlanningError,
    PoseError,
    Robot,
    UnknownNameError,
    planners,
    save_scene,
)
from loewner.cli.main import main

BEHIND = np.array([0.5, -0.5, UP])


@pytest.fixture
def checker(tmp_path):
    urdf, srdf = gantry(tmp_path)
    return CollisionChecker(Robot.from_urdf(urdf, srdf=srdf), wall())


def rod(checker, q):
    return checker.robot.forward_kinematics(q)[checker.robot.link_names.index("rod")]


def test_a_pose_is_a_goal(checker):
    """The path ends where the link has the pose, and is proven; so does that of a roadmap."""
    goal = planners.PoseGoal("rod", rod(checker, BEHIND))
    path = planners.plan(checker, LEFT, goal)
    assert np.abs(rod(checker, path[-1]) - goal.T).max() < 1e-9
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == 0).all()
    path = planners.roadmap(checker, 300).path(LEFT, goal)
    assert np.abs(rod(checker, path[-1]) - goal.T).max() < 1e-9


def test_any_of_many_poses(checker):
    """One pose that can be reached is enough, and poses in an obstacle or out of reach are passed over."""
    in_wall, far = rod(checker, [0.0, -0.5, 0.0]), translation(x=5.0)
    path = planners.plan(checker, LEFT, planners.PoseGoal("rod", [far, in_wall, rod(checker, BEHIND)]))
    assert np.abs(path[-1][:2] - BEHIND[:2]).max() < 1e-9
    position = planners.PoseGoal("ball", translation(x=0.5, y=-0.5), tolerance=[0, 0, 0, *[np.inf] * 3])
    assert np.abs(planners.plan(checker, LEFT, position)[-1] - [0.5, -0.5, UP]).max() < 1e-9  # nothing else moves


def test_what_cannot_be_reached(checker):
    """The error says how near the link came, or what is in the way."""
    with pytest.raises(PlanningError, match=r"a pose that rod can reach .* 4e\+03 mm and \S+ rad away"):
        planners.plan(checker, LEFT, planners.PoseGoal("rod", translation(x=5.0)))
    with pytest.raises(PlanningError, match="one of 2 poses .* from pose 1"):
        planners.plan(checker, LEFT, planners.PoseGoal("rod", [translation(x=5.0), translation(x=4.0)]))
    with pytest.raises(PlanningError, match="collision of .*wall"):
        planners.plan(checker, LEFT, planners.PoseGoal("rod", rod(checker, [0.0, -0.5, 0.0])))
    blocked = planners.PoseGoal("rod", [translation(x=5.0), rod(checker, [0.0, -0.5, 0.0])])
    with pytest.raises(PlanningError, match="found none: solution 0 of pose 1: a collision of .*wall"):
        planners.plan(checker, LEFT, blocked)
    with pytest.raises(PlanningError, match="found none: solution 0 of pose 1: a collision of .*wall"):
        planners.roadmap(checker, 20).path(LEFT, blocked)


def test_bad_input(checker):
    """A bare pose is refused with the way to give one; a goal's link and poses are checked."""
    with pytest.raises(
        InputError, match=r"for poses of a link planners.PoseGoal\(link, T\); found poses, shape \(4, 4\)"
    ):
        planners.plan(checker, LEFT, np.eye(4))
    with pytest.raises(InputError, match="goal: expected an array"):
        planners.plan(checker, LEFT, [[1.0, 2.0], [3.0]])
    with pytest.raises(InputError, match="seeds: expected"):
        planners.PoseGoal("rod", np.eye(4), seeds=0)
    with pytest.raises(InputError, match="checker: expected"):
        planners.PoseGoal("rod", np.eye(4)).configurations(checker.robot, LEFT)
    with pytest.raises(UnknownNameError, match="link"):
        planners.plan(checker, LEFT, planners.PoseGoal("hand", np.eye(4)))
    with pytest.raises(PoseError, match="T: expected last row"):
        planners.plan(checker, LEFT, planners.PoseGoal("rod", np.zeros((4, 4))))
    with pytest.raises(InputError, match="expected one pose or more"):
        planners.plan(checker, LEFT, planners.PoseGoal("rod", np.zeros((0, 4, 4))))


def test_command(tmp_path, capsys, monkeypatch):
    """``loewner plan --goal-pose`` takes numbers or a file, and reports a pose that is out of reach."""
    monkeypatch.chdir(tmp_path)
    gantry(tmp_path)
    save_scene(wall(), "wall.yaml")
    np.save("poses.npy", [translation(x=5.0), translation(x=0.5, y=-0.5)])
    command = ["plan", "gantry.urdf", "--srdf", "gantry.srdf", "--scene", "wall.yaml", "--start", "-0.5 -0.5 1.57"]
    for pose in ("0.5 -0.5 0 1 0 0 0", "0.5 -0.5 0", "poses.npy"):
        assert main([*command, "--goal-pose", "rod", pose]) == 0
    assert "FREE" in capsys.readouterr().out
    assert main([*command, "--goal-pose", "rod", "5 0 0"]) == 1
    assert "mm and 0 rad away" in capsys.readouterr().err
    for pose, message in (("1 2", "expected x y z qw qx qy qz"), ("1 a 2", "expected numbers or a .npy file")):
        assert main([*command, "--goal-pose", "rod", pose]) == 2
        assert message in capsys.readouterr().err


def test_only_joints_that_move_the_link_move(checker):
    """Other joints, such as fingers that hold something, keep their values on the way, unless joints are named."""
    ball = checker.robot.forward_kinematics(BEHIND)[checker.robot.link_names.index("ball")]
    path = planners.plan(checker, LEFT, planners.PoseGoal("ball", ball), simplify=False)
    assert len(path) > 2
    assert (path[:, 2] == UP).all()


def test_no_bound_is_claimed_for_poses(checker):
    """Configurations that were not tried may reach the pose at less cost."""
    found = planners.plan(checker, LEFT, planners.PoseGoal("rod", rod(checker, BEHIND)), full=True)
    assert found.bound == 0.0
    assert found.gap == np.inf
