"""Robots of links and joints in memory are those that a URDF describes; bad links and joints are refused by name."""

import math
import re
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from families import random_poses
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    Joint,
    LoewnerError,
    PoseError,
    Robot,
    UnknownNameError,
    Verdict,
    planners,
)
from loewner.robots.description.urdf import read_urdf
from robot_oracle import robots_folder
from test_robot_exports import LIMITS, SLED, expect_same_back

BALL, CUBE = Body.sphere(0.1), Body.box([0.2, 0.2, 0.2])


def shift(x, y, z):
    """The pose that only shifts."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def in_memory(text):
    """The robot of a URDF's kinematics, as data, and with a ball on each link that has shapes."""
    described = read_urdf("URDF text", text)
    joints = [
        Joint(
            j.name, j.kind, j.parent, j.child, j.origin, None, j.axis,
            j.lower, j.upper,
            velocity=None if math.isnan(j.velocity) else j.velocity,
            acceleration=None if math.isnan(j.acceleration) else j.acceleration,
            jerk=None if math.isnan(j.jerk) else j.jerk,
            mimic=j.mimic and (j.mimic.joint, j.mimic.multiplier, j.mimic.offset),
        )
        for j in described.joints.values()
    ]  # fmt: skip
    links = {link: BALL if shapes else None for link, shapes in described.shapes.items()}
    return Robot.from_links(links, joints, name=described.name)


@pytest.mark.parametrize(
    "name",
    ["sled", "panda_description/urdf/panda.urdf", "tiago_pro_description/robots/tiago_pro.urdf",
     "pr2_description/urdf/pr2.urdf"],
)  # fmt: skip
def test_is_the_robot_of_a_urdf(name):
    """Kinematics, names, limits, rates, mimics and adjacent pairs are those of the URDF that has the same joints."""
    text = SLED if name == "sled" else (robots_folder() / name).read_text()
    if name == "sled":
        text = text.replace('<safety_controller soft_lower_limit="-0.5" soft_upper_limit="1.5" k_velocity="1"/>', "")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours = in_memory(text)
        theirs = Robot.from_urdf(text=without_meshes(text))
    assert ours.link_names == theirs.link_names
    assert ours.configuration_names == theirs.configuration_names
    assert (ours.mimics, ours.adjacent_pairs) == (theirs.mimics, theirs.adjacent_pairs)
    for limit in LIMITS:
        if "hard" in limit or name == "sled":
            np.testing.assert_array_equal(getattr(ours, limit), getattr(theirs, limit), err_msg=limit)
    for a, b in zip(ours.tree, theirs.tree, strict=True):
        np.testing.assert_array_equal(a, b)


def without_meshes(text):
    """The URDF with a ball in place of each mesh."""
    return re.sub(r"<mesh[^>]*?(/>|>\s*</mesh>)", '<sphere radius="0.1"/>', text)


def test_the_child_may_be_off_the_joint():
    """The child is at T_parent_joint, then the motion, then T_joint_child, for each kind of joint."""
    rng = np.random.default_rng(2)
    for kind in ("fixed", "revolute", "continuous", "prismatic", "planar", "floating", "ball"):
        before, behind = random_poses(rng, 2, 1.0)
        axis = rng.normal(size=3)
        robot = Robot.from_links(
            {"a": None, "b": CUBE},
            [Joint("j", kind, "a", "b", before, behind, (0, 0, 1) if kind == "planar" else axis)],
        )
        for q in robot.random_configurations(5):
            motion = np.eye(4)
            if kind in ("revolute", "continuous"):
                motion[:3, :3] = Rotation.from_rotvec(q[0] * axis / np.linalg.norm(axis)).as_matrix()
            elif kind == "prismatic":
                motion[:3, 3] = q[0] * axis / np.linalg.norm(axis)
            elif kind == "planar":
                motion[:2, 3], motion[:3, :3] = q[:2], Rotation.from_rotvec([0, 0, q[2]]).as_matrix()
            elif kind in ("floating", "ball"):
                motion[:3, :3] = Rotation.from_quat(q[-4:], scalar_first=True).as_matrix()
                motion[:3, 3] = q[:3] if kind == "floating" else 0
            found = robot.forward_kinematics(q)[robot.link_names.index("b")]
            np.testing.assert_allclose(found, before @ motion @ behind, atol=1e-14)
        assert robot.link_names == (("a", "b") if kind == "fixed" else ("a", "b/j", "b"))


