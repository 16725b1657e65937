"""The public classes `Body` and `Bodies`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._log import MANY_TRIANGLES, logged
from loewner._base._matrices import dot, lengths
from loewner._base._pictures import COLOURS, bodies, pictured
from loewner._base._read_only import KeepsReadOnly
from loewner._base._rotations import pose_of
from loewner._base._validate import Floats, Ints, Progress
from loewner._kernels import columns, tolerances
from loewner.bodies import sensed, surfaces
from loewner.bodies.depth_images import points_of
from loewner.bodies.kinds import KIND_NAMES
from loewner.bodies.layout import laid_out
from loewner.bodies.pack import Packed, as_one, empty, join, moved, take
from loewner.bodies.primitives import CLOSED_FORM_ROUNDING, primitives
from loewner.bodies.triangulated import MANY_PIECES, for_pictures
from loewner.ellipsoids import fits
from loewner.ellipsoids.ellipsoids import Ellipsoids, trusted
from loewner.ellipsoids.polytopes import Hulls, Polytope, box_hull, hulls
from loewner.errors import BodyIndexError, FileError, GeometryError, InputError
from loewner.meshes import decomposition as meshes
from loewner.meshes.coverage import Covering, CoverReport

# Longest allowed edge of the cube that represents a half-space [m]; contact is accurate to about 1e-12 of the edge.
LARGEST_EXTENT = 1e9


@dataclass(frozen=True, eq=False, repr=False)
class Piece(_validate.Brief, KeepsReadOnly):
    """One piece of a body, either convex or a surface.

    Attributes
    ----------
    kind : str
        "polytope", "ellipsoid", "cylinder", "cone", "capsule" or "sphere"; or, for a piece made by `Body.from_surface`,
        "surface" (only the triangles) or "solid" (the triangles and the space that they enclose).
    vertices : ndarray, shape (v, 3), or None
        Extreme points of a polytope, or vertices of a surface; None for curved pieces.
    normals, offsets : ndarray, shapes (f, 3) and (f,), or None
        Unit outward normals and offsets of a polytope's faces; the polytope is {x : normals @ x <= offsets}.
    triangles : ndarray of int, shape (t, 3), or None
        Indices into `vertices`. The triangles of a polytope's surface are counter-clockwise when seen from outside; the
        triangles of a surface are oriented as in the mesh.
    inner, outer : Ellipsoids
        The largest ellipsoid inside the piece, and the smallest ellipsoid around it. For a surface, the inner ellipsoid
        is not the largest possible. For an open surface without a radius, the inner ellipsoid is a point: its semi-axes
        are zero.
    inner_gap, outer_gap : float
        Certified bounds on how far the log-volume of each ellipsoid is from the optimum. The inner ellipsoid of a
        surface has no such bound; its `inner_gap` is 0.

    Examples
    --------
    >>> piece = Body.box([2, 2, 2]).pieces[0]
    >>> piece.kind, piece.vertices.shape, piece.normals.shape
    ('polytope', (8, 3), (6, 3))
    >>> piece.inner.semi_axes, piece.inner_gap < 1e-12
    (array([1., 1., 1.]), True)
    """

    kind: str
    vertices: Floats | None
    normals: Floats | None
    offsets: Floats | None
    triangles: Ints | None
    inner: Ellipsoids
    outer: Ellipsoids
    inner_gap: float
    outer_gap: float


class _Unmade:
    """Placeholder for the arrays of a body until its constructor sets them; using it raises an error."""

    def __get__(self, body: Any, kind: type) -> Any:
        if body is None:
            return self
        raise InputError(f"expected a {kind.__name__} made by its constructors, found one without content")


@guarded
class _Bodies:
    """Properties and methods shared by one body and a sequence of bodies."""

    _packed: Packed = cast(Packed, _Unmade())
    _covering: Covering | None = None

    @property
    def inner(self) -> Ellipsoids:
        """Inner ellipsoids, one row per piece; for an open surface without a radius, the inner ellipsoid is a point."""
        return trusted(self._packed.inner_center, self._packed.inner_factor)

    @property
    def outer(self) -> Ellipsoids:
        """Outer ellipsoids, one row per piece."""
        return trusted(self._packed.outer_center, self._packed.outer_factor)

    @property
    def gaps(self) -> Floats:
        """Certified log-volume gaps of the inner and outer fits, shape (pieces, 2)."""
        return self._packed.gaps

    @property
    def nbytes(self) -> int:
        """Memory held by all arrays, in bytes."""
        return self._packed.nbytes

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """All pieces, in order."""
        return tuple(_piece(self._packed, i) for i in range(len(self._packed.layout)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save to a versioned file without pickles.

        The file is written under a temporary name and then renamed.

        Parameters
        ----------
        path : path
            Must end in ``.npz``, or in ``.lwn`` for programs in C and C++ (``loewner.h``); only the same version of
            loewner can read the prepared data of a ``.lwn`` file. An existing file is replaced.

        Raises
        ------
        InputError
            If the name has another extension.
        FileError
            If the file cannot be written.

        Examples
        --------
        >>> Body.sphere(1.0).save("ball.npz")
        >>> Body.load("ball.npz")
        Body(sphere, 0 vertices)
        """
        # Imported late, because archives and checksums would take a fifth of the time of `import loewner`.
        from loewner.bodies import files, native_files

        if native_files.is_meant(path):
            native_files.save(path, self._packed)
        else:
            files.save(self._packed, path, self._covering)


