"""Read the text form of the Object File Format: header, three counts, vertices and faces, colours and normals."""

from contextlib import suppress

import numpy as np

from loewner._base._validate import Floats, Ints
from loewner.meshes.files.parts import Refusal, Tell, Triangles, check_range, cut, expect, quoted
from loewner.meshes.files.text import data_lines, floats, in_line, integers, remarks, table_of, tell_unit

# Possible counts of numbers in the line of a vertex: x y z, and possibly a normal and a colour of three or four
# numbers.
_WIDTHS = {b"OFF": (3,), b"NOFF": (6,), b"COFF": (6, 7), b"CNOFF": (9, 10)}

# Possible numbers of values in a face's colour: none, an index into a table, red green blue, and alpha as well.
_COLOURS = (0, 1, 3, 4)


def read(data: bytes, tell: Tell) -> tuple[Floats, Triangles]:
    """Read vertices as stored, and polygons as triangles."""
    tell_unit(remarks(data), tell)
    lines, numbers = data_lines(data, b"#")
    word = lines[0][0] if lines else b""
    expect(word in _WIDTHS, f"expected an OFF file, found one that begins with {quoted(word)}")
    if len(lines[0]) == 1:
        lines, numbers = lines[1:], numbers[1:]
    else:
        lines[0] = lines[0][1:]
    expect(lines and len(lines[0]) == 3, "expected counts of vertices, faces and edges after OFF, found none")
    v, f, _ = (int(count) for count in in_line(numbers[0], integers, lines[0]))
    expect(v >= 0 and f >= 0, f"expected counts of vertices and faces, found {v} and {f}", numbers[0])
    expect(len(lines) == 1 + v + f, f"expected {v + f} lines of {v} vertices and {f} faces, found {len(lines) - 1}")
    points = np.empty((v, 3))
    if v:
        width, widths = len(lines[1]), _WIDTHS[word]
        expect(width in widths, f"expected a vertex of {widths[0]} numbers, found {width}", numbers[1])
        wanted = f"a vertex of {width} numbers as the first"
        points = table_of(lines[1 : 1 + v], numbers[1 : 1 + v], width, wanted)[:, :3].copy()
    corners, sizes = _faces(lines[1 + v :], numbers[1 + v :], v)
    return points, cut(points, corners, sizes, tell, lambda k: f"line {numbers[1 + v + k]}")


def _faces(faces: list[list[bytes]], numbers: list[int], count: int) -> tuple[Ints, Ints]:
    """Read the corners of all faces, concatenated, and the number of corners of each face."""
    with suppress(Refusal):  # the refusal is reported below, with its line
        sizes = integers([line[0] for line in faces])
        if all(len(line) == size + 1 >= 4 for line, size in zip(faces, sizes.tolist(), strict=True)):
            corners = integers([word for line in faces for word in line[1:]])
            check_range(corners, count, "a face")
            return corners, sizes
    parts = [_face(line, number, count) for line, number in zip(faces, numbers, strict=True)]
    return np.concatenate(parts), np.array(list(map(len, parts)), dtype=np.int64)


def _face(line: list[bytes], number: int, count: int) -> Ints:
    """Read the corners of one face, which may have a colour."""
    size = int(in_line(number, integers, line[:1])[0])
    expect(size >= 3, f"expected a face of at least 3 corners, found {size}", number)
    message = f"expected a face of {size} corners, perhaps with a colour, found {len(line) - 1} numbers"
    expect(len(line) - 1 - size in _COLOURS, message, number)
    corners = in_line(number, integers, line[1 : 1 + size])
    check_range(corners, count, "a face", number)
    in_line(number, floats, line[1 + size :])
    return corners
