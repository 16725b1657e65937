"""Small dense linear algebra: Cholesky, triangular solves, Householder QR, squares of vectors.

For problems of these sizes, calling LAPACK takes longer than solving them. The loops are therefore written here. Every
function takes the dimension `n`, so a caller with a compile-time `n` gets unrolled loops.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit

SQRT2 = np.sqrt(2.0)


class Counts(NamedTuple):
    """Sizes of interior-point problems: m vectors in n dimensions, and p entries of a symmetric matrix."""

    m: Any
    n: Any
    p: Any


@inline
def counts_of(m, n):
    """Sizes for m vectors in n dimensions."""
    return Counts(m, n, n * (n + 1) // 2)


@inline
def svec(v, rows, i, n):
    """Write the p entries of v vᵀ to row i; the inner product of two such rows is the square of v · w.

    Returns |v|².
    """
    a = 0
    norm2 = 0.0
    for j in range(n):
        for k in range(j):
            rows[i, a] = SQRT2 * v[j] * v[k]
            a += 1
        square = v[j] * v[j]
        norm2 += square
        rows[i, a] = square
        a += 1
    return norm2


@inline
def fill_upper(a, diagonal, n):
    """Fill the upper triangle of `a` with a multiple of the identity."""
    for j in range(n):
        a[j, j] = diagonal
        for k in range(j + 1, n):
            a[j, k] = 0.0


@njit()
def cholesky(a, n):
    """Overwrite the lower triangle of `a` with its Cholesky factor; False if `a` is not positive definite."""
    for j in range(n):
        pivot = a[j, j]
        for k in range(j):
            pivot -= a[j, k] * a[j, k]
        if not pivot > 0.0:  # Written with `not`, the condition also holds for NaN.
            return False
        root = np.sqrt(pivot)
        a[j, j] = root
        inverse = 1.0 / root
        for i in range(j + 1, n):
            value = a[i, j]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            a[i, j] = value * inverse
    return True


@njit()
def normal_cholesky(a, n):
    """Overwrite the upper triangle of `a` with R such that a = Rᵀ R; False if `a` is not positive definite.

    This function is for the larger normal matrices: its inner loop runs along rows without a sum, so it vectorises.
    """
    for j in range(n):
        if not a[j, j] > 0.0:
            return False
        root = np.sqrt(a[j, j])
        inverse = 1.0 / root
        a[j, j] = root
        for k in range(j + 1, n):
            a[j, k] *= inverse
        for i in range(j + 1, n):
            t = a[j, i]
            for k in range(i, n):
                a[i, k] -= t * a[j, k]
    return True


@njit()
def normal_solve(r, x, n):
    """Overwrite `x` with (Rᵀ R)⁻¹ x, where R is from `normal_cholesky`."""
    for i in range(n):
        t = x[i] / r[i, i]
        x[i] = t
        for k in range(i + 1, n):
            x[k] -= t * r[i, k]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(i + 1, n):
            value -= r[i, k] * x[k]
        x[i] = value / r[i, i]


@njit()
def reversed_cholesky(a, n):
    """Overwrite the upper triangle of symmetric `a` with U such that a = U Uᵀ; False if `a` is not positive definite.

    The inverse transpose L = U⁻ᵀ is lower triangular with a⁻¹ = L Lᵀ: it is the factor of an ellipsoid, triangular from
    the start. Only the upper triangle of `a` is read.
    """
    for j in range(n - 1, -1, -1):
        pivot = a[j, j]
        for k in range(j + 1, n):
            pivot -= a[j, k] * a[j, k]
        if not pivot > 0.0:
            return False
        root = np.sqrt(pivot)
        a[j, j] = root
        inverse = 1.0 / root
        for i in range(j):
            value = a[i, j]
            for k in range(j + 1, n):
                value -= a[i, k] * a[j, k]
            a[i, j] = value * inverse
    return True


@njit()
def solve_lower(low, x, n):
    """Overwrite `x` with low⁻¹ x."""
    for i in range(n):
        value = x[i]
        for k in range(i):
            value -= low[i, k] * x[k]
        x[i] = value / low[i, i]


@njit()
def solve_lower_transposed(low, x, n):
    """Overwrite `x` with low⁻ᵀ x."""
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(i + 1, n):
            value -= low[k, i] * x[k]
        x[i] = value / low[i, i]


@njit()
def invert_lower(low, out, n):
    """Write the inverse of a lower triangular matrix to `out`, with zeros above the diagonal."""
    for j in range(n):
        for i in range(j):
            out[i, j] = 0.0
        out[j, j] = 1.0 / low[j, j]
        for i in range(j + 1, n):
            value = 0.0
            for k in range(j, i):
                value -= low[i, k] * out[k, j]
            out[i, j] = value / low[i, i]


@njit()
def inverse_transposed_upper(up, out, n):
    """Write up⁻ᵀ, which is lower triangular, to `out`, with zeros above the diagonal."""
    for j in range(n):
        for i in range(j):
            out[i, j] = 0.0
        out[j, j] = 1.0 / up[j, j]
        for i in range(j + 1, n):
            value = 0.0
            for k in range(j, i):
                value -= up[k, i] * out[k, j]
            out[i, j] = value / up[i, i]


@njit()
def multiply_lower(a, b, out, n):
    """Write the product of two lower triangular matrices, which is lower triangular, to `out`."""
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(j, i + 1):
                value += a[i, k] * b[k, j]
            out[i, j] = value
        for j in range(i + 1, n):
            out[i, j] = 0.0


@njit()
def solve_general(a, x, n):
    """Overwrite `x` with a⁻¹ x, by Gaussian elimination with partial pivoting; `a` is destroyed. False if singular."""
    for j in range(n):
        best = j
        for i in range(j + 1, n):
            if abs(a[i, j]) > abs(a[best, j]):
                best = i
        if not abs(a[best, j]) > 0.0:
            return False
        if best != j:
            for k in range(n):
                a[j, k], a[best, k] = a[best, k], a[j, k]
            x[j], x[best] = x[best], x[j]
        for i in range(j + 1, n):
            factor = a[i, j] / a[j, j]
            if factor != 0.0:
                for k in range(j + 1, n):
                    a[i, k] -= factor * a[j, k]
                x[i] -= factor * x[j]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(i + 1, n):
            value -= a[i, k] * x[k]
        x[i] = value / a[i, i]
    return True


@njit()
def householder_triangle(a, m, n):
    """Overwrite the upper triangle of `a` (m, n) with R of its QR factorisation, whose diagonal is made positive.

    The method is backward stable row by row after scaling, whereas the Gram matrix would square the condition number.
    Returns False if the columns are dependent. The entries below the triangle are meaningless.
    """
    for j in range(n):
        norm2 = 0.0
        for i in range(j, m):
            norm2 += a[i, j] * a[i, j]
        norm = np.sqrt(norm2)
        if not norm > 0.0:
            return False
        alpha = -norm if a[j, j] > 0.0 else norm
        head = a[j, j] - alpha
        scale = -1.0 / (alpha * head)  # The scale is 2 / vᵀv with v = column - alpha e_j.
        a[j, j] = head
        for k in range(j + 1, n):
            dot = 0.0
            for i in range(j, m):
                dot += a[i, j] * a[i, k]
            dot *= scale
            for i in range(j, m):
                a[i, k] -= dot * a[i, j]
        a[j, j] = alpha
    for i in range(n):
        if a[i, i] < 0.0:
            for k in range(i, n):
                a[i, k] = -a[i, k]
    return True
