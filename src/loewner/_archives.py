"""Arrays in ``.npz`` files: written whole or not at all, read as data; and single ones in ``.npy`` files.

Reading goes in steps, each of which trusts only the ones before: a regular file; an archive with members that have the
names of ours; for each the few bytes that say type and shape, which must agree with one another, with the sizes that
the archive states, and with a limit; then the numbers, their checksum, and whether they are what they should be, which
whoever asks for them looks at.
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

from loewner._files import replacing
from loewner._validate import physical_memory
from loewner.errors import FileError, InputError

T = TypeVar("T")

# Unpacked, a file's arrays take no more than this, nor than the machine's memory [bytes]. Some hundred million pieces.
LARGEST_CONTENT = 2**36

# Texts (format, digest, names) are short [bytes].
LARGEST_TEXT = 2**12

# At a time [bytes]; the directory of an archive of a few members is a kilobyte.
CHUNK, MOST_AT_ONCE = 2**18, 2**20

# Members of every file, besides its arrays.
OWN = ("format", "version", "digest")

# What an array begins with. Then come two bytes that say the version, of which the first says how many bytes the length
# of the header has, which in `.npy` files is at most this.
MAGIC, LENGTH_BYTES, LONGEST_HEADER = b"\x93NUMPY", {1: 2, 2: 4, 3: 4}, 2**16

# What NumPy writes before the numbers of a plain array; read strictly, so that nothing is evaluated.
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
        What its member "format" says.
    version : int
        The newest that is read; files of older ones are read as well.
    what : str
        What is in it, for messages: "a body".
    else_use : str
        What to use for other kinds of files, for messages.
    arrays : tuple of str
        Members that hold numbers.
    integers : frozenset of str
        Those of them that are whole numbers.
    check_shapes : callable
        Called with the shapes of the arrays by name, before any is unpacked; raises InputError.
    texts : tuple of str
        Members that hold short texts.
    optional : frozenset of str
        Those of them that may be missing.
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
    """Write arrays and texts into a file of some kind.

    Parameters
    ----------
    path : path
    kind : Format
    arrays : dict
    version : int, optional
        The oldest one that has what is in these arrays; the newest by default.

    Raises
    ------
    InputError
        If the path is none, or does not end in .npz.
    FileError
        If it cannot be written, or would be too large to be read again; an older file is then untouched.
    """
    target = Path(_expect_path(path))
    if target.suffix != ".npz":
        raise InputError(f"path: expected a name that ends in .npz, found {target.name!r}")
    _check_content(sum(np.asarray(array).nbytes for array in arrays.values()), str(target))
    told = kind.version if version is None else version
    content: dict[str, Any] = {"format": kind.name, "version": told, "digest": digest(arrays), **arrays}
    with replacing(target) as temporary, open(temporary, "xb") as stream:
        np.savez_compressed(stream, **content)


def read(path: str | os.PathLike[str], kind: Format, make: Callable[[dict[str, Any]], T]) -> T:
    """Read what `write` wrote.

    Parameters
    ----------
    path : path
    kind : Format
    make : callable
        Called with the arrays by name: int64 or float64 in C order, and arrays of texts. What it returns is returned;
        what it finds wrong it raises as an InputError, which becomes a FileError that names the file.

    Raises
    ------
    InputError
        If the path is none.
    FileError
        If there is no such file, or it is of another kind or damaged.
    """
    name = _expect_path(path)
    try:
        with open(name, "rb", opener=_open_without_waiting) as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise FileError(f"{name}: expected a regular file, found another kind")
            return _read(stream, name, kind, make)
    except FileNotFoundError:
        raise FileError(f"{name}: expected a saved file, found no such file") from None
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{name}: could not be read ({error.strerror or error})") from None


def numbers(data: bytes, name: str, what: str) -> NDArray[Any]:
    """Numbers of a ``.npy`` file, each of whose bytes has to be what its header says.

    Parameters
    ----------
    data : bytes
        All of the file.
    name, what : str
        Its name, and what it ought to hold, for messages: "an array of numbers".

    Raises
    ------
    FileError
        If it is no array of whole numbers, floats or booleans in NumPy's format, or longer or shorter than its header
        says. Nothing is unpickled, and no memory is taken for numbers that are not there.
    """
    if not data.startswith(MAGIC) or len(data) < len(MAGIC) + 2 or data[len(MAGIC)] not in LENGTH_BYTES:
        raise FileError(f"{name}: expected {what} as NumPy's save writes it, found something else")
    start = len(MAGIC) + 2 + LENGTH_BYTES[data[len(MAGIC)]]
    stop = start + int.from_bytes(data[len(MAGIC) + 2 : start], "little")
    try:
        header = _parsed(data[start : min(stop, start + LONGEST_HEADER)], name, "biuf")
        if len(data) - stop != header.nbytes:
            raise InputError(
                f"{name}: expected {header.nbytes} bytes of numbers for shape {header.shape}, "
                f"found {max(len(data) - stop, 0)}"
            )
        order: Any = "F" if header.fortran_order else "C"
        return np.ndarray(header.shape, header.dtype, data, stop, order=order).copy(order="K")
    except (ValueError, TypeError) as error:  # an InputError too; the others are of absurd types and shapes
        found = str(error).removeprefix(f"{name}: ")
        raise FileError(f"{name}: expected {what}, found something else ({found})") from None


def _read(stream: IO[bytes], name: str, kind: Format, make: Callable[[dict[str, Any]], T]) -> T:
    if not zipfile.is_zipfile(stream):
        raise FileError(
            f"{name}: expected {kind.what} saved as .npz, found another kind of file or a damaged one; {kind.else_use}"
        )
    try:
        with zipfile.ZipFile(_InSmallParts(stream, kind.what)) as archive:
            return make(_from_archive(archive, name, kind))
    except (FileError, MemoryError):  # lack of memory is no fault of the file
        raise
    except InputError as error:
        raise FileError(f"{name}: {error}") from None
    except Exception as error:  # a damaged zip ends in any of a dozen exceptions, zlib's among them
        raise FileError(f"{name}: expected a loewner .npz, found something unreadable ({error})") from None


def _from_archive(archive: zipfile.ZipFile, name: str, kind: Format) -> dict[str, Any]:
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
    listed, known = archive.namelist(), {f"{member}.npy" for member in (*OWN, *kind.arrays, *kind.texts)}
    unknown = [member for member in listed if member not in known]
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

    told: dict[str, Any] = {
        member: _array(archive, infos[f"{member}.npy"], header) for member, header in headers.items()
    }
    texts = [text for text in kind.texts if f"{text}.npy" in infos]
    told |= {text: _texts(archive, infos[f"{text}.npy"]) for text in texts}
    if _text(archive, infos["digest.npy"]) != digest(told):
        raise FileError(f"{name}: the content does not match its checksum; the file is damaged or was altered")
    for member in kind.arrays:  # other systems count in other integers
        told[member] = np.ascontiguousarray(told[member], dtype=np.int64 if member in kind.integers else np.float64)
    return told


def digest(arrays: Mapping[str, Any]) -> str:
    """Checksum over all arrays, so that a damaged or altered file never turns into a verdict."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.data)
    return found.hexdigest()


