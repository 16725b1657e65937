"""The farthest vertex along a direction, however many there are: beside a search through all of them."""

from pathlib import Path

import numpy as np
import pytest

import loewner
from families import box_corners, polygon, prism, random_poses
from loewner import Bodies, Body
from loewner._kernels import columns
from loewner._kernels._jit import njit
from loewner._kernels.pieces.directions import direction_map
from loewner._kernels.pieces.pack import pieces_of, placed
from loewner._kernels.pieces.shapes import core_support
from sampling import quick


@njit()
def kernel_supports(handle, piece, directions, out):
    P = placed(pieces_of(handle), piece, np.empty((1, 4, 4)), 0)  # the pose does not matter
    for k in range(len(directions)):
        n = directions[k, 0], directions[k, 1], directions[k, 2]
        out[k, 0], out[k, 1], out[k, 2] = core_support(P, n)


def supports(body: Body | Bodies, piece: int, directions: np.ndarray) -> np.ndarray:
    out = np.empty(directions.shape)
    kernel_supports(body._packed.handle, piece, np.ascontiguousarray(directions), out)
    return out


def on_surface(count: int, power: float = 2.0, seed: int = 0) -> np.ndarray:
    """Points on |x|^p + |y|^p + |z|^p = 1, all of them vertices."""
    x = np.random.default_rng(seed).normal(size=(count, 3))
    return x / (np.abs(x) ** power).sum(axis=1, keepdims=True) ** (1 / power)


def bevelled_box(edge: int) -> np.ndarray:
    """A box with round edges: six flat faces, whose rims of `4 * edge` vertices are coplanar, and crowds between."""
    ring = polygon(4 * edge, 0.1)
    ball = np.concatenate([np.column_stack([ring * np.cos(t), np.full(len(ring), 0.1 * np.sin(t))])
                           for t in np.linspace(-1.5, 1.5, edge)])  # fmt: skip
    return (ball[:, None] + box_corners(np.array([2.0, 1.0, 1.0]))).reshape(-1, 3)


HULLS = {
    "tetrahedron": on_surface(4),
    "7 vertices": on_surface(7),
    "box": box_corners(np.ones(3)),
    "9 vertices": on_surface(9),
    "20 vertices": on_surface(20),
    "duplicates": np.repeat(on_surface(30), 5, axis=0),
    "128 vertices": on_surface(columns.LARGE),
    "129 vertices": on_surface(columns.LARGE + 1),
    "1,000 vertices": on_surface(1_000),
    "10,000 vertices": on_surface(10_000),
    "near a cube": on_surface(3_000, 8.0),
    "needle": on_surface(700) * (1e-3, 1.0, 1e-4),
    "far from its origin": on_surface(700) + (1e4, -1e5, 3.0),
    "tiny": on_surface(300) * 1e-12,
    "prism": prism(1_500, 1.0),
    "bevelled box": bevelled_box(8),
}


def awkward_directions(body: Body) -> np.ndarray:
    """Random ones; along faces' normals, where vertices tie; along the seams of the map of directions."""
    rng = np.random.default_rng(1)
    seams = np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1])).reshape(3, -1).T
    seams = seams[np.abs(seams).any(axis=1)].astype(float)
    quarters = rng.integers(-8, 9, size=(300, 3)) / 8.0
    quarters = quarters[np.abs(quarters).any(axis=1)]
    exact = np.concatenate([seams, quarters])
    beside = exact * (1 + rng.integers(-2, 3, size=exact.shape) * 2.0**-52)
    normals = body.pieces[0].normals
    assert normals is not None
    some = normals[rng.integers(len(normals), size=500)]
    directions = np.concatenate([rng.normal(size=(2000, 3)), exact, beside, some, -some])
    return np.concatenate([directions, directions[:200] * 1e-150, directions[:200] * 1e150])


@pytest.mark.parametrize("name", HULLS)
@pytest.mark.parametrize("every", quick(7, 1))
def test_farthest_is_farthest(name: str, every: int):
    """No vertex lies farther along any direction than the one found, but for the rounding of the comparison."""
    body = Body.from_points(HULLS[name])
    vertices = body.pieces[0].vertices
    assert vertices is not None
    assert (body._packed.kernel[1][0, columns.KIND] == columns.MAPPED) == (len(vertices) > columns.LARGE)
    directions = awkward_directions(body)[::every]
    found = supports(body, 0, directions)
    unit = directions / np.abs(directions).max(axis=1, keepdims=True)
    best = np.concatenate([(part @ vertices.T).max(axis=1) for part in np.array_split(unit, 40)])
    short = best - (unit * found).sum(axis=1)
    assert short.max() <= 8 * 2.0**-53 * 3 * np.abs(vertices).max()
    # What is found is one of the vertices, to the last bit.
    assert set(map(tuple, found)) <= set(map(tuple, vertices))


@pytest.mark.parametrize("name", ["20 vertices", "1,000 vertices", "prism"])
def test_any_direction_is_safe(name: str):
    """Zero, infinite and undefined directions still give a vertex."""
    body = Body.from_points(HULLS[name])
    vertices = body.pieces[0].vertices
    assert vertices is not None
    numbers = np.array([0.0, -0.0, 1.0, -1.0, 5e-324, np.inf, -np.inf, np.nan])
    directions = np.array(np.meshgrid(numbers, numbers, numbers)).reshape(3, -1).T
    assert set(map(tuple, supports(body, 0, directions))) <= set(map(tuple, vertices))


