"""Load triangle meshes and split them into convex pieces.

A file is read completely or refused, since half a mesh could be free where the whole mesh collides.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._files import shown
from loewner._base._log import MANY_TRIANGLES, log, logged
from loewner._base._plausible import warn
from loewner._base._validate import Floats, Progress
from loewner.ellipsoids.polytopes import Polytope
from loewner.errors import GeometryError, InputError, imported
from loewner.meshes import files as mesh_files
from loewner.meshes.closed_parts import ClosedPart, closed_parts, volume
from loewner.meshes.coverage import Covering, covered
from loewner.meshes.files.parts import Triangles as Triangles
from loewner.meshes.plane_cuts import WORK, pieces_within
from loewner.meshes.protrusion import Solid, protrusion_of_hulls, protrusions

__all__ = ["convex_pieces", "load"]

T = TypeVar("T")


class Surface(Protocol):
    """The part of a `trimesh.Trimesh` that this module uses: vertices, and triangles as indices of vertices."""

    @property
    def vertices(self) -> ArrayLike:
        """Vertices, shape (v, 3), in metres, or in `units` if they are given."""

    @property
    def faces(self) -> ArrayLike:
        """Triangles, shape (t, 3), as indices of vertices."""


class Surfaces(Protocol):
    """The part of a `trimesh.Scene` that this module uses: its meshes can be joined."""

    def to_mesh(self) -> Surface:
        """Join all meshes of the scene into one."""


class Loaded(Protocol):
    """The declared result type of `trimesh.load`; only reading the file shows whether the result is a surface."""

    @property
    def bounds(self) -> ArrayLike | None:
        """Corners of the bounding box."""


Source = str | PathLike[str] | Surface | Surfaces | Loaded | tuple[ArrayLike, ArrayLike]

SUFFIXES = mesh_files.SUFFIXES

# A closed mesh is replaced with its convex hull if their volumes differ by at most this share. For collision meshes
# that are simplified hulls in float32, the volumes differ by up to 1e-3.
CONVEX_VOLUME_TOLERANCE = 1e-3

# A mesh whose size [m] is outside this range causes a warning, since its unit is probably not the metre. For
# landscapes, the warning can be filtered. A part of 0.5 m that is read as 500 m causes no warning.
USUAL_SIZES = (1e-4, 1e3)

# Default tolerance for a mesh with holes, as a share of the diagonal of its box.
OPEN_TOLERANCE = 0.02

# CoACD accepts numbers of pieces and seeds of 31 bits.
LARGEST_NUMBER = 2**31 - 1


def load(source: Source) -> tuple[Floats, Triangles]:
    """Read a mesh as triangles, in metres.

    Parameters
    ----------
    source : path, trimesh.Trimesh or trimesh.Scene, or a pair of arrays
        A file in STL, OBJ, PLY, OFF, GLB, glTF or Collada (DAE) format, a mesh or scene in memory, or a pair of arrays:
        vertices, shape (v, 3), and triangles, shape (t, 3). The meshes of a scene are placed by their transforms and
        joined. A file that states its unit of length is converted to metres; all other files are assumed to be in
        metres.

    Returns
    -------
    vertices : ndarray, shape (v, 3)
        Vertices in metres, as stored; equal vertices are not merged. Vertices that are not finite and belong to no
        triangle are left out.
    triangles : ndarray of int, shape (t, 3)

    Raises
    ------
    FileError
        If the file is missing, empty, cut short, larger than 2 GiB, not a regular file or not a mesh, or if its
        contents do not match its declarations; the message names the line or element. (An OBJ file does not declare its
        length, so a file that was cut off between two lines cannot be distinguished from a complete file.)
    GeometryError
        If a vertex of a triangle is not finite, or there are no triangles.

    Examples
    --------
    >>> import trimesh
    >>> from loewner.meshes import decomposition as meshes
    >>> _ = trimesh.creation.box((0.1, 0.2, 0.3)).export("box.obj")
    >>> vertices, triangles = meshes.load("box.obj")
    >>> vertices.max(axis=0), triangles.shape
    (array([0.05, 0.1 , 0.15]), (12, 3))
    """
    name = name_of(source)
    if isinstance(source, str | PathLike):
        vertices, triangles = mesh_files.read(_path(source))
        if len(triangles) >= MANY_TRIANGLES:
            log.info("%s: read, %d triangles", name, len(triangles))
    else:
        vertices, triangles = _in_memory(source)
    if len(triangles) == 0:
        raise GeometryError(f"{name}: expected a mesh, found {len(vertices)} vertices and no triangle")
    first, last = triangles.min(), triangles.max()
    if first < 0 or last >= len(vertices):
        raise GeometryError(f"{name}: expected triangles of vertices 0..{len(vertices) - 1}, found {first}..{last}")
    return _used_and_finite(vertices, triangles, name)


def _used_and_finite(vertices: Floats, triangles: Triangles, name: str) -> tuple[Floats, Triangles]:
    """Drop vertices that are not finite and have no triangle; scanners write such vertices where they saw nothing."""
    if np.isfinite(vertices).all():
        return vertices, triangles
    finite = np.logical_and.reduce(np.isfinite(vertices), axis=1)
    if not finite[triangles].all():
        bad = int(triangles[~finite[triangles]].min())
        raise GeometryError(f"{name}: expected finite vertices, found {vertices[bad].tolist()} at vertex {bad}")
    return vertices[finite], (np.cumsum(finite) - 1)[triangles]


def _in_memory(source: Any) -> tuple[Floats, Triangles]:
    """Return the vertices in metres and the triangles of a trimesh.Trimesh, a trimesh.Scene or a pair of arrays."""
    if isinstance(source, tuple) and len(source) == 2:
        source = SimpleNamespace(vertices=source[0], faces=source[1])
    try:
        if hasattr(source, "to_mesh"):
            _expect_one_unit(source)
        mesh = source.to_mesh() if hasattr(source, "to_mesh") else source
    except InputError:
        raise
    except Exception as error:  # from a scene made by the caller; trimesh has no errors of its own
        raise GeometryError(f"mesh: expected a joinable scene, found {type(error).__name__}: {error}") from None
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise InputError(
            f"mesh: expected a path, a trimesh.Trimesh or Scene, or a pair of arrays, found {type(source).__name__}"
        )
    vertices = _validate.float_array(mesh.vertices, "mesh.vertices")
    triangles = _validate.plain_array(mesh.faces, "mesh.faces")
    for array, what in ((vertices, "vertices"), (triangles, "faces")):
        if array.ndim != 2 or array.shape[1] != 3:
            raise GeometryError(f"mesh.{what}: expected shape (n, 3), found {_validate.shape_text(array.shape)}")
    if len(triangles) and triangles.dtype.kind not in "iu":
        raise GeometryError(f"mesh.faces: expected whole numbers, found dtype {triangles.dtype}")
    return vertices * _metres(mesh), np.array(triangles, dtype=np.int64)


def _expect_one_unit(scene: Any) -> None:
    """Refuse a scene of meshes with different units: trimesh joins them without converting any."""
    shapes = [mesh for mesh in getattr(scene, "geometry", {}).values() if hasattr(mesh, "faces")]
    units = {_metres(mesh): str(getattr(mesh, "units", None)) for mesh in shapes}
    if len(units) > 1:
        raise GeometryError(
            f"mesh: expected a scene with one unit of length, found {', '.join(units.values())}; see mesh.convert_units"
        )


def _ask_about_units(vertices: Floats, name: str) -> None:
    """Warn about a size that suggests a unit of length other than metres; `vertices` are already scaled."""
    size = float(np.ptp(vertices, axis=0).max())
    if not USUAL_SIZES[0] <= size <= USUAL_SIZES[1] and size > 0:
        unit, factor = ("in millimetres", 0.001) if size > 1 else ("scaled to metres twice", 1000)
        warn(
            f"{name}: {size:.3g} m across, all lengths being metres. Is it {unit}? Then give scale={factor} "
            f"(--scale {factor})"
        )


def convex_pieces(
    source: Source,
    *,
    scale: ArrayLike = 1.0,
    decompose: bool = True,
    cover: bool = True,
    tolerance: float | None = None,
    threshold: float = 0.05,
    max_pieces: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[list[Floats], Covering]:
    """Split a mesh into convex pieces.

    Parameters
    ----------
    source : path, trimesh.Trimesh or trimesh.Scene
        See `load`.
    scale : float, or array_like of shape (3,)
        Factor for all lengths, or one factor for each axis of the mesh; a negative factor mirrors the mesh.
    decompose : bool
        Whether to split the mesh. If false, the only piece is the mesh's convex hull, which contains the mesh.
    cover : bool
        Whether to grow the pieces of a decomposition until they contain the mesh's whole surface.
    tolerance : float, optional
        The largest distance by which the pieces may stick out of the mesh, in metres. If a tolerance is given, the mesh
        is cut along planes instead of by CoACD, either until no piece sticks out farther than the tolerance, or until
        `max_pieces` is reached. If a piece still sticks out farther, a warning states how far. A mesh with holes is
        always cut along planes; the default tolerance is then 2 % of the diagonal of the bounding box, or more if 2 %
        would take too much work.
    threshold : float
        CoACD's bound on concavity, from 0.01 to 1. A smaller bound gives more pieces and a closer fit. The bound
        applies only to meshes without holes.
    max_pieces : int, optional
        Limit on the number of pieces of a decomposition.
    seed : int
        Seed of CoACD's search.
    progress : callable, optional
        Called as ``progress(done, total)`` after each step; the ratio done / total never decreases. If the mesh is cut
        along planes, each step represents a hundredth of the mesh's surface.

    Returns
    -------
    pieces : list of ndarray, each of shape (v_i, 3)
        Vertices of each piece's hull, in metres.
    covering : Covering

    Raises
    ------
    FileError, GeometryError, MissingExtraError
        As for `load`; GeometryError also for a flat mesh.

    Warns
    -----
    UserWarning
        If a mesh to be decomposed has holes, since a body inside may then be FREE; if the scaled mesh is more than 1000
        m or less than 0.1 mm across, since its unit may not be the metre; or if the pieces stick out by more than
        `tolerance`.

    Notes
    -----
    The closed parts of a mesh are decomposed one by one, even if they overlap or share edges or corners. A part counts
    as convex if its volume equals the volume of its hull to within 1e-3; the hull is then the only piece of the part. A
    part of negative volume is a cavity of the part in which it lies.

    Covering is proven, not sampled. A triangle lies in a convex piece if its corners do. A triangle that lies in no
    piece is halved until its parts lie in a piece, nearly lie in one, or are smaller than 0.25 % of the mesh's
    diagonal. With `cover`, the remaining parts are added to the nearest piece. Without `cover`, the distance of the
    remaining parts from the pieces is measured at the parts' corners. The distance to a convex piece is a convex
    function, and is therefore greatest at a corner.

    References
    ----------
    Wei, Liu, Ling and Su (2022), "Approximate convex decomposition for 3D meshes with
    collision-aware concavity and tree search", ACM Trans. Graph. 41(4), doi:10.1145/3528223.3530103.

    Examples
    --------
    >>> import trimesh
    >>> from loewner.meshes import decomposition as meshes
    >>> pieces, covering = meshes.convex_pieces(trimesh.creation.box((0.1, 0.2, 0.3)))
    >>> len(pieces), pieces[0].shape, covering.exact
    (1, (8, 3), True)
    """
    options = Options(scale, decompose, cover, tolerance, threshold, max_pieces, seed, progress)
    polytopes, covering = convex_polytopes(source, options)
    return [np.array(piece.vertices) for piece in polytopes], covering


def scaled_mesh(source: Source, scale: ArrayLike) -> tuple[Floats, Triangles]:
    """Read a mesh as `load` does, scale it to metres, and warn about doubtful sizes."""
    factors = _validate.float_array(scale, "scale")
    factors = _validate.finite_array(factors, "scale", (3,) if factors.ndim else ())
    if not factors.all():
        raise InputError(f"scale: expected factors other than 0, found {_validate.short(scale)}")
    vertices, triangles = load(source)
    name = name_of(source)
    with np.errstate(over="ignore"):
        vertices = vertices * factors
    vertices, triangles = _used_and_finite(vertices, triangles, name)
    _ask_about_units(vertices[triangles].reshape(-1, 3), name)
    return vertices, triangles


def name_of(source: Source) -> str:
    """Return the name of a mesh for messages."""
    return shown(_path(source)) if isinstance(source, str | PathLike) else "mesh"


def _path(source: str | PathLike[str]) -> Path:
    """Return the path of a source; an invalid name is reported when the file is read."""
    return Path(source) if isinstance(source, str | Path) else _validate.path(source, "source")


class Options(NamedTuple):
    """The options of `convex_pieces`."""

    scale: ArrayLike
    decompose: bool
    cover: bool
    tolerance: float | None
    threshold: float
    max_pieces: int | None
    seed: int
    progress: Progress | None

    def checked(self) -> Options:
        """Check all options except the scale, which `scaled_mesh` checks."""
        threshold = _validate.positive_scalar(self.threshold, "threshold")
        if not 0.01 <= threshold <= 1:
            raise InputError(f"threshold: expected 0.01 to 1, found {threshold:g}")
        within, most = self.tolerance, self.max_pieces
        return self._replace(
            threshold=threshold,
            tolerance=None if within is None else _validate.positive_scalar(within, "tolerance"),
            max_pieces=None if most is None else _validate.whole_number(most, "max_pieces", 1, LARGEST_NUMBER),
            seed=_validate.whole_number(self.seed, "seed", 0, LARGEST_NUMBER),
            decompose=_validate.flag(self.decompose, "decompose"),
            cover=_validate.flag(self.cover, "cover"),
            progress=_validate.callback(self.progress, "progress"),
        )


def convex_polytopes(source: Source, options: Options) -> tuple[list[Polytope], Covering]:
    """Split a mesh as `convex_pieces` does, and keep the hulls' faces; error messages begin with the mesh's name."""
    try:
        return _polytopes(source, options)
    except GeometryError as error:
        name, text = name_of(source), str(error)
        raise GeometryError(text if text.startswith(name) else f"{name}: {text}") from None


def _polytopes(source: Source, options: Options) -> tuple[list[Polytope], Covering]:
    options = options.checked()
    decompose, within, name = options.decompose, options.tolerance, name_of(source)
    vertices, triangles = scaled_mesh(source, options.scale)
    vertices, triangles = welded(vertices, triangles)
    parts = closed_parts(vertices, triangles) or []  # empty for a mesh that is not closed
    if parts:
        triangles = np.concatenate([part.triangles for part in parts])  # with outward orientation
    mesh_volume = sum(part.volume for part in parts) if parts else np.nan
    solid = Solid(vertices[triangles], closed=bool(parts))
    hull = Polytope.from_points(vertices)
    hulls = _hulls_of_parts(vertices, parts, hull)
    convex = bool(hulls) and all(map(_is_hull_of, parts, hulls))

    if not decompose or convex:
        pieces = hulls if decompose else [hull]
        kind = "convex" if convex and len(pieces) == len(hulls) else "hull"
        corners = [vertices[part.triangles] for part in parts]
        reached = protrusion_of_hulls(corners, pieces) if kind == "convex" else _protrusion(pieces, solid)
        if within is None or reached <= within or not decompose:
            excess = _excess_volume(pieces, mesh_volume)
            return _told(name, pieces, Covering(kind, True, 0.0, excess, len(vertices), reached), within)

    if _has_holes(triangles):
        warn(
            f"{name}: has holes, so that a body inside it may be FREE; close the holes, use the triangles as they are "
            "(Body.from_surface, --model surface), which is exact and fast, or the hull (decompose=False, --hull)"
        )
        if within is None:  # CoACD would first make the mesh solid, which is slow and less accurate
            within = OPEN_TOLERANCE * _size(vertices)
    if within is None:
        with logged("%s: decomposing %d triangles", name, len(triangles)):
            pieces = _coacd_by_parts(vertices, triangles, parts, hulls, options)
        pieces, covering = covered(vertices[triangles], pieces, _size(vertices), grow=options.cover)
        reached = _protrusion(pieces, solid)
    else:
        surfaces = [vertices[part.triangles] for part in parts] if hulls else [vertices[triangles]]
        with logged("%s: cutting %d triangles", name, len(triangles)):
            work = np.inf if solid.closed else WORK
            cells = pieces_within(surfaces, solid, within, options.max_pieces, options.progress, work)
        pieces = [cell.hull for cell in cells]
        # Each cell already lies in its hull, so no hull has to grow.
        surface = np.concatenate([cell.triangles for cell in cells])
        _, covering = covered(surface, pieces, _size(vertices), grow=False)
        reached = min(_protrusion(pieces, solid), max(cell.bound for cell in cells))
    excess = _excess_volume(pieces, mesh_volume)
    covering = replace(covering, excess_volume=excess, max_protrusion=reached)
    return _told(name, pieces, covering, options.tolerance)


def _told(
    name: str, pieces: list[Polytope], covering: Covering, tolerance: float | None
) -> tuple[list[Polytope], Covering]:
    """Return pieces and covering, and warn if the pieces stick out by more than a tolerance."""
    if covering.kind == "decomposition":
        log.info("%s: %d pieces that stick out by up to %.3g m", name, len(pieces), covering.max_protrusion)
    if tolerance is not None and covering.max_protrusion > tolerance:
        cures = ["more pieces (max_pieces)" if covering.kind == "decomposition" else "decompose=True"]
        cures += ["a closed mesh"] * bool(np.isnan(covering.excess_volume))
        warn(
            f"{name}: expected pieces that stick out by at most tolerance={tolerance:.4g} m, found {len(pieces)} that "
            f"stick out by up to {covering.max_protrusion:.4g} m; {' or '.join(cures)} may help"
        )
    return pieces, covering


def _protrusion(pieces: list[Polytope], solid: Solid) -> float:
    """Return a proven bound on how far pieces stick out."""
    return float(protrusions(pieces, solid, together=True).bounds.max())


def _excess_volume(hulls: list[Polytope], whole: float) -> float:
    """Compute by what share the pieces' volume exceeds the mesh's volume; NaN if the mesh has no volume."""
    return float(sum(_hull_volume(h) for h in hulls) / whole - 1) if whole > 0 else float("nan")


def trimesh_scene(meshes: Mapping[str, tuple[Floats, Triangles]]) -> Any:
    """Make a `trimesh.Scene` from vertices and triangles, keyed by name."""
    trimesh = imported("trimesh", "making a scene of trimesh needs trimesh", "meshes")
    scene = trimesh.Scene()
    for name, (vertices, triangles) in meshes.items():
        scene.add_geometry(trimesh.Trimesh(vertices, triangles, process=False), node_name=name, geom_name=name)
    return scene


# -- files --------------------------------------------------------------------------------------


def _metres(mesh: Any) -> float:
    """Return the metres per unit of length of a mesh that states its unit, as Collada does."""
    units = getattr(mesh, "units", None)
    if units is None or units == "meters":
        return 1.0
    trimesh = imported("trimesh", "converting a mesh's unit of length needs trimesh", "meshes")
    try:
        return float(trimesh.units.unit_conversion(units, "meters"))
    except (KeyError, ValueError):
        raise GeometryError(f"mesh: expected a known unit of length, found {units!r}") from None


# -- shape of a mesh ----------------------------------------------------------------------------


def _size(vertices: Floats) -> float:
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def welded(vertices: Floats, triangles: Triangles) -> tuple[Floats, Triangles]:
    """Merge equal vertices; then drop triangles whose corners are not distinct, and unused vertices."""
    vertices, index = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if len(triangles) == 0:
        raise GeometryError(f"mesh: expected triangles, found only ones with equal corners, {len(vertices)} points")
    used, triangles = np.unique(triangles, return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3)


def _has_holes(triangles: Triangles) -> bool:
    """Return whether a surface has a border; closed parts may share edges, and triangles may be reversed."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts % 2).any())


