"""The library for C holds its answers against Python's; forged files, bad arguments, threads, and the headers."""

import ctypes
import os
import re
import shlex
import shutil
import struct
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import loewner
from families import random_poses, translation
from loewner import Bodies, Body, CollisionChecker, InputError, Scene, classify, collide, distance, planners
from loewner._native import library
from loewner.bodies import native_files
from loewner.errors import PlanningError
from motion_oracle import AFLOAT, example, ring, steps, written
from native_files import NATIVE, needs_library

pytestmark = needs_library

capi = pytest.importorskip("capi")
INCLUDE = Path(loewner.__file__).parent / "include"
EXAMPLES = Path(__file__).parents[1] / "examples"
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror")


def pose(rng, near=0.3, far=0.8):
    T = random_poses(rng, 1)[0]
    direction = rng.normal(size=3)
    T[:3, 3] = rng.uniform(near, far) * direction / np.linalg.norm(direction)
    return T


@pytest.fixture(scope="module")
def panda():
    return example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")


@pytest.fixture
def pair(panda, tmp_path, rng):
    """A Panda in a scene, as Python's checker and as the library's."""
    checker = CollisionChecker(panda, ring(rng, 8, 0.5, 0.9, 0.2))
    checker.save(tmp_path / "cell.lwn")
    return checker, capi.Checker(tmp_path / "cell.lwn")


def assert_same(checker, mine, Q, *, exactly=True):
    """All queries give what Python gives, to the last bit unless a body is attached."""
    assert mine.pairs() == list(checker.checked_pairs)
    assert np.array_equal(mine.verdicts("classify", Q), checker.classify(Q))
    assert np.array_equal(mine.verdicts("collide", Q) == 1, checker.collide(Q))
    found, slopes = mine.distance(Q)
    wanted = checker.distance(Q, exact=True, gradient=True)
    lower, smooth = mine.clearance(Q)
    values, gradients = checker.clearance(Q, gradient=True)
    for ours, python in ((found["distance"], wanted.distance), (lower, values)):
        assert np.array_equal(ours, python) if exactly else np.abs(ours - python).max() < 1e-9
    assert ((found["lower"] <= wanted.distance) & (wanted.distance <= found["upper"])).all()
    if exactly:  # bounds depend on the frames of bodies; and of several witnesses, rounding chooses one
        assert np.array_equal(found["lower"], wanted.lower)
        for ours, python in ((slopes, wanted.gradient), (found["witness_a"], wanted.witness_a), (smooth, gradients)):
            assert np.array_equal(ours, python)
    half = len(Q) // 2
    a, b = Q[:half], checker.robot.between(Q[:half], Q[half : 2 * half], 0.2)
    verdicts, at, bodies = mine.certify(a, b)
    certified = checker.certify_edges(a, b)
    assert np.array_equal(verdicts, certified.verdict)
    for _ in range(2):  # the second time with the order of pairs that it has learned
        assert np.array_equal(mine.free(a, b), verdicts == 0)
    if exactly:
        assert np.array_equal(at, certified.fraction, equal_nan=True)
        names = [["", ""] if x < 0 else [capi.ask("checker_body_name", mine, int(k)).decode() for k in (x, y)]
                 for x, y in bodies]  # fmt: skip
        assert np.array_equal(names, certified.names)


# -- answers ---------------------------------------------------------------------------------------


def test_an_arm_answers_as_in_python(pair):
    """All queries give the same bits, also of single pairs, and of links that somebody else placed."""
    checker, mine = pair
    Q = checker.robot.random_configurations(1500, seed=1)
    assert_same(checker, mine, Q)
    a, b = Q[:300], Q[:300] + 0.1 * (Q[300:600] - Q[:300])
    found, _, _ = mine.certify(a, b, tolerance=1e-4, joint_error=np.full(mine.dof, 2e-3))
    assert np.array_equal(found, checker.certify_edges(a, b, tolerance=1e-4, joint_error=2e-3).verdict)
    assert np.array_equal(mine.free(a, b, tolerance=1e-4, joint_error=np.full(mine.dof, 2e-3)), found == 0)
    for q in Q[:20]:
        by_pair = mine.collide_by_pair(q)
        assert np.array_equal(by_pair == 1, checker.collide_by_pair(q))
        worst, placed = mine.placed(mine.link_poses(q)[0])
        assert worst == checker.collide(q)
        assert np.array_equal(placed, by_pair)


@pytest.mark.parametrize("count", [2**61, 2**63, 2**64 - 1])
def test_numbers_of_rows_that_wrap_around_are_refused(pair, count):
    """Their sizes in bytes, modulo 2^64, may be small, and the rest of the memory must not be read."""
    _, mine = pair
    rows, out, n = np.zeros((8, mine.dof)), np.zeros(8, dtype=np.int8), capi.size(count)
    for query in ("classify", "collide"):
        with pytest.raises(capi.Error, match=f"configurations: expected at most [0-9]+, found {count}"):
            capi.ask(f"checker_{query}", mine, mine.workspace, rows, n, out)
    with pytest.raises(capi.Error, match="configurations: expected at most"):
        capi.ask("checker_link_poses", mine, rows, n, out)
    with pytest.raises(capi.Error, match="starts: expected at most"):
        capi.ask("checker_certify_edges", mine, mine.workspace, rows, rows, n, None, out, None, None)
    with pytest.raises(capi.Error, match="points: expected at most"):
        capi.ask("checker_certify_curves", mine, mine.workspace, rows, n, ctypes.c_int32(3), None, out, None, None)


