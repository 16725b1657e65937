"""The threads of a GPU, run in a loop on the CPU, and the PTX that is made of them."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
import zlib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numba
import numpy as np
import pytest

from checker_oracle import random_scene, robot_of, simple_bodies
from families import FAMILIES, pieces, random_poses
from gpu_stand_in import StandIn, put_in
from loewner import Bodies, Body, CollisionChecker, Robot, Scene, Verdict, classify, gpu
from loewner._kernels import _sealed, _store, columns
from loewner._kernels._sources import source_hash
from loewner._kernels.simd import scalars, trig
from loewner._kernels.threads import configurations as threads_of_configurations
from loewner._native import library
from loewner.gpu import _ptx, configurations, driver, motions, tables, tiles
from loewner.gpu.driver import Device

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import robot_samples
from sampling import quick

U24 = 2.0**-24


@pytest.fixture(scope="module")
def device() -> Device:
    """A GPU whose threads run one after the other."""
    made = StandIn()
    with pytest.MonkeyPatch.context() as patch:
        put_in(patch, made)
        return Device(0, made)


@pytest.fixture(autouse=True)
def stand_in(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "opened", lambda number: device)


def told(a, Ta, b, Tb) -> tuple[np.ndarray, np.ndarray]:
    """What the GPU says of pairs by itself, and what the CPU says."""
    return np.asarray(gpu.classify(a, Ta, b, Tb, refine=False)), classify(a, Ta, b, Tb)


# -- pairs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", quick(3_000, 100_000))
def test_pairs_are_told_as_on_the_cpu(rng, n):
    """Of turned pairs no claim differs; few are left to the CPU, and with these all verdicts agree."""
    kinds = tuple(FAMILIES)
    bodies = Bodies.from_points([V for kind in kinds for V in pieces(kind, 30)])
    chosen = rng.integers(0, len(bodies), size=(n, 2))
    a, b = bodies[chosen[:, 0]], bodies[chosen[:, 1]]
    Ta, Tb = random_poses(rng, n, 1.0), random_poses(rng, n, 1.0)
    alone, expected = told(a, Ta, b, Tb)
    claims = alone != Verdict.AMBIGUOUS
    assert (alone[claims] == expected[claims]).all()
    assert (np.bincount(expected, minlength=3) > n // 50).all()
    assert (alone != expected).mean() < 0.02
    np.testing.assert_array_equal(gpu.classify(a, Ta, b, Tb), expected)


@pytest.mark.parametrize("spread", [1e-3, 1.0, 100.0])
def test_no_claim_is_wrong_far_from_the_origin(rng, spread):
    """Wherever the world's origin is, a claim is the CPU's, in double precision."""
    bodies = Bodies.from_points(pieces("ball 20", 50))
    shift = rng.normal(size=(50, 3)) * spread
    Ta, Tb = random_poses(rng, 50, 0.3), random_poses(rng, 50, 0.3)
    Ta[:, :3, 3] += shift
    Tb[:, :3, 3] += shift
    alone, expected = told(bodies, Ta, bodies, Tb)
    assert ((alone == expected) | (alone == Verdict.AMBIGUOUS)).all()


def test_bodies_of_several_pieces(rng):
    """A union of pieces is FREE only if all piece pairs are, COLLIDING if any is; a body of many is left to the CPU."""
    parts = [Body.from_points(V) for V in pieces("ball 8", 40)]
    several = [
        Body.union([part.transformed(T) for part, T in zip(parts[k::8], random_poses(rng, 5, 0.8), strict=True)])
        for k in range(8)
    ]
    many = Body.spheres(rng.normal(size=(1100, 3)), np.full(1100, 0.05))
    bodies = Bodies([*several, many, parts[0]])
    chosen = rng.integers(0, len(bodies), size=(300, 2))
    Ta, Tb = random_poses(rng, len(bodies), 1.0), random_poses(rng, len(bodies), 1.0)
    expected = classify(bodies, Ta, bodies, Tb, pairs=chosen)
    alone = gpu.classify(bodies, Ta, bodies, Tb, pairs=chosen, refine=False)
    claims = alone != Verdict.AMBIGUOUS
    assert (alone[claims] == expected[claims]).all()
    assert claims.mean() > 0.3
    np.testing.assert_array_equal(gpu.classify(bodies, Ta, bodies, Tb, pairs=chosen), expected)


def test_surfaces_get_what_the_cpu_knows_besides(rng):
    """What the ellipsoids of a surface leave open is not AMBIGUOUS yet: its parts are asked on the CPU."""
    n = 8
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    vertices = np.column_stack([x.ravel(), y.ravel(), 0.2 * np.sin(3 * x.ravel())])
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.c_[corner, corner + 1, corner + n], np.c_[corner + 1, corner + n + 1, corner + n]])
    sheet, ball = Body.from_surface((vertices, faces)), Body.sphere(0.2)
    T = random_poses(rng, 400, 0.8)
    np.testing.assert_array_equal(gpu.classify(sheet, None, ball, T), classify(sheet, None, ball, T))


# -- kinematics ------------------------------------------------------------------------------------


@numba.njit
def _sines(angles, found):
    for k in range(len(angles)):
        s, c = trig.sine_cosine_single(scalars.number_at(angles.ctypes.data, k))
        scalars.put_number(found.ctypes.data, 2 * k, s)
        scalars.put_number(found.ctypes.data, 2 * k + 1, c)


def test_sines_are_within_their_bound(rng):
    """Sine and cosine of floats up to 1000 rad are off by less than 5 roundings, near quarter turns too."""
    near = np.arange(-600, 600) * (np.pi / 2) + rng.normal(size=1200) * 1e-4
    angles = np.concatenate([rng.uniform(-1000, 1000, 200_000), rng.uniform(-4, 4, 200_000), near, [0.0]])
    angles = angles.astype(np.float32)
    found = np.empty((len(angles), 2), dtype=np.float32)
    _sines(angles, found)
    exact = np.column_stack([np.sin(angles.astype(float)), np.cos(angles.astype(float))])
    off = np.abs(found - exact).max() / U24
    print(f"at most {off:.2f} roundings")
    assert off < 4.2


def placed_links(device: Device, robot: Robot, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of links as the GPU has them, and how far off it says they may be: shapes (N, L, 3, 4) and (N, L, 2)."""
    t = tables.tables_of(device, CollisionChecker(robot, Scene())._ready())
    S, n = 1024, len(Q)
    placed, there = device.memory(4 * columns.LINK_NUMBERS * t.links * S), device.upload(Q.astype(np.float32))
    device.launch(
        "place_links", n, S, there.address, 0, robot.dof, t.links, t.joints.address, t.constants.address, placed.address
    )
    found = np.empty((t.links, columns.LINK_NUMBERS, S), dtype=np.float32)
    device.download(placed.address, found)
    numbers = found[:, :, :n].transpose(2, 0, 1).astype(np.float64)
    R, t = numbers[:, :, :9].reshape(n, -1, 3, 3), numbers[:, :, 9:12, None]
    return np.concatenate([R, t], axis=3), numbers[:, :, 12:]


