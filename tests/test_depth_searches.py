"""Penetration depths and ellipsoid distances: closed forms, naive references, laws, and a rival as judge."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

import loewner
from families import FAMILIES, box_corners, near_contact, pieces, random_poses, rotations, stretch, translation
from loewner import Bodies, Body
from loewner._kernels import codes
from loewner._kernels.ellipsoids import signed_distance
from loewner._kernels.narrow import epa_fast, epa_robust
from loewner._kernels.records import Placed
from oracles import directional_distance, ellipsoid_support, fibonacci_sphere, hull, pack, posed_support
from sampling import examples, quick

seeds = st.integers(0, 2**32 - 1)


def exact(a: Any, Ta: Any, b: Any, Tb: Any) -> loewner.Distance:
    return loewner.distance(a, Ta, b, Tb, exact=True)


def turned(rng: np.random.Generator, count: int, spread: float) -> np.ndarray:
    """Poses with uniform rotations, translations up to `spread` long."""
    T = random_poses(rng, count, 0.0)
    along = rng.normal(size=(count, 3))
    T[:, :3, 3] = spread * rng.uniform(size=(count, 1)) * along / np.linalg.norm(along, axis=1, keepdims=True)
    return T


# -- ellipsoids: closed forms ----------------------------------------------------------------------------------


def point_to_ellipsoid(axes: np.ndarray, p: np.ndarray) -> float:
    """Signed distance of a point off the coordinate planes, from the root of the confocal equation."""
    least = axes.min() ** 2

    def level(t: float) -> float:
        return float(((axes * p / (axes**2 + t)) ** 2).sum()) - 1

    low = -least + 1e-12 * least
    high = float(np.linalg.norm(p) * axes.max())
    t = brentq(level, low, high, xtol=1e-15 * least, rtol=1e-15, maxiter=500)
    return float(np.copysign(np.linalg.norm(t * p / (axes**2 + t)), t))


@pytest.mark.parametrize("count", quick(60, 200))
def test_ball_and_ellipsoid_by_the_confocal_root(count: int):
    """The distance of a ball is that of its center less the radius, inside and outside, in either order."""
    rng = np.random.default_rng(3)
    for _ in range(count):
        axes = rng.uniform(0.2, 2, size=3)
        p, r = rng.uniform(-2, 2, size=3), rng.uniform(0.01, 1)
        T = turned(rng, 1, 3.0)[0]
        ball = T @ translation(*p)
        expected = point_to_ellipsoid(axes, p) - r
        for found in (
            exact(Body.ellipsoid(axes), T, Body.sphere(r), ball),
            exact(Body.sphere(r), ball, Body.ellipsoid(axes), T),
        ):
            assert found.distance == pytest.approx(expected, abs=1e-13)
            assert found.witness_b - found.witness_a == pytest.approx(found.distance * found.normal, abs=1e-13)


@pytest.mark.parametrize("thin", [1.0, 1e-2, 1e-4, 1e-6])
def test_concentric_ellipsoids_with_common_axes(thin: float):
    """The depth is the least a_i + b_i: the sum of the supports is concave in the squares of the normal."""
    rng = np.random.default_rng(int(-np.log10(thin)))
    for R in rotations(rng, 30):
        a, b = (thin ** rng.uniform(0, 1, size=3) for _ in range(2))
        T = np.eye(4)
        T[:3, :3] = R
        found = exact(Body.ellipsoid(a), T, Body.ellipsoid(b), T)
        assert found.distance == pytest.approx(-(a + b).min(), abs=1e-12)


@pytest.mark.parametrize("thin", [1.0, 1e-3, 1e-6])
def test_ellipsoids_apart_along_a_common_axis(thin: float):
    """Tip against tip: the centers' distance less two semi-axes, from 1e-9 to far apart."""
    rng = np.random.default_rng(4)
    for gap in (1e-9, 1e-3, 1.0, 1e3):
        for R in rotations(rng, 10):
            a, b = (thin ** rng.uniform(0, 1, size=3) for _ in range(2))
            axis = rng.integers(3)
            T = np.eye(4)
            T[:3, :3] = R
            along = np.zeros(3)
            along[axis] = a[axis] + b[axis] + gap
            found = exact(Body.ellipsoid(a), T, Body.ellipsoid(b), T @ translation(*along))
            assert found.distance == pytest.approx(gap, abs=1e-12 * (2 + gap))
            if gap >= 1e-3:
                assert found.normal == pytest.approx(R[:, axis], abs=1e-9)


