"""Bodies of what sensors see: clouds, voxels, spheres, boxes, terrain, half-spaces; against loops over all parts."""

import functools
import io
import pickle
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import loewner
from exact import halfspaces_crossed, points_outside
from gantry import gantry
from loewner import (
    Body,
    CollisionChecker,
    FileError,
    GeometryError,
    InputError,
    MemoryLimitError,
    Robot,
    Scene,
    planners,
)
from loewner._base import _memory
from loewner.bodies import sensed
from loewner.cli import configurations, inputs
from loewner.scenes.files.sensor_shapes import read_array
from sampling import quick

SHAPES = {
    "ball": Body.sphere(0.07),
    "box": Body.box([0.2, 0.1, 0.05]),
    "capsule": Body.capsule(0.03, 0.2),
    "hull": Body.from_points(np.random.default_rng(5).normal(size=(40, 3)) * 0.06),
}


def places(rng: np.random.Generator, n: int, low: float = -0.2, high: float = 1.2) -> np.ndarray:
    """Random poses whose translations are in a cube."""
    T = np.tile(np.eye(4), (n, 1, 1))
    q = rng.normal(size=(n, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    T[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    T[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    T[:, 2, :3] = np.cross(T[:, 0, :3], T[:, 1, :3])
    T[:, :3, 3] = rng.uniform(low, high, size=(n, 3))
    return T


def one_by_one(parts: list[Body], body: Body, T: np.ndarray) -> np.ndarray:
    """Whether a body meets any of the parts, in a loop over these."""
    return np.any([loewner.collide(part, None, body, T) for part in parts], axis=0)


def ball_at(center: np.ndarray, radius: float) -> Body:
    T = np.eye(4)
    T[:3, 3] = center
    return Body.sphere(radius).transformed(T)


# -- against a loop over all parts ------------------------------------------------------------------


@functools.cache
def a_hundred_parts(kind: str) -> tuple[Body, list[Body]]:
    """A body of a hundred parts, and each of them as a body of its own."""
    rng = np.random.default_rng(20240229)
    centers = rng.uniform(size=(100, 3))
    if kind == "cloud":
        return Body.from_cloud(centers, radius=0.02), [ball_at(c, 0.02) for c in centers]
    if kind == "spheres":
        radii = rng.uniform(0.01, 0.05, size=100)
        return Body.spheres(centers, radii), [ball_at(c, r) for c, r in zip(centers, radii, strict=True)]
    if kind == "boxes":
        edges = rng.uniform(0.01, 0.1, size=(100, 3))
        corners = np.array(list(product([-0.5, 0.5], repeat=3)))
        parts = [Body.from_points(c + e * corners) for c, e in zip(centers, edges, strict=True)]
        return Body.boxes(centers, edges), parts
    corners = np.array(list(product([0.0, 1.0], repeat=3)))
    parts = [Body.from_points(0.05 * (np.floor(c / 0.05) + corners)) for c in centers]
    return Body.from_cloud(centers, voxel=0.05), parts


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "kind", ["cloud", "voxels", *(pytest.param(k, marks=pytest.mark.verify) for k in ("spheres", "boxes"))]
)
@pytest.mark.parametrize("count", quick(60, 400))
def test_collide_and_distance_agree_with_a_loop_over_all_parts(
    kind: str, shape: str, rng: np.random.Generator, count: int
) -> None:
    """A hundred parts: the same verdicts, distances to 1e-9, and no certified verdict that is wrong."""
    body, parts = a_hundred_parts(kind)
    T = places(rng, count)
    other = SHAPES[shape]
    expected = one_by_one(parts, other, T)
    assert 0.03 < expected.mean() < 0.95
    assert (loewner.collide(body, None, other, T) == expected).all()
    verdicts = loewner.classify(body, None, other, T)
    assert not expected[verdicts == loewner.Verdict.FREE].any()
    assert expected[verdicts == loewner.Verdict.COLLIDING].all()
    free = T[~expected]
    least = np.min([loewner.distance(p, None, other, free, exact=True).distance for p in parts], axis=0)
    np.testing.assert_allclose(loewner.distance(body, None, other, free, exact=True).distance, least, atol=1e-9)


@given(st.integers(1, 60), st.floats(1e-3, 0.2), st.integers(0, 2**32 - 1))
def test_a_ball_meets_a_cloud_when_a_point_is_near(count: int, radius: float, seed: int) -> None:
    """For clouds of any size, some with points that are equal, in a line or in a plane."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(count, 3)) * [1, rng.integers(2), rng.integers(2)]
    points = points[rng.integers(count, size=count)]
    T = places(rng, 50)
    near = np.linalg.norm(points[:, None] - T[:, :3, 3], axis=2).min(axis=0)
    found = loewner.collide(Body.from_cloud(points, radius=radius), None, Body.sphere(0.05), T)
    clear = np.abs(near - radius - 0.05) > 1e-12
    assert (found == (near <= radius + 0.05))[clear].all()


def test_planes_that_spare_searches_change_no_verdict(rng: np.random.Generator) -> None:
    """20,000 points on a wavy sheet, at a thousand places near it, for pieces of all kinds: as points one by one."""
    xy = rng.uniform(size=(20_000, 2))
    points = np.column_stack([xy, 0.1 * np.sin(8 * xy[:, 0]) * np.cos(5 * xy[:, 1])])
    cloud = Body.from_cloud(points, radius=0.005)
    ball = Body.sphere(0.005)
    for body in SHAPES.values():
        T = places(rng, 250, -0.1, 0.9)
        T[:, 2, 3] = rng.uniform(-0.2, 0.2, size=250)
        found = loewner.collide(cloud, None, body, T)
        assert 0.1 < found.mean() < 0.9
        for k in rng.choice(250, size=25, replace=False):
            at = np.tile(np.eye(4), (len(points), 1, 1))
            at[:, :3, 3] = points
            assert loewner.collide(body, T[k], ball, at).any() == found[k]


# -- what the parts are -----------------------------------------------------------------------------


def test_boxes_hold_their_ellipsoids_exactly(rng: np.random.Generator) -> None:
    """In rational arithmetic, also far from the origin: inner in the half-spaces of the corners, corners in outer."""
    centers = np.concatenate([rng.uniform(-1, 1, size=(10, 3)), 1e3 + rng.uniform(size=(10, 3))])
    body = Body.boxes(centers, rng.uniform(0.01, 1, size=(20, 3)))
    for piece in body.pieces:
        lower, upper = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        A, b = np.concatenate([np.eye(3), -np.eye(3)]), np.concatenate([upper, -lower])
        assert halfspaces_crossed(A, b, piece.inner.center, piece.inner.factor) == 0
        assert points_outside(piece.vertices, piece.outer.center, piece.outer.factor) == 0
        assert (np.sort(piece.offsets) == np.sort(b)).all()
        assert (piece.vertices @ piece.normals.T <= piece.offsets).all()
        assert max(piece.inner_gap, piece.outer_gap) < 1e-8


def test_voxels_are_the_cells_that_points_are_in(rng: np.random.Generator) -> None:
    """Rows of cells cover each occupied cell once and nothing else, whatever the axis they run along."""
    cells = np.unique(rng.integers(-4, 5, size=(300, 3)), axis=0)
    for axis in range(3):
        first, last = sensed._rows_along(cells, axis)
        covered = [tuple(a + k * np.eye(3, dtype=int)[axis]) for a, b in zip(first, last, strict=True)
                   for k in range(b[axis] - a[axis] + 1)]  # fmt: skip
        assert len(covered) == len(cells)
        assert set(covered) == set(map(tuple, cells))
    points = rng.uniform(-1, 1, size=(200, 3))
    expected = {tuple(int(Fraction(x) // Fraction(0.25)) for x in p) for p in points}
    assert set(map(tuple, sensed.cells_of(points, 0.25))) == expected


@pytest.mark.parametrize("shape", [(9, 4, 5), (4, 9, 5), (4, 5, 9), (1, 1, 1), (7, 1, 1)])
def test_boxes_of_a_grid_are_its_cells(rng: np.random.Generator, shape: tuple[int, int, int]) -> None:
    """Each occupied cell is in one box and no other cell is, whatever the axis along which rows are fewest."""
    for share in (0.2, 0.5, 0.9, 1.0):
        grid = rng.uniform(size=shape) < share
        grid[0, 0, 0] = True
        pieces = Body.from_voxels(grid, 1.0).pieces
        covered = np.zeros(shape, int)
        for piece in pieces:
            i, j, k = piece.vertices.min(axis=0).astype(int)
            p, q, r = piece.vertices.max(axis=0).astype(int)
            covered[i:p, j:q, k:r] += 1
        np.testing.assert_array_equal(covered, grid)
        fewest = min(np.count_nonzero(np.diff(grid, axis=axis, prepend=False) & grid) for axis in range(3))
        assert len(pieces) == fewest


def test_what_does_not_fit_is_refused_before_it_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Large inputs are held against the memory there is; views that take none, too."""
    monkeypatch.setattr(_memory, "left", lambda: (2**26, " left in this test"))
    told = "expected .* GiB of memory at least, found 0.0625 GiB left in this test"
    for call, what in (
        (
            lambda: Body.from_voxels(np.broadcast_to(False, (10**5, 10**5, 10**3)), 0.1),
            "grid: 100000 x 100000 x 1000 c",
        ),
        (lambda: Body.from_voxels(np.ones((200, 200, 1), bool), 0.1), None),
        (lambda: Body.from_voxels(np.indices((70, 70, 70)).sum(axis=0) % 2 == 0, 0.1), "grid: 171500 boxes"),
        (lambda: Body.from_cloud(np.zeros((300_000, 3)), radius=0.1), "points: 300000 triangles or balls"),
        (lambda: Body.height_field(np.zeros((400, 400)), 0.1), "a height field of 400 x 400"),
        (lambda: Body.spheres(np.zeros((70_000, 3)), 0.1), "70000 spheres"),
    ):
        if what is None:
            assert len(call().pieces) == 200
        else:
            with pytest.raises(MemoryLimitError, match=f"{what}.*: {told}"):
                call()


def test_a_grid_is_where_its_origin_says() -> None:
    """One row of cells is one box, at origin + size (i, j, k)."""
    grid = np.zeros((5, 4, 3), bool)
    grid[1:4, 2, 1] = True
    (piece,) = Body.from_voxels(grid, 0.5, origin=[10, 20, 30]).pieces
    np.testing.assert_allclose(piece.vertices.min(axis=0), [10.5, 21, 30.5])
    np.testing.assert_allclose(piece.vertices.max(axis=0), [12, 21.5, 31])


def test_terrain_is_solid_down_to_its_base(rng: np.random.Generator) -> None:
    """Small balls collide exactly where they are below the surface that the triangles make."""
    heights = rng.uniform(0, 0.3, size=(7, 9))
    ground = Body.height_field(heights, [0.5, 0.25], base=-1.0)
    assert ground.pieces[0].kind == "solid"
    xy = rng.uniform([0.01, 0.01], [2.99, 1.99], size=(500, 2))
    z = rng.uniform(-0.9, 0.5, size=500)
    i, j = np.floor(xy / [0.5, 0.25]).astype(int).T
    s, t = (xy / [0.5, 0.25] - np.stack([i, j], axis=1)).T
    a, b, c, d = heights[i, j], heights[i + 1, j], heights[i + 1, j + 1], heights[i, j + 1]
    surface = np.where(s >= t, a + s * (b - a) + t * (c - b), a + t * (d - a) + s * (c - d))
    T = np.tile(np.eye(4), (500, 1, 1))
    T[:, :3, 3] = np.column_stack([xy, z])
    found = loewner.collide(ground, None, Body.sphere(1e-6), T)
    clear = np.abs(z - surface) > 1e-5
    assert clear.sum() > 490
    assert (found == (z < surface))[clear].all()
    default = Body.height_field(heights, 0.5)
    assert default.pieces[0].vertices[:, 2].min() == heights.min() - 4.0


@pytest.mark.parametrize("normal", [[0, 0, 1], [0, 0, -2], [1, 0, 0], [1, 2, 3], [-1e-200, 1e-200, 0], [1e200, 1, 1]])
def test_half_spaces_end_at_their_plane(normal: list[float]) -> None:
    """The distance of a ball from a floor or wall is that from its plane, on the side the normal points to."""
    n = np.array(normal) / np.abs(normal).max()
    n /= np.linalg.norm(n)
    wall = Body.half_space(normal, -0.5, extent=50.0)
    T = np.eye(4)
    for height in (0.3, 2.0):
        T[:3, 3] = (height - 0.5) * n + np.cross(n, [0.3, 0.4, 0.5])
        found = loewner.distance(wall, None, Body.sphere(0.1), T, exact=True).distance
        np.testing.assert_allclose(found, height - 0.1, atol=1e-9)
    T[:3, 3] = -0.5 * n - 3 * n
    assert loewner.collide(wall, None, Body.sphere(0.1), T)


# -- as any other body ------------------------------------------------------------------------------


def test_clouds_are_bodies_like_any_other(rng: np.random.Generator, tmp_path: Path) -> None:
    """Saved, pickled, moved, united with others, and against each other."""
    cloud = Body.from_cloud(rng.uniform(size=(500, 3)), radius=0.01)
    T = places(rng, 40)
    expected = loewner.collide(cloud, None, SHAPES["box"], T)
    cloud.save(tmp_path / "cloud.npz")
    for copy in (Body.load(tmp_path / "cloud.npz"), pickle.loads(pickle.dumps(cloud))):
        assert repr(copy) == repr(cloud) == "Body(cloud, 500 points, radius 0.01)"
        assert (loewner.collide(copy, None, SHAPES["box"], T) == expected).all()
    moved = cloud.transformed(T[0])
    assert (loewner.collide(moved, None, SHAPES["box"], T[0] @ T) == expected).all()
    both = Body.union([cloud, ball_at(np.array([3.0, 0, 0]), 0.1)])
    assert (loewner.collide(both, None, SHAPES["box"], T) == expected).all()
    other = Body.from_cloud(rng.uniform(size=(400, 3)), radius=0.005)
    a, b = cloud.pieces[0].vertices, other.pieces[0].vertices
    far = T[:8].copy()
    far[:, 0, 3] += 0.8
    placed = np.einsum("tij,nj->tni", far[:, :3, :3], b) + far[:, None, :3, 3]
    least = np.linalg.norm(placed[:, :, None] - a, axis=3).min(axis=(1, 2)) - 0.015
    found = loewner.distance(cloud, None, other, far, exact=True).distance
    assert (found <= 0).tolist() == (least <= 0).tolist()
    np.testing.assert_allclose(found[least > 0], least[least > 0], atol=1e-9)
    assert (loewner.collide(cloud, None, other, far) == (least <= 0)).all()


@pytest.mark.parametrize("kind", ["cloud", "voxels", "spheres"])
@pytest.mark.parametrize("count", quick(80, 200))
def test_robots_among_sensor_data(kind: str, count: int, rng: np.random.Generator, tmp_path: Path) -> None:
    """Configurations, motions and clearances of a robot agree with a loop over parts; a new cloud is noticed."""
    robot = Robot.from_urdf(gantry(tmp_path)[0])
    checker = CollisionChecker(robot, scene := Scene())
    Q = robot.random_configurations(count, 0)
    reach = robot.forward_kinematics(Q)[:, -1, :3, 3]
    for _ in range(2):
        centers = rng.uniform(reach.min(axis=0), reach.max(axis=0), size=(60, 3))
        if kind == "cloud":
            body, parts = Body.from_cloud(centers, radius=0.03), [ball_at(c, 0.03) for c in centers]
        elif kind == "spheres":
            body, parts = Body.spheres(centers, 0.03), [ball_at(c, 0.03) for c in centers]
        else:
            body = Body.from_cloud(centers, voxel=0.06)
            parts = [Body.boxes([p.outer.center], np.ptp(p.vertices, axis=0)) for p in body.pieces]
        if "seen" in scene:
            scene.replace("seen", body)
        else:
            scene.add("seen", body)
        single = Scene()
        for k, part in enumerate(parts):
            single.add(str(k), part)
        loop = CollisionChecker(robot, single)
        expected = loop.collide(Q)
        assert 0.02 < expected.mean() < 0.98
        assert (checker.collide(Q) == expected).all()
        np.testing.assert_allclose(
            checker.distance(Q[~expected], exact=True).distance,
            loop.distance(Q[~expected], exact=True).distance,
            atol=1e-9,
        )
        free = Q[~expected][:8]
        found = checker.certify_edges(free[:-1], free[1:])
        assert loop.valid_edges(free[:-1], free[1:], 0.005)[found.verdict == loewner.Verdict.FREE].all()
        for k in np.flatnonzero(found.verdict == loewner.Verdict.COLLIDING):
            assert loop.collide(robot.between(free[k], free[k + 1], found.fraction[k]))


def test_a_plan_in_a_tunnel_of_points_is_proven(tmp_path: Path) -> None:
    """Above a floor of points, and among so many that each part of them reaches into the free space."""
    robot = Robot.from_urdf(gantry(tmp_path)[0])
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform([-2, -2, -0.5], [2, 2, -0.4], size=(500, 3)), [[0.0, 0, 3]]])
    start, goal = [-0.5, -0.5, 0.0], [0.5, 0.5, 0.0]
    checker = CollisionChecker(robot, scene := Scene())
    scene.add("seen", Body.from_cloud(points, radius=0.02))
    assert len(planners.plan(checker, start, goal)) >= 2
    scene.remove("seen")
    around = rng.uniform([-2, -2, -1], [2, 2, 1], size=(40_000, 3))
    around = around[np.hypot(around[:, 0] - around[:, 1], 2 * around[:, 2]) > 0.5]
    scene.add("seen", Body.from_cloud(around, radius=0.002))
    path = planners.plan(checker, start, goal)
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == 0).all()


