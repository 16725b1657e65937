"""Checkers of configurations: what the queries say pair by pair, for any robot, scene and batch."""

import copy
import gc
import math
import pickle
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import loewner
from checker_oracle import (
    TOUCHING,
    agrees,
    cluster,
    composed_bodies,
    expected_pairs,
    pairwise,
    pose,
    random_robot,
    random_scene,
    robot_of,
    simple_bodies,
)  # fmt: skip
from families import translation
from gantry import gantry_robot
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    LoewnerError,
    Robot,
    Scene,
    UnknownNameError,
    Verdict,
    pairs_by_sampling,
)
from loewner.queries import pairs as queries
from loewner.robots.checker import prepared_of
from loewner.robots.checking import distances, edges
from loewner.robots.checking.verdicts import lengths
from sampling import quick_of

SLIDE = '<axis xyz="1 0 0"/><limit lower="-1" upper="1"/>'

# About a robot on slides of a metre, deliberately far outside.
far_outside = pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")


@pytest.fixture(scope="module")
def bodies():
    rng = np.random.default_rng(1)
    return simple_bodies(rng), composed_bodies(rng)


def slider(folder, body=None):
    """A box that slides along x."""
    return robot_of(folder, [("prismatic", 0, SLIDE)], {"l1": body or Body.box([1.0, 1.0, 1.0])})


def arm(folder, bodies, seed=0, links=5):
    return random_robot(np.random.default_rng(seed), folder, links, bodies)


# -- the answers --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", quick_of(range(25), range(5)))
def test_a_checker_says_what_the_queries_say_pair_by_pair(seed, bodies, tmp_path):
    """Any kinds of joints, bodies and margins; before and after bodies move, come, are grasped, put down and go."""
    rng = np.random.default_rng(seed)
    pool = bodies[0] if seed % 2 else [*bodies[0], *bodies[1]]
    robot = random_robot(rng, tmp_path, int(rng.integers(2, 7)), pool)
    scene = random_scene(rng, robot, int(rng.choice([0, 1, 4, 9])), pool)
    checker = CollisionChecker(robot, scene, skip_adjacent=bool(seed % 3))
    skipped = robot.adjacent_pairs if seed % 3 else frozenset()
    Q = robot.random_configurations(70, seed)
    assert {frozenset(pair) for pair in checker.checked_pairs} == expected_pairs(robot, scene, skipped)
    agrees(checker, Q)
    for name in scene.static_names:
        scene.move(name, pose(rng, 0.6))
    agrees(checker, Q)
    scene.add("new", pool[seed % len(pool)], pose(rng, 0.4))
    scene.attach("new", robot.link_names[-1], pose(rng, 0.2))
    assert {frozenset(pair) for pair in checker.checked_pairs} == expected_pairs(robot, scene, skipped)
    agrees(checker, Q)
    scene.detach("new", pose(rng, 0.4))
    agrees(checker, Q)
    scene.remove("new")
    agrees(checker, Q)


@far_outside
@pytest.mark.parametrize("far", [0.0, 1e4, 1e6])
def test_bodies_of_many_pieces_far_away(far, tmp_path):
    """Far away single precision settles next to nothing, so that thousands of piece pairs wait for the double one."""
    rng = np.random.default_rng(5)
    body = cluster(rng, 100)
    robot = robot_of(tmp_path, [("floating", 0, "")], {"l1": body})
    scene, center = Scene(), np.array([2.0, -0.5, 0.9]) * far
    scene.add("c", body, translation(*center))
    apart = rng.normal(size=(200, 3))
    apart *= (rng.uniform(0.3, 0.6, 200) / np.linalg.norm(apart, axis=1))[:, None]
    Q = np.concatenate([center + apart, Rotation.random(200, random_state=2).as_quat()], axis=1)
    assert 0.1 < agrees(CollisionChecker(robot, scene), Q).mean() < 0.9


@pytest.mark.parametrize("size", [1e-5, 2e3])
def test_tiny_and_huge_bodies_beside_ordinary_ones(size, bodies, tmp_path):
    """Sizes that single precision is not used for."""
    rng = np.random.default_rng(3)
    odd = [Body.box([size, size, 0.1]), Body.sphere(size), Body.from_points(rng.normal(size=(12, 3)) * size)]
    robot = arm(tmp_path, [*odd, *bodies[0], *bodies[1]], seed=4)
    scene = random_scene(rng, robot, 4, [*odd, *bodies[0]])
    agrees(CollisionChecker(robot, scene), robot.random_configurations(100))


