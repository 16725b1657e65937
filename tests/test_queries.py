"""The laws of classify, collide and distance, on pairs whose truth the oracles know."""

import pickle
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import loewner
from families import FAMILIES, box_corners, near_contact, pieces, random_poses, rotations, sizes, stretch, translation
from loewner import Bodies, Body, Verdict, classify, collide, distance
from loewner._native import entries
from oracles import (
    HullPool,
    Support,
    capsule_support,
    cone_support,
    cylinder_support,
    directional_distance,
    ellipsoid_support,
    exact_collides,
    exact_squared_distance,
    hull,
    naive_distance,
    pack,
    polytope_support,
    posed_support,
    signed_distances,
)
from sampling import examples, quick

FREE, COLLIDING, AMBIGUOUS = Verdict

# Closer to touching than this, relative to the size of the pair, float64 input itself decides.
GRAZING = 1e-9

BODIES = 12  # of each family


class Pairs(NamedTuple):
    """All pairs of one family, in the order of the poses' last two batch axes."""

    points: list[np.ndarray]
    pool: HullPool
    a: Bodies
    b: Bodies
    Ta: np.ndarray  # (rounds, BODIES, 4, 4)
    Tb: np.ndarray
    gap: np.ndarray  # (rounds, BODIES): sign of the truth; the depth where negative
    distance: np.ndarray  # the true signed distance
    size: np.ndarray

    def flat(self):
        for p in range(self.gap.size):
            r, i = divmod(p, BODIES)
            j = BODIES - 1 - i
            yield (r, i), i, j, self.Ta[r, i], self.Tb[r, i]


@pytest.fixture(scope="module", params=quick(5, 13))
def world(request: pytest.FixtureRequest) -> dict[str, Pairs]:
    """Pairs of all families, with several poses of each body: 900 pairs in the quick suite."""
    out, rounds = {}, request.param
    rng = np.random.default_rng(11)
    for family in FAMILIES:
        points = pieces(family, BODIES, seed=1)
        pool = pack(map(hull, points))
        i = np.tile(np.arange(BODIES), rounds)
        j = BODIES - 1 - i
        Ta, Tb = near_contact(rng, pool, i, pool, j, stretch=stretch(family))
        gap, _ = signed_distances(pool, i, Ta, pool, j, Tb)
        truth = gap.copy()
        for p in np.flatnonzero(gap > 0):
            truth[p] = naive_distance(pool.hull(i[p]), Ta[p], pool.hull(j[p]), Tb[p])[0]
        a = Bodies.from_points(points)
        b = Bodies([a[k] for k in range(BODIES)][::-1])
        size = (sizes(pool)[i] + sizes(pool)[j]).reshape(rounds, BODIES)
        poses = (T.reshape(rounds, BODIES, 4, 4) for T in (Ta, Tb))
        out[family] = Pairs(
            points, pool, a, b, *poses, gap.reshape(rounds, BODIES), truth.reshape(rounds, BODIES), size
        )
    return out


def check_witnesses(
    result: loewner.Distance, a: Support, b: Support, tolerance: float, index: tuple[int, ...] = ()
) -> None:
    """The witnesses and the normal prove the distance: one from above, the other from below.

    Apart: the segment between points of the bodies is as long as the gap between the planes across
    it. Overlapping: the planes across the normal overlap by just the depth, and moving b that far
    brings the witnesses together.
    """
    d = float(np.asarray(result.distance)[index])
    wa, wb, n = result.witness_a[index], result.witness_b[index], result.normal[index]
    assert np.linalg.norm(n) == pytest.approx(1, abs=1e-12)
    assert wb - wa == pytest.approx(d * n, abs=tolerance)
    gap = float((n * (b(-n[None]) - a(n[None]))).sum())
    assert gap == pytest.approx(d, abs=tolerance)
    # The witnesses are in their bodies: no direction of many sees them stick out.
    directions = rotations(np.random.default_rng(0), 200).reshape(-1, 3)
    for w, support in ((wa, a), (wb, b)):
        assert (np.einsum("ki,ki->k", directions, w - support(directions)) <= tolerance).all()


# -- right answers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_verdicts_are_true(world: dict[str, Pairs], family: str):
    """FREE only where the pieces are apart, COLLIDING only where they meet; none set apart as too close."""
    w = world[family]
    verdict = loewner.classify(w.a, w.Ta, w.b, w.Tb)
    assert verdict.dtype == np.int8
    assert verdict.shape == w.gap.shape
    assert set(np.unique(verdict)) <= {FREE, COLLIDING, AMBIGUOUS}
    doubtful = np.abs(w.gap) < 1e-13
    assert not ((verdict == FREE) & (w.gap <= 0) & ~doubtful).any()
    assert not ((verdict == COLLIDING) & (w.gap > 0) & ~doubtful).any()
    for where, i, j, Ta, Tb in w.flat():
        if doubtful[where] and verdict[where] != AMBIGUOUS:
            assert exact_collides(w.points[i], Ta, w.points[j], Tb) == (verdict[where] == COLLIDING)


