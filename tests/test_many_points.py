"""Hulls of many points: what is left out before Qhull, what a map leaves of vertices, fits with few of the faces."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from exact import halfspaces_crossed, points_outside, rational
from families import polygon
from loewner import Body, MemoryLimitError, Polytope, mvie
from loewner._base import _memory
from loewner._kernels import columns, tolerances
from loewner._kernels.fits import many
from loewner._native import entries
from loewner.bodies import layout, pack
from loewner.ellipsoids import fits, polytopes
from sampling import quick, quick_of

Maker = Callable[[np.random.Generator], np.ndarray]


def rotation(rng: np.random.Generator) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def sphere(rng: np.random.Generator, count: int) -> np.ndarray:
    x = rng.normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def ball(rng: np.random.Generator, count: int = 30_000) -> np.ndarray:
    return sphere(rng, count) * rng.uniform(size=(count, 1)) ** (1 / 3)


def grid(count: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(float(count))] * 3), -1).reshape(-1, 3)


def lines(rng: np.random.Generator) -> np.ndarray:
    """Points on the spokes to six corners, and inside."""
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * [3.0, 2.0, 1.0]
    spokes = corners[rng.integers(6, size=10_000)] * rng.uniform(size=(10_000, 1))
    return np.concatenate([spokes, corners, 0.5 * ball(rng, 20_000)])


CLOUDS: dict[str, Maker] = {
    "ball": ball,
    "ball far away": lambda rng: ball(rng) + np.round(1e6 * rng.normal(size=3)),
    "ball, each point four times": lambda rng: rng.permutation(np.tile(ball(rng, 8_000), (4, 1))),
    "ball and outliers": lambda rng: np.concatenate([ball(rng), 1e3 * sphere(rng, 7)]),
    "box": lambda rng: rng.uniform(-1, 1, size=(30_000, 3)) * [1, 2, 3] @ rotation(rng).T,
    "needle": lambda rng: ball(rng) * [1, 1e-6, 1e-6] @ rotation(rng).T,
    "plate": lambda rng: ball(rng) * [1, 1, 1e-6] @ rotation(rng).T,
    "grid": lambda rng: rng.permutation(grid(30)),
    "lines": lines,
}
FEW = ("ball far away", "needle", "box", "grid", "lines")


def unit_size(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frame and the coordinates that hulls are found in."""
    code, _, _, _, _, frame, coordinates = entries.to_unit_size(points, polytopes.FLATNESS)
    assert code == 0
    return frame, coordinates


@pytest.mark.parametrize("name", quick_of(CLOUDS, FEW))
@pytest.mark.parametrize("step", quick(4, 1))
def test_what_is_left_out_is_inside(name: str, step: int, rng: np.random.Generator) -> None:
    """Every point left out is deeper in the hull of the others than rounding reaches; no vertex is among them."""
    frame, coordinates = unit_size(CLOUDS[name](rng)[::step].copy())
    left = polytopes._not_inside(frame, coordinates)
    assert not isinstance(left, slice)
    out = np.setdiff1d(np.arange(len(coordinates)), left)
    assert len(out) > len(coordinates) // 3
    planes = ConvexHull(coordinates[left]).equations
    depth = -(coordinates[out] @ planes[:, :3].T + planes[:, 3]).max()
    # The hull is shrunk by this share of the distance from its middle to the nearest face.
    assert depth > 0.5 * polytopes.SHRINK * polytopes.SHALLOW
    assert not set(ConvexHull(coordinates).vertices) & set(out)