def test_crowd_of_three_hundred_bodies(bodies, tmp_path):
    """Most pairs are far apart."""
    rng = np.random.default_rng(6)
    robot, scene = arm(tmp_path, bodies[0], seed=1), Scene()
    for k in range(300):
        scene.add(f"b{k}", bodies[0][k % len(bodies[0])], pose(rng, 3.0))
    agrees(CollisionChecker(robot, scene), robot.random_configurations(40))


@far_outside
@pytest.mark.parametrize("where", [0.0, 1.0, 1e4])
@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_boxes_face_to_face(where, margin, tmp_path):
    """At all gaps down to rounding: free when clearly apart, colliding when touching or deeper."""
    scene = Scene(margin=margin)
    scene.add("wall", Body.box([1.0, 1.0, 1.0]), translation(where, 0, 0))
    checker = CollisionChecker(slider(tmp_path), scene)
    gaps = np.concatenate([[0.0], *(10.0 ** -np.arange(2, 16.0) * sign for sign in (1, -1))])
    found = checker.collide((where - 1 - margin - gaps)[:, None])
    # A position is off by a rounding of `where`, the search by a few more.
    band = 64 * 2.0**-53 * (where + 4)
    assert found[gaps <= -band].all()
    assert not found[gaps >= band].any()
    assert found[np.abs(gaps) < 1e-18].all() or margin > 0 or where > 1


@far_outside
@pytest.mark.parametrize("value", [1e8, 1e19, 1e30, 1e38, 1e39, 1e100, 1e150])
def test_huge_values(value, bodies, tmp_path):
    """Where single precision overflows, answers are right still, and the same for those beside."""
    joints = [("prismatic", 0, SLIDE), ("planar", 1, ""), ("floating", 1, "")]
    robot = robot_of(tmp_path, joints, {f"l{k}": bodies[k % 2][k] for k in range(4)})
    scene = random_scene(np.random.default_rng(2), robot, 4, bodies[0])
    checker, Q = CollisionChecker(robot, scene, skip_adjacent=False), robot.random_configurations(60)
    plain = checker.collide(Q), checker.classify(Q)
    rng = np.random.default_rng(0)
    big = rng.random(60) < 0.3
    columns = rng.integers(0, 3, 60)  # those of lengths
    Q[big, columns[big]] = value
    agrees(checker, Q)
    np.testing.assert_array_equal(checker.collide(Q)[~big], plain[0][~big])
    np.testing.assert_array_equal(checker.classify(Q)[~big], plain[1][~big])


