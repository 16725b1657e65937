"""Compute verdicts for listed pairs: first in a fast pass, then by a fallback, and finally in exact integers.

Queries about pairs and crowds use this module. Robots use it for configurations that the kernels for robots
(`_kernels/robots/configurations.py`) leave undecided.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loewner._base._validate import Ints
from loewner._base._workspaces import workspace
from loewner._kernels import codes
from loewner._native import entries
from loewner.queries import _exact
from loewner.queries._exact import Operands as Operands

# Empty rows, for pairs that are not listed by row numbers.
NO_ROWS = np.empty((2, 0), dtype=np.int64)


def settle(mode: int, margin: float, first: int, last: int, operands: Operands, out: NDArray[np.int8]) -> Ints | None:
    """Settle the pairs k with ``first <= k < last``.

    Parameters
    ----------
    mode : int
        `codes.CERTIFY` or `codes.EXACT`.
    margin : float
        Distance to keep, in metres, >= 0.
    operands : Operands
    out : ndarray of int8
        Receives the verdicts. In mode EXACT, AMBIGUOUS means that no search settled the pair; callers must not treat it
        as free.

    Returns
    -------
    ndarray of int64, shape (TIERS,), or None
        How many pairs of pieces each tier of the fast pass settled. None if a pose is not a rigid motion; `out` is then
        invalid.
    """
    tally = np.zeros(codes.TIERS, dtype=np.int64)
    if not entries.settle_range(mode, margin, first, last, *operands, out, tally, workspace(entries.workspace_size())):
        return None
    if mode == codes.EXACT and tally[codes.OPEN]:
        entries.settle_open(margin, first, last, *operands, out)
        for k in first + np.flatnonzero(out[first:last] == codes.INEXACT):
            out[k] = _exact.verdict(margin, int(k), operands)
    return tally
