"""Lay pieces out in flat arrays, and make the kernels' arrays: tables, blocks of vertices, trees, addresses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base._matrices import dot, image, lengths, product, singular_values, slices
from loewner._base._read_only import KeepsReadOnly, read_only
from loewner._base._validate import Floats, Ints
from loewner._kernels import columns, records, tolerances
from loewner._native import entries
from loewner.bodies.boxes import least_box_axes
from loewner.bodies.surface_trees import SurfaceTree, Trees
from loewner.errors import GeometryError, InputError

Maps = dict[int, tuple[Ints, Floats]]

# Range of lengths [m]. Outside this range, the sixth powers of lengths in the contact function overflow or underflow.
# Real bodies are far from both ends.
SMALLEST, LARGEST = 1e-30, 1e30

# Share by which a pose that is accepted as rigid may still stretch or shrink lengths.
BEND = 2 * tolerances.ROTATION_TOLERANCE  # certified.md B22

# Bounds are rounded up by this factor before they are converted to single precision.
UP = 1 + 2.0**-22  # certified.md B23

# Assumed bound on the errors of singular values, relative to the largest singular value; tests compare LAPACK's errors
# with this bound.
SINGULAR_ROUNDINGS = 32 * 2.0**-53

# Bound on the rounding errors of a nearly orthonormal matrix from LAPACK, and of two products with this matrix, which
# have three terms per entry.
TURN_ROUNDINGS = 128 * 2.0**-53

# Number of products of directions and vertices computed at a time.
AT_ONCE = 1_000_000

# Types of the arrays in `records.Pieces`: F float64, S float32 or I int64, and the number of axes.
_WORDS = ["F2", "I2", "F1", "I1", "F2", "S2", "F1", "I1", "I1", "S1", "F2", "I1"]

# The corners of a box. Along each axis, 0 is the lower end, and 1 is the upper end.
_CORNERS = np.indices((2, 2, 2)).reshape(3, 8).T
_UPPER = (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)  # entries of a symmetric matrix

# Range of sizes in which the certificate may start in single precision (docs/certified.md).
SINGLE_SIZES = 1e-3, 1e3


@dataclass(frozen=True, eq=False)
class PieceArrays(KeepsReadOnly):
    """The pieces of n bodies as read-only arrays.

    Attributes
    ----------
    layout : ndarray of int64, shape (P, 5)
        Kind of the piece, first row and end of its points, and first row and end of its planes. An end is one past the
        last row.
    points, planes : ndarray, shapes (V, 3) and (F, 4)
        ``points`` has the vertices. Each row of ``planes`` is a face: its unit outward normal n, and its offset. All
        points x of the piece satisfy n·x <= offset.
    piece_start : ndarray of int64, shape (n + 1,)
        Start of each body's range of pieces: body i has pieces piece_start[i] : piece_start[i+1].
    frames : ndarray, shape (P, 13)
        Rounding radius, and center and factor of the unit shape's image; zeros for polytopes.
    triangles, triangle_start
        Triangles of polytopes and surfaces, as indices into the piece's own points, and the start of each piece's
        triangles.
    inner_center, inner_factor, outer_center, outer_factor
        The ellipsoids, shapes (P, 3) and (P, 3, 3).
    gaps : ndarray, shape (P, 2)
        Certified log-volume gaps of the inner and the outer fit.
    """

    layout: Ints
    points: Floats
    planes: Floats
    piece_start: Ints
    frames: Floats
    triangles: Ints
    triangle_start: Ints
    inner_center: Floats
    inner_factor: Floats
    outer_center: Floats
    outer_factor: Floats
    gaps: Floats

    def __post_init__(self) -> None:
        read_only(*arrays_of(self).values())

    def points_of(self, i: int) -> Floats:
        """Return the points of a piece."""
        return self.points[self.layout[i, columns.POINTS_FROM] : self.layout[i, columns.POINTS_TO]]

    def planes_of(self, i: int) -> Floats:
        """Return the planes of a polytope."""
        return self.planes[self.layout[i, columns.PLANES_FROM] : self.layout[i, columns.PLANES_TO]]

    def triangles_of(self, i: int) -> Ints:
        """Return the triangles of a polytope or a surface, as indices into its points."""
        return self.triangles[self.triangle_start[i] : self.triangle_start[i + 1]]


ARRAYS = tuple(f.name for f in fields(PieceArrays))


def arrays_of(pieces: PieceArrays) -> dict[str, Any]:
    """Return the arrays by name, in the order of `ARRAYS`."""
    return {name: getattr(pieces, name) for name in ARRAYS}


def laid_out(
    kind: int | Ints,
    inner: tuple[Floats, Floats],
    outer: tuple[Floats, Floats],
    gaps: Floats,
    *,
    point_start: Ints | None = None,
    plane_start: Ints | None = None,
    radius: float = 0.0,
    **others: Any,
) -> PieceArrays:
    """Lay out one body of pieces; arrays that are not passed are empty.

    Parameters
    ----------
    kind : int or ndarray of int64, shape (P,)
        Number of the kind.
    inner, outer : tuple
        Centers and factors of the ellipsoids, shapes (P, 3) and (P, 3, 3).
    gaps : ndarray, shape (P, 2)
        Log-volume gaps of the fits.
    point_start, plane_start : ndarray of int64, shape (P + 1,), optional
        Starts of the pieces' ranges of points and of planes; by default, all ranges are empty.
    radius : float
        Rounding radius of all pieces; unused if `frames` is given.
    **others : ndarray
        Further arrays of `PieceArrays`.
    """
    count = len(gaps)
    layout, frames = np.zeros((count, 5), dtype=np.int64), np.zeros((count, 13))
    layout[:, columns.KIND], frames[:, 0] = kind, radius
    for column, start in ((columns.POINTS_FROM, point_start), (columns.PLANES_FROM, plane_start)):
        if start is not None:
            layout[:, column], layout[:, column + 1] = start[:-1], start[1:]
    arrays: dict[str, Any] = {
        "layout": layout, "points": np.zeros((0, 3)), "planes": np.zeros((0, 4)), "frames": frames, "gaps": gaps,
        "piece_start": np.array([0, count], dtype=np.int64), "triangles": np.zeros((0, 3), dtype=np.int64),
        "triangle_start": np.zeros(count + 1, dtype=np.int64),
    }  # fmt: skip
    arrays["inner_center"], arrays["inner_factor"] = inner
    arrays["outer_center"], arrays["outer_factor"] = outer
    return PieceArrays(**arrays | others)


def kernel_arrays(p: PieceArrays, maps: Maps, trees: Trees) -> records.Pieces:
    """Make the arrays for kernels, with the direction maps of large pieces and the trees of surfaces.

    `loewner._kernels.pieces.shapes` describes the arrays. They are writeable, because Numba would treat read-only
    arrays as a different type and compile everything twice.

    Raises
    ------
    GeometryError
        If a piece is smaller than `SMALLEST`, or larger than `LARGEST`.
    """
    table = _table(p)
    layout, points = _kernel_points(p, maps, trees)
    hot = np.ascontiguousarray(table[:, : columns.HOT])
    start = p.piece_start.copy()
    single = _single(hot)
    vertices = records.aligned(len(points) if len(single) else 0, np.float32)
    vertices[:] = points[: len(vertices)]
    return records.Pieces(table, layout, points, start, hot, single, *_trees(table, start), vertices, *_parts(p, trees))


def joined_kernel(packs: Sequence[Any]) -> records.Pieces:
    """Join the kernels' arrays of several packs, in order.

    The result is the same as from `kernel_arrays` for all pieces.

    Joining the arrays of a cloud is a hundred times as fast as making them again.
    """
    counts = [len(pack.piece_start) - 1 for pack in packs]
    numbers = np.concatenate([np.arange(count) for count in counts])
    chosen = np.column_stack([np.repeat(np.array([pack.handle for pack in packs]), counts), numbers])
    block = records.aligned(entries.join_bodies(chosen, np.zeros(0)))
    entries.join_bodies(chosen, block)
    table = block[: records.ENTRIES * len(_WORDS)].view(np.int64).reshape(-1, records.ENTRIES).tolist()
    return records.Pieces(*(array_in(block, row, word) for row, word in zip(table, _WORDS, strict=True)))


def array_in(memory: NDArray[Any], row: Sequence[int], word: str) -> Any:
    """Return the array in `memory` that a row of a table describes; `word` is its type, as in `_WORDS`."""
    address, *shape = row
    within = address - memory.ctypes.data if 0 not in shape else 0  # an empty array may have any address
    kind = {"F": np.float64, "S": np.float32, "I": np.int64}[word[0]]
    return np.ndarray(shape[: int(word[1])], kind, memory, within)


def one_body(kernel: records.Pieces) -> records.Pieces:
    """Combine all pieces into one body."""
    start = np.array([0, len(kernel.table)])
    groups, children, roots = _trees(kernel.table, start)
    return kernel._replace(piece_start=start, groups=groups, children=children, roots=roots)


def kernel_of_parts(p: PieceArrays, tree: SurfaceTree, around: Sequence[Floats], reach: float) -> records.Pieces:
    """Make the kernels' arrays for the parts of a surface, as one body.

    An exact search on a part uses the tree of the whole surface. If the search finds a collision with another part
    instead, that is also a collision of the same two bodies.

    Parameters
    ----------
    p : PieceArrays
    tree : SurfaceTree
        The whole surface's tree.
    around : sequence of ndarray, shape (k, 3)
        For each part, points whose convex hull contains the part's triangles, without the radius.
    reach : float
        Reach of the whole surface. Bounds on rounding depend on it, since they must hold for all triangles of the tree.
    """
    table, count = _table(p), len(around)
    table[:, columns.REACH] = reach
    hot, number = np.ascontiguousarray(table[:, : columns.HOT]), np.arange(count)
    blocks = [_in_blocks(points) for points in around]
    single, points = _single(hot), _end_to_end([block.ravel() for block in blocks])
    ends = np.cumsum([0, *(block.size // 3 for block in blocks)])
    layout = np.column_stack([p.layout[:, columns.KIND], ends[:-1], ends[1:], number])
    layout[:, columns.SURFACE_AT] = tree.table.ctypes.data
    vertices = _end_to_end([points[: len(points) * (len(single) > 0)].astype(np.float32)])
    part_start = np.column_stack([number, number + 1, number + 1]).ravel()
    return records.Pieces(
        table, layout, points, p.piece_start.copy(), hot, single, *_trees(table, p.piece_start), vertices, hot.copy(),
        part_start,
    )  # fmt: skip


def _in_blocks(points: Floats) -> Floats:
    """Arrange points, shape (k, 3), in blocks of eight; copies of the last point fill up the last block."""
    count = -(-len(points) // columns.BLOCK) * columns.BLOCK
    filled = points[np.minimum(np.arange(count), len(points) - 1)]
    return filled.reshape(-1, columns.BLOCK, 3).transpose(0, 2, 1)


def _end_to_end(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate flat arrays; the result starts at a cache line."""
    flat_array: NDArray[Any] = records.aligned(sum(map(len, arrays)), arrays[0].dtype)
    return np.concatenate(arrays, out=flat_array)


