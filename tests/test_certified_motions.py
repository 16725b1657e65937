"""Motions proven free are free at every sample, those found colliding collide there, and nothing else is left open."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest

import loewner
from checker_oracle import composed_bodies, random_robot, random_scene, simple_bodies
from families import translation
from gantry import RADIUS, gantry_robot
from loewner import Body, CollisionChecker, InputError, Scene, Verdict
from loewner._kernels import columns
from loewner._kernels.robots import motions, sweeps
from loewner.robots.proofs import courses
from loewner.robots.proofs import motions as robots_motions
from motion_oracle import (
    AFLOAT,
    FINGERS,
    assert_true,
    example,
    free_configurations,
    refuted,
    ring,
    steps,
    written,
)  # fmt: skip

# A link that turns about z on its base.
TURNTABLE = """<robot name="turntable"><link name="base"/>
<link name="table"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/></joint>
</robot>"""

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS

# Motions of robots with limits of a metre, deliberately far outside.
far_outside = pytest.mark.filterwarnings("ignore:.*is it in .*:UserWarning")

ARMS = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf"),
}


@pytest.fixture(scope="module")
def arms():
    made = {}

    def arm(name):
        if name not in made:
            made[name] = example(*ARMS[name])
        return made[name]

    return arm


@pytest.fixture
def machine(tmp_path):
    """The gantry alone: a ball that slides along x and y, and a rod that turns."""
    return gantry_robot(tmp_path)


def ball_only(machine):
    """The gantry without its rod."""
    return replace(machine, bodies={"ball": Body.sphere(RADIUS)})


def afloat(folder):
    """A robot on floating, planar, turning and sliding joints, with bodies of all kinds."""
    bodies = {
        "cart": Body.box([0.3, 0.2, 0.1]), "arm": Body.capsule(0.05, 0.3),
        "hand": Body.union([Body.sphere(0.06), Body.cone(0.05, 0.2).transformed(translation(0.1, 0, 0))]),
    }  # fmt: skip
    return replace(written(folder, AFLOAT), bodies=bodies)


# -- laws ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("length", [0.2, 1.0, 3.0])
def test_arms_among_obstacles(arms, name, length, rng):
    """No motion of an arm that is proven is refuted by 2,000 samples, every hit is one, and all are decided."""
    checker = CollisionChecker(arms(name), ring(rng, 10, 0.4, 0.9, 0.25))
    Q = free_configurations(checker, 40)
    verdicts = assert_true(checker, Q, steps(checker.robot, rng, Q, length))
    assert (verdicts == FREE).any()
    assert (verdicts == COLLIDING).any()
    assert not (verdicts == AMBIGUOUS).any()


def test_floating_and_planar_bases(tmp_path, rng):
    """The same of a robot with an orientation of its own: the shorter arc, a constant turn."""
    checker = CollisionChecker(afloat(tmp_path), ring(rng, 8, 0.8, 2.5, 0.6))
    Q = free_configurations(checker, 60)
    for length in (0.3, 2.0):
        verdicts = assert_true(checker, Q, steps(checker.robot, rng, Q, length), samples=1000)
        assert (verdicts == FREE).any()
        assert (verdicts == COLLIDING).any()


def test_half_turns(tmp_path, rng):
    """Between opposite orientations rounding chooses the way; the proof is of the one that `between` takes."""
    checker = CollisionChecker(afloat(tmp_path), ring(rng, 8, 0.5, 1.5, 0.5))
    Q = free_configurations(checker, 200)
    end = Q.copy()
    at = checker.robot._quaternions["base"]
    w, x, y, z = Q[:, at].T
    end[:, at] = np.column_stack([-x, w, -z, y])  # half a turn about an axis of the body, exactly
    verdicts = assert_true(checker, Q, end, samples=200)
    assert (verdicts == FREE).any()
    assert (verdicts == COLLIDING).any()


@pytest.mark.parametrize("kind", [*ARMS, "afloat"])
def test_values_off_the_motion(arms, tmp_path, kind, rng):
    """Proven with values that may be off, no configuration that is off by so much collides; many do where none may."""
    robot = afloat(tmp_path) if kind == "afloat" else arms(kind)
    checker = CollisionChecker(robot, ring(rng, 14, 0.3, 1.2, 0.3))
    Q = free_configurations(checker, 150)
    ends = steps(robot, rng, Q, 0.2)
    off = rng.uniform(0.0, 0.03, Q.shape) * (rng.random(Q.shape) < 0.5)
    straight = courses.straight(robot, Q, ends)
    strays = robots_motions.settle(checker._ready(), straight, 1e-5, off).verdicts
    bare = checker.certify_edges(Q, ends).verdict
    hit = np.zeros(len(Q), dtype=bool)
    for _ in range(300):
        there = robot.between(Q, ends, rng.random(len(Q))) + off * rng.choice([-1.0, 1.0], Q.shape)
        for at in robot._quaternions.values():
            there[:, at] /= np.linalg.norm(there[:, at], axis=1, keepdims=True)
        hit |= checker.collide(there)
    assert not (hit & (strays == FREE)).any()
    assert (hit & (bare == FREE)).any()
    assert (strays == FREE).sum() > 0.3 * (bare == FREE).sum()
    assert (bare[strays == FREE] == FREE).all()
    same = robots_motions.settle(checker._ready(), straight, 1e-5, np.zeros_like(off))
    assert (same.verdicts == bare).all()


@pytest.mark.parametrize("seed", [*range(6), *(pytest.param(k, marks=pytest.mark.verify) for k in range(6, 12))])
def test_random_robots(tmp_path, seed):
    """The same of robots of all joints with bodies of all kinds and many pieces, margins and attachments."""
    rng = np.random.default_rng(seed)
    bodies = simple_bodies(rng) + composed_bodies(rng)
    robot = random_robot(rng, tmp_path, 5, bodies[: 9 + 4 * (seed % 2)])
    checker = CollisionChecker(robot, random_scene(rng, robot, 4, bodies), skip_adjacent=True)
    Q = free_configurations(checker, 12, seed)
    if robot.dof == 0 or len(Q) == 0:
        pytest.skip("a robot that is never free")
    assert_true(checker, Q, steps(robot, rng, Q, 0.5), samples=300)


def test_many_pieces(tmp_path, rng):
    """A body of many pieces is as its pieces are, one by one."""
    robot = afloat(tmp_path)
    parts = [Body.box(rng.uniform(0.05, 0.2, 3)).transformed(translation(*rng.normal(size=3))) for _ in range(60)]
    whole, single = Scene(), Scene()
    whole.add("all", Body.union(parts))
    for k, part in enumerate(parts):
        single.add(f"part {k}", part)
    checker = CollisionChecker(robot, whole)
    Q = free_configurations(checker, 40)
    end = steps(robot, rng, Q, 0.5)
    verdicts = assert_true(checker, Q, end, samples=500)
    assert (verdicts == CollisionChecker(robot, single).certify_edges(Q, end).verdict).all()
    assert (verdicts == FREE).any()
    assert (verdicts == COLLIDING).any()


def test_reversal(arms, rng):
    """A motion that is free is free backwards, and one that collides collides backwards."""
    checker = CollisionChecker(arms("panda"), ring(rng, 10, 0.4, 0.9, 0.25))
    Q = free_configurations(checker, 200)
    end = steps(checker.robot, rng, Q, 1.0)
    assert (checker.certify_edges(Q, end).verdict == checker.certify_edges(end, Q).verdict).all()


# -- answers in closed form ---------------------------------------------------------------------


@pytest.mark.parametrize("along", ["x", "y"])
@pytest.mark.parametrize(
    ("gap", "allowed"),
    [(1e-2, {FREE}), (2e-5, {FREE}), (1.1e-5, {FREE}), (5e-6, {FREE, AMBIGUOUS}), (1e-9, {FREE, AMBIGUOUS}),
     (-1e-9, {COLLIDING}), (-1e-3, {COLLIDING})],
)  # fmt: skip
def test_a_ball_beside_a_wall(machine, along, gap, allowed):
    """A ball that passes a wall at a distance known in closed form, parallel to it and towards its edge."""
    scene = Scene()
    # A wall whose face is at x = 0.3: the ball slides by along y, or comes head-on from the left.
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(ball_only(machine), scene)
    x = 0.3 - RADIUS - gap
    ends = {"y": ([x, -0.9, 0.0], [x, 0.9, 0.0]), "x": ([-0.8, 0.1, 0.0], [x, 0.1, 0.0])}
    found = checker.certify_edges(*ends[along])
    assert found.verdict in allowed
    if found.verdict != FREE:
        assert found.names == ("ball", "wall")


@pytest.mark.parametrize("turns", [0.1, 1.0, 40.0])
@pytest.mark.parametrize("gap", [1e-3, 1.5e-5, 1e-6, -1e-6])
@far_outside
def test_a_rod_that_sweeps_past_a_wall(machine, turns, gap):
    """The corner of a rod passes a wall at one instant only, at a distance known in closed form."""
    corner = np.hypot(0.45, 0.01)
    scene = Scene()
    scene.add("wall", Body.box([0.1, 3.0, 1.0]), translation(corner + gap + 0.05, 0, 0))
    robot = replace(machine, bodies={"rod": machine.bodies["rod"]})
    checker = CollisionChecker(robot, scene)
    angle = np.pi * turns
    found = checker.certify_edges([0, 0, -0.3 * angle], [0, 0, 0.7 * angle])
    if gap > 1e-5:
        assert found.verdict == FREE
    elif gap > 0:
        assert found.verdict == AMBIGUOUS or found.verdict == FREE
    else:
        assert found.verdict == COLLIDING
    if found.verdict != FREE:
        # Where a corner is nearest to the wall: rod's axis at the angle of the corner, up or down.
        q = robot.between([0, 0, -0.3 * angle], [0, 0, 0.7 * angle], found.fraction)
        off = np.abs(np.remainder(q[2] + np.pi, 2 * np.pi) - np.pi) - np.arctan2(0.01, 0.45)
        assert abs(off) < 0.02


def test_closing_fingers(tmp_path):
    """Fingers that slide together by one value and its mimic end at a gap known in closed form."""
    checker = CollisionChecker(written(tmp_path, FINGERS), skip_adjacent=False)
    assert ("left", "right") in checker.checked_pairs
    gaps = np.array([1e-2, 1e-4, 1.1e-5, 2e-6, 0.0, -1e-3])
    found = checker.certify_edges([0.05], gaps[:, None] / 2)
    assert found.verdict.tolist()[:3] == [FREE] * 3
    assert found.verdict[3] != COLLIDING
    assert found.verdict[5] == COLLIDING
    assert found.verdict[4] in (COLLIDING, AMBIGUOUS)


def test_thin_plates_between_samples(machine, rng):
    """A plate that lies between two samples of a motion is hit all the same."""
    scene = Scene()
    scene.add("plate", Body.box([0.4, 1e-4, 0.4]), translation(0.3, 0.0, 0.0))
    robot = replace(machine, bodies={"rod": Body.box([0.3, 1e-3, 0.02]).transformed(translation(0.3, 0, 0))})
    checker = CollisionChecker(robot, scene)
    start = rng.uniform([-0.01, -0.01, -1.0], [0.01, 0.01, -0.1], (200, 3))
    end = start * [1, 1, -1]
    end[:, 2] += rng.uniform(0, 0.05, 200)
    found = checker.certify_edges(start, end)
    assert (found.verdict == COLLIDING).all()
    assert checker.valid_edges(start, end, 0.05).mean() > 0.3  # which sampling does not see


def test_margins(machine):
    """A motion is free if it keeps the margin of its pair, not if it keeps less."""
    scene = Scene(margin=0.05)
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(ball_only(machine), scene)
    x = 0.3 - RADIUS - np.array([0.051, 0.0501, 0.05001 + 2e-6, 0.0499, 0.02])
    start, end = (np.column_stack([x, np.full(5, y), np.zeros(5)]) for y in (-0.9, 0.9))
    assert checker.certify_edges(start, end).verdict.tolist() == [FREE, FREE, FREE, COLLIDING, COLLIDING]
    scene.set_margin(0.1, "ball", "wall")
    assert (checker.certify_edges(start, end).verdict == COLLIDING).all()
    scene.set_margin(0.0, "ball", "wall")
    assert (checker.certify_edges(start, end).verdict == FREE).tolist() == [True, True, True, False, False]
    scene.set_margin(0.0, "ball", "wall", lower=True)
    assert (checker.certify_edges(start, end).verdict == FREE).all()


def test_attached_bodies(machine):
    """What a link holds moves with it, and may touch what it is allowed to."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    scene.add("pole", Body.box([0.3, 0.01, 0.01]))
    checker = CollisionChecker(ball_only(machine), scene)
    ends = [0.1, -0.5, 0.0], [0.1, 0.5, 0.0]
    assert checker.certify_edges([0.1, 0.3, 0.0], [0.1, 0.5, 0.0]).verdict == FREE
    scene.attach("pole", "ball", translation(0.2, 0, 0), touch_links=["ball"])
    found = checker.certify_edges(*ends)
    assert found.verdict == COLLIDING
    assert found.names == ("pole", "wall")


