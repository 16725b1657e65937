"""What the compiled code is made from, and where it may be kept."""

import os
import sys
from functools import cache
from pathlib import Path


@cache
def source_hash() -> str:
    """Hash of all kernel sources, subfolders included; empty where they are not files, as in a zip.

    Code made from other sources is never used; where the sources cannot be told, nothing is kept.
    """
    import hashlib  # OpenSSL comes with it; an import of the package does not wait for that

    home = Path(__file__).parent
    paths = sorted(home.rglob("*.py"))
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.relative_to(home).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest() if paths else ""


def cache_folder() -> Path:
    """Return where this package keeps files: ``$LOEWNER_CACHE_DIR`` if set, else the user's cache folder."""
    if "LOEWNER_CACHE_DIR" in os.environ:
        return Path(os.environ["LOEWNER_CACHE_DIR"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or _home() / "AppData" / "Local") / "loewner"
    if sys.platform == "darwin":
        return _home() / "Library" / "Caches" / "loewner"
    return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "loewner"


def _home() -> Path:
    """Return the user's folder; where there is none, a place that cannot be written."""
    try:
        return Path.home()
    except RuntimeError:
        return Path(os.devnull)