def test_spheres_written_as_ellipsoids():
    """Equal axes: every direction ties about one centre, and Newton's matrix vanishes there."""
    a, b = Body.ellipsoid([0.5] * 3), Body.ellipsoid([0.25] * 3)
    for t in [(0, 0, 0), (1e-15, 0, 0), (0, 1e-9, 1e-9), (0.1, 0, 0), (0.3, 0.4, 0.5), (3, -4, 12)]:
        found = exact(a, None, b, translation(*t))
        assert found.distance == pytest.approx(np.linalg.norm(t) - 0.75, abs=1e-13 * (1 + np.linalg.norm(t)))


# -- ellipsoids: naive reference -------------------------------------------------------------------------------


def compare_with_directions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.1, 1, size=(2, 3))
    Ta, Tb = turned(rng, 2, 10 ** rng.uniform(-3, 0))
    found = exact(Body.ellipsoid(a), Ta, Body.ellipsoid(b), Tb)
    truth, _ = directional_distance(
        posed_support(ellipsoid_support(a), Ta), posed_support(ellipsoid_support(b), Tb), 2000
    )
    assert found.distance == pytest.approx(truth, abs=1e-9)


@examples(8, 20)
@given(seeds)
def test_ellipsoids_against_directions(seed: int):
    """No direction of a dense grid, polished from its best starts, shows a shallower way out or a wider gap."""
    compare_with_directions(seed)


@pytest.mark.verify
@given(seeds)
def test_more_ellipsoids_against_directions(seed: int):
    """The same law with twice as many pairs."""
    compare_with_directions(seed)


@pytest.mark.verify  # it compiles the search for the least depth, which it calls directly
def test_the_nearest_way_out_is_not_the_shortest():
    """Deep pairs have several local minima: downhill from a random direction is often another than the least found."""
    rng = np.random.default_rng(8)
    grid = fibonacci_sphere(20_000)
    misled = 0
    for _ in range(200):
        FA, FB = (rotations(rng, 1)[0] * rng.uniform(0.1, 1, size=3) for _ in range(2))
        c = 0.3 * rng.uniform(size=3)
        start = tuple(rotations(rng, 1)[0, 0])
        factors = tuple(FA.ravel()), tuple(FB.ravel()), tuple(c)
        _, local, _ = signed_distance.descend(*factors, start, 3.0)
        n, h, lower, slope = signed_distance.global_minimum(*factors, start, 3.0)
        heights = np.linalg.norm(grid @ FA, axis=1) + np.linalg.norm(grid @ FB, axis=1) - grid @ c
        assert h <= heights.min() + 1e-14
        assert h - lower <= 1e-10
        assert slope <= 1e-12
        assert np.linalg.norm(np.array(n) @ FA) + np.linalg.norm(np.array(n) @ FB) - n @ c == pytest.approx(
            h, abs=1e-14
        )
        misled += local > h + 1e-6
    assert misled > 10


