"""Read JSON and YAML as trees of places: keys occur once, kinds are checked, and errors name file, line and key.

A file is read completely or refused, since a robot would drive into an obstacle that was skipped. Every key must
therefore be known, and every error is reported with its place.
"""

from __future__ import annotations

import functools
import json
import math
import re
import reprlib
import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from loewner._base import _json, _validate
from loewner.errors import FileError, InputError, imported

# Limits on a file: the depth of nested entries and, for YAML, the number of entries. An alias counts each time it is
# used. A scene of a hundred thousand boxes has half of the allowed entries. Reading YAML takes a few seconds per
# megabyte.
DEEPEST = 50
MOST_ENTRIES = 2_000_000

# YAML's tags for plain values, and for a key that adds another mapping's entries to a mapping.
TAGS = tuple(f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp"))
MERGE = "tag:yaml.org,2002:merge"

# NUMBER matches decimal numbers that YAML 1.1 and 1.2 both read, and also numbers like 1e-3, which YAML 1.1 reads as
# text; OCTAL matches integers that YAML 1.1 reads as octal.
NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)
OCTAL = re.compile(r"[-+]?0\d+", re.ASCII)

# Tags of angles in ROS parameter files, and the radians of one unit.
ANGLES = {"!degrees": math.pi / 180, "!radians": 1.0}