def direction_maps(layout: Ints, points: Floats) -> Maps:
    """Make the direction maps of the large polytopes, keyed by piece index."""
    first, last = layout[:, columns.POINTS_FROM], layout[:, columns.POINTS_TO]
    return {
        int(i): entries.direction_map(points[first[i] : last[i]].copy())
        for i in np.flatnonzero((last - first > columns.LARGE) & (layout[:, columns.KIND] == columns.POLYTOPE))
    }


def surface_trees(p: PieceArrays) -> Trees:
    """Build a tree for every piece that is a surface, keyed by piece index."""
    kind = p.layout[:, columns.KIND]
    return {
        i: SurfaceTree.of(p.points_of(i), p.triangles_of(i), bool(kind[i] == columns.SOLID))
        for i in np.flatnonzero(kind <= columns.SURFACE).tolist()
    }


def heights_of(
    points: Floats, normals: Floats, center: Floats, factor: Floats, most: float = np.inf
) -> tuple[Floats, int]:
    """For each normal, find the largest normal·vertex over the vertices of a large polytope; also count the products.

    The direction map is made in coordinates in which the inner ellipsoid is a ball, so that few candidates remain for
    any shape.

    Parameters
    ----------
    points : ndarray, shape (v, 3)
    normals : ndarray, shape (f, 3)
    center, factor : ndarray, shape (3,) and (3, 3)
        The inner ellipsoid.
    most : float
        Limit on the number of products.

    Raises
    ------
    InputError
        If this limit is reached.
    """
    vertices, nodes = entries.direction_map((points - center) @ np.linalg.inv(factor).T)
    node, s, t = _cells(product(normals, factor))
    for bit in reversed(range(columns.DEEPEST)):
        inner = nodes[node, 1] < 0
        child = nodes[node, 0].astype(np.int64) + ((s >> bit) & 1) + 2 * ((t >> bit) & 1)
        node = np.where(inner, child, node)
    first, last = nodes[node].astype(np.int64).T
    total = int((last - first).sum())
    if total > most:
        raise InputError("points: expected the vertices of convex pieces, found too many that are not")
    heights = np.empty(len(normals))
    order = np.argsort(node, kind="stable")
    for same in np.split(order, np.flatnonzero(np.diff(node[order])) + 1):
        leaf = points[vertices[first[same[0]] : last[same[0]]]]
        for some in slices(len(same), AT_ONCE // len(leaf)):
            heights[same[some]] = product(normals[same[some]], leaf.T).max(axis=1)
    return heights, total


def _cells(normals: Floats) -> tuple[Ints, Ints, Ints]:
    """Find the cube face and the cell of its grid through which each direction goes, numbered as in `directions`."""
    axis = np.argmax(np.abs(normals), axis=1)
    one, two = np.array([1, 0, 0])[axis], np.array([2, 2, 1])[axis]
    each = np.arange(len(normals))
    major = normals[each, axis]
    grid = columns.GRID
    cells = [
        np.clip(normals[each, k] / np.abs(major) * (grid / 2) + grid / 2, 0, grid - 1).astype(np.int64)
        for k in (one, two)
    ]
    return 2 * axis + (major < 0), cells[0], cells[1]


def starts(lengths: Ints) -> Ints:
    """Return the starts of adjacent ranges with the given lengths, followed by the end of the last range."""
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)


