"""Prove that convex elements contain a whole body, including its interior, or find an uncovered point.

docs/containment.md defines the three outcomes and derives the margins.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from loewner._base._matrices import dot, least_of, lengths, normals_of
from loewner._base._validate import Bools, Floats, Ints, Progress, silent
from loewner._kernels import columns
from loewner._kernels.tolerances import FACE_WIDTH
from loewner.bodies.elements import HEIGHT_ROUNDINGS, Elements
from loewner.bodies.kinds import CURVED, ROUND, ball, inradius
from loewner.bodies.pack import Packed
from loewner.bodies.triangulated import of_piece
from loewner.ellipsoids.polytopes import Polytope
from loewner.meshes.coverage import CoverReport
from loewner.meshes.protrusion import Solid, protrusions
from loewner.meshes.triangles import halved

# By default, cells of the body are halved until they are as small as this share of the body's diagonal.
RESOLUTION = 1e-4

# Bound on the rounding of a cell's corners, relative to the largest coordinate. There are few halvings, and each rounds
# twice.
CELL_ROUNDINGS = 256 * 2.0**-53

# At most WORK cells are halved at a time. At most AT_ONCE pairs of a cell and an element are formed at a time, so that
# the arrays stay in the processor's cache. The search for a hole smaller than the tolerance halves the most promising
# LOOKED_INTO cells, LOOKS times.
WORK, AT_ONCE, LOOKED_INTO, LOOKS = 200_000, 100_000, 128, 60

# The search for the largest distance ends when the upper bound exceeds the largest distance found by at most this
# share.
RELATIVE = 0.01

# Triangles that are partly inside other pieces are halved this many times.
TRIMS = 8

# Circumscribed polytopes are enlarged by this factor, for the rounding of their corners.
OUTWARD = 1 + 1e-12

# Number of subdivisions of the triangulated ball, whose corners are used as trial points on curved elements.
DIVISIONS = 2

# One search for the largest protrusion takes elements with about this many triangles in all.
FACES = 100_000

OCTANTS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


class _Part(NamedTuple):
    """A piece of the body: the triangles of its boundary or, for a curved piece, of a polytope around it."""

    triangles: Floats
    solid: bool  # the piece includes its inside
    convex: bool
    radius: float  # radius of the ball around each point of the triangles
    slack: float  # how far the piece may stick out of its triangles
    gap: float = 0.0  # how far the triangles may stick out of the piece
    inner: Floats | None = None  # triangles in a curved piece, with corners on its surface


class Target:
    """A body to be covered, as triangles and solids.

    Parameters
    ----------
    packed : Packed
        The pieces of one body.
    """

    def __init__(self, packed: Packed) -> None:
        self.packed = packed
        self.parts = [_part(packed, i) for i in range(len(packed.layout))]
        self.triangles, self.owner = self.surface([part.triangles for part in self.parts])
        self.curved = np.array([part.inner is not None for part in self.parts])
        # The triangles in `own`, whose areas are measured, contain only points of the body.
        self.own = self.surface([part.triangles if part.inner is None else part.inner for part in self.parts])
        self.radius, self.slack, self.gap = (
            np.array([getattr(part, name) for part in self.parts]) for name in ("radius", "slack", "gap")
        )
        corners = self.triangles.reshape(-1, 3)
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        self.size = float(lengths(self.high - self.low)) + 2.0 * float(self.radius.max())
        self.reach = float(np.abs(corners).max())
        convex = [part.triangles for part in self.parts if part.convex]
        self.solids = [Solid(np.concatenate(convex), True)] if convex else []
        self.solids += [Solid(part.triangles, True) for part in self.parts if part.solid and not part.convex]
        closed = all(part.solid for part in self.parts)
        self.whole = self.solids[0] if closed and len(self.solids) == 1 else Solid(self.triangles, closed)
        self.boundary = self._boundary()
        self.open = [Solid(part.triangles, False) for part in self.parts if not part.solid]

    def cube(self) -> Floats:
        """Return the center and half edge of a cube around the body."""
        return np.append(self.low / 2 + self.high / 2, float((self.high - self.low).max()) / 2 * (1 + 1e-9))

    @staticmethod
    def surface(of_parts: list[Floats]) -> tuple[Floats, Ints]:
        """Join the triangles of parts, and number them by part."""
        return np.concatenate(of_parts), np.repeat(np.arange(len(of_parts)), [len(part) for part in of_parts])

    def below(self, points: Floats) -> Floats:
        """Compute lower bounds on the distances of points from the body; the bounds are negative inside a solid."""
        return np.asarray(_least(points, [*self.solids, *self.open]) - self.radius.max())

    def holds(self, points: Floats) -> Bools:
        """Return whether points are certainly in a solid of the body."""
        if not self.solids:
            return np.zeros(len(points), dtype=bool)
        clear = 4 * max(solid.rounding for solid in self.solids) + 2 * float(self.gap.max())
        return np.asarray(self.depths(points) < -clear)

    def depths(self, points: Floats) -> Floats:
        """Compute lower bounds on the distances of points from all solids; the bounds are negative inside a solid."""
        return _least(points, self.solids)

    def far(self, points: Floats) -> Floats:
        """Compute upper bounds on the distances of points from the body; they are negative well inside the body."""
        distances = self.boundary.signed_distances(points)[0]
        if self.boundary is not self.whole and self.whole.closed:
            clear = np.flatnonzero(distances > self.whole.rounding)
            distances[clear[self.whole.winding_numbers(points[clear]) != 0]] *= -1
        return np.asarray(distances + self.whole.rounding - self.radius.min() + self.gap.max())

    def _boundary(self) -> Solid:
        """Drop parts of triangles that are inside another convex piece, and so are not on the body's boundary."""
        convex = [k for k, part in enumerate(self.parts) if part.convex]
        if len(convex) < 2 or not self.whole.closed:
            return self.whole
        cells, owner = self.triangles, self.owner
        boxes = [(part.triangles.min(axis=(0, 1)), part.triangles.max(axis=(0, 1))) for part in self.parts]
        pieces = {k: Solid(self.parts[k].triangles, True) for k in convex}
        rest = []
        for step in range(TRIMS + 1):
            inside, meets = np.zeros(len(cells), dtype=bool), np.zeros(len(cells), dtype=bool)
            for k in convex:
                low, high = cells.min(axis=1), cells.max(axis=1)
                near = (owner != k) & ~inside & (high > boxes[k][0]).all(axis=1) & (low < boxes[k][1]).all(axis=1)
                near_cells = np.flatnonzero(near)
                if len(near_cells) == 0:
                    continue
                corners, back = np.unique(cells[near_cells].reshape(-1, 3), axis=0, return_inverse=True)
                slack = 2 * (pieces[k].rounding + self.parts[k].slack)
                deep = (pieces[k].signed_distances(corners)[0] < -slack)[back.reshape(-1, 3)]
                inside[near_cells[deep.all(axis=1)]] = True
                meets[near_cells[deep.any(axis=1)]] = True
            split = meets & ~inside
            if step == TRIMS or len(cells) > WORK:
                split[:] = False
            rest.append(cells[~inside & ~split])
            edges = cells[split] - np.roll(cells[split], -1, axis=1)
            cells, owner = halved(cells[split], dot(edges, edges).argmax(axis=1)), np.tile(owner[split], 2)
            if len(cells) == 0:
                break
        kept = np.concatenate(rest)
        return Solid(kept, False) if len(kept) < len(self.triangles) or len(rest) > 1 else self.whole


