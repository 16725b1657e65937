"""First contacts of bodies that move and turn: closed forms, dense samples, and the bounds that steps rest on."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import loewner
from families import translation
from loewner import Bodies, Body, InputError, PoseError, Verdict, collide, distance, first_contact
from loewner._kernels._jit import njit
from loewner._kernels.pieces.pack import pieces_of, placed
from loewner._kernels.pipeline.first_contacts import (
    MOTION,
    arm_of,
    lost_between,
    rates_between,
    write_motion,
)
from loewner.bodies import packed_of
from sampling import quick

FREE, COLLIDING, AMBIGUOUS = Verdict.FREE, Verdict.COLLIDING, Verdict.AMBIGUOUS

TOLERANCE = 1e-6
# Closed forms are computed in double precision.
ROUNDING = 1e-11


def pose(turn=(0.0, 0.0, 0.0), at=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Poses from rotation vectors and origins."""
    turn, at = (x.copy() for x in np.broadcast_arrays(turn, at))
    T = np.zeros((*turn.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(*turn.shape[:-1], 3, 3)
    T[..., :3, 3], T[..., 3, 3] = at, 1.0
    return T


def on_the_way(motion, t) -> np.ndarray:
    """The poses of motions at fractions, computed without the library."""
    shape = np.broadcast_shapes(np.shape(t), motion[0].shape[:-2])
    T0, T1 = (np.broadcast_to(T, (*shape, 4, 4)) for T in motion)
    t = np.broadcast_to(t, shape)[..., None]
    R = T0[..., :3, :3]
    turn = Rotation.from_matrix((np.swapaxes(R, -1, -2) @ T1[..., :3, :3]).reshape(-1, 3, 3)).as_rotvec()
    T = T0.copy()
    T[..., :3, :3] = R @ Rotation.from_rotvec(turn * t.reshape(-1, 1)).as_matrix().reshape(R.shape)
    T[..., :3, 3] = (1 - t) * T0[..., :3, 3] + t * T1[..., :3, 3]
    return T


def units(rng, *shape) -> np.ndarray:
    x = rng.normal(size=(*shape, 3))
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def motions(rng, n, near, turn) -> tuple[np.ndarray, np.ndarray]:
    """Random motions of n bodies that start `near` this far from the origin and pass it."""
    start = units(rng, n) * near
    R = Rotation.random(n, random_state=rng)
    by = Rotation.from_rotvec(units(rng, n) * rng.uniform(0, turn, (n, 1)))
    T0, T1 = np.tile(np.eye(4), (2, n, 1, 1))
    T0[:, :3, :3], T1[:, :3, :3] = R.as_matrix(), (R * by).as_matrix()
    T0[:, :3, 3], T1[:, :3, 3] = (
        start,
        -start * rng.uniform(0, 1, (n, 1)) + units(rng, n) * rng.uniform(0, near, (n, 1)),
    )
    return T0, T1


def expect_times(found, times, speed, tolerance=TOLERANCE) -> None:
    """Compare with exact times, inf for never: never late, and the bracket as narrow as promised."""
    verdict, free, touching = (np.asarray(x) for x in (found.verdict, found.free_until, found.touching_at))
    meets = np.isfinite(times)
    assert (verdict[meets] == COLLIDING).all()
    assert (verdict[~meets] == FREE).all()
    assert np.isinf(free[~meets]).all()
    assert np.isinf(touching[~meets]).all()
    assert (free[meets] <= times[meets] + ROUNDING).all()
    assert (touching[meets] >= times[meets] - ROUNDING).all()
    width = touching[meets] - free[meets]
    assert (width >= 0).all()
    assert (width * np.broadcast_to(speed, times.shape)[meets] <= tolerance * 1.001).all()


def test_balls():
    """Balls that move past each other, turning as they like, touch where a quadratic equation says."""
    rng = np.random.default_rng(1)
    n = 400
    radii = rng.uniform(0.1, 1.0, (2, n))
    a, b = (motions(rng, n, 3.0, 3.0) for _ in range(2))
    x = b[0][:, :3, 3] - a[0][:, :3, 3]
    v = b[1][:, :3, 3] - a[1][:, :3, 3] - x
    reach = radii.sum(axis=0)
    A, B, C = (v * v).sum(1), (x * v).sum(1), (x * x).sum(1) - reach**2
    root = (-B - np.sqrt(np.maximum(B * B - A * C, 0))) / A
    times = np.where((B * B > A * C) & (root >= 0) & (root <= 1), root, np.inf)
    times[C <= 0] = 0.0
    found = first_contact(Bodies.spheres(radii[0]), a, Bodies.spheres(radii[1]), b)
    expect_times(found, times, np.linalg.norm(v, axis=1))
    assert 200 < np.isfinite(times).sum() < n - 20


def test_ball_and_half_space():
    """A spinning ball, its center on an arm or not, reaches a plane at a constant rate."""
    ground = Body.half_space([0, 0, 1], 0.0)
    for turn in (0.0, 1.0, 3.1):
        for T0, T1, t in ((2.0, 0.0, 0.75), (0.5, 0.5, 0.0), (1.5, 0.75, np.inf), (2.0, 0.5, 1.0 - 1e-4)):
            height = T0 - 0.5
            ends = (
                pose(at=(0, 0, T0)),
                pose(turn=(turn, turn / 9, 0), at=(3, 0, T1 if t != 1 - 1e-4 else T0 - height / t)),
            )
            found = first_contact(Body.sphere(0.5), ends, ground, None)
            expect_times(found, np.array(t), 0.0)


def test_turning_rod_and_wall():
    """A rod that turns about its end touches a wall with its tip, at an angle in closed form."""
    n = 60
    rng = np.random.default_rng(2)
    angle, height = rng.uniform(0.3, 3.0, n), rng.uniform(0.15, 1.2, n)
    rod = Body.capsule(0.05, 1.0).transformed(pose((0, np.pi / 2, 0), (0.5, 0, 0)))
    wall = Body.box([10.0, 1.0, 10.0])
    sine = (height - 0.05) / 1.0
    times = np.where(sine <= 1.0, np.arcsin(np.minimum(sine, 1.0)) / angle, np.inf)
    times[times > 1.0] = np.inf
    turned = pose(np.stack([0 * angle, 0 * angle, angle], axis=1))
    at_wall = pose(at=np.stack([0 * height, height + 0.5, 0 * height], axis=1))
    expect_times(first_contact(rod, (None, turned), wall, at_wall), times, angle * 1.0)
    # The wall turns the other way about the same axis: only the relative rate counts.
    both = first_contact(rod, (None, pose((0, 0, 0.5))), Body.box([4.0, 0.2, 4.0]), (pose(at=(0, 0.5, 0)),) * 2)
    assert abs(both.touching_at - np.arcsin(0.4 - 0.05) / 0.5) < TOLERANCE


def test_screw_and_wall():
    """A ball on an arm that turns about its own axis while it moves along it meets a slanted wall."""
    radius, arm, rate, way = 0.1, 0.7, 3.0, 1.2
    ball = Body.sphere(radius).transformed(translation(arm))
    grid = np.linspace(0, 1, 200_001)
    for slant in (0.3, 0.9, 1.4):
        n = np.array([np.sin(slant), 0.0, np.cos(slant)])
        for offset in np.linspace(0.85, 1.2, 8):
            wall = Body.half_space(-n, -offset)
            level = n[0] * arm * np.cos(rate * grid) + n[2] * way * grid + radius - offset
            over = np.flatnonzero(level >= 0)
            t = np.inf
            if len(over) and over[0] == 0:
                t = 0.0
            elif len(over):
                low, high = grid[over[0] - 1], grid[over[0]]
                for _ in range(60):
                    middle = (low + high) / 2
                    above = n[0] * arm * np.cos(rate * middle) + n[2] * way * middle + radius >= offset
                    low, high = (low, middle) if above else (middle, high)
                t = high
            elif level.max() > -1e-6:
                continue
            found = first_contact(ball, (None, pose((0, 0, rate), (0, 0, way))), wall, None)
            expect_times(found, np.array(t), 1.0)


@pytest.mark.parametrize("n", quick(100, 300))
def test_boxes_in_translation(n):
    """Boxes that only slide meet when their extents along all three axes do."""
    rng = np.random.default_rng(3)
    sizes = rng.uniform(0.2, 1.5, (2, n, 3))
    x0, x1 = units(rng, n) * 2.5, -units(rng, n) * rng.uniform(0, 2.5, (n, 1))
    half, v = sizes.sum(axis=0) / 2, x1 - x0
    enter, leave = np.sort([(-half - x0) / v, (half - x0) / v], axis=0)
    enter, leave = enter.max(axis=1), leave.min(axis=1)
    times = np.where((enter <= leave) & (enter <= 1) & (leave >= 0), np.maximum(enter, 0), np.inf)
    boxes = [Bodies([Body.box(size) for size in side]) for side in sizes]
    found = first_contact(boxes[0], None, boxes[1], (pose(at=x0), pose(at=x1)))
    expect_times(found, times, np.linalg.norm(v, axis=1))


def shapes(rng) -> list[Body]:
    hull = Body.from_points(rng.normal(size=(20, 3)) * 0.3)
    corners = units(rng, 30) * [0.5, 0.3, 0.4]
    surface = Body.from_surface((corners, ConvexHull(corners).simplices), radius=0.02, solid=False)
    return [
        Body.box([0.8, 0.3, 0.5]),
        hull,
        hull.transformed(translation(0.5, 0.2, 0.1)),
        Body.from_points(units(rng, 300) * 0.4),
        Body.capsule(0.1, 0.8),
        Body.cylinder(0.3, 0.6),
        Body.cone(0.3, 0.6),
        Body.ellipsoid([0.2, 0.3, 0.6]),
        Body.union([Body.box([0.9, 0.2, 0.2]), hull, Body.sphere(0.3).transformed(translation(0.0, 0.5))]),
        Body.spheres(units(rng, 40) * 0.4, np.full(40, 0.1)),
        surface,
    ]


def compared(a, Ma, b, Mb, margin=0.0) -> np.ndarray:
    """Hold answers against dense samples; return the verdicts.

    Before `free_until` every sample is apart by more than the margin, and at `touching_at` the bodies touch.
    """
    found = first_contact(a, Ma, b, Mb, margin=margin)
    shares = np.concatenate([np.linspace(0, 1, 40)[:-1], 1 - np.logspace(-9, -2, 8)])[:, None]
    t = np.minimum(found.free_until, 1.0) * shares
    apart = distance(a, on_the_way(Ma, t), b, on_the_way(Mb, t), exact=True).distance
    assert (apart[:, found.free_until > 0] > margin).all()
    t = np.minimum(found.touching_at, 1.0)
    meets = collide(a, on_the_way(Ma, t), b, on_the_way(Mb, t), margin=margin + ROUNDING)
    assert meets[found.verdict == COLLIDING].all()
    assert (found.touching_at >= found.free_until).all()
    assert (np.isinf(found.free_until) == (found.verdict == FREE)).all()
    return found.verdict


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.verify) for k in range(1, 40))])
def test_never_late(seed):
    """Bodies of all kinds that move and turn, with and without a margin."""
    rng = np.random.default_rng(seed)
    made, verdicts = shapes(rng), []
    for i, a in enumerate(made):
        for b in made[i % 3 :: 3]:
            Ma, Mb = motions(rng, 6, 1.2, 3.1), motions(rng, 6, 1.6, 3.1)
            verdicts += list(compared(a, Ma, b, Mb, rng.choice([0.0, 0.05])))
    counts = np.bincount(verdicts, minlength=3)
    assert counts[FREE] > 10
    assert counts[COLLIDING] > 50
    assert counts[AMBIGUOUS] <= 2


