"""Split files in text formats into lines, numbers and comments, and report faults with their lines."""

import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from loewner._base._plausible import doubt_about_unit
from loewner._base._validate import Floats, Ints
from loewner.meshes.files.parts import Refusal, Tell, quoted

T = TypeVar("T", np.float64, np.int64)


def floats(tokens: Sequence[bytes]) -> Floats:
    """Convert tokens to numbers, where 1e400 becomes infinity; refuse the first token that is not a number."""
    return _converted(tokens, float, np.float64, "a number")


def integers(tokens: Sequence[bytes]) -> Ints:
    """Convert tokens to integers; refuse the first token that is not an integer or is absurdly large."""
    return _converted(tokens, int, np.int64, "a whole number")


def _converted(tokens: Sequence[bytes], read: Callable[[bytes], Any], kind: type[T], wanted: str) -> NDArray[T]:
    numbers = _numbers(tokens, read, kind)
    if numbers is None:
        bad = next(token for token in tokens if _numbers([token], read, kind) is None)
        raise Refusal(f"expected {wanted}, found {quoted(bad)}")
    return numbers


def _numbers(tokens: Sequence[bytes], read: Callable[[bytes], Any], kind: type[T]) -> NDArray[T] | None:
    """Convert tokens with `int` or `float`, but refuse underscores; None if a token is not such a number."""
    try:
        numbers = np.fromiter(map(read, tokens), dtype=kind, count=len(tokens))
    except (ValueError, OverflowError):
        return None
    return None if b"_" in b"".join(tokens) else numbers


def in_line(number: int, convert: Callable[[Sequence[bytes]], NDArray[T]], tokens: Sequence[bytes]) -> NDArray[T]:
    """Convert the words of a line; a refusal includes the line's number."""
    try:
        return convert(tokens)
    except Refusal as refusal:
        raise Refusal(str(refusal), number) from None


def table_of(lines: list[list[bytes]], numbers: list[int], width: int, wanted: str) -> Floats:
    """Convert the words of lines of equal length, shape (lines, width); a refusal includes the line's number."""
    if set(map(len, lines)) - {width}:
        k = next(k for k, line in enumerate(lines) if len(line) != width)
        raise Refusal(f"expected {wanted}, found {len(lines[k])}", numbers[k])
    try:
        return floats([word for line in lines for word in line]).reshape(len(lines), width)
    except Refusal:
        refuse_line(lines, numbers)
        raise


def refuse_line(lines: list[list[bytes]], numbers: list[int]) -> None:
    """Refuse the first line, if any, with a word that is not a number."""
    for line, number in zip(lines, numbers, strict=True):
        in_line(number, floats, line)


def tell_unit(comments: bytes, tell: Tell) -> None:
    """Report a unit that comments name."""
    doubt = doubt_about_unit(comments.decode("latin-1"))
    if doubt:
        tell(f"expected {doubt}", "")


def remarks(data: bytes) -> bytes:
    """Return the comments of a text from # to the ends of their lines."""
    return b"\n".join(re.findall(rb"#[^\r\n]*", data))


def with_line_feeds(data: bytes) -> bytes:
    """Return a text whose lines, which may end in LF, CR LF or CR, all end in LF."""
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def plain_lines(data: bytes) -> list[bytes]:
    """Split a text into lines, which end in LF, CR LF or CR."""
    return with_line_feeds(data).split(b"\n")


def data_lines(data: bytes, comment: bytes | None = None) -> tuple[list[list[bytes]], list[int]]:
    """Return the words of all non-empty lines, and the line numbers."""
    lines = plain_lines(data)
    if comment is not None and comment in data:
        lines = [line.partition(comment)[0] for line in lines]
    words = [line.split() for line in lines]
    return [w for w in words if w], [i for i, w in enumerate(words, 1) if w]