def test_motions_one_by_one_between_other_queries(pair):
    """What is learned from motion to motion survives other queries in the same workspace, and changes no answer."""
    checker, mine = pair
    Q = checker.robot.random_configurations(600, seed=5)
    a, b = Q[:300], Q[:300] + 0.15 * (Q[300:] - Q[:300])
    wanted = checker.certify_edges(a, b).verdict == 0
    assert 0.2 < wanted.mean() < 0.9
    for k in range(300):
        assert mine.free(a[k], b[k])[0] == wanted[k]
        if k % 3 == 0:
            mine.verdicts("collide", a[k])
        elif k % 50 == 1:
            mine.certify(a[k], b[k])
            mine.distance(a[k])
    with pytest.raises(capi.Error, match="tolerance"):
        mine.free(a, b, tolerance=-1.0)
    with pytest.raises(capi.Error, match="ends.0.: expected finite"):
        mine.free(a, np.full_like(b, np.nan))
    assert np.array_equal(mine.free(a, b), wanted)


def test_the_longest_motion_that_is_free(pair):
    """Where the last bits decide whether a motion is proven, C and Python have the same verdicts."""
    checker, mine = pair
    Q = checker.robot.random_configurations(4000, seed=6)
    Q = Q[~checker.collide(Q)]
    start, way = Q[:1500], 0.2 * (Q[1500:3000] - Q[:1500])
    blocked = mine.free(start, start + way) == 0
    start, way = start[blocked][:200], way[blocked][:200]
    low, high = np.zeros(len(start)), np.ones(len(start))
    for _ in range(55):
        middle = 0.5 * (low + high)
        free = mine.free(start, start + middle[:, None] * way) == 1
        low, high = np.where(free, middle, low), np.where(free, high, middle)
    assert len(start) > 100
    for share in (low, high):
        ends = start + share[:, None] * way
        verdicts = checker.certify_edges(start, ends).verdict
        assert np.array_equal(mine.certify(start, ends)[0], verdicts)
        assert np.array_equal(mine.free(start, ends), verdicts == 0)


def test_paths_are_those_of_python(pair):
    """Equal seeds give equal paths, rough and shortened."""
    checker, mine = pair
    Q = checker.robot.random_configurations(300, seed=2)
    free = Q[~checker.collide(Q)]
    found = 0
    for seed in range(12):
        start, goals = free[3 * seed], free[3 * seed + 1 : 3 * seed + 3]
        try:
            path = planners.plan(checker, start, goals, seed=seed, max_iterations=500)
        except PlanningError:
            continue
        assert np.array_equal(mine.plan(start, goals, seed=seed), path)
        rough = planners.plan(checker, start, goals, seed=seed, simplify=False)
        assert np.array_equal(mine.plan(start, goals, seed=seed, cuts=-1), rough)
        assert np.array_equal(mine.shorten(rough), planners.shorten(checker, rough))
        found += 1
    assert found >= 6


def test_some_joints_move_and_goals_are_refused(pair):
    """A path moves the named joints only, and a start or goal that cannot be says why."""
    checker, mine = pair
    free = (q for q in checker.robot.random_configurations(300, seed=3) if not checker.collide(q))
    start = next(free)
    goal = start.copy()
    goal[0] = np.clip(start[0] + 0.3, *(x[0] for x in (checker.robot.lower, checker.robot.upper)))
    only = [1, *[0] * (mine.dof - 1)]
    name = checker.robot.configuration_names[0]
    wanted = planners.plan(checker, start, goal, joints=[name])
    assert np.array_equal(mine.plan(start, goal, joints=only), wanted)
    with pytest.raises(capi.Error, match="does not move"):
        mine.plan(start, start + 0.01, joints=only)
    beyond = rf"expected values within the limits, found {name} = .* outside "
    with pytest.raises(capi.Error, match=f"start: {beyond}"):
        mine.plan(start + 100.0, goal)
    with pytest.raises(capi.Error, match=rf"goals\[0\]: {beyond}"):
        mine.plan(start, start + 100.0)
    q = next(q for q in checker.robot.random_configurations(300, seed=3) if checker.collide(q))
    pairs = "|".join(f"{a} and {b}|{b} and {a}" for a, b in ((c.name_a, c.name_b) for c in checker.pairs(q)))
    with pytest.raises(capi.Error, match=f"start: expected a free configuration, found a collision of ({pairs})$"):
        mine.plan(q, start)
    with pytest.raises(capi.Error, match=rf"goals\[1\], no other being free: .*, found a collision of ({pairs})$"):
        mine.plan(start, [start + 100.0, q])


def around(tmp_path, turning, gap):
    """A ball of 5 cm that slides in x, and slides or turns through a slit in a wall; and the same in C."""
    limits = '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    robot = written(tmp_path, (
        f'<robot name="r"><link name="w"/><link name="a"/><link name="b"><collision><origin xyz="{0.4 * turning} 0 0"/>'
        '<geometry><sphere radius="0.05"/></geometry></collision></link>'
        f'<joint name="x" type="prismatic"><parent link="w"/><child link="a"/><axis xyz="1 0 0"/>{limits}'
        f'<joint name="y" type="{"continuous" if turning else "prismatic"}"><parent link="a"/><child link="b"/>'
        + ('<axis xyz="0 0 1"/></joint>' if turning else f'<axis xyz="0 1 0"/>{limits}') + "</robot>"))  # fmt: skip
    scene = Scene()
    for k, side in enumerate((-1, 1)):
        T = np.eye(4)
        T[1, 3] = side * (2.05 + gap) - 0.2
        scene.add(f"wall {k}", Body.box([0.3, 4, 1]), T)
    checker = CollisionChecker(robot, scene)
    checker.save(tmp_path / "cell.lwn")
    return checker, capi.Checker(tmp_path / "cell.lwn")


def test_turned_paths_are_those_of_python(tmp_path):
    """Where trees meet whole turns apart, the path is shifted alike."""
    checker, mine = around(tmp_path, True, 0.2)
    for turns in (-5, -1, 3):
        start, goal = np.array([-0.9, 2.0]), np.array([0.9, 0.5 + 2 * np.pi * turns])
        path = planners.plan(checker, start, goal, seed=turns + 5, simplify=False)
        assert len(path) > 2
        assert np.array_equal(mine.plan(start, goal, seed=turns + 5, cuts=-1), path)


