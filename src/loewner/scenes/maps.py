"""Read occupancy grids of the ROS map server, each a YAML file with thresholds and a grey image."""

from __future__ import annotations

import io
import math
import os
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from loewner._base import _files, _validate
from loewner._base._nodes import YamlNode, read_yaml
from loewner._base._plausible import warn
from loewner._base._rotations import pose_of
from loewner._base._validate import Bools, Floats, Ints
from loewner.bodies import Body
from loewner.errors import FileError, imported

# Largest sizes of the two files [bytes], and largest number of pixels of the image.
LARGEST_YAML, LARGEST_IMAGE, MOST_PIXELS = 1_000_000, 500_000_000, 400_000_000

# Grey value of unknown cells in files that ROS writes.
UNKNOWN_GREY = 205

KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")

# The header of a grey PGM: its kind and three numbers, separated by spaces and comments.
PGM = re.compile(rb"(P[25])" + 3 * rb"(?:\s|#[^\n]*\n)+(\d{1,9})" + rb"\s")


class Map(NamedTuple):
    """An occupancy grid.

    Attributes
    ----------
    occupied, unknown : ndarray of bool, shape (p, q)
        Flags of the cells. In units of the resolution, and in the frame of the lowest corner, cell (i, j) extends from
        (i, j) to (i + 1, j + 1).
    resolution : float
        Edge of a cell, in metres.
    origin : ndarray, shape (3,)
        Position x, y of the grid's lowest corner in the world, in metres, and the grid's rotation about z, in radians.
    """

    occupied: Bools
    unknown: Bools
    resolution: float
    origin: Floats


def read_map(path: str | os.PathLike[str]) -> Map:
    """Read a map of the ROS map server, in mode trinary or scale.

    Raises
    ------
    FileError
        If a file is missing, damaged or not grey, a key is missing or unknown, or a threshold is not between 0 and 1.
    MissingExtraError
        If PyYAML is missing, or if the image is not a PGM and Pillow is missing.
    """
    file = _validate.path(path, "path")
    values = read_yaml(_files.read_regular(file, "a map", LARGEST_YAML), file, "a map").mapping(KEYS, REQUIRED)
    resolution, origin = values["resolution"].length(), np.array(values["origin"].numbers(3, "x, y, yaw"))
    if abs(origin[2]) > 2.0 * math.pi:
        warn(f"{file}: the origin turns the map by {origin[2]:g} rad, more than a whole turn; is this in degrees?")
    if not resolution > 0.0:
        raise values["resolution"].error(f"expected a length above 0, found {resolution:g}")
    negate = values["negate"].number()
    if negate not in (0.0, 1.0):
        raise values["negate"].error(f"expected 0 or 1, found {negate:g}")
    occupied, free = (_share(values[key]) for key in ("occupied_thresh", "free_thresh"))
    if not free < occupied:
        raise values["free_thresh"].error(f"expected less than occupied_thresh, {occupied:g}, found {free:g}")
    mode = values["mode"].choice(("trinary", "scale"), "trinary or scale") if "mode" in values else "trinary"
    with values["image"].blamed():
        grey, most = _grey(file.parent / values["image"].text())
    share = (grey if negate else most - grey) / most
    if most == 255 and not negate and (grey == UNKNOWN_GREY).any() and free > (255 - UNKNOWN_GREY) / 255:
        warn(
            f"{file}: free_thresh {free:g} makes the grey {UNKNOWN_GREY} free, which map servers write for unknown "
            "cells; give a free_thresh of 0.196 if these cells are unknown"
        )
    # The first row of an image has the largest y.
    filled, empty = ((test[::-1].T).copy() for test in (share >= occupied, share < free))
    if mode == "scale":  # values between the thresholds are costs and do not mark unknown cells
        filled = ~empty
    return Map(filled, ~filled & ~empty, resolution, origin)


def rectangles(cells: Bools) -> Ints:
    """Divide cells into rectangles: runs along the second axis, merged with equal runs in the following rows.

    Returns
    -------
    ndarray of int64, shape (n, 4)
        For each rectangle i0, j0, i1, j1: the indices of its first cell, and the indices just after its last cell.
    """
    padded = np.pad(cells, ((0, 0), (1, 1))).astype(np.int8)
    rows, starts = np.nonzero(np.diff(padded, axis=1) == 1)
    _, ends = np.nonzero(np.diff(padded, axis=1) == -1)
    order = np.lexsort((rows, ends, starts))
    i, j0, j1 = rows[order], starts[order], ends[order]
    new = np.ones(len(i), dtype=bool)
    new[1:] = (j0[1:] != j0[:-1]) | (j1[1:] != j1[:-1]) | (i[1:] != i[:-1] + 1)
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(i)) - 1
    return np.stack([i[first], j0[first], i[last] + 1, j1[first]], axis=1) if len(i) else np.empty((0, 4), np.int64)


