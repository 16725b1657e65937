"""Pairs that meet among many bodies, and how deep: the same as asking about every pair."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import loewner
from families import FAMILIES, pieces, random_poses, translation
from loewner import Bodies, Body, Verdict, overlapping_pairs
from loewner._kernels import columns
from loewner._native import entries
from loewner.queries import crowds
from sampling import quick

SEEDS = st.integers(0, 2**32 - 1)


def all_pairs(bodies: Body | Bodies, T: np.ndarray):
    """Numbers of all pairs, and the operands of a query about them."""
    i, j = np.triu_indices(len(T), 1)
    a, b = (bodies[i], bodies[j]) if isinstance(bodies, Bodies) else (bodies, bodies)
    return np.stack([i, j], axis=1), (a, T[i], b, T[j])


def brute(bodies: Body | Bodies, T: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Pairs that `collide`, asked one by one."""
    pairs, operands = all_pairs(bodies, T)
    return pairs[loewner.collide(*operands, margin=margin)]


def not_free(bodies: Body | Bodies, T: np.ndarray, margin: float) -> np.ndarray:
    """Pairs that `classify` does not prove free."""
    pairs, operands = all_pairs(bodies, T)
    return pairs[loewner.classify(*operands, margin=margin) != Verdict.FREE]


def axes(rng: np.random.Generator, n: int, decades: float) -> np.ndarray:
    """Semi-axes of ellipsoids, sizes spread evenly over so many decades below 1."""
    return rng.uniform(0.3, 1.0, size=(n, 3)) * 10 ** rng.uniform(-decades, 0.0, size=(n, 1))


def snowman(rng: np.random.Generator) -> Body:
    """Several pieces of different kinds, far from the body's own origin."""
    parts = [
        Body.sphere(0.4).transformed(random_poses(rng, 1)[0]),
        Body.box(rng.uniform(0.1, 0.8, size=3)).transformed(random_poses(rng, 1)[0]),
        Body.capsule(0.1, 0.6).transformed(random_poses(rng, 1)[0]),
    ]
    return Body.union(parts[: rng.integers(1, 4)])


def crowd(kind: str, rng: np.random.Generator, n: int) -> Bodies:
    if kind == "spheres":
        return Bodies.spheres(rng.uniform(0.1, 0.6, size=n))
    if kind == "ellipsoids":
        return Bodies.ellipsoids(axes(rng, n, 0.0))
    if kind == "mixed sizes":
        return Bodies.ellipsoids(axes(rng, n, 3.0))
    if kind == "several pieces":
        return Bodies([snowman(rng) for _ in range(n)])
    kinds = sorted(FAMILIES)
    return Bodies.from_points([pieces(kinds[k % len(kinds)], 1, seed=k)[0] for k in range(n)])


KINDS = ("spheres", "ellipsoids", "mixed sizes", "several pieces", "hulls")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("margin", quick(0.2, 0.0))
@pytest.mark.parametrize("count", quick(60, 90))
def test_same_as_all_pairs(kind, count, margin):
    """Exactly the pairs that a query of every pair gives, in order."""
    rng = np.random.default_rng([5, KINDS.index(kind)])
    bodies = crowd(kind, rng, count)
    T = random_poses(rng, count, spread=0.8 if kind == "mixed sizes" else 2.5)
    truth, doubtful = brute(bodies, T, margin), not_free(bodies, T, margin)
    assert 10 < len(truth) < count * (count - 1) // 2
    found = overlapping_pairs(bodies, T, margin=margin)
    assert found.dtype == np.int64
    assert np.array_equal(found, truth)
    # The boxes may prove free what `classify` alone leaves ambiguous, and never what collides.
    unproven = overlapping_pairs(bodies, T, margin=margin, method="certified")
    assert set(map(tuple, truth)) <= set(map(tuple, unproven))
    assert set(map(tuple, unproven)) <= set(map(tuple, doubtful))
    assert len(unproven) >= 0.99 * len(doubtful)


