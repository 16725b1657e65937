"""A million samples of lines of real arms: none strays farther than the tolerances."""

import numpy as np
import pytest

from loewner import CollisionChecker, PlanningError, Robot, planners
from loewner.planners import lines
from robot_oracle import robots_folder

pytestmark = pytest.mark.verify

POSITION, ROTATION = 1e-4, 1e-3
LINES, SAMPLES = 100, 200


@pytest.mark.parametrize(
    ("name", "link"), [("panda_description/{}/panda.{}", "panda_hand"), ("ur_description/{}/ur5.{}", "tool0")]
)
def test_samples_of_lines(name, link, monkeypatch):
    """At random instants of 100 lines of half a metre, a million in all, the link is within the tolerances."""
    folder = robots_folder()
    urdf = name.format("urdf", "urdf").replace("ur5.urdf", "ur5_robot.urdf")
    robot = Robot.from_urdf(folder / urdf, srdf=folder / name.format("srdf", "srdf"), package_dirs=[folder.parents[1]])
    checker, number = CollisionChecker(robot), robot.link_names.index(link)
    seen = []
    block_of = lines.block_of
    monkeypatch.setattr(lines, "block_of", lambda judge, u, Q: (seen.append(u), block_of(judge, u, Q))[1])
    rng = np.random.default_rng(0)
    done = count = 0
    farthest = np.zeros(2)
    for q in robot.random_configurations(100 * LINES, 1):
        T = robot.forward_kinematics(q)[number]
        line = rng.normal(size=(2, 3))
        line *= np.array([[0.5], [0.6]]) / np.linalg.norm(line, axis=1, keepdims=True)
        K = np.cross(np.eye(3), line[1] / 0.6)
        goal = T.copy()
        goal[:3, 3] += line[0]
        goal[:3, :3] = (np.eye(3) + np.sin(0.6) * K.T + (1 - np.cos(0.6)) * K @ K) @ T[:3, :3]
        try:
            path = planners.straight(checker, q, link, goal, position=POSITION, rotation=ROTATION)
        except PlanningError:
            continue
        u = seen[-1]
        s = np.sort(rng.random((len(path) - 1, SAMPLES)), axis=1)
        Q = path[:-1, None] + s[..., None] * (path[1:] - path[:-1])[:, None]
        at = (u[:-1, None] + s * (u[1:] - u[:-1])[:, None]).ravel()
        poses = robot.forward_kinematics(Q.reshape(-1, robot.dof))[:, number]
        angles = (0.6 * at)[:, None, None]
        R = (np.eye(3) + np.sin(angles) * K.T + (1 - np.cos(angles)) * K @ K) @ T[:3, :3]
        off = np.linalg.norm(poses[:, :3, 3] - T[:3, 3] - at[:, None] * line[0], axis=1).max()
        turned = 2 * np.arcsin(np.linalg.norm(poses[:, :3, :3] - R, axis=(1, 2)).max() / np.sqrt(8))
        farthest = np.maximum(farthest, [off, turned])
        count, done = count + len(at), done + 1
        if done >= LINES and count >= 1_000_000:
            break
    print(f"{link}: {done} lines, {count} samples, at most {farthest[0]:.3g} m and {farthest[1]:.3g} rad off")
    assert done >= LINES
    assert farthest[0] <= POSITION
    assert farthest[1] <= ROTATION
