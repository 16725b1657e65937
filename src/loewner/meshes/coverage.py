"""Find the parts of a mesh's surface that are outside the convex pieces, bound their distance, and cover them.

A decomposition cuts corners off the mesh, and a body that touches only such a corner would be reported as free. The
pieces are therefore grown until they contain the whole surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loewner._base import _validate
from loewner._base._matrices import least_of, slices
from loewner._base._validate import Floats, Ints
from loewner.ellipsoids.polytopes import Polytope
from loewner.meshes.triangles import halved, longest_edges, squared_distances

# Parts that stick out of the nearest piece by more than GROWTH are cut into cells, down to CELL_SIZE; both are relative
# to the diagonal of the mesh's box. A piece thus grows by about 0.1 % of the diagonal over a face, and by about 0.25 %
# over an edge that it shares with another piece.
GROWTH = 0.001
CELL_SIZE = 0.0025

# A sample that is outside a piece by at most this share of the diagonal of the mesh's box counts as inside. The share
# is far above Qhull's errors (about 1e-15), and far below the accuracy of any mesh.
COVER_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Covering:
    """To what extent verdicts about the convex pieces of a mesh apply to the mesh itself.

    Attributes
    ----------
    kind : str
        ``"cover"``: `Body.cover` fitted the pieces to a body, and the attributes refer to that body. ``"convex"``: the
        mesh is a union of closed convex parts, and the pieces are the hulls of the parts. ``"hull"``: the only piece is
        the convex hull of the mesh. ``"decomposition"``: the pieces approximate the mesh. ``"solid"``: the mesh is not
        closed, and triangles that close its holes were added. ``"swept"``: the pieces contain links of a robot at every
        point of a curve (`Robot.swept`), and all numbers refer to the swept volume of the links.
    exact : bool
        Whether the union of the pieces contains the whole surface of the mesh, up to rounding errors. If true, FREE
        also applies to the mesh, and `max_uncovered` bounds the rounding errors.
    max_uncovered : float
        Proven upper bound on the distance from any point of the mesh's surface to the union of the pieces, in metres.
        If the ``margin`` of a query is at least the sum of the bounds of both bodies, FREE applies to the surfaces of
        both meshes, even if `exact` is false.
    excess_volume : float
        Sum of the pieces' volumes divided by the mesh's volume, minus 1. The value measures how much the pieces stick
        out; overlaps count twice, including overlaps of the mesh's closed parts. NaN if the mesh is not closed and
        therefore has no volume.
    samples : int
        Number of surface points that were tested, including all vertices of the mesh.
    max_protrusion : float
        Proven upper bound, up to rounding, on the distance from any point of the pieces to the mesh, in metres. For a
        closed mesh, the distance is measured to the enclosed solid (all points with a nonzero winding number); for any
        other mesh, to the surface. The bound is within 1 % of the true value, or within 1e-4 of the diagonal of the
        mesh's bounding box, unless the mesh is so large that the search was stopped. NaN if the body was loaded from a
        file written before this value existed, or was made for a link from a mesh without an inside.

    Examples
    --------
    >>> import trimesh
    >>> from loewner import Body
    >>> Body.from_mesh(trimesh.creation.box((1, 1, 1))).covering.exact
    True
    """

    kind: str
    exact: bool
    max_uncovered: float
    excess_volume: float
    samples: int
    max_protrusion: float = float("nan")


@dataclass(frozen=True, eq=False, repr=False)
class CoverReport(_validate.Brief):
    """Whether the elements of a model contain a body, and how far the elements stick out of it; see `Body.covered_by`.

    Attributes
    ----------
    outcome : {"covered", "uncovered", "undecided"}
        "covered": each point of the body, including its interior, is proven to be in the model. "uncovered": `witness`
        is proven to be outside the model. "undecided": neither outcome is proven, because some parts of the body are in
        no single element, even though they are as small as the tolerance.
    uncovered_share : tuple of float
        Bounds on the share of the body's surface area that is outside the model. The surfaces of all pieces count, even
        where they are inside other pieces. For a curved piece, the area of an inscribed polytope with corners on the
        surface is measured. For a cloud of points without triangles, which has no area, the bounds are (0, 1).
    depth : tuple of float
        Bounds on the largest distance from a point of the body to the model, in metres.
    witness : ndarray, shape (3,), or None
        Among the points of the body that were tried, the point that is farthest outside the model.
    excess : tuple of float
        Bounds on the largest distance from a point of the model to the body, in metres.

    Examples
    --------
    >>> from loewner import Body
    >>> Body.box([1, 1, 1]).covered_by(Body.sphere(1.0)).outcome
    'covered'
    """

    outcome: str
    uncovered_share: tuple[float, float]
    depth: tuple[float, float]
    witness: Floats | None
    excess: tuple[float, float]


def covered(triangles: Floats, hulls: list[Polytope], size: float, *, grow: bool) -> tuple[list[Polytope], Covering]:
    """Measure the uncovered part of a surface, and grow the convex pieces on request.

    Parameters
    ----------
    triangles : ndarray, shape (t, 3, 3)
        Corners of the surface's triangles.
    hulls : list of Polytope
    size : float
        Diagonal of the mesh's bounding box.
    grow : bool
        Whether to add each part of the surface that lies in no piece to the closest piece.

    Returns
    -------
    hulls : list of Polytope
    covering : Covering
        The covering, without the excess volume and `max_protrusion`.
    """
    cells, owner, samples = _outside(triangles, hulls, GROWTH * size, CELL_SIZE * size)
    if grow and len(cells):
        hulls = list(hulls)
        for j in np.unique(owner):
            corners = cells[owner == j].reshape(-1, 3)
            hulls[j] = Polytope.from_points(np.concatenate([hulls[j].vertices, corners]))
    rounding = COVER_TOLERANCE * size
    gap = _largest_gap(cells, hulls, rounding)
    return hulls, Covering("decomposition", bool(gap <= rounding), gap, float("nan"), samples)


def _outside(triangles: Floats, hulls: list[Polytope], growth: float, cell_size: float) -> tuple[Floats, Ints, int]:
    """Find the cells of the surface that lie in no single piece.

    A triangle lies in a convex piece if its corners do. A triangle that lies in no piece is halved across its longest
    edge. The halving ends if a part lies in a piece, sticks out of a piece by at most `growth`, or has no edge longer
    than `cell_size`.

    Returns
    -------
    cells : ndarray, shape (k, 3, 3)
        Corners of the remaining cells.
    owner : ndarray of int, shape (k,)
        Index of the piece to which each cell is closest.
    samples : int
        Number of points tested.
    """
    rest, owners, samples = [np.empty((0, 3, 3))], [np.empty(0, dtype=np.int64)], 0
    while len(triangles):
        points, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        samples += len(points)
        worst, owner = _coverage(points, index.reshape(-1, 3), hulls)
        triangles, worst, owner = triangles[worst > 0], worst[worst > 0], owner[worst > 0]
        length, edge = longest_edges(triangles)
        split = (worst > growth) & (length > cell_size)
        rest.append(triangles[~split])
        owners.append(owner[~split])
        triangles = halved(triangles[split], edge[split])
    return np.concatenate(rest), np.concatenate(owners), samples


def _coverage(points: Floats, cells: Ints, hulls: list[Polytope]) -> tuple[Floats, Ints]:
    """Find the piece closest to each cell, and a lower bound on how far the cell sticks out (<= 0: it is inside)."""
    worst, owner = np.full(len(cells), np.inf), np.zeros(len(cells), dtype=np.int64)
    for j, hull in enumerate(hulls):
        box = np.maximum(hull.vertices.min(axis=0) - points, points - hull.vertices.max(axis=0)).max(axis=1)
        ask = (worst > 0) & (box[cells].max(axis=1) < worst)
        used = np.zeros(len(points), dtype=bool)
        used[cells[ask]] = True
        box[used] = _excess(points[used], hull)
        excess = np.where(ask, box[cells].max(axis=1), np.inf)
        better = excess < worst
        worst[better], owner[better] = excess[better], j
    return worst, owner


def _excess(points: Floats, hull: Polytope) -> Floats:
    """Compute the largest n·x - b over the faces, which is a lower bound on the distance, and negative inside."""
    excess = np.empty(len(points))
    for some in slices(len(points), 2_000_000 // len(hull.normals)):
        excess[some] = (points[some] @ hull.normals.T - hull.offsets).max(axis=1)
    return excess


def _largest_gap(cells: Floats, hulls: list[Polytope], slack: float) -> float:
    """Bound the distance of cells from the pieces, by the farthest corner of each cell from its nearest piece."""
    points, index = np.unique(cells.reshape(-1, 3), axis=0, return_inverse=True)
    corner = index.reshape(-1, 3)
    corner = corner[_coverage(points, corner, hulls)[0] > 0]
    if len(corner) == 0:
        return 0.0
    least = np.full(len(corner), np.inf)
    for hull in hulls:
        # A piece whose lower bound exceeds another piece's distance cannot be the nearest piece.
        near = _excess(points, hull)[corner].max(axis=1) < least
        used = np.unique(corner[near])
        distance = np.full(len(points), np.inf)
        distance[used] = distances_from(points[used], hull, slack)
        least = np.minimum(least, distance[corner].max(axis=1))
    return float(least.max())


def distances_from(points: Floats, hull: Polytope, slack: float) -> Floats:
    """Compute the distance from points to a convex piece, 0 inside.

    The nearest point of the piece lies on a face that is visible from the given point; `slack` prevents rounding from
    hiding such a face.
    """
    distance = np.zeros(len(points))
    for some in slices(len(points), 500_000 // len(hull.simplices)):
        x = points[some]
        height = x @ hull.normals.T - hull.offsets
        seen = (height > -slack) & (height.max(axis=1) > 0)[:, None]
        i, j = np.nonzero(seen[:, hull.face_of_simplex])
        squared = least_of(squared_distances(x[i], hull.vertices[hull.simplices[j]]), i, len(x))
        distance[some] = np.where(seen.any(axis=1), np.sqrt(squared), 0.0)
    return distance
