"""What proven motions are held against: dense samples, answers in closed form, and samples of the kernels' bounds."""

from pathlib import Path

import numpy as np

from loewner import Body, CollisionChecker, Robot, Scene, Verdict
from robot_oracle import robots_folder

# Two fingers 0.1 m wide that slide towards each other by one value: inner faces at x = -v and v.
FINGERS = """<robot name="fingers"><link name="palm"/>
<link name="left"><collision><origin xyz="0.05 0 0"/><geometry><box size="0.1 0.02 0.05"/></geometry></collision></link>
<link name="right"><collision><origin xyz="-0.05 0 0"/><geometry><box size="0.1 0.02 0.05"/></geometry></collision>
</link>
<joint name="v" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.1"/></joint>
<joint name="w" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="1 0 0"/>
  <limit lower="-0.1" upper="0.1"/><mimic joint="v" multiplier="-1" offset="0"/></joint>
</robot>"""

# A floating base, a planar cart on it, and an arm of a turning and a sliding joint.
AFLOAT = """<robot name="afloat">
<link name="world"/><link name="base"/><link name="cart"/><link name="arm"/><link name="hand"/>
<joint name="base" type="floating"><parent link="world"/><child link="base"/></joint>
<joint name="cart" type="planar"><parent link="base"/><child link="cart"/><origin xyz="0 0 0.3" rpy="0.2 0 0"/>
  <axis xyz="0 0 1"/></joint>
<joint name="arm" type="revolute"><parent link="cart"/><child link="arm"/><origin xyz="0.2 0 0.1"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3"/></joint>
<joint name="hand" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="0.3 0 0" rpy="0 0.3 0"/>
  <axis xyz="1 0 0"/><limit lower="-0.2" upper="0.2"/></joint>
</robot>"""


def written(folder: Path, text: str) -> Robot:
    """The robot of a URDF given as text."""
    path = folder / "robot.urdf"
    path.write_text(text)
    return Robot.from_urdf(path)


def example(urdf: str, srdf: str) -> Robot:
    """A robot of example-robot-data."""
    folder = robots_folder()
    return Robot.from_urdf(folder / urdf, srdf=folder / srdf, package_dirs=[folder.parents[1]])


def ring(rng: np.random.Generator, count: int, near: float, far: float, size: float) -> Scene:
    """Boxes and hulls about the origin, turned at random."""
    scene = Scene()
    for k in range(count):
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        T = np.eye(4)
        T[:3, :3] = axes * np.sign(np.linalg.det(axes))
        direction = rng.normal(size=3)
        T[:3, 3] = rng.uniform(near, far) * direction / np.linalg.norm(direction)
        body = (
            Body.box(rng.uniform(0.2, 1.0, 3) * size)
            if k % 2
            else Body.from_points(rng.normal(size=(20, 3)) * size / 4)
        )
        scene.add(f"b{k}", body, T)
    return scene


def steps(robot: Robot, rng: np.random.Generator, Q: np.ndarray, length: float) -> np.ndarray:
    """Other ends of motions of about a length from Q, in random directions; joints with little room go less far."""
    step = rng.normal(size=Q.shape) * np.minimum(robot.upper - robot.lower, 1.0)
    step *= length / np.linalg.norm(step, axis=1, keepdims=True)
    end = Q + step
    for quaternion in robot._quaternions.values():
        end[:, quaternion] /= np.linalg.norm(end[:, quaternion], axis=1, keepdims=True)
    return end


def refuted(checker: CollisionChecker, Q0: np.ndarray, Q1: np.ndarray, samples: int) -> np.ndarray:
    """Which motions collide at one of so many fractions, evenly spread."""
    Q0, Q1 = np.broadcast_arrays(Q0, Q1)
    t = np.linspace(0.0, 1.0, samples)
    return np.array([checker.collide(checker.robot.between(a, b, t)).any() for a, b in zip(Q0, Q1, strict=True)], bool)


def assert_true(checker: CollisionChecker, Q0, Q1, samples: int = 2000, **options):
    """Hold every verdict against samples and `collide`; returns the verdicts."""
    found = checker.certify_edges(Q0, Q1, **options)
    Q0, Q1 = np.broadcast_arrays(Q0, Q1)
    free = found.verdict == Verdict.FREE
    assert not refuted(checker, Q0[free], Q1[free], samples).any()
    assert np.isnan(found.fraction[free]).all()
    assert (found.names[free] == "").all()
    rest = ~free
    assert ((found.fraction[rest] >= 0) & (found.fraction[rest] <= 1)).all()
    assert (found.names[rest] != "").all()
    hit = found.verdict == Verdict.COLLIDING
    at = checker.robot.between(Q0[hit], Q1[hit], found.fraction[hit])
    assert checker.collide(at).all()
    pairs = {pair: k for k, pair in enumerate(checker.checked_pairs)}
    named = [pairs[tuple(pair)] for pair in found.names[hit].tolist()]
    assert checker.collide_by_pair(at)[np.arange(hit.sum()), named].all()
    return found.verdict


def free_configurations(checker: CollisionChecker, count: int, seed: int = 0) -> np.ndarray:
    """Configurations at random that do not collide, up to a count."""
    Q = checker.robot.random_configurations(50 * count, seed)
    return Q[~checker.collide(Q)][:count]
