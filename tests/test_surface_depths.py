"""Depths of surfaces are strict lower bounds: whole numbers and fractions say how far bodies have to be moved apart."""

import warnings
from collections.abc import Iterator
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from exact import ExactEllipsoid, rational, root_bounds
from families import random_poses
from loewner import Body, collide, distance
from sampling import quick
from surface_oracle import Mesh, Placed, Point, squared_distance

EYE = np.eye(4)
# How much a depth is lowered by, relative to the lengths: 64 units of roundoff (docs/certified.md), and as much again.
LOWERED = 2.0**-46

# Five triangles 6e5 m wide, two of them without area, and a hull of 0.6 m that lies in one of them.
WIDE = [
    [2e5, 0, 0], [3e5, -3e5, 2e5], [-2e5, 3e5, 0], [-2e5, -3e5, -3e5], [-1e5, 2e5, -2e5], [-1.5e5, -5e4, -2.5e5],
]  # fmt: skip
WIDE_FACES = [[4, 5, 0], [3, 1, 3], [4, 1, 1], [2, 4, 4], [5, 3, 0]]
SMALL = [
    [-0.02694101195104293, -0.10249761995601896, -0.22083573030287748],
    [0.03950017436739301, -0.0033910555562393415, 0.31373274768050596],
    [-0.15282215446375033, -0.35068179211139444, -0.27141788774249626],
    [0.025118324832700167, -0.21177735102451659, 0.18579403475525688],
    [-0.09349951332535916, -0.02900064362626382, -0.020415770305903785],
    [0.3039389368650382, 0.21448507251271853, -0.2271943580429852],
    [-0.21938065583806657, -0.2771848157816393, -0.07099792774552256],
    [-0.12044052527640209, -0.13149826358228278, -0.24125150060878128],
]
POSE_WIDE = [
    [-0.2832800336331657, -0.9249880638773598, -0.2532775241295715, 0.0],
    [0.4936521634326197, -0.36705968625071306, 0.7884001067147454, 0.0],
    [-0.8222286568121342, 0.09830701101112405, 0.5606030391488902, 0.0],
    [0.0, 0.0, 0.0, 1.0],
]
POSE_SMALL = [
    [0.2532775241295715, 0.2832800336331657, -0.9249880638773598, 343065.82096979924],
    [-0.7884001067147454, -0.4936521634326197, -0.36705968625071306, -64875.94173722459],
    [-0.5606030391488902, 0.8222286568121342, 0.09830701101112405, -65930.4909877763],
    [0.0, 0.0, 0.0, 1.0],
]


def minus(p: Point, q: Point) -> Point:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def dot(p: Point, q: Point) -> int:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def axes(P: list[Point], Q: list[Point]) -> Iterator[Point]:
    """Normals of all faces that the difference of two hulls can have, and others: products of any two edges."""
    edges = [minus(p, q) for X in (P, Q) for p, q in combinations(X, 2)]
    for u, v in combinations(edges, 2):
        n = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        if n != (0, 0, 0):
            yield n


def squared_depth(P: list[Point], Q: list[Point]) -> Fraction:
    """Square of how far two hulls have to be moved apart: the least overlap along an axis of theirs."""
    least = Fraction(-1)
    for n in axes(P, Q):
        p, q = [dot(n, x) for x in P], [dot(n, x) for x in Q]
        overlap = max(min(max(p) - min(q), max(q) - min(p)), 0)
        square = Fraction(overlap * overlap, dot(n, n))
        least = square if least < 0 else min(least, square)
    return max(least, Fraction(0))


def true_squared(mesh: Mesh, T: np.ndarray, points: np.ndarray, T_points: np.ndarray) -> Fraction:
    """Square of the depth [m] of the triangle that is deepest in a hull."""
    placed = Placed((mesh, Mesh(points, np.zeros((1, 3)), False)), (T, T_points))
    hull = [placed.vertex(1, k) for k in range(len(points))]
    squares = [squared_depth(list(placed.triangle(0, k)), hull) for k in range(len(mesh.faces))]
    return max(squares) * Fraction(2) ** (2 * placed.exponent)


def surface(mesh: Mesh, **options: float) -> Body:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".* across, all lengths being metres")
        return Body.from_surface((mesh.vertices, mesh.faces), solid=bool(mesh.solid), **options)


def turned(rng: np.random.Generator) -> np.ndarray:
    return random_poses(rng, 1, 0.0)[0]