@guarded
class Body(_Bodies):
    """A union of convex pieces and surfaces, each with its inner and outer ellipsoid.

    Make a body with `from_points`, `from_pieces`, `from_mesh`, `from_surface`, `box`, `sphere`, `cylinder`, `capsule`,
    `cone`, `ellipsoid`, `union` or `load`. Lengths are in metres, in the body's own frame.

    Examples
    --------
    >>> body = Body.box([1, 2, 3])
    >>> body.inner[0].semi_axes
    array([1.5, 1. , 0.5])
    """

    def __init__(self, packed: Packed, covering: Covering | None = None) -> None:
        if not isinstance(packed, Packed):
            raise InputError("Body: make one by Body.from_points, from_mesh, box, sphere, ... or load")
        if len(packed.piece_start) != 2:
            raise InputError(f"Body: expected the pieces of one body, found {len(packed.piece_start) - 1} bodies")
        self._packed = packed
        self._covering = covering

    @property
    def covering(self) -> Covering | None:
        """How well the pieces cover the mesh or body that they approximate; None if this was not measured."""
        return self._covering

    def __repr__(self) -> str:
        kinds = [KIND_NAMES[k] for k in self._packed.layout[:, columns.KIND].tolist()]
        text = kinds[0] if len(kinds) == 1 else f"{len(kinds)} pieces"
        if self._packed.layout[0, columns.KIND] <= columns.SURFACE and len(kinds) == 1:
            radius = self._packed.frames[0, 0]
            around = f", radius {radius:g}" if radius > 0 else ""
            corners = self._packed.triangles
            if (corners == corners[:, :1]).all():
                return f"Body(cloud, {len(corners)} points{around})"
            return f"Body({text}, {len(self._packed.triangles)} triangles{around})"
        return f"Body({text}, {len(self._packed.points)} vertices)"

    @pictured
    def _repr_html_(self) -> str:
        packed = self._packed
        outlines = [
            (packed.outer_center, packed.outer_factor, 'stroke-opacity="0.7"'),
            (packed.inner_center, packed.inner_factor, 'stroke-dasharray="4 3"'),
        ]
        shape = for_pictures(packed).at(np.eye(4), COLOURS[0])
        if len(packed.layout) > MANY_PIECES:
            return bodies([shape])
        return bodies([shape], outlines, note=", outer (—) and inner (- -) ellipsoids")

    @classmethod
    def from_points(cls, points: ArrayLike, *, tol: float = 1e-4) -> Body:
        """Make a body of one piece, the convex hull of points.

        Parameters
        ----------
        points : array_like, shape (m, 3)
            At least four points, in metres, not all in one plane.
        tol : float
            Upper limit on the certified log-volume gaps of the two fits.

        Raises
        ------
        GeometryError
            If there are too few points, or if all points are coplanar, collinear or equal.

        Examples
        --------
        >>> Body.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.1, 0.1, 0.1]])
        Body(polytope, 4 vertices)
        """
        return cls(_fitted(hulls([points], names=["points"]), np.array([0, 1]), tol))

    @classmethod
    def from_pieces(cls, point_sets: Iterable[ArrayLike], *, tol: float = 1e-4) -> Body:
        """Make the union of the convex hulls of several point sets, each of shape (m_i, 3).

        Parameters
        ----------
        point_sets : iterable of array_like, each of shape (m_i, 3)
            Points in metres.
        tol : float
            Upper limit on the certified log-volume gap of every fit.

        Raises
        ------
        GeometryError
            If there are no point sets, or if the points of a set are coplanar; the message gives the index of that set.

        Examples
        --------
        >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> Body.from_pieces([corners, corners + [2, 0, 0]])
        Body(2 pieces, 8 vertices)
        """
        sets = _validate.listed(point_sets, "point_sets")
        if not sets:
            raise GeometryError("point_sets: expected at least one piece, found none")
        return cls(_fitted(hulls(sets), np.array([0, len(sets)]), tol))

    @classmethod
    def from_mesh(
        cls,
        source: meshes.Source,
        *,
        decompose: bool = True,
        tol: float = 1e-4,
        scale: ArrayLike = 1.0,
        cover: bool = True,
        tolerance: float | None = None,
        threshold: float = 0.05,
        max_pieces: int | None = None,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Body:
        """Make a body from a triangle mesh.

        Parameters
        ----------
        source : path, trimesh.Trimesh or trimesh.Scene
            The mesh, or a mesh file (STL, OBJ, PLY, OFF, GLB, glTF or DAE); lengths in metres.
        decompose : bool
            If true, split a non-convex mesh into convex pieces, with CoACD or by cutting along planes. The pieces only
            approximate the mesh; `body.covering` states how well. If false, use the convex hull, which contains the
            mesh.
        tol : float
            Upper limit on the certified log-volume gap of every fit.
        scale : float, or array_like of shape (3,)
            Factor for all lengths, or one factor for each axis of the mesh; a negative factor mirrors the mesh.
        cover : bool
            Whether to grow the pieces of a decomposition until they contain the mesh's whole surface.
        tolerance : float, optional
            The largest distance by which the pieces may stick out of the mesh, in metres. With a tolerance, the mesh is
            cut along planes, without CoACD. The cutting ends when no piece sticks out farther than the tolerance, or
            when there are `max_pieces` pieces. If a piece still sticks out farther, a warning gives the distance. A
            mesh with holes is always cut along planes. For such a mesh, the default tolerance is 2 % of the diagonal of
            the bounding box, or more if 2 % would take too much work.
        threshold : float
            CoACD's bound on concavity, from 0.01 to 1; used only for meshes without holes. A smaller bound gives more
            pieces and a closer fit.
        max_pieces : int, optional
            Limit on the number of pieces of a decomposition.
        seed : int
            Seed of CoACD's search.
        progress : callable, optional
            Called as ``progress(done, total)`` after each step; the ratio done / total never decreases. If the mesh is
            cut along planes, each step stands for a hundredth of its surface. All ellipsoids are fitted in the last
            step.

        Raises
        ------
        FileError
            If the file is missing, empty, truncated or not a mesh.
        MissingExtraError
            If a required package of the ``meshes`` extra is missing.

        See Also
        --------
        loewner.meshes.convex_pieces : The decomposition alone, with a description of the method.

        Examples
        --------
        >>> import trimesh
        >>> body = Body.from_mesh(trimesh.creation.box((0.1, 0.2, 0.3)))
        >>> body, body.covering.kind, body.covering.max_protrusion
        (Body(polytope, 8 vertices), 'convex', 0.0)
        """
        report, steps = _validate.reporter(progress), 1  # the fits are one step

        def decomposed(done: int, total: int) -> None:
            nonlocal steps
            steps = total + 1
            report(done, steps)

        options = meshes.Options(scale, decompose, cover, tolerance, threshold, max_pieces, seed, decomposed)
        polytopes, covering = meshes.convex_polytopes(source, options)
        body = body_of_polytopes(polytopes, covering, tol)
        report(steps, steps)
        return body

    @classmethod
    def from_surface(
        cls,
        source: meshes.Source,
        *,
        radius: float = 0.0,
        solid: bool | None = None,
        scale: ArrayLike = 1.0,
    ) -> Body:
        """Make a body from the triangles of a mesh, without decomposition or approximation.

        Every triangle is treated as a convex piece: a flat core, thickened by a radius. The mesh may have holes, and
        its triangles may be duplicated, flipped, degenerate or intersecting. docs/surfaces.md explains when to use this
        method and when to use `from_mesh`.

        Parameters
        ----------
        source : path, trimesh.Trimesh, trimesh.Scene, or a pair of arrays
            The mesh, or a mesh file (STL, OBJ, PLY, OFF, GLB, glTF or DAE); lengths in metres. A pair holds the
            vertices, shape (v, 3), and the triangles, shape (t, 3).
        radius : float
            Radius of the ball around each point of the triangles, in metres.
        solid : bool, optional
            Whether the body includes the enclosed space, that is, all points around which the mesh winds. A solid
            collides with a body inside it, but not with a body in one of its cavities. By default, a mesh is solid if
            it is closed, that is, if its triangles traverse each edge equally often in both directions. A mesh that is
            only nearly closed causes a warning and counts as open.
        scale : float, or array_like of shape (3,)
            Factor for all lengths, or one factor for each axis of the mesh; a negative factor mirrors the mesh.

        Raises
        ------
        FileError
            If the file is missing, empty, truncated or not a mesh.
        GeometryError
            If a vertex is not finite, an index is out of range, there are no triangles, or a size is not between 1e-12
            and 1e12 m. With ``solid=True``, also if the mesh is open; the message locates an open edge.
        InputError
            If the radius is negative or not finite.

        Examples
        --------
        >>> import trimesh
        >>> from loewner import Body, distance
        >>> mug = trimesh.creation.annulus(0.036, 0.04, 0.1)
        >>> body = Body.from_surface(mug)
        >>> body, body.pieces[0].kind
        (Body(solid, 256 triangles), 'solid')
        >>> ball = Body.sphere(0.01)
        >>> float(np.round(distance(body, None, ball, None, exact=True).distance, 4))
        0.0258
        """
        length = _validate.positive_scalar(radius, "radius", zero=True)
        if solid is not None:
            solid = _validate.flag(solid, "solid")
        vertices, triangles = meshes.scaled_mesh(source, scale)
        name = meshes.name_of(source)
        with logged("%s: preparing a surface of %d triangles", name, len(triangles), least=MANY_TRIANGLES):
            pieces = surfaces.surface_pieces(name, vertices, triangles, length, solid, fits.DEFAULT_TOLERANCE)
            return cls(Packed.of(pieces))

    @classmethod
    def box(cls, size: ArrayLike) -> Body:
        """Make an axis-aligned box centered at the origin.

        Parameters
        ----------
        size : array_like, shape (3,)
            Full edge lengths along x, y and z, in metres.

        Raises
        ------
        InputError
            If a length is not positive and finite.
        GeometryError
            If the ratio of two lengths is so small (about 1e-12) that the shorter length is lost in rounding, or if a
            length is not between 1e-30 and 1e30 m.

        Examples
        --------
        >>> Body.box([2, 4, 6]).outer.volume / Body.box([2, 4, 6]).inner.volume  # 3 sqrt(3)
        array([5.19615242])
        """
        half = _validate.positive_array(size, "size", (3,)) / 2
        # The ellipsoids of a box have a closed form. They are adjusted so that containment also holds after rounding
        # (docs/containment.md).
        F = np.diag(half)
        inner = np.zeros((1, 3)), F[None] * (1 - CLOSED_FORM_ROUNDING)
        outer = np.zeros((1, 3)), F[None] * (np.sqrt(3.0) * (1 + CLOSED_FORM_ROUNDING))
        gaps = np.full((1, 2), 6 * CLOSED_FORM_ROUNDING)
        return cls(_of_hulls(box_hull(half, "size"), np.array([0, 1]), inner, outer, gaps))

    @classmethod
    def sphere(cls, radius: float) -> Body:
        """Make a ball centered at the origin; the ball is its own inner and outer ellipsoid.

        Parameters
        ----------
        radius : float
            Radius in metres.

        Raises
        ------
        InputError
            If the radius is not positive and finite.

        Examples
        --------
        >>> Body.sphere(0.5).outer.semi_axes
        array([[0.5, 0.5, 0.5]])
        """
        r = _validate.positive_scalar(radius, "radius")
        return _primitive(columns.POINT, r, [r, r, r])

    @classmethod
    def ellipsoid(cls, semi_axes: ArrayLike) -> Body:
        """Make an axis-aligned ellipsoid centered at the origin.

        Parameters
        ----------
        semi_axes : array_like, shape (3,)
            Semi-axes along x, y and z, in metres.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.ellipsoid([1, 2, 3])
        Body(ellipsoid, 0 vertices)
        """
        return _primitive(columns.ELLIPSOID, 0.0, _validate.positive_array(semi_axes, "semi_axes", (3,)))

    @classmethod
    def spheres(cls, centers: ArrayLike, radii: ArrayLike) -> Body:
        """Make a union of balls, one piece per ball; for many balls of equal radius, see `from_cloud`.

        Parameters
        ----------
        centers : array_like, shape (n, 3)
            Centers in metres.
        radii : float, or array_like of shape (n,)
            Radii in metres.

        Raises
        ------
        InputError
            If shapes are wrong, entries are not finite, or radii are not positive.
        GeometryError
            If there are no balls.

        Examples
        --------
        >>> Body.spheres([[0, 0, 0], [1, 0, 0]], [0.5, 0.25])
        Body(2 pieces, 0 vertices)
        """
        c = _rows_of_three(centers, "centers")
        r = np.ascontiguousarray(np.broadcast_to(_validate.positive_lengths(radii, "radii", (len(c),)), len(c)))
        return cls(Packed.of(sensed.ball_pieces(c, r)))

    @classmethod
    def boxes(cls, centers: ArrayLike, edges: ArrayLike) -> Body:
        """Make a union of axis-aligned boxes, one piece per box.

        Parameters
        ----------
        centers : array_like, shape (n, 3)
            Centers in metres.
        edges : float, or array_like of shape (3,) or (n, 3)
            Full edge lengths along x, y and z, in metres: one number if all boxes are equal cubes, one row if all boxes
            are equal, or one row per box.

        Raises
        ------
        InputError
            If shapes are wrong, entries are not finite, or lengths are not positive.
        GeometryError
            If there are no boxes, or if an edge is so short, and so far from the origin, that it is lost in rounding.

        Examples
        --------
        >>> Body.boxes([[0, 0, 0], [1, 0, 0]], 0.5)
        Body(2 pieces, 16 vertices)
        """
        c = _rows_of_three(centers, "centers")
        e = np.broadcast_to(_validate.positive_lengths(edges, "edges", (len(c), 3)), (len(c), 3))
        return cls(Packed.of(sensed.box_pieces(c - e / 2, c + e / 2)))

    @classmethod
    def from_cloud(cls, points: ArrayLike, *, radius: float | None = None, voxel: float | None = None) -> Body:
        """Make a body from a point cloud: the union of balls around the points, or of the voxels that contain them.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            Points in metres.
        radius : float, optional
            Radius of the ball around each point, in metres. Making a body from 50,000 points takes about 40 ms.
        voxel : float, optional
            Edge length, in metres, of the cells of a grid with a corner at the origin. The cells that contain points
            form the body, as in `from_voxels`. Give either `voxel` or `radius`.

        Returns
        -------
        Body
            With `radius`, a body of one piece, with a search tree over the points; with `voxel`, a body of boxes, as in
            `from_voxels`. FREE is proven for the exact union of balls or voxels.

        Raises
        ------
        InputError
            If the shape is wrong, if entries are not finite (remove the invalid points of a depth image first), or if
            both or neither of `radius` and `voxel` are given.
        GeometryError
            If there are no points.

        Examples
        --------
        >>> points = np.random.default_rng(0).uniform(size=(1000, 3))
        >>> Body.from_cloud(points, radius=0.01)
        Body(cloud, 1000 points, radius 0.01)
        """
        x = _rows_of_three(points, "points")
        if (radius is None) == (voxel is None):
            raise InputError("radius, voxel: expected one of the two, found " + ("none" if voxel is None else "both"))
        if voxel is None:
            length = _validate.positive_scalar(radius, "radius")
            return cls(Packed.of(sensed.point_pieces(x, length, fits.DEFAULT_TOLERANCE)))
        edge = _validate.positive_scalar(voxel, "voxel")
        return cls(Packed.of(sensed.voxel_pieces(sensed.cells_of(x, edge), edge)))

    @classmethod
    def from_depth(
        cls,
        image: ArrayLike,
        K: ArrayLike,
        T_world_camera: ArrayLike | None = None,
        *,
        radius: float | None = None,
        voxel: float | None = None,
        checker: Any = None,
        q: ArrayLike | None = None,
        clear: float = 0.03,
    ) -> Body:
        """Make a body in world coordinates from the points of a depth image, leaving out points on the robot.

        Parameters
        ----------
        image, K, T_world_camera
            As for `depth.points_of`; pixels without an echo are left out.
        radius, voxel : float
            As for `from_cloud`; give exactly one of the two.
        checker : CollisionChecker, optional
            If a checker is given, its method `off_the_robot` removes the points on the robot and on attached bodies.
        q : array_like, shape (dof,), optional
            The robot's configuration when the image was taken.
        clear : float
            Points within this distance of the robot, in metres, are left out; without a checker, `clear` has no effect.
            If no point on the robot is to remain, the distance must exceed the camera's noise plus the error of the
            robot's pose. If the robot must not collide with the body, the distance must also exceed the sum of the
            margin and the radius (or the voxel's diagonal).

        Raises
        ------
        InputError
            As for `depth.points_of`, `from_cloud` and `off_the_robot`, or if only one of `checker` and `q` is given.
        PoseError
            If the pose is not a rigid motion.
        GeometryError
            If no points are left.

        Examples
        --------
        >>> K = [[100.0, 0, 1], [0, 100.0, 1], [0, 0, 1]]
        >>> Body.from_depth([[2.0, 2.0, np.nan], [2.0, 0.0, 2.0]], K, radius=0.01)
        Body(cloud, 4 points, radius 0.01)
        """
        points = points_of(image, K, T_world_camera)
        if (checker is None) != (q is None):
            raise InputError("checker, q: expected both or none, found one")
        if checker is None:
            left = points[~np.isnan(points[..., 2])]
        elif not hasattr(checker, "off_the_robot"):
            raise InputError(f"checker: expected a CollisionChecker, found {_validate.short(checker)}")
        else:
            left = checker.off_the_robot(points, q, clear=clear)
        if len(left) == 0:
            raise GeometryError("image: expected an echo that is not from the robot, found none")
        return cls.from_cloud(left, radius=radius, voxel=voxel)

    @classmethod
    def from_voxels(cls, grid: ArrayLike, size: float, *, origin: ArrayLike = (0.0, 0.0, 0.0)) -> Body:
        """Make a body from an occupancy grid: the union of the occupied cells; each unbroken row of cells is one box.

        Parameters
        ----------
        grid : array_like of bool, shape (p, q, r)
            True for occupied cells. Compare probabilities with a threshold first.
        size : float
            Edge of a cell, in metres.
        origin : array_like, shape (3,)
            The lowest corner of cell (0, 0, 0), in metres. The lowest corner of cell (i, j, k) is origin + size · (i,
            j, k).

        Raises
        ------
        InputError
            If the grid is not an array of bool with three axes.
        GeometryError
            If no cell is occupied.
        MemoryLimitError
            If the boxes would not fit into memory.

        Examples
        --------
        >>> grid = np.zeros((4, 4, 4), bool)
        >>> grid[1:3, 1:3, 0] = True
        >>> Body.from_voxels(grid, 0.1)
        Body(2 pieces, 16 vertices)
        """
        occupied = _validate.plain_array(grid, "grid")
        if occupied.dtype != bool or occupied.ndim != 3:
            raise InputError(
                f"grid: expected an array of bool with three axes, found {occupied.dtype} of shape {occupied.shape}"
            )
        edge = _validate.positive_scalar(size, "size")
        corner = _validate.finite_array(origin, "origin", (3,))
        return cls(Packed.of(sensed.grid_pieces(occupied, edge, corner)))

    @classmethod
    def from_octree(cls, path: str | os.PathLike[str]) -> Body:
        """Make a body from an OctoMap octree: the union of its occupied leaves, one box per leaf.

        Parameters
        ----------
        path : path
            A ``.bt`` file.

        Raises
        ------
        FileError
            If the file is missing or is not a complete octree.
        GeometryError
            If no cell of the octree is occupied.

        Examples
        --------
        >>> Body.from_octree("none.bt")
        Traceback (most recent call last):
            ...
        loewner.errors.FileError: none.bt: expected an octree in .bt, but there is no such file
        """
        from loewner.bodies.octrees import occupied_leaves

        return cls(Packed.of(sensed.box_pieces(*occupied_leaves(path))))

    @classmethod
    def height_field(cls, heights: ArrayLike, spacing: ArrayLike, *, base: float | None = None) -> Body:
        """Make terrain: the solid below a triangulated surface through heights on a grid.

        Parameters
        ----------
        heights : array_like, shape (p, q)
            Heights in metres, at least two along each axis; ``heights[i, j]`` is the height at x = i · spacing, y = j ·
            spacing.
        spacing : float, or array_like of shape (2,)
            Distance between neighbouring heights along x and y, in metres.
        base : float, optional
            Height of the flat underside, in metres; it must be below all `heights`. The default is the lowest height
            minus the length of the grid's longer side. The terrain is then so thick that a body that sinks into it is
            noticed before it comes out below.

        Raises
        ------
        InputError
            If the shape is wrong, entries are not finite, or the base is not below all heights.

        Examples
        --------
        >>> x = np.linspace(0, 1, 11)
        >>> Body.height_field(0.1 * np.sin(6 * x)[:, None] * np.ones(11), 0.1)
        Body(solid, 320 triangles)
        """
        z = _validate.finite_array(heights, "heights", ("p", "q"))
        if min(z.shape) < 2:
            raise InputError(f"heights: expected at least two along each axis, found shape {z.shape}")
        step = np.broadcast_to(_validate.positive_lengths(spacing, "spacing", (2,)), 2)
        lowest = float(z.min())
        below = lowest - float((step * (np.array(z.shape) - 1)).max()) if base is None else base
        below = float(_validate.finite_array(below, "base", ()))
        if not below < lowest:
            raise InputError(f"base: expected a height below the lowest, {lowest:g} m, found {below:g}")
        return cls(Packed.of(sensed.terrain_pieces(z, step, below, fits.DEFAULT_TOLERANCE)))

    @classmethod
    def half_space(cls, normal: ArrayLike, offset: float, *, extent: float = 1000.0) -> Body:
        """Make a floor, wall or ceiling: a cube with edges of length `extent` behind a plane.

        Parameters
        ----------
        normal : array_like, shape (3,)
            The outward normal, of any nonzero length. The body lies in {x : n · x <= offset}, where n is the normal
            scaled to length 1.
        offset : float
            Signed distance of the plane from the origin along the normal, in metres.
        extent : float
            Edge length of the cube, in metres, at most 1e9. One face of the cube lies in the plane, centered at the
            plane's point nearest to the origin. Everything outside the cube is free, so the cube must extend beyond the
            range of the moving bodies. Contact is accurate to about 1e-12 times the extent. The ellipsoid around the
            cube reaches beyond each face by 0.37 times the extent. For `CollisionChecker.clearance`, which uses this
            ellipsoid, use a thin box instead.

        Raises
        ------
        InputError
            If a number is not finite, the normal is zero, or the extent is not positive or exceeds 1e9.

        Examples
        --------
        >>> floor = Body.half_space([0, 0, 1], 0.0)
        >>> floor.outer.center.round(6)
        array([[   0.,    0., -500.]])
        """
        n = _validate.finite_array(normal, "normal", (3,))
        size = float(np.abs(n).max())
        if not size > 0:
            raise InputError("normal: expected a nonzero vector, found zeros")
        n = n / size
        n = n / lengths(n)
        where = float(_validate.finite_array(offset, "offset", ()))
        edge = _validate.positive_scalar(extent, "extent")
        if edge > LARGEST_EXTENT:
            raise InputError(
                f"extent: expected at most {LARGEST_EXTENT:g} m, for contact accurate to 1 mm, found {edge:g}"
            )
        axis = np.eye(3)[np.abs(n).argmin()]
        across = axis - dot(axis, n) * n
        across /= lengths(across)
        T = pose_of(np.column_stack([across, np.cross(n, across), n]), (where - edge / 2) * n)
        return cls.box([edge, edge, edge]).transformed(T)

    @classmethod
    def cylinder(cls, radius: float, length: float) -> Body:
        """Make a cylinder centered at the origin, with its axis along z.

        Parameters
        ----------
        radius, length : float
            Radius and length in metres; the axis runs from -length/2 to length/2.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.cylinder(radius=1, length=4).inner.semi_axes
        array([[2., 1., 1.]])
        """
        return _upright(columns.CYLINDER, radius, length)

    @classmethod
    def cone(cls, radius: float, length: float) -> Body:
        """Make a cone with its axis along z; its apex is at z = +length/2, and its base at z = -length/2.

        Parameters
        ----------
        radius, length : float
            Radius of the base, and distance from base to apex, in metres.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.cone(radius=1, length=4).inner.center
        array([[ 0.,  0., -1.]])
        """
        return _upright(columns.CONE, radius, length)

    @classmethod
    def capsule(cls, radius: float, length: float) -> Body:
        """Make a capsule centered at the origin, with its axis along z; `length` is the length of the straight part.

        Parameters
        ----------
        radius, length : float
            Radius and length in metres; the total length from tip to tip is length + 2 radius.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.capsule(radius=1, length=4).inner.semi_axes
        array([[3., 1., 1.]])
        """
        return _upright(columns.SEGMENT, radius, length)

    @classmethod
    def union(cls, bodies: Iterable[Body]) -> Body:
        """Combine several bodies into one that has all their pieces, in their common frame.

        Parameters
        ----------
        bodies : iterable of Body
            At least one body.

        Raises
        ------
        InputError
            If an argument is not a body.
        GeometryError
            If there are no bodies.

        Examples
        --------
        >>> Body.union([Body.sphere(1.0), Body.box([4, 0.5, 0.5])])
        Body(2 pieces, 8 vertices)
        """
        if isinstance(bodies, Body):
            raise InputError("bodies: expected several bodies in a list, found one body")
        listed = _validate.listed(bodies, "bodies")
        if not listed:
            raise GeometryError("bodies: expected at least one body, found none")
        return cls(as_one([_validate.instance(b, "bodies", Body)._packed for b in listed]))

    def transformed(self, T: ArrayLike) -> Body:
        """Return a copy of the body and its ellipsoids, moved by the rigid motion `T`.

        The moved vertices are rounded to float64. To preserve containment, the outer ellipsoids grow and the inner ones
        shrink by the largest effect of this rounding.

        Parameters
        ----------
        T : array_like, shape (4, 4)
            The motion, with its translation in metres.

        Returns
        -------
        Body

        Raises
        ------
        PoseError
            If T is not a rigid motion.
        GeometryError
            If the translation is so large that rounding would destroy a thin piece.

        Examples
        --------
        >>> T = np.eye(4)
        >>> T[0, 3] = 5.0
        >>> Body.sphere(1.0).transformed(T).outer.center
        array([[5., 0., 0.]])
        """
        return Body(moved(self._packed, _validate.pose(T, "T")), self.covering)

    def covered_by(
        self, model: Body, *, tolerance: float | None = None, progress: Progress | None = None
    ) -> CoverReport:
        """Prove that convex elements contain the whole body, including its interior, or find an uncovered point.

        Parameters
        ----------
        model : Body
            Balls, capsules, boxes, ellipsoids or other convex pieces, in the same frame as the body.
        tolerance : float, optional
            A length in metres. The proof divides the body into cells, and halves each cell that no single element
            contains, unless the cell is already as small as the tolerance. The default is 1e-4 of the body's diagonal.
            Holes of any size prevent the outcome "covered": for a hole smaller than the tolerance, the outcome is
            "undecided" or "uncovered".
        progress : callable, optional
            Called as ``progress(done, total)`` after each step.

        Returns
        -------
        CoverReport
            The outcome, with bounds on three quantities: the uncovered share of the body's surface, how far the body
            sticks out of the model, and how far the model sticks out of the body.

        Raises
        ------
        InputError
            If a piece of the model is a surface, or the tolerance is not positive.

        Notes
        -----
        An open surface consists only of its triangles, thickened by their radius; solids and convex pieces include
        their interior. docs/containment.md gives the proof.

        Examples
        --------
        >>> box = Body.box([0.2, 0.1, 0.1])
        >>> report = box.covered_by(Body.spheres([[-0.05, 0, 0], [0.05, 0, 0]], 0.1))
        >>> report.outcome, report.excess[1] < 0.06
        ('covered', True)
        >>> report = box.covered_by(Body.spheres([[-0.05, 0, 0], [0.05, 0, 0]], 0.08))
        >>> report.outcome, report.witness
        ('uncovered', array([ 0.1 ,  0.05, -0.05]))
        """
        from loewner.bodies.cover_proofs import prove

        other = _validate.instance(model, "model", Body)
        length = None if tolerance is None else _validate.positive_scalar(tolerance, "tolerance")
        return prove(self._packed, other._packed, length, _validate.reporter(progress))

    def cover(
        self,
        kind: Literal["spheres", "capsules", "boxes", "ellipsoids"] = "spheres",
        *,
        n: int | None = None,
        protrusion: float | None = None,
        progress: Progress | None = None,
    ) -> Body:
        """Make a body of a few simple elements that provably contains this body, including its interior.

        Parameters
        ----------
        kind : {"spheres", "capsules", "boxes", "ellipsoids"}
        n : int, optional
            Upper limit on the number of elements. Within this limit, the search makes the elements stick out as little
            as possible.
        protrusion : float, optional
            The largest distance by which an element may stick out of the body, in metres. Within this distance, the
            search uses as few elements as possible. Give either `n` or ``protrusion``.
        progress : callable, optional
            Called as ``progress(done, total)`` after each step.

        Returns
        -------
        Body
            A body with one piece per element. Its `covering` is proven: `max_uncovered` is 0, and `max_protrusion` is
            at most ``protrusion`` if ``protrusion`` is given. Centers and radii of spheres are multiples of a power of
            two, so that float32 and the decimals in files represent them exactly.

        Raises
        ------
        InputError
            If both or neither of `n` and ``protrusion`` are given, if `n` is less than 1, or if ``protrusion`` is less
            than 1e-4 of the body's diagonal.
        GeometryError
            If the search finds no elements within the given limit.

        Examples
        --------
        >>> cover = Body.box([0.2, 0.1, 0.1]).cover("spheres", protrusion=0.04)
        >>> len(cover.pieces) < 20, cover.covering.max_protrusion <= 0.04
        (True, True)
        """
        from loewner.bodies import cover_fits

        _validate.choice(kind, "kind", ("spheres", "capsules", "boxes", "ellipsoids"))
        if (n is None) == (protrusion is None):
            raise InputError("n, protrusion: expected one of the two, found " + ("none" if n is None else "both"))
        count = None if n is None else _validate.whole_number(n, "n", 1, cover_fits.MOST)
        length = None if protrusion is None else _validate.positive_scalar(protrusion, "protrusion")
        packed, excess = cover_fits.cover(self._packed, kind, count, length, _validate.reporter(progress))
        return Body(packed, Covering("cover", True, 0.0, float("nan"), 0, excess))

    def to_mjcf(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        ellipsoids: Literal["inner", "outer"] | None = None,
        name: str = "body",
    ) -> str:
        """Write the body as a MuJoCo model: a single body without joints, with one geom per piece.

        A box, sphere, cylinder, capsule or ellipsoid becomes a geom of that type. Any other piece becomes a mesh, whose
        vertices are part of the model file; for a cone, the mesh is a circumscribed polytope.

        Parameters
        ----------
        path : path, optional
            File to write; it is written under a temporary name and then renamed.
        ellipsoids : {"inner", "outer"}, optional
            Which ellipsoids to write instead of the pieces.
        name : str
            Name of the model and of its body: any name except "world", which MuJoCo reserves. The geoms are named
            ``NAME_0``, ``NAME_1``, ...

        Returns
        -------
        str
            The text of the file.

        Raises
        ------
        InputError
            If the name is invalid, or if no ellipsoids are requested and a piece is a surface, a height field or a
            cloud, which MuJoCo would replace with its convex hull.
        FileError
            If the file cannot be written.

        Examples
        --------
        >>> print(Body.sphere(0.5).to_mjcf(name="ball"))  # doctest: +ELLIPSIS
        <mujoco model="ball">
          <asset />
          <worldbody>
            <body name="ball">
              <geom name="ball_0" type="sphere" size="0.5" ... />
            </body>
          </worldbody>
        </mujoco>
        """
        from loewner.bodies import exports

        text = exports.mjcf_text(self._packed, exports.plain_name(name), ellipsoids)
        if path is not None:
            exports.save_text(text, _validate.path(path, "path"))
        return text

    def to_urdf(
        self,
        path: str | os.PathLike[str],
        *,
        ellipsoids: Literal["inner", "outer"] | None = None,
        mesh_prefix: str = "",
    ) -> None:
        """Write the body as a URDF with a single link that has only collision shapes.

        Boxes, spheres and cylinders keep their shapes, and a capsule becomes a cylinder and two spheres. Any other
        piece becomes a mesh in a file ``STEM-DIGEST.obj`` next to the URDF, where DIGEST is a digest of the file's
        content. For an inner ellipsoid, the mesh is an inscribed polytope; for any other ellipsoid and for a cone, it
        is a circumscribed polytope.

        Parameters
        ----------
        path : path
            Any extension is allowed; the stem names both the robot and its link. The mesh files are written first; then
            the URDF is written under a temporary name and renamed. A mesh file is never overwritten with different
            content, so the meshes of an older URDF, or of a copy of that URDF, do not change.
        ellipsoids : {"inner", "outer"}, optional
            Which ellipsoids to write instead of the pieces.
        mesh_prefix : str
            Prefix for the names of mesh files in the URDF, for instance ``"package://my_robot/meshes/"``.

        Raises
        ------
        InputError
            If the stem is not a valid name, or if no ellipsoids are requested and a piece is a surface.
        FileError
            If a file cannot be written.

        Examples
        --------
        >>> Body.capsule(radius=0.1, length=0.5).to_urdf("rod.urdf")
        >>> from loewner import Robot
        >>> Robot.from_urdf("rod.urdf").bodies["rod"]
        Body(3 pieces, 0 vertices)
        """
        from loewner.bodies import exports

        file = _validate.path(path, "path")
        exports.plain_name(file.stem, "the stem of path")
        exports.save_urdf(self._packed, file, ellipsoids, exports.prefix(mesh_prefix))

    def to_stl(self, path: str | os.PathLike[str]) -> None:
        """Write the pieces to a binary STL file, in metres.

        Each convex piece becomes a closed mesh; the meshes may overlap.

        Parameters
        ----------
        path : path
            Must end in ``.stl``; the file is written under a temporary name and then renamed.

        Raises
        ------
        InputError
            If the name has another extension, or a piece is a surface or a cloud with a radius.
        FileError
            If the file cannot be written.

        Notes
        -----
        Coordinates are rounded to single precision, and the triangles of curved pieces lie inside the pieces. A body
        made by `Robot.swept` is written exactly.

        Examples
        --------
        >>> Body.box([1, 2, 3]).to_stl("box.stl")
        >>> Body.from_mesh("box.stl").covering.kind
        'convex'
        """
        from loewner.bodies import exports

        file = _validate.path(path, "path")
        if file.suffix.lower() != ".stl":
            raise InputError(f"path: expected a name that ends in .stl, found {file}")
        exports.save_stl(self._packed, file)

    def to_trimesh(self, what: Literal["pieces", "inner", "outer"] = "pieces") -> Any:
        """Triangulate the pieces or ellipsoids for trimesh, which can display them or write them as GLB, STL and so on.

        Parameters
        ----------
        what : {"pieces", "inner", "outer"}
            What to triangulate. The corners of the triangles are on the surface of a curved piece, so the triangles lie
            inside the piece. A circle becomes a polygon with 48 corners; an ellipsoid has at most 1280 triangles.

        Returns
        -------
        trimesh.Scene
            One mesh per piece, named ``piece_0``, ``piece_1``, ...; ``.to_mesh()`` joins the meshes. If `what` is
            "inner", an open surface without a radius is left out, since its inner ellipsoid is a point.

        Raises
        ------
        MissingExtraError
            If trimesh is not installed.

        Examples
        --------
        >>> scene = Body.box([1, 2, 3]).to_trimesh()
        >>> float(scene.volume)
        6.0
        >>> _ = scene.export("box.glb")
        """
        from loewner.bodies.triangulated import of_ellipsoids, of_pieces

        _validate.choice(what, "what", ("pieces", "inner", "outer"))
        meshes_by_number = (
            dict(enumerate(of_pieces(self._packed))) if what == "pieces" else of_ellipsoids(self._packed, what)
        )
        return meshes.trimesh_scene({f"piece_{number}": mesh for number, mesh in meshes_by_number.items()})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Body:
        """Read a file written by `save`.

        Parameters
        ----------
        path : path

        Raises
        ------
        FileError
            If the file is missing, damaged, altered or written by a newer version, or if it holds several bodies.

        Examples
        --------
        >>> Body.load("none.npz")
        Traceback (most recent call last):
            ...
        loewner.errors.FileError: none.npz: expected a saved file, but there is no such file
        """
        return body_of_file(path)


@guarded
class Bodies(_Bodies):
    """A packed sequence of n bodies, which broadcasts with the last batch axis of the poses.

    Parameters
    ----------
    bodies : iterable of Body

    Examples
    --------
    >>> bodies = Bodies([Body.sphere(1.0), Body.box([1, 1, 1])])
    >>> len(bodies), bodies[1]
    (2, Body(polytope, 8 vertices))
    """

    def __init__(self, bodies: Iterable[Body]) -> None:
        listed = [_validate.instance(b, "bodies", Body)._packed for b in _validate.listed(bodies, "bodies")]
        self._packed = join(listed) if listed else empty()

    @classmethod
    def _wrap(cls, packed: Packed) -> Bodies:
        self = object.__new__(cls)
        self._packed = packed
        return self

    @classmethod
    def from_points(
        cls, point_sets: Iterable[ArrayLike], *, tol: float = 1e-4, progress: Progress | None = None
    ) -> Bodies:
        """Make one convex body per point set; all hulls and fits are computed together, on all threads.

        Parameters
        ----------
        point_sets : sequence of array_like, each of shape (m_i, 3)
        tol : float
            Upper limit on the certified log-volume gap of every fit.
        progress : callable, optional
            Called as ``progress(done, total)`` from time to time.

        Raises
        ------
        GeometryError
            If a set is flat or has fewer than four points; the message gives the index of the set.

        Examples
        --------
        >>> Bodies.from_points(np.random.default_rng(0).normal(size=(100, 12, 3)))
        Bodies(100 bodies, 100 pieces)
        """
        sets = _validate.listed(point_sets, "point_sets")
        _validate.callback(progress, "progress")
        return cls._wrap(_fitted(hulls(sets), np.arange(len(sets) + 1), tol, progress))

    @classmethod
    def spheres(cls, radii: ArrayLike) -> Bodies:
        """Make one ball centered at the origin for each radius; see `Body.sphere`.

        Parameters
        ----------
        radii : array_like, shape (n,)
            Radii in metres.

        Examples
        --------
        >>> Bodies.spheres([0.5, 1.0])
        Bodies(2 bodies, 2 pieces)
        """
        r = _validate.positive_array(radii, "radii", (None,))
        return cls._wrap(primitives(columns.POINT, r, np.repeat(r[:, None], 3, axis=1)))

    @classmethod
    def ellipsoids(cls, semi_axes: ArrayLike) -> Bodies:
        """Make one ellipsoid centered at the origin for each row of semi-axes; see `Body.ellipsoid`.

        Parameters
        ----------
        semi_axes : array_like, shape (n, 3)
            Semi-axes along x, y and z, in metres.

        Examples
        --------
        >>> Bodies.ellipsoids([[1, 2, 3], [1, 1, 1]])
        Bodies(2 bodies, 2 pieces)
        """
        s = _validate.positive_array(semi_axes, "semi_axes", (None, 3))
        return cls._wrap(primitives(columns.ELLIPSOID, np.zeros(len(s)), s))

    def __len__(self) -> int:
        return len(self._packed.piece_start) - 1

    def __iter__(self) -> Iterator[Body]:
        return (self[i] for i in range(len(self)))

    @overload
    def __getitem__(self, index: int | np.integer[Any]) -> Body: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[Any]) -> Bodies: ...
    def __getitem__(self, index: int | np.integer[Any] | slice | Sequence[int] | NDArray[Any]) -> Body | Bodies:
        n = len(self)
        if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
            if not -n <= index < n:
                raise BodyIndexError(f"expected an index from {-n} to {n - 1}, found {_validate.short(index)}")
            return Body(take(self._packed, np.array([index % n])))
        try:
            rows = np.arange(n)[index]
        except Exception as error:  # an IndexError, or an error from the caller's object
            text = f"{_validate.short(index)} ({error})"
            raise BodyIndexError(f"expected indices from {-n} to {n - 1}, found {text}") from None
        if rows.ndim != 1:
            raise BodyIndexError(f"expected a slice, or indices of shape (k,), found {_validate.short(index)}")
        return bodies_of(take(self._packed, rows))

    def __repr__(self) -> str:
        return f"Bodies({len(self)} bodies, {len(self._packed.layout)} pieces)"

    @property
    def piece_start(self) -> Ints:
        """Start of each body's range of pieces, shape (n + 1,); body i has pieces piece_start[i] : piece_start[i+1]."""
        return self._packed.piece_start

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Bodies:
        """Read a file written by `Body.save` or `Bodies.save`.

        Parameters
        ----------
        path : path

        Raises
        ------
        FileError
            If the file is missing, damaged, altered or written by a newer version.
        """
        from loewner.bodies import files

        return cls._wrap(files.load(path)[0])