def test_a_moved_obstacle(machine):
    """What is prepared follows the scene."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(ball_only(machine), scene)
    ends = [0.25, -0.9, 0.0], [0.25, 0.9, 0.0]
    assert checker.certify_edges(*ends).verdict == COLLIDING
    scene.move("wall", translation(0.6, 0, 0))
    assert checker.certify_edges(*ends).verdict == FREE


def test_a_scene_that_changes_meanwhile(tmp_path, monkeypatch):
    """A hit is confirmed in the scene that it was found in, not in the one that there is by then."""
    robot = replace(written(tmp_path, AFLOAT), bodies={"cart": Body.sphere(RADIUS)})
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0.3))
    checker = CollisionChecker(robot, scene)
    start, end = robot.configuration({"base/x": -1.0}), robot.configuration({"base/x": 1.0})
    settle = robots_motions.settle

    def with_another_thread(*given, **options):
        found = settle(*given, **options)
        scene.move("wall", translation(0.4, 5.0, 0.3))
        return found

    monkeypatch.setattr(robots_motions, "settle", with_another_thread)
    assert checker.certify_edges(start, end).verdict == COLLIDING
    assert checker.certify_edges(start, end).verdict == FREE


# -- special motions ----------------------------------------------------------------------------


def test_motions_of_no_length(arms, rng):
    """A motion that stays where it is, is what `collide` says of that place."""
    checker = CollisionChecker(arms("panda"), ring(rng, 10, 0.4, 0.9, 0.25))
    Q = checker.robot.random_configurations(300)
    verdicts = checker.certify_edges(Q, Q).verdict
    assert ((verdicts == COLLIDING) == checker.collide(Q)).all()
    assert not (verdicts == AMBIGUOUS).any()


@far_outside
def test_motions_far_outside_the_limits(machine, rng):
    """Limits are no obstacle, nor are hundreds of turns or metres."""
    checker = CollisionChecker(machine, ring(rng, 6, 0.5, 1.5, 0.3))
    start = np.array([[300.0, 0, 0], [0, 300.0, -700.0], [3.0, 3.0, -900.0], [-300.0, 0.01, 5.0]])
    end = np.array([[-300.0, 0, 0], [0.0, -300.0, 800.0], [3.0, 3.0, 900.0], [-300.0, 4.0, 5.0]])
    verdicts = assert_true(checker, start, end, samples=200_000)
    assert verdicts[2] == FREE
    assert verdicts[3] == FREE


@far_outside
@pytest.mark.parametrize("far", [1e15, 1e100, 1e154, 1e160, 1e190])
@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_motions_to_where_squares_overflow(machine, far, margin):
    """What is so far away that its squares are infinite does not collide there."""
    scene = Scene(margin=margin)
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(ball_only(machine), scene)
    start = np.array([[0.0, 0, 0], [0, 5.0, 0], [far / 2, 0, 0]])
    end = np.array([[far, 0, 0], [far, 5.0, 0], [far, 0, 0]])
    found = checker.certify_edges(start, end)
    hit = found.verdict == COLLIDING
    assert checker.collide(checker.robot.between(start[hit], end[hit], found.fraction[hit])).all()
    assert found.verdict[1] != COLLIDING
    assert found.verdict[2] == FREE


@far_outside
def test_motions_too_long_are_refused(machine):
    """What would take forever is refused, with the motion's number; what overflows as well."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(machine, scene)
    for far in (1e9, 1e190):
        with pytest.raises(InputError, match="number 1"):
            checker.certify_edges([0, 0, 0], [[0, 0, 1.0], [0, 0, far]])


