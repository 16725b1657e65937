"""Choose the body of a link's mesh: its hull, or the solid that it encloses."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from loewner._base._matrices import components, lengths
from loewner._base._plausible import warn
from loewner._base._validate import Floats, Ints
from loewner.bodies import Body, packed_of
from loewner.bodies.surfaces import nearly_closed
from loewner.ellipsoids.polytopes import Polytope
from loewner.errors import GeometryError
from loewner.meshes import decomposition as meshes
from loewner.meshes.closed_parts import ClosedPart, closed_parts
from loewner.meshes.coverage import Covering
from loewner.meshes.protrusion import Solid, protrusions

# A hull is close to its mesh if it sticks out by at most NEAR [m], or by at most the share NEAR_SHARE of the mesh's
# diameter.
NEAR, NEAR_SHARE = 1e-3, 0.01

# Relative accuracy of bounds. It is so coarse that the search ends as soon as a hull is found to stick out too far. No
# bound exceeds a distance by this factor, and no distance times this factor overflows.
AT_ONCE = 1e12

# A part has no inside if its volume is less than NO_INSIDE times the cube of the mesh's diameter. This limit is far
# above rounding errors.
NO_INSIDE = 1e-12

# Names of the bodies of open meshes, in `described` and in the warning.
OPEN_HULL, CAPPED = "hull of an open mesh", "solid of a nearly closed mesh"
OPENED = {CAPPED: "nearly closed, whose holes were closed", OPEN_HULL: "open, whose hulls were taken"}

Choice = Literal["hull", "solid", "open"]


def mesh_body(mesh: Any, model: str, tol: float) -> Body:
    """Make a body from a mesh that `Body.from_mesh` accepts, in one of the representations `link_bodies.MODELS`."""
    if model == "surface":
        return Body.from_surface(mesh)
    if model != "auto":
        return Body.from_mesh(mesh, decompose=model == "pieces", tol=tol)
    choice, closed, edges = hull_or_solid(*meshes.load(mesh))
    if choice == "hull":
        return Body.from_mesh(closed, decompose=False, tol=tol)
    body = Body.from_surface(closed, solid=True) if choice == "solid" else Body.from_points(closed[0], tol=tol)
    if choice == "solid" and edges == 0:
        return body
    # The distance by which a body sticks out of a surface without an inside is of little use, and slow to compute.
    kind = "solid" if choice == "solid" else "hull"
    return Body(packed_of(body), Covering(kind, True, 0.0, excess_volume=np.nan, samples=len(closed[0])))


def described(body: Body) -> str:
    """Describe the body of a mesh in a few words; the words before the first comma name the kind of body."""
    first, covering = body.pieces[0], body.covering
    if first.triangles is not None and first.kind in ("surface", "solid"):
        kind = "surface without an inside" if first.kind == "surface" else "solid" if covering is None else CAPPED
        return f"{kind}, {len(first.triangles):,} triangles"
    if covering is None:
        return first.kind
    reach = f"out by up to {1e3 * covering.max_protrusion:.3g} mm"
    if covering.kind == "decomposition" or len(body.pieces) > 1:
        return f"pieces, {len(body.pieces)} that stick {reach}"
    return OPEN_HULL if np.isnan(covering.excess_volume) else f"hull, sticks {reach}"


def warn_of_open_meshes(title: object, named: Iterable[tuple[str, str]], instead: str) -> None:
    """Issue one warning that names all meshes that are not closed.

    Parameters
    ----------
    title : object
        The file or the model, for the message.
    named : iterable of (str, str)
        Names of meshes, and the results of `described`.
    instead : str
        The option that keeps the triangles unchanged.
    """
    kinds = [(name, words.partition(",")[0]) for name, words in named]
    names_by_kind = {kind: [name for name, own in kinds if own == kind] for kind in OPENED}
    groups = [f"{len(names)} {OPENED[kind]} ({', '.join(names)})" for kind, names in names_by_kind.items() if names]
    if groups:
        warn(
            f"{title}: expected closed meshes, found {' and '.join(groups)}; a body wholly within such a mesh "
            f"collides, but would not collide with the triangles alone, that is, with {instead}; inspect these meshes"
        )


def hull_or_solid(vertices: Floats, triangles: Ints) -> tuple[Choice, tuple[Floats, Ints], int]:
    """Choose between a mesh's hull, which can be much larger than the mesh, and the solid that the mesh encloses.

    Parameters
    ----------
    vertices, triangles : ndarray
        A mesh as returned by `meshes.load`.

    Returns
    -------
    choice : {"hull", "solid", "open"}
        "hull": the mesh is closed, and its hull is proven to stick out by at most `NEAR`, or by at most the share
        `NEAR_SHARE` of the diameter. "solid": the mesh is closed, but no such bound on its hull is proven. "open": the
        mesh has no inside.
    mesh : tuple of ndarray
        Vertices and triangles; holes of a nearly closed mesh have been closed. The triangles of each closed part face
        outward, unless the part is a cavity. A part is a cavity of a larger part if all of its tested points lie in the
        larger part.
    edges : int
        The number of edges at which the mesh was open.
    """
    vertices, triangles = meshes.welded(vertices, triangles)
    start, end = _boundary(triangles)
    edges = len(np.unique(np.column_stack([start, end]), axis=0))
    if edges and nearly_closed(vertices, triangles, edges):
        vertices, triangles = _capped(vertices, triangles, start, end)
    parts = closed_parts(vertices, triangles)
    if parts is None:
        return "open", (vertices, triangles), edges
    hull = Polytope.from_points(vertices)
    far = hull.vertices[lengths(hull.vertices - hull.vertices[0]).argmax()]
    diameter = float(lengths(hull.vertices - far).max())  # or slightly less, which is safe
    if not all(_has_inside(vertices, part, NO_INSIDE * diameter**3) for part in parts):
        return "open", (vertices, triangles), edges
    triangles = np.concatenate([part.triangles for part in parts])
    limit = max(NEAR, NEAR_SHARE * diameter)
    reached = protrusions([hull], Solid(vertices[triangles], closed=True), floor=limit, relative=AT_ONCE)
    return "hull" if reached.bounds.max() <= limit else "solid", (vertices, triangles), edges


def _boundary(triangles: Ints) -> tuple[Ints, Ints]:
    """Find edges that triangles traverse more often from `start` to `end` than back, once per surplus traversal."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    count = int(triangles.max()) + 1
    edge, of = np.unique(np.minimum(start, end) * count + np.maximum(start, end), return_inverse=True)
    more = np.bincount(of, np.where(start < end, 1.0, -1.0)).astype(np.int64)  # the sums are small integers
    low, high = np.repeat(edge, np.abs(more)) // count, np.repeat(edge, np.abs(more)) % count
    forth = np.repeat(more, np.abs(more)) > 0
    return np.where(forth, low, high), np.where(forth, high, low)


def _capped(vertices: Floats, triangles: Ints, start: Ints, end: Ints) -> tuple[Floats, Ints]:
    """Close a mesh with triangles from each connected part of its boundary to the middle of that part.

    The boundary leaves each vertex as often as it enters the vertex, so the new triangles close the mesh. The new
    triangles lie in the hull of the mesh, and the mesh's own triangles remain.
    """
    used, ends = np.unique(np.concatenate([start, end]), return_inverse=True)
    ends = ends.reshape(2, -1)
    part = components(len(used), *ends)
    sums = [np.bincount(part, vertices[used, axis]) for axis in range(3)]
    middles = np.column_stack(sums) / np.bincount(part)[:, None]
    caps = np.column_stack([end, start, len(vertices) + part[ends[0]]])
    return np.concatenate([vertices, middles]), np.concatenate([triangles, caps])


def _has_inside(vertices: Floats, part: ClosedPart, least: float) -> bool:
    """Return whether a closed part has a volume or is flat; a curved sheet with two sides has no inside."""
    if part.volume > least:
        return True
    try:
        Polytope.from_points(vertices[np.unique(part.triangles)])
    except GeometryError:
        return True
    return False