def test_curved_bodies_at_contact(bodies, tmp_path):
    """Placed at distances down to nothing: free and colliding as the distance says, but for a documented hair."""
    rng = np.random.default_rng(8)
    gaps = np.array([s * 10.0**-k for k in range(2, 17) for s in (1, -1)])
    for a in bodies[0][2:7]:
        for b in bodies[0][:7]:
            T, scene = pose(rng, 1.0), Scene()
            scene.add("b", b, T)
            Ta = np.array([pose(rng, 0.05, T[:3, 3]) for _ in gaps])
            for _ in range(3):
                d = queries.distance(a, Ta, b, T, exact=True)
                Ta[:, :3, 3] += (d.distance - gaps)[:, None] * d.normal
            robot = robot_of(tmp_path, [("floating", 0, "")], {"l1": a})
            turn = Rotation.from_matrix(Ta[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
            Q = np.concatenate([Ta[:, :3, 3], turn], axis=1)
            found = CollisionChecker(robot, scene).collide(Q)
            placed = queries.distance(a, robot.forward_kinematics(Q)[:, 1], b, T, exact=True).distance
            clear = np.abs(placed) > 4 * TOUCHING
            np.testing.assert_array_equal(found[clear], placed[clear] < 0)
            assert clear.sum() > 15


# -- in any company -----------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 63, 64, 65, 1000])
def test_verdicts_do_not_depend_on_company(count, bodies, tmp_path):
    """One by one, in batches of any size and order, and after the order of the pairs was learnt."""
    pool = [*bodies[0], *bodies[1]]
    robot = arm(tmp_path, pool, seed=2)
    scene = random_scene(np.random.default_rng(7), robot, 6, pool)
    Q = robot.random_configurations(1000)
    fresh, learnt = CollisionChecker(robot, scene), CollisionChecker(robot, scene)
    expected = learnt.collide(Q), learnt.classify(Q)
    for _ in range(3):
        learnt.collide(Q)
    order = np.random.default_rng(count).permutation(1000)[:count]
    for checker in (fresh, learnt):
        np.testing.assert_array_equal(checker.collide(Q[order]), expected[0][order])
        np.testing.assert_array_equal(checker.classify(Q[order]), expected[1][order])
        assert checker.tiers(Q[order]).total == count
    for k in order[:20]:
        assert fresh.collide(Q[k]) is bool(expected[0][k])
        assert fresh.classify(Q[k]) is Verdict(int(expected[1][k]))


@pytest.mark.parametrize("query", ["collide", "classify"])
def test_a_configuration_alone_where_the_verdict_changes(query, bodies, tmp_path):
    """One configuration has a kernel of its own; even where the last bits decide, it says what a batch says."""
    pool = [*bodies[0], *bodies[1]]
    robot = arm(tmp_path, pool, seed=4)
    checker = CollisionChecker(robot, random_scene(np.random.default_rng(8), robot, 6, pool))
    ask = getattr(checker, query)
    Q = robot.random_configurations(3000)
    free = np.asarray(ask(Q)) == 0
    count = min(200, free.sum(), (~free).sum())
    a, b = Q[free][:count], Q[~free][:count]
    for _ in range(55):
        middle = 0.5 * (a + b)
        free = (np.asarray(ask(middle)) == 0)[:, None]
        a, b = np.where(free, middle, a), np.where(free, b, middle)
    assert count > 50
    for near in (a, b):
        assert [int(ask(q)) for q in near] == np.asarray(ask(near), dtype=int).tolist()


def test_verdicts_do_not_depend_on_the_number_of_threads(bodies, tmp_path):
    """The same from one and from two."""
    robot = arm(tmp_path, bodies[0], seed=3)
    checker = CollisionChecker(robot, random_scene(np.random.default_rng(1), robot, 5, bodies[0]))
    Q, before, found = robot.random_configurations(3000), loewner.get_num_threads(), []
    try:
        for threads in (1, 2):
            loewner.set_num_threads(threads)
            found.append((checker.collide(Q), checker.classify(Q)))
    finally:
        loewner.set_num_threads(before)
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


def test_several_threads_share_a_checker(bodies, tmp_path):
    """Also while it learns the order of the pairs."""
    robot = arm(tmp_path, bodies[0], seed=3)
    scene = random_scene(np.random.default_rng(1), robot, 5, bodies[0])
    Q = robot.random_configurations(400)
    expected = CollisionChecker(robot, scene).collide(Q)
    shared = CollisionChecker(robot, scene)
    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(lambda _: shared.collide(Q), range(40)):
            np.testing.assert_array_equal(found, expected)


def test_any_array_of_configurations(bodies, tmp_path):
    """Shapes, strides, precision and read-only arrays; lists."""
    robot = arm(tmp_path, bodies[0], seed=3)
    joints = robot.random_configurations(6).astype(np.float32).astype(float)
    checker = CollisionChecker(robot, random_scene(np.random.default_rng(1), robot, 5, bodies[0]))
    expected = checker.collide(joints)
    fixed = joints.copy()
    fixed.setflags(write=False)
    wide = np.zeros((6, 2 * robot.dof))
    wide[:, ::2] = joints
    for Q in (fixed, wide[:, ::2], joints.astype(np.float32), np.asfortranarray(joints), joints.tolist()):
        np.testing.assert_array_equal(checker.collide(Q), expected)
    for query in (checker.collide, checker.classify):
        np.testing.assert_array_equal(query(joints.reshape(2, 3, -1)), query(joints).reshape(2, 3))
    assert checker.distance(joints.reshape(2, 3, -1), exact=True).witness_a.shape == (2, 3, 3)
    assert checker.collide(np.empty((0, 3, robot.dof))).shape == (0, 3)


def test_robots_without_joints_or_bodies(tmp_path):
    """One link, or one with a body; with and without a scene: every query answers."""
    box = Body.box([1.0, 1.0, 1.0])
    for robot, hits in (
        (robot_of(tmp_path, [], {"l0": box}), True),
        (slider(tmp_path, box), True),
        (robot_of(tmp_path, [("prismatic", 0, SLIDE)], {"l0": box}), True),
    ):
        for scene in (None, Scene()):
            if scene is not None:
                scene.add("o", box)
            checker, hit = CollisionChecker(robot, scene), hits and scene is not None
            for shape in ((), (0,), (3,), (1000,), (2, 3)):
                Q = np.zeros((*shape, robot.dof))
                assert np.array_equal(checker.collide(Q), np.full(shape, hit))
                assert np.array_equal(checker.classify(Q), np.full(shape, int(hit)))
                assert np.array_equal(checker.valid_edges(Q, Q, 0.1), np.full(shape, not hit))
                if hit:
                    assert np.array_equal(checker.distance(Q, exact=True).distance, np.full(shape, -1.0))
                else:
                    with pytest.raises(InputError, match="pairs to check"):
                        checker.distance(Q)
            assert len(checker.pairs(np.zeros(robot.dof))) == hit


# -- details ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_pairs_and_distances(seed, bodies, tmp_path):
    """Named are the pairs that collide; the distance is that of the nearest pair and between its bounds."""
    rng = np.random.default_rng(seed)
    pool = [*bodies[0], *bodies[1][:2]]
    robot = arm(tmp_path, pool, seed, links=4)
    scene = random_scene(rng, robot, 3, pool)
    checker, Q = CollisionChecker(robot, scene), robot.random_configurations(25, seed)
    hits = np.array(pairwise(checker, Q, queries.collide))
    nearest = np.array([d.distance for d in pairwise(checker, Q, queries.distance, exact=True)])
    found, bounds = checker.distance(Q, exact=True), checker.distance(Q)
    np.testing.assert_allclose(found.distance, nearest.min(axis=0), atol=1e-9)
    np.testing.assert_array_equal(found.lower, bounds.lower)
    np.testing.assert_array_equal(found.upper, bounds.upper)
    assert (found.lower <= found.distance + 1e-12).all()
    assert (found.distance <= found.upper + 1e-12).all()
    between = found.distance[:, None] * found.normal
    np.testing.assert_allclose(found.witness_b - found.witness_a, between, atol=1e-9)
    for k, q in enumerate(Q):
        # This is the way if the fast searches fail.
        distance, pair, x, y, normal = distances._nearest_with_care(checker._ready(), q)
        assert distance == pytest.approx(found.distance[k], abs=1e-9)
        assert (pair >= 0).all()
        np.testing.assert_allclose(y - x, distance * normal, atol=1e-9)
        contacts = checker.pairs(q)
        assert {(c.name_a, c.name_b) for c in contacts} == {
            checker.checked_pairs[p] for p in np.flatnonzero(hits[:, k])
        }
        assert bool(contacts) is checker.collide(q)
        for c in contacts:
            p = checker.checked_pairs.index((c.name_a, c.name_b))
            assert c.distance == pytest.approx(nearest[p, k], abs=1e-9)
            np.testing.assert_allclose(c.witness_b - c.witness_a, c.distance * c.normal, atol=1e-9)
        one = checker.distance(q, exact=True)
        assert one.distance == found.distance[k]
        assert one.names == tuple(found.names[k])


# -- motions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("resolution", [0.05, 0.3, 50.0])
def test_motions_are_free_if_all_between_are(resolution, bodies, tmp_path):
    """The same as collide along the way, quaternions included, at least as densely as asked for."""
    joints = [("revolute", 0, f'<origin xyz="0.3 0 0"/>{SLIDE}'), ("floating", 0, ""), ("planar", 1, "")]
    robot = robot_of(tmp_path, joints, {"l1": bodies[0][3], "l2": bodies[1][0], "l3": bodies[0][0]})
    scene = Scene()
    scene.add("o", Body.sphere(0.2), translation(0.5, 0.5, 0))
    checker = CollisionChecker(robot, scene, skip_adjacent=False)
    a, b = robot.random_configurations(40, 1) * 0.5, robot.random_configurations(40, 2) * 0.5
    for Q in (a, b):
        Q[:, 4:8] *= 2
    b[:5] = a[:5]
    expected = []
    for p, q, length in zip(a, b, robot.distances(a, b), strict=True):
        steps = max(1, int(np.ceil(length / resolution)))
        way = robot.between(p, q, np.arange(steps + 1) / steps)
        assert (robot.distances(way[:-1], way[1:]) <= resolution * (1 + 1e-9)).all()
        expected.append(not checker.collide(way).any())
    np.testing.assert_array_equal(checker.valid_edges(a, b, resolution), expected)
    assert 0 < np.sum(expected) < 40
    assert checker.valid_edges(a[0], b[0], resolution) is expected[0]
    np.testing.assert_array_equal(checker.valid_edges(a[0], b[:, None][:3], resolution).shape, (3, 1))


def test_tiers_count_what_the_careful_search_settled(tmp_path):
    """All configurations are in the total, also where boxes touch to within a rounding."""
    scene = Scene()
    scene.add("o", Body.box([1.0, 1.0, 1.0]))
    checker = CollisionChecker(slider(tmp_path), scene)
    Q = np.array([[1.0], [0.9999999], [3.0]])
    np.testing.assert_array_equal(checker.collide(Q), [True, True, False])
    settled = checker.tiers(Q)
    assert (settled.total, settled.colliding, settled.free) == (3, 2, 1)


def test_settle_is_collide_and_tiers(tmp_path):
    """`settle` answers as `collide` does and counts as `tiers` does, of one configuration or of many."""
    scene = Scene()
    scene.add("o", Body.box([1.0, 1.0, 1.0]))
    checker = CollisionChecker(slider(tmp_path), scene)
    Q = np.array([[[1.0], [0.9999999]], [[3.0], [0.2]]])
    found, settled = checker.settle(Q)
    np.testing.assert_array_equal(found, checker.collide(Q))
    assert settled == checker.tiers(Q)
    assert checker.settle([3.0])[0] is False
    assert checker.settle([0.2])[0] is True


@far_outside
def test_ends_of_a_motion_are_checked_exactly(tmp_path):
    """Not at a + (b - a), which may miss b by a rounding of a."""
    scene = Scene()
    scene.add("o", Body.box([0.1, 0.1, 0.1]))
    robot = slider(tmp_path, Body.box([0.1, 0.1, 0.1]))
    checker = CollisionChecker(robot, scene)
    start, end = np.array([1e16]), np.array([0.05])
    assert start + (end - start) != end
    np.testing.assert_array_equal(robot.between(start, end, 1.0), end)
    for values in (-0.05, 0.05):
        scene.move("o", translation(values, 0, 0))
        assert not checker.valid_edges(start, [values], 1e16)
        assert not checker.valid_edges([values], start, 1e16)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan, np.inf, 1e-320, 1e-9, "x", None])
