"""Code shared by outer and inner fits: triangular matrices, step lengths, progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from loewner._base._validate import Floats, Progress

ROUNDING = 2.0**-53  # unit roundoff of float64
# Count of numbers in a block of rows: few enough for the cache, and enough to make the overhead of NumPy negligible.
BLOCK = 2**16
# Largest number of unknowns in an interior-point method whose matrix has a row for each unknown; the matrix then takes
# 390 MB.
LARGEST_SYSTEM = 7000
STEP_CAP, CENTRING_FLOOR = 0.9999, 1e-15  # as in `_kernels.fits.mvce`


def blocks(rows: Floats) -> Iterator[tuple[int, Floats]]:
    """Yield rows in blocks, each block with the number of its first row."""
    size = max(1, BLOCK // rows.shape[1])
    for first in range(0, len(rows), size):
        yield first, rows[first : first + size]


def lower_root(rows: Floats) -> Floats:
    """Compute the lower triangular L with a positive diagonal and L Lᵀ = rowsᵀ rows."""
    triangle = np.asarray(np.linalg.qr(rows, mode="r"))
    return np.ascontiguousarray((triangle * np.where(np.diagonal(triangle) < 0, -1.0, 1.0)[:, None]).T)


def inverse_of(lower: Any) -> Floats:
    """Invert a lower triangular matrix."""
    from scipy.linalg.lapack import dtrtri

    return np.ascontiguousarray(np.tril(dtrtri(lower, lower=1)[0]))


def root_of_inverse(matrix: Floats) -> Floats | None:
    """Compute the lower triangular H such that Hᵀ H inverts `matrix`; None if `matrix` is singular to rounding."""
    try:
        return inverse_of(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        return None


def solver_of(matrix: Floats, diagonal: Floats | float) -> Callable[[Floats], Floats] | None:
    """Make a solver of (matrix + diag(diagonal)) X = B that overwrites `matrix`; None if singular to rounding."""
    from scipy.linalg.lapack import dpotrf, dpotrs

    matrix.ravel()[:: len(matrix) + 1] += diagonal
    lower, failed = dpotrf(matrix.T, lower=1, overwrite_a=1, clean=0)
    return None if failed else lambda B: dpotrs(lower, B, lower=1)[0]


def room(x: Floats, dx: Floats) -> float:
    """Compute the largest step of x along dx that keeps x positive."""
    down = dx < 0
    return float((x[down] / -dx[down]).min(initial=np.inf))


@dataclass
class Reporter:
    """A reporter of the percentage of the requested digits that have been reached, which never decreases.

    Within a round, the share does not change, and is reported again so that the callback may interrupt.
    """

    progress: Progress
    tol: float
    first: float = np.inf
    told: int = 0

    def reached(self, gap: float) -> None:
        """Report a gap that holds for all points or half-spaces."""
        if 0 < gap < np.inf:
            if not self.first < np.inf:
                self.first = max(gap, 2 * self.tol)
            share = np.log(self.first / max(gap, self.tol)) / np.log(self.first / self.tol)
            self.told = max(self.told, min(99, int(100 * share)))
        self.working()

    def working(self) -> None:
        """Report that another step has been made."""
        self.progress(self.told, 100)

    def done(self) -> None:
        """Report that all digits are reached."""
        self.told = 100
        self.working()