# -- bad input --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Body.from_cloud(np.zeros((0, 3)), radius=1), GeometryError, "at least one point, found none"),
        (lambda: Body.from_cloud([[0, 0, np.nan]], radius=1), InputError, "points"),
        (lambda: Body.from_cloud([[0, 0]], radius=1), InputError, "points"),
        (lambda: Body.from_cloud([[0, 0, 0]]), InputError, "expected one of the two, found none"),
        (lambda: Body.from_cloud([[0, 0, 0]], radius=1, voxel=1), InputError, "found both"),
        (lambda: Body.from_cloud([[0, 0, 0]], radius=0), InputError, "radius"),
        (lambda: Body.from_cloud([[0, 0, 0]], radius=-1), InputError, "radius"),
        (lambda: Body.from_cloud([[0, 0, 0]], voxel=np.inf), InputError, "voxel"),
        (lambda: Body.from_cloud([[1e9, 0, 0]], voxel=1e-3), InputError, "cells within 1048576"),
        (lambda: Body.spheres([[0, 0, 0]], [1, 2]), InputError, "radii"),
        (lambda: Body.spheres([[0, 0, 0]], 0), InputError, "radii"),
        (lambda: Body.spheres(np.zeros((0, 3)), 1), GeometryError, "centers"),
        (lambda: Body.boxes([[0, 0, 0]], [1, 2]), InputError, "edges"),
        (lambda: Body.boxes([[0, 0, 0]], [[1, 2, -3]]), InputError, "edges"),
        (lambda: Body.boxes([[1e9, 0, 0]], 1e-6), GeometryError, "more than rounding, found box 0"),
        (lambda: Body.boxes([[1e300, 0, 0]], 1.0), GeometryError, "more than rounding"),
        (lambda: Body.from_voxels(np.zeros((2, 2, 2), bool), 1), GeometryError, "found none"),
        (lambda: Body.from_voxels(np.zeros((2, 2, 2)), 1), InputError, "array of bool"),
        (lambda: Body.from_voxels(np.ones((2, 2), bool), 1), InputError, "array of bool"),
        (lambda: Body.from_voxels(np.ma.array(np.ones((2, 2, 2), bool), mask=True), 1), InputError, "masked entries"),
        (lambda: Body.from_voxels(np.ones((2, 2, 2), bool), 0), InputError, "size"),
        (lambda: Body.from_voxels(np.ones((2, 2, 2), bool), 1, origin=[0, 0]), InputError, "origin"),
        (lambda: Body.height_field([[1.0]], 1), InputError, "at least two along each axis"),
        (lambda: Body.height_field([[1.0, np.nan], [0, 0]], 1), InputError, "heights"),
        (lambda: Body.height_field(np.zeros((2, 2)), [1, 2, 3]), InputError, "spacing"),
        (lambda: Body.height_field(np.zeros((2, 2)), 1, base=0.0), InputError, "below the lowest, 0 m, found 0"),
        (lambda: Body.half_space([0, 0, 0], 1), InputError, "normal"),
        (lambda: Body.half_space([0, 0, 1], np.inf), InputError, "offset"),
        (lambda: Body.half_space([0, 0, 1], 0, extent=0), InputError, "extent"),
        (lambda: Body.half_space([0, 0, 1], 0, extent=2e9), InputError, r"extent: expected at most 1e\+09 m, .*2e\+09"),
    ],
)
def test_bad_input_says_what_was_expected(call: object, error: type[Exception], message: str) -> None:
    """Each is an error of this library."""
    with pytest.raises(error, match=message):
        call()


