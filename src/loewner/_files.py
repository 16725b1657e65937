"""Files written whole or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from loewner.errors import FileError


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary name beside `path` to write to; rename it when the block ends well.

    Raises
    ------
    FileError
        If writing or renaming fails; an older file of that name is then untouched.
    """
    target = Path(path)
    # A plain open keeps the user's file mode; the suffix stays, since some writers go by it.
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(6)}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        raise FileError(f"{target}: could not be written ({error.strerror or error})") from None
    finally:
        with suppress(OSError):
            temporary.unlink()
