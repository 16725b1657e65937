"""Surfaces on a lattice, with all that meshes have wrong, at contact: whole numbers judge what is said of them."""

from collections import Counter
from typing import NamedTuple

import numpy as np

import surface_oracle
from families import rotations
from loewner import Body, Verdict, classify, collide, distance
from sliding_motions import CORNERS, TRIANGLES
from surface_oracle import Mesh, collides

# The whole of a depth does part two bodies; so much of it must not.
SHARE = 0.999999
# Relative to the lengths: what distances are right to (docs/verification.md).
TIGHT = 1e-9


class Pair(NamedTuple):
    """Two meshes at their poses, and bodies of them."""

    meshes: tuple[Mesh, Mesh]
    bodies: tuple[Body, Body]
    poses: tuple[np.ndarray, np.ndarray]
    lengths: float  # that rounding is relative to


# -- meshes ------------------------------------------------------------------------------------


def block(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Triangles of a box, outwards."""
    return np.where(CORNERS, high, low)[TRIANGLES]


def tetrahedron(corners: np.ndarray) -> np.ndarray:
    """Triangles of a tetrahedron; outwards or inwards, or flat."""
    return corners[np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])]


def closed_part(rng: np.random.Generator) -> np.ndarray:
    """A block or tetrahedron on the lattice, or one within another: a cavity, or a shell of the same kind."""
    if rng.random() < 0.3:
        return tetrahedron(rng.integers(-3, 4, (4, 3)))
    low = rng.integers(-3, 2, 3)
    outer = block(low, low + rng.integers(1, 6, 3))
    if rng.random() < 0.5:
        return outer
    inset = int(rng.integers(0, 2))  # 0: shells that coincide
    most = outer.reshape(-1, 3).max(axis=0)
    inner = block(low + inset, np.maximum(most - inset, low + inset + 1))
    return np.concatenate([outer, inner[:, ::-1] if rng.random() < 0.7 else inner])


def damaged(rng: np.random.Generator, faces: np.ndarray) -> np.ndarray:
    """The same with triangles there and back, of no area, split; every edge is still passed as often forth as back."""
    for _ in range(int(rng.integers(0, 4))):
        k, way = int(rng.integers(len(faces))), int(rng.integers(3))
        a, b, c = np.roll(faces[k], way, axis=0)
        if way == 0:  # once more, there and back
            faces = np.concatenate([faces, [[a, b, c], [a, c, b]]])
        elif way == 1:  # an edge split on one side alone, and the seam closed by a triangle of no area
            m = (a + b) / 2
            faces = np.concatenate([np.delete(faces, k, axis=0), [[a, m, c], [m, b, c], [a, b, m]]])
        else:  # a point and a segment
            faces = np.concatenate([faces, [[a, a, a], [a, b, a]]])
    return faces


def lattice_mesh(rng: np.random.Generator, scale: float) -> Mesh:
    """A few closed parts, or triangles that have nothing in common; in one of two a part stands twice or inside out."""
    if rng.random() < 0.25:
        corners = rng.integers(-3, 4, (int(rng.integers(1, 8)), 3, 3)).astype(float)
        corners[0] += np.eye(3) * (not np.cross(*np.diff(corners[0], axis=0)).any())
        return Mesh(corners.reshape(-1, 3) * scale, np.arange(3 * len(corners)).reshape(-1, 3), False)
    parts = [closed_part(rng).astype(float) for _ in range(int(rng.integers(1, 4)))]
    if rng.random() < 0.5:
        again = parts[int(rng.integers(len(parts)))]
        parts.append(again[:, ::-1] if rng.random() < 0.5 else again)
    faces = damaged(rng, np.concatenate(parts))
    return Mesh(faces.reshape(-1, 3) * scale, np.arange(3 * len(faces)).reshape(-1, 3), bool(rng.random() < 0.8))


def hull_mesh(rng: np.random.Generator, scale: float) -> Mesh:
    """A convex block or tetrahedron."""
    while True:
        points = rng.integers(-3, 4, (4, 3))
        faces = tetrahedron(points) if rng.random() < 0.5 else block(*np.sort(points[:2], axis=0))
        volume = np.linalg.det(faces).sum()
        if abs(volume) > 0.5:  # six times the volume, a whole number but for rounding
            turned = faces if volume > 0 else faces[:, ::-1]
            return Mesh(turned.reshape(-1, 3) * scale, np.arange(3 * len(faces)).reshape(-1, 3), True)


# -- contacts ----------------------------------------------------------------------------------


def turn(rng: np.random.Generator) -> np.ndarray:
    """No rotation, one of a cube, or any."""
    kind = rng.integers(3)
    if kind == 2:
        return rotations(rng, 1)[0]
    R = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3) if kind else np.eye(3)
    return R * np.linalg.det(R).round()


def feature(rng: np.random.Generator, mesh: Mesh, T: np.ndarray, toward: np.ndarray | None) -> np.ndarray:
    """A point of a placed mesh on a vertex, an edge or a face; with a direction on the farthest along it."""
    corners = mesh.vertices[mesh.faces] @ T[:3, :3].T + T[:3, 3]
    if toward is None:
        chosen = corners[rng.integers(len(corners))]
        return chosen.T @ [[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.25, 0.5]][rng.integers(3)]
    along = corners.reshape(-1, 3) @ toward
    farthest = corners.reshape(-1, 3)[along >= along.max() - 1e-9 * np.ptp(along)]
    return np.mean(farthest[rng.integers(len(farthest), size=rng.integers(1, 4))], axis=0)


def pair(rng: np.random.Generator, hulls: bool = False) -> Pair:
    """Two meshes of sizes up to 1e6 : 1 at contact, plus or minus 1e-18 to 1e-6 of the size of either."""
    scale = 10 ** rng.uniform(-3, 3) if rng.random() < 0.5 else 2.0 ** rng.integers(-10, 10)
    ratio = 2.0 ** -rng.integers(0, 20) if rng.random() < 0.5 else 10 ** rng.uniform(-6, 0)
    scales = [scale, scale * ratio] if rng.random() < 0.5 else [scale * ratio, scale]
    a = lattice_mesh(rng, scales[0])
    b = hull_mesh(rng, scales[1]) if hulls else lattice_mesh(rng, scales[1])
    Ta, Tb = np.eye(4), np.eye(4)
    Ta[:3, :3], Tb[:3, :3] = turn(rng), turn(rng)
    Ta[:3, 3] = scale * rng.integers(-3, 4, 3) * rng.choice([0, 1, 0.1])
    toward = rng.integers(-2, 3, 3).astype(float) if rng.random() < 0.7 else None
    if toward is not None:
        toward += toward == 0 if not toward.any() else 0
        toward = Ta[:3, :3] @ toward / np.linalg.norm(toward)
    on_a, on_b = feature(rng, a, Ta, toward), feature(rng, b, Tb, None if toward is None else -toward)
    way = toward if toward is not None and rng.random() < 0.7 else rng.normal(size=3)
    # Deeper where depths are what is wanted: the nearest way out is then no longer the one it came.
    by = -(10 ** rng.uniform(-4, 0)) if hulls else rng.choice([-1, 0, 1]) * 10 ** rng.uniform(-18, -6)
    Tb[:3, 3] = on_a - on_b + rng.choice(scales) * by * way
    made = Body.from_points(b.vertices) if hulls else body_of(b)
    lengths = sum(np.abs(m.vertices).max() + np.abs(T[:3, 3]).max() for m, T in ((a, Ta), (b, Tb)))
    return Pair((a, b), (body_of(a), made), (Ta, Tb), float(lengths))


def body_of(mesh: Mesh) -> Body:
    """The surface that a mesh is."""
    return Body.from_surface((mesh.vertices, mesh.faces), solid=bool(mesh.solid))


# -- laws --------------------------------------------------------------------------------------


def judged(given: Pair, counts: Counter[str]) -> str:
    """What is wrong with the answers about two surfaces; empty if nothing is."""
    (a, b), (A, B), (Ta, Tb) = given.meshes, given.bodies, given.poses
    truth = bool(collides(a, Ta, b, Tb, count=lambda n: counts.update(whole=n))[0])
    counts.update(["colliding" if truth else "free"])
    said = collide(A, Ta, B, Tb), collide(B, Tb, A, Ta), bool(collide(A, np.stack([Ta, Ta]), B, Tb)[1])
    if set(said) != {truth}:
        return f"colliding is {truth} in whole numbers, and {said} alone, swapped and in a batch"
    verdict = classify(A, Ta, B, Tb)
    if verdict == (Verdict.FREE if truth else Verdict.COLLIDING):
        return f"{verdict.name} is wrong in whole numbers"
    if not truth:
        found, exact = distance(A, Ta, B, Tb, exact=True), surface_oracle.distance(a, Ta, b, Tb)
        slack = TIGHT * given.lengths
        if not (found.lower <= exact + slack and exact <= found.upper + slack and abs(found.distance - exact) <= slack):
            return f"distance {found.distance} in [{found.lower}, {found.upper}], and {exact} in whole numbers"
    return ""


def not_parted(given: Pair, counts: Counter[str]) -> str:
    """What is wrong with the depth of a pair that collides; empty if nothing is.

    The law: moving a body by less than the depth, along the normal, does not part the two.
    """
    (a, b), (A, B), (Ta, Tb) = given.meshes, given.bodies, given.poses
    if not collides(a, Ta, b, Tb)[0]:
        return ""
    found = distance(A, Ta, B, Tb, exact=True)
    if not -found.distance * (1 - SHARE) > 4 * np.spacing(given.lengths):
        return ""  # rounding of the translation would count for more
    counts.update(["depths"])
    moved = Tb.copy()
    moved[:3, 3] -= found.normal * found.distance * SHARE
    if not collides(a, Ta, b, moved)[0]:
        return f"{SHARE} of the depth {-found.distance} along {found.normal} parts the two"
    return ""
