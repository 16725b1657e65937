"""Numbers that fill a unit cube more evenly than random ones."""

from functools import cache

import numpy as np

from loewner._base._validate import Floats
from loewner._native import entries


@cache
def strides(dimension: int) -> Floats:
    """Compute numbers whose multiples, modulo 1, fill the unit cube evenly: see `_kernels.low_discrepancy`."""
    powers = np.empty(dimension)
    entries.irrationals(powers, np.empty(dimension))
    return powers


def points(count: int, dimension: int) -> Floats:
    """Compute points that fill the unit cube evenly, shape (count, dimension)."""
    return np.asarray(np.modf(0.5 + np.arange(1.0, count + 1.0)[:, None] * strides(dimension))[0])
