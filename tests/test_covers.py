"""Models that provably hold a body: the three outcomes, each hole found and none invented, and fits of elements."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from loewner import (
    Body,
    CoverReport,
    GeometryError,
    InputError,
    Robot,
    UnknownNameError,
    get_num_threads,
    set_num_threads,
)
from loewner._native import entries
from loewner.bodies import packed_of
from sampling import examples, quick

ANNULUS = trimesh.creation.annulus(0.03, 0.04, 0.1)
BOX = Body.box([0.2, 0.1, 0.1])


def turned(seed: int, shift: float = 0.05) -> np.ndarray:
    """Make a random pose."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, 0] *= np.linalg.det(T[:3, :3])
    T[:3, 3] = rng.normal(size=3) * shift
    return T


def in_balls(points: np.ndarray, body: Body) -> np.ndarray:
    """Whether points are in a body of balls, in float64."""
    centers, radii = body.outer.center, body.outer.semi_axes[:, 0]
    return (np.linalg.norm(points[:, None] - centers, axis=2) <= radii * (1 + 1e-12)).any(axis=1)


def outside_in_fractions(point: np.ndarray, centers: np.ndarray, radii: np.ndarray) -> bool:
    """Whether a point is outside of all balls, in exact arithmetic."""
    x = [Fraction(float(v)) for v in point]
    for center, radius in zip(centers, radii, strict=True):
        far = sum((a - Fraction(float(b))) ** 2 for a, b in zip(x, center, strict=True))
        if far <= Fraction(float(radius)) ** 2:
            return False
    return True


