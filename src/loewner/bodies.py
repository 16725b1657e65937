"""Bodies: unions of convex pieces, each with its inner and outer ellipsoid.

A `Body` is one; `Bodies` is a packed sequence of them for batches. Both are read-only. A body is
moved by handing a pose to a query; the fits are never computed again.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner import _check, _memory, fits, meshes, polytopes
from loewner._check import Floats
from loewner._files import replacing
from loewner._guard import guarded
from loewner._kernels import blocks, directions, handles, rigid, shapes, trees
from loewner.ellipsoids import Ellipsoids
from loewner.errors import BodyIndexError, FileError, GeometryError, InputError

Ints = NDArray[np.int64]
Progress = Callable[[int, int], None]

FORMAT, VERSION = "loewner-bodies", 1

KIND_NAMES = ("polytope", "ellipsoid", "cylinder", "cone", "capsule", "sphere")

# Sizes outside this range under- or overflow in sixth powers of lengths, which the contact function
# forms; nothing anybody collides is near either end.
SMALLEST, LARGEST = 1e-30, 1e30

# Sizes at which the certificate may work in single precision first (docs/certified.md).
SINGLE_SIZES = 1e-3, 1e3

# Relative allowance for the rounding of a closed form and of a stored factor.
CLOSED_FORM_ROUNDING = 16 * 2.0**-53


@dataclass(frozen=True, eq=False)
class Packed:
    """Pieces of n bodies as arrays; what kernels see is `kernel`.

    Attributes
    ----------
    layout : ndarray of int64, shape (P, 5)
        Kind, first and last+1 row of the piece's points, first and last+1 row of its planes.
    points, planes : ndarray, shapes (V, 3) and (F, 4)
        Vertices, and faces as (unit outward normal, offset): n·x <= offset.
    piece_start : ndarray of int64, shape (n + 1,)
        Body i owns the pieces piece_start[i] .. piece_start[i+1].
    frames : ndarray, shape (P, 13)
        Rounding radius, center and factor of the unit shape's image (zero for polytopes).
    triangles, triangle_start
        Hull triangles of the polytopes, as indices into the piece's own points.
    inner_center, inner_factor, outer_center, outer_factor
        The ellipsoids, shapes (P, 3) and (P, 3, 3).
    gaps : ndarray, shape (P, 2)
        Certified log-volume gaps of the inner and the outer fit.
    maps
        What `directions.direction_map` makes of the large polytopes, by number of the piece; None: still to be made.
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
    maps: dict[int, tuple[Ints, Floats]] | None = None

    def __post_init__(self) -> None:
        _memory.expect_start()
        for name in ARRAYS:
            getattr(self, name).setflags(write=False)
        if self.maps is None:
            object.__setattr__(self, "maps", _direction_maps(self))
        table = _table(self)
        layout, points = _kernel_points(self)
        hot = np.ascontiguousarray(table[:, : shapes.HOT])
        start = self.piece_start.copy()
        single = _single(hot)
        vertices = blocks.aligned(len(points) if len(single) else 0, np.float32)
        vertices[:] = points[: len(vertices)]
        kernel = (table, layout, points, start, hot, single, *_trees(table, start), vertices)
        # Not made read-only: to Numba that would be another type, and everything compiled twice.
        object.__setattr__(self, "kernel", kernel)
        object.__setattr__(self, "handle_table", handles.table_of(kernel))
        object.__setattr__(self, "handle", self.handle_table.ctypes.data)

    def __reduce__(self) -> Any:
        """Copies and pickles are made anew: a handle is an address, and means nothing anywhere else."""
        return type(self), (*(getattr(self, name) for name in ARRAYS), self.maps)

    # Set in __post_init__: the arrays of `loewner._kernels.shapes`, in order, and their handle.
    kernel: Any = field(init=False)
    handle_table: Any = field(init=False)
    handle: int = field(init=False)


ARRAYS = tuple(f.name for f in fields(Packed) if f.init and f.name != "maps")


def _direction_maps(p: Packed) -> dict[int, tuple[Ints, Floats]]:
    first, last = p.layout[:, shapes.POINTS_FROM], p.layout[:, shapes.POINTS_TO]
    return {
        int(i): directions.direction_map(np.ascontiguousarray(p.points[first[i] : last[i]]))
        for i in np.flatnonzero(last - first > shapes.LARGE)
    }


