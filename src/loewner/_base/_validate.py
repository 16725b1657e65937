"""Validate input: turn array-likes into checked float64 arrays in C order; and define types that signatures share.

Returned arrays are finite float64 in C order. ``poses(check=False)`` does not check whether poses are rigid: it leaves
the entries to the kernels, which read them anyway and report a bad pose.
"""

import math
import operator
import os
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _memory
from loewner._kernels import codes, tolerances
from loewner._native import entries
from loewner.errors import InputError, MemoryLimitError, PoseError, UnknownNameError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

Bools = NDArray[np.bool_]

# One value or an array, depending on an argument's number of axes, which the argument's type does not show.
FloatOrFloats = float | Floats
BoolOrBools = bool | Bools

# One value or an array, for results that a type checker should accept as either.
OneOrMany = Any

# The type of the values in a `Named`, and a class of this library.
Entry = TypeVar("Entry")
Kind = TypeVar("Kind")

# Names of two bodies or links.
Pair = tuple[str, str]

# A callback progress(done, total).
Progress = Callable[[int, int], None]

# Largest number of names that a message lists.
LISTED = 30

# Largest count; no array can have more entries.
LARGEST_INTEGER = 2**63 - 1
# Largest seed of random numbers; it has 128 bits, like NumPy's own seeds.
LARGEST_SEED = 2**128 - 1

# Largest number of characters of a value that a message shows.
LONGEST = 120
# Largest number of entries of an array that the repr of a result writes out.
FEW = 6

# Depth to which nested lists are searched for numbers with a unit. NumPy's arrays have at most this many axes.
MOST_AXES = 64

IDENTITY: Floats = np.eye(4)  # writable, since Numba would compile kernels again for the type of read-only arrays


def float_array(x: ArrayLike, name: str) -> Floats:
    """Return `x` as a C-order float64 array; anything but real numbers is an error.

    Numbers are integers and floats of any size and byte order, and objects that `real` accepts, but not booleans,
    complex numbers, text, dates or masked entries.
    """
    array = plain_array(x, name)
    if array.dtype == np.float64 and array.flags.c_contiguous and array.flags.aligned:
        return array
    if array.dtype == np.object_:
        return _numbers(array, name)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name}: expected real numbers, found dtype {array.dtype}")
    with np.errstate(over="ignore"):  # a longdouble may overflow to inf, which the error reports
        return array.astype(np.float64, order="C")


def integer_array(x: ArrayLike, name: str) -> Ints:
    """Return `x` as a C-order int64 array; anything but integers of at most 63 bits is an error."""
    array = plain_array(x, name)
    if array.dtype == np.object_ and array.size:
        entries = [whole_number(entry, name, -LARGEST_INTEGER) for entry in array.flat]
        return np.array(entries, dtype=np.int64).reshape(array.shape)
    if array.dtype.kind not in "iu" and array.size:
        raise InputError(f"{name}: expected integers, found dtype {array.dtype}")
    if array.dtype == np.uint64 and array.size and array.max() > LARGEST_INTEGER:
        raise InputError(f"{name}: expected integers <= {LARGEST_INTEGER}, found {array.max()}")
    return array.astype(np.int64, order="C")


def plain_array(x: ArrayLike, name: str) -> NDArray[Any]:
    """Make an array of the entries of `x`, of any type; refuse masked entries, which represent missing numbers."""
    if isinstance(x, (np.ma.MaskedArray, list, tuple)):
        parts = x if isinstance(x, (list, tuple)) else (x,)
        if any(isinstance(part, np.ma.MaskedArray) and np.ma.is_masked(part) for part in parts):
            raise InputError(f"{name}: expected numbers only, found masked entries")
    if type(x) is not np.ndarray:
        _refuse_quantity(x, name)
    if isinstance(x, (str, bytes, bytearray)):  # NumPy would convert a bytearray to an array of its bytes
        raise InputError(f"{name}: expected an array of numbers, found {short(x)}")
    try:
        return np.asarray(x)
    except MemoryError:
        raise
    except Exception as error:  # the array is ragged, or the caller's object fails to convert itself to an array
        what = "a ragged sequence" if isinstance(x, (list, tuple)) else type(x).__name__
        raise InputError(
            f"{name}: expected an array of numbers, found {what} ({type(error).__name__}: {error})"
        ) from None


