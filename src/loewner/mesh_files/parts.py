"""Code shared by the readers of all formats: refuse files, read numbers from text, cut polygons into triangles."""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from loewner._matrices import image
from loewner._validate import Floats, Ints

Triangles = Ints
T = TypeVar("T", np.float64, np.int64)

# Limit on the vertices, and on the triangles, of a mesh: a file of 2 GiB holds about this many. A short file can use
# the same ones a million times.
MOST = 50_000_000


class Refusal(Exception):
    """The reason why a file is refused, with the line if it is known."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


def expect(holds: object, message: str, line: int | None = None) -> None:
    """Refuse the file unless `holds` is true."""
    if not holds:
        raise Refusal(message, line)


def quoted(token: bytes | str) -> str:
    """Make a part of a file printable and short, for a message."""
    text = token.decode("latin-1") if isinstance(token, bytes) else token
    return ascii(text if len(text) <= 40 else text[:40] + "...")


def is_float(token: bytes) -> bool:
    """Return whether `floats` accepts a token: Python's grammar without underscores."""
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token


def is_integer(token: bytes) -> bool:
    """Return whether `integers` accepts a token."""
    return token.lstrip(b"+-").isdigit() and len(token) <= 19 and token.lstrip(b"+-") in (token, token[1:])


def floats(tokens: Sequence[bytes]) -> Floats:
    """Convert tokens to numbers, 1e400 to infinity; the first token that is not a number is refused."""
    try:
        numbers = np.fromiter(map(float, tokens), dtype=np.float64, count=len(tokens))
        if b"_" not in b"".join(tokens):
            return numbers
    except ValueError:
        pass
    bad = next(token for token in tokens if not is_float(token))
    raise Refusal(f"expected a number, found {quoted(bad)}")


def integers(tokens: Sequence[bytes]) -> Ints:
    """Convert tokens to whole numbers; the first token that is no whole number, or is absurdly large, is refused."""
    try:
        numbers = np.fromiter(map(int, tokens), dtype=np.int64, count=len(tokens))
        if b"_" not in b"".join(tokens):
            return numbers
    except (ValueError, OverflowError):
        pass
    bad = next((token for token in tokens if not is_integer(token)), max(tokens, key=len, default=b""))
    raise Refusal(f"expected a whole number, found {quoted(bad)}")


def in_line(number: int, convert: Callable[[Sequence[bytes]], NDArray[T]], tokens: Sequence[bytes]) -> NDArray[T]:
    """Convert the words of a line; a refusal includes the line's number."""
    try:
        return convert(tokens)
    except Refusal as refusal:
        raise Refusal(str(refusal), number) from None


def fans(corners: Ints, sizes: Ints) -> Triangles:
    """Cut polygons into fans of triangles about their first corners; `corners` has the corners of all, concatenated."""
    count = sizes - 2
    expect(count.sum() <= MOST, f"expected at most {MOST} triangles, found {count.sum()}")
    first = np.repeat(np.cumsum(sizes) - sizes, count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)


def strip(corners: Ints) -> Triangles:
    """Return the triangles of a strip, all oriented like the first."""
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def joined(parts: Iterable[tuple[Floats, Triangles]]) -> tuple[Floats, Triangles]:
    """Join meshes into one, in which meshes with the same array of vertices share it; refuse one that is too large."""
    vertices: list[Floats] = []
    triangles: list[Triangles] = []
    starts: dict[int, int] = {}  # of the arrays in `vertices`
    v = t = 0
    for points, corners in parts:
        if id(points) not in starts:
            starts[id(points)] = v
            vertices.append(points)
            v += len(points)
        triangles.append(corners + starts[id(points)])
        t += len(corners)
        expect(v <= MOST, f"expected at most {MOST} vertices, found more")
        expect(t <= MOST, f"expected at most {MOST} triangles, found more")
    if not vertices:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    return np.concatenate(vertices), np.concatenate(triangles)


def placed(T: Floats, vertices: Floats, triangles: Triangles) -> tuple[Floats, Triangles]:
    """Move a mesh by an affine map; a mirror also reverses triangles, so that the mesh is not inside out."""
    if np.linalg.det(T[:3, :3]) < 0:
        triangles = triangles[:, ::-1]
    return image(T[:3, :3], vertices) + T[:3, 3], triangles


def check_range(corners: Ints, count: int, what: str, line: int | None = None) -> None:
    """Refuse indices outside the range from 0 to count - 1."""
    if len(corners) and (corners.min() < 0 or corners.max() >= count):
        bad = corners[(corners < 0) | (corners >= count)][0]
        raise Refusal(f"expected {what} to name vertices 0..{count - 1}, found {bad}", line)


def plain_lines(data: bytes) -> list[bytes]:
    """Split a text into lines, which end in LF, CR LF or CR."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data.split(b"\n")


def data_lines(data: bytes, comment: bytes | None = None) -> tuple[list[list[bytes]], list[int]]:
    """Return the words of all non-empty lines, and the line numbers."""
    lines = plain_lines(data)
    if comment is not None and comment in data:
        lines = [line.partition(comment)[0] for line in lines]
    words = [line.split() for line in lines]
    return [w for w in words if w], [i for i, w in enumerate(words, 1) if w]
