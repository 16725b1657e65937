"""Make curved pieces in closed form: the image of a unit shape, its rounding radius, and both optimal ellipsoids."""

from __future__ import annotations

import numpy as np

from loewner._kernels import columns
from loewner._validate import Floats, Ints
from loewner.bodies.kinds import CURVED
from loewner.bodies.layout import PieceArrays
from loewner.bodies.pack import Packed

# Relative allowance for the rounding of a closed form and of a stored factor.
CLOSED_FORM_ROUNDING = 16 * 2.0**-53


def primitives(kind: int, rounding: Floats, frame: Floats) -> Packed:
    """Make bodies of one curved piece each; `frame` has one row per body, the semi-axes of the unit shape's image."""
    n = len(frame)
    # An ellipsoid is its own fit exactly; the others' closed forms are rounded, so step to the safe side.
    slack = 0.0 if CURVED[kind].is_ball else CLOSED_FORM_ROUNDING
    layout = np.zeros((n, 5), dtype=np.int64)
    layout[:, columns.KIND] = kind
    inner, outer, lift = ellipsoids_in_frame(np.full(n, kind), rounding, frame)
    center = np.column_stack([np.zeros((n, 2)), lift])
    pieces = PieceArrays(
        layout=layout,
        points=np.zeros((0, 3)),
        planes=np.zeros((0, 4)),
        piece_start=np.arange(n + 1),
        frames=np.column_stack([rounding, np.zeros((n, 3)), _diagonal(frame).reshape(n, 9)]),
        triangles=np.zeros((0, 3), dtype=np.int64),
        triangle_start=np.zeros(n + 1, dtype=np.int64),
        inner_center=center,
        inner_factor=_diagonal(inner) * (1 - slack),
        outer_center=center.copy(),
        outer_factor=_diagonal(outer) * (1 + slack),
        gaps=np.full((n, 2), 6 * slack),
    )
    return Packed.of(pieces)


def around_capsules(radius: Floats, half: Floats) -> tuple[Floats, Floats]:
    """Compute the smallest ellipsoids (a, a, b) around capsules, as (a, b); `half` is half the straight part.

    Their support function must be at least h|cos| + r, that is, a² - r² - 2hr c + k c² >= 0 for c in [0, 1] with k = b²
    - a² - h². The volume is least where k² - 2h²k - 3h²r² = 0.
    """
    # In units of the greater length, so that no square over- or underflows.
    unit = np.maximum(radius, half)
    x, y = radius / unit, half / unit
    k = y * (y + np.hypot(y, np.sqrt(3.0) * x))
    grow = np.sqrt(1 + y * y / k)
    return radius * grow, unit * grow * np.sqrt(x * x + k)


def ellipsoids_in_frame(kinds: Ints, rounding: Floats, lengths: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute the semi-axes of the inner and outer ellipsoids of curved pieces in their frames, and the centers.

    Parameters
    ----------
    kinds : ndarray of int, shape (k,)
    rounding : ndarray, shape (k,)
    lengths : ndarray, shape (k, 3)
        Semi-axes of the images of the unit shapes.

    Returns
    -------
    inner, outer : ndarray, shape (k, 3)
    lift : ndarray, shape (k,)
        Position of both centers along the third axis.
    """
    inner, outer, lift = np.empty((len(kinds), 3)), np.empty((len(kinds), 3)), np.zeros(len(kinds))
    for kind, known in CURVED.items():
        if known.fitted is not None:
            these, (smaller, larger, height) = kinds == kind, known.fitted
            inner[these] = lengths[these] * smaller / known.divisors[0]
            outer[these] = lengths[these] * larger / known.divisors[1]
            lift[these] = lengths[these, 2] * height
    balls, capsules = kinds == columns.POINT, kinds == columns.SEGMENT
    inner[balls] = outer[balls] = rounding[balls, None]
    r, h = rounding[capsules], lengths[capsules, 2]
    inner[capsules] = np.column_stack([r, r, h + r])
    a, b = around_capsules(r, h)
    outer[capsules] = np.column_stack([a, a, b])
    return inner, outer, lift


def _diagonal(axes: Floats) -> Floats:
    """Make diagonal matrices, shape (n, 3, 3), from the rows of an (n, 3) array."""
    return axes[:, :, None] * np.eye(3)