@pytest.mark.parametrize("family", FAMILIES)
def test_exact_answers_are_true(world: dict[str, Pairs], family: str):
    """Exact agrees with the truth on every pair that is not grazing."""
    w = world[family]
    found = loewner.collide(w.a, w.Ta, w.b, w.Tb)
    assert found.dtype == bool
    clear = np.abs(w.distance) > GRAZING * w.size
    assert np.array_equal(found[clear], w.gap[clear] <= 0)


@pytest.mark.parametrize("family", FAMILIES)
def test_distances_are_true(world: dict[str, Pairs], family: str):
    """Lower <= true distance <= upper, and the exact distance is the true one, depth included."""
    w = world[family]
    result = loewner.distance(w.a, w.Ta, w.b, w.Tb, exact=True)
    slack = 1e-12 * w.size
    assert (result.lower <= w.distance + slack).all()
    assert (w.distance <= result.upper + slack).all()
    assert (np.abs(result.distance - w.distance) <= 1e-9 * w.size).all()
    bounds = loewner.distance(w.a, w.Ta, w.b, w.Tb)
    assert bounds.distance is None
    assert bounds.witness_a is None
    assert bounds.witness_b is None
    assert bounds.normal is None
    assert (bounds.lower <= w.distance + slack).all()
    assert (w.distance <= bounds.upper + slack).all()
    assert np.isfinite(bounds.estimate).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_witnesses_prove_the_distance(world: dict[str, Pairs], family: str):
    """Witnesses lie in the pieces, are the distance apart along the normal, and the planes there agree."""
    w = world[family]
    result = loewner.distance(w.a, w.Ta, w.b, w.Tb, exact=True)
    for where, i, j, Ta, Tb in w.flat():
        if abs(w.distance[where]) < 1e-6 * w.size[where]:
            continue  # the normal of a short segment is rounding
        a = posed_support(polytope_support(w.points[i]), Ta)
        b = posed_support(polytope_support(w.points[j]), Tb)
        check_witnesses(result, a, b, 1e-9 * float(w.size[where]), where)


def test_witnesses_of_a_graze():
    """Where an edge all but touches a tiny cylinder, in any direction, the witnesses are that place."""
    rng = np.random.default_rng(0)
    count, size, radius, length = 2000, np.array([0.1, 0.05, 0.02]), 1e-5, 6e-5
    Ta, Tb = random_poses(rng, count, 0.0), random_poses(rng, count, 0.0)
    angle = rng.uniform(0, np.pi / 2, size=count)
    n = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    n = np.einsum("kij,kj->ki", Ta[:, :3, :3], n)
    place = Ta[:, :3, :3] @ (size * [0.5, 0.5, 0.0])
    place += (size[2] * rng.uniform(-0.5, 0.5, size=count))[:, None] * Ta[:, :3, 2]
    gap = 10.0 ** rng.uniform(-16, -13, size=count)
    for k in range(count):
        Tb[k, :3, 3] = (
            place[k] + gap[k] * n[k] - posed_support(cylinder_support(radius, length), Tb[k])(-n[k : k + 1])[0]
        )
    a, b = Body.box(size), Body.cylinder(radius, length)
    settled = 0
    for k in range(count):
        try:
            result = loewner.distance(a, Ta[k], b, Tb[k], exact=True)
        except loewner.ConvergenceError:
            continue
        settled += 1
        assert abs(result.distance) < 1e-10
        assert np.abs(result.witness_a - place[k]).max() < 1e-6
        assert np.abs(result.witness_b - place[k]).max() < 1e-6
    assert settled > 0.99 * count


def test_mix_is_mixed(world: dict[str, Pairs]):
    """Over all families each of free, ambiguous and colliding has its fair share."""
    counts = np.zeros(3)
    for w in world.values():
        counts += np.bincount(loewner.classify(w.a, w.Ta, w.b, w.Tb).ravel(), minlength=3)
    assert (counts > 0.15 * counts.sum()).all()


def test_estimate_keeps_what_is_certain(world: dict[str, Pairs]):
    """An estimate never overrules a certified verdict, and does much better than a coin on the rest."""
    right = total = 0
    for w in world.values():
        verdict = loewner.classify(w.a, w.Ta, w.b, w.Tb)
        guess = loewner.collide(w.a, w.Ta, w.b, w.Tb, method="estimate")
        assert not guess[verdict == FREE].any()
        assert guess[verdict == COLLIDING].all()
        right += (guess == (w.gap <= 0)).sum()
        total += guess.size
    assert right > 0.8 * total


# -- laws ------------------------------------------------------------------------------------------------


def opposite(w: Pairs) -> tuple:
    return w.b, w.Tb, w.a, w.Ta


