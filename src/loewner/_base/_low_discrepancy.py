"""Numbers that fill a unit cube more evenly than random ones."""

from functools import cache

import numpy as np

from loewner._base._validate import Floats


@cache
def irrationals(dimension: int) -> tuple[Floats, Floats]:
    """Compute powers of the root of x^(d + 1) = x + 1 (the golden ratio for d = 1), and numbers independent of them.

    Multiples of the first, modulo 1, fill the unit cube evenly. Roberts: The unreasonable effectiveness of quasirandom
    sequences, 2018.
    """
    powers = [1.0 / _root(dimension)]
    for _ in range(1, dimension):
        powers.append(powers[-1] * powers[0])
    order = np.arange(1.0, dimension + 1.0)
    return np.array(powers), np.modf(np.pi * np.sqrt(order + 1.0))[0]


def _root(dimension: int) -> float:
    """Halve the interval from 1 to 2 until its ends are neighbours.

    Only products are rounded, one by one as in C (`root_of` in `plans.c`): no power of a library, whose last bit
    depends on the processor, decides where the points are.
    """
    low, high = 1.0, 2.0
    for _ in range(52):
        middle = 0.5 * (low + high)
        power = 1.0
        for _ in range(dimension + 1):
            power *= middle
        low, high = (middle, high) if power < 1.0 + middle else (low, middle)
    return low


def points(count: int, dimension: int) -> Floats:
    """Compute points of the unit cube, shape (count, dimension)."""
    strides, _ = irrationals(dimension)
    return np.asarray(np.modf(0.5 + np.arange(1.0, count + 1.0)[:, None] * strides)[0])
