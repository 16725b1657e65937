"""Polytopes: known solids, hull laws, both representations, and every bad input by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exact import hull_planes, rational
from families import polygon, prism
from loewner import GeometryError, InputError, Polytope
from loewner.ellipsoids import polytopes
from sampling import examples

seeds = st.integers(0, 2**32 - 1)


def signs(n: int) -> np.ndarray:
    return np.array(np.meshgrid(*[[-1.0, 1.0]] * n)).reshape(n, -1).T


def rotation(rng: np.random.Generator, n: int = 3) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


MAPS = {
    "plain": lambda rng, x: x,
    "turned": lambda rng, x: x @ rotation(rng).T,
    "far away": lambda rng, x: x + np.round(1e6 * rng.normal(size=3)),
    "tiny": lambda rng, x: x * 2.0**-20,
    "huge": lambda rng, x: x * 2.0**20,
    "thin": lambda rng, x: x * [1, 1, 1e-8],
}

SOLIDS = {
    "cube": (signs(3), 8, 6),
    "grid": (np.stack(np.meshgrid(*[np.arange(5.0)] * 3), -1).reshape(-1, 3), 8, 6),
    "prism": (prism(6, 1.0), 12, 8),
    "tetrahedron": (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), 4, 4),
    "octahedron": (np.concatenate([np.eye(3), -np.eye(3)]), 6, 8),
}


def check_laws(piece: Polytope) -> None:
    """Unit normals, every vertex under every face and on one, simplices in their faces, closed, turned outward."""
    V, n = piece.vertices, piece.dim
    np.testing.assert_allclose(np.linalg.norm(piece.normals, axis=1), 1, atol=1e-14)
    size = np.abs(V).max()
    height = V @ piece.normals.T - piece.offsets
    rounding = 2 * n * np.finfo(float).eps * size  # of a dot product of this length, in another order of summation
    assert np.abs(height.max(axis=0)).max() <= rounding
    width = np.ptp(V @ piece.normals.T, axis=0)
    for face, simplex in zip(piece.face_of_simplex, piece.simplices, strict=True):
        assert height[simplex, face].min() >= -(1e-11 * width[face] + 1e-13 * size)
    assert set(piece.face_of_simplex) == set(range(len(piece.normals)))
    assert set(piece.simplices.ravel()) == set(range(len(V)))
    if n == 3:
        edges = [tuple(t[[k, (k + 1) % 3]]) for t in piece.simplices for k in range(3)]
        assert len(set(edges)) == len(edges)
        assert {(b, a) for a, b in edges} == set(edges)
        # Outward: the signed volume of the cones over the triangles is the volume, above zero.
        T = V[piece.simplices] - V.mean(axis=0)
        assert np.linalg.det(T).sum() > 0


@pytest.mark.parametrize("where", MAPS)
@pytest.mark.parametrize("solid", SOLIDS)
def test_known_solids(solid: str, where: str, rng: np.random.Generator) -> None:
    """Vertices and merged faces are counted right, wherever the solid is and however it is scaled."""
    points, vertices, faces = SOLIDS[solid]
    piece = Polytope.from_points(rng.permutation(MAPS[where](rng, points)))
    check_laws(piece)
    assert len(piece.vertices) == vertices
    assert len(piece.normals) == faces


@given(seeds)
def test_hull_laws_of_random_points(seed: int) -> None:
    """The laws hold for any cloud, and no point lies outside any face beyond rounding."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    points = rng.normal(size=(int(rng.integers(n + 1, 40)), n)) * np.exp(rng.uniform(-9, 9, size=n))
    points = points @ rotation(rng, n).T + rng.normal(size=n)
    piece = Polytope.from_points(points)
    check_laws(piece)
    width = np.ptp(piece.vertices @ piece.normals.T, axis=0)
    outside = points @ piece.normals.T - piece.offsets
    assert (outside <= 1e-13 * width + 1e-14 * np.abs(points).max()).all()


@examples(15, 40)
@given(seeds)
def test_faces_are_those_of_the_exact_hull(seed: int) -> None:
    """Against rational arithmetic: small integer points, full of coplanar and collinear ones."""
    rng = np.random.default_rng(seed)
    points = rng.integers(-2, 3, size=(12, 3)).astype(float)
    if np.linalg.matrix_rank(points - points[0]) < 3:
        return
    piece = Polytope.from_points(points)
    check_laws(piece)
    A, b = hull_planes(np.unique(points, axis=0))
    planes = {
        tuple(np.round(np.r_[a, c].astype(float) / np.linalg.norm(a.astype(float)), 9) + 0.0)
        for a, c in zip(A, b, strict=True)
    }
    found = {tuple(np.round(np.r_[a, c], 9) + 0.0) for a, c in zip(piece.normals, piece.offsets, strict=True)}
    assert found == planes
    # Vertices: exactly the points that lie on faces of full rank.
    for x in rational(np.unique(points, axis=0)):
        on = A[(A @ x) == b].astype(float)
        extreme = len(on) > 0 and np.linalg.matrix_rank(on) == 3
        assert extreme == any((v == x.astype(float)).all() for v in piece.vertices)


