"""Robots joined to one, on a base that moves, or with a body on a joint: each part answers as it does alone."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from checker_oracle import pose, random_robot, simple_bodies
from loewner import Body, CollisionChecker, InputError, PoseError, Robot, Scene, UnknownNameError, Verdict, planners
from motion_oracle import example

ARM = """<robot name="arm"><link name="rail"/>
<link name="cart"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
<link name="forearm"><collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision></link><link name="tip"/>
<joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/><limit lower="0" upper="2" velocity="1"/>
<axis xyz="1 0 0"/></joint>
<joint name="elbow" type="continuous"><parent link="cart"/><child link="forearm"/><origin xyz="0 0 0.4" rpy="1 2 3"/>
<axis xyz="0 1 0"/></joint>
<joint name="hold" type="fixed"><parent link="forearm"/><child link="tip"/><origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/>
</joint></robot>"""


@pytest.fixture
def arm():
    return Robot.from_urdf(text=ARM)


@pytest.fixture(scope="module")
def panda():
    return example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")


def rows(robot, part):
    return [robot.link_names.index(name) for name in part.link_names]


@pytest.mark.parametrize("seed", range(5))
def test_parts_are_where_they_are_alone(seed, tmp_path):
    """Poses of links, configurations within limits, and collisions within a part, of random robots at random poses."""
    rng = np.random.default_rng(seed)
    parts = {}
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        parts[name] = random_robot(rng, tmp_path / name, 5, simple_bodies(rng))
    poses = {"a": pose(rng, 50.0), "c": pose(rng, 50.0)}
    robot = Robot.join(parts, poses)
    assert robot.dof == sum(part.dof for part in parts.values())
    Q = robot.random_configurations(50, seed)
    found, hits = robot.forward_kinematics(Q), CollisionChecker(robot).collide(Q)
    each = []
    for name in parts:
        part = robot.part(name)
        alone = part.robot.forward_kinematics(Q[:, part.columns])
        np.testing.assert_array_equal(found[:, rows(robot, part)], alone)
        expected = parts[name].placed(poses[name]) if name in poses else parts[name]
        np.testing.assert_array_equal(alone, expected.forward_kinematics(Q[:, part.columns]))
        assert part.joint_names == tuple(f"{name}/{joint}" for joint in parts[name].joint_names)
        each.append(
            CollisionChecker(part.robot).collide(Q[:, part.columns]) if part.robot.bodies else np.zeros(50, bool)
        )
    # Tens of metres apart, none meets another: but for two at the origin, all that collide do so alone.
    np.testing.assert_array_equal(hits, np.any(each, axis=0))


def test_names_groups_states_and_pairs_are_kept(panda):
    """All with the prefix of their part; robots that are joined again are nested."""
    both = Robot.join({"left": panda, "right": panda}, {"right": np.eye(4)})
    assert both.configuration_names[:1] == ("left/panda_joint1",)
    assert both.groups.keys() == {f"{side}/{group}" for side in ("left", "right") for group in panda.groups}
    assert len(both.disabled_pairs) == 2 * len(panda.disabled_pairs)
    state, (_, values) = next(iter(panda.states.items()))
    q = both.configuration(f"right/{state}")
    np.testing.assert_array_equal(q[both.part("right").columns], panda.configuration(state))
    assert both.states[f"right/{state}"][1].keys() == {f"right/{joint}" for joint in values}
    assert both.mimics.keys() == {f"{side}/{joint}" for side in ("left", "right") for joint in panda.mimics}
    more = Robot.join({"cell": both, "third": panda})
    assert more.part("cell/right").columns == slice(panda.dof, 2 * panda.dof)
    assert more.part("third").columns == slice(2 * panda.dof, 3 * panda.dof)
    assert more.add_base("planar").part("third").columns == slice(2 * panda.dof + 3, 3 * panda.dof + 3)
    assert more.part("cell/right").link_names[0] == "cell/right/" + panda.link_names[0]


def test_adjacent_pairs_of_a_part_without_an_srdf_stay_skipped(arm, panda):
    """As if it were alone, although the other part disables pairs of its own."""
    both = Robot.join({"arm": arm, "panda": panda}, {"panda": [[1, 0, 0, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]})
    assert ("arm/cart", "arm/forearm") in both.disabled_pairs
    pairs = CollisionChecker(both).checked_pairs
    alone = CollisionChecker(arm).checked_pairs + CollisionChecker(panda).checked_pairs
    across = sum(a.startswith("arm") != b.startswith("arm") for a, b in pairs)
    assert len(pairs) - across == len(alone)
    assert across > 0


def test_two_arms_are_planned_together(panda):
    """A path on which each crosses the other's place, every motion proven; alone they would meet."""
    T = np.eye(4)
    T[:2, :2], T[0, 3] = [[-1, 0], [0, -1]], 0.7
    both = Robot.join({"left": panda, "right": panda}, {"right": T})
    checker = CollisionChecker(both)
    Q = both.random_configurations(400, 3)
    Q = Q[~checker.collide(Q)][:8]
    paths = [planners.plan(checker, a, b) for a, b in zip(Q[:-1], Q[1:], strict=True)]
    for path in paths:
        assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    assert max(map(len, paths)) > 2


