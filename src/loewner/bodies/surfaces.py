"""Make pieces from surfaces: their triangles, their ellipsoids, and whether they enclose a solid."""

from __future__ import annotations

import numpy as np

from loewner._base import _memory, _validate
from loewner._base._matrices import normals_of, product
from loewner._base._plausible import warn
from loewner._base._validate import Floats, Ints
from loewner._kernels import columns
from loewner._native import entries
from loewner.bodies.layout import PieceArrays, laid_out
from loewner.bodies.surface_trees import around_point, around_sums
from loewner.ellipsoids.polytopes import FLATNESS
from loewner.errors import GeometryError

# Limits on the sizes of surfaces [m]; for boxes around triangles, lengths are squared in single precision.
SMALLEST, LARGEST = 1e-12, 1e12

# A mesh is nearly closed if its share of open edges is at most FEW_OPEN, and the share of its area that does not cancel
# is at most NEARLY_CANCELLED.
FEW_OPEN, NEARLY_CANCELLED = 0.25, 0.2

# Approximate bytes of a triangle in all arrays and the tree.
TRIANGLE_BYTES = 350

# Relative thickness of a flat surface's outer ellipsoid: above rounding errors, but too small to matter.
THICKNESS = 1e-6


def surface_pieces(
    name: str, vertices: Floats, triangles: Ints, radius: float, solid: bool | None, tol: float
) -> PieceArrays:
    """Make a body of one piece: all triangles of a mesh, thickened by a radius.

    Parameters
    ----------
    name : str
        Name of the mesh in messages.
    vertices, triangles : ndarray
        A mesh as returned by `meshes.load`.
    radius : float
        Radius in metres, >= 0.
    solid : bool or None
        Whether the piece includes the space around which the mesh winds. If None, the piece includes this space if the
        mesh is closed.
    tol : float
        Upper limit on the certified log-volume gap of the outer ellipsoid.

    Raises
    ------
    GeometryError
        If the mesh is too small or too large, if the radius is too large, or if `solid` is true and the mesh is open.
    """
    _memory.expect_left(len(triangles) * TRIANGLE_BYTES, f"{name}: {len(triangles)} triangles or balls")
    vertices, triangles = _merged(vertices, triangles)
    expect_sizes(vertices)
    expect_radius(radius)
    if solid:
        expect_closed(name, vertices, triangles)
    elif solid is None:
        edges = _open_edges(len(vertices), triangles)
        solid = len(edges) == 0
        if not solid and nearly_closed(vertices, triangles, len(edges)):
            warn(
                f"{name}: nearly closed, but for {_told(vertices, edges)}. An open mesh has no inside, so that a body "
                "within it counts as free. Close the mesh, or pass solid=False if that is intended"
            )
    center, factor, gap = _outer(vertices, tol)
    if radius > 0:
        center, factor, gap = _with_radius(center, factor, gap, radius)
    return laid_out(
        columns.SOLID if solid else columns.SURFACE,
        (vertices[triangles[:1, 0]], around_point(radius)[None]),
        (center[None], factor[None]),
        np.array([[0.0, gap]]),
        point_start=np.array([0, len(vertices)]), points=vertices, radius=radius,
        triangle_start=np.array([0, len(triangles)], dtype=np.int64), triangles=triangles,
    )  # fmt: skip


