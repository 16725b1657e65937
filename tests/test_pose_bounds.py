"""Bodies that are known by bounds only: what is proven holds wherever they are within these bounds."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PPoly
from scipy.spatial.transform import Rotation

from families import translation
from gantry import LEFT, gantry_robot
from loewner import (
    Body,
    CollisionChecker,
    InputError,
    PlanningError,
    Scene,
    Verdict,
    load_scene,
    planners,
    save_scene,
)  # fmt: skip
from sampling import examples, quick, quick_of
from test_bounded_work import carriage
from test_moving_bodies import moving_scene, turned

RADIUS = 0.1  # of the ball that slides along x and y
SAMPLES = 20
SEEDS = pytest.mark.parametrize("seed", quick_of(range(40), range(2)))


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """A ball that slides along x and y, and a rod that turns beside it."""
    return gantry_robot(tmp_path_factory.mktemp("gantry"))


def with_bounds(scene, rng, since=(-1.0, 3.0)):
    """The same scene with bounds on its motions: each body's own speed, turn and time since when they grow."""
    made = scene.copy()
    for name, path in scene.following.items():
        speed, turn = rng.uniform(0.0, 0.15, 2) * (rng.random(2) < 0.7)
        if speed or turn:
            made.follow(
                name, path.times, path.poses(path.times), repeat=path.repeat, speed=speed, turn=turn,
                since=rng.uniform(*since),
            )  # fmt: skip
    return made


def as_bad_as_allowed(checker, Q, t, rng, toward):
    """Poses of the bodies at a time that are as far off as their bounds allow; with `toward` nearest to the robot."""
    moved = {}
    near = checker.distance_by_pair(Q, t, within=1e3)
    for name, path in checker.scene.following.items():
        T, known = path.poses(t), checker.scene.bounds.get(name)
        if known is not None:
            lapse = abs(t - known.since)
            way, axis = rng.normal(size=(2, 3))
            rows = [k for k, names in enumerate(near.names) if name in names]
            if toward and rows:
                k = min(rows, key=lambda row: near.distance[row])
                way = -near.normal[k] if near.names[k][1] == name else near.normal[k]
                lever = near.witness_b[k] - T[:3, 3] if near.names[k][1] == name else near.witness_a[k] - T[:3, 3]
                axis = np.cross(lever, way) + 1e-9 * axis
            T = T.copy()
            turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * known.turn * lapse).as_matrix()
            T[:3, :3] = turn @ T[:3, :3]
            T[:3, 3] += way / np.linalg.norm(way) * known.speed * lapse
        moved[name] = T
    return moved


def contact_within_bounds(checker, at, times, rng):
    """Whether the robot, at configurations `at(times)`, meets bodies that are as badly placed as their bounds allow."""
    still = Scene(margin=checker.scene.margin)
    for name in checker.scene:
        still.add(name, checker.scene[name])
    same = CollisionChecker(checker.robot, still)
    for t in times:
        for toward in (True, False):
            still.move(as_bad_as_allowed(checker, at(t), float(t), rng, toward))
            if same.collide(at(t)):
                return True
    return False


# -- known answers ----------------------------------------------------------------------------


@pytest.mark.parametrize("lead", [-1e-4, 1e-4])
@pytest.mark.parametrize("since", [0.0, 1.0, 2.0, -3.0])
def test_a_person_at_rest_grows_with_their_speed(slider, since, lead):
    """The ball waits, and may be met exactly when the sum of both radii and of the growth is their distance."""
    speed, end = 1.6, 2.0
    growth = speed * max(abs(end - since), abs(since))
    scene = Scene()
    for k in range(6):  # more pairs than are tested before bounds about whole motions
        scene.add(f"far {k}", Body.sphere(0.1), translation(x=50.0 + k))
    scene.add("person", Body.sphere(0.3))
    scene.follow("person", [since], [translation(y=0.3 + RADIUS + growth + lead)], speed=speed)
    checker, q = CollisionChecker(slider, scene), np.array([0.0, 0.0, np.pi])
    wanted = Verdict.FREE if lead > 0 else Verdict.AMBIGUOUS
    found = checker.certify_edges(q, q, t0=0.0, t1=end)
    assert found.verdict == wanted
    assert checker.certify_trajectory(CubicSpline([0.0, end], [q, q])).verdict == wanted
    worst = 0.0 if abs(since) > abs(end - since) else end
    assert checker.collide(q, worst) == (lead < 0)
    assert checker.classify(q, worst) == wanted
    assert bool(checker.pairs(q, worst)) == (lead < 0)
    assert checker.collide_by_pair(q, worst).any() == (lead < 0)
    if lead < 0:
        assert "person" in found.names
        assert checker.collide(q, found.fraction * end)


