"""Write flat files of arrays for programs without Python; `native/capi/files.c` maps and checks such files.

A file consists of a header, a directory, and arrays. Each array starts at the beginning of a cache line. Kernels use
the arrays as they are; the reader only fills in addresses. The layout of the arrays belongs to one version of the
kernels. The header names this version, and no other version can read the file.

The header contains the text ``lwn file``, the format, the size of the file in bytes, a checksum of everything after the
checksum, the hash of the kernels' sources, and eight numbers. The first seven numbers count the arrays, the values of a
configuration, the links, the moving bodies, the static bodies, the additional packs with surfaces in parts (0 or 2),
and the surfaces; the eighth number is 0. Each row of the directory contains the type of an array (0 int64, 1 float64, 2
float32, 3 bytes), its numbers of rows and columns, and its offset in bytes.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from loewner._base import _validate
from loewner._base._files import write_atomically
from loewner._kernels import columns
from loewner._kernels._sources import source_hash
from loewner.bodies.pack import Packed, join, take
from loewner.bodies.parts import in_open_parts, in_parts
from loewner.errors import InputError

SUFFIX = ".lwn"

MAGIC, FORMAT = b"lwn file", 1
HEADER = struct.Struct("<8sQQQ64s8q")
BEHIND_CHECKSUM = 32  # bytes
LINE = columns.CACHE_LINE

TYPES = {np.dtype(np.int64): 0, np.dtype(np.float64): 1, np.dtype(np.float32): 2, np.dtype(np.uint8): 3}

# The golden ratio in 64 bits. Its multiples, made odd, are the factors of the words in the checksum.
GOLDEN = 0x9E3779B97F4A7C15

# Arrays that precede the packs. In a file that has only bodies, all arrays in this list except the names are empty.
BEFORE = (
    "names", "parent", "kind", "column", "multiplier", "offset", "constants", "limits", "joints",
    "quaternions", "link", "pairs", "margins", "order", "margin", "poses", "own", "lowered", "rules",
    "rule_margins",
)  # fmt: skip
_NO_NUMBERS = np.zeros(0)


def is_meant(path: str | os.PathLike[str]) -> bool:
    """Return whether a path names a ``.lwn`` file; return False for anything that is not a path."""
    try:
        return os.fsdecode(path).endswith(SUFFIX)
    except Exception:  # the caller's path-like object may raise any error
        return False


def save(path: str | os.PathLike[str], packed: Packed) -> None:
    """Write a file that contains only bodies, named by their indices; see `write`."""
    count = len(packed.piece_start) - 1
    packs = [packed]
    if packed.trees:
        bodies = [take(packed, np.array([k])) for k in range(count)]
        packs += [join(in_parts(bodies)), join(in_open_parts(bodies, np.ones(count, dtype=bool)))]
    write(path, [[str(k) for k in range(count)]], {}, packs, (0, 0, 0))


def write(
    path: str | os.PathLike[str],
    names: Sequence[Sequence[str]],
    arrays: dict[str, Any],
    packs: Sequence[Packed],
    counts: tuple[int, int, int],
) -> None:
    """Write a file.

    Parameters
    ----------
    path : path
        Must end in ``.lwn``.
    names : sequence of sequences of str
        Names of bodies, of links, and of the values of a configuration.
    arrays : dict
        Arrays, keyed by their names in `BEFORE`; missing arrays are empty.
    packs : sequence of Packed
        The bodies. If surfaces can be cut into parts, two more packs of the same bodies follow. In the first, all
        surfaces are cut. In the second, only static bodies without solids are cut, into small parts.
    counts : tuple of int
        The number of values of a configuration, the number of links, and the number of moving bodies.

    Raises
    ------
    InputError
        If the path does not end in ``.lwn``.
    FileError
        If the file cannot be written; an older file is then unchanged.
    """
    target = _validate.path(path, "path")
    if target.suffix != SUFFIX:
        raise InputError(f"path: expected a name that ends in {SUFFIX}, found {target.name!r}")
    listed_names = [name for group in names for name in group]
    for name in listed_names:
        if "\0" in name:
            raise InputError(f"expected names without NUL, found {name!r}")
    text = "".join(f"{name}\0" for name in listed_names).encode(errors="backslashreplace")
    held = {"names": np.frombuffer(text, np.uint8), **arrays}
    listed = [held.get(name, _NO_NUMBERS) for name in BEFORE]
    surfaces = {tree.table.ctypes.data: tree for pack in packs for tree in pack.trees.values()}
    numbers = {address: number for number, address in enumerate(surfaces, 1)}
    for pack in packs:
        layout = pack.kernel.layout.copy()
        layout[:, columns.SURFACE_AT] = [numbers.get(at, 0) for at in layout[:, columns.SURFACE_AT].tolist()]
        listed += pack.kernel._replace(layout=layout)
    for tree in surfaces.values():
        listed += [tree.boxes, tree.children, tree.blocks, tree.parts, tree.diagonals]
    content, directory = bytearray(), []
    begin = _lines(HEADER.size + 32 * len(listed))
    places: dict[tuple[int, int], int] = {}  # packs share many arrays
    for array in listed:
        array = np.ascontiguousarray(array)
        key = array.ctypes.data, array.nbytes
        if key not in places:
            places[key] = begin + len(content)
            content += array.tobytes()
            content += bytes(_lines(len(content)) - len(content))
        columns_of = array.shape[1] if array.ndim == 2 else 1
        directory.append((TYPES[array.dtype], array.shape[0], columns_of, places[key]))
    rows = np.array(directory, dtype=np.int64).tobytes()
    dof, links, moving = counts
    static = len(packs[0].piece_start) - 1 - moving
    head = [len(listed), dof, links, moving, static, len(packs) - 1, len(surfaces), 0]
    size = begin + len(content)
    whole = bytearray(HEADER.pack(MAGIC, FORMAT, size, 0, source_hash().encode(), *head)) + rows
    whole += bytes(begin - len(whole)) + content
    struct.pack_into("<Q", whole, BEHIND_CHECKSUM - 8, checksum(bytes(whole[BEHIND_CHECKSUM:])))
    write_atomically(target, whole)


def _lines(size: int) -> int:
    return -(-size // LINE) * LINE


def checksum(content: bytes) -> int:
    """Sum 64-bit words, each multiplied by an odd number that depends on its position.

    Changing any one word changes the sum.
    """
    words = np.frombuffer(content, dtype="<u8")
    with np.errstate(over="ignore"):
        factors = np.arange(1, len(words) + 1, dtype=np.uint64) * np.uint64(GOLDEN) | np.uint64(1)
        return int((words * factors).sum(dtype=np.uint64))
