"""Laws of bodies that are triangle meshes as they are: known answers, the oracle of surfaces, every other shape."""

import functools
import pickle
from collections.abc import Callable
from fractions import Fraction
from itertools import permutations, product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import loewner
import surface_oracle
from checker_oracle import agrees, random_robot, random_scene, robot_of
from families import random_poses, translation
from loewner import (
    Bodies,
    Body,
    CollisionChecker,
    FileError,
    GeometryError,
    InputError,
    LoewnerError,
    Scene,
    Verdict,
    classify,
    collide,
    distance,
    overlapping_pairs,
)
from loewner._native import entries
from sampling import examples, quick, quick_of
from surface_oracle import Mesh, boundary, collides

SEEDS = st.integers(0, 2**32 - 1)
EYE = np.eye(4)
# Relative to the lengths involved: what distances are computed to.
TIGHT = 1e-12
# So near to contact, relative, nothing is rounded away.
HAIR = 1e-9

# The cup: radius and height of its inside, wall and floor, sides of its polygon.
INSIDE, DEPTH, WALL, SIDES = 0.4, 1.0, 0.05, 24


# -- meshes ------------------------------------------------------------------------------------


def made(mesh: trimesh.Trimesh, solid: bool | None = None, inwards: bool = False) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1] if inwards else mesh.faces, solid)


def box(size: float | tuple = 1.0, center: tuple = (0, 0, 0), **options: bool) -> Mesh:
    mesh = trimesh.creation.box(np.broadcast_to(size, 3))
    mesh.apply_translation(center)
    return made(mesh, **options)


def joined(*meshes: Mesh, solid: bool | None = None) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + start for m, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces), solid)


def cup(solid: bool | None = None) -> Mesh:
    """Open at the top, its inside from z = 0 to DEPTH: a closed mesh with a cavity that is outside."""
    profile = [(0, -WALL), (INSIDE + WALL, -WALL), (INSIDE + WALL, DEPTH), (INSIDE, DEPTH), (INSIDE, 0), (0, 0)]
    return made(trimesh.creation.revolve(profile, sections=SIDES), solid)


def ring(solid: bool | None = None) -> Mesh:
    return made(trimesh.creation.torus(0.6, 0.2, 16, 8), solid)


def hollow() -> Mesh:
    """A box with a cavity, and a box within that."""
    return joined(box(2.0), box(1.6, inwards=True), box(0.6))


def plane(cells: int) -> Mesh:
    """An open square of unit cells at z = 0 about the origin."""
    n = cells + 1
    x, y = np.meshgrid(np.arange(n) - cells / 2, np.arange(n) - cells / 2, indexing="ij")
    i, j = (k.ravel() for k in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Mesh(np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)]), faces)


def soup(rng: np.random.Generator, count: int, grid: bool) -> Mesh:
    """Triangles with nothing in common: some twice, some segments or points; the first has an area."""
    corners = rng.integers(0, 5, (count, 3, 3)) / 4 if grid else rng.uniform(-0.7, 0.7, (count, 3, 3))
    corners[0] += 0.25 * np.eye(3) * (np.linalg.norm(np.cross(*np.diff(corners[0], axis=0))) == 0)
    for k in range(1, count):
        kind = rng.integers(8)
        if kind == 0:
            corners[k] = corners[k, 0]
        elif kind == 1:
            corners[k, 2] = (corners[k, 0] + corners[k, 1]) / 2 if grid else corners[k, 1]
        elif kind == 2:
            corners[k] = corners[rng.integers(k), rng.permutation(3)]
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count), False)


def surface(mesh: Mesh, **options: float) -> Body:
    source = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return Body.from_surface(source, solid=bool(mesh.solid), **options)


