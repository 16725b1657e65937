"""Write arrays to ``.npz`` files atomically, and read arrays from ``.npz`` and ``.npy`` files as pure data.

A file is read in steps, and each step trusts only facts that earlier steps have checked. The file must be a regular
file, and an archive with the expected members. The first bytes of each member give its type and shape. The resulting
size must agree with the size that the archive states, and all sizes together must not exceed a limit. The numbers and
their checksum are read last. The caller checks the meaning of the numbers.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from loewner._base._files import replacing
from loewner._base._validate import physical_memory
from loewner.errors import FileError, InputError

T = TypeVar("T")

# Largest total size of a file's unpacked arrays [bytes], enough for about a hundred million pieces. The machine's
# memory may set a lower limit.
LARGEST_CONTENT = 2**36

# Largest size of texts, such as format, digest and names [bytes].
LARGEST_TEXT = 2**12

# CHUNK is the number of bytes that are unpacked at a time. MOST_AT_ONCE limits a single read of the file itself. The
# longest such read is the archive's directory, which takes about a kilobyte.
CHUNK, MOST_AT_ONCE = 2**18, 2**20

# Members that every file has in addition to its arrays.
OWN = ("format", "version", "digest")

# An array begins with MAGIC, followed by two bytes for the version. The first version byte determines how many bytes
# hold the length of the header, which is at most LONGEST_HEADER in `.npy` files.
MAGIC, LENGTH_BYTES, LONGEST_HEADER = b"\x93NUMPY", {1: 2, 2: 4, 3: 4}, 2**16

# NumPy's header of a plain array. NumPy evaluates such headers; here, a header must match this pattern.
HEADER = re.compile(
    rb"\{'descr': '([<>|=][a-zA-Z]\d{1,6})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,18}, ?)*(?:\d{1,18})?)\), \} *\n"
)


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes
    ----------
    name : str
        Text in the member "format".
    version : int
        The newest version; files of older versions are read as well.
    what : str
        Description of the content for messages, such as "a body".
    else_use : str
        Advice for messages about other kinds of files.
    arrays : tuple of str
        Members that hold numbers.
    integers : frozenset of str
        Members among `arrays` that hold integers.
    check_shapes : callable
        Called with a dict of the arrays' shapes before any array is unpacked; raises InputError for wrong shapes.
    texts : tuple of str
        Members that hold short texts.
    optional : frozenset of str
        Members among `texts` that may be missing.
    """

    name: str
    version: int
    what: str
    else_use: str
    arrays: tuple[str, ...]
    integers: frozenset[str]
    check_shapes: Callable[[Mapping[str, tuple[int, ...]]], None]
    texts: tuple[str, ...] = ()
    optional: frozenset[str] = frozenset()


def write(path: str | os.PathLike[str], kind: Format, arrays: Mapping[str, Any], version: int | None = None) -> None:
    """Write arrays and texts to a file.

    Parameters
    ----------
    path : path
    kind : Format
    arrays : dict
    version : int, optional
        The oldest version that supports these arrays; the default is the newest version.

    Raises
    ------
    InputError
        If the path is not valid, or does not end in .npz.
    FileError
        If the file cannot be written, or would be too large to be read again; an older file stays unchanged.
    """
    target = Path(_expect_path(path))
    if target.suffix != ".npz":
        raise InputError(f"path: expected a name that ends in .npz, found {target.name!r}")
    _check_content(sum(np.asarray(array).nbytes for array in arrays.values()), str(target))
    content = {"format": kind.name, "version": version or kind.version, "digest": digest(arrays)}
    with replacing(target) as temporary, open(temporary, "xb") as stream:
        _save(stream, {**content, **arrays})


def _save(stream: IO[bytes], content: dict[str, Any]) -> None:
    """Write arrays as an archive; raise an interrupt as such, not as zipfile's error about the unfinished entry."""
    try:
        np.savez_compressed(stream, **content)
    except ValueError as error:
        cause = error.__context__
        if cause is None or isinstance(cause, Exception):
            raise
    else:
        return
    try:  # as in `_guard.py`
        raise cause
    finally:
        del cause


def read(
    path: str | os.PathLike[str], kind: Format, make: Callable[[dict[str, Any]], T], wanted: str | None = None
) -> T:
    """Read a file written by `write`.

    Parameters
    ----------
    path : path
    kind : Format
    make : callable
        Called with a dict of the arrays: int64 or float64 in C order, and arrays of texts. `read` returns the result of
        `make`; an InputError that `make` raises becomes a FileError that names the file.
    wanted : str, optional
        The `digest` that the content must have.

    Raises
    ------
    InputError
        If the path is not valid.
    FileError
        If the file does not exist, is of another kind, is damaged, or does not have the `wanted` digest.
    """
    name = _expect_path(path)
    try:
        with open(name, "rb", opener=_open_without_waiting) as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise FileError(f"{name}: expected a regular file, found another kind")
            return _read(stream, name, kind, make, wanted)
    except FileNotFoundError:
        raise FileError(f"{name}: expected a saved file, but there is no such file") from None
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{name}: could not be read ({error.strerror or error})") from None


