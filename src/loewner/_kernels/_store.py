"""Compiled code on disk: one sealed file for each function, under a key of everything that determines the code.

Numba's own cache notices changes in a function's own file, but not in the files of other functions that it calls. It
also trusts the content of any cache file. Stale or damaged collision code is dangerous. Here, a key contains the
sources of the function's module and of all modules that it imports. The key changes with an edit to any such module,
but not with edits to other files. A damaged file is replaced.

The folder is ``$LOEWNER_CACHE_DIR`` if set, otherwise it is in the platform's cache folder of the user. The native
library's build shares the folder with Numba on machines without the library.
"""

import hashlib
import os
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from loewner._kernels import _sealed, _sources

FOLDER = _sources.cache_folder() / "kernels"

# KEPT: a file that has not been used for this time [s] is removed. DAY: the use of a file is recorded at most once in
# this time [s].
KEPT, DAY = 30 * 86_400.0, 86_400.0

# Modules on which any kernel may depend, even if it does not import them, because the types of a kernel's arguments
# select vector operations.
ALWAYS = ("_numba", "_jit", "_parts", "_fused", "simd/memory", "simd/scalars", "simd/vectors")

_IMPORT = re.compile(r"^ *(?:from|import) +loewner\._kernels([\w.]*)(?: +import +(\([^)]*\)|[^\n]*))?", re.MULTILINE)
_PREFIX = "loewner._kernels"

_edited: list[str] = []  # Modules that were edited after `_texts` had read them, but before they were imported.


@cache
def _texts() -> dict[str, bytes]:
    """Content of all kernel sources, by path without suffix; empty if they cannot be read."""
    return (
        {name.removesuffix(".py"): text for name, text in _sources.sources().items()} if _sources.source_hash() else {}
    )


@cache
def _imported(name: str) -> frozenset[str]:
    """Kernel modules that a kernel module imports directly."""
    candidates = set[str]()
    for module, names in _IMPORT.findall(_texts()[name].decode()):
        folder = module.lstrip(".").replace(".", "/")
        imported_names = [part.split(" as ")[0].strip() for part in names.strip("()").split(",")]
        candidates.update([folder, *(f"{folder}/{part}".lstrip("/") for part in imported_names)])
    return frozenset(candidates & _texts().keys())


@cache
def modules_behind(module: str) -> frozenset[str]:
    """Return a kernel module (given with dots) and the kernel modules it may depend on, as paths without suffix.

    A module outside the kernels may depend on all kernel modules.
    """
    start = module.removeprefix(f"{_PREFIX}.").replace(".", "/")
    if not module.startswith(f"{_PREFIX}.") or start not in _texts():
        return frozenset(_texts())
    modules, waiting = set[str](), [start, *(name for name in ALWAYS if name in _texts())]
    while waiting:
        name = waiting.pop()
        if name not in modules:
            modules.add(name)
            waiting.extend(_imported(name))
    return frozenset(modules)


@cache
def hash_of(modules: frozenset[str]) -> str:
    """Hash of the content of modules."""
    digest = hashlib.sha256()
    for name in sorted(modules):
        digest.update(repr((name, hashlib.sha256(_texts()[name]).hexdigest())).encode())
    return digest.hexdigest()


@cache
def expect_as_read(module: str) -> None:
    """Stop keeping code in this process if the kernel module being imported was edited after `_texts` ran.

    Otherwise, the module's code would get the key of the sources from before the edit.
    """
    name = module.removeprefix(f"{_PREFIX}.").replace(".", "/")
    # For a module in an archive, this file does not exist; an archive is never edited.
    path = Path(_sources.__file__).parent / f"{name}.py"
    if name in _texts() and path.exists() and path.read_bytes() != _texts()[name]:
        _edited.append(module)


def is_usable() -> bool:
    """Return whether the sources can be read and are the ones that were imported; otherwise, no code may be kept."""
    return bool(_texts()) and not _edited


def key_of(name: str, made_of: Any, modules: frozenset[str]) -> str:
    """Key of a part: a readable name, and a hash of its sources and of everything else that determines it."""
    digest = hashlib.sha256(repr((made_of, hash_of(modules))).encode()).hexdigest()
    return f"{re.sub(r'[^A-Za-z0-9_.]', '', name)[:80]}-{digest[:32]}"


def path_of(key: str) -> Path:
    """Return the path of the file for a key."""
    return FOLDER / f"{key}.kernel"


def read(key: str) -> bytes:
    """Return the content for a key, or raise an error of `_sealed.read`."""
    content = _sealed.read(path_of(key))
    with suppress(OSError):
        if path_of(key).stat().st_mtime < time.time() - DAY:
            os.utime(path_of(key))
    return content


def write(key: str, content: bytes) -> None:
    """Store the content for a key, or raise an OSError."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    _sealed.write(path_of(key), content)


def remove_unused() -> None:
    """Remove files that have not been read for a month: every edit of a source leaves unused files behind."""
    with suppress(OSError):
        for path in FOLDER.iterdir():
            with suppress(OSError):
                if path.stat().st_mtime < time.time() - KEPT:
                    path.unlink()


@contextmanager
def claimed(key: str) -> Iterator[None]:
    """Let one process at a time compile the code with a key; other processes wait, and then read the code.

    A claim is a lock on a file, which ends with the process that holds it. Kernels never call each other in circles, so
    no two processes wait for each other. If files cannot be locked, several processes compile the same code.
    """
    if sys.platform == "win32" or path_of(key).exists():
        yield
        return
    import fcntl

    claim = FOLDER / f"{key}.claim"
    try:
        FOLDER.mkdir(parents=True, exist_ok=True)
        file = claim.open("wb")
    except OSError:  # If the claim's file cannot be created, code is compiled without a claim.
        yield
        return
    with file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            with suppress(OSError):
                claim.unlink()
