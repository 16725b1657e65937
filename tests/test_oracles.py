"""The oracles against each other, against closed forms and against two other libraries."""

from fractions import Fraction

import numpy as np
import pytest

from exact import ExactEllipsoid, gap_bounds, rational
from families import (
    EIGHT,
    FAMILIES,
    box_corners,
    near_contact,
    pieces,
    posed_near_contact,
    random_poses,
    rotations,
    translation,
)
from oracles import (
    Hull,
    capsule_support,
    cone_support,
    cylinder_support,
    differences,
    directional_distance,
    ellipsoid_support,
    exact_collides,
    exact_ellipsoid_verdict,
    exact_squared_distance,
    hull,
    naive_distance,
    pack,
    polytope_support,
    posed_gaps,
    posed_support,
    signed_distance,
    signed_distances,
)
from sampling import quick

SOME_FAMILIES = pytest.mark.parametrize(
    "family", [pytest.param(name, marks=[pytest.mark.verify] * (name not in EIGHT)) for name in FAMILIES]
)


@pytest.fixture(scope="module")
def sample() -> dict:
    """A few pairs of every family near contact, with their separating-axis answers."""
    out = {}
    rng = np.random.default_rng(5)
    for family in FAMILIES:
        points = pieces(family, 12)
        pool = pack(map(hull, points))
        i, j = rng.integers(0, 12, size=(2, 24))
        Ta, Tb = near_contact(rng, pool, i, pool, j)
        gap, axis = signed_distances(pool, i, Ta, pool, j, Tb)
        out[family] = points, pool, i, j, Ta, Tb, gap, axis
    return out


@pytest.mark.parametrize("family", FAMILIES)
def test_hulls_are_closed(family: str):
    """Every edge lies in two faces, Euler's formula holds, and all points are behind every face."""
    for points in pieces(family, 20):
        h = hull(points)
        behind = (points @ h.normals.T).max(axis=0) - (h.vertices @ h.normals.T).max(axis=0)
        assert behind.max() <= 1e-12
        if family not in ("needles 1:1e-3:1e-3", "slivers"):  # nearly flat facets merge unevenly there
            assert len(h.vertices) - len(h.edges) + len(h.normals) == 2


def test_boxes_by_hand():
    """Two unit cubes: apart along a face, an edge, a corner; touching; overlapping; one inside the other."""
    cube = hull(box_corners(np.ones(3)))
    assert len(cube.normals) == 6
    assert len(cube.edges) == 12
    still = np.eye(4)
    for t, expected in [((1.5, 0.2, 0.1), 0.5), ((1, 0, 0), 0.0), ((0.9, 0.3, 0), -0.1), ((0, 0, 0), -1.0)]:
        assert signed_distance(cube, still, cube, translation(*t))[0] == pytest.approx(expected, abs=1e-15)
    assert naive_distance(cube, still, cube, translation(2, 2, 0))[0] == pytest.approx(2**0.5, abs=1e-15)
    assert naive_distance(cube, still, cube, translation(2, 2, 2))[0] == pytest.approx(3**0.5, abs=1e-15)
    assert exact_squared_distance(cube.vertices, None, cube.vertices, translation(2, 2, 2)) == 3
    assert exact_collides(cube.vertices, None, cube.vertices, translation(1, 1, 1))
    assert not exact_collides(cube.vertices, None, cube.vertices, translation(np.nextafter(1, 2), 1, 1))
    small = box_corners(np.full(3, 0.25))
    assert exact_collides(cube.vertices, None, small, None)
    assert signed_distance(cube, still, hull(small), still)[0] == pytest.approx(-0.625, abs=1e-15)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("count", quick(5, 12))
def test_separating_axes_against_rationals(sample: dict, family: str, count: int):
    """Same sign as exact arithmetic; where apart, the naive distance is the exact one and proves itself."""
    points, pool, i, j, Ta, Tb, gap, _ = sample[family]
    for p in range(min(count, 5) if "200" in family else count):
        squared = exact_squared_distance(points[i[p]], Ta[p], points[j[p]], Tb[p])
        if abs(gap[p]) > 1e-14:
            assert (squared == 0) == (gap[p] <= 0)
        if gap[p] > 1e-14:
            d, near_a, near_b, proof = naive_distance(pool.hull(i[p]), Ta[p], pool.hull(j[p]), Tb[p])
            assert d == pytest.approx(float(squared) ** 0.5, abs=2e-15)
            assert np.linalg.norm(near_a - near_b) == pytest.approx(d, abs=2e-15)
            # Rounding turns the normal of a short segment, and the proof with it.
            assert abs(d - proof) <= 1e-15 + 3e-14 / d
            assert gap[p] <= d + 1e-15


