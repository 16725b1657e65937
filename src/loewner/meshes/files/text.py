"""Lines, numbers and comments of formats in text: split them, and report faults with their lines."""

import re
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from loewner._base._plausible import doubt_about_unit
from loewner._base._validate import Floats, Ints
from loewner.meshes.files.parts import Refusal, Tell, quoted

T = TypeVar("T", np.float64, np.int64)


def is_float(token: bytes) -> bool:
    """Return whether `floats` accepts a token: Python's grammar without underscores."""
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token


def is_integer(token: bytes) -> bool:
    """Return whether `integers` accepts a token."""
    return token.lstrip(b"+-").isdigit() and len(token) <= 19 and token.lstrip(b"+-") in (token, token[1:])


def floats(tokens: Sequence[bytes]) -> Floats:
    """Convert tokens to numbers, where 1e400 becomes infinity; refuse the first token that is not a number."""
    try:
        numbers = np.fromiter(map(float, tokens), dtype=np.float64, count=len(tokens))
        if b"_" not in b"".join(tokens):
            return numbers
    except ValueError:
        pass
    bad = next(token for token in tokens if not is_float(token))
    raise Refusal(f"expected a number, found {quoted(bad)}")


def integers(tokens: Sequence[bytes]) -> Ints:
    """Convert tokens to integers; refuse the first token that is not an integer or is absurdly large."""
    try:
        numbers = np.fromiter(map(int, tokens), dtype=np.int64, count=len(tokens))
        if b"_" not in b"".join(tokens):
            return numbers
    except (ValueError, OverflowError):
        pass
    bad = next((token for token in tokens if not is_integer(token)), max(tokens, key=len, default=b""))
    raise Refusal(f"expected a whole number, found {quoted(bad)}")


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
    """Refuse the first line, if any, that has a word that is not a number."""
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


def plain_lines(data: bytes) -> list[bytes]:
    """Split a text into lines, which end in LF, CR LF or CR."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data.split(b"\n")


def data_lines(data: bytes, comment: bytes | None = None) -> tuple[list[list[bytes]], list[int]]:
    """Return the words of all non-empty lines, and the line numbers."""
    lines = plain_lines(data)
    if comment is not None and comment in data:
        lines = [line.partition(comment)[0] for line in lines]
    words = [line.split() for line in lines]
    return [w for w in words if w], [i for i, w in enumerate(words, 1) if w]