@pytest.mark.verify
def test_trees_grow_as_in_python(tmp_path):
    """Trees that need several times their first memory give the same path."""
    checker, mine = around(tmp_path, False, 5e-4)
    start, goal = np.array([-0.5, 0.3]), np.array([0.5, 0.4])
    path = planners.plan(checker, start, goal, seed=5, simplify=False, timeout=1e3)
    assert np.array_equal(mine.plan(start, goal, seed=5, cuts=-1), path)


def test_curves_are_proven_as_courses(pair):
    """Evenly spread points are the straight motion; FREE curves hold against samples, COLLIDING ones collide."""
    checker, mine = pair
    Q = checker.robot.random_configurations(400, seed=4)
    points = np.stack([Q[:100] + s * (Q[100:200] - Q[:100]) for s in (0.0, 0.05, 0.1)], axis=1)
    straight, _ = mine.certify_curves(points)  # evenly spaced Bezier points: the straight motion
    assert np.array_equal(straight, checker.certify_edges(points[:, 0], points[:, 2]).verdict)
    bent = points + 0.05 * np.array([0.0, 1.0, 0.0])[:, None] * (Q[200:300] - Q[:100])[:, None]
    verdicts, at = mine.certify_curves(bent)
    t = np.linspace(0, 1, 200)[:, None, None]
    curve = (1 - t) ** 2 * bent[:, 0] + 2 * t * (1 - t) * bent[:, 1] + t**2 * bent[:, 2]
    hits = checker.collide(curve)
    assert not hits[:, verdicts == 0].any()
    assert (verdicts == 1).any()
    for k in np.flatnonzero(verdicts == 1):
        s = at[k]
        assert checker.collide((1 - s) ** 2 * bent[k, 0] + 2 * s * (1 - s) * bent[k, 1] + s**2 * bent[k, 2])


def test_every_kind_of_joint(tmp_path, rng):
    """Floating, planar, turning and sliding joints; quaternions of either sign."""
    bodies = {"cart": Body.box([0.3, 0.2, 0.1]), "arm": Body.capsule(0.05, 0.3), "hand": Body.sphere(0.06)}
    robot = replace(written(tmp_path, AFLOAT), bodies=bodies)
    checker = CollisionChecker(robot, ring(rng, 8, 0.3, 0.8, 0.3))
    checker.save(tmp_path / "afloat.lwn")
    mine = capi.Checker(tmp_path / "afloat.lwn")
    Q = robot.random_configurations(600, seed=1)
    assert_same(checker, mine, Q)
    turned = Q.copy()
    for quaternion in robot._quaternions.values():
        turned[:, quaternion] *= rng.choice([-1, 1], (len(Q), 1))
    ends = steps(robot, rng, turned, 0.5)
    found, at, _ = mine.certify(turned, ends)
    wanted = checker.certify_edges(turned, ends)
    assert np.array_equal(found, wanted.verdict)
    assert np.array_equal(at, wanted.fraction, equal_nan=True)
    assert np.array_equal(mine.free(turned, ends), found == 0)
    Q[0, 3] += 0.1
    with pytest.raises(capi.Error, match="quaternions"):
        mine.verdicts("collide", Q[:1])


def test_surfaces_and_clouds(panda, tmp_path, rng):
    """Surfaces are whole for configurations and in parts for motions, also after they moved."""
    import trimesh

    scene = Scene(margin=0.01)
    scene.add("dome", Body.from_surface(trimesh.creation.icosphere(2, 0.15)), pose(rng))
    scene.add("solid", Body.from_surface(trimesh.creation.box([0.2, 0.3, 0.2]), solid=True), pose(rng))
    scene.add("cloud", Body.from_cloud(rng.uniform(-0.2, 0.2, (2000, 3)), radius=0.01), pose(rng))
    scene.add("voxels", Body.from_voxels(rng.random((8, 8, 8)) < 0.05, 0.05), pose(rng))
    checker = CollisionChecker(panda, scene)
    checker.save(tmp_path / "cell.lwn")
    mine = capi.Checker(tmp_path / "cell.lwn")
    Q = panda.random_configurations(300, seed=1)
    assert_same(checker, mine, Q)
    T = pose(rng)
    scene.move("cloud", T)
    mine.move("cloud", T)
    assert_same(checker, mine, Q)


def test_bodies_are_added_attached_and_taken_away(pair, tmp_path, rng):
    """Each change of the scene gives what the same change of Python's scene gives."""
    checker, mine = pair
    scene, Q = checker.scene, checker.robot.random_configurations(200, seed=1)
    mug = Body.union([Body.box([0.1, 0.02, 0.1]), Body.from_points(rng.normal(size=(300, 3)) * 0.05)]
                     + [Body.sphere(0.01).transformed(pose(rng, 0.0, 0.1)) for _ in range(9)])  # fmt: skip
    cloud = Body.from_cloud(rng.uniform(-0.1, 0.1, (500, 3)), radius=0.01)
    Bodies([mug, Body.capsule(0.05, 0.2), cloud]).save(tmp_path / "parts.lwn")
    parts = capi.Bodies(tmp_path / "parts.lwn")
    for number, (name, body) in enumerate([("mug", mug), ("rod", Body.capsule(0.05, 0.2)), ("cloud", cloud)]):
        T = pose(rng)
        scene.add(name, body, T)
        assert mine.add(name, parts, number, T) == mine.body(name)
        assert_same(checker, mine, Q)
    parts.close()  # what was added stays
    for name in ("rod", "b3"):
        T = pose(rng)
        scene.move(name, T)
        mine.move(name, T)
    assert_same(checker, mine, Q)
    H = pose(rng, 0.0, 0.1)
    scene.attach("mug", "panda_hand", H, touch_links=["panda_leftfinger", "panda_rightfinger"])
    mine.attach("mug", "panda_hand", H, ("panda_leftfinger", "panda_rightfinger"))
    assert_same(checker, mine, Q, exactly=False)
    worst, placed = mine.placed(mine.link_poses(Q[0])[0])
    assert worst == checker.collide(Q[0])
    assert np.array_equal(placed, mine.collide_by_pair(Q[0]))
    scene.allow("mug", "b1")
    mine.allow("mug", "b1")
    scene.set_margin(0.03, "rod", "panda_link6")
    mine.set_margin("rod", "panda_link6", 0.03)
    scene.remove("b2")
    mine.set_present("b2", False)
    assert_same(checker, mine, Q, exactly=False)
    T = pose(rng)
    scene.detach("mug", T)
    mine.detach("mug", T)
    assert_same(checker, mine, Q)
    with pytest.raises(capi.Error, match="which there is already"):
        mine.add("mug", capi.Bodies(tmp_path / "parts.lwn"), 0, T)
    with pytest.raises(capi.Error, match="belongs to the robot"):
        mine.attach("panda_link3", "panda_hand", T)