def test_resolutions_that_make_no_sense(resolution, tmp_path):
    """Refused without a warning from inside."""
    checker = CollisionChecker(slider(tmp_path))
    with pytest.raises(InputError, match="resolution"):
        checker.valid_edges([0.0], [1.0], resolution)


@far_outside
@pytest.mark.filterwarnings("error")
def test_motions_longer_than_numbers_reach(tmp_path):
    """A motion whose length in configuration space overflows is refused without a warning."""
    checker = CollisionChecker(slider(tmp_path))
    with pytest.raises(InputError, match="longest motion"):
        checker.valid_edges([-1e200], [1e200], 1e100)


# -- bad input ----------------------------------------------------------------------------------

QUERIES = ("collide", "classify", "tiers", "pairs", "distance")


def test_a_robot_without_collision_geometry_is_refused(tmp_path):
    """It would be free everywhere; the links that have visual geometry only are named."""
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="a"><visual><geometry><sphere radius="1"/></geometry></visual></link>'
        '<link name="b"/><joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>'
    )
    for query in (CollisionChecker, pairs_by_sampling):
        with pytest.raises(
            InputError, match="with collision geometry, found none in 'r'; links with <visual> only: a$"
        ):
            query(Robot.from_urdf(path))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda scene: scene.allow("o", "l7"), "in an allowed pair: expected one of o, l0, l1; found 'l7'"),
        (lambda scene: scene.attach("o", "l7"), "link in attach of 'o': expected one of l0, l1; found 'l7'"),
        (lambda scene: scene.attach("o", "p"), "link in attach of 'o': expected one of l0, l1; found 'p'"),
        (
            lambda scene: scene.attach("o", "l1", touch_links=["l7"]),
            "touch link in attach of 'o': expected one of l0, l1; found 'l7'",
        ),
        (lambda scene: scene.set_margin(0.1, "l7"), "in margins: expected one of o, l0, l1; found 'l7'"),
        (lambda scene: scene.set_margin(0.1, "o", "l7"), "in margins: expected one of o, l0, l1; found 'l7'"),
    ],
)
def test_links_that_the_robot_does_not_have(change, message, tmp_path):
    """Each query says where the name stands and which there are, also if the slip comes after the checker was made."""
    scene = Scene()
    scene.add("o", Body.sphere(1.0))
    checker = CollisionChecker(slider(tmp_path), scene)
    assert checker.collide([0.0])
    change(scene)
    for query in QUERIES:
        for _ in range(2):
            with pytest.raises(UnknownNameError, match=message):
                getattr(checker, query)([0.0])