class Node(ABC):
    """A place in a file; each format defines how its plain values are read.

    Attributes
    ----------
    file : Path
    raw : object
        The value of the place, as returned by the format's reader.
    """

    __slots__ = ("_above", "_name", "file", "raw")

    def __init__(self, file: Path, raw: Any, above: Node | None = None, name: str | int = "") -> None:
        self.file, self.raw, self._above, self._name = file, raw, above, name

    @property
    def key(self) -> str:
        """The keys that lead to the place, joined by "/"; empty at the top."""
        names: list[str] = []
        at: Node | None = self
        while at is not None and at._above is not None:  # YAML's aliases may lead deeper than recursion can go
            names.append(f"[{at._name}]" if isinstance(at._name, int) else f"/{cut(at._name)}")
            at = at._above
        return cut_middle("".join(reversed(names)).removeprefix("/"))

    @property
    def line(self) -> int | None:
        """Line at which the place begins; None if the format's reader records no lines."""
        return None

    @property
    @abstractmethod
    def kind(self) -> str:
        """Whether the place is a "mapping", a "sequence" or a "scalar"."""

    @property
    @abstractmethod
    def empty(self) -> bool:
        """Whether the place has no value, or is an empty mapping, sequence or text."""

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

    def angle(self) -> float:
        """Read a finite number, or in YAML an angle with the tag !degrees or !radians; the result is in radians."""
        return self.number()

    def error(self, text: str) -> FileError:
        """Make an error about this place."""
        line, key = "" if self.line is None else f", line {self.line}", self.key
        return FileError(f"{self.file}{line}:{f' {key}:' if key else ''} {text}")

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Name the place in errors about its contents."""
        try:
            yield
        except (InputError, FileError) as error:
            raise self.error(str(error)) from None

    def mapping(self, known: Collection[str] | None, required: tuple[str, ...] = ()) -> dict[str, Self]:
        """Return places by key; missing and duplicate keys are errors, as are unknown keys unless `known` is None."""
        places: dict[str, Self] = {}
        for raw_key, raw in self.expect("mapping", "a mapping"):
            key = raw_key if type(raw_key) is str else str(self._at(raw_key).expect("scalar", "a name as key"))
            if known is not None and key not in known:
                raise self._at(raw_key).error(f"expected keys among {', '.join(known)}, found {cut(repr(key))}")
            if key in places:
                raise self._at(raw_key).error(f"expected each key once in a mapping, found {cut(repr(key))} again")
            places[key] = type(self)(self.file, raw, self, key)
        for key in required:
            if key not in places:
                raise self.error(f"expected the key {key}, found {some(places) or 'none'}")
        return places

    def _at(self, raw_key: Any) -> Self:
        """Return the place of a key; its errors name the mapping."""
        return type(self)(self.file, raw_key, self._above, self._name)

    def items(self, *lengths: int, names: str = "") -> list[Self]:
        """Return the places of a sequence; its length must be one of `lengths`, if any are given.

        Messages show the `names` of the entries.
        """
        wanted = f"a sequence of {' or '.join(map(str, lengths))}{names and f' ({names})'}" if lengths else "a sequence"
        entries = self.expect("sequence", wanted)
        if lengths and len(entries) not in lengths:
            raise self.error(f"expected {wanted}, found {self.described()}")
        return [type(self)(self.file, raw, self, i) for i, raw in enumerate(entries)]

    def first(self) -> Self:
        """Return the first place of a sequence that is not empty."""
        return type(self)(self.file, self.expect("sequence", "a sequence")[0], self, 0)

    def finite(self, number: float) -> float:
        """Check that a number read here is finite; NaN means that no number could be read."""
        if not math.isfinite(number):
            raise self.error(f"expected a finite number, found {self.described()}")
        return number

    def length(self) -> float:
        """Read a non-negative length in metres."""
        number = self.number()
        if number < 0:
            raise self.error(f"expected a number of metres >= 0, found {number:g}")
        return number

    def numbers(self, length: int | None = None, names: str = "") -> list[float]:
        """Read finite numbers, exactly `length` of them if it is given; messages show their `names`."""
        return [item.number() for item in self.items(*([] if length is None else [length]), names=names)]

    def choice(self, words: Collection[str], wanted: str = "") -> str:
        """Read one of several words. The error lists the words, unless `wanted` is a shorter description of them."""
        text = self.text()
        if text not in words:
            raise self.error(f"expected {wanted or f'one of {some(words)}'}, found {self.described()}")
        return text

    def rows(self, length: int) -> list[list[float]]:
        """Read rows, each with a given number of finite values."""
        return [row.numbers(length) for row in self.items()]


def some(names: Iterable[str]) -> str:
    """Join names for messages: a limited number of names, each shortened to a limited length."""
    return _validate.some(map(cut, names))


def cut_middle(text: str) -> str:
    """Shorten the keys that lead to a place: keep the first and the last."""
    return text if len(text) <= 400 else f"{text[:200]} ... {text[-200:]}"


def cut(text: str) -> str:
    """Shorten a string from a file for a message."""
    return text if len(text) <= 80 else f"{text[:77]}..."


# -- JSON ---------------------------------------------------------------------------------------


class JsonNode(Node):
    """A place in a JSON file; the JSON reader records no line numbers."""

    __slots__ = ()

    @property
    def kind(self) -> str:
        """Whether the place is a "mapping", a "sequence" or a "scalar"."""
        return "mapping" if isinstance(self.raw, dict) else "sequence" if isinstance(self.raw, list) else "scalar"

    @property
    def empty(self) -> bool:
        """Whether the place has no value, or is an empty mapping, sequence or text."""
        return self.raw is None or (isinstance(self.raw, (dict, list, str)) and not self.raw)

    def expect(self, kind: str, wanted: str) -> Any:
        """Check the kind of the place and return its content: mapping pairs, sequence entries, or a plain value."""
        if self.kind != kind:
            raise self.error(f"expected {wanted}, found {self.described()}")
        return self.raw.items() if isinstance(self.raw, dict) else self.raw

    def described(self) -> str:
        """Describe the content, for messages."""
        if isinstance(self.raw, dict | list):
            return f"a {self.kind} of {len(self.raw)}"
        return cut(repr(self.raw) if isinstance(self.raw, str) else reprlib.repr(self.raw))

    def _plain(self, kind: type, wanted: str) -> Any:
        # In Python, a bool is an int; in a file, it is not.
        if not isinstance(self.raw, kind) or (isinstance(self.raw, bool) and kind is not bool):
            raise self.error(f"expected {wanted}, found {self.described()}")
        return self.raw

    def text(self) -> str:
        """Read a name."""
        return str(self._plain(str, "a name"))

    def number(self) -> float:
        """Read a finite number; integers may be too large for a float."""
        value = self.raw if isinstance(self.raw, float) else self._plain(int, "a number")
        return self.finite(float(value) if abs(value) <= sys.float_info.max else math.nan)

    def numbers(self, length: int | None = None, names: str = "") -> list[float]:
        """Read finite numbers, exactly `length` of them if it is given; messages show their `names`."""
        raw = self.raw
        plain = type(raw) is list and length in (None, len(raw))
        if plain and all(type(value) is float and math.isfinite(value) for value in raw):
            return list(raw)
        return super().numbers(length, names)

    def whole(self) -> int:
        """Read a whole number."""
        return int(self._plain(int, "a whole number"))

    def flag(self) -> bool:
        """Read a boolean."""
        return bool(self._plain(bool, "true or false"))


def read_json(data: str | bytes, file: Path, what: str) -> JsonNode:
    """Read a JSON file in UTF-8, UTF-16 or UTF-32; a FileError names the expected content, and the line if known."""
    try:
        text = data if isinstance(data, str) else data.decode(json.detect_encoding(data))
        return JsonNode(file, _json.parsed(text.removeprefix("\ufeff"), str(file)))
    except FileError:
        raise
    except json.JSONDecodeError as error:
        raise FileError(f"{file}, line {error.lineno}: expected JSON, found a fault in it ({error.msg})") from None
    except RecursionError:
        raise FileError(f"{file}: expected {what}, found too many entries inside each other") from None
    except ValueError as error:
        raise FileError(f"{file}: expected {what}, found something else ({error})") from None


# -- YAML ---------------------------------------------------------------------------------------


class YamlNode(Node):
    """A place in a YAML file; `raw` is PyYAML's node, which records the line."""

    __slots__ = ()

    @property
    def line(self) -> int:
        """Line at which the place begins."""
        return int(self.raw.start_mark.line) + 1

    @property
    def kind(self) -> str:
        """Whether the place is a "mapping", a "sequence" or a "scalar"."""
        return str(self.raw.id)

    @property
    def empty(self) -> bool:
        """Whether the place has no value, or is an empty mapping, sequence or text."""
        return not self.raw.value or self.raw.tag == "tag:yaml.org,2002:null"

    def expect(self, kind: str, wanted: str) -> Any:
        """Check the kind of the place and return its content: mapping pairs, sequence entries, or a scalar's text."""
        if self.raw.tag not in TAGS:
            raise self.error(f"expected {wanted}, found the tag {self.raw.tag}")
        if self.raw.id != kind:
            raise self.error(f"expected {wanted}, found {self.described()}")
        return self.raw.value

    def described(self) -> str:
        """Describe the content, for messages."""
        if self.raw.id == "scalar":
            return cut(repr(self.raw.value)) if self.raw.value else "nothing"
        return f"a {self.raw.id} of {len(self.raw.value)}"

    def text(self) -> str:
        """Read a name, even one that YAML would read as a number."""
        value: str = self.expect("scalar", "a name")
        if not value:
            raise self.error("expected a name, found nothing")
        return value

    def number(self) -> float:
        """Read a finite number; refuse a quoted number, and a number that differs between YAML 1.1 and 1.2."""
        return self._number(self.expect("scalar", "a number"))

    def angle(self) -> float:
        """Read a finite number, or an angle with the tag !degrees or !radians; the result is in radians."""
        if self.raw.tag in ANGLES and self.raw.id == "scalar":
            return self._number(self.raw.value) * ANGLES[self.raw.tag]
        return self.number()

    def _number(self, value: str) -> float:
        if self.raw.style is not None or not NUMBER.fullmatch(value):
            return self.finite(math.nan)
        if OCTAL.fullmatch(value) and not ("8" not in value and "9" not in value and int(value, 8) == int(value)):
            raise self.error(f"expected a number without leading zeros, octal in YAML 1.1, found {cut(value)}")
        return self.finite(float(value))

    def flag(self) -> bool:
        """Read a boolean."""
        value = str(self.expect("scalar", "true or false")).lower()
        if value not in ("true", "false") or self.raw.style is not None:
            raise self.error(f"expected true or false, found {self.described()}")
        return value == "true"