@given(SEEDS, st.integers(2, 40), st.floats(0.0, 6.0), st.floats(0.1, 30.0), st.floats(0.0, 3.0))
def test_same_as_all_pairs_of_any_sizes(seed, n, decades, spread, margin):
    """Sizes over any range, dense or sparse, near or far: no pair lost, none invented."""
    rng = np.random.default_rng(seed)
    bodies, T = Bodies.ellipsoids(axes(rng, n, decades)), random_poses(rng, n, spread)
    assert np.array_equal(overlapping_pairs(bodies, T, margin=margin), brute(bodies, T, margin))


def test_boxes_hold_their_bodies():
    """Every vertex, placed in long doubles, is inside its body's box; the box is no wider than rounding asks for."""
    rng = np.random.default_rng(2)
    points = [pieces(family, 1)[0] for family in sorted(FAMILIES)]
    bodies = Bodies.from_points(points)
    n = len(points)
    T = random_poses(rng, n)
    T[::2, :3, 3] += 1e6
    lower, upper = np.empty((n, 3)), np.empty((n, 3))
    entries.body_boxes(0, n, 1, 1, bodies._packed.handle, T, lower, upper)
    exact = T.astype(np.longdouble)
    for k in range(n):
        x = bodies[k].pieces[0].vertices.astype(np.longdouble) @ exact[k, :3, :3].T + exact[k, :3, 3]
        assert (x >= lower[k]).all()
        assert (x <= upper[k]).all()
    placed = bodies.outer.transformed(T)
    half = np.sqrt(np.einsum("nii->ni", placed.shape_matrix))
    np.testing.assert_allclose(upper - lower, 2 * half, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("far", [0.0, 1e6, -1e12])
def test_touching_row_of_cubes(far):
    """Cubes in a row, faces in common: each meets its neighbours, wherever the row is."""
    n = 40
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 1, 3] = far + np.arange(n)
    found = overlapping_pairs(Body.box([1, 1, 1]), T)
    assert np.array_equal(found, np.stack([np.arange(n - 1), np.arange(1, n)], axis=1))


def test_far_from_the_origin():
    """A million metres out the answer is that of the rounded poses."""
    rng = np.random.default_rng(6)
    bodies, T = Bodies.ellipsoids(axes(rng, 60, 1.0)), random_poses(rng, 60, 2.0)
    T[:, :3, 3] += [1e6, -2e6, 5e5]
    assert np.array_equal(overlapping_pairs(bodies, T), brute(bodies, T))


def test_one_far_away():
    """A body far off spoils the order of the others, not the answer."""
    rng = np.random.default_rng(7)
    bodies, T = Bodies.ellipsoids(axes(rng, 60, 1.0)), random_poses(rng, 60, 1.0)
    T[17, :3, 3] = [1e200, -1e300, 1.7e308]
    truth = [pair for pair in brute(bodies, T).tolist() if 17 not in pair]
    assert overlapping_pairs(bodies, T).tolist() == truth


def test_all_in_one_place():
    """Everybody meets everybody, more pairs than the buffer for candidates holds."""
    n = 600
    assert n * (n - 1) // 2 > crowds.CANDIDATES + columns.WIDE * n
    found = overlapping_pairs(Body.sphere(1.0), np.tile(np.eye(4), (n, 1, 1)))
    assert np.array_equal(found, np.stack(np.triu_indices(n, 1), axis=1))
    assert np.array_equal(overlapping_pairs(Bodies.spheres(np.ones(n))), found)


def test_few_bodies():
    """None and one have no pairs; two may have one."""
    for n in (0, 1):
        for method in ("exact", "certified"):
            assert overlapping_pairs(Bodies.spheres(np.ones(n)), method=method).shape == (0, 2)
        assert overlapping_pairs(Body.sphere(1.0), np.tile(np.eye(4), (n, 1, 1))).shape == (0, 2)
    assert overlapping_pairs(Body.sphere(1.0)).shape == (0, 2)
    assert overlapping_pairs(Bodies.spheres([1.0, 2.0])).tolist() == [[0, 1]]


def test_margin_is_monotone():
    """A wider margin loses no pair, and a very wide one has them all."""
    rng = np.random.default_rng(8)
    bodies, T = Bodies.ellipsoids(axes(rng, 50, 2.0)), random_poses(rng, 50, 5.0)
    before: set[tuple[int, ...]] = set()
    for margin in (0.0, 0.1, 1.0, 3.0, 1e3):
        found = {tuple(pair) for pair in overlapping_pairs(bodies, T, margin=margin).tolist()}
        assert before <= found
        before = found
    assert len(before) == 50 * 49 // 2