def test_answers_do_not_depend_on_the_batch():
    """A pair has the same answer alone and in a batch; one body or pose serves many, and shapes broadcast."""
    rng = np.random.default_rng(5)
    hulls = Bodies([Body.from_points(rng.normal(size=(12, 3)) * 0.3) for _ in range(5)])
    Ma, Mb = motions(rng, 5, 1.0, 2.0), motions(rng, 5, 1.5, 2.0)
    found = first_contact(hulls, Ma, hulls[2], Mb)
    for k in range(5):
        alone = first_contact(hulls[k], (Ma[0][k], Ma[1][k]), hulls[2], (Mb[0][k], Mb[1][k]))
        assert (alone.verdict, alone.free_until, alone.touching_at) == (
            found.verdict[k],
            found.free_until[k],
            found.touching_at[k],
        )
    grid = first_contact(hulls, (Ma[0][:, None, None], Ma[1]), hulls[2], (Mb[0], Mb[1][0]))
    assert grid.verdict.shape == grid.free_until.shape == (5, 1, 5)
    assert "FirstContact(" in repr(grid)
    # The other way round, the brackets are of the same time.
    other = first_contact(hulls[2], Mb, hulls, Ma)
    assert (other.verdict == found.verdict).all()
    meets = found.verdict == COLLIDING
    assert (other.free_until <= found.touching_at)[meets].all()
    assert (found.free_until <= other.touching_at)[meets].all()