def numbers(data: bytes, name: str, what: str) -> NDArray[Any]:
    """Read the numbers of a ``.npy`` file, whose size must match its header.

    Parameters
    ----------
    data : bytes
        The whole file.
    name, what : str
        Name of the file and description of its expected content, such as "an array of numbers", for messages.

    Raises
    ------
    FileError
        If the file is not an array of integers, floats or booleans in NumPy's format, or its length does not match its
        header. Nothing is unpickled, and no memory is allocated for missing numbers.
    """
    if not data.startswith(MAGIC) or len(data) < len(MAGIC) + 2 or data[len(MAGIC)] not in LENGTH_BYTES:
        raise FileError(f"{name}: expected {what} as NumPy's save writes it, found something else")
    start = len(MAGIC) + 2 + LENGTH_BYTES[data[len(MAGIC)]]
    stop = start + int.from_bytes(data[len(MAGIC) + 2 : start], "little")
    try:
        header = _parsed(data[start : min(stop, start + LONGEST_HEADER)], name, "biuf")
        size = max(len(data) - stop, 0)
        if size != header.nbytes:
            raise InputError(f"{name}: expected {header.nbytes} bytes for shape {header.shape}, found {size}")
        return np.ndarray(header.shape, header.dtype, data, stop, order=header.order).copy(order="K")
    except (ValueError, TypeError) as error:  # includes InputError; extreme types and shapes raise other errors
        reason = str(error).removeprefix(f"{name}: ")
        raise FileError(f"{name}: expected {what}, found something else ({reason})") from None


def _read(stream: IO[bytes], name: str, kind: Format, make: Callable[[dict[str, Any]], T], wanted: str | None) -> T:
    if not zipfile.is_zipfile(stream):
        raise FileError(
            f"{name}: expected {kind.what} saved as .npz, found another kind of file or a damaged one; {kind.else_use}"
        )
    try:
        with zipfile.ZipFile(_InSmallParts(stream, kind.what)) as archive:
            return make(_from_archive(archive, name, kind, wanted))
    except (FileError, MemoryError):  # a lack of memory is not a fault of the file
        raise
    except InputError as error:
        raise FileError(f"{name}: {error}") from None
    except Exception as error:  # a damaged zip raises any of a dozen exceptions, including zlib's
        raise FileError(f"{name}: expected a loewner .npz, found something unreadable ({error})") from None


def _from_archive(archive: zipfile.ZipFile, name: str, kind: Format, wanted: str | None) -> dict[str, Any]:
    infos = {info.filename: info for info in archive.infolist()}
    if "format.npy" not in infos or _text(archive, infos["format.npy"]) != kind.name:
        raise FileError(f"{name}: expected a loewner .npz, found another kind of .npz")
    version = _version(archive, infos["version.npy"]) if "version.npy" in infos else None
    if not isinstance(version, int) or not 1 <= version <= kind.version:
        older = " or older" if kind.version > 1 else ""
        raise FileError(
            f"{name}: expected format version {kind.version}{older}, found {version}; a newer loewner may have "
            "written it"
        )
    needed = (*kind.arrays, *(text for text in kind.texts if text not in kind.optional), "digest")
    missing = [member for member in needed if f"{member}.npy" not in infos]
    if missing:
        raise FileError(f"{name}: expected the arrays of {kind.what}, found none called {', '.join(missing)}")
    listed, members = archive.namelist(), {f"{member}.npy" for member in (*OWN, *kind.arrays, *kind.texts)}
    unknown = [member for member in listed if member not in members]
    if unknown or len(infos) != len(listed):
        raise FileError(f"{name}: expected one array of each name, found {unknown[0] if unknown else 'two of one'!r}")

    headers = {member: _header(archive, infos[f"{member}.npy"]) for member in kind.arrays}
    for member, header in headers.items():
        letter = "i" if member in kind.integers else "f"
        if header.dtype.kind != letter or (letter == "f" and header.dtype.itemsize != 8):
            wanted = "int64" if letter == "i" else "float64"
            raise FileError(f"{name}: {member}: expected {wanted}, found {header.dtype}")
    kind.check_shapes({member: header.shape for member, header in headers.items()})
    _check_content(sum(header.nbytes for header in headers.values()), name)

    told: dict[str, Any] = {key: _array(archive, infos[f"{key}.npy"], header) for key, header in headers.items()}
    told |= {text: _texts(archive, infos[f"{text}.npy"]) for text in kind.texts if f"{text}.npy" in infos}
    checksum = digest(told)
    if _text(archive, infos["digest.npy"]) != checksum:
        raise FileError(f"{name}: the content does not match its checksum; the file is damaged or was altered")
    if wanted not in (None, checksum):
        raise FileError(f"{name}: expected {kind.what} with the checksum {wanted}, found {checksum}; the file changed")
    for member in kind.arrays:  # the default integer type differs between systems
        told[member] = np.ascontiguousarray(told[member], dtype=np.int64 if member in kind.integers else np.float64)
    return told