# -- making -----------------------------------------------------------------------------------


def _rows_of_three(x: ArrayLike, name: str) -> Floats:
    """Check that an array has at least one row, and three numbers in each row."""
    rows = _validate.finite_array(x, name, ("n", 3))
    if len(rows) == 0:
        raise GeometryError(f"{name}: expected at least one point, found none")
    return rows


def _fitted(hull: Hulls, piece_start: Ints, tol: float, progress: Progress | None = None) -> Packed:
    """Fit ellipsoids to hulls and pack the bodies."""
    if len(hull) == 0:
        return empty()
    inner_center, inner_factor, outer_center, outer_factor, *gaps = fits.fit_pieces(
        hull.vert_start, hull.vertices, hull.face_start, hull.normals, tol=tol, progress=progress
    )
    inner, outer = (inner_center, inner_factor), (outer_center, outer_factor)
    return _of_hulls(hull, piece_start, inner, outer, np.stack(gaps, axis=1))


def _of_hulls(
    hull: Hulls, piece_start: Ints, inner: tuple[Floats, Floats], outer: tuple[Floats, Floats], gaps: Floats
) -> Packed:
    pieces = laid_out(
        columns.POLYTOPE, inner, outer, gaps, piece_start=np.asarray(piece_start, dtype=np.int64),
        point_start=hull.vert_start, points=np.ascontiguousarray(hull.vertices),
        plane_start=hull.face_start, planes=np.ascontiguousarray(np.column_stack([hull.normals, hull.offsets])),
        triangle_start=hull.triangle_start, triangles=hull.triangles,
    )  # fmt: skip
    return Packed.of(pieces)


