"""Define ellipsoids in any dimension, single or in batches: E = {c + F u : |u| <= 1}, Q = F Fᵀ."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._read_only import KeepsReadOnly
from loewner._base._validate import Floats
from loewner._kernels import tolerances
from loewner.errors import BodyIndexError, GeometryError, InputError


@guarded
@dataclass(frozen=True, eq=False)
class Ellipsoids(KeepsReadOnly):
    """One ellipsoid or a batch of ellipsoids, stored as center and factor.

    Parameters
    ----------
    center : array_like, shape (..., n)
        Centers, in metres.
    factor : array_like, shape (..., n, n)
        Invertible F with E = ``{c + F u : |u| <= 1}``, in metres.

    Raises
    ------
    InputError
        If shapes are wrong or entries are not finite.
    GeometryError
        If a factor is singular (a flat ellipsoid).

    Notes
    -----
    Some `inner` ellipsoids of bodies are single points: an open surface without a radius has no interior, so the factor
    of its inner ellipsoid is zero. The semi-axes and the volume of a point are 0. A point contains only its center,
    which is its support point in every direction, and remains a point when it is moved. Functions that take two
    ellipsoids refuse points.

    Examples
    --------
    >>> E = Ellipsoids.from_semi_axes([0, 0, 0], [3, 2, 1])
    >>> E.semi_axes
    array([3., 2., 1.])
    >>> bool(E.contains([2.9, 0, 0]))
    True
    """

    center: Floats
    factor: Floats

    def __init__(self, center: ArrayLike, factor: ArrayLike) -> None:
        c = _validate.finite_array(center, "center", ("...", None))
        F = _validate.finite_array(factor, "factor", ("...", None, None))
        n = c.shape[-1]
        if n == 0 or F.shape[-2:] != (n, n) or F.shape[:-2] != c.shape[:-1]:
            raise InputError(
                f"factor: expected shape {_validate.shape_text((*c.shape, n))} for a center of shape "
                f"{_validate.shape_text(c.shape)}, found {_validate.shape_text(F.shape)}"
            )
        if F.size and not (np.linalg.svd(F, compute_uv=False)[..., -1] > 0).all():
            raise GeometryError("factor: expected an invertible matrix, found a singular one (a flat ellipsoid)")
        self._freeze(c, F)

    def _freeze(self, c: Floats, F: Floats) -> None:
        for name, array in (("center", np.array(c)), ("factor", np.array(F))):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def from_shape_matrix(cls, center: ArrayLike, shape_matrix: ArrayLike) -> Ellipsoids:
        """Make ellipsoids E = {x : (x-c)ᵀ Q⁻¹ (x-c) <= 1} from shape matrices Q.

        Parameters
        ----------
        center : array_like, shape (..., n)
        shape_matrix : array_like, shape (..., n, n)
            Symmetric positive definite matrices, in square metres.

        Raises
        ------
        GeometryError
            If Q is not symmetric (to 1e-9 of its largest entry) or not positive definite.

        Examples
        --------
        >>> Ellipsoids.from_shape_matrix([0, 0], [[4, 0], [0, 1]]).semi_axes
        array([2., 1.])
        """
        Q = _validate.finite_array(shape_matrix, "shape_matrix", ("...", None, None))
        if Q.shape[-1] != Q.shape[-2]:
            raise InputError(f"shape_matrix: expected square matrices, found shape {_validate.shape_text(Q.shape)}")
        half, other = Q / 2, np.swapaxes(Q, -1, -2) / 2  # halves, since the sum of integers may overflow
        if Q.size and np.abs(half - other).max() > 1e-9 * np.abs(half).max():
            raise GeometryError("shape_matrix: expected a symmetric matrix, found Q != Qᵀ")
        try:
            return cls(center, np.linalg.cholesky(half + other))
        except np.linalg.LinAlgError:
            raise GeometryError("shape_matrix: expected a positive definite matrix") from None

    @classmethod
    def from_semi_axes(cls, center: ArrayLike, semi_axes: ArrayLike, rotation: ArrayLike | None = None) -> Ellipsoids:
        """Make ellipsoids from semi-axis lengths and an orthogonal matrix whose columns are the axes.

        Parameters
        ----------
        center : array_like, shape (..., n)
        semi_axes : array_like, shape (..., n)
            Positive lengths, in metres.
        rotation : array_like, shape (..., n, n), optional
            Orthogonal matrices; the default is the identity.

        Raises
        ------
        GeometryError
            If a length is not positive.
        InputError
            If shapes do not broadcast, or `rotation` is not orthogonal.

        Examples
        --------
        >>> Ellipsoids.from_semi_axes([[0, 0, 0], [1, 0, 0]], [3, 2, 1])  # two of the same shape
        Ellipsoids((2,), n=3)
        """
        axes = _validate.finite_array(semi_axes, "semi_axes", ("...", None))
        if not (axes > 0).all():
            raise GeometryError(f"semi_axes: expected lengths > 0, found {axes.min():g}")
        F = axes[..., None, :] * np.eye(axes.shape[-1])
        if rotation is not None:
            R = _validate.finite_array(rotation, "rotation", ("...", axes.shape[-1], axes.shape[-1]))
            _validate.broadcast({"rotation": R.shape[:-2], "semi_axes": axes.shape[:-1]})
            with np.errstate(over="ignore", invalid="ignore"):
                defect = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(R.shape[-1])).max() if R.size else 0.0
            if not defect <= tolerances.ROTATION_TOLERANCE:
                raise InputError(f"rotation: expected an orthogonal matrix, found a departure of {defect:.3g}")
            F = R @ F
        c = _validate.finite_array(center, "center", ("...", axes.shape[-1]))
        batch = _validate.broadcast({"center": c.shape[:-1], "semi_axes and rotation": F.shape[:-2]})
        return cls(np.broadcast_to(c, (*batch, c.shape[-1])), np.broadcast_to(F, (*batch, *F.shape[-2:])))

    # -- properties ---------------------------------------------------------------------------

    @property
    def dim(self) -> int:
        """Dimension n of the space."""
        return int(self.center.shape[-1])

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Shape of the batch; ``()`` for one ellipsoid."""
        return self.center.shape[:-1]

    def __len__(self) -> int:
        if not self.batch_shape:
            raise TypeError("one ellipsoid has no length; a batch has")
        return self.batch_shape[0]

    def __getitem__(self, index: int | slice | tuple[int | slice, ...] | Floats) -> Ellipsoids:
        if not self.batch_shape:
            raise BodyIndexError("one ellipsoid cannot be indexed; a batch can")
        try:
            c, F = self.center[index], self.factor[index]
        except Exception as error:  # an IndexError, or an error from the caller's object
            batch, text = _validate.shape_text(self.batch_shape), _validate.short(index)
            raise BodyIndexError(f"expected an index into a batch of shape {batch}, found {text} ({error})") from None
        if c.shape[-1:] != (self.dim,) or F.shape != (*c.shape, self.dim):
            raise BodyIndexError(f"expected an index of the batch only, found {_validate.short(index)}")
        return trusted(c, F)

    def __repr__(self) -> str:
        if self.batch_shape or self.dim > _validate.FEW:
            return f"Ellipsoids({_validate.shape_text(self.batch_shape)}, n={self.dim})"
        return f"Ellipsoids(center={self.center.tolist()}, semi_axes={self.semi_axes.tolist()})"

    @property
    @guarded
    def shape_matrix(self) -> Floats:
        """Q = F Fᵀ, shape (..., n, n), in square metres; entries may overflow to infinity or underflow to 0."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.factor @ np.swapaxes(self.factor, -1, -2)

    @property
    @guarded
    def semi_axes(self) -> Floats:
        """Semi-axis lengths, longest first, shape (..., n), in metres."""
        return np.asarray(np.linalg.svd(self.factor, compute_uv=False), dtype=np.float64)

    @property
    @guarded
    def rotation(self) -> Floats:
        """Orthogonal matrix whose columns are the axes, in the order of `semi_axes`; determinant +1."""
        U = np.linalg.svd(self.factor)[0]
        flip = np.where(np.linalg.det(U) < 0, -1.0, 1.0)
        U[..., :, -1] *= flip[..., None]
        return U

    @property
    def log_volume(self) -> Floats:
        """Natural logarithm of the volume, shape (...)."""
        n = self.dim
        unit_ball = 0.5 * n * math.log(math.pi) - math.lgamma(0.5 * n + 1)
        return np.asarray(unit_ball + np.linalg.slogdet(self.factor)[1])

    @property
    @guarded
    def volume(self) -> Floats:
        """Volume (area if n = 2), shape (...), in m^n; infinite on overflow, 0 on underflow (see `log_volume`)."""
        with np.errstate(over="ignore"):
            return np.exp(self.log_volume)

    # -- queries ------------------------------------------------------------------------------

    def support(self, direction: ArrayLike) -> Floats:
        """Find the point of each ellipsoid that is farthest along a direction.

        Parameters
        ----------
        direction : array_like, shape (..., n)
            Nonzero vectors, which broadcast with the batch.

        Returns
        -------
        ndarray, shape (..., n)

        Examples
        --------
        >>> Ellipsoids.from_semi_axes([1, 0], [3, 2]).support([1, 0])
        array([4., 0.])
        """
        d = _validate.finite_array(direction, "direction", ("...", self.dim))
        _validate.broadcast({"direction": d.shape[:-1], "the batch": self.batch_shape})
        if d.size and not d.any(axis=-1).all():
            raise InputError("direction: expected a non-zero vector, found zero")
        w = np.einsum("...ji,...j->...i", _near_one(self.factor, (-2, -1))[0], _near_one(d, (-1,))[0])
        w = _near_one(w, (-1,))[0]
        length = np.linalg.norm(w, axis=-1, keepdims=True)
        length[length == 0] = 1.0  # the distance from the center to the support point underflows
        return np.asarray(self.center + np.einsum("...ij,...j->...i", self.factor, w / length))

    def contains(self, points: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Decide whether points lie inside or on the ellipsoid, in plain float64 arithmetic.

        Parameters
        ----------
        points : array_like, shape (..., n)
            Points, which broadcast with the batch.

        Returns
        -------
        ndarray of bool, shape (...)

        Examples
        --------
        >>> Ellipsoids.from_semi_axes([0, 0], [3, 2]).contains([[2.9, 0], [0, 2.1]])
        array([ True, False])
        """
        p = _validate.finite_array(points, "points", ("...", self.dim))
        batch = _validate.broadcast({"points": p.shape[:-1], "the batch": self.batch_shape})
        F = np.broadcast_to(self.factor, (*batch, self.dim, self.dim))
        with np.errstate(over="ignore", invalid="ignore"):  # points whose coordinates overflow are outside
            x = np.broadcast_to(p - self.center, (*batch, self.dim))
            # A point, such as the inner ellipsoid of an open surface, contains only its center.
            point = np.asarray(~F.any(axis=(-2, -1)))
            F = np.asarray(np.where(point[..., None, None], np.eye(self.dim), F), dtype=np.float64)
            u = np.linalg.solve(F, x[..., None])[..., 0]
            return np.asarray(np.where(point, ~x.any(axis=-1), (u * u).sum(axis=-1) <= 1.0))

    def bounding_box(self) -> tuple[Floats, Floats]:
        """Compute the lower and upper corners, each of shape (..., n), of the axis-aligned bounding box.

        Returns
        -------
        lower, upper : ndarray, shape (..., n)
            The corners, in metres.

        Examples
        --------
        >>> Ellipsoids.from_semi_axes([1, 0], [3, 2]).bounding_box()
        (array([-2., -2.]), array([4., 2.]))
        """
        F, exponent = _near_one(self.factor, (-1,))
        half = np.ldexp(np.sqrt((F**2).sum(axis=-1)), exponent[..., 0])
        return self.center - half, self.center + half

    # -- motions ------------------------------------------------------------------------------

    def transformed(self, T: ArrayLike | None) -> Ellipsoids:
        """Move the ellipsoids by rigid motions of 3-space.

        Parameters
        ----------
        T : array_like, shape (..., 4, 4), or None
            The motions, which broadcast with the batch; translation in the ellipsoid's unit, which is metres for a
            body's ellipsoids. ``None`` is the identity.

        Returns
        -------
        Ellipsoids

        Raises
        ------
        PoseError
            If T is not a rigid motion.
        InputError
            If the ellipsoids are not three-dimensional, or batch shapes do not broadcast.

        Examples
        --------
        >>> T = np.eye(4)
        >>> T[2, 3] = 1.0
        >>> Ellipsoids.from_semi_axes([0, 0, 0], [3, 2, 1]).transformed(T).center
        array([0., 0., 1.])
        """
        if self.dim != 3:
            raise InputError(f"transformed: expected ellipsoids in 3-D, found dimension {self.dim}; use affine")
        P = _validate.poses(T, "T")
        _validate.broadcast({"T": P.shape[:-2], "the batch": self.batch_shape})
        return self._mapped(P[..., :3, :3], P[..., :3, 3])

    def affine(self, A: ArrayLike, b: ArrayLike) -> Ellipsoids:
        """Compute the image of the ellipsoids under x -> A x + b.

        Parameters
        ----------
        A : array_like, shape (..., n, n)
            Invertible matrices.
        b : array_like, shape (..., n)
            Vectors, in metres.

        Returns
        -------
        Ellipsoids

        Raises
        ------
        GeometryError
            If A is singular, or the image is too large or too thin for float64.
        InputError
            If shapes are wrong, entries are not finite, or batch shapes do not broadcast.

        Examples
        --------
        >>> Ellipsoids.from_semi_axes([0, 0], [1, 1]).affine([[2, 0], [0, 3]], [5, 5]).semi_axes
        array([3., 2.])
        """
        A_ = _validate.finite_array(A, "A", ("...", self.dim, self.dim))
        b_ = _validate.finite_array(b, "b", ("...", self.dim))
        if A_.size and not (np.linalg.svd(A_, compute_uv=False)[..., -1] > 0).all():
            raise GeometryError("A: expected an invertible matrix, found a singular one")
        _validate.broadcast({"A": A_.shape[:-2], "b": b_.shape[:-1], "the batch": self.batch_shape})
        return self._mapped(A_, b_)

    def _mapped(self, A: Floats, b: Floats) -> Ellipsoids:
        with np.errstate(over="ignore", invalid="ignore"):
            c = np.einsum("...ij,...j->...i", A, self.center) + b
            F = A @ self.factor
        there = np.isfinite(c).all() and np.isfinite(F).all()
        point = ~self.factor.any(axis=(-2, -1))  # a point stays a point
        if not there or (F.size and not (point | (np.linalg.svd(F, compute_uv=False)[..., -1] > 0)).all()):
            raise GeometryError("expected an image within the range of float64, found a larger or thinner one")
        return trusted(c, np.broadcast_to(F, (*c.shape, self.dim)))


def trusted(center: Floats, factor: Floats) -> Ellipsoids:
    """Wrap arrays that come from a fit or a rigid motion, without checking them again."""
    ellipsoids = object.__new__(Ellipsoids)
    ellipsoids._freeze(center, factor)
    return ellipsoids


def _near_one(x: Floats, axes: tuple[int, ...]) -> tuple[Floats, np.ndarray[tuple[int, ...], np.dtype[np.int_]]]:
    """Divide x exactly by a power of two near its largest entry along `axes`; also return the exponent."""
    exponent = np.frexp(np.abs(x).max(axis=axes, keepdims=True, initial=0.0))[1]
    return np.ldexp(x, -exponent), exponent
