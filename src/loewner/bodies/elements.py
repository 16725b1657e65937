"""Represent convex pieces by functions that are at most zero inside, and evaluate the functions at many points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from loewner._base._matrices import dot, least_of, lengths, product, singular_values, slices
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns
from loewner.bodies.kinds import CURVED, KIND_NAMES, ROUND
from loewner.bodies.pack import Packed
from loewner.ellipsoids.polytopes import Polytope
from loewner.errors import GeometryError, InputError
from loewner.meshes.coverage import distances_from

# Bound on the rounding error of a height, relative to the size of the element (docs/containment.md).
HEIGHT_ROUNDINGS = 64 * 2.0**-53

# Number of products of points and planes computed at a time.
AT_ONCE = 1_000_000

# The search for a direction that leads away from all elements takes FACING_STEPS steps. The cosines of its angles with
# the directions away from the elements must exceed FACING.
FACING_STEPS, FACING = 8, 1e-6

# Number of steps of Newton's method for the point of an ellipsoid that is nearest to a given point.
NEAREST_STEPS = 24


class Elements:
    """The convex pieces of a body, represented by convex functions of points, which are called heights.

    A height is at most zero inside the piece and positive outside, and the heights of two points differ by no more than
    the distance between the points. Outside, the height is therefore a lower bound on the distance. For a ball or a
    capsule, the height is the signed distance. For a polytope, it is the largest signed distance from a face's plane.
    For any other curved piece, it is s (g - 1), where s is the smallest semi-axis and g the gauge of the unit shape.

    Parameters
    ----------
    packed : Packed
        The pieces of one body.
    name : str
        Name of the body in error messages.

    Attributes
    ----------
    kind : ndarray of int, shape (n,)
    rounding : ndarray, shape (n,)
        Bounds on the errors of heights, for deciding whether a point is inside; docs/containment.md derives them.
    exact : ndarray of bool, shape (n,)
        Whether the computed heights of float64 points have exact signs, as for axis-aligned boxes.
    plain : bool
        Whether all elements are balls, capsules and boxes. The direction to the nearest point of such an element is a
        combination of the directions that `face_one_way` considers.
    """

    def __init__(self, packed: Packed, name: str = "model") -> None:
        self.kind = packed.layout[:, columns.KIND]
        flat = np.flatnonzero(self.kind < columns.POLYTOPE)
        if len(flat):
            kind = KIND_NAMES[int(self.kind[flat[0]])]
            raise InputError(f"{name}: expected convex pieces, found a {kind} as piece {flat[0]}; see Body.from_mesh")
        n = len(self.kind)
        self.radius, self.center = packed.frames[:, 0].copy(), packed.frames[:, 1:4].copy()
        self.factor = packed.frames[:, 4:].reshape(n, 3, 3).copy()
        self.axis = np.ascontiguousarray(self.factor[:, :, 2])
        self.rounding, self.exact = np.empty(n), np.zeros(n, dtype=bool)
        self.hulls: dict[int, Polytope] = {}
        round_ = np.isin(self.kind, ROUND)
        far = np.where(self.kind == columns.SEGMENT, lengths(self.axis), 0.0)
        self.rounding[round_] = HEIGHT_ROUNDINGS * (self.radius + far)[round_]
        self._take_gauges()
        self._take_planes(packed)
        self.kinds = np.unique(self.kind).tolist()
        boxes = all(_right_angled(hull.normals) for hull in self.hulls.values())
        self.plain = boxes and set(self.kinds) <= {columns.POINT, columns.SEGMENT, columns.POLYTOPE}

    def __len__(self) -> int:
        return len(self.kind)

    def _take_gauges(self) -> None:
        """Prepare the curved pieces without an added ball."""
        these = np.flatnonzero((self.kind > columns.POLYTOPE) & ~np.isin(self.kind, ROUND))
        self.inverse, self.sigma = np.zeros_like(self.factor), np.zeros(len(self.kind))
        if len(these) == 0:
            return
        self.inverse[these] = np.linalg.inv(self.factor[these])
        self.sigma[these] = singular_values(self.factor[these])[:, -1]
        # The inverse and the product with the inverse add rounding errors to the gauge of a point.
        spread = product(np.abs(self.inverse[these]), np.abs(self.factor[these]))
        turned = np.sqrt((spread * spread).sum(axis=(1, 2)))
        self.sigma[these] *= 1 - HEIGHT_ROUNDINGS
        self.rounding[these] = HEIGHT_ROUNDINGS * self.sigma[these] * turned

    def _take_planes(self, packed: Packed) -> None:
        """Prepare polytopes: for each triangle of the surface, choose the plane that is nearest to its lowest corner.

        By the lemma of docs/containment.md, the points below all chosen planes lie in the hull of the vertices.
        """
        rows: dict[int, Floats] = {}
        for i in np.flatnonzero(self.kind == columns.POLYTOPE).tolist():
            vertices, planes, triangles = packed.points_of(i), packed.planes_of(i), packed.triangles_of(i)
            heights = product(vertices, planes[:, :3].T)
            least, face = np.empty(len(triangles)), np.empty(len(triangles), dtype=np.int64)
            for some in slices(len(triangles), AT_ONCE // len(planes)):
                low = heights[triangles[some]].min(axis=1)
                face[some] = (low - planes[:, 3]).argmax(axis=1)
                least[some] = np.take_along_axis(low, face[some, None], axis=1)[:, 0]
            used, place = np.unique(face, return_inverse=True)
            offsets = least_of(least, place, len(used))
            middle = vertices.mean(axis=0)
            self.center[i] = middle
            if not (offsets - product(planes[used, :3], middle[:, None])[:, 0] > 0).all():
                raise GeometryError(f"piece {i}: expected a polytope with an interior, found one that is too flat")
            most = heights[:, used].max(axis=0)
            rows[i] = np.column_stack([planes[used, :3], offsets])
            along = np.abs(planes[used, :3])
            self.exact[i] = bool(((along == 0) | (along == 1)).all() and (most == offsets).all())
            self.rounding[i] = HEIGHT_ROUNDINGS * np.abs(vertices).max() + (most - offsets).max()
            self.hulls[i] = Polytope(vertices, planes[:, :3], planes[:, 3], triangles, face)
        most_planes = max((len(row) for row in rows.values()), default=0)
        self.planes = np.zeros((len(self.kind), most_planes, 4))
        for i, row in rows.items():
            self.planes[i] = np.resize(row, (most_planes, 4))

    def heights(self, points: Floats, element: Ints) -> Floats:
        """Compute the heights of points, shape (m, 3), each for its own element, shape (m,)."""
        if len(self.kinds) == 1:
            return self._heights(self.kinds[0], points, element)
        return self._by_kind(element, lambda kind, these: self._heights(kind, points[these], element[these]))

    def _by_kind(self, element: Ints, function: Callable[[int, Ints], Floats]) -> Floats:
        """Compute one number per entry of `element`; `function` receives a kind and the positions of its entries."""
        kinds, values = self.kind[element], np.empty(len(element))
        for kind in self.kinds:
            these = np.flatnonzero(kinds == kind)
            if len(these):
                values[these] = function(kind, these)
        return values

    def _heights(self, kind: int, points: Floats, element: Ints) -> Floats:
        if kind == columns.POLYTOPE:
            height = np.empty(len(points))
            for some in slices(len(points), AT_ONCE // self.planes.shape[1]):
                planes = self.planes[element[some]]
                height[some] = (dot(points[some, None], planes[:, :, :3]) - planes[:, :, 3]).max(axis=1)
            return height
        arm = points - self.center[element]
        if kind == columns.SEGMENT:
            axis = self.axis[element]
            arm = arm - np.clip(dot(arm, axis) / dot(axis, axis), -1.0, 1.0)[:, None] * axis
        if kind in ROUND:
            return np.asarray(lengths(arm) - self.radius[element])
        return np.asarray(self.sigma[element] * (CURVED[kind].gauge(dot(self.inverse[element], arm[:, None])) - 1.0))

    def distances(self, points: Floats, element: Ints) -> Floats:
        """Compute upper bounds on the distances of points from their elements; the bound is 0 inside."""
        distances = np.maximum(self.heights(points, element), 0.0)
        kinds = self.kind[element]
        for i in np.unique(element[kinds == columns.POLYTOPE]).tolist():
            mine = np.flatnonzero((element == i) & (distances > 0))
            if len(mine):
                hull = self.hulls[i]
                distances[mine] = distances_from(points[mine], hull, float(self.rounding[i])) + self.rounding[i]
        these = np.flatnonzero((self.sigma[element] > 0) & (distances > 0))
        if len(these):
            x, e = points[these], element[these]
            near = self._near(x - self.center[e], e)
            unit = dot(self.inverse[e], near[:, None])
            share = self._by_kind(e, lambda kind, its: CURVED[kind].share(unit[its]))
            distances[these] = lengths(x - self.center[e] - share[:, None] * near) + self.rounding[e]
        return distances

    def below(self, points: Floats, element: Ints) -> Floats:
        """Compute lower bounds, at least as large as the heights, on the distances of points from their elements."""
        bounds = self.heights(points, element)
        these = np.flatnonzero(self.kind[element] == columns.POLYTOPE)
        if len(these):
            far = self.distances(points[these], element[these]) - 3 * self.rounding[element[these]]
            bounds[these] = np.where(bounds[these] > 0, np.maximum(bounds[these], far), bounds[these])
        these = np.flatnonzero((self.sigma[element] > 0) & (bounds > 0))
        if len(these):
            # The distance from a supporting plane of the element is a lower bound. The plane is perpendicular to the
            # direction from a near point of the element.
            e = element[these]
            arm = points[these] - self.center[e]
            way = arm - self._near(arm, e)
            length = lengths(way)
            way /= np.where(length > 0, length, 1.0)[:, None]
            turned = dot(self.factor[e].transpose(0, 2, 1), way[:, None])
            support = self._by_kind(e, lambda kind, its: CURVED[kind].support(turned[its]))
            bounds[these] = np.maximum(bounds[these], dot(way, arm) - support - self.rounding[e])
        return bounds

    def _near(self, arm: Floats, element: Ints) -> Floats:
        """Compute points of elements close to points outside; all points are relative to the elements' centers."""
        unit = dot(self.inverse[element], arm[:, None])
        kinds = self.kind[element]
        squares = (self.factor[element] ** 2).sum(axis=1)
        # For an ellipsoid with semi-axes a and a point y = a · unit, the nearest point is a² y / (a² + t), for the t at
        # which the squares of a y / (a² + t) sum to 1.
        t = np.zeros(len(arm))
        for _ in range(NEAREST_STEPS):
            terms = squares * unit / (squares + t[:, None])
            value, slope = (terms**2).sum(axis=1) - 1.0, (2.0 * terms**2 / (squares + t[:, None])).sum(axis=1)
            t += np.where(value > 0, value / slope, 0.0)
        near = squares * unit / (squares + t[:, None])
        across = np.maximum(np.hypot(unit[:, 0], unit[:, 1]), 1.0)
        clipped = np.column_stack([unit[:, :2] / across[:, None], np.clip(unit[:, 2], -1.0, 1.0)])
        near = np.where((kinds == columns.ELLIPSOID)[:, None], near, unit)
        near = np.where((kinds == columns.CYLINDER)[:, None], clipped, near)
        return dot(self.factor[element], near[:, None])

    def face_one_way(self, middles: Floats, reach: Floats, cell: Ints, element: Ints) -> Bools:
        """Return, for each cell, whether one direction leads away from all its elements at every point of the cell.

        Parameters
        ----------
        middles, reach : ndarray, shapes (k, 3) and (k,)
            Balls that contain the cells.
        cell, element : ndarray of int, shape (m,)
            Pairs of a cell and one of its elements.

        Returns
        -------
        ndarray of bool, shape (k,)
            If true for a cell, the least height over the cell's elements has no local maximum above zero in the cell.
        """
        candidates: list[tuple[Floats, Floats, Ints]] = []  # directions, slacks, and the cells to which they belong
        answers = np.ones(len(middles), dtype=bool)
        kinds = self.kind[element]
        for kind in self.kinds:
            these = np.flatnonzero(kinds == kind)
            its, e = cell[these], element[these]
            arm, far = middles[its] - self.center[e], reach[its]
            if kind == columns.POINT:
                candidates.append((arm, far, its))
            elif kind == columns.SEGMENT:
                candidates += [(arm - self.axis[e], far, its), (arm + self.axis[e], far, its)]
            elif kind == columns.ELLIPSOID:
                unit, size = dot(self.inverse[e], arm[:, None]), self.sigma[e]
                gradient = dot(self.inverse[e].transpose(0, 2, 1), unit[:, None]) * (size * size)[:, None]
                candidates.append((gradient, far, its))
            elif kind == columns.POLYTOPE:
                planes = self.planes[e]
                above = dot(middles[its][:, None], planes[:, :, :3]) - planes[:, :, 3] > -(far * (1 + 1e-9))[:, None]
                pair, face = np.nonzero(above)
                candidates.append((planes[pair, face, :3], np.zeros(len(pair)), its[pair]))
            else:
                answers[its] = False
        if not candidates:
            return answers
        row, slack, owner = map(np.concatenate, zip(*candidates, strict=True))
        size = lengths(row)
        unit = row / np.where(size > 0, size, 1.0)[:, None]
        share = np.where(size > 0, slack / np.where(size > 0, size, 1.0), np.inf) + FACING
        way = np.zeros((len(middles), 3))
        np.add.at(way, owner, unit)
        for _ in range(FACING_STEPS):
            length = lengths(way)
            way /= np.where(length > 0, length, 1.0)[:, None]
            excess = dot(unit, way[owner]) - share
            least = least_of(excess, owner, len(middles))
            worst = np.flatnonzero((excess == least[owner]) & (least[owner] <= 0))
            if len(worst) == 0:
                break
            way[owner[worst]] += unit[worst]
        return np.asarray(answers & (least > 0))


def _right_angled(normals: Floats) -> bool:
    return len(normals) == 6 and bool((np.abs(np.abs(product(normals, normals.T)) - 0.5) > 0.5 - 1e-9).all())