def _least(points: Floats, surfaces: list[Solid]) -> Floats:
    """Compute lower bounds on the distances of points from the nearest surface; infinite if there are no surfaces."""
    bounds = np.full(len(points), np.inf)
    for surface in surfaces:
        bounds = np.minimum(bounds, surface.signed_distances(points)[0] - surface.rounding)
    return bounds


def _part(packed: Packed, i: int) -> _Part:
    kind = int(packed.layout[i, columns.KIND])
    vertices, triangles = of_piece(packed, i)
    if kind <= columns.SURFACE:
        return _Part(vertices[triangles], kind == columns.SOLID, False, float(packed.frames[i, 0]), 0.0)
    if kind == columns.POLYTOPE:
        return _Part(vertices[triangles], True, True, 0.0, _stray(vertices, packed.planes_of(i)))
    hull, center, shrink = _around(packed, i)
    slack = _stray(hull.vertices, np.column_stack([hull.normals, hull.offsets]))
    gap = (1 - shrink) * float(lengths(hull.vertices - center).max())
    inner = center + (vertices - center) / OUTWARD
    return _Part(hull.vertices[hull.simplices], True, True, 0.0, slack, gap, inner[triangles])


def _stray(hull_points: Floats, planes: Floats) -> float:
    """Bound how far the hull of points sticks out of its own triangles, which are in the faces only up to rounding.

    Let c be the middle of the hull, h the height of a triangle's plane above c, and w the width within which
    `polytopes` accepts the corners of a face. Seen from c, a point y of the hull is beyond the plane by at most w |y -
    c| / h.
    """
    middle = hull_points.mean(axis=0)
    reach = float(lengths(hull_points - middle).max())
    over = float((planes[:, 3] - planes[:, :3] @ middle).min())
    return (2 * FACE_WIDTH * reach + HEIGHT_ROUNDINGS * float(np.abs(hull_points).max())) * reach / over


