"""Make pieces from arrays of sensor data: balls, boxes, points with a radius, occupied voxels, terrain."""

from __future__ import annotations

import numpy as np

from loewner._base import _memory
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns
from loewner.bodies.layout import PieceArrays, laid_out
from loewner.bodies.primitives import CLOSED_FORM_ROUNDING
from loewner.bodies.surfaces import surface_pieces
from loewner.ellipsoids.polytopes import box_hull
from loewner.errors import GeometryError, InputError

# Approximate memory of a piece, and of a box, in all arrays [bytes].
PIECE_BYTES, BOX_BYTES = 1100, 2200

# Number of bits of a cell's index along each axis; three such indices fit into one 64-bit integer.
CELL_BITS = 21
MOST_CELLS = 2 ** (CELL_BITS - 1)


def ball_pieces(centers: Floats, radii: Floats) -> PieceArrays:
    """Make one body of balls; each ball is a piece, and also this piece's inner and outer ellipsoid.

    Parameters
    ----------
    centers : ndarray, shape (n, 3)
    radii : ndarray, shape (n,)
    """
    n = len(centers)
    _memory.expect_left(n * PIECE_BYTES, f"{n} spheres")
    factor = radii[:, None, None] * np.eye(3)
    inner, outer = (centers.copy(), factor), (centers.copy(), factor.copy())
    frames = np.column_stack([radii, centers, factor.reshape(n, 9)])
    return laid_out(columns.POINT, inner, outer, np.zeros((n, 2)), frames=frames)


def box_pieces(lower: Floats, upper: Floats) -> PieceArrays:
    """Make one body of axis-aligned boxes, each a polytope between its lower and its upper corner.

    The corners are exact, but centers and half edges are rounded. The outer ellipsoids therefore grow, and the inner
    ellipsoids shrink, by the ratio of this rounding error to the shortest edge.

    Parameters
    ----------
    lower, upper : ndarray, shape (n, 3)

    Raises
    ------
    GeometryError
        If a box is so thin, and so far from the origin, that its thickness is lost in rounding.
    """
    n = len(lower)
    _memory.expect_left(n * BOX_BYTES, f"{n} boxes")
    unit = box_hull(np.ones(3), "boxes")
    center, half = (lower + upper) / 2, (upper - lower) / 2
    farthest, thinnest = np.maximum(np.abs(lower), np.abs(upper)).max(axis=1), half.min(axis=1)
    with np.errstate(divide="ignore"):
        off = 8 * 2.0**-53 * farthest / thinnest + CLOSED_FORM_ROUNDING
    if not (off < 1e-3).all():
        i = int(off.argmax())
        raise GeometryError(
            f"boxes: expected edges that are more than rounding, found box {i} with an edge of {2 * thinnest[i]:g} m "
            f"{farthest[i]:g} m from the origin"
        )
    # Filling one column at a time takes a third of the time of a selection by broadcasting. A face's plane goes exactly
    # through the face's corners, since its normal is an axis.
    corners, planes = np.empty((n, 8, 3)), np.empty((n, 6, 4))
    for (vertex, axis), sign in np.ndenumerate(unit.vertices):
        corners[:, vertex, axis] = upper[:, axis] if sign > 0 else lower[:, axis]
    planes[:, :, :3] = unit.normals
    for face, axis in zip(*np.nonzero(unit.normals), strict=True):
        planes[:, face, 3] = upper[:, axis] if unit.normals[face, axis] > 0 else -lower[:, axis]
    factor, number = half[:, None] * np.eye(3), np.arange(n + 1, dtype=np.int64)
    return laid_out(
        columns.POLYTOPE,
        (center, factor * (1 - off)[:, None, None]),
        (center.copy(), factor * (np.sqrt(3.0) * (1 + off))[:, None, None]),
        np.repeat(6 * off[:, None], 2, axis=1),
        point_start=8 * number, points=corners.reshape(-1, 3), plane_start=6 * number, planes=planes.reshape(-1, 4),
        triangle_start=number * len(unit.triangles), triangles=np.tile(unit.triangles, (n, 1)),
    )  # fmt: skip


def point_pieces(points: Floats, radius: float, tol: float) -> PieceArrays:
    """Make a body of one piece: equal balls around points, stored as a surface whose triangles are single points."""
    triangles = np.repeat(np.arange(len(points))[:, None], 3, axis=1)
    return surface_pieces("points", points, triangles, radius, False, tol)


def cells_of(points: Floats, edge: float) -> Ints:
    """List each occupied cell once and in order, shape (k, 3), for a grid with a corner at the origin."""
    cells = points / edge
    np.floor(cells, out=cells)
    farthest = float(np.abs(cells).max())
    if not farthest < MOST_CELLS:
        raise InputError(
            f"voxel: expected cells within {MOST_CELLS} of the origin along each axis, found one at {farthest:.3g}"
        )
    numbers = _numbered(cells.astype(np.int64), (0, 1, 2))
    # Neighbours in an image are often in the same cell. Dropping repeats first leaves fewer numbers to sort.
    return _cells(_without_repeats(np.sort(_without_repeats(numbers))), (0, 1, 2))