def test_ends_of_the_motion():
    """Bodies that touch at the beginning do so at 0; a body at rest has one pose; touching ends at 1."""
    box = Body.box([1, 1, 1])
    for pair in ((None, None), (None, translation(1.0)), (translation(1.0), translation(5.0))):
        found = first_contact(box, None, box, pair)
        start = np.eye(4) if pair[0] is None else pair[0]
        assert (found.verdict == COLLIDING) == collide(box, None, box, start)
        if found.verdict == COLLIDING:
            assert (found.free_until, found.touching_at) == (0.0, 0.0)
    far = translation(3.0)
    assert first_contact(box, None, box, far).verdict == FREE
    assert first_contact(box, far, box, (far, far)).verdict == COLLIDING
    assert first_contact(box, None, box, (far, translation(1.0 + 1e-6))).verdict == FREE
    late = first_contact(box, None, box, (far, translation(1.0 - 1e-6)))
    assert late.verdict == COLLIDING
    assert late.free_until < late.touching_at <= 1.0


def test_grazing():
    """A ball that passes at a tiny distance is free, and one that touches for an instant is never found late."""
    ball = Body.sphere(0.5)
    for gap in (1e-3, 1e-6, 1e-9):
        ends = translation(-2.0, 1.0 + gap), translation(2.0, 1.0 + gap)
        assert first_contact(ball, None, ball, ends).verdict == FREE
        ends = translation(-2.0, 1.0 - gap), translation(2.0, 1.0 - gap)
        found = first_contact(ball, None, ball, ends)
        assert found.free_until <= 0.5 - np.sqrt(1 - (1 - gap) ** 2) / 4 + ROUNDING
        assert found.verdict == COLLIDING or found.touching_at <= 0.5
    found = first_contact(ball, None, ball, (translation(-2.0, 1.0), translation(2.0, 1.0)))
    assert found.verdict != FREE
    assert 0.49 < found.free_until <= 0.5
    # A cylinder that rolls 1e-9 above a plate: neither is proven within the rounds, and this is said.
    plate, lying = Body.box([9, 9, 1]), Body.cylinder(0.5, 1.0)
    R0 = Rotation.from_euler("x", 90, degrees=True)
    ends = [pose((R0 * Rotation.from_euler("z", z)).as_rotvec(), (x, 0, 1.0 + 1e-9)) for z, x in ((0.3, 0), (2.0, 1.0))]
    found = first_contact(lying, tuple(ends), plate, None)
    assert found.verdict == FREE or (found.verdict == AMBIGUOUS and found.touching_at >= found.free_until)