def _hull_volume(hull: Polytope) -> float:
    return abs(volume(hull.vertices, hull.simplices))


def _is_hull_of(part: ClosedPart, hull: Polytope) -> bool:
    return bool(part.volume >= (1 - CONVEX_VOLUME_TOLERANCE) * _hull_volume(hull))


def _hulls_of_parts(vertices: Floats, parts: list[ClosedPart], hull: Polytope) -> list[Polytope]:
    """Compute the hull of each closed part (`hull` if there is only one part); return no hulls if a part is flat."""
    if len(parts) == 1:
        return [hull]
    try:
        return [Polytope.from_points(vertices[np.unique(part.triangles)]) for part in parts]
    except GeometryError:
        return []


def _interruptible(work: Callable[[], T]) -> T:
    """Run foreign code that may take minutes, but let an interrupt take effect immediately.

    The code itself cannot be stopped: after an interrupt, it runs to its end on its own thread, and its result is
    discarded.
    """
    from concurrent.futures import Future  # imported late, since loading bodies does not need it

    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    thread = threading.Thread(target=run, name="loewner decomposition", daemon=True)
    thread.start()
    while not future.done():
        thread.join(0.05)
    return future.result()


def _coacd_by_parts(
    vertices: Floats, triangles: Triangles, parts: list[ClosedPart], hulls: list[Polytope], options: Options
) -> list[Polytope]:
    """Decompose each nonconvex closed part, or the whole mesh if its parts are unknown or too many."""
    threshold, most, seed = options.threshold, options.max_pieces, options.seed
    if not hulls or (most is not None and len(parts) > most):
        return _at_most(most, _coacd(vertices, triangles, threshold, most, seed))
    curved = [not _is_hull_of(part, hull) for part, hull in zip(parts, hulls, strict=True)]
    pieces = [hull for hull, left in zip(hulls, curved, strict=True) if not left]
    size = _size(vertices)
    for k, part in enumerate(part for part, left in zip(parts, curved, strict=True) if left):
        # Each part gets an even share of the remaining pieces; the threshold is relative to the whole mesh.
        share = None if most is None else (most - len(pieces)) // (sum(curved) - k)
        corners, own = np.unique(part.triangles, return_inverse=True)
        relative = min(1.0, threshold * size / _size(vertices[corners]))
        pieces += _coacd(vertices[corners], own.reshape(-1, 3), relative, share, seed)
        if options.progress is not None:
            options.progress(k + 1, sum(curved))
    return _at_most(most, pieces)


