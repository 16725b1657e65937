"""Make curved pieces: the image of a unit shape, a rounding radius, and both optimal ellipsoids in closed form."""

from __future__ import annotations

import numpy as np

from loewner._base._validate import Floats, Ints
from loewner.bodies.kinds import CURVED
from loewner.bodies.layout import laid_out
from loewner.bodies.pack import Packed

# Relative allowance for the rounding of a closed form and of a stored factor.
CLOSED_FORM_ROUNDING = 16 * 2.0**-53


def primitives(kind: int, rounding: Floats, frame: Floats) -> Packed:
    """Make bodies of one curved piece each; each row of `frame` has the semi-axes of the unit shape's image."""
    n = len(frame)
    # An ellipsoid or a ball equals its fits, without rounding. The closed forms for other kinds are rounded, so they
    # need a margin on the safe side.
    slack = 0.0 if CURVED[kind].is_ball else CLOSED_FORM_ROUNDING
    (inner, outer), lifts = ellipsoids_in_frame(np.full(n, kind), rounding, frame)
    inner_center, outer_center = (np.column_stack([np.zeros((n, 2)), lift]) for lift in lifts)
    pieces = laid_out(
        kind,
        (inner_center, _diagonal(inner) * (1 - slack)),
        (outer_center, _diagonal(outer) * (1 + slack)),
        np.full((n, 2), 6 * slack),
        piece_start=np.arange(n + 1),
        frames=np.column_stack([rounding, np.zeros((n, 3)), _diagonal(frame).reshape(n, 9)]),
    )
    return Packed.of(pieces)


def ellipsoids_in_frame(kinds: Ints, rounding: Floats, lengths: Floats) -> tuple[Floats, Floats]:
    """Compute the inner and outer ellipsoids of curved pieces, in the frames of the pieces.

    Parameters
    ----------
    kinds : ndarray of int, shape (k,)
    rounding : ndarray, shape (k,)
    lengths : ndarray, shape (k, 3)
        Semi-axes of the images of the unit shapes.

    Returns
    -------
    semi_axes : ndarray, shape (2, k, 3)
        The inner ellipsoids come first.
    lifts : ndarray, shape (2, k)
        Positions of the ellipsoids' centers along the third axis.
    """
    semi_axes, lifts = np.empty((2, len(kinds), 3)), np.empty((2, len(kinds)))
    for kind, curved in CURVED.items():
        these = kinds == kind
        for side, fit in enumerate((curved.inner, curved.outer)):
            semi_axes[side, these], lifts[side, these] = fit(rounding[these], lengths[these])
    return semi_axes, lifts


def _diagonal(axes: Floats) -> Floats:
    """Make diagonal matrices, shape (n, 3, 3), from the rows of an (n, 3) array."""
    return axes[:, :, None] * np.eye(3)
