"""Prove bounds on how far convex pieces stick out of a mesh, by branch and bound over the pieces' surfaces."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from loewner._base import _elementary
from loewner._base._kept import kept
from loewner._base._matrices import dot, lengths, product, slices
from loewner._base._validate import Bools, Floats, Ints
from loewner._base._workspaces import workspace
from loewner._kernels.codes import UNCOUNTED
from loewner._native import entries
from loewner.ellipsoids.polytopes import Polytope
from loewner.meshes.triangles import FramedTree, cut, framed, halved, longest_edges, squared_distances, unit_normals

# The search ends when the bound exceeds the largest value found by at most RELATIVE of this value, or ABSOLUTE of the
# diagonal of the mesh's box.
RELATIVE, ABSOLUTE = 0.01, 1e-4

# Rounding errors of distances and heights are below ROUNDING times the diagonal plus COORDINATES times the largest
# coordinate.
ROUNDING = 1e-12  # certified.md B44
COORDINATES = 1e-14

# Limits on the number of cells. After WORK cells, the current bound is returned. A step examines at most AT_ONCE cells.
# If no point was found to stick out, the first WORK_ON_NOTHING cells are examined down to rounding errors.
WORK, AT_ONCE, WORK_ON_NOTHING = 400_000, 8192, 100_000

# A cell is cut along the edges of the triangle in which it lies, unless the cell's edges are COARSE times as long as
# the triangle's.
COARSE = 4.0

# The number of planes that `heights_above` takes is a multiple of this number.
PLANES = 8

# The triangles within reach of a cube are tested if the cube is no larger than this share of the diagonal.
LARGEST_LOOKED_INTO = 0.1

# Triangles face one half-space if the products of their normals with one direction are at least FACING. The search for
# this direction takes FACING_STEPS steps.
FACING, FACING_STEPS = 1e-6, 6

# Barycentric coordinates of the points at which triangles are tested from both sides, and the distance of the tests
# from the triangle, as a share of the diagonal.
SEEN_AT = np.array([[1, 1, 1], [2.4, 0.3, 0.3], [0.3, 2.4, 0.3], [0.3, 0.3, 2.4]]) / 3
LOOKED_ASIDE = 1e-7

# Number of points in one call of a kernel; interrupts are noticed between calls.
CHUNK = 16_384


class Solid:
    """A triangle mesh, and distances from it: from the solid if the mesh is closed, and otherwise from the surface.

    Parameters
    ----------
    triangles : ndarray, shape (t, 3, 3)
        Corners of the triangles; in a closed mesh, counter-clockwise when seen from outside.
    closed : bool
        Whether the mesh has an inside, which consists of all points with a nonzero winding number.
    size : float, optional
        Reference length in metres; the default is the diagonal of the mesh's bounding box.

    Notes
    -----
    `rounding` bounds the errors of distances.
    """

    def __init__(self, triangles: Floats, closed: bool, size: float | None = None) -> None:
        self.triangles, self.closed = triangles, closed
        self.normals = unit_normals(triangles)
        corners = triangles.reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.size = float(lengths(high - low)) if size is None else size
        self.rounding = ROUNDING * self.size + COORDINATES * float(np.abs(corners).max())
        self._tree = FramedTree.of(corners)
        self._normals = self.normals[self._tree.numbers]

    def _chunks(self, points: Floats) -> Iterator[tuple[slice, tuple[int, float, Floats]]]:
        """Yield slices of points with arguments for kernels: the tree, a bound on lengths, and the points in its frame.

        The bound is a sum of lengths that is at least as large as any coordinate.
        """
        for some in slices(len(points), CHUNK):
            within = framed(points[some], self._tree.origin, self._tree.scale)
            yield some, (self._tree.table.ctypes.data, 3.0 * (1.0 + float(np.abs(within).max(initial=0.0))), within)

    def signed_distances(self, points: Floats) -> tuple[Floats, Ints]:
        """Compute the distances from points to the surface, negative inside, and the triangle nearest to each point."""
        distances, places = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        memory = workspace(entries.points_memory())
        for some, chunk in self._chunks(points):
            entries.nearest_triangles(*chunk, distances[some], places[some], memory)
        distances /= self._tree.scale
        if self.closed:
            clear = np.flatnonzero(distances > self.rounding)  # on the surface, either sign is valid
            distances[clear[self.winding_numbers(points[clear]) != 0]] *= -1
        return distances, self._tree.numbers[places]

    def face_one_way(self, points: Floats, reach: Floats, outside: Bools) -> Bools:
        """Return, for each point, whether the outward normals of all triangles within `reach` lie in one half-space.

        A surface that is not closed has two outer sides. If the point and its surroundings are known to be `outside`,
        only the side that faces the point counts.
        """
        answers = np.zeros(len(points), dtype=bool)
        if len(points) == 0 or self.closed and not self._turned_alike:
            return answers
        tested = np.arange(len(points)) if self.closed else np.flatnonzero(outside)
        far, one_way = (reach[tested] + self.rounding) * self._tree.scale, np.empty(len(tested), dtype=bool)
        memory, near = workspace(entries.points_memory()), np.empty((len(self.triangles), 3))
        options = self._normals, not self.closed, FACING, FACING_STEPS
        for some, chunk in self._chunks(points[tested]):
            entries.facing_one_way(*chunk, far[some], *options, one_way[some], near, memory)
        answers[tested] = one_way
        return answers

    @kept
    def _turned_alike(self) -> bool:
        """Return whether each triangle has the solid on its inner side, judged by four of its points.

        Where a cavity extends beyond its part, a triangle may have the solid on its outer side.
        """
        seen = self.normals.any(axis=1)
        points = product(SEEN_AT, self.triangles[seen])
        step = np.repeat(self.normals[seen], len(SEEN_AT), axis=0) * max(LOOKED_ASIDE * self.size, 16 * self.rounding)
        outer, inner = (self.winding_numbers(points.reshape(-1, 3) + side * step) for side in (1, -1))
        return bool(((outer >= 0) & (inner >= 1)).all())

    def winding_numbers(self, points: Floats) -> Ints:
        """Compute the winding number of a closed mesh around each point."""
        numbers = np.empty(len(points), dtype=np.int64)
        memory = workspace(entries.points_memory())
        for some, chunk in self._chunks(points):
            entries.winding_numbers(*chunk, numbers[some], memory)
        for untold in np.flatnonzero(numbers == UNCOUNTED):
            numbers[untold] = self._turns(points[untold])
        return numbers

    def _turns(self, point: Floats) -> int:
        """Compute winding numbers as the sum of the triangles' solid angles."""
        arms = self.triangles - point
        length = lengths(arms)
        a, b, c = arms.transpose(1, 0, 2)
        la, lb, lc = length.T
        volume = dot(a, np.cross(b, c))
        dots = [dot(*pair) for pair in ((a, b), (b, c), (c, a))]
        angles = 2 * _elementary.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
        return round(float(angles.sum()) / (4 * np.pi))


