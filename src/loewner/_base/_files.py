"""Read whole files up to a size limit, and write files atomically."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from loewner.errors import FileError

# Number of bytes read at a time. A file may state a false size, which must not cause a large allocation.
CHUNK = 1 << 24

# Number of hexadecimal digits of a digest in a file's name. No two contents share this many digits by chance.
DIGITS = 16

# Kinds of files other than regular ones.
_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_regular(path: str | os.PathLike[str], what: str, limit: int) -> bytes:
    """Read a whole regular file.

    Parameters
    ----------
    path : path
    what : str
        Description of the expected file for messages, such as "a mesh file".
    limit : int
        Largest size in bytes.

    Raises
    ------
    FileError
        If the file does not exist, cannot be opened or read, is larger than `limit`, changes while it is read, or is
        not a regular file: a pipe would block, and a device may never end.
    """
    name = shown(path)
    try:
        # Opening a device can have effects, so the file is checked before it is opened. The open file is checked again,
        # since another file may have taken its place.
        _expect_regular(os.stat(path), name, what)
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
        with open(os.open(path, flags), "rb", buffering=0) as file:
            status = os.fstat(file.fileno())
            _expect_regular(status, name, what)
            parts: list[bytes] = []
            size = 0
            while size <= limit and (part := file.read(min(CHUNK, max(status.st_size - size, 0) + 1))):
                parts.append(part)
                size += len(part)
    except FileError:
        raise
    except FileNotFoundError:
        raise FileError(f"{name}: expected {what}, but there is no such file") from None
    except OSError as error:
        raise FileError(f"{name}: expected {what}, but it could not be read ({error.strerror or error})") from None
    except ValueError:  # NUL, or a surrogate that encodes no byte
        raise FileError(f"{name}: expected {what}, found a name that no file can have") from None
    except MemoryError:
        raise FileError(f"{name}: expected {what} that fits into memory, found {status.st_size} bytes") from None
    if size > limit:
        raise FileError(f"{name}: expected {what} of at most {limit} bytes, found {max(size, status.st_size)}")
    if size < status.st_size:
        raise FileError(f"{name}: expected {what} of {status.st_size} bytes, found {size}: it changed while being read")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def folder_exists(path: Path) -> bool:
    """Return whether a folder exists; False also for names that no file system accepts, such as overlong names."""
    try:
        return path.is_dir()
    except OSError:
        return False


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path as text for a message, escaped if a terminal could not print it."""
    name = os.fsdecode(path)
    return name if name.isprintable() else ascii(name)


def _expect_regular(status: os.stat_result, name: str, what: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        actual_kind = next((kind for is_kind, kind in _KINDS if is_kind(status.st_mode)), "something else")
        raise FileError(f"{name}: expected {what}, found {actual_kind}, which is no regular file")


def named_by_content(stem: str, digest: str, suffix: str) -> str:
    """Name a file after its content, so that no file with other content replaces it while another file refers to it."""
    return f"{stem}-{digest[:DIGITS]}{suffix}"


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Provide a temporary name for writing, and rename it to `path` when the block ends without an error.

    If `path` is a link, the link remains and its target is replaced, as with `open`.

    Raises
    ------
    FileError
        If something other than a regular file has this name: as root, renaming would replace even a device or a pipe.
        Also if writing or renaming fails. An existing file of this name stays unchanged.
    """
    name = shown(path)
    try:
        target = _regular_or_new(Path(path), name)
        # The caller opens this name, so that the user's file mode applies. The suffix is kept, since some writers
        # choose the format by the suffix.
        temporary = target.with_name(f".{target.stem}-{os.urandom(6).hex()}{target.suffix}")
        try:
            yield temporary
            os.replace(temporary, target)
        finally:
            with suppress(OSError):
                temporary.unlink()
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{name}: could not be written ({error.strerror or error})") from None


def write_atomically(target: Path, content: bytes | bytearray) -> None:
    """Write a file completely or not at all; after a `FileError`, an existing file is unchanged."""
    with replacing(target) as temporary:
        temporary.write_bytes(content)


def made_folder(folder: Path) -> Path:
    """Make a folder and its parents, unless the folder exists."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{shown(folder)}: expected a folder, could not make it ({error.strerror or error})") from None
    return folder


def _regular_or_new(path: Path, name: str) -> Path:
    """Return the path of a file that exists or will be created, with links resolved."""
    try:
        with suppress(FileNotFoundError):  # the file is new; errors are reported when it is written
            _expect_regular(os.stat(path), name, "the name of a file to write")
        return Path(os.path.realpath(path))
    except ValueError:  # NUL, or a surrogate that encodes no byte
        raise FileError(f"{name}: expected the name of a file to write, found one that no file can have") from None