@SOME_FAMILIES
@pytest.mark.parametrize("count", quick(6, 12))
def test_many_shifts_of_one_turn(family: str, count: int):
    """The listed faces give what the separating axes give, and above 1e-14 of the lengths the sign is the exact one."""
    rng = np.random.default_rng(6)
    points = pieces(family, count)
    pool = pack(map(hull, points))
    i, j = np.arange(count), rng.permutation(count)
    faces = differences(pool, i, pool, j, rotations(rng, count))
    pair = np.tile(i, 8)
    Ta, Tb = posed_near_contact(rng, faces, pair, grazing=1.0)
    gap, axis = posed_gaps(faces, pair, Ta, Tb)
    same, _ = signed_distances(pool, i[pair], Ta, pool, j[pair], Tb)
    size = faces.size[pair] + np.linalg.norm(Tb[:, :3, 3] - Ta[:, :3, 3], axis=1)
    assert (np.abs(gap - same) <= 3e-15 * size).all()
    assert np.linalg.norm(axis, axis=1) == pytest.approx(np.ones(len(pair)), abs=1e-14)
    nearest = np.argsort(np.abs(gap) / size)[:count]
    assert (np.abs(gap[nearest]) < 1e-10 * size[nearest]).all()
    for p in nearest:
        if abs(gap[p]) > 1e-14 * size[p]:
            assert exact_collides(points[i[pair[p]]], Ta[p], points[j[pair[p]]], Tb[p]) == (gap[p] <= 0)


@SOME_FAMILIES
def test_separating_axes_against_directions(sample: dict, family: str):
    """The penetration depth is the largest gap over the whole sphere; no direction beats the axes."""
    points, _, i, j, Ta, Tb, gap, axis = sample[family]
    for p in np.argsort(gap)[:2]:
        assert gap[p] < 0
        a = posed_support(polytope_support(points[i[p]]), Ta[p])
        b = posed_support(polytope_support(points[j[p]]), Tb[p])
        found, _ = directional_distance(a, b)
        assert found <= gap[p] + 1e-14
        assert found == pytest.approx(gap[p], rel=1e-3)
        n = axis[p][None]
        assert np.linalg.norm(n) == pytest.approx(1, abs=1e-14)
        assert float((n * (b(-n) - a(n))).sum()) == pytest.approx(gap[p], abs=1e-14)


def test_depth_is_what_it_takes_to_part(sample: dict):
    """Moved along the axis by a little more than the depth the pair is apart; by a little less it still meets."""
    for family in EIGHT:
        points, pool, i, j, Ta, Tb, gap, axis = sample[family]
        p = int(np.argmin(gap))
        for more, meets in [(1 - 1e-9, True), (1 + 1e-9, False)]:
            moved = Tb[p].copy()
            moved[:3, 3] -= gap[p] * more * axis[p]
            assert exact_collides(points[i[p]], Ta[p], points[j[p]], moved) == meets


def test_scale_does_not_matter_to_axes(sample: dict):
    """A common power-of-two scale multiplies the answer, bit by bit."""
    _, pool, i, j, Ta, Tb, gap, _ = sample["ball 20"]
    big = pool._replace(vertices=pool.vertices * 1024)
    Sa, Sb = Ta.copy(), Tb.copy()
    Sa[:, :3, 3] *= 1024
    Sb[:, :3, 3] *= 1024
    assert np.array_equal(signed_distances(big, i, Sa, big, j, Sb)[0], 1024 * gap)


# -- against other libraries ------------------------------------------------------------------------


