"""Proofs of motions whose work is limited in steps: they stop in time, and give no other verdict than AMBIGUOUS."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.interpolate import PPoly

import capi
import mechanisms
from families import translation
from loewner import Body, CollisionChecker, InputError, Scene, Verdict
from loewner._kernels.tolerances import ROTATION_TOLERANCE
from loewner._native import library
from native_files import needs_library
from sampling import quick
from test_piece_trees import without_trees

HERE = Path(__file__).parent

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS

# What docs/certified.md, "Bounded work", adds to a limit besides numbers of the scene.
MORE = 100


def carriage(*bodies):
    """A robot that slides along three axes and turns, and the last bodies of which are on further hinges."""
    names, last = ["x", "y", "z", *(f"hand{k}" for k in range(len(bodies)))], "base"
    parts = [mechanisms.link("base")]
    for k, name in enumerate(names):
        parts.append(mechanisms.link(name))
        kind, axis = ("prismatic", np.eye(3, dtype=int)[k]) if k < 3 else ("revolute", (0, 0, 1))
        parts.append(mechanisms.joint(f"j{k}", kind, last, name, axis=axis, limits=(-1e4, 1e4)))
        last = name
    hands = {f"hand{k}": body for k, body in enumerate(bodies) if body is not None}
    return replace(mechanisms.robot(*parts), bodies=hands)


def scene_of(**bodies):
    scene = Scene()
    for name, (body, T) in bodies.items():
        scene.add(name, body, T)
    return scene


def bumpy(subdivisions, size, phase=0.0):
    """A solid with bumps, by its triangles."""
    mesh = trimesh.creation.icosphere(subdivisions, size)
    v = mesh.vertices / size
    mesh.vertices *= 1 + 0.05 * np.sin(7 * v[:, :1] + phase) * np.sin(5 * v[:, 1:2])
    return Body.from_surface(mesh)


def wall():
    """Points of a wavy wall across the x axis."""
    y, z = np.meshgrid(*[np.arange(-0.5, 0.5, 0.02)] * 2)
    return np.stack([0.01 * np.sin(9 * y) * np.sin(8 * z), y, z], axis=-1).reshape(-1, 3)


def crumbs(count):
    """A surface of separate tetrahedra around the z axis."""
    one = trimesh.creation.icosphere(0, 0.01)
    angles = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    at = np.stack([0.2 * np.cos(angles), 0.2 * np.sin(angles), 0.02 * np.cos(9 * angles)], axis=1)
    faces = one.faces + len(one.vertices) * np.arange(count)[:, None, None]
    return Body.from_surface(((one.vertices + at[:, None]).reshape(-1, 3), faces.reshape(-1, 3)))


def motion(robot, start, way, turn):
    """Ends of a motion of the carriage, whose hinges all turn by `turn`."""
    a, b = np.zeros(robot.dof), np.full(robot.dof, turn)
    a[:3], b[:3] = start, np.add(start, way)
    return a, b


def balls_near_a_box():
    """A box that slides along a flat wall of balls, half a millimetre away."""
    robot = carriage(Body.box([0.2, 0.6, 0.6]))
    scene = scene_of(wall=(Body.spheres(wall() * [0, 1, 1], np.full(len(wall()), 0.01)), np.eye(4)))
    return CollisionChecker(robot, scene), motion(robot, [0.1105, 0.0, 0.0], [0.0, 0.1, 0.05], 0.0)


def thousands_of_pieces():
    """A moving cloud of voxels beside another one."""
    robot = carriage(Body.from_cloud(wall() + [0.06, 0.0, 0.0], voxel=0.02))
    scene = scene_of(wall=(Body.from_cloud(wall(), voxel=0.02), np.eye(4)))
    return CollisionChecker(robot, scene), motion(robot, [0.0, 0.0, 0.0], [0.0, 0.01, 0.0], 0.0)


def turning_beside_balls():
    """A box that turns beside such a wall: planes in parts of the intervals prove what no plane of a whole one does."""
    robot = carriage(Body.box([0.3, 0.6, 0.3]))
    scene = scene_of(wall=(Body.spheres(wall() * [0, 1, 1], np.full(len(wall()), 0.01)), np.eye(4)))
    return CollisionChecker(robot, scene), motion(robot, [0.349, 0.0, 0.0], [0.0, 0.02, 0.0], 4.0)


def grazing():
    """A round body that spins beside another one, farther away than the tolerance by a hair's breadth."""
    robot = carriage(Body.cone(0.1, 0.2).transformed(translation(0.0, 0.001, 0.0)))
    scene = scene_of(post=(Body.cylinder(0.1, 0.3), np.eye(4)))
    return CollisionChecker(robot, scene), motion(robot, [-0.201 - 1.1e-5, 0.0, 0.0], [0.0, 0.0, 0.03], 6.0)