def test_bodies_named_like_links(tmp_path):
    """A scene body with the name of a link is refused by every query, by name."""
    scene = Scene()
    scene.add("l0", Body.sphere(1.0))
    for query in QUERIES:
        with pytest.raises(UnknownNameError, match="'l0', which is also a link"):
            getattr(CollisionChecker(slider(tmp_path), scene), query)([0.0])


@pytest.mark.parametrize(
    "q", [[np.nan], [-np.inf], [1.0, 2.0], [], 3.0, "x", [1j], None, [None], [[1.0], [1.0, 2.0]], {"j": 1}]
)
def test_what_is_no_configuration(q, tmp_path):
    """Anything but finite numbers, one per joint, is refused as a configuration."""
    checker = CollisionChecker(slider(tmp_path))
    for query in QUERIES:
        with pytest.raises(InputError, match="expected"):
            getattr(checker, query)(q)
    with pytest.raises(InputError, match="Q1"):
        checker.valid_edges([0.0], q, 0.1)


def test_pairs_wants_one_configuration_and_motions_shapes_that_fit(tmp_path):
    """`pairs` takes one configuration only; the ends of motions have to broadcast."""
    checker = CollisionChecker(slider(tmp_path))
    with pytest.raises(InputError, match="one configuration"):
        checker.pairs([[0.0]])
    with pytest.raises(InputError, match="broadcast"):
        checker.valid_edges(np.zeros((2, 1)), np.zeros((3, 1)), 1.0)