def _at_most(most: int | None, pieces: list[Polytope]) -> list[Polytope]:
    """Join pairs of pieces, in order of the size of their common box, until the number of pieces is within a limit.

    CoACD keeps unconnected parts separate regardless of the limit.
    """
    pieces = list(pieces)
    while most is not None and len(pieces) > most:
        lower, upper = (np.array([f(piece.vertices, axis=0) for piece in pieces]) for f in (np.min, np.max))
        box = np.maximum(upper[:, None], upper) - np.minimum(lower[:, None], lower)
        size = np.linalg.norm(box, axis=2) + np.diag(np.full(len(pieces), np.inf))
        a, b = np.unravel_index(size.argmin(), size.shape)
        joined = Polytope.from_points(np.concatenate([pieces[a].vertices, pieces[b].vertices]))
        pieces = [piece for k, piece in enumerate(pieces) if k not in (a, b)] + [joined]
    return pieces


def _coacd(vertices: Floats, triangles: Triangles, threshold: float, most: int | None, seed: int) -> list[Polytope]:
    coacd = imported("coacd", "decomposing meshes needs coacd", "meshes")
    coacd.set_log_level("error")
    middle, size = vertices.mean(axis=0), _size(vertices)  # CoACD's tolerances suit meshes of size 1 at the origin
    mesh = coacd.Mesh((vertices - middle) / size, triangles)
    parts = _interruptible(
        lambda: coacd.run_coacd(mesh, threshold=threshold, max_convex_hull=-1 if most is None else most, seed=seed)
    )
    hulls = []
    for points, _ in parts:
        with suppress(GeometryError):  # flat slivers; covering assigns their surface to a neighbour, and measures it
            hulls.append(Polytope.from_points(np.asarray(points) * size + middle))
    if not hulls:
        raise GeometryError("mesh: expected solid pieces from CoACD, found none; decompose=False takes the convex hull")
    return hulls