def points_of_hull(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random convex combinations, some of them near the corners and the edges."""
    weights = rng.dirichlet(np.full(len(points), 0.2), size=count)
    return weights @ points


def bits_of(words: np.ndarray, count: int) -> np.ndarray:
    """The first bits of each row of words."""
    return np.unpackbits(words.view(np.uint8), axis=1, count=count, bitorder="little").astype(bool)


def held_by(points: np.ndarray, centers: np.ndarray, axes: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Which capsules, in columns, hold balls about points: axes as 101 points each."""
    far = np.full((len(points), len(centers)), np.inf)
    for share in np.linspace(-1.0, 1.0, 101) if axes.any() else [0.0]:
        far = np.minimum(far, np.linalg.norm(points[:, None, :3] - centers - share * axes, axis=2))
    return far + points[:, 3:] <= radii


def words_of(points: np.ndarray, centers: np.ndarray, axes: np.ndarray, radii: np.ndarray, at: int = 0) -> tuple:
    """The kernel's bits by point and by candidate, where the points from one on are found in a second call."""
    m = -(-len(radii) // 64) * 64
    rows = np.zeros((8, m))
    rows[:3, : len(radii)], rows[3:6, : len(radii)], rows[7], rows[7, : len(radii)] = centers.T, axes.T, -1, radii
    squares = (axes * axes).sum(axis=1)
    rows[6, : len(radii)] = np.where(squares > 0, 1 / np.where(squares > 0, squares, 1), 0)
    by_point, by_candidate = np.zeros((len(points), m // 64), np.int64), np.zeros((m, len(points) // 64 + 1), np.int64)
    entries.find_held(0, points[: at or len(points)].copy(), rows.ravel(), by_point, by_candidate)
    entries.find_held(at // 64 * 64, points, rows.ravel(), by_point, by_candidate)
    return by_point, by_candidate


@pytest.mark.parametrize("axis", [0.0, 0.3])
def test_bits_are_the_points_that_candidates_hold(axis: float):
    """Bits by point and by candidate agree with distances, for balls and capsules, and for points found later."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(size=(150, 3)), 0.2 * rng.uniform(size=150)])
    centers, radii = rng.uniform(size=(70, 3)), 0.5 * rng.uniform(size=70)
    axes = axis * rng.normal(size=(70, 3)) * (np.arange(70) >= 40)[:, None]
    expected = held_by(points, centers, axes, radii)
    assert 0.02 < expected.mean() < 0.9
    # The nearest one of the points of an axis is farther away than the axis, by at most half their distance.
    near = held_by(points, centers, axes, radii + 0.01 * np.linalg.norm(axes, axis=1))
    for at in (0, 100):
        by_point, by_candidate = words_of(points, centers, axes, radii, at)
        found = bits_of(by_point, 128)
        assert (found == bits_of(by_candidate, 150).T).all()
        assert not found[:, 70:].any()
        assert (expected <= found[:, :70]).all()
        assert (found[:, :70] <= near).all()


def naive_choice(holds: np.ndarray, start: list[int], steps: int) -> list[int]:
    """The search of `choose_few`, which counts everything anew in each step."""
    chosen: list[int] = []
    for k in start:
        if (holds[:, k] & ~holds[:, chosen].any(axis=1)).any():
            chosen.append(k)
    while not holds[:, chosen].any(axis=1).all():
        chosen.append(int(holds[~holds[:, chosen].any(axis=1)].sum(axis=0).argmax()))
    best, weight, last = list(chosen), np.ones(len(holds)), np.full(holds.shape[1], -10)

    def drop(step: int, waits: int) -> None:
        alone = holds[:, chosen].sum(axis=1) == 1
        loss = [weight[holds[:, k] & alone].sum() + 1e9 * (last[k] > step - waits) for k in chosen]
        last[chosen.pop(int(np.argmin(loss)))] = step

    for step in range(min(steps, 50 * len(best))):
        while holds[:, chosen].any(axis=1).all():
            best = list(chosen)
            if len(chosen) == 1:
                return best
            drop(step, 0)
        if len(chosen) > 1:
            drop(step, 3)
        missed = np.flatnonzero(~holds[:, chosen].any(axis=1))
        able, some = np.flatnonzero(holds[missed[step * 7919 % len(missed)]]), missed[:: -(-len(missed) // 128)]
        gain = np.where(last[able] < step, weight[some] @ holds[np.ix_(some, able)], -1.0)
        chosen.append(int(able[gain.argmax()]))
        last[chosen[-1]] = step
        weight[~holds[:, chosen].any(axis=1)] += 1.0
    return best


@pytest.mark.parametrize(("count", "radius", "start"), [(900, 0.45, []), (300, 0.3, [5, 5, 17, 80]), (70, 2.0, [])])
def test_choice_is_that_of_a_naive_search(count: int, radius: float, start: list[int]):
    """The kernel, which only updates, chooses the same candidates as a search that counts everything anew."""
    rng = np.random.default_rng(count)
    points = np.column_stack([rng.uniform(size=(count, 3)), np.zeros(count)])
    centers = np.concatenate([points[:: count // 60, :3], rng.uniform(size=(40, 3))])
    by_point, by_candidate = words_of(points, centers, np.zeros_like(centers), np.full(len(centers), radius))
    holds, found = bits_of(by_point, len(centers)), np.empty(count, np.int64)
    for steps in (0, 250):
        n = entries.choose_few(count, steps, np.array(start, np.int64), by_point, by_candidate, found)
        expected = naive_choice(holds, start, steps)
        assert found[:n].tolist() == expected
        assert holds[:, found[:n]].any(axis=1).all()


def test_a_point_that_no_candidate_holds_is_no_choice():
    """A point without a candidate gives no choice, whatever the others hold."""
    points = np.column_stack([np.arange(3.0), np.zeros((3, 3))])
    by_point, by_candidate = words_of(points, points[:2, :3], np.zeros((2, 3)), np.full(2, 0.5))
    assert entries.choose_few(3, 9, np.empty(0, np.int64), by_point, by_candidate, np.empty(3, np.int64)) == -1
    assert entries.choose_few(2, 9, np.empty(0, np.int64), by_point, by_candidate, np.empty(3, np.int64)) == 2


@given(st.integers(0, 10**6), st.integers(1, 12), st.floats(0.02, 0.4))
@examples(10, 25)
def test_outcomes_of_balls_are_true(seed: int, count: int, radius: float):
    """Random hulls and balls: samples of a covered body are inside, and witnesses are outside in exact arithmetic."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(8, 3)) * 0.1
    body = Body.from_points(points)
    centers, radii = rng.normal(size=(count, 3)) * 0.1, radius * rng.uniform(0.5, 1.0, count)
    report = body.covered_by(Body.spheres(centers, radii), tolerance=0.005)
    samples = points_of_hull(points, 20_000, rng)
    held = in_balls(samples, Body.spheres(centers, radii))
    if report.outcome == "covered":
        assert held.all()
        assert report.depth == (0.0, 0.0)
        assert report.uncovered_share == (0.0, 0.0)
    if report.outcome == "uncovered":
        assert outside_in_fractions(report.witness, centers, radii)
        planes = body.pieces[0]
        assert (planes.normals @ report.witness <= planes.offsets + 1e-12).all()
    depth = (np.linalg.norm(samples[:, None] - centers, axis=2) - radii).min(axis=1).max()
    assert depth <= report.depth[1] + 1e-9
    assert report.depth[0] <= report.depth[1]


@pytest.mark.parametrize("seed", quick(0, 1))
@pytest.mark.parametrize("tolerance", quick(0.02, 0.005))
@pytest.mark.parametrize(
    "kind",
    [
        *("capsule", "box", "ellipsoid", "sphere", "hull"),
        *(
            pytest.param(kind, marks=pytest.mark.verify) for kind in ("cylinder", "cone")
        ),  # their bounds take many cells
    ],
)
def test_elements_hold_what_they_are_said_to(seed: int, tolerance: float, kind: str):
    """A body is in a larger copy of itself and not in a smaller one, for each kind of element and any pose."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0.05, 0.3, 3)
    points = rng.normal(size=(12, 3)) * 0.1
    make = {
        "capsule": lambda s: Body.capsule(a * s, b * s),
        "box": lambda s: Body.box([a * s, b * s, c * s]),
        "ellipsoid": lambda s: Body.ellipsoid([a * s, b * s, c * s]),
        "cylinder": lambda s: Body.cylinder(a * s, b * s),
        "cone": lambda s: Body.cone(a * s, b * s),
        "sphere": lambda s: Body.sphere(a * s),
        "hull": lambda s: Body.from_points((points - points.mean(axis=0)) * s),
    }[kind]
    T = turned(seed)
    body = make(1.0).transformed(T)
    # A circumscribed polytope stands for a curved piece; it is at most 0.7 % larger.
    assert body.covered_by(make(1.01).transformed(T), tolerance=0.005).outcome == "covered"
    assert body.covered_by(body).outcome == "covered"
    small = body.covered_by(make(0.97).transformed(T), tolerance=tolerance)
    assert small.outcome == "uncovered"
    assert small.depth[0] > 0


@pytest.mark.parametrize("tolerance", quick(1e-2, None))
def test_two_balls_around_a_box(tolerance: float | None):
    """A known answer: two balls hold a box, and smaller ones leave out its corners, by a depth in closed form."""
    centers = np.array([[-0.05, 0, 0], [0.05, 0, 0]])
    report = BOX.covered_by(Body.spheres(centers, 0.1))
    assert report.outcome == "covered"
    assert report.witness is None
    assert report.excess[0] == pytest.approx(0.05, abs=1e-4)
    assert report.excess[1] == pytest.approx(0.05, abs=1e-4)
    report = BOX.covered_by(Body.spheres(centers, 0.08), tolerance=tolerance)
    depth = np.sqrt(3) * 0.05 - 0.08
    assert report.outcome == "uncovered"
    assert report.depth[0] == pytest.approx(depth, rel=0.01)
    assert report.depth[1] >= depth * (1 - 1e-9)
    assert outside_in_fractions(report.witness, centers, np.full(2, 0.08))


@pytest.mark.verify
def test_share_is_that_of_samples():
    """The share of the surface that is outside agrees with samples, to three digits."""
    centers, radius = np.array([[0.0, 0.01, -0.03], [0.0, -0.01, 0.03]]), 0.042
    report = Body.from_surface(ANNULUS).covered_by(Body.spheres(centers, radius))
    points = ANNULUS.sample(400_000, seed=0)
    share = 1 - in_balls(points, Body.spheres(centers, radius)).mean()
    low, high = report.uncovered_share
    assert high - low < 1e-3
    assert low - 3e-3 < share < high + 3e-3


def test_radius_short_by_a_rounding_of_single_precision():
    """Around a cube the ball is exact: a radius shorter by 2⁻²⁴ is found, one longer by 2⁻⁴⁰ covers."""
    cube, radius = Body.box([0.1, 0.1, 0.1]), np.sqrt(3) * 0.05
    assert cube.covered_by(Body.sphere(radius * (1 + 2.0**-40))).outcome == "covered"
    report = cube.covered_by(Body.sphere(radius * (1 - 2.0**-24)))
    assert report.outcome == "uncovered"
    assert outside_in_fractions(report.witness, np.zeros((1, 3)), [radius * (1 - 2.0**-24)])
    assert cube.covered_by(Body.sphere(radius)).outcome != "uncovered"


@pytest.mark.parametrize("tolerance", quick(1e-2, 4e-3, 1e-3))
@pytest.mark.parametrize("fine", quick(1e-2, None))
def test_boxes_that_share_a_face_are_not_accused(tolerance: float, fine: float | None):
    """Boxes that share faces cover without a gap: never "uncovered"; moved apart by 1 µm, they leave a hole."""
    halves = [[-0.05, 0, 0], [0.05, 0, 0]]
    assert BOX.covered_by(Body.boxes(halves, 0.1), tolerance=tolerance).outcome in ("covered", "undecided")
    assert BOX.covered_by(Body.boxes(halves, 0.1 + 1e-4)).outcome == "covered"
    apart = BOX.covered_by(Body.boxes([[-0.05, 0, 0], [0.05 + 1e-6, 0, 0]], 0.1), tolerance=fine)
    assert apart.outcome == "uncovered"
    assert 0 < apart.witness[0] < 1e-6
    assert 0 < apart.depth[0] <= 0.5e-6


def test_eight_boxes_with_a_common_corner():
    """Eight boxes that overlap cover a larger box, although its middle is in all of their seams."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
    assert Body.box([0.2, 0.2, 0.2]).covered_by(Body.boxes(corners, 0.101)).outcome == "covered"


@pytest.mark.parametrize("solid", [True, False])
def test_a_hole_inside(solid: bool):
    """Balls along a sphere's surface leave a hole in the middle of a solid; without an inside there is none."""
    mesh = trimesh.creation.icosphere(3, radius=0.1)
    body = Body.from_surface(mesh, solid=solid)
    centers = trimesh.creation.icosphere(2).vertices * 0.09
    shell = Body.spheres(centers, 0.03)
    report = body.covered_by(shell)
    assert report.outcome == ("uncovered" if solid else "covered")
    if solid:
        assert np.linalg.norm(report.witness) < 0.06
        assert report.depth[0] == pytest.approx(0.06, rel=0.02)
        assert report.depth[1] >= 0.06 * (1 - 1e-6)
        assert body.covered_by(Body.union([shell, Body.sphere(0.07)])).outcome == "covered"


@pytest.mark.verify
def test_a_hole_that_goes_on_between_balls():
    """A ball that fills most of a hole leaves its parts between the balls around it."""
    shell = Body.spheres(trimesh.creation.icosphere(2).vertices * 0.09, 0.03)
    body = Body.from_surface(trimesh.creation.icosphere(3, radius=0.1))
    pierced = body.covered_by(Body.union([shell, Body.sphere(0.0605)]))
    assert pierced.outcome == "uncovered"
    assert 0.0605 < np.linalg.norm(pierced.witness) < 0.07


def test_a_cavity_is_no_part_of_the_body():
    """What is inside a cavity need not be covered."""
    outer, inner = trimesh.creation.icosphere(3, radius=0.1), trimesh.creation.icosphere(3, radius=0.07)
    inner.invert()
    shell = Body.from_surface(trimesh.util.concatenate([outer, inner]))
    centers = trimesh.creation.icosphere(2).vertices * 0.085
    assert shell.covered_by(Body.spheres(centers, 0.035)).outcome == "covered"


def test_excess_in_a_slit_between_pieces():
    """Polytopes around two balls close the slit between them, where a small ball is outside both."""
    balls = Body.spheres([[-1.001, 0, 0], [1.001, 0, 0]], 1.0)
    report = balls.covered_by(Body.sphere(0.02))
    outside = np.hypot(1.001, 0.02) - 1.0
    assert report.excess[0] <= outside * (1 + 1e-9) <= report.excess[1] * (1 + 2e-9)


@pytest.mark.parametrize("tolerance", quick(1e-2, None))
def test_excess_of_elements_that_stick_out(tolerance: float | None):
    """The excess of each kind of element over a box is known in closed form."""
    for model, excess in (
        (Body.box([0.22, 0.1, 0.1]), 0.01),
        (Body.capsule(0.08, 0.4), 0.2 + 0.08 - 0.05),
        (Body.ellipsoid([0.3, 0.1, 0.1]), 0.2),
        (Body.cylinder(0.2, 0.3), np.hypot(0.15, 0.1)),
    ):
        report = BOX.covered_by(model, tolerance=tolerance)
        assert report.excess[0] <= excess * (1 + 1e-9)
        assert excess * (1 - 1e-9) <= report.excess[1] <= excess * 1.05 + 1e-3


@pytest.mark.slow("fits of spheres and capsules repeat a search and a proof")
@pytest.mark.parametrize("kind", quick("spheres", "capsules", "boxes", "ellipsoids"))
def test_covers_by_number(kind: str):
    """A cover has at most n elements, is proven by another call, holds samples, and sticks out as it states."""
    body = Body.from_surface(ANNULUS)
    cover = body.cover(kind, n=6)
    assert len(cover.pieces) <= 6
    report = body.covered_by(cover)
    assert report.outcome == "covered"
    assert report.excess[0] <= cover.covering.max_protrusion == pytest.approx(report.excess[1])
    assert cover.covering.exact
    assert cover.covering.max_uncovered == 0.0
    assert cover.covering.kind == "cover"
    if kind == "spheres":
        assert in_balls(ANNULUS.sample(100_000, seed=1), cover).all()


@pytest.mark.verify  # two fits of spheres
def test_covers_by_protrusion():
    """Spheres stick out by at most the protrusion, and take no more of them if more is allowed."""
    counts = []
    for protrusion in (0.012, 0.03):
        cover = BOX.cover("spheres", protrusion=protrusion)
        assert cover.covering.max_protrusion <= protrusion
        counts.append(len(cover.pieces))
        samples = np.random.default_rng(0).uniform(-0.5, 0.5, (100_000, 3)) * [0.2, 0.1, 0.1]
        assert in_balls(samples, cover).all()
        numbers = np.concatenate([cover.outer.center.ravel(), cover.outer.semi_axes[:, 0]])
        assert (numbers == numbers.astype(np.float32)).all()
    assert counts[0] > counts[1]


@pytest.mark.verify  # a fit of spheres
def test_spheres_of_an_open_surface():
    """A surface without an inside is held by spheres about its points."""
    triangle = Body.from_surface((np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.0]]), np.array([[0, 1, 2]])))
    cover = triangle.cover(protrusion=0.02)
    assert cover.covering.max_protrusion <= 0.02
    assert triangle.covered_by(cover).outcome == "covered"


def test_progress_and_saved_covers(tmp_path):
    """The share that is reported never falls and ends complete; a cover is saved with its covering."""
    shares: list[float] = []
    cover = BOX.cover("boxes", n=2, progress=lambda done, total: shares.append(done / total))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    shares.clear()
    BOX.covered_by(cover, progress=lambda done, total: shares.append(done / total))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    cover.save(tmp_path / "cover.npz")
    assert Body.load(tmp_path / "cover.npz").covering.max_protrusion == cover.covering.max_protrusion


def test_bad_input():
    """Each argument that is wrong is named."""
    with pytest.raises(InputError, match=r"model: expected loewner\.Body"):
        BOX.covered_by([])
    with pytest.raises(InputError, match="model: expected convex pieces, found a solid"):
        BOX.covered_by(Body.from_surface(ANNULUS))
    with pytest.raises(InputError, match="tolerance"):
        BOX.covered_by(BOX, tolerance=0.0)
    for far in (1e-200, 1e200):
        with pytest.raises(InputError, match="protrusion: expected at (least|most)"):
            BOX.cover(protrusion=far)
    with pytest.raises(InputError, match="n, protrusion: expected one of the two, found none"):
        BOX.cover()
    with pytest.raises(InputError, match="n, protrusion: expected one of the two, found both"):
        BOX.cover(n=3, protrusion=0.1)
    with pytest.raises(UnknownNameError, match="kind"):
        BOX.cover("cones", n=3)
    with pytest.raises(InputError, match="n: expected"):
        BOX.cover(n=0)
    with pytest.raises(InputError, match="protrusion: expected at least"):
        BOX.cover(protrusion=1e-7)
    assert isinstance(BOX.covered_by(BOX), CoverReport)


def test_a_plate_shaped_hole_is_found():
    """Elements that do not meet a cell in the middle of a hole may be the nearest ones there."""
    low = [[-1.1, -1.1, -1.1], [0.56, -1.1, -1.1], [-1.1, -1.1, -1.1], [-1.1, 0.3, -1.1], [-1.1] * 3, [-1.1, -1.1, 0.3]]
    high = [[0.44, 1.1, 1.1], [1.1] * 3, [1.1, -0.3, 1.1], [1.1] * 3, [1.1, 1.1, -0.3], [1.1] * 3]
    model = Body.boxes((np.array(low) + high) / 2, np.subtract(high, low))
    found = Body.box([2, 2, 2]).covered_by(model)
    assert found.outcome == "uncovered"
    assert (np.abs(found.witness - [0.5, 0, 0]) < [0.06, 0.3, 0.3]).all()
    assert found.depth[0] <= 0.06 <= found.depth[1]


@pytest.mark.parametrize("tolerance", quick(0.2, 0.05))
def test_a_thick_surface_is_not_its_corners(tolerance: float):
    """A surface with a radius is not held by the hull of its corners."""
    box = trimesh.creation.box((2, 2, 2))
    thick = Body.from_surface(box, radius=0.5, solid=False)
    assert thick.covered_by(Body.box([2, 2, 2]), tolerance=tolerance).outcome != "covered"


@pytest.mark.verify
def test_spheres_of_a_thick_surface_hold_its_thickness():
    """Spheres of a surface with a radius hold the balls about its points, not only the points."""
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0.03]])
    thick = Body.from_surface((points, np.array([[0, 1, 2], [1, 3, 2]])), radius=0.01)
    cover = thick.cover("spheres", protrusion=0.02)
    assert cover.covering.max_protrusion <= 0.02
    assert thick.covered_by(cover).outcome == "covered"
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(20_000, 3))
    flat = rng.dirichlet(np.ones(3), size=20_000) @ points[:3]
    assert in_balls(flat + 0.01 * ways / np.linalg.norm(ways, axis=1, keepdims=True), cover).all()
    # A solid beside it has no radius, so that a ball about its surface need not hold more than the surface.
    both = Body.union([thick, Body.from_surface(trimesh.creation.box((0.05, 0.05, 0.05)))])
    assert both.cover("spheres", protrusion=0.02).covering.max_protrusion <= 0.02


