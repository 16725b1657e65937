"""Octrees of OctoMap: the boxes of occupied leaves, read by its own library."""

from __future__ import annotations

import os

import numpy as np

from loewner import _validate
from loewner._files import read_regular
from loewner._validate import Floats
from loewner.errors import FileError, GeometryError, MissingExtraError, installing

# Bytes of a file: a building at a centimetre has a tenth of it.
MOST_BYTES = 2**30
HEADER = b"# Octomap OcTree binary file"


def occupied_leaves(path: str | os.PathLike[str]) -> tuple[Floats, Floats]:
    """Lower and upper corners of the occupied leaves of a `.bt` file, shapes (n, 3).

    Raises
    ------
    FileError
        If the file is missing, or no whole octree.
    GeometryError
        If nothing in it is occupied.
    MissingExtraError
        If octomap-python is not installed.
    """
    try:
        import octomap
    except ImportError:
        raise MissingExtraError(f"octrees need octomap-python: {installing('octrees')}") from None
    file = _validate.path(path, "path")
    if not read_regular(file, "an octree in .bt", MOST_BYTES).startswith(HEADER):
        raise FileError(f"{file}: expected an octree of OctoMap in .bt, which begins with {HEADER.decode()!r}")
    tree = octomap.OcTree(0.1)
    if not tree.readBinary(os.fsencode(file)):
        raise FileError(f"{file}: expected a whole octree of OctoMap, found one that is cut off or altered")
    leaves = [(*leaf.getCoordinate(), leaf.getSize()) for leaf in tree.begin_leafs() if tree.isNodeOccupied(leaf)]
    if not leaves:
        raise GeometryError(f"{file}: expected at least one occupied leaf, found none")
    rows = np.array(leaves)
    half = rows[:, 3:] / 2
    return rows[:, :3] - half, rows[:, :3] + half