def test_bodies_known_by_bounds_are_proven_as_in_python(pair, rng):
    """Growth in time, constant errors, joint errors and moved bodies; what C does not know of bounds, it refuses."""
    checker, mine = pair
    scene, names = checker.scene, [name for name in checker.scene if name.startswith("b")][:4]
    a = checker.robot.random_configurations(150, seed=3)
    b = a + rng.normal(size=a.shape) * 0.1
    t0 = rng.uniform(-0.5, 0.5, len(a))
    t1 = t0 + rng.uniform(0.0, 0.5, len(a))
    free = 0
    for speed, since in ((0.05, -1.0), (0.4, -0.5), (1.6, -0.51)):
        for name in names:
            T = scene.pose(name) if name in scene.static_names else scene.following[name].poses(0.0)
            T[:3, 3] += rng.normal(size=3) * 0.05
            capi.ask("checker_move", mine, np.array([mine.body(name)], dtype=np.int32), T, capi.size(1))
            mine.set_bounds(name, metres=0.02, radians=0.0, speed=speed, turn=0.0, since=since)
            scene.follow(name, [since], T, speed=speed, error=(0.02, 0.0))
        for error in (None, np.full(checker.robot.dof, 1e-3)):
            found, at, bodies = mine.certify(a, b, joint_error=error, times=(t0, t1))
            wanted = checker.certify_edges(a, b, t0=t0, t1=t1, joint_error=0.0 if error is None else error)
            np.testing.assert_array_equal(found, wanted.verdict)
            np.testing.assert_allclose(at, wanted.fraction, atol=1e-9)
            assert ((bodies >= 0).all(axis=1) == (found != 0)).all()
            free += int((found == 0).sum())
    assert 100 < free < 800
    with pytest.raises(capi.Error, match="expected times, since bounds on b"):
        mine.certify(a, b)
    with pytest.raises(capi.Error, match="t0 <= t1, found"):
        mine.certify(a, b, times=(t1 + 1.0, t0))
    with pytest.raises(capi.Error, match="known by bounds only"):
        mine.verdicts("collide", a)
    with pytest.raises(capi.Error, match="known by bounds only"):
        mine.free(a, b)
    for wrong in ({"speed": -1.0}, {"metres": np.nan}, {"turn": np.inf}, {"since": np.nan}):
        with pytest.raises(capi.Error, match="bounds: expected numbers >= 0"):
            mine.set_bounds(names[0], **wrong)
    with pytest.raises(capi.Error, match="on a link"):
        mine.set_bounds("panda_hand", speed=1.0)
    for name in names:
        mine.set_bounds(name)
        scene.detach(name, scene.following[name].poses(0.0))
    np.testing.assert_array_equal(mine.certify(a, b)[0], checker.certify_edges(a, b).verdict)
    np.testing.assert_array_equal(mine.verdicts("collide", a) == 1, checker.collide(a))


def test_a_piece_behind_a_surface_is_no_surface(pair, tmp_path, rng):
    """Of a solid and a box, the box has no parts, wherever it comes to lie: classify once said FREE of it."""
    import trimesh

    checker, mine = pair
    both = Body.union([Body.from_surface(trimesh.creation.icosphere(1, 0.1), solid=True), Body.box([0.1, 0.6, 0.05])])
    both.save(tmp_path / "both.lwn")
    parts = capi.Bodies(tmp_path / "both.lwn")
    Q = checker.robot.random_configurations(400, seed=1)
    for name in ("one", "two", "three"):
        T = pose(rng)
        checker.scene.add(name, both, T)
        mine.add(name, parts, 0, T)
        assert_same(checker, mine, Q)
        certified = checker.classify(Q)
        assert not (checker.collide(Q) & (certified == 0)).any()


def test_placed_links_carry_attached_bodies(panda, tmp_path, rng):
    """An attached body follows the pose that its link is given, also on a link that is fixed to the world."""
    checker = CollisionChecker(panda, ring(rng, 8, 0.4, 0.8, 0.2))
    checker.save(tmp_path / "cell.lwn")
    mine, base = capi.Checker(tmp_path / "cell.lwn"), pose(rng, 0.1, 0.2)
    moved = CollisionChecker(panda.placed(base), checker.scene)
    for body, link in (("b1", "panda_hand"), ("b3", "panda_link0"), ("b5", "panda_link8")):
        H = pose(rng, 0.1, 0.3)
        checker.scene.attach(body, link, H)
        mine.attach(body, link, H)
        for q in panda.random_configurations(40, seed=2):
            worst, _ = mine.placed(base @ mine.link_poses(q)[0])
            assert worst == moved.collide(q)