@pytest.mark.parametrize("name", quick_of(CLOUDS, FEW))
def test_the_hull_is_that_of_all_points(name: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without leaving any out the hull has the same vertices and as many faces; no point is outside."""
    points = CLOUDS[name](rng)
    piece = Polytope.from_points(points)
    monkeypatch.setattr(polytopes, "MANY_POINTS", len(points) + 1)
    plain = Polytope.from_points(points)
    assert set(map(tuple, piece.vertices)) == set(map(tuple, plain.vertices))
    assert len(piece.normals) == len(plain.normals)
    for face, normal in enumerate(piece.normals):
        heights = points @ normal
        assert heights.max() - piece.offsets[face] <= 2e-14 * np.ptp(heights) + 1e-15 * np.abs(points).max()


SHELLS: dict[str, Maker] = {
    "sphere": lambda rng: sphere(rng, 20_000),
    "faces of a cube": lambda rng: (lambda x: x[((x == 0) | (x == 79)).any(axis=1)])(grid(80)),
    "a sheet and a point": lambda rng: np.concatenate([rng.uniform(size=(30_000, 3)) * [1, 1, 0], np.eye(3)]),
}


@pytest.mark.parametrize("name", SHELLS)
def test_hulls_where_little_can_be_left_out(name: str, rng: np.random.Generator) -> None:
    """Points that are nearly all on the hull, or whose sample has none, go to Qhull as they are."""
    points = SHELLS[name](rng)
    piece = Polytope.from_points(points)
    assert set(map(tuple, piece.vertices)) == set(map(tuple, points[ConvexHull(points).vertices]))


def test_few_points_are_untouched(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """Below the limit no point is left out, so that hulls are what they were, bit for bit."""
    points = ball(rng, polytopes.MANY_POINTS - 1)
    monkeypatch.setattr(polytopes, "_not_inside", lambda *_: pytest.fail("asked"))
    Polytope.from_points(points)


def test_hulls_tell_the_memory_they_take(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """Points whose coordinates alone do not fit are refused, with their name and number."""
    monkeypatch.setattr(_memory, "LOOK", 1)
    monkeypatch.setattr(_memory, "left", lambda: (2**15, " left in this test"))
    with pytest.raises(MemoryLimitError, match="points: hull of 20000 points: expected .* left in this test"):
        Polytope.from_points(ball(rng, 20_000))
    Polytope.from_points(ball(rng, 100))


# -- many vertices --------------------------------------------------------------------------------


def lens(rng: np.random.Generator) -> np.ndarray:
    """Two nearly flat caps, which meet in an edge."""
    x = sphere(rng, 60_000)
    x = x[x[:, 2] > 0.99][:400]
    return np.concatenate([x, x * [1, 1, -1] + [0, 0, 1.98]])


POLYHEDRA: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "sphere": lambda rng, n: sphere(rng, 9 * n),
    "far away": lambda rng, n: sphere(rng, 5 * n) + 1e6,
    "squashed": lambda rng, n: sphere(rng, 5 * n) * [1, 1e-2, 1e-4] @ rotation(rng).T,
    "plate": lambda rng, n: sphere(rng, 5 * n) * [1, 1, 1e-6] @ rotation(rng).T,
    "needle": lambda rng, n: sphere(rng, 5 * n) * [1, 1e-6, 1e-6] @ rotation(rng).T,
    "rounded box": lambda rng, n: 0.2 * (x := sphere(rng, 9 * n)) + np.sign(x) * [1, 2, 3],
    "prism": lambda rng, n: (
        np.concatenate([np.c_[polygon(3 * n), np.full(3 * n, z)] for z in (-0.4, 0.4)]) @ rotation(rng).T
    ),
    "cone": lambda rng, n: np.concatenate([np.c_[polygon(4 * n), np.zeros(4 * n)], [[0, 0, 3.0]]]) @ rotation(rng).T,
    "lens": lambda rng, n: lens(rng),
    "bumpy faces": lambda rng, n: grid(12) + 1e-13 * rng.normal(size=(12**3, 3)),
}


def solid(name: str, rng: np.random.Generator, n: int = 100) -> Polytope:
    """One of them, with some hundreds of vertices."""
    return Polytope.from_points(POLYHEDRA[name](rng, n))


def test_polyhedra_have_many_vertices(rng: np.random.Generator) -> None:
    """They take the map, but for the one whose faces are flat to rounding."""
    counts = {name: len(solid(name, rng).vertices) for name in POLYHEDRA}
    assert all(count > many.MANY for name, count in counts.items() if name != "bumpy faces"), counts


@pytest.mark.parametrize("name", POLYHEDRA)
def test_faces_touch_the_farthest_vertex(name: str, rng: np.random.Generator) -> None:
    """Offsets are the largest n·v of all vertices, to the rounding of that product."""
    piece = solid(name, rng)
    products = piece.normals[:, None, :] * piece.vertices
    rounding = 4 * 2.0**-53 * np.abs(products).sum(axis=2).max(axis=1)
    assert (np.abs(products.sum(axis=2).max(axis=1) - piece.offsets) <= rounding).all()


@pytest.mark.parametrize("name", POLYHEDRA)
@pytest.mark.parametrize("n", quick(65, 100))
def test_inner_ellipsoids_are_inside_exactly(name: str, n: int, rng: np.random.Generator) -> None:
    """In rational arithmetic, by the lemma of docs/containment.md: inside the least n·v of each simplex's vertices."""
    piece = solid(name, rng, n)
    assert name == "bumpy faces" or len(piece.vertices) > many.MANY
    fit = mvie(piece.vertices)
    V, N = rational(piece.vertices), rational(piece.normals)
    least = (N[piece.face_of_simplex][:, None, :] * V[piece.simplices]).sum(axis=2).min(axis=1)
    E = fit.ellipsoid
    assert halfspaces_crossed(N[piece.face_of_simplex], least, E.center, E.factor) == 0


@pytest.mark.parametrize("name", POLYHEDRA)
def test_few_faces_give_the_fit_of_all(name: str, rng: np.random.Generator) -> None:
    """Both gaps keep the tolerance, and the volume is that of `mvie` with all half-spaces, to their sum."""
    piece = solid(name, rng)
    tol = 1e-6 if name in ("sphere", "rounded box", "prism", "cone", "lens") else 1e-4
    fit = mvie(piece.vertices, tol=tol)
    middle = piece.vertices.mean(axis=0)
    offsets = ((piece.vertices - middle) @ piece.normals.T).max(axis=0)
    other = mvie(piece.normals, offsets, tol=tol)
    assert fit.gap <= tol
    assert abs(fit.ellipsoid.log_volume - other.ellipsoid.log_volume) <= 2 * tol


@pytest.mark.verify  # it compiles the map, which it calls directly
def test_all_vertices_of_a_face_are_on_the_map(rng: np.random.Generator) -> None:
    """Also those that another vertex beats along every direction near by, by no more than the window of the face."""
    window = tolerances.FACE_WIDTH * 2
    caps = [np.c_[polygon(300), z + rng.uniform(-0.5, 0.5, size=300) * window] for z in (1.0, -1.0)]
    unit = np.eye(3)
    columns, nodes = many.face_map(np.concatenate(caps), unit)
    for sign, cap in ((1.0, set(range(300))), (-1.0, set(range(300, 600)))):
        first, last = many.leaf.py_func(unit, nodes, unit[2], sign)
        assert set(columns[first:last]) == cap


def test_all_faces_are_taken_where_few_leave_no_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A needle of four faces, three of them in one sector: two bound nothing, so the fit is that of all."""
    A = np.array([[1.0, 0.1, 0.1], [1.0, 0.4, 0.1], [1.0, 0.25, 0.4], [-1.0, -0.25, -0.2]])
    x, low, lam = np.empty(3), np.empty((3, 3)), np.empty(len(A))
    monkeypatch.setattr(many, "solve_primal_dual", entries.solve_primal_dual)  # as it is compiled already
    gap, _ = many.solve_with_few.py_func(A, 1e-6, x, low, lam)
    fit = mvie(A, np.ones(len(A)), tol=1e-6)
    assert gap <= 1e-6
    assert abs(np.linalg.slogdet(low)[1] - fit.ellipsoid.log_volume + np.log(4 * np.pi / 3)) <= 2e-6
    assert (lam > 0).all()


def test_bodies_of_many_points(rng: np.random.Generator) -> None:
    """Vertices, both ellipsoids and the farthest points are those of all 40,000 points."""
    points = ball(rng, 40_000) * [3, 2, 1] + [5, 0, 0]
    body = Body.from_points(points)
    (piece,) = body.pieces
    assert points_outside(piece.vertices, piece.outer.center, piece.outer.factor) == 0
    assert max(fits.mvce(points).gap, mvie(points).gap) <= 1e-4
    d = rng.normal(size=(50, 3))
    np.testing.assert_array_equal((points @ d.T).max(axis=0), (piece.vertices @ d.T).max(axis=0))


@pytest.mark.parametrize(
    "axes", [[1000.0, 1.0, 1.0], *(pytest.param([k, k, 1.0], marks=pytest.mark.verify) for k in (1.0, 1000.0))]
)
@pytest.mark.parametrize("most", quick(1500, 6000))
def test_moved_bodies_touch_their_farthest_vertices(
    axes: list[float], rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    """Offsets of a moved body are those of all its vertices, in however many parts they are found.

    For a large hull, thin or not, that takes a few tens of products for each face, however many vertices there are.
    """
    products = []

    def counted(*arguments: Any) -> Any:
        found = layout.heights_of(*arguments)
        products.append(found[1])
        return found

    monkeypatch.setattr(layout, "AT_ONCE", 64)
    monkeypatch.setattr(pack, "heights_of", counted)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(rng), [1.0, 2.0, 3.0]
    T[:3, :3] *= np.linalg.det(T[:3, :3])
    for count in (60, 600, most):
        packed = Body.from_points(sphere(rng, count) * axes).transformed(T)._packed
        farthest = (packed.points @ packed.planes[:, :3].T).max(axis=0)
        np.testing.assert_allclose(packed.planes[:, 3], farthest, rtol=0, atol=1e-14 * max(axes))
        assert sum(products) < 50 * len(packed.planes)
        assert len(products) == (count > columns.LARGE)
        products.clear()