def _refuse_quantity(x: Any, name: str) -> None:
    """Refuse numbers with a unit, as in astropy, pint and xarray; for a list, the first entry decides."""
    for _ in range(MOST_AXES):
        if not (isinstance(x, (list, tuple)) and x):
            break
        x = x[0]
    if type(x) in (np.ndarray, list, tuple, float, int, str):
        return
    try:
        # A table may have a column named "unit" or "units", which is not a unit.
        units = (getattr(x, key, None) for key in ("unit", "units"))
        stated = [
            str(unit) for unit in units if isinstance(unit, str) or not (callable(unit) or hasattr(unit, "__len__"))
        ]
        unit = next((unit for unit in stated if unit not in ("None", "", "dimensionless")), "")
    except Exception:  # the caller's object may raise any error
        return
    if unit:
        raise InputError(f"{name}: expected plain numbers in metres or radians, found a quantity in {short(unit)}")


def _numbers(objects: NDArray[np.object_], name: str) -> Floats:
    """Convert entries that are not NumPy numbers, such as fractions or integers beyond 64 bits, one by one."""
    array = np.empty(objects.shape)
    for index, entry in np.ndenumerate(objects):
        try:
            array[index] = real(entry, name)
        except InputError as error:
            raise InputError(f"{error}{_at(index)}") from None
    return array


def _at(index: tuple[int, ...]) -> str:
    """Write the index of an entry for messages; nothing for a scalar."""
    return f" at index {index}" if index else ""


def shape_text(shape: Iterable[int | None | str]) -> str:
    """Write a shape for messages, with letters or dots for arbitrary lengths."""
    parts = ["n" if s is None else str(s) for s in shape]
    return "(" + ", ".join(parts) + ("," if len(parts) == 1 else "") + ")"


def finite_array(x: ArrayLike, name: str, shape: tuple[int | None | str, ...]) -> Floats:
    """Check shape and finiteness.

    Parameters
    ----------
    x : array_like
    name : str
        The caller's name for `x`, for the message.
    shape : tuple
        Expected shape; ``None`` or a letter matches any length, a leading ``"..."`` any batch shape.

    Raises
    ------
    InputError
        The message gives the expected and the found shape, or the first entry that is not finite.
    """
    array = float_array(x, name)
    tail = shape[1:] if shape and shape[0] == "..." else shape
    fits = array.ndim >= len(tail) if len(tail) < len(shape) else array.ndim == len(tail)
    lengths = zip(reversed(tail), reversed(array.shape), strict=False)
    if not (fits and all(want == have for want, have in lengths if isinstance(want, int))):
        raise InputError(f"{name}: expected shape {shape_text(shape)}, found {shape_text(array.shape)}")
    _expect_each(np.isfinite(array), array, f"{name}: expected finite numbers")
    return array


def _expect_each(right: Bools, array: Floats, wanted: str) -> None:
    """Refuse an array unless all entries are right; the message gives the first wrong entry."""
    if not right.all():
        where = tuple(np.argwhere(~right)[0].tolist())
        raise InputError(f"{wanted}, found {array[where]}{_at(where)}")


def real(x: Any, name: str, *, least: str = "") -> float:
    """Check one finite number.

    Parameters
    ----------
    x : number
        An int or a float, of Python or NumPy; an array without axes; or an object that converts itself to a float, such
        as a Fraction, a Decimal or a tensor. Booleans and numbers in text are refused.
    name : str
        The caller's name for `x`, for the message.
    least : str
        Words that follow "a finite number" in the message, about a condition that the caller checks.

    Raises
    ------
    InputError
        If `x` is not a number, is not finite, or exceeds the range of a float.
    """
    _refuse_quantity(x, name)
    if isinstance(x, (bool, np.bool_, str, bytes, bytearray)) or not _maybe_a_number(x):
        raise InputError(f"{name}: expected a number, found {short(x)}")
    try:
        value = float(x)
    except OverflowError:
        value = math.inf
    except Exception:
        raise InputError(f"{name}: expected a number, found {short(x)}") from None
    if not math.isfinite(value):
        raise InputError(f"{name}: expected a finite number{least}, found {short(x)}")
    return value


