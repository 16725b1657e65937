"""Cut a mesh along planes into convex pieces that stick out of the mesh by no more than a tolerance.

The hull of the surface on one side of a plane contains the solid on that side, since the extreme points of a solid's
section lie on the solid's surface. The pieces therefore contain the mesh without being grown.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from loewner._base import _elementary, _validate
from loewner._base._log import Percentage
from loewner._base._matrices import dot, image, lengths, normals_of, principal_axes, product
from loewner._base._validate import Floats, Progress
from loewner.ellipsoids.polytopes import Polytope
from loewner.errors import GeometryError
from loewner.meshes.protrusion import Solid, protrusions
from loewner.meshes.triangles import cut, squared_distances, unit_normals

# Relative accuracy of the bound on a piece's protrusion before the piece is cut.
ACCURACY = 0.25

# A cut tries the planes of FACES faces near the deepest point, TURNS planes around the shortest segment from that point
# to the mesh, and planes perpendicular to the coordinate axes and the principal axes.
FACES, TURNS = 6, 4

# Number of random triangles that represent a larger cell while planes are compared.
MANY = 1024

# Number of random points that represent a hull's surface while planes and merges are compared.
SAMPLES = 48

# A cut makes no progress if a part has less than this share of the piece's volume.
LEAST_SHARE = 1e-4

# A flat part of a surface becomes a plate, each of whose sides is this share of the tolerance away from the part. A
# closed surface has flat parts where planes cut off everything behind a face.
PLATE = 0.25

# Default limit on the number of pieces; a tolerance that needs more pieces is below the mesh's own accuracy.
MOST = 2000


# The work of a cut, in units of one triangle cut by one plane; OVERHEAD is the work for hulls and distances of a few
# triangles. Cells are cut until WORK is used up, about ten seconds on one core.
OVERHEAD, WORK = 1000, 8_000_000

# Cells that stick out by less than this share of the largest bound wait until the other cells are cut.
FARTHEST = 0.5

# Largest number of rounds of cutting and joining cells. If the number of pieces is limited, joining cells makes room
# for more cuts.
PASSES = 20


@dataclass(frozen=True, eq=False)
class Cell:
    """The part of the surface in one convex cell, the hull of that part, and a proven bound on the hull's protrusion.

    Attributes
    ----------
    triangles : ndarray, shape (t, 3, 3)
    hull : Polytope
    bound : float
        Bound in metres; infinite before it is measured.
    deepest : ndarray, shape (3,)
        The point of the hull that sticks out most, among the points examined.
    whole : bool
        Whether the cell stays whole, either because no point was found to stick out or because no plane makes progress.
    """

    triangles: Floats
    hull: Polytope
    bound: float = np.inf
    deepest: Floats = field(default_factory=lambda: np.full(3, np.nan))
    whole: bool = False

    def is_out(self, tolerance: float) -> bool:
        """Return whether the cell sticks out too far and may be cut."""
        return self.bound > tolerance and not self.whole


def pieces_within(
    parts: list[Floats], solid: Solid, tolerance: float, most: int | None, progress: Progress | None,
    work: float = np.inf,
) -> list[Cell]:  # fmt: skip
    """Cut parts of a mesh until, as far as possible, no hull sticks out of the mesh by more than a tolerance.

    Parameters
    ----------
    parts : list of ndarray, each of shape (t, 3, 3)
        Corners of triangles, either of closed parts with their cavities or of a single surface that is not closed.
    solid : Solid
        The whole mesh.
    tolerance : float
        Largest distance by which a hull may stick out, in metres.
    most : int, optional
        Limit on the number of cells; the cells that stick out most are cut first.
    progress : callable, optional
        Called as ``progress(done, total)``; the ratio is the share of the surface in pieces that need no more cuts.
    work : float
        Limit on the work spent on cuts; see `WORK`.
    """
    limit = MOST if most is None else most
    if len(parts) > limit:
        parts = [np.concatenate(parts)]
    rng = np.random.default_rng(0)
    plate = PLATE * tolerance
    cells = [_cell(part, plate) for part in parts]
    far = Percentage(_validate.reporter(progress))
    for _ in range(PASSES):
        cells, work = _cut_up(cells, solid, tolerance, limit, plate, far, rng, work)
        cells = _merged(cells, solid, tolerance, rng)
        # Joining makes room for more cuts.
        if work <= 0 or len(cells) >= limit or not any(cell.is_out(tolerance) for cell in cells):
            break
    far.done()  # even if some cells remain uncut
    return cells


def _finished(cells: list[Cell], tolerance: float) -> float:
    """Compute the share of the surface that is in cells that need no further cuts."""
    areas = np.array([lengths(normals_of(cell.triangles)).sum() for cell in cells])
    out = np.array([cell.is_out(tolerance) for cell in cells])
    return float(areas[~out].sum() / max(areas.sum(), np.finfo(float).tiny))


def _cut_up(
    cells: list[Cell], solid: Solid, tolerance: float, limit: int, plate: float, progress: Percentage,
    rng: np.random.Generator, work: float,
) -> tuple[list[Cell], float]:  # fmt: skip
    """Cut cells until no cell sticks out too far or a limit is reached; also return the remaining work."""
    while True:
        cells = _measured(cells, solid, tolerance)
        progress.report(_finished(cells, tolerance))
        out = sorted((cell for cell in cells if cell.is_out(tolerance)), key=lambda cell: -cell.bound)
        chosen = set[int]()
        for cell in out[: max(0, limit - len(cells))]:
            if work <= 0 or cell.bound < FARTHEST * out[0].bound:
                break
            chosen.add(id(cell))
            work -= _work(cell)
        if not chosen:
            return cells, work
        parts: list[Cell] = []
        for cell in cells:
            parts += (_cut(cell, solid, plate, rng) or [replace(cell, whole=True)]) if id(cell) in chosen else [cell]
        cells = parts


def _work(cell: Cell) -> int:
    planes, count = 2 * FACES + TURNS + 8, len(cell.triangles)
    return planes * (OVERHEAD + min(count, MANY)) + count


def _measured(cells: list[Cell], solid: Solid, tolerance: float) -> list[Cell]:
    """Measure all new cells: bound how far they stick out, and find the points that stick out most."""
    new = [k for k, cell in enumerate(cells) if not np.isfinite(cell.bound)]
    if new:
        excess = protrusions([cells[k].hull for k in new], solid, floor=tolerance, relative=ACCURACY)
        cells = list(cells)
        for at, k in enumerate(new):
            cells[k] = replace(
                cells[k], bound=float(excess.bounds[at]), deepest=excess.points[at], whole=not excess.found[at] > 0
            )
    return cells


def _cut(cell: Cell, solid: Solid, plate: float, rng: np.random.Generator) -> list[Cell] | None:
    """Cut a cell in two along the plane that leaves the parts sticking out least; None if no plane makes progress."""
    some = cell
    if len(cell.triangles) > MANY:
        with suppress(GeometryError):
            some = _cell(cell.triangles[rng.choice(len(cell.triangles), MANY, replace=False)], plate)
    whole, corners = _volume(some.hull), cell.triangles.reshape(-1, 3)
    options = []
    for plane in _planes(cell, solid, plate):
        if np.ptp(dot(corners, plane[0])) < plate:
            continue  # both halves would stick out about as far as the cell, and would be cut endlessly
        halves = _halves(some.triangles, plane, solid, plate)
        if halves is None:
            continue
        volumes = [_volume(half.hull) for half in halves]
        if solid.closed and min(volumes) < LEAST_SHARE * whole:
            continue
        options.append((plane, halves, sum(volumes) / whole))
    if not options:
        return None
    samples = _samples([half.hull for _, halves, _ in options for half in halves], rng)
    out = solid.signed_distances(samples)[0].reshape(len(options), -1).max(axis=1)
    shares = np.array([share for _, _, share in options])
    plane, halves, _ = options[int((shares + np.maximum(out, 0.0) / cell.bound).argmin())]
    return halves if some is cell else _halves(cell.triangles, plane, solid, plate)


def _halves(triangles: Floats, plane: tuple[Floats, float], solid: Solid, plate: float) -> list[Cell] | None:
    """Return the parts on the two sides of a plane; None if a part is empty or a line."""
    ones = np.ones(len(triangles))
    below, _, above, _ = cut(triangles, ones[:, None] * plane[0], ones * plane[1], solid.rounding)
    try:
        return [_cell(half, plate) for half in (below, above)]
    except GeometryError:
        return None


def _cell(triangles: Floats, plate: float) -> Cell:
    points = triangles.reshape(-1, 3)
    points = points[np.lexsort(points.T)]  # np.unique along an axis takes several times as long
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[1:] != points[:-1]).any(axis=1)
    return Cell(triangles, _hull(points[new], plate))


def _hull(points: Floats, plate: float) -> Polytope:
    """Compute the hull of points; for flat points, a plate whose sides are at a given distance from them."""
    try:
        return Polytope.from_points(points)
    except GeometryError:
        if len(points) == 0:
            raise
    thin = principal_axes(points)[-1]
    return Polytope.from_points(np.concatenate([points - plate * thin, points + plate * thin]))


def _planes(cell: Cell, solid: Solid, plate: float) -> list[tuple[Floats, float]]:
    """List planes that may cut off the protruding part, as unit normals and offsets."""
    deepest = cell.deepest
    _, nearest = solid.signed_distances(deepest[None])
    out = deepest - _foot(deepest, solid.triangles[nearest[0]])
    out /= max(float(lengths(out)), np.finfo(float).tiny)
    corners = cell.triangles.reshape(-1, 3)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    principal = principal_axes(corners)
    normals = [*np.eye(3), *principal]
    if out.any():
        across = np.cross(out, principal[np.abs(image(principal, out)).argmin()])
        across /= lengths(across)
        up = np.cross(out, across)
        angles = np.pi * np.arange(TURNS) / TURNS
        turns = zip(_elementary.cos(angles).tolist(), _elementary.sin(angles).tolist(), strict=True)
        normals = [*(cosine * across + sine * up for cosine, sine in turns), *normals]
    planes = [(n, float(dot(n, deepest))) for n in normals]
    planes += [(n, float(dot(n, middle))) for n in (*np.eye(3), *principal)]
    faces = unit_normals(cell.triangles)
    squared = squared_distances(np.broadcast_to(deepest, (len(faces), 3)), cell.triangles)
    chosen: list[Floats] = []
    for k in np.argsort(squared, kind="stable"):
        if len(chosen) == FACES:
            break
        if faces[k].any() and all(abs(dot(faces[k], other)) < 0.999 for other in chosen):
            chosen.append(faces[k])
            # For a surface that is not closed, the face itself is cut off, with a little of its neighbours.
            below = 0.0 if solid.closed else 2 * plate
            planes.append((faces[k], float(dot(faces[k], cell.triangles[k, 0])) - below))
    return planes


def _foot(point: Floats, triangle: Floats) -> Floats:
    """Find the point of a triangle that is nearest to a given point."""
    normal = unit_normals(triangle[None])[0]
    edges = np.roll(triangle, -1, axis=0) - triangle
    foot: Floats = point - dot(point - triangle[0], normal) * normal
    inward = (np.cross(normal, edges) * (foot - triangle)).sum(axis=1)
    if normal.any() and (inward >= 0).all():
        return foot
    along = np.clip(((point - triangle) * edges).sum(axis=1) / np.maximum((edges**2).sum(axis=1), 1e-300), 0, 1)
    feet = triangle + along[:, None] * edges
    nearest: Floats = feet[((point - feet) ** 2).sum(axis=1).argmin()]
    return nearest


@dataclass(frozen=True, eq=False)
class Joined:
    """The common hull of two cells, and the excess of its volume over the volumes of the cells' own hulls."""

    hull: Polytope
    gain: float