@pytest.mark.parametrize("seed", range(6))
def test_links_are_where_they_are_said_to_be(seed, device, tmp_path):
    """Rotations and translations in single precision are off by less than the bound that comes with them."""
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng)
    joints = [
        (str(rng.choice(["revolute", "prismatic", "fixed", "continuous"])), k, _joint(rng))
        for k in range(int(4 * seed + 3))
    ]
    robot = robot_of(tmp_path, joints, {"l1": bodies[0]})
    Q = rng.uniform(-3.0, 3.0, size=(500, robot.dof)) * rng.choice([1.0, 10.0], size=(500, 1))
    found, said = placed_links(device, robot, Q)
    exact = robot.forward_kinematics(Q)[:, :, :3]
    turned = np.linalg.norm((found - exact)[..., :3], axis=(2, 3))
    moved = np.linalg.norm((found - exact)[..., 3], axis=2)
    assert (turned <= U24 * said[..., 0]).all(), (turned / (U24 * said[..., 0])).max()
    assert (moved <= U24 * said[..., 1]).all(), (moved / (U24 * said[..., 1])).max()


def _joint(rng: np.random.Generator, length: float = 1.0) -> str:
    """A joint's place, axis and wide limits."""
    axis, place, turn = rng.normal(size=3), rng.normal(size=3) * length, rng.uniform(-3, 3, 3)
    text = " ".join(map(str, axis / np.linalg.norm(axis)))
    where = f'<origin xyz="{" ".join(map(str, place))}" rpy="{" ".join(map(str, turn))}"/>'
    return f'{where}<axis xyz="{text}"/><limit lower="-1000" upper="1000" effort="1" velocity="1"/>'