def _around(packed: Packed, i: int) -> tuple[Polytope, Floats, float]:
    """Make a polytope around a curved piece, and the center and factor of a scaling that moves it into the piece."""
    kind, frame = CURVED[int(packed.layout[i, columns.KIND])], packed.frames[i]
    radius, center, factor = frame[0], frame[1:4], frame[4:].reshape(3, 3)
    unit, _ = kind.mesh()
    if kind.core is not None:
        half, least = kind.core * factor[:, 2], inradius()
        around = unit * (radius * OUTWARD / least)
        return Polytope.from_points(np.concatenate([center + half + around, center - half + around])), center, least
    unit = OUTWARD * unit / (kind.inradii or inradius())
    return Polytope.from_points(center + unit @ factor.T), center, float(kind.share(unit).min())


class _Cells(NamedTuple):
    """Triangles or cubes, and all pairs of a cell and an element that may meet, in the order of the cells."""

    shape: Floats  # (k, 3, 3) corners of triangles, or (k, 4) centers and half edges of cubes
    owner: Ints
    area: Floats
    cell: Ints
    element: Ints

    def take(self, keep: Bools, pairs: Bools | None = None) -> _Cells:
        """Select cells and their pairs; `pairs` marks the pairs to keep, by default all."""
        place = np.cumsum(keep) - 1
        pairs = keep[self.cell] if pairs is None else pairs & keep[self.cell]
        return _Cells(self.shape[keep], self.owner[keep], self.area[keep], place[self.cell[pairs]], self.element[pairs])

    def middles(self) -> tuple[Floats, Floats]:
        """Return the centers and radii of balls that contain the cells."""
        if self.shape.ndim == 2:
            return self.shape[:, :3], np.sqrt(3.0) * (1 + 1e-12) * self.shape[:, 3]
        middle = self.shape.mean(axis=1)
        return middle, lengths(self.shape - middle[:, None]).max(axis=1) * (1 + 1e-12)

    def corner(self, cells: Ints, k: int) -> Floats:
        if self.shape.ndim == 2:
            return np.asarray(self.shape[cells, :3] + self.shape[cells, 3:] * OCTANTS[k])
        return np.asarray(self.shape[cells, k])

    def parts(self) -> _Cells:
        """Halve triangles across their longest edges, and cubes in all three directions."""
        n = len(self.shape)
        if self.shape.ndim == 2:
            half = self.shape[:, 3:] / 2
            shapes = np.concatenate([np.hstack([self.shape[:, :3] + half * way, half]) for way in OCTANTS])
            count = 8
        else:
            edges = self.shape - np.roll(self.shape, -1, axis=1)
            shapes, count = halved(self.shape, dot(edges, edges).argmax(axis=1)), 2
        cell = np.concatenate([self.cell + k * n for k in range(count)])
        owner, area, element = self.owner, self.area / count, self.element
        return _Cells(shapes, np.tile(owner, count), np.tile(area, count), cell, np.tile(element, count))

    @classmethod
    def joined(cls, some_cells: list[_Cells]) -> _Cells:
        first = np.cumsum([0, *(len(cells.shape) for cells in some_cells)])
        shifted = [cells._replace(cell=cells.cell + k) for cells, k in zip(some_cells, first, strict=False)]
        return cls(*map(np.concatenate, zip(*shifted, strict=True)))


