"""Smooth clearances of robots: lower bounds, soft minima of the gaps of all pairs, gradients beside differences."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from checker_oracle import composed_bodies, pose, random_robot, random_scene, robot_of, simple_bodies
from loewner import Body, CollisionChecker, ConvergenceError, InputError, Robot, Scene
from sampling import examples
from test_gradients import nudged

SEEDS = st.integers(0, 2**32 - 1)


def expect_good_checkers(ask: Any, q: Any, folder: Path) -> None:
    """Have a function of checkers refuse what is none at once, and one without pairs when it is asked."""
    for bad in (None, "checker", CollisionChecker):
        with pytest.raises(InputError, match=r"checker: expected loewner\.CollisionChecker, found"):
            ask(bad)
    scene = Scene()
    function = ask(cube_on_a_leash(folder, scene))
    with pytest.raises(
        InputError, match=f"{ask.__name__}: expected a robot and a scene with pairs to check, found none"
    ):
        function(q)
    scene.add("ball", Body.sphere(0.5))
    assert function(q) > 1.0


def told(checker: CollisionChecker, name: str, Q: Any) -> tuple[Any, Any]:
    """What the checker itself says."""
    if name == "clearance":
        return checker.clearance(Q, gradient=True)
    found = checker.distance(Q, exact=True, gradient=True)
    return found.distance, found.gradient


def random_checker(rng: np.random.Generator, folder: Path, pieces: int = 1) -> CollisionChecker:
    """A robot of all kinds of joints among bodies; with `pieces` more than one, of bodies of many pieces too."""
    bodies = simple_bodies(rng) if pieces == 1 else composed_bodies(rng)
    robot = random_robot(rng, folder, 6, bodies)
    return CollisionChecker(robot, random_scene(rng, robot, 3, bodies))


def gaps(checker: CollisionChecker, q: np.ndarray) -> np.ndarray:
    """Gaps of all pairs of pieces along their contact normals, by NumPy and bisection."""
    ready = checker._ready()
    T = ready.poses(q[None])[0]
    found = []
    for a, b in ready.pairs:
        (p, P), (q, Q) = (placed(ready.bodies[int(k)], T[k]) for k in (a, b))
        i, j = (at.ravel() for at in np.indices((len(p), len(q))))
        found.append(gap(P[i], Q[j], q[j] - p[i]))
    return np.concatenate(found)


def placed(body: Body, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centers and shape matrices of the outer ellipsoids in the world."""
    F = T[:3, :3] @ body.outer.factor
    return body.outer.center @ T[:3, :3].T + T[:3, 3], F @ np.swapaxes(F, 1, 2)