def test_margin_and_tolerance():
    """A margin is kept, and smaller tolerances give narrower brackets, inside the wider ones up to their width."""
    rng = np.random.default_rng(6)
    hull = Body.from_points(rng.normal(size=(20, 3)) * 0.3)
    Ma, Mb = motions(rng, 40, 0.9, 2.0), motions(rng, 40, 1.2, 2.0)
    wide = first_contact(hull, Ma, hull, Mb, tolerance=1e-3)
    fine = first_contact(hull, Ma, hull, Mb, tolerance=1e-10)
    meets = wide.verdict == COLLIDING
    assert (fine.verdict == wide.verdict).all()
    assert (fine.free_until <= wide.touching_at)[meets].all()
    assert (wide.free_until <= fine.touching_at)[meets].all()
    assert (fine.touching_at[meets] - fine.free_until[meets]).max() < 1e-9
    kept = first_contact(hull, Ma, hull, Mb, margin=0.1)
    assert (kept.free_until <= fine.free_until).all()
    # A tolerance below rounding cannot be honoured.
    tiny = first_contact(hull, Ma, hull, Mb, tolerance=1e-300)
    assert ((tiny.verdict != COLLIDING) | (tiny.touching_at == 0.0)).all()


def test_far_from_the_origin():
    """Poses far from the world's origin widen the slack, and change nothing else."""
    rng = np.random.default_rng(7)
    box = Body.box([0.5, 0.3, 0.2])
    Ma, Mb = motions(rng, 30, 0.9, 2.0), motions(rng, 30, 1.2, 2.0)
    near = first_contact(box, Ma, box, Mb)
    off = translation(1e5, -2e5, 3e5)
    far = first_contact(box, (off @ Ma[0], off @ Ma[1]), box, (off @ Mb[0], off @ Mb[1]))
    assert (near.verdict == far.verdict).all()
    meets = near.verdict == COLLIDING
    assert np.abs(near.touching_at[meets] - far.touching_at[meets]).max() < 1e-5


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ((None, np.eye(3)), "motion_b"),
        ((np.full((4, 4), np.nan), None), "motion_b"),
        ([np.eye(4), np.eye(4)], "found a list of two"),
        ((None, None, None), "motion_b"),
        ((np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (3, 1, 1))), "broadcast"),
        ((None, np.diag([-1.0, -1.0, 1.0, 1.0])), "half a turn in pair 0"),
        ((None, np.diag([-1.0, -1.0, -1.0, 1.0])), "motion_b"),
        ((None, np.diag([2.0, 1.0, 1.0, 1.0])), "motion_b"),
    ],
)
def test_motions_that_are_none(motion, message):
    """Poses that are no rigid motions, and turns that could go either way, are refused by name."""
    with pytest.raises(PoseError, match=message):
        first_contact(Body.sphere(1.0), None, Body.sphere(1.0), motion)