def test_empty_batches(machine):
    """No motions have no verdicts; a robot without pairs is always free."""
    checker = CollisionChecker(ball_only(machine))
    found = checker.certify_edges(np.empty((0, 3)), [0.0, 0, 0])
    assert found.verdict.shape == (0,)
    assert found.names.shape == (0, 2)
    assert found.fraction.shape == (0,)
    assert checker.certify_edges([0, 0, 0], [0.5, 0.5, 1.0]).verdict == FREE


def test_shapes(machine, rng):
    """Ends broadcast; one motion gives scalars, a batch arrays of its shape."""
    checker = CollisionChecker(machine, ring(rng, 6, 0.3, 0.8, 0.2))
    start, end = rng.uniform(-1, 1, (3, 1, 3)), rng.uniform(-1, 1, (4, 3))
    found = checker.certify_edges(start, end)
    assert found.verdict.shape == found.fraction.shape == found.poses.shape == found.searches.shape == (3, 4)
    assert found.names.shape == (3, 4, 2)
    assert found.verdict.dtype == np.int8
    one = checker.certify_edges(start[1, 0], end[2])
    assert isinstance(one.verdict, Verdict)
    assert isinstance(one.fraction, float)
    assert isinstance(one.poses, int)
    assert one.verdict == found.verdict[1, 2]
    assert one.names == tuple(found.names[1, 2])
    assert "CertifiedMotions" in repr(found)