def dense_surfaces():
    """Two solids with thousands of triangles each, half a millimetre apart."""
    robot = carriage(bumpy(4, 0.2))
    scene = scene_of(shell=(bumpy(4, 0.2), translation(0.4, 0, 0)))
    return CollisionChecker(robot, scene), motion(robot, [-0.0002, 0.0, 0.0], [0.0, 0.03, 0.02], 0.5)


def surfaces_within_each_other():
    """A solid in a slightly larger cave."""
    mesh = trimesh.creation.icosphere(3, 0.204)
    mesh.invert()
    cave = Body.from_surface(trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), mesh]))
    robot = carriage(Body.from_surface(trimesh.creation.icosphere(3, 0.2)))
    return CollisionChecker(robot, scene_of(cave=(cave, np.eye(4)))), motion(
        robot, [0.0, 0.0, 0.0], [1e-4, 0, 1e-4], 0.1
    )


def surface_around_a_piece():
    mesh = trimesh.creation.icosphere(4, 0.204)
    mesh.invert()
    cave = Body.from_surface(trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), mesh]))
    robot = carriage(Body.sphere(0.2))
    return CollisionChecker(robot, scene_of(cave=(cave, np.eye(4)))), motion(
        robot, [0.0, 0.0, 0.0], [1e-4, 0, 1e-4], 0.1
    )


def solid_among_crumbs():
    """A solid torus, and a ring of a thousand connected parts within its hole."""
    torus = Body.from_surface(trimesh.creation.torus(0.3, 0.08, 64, 32))
    robot = carriage(torus)
    return CollisionChecker(robot, scene_of(crumbs=(crumbs(1000), np.eye(4)))), motion(
        robot, [0, 0, 0], [0, 0, 0.004], 0.3
    )


def many_links():
    """A chain of links that are apart, with each other and with static bodies; nothing comes near."""
    robot = carriage(*[Body.sphere(0.001).transformed(translation(0.05 * k, 0, 0)) for k in range(40)])
    return CollisionChecker(robot), motion(robot, [0, 0, 0], [0.1, 0.1, 0.1], 0.01)


def nothing_to_check():
    robot = carriage(Body.sphere(0.1))
    return CollisionChecker(robot), motion(robot, [0, 0, 0], [5.0, 0, 0], 3000.0)


def two_hands():
    """Moving bodies beside each other, one of them a surface."""
    robot = carriage(bumpy(3, 0.1), None, Body.from_cloud(wall() + [0.12, 0, 0], voxel=0.02))
    return CollisionChecker(robot), motion(robot, [0, 0, 0], [0.3, 0, 0], 0.02)


WORLDS = {
    made.__name__: made
    for made in (
        balls_near_a_box, thousands_of_pieces, turning_beside_balls, grazing, dense_surfaces,
        surfaces_within_each_other, surface_around_a_piece, solid_among_crumbs, many_links, nothing_to_check, two_hands,
    )
}  # fmt: skip