def _merged(cells: list[Cell], solid: Solid, tolerance: float, rng: np.random.Generator) -> list[Cell]:
    """Join pairs of cells whose common hull sticks out by no more than the tolerance, until no such pair remains."""
    cells, alive, new = list(cells), list[int](), list(range(len(cells)))
    possible = dict[tuple[int, int], Joined]()
    while True:
        possible |= _joinable(cells, alive, new, solid, tolerance, rng)
        alive += new
        taken, chosen = set[int](), list[tuple[int, int]]()
        for pair in sorted(possible, key=lambda pair: possible[pair].gain):
            if not taken & {*pair}:
                taken |= {*pair}
                chosen.append(pair)
        if not chosen:
            return [cells[k] for k in alive]
        hulls = [possible.pop(pair).hull for pair in chosen]
        bounds = protrusions(hulls, solid, floor=tolerance, relative=ACCURACY).bounds
        new, gone = [], set[int]()
        for pair, hull, bound in zip(chosen, hulls, bounds, strict=True):
            if bound <= tolerance:
                gone |= {*pair}
                new.append(len(cells))
                cells.append(Cell(np.concatenate([cells[k].triangles for k in pair]), hull, float(bound)))
        alive = [k for k in alive if k not in gone]
        possible = {pair: joined for pair, joined in possible.items() if not gone & {*pair}}