@dataclass(frozen=True)
class Protrusions:
    """How far convex pieces stick out of a solid.

    Attributes
    ----------
    bounds : ndarray, shape (k,)
        Proven upper bound for each piece, in metres.
    found : ndarray, shape (k,)
        Distance of the farthest point found on each piece, in metres; a lower bound.
    points : ndarray, shape (k, 3)
        The farthest point found; NaN if nothing sticks out.
    """

    bounds: Floats
    found: Floats
    points: Floats


def protrusions(
    hulls: list[Polytope], solid: Solid, *, floor: float = 0.0, relative: float = RELATIVE, together: bool = False
) -> Protrusions:
    """Bound how far convex pieces stick out of a solid.

    Parameters
    ----------
    hulls : list of Polytope
    solid : Solid
    floor : float
        A piece is not examined further once its bound is below this length.
    relative : float
        How close the bound must come to the distance found, as a share of that distance.
    together : bool
        Whether only the greatest protrusion of all pieces matters; the search can then end earlier.

    Notes
    -----
    The distances of two points from the solid differ by at most the distance between the points. One bound for a
    triangle of a piece's boundary is therefore the distance of the triangle's center, negative inside, plus the
    triangle's radius about the center. The distance to a single triangle of the mesh is a convex function, so the
    largest of its values at the corners is a second bound. The smaller bound counts. A triangle whose bound is above
    the required bound is halved, or cut along the edges of the mesh triangle in which it nearly lies. The cut settles
    the part in the mesh triangle.

    If a piece fills a cavity or a groove of the mesh, the distance may have a local maximum inside the piece that
    exceeds all values on its boundary. The directions from the nearest points of the surface to such a maximum do not
    all lie in one open half-space. Each direction is a combination of the outward normals of the triangles at its
    nearest point.

    The inside of each piece is searched cube by cube. A cube contains no such maximum if the outward normals of all
    triangles that may be nearest to one of its points lie in one open half-space. For any other cube, the bound from
    the distance of its center is used, or the cube is divided. If the solid is on the outer side of some triangle of
    the mesh, for instance where a cavity extends beyond its part, no cube can be ruled out in this way.
    """
    cells = np.concatenate([hull.vertices[hull.simplices] for hull in hulls])
    owner = np.repeat(np.arange(len(hulls)), [len(hull.simplices) for hull in hulls])
    bounds, lower_bounds = np.zeros(len(hulls)), np.zeros(len(hulls))
    points = np.full((len(hulls), 3), np.nan)
    rounding = solid.rounding

    def targets(work: int) -> Floats:
        best = np.full(len(hulls), lower_bounds.max()) if together else lower_bounds
        nothing = best.max() <= rounding and floor == 0 and work < WORK_ON_NOTHING
        accuracy = 2 * rounding if nothing else ABSOLUTE * solid.size
        if floor > 0:
            accuracy = max(2 * rounding, min(accuracy, RELATIVE * floor))
        # The search must decide whether a piece is below the floor, however close the piece is to the floor. How far a
        # piece is above the floor does not matter.
        near = np.where(best > floor, best * (1 + relative), best)
        return np.maximum(floor, np.maximum(near, best + accuracy))

    search = _Search(hulls, solid, lower_bounds, points, bounds, targets)
    search.go(cells, owner, np.full(len(cells), np.inf), search.boundary)
    cubes = np.array([[*(box := hull.vertices).min(axis=0), *np.ptp(box, axis=0)] for hull in hulls])
    middles, half = cubes[:, :3] + cubes[:, 3:] / 2, cubes[:, 3:].max(axis=1, keepdims=True) / 2
    search.go(np.hstack([middles, half]), np.arange(len(hulls)), np.full(len(hulls), np.inf), search.inside)
    return Protrusions(np.where(bounds <= 4 * rounding, 0.0, bounds), lower_bounds, points)


