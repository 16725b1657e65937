"""Define every error that `loewner` raises on purpose, each as a subclass of `LoewnerError`.

Each error also derives from the matching built-in exception, so that callers can write ``except ValueError``.
"""

from importlib import import_module
from typing import Any

import numpy as np


class LoewnerError(Exception):
    """The base class of all errors that `loewner` raises on purpose.

    Examples
    --------
    >>> import loewner
    >>> try:
    ...     loewner.Body.sphere(-1.0)
    ... except loewner.LoewnerError as error:
    ...     print(error)
    radius: expected a finite number > 0, found -1.0
    """


class InputError(LoewnerError, ValueError):
    """An argument has the wrong shape, type or value.

    Examples
    --------
    >>> import loewner
    >>> loewner.Body.box([1.0, 2.0])
    Traceback (most recent call last):
        ...
    loewner.errors.InputError: size: expected shape (3,), found (2,)
    """


class GeometryError(InputError):
    """The geometry is empty, flat, unbounded, or too small for an ellipsoid.

    Examples
    --------
    >>> import loewner
    >>> loewner.Body.from_points([[0, 0, 0], [1, 0, 0]])
    Traceback (most recent call last):
        ...
    loewner.errors.GeometryError: points: expected at least 4 points in dimension 3, found 2
    """


class PoseError(InputError):
    """A pose does not have the shape (..., 4, 4), is not a rigid motion, or does not broadcast.

    Examples
    --------
    >>> import loewner
    >>> ball = loewner.Body.sphere(1.0)
    >>> loewner.collide(ball, None, ball, [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    Traceback (most recent call last):
        ...
    loewner.errors.PoseError: T_world_b: expected a rotation (RᵀR = 1 within 1e-06), found a departure of 3
    """


class ConvergenceError(LoewnerError, ArithmeticError):
    """An iteration did not converge to a certified result, and no uncertified result is returned.

    Attributes
    ----------
    indices : ndarray of int
        The flat indices, within the batch, of the pairs that could not be settled.
    partial : object or None
        The query's result, with the answers for all settled pairs. For the unsettled pairs, the result of `collide` is
        True, and exact distances, witnesses and normals are NaN.

    Examples
    --------
    >>> import numpy as np
    >>> import loewner
    >>> far = 1 + 1e-8 * np.random.default_rng(0).normal(size=(9, 2))  # coordinates with few digits left
    >>> try:
    ...     loewner.mvce(far, tol=1e-12)
    ... except loewner.ConvergenceError as error:
    ...     print(str(error).split(";")[1])
     a thin body far from the origin may not have that many digits: ask for a larger tol, or move it to the origin
    """

    def __init__(self, message: str, indices: Any = (), partial: Any = None) -> None:
        super().__init__(message)
        self.indices = np.asarray(indices, dtype=np.intp)
        self.partial = partial

    def __reduce__(self) -> Any:
        return type(self), (str(self), self.indices, self.partial)


class MemoryLimitError(InputError, MemoryError):
    """A call would need more memory than is available or allowed for the process; divide the call into smaller ones.

    The machine, the process (``ulimit -v``, that is, RLIMIT_AS) and its container (control groups) set the limits.
    Results that are too large are refused before anything is computed, and the message states their size.

    Examples
    --------
    >>> import numpy as np
    >>> import loewner
    >>> T = np.tile(np.eye(4), (300_000, 1, 1))
    >>> loewner.distance(loewner.Body.sphere(1.0), T[:, None], loewner.Body.sphere(1.0), T)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    loewner.errors.MemoryLimitError: expected a batch whose results fit into memory (...
    """


class PlanningError(LoewnerError, RuntimeError):
    """Planning failed: the start or the goal is not free, or no path was found; the message gives the reason.

    Examples
    --------
    >>> import loewner
    >>> from loewner import planners
    >>> checker = loewner.CollisionChecker(loewner.Robot.from_urdf("arm.urdf"))
    >>> planners.plan(checker, [0.0, 0.0], [3.0, 0.0], joints="rail")
    Traceback (most recent call last):
        ...
    loewner.errors.PlanningError: goal: expected a free configuration within the limits, found rail = 3 outside 0 .. 2
    """


class GpuError(LoewnerError, RuntimeError):
    """A GPU cannot do the work: it is missing, its driver is too old, its memory is too small, or its work was lost.

    Attributes
    ----------
    code : int or None
        The driver's error code, if it returned one.

    Examples
    --------
    Without an NVIDIA GPU:

    >>> import loewner.gpu
    >>> loewner.gpu.classify(body, T, other, None)  # doctest: +SKIP
    Traceback (most recent call last):
        ...
    loewner.errors.GpuError: expected NVIDIA's driver, found no libcuda.so.1 to load (...)
    """

    def __init__(self, message: str, code: int | None = None) -> None:
        super().__init__(message)
        self.code = code

    def __reduce__(self) -> Any:
        return type(self), (str(self), self.code)


class FileError(LoewnerError, OSError):
    """A file is missing, empty, truncated or of the wrong kind, or it cannot be written.

    Examples
    --------
    >>> import loewner
    >>> loewner.Body.load("none.npz")
    Traceback (most recent call last):
        ...
    loewner.errors.FileError: none.npz: expected a saved file, but there is no such file
    """


class UnknownNameError(LoewnerError, KeyError):
    """A name, for instance of a link, joint, body or method, is unknown; the message lists the valid names.

    Examples
    --------
    >>> import loewner
    >>> loewner.Robot.from_urdf("arm.urdf").configuration("rest")
    Traceback (most recent call last):
        ...
    loewner.errors.UnknownNameError: state: expected one of (there are none); found 'rest'
    """

    def __str__(self) -> str:
        # KeyError would print the repr of the message, with quotes around it.
        return str(self.args[0]) if self.args else ""


class BodyIndexError(LoewnerError, IndexError):
    """A sequence of bodies has no body with the given index.

    Examples
    --------
    >>> import loewner
    >>> loewner.Bodies.spheres([1.0, 2.0])[2]
    Traceback (most recent call last):
        ...
    loewner.errors.BodyIndexError: expected an index from -2 to 1, found 2
    """


class MissingExtraError(LoewnerError, ImportError):
    """An optional package is needed but not installed; the message names the extra to install.

    Examples
    --------
    Without CoACD:

    >>> loewner.Body.from_mesh("part.stl")  # doctest: +SKIP
    Traceback (most recent call last):
        ...
    loewner.errors.MissingExtraError: decomposing meshes needs coacd: pip install "loewner[meshes]"
    """


def imported(module: str, purpose: str, extra: str) -> Any:
    """Import a module of an optional package; `MissingExtraError` states its `purpose` and how to install it."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtraError(f"{purpose}: {installing(extra)}") from None


def installing(extra: str) -> str:
    """Return, for messages, the commands that install an optional part: from a package index, and in a clone."""
    return f'pip install "loewner[{extra}]", or pip install ".[{extra}]" in a clone'