def quarter_turns() -> np.ndarray:
    """The 24 rotations of a cube, exact."""
    turns = []
    for order, signs in product(permutations(range(3)), product((-1.0, 1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), order] = signs
        if np.linalg.det(R) > 0:
            turns.append(R)
    return np.array(turns)


def grid_poses(rng: np.random.Generator, count: int) -> np.ndarray:
    T = np.tile(EYE, (count, 1, 1))
    T[:, :3, :3] = quarter_turns()[rng.integers(24, size=count)]
    T[:, :3, 3] = rng.integers(-4, 5, (count, 3)) / 4
    return T


SOLIDS: dict[str, Callable[[], Mesh]] = {
    "box": box,
    "box as a skin": lambda: box(solid=False),
    "cup": cup,
    "cup as a skin": lambda: cup(solid=False),
    "ring": ring,
    "shells": hollow,
    "plane": lambda: plane(2),
    "soup": lambda: soup(np.random.default_rng(5), 9, grid=False),
}


@functools.cache
def solid(name: str) -> tuple[Mesh, Body]:
    """One of them, for the oracle and for the library."""
    mesh = SOLIDS[name]()
    return mesh, surface(mesh)


PAIRS = [("box", "ring"), ("cup", "ring"), ("cup", "box as a skin"), ("shells", "soup"), ("plane", "cup"),
         ("cup as a skin", "shells"), ("soup", "soup"), ("ring", "plane")]  # fmt: skip

OTHERS: dict[str, Callable[[], Body]] = {
    "box": lambda: Body.box([0.5, 0.8, 0.3]),
    "sphere": lambda: Body.sphere(0.4),
    "cylinder": lambda: Body.cylinder(0.3, 0.9),
    "capsule": lambda: Body.capsule(0.2, 0.7),
    "cone": lambda: Body.cone(0.4, 0.9),
    "ellipsoid": lambda: Body.ellipsoid([0.2, 0.4, 0.6]),
    "hull": lambda: Body.from_points(np.random.default_rng(3).normal(size=(20, 3)) * 0.3),
    "union": lambda: Body.union([Body.sphere(0.2), Body.box([0.2, 0.9, 0.2]), Body.cone(0.3, 0.5)]),
}


def poses_of(seed: int, count: int, spread: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return random_poses(rng, count, spread / 2), random_poses(rng, count, spread / 2)


def lengths(T: np.ndarray) -> float:
    return 2.0 + float(np.abs(T[..., :3, 3]).max())


# -- known answers -----------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 8, 9, 300, 5000])
def test_boxes_and_diagonals_hold_their_triangles(count: int):
    """Every box of a tree has the extents of the triangles below it, along the axes and along twenty diagonals."""
    rng = np.random.default_rng(count)
    vertices = rng.normal(size=(count + 2, 3))
    triangles = np.sort(rng.integers(0, count + 2, size=(count, 3)), axis=1)
    boxes, children, blocks, diagonals, _, numbers = entries.triangle_tree(vertices, triangles)
    boxes, diagonals, blocks = boxes.reshape(-1, 6, 16), diagonals.reshape(-1, 20, 16), blocks.reshape(-1, 3, 3, 8)
    two = list(product((1, -1), repeat=2))
    along = [*((x, y, 0) for x, y in two), *((x, 0, z) for x, z in two), *((0, y, z) for y, z in two)]
    along = np.array([*along, *product((1, -1), repeat=3)], dtype=float)
    seen = []

    def corners(slot: int) -> np.ndarray:
        """Corners below a box, which is looked at on the way."""
        node, lane, child = slot // 16, slot % 16, children[slot]
        if child < 0:
            leaf, size = ~child >> 3, (~child & 7) + 1
            seen.extend(map(tuple, np.sort(blocks[leaf, :, :, :size].transpose(2, 0, 1).reshape(size, 9))))
            found = blocks[leaf, :, :, :size].transpose(0, 2, 1).reshape(-1, 3)
        else:
            below = [k for k in range(16) if boxes[child, 3, k] >= 0]
            found = np.concatenate([corners(child * 16 + k) for k in below])
        middle, half = boxes[node, :3, lane], boxes[node, 3:, lane]
        assert (np.abs(found - middle) <= half).all()
        assert np.allclose(
            half, np.maximum(found.max(axis=0) - middle, middle - found.min(axis=0)), rtol=1e-6, atol=1e-6
        )
        extents = (found @ along.T).max(axis=0)
        assert (diagonals[node, :, lane] >= extents).all()
        assert np.allclose(diagonals[node, :, lane], extents, rtol=1e-6, atol=1e-6)
        return np.asarray(found)

    corners(0)
    assert sorted(seen) == sorted(map(tuple, np.sort(vertices[triangles].reshape(count, 9))))
    np.testing.assert_array_equal(blocks.transpose(0, 3, 1, 2).reshape(-1, 3, 3), vertices[triangles[numbers]])


@pytest.mark.parametrize(
    "height", [0.0, 1e-309, *(pytest.param(h, marks=pytest.mark.verify) for h in (5e-324, 1e-300))]
)
@pytest.mark.parametrize("most", quick(1000, 3000))
def test_meshes_that_are_flat_but_for_nothing(height: float, most: int):
    """Heights whose reciprocals overflow put no triangle out of place."""
    rng = np.random.default_rng(7)
    vertices = rng.uniform(-1, 1, size=(1500, 3))
    vertices[:, 2] = rng.choice([0.0, height], size=1500)
    for count in (40, 400, most):
        flat = Body.from_surface((vertices, rng.integers(0, 1500, size=(count, 3))))
        assert distance(flat, None, flat, translation(z=1.0), exact=True).distance == pytest.approx(1.0)


def test_a_box_within_a_box():
    """A box within a closed surface collides if that is solid, and not if only its skin is taken; by default it is."""
    small = box(0.2)
    default = Body.from_surface(trimesh.creation.box((2, 2, 2)))
    for large, expected in ((default, True), (surface(box(2.0)), True), (surface(box(2.0, solid=False)), False)):
        for x in (0.0, 0.3, 0.7):
            for other in (surface(small), surface(box(0.2, solid=False)), Body.box([0.2] * 3), Body.sphere(0.1)):
                assert collide(large, None, other, translation(x, -x / 2, 0.1)) == expected
                assert collide(other, translation(x, -x / 2, 0.1), large, None) == expected


def test_orientation_of_a_whole_mesh_does_not_matter():
    """Of a shell that is wound inwards the winding number is not zero either: what is within it collides."""
    assert collide(surface(box(2.0, inwards=True)), None, Body.sphere(0.1), None)
    assert collide(surface(box(2.0, inwards=True)), None, surface(box(0.2)), None)


def test_a_cavity_is_free():
    """What is within an inner shell, wound inwards, is outside; a shell within it is solid again."""
    body, ball = surface(hollow()), Body.sphere(0.05)
    for x, expected in ((0.0, True), (0.3, True), (0.5, False), (0.74, False), (0.8, True), (0.9, True), (1.1, False)):
        assert collide(body, None, ball, translation(x)) == expected, x
        assert collide(body, None, surface(box(0.05)), translation(x)) == expected, x
    doubled = joined(box(2.0), box(1.0))  # wound around twice: not zero
    assert collide(surface(doubled), None, ball, None)


def test_a_ball_in_a_cup():
    """Its distance is known within the cup, above and below it; in the wall it collides, in the cavity it does not."""
    body, ball, r = surface(cup()), Body.sphere(0.1), 0.1
    flat = INSIDE * np.cos(np.pi / SIDES)  # of the polygon's sides
    for x, z, expected in ((0.0, 0.6, flat), (0.0, 0.15, 0.15), (0.0, 1.4, np.hypot(0.4, INSIDE)), (0.0, -0.4, 0.35)):
        found = distance(body, None, ball, translation(x, 0, z), exact=True)
        if z == 1.4:  # the edge of the mouth: between a corner of the polygon and the middle of a side
            assert np.hypot(0.4, flat) - r - TIGHT <= found.distance <= expected - r + TIGHT
        else:
            assert found.distance == pytest.approx(expected - r, abs=TIGHT)
        assert not collide(body, None, ball, translation(x, 0, z))
    for x, z in ((INSIDE, 0.5), (0.0, 0.05), (INSIDE + WALL / 2, 0.5), (0.0, -WALL)):
        assert collide(body, None, ball, translation(x, 0, z))
    assert collide(body, None, Body.sphere(0.01), translation(INSIDE + WALL / 2, 0, 0.5))  # within the wall
    assert not collide(surface(cup(False)), None, Body.sphere(0.01), translation(INSIDE + WALL / 2, 0, 0.5))


def test_components_within_a_solid():
    """A mesh of parts collides when one of its parts is within a solid, whichever it is."""
    two, large = surface(joined(box(0.2), box(0.2, (3, 0, 0)))), surface(box(2.0))
    for x, expected in ((0.0, True), (-3.0, True), (-1.5, False), (3.0, False)):
        assert collide(two, translation(x), large, None) == collide(large, None, two, translation(x)) == expected
    triangle = Mesh(0.1 * np.eye(3), [[0, 1, 2]])
    assert collide(surface(triangle), None, large, None)
    assert not collide(surface(triangle), None, surface(box(2.0, solid=False)), None)


def test_open_and_ill_oriented_meshes_are_skins_by_default():
    """Without a face, or with one turned over, a mesh winds around nothing: what is within it does not collide."""
    cube = box(2.0)
    for faces in (cube.faces[1:], np.vstack([cube.faces[1:], cube.faces[:1, ::-1]])):
        with pytest.warns(UserWarning, match="mesh: nearly closed"):
            body = Body.from_surface(trimesh.Trimesh(cube.vertices, faces, process=False))
        assert not collide(body, None, Body.sphere(0.1), None)
        assert collide(body, None, Body.sphere(0.1), translation(1.0, 0.3, 0.4))


def test_corners_that_every_triangle_has_for_itself():
    """A closed mesh whose triangles share no vertex, as in an STL file, is closed all the same."""
    cube = box(2.0)
    loose = trimesh.Trimesh(cube.vertices[cube.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    assert collide(Body.from_surface(loose), None, Body.sphere(0.1), None)
    assert collide(Body.from_surface(loose, solid=True), None, Body.sphere(0.1), None)


def test_degenerate_triangles_leave_a_mesh_closed():
    """Triangles of no area with corners of the mesh change neither what is solid nor what is touched."""
    cube = box(2.0)
    faces = np.vstack([cube.faces, [[0, 0, 0], [1, 3, 3], [*cube.faces[0][:2], cube.faces[0][0]]]])
    body = Body.from_surface(trimesh.Trimesh(cube.vertices, faces, process=False), solid=True)
    assert collide(body, None, Body.sphere(0.1), None)
    for T in random_poses(np.random.default_rng(0), 30, 2.0):
        assert collide(body, None, Body.sphere(0.3), T) == collide(surface(cube), None, Body.sphere(0.3), T)


# -- touching ----------------------------------------------------------------------------------


def test_boxes_that_touch():
    """Faces, edges and corners that touch exactly collide, and a hair beyond they do not; in every order and kind."""
    a, b = surface(box()), surface(box())
    for x, y, z in ((1, 0, 0), (1, 0.25, 0.5), (1, 1, 0), (1, 1, 1), (1, -1, 0.25), (1, 0.5, 0)):
        T, apart = translation(x, y, z), translation(1 + HAIR, y, z)
        for other in (b, surface(box(solid=False)), Body.box([1, 1, 1])):
            assert collide(a, None, other, T)
            assert collide(other, T, a, None)
            assert not collide(a, None, other, apart)
            assert not collide(other, apart, a, None)
            assert distance(a, None, other, T, exact=True).distance == pytest.approx(0, abs=TIGHT)
            assert distance(a, None, other, apart, exact=True).distance == pytest.approx(HAIR, abs=TIGHT)


@pytest.mark.parametrize("shift", [(0.9, 0, 0), (0.9, 0.1, 0), (1, 0.1, 0.2), (0, 0, 0), (0.5, 0.5, 0.5)])
def test_solids_that_share_planes(shift):
    """Faces in one plane leave nothing open: the depth is at least that of the balls inside, and touching is 0."""
    cube, T = surface(box()), translation(*shift)
    apart = float(np.linalg.norm(shift))
    for other in (cube, Body.box([1, 1, 1])):
        found = distance(cube, None, other, T, exact=True)
        assert found.distance <= min(0.0, apart - 1.0) + 1e-5  # two balls of half the edge, or nearly
        assert collide(cube, None, other, T)
        along = (np.asarray(found.witness_b) - np.asarray(found.witness_a)) @ np.asarray(found.normal)
        assert along == pytest.approx(found.distance, abs=1e-5)


@examples(25, 60)
@given(SEEDS)
def test_margins_of_slivers(seed: int):
    """A margin decides about a triangle of hardly any height as about others: within rounding of the lengths."""
    rng = np.random.default_rng(seed)
    along, across, up = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    height = 10.0 ** rng.uniform(-8, -4)
    sliver = np.array([0 * along, along, rng.uniform(0.3, 0.7) * along + height * across])[rng.permutation(3)]
    share, gap = rng.uniform(0.2, 0.8), height * 10.0 ** rng.uniform(-1.5, 2)
    foot = share * along + height * 0.6 * min(share, 1 - share) * across + gap * up
    needle = np.array([foot, foot + 0.3 * up + 0.1 * across, foot + 0.4 * up + 0.2 * along])
    meshes = [Mesh(corners, np.array([[0, 1, 2]]), False) for corners in (sliver, needle)]
    placed = surface_oracle.Placed(meshes, [EYE, EYE])
    square = surface_oracle.squared_distance(placed.triangle(0, 0), placed.triangle(1, 0))
    true = surface_oracle.root(square * Fraction(2) ** (2 * placed.exponent))
    a, b = map(surface, meshes)
    for off in (1e-13, 1e-11, 1e-9):
        assert collide(a, None, b, None, margin=true + off)
        assert collide(b, None, a, None, margin=true + off)
        if off < true:
            assert not collide(a, None, b, None, margin=true - off)
            assert not collide(b, None, a, None, margin=true - off)


@pytest.mark.slow("the first of those that compile the oracle of surfaces")
@examples(4, 20)
@given(SEEDS)
def test_contact_far_from_the_own_origin(seed: int):
    """What is apart by the last bit is free in either order, although coordinates are far larger than the bodies."""
    rng = np.random.default_rng(seed)
    far = [10.0 ** rng.uniform(0, 4) * rng.normal(size=3) for _ in range(2)]
    a, b = (box(tuple(rng.uniform(0.1, 1, 3)), tuple(center)) for center in far)
    Ta, Tb = EYE.copy(), EYE.copy()
    for T, center in ((Ta, far[0]), (Tb, far[1])):
        T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        T[:3, 0] *= np.sign(np.linalg.det(T[:3, :3]))
        T[:3, 3] = -T[:3, :3] @ center
    for P in boundary(a, Ta, b, Tb, 4 * rng.normal(size=3), 0.0) or ():
        true = bool(collides(a, Ta, b, P)[0])
        assert collide(surface(a), Ta, surface(b), P) == true
        assert collide(surface(b), P, surface(a), Ta) == true


def test_vertices_and_triangles_as_arrays():
    """A pair of arrays is a mesh like any other."""
    cube = box()
    body = Body.from_surface((cube.vertices, cube.faces))
    assert repr(body) == repr(surface(cube))
    assert distance(body, None, surface(cube), translation(2), exact=True).distance == pytest.approx(1, abs=TIGHT)


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_what_lies_in_a_solid_is_never_classified_free(subdivisions):
    """Ellipsoids around the parts of a skin leave room inside: what is there, however thin, is not proven free."""
    rng = np.random.default_rng(subdivisions)
    ball = Body.from_surface(trimesh.creation.icosphere(subdivisions=subdivisions))
    flat = Mesh(0.05 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]]), False)
    thin = [surface(flat), Body.capsule(1e-10, 0.05), Body.ellipsoid([0.05, 1e-9, 1e-9]), Body.cone(1e-9, 0.05)]
    poses = random_poses(rng, 300, 0.5)
    poses[:, :3, 3] *= (0.6 * rng.random(300) / np.linalg.norm(poses[:, :3, 3], axis=1))[:, None]
    for other in thin:
        assert collide(ball, None, other, poses).all()
        for body in (ball, Body.union([ball, Body.box([0.1, 0.1, 0.1])])):
            assert (classify(body, None, other, poses) != Verdict.FREE).all()
            assert (classify(other, poses, body, None) != Verdict.FREE).all()


def test_depth_of_sheets_with_radii():
    """Two sheets in one plane are as deep in each other as their radii say, and no deeper."""
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    thick = Body.from_surface(sheet, radius=0.1)
    for x, y in ((0.2, 0.2), (0.5, 0.5), (0, 0), (0.5, 0), (0.25, 0.5)):
        for radius in (0.0, 0.1, 0.2):
            found = distance(thick, None, Body.from_surface(sheet, radius=radius), translation(x, y, 0), exact=True)
            assert found.distance == pytest.approx(-0.1 - radius, abs=1e-9)
        found = distance(thick, None, Body.sphere(0.1), translation(x, y, 0), exact=True)
        assert -0.2 - 1e-9 <= found.distance < 0
    for x, y in ((0.5, 0.5), (0, 0), (0.5, 0)):  # where its upright axis is at an edge
        found = distance(thick, None, Body.capsule(0.1, 0.4), translation(x, y, 0), exact=True)
        assert -0.2 - 1e-9 <= found.distance < 0


@pytest.mark.parametrize("point", [(0, 0, 0), (-2, 2, -1), (1e4, 2e4, 3.3e4)])
@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_a_mesh_that_is_a_point(point, radius):
    """Triangles with all corners at one place are a point, or a ball."""
    body = Body.from_surface(trimesh.Trimesh([point] * 3, [[0, 1, 2]], process=False), radius=radius)
    T = translation(*(np.array(point) + (1, 0, 0)))
    assert distance(body, None, Body.sphere(0.5), T, exact=True).distance == pytest.approx(0.5 - radius, abs=1e-9)


def test_a_box_on_a_grid():
    """Set down on a plane of triangles it touches, wherever its corners are; a hair above it does not."""
    floor = surface(plane(6))
    for size, x, y in product((1.0, 0.5, 10.0), (0.0, 0.5, 0.3), (0.0, 0.25, 1.0)):
        for other in (surface(box(size)), Body.box([size] * 3), surface(box(size, solid=False))):
            assert collide(floor, None, other, translation(x, y, size / 2))
            if size < 6:  # a larger one, sunk, has all of the plane within it
                assert collide(floor, None, other, translation(x, y, size / 2 - HAIR))
            assert not collide(floor, None, other, translation(x, y, size / 2 + HAIR))
            assert not collide(floor, None, other, translation(x, y, -size / 2 - HAIR))
            assert collide(other, translation(x, y, -size / 2), floor, None)


@settings(max_examples=25)
@given(SEEDS)
def test_touching_on_a_grid(seed: int):
    """Triangles, segments and points on a grid, at right angles, far away too: what touches collides, exactly."""
    rng = np.random.default_rng(seed)
    A, B = soup(rng, int(rng.integers(1, 6)), True), soup(rng, int(rng.integers(1, 6)), True)
    Ta, Tb = grid_poses(rng, 12), grid_poses(rng, 12)
    for T in (Ta, Tb):
        T[6:, :3, 3] += 2.0**20
        T[9:, :3, :3] *= 1 + 2.0**-22
    expected = collides(A, Ta, B, Tb)
    a, b = surface(A), surface(B)
    np.testing.assert_array_equal(collide(a, Ta, b, Tb), expected)
    np.testing.assert_array_equal(collide(b, Tb, a, Ta), expected)


@settings(max_examples=10)
@given(SEEDS)
def test_solids_on_a_grid(seed: int):
    """Boxes in boxes, cavities and doubled shells, in places and turns where faces, edges and corners coincide."""
    rng = np.random.default_rng(seed)
    shells = [box(float(s), inwards=bool(rng.integers(2))) for s in rng.choice([0.5, 1.0, 1.5, 2.0], 2, replace=False)]
    A, B = joined(*shells), joined(box(0.5), box(0.25, (0.75, 0, 0)))
    Ta, Tb = grid_poses(rng, 40), grid_poses(rng, 40)
    np.testing.assert_array_equal(collide(surface(A), Ta, surface(B), Tb), collides(A, Ta, B, Tb))


@pytest.mark.parametrize("enough", quick(4, 40))
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_both_sides_of_contact(first: str, second: str, enough: int):
    """A billionth of the size on either side of contact, found by halving along random ways: colliding, and free."""
    (A, a), (B, b), rng = solid(first), solid(second), np.random.default_rng(7)
    found = 0
    for Ta, Tb in zip(*poses_of(1, 40), strict=True):
        way = rng.normal(size=3)
        both = boundary(A, Ta, B, Tb, way * 2 / np.linalg.norm(way), HAIR * min(A.size, B.size))
        if both is not None:
            assert collide(a, Ta, b, both[0])
            assert not collide(a, Ta, b, both[1])
            assert not collide(b, both[1], a, Ta)
            found += 1
            if found == enough:
                break
    assert found >= 3


@pytest.mark.parametrize("offset", quick(-12345.678, 0.0, 1e3))
@pytest.mark.parametrize("enough", quick(2, 8))
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_the_last_bit_of_contact(first: str, second: str, enough: int, offset: float):
    """Neighbouring doubles on either side of contact, far away too, turned a little askew: decided exactly."""
    (A, a), (B, b), rng = solid(first), solid(second), np.random.default_rng(29)
    found = 0
    for Ta, Tb in zip(*poses_of(30, 8), strict=True):
        for T in (Ta, Tb):
            T[:3, :3] += rng.uniform(-1e-7, 1e-7, (3, 3))
            T[:3, 3] += offset
        both = boundary(A, Ta, B, Tb, rng.normal(size=3) * 2, 0.0)
        if both is not None:
            for T, expected in zip(both, (True, False), strict=True):
                assert collide(a, Ta, b, T) == collide(b, T, a, Ta) == expected
                assert classify(a, Ta, b, T) != (Verdict.FREE if expected else Verdict.COLLIDING)
            found += 1
            if found == enough:
                break
    assert found >= 1


@pytest.mark.verify  # its oracle counts in whole numbers
def test_a_pose_means_its_doubles():
    """A rotation off by 4e-7 makes the placed body larger or smaller by as much: it touches or not accordingly."""
    A = box()
    for sign, expected in ((1, True), (-1, False)):
        T = np.diag([1 + sign * 4e-7] * 3 + [1.0])
        Tb = translation(1 + sign * 1e-7)
        assert collides(A, T, A, Tb) == expected
        for b in (surface(A), Body.box([1, 1, 1])):
            assert collide(surface(A), T, b, Tb) == expected
            assert collide(b, Tb, surface(A), T) == expected
        if not expected:
            exact = surface_oracle.distance(A, T, A, Tb)
            assert distance(surface(A), T, surface(A), Tb, exact=True).distance == pytest.approx(exact, abs=TIGHT)


# -- the oracle --------------------------------------------------------------------------------


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_collide_and_classify_agree_with_the_oracle(first: str, second: str):
    """`collide` is what rational arithmetic says; FREE and COLLIDING are proven; and the order does not matter."""
    (A, a), (B, b) = solid(first), solid(second)
    Ta, Tb = poses_of(2, 300, 2.0)
    expected = collides(A, Ta, B, Tb)
    assert 10 < expected.sum() < 295
    np.testing.assert_array_equal(collide(a, Ta, b, Tb), expected)
    np.testing.assert_array_equal(collide(b, Tb, a, Ta), expected)
    for verdicts in (classify(a, Ta, b, Tb), classify(b, Tb, a, Ta)):
        assert not (expected & (verdicts == Verdict.FREE)).any()
        assert not (~expected & (verdicts == Verdict.COLLIDING)).any()


@settings(max_examples=15)
@given(SEEDS)
def test_soups_agree_with_brute_force(seed: int):
    """Random triangles, equal, degenerate and crossing each other: collisions and distances are those of all pairs."""
    rng = np.random.default_rng(seed)
    A, B = soup(rng, int(rng.integers(1, 15)), False), soup(rng, int(rng.integers(1, 15)), False)
    a, b = surface(A), surface(B)
    Ta, Tb = random_poses(rng, 6, 0.5), random_poses(rng, 6, 0.5)
    expected = collides(A, Ta, B, Tb)
    np.testing.assert_array_equal(collide(a, Ta, b, Tb), expected)
    found = distance(a, Ta, b, Tb, exact=True)
    for k in np.flatnonzero(~expected):
        exact = surface_oracle.distance(A, Ta[k], B, Tb[k])
        assert abs(found.distance[k] - exact) <= TIGHT * lengths(Tb)
    assert (found.distance[expected] <= TIGHT).all()


@pytest.mark.parametrize("count", quick(12, 30))
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_distances_agree_with_brute_force(first: str, second: str, count: int):
    """Apart, bodies are as far as their nearest triangles, within the bounds; colliding, they are at no distance."""
    (A, a), (B, b) = solid(first), solid(second)
    Ta, Tb = poses_of(3, count, 3.0)
    expected = collides(A, Ta, B, Tb)
    assert not expected.all()
    found, bounds = distance(a, Ta, b, Tb, exact=True), distance(a, Ta, b, Tb)
    assert (found.distance[expected] <= TIGHT).all()
    assert (found.lower <= found.distance).all()
    assert (found.distance <= found.upper).all()
    for k in np.flatnonzero(~expected):
        exact = surface_oracle.distance(A, Ta[k], B, Tb[k])
        assert abs(found.distance[k] - exact) <= TIGHT * lengths(Tb)
        assert bounds.lower[k] <= exact * (1 + TIGHT)
        assert bounds.upper[k] >= exact * (1 - TIGHT)


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_witnesses(first: str, second: str):
    """They lie on both surfaces, as far apart as the distance says, along the normal, which is a unit vector."""
    (A, a), (B, b) = solid(first), solid(second)
    Ta, Tb = poses_of(4, 30, 3.0)
    found = distance(a, Ta, b, Tb, exact=True)
    apart = np.flatnonzero(found.distance > 0)
    assert len(apart) > 0
    slack = TIGHT * lengths(Tb)
    for k in apart:
        between = found.witness_b[k] - found.witness_a[k]
        assert np.linalg.norm(between) == pytest.approx(found.distance[k], abs=slack)
        np.testing.assert_allclose(between, found.distance[k] * found.normal[k], rtol=0, atol=slack)
        assert np.linalg.norm(found.normal[k]) == pytest.approx(1, abs=1e-9)
        for mesh, T, x in ((A, Ta[k], found.witness_a[k]), (B, Tb[k], found.witness_b[k])):
            own = np.linalg.solve(T[:3, :3], x - T[:3, 3])
            assert surface_oracle.distances_of_points(mesh, own[None])[0] <= slack


@pytest.mark.parametrize("count", quick(15, 40))
@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_depths_are_lower_bounds(first: str, second: str, count: int):
    """A negative distance: moved by less than that, whichever way, the bodies still collide."""
    (A, a), (B, b) = solid(first), solid(second)
    Ta, Tb = poses_of(5, count, 1.0)
    found = distance(a, Ta, b, Tb, exact=True)
    hit = collides(A, Ta, B, Tb)
    assert hit.any()
    np.testing.assert_array_equal(found.distance <= 0, hit)
    ways = np.concatenate([np.random.default_rng(6).normal(size=(60, 3)), np.eye(3), -np.eye(3)])
    for k in np.flatnonzero(found.distance < 0):
        toward = np.concatenate([ways, [found.normal[k], -found.normal[k]]])
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        moved = np.tile(Tb[k], (len(toward), 1, 1))
        moved[:, :3, 3] += toward * -found.distance[k] * (1 - 1e-6)
        assert collides(A, Ta[k], B, moved).all()
        assert collide(a, Ta[k], b, moved).all()


def test_depth_of_a_body_deep_inside():
    """Within a solid, the depth is at least what a ball that fits says, and at most what it takes to get out."""
    large, ball = surface(box(4.0)), Body.sphere(0.5)
    for x in (0.0, 1.0, 1.4):
        found = distance(large, None, ball, translation(x), exact=True).distance
        assert -(2.0 - x + 0.5) * (1 + 1e-9) <= found < 0


# -- laws --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_symmetry(first: str, second: str):
    """Asked the other way around, the distance is the same and witnesses change places."""
    a, b = solid(first)[1], solid(second)[1]
    Ta, Tb = poses_of(8, 40, 3.0)
    one, two = distance(a, Ta, b, Tb, exact=True), distance(b, Tb, a, Ta, exact=True)
    apart = one.distance > 0
    np.testing.assert_array_equal(apart, two.distance > 0)
    np.testing.assert_allclose(one.distance[apart], two.distance[apart], rtol=0, atol=TIGHT * lengths(Tb))
    between = two.witness_b[apart] - two.witness_a[apart]
    np.testing.assert_allclose(np.linalg.norm(between, axis=1), one.distance[apart], rtol=0, atol=TIGHT * lengths(Tb))


@pytest.mark.parametrize(("first", "second"), PAIRS[:4])
def test_common_motions_change_nothing(first: str, second: str):
    """Both bodies moved by the same rigid motion: the same answers, and distances to rounding."""
    a, b = solid(first)[1], solid(second)[1]
    Ta, Tb = poses_of(9, 60, 2.0)
    before = distance(a, Ta, b, Tb, exact=True).distance
    for G in random_poses(np.random.default_rng(10), 3, 20.0):
        after = distance(a, G @ Ta, b, G @ Tb, exact=True).distance
        clear = np.abs(before) > HAIR
        np.testing.assert_array_equal(collide(a, G @ Ta, b, G @ Tb)[clear], collide(a, Ta, b, Tb)[clear])
        apart = before > HAIR
        np.testing.assert_allclose(after[apart], before[apart], rtol=0, atol=TIGHT * lengths(G))


@pytest.mark.parametrize(("first", "second"), PAIRS)
@pytest.mark.parametrize("count", quick(10, 60))
def test_margins(first: str, second: str, count: int):
    """Within a margin bodies collide exactly if their distance is not more; more margin never makes them free."""
    (A, a), (B, b) = solid(first), solid(second)
    Ta, Tb = poses_of(11, count, 3.0)
    before = collides(A, Ta, B, Tb)
    gap = np.array(
        [0.0 if hit else surface_oracle.distance(A, T, B, U) for hit, T, U in zip(before, Ta, Tb, strict=True)]
    )
    assert (~before).any()
    for margin in (1e-6, 0.01, 0.1, 0.5, 3.0):
        clear = np.abs(gap - margin) > HAIR
        found = collide(a, Ta, b, Tb, margin=margin)
        np.testing.assert_array_equal(found[clear], (gap <= margin)[clear])
        assert (found | ~before).all()
        verdicts = classify(a, Ta, b, Tb, margin=margin)
        assert not (found & (verdicts == Verdict.FREE)).any()
        assert not (~found & (verdicts == Verdict.COLLIDING)).any()
        before = found
    for k in np.flatnonzero(gap > 0.01)[:10]:
        assert collide(a, Ta[k], b, Tb[k], margin=gap[k] * (1 + HAIR))
        assert not collide(a, Ta[k], b, Tb[k], margin=gap[k] * (1 - HAIR))


@pytest.mark.parametrize("other", ["cup", "sphere", "hull"])
@pytest.mark.parametrize("name", ["cup", "cup as a skin", "soup", "plane"])
def test_a_radius_is_a_margin(name: str, other: str):
    """A surface with a radius is nearer by that, and collides where the one without does with that margin."""
    r, mesh = 0.07, SOLIDS[name]()
    thin, thick = surface(mesh), surface(mesh, radius=r)
    b = surface(cup()) if other == "cup" else OTHERS[other]()
    Ta, Tb = poses_of(12, 80, 2.5)
    gap = distance(thin, Ta, b, Tb, exact=True).distance
    clear = np.abs(gap - r) > HAIR
    np.testing.assert_array_equal(collide(thick, Ta, b, Tb)[clear], collide(thin, Ta, b, Tb, margin=r)[clear])
    more = np.abs(gap - r - 0.1) > HAIR
    np.testing.assert_array_equal(
        collide(b, Tb, thick, Ta, margin=0.1)[more], collide(thin, Ta, b, Tb, margin=r + 0.1)[more]
    )
    verdicts, hit = classify(thick, Ta, b, Tb), collide(thick, Ta, b, Tb)
    assert not (hit & (verdicts == Verdict.FREE)).any()
    assert not (~hit & (verdicts == Verdict.COLLIDING)).any()
    found = distance(thick, Ta, b, Tb, exact=True)
    apart = gap > r + HAIR
    assert apart.any()
    np.testing.assert_allclose(found.distance[apart], gap[apart] - r, rtol=0, atol=TIGHT * lengths(Tb))
    between = (found.witness_b - found.witness_a)[apart]
    np.testing.assert_allclose(np.linalg.norm(between, axis=1), found.distance[apart], rtol=0, atol=TIGHT * lengths(Tb))


def test_two_radii_add():
    """Two surfaces with radii are nearer by the sum of them; a ball within a thick skin collides if that reaches it."""
    A = surface(box(), radius=0.1)
    found = distance(A, None, surface(box(), radius=0.2), translation(2.0), exact=True)
    assert found.distance == pytest.approx(0.7, abs=TIGHT)
    ball = Body.sphere(0.1)
    for radius, expected in ((0.39, False), (0.41, True)):
        assert collide(surface(box(solid=False), radius=radius), None, ball, None) == expected
        assert collide(surface(box(solid=True), radius=radius), None, ball, None)


# -- beside every other shape ------------------------------------------------------------------


@pytest.mark.parametrize("kind", OTHERS)
def test_a_convex_surface_is_its_hull(kind: str):
    """A closed convex mesh as a surface answers as the hull of its vertices does, to any other shape, near and far."""
    hull = Body.from_points(np.random.default_rng(13).normal(size=(40, 3)) * 0.4)
    mesh = Mesh(hull.pieces[0].vertices, hull.pieces[0].triangles)
    assert mesh.closed
    a, b = surface(mesh), OTHERS[kind]()
    Ta, Tb = poses_of(14, 300, 1.8)
    expected, gap = collide(hull, Ta, b, Tb), distance(hull, Ta, b, Tb, exact=True).distance
    assert 30 < expected.sum() < 295
    np.testing.assert_array_equal(collide(a, Ta, b, Tb), expected)
    np.testing.assert_array_equal(collide(b, Tb, a, Ta), expected)
    np.testing.assert_array_equal(
        collide(a, Ta, b, Tb, margin=0.05)[np.abs(gap - 0.05) > HAIR], (gap <= 0.05)[np.abs(gap - 0.05) > HAIR]
    )
    verdicts = classify(a, Ta, b, Tb)
    assert not (expected & (verdicts == Verdict.FREE)).any()
    assert not (~expected & (verdicts == Verdict.COLLIDING)).any()
    found = distance(a, Ta, b, Tb, exact=True)
    np.testing.assert_allclose(found.distance[~expected], gap[~expected], rtol=0, atol=1e-9)
    # The hull's depth of two convex pieces is exact: a certified lower bound is not more.
    if kind != "union":
        assert (found.distance[expected] >= gap[expected] - 1e-9).all()
    assert (found.distance[expected] <= 0).all()


@pytest.mark.parametrize("kind", OTHERS)
def test_a_convex_surface_near_contact(kind: str):
    """Moved along the normal to a gap or overlap of a billionth, surface and hull say the same."""
    hull = Body.from_points(np.random.default_rng(15).normal(size=(30, 3)) * 0.4)
    a, b = surface(Mesh(hull.pieces[0].vertices, hull.pieces[0].triangles)), OTHERS[kind]()
    Ta, Tb = poses_of(16, 60, 3.0)
    found = distance(hull, Ta, b, Tb, exact=True)
    apart = np.flatnonzero(found.distance > 0.01)
    assert len(apart) > 5
    for gap, expected in ((1e-7, False), (-1e-7, True)):
        T = Tb[apart].copy()
        T[:, :3, 3] -= found.normal[apart] * (found.distance[apart] - gap)[:, None]
        assert (collide(hull, Ta[apart], b, T) == expected).all()
        assert (collide(a, Ta[apart], b, T) == expected).all()
        assert (collide(b, T, a, Ta[apart]) == expected).all()


@functools.cache
def cavity_and_solids() -> tuple[Body, Body, Body]:
    """A solid with a cavity, the solid without it, and its skin."""
    return surface(joined(box(8.0), box(4.0, inwards=True))), surface(box(8.0)), surface(box(8.0, solid=False))


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("count", quick(2, 5))
def test_other_shapes_in_a_cavity_and_in_a_solid(kind: str, count: int):
    """Every shape is free in a cavity, collides in the solid around it, and does not within a skin."""
    b = OTHERS[kind]()
    large, full, skin = cavity_and_solids()
    for T in random_poses(np.random.default_rng(17), count, 0.2):
        assert not collide(large, None, b, T)
        assert not collide(skin, None, b, T)
        assert collide(full, None, b, T)
        assert collide(b, T, full, None)
        moved = translation(2.0) @ T
        assert collide(large, None, b, moved)
        assert distance(large, None, b, T, exact=True).distance > 0


@pytest.mark.parametrize("kind", ["box", "hull"])
def test_polytopes_agree_with_the_oracle(kind: str):
    """A polytope is the solid of its own triangles: surface and polytope collide as the oracle's meshes do."""
    b = OTHERS[kind]()
    B = Mesh(b.pieces[0].vertices, b.pieces[0].triangles)
    for name in ("cup", "ring", "shells", "soup"):
        A = SOLIDS[name]()
        Ta, Tb = poses_of(18, 150, 2.0)
        np.testing.assert_array_equal(collide(surface(A), Ta, b, Tb), collides(A, Ta, B, Tb))


# -- sources -----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "glb"])
def test_files_and_meshes_are_the_same(suffix: str, tmp_path: Path):
    """A file, by its name or path, gives the body that the mesh in memory gives."""
    source = trimesh.creation.box((1.0, 0.5, 0.25))
    path = tmp_path / f"box.{suffix}"
    source.export(path)
    Ta, Tb = poses_of(19, 60, 1.5)
    expected = collide(Body.from_surface(source), Ta, Body.sphere(0.2), Tb)
    for given_as in (path, str(path)):
        body = Body.from_surface(given_as, solid=True)
        np.testing.assert_array_equal(collide(body, Ta, Body.sphere(0.2), Tb), expected)


def test_the_meshes_of_a_scene_are_placed():
    """The meshes of a trimesh.Scene are where their transforms say, as one body."""
    source = trimesh.Scene()
    source.add_geometry(trimesh.creation.box((1, 1, 1)))
    source.add_geometry(trimesh.creation.box((1, 1, 1)), transform=translation(4.0))
    body, ball = Body.from_surface(source), Body.sphere(0.1)
    for x, expected in ((0.0, True), (4.0, True), (2.0, False)):
        assert collide(body, None, ball, translation(x)) == expected


def test_scale():
    """One factor for all lengths or one for each axis; a negative one mirrors, and what is solid stays so."""
    source, ball = trimesh.creation.box((1, 1, 1)), Body.sphere(0.1)
    for scale, reach in ((2.0, 1.0), ((3.0, 1.0, 1.0), 1.5), ((-2.0, 1.0, 1.0), 1.0), (-1.0, 0.5)):
        body = Body.from_surface(source, scale=scale, solid=True)
        assert collide(body, None, ball, None)
        found = distance(body, None, ball, translation(4.0), exact=True).distance
        assert found == pytest.approx(4.0 - reach - 0.1, abs=TIGHT)
    thick = Body.from_surface(source, scale=2.0, radius=0.25)  # which is in metres, and not scaled
    assert distance(thick, None, ball, translation(4.0), exact=True).distance == pytest.approx(2.65, abs=TIGHT)


# -- what bodies can do ------------------------------------------------------------------------


def same(a: Body, b: Body) -> None:
    """The same answers, to the bit."""
    Ta, Tb = poses_of(20, 20, 2.0)
    for other in (Body.sphere(0.2), solid("ring")[1]):
        one, two = (distance(body, Ta, other, Tb, exact=True) for body in (a, b))
        np.testing.assert_array_equal(one.distance, two.distance)
        np.testing.assert_array_equal(collide(a, Ta, other, Tb), collide(b, Ta, other, Tb))
        np.testing.assert_array_equal(classify(a, Ta, other, Tb), classify(b, Ta, other, Tb))


@pytest.mark.parametrize("name", SOLIDS)
def test_saved_and_loaded(name: str, tmp_path: Path):
    """A surface that was saved and loaded answers as before, solid or not, with a radius or without."""
    mesh, sharp = solid(name)
    for k, body in enumerate((sharp, surface(mesh, radius=0.03))):
        body.save(tmp_path / f"{k}.npz")
        same(Body.load(tmp_path / f"{k}.npz"), body)


@pytest.mark.parametrize("name", SOLIDS)
def test_pickled(name: str):
    """A surface that was pickled answers as before."""
    body = surface(SOLIDS[name](), radius=0.03)
    same(pickle.loads(pickle.dumps(body)), body)


def test_transformed_is_a_pose():
    """A surface moved once and for all is where a pose would have put it."""
    T = random_poses(np.random.default_rng(21), 1, 0.5)[0]
    Ta, Tb = poses_of(22, 100, 2.0)
    for name in ("cup", "soup", "shells"):
        body = surface(SOLIDS[name]())
        found = distance(body.transformed(T), Ta, Body.capsule(0.1, 0.4), Tb, exact=True).distance
        expected = distance(body, Ta @ T, Body.capsule(0.1, 0.4), Tb, exact=True).distance
        apart = expected > HAIR
        np.testing.assert_array_equal(apart, found > HAIR)
        np.testing.assert_allclose(found[apart], expected[apart], rtol=0, atol=TIGHT * lengths(Tb))


def mixed() -> list[Body]:
    return [surface(cup()), Body.sphere(0.3), surface(soup(np.random.default_rng(5), 9, False), radius=0.02),
            OTHERS["union"](), surface(hollow()), surface(box(solid=False))]  # fmt: skip


def test_joined_and_indexed(tmp_path: Path):
    """Surfaces among other bodies, joined, taken out, repeated, reversed and saved: each answers as it does alone."""
    parts = mixed()
    bodies = Bodies(parts)
    bodies.save(tmp_path / "all.npz")
    for several in (bodies, Bodies(list(bodies)), Bodies.load(tmp_path / "all.npz")):
        assert len(several) == len(parts)
        for one, alone in zip(several, parts, strict=True):
            same(one, alone)
    Ta, Tb = poses_of(23, len(parts), 1.0)
    other = solid("ring")[1]
    alone = [collide(a, A, other, B) for a, A, B in zip(parts, Ta, Tb, strict=True)]
    np.testing.assert_array_equal(collide(bodies, Ta, other, Tb), alone)
    np.testing.assert_array_equal(collide(other, Tb, bodies, Ta), alone)
    for chosen in ([5, 4, 3, 2, 1, 0], [0, 0, 2, 2], [4, 1]):
        np.testing.assert_array_equal(collide(bodies[chosen], Ta[chosen], other, Tb[chosen]), np.array(alone)[chosen])
    np.testing.assert_array_equal(collide(bodies[1:4], Ta[1:4], other, Tb[1:4]), alone[1:4])
    same(bodies[-2], parts[-2])


def test_batches_are_single_calls():
    """Any shape of batch, lists of pairs, and one pair at a time: the same answers, distances to the bit."""
    a, b = surface(cup()), surface(ring())
    Ta, Tb = poses_of(24, 7, 1.5)
    found = distance(a, Ta[:, None], b, Tb, exact=True)
    hits, verdicts = collide(a, Ta[:, None], b, Tb), classify(a, Ta[:, None], b, Tb)
    assert hits.shape == found.distance.shape == (7, 7)
    assert 3 < hits.sum() < 46
    for i, j in product(range(7), range(7)):
        one = distance(a, Ta[i], b, Tb[j], exact=True)
        assert (one.distance, one.lower, one.upper) == (found.distance[i, j], found.lower[i, j], found.upper[i, j])
        np.testing.assert_array_equal(one.witness_a, found.witness_a[i, j])
        assert collide(a, Ta[i], b, Tb[j]) == hits[i, j]
        assert classify(a, Ta[i], b, Tb[j]) == verdicts[i, j]
    listed = np.indices((7, 7)).T
    np.testing.assert_array_equal(collide(a, Ta, b, Tb, pairs=listed), hits.T)
    np.testing.assert_array_equal(distance(a, Ta, b, Tb, exact=True, pairs=listed).distance, found.distance.T)
    assert collide(a, np.empty((0, 4, 4)), b, None).shape == (0,)


def test_threads_change_nothing():
    """The same answers from one thread and from several."""
    a, b = surface(cup()), surface(ring())
    Ta, Tb = poses_of(25, 9000, 2.0)
    before = loewner.get_num_threads()
    try:
        found = []
        for count in (1, 2):
            loewner.set_num_threads(count)
            found.append((collide(a, Ta, b, Tb), distance(a, Ta[:500], b, Tb[:500], exact=True).distance))
    finally:
        loewner.set_num_threads(before)
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("count", quick(18, 30))
def test_pairs_of_a_crowd(count: int):
    """Among many bodies the pairs that meet are those that meet two by two."""
    parts = mixed()
    bodies = Bodies([parts[k % len(parts)] for k in range(count)])
    T = random_poses(np.random.default_rng(26), count, 2.0)
    i, j = np.triu_indices(count, 1)
    first, second = bodies[i], bodies[j]
    for margin in (0.0, 0.1):
        expected = np.stack([i, j], axis=1)[collide(first, T[i], second, T[j], margin=margin)]
        assert len(expected) > 10
        np.testing.assert_array_equal(overlapping_pairs(bodies, T, margin=margin), expected)
    one = surface(cup())
    expected = np.stack([i, j], axis=1)[collide(one, T[i], one, T[j])]
    np.testing.assert_array_equal(overlapping_pairs(one, T), expected)


def test_a_scene_with_surfaces():
    """A scene names the pairs that collide two by two, and their distances."""
    scene = Scene()
    parts = mixed()
    T = random_poses(np.random.default_rng(27), len(parts), 0.8)
    for k, body in enumerate(parts):
        scene.add(f"b{k}", body, T[k])
    hits = {
        (f"b{i}", f"b{j}")
        for i, j in zip(*np.triu_indices(len(parts), 1), strict=True)
        if collide(parts[i], T[i], parts[j], T[j])
    }
    assert 0 < len(hits) < 15
    assert {tuple(sorted((c.name_a, c.name_b))) for c in scene.pairs()} == hits
    assert scene.collide()
    found = scene.distance("b0", "b4", exact=True).distance
    assert found == distance(parts[0], T[0], parts[4], T[4], exact=True).distance


@pytest.mark.parametrize("count", quick(15, 40))
@pytest.mark.parametrize("seed", quick_of(range(6), range(2)))
def test_checkers_are_their_pairs(seed: int, count: int, tmp_path: Path):
    """A robot with surfaces for links among surfaces, some of them carried: what the queries say pair by pair."""
    rng = np.random.default_rng(seed)
    small = [Body.from_surface(trimesh.creation.torus(0.12, 0.04, 12, 6)), Body.sphere(0.1), Body.box([0.1, 0.2, 0.1]),
             surface(box(0.2), radius=0.01), surface(box(0.25, solid=False))]  # fmt: skip
    robot = random_robot(rng, tmp_path, 5, small)
    scene = random_scene(rng, robot, 5, [*small, surface(hollow()), surface(plane(2))])
    checker = CollisionChecker(robot, scene)
    Q = robot.random_configurations(count, seed)
    agrees(checker, Q)
    names = checker.checked_pairs
    by_pair = checker.collide_by_pair(Q)
    assert by_pair.shape == (count, len(names))
    np.testing.assert_array_equal(by_pair.any(axis=1), checker.collide(Q))
    for q, hits in zip(Q[:5], by_pair[:5], strict=True):
        named = {frozenset((c.name_a, c.name_b)) for c in checker.pairs(q)}
        assert named == {frozenset(pair) for pair, hit in zip(names, hits, strict=True) if hit}


@pytest.mark.parametrize("length", [0.1, 9.0])
@pytest.mark.parametrize("margin", [0.0, 1e-9, 0.01])
def test_a_skin_s_point_in_a_solid(length: float, margin: float):
    """The inner ellipsoid of a skin is a single point: in that of a solid, it proves a collision, with any margin."""
    skin = surface(Mesh(length * np.array(CORNERS), np.array([[0, 1, 2]]), False))
    assert np.count_nonzero(skin.inner.factor) == 0
    solid, T = Body.box([2, 0.2, 2]), np.eye(4)
    T[1, 3] = 0.03
    assert classify(skin, None, solid, T, margin=margin) == Verdict.COLLIDING
    # Without a margin, the order decides whether the proof is found at once.
    assert margin == 0.0 or classify(solid, T, skin, None, margin=margin) == Verdict.COLLIDING
    T[1, 3] = 0.2
    assert classify(skin, None, solid, T, margin=margin) != Verdict.COLLIDING


def test_a_checker_in_a_shell(tmp_path: Path):
    """A link that slides within a solid's cavity is free there and collides beyond; a skin lets it through."""
    slide = '<axis xyz="1 0 0"/><limit lower="-3" upper="3"/>'
    robot = robot_of(tmp_path, [("prismatic", 0, slide)], {"l1": surface(box(0.2))})
    for mesh, expected in (
        (hollow(), (True, False, True, False)),
        (box(2.0, solid=False), (False, False, False, False)),
    ):
        scene = Scene()
        scene.add("shell", surface(mesh))
        Q = np.array([[0.0], [0.5], [0.9 if mesh.solid else 0.8], [1.5]])
        assert CollisionChecker(robot, scene).collide(Q).tolist() == list(expected)


# -- bad input ---------------------------------------------------------------------------------


def arrays(vertices: object, faces: object) -> SimpleNamespace:
    """What a trimesh.Trimesh would be if it took anything."""
    return SimpleNamespace(vertices=np.asarray(vertices, float), faces=np.asarray(faces), units=None)


CORNERS = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (arrays(np.empty((0, 3)), np.empty((0, 3), int)), "triangle|vert"),
        (arrays(CORNERS, np.empty((0, 3), int)), "triangle"),
        (arrays([[0, 0, np.nan], *CORNERS[1:]], [[0, 1, 2]]), "nan|finite"),
        (arrays([[0, 0, np.inf], *CORNERS[1:]], [[0, 1, 2]]), "inf|finite"),
        (arrays(CORNERS, [[0, 1, 3]]), "3"),
        (arrays(CORNERS, [[0, 1, -1]]), "-1"),
        (arrays(CORNERS, [[0.0, 1.0, 2.0]]), "whole|int"),
        (arrays(CORNERS, [[0, 1, 2, 0]]), "shape"),
    ],
)
def test_bad_arrays(source: SimpleNamespace, message: str):
    """A mesh that is empty, not finite, or names corners that do not exist is refused, saying so."""
    with pytest.raises(GeometryError, match=message):
        Body.from_surface(source)


