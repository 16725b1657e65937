"""What proven motions are held against: dense samples, answers in closed form, and samples of the kernels' bounds."""

import math
from functools import cache
from pathlib import Path

import numpy as np

from checker_oracle import random_robot, random_scene, simple_bodies
from loewner import Body, CollisionChecker, Robot, Scene, Verdict
from loewner._kernels import columns
from loewner._kernels.robots.motion_bounds import Rates, rates_of, uncertainty
from loewner.robots.proofs import courses
from robot_oracle import robots_folder

Real = np.longdouble

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


def read_example(urdf: str, srdf: str) -> Robot:
    """A robot of example-robot-data, read anew."""
    folder = robots_folder()
    return Robot.from_urdf(folder / urdf, srdf=folder / srdf, package_dirs=[folder.parents[1]])


@cache
def example(urdf: str, srdf: str) -> Robot:
    """The same robot, which tests share: none changes it."""
    return read_example(urdf, srdf)


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


# -- bounds of the kernels, and poses in extended precision ----------------------------------------


def empty_rates(robot):
    return Rates(*(np.empty(len(robot.link_names)) for _ in Rates._fields))


def rates(checker, course, width=1.0):
    """What the kernel makes of a course, or of a part: rates of joints, and what its poses may be off by."""
    robot, tables, made = checker.robot, checker._ready().tables, empty_rates(checker.robot)
    travel, angles, places = rates_of(robot.tree, course, width, made)
    return tables, made, uncertainty(tables, travel, angles, places)[0]


def straight(robot, a, b):
    return courses.straight(robot, a[None], b[None])[0]


def bent(robot, rng, q, degree, length):
    """A course of some degree that begins at q; its orientations turn a little."""
    points = q + np.cumsum(rng.uniform(-length, length, (degree + 1, robot.dof)), axis=0) / degree
    points[0] = q
    for at in robot._quaternions.values():
        points[:, at] = q[at] + rng.uniform(-0.07, 0.07, (degree + 1, 4))
    return points


def real_configurations(robot, course, t):
    """Configurations on a course, in extended precision."""
    degree, points = len(course) - 1, course.astype(Real)
    weights = [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)]
    Q = np.stack(weights, axis=1) @ points
    for quaternion in robot._quaternions.values():
        if degree > 1:
            Q[:, quaternion] /= np.sqrt((Q[:, quaternion] ** 2).sum(axis=1))[:, None]
            continue
        p, q = (end[quaternion] / np.sqrt((end[quaternion] ** 2).sum()) for end in points)
        half = np.arcsin(np.sqrt(((p - q) ** 2).sum()) / 2)  # of the angle between the two
        across = p + q
        across /= np.sqrt((across**2).sum())
        along = (q - p) / max(np.sqrt(((q - p) ** 2).sum()), Real(1e-30))
        angle = (2 * t - 1)[:, None] * half
        Q[:, quaternion] = np.cos(angle) * across + np.sin(angle) * along
    return Q


def real_poses(robot, course, times):
    """Poses of all links on the real course, in extended precision: (times, links, 4, 4)."""
    return real_places(robot, real_configurations(robot, course, np.asarray(times, dtype=Real)))


def real_places(robot, Q):
    """Poses of all links at configurations of extended precision, shape (N, dof)."""
    tree = robot.tree
    out = np.zeros((len(Q), len(tree.parent), 4, 4), dtype=Real)
    out[..., 3, 3] = 1
    for link, row in enumerate(tree.constants.astype(Real)):
        fixed, sine, cosine = (row[k : k + 9].reshape(3, 3) for k in (columns.ROTATION, columns.SINE, columns.COSINE))
        kind, at = tree.kind[link], tree.column[link]
        value = Q[:, at] * Real(tree.multiplier[link]) + Real(tree.offset[link]) if kind else None
        R, place = np.broadcast_to(fixed, (len(Q), 3, 3)), np.broadcast_to(row[9:12], (len(Q), 3)).copy()
        if kind == columns.PLANAR:
            place += Q[:, at, None] * row[30:33] + Q[:, at + 1, None] * row[33:36]
            value = Q[:, at + 2]
        if kind in (columns.REVOLUTE, columns.PLANAR):
            R = fixed + np.sin(value)[:, None, None] * sine + np.cos(value)[:, None, None] * cosine
        elif kind == columns.PRISMATIC:
            place += value[:, None] * row[30:33]
        elif kind in (columns.FLOATING, columns.BALL):
            if kind == columns.FLOATING:
                place += Q[:, at : at + 3] @ fixed.T
                at += 3
            w, x, y, z = Q[:, at : at + 4].T
            turned = [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
            R = fixed @ np.array(turned).transpose(2, 0, 1)
        above = tree.parent[link]
        if above >= 0:
            A = out[:, above]
            place = A[:, :3, 3] + (A[:, :3, :3] @ place[:, :, None])[..., 0]
            R = A[:, :3, :3] @ R
        out[:, link, :3, :3], out[:, link, :3, 3] = R, place
    return out


def checkers(tmp_path, seed):
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng)
    robot = random_robot(rng, tmp_path, 6, bodies)
    return rng, CollisionChecker(robot, random_scene(rng, robot, 4, bodies), skip_adjacent=False)


def points_of(checker):
    """Points of each body in the frame of its link, or of its own if it stands; vertices, where there are any."""
    ready = checker._ready()
    found = []
    for body in range(len(ready.names)):
        pieces = ready.bodies[body].pieces
        inner = [np.concatenate([p.inner.center + p.inner.factor.T, p.inner.center - p.inner.factor.T]) for p in pieces]
        corners = [p.vertices if p.vertices is not None else points for p, points in zip(pieces, inner, strict=True)]
        found.append(np.concatenate(corners))
    return ready, found
