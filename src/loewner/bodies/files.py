"""Bodies in ``.npz`` files: written whole or not at all, read as data.

Reading goes in steps, each of which trusts only the ones before: a regular file; an archive with members that have the
names of ours; for each the few bytes that say type and shape, which must agree with one another, with the sizes that
the archive states, and with a limit; then the numbers, their checksum, and whether they are bodies (`checks`).
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
import zipfile
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from loewner._files import replacing
from loewner._validate import physical_memory
from loewner.bodies.checks import INTEGERS, check_shapes, checked
from loewner.bodies.layout import ARRAYS, arrays_of
from loewner.bodies.pack import Packed
from loewner.coverage import Covering
from loewner.errors import FileError, InputError

FORMAT, VERSION = "loewner-bodies", 1

# Unpacked, a file's arrays take no more than this, nor than the machine's memory [bytes]. Some hundred million pieces.
LARGEST_CONTENT = 2**36

# Texts (format, digest, covering) are short [bytes].
LARGEST_TEXT = 2**12

# At a time [bytes]; the directory of an archive of a few members is a kilobyte.
CHUNK, MOST_AT_ONCE = 2**18, 2**20

COVERINGS = ("convex", "hull", "decomposition")
TEXTS = ("format", "digest", "covering")
MEMBERS = {f"{name}.npy": name for name in (*TEXTS, "version", *ARRAYS)}

# What NumPy writes before the numbers of a plain array; read strictly, so that nothing is evaluated.
HEADER = re.compile(
    rb"\{'descr': '([<>|=][a-zA-Z]\d{1,6})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,18}, ?)*(?:\d{1,18})?)\), \} *\n"
)


def save(packed: Packed, path: str | os.PathLike[str], covering: Covering | None) -> None:
    """Write a pack, and what the pieces of a mesh leave uncovered."""
    target = Path(_expect_path(path))
    if target.suffix != ".npz":
        raise InputError(f"path: expected a name that ends in .npz, found {target.name!r}")
    arrays = arrays_of(packed)
    if covering is not None:
        arrays["covering"] = np.array([str(value) for value in astuple(covering)])
    _check_content(sum(array.nbytes for array in arrays.values()), str(target))
    content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "digest": _digest(arrays), **arrays}
    with replacing(target) as temporary, open(temporary, "xb") as stream:
        np.savez_compressed(stream, **content)


def load(path: str | os.PathLike[str]) -> tuple[Packed, Covering | None]:
    """Read what `save` wrote."""
    name = _expect_path(path)
    try:
        with open(name, "rb", opener=_open_without_waiting) as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise FileError(f"{name}: expected a regular file, found another kind")
            return _read(stream, name)
    except FileNotFoundError:
        raise FileError(f"{name}: expected a file, found none") from None
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{name}: could not be read ({error.strerror or error})") from None


def _read(stream: IO[bytes], name: str) -> tuple[Packed, Covering | None]:
    if not zipfile.is_zipfile(stream):
        raise FileError(
            f"{name}: expected a body saved as .npz, found another kind of file or a damaged one; "
            "for a mesh use loewner.Body.from_mesh"
        )
    try:
        with zipfile.ZipFile(_InSmallParts(stream)) as archive:
            return _from_archive(archive, name)
    except (FileError, MemoryError):  # lack of memory is no fault of the file
        raise
    except InputError as error:
        raise FileError(f"{name}: {error}") from None
    except Exception as error:  # a damaged zip ends in any of a dozen exceptions, zlib's among them
        raise FileError(f"{name}: expected a loewner .npz, found something unreadable ({error})") from None


def _from_archive(archive: zipfile.ZipFile, name: str) -> tuple[Packed, Covering | None]:
    infos = {info.filename: info for info in archive.infolist()}
    if "format.npy" not in infos or _text(archive, infos["format.npy"]) != FORMAT:
        raise FileError(f"{name}: expected a loewner .npz, found another kind of .npz")
    version = _version(archive, infos["version.npy"]) if "version.npy" in infos else None
    if version != VERSION:
        raise FileError(
            f"{name}: expected format version {VERSION}, found {version}; a newer loewner may have written it"
        )
    listed = archive.namelist()
    missing = [member for member in (*ARRAYS, "digest") if f"{member}.npy" not in infos]
    if missing:
        raise FileError(f"{name}: expected the arrays of a body, found none called {', '.join(missing)}")
    unknown = [member for member in listed if member not in MEMBERS]
    if unknown or len(infos) != len(listed):
        raise FileError(f"{name}: expected one array of each name, found {unknown[0] if unknown else 'two of one'!r}")

    headers = {known: _header(archive, infos[f"{known}.npy"]) for known in ARRAYS}
    for known, header in headers.items():
        kind = "i" if known in INTEGERS else "f"
        if header.dtype.kind != kind or (kind == "f" and header.dtype.itemsize != 8):
            wanted = "int64" if kind == "i" else "float64"
            raise FileError(f"{name}: {known}: expected {wanted}, found {header.dtype}")
    check_shapes({known: header.shape for known, header in headers.items()})
    _check_content(sum(header.nbytes for header in headers.values()), name)

    arrays: dict[str, Any] = {
        known: _array(archive, infos[f"{known}.npy"], header) for known, header in headers.items()
    }
    told = dict(arrays)
    if "covering.npy" in infos:
        told["covering"] = _texts(archive, infos["covering.npy"])
    if _text(archive, infos["digest.npy"]) != _digest(told):
        raise FileError(f"{name}: the content does not match its checksum; the file is damaged or was altered")
    # Other systems count in other integers.
    native = {
        known: np.ascontiguousarray(array, dtype=np.int64 if known in INTEGERS else np.float64)
        for known, array in arrays.items()
    }
    covering = _covering(told["covering"].tolist()) if "covering" in told else None
    return checked(native), covering


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

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.seek, self.tell, self.seekable = stream.seek, stream.tell, stream.seekable
        self.size = os.fstat(stream.fileno()).st_size

    def read(self, n: int = -1) -> bytes:
        left = max(self.size - self._stream.tell(), 0)
        if min(left if n is None or n < 0 else n, left) > MOST_AT_ONCE:
            raise ValueError("its directory is longer than that of a body")
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
    if len(start) < 10 or start[:8] != b"\x93NUMPY\x01\x00":
        raise InputError(f"{info.filename}: expected an array in NumPy's format 1.0, found something else")
    length = int.from_bytes(start[8:], "little")
    text = member.read(length)
    found = HEADER.fullmatch(text)
    if found is None:
        raise InputError(f"{info.filename}: expected the header of a plain array, found {text[:100]!r}")
    kind, fortran, numbers = (group.decode() for group in found.groups())
    if kind[1] not in "fiuU":
        raise InputError(f"{info.filename}: expected numbers or text, found type {kind}")
    shape = tuple(int(n) for n in numbers.replace(",", " ").split())
    header = _Header(np.dtype(kind), shape, fortran == "True")
    if info.file_size != len(start) + length + header.nbytes:
        raise InputError(
            f"{info.filename}: expected {len(start) + length + header.nbytes} bytes for shape {shape}, "
            f"found {info.file_size}"
        )
    return header


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


def _covering(values: list[str]) -> Covering:
    """What a mesh's pieces leave uncovered, from the five texts that `save` writes."""
    if np.shape(values) != (5,):
        raise InputError(f"covering: expected five entries, found {values!r}")
    kind, exact, uncovered, excess, samples = values
    if kind not in COVERINGS or exact not in ("True", "False") or not re.fullmatch(r"\d{1,18}", samples, re.ASCII):
        raise InputError(
            f"covering: expected a kind among {', '.join(COVERINGS)}, True or False, ..., found {values!r}"
        )
    try:
        gap, more = float(uncovered), float(excess)
    except ValueError:
        raise InputError(f"covering: expected numbers, found {uncovered!r} and {excess!r}") from None
    if not 0 <= gap < math.inf or not (math.isnan(more) or -1 <= more < math.inf):
        raise InputError(f"covering: expected a length >= 0 and a ratio >= -1 or nan, found {uncovered} and {excess}")
    return Covering(kind, exact == "True", gap, more, int(samples))


def _digest(arrays: dict[str, Any]) -> str:
    """Checksum over all arrays, so that a damaged or altered file never turns into a verdict."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()


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
