"""Derivatives: Jacobians of robots, wrenches of distances, gradients of a robot's clearance; beside differences."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from checker_oracle import composed_bodies, pairwise, pose, random_robot, random_scene, simple_bodies
from loewner import Body, CollisionChecker, InputError, Robot, Scene, UnknownNameError, distance
from loewner.robots.gradients import rounded_down
from sampling import examples, quick, quick_of

SEEDS = st.integers(0, 2**32 - 1)
STEP = 1e-6


def nudged(robot: Robot, q: np.ndarray, column: int, step: float) -> np.ndarray:
    """A configuration with one value changed; quaternions are brought back to norm 1, and so does what they turn."""
    q = q.copy()
    q[column] += step
    for first in quaternions(robot):
        q[first : first + 4] /= np.linalg.norm(q[first : first + 4])
    return q


def quaternions(robot: Robot) -> list[int]:
    """Where the quaternions of floating joints begin."""
    names = robot.configuration_names
    return [k for k, name in enumerate(names) if name.endswith("/qw")] or [
        int(column) + 3 for column, kind in zip(robot.tree.column, robot.tree.kind, strict=True) if kind == 4
    ]


@examples(8, 25)
@given(seed=SEEDS)
def test_jacobians_are_differences(seed: int, tmp_path_factory):
    """Of a point of each link of a robot of all kinds of joints, by each value of the configuration."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, tmp_path_factory.mktemp("robot"), 7, simple_bodies(rng))
    q, point = robot.random_configurations(1, seed=seed % 1000)[0], rng.normal(size=3)
    for k, link in enumerate(robot.link_names):
        J = robot.jacobian(q, link, point)
        assert J.shape == (6, robot.dof)
        for column in range(robot.dof):
            after, before = (robot.forward_kinematics(nudged(robot, q, column, step))[k] for step in (STEP, -STEP))
            linear = (after[:3, :3] @ point + after[:3, 3] - before[:3, :3] @ point - before[:3, 3]) / (2 * STEP)
            turned = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / (2 * STEP)
            np.testing.assert_allclose(J[:, column], np.concatenate([linear, turned]), atol=3e-8)


def test_jacobians_of_batches(tmp_path: Path):
    """The same for many configurations at once; of the link's own origin where no point is given."""
    rng = np.random.default_rng(1)
    robot = random_robot(rng, tmp_path, 5, simple_bodies(rng))
    Q = robot.random_configurations(6).reshape(2, 3, -1)
    J = robot.jacobian(Q, robot.link_names[-1])
    assert J.shape == (2, 3, 6, robot.dof)
    np.testing.assert_array_equal(J[1, 2], robot.jacobian(Q[1, 2], robot.link_names[-1], [0, 0, 0]))
    np.testing.assert_array_equal(J, robot.jacobian(Q, robot.link_names[-1], np.broadcast_to(0.0, 3)))  # read-only


def test_bad_jacobians(tmp_path: Path):
    """Unknown links and what is no point are refused."""
    rng = np.random.default_rng(2)
    robot = random_robot(rng, tmp_path, 3, simple_bodies(rng))
    q = robot.random_configurations(1)[0]
    with pytest.raises(UnknownNameError, match="link"):
        robot.jacobian(q, "nobody")
    for point in ([0.0, 1.0], [np.nan, 0, 0], "x"):
        with pytest.raises(InputError, match="point"):
            robot.jacobian(q, robot.link_names[0], point)
    with pytest.raises(InputError):
        robot.jacobian(q[:-1], robot.link_names[0])