# -- members ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Header:
    """What a member says about its numbers."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran_order: bool

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


class _InSmallParts:
    """A file that gives out little at a time: whoever asks for more has believed a size that the file states."""

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
    """Read the first bytes of a member; its length must be what they say."""
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 0x1:
        raise InputError(f"{info.filename}: expected a member stored or deflated, found another method")
    with archive.open(info) as member:
        return _header_of(member, info)


def _header_of(member: IO[bytes], info: zipfile.ZipInfo) -> _Header:
    start = member.read(10)
    # Later versions of the format are for names and types that no array here has.
    if len(start) < 10 or start[:8] != MAGIC + b"\x01\x00":
        raise InputError(f"{info.filename}: expected an array in NumPy's format 1.0, found something else")
    length = int.from_bytes(start[8:], "little")
    header = _parsed(member.read(length), info.filename, "fiuU")
    if info.file_size != len(start) + length + header.nbytes:
        raise InputError(
            f"{info.filename}: expected {len(start) + length + header.nbytes} bytes for shape {header.shape}, "
            f"found {info.file_size}"
        )
    return header


def _parsed(text: bytes, name: str, letters: str) -> _Header:
    """What a header says, if it is that of a plain array whose type has one of these letters."""
    found = HEADER.fullmatch(text)
    if found is None:
        raise InputError(f"{name}: expected the header of a plain array, found {text[:100]!r}")
    kind, fortran, lengths = (group.decode() for group in found.groups())
    if kind[1] not in letters:
        raise InputError(f"{name}: expected numbers{' or text' if 'U' in letters else ''}, found type {kind}")
    shape = tuple(int(n) for n in lengths.replace(",", " ").split())
    return _Header(np.dtype(kind), shape, fortran == "True")


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo, header: _Header) -> Any:
    """Unpack a member whose header was accepted."""
    with archive.open(info) as member:
        if _header_of(member, info) != header:
            raise InputError(f"{info.filename}: changed while it was read")
        order: Any = "F" if header.fortran_order else "C"
        data = np.empty(header.nbytes, dtype=np.uint8)
        at = 0
        while at < len(data):
            part = member.read(min(CHUNK, len(data) - at))
            if not part:
                raise InputError(f"{info.filename}: expected {header.nbytes} bytes, found {at}")
            data[at : at + len(part)] = np.frombuffer(part, dtype=np.uint8)
            at += len(part)
        member.read(1)  # the end: now the archive's own checksum is looked at
    return data.view(header.dtype).reshape(header.shape, order=order)


def _texts(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
    """An array of short texts."""
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
    """What the operating system can take for a path, as text."""
    try:
        name = os.fspath(path)
    except Exception:  # a TypeError, or what a path-like object of the caller's raises
        raise InputError(f"path: expected a path, found {type(path).__name__}") from None
    try:
        fits = b"\0" not in os.fsencode(name)
    except UnicodeEncodeError:
        fits = False
    if not fits:
        raise FileError(f"{name!r}: expected a path without NUL and without lone surrogates")
    return os.fsdecode(name)


def _open_without_waiting(path: str, flags: int) -> int:
    """For `open`: a pipe that nobody writes to would keep us waiting."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_content(size: int, name: str) -> None:
    most = min(LARGEST_CONTENT, physical_memory())
    if size > most:
        raise FileError(f"{name}: expected arrays of at most {most:,} bytes, found {size:,}")
