"""What fits from outside and from inside share: triangular matrices, step lengths, progress."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from loewner._validate import Floats, Progress

ROUNDING = 2.0**-53  # unit roundoff of float64
# Numbers in a block of rows: few enough for the cache, enough for a call of NumPy not to count.
BLOCK = 2**16
# Most unknowns of an interior point whose matrix has a row for each: it takes 390 MB then.
LARGEST_SYSTEM = 7000
STEP_CAP, CENTRING_FLOOR = 0.9999, 1e-15  # as in `_kernels.fits.mvce`


def blocks(rows: Floats) -> Iterator[tuple[int, Floats]]:
    """Yield many rows block by block, each with the number of its first row."""
    size = max(1, BLOCK // rows.shape[1])
    for first in range(0, len(rows), size):
        yield first, rows[first : first + size]


def lower_root(rows: Floats) -> Floats:
    """Lower triangular L, diagonal positive, with L Lᵀ = rowsᵀ rows."""
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    return np.ascontiguousarray((triangle * np.where(np.diagonal(triangle) < 0, -1.0, 1.0)[:, None]).T)


def inverse_of(lower: Any) -> Floats:
    """Inverse of a lower triangular matrix."""
    from scipy.linalg.lapack import dtrtri

    return np.ascontiguousarray(np.tril(dtrtri(lower, lower=1)[0]))


def root_of_inverse(matrix: Floats) -> Floats | None:
    """Lower triangular H with Hᵀ H the inverse of `matrix`; None if that is singular to rounding."""
    try:
        return inverse_of(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return None


def room(x: Floats, dx: Floats) -> float:
    """How far x may go along dx and stay positive."""
    down = dx < 0
    return float((x[down] / -dx[down]).min(initial=np.inf))


@dataclass
class Reporter:
    """Tells how many of the digits asked for are there, in percent; never less than before.

    Within a round the number stands still, and is told again so that whoever listens may interrupt.
    """

    progress: Progress | None
    tol: float
    first: float = np.inf
    told: int = 0

    def reached(self, gap: float) -> None:
        """Tell of a gap that all points or half-spaces are within."""
        if 0 < gap < np.inf:
            if not self.first < np.inf:
                self.first = max(gap, 2 * self.tol)
            share = np.log(self.first / max(gap, self.tol)) / np.log(self.first / self.tol)
            self.told = max(self.told, min(99, int(100 * share)))
        self.working()

    def working(self) -> None:
        """Tell that another step is done."""
        if self.progress is not None:
            self.progress(self.told, 100)

    def done(self) -> None:
        """Tell that all of them are there."""
        self.told = 100
        self.working()