def packed_of(bodies: Body | Bodies) -> Packed:
    """Return the arrays of bodies, for modules that call kernels."""
    return bodies._packed


def reach_of(bodies: Body | Bodies) -> float:
    """Bound the distance [m] of a body's points from the body's origin, at any pose that is accepted as rigid.

    The radius of a surface or cloud does not count, since a rotation moves a ball no farther than its center.
    """
    packed = packed_of(bodies)
    if (packed.layout[:, columns.KIND] <= columns.POLYTOPE).all():
        far = float(lengths(packed.points).max(initial=0.0)) * (1.0 + 1e-12)
    else:
        far = float(packed.kernel.table[:, columns.REACH].max(initial=0.0))
    return far * (1.0 + 4.0 * tolerances.ROTATION_TOLERANCE)


def body_of_polytopes(polytopes: Sequence[Polytope], covering: Covering | None, tol: float) -> Body:
    """Make a body of polytopes, and fit their ellipsoids with log-volume gaps of up to `tol`."""
    return Body(_fitted(Hulls.of(polytopes), np.array([0, len(polytopes)]), tol), covering)


def bodies_of(packed: Packed) -> Bodies:
    """Make bodies from packed arrays."""
    return Bodies._wrap(packed)


def body_of_file(path: str | os.PathLike[str], wanted: str | None = None) -> Body:
    """Read a body, and raise an error if the result of `checksum_of` differs from `wanted`."""
    from loewner.bodies import files

    packed, covering = files.load(path, wanted)
    if len(packed.piece_start) != 2:
        raise FileError(f"{path}: expected one body, found {len(packed.piece_start) - 1}; use loewner.Bodies.load")
    return Body(packed, covering)


