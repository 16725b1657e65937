"""A checker whose scene has changed answers as one that is made anew: only what changed is prepared again."""

import gc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from checker_oracle import composed_bodies, pose, random_robot, random_scene, simple_bodies
from loewner import Bodies, Body, CollisionChecker, InputError, PoseError, Scene, UnknownNameError
from loewner._kernels import codes
from loewner.bodies import packed_of
from loewner.bodies.pack import Packed, joined
from loewner.robots.checking import verdicts
from loewner.robots.checking.problem import Problem
from sampling import examples, quick_of

CHANGES = ("move", "move_all", "add", "remove", "replace", "attach", "detach", "allow", "forbid", "margin")


def bodies_of(rng):
    cloud = Body.from_cloud(rng.normal(size=(300, 3)) * 0.1, radius=0.02)
    voxels = Body.from_cloud(rng.normal(size=(200, 3)) * 0.1, voxel=0.05)
    return [*simple_bodies(rng), *composed_bodies(rng), cloud, voxels]


def change(rng, kind, scene, robot, bodies, number):
    """One change of a scene, if there is something to change in this way."""
    body, links = bodies[rng.integers(len(bodies))], robot.link_names
    still, held, allowed = scene.static_names, tuple(scene.attachments), sorted(scene.allowed)
    name = str(rng.choice(scene.names)) if len(scene) else ""
    if kind == "add":
        scene.add(f"new {number}", body, pose(rng, 0.6))
    elif kind == "move_all" and still:
        some = [name for name in still if rng.random() < 0.5]
        scene.move_all(some, np.array([pose(rng, 0.6) for _ in some]).reshape(-1, 4, 4))
    elif kind == "move" and still:
        scene.move(str(rng.choice(still)), pose(rng, 0.6))
    elif kind == "remove" and name:
        scene.remove(name)
    elif kind == "replace" and name:
        scene.replace(name, body)
    elif kind == "attach" and name:
        scene.attach(name, str(rng.choice(links)), pose(rng, 0.2), touch_links=links[:1])
    elif kind == "detach" and held:
        scene.detach(str(rng.choice(held)), pose(rng, 0.6))
    elif kind == "allow" and name:
        scene.allow(name, str(rng.choice(links)))
    elif kind == "forbid" and allowed:
        scene.forbid(*allowed[0])
    elif kind == "margin" and name:
        scene.set_margin(float(rng.choice([0.0, 0.01, 0.05])), name, lower=bool(rng.random() < 0.5))


@pytest.fixture(scope="module")
def pool():
    return bodies_of(np.random.default_rng(0))