# -- robots ----------------------------------------------------------------------------------------


@pytest.mark.slow("each thread of a GPU runs in Python")
@pytest.mark.parametrize("n", quick(1_000, 100_000))
def test_a_panda_collides_as_on_the_cpu(n):
    """Of configurations among ten obstacles every answer is the checker's, and most need no CPU."""
    robot = robot_samples.panda().robot
    checker = CollisionChecker(robot, robot_samples.obstacles(3))
    Q = robot.random_configurations(n, seed=1)
    expected = checker.collide(Q)
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal(gpu.Checker(checker).collide(Q), expected)


def test_no_claim_about_a_configuration_is_wrong(device, rng):
    """What the GPU does not leave to the CPU is right: no wrong FREE, no wrong COLLIDING; it leaves one in 500."""
    robot = robot_samples.panda().robot
    checker = CollisionChecker(robot, robot_samples.obstacles(4))
    Q = robot.random_configurations(30_000, seed=2)
    ready, there = checker._ready(), device.upload(Q.astype(np.float32))
    verdicts, left = gpu.Checker(checker)._asked(ready, device, len(Q), there.address)
    said = np.empty(len(Q), dtype=np.int8)
    device.download(verdicts.address, said)
    assert ((said == Verdict.AMBIGUOUS) == np.isin(np.arange(len(Q)), left)).all()
    claims = said != Verdict.AMBIGUOUS
    assert (said[claims] == checker.collide(Q)[claims]).all()
    assert claims.mean() > 0.998


@pytest.mark.parametrize("seed", range(10))
def test_any_robot_collides_as_on_the_cpu(seed, tmp_path):
    """Robots of joints that turn or slide, bodies of several pieces, attachments, margins, scenes that change."""
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng)
    joints = [
        (str(rng.choice(["revolute", "prismatic", "fixed"])), int(rng.integers(0, k + 1)), _joint(rng))
        for k in range(6)
    ]
    union = Body.union([bodies[0], bodies[1].transformed(random_poses(rng, 1, 0.5)[0])])
    robot = robot_of(tmp_path, joints, {f"l{k}": union if k == 3 else bodies[k % len(bodies)] for k in range(1, 7)})
    scene = random_scene(rng, robot, int(rng.integers(0, 6)), [*bodies, union])
    scene.add("one", bodies[2], random_poses(rng, 1, 1.0)[0])
    checker = CollisionChecker(robot, scene)
    on_gpu = gpu.Checker(checker)
    Q = rng.uniform(-2.0, 2.0, size=(300, robot.dof))
    np.testing.assert_array_equal(on_gpu.collide(Q), checker.collide(Q))
    scene.add("two", union, random_poses(rng, 1, 2.0)[0])
    scene.move("one", random_poses(rng, 1, 2.0)[0])
    np.testing.assert_array_equal(on_gpu.collide(Q.reshape(3, 100, -1)), checker.collide(Q).reshape(3, 100))
    assert on_gpu.collide(Q[0]) == checker.collide(Q[0])


