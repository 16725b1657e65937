"""Bodies of many pieces: trees over the pieces change the work, not the answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import loewner
from families import random_poses, translation
from loewner import Bodies, Body, Verdict, bodies
from loewner._kernels import codes, columns, tolerances
from loewner._kernels.trees import piece_tree
from loewner.queries import pairs as queries
from sampling import examples, quick, quick_of

SEEDS = st.integers(0, 2**32 - 1)


def cloud(rng: np.random.Generator, count: int, size: float | None = None, reach: float = 1.0) -> Body:
    """`count` ellipsoids of many sizes, the fewer the larger, strewn in a box off the origin."""
    size = size or 2.0 / np.cbrt(count)
    shapes = Bodies.ellipsoids(
        rng.uniform(0.1, 1.0, size=(count, 3)) * size * 10 ** rng.uniform(-1.5, 0, size=(count, 1))
    )
    poses = random_poses(rng, count, reach) @ np.array([[1.0, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return Body.union(shape.transformed(T) for shape, T in zip(shapes, poses, strict=True))


def without_trees(body: Body) -> Body:
    """The same body, all of whose pieces are tried."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(columns, "FEW", 10**9)
        plain = Body(bodies.Packed.of(bodies.PieceArrays(**bodies.arrays_of(body._packed))))
    assert (plain._packed.kernel[8] == -1).all()
    return plain


def bent(rng: np.random.Generator, T: np.ndarray) -> np.ndarray:
    """Poses as far from rigid as they may be."""
    T = T.copy()
    T[:, :3, :3] += rng.uniform(-1, 1, size=(len(T), 3, 3)) * 0.25 * tolerances.ROTATION_TOLERANCE
    return T


@pytest.mark.parametrize(
    "counts",
    quick_of([(9, 70), (70, 3), (1, 8), (9, 200), (120, 3), (60, 60), (3, 120), (500, 65)], [(9, 70), (70, 3), (1, 8)]),
)
@pytest.mark.parametrize("margin", quick(0.07, 0.0))
def test_same_verdicts_and_distances(counts, margin):
    """Verdicts, booleans, distances and witnesses are those of all piece pairs, whichever body has a tree."""
    rng = np.random.default_rng([1, *counts])
    a, b = cloud(rng, counts[0]), cloud(rng, counts[1])
    assert (a._packed.kernel[8][0] >= 0) == (counts[0] >= columns.FEW)
    Ta, Tb = random_poses(rng, 24, 0.5), random_poses(rng, 24, 2.0)
    plain_a, plain_b = without_trees(a), without_trees(b)
    hit = loewner.collide(a, Ta, b, Tb, margin=margin)
    assert 0 < hit.sum() < 24
    assert np.array_equal(hit, loewner.collide(plain_a, Ta, plain_b, Tb, margin=margin))
    verdict, plain = (loewner.classify(x, Ta, y, Tb, margin=margin) for x, y in ((a, b), (plain_a, plain_b)))
    # A box can prove free what the ellipsoids leave ambiguous.
    assert ((verdict == plain) | ((verdict == Verdict.FREE) & (plain == Verdict.AMBIGUOUS))).all()
    estimate = loewner.collide(a, Ta, b, Tb, margin=margin, method="estimate")
    assert not (estimate & ~loewner.collide(plain_a, Ta, plain_b, Tb, margin=margin, method="estimate")).any()
    assert not ((verdict == Verdict.COLLIDING) & ~estimate).any()
    found = loewner.distance(a, Ta, b, Tb, exact=True)
    truth = loewner.distance(plain_a, Ta, plain_b, Tb, exact=True)
    np.testing.assert_allclose(found.distance, truth.distance, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.witness_b - found.witness_a, found.distance[:, None] * found.normal, atol=1e-8)
    assert np.array_equal(found.upper, truth.upper)
    assert (found.lower >= truth.lower).all()
    assert (found.lower <= found.distance).all()


@examples(5, 40)
@given(SEEDS, st.integers(8, 40), st.integers(1, 40), st.floats(0.05, 3.0), st.floats(0.0, 0.5))
def test_no_collision_is_lost(seed, count_a, count_b, spread, margin):
    """Poses barely rigid, pieces far from their origin: the same answers with and without trees."""
    rng = np.random.default_rng(seed)
    a, b = cloud(rng, count_a, reach=5.0), cloud(rng, count_b, reach=5.0)
    Ta, Tb = bent(rng, random_poses(rng, 6, spread)), bent(rng, random_poses(rng, 6, spread))
    plain_a, plain_b = without_trees(a), without_trees(b)
    for x, X, y, Y, p, q in ((a, Ta, b, Tb, plain_a, plain_b), (b, Tb, a, Ta, plain_b, plain_a)):
        assert np.array_equal(loewner.collide(x, X, y, Y, margin=margin), loewner.collide(p, X, q, Y, margin=margin))
        np.testing.assert_allclose(
            loewner.distance(x, X, y, Y).upper, loewner.distance(p, X, q, Y).upper, rtol=1e-12, atol=0
        )


