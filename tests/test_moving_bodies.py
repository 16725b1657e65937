"""Bodies that follow motions in time: what is proven against them holds at every instant."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PPoly
from scipy.spatial.transform import Rotation

from families import translation
from gantry import LEFT, gantry_robot
from loewner import (
    Body,
    CollisionChecker,
    FileError,
    InputError,
    PoseError,
    Robot,
    Scene,
    UnknownNameError,
    Verdict,
    load_scene,
    save_scene,
)  # fmt: skip
from loewner.queries.pose_paths import PackedPaths, PosePath, path_of
from loewner.robots.proofs import in_time
from loewner.robots.proofs.courses import parts
from motion_oracle import AFLOAT
from sampling import examples, quick_of

SAMPLES = 400


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """A ball that slides along x and y, and a rod that turns beside it."""
    return gantry_robot(tmp_path_factory.mktemp("gantry"))


def turned(rng, count, near=0.3):
    """Poses about the origin with turns between them of any size below half a turn."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = rng.normal(size=(count, 3)) * near
    turn = Rotation.random(random_state=int(rng.integers(1 << 30)))
    for row in T:
        step = rng.normal(size=3)
        turn = turn * Rotation.from_rotvec(step / np.linalg.norm(step) * rng.uniform(0, 3.0))
        row[:3, :3] = turn.as_matrix()
    return T


def moving_scene(rng, bodies, **options):
    """Boxes that follow motions near the origin, every other one of them again and again."""
    scene = Scene(**options)
    for k in range(bodies):
        scene.add(f"body {k}", Body.box(rng.uniform(0.05, 0.3, 3) * [3, 1, 1]))
        count, repeat = int(rng.integers(2, 5)), bool(k % 2)
        T = turned(rng, count)
        if repeat:
            T = np.concatenate([T, T[::-1]])
        times = np.cumsum(rng.uniform(0.05, 0.8, len(T))) - 0.5
        scene.follow(f"body {k}", times, T, repeat=repeat)
    return scene


def sampled(checker, curve, times):
    return checker.collide(curve(times), times)


# -- known answers ----------------------------------------------------------------------------


@pytest.mark.parametrize("lead", [-1e-4, 1e-4])
def test_passing_behind_a_ball_is_a_matter_of_time(slider, lead):
    """Both balls go at 1 m/s, at right angles; they come nearest, by √2/2 of their difference, at one instant."""
    scene = Scene()
    scene.add("other", Body.sphere(0.1))
    late = 0.2 * np.sqrt(2) + lead  # [s]
    scene.follow("other", [late, 2.0 + late], [translation(y=-1.5), translation(y=0.5)])
    checker = CollisionChecker(slider, scene)
    a, b = np.array([-1.0, -0.5, 0.0]), np.array([1.0, -0.5, 0.0])  # the rod in front
    found = checker.certify_edges(a, b, t0=0.0, t1=2.0)
    assert found.verdict == (Verdict.FREE if lead > 0 else Verdict.COLLIDING)
    curve = PPoly(np.stack([(b - a) / 2, a])[:, None], [0.0, 2.0])
    assert checker.certify_trajectory(curve).verdict == found.verdict
    if lead < 0:
        q, t = slider.between(a, b, found.fraction), 2.0 * found.fraction
        assert checker.collide(q, t)
        assert abs(t - (1.0 + late / 2)) < 0.02


