"""Files that reveal damage: a header, the checksum of the content, and the content, written atomically.

Machine code from a damaged file can crash the process or, worse, return wrong answers. `read` returns no content from a
file that was truncated, altered or never sealed.
"""

import hashlib
import os
import secrets
from contextlib import suppress
from pathlib import Path

HEADER = b"loewner sealed file, 1\n"
_DIGEST = hashlib.sha256().digest_size


class DamagedFileError(Exception):
    """A file differs from the one that `write` wrote."""


def write(path: Path, content: bytes) -> None:
    """Seal `content` and write it to `path`, under a temporary name first; an OSError leaves no file behind."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        temporary.write_bytes(HEADER + hashlib.sha256(content).digest() + content)
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink()


def read(path: Path) -> bytes:
    """Return the content of a sealed file.

    Raises
    ------
    OSError
        If the file cannot be read; FileNotFoundError if it does not exist.
    DamagedFileError
        If the file differs from the one that `write` wrote.
    """
    data = path.read_bytes()
    start = len(HEADER) + _DIGEST
    content = data[start:]
    if data[:start] != HEADER + hashlib.sha256(content).digest():
        raise DamagedFileError(path)
    return content