@pytest.mark.parametrize("count", [1_000, 10_000])
@pytest.mark.parametrize("power", [2.0, 4.0, 16.0])
def test_maps_grow_with_the_hull(count: int, power: float):
    """A map is linear in the vertices, its leaves are short."""
    columns, nodes = direction_map(on_surface(count, power))
    assert len(columns) < 10 * count
    assert len(nodes) < 2 * count
    leaves = nodes[nodes[:, 1] >= 0]
    lengths = leaves[:, 1] - leaves[:, 0]
    assert lengths.sum() == len(columns)
    assert np.median(lengths) <= 32


def test_every_vertex_is_on_the_map():
    """Each vertex is the farthest somewhere, so some leaf has it."""
    points = on_surface(2_000)
    columns, _ = direction_map(points)
    assert len(np.unique(columns)) == len(points)


def changed(tmp_path: Path, body: Body) -> dict[str, tuple[Body, int]]:
    """Other ways to the same piece, with the piece's number."""
    body.save(tmp_path / "body.npz")
    small = Body.box([1, 1, 1])
    return {
        "loaded": (Body.load(tmp_path / "body.npz"), 0),
        "of a union": (Body.union([small, Body.sphere(1), body, small]), 2),
        "of bodies": (Bodies([small, body, body])[[2, 0, 1]][2], 0),
        "chosen": (Bodies([small, body])[1], 0),
    }


def test_the_map_follows_its_piece(tmp_path: Path):
    """Saving, joining and choosing bodies keep the answers of a large piece to the last bit."""
    body = Body.from_points(on_surface(600))
    directions = np.random.default_rng(3).normal(size=(500, 3))
    expected = supports(body, 0, directions)
    for name, (other, piece) in changed(tmp_path, body).items():
        assert np.array_equal(supports(other, piece, directions), expected), name
    assert body.nbytes > Body.from_points(on_surface(600))._packed.kernel[2].nbytes


def test_a_moved_body_has_a_map_of_its_own():
    """The map of directions of a transformed body finds the farthest of the moved vertices."""
    T = random_poses(np.random.default_rng(4), 1, 2.0)[0]
    moved = Body.from_points(on_surface(600)).transformed(T)
    vertices = moved.pieces[0].vertices
    assert vertices is not None
    directions = np.random.default_rng(3).normal(size=(500, 3))
    found = supports(moved, 0, directions)
    assert (directions * found).sum(axis=1) == pytest.approx((directions @ vertices.T).max(axis=1), abs=1e-14)


OTHERS = {
    "itself": lambda: Body.from_points(on_surface(2_000)),
    "box": lambda: Body.box([1, 2, 0.5]),
    "prism": lambda: Body.from_points(prism(1_500, 1.0)),
    "capsule": lambda: Body.capsule(0.3, 1.0),
    "cone": lambda: Body.cone(0.5, 1.0),
}


@pytest.mark.parametrize("other", OTHERS)
def test_large_hulls_measure_as_their_vertices_say(other: str):
    """The distance of a hull of 2,000 vertices is that of the planes across its normal, found by a full search."""
    rng = np.random.default_rng(5)
    a, b = Body.from_points(on_surface(2_000)), OTHERS[other]()
    Ta, Tb = random_poses(rng, 60, 0.0), random_poses(rng, 60, 0.0)
    Tb[:, :3, 3] = rng.normal(size=(60, 3)) * 1.2
    vertices = a.pieces[0].vertices
    assert vertices is not None
    result = loewner.distance(a, Ta, b, Tb, exact=True)
    assert (loewner.collide(a, Ta, b, Tb) == (result.distance <= 0)).all()
    assert 10 < (result.distance > 0).sum() < 50
    for k in range(60):
        n, d = result.normal[k], result.distance[k]
        world = vertices @ Ta[k, :3, :3].T
        assert (world @ n).max() == pytest.approx(result.witness_a[k] @ n, abs=1e-9)
        assert result.witness_b[k] - result.witness_a[k] == pytest.approx(d * n, abs=1e-9)
    back = loewner.distance(b, Tb, a, Ta, exact=True)
    assert back.distance == pytest.approx(result.distance, abs=1e-9)


@pytest.mark.parametrize("wobble", [0.0, 1e-16, 1e-15, 1e-14])
@pytest.mark.parametrize("pairs", quick(100, 300))
def test_facing_faces_are_apart(wobble: float, pairs: int):
    """Faces of many nearly coplanar vertices, parallel and apart: flat simplices never pass for an overlap."""
    rng = np.random.default_rng(6)
    sides, gap = 12, 0.25
    shapes_a = [prism(sides, 1.0) + wobble * rng.normal(size=(2 * sides, 3)) for _ in range(pairs)]
    shapes_b = [prism(sides, 1.0) + wobble * rng.normal(size=(2 * sides, 3)) for _ in range(pairs)]
    a, b = Bodies.from_points(shapes_a), Bodies.from_points(shapes_b)
    Tb = np.tile(np.eye(4), (pairs, 1, 1))
    Tb[:, :2, 3] = rng.uniform(-1, 1, size=(pairs, 2))
    Tb[:, 2, 3] = 1.0 + gap
    result = loewner.distance(a, None, b, Tb, exact=True)
    assert result.distance == pytest.approx(gap, abs=1e-12)
    assert not loewner.collide(a, None, b, Tb).any()
    assert not loewner.collide(a, None, b, Tb, margin=gap - 1e-9).any()
    assert loewner.collide(a, None, b, Tb, margin=gap + 1e-9).all()
