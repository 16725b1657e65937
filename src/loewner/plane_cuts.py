"""Convex pieces that stick out of a mesh by no more than a tolerance, by cutting it with planes.

The hull of the surface on one side of a plane holds the solid on that side, since the extreme points of a solid's
section lie on its surface. So the pieces hold the mesh without being grown, and their triangles show it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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


# Cells that stick out by less than this share of the largest bound wait until the others are cut.
FARTHEST = 0.5

# Cells are cut, joined and cut again at most so often, where a limit on the number of pieces leaves room for it.
PASSES = 20


@dataclass(frozen=True, eq=False)
class Cell:
    """The part of the surface in one convex cell, its hull, and a proven bound on how far that sticks out.

    Attributes
    ----------
    triangles : ndarray, shape (t, 3, 3)
    hull : Polytope
    bound : float
        Metres; infinite before it is measured.
    deepest : ndarray, shape (3,)
        The point of the hull that was found to stick out most.
    whole : bool
        Whether nothing is found to stick out, or no plane makes progress.
    """

    triangles: Floats
    hull: Polytope
    bound: float = np.inf
    deepest: Floats = field(default_factory=lambda: np.full(3, np.nan))
    whole: bool = False

    def is_out(self, tolerance: float) -> bool:
        """Whether it sticks out too far and may be cut."""
        return self.bound > tolerance and not self.whole


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
        Limit on the number of cells; those that stick out most are cut first.
    progress : callable, optional
        Called as ``progress(done, total)``, in pieces that are there.
    """
    limit = MOST if most is None else most
    if len(parts) > limit:
        parts = [np.concatenate(parts)]
    rng = np.random.default_rng(0)
    plate = PLATE * tolerance
    cells = [_cell(part, plate) for part in parts]
    for _ in range(PASSES):
        cells = _merged(_cut_up(cells, solid, tolerance, limit, plate, progress, rng), solid, tolerance, rng)
        # Joining makes room for more cuts.
        if len(cells) >= limit or not any(cell.is_out(tolerance) for cell in cells):
            break
    return cells


def _cut_up(
    cells: list[Cell], solid: Solid, tolerance: float, limit: int, plate: float, progress: Progress | None,
    rng: np.random.Generator,
) -> list[Cell]:  # fmt: skip
    """Cut cells that stick out too far until none does, or there are as many as the limit allows."""
    while True:
        cells = _measured(cells, solid, tolerance)
        out = sorted((cell for cell in cells if cell.is_out(tolerance)), key=lambda cell: -cell.bound)
        room = limit - len(cells)
        farthest = [cell for cell in out if cell.bound >= FARTHEST * out[0].bound]
        if progress is not None:
            progress(len(cells) - len(out), len(cells))
        if not out or room <= 0:
            return cells
        chosen = {id(cell) for cell in farthest[:room]}
        cells = [
            part
            for cell in cells
            for part in (
                (_cut(cell, solid, plate, rng) or [replace(cell, whole=True)]) if id(cell) in chosen else [cell]
            )
        ]


def _measured(cells: list[Cell], solid: Solid, tolerance: float) -> list[Cell]:
    """The same with bounds on how far they stick out, and where."""
    new = [k for k, cell in enumerate(cells) if not np.isfinite(cell.bound)]
    if new:
        found = protrusions([cells[k].hull for k in new], solid, floor=tolerance, relative=ACCURACY)
        cells = list(cells)
        for at, k in enumerate(new):
            cells[k] = replace(
                cells[k], bound=float(found.bounds[at]), deepest=found.points[at], whole=not found.found[at] > 0
            )
    return cells


def _cut(cell: Cell, solid: Solid, plate: float, rng: np.random.Generator) -> list[Cell] | None:
    """Two parts of a cell, by the plane that leaves the least to stick out; None if no plane makes progress."""
    whole = _volume(cell.hull)
    ones = np.ones(len(cell.triangles))
    options, shares, samples = [], [], []
    for normal, offset in _planes(cell, solid, plate):
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


def _planes(cell: Cell, solid: Solid, plate: float) -> list[tuple[Floats, float]]:
    """Planes that may cut off what sticks out, as unit normals and offsets."""
    deepest = cell.deepest
    _, nearest = solid.signed_distances(deepest[None])
    out = deepest - _foot(deepest, solid.triangles[nearest[0]])
    out /= max(float(np.linalg.norm(out)), np.finfo(float).tiny)
    corners = cell.triangles.reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    principal = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    normals = [*np.eye(3), *principal]
    if out.any():
        across = np.cross(out, principal[np.abs(principal @ out).argmin()])
        across /= np.linalg.norm(across)
        angles = np.pi * np.arange(TURNS) / TURNS
        normals = [*(np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(out, across)), *normals]
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