def test_a_small_hull_in_a_wide_surface():
    """Moved by the depth that is told, a hull still meets triangles a million times its size."""
    mesh, points = Mesh(np.array(WIDE), np.array(WIDE_FACES), False), np.array(SMALL)
    T, T_points = np.array(POSE_WIDE), np.array(POSE_SMALL)
    a, b = surface(mesh), Body.from_points(points)
    true = true_squared(mesh, T, points, T_points)
    for found in (distance(a, T, b, T_points, exact=True), distance(b, T_points, a, T, exact=True)):
        assert found.distance < 0.0
        assert Fraction(found.distance) ** 2 <= true
        assert Fraction(-found.distance + LOWERED * 2e6) ** 2 > true
    found = distance(a, T, b, T_points, exact=True)
    moved = T_points.copy()
    moved[:3, 3] -= found.distance * (1 - 1e-6) * found.normal
    assert collide(a, T, b, moved)


@pytest.mark.parametrize("decades", [pytest.param(k, marks=[pytest.mark.verify] * (k % 3 != 0)) for k in range(-6, 7)])
@pytest.mark.parametrize("count", quick(10, 24))
def test_triangles_in_hulls_are_at_least_so_deep(decades: int, count: int):
    """However large, a triangle in a hull is at least as deep as told, and hardly deeper: all axes of theirs say so."""
    rng = np.random.default_rng(20 + decades)
    size = 10.0**decades
    told = 0
    for k in range(count):
        corners = size * (rng.integers(-4, 5, (2, 3, 3)) / 4 if k % 2 else rng.normal(size=(2, 3, 3)))
        points = rng.integers(-2, 3, (5, 3)) / 4 if k % 3 == 0 else rng.normal(size=(5, 3)) * 0.3
        if np.linalg.matrix_rank(points - points[0]) < 3:
            continue
        mesh = Mesh(corners.reshape(-1, 3), np.arange(6), False)
        T, T_points = turned(rng), turned(rng)
        T_points[:3, 3] = T[:3, :3] @ (rng.dirichlet(np.ones(3)) @ corners[0])
        T_points[:3, 3] -= T_points[:3, :3] @ (rng.dirichlet(np.ones(5)) @ points)
        found = distance(surface(mesh), T, Body.from_points(points), T_points, exact=True).distance
        true = true_squared(mesh, T, points, T_points)
        lengths = np.abs(T_points[:3, 3]).sum() + np.abs(corners).sum(axis=2).max() + np.abs(points).sum(axis=1).max()
        assert found <= LOWERED * lengths
        if found < 0.0:
            told += 1
            assert Fraction(float(found)) ** 2 <= true, k
            assert Fraction(float(LOWERED * lengths - found)) ** 2 >= true, k
    assert told > max(count - 12, 2)


@pytest.mark.parametrize("decades", [0, *(pytest.param(k, marks=pytest.mark.verify) for k in (2, 4)), 6])
@pytest.mark.parametrize("count", quick(16, 40))
def test_triangles_in_triangles_are_at_least_so_deep(decades: int, count: int):
    """The same of two surfaces, and of radii around those that cross or are apart."""
    rng = np.random.default_rng(40 + decades)
    told = 0
    for k in range(count):
        wide, small = 10.0**decades * rng.normal(size=(3, 3)), 0.3 * rng.normal(size=(3, 3))
        T, T_small = turned(rng), turned(rng)
        T_small[:3, 3] = T[:3, :3] @ (rng.dirichlet(np.ones(3)) @ wide)
        T_small[:3, 3] -= T_small[:3, :3] @ (rng.dirichlet(np.ones(3)) @ small) * (k % 4 != 0)
        meshes = Mesh(wide, np.arange(3), False), Mesh(small, np.arange(3), False)
        placed = Placed(meshes, (T, T_small))
        s, t = placed.triangle(0, 0), placed.triangle(1, 0)
        depth = root_bounds(squared_depth(list(s), list(t)))[1]
        apart = root_bounds(squared_distance(s, t))[0]
        for radius in (0.0, 0.75):
            a, b = surface(meshes[0]), surface(meshes[1], radius=radius)
            found = distance(a, T, b, T_small, exact=True).distance
            told += found < 0.0
            if found < 0.0:
                assert -Fraction(float(found)) <= Fraction(radius) + (depth - apart) * Fraction(2) ** placed.exponent, k
    assert told > max(count - 10, 5)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("count", quick(5, 12))
def test_curved_pieces_are_at_least_so_deep(size: float, count: int):
    """A triangle and an ellipsoid overlap by the depth at least, along the normal that is told and all others."""
    rng = np.random.default_rng(7)
    told = 0
    for axes_of in ([1.0, 0.5, 0.25], [0.5, 0.5, 0.5], [0.75, 0.75, 0.001]):
        for _ in range(count):
            mesh = Mesh(size * rng.normal(size=(3, 3)), np.arange(3), False)
            T, T_round = turned(rng), turned(rng)
            T_round[:3, 3] = T[:3, :3] @ (rng.dirichlet(np.ones(3)) @ mesh.vertices) + 0.05 * rng.normal(size=3)
            found = distance(surface(mesh), T, Body.ellipsoid(axes_of), T_round, exact=True)
            if not found.distance < 0.0:
                continue
            told += 1
            ellipsoid = ExactEllipsoid(np.zeros(3), np.diag(axes_of), T_round)
            corners = rational(mesh.vertices) @ rational(T[:3, :3]).T
            for n in [found.normal, *rng.normal(size=(5, 3))]:
                n = rational(n)
                heights, middle, reach = corners @ n, n @ ellipsoid.center, ellipsoid.reach(n)[1]
                overlap = min(max(heights) - middle, middle - min(heights)) + reach
                assert -Fraction(float(found.distance)) * root_bounds(n @ n)[0] <= overlap
    assert told > max(3 * count - 16, 5)