def _kernel_points(p: Packed) -> tuple[Ints, Floats]:
    """Form the kernels' layout and points: vertices in blocks, or the direction map of a large polytope."""
    maps = p.maps or {}
    first = p.layout[:, shapes.POINTS_FROM]
    lengths = p.layout[:, shapes.POINTS_TO] - first
    columns = -(-lengths // blocks.BLOCK) * blocks.BLOCK
    room = columns.copy()
    for i, (chosen, nodes) in maps.items():
        columns[i] = len(chosen)
        room[i] = len(chosen) + -(-nodes.size // (3 * blocks.BLOCK)) * blocks.BLOCK
    begin = _starts(room)
    # A block is filled up with repeats of the last point: they change no maximum.
    vertex = np.minimum(np.arange(begin[-1]) - np.repeat(begin[:-1], room), np.repeat(lengths, room) - 1)
    for i, (chosen, _) in maps.items():
        vertex[begin[i] : begin[i] + len(chosen)] = chosen
    points = blocks.aligned(3 * len(vertex))
    by_block = p.points[np.repeat(first, room) + vertex].reshape(-1, blocks.BLOCK, 3)
    points.reshape(-1, 3, blocks.BLOCK)[:] = by_block.transpose(0, 2, 1)
    for i, (chosen, nodes) in maps.items():
        at = 3 * (begin[i] + len(chosen))
        points[at : at + nodes.size] = nodes.ravel()
    kind = p.layout[:, shapes.KIND].copy()
    kind[list(maps)] = shapes.MAPPED
    return np.column_stack([kind, begin[:-1], begin[:-1] + columns]), points


def _table(p: Packed) -> Floats:
    """Form the kernels' table: shape matrices and one-sided bounds of sizes."""
    table = np.zeros((len(p.layout), shapes.COLUMNS))
    # Before anything overflows. A factor's entries are no larger than the longest semi-axis.
    largest = np.abs(p.outer_factor).max(axis=(1, 2), initial=0.0)
    if not (largest < LARGEST).all():
        raise _wrong_sizes(largest, largest)
    upper = np.triu_indices(3)
    for center, factor, at_center, at_shape in (
        (p.outer_center, p.outer_factor, shapes.OUTER_CENTER, shapes.OUTER_SHAPE),
        (p.inner_center, p.inner_factor, shapes.INNER_CENTER, shapes.INNER_SHAPE),
    ):
        table[:, at_center : at_center + 3] = center
        Q = factor @ factor.transpose(0, 2, 1)
        table[:, at_shape : at_shape + 6] = Q[:, upper[0], upper[1]]
    table[:, shapes.ROUNDING] = p.frames[:, 0]
    table[:, shapes.FRAME_CENTER : shapes.FRAME_CENTER + 12] = p.frames[:, 1:]
    if len(table) == 0:
        return table
    # Singular values are computed with a backward error of a few roundings of the largest.
    outer = np.linalg.svd(p.outer_factor, compute_uv=False)
    inner = np.linalg.svd(p.inner_factor, compute_uv=False)
    slack = 32 * 2.0**-53
    # A pose accepted as rigid may still stretch: lengths by √(1 + 3 ROTATION_TOLERANCE) at most.
    bend = 2 * rigid.ROTATION_TOLERANCE
    table[:, shapes.INNER_SIGMA] = np.maximum(inner[:, -1] - slack * inner[:, 0], 1e-300) * (1 - bend)
    table[:, shapes.INNER_GRIP] = (1 + 2.0**-50) / table[:, shapes.INNER_SIGMA]
    table[:, shapes.OUTER_SIGMA] = np.maximum(outer[:, -1] - slack * outer[:, 0], 1e-300) * (1 - bend)
    table[:, shapes.OUTER_RADIUS] = outer[:, 0] * (1 + slack) * (1 + bend)
    # The inner ellipsoid lies in the piece and the piece in the outer one.
    table[:, shapes.REACH] = (np.linalg.norm(p.outer_center, axis=1) + outer[:, 0]) * (1 + slack) * (1 + bend)
    reach = table[:, shapes.REACH]
    if not ((reach < LARGEST) & (outer[:, 0] > SMALLEST)).all():
        raise _wrong_sizes(outer[:, 0], reach)
    return table


def _wrong_sizes(least: NDArray[Any], most: NDArray[Any]) -> GeometryError:
    """Make the error about pieces too small or too large for the kernels."""
    return GeometryError(
        f"pieces: expected sizes between {SMALLEST:g} and {LARGEST:g} m, found {least.min():g} .. {most.max():g}"
    )


def _single(hot: Floats) -> NDArray[np.float32]:
    """The kernels' hot columns in single precision, if all sizes suit it; otherwise no rows."""
    least, most = SINGLE_SIZES
    if len(hot) == 0 or hot[:, shapes.OUTER_RADIUS].min() < least or hot[:, shapes.REACH].max() > most:
        return np.empty((0, shapes.HOT), dtype=np.float32)
    rounded = hot.copy()
    rounded[:, [shapes.OUTER_RADIUS, shapes.REACH, shapes.INNER_GRIP]] *= 1 + 2.0**-22
    return np.minimum(rounded, np.finfo(np.float32).max).astype(np.float32)


def _trees(table: Floats, piece_start: Ints) -> tuple[Floats, Ints, Ints]:
    """Trees over the pieces of the bodies that have many."""
    n = len(piece_start) - 1
    if np.diff(piece_start).max(initial=0) < trees.FEW:
        return np.empty(0), np.empty(0, dtype=np.int64), np.full(n, -1)
    center = table[:, shapes.OUTER_CENTER : shapes.OUTER_CENTER + 3]
    # The widths along the axes are the roots of the diagonal; all of it rounds outward.
    half = np.sqrt(table[:, [shapes.OUTER_SHAPE, shapes.OUTER_SHAPE + 3, shapes.OUTER_SHAPE + 5]])
    half += 2.0**-53 * 64 * table[:, shapes.REACH, None]
    grown: tuple[Floats, Ints, Ints] = trees.planted(piece_start, center - half, center + half)
    return grown


@dataclass(frozen=True, eq=False)
class Piece:
    """One convex piece of a body.

    Attributes
    ----------
    kind : str
        "polytope", "ellipsoid", "cylinder", "cone", "capsule" or "sphere".
    vertices : ndarray, shape (v, 3), or None
        Extreme points; None for curved pieces.
    normals, offsets : ndarray, shapes (f, 3) and (f,), or None
        Faces: unit outward normals and offsets, normals @ x <= offsets.
    triangles : ndarray of int, shape (t, 3), or None
        Hull surface as indices into `vertices`, counter-clockwise from outside.
    inner, outer : Ellipsoids
        Largest ellipsoid inside, smallest around.
    inner_gap, outer_gap : float
        Certified bounds on the log-volume distance from the optimum.

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


class _Bodies:
    """What one body and a sequence of bodies have in common."""

    _packed: Packed

    @property
    def inner(self) -> Ellipsoids:
        """Inner ellipsoids, one row per piece."""
        return Ellipsoids._trusted(self._packed.inner_center, self._packed.inner_factor)

    @property
    def outer(self) -> Ellipsoids:
        """Outer ellipsoids, one row per piece."""
        return Ellipsoids._trusted(self._packed.outer_center, self._packed.outer_factor)

    @property
    def gaps(self) -> Floats:
        """Certified log-volume gaps (inner, outer) of the fits, shape (pieces, 2)."""
        return self._packed.gaps

    @property
    def nbytes(self) -> int:
        """Memory held by all arrays, in bytes."""
        return _held(self._packed)

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """All pieces, in order."""
        return tuple(_piece(self._packed, i) for i in range(len(self._packed.layout)))


@guarded
class Body(_Bodies):
    """A union of convex pieces, each with its inner and outer ellipsoid.

    Make one by `from_points`, `from_pieces`, `from_mesh`, `box`, `sphere`, `cylinder`, `capsule`,
    `cone`, `ellipsoid`, `union` or `load`. Lengths are metres, in the body's own frame.

    Examples
    --------
    >>> body = Body.box([1, 2, 3])
    >>> body.inner[0].semi_axes
    array([1.5, 1. , 0.5])
    """

    def __init__(self, packed: Packed, covering: meshes.Covering | None = None) -> None:
        if not isinstance(packed, Packed):
            raise InputError("Body: make one by Body.from_points, from_mesh, box, sphere, ... or load")
        if len(packed.piece_start) != 2:
            raise InputError(f"Body: expected the pieces of one body, found {len(packed.piece_start) - 1} bodies")
        self._packed = packed
        self.covering = covering

    def __repr__(self) -> str:
        kinds = [KIND_NAMES[k] for k in self._packed.layout[:, shapes.KIND]]
        text = kinds[0] if len(kinds) == 1 else f"{len(kinds)} pieces"
        return f"Body({text}, {len(self._packed.points)} vertices)"

    @classmethod
    def from_points(cls, points: ArrayLike, *, tol: float = 1e-4) -> Body:
        """Convex hull of points, as one piece.

        Parameters
        ----------
        points : array_like, shape (m, 3)
            In metres; at least four, not all in a plane.
        tol : float
            Certified log-volume gap of both fits.

        Raises
        ------
        GeometryError
            If there are too few points, or they are flat, collinear or all the same.

        Examples
        --------
        >>> Body.from_points([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.1, 0.1, 0.1]])
        Body(polytope, 4 vertices)
        """
        return cls.from_pieces([points], tol=tol)

    @classmethod
    def from_pieces(cls, point_sets: Iterable[ArrayLike], *, tol: float = 1e-4) -> Body:
        """Union of the convex hulls of several point sets, each of shape (m_i, 3).

        Parameters
        ----------
        point_sets : iterable of array_like, each of shape (m_i, 3)
            In metres.
        tol : float
            Certified log-volume gap of all fits.

        Raises
        ------
        GeometryError
            If there is no set, or one is flat; the message gives its number.

        Examples
        --------
        >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> Body.from_pieces([corners, corners + [2, 0, 0]])
        Body(2 pieces, 8 vertices)
        """
        sets = list(point_sets)
        if not sets:
            raise GeometryError("point_sets: expected at least one piece, found none")
        return cls(_from_point_sets(sets, np.array([0, len(sets)]), tol, None))

    @classmethod
    def from_mesh(cls, source: Any, *, decompose: bool = True, tol: float = 1e-4, **options: Any) -> Body:
        """Body of a triangle mesh.

        Parameters
        ----------
        source : path or trimesh.Trimesh
            STL, OBJ, PLY, GLB or DAE, in metres.
        decompose : bool
            True: split a non-convex mesh into convex pieces (CoACD); the pieces approximate the
            mesh, and `body.covering` says how well. False: the convex hull, which contains it.
        tol : float
            Certified log-volume gap of all fits.
        **options
            Passed on to `loewner.meshes.convex_pieces`.

        Raises
        ------
        FileError
            If the file is missing, empty, truncated or no mesh.
        MissingExtraError
            If a package of the extra "meshes" is needed and missing.

        Examples
        --------
        >>> import trimesh
        >>> body = Body.from_mesh(trimesh.creation.box((0.1, 0.2, 0.3)))
        >>> body, body.covering.kind
        (Body(polytope, 8 vertices), 'convex')
        """
        known = inspect.signature(meshes.convex_pieces).parameters
        for name in options:
            if name not in known:
                raise InputError(f"from_mesh: expected options among {', '.join(known)}, found {name!r}")
        pieces, covering = meshes.convex_pieces(source, decompose=decompose, **options)
        body = cls.from_pieces(pieces, tol=tol)
        body.covering = covering
        return body

    @classmethod
    def box(cls, size: ArrayLike) -> Body:
        """Axis-aligned box about the origin with full edge lengths `size`, shape (3,), in metres.

        Parameters
        ----------
        size : array_like, shape (3,)
            Full edge lengths along x, y, z, in metres.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.box([2, 4, 6]).outer.volume / Body.box([2, 4, 6]).inner.volume  # 3 sqrt(3)
        array([5.19615242])
        """
        half = _check.positive_vector(size, "size", 3) / 2
        signs = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
        hull = polytopes.hulls([signs * half])
        # The fits of a box are known (FITS: parallelepiped); only containment after rounding is to be seen to.
        F = np.diag(half)
        return cls(
            _assemble_polytopes(
                hull,
                np.array([0, 1]),
                np.zeros((1, 3)),
                F[None] * (1 - CLOSED_FORM_ROUNDING),
                np.zeros((1, 3)),
                F[None] * (np.sqrt(3.0) * (1 + CLOSED_FORM_ROUNDING)),
                np.full((1, 2), 6 * CLOSED_FORM_ROUNDING),
            )
        )

    @classmethod
    def sphere(cls, radius: float) -> Body:
        """Ball about the origin, radius in metres; its own inner and outer ellipsoid.

        Parameters
        ----------
        radius : float
            In metres.

        Raises
        ------
        InputError
            If the radius is not positive and finite.

        Examples
        --------
        >>> Body.sphere(0.5).outer.semi_axes
        array([[0.5, 0.5, 0.5]])
        """
        r = _check.positive_scalar(radius, "radius")
        return _primitive(shapes.POINT, r, [r, r, r], [r, r, r], [r, r, r], 0.0)

    @classmethod
    def ellipsoid(cls, semi_axes: ArrayLike) -> Body:
        """Ellipsoid about the origin along the axes, semi-axes of shape (3,), in metres.

        Parameters
        ----------
        semi_axes : array_like, shape (3,)
            Along x, y, z, in metres.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.ellipsoid([1, 2, 3])
        Body(ellipsoid, 0 vertices)
        """
        s = _check.positive_vector(semi_axes, "semi_axes", 3)
        return _primitive(shapes.ELLIPSOID, 0.0, s, s, s, 0.0)

    @classmethod
    def cylinder(cls, radius: float, length: float) -> Body:
        """Cylinder about the origin along z, in metres.

        Parameters
        ----------
        radius, length : float
            In metres; the axis runs from -length/2 to length/2.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.cylinder(radius=1, length=4).inner.semi_axes
        array([[2., 1., 1.]])
        """
        r = _check.positive_scalar(radius, "radius")
        h = _check.positive_scalar(length, "length") / 2
        wide = r * np.sqrt(1.5)
        return _primitive(shapes.CYLINDER, 0.0, [r, r, h], [r, r, h], [wide, wide, np.sqrt(3.0) * h], 0.0)

    @classmethod
    def cone(cls, radius: float, length: float) -> Body:
        """Cone along z with its apex at +length/2 and its base at -length/2, in metres.

        Parameters
        ----------
        radius, length : float
            Of the base, and from base to apex, in metres.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.cone(radius=1, length=4).inner.center
        array([[ 0.,  0., -1.]])
        """
        r = _check.positive_scalar(radius, "radius")
        H = _check.positive_scalar(length, "length")
        narrow, wide = r / np.sqrt(2.0), 3 * r / np.sqrt(8.0)
        return _primitive(shapes.CONE, 0.0, [r, r, H / 2], [narrow, narrow, H / 4], [wide, wide, 0.75 * H], -H / 4)

    @classmethod
    def capsule(cls, radius: float, length: float) -> Body:
        """Capsule about the origin along z; `length` is that of the straight part, in metres.

        Parameters
        ----------
        radius, length : float
            In metres; from tip to tip it measures length + 2 radius.

        Raises
        ------
        InputError
            If a length is not positive and finite.

        Examples
        --------
        >>> Body.capsule(radius=1, length=4).inner.semi_axes
        array([[3., 1., 1.]])
        """
        r = _check.positive_scalar(radius, "radius")
        h = _check.positive_scalar(length, "length") / 2
        # Smallest (a, a, b) around: its support must exceed h|cos| + r, that is
        # a² - r² - 2hr c + k c² >= 0 for c in [0, 1] with k = b² - a² - h²; the volume is least at
        # k² - 2h²k - 3h²r² = 0. The largest inside is (r, r, h + r).
        # In units of the greater length, that no square over- or underflows.
        unit = max(r, h)
        x, y = r / unit, h / unit
        k = y * (y + np.hypot(y, np.sqrt(3.0) * x))
        grow = np.sqrt(1 + y * y / k)
        a, b = r * grow, unit * grow * np.sqrt(x * x + k)
        return _primitive(shapes.SEGMENT, r, [r, r, h], [r, r, h + r], [a, a, b], 0.0)

    @classmethod
    def union(cls, bodies: Iterable[Body]) -> Body:
        """One body of all the pieces of several, in the frame they share.

        Parameters
        ----------
        bodies : iterable of Body
            At least one.

        Raises
        ------
        InputError
            If one is no body.
        GeometryError
            If there is none.

        Examples
        --------
        >>> Body.union([Body.sphere(1.0), Body.box([4, 0.5, 0.5])])
        Body(2 pieces, 8 vertices)
        """
        if isinstance(bodies, Body):
            raise InputError("bodies: expected several bodies in a list, found one body")
        listed = list(bodies)
        if not listed:
            raise GeometryError("bodies: expected at least one body, found none")
        packed = _concatenate([_expect_body(b, "bodies")._packed for b in listed])
        start = np.array([0, len(packed.layout)])
        return cls(Packed(**{**_arrays(packed), "piece_start": start}, maps=packed.maps))

    def transformed(self, T: ArrayLike) -> Body:
        """The body moved by a rigid motion, shape (4, 4), for good; the ellipsoids move along.

        The moved vertices are rounded to float64, so the ellipsoids are grown and shrunk by what
        that rounding can do to containment.

        Parameters
        ----------
        T : array_like, shape (4, 4)
            Translation in metres.

        Returns
        -------
        Body

        Raises
        ------
        PoseError
            If T is no rigid motion.
        GeometryError
            If the translation leaves no digits for a piece that is thin.

        Examples
        --------
        >>> T = np.eye(4)
        >>> T[0, 3] = 5.0
        >>> Body.sphere(1.0).transformed(T).outer.center
        array([[5., 0., 0.]])
        """
        return Body(_moved(self._packed, _check.pose(T, "T")), self.covering)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a versioned ``.npz`` without pickle, to a temporary name first, then renamed.

        Parameters
        ----------
        path : path
            Ends in ``.npz``; a file of that name is replaced.

        Raises
        ------
        InputError
            If the name ends otherwise.
        FileError
            If the file cannot be written.

        Examples
        --------
        >>> Body.sphere(1.0).save("ball.npz")
        >>> Body.load("ball.npz")
        Body(sphere, 0 vertices)
        """
        _save(self._packed, path, self.covering)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Body:
        """Read what `save` wrote.

        Parameters
        ----------
        path : path

        Raises
        ------
        FileError
            If the file is missing, broken, altered, newer, or holds several bodies.

        Examples
        --------
        >>> Body.load("none.npz")
        Traceback (most recent call last):
            ...
        loewner.errors.FileError: none.npz: expected a file, found none
        """
        packed, covering = _load(path)
        if len(packed.piece_start) != 2:
            raise FileError(f"{path}: expected one body, found {len(packed.piece_start) - 1}; use loewner.Bodies.load")
        return cls(packed, covering)


@guarded
class Bodies(_Bodies):
    """A packed sequence of n bodies; broadcasts with the last batch axis of the poses.

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
        listed = [_expect_body(b, "bodies")._packed for b in bodies]
        self._packed = _concatenate(listed) if listed else _empty()

    @classmethod
    def _wrap(cls, packed: Packed) -> Bodies:
        self = object.__new__(cls)
        self._packed = packed
        return self

    @classmethod
    def from_points(
        cls, point_sets: Iterable[ArrayLike], *, tol: float = 1e-4, progress: Progress | None = None
    ) -> Bodies:
        """One convex body per point set; hulls and fits in one go, on all threads.

        Parameters
        ----------
        point_sets : sequence of array_like, each of shape (m_i, 3)
        tol : float
            Certified log-volume gap of all fits.
        progress : callable, optional
            Called as ``progress(done, total)`` now and then.

        Raises
        ------
        GeometryError
            If a set is flat or too small; the message gives its number.

        Examples
        --------
        >>> Bodies.from_points(np.random.default_rng(0).normal(size=(100, 12, 3)))
        Bodies(100 bodies, 100 pieces)
        """
        sets = list(point_sets)
        return cls._wrap(_from_point_sets(sets, np.arange(len(sets) + 1), tol, progress))

    @classmethod
    def spheres(cls, radii: ArrayLike) -> Bodies:
        """One ball about the origin per radius, shape (n,), in metres; as `Body.sphere`.

        Parameters
        ----------
        radii : array_like, shape (n,)
            In metres.

        Examples
        --------
        >>> Bodies.spheres([0.5, 1.0])
        Bodies(2 bodies, 2 pieces)
        """
        r = _check.positive_vector(radii, "radii", None)
        axes = np.repeat(r[:, None], 3, axis=1)
        return cls._wrap(_primitives(shapes.POINT, r, axes, axes, axes, 0.0))

    @classmethod
    def ellipsoids(cls, semi_axes: ArrayLike) -> Bodies:
        """One ellipsoid about the origin per row of semi-axes, shape (n, 3), in metres; as `Body.ellipsoid`.

        Parameters
        ----------
        semi_axes : array_like, shape (n, 3)
            Along x, y, z, in metres.

        Examples
        --------
        >>> Bodies.ellipsoids([[1, 2, 3], [1, 1, 1]])
        Bodies(2 bodies, 2 pieces)
        """
        s = _check.positive_array(semi_axes, "semi_axes", (None, 3))
        return cls._wrap(_primitives(shapes.ELLIPSOID, np.zeros(len(s)), s, s, s, 0.0))

    def __len__(self) -> int:
        return len(self._packed.piece_start) - 1

    def __iter__(self) -> Iterator[Body]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, index: int | slice | Sequence[int] | NDArray[Any]) -> Any:
        if isinstance(index, (int, np.integer)):
            if not -len(self) <= index < len(self):
                raise BodyIndexError(f"expected an index from {-len(self)} to {len(self) - 1}, found {index}")
            return Body(take(self._packed, np.array([index % len(self)])))
        return Bodies._wrap(take(self._packed, np.arange(len(self))[index]))

    def __repr__(self) -> str:
        return f"Bodies({len(self)} bodies, {len(self._packed.layout)} pieces)"

    @property
    def piece_start(self) -> Ints:
        """Body i owns the pieces piece_start[i] .. piece_start[i+1]; shape (n + 1,)."""
        return self._packed.piece_start

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a versioned ``.npz`` without pickle, to a temporary name first, then renamed.

        Parameters
        ----------
        path : path
            Ends in ``.npz``; a file of that name is replaced.

        Examples
        --------
        >>> Bodies.spheres([0.5, 1.0]).save("balls.npz")
        >>> Bodies.load("balls.npz")
        Bodies(2 bodies, 2 pieces)
        """
        _save(self._packed, path, None)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Bodies:
        """Read what `save` of a body or of bodies wrote.

        Parameters
        ----------
        path : path

        Raises
        ------
        FileError
            If the file is missing, broken, altered or newer.
        """
        return cls._wrap(_load(path)[0])


# -- making -----------------------------------------------------------------------------------


def _expect_body(body: Any, name: str) -> Body:
    if not isinstance(body, Body):
        raise InputError(f"{name}: expected loewner.Body, found {type(body).__name__}")
    return body


def _from_point_sets(sets: list[ArrayLike], piece_start: Ints, tol: float, progress: Progress | None) -> Packed:
    """Hulls, fits, packing."""
    if not sets:
        return _empty()
    hull = polytopes.hulls(sets)
    inner_c, inner_F, outer_c, outer_F, inner_gap, outer_gap = fits.fit_pieces(
        hull.vert_start, hull.vertices, hull.face_start, hull.normals, hull.offsets, tol=tol, progress=progress
    )
    gaps = np.stack([inner_gap, outer_gap], axis=1)
    return _assemble_polytopes(hull, piece_start, inner_c, inner_F, outer_c, outer_F, gaps)


def _assemble_polytopes(
    hull: polytopes.Hulls,
    piece_start: Ints,
    inner_c: Floats,
    inner_F: Floats,
    outer_c: Floats,
    outer_F: Floats,
    gaps: Floats,
) -> Packed:
    count = len(hull.vert_start) - 1
    layout = np.zeros((count, 5), dtype=np.int64)
    layout[:, shapes.KIND] = shapes.POLYTOPE
    layout[:, shapes.POINTS_FROM], layout[:, shapes.POINTS_TO] = hull.vert_start[:-1], hull.vert_start[1:]
    layout[:, shapes.PLANES_FROM], layout[:, shapes.PLANES_TO] = hull.face_start[:-1], hull.face_start[1:]
    return Packed(
        layout=layout,
        points=np.ascontiguousarray(hull.vertices),
        planes=np.ascontiguousarray(np.column_stack([hull.normals, hull.offsets])),
        piece_start=np.asarray(piece_start, dtype=np.int64),
        frames=np.zeros((count, 13)),
        triangles=np.asarray(hull.triangles, dtype=np.int64),
        triangle_start=np.asarray(hull.triangle_start, dtype=np.int64),
        inner_center=inner_c,
        inner_factor=inner_F,
        outer_center=outer_c,
        outer_factor=outer_F,
        gaps=gaps,
    )


def _empty() -> Packed:
    return Packed(
        layout=np.zeros((0, 5), dtype=np.int64),
        points=np.zeros((0, 3)),
        planes=np.zeros((0, 4)),
        piece_start=np.zeros(1, dtype=np.int64),
        frames=np.zeros((0, 13)),
        triangles=np.zeros((0, 3), dtype=np.int64),
        triangle_start=np.zeros(1, dtype=np.int64),
        inner_center=np.zeros((0, 3)),
        inner_factor=np.zeros((0, 3, 3)),
        outer_center=np.zeros((0, 3)),
        outer_factor=np.zeros((0, 3, 3)),
        gaps=np.zeros((0, 2)),
    )


def _primitive(kind: int, rounding: float, frame: ArrayLike, inner: ArrayLike, outer: ArrayLike, lift: float) -> Body:
    """One curved piece: image of a unit shape, ellipsoids in closed form centred at height `lift`."""
    image, smaller, larger = (np.array([axes], dtype=float) for axes in (frame, inner, outer))
    return Body(_primitives(kind, np.array([rounding]), image, smaller, larger, lift))


def _primitives(kind: int, rounding: Floats, frame: Floats, inner: Floats, outer: Floats, lift: float) -> Packed:
    """Bodies of one curved piece each; `frame`, `inner` and `outer` are semi-axes, one row per body."""
    n = len(frame)
    # An ellipsoid is its own fit exactly; the others' closed forms are rounded, so step to the safe side.
    slack = 0.0 if kind in (shapes.ELLIPSOID, shapes.POINT) else CLOSED_FORM_ROUNDING
    layout = np.zeros((n, 5), dtype=np.int64)
    layout[:, shapes.KIND] = kind
    center = np.tile([0.0, 0.0, lift], (n, 1))
    return Packed(
        layout=layout,
        points=np.zeros((0, 3)),
        planes=np.zeros((0, 4)),
        piece_start=np.arange(n + 1),
        frames=np.column_stack([rounding, np.zeros((n, 3)), _diagonal(frame).reshape(n, 9)]),
        triangles=np.zeros((0, 3), dtype=np.int64),
        triangle_start=np.zeros(n + 1, dtype=np.int64),
        inner_center=center,
        inner_factor=_diagonal(inner) * (1 - slack),
        outer_center=center.copy(),
        outer_factor=_diagonal(outer) * (1 + slack),
        gaps=np.full((n, 2), 6 * slack),
    )


def _diagonal(axes: Floats) -> Floats:
    """Diagonal matrices (n, 3, 3) of the rows of an (n, 3) array."""
    return axes[:, :, None] * np.eye(3)


# -- rearranging ------------------------------------------------------------------------------


def _arrays(packed: Packed) -> dict[str, Any]:
    return {name: getattr(packed, name) for name in ARRAYS}


def _held(p: Packed) -> int:
    """Bytes of all arrays, with those that are made for the kernels."""
    maps = [array for made in (p.maps or {}).values() for array in made]
    return sum(int(array.nbytes) for array in (*_arrays(p).values(), *maps, *p.kernel))


def _concatenate(parts: list[Packed]) -> Packed:
    """All bodies of several packs, in order."""
    _check.fits_memory(sum(map(_held, parts)), f"{len(parts)} bodies")
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ARRAYS}
    sizes = np.array([[len(p.points), len(p.planes), len(p.layout), len(p.triangles)] for p in parts])
    shift = np.concatenate([np.zeros((1, 4), dtype=np.int64), np.cumsum(sizes, axis=0)[:-1]])
    layouts = []
    for part, (points, planes, _, _) in zip(parts, shift, strict=True):
        layouts.append(part.layout + np.array([0, points, points, planes, planes]))
    joined["layout"] = np.concatenate(layouts)
    for name, column in (("piece_start", 2), ("triangle_start", 3)):
        tails = [getattr(p, name)[1:] + s[column] for p, s in zip(parts, shift, strict=True)]
        joined[name] = np.concatenate([[0], *tails]).astype(np.int64)
    maps = {int(i + s[2]): made for p, s in zip(parts, shift, strict=True) for i, made in (p.maps or {}).items()}
    return Packed(**joined, maps=maps)