@pytest.mark.slow("fits that divide clusters until none sticks out too far")
@pytest.mark.parametrize(
    ("kind", "body", "protrusion"),
    [
        ("boxes", Body.from_surface(trimesh.creation.icosphere(1, 0.1)), 0.04),
        ("ellipsoids", BOX, 0.04),
        pytest.param("boxes", Body.from_surface(trimesh.creation.icosphere(2, 0.1)), 0.01, marks=pytest.mark.verify),
        pytest.param("ellipsoids", Body.box([0.2, 0.2, 0.2]), 0.01, marks=pytest.mark.verify),
    ],
)
def test_boxes_and_ellipsoids_by_protrusion(kind: str, body: Body, protrusion: float):
    """Boxes hold what is round, and ellipsoids what has corners, and stick out by no more than they may."""
    cover = body.cover(kind, protrusion=protrusion)
    assert cover.covering.max_protrusion <= protrusion
    assert body.covered_by(cover).outcome == "covered"


@pytest.mark.slow("512 ellipsoids, of at least 10,000")
@pytest.mark.verify
def test_more_elements_than_there_may_be():
    """A protrusion that takes too many ellipsoids is an error that states so."""
    with pytest.raises(GeometryError, match="protrusion: expected one that at most 4096 ellipsoids reach"):
        Body.box([1.0, 1.0, 1.0]).cover("ellipsoids", protrusion=5e-4)


