"""The bounds that proofs of motions rest on hold for ways and poses computed without them, in extended precision."""

from dataclasses import replace

import numpy as np
import pytest

from loewner import Body, CollisionChecker
from loewner._kernels import columns
from loewner._kernels.robots.motion_bounds import ways_between, write_strays
from loewner._kernels.robots.motion_path import write_part
from loewner.robots.description.robot import on_the_way
from loewner.robots.proofs import courses
from motion_oracle import (
    AFLOAT,
    Real,
    bent,
    checkers,
    empty_rates,
    example,
    points_of,
    rates,
    real_poses,
    steps,
    straight,
    written,
)
from sampling import quick, quick_of

far_outside = pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")


@pytest.mark.parametrize("degree", [1, 5, *(pytest.param(k, marks=pytest.mark.verify) for k in (2, 3))])
@pytest.mark.parametrize("seed", quick(*range(8)))
@pytest.mark.parametrize("count", quick(101, 401))
@far_outside
def test_speed_and_curvature(tmp_path, seed, degree, count):
    """No point of a body is faster, or its way more bent, than the bound, as seen from any other body or the world.

    The same holds of a part of a course and the bounds of that part.
    """
    rng, checker = checkers(tmp_path, seed)
    robot, (ready, points) = checker.robot, points_of(checker)
    if robot.dof == 0:
        pytest.skip("nothing moves")
    closest = 0.0
    for q in robot.random_configurations(3, seed):
        length = rng.uniform(0.5, 6.0)
        course = straight(robot, q, steps(robot, rng, q[None], length)[0])
        low, high = 0.0, 1.0
        if degree > 1:
            course = bent(robot, rng, q, degree, length)
            low, high = rng.choice([[0.0, 1.0], [0.25, 0.375], [0.9, 1.0]])
        part = np.empty_like(course)
        write_part(course, low, high, np.empty(degree + 1), part)
        tables, made, _ = rates(checker, part, high - low)
        t = np.linspace(low, high, count).astype(Real)
        h = t[1] - t[0]
        poses = real_poses(robot, course, t)
        for a in range(len(ready.names)):
            for b in range(len(ready.link)):
                if a == b:
                    continue
                # A body that stands moves as seen from a link.
                moves = a < len(ready.link)
                to = np.linalg.inv(poses[:, ready.link[b]].astype(float)).astype(Real)
                x = np.c_[points[a], np.ones(len(points[a]))].astype(Real)
                if moves:
                    x = np.einsum("tij,nj->tni", poses[:, ready.link[a]], x)
                else:
                    x = np.broadcast_to(
                        x @ ready.standing.poses[a - len(ready.link)].reshape(4, 4).T, (len(t), *x.shape)
                    )
                seen = np.einsum("tij,tnj->tni", to, x)[..., :3]
                ways = ways_between(tables, made, a, ready.link[a] if moves else -1, ready.link[b])
                speed = np.sqrt(((seen[1:] - seen[:-1]) ** 2).sum(axis=2)).max() / h
                bend = np.sqrt(((seen[2:] - 2 * seen[1:-1] + seen[:-2]) ** 2).sum(axis=2)).max() / h**2
                assert speed <= ways.speed + 1e-9
                assert bend <= ways.bend + 1e-5
                if ways.bend > 0:
                    closest = max(closest, float(bend / ways.bend))
    assert closest > 0.2 or not np.isin(robot.tree.kind, (columns.REVOLUTE, columns.PLANAR, columns.FLOATING)).any()


def largest_error(checker, course, times):
    """How far points at the longest reach are from the real course, in units of the bound."""
    ready = checker._ready()
    table = ready.bodies._packed.kernel.table
    _, _, bound = rates(checker, course)
    real = real_poses(checker.robot, course, times)[:, ready.link]
    Q = courses.configurations(checker.robot, np.broadcast_to(course, (len(times), *course.shape)), times)
    found = checker.robot.forward_kinematics(Q)[:, ready.link]
    start = ready.bodies._packed.piece_start
    reach = np.array([table[start[k] : start[k + 1], columns.REACH].max() for k in range(len(ready.link))])
    off = found.astype(Real) - real
    turn = np.sqrt((off[..., :3, :3] ** 2).sum(axis=(2, 3)))  # Frobenius, no less than the largest of any point
    shift = np.sqrt((off[..., :3, 3] ** 2).sum(axis=2))
    return float((turn * reach + shift).max() / bound)


