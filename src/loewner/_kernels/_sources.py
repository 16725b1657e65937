"""The sources of the compiled code, and the folder in which the code may be kept."""

import os
import sys
import zipfile
import zlib
from functools import cache
from pathlib import Path

# Archive that contains the sources of the kernels in a wheel. The modules listed in LOOSE are not in the archive,
# because Python imports them even if there is a native library.
ARCHIVE = "sources.zip"
LOOSE = ("__init__.py", "_sealed.py", "_sources.py", "codes.py", "columns.py", "records.py", "tolerances.py")


def sources() -> dict[str, bytes]:
    """Content of all kernel sources, by their paths in this package."""
    home = Path(__file__).parent
    contents = {path.relative_to(home).as_posix(): path.read_bytes() for path in home.rglob("*.py")}
    if (home / ARCHIVE).exists():
        with zipfile.ZipFile(home / ARCHIVE) as archive:
            contents |= {name: archive.read(name) for name in archive.namelist()}
    return contents


@cache
def source_hash() -> str:
    """Hash of all kernel sources; empty if they cannot be read.

    Code made from other sources is never used. If the sources are unknown, no code is kept.
    """
    import hashlib  # Imported only here, because hashlib loads OpenSSL, which would slow down `import loewner`.

    try:
        contents = sources()
    except (OSError, zipfile.BadZipFile, zlib.error):
        return ""
    digest = hashlib.sha256()
    for name in sorted(contents):
        digest.update(name.encode())
        digest.update(contents[name])
    return digest.hexdigest() if contents else ""


def cache_folder() -> Path:
    """Return the cache folder of this package: ``$LOEWNER_CACHE_DIR`` if set, otherwise the user's cache folder."""
    if "LOEWNER_CACHE_DIR" in os.environ:
        return Path(os.environ["LOEWNER_CACHE_DIR"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or _home() / "AppData" / "Local") / "loewner"
    if sys.platform == "darwin":
        return _home() / "Library" / "Caches" / "loewner"
    return Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache") / "loewner"


def _home() -> Path:
    """Return the user's folder; if the user has none, return a path to which nothing can be written."""
    try:
        return Path.home()
    except RuntimeError:
        return Path(os.devnull)