@pytest.mark.slow("fits of spheres for three links, twice")
def test_covers_of_robots_do_not_depend_on_threads():
    """One thread or several, and equal links or not: each link has the cover that its body alone has."""
    links = {"a": "0.2 0.1 0.1", "b": "0.2 0.1 0.1", "c": "0.1 0.1 0.3"}
    parts = "".join(
        f'<link name="{name}"><collision><geometry><box size="{size}"/></geometry></collision></link>'
        for name, size in links.items()
    )
    joints = "".join(
        f'<joint name="to_{x}" type="fixed"><parent link="a"/><child link="{x}"/><origin xyz="0 0 {k}"/></joint>'
        for k, x in ((1, "b"), (2, "c"))
    )
    robot, before = Robot.from_urdf(text=f'<robot name="r">{parts}{joints}</robot>'), get_num_threads()
    alone = {link: body.cover("spheres", protrusion=0.04) for link, body in robot.bodies.items()}
    shares: list[float] = []
    try:
        for count in (1, 3):
            set_num_threads(count)
            covers = robot.cover("spheres", protrusion=0.04, progress=lambda done, total: shares.append(done / total))
            for link in robot.bodies:
                assert (packed_of(covers.bodies[link]).frames == packed_of(alone[link]).frames).all()
            assert shares == sorted(shares)
            assert shares.pop() == 1.0
            shares.clear()
    finally:
        set_num_threads(before)