def test_certified_holds_all_exact_pairs():
    """What the ellipsoids do not prove free includes every pair that meets."""
    rng = np.random.default_rng(9)
    bodies = crowd("hulls", rng, 80)
    T = random_poses(rng, 80, 2.0)
    exact = {tuple(pair) for pair in overlapping_pairs(bodies, T).tolist()}
    certified = {tuple(pair) for pair in overlapping_pairs(bodies, T, method="certified").tolist()}
    assert exact < certified


def test_same_for_any_number_of_threads():
    """The same array from one thread, from two, and again."""
    rng = np.random.default_rng(10)
    n = 3 * crowds.CHUNK
    bodies, T = Bodies.ellipsoids(axes(rng, n, 1.0)), random_poses(rng, n, 15.0)
    before = loewner.get_num_threads()
    found = []
    try:
        for threads in (1, 2, 1):
            loewner.set_num_threads(threads)
            found.append(overlapping_pairs(bodies, T))
    finally:
        loewner.set_num_threads(before)
    assert len(found[0]) > n // 10
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])


def test_order_of_the_bodies_does_not_matter():
    """Bodies in another order: the same pairs under their new numbers."""
    rng = np.random.default_rng(12)
    n = 2000
    bodies, T = Bodies.ellipsoids(axes(rng, n, 2.0)), random_poses(rng, n, 4.0)
    found = overlapping_pairs(bodies, T)
    order = rng.permutation(n)
    again = np.sort(order[overlapping_pairs(bodies[order], T[order])], axis=1)
    assert np.array_equal(again[np.lexsort((again[:, 1], again[:, 0]))], found)


