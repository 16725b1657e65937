"""Read JSON, but refuse an object in which a key occurs twice: Python would silently keep only the last value."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from loewner._base._memory import uncollected
from loewner._base._validate import short
from loewner.errors import FileError

# A string, which may lack its end, or a character that begins, divides or ends a mapping or a list.
_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"?|[{}\[\]:]', re.DOTALL)


class RepeatedKeyError(ValueError):
    """A key occurs twice in an object.

    Attributes
    ----------
    line : int
        The line of the second occurrence.
    """

    def __init__(self, key: str, line: int) -> None:
        super().__init__(f"expected each key once in a mapping, found {short(key)} again")
        self.line = line


def parsed(data: str | bytes, name: str) -> Any:
    """Parse a file of JSON as `json.loads` does, and refuse a key that occurs twice in an object.

    Parameters
    ----------
    data : str or bytes
        Contents of the file; bytes may be in UTF-8, UTF-16 or UTF-32.
    name : str
        Name of the file, for messages.

    Raises
    ------
    FileError
        If a key occurs twice in an object; the message gives the line of the second occurrence.
    ValueError, RecursionError
        If the data are not JSON, or are nested too deeply.

    Examples
    --------
    >>> parsed('{"a": {"b": 1}, "b": 2}', "x.json")
    {'a': {'b': 1}, 'b': 2}
    >>> parsed('{"a": 1,\\n "a": 2}', "x.json")
    Traceback (most recent call last):
        ...
    loewner.errors.FileError: x.json, line 2: expected each key once in a mapping, found 'a' again
    """
    try:
        return loads(data)
    except RepeatedKeyError as error:
        raise FileError(f"{name}, line {error.line}: {error}") from None


def loads(data: str | bytes, constant: Callable[[str], Any] | None = None) -> Any:
    """Parse JSON as `json.loads` does, and raise a RepeatedKeyError if a key occurs twice in an object.

    If given, `constant` is called with the words NaN, Infinity and -Infinity; by default, they become floats.
    """
    text = data if isinstance(data, str) else data.decode(json.detect_encoding(data), "surrogatepass")
    repeated: list[Any] = []

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        mapping = dict(pairs)
        if len(mapping) != len(pairs):
            repeated.append(mapping)
        return mapping

    with uncollected():
        document = json.loads(text, object_pairs_hook=once, parse_constant=constant)
    if repeated:
        raise RepeatedKeyError(*_first_repeated(text))
    return document


def _first_repeated(text: str) -> tuple[str, int]:
    """Find the first repeated key in valid JSON, and its line, which the parser does not record."""
    keys: list[set[str]] = []  # for the objects and lists that are open, from the outside inwards
    last, start = "", 0
    for token in _TOKEN.finditer(text):
        lexeme = token[0]
        if lexeme in "{[":
            keys.append(set())
        elif lexeme in "}]":
            keys.pop()
        elif lexeme != ":":
            last, start = lexeme, token.start()
        else:
            key = json.loads(last)
            if key in keys[-1]:
                return key, text.count("\n", 0, start) + 1
            keys[-1].add(key)
    raise AssertionError("expected a key that occurs twice")