def checksum_of(body: Body) -> str:
    """Return the SHA-256 of the content of a saved body."""
    from loewner.bodies import files

    return files.checksum(body._packed, body.covering)


def _primitive(kind: int, rounding: float, frame: ArrayLike) -> Body:
    """Make a body of one curved piece: the image of a unit shape, plus a ball of radius `rounding`."""
    return Body(primitives(kind, np.array([rounding]), np.array([frame], dtype=float)))


def _upright(kind: int, radius: float, length: float) -> Body:
    """Make a cylinder, a cone or a capsule, along the third axis."""
    r, h = _validate.positive_scalar(radius, "radius"), _validate.positive_scalar(length, "length") / 2
    return _primitive(kind, r if kind == columns.SEGMENT else 0.0, [r, r, h])


def _piece(p: Packed, i: int) -> Piece:
    kind = int(p.layout[i, columns.KIND])
    polytope, flat = kind == columns.POLYTOPE, kind <= columns.POLYTOPE
    return Piece(
        kind=KIND_NAMES[kind],
        vertices=p.points_of(i) if flat else None,
        normals=p.planes_of(i)[:, :3] if polytope else None,
        offsets=p.planes_of(i)[:, 3] if polytope else None,
        triangles=p.triangles_of(i) if flat else None,
        inner=trusted(p.inner_center[i], p.inner_factor[i]),
        outer=trusted(p.outer_center[i], p.outer_factor[i]),
        inner_gap=float(p.gaps[i, 0]),
        outer_gap=float(p.gaps[i, 1]),
    )