def test_a_reference_is_the_value_of_no_motion():
    """At its reference, a joint does not move its child; a joint that follows it moves by its own reference."""
    joints = [
        Joint("turn", "revolute", "a", "b", lower=-1, upper=1, reference=0.3),
        Joint("slide", "prismatic", "b", "c", mimic=("turn", 2.0, 0.1), reference=0.7),
    ]
    robot = Robot.from_links({"a": None, "b": BALL, "c": CUBE}, joints)
    np.testing.assert_allclose(robot.forward_kinematics([0.3]), np.broadcast_to(np.eye(4), (3, 4, 4)), atol=1e-15)


def test_a_list_of_bodies_is_their_union():
    """Several bodies at poses collide as the same bodies, moved and united; an empty list is no body."""
    rng = np.random.default_rng(3)
    poses = random_poses(rng, 3, 0.3)
    parts = [(BALL, poses[0]), (CUBE, None), (Body.cone(0.1, 0.2), poses[2])]
    slide = Joint("slide", "prismatic", "a", "b", axis=[1, 2, 3], lower=-1, upper=1)
    robots = [
        Robot.from_links({"a": CUBE, "b": parts}, [slide], disabled=()),
        Robot.from_links(
            {"a": CUBE, "b": Body.union([BALL.transformed(poses[0]), CUBE, parts[2][0].transformed(poses[2])])},
            [slide],
            disabled=[],
        ),
    ]
    Q = robots[0].random_configurations(200)
    found = [CollisionChecker(robot).distance(Q, exact=True).distance for robot in robots]
    np.testing.assert_array_equal(*found)
    assert 0 < (found[0] < 0).sum() < len(Q)
    assert not Robot.from_links({"a": [], "b": CUBE}, [slide]).bodies.keys() - {"b"}


def test_pairs_that_need_no_check():
    """Without a list, adjacent pairs need no check; with one, even an empty one, all others are checked."""
    joints = [Joint("j", "revolute", "a", "b"), Joint("k", "revolute", "b", "c", shift(1, 0, 0))]
    links = dict.fromkeys("abc", BALL)

    def pairs(disabled):
        return {*map(frozenset, CollisionChecker(Robot.from_links(links, joints, disabled=disabled)).checked_pairs)}

    every = {frozenset("ab"), frozenset("bc"), frozenset("ac")}
    assert pairs(None) == {frozenset("ac")}
    assert pairs([]) == every
    assert pairs([("c", "b")]) == every - {frozenset("bc")}


def test_joints_of_several_values_have_limits():
    """Limits of planar and floating joints bound x, y and the angle, and the position; quaternions stay free."""
    for kind, width in (("planar", 3), ("floating", 7)):
        robot = Robot.from_links(
            {"a": None, "b": BALL}, [Joint("j", kind, "a", "b", lower=[-1, -2, -3], upper=[1, math.inf, 3])]
        )
        for limits in ("", "hard_"):
            assert getattr(robot, limits + "lower")[:3].tolist() == [-1, -2, -3]
            assert getattr(robot, limits + "upper")[:3].tolist() == [1, math.inf, 3]
        assert robot.dof == width
        with pytest.raises(InputError, match="bounds of 'j'"):
            robot.to_urdf("x.urdf")


def test_bounds_of_several_values_leave_other_hard_limits():
    """Where limits of a joint that follows narrow those of another, its hard limits stay as given."""
    joints = [
        Joint("j", "revolute", "a", "b", lower=-2, upper=2),
        Joint("k", "revolute", "b", "c", lower=-1, upper=1, mimic=("j", 1, 0)),
        Joint("p", "planar", "a", "d", lower=[-1, -2, -3], upper=[1, 2, 3]),
    ]
    robot = Robot.from_links(dict.fromkeys("abcd"), joints)
    assert robot.upper.tolist() == [1, 1, 2, 3]
    assert robot.hard_upper.tolist() == [2, 1, 2, 3]
    assert robot.hard_lower.tolist() == [-2, -1, -2, -3]


def arm():
    """An arm with a gripper whose second finger follows the first."""
    up = shift(0, 0, 0.4)
    links = {"base": Body.cylinder(0.1, 0.1), "upper": [(Body.capsule(0.05, 0.25), shift(0, 0, 0.2))]}
    links |= {"lower": links["upper"], "palm": Body.box([0.1, 0.2, 0.05]), "left": CUBE, "right": CUBE}
    axes = {"shoulder": [0, 0, 1], "elbow": [0, 1, 0], "wrist": [0, 1, 0]}
    joints = [
        Joint(name, "revolute", parent, child, up if k else shift(0, 0, 0.06), None, axes[name], -2, 2, velocity=1.5)
        for k, (name, parent, child) in enumerate(
            [("shoulder", "base", "upper"), ("elbow", "upper", "lower"), ("wrist", "lower", "palm")]
        )
    ]
    finger = {"axis": [0, 1, 0], "lower": 0.0, "upper": 0.1, "velocity": 0.2}
    joints.append(Joint("open", "prismatic", "palm", "left", shift(0, 0.15, 0.2), **finger))
    follow = {"axis": [0, -1, 0], "lower": 0.0, "upper": 0.08, "mimic": ("open", 1.0, 0.0)}
    joints.append(Joint("follow", "prismatic", "palm", "right", shift(0, -0.15, 0.2), **follow))
    return Robot.from_links(links, joints, name="arm")