def gap(P: np.ndarray, Q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """n·r - √(nᵀPn) - √(nᵀQn) over |n|, at the s where the contact function's slope changes sign."""
    low, high = np.zeros(len(r)), np.ones(len(r))
    for _ in range(60):
        s = ((low + high) / 2)[:, None, None]
        n = np.linalg.solve((1 - s) * P + s * Q, r[:, :, None])
        p, q = ((np.swapaxes(n, 1, 2) @ M @ n)[:, 0, 0] for M in (P, Q))
        rises = (1 - s[:, 0, 0]) ** 2 * p > s[:, 0, 0] ** 2 * q
        low, high = np.where(rises, s[:, 0, 0], low), np.where(rises, high, s[:, 0, 0])
    n = n[:, :, 0]
    return (np.sum(n * r, axis=1) - np.sqrt(p) - np.sqrt(q)) / np.linalg.norm(n, axis=1)


@pytest.mark.parametrize("count", [1, pytest.param(6, marks=pytest.mark.verify)])
@examples(2, 6)
@given(seed=SEEDS, pieces=st.sampled_from([1, 3]), softness=st.sampled_from([1e-6, 1e-3, 0.02, 0.3]))
def test_clearances_are_soft_minima_of_all_gaps(seed: int, pieces: int, softness: float, count: int, tmp_path_factory):
    """Beside a sum over all pairs of pieces, with none left out; apart and deep within each other."""
    rng = np.random.default_rng(seed)
    checker = random_checker(rng, tmp_path_factory.mktemp("robot"), pieces)
    for q in checker.robot.random_configurations(count, seed=seed % 1000):
        expected = gaps(checker, q)
        least = expected.min()
        soft = least - softness * np.log(np.exp(-(expected - least) / softness).sum())
        assert checker.clearance(q, softness=softness) == pytest.approx(soft, abs=1e-9)


@examples(8, 20)
@given(seed=SEEDS, pieces=st.sampled_from([1, 3]), softness=st.sampled_from([1e-9, 1e-3, 0.1]))
def test_clearances_are_lower_bounds(seed: int, pieces: int, softness: float, tmp_path_factory):
    """Never above the exact distance, also where bodies overlap; the softer, the lower."""
    rng = np.random.default_rng(seed)
    checker = random_checker(rng, tmp_path_factory.mktemp("robot"), pieces)
    Q = checker.robot.random_configurations(40, seed=seed % 1000)
    found, exact = checker.clearance(Q, softness=softness), checker.distance(Q, exact=True).distance
    assert (found <= exact).all()
    assert (checker.clearance(Q, softness=2 * softness) <= found).all()


@pytest.mark.parametrize("count", [2, pytest.param(10, marks=pytest.mark.verify)])
@examples(5, 12)
@given(seed=SEEDS, pieces=st.sampled_from([1, 3]), softness=st.sampled_from([2e-3, 0.05]))
def test_gradients_of_clearances_are_differences(seed: int, pieces: int, softness: float, count: int, tmp_path_factory):
    """Of robots with all kinds of joints, mimics and attached bodies: the function is smooth, so every one is near."""
    rng = np.random.default_rng(seed)
    checker = random_checker(rng, tmp_path_factory.mktemp("robot"), pieces)
    for q in checker.robot.random_configurations(count, seed=seed % 1000):
        _, gradient = checker.clearance(q, softness=softness, gradient=True)
        weights = {1e-5: 8, -1e-5: -8, 2e-5: -1, -2e-5: 1}
        near = [[nudged(checker.robot, q, column, step) for step in weights] for column in range(checker.robot.dof)]
        values = checker.clearance(np.reshape(near, (checker.robot.dof, 4, checker.robot.dof)), softness=softness)
        differences = values @ list(weights.values()) / (12 * 1e-5)
        assert (np.abs(gradient - differences) <= 1e-6 * (1 + np.abs(differences))).all()


@pytest.mark.parametrize(("softness", "seed"), [(0.005, 3), (0.02, 3), (0.1, 3), (0.1, 5), (0.02, 7)])
def test_clearances_do_not_depend_on_the_batch(softness: float, seed: int, tmp_path: Path):
    """To the bit, alone, in batches of every size and in another order; also of more pairs of pieces than a run."""
    rng = np.random.default_rng(seed)
    checker = random_checker(rng, tmp_path, 3)
    Q = checker.robot.random_configurations(30, seed=4)
    value, gradient = checker.clearance(Q, softness=softness, gradient=True)
    order = rng.permutation(len(Q))
    for size in (1, 3, 8, 11):
        for k in range(0, len(Q), size):
            rows = order[k : k + size]
            some, slopes = checker.clearance(Q[rows], softness=softness, gradient=True)
            np.testing.assert_array_equal(some, value[rows])
            np.testing.assert_array_equal(slopes, gradient[rows])
    alone, slope = checker.clearance(Q[0], softness=softness, gradient=True)
    assert isinstance(alone, float)
    assert alone == value[0]
    np.testing.assert_array_equal(slope, gradient[0])


def cube_on_a_leash(folder: Path, scene: Scene) -> CollisionChecker:
    """A floating cube of a metre."""
    text = """<robot name="r"><link name="world"/><link name="cube"><collision><geometry><box size="1 1 1"/></geometry>
    </collision></link><joint name="free" type="floating"><parent link="world"/><child link="cube"/></joint></robot>"""
    (folder / "cube.urdf").write_text(text)
    return CollisionChecker(Robot.from_urdf(folder / "cube.urdf"), scene)


@pytest.mark.verify
def test_more_pieces_than_a_run(tmp_path: Path):
    """Sums over several runs of pairs are those over all."""
    rng = np.random.default_rng(5)
    T = np.tile(np.eye(4), (2100, 1, 1))
    T[:, :3, 3] = rng.normal(size=(2100, 3)) * 3
    scene = Scene()
    speck = Body.sphere(0.05)
    scene.add("dust", Body.union([speck.transformed(each) for each in T]))
    checker = cube_on_a_leash(tmp_path, scene)
    q = np.array([1.0, 0.5, 0.2, 1, 0, 0, 0])
    expected = gaps(checker, q)
    least, softness = expected.min(), 0.5
    soft = least - softness * np.log(np.exp(-(expected - least) / softness).sum())
    assert checker.clearance(q, softness=softness) == pytest.approx(soft, abs=1e-9)
    _, gradient = checker.clearance(q, softness=softness, gradient=True)
    step = np.array([1e-5, 0, 0, 0, 0, 0, 0])
    after, before = (checker.clearance(q + way * step, softness=softness) for way in (1, -1))
    assert gradient[0] == pytest.approx((after - before) / 2e-5, abs=1e-7)


@pytest.mark.filterwarnings("ignore:body 'other'. expected lengths in metres")
@pytest.mark.parametrize(("thin", "rough"), [(1e-3, 1e-8), (1e-4, 1e-6), (1e-5, 1e-4), (1e-6, 1e-2)])
def test_needles(thin: float, rough: float, tmp_path: Path):
    """Of a needle and a speck, or two needles, neighbouring configurations have neighbouring clearances."""
    for other in (Body.sphere(thin), Body.capsule(thin, 1.0), Body.box([1.0, 0.01, thin])):
        scene = Scene()
        scene.add("other", other, pose(np.random.default_rng(1), 0.0))
        text = f"""<robot name="r"><link name="world"/><link name="rod"><collision><origin rpy="0.3 0.5 0.7"/><geometry>
        <capsule radius="{thin}" length="1"/></geometry></collision></link><joint name="free" type="floating">
        <parent link="world"/><child link="rod"/></joint></robot>"""
        (tmp_path / "rod.urdf").write_text(text)
        checker = CollisionChecker(Robot.from_urdf(tmp_path / "rod.urdf"), scene)
        rng = np.random.default_rng(2)
        for _ in range(40):
            q = np.array([*rng.normal(size=3) * rng.choice([0.3, 1.0, 4.0]), 1, 0, 0, 0])
            near = np.tile(q, (16, 1))
            near[:, :3] += rng.uniform(-1e-9, 1e-9, size=(16, 3))
            found = checker.clearance(near)
            assert np.ptp(found) <= rough
            assert (found <= checker.distance(near, exact=True).distance).all()


def test_concentric_ellipsoids(tmp_path: Path):
    """The bound holds where centers coincide; the pair adds nothing to the gradient."""
    scene = Scene()
    scene.add("post", Body.box([1, 1, 1]))
    checker = cube_on_a_leash(tmp_path, scene)
    q = np.array([0.0, 0, 0, 1, 0, 0, 0])
    value, gradient = checker.clearance(q, gradient=True)
    assert value <= checker.distance(q, exact=True).distance
    assert value == pytest.approx(-np.sqrt(3))
    np.testing.assert_array_equal(gradient, np.zeros(7))


@pytest.mark.parametrize("far", [1e3, 1e9, 1e20, 1e100])
def test_far_bodies(far: float, tmp_path: Path):
    """Far from each other, the bound is the distance but for a share, and the gradient the direction."""
    scene = Scene()
    scene.add("post", Body.box([1, 1, 1]))
    value, gradient = cube_on_a_leash(tmp_path, scene).clearance([far, 0, 0, 1, 0, 0, 0], gradient=True)
    assert 0.99 * (far - 2) <= value <= far
    np.testing.assert_allclose(gradient[:3], [1, 0, 0], atol=1e-6)


def test_bad_input_of_clearances(tmp_path: Path):
    """What is asked for wrongly is said; so is what overflows."""
    checker = cube_on_a_leash(tmp_path, Scene())
    q = [3.0, 0, 0, 1, 0, 0, 0]
    with pytest.raises(InputError, match="expected a robot and a scene with pairs to check, found none"):
        checker.clearance(q)
    scene = Scene()
    scene.add("post", Body.box([1, 1, 1]))
    checker = cube_on_a_leash(tmp_path, scene)
    for softness in (0, -1e-3, np.nan, np.inf, "soft", True):
        with pytest.raises(InputError, match="softness"):
            checker.clearance(q, softness=softness)
    with pytest.raises(InputError, match="gradient"):
        checker.clearance(q, gradient=1.5)
    with pytest.raises(InputError, match="expected finite numbers"):
        checker.clearance([np.nan, 0, 0, 1, 0, 0, 0])
    with pytest.raises(ConvergenceError, match="positions overflow at configuration"):
        checker.clearance([1e180, 0, 0, 1, 0, 0, 0])
    values, gradients = checker.clearance(np.empty((0, 7)), gradient=True)
    assert values.shape == (0,)
    assert gradients.shape == (0, 7)


@pytest.mark.filterwarnings("ignore:Q. expected a value near the limits")
def test_runaway_configurations(tmp_path: Path):
    """A step of an optimiser that went far astray gives finite numbers."""
    rng = np.random.default_rng(8)
    robot = random_robot(rng, tmp_path, 5, simple_bodies(rng))
    checker = CollisionChecker(robot, random_scene(rng, robot, 3, simple_bodies(rng)))
    for q in robot.random_configurations(5, seed=2):
        value, gradient = checker.clearance(np.where(np.abs(q) < 7, q * 1e9, q), gradient=True)
        assert np.isfinite(value)
        assert np.isfinite(gradient).all()


def test_gradients_through_mimicking_joints(tmp_path: Path):
    """A joint's value moves all that mimic it, each by its multiplier: turning, sliding, and both at once."""
    bodies = {f"l{k}": Body.capsule(0.04, 0.3) for k in range(1, 4)}
    robot = robot_of(
        tmp_path,
        [
            ("revolute", 0, '<origin xyz="0 0 0.3"/><axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2"/>'),
            ("prismatic", 1, '<origin xyz="0.2 0 0.3"/><axis xyz="1 0 0"/><limit lower="-2" upper="2"/>'
                             '<mimic joint="j1" multiplier="-0.5" offset="0.1"/>'),
            ("revolute", 2, '<origin xyz="0 0.1 0.3"/><axis xyz="0 1 0"/><limit lower="-2" upper="2"/>'
                            '<mimic joint="j1" multiplier="3"/>'),
        ],
        bodies,
    )  # fmt: skip
    scene = Scene()
    scene.add(
        "post", Body.box([0.2, 0.3, 0.4]), np.array([[1.0, 0, 0, 0.7], [0, 1, 0, 0.2], [0, 0, 1, 0.5], [0, 0, 0, 1]])
    )
    checker = CollisionChecker(robot, scene)
    assert robot.dof == 1
    for q in np.linspace(-0.6, 0.4, 6)[:, None]:
        _, slope = checker.clearance(q, gradient=True)
        exact = checker.distance(q, exact=True, gradient=True).gradient
        for found, query in (
            (slope, checker.clearance),
            (exact, lambda x: checker.distance(x, exact=True).distance),
        ):
            difference = (query(q + 1e-6) - query(q - 1e-6)) / 2e-6
            assert found[0] == pytest.approx(difference, abs=1e-6)