# -- octrees, scene files ---------------------------------------------------------------------------


def test_octrees_are_the_boxes_of_their_leaves(rng: np.random.Generator, tmp_path: Path) -> None:
    """A written octree is read back: each point is inside, leaves have the size of the tree, and damage is told."""
    octomap = pytest.importorskip("octomap")
    tree = octomap.OcTree(0.1)
    points = rng.uniform(size=(200, 3))
    tree.insertPointCloud(points, np.array([0.5, 0.5, 3.0]))
    file = tmp_path / "map.bt"
    tree.writeBinary(str(file).encode())
    body = Body.from_octree(file)
    T = np.tile(np.eye(4), (200, 1, 1))
    T[:, :3, 3] = points
    assert loewner.collide(body, None, Body.sphere(1e-9), T).mean() > 0.95  # rays to others pass through some
    edges = np.array([np.ptp(piece.vertices, axis=0) for piece in body.pieces])
    np.testing.assert_allclose(edges / 0.1, np.round(edges / 0.1), atol=1e-6)
    # OctoMap's own library gives single precision.
    again = octomap.OcTree(0.1)
    assert again.readBinary(str(file).encode())
    centers = [leaf.getCoordinate() for leaf in again.begin_leafs() if again.isNodeOccupied(leaf)]
    np.testing.assert_allclose(
        sorted(tuple(piece.vertices.mean(axis=0).round(4) + 0.0) for piece in body.pieces),
        sorted(tuple(np.round(center, 4) + 0.0) for center in centers),
        atol=1e-6,
    )