@pytest.mark.parametrize("seed", quick_of(range(15), range(2)))
def test_wrenches_are_differences(seed: int):
    """The derivative of a distance as b moves by a twist, about the world's origin, is the wrench's power."""
    rng = np.random.default_rng(seed)
    errors = []
    for a in simple_bodies(rng):
        for b in simple_bodies(rng):
            Ta, Tb = pose(rng, 0.1), pose(rng, 0.1, [0.6, 0.2, -0.3])
            found = distance(a, Ta, b, Tb, exact=True)
            twist = rng.normal(size=6)
            values = []
            for step in (STEP, -STEP):
                T = np.eye(4)
                T[:3, :3] = Rotation.from_rotvec(step * twist[3:]).as_matrix()
                T[:3, 3] = step * twist[:3]
                values.append(distance(a, Ta, b, T @ Tb, exact=True).distance)
            errors.append(abs((values[0] - values[1]) / (2 * STEP) - found.wrench @ twist))
    # Few of the pairs have a kink within the step: features that are parallel but for it.
    assert np.median(errors) < 1e-7
    assert np.quantile(errors, 0.9) < 1e-5


def test_wrenches_of_batches():
    """They have the shape of the batch; without exact distances there is none."""
    T = np.tile(np.eye(4), (2, 3, 1, 1))
    T[..., 0, 3] = 3.0
    found = distance(Body.sphere(1.0), None, Body.sphere(0.5), T, exact=True)
    assert found.wrench.shape == (2, 3, 6)
    np.testing.assert_allclose(found.wrench[0, 0], [1, 0, 0, 0, 0, 0], atol=1e-12)
    assert distance(Body.sphere(1.0), None, Body.sphere(0.5), T).wrench is None


@examples(5, 12)
@given(seed=SEEDS)
def test_gradients_are_differences(seed: int, tmp_path_factory):
    """Of robots of all kinds of joints among bodies of all kinds, by each value of the configuration."""
    rng = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("robot")
    bodies = simple_bodies(rng) if seed % 2 else composed_bodies(rng)
    robot = random_robot(rng, folder, 5, bodies)
    checker = CollisionChecker(robot, random_scene(rng, robot, 4, bodies))
    if not checker.checked_pairs:
        return
    Q = robot.random_configurations(12, seed=seed % 1000)
    found = checker.distance(Q, exact=True, gradient=True)
    assert found.gradient.shape == Q.shape
    apart = found.distance > 1e-3
    errors = []
    for column in range(robot.dof):
        after, before = (
            checker.distance(np.array([nudged(robot, q, column, step) for q in Q]), exact=True).distance
            for step in (STEP, -STEP)
        )
        errors.append(np.abs((after - before) / (2 * STEP) - found.gradient[:, column])[apart])
    errors = np.concatenate(errors)
    assert len(errors) == 0 or np.median(errors) < 1e-7
    assert len(errors) == 0 or np.mean(errors > 1e-4) < 0.1


def test_gradient_of_one_configuration(tmp_path: Path):
    """It is that of the batch, and is there only where it was asked for."""
    rng = np.random.default_rng(5)
    robot = random_robot(rng, tmp_path, 4, simple_bodies(rng))
    checker = CollisionChecker(robot, random_scene(rng, robot, 3, simple_bodies(rng)))
    Q = robot.random_configurations(5)
    many = checker.distance(Q, exact=True, gradient=True)
    one = checker.distance(Q[2], exact=True, gradient=True)
    np.testing.assert_allclose(one.gradient, many.gradient[2], atol=1e-14)
    assert checker.distance(Q, exact=True).gradient is None
    with pytest.raises(InputError, match="gradient: expected exact=True"):
        checker.distance(Q, gradient=True)
    with pytest.raises(InputError, match="gradient"):
        checker.distance(Q, exact=True, gradient="yes")


def test_a_runaway_step_has_an_answer(tmp_path: Path):
    """An optimiser that leaves the scene behind gets finite numbers, or an error of ours."""
    rng = np.random.default_rng(6)
    robot = random_robot(rng, tmp_path, 4, simple_bodies(rng))
    checker = CollisionChecker(robot, Scene())
    if not checker.checked_pairs:
        pytest.skip("this robot has no pairs")
    q = robot.random_configurations(1)[0]
    turning = [int(c) for c, kind in zip(robot.tree.column, robot.tree.kind, strict=True) if kind == 1]
    q[turning] = 1e9
    with pytest.warns(UserWarning, match="expected a value near the limits"):
        assert np.isfinite(checker.distance(q, exact=True, gradient=True).gradient).all()


