"""The border: array-likes in, checked C-order float64 arrays out.

Everything past this module may assume finite float64 in C order and rigid poses.
"""

import difflib
import math
import operator
from collections.abc import Iterable
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner import _memory
from loewner._kernels import rigid
from loewner.errors import InputError, MemoryLimitError, PoseError, UnknownNameError

Floats = NDArray[np.float64]

# Names that the message about an unknown one lists at most.
LISTED = 30

# Entries of an array that is written out in the repr of a result, at most.
FEW = 6

IDENTITY: Floats = np.eye(4)  # not read-only: to Numba that would be another type, compiled all over again


def float_array(x: ArrayLike, name: str) -> Floats:
    """Return `x` as a C-order float64 array; anything that is not real numbers is an error."""
    try:
        array = np.asarray(x)
    except ValueError as error:
        raise InputError(f"{name}: expected an array of numbers, found a ragged sequence ({error})") from None
    if array.dtype == np.float64 and array.flags.c_contiguous:
        return array
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name}: expected real numbers, found dtype {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)


def shape_text(shape: Iterable[int | None | str]) -> str:
    """Write a shape for people, with letters or dots where any length will do."""
    parts = ["n" if s is None else str(s) for s in shape]
    return "(" + ", ".join(parts) + ("," if len(parts) == 1 else "") + ")"


def finite_array(x: ArrayLike, name: str, shape: tuple[int | None | str, ...]) -> Floats:
    """Check shape and finiteness.

    Parameters
    ----------
    x : array_like
    name : str
        What the caller calls it, for the message.
    shape : tuple
        Expected shape; ``None`` matches any length, a leading ``"..."`` any batch shape.

    Raises
    ------
    InputError
        With the shape expected and the one found, or the first entry that is not finite.
    """
    array = float_array(x, name)
    tail = shape[1:] if shape and shape[0] == "..." else shape
    fits = array.ndim >= len(tail) if len(tail) < len(shape) else array.ndim == len(tail)
    if fits and tail:
        fits = all(want is None or want == have for want, have in zip(tail, array.shape[-len(tail) :], strict=True))
    if not fits:
        raise InputError(f"{name}: expected shape {shape_text(shape)}, found {shape_text(array.shape)}")
    if array.size and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(f"{name}: expected finite numbers, found {array[where]} at index {where}")
    return array


def positive_scalar(x: Any, name: str, *, zero: bool = False) -> float:
    """Check a finite number above zero (or not below it, with `zero`)."""
    if type(x) is float and (0.0 < x < math.inf or (zero and x == 0.0)):  # the usual case, quickly
        return x
    try:
        value = float(x)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected a number, found {x!r}") from None
    if not math.isfinite(value) or value < 0 or (value == 0 and not zero):
        raise InputError(f"{name}: expected a finite number {'>= 0' if zero else '> 0'}, found {x!r}")
    return value


def whole_number(x: Any, name: str, least: int) -> int:
    """Check an integer that is not below `least`."""
    try:
        value = operator.index(x)
    except TypeError:
        value = least - 1
    if isinstance(x, bool) or value < least:
        raise InputError(f"{name}: expected an integer >= {least}, found {x!r}")
    return value


def positive_array(x: ArrayLike, name: str, shape: tuple[int | None | str, ...]) -> Floats:
    """Check shape, and that all numbers are finite and above zero."""
    array = finite_array(x, name, shape)
    if not (array > 0).all():
        where = tuple(int(i) for i in np.argwhere(~(array > 0))[0])
        raise InputError(f"{name}: expected numbers > 0, found {array[where]} at index {where}")
    return array


def positive_vector(x: ArrayLike, name: str, length: int | None) -> Floats:
    """Check a vector of finite numbers above zero."""
    return positive_array(x, name, (length,))


def one_pose(T: Any) -> Floats | None:
    """Return a single pose if no more than a look tells that it can go to a kernel; its entries are not checked."""
    if T is None:
        return IDENTITY
    if type(T) is np.ndarray and T.shape == (4, 4) and T.dtype == np.float64 and T.flags.carray:
        return T
    return None


