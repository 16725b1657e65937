"""The rounding margin under attack: pairs at contact, judged in rational arithmetic.

Certified verdicts must be true at whatever distance from contact, in single precision as in double. The long version
(``-m verify``) is the same on more pairs.
"""

from functools import lru_cache

import numpy as np
import pytest

import loewner
from contacts import APART, MEETING, Contacts, Setting, contacts, ellipsoid_bodies, judge
from families import box_corners, pieces, rotations
from loewner import Bodies, Body, Verdict
from oracles import exact_collides, hull, pack, signed_distances
from sampling import quick

SETTINGS = {
    "balls": Setting(("balls", "balls")),
    "round": Setting(("round", "round")),
    "needles": Setting(("needles", "needles")),
    "needle and disc": Setting(("needles", "discs")),
    "thinner than single precision": Setting(("thin", "thin")),
    "single precision poses": Setting(("round", "needles"), turn="float32"),
    "bent poses": Setting(("discs", "round"), turn="bent"),
    "smallest": Setting(("round", "needles"), 2e-3, 2e-3),
    "below single precision": Setting(("round", "round"), 1e-5, 1e-4),
    "largest": Setting(("discs", "round"), 500.0, 500.0),
    "small and large": Setting(("round", "round"), 2e-3, 500.0),
    "far from the world's origin": Setting(("round", "needles"), world=1e6),
    "far, in single precision": Setting(("round", "discs"), world=1e6, turn="float32"),
    "far from the body's origin": Setting(("round", "needles"), offset=500.0),
    "small, far from the body's origin": Setting(("discs", "round"), 1e-2, 1e-2, offset=500.0, turn="bent"),
    "far from both": Setting(("needles", "discs"), offset=500.0, world=1e4),
}
BODIES = 10


def wrong_and_judged(
    rng: np.random.Generator, a: Bodies, b: Bodies, each: int, setting: Setting, margin: float, alone: bool
) -> tuple[int, int, int]:
    """Pairs with the outer ellipsoids at the margin, then the inner: wrong verdicts, proven ones, and not judged."""
    wrong = proven = unknown = 0
    for A, B, verdict, truth in (
        (a.outer, b.outer, Verdict.FREE, APART),
        (a.inner, b.inner, Verdict.COLLIDING, MEETING),
    ):
        # The ellipsoids certify margins less tightly than contact: more pairs must be farther from it.
        c = contacts(rng, A, B, each, setting, margin, (-17.0, -1.0) if margin == 0 else (-13.0, 1.0))
        for p in np.flatnonzero(answers(a, b, c, each, margin, alone) == verdict):
            found = judge(A, B, c, p, margin)
            wrong += found == -truth
            proven += found == truth
            unknown += found not in (APART, MEETING)
    return wrong, proven, unknown


@lru_cache(maxsize=2)
def singles(bodies: Bodies) -> list[Body]:
    """Each of them as a body of its own."""
    return list(bodies)


def answers(a: Bodies, b: Bodies, c: Contacts, each: int, margin: float, alone: bool) -> np.ndarray:
    """Verdicts of all pairs in one call, or each by itself."""
    if alone:
        one = list(zip(singles(a), singles(b), strict=True))
        calls = zip(c.k, c.Ta, c.Tb, strict=True)
        return np.array([loewner.classify(one[k][0], Ta, one[k][1], Tb, margin=margin) for k, Ta, Tb in calls])
    shape = (each, len(a), 4, 4)
    return loewner.classify(a, c.Ta.reshape(shape), b, c.Tb.reshape(shape), margin=margin).ravel()


@pytest.mark.parametrize("each", quick(1, 200))
@pytest.mark.parametrize("name", SETTINGS)
def test_ellipsoids_at_contact(name: str, each: int):
    """FREE is never said of outer ellipsoids with a common point, nor COLLIDING of inner ones that a plane parts."""
    s = SETTINGS[name]
    rng = np.random.default_rng([1, sum(name.encode())])
    a = ellipsoid_bodies(rng, s.shapes[0], BODIES, s.size_a, s.offset)
    b = ellipsoid_bodies(rng, s.shapes[1], BODIES, s.size_b, 0.0)
    tally = np.zeros(3, int)
    for first, second in ((a, b), (b, a)):
        for alone in (False, True):
            tally += wrong_and_judged(rng, first, second, each, s, 0.0, alone)
    print(f"\n{name:36s} wrong {tally[0]}, proven right {tally[1]}, undecided {tally[2]}")
    assert tally[0] == 0
    assert tally[1] > 4 * each  # of 40 pairs for each round, half on the side that can be certified
    assert tally[2] == 0


@pytest.mark.parametrize("each", [5, pytest.param(200, marks=pytest.mark.verify)])
@pytest.mark.parametrize("margin", [1e-2, *(pytest.param(k, marks=pytest.mark.verify) for k in (1e-6, 1.0))])
@pytest.mark.parametrize("name", ["balls", "round", "needle and disc", "far from the world's origin", "bent poses"])
def test_ellipsoids_at_a_margin(name: str, margin: float, each: int):
    """The same about a margin: FREE is proven farther, and COLLIDING is never said of pairs that are."""
    s = SETTINGS[name]
    rng = np.random.default_rng([2, sum(name.encode())])
    a = ellipsoid_bodies(rng, s.shapes[0], BODIES, s.size_a, 0.0)
    b = ellipsoid_bodies(rng, s.shapes[1], BODIES, s.size_b, 0.0)
    wrong, proven, unknown = wrong_and_judged(rng, a, b, each, s, margin, False)
    print(f"\n{name:30s} margin {margin:g}: wrong {wrong}, proven right {proven}, undecided {unknown}")
    assert wrong == 0
    assert unknown == 0
    assert 2 * proven > each  # of 20 pairs for each round; the ellipsoids certify wide margins poorly


