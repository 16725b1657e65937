"""What must not change an answer: where the world's origin is, the unit of length, the order of the pair."""

import numpy as np
import pytest

import loewner
from families import EIGHT, FAMILIES, box_corners, near_contact, pieces, random_poses, sizes, translation
from loewner import Bodies, Body, Verdict
from oracles import exact_collides, hull, pack, signed_distances
from sampling import quick

FREE, COLLIDING = Verdict.FREE, Verdict.COLLIDING

COUNT = 8  # bodies of each family


@pytest.fixture(scope="module", params=quick(8, 25))
def rounds(request: pytest.FixtureRequest) -> int:
    """How many poses there are of each body."""
    return request.param


@pytest.fixture(scope="module", params=sorted(FAMILIES))
def pairs(request: pytest.FixtureRequest, rounds: int):
    rng = np.random.default_rng(3)
    points = pieces(request.param, COUNT, seed=2)
    pool = pack(map(hull, points))
    i = np.tile(np.arange(COUNT), rounds)
    Ta, Tb = near_contact(rng, pool, i, pool, i[::-1], grazing=0.0)
    gap, _ = signed_distances(pool, i, Ta, pool, i[::-1], Tb)
    shape = (rounds, COUNT)
    size = (sizes(pool)[i] + sizes(pool)[i[::-1]]).reshape(shape)
    return points, Ta.reshape(*shape, 4, 4), Tb.reshape(*shape, 4, 4), gap.reshape(shape), size


def bodies(points: list[np.ndarray]) -> tuple[Bodies, Bodies]:
    return Bodies.from_points(points), Bodies.from_points(points[::-1])


@pytest.fixture(scope="module")
def both(pairs) -> tuple[Bodies, Bodies]:
    """The bodies of the pairs, in order and backwards."""
    return bodies(pairs[0])


def consistent(before: np.ndarray, after: np.ndarray, share: float) -> None:
    """No contradiction between certified verdicts, and nearly all the same."""
    assert not (((before == FREE) & (after == COLLIDING)) | ((before == COLLIDING) & (after == FREE))).any()
    assert np.mean(before == after) >= share


def test_rigid_motion(pairs, both):
    """Moving the whole world moves the witnesses and changes nothing else."""
    points, Ta, Tb, gap, size = pairs
    a, b = both
    W = random_poses(np.random.default_rng(1), 1)[0]
    consistent(loewner.classify(a, Ta, b, Tb), loewner.classify(a, W @ Ta, b, W @ Tb), 0.98)
    d = loewner.distance(a, Ta, b, Tb, exact=True)
    e = loewner.distance(a, W @ Ta, b, W @ Tb, exact=True)
    assert (np.abs(d.distance - e.distance) <= 2e-9 * size).all()
    clear = np.abs(gap) > 1e-9 * size
    assert np.array_equal(loewner.collide(a, Ta, b, Tb)[clear], loewner.collide(a, W @ Ta, b, W @ Tb)[clear])


def test_far_from_the_origin(pairs, both):
    """A million metres out, the doubles of the poses are coarser and the answers are right for them."""
    points, Ta, Tb, _, size = pairs
    a, b = both
    far = np.array([1e6, -2e6, 5e5])
    Fa, Fb = Ta.copy(), Tb.copy()
    Fa[..., :3, 3] += far
    Fb[..., :3, 3] += far
    pool = pack(map(hull, points))
    i = np.tile(np.arange(COUNT), len(size))
    gap, _ = signed_distances(pool, i, Fa.reshape(-1, 4, 4), pool, i[::-1], Fb.reshape(-1, 4, 4))
    gap = gap.reshape(size.shape)
    verdict = loewner.classify(a, Fa, b, Fb)
    sure = np.abs(gap) > 1e-13
    assert not ((verdict == FREE) & (gap <= 0) & sure).any()
    assert not ((verdict == COLLIDING) & (gap > 0) & sure).any()
    found = loewner.collide(a, Fa, b, Fb)
    clear = np.abs(gap) > 1e-9 * np.maximum(size, 1e-2)
    assert np.array_equal(found[clear], gap[clear] <= 0)
    # Hardly a verdict is lost to the offset, unless the offset's own rounding (1e-10) is the size of things.
    consistent(loewner.classify(a, Ta, b, Tb), verdict, 0.9)
    result = loewner.distance(a, Fa, b, Fb, exact=True)
    deep = gap < -1e-6
    assert result.distance[deep] == pytest.approx(gap[deep], abs=1e-8)


def test_pieces_far_from_their_own_origin(pairs, both):
    """The same world with the offset in the vertices instead of the pose."""
    points, Ta, Tb, gap, size = pairs
    offset = np.array([3e3, -1e3, 2e3])
    a = Bodies.from_points([P + offset for P in points])
    _, b = both
    back = translation(*-offset)
    found = loewner.collide(a, Ta @ back, b, Tb)
    clear = np.abs(gap) > 1e-9 * np.maximum(size, 1)
    assert np.array_equal(found[clear], gap[clear] <= 0)
    verdict = loewner.classify(a, Ta @ back, b, Tb)
    assert not ((verdict == FREE) & (gap <= 0) & clear).any()
    assert not ((verdict == COLLIDING) & (gap > 0) & clear).any()


