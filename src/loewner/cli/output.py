"""Write the output of commands: tables on standard output, progress on standard error, and an exit status."""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

import loewner
from loewner._base._files import shown
from loewner.errors import FileError
from loewner.robots.proofs.written_proofs import MAGIC

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

# Exit statuses. FREE also means that a command is done; COLLIDING means at least one collision.
FREE, COLLIDING, ERROR, AMBIGUOUS = 0, 1, 2, 3

# Exit statuses by the name of a verdict.
STATUS = {"FREE": FREE, "COLLIDING": COLLIDING, "AMBIGUOUS": AMBIGUOUS}

WORST_FIRST = ("COLLIDING", "AMBIGUOUS", "FREE")

# Number of configurations of each motion, including its ends, for which the distance of the nearest pair is measured.
MEASURED = 33

# Largest overlap [m] of bodies in a contact that rules allow, well above tolerances and errors of poses.
OVERLAP = 1e-3
OVERLAP_HELP = "deepest overlap that leave: and reach: allow [m] (%(default)s)"

# Width [characters] of standard output that is not a terminal, larger than any table.
UNBROKEN = 1_000_000

# "No path" is an answer, like a collision, and not an error.
NO_PATH = COLLIDING


class PrintPath(argparse.Action):
    """An option that prints a path on one line and ends the program.

    The action `version` of argparse breaks a long text at the width of the terminal, even in a pipe.
    """

    def __init__(self, option_strings: Sequence[str], dest: str, *, path: Path, help: str) -> None:
        super().__init__(option_strings, dest=argparse.SUPPRESS, nargs=0, help=help)
        self._path = path

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        """Write the bytes that name the path in the file system, so that a program that reads them finds the file."""
        line, binary = f"{self._path}\n", getattr(sys.stdout, "buffer", None)
        if binary is None:  # a caller in Python has replaced standard output
            sys.stdout.write(line)
        else:
            sys.stdout.flush()
            binary.write(os.fsencode(line))
            binary.flush()
        parser.exit()


class _Descriptor(io.FileIO):
    """A file that discards all further output once it cannot be written.

    A reader that has ended early (`| head`) does not affect the exit status. Any other reason is kept in `fault`.
    """

    fault: OSError | None = None

    def write(self, data: Any) -> int:
        """Write the data, or discard them."""
        try:
            return super().write(data)
        except OSError as error:
            if not isinstance(error, BrokenPipeError):
                self.fault = error
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return super().write(data)


@contextmanager
def standard_output() -> Iterator[None]:
    """Keep standard output usable after its reader has ended, and escape characters that its encoding lacks.

    Raises
    ------
    FileError
        If a part of the output could not be written.
    """
    out = sys.stdout
    try:
        raw = _Descriptor(out.fileno(), "w", closefd=False)
    except (AttributeError, OSError, ValueError):  # a caller in Python has replaced standard output
        yield
        return
    out.flush()
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(raw), out.encoding, "backslashreplace", line_buffering=bool(out.line_buffering)
    )
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stdout = out
        if raw.fault is not None:
            raise FileError(f"standard output: expected room for the output, found: {raw.fault.strerror}")


def remove_older_proof(path: Path | None) -> None:
    """Remove an older proof before work on a new one begins, so that the older proof is never verified by mistake.

    A file at this path that is not a proof stays until the new proof replaces it.

    Raises
    ------
    FileError
        If the proof could not be written to this path, or the older proof cannot be removed.
    """
    if path is None:
        return
    try:
        if not path.parent.is_dir():
            raise FileError(f"--proof: expected a file in a folder that exists, found {shown(path)}")
        if not path.is_file():
            return
        with path.open("rb") as file:
            is_proof = file.read(len(MAGIC)) == MAGIC
        if is_proof:
            path.resolve().unlink()  # if the path is a link, remove its target
    except (OSError, ValueError) as error:  # includes names that are too long for the system
        if isinstance(error, FileError):
            raise
        why = getattr(error, "strerror", None) or error
        raise FileError(f"--proof: expected a file that can be written, found {shown(path)} ({why})") from None


class NoProgress(nullcontext["NoProgress"]):
    """A progress bar that shows nothing, which is used if Rich is not installed."""

    def __init__(self) -> None:
        super().__init__(self)

    def add_task(self, *_: Any, **__: Any) -> Any:
        """Begin a task."""

    def update(self, *_: Any, **__: Any) -> None:
        """Update the progress of a task."""


def _console(**options: Any) -> Console:
    """Make a Rich console that lets `main` handle a broken pipe of standard error.

    Rich would end the program with status 1, which here means "colliding".
    """
    from rich.console import Console

    class Quiet(Console):
        """A console that does not end the program."""

        def on_broken_pipe(self) -> None:
            """Raise the error again, for `main`."""
            raise BrokenPipeError

    return Quiet(**options)


def print_answer(options: argparse.Namespace, answer: Any, print_text: Callable[[], None]) -> None:
    """Print an answer, as JSON if --json is given, and otherwise as text."""
    if options.json:
        print(json.dumps(answer, indent=2))
    else:
        print_text()