OCTREE = b"# Octomap OcTree binary file\nid OcTree\nsize %d\nres 0.1\ndata\n"


def test_octrees_of_known_cells(tmp_path: Path) -> None:
    """An occupied child of the root is an eighth of the world; sixteen levels down it has the resolution as edge."""
    (tmp_path / "root.bt").write_bytes(OCTREE % 2 + b"\x02\x00")  # child 0: below the origin along all axes
    (piece,) = Body.from_octree(tmp_path / "root.bt").pieces
    np.testing.assert_allclose([piece.vertices.min(axis=0), piece.vertices.max(axis=0)], [[-3276.8] * 3, [0.0] * 3])
    chain = b"\x00\xc0" + b"\x03\x00" * 14 + b"\x00\x80"  # the last child, fourteen first ones, a last leaf
    (tmp_path / "deep.bt").write_bytes(OCTREE % 17 + chain)
    (piece,) = Body.from_octree(tmp_path / "deep.bt").pieces
    np.testing.assert_allclose([piece.vertices.min(axis=0), piece.vertices.max(axis=0)], [[0.1] * 3, [0.2] * 3])


@pytest.mark.parametrize(("data", "count"), [(b"\x0a\x00", 3), (b"\x0a\x0a", 5), (b"\x20\x0a", 4), (b"\x09\x0a", 5)])
def test_octrees_whose_first_bytes_are_white_space(data: bytes, count: int, tmp_path: Path) -> None:
    """The data begins behind the first line feed, and two bits of a leaf that are 10 make it occupied."""
    for end in (b"data\n", b"data\r\n", b"data \n"):
        (tmp_path / "map.bt").write_bytes(OCTREE.replace(b"data\n", end) % count + data)
        word = int.from_bytes(data, "little")
        occupied = sum(word >> 2 * child & 3 == 2 for child in range(8))
        assert len(Body.from_octree(tmp_path / "map.bt").pieces) == occupied


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"# Octo", "begins with"),
        (OCTREE.replace(b"0.1", b"-1") % 2 + b"\x02\x00", "expected res, a length in metres, found '-1'"),
        (OCTREE % 2, "cut off"),
        (OCTREE % 2 + b"\x02", "cut off"),
        (OCTREE % 3 + b"\x02\x00", "with 3 nodes in 2 bytes, found 2 in 2"),
        (OCTREE % 2 + b"\x02\x00\x00", "with 2 nodes in 2 bytes, found 2 in 3"),
        (OCTREE % 100_010 + b"\x03\x00" * 100_000 + b"\xaa\xaa", "octree of 16 levels, found one that is deeper"),
        (OCTREE % 18 + b"\x03\x00" * 16 + b"\x02\x00", "octree of 16 levels, found one that is deeper"),
    ],
)
def test_damaged_octrees_are_refused(tmp_path: Path, capfd, data: bytes, message: str) -> None:
    """Whatever is altered, cut off or too deep gives an error with the file's name, and nothing besides."""
    (tmp_path / "broken.bt").write_bytes(data)
    with pytest.raises(FileError, match=rf"broken.bt: .*{message}"):
        Body.from_octree(tmp_path / "broken.bt")
    assert capfd.readouterr() == ("", "")