@pytest.mark.slow("each thread of a GPU runs in Python")
@pytest.mark.parametrize("count", quick(24, 200))
def test_a_list_that_is_too_short_leaves_work_to_the_cpu(monkeypatch, tmp_path, count):
    """Where more pairs survive than were expected, or intervals stay open, answers stay right."""
    rng = np.random.default_rng(0)
    bodies = simple_bodies(rng)
    joints = [("revolute", k, _joint(rng)) for k in range(4)]
    robot = robot_of(tmp_path, joints, {f"l{k}": bodies[k] for k in range(5)})
    checker = CollisionChecker(robot, Scene(), skip_adjacent=False)
    Q = robot.random_configurations(count, 3)
    tile = tiles.tile_of
    monkeypatch.setattr(configurations, "tile_of", lambda *of: tile(*of)._replace(capacity=50))
    np.testing.assert_array_equal(gpu.Checker(checker).collide(Q), checker.collide(Q))
    monkeypatch.setattr(motions, "INTERVALS", 2)
    expected = checker.certify_edges(Q[: count // 2], Q[count // 2 :]).verdict
    np.testing.assert_array_equal(gpu.Checker(checker).certify_edges(Q[: count // 2], Q[count // 2 :]), expected)


@numba.njit
def _listed(searches, capacity):
    return threads_of_configurations.list_piece_pair(7, 8, 9, searches.ctypes.data, capacity)


def test_a_full_list_is_not_counted_on():
    """Pieces of all pairs may be more than an int32 counts: a count that wrapped would write before the list."""
    for count, room in ((0, True), (9, True), (10, False), (2**31 - 1, False)):
        searches = np.zeros(1 + 3 * 11, dtype=np.int32)
        searches[0] = count
        assert _listed(searches, 10) == room
        assert searches[0] == count + room
        assert np.flatnonzero(searches[1:]).tolist() == ([3 * count, 3 * count + 1, 3 * count + 2] if room else [])


def test_threads_may_share_a_checker():
    """Calls from several threads at once do not disturb each other."""
    robot = robot_samples.panda().robot
    checker = CollisionChecker(robot, robot_samples.obstacles(3))
    on_gpu = gpu.Checker(checker)
    given = [robot.random_configurations(300, seed=k) for k in range(8)]
    expected = [checker.collide(Q) for Q in given]
    with ThreadPoolExecutor(4) as threads:
        for found, wanted in zip(threads.map(on_gpu.collide, given * 4), expected * 4, strict=True):
            np.testing.assert_array_equal(found, wanted)


# -- motions ---------------------------------------------------------------------------------------


def claimed(device: Device, checker: CollisionChecker, Q0: np.ndarray, Q1: np.ndarray) -> np.ndarray:
    """Verdicts of motions on the GPU alone; what is left to the CPU is AMBIGUOUS."""
    on_gpu, there = gpu.Checker(checker), [device.upload(Q.astype(np.float32)) for Q in (Q0, Q1)]
    t = on_gpu._tables_of(device, checker._ready())
    ends = there[0].address, there[1].address
    tile = on_gpu._tile_of(device, t, 4 * len(Q0))
    verdicts, left = motions.certified(device, t, tile, checker.robot.dof, ends, len(Q0))
    said = np.empty(len(Q0), dtype=np.int8)
    device.download(verdicts.address, said)
    assert ((said == Verdict.AMBIGUOUS) == np.isin(np.arange(len(Q0)), left)).all()
    return said


@pytest.mark.parametrize("share", [1.0, 0.1])
@pytest.mark.parametrize("count", quick(800, 2000))
def test_no_claim_about_a_motion_is_wrong(share, device, count):
    """Motions of a Panda among obstacles: no claim differs from the CPU's proof, and few are left."""
    robot = robot_samples.panda().robot
    checker = CollisionChecker(robot, robot_samples.obstacles(4))
    Q0 = robot.random_configurations(count, seed=2).astype(np.float32).astype(np.float64)
    Q1 = (Q0 + share * (robot.random_configurations(count, seed=3) - Q0)).astype(np.float32).astype(np.float64)
    said, expected = claimed(device, checker, Q0, Q1), checker.certify_edges(Q0, Q1).verdict
    claims = said != Verdict.AMBIGUOUS
    assert (np.bincount(expected, minlength=3)[:2] > 0.15 * count).all()
    np.testing.assert_array_equal(said[claims], expected[claims])
    assert claims.mean() > 0.99
    np.testing.assert_array_equal(gpu.Checker(checker).certify_edges(Q0[:200], Q1[:200]), expected[:200])


@pytest.mark.parametrize("seed", range(10))
def test_any_robot_moves_as_on_the_cpu(seed, device, tmp_path):
    """Joints that turn or slide, all kinds of pieces, unions, attachments and margins."""
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng)
    joints = [
        (str(rng.choice(["revolute", "prismatic", "continuous"])), int(rng.integers(max(0, k - 1), k + 1)),
         _joint(rng, 0.2))
        for k in range(5)
    ]  # fmt: skip
    union = Body.union([bodies[0], bodies[1].transformed(random_poses(rng, 1, 0.5)[0])])
    robot = robot_of(tmp_path, joints, {f"l{k}": union if k == 3 else bodies[(k + seed) % 9] for k in range(1, 6)})
    scene = random_scene(rng, robot, 5, [*bodies, union])
    checker = CollisionChecker(robot, scene)
    Q0 = rng.uniform(-0.7, 0.7, size=(150, robot.dof)).astype(np.float32).astype(np.float64)
    Q1 = (Q0 + rng.normal(size=Q0.shape) * rng.choice([1.0, 0.1], size=(150, 1))).astype(np.float32).astype(np.float64)
    said, found = claimed(device, checker, Q0, Q1), checker.certify_edges(Q0, Q1)
    claims = (said != Verdict.AMBIGUOUS) & (found.verdict != Verdict.AMBIGUOUS)
    np.testing.assert_array_equal(said[claims], found.verdict[claims])
    assert claims.mean() > 0.9


@pytest.mark.parametrize("kinds", [["revolute"], ["revolute", "revolute"], ["continuous", "prismatic"]])
def test_obstacles_just_beyond_an_arc(kinds, device, tmp_path):
    """A tip turns past an obstacle that its arc, but no chord, reaches: what a bound that is 3 % too small misses."""
    inside = '<axis xyz="{}"/><limit lower="-9" upper="9" effort="1" velocity="1"/>'
    joints = [(kind, k, inside.format("1 0 0" if kind == "prismatic" else "0 0 1")) for k, kind in enumerate(kinds)]
    tip = Body.sphere(0.05).transformed([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    robot = robot_of(tmp_path, joints, {f"l{len(kinds)}": tip})
    scene = Scene()
    scene.add("post", Body.box([0.04, 0.04, 0.04]))
    checker, rng, place = CollisionChecker(robot, scene), np.random.default_rng(1), np.eye(4)
    collide = 0
    for off in [*-(10.0 ** np.arange(-6, -1.9, 0.5)), *10.0 ** np.arange(-6, -3.9, 0.5)]:
        place[0, 3] = 1.0 + 0.05 + 0.02 + off
        scene.move("post", place)
        turn = rng.uniform(0.1, 1.5, (30, 1)) * np.where(np.array(kinds) == "prismatic", 0.0, 1.0)
        Q0, Q1 = -turn * rng.uniform(0.2, 1.0, (30, 1)), turn
        said, expected = claimed(device, checker, Q0, Q1), checker.certify_edges(Q0, Q1).verdict
        claims = (said != Verdict.AMBIGUOUS) & (expected != Verdict.AMBIGUOUS)
        np.testing.assert_array_equal(said[claims], expected[claims])
        collide += int((said == Verdict.COLLIDING).sum())
    assert collide > 100


@pytest.mark.parametrize("seed", range(4))
def test_paths_bend_no_more_than_the_bound(seed, device, tmp_path):
    """The second derivative of a point of one body, seen from another one, is at most the bound of their chain."""
    rng = np.random.default_rng(seed)
    joints = [(str(rng.choice(["revolute", "prismatic"])), int(rng.integers(0, k + 1)), _joint(rng)) for k in range(6)]
    ball = Body.sphere(0.1)
    robot = robot_of(tmp_path, joints, {f"l{k}": ball for k in range(1, 7)})
    ready = CollisionChecker(robot, Scene(), skip_adjacent=False)._ready()
    t, n = tables.tables_of(device, ready), 50
    Q0, Q1 = (rng.uniform(-2.0, 2.0, size=(n, robot.dof)).astype(np.float32) for _ in range(2))
    there, bends = [device.upload(Q) for Q in (Q0, Q1)], device.memory(4 * t.chains * n)
    asked = n, n, robot.dof, there[0].address, there[1].address, t.cell.address, bends.address
    device.launch("bound_motion", t.chains * n, *asked)
    bound = np.empty((t.chains, n), dtype=np.float32)
    device.download(bends.address, bound)
    step, at = 1e-3, np.linspace(0.0, 1.0, 21)[:, None, None]
    poses = [robot.forward_kinematics(Q0.astype(float) + (at + k * step) * (Q1.astype(float) - Q0)) for k in (-1, 0, 1)]
    roles = tables._Chains(ready).roles
    point, closest = np.array([0.1, 0.0, 0.0, 1.0]), 0.0
    for pair in range(len(ready.pairs)):
        upper, lower = (int(ready.link[body]) for body in roles[pair, [columns.UPPER, columns.LOWER]])
        seen = [np.linalg.inv(T[:, :, lower]) @ T[:, :, upper] @ point for T in poses]
        second = np.linalg.norm(seen[0] - 2 * seen[1] + seen[2], axis=-1).max(axis=0) / step**2
        limit = bound[roles[pair, columns.CHAIN]]
        assert (second <= limit * (1 + 1e-3) + 1e-6).all()
        closest = max(closest, float((second / np.maximum(limit, 1e-6)).max()))
    print(f"at most {closest:.2f} of the bound")
    assert closest > 0.9


# -- PTX -------------------------------------------------------------------------------------------
# Compiling it takes half a minute: `make verify`, `make test-gpu` and `.ci/run` run these tests, not the quick suite.


@pytest.fixture(scope="module")
def ptx() -> str:
    return _ptx.text().decode()


@pytest.mark.verify
def test_ptx_rounds_correctly(ptx):
    """Only operations that round to the nearest; nothing approximate, flushed to zero or in double precision."""
    operations = Counter(re.findall(r"^\s+(?:@\S+ )?([a-z]\w*(?:\.\w+)+)", ptx, flags=re.M))
    of_floats = {name for name in operations if name.endswith(".f32")}
    exact = {"abs.f32", "neg.f32", "max.f32", "min.f32", "selp.f32", "mov.f32", "cvt.rni.f32.f32", "cvt.rmi.f32.f32"}
    exact |= {"copysign.f32"}
    exact |= {name for name in of_floats if name.startswith(("setp.", "ld.", "st."))} | {"cvt.rn.f32.s32"}
    rounded = {"add.f32", "sub.f32", "mul.f32", "fma.rn.f32", "div.rn.f32", "rcp.rn.f32", "sqrt.rn.f32"}
    rounded |= {"add.rn.f32", "sub.rn.f32", "mul.rn.f32"}  # without a word they round to the nearest, too
    assert of_floats <= exact | rounded, of_floats - exact - rounded
    assert {"fma.rn.f32", "div.rn.f32", "sqrt.rn.f32"} <= of_floats
    for word in (".f64", ".approx", ".ftz", ".full", ".local"):
        assert word not in ptx, word
    assert not re.search(r"\bcall\b|\.extern|\.func", ptx)


@pytest.mark.verify
def test_ptx_has_every_kernel(ptx):
    """Each kernel is there, takes its function's arguments, and is for GPUs from the oldest on."""
    kernels = {name for names in _ptx.KERNELS.values() for name in names}
    assert set(re.findall(r"\.visible \.entry (\w+)\(", ptx)) == kernels
    assert re.search(r"^\.version 7\.0$", ptx, flags=re.M)
    assert re.search(r"^\.target sm_75$", ptx, flags=re.M)


@pytest.mark.verify
def test_ptx_is_the_same_when_it_is_made_again():
    """What is compiled depends on nothing but the sources."""
    assert _ptx.compiled() == _ptx.compiled()


def test_ptx_is_kept_and_made_anew_when_damaged(monkeypatch, tmp_path):
    """Where none was built, it is kept in a sealed file; one that is damaged is not used."""
    monkeypatch.setattr(library, "shipped", lambda name: None)
    monkeypatch.setattr(_store, "FOLDER", tmp_path)
    monkeypatch.setattr(_ptx, "compiled", lambda: b"made")
    _ptx.text.cache_clear()
    assert _ptx.text() == b"made"
    (path,) = tmp_path.iterdir()
    assert _sealed.read(path) == b"made"
    monkeypatch.setattr(_ptx, "compiled", lambda: b"again")
    _ptx.text.cache_clear()
    assert _ptx.text() == b"made"
    path.write_bytes(path.read_bytes()[:-1])
    _ptx.text.cache_clear()
    assert _ptx.text() == b"again"
    _ptx.text.cache_clear()


@pytest.mark.verify
def test_shipped_ptx_is_that_of_the_sources():
    """What was built beside the library is what is compiled now."""
    shipped = library.shipped(_ptx.NAME)
    if shipped is None:
        pytest.skip("nothing was built for GPUs: python native/build.py --gpu")
    names = re.compile(rb"[$%][\w$]+")  # of registers and branches, which have numbers
    assert names.sub(b"", zlib.decompress(shipped)) == names.sub(b"", _ptx.compiled())


def test_shipped_ptx_is_not_used_where_it_is_damaged(monkeypatch, tmp_path):
    """It is as the list of the build has it, or there is none."""
    shipped = zlib.compress(b"built")
    (tmp_path / _ptx.NAME).write_bytes(shipped)
    listed = {"sources": source_hash(), "numba": "0", "files": {_ptx.NAME: hashlib.sha256(shipped).hexdigest()}}
    (tmp_path / library.LIST).write_text(json.dumps(listed))
    monkeypatch.setattr(library, "HOME", tmp_path)
    monkeypatch.delenv("LOEWNER_JIT", raising=False)
    assert library.shipped(_ptx.NAME) == shipped
    (tmp_path / _ptx.NAME).write_bytes(shipped[:-1])
    assert library.shipped(_ptx.NAME) is None
    (tmp_path / _ptx.NAME).unlink()
    assert library.shipped(_ptx.NAME) is None


# Registers that a kernel may take, of 65,536 that its threads share.
REGISTERS = {
    "classify_pieces": 80, "classify_bodies": 100, "certify_survivor": 100, "place_links": 80, "search_survivor": 100,
    "certify_interval": 100, "search_interval": 168,
}  # fmt: skip


def ptxas() -> Path | None:
    """NVIDIA's assembler, of its package or of a toolkit."""
    try:
        files = distribution("nvidia-cuda-nvcc").files or []
        found = [Path(str(path.locate())) for path in files if path.name in ("ptxas", "ptxas.exe")]
    except PackageNotFoundError:
        found = []
    return found[0] if found else (Path(other) if (other := shutil.which("ptxas")) else None)


@pytest.mark.verify
@pytest.mark.parametrize("arch", ["sm_75", "sm_80", "sm_86", "sm_89", "sm_90", "sm_100", "sm_120"])
def test_ptx_assembles_without_spills(arch, ptx, tmp_path):
    """NVIDIA's own assembler takes it for all GPUs since 2018; no kernel spills registers, and none takes many."""
    assembler = ptxas()
    if assembler is None:
        pytest.skip("no ptxas here: pip install -r requirements/gpu.txt")
    source = tmp_path / "threads.ptx"
    source.write_text(ptx)
    command = [str(assembler), "-v", f"-arch={arch}", "-o", str(tmp_path / "threads.cubin"), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told_of = re.findall(
        r"Compiling entry function '(\w+)'.*?(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads"
        r".*?Used (\d+) registers",
        done.stderr + done.stdout, flags=re.S,
    )  # fmt: skip
    assert {name for name, *_ in told_of} == {name for names in _ptx.KERNELS.values() for name in names}
    for name, stack, stores, loads, registers in told_of:
        assert (int(stack), int(stores), int(loads)) == (0, 0, 0), name
        assert int(registers) <= REGISTERS.get(name, 64), (name, registers)