def more_than_the_limit(checker):
    """How many steps a proof may take beyond its limit; docs/certified.md derives it."""
    ready = checker._ready(timed=bool(checker.scene.following)).in_parts
    bodies = {int(k) for k in ready.pairs[:, 0]} | {int(k) for k in ready.pairs[:, 1]}
    pieces = max((len(checker.robot.bodies[name].pieces) for name in checker.robot.bodies), default=0)
    return MORE + 2 * len(bodies) + len(ready.pairs) // 8 + pieces


def limits(most, count=14):
    """Limits below a number of steps, shortly before it, at it, and above."""
    late = [most - left for left in (500, 250, 150, 110) if left < most]
    return [*np.unique(np.geomspace(1, most - 1, count).astype(int)).tolist(), *late, most, most + 1, 2 * most]


# How many limits are tried below the number of steps.
COUNTS = pytest.mark.parametrize("count", quick(5, 14))


def held(whole, limited, most, more, taken):
    """Whether a result within a limit is as it may be, beside the one without."""
    assert taken <= most + more, (taken, most)
    if taken > most:
        assert limited.verdict in (AMBIGUOUS, COLLIDING, whole.verdict)
    else:
        assert (limited.verdict, limited.names) == (whole.verdict, whole.names)
    if limited.verdict != AMBIGUOUS:
        assert limited.verdict == whole.verdict


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=[pytest.mark.verify] * (k == "surfaces_within_each_other")) for k in WORLDS]
)
@pytest.mark.parametrize("error", [0.0, pytest.param(1e-4, marks=pytest.mark.verify)])
@COUNTS
def test_no_proof_takes_more_than_its_limit(name, error, count):
    """Up to a number that depends on the scene; and it is AMBIGUOUS, or has the verdict of a proof without a limit."""
    checker, (a, b) = WORLDS[name]()
    whole, more = checker.certify_edges(a, b, joint_error=error), more_than_the_limit(checker)
    stopped = 0
    for most in limits(whole.steps, count):
        found = checker.certify_edges(a, b, joint_error=error, steps=most)
        held(whole, found, most, more, found.steps)
        stopped += found.verdict == AMBIGUOUS and found.steps > most
        if found.steps > most:
            assert 0.0 <= found.fraction <= 1.0 or found.verdict == FREE
    assert stopped > 0


def test_waiting_intervals_keep_the_limit():
    """Many intervals wait to be halved, and planes in their parts prove nearly all of them: each is compared."""
    checker, _ = turning_beside_balls()
    a, b = motion(checker.robot, [0.3475, 0.0, 0.0], [0.0, 0.02, 0.0], 2.0)
    whole, more = checker.certify_edges(a, b), more_than_the_limit(checker)
    assert whole.verdict == FREE
    for most in range(1, whole.steps, 41):
        found = checker.certify_edges(a, b, steps=most)
        held(whole, found, most, more, found.steps)


def barely_not_free():
    """Motions of one pair of pieces, and of many, that are not free; a search shows it only late."""
    checker, (a, b) = grazing()
    for nearer in (1.1e-5, 1.2e-5):
        yield checker, (a + np.eye(len(a))[0] * nearer, b + np.eye(len(b))[0] * nearer)
    checker, _ = turning_beside_balls()
    for deep in (2e-4, 2e-3):
        yield checker, motion(checker.robot, [0.3454 - deep, 0.0, 0.0], [0.0, 0.02, 0.0], 2.0)
    # A rod that turns meets a ball at once, within the first interval; the others are searched before.
    robot = carriage(Body.box([0.6, 0.01, 0.3]))
    ball = Body.sphere(0.02).transformed(translation(0.2 * np.cos(0.21), 0.2 * np.sin(0.21), 0.0))
    yield CollisionChecker(robot, scene_of(ball=(ball, np.eye(4)))), motion(robot, [0, 0, 0], [0, 0, 0], 3.0)


@pytest.mark.parametrize("number", range(5))
def test_what_is_not_free_is_not_free_within_any_limit(number):
    """Wherever a proof stops, it has proven nothing."""
    checker, (a, b) = list(barely_not_free())[number]
    whole = checker.certify_edges(a, b)
    assert whole.verdict != FREE
    for most in np.unique(np.linspace(1, whole.steps, 200).astype(int)).tolist():
        assert checker.certify_edges(a, b, steps=most).verdict != FREE