def _maybe_a_number(x: Any) -> bool:
    """Return whether `float` may be tried; False for arrays with axes, masked numbers, and NumPy's dates and texts."""
    if isinstance(x, (np.ndarray, np.generic)):
        return x.ndim == 0 and x.dtype.kind in "fiuO" and not np.ma.is_masked(x)
    return True


def positive_scalar(x: Any, name: str, *, zero: bool = False) -> float:
    """Check a finite number above zero (with `zero`, at least zero); see `real` for the accepted types."""
    if type(x) is float and (0.0 < x < math.inf or (zero and x == 0.0)):  # a fast path for the usual case
        return x
    least = " >= 0" if zero else " > 0"
    value = real(x, name, least=least)
    if value < 0 or (value == 0 and not zero):
        raise InputError(f"{name}: expected a finite number{least}, found {short(x)}")
    return value


def whole_number(x: Any, name: str, least: int, most: int = LARGEST_INTEGER) -> int:
    """Check an integer from `least` to `most`; a boolean is refused."""
    try:
        value = least - 1 if isinstance(x, bool) or np.ma.is_masked(x) else operator.index(x)
    except Exception:  # a TypeError, or an error that the caller's object raised
        value = least - 1
    if value < least:
        raise InputError(f"{name}: expected an integer >= {least}, found {short(x)}")
    if value > most:
        raise InputError(f"{name}: expected an integer <= {most}, found {short(x)}")
    return value


def instance(x: Any, name: str, kind: type[Kind], home: str = "loewner") -> Kind:
    """Check that `x` is an instance of a class that the module `home` makes public."""
    if isinstance(x, kind):
        return x
    raise InputError(f"{name}: expected {home}.{kind.__name__}, found {type(x).__name__}")


def flag(x: Any, name: str) -> bool:
    """Check a choice between True and False; other values, such as the text 'no', are refused."""
    if isinstance(x, (bool, np.bool_)):
        return bool(x)
    raise InputError(f"{name}: expected True or False, found {short(x)}")


def expect_name(x: Any, wanted: str = "name: expected a name") -> str:
    """Refuse anything except a non-empty string, and return a NumPy string as a Python string."""
    if not isinstance(x, str) or not x:
        raise InputError(f"{wanted}, found {short(x)}")
    return str(x)


def unused(name: str, taken: Container[str]) -> str:
    """Return a name that is not yet taken."""
    while name in taken:
        name += "_"
    return name


def choice(x: Any, name: str, known: Collection[str]) -> str:
    """Check that `x` is one of the `known` names."""
    if isinstance(x, str) and x in known:  # check the type first: arrays compare by entries, and lists have no hash
        return x
    raise UnknownNameError(f"{name}: expected one of {', '.join(known)}, found {short(x)}")


def listed(x: Any, name: str, *, wanted: str = "a list") -> list[Any]:
    """Check an iterable and return its items as a list; text is not accepted as a list of its letters."""
    if isinstance(x, (str, bytes, bytearray)):
        raise InputError(f"{name}: expected {wanted}, found one text, {short(x)}")
    try:
        return list(x)
    except MemoryError:
        raise
    except Exception:  # the object is not iterable, or raised an error
        raise InputError(f"{name}: expected {wanted}, found {short(x)}") from None


def mapping(x: Any, name: str, contents: str, least: int = 0) -> Mapping[Any, Any]:
    """Check a mapping with at least `least` entries; None means an empty mapping."""
    entries = {} if x is None else x
    if not isinstance(entries, Mapping) or len(entries) < least:
        raise InputError(f"{name}: expected a mapping {contents}, found {short(x)}")
    return entries


def group_or_names(x: Any, name: str) -> Any:
    """Return a group's name or None unchanged, and several names as a list, since an iterator is read only once."""
    return x if x is None or isinstance(x, str) else listed(x, name)


def callback(x: Any, name: str) -> Any:
    """Check a callable, or None."""
    if x is not None and not callable(x):
        raise InputError(f"{name}: expected a function or None, found {short(x)}")
    return x


def silent(done: int, total: int) -> None:
    """Report no progress."""


def reporter(progress: Any) -> Progress:
    """Check a callback progress(done, total), and replace None by a function that reports nothing."""
    return cast(Progress, silent if callback(progress, "progress") is None else progress)


