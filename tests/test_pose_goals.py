"""Poses of a link as goals of paths: one of many is enough, and what cannot be reached is an error that says so."""

from dataclasses import replace

import numpy as np
import pytest

from families import translation
from gantry import LEFT, RADIUS, RIGHT, UP, gantry, wall
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    PlanningError,
    PoseError,
    Scene,
    UnknownNameError,
    Verdict,
    planners,
    save_scene,
)
from loewner.cli.main import main
from loewner.planners import PoseGoal, pose_goals
from motion_oracle import example

BEHIND = np.array([0.5, -0.5, UP])


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


def test_names_of_joints_may_come_from_an_iterator(checker):
    """Names are asked for once, although the poses and the space both need them."""
    names, goal = checker.robot.joint_names, PoseGoal("rod", rod(checker, BEHIND))
    found = goal.configurations(checker, LEFT, joints=list(names))
    np.testing.assert_array_equal(goal.configurations(checker, LEFT, joints=iter(names)), found)
    path = planners.plan(checker, LEFT, goal, joints=list(names))
    np.testing.assert_array_equal(planners.plan(checker, LEFT, goal, joints=iter(names)), path)


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


# -- approach and retreat -----------------------------------------------------------------------


def ball(checker, q):
    return checker.robot.forward_kinematics(q)[..., checker.robot.link_names.index("ball"), :, :]


