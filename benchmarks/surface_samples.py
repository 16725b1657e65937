"""Meshes that surfaces are benchmarked on, in pairs, and poses of them. The oracle of the tests tells the truth."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from loewner.meshes import decomposition as meshes
from rivals import Missing
from samples import Array, poses, rotations

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from surface_oracle import Mesh, boundary, collides, distance, distances_of_points

__all__ = ["Mesh", "Pair", "boundary", "collides", "distance", "distances_of_points"]

# The share of random poses that collide, on how many that is tried, and how far around they are drawn.
SHARE, TRIAL = 1 / 3, 300
FACTORS = tuple(4 * 0.94**k for k in range(80))
# A mug, metres: outer radius, height, wall, floor. Its handle: radius, that of its tube, how deep it is in the wall.
MUG_RADIUS, MUG_HEIGHT, MUG_WALL, MUG_FLOOR = 0.04, 0.1, 0.003, 0.005
HANDLE, TUBE, DEEP = 0.028, 0.005, 0.0015

Faces = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two meshes; whether they are solid is for each of them to say."""

    name: str
    a: Mesh
    b: Mesh

    @property
    def size(self) -> float:
        return self.a.size + self.b.size


def robot_file(path: str) -> Path:
    """A file of example-robot-data, relative to its folder of robots."""
    try:
        files = distribution("example-robot-data")
    except PackageNotFoundError:
        raise Missing("package example-robot-data is not installed") from None
    return Path(str(files.locate_file("cmeel.prefix/share/example-robot-data/robots"))) / path


def robot_mesh(path: str) -> Mesh:
    return Mesh(*meshes.load(robot_file(path)))


LINK5 = "panda_description/meshes/visual/link5.dae"
HAND = "panda_description/meshes/visual/hand.dae"


def pairs() -> list[Pair]:
    """Ten pairs: open and closed, of one shell and of many, with and without degenerate triangles."""
    hand, cup = robot_mesh(HAND), Mesh(*mug())
    nested = Mesh(*joined(*(sphere(r, 3, inwards=k % 2 == 1) for k, r in enumerate((0.10, 0.09, 0.06, 0.05)))))
    hollow = Mesh(*joined(sphere(0.02, 2), sphere(0.015, 2, inwards=True)))
    tube = Mesh(*joined(torus(0.1, 0.04, 64, 32), torus(0.1, 0.037, 64, 32, inwards=True)))
    return [
        Pair("Panda: link 5 and hand, open", robot_mesh(LINK5), hand),
        Pair("G1: head, Bolt: body, closed", robot_mesh("g1_description/meshes/head_link.STL"),
             robot_mesh("bolt_description/meshes/stl/bolt_body.stl")),
        Pair("UR5: forearm and base, closed, with degenerate triangles",
             robot_mesh("ur_description/meshes/ur5/visual/forearm.dae"),
             robot_mesh("ur_description/meshes/ur5/visual/base.dae")),
        Pair("Talos: torso, Allegro: palm, open", robot_mesh("talos_data/meshes/torso/torso_2.STL"),
             robot_mesh("allegro_hand_description/meshes/base_link.STL")),
        Pair("Cassie: spring of 12 parts, Finger: link, closed",
             robot_mesh("cassie_description/meshes/knee-spring.stl"),
             robot_mesh("finger_edu_description/meshes/lower_link.stl")),
        Pair("knot in a hollow torus", tube, Mesh(*knot(0.1, 0.015, 0.006, 240, 12))),
        Pair("shells in shells", nested, hollow),
        Pair("mug and ball", cup, Mesh(*sphere(0.012, 3))),
        Pair("mug and Panda's finger of 4 parts", cup, robot_mesh("panda_description/meshes/visual/finger.dae")),
        Pair("terrain of 20,000 triangles and hand", Mesh(*terrain(20_000)), hand),
    ]  # fmt: skip


# -- meshes ------------------------------------------------------------------------------------


def trimesh_of(vertices: Array, faces: Array) -> Any:
    """The same as a trimesh.Trimesh that merges and drops nothing."""
    if find_spec("trimesh") is None:
        raise Missing("package trimesh is not installed")
    import trimesh

    return trimesh.Trimesh(vertices, faces, process=False)