@pytest.mark.parametrize("source", [3, None, [CORNERS], np.zeros((3, 3)), object()])
def test_bad_sources(source: object):
    """What is neither a path nor a mesh is refused, naming its type."""
    with pytest.raises(InputError):
        Body.from_surface(source)


def test_bad_files(tmp_path: Path):
    """Files that are missing, empty, of points or of lines are refused, by name."""
    with pytest.raises(FileError, match="nothing"):
        Body.from_surface(tmp_path / "nothing.stl")
    points = "".join(f"v {k} {k * k} 0\n" for k in range(4))
    ply = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {c}\n" for c in "xyz")
    for name, text in {
        "empty.obj": "", "points.obj": points, "lines.obj": points + "l 1 2\nl 2 3\n",
        "points.ply": ply + "end_header\n0 0 0\n", "points.off": "OFF\n1 0 0\n0 0 0\n",
    }.items():  # fmt: skip
        (tmp_path / name).write_text(text)
        with pytest.raises(LoewnerError, match=name.replace(".", r"\.")):
            Body.from_surface(tmp_path / name)


@pytest.mark.parametrize("what", ["open", "turned over"])
def test_an_open_mesh_is_no_solid(what: str):
    """A mesh that is called solid and is open, or ill oriented, is refused; the message says where."""
    cube = box()
    faces = cube.faces[1:] if what == "open" else np.vstack([cube.faces[1:], cube.faces[:1, ::-1]])
    source = trimesh.Trimesh(cube.vertices, faces, process=False)
    with pytest.raises(GeometryError, match=r"(?s)edge.*\d"):
        Body.from_surface(source, solid=True)
    with pytest.warns(UserWarning, match="mesh: nearly closed"):
        Body.from_surface(source)
    Body.from_surface(source, solid=False)