def protrusion_of_hulls(parts: list[Floats], hulls: list[Polytope]) -> float:
    """Bound how far the hulls of closed parts stick out, each measured against its own part.

    Parts that touch or contain one another would interfere, so each part is placed far from the others.
    """
    size = max(float(lengths(np.ptp(hull.vertices, axis=0))) for hull in hulls)
    edge = next(count for count in itertools.count(1) if count**3 >= len(parts))
    places = 3 * size * np.stack(np.unravel_index(np.arange(len(parts)), (edge, edge, edge)), axis=1)
    shifts = places - [hull.vertices.mean(axis=0) for hull in hulls]
    solid = Solid(np.concatenate([part + shift for part, shift in zip(parts, shifts, strict=True)]), True, size)
    moved = [
        replace(hull, vertices=hull.vertices + shift, offsets=hull.offsets + dot(hull.normals, shift))
        for hull, shift in zip(hulls, shifts, strict=True)
    ]
    return float(protrusions(moved, solid, together=True).bounds.max())


@dataclass
class _Search:
    """Branch and bound over cells, which are triangles or cubes, with the values found and the bounds proven."""

    hulls: list[Polytope]
    solid: Solid
    found: Floats
    points: Floats
    bounds: Floats
    targets: Callable[[int], Floats]
    planes: dict[int, Floats] = field(default_factory=dict)

    def go(self, cells: Floats, owner: Ints, limit: Floats, look: Callable[..., tuple[Floats, Ints, Floats]]) -> None:
        """Examine cells, beginning with the greatest bounds, and then the parts of unsettled cells.

        `limit` is the known bound of each cell. `look` takes cells, owners, limits and the work so far, and returns the
        parts of unsettled cells, the index of each part's cell, and the bounds of all cells.
        """
        work = 0
        while len(cells) and work < WORK:
            now, later = np.arange(len(cells)), np.empty(0, dtype=np.int64)
            if len(cells) > AT_ONCE:
                order = np.argsort(-limit, kind="stable")
                now, later = order[:AT_ONCE], order[AT_ONCE:]
            work += len(now)
            parts, origin, bound = look(cells[now], owner[now], limit[now], work)
            # Values found meanwhile may have settled waiting cells.
            over = limit[later] <= self.targets(work)[owner[later]]
            np.maximum.at(self.bounds, owner[later[over]], limit[later[over]])
            later = later[~over]
            cells = np.concatenate([parts, cells[later]])
            limit = np.concatenate([bound[origin], limit[later]])
            owner = np.concatenate([owner[now][origin], owner[later]])
        np.maximum.at(self.bounds, owner, limit)

    def _planes(self, k: int) -> Floats:
        """Return a piece's planes for `heights_above`, repeating some to make their number a multiple of eight."""
        if k not in self.planes:
            hull = self.hulls[k]
            rows = np.column_stack([hull.normals, hull.offsets])
            self.planes[k] = np.resize(rows, (-(-len(rows) // PLANES) * PLANES, 4)).T.ravel()
        return self.planes[k]

    def _note(self, points: Floats, signed: Floats, owner: Ints) -> None:
        """Keep the farthest known point of each piece."""
        for k in np.unique(owner[signed > self.found[owner]]):
            mine = np.flatnonzero(owner == k)
            at = mine[signed[mine].argmax()]
            self.found[k], self.points[k] = signed[at], points[at]

    def boundary(self, cells: Floats, owner: Ints, limit: Floats, work: int) -> tuple[Floats, Ints, Floats]:
        """Examine the triangles of the pieces' boundaries."""
        solid = self.solid
        centers = cells.mean(axis=1)
        signed, nearest = solid.signed_distances(centers)
        self._note(centers, signed, owner)
        radius = lengths(cells - centers[:, None]).max(axis=1)
        far = squared_distances(cells.reshape(-1, 3), solid.triangles[np.repeat(nearest, 3)]).reshape(-1, 3)
        bound = np.minimum(np.maximum(signed + radius, 0.0), np.sqrt(far.max(axis=1))) + solid.rounding
        bound = np.minimum(bound, limit)
        target = self.targets(work)[owner]
        rest = np.flatnonzero(bound > target)
        np.maximum.at(self.bounds, owner, np.where(bound > target, 0.0, bound))
        parts, origin, height = _smaller(cells[rest], nearest[rest], target[rest], solid)
        np.maximum.at(self.bounds, owner[rest], height)
        return parts, rest[origin], bound

    def inside(self, cells: Floats, owner: Ints, limit: Floats, work: int) -> tuple[Floats, Ints, Floats]:
        """Examine cubes, given by centers and half edges, that may contain local maxima of distance inside pieces."""
        middles, half = cells[:, :3], cells[:, 3]
        radius = np.sqrt(3.0) * half
        height = np.empty(len(cells))
        for k in np.unique(owner):
            mine = np.flatnonzero(owner == k)
            own_heights = np.empty(len(mine))
            entries.heights_above(self._planes(k), middles[mine], radius[mine], own_heights)
            height[mine] = own_heights
        signed = np.full(len(cells), -np.inf)
        met = np.flatnonzero(height < radius)
        signed[met] = self.solid.signed_distances(middles[met])[0]
        self._note(middles[height <= 0], signed[height <= 0], owner[height <= 0])
        bound = np.minimum(np.maximum(signed + radius, 0.0) + self.solid.rounding, limit)
        target = self.targets(work)[owner]
        low = (bound <= target) & (height < radius)
        np.maximum.at(self.bounds, owner[low], bound[low])
        rest = np.flatnonzero((bound > target) & (height < radius))
        small = rest[radius[rest] <= self.solid.size * LARGEST_LOOKED_INTO]
        far, outside = signed[small] + 2 * radius[small], signed[small] > radius[small]
        rest = np.setdiff1d(rest, small[self.solid.face_one_way(middles[small], far, outside)])
        steps = np.array([[x, y, z, 0] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
        parts = np.hstack([middles, half[:, None] / 2])[rest, None] + steps * half[rest, None, None]
        return parts.reshape(-1, 4), np.repeat(rest, 8), bound


def _smaller(cells: Floats, nearest: Ints, target: Floats, solid: Solid) -> tuple[Floats, Ints, Floats]:
    """Return parts of cells, the cell from which each part comes, and a bound for the settled part of each cell."""
    length, edge = longest_edges(cells)
    mesh, normals = solid.triangles[nearest], solid.normals[nearest]
    height = np.abs(dot(cells - mesh[:, :1], normals[:, None])).max(axis=1) + solid.rounding
    flat = normals.any(axis=1) & (height <= target) & (length <= COARSE * longest_edges(mesh)[0])
    flat &= _over(cells.mean(axis=1), mesh, normals)
    parts, origins = [], []
    inside, of = cells[flat], np.flatnonzero(flat)
    for k in range(3):
        a, b = mesh[of, k], mesh[of, (k + 1) % 3]
        outward = np.cross(b - a, normals[of])
        outward /= lengths(outward)[:, None]
        inside, within, outside, beyond = cut(inside, outward, dot(outward, a), solid.rounding)
        parts.append(outside)
        origins.append(of[beyond])
        of = of[within]
    # A cell perpendicular to the triangle may lie in the plane that cuts along an edge, in which case no part is
    # inside.
    cut_up = np.zeros(len(cells), dtype=bool)
    cut_up[of] = True
    keep = [cut_up[origin] for origin in origins]
    whole = np.flatnonzero(~cut_up)
    parts = [part[k] for part, k in zip(parts, keep, strict=True)] + [halved(cells[whole], edge[whole])]
    origins = [origin[k] for origin, k in zip(origins, keep, strict=True)] + [whole, whole]
    # The distance to one triangle is convex, and therefore greatest at a corner of the part inside.
    far = squared_distances(inside.reshape(-1, 3), solid.triangles[np.repeat(nearest[of], 3)])
    bound = np.zeros(len(cells))
    np.maximum.at(bound, of, np.sqrt(far.reshape(-1, 3).max(axis=1)) + solid.rounding)
    return np.concatenate(parts), np.concatenate(origins), bound


def _over(points: Floats, triangles: Floats, normals: Floats) -> Bools:
    """Return whether points lie above the interiors of triangles."""
    above = np.ones(len(points), dtype=bool)
    for k in range(3):
        edge = triangles[:, (k + 1) % 3] - triangles[:, k]
        above &= dot(np.cross(normals, edge), points - triangles[:, k]) > 0
    return above