def test_touch_links_exempt_the_link_itself(panda, tmp_path, rng):
    """Not what else is attached to it, in Python or here."""
    scene = Scene()
    scene.add("can", Body.cylinder(0.04, 0.2), pose(rng))
    scene.add("mug", Body.box([0.3, 0.3, 0.3]), pose(rng))
    scene.attach("can", "panda_hand", np.eye(4), touch_links=["panda_hand"])
    checker = CollisionChecker(panda, scene)
    checker.save(tmp_path / "cell.lwn")
    mine, H = capi.Checker(tmp_path / "cell.lwn"), pose(rng, 0.2, 0.3)
    scene.attach("mug", "panda_link5", H, touch_links=["panda_hand"])
    mine.attach("mug", "panda_link5", H, ("panda_hand",))
    assert_same(checker, mine, panda.random_configurations(100, seed=3), exactly=False)
    with pytest.raises(capi.Error, match="belongs to the robot"):
        mine.attach("can", "panda_link5", H)


def test_an_allowed_pair_is_checked_again(pair):
    """Where it was checked when the file was saved; other pairs have no margin here, and are refused."""
    checker, mine = pair
    Q = checker.robot.random_configurations(200, seed=4)
    mine.allow("b1", "panda_link5")
    mine.allow("b1", "panda_link5", False)
    assert_same(checker, mine, Q)
    with pytest.raises(capi.Error, match="was checked when"):
        mine.allow("panda_link5", "panda_link6", False)


def test_pairs_of_bodies(tmp_path, rng):
    """Queries without a robot: one body or all of a file, margins, and what is refused."""
    shapes = [Body.box([0.3, 0.2, 0.1]), Body.capsule(0.1, 0.3), Body.from_points(rng.normal(size=(20, 3)) * 0.1),
              Body.union([Body.sphere(0.1), Body.cone(0.1, 0.2)]), Body.cylinder(0.1, 0.2)]  # fmt: skip
    bodies = Bodies(shapes)
    bodies.save(tmp_path / "bodies.lwn")
    mine, workspace = capi.Bodies(tmp_path / "bodies.lwn"), capi.Workspace()
    n = 300
    T, S = random_poses(rng, n), random_poses(rng, n)
    T[:, :3, 3] *= 0.1
    S[:, :3, 3] *= 0.1
    for i, j in ((0, 1), (2, 3), (3, 4)):
        out = np.full(n, 9, dtype=np.int8)
        for query, python in (("classify", classify), ("collide", collide)):
            for margin in (0.0, 0.02):
                capi.pair_query(query, workspace, (mine, i, T), (mine, j, S), n, ctypes.c_double(margin), out)
                assert np.array_equal(out, python(shapes[i], T, shapes[j], S, margin=margin))
        found = np.zeros(n, dtype=capi.DISTANCE)
        capi.pair_query("measure", workspace, (mine, i, T), (mine, j, S), n, found)
        wanted = distance(shapes[i], T, shapes[j], S, exact=True)
        assert np.array_equal(found["distance"], wanted.distance)
        assert np.array_equal(found["witness_b"], wanted.witness_b)
    out = np.full(len(shapes), 9, dtype=np.int8)
    capi.pair_query("collide", workspace, (mine, -1, T[:5]), (mine, 2, None), 5, ctypes.c_double(0.0), out)
    assert np.array_equal(out, collide(bodies, T[:5], shapes[2], None))
    with pytest.raises(capi.Error, match="rigid"):
        capi.pair_query(
            "collide", workspace, (mine, 0, 2 * T), (mine, 1, S), n, ctypes.c_double(0.0), np.empty(n, np.int8)
        )
    with pytest.raises(capi.Error, match="below number"):
        capi.pair_query("collide", workspace, (mine, 5, T), (mine, 1, S), n, ctypes.c_double(0.0), np.empty(n, np.int8))


# -- files -----------------------------------------------------------------------------------------


def sealed(content: bytes) -> bytes:
    """The file with the checksum of what it contains."""
    made = bytearray(content)
    struct.pack_into("<Q", made, 24, native_files.checksum(bytes(made[32:])))
    return bytes(made)


def refused(path: Path, content: bytes) -> str:
    path.write_bytes(content)
    with pytest.raises(capi.Error) as raised:
        capi.Checker(path)
    assert raised.value.status in (2, 3)
    return str(raised.value)


@pytest.fixture(scope="module")
def forged(panda, tmp_path_factory):
    """A file with one body of every kind, and the places of its arrays."""
    import trimesh

    rng = np.random.default_rng(0)
    scene = Scene()
    scene.add("solid", Body.from_surface(trimesh.creation.icosphere(1, 0.1), solid=True), pose(rng))
    scene.add("cloud", Body.from_cloud(rng.uniform(-0.2, 0.2, (40, 3)), radius=0.01), pose(rng))
    scene.add("pieces", Body.from_voxels(rng.random((4, 4, 4)) < 0.3, 0.05), pose(rng))
    scene.add("large", Body.from_points(rng.normal(size=(400, 3)) / 10), pose(rng))
    path = tmp_path_factory.mktemp("forged") / "cell.lwn"
    CollisionChecker(panda, scene).save(path)
    content = path.read_bytes()
    count = struct.unpack_from("<q", content, 96)[0]
    rows = np.frombuffer(content, np.int64, 4 * count, native_files.HEADER.size).reshape(-1, 4)
    return content, rows