def poses(T: ArrayLike | None, name: str, *, check: bool = True) -> Floats:
    """Check rigid motions.

    Parameters
    ----------
    T : array_like, shape (..., 4, 4), or None
        Homogeneous matrices; ``None`` is the identity.
    check : bool
        False leaves the entries to whoever goes through them anyway.

    Raises
    ------
    PoseError
        If the shape is wrong, an entry is not finite, the last row is not (0, 0, 0, 1), or the
        rotation part is not orthonormal to `rigid.ROTATION_TOLERANCE` with determinant +1.
    """
    if T is None:
        return IDENTITY
    try:
        array = float_array(T, name)
    except InputError as error:
        raise PoseError(str(error)) from None
    if array.shape[-2:] != (4, 4):
        cure = "; T = np.eye(4), T[:3, :3] = rotation, T[:3, 3] = translation makes one"
        raise PoseError(f"{name}: expected shape (..., 4, 4), found {shape_text(array.shape)}{cure}")
    if not array.flags.carray:  # read-only: to Numba another type, see above
        array = array.copy()
    if check:
        rigid_motions(array, name)
    return array


def pose(T: ArrayLike | None, name: str) -> Floats:
    """Check one rigid motion, shape (4, 4); ``None`` is the identity. The array returned is the caller's own."""
    checked = poses(T, name)
    if checked.shape != (4, 4):
        raise PoseError(f"{name}: expected shape (4, 4), found {shape_text(checked.shape)}")
    return checked.copy()


def rigid_motions(T: Floats, name: str) -> None:
    """Check poses of shape (..., 4, 4) one by one."""
    batch = T.reshape(-1, 4, 4)
    at, kind, size = rigid.first_fault(batch)
    if at < len(batch):
        where = f"{name}[{at}]" if len(batch) > 1 else name
        tolerance = rigid.ROTATION_TOLERANCE
        raise PoseError(f"{where}: {_POSE_FAULTS[kind].format(size=size, tolerance=tolerance, T=batch[at])}")


_POSE_FAULTS = {
    rigid.NOT_FINITE: "expected finite numbers, found NaN or inf",
    rigid.LAST_ROW: "expected last row [0. 0. 0. 1.], found {T[3]}",
    rigid.NOT_ORTHONORMAL: "expected a rotation (RᵀR = 1 within {tolerance:g}), found a departure of {size:.3g}",
    rigid.REFLECTION: "expected a rotation with determinant +1, found a reflection (determinant {size:.3g})",
}


def unknown_name(what: str, name: Any, known: Iterable[str]) -> UnknownNameError:
    """Make the error about a name that is none of the `known` ones: it lists them, and the nearest first."""
    listed = list(known)
    nearest = difflib.get_close_matches(str(name), listed, n=1)
    hint = f" (did you mean {nearest[0]!r}?)" if nearest else ""
    more = f", and {len(listed) - LISTED} more" if len(listed) > LISTED else ""
    return UnknownNameError(
        f"{what}: expected one of {', '.join(listed[:LISTED]) or '(there are none)'}{more}; found {name!r}{hint}"
    )


def brief(record: Any) -> str:
    """Write a result for people: numbers as they are, long arrays by their shapes, on a few lines at most."""
    parts = []
    for entry in fields(record):
        value = getattr(record, entry.name)
        if isinstance(value, np.ndarray) and (value.size > FEW or value.ndim > 1):
            parts.append(f"{entry.name}=<{shape_text(value.shape)} {value.dtype}>")
        elif isinstance(value, np.ndarray):
            parts.append(f"{entry.name}={np.array2string(value, precision=6, separator=', ')}")
        elif value is not None:
            parts.append(f"{entry.name}={value!r}")
    return f"{type(record).__name__}({', '.join(parts)})"


def fits_memory(needed: int, what: str) -> None:
    """Refuse results of `needed` bytes that the machine, or a limit on this process, has no room for."""
    there, which = physical_memory(), ""
    if needed >= _memory.LOOK:
        there, which = min((there, which), _memory.left())
    if needed > there:
        raise MemoryLimitError(
            f"expected a batch whose results fit into memory ({there / 2**30:.3g} GiB{which}), found {what}, "
            f"which need {needed / 2**30:.3g} GiB; query them in parts"
        )


@cache
def physical_memory() -> int:
    """Memory of the machine, in bytes."""
    return _memory.physical()