def clouds(rng, made, moves):
    """A hand of several pieces beside a cloud of voxels, which is static or in the other hand; its pose is bent."""
    T = translation(0.55, 0.3, 0.1)
    T[:3, :3] = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    T[:3, :3] += rng.uniform(-1, 1, (3, 3)) * 0.25 * ROTATION_TOLERANCE
    cloud = Body.from_cloud(rng.uniform(-0.3, 0.3, (400, 3)) * [1.0, 1.0, 0.2], voxel=0.02)
    hand = made(Body.spheres(rng.uniform(-0.1, 0.1, (9, 3)), rng.uniform(0.01, 0.05, 9)))
    if moves:
        return CollisionChecker(carriage(hand, None, made(cloud.transformed(translation(0.2, 0.1, 0.17)))))
    return CollisionChecker(carriage(hand), scene_of(cloud=(made(cloud), T)))


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_trees_change_the_work_and_no_verdict(moves, margin):
    """Only pieces near the way are compared; the verdicts are those of all pairs of pieces."""
    one, other = (clouds(np.random.default_rng(1), made, moves) for made in (lambda body: body, without_trees))
    for checker in (one, other):
        checker.scene.set_margin(margin)
    rng, n, dof = np.random.default_rng(2), 150, one.robot.dof
    a = rng.uniform(-1, 1, (n, dof)) * np.append([0.4, 0.4, 0.3], np.full(dof - 3, 3.0))
    b = a + rng.uniform(-1, 1, (n, dof)) * 0.3 * rng.random((n, 1))
    found, wanted = (checker.certify_edges(a, b) for checker in (one, other))
    assert np.array_equal(found.verdict, wanted.verdict)
    assert (np.bincount(found.verdict, minlength=2)[:2] > 10).all()
    free = found.verdict == FREE
    assert found.steps[free].sum() < 0.1 * wanted.steps[free].sum()


def test_a_tree_leaves_out_what_is_farther_than_the_margin():
    """A ball passes a row of balls, at the margin and a little more or less; each of them is the nearest once."""
    robot, at = carriage(Body.sphere(0.05)), np.linspace(-0.5, 0.5, 40)
    row = Body.spheres(np.stack([at, np.zeros(40), np.zeros(40)], axis=1), np.full(40, 0.01))
    scene = scene_of(row=(row, np.eye(4)))
    scene.set_margin(0.2)
    checker = CollisionChecker(robot, scene)
    for lead in (-3e-5, 3e-5):
        for k in range(40):
            a, b = motion(robot, [at[k] - 0.01, 0.0, 0.26 + lead], [0.02, 0.0, 0.0], 0.0)
            found = checker.certify_edges(a, b)
            assert found.verdict == (FREE if lead > 0 else COLLIDING)
            assert found.steps < 80


def in_time():
    """The same motion among bodies that follow motions: its pieces share the steps."""
    checker, (a, b) = balls_near_a_box()
    checker.scene.add("door", Body.box([0.05, 0.5, 0.5]), translation(-0.1, 0, 0))
    times = np.linspace(0.0, 1.0, 40)
    checker.scene.follow("door", times, [translation(-0.1 - 0.1 * t, 0, 0) for t in times])
    return checker, (a, b)


def test_motions_in_time_keep_the_limit():
    """However many pieces a motion is cut into, they take no more than the limit together."""
    checker, (a, b) = in_time()
    whole, more = checker.certify_edges(a, b, t0=0.0, t1=1.0), more_than_the_limit(checker)
    assert whole.verdict == FREE
    for most in limits(whole.steps):
        found = checker.certify_edges(a, b, t0=0.0, t1=1.0, steps=most)
        held(whole, found, most, more, found.steps)
        assert (found.verdict == FREE) == (found.steps <= most) or most >= whole.steps


