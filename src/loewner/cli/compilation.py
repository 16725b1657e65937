"""Compile kernels in advance, on all cores. By default, each query compiles its kernels on its first call."""

from __future__ import annotations

import gc
import os
import tempfile
import traceback
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

from loewner._base import _validate
from loewner._base._log import log
from loewner._base._threads import processors
from loewner._base._validate import Progress
from loewner._native import entries, library
from loewner.cli import jobs
from loewner.errors import FileError

# For each part, the modules below `loewner._kernels` that define its entries, or prefixes of module names.
_MODULES = {
    "verdicts": (
        "elementary",
        "pipeline.verdicts",
        "pipeline.fallback",
        "pipeline.workspace",
        "pieces.rigid",
        "pieces.joining",
    ),
    "crowds": ("trees.boxes",),
    "robots": ("robots.", "low_discrepancy"),
    "fits": ("fits.", "ellipsoids.", "pieces.directions"),
    "surfaces": ("narrow.mesh_points", "narrow.inscribed", "trees.piece_tree", "trees.triangle", "trees.cuts"),
    "distances": ("pipeline.distances", "pipeline.first_contacts"),
    "estimates": ("pipeline.bounds",),
    "paper": ("paper.",),
}
PARTS = tuple(_MODULES)

# Groups of parts that share most of their code, each compiled by one process; the slowest groups come first.
_TOGETHER = (("verdicts", "crowds", "robots"), ("fits", "surfaces"), ("distances", "estimates", "paper"))


def compile_kernels(parts: Iterable[str] = PARTS, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Compile the kernels for this machine now, in as many processes as are useful.

    Kernels that were compiled earlier are only looked up, which takes a few seconds. If the native library is in use,
    no kernels need to be compiled.

    Parameters
    ----------
    parts : iterable of str
        Any of "verdicts", "crowds", "robots", "fits", "surfaces", "distances", "estimates" and "paper". The default is
        every part.
    progress : callable, optional
        Called as ``progress(done, total)`` after each part.

    Returns
    -------
    Path
        The folder of the compiled code, or the native library.

    Raises
    ------
    InputError, UnknownNameError
        If the name of a part is unknown.
    MissingExtraError
        If neither the native library nor Numba is available.
    FileError
        If a part cannot be compiled, or the folder cannot be written. The message includes the traceback.
    """
    wanted = [_validate.choice(name, "parts", PARTS) for name in _validate.listed(parts, "parts")]
    chosen = [[name for name in group if name in wanted] for group in _TOGETHER]
    _validate.callback(progress, "progress")
    if library.level() is not None:
        return library.HOME
    entries.expect_numba()
    from loewner._kernels import _store

    _expect_writable(_store.FOLDER)
    tasks, total, told = [{"parts": names} for names in chosen if names], sum(map(len, chosen)), 0
    with closing(jobs.answers(__name__, tasks, processors())) as events:
        for kind, place, value in events:
            if kind == "progress":
                told += 1
                log.info("%d of %d parts of the kernels compiled", told, total)
                if progress is not None:
                    progress(told, total)
            elif kind == "answer" and value != "":
                what, why = ", ".join(tasks[place]["parts"]), value or "the process died"
                raise FileError(f"the kernels for {what} could not be compiled:\n{why}")
    _store.remove_unused()
    return _store.FOLDER


def _expect_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written, before compiling takes minutes."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise FileError(
            f"expected a folder for the compiled kernels, found that {folder} cannot be written "
            f"({error.strerror or error}); set LOEWNER_CACHE_DIR to a folder that can"
        ) from None


def serve_task(task: dict[str, Any], progress: Progress) -> str:
    """Compile parts in a separate process, because Numba compiles one function at a time. Return an error or ""."""
    from loewner._kernels import _jit

    os.environ["LOEWNER_QUIET"] = "1"
    # Numba makes millions of small permanent objects, so garbage collection would take a sixth of the time.
    gc.set_threshold(200_000, 50, 100)
    try:
        for number, name in enumerate(task["parts"], 1):
            compile_part(name)
            progress(number, len(task["parts"]))
    except Exception:
        return traceback.format_exc().strip()[-2000:]
    return _jit.unwritten() or ""


def compile_part(name: str) -> None:
    """Compile the entries of a part in this process, for the types in the table of entries."""
    for entry in entries.ENTRIES.values():
        if entry.module.startswith(_MODULES[name]):
            for signature in entries.signatures(entry):
                getattr(entries, entry.name).compile_ahead(signature)