def test_a_turning_rod_is_seen_between_its_poses(slider):
    """At both ends the rod is clear of the ball; it sweeps across it in between."""
    scene = Scene()
    scene.add("bar", Body.box([2.0, 0.02, 0.02]))
    spin = np.tile(translation(x=-0.5, y=0.4), (2, 1, 1))
    for T, angle in zip(spin, (-0.2, -2.9), strict=True):
        T[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    scene.follow("bar", [0.0, 1.0], spin)
    checker = CollisionChecker(slider, scene)
    q = LEFT
    assert not checker.collide(q, [0.0, 1.0]).any()
    assert checker.collide(q, 0.5)
    assert checker.certify_edges(q, q, t0=0.0, t1=1.0).verdict == Verdict.COLLIDING
    assert checker.certify_edges(q, q, t0=0.0, t1=0.2).verdict == Verdict.FREE
    assert checker.certify_edges(q, q, t0=1.0, t1=9.0).verdict == Verdict.FREE  # it waits where it ends
    many = checker.certify_edges(q, [q, q], t0=[[0.0], [1.0], [1.0]], t1=[1.0, 9.0])
    assert many.verdict.tolist() == [[Verdict.COLLIDING] * 2, [Verdict.FREE] * 2, [Verdict.FREE] * 2]
    waits = CubicSpline([0.0, 1.0], [q, q])
    assert checker.certify_trajectory(waits).verdict == Verdict.COLLIDING


def test_a_motion_repeats(slider):
    """At any repetition, long ago or far ahead, contact is found and time without it is proven."""
    scene = Scene()
    scene.add("other", Body.sphere(0.1))
    scene.follow("other", [0.0, 1.0, 2.0], [translation(y=1.0), translation(y=0.0), translation(y=1.0)], repeat=True)
    checker = CollisionChecker(slider, scene)
    q = np.array([0.0, 0.0, np.pi])
    for k in (-1000, -1, 0, 7, 12345):
        assert checker.collide(q, 2 * k + 1.0)
        assert not checker.collide(q, 2.0 * k)
        near = 2 * k + 0.8
        assert checker.certify_edges(q, q, t0=near - 0.39, t1=near - 1e-5).verdict == Verdict.FREE
        assert checker.certify_edges(q, q, t0=near - 0.39, t1=near + 1e-5).verdict == Verdict.COLLIDING
    assert checker.certify_edges(q, q, t0=0.0, t1=100.0).verdict == Verdict.COLLIDING


# -- laws -------------------------------------------------------------------------------------


@examples(16, 40)
@given(st.integers(0, 2**31), st.booleans())
def test_no_free_motion_is_refuted_by_samples(slider, seed, far):
    """Nor at large times; collisions are confirmed at the time that a user computes."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(slider, moving_scene(rng, 3))
    N, shift = 12, 1e5 * far
    a, b = rng.uniform(-1, 1, (2, N, 3)) * [1, 1, 3]
    if far:  # repeated motions only
        for name, path in checker.scene.following.items():
            if not path.repeat:
                checker.scene.remove(name)
    t0 = rng.uniform(-1, 4, N) + shift
    t1 = t0 + rng.uniform(0, 2, N) * (rng.random(N) > 0.1)
    found = checker.certify_edges(a, b, t0=t0, t1=t1)
    f = np.linspace(0, 1, SAMPLES)
    for k in range(N):
        Q, t = slider.between(a[k], b[k], f), t0[k] + f * (t1[k] - t0[k])
        if found.verdict[k] == Verdict.FREE:
            assert not checker.collide(Q, t).any()
        elif found.verdict[k] == Verdict.COLLIDING:
            at = found.fraction[k]
            assert checker.collide(slider.between(a[k], b[k], at), t0[k] + at * (t1[k] - t0[k]))


@examples(16, 40)
@given(st.integers(0, 2**31), st.sampled_from([1, 2, 3, 5, 7]))
def test_no_free_curve_is_refuted_by_samples(slider, seed, degree):
    """Polynomials of every degree, and until `first` at least."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(slider, moving_scene(rng, 3))
    coefficients = rng.normal(size=(degree + 1, 1, 3)) * 0.3
    curve = PPoly(coefficients, [0.0, 1.5])
    found = checker.certify_trajectory(curve)
    t = np.linspace(0, 1.5, SAMPLES)
    hit = sampled(checker, curve, t)
    if found.verdict == Verdict.FREE:
        assert not hit.any()
        assert found.first == np.inf
    else:
        assert not hit[t < found.first].any()
        assert found.first <= found.time


def test_bodies_are_where_their_motions_say(slider, rng):
    """At any time a scene in which the bodies stand where they are then has the same answers."""
    scene, still = moving_scene(rng, 4, margin=0.01), Scene(margin=0.01)
    for name in scene:
        still.add(name, scene[name])
    checker, same = CollisionChecker(slider, scene), CollisionChecker(slider, still)
    Q = rng.uniform(-1, 1, (40, 3))
    hits = 0
    for t in rng.uniform(-2, 6, 25):
        still.move({name: path.poses(t) for name, path in scene.following.items()})
        expected = same.collide(Q)
        np.testing.assert_array_equal(checker.collide(Q, t), expected)
        np.testing.assert_array_equal(checker.classify(Q, t), same.classify(Q))
        found, wanted = (
            {(contact.name_a, contact.name_b): contact.distance for contact in pairs}
            for pairs in (checker.pairs(Q[0], t), same.pairs(Q[0]))
        )
        assert found == pytest.approx(wanted, abs=1e-9)
        found, wanted = checker.distance(Q, t, exact=True, gradient=True), same.distance(Q, exact=True, gradient=True)
        np.testing.assert_allclose(found.distance, wanted.distance, atol=1e-9)
        assert found.gradient.shape == (40, 3)
        hits += expected.sum()
    assert 15 < hits < 950


def test_no_motions_and_no_configurations(slider, rng):
    """Empty batches have empty answers."""
    checker = CollisionChecker(slider, moving_scene(rng, 2))
    none = np.empty((0, 3))
    assert checker.collide(none, 1.0).shape == (0,)
    assert checker.collide(none, np.empty(0)).shape == (0,)
    assert checker.certify_edges(none, none, t0=0.0, t1=1.0).verdict.shape == (0,)


def test_a_robot_with_quaternions_among_moving_bodies(rng):
    """Its own orientations turn at a constant rate as well, and are cut where bodies change their rates."""
    robot = Robot.from_urdf(text=AFLOAT).with_body("bar", Body.box([1.0, 0.05, 0.05]), parent="hand", joint="fixed")
    checker = CollisionChecker(robot, moving_scene(rng, 3))
    a, b = robot.random_configurations(2 * 40, seed=1).reshape(2, 40, -1)
    a[:, :3] *= 0.2
    b[:, :3] *= 0.2
    found = checker.certify_edges(a, b, t0=0.0, t1=1.0)
    f = np.linspace(0, 1, SAMPLES)
    seen = {Verdict.FREE: 0, Verdict.COLLIDING: 0}
    for k in range(40):
        hit = checker.collide(robot.between(a[k], b[k], f), f)
        assert not (found.verdict[k] == Verdict.FREE and hit.any())
        if found.verdict[k] == Verdict.COLLIDING:
            assert checker.collide(robot.between(a[k], b[k], found.fraction[k]), found.fraction[k])
        seen[Verdict(found.verdict[k])] += 1
    assert min(seen.values()) >= 3


def test_a_piece_that_is_not_cut_is_the_motion_of_a_joined_robot(slider, rng):
    """A body that moves straight is the same as a link on a floating joint of `Robot.with_body`."""
    box = Body.box([0.2, 0.1, 0.3])
    T = turned(rng, 2)
    scene = Scene()
    scene.add("box", box)
    scene.follow("box", [0.0, 1.0], T)
    joined = CollisionChecker(slider.with_body("box", box))
    values = PackedPaths.of((scene.following["box"],)).values(np.array([0.0, 1.0]))[:, 0]
    a, b = rng.uniform(-1, 1, (2, 300, 3))
    found = CollisionChecker(slider, scene).certify_edges(a, b, t0=0.0, t1=1.0)
    ends = [np.concatenate([Q, np.tile(value, (300, 1))], axis=1) for Q, value in zip((a, b), values, strict=True)]
    np.testing.assert_array_equal(found.verdict, joined.certify_edges(*ends).verdict)
    assert 20 < (found.verdict == Verdict.FREE).sum() < 280


# -- bounds, and what would be wrong without them ---------------------------------------------


def slerp(path, t):
    """Values of a motion in higher precision."""
    k = int(np.clip(np.searchsorted(path.times, t, side="right") - 1, 0, len(path.times) - 2))
    s = np.longdouble(t - path.times[k]) / np.longdouble(path.times[k + 1] - path.times[k])
    s = min(max(s, np.longdouble(0)), np.longdouble(1))
    p, q = (path.quaternions[n].astype(np.longdouble) for n in (k, k + 1))
    p, q = p / np.sqrt((p * p).sum()), q / np.sqrt((q * q).sum())
    arc = 2 * np.arcsin(np.sqrt(((p - q) ** 2).sum()) / 2)
    mixed = (1 - s) * p + s * q if arc < 1e-9 else (np.sin((1 - s) * arc) * p + np.sin(s * arc) * q) / np.sin(arc)
    x = (1 - s) * path.positions[k].astype(np.longdouble) + s * path.positions[k + 1]
    return np.concatenate([x, mixed])


@pytest.mark.parametrize("points", [2, 4, 6, 8])
@pytest.mark.parametrize("seed", range(3))
def test_courses_of_bodies_stay_within_their_bounds(points, seed, monkeypatch):
    """Positions and turns of each piece, against higher precision; with a smaller bound on arcs they do not."""
    rng = np.random.default_rng(seed)
    path = path_of(np.cumsum(rng.uniform(0.1, 1, 4)), turned(rng, 4, 100.0), False)
    packed, robot = PackedPaths.of((path,)), Robot.from_urdf(text='<robot name="none"><link name="a"/></robot>')
    t0, t1 = np.array([path.times[0] + 0.01]), np.array([path.times[-1] + 0.5])

    def worst():
        cut = in_time.pieces(robot, packed, np.zeros((1, points, 0)), np.zeros((1, 0)), t0, t1)
        assert len(cut.owner) >= 4
        share = 0.0
        for k in range(0, len(cut.owner), max(1, len(cut.owner) // 25)):
            for f in rng.uniform(0, 1, 5):
                weights = [1 - f, f]
                for _ in range(points - 2):
                    weights = np.convolve(weights, [1 - f, f])
                value = np.asarray(weights) @ cut.courses[k]
                t = float(cut.times[k, 0] + f * (cut.times[k, 1] - cut.times[k, 0]))
                if points == 2:
                    value = in_time_slerp(cut.courses[k], f)
                real = slerp(path, t)
                wrong = np.abs(value[:3] - real[:3]).max() / cut.off[k, 0]
                turn = np.linalg.norm(value[3:] / np.linalg.norm(value[3:]) * np.sign(value[3:] @ real[3:]) - real[3:])
                share = max(share, float(wrong), float(turn / (2 * cut.off[k, 3])))
        return share

    assert worst() <= 1.0
    if points > 2:
        monkeypatch.setattr(in_time, "ARC_ERROR", 1e-4 * in_time.ARC_ERROR)
        assert worst() > 1.0


def in_time_slerp(course, f):
    """A course of degree 1, in higher precision."""
    path = PosePath(np.array([0.0, 1.0]), course[:, :3], course[:, 3:], False)
    return slerp(path, f).astype(np.float64)


def test_parts_of_courses_are_exact_but_for_rounding(rng):
    """De Casteljau in fractions."""
    courses = rng.normal(size=(5, 6, 2))
    low, high = np.sort(rng.uniform(0, 1, (2, 5)), axis=0)
    found = parts(courses, low, high)
    for k in range(5):
        for column in range(2):
            points = [Fraction(float(x)) for x in courses[k, :, column]]
            for n in range(6):
                row = points
                for step in range(5):
                    t = Fraction(float((high if step < n else low)[k]))
                    row = [(1 - t) * a + t * b for a, b in zip(row[:-1], row[1:], strict=True)]
                error = abs(Fraction(float(found[k, n, column])) - row[0])
                assert error <= Fraction(in_time.CURVE_ROUNDINGS) * max(abs(x) for x in points)


def refuted(slider):
    """How many motions beside moving bodies count as free and collide at a sample."""
    wrong, rng = 0, np.random.default_rng(5)
    scene = Scene()
    scene.add("bar", Body.box([2.0, 0.02, 0.02]))
    spin = np.tile(translation(x=-0.5, y=0.4), (2, 1, 1))
    for T, angle in zip(spin, (-0.2, -2.9), strict=True):
        T[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    scene.follow("bar", [0.0, 2.0], spin)
    f = np.linspace(0, 1, 60)
    checker = CollisionChecker(slider, scene)
    if checker.certify_edges(LEFT, LEFT, t0=0.0, t1=2.0).verdict == Verdict.FREE:
        wrong += checker.collide(LEFT, 2.0 * f).any()
    for _ in range(8):
        checker = CollisionChecker(slider, moving_scene(rng, 3))
        a, b = rng.uniform(-1, 1, (2, 30, 3))
        found = checker.certify_edges(a, b, t0=1.0, t1=2.0)
        for k in np.flatnonzero(found.verdict == Verdict.FREE):
            wrong += checker.collide(slider.between(a[k], b[k], f), 1.0 + f).any()
    return wrong


@pytest.fixture(scope="module")
def not_refuted(slider):
    """The number of them with the proof as it is."""
    return refuted(slider)


@pytest.mark.parametrize("mutant", ["the body waits", "the body does not turn", "its time is another"])
def test_mutants_are_caught(slider, not_refuted, mutant, monkeypatch):
    """What the proof takes of a moving body is needed: without any one part, motions that collide count as free."""
    made, cut = in_time._write_courses, in_time.pieces
    assert not_refuted == 0

    def wrong_courses(a, b, out):
        b = a.copy() if mutant == "the body waits" else b
        if mutant == "the body does not turn":
            b = np.concatenate([b[..., :3], a[..., 3:]], axis=-1)
        return made(a, b, out)

    def wrong_pieces(robot, paths, courses, off, t0, t1):
        return cut(robot, paths, courses, off, 0.98 * t0, 0.98 * t1)

    monkeypatch.setattr(in_time, "_write_courses", wrong_courses)
    if mutant == "its time is another":
        monkeypatch.setattr(in_time, "pieces", wrong_pieces)
    assert refuted(slider) > 0


def test_a_motion_that_is_closed_turns_as_its_poses_say():
    """Its last pose is set to its first one, which is up to 1e-6 rad away; rates belong to what is stored."""
    T = np.tile(np.eye(4), (4, 1, 1))
    for row, angle in zip(T, (0.0, 1.0, 3.0, -9.5e-7), strict=True):
        row[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
    path = path_of(np.arange(4.0), T, True)
    chords = np.linalg.norm(np.diff(path.quaternions, axis=0), axis=1)
    np.testing.assert_allclose(path.arcs, 2 * np.arcsin(chords / 2), rtol=1e-15)
    for t in (2.25, 2.5, 2.9):
        np.testing.assert_allclose(
            slerp(path, t)[3:].astype(float), PackedPaths.of((path,)).values(np.array([t]))[0, 0, 3:], atol=1e-14
        )


def test_knots_are_listed_where_motions_are(slider):
    """Two short motions long after each other are answered together as they are alone."""
    scene = Scene()
    scene.add("a", Body.sphere(0.1))
    scene.follow("a", [0.0, 0.1, 0.2], [translation(x=5.0), translation(x=6.0), translation(x=5.0)], repeat=True)
    checker = CollisionChecker(slider, scene)
    t0 = np.array([1e6, 0.0, 0.5, 3.0])
    found = checker.certify_edges(np.tile(LEFT, (4, 1)), LEFT, t0=t0, t1=t0 + 1.0)
    assert (found.verdict == Verdict.FREE).all()


@pytest.mark.parametrize("gap", [3e-6, 1e-4])
def test_a_body_that_turns_near_a_plate_is_free(slider, gap):
    """It passes the ball at a constant distance above the tolerance: turns are approximated finely enough."""
    scene = Scene()
    scene.add("plate", Body.cylinder(40.0, 0.2).transformed(translation(z=-0.1)))
    spin = np.tile(translation(x=-0.5, y=-0.5, z=-0.1 - gap), (5, 1, 1))
    spin[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 5)[:, None] * [0, 0, 1.0]).as_matrix()
    scene.follow("plate", np.arange(5.0), spin, repeat=True)
    found = CollisionChecker(slider, scene).first_contact(CubicSpline([0.0, 1.0], [LEFT, LEFT]))
    assert (found.verdict, found.free_until) == (Verdict.FREE, np.inf)


# -- scenes -----------------------------------------------------------------------------------


def test_a_body_follows_and_stops(slider):
    """It leaves the bodies that stand, and comes back by detach, attach or remove."""
    scene = Scene()
    scene.add("a", Body.sphere(0.1), translation(x=0.5))
    scene.add("b", Body.sphere(0.1), translation(x=0.5))
    assert scene.collide()
    scene.follow("a", [0.0, 1.0], [translation(), translation(x=1.0)])
    assert scene.static_names == ("b",)
    for time, touch in ((0.0, False), (0.29, False), (0.31, True), (0.69, True), (0.71, False), (9.0, False)):
        assert scene.collide(time) == touch == bool(scene.pairs(time))
    assert scene.static_names == ("b",)
    for query in (scene.collide, scene.pairs):
        with pytest.raises(InputError, match=r"time: expected seconds, since bodies follow motions \(a\), found None"):
            query()
        with pytest.raises(InputError, match="time"):
            query(np.nan)
    checker = CollisionChecker(slider, scene)
    with pytest.raises(InputError, match=r"expected a time, since bodies of the scene follow motions \(a\)"):
        checker.collide(LEFT)
    version = scene.structure_version
    scene.follow("a", [0.0, 2.0], [translation(), translation(x=1.0)])
    assert scene.structure_version == version  # only the motion is another one
    assert checker.collide([1.0, 0.0, np.pi], 4.0)
    copy = scene.copy()
    scene.detach("a", translation(x=-0.5, y=-0.5))
    assert scene.following == {}
    assert checker.collide(LEFT)
    assert list(copy.following) == ["a"]
    copy.attach("a", "ball")
    assert copy.following == {}
    copy.remove("a")
    assert "a" not in copy


def test_a_motion_is_the_scenes_own(slider):
    """What becomes of the caller's arrays afterwards does not matter, and the motion cannot be changed in place."""
    times, poses = np.array([0.0, 1.0, 2.0]), np.array([translation(x=x) for x in (3.0, 0.0, 3.0)])
    scene = Scene()
    scene.add("a", Body.sphere(0.1))
    scene.follow("a", times, poses, repeat=True)
    times[1], poses[:] = 1.9, translation(x=9.0)
    path = scene.following["a"]
    np.testing.assert_array_equal(path.times, [0.0, 1.0, 2.0])
    assert CollisionChecker(slider, scene).collide([0.0, 0.0, np.pi], 1.0)
    for array in (path.times, path.positions, path.quaternions):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_a_new_motion_counts_at_once(slider):
    """Answers belong to the present motion, also after other bodies have moved."""
    scene = Scene()
    scene.add("a", Body.sphere(0.1))
    scene.follow("a", [0.0, 1.0], [translation(x=5.0), translation(x=6.0)])
    checker = CollisionChecker(slider, scene)
    assert not checker.collide(LEFT, 0.5)
    scene.follow("a", [0.0, 1.0], [translation(x=-0.5, y=-0.5)] * 2)
    assert checker.collide(LEFT, 0.5)
    scene.add("wall", Body.box([0.1, 0.1, 0.1]), translation(z=5))
    scene.move("wall", translation(z=6))
    assert checker.collide(LEFT, 0.5)
    scene.follow("a", [0.0, 1.0], [translation(x=5.0)] * 2)
    assert not checker.collide(LEFT, 0.5)


def test_a_twist_is_a_motion(slider, rng):
    """At any time the origin is where its velocity takes it, and the body has turned about its angular velocity."""
    for turns in (0.0, 0.1, 1.0, 40.0):
        first, velocity, axis = turned(rng, 1)[0], rng.normal(size=3), rng.normal(size=3)
        spin = turns * axis / np.linalg.norm(axis)
        scene = Scene()
        scene.add("a", Body.sphere(0.1))
        scene.follow("a", [1.0, 4.0], first, twist=[*velocity, *spin])
        for t in rng.uniform(1.0, 4.0, 20):
            T = scene.following["a"].poses(t)
            np.testing.assert_allclose(T[:3, 3], first[:3, 3] + (t - 1.0) * velocity, atol=1e-13)
            R = Rotation.from_rotvec((t - 1.0) * spin).as_matrix() @ first[:3, :3]
            np.testing.assert_allclose(T[:3, :3], R, atol=1e-12)
        np.testing.assert_array_equal(scene.following["a"].poses(9.0), scene.following["a"].poses(4.0))
    for times, pose, twist, message in (
        ([0.0], first, np.zeros(6), "expected two times that increase and one pose"),
        ([1.0, 0.0], first, np.zeros(6), "expected two times that increase and one pose"),
        ([0.0, 1.0], [first, first], np.zeros(6), "one pose with it"),
        ([0.0, 1.0], first, np.zeros(3), "twist"),
        ([0.0, 1.0], first, [0, 0, 0, 0, 0, np.nan], "twist"),
        ([0.0, 1e9], first, [0, 0, 0, 0, 0, 1.0], "at most 4194304 turns"),
        ([0.0, 1.0], first, [0, 0, 0, 0, 0, 1e308], "at most 4194304 turns"),
        ([0.0, 1.0], first, [1e308, 0, 0, 0, 0, 0], "speeds below"),
    ):
        with pytest.raises(InputError, match=message):
            scene.follow("a", times, pose, twist=twist)


def test_motions_are_kept_in_files(rng, tmp_path):
    """Times and positions to the last bit; wrong files are named with their line."""
    scene = moving_scene(rng, 3)
    scene.add("still", Body.box([1, 1, 1]), translation(x=3.0))
    save_scene(scene, tmp_path / "scene.yaml")
    loaded = load_scene(tmp_path / "scene.yaml")
    assert loaded.names == scene.names
    assert loaded.static_names == ("still",)
    for name, path in scene.following.items():
        same = loaded.following[name]
        np.testing.assert_array_equal(same.times, path.times)
        np.testing.assert_array_equal(same.positions, path.positions)
        np.testing.assert_allclose(same.quaternions, path.quaternions, atol=1e-15)
        assert same.repeat == path.repeat
    text = "bodies: {a: {sphere: {radius: 1}, follow: {poses: [{time: 0}, {time: 0}]}}}"
    for wrong, message in (
        (text, "line 1.*times that increase"),
        (
            text.replace("follow:", "position: [0, 0, 0], follow:"),
            "expected poses and errors in follow alone, found position",
        ),
        (text.replace("time: 0}]", "t: 1}]"), "time"),
        (text.replace("{time: 0}, {time: 0}", "{time: 0}"), "two times or more"),
        (text.replace("{time: 0}, {time: 0}", ""), "expected one row or more"),
    ):
        (tmp_path / "wrong.yaml").write_text(wrong)
        with pytest.raises(FileError, match=message):
            load_scene(tmp_path / "wrong.yaml")


@pytest.mark.parametrize(("first", "last", "warns"), [(0, 3.1, 0), (3.1, -3.1, 0), (0, 3.2, 1), (6.2, 3, 1)])
def test_more_than_half_a_turn_between_rows_of_a_file_is_reported(tmp_path, recwarn, first, last, warns):
    """A body turns through the smaller angle, so a file that states a larger turn states another motion."""
    rows = f"[{{time: 0, rpy: [0, 0, {first}]}}, {{time: 1, rpy: [0, 0, {last}]}}]"
    (tmp_path / "s.yaml").write_text(f"bodies: {{a: {{sphere: {{radius: 1}}, follow: {{poses: {rows}}}}}}}")
    load_scene(tmp_path / "s.yaml")
    assert ["turns through the smaller angle" in str(each.message) for each in recwarn] == [True] * warns


@pytest.mark.parametrize("bounds", [{"speed": 1.0}, {"error": (0.05, 0.0)}])
def test_a_checker_notices_bounds_of_a_body_with_rules(slider, bounds):
    """A rule of leave needs a known pose, so bounds that come after the checker has answered are refused as well."""
    scene = Scene()
    scene.add("box", Body.box([0.1, 0.1, 0.1]))
    path = [0.0, 1.0], np.array([translation(5.0), translation(5.1)])
    scene.follow("box", *path)
    scene.leave("box", "ball")
    checker = CollisionChecker(slider, scene)
    assert checker.certify_edges(LEFT, LEFT, t0=0.0, t1=1.0).verdict == Verdict.FREE
    scene.follow("box", *path, **bounds)
    with pytest.raises(InputError, match="expected bodies at known poses, found 'box'"):
        checker.certify_edges(LEFT, LEFT, t0=0.0, t1=1.0)


def test_bad_motions_are_refused(slider):
    """Motions, times and queries without a time."""
    scene = Scene()
    scene.add("a", Body.sphere(0.1))
    scene.add("held", Body.sphere(0.1))
    scene.attach("held", "ball")
    still = [translation(), translation()]
    half = translation()
    half[:3, :3] = np.diag([-1.0, -1.0, 1.0])
    for times, poses, options, message in (
        ([0.0, 0.0], still, {}, r"times: expected times that increase, found 0 and then 0"),
        ([1.0, 0.0], still, {}, "times that increase"),
        ([0.0, np.nan], still, {}, "times: expected finite"),
        ([0.0], still[:1], {}, "two times or more"),
        ([0.0, 1.0, 2.0], still, {}, "a pose for each"),
        ([0.0, 1.0], [translation(), half], {}, "less than half a turn"),
        ([0.0, 1.0], [translation(), translation(x=1.0)], {"repeat": True}, "a jump of 1 m"),
        ([0.0, 1.0], still, {"repeat": "yes"}, "repeat"),
        ([0.0, 1e-300], still, {}, "times at least 1e-12 s apart"),
        ([-1.7e308, 1.7e308], still, {}, "a finite duration"),
        ([0.0, 1.0], [translation(), translation(x=1e13)], {}, "speeds below"),
    ):
        with pytest.raises(InputError, match=message):
            scene.follow("a", times, poses, **options)
    with pytest.raises(PoseError):
        scene.follow("a", [0.0, 1.0], np.full((2, 4, 4), 2.0))
    with pytest.raises(UnknownNameError):
        scene.follow("b", [0.0, 1.0], still)
    with pytest.raises(InputError, match="found one on link 'ball'"):
        scene.follow("held", [0.0, 1.0], still)
    scene.follow("a", [0.0, 1.0], still)
    for change in (
        lambda: scene.move("a", translation()),
        lambda: scene.pose("a"),
        lambda: scene.move_all(["a"], still[:1]),
    ):
        with pytest.raises(InputError, match="follows a motion"):
            change()
    checker = CollisionChecker(slider, scene)
    for call, message in (
        (lambda: checker.certify_edges(LEFT, LEFT), "expected a time"),
        (lambda: checker.distance(LEFT), "expected a time"),
        (lambda: checker.clearance(LEFT), "expected a time"),
        (lambda: checker.joint_error([LEFT, LEFT]), "expected a time"),
        (lambda: checker.certify_edges(LEFT, LEFT, t0=0.0), "expected both t0 and t1, found t0 only"),
        (lambda: checker.certify_edges(LEFT, LEFT, t0=1.0, t1=0.0), "t1: expected times at or after t0"),
        (lambda: checker.certify_edges([LEFT] * 3, LEFT, t0=[0.0, 1.0], t1=2.0), "broadcast"),
        (lambda: checker.collide(LEFT, np.inf), "t: expected finite"),
        (lambda: checker.certify_edges(LEFT, LEFT, t0=-1.7e308, t1=1.7e308), "finite durations"),
        (lambda: checker.collide([LEFT, LEFT], [0.0, 1.0, 2.0]), "broadcast"),
        (lambda: checker.certify_edges(LEFT, LEFT, t0=0.0, t1=1e12), None),
    ):
        if message is None:
            assert call().verdict == Verdict.FREE
            continue
        with pytest.raises(InputError, match=message):
            call()
    scene.follow("a", [0.0, 1.0], still, repeat=True)
    with pytest.raises(InputError, match="at most 4194304 knots"):
        checker.certify_edges(LEFT, LEFT, t0=0.0, t1=1e10)
    for late in (1e14, 1e300, 1.7e308):
        with pytest.raises(InputError, match="repetitions of a motion"):
            checker.certify_edges(LEFT, LEFT, t0=late, t1=late)


# -- first contact on a curve -----------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.3, 1.0, 7.0])
def test_first_contact_of_two_balls_is_known(slider, speed):
    """The robot's ball waits; the other one comes along x and would touch it at a distance of 0.2 m."""
    scene = Scene(margin=0.05)
    scene.add("other", Body.sphere(0.1))
    scene.follow("other", [0.0, 3.0 / speed], [translation(x=2.0), translation(x=-1.0)])
    checker = CollisionChecker(slider, scene)
    q = np.array([0.0, 0.0, np.pi])
    found = checker.first_contact(CubicSpline([0.0, 5.0, 20.0], [q, q, q]))
    touching = (2.0 - 0.25) / speed
    assert found.verdict == Verdict.COLLIDING
    assert found.names == ("ball", "other")
    assert touching - 1e-6 / speed <= found.free_until <= touching + 1e-15
    assert touching - 1e-12 <= found.touching_at <= touching + 1e-9


@pytest.mark.parametrize("seed", quick_of(range(8), range(3)))
def test_first_contact_is_never_late(slider, seed):
    """Samples until `free_until` are free, and a collision follows."""
    rng = np.random.default_rng(seed)
    checker = CollisionChecker(slider, moving_scene(rng, 3))
    curves = [PPoly(rng.normal(size=(4, 2, 3)) * [0.3, 0.3, 1.0], [0.0, 1.0, 1.5]) for _ in range(6)]
    for curve in curves:
        curve.c[-1, 1] = curve.c[:, 0].sum(axis=0)
    seen = set()
    for curve, found in zip(curves, checker.first_contact(curves), strict=True):
        proven = checker.certify_trajectory(curve)
        assert (found.verdict == Verdict.FREE) == (proven.verdict == Verdict.FREE)
        assert found.free_until <= found.touching_at
        seen.add(found.verdict)
        if found.verdict == Verdict.FREE:
            assert found.touching_at == np.inf
            continue
        assert found.free_until >= 0.0
        t = np.append(np.linspace(0.0, found.free_until, SAMPLES), np.nextafter(found.free_until, -1.0))
        assert not sampled(checker, curve, t[(t >= 0.0) & (t < found.free_until)]).any()
        if found.verdict == Verdict.COLLIDING:
            assert sampled(checker, curve, np.array([found.touching_at, found.touching_at + 1e-9])).any()
            names = [
                (contact.name_a, contact.name_b)
                for contact in checker.pairs(curve(found.touching_at + 1e-9), found.touching_at + 1e-9)
            ]
            assert found.touching_at - found.free_until > 1e-4 or found.names in names
    assert Verdict.COLLIDING in seen


def test_first_contact_with_what_stands(slider):
    """Without bodies that move, and for a curve that begins in contact."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]))
    checker = CollisionChecker(slider, scene)
    a, b = np.array([-1.0, -0.5, np.pi]), np.array([1.0, -0.5, np.pi])
    found = checker.first_contact(PPoly(np.stack([b - a, a])[:, None], [0.0, 1.0]))
    assert found.free_until == pytest.approx((1.0 - 0.15) / 2.0, abs=1e-6)
    assert found.free_until <= found.touching_at
    inside = checker.first_contact(PPoly(np.stack([b - a, 0 * a])[:, None], [0.0, 1.0]))
    touch = np.array([-0.15 - 2.0**-53, -0.5, np.pi])  # within rounding of the wall, so that the start is open
    grazing = checker.first_contact(PPoly(np.stack([b - a, touch])[:, None], [0.0, 1.0]))
    assert (grazing.free_until, grazing.touching_at) == (0.0, 0.0)
    assert (inside.verdict, inside.free_until, inside.touching_at) == (Verdict.COLLIDING, 0.0, 0.0)
    with pytest.raises(InputError, match="tolerance"):
        checker.first_contact(PPoly(np.zeros((2, 1, 3)), [0.0, 1.0]), tolerance=0.0)