def _kernel_points(p: PieceArrays, maps: Maps, trees: Trees) -> tuple[Ints, Floats]:
    """Make the kernels' layout and points.

    The points of a piece are its vertices in blocks. A large polytope has its direction map instead, and a surface the
    corners of a box around it.
    """
    first = p.layout[:, columns.POINTS_FROM].copy()
    lengths = p.layout[:, columns.POINTS_TO] - first
    vertices, table_at = p.points, np.zeros(len(first), dtype=np.int64)
    if trees:
        corners = [_box_corners(p.points_of(i), p.triangles_of(i)) for i in trees]
        surfaces = list(trees)
        first[surfaces] = len(vertices) + 8 * np.arange(len(trees))
        lengths[surfaces] = 8
        table_at[surfaces] = [tree.table.ctypes.data for tree in trees.values()]
        vertices = np.concatenate([vertices, *corners])
    width = -(-lengths // columns.BLOCK) * columns.BLOCK
    room = width.copy()
    for i, (chosen, nodes) in maps.items():
        width[i] = len(chosen)
        room[i] = len(chosen) + -(-nodes.size // (3 * columns.BLOCK)) * columns.BLOCK
    begin = starts(room)
    # Copies of the last point fill up a block, since they change no maximum.
    if (lengths == columns.BLOCK).all() and np.array_equal(first, begin[:-1]):  # as for boxes
        filled = vertices[: begin[-1]]
    else:
        vertex = np.minimum(np.arange(begin[-1]) - np.repeat(begin[:-1], room), np.repeat(lengths, room) - 1)
        for i, (chosen, _) in maps.items():
            vertex[begin[i] : begin[i] + len(chosen)] = chosen
        filled = vertices[np.repeat(first, room) + vertex]
    points = records.aligned(3 * int(begin[-1]))
    points.reshape(-1, 3, columns.BLOCK)[:] = filled.reshape(-1, columns.BLOCK, 3).transpose(0, 2, 1)
    for i, (chosen, nodes) in maps.items():
        at = 3 * (begin[i] + len(chosen))
        points[at : at + nodes.size] = nodes.ravel()
    kind = p.layout[:, columns.KIND].copy()
    kind[list(maps)] = columns.MAPPED
    return np.column_stack([kind, begin[:-1], begin[:-1] + width, table_at]), points


def _parts(p: PieceArrays, trees: Trees) -> tuple[Floats, Ints]:
    """Make the table's rows for ellipsoids around parts of surfaces and inside solids, and the rows of each piece.

    Without surfaces, both arrays are empty.
    """
    start = np.zeros((len(p.layout) if trees else 0, columns.PARTS), dtype=np.int64)
    none = np.zeros((0, 3)), np.zeros((0, 3, 3))
    ellipsoids = [(*none, *none)]
    total = 0
    for i, tree in trees.items():
        center, factor = tree.outer_ellipsoids(p.frames[i, 0])
        outer, inner = len(center), len(tree.inner_center)
        # Each row is for an ellipsoid around a part, or for an ellipsoid inside a solid. The unused columns of the row
        # have an inner ellipsoid without size, which proves nothing, or the whole surface's outer ellipsoid.
        inner_center, inner_factor = np.concatenate([center, tree.inner_center]), np.zeros((outer + inner, 3, 3))
        inner_factor[outer:] = tree.inner_factor
        center = np.concatenate([center, np.repeat(p.outer_center[i : i + 1], inner, axis=0)])
        factor = np.concatenate([factor, np.repeat(p.outer_factor[i : i + 1], inner, axis=0)])
        ellipsoids.append((center, factor, inner_center, inner_factor))
        start[i] = total, total + outer, total + outer + inner
        total += outer + inner
    rows = _ellipsoid_columns(*(np.concatenate(column) for column in zip(*ellipsoids, strict=True)))
    return np.ascontiguousarray(rows[:, : columns.HOT]), start.ravel()


def _box_corners(points: Floats, triangles: Ints) -> Floats:
    """Find the corners of a box with a small surface area around all points; the triangles determine its axes."""
    single = (triangles == triangles[:, :1]).all()
    turn = least_box_axes(points[triangles[:, :1] if single else triangles].transpose(2, 1, 0))
    turned = image(turn.T, points).T
    # Bound on the rounding when points are turned and turned back by a matrix that is orthonormal up to a few
    # roundings.
    slack = 0.0 if np.array_equal(turn, np.eye(3)) else TURN_ROUNDINGS * np.abs(points).max()
    ends = np.stack([turned.min(axis=1) - slack, turned.max(axis=1) + slack])
    return np.asarray(image(turn, ends[_CORNERS, np.arange(3)]))


def _table(p: PieceArrays) -> Floats:
    """Make the kernels' table of pieces."""
    table = _ellipsoid_columns(p.outer_center, p.outer_factor, p.inner_center, p.inner_factor)
    table[:, columns.ROUNDING] = p.frames[:, 0]
    table[:, columns.FRAME_CENTER : columns.FRAME_CENTER + 12] = p.frames[:, 1:]
    return table


def _ellipsoid_columns(
    outer_center: Floats, outer_factor: Floats, inner_center: Floats, inner_factor: Floats
) -> Floats:
    """Make a table, and fill in its columns for ellipsoids: centers, shape matrices, and one-sided bounds on sizes."""
    table = np.zeros((len(outer_center), columns.COLUMNS))
    if len(table) == 0:
        return table
    # Check sizes before a product can overflow. A factor's entries are no larger than the longest semi-axis.
    largest = np.abs(outer_factor).max(axis=(1, 2), initial=0.0)
    if not (largest < LARGEST).all():
        raise _wrong_sizes(largest, largest)
    for center, factor, at_center, at_shape in (
        (outer_center, outer_factor, columns.OUTER_CENTER, columns.OUTER_SHAPE),
        (inner_center, inner_factor, columns.INNER_CENTER, columns.INNER_SHAPE),
    ):
        table[:, at_center : at_center + 3] = center
        for column, (i, j) in enumerate(_UPPER, at_shape):
            table[:, column] = dot(factor[:, i], factor[:, j])
    outer, inner = np.split(_singular_values(np.concatenate([outer_factor, inner_factor])), 2)
    slack, bend = SINGULAR_ROUNDINGS, BEND
    table[:, columns.INNER_SIGMA] = np.maximum(inner[:, -1] - slack * inner[:, 0], 1e-300) * (1 - bend)
    table[:, columns.INVERSE_INNER_SIGMA] = (1 + 2.0**-50) / table[:, columns.INNER_SIGMA]
    table[:, columns.OUTER_SIGMA] = np.maximum(outer[:, -1] - slack * outer[:, 0], 1e-300) * (1 - bend)
    table[:, columns.OUTER_RADIUS] = outer[:, 0] * (1 + slack) * (1 + bend)
    # The outer ellipsoid contains the piece, and thus the inner ellipsoid.
    table[:, columns.REACH] = (lengths(outer_center) + outer[:, 0]) * (1 + slack) * (1 + bend)
    reach = table[:, columns.REACH]
    if not ((reach < LARGEST) & (outer[:, 0] > SMALLEST)).all():
        raise _wrong_sizes(outer[:, 0], reach)
    return table


def _singular_values(factor: Floats) -> Floats:
    """Compute singular values, largest first; diagonal matrices, as for balls and boxes, need no decomposition."""
    diagonal = np.diagonal(factor, axis1=1, axis2=2)
    if np.count_nonzero(factor) == np.count_nonzero(diagonal):
        a, b, c = np.abs(diagonal).T
        most, least = np.maximum(a, b), np.minimum(a, b)
        return np.column_stack([np.maximum(most, c), np.maximum(least, np.minimum(most, c)), np.minimum(least, c)])
    return singular_values(factor)


def _wrong_sizes(least: NDArray[Any], most: NDArray[Any]) -> GeometryError:
    """Make the error for pieces that are too small or too large for the kernels."""
    return GeometryError(
        f"pieces: expected sizes between {SMALLEST:g} and {LARGEST:g} m, found {least.min():g} .. {most.max():g}"
    )


def _single(hot: Floats) -> NDArray[np.float32]:
    """Convert the kernels' most used columns to single precision if all sizes allow it; otherwise return no rows."""
    least, most = SINGLE_SIZES
    if len(hot) == 0 or hot[:, columns.OUTER_RADIUS].min() < least or hot[:, columns.REACH].max() > most:
        return np.empty((0, columns.HOT), dtype=np.float32)
    rounded = hot.copy()
    rounded[:, [columns.OUTER_RADIUS, columns.REACH, columns.INVERSE_INNER_SIGMA]] *= UP
    return np.minimum(rounded, np.finfo(np.float32).max).astype(np.float32)


def _trees(table: Floats, piece_start: Ints) -> tuple[Floats, Ints, Ints]:
    """Build a tree over the pieces of each body that has many pieces."""
    n = len(piece_start) - 1
    if np.diff(piece_start).max(initial=0) < columns.FEW:
        return np.empty(0), np.empty(0, dtype=np.int64), np.full(n, -1)
    center = table[:, columns.OUTER_CENTER : columns.OUTER_CENTER + 3]
    # An ellipsoid's half widths along the axes are the square roots of its shape matrix's diagonal. Boxes are rounded
    # outward.
    half = np.sqrt(table[:, [columns.OUTER_SHAPE, columns.OUTER_SHAPE + 3, columns.OUTER_SHAPE + 5]])
    half += tolerances.POSITION_ROUNDINGS * table[:, columns.REACH, None]
    grown: tuple[Floats, Ints, Ints] = entries.piece_trees(piece_start, center - half, center + half)
    return grown