def test_order_of_the_bodies_does_not_matter(world: dict[str, Pairs]):
    """Swapping a and b keeps every answer, swaps the witnesses and turns the normal."""
    for w in world.values():
        there, back = loewner.classify(w.a, w.Ta, w.b, w.Tb), loewner.classify(*opposite(w))
        contradiction = ((there == FREE) & (back == COLLIDING)) | ((there == COLLIDING) & (back == FREE))
        assert not contradiction.any()
        assert np.mean(there == back) > 0.99  # a witness may fall one rounding either side of proof
        clear = np.abs(w.distance) > GRAZING * w.size
        assert np.array_equal(loewner.collide(w.a, w.Ta, w.b, w.Tb)[clear], loewner.collide(*opposite(w))[clear])
        d, e = loewner.distance(w.a, w.Ta, w.b, w.Tb, exact=True), loewner.distance(*opposite(w), exact=True)
        assert (np.abs(d.distance - e.distance) <= 2e-9 * w.size).all()


def test_margin_is_a_distance(world: dict[str, Pairs]):
    """With a margin, collide means "within the margin", and verdicts stay true."""
    for w in world.values():
        for margin in (1e-3, 0.05, 0.5):
            verdict = loewner.classify(w.a, w.Ta, w.b, w.Tb, margin=margin)
            within = w.distance <= margin
            doubtful = np.abs(w.distance - margin) < 1e-12
            assert not ((verdict == FREE) & within & ~doubtful).any()
            assert not ((verdict == COLLIDING) & ~within & ~doubtful).any()
            clear = np.abs(w.distance - margin) > GRAZING * w.size
            found = loewner.collide(w.a, w.Ta, w.b, w.Tb, margin=margin)
            assert np.array_equal(found[clear], within[clear])


def test_margin_is_monotone(world: dict[str, Pairs]):
    """A larger margin never makes a colliding pair free."""
    for w in world.values():
        before = np.zeros(w.gap.shape, bool)
        for margin in (0.0, 1e-6, 0.01, 0.1, 1.0):
            verdict = loewner.classify(w.a, w.Ta, w.b, w.Tb, margin=margin)
            now = loewner.collide(w.a, w.Ta, w.b, w.Tb, margin=margin)
            assert not (before & ~now).any()
            assert not (before & (verdict == FREE)).any()
            assert not now[verdict == FREE].any()
            assert now[verdict == COLLIDING].all()
            before = now


seeds = st.integers(0, 2**32 - 1)
families = st.sampled_from(sorted(FAMILIES))