def joined(*parts: Faces) -> Faces:
    starts = np.cumsum([0, *(len(v) for v, _ in parts)])
    faces = [f + start for (_, f), start in zip(parts, starts, strict=False)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(faces)


def grid(across: int, along: int) -> Array:
    """Triangles of a grid of points, closed both ways."""
    i, j = (x.ravel() for x in np.meshgrid(np.arange(along), np.arange(across), indexing="ij"))
    a, b = i * across + j, ((i + 1) % along) * across + j
    c, d = ((i + 1) % along) * across + (j + 1) % across, i * across + (j + 1) % across
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def sphere(radius: float, subdivisions: int, inwards: bool = False) -> Faces:
    if find_spec("trimesh") is None:
        raise Missing("package trimesh is not installed")
    import trimesh

    made = trimesh.creation.icosphere(subdivisions, radius)
    return made.vertices.view(np.ndarray).copy(), made.faces[:, ::-1].copy() if inwards else made.faces.copy()


def torus(ring: float, tube: float, along: int, across: int, inwards: bool = False) -> Faces:
    u, v = np.meshgrid(*(2 * np.pi * np.arange(n) / n for n in (along, across)), indexing="ij")
    wide = ring + tube * np.cos(v)
    vertices = np.stack([wide * np.cos(u), wide * np.sin(u), tube * np.sin(v)], axis=-1).reshape(-1, 3)
    faces = grid(across, along)
    return vertices, faces[:, ::-1] if inwards else faces


def knot(ring: float, tube: float, rope: float, along: int, across: int) -> Faces:
    """A rope along the trefoil on a torus."""
    s = 2 * np.pi * np.arange(along) / along
    wide = ring + tube * np.cos(3 * s)
    center = np.column_stack([wide * np.cos(2 * s), wide * np.sin(2 * s), tube * np.sin(3 * s)])
    way = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    # Square to the rope and to the radius; that one never runs along the rope.
    up = np.cross(way, center)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    side = np.cross(up, way)
    v = 2 * np.pi * np.arange(across) / across
    around = np.cos(v)[:, None] * side[:, None] + np.sin(v)[:, None] * up[:, None]
    return (center[:, None] + rope * around).reshape(-1, 3), grid(across, along)[:, ::-1]


def mug(sections: int = 96) -> Faces:
    """A cup by revolution, and a torus through its wall for a handle: closed, wound around twice where they overlap.

    The cavity's axis is z, its floor at MUG_FLOOR. The tube enters the wall to DEEP and not the cavity.
    """
    inner = MUG_RADIUS - MUG_WALL
    profile = [(MUG_RADIUS, 0.0), (MUG_RADIUS, MUG_HEIGHT), (inner, MUG_HEIGHT), (inner, MUG_FLOOR)]
    angle = 2 * np.pi * np.arange(sections) / sections
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(sections, z)]) for r, z in profile]
    vertices = np.concatenate([*rings, [[0, 0, 0]], [[0, 0, MUG_FLOOR]]])
    j = np.arange(sections)
    k = (j + 1) % sections
    faces = [np.column_stack([np.full(sections, 4 * sections), k, j])]
    for ring in range(3):
        low, high = ring * sections, (ring + 1) * sections
        faces += [np.column_stack([low + j, low + k, high + k]), np.column_stack([low + j, high + k, high + j])]
    faces.append(np.column_stack([np.full(sections, 4 * sections + 1), 3 * sections + j, 3 * sections + k]))
    ring, around = torus(HANDLE, TUBE, 48, 16)
    ring = ring[:, [0, 2, 1]] * [1, -1, 1]  # its axis along y
    # Its centre is so far out that the innermost points of the tube are DEEP in the wall.
    ring = ring + [MUG_RADIUS - DEEP + HANDLE + TUBE, 0, MUG_HEIGHT / 2]
    return joined((vertices, np.concatenate(faces)), (ring, around))


def cavity() -> Array:
    """The middle of the mug's cavity."""
    return np.array([0.0, 0.0, (MUG_FLOOR + MUG_HEIGHT) / 2])


