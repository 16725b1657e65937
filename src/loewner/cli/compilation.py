"""Compile kernels in advance, on all cores; by default, each query compiles its kernels on its first call."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from loewner._base import _validate
from loewner._base._log import log
from loewner._base._threads import processors
from loewner._native import entries, library
from loewner.errors import FileError

# The parts, each with the modules below `loewner._kernels`, or prefixes of module names, that define its entries.
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

POLL = 0.1  # seconds between polls of the processes


def compile_kernels(parts: Iterable[str] = PARTS, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Compile the kernels for this machine now, in as many processes as are useful.

    Kernels that have been compiled before are only looked up, which takes a few seconds. If the native library is in
    use, no kernels need compiling.

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
        If a part cannot be compiled, or the folder cannot be written; the message includes the output of the process.
    """
    wanted = [_validate.choice(name, "parts", PARTS) for name in _validate.listed(parts, "parts")]
    chosen = [[name for name in group if name in wanted] for group in _TOGETHER]
    _validate.callback(progress, "progress")
    if library.level() is not None:
        return library.HOME
    entries.expect_numba()
    from loewner._kernels import _store

    _expect_writable(_store.FOLDER)
    waiting, running, ended = [names for names in chosen if names], list[_Group](), 0
    total, told = sum(map(len, chosen)), 0
    folder = tempfile.TemporaryDirectory()
    try:
        while waiting or running:
            while waiting and len(running) < processors():
                running.append(_Group(waiting.pop(0), Path(folder.name)))
            time.sleep(POLL)
            for group in [group for group in running if group.process.poll() is not None]:
                group.check()
                running.remove(group)
                ended += len(group.names)
            done = ended + sum(group.done() for group in running)
            for number in range(told + 1, done + 1):
                log.info("%d of %d parts of the kernels compiled", number, total)
                if progress is not None:
                    progress(number, total)
            told = done
    finally:
        for group in running:
            group.process.kill()
            group.process.wait()
        folder.cleanup()
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


class _Group:
    """Parts that are compiled in a process of their own, since Numba compiles one function at a time per process."""

    def __init__(self, names: list[str], folder: Path) -> None:
        self.names = names
        # Use files, not pipes: a pipe that is not read in time fills up and blocks the process.
        self._told, self._said = folder / f"{names[0]}.out", folder / f"{names[0]}.err"
        environment = {**os.environ, "LOEWNER_QUIET": "1"}
        command = [sys.executable, "-c", _code(names)]
        with self._told.open("wb") as told, self._said.open("wb") as said:
            self.process = subprocess.Popen(command, env=environment, stdout=told, stderr=said)

    def done(self) -> int:
        """Return the number of parts that are done."""
        return sum(line in self.names for line in self._told.read_text(encoding="utf-8", errors="replace").splitlines())

    def check(self) -> None:
        """Raise the error with which the process ended, if any."""
        if self.process.returncode:
            what, why = ", ".join(self.names), self._said.read_text(encoding="utf-8", errors="replace").strip()[-2000:]
            raise FileError(f"the kernels for {what} could not be compiled:\n{why}")


def _code(names: list[str]) -> str:
    # The child imports this copy of the package. Numba makes millions of small permanent objects, so that garbage
    # collection would take a sixth of the time.
    return f"""
import gc, sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
gc.set_threshold(200_000, 50, 100)
from loewner._kernels import _jit
from loewner.cli.compilation import compile_part
for name in {names!r}:
    compile_part(name)
    print(name, flush=True)
sys.exit(_jit.unwritten())
"""


def compile_part(name: str) -> None:
    """Compile the entries of a part in this process, for the types in the table of entries."""
    for entry in entries.ENTRIES.values():
        if entry.module.startswith(_MODULES[name]):
            for signature in entries.signatures(entry):
                getattr(entries, entry.name).compile_ahead(signature)