@pytest.mark.verify  # it compiles the search for the least depth, which it calls directly
def test_an_ellipsoid_within_proves_only_the_least():
    """Its proof holds for no minimum that has a lower one beside it, nor for one made deeper; it holds for most."""
    rng = np.random.default_rng(12)
    proven, misled, deep = 0, 0, 0
    for _ in range(400):
        thin = 10 ** rng.uniform(-1.5, 0)
        FA, FB = (rotations(rng, 1)[0] * rng.uniform(thin, 1, size=3) for _ in range(2))
        factors = tuple(FA.ravel()), tuple(FB.ravel()), tuple(rng.uniform(0.1, 0.5) * rng.normal(size=3))
        local, height, _ = signed_distance.descend(*factors, tuple(rotations(rng, 1)[0, 0]), 3.0)
        least, h, _, _ = signed_distance.global_minimum(*factors, local, 3.0)
        lower_beside = height > h + 1e-9
        claimed = signed_distance.is_least(*factors[:2], local, height)
        assert not (claimed and lower_beside)
        if h > 0:
            deep += 1
            proven += signed_distance.is_least(*factors[:2], least, h)
            width = np.linalg.norm(np.array(least) @ FA) + np.linalg.norm(np.array(least) @ FB)
            assert not signed_distance.is_least(*factors[:2], least, width)  # only a ball is as deep as it is wide
        misled += lower_beside
    assert misled > 10
    assert deep > 100
    assert proven > 0.7 * deep


@pytest.mark.parametrize("count", quick(40, 100))
def test_enclosing_depth_is_concave_and_enough(count: int):
    """What the proof rests on: D is the least over all directions, concave, and at the right r no more than h."""
    rng = np.random.default_rng(2)
    for _ in range(count):
        FA, FB = (rotations(rng, 1)[0] * 10 ** rng.uniform(-2, 0, size=3) for _ in range(2))
        P, Q = (tuple((F @ F.T)[np.triu_indices(3)]) for F in (FA, FB))
        c = tuple(rng.uniform(-0.5, 0.5, size=3))

        def depth(p: float, q: float, P: Any = P, Q: Any = Q, c: Any = c) -> float:
            return signed_distance.enclosing_depth(p, q, P, Q, c, np.eye(3))[0]

        one, two = 10 ** rng.uniform(-1, 2, size=(2, 2))
        middle = 0.5 * (one + two)
        assert depth(*middle) >= 0.5 * (depth(*one) + depth(*two)) - 1e-12
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        ha, hb = np.linalg.norm(FA.T @ n), np.linalg.norm(FB.T @ n)
        ratio = ha / hb
        assert depth(1 + 1 / ratio, 1 + ratio) <= ha + hb - n @ c + 1e-13
        p, q = one
        M = p * FA @ FA.T + q * FB @ FB.T
        value, normal = signed_distance.enclosing_depth(p, q, P, Q, c, np.eye(3))
        assert np.sqrt(normal @ M @ normal) - np.dot(normal, c) == pytest.approx(value, abs=1e-12 * p)
        grid = fibonacci_sphere(500)
        assert value <= (np.sqrt(np.einsum("ki,ij,kj->k", grid, M, grid)) - grid @ c).min() + 1e-12


# -- ellipsoids: laws ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spread", [2.0, 1e-3, 1e-15, *(pytest.param(k, marks=pytest.mark.verify) for k in (0.3, 1e-9, 0.0))]
)
@pytest.mark.parametrize("thin", [1.0, 0.1, 1e-3, 1e-6])
@pytest.mark.parametrize("count", quick(6, 40))
def test_round_pairs_obey_the_laws(thin: float, spread: float, count: int):
    """Settled for every ratio of axes, at any depth; order, common motion and scale change nothing."""
    rng = np.random.default_rng(17)

    def some(scale: float) -> list[Body]:
        choice = np.random.default_rng(5)
        made = []
        for _ in range(count):
            axes, ball = thin ** choice.uniform(size=3), choice.uniform() < 0.2
            made.append(Body.sphere(scale * axes[0]) if ball else Body.ellipsoid(scale * axes))
        return made

    a, b = Bodies(some(1.0)), Bodies(some(1.0)[::-1])
    Ta, Tb = turned(rng, count, 0.0), turned(rng, count, spread)
    Ta[::2, :3, :3] = Tb[::2, :3, :3]
    found = exact(a, Ta, b, Tb)
    assert found.witness_b - found.witness_a == pytest.approx(found.distance[:, None] * found.normal, abs=1e-9)
    colliding = loewner.collide(a, Ta, b, Tb)
    clear = np.abs(found.distance) > 1e-12
    assert np.array_equal(colliding[clear], found.distance[clear] <= 0)
    assert exact(b, Tb, a, Ta).distance == pytest.approx(found.distance, abs=1e-11)
    move = turned(rng, 1, 1.0)[0]
    assert exact(a, move @ Ta, b, move @ Tb).distance == pytest.approx(found.distance, abs=1e-11)
    larger = [T.copy() for T in (Ta, Tb)]
    for T in larger:
        T[:, :3, 3] *= 2.0**20
    big = Bodies(some(2.0**20)), Bodies(some(2.0**20)[::-1])
    assert exact(big[0], larger[0], big[1], larger[1]).distance / 2.0**20 == pytest.approx(found.distance, abs=1e-11)