def terrain(triangles: int, size: float = 4.0, seed: int = 0) -> Faces:
    """Hills of many widths on a square, about so many triangles: an open mesh."""
    n = round((triangles / 2) ** 0.5) + 1
    x, y = np.meshgrid(*[np.linspace(-size / 2, size / 2, n)] * 2, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), hills(x, y, seed).ravel()]), open_grid(n)


def hills(x: Array, y: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    z = np.zeros_like(x)
    for octave in range(7):
        for _ in range(4):
            angle, phase = rng.uniform(0, 2 * np.pi, 2)
            waves = 1.5 * 1.9**octave
            z += 0.25 / 2.1**octave * np.sin(waves * (np.cos(angle) * x + np.sin(angle) * y) + phase)
    return z


def open_grid(n: int) -> Array:
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
    a, b, c, d = i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1, i * n + j + 1
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def rock(subdivisions: int, radius: float = 0.5, seed: int = 1) -> Faces:
    """A sphere with hills on it, 20 * 4**subdivisions triangles: closed."""
    vertices, faces = sphere(1.0, subdivisions)
    height = hills(4 * vertices[:, 0], 4 * vertices[:, 1] + 3 * vertices[:, 2], seed)
    return vertices * radius * (1 + 0.1 * height[:, None]), faces


# -- poses -------------------------------------------------------------------------------------


def drawn(pair: Pair, count: int, seed: int) -> tuple[Array, Array]:
    """Poses at random, about a third of which collide.

    Both meshes are turned at random. The middle of b lies anywhere in the box of a widened by b's radius, times the
    largest of FACTORS at which a third of TRIAL poses collide, or else the one at which most do.
    """
    return placed(pair, count, seed, factor(pair))


@cache
def factor(pair: Pair) -> float:
    shares: dict[float, float] = {}
    for f in FACTORS:
        Ta, Tb = placed(pair, TRIAL, 12345, f)
        shares[f] = float(collides(pair.a, Ta, pair.b, Tb).mean())
        if shares[f] >= SHARE:
            return f
    return max(shares, key=lambda f: shares[f])


def placed(pair: Pair, count: int, seed: int, wide: float) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    (center_a, half), (center_b, _) = box(pair.a), box(pair.b)
    Ra, Rb = rotations(rng, count), rotations(rng, count)
    at = center_a + wide * (half + pair.b.size / 2) * rng.uniform(-1, 1, (count, 3))
    ta = rng.uniform(-1, 1, (count, 3)) * pair.size
    tb = np.einsum("nij,nj->ni", Ra, at) + ta - np.einsum("nij,nj->ni", Rb, np.tile(center_b, (count, 1)))
    return poses(Ra, ta), poses(Rb, tb)


def box(mesh: Mesh) -> tuple[Array, Array]:
    used = mesh.vertices[np.unique(mesh.faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    return (low + high) / 2, (high - low) / 2


def grazing(
    pair: Pair, count: int, seed: int, tolerance: float, told: Callable[[int], object] | None = None
) -> tuple[Array, Array, Array]:
    """Poses on both sides of contact, and whether they collide: `count` in all, half of them on each side.

    From a colliding pose b moves a random way until it is free; halving comes to within `tolerance`, a share of the
    size of the smaller mesh. The oracle looks.
    """
    rng = np.random.default_rng(seed)
    found: list[tuple[Array, Array, Array]] = []
    near = tolerance * min(pair.a.size, pair.b.size)
    for batch in range(100):
        Ta, Tb = drawn(pair, 4 * count, seed + 7 * batch)
        for n in np.flatnonzero(collides(pair.a, Ta, pair.b, Tb)):
            way = rng.normal(size=3)
            way *= rng.uniform(0.1, 1.0) * pair.size / np.linalg.norm(way)
            both = boundary(pair.a, Ta[n], pair.b, Tb[n], way, near)
            if both is not None:
                found.append((Ta[n], *both))
            if 2 * len(found) >= count:
                A, hit, free = (np.array(x) for x in zip(*found, strict=True))
                truth = np.repeat([True, False], len(found))
                return np.concatenate([A, A]), np.concatenate([hit, free]), truth
    raise ArithmeticError(f"{pair.name}: no contact found")