@pytest.mark.parametrize("size", [1.0, 1e3, 1e6])
def test_balls_in_solids_are_at_least_so_deep(size: float):
    """A ball in a cube has to go out through a face: it is no deeper than told for any of them, whatever the sizes."""
    rng = np.random.default_rng(8)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * size
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    cube = surface(Mesh(corners, np.array(faces)))
    assert cube.pieces[0].kind == "solid"
    for _ in range(40):
        T, T_ball = turned(rng), turned(rng)
        inside = size * rng.uniform(0.2, 0.8, 3)
        inside[rng.integers(3)] = rng.uniform(0.0, min(1.0, 0.2 * size))
        T_ball[:3, 3] = T[:3, :3] @ inside
        found = distance(cube, T, Body.sphere(0.25), T_ball, exact=True).distance
        assert found < 0.0
        R, center = rational(T[:3, :3]), rational(T_ball[:3, 3])
        for axis in range(3):
            u, v = R[:, axis - 2], R[:, axis - 1]
            n = np.array([u[k - 2] * v[k - 1] - u[k - 1] * v[k - 2] for k in range(3)])
            height, top = n @ center, n @ R[:, axis] * Fraction(size)
            least = min(abs(height), abs(top - height))
            assert (-Fraction(float(found)) - Fraction(1, 4)) * root_bounds(n @ n)[0] <= least


def test_the_deepest_point_of_a_cloud_counts():
    """Of many points in a solid box, wherever they are listed; the normal and the witnesses belong to the depth."""
    rng, radius, half = np.random.default_rng(59), 0.04, np.array([0.2, 0.25, 0.4])
    corners = half * [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    hull = ConvexHull(corners)
    inward = (np.cross(*(corners[hull.simplices][:, k] - corners[hull.simplices][:, 0] for k in (1, 2)))
              * hull.equations[:, :3]).sum(axis=1) < 0  # fmt: skip
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    box = Body.from_surface((corners, faces))
    points = rng.uniform(-0.6, 0.6, (200, 3))
    expected = (half - np.abs(points)).min(axis=1).max() + radius
    T = random_poses(rng, 4)
    for order in (np.arange(200), np.arange(200)[::-1], *(rng.permutation(200) for _ in range(4))):
        cloud = Body.from_cloud(points[order], radius=radius)
        for one, other in ((box, cloud), (cloud, box)):
            found = distance(one, T, other, T, exact=True)
            assert np.abs(found.distance + expected).max() < 1e-12
            along = ((found.witness_b - found.witness_a) * found.normal).sum(axis=-1)
            assert np.abs(along - found.distance).max() < 1e-12


def test_witnesses_of_a_graze_are_in_both_bodies():
    """A triangle whose core meets a flat ellipsoid: where there is no depth, both witnesses are a common point.

    The simplex that contains the origin had the weights of the one before.
    """
    half, semi_axes = np.array([0.15, 0.1, 0.2]), np.array([1.0, 1.0, 1e-3])
    shell = Body.from_surface(trimesh.creation.box(2 * half), solid=False)
    flat = Body.ellipsoid(semi_axes)
    rng = np.random.default_rng(5)
    Ta, Tb = random_poses(rng, 400, 0.4), random_poses(rng, 400, 0.4)
    gap = rng.choice([-1, 1], 400) * 10 ** rng.uniform(-13, -3, 400)
    found = distance(shell, Ta, flat, Tb, exact=True)
    Tb[:, :3, 3] += (gap - found.distance)[:, None] * found.normal
    found = distance(shell, Ta, flat, Tb, exact=True)
    touching = found.distance <= 0.0
    assert touching.sum() > 50
    on_b = np.einsum("nji,nj->ni", Tb[:, :3, :3], found.witness_b - Tb[:, :3, 3])[touching]
    on_a = np.einsum("nji,nj->ni", Ta[:, :3, :3], found.witness_a - Ta[:, :3, 3])[touching]
    assert (np.square(on_b / semi_axes).sum(axis=1) < 1.0 + 1e-4).all()
    assert np.abs(np.abs(on_a) - half).min(axis=1).max() < 1e-9