def test_distance_against_cvxpy(sample: dict):
    """A conic solver finds the same distance of separated pairs."""
    cp = pytest.importorskip("cvxpy")
    checked = 0
    for family in ("ball 20", "boxes", "plates 1:1:0.05", "tetrahedra"):
        points, pool, i, j, Ta, Tb, gap, _ = sample[family]
        for p in np.flatnonzero(gap > 1e-3)[:3]:
            A = points[i[p]] @ Ta[p, :3, :3].T + Ta[p, :3, 3]
            B = points[j[p]] @ Tb[p, :3, :3].T + Tb[p, :3, 3]
            u, w = cp.Variable(len(A), nonneg=True), cp.Variable(len(B), nonneg=True)
            problem = cp.Problem(cp.Minimize(cp.norm(u @ A - w @ B)), [cp.sum(u) == 1, cp.sum(w) == 1])
            problem.solve(solver=cp.CLARABEL)
            d = naive_distance(pool.hull(i[p]), Ta[p], pool.hull(j[p]), Tb[p])[0]
            assert problem.value == pytest.approx(d, abs=1e-6)
            checked += 1
    assert checked >= 8


def coal_convex(coal, points: np.ndarray):
    vectors = coal.StdVec_Vec3s()
    for x in points:
        vectors.append(x)
    return coal.Convex.convexHull(vectors, True, None)


def coal_pose(coal, T: np.ndarray):
    return coal.Transform3s(T[:3, :3], T[:3, 3])


def test_signed_distance_against_coal(sample: dict):
    """Coal's signed distance agrees on distance and depth, away from its own tolerance of 1e-6."""
    coal = pytest.importorskip("coal")
    checked = 0
    for family in EIGHT:
        points, pool, i, j, Ta, Tb, gap, _ = sample[family]
        for p in range(12):
            a, b = coal_convex(coal, points[i[p]]), coal_convex(coal, points[j[p]])
            result = coal.DistanceResult()
            found = coal.distance(a, coal_pose(coal, Ta[p]), b, coal_pose(coal, Tb[p]), coal.DistanceRequest(), result)
            if abs(gap[p]) < 1e-5:
                continue
            apart = gap[p] > 0
            d = naive_distance(pool.hull(i[p]), Ta[p], pool.hull(j[p]), Tb[p])[0] if apart else gap[p]
            assert found == pytest.approx(d, abs=2e-5)
            checked += 1
    assert checked > 75


# -- ellipsoids and other curved bodies --------------------------------------------------------------


def test_exact_ellipsoids_by_hand():
    """Balls that touch exactly, by one bit more and one bit less."""
    ball, o = np.eye(3), np.zeros(3)
    assert exact_ellipsoid_verdict(o, ball, None, o, ball, translation(2, 0, 0)) == -1
    assert exact_ellipsoid_verdict(o, ball, None, o, ball, translation(np.nextafter(2, 3), 0, 0)) == 1
    assert exact_ellipsoid_verdict(o, ball, None, o, ball, translation(np.nextafter(2, 1), 0, 0)) == -1
    assert exact_ellipsoid_verdict(o, ball, None, o, ball, None) == -1
    thin = np.diag([1.0, 1e-6, 1e-6])
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = quarter, (0, 0, 2.000001e-6)
    assert exact_ellipsoid_verdict(o, thin, None, o, thin, T) == 1
    T[2, 3] = 1.999999e-6
    assert exact_ellipsoid_verdict(o, thin, None, o, thin, T) == -1


@pytest.mark.parametrize("count", quick(8, 20))
def test_exact_ellipsoids_against_directions(rng: np.random.Generator, count: int):
    """The rational verdict has the sign of the largest gap between supporting planes."""
    seen = set()
    poses = random_poses(rng, 2 * count, 1.0)
    for k in range(count):
        axes_a, axes_b = rng.uniform(0.1, 1, size=(2, 3))
        Ta, Tb = poses[2 * k], poses[2 * k + 1]
        a, b = posed_support(ellipsoid_support(axes_a), Ta), posed_support(ellipsoid_support(axes_b), Tb)
        d, _ = directional_distance(a, b)
        verdict = exact_ellipsoid_verdict(np.zeros(3), np.diag(axes_a), Ta, np.zeros(3), np.diag(axes_b), Tb)
        assert verdict == np.sign(d)
        seen.add(verdict)
    assert seen == {-1, 1}