@contextmanager
def progress_of(name: str, total: int | None = None) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of one task; yield a callback ``progress(done, total)`` that updates it."""
    with progress_bar() as bar:
        task = bar.add_task(name, total=total)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def progress_bar() -> Progress | NoProgress:
    """Show progress on standard error, so that standard output contains only the answer."""
    try:
        from rich.progress import Progress
    except ImportError:
        return NoProgress()
    return Progress(console=_console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def counted(number: int, noun: str) -> str:
    """Return a number with a noun, in the singular or the plural: "1 pair", "2,000 pairs"."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def lasting(seconds: float) -> str:
    """Return a duration in seconds, or in milliseconds if it is shorter than a second."""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"


def pairs_of(checker: loewner.CollisionChecker) -> dict[str, int]:
    """Count the pairs that are checked, and the pairs of links that are exempt from checking."""
    checked, links = checker.checked_pairs, checker.robot.bodies.keys()
    own = sum(links >= {*pair} for pair in checked)
    return {"checked_pairs": len(checked), "exempt_pairs": len(links) * (len(links) - 1) // 2 - own}


def nearest_pairs(measured: loewner.StateDistance) -> list[dict[str, Any]]:
    """Return the least distance on each motion, with its pair. Each row of `measured` belongs to one motion."""
    least = enumerate(measured.distance.argmin(axis=1))
    return [{"nearest": float(measured.distance[at]), "nearest_pair": measured.names[at].tolist()} for at in least]


def heading(answer: dict[str, Any]) -> str:
    """Return the title of a table: the robot and its numbers of pairs."""
    exempt = counted(answer["exempt_pairs"], "pair")
    return f"{answer['robot']}, {counted(answer['checked_pairs'], 'pair')} checked, {exempt} of links exempt"


def deep_line(pair: Iterable[str], nearest: float, where: str, overlap: float) -> str:
    """Return the line about a contact that the rules allow but that is deeper than --overlap."""
    return (
        f"deep      {' and '.join(pair)} overlap by {-1e3 * nearest:.3f} mm {where}, and "
        f"--overlap allows {1e3 * overlap:.6g} mm; are the poses right?"
    )


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], title: str | None = None) -> None:
    """Print a table on standard output, in plain text if Rich is not installed. Rows may have missing cells."""
    try:
        from rich.table import Table
    except ImportError:
        cells = [columns, *rows]
        widths = [max(map(len, column)) for column in zip_longest(*cells, fillvalue="")]
        lines = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=False)) for row in cells]
        print("\n".join(line.rstrip() for line in [*([title] if title else []), *lines]))
        return
    table = Table(title=title)
    for column in columns:
        table.add_column(column, overflow="fold")  # On a narrow terminal, nothing is cut off.
    for row in rows:
        table.add_row(*row)
    # A program that reads a pipe or a file needs each name, path and number in one piece. Tables that are not for a
    # terminal are therefore as wide as their cells. Names and messages are not read as markup, since they may contain
    # `pip install "loewner[meshes]"`.
    _console(width=None if sys.stdout.isatty() else UNBROKEN, markup=False, emoji=False).print(table)


def print_contact_points(answer: dict[str, Any]) -> None:
    """Print the witnesses and the normal of two bodies."""
    print(f"on A        {coordinates(answer['witness_a'])}")
    print(f"on B        {coordinates(answer['witness_b'])}")
    print(f"normal      {coordinates(answer['normal'])}, from A to B")


def coordinates(vector: Iterable[float]) -> str:
    """Write the coordinates of a point or a direction in readable form."""
    return " ".join(f"{round(x, 12) + 0.0:.6g}" for x in vector)


def is_surface(body: loewner.Body) -> bool:
    """Return whether a body consists of the triangles of a mesh, not of convex pieces."""
    return all(piece.kind in ("surface", "solid") for piece in body.pieces)


def model_text(body: loewner.Body) -> str:
    """Describe in a few words how a body represents the mesh from which it was made."""
    if not is_surface(body):
        return covering_text(body.covering)
    count = sum(len(piece.triangles) for piece in body.pieces if piece.triangles is not None)
    kinds = " and ".join(sorted({piece.kind for piece in body.pieces}))
    hollow = ", bodies wholly inside it count as free" if any(piece.kind == "surface" for piece in body.pieces) else ""
    return f"{kinds} of the mesh's {count:,} triangles{hollow}"


def covering_text(covering: loewner.Covering | None) -> str:
    """Describe in a few words how much of a mesh its pieces contain, and how far they stick out of the mesh."""
    if covering is None:
        return "-"
    percent = round(100 * covering.excess_volume, 1) + 0.0  # avoids minus zero
    excess = f", {percent:+.1f} % volume"
    if np.isnan(covering.excess_volume):
        excess = ", volume of the mesh unknown"
    if not np.isnan(covering.max_protrusion):
        excess += f", sticks out by up to {1e3 * covering.max_protrusion:.3g} mm"
    if covering.exact:
        what = "the mesh's surface" if covering.kind == "decomposition" else "the mesh"
        return f"{covering.kind}, holds {what}{excess}"
    return f"{covering.kind}, leaves up to {1e3 * covering.max_uncovered:.3g} mm uncovered{excess}"
