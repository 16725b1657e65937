"""Read `v` and `f` lines of Wavefront OBJ; groups, materials, normals and texture coordinates are ignored."""

import re
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from loewner._base._validate import Floats, Ints
from loewner.meshes.files.parts import Refusal, Tell, Triangles, cut, expect, quoted
from loewner.meshes.files.text import floats, in_line, integers, remarks, tell_unit, with_line_feeds

# Number of bytes that are split into words at a time; the words take about twenty times as much memory.
BLOCK = 1 << 23

# Lines that do not affect the surface. Other unknown lines are refused: a line may be a damaged `v`, and omitting it
# would renumber all later vertices.
_PASSED_OVER = frozenset(
    b"vt vn vp g o s mg l p usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj".split()
)
# Kinds of lines that may continue on the next line. If other lines could continue, a comment or a name that ends in a
# backslash, such as a folder's name, would swallow a face on the next line.
_CONTINUED = (b"v", b"f")
_CORNER = re.compile(rb"[+-]?[0-9]+(?:/[+-]?[0-9]*){0,2}")

# Possible numbers of values of a vertex: x y z, x y z with a weight, with a colour, or with both.
_WIDTHS = (3, 4, 6, 7)


def read(data: bytes, tell: Tell) -> tuple[Floats, Triangles]:
    """Read vertices as stored, and polygons as triangles."""
    tell_unit(remarks(data), tell)
    points: list[Floats] = []
    faces: list[tuple[Ints, Ints, Ints]] = []  # corners, and for each face their number and its line
    total = 0
    for first, block in _blocks(_plain(data)):
        vertex_lines: list[bytes] = []
        face_lines: list[bytes] = []
        vertex_numbers: list[int] = []
        face_numbers: list[int] = []
        seen: list[int] = []
        for number, line in enumerate(block, first):
            head = line[:2]
            if head == b"vn" or head == b"vt":
                head = line[:3]  # faster than splitting, and most lines are of these four kinds
                if head == b"vn " or head == b"vt ":
                    continue
            if head != b"v " and head != b"f ":
                words = line.split(None, 1)
                if not words or words[0] in _PASSED_OVER:
                    continue
                head = words[0] + b" "
            if head == b"v ":
                vertex_lines.append(line)
                vertex_numbers.append(number)
            elif head == b"f ":
                face_lines.append(line)
                face_numbers.append(number)
                seen.append(total + len(vertex_lines))
            else:
                keyword = quoted(head.strip())
                raise Refusal(f"expected a line of an OBJ file, found one that begins with {keyword}", number)
        if vertex_lines:
            points.append(_coordinates(vertex_lines, vertex_numbers, len(points[0][0]) if points else 0))
            total += len(vertex_lines)
        if face_lines:
            flat, sizes = _words(face_lines, face_numbers)
            corners = _corners(flat, np.repeat(face_numbers, sizes), np.repeat(seen, sizes))
            faces.append((corners, sizes, np.array(face_numbers, dtype=np.int64)))
    vertices = np.concatenate(points)[:, :3].copy() if points else np.empty((0, 3))
    if not faces:
        return vertices, np.empty((0, 3), dtype=np.int64)
    corners, sizes, places = map(np.concatenate, zip(*faces, strict=True))
    if corners.max() >= total:
        k = int((corners >= total).argmax())
        where = int(np.repeat(places, sizes)[k])
        raise Refusal(f"expected a face of vertices 1..{total}, found {corners[k] + 1}", where)
    return vertices, cut(vertices, corners, sizes, tell, lambda k: f"line {places[k]}")


def _plain(data: bytes) -> bytes:
    """Return the text with plain line ends and continued lines joined; all other lines keep their numbers."""
    data = with_line_feeds(data.removeprefix(b"\xef\xbb\xbf"))
    if b"\\\n" in data:
        # A continued line is joined with the next line; blank lines follow, so that all later lines keep their numbers.
        data = re.sub(rb"(?:[^\n]*\\\n)+[^\n]*", _continued, data)
    return data