@examples(4, 10)
@given(seed=SEEDS)
def test_distances_by_pair_are_those_of_the_pairs(seed: int, tmp_path_factory):
    """All pairs within a distance, and no others; as each pair alone says."""
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng) if seed % 2 else composed_bodies(rng)
    robot = random_robot(rng, tmp_path_factory.mktemp("robot"), 4, bodies)
    checker = CollisionChecker(robot, random_scene(rng, robot, 3, bodies))
    if not checker.checked_pairs:
        return
    Q, within = robot.random_configurations(20, seed=seed % 1000), float(rng.choice([0.0, 0.05, 0.5]))
    expected = np.array([found.distance for found in pairwise(checker, Q, distance, exact=True)])
    found = checker.distance_by_pair(Q, within=within, gradient=True)
    listed = set(zip(found.pair.tolist(), found.configuration.tolist(), strict=True))
    assert len(listed) == len(found)
    sure = np.argwhere(expected <= within - 1e-9)
    assert {tuple(row) for row in sure.tolist()} <= listed
    assert (expected[found.pair, found.configuration] <= within + 1e-9).all()
    np.testing.assert_allclose(found.distance, expected[found.pair, found.configuration], atol=1e-9)
    assert (np.diff(found.configuration) >= 0).all()
    for pair, names in zip(found.pair, found.names.tolist(), strict=True):
        assert set(names) == set(checker.checked_pairs[pair])
    nearest = checker.distance(Q, exact=True, gradient=True)
    for k in range(len(found)):
        at = found.configuration[k]
        if found.distance[k] == nearest.distance[at] and tuple(found.names[k]) == tuple(nearest.names[at]):
            np.testing.assert_allclose(found.gradient[k], nearest.gradient[at], atol=1e-6)


@pytest.mark.parametrize("apart", [1e-6, 0.01, 0.3, 3.0])
@pytest.mark.parametrize("count", quick(20, 200))
def test_bounds_of_ellipsoids_apart_are_tight(apart: float, count: int):
    """Of ellipsoids, which are their own inner and outer ones, both bounds are the distance itself."""
    rng = np.random.default_rng(11)
    for _ in range(count):
        a, b = (Body.ellipsoid(rng.uniform(0.4, 1.0, 3)) for _ in range(2))
        T = [pose(rng, 0.0), pose(rng, 0.0)]
        T[1][:3, 3] = rng.normal(size=3)
        T[1][:3, 3] *= 3.0 / np.linalg.norm(T[1][:3, 3])
        T[1][:3, 3] *= 1 + (apart - distance(a, T[0], b, T[1], exact=True).distance) / 3.0
        found = distance(a, T[0], b, T[1], exact=True)
        assert 0 <= found.distance - found.lower <= 1e-6 * found.distance + 1e-13
        assert 0 <= found.upper - found.distance <= 1e-6 * found.distance + 1e-13


@pytest.mark.parametrize("far", [1e10, 1e19, 1e20, 1e25, 1e38, 1e39, 1e60, 1e150])
def test_bodies_far_beyond_single_precision(far: float, tmp_path: Path):
    """Where squares of single precision overflow bounds are still bounds, and no pair is lost."""
    text = """<robot name="r"><link name="world"/><link name="cube"><collision><geometry><box size="1 1 1"/></geometry>
    </collision></link><joint name="free" type="floating"><parent link="world"/><child link="cube"/></joint></robot>"""
    (tmp_path / "cube.urdf").write_text(text)
    scene = Scene()
    scene.add("post", Body.box([1, 1, 1]))
    checker = CollisionChecker(Robot.from_urdf(tmp_path / "cube.urdf"), scene)
    q = np.array([far, 0, 0, 1, 0, 0, 0])
    found = checker.distance(q, exact=True, gradient=True)
    assert found.lower <= found.distance <= found.upper
    assert found.lower == pytest.approx(far, rel=1e-6)
    assert found.distance == pytest.approx(far, rel=1e-9)
    np.testing.assert_allclose(found.gradient[:3], [1, 0, 0], atol=1e-9)  # turns kink: the faces are parallel
    assert len(checker.distance_by_pair(q, within=2 * far)) == 1


