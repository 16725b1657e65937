"""Where pinocchio sees the links of a robot, and where the robots are that both read."""

import warnings
import xml.etree.ElementTree as ElementTree
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

from loewner import Robot
from loewner.robots.description.urdf import read_urdf

# URDF and SRDF, below the folder of all robots.
ROBOTS = """
a1_description/urdf/a1.urdf a1
alex_description/urdf/alex_nub_hands.urdf alex_nub_hands
alex_description/urdf/alex_psyonic_hands.urdf alex_psyonic_hands
alex_description/urdf/alex_sake_hands.urdf alex_sake_hands
alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf alexander
anymal_b_simple_description/robots/anymal-kinova.urdf anymal-kinova
anymal_b_simple_description/robots/anymal.urdf anymal
anymal_c_simple_description/urdf/anymal.urdf anymal
b1_description/urdf/b1-z1.urdf b1-z1
b1_description/urdf/b1.urdf b1
baxter_description/urdf/baxter.urdf baxter_manipulation
bolt_description/robots/bolt.urdf bolt
borinot_description/urdf/borinot_flying_arm_2.urdf borinot_flying_arm_2
centauro_description/urdf/centauro.urdf centauro
finger_edu_description/robots/finger_edu.urdf finger_edu
go1_description/urdf/go1.urdf go1
go2_description/urdf/go2.urdf go2
hextilt_description/urdf/hextilt_flying_arm_5.urdf hextilt_flying_arm_5
hyq_description/robots/hyq_no_sensors.urdf hyq
icub_description/robots/icub.urdf icub
icub_description/robots/icub_reduced.urdf icub
kinova_description/robots/kinova.urdf kinova
panda_description/urdf/panda.urdf panda
panda_description/urdf/panda_collision.urdf panda
pr2_description/urdf/pr2.urdf pr2
pr2_description/urdf/pr2.urdf pr2_manipulation
romeo_description/urdf/romeo.urdf romeo
romeo_description/urdf/romeo.urdf romeo_moveit
romeo_description/urdf/romeo_small.urdf romeo_small
simple_humanoid_description/urdf/simple_humanoid.urdf simple_humanoid
simple_humanoid_description/urdf/simple_humanoid_classical.urdf simple_humanoid_classical
solo_description/robots/solo.urdf solo
solo_description/robots/solo12.urdf solo
talos_data/robots/talos_full_v2.urdf talos
talos_data/robots/talos_full_v2_box.urdf talos
talos_data/robots/talos_left_arm.urdf talos
talos_data/robots/talos_reduced.urdf talos
talos_data/robots/talos_reduced_box.urdf talos
talos_data/robots/talos_reduced_corrected.urdf talos
ur_description/urdf/ur3_gripper.urdf ur3_gripper
ur_description/urdf/ur5_gripper.urdf ur5_gripper
ur_description/urdf/ur5_joint_limited_robot.urdf ur5_joint_limited_robot
ur_description/urdf/ur5_robot.urdf ur5
xarm_description/urdf/xarm7.urdf xarm7
z1_description/urdf/z1.urdf z1
"""
PAIRS = [tuple(line.split()) for line in ROBOTS.strip().splitlines()]


def robots_folder() -> Path:
    """Folder of the robots of example-robot-data."""
    try:
        files = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return Path(str(files.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def disagreement(robot: Robot, path: Path, count: int, seed: int = 0) -> float:
    """Largest difference of any entry of any link's pose from pinocchio's, over random configurations."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    Q = robot.random_configurations(count, seed)
    poses = robot.forward_kinematics(Q)
    frames = [model.getFrameId(name, pin.FrameType.BODY) for name in robot.link_names]
    assert max(frames) < model.nframes
    values = {name: k for k, name in enumerate(robot.configuration_names)}
    joints = read_urdf(path).joints
    worst = 0.0
    for q, found in zip(Q, poses, strict=True):
        x = pinocchio_configuration(pin, model, joints, values, q)
        pin.framesForwardKinematics(model, data, x)
        expected = np.array([data.oMf[frame].homogeneous for frame in frames])
        worst = max(worst, float(np.abs(expected - found).max()))
    return worst


def without_shapes(text: str) -> str:
    """The text of a URDF without shapes, so that no mesh is read: pinocchio and `Robot` get the same."""
    root = ElementTree.fromstring(text)
    for link in root.iter("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    return ElementTree.tostring(root, encoding="unicode")


def compare_with_pinocchio(text: str) -> str:
    """Compare poses of links, limits and mimics; return what was compared."""
    pin = pytest.importorskip("pinocchio")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot, joints = Robot.from_urdf(text=text), read_urdf("URDF text", text).joints
    model = pin.buildModelFromXML(text)
    data, values = model.createData(), {name: k for k, name in enumerate(robot.configuration_names)}
    frames = [model.getFrameId(name, pin.FrameType.BODY) for name in robot.link_names]
    Q = robot.random_configurations(5)
    for q, found in zip(Q, robot.forward_kinematics(Q), strict=True):
        pin.framesForwardKinematics(model, data, pinocchio_configuration(pin, model, joints, values, q))
        expected = np.array([data.oMf[frame].homogeneous for frame in frames])
        assert np.abs(expected - found).max() <= 1e-12 * (1 + np.abs(expected).max())
    limited = 0
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        own = joints[name]
        if joint.nq != 1 or own.kind == "continuous":  # pinocchio has two values for a continuous joint
            continue
        ends = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        assert (own.lower, own.upper) == ends, name
        if own.mimic is None:
            at = values[name]
            assert (robot.hard_lower[at], robot.hard_upper[at]) == ends, name
        limited += 1
    return f"{len(robot.link_names)} links, {limited} limits, {len(robot.mimics)} mimics"


def pinocchio_configuration(pin, model, joints, values, q):
    """A configuration as pinocchio orders it; `joints` as described in the file, `values` the columns by name."""
    x = pin.neutral(model)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        x[joint.idx_q : joint.idx_q + joint.nq] = _entries(q, values, joints[name], joint.nq)
    return x


def _entries(q, values, joint, width):
    """A joint's values as pinocchio orders them; it takes joints that mimic for joints like any other."""
    if joint.kind == "floating":  # x, y, z, then the quaternion as x, y, z, w
        return [q[values[f"{joint.name}/{v}"]] for v in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    if joint.kind == "planar":
        x, y, theta = (q[values[f"{joint.name}/{v}"]] for v in ("x", "y", "theta"))
        return [x, y, np.cos(theta), np.sin(theta)]
    if joint.mimic:
        value = joint.mimic.multiplier * q[values[joint.mimic.joint]] + joint.mimic.offset
    else:
        value = q[values[joint.name]]
    return [np.cos(value), np.sin(value)] if width == 2 else [value]