@pytest.mark.parametrize(
    "allowed", [None, 3, "l0", ["l0"], [("l0",)], [("l0", "l1", "l0")], [("l0", "l0")], [("l0", "l9")], [(0, 1)], [3]]
)
def test_allowed_pairs_that_are_none(allowed, tmp_path):
    """Nothing is silently skipped."""
    with pytest.raises(LoewnerError, match="expected"):
        CollisionChecker(slider(tmp_path), allowed=allowed)


def test_the_message_about_a_link_names_the_argument(tmp_path):
    """A misspelt link among the allowed pairs is told as one of `allowed`."""
    with pytest.raises(UnknownNameError, match="link in allowed: expected one of l0, l1; found 'floor'"):
        CollisionChecker(slider(tmp_path), allowed=[("l0", "floor")])


def test_neither_robot_nor_scene(tmp_path):
    """A checker is made of a Robot and a Scene, and names what it got instead."""
    with pytest.raises(InputError, match=r"robot: expected loewner\.Robot, found str"):
        CollisionChecker("panda.urdf")
    with pytest.raises(InputError, match=r"scene: expected loewner\.Scene or None, found dict"):
        CollisionChecker(slider(tmp_path), {})


# -- copies -------------------------------------------------------------------------------------

ASK = """
import pickle, sys
import numpy as np
with open(sys.argv[1], "rb") as stream:
    checker, Q = pickle.load(stream)
print("".join(str(int(x)) for x in checker.collide(Q)))
"""


