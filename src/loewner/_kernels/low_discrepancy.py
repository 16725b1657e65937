"""Numbers that fill a unit cube more evenly than random numbers do.

Roberts: The unreasonable effectiveness of quasirandom sequences, 2018.
"""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.simd.vectors import rounded_product


@njit()
def irrationals(strides, shifts):
    """Compute powers of the root of x^(d + 1) = x + 1 (the golden ratio for d = 1), and numbers independent of them.

    Multiples of the powers, modulo 1, fill the unit cube evenly. The root is found by halving the interval from 1 to 2
    until its ends are neighbours. Powers are computed as products that are rounded one by one, because the last bit of
    a library's power function depends on the processor.

    Parameters
    ----------
    strides, shifts : ndarray, shape (d,)
        Receive the powers and the independent numbers.
    """
    low, high = 1.0, 2.0
    for _ in range(52):
        middle, power = 0.5 * (low + high), 1.0
        for _ in range(len(strides) + 1):
            power *= middle
        if power < 1.0 + middle:
            low = middle
        else:
            high = middle
    first, power = 1.0 / low, 1.0
    for k in range(len(strides)):
        power *= first
        multiple = rounded_product(np.pi, np.sqrt(k + 2.0))
        strides[k], shifts[k] = power, multiple - np.floor(multiple)
