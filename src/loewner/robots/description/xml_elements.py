"""Read the XML elements of robot descriptions, with line numbers for error messages."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import NoReturn

from loewner._base import _validate, _xml
from loewner._base._files import read_regular
from loewner._base._plausible import warn
from loewner._base._validate import LISTED
from loewner.errors import FileError, InputError

# Limits on a description: bytes of a file, number of elements, and depth of nesting. These limits are a hundred times
# larger than the largest known robots need.
MOST_BYTES = 2**25
MOST_ELEMENTS = 250_000
DEEPEST = 100

# Lengths, factors and offsets above LARGEST in a description are refused [m, rad, 1], so that results computed from
# thousands of such numbers are finite.
LARGEST = 1e12

# Largest number of unread parts that a message lists.
UNREAD = 8

# TO_EXPAND contains namespaces whose elements another program has to replace before a description is complete.
# UNDECLARED contains their usual prefixes, which some files use without declaring them. The address of xacro's
# namespace has had several forms.
TO_EXPAND = ("xacro", "www.w3.org/2001/xinclude")
UNDECLARED = {"xacro": "xacro", "xi": "www.w3.org/2001/xinclude"}

# Elements of xacro from the time before xacro had a prefix; as children of <robot>, they have no other meaning.
WITHOUT_PREFIX = ("include", "macro", "property")

# Elements that describe a robot, even inside another program's extension.
DESCRIBING = frozenset(("link", "joint", "collision", "mimic"))


class Element(_xml.Element):
    """An XML element, with errors that name the file and the line."""

    __slots__ = ("path",)

    def __init__(self, path: Path, tag: str, attributes: dict[str, str], line: int, namespace: str) -> None:
        super().__init__(tag, attributes, line, namespace)
        self.path = path

    def has(self, tag: str) -> bool:
        """Return whether there is a child with this tag, without marking it as read."""
        return any(child.tag == tag for child in self.children)

    def drop(self, *tags: str) -> None:
        """Remove the children with the given tags, which have no meaning here."""
        self.children = [child for child in self.children if child.tag not in tags]

    def text(self, attribute: str) -> str:
        """Return an attribute, which must exist and not be empty."""
        text = (self.get(attribute) or "").strip()
        if not text:
            self.fault(f"an attribute {attribute!r} of <{self.tag}>", "none")
        return text

    def numbers(self, attribute: str, count: int, default: str | None = None) -> list[float]:
        """Read an attribute that must contain `count` numbers; infinity is allowed, NaN is not."""
        raw_text = self.get(attribute)
        text = default if raw_text is None else raw_text
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
        """Read an attribute that must contain `count` numbers, none larger than `LARGEST`."""
        values = self.numbers(attribute, count, default)
        if not all(abs(v) <= LARGEST for v in values):
            excerpt = cut(self.attributes[attribute])
            self.fault(f"finite numbers as {attribute!r} of <{self.tag}>, none beyond {LARGEST:g}", excerpt)
        return values

    def fault(self, expected: str, found: str, kind: type[Exception] = InputError) -> NoReturn:
        """Raise an error that names the position in the file."""
        raise kind(f"{self.path}, line {self.line}: expected {expected}, found {found}")


def read_xml(path: str | os.PathLike[str], what: str, text: str | None = None) -> Element:
    """Read the root element of a robot description, from a file or a string; messages name the path in both cases."""
    if isinstance(path, str) and path.lstrip().startswith("<"):
        advice = "pass it as text=" if what == "a URDF" else "write it to a file first"
        raise InputError(f"expected a path to {what}, found XML text; {advice}")
    path = _validate.path(path, "path", wanted=f"a path to {what}")
    data = read_regular(path, what, MOST_BYTES) if text is None else _checked_text(text, what)

    prefixed: list[Element] = []

    def make(tag: str, attributes: dict[str, str], line: int, namespace: str) -> Element:
        element = Element(path, tag, attributes, line, namespace)
        if namespace or ":" in tag:
            prefixed.append(element)
        return element

    try:
        root = _xml.parse(data, what, make, deepest=DEEPEST, most=MOST_ELEMENTS, texts=True)
    except _xml.XmlError as error:
        raise FileError(f"{path}, line {error.line}: {error}") from None
    if root.tag != "robot":
        root.fault(f"{what} with the root element <robot>", f"<{root.tag}>", FileError)
    macros = [element for element in prefixed if _is_macro(element)]
    macros += [child for child in root.children if child.tag in WITHOUT_PREFIX]
    for element in sorted(macros, key=lambda macro: macro.line)[:1]:
        here = ", or let from_urdf do it (xacro_args={})" if what == "a URDF" and text is None else ""
        element.fault(what, f"the macro <{element.tag}>; run xacro on the file first{here}", FileError)
    return root


def settle(root: Element, what: str, harmless: Mapping[str, AbstractSet[str]]) -> None:
    """Warn once about all parts of a file that its reader has not read, unless they are harmless.

    Parameters
    ----------
    root : Element
    what : str
        The format, for the message.
    harmless : mapping of str to set of str
        See `_xml.Element.unread`.
    """
    lines: dict[str, list[int]] = {}
    for element, name in root.unread(harmless, DESCRIBING):
        lines.setdefault(name, []).append(element.line)
    if lines:
        places = ("" if len(at) == 1 else f", and {len(at) - 1} more times" for at in lines.values())
        named = (f"{name} (line {at[0]}{more})" for (name, at), more in zip(lines.items(), places, strict=True))
        why = f"since {what} does not define them, or gives them no meaning there"
        warn(f"{root.path}: some parts are ignored, {why}: {some(named, UNREAD)}")


def _is_macro(element: Element) -> bool:
    """Return whether xacro or XInclude would replace an element; the prefix xacro always means xacro."""
    prefix = element.tag.rpartition(":")[0]
    namespace = element.namespace or UNDECLARED.get(prefix, "")
    return prefix == "xacro" or any(part in namespace.lower() for part in TO_EXPAND)


def _checked_text(text: str, what: str) -> str:
    """Refuse a string that could not be in a file."""
    try:
        size = len(text.encode())
    except UnicodeEncodeError:
        raise InputError(f"text: expected the text of {what}, found a character that no file can have") from None
    if size > MOST_BYTES:
        raise InputError(f"text: expected {what} of at most {MOST_BYTES} bytes, found {size}")
    return text


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


def some(names: Iterable[str], most: int = LISTED) -> str:
    """Format names for messages, without repeats and limited to a readable number."""
    return _validate.some(dict.fromkeys(names), most)


def cut(text: str) -> str:
    """Shorten a string from a file for a message."""
    return repr(text) if len(text) <= 80 else f"{text[:80]!r} and more"