def test_a_file_is_whole_and_of_this_version(forged, tmp_path):
    """A file that was cut, altered or written by another version is refused with the reason."""
    content, _ = forged
    path = tmp_path / "cell.lwn"
    assert sealed(content) == content
    assert "damaged" in refused(path, content[:-64])
    assert "another" in refused(path, b"")
    assert "another" in refused(path, b"x" * 4096)
    assert "save it again" in refused(path, sealed(content[:8] + b"\x02" + content[9:]))
    assert "save it again" in refused(path, sealed(content[:32] + b"0" * 64 + content[96:]))
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    assert "checksum" in refused(path, bytes(flipped))
    with pytest.raises(capi.Error, match="could not be opened"):
        capi.Checker(tmp_path / "nothing.lwn")
    with pytest.raises(capi.Error, match="regular file"):
        capi.Checker(tmp_path)


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.verify)])
def test_forged_files_are_refused(forged, tmp_path, count):
    """Each has one size, place or index that cannot be, and the right checksum."""
    content, rows = forged
    rng = np.random.default_rng(1)
    path = tmp_path / "cell.lwn"
    names = [*native_files.BEFORE, *3 * [f"pack {k}" for k in range(12)]]
    indices = [names.index(name) for name in ("parent", "kind", "column", "link", "pairs", "order", "quaternions")]
    indices = [k for k in indices if rows[k, 1] > 0]
    # Of packs: layout, piece_start, children, roots, part_start; of surfaces: children.
    packs = range(len(native_files.BEFORE), len(native_files.BEFORE) + 36, 12)
    indices += [first + k for first in packs for k in (1, 3, 7, 8, 11) if rows[first + k, 1] > 0]
    indices += range(len(native_files.BEFORE) + 37, len(rows), 5)
    refusals = 0
    for number in range(count):
        made = bytearray(content)
        wrong = int(rng.choice([-(2**62), 2**20, 2**40, 2**62]))
        if number % 4 == 0:  # the header's counts, or the directory
            at = (
                96 + 8 * int(rng.integers(7))
                if number % 8
                else native_files.HEADER.size + 8 * int(rng.integers(rows.size))
            )
            if struct.unpack_from("<q", made, at)[0] == wrong:
                continue
        else:
            kind, length, width, start = rows[rng.choice(indices)]
            assert kind == 0
            at = int(start + 8 * rng.integers(length * width))
        struct.pack_into("<q", made, at, wrong)
        refused(path, sealed(made))
        refusals += 1
    assert refusals > 0.99 * count - 1


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.verify)])
def test_files_with_any_changed_word_are_harmless(forged, tmp_path, count):
    """A changed coordinate makes another file, which is opened or not; in a process of its own, which must live."""
    content, _ = forged
    (tmp_path / "cell.lwn").write_bytes(content)
    program = Path(__file__).with_name("capi_forgeries.py")
    done = subprocess.run(
        [sys.executable, str(program), str(tmp_path / "cell.lwn"), str(count)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]


class BrokenPath:
    """A path that raises an error of its own whatever it is asked for."""

    def __fspath__(self):
        raise RuntimeError("not today")

    __str__ = __repr__ = __fspath__


def test_what_cannot_be_saved(panda, tmp_path):
    """Another suffix, bodies that follow motions, and errors of poses, which a program would not know of."""
    checker = CollisionChecker(panda)
    with pytest.raises(InputError, match="ends in .lwn"):
        checker.save(tmp_path / "cell.npz")
    for path in (BrokenPath(), 3):
        with pytest.raises(InputError, match="expected a path"):
            Body.sphere(1.0).save(path)
        with pytest.raises(InputError, match="expected the path"):
            checker.save(path)
    checker.scene.add("box", Body.box([0.1, 0.1, 0.1]))
    checker.scene.follow("box", [0.0, 1.0], random_poses(np.random.default_rng(0), 2))
    with pytest.raises(InputError, match="follow motions"):
        checker.save(tmp_path / "cell.lwn")
    for change in (
        lambda scene: scene.move("box", np.eye(4), error=(0.1, 0.0)),
        lambda scene: scene.follow("box", [0.0], [np.eye(4)], speed=1.6),
    ):
        checker = CollisionChecker(panda, Scene())
        checker.scene.add("box", Body.box([0.1, 0.1, 0.1]))
        change(checker.scene)
        with pytest.raises(InputError, match=r"exact poses, found bounds on the pose of 'box'.*set_bounds"):
            checker.save(tmp_path / "cell.lwn")
    checker.scene.remove("box")
    checker.save(tmp_path / "cell.lwn")


# -- arguments and threads -------------------------------------------------------------------------


def test_bad_arguments_are_refused(pair):
    """Numbers that are not finite, poses that are not rigid, unknown bodies and NULL are errors, and do no harm."""
    checker, mine = pair
    Q = checker.robot.random_configurations(3, seed=1)
    for value in (np.nan, np.inf, -1e300):
        bad = Q.copy()
        bad[1, 2] = value
        for query in (lambda bad=bad: mine.verdicts("collide", bad), lambda bad=bad: mine.certify(bad, Q),
                      lambda bad=bad: mine.certify(Q, bad), lambda bad=bad: mine.distance(bad),
                      lambda bad=bad: mine.clearance(bad), lambda bad=bad: mine.plan(bad[1], Q),
                      lambda bad=bad: mine.plan(Q[0], bad), lambda bad=bad: mine.link_poses(bad)):  # fmt: skip
            with pytest.raises(capi.Error, match="finite"):
                query()
    with pytest.raises(capi.Error, match="rigid"):
        mine.move("b1", np.ones((4, 4)))
    with pytest.raises(capi.Error, match="on a link"):
        mine.move("panda_link3", np.eye(4))
    with pytest.raises(capi.Error, match="softness"):
        mine.clearance(Q, softness=0.0)
    with pytest.raises(capi.Error, match="tolerance"):
        mine.certify(Q, Q, tolerance=-1.0)
    with pytest.raises(capi.Error, match="margin"):
        mine.set_margin("b1", "panda_link3", -1.0)
    with pytest.raises(capi.Error, match="below"):
        mine.set_present("nothing", True)
    null = ctypes.c_void_p()
    assert capi.functions().loewner_checker_collide(null, null, null, capi.size(1), null) == 1
    assert capi.functions().loewner_checker_collide(mine._as_parameter_, null, null, capi.size(1), null) == 1
    assert capi.functions().loewner_checker_open(null, null) == 1
    for leave in ("checker_close", "bodies_close", "workspace_free"):
        getattr(capi.functions(), f"loewner_{leave}")(null)
    assert_same(checker, mine, checker.robot.random_configurations(60, seed=5))


def test_threads_with_workspaces_of_their_own(pair):
    """Eight threads get the same answers; the first one takes a change over."""
    checker, mine = pair
    Q = checker.robot.random_configurations(2000, seed=1)
    wanted, faults = checker.collide(Q), []

    def ask(number):
        workspace, out = capi.Workspace(), np.empty(len(Q), dtype=np.int8)
        for _ in range(5):
            capi.ask("checker_collide", mine, workspace, Q, capi.size(len(Q)), out)
            if not np.array_equal(out == 1, wanted):
                faults.append(number)

    mine.move("b1", checker.scene.pose("b1"))  # the first one to ask takes the change over
    threads = [threading.Thread(target=ask, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults


# -- headers ---------------------------------------------------------------------------------------


def expect_programs(*names):
    """Skip the test where one is missing."""
    for name in names:
        if shutil.which(name) is None:
            pytest.skip(f"no {name} here")


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_headers_compile_without_a_warning(compiler, tmp_path):
    """C11 and C++17, with all warnings as errors."""
    for_cpp = {"gcc": "g++", "clang": "clang++"}[compiler]
    expect_programs(compiler, for_cpp)
    for suffix, header, standards in (("c", "loewner.h", ("c11",)), ("cpp", "loewner.hpp", ("c++17",))):
        source = tmp_path / f"one.{suffix}"
        source.write_text(f"#include <{header}>\n#include <{header}>\nint main(void) {{ return 0; }}\n")
        for standard in standards:
            program = compiler if suffix == "c" else for_cpp
            command = [program, f"-std={standard}", *STRICT, f"-I{INCLUDE}", "-fsyntax-only", str(source)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr


def test_every_function_is_exported_and_nothing_else():
    """The symbols of the library are the functions of the header."""
    expect_programs("nm")
    listed = subprocess.run(
        ["nm", "-D", "--defined-only", str(capi.LIBRARY)], capture_output=True, text=True, check=True
    )
    exported = {line.split()[-1] for line in listed.stdout.splitlines()}
    text = capi.HEADER.read_text(encoding="utf-8")
    assert {name for name in exported if not name.startswith("_")} == set(re.findall(r"\b(loewner_\w+)\(", text))


def compiled(name, to):
    """Compile an example with all warnings as errors."""
    compiler, standard = ("cc", "-std=c11") if name.endswith(".c") else ("c++", "-std=c++17")
    source, told = (
        EXAMPLES / name,
        [f"-I{INCLUDE}", f"-L{library.HOME}", "-lloewner", "-Xlinker", "-rpath", "-Xlinker", str(library.HOME)],
    )
    subprocess.run([compiler, standard, *STRICT, str(source), *told, "-o", str(to)], check=True)


def test_a_part_is_grasped(panda, tmp_path, rng):
    """The example adds a part, plans with the part in the hand, and puts it down."""
    expect_programs("c++")
    scene = Scene()
    scene.add("far", Body.box([0.1, 0.1, 0.1]), pose(rng, 3.0, 4.0))
    CollisionChecker(panda, scene).save(tmp_path / "cell.lwn")
    Body.box([0.04, 0.04, 0.1]).save(tmp_path / "parts.lwn")
    compiled("grasp.cpp", tmp_path / "grasp")
    command = [str(tmp_path / "grasp"), str(tmp_path / "cell.lwn"), str(tmp_path / "parts.lwn")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("carried along"), done.stderr


def test_a_gate_brakes_in_front_of_a_box(panda, tmp_path):
    """The example lets targets through and brakes before the arm meets the box, at rest and without a collision."""
    expect_programs("c++")
    scene = Scene(margin=0.005)
    scene.add("box", Body.box([0.15, 0.15, 0.15]), translation(0.5, 0.0, 0.2))
    CollisionChecker(panda, scene).save(tmp_path / "cell.lwn")
    compiled("gate.cpp", tmp_path / "gate")
    done = subprocess.run([str(tmp_path / "gate"), str(tmp_path / "cell.lwn")], capture_output=True, text=True)
    told = re.fullmatch(r"(\d+) targets passed, then the robot braked \(contact, panda_\w+, box\) .*\n", done.stdout)
    assert told, (done.stdout, done.stderr)
    assert int(told[1]) > 50


def test_a_workspace_serves_one_thread(pair):
    """A second thread is refused while the first one uses it: both would get wrong answers."""
    checker, mine = pair
    Q = checker.robot.random_configurations(200_000, seed=1)
    told = []

    def ask():
        try:
            mine.verdicts("collide", Q)
        except capi.Error as error:
            told.append(str(error))

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all("another thread uses" in text for text in told)
    assert len(told) < 8
    assert np.array_equal(mine.verdicts("collide", Q[:500]) == 1, checker.collide(Q[:500]))


def test_the_examples_run(pair, tmp_path):
    """The programs compile without a warning, find a path, and say what is wrong."""
    expect_programs("cc", "c++")
    for name in ("query.c", "query.cpp"):
        program = tmp_path / name.replace(".", "_")
        compiled(name, program)
        done = subprocess.run([str(program), str(tmp_path / "cell.lwn")], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "a proven path" in done.stdout
        done = subprocess.run([str(program), "nothing.lwn"], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert "could not be opened" in done.stderr


@pytest.mark.verify
def test_cmake_and_pkg_config_find_it(pair, tmp_path):
    """In the package as it is, and below a prefix where it was installed."""
    expect_programs("cc", "cmake", "pkg-config")
    run = f"import sys; sys.path.insert(0, {str(NATIVE)!r}); import install; from pathlib import Path; "
    run += f"install.install(Path({str(tmp_path / 'prefix')!r}))"
    subprocess.run([sys.executable, "-c", run], check=True)
    example = (Path(__file__).parents[1] / "examples" / "query.c").as_posix()
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.18)\nproject(query C)\nfind_package(loewner 0.1 REQUIRED)\n"
        f'add_executable(query "{example}")\ntarget_link_libraries(query loewner::loewner)\n'
    )
    places = [INCLUDE.parent / "share", tmp_path / "prefix" / "lib"]
    for place, cmake in zip(places, ("cmake", "cmake/loewner"), strict=True):
        build = tmp_path / place.name
        for command in (
            ["cmake", "-S", str(tmp_path), "-B", str(build), f"-Dloewner_DIR={place / cmake}"],
            ["cmake", "--build", str(build)],
            [str(build / "query"), str(tmp_path / "cell.lwn")],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stdout + done.stderr
        environment = os.environ | {"PKG_CONFIG_PATH": str(place / "pkgconfig")}
        asked = ["pkg-config", "--cflags", "--libs", "loewner"]
        told = subprocess.run(asked, capture_output=True, text=True, check=True, env=environment).stdout
        program = str(build / "with-pkg-config")
        subprocess.run(["cc", example, *shlex.split(told), "-o", program], check=True)
        assert subprocess.run([program, str(tmp_path / "cell.lwn")], check=False).returncode == 0


@pytest.mark.verify
def test_the_documented_build_works_in_any_folder(pair, tmp_path):
    """The page's lines build a program if the names of the environment and of the project are long and contain blanks.

    A terminal of 40 columns does not break the printed folders.
    """
    expect_programs("cc", "cmake", "pkg-config")
    place = tmp_path / f"environment of {'a-long-name-' * 10}" / "site packages"
    place.mkdir(parents=True)
    (place / "loewner").symlink_to(Path(loewner.__file__).parent, target_is_directory=True)
    command = tmp_path / "bin" / "loewner"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m loewner "$@"\n')
    command.chmod(0o755)
    project = tmp_path / "a project"
    project.mkdir()
    shutil.copy(EXAMPLES / "query.c", project)
    page = Path(__file__).parents[1] / "docs" / "howto" / "cpp.md"
    lines = re.search(r"\n((?: {4}.*\n)+)", page.read_text(encoding="utf-8").split("## Build a program")[1])[1]
    assert all(word in lines for word in ("--include", "--cmake-dir", "--pkg-config-dir"))
    four = re.search(r"```cmake\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)[1]
    (project / "CMakeLists.txt").write_text(four.replace("CXX", "C").replace("query.cpp", "query.c"))
    script = f"set -e\n{lines}\ncmake --build build\n"
    script += 'for program in ./query build/query; do "$program" ../cell.lwn; done\n'
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(place), os.environ.get("PYTHONPATH", "")]),
        "PATH": os.pathsep.join([str(command.parent), os.environ["PATH"]]),
        "COLUMNS": "40",
    }
    done = subprocess.run(
        ["sh", "-c", script], cwd=project, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith(f"{place / 'loewner' / 'include'}\n")
    assert done.stdout.count("a proven path") == 2


def test_the_files_name_one_version():
    """CMake, pkg-config and the package agree."""
    version = loewner.__version__
    share = INCLUDE.parent / "share"
    assert f'set(PACKAGE_VERSION "{version}")' in (share / "cmake" / "loewner-config-version.cmake").read_text()
    assert f"Version: {version}\n" in (share / "pkgconfig" / "loewner.pc").read_text()
    assert f'#define LOEWNER_VERSION "{version}"' in capi.HEADER.read_text()
    assert capi.ask("version").decode() == version


@pytest.mark.filterwarnings("ignore:attach of 'b1'")
def test_margins_and_allowed_pairs_of_static_bodies_travel(panda, tmp_path, rng):
    """They say nothing while the bodies stand, and hold when one is attached or another body is added."""
    scene = ring(rng, 6, 0.3, 0.6, 0.25)
    scene.set_margin(0.04, "b1")
    scene.set_margin(0.03, "panda_hand")
    scene.set_margin(0.06, "b2", "b3")
    scene.set_margin(0.0, "b4", lower=True)
    scene.allow("b1", "b5")
    scene.widen(0.01)
    checker = CollisionChecker(panda, scene)
    checker.save(tmp_path / "cell.lwn")
    Body.box([0.1, 0.1, 0.1]).save(tmp_path / "box.lwn")
    mine, Q = capi.Checker(tmp_path / "cell.lwn"), panda.random_configurations(300, seed=1)
    assert_same(checker, mine, Q)
    T = pose(rng)
    scene.add("box", Body.box([0.1, 0.1, 0.1]), T)
    mine.add("box", capi.Bodies(tmp_path / "box.lwn"), 0, T)
    assert_same(checker, mine, Q)
    for name in ("b1", "b2", "b4"):
        H = pose(rng, 0.1, 0.2)
        scene.attach(name, "panda_hand", H)
        mine.attach(name, "panda_hand", H)
        assert_same(checker, mine, Q, exactly=False)


def test_a_cell_is_of_one_state(panda, tmp_path, monkeypatch):
    """If another thread sets a margin while the file is made, pairs and bodies have it, or neither do."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 1.0, 1.0]), pose(np.random.default_rng(0), 1.0, 1.2))
    checker, calls = CollisionChecker(panda, scene), []
    prepared = checker._ready

    def interrupted(**options):
        ready = prepared(**options)
        if not calls:
            scene.set_margin(0.05, "wall")
        calls.append(ready)
        return ready

    monkeypatch.setattr(checker, "_ready", interrupted)
    checker.save(tmp_path / "cell.lwn")
    content = (tmp_path / "cell.lwn").read_bytes()
    count = struct.unpack_from("<q", content, 96)[0]
    rows = np.frombuffer(content, np.int64, 4 * count, native_files.HEADER.size).reshape(-1, 4)
    largest = []
    for name in ("own", "margins"):
        _, length, _, start = rows[native_files.BEFORE.index(name)]
        largest.append(np.frombuffer(content, float, length, start).max())
    assert largest == [0.05, 0.05]
    assert len(calls) == 2