@pytest.mark.parametrize("seed", quick_of(range(10), range(3)))
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e4])
@far_outside
def test_rounding_of_poses(tmp_path, seed, scale):
    """Computed poses are off by less than the bound: short motions, and values of thousands of turns and metres."""
    rng, checker = checkers(tmp_path, seed)
    robot = checker.robot
    if robot.dof == 0 or not robot.bodies:
        pytest.skip("nothing moves")
    start = robot.random_configurations(4, seed) * max(scale, 1.0)
    for quaternion in robot._quaternions.values():
        start[:, quaternion] /= np.linalg.norm(start[:, quaternion], axis=1, keepdims=True)
    for a, b in zip(start, steps(robot, rng, start, 3.0 * scale), strict=True):
        assert largest_error(checker, straight(robot, a, b), rng.uniform(size=200)) < 1.0
        for degree in (2, 3, 5, 7):
            assert largest_error(checker, bent(robot, rng, a, degree, scale), rng.uniform(size=50)) < 1.0


def test_rounding_of_a_long_chain():
    """The same of an arm; and the bound is no more than a hundred times what is met."""
    checker = CollisionChecker(example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"))
    rng = np.random.default_rng(0)
    start = checker.robot.random_configurations(40)
    found = [
        largest_error(checker, straight(checker.robot, a, b), rng.uniform(size=100))
        for a, b in zip(start, steps(checker.robot, rng, start, 1.0), strict=True)
    ]
    assert 0.002 < max(found) < 1.0


@pytest.mark.parametrize("astray", [1e-16, 1e-9, 9e-7])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.9e-6, 2.1e-6, 1e-3, 1.0, 3.0, np.pi])
@pytest.mark.parametrize("count", quick(10, 30))
def test_orientations(tmp_path, angle, astray, count):
    """Quaternions that are not quite of norm 1, and any angle between them, stay within the bound."""
    robot = written(tmp_path, AFLOAT)
    checker = CollisionChecker(replace(robot, bodies={"base": Body.box([0.2, 0.2, 0.2]), "hand": Body.sphere(0.1)}))
    rng = np.random.default_rng(int(angle * 1e9) % 1000)
    for _ in range(count):
        a, b = robot.random_configurations(2, int(rng.integers(2**31)))
        at = robot._quaternions["base"]
        p, other = a[at], rng.normal(size=4)
        other -= p * (p @ other)
        other /= np.linalg.norm(other)
        b[at] = (np.cos(angle / 2) * p + np.sin(angle / 2) * other) * rng.choice([-1.0, 1.0])
        a[at] *= 1 + astray * rng.uniform(-1, 1)
        b[at] *= 1 + astray * rng.uniform(-1, 1)
        assert largest_error(checker, straight(robot, a, b), rng.uniform(size=50)) < 1.0


@pytest.mark.parametrize("seed", quick_of(range(8), range(3)))
@far_outside
def test_strays(tmp_path, seed):
    """Configurations off a motion by so much have no point of a body farther off, as seen from any other, than told."""
    rng, checker = checkers(tmp_path, seed)
    robot, (ready, points) = checker.robot, points_of(checker)
    if robot.dof == 0:
        pytest.skip("nothing moves")
    closest = 0.0
    for q in robot.random_configurations(4, seed):
        end = steps(robot, rng, q[None], 0.1)[0]
        tables, made, _ = rates(checker, straight(robot, q, end))
        strays = empty_rates(robot)
        off = rng.uniform(0.0, 0.05, robot.dof) * (rng.random(robot.dof) < 0.5)
        write_strays(robot.tree, off, made, strays)
        start = robot.between(q, on_the_way(robot, q, end), 0.5)
        there = start + off * rng.choice([-1.0, 1.0], (20, robot.dof))
        for at in robot._quaternions.values():
            there[:, at] /= np.linalg.norm(there[:, at], axis=1, keepdims=True)
        before = real_poses(robot, np.stack([start, start]), [0.0])
        after = np.concatenate([real_poses(robot, np.stack([x, x]), [0.0]) for x in there])
        for a in range(len(ready.link)):
            for b in range(len(ready.link)):
                if a == b:
                    continue
                x = np.c_[points[a], np.ones(len(points[a]))].astype(Real)
                seen = []
                for poses in (before, after):
                    to = np.linalg.inv(poses[:, ready.link[b]].astype(float)).astype(Real)
                    seen.append(np.einsum("tij,tjk,nk->tni", to, poses[:, ready.link[a]], x)[..., :3])
                moved = np.sqrt(((seen[1] - seen[0]) ** 2).sum(axis=-1)).max()
                told = ways_between(tables, strays, a, ready.link[a], ready.link[b]).speed
                assert moved <= told * (1 + 1e-9) + 1e-12
                closest = max(closest, float(moved / told) if told else 0.0)
    assert closest > 0.3  # the bound is no wild guess