def _continued(match: re.Match[bytes]) -> bytes:
    text = match.group()
    line = text.replace(b"\\\n", b" ")
    head = line.split(None, 1)[:1]
    if not head or head[0] not in _CONTINUED or b"#" in text[: text.rindex(b"\\\n")]:
        description = f"one that begins with {quoted(b''.join(head))}" if b"#" not in text else "a comment"
        number = match.string.count(b"\n", 0, match.start()) + 1
        raise Refusal(f"expected a vertex or a face where a backslash continues a line, found {description}", number)
    return line + b"\n" * text.count(b"\\\n")


def _blocks(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Yield blocks of lines without comments, each with the number of its first line."""
    number, start = 1, 0
    while start < len(data):
        end = data.find(b"\n", start + BLOCK)
        block = data[start:] if end < 0 else data[start:end]
        lines = block.split(b"\n")
        yield number, [line.partition(b"#")[0] for line in lines] if b"#" in block else lines
        number, start = number + len(lines), start + len(block) + 1


def _coordinates(vertex_lines: list[bytes], numbers: list[int], width: int) -> Floats:
    """Read the numbers of `v` lines, one row per line, with `width` columns unless `width` is 0."""
    width = width or len(vertex_lines[0].split()) - 1
    flat = b" ".join(vertex_lines).split()
    # Each line begins with "v", which is not a number: if the lines differ in length, a "v" ends up in a column of
    # numbers.
    if width in _WIDTHS and len(flat) == len(vertex_lines) * (width + 1):
        with suppress(Refusal):  # the refusal is reported below, with its line
            return np.stack([floats(flat[k :: width + 1]) for k in range(1, width + 1)], axis=1)
    requirement = f"{width} numbers as in the lines before" if width in _WIDTHS else "3, 4, 6 or 7 numbers"
    for number, line in zip(numbers, vertex_lines, strict=True):
        words = line.split()[1:]
        expect(len(words) == width in _WIDTHS, f"expected a vertex of {requirement}, found {len(words)}", number)
        in_line(number, floats, words)
    raise Refusal("expected vertices, found something else")


def _words(face_lines: list[bytes], numbers: list[int]) -> tuple[list[bytes], Ints]:
    """Return the corners of all faces, concatenated, and the number of corners of each face."""
    sizes = np.fromiter((len(line.split()) for line in face_lines), dtype=np.int64, count=len(face_lines)) - 1
    if sizes.min() < 3:
        k = int(np.argmax(sizes < 3))
        raise Refusal(f"expected a face of at least 3 corners, found {sizes[k]}", numbers[k])
    if (sizes == sizes[0]).all():
        flat = b" ".join(face_lines).split()
        del flat[:: sizes[0] + 1]
        return flat, sizes
    return [word for line in face_lines for word in line.split()[1:]], sizes


def _corners(flat: list[bytes], numbers: Ints, seen: Ints) -> Ints:
    """Return zero-based indices of the faces' vertices; negative indices in a file count back from the last vertex."""
    if b"/" in b"".join(flat):
        for k, word in enumerate(flat):
            if not _CORNER.fullmatch(word):
                raise Refusal(f"expected a corner as v, v/vt, v//vn or v/vt/vn, found {quoted(word)}", int(numbers[k]))
        flat = [word.partition(b"/")[0] for word in flat]
    try:
        indices = integers(flat)
    except Refusal:
        for number, word in zip(numbers.tolist(), flat, strict=True):
            in_line(number, integers, [word])
        raise
    corners = np.where(indices > 0, indices - 1, indices + seen)
    wrong = (indices == 0) | (corners < 0)
    if wrong.any():
        k = int(np.argmax(wrong))
        where = int(numbers[k])
        raise Refusal(f"expected a vertex counted from 1, or back from -1, found {indices[k]} of {seen[k]}", where)
    return corners
