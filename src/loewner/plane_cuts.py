"""Convex pieces that stick out of a mesh by no more than a tolerance, by cutting it with planes.

The hull of the surface on one side of a plane holds the solid on that side, since the extreme points of a solid's
section lie on its surface. So the pieces hold the mesh without being grown, and their triangles show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from loewner._validate import Floats, Progress
from loewner.errors import GeometryError
from loewner.polytopes import Polytope
from loewner.protrusion import Solid, protrusions
from loewner.triangles import cut, squared_distances, unit_normals

# How near the bound on a piece's protrusion comes to its value before the piece is cut.
ACCURACY = 0.25

# Planes tried for a cut: of so many faces near the deepest point, so many around the shortest way from there to the
# mesh, and across the axes.
FACES, TURNS = 6, 4

# Random points of a hull's surface that stand for it while planes and merges are compared.
SAMPLES = 48

# A part with less than this share of a piece's volume is no progress.
LEAST_SHARE = 1e-4

# A flat part of a surface becomes a plate, whose sides are this share of the tolerance from it. A closed surface has
# such parts where planes cut off all that is behind a face.
PLATE = 0.25

# Pieces in all, where the caller sets no limit: a tolerance that needs more is one below the mesh's own accuracy.
MOST = 2000


@dataclass(frozen=True, eq=False)
class Cell:
    """The part of the surface in one convex cell, its hull, and a proven bound on how far that sticks out."""

    triangles: Floats
    hull: Polytope
    bound: float = np.inf


def pieces_within(
    parts: list[Floats], solid: Solid, tolerance: float, most: int | None, progress: Progress | None
) -> list[Cell]:
    """Cut parts of a mesh until no hull sticks out of the mesh by more than a tolerance, as far as it can be done.

    Parameters
    ----------
    parts : list of ndarray, each of shape (t, 3, 3)
        Corners of triangles: closed parts with their cavities, or the one surface that is not closed.
    solid : Solid
        The whole mesh.
    tolerance : float
        In metres.
    most : int, optional
        Limit on the number of cells.
    progress : callable, optional
        Called as ``progress(done, total)``, in pieces that are there.
    """
    limit = MOST if most is None else most
    if len(parts) > limit:
        parts = [np.concatenate(parts)]
    rng = np.random.default_rng(0)
    plate = PLATE * tolerance
    cells = [_cell(part, plate) for part in parts]
    done: list[Cell] = []
    while cells:
        found = protrusions([cell.hull for cell in cells], solid, floor=tolerance, relative=ACCURACY)
        order = np.argsort(-found.bounds)
        todo: list[Cell] = []
        for rank, k in enumerate(order):
            cell = Cell(cells[k].triangles, cells[k].hull, float(found.bounds[k]))
            # Every cell that is not yet looked at counts as one piece, and a cut makes one more.
            room = len(done) + len(todo) + len(order) - rank < limit
            open_to_cut = cell.bound > tolerance and room and found.found[k] > 0
            halves = _cut(cell, found.points[k], solid, plate, rng) if open_to_cut else None
            if halves is None:
                done.append(cell)
            else:
                todo += halves
            if progress is not None:
                progress(len(done), len(done) + len(todo) + len(order) - rank - 1)
        cells = todo
    return _merged(done, solid, tolerance, rng)


def _cut(cell: Cell, deepest: Floats, solid: Solid, plate: float, rng: np.random.Generator) -> list[Cell] | None:
    """Two parts of a cell, by the plane that leaves the least to stick out; None if no plane makes progress."""
    whole = _volume(cell.hull)
    ones = np.ones(len(cell.triangles))
    options, shares, samples = [], [], []
    for normal, offset in _planes(cell, deepest, solid, plate):
        below, _, above, _ = cut(cell.triangles, ones[:, None] * normal, ones * offset, solid.rounding)
        try:
            halves = [_cell(half, plate) for half in (below, above)]
        except GeometryError:
            continue  # nothing on one side, or a line
        volumes = [_volume(half.hull) for half in halves]
        if solid.closed and min(volumes) < LEAST_SHARE * whole:
            continue
        options.append(halves)
        shares.append(sum(volumes) / whole)
        samples += [_samples(half.hull, rng) for half in halves]
    if not options:
        return None
    out = solid.signed_distances(np.concatenate(samples))[0].reshape(len(options), -1).max(axis=1)
    return options[int((np.array(shares) + np.maximum(out, 0.0) / cell.bound).argmin())]


def _cell(triangles: Floats, plate: float) -> Cell:
    return Cell(triangles, _hull(np.unique(triangles.reshape(-1, 3), axis=0), plate))


def _hull(points: Floats, plate: float) -> Polytope:
    """Hull of points; of flat ones, a plate with its sides so far from them."""
    try:
        return Polytope.from_points(points)
    except GeometryError:
        if len(points) == 0:
            raise
    thin = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    return Polytope.from_points(np.concatenate([points - plate * thin, points + plate * thin]))


def _planes(cell: Cell, deepest: Floats, solid: Solid, plate: float) -> list[tuple[Floats, float]]:
    """Planes that may cut off what sticks out, as unit normals and offsets."""
    _, nearest = solid.signed_distances(deepest[None])
    out = deepest - _foot(deepest, solid.triangles[nearest[0]])
    out /= max(float(np.linalg.norm(out)), np.finfo(float).tiny)
    corners = cell.triangles.reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    principal = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    across = np.cross(out, principal[np.abs(principal @ out).argmin()])
    across /= np.linalg.norm(across)
    angles = np.pi * np.arange(TURNS) / TURNS
    turned = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(out, across)
    normals = [*turned, *np.eye(3), *principal]
    planes = [(n, float(n @ deepest)) for n in normals] + [(n, float(n @ middle)) for n in (*np.eye(3), *principal)]
    faces = unit_normals(cell.triangles)
    squared = squared_distances(np.broadcast_to(deepest, (len(faces), 3)), cell.triangles)
    chosen: list[Floats] = []
    for k in np.argsort(squared):
        if len(chosen) == FACES:
            break
        if faces[k].any() and all(abs(faces[k] @ other) < 0.999 for other in chosen):
            chosen.append(faces[k])
            # From a surface that is not closed, the face itself is cut off, with a little of what it borders on.
            below = 0.0 if solid.closed else 2 * plate
            planes.append((faces[k], float(faces[k] @ cell.triangles[k, 0]) - below))
    return planes


def _foot(point: Floats, triangle: Floats) -> Floats:
    """The point of a triangle that is nearest to a point."""
    normal = unit_normals(triangle[None])[0]
    edges = np.roll(triangle, -1, axis=0) - triangle
    foot: Floats = point - ((point - triangle[0]) @ normal) * normal
    inward = (np.cross(normal, edges) * (foot - triangle)).sum(axis=1)
    if normal.any() and (inward >= 0).all():
        return foot
    along = np.clip(((point - triangle) * edges).sum(axis=1) / np.maximum((edges**2).sum(axis=1), 1e-300), 0, 1)
    feet = triangle + along[:, None] * edges
    nearest: Floats = feet[((point - feet) ** 2).sum(axis=1).argmin()]
    return nearest


def _merged(cells: list[Cell], solid: Solid, tolerance: float, rng: np.random.Generator) -> list[Cell]:
    """Join cells as long as their common hull sticks out by no more than the tolerance."""
    cells, alive, apart = list(cells), set(range(len(cells))), set[tuple[int, int]]()
    while True:
        pairs = [
            (a, b)
            for a, b in combinations(sorted(alive), 2)
            if (a, b) not in apart
            and max(cells[a].bound, cells[b].bound) <= tolerance
            and _touch(cells[a].hull, cells[b].hull, tolerance)
        ]
        if not pairs:
            break
        hulls = [
            Polytope.from_points(np.concatenate([cells[a].hull.vertices, cells[b].hull.vertices])) for a, b in pairs
        ]
        samples = np.concatenate([_samples(hull, rng) for hull in hulls])
        height = solid.signed_distances(samples)[0].reshape(len(hulls), -1).max(axis=1)
        apart |= {pair for pair, out in zip(pairs, height, strict=True) if out > tolerance}
        gain = [
            _volume(hull) - sum(_volume(cells[k].hull) for k in pair) for hull, pair in zip(hulls, pairs, strict=True)
        ]
        taken: set[int] = set()
        chosen = []
        for k in np.argsort(gain, kind="stable"):
            if height[k] <= tolerance and not taken & {*pairs[k]}:
                taken |= {*pairs[k]}
                chosen.append(k)
        if not chosen:
            break
        bounds = protrusions([hulls[k] for k in chosen], solid, floor=tolerance, relative=ACCURACY).bounds
        for k, bound in zip(chosen, bounds, strict=True):
            if bound > tolerance:
                apart.add(pairs[k])
                continue
            joined = np.concatenate([cells[i].triangles for i in pairs[k]])
            alive -= {*pairs[k]}
            alive.add(len(cells))
            cells.append(Cell(joined, hulls[k], float(bound)))
    return [cells[k] for k in sorted(alive)]


def _touch(first: Polytope, second: Polytope, reach: float) -> bool:
    """Whether the boxes of two pieces are within reach of each other."""
    a, b = first.vertices, second.vertices
    return bool((np.maximum(a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0)) <= reach).all())


def _samples(hull: Polytope, rng: np.random.Generator) -> Floats:
    """Random points of a hull's surface."""
    corners = hull.vertices[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), SAMPLES, p=area / area.sum())]
    return np.asarray(np.einsum("ij,ijk->ik", rng.dirichlet(np.ones(3), SAMPLES), chosen))


def _volume(hull: Polytope) -> float:
    a, b, c = (hull.vertices - hull.vertices.mean(axis=0))[hull.simplices].transpose(1, 0, 2)
    return abs(float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6))
