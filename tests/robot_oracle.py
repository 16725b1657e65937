"""Where pinocchio sees the links of a robot, and where the robots are that both read."""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

from loewner import Robot
from loewner.descriptions import read_urdf


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
        x = pin.neutral(model)
        for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
            x[joint.idx_q : joint.idx_q + joint.nq] = _entries(q, values, joints[name], joint.nq)
        pin.framesForwardKinematics(model, data, x)
        expected = np.array([data.oMf[frame].homogeneous for frame in frames])
        worst = max(worst, float(np.abs(expected - found).max()))
    return worst


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