@pytest.mark.parametrize("radius", [-1.0, -1e-300, np.nan, np.inf, "thick", None, [0.1, 0.2], 1j])
def test_bad_radii(radius: object):
    """A radius is one finite number that is not negative."""
    with pytest.raises(InputError, match="radius"):
        Body.from_surface(trimesh.creation.box((1, 1, 1)), radius=radius)


@pytest.mark.parametrize("solid", [1, 0, "yes", 0.5, [True], np.array([True, False])])
def test_solid_is_a_flag(solid: object):
    """`solid` is True, False or None, and nothing that would count as one."""
    with pytest.raises(InputError, match="solid"):
        Body.from_surface(trimesh.creation.box((1, 1, 1)), solid=solid)


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf, "metres", (1.0, 2.0), (1.0, 0.0, 1.0)])
def test_bad_scales(scale: object):
    """A factor is a finite number other than zero, or three."""
    with pytest.raises(InputError, match="scale"):
        Body.from_surface(trimesh.creation.box((1, 1, 1)), scale=scale)


def test_positional_options_are_refused():
    """Everything but the source is given by name."""
    with pytest.raises(TypeError):
        Body.from_surface(trimesh.creation.box((1, 1, 1)), 0.1)


def test_bad_poses_are_found():
    """A pose that is no rigid motion is refused, as for any body."""
    a, b = surface(box()), surface(ring())
    for T in (2 * EYE, np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan), np.diag([1 + 1e-6] * 3 + [1.0])):
        for query in (collide, classify, distance):
            with pytest.raises(loewner.PoseError):
                query(a, T, b, None)
            with pytest.raises(loewner.PoseError):
                query(b, None, a, np.stack([EYE, T]))