@pytest.mark.parametrize("n", quick(1600, 4000))
def test_search_is_far_from_all_pairs(n):
    """Small ones among large ones: boxes that meet are a small share of all pairs, and every one is reported once."""
    rng = np.random.default_rng(13)
    sizes = axes(rng, n, 3.0)
    T = random_poses(rng, n, 1.5 * np.cbrt((4 * sizes.prod(axis=1)).sum()))
    bodies = Bodies.ellipsoids(sizes)
    crowd = crowds._prepare(bodies, T)
    tree = crowds._tree(crowd)
    rows = np.empty((2, 10 * n), dtype=np.int64)
    leaf, count = entries.meeting_boxes(0, -(-n // columns.WIDE), 0.0, *tree, rows[0], rows[1])
    assert leaf == n // columns.WIDE
    lower, upper = np.empty((n, 3)), np.empty((n, 3))
    entries.body_boxes(0, n, *crowd.steps, crowd.packed.handle, crowd.T, lower, upper)
    meet = ((lower[:, None] <= upper[None]) & (upper[:, None] >= lower[None])).all(axis=2)
    truth = np.argwhere(np.triu(meet, 1))
    assert count == len(truth)
    assert {tuple(p) for p in rows[:, :count].T.tolist()} == {tuple(p) for p in truth.tolist()}
    assert len(truth) < 2 * n


@pytest.mark.parametrize(
    ("arguments", "options", "error", "words"),
    [
        (
            ([Body.sphere(1.0)], None),
            {},
            loewner.InputError,
            "bodies: expected loewner.Bodies or loewner.Body, found list",
        ),
        ((Bodies.spheres([1.0, 1.0]), np.eye(4)), {}, loewner.PoseError, "(n, 4, 4), found (4, 4)"),
        ((Bodies.spheres([1.0, 1.0]), np.tile(np.eye(4), (3, 1, 1))), {}, loewner.PoseError, "2 bodies, found 3"),
        ((Bodies.spheres([1.0, 1.0]), np.zeros((2, 4, 4))), {}, loewner.PoseError, "last row"),
        ((Bodies.spheres([1.0, 1.0]), None), {"margin": -1.0}, loewner.InputError, "margin: expected"),
        ((Bodies.spheres([1.0, 1.0]), None), {"margin": np.inf}, loewner.InputError, "margin: expected"),
        (
            (Bodies.spheres([1.0, 1.0]), None),
            {"depth": 1},
            loewner.InputError,
            "depth: expected True or False, found 1",
        ),
        ((Bodies.spheres([1.0, 1.0]), np.zeros((2, 4, 4))), {"depth": True}, loewner.PoseError, "last row"),
        ((Bodies.spheres([1.0, 1.0]), None), {"method": "guess"}, loewner.UnknownNameError, "exact, certified, found"),
    ],
)
def test_bad_input(arguments, options, error, words):
    """What was expected and what was found."""
    with pytest.raises(error) as caught:
        overlapping_pairs(*arguments, **options)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("make", "argument", "words"),
    [
        (Bodies.spheres, [1.0, 0.0], "radii: expected numbers > 0, found 0.0 at index (1,)"),
        (Bodies.spheres, 1.0, "radii: expected shape (n,), found ()"),
        (Bodies.ellipsoids, [[1.0, 2.0, np.nan]], "semi_axes: expected finite numbers"),
        (Bodies.ellipsoids, [[1.0, 2.0]], "semi_axes: expected shape (n, 3), found (1, 2)"),
    ],
)
def test_bad_sizes(make, argument, words):
    """Sizes that are no sizes are named."""
    with pytest.raises(loewner.InputError) as caught:
        make(argument)
    assert words in str(caught.value)


def test_many_at_once_are_those_one_by_one():
    """`spheres` and `ellipsoids` make the same bodies as their namesakes of `Body`."""
    rng = np.random.default_rng(14)
    sizes = axes(rng, 5, 2.0)
    for many, single in (
        (Bodies.ellipsoids(sizes), Bodies([Body.ellipsoid(s) for s in sizes])),
        (Bodies.spheres(sizes[:, 0]), Bodies([Body.sphere(s) for s in sizes[:, 0]])),
    ):
        for left, right in zip(many._packed.kernel, single._packed.kernel, strict=True):
            np.testing.assert_array_equal(left, right)


# -- depths ------------------------------------------------------------------------------------


FIELDS = ("distance", "witness_a", "witness_b", "normal")


def surfaces(rng: np.random.Generator, n: int) -> Bodies:
    """Solids of triangles, open surfaces, and hulls among them."""
    ball = Body.from_points(pieces("ball 20", 1, seed=3)[0]).pieces[0]
    triangles = ConvexHull(ball.vertices).simplices
    solid = Body.from_surface((ball.vertices, triangles))
    made = [solid, Body.from_surface((ball.vertices, triangles[:5])), Body.from_points(ball.vertices)]
    return Bodies([made[k] for k in rng.integers(3, size=n)])


def curved(rng: np.random.Generator, n: int) -> Bodies:
    """Primitives of every curved kind."""
    made = [
        Body.cylinder(0.4, 0.7),
        Body.cone(0.5, 0.8),
        Body.capsule(0.3, 0.6),
        Body.ellipsoid([0.3, 0.5, 0.7]),
        Body.sphere(0.4),
    ]
    return Bodies([made[k] for k in rng.integers(len(made), size=n)])


MADE = {"surfaces": surfaces, "curved": curved}


def crowd_of(kind: str, n: int = 60) -> tuple[Bodies, np.ndarray]:
    """A crowd of any kind with many pairs that meet, and its poses."""
    rng = np.random.default_rng([6, *map(ord, kind)])
    bodies = MADE[kind](rng, n) if kind in MADE else crowd(kind, rng, n)
    return bodies, random_poses(rng, n, spread=0.8 if kind == "mixed sizes" else 2.0)


def measured(bodies: Body | Bodies, T: np.ndarray, margin: float = 0.0, method: str = "exact") -> loewner.Overlaps:
    """Pairs with their depths, checked to be those that are listed without."""
    found = overlapping_pairs(bodies, T, margin=margin, method=method, depth=True)
    np.testing.assert_array_equal(found.pairs, overlapping_pairs(bodies, T, margin=margin, method=method))
    assert found.distance.shape == (len(found),)
    assert found.normal.shape == found.witness_a.shape == found.witness_b.shape == (len(found), 3)
    return found


@pytest.mark.parametrize("kind", [*KINDS, *MADE])
@pytest.mark.parametrize("margin", quick(0.2, 0.0))
def test_depths_are_those_of_distance(kind, margin):
    """What `distance` says of the pairs one by one, to 1e-9 of the lengths involved, and within its bounds."""
    bodies, T = crowd_of(kind)
    found = measured(bodies, T, margin)
    i, j = found.pairs.T
    truth = loewner.distance(bodies[i], T[i], bodies[j], T[j], exact=True)
    size = 1e-9 * (1.0 + np.linalg.norm(T[i, :3, 3] - T[j, :3, 3], axis=1))
    assert len(found) > 20
    assert (np.abs(found.distance - truth.distance) <= size).all()
    assert (found.distance >= truth.lower).all()
    assert (found.distance <= truth.upper).all()
    for name in FIELDS[1:]:
        np.testing.assert_allclose(getattr(found, name), getattr(truth, name), atol=1e-6)
    assert (found.distance <= margin + 1e-9).all()
    assert (found.distance < 0).any()
    assert (found.distance > 0).any() == (margin > 0)


@pytest.mark.parametrize("kind", KINDS)
def test_depths_do_not_depend_on_the_order(kind):
    """Bodies in reverse order: the same depths, normals turned round, witnesses exchanged."""
    bodies, T = crowd_of(kind)
    n = len(bodies)
    found, other = measured(bodies, T), measured(bodies[np.arange(n)[::-1]], T[::-1])
    place = {pair: k for k, pair in enumerate(map(tuple, (n - 1 - other.pairs[:, ::-1]).tolist()))}
    k = [place[pair] for pair in map(tuple, found.pairs.tolist())]
    np.testing.assert_allclose(other.distance[k], found.distance, atol=1e-9)
    for one, two in (("witness_a", "witness_b"), ("witness_b", "witness_a")):
        gap = np.einsum("kc,kc->k", getattr(other, two)[k] - getattr(found, one), found.normal)
        np.testing.assert_allclose(gap, 0.0, atol=1e-6)
    if kind in ("spheres", "ellipsoids", "mixed sizes"):  # elsewhere directions may tie
        np.testing.assert_allclose(other.normal[k], -found.normal, atol=1e-6)


@pytest.mark.parametrize("kind", ["spheres", "ellipsoids", "mixed sizes", "hulls"])
def test_pushed_apart_by_the_depth_they_touch(kind):
    """Moved along its normal by its depth and a hair, the second of two bodies is free; by a hair less, it is not."""
    bodies, T = crowd_of(kind)
    found = measured(bodies, T)
    i, j = found.pairs.T
    for hair, free in ((1e-7, True), (-1e-7, False)):
        moved = T[j]
        moved[:, :3, 3] += (hair - found.distance)[:, None] * found.normal
        assert (loewner.collide(bodies[i], T[i], bodies[j], moved) != free).all()


def test_witnesses_span_the_depth():
    """witness_b - witness_a is the distance times a unit normal, and both points are on the bodies' boundaries."""
    rng = np.random.default_rng(20)
    axes_of = axes(rng, 80, 1.0)
    T = random_poses(rng, 80, 1.0)
    found = measured(Bodies.ellipsoids(axes_of), T, 0.1)
    assert len(found) > 100
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(found.witness_b - found.witness_a, found.distance[:, None] * found.normal, atol=1e-9)
    for k, points in zip(found.pairs.T, (found.witness_a, found.witness_b), strict=True):
        local = np.einsum("kcr,kc->kr", T[k, :3, :3], points - T[k, :3, 3]) / axes_of[k]
        np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1.0, atol=1e-9)


