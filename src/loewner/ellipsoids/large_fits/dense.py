"""Code shared by outer and inner fits: triangular matrices, step lengths, progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from loewner._base._log import Percentage
from loewner._base._matrices import slices
from loewner._base._validate import Floats, Progress

ROUNDING = 2.0**-53  # unit roundoff of float64
# Count of numbers in a block of rows: few enough for the cache, and enough to make the overhead of NumPy negligible.
BLOCK = 2**16
# Largest number of unknowns in an interior-point method whose matrix has a row for each unknown; the matrix then takes
# 390 MB.
LARGEST_SYSTEM = 7000
STEP_CAP, CENTRING_FLOOR = 0.9999, 1e-15  # as in `_kernels.fits.mvce`


def blocks(rows: Floats) -> Iterator[tuple[slice, Floats]]:
    """Yield blocks of rows, each with the slice that selects it."""
    return ((some, rows[some]) for some in slices(len(rows), BLOCK // rows.shape[1]))


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


def half_log_det(matrix: Floats) -> float:
    """Compute half the logarithm of a determinant; minus infinity if `matrix` is not positive definite."""
    try:
        return float(np.log(np.diagonal(np.linalg.cholesky(matrix))).sum())
    except np.linalg.LinAlgError:
        return -np.inf


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


class Reporter(Percentage):
    """A reporter of the percentage of the requested digits that have been reached."""

    def __init__(self, progress: Progress, tol: float) -> None:
        super().__init__(progress)
        self._tol, self._first = tol, np.inf

    def reached(self, gap: float) -> None:
        """Report a gap that holds for all points or half-spaces."""
        if not 0 < gap < np.inf:
            return self.report()
        if not self._first < np.inf:
            self._first = max(gap, 2 * self._tol)
        self.report(np.log(self._first / max(gap, self._tol)) / np.log(self._first / self._tol))