@pytest.mark.parametrize("speed", [1e-3, 0.02, 0.3])
def test_bodies_that_grow_keep_the_limit(speed):
    """Also where one may be hit, and the proof goes on without growth."""
    checker, (a, b) = turning_beside_balls()
    checker.scene.follow("wall", [0.0], [np.eye(4)], speed=speed)
    whole, more = checker.certify_edges(a, b, t0=0.0, t1=1.0), more_than_the_limit(checker)
    assert (whole.verdict == FREE) == (speed < 0.01)
    for most in [*limits(whole.steps), *range(1, whole.steps, 97)]:
        found = checker.certify_edges(a, b, t0=0.0, t1=1.0, steps=most)
        held(whole, found, most, more, found.steps)


def curve_through(rng, checker, count):
    """A quadratic curve of as many pieces."""
    a, b = motion(checker.robot, [0.1105, 0.0, 0.0], [0.0, 0.1, 0.05], 0.0)
    t = np.linspace(0.0, 1.0, count + 1)
    bend = 1e-3 * rng.normal(size=checker.robot.dof)
    ways = (b - a) * np.ones((count, 1)) - 2 * bend * (t[:-1, None] - 0.5)
    at = a + t[:-1, None] * (b - a) + bend * t[:-1, None] * (1 - t[:-1, None])
    return PPoly(np.stack([np.tile(-bend, (count, 1)), ways, at]), t)