def body_of(grid: Map, height: float, *, unknown: bool) -> Body | None:
    """Make boxes from the occupied cells, in the frame of the map's lowest corner; None if no cell is occupied."""
    cells = rectangles(grid.occupied | grid.unknown if unknown else grid.occupied)
    if len(cells) == 0:
        return None
    ends = np.asarray(grid.resolution * cells, dtype=np.float64)
    return _boxes(ends[:, :2], ends[:, 2:], height)


def around(grid: Map, height: float, width: float) -> Body:
    """Make four boxes of the given width [m] around a map, in the frame of its lowest corner."""
    a, b = grid.resolution * np.array(grid.occupied.shape)
    low = np.array([[-width, -width], [a, -width], [0.0, -width], [0.0, b]])
    high = np.array([[0.0, b + width], [a + width, b + width], [a, 0.0], [a, b + width]])
    return _boxes(low, high, height)


def _boxes(low: Floats, high: Floats, height: float) -> Body:
    """Make boxes on the plane z = 0, given the lower and upper corners of their bases, shape (n, 2)."""
    centers = np.column_stack([(low + high) / 2.0, np.full(len(low), height / 2.0)])
    return Body.boxes(centers, np.column_stack([high - low, np.full(len(low), height)]))


def bounds_of(grid: Map) -> Floats:
    """Compute the extent of a map in the world: one row each for x and y, with the least and the largest value."""
    corners = grid.resolution * np.array(grid.occupied.shape) * [[0, 0], [0, 1], [1, 0], [1, 1]]
    T = corner(grid)
    places = corners @ T[:2, :2].T + T[:2, 3]
    return np.stack([places.min(axis=0), places.max(axis=0)], axis=1)


def _share(node: YamlNode) -> float:
    share = node.number()
    if not 0.0 <= share <= 1.0:
        raise node.error(f"expected a share from 0 to 1, found {share:g}")
    return share


def _grey(file: Path) -> tuple[Ints, int]:
    """Read a grey image, and the value that stands for white."""
    data = _files.read_regular(file, "the image of a map", LARGEST_IMAGE)
    head = PGM.match(data)
    if head is None:
        return _grey_by_pillow(data, file)
    width, height, most = (int(number) for number in head.groups()[1:])
    if not (0 < most < 65536 and 0 < width * height <= MOST_PIXELS):
        raise FileError(f"{file}: expected a grey image, found {width} x {height} pixels with values up to {most}")
    if head[1] == b"P2":
        try:
            pixels = np.array(data[head.end() :].split(), dtype=np.int64)
        except (ValueError, OverflowError) as error:
            raise FileError(f"{file}: expected numbers as pixels, found others ({error})") from error
    else:
        pixels = np.frombuffer(data[head.end() :], dtype=">u2" if most > 255 else "u1").astype(np.int64)
    if len(pixels) != width * height or not ((pixels >= 0) & (pixels <= most)).all():
        raise FileError(f"{file}: expected {width * height} pixels from 0 to {most}, found {len(pixels)} or others")
    return pixels.reshape(height, width), most


def _grey_by_pillow(data: bytes, file: Path) -> tuple[Ints, int]:
    """Read an image in PNG, BMP or a similar format."""
    pillow = imported("PIL.Image", f"{file}: expected Pillow for images other than PGM", "plots")
    try:
        with pillow.open(io.BytesIO(data)) as image:
            image.load()
            mode, pixels = image.mode, np.asarray(image)
    except Exception as error:  # Pillow raises errors of many kinds about damaged files
        why = "no known kind of image" if isinstance(error, pillow.UnidentifiedImageError) else error
        raise FileError(f"{file}: expected an image, found one that cannot be read ({why})") from error
    if mode == "1":
        return pixels.astype(np.int64) * 255, 255
    if mode in ("RGB", "RGBA") and (pixels[..., :1] == pixels[..., :3]).all() and (pixels[..., 3:] == 255).all():
        return pixels[..., 0].astype(np.int64), 255
    if mode not in ("L", "I;16"):
        raise FileError(f"{file}: expected a grey image without transparent pixels, found colours of mode {mode}")
    return pixels.astype(np.int64), 255 if mode == "L" else 65535


def corner(grid: Map) -> Floats:
    """Compute the pose of a map's lowest corner, shape (4, 4)."""
    x, y, yaw = grid.origin.tolist()
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return pose_of(np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]), [x, y, 0.0])