@given(seeds)
def test_both_representations_agree(seed: int) -> None:
    """Faces back to vertices: half-spaces of a hull, rescaled, shuffled and with redundant ones, give it again."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    piece = Polytope.from_points(rng.normal(size=(int(rng.integers(n + 1, 15)), n)) + 3 * rng.normal(size=n))
    A = np.concatenate([piece.normals, piece.normals[:3]])
    b = np.concatenate([piece.offsets, piece.offsets[:3] + 1])
    scale = np.exp(rng.uniform(-3, 3, size=len(A)))
    order = rng.permutation(len(A))
    again = Polytope.from_halfspaces((A * scale[:, None])[order], (b * scale)[order])
    check_laws(again)
    assert len(again.vertices) == len(piece.vertices)
    size = np.abs(piece.vertices).max()
    for v in piece.vertices:
        assert np.abs(again.vertices - v).max(axis=1).min() <= 1e-7 * size


def test_polygons_and_high_dimensions() -> None:
    """The plane has edges for faces; a cube in seven dimensions has 14 faces."""
    ring = Polytope.from_points(polygon(11))
    assert (len(ring.vertices), len(ring.normals), ring.dim) == (11, 11, 2)
    cube = Polytope.from_points(signs(7))
    assert (len(cube.vertices), len(cube.normals)) == (128, 14)
    again = Polytope.from_halfspaces(np.concatenate([np.eye(7), -np.eye(7)]), np.ones(14))
    assert len(again.vertices) == 128


def test_hulls_pack_what_from_points_finds(rng: np.random.Generator) -> None:
    """Row ranges of the packed arrays are the polytopes, bit for bit; progress reaches the total."""
    sets = [rng.normal(size=(int(rng.integers(4, 30)), 3)) for _ in range(20)] + [signs(3).tolist()]
    seen: list[tuple[int, int]] = []
    h = polytopes.hulls(sets, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (21, 21)
    assert len(h) == 21
    for i, points in enumerate(sets):
        piece = Polytope.from_points(points)
        v, f, t = (slice(s[i], s[i + 1]) for s in (h.vert_start, h.face_start, h.triangle_start))
        assert (h.vertices[v] == piece.vertices).all()
        assert (h.normals[f] == piece.normals).all()
        assert (h.offsets[f] == piece.offsets).all()
        assert (h.triangles[t] == piece.simplices).all()
    assert len(polytopes.hulls([])) == 0


BAD_POINTS = {
    "nan": ([[0, 0], [1, 0], [0, np.nan]], InputError, "finite"),
    "inf": ([[0, 0], [1, 0], [0, -np.inf]], InputError, "finite"),
    "none": (np.empty((0, 3)), GeometryError, "at least 4 points"),
    "too few": ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], GeometryError, "found 3"),
    "one dimension": ([[0.0], [1.0]], InputError, "n >= 2"),
    "one axis": ([1.0, 2.0], InputError, "expected shape"),
    "duplicates": (np.ones((9, 3)), GeometryError, "in one place"),
    "collinear": (np.outer(np.arange(9.0), [1, 2, 3]) + 7, GeometryError, "on a line"),
    "a sheet of 1e-16 across x": (signs(3) * [1e-16, 1, 1], GeometryError, "in a plane"),
    "a sheet of 1e-16 across y": (signs(3) * [1, 1e-16, 1], GeometryError, "in a plane"),
    "a sheet of 1e-16 across z": (signs(3) * [1, 1, 1e-16], GeometryError, "in a plane"),
    "a thread of 1e-16 about y": (signs(3) * [1e-16, 1, 1e-16], GeometryError, "on a line"),
    "flat": (np.c_[polygon(9), np.ones(9)] @ [[1, 2, 0], [0.3, 1, 1], [1, 0, 2]], GeometryError, "in a plane"),
}


@pytest.mark.parametrize("name", BAD_POINTS)
def test_bad_points_are_named(name: str) -> None:
    """Points without a hull of full dimension say so."""
    points, error, message = BAD_POINTS[name]
    with pytest.raises(error, match=message):
        Polytope.from_points(points)


def test_bad_set_is_numbered() -> None:
    """The batch names the set."""
    with pytest.raises(GeometryError, match=r"point_sets\[1\].*in a plane"):
        polytopes.hulls([signs(3), signs(3) * [1, 1, 0]])
    with pytest.raises(InputError, match=r"point_sets\[0\].*\(n, 3\)"):
        polytopes.hulls([signs(2)])


SQUARE = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
BAD_HALFSPACES = {
    "nan": (SQUARE, [1, 1, np.nan, 1], InputError, "finite"),
    "lengths": (SQUARE, [1, 1], InputError, "expected shape"),
    "one dimension": ([[1.0], [-1.0]], [1, 1], InputError, "n >= 2"),
    "empty": (SQUARE, [1, -2, 1, 1], GeometryError, "empty"),
    "flat": (SQUARE, [1, -1, 1, 1], GeometryError, "flat"),
    "unbounded": (SQUARE[:3], [1, 1, 1], GeometryError, "unbounded"),
}


@pytest.mark.parametrize("name", BAD_HALFSPACES)
def test_bad_halfspaces_are_named(name: str) -> None:
    """Empty, flat and unbounded are told apart."""
    A, b, error, message = BAD_HALFSPACES[name]
    with pytest.raises(error, match=message):
        Polytope.from_halfspaces(A, b)


def test_results_are_frozen() -> None:
    """The arrays of a polytope cannot be written."""
    piece = Polytope.from_points(signs(3))
    with pytest.raises(ValueError, match="read-only"):
        piece.vertices[0] = 1
