"""Read the XML elements of robot descriptions, with line numbers for error messages.

The standard library's reader is used, since it records the line of every element. Elements that are not needed
(materials, sensors and transmissions) are ignored, even if they are broken.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from loewner import _validate
from loewner._files import read_regular
from loewner.errors import FileError, InputError

# Limits on a description, a hundred times the largest known robots: bytes of a file, number of elements, and depth of
# their nesting.
MOST_BYTES = 2**25
MOST_ELEMENTS = 250_000
DEEPEST = 100

# Larger numbers in a description are refused: lengths, factors and offsets [m, rad, 1]. Results from thousands of them
# are then still finite.
LARGEST = 1e12

# Advice for a text that is passed as a path.
ITS_TEXT = {"a URDF": "; give it by text="}

# Largest number of names that a message lists.
LISTED = 30

# Namespaces whose elements another program has to replace before a description is complete, and their usual prefixes,
# which some files use without declaring them. The address of xacro's namespace has had several forms.
TO_EXPAND = ("xacro", "www.w3.org/2001/xinclude")
UNDECLARED = {"xacro": "xacro", "xi": "www.w3.org/2001/xinclude"}

# Elements of xacro from the time before it had a prefix; as children of <robot>, they have no other meaning.
WITHOUT_PREFIX = ("include", "macro", "property")


@dataclass(eq=False)
class Element:
    """An element, its contents, and its position."""

    tag: str
    attributes: dict[str, str]
    line: int
    path: Path
    children: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Return the children with this tag."""
        return (c for c in self.children if c.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child with this tag, or None."""
        return next(self.all(tag), None)

    def the(self, tag: str) -> Element:
        """Return the first child with this tag, which must exist."""
        found = self.first(tag)
        if found is None:
            self.fault(f"a <{tag}> in <{self.tag}>", "none")
        return found

    def text(self, attribute: str) -> str:
        """Return an attribute, which must exist and not be empty."""
        found = self.attributes.get(attribute, "").strip()
        if not found:
            self.fault(f"an attribute {attribute!r} of <{self.tag}>", "none")
        return found

    def numbers(self, attribute: str, count: int, default: str | None = None) -> list[float]:
        """Read an attribute that must contain a given count of numbers; infinity is allowed, NaN is not."""
        text = self.attributes.get(attribute, default)
        if text is None:
            self.fault(f"an attribute {attribute!r} of <{self.tag}>", "none")
        try:  # Python would accept "1_0" as ten, and digits of other scripts
            values = [float(word) for word in text.split()] if text.isascii() and "_" not in text else []
        except ValueError:
            values = []
        if len(values) != count or any(math.isnan(v) for v in values):
            unexpanded = "${" in text or "$(" in text
            advice = "; run xacro on the file first" if unexpanded else ""
            self.fault(f"{count} number{'s' * (count > 1)} as {attribute!r} of <{self.tag}>", cut(text) + advice)
        return values

    def finite(self, attribute: str, count: int, default: str | None = None) -> list[float]:
        """Read an attribute that must contain a given count of numbers, none larger than `LARGEST`."""
        values = self.numbers(attribute, count, default)
        if not all(abs(v) <= LARGEST for v in values):
            found = cut(self.attributes[attribute])
            self.fault(f"finite numbers as {attribute!r} of <{self.tag}>, none beyond {LARGEST:g}", found)
        return values

    def fault(self, expected: str, found: str, kind: type[Exception] = InputError) -> NoReturn:
        """Raise an error that names the position in the file."""
        raise kind(f"{self.path}, line {self.line}: expected {expected}, found {found}")


def read_xml(path: str | os.PathLike[str], what: str, text: str | None = None) -> Element:
    """Read the root element of a robot description, from a file or a string; messages name the path in both cases."""
    if isinstance(path, str) and path.lstrip().startswith("<"):
        raise InputError(f"expected a path to {what}, found XML text{ITS_TEXT.get(what, '; write it to a file first')}")
    path = _validate.path(path, "path", wanted=f"a path to {what}")
    data = read_regular(path, what, MOST_BYTES) if text is None else _bytes_of(text, what)
    # A text has already been decoded, whatever encoding its first line declares.
    parser = expat.ParserCreate(None if text is None else "utf-8")
    document = Element("", {}, 1, path)
    open_elements = [document]
    namespaces = [UNDECLARED]
    macros: list[Element] = []
    count = 0

    def refuse(found: str) -> NoReturn:
        raise FileError(f"{path}, line {parser.CurrentLineNumber}: expected {what}, found {found}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS or len(open_elements) > DEEPEST:
            most = f"{MOST_ELEMENTS} elements" if count > MOST_ELEMENTS else f"{DEEPEST} elements inside each other"
            refuse(f"more than {most}")
        element = Element(tag, attributes, parser.CurrentLineNumber, path)
        namespaces.append(_with_declared(namespaces[-1], attributes))
        old = len(open_elements) == 2 and tag in WITHOUT_PREFIX
        if old or _is_macro(tag, namespaces[-1]):
            macros.append(element)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def end(tag: str) -> None:
        open_elements.pop()
        namespaces.pop()

    # Entities can expand to more text than memory holds, or to other files; no description needs to define any.
    parser.EntityDeclHandler = lambda name, *rest: refuse(f"the declaration of an entity, {cut(name)}")
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except FileError:
        raise
    except (expat.ExpatError, ValueError, LookupError, MemoryError) as error:  # an unknown or large encoding
        line = getattr(error, "lineno", 1)
        raise FileError(f"{path}, line {line}: expected {what}, found broken XML ({error})") from None
    root = document.children[0]
    if root.tag != "robot":
        root.fault(f"{what} with the root element <robot>", f"<{root.tag}>", FileError)
    if macros:
        macros[0].fault(f"{what}", f"the macro <{macros[0].tag}>; run xacro on the file first", FileError)
    return root


def _with_declared(namespaces: dict[str, str], attributes: dict[str, str]) -> dict[str, str]:
    """Add the namespaces that an element declares to a dict by prefix; the default namespace has the prefix ""."""
    if not any(name.startswith("xmlns") for name in attributes):
        return namespaces
    declared = {name[6:]: value for name, value in attributes.items() if name == "xmlns" or name.startswith("xmlns:")}
    return namespaces | declared


def _is_macro(tag: str, namespaces: dict[str, str]) -> bool:
    """Return whether xacro or XInclude would replace an element; the prefix xacro always means xacro."""
    prefix = tag.rpartition(":")[0]
    return prefix == "xacro" or any(part in namespaces.get(prefix, "").lower() for part in TO_EXPAND)


def _bytes_of(text: str, what: str) -> bytes:
    """Encode a string as it would be in a file."""
    try:
        data = text.encode()
    except UnicodeEncodeError:
        raise InputError(f"text: expected the text of {what}, found a character that no file can have") from None
    if len(data) > MOST_BYTES:
        raise InputError(f"text: expected {what} of at most {MOST_BYTES} bytes, found {len(data)}")
    return data


def by_name(elements: Iterable[Element]) -> dict[str, Element]:
    """Key elements by name; each name may occur only once."""
    named: dict[str, Element] = {}
    for element in elements:
        name = element.text("name")
        if name in named:
            element.fault(f"each name of a {element.tag} once", f"{name!r} again, first in line {named[name].line}")
        named[name] = element
    return named


def known(names: Iterable[str]) -> str:
    """Format names for messages."""
    listed = some(sorted(names))
    return f"known are {listed}" if listed else "there are none"


def some(names: Iterable[str]) -> str:
    """Format names for messages, without repeats and limited to a readable number."""
    once = list(dict.fromkeys(names))
    more = f", and {len(once) - LISTED} more" if len(once) > LISTED else ""
    return ", ".join(once[:LISTED]) + more


def cut(text: str) -> str:
    """Shorten a string from a file for a message."""
    return repr(text) if len(text) <= 80 else f"{text[:80]!r} and more"
