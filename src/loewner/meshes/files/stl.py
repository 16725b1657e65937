"""Read STL files, binary or text: triangles, each with its own corners."""

import struct

import numpy as np

from loewner._base._validate import Floats
from loewner.meshes.files.parts import Refusal, Tell, Triangles, expect, quoted
from loewner.meshes.files.text import data_lines, floats, in_line, plain_lines, tell_unit

HEADER, FACET = 84, 50  # bytes
FACETS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

# Lines of a facet in text: the beginning of each, and the number of words that follow. A normal may be any three words:
# for a triangle without area, C libraries write NaN in many ways.
_VERTEX = (b"vertex",)
_LINES = (
    ((b"facet", b"normal"), 3),
    ((b"outer", b"loop"), 0),
    (_VERTEX, 3),
    (_VERTEX, 3),
    (_VERTEX, 3),
    ((b"endloop",), 0),
    ((b"endfacet",), 0),
)


def read(data: bytes, tell: Tell) -> tuple[Floats, Triangles]:
    """Read three vertices per triangle, in the file's order; the file's normals are ignored."""
    count = struct.unpack("<I", data[80:84])[0] if len(data) >= HEADER else 0
    if len(data) >= HEADER and len(data) == HEADER + FACET * count:
        tell_unit(data[:80], tell)
        corners = np.frombuffer(data, FACETS, offset=HEADER)["corners"].astype(np.float64)
    elif data[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        tell_unit(data.lstrip()[:512].splitlines()[0], tell)  # a unit may follow the name of the first solid
        corners = _text(data)
    else:  # a binary file's header may also begin with "solid"
        description = f"{len(data)} bytes, although its header states {HEADER + FACET * count}"
        raise Refusal(f"expected an STL mesh, found {description if len(data) >= HEADER else 'no header'}")
    return corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int64).reshape(-1, 3)


def _text(data: bytes) -> Floats:
    """Read the corners of all facets of all solids in a text file."""
    lines = [line for line in map(bytes.strip, plain_lines(data.lower())) if line]
    begins = [i for i, line in enumerate(lines) if line.startswith(b"solid") and line.split()[0] == b"solid"]
    ends = [i for i, line in enumerate(lines) if line.startswith(b"endsolid") and line.split()[0] == b"endsolid"]
    expect(ends and ends[-1] == len(lines) - 1, "expected a whole text STL, found one cut before its endsolid")
    follows = len(begins) == len(ends) and begins == [0, *(i + 1 for i in ends[:-1])]
    expect(follows, "expected solids, each from solid to endsolid, found these words elsewhere")
    if any((last - first - 1) % len(_LINES) for first, last in zip(begins, ends, strict=True)):
        _refuse_first(data, begins, ends)
    inside = [line for first, last in zip(begins, ends, strict=True) for line in lines[first + 1 : last]]
    corners = []
    for k, (words, count) in enumerate(_LINES):
        mine = inside[k :: len(_LINES)]
        flat, size = b" ".join(mine).split(), len(words) + count
        # The keywords are not numbers: if the lines differ in length, keywords end up in columns of numbers.
        if len(flat) != size * len(mine) or any(set(flat[j::size]) - {word} for j, word in enumerate(words)):
            _refuse_first(data, begins, ends)
        if words == _VERTEX:
            try:
                corners.append(np.stack([floats(flat[j::size]) for j in range(1, size)], axis=1))
            except Refusal:
                _refuse_first(data, begins, ends)
    return np.stack(corners, axis=1)


def _refuse_first(data: bytes, begins: list[int], ends: list[int]) -> None:
    """Refuse a file and name its first malformed line."""
    lines, numbers = data_lines(data)
    for first, last in zip(begins, ends, strict=True):
        for i in range(first + 1, last):
            words, count = _LINES[(i - first - 1) % len(_LINES)]
            line, requirement = lines[i], b" ".join(words).decode() + (f" and {count} numbers" if count else "")
            right = len(line) == len(words) + count and all(a.lower() == b for a, b in zip(line, words, strict=False))
            expect(right, f"expected {requirement}, found {quoted(b' '.join(line))}", numbers[i])
            if words == _VERTEX:
                in_line(numbers[i], floats, line[1:])
        expect((last - first - 1) % len(_LINES) == 0, "expected a whole facet, found endsolid", numbers[last])
    raise Refusal("expected a text STL, found something else")
