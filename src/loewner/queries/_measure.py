"""Compute distances of pairs: first in a fast pass, and then by careful searches for the remaining pairs.

Queries about pairs and about crowds use this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner._base._threads import in_shares
from loewner._base._validate import Bools, Floats
from loewner._base._workspaces import workspace
from loewner._native import entries
from loewner.queries._settle import Operands

# The smallest number of pairs that is worth a thread of its own.
CHUNK = 4096

# Bytes per pair. Bounds take three numbers. An exact distance takes four numbers, three vectors, a status and a flag.
BOUND_BYTES, EXACT_BYTES = 24, 106


class Measures(NamedTuple):
    """Distances of n pairs, in the order of the fields of `Distance`.

    Attributes
    ----------
    lower, upper, estimate : ndarray, shape (n,)
    distance : ndarray, shape (n,), or (0,) if only bounds are requested
    witness_a, witness_b, normal : ndarray, shape (n, 3), or (0, 3)
    unsettled : ndarray of bool, shape (n,), or (0,)
        Marks pairs whose distance could not be computed. For these pairs, distance, witnesses and normal are NaN.
    """

    lower: Floats
    upper: Floats
    estimate: Floats
    distance: Floats
    witness_a: Floats
    witness_b: Floats
    normal: Floats
    unsettled: Bools


def measure(exact: bool, n: int, operands: Operands) -> Measures:
    """Bound the distances of n pairs; with `exact`, compute the distances as well. Poses must be rigid motions."""
    plan, rows, *bodies = operands
    m = n if exact else 0
    numbers, vectors, status = np.empty((3 + exact, n)), np.empty((3, m, 3)), np.zeros(m, dtype=np.int8)

    def run(first: int, last: int) -> None:
        memory = workspace(entries.memory_of_distances())
        pieces, values = entries.distance_range(
            exact, first, last, plan, rows, *bodies, memory, numbers, vectors, status
        )
        if len(pieces):
            entries.measure_left(pieces, values, *bodies, numbers, vectors, status)

    in_shares(run, n, CHUNK)
    lower, upper, estimate = numbers[:3]
    value = numbers[3] if exact else np.empty(0)
    if exact:
        # The bounds are proven, but the computed value is not. The value is therefore clamped to the bounds.
        np.maximum(lower, np.minimum(value, upper, out=value), out=value)
    unsettled = status != 0
    value[unsettled] = vectors[:, unsettled] = np.nan
    return Measures(lower, upper, estimate, value, vectors[0], vectors[1], vectors[2], unsettled)