def test_bodies_are_taken_out_once(tmp_path: Path):
    """Bodies are those of the robot and the scene, also when they move; anew where another one takes a name."""
    rng = np.random.default_rng(9)
    robot = random_robot(rng, tmp_path, 3, simple_bodies(rng))
    scene = Scene()
    scene.add("seen", Body.from_cloud(rng.normal(size=(50, 3)), radius=0.1))
    checker = CollisionChecker(robot, scene)
    q = robot.random_configurations(1)

    def nearest():
        found = checker.distance_by_pair(q, within=100.0)
        return found.distance[(found.names == "seen").any(axis=1)]

    before, ready = nearest(), checker._ready()
    kept = [ready.body(k)._packed for k in range(len(ready.names))]
    assert kept[-1] is scene["seen"]._packed
    T = np.eye(4)
    T[0, 3] = 3.0
    scene.move("seen", T)
    moved = nearest()
    assert (moved != before).any()
    assert all(checker._ready().body(k)._packed is pack for k, pack in enumerate(kept))
    scene.remove("seen")
    scene.add("seen", Body.from_cloud(rng.normal(size=(50, 3)) - [3, 0, 0], radius=0.1), T)
    assert (nearest() != moved).any()


def test_bad_distances_by_pair(tmp_path: Path):
    """A distance that is none is refused; of no configurations there are no pairs."""
    rng = np.random.default_rng(8)
    robot = random_robot(rng, tmp_path, 3, simple_bodies(rng))
    checker = CollisionChecker(robot, random_scene(rng, robot, 2, simple_bodies(rng)))
    q = robot.random_configurations(1)
    for within in (-1.0, np.nan, np.inf, "far", None):
        with pytest.raises(InputError, match="within"):
            checker.distance_by_pair(q, within=within)
    assert len(checker.distance_by_pair(q[:0], within=0.1)) == 0
    assert len(CollisionChecker(robot, skip_adjacent=True).distance_by_pair(q, within=0.0)) >= 0


@examples(4, 10)
@given(seed=SEEDS)
def test_distances_do_not_depend_on_the_batch(seed: int, tmp_path_factory):
    """Each configuration is answered as if it were alone, to the last bit."""
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng) if seed % 2 else composed_bodies(rng)
    robot = random_robot(rng, tmp_path_factory.mktemp("robot"), 5, bodies)
    checker = CollisionChecker(robot, random_scene(rng, robot, 4, bodies))
    if not checker.checked_pairs:
        return
    Q = robot.random_configurations(40, seed=seed % 1000)
    many, shifted = checker.distance(Q, exact=True), checker.distance(Q[5:], exact=True)
    bounds = checker.distance(Q)
    np.testing.assert_array_equal(bounds.lower, many.lower)
    np.testing.assert_array_equal(bounds.upper, many.upper)
    for name in ("lower", "upper", "distance", "names"):
        np.testing.assert_array_equal(getattr(many, name)[5:], getattr(shifted, name))
    for k in range(0, len(Q), 7):
        one = checker.distance(Q[k], exact=True)
        assert (one.lower, one.upper, one.distance) == (many.lower[k], many.upper[k], many.distance[k])


def test_bounds_are_rounded_down():
    """To the next float32 below, or the number itself; what is too large for float32 becomes its largest number."""
    single, exact = np.dtype(np.float32), np.array([0.1, -0.1, 0.5, 0.0, 1e-60, -1e-60])
    found = rounded_down(exact, single)
    assert found.dtype == single
    assert (found <= exact).all()
    assert (np.nextafter(found, np.float32(np.inf)) > exact).all()
    np.testing.assert_array_equal(found[2:4], exact[2:4])
    np.testing.assert_array_equal(rounded_down(exact, np.dtype(np.float64)), exact)
    with np.errstate(over="ignore"):
        assert rounded_down([1e39, -1e39], single).tolist() == [np.finfo(single).max, -np.inf]