def test_one_body_at_many_poses_has_depths():
    """A single body stands for all: equal balls in a row, by hand."""
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 1, 3] = 0.75 * np.arange(5)
    found = measured(Body.sphere(0.5), T)
    assert found.pairs.tolist() == [[k, k + 1] for k in range(4)]
    np.testing.assert_allclose(found.distance, -0.25, atol=1e-15)
    np.testing.assert_allclose(found.normal, np.tile([0.0, 1.0, 0.0], (4, 1)), atol=1e-15)


def test_certified_pairs_have_distances_too():
    """What the ellipsoids leave open is measured: some of it is apart, and all that collides is there."""
    rng = np.random.default_rng(9)
    bodies, T = crowd("hulls", rng, 80), random_poses(rng, 80, 2.0)
    found = measured(bodies, T, method="certified")
    hit = {tuple(pair) for pair in found.pairs[found.distance <= 0].tolist()}
    assert hit == {tuple(pair) for pair in overlapping_pairs(bodies, T).tolist()}
    assert (found.distance > 1e-6).any()


@pytest.mark.parametrize("n", [0, 1, 2])
def test_no_pairs_have_no_depths(n):
    """An empty list has empty arrays of the right shapes."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 0, 3] = 10.0 * np.arange(n)
    for bodies in (Body.sphere(1.0), Bodies.spheres(np.ones(n))):
        found = measured(bodies, T)
        assert len(found) == 0
        assert found.pairs.shape == (0, 2)
        assert found.pairs.dtype == np.int64


def test_depths_are_the_same_for_any_number_of_threads():
    """To the bit from one thread and from two, whichever pairs come together."""
    rng = np.random.default_rng(10)
    n = 3 * crowds.CHUNK
    bodies, T = Bodies.ellipsoids(axes(rng, n, 1.0)), random_poses(rng, n, 8.0)
    before = loewner.get_num_threads()
    found = []
    try:
        for threads in (1, 2):
            loewner.set_num_threads(threads)
            found.append(overlapping_pairs(bodies, T, depth=True))
    finally:
        loewner.set_num_threads(before)
    assert len(found[0]) > 2 * crowds.CHUNK
    for name in ("pairs", *FIELDS):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_a_depth_that_cannot_be_settled_is_an_error(monkeypatch):
    """An error that names the pair's row and keeps the answers to all others."""
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, 0, 3] = 0.75 * np.arange(4)
    right = overlapping_pairs(Body.sphere(0.5), T, depth=True)
    measure = entries.distance_range

    def one_left(*arguments):
        left = measure(*arguments)
        arguments[-1][1] = 1  # the status of the second pair
        return left

    monkeypatch.setattr(entries, "distance_range", one_left)
    with pytest.raises(loewner.ConvergenceError, match=r"1 of 3 pairs .* \(1, 2\)") as caught:
        overlapping_pairs(Body.sphere(0.5), T, depth=True)
    assert caught.value.indices.tolist() == [1]
    found = caught.value.partial
    assert found.pairs.tolist() == right.pairs.tolist()
    assert np.isnan(found.distance).tolist() == [False, True, False]
    np.testing.assert_array_equal(found.normal[[0, 2]], right.normal[[0, 2]])


