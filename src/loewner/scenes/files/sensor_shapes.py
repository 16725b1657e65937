"""Read the shapes in scene files that represent sensor data: point clouds, voxels, terrain, balls and boxes."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from loewner._base import _archives, _tables, _validate
from loewner._base._files import read_regular
from loewner._base._nodes import Node
from loewner._base._plausible import doubt_about_unit, warn
from loewner.bodies import Body
from loewner.errors import FileError
from loewner.scenes.files.schema import keys_of

# Largest size of a file of numbers in bytes; a cloud of ten million points in text is smaller.
MOST_BYTES = 2**29

Recipe = tuple[Any, Callable[[], Body]]


def _spheres(entry: Node) -> Recipe:
    rows = np.array(entry.rows(4)).reshape(-1, 4)
    return (rows.tobytes(),), lambda: Body.spheres(rows[:, :3], rows[:, 3])


def _boxes(entry: Node) -> Recipe:
    rows = np.array(entry.rows(6)).reshape(-1, 6)
    return (rows.tobytes(),), lambda: Body.boxes(rows[:, :3], rows[:, 3:])


def _half_space(entry: Node) -> Recipe:
    keys = entry.mapping(*keys_of("half_space"))
    normal, offset = keys["normal"].numbers(3), keys["offset"].number()
    sizes = {"extent": keys["extent"].number()} if "extent" in keys else {}
    return (*normal, offset, *sizes.values()), functools.partial(Body.half_space, normal, offset, **sizes)


def _cloud(entry: Node) -> Recipe:
    keys = entry.mapping(*keys_of("cloud"))
    file = file_of(keys["file"])
    sizes = {key: keys[key].number() for key in ("radius", "voxel") if key in keys}
    return (file, *sizes.items()), lambda: Body.from_cloud(read_array(file), **sizes)


def _voxels(entry: Node) -> Recipe:
    keys = entry.mapping(*keys_of("voxels"))
    file, size = file_of(keys["file"]), keys["size"].number()
    origin = keys["origin"].numbers(3) if "origin" in keys else [0.0] * 3
    return (file, size, *origin), lambda: Body.from_voxels(read_array(file), size, origin=origin)


def _height_field(entry: Node) -> Recipe:
    keys = entry.mapping(*keys_of("height_field"))
    file, spacing = file_of(keys["file"]), keys["spacing"].numbers(2)
    base = keys["base"].number() if "base" in keys else None
    return (file, *spacing, base), lambda: Body.height_field(read_array(file), spacing, base=base)


def _octree(entry: Node) -> Recipe:
    file = file_of(entry)
    return (file,), functools.partial(Body.from_octree, file)


SENSOR_SHAPES: dict[str, Callable[[Node], Recipe]] = {
    "cloud": _cloud,
    "voxels": _voxels,
    "octree": _octree,
    "height_field": _height_field,
    "half_space": _half_space,
    "spheres": _spheres,
    "boxes": _boxes,
}


def file_of(entry: Node) -> Path:
    """Return the path of a file whose name is relative to the scene's file."""
    name = entry.text()
    with entry.blamed():
        return entry.file.parent / _validate.path(name, "file")


def read_array(path: Path) -> Any:
    """Read numbers from a NumPy file (`.npy`, never a pickle) or from lines of text (`.xyz`, `.txt`, `.csv`).

    Parameters
    ----------
    path : Path
        In `.csv` files, commas separate the numbers; in other text files, spaces or commas separate them.

    Raises
    ------
    FileError
        If the file is missing, too large or of the wrong kind, or if a number is missing in it.
    """
    suffix = path.suffix.lower()
    if suffix not in (".npy", ".xyz", ".txt", ".csv"):
        raise FileError(f"{path}: expected a file that ends in .npy, .xyz, .txt or .csv")
    data = read_regular(path, "numbers in .npy, .xyz, .txt or .csv", MOST_BYTES)
    if suffix == ".npy":
        return _archives.numbers(data, str(path), "an array of numbers")
    table = _tables.table(data, str(path), commas=suffix == ".csv")
    for doubt in _doubts("\n".join(_tables.COMMENT.findall(data.decode("ascii")))):
        warn(f"{path}: expected {doubt}")
    return table


def _doubts(comments: str) -> Iterator[str]:
    """Yield reasons to doubt the unit or the order of the numbers, judging by comments, which are otherwise ignored."""
    if doubt := doubt_about_unit(comments):
        yield doubt
    for line in comments.splitlines():
        names = re.split(r"[\s,;]+", line.strip("# \t").lower())[:3]
        if sorted(names) == ["x", "y", "z"] != names:
            yield f"columns x, y and z, found {line!r} in a comment, which is not read"
            return