def test_other_bad_arguments():
    """Margins, tolerances and operands that are none, and batches that do not fit."""
    ball = Body.sphere(1.0)
    for wrong in ({"margin": -1.0}, {"tolerance": 0.0}, {"tolerance": np.nan}, {"margin": np.inf}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            first_contact(ball, None, ball, None, **wrong)
    with pytest.raises(InputError, match="b: expected"):
        first_contact(ball, None, "b", None)
    with pytest.raises(PoseError, match="broadcast"):
        first_contact(Bodies([ball] * 3), None, ball, (None, np.tile(np.eye(4), (2, 1, 1))))
    assert first_contact(ball, np.empty((0, 4, 4)), ball, None).free_until.shape == (0,)


# -- the bounds that steps rest on ---------------------------------------------------------------------------------


@njit()
def _bounds(pack_a, Ta0, Ta1, pack_b, Tb0, Tb1, poses, ways, out):
    """Arms of the first pieces, and bounds on their relative velocity and acceleration."""
    write_motion(Ta0, Ta1, poses, 0, ways[0])
    write_motion(Tb0, Tb1, poses, 1, ways[1])
    out[0] = arm_of(placed(pieces_of(pack_a), 0, poses, 0), ways[0])
    out[1] = arm_of(placed(pieces_of(pack_b), 0, poses, 1), ways[1])
    out[2], out[3] = rates_between(ways[0], out[0], ways[1], out[1])


def bounds(a, Ma, b, Mb) -> np.ndarray:
    out = np.empty(4)
    packs = packed_of(a), packed_of(b)
    _bounds(packs[0].handle, *Ma, packs[1].handle, *Mb, np.empty((2, 4, 4)), np.empty((2, MOTION)), out)
    return out


@pytest.mark.verify
def test_gaps_between_two_planes():
    """Between planes at both ends of a motion, no product falls below its chord by more than the bound.

    Without any one of its parts, samples refute the bound: the curvature of a's paths or of b's, the arm from the axis
    to the piece, the turn of the normal, and the velocity that goes with it.
    """
    rng = np.random.default_rng(8)
    refuted = dict.fromkeys(("a", "b", "arm", "normal", "speed"), False)
    t, points = np.linspace(0, 1, 101), rng.normal(size=(2, 10, 3)) * 0.2
    for k in range(60):
        off = rng.normal(size=(2, 3)) * (k % 3)
        x = points + off[:, None]
        a, b = (Body.from_points(corners) for corners in x)
        turns = [0.0 if k % 5 == 1 else 2.0, 0.0 if k % 5 == 2 else 2.0]
        M = [tuple(T[0] for T in motions(rng, 1, 1.0, turn)) for turn in turns]
        if k % 5 == 3:
            M = [(T0, T0 + translation(*rng.normal(size=3)) - np.eye(4)) for T0, _ in M]
        arm_a, arm_b, speed, bend = bounds(a, M[0], b, M[1])
        # All points at all times, and their differences.
        T = [on_the_way(ends, t) for ends in M]
        y = [np.einsum("tij,nj->tni", T[s][:, :3, :3], x[s]) + T[s][:, None, :3, 3] for s in (0, 1)]
        d = (y[1][:, None] - y[0][:, :, None]).reshape(101, -1, 3)
        h = t[1]
        assert np.linalg.norm(d[1:] - d[:-1], axis=2).max() <= speed * h
        assert np.linalg.norm(d[2:] - 2 * d[1:-1] + d[:-2], axis=2).max() <= bend * h * h + 1e-9
        n0 = units(rng)
        n1 = n0 if k % 2 else units(rng)
        n = (1 - t[:, None]) * n0 + t[:, None] * n1
        gaps = np.einsum("ti,tni->tn", n, d)
        fall = ((1 - t[:, None]) * gaps[0] + t[:, None] * gaps[-1] - gaps).max()
        change = float(np.linalg.norm(n1 - n0))
        assert fall <= lost_between(speed, bend, change, 1.0) + 1e-12
        angles = [np.linalg.norm(Rotation.from_matrix(T0[:3, :3].T @ T1[:3, :3]).as_rotvec()) for T0, T1 in M]
        around = [np.linalg.norm(points[s] - points[s].mean(axis=0), axis=1).max() for s in (0, 1)]
        short = sum(w * w * r for w, r in zip(angles, around, strict=True))
        refuted["a"] |= fall > lost_between(speed, angles[1] ** 2 * arm_b, change, 1.0) + 1e-9
        refuted["b"] |= fall > lost_between(speed, angles[0] ** 2 * arm_a, change, 1.0) + 1e-9
        refuted["arm"] |= fall > lost_between(speed, short, change, 1.0) + 1e-9
        refuted["normal"] |= fall > lost_between(speed, bend, 0.0, 1.0) + 1e-9
        refuted["speed"] |= fall > lost_between(0.0, bend, change, 1.0) + 1e-9
    assert all(refuted.values()), refuted


def test_the_name_is_public():
    """The function and its result are names of the package."""
    assert {"first_contact", "FirstContact"} <= set(loewner.__all__)


@pytest.mark.parametrize("extent", [5.0, 50.0, 500.0, 5000.0])
def test_large_bodies_cost_no_accuracy(extent):
    """A ball and a cylinder fall on a huge cuboid (Parry's issue 429, and its pull request 414)."""
    ground = Body.box([2 * extent, 1.0, 2 * extent])
    rng = np.random.default_rng(6)
    x = rng.uniform(-0.9, 0.9, (50, 2)) * extent
    start = np.stack([x[:, 0], rng.uniform(1.5, 3.0, 50), x[:, 1]], axis=1)
    end = start - [0, 4.0, 0]
    ball, cylinder = Body.sphere(0.5166), Body.cylinder(0.4, 1.2).transformed(pose((np.pi / 2, 0, 0)))
    for body, half in ((ball, 0.5166), (cylinder, 0.6)):
        found = first_contact(body, (pose(at=start), pose(at=end)), ground, None)
        expect_times(found, (start[:, 1] - 0.5 - half) / 4.0, 4.0)


def test_cases_that_others_missed():
    """Cases from the tests and issues of Box2D, Parry and FCL, as bodies of unit depth."""
    # Box2D: a segment moves by 2 to a square at a distance of 1.
    found = first_contact(Body.box([2, 2, 1]), None, Body.box([1e-3, 2, 1]), (pose(at=(2, 0, 0)), pose(at=(0, 0, 0))))
    expect_times(found, np.array((1 - 0.5e-3) / 2), 2.0)
    # Parry's issue 180: a square and a line; for one of three starts there was no answer.
    way = 60 * np.array([0.0081385, -0.999966, 0.0])
    line = Body.box([123.0, 1e-3, 1.0]).transformed(translation(62.5, 1.0))
    for x in (15.689464, 15.689465, 15.689466):
        start = np.array([x, 54.00709, 0.0])
        found = first_contact(Body.box([4, 4, 1]), (pose(at=start), pose(at=start + way)), line, None)
        expect_times(found, np.array((54.00709 - 2 - 1 - 0.5e-3) / -way[1]), 60.0)
    # FCL's issue 555: two boxes, both of which move.
    boxes = [(pose(at=(0, 0, s * 4.0)), pose(at=(0, 0, s * -4.0))) for s in (1, -1)]
    found = first_contact(Body.box([2, 2, 2]), boxes[0], Body.box([2, 2, 2]), boxes[1])
    expect_times(found, np.array(3 / 8), 16.0)
    # A capsule that turns by nearly half a turn hits, in between, what it does not touch at the ends.
    rod = Body.capsule(0.1, 3.0).transformed(pose((0, np.pi / 2, 0), (1.5, 0, 0)))
    found = first_contact(rod, (None, pose((0, 0, 3.1))), Body.sphere(0.2), pose(at=(0, 2.0, 0)))
    expect_times(found, np.array((np.pi / 2 - np.arcsin(0.3 / 2)) / 3.1), 9.3)


@pytest.mark.parametrize("order", [1, -1])
def test_a_slow_pair_does_not_widen_the_bracket_of_a_fast_one(order):
    """Between both times, the distance of unions changes by the tolerance, however slow a pair of pieces is."""
    # One ball goes round, and another one moves away from the ball below it.
    arm = np.array([[1000.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    motion = pose(), pose([0.0, 0.0, 3.0], [0.0, 0.0, 1.0])
    tip = (on_the_way(motion, 0.5) @ [1000.0, 0.0, 0.0, 1.0])[:3]

    def found(gap):
        a, b = (Body.spheres(x[::order], [0.1, 0.1]) for x in (arm, np.array([tip, [0.0, 0.0, -0.2 - gap]])))
        return a, b, first_contact(a, motion, b, None, tolerance=TOLERANCE)

    hit = found(5.0)[2].touching_at
    for share in (0.1, 0.5, 0.9):
        a, b, answer = found(1.00001 * hit - share * TOLERANCE)
        at = on_the_way(motion, np.array([answer.free_until, answer.touching_at]))
        before, after = distance(a, at, b, None, exact=True).distance
        assert answer.verdict == COLLIDING
        assert before - after <= 2.0 * TOLERANCE


@pytest.mark.parametrize("count", quick(8, 20))
def test_clouds_above_floors_that_turn(count):
    """Points of the floor that are far away move fast, which does not count; dense samples of the points' heights."""
    rng, radius, t = np.random.default_rng(59), 0.02, np.linspace(0.0, 1.0, 4001)
    for _ in range(count):
        points = rng.normal(size=(50, 3)) * rng.choice([0.05, 0.3]) + rng.normal(size=3)
        n, offset = units(rng), rng.normal()
        floor = Body.half_space(n, offset, extent=rng.choice([1e2, 1e4]))
        turn = rng.uniform(-1.5, 1.5, (2, 3))
        floor_ends = pose(rng.normal(size=3), rng.normal(size=3))
        floor_ends = floor_ends, floor_ends @ pose(0.4 * turn[0], rng.normal(size=3))
        start = pose(rng.normal(size=3), np.zeros(3))
        # The lowest point at the start is 2 m above the floor's plane.
        up = floor_ends[0][:3, :3] @ n
        lift = 2.0 + offset + up @ floor_ends[0][:3, 3] - (points @ start[:3, :3].T @ up).min()
        start[:3, 3] = lift * up
        ends = start, pose(turn[1]) @ start
        ends[1][:3, 3] = start[:3, 3] - rng.uniform(1.0, 8.0) * up
        T, F = on_the_way(ends, t), on_the_way(floor_ends, t)
        placed_points = points @ T[:, :3, :3].swapaxes(-1, -2) + T[:, None, :3, 3]
        local = (placed_points - F[:, None, :3, 3]) @ F[:, :3, :3]
        low = (local @ n).min(axis=1) - offset - radius
        cloud = Body.from_cloud(points, radius=radius)
        for pair in ((cloud, ends, floor, floor_ends), (floor, floor_ends, cloud, ends)):
            found = first_contact(*pair, tolerance=1e-4)
            if (low > 0).all():
                assert found.verdict == FREE
                continue
            first = t[np.argmax(low <= 0)]
            assert found.verdict == COLLIDING
            assert found.free_until <= first <= found.touching_at + 1.1 * t[1]
            assert (low[t < found.free_until] > 0).all()
            assert abs(np.interp(found.free_until, t, low)) <= 2e-4


@pytest.mark.parametrize("solid", [True, False])
def test_parallel_faces_of_a_hull_and_a_surface(solid):
    """A mesh that comes down on a hull, face to face, touches it when their distance is covered."""
    trimesh = pytest.importorskip("trimesh")
    rim = trimesh.creation.cylinder(0.009, 0.01, sections=24).vertices
    hull, cube = Body.from_points(rim), Body.from_surface(trimesh.creation.box((0.008, 0.008, 0.01)), solid=solid)
    for height in np.linspace(0.0105, 0.0295, 12):
        above, below = translation(z=height), translation(z=0.001)
        for found in (
            first_contact(hull, None, cube, (above, below)), first_contact(cube, (above, below), hull, None),
        ):  # fmt: skip
            contact = (height - 0.01) / (height - 0.001)
            assert found.free_until <= contact <= found.touching_at
            assert found.touching_at - found.free_until < 1e-3