def _left(cells: list[_Cells]) -> _Cells | None:
    """Join lists of unsettled cells; return None if all lists are empty."""
    left = [some for some in cells if len(some.shape)]
    return _Cells.joined(left) if left else None


class _Proof:
    """The search over the cells of one body and one model."""

    def __init__(self, target: Target, model: Elements, tolerance: float) -> None:
        self.target, self.model, self.tolerance = target, model, tolerance
        ends = np.abs(model.center).max(initial=0.0) if len(model) else 0.0
        # Bound on the rounding of the cells' corners, which are rounded at each halving.
        self.cells = CELL_ROUNDINGS * (target.reach + float(ends))
        self.witness: Floats | None = None
        self.deepest = 0.0
        self.outside: list[Floats] = []  # points and, in a fourth column, the radii of balls about them

    def within(self, points: Floats, element: Ints, radius: float) -> Bools:
        """Return whether balls of one radius about stored points are in the given elements."""
        model = self.model
        margin = np.where(model.exact[element] & (radius == 0), 0.0, model.rounding[element])
        return np.asarray(model.heights(points, element) <= -(margin + radius))

    def wholes(self) -> Bools:
        """Find the parts that equal an element, or that have all corners in one element."""
        target, model = self.target, self.model
        packed, is_whole = target.packed, np.zeros(len(target.parts), dtype=bool)
        kinds, frames = packed.layout[:, columns.KIND], packed.frames
        for i, part in enumerate(target.parts):
            kind, left = int(kinds[i]), np.arange(len(model))
            equal = (model.kind == kind) & (kind > columns.POLYTOPE)
            equal &= (model.radius == frames[i, 0]) & (model.center == frames[i, 1:4]).all(axis=1)
            equal &= (model.factor.reshape(-1, 9) == frames[i, 4:]).all(axis=1)
            if kind in ROUND:
                far = frames[i, 4:].reshape(3, 3)[:, 2] * (kind == columns.SEGMENT)
                corners, radius = frames[i, 1:4] + np.array([far, -far]), float(frames[i, 0]) + self.cells
            elif kind > columns.POLYTOPE:
                corners, radius = part.triangles.reshape(-1, 3), part.slack
            else:
                corners, radius = packed.points_of(i), part.radius
                equal = np.array([np.array_equal(corners, model.hulls[j].vertices) if j in model.hulls else False
                                  for j in range(len(model))])  # fmt: skip
            left = left[self.within(np.broadcast_to(corners[0], (len(left), 3)), left, radius)]
            is_whole[i] = (part.radius == 0.0 and bool(equal.any())) or any(
                self.within(corners, np.full(len(corners), element), radius).all() for element in left.tolist()
            )
        return is_whole

    def look(self, cells: _Cells, first: bool, inside: bool) -> tuple[_Cells, Floats, Bools, Bools, Bools]:
        """Examine cells.

        Returns
        -------
        cells : _Cells
            The remaining cells, which are in no single element, paired with the elements that they may meet. With
            `inside`, a cell is paired with every element whose height may be the least at some point of the cell.
        height : ndarray
            The least height over the elements at each remaining cell's center.
        outside : ndarray of bool
            Which remaining cells are outside all elements.
        flush : ndarray of bool
            Which remaining cells are, up to rounding, in the boundary of an element; their parts then are as well.
        settled : ndarray of bool
            Which of the given cells are in one element.
        """
        target, model = self.target, self.model
        middle, reach = cells.middles()
        radius = np.zeros(len(middle)) if inside else target.radius[cells.owner]
        slack = np.zeros(len(middle)) if inside else target.slack[cells.owner]
        below = radius + slack
        c, e = cells.cell, cells.element
        height = model.heights(middle[c], e)
        margin = model.rounding[e] + self.cells
        meets = height <= (reach + radius)[c] + margin
        least = least_of(height, c, len(middle))
        outside = np.ones(len(middle), dtype=bool)
        outside[c[meets]] = False
        needed = margin
        if first:
            # The corners of the first cells are as stored, without the rounding of halvings.
            needed = np.where(model.exact[e] & (below == 0)[c], 0.0, model.rounding[e])
        # If a cell is in an element, the cell's center is in the element, too, up to rounding: both are convex.
        blur = margin + 2 * slack[c]
        left = np.flatnonzero(meets & (height <= blur))
        most = np.full(len(left), -np.inf)
        for k in range(8 if inside else 3):
            most = np.maximum(most, model.heights(cells.corner(c[left], k), e[left]) + below[c[left]])
            near = most <= blur[left]
            left, most = left[near], most[near]
        settled, flush = np.zeros(len(middle), dtype=bool), np.zeros(len(middle), dtype=bool)
        settled[c[left[most <= -needed[left]]]] = True
        # If a cell lies in the boundary of an element, the cell's center lies there as well.
        flush[c[left[height[left] >= -radius[c[left]] - 4 * blur[left]]]] = True
        rest = ~settled
        # In a hole, an element may have the least height at a point of a cell without meeting the cell.
        kept = height <= (least + 2 * reach)[c] + margin if inside else meets
        return cells.take(rest, kept), least[rest], outside[rest], flush[rest], settled

    def note(self, points: Floats, depth: Floats) -> None:
        """Keep the point with the greatest `depth` outside the model if it is deeper than the point kept so far."""
        if len(depth) == 0 or not depth.max() > self.deepest:
            return
        point, n = points[depth.argmax()], len(self.model)
        below = self.model.below(np.repeat(point[None], n, axis=0), np.arange(n)) - self.model.rounding
        if below.min() - self.cells > self.deepest:
            self.deepest, self.witness = float(below.min() - self.cells), point.copy()

    def paired(self, shape: Floats, owner: Ints, area: Floats) -> Iterator[_Cells]:
        """Pair cells with all elements, a limited number at a time."""
        count = len(self.model)
        each = max(1, AT_ONCE // count)
        for k in range(0, max(len(shape), 1), each):
            n = len(shape[k : k + each])
            cell, element = np.repeat(np.arange(n), count), np.tile(np.arange(count), n)
            yield _Cells(shape[k : k + each], owner[k : k + each], area[k : k + each], cell, element)

    def surface(
        self, triangles: Floats, owner: Ints, report: Progress, *, own: bool = True
    ) -> tuple[float, float, _Cells | None]:
        """Halve triangles that are in no single element.

        Parameters
        ----------
        triangles, owner : ndarray, shapes (t, 3, 3) and (t,)
        report : callable
            Receives the settled percentage of the area.
        own : bool
            Whether the points of the triangles belong to the body. If so, a point outside the model proves that the
            body is not covered.

        Returns
        -------
        covered, outside : float
            Areas that are proven to be inside the model, and outside the model.
        rest : _Cells or None
            Cells that are not settled.
        """
        covered, outside, area = 0.0, 0.0, lengths(normals_of(triangles)) / 2
        total = max(float(area.sum()), 1e-300)
        cells: Iterable[_Cells] = self.paired(triangles, owner, area)
        first, rest = True, list[_Cells]()
        while True:
            next_cells = []
            for some_cells in cells:
                open_cells, least, out, flush, settled = self.look(some_cells, first, inside=False)
                covered += float(some_cells.area[settled].sum())
                middle, reach = open_cells.middles()
                if own:
                    outside += float(open_cells.area[out].sum())
                    self.outside.append(np.column_stack([middle[out], self.target.radius[open_cells.owner[out]]]))
                    self.note(middle, least)
                    if first:
                        self._corners(open_cells)
                done = flush | (2 * reach <= self.tolerance) | (out & (not own))
                rest.append(open_cells.take(done & ~(out & own)))
                next_cells.append(open_cells.take(~done & ~out))
            first = False
            report(int(100 * min(1.0, (covered + outside) / total)), 100)
            halves = _Cells.joined(next_cells)
            if len(halves.shape) > WORK:
                rest.append(halves)
            if not 0 < len(halves.shape) <= WORK:
                return covered, outside, _left(rest)
            cells = [halves.parts()]

    def _corners(self, cells: _Cells) -> None:
        """Try the corners of stored triangles, because the deepest point is often a corner."""
        for k in range(3):
            points = cells.shape[:, k]
            heights = self.model.heights(points[cells.cell], cells.element)
            self.note(points, least_of(heights, cells.cell, len(points)))

    def inside(self) -> _Cells | None:
        """Search the interior for holes, assuming that the surface is covered; return the cells that are not settled.

        In a hole, the least height over the elements has a local maximum. A cell is settled if it cannot contain such a
        maximum. This is so in three cases: the cell is in one element; the cell is outside the body; or one direction
        leads away from all elements that may be nearest to a point of the cell.
        """
        target, model = self.target, self.model
        if not target.solids:
            return None
        cells, rest = next(self.paired(np.array([target.cube()]), np.zeros(1, dtype=np.int64), np.zeros(1))), []
        while len(cells.shape):
            cells, least, _, flush, _ = self.look(cells, first=False, inside=True)
            centers, reach = cells.middles()
            # An element counts if its height may be the least somewhere in the cell, judging by the height at the
            # cell's center.
            height = model.heights(centers[cells.cell], cells.element)
            active = height <= (least + 2 * reach)[cells.cell] + model.rounding[cells.element] + self.cells
            away = model.face_one_way(centers, reach + self.cells, cells.cell[active], cells.element[active])
            away &= np.isfinite(least)
            candidates = np.flatnonzero(~away)
            depth = np.full(len(away), np.inf)
            depth[candidates] = target.depths(centers[candidates])
            keep = depth <= reach + target.radius.max()
            chosen = np.flatnonzero(keep & (least > 0))
            chosen = chosen[target.holds(centers[chosen])]
            self.note(centers[chosen], least[chosen])
            self.outside.append(np.column_stack([centers[chosen], np.zeros(len(chosen))]))
            if self.witness is not None:
                return None
            done = keep & (flush | (2 * reach <= self.tolerance))
            rest.append(cells.take(done, active))
            cells = cells.take(keep & ~done, active)
            if len(cells.shape) * 8 > WORK:
                rest.append(cells)
                break
            cells = cells.parts()
        return _left(rest)

    def dive(self, cells: _Cells, inside: bool) -> None:
        """Search for a hole smaller than the tolerance, in the cells that are nearest to being outside the model."""
        for _ in range(LOOKS):
            if len(cells.shape) == 0 or self.witness is not None:
                return
            cells, least, _, flush, _ = self.look(cells.parts(), first=False, inside=inside)
            chosen = np.flatnonzero(least > 0)
            centers = cells.middles()[0]
            if inside:
                chosen = chosen[self.target.holds(centers[chosen])]
            self.note(centers[chosen], least[chosen])
            keep = np.zeros(len(least), dtype=bool)
            keep[np.argsort(np.where(flush, np.inf, -least), kind="stable")[:LOOKED_INTO]] = True
            cells = cells.take(keep & ~flush)

    def depth(self, whole: Bools, holes: _Cells | None) -> float:
        """Compute an upper bound on the largest distance from a point of the body to the model.

        If no hole was found in the interior, the distance is greatest on the surface or in a cell that is not settled.
        """
        target, (triangles, owner) = self.target, self.target.own
        left = ~whole[owner]
        bound = self._deepest(triangles[left], owner[left], self.tolerance, inside=False)
        if self.model.plain and self.witness is None:
            if holes is not None:
                middle, reach = holes.middles()
                distances = self.model.distances(middle[holes.cell], holes.element)
                far = least_of(distances, holes.cell, len(middle))
                bound = max(bound, float((far + reach).max()))
        elif target.solids:
            # The interior takes more cells than the surface. Distances of interior points are therefore bounded only to
            # a third of a percent of the body's size.
            least = max(self.tolerance, target.size / 300)
            cube = np.array([target.cube()])
            bound = max(bound, self._deepest(cube, np.zeros(1, dtype=np.int64), least, inside=True))
        return bound + float(target.gap.max())

    def _deepest(self, shape: Floats, owner: Ints, least: float, inside: bool) -> float:
        """Bound the largest distance from a point of the cells to the model, accurately to 1 % or to `least`."""
        target, model, bound, work = self.target, self.model, 0.0, 0
        waiting: Iterable[_Cells] = self.paired(shape, owner, np.zeros(len(shape)))
        plain = inside and model.plain
        while True:
            halves: list[_Cells] = []
            for cells in waiting:
                middle, reach = cells.middles()
                radius = np.zeros(len(middle)) if inside else target.radius[cells.owner]
                c, e = cells.cell, cells.element
                height, distance = model.heights(middle[c], e), model.distances(middle[c], e)
                far = least_of(distance, c, len(middle))
                most = far + reach + radius
                # An element is dropped if another element is nearer everywhere in the cell.
                near = height <= (far + 2 * reach)[c] + self.cells
                if inside:
                    ask = np.flatnonzero(most > self.deepest + least)
                    deep = target.depths(middle[ask])
                    most[ask[deep > reach[ask] + target.radius.max()]] = 0.0
                    held = ask[deep < 0]
                    held = held[target.holds(middle[held])]
                    self.note(middle[held], far[held])
                    if plain:
                        away = model.face_one_way(middle, reach + self.cells, c[near], e[near])
                        most[away] = 0.0
                else:
                    self.note(middle, far)
                    worst = np.max([model.distances(cells.corner(c, k), e) for k in range(3)], axis=0)
                    most = np.minimum(most, least_of(worst, c, len(middle)) + radius)
                enough = max(self.deepest * (1 + RELATIVE), self.deepest + least)
                kept = cells.take(most > enough, near)
                work += len(kept.shape)
                settled = most <= enough if work <= WORK else np.ones(len(most), dtype=bool)
                bound = max(bound, float(most[settled].max(initial=0.0)))
                if work <= WORK:
                    halves.append(kept.parts())
            if sum(len(cells.shape) for cells in halves) == 0:
                return bound + self.cells
            waiting = [_Cells.joined(halves)]


def excess_of(target: Target, packed: Packed, model: Elements, tolerance: float) -> tuple[float, float]:
    """Bound how far the elements of a model stick out of a body.

    A ball around a point at some depth in the body sticks out by no more than its radius minus this depth. A capsule is
    a union of such balls. If this bound is not close to the largest distance of trial points, or if the element is of
    another kind, a circumscribed polytope replaces the element, and `protrusion` bounds how far the polytope sticks
    out.
    """
    n, ways = len(model), ball(DIVISIONS)[0]
    upper, points = np.full(n, np.inf), []
    round_ = np.flatnonzero(np.isin(model.kind, ROUND))
    if len(round_):
        upper[round_] = _round_excess(target, model, round_, tolerance)
    hulls: dict[int, Polytope] = dict(model.hulls)
    for i in range(n):
        if i in hulls:
            points.append(hulls[i].vertices)
        elif model.sigma[i] > 0:
            hulls[i], center, _ = _around(packed, i)
            points.append(center + (of_piece(packed, i)[0] - center) / OUTWARD)
        else:
            ends = [model.axis[i], -model.axis[i]] if model.kind[i] == columns.SEGMENT else [np.zeros(3)]
            points += [model.center[i] + end + ways * (model.radius[i] * (1 - 1e-12)) for end in ends]
    lower = max(0.0, float(target.below(np.concatenate(points)).max()))
    near = max(lower * (1 + RELATIVE), lower + tolerance)
    open_ = [i for i in range(n) if upper[i] > near]
    if open_:
        around = {i: hulls[i] if i in hulls else _around(packed, i)[0] for i in open_}
        faces = np.cumsum([len(around[i].simplices) for i in open_])
        groups = np.split(np.array(open_), np.searchsorted(faces, np.arange(FACES, int(faces[-1]), FACES)))
        # Each search does a limited amount of work. If there are several searches, they may ignore elements that stick
        # out less than another element.
        floor = max(0.0, near + float(target.radius.min() - target.gap.max())) if len(groups) > 1 else 0.0
        for group in groups:
            if len(group) == 0:
                continue
            reached = protrusions([around[i] for i in group.tolist()], target.whole, floor=floor, together=True)
            bounds = np.maximum(reached.bounds - target.radius.min(), 0.0) + target.gap.max()
            upper[group] = np.minimum(upper[group], bounds)
            flat = [k for k, i in enumerate(group.tolist()) if i in model.hulls and reached.found[k] > 0]
            if flat:
                lower = max(lower, float(target.below(reached.points[flat]).max()))
    return lower, max(lower, float(np.maximum(upper, 0.0).max()))


def _round_excess(target: Target, model: Elements, these: Ints, tolerance: float) -> Floats:
    """Bound how far balls and capsules stick out: the largest signed distance of the axis, plus the radius."""
    bound = np.full(len(these), -np.inf)
    owner = np.arange(len(these))
    axis = model.axis[these] * (model.kind[these] == columns.SEGMENT)[:, None]
    low, high = np.full(len(these), -1.0), np.full(len(these), 1.0)
    best = np.full(len(these), -np.inf)
    for _ in range(20):
        middle = (low + high) / 2
        signed = target.far(model.center[these[owner]] + middle[:, None] * axis[owner])
        np.maximum.at(best, owner, signed)
        most = signed + (high - low) / 2 * lengths(axis[owner]) * (1 + 1e-12)
        done = most <= best[owner] + tolerance / 2
        np.maximum.at(bound, owner[done], most[done])
        owner, low, middle, high = owner[~done], low[~done], middle[~done], high[~done]
        if len(owner) == 0:
            break
        owner, low, high = np.tile(owner, 2), np.concatenate([low, middle]), np.concatenate([middle, high])
    else:
        np.maximum.at(bound, owner, np.inf)
    # A ball inside the triangles may stick out of the pieces by as much as the triangles do.
    return np.asarray(np.maximum(bound + model.radius[these] + model.rounding[these], target.gap.max()))


def prove(packed: Packed, model: Packed, tolerance: float | None, progress: Progress = silent) -> CoverReport:
    """Prove that a model covers a body, or that it does not; see `Body.covered_by`."""
    elements, target = Elements(model), Target(packed)
    length = RESOLUTION * target.size if tolerance is None else tolerance
    proof = _Proof(target, elements, length)

    def report(done: int, total: int) -> None:
        progress(done * 6 // 10, total)

    whole = proof.wholes()
    triangles, owner = target.own
    left = ~whole[owner]
    covered, outside, rest = proof.surface(triangles[left], owner[left], report)
    undecided = 0.0 if rest is None else float(rest.area.sum())
    covered += float((lengths(normals_of(triangles[~left])) / 2).sum())
    if rest is not None and proof.witness is None:
        proof.dive(rest, inside=False)
    around = target.curved & ~whole
    if proof.witness is None and around.any():
        # A curved piece is covered if the polytope around the piece is covered.
        these = around[target.owner]
        _, _, more = proof.surface(target.triangles[these], target.owner[these], silent, own=False)
        rest = _left([cells for cells in (rest, more) if cells is not None])
    holes = None
    if proof.witness is None and not whole.all():
        holes = proof.inside()
        if holes is not None and proof.witness is None:
            proof.dive(holes, inside=True)
    progress(80, 100)
    covers = proof.witness is None and rest is None and holes is None
    depth, share = (0.0, 0.0), (0.0, 0.0)
    if not covers:
        upper = proof.depth(whole, holes)  # may find a deeper point
        depth = (proof.deepest, max(upper, proof.deepest))
        total = covered + outside + undecided
        share = (outside / total, (outside + undecided) / total) if total > 0 else (0.0, 1.0)  # a cloud has no area
    outcome = "covered" if covers else "undecided" if proof.witness is None else "uncovered"
    excess = excess_of(target, model, elements, length)
    progress(100, 100)
    return CoverReport(outcome, share, depth, proof.witness, excess)


def first_failures(target: Target, model: Packed, protrusion: float) -> tuple[Floats, Floats]:
    """Return points of a body that a model misses, or is not proven to cover; none if the body is proven to be covered.

    Also return, for each point, the radius of a ball around it that lies in the body.
    """
    proof = _Proof(target, Elements(model), 0.02 * protrusion)
    whole = proof.wholes()
    triangles, owner = target.triangles, target.owner
    left = ~whole[owner]
    _, _, rest = proof.surface(triangles[left], owner[left], silent)
    if rest is not None:
        proof.outside.append(np.column_stack([rest.middles()[0], target.radius[rest.owner]]))
    if not any(map(len, proof.outside)) and not whole.all():
        holes = proof.inside()
        if holes is not None:
            proof.outside.append(np.column_stack([holes.middles()[0], np.zeros(len(holes.shape))]))
    points = np.concatenate([np.empty((0, 4)), *proof.outside])
    points = points[:: max(1, len(points) // 1000)]
    return points[:, :3], points[:, 3]