def test_a_pose_replaces_an_earlier_one(arm):
    """And is not added to it; a joined robot is placed as a whole."""
    rng = np.random.default_rng(0)
    first, second, q = pose(rng, 1.0), pose(rng, 1.0), [0.3, 0.4]
    once, twice = arm.placed(second), arm.placed(first).placed(second)
    np.testing.assert_array_equal(twice.forward_kinematics(q), once.forward_kinematics(q))
    np.testing.assert_array_equal(once.placed(None).forward_kinematics(q), arm.forward_kinematics(q))
    both = Robot.join({"a": arm, "b": arm}, {"b": first})
    moved = both.placed(second).forward_kinematics([0.3, 0.4] * 2)
    np.testing.assert_allclose(moved, second @ both.forward_kinematics([0.3, 0.4] * 2), atol=1e-12)
    outer = Robot.join({"c": arm, "d": both.placed(first)}, {"d": second})
    for whole, name in ((both.placed(first).placed(second), "b"), (outer, "d/b"), (outer, "d")):
        part, Q = whole.part(name), whole.random_configurations(1, seed=1)[0]
        numbers = [whole.link_names.index(link) for link in part.link_names]
        alone = part.robot.forward_kinematics(Q[part.columns])
        np.testing.assert_allclose(alone, whole.forward_kinematics(Q)[numbers], atol=1e-12)


def test_bodies_in_the_world_stay_there(arm):
    """A robot is placed, or put on a base, before bodies are added in the world; they would move with it."""
    door = arm.with_body("door", Body.box([0.1, 0.1, 0.1]), joint="revolute", limits=(0, 1))
    for call in (
        lambda: door.placed(None),
        lambda: door.add_base("planar"),
        lambda: Robot.join({"a": door}, {"a": None}),
    ):
        with pytest.raises(InputError, match="without bodies in the world.*'door'.*call with_body afterwards"):
            call()
    assert Robot.join({"a": door, "b": arm}).dof == door.dof + arm.dof
    held = arm.with_body("tool", Body.box([0.1, 0.1, 0.1]), joint="fixed", parent=arm.link_names[-1])
    assert held.add_base("planar").dof == arm.dof + 3


# -- bases ----------------------------------------------------------------------------------------


