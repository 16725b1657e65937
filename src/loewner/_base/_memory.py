"""Determine how much memory a call may still use, within the limits of the machine, the process and its container.

Requests that are too large are refused before any memory is allocated. On most systems, allocating more than the
available memory succeeds, and this process or another process is killed when the memory is used.
"""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import numpy as np

from loewner._native import library
from loewner.errors import MemoryLimitError

# Smallest request that is checked [bytes]; reading the limits takes as long as filling a few hundred kilobytes.
LOOK = 2**26

# Libraries that a process loads on first use: kernels with OpenBLAS's buffers, and SciPy's hulls and linear programs.
KERNELS, SCIPY = "compiled kernels", "SciPy"

# Measured address space [bytes] of these libraries, with a reserve. The native library and OpenBLAS took 38 MiB for the
# first body, and SciPy took 148 MiB. Numba with its compiled code took 180 MiB; the rest of SciPy then took 45 MiB.
LIBRARY = {KERNELS: 64 * 2**20, SCIPY: 192 * 2**20}
NUMBA = {KERNELS: 256 * 2**20, SCIPY: 64 * 2**20}

# Room for a call of OpenBLAS and the small arrays around it [bytes]; measured use was tens of kilobytes.
BLAS = 2**21

_ROOT = Path("/")


@contextmanager
def uncollected() -> Iterator[None]:
    """Suspend the garbage collector while objects without cycles are made, such as the tree of a large file.

    The search for cycles would take a third of the time.
    """
    searches = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searches:
            gc.enable()


def left(root: Path = _ROOT) -> tuple[int, str]:
    """Return the available memory in bytes, and a description of the limit that determines it, for messages.

    Parameters
    ----------
    root : path
        Folder that contains ``proc`` and ``sys``; tests use another folder.
    """
    return min([*_of_process(root), *_of_groups(root), *_of_machine(root)], default=(sys.maxsize, ""))


_expected: set[str] = set()  # libraries that fitted and are loaded


def expect_place(*names: str) -> None:
    """Refuse to load KERNELS or SCIPY for the first time in a process if they would not fit into the address space.

    SciPy, OpenBLAS and LLVM end the process, or leave a half-loaded module, when they run out of address space.
    """
    missing = [name for name in names if name not in _expected]
    if missing:
        there, which = min(_of_process(_ROOT), default=(sys.maxsize, ""))  # libraries use little of their address space
        there_is_room = there >= LIBRARY[KERNELS]  # enough to open the native library
        sizes = NUMBA if there_is_room and library.level() is None else LIBRARY
        wanted = sum(sizes[name] for name in missing)
        if there < wanted:
            what = f"{wanted >> 20} MiB of address space to load {' and '.join(missing)}"
            raise MemoryLimitError(f"expected {what}, found {there / 2**20:.3g} MiB{which}")
        _expected.update(missing)


def expect_left(needed: int, what: str) -> None:
    """Refuse work on `what` if its arrays, which take at least `needed` bytes, would not fit."""
    if needed >= LOOK:
        there, which = min(left(), (physical(), " in this machine"))
        if needed > there:
            raise MemoryLimitError(
                f"{what}: expected {needed / 2**30:.3g} GiB of memory at least, found {there / 2**30:.3g} GiB{which}"
            )


def expect_room_for_blas(needed: int = 0) -> None:
    """Refuse to continue if hardly any address space is left beyond `needed` bytes.

    On several threads, OpenBLAS allocates a few more kilobytes in each call, and ends the process if this fails.

    Raises
    ------
    MemoryError
        As raised by NumPy.
    """
    np.empty(BLAS + needed, dtype=np.uint8)


def _of_process(root: Path) -> Iterator[tuple[int, str]]:
    """Yield the address space and the private memory that are left within the limits set by `setrlimit`."""
    try:
        import resource
    except ImportError:  # this system has no such limits
        return
    pages = (_text(root / "proc/self/statm") or "0 0 0 0 0 0 0").split()
    for name, column in (("RLIMIT_AS", 0), ("RLIMIT_DATA", 5)):
        limit = resource.getrlimit(getattr(resource, name))[0]
        if limit != resource.RLIM_INFINITY:
            yield max(0, limit - int(pages[column]) * resource.getpagesize()), f" left by {name}"


def _of_groups(root: Path) -> Iterator[tuple[int, str]]:
    """Yield the memory that the control groups of this process leave, from the innermost to the outermost group.

    A group is a folder, and its parents are the groups around it. Files that the system caches in memory count as used,
    but are dropped when memory runs short.
    """
    for folder, top in _group_folders(root):
        for group in (folder, *folder.parents):
            for limit, used, cached in (
                ("memory.max", "memory.current", ("inactive_file", "active_file")),
                ("memory.limit_in_bytes", "memory.usage_in_bytes", ("total_inactive_file", "total_active_file")),
            ):
                most = _number(group / limit)
                if most is not None:
                    kept = dict(line.split() for line in (_text(group / "memory.stat") or "").splitlines())
                    spare = sum(int(kept.get(name, 0)) for name in cached)
                    yield max(0, most - max(0, (_number(group / used) or 0) - spare)), " left in this control group"
            if group == top:
                break


def _group_folders(root: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the folder of each control group of this process that counts memory, and the top of the group's tree."""
    mine = {}
    for line in (_text(root / "proc/self/cgroup") or "").splitlines():
        _, controllers, within = line.split(":", 2)
        if controllers == "" or "memory" in controllers.split(","):
            mine["cgroup" if controllers else "cgroup2"] = PurePosixPath(within)
    for line in (_text(root / "proc/self/mountinfo") or "").splitlines():
        # See proc(5): "36 35 98:0 ROOT MOUNT_POINT options ... - TYPE source super_options".
        before, _, after = line.partition(" - ")
        start, mount = before.split()[3:5]
        kind, _, options = (*after.split(), "", "")[:3]
        if kind not in mine or (kind == "cgroup" and "memory" not in options.split(",")):
            continue
        top, path = root / mount.lstrip("/"), mine[kind]
        # In a container, the path of a group may be the host's path, although only a part of the tree is visible.
        inside = path.relative_to(start) if path.is_relative_to(start) else PurePosixPath()
        folder = top / str(inside).lstrip("/")
        yield (folder if folder.is_dir() else top), top


def _of_machine(root: Path) -> Iterator[tuple[int, str]]:
    """Yield the memory that is free, or can be freed without swapping."""
    for line in (_text(root / "proc/meminfo") or "").splitlines():
        if line.startswith("MemAvailable:"):
            yield int(line.split()[1]) * 1024, " free on this machine"


def physical() -> int:
    """Return the memory of the machine in bytes; if the system does not report it, the size of the address space."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return sys.maxsize


def _text(path: Path) -> str | None:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return None


def _number(path: Path) -> int | None:
    """Read the number in a file; None if the content is "max" or not a number."""
    text = (_text(path) or "").strip()
    return int(text) if text.isdigit() else None
