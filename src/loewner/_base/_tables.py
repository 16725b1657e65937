"""Read and write numbers separated by commas or by spaces, but never by both, so that missing numbers are noticed."""

from __future__ import annotations

import csv
import io
import re

import numpy as np

from loewner._base._validate import Floats, short
from loewner.errors import FileError, InputError

# Patterns: the end of a line, a comment, the spaces of a line without numbers, and the start of a line with numbers.
LINE_END, COMMENT = re.compile(r"\r\n|\r|\n"), re.compile("#[^\r\n]*")
BLANK, CONTENT = re.compile(r"^[ \t]+(?=#|\r?$)", re.MULTILINE), re.compile(r"^[ \t]*[^#\s]", re.MULTILINE)

# A line with this text and a trajectory's start time precedes the header of its table, unless the time is 0.
STARTS = "# start_time: "


def row(text: str, *, commas: bool | None = None) -> list[float]:
    """Read the numbers of a line.

    Parameters
    ----------
    text : str
    commas : bool, optional
        Whether commas, not spaces, separate the numbers; the default is true if the line contains a comma.

    Raises
    ------
    ValueError
        If a number is missing or malformed; the message gives the expected and the found content.

    Examples
    --------
    >>> row("1, 2, 3"), row("1 2 3")
    ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    >>> row("0,,1")
    Traceback (most recent call last):
        ...
    ValueError: expected a number in each cell, found an empty one
    """
    commas = "," in text if commas is None else commas
    return [number(cell.strip()) for cell in text.split(",")] if commas else [number(cell) for cell in text.split()]


def number(cell: str) -> float:
    """Read the number in a cell; a ValueError describes any other content."""
    if not cell:
        raise ValueError("expected a number in each cell, found an empty one")
    if len(cell.split()) > 1 or "," in cell:
        raise ValueError(
            f"expected numbers divided by commas or by spaces, not by both, and no decimal commas, found {short(cell)}"
        )
    try:  # Python would accept "1_0" as ten, as well as digits of other scripts
        if cell.isascii() and "_" not in cell:
            return float(cell)
    except ValueError:
        pass
    raise ValueError(f"expected a number, found {short(cell)}")


def below(header: list[str], rows: list[list[str]]) -> Floats:
    """Read the numbers of rows below a header, shape (rows, columns); an InputError describes any other row."""
    table = np.empty((len(rows), len(header)))
    for at, cells in enumerate(rows):
        if len(cells) != len(header):
            raise InputError(f"row {at + 1} below the header: expected {len(header)} cells, found {len(cells)}")
        for column, cell in enumerate(cells):
            try:
                table[at, column] = number(cell.strip())
            except ValueError as error:
                raise InputError(f"row {at + 1} below the header, column {header[column]!r}: {error}") from None
    return table


def table(data: bytes, name: str, *, commas: bool = False) -> Floats:
    """Read lines that all have the same count of numbers; # begins a comment.

    Parameters
    ----------
    data : bytes
        Contents of the whole file.
    name : str
        Name of the file, for messages.
    commas : bool
        Whether commas must separate the numbers. If false, commas separate them if any line contains a comma, and
        spaces if no line does.

    Returns
    -------
    ndarray, shape (lines, columns)

    Raises
    ------
    FileError
        If a line has an empty or malformed cell, or a different count of numbers; the message gives the line.
    """
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        raise FileError(f"{name}: expected an array of numbers, found something else ({error})") from None
    if CONTENT.search(text) is None:
        raise FileError(f"{name}: expected an array of numbers, found none")
    commas = commas or "," in (COMMENT.sub("", text) if "#" in text else text)
    try:
        return np.loadtxt(io.StringIO(BLANK.sub("", text)), delimiter="," if commas else None, ndmin=2)
    except ValueError as error:
        _refuse_lines(text, name, commas)
        reason = str(error)[:200]
        raise FileError(f"{name}: expected an array of numbers, found something else ({reason})") from None


def _refuse_lines(text: str, name: str, commas: bool) -> None:
    """Refuse the first line that is not a row of numbers, or has a different count of numbers than the first row."""
    length = 0
    for number, line in enumerate(LINE_END.split(text), 1):
        content = line.partition("#")[0]
        if content.strip():
            try:
                count = len(row(content, commas=commas))
            except ValueError as error:
                raise FileError(f"{name}, line {number}: {error}") from None
            if count != (length := length or count):
                raise FileError(f"{name}, line {number}: expected {length} numbers as in the first line, found {count}")


def written(header: list[str], rows: Floats, start_time: float, flags: list[int] | None = None) -> str:
    """Write rows below a header, in full precision, with a last column of `flags` if given."""
    out = io.StringIO()
    if start_time:
        out.write(f"{STARTS}{start_time!r}\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(
        rows.tolist() if flags is None else [[*row, k] for row, k in zip(rows.tolist(), flags, strict=True)]
    )
    return out.getvalue()


def start_of(text: str) -> tuple[float, str]:
    """Split a table into its start time and the lines that follow."""
    first, _, rest = text.partition("\n")
    return (float(first.removeprefix(STARTS)), rest) if first.startswith(STARTS) else (0.0, text)