HOLES = {
    "an empty cell": ("a.csv", "0.5,0.0,0.1,0.9\n0.5,0.1,,0.9\n", "a.csv, line 2: .*found an empty one"),
    "one in every line": ("a.csv", "0.5,0.0,,0.9\n0.5,0.1,,0.9\n", "a.csv, line 1: .*found an empty one"),
    "an empty last cell": ("a.csv", "1,2,\n3,4,\n", "a.csv, line 1: .*found an empty one"),
    "an empty cell of a text": ("a.xyz", "# x, y, z\n\n1, 2, 3\n1,,2,3\n", "a.xyz, line 4: .*found an empty one"),
    "decimal commas": ("a.csv", "0,5 0,7\n0,5 0,7\n", "a.csv, line 1: .*no decimal commas, found '5 0'"),
    "decimal commas in a text": ("a.txt", "1 2\n0,5 0,7\n", "a.txt, line 1: .*no decimal commas, found '1 2'"),
    "lines of both kinds": ("a.txt", "1,2,3\n1 2 3\n", "a.txt, line 2: .*not by both.* found '1 2 3'"),
    "spaces in a CSV": ("a.csv", "1 2 3\n1 2 3\n", "a.csv, line 1: .*not by both.* found '1 2 3'"),
    "a word": ("a.csv", "1,2,3\n1,2,three\n", "a.csv, line 2: expected a number, found 'three'"),
    "a shorter line": ("a.csv", "1,2,3\n1,2\n", "a.csv, line 2: expected 3 numbers as in the first line, found 2"),
    "comments alone": ("a.csv", "# 1,2,3\n", "a.csv: expected an array of numbers, found none"),
}


