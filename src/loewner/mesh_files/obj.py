"""Wavefront OBJ: `v` and `f` lines; groups, materials, normals and texture coordinates are passed over."""

import re
from collections.abc import Iterator
from itertools import chain

import numpy as np

from loewner._check import Floats
from loewner.mesh_files.parts import (
    Integers,
    Refusal,
    Triangles,
    expect,
    fans,
    floats,
    integers,
    is_float,
    is_integer,
    quoted,
)

# Bytes whose words are taken apart at a time; they take some twenty times as much memory.
BLOCK = 1 << 23

# Lines that say nothing of the surface. What is not here nor understood is refused: it may be a damaged `v`, and with
# that line left out all vertices behind it would be others.
_PASSED_OVER = frozenset(
    b"vt vn vp g o s mg l p usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj".split()
)
_CORNER = re.compile(rb"[+-]?[0-9]+(?:/[+-]?[0-9]*){0,2}")

# x y z; with a weight; with a colour; with both.
_WIDTHS = (3, 4, 6, 7)


def read(data: bytes) -> tuple[Floats, Triangles]:
    """Vertices as stored; polygons become fans."""
    points: list[Floats] = []
    corners: list[Integers] = []
    sizes: list[Integers] = []
    lines: list[Integers] = []
    width = 0
    total = 0
    for first, block in _blocks(_plain(data)):
        words = [line.split() for line in block]
        vertex_lines, face_lines, numbers, seen = [], [], [], []
        for number, line in enumerate(words, first):
            if not line:
                continue
            if line[0] == b"v":
                width = width or len(line) - 1
                if len(line) != width + 1 or width not in _WIDTHS:
                    asked = f"{width} numbers as in the lines before" if width in _WIDTHS else "3, 4, 6 or 7 numbers"
                    raise Refusal(f"expected a vertex of {asked}, found {len(line) - 1}", number)
                vertex_lines.append(line)
            elif line[0] == b"f":
                expect(len(line) >= 4, f"expected a face of at least 3 corners, found {len(line) - 1}", number)
                face_lines.append(line)
                numbers.append(number)
                seen.append(total + len(vertex_lines))
            elif line[0] not in _PASSED_OVER:
                raise Refusal(f"expected a line of an OBJ file, found one that begins with {quoted(line[0])}", number)
        if vertex_lines:
            points.append(_coordinates(vertex_lines, width, words, first))
            total += len(vertex_lines)
        if face_lines:
            sizes.append(np.array(list(map(len, face_lines)), dtype=np.int64) - 1)
            lines.append(np.array(numbers, dtype=np.int64))
            corners.append(_corners(face_lines, numbers, np.repeat(seen, sizes[-1])))
    vertices = np.concatenate(points) if points else np.empty((0, 3))
    if not corners:
        return vertices, np.empty((0, 3), dtype=np.int64)
    all_corners, all_sizes = np.concatenate(corners), np.concatenate(sizes)
    if all_corners.max() >= total:
        k = int(np.flatnonzero(all_corners >= total)[0])
        where = int(np.repeat(np.concatenate(lines), all_sizes)[k])
        raise Refusal(f"expected a face of vertices 1..{total}, found {all_corners[k] + 1}", where)
    return vertices, fans(all_corners, all_sizes)


def _plain(data: bytes) -> bytes:
    """The same text with plain line ends and continued lines joined; all other lines keep their numbers."""
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in data:
        # The line goes on in the next one; blank lines behind it keep the numbers of those that follow.
        data = re.sub(rb"(?:[^\n]*\\\n)+[^\n]*", _continued, data)
    return data


def _continued(match: re.Match[bytes]) -> bytes:
    text = match.group()
    return text.replace(b"\\\n", b" ") + b"\n" * text.count(b"\\\n")


def _blocks(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Lines without comments, some at a time, each time with the number of the first."""
    number, start = 1, 0
    while start < len(data):
        end = data.find(b"\n", start + BLOCK)
        block = data[start:] if end < 0 else data[start:end]
        lines = block.split(b"\n")
        yield number, [line.partition(b"#")[0] for line in lines] if b"#" in block else lines
        number, start = number + len(lines), start + len(block) + 1


def _coordinates(vertex_lines: list[list[bytes]], width: int, words: list[list[bytes]], first: int) -> Floats:
    flat = list(chain.from_iterable(vertex_lines))
    try:
        columns = [floats(flat[k :: width + 1]) for k in range(1, width + 1)]
    except Refusal as refusal:
        bad = next(i for i, w in enumerate(words, first) if w and w[0] == b"v" and not all(map(is_float, w[1:])))
        raise Refusal(str(refusal), bad) from None
    return np.stack(columns[:3], axis=1)


def _corners(face_lines: list[list[bytes]], numbers: list[int], seen: Integers) -> Integers:
    """Indices from 0 of the vertices that the faces name; negative ones count back from the last vertex before."""
    flat = list(chain.from_iterable(line[1:] for line in face_lines))
    if not all(map(_CORNER.fullmatch, flat)):
        for number, line in zip(numbers, face_lines, strict=True):
            for word in line[1:]:
                expect(
                    _CORNER.fullmatch(word),
                    f"expected a corner as v, v/vt, v//vn or v/vt/vn, found {quoted(word)}",
                    number,
                )
    if any(b"/" in word for word in flat):
        flat = [word.partition(b"/")[0] for word in flat]
    try:
        given = integers(flat)
    except Refusal as refusal:
        names = [[word.partition(b"/")[0] for word in line[1:]] for line in face_lines]
        bad = next(n for n, line in zip(numbers, names, strict=True) if not all(map(is_integer, line)))
        raise Refusal(str(refusal), bad) from None
    corners = np.where(given > 0, given - 1, given + seen)
    wrong = (given == 0) | (corners < 0)
    if wrong.any():
        k = int(np.flatnonzero(wrong)[0])
        where = int(np.repeat(numbers, [len(line) - 1 for line in face_lines])[k])
        raise Refusal(f"expected a vertex counted from 1, or back from -1, found {given[k]} of {seen[k]}", where)
    return corners