@pytest.mark.filterwarnings("ignore:attach of")
@pytest.mark.parametrize("seed", quick_of(range(6), range(3)))
def test_a_patched_checker_answers_as_one_made_anew(seed, pool, tmp_path):
    """After each of twenty changes in a row: verdicts, proofs with their work, and distances, bit for bit."""
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, tmp_path, 5, pool[:9])
    scene = random_scene(rng, robot, 4, pool)
    checker = CollisionChecker(robot, scene)
    Q = robot.random_configurations(40, seed)
    start, end = Q[:8], robot.between(Q[:8], Q[8:16], 0.2)
    for number in range(20):
        kind = str(rng.choice(CHANGES))
        change(rng, kind, scene, robot, pool, number)
        if number % 3 == 1:
            continue  # several changes at once
        fresh = CollisionChecker(robot, scene)
        assert checker.checked_pairs == fresh.checked_pairs
        np.testing.assert_array_equal(checker.collide(Q), fresh.collide(Q))
        np.testing.assert_array_equal(checker.classify(Q), fresh.classify(Q))
        one, other = checker.certify_edges(start, end), fresh.certify_edges(start, end)
        for name in ("verdict", "fraction", "names", "poses", "searches"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        if checker.checked_pairs:
            one, other = checker.distance(Q[:4], exact=True), fresh.distance(Q[:4], exact=True)
            np.testing.assert_array_equal(one.distance, other.distance)
            np.testing.assert_array_equal(checker.clearance(Q[:4]), fresh.clearance(Q[:4]))


@given(st.integers(0, 2**32 - 1))
@examples(4, 20)
def test_packs_that_are_joined_are_as_made_anew(seed):
    """Joined arrays for kernels equal those made of all pieces, up to the tables of addresses and unused children."""
    rng = np.random.default_rng(seed)
    pool = bodies_of(rng)
    chosen = [packed_of(pool[k]) for k in rng.integers(len(pool), size=rng.integers(1, 6))]
    pack = packed_of(Bodies([pool[0], *(pool[k] for k in rng.integers(len(pool), size=4))]))
    for parts in (chosen, [pack, *chosen]):
        quick = packed_of(Bodies([Body(part) for part in chosen])) if parts is chosen else None
        made = Packed.of(*(lambda all: (all, all.maps, all.trees))(joined(parts)))
        kernel = quick.kernel if quick else made.kernel
        for name in ("layout", "points", "piece_start", "roots", "vertices", "part_start", "groups"):
            np.testing.assert_array_equal(getattr(kernel, name), getattr(made.kernel, name), err_msg=name)
        for name in ("table", "hot", "single", "parts"):
            np.testing.assert_allclose(getattr(kernel, name), getattr(made.kernel, name), rtol=1e-12, atol=1e-300)


def test_what_did_not_change_is_kept(pool, tmp_path):
    """Robots are not joined again when a body is replaced, nor bodies when one moves, nor attached ones transformed."""
    rng = np.random.default_rng(1)
    robot = random_robot(rng, tmp_path, 5, pool[:9])
    scene = Scene()
    for k in range(3):
        scene.add(f"b{k}", pool[k], pose(rng, 0.6))
    scene.attach("b0", robot.link_names[-1])
    checker = CollisionChecker(robot, scene)
    before: Problem = checker._ready()
    scene.move("b1", pose(rng, 0.6))
    moved = checker._ready()
    assert moved.packed is before.packed
    scene.replace("b2", pool[5])
    replaced = checker._ready()
    assert replaced.moving is before.moving
    assert replaced.packed is not before.packed
    still = np.flatnonzero((replaced.standing.poses == before.standing.poses).all(axis=1))
    assert len(still) == 1
    np.testing.assert_array_equal(moved.standing.bounds[still], before.standing.bounds[still])


def test_an_earlier_state_stays_as_it_was(pool, tmp_path):
    """Its arrays and its answers, which other threads may be using; its queries keep the memory that they need."""
    rng = np.random.default_rng(2)
    robot = random_robot(rng, tmp_path, 5, pool[:9])
    scene = Scene()
    for k in range(6):
        scene.add(f"b{k}", pool[k], pose(rng, 0.6))
    checker, Q = CollisionChecker(robot, scene), robot.random_configurations(60, 0)
    before, expected = checker._ready(), checker.collide(Q)
    single, arrays = before.single, [array.copy() for array in before.standing]
    for _ in range(5):
        scene.move_all(scene.names, np.array([pose(rng, 0.6) for _ in scene.names]))
        checker.collide(Q[0])
    assert all(map(np.array_equal, before.standing, arrays))
    assert verdicts.collisions(verdicts.classified(before, codes.EXACT, Q).verdicts, Q).tolist() == expected.tolist()
    del before
    gc.collect()
    assert all(single.collide(q) in (None, collides) for q, collides in zip(Q, expected.tolist(), strict=True))


def test_bodies_move_together_or_not_at_all():
    """A wrong name or pose moves no body; each name occurs once."""
    scene = Scene()
    for name in "abc":
        scene.add(name, Body.sphere(0.1))
    scene.attach("c", "hand")
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, 0, 3] = 1.0
    bad = T.copy()
    bad[1, 0, 0] = 2.0
    for names, Ts, error in (
        (["a", "b"], bad, PoseError), (["a", "c"], T, InputError), (["a", "x"], T, UnknownNameError),
        (["a", "a"], T, InputError), (["a"], T, InputError), ("ab", T, InputError), (["a", 3], T, UnknownNameError),
    ):  # fmt: skip
        with pytest.raises(error):
            scene.move_all(names, Ts)
        assert scene.pose("a")[0, 3] == scene.pose("b")[0, 3] == 0.0
    version, structure = scene.version, scene.structure_version
    scene.move_all(["a", "b"], T)
    T[:] = 0.0  # the scene has its own
    assert scene.pose("a")[0, 3] == scene.pose("b")[0, 3] == 1.0
    assert scene.version > version
    assert scene.structure_version == structure
    scene.move_all([], np.zeros((0, 4, 4)))