def test_bent_poses_touching_at_arms_length():
    """A metre from their origins, spheres touch by less than what the bend of a pose moves them."""
    rng = np.random.default_rng(4)
    arm = Body.union([Body.sphere(0.01).transformed(translation(1.0 + 0.1 * k, 0, 0)) for k in range(10)])
    n = 200
    Ta = bent(rng, random_poses(rng, n, 1.0))
    tip = Ta @ np.array([1.9, 0, 0, 1.0])
    Tb = bent(rng, random_poses(rng, n, 1.0))
    away = Tb @ np.array([1.9, 0, 0, 1.0])
    gap = rng.uniform(-3e-6, 3e-6, size=n)
    # The last spheres' centers 0.02 + gap apart, along a random axis of b's frame.
    axis = Tb[np.arange(n), :3, rng.integers(0, 3, size=n)]
    Tb[:, :3, 3] += tip[:, :3] - away[:, :3] + (0.02 + gap)[:, None] * axis
    plain = without_trees(arm)
    hit = loewner.collide(plain, Ta, plain, Tb)
    assert 0.2 < hit.mean() < 0.8
    assert np.array_equal(loewner.collide(arm, Ta, arm, Tb), hit)


@pytest.mark.parametrize("far", [1e6, 1e200, 5e307])
def test_far_from_the_origin(far):
    """Poses far out, and bodies so far apart that lengths overflow: no collision is lost, no distance is short."""
    rng = np.random.default_rng(5)
    a, b = cloud(rng, 20), cloud(rng, 20)
    here, there = random_poses(rng, 10, 0.5), random_poses(rng, 10, 0.5)
    both = np.array([far, -far, far])
    assert not loewner.collide(a, here, b, translation(*both)).any()
    here[:, :3, 3] += both
    there[:, :3, 3] += both
    plain_a, plain_b = without_trees(a), without_trees(b)
    verdict = loewner.classify(plain_a, here, plain_b, there)
    assert np.array_equal(loewner.classify(a, here, b, there), verdict)
    assert (verdict != Verdict.FREE).any()


def test_lengths_that_overflow():
    """Where the distance of two bodies is no double, nothing is proven, with trees or without."""
    rng = np.random.default_rng(5)
    a, b = cloud(rng, 20), cloud(rng, 20)
    left, right = translation(-1.7e308, 0, 0), translation(1.7e308, 0, 0)
    verdict = loewner.classify(without_trees(a), left, without_trees(b), right)
    assert loewner.classify(a, left, b, right) == verdict == Verdict.AMBIGUOUS


def test_every_piece_is_in_its_tree_once():
    """Links lead from each root to all pieces of its body; every box holds what hangs below it."""
    rng = np.random.default_rng(6)
    counts = (3, 8, 9, 64, 65, 130, 1)
    packed = Bodies([cloud(rng, count) for count in counts])._packed
    start, groups, children, roots = packed.kernel[3], *packed.kernel[6:9]
    box_of = groups.reshape(-1, 6, columns.WIDE)

    def below(group: int) -> list[int]:
        out = []
        for lane in range(columns.WIDE):
            lower, upper = box_of[group, :3, lane], box_of[group, 3:, lane]
            if not (lower <= upper).all():
                continue
            child = children[columns.WIDE * group + lane]
            if child < 0:
                out.append(~child)
                center = packed.outer_center[~child]
                half = np.sqrt(np.einsum("ij,ij->i", *[packed.outer_factor[~child]] * 2))
                assert (lower <= center - half).all()
                assert (upper >= center + half).all()
            else:
                real = box_of[child, 0] <= box_of[child, 3]
                assert (lower == box_of[child, :3][:, real].min(axis=1)).all()
                assert (upper == box_of[child, 3:][:, real].max(axis=1)).all()
                out += below(child)
        return out

    for body, count in enumerate(counts):
        if count < columns.FEW:
            assert roots[body] == -1
        else:
            assert sorted(below(roots[body])) == list(range(start[body], start[body + 1]))


@pytest.mark.parametrize("count", quick(200, 500))
def test_work_grows_with_what_is_near(count):
    """Of all piece pairs a hundredth are looked at, and of bodies far apart none."""
    rng = np.random.default_rng(7)
    a, b = cloud(rng, count, size=0.1), cloud(rng, count, size=0.1)

    def looked_at(T: np.ndarray) -> int:
        _, tally = queries._settle(codes.CERTIFY, 0.0, queries._prepare(a, None, b, T, check=True))
        return int(tally.sum())

    near = np.stack([translation(x, 0.2, 0.1) for x in np.linspace(0, 2.5, 20)])
    assert 20 < looked_at(near) < 20 * count * count / 100
    assert looked_at(translation(30.0, 0, 0)) == 0


@pytest.mark.verify  # it compiles the walk, which it calls directly
def test_walk_in_small_steps_is_the_same_walk():
    """A buffer for one pair at a time and one for all give the same piece pairs in the same order."""
    rng = np.random.default_rng(8)
    a, b = cloud(rng, 70), cloud(rng, 90)
    T = random_poses(rng, 2, 0.3)

    def walked(room: int) -> list[tuple[int, int]]:
        steps, numbers = np.empty(piece_tree.STEPS, dtype=np.int64), np.empty(piece_tree.NUMBERS)
        i, j = np.empty((2, room), dtype=np.int64)
        pack_a, pack_b = a._packed.kernel, b._packed.kernel
        piece_tree.begin(pack_a, 0, T, 0, pack_b, 0, T, 1, steps, numbers)
        out = []
        while count := piece_tree.more(pack_a, pack_b, 0, 0.1, steps, numbers, i, j):
            out += zip(i[:count].tolist(), j[:count].tolist(), strict=True)
        return out

    found = walked(1)
    assert len(set(found)) == len(found) > 10
    assert walked(7) == walked(10_000) == found


def test_bend_covers_what_poses_may_be():
    """The walk allows for every pose that the border lets in: three entries of RᵀR - 1 in a row."""
    assert np.sqrt(3) * tolerances.ROTATION_TOLERANCE < piece_tree.BEND