@pytest.mark.parametrize("name", HOLES)
def test_tables_with_holes_are_refused(name: str, tmp_path: Path) -> None:
    """No number moves into the place of one that is missing: the file and the line are named."""
    file, text, message = HOLES[name]
    (tmp_path / file).write_text(text)
    with pytest.raises(FileError, match=message):
        read_array(tmp_path / file)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("a.csv", "1,2,3\n4,5,6\n"),
        ("a.csv", "# x, y\r\n1, 2 ,3\r\n  \r\n 4,5,6 # last\r\n"),
        ("a.txt", "1 2 3\n\n  # 0,0\n4\t5 6"),
        ("a.XYZ", "1, 2, 3\n  # none\n4,5,6\n"),
    ],
)
def test_tables_without_holes_are_read(file: str, text: str, tmp_path: Path) -> None:
    """Spaces beside commas, comments and blank lines do no harm."""
    (tmp_path / file).write_text(text, newline="")
    assert read_array(tmp_path / file).tolist() == [[1, 2, 3], [4, 5, 6]]


def _npy(header: bytes, version: int = 1) -> bytes:
    return b"\x93NUMPY" + bytes([version, 0]) + len(header).to_bytes(2 if version == 1 else 4, "little") + header


def _saved(array: object, **options: bool) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


