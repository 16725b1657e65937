"""Find the native library for this machine, and check that it is intact.

The library contains the kernels as machine code. It is built from the kernels' sources (`native/`) with the compiler
that Numba uses on a user's machine. The library is next to this file, with a list of its files and a hash of the
sources. A library that was built from other sources, or altered afterwards, is not loaded.

While a build runs in a clone, finished kernels can already be used. The list names a file with the kernels built so
far, and a call of any other kernel waits.
"""

import json
import os
import sys
import time
from functools import cache
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any, NamedTuple

from loewner._kernels._sources import source_hash
from loewner.errors import InputError

HOME = Path(__file__).parent
LIST = "built.json"
LOCK = "building"  # a file that is locked while files are built
POLL = 0.1  # seconds between checks of a build
EXTENSION = f"{__package__}._call"
CALL = "_call.abi3.so"  # the extension for all versions of Python; it is opened by path, so any system accepts its name


class Entry(NamedTuple):
    """A kernel that Python calls: its module below `loewner._kernels`, its name, its arguments and its results."""

    module: str
    name: str
    arguments: str
    results: str


_opened_list: dict[str, Any] = {}  # the list when the library in use was opened


class _Refused(Exception):
    """No library can be used; the text gives the reason."""


def kernel(entry: Entry) -> Any:
    """Return a kernel of the library, waiting until it is built; None if the library or the kernel is missing."""
    library, _ = _opened()
    if library is not None and is_missing(entry):
        _awaited(entry)
        _opened.cache_clear()
        library, _ = _opened()
    if library is None or is_missing(entry):
        return None
    return library.kernel(entry.name, entry.arguments, entry.results)


def is_missing(entry: Entry) -> bool:
    """Return whether the library in use was opened before a kernel was built."""
    return entry.name not in _opened_list.get("entries", [entry.name])


def level() -> str | None:
    """Return the processor level for which the library in use was compiled; None if there is no library."""
    library, text = _opened()
    return None if library is None else text


def why_not() -> str:
    """Return the reason why no library is in use; empty if a library is in use."""
    library, text = _opened()
    return "" if library is not None else text


def extension() -> Any:
    """Return the extension that calls the library in use; None if there is no library."""
    return None if _opened()[0] is None else sys.modules[EXTENSION]


def levels() -> tuple[str, ...]:
    """Return the levels of the library that this processor supports, best first; empty if they cannot be determined."""
    try:
        return tuple(_extension(_listed()).levels())
    except (_Refused, OSError, ImportError):
        return ()


def shipped(name: str) -> bytes | None:
    """Return the content of a file that was built with the library, for any processor; None if it is not usable."""
    if os.environ.get("LOEWNER_JIT") == "1":
        return None
    try:
        return _checked(name, _listed()).read_bytes()
    except (_Refused, OSError):
        return None


def built_with() -> str:
    """Return the version of Numba with which the library was built."""
    return str(_listed()["numba"])


@cache
def _opened() -> tuple[Any, str]:
    """Return the library and its level, or None and the reason."""
    forced = os.environ.get("LOEWNER_JIT") or "0"
    if forced not in ("0", "1"):
        raise InputError(f"LOEWNER_JIT: expected 0 or 1, found {forced!r}")
    if forced == "1":
        return None, "LOEWNER_JIT=1"
    global _opened_list
    while True:
        built = None
        try:
            built = _awaited()
            call = _extension(built)
            name = _best(call.levels(), built)
            path = _checked(_file_of(name, built), built)
            library = call.Library(path=path, build=f"{built['sources']} {name}")
        except (_Refused, OSError, ImportError) as error:
            if built is None or not _has_grown(built):
                return None, str(error)
            continue
        _opened_list = built
        return library, name


def _awaited(entry: Entry | None = None) -> dict[str, Any]:
    """Read the list of built files; while a build runs, wait until the list exists and names the kernel, if given."""
    told = False
    while True:
        is_running = is_being_built()  # checked first, so that a build that ends now is noticed
        try:
            built = _listed()
            if not is_running or entry is None or entry.name in built.get("entries", [entry.name]):
                return built
        except _Refused:
            if not is_running:
                raise
        if not told and "LOEWNER_QUIET" not in os.environ:
            print("loewner: waiting for the native library, which is being built ...", file=sys.stderr, flush=True)
        told = True
        time.sleep(POLL)


def is_being_built() -> bool:
    """Return whether a process is building the library now."""
    if sys.platform == "win32" or not (HOME / LOCK).exists():
        return False
    import fcntl

    try:
        with (HOME / LOCK).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)  # another process has the lock
    return False


def _listed() -> dict[str, Any]:
    """Read the list of built files, if they were built from the present sources."""
    try:
        built = _read_list()
        sources, files, _ = built["sources"], built["files"], built["numba"]
        if not isinstance(files, dict):
            raise TypeError(f"files: expected an object, found {type(files).__name__}")
    except FileNotFoundError:
        raise _Refused("it was not built") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise _Refused(f"{HOME / LIST} cannot be read ({error})") from None
    if sources != source_hash():
        raise _Refused("it was built from other sources")
    return dict(built)


def _has_grown(built: dict[str, Any]) -> bool:
    """Return whether another list of files has replaced the given list."""
    try:
        return bool(built != _read_list())
    except (OSError, ValueError):
        return False


def _read_list() -> Any:
    return json.loads((HOME / LIST).read_text(encoding="utf-8"))


def _checked(name: str, built: dict[str, Any]) -> Path:
    """Return the path of a built file, after checking that the file is unchanged."""
    import hashlib  # importing it takes as long as the rest of this module

    path = HOME / name
    if name not in built["files"]:
        raise _Refused(f"it was built without {name}")
    if hashlib.sha256(path.read_bytes()).hexdigest() != built["files"][name]:
        raise _Refused(f"{path} is damaged")
    return path


def _extension(built: dict[str, Any]) -> Any:
    """Import the extension, after checking that it is intact."""
    if EXTENSION not in sys.modules:
        sys.modules[EXTENSION] = loaded(_checked(CALL, built))
    return sys.modules[EXTENSION]


def loaded(path: Path) -> Any:
    """Load the extension from a file, whose name may differ from the names that `import` looks for."""
    loader = ExtensionFileLoader(EXTENSION, str(path))
    spec = spec_from_loader(EXTENSION, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


def _best(levels: tuple[str, ...], built: dict[str, Any]) -> str:
    """Choose the best level that was built and that the processor supports."""
    if most := os.environ.get("LOEWNER_LEVEL"):
        if most not in levels:
            runs = ", ".join(levels) or "none"
            raise InputError(f"LOEWNER_LEVEL: expected a level that this processor runs ({runs}), found {most!r}")
        levels = levels[levels.index(most) :]
    for name in levels:
        if _file_of(name, built):
            return name
    files = sorted(file for file in built["files"] if file.startswith("kernels-"))
    raise _Refused(f"this processor runs {', '.join(levels) or 'none of its levels'}, and {', '.join(files)} was built")


def _file_of(level: str, built: dict[str, Any]) -> str:
    """Return the name of the file with the kernels for a level; while a build adds kernels, the name has a number."""
    return next((file for file in built["files"] if file.startswith(f"kernels-{level}")), "")
