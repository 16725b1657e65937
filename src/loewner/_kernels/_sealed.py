"""Files that notice damage: a header, the checksum of the content, the content; written whole or not at all.

Machine code from a damaged file can crash the process or, worse, answer wrongly. A sealed file that was cut, altered or
never was one of ours gives no content at all.
"""

import hashlib
import os
import secrets
from contextlib import suppress
from pathlib import Path

HEADER = b"loewner sealed file, 1\n"
_DIGEST = hashlib.sha256().digest_size


class DamagedFileError(Exception):
    """A file is not what `write` wrote."""


def write(path: Path, content: bytes) -> None:
    """Seal `content` and put it at `path`, under a temporary name first; an OSError leaves nothing behind."""
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
        If the file cannot be read; FileNotFoundError if there is none.
    DamagedFileError
        If it is not what `write` wrote.
    """
    data = path.read_bytes()
    start = len(HEADER) + _DIGEST
    content = data[start:]
    if data[:start] != HEADER + hashlib.sha256(content).digest():
        raise DamagedFileError(path)
    return content