def test_first_contact_is_where_a_body_may_be(slider):
    """Free until the person may be there, and in contact when they are, if they stay."""
    scene = Scene()
    scene.add("person", Body.sphere(0.3))
    scene.follow("person", [0.0], [translation(x=2.0)], speed=0.5)
    checker = CollisionChecker(slider, scene)
    curve = PPoly(np.array([[[0.5, 0.0, 0.0]], [[-0.2, -0.0, np.pi]]]), [0.0, 6.0])
    found = checker.first_contact(curve)
    apart = 2.0 + 0.2 - 0.3 - RADIUS
    assert found.free_until == pytest.approx(apart / (0.5 + 0.5), abs=1e-5)
    assert found.touching_at == pytest.approx(apart / 0.5, abs=1e-5)
    assert found.verdict == Verdict.COLLIDING
    near = 2.0 - 0.6 - 0.3 - RADIUS  # distances are those of the given poses
    assert checker.closest(PPoly(curve.c, [0.0, 1.6])).distance.min() == pytest.approx(near, abs=1e-4)


def test_collisions_behind_a_possible_one_are_found(slider):
    """A motion that may meet one body and does meet another one later is COLLIDING, as without bounds."""
    scene = Scene()
    scene.add("near", Body.sphere(0.1), translation(x=0.0, y=0.25), error=(0.1, 0.0))
    scene.add("wall", Body.box([0.1, 1, 1]), translation(x=1.0))
    scene.add("person", Body.sphere(0.1))
    scene.follow("person", [0.0], [translation(x=0.5, y=0.25)], speed=0.2)
    checker = CollisionChecker(slider, scene)
    a, b = np.array([-0.9, 0.0, np.pi]), np.array([0.97, 0.0, np.pi])
    found = checker.certify_edges(a, b, t0=0.0, t1=1.0)
    assert found.verdict == Verdict.COLLIDING
    assert "wall" in found.names
    scene.remove("wall")
    assert checker.certify_edges(a, b, t0=0.0, t1=1.0).verdict == Verdict.AMBIGUOUS
    scene.remove("person")
    assert checker.certify_edges(a, b).verdict == Verdict.AMBIGUOUS
    scene.move("near", translation(x=0.0, y=0.25))
    assert checker.certify_edges(a, b).verdict == Verdict.FREE


def test_an_error_counts_with_the_distance_from_the_origin(slider):
    """A rod that may be turned needs room at its ends; with the origin there, its other end needs twice as much."""
    scene, q = Scene(), np.array([0.0, 0.0, np.pi])
    scene.add("bar", Body.box([1.0, 0.02, 0.02]), translation(x=0.5 + RADIUS + 0.04), error=(0.01, 0.05))
    reach = np.hypot(0.5, 0.01 * np.sqrt(2))
    assert scene.bounds["bar"].reach == pytest.approx(reach, rel=1e-5)
    assert "reach=0.5" in repr(scene.bounds["bar"])
    assert "1 known by bounds" in repr(scene)
    assert scene.bounds["bar"].off(0.0) == pytest.approx(0.01 + 0.05 * reach, rel=1e-5)
    checker = CollisionChecker(slider, scene)
    for gap, wanted in ((0.034, Verdict.AMBIGUOUS), (0.037, Verdict.FREE)):
        scene.move("bar", translation(x=0.5 + RADIUS + gap), error=(0.01, 0.05))
        assert checker.classify(q) == wanted
        assert checker.collide(q) == (wanted != Verdict.FREE)
        assert checker.certify_edges(q, q + [0.0, 1e-6, 0.0]).verdict == wanted
        scene.replace("bar", Body.box([1.0, 0.02, 0.02]))
        assert checker.classify(q) == wanted
    scene.move("bar", translation(x=0.5 + RADIUS - 0.01), error=(0.01, 0.05))
    assert checker.certify_edges(q, q + [0.0, 1e-6, 0.0]).verdict == Verdict.COLLIDING


