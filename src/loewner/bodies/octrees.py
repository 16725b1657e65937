"""Read OctoMap octrees from binary files, as the boxes of their occupied leaves.

The format is simple: a text header is followed by two bytes for each inner node, in depth-first order, with two bits
per child. OctoMap's own reader is not used: it recurses as deeply as a file demands, so a damaged file can crash the
process.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._files import read_regular, shown
from loewner._base._validate import Floats, Ints
from loewner.errors import FileError, GeometryError

# Largest size of a file in bytes. A building at a resolution of one centimetre takes a tenth of this size.
MOST_BYTES = 2**30

# The binary data begins after the first line feed that follows "data", even if the data's first bytes look like white
# space.
HEADER = re.compile(
    rb"# Octomap OcTree binary file\s*\n(?:#[^\n]*\n)*id OcTree\s*\nsize (\d+)\s*\nres ([-+.\deE]+)\s*\ndata[ \t\r]*\n"
)

LEVELS = 16  # the depth of an OctoMap tree, whose keys have 16 bits per axis

# Values of a child's two bits. The remaining values are 1 for a free child, and 0 for an absent child.
OCCUPIED, INNER = 2, 3


def occupied_leaves(path: str | os.PathLike[str]) -> tuple[Floats, Floats]:
    """Read the lower and upper corners, shape (n, 3) each, of the occupied leaves of a `.bt` file.

    Raises
    ------
    FileError
        If the file is missing, or not a complete octree of at most 16 levels.
    GeometryError
        If no cell of the octree is occupied.
    """
    file = _validate.path(path, "path")
    data = read_regular(file, "an octree in .bt", MOST_BYTES)
    header = HEADER.match(data)
    if header is None:
        raise FileError(
            f"{shown(file)}: expected an octree of OctoMap in .bt, which begins with '# Octomap OcTree binary file' "
            "and lines with id, size, res and data; found another beginning"
        )
    count, resolution = int(header[1]), _resolution(header[2], file)
    nodes = np.frombuffer(data, dtype="<u2", offset=header.end(), count=(len(data) - header.end()) // 2)
    keys, depths = _leaves(nodes, count, len(data) - header.end(), file)
    if len(keys) == 0:
        raise GeometryError(f"{shown(file)}: expected at least one occupied leaf, found none")
    levels = np.arange(LEVELS)
    cell = np.stack([((keys[:, None] >> (3 * levels + axis) & 1) << levels).sum(axis=1) for axis in range(3)], axis=1)
    edge = resolution * 2.0 ** (LEVELS - depths)[:, None]
    center = ((cell - 2 ** (LEVELS - 1)) * 2.0 ** (depths - LEVELS)[:, None] + 0.5) * edge
    return center - edge / 2, center + edge / 2


def _resolution(text: bytes, file: Path) -> float:
    """Read the edge length of the smallest cells, in metres."""
    try:
        resolution = float(text)
    except ValueError:
        resolution = math.nan
    if not 0 < resolution < math.inf:
        raise FileError(f"{shown(file)}: expected res, a length in metres, found {text.decode()!r}")
    return resolution


def _leaves(nodes: NDArray[np.uint16], count: int, size: int, file: Path) -> tuple[Ints, Ints]:
    """List the occupied leaves: the key of the lower corner, with three bits per level, and the depth.

    Raises
    ------
    FileError
        If the data ends too early or too late, the number of nodes differs from the header, or a node is deeper than 16
        levels.
    """
    leaves: list[tuple[int, int]] = []
    children_by_word: dict[int, tuple[int, list[int], list[int]]] = {}
    stack, used, seen = [(0, 0)], 0, 1 if count else 0
    words = nodes.tolist()
    while stack and count:
        key, depth = stack.pop()
        if used == len(words):
            raise FileError(f"{shown(file)}: expected a whole octree of OctoMap, found one that is cut off")
        if depth == LEVELS:
            raise FileError(f"{shown(file)}: expected an octree of {LEVELS} levels, found one that is deeper")
        word, used = words[used], used + 1
        step = 3 * (LEVELS - 1 - depth)
        if word not in children_by_word:
            children_by_word[word] = _children(word)
        children, occupied, inner = children_by_word[word]
        seen += children
        leaves += [(key | child << step, depth + 1) for child in occupied]
        stack += [(key | child << step, depth + 1) for child in inner]
    if seen != count or 2 * used != size:
        wanted = f"an octree with {count} nodes in {2 * used} bytes"
        raise FileError(f"{shown(file)}: expected {wanted}, found {seen} in {size}: it is cut off or altered")
    rows = np.array(sorted(leaves), dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _children(word: int) -> tuple[int, list[int], list[int]]:
    """Return a node's number of children, its occupied leaves, and its inner nodes in reverse order."""
    kinds = [word >> 2 * child & 3 for child in range(8)]
    occupied = [child for child, kind in enumerate(kinds) if kind == OCCUPIED]
    return 8 - kinds.count(0), occupied, [child for child in range(7, -1, -1) if kinds[child] == INNER]
