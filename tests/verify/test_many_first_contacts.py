"""A million first contacts: closed forms, and random convex bodies held against exact distances."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from families import translation
from loewner import Bodies, Body, Verdict, distance, first_contact
from test_first_contacts import ROUNDING, TOLERANCE, expect_times, motions, on_the_way, pose, units

pytestmark = pytest.mark.verify

BALLS, RODS, SCREWS, BOXES, OTHERS = 300_000, 200_000, 100_000, 200_000, 200_000


def test_balls():
    """Balls that turn as they like meet where a quadratic equation has its first root."""
    rng = np.random.default_rng(11)
    radii = rng.uniform(0.1, 1.0, (2, BALLS))
    a, b = (motions(rng, BALLS, 3.0, 3.0) for _ in range(2))
    x = b[0][:, :3, 3] - a[0][:, :3, 3]
    v = b[1][:, :3, 3] - a[1][:, :3, 3] - x
    reach = radii.sum(axis=0)
    A, B, C = (v * v).sum(1), (x * v).sum(1), (x * x).sum(1) - reach**2
    square = B * B - A * C
    # The second form does not cancel where the balls begin near each other.
    root = C / (-B + np.sqrt(np.maximum(square, 0)))
    times = np.where((square > 0) & (B < 0) & (root <= 1), root, np.inf)
    times[C <= 0] = 0.0
    sure = np.abs(square) > 1e-9 * B * B  # the others graze
    assert sure.mean() > 0.999
    a, b = (tuple(T[sure] for T in ends) for ends in (a, b))
    found = first_contact(Bodies.spheres(radii[0, sure]), a, Bodies.spheres(radii[1, sure]), b)
    expect_times(found, times[sure], np.sqrt(A[sure]))
    assert np.isfinite(times).sum() > BALLS // 3


def test_turning_rods_and_walls():
    """Rods that turn about one end meet a wall at an angle given by an arc sine."""
    rng = np.random.default_rng(12)
    angle, height = rng.uniform(0.3, 3.0, RODS), rng.uniform(0.15, 1.2, RODS)
    rod = Body.capsule(0.05, 1.0).transformed(pose((0, np.pi / 2, 0), (0.5, 0, 0)))
    wall = Body.box([10.0, 1.0, 10.0])
    sine = height - 0.05
    times = np.where(sine <= 1.0, np.arcsin(np.minimum(sine, 1.0)) / angle, np.inf)
    times[times > 1.0] = np.inf
    sure = (np.abs(sine - 1.0) > 1e-6) & (np.abs(np.arcsin(np.minimum(sine, 1.0)) - angle) > 1e-6)
    turned = pose(np.stack([0 * angle, 0 * angle, angle], axis=1))[sure]
    at_wall = pose(at=np.stack([0 * height, height + 0.5, 0 * height], axis=1))[sure]
    found = first_contact(rod, (None, turned), wall, at_wall)
    expect_times(found, times[sure], angle[sure])
    assert np.isfinite(times).sum() > RODS // 3


def test_screws_and_walls():
    """A ball on an arm that turns about an axis while it moves along it meets slanted walls."""
    rng = np.random.default_rng(13)
    radius, arm = 0.1, 0.7
    rate, way, slant, offset = (rng.uniform(*ends, SCREWS) for ends in ((0.2, 3.1), (-1.5, 1.5), (0, 3.1), (0.4, 1.2)))
    normal = np.stack([np.sin(slant), 0 * slant, np.cos(slant)], axis=1)

    def level(t):
        return normal[:, 0] * arm * np.cos(rate * t) + normal[:, 2] * way * t + radius - offset

    # The height is a cosine plus a line. Within half a turn it has at most two extrema, where
    # sin(rate t) takes this value, and is monotonic between them.
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.arcsin(np.clip(normal[:, 2] * way / (normal[:, 0] * arm * rate), -1, 1)) / rate
    turns = np.clip(np.sort(np.stack([0 * rate, at, np.pi / rate - at, np.ones(SCREWS)]), axis=0), 0, 1)
    times = np.full(SCREWS, np.inf)
    for low, high in zip(turns[:-1], turns[1:], strict=True):
        here = (level(low) < 0) & (level(high) >= 0) & np.isinf(times)
        low, high = low.copy(), high.copy()
        for _ in range(60):
            middle = (low + high) / 2
            above = level(middle) >= 0
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        times[here] = high[here]
    times[level(0.0) >= 0] = 0.0
    sure = np.min([np.abs(level(t)) for t in turns], axis=0) > 1e-5
    assert sure.mean() > 0.99
    # A wall of a size that keeps its rounding small.
    wall = Body.half_space([0, 0, -1], 0.0, extent=50.0)
    T = np.tile(np.eye(4), (SCREWS, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.stack([0 * slant, slant, 0 * slant], axis=1)).as_matrix()
    T[:, :3, 3] = normal * offset[:, None]
    ball = Body.sphere(radius).transformed(translation(arm))
    ends = pose(np.stack([0 * rate, 0 * rate, rate], axis=1), np.stack([0 * way, 0 * way, way], axis=1))
    found = first_contact(ball, (None, ends[sure]), wall, T[sure])
    expect_times(found, times[sure], np.abs(way[sure]))
    assert np.isfinite(times).sum() > SCREWS // 10


def test_boxes_in_translation():
    """Boxes that only slide meet when their extents along all three axes do."""
    rng = np.random.default_rng(14)
    kinds = 2_000
    sizes = rng.uniform(0.2, 1.5, (2, kinds, 3))
    boxes = [Bodies([Body.box(size) for size in side]) for side in sizes]
    shape = (BOXES // kinds, kinds)
    x0 = units(rng, *shape) * 2.5
    x1 = -units(rng, *shape) * rng.uniform(0, 2.5, (*shape, 1))
    half, v = sizes.sum(axis=0) / 2, x1 - x0
    enter, leave = np.sort([(-half - x0) / v, (half - x0) / v], axis=0)
    enter, leave = enter.max(axis=-1), leave.min(axis=-1)
    times = np.where((enter <= leave) & (enter <= 1) & (leave >= 0), np.maximum(enter, 0), np.inf)
    sure = (np.abs(leave - enter) > 1e-6) & (np.abs(enter - 1) > 1e-6)
    found = first_contact(boxes[0], None, boxes[1], (pose(at=x0), pose(at=x1)))
    verdict, free, touching = (np.asarray(x)[sure] for x in (found.verdict, found.free_until, found.touching_at))
    only = type(found)(verdict, free, touching)
    expect_times(only, times[sure], np.linalg.norm(v, axis=-1)[sure])


def test_other_bodies():
    """Hulls, boxes, capsules, cylinders, cones and ellipsoids: apart before, touching at the bracket's end."""
    rng = np.random.default_rng(15)
    kinds = [
        *(Body.from_points(rng.normal(size=(20, 3)) * 0.3) for _ in range(40)),
        *(Body.box(rng.uniform(0.2, 1.0, 3)) for _ in range(20)),
        *(Body.capsule(rng.uniform(0.1, 0.2), rng.uniform(0.2, 1.0)) for _ in range(10)),
        *(Body.cylinder(*rng.uniform(0.2, 0.8, 2)) for _ in range(10)),
        *(Body.cone(*rng.uniform(0.2, 0.8, 2)) for _ in range(10)),
        *(Body.ellipsoid(rng.uniform(0.1, 0.6, 3)) for _ in range(10)),
    ]
    n, rounds = len(kinds), OTHERS // len(kinds) ** 2
    a, b = Bodies(kinds), Bodies([kinds[k] for k in rng.permutation(n)])
    counts = np.zeros(3, dtype=int)
    for _ in range(rounds * n):
        Ma, Mb = motions(rng, n, 1.2, 3.1), motions(rng, n, 1.6, 3.1)
        found = first_contact(a, Ma, b, Mb)
        counts += np.bincount(found.verdict, minlength=3)
        t = np.minimum(found.free_until, 1.0) * np.array([0.0, 0.3, 0.6, 0.9, 1 - 1e-6, 1.0])[:, None]
        before = found.free_until > 0
        apart = distance(a, on_the_way(Ma, t), b, on_the_way(Mb, t), exact=True).distance[:, before]
        assert (apart[:-1] > 0).all()
        assert (apart[-1] >= -ROUNDING).all()
        meets = found.verdict == Verdict.COLLIDING
        at = np.where(meets, found.touching_at, 0.0)
        near = distance(a, on_the_way(Ma, at), b, on_the_way(Mb, at), exact=True).distance
        assert (near[meets] <= 1e-9).all()
        # The bracket is as narrow as promised, since the relative way of the origins is no longer than the bound.
        way = np.linalg.norm((Mb[1] - Mb[0] - Ma[1] + Ma[0])[:, :3, 3], axis=1)[meets]
        assert ((found.touching_at[meets] - found.free_until[meets]) * way <= TOLERANCE * 1.001).all()
    assert counts[Verdict.AMBIGUOUS] <= 1e-4 * counts.sum()
    assert (counts[:2] > counts.sum() // 5).all()