@pytest.mark.parametrize(
    ("start", "end", "options", "text"),
    [
        ([0, 0], [0, 0, 0], {}, r"Q0: expected shape \(..., 3\)"),
        ([0, 0, 0], [0, 0, np.nan], {}, "Q1.*finite"),
        ([0, 0, np.inf], [0, 0, 0], {}, "Q0.*finite"),
        (np.zeros((2, 3)), np.zeros((3, 3)), {}, "broadcast"),
        ([0, 0, 0], [0, 0, 1], {"tolerance": 0.0}, "tolerance"),
        ([0, 0, 0], [0, 0, 1], {"tolerance": -1e-5}, "tolerance"),
        ([0, 0, 0], [0, 0, 1], {"tolerance": np.nan}, "tolerance"),
        ([0, 0, 0], [0, 0, 1], {"tolerance": np.inf}, "tolerance"),
        ([0, 0, 0], [0, 0, 1], {"tolerance": "fine"}, "tolerance"),
    ],
)
def test_bad_input(machine, start, end, options, text):
    """What is no motion or no tolerance is refused, saying what was expected."""
    with pytest.raises(InputError, match=text):
        CollisionChecker(machine).certify_edges(start, end, **options)


def test_threads(arms, rng):
    """Answers depend neither on the number of threads, nor on a motion's batch, nor on what was asked before."""
    checker = CollisionChecker(arms("panda"), ring(rng, 10, 0.4, 0.9, 0.25))
    Q = free_configurations(checker, 400)
    end = steps(checker.robot, rng, Q, 1.5)
    before = loewner.get_num_threads()
    found = []
    try:
        for count in (1, 2, 5):
            loewner.set_num_threads(count)
            found.append(checker.certify_edges(Q, end))
    finally:
        loewner.set_num_threads(before)
    prepared = checker._ready().lasting
    checker.collide(checker.robot.random_configurations(2000))  # from which the order of pairs is learnt
    assert checker._ready().lasting is prepared
    found.append(copy.copy(checker).certify_edges(Q[::-1], end[::-1]))
    for other in found[1:]:
        order = slice(None, None, -1) if other is found[-1] else slice(None)
        for name in ("verdict", "fraction", "names", "poses", "searches"):
            assert np.array_equal(getattr(other, name)[order], getattr(found[0], name), equal_nan=name == "fraction")