def _joinable(
    cells: list[Cell], old: list[int], new: list[int], solid: Solid, tolerance: float, rng: np.random.Generator
) -> dict[tuple[int, int], Joined]:
    """List the pairs of cells, at least one of them new, whose common hull was not found to stick out too far."""
    joins = dict[tuple[int, int], Joined]()
    within = np.array([k for k in (*old, *new) if cells[k].bound <= tolerance], dtype=np.int64)
    if len(within) == 0:
        return joins
    low, high = (np.array([f(cells[k].hull.vertices, axis=0) for k in within]) for f in (np.min, np.max))
    for at in np.flatnonzero(np.isin(within, new)):
        apart = np.maximum(low[:at] - high[at], low[at] - high[:at]).max(axis=1, initial=-np.inf)
        for other in within[:at][apart <= tolerance]:
            pair = int(other), int(within[at])
            hulls = [cells[k].hull for k in pair]
            try:
                hull = Polytope.from_points(np.concatenate([hull.vertices for hull in hulls]))
            except GeometryError:
                continue  # for example two plates in one plane, whose thickness is only rounding
            joins[pair] = Joined(hull, _volume(hull) - sum(map(_volume, hulls)))
    if joins:
        samples = _samples([joined.hull for joined in joins.values()], rng)
        height = solid.signed_distances(samples)[0].reshape(len(joins), -1).max(axis=1)
        joins = {pair: joined for (pair, joined), out in zip(joins.items(), height, strict=True) if out <= tolerance}
    return joins


def _samples(hulls: list[Polytope], rng: np.random.Generator) -> Floats:
    """Draw random points of the hulls' surfaces, the same number for each hull."""
    chosen = np.empty((len(hulls), SAMPLES, 3, 3))
    for k, hull in enumerate(hulls):
        corners, normals = _faces(hull)
        area = np.cumsum(lengths(normals))
        chosen[k] = corners[np.searchsorted(area, area[-1] * rng.random(SAMPLES))]
    shares = rng.dirichlet(np.ones(3), (len(hulls), SAMPLES))
    return product(shares[..., None, :], chosen).reshape(-1, 3)


def _volume(hull: Polytope) -> float:
    corners, normals = _faces(hull)
    return abs(float(dot(corners[:, 0] - hull.vertices.mean(axis=0), normals).sum() / 6))


def _faces(hull: Polytope) -> tuple[Floats, Floats]:
    """Return the corners of a hull's triangles, and the normals of the triangles."""
    corners = hull.vertices[hull.simplices]
    return corners, normals_of(corners)