def _archive() -> bytes:
    file = io.BytesIO()
    np.savez(file, a=np.eye(3))
    return file.getvalue()


HUGE = "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }\n"
DAMAGED_ARRAYS = {
    "another kind of file": b"words",
    "nothing": b"",
    "the beginning alone": b"\x93NUMPY",
    "the beginning of an archive": b"PK\x03\x04 and more",
    "a whole archive": _archive(),
    "brackets": _npy(b"(" * 500 + b"\n"),
    "a pickle": _saved(np.array([{}, None], dtype=object), allow_pickle=True),
    "texts": _saved(np.array(["a", "b"])),
    "a type that there is not": _npy(b"{'descr': '<f7', 'fortran_order': False, 'shape': (), }\n") + bytes(7),
    "more axes than there are": _npy((HUGE % ("1, " * 99 + "1")).encode()) + bytes(8),
    "a larger shape": _npy((HUGE % 10**12).encode()) + bytes(800),
    "an absurd shape": _npy((HUGE % ", ".join(["9" * 18] * 5)).encode(), 2) + bytes(800),
    "a length beyond the file": b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(9),
    "numbers cut off": _saved(np.eye(4))[:-1],
    "two arrays": _saved(np.eye(4)) * 2,
}


@pytest.mark.parametrize("name", DAMAGED_ARRAYS)
def test_damaged_arrays_are_refused(name: str, tmp_path: Path) -> None:
    """Whatever is wrong with a file of NumPy, for scenes and on the command line, is an error that names the file."""
    (tmp_path / "a.npy").write_bytes(DAMAGED_ARRAYS[name])
    robot = Robot.from_urdf(gantry(tmp_path)[0])
    for read in (read_array, lambda path: inputs.pose(str(path), "T"), lambda path: configurations.read(path, robot)):
        with pytest.raises(FileError, match="a.npy: expected a"):
            read(tmp_path / "a.npy")


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
@pytest.mark.parametrize("kind", ["<f8", ">f4", "<i2", "|u1", "|b1"])
@pytest.mark.parametrize("shape", [(), (0, 3), (4, 3), (2, 3, 4)])
def test_arrays_are_read_as_numpy_reads_them(version: tuple[int, int], kind: str, shape: tuple, tmp_path: Path) -> None:
    """All versions of the format, both orders, all kinds of numbers; what is read may be written to."""
    array = np.arange(int(np.prod(shape))).reshape(shape).astype(kind)
    for saved in (array, np.asfortranarray(array)):
        with open(tmp_path / "a.npy", "wb") as file:
            np.lib.format.write_array(file, saved, version)
        found = read_array(tmp_path / "a.npy")
        assert found.dtype == saved.dtype
        assert found.shape == saved.shape
        assert (found == saved).all()
        assert found.flags.writeable


