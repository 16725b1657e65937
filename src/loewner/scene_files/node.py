"""Read places in a file of nested mappings and sequences, check their contents, and name them in messages.

A file is read completely or refused, since a robot would drive into an obstacle that was skipped. Every key must
therefore be known, and every fault is reported with its place.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from loewner.errors import FileError, InputError

# Largest number of keys that a message lists.
LISTED = 30

# Limit on the depth of nested entries.
DEEPEST = 50


@dataclass(frozen=True)
class Node(ABC):
    """A place in a file; each format defines how its plain values are read.

    Attributes
    ----------
    file : Path
    key : str
        The keys that lead here, joined by "/"; empty at the top.
    raw : object
        The value of the place, as returned by the format's reader.
    """

    file: Path
    key: str
    raw: Any

    @property
    @abstractmethod
    def line(self) -> int | None:
        """Line at which the place begins, if the reader records lines."""

    @abstractmethod
    def expect(self, kind: str, wanted: str) -> Any:
        """Check the kind of the place and return its content: mapping pairs, sequence entries, or a scalar's value."""

    @abstractmethod
    def described(self) -> str:
        """Describe the content, for messages."""

    @abstractmethod
    def text(self) -> str:
        """Read a name."""

    @abstractmethod
    def number(self) -> float:
        """Read a finite number."""

    @abstractmethod
    def flag(self) -> bool:
        """Read a boolean."""

    def error(self, text: str) -> FileError:
        """Make an error about this place."""
        line = "" if self.line is None else f", line {self.line}"
        return FileError(f"{self.file}{line}:{f' {self.key}:' if self.key else ''} {text}")

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Add the place in the file to errors about its contents."""
        try:
            yield
        except (InputError, FileError) as error:
            raise self.error(str(error)) from None

    def mapping(self, known: tuple[str, ...] | None, required: tuple[str, ...] = ()) -> dict[str, Self]:
        """Return places by key; missing and duplicate keys are errors, and unknown ones unless `known` is None."""
        found: dict[str, Self] = {}
        for raw_key, raw in self.expect("mapping", "a mapping"):
            at_key = type(self)(self.file, self.key, raw_key)
            key = at_key.expect("scalar", "a name as key")
            if known is not None and key not in known:
                raise at_key.error(f"expected keys among {', '.join(known)}, found {cut(repr(key))}")
            if key in found:
                raise at_key.error(f"expected each key once, found {cut(repr(key))} again")
            found[key] = type(self)(self.file, f"{self.key}/{cut(key)}" if self.key else cut(key), raw)
        for key in required:
            if key not in found:
                raise self.error(f"expected the key {key}, found {some(found) or 'none'}")
        return found

    def items(self, *lengths: int, names: str = "") -> list[Self]:
        """Return the places of a sequence, which has one of these lengths, or any length if none is given.

        Names of its entries are shown in messages.
        """
        wanted = f"a sequence of {' or '.join(map(str, lengths))}{names and f' ({names})'}" if lengths else "a sequence"
        entries = self.expect("sequence", wanted)
        if lengths and len(entries) not in lengths:
            raise self.error(f"expected {wanted}, found {self.described()}")
        return [type(self)(self.file, f"{self.key}[{i}]", raw) for i, raw in enumerate(entries)]

    def finite(self, number: float) -> float:
        """Check that a number read here is finite; NaN means that none could be read."""
        if not math.isfinite(number):
            raise self.error(f"expected a finite number, found {self.described()}")
        return number

    def length(self) -> float:
        """Read a non-negative length in metres."""
        number = self.number()
        if number < 0:
            raise self.error(f"expected a number of metres >= 0, found {number:g}")
        return number

    def numbers(self, length: int, names: str = "") -> list[float]:
        """Read a given count of finite numbers, whose names are shown in messages."""
        return [item.number() for item in self.items(length, names=names)]

    def rows(self, length: int) -> list[list[float]]:
        """Read rows, each with a given number of finite values."""
        return [row.numbers(length) for row in self.items()]


def some(names: Iterable[str]) -> str:
    """Format names for messages, limited to a readable number."""
    listed = list(names)
    more = f", and {len(listed) - LISTED} more" if len(listed) > LISTED else ""
    return ", ".join(map(cut, listed[:LISTED])) + more


def cut(text: str) -> str:
    """Shorten a string from a file for a message."""
    return text if len(text) <= 80 else f"{text[:77]}..."