@pytest.mark.parametrize("each", [5, pytest.param(200, marks=pytest.mark.verify)])
@pytest.mark.parametrize("family", ["ball 20", "boxes", "slivers", "needles 1:1e-3:1e-3", "tetrahedra"])
def test_fitted_ellipsoids_at_contact(family: str, each: int):
    """The same for the ellipsoids of hulls, which are general matrices off the origin."""
    rng = np.random.default_rng([3, sum(family.encode())])
    points = pieces(family, 2 * BODIES, seed=4)
    a, b = Bodies.from_points(points[:BODIES]), Bodies.from_points(points[BODIES:])
    wrong, proven, unknown = wrong_and_judged(rng, a, b, each, Setting(("hull", "hull")), 0.0, False)
    print(f"\n{family:24s} wrong {wrong}, proven right {proven}, undecided {unknown}")
    assert wrong == unknown == 0
    assert proven > each


# -- the exact test --------------------------------------------------------------------------------------

# Pairs apart by less than this share of the lengths may count as touching (docs/certified.md).
TOUCHING = 1e-12


def hulls_at_contact(
    rng: np.random.Generator, family: str, count: int, size: float, world: float, turn: str
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Hulls 2p and 2p + 1 and their poses: first centroid in centroid, then parted to 1e-17 .. 1e-6 of the size."""
    points = [P * size for P in pieces(family, 2 * count, seed=5)]
    pool = pack(map(hull, points))
    R = rotations(rng, 2 * count)
    if turn == "float32":
        R = R.astype(np.float32).astype(float)
    elif turn == "aligned":
        R = np.tile(np.eye(3), (2 * count, 1, 1))
    T = np.tile(np.eye(4), (2 * count, 1, 1))
    T[:, :3, :3] = R
    means = np.array([Q @ pool.hull(k).vertices.mean(axis=0) for k, Q in enumerate(R)])
    T[::2, :3, 3] = rng.uniform(-world, world, size=(count, 3))
    T[1::2, :3, 3] = T[::2, :3, 3] + means[::2] - means[1::2]
    even = np.arange(0, 2 * count, 2)
    gap, axis = signed_distances(pool, even, T[::2], pool, even + 1, T[1::2])
    wanted = size * rng.choice([-1, 1], size=count) * 10 ** rng.uniform(-17, -6, size=count)
    T[1::2, :3, 3] += (wanted - gap)[:, None] * axis
    return points, T[::2].copy(), T[1::2].copy()


HULLS = {
    "turned": (1.0, 1.0, "double"),
    "aligned": (1.0, 0.0, "aligned"),
    "small": (2e-3, 1.0, "double"),
    "large, in single precision": (500.0, 1.0, "float32"),
    "far": (1.0, 1e6, "double"),
    "far, in single precision": (1.0, 1e6, "float32"),
}


@pytest.mark.parametrize("count", quick(4, 200))
@pytest.mark.parametrize(
    "where",
    [
        *("turned", "small", "far, in single precision"),
        *(pytest.param(k, marks=pytest.mark.verify) for k in ("aligned", "large, in single precision", "far")),
    ],
)
def test_hulls_at_contact(where: str, count: int):
    """False is never said of hulls with a common point; True only of those that have one, or are within rounding."""
    rng = np.random.default_rng([4, sum(where.encode())])
    within, meeting, size = 0, 0, HULLS[where][0]
    families = ["boxes", "tetrahedra", "ball 8", "prisms", "slivers", "needles 1:1e-3:1e-3", "rods 1:0.05:0.05"]
    for family in families:
        points, Ta, Tb = hulls_at_contact(rng, family, count, *HULLS[where])
        a, b = Bodies.from_points(points[::2]), Bodies.from_points(points[1::2])
        pool, even = pack(map(hull, points)), np.arange(0, 2 * count, 2)
        gap, _ = signed_distances(pool, even, Ta, pool, even + 1, Tb)
        truth = np.array([exact_collides(points[2 * p], Ta[p], points[2 * p + 1], Tb[p]) for p in range(count)])
        batch = loewner.collide(a, Ta, b, Tb)
        alone = np.array([loewner.collide(a[p], Ta[p], b[p], Tb[p]) for p in range(count)])
        verdict = loewner.classify(a, Ta, b, Tb)
        for exact in (batch, alone):
            assert not (truth & ~exact).any()
            assert (gap[exact & ~truth] < TOUCHING * 4 * size).all()
        assert not (truth & (verdict == Verdict.FREE)).any()
        assert not (~truth & (verdict == Verdict.COLLIDING)).any()
        within += int((batch & ~truth).sum())
        meeting += int(truth.sum())
    total = count * len(families)
    print(f"\n{where:28s} {total} pairs, {meeting} meet, {within} apart within rounding count as touching")
    assert 0.2 < meeting / total < 0.8


@pytest.mark.parametrize("scale", [2e-3, 1.0, 700.0])
def test_cubes_a_rounding_apart(scale: float):
    """Aligned cubes: face to face the answer turns exactly where the doubles do, or within the documented rounding."""
    cube = loewner.Body.from_points(box_corners(np.full(3, scale)))
    T = np.eye(4)
    for steps in range(-40, 41):
        T[0, 3] = scale + steps * np.spacing(scale)
        met = loewner.collide(cube, None, cube, T)
        assert met or steps > 0
        if steps * np.spacing(scale) > TOUCHING * 4 * scale:
            assert not met
