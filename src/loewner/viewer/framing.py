"""Set the camera's first view, and the grid on the ground, to suit the size of the scene."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from loewner._base._validate import Floats
from loewner.viewer.drawing import spanned

# GRID_SIDE is the side of the grid as a multiple of the view's diagonal. A side has at least LEAST_CELLS cells, and a
# section has SECTION cells.
GRID_SIDE, LEAST_CELLS, SECTION = 2.5, 20, 5

# A scene counts as resting on z = 0 unless it is below z = 0, or above it by more than this fraction of the view's
# diagonal.
ON_GROUND = 0.1


def framed(main: Floats, others: Iterable[Floats], most: float) -> Floats:
    """Compute the box that the camera shows: the main object, and nearby objects that are not much larger.

    Parameters
    ----------
    main : ndarray, shape (2, 3)
        Lowest and highest corner.
    others : iterable of ndarray, shape (2, 3)
    most : float
        A box, such as the box of a floor, is omitted if it would lengthen the diagonal by more than this factor.

    Returns
    -------
    ndarray, shape (2, 3)
    """
    longest = most * diagonal(main)
    return spanned([main, *(box for box in others if diagonal(spanned([main, box])) <= longest)])


def diagonal(box: Floats) -> float:
    """Return the length of a box's diagonal, in metres."""
    return float(np.linalg.norm(box[1] - box[0]))


def aim(server: Any, box: Floats) -> None:
    """Set the camera's first view, from the front, the right and above; the box appears to the left of the panel."""
    size = diagonal(box)
    middle = box.mean(axis=0) + 0.12 * size * np.array([0.84, 0.54, 0.0])
    server.initial_camera.look_at = middle
    server.initial_camera.position = middle + size * np.array([0.43, -0.66, 0.35])
    server.initial_camera.near, server.initial_camera.far = size * 1e-3, size * 1e3


def add_ground(scene: Any, box: Floats) -> tuple[Any, float]:
    """Add a grid below the scene, and return the edge length of its cells [m].

    The grid is at z = 0 if the scene rests there, and otherwise at the scene's lowest point.
    """
    size = diagonal(box)
    cell = round_length(GRID_SIDE * size / LEAST_CELLS)
    section = SECTION * cell
    side = section * math.ceil(GRID_SIDE * size / section)
    lowest = float(box[0, 2])
    at = 0.0 if 0.0 <= lowest <= ON_GROUND * size else lowest
    # The grid's lines are at round coordinates, with a round spacing.
    x, y = section * np.round(box.mean(axis=0)[:2] / section)
    grid = scene.add_grid(
        "/ground", side, side, position=(x, y, at), cell_size=cell, section_size=section, fade_distance=20 * size
    )
    return grid, cell


def round_length(most: float) -> float:
    """Round a length down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(most))
    return max((step * power for step in (1, 2, 5) if step * power <= most), default=power)