def test_reaches_from_a_base_that_is_not_quite_rigid(tmp_path):
    """A pose accepted as rigid does not move the axis of a joint, from which a body far along it is close."""
    robot = written(tmp_path, TURNTABLE)
    T = np.eye(4)
    T[0, 2] = T[2, 0] = 4e-7
    robot = replace(robot.placed(T), bodies={"table": Body.sphere(1e-5).transformed(translation(1e-4, 0.0, 100.0))})
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    reach = CollisionChecker(robot, scene)._ready().tables.reach[0, robot.link_names.index("table")]
    assert 1.1e-4 <= reach < 1.2e-4


# -- tolerance and work -------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-8, 1e-10])
def test_tolerance(machine, tolerance):
    """Beyond the tolerance every motion is decided; within it none is called free that collides."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(machine, scene)
    corner = np.hypot(0.45, 0.01)
    gaps = tolerance * np.array([1.01, 2.0, 10.0])
    x = 0.3 - corner - gaps
    start, end = (np.column_stack([x, np.full(3, -0.3), np.full(3, turn)]) for turn in (-1.0, 1.0))
    assert (checker.certify_edges(start, end, tolerance=tolerance).verdict == FREE).all()
    past = np.array([1.1 * gaps[2], 0, 0])
    assert (checker.certify_edges(start + past, end + past, tolerance=tolerance).verdict == COLLIDING).all()


def test_a_tolerance_below_rounding(machine):
    """Where arithmetic cannot tell, a motion is not free, and the search for it ends."""
    scene = Scene()
    scene.add("wall", Body.box([0.2, 1.0, 1.0]), translation(0.4, 0, 0))
    checker = CollisionChecker(machine, scene)
    x = 0.3 - np.hypot(0.45, 0.01) - 1e-15
    found = checker.certify_edges([x, -0.3, -1.0], [x, -0.3, 1.0], tolerance=1e-300)
    assert found.verdict in (AMBIGUOUS, COLLIDING)
    assert found.poses < 10_000


def test_memory_suffices():
    """Cuts in eight end where no double is left between two; each leaves at most three intervals behind."""
    cuts = math.ceil((53 - math.log2(sweeps.INTERVALS)) / math.log2(motions.PARTS))
    assert cuts + 1 < motions.DEPTH
    assert 1 + math.log2(motions.PARTS) * (motions.DEPTH - 1) < motions.STACK
    assert 2 * motions.LANES < motions.WAITING


def test_work_is_bounded(arms, rng):
    """Free motions of a radian take few poses and searches."""
    checker = CollisionChecker(arms("panda"), ring(rng, 10, 0.4, 0.9, 0.25))
    Q = free_configurations(checker, 400)
    found = checker.certify_edges(Q, steps(checker.robot, rng, Q, 1.0))
    free = found.verdict == FREE
    assert found.poses[free].mean() < 16
    assert found.searches[free].mean() < 20
    assert found.poses.max() < 1000
    assert found.searches.max() < 2000


# -- mutants ------------------------------------------------------------------------------------


def without_sliding_joints(ready):
    """Shorten the paths of links as if sliding joints stood still: a mistake of an early version."""
    start, links = ready.tables.path_start, ready.tables.path_link
    kept = [path[ready.robot.tree.kind[path] != columns.PRISMATIC] for path in np.split(links, start[1:-1])]
    start[1:] = np.cumsum(list(map(len, kept)))
    links[: start[-1]] = np.concatenate(kept)


def closing(tmp_path):
    """Motions of fingers, half of which close for good."""
    checker = CollisionChecker(written(tmp_path, FINGERS), skip_adjacent=False)
    return checker, np.full((40, 1), 0.05), np.linspace(-0.02, 0.02, 40)[:, None]


@pytest.fixture(scope="module")
def long_sweeps(arms):
    """Motions of 4 rad of a Panda among thin plates: their starts and ends."""
    rng = np.random.default_rng(3)
    checker = CollisionChecker(arms("panda"), ring(rng, 45, 0.35, 0.9, 0.04))
    Q = free_configurations(checker, 3000)
    return Q, steps(checker.robot, rng, Q, 4.0)


def false_free(checker, start, end):
    """Motions that are called free and are not."""
    free = checker.certify_edges(start, end).verdict == FREE
    return int(refuted(checker, start[free], end[free], 500).sum())


def test_sliding_joints_taken_for_still_are_noticed(tmp_path):
    """The tests of closing fingers would fail if what only slides were taken not to move."""
    checker, start, end = closing(tmp_path)
    assert false_free(checker, start, end) == 0
    without_sliding_joints(checker._ready())
    assert false_free(checker, start, end) > 0


@pytest.mark.parametrize(("rows", "margin"), [(slice(3, 6), 0.0), (slice(6, 7), 0.2)])
def test_boxes_without_widths_or_margins_are_noticed(arms, long_sweeps, rows, margin):
    """The tests of arms would fail if what is compared with whole blocks of a motion were too small."""
    arm = arms("panda")
    scene = ring(np.random.default_rng(3), 45, 0.35, 0.9, 0.04)
    scene.set_margin(margin)
    checker, (start, end) = CollisionChecker(arm, scene), (rows[:1000] for rows in long_sweeps)
    assert false_free(checker, start, end) == 0
    checker._ready().tables.groups.reshape(-1, 8, 8)[:, rows] = 0.0
    assert false_free(checker, start, end) > 0


def test_groups_hold_every_pair(arms, rng):
    """Each pair with a static body is in a group of its moving body, with its box, its margin and its size."""
    ready = CollisionChecker(arms("panda"), ring(rng, 13, 0.3, 1.2, 0.3))._ready()
    tables, moving = ready.tables, len(ready.link)
    numbers, rows = tables.group_pairs.reshape(-1, 8), tables.groups.reshape(-1, 8, 8)
    assert set(numbers.ravel()) == set(np.flatnonzero(ready.pairs[:, 1] >= moving))
    assert (ready.pairs[numbers, 0] == np.repeat(np.arange(moving), np.diff(tables.group_start))[:, None]).all()
    still = ready.pairs[numbers, 1] - moving
    assert (rows[:, :6].swapaxes(1, 2) == ready.standing.bounds[still][..., [0, 1, 2, 4, 5, 6]]).all()
    assert (rows[:, 6] == ready.margins[numbers]).all()
    assert (rows[:, 7] == tables.sizes[still]).all()


def test_ways_taken_for_straight_are_noticed(arms, long_sweeps):
    """The tests of arms would fail if the curvature of ways were left out."""
    scene = ring(np.random.default_rng(3), 45, 0.35, 0.9, 0.04)
    checker, (start, end) = CollisionChecker(arms("panda"), scene), long_sweeps
    assert false_free(checker, start, end) == 0
    # The reach enters the curvature and the speed; speed decides nothing but when to give up.
    checker._ready().tables.reach[:] *= 1e-9
    assert false_free(checker, start, end) > 0