def test_the_source_may_change_afterwards():
    """A body keeps nothing of the mesh that it was made of."""
    source = trimesh.creation.box((1, 1, 1))
    body = Body.from_surface(source)
    source.vertices *= 10.0
    exact = distance(body, None, Body.sphere(0.1), translation(2.0), exact=True).distance
    assert exact == pytest.approx(float(Fraction(14, 10)), abs=TIGHT)


def dented(triangles: int, flipped: bool) -> trimesh.Trimesh:
    """A ball of 320 triangles without some of them, or with those turned over."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    faces = mesh.faces.copy()
    if flipped:
        faces[:triangles] = faces[:triangles, ::-1]
        return trimesh.Trimesh(mesh.vertices, faces, process=False)
    return trimesh.Trimesh(mesh.vertices, faces[triangles:], process=False)


@pytest.mark.parametrize("flipped", [False, True])
def test_a_nearly_closed_mesh_is_told(flipped, tmp_path):
    """It has no inside, which nobody expects of a ball with a hole; the warning names the mesh and the first edge."""
    with pytest.warns(UserWarning, match=r"mesh: nearly closed, but for \d+ edges that do not join triangles"):
        body = Body.from_surface(dented(2, flipped))
    assert body.pieces[0].kind == "surface"
    dented(1, flipped).export(tmp_path / "ball.stl")
    with pytest.warns(UserWarning, match=r"ball.stl: nearly closed, but for 3 edges"):
        Body.from_surface(tmp_path / "ball.stl")
    Body.from_surface(dented(2, flipped), solid=False)  # is meant so


def test_open_meshes_are_not_told():
    """A terrain, a half ball and loose triangles are not taken for closed meshes with a hole."""
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    z = np.sin(x) + np.cos(y)
    corners = np.arange(400).reshape(20, 20)
    a, b, c, d = (at.ravel() for at in (corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]))
    terrain = (
        np.column_stack([x.ravel(), y.ravel(), z.ravel()]),
        np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]),
    )
    Body.from_surface(terrain)
    half = trimesh.creation.icosphere(subdivisions=2)
    half.update_faces(half.triangles_center[:, 2] > 0)
    Body.from_surface(half)
    rng = np.random.default_rng(0)
    Body.from_surface((rng.normal(size=(300, 3)), np.arange(300).reshape(-1, 3)))