# -- what is refused ---------------------------------------------------------------------------


def test_unsettled_pairs_are_an_error(monkeypatch):
    """A pair that arithmetic cannot settle is named, not dropped."""

    def gives_up(mode, margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out, tally, memory):
        out[:] = Verdict.AMBIGUOUS
        return True

    monkeypatch.setattr(entries, "settle_range", gives_up)
    with pytest.raises(loewner.ConvergenceError, match=r"first of them \(0, 1\)"):
        overlapping_pairs(Bodies.spheres([1.0, 1.0]))


def test_poses_that_are_hardly_rigid_are_refused():
    """A pose that one check lets through and another does not is no proof that nothing overlaps."""
    grid = Body.union([Body.box([1, 1, 1]).transformed(translation(i, j)) for i in range(8) for j in range(8)])
    T = np.tile(np.eye(4), (8, 1, 1))
    T[:, 0, 3] = [0, 0.1, 100, 200, 300, 400, 500, 600]
    # The square of the last entry is off by 1e-6 and a hair.
    T[:, 2, 2] = 1.0000004999998753
    with pytest.raises(loewner.PoseError, match="T_world"):
        overlapping_pairs(Bodies([grid] * 8), T)
    T[:, 2, 2] = 1.0000004999998
    assert overlapping_pairs(Bodies([grid] * 8), T).tolist() == [[0, 1]]