def _merged(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Drop unused vertices and merge equal ones, so that triangles still share their vertices after a motion."""
    used, numbers = np.unique(triangles, return_inverse=True)
    vertices = vertices[used] + 0.0  # without negative zeros
    count, number = entries.equal_vertices(vertices)
    points = np.empty((count, 3))
    points[number] = vertices
    return points, np.ascontiguousarray(number[numbers.reshape(-1, 3)], dtype=np.int64)


def expect_sizes(vertices: Floats) -> None:
    """Refuse sizes that are too small or too large for kernels."""
    size = float(np.abs(vertices).max())
    across = float(np.ptp(vertices, axis=0).max())
    if not size <= LARGEST or 0 < across < SMALLEST:
        raise GeometryError(
            f"mesh: expected sizes between {SMALLEST:g} and {LARGEST:g} m, found {across:g} m across, "
            f"coordinates up to {size:g} m"
        )


def expect_radius(radius: float) -> None:
    """Refuse a radius that is too large for kernels."""
    if radius > LARGEST:
        raise GeometryError(f"radius: expected at most {LARGEST:g} m, found {radius:g}")


def expect_closed(name: str, vertices: Floats, triangles: Ints) -> None:
    """Refuse a mesh that is open or inconsistently oriented, since it encloses no space."""
    edges = _open_edges(len(vertices), triangles)
    if len(edges) == 0:
        return
    raise GeometryError(
        f"solid: expected a closed mesh with triangles turned alike, found {_told(vertices, edges)}, in {name}; "
        "solid=False uses only the triangles"
    )


def _told(vertices: Floats, edges: Ints) -> str:
    """Describe the number of open edges and the position of the first one."""
    a, b = (_validate.short(np.round(vertices[v], 6).tolist()) for v in edges[0])
    return (
        f"{len(edges)} edges that do not join triangles turned alike (holes, or flipped triangles), the first from "
        f"{a} to {b}"
    )


def nearly_closed(vertices: Floats, triangles: Ints, open_edges: int) -> bool:
    """Return whether a mesh with open edges was probably meant to be closed.

    If so, few of its edges are open, and the area vectors of its triangles nearly cancel. In a closed mesh, these
    vectors cancel exactly.
    """
    areas = normals_of(vertices[triangles])
    total = float(np.linalg.norm(areas, axis=1).sum())
    left = float(np.linalg.norm(areas.sum(axis=0)))
    return open_edges <= FEW_OPEN * 1.5 * len(triangles) and left <= NEARLY_CANCELLED * total


def _open_edges(count: int, triangles: Ints) -> Ints:
    """Find the edges, as rows of two vertices, that triangles traverse more often in one direction than in the other.

    Adjacent triangles must share vertices. If a mesh has no open edges, its winding number is an integer at every point
    that is not on the surface.
    """
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    keys = np.sort((low * count + high) * 2 + (start < end))
    edge = keys >> 1
    first = np.flatnonzero(np.concatenate([[True], edge[1:] != edge[:-1]]))
    forth = np.add.reduceat(keys & 1, first)
    passed = np.diff(np.append(first, len(keys)))
    odd = edge[first[2 * forth != passed]]
    odd = np.column_stack([odd // count, odd % count])
    return np.asarray(odd[odd[:, 0] != odd[:, 1]], dtype=np.int64)  # without edges of zero length


def _outer(vertices: Floats, tol: float) -> tuple[Floats, Floats, float]:
    """Fit the smallest ellipsoid around points; if the points are flat, the ellipsoid is only nearly the smallest."""
    center, factor = np.empty(3), np.empty((3, 3))
    points = vertices
    for _ in range(2):
        if len(points) > 3:
            code, gap, _, _, _, _ = entries.fit_outer(points, tol, FLATNESS, center, factor)
            if code == 0:
                return center, factor, float(gap)
        points = np.concatenate([vertices, _thickened(vertices)])
    raise GeometryError(f"mesh: expected vertices that an ellipsoid can be fitted around, found {len(vertices)}")


def _thickened(vertices: Floats) -> Floats:
    """Return two points for each direction in which a set is flat, on both sides of the set's center."""
    middle = vertices.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((vertices - middle).T, bias=True))
    lengths = np.sqrt(np.maximum(spread, 0.0))
    thick = max(THICKNESS * lengths[-1], 1e-10 * float(np.abs(vertices).max()), SMALLEST)
    flat = axes.T[lengths < thick] * thick
    return np.concatenate([middle + flat, middle - flat])


def _with_radius(center: Floats, factor: Floats, gap: float, radius: float) -> tuple[Floats, Floats, float]:
    """Compute an ellipsoid around the sum of an ellipsoid and a ball, and a bound on its log-volume gap."""
    grown = around_sums((product(factor, factor.T))[None], np.array([radius]))[0]
    volumes = np.linalg.slogdet(grown)[1] - np.linalg.slogdet(factor)[1]
    return center, grown, gap + float(volumes)