def test_supports_are_supports(rng: np.random.Generator):
    """No point of a dense cloud of the body lies beyond the support, and some point comes close."""
    d = rotations(rng, 50)[:, 0]
    turn = np.linspace(0, 2 * np.pi, 400)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    from oracles import fibonacci_sphere

    ball = fibonacci_sphere(20000)
    up = np.array([0, 0, 1.0])
    for support, cloud in [
        (ellipsoid_support([0.5, 1, 2]), ball * [0.5, 1, 2]),
        (cylinder_support(0.7, 2), np.concatenate([0.7 * ring + up, 0.7 * ring - up])),
        (capsule_support(0.7, 2), np.concatenate([0.7 * ball + up, 0.7 * ball - up])),
        (cone_support(0.7, 2), np.concatenate([0.7 * ring - up, [up]])),
    ]:
        height = np.einsum("ki,ki->k", d, support(d))
        found = (d @ cloud.T).max(axis=1)
        assert (found <= height + 1e-12).all()
        assert (found >= height - 1e-3).all()


def test_directions_closed_forms():
    """Balls and capsules: distance and depth of the segments less the radii."""
    ball = ellipsoid_support([0.5, 0.5, 0.5])
    for t, expected in [((2, 1, 0.5), 5.25**0.5 - 1), ((0.3, 0.2, 0), 0.13**0.5 - 1)]:
        assert directional_distance(ball, posed_support(ball, translation(*t)))[0] == pytest.approx(expected, abs=1e-9)
    capsule = capsule_support(0.25, 2)
    lying = translation(0, 0.7, 0.1)
    lying[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    assert directional_distance(capsule, posed_support(capsule, lying))[0] == pytest.approx(0.2, abs=1e-9)


def test_fractions_see_what_floats_do_not():
    """Two tetrahedra whose gap is 2**-1074: apart, and exactly so."""
    tetrahedron = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    other = -tetrahedron
    tiny = 2.0**-1074
    assert exact_squared_distance(tetrahedron, None, other, translation(0, 0, -tiny)) == Fraction(tiny) ** 2
    assert exact_squared_distance(tetrahedron, None, other, translation(0, 0, tiny)) == 0


def test_hull_is_a_record():
    """Pools give back the hulls they were packed from."""
    hulls = [hull(p) for p in pieces("ball 20", 3)]
    pool = pack(hulls)
    assert pool.size == 3
    for k, h in enumerate(hulls):
        assert isinstance(pool.hull(k), Hull)
        for ours, packed in zip(h, pool.hull(k), strict=True):
            assert np.array_equal(ours, packed)


def test_exact_gaps_by_hand():
    """Balls of radius 1 and 2 along x: the gap of planes is exact to the last bit, whatever the direction's length."""
    T = translation(np.nextafter(3.0, 4.0), 0, 0)
    small, large = (ExactEllipsoid(np.zeros(3), r * np.eye(3), P) for r, P in ((1.0, np.eye(4)), (2.0, T)))
    for length in (1.0, 3.0):
        low, high = gap_bounds(small, large, np.array([length, 0.0, 0.0]))
        assert 0 <= low <= high
        assert float(low) == float(high) == np.spacing(3.0)
    low, high = gap_bounds(small, large, np.array([0.0, 1.0, 0.0]))
    assert float(low) == float(high) == -3.0
    assert large.contains(rational(np.array([1 + np.spacing(3.0), 0.0, 0.0])))
    assert not large.contains(rational(np.array([1.0, 0.0, 0.0])))
    assert small.contains(rational(np.array([1.0, 0.0, 0.0])))


def test_exact_containment_of_a_sheared_ellipsoid():
    """Images of points in and on the unit ball under a general factor are inside, those beyond are not."""
    rng = np.random.default_rng(7)
    F = rng.integers(-3, 4, size=(3, 3)) + 5 * np.eye(3)
    E = ExactEllipsoid(np.array([1.0, 2.0, 3.0]), F, translation(0.5, 0, 0))
    for u in np.eye(3):
        on = np.array([1.5, 2.0, 3.0]) + F @ u
        assert E.contains(rational(on))
        assert not E.contains(rational(on + F @ u * 2.0**-40))
        assert E.contains(rational(on - F @ u * 2.0**-40))