def test_what_robots_can_do(tmp_path):
    """A robot in memory is written, placed, joined, put on a base, planned for, and its plan is timed and proven."""
    robot = arm()
    assert robot.configuration_names == ("shoulder", "elbow", "wrist", "open")
    assert (robot.upper[3], robot.hard_upper[3]) == (0.08, 0.1)
    expect_same_back(robot, tmp_path)
    both = Robot.join({"a": robot, "b": robot.placed(shift(2, 0, 0))})
    expect_same_back(both, tmp_path)
    assert robot.add_base("planar").dof == 7
    checker = CollisionChecker(robot)
    path = planners.plan(checker, [0, 0.5, 0.5, 0], [1.5, -0.5, 1, 0.05], full=True).path
    moved = planners.trajectory(robot, path, acceleration=2.0)
    assert moved.certify(checker).verdict is Verdict.FREE
    assert np.abs(np.diff(moved.sample(100.0)[1][:, 3])).max() <= 0.2 / 100 * (1 + 1e-9)


def test_a_body_on_a_joint_has_a_velocity_and_follows():
    """`with_body` makes the robot that `from_links` makes of the same joint, with its velocity and its mimic."""
    links = {"base": CUBE, "a": BALL}
    first = Joint("a", "prismatic", "base", "a", shift(1, 0, 0), axis=[0, 1, 0], lower=-1, upper=1, velocity=0.5)
    rng = np.random.default_rng(4)
    for kind in ("prismatic", "revolute", "continuous"):
        T, axis = random_poses(rng, 1, 1.0)[0], rng.normal(size=3)
        for mimic in (None, ("a", -2.0, 0.5), ("a", 0.0, 0.25)):
            limits = {} if kind == "continuous" else {"lower": -1.0, "upper": 1.5}
            second = Joint("b", kind, "a", "b", T, None, axis, **limits, velocity=0.4, mimic=mimic)
            whole = Robot.from_links(links | {"b": CUBE}, [first, second])
            added = Robot.from_links(links, [first]).with_body(
                "b", CUBE, T, joint=kind, parent="a", axis=axis, velocity=0.4, mimic=mimic,
                limits=(-1.0, 1.5) if limits else None,
            )  # fmt: skip
            for name in ("configuration_names", "joint_names", "link_names", "mimics", "adjacent_pairs"):
                assert getattr(added, name) == getattr(whole, name)
            for limit in LIMITS:
                np.testing.assert_array_equal(getattr(added, limit), getattr(whole, limit), err_msg=limit)
            Q = whole.random_configurations(20)
            np.testing.assert_allclose(added.forward_kinematics(Q), whole.forward_kinematics(Q), rtol=0, atol=1e-15)
            moved = added.placed(shift(0, 0, 1))
            np.testing.assert_allclose(
                moved.forward_kinematics(Q)[:, 2], shift(0, 0, 1) @ added.forward_kinematics(Q)[:, 2]
            )


ROOTED = {"a": None, "b": BALL}
J = Joint("j", "revolute", "a", "b")