def broadcast(shapes: dict[str, tuple[int, ...]], error: type[InputError] = InputError) -> tuple[int, ...]:
    """Return the shape to which batch shapes broadcast; an error names shapes that do not broadcast."""
    different = {*shapes.values()} - {()}
    if len(different) < 2:  # usually; NumPy's function takes longer than the rest of a small query
        return different.pop() if different else ()
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        listing = ", ".join(f"{name}: {shape_text(shape)}" for name, shape in shapes.items())
        raise error(f"expected batch shapes that broadcast, found {listing}") from None


def positive_array(x: ArrayLike, name: str, shape: tuple[int | None | str, ...]) -> Floats:
    """Check the shape, and that all numbers are finite and above zero."""
    array = finite_array(x, name, shape)
    _expect_each(array > 0, array, f"{name}: expected numbers > 0")
    return array


def increasing(times: Floats, name: str) -> None:
    """Check that each time is later than the time before it."""
    for k in np.flatnonzero(~(np.diff(times) > 0))[:1]:
        before, after = times[k : k + 2].tolist()
        raise InputError(f"{name}: expected times that increase, found {before:.15g} and then {after:.15g} at {k + 1}")


def positive_lengths(x: ArrayLike, name: str, shape: tuple[int, ...]) -> Floats:
    """Check numbers above zero whose shape broadcasts to `shape`, aligned at the last axes."""
    array = float_array(x, name)
    if array.ndim > len(shape) or array.shape != shape[len(shape) - array.ndim :]:
        shapes = " or ".join(str(shape[k:]) for k in range(len(shape)))
        raise InputError(f"{name}: expected a number or an array of shape {shapes}, found shape {array.shape}")
    return positive_array(array, name, array.shape)


