"""Verdicts for listed pairs: a fast pass, then a fallback for the remaining pairs, then exact integers.

Queries about pairs and about crowds use this module. Robots also use it, for configurations that their own kernels
(`_kernels/robots/configurations.py`) leave open.
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

# The empty rows for pairs that are not listed by row numbers.
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
        Receives the verdicts. AMBIGUOUS in mode EXACT means that no search settled the pair; the caller must treat the
        pair as unsettled.

    Returns
    -------
    ndarray of int64, shape (TIERS,), or None
        Number of piece pairs that each tier of the fast pass settled. None if a pose is not a rigid motion; in that
        case no result is valid.
    """
    tally = np.zeros(codes.TIERS, dtype=np.int64)
    if not entries.settle_range(mode, margin, first, last, *operands, out, tally, workspace(entries.workspace_size())):
        return None
    if mode == codes.EXACT and tally[codes.OPEN]:
        entries.settle_open(margin, first, last, *operands, out)
        for k in first + np.flatnonzero(out[first:last] == codes.INEXACT):
            out[k] = _exact.verdict(margin, int(k), operands)
    return tally
