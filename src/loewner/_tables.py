"""Numbers in text, divided by commas or by spaces: never by both, so that none goes missing unseen."""

from __future__ import annotations

import io
import re

import numpy as np

from loewner._validate import Floats, short
from loewner.errors import FileError

# How a line ends; a comment, which goes to the end of its line; the spaces of lines that hold no more, and a number.
LINE_END, COMMENT = re.compile(r"\r\n|\r|\n"), re.compile("#[^\r\n]*")
BLANK, CONTENT = re.compile(r"^[ \t]+(?=#|\r?$)", re.MULTILINE), re.compile(r"^[ \t]*[^#\s]", re.MULTILINE)


def row(text: str, *, commas: bool | None = None) -> list[float]:
    """Numbers of a line.

    Parameters
    ----------
    text : str
    commas : bool, optional
        Whether commas divide the numbers, or spaces. Default: commas, if there is one.

    Raises
    ------
    ValueError
        If there is no number between two of them, or something that is none; it says what was expected and found.

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
    """What a cell holds; ValueError says what else it does."""
    if not cell:
        raise ValueError("expected a number in each cell, found an empty one")
    if len(cell.split()) > 1 or "," in cell:
        raise ValueError(
            f"expected numbers divided by commas or by spaces, not by both, and no decimal commas, found {short(cell)}"
        )
    try:  # Python would take "1_0" for ten, and digits of all the world's scripts
        if cell.isascii() and "_" not in cell:
            return float(cell)
    except ValueError:
        pass
    raise ValueError(f"expected a number, found {short(cell)}")


def table(data: bytes, name: str, *, commas: bool = False) -> Floats:
    """Numbers of a text of lines that are equally long; what follows a # is a comment.

    Parameters
    ----------
    data : bytes
        All of a file.
    name : str
        What it is called, for messages.
    commas : bool
        Whether commas divide the numbers of each line. Otherwise they do if there is one in any line, or else spaces.

    Returns
    -------
    ndarray, shape (lines, columns)

    Raises
    ------
    FileError
        If a line has an empty cell or something that is no number, or another length; it says which line.
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
        found = str(error)[:200]
        raise FileError(f"{name}: expected an array of numbers, found something else ({found})") from None


def _refuse_lines(text: str, name: str, commas: bool) -> None:
    """Say which line is no row of numbers, or of another length than the first."""
    length = 0
    for number, line in enumerate(LINE_END.split(text), 1):
        content = line.partition("#")[0]
        if content.strip():
            try:
                found = len(row(content, commas=commas))
            except ValueError as error:
                raise FileError(f"{name}, line {number}: {error}") from None
            if found != (length := length or found):
                raise FileError(f"{name}, line {number}: expected {length} numbers as in the first line, found {found}")