@COUNTS
def test_curves_keep_the_limit(rng, count):
    """The segments of a curve share the steps; segments that are left over are AMBIGUOUS, without names."""
    checker, _ = balls_near_a_box()
    curve = curve_through(rng, checker, 60)
    whole, more = checker.certify_trajectory(curve), more_than_the_limit(checker)
    total = int(whole.segments.steps.sum())
    for most in limits(total, count):
        found = checker.certify_trajectory(curve, steps=most)
        held(whole, found, most, more, int(found.segments.steps.sum()))
    found = checker.certify_trajectory([curve, curve], steps=total // 2)
    assert found[0].verdict == found[1].verdict == AMBIGUOUS  # each has its own
    assert (found[0].segments.verdict[-1], *found[0].segments.names[-1]) == (AMBIGUOUS, "", "")
    assert (found[0].segments.steps == found[1].segments.steps).all()


@pytest.mark.parametrize("count", quick(80, 200))
def test_batches_keep_the_limit(rng, count):
    """Each motion of a batch has its own limit, whatever the others take and how many threads there are."""
    checker, (a, b) = balls_near_a_box()
    ends = b + np.abs(rng.normal(size=(count, len(b)))) * [0.02, 0.1, 0.1, 0.0] - [0.005, 0.0, 0.0, 0.0]
    alone = [checker.certify_edges(a, end, steps=6300) for end in ends]
    found = checker.certify_edges(a, ends, steps=6300)
    assert np.array_equal(found.verdict, [one.verdict for one in alone])
    assert np.array_equal(found.steps, [one.steps for one in alone])
    assert len(np.unique(found.verdict)) == 3


@COUNTS
def test_contact_that_ends_keeps_the_limit(count):
    """Where a pair may be in contact at the start, the proofs of how it ends count, too; and a pair that they leave
    open is not COLLIDING."""
    robot = carriage(Body.box([0.2, 0.2, 0.2]))
    scene = scene_of(table=(Body.box([1.0, 1.0, 0.1]), translation(0, 0, -0.15)))
    scene.leave("hand0", "table")
    checker, more = CollisionChecker(robot, scene), 5 * MORE
    a, b = motion(robot, [0, 0, 0], [0.1, 0, 0.3], 1.0)
    whole = checker.certify_edges(a, b)
    assert whole.verdict == FREE
    for most in limits(whole.steps, count):
        held(whole, checker.certify_edges(a, b, steps=most), most, more, checker.certify_edges(a, b, steps=most).steps)


@needs_library
@pytest.mark.parametrize("name", ["balls_near_a_box", "dense_surfaces", "thousands_of_pieces"])
def test_limits_in_c_are_those_of_python(tmp_path, name):
    """The same verdicts and the same steps, for motions, for curves and for validators of motions."""
    checker, (a, b) = WORLDS[name]()
    checker.save(tmp_path / "cell.lwn")
    mine = capi.Checker(tmp_path / "cell.lwn")
    whole = checker.certify_edges(a, b)
    ends = np.stack([a, b, a + 0.3 * (b - a)])
    for most in [*limits(whole.steps), None]:
        wanted, taken = checker.certify_edges(a, ends, steps=most), np.zeros((3, 3), dtype=np.int64)
        verdicts, fractions, _ = mine.certify(np.tile(a, (3, 1)), ends, steps=most or 0, taken=taken[0])
        assert np.array_equal(verdicts, wanted.verdict)
        assert np.array_equal(fractions, wanted.fraction, equal_nan=True)
        free = mine.free(np.tile(a, (3, 1)), ends, steps=most or 0, taken=taken[1])
        assert np.array_equal(free, wanted.verdict == FREE)
        curved, _ = mine.certify_curves(np.stack([np.tile(a, (3, 1)), ends], axis=1), steps=most or 0, taken=taken[2])
        assert np.array_equal(curved, wanted.verdict)
        assert (taken == wanted.steps).all()


def test_bad_limits():
    """A limit is a positive integer."""
    checker, (a, b) = many_links()
    for bad in (0, -1, 2.5, True, 2**63, "many"):
        with pytest.raises(InputError, match="steps: expected an integer"):
            checker.certify_edges(a, b, steps=bad)
        with pytest.raises(InputError, match="steps: expected an integer"):
            checker.certify_trajectory(PPoly(np.stack([[b - a], [a]]), [0.0, 1.0]), steps=bad)


@needs_library
def test_bad_limits_in_c(tmp_path):
    """In C, 0 stands for no limit."""
    checker, (a, b) = many_links()
    checker.save(tmp_path / "cell.lwn")
    with pytest.raises(capi.Error, match="steps: expected a number >= 0, found -1"):
        capi.Checker(tmp_path / "cell.lwn").certify(a[None], b[None], steps=-1)


@pytest.fixture(scope="module")
def counting(tmp_path_factory):
    """The program that counts allocations."""
    told = [
        f"-I{HERE.parent / 'src' / 'loewner' / 'include'}",
        f"-L{library.HOME}",
        "-lloewner",
        "-Xlinker",
        "-rpath",
        "-Xlinker",
        str(library.HOME),
    ]
    program = tmp_path_factory.mktemp("counting") / "program"
    subprocess.run(
        ["cc", "-std=c11", "-Wall", "-Wextra", "-Werror", HERE / "capi_allocations.c", *told, "-o", program], check=True
    )
    return program


@needs_library
@pytest.mark.skipif(shutil.which("cc") is None or sys.platform != "linux", reason="it takes a C compiler and glibc")
@pytest.mark.parametrize(
    ("name", "count"),
    [
        *(("balls_near_a_box", 4), ("dense_surfaces", 20), ("thousands_of_pieces", 1), ("grazing", 20)),
        *(pytest.param(name, 20, marks=pytest.mark.verify) for name in ("balls_near_a_box", "thousands_of_pieces")),
    ],
)
def test_proofs_allocate_nothing(tmp_path, counting, name, count, rng):
    """After the first proof of a workspace, neither proofs nor those that are given up allocate memory."""
    checker, (a, b) = WORLDS[name]()
    checker.save(tmp_path / "cell.lwn")
    ends = b + 0.01 * rng.normal(size=(count, len(b)))
    np.tile(a, (count, 1)).tofile(tmp_path / "from")
    ends.tofile(tmp_path / "to")
    for most in (100, 0):
        asked = [counting, tmp_path / "cell.lwn", str(most), tmp_path / "from", tmp_path / "to"]
        counted, free = map(int, subprocess.run(asked, check=True, capture_output=True, text=True).stdout.split())
        assert counted == 0
        assert free == (checker.certify_edges(a, ends, steps=most or None).verdict == FREE).sum()