def random_pair(family: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    A, B = (FAMILIES[family](rng) for _ in range(2))
    pool, zero = pack([hull(A), hull(B)]), np.zeros(1, np.int64)
    Ta, Tb = near_contact(rng, pool, zero, pool, zero + 1, stretch=stretch(family))
    return A, Ta[0], B, Tb[0]


@examples(15, 40)
@given(families, seeds)
def test_one_pair_agrees_with_rationals(family: str, seed: int):
    """One pair at a time: certified, exact and distance answers against exact arithmetic."""
    A, Ta, B, Tb = random_pair(family, seed)
    a, b = Body.from_points(A), Body.from_points(B)
    squared = exact_squared_distance(A, Ta, B, Tb)
    verdict = loewner.classify(a, Ta, b, Tb)
    assert isinstance(verdict, Verdict)
    assert verdict == AMBIGUOUS or (verdict == COLLIDING) == (squared == 0)
    result = loewner.distance(a, Ta, b, Tb, exact=True)
    size = np.ptp(A, axis=0).max() + np.ptp(B, axis=0).max()
    if abs(result.distance) > GRAZING * size:
        assert bool(loewner.collide(a, Ta, b, Tb)) == (squared == 0)
        assert (result.distance <= 0) == (squared == 0)
    if squared:
        assert float(result.distance) == pytest.approx(float(squared) ** 0.5, abs=1e-9 * size)


@examples(8, 40)
@given(families, seeds, st.integers(2, 4))
def test_union_is_the_union(family: str, seed: int, count: int):
    """A union is FREE only if every piece pair is, COLLIDING if any is; its distance is the least."""
    rng = np.random.default_rng(seed)
    parts = [FAMILIES[family](rng) + rng.uniform(-1, 1, size=3) for _ in range(count)]
    whole = Body.from_pieces(parts)
    assert len(whole.pieces) == count
    same = Body.union([Body.from_points(P) for P in parts])
    other = Body.from_points(FAMILIES[family](rng))
    T = random_poses(rng, 1, 1.5)[0]
    verdicts = [loewner.classify(Body.from_points(P), None, other, T) for P in parts]
    apart = all(v == FREE for v in verdicts)
    expected = COLLIDING if COLLIDING in verdicts else FREE if apart else AMBIGUOUS
    assert loewner.classify(whole, None, other, T) == expected
    assert loewner.classify(same, None, other, T) == expected
    assert loewner.collide(whole, None, other, T) == any(
        loewner.collide(Body.from_points(P), None, other, T) for P in parts
    )
    each = [loewner.distance(Body.from_points(P), None, other, T, exact=True) for P in parts]
    result = loewner.distance(whole, None, other, T, exact=True)
    assert float(result.distance) == pytest.approx(min(float(e.distance) for e in each), abs=1e-9)
    assert result.lower <= result.distance + 1e-12
    assert result.distance <= result.upper + 1e-12


# -- shapes of the answers -----------------------------------------------------------------------------------


def test_none_is_the_identity(world: dict[str, Pairs]):
    """None as a pose means the identity, in every query and for either operand."""
    w = world["ball 20"]
    a, b, T = w.a[0], w.b[0], w.Tb[0, 0]
    assert loewner.classify(a, None, b, T) == loewner.classify(a, np.eye(4), b, T)
    assert loewner.collide(a, T, b, None) == loewner.collide(a, T, b, np.eye(4))
    assert loewner.distance(a, None, b, T).lower == loewner.distance(a, np.eye(4), b, T).lower


def test_poses_broadcast(world: dict[str, Pairs]):
    """Any mix of batch shapes gives what the pairs give one at a time."""
    w = world["ball 20"]
    a, b = w.a[0], w.b[0]
    Ta, Tb = w.Ta[:4, :3], w.Tb[:4, :3]
    each = np.array([[loewner.classify(a, Ta[r, 0], b, Tb[0, c]) for c in range(3)] for r in range(4)])
    assert np.array_equal(loewner.classify(a, Ta[:, :1], b, Tb[0]), each)
    assert np.array_equal(loewner.classify(a, Ta[:, 0, None], b, Tb[:1]), each)
    assert loewner.classify(a, Ta[:, 0], b, None).shape == (4,)
    assert loewner.classify(a, None, b, Tb).shape == (4, 3)
    full = loewner.distance(a, Ta, b, Tb, exact=True)
    assert full.distance.shape == full.lower.shape == full.upper.shape == full.estimate.shape == (4, 3)
    assert full.witness_a.shape == full.witness_b.shape == full.normal.shape == (4, 3, 3)
    for r in range(4):
        for c in range(3):
            one = loewner.distance(a, Ta[r, c], b, Tb[r, c], exact=True)
            assert full.distance[r, c] == pytest.approx(float(one.distance), abs=1e-12)


def test_bodies_broadcast_with_the_last_axis(world: dict[str, Pairs]):
    """Bodies of n against poses (..., n), against one Body, and against Bodies of n."""
    w = world["tetrahedra"]
    n = BODIES
    batch = loewner.classify(w.a, w.Ta, w.b, w.Tb)
    each = [[loewner.classify(w.a[i], w.Ta[r, i], w.b[i], w.Tb[r, i]) for i in range(n)] for r in range(3)]
    assert np.array_equal(batch[:3], each)
    assert loewner.classify(w.a, None, w.b[0], None).shape == (n,)
    assert loewner.classify(w.a, w.Ta[0, 0], w.b, w.Tb[0, 1]).shape == (n,)
    assert loewner.classify(w.a[0], w.Ta[:, :1], w.b, w.Tb[0, 0]).shape == (len(w.gap), n)
    one = loewner.classify(w.a[0], w.Ta[0, 0], w.b, w.Tb[0])
    assert np.array_equal(one, [loewner.classify(w.a[0], w.Ta[0, 0], w.b[i], w.Tb[0, i]) for i in range(n)])
    assert loewner.collide(w.a[:5], w.Ta[:, :5], w.b[:5], None).shape == (len(w.gap), 5)


def test_same_answers_for_any_number_of_threads(world: dict[str, Pairs]):
    """Verdicts and distances are the same to the last bit for any number of threads."""
    w = world["boxes"]
    before = loewner.get_num_threads()
    answers = []
    try:
        for threads in range(1, max(before, 2) + 1):
            loewner.set_num_threads(threads)
            result = loewner.distance(w.a, w.Ta, w.b, w.Tb, exact=True)
            answers.append((loewner.classify(w.a, w.Ta, w.b, w.Tb), result.distance, result.lower))
    finally:
        loewner.set_num_threads(before)
    for answer in answers[1:]:
        for x, y in zip(answers[0], answer, strict=True):
            assert np.array_equal(x, y)


def test_results_are_fresh_and_frozen(world: dict[str, Pairs]):
    """Records cannot be changed, and two calls share no memory."""
    w = world["boxes"]
    one, two = (loewner.distance(w.a, w.Ta, w.b, w.Tb, exact=True) for _ in range(2))
    assert not np.shares_memory(one.lower, two.lower)
    with pytest.raises(AttributeError):
        one.lower = two.lower


# -- primitives ---------------------------------------------------------------------------------------------


def test_balls_by_hand():
    """Sphere against sphere: centre distance less the radii, sign and all."""
    a, b = Body.sphere(0.5), Body.sphere(0.25)
    for t in [(1, 0, 0), (0.3, 0.4, 0.5), (0.2, 0, 0.1), (3, -4, 12)]:
        expected = np.linalg.norm(t) - 0.75
        result = loewner.distance(a, None, b, translation(*t), exact=True)
        assert float(result.distance) == pytest.approx(expected, abs=1e-9)
        assert result.normal == pytest.approx(np.array(t) / np.linalg.norm(t), abs=1e-5)
        assert result.lower <= expected + 1e-12
        assert result.upper >= expected - 1e-12
        assert bool(loewner.collide(a, None, b, translation(*t))) == (expected <= 0)
        # A sphere is its own ellipsoid: nothing is ambiguous.
        assert loewner.classify(a, None, b, translation(*t)) == (COLLIDING if expected <= 0 else FREE)


def test_touching_collides():
    """Touching counts as colliding wherever float64 can say so."""
    cube, ball = Body.box([1, 1, 1]), Body.sphere(0.5)
    for t in [(1, 0, 0), (0, 1, 0.5), (1, 1, 1), (1, 0.25, 1)]:
        assert loewner.collide(cube, None, cube, translation(*t))
    assert loewner.collide(ball, None, cube, translation(1, 0, 0))
    assert loewner.collide(ball, None, ball, translation(1, 0, 0))
    assert loewner.classify(cube, None, cube, translation(1, 0, 0)) != FREE
    assert loewner.collide(cube, None, cube, translation(1.5, 0, 0), margin=0.5)
    assert not loewner.collide(cube, None, cube, translation(1.5, 0, 0), margin=0.499)


def test_ball_and_box_by_hand():
    """Sphere against box: distance to the clamped centre, outside and inside."""
    ball, box = Body.sphere(0.5), Body.box([2, 4, 6])
    for t in [(2, 0, 0), (1.2, 2.1, 0), (2, 3, 4), (0.9, 0, 0), (0.2, 1.8, 0.1)]:
        x, half = np.abs(t), np.array([1, 2, 3])
        outside = np.linalg.norm(np.maximum(x - half, 0))
        expected = (outside or -(half - x).min()) - 0.5
        found = loewner.distance(box, None, ball, translation(*t), exact=True)
        assert float(found.distance) == pytest.approx(expected, abs=1e-9)


def test_capsules_by_hand():
    """Capsules: the distance of their segments less the radii."""
    a, b = Body.capsule(0.2, 1), Body.capsule(0.1, 2)
    lying = np.eye(4)
    lying[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    for t, segments in [((0.5, 0.6, 0.3), 0.6), ((0, 0.25, 0), 0.25), ((1.5, 0, 1), 0.5**0.5), ((2, 0, 0.5), 1)]:
        lying[:3, 3] = t
        result = loewner.distance(a, None, b, lying, exact=True)
        assert float(result.distance) == pytest.approx(segments - 0.3, abs=1e-9)


def test_cylinders_and_cones_by_hand():
    """Cylinders side by side, on top of each other, rim over rim; a cone's tip and base; exact, no facets."""
    can, cone = Body.cylinder(0.5, 2), Body.cone(0.5, 2)
    for a, b, t, expected in [
        (can, can, (1.5, 0, 0.3), 0.5),
        (can, can, (0.9, 0, 0), -0.1),
        (can, can, (0.2, 0.1, 2.25), 0.25),
        (can, can, (1.3, 0, 2.4), 0.5),
        (cone, can, (0, 0, 2.125), 0.125),
        (can, cone, (0, 0, 2.125), 0.125),
        (cone, cone, (0, 0, 2.5), 0.5),
        (cone, can, (0, 0, 1.875), -0.125),
    ]:
        result = loewner.distance(a, None, b, translation(*t), exact=True)
        assert float(result.distance) == pytest.approx(expected, abs=1e-9)
        assert bool(loewner.collide(a, None, b, translation(*t))) == (expected <= 0)


PRIMITIVES = {
    "box": (lambda: Body.box([1, 0.6, 0.3]), polytope_support(box_corners(np.array([1, 0.6, 0.3])))),
    "sphere": (lambda: Body.sphere(0.4), ellipsoid_support([0.4, 0.4, 0.4])),
    "cylinder": (lambda: Body.cylinder(0.3, 1), cylinder_support(0.3, 1)),
    "capsule": (lambda: Body.capsule(0.2, 0.8), capsule_support(0.2, 0.8)),
    "cone": (lambda: Body.cone(0.4, 0.9), cone_support(0.4, 0.9)),
    "ellipsoid": (lambda: Body.ellipsoid([0.6, 0.3, 0.2]), ellipsoid_support([0.6, 0.3, 0.2])),
    "plate": (lambda: Body.cylinder(0.7, 0.02), cylinder_support(0.7, 0.02)),
    "rod": (lambda: Body.capsule(0.01, 1.5), capsule_support(0.01, 1.5)),
}


@pytest.mark.parametrize("poses", [1, pytest.param(3, marks=pytest.mark.verify)])
@pytest.mark.parametrize("first", PRIMITIVES)
def test_primitives_against_directions(first: str, poses: int):
    """Every kind against every kind: the signed distance is the largest gap over all directions."""
    rng = np.random.default_rng(sum(first.encode()))
    make_a, support_a = PRIMITIVES[first]
    body_a = make_a()
    for second, (make_b, support_b) in PRIMITIVES.items():
        if second > first:
            continue
        body_b = make_b()
        for Ta, Tb in random_poses(rng, 6, 0.45).reshape(3, 2, 4, 4)[:poses]:
            a, b = posed_support(support_a, Ta), posed_support(support_b, Tb)
            result = loewner.distance(body_a, Ta, body_b, Tb, exact=True)
            d = float(result.distance)
            check_witnesses(result, a, b, 1e-7)
            if d <= 0:
                # Supporting planes prove "at most this deep"; no direction may do better.
                truth, _ = directional_distance(a, b, 1000, finest=1e-9)
                assert truth <= d + 1e-7
            verdict = loewner.classify(body_a, Ta, body_b, Tb)
            assert verdict == AMBIGUOUS or (verdict == COLLIDING) == (d <= 0)
            assert bool(loewner.collide(body_a, Ta, body_b, Tb)) == (d <= 0)
            assert result.lower <= d + 1e-9
            assert d <= result.upper + 1e-9


# -- regressions: found by attack ------------------------------------------------------------------------------


def test_concentric_bodies_have_a_depth():
    """Bodies about one centre, where every direction ties, still have a penetration depth."""
    sphere, tall = Body.sphere, Body.capsule
    for a, b, expected in [
        (sphere(1), sphere(2), -3),
        (sphere(1), sphere(1), -2),
        (sphere(1e-6), sphere(2), -2.000001),
        (sphere(0.1), tall(2, 3), -2.1),
        (tall(1, 1), tall(1, 1), -2),
        (tall(1, 1), tall(0.5, 2), -1.5),
        (Body.ellipsoid([1, 1, 1]), Body.ellipsoid([0.5, 0.5, 0.5]), -1.5),
        (Body.ellipsoid([1, 1, 2]), Body.ellipsoid([0.5, 0.5, 0.1]), -1.5),
        (Body.cylinder(1, 1), Body.cylinder(0.1, 4), -1.1),
        (Body.cylinder(1, 1), Body.cylinder(1, 1), -1),
        (Body.cone(1, 1), Body.cone(1, 1), -1),
        (Body.box([1, 1, 1]), Body.box([1, 1, 1]), -1),
    ]:
        for x, y in ((a, b), (b, a)):
            result = loewner.distance(x, None, y, None, exact=True)
            assert float(result.distance) == pytest.approx(expected, abs=1e-8)
            assert result.witness_b - result.witness_a == pytest.approx(result.distance * result.normal, abs=1e-8)


def test_ball_in_a_cone():
    """A ball much smaller than the cone it is in: witnesses agree with distance and normal."""
    size, r = (1.1828100922851816, 6.40412847480041), 1.0505651028961072e-05
    T = translation(-1.0635161908576265, -2.001529903151095, 0.7718515871092677)
    T_cone = np.eye(4)
    T_cone[:3, :3] = [
        [-0.9511742078670844, 0.2553112804360485, 0.17344675370421142],
        [0.19615429575358004, 0.06614302243204673, 0.9783397123908293],
        [0.23830887215091473, 0.9645938267818528, -0.1129939413796146],
    ]
    result = loewner.distance(Body.cone(*size), T_cone, Body.sphere(r), T, exact=True)
    a, b = posed_support(cone_support(*size), T_cone), posed_support(ellipsoid_support([r] * 3), T)
    check_witnesses(result, a, b, 1e-7)


def test_estimate_keeps_what_is_certain_for_long_pieces():
    """A small ball beside a box of 1 : 7 : 2500: the estimate obeys the certificate there too."""
    rng = np.random.default_rng(57)
    ball, beam = Body.sphere(0.01), Body.box([0.4, 2.8, 1000])
    T = random_poses(rng, 4000, 0.0)
    P = np.tile(np.eye(4), (4000, 1, 1))
    P[:, :3, 3] = np.einsum("nij,nj->ni", T[:, :3, :3], rng.uniform(-1, 1, size=(4000, 3)) * [1, 2, 800])
    verdict = loewner.classify(ball, P, beam, T)
    guess = loewner.collide(ball, P, beam, T, method="estimate")
    assert not guess[verdict == FREE].any()
    assert guess[verdict == COLLIDING].all()


def test_estimate_obeys_the_certificate_at_extreme_sizes():
    """A cube of 7 cm beside a cone of 5 cm by 8 km, far from the origin: free is free."""
    cube, spike = Body.box([0.06628702538750511] * 3), Body.cone(0.04647938998257031, 8428.439090463668)
    Ta = [
        [0.8553448915481567, -0.5172001123428345, 0.029817722737789154, -3250637568.0],
        [0.3324909806251526, 0.5921900272369385, 0.7340031862258911, 3740723456.0],
        [-0.39728429913520813, -0.6179117560386658, 0.6784911155700684, -317784064.0],
        [0, 0, 0, 1],
    ]
    Tb = [
        [0.5933630466461182, 0.16310887038707733, -0.7882359027862549, -3250640384.0],
        [0.05231747031211853, 0.9693686366081238, 0.23997369408607483, 3740723968.0],
        [0.8032329678535461, -0.18363001942634583, 0.5666540265083313, -317784256.0],
        [0, 0, 0, 1],
    ]
    verdict = loewner.classify(cube, Ta, spike, Tb)
    guess = loewner.collide(cube, Ta, spike, Tb, method="estimate")
    assert verdict == AMBIGUOUS or guess == (verdict == COLLIDING)


@pytest.mark.parametrize(
    ("body", "other"),
    [
        (Body.box([1, 1, 1]), Body.box([1, 1, 1])),
        (Body.cylinder(0.5, 1), Body.cylinder(0.5, 1)),
        (Body.cone(0.5, 1), Body.sphere(0.5)),
        (Body.capsule(0.2, 0.6), Body.capsule(0.2, 0.6)),
        (Body.ellipsoid([0.5, 0.4, 0.3]), Body.ellipsoid([0.5, 0.4, 0.3])),
    ],
    ids=repr,
)
def test_contact_flips_once(body: Body, other: Body):
    """Through contact in steps of 1e-12: first free, then colliding, one flip, within 2e-12 of the distance.

    Not for two sharp tips: pushed past contact along the normal, those may slip by each other.
    """
    rng = np.random.default_rng(7)
    for T in random_poses(rng, 3, 0.0):
        T[:3, 3] = 3, 0.1, 0.2
        start = loewner.distance(body, None, other, T, exact=True)
        steps = np.arange(-300, 301) * 1e-12
        poses = np.tile(T, (len(steps), 1, 1))
        poses[:, :3, 3] -= start.normal * (start.distance + steps)[:, None]
        colliding = loewner.collide(body, None, other, poses)
        flips = np.flatnonzero(np.diff(colliding.astype(int)))
        assert not colliding[0]
        assert colliding[-1]
        assert len(flips) == 1
        assert abs(steps[flips[0]]) < 2e-12


# -- pairs by number ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def links_and_obstacles():
    rng = np.random.default_rng(11)
    links = Bodies([*Bodies.from_points(rng.normal(size=(4, 12, 3))), Body.sphere(0.4), union_of_boxes(rng, 12)])
    obstacles = Bodies([*Bodies.from_points(rng.normal(size=(7, 12, 3))), Body.box([1, 2, 0.3])])
    place = lambda n: posed(rotations(rng, n), rng.uniform(-2, 2, (n, 3)))  # noqa: E731
    return links, place(len(links)), obstacles, place(len(obstacles))


def union_of_boxes(rng, count):
    return Body.union(Body.box([0.2, 0.3, 0.1]).transformed(translation(*x)) for x in rng.uniform(-1, 1, (count, 3)))


def posed(R, t):
    T = np.zeros((*np.shape(t)[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1
    return T


@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_pairs_by_number_are_the_pairs(links_and_obstacles, margin):
    """Rows say the same as picking bodies and poses: all of one set with all of another, in any shape."""
    a, Ta, b, Tb = links_and_obstacles
    pairs = np.indices((len(a), len(b))).transpose(1, 2, 0)
    i, j = pairs.reshape(-1, 2).T
    picked = a[i], Ta[i], b[j], Tb[j]
    shape = (len(a), len(b))
    asked = {"margin": margin, "pairs": pairs}
    np.testing.assert_array_equal(classify(a, Ta, b, Tb, **asked), classify(*picked, margin=margin).reshape(shape))
    found = collide(a, Ta, b, Tb, **asked)
    np.testing.assert_array_equal(found, collide(*picked, margin=margin).reshape(shape))
    assert 0 < found.sum() < found.size
    np.testing.assert_array_equal(
        collide(a, Ta, b, Tb, method="estimate", **asked),
        collide(*picked, method="estimate", margin=margin).reshape(shape),
    )


def test_distances_of_pairs_by_number(links_and_obstacles):
    """The same for distances, and for one body or one pose on a side."""
    a, Ta, b, Tb = links_and_obstacles
    pairs = np.indices((4, len(b))).T
    i, j = pairs.reshape(-1, 2).T
    one, other = distance(a, Ta, b, Tb, exact=True, pairs=pairs), distance(a[i], Ta[i], b[j], Tb[j], exact=True)
    assert one.distance.shape == (len(b), 4)
    assert one.normal.shape == (len(b), 4, 3)
    np.testing.assert_array_equal(one.distance.ravel(), other.distance)
    np.testing.assert_array_equal(
        collide(a[0], Ta, b, None, pairs=pairs), collide(a[0], Ta[i], b[j], None).reshape(len(b), 4)
    )
    assert isinstance(collide(a, Ta, b, Tb, pairs=[0, 0]), bool)
    assert collide(a, Ta, b, Tb, pairs=np.zeros((0, 2), int)).shape == (0,)
    assert distance(a, Ta, b, Tb, pairs=np.zeros((0, 2), int)).lower.shape == (0,)


@pytest.mark.parametrize("exact", [False, True])
def test_distances_of_pairs_by_number_are_those_of_copies(links_and_obstacles, exact):
    """Every field to the bit, in any order and with repeats, of one body at many poses and of many at one."""
    a, Ta, b, Tb = links_and_obstacles
    rng = np.random.default_rng(3)
    pairs = np.stack([rng.integers(len(a), size=150), rng.integers(len(b), size=150)], axis=1)
    i, j = pairs.T
    for listed, picked in (
        ((a, Ta, b, Tb), (a[i], Ta[i], b[j], Tb[j])),
        ((a[5], Ta, b, Tb[3]), (a[5], Ta[i], b[j], Tb[3])),
        ((a, None, b[2], Tb), (a[i], None, b[2], Tb[j])),
    ):
        one, other = distance(*listed, exact=exact, pairs=pairs), distance(*picked, exact=exact)
        for name in ("lower", "upper", "estimate", "distance", "witness_a", "witness_b", "normal"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    ("pairs", "told"),
    [
        ([[0, 1, 2]], "shape"),
        ([[0.0, 1.0]], "integers"),
        ([[0, 8]], "from 0 to 7, found 8"),
        ([[-1, 0]], "from 0 to 5, found -1"),
        (3, "shape"),
    ],
)
def test_pairs_that_do_not_exist(links_and_obstacles, pairs, told):
    """Rows of `pairs` that are no two indices of existing bodies are refused with the range allowed."""
    a, Ta, b, Tb = links_and_obstacles
    for query in (classify, collide, distance):
        with pytest.raises(loewner.InputError, match=told):
            query(a, Ta, b, Tb, pairs=pairs)
    with pytest.raises(loewner.PoseError, match="as many bodies as poses"):
        collide(a, Ta[:3], b, Tb, pairs=[[0, 0]])


def test_deep_in_a_cone_with_the_origin_on_a_face():
    """GJK ends with three points here; the depth was then sought to more digits than there are, the witnesses wrong."""
    Ta, Tb, upright = np.eye(4), np.eye(4), np.eye(4)
    Ta[:3, 3] = [0.3949288093670008, -0.4230924575572125, -0.0069885899329622525]
    Tb[:3] = [
        [-0.5192160134366026, 0.2860656126309713, -0.8053453896689725, 0.38757794010443514],
        [0.14541119733657223, 0.9581477005563033, 0.24659393262571044, -0.41391702903931515],
        [0.8421818776726001, 0.010929281254321951, -0.539082772615781, -0.005996200828824572],
    ]
    upright[:3, 3] = [0.033, -0.354, 0.29]
    cone = Body.cone(0.3, 0.8)
    rng = np.random.default_rng(4)
    many = np.tile(np.eye(4), (2000, 1, 1))
    many[:, :3, 3] = rng.uniform(-0.45, 0.45, size=(2000, 3)).round(3)
    for a, A, T in ((Body.sphere(0.3), Ta, Tb), (Body.cylinder(0.2, 0.3), None, upright), (cone, None, many)):
        found = distance(a, A, cone, T, exact=True)
        along = np.multiply(np.expand_dims(found.distance, -1), found.normal)
        assert found.witness_b - found.witness_a == pytest.approx(along, abs=1e-8)
    assert distance(Body.sphere(0.3), Ta, cone, Tb, exact=True).distance == pytest.approx(-0.43472, abs=1e-5)


def test_a_batch_with_a_pair_that_cannot_be_settled(monkeypatch):
    """An error that names the pair and keeps the answers to all others."""
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = [2.0, 3.0, 0.1, 5.0, 6.0]
    sphere, box = Body.sphere(0.3), Body.box([1.0, 1.0, 1.0])
    right = distance(sphere, None, box, poses, exact=True)
    settle = entries.distance_range

    def one_left(*arguments):
        left = settle(*arguments)
        arguments[-1][2] = 1  # the status of the third pair
        return left

    monkeypatch.setattr(entries, "distance_range", one_left)
    with pytest.raises(loewner.ConvergenceError, match=r"1 of 5 .* flat index 2") as caught:
        distance(sphere, None, box, poses, exact=True)
    found = caught.value.partial
    assert caught.value.indices.tolist() == [2]
    assert np.isnan(found.distance).tolist() == [False, False, True, False, False]
    assert np.isnan(found.normal[2]).all()
    for k in (0, 1, 3, 4):
        assert found.distance[k] == right.distance[k]
        assert (found.witness_b[k] == right.witness_b[k]).all()
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.indices == [2]).all()
    assert str(again) == str(caught.value)


def test_depths_of_a_tiny_cone_in_a_thin_rod():
    """Cores that overlap by a thousandth of the rod's length are not taken for touching, whichever comes first."""
    Ta = np.array([
        [-0.6369902816922081, -0.3587840222744617, 0.6822883601456495, 0],
        [-0.4086459781345084, 0.9076536082907519, 0.09577782578065132, 0],
        [-0.6536450455592637, -0.21780485007762446, -0.7247821753454559, 0], [0, 0, 0, 1],
    ])  # fmt: skip
    Tb = np.array([
        [0.09723266753177133, -0.9819521829666185, 0.16222120308932653, 0],
        [-0.7516058770747649, 0.03439769291865229, 0.658714964357534, 0],
        [-0.6524066323324198, -0.18597502275565556, -0.7346964522846862, 0], [0, 0, 0, 1],
    ])  # fmt: skip
    cone = Body.cone(0.0008554679367887097, 0.0005991331779436729)
    rod = Body.capsule(8.766485707887911e-05, 0.6954557035608326)
    for found in (distance(cone, Ta, rod, Tb, exact=True), distance(rod, Tb, cone, Ta, exact=True)):
        assert found.distance == pytest.approx(-0.00047977658, abs=1e-10)
        np.testing.assert_allclose(
            found.witness_b - found.witness_a, found.distance * np.asarray(found.normal), atol=1e-9
        )