def test_scenes_add_up_both_errors():
    """Two bodies with bounds need both of them between them."""
    scene = Scene()
    scene.add("a", Body.sphere(0.1), error=(0.1, 0.0))
    scene.add("b", Body.sphere(0.1), translation(x=0.45), error=(0.1, 0.0))
    scene.add("c", Body.sphere(0.1), translation(x=0.8))
    assert not scene.collide()
    scene.follow("b", [0.0], [translation(x=0.45)], speed=1.0)
    assert not scene.collide(0.149)
    assert [(found.name_a, found.name_b) for found in scene.pairs(0.0501 + 0.1)] == [("a", "b"), ("b", "c")]


# -- laws -------------------------------------------------------------------------------------


@examples(15, 40)
@given(st.integers(0, 2**31))
def test_bounds_of_zero_change_nothing(slider, seed):
    """To the last bit: verdicts, fractions, pairs, and the work of the proof."""
    rng = np.random.default_rng(seed)
    scene = moving_scene(rng, 3)
    same = scene.copy()
    for name, path in scene.following.items():
        same.follow(name, path.times, path.poses(path.times), repeat=path.repeat, speed=0.0, turn=0.0, error=(0.0, 0.0))
    a, b = rng.uniform(-1, 1, (2, 12, 3)) * [1, 1, 3]
    t0 = rng.uniform(-1, 4, 12)
    t1 = t0 + rng.uniform(0, 2, 12)
    found, wanted = (CollisionChecker(slider, one).certify_edges(a, b, t0=t0, t1=t1) for one in (same, scene))
    for name in ("verdict", "fraction", "names", "poses", "searches"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


@SEEDS
def test_wider_bounds_free_less_and_collide_alike(slider, seed):
    """FREE is monotone in every bound, and COLLIDING does not depend on bounds."""
    rng = np.random.default_rng(seed)
    scene = moving_scene(rng, 3)
    a, b = rng.uniform(-1, 1, (2, 16, 3)) * [1, 1, 3]
    t0 = rng.uniform(-1, 4, 16)
    t1 = t0 + rng.uniform(0, 2, 16)
    before = CollisionChecker(slider, scene).certify_edges(a, b, t0=t0, t1=t1).verdict
    collides = before == Verdict.COLLIDING
    for wider in (1e-3, 0.03, 0.3):
        for name, path in scene.following.items():
            scene.follow(
                name, path.times, path.poses(path.times), repeat=path.repeat, speed=wider, turn=wider, since=1.0
            )
        found = CollisionChecker(slider, scene).certify_edges(a, b, t0=t0, t1=t1).verdict
        assert not ((found == Verdict.FREE) & (before != Verdict.FREE)).any()
        np.testing.assert_array_equal(found == Verdict.COLLIDING, collides)
        before = found


@SEEDS
def test_free_holds_for_bodies_as_badly_placed_as_allowed(slider, seed):
    """At dense samples, with bodies as near to the robot as their bounds allow, and at random within them."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(slider, with_bounds(moving_scene(rng, 2), rng))
    a, b = rng.uniform(-1, 1, (2, 8, 3)) * [1, 1, 3]
    t0 = rng.uniform(-1, 4, 8)
    t1 = t0 + rng.uniform(0, 2, 8)
    found = checker.certify_edges(a, b, t0=t0, t1=t1)
    for k in np.flatnonzero(found.verdict == Verdict.FREE)[:3]:

        def at(t, k=k):
            return slider.between(a[k], b[k], float(np.clip((t - t0[k]) / (t1[k] - t0[k]), 0, 1)))

        assert not contact_within_bounds(checker, at, np.linspace(t0[k], t1[k], SAMPLES), rng)


@pytest.mark.parametrize("count", quick(300, 1000))
def test_a_free_motion_is_free_of_a_thousand_places(slider, count):
    """Places at random within the bounds, at random times, of bodies beside which only FREE motions are left."""
    rng = np.random.default_rng(11)
    checker = CollisionChecker(slider, with_bounds(moving_scene(rng, 3), rng))
    a, b = rng.uniform(-1, 1, (2, 300, 3)) * [1, 1, 3]
    t0, t1 = rng.uniform([[-0.5], [0.5]], [[0.5], [2.0]], (2, 300))
    free = np.flatnonzero(checker.certify_edges(a, b, t0=t0, t1=t1).verdict == Verdict.FREE)
    still = Scene()
    for name in checker.scene:
        still.add(name, checker.scene[name])
    same, hits = CollisionChecker(slider, still), 0
    for _ in range(count):
        k, f = rng.choice(free), rng.random()
        t = t0[k] + f * (t1[k] - t0[k])
        for name, path in checker.scene.following.items():
            T, known = path.poses(t), checker.scene.bounds.get(name)
            if known is not None:
                way, axis = rng.normal(size=(2, 3))
                lapse = abs(t - known.since) * rng.random() ** 0.2
                turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * known.turn * lapse).as_matrix()
                T[:3, :3] = turn @ T[:3, :3]
                T[:3, 3] += way / np.linalg.norm(way) * known.speed * lapse
            still.move(name, T)
        hits += same.collide(slider.between(a[k], b[k], f))
    assert len(free) > 20
    assert hits == 0


@SEEDS
def test_a_curve_is_free_until_first_contact_within_bounds(slider, seed):
    """Curves likewise, up to the time until which they are proven free."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(slider, with_bounds(moving_scene(rng, 2), rng))
    curve = PPoly(rng.normal(size=(4, 1, 3)) * 0.3, [0.0, 1.5])
    free = checker.first_contact(curve).free_until
    assert (free == np.inf) == (checker.certify_trajectory(curve).verdict == Verdict.FREE)
    times = np.linspace(0.0, min(1.5, free), SAMPLES)[:-1]
    assert not contact_within_bounds(checker, curve, times[times < free], rng)


@examples(15, 40)
@given(st.integers(0, 2**31), st.booleans())
def test_proofs_are_as_sharp_as_the_bounds(slider, seed, back):
    """Two balls are FREE exactly where the growth of one leaves a gap, up to the tolerance; also on a way and back."""
    rng = np.random.default_rng(seed)
    speed, since, room, height = rng.uniform([0.05, -1.0, 0.01, 0.0], [1.0, 2.0, 0.2, 1.0])
    a, b, c = rng.uniform(-1, 1, (3, 3)) * [1, 1, 0] + [0, 0, np.pi]
    rise = np.zeros(3)
    if back:  # along one line, nearest in the middle
        way = (a - c) / np.linalg.norm(a - c)
        rise, a, b = way * rng.uniform(0.0, 3.0), a, a + way * rng.uniform(0.0, 1.0)
    curve = PPoly(np.stack([rise, b - a - rise, a])[:, None], [0.0, 1.0])
    t = np.linspace(0.0, 1.0, 20001)
    apart = np.hypot(np.linalg.norm((curve(t) - c)[:, :2], axis=1), height)
    least = (apart - speed * np.abs(t - since) - RADIUS - room).min()
    scene, T = Scene(), translation(x=c[0], y=c[1])
    T[2, 3] = height
    scene.add("other", Body.sphere(room))
    scene.allow("other", "rod")
    scene.follow("other", [since], [T], speed=speed)
    checker = CollisionChecker(slider, scene)
    found = [checker.certify_trajectory(curve, tolerance=1e-6)]
    if not back:
        found.append(checker.certify_edges(a, b, t0=0.0, t1=1.0, tolerance=1e-6))
    if abs(least) > 1e-5:
        assert all((one.verdict == Verdict.FREE) == (least > 0) for one in found)


@pytest.mark.parametrize("speed", [0.528, 0.531])
def test_a_plane_that_holds_later_is_not_enough_in_the_middle(slider, speed):
    """The ball comes near and goes back on one line as the body grows: the gap ends shortly, between tested times."""
    scene = Scene()
    scene.add("other", Body.sphere(0.1))
    scene.allow("other", "rod")
    scene.follow("other", [0.0], [translation(x=-0.5)], speed=speed)
    curve = PPoly(np.array([[[2.0, 0.0, 0.0]], [[-2.0, 0.0, 0.0]], [[0.5, 0.0, np.pi]]]), [0.0, 1.0])
    t = np.linspace(0.0, 1.0, 10001)
    least = (curve(t)[:, 0] + 0.5 - 0.1 - RADIUS - speed * t).min()
    assert (least < 0) == (speed > 0.53)
    found = CollisionChecker(slider, scene).certify_trajectory(curve).verdict
    assert found == (Verdict.FREE if least > 0 else Verdict.AMBIGUOUS)


@pytest.mark.parametrize("lead", [-1e-5, 1e-5])
def test_a_plane_that_turns_with_a_link_keeps_the_growth(lead):
    """A plate turns about an axis beside a ball that grows; they come nearest within a quarter of a tested interval."""
    radius, lever, rate, speed, nearest = 0.02, 0.05, 6.0, 0.01, 13.25 / 28.0
    aligned, t = nearest - speed / (lever * rate**2), np.linspace(0.0, 1.0, 20001)
    left = -radius - lever * np.cos(rate * (t - aligned)) - speed * t
    offset = lead - left.min()
    assert abs(t[left.argmin()] - nearest) < 1e-3
    assert (left + offset < 0).mean() < 0.01
    robot = carriage(Body.box([0.02, 2.0, 0.5]).transformed(translation(x=offset + 0.01)))
    scene = Scene()
    scene.add("ball", Body.sphere(radius))
    scene.follow("ball", [0.0], [translation(x=lever)], speed=speed)
    a, b = np.zeros((2, robot.dof))
    a[3], b[3] = -rate * aligned, rate * (1.0 - aligned)
    found = CollisionChecker(robot, scene).certify_edges(a, b, t0=0.0, t1=1.0, tolerance=1e-7)
    assert found.verdict == (Verdict.FREE if lead > 0 else Verdict.AMBIGUOUS)


@SEEDS
@pytest.mark.parametrize("solid", [False, True])
def test_surfaces_grow_like_hulls(slider, seed, solid):
    """The triangles of a box, of itself or around its inside, have the verdicts of the box, and so do many boxes."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-1, 1, (2, 12, 3)) * [1, 1, 3]
    t1 = rng.uniform(0.0, 1.0, 12)
    found, scenes = [], [Scene(), Scene(), Scene()]
    for k in range(2):
        mesh, T = trimesh.creation.box(rng.uniform(0.1, 0.5, 3)), turned(rng, 1, 0.6)[0]
        speed, turn, since = rng.uniform([0.0, 0.0, -0.5], [0.4, 0.4, 1.0])
        halves = [mesh.vertices * [0.5, 1, 1] + [side * mesh.extents[0] / 4, 0, 0] for side in (-1, 1)]
        bodies = (
            Body.from_points(mesh.vertices),
            Body.from_surface(mesh, solid=solid),
            Body.union([Body.from_points(half) for half in halves]),
        )
        for scene, body in zip(scenes, bodies, strict=True):
            scene.add(f"body {k}", body)
            scene.follow(f"body {k}", [since], [T], speed=speed, turn=turn)
    for scene in scenes:
        found.append(CollisionChecker(slider, scene).certify_edges(a, b, t0=np.zeros(12), t1=t1, tolerance=1e-6))
    for other in found[1:]:
        alike = other.verdict == found[0].verdict
        if not solid and other is found[1]:  # inside there is nothing to collide with
            alike |= found[0].verdict == Verdict.COLLIDING
        assert alike.all()


# -- elsewhere --------------------------------------------------------------------------------


def test_plans_keep_away_from_where_a_body_may_be(slider):
    """A plan in time is free for the worst person; a body that grows beside the start refuses it."""
    rng = np.random.default_rng(5)
    scene = Scene()
    scene.add("person", Body.sphere(0.2))
    scene.follow("person", [0.0], [translation(x=0.0, y=0.9)], speed=0.1)
    checker = CollisionChecker(slider, scene)
    start, goal = np.array([-0.8, -0.3, np.pi]), np.array([0.8, -0.3, np.pi])
    found = planners.plan(checker, start, goal, start_time=0.0, velocity=1.0)
    assert checker.certify_trajectory(found).verdict == Verdict.FREE
    assert not contact_within_bounds(
        checker, lambda t: found.positions(t), np.linspace(0, found.duration, SAMPLES), rng
    )
    scene.follow("person", [-30.0], [translation(x=0.0, y=0.9)], speed=0.1)
    with pytest.raises(PlanningError, match="start"):
        planners.plan(checker, start, goal, start_time=0.0, velocity=1.0)


def test_bounds_are_saved_with_scenes(tmp_path):
    """A scene file keeps the bounds; a new motion or pose without them drops them."""
    scene = Scene()
    scene.add("crate", Body.box([0.6, 0.8, 0.2]), translation(x=1.0), error=(0.01, 0.1))
    scene.add("person", Body.capsule(0.3, 1.2))
    scene.follow("person", [2.0], [translation(x=2.0)], speed=1.6, turn=0.5, since=2.5, error=(0.02, 0.0))
    save_scene(scene, tmp_path / "scene.yaml")
    again = load_scene(tmp_path / "scene.yaml")
    assert again.bounds == scene.bounds
    assert scene.copy().bounds == scene.bounds
    scene.move("crate", translation(x=1.0))
    scene.follow("person", [0.0, 1.0], [np.eye(4)] * 2)
    assert scene.bounds == {}
    again.attach("crate", "hand")
    again.detach("person", np.eye(4))
    assert again.bounds == {}


def test_proofs_hold_for_errors_and_are_refused_for_motions(slider):
    """A written proof of a scene with errors has the larger margins; there is none about bodies in time."""
    scene = Scene()
    scene.add("box", Body.box([0.1, 0.1, 0.1]), translation(x=0.4), error=(0.05, 0.0))
    checker = CollisionChecker(slider, scene)
    a, b = np.array([0.0, -0.2, np.pi]), np.array([0.0, 0.2, np.pi])
    found = checker.certify_edges(a, b, proof=True)
    assert found.proof is not None
    scene.follow("box", [0.0], [translation(x=0.4)], speed=0.01)
    with pytest.raises(InputError, match="motions"):
        checker.certify_edges(a, b, t0=0.0, t1=1.0, proof=True)


def test_contact_rules_need_known_poses(slider):
    """Which contact may be left is not defined for a body whose pose is known by bounds only."""
    scene = Scene()
    scene.add("box", Body.box([0.1, 0.1, 0.1]), translation(x=0.14), error=(0.05, 0.0))
    scene.leave("ball", "box")
    with pytest.raises(InputError, match="expected bodies at known poses, found 'box'"):
        CollisionChecker(slider, scene).certify_edges(LEFT, LEFT)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": -1.0}, "speed: expected a finite number >= 0"),
        ({"speed": np.nan}, "speed"),
        ({"turn": -0.1}, "turn"),
        ({"turn": np.inf}, "turn"),
        ({"speed": "fast"}, "speed"),
        ({"speed": 1.0, "since": np.nan}, "since"),
        ({"since": 1.0}, "since: expected speed or turn with it"),
        ({"error": (0.1, -0.1)}, "error: expected metres and radians >= 0, found 0.1 and -0.1"),
        ({"error": 0.1}, "error"),
        ({"error": (0.1, np.nan)}, "error"),
    ],
)
def test_wrong_bounds_change_nothing(options, message):
    """Each is refused by name, and the body stays as it was."""
    scene = Scene()
    scene.add("body", Body.sphere(0.1), error=(0.01, 0.0))
    version, bounds = scene.version, scene.bounds
    with pytest.raises(InputError, match=message):
        scene.follow("body", [0.0, 1.0], [np.eye(4)] * 2, **options)
    if "error" in options:
        for change in (
            lambda: scene.move("body", np.eye(4), **options),
            lambda: scene.move_all(["body"], [np.eye(4)], **options),
            lambda: scene.add("other", Body.sphere(0.1), **options),
        ):
            with pytest.raises(InputError, match="error"):
                change()
    assert (scene.version, scene.bounds) == (version, bounds)
    assert scene.static_names == ("body",)


def test_distances_and_clearances_hold_for_all_poses(slider):
    """Bounds on distances hold for each pose within the errors, and the exact distance is that of the given pose."""
    rng = np.random.default_rng(7)
    scene, exact = Scene(), Scene()
    errors = {"a": (0.02, 0.3), "b": (0.1, 0.0), "c": (0.0, 0.0)}
    for name, error in errors.items():
        body, T = Body.box(rng.uniform(0.1, 0.4, 3)), translation(*rng.uniform(-1, 1, 2))
        scene.add(name, body, T, error=error)
        exact.add(name, body, T)
    checker, same = CollisionChecker(slider, scene), CollisionChecker(slider, exact)
    Q = rng.uniform(-1, 1, (30, 3))
    found, given_pose = checker.distance(Q, exact=True), same.distance(Q, exact=True)
    np.testing.assert_array_equal(found.distance, given_pose.distance)
    clearance, slopes = checker.clearance(Q, gradient=True)
    assert (clearance < same.clearance(Q)).any()
    step = 1e-6 * rng.normal(size=Q.shape)
    change = checker.clearance(Q + step) - checker.clearance(Q - step)
    np.testing.assert_allclose(2 * (slopes * step).sum(axis=1), change, atol=1e-9)
    for _ in range(20):
        for name, (metres, radians) in errors.items():
            way, axis = rng.normal(size=(2, 3))
            T = scene.pose(name)
            turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * radians).as_matrix()
            T[:3, :3] = turn @ T[:3, :3]
            T[:3, 3] += way / np.linalg.norm(way) * metres
            exact.move(name, T)
        moved = same.distance(Q, exact=True).distance
        assert (found.lower <= moved).all()
        assert (moved <= found.upper).all()
        assert (clearance <= moved).all()
