"""What the compiled code is made from, and where it may be kept."""

import os
import sys
from functools import cache
from pathlib import Path


@cache
def source_hash() -> str:
    """Hash of all kernel sources, subfolders included: code made from other sources is never used."""
    import hashlib  # OpenSSL comes with it; an import of the package does not wait for that

    digest = hashlib.sha256()
    home = Path(__file__).parent
    for path in sorted(home.rglob("*.py")):
        digest.update(path.relative_to(home).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_folder() -> Path:
    """Return where this package keeps files: ``$LOEWNER_CACHE_DIR`` if set, else the user's cache folder."""
    if "LOEWNER_CACHE_DIR" in os.environ:
        return Path(os.environ["LOEWNER_CACHE_DIR"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "loewner"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "loewner"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "loewner"
