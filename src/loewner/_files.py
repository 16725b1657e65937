"""Files read whole within a limit, and written whole or not at all."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from loewner.errors import FileError

# Read at a time [bytes]: what a file's size says is no reason to ask for that much memory at once.
CHUNK = 1 << 24

# What os.stat finds instead of a regular file.
_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_regular(path: str | os.PathLike[str], what: str, limit: int) -> bytes:
    """Read a regular file whole.

    Parameters
    ----------
    path : path
    what : str
        What the file ought to be, for messages: "a mesh file".
    limit : int
        Most bytes that it may have.

    Raises
    ------
    FileError
        If there is no such file, it cannot be opened or read, it is larger than `limit`, it changes while it is
        read, or it is no regular file: a pipe would block, and a device need not end.
    """
    name = shown(path)
    try:
        # Opening a device can do something, so it is looked at first; and again when open, for it may have changed.
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
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{name}: expected {what}, found {(error.strerror or str(error)).lower()}") from None
    except ValueError:  # NUL, or a surrogate that stands for no byte
        raise FileError(f"{name}: expected {what}, found a name that no file can have") from None
    except MemoryError:
        raise FileError(f"{name}: expected {what} that fits into memory, found {status.st_size} bytes") from None
    if size > limit:
        raise FileError(f"{name}: expected {what} of at most {limit} bytes, found {max(size, status.st_size)}")
    if size < status.st_size:
        raise FileError(f"{name}: expected {what} of {status.st_size} bytes, found {size}: it changed while being read")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def shown(path: str | os.PathLike[str]) -> str:
    """Write a path for a message: as it is, or escaped where a terminal could not print it."""
    name = os.fsdecode(path)
    return name if name.isprintable() else ascii(name)


def _expect_regular(status: os.stat_result, name: str, what: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        found = next((kind for is_kind, kind in _KINDS if is_kind(status.st_mode)), "something else")
        raise FileError(f"{name}: expected {what}, found {found}, which is no regular file")


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary name to write to; rename it to `path` when the block ends well.

    A link stays a link: what it leads to is written, as by a plain open.

    Raises
    ------
    FileError
        If something other than a regular file has that name (renaming would take a device's or a pipe's name away, and
        root may), or writing or renaming fails; an older file of that name is then untouched.
    """
    name = shown(path)
    target = _regular_or_new(Path(path), name)
    # A plain open keeps the user's file mode; the suffix stays, since some writers go by it.
    temporary = target.with_name(f".{target.stem}-{os.urandom(6).hex()}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{name}: could not be written ({error.strerror or error})") from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def _regular_or_new(path: Path, name: str) -> Path:
    """Where a file of that name is, or would be, links followed."""
    try:
        with suppress(FileNotFoundError):  # a new one; whether there can be one is told when it is written
            _expect_regular(os.stat(path), name, "the name of a file to write")
        return Path(os.path.realpath(path))
    except FileError:
        raise
    except ValueError:  # NUL, or a surrogate that stands for no byte
        raise FileError(f"{name}: expected the name of a file to write, found one that no file can have") from None
    except OSError as error:
        raise FileError(f"{name}: could not be written ({error.strerror or error})") from None