def free(checker, path):
    return (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()


def test_a_path_ends_with_its_approach(checker):
    """The approach ends at the pose and the retreat begins there; both are displaced as given, and proven."""
    goal = PoseGoal("rod", rod(checker, BEHIND), approach=[0.2, 0.1, 0.0], retreat=("world", [0.0, -0.3, 0.0]))
    found = planners.plan(checker, LEFT, goal, full=True)
    at = [rod(checker, q) for q in (found.path[found.approach], found.path[-1], found.retreat[-1])]
    assert np.abs(at[1] - goal.T).max() < 1e-9
    assert np.abs(at[1][:3, :3].T @ (at[1] - at[0])[:3, 3] - [0.2, 0.1, 0.0]).max() < 1e-9
    assert np.abs((at[2] - at[1])[:3, 3] - [0, -0.3, 0]).max() < 1e-9
    assert np.array_equal(found.retreat[0], found.path[-1])
    assert free(checker, found.path)
    assert free(checker, found.retreat)
    assert np.array_equal(planners.plan(checker, LEFT, goal), found.path)
    assert np.abs(goal.approach_path(checker, found.path[-1]) - found.path[found.approach :]).max() < 1e-9
    assert np.abs(goal.retreat_path(checker, found.path[-1]) - found.retreat).max() < 1e-9
    path = planners.roadmap(checker, 300).path(LEFT, goal)
    assert np.abs(rod(checker, path[-1]) - goal.T).max() < 1e-9
    assert free(checker, path)
    assert np.abs(rod(checker, path[-2])[:3, :3] - goal.T[:3, :3]).max() < 1e-9
    assert planners.plan(checker, LEFT, replace(goal, approach=None), full=True).approach is None
    assert planners.plan(checker, LEFT, replace(goal, retreat=None), full=True).retreat is None


def test_a_number_is_a_distance_along_z():
    """An approach goes forward along the link's z axis, and a retreat back; with a tolerance, from where it is."""
    panda = CollisionChecker(example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"))
    robot, q = panda.robot, panda.robot.configuration("default")
    number = robot.link_names.index("panda_hand")
    T = robot.forward_kinematics(q)[number]
    goal = PoseGoal("panda_hand", T, tolerance=[0, 0, 0, 0.2, 0.2, np.pi], approach=0.1, retreat=0.05)
    found = planners.plan(panda, robot.random_configurations(1, seed=3)[0], goal, full=True)
    begin, end, away = robot.forward_kinematics(np.stack([*found.path[[found.approach, -1]], found.retreat[-1]]))[
        :, number
    ]
    assert np.abs(begin[:3, 3] - end[:3, 3] + 0.1 * end[:3, 2]).max() < 1e-9
    assert np.abs(away[:3, 3] - end[:3, 3] + 0.05 * end[:3, 2]).max() < 1e-9
    moved = planners.trajectory(
        robot, found.path, acceleration=2.0, checker=panda, line=planners.Line("panda_hand", found.approach)
    )
    at = moved.positions(moved.stops)
    assert (at == found.path[found.approach]).all(axis=1).any()
    assert len(moved.stops) < len(found.path) - found.approach - 1


def test_as_explicit_loops(monkeypatch):
    """The configurations are those of loops over `reach` and `straight`, and the message counts the others."""
    monkeypatch.setattr(pose_goals, "MOST_GOALS", 10_000)
    robot = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    scene, link = Scene(margin=0.002), "panda_hand"
    scene.add("shelf", Body.boxes([[0.6, 0, 0.3], [0.6, 0, 0.75]], [[0.4, 0.8, 0.02], [0.4, 0.8, 0.02]]))
    scene.add("post", Body.box([0.04, 0.04, 0.4]), translation(0.45, 0.1, 0.5))
    checker, start = CollisionChecker(robot, scene), robot.configuration("default")
    forward = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    poses = np.stack([translation(x, y, 0.5) for x in (0.5, 0.6) for y in (-0.2, 0.0, 0.2)])
    poses[:, :3, :3] = forward
    reached = robot.reach(link, poses, start=start, checker=checker, all=True, seeds=16)
    candidates = [q for Q, n in zip(reached.solutions, reached.free, strict=True) for q in Q[:n]]
    many = sum(map(len, reached.solutions))
    for approach, up in ((0.15, 0.05), (None, 0.12), (0.1, 0.4)):
        good = []
        for q in candidates:
            T = robot.forward_kinematics(q)[robot.link_names.index(link)]
            ends = [] if approach is None else [T @ translation(0, 0, -approach)]
            try:
                for end in (*ends, translation(0, 0, up) @ T):
                    planners.straight(checker, q, link, end)
            except PlanningError:
                continue
            good.append(q)
        goal = PoseGoal(link, poses, seeds=16, approach=approach, retreat=("world", [0, 0, up]))
        if good:
            found = goal.configurations(checker, start)
            assert sorted(found.round(9).tolist()) == sorted(np.array(good).round(9).tolist())
            assert len(good) < len(candidates)
        else:
            with pytest.raises(PlanningError, match="free approach and retreat of panda_hand, found") as caught:
                goal.configurations(checker, start)
            told = str(caught.value)
            assert f"found {many} that reach the goal" in told
            assert f"{many - len(candidates)} in collision (" in told
            assert " blocked on the retreat (" in told


def test_what_has_no_approach_or_retreat(checker):
    """The message counts the configurations by what is in the way, and names the bodies or the joint."""
    pose = ball(checker, RIGHT)
    with pytest.raises(
        PlanningError, match=r"free approach of ball, found 1 .*: 1 blocked on the approach \(.*wall.*at the"
    ):
        planners.plan(checker, LEFT, PoseGoal("ball", pose, approach=[0.9, 0, 0]))
    with pytest.raises(PlanningError, match=r"found 1 .*: 1 unable to follow the retreat \(.* fraction 0.8333: "):
        planners.plan(checker, LEFT, PoseGoal("ball", pose, retreat=[0.6, 0, 0]))
    with pytest.raises(PlanningError, match=r"found 1 .*: 1 in collision \(ball and wall\)"):
        planners.plan(checker, LEFT, PoseGoal("ball", ball(checker, np.zeros(3)), retreat=[0.6, 0, 0]))
    goal = PoseGoal("ball", pose, approach=[0.9, 0, 0], retreat=[0.6, 0, 0])
    with pytest.raises(PlanningError, match="approach: expected a free line that ball can follow, found that .*wall"):
        goal.approach_path(checker, RIGHT)
    with pytest.raises(PlanningError, match="retreat: expected a free line that ball can follow, found that it cannot"):
        goal.retreat_path(checker, RIGHT)


def test_contact_at_the_goal(checker):
    """Contact is allowed at the end of an approach by `reach`, and at the start of a retreat by `leave`, only."""
    touching = np.array([0.05 + RADIUS - 2e-6, -0.5, UP])
    goal = PoseGoal("ball", ball(checker, touching), approach=[-0.3, 0, 0], retreat=[0.2, 0, 0])
    with pytest.raises(PlanningError, match="in collision"):
        planners.plan(checker, RIGHT, goal)
    checker.scene.reach("ball", "wall")
    with pytest.raises(PlanningError, match="blocked on the retreat"):
        planners.plan(checker, RIGHT, goal)
    checker.scene.leave("ball", "wall")
    found = planners.plan(checker, RIGHT, goal, full=True)
    assert np.abs(ball(checker, found.path[-1]) - goal.T).max() < 1e-9
    assert free(checker, found.path[:-1])
    assert free(checker, found.path[-2:])
    assert not checker.collide(found.path[:-1]).any()
    # Another contact where the approach begins, or where the retreat ends, is none that ends or begins there.
    for lines in ({"approach": [0, -0.1, 0]}, {"retreat": [0, 0.1, 0]}):
        with pytest.raises(PlanningError, match="blocked on the .*contact where the line"):
            planners.plan(checker, RIGHT, PoseGoal("ball", goal.T, **lines))
    with pytest.raises(PlanningError, match="in collision"):
        planners.plan(checker, RIGHT, goal, joint_error=1e-3)


def test_joint_errors_and_axes_count_on_the_approach(checker):
    """An approach is proven within the joint error, and keeps the axis that the path keeps."""
    near = np.array([0.05 + RADIUS + 2e-3, -0.5, UP])
    goal = PoseGoal("ball", ball(checker, near), approach=[-0.2, 0, 0])
    assert planners.plan(checker, RIGHT, goal, joint_error=1e-3)[-1] == pytest.approx(near)
    with pytest.raises(PlanningError, match="blocked on the approach"):
        planners.plan(checker, RIGHT, goal, joint_error=3e-3)
    keep = ("rod", "x", [0, 1, 0], 0.1)
    path = planners.plan(checker, RIGHT, goal, keep=keep)
    assert np.abs(path[:, 2] - UP).max() <= 0.1
    with pytest.raises(PlanningError, match="blocked on the approach .the axis does not keep its direction"):
        planners.plan(checker, RIGHT, goal, keep=("rod", "x", [1, 0, 0], 0.1))


def test_whole_turns(checker):
    """Where a joint turns without limits, the approach is whole turns from the solution, like the goal, and proven."""
    start = RIGHT + [0, 0, 4 * np.pi]
    goal = PoseGoal("rod", rod(checker, BEHIND), approach=[0.1, 0, 0], retreat=[-0.1, 0, 0])
    found = planners.plan(checker, start, goal, full=True)
    assert found.path[-1, 2] == pytest.approx(UP + 4 * np.pi)
    assert np.array_equal(found.retreat[0], found.path[-1])
    assert free(checker, found.path)
    assert np.abs(np.diff(found.path[:, 2])).max() < 4


def test_bad_approaches(checker):
    """Each bad displacement is refused with its name; plans in time have none."""
    for name in ("approach", "retreat"):
        for bad in (0.0, -0.1, np.inf, True, [0, 0, 0], [0, 1], ("up", [0, 0, 1]), ("world", 0.1), "z", [np.nan, 0, 0]):
            with pytest.raises((InputError, UnknownNameError), match=name):
                PoseGoal("ball", np.eye(4), **{name: bad})
        with pytest.raises(InputError, match=f"{name}: expected PoseGoal"):
            getattr(PoseGoal("ball", np.eye(4)), f"{name}_path")(checker, RIGHT)
        goal = PoseGoal("ball", ball(checker, RIGHT), **{name: [0, 0, 0.1]})
        with pytest.raises(InputError, match="no approach or retreat in a plan in time"):
            planners.plan(checker, LEFT, goal, start_time=0.0, velocity=1.0)