def test_a_checker_survives_its_original(bodies, tmp_path):
    """Copies do not lean on what they were copied from: in another process, and after that is gone."""
    robot = arm(tmp_path, bodies[0])
    checker = CollisionChecker(robot, random_scene(np.random.default_rng(3), robot, 4, bodies[0]))
    Q = robot.random_configurations(300, 5)
    expected = checker.collide(Q)
    assert expected.any()
    twin = copy.deepcopy(checker)
    saved = tmp_path / "checker.pickle"
    saved.write_bytes(pickle.dumps((checker, Q)))
    del checker
    gc.collect()
    np.testing.assert_array_equal(twin.collide(Q), expected)
    ran = subprocess.run([sys.executable, "-c", ASK, str(saved)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "".join(str(int(x)) for x in expected)


class ChangedMeanwhile(Scene):
    """As if another thread forbade a pair while a checker prepares the pairs."""

    def snapshot(self):
        now = super().snapshot()
        for pair in self.allowed:
            self.forbid(*pair)
        return now


def test_what_changes_while_pairs_are_prepared_is_noticed_the_next_time(tmp_path):
    """A change of the scene during preparation does not affect this query, and takes effect in the next one."""
    scene = ChangedMeanwhile()
    for name in ("o", "p"):
        scene.add(name, Body.sphere(1.0), translation(100.0 if name == "p" else 0.0))
    scene.allow("l1", "o")
    checker = CollisionChecker(slider(tmp_path), scene)
    assert not checker.collide([0.0])  # as the scene was
    assert not scene.allowed
    assert checker.collide([0.0])


def test_no_answers_of_another_scene_or_robot(bodies, tmp_path):
    """What was prepared is never asked about another scene, nor about the same robot on another base."""
    robot = arm(tmp_path, bodies[0])
    checker = CollisionChecker(robot, Scene())
    checker.collide(robot.random_configurations(3, 0))
    with pytest.raises(AttributeError):
        checker.scene = Scene()
    with pytest.raises(AttributeError):
        checker.robot = robot.placed(translation(1.0, 0.0, 0.0))


def test_a_motion_alone_is_divided_as_in_a_batch(tmp_path):
    """Also where a length is a whole number of steps but for its rounding, and one step more would see a collision."""
    checker = CollisionChecker(gantry_robot(tmp_path))
    a, b = np.random.default_rng(5).uniform(-1, 1, size=(2, 2000, 3))
    for count in (3, 7, 10, 49):
        for x, y in zip(a, b, strict=True):
            step = math.dist(x, y) / count
            alone = edges.steps(checker.robot._distances(x, y), step)
            assert edges.steps(lengths(prepared_of(checker), x[None], y[None], step), step)[0] == alone


def test_quotients_that_rounding_may_move_are_found():
    """Whole numbers but for a rounding, and what overflowed."""
    assert edges.nearly_whole(np.array([0.5, 2.0, 3.0 - 1e-13, np.inf, 7.1])).tolist() == [1, 2, 3]


ALWAYS = """<robot name="r"><link name="a"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
<link name="b"/><link name="c"><collision><geometry><box size="3 3 3"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 1.2"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/></joint><joint name="k" type="revolute"><parent link="b"/><child link="c"/>
<origin xyz="0 0 {}"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>"""


@pytest.mark.parametrize("one_by_one", [False, True])
def test_a_pair_that_always_collides_is_named_once(one_by_one):
    """Nobody can plan with such a pair, and the pair alone says why; a robot that is free somewhere causes no words."""
    for height, words in ((0.2, 1), (1.0, 0)):
        robot = Robot.from_urdf(text=ALWAYS.format(height))
        checker = CollisionChecker(robot, skip_adjacent=False)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            for Q in robot.random_configurations(100) if one_by_one else [robot.random_configurations(100)] * 3:
                checker.collide(Q)
        assert len(told) == words
        assert all("'a' and 'c' collide in each of" in str(one.message) for one in told)
