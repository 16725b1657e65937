"""Sample motions between given ends: first the ends, then the middle, then points at finer and finer spacing.

Collisions tend to be found early in this order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._validate import Floats, Ints
from loewner.errors import InputError
from loewner.robots.description.robot import Robot

# Minimum number of configurations that is worth a kernel call.
AT_LEAST = 64

# Maximum number of configurations that are computed at a time, unless there are more edges. For ten joints, the
# configurations take 80 MB.
MOST_AT_ONCE = 2**20

# If the quotient of a length and a step is this close to an integer, rounding may put it on either side of the integer.
# The distance is relative.
NEARLY_WHOLE = 1e-9

# Bytes of a motion's results: a verdict, a fraction, a pair, and the work that was done.
BYTES_OF_A_MOTION = 40

# Maximum number of steps in a motion. A larger number suggests a wrong unit.
MOST_STEPS = 2**24


def steps(lengths: Floats, step: float) -> Ints:
    """Count the steps, of length at most `step`, into which edges of the given lengths are divided.

    Raises
    ------
    InputError
        If an edge needs more than `MOST_STEPS` steps.
    """
    longest = float(np.max(lengths, initial=0.0))
    if not longest / step <= MOST_STEPS:
        raise InputError(
            f"resolution: expected at most {MOST_STEPS} steps on the longest motion ({longest:g}), found {step:g}"
        )
    return np.maximum(np.ceil(lengths / step), 1).astype(np.int64)


def nearly_whole(quotients: Floats) -> Ints:
    """Return the indices of quotients that overflowed, or that rounding may have moved across an integer."""
    with np.errstate(invalid="ignore"):
        far = np.abs(quotients - np.rint(quotients)) > NEARLY_WHOLE * (1.0 + quotients)
    return np.flatnonzero(~far)


def rounds(parts: Ints, valid: NDArray[np.bool_]) -> Iterator[tuple[Ints, Floats]]:
    """Yield edges and the fractions at which to check them, coarsest first; edges that are not `valid` are skipped.

    Parameters
    ----------
    parts : ndarray of int64
        Number of steps into which each edge is divided.
    valid : ndarray of bool
        Whether each edge is still to be checked; the caller may change this array between two rounds.
    """
    done, more = 0, max(2, AT_LEAST // max(1, len(parts)))
    while True:
        going = np.flatnonzero(valid & (parts >= done))
        if len(going) == 0:
            return
        edges, fractions = [], []
        for count in np.unique(parts[going]):
            at = coarse_first(int(count))[done : done + more]
            those = going[parts[going] == count]
            edges.append(np.repeat(those, len(at)))
            fractions.append(np.tile(at, len(those)))
        yield np.concatenate(edges), np.concatenate(fractions)
        done, more = done + more, max(more, min(done + more, MOST_AT_ONCE // len(going)))


@lru_cache(maxsize=256)
def coarse_first(parts: int) -> Floats:
    """Return 0, 1, and then the multiples of 1 / parts between them: the middle, the quarters, and so on."""
    numbers = np.zeros(1, dtype=np.int64)  # in the order of their reversed binary digits
    for _ in range(max(1, (parts - 1).bit_length())):
        numbers = np.concatenate([2 * numbers, 2 * numbers + 1])
    return np.concatenate([[0.0, 1.0], numbers[(numbers > 0) & (numbers < parts)] / parts])


def ends(robot: Robot, Q0: ArrayLike, Q1: ArrayLike) -> tuple[Floats, Floats, tuple[int, ...]]:
    """Check and broadcast the starts and ends of motions; return them as rows, with the shape of the batch."""
    a, b = robot.checked(Q0, "Q0"), robot.checked(Q1, "Q1")
    if a.ndim == b.ndim == 1:  # a fast path for the usual case
        return a[None], b[None], ()
    if a.shape != b.shape:
        _validate.broadcast({"Q0": a.shape[:-1], "Q1": b.shape[:-1]})
        a, b = np.broadcast_arrays(a, b)
    shape = a.shape[:-1]
    _validate.fits_memory(math.prod(shape) * (BYTES_OF_A_MOTION + 16 * robot.dof), f"{shape} motions")
    return np.ascontiguousarray(flat(a)), np.ascontiguousarray(flat(b)), shape


def checked_path(robot: Robot, path: ArrayLike) -> Floats:
    """Check a user's path, shape (k, dof), with at least two rows."""
    rows = robot.checked(path, "path")
    if rows.ndim != 2 or len(rows) < 2:
        raise InputError(f"path: expected shape (k, {robot.dof}) with k >= 2, found {_validate.shape_text(rows.shape)}")
    return rows


def flat(Q: Floats) -> Floats:
    """Flatten configurations to rows. (NumPy cannot infer the number of rows if there are no joints.)"""
    return Q.reshape(math.prod(Q.shape[:-1]), Q.shape[-1])