def yaml_package() -> Any:
    """Import PyYAML, which is optional."""
    return imported("yaml", "YAML files need PyYAML", "robots")


def read_yaml(data: bytes, file: Path, what: str, *, merges: bool = False) -> YamlNode:
    """Read a YAML file that contains one document; a FileError names the expected content, and the line if known.

    With `merges`, the key ``<<`` adds the entries of other mappings; without it, the key is unknown.
    """
    yaml = yaml_package()
    try:
        loader = _loader()(data)
        try:
            root = loader.get_node() if loader.check_node() else None
            if loader.check_node():
                line = loader.peek_event().start_mark.line + 1
                detail = "several, separated by ---; write each to a file of its own"
                raise FileError(f"{file}, line {line}: expected {what}, found {detail}")
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise FileError(f"{file}, line {mark.line + 1}: expected YAML, found a fault in it ({error.problem})") from None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:  # escapes and depth cause others
        detail = " ".join(str(error).split())[:200]
        raise FileError(f"{file}: expected YAML, found something else ({detail})") from None
    if root is None:
        raise FileError(f"{file}: expected {what}, found an empty file")
    top = YamlNode(file, root)
    if merges:
        _merge(top)
    return top


def _merge(top: YamlNode) -> None:
    """Replace each key << with the entries of the mappings that it names; a mapping's own entries take precedence."""
    # In `order`, the parts of a node come before the node. An alias leads to its node again, even from within that
    # node, so `seen` lists the visited nodes.
    order, waiting, seen = [], [(top.raw, False)], set()
    while waiting:
        node, entered = waiting.pop()
        if entered:
            order.append(node)
        elif id(node) not in seen and node.id != "scalar":
            seen.add(id(node))
            waiting.append((node, True))
            inside = node.value if node.id == "sequence" else [value for _, value in node.value]
            waiting += [(each, False) for each in inside]
    for node in order:
        if node.id != "mapping" or not any(key.tag == MERGE for key, _ in node.value):
            continue
        own = [(key, value) for key, value in node.value if key.tag != MERGE]
        taken = {key.value for key, _ in own if key.id == "scalar"}
        for key, value in node.value:
            if key.tag != MERGE:
                continue
            for each in value.value if value.id == "sequence" else [value]:
                if each.id != "mapping":
                    raise YamlNode(top.file, each).error("expected a mapping at <<, found something else")
                own += [pair for pair in each.value if pair[0].id != "scalar" or pair[0].value not in taken]
                taken |= {pair[0].value for pair in each.value if pair[0].id == "scalar"}
        node.value = own


