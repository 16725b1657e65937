"""Decide the overlap of two ellipsoids by an eigenproblem (appendix A of the paper).

This method is the reference for `loewner.overlap`, which is faster and stays accurate for thin ellipsoids.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base._guard import guarded
from loewner._base._validate import Floats
from loewner.ellipsoids.ellipsoid_pairs import PairArrays
from loewner.ellipsoids.ellipsoids import Ellipsoids
from loewner.errors import ConvergenceError

# An eigenvalue gives a touching point. It is accepted if this point is within this relative distance of E2. The
# eigenproblem squares the axis ratio: for ratios of about 100 and more, results for some pairs are wrong.
LARGEST_MISS = 1e-6


@guarded
def overlap_by_eigenvalue(E1: Ellipsoids, E2: Ellipsoids) -> NDArray[np.bool_]:
    """Decide whether ellipsoids overlap or touch, by the 2n x 2n eigenproblem of the paper's appendix A.

    Parameters
    ----------
    E1, E2 : Ellipsoids
        Ellipsoids of any dimension n; batches broadcast.

    Returns
    -------
    ndarray of bool, shape (...)

    Raises
    ------
    InputError
        If dimensions differ or batch shapes do not broadcast.
    ConvergenceError
        If the eigenproblem lost its accuracy, as it can for thin ellipsoids.

    References
    ----------
    The paper, appendix A.

    Examples
    --------
    >>> from loewner import Ellipsoids, paper
    >>> a = Ellipsoids.from_semi_axes([0, 0, 0], [1, 1, 1])
    >>> b = Ellipsoids.from_semi_axes([2.5, 0, 0], [2, 1, 1])
    >>> bool(paper.overlap_by_eigenvalue(a, b))
    True
    """
    pair = PairArrays(E1, E2, "overlap_by_eigenvalue", dim=None)
    try:
        with np.errstate(all="ignore"):  # after an overflow, the point is not on E2, and an error is raised
            return _solved_by_eigenvalue(pair)
    except np.linalg.LinAlgError as error:
        raise ConvergenceError(
            f"overlap_by_eigenvalue: the eigenproblem has no solution in floats ({error}); use loewner.overlap"
        ) from None


def _solved_by_eigenvalue(pair: PairArrays) -> NDArray[np.bool_]:
    """Compute the overlap in the notation of appendix A.

    The paper first tests whether the center of either ellipsoid lies in the other one. If the center a lies in E2, no
    scaled E1 touches E2 from outside, and the eigenproblem cannot decide. If the center b lies in E1, the eigenproblem
    decides correctly.
    """
    F1, F2, batch = pair.F1, pair.F2, pair.batch
    if not len(F1):
        return np.zeros(batch, np.bool_)
    n = F1.shape[-1]
    a, b = np.zeros_like(pair.offset), pair.offset

    # A^(1/2) and A^(-1/2), A = (F1 F1ᵀ)⁻¹, from the singular values of the factor.
    U, s, _ = np.linalg.svd(F1)
    root_A = (U / s[:, None, :]) @ U.transpose(0, 2, 1)
    inverse_root_A = (U * s[:, None, :]) @ U.transpose(0, 2, 1)

    inside = (_solved(F2, a - b) ** 2).sum(axis=-1) <= 1.0

    # B bar = A^(-1/2) B A^(-1/2), so B tilde = B bar⁻¹ = H Hᵀ with H = A^(1/2) F2.
    H = root_A @ F2
    V, h, _ = np.linalg.svd(H)
    B_tilde = (V * h[:, None, :] ** 2) @ V.transpose(0, 2, 1)
    root_B_tilde = (V * h[:, None, :]) @ V.transpose(0, 2, 1)
    b_bar = np.einsum("kij,kj->ki", root_A, b - a)
    b_tilde = np.einsum("kij,kj->ki", root_B_tilde, b_bar)

    block = np.empty((len(a), 2 * n, 2 * n))
    block[:, :n, :n] = block[:, n:, n:] = B_tilde
    block[:, :n, n:] = -np.eye(n)
    block[:, n:, :n] = -b_tilde[:, :, None] * b_tilde[:, None, :]
    eigenvalues = np.linalg.eigvals(block)
    lam = eigenvalues[np.arange(len(a)), np.argmin(eigenvalues.real, axis=-1)].real

    # a + lam A^(-1/2) (lam I - B tilde)⁻¹ b bar, where the inverse is computed from the singular values above. If this
    # point is not on E2 (or is NaN), the eigenvalue has lost its accuracy and decides nothing.
    coordinates = lam[:, None] / (lam[:, None] - h**2) * np.einsum("kji,kj->ki", V, b_bar)
    y = np.einsum("kij,kj->ki", V, coordinates)
    miss = np.abs(np.linalg.norm(_solved(F2, a - b + np.einsum("kij,kj->ki", inverse_root_A, y)), axis=-1) - 1.0)
    touches = (y**2).sum(axis=-1) <= 1.0
    lost = np.flatnonzero(~inside & ~(miss <= LARGEST_MISS))
    if lost.size:
        raise ConvergenceError(
            "overlap_by_eigenvalue: expected touching points on the second ellipsoid within "
            f"{LARGEST_MISS:g}, found {lost.size} of {len(a)} that miss it (first at index {lost[0]}); "
            "thin ellipsoids need loewner.overlap"
        )
    overlaps: NDArray[np.bool_] = (inside | touches).reshape(batch)[()]
    return overlaps


def _solved(M: Floats, v: Floats) -> Floats:
    """Compute M⁻¹ v for batches."""
    x: Any = np.linalg.solve(M, v[..., None])
    return np.asarray(x[..., 0])