def _without_repeats(numbers: Ints) -> Ints:
    """Drop numbers that equal their predecessors."""
    return np.asarray(numbers[np.concatenate([[True], numbers[1:] != numbers[:-1]])])


def voxel_pieces(cells: Ints, edge: float) -> PieceArrays:
    """Make one body from cells of a grid with a corner at the origin; each row of cells without gaps becomes one box.

    Parameters
    ----------
    cells : ndarray of int, shape (k, 3)
        The cells, each once.
    edge : float
        In metres.
    """
    first, last = min((_rows_along(cells, axis) for axis in range(3)), key=lambda rows: len(rows[0]))
    lower, upper = (np.multiply(edge, ends, dtype=np.float64) for ends in (first, last + 1))
    return box_pieces(lower, upper)


def _rows_along(cells: Ints, axis: int) -> tuple[Ints, Ints]:
    """Find the first and last cells of the rows without gaps along an axis."""
    order = (*(k for k in range(3) if k != axis), axis)
    numbers = np.sort(_numbered(cells, order))
    # No index along the last axis is 0, so cells with consecutive numbers are neighbours in the grid.
    ends = np.flatnonzero(np.diff(numbers) != 1)
    first, last = np.concatenate([[0], ends + 1]), np.concatenate([ends, [len(numbers) - 1]])
    return _cells(numbers[first], order), _cells(numbers[last], order)


def _numbered(cells: Ints, order: tuple[int, ...]) -> Ints:
    """Combine the three indices of each cell into one integer; the first axis in `order` is the most significant."""
    x, y, z = (cells[:, axis] + MOST_CELLS for axis in order)
    return np.asarray((((x << CELL_BITS) | y) << CELL_BITS) | z)


def _cells(numbers: Ints, order: tuple[int, ...]) -> Ints:
    """Recover cells from the integers that `_numbered` computed."""
    cells = np.empty((len(numbers), 3), dtype=np.int64)
    rest = numbers
    for axis in reversed(order):
        cells[:, axis] = (rest & (2 * MOST_CELLS - 1)) - MOST_CELLS
        rest = rest >> CELL_BITS
    return cells


def grid_pieces(occupied: Bools, edge: float, origin: Floats) -> PieceArrays:
    """Make one body of boxes, the union of the occupied cells; each row of cells without gaps becomes one box.

    Parameters
    ----------
    occupied : ndarray of bool, shape (p, q, r)
    edge : float
        In metres.
    origin : ndarray, shape (3,)
        The lowest corner of cell (0, 0, 0).

    Raises
    ------
    GeometryError
        If no cell is occupied.
    """
    # Two arrays of flags determine peak memory: one for cells that begin a row, and one for empty cells.
    _memory.expect_left(2 * occupied.size, f"grid: {' x '.join(map(str, occupied.shape))} cells")
    count, axis = min((int(np.count_nonzero(_begins(np.moveaxis(occupied, axis, 2)))), axis) for axis in range(3))
    if count == 0:
        raise GeometryError("grid: expected at least one occupied cell, found none")
    _memory.expect_left(count * BOX_BYTES, f"grid: {count} boxes")
    along = np.moveaxis(occupied, axis, 2)
    first = np.argwhere(_begins(along))
    last = np.argwhere(_begins(along[..., ::-1])[..., ::-1])
    order = np.argsort([k for k in range(3) if k != axis] + [axis])
    return box_pieces(origin + edge * first[:, order], origin + edge * (last[:, order] + 1))


def _begins(occupied: Bools) -> Bools:
    """Mark the occupied cells whose predecessor along the last axis is not occupied."""
    begins = occupied.copy()
    begins[..., 1:] &= ~occupied[..., :-1]
    return begins


def terrain_pieces(heights: Floats, spacing: Floats, base: float, tol: float) -> PieceArrays:
    """Make a body of one solid piece: the space between a flat base and a triangulated surface of heights.

    Parameters
    ----------
    heights : ndarray, shape (p, q)
        ``heights[i, j]`` is the height at x = i spacing[0], y = j spacing[1].
    spacing : ndarray, shape (2,)
    base : float
        Below all heights.
    tol : float
        Upper limit on the certified log-volume gap of the outer ellipsoid.
    """
    p, q = heights.shape
    _memory.expect_left(p * q * 500, f"a height field of {p} x {q}")
    x, y = np.meshgrid(np.arange(p) * spacing[0], np.arange(q) * spacing[1], indexing="ij")
    top = np.stack([x, y, heights], axis=2).reshape(-1, 3)
    number = np.arange(p * q).reshape(p, q)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    surface = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    # The rim runs counter-clockwise as seen from above. The base is a fan of triangles around its center.
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    low, middle = p * q + np.arange(len(rim)), p * q + len(rim)
    ahead, low_ahead = np.roll(rim, -1), np.roll(low, -1)
    sides = np.concatenate([np.column_stack([low, low_ahead, ahead]), np.column_stack([low, ahead, rim])])
    below = np.column_stack([np.full(len(rim), middle), low_ahead, low])
    ground = np.column_stack([top[rim, :2], np.full(len(rim), base)])
    center = np.array([[*(0.5 * top[-1, :2]), base]])
    return surface_pieces(
        "heights", np.concatenate([top, ground, center]), np.concatenate([surface, sides, below]), 0.0, True, tol
    )