def _ranges(starts: Ints, stops: Ints) -> Ints:
    """Concatenate the index ranges starts[i] .. stops[i]."""
    lengths = stops - starts
    if lengths.sum() == 0:
        return np.zeros(0, dtype=np.int64)
    offsets = np.repeat(starts - np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths)
    return np.asarray(np.arange(lengths.sum()) + offsets)


def _starts(lengths: Ints) -> Ints:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)


def take(p: Packed, bodies: Ints) -> Packed:
    """Pack of some of the bodies, repeats allowed."""
    _check.fits_memory(len(bodies) * _held(p) // max(1, len(p.piece_start) - 1), f"{len(bodies)} bodies")
    first, last = p.piece_start[bodies], p.piece_start[bodies + 1]
    pieces = _ranges(first, last)
    layout = p.layout[pieces]
    points = _ranges(layout[:, shapes.POINTS_FROM], layout[:, shapes.POINTS_TO])
    planes = _ranges(layout[:, shapes.PLANES_FROM], layout[:, shapes.PLANES_TO])
    triangles = _ranges(p.triangle_start[pieces], p.triangle_start[pieces + 1])
    point_start = _starts(layout[:, shapes.POINTS_TO] - layout[:, shapes.POINTS_FROM])
    plane_start = _starts(layout[:, shapes.PLANES_TO] - layout[:, shapes.PLANES_FROM])
    moved = np.column_stack(
        [layout[:, shapes.KIND], point_start[:-1], point_start[1:], plane_start[:-1], plane_start[1:]]
    ).astype(np.int64)
    return Packed(
        layout=np.ascontiguousarray(moved),
        points=p.points[points],
        planes=p.planes[planes],
        piece_start=_starts(last - first),
        frames=p.frames[pieces],
        triangles=p.triangles[triangles],
        triangle_start=_starts(p.triangle_start[pieces + 1] - p.triangle_start[pieces]),
        inner_center=p.inner_center[pieces],
        inner_factor=p.inner_factor[pieces],
        outer_center=p.outer_center[pieces],
        outer_factor=p.outer_factor[pieces],
        gaps=p.gaps[pieces],
        maps={new: p.maps[old] for new, old in enumerate(pieces.tolist()) if old in p.maps} if p.maps else {},
    )


def _moved(p: Packed, T: Floats) -> Packed:
    """Move all pieces by one rigid motion, keeping containment through the rounding."""
    R, t = T[:3, :3], T[:3, 3]
    points = p.points @ R.T + t
    normals = p.planes[:, :3] @ R.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.empty(len(normals))
    for row in p.layout:
        faces = slice(row[shapes.PLANES_FROM], row[shapes.PLANES_TO])
        if row[shapes.KIND] == shapes.POLYTOPE:
            offsets[faces] = (normals[faces] @ points[row[shapes.POINTS_FROM] : row[shapes.POINTS_TO]].T).max(axis=1)
    frames = p.frames.copy()
    curved = p.layout[:, shapes.KIND] != shapes.POLYTOPE
    frames[curved, 1:4] = p.frames[curved, 1:4] @ R.T + t
    frames[:, 4:] = (R @ p.frames[:, 4:].reshape(-1, 3, 3)).reshape(-1, 9)
    # A point moves off its exact image by at most 8 roundings of the lengths involved, an ellipsoid's
    # center and factor likewise, and R stretches by its departure from orthonormality.
    table = p.kernel[0]
    shift = 2.0**-53 * 32 * (table[:, shapes.REACH] + np.abs(t).sum())
    shrink = 1 - shift / table[:, shapes.INNER_SIGMA]
    grow = 1 + shift / table[:, shapes.OUTER_SIGMA]
    if not (shrink > 0.5).all():
        raise GeometryError(
            f"T: a translation of {np.abs(t).max():g} m leaves no digits for a piece this thin; "
            "pass the pose to the query instead"
        )
    arrays = _arrays(p)
    arrays.update(
        points=points,
        planes=np.column_stack([normals, offsets]),
        frames=frames,
        inner_center=p.inner_center @ R.T + t,
        inner_factor=(R @ p.inner_factor) * shrink[:, None, None],
        outer_center=p.outer_center @ R.T + t,
        outer_factor=(R @ p.outer_factor) * grow[:, None, None],
        gaps=p.gaps + 3 * np.column_stack([-np.log(shrink), np.log(grow)]),
    )
    return Packed(**arrays)


def _piece(p: Packed, i: int) -> Piece:
    kind = int(p.layout[i, shapes.KIND])
    polytope = kind == shapes.POLYTOPE
    points = slice(p.layout[i, shapes.POINTS_FROM], p.layout[i, shapes.POINTS_TO])
    planes = slice(p.layout[i, shapes.PLANES_FROM], p.layout[i, shapes.PLANES_TO])
    return Piece(
        kind=KIND_NAMES[kind],
        vertices=p.points[points] if polytope else None,
        normals=p.planes[planes, :3] if polytope else None,
        offsets=p.planes[planes, 3] if polytope else None,
        triangles=p.triangles[p.triangle_start[i] : p.triangle_start[i + 1]] if polytope else None,
        inner=Ellipsoids._trusted(p.inner_center[i], p.inner_factor[i]),
        outer=Ellipsoids._trusted(p.outer_center[i], p.outer_factor[i]),
        inner_gap=float(p.gaps[i, 0]),
        outer_gap=float(p.gaps[i, 1]),
    )


# -- files ------------------------------------------------------------------------------------


def _digest(arrays: dict[str, Any]) -> str:
    """Checksum over all arrays, so that a damaged or altered file never turns into a verdict."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _save(packed: Packed, path: str | os.PathLike[str], covering: meshes.Covering | None) -> None:
    arrays = _arrays(packed)
    if covering is not None:
        arrays["covering"] = np.array([str(value) for value in astuple(covering)])
    target = Path(path)
    if target.suffix != ".npz":
        raise InputError(f"path: expected a name that ends in .npz, found {target.name!r}")
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "digest": _digest(arrays), **arrays}
    with replacing(target) as temporary, open(temporary, "xb") as stream:
        np.savez_compressed(stream, **content)


def _load(path: str | os.PathLike[str]) -> tuple[Packed, meshes.Covering | None]:
    if os.path.isfile(path) and not zipfile.is_zipfile(path):
        raise FileError(
            f"{path}: expected a body saved as .npz, found another kind of file or a damaged one; "
            "for a mesh use loewner.Body.from_mesh"
        )
    try:
        stored = np.load(path, allow_pickle=False)
        if not isinstance(stored, np.lib.npyio.NpzFile):
            raise FileError(f"{path}: expected a loewner .npz, found a single array")
        with stored:
            content = {name: stored[name] for name in stored.files}
    except FileNotFoundError:
        raise FileError(f"{path}: expected a file, found none") from None
    except (FileError, MemoryError):
        raise
    except Exception as error:  # a damaged zip or array header ends in any of a dozen exceptions, zlib's among them
        raise FileError(f"{path}: expected a loewner .npz, found something unreadable ({error})") from None
    if str(content.get("format")) != FORMAT:
        raise FileError(f"{path}: expected a loewner .npz, found another kind of .npz")
    version = content.get("version")
    if version is None or version.shape != () or int(version) != VERSION:
        raise FileError(
            f"{path}: expected format version {VERSION}, found {version}; a newer loewner may have written it"
        )
    missing = [name for name in ARRAYS if name not in content]
    if missing:
        raise FileError(f"{path}: expected the arrays of a body, found none called {', '.join(missing)}")
    arrays: dict[str, Any] = {name: content[name] for name in ARRAYS}
    checked = arrays | ({"covering": content["covering"]} if "covering" in content else {})
    if str(content.get("digest")) != _digest(checked):
        raise FileError(f"{path}: the content does not match its checksum; the file is damaged or was altered")
    covering = None
    if "covering" in content:
        kind, exact, uncovered, excess, samples = (str(entry) for entry in content["covering"])
        covering = meshes.Covering(kind, exact == "True", float(uncovered), float(excess), int(samples))
    return Packed(**arrays), covering