def test_scene_files_know_sensor_data(rng: np.random.Generator, tmp_path: Path) -> None:
    """All shapes, from files beside the scene; saved and read again they give the same verdicts."""
    points = rng.uniform(size=(50, 3))
    np.save(tmp_path / "points.npy", points)
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", fmt="%.17g")
    grid = rng.uniform(size=(4, 5, 6)) < 0.3
    np.save(tmp_path / "grid.npy", grid)
    np.save(tmp_path / "heights.npy", rng.uniform(size=(4, 5)))
    (tmp_path / "scene.yaml").write_text(
        """
        bodies:
          a: {cloud: {file: points.npy, radius: 0.02}}
          b: {cloud: {file: points.csv, voxel: 0.1}, position: [2, 0, 0]}
          c: {voxels: {file: grid.npy, size: 0.1, origin: [0, 0, 1]}}
          d: {height_field: {file: heights.npy, spacing: [0.1, 0.2], base: -1}}
          e: {half_space: {normal: [0, 0, 1], offset: -3}}
          f: {spheres: [[0, 0, 5, 0.5], [1, 0, 5, 0.25]]}
          g: {boxes: [[0, 0, 7, 1, 2, 3]]}
        """
    )
    scene = loewner.load_scene(tmp_path / "scene.yaml")
    assert repr(scene["a"]) == "Body(cloud, 50 points, radius 0.02)"
    assert len(scene["f"].pieces) == 2
    loewner.save_scene(scene, tmp_path / "again.yaml")
    again = loewner.load_scene(tmp_path / "again.yaml")
    T = places(rng, 100, -1, 8)
    for name in scene:
        expected = loewner.collide(scene[name], scene.pose(name), SHAPES["ball"], T)
        assert (loewner.collide(again[name], again.pose(name), SHAPES["ball"], T) == expected).all()
    for text, message in (
        ("cloud: {file: points.npy}", "found none"),
        ("cloud: {file: none.npy, radius: 1}", "but there is no such file"),
        ("cloud: {file: scene.yaml, radius: 1}", "ends in .npy"),
        ("voxels: {file: points.npy, size: 1}", "array of bool"),
        ("spheres: [[0, 0, 0]]", "sequence of 4"),
        ("half_space: {normal: [0, 0, 0], offset: 0}", "normal"),
    ):
        (tmp_path / "bad.yaml").write_text(f"bodies: {{x: {{{text}}}}}")
        with pytest.raises(FileError, match=message):
            loewner.load_scene(tmp_path / "bad.yaml")
    (tmp_path / "pickled.npy").write_bytes(b"\x93NUMPY\x01\x00 not an array")
    (tmp_path / "bad.yaml").write_text("bodies: {x: {cloud: {file: pickled.npy, radius: 1}}}")
    with pytest.raises(FileError, match="array of numbers"):
        loewner.load_scene(tmp_path / "bad.yaml")


@pytest.mark.parametrize("shape", ["cylinder", "cone", "capsule", "ellipsoid", "box"])
def test_depth_is_that_of_the_deepest_point(shape: str, rng: np.random.Generator) -> None:
    """Of a cloud in a piece of any kind, as of the same balls one by one; of triangles without area likewise."""
    body = {
        "cylinder": Body.cylinder(0.1, 0.2),
        "cone": Body.cone(0.1, 0.2),
        "capsule": Body.capsule(0.05, 0.2),
        "ellipsoid": Body.ellipsoid([0.1, 0.15, 0.2]),
        "box": Body.box([0.2, 0.3, 0.4]),
    }[shape]
    points = rng.uniform(-0.1, 0.1, size=(100, 3))
    T = places(rng, 1, -0.02, 0.02)[0]
    found = loewner.distance(Body.from_cloud(points, radius=1e-3), None, body, T, exact=True).distance
    at = np.tile(np.eye(4), (len(points), 1, 1))
    at[:, :3, 3] = points
    deepest = loewner.distance(Body.sphere(1e-3), at, body, T, exact=True).distance.min()
    assert deepest < -0.01
    np.testing.assert_allclose(found, deepest, rtol=1e-4)
    if shape == "cylinder":  # a rod without thickness along its axis
        line = Body.from_surface((np.array([[0, 0, -1.0], [0, 0, 0.5], [0, 0, 1]]), np.array([[0, 1, 2]])))
        np.testing.assert_allclose(loewner.distance(line, None, body, None, exact=True).distance, -0.1, rtol=1e-4)


@pytest.mark.parametrize("off", [3e-8, 3e-7])
def test_distances_at_poses_in_single_precision(off: float, rng: np.random.Generator) -> None:
    """Poses that are rigid to single precision only stretch ellipsoids and no radii: that is no reason to give up."""
    cloud, ball = Body.from_cloud(rng.uniform(size=(9, 3)), radius=0.01), Body.sphere(0.5)
    A, B = places(rng, 200, -3, 3), places(rng, 200, -3, 3)
    for T in (A, B):
        T[:, :3, :3] += off * rng.uniform(-1, 1, size=(200, 3, 3))
    placed = np.einsum("tij,nj->tni", A[:, :3, :3], cloud.pieces[0].vertices) + A[:, None, :3, 3]
    expected = np.linalg.norm(placed - B[:, None, :3, 3], axis=2).min(axis=1) - 0.51
    found = loewner.distance(cloud, A, ball, B, exact=True).distance
    np.testing.assert_allclose(found, expected, atol=1e-6)