@pytest.mark.parametrize("count", quick(40, 100))
def test_coal_agrees_on_ellipsoids(count: int):
    """Apart or shallow, Coal's distances are ours to its own accuracy; deep, its polytope inside A - B falls short."""
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(6)
    for reach, tolerance in ((3.0, 2e-4), (0.5, 3e-2)):
        for _ in range(count):
            a, b = rng.uniform(0.3, 1, size=(2, 3))
            Ta, Tb = turned(rng, 2, reach)
            ours = float(exact(Body.ellipsoid(a), Ta, Body.ellipsoid(b), Tb).distance)
            poses = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (Ta, Tb)]
            theirs = coal.distance(
                coal.Ellipsoid(*a),
                poses[0],
                coal.Ellipsoid(*b),
                poses[1],
                coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            assert theirs - tolerance <= ours <= theirs + 1e-5


# -- polytopes: the fast search --------------------------------------------------------------------------------


def both_depths(a: Bodies, Ta: np.ndarray, b: Bodies, Tb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Status and depth of the fast search, depth of the careful one, pair by pair."""
    A, B = a._packed.kernel, b._packed.kernel
    W, K = epa_fast.workspace()
    work = epa_robust.workspace(True)
    found = np.empty((len(Ta), 3))
    result = np.empty(9)
    for k in range(len(Ta)):
        d = tuple(Tb[k, :3, 3] - Ta[k, :3, 3])
        one, other = Placed(*A[:3], k, Ta, k), Placed(*B[:3], k, Tb, k)
        status, _, fast = epa_fast.overlap_depth(one, other, d, W, K, result)
        _, careful = epa_robust.penetration(one, other, d, 1e-11, work, result)
        found[k] = status, fast, careful
    return found[:, 0], found[:, 1], found[:, 2]


@pytest.mark.verify  # it compiles the searches, which it calls directly
@pytest.mark.parametrize("family", FAMILIES)
def test_fast_depth_is_the_careful_one(family: str):
    """Where the fast search answers, it answers the depth; it leaves few overlapping pairs open, and all others."""
    rng = np.random.default_rng(23)
    points = pieces(family, 60, seed=3)
    pool, i = pack(map(hull, points)), np.arange(60)
    bodies = Bodies.from_points(points)
    Ta, Tb = near_contact(rng, pool, i, pool, i[::-1], stretch=stretch(family))
    status, fast, careful = both_depths(bodies, Ta, bodies[i[::-1]], Tb)
    settled = status == codes.DEPTH_FOUND
    assert fast[settled] == pytest.approx(careful[settled], abs=1e-13)
    assert not settled[careful < -1e-9].any()
    overlapping = careful > 1e-9
    assert overlapping.sum() > 10
    assert settled[overlapping].mean() > 0.85


@pytest.mark.verify  # it compiles the searches, which it calls directly
def test_fast_depth_gives_up_on_too_much():
    """More corners than fit, or more faces than a mask has bits: unsettled, and the answer is right all the same."""
    ball = fibonacci_sphere(1500)
    for points in (ball, ball[::4]):
        body = Body.from_points(points)
        T = translation(0.3, 0.2, 0.1)[None]
        status, _, careful = both_depths(Bodies([body]), np.eye(4)[None], Bodies([body]), T)
        if len(points) > epa_fast.MAX_CORNERS:
            assert status[0] == codes.UNSETTLED
        assert exact(body, None, body, T).distance == pytest.approx(-careful, abs=1e-12)


@pytest.mark.verify  # it compiles the searches, which it calls directly
def test_fast_depth_of_boxes_by_hand():
    """Boxes with common axes: the least overlap of their intervals, ties and concentric pairs included."""
    rng = np.random.default_rng(9)
    for trial in range(100):
        a, b = rng.choice([0.5, 1.0, 2.0], size=(2, 3))
        t = rng.choice([0.0, 0.125, -0.25, 0.5], size=3) * (trial > 5)
        R = random_poses(rng, 1, 1.0)[0]
        status, fast, _ = both_depths(
            Bodies.from_points([box_corners(a)]),
            R[None],
            Bodies.from_points([box_corners(b)]),
            (R @ translation(*t))[None],
        )
        depth = (0.5 * (a + b) - np.abs(t)).min()
        if depth > 1e-9:
            assert status[0] == codes.DEPTH_FOUND
            assert fast[0] == pytest.approx(depth, abs=1e-14)


def test_a_face_as_near_as_another():
    """Boxes that graze: of two faces equally near the search once took the plane of the wrong one."""
    a = Body.box(2 * np.array([0.28195053334245374, 0.3921773857960926, 0.41066578891763955]))
    b = Body.box(2 * np.array([0.6060017806165992, 0.626524828930082, 0.44474607461149374]))
    Ta, Tb = np.eye(4), np.eye(4)
    Ta[:3] = [
        [0.5851015164985044, 0.75734850864608, 0.28996456997831455, -0.08529079794690442],
        [0.6604804904622117, -0.6524991395585102, 0.3714975028101814, 0.8233153575559051],
        [0.47055471213233735, -0.02584781087370308, -0.8819921505110413, -0.9043115176658729],
    ]
    Tb[:3] = [
        [-0.42689243384016695, -0.44133420971115267, -0.7892952332737423, 0.23081673330106722],
        [-0.5938528016091461, -0.5214265355074927, 0.6127423749746885, -0.1390775809964332],
        [-0.6819836507944946, 0.7303002693463052, -0.03949451407128679, -0.10633146170414406],
    ]
    assert exact(a, Ta, b, Tb).distance == pytest.approx(-3.411155857779846e-09, abs=1e-13)


@pytest.mark.parametrize("curved", [Body.cylinder(0.1, 0.3), Body.cone(0.1, 0.3)], ids=["cylinder", "cone"])
@pytest.mark.parametrize("count", quick(70, 200))
def test_shallow_overlaps_of_hulls_and_curved_pieces(curved: Body, count: int):
    """Overlaps down to 1e-9 m are settled, and no shorter way along the normal of the depth leads out of one."""
    rng = np.random.default_rng(36)
    for _ in range(count):
        made = Body.from_points(0.1 * rng.normal(size=(20, 3)))
        Ta, Tb = random_poses(rng, 2, 0.0)
        along = rng.normal(size=3)
        Tb[:3, 3] = along / np.linalg.norm(along)
        apart = exact(made, Ta, curved, Tb)
        for overlap in (1e-5, 1e-7, 1e-9):
            T = Tb.copy()
            T[:3, 3] -= (apart.distance + overlap) * apart.normal
            found = exact(made, Ta, curved, T)
            assert loewner.collide(made, Ta, curved, T) == (found.distance < 0.0)
            if found.distance > -1e-10:  # apexes pass each other
                continue
            for share, hit in ((0.9, True), (1.1, False)):
                out = T.copy()
                out[:3, 3] -= share * found.distance * found.normal
                assert loewner.collide(made, Ta, curved, out) == hit
