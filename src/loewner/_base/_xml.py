"""XML as a tree of elements that record which parts were requested, so that a reader can list the unread parts."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from typing import Any, NoReturn, Self, TypeVar
from xml.parsers import expat

from loewner._base._memory import uncollected

E = TypeVar("E", bound="Element")

# Names of Python's codecs for the multibyte encodings that expat does not decode. All other names are left to expat,
# since some codecs do more than decode.
_MULTIBYTE = frozenset(
    ["gb2312", "gbk", "gb18030", "big5", "cp950", "shift_jis", "cp932", "euc_jp", "iso2022_jp", "euc_kr", "cp949"]
)
_DECLARED = re.compile(rb"""<\?xml\s[^>]*?\sencoding\s*=\s*["']([A-Za-z][A-Za-z0-9._-]*)["']""")


class XmlError(ValueError):
    """A file is not XML, or has content that its reader excludes; the message has the expected and the found content.

    Attributes
    ----------
    line : int
        The line of the content that was found.
    """

    def __init__(self, expected: str, found: str, line: int) -> None:
        super().__init__(f"expected {expected}, found {found}")
        self.line = line


class Element:
    """An element; its methods record which children and attributes were requested.

    Attributes
    ----------
    tag : str
        Name with its prefix, or without its prefix if the parser strips namespaces.
    namespace : str
        Address to which the prefix is bound at this place, or the default namespace; empty if neither exists.
    attributes : dict of str to str
    children : list of Element
    texts : list of str
        Pieces of text outside the children; empty unless the parser keeps texts.
    line : int
        Line of the file in which the element begins.
    """

    __slots__ = ("_asked", "attributes", "children", "line", "namespace", "tag", "texts")

    def __init__(self, tag: str, attributes: dict[str, str], line: int, namespace: str = "") -> None:
        self.tag, self.attributes, self.line, self.namespace = tag, attributes, line, namespace
        self.children: list[Self] = []
        self.texts: list[str] = []
        self._asked: set[str] | None = None  # tags, and "@" with names of attributes; made when first needed

    def all(self, tag: str) -> list[Self]:
        """Return the children with this tag."""
        self._ask(tag)
        return [child for child in self.children if child.tag == tag]

    def one(self, tag: str) -> Self | None:
        """Return the child with this tag, or None; two such children are an error."""
        children = self.all(tag)
        if len(children) > 1:
            children[1].fault(f"one <{tag}> in <{self.tag}>", f"another one in line {children[0].line}")
        return children[0] if children else None

    def the(self, tag: str) -> Self:
        """Return the only child with this tag; an error if there is none, or more than one."""
        child = self.one(tag)
        if child is None:
            self.fault(f"a <{tag}> in <{self.tag}>", "none")
        return child

    def get(self, name: str) -> str | None:
        """Return an attribute, or None."""
        self._ask("@" + name)
        return self.attributes.get(name)

    def _ask(self, name: str) -> None:
        if self._asked is None:
            self._asked = set()
        self._asked.add(name)

    def fault(self, expected: str, found: str) -> NoReturn:
        """Raise an error about this element; readers override this method to raise their own errors."""
        raise XmlError(expected, found, self.line)

    def disown(self, *names: str) -> None:
        """Mark parts as unread again: tags, and "@" with names of attributes."""
        if self._asked is not None:
            self._asked.difference_update(names)

    def unread(
        self, harmless: Mapping[str, AbstractSet[str]], telling: AbstractSet[str] = frozenset()
    ) -> Iterator[tuple[Self, str]]:
        """Yield the elements, attributes and texts in this element that were never requested, in the file's order.

        Parameters
        ----------
        harmless : mapping of str to set of str
            Maps the tag of an element to parts that may be ignored: tags of children, and "@" with names of attributes.
            Nothing inside such a child is reported, unless its tag ends in "*" here: elements inside it are then
            reported if their tags are in `telling` and they have children themselves.
        telling : set of str, optional
            Tags of elements.

        Yields
        ------
        element : Element
            The unread element, or the element with the unread attribute; its `line` gives the place.
        name : str
            Words for messages, such as "<colision> in <link>", or "<limit min>" for an attribute.
        """
        requested: AbstractSet[str] = self._asked or frozenset()
        passed_over = harmless.get(self.tag, frozenset())
        for name in self.attributes:
            is_known = f"@{name}" in requested or f"@{name}" in passed_over
            if not is_known and not name.startswith(("xmlns", "xml:")):
                yield self, f"<{self.tag} {name}>"
        if "".join(self.texts).strip():
            yield self, f"text in <{self.tag}>"
        for child in self.children:
            if f"{child.tag}*" in passed_over:
                yield from child._inside(child.tag, telling)
            elif child.tag in passed_over:
                continue
            elif child.tag in requested:
                yield from child.unread(harmless, telling)
            else:
                yield child, f"<{child.tag}> in <{self.tag}>"

    def _inside(self, tag: str, telling: AbstractSet[str]) -> Iterator[tuple[Self, str]]:
        for child in self.children:
            if child.tag in telling and child.children:
                yield child, f"<{child.tag}> in <{tag}>"
            else:
                yield from child._inside(tag, telling)


def parse(
    data: bytes | str,
    what: str,
    make: Callable[[str, dict[str, str], int, str], E],
    *,
    deepest: int,
    most: int,
    texts: bool = False,
    doctype: bool = True,
    strip: bool = False,
) -> E:
    """Parse a file, and return its root element.

    Parameters
    ----------
    data : bytes or str
        The contents of the file. A string has already been decoded, so the encoding declared in its first line has no
        effect.
    what : str
        The expected kind of file, with an article, for messages.
    make : callable
        Makes an element from its tag, attributes, line and namespace.
    deepest, most : int
        Limits on the nesting and on the number of elements. The caller limits the number of bytes.
    texts : bool, optional
        Whether to keep the text between tags.
    doctype : bool, optional
        Whether a document type is allowed. Declarations of entities are never allowed, since entities can expand to
        more text than memory holds, or to other files.
    strip : bool, optional
        Whether to strip the namespaces from the tags, in which case prefixes must be declared.

    Raises
    ------
    XmlError
        If the data are not XML, or exceed a limit.
    """
    parser = expat.ParserCreate(namespace_separator="}" if strip else None)
    parser.buffer_text, parser.buffer_size = True, 1 << 20
    path = [make("", {}, 0, "")]
    scopes: list[dict[str, str]] = [{}]  # namespaces by prefix, for the document and the open elements
    names: dict[str, tuple[str, str]] = {}  # maps names in the file to their tags and namespaces
    total = 0

    def refuse(found: str) -> NoReturn:
        raise XmlError(what, found, parser.CurrentLineNumber)

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal total
        total += 1
        if len(path) > deepest:
            refuse(f"more than {deepest} elements inside each other")
        if total > most:
            refuse(f"more than {most} elements")
        if strip:
            if name not in names:
                namespace, _, tag = name.rpartition("}")
                names[name] = tag, namespace
            tag, namespace = names[name]
        else:
            # The default namespace has the prefix "".
            declared = {key[6:]: value for key, value in attributes.items() if key[:6] in ("xmlns", "xmlns:")}
            scope = scopes[-1] | declared if declared else scopes[-1]
            scopes.append(scope)
            tag, namespace = name, scope.get(name.rpartition(":")[0], "") if scope else ""
        element = make(tag, attributes, parser.CurrentLineNumber, namespace)
        path[-1].children.append(element)
        path.append(element)

    def end(_: str) -> None:
        path.pop()
        if not strip:
            scopes.pop()

    def entity(name: str, *_: Any) -> None:
        refuse(f"the declaration of an entity, {name[:40]!r}")

    parser.StartElementHandler, parser.EndElementHandler, parser.EntityDeclHandler = start, end, entity
    if texts:
        parser.CharacterDataHandler = lambda words: path[-1].texts.append(words)
    if not doctype:
        parser.StartDoctypeDeclHandler = lambda *_: refuse("a document type, which may declare entities")
    try:
        with uncollected():
            parser.Parse(_decoded(data), True)
    except XmlError:
        raise
    except expat.ExpatError as error:
        raise XmlError(what, f"broken XML ({expat.ErrorString(error.code) or error})", error.lineno) from None
    except (ValueError, LookupError, MemoryError) as error:  # the encoding is unknown, too large, or violated
        raise XmlError(what, f"broken XML ({error})", 1) from None
    return path[0].children[0]


def _decoded(data: bytes | str) -> bytes | str:
    """Decode bytes if expat lacks their declared encoding."""
    declared = _DECLARED.match(data) if isinstance(data, bytes) else None
    if declared is None:
        return data
    codec = codecs.lookup(declared[1].decode()).name
    return data.decode(codec) if codec in _MULTIBYTE and isinstance(data, bytes) else data
