"""Elementary functions of numbers and arrays. Unlike a C library's, their results have the same bits on every machine.

On an array, these functions take as long as a C library's; on a single number, they take about a microsecond. The
results are accurate to three units in the last place (`_kernels.elementary`).
"""

from functools import partial
from typing import Any

import numpy as np

from loewner._base._validate import Floats
from loewner._kernels import codes
from loewner._native import entries


def _of_each(function: int, x: Any, y: Any = None) -> Any:
    """Apply a function of `codes` to each number; for a single number, the result is a float."""
    first = np.array(x, dtype=float, order="C")
    second = first if y is None else np.array(y, dtype=float, order="C")
    values: Floats = np.empty(first.shape)
    entries.elementary(function, first.reshape(-1), second.reshape(-1), values.reshape(-1))
    return values if np.ndim(x) else float(values.item())


def arctan2(y: Any, x: Any) -> Any:
    """Compute the angles from the x-axis to the vectors (x, y) [rad]."""
    return _of_each(codes.ARC_TANGENT, *np.broadcast_arrays(y, x))


# Sines and cosines of angles [rad].
sin, cos = partial(_of_each, codes.SINE_OF), partial(_of_each, codes.COSINE_OF)

# Angles [rad] from their cosines and sines; NaN for arguments beyond ±1.
arccos, arcsin = partial(_of_each, codes.ARC_COSINE), partial(_of_each, codes.ARC_SINE)

# Natural logarithms (minus infinity for zero, NaN for negative numbers) and cube roots.
log, cbrt = partial(_of_each, codes.LOGARITHM), partial(_of_each, codes.CUBE_ROOT)
