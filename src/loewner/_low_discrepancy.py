"""Numbers that fill a unit cube more evenly than random ones."""

from functools import cache

import numpy as np

from loewner._validate import Floats


@cache
def irrationals(dimension: int) -> tuple[Floats, Floats]:
    """Compute powers of the root of x^(d + 1) = x + 1 (the golden ratio for d = 1), and numbers independent of them.

    Multiples of the first, modulo 1, fill the unit cube evenly. Roberts: The unreasonable effectiveness of quasirandom
    sequences, 2018.
    """
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimension + 1))
    order = np.arange(1.0, dimension + 1.0)
    return root**-order, np.modf(np.pi * np.sqrt(order + 1.0))[0]


def points(count: int, dimension: int) -> Floats:
    """Compute points of the unit cube, shape (count, dimension)."""
    strides, _ = irrationals(dimension)
    return np.asarray(np.modf(0.5 + np.arange(1.0, count + 1.0)[:, None] * strides)[0])
