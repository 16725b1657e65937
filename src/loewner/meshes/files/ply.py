"""Read the Polygon File Format: a header that declares elements, and the elements' content, text or binary."""

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loewner._base._validate import Floats, Ints
from loewner.meshes.files.parts import Refusal, Tell, Triangles, check_range, cut, expect, quoted
from loewner.meshes.files.text import data_lines, floats, in_line, integers, refuse_line, table_of, tell_unit

_KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
_TYPES = {
    **dict(zip(("char", "uchar", "short", "ushort", "int", "uint", "float", "double"), _KINDS, strict=True)),
    **dict(zip(("int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"), _KINDS, strict=True)),
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COMMENTS = (b"comment", b"obj_info")
_CORNERS = ("vertex_indices", "vertex_index")

# Elements whose lists are not polygons. Lists of any other element except vertex and face, such as tristrips, may be
# polygons.
_HARMLESS = ("multi_texture_face",)  # corners in a texture

# Limits on the length of a header's line [bytes] and on the properties of an element. Scanners write about twenty.
HEADER_LINE, MOST_PROPERTIES = 1 << 16, 1000


@dataclass
class _Property:
    name: str
    type: str
    length: str | None = None  # type of a list's length


@dataclass
class _Element:
    name: str
    count: int
    line: int
    properties: list[_Property] = field(default_factory=list)

    def has(self, *names: str) -> bool:
        return set(names) <= {p.name for p in self.properties if p.length is None}


def _no_integers() -> Ints:
    return np.empty(0, dtype=np.int64)


@dataclass
class _Content:
    """The content of an element: its scalars, and its lists of corners in concatenated form."""

    scalars: dict[str, Any]
    corners: Ints = field(default_factory=_no_integers)
    sizes: Ints = field(default_factory=_no_integers)


def read(data: bytes, tell: Tell) -> tuple[Floats, Triangles]:
    """Read vertices as stored, and polygons as triangles."""
    order, elements, start = _header(data)
    tell_unit(b"\n".join(line for line in data[:start].split(b"\n") if line.startswith(_COMMENTS)), tell)
    vertex, face = ([k for k, e in enumerate(elements) if e.name == name] for name in ("vertex", "face"))
    right = len(vertex) == 1 and elements[vertex[0]].has("x", "y", "z")
    expect(right, "expected one element vertex with x, y and z")
    expect(len(face) <= 1, f"expected one element face, found {len(face)}")
    for other in elements:
        lists = any(p.length is not None for p in other.properties)
        polygons = lists and other.count and other.name not in ("vertex", "face", *_HARMLESS)
        expect(not polygons, f"expected faces, found lists in {quoted(other.name)}, which are not read", other.line)
    contents = _text(data, start, elements) if not order else _binary(data, start, elements, order)
    xyz = contents[vertex[0]].scalars
    points = np.stack([np.asarray(xyz[k], dtype=np.float64) for k in "xyz"], axis=1)
    if not face:
        return points, np.empty((0, 3), dtype=np.int64)
    corners, sizes = contents[face[0]].corners, contents[face[0]].sizes
    if sizes.min(initial=3) < 3:
        k = int(np.argmax(sizes < 3))
        raise Refusal(f"face {k}: expected at least 3 corners, found {sizes[k]}")
    check_range(corners, len(points), "a face")
    return points, cut(points, corners, sizes, tell, lambda k: f"face {k}")


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Read the header: byte order ("" for text), elements, and the position at which the header ends."""
    order: str | None = None
    elements: list[_Element] = []
    position, number = 0, 0
    while True:
        end = data.find(b"\n", position, position + HEADER_LINE)
        expect(end >= 0, "expected the header of a PLY file with its end_header, found none", number + 1)
        words = data[position:end].decode("latin-1").split()
        position, number = end + 1, number + 1
        if number == 1:
            expect(words == ["ply"], f"expected ply, found {quoted(' '.join(words))}", 1)
        elif not words or words[0].encode() in _COMMENTS:
            continue
        elif words[0] == "format" and order is None and len(words) == 3:
            order = _FORMATS.get(words[1]) if words[2] == "1.0" else None
            expect(order is not None, f"expected a format of PLY 1.0, found {words[1:]}", number)
        elif words[0] == "element" and len(words) == 3:
            expect(words[2].isascii() and words[2].isdigit() and len(words[2]) < 16, "expected a count", number)
            elements.append(_Element(words[1], int(words[2]), number))
        elif words[0] == "property" and elements:
            added, others = _property(words[1:], number), elements[-1].properties
            taken = {p.name for p in others}
            expect(len(others) < MOST_PROPERTIES, f"expected at most {MOST_PROPERTIES} properties, found more", number)
            expect(added.name not in taken, f"expected {quoted(added.name)} once, found it twice", number)
            others.append(added)
        elif words == ["end_header"]:
            break
        else:
            raise Refusal(f"expected a line of a PLY header, found {quoted(' '.join(words))}", number)
    if order is None:
        raise Refusal("expected a line with the format in the header, found none")
    for element in elements:
        lists = [p for p in element.properties if p.name in _CORNERS and p.length is not None]
        if element.name == "face" and not (len(lists) == 1 and lists[0].type[0] in "iu"):
            raise Refusal("expected a face with one list of whole numbers, vertex_indices", element.line)
    return order, elements, position


def _property(words: list[str], number: int) -> _Property:
    """Read the words of a property in a line of the header."""
    kinds = [_TYPES.get(word, "") for word in words]
    if len(words) == 4 and words[0] == "list" and kinds[1] and kinds[2] and kinds[1][0] != "f":
        return _Property(words[3], kinds[2], kinds[1])
    expect(len(words) == 2 and kinds[0], f"expected a property, found {quoted(' '.join(words))}", number)
    return _Property(words[1], kinds[0])


# -- text ---------------------------------------------------------------------------------------


def _text(data: bytes, start: int, elements: list[_Element]) -> list[_Content]:
    lines, numbers = data_lines(data[start:])
    before = data.count(b"\n", 0, start)
    numbers = [n + before for n in numbers]
    # The lines of an element without properties are empty, and not included here.
    wanted = [e.count if e.properties else 0 for e in elements]
    expect(len(lines) == sum(wanted), f"expected {sum(wanted)} lines as its header says, found {len(lines)}")
    contents, first = [], 0
    for element, count in zip(elements, wanted, strict=True):
        contents.append(_text_element(element, lines[first : first + count], numbers[first : first + count]))
        first += count
    return contents


def _text_element(element: _Element, lines: list[list[bytes]], numbers: list[int]) -> _Content:
    """Read an element in text; lines are split one by one only if the element has lists."""
    properties = element.properties
    scalars: dict[str, Any] = {p.name: np.empty(0) for p in properties if p.length is None}
    if not any(p.length for p in properties):
        table = table_of(lines, numbers, len(properties), f"{len(properties)} numbers for a {element.name}")
        return _Content(dict(zip(scalars, table.T, strict=True)))
    if len(properties) == 1 and lines and len(set(map(len, lines))) == 1 and properties[0].name in _CORNERS:
        with suppress(Refusal):  # the refusal is reported below, with its line
            lengths = integers([line[0] for line in lines])
            if (lengths == len(lines[0]) - 1).all():
                return _Content({}, integers([word for line in lines for word in line[1:]]), lengths)
    corners: list[bytes] = []
    sizes: list[int] = []
    columns: dict[str, list[bytes]] = {name: [] for name in scalars}
    for line, number in zip(lines, numbers, strict=True):
        k = 0
        for p in properties:
            expect(k < len(line), f"expected more numbers for a {element.name}, found {len(line)}", number)
            if p.length is None:
                columns[p.name].append(line[k])
                k += 1
                continue
            size, left = int(in_line(number, integers, line[k : k + 1])[0]), len(line) - k - 1
            expect(0 <= size <= left, f"expected a list of {size} numbers, found {left}", number)
            values = line[k + 1 : k + 1 + size]
            if p.name in _CORNERS:
                corners.extend(values)
                sizes.append(size)
            else:
                in_line(number, floats, values)
            k += 1 + size
        expect(k == len(line), f"expected {k} numbers for this {element.name}, found {len(line)}", number)
    try:
        for name, column in columns.items():
            scalars[name] = floats(column)
        return _Content(scalars, integers(corners), np.array(sizes, dtype=np.int64))
    except Refusal as refusal:
        refuse_line(lines, numbers)
        raise Refusal(f"{element.name}: {refusal}") from None


# -- binary -------------------------------------------------------------------------------------


def _binary(data: bytes, start: int, elements: list[_Element], order: str) -> list[_Content]:
    contents = []
    for element in elements:
        content, start = _binary_element(element, data, start, order)
        contents.append(content)
    expect(len(data) == start, f"expected {start} bytes as its header says, found {len(data)}")
    return contents


def _binary_element(element: _Element, data: bytes, start: int, order: str) -> tuple[_Content, int]:
    """Read a binary element, and return where it ends; if its lists differ in length, rows are read one by one."""
    count = element.count
    if not count or not element.properties:
        return _Content({p.name: np.empty(0) for p in element.properties if p.length is None}), start
    row = _layout(element, data, start, order)
    if row is None:
        raise Refusal(f"element {element.name}: expected {count} of them as its header says, found the file's end")
    size = sum(np.dtype(kind).itemsize * (1 if length is None else length) for _, kind, length in row)
    room = size * count <= len(data) - start
    if not any(p.length for p in element.properties):
        expect(room, f"element {element.name}: expected {count} of {size} bytes each, found the file's end")
    if room:
        dtype = np.dtype([(f"{k}", kind, () if n is None else (n,)) for k, (_, kind, n) in enumerate(row)])
        table = np.frombuffer(data, dtype, count=count, offset=start)
        lengths = [(k, row[k + 1][2]) for k, (name, _, _) in enumerate(row) if name is None]
        if all((table[f"{k}"] == length).all() for k, length in lengths):
            scalars = {name: table[f"{k}"] for k, (name, _, n) in enumerate(row) if name is not None and n is None}
            content = _Content(scalars)
            for k, (name, _, n) in enumerate(row):
                if n is not None and name in _CORNERS:
                    corners = table[f"{k}"].astype(np.int64).reshape(-1)
                    content = _Content(scalars, corners, np.full(count, n, dtype=np.int64))
            return content, start + size * count
    return _binary_rows(element, data, start, order)


def _layout(element: _Element, data: bytes, start: int, order: str) -> list[tuple[str | None, str, int | None]] | None:
    """Return name, type and length of the first row's fields, in order; the length field of a list has no name."""
    row: list[tuple[str | None, str, int | None]] = []
    for p in element.properties:
        kind = order + p.type
        if p.length is not None:
            length = order + p.length
            if start + np.dtype(length).itemsize > len(data):
                return None
            size = int(np.frombuffer(data, length, count=1, offset=start)[0])
            if not 0 <= size <= len(data):
                return None
            row += [(None, length, None), (p.name, kind, size)]
            start += np.dtype(length).itemsize + size * np.dtype(kind).itemsize
        else:
            row.append((p.name, kind, None))
            start += np.dtype(kind).itemsize
    return row if start <= len(data) else None


def _binary_rows(element: _Element, data: bytes, start: int, order: str) -> tuple[_Content, int]:
    """Read rows one by one, since their lists differ in length."""
    little = "little" if order == "<" else "big"
    parts = [
        (p.name, order + p.type, int(p.type[1]), p.length and (int(p.length[1]), p.length[0] == "i"))
        for p in element.properties
    ]
    least = sum(length[0] if length else size for _, _, size, length in parts)
    room = least * element.count <= len(data) - start
    expect(room, f"expected {element.count} of {element.name}, found the file's end")
    scalars: dict[str, Any] = {name: [] for name, _, _, length in parts if not length}
    corners: list[Any] = []
    sizes: list[int] = []
    for k in range(element.count):
        for name, kind, size, length in parts:
            if not length:
                if name in "xyz":
                    expect(start + size <= len(data), f"{element.name} {k}: expected more bytes, found the file's end")
                    scalars[name].append(np.frombuffer(data, kind, count=1, offset=start)[0])
                start += size
                continue
            n = int.from_bytes(data[start : start + length[0]], little, signed=length[1])  # type: ignore[arg-type]
            start += length[0]
            fits = n >= 0 and start + n * size <= len(data)
            expect(fits, f"{element.name} {k}: expected a list of {n} numbers, found the file's end")
            if name in _CORNERS:
                corners.append(data[start : start + n * size])
                sizes.append(n)
                corner_kind = kind
            start += n * size
    expect(start <= len(data), f"expected {element.count} of {element.name}, found the file's end")
    corner_numbers = np.frombuffer(b"".join(corners), corner_kind).astype(np.int64) if corners else _no_integers()
    return _Content(scalars, corner_numbers, np.array(sizes, dtype=np.int64)), start