def digest(arrays: Mapping[str, Any]) -> str:
    """Compute a checksum of all arrays, so that a damaged or altered file never leads to a verdict."""
    checksum = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        checksum.update(f"{name} {array.dtype.str} {array.shape}".encode())
        checksum.update(array.data)
    return checksum.hexdigest()


# -- members ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Header:
    """Type and shape of a member's numbers."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: Any  # "F" or "C", as in NumPy

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


class _InSmallParts:
    """A file that refuses large reads, because only a false size stated in the file itself can cause them."""

    def __init__(self, stream: IO[bytes], what: str) -> None:
        self._stream, self._what = stream, what
        self.seek, self.tell, self.seekable = stream.seek, stream.tell, stream.seekable
        self.size = os.fstat(stream.fileno()).st_size

    def read(self, n: int = -1) -> bytes:
        left = max(self.size - self._stream.tell(), 0)
        if min(left if n is None or n < 0 else n, left) > MOST_AT_ONCE:
            raise ValueError(f"its directory is longer than that of {self._what}")
        return self._stream.read(-1 if n is None else n)


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Header:
    """Read the first bytes of a member, and check that they agree with its length."""
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 0x1:
        raise InputError(f"{info.filename}: expected a member stored or deflated, found another method")
    with archive.open(info) as member:
        return _header_of(member, info)


def _header_of(member: IO[bytes], info: zipfile.ZipInfo) -> _Header:
    start = member.read(10)
    # Only names and types that do not occur here need later versions of the format.
    if len(start) < 10 or start[:8] != MAGIC + b"\x01\x00":
        raise InputError(f"{info.filename}: expected an array in NumPy's format 1.0, found something else")
    length = int.from_bytes(start[8:], "little")
    header = _parsed(member.read(length), info.filename, "fiuU")
    size = len(start) + length + header.nbytes
    if info.file_size != size:
        raise InputError(f"{info.filename}: expected {size} bytes for shape {header.shape}, found {info.file_size}")
    return header


def _parsed(text: bytes, name: str, letters: str) -> _Header:
    """Parse the header of a plain array, whose type must have one of these letters."""
    match = HEADER.fullmatch(text)
    if match is None:
        raise InputError(f"{name}: expected the header of a plain array, found {text[:100]!r}")
    kind, fortran, lengths = (group.decode() for group in match.groups())
    if kind[1] not in letters:
        raise InputError(f"{name}: expected numbers{' or text' if 'U' in letters else ''}, found type {kind}")
    shape = tuple(int(n) for n in lengths.replace(",", " ").split())
    return _Header(np.dtype(kind), shape, "F" if fortran == "True" else "C")


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo, header: _Header) -> Any:
    """Unpack a member whose header was accepted."""
    with archive.open(info) as member:
        if _header_of(member, info) != header:
            raise InputError(f"{info.filename}: changed while it was read")
        data = np.empty(header.nbytes, dtype=np.uint8)
        at = 0
        while at < len(data):
            part = member.read(min(CHUNK, len(data) - at))
            if not part:
                raise InputError(f"{info.filename}: expected {header.nbytes} bytes, found {at}")
            data[at : at + len(part)] = np.frombuffer(part, dtype=np.uint8)
            at += len(part)
        member.read(1)  # at the end of the member, zipfile verifies the archive's own checksum
    return data.view(header.dtype).reshape(header.shape, order=header.order)


def _texts(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
    """Unpack an array of short texts."""
    header = _header(archive, info)
    if header.dtype.kind != "U" or header.nbytes > LARGEST_TEXT:
        raise InputError(f"{info.filename}: expected short text, found {header.dtype} of shape {header.shape}")
    return _array(archive, info, header)


def _text(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> str:
    array = _texts(archive, info)
    return str(array) if array.shape == () else ""


def _version(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
    header = _header(archive, info)
    whole = header.shape == () and header.dtype.kind in "iu"
    return int(_array(archive, info, header)) if whole else f"{header.dtype} of shape {header.shape}"


# -- paths ------------------------------------------------------------------------------------


def _expect_path(path: Any) -> str:
    """Check that a path is valid for the operating system, and return it as text."""
    try:
        name = os.fspath(path)
    except Exception:  # a TypeError, or an error from the caller's path-like object
        raise InputError(f"path: expected a path, found {type(path).__name__}") from None
    try:
        fits = b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:
        fits = False
    if not fits:
        raise FileError(f"{name!r}: expected a path without NUL and without lone surrogates")
    return os.fsdecode(name)


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file for `open` without blocking on a pipe that has no writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_content(size: int, name: str) -> None:
    most = min(LARGEST_CONTENT, physical_memory())
    if size > most:
        raise FileError(f"{name}: expected arrays of at most {most:,} bytes, found {size:,}")