def test_a_planar_base_carries_the_robot(arm):
    """Along x and y, then about z; within bounds; from where the robot stood."""
    rng = np.random.default_rng(0)
    stood = arm.placed(pose(rng, 1.0))
    robot = stood.add_base("planar", [[-2, 1], [-3, -1]])
    assert robot.configuration_names == ("base/x", "base/y", "base/theta", "slide", "elbow")
    assert robot.lower.tolist()[:3] == [-2, -3, -np.inf]
    assert robot.upper.tolist()[:3] == [1, -1, np.inf]
    Q = robot.random_configurations(30)
    T = np.tile(np.eye(4), (30, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("z", Q[:, 2:3]).as_matrix()
    T[:, :2, 3] = Q[:, :2]
    expected = T[:, None] @ stood.forward_kinematics(Q[:, 3:])
    np.testing.assert_allclose(robot.forward_kinematics(Q)[:, -4:], expected, atol=1e-12)
    assert robot.adjacent_pairs == arm.adjacent_pairs


def test_a_mobile_arm_is_planned(arm):
    """Around a wall, the base included."""
    robot, scene = arm.add_base("planar", [[-3, 3], [-3, 3]]), Scene()
    scene.add("wall", Body.box([0.1, 3.0, 2.0]), [[1, 0, 0, 0], [0, 1, 0, 0.0], [0, 0, 1, 0], [0, 0, 0, 1]])
    checker = CollisionChecker(robot, scene)
    path = planners.plan(checker, [-2.8, 0, 0, 0, 0], [1, 0, 0, 0, 0])
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    assert len(path) > 2


def test_a_floating_base_has_limits(arm):
    """Of its position; an attached body moves with it, and one that is fixed to the base's root is static."""
    robot = arm.add_base("floating", [[-1, 1], [-2, 2], [0, 3]], name="free")
    assert robot.configuration_names[:7] == tuple(f"free/{v}" for v in ("x", "y", "z", "qw", "qx", "qy", "qz"))
    assert robot.lower[:7].tolist() == [-1, -2, 0, -1, -1, -1, -1]
    Q = robot.random_configurations(100)
    assert Q[:, 2].min() >= 0
    scene = Scene()
    for name, link in (("held", "rail"), ("still", "free/world")):
        scene.add(name, Body.sphere(0.1))
        scene.attach(name, link)
    ready = CollisionChecker(robot, scene)._ready()
    assert dict(zip(ready.names, ready._stand.tolist(), strict=True))["still"]
    assert not dict(zip(ready.names, ready._stand.tolist(), strict=True))["held"]


# -- bodies ---------------------------------------------------------------------------------------


def test_a_body_on_a_joint_of_a_link(arm):
    """Moves with the link and turns about its own axis; a fixed parent is a frame like any other."""
    rng = np.random.default_rng(0)
    T, axis = pose(rng, 0.3), rng.normal(size=3)
    for parent in ("tip", "forearm", "rail", None):
        robot = arm.with_body("tool", Body.sphere(0.1), T, joint="revolute", parent=parent, axis=axis, limits=(-1, 2))
        Q = robot.random_configurations(20)
        poses = robot.forward_kinematics(Q)
        turn = np.tile(np.eye(4), (20, 1, 1))
        turn[:, :3, :3] = Rotation.from_rotvec(Q[:, 2:] * axis / np.linalg.norm(axis)).as_matrix()
        above = np.eye(4) if parent is None else poses[:, robot.link_names.index(parent)]
        np.testing.assert_allclose(poses[:, -1], above @ T @ turn, atol=1e-12)
        assert (robot.lower[2], robot.upper[2]) == (-1, 2)
        assert (("forearm", "tool") in robot.adjacent_pairs) == (parent == "forearm")


@pytest.mark.parametrize("joint", ["fixed", "prismatic", "revolute", "continuous", "planar", "floating"])
def test_bodies_on_every_kind_of_joint_are_checked(joint, arm):
    """In the cart's way or beside it, as a body of the scene at the same pose."""
    limits = (-1.0, 1.0) if joint in ("prismatic", "revolute") else None
    for x, hit in ((1.0, True), (9.0, False)):
        T = np.eye(4)
        T[0, 3] = x
        robot = arm.with_body("box", Body.box([0.1, 0.1, 0.1]), T, joint=joint, limits=limits)
        q = robot.configuration({"slide": 1.0})
        assert CollisionChecker(robot).collide(q) is hit


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda arm: Robot.join({}), InputError, "parts"),
        (lambda arm: Robot.join([arm]), InputError, "parts"),
        (lambda arm: Robot.join({"": arm}), InputError, "names"),
        (lambda arm: Robot.join({"a": 1}), InputError, "'a': expected loewner.Robot"),
        (lambda arm: Robot.join({"a": arm}, {"b": np.eye(4)}), UnknownNameError, "part in poses"),
        (lambda arm: Robot.join({"a": arm}, {"a": np.ones((4, 4))}), PoseError, "T_world_base"),
        (lambda arm: arm.part("left"), UnknownNameError, "part"),
        (lambda arm: arm.add_base("wheels"), UnknownNameError, "kind"),
        (lambda arm: arm.add_base("planar", [[0, 1]]), InputError, "bounds"),
        (lambda arm: arm.add_base("planar", [[0, 1], [1, 0]]), InputError, "a lower and an upper"),
        (lambda arm: arm.add_base("planar", name=""), InputError, "name"),
        (lambda arm: arm.add_base("planar").add_base("planar"), InputError, "base/"),
        (lambda arm: arm.with_body("cart", Body.sphere(1.0)), InputError, "'cart' twice"),
        (lambda arm: arm.with_body("elbow", Body.sphere(1.0)), InputError, "'elbow' twice"),
        (lambda arm: arm.with_body("b", "sphere"), InputError, "loewner.Body"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), joint="ball"), UnknownNameError, "joint"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), parent="hand"), UnknownNameError, "parent"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), axis=[0, 0, 0]), InputError, "axis"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), joint="revolute"), InputError, "limits"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), limits=(0, 1)), InputError, "limits"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), joint="revolute", limits=(1, 0)), InputError, "a lower"),
        (lambda arm: arm.with_body("b", Body.sphere(1.0), np.ones((4, 4))), PoseError, "T_parent_joint"),
    ],
)
def test_bad_input_is_named(call, error, message, arm):
    """What is no robot, base or joint is refused, saying what was expected."""
    with pytest.raises(error, match=message):
        call(arm)


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_limits_of_joints_with_several_values_are_not_dropped_silently(kind):
    """URDF does not define them: a warning says so, and where bounds can be set."""
    text = f"""<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="{kind}"><parent link="a"/>
    <child link="b"/><limit lower="-1" upper="1"/></joint></robot>"""
    with pytest.warns(UserWarning, match=f"<limit> of the {kind} joint 'j' is ignored.*add_base"):
        Robot.from_urdf(text=text)


def test_what_a_joined_robot_looks_like(tmp_path: Path):
    """The viewer reads each part's own description, and names links with their prefix."""
    from loewner.viewer.visuals import visual_meshes

    looks = '<link name="rail"><visual><geometry><sphere radius="0.2"/></geometry></visual></link>'
    text = ARM.replace('<link name="rail"/>', looks)
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    both = Robot.join({"a": Robot.from_urdf(path), "b": Robot.from_urdf(text=text)}).add_base("planar")
    meshes, faults = visual_meshes(both)
    assert meshes.keys() == {"a/rail", "b/rail"}
    assert not faults