@pytest.mark.parametrize("scale", [1e-6, 1e6, 2.0**-20])
def test_scale(pairs, both, scale: float):
    """Micrometres or megametres: the same verdicts, distances times the scale."""
    points, Ta, Tb, gap, size = pairs
    a, b = both
    c, d = bodies([P * scale for P in points])
    Sa, Sb = Ta.copy(), Tb.copy()
    Sa[..., :3, 3] *= scale
    Sb[..., :3, 3] *= scale
    consistent(loewner.classify(a, Ta, b, Tb), loewner.classify(c, Sa, d, Sb), 0.98)
    clear = np.abs(gap) > 1e-9 * size
    assert np.array_equal(loewner.collide(c, Sa, d, Sb)[clear], gap[clear] <= 0)
    big = loewner.distance(c, Sa, d, Sb, exact=True)
    one = loewner.distance(a, Ta, b, Tb, exact=True)
    assert (np.abs(big.distance / scale - one.distance) <= 2e-9 * size).all()


def test_order_of_vertices_and_repeats_do_not_matter():
    """Shuffled and repeated vertices give the same piece: same volumes of ellipsoids to the fit's tolerance."""
    rng = np.random.default_rng(8)
    for family in EIGHT:
        (P,) = pieces(family, 1, seed=4)
        one = loewner.Body.from_points(P)
        other = loewner.Body.from_points(np.concatenate([P, P[:3]])[rng.permutation(len(P) + 3)])
        assert one.outer.log_volume == pytest.approx(other.outer.log_volume, abs=3e-4)
        assert one.inner.log_volume == pytest.approx(other.inner.log_volume, abs=3e-4)


def test_poses_that_went_through_float32(pairs, both):
    """A pose rounded to float32 is a slightly bent map; certified verdicts hold for the bent pieces themselves."""
    points, Ta, Tb, _, size = pairs
    a, b = both
    Fa, Fb = Ta.astype(np.float32), Tb.astype(np.float32)
    pool = pack(map(hull, points))
    i = np.tile(np.arange(COUNT), len(size))
    gap, _ = signed_distances(pool, i, Fa.reshape(-1, 4, 4), pool, i[::-1], Fb.reshape(-1, 4, 4))
    gap = gap.reshape(size.shape)
    verdict = loewner.classify(a, Fa, b, Fb)
    # The oracle's face normals are rotated by the bent matrix too, hence right to about 1e-7 of the size.
    sure = np.abs(gap) > 1e-6 * size
    assert not ((verdict == FREE) & (gap <= 0) & sure).any()
    assert not ((verdict == COLLIDING) & (gap > 0) & sure).any()
    assert np.array_equal(loewner.collide(a, Fa, b, Fb)[sure], gap[sure] <= 0)


def float32_corners(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses, rounded to float32, of two unit cubes that touch corner to corner."""
    T = random_poses(np.random.default_rng(0), count)
    return T.astype(np.float32).astype(float), (T @ translation(1, 1, 1)).astype(np.float32).astype(float)


@pytest.mark.parametrize("count", quick(500, 1500))
def test_bent_poses_are_taken_at_their_word(count: int):
    """A pose through float32 stretches by up to 1e-7; FREE must be true of the stretched bodies, to the last bit."""
    corners = box_corners(np.ones(3))
    cube = Body.from_points(corners)
    Ta, Tb = float32_corners(count)
    free = np.flatnonzero(loewner.classify(cube, Ta, cube, Tb) == FREE)
    assert len(free) > count / 5
    for k in free:
        assert not exact_collides(corners, Ta[k], corners, Tb[k])


@pytest.mark.parametrize("count", quick(100, 300))
def test_bounds_hold_under_bent_poses(count: int):
    """Lower <= distance <= upper where the poses are slightly off a rotation."""
    for a, b in [
        (Body.sphere(1), Body.sphere(1.2)),
        (Body.capsule(0.5, 1), Body.sphere(0.3)),
        (Body.box([1, 1, 1]), Body.cylinder(0.5, 1)),
    ]:
        Ta, Tb = float32_corners(count)
        Tb[:, :3, 3] = Ta[:, :3, 3] + 0.5 * (Tb[:, :3, 3] - Ta[:, :3, 3])
        result = loewner.distance(a, Ta, b, Tb, exact=True)
        assert (result.lower <= result.upper).all()
        assert (result.lower <= result.distance + 1e-10).all()
        assert (result.distance <= result.upper + 1e-10).all()


@pytest.mark.parametrize("offset", [0.0, pytest.param(1000.0, marks=pytest.mark.verify)])
@pytest.mark.parametrize("count", quick(150, 1000))
def test_neighbours_and_precision_of_the_batch(offset: float, count: int):
    """A verdict is the pair's own: alone, in a batch, in any order, or beside pieces too small for single precision."""
    rng = np.random.default_rng(0)
    n = count
    rods = [0.3 * rng.normal(size=(12, 3)) * [1, 1e-3, 1e-3] for _ in range(20)]
    bodies = Bodies.from_points(rods)
    i, j = rng.integers(20, size=(2, n))
    Ta, Tb = random_poses(rng, n, 0.0), random_poses(rng, n, 0.02)
    Ta[:, :3, 3] += offset
    Tb[:, :3, 3] += offset
    batch = loewner.classify(bodies[i], Ta, bodies[j], Tb)
    assert (np.bincount(batch) > n / 100).all()
    order = rng.permutation(n)
    assert np.array_equal(batch[order], loewner.classify(bodies[i[order]], Ta[order], bodies[j[order]], Tb[order]))
    alone = [loewner.classify(bodies[i[k]], Ta[k], bodies[j[k]], Tb[k]) for k in range(n)]
    assert np.array_equal(batch, alone)
    speck = Bodies([Body.sphere(1e-5), *bodies])
    first, second = speck[np.append(i + 1, 0)], speck[np.append(j + 1, 0)]
    identity = np.eye(4)[None]
    double = loewner.classify(first, np.concatenate([Ta, identity]), second, np.concatenate([Tb, identity]))
    assert np.array_equal(batch, double[:n])