@functools.cache
def _loader() -> Any:
    """Make the class that reads YAML when PyYAML is first needed; nothing in a file is executed."""
    yaml = yaml_package()
    parent: Any = yaml.SafeLoader

    class Loader(parent):  # type: ignore[misc]
        """A YAML loader that counts nodes, so that neither depth nor nested aliases exceed the limits on a file."""

        def __init__(self, data: bytes) -> None:
            super().__init__(data)
            self.depth = self.entries = 0
            self.entries_of: dict[str, int] = {}

        def compose_node(self, above: Any, index: Any) -> Any:
            event = self.peek_event()
            before = self.entries
            self.depth += 1
            self.entries += 1
            if self.depth > DEEPEST:
                self.refuse(f"more than {DEEPEST} entries inside each other", event)
            node = super().compose_node(above, index)
            self.depth -= 1
            if isinstance(event, yaml.AliasEvent):
                # An alias counts as many entries as its node; within that node, whose count is not yet complete, it
                # counts as one.
                self.entries = before + self.entries_of.get(event.anchor, 1)
            elif event.anchor is not None:
                self.entries_of[event.anchor] = self.entries - before
            if self.entries > MOST_ENTRIES:
                self.refuse(f"more than {MOST_ENTRIES} entries, aliases counted each time", event)
            return node

        def refuse(self, what: str, event: Any) -> None:
            raise yaml.composer.ComposerError(None, None, what, event.start_mark)

    return Loader