def poses(T: ArrayLike | None, name: str, *, check: bool = True) -> Floats:
    """Check rigid motions.

    Parameters
    ----------
    T : array_like, shape (..., 4, 4), or None
        Homogeneous matrices; ``None`` is the identity.
    check : bool
        Whether to check the entries here; False leaves this check to the kernels, which read the entries anyway.

    Raises
    ------
    PoseError
        If the shape is wrong, an entry is not finite, the last row is not (0, 0, 0, 1), or the
        rotation part is not orthonormal to `tolerances.ROTATION_TOLERANCE` with determinant +1.
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
    if not array.flags.carray:  # to Numba, read-only arrays are of another type; see IDENTITY
        array = array.copy()
    if check:
        rigid_motions(array, name)
    return array


def pose(T: ArrayLike | None, name: str) -> Floats:
    """Check one rigid motion, shape (4, 4), and return a new array; ``None`` is the identity."""
    checked = poses(T, name)
    if checked.shape != (4, 4):
        raise PoseError(f"{name}: expected shape (4, 4), found {shape_text(checked.shape)}")
    return checked.copy()


def pose_error(x: ArrayLike | None, name: str) -> tuple[float, float]:
    """Check the error of a pose, in metres and radians; None stands for (0, 0)."""
    if x is None:
        return 0.0, 0.0
    metres, radians = finite_array(x, name, (2,)).tolist()
    if not (metres >= 0.0 and radians >= 0.0):
        raise InputError(f"{name}: expected metres and radians >= 0, found {metres:g} and {radians:g}")
    return metres, radians


def rigid_motions(T: Floats, name: str) -> None:
    """Check poses of shape (..., 4, 4) one by one."""
    batch = T.reshape(-1, 4, 4)
    at, kind, size = entries.first_fault(batch)
    if at < len(batch):
        where = f"{name}[{at}]" if len(batch) > 1 else name
        tolerance = tolerances.ROTATION_TOLERANCE
        raise PoseError(f"{where}: {_POSE_FAULTS[kind].format(size=size, tolerance=tolerance, T=batch[at])}")


_POSE_FAULTS = {
    codes.NOT_FINITE: "expected finite numbers, found NaN or inf",
    codes.LAST_ROW: "expected last row [0. 0. 0. 1.], found {T[3]}",
    codes.NOT_ORTHONORMAL: "expected a rotation (RᵀR = 1 within {tolerance:g}), found a departure of {size:.3g}",
    codes.REFLECTION: "expected a rotation with determinant +1, found a reflection (determinant {size:.3g})",
}


def path(x: Any, name: str, *, wanted: str = "the path of a file") -> Path:
    """Check the name of a file or folder, which need not exist.

    Parameters
    ----------
    x : str or os.PathLike of str
    name : str
        The caller's name for `x`, for the message.
    wanted : str
        Description of the expected file, for the message.

    Raises
    ------
    InputError
        If `x` is not text, is empty, or contains a NUL or characters that the file system cannot encode (lone
        surrogates, except for the ones with which Python itself represents names that are not UTF-8).
    """
    try:
        text = os.fspath(x)
    except Exception as error:  # the caller's path-like object may raise any error
        reason = "" if isinstance(error, TypeError) else f" ({type(error).__name__}: {error})"
        raise InputError(f"{name}: expected {wanted}, found {short(x)}{reason}") from None
    if not isinstance(text, str) or not text:
        raise InputError(f"{name}: expected {wanted}, found {short(text)}")
    try:
        os.fsencode(text)
    except UnicodeEncodeError as error:
        raise InputError(f"{name}: expected {wanted}, found {short(text)} ({error.reason})") from None
    if "\0" in text:
        raise InputError(f"{name}: expected {wanted}, found {short(text)}, which holds a NUL")
    return Path(text)


def short(x: Any) -> str:
    """Return the text of a value for messages: its `repr`, cut if it is long, or its type if its `repr` fails."""
    try:
        text = repr(x)
    except Exception:  # from the caller's object, or from an integer with more digits than Python writes
        text = f"{type(x).__name__}, which cannot be shown"
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 20]} ... ({type(x).__name__})"


def some(names: Iterable[str], most: int = LISTED, divider: str = ", ") -> str:
    """Join names for a message: at most the first `most` of them, and how many more there are."""
    listed = list(names)
    return divider.join(listed[:most] + [f"and {len(listed) - most} more"] * (len(listed) > most))


def unknown_name(what: str, name: Any, known: Iterable[str]) -> UnknownNameError:
    """Make the error about an unknown name; the message lists the `known` names, and suggests the most similar name."""
    import difflib  # only this message needs it

    listed = list(known)
    nearest = difflib.get_close_matches(name, listed, n=1) if isinstance(name, str) else []
    hint = f" (did you mean {nearest[0]!r}?)" if nearest else ""
    names = some(listed) or "(there are none)"
    return UnknownNameError(f"{what}: expected one of {names}; found {short(name)}{hint}")


def known(x: Any, what: str, names: Collection[str]) -> str:
    """Check that `x` is one of many names; the error suggests the most similar name."""
    if isinstance(x, str) and x in names:
        return x
    raise unknown_name(what, x, names)


class Named(dict[str, Entry]):
    """A read-only dict for users; the error about an unknown name lists the known names."""

    def __init__(self, what: str, entries: Mapping[str, Entry]) -> None:
        super().__init__(entries)
        self._what = what

    def __missing__(self, name: object) -> NoReturn:
        raise unknown_name(self._what, name, self)

    def __reduce__(self) -> tuple[Any, ...]:
        return Named, (self._what, dict(self))

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise InputError(
            f"a {self._what} cannot be set or removed in place: expected a new object with the changed entries, "
            "since answers have been prepared from these"
        )

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse


class Brief:
    """A dataclass that is shown in a few lines: numbers in full, long arrays by their shapes."""

    def __repr__(self) -> str:
        parts = []
        for entry in fields(cast(Any, self)):
            value = getattr(self, entry.name)
            if isinstance(value, np.ndarray) and (value.size > FEW or value.ndim > 1):
                parts.append(f"{entry.name}=<{shape_text(value.shape)} {value.dtype}>")
            elif isinstance(value, np.ndarray):
                parts.append(f"{entry.name}={np.array2string(value, precision=6, separator=', ')}")
            elif value is not None:
                parts.append(f"{entry.name}={value!r}")
        return f"{type(self).__name__}({', '.join(parts)})"


def fits_memory(needed: int, what: str) -> None:
    """Refuse results of `needed` bytes if they exceed the machine's memory or a limit on this process."""
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
    """Return the memory of the machine, in bytes."""
    return _memory.physical()