@pytest.mark.parametrize(
    ("links", "joints", "error", "text"),
    [
        (None, [], InputError, "links: expected a mapping"),
        ({}, [], InputError, "links: expected a mapping"),
        ({"": None}, [], InputError, "a name of a link"),
        ({3: None}, [], InputError, "a name of a link"),
        ({"a": 3}, [], InputError, "link 'a': expected a body, None, or a list of pairs"),
        ({"a": [BALL]}, [], InputError, "link 'a': expected a body, None, or a list of pairs"),
        ({"a": [(BALL, np.ones((4, 4)))]}, [], PoseError, "a pose in link 'a'"),
        (ROOTED, J, InputError, "joints: expected a list of loewner.Joint"),
        (ROOTED, ["j"], InputError, "joints: expected loewner.Joint, found str"),
        (ROOTED, [], InputError, "tree with one root, found 2 links"),
        ({**ROOTED, "c": None}, [J, J], InputError, "'j' twice"),
        (ROOTED, [J, Joint("k", "fixed", "a", "b")], InputError, "'b' below two joints, 'j' and 'k'"),
        (ROOTED, [J, Joint("k", "fixed", "b", "a")], InputError, "a cycle"),
        (ROOTED, [Joint("", "fixed", "a", "b")], InputError, "a name of a joint"),
        (ROOTED, [Joint("j", "hinge", "a", "b")], UnknownNameError, "kind of joint 'j'"),
        (ROOTED, [Joint("j", "fixed", "a", "c")], UnknownNameError, "link of joint 'j'"),
        (ROOTED, [Joint("j", "fixed", "a", 3)], UnknownNameError, "link of joint 'j'"),
        (ROOTED, [Joint("j", "fixed", "a", "b", np.ones((4, 4)))], PoseError, "T_parent_joint of joint 'j'"),
        (ROOTED, [Joint("j", "fixed", "a", "b", None, np.ones((4, 4)))], PoseError, "T_joint_child of joint 'j'"),
        (ROOTED, [Joint("j", "fixed", "a", "b", shift(1e300, 0, 0))], InputError, "T_parent_joint of joint 'j'.*1e"),
        (ROOTED, [Joint("j", "revolute", "a", "b", axis=[0, 0, 0])], InputError, "axis of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", axis=[0, 1])], InputError, "axis of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", lower=1, upper=0)], InputError, "limits of joint 'j'.*lower ones"),
        (ROOTED, [Joint("j", "revolute", "a", "b", lower=math.nan)], InputError, "limits of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", lower=math.inf)], InputError, "limits of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", lower=[1, 2])], InputError, "lower of joint 'j'.*expected shape"),
        (ROOTED, [Joint("j", "continuous", "a", "b", upper=2)], InputError, "none for a continuous joint"),
        (ROOTED, [Joint("j", "ball", "a", "b", upper=2)], InputError, "none for a ball joint"),
        (ROOTED, [Joint("j", "fixed", "a", "b", upper=2)], InputError, "none for a fixed joint"),
        (ROOTED, [Joint("j", "planar", "a", "b", upper=[1, 2])], InputError, "upper of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", velocity=0)], InputError, "velocity of joint 'j'"),
        (ROOTED, [Joint("j", "planar", "a", "b", velocity=1)], InputError, "velocity of joint 'j'.*None"),
        (ROOTED, [Joint("j", "planar", "a", "b", reference=1)], InputError, "reference of joint 'j'.*0"),
        (ROOTED, [Joint("j", "revolute", "a", "b", mimic="k")], InputError, "mimic of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", mimic=("k", 1, math.nan))], InputError, "mimic of joint 'j'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", mimic=("k", 1, 0))], UnknownNameError, "'k'"),
        (ROOTED, [Joint("j", "revolute", "a", "b", mimic=("j", 1, 0))], InputError, "^robot: .*a ring"),
        (ROOTED, [Joint("j", "floating", "a", "b", mimic=("k", 1, 0))], InputError, "None for a floating joint"),
    ],
)
def test_bad_links_and_joints(links, joints, error, text):
    """Each is refused by the name of the link or joint."""
    with pytest.raises(error, match=text):
        Robot.from_links(links, joints)


def test_bad_names_and_pairs():
    """A name and pairs are checked like elsewhere."""
    with pytest.raises(InputError, match="name: expected a name"):
        Robot.from_links(ROOTED, [J], name="")
    with pytest.raises(UnknownNameError, match="'c'"):
        Robot.from_links(ROOTED, [J], disabled=[("a", "c")])
    with pytest.warns(UserWarning, match=r"^robot: joint 'j': expected limits in radians"):
        Robot.from_links(ROOTED, [Joint("j", "revolute", "a", "b", lower=-90, upper=90)])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"velocity": 0.0}, "velocity"),
        ({"joint": "fixed", "limits": None, "velocity": 1.0}, "velocity: expected None for a fixed joint"),
        ({"joint": "floating", "limits": None, "mimic": ("j", 1, 0)}, "mimic: expected None for a floating joint"),
        ({"mimic": "j"}, "mimic: expected the name of a joint"),
        ({"mimic": ("x", 1, 0)}, "joint of one value of its own in mimic"),
        ({"mimic": ("c", 1, 0)}, "joint of one value of its own in mimic"),
        ({"mimic": ("f", 1, 0)}, "joint of one value of its own in mimic"),
        ({"mimic": ("j", 1, 9)}, "mimic: expected limits that leave 'j' values"),
        ({"mimic": ("j", math.inf, 9)}, "mimic: expected a finite number"),
    ],
)
def test_bad_velocities_and_mimics(arguments, text):
    """`with_body` refuses velocities and mimics of joints that have not one value, and joints that are unfit."""
    robot = Robot.from_links(
        {**ROOTED, "f": None},
        [Joint("j", "revolute", "a", "b", lower=-1, upper=1), Joint("f", "floating", "b", "f")],
    )
    with pytest.raises(LoewnerError, match=text):
        robot.with_body("c", BALL, **{"joint": "prismatic", "limits": (0, 1)} | arguments)
