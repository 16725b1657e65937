"""Products and factors of small matrices, and lengths of short vectors, with the same bits on every processor.

BLAS, LAPACK, `np.einsum` and reductions choose the order of a sum, and whether to fuse products and sums, according to
the processor. NumPy's elementwise sums and products round every entry separately, as IEEE 754 requires. Values that two
machines compare, such as the hash of a robot's model, are therefore computed by these functions, which add terms in a
fixed order. Sines and logarithms are in `_elementary`.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import numpy as np

from loewner._base._validate import Floats, Ints

# Largest cosine of the angle between columns that count as orthogonal. Rounding alone causes cosines of up to three
# units of 2^-53. The lengths of orthogonal columns are the singular values, with errors of at most twice this bound.
ORTHOGONAL = 2.0**-51

# Jacobi's method takes three to six sweeps.
MOST_SWEEPS = 16

# A number that is negligible compared with entries of about 1. It is added to denominators, so that no quotient is 0 /
# 0.
TINY = 1e-300

# Up to this number of matrices, arithmetic on arrays takes longer than arithmetic on single numbers.
FEW = 16

# The entries of a column: numbers, or arrays with a number for each matrix.
Column: TypeAlias = tuple[Any, ...]


def product(A: Floats, B: Floats) -> Floats:
    """Multiply matrices of shapes (..., n, k) and (..., k, m), with a small k; no entry is a negative zero."""
    total: Floats = 0.0 + A[..., :, 0, None] * B[..., None, 0, :]
    for k in range(1, A.shape[-1]):
        total += A[..., :, k, None] * B[..., None, k, :]
    return total


def image(M: Floats, x: Floats) -> Floats:
    """Multiply a matrix of shape (n, k) by vectors of shape (..., k)."""
    total: Floats = 0.0 + x[..., 0, None] * M[:, 0]
    for k in range(1, M.shape[-1]):
        total += x[..., k, None] * M[:, k]
    return total


def in_frame(T_world_frame: Floats, T_world_body: Floats) -> Floats:
    """Return the pose of a body in a frame; all shapes are (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = T_world_frame[:3, :3].T
    inverse[:3, 3] = -image(inverse[:3, :3], T_world_frame[:3, 3])
    return product(inverse, T_world_body)


def dot(a: Floats, b: Floats) -> Floats:
    """Compute dot products of vectors, shape (..., k), with a small k; terms are added from the first to the last."""
    total: Floats = 0.0 + a[..., 0] * b[..., 0]
    for k in range(1, a.shape[-1]):
        total = total + a[..., k] * b[..., k]
    return total


def lengths(x: Floats) -> Floats:
    """Compute the lengths of vectors, shape (..., k), with a small k."""
    return np.asarray(np.sqrt(dot(x, x)))


def normals_of(triangles: Floats) -> Floats:
    """Compute normals of triangles (n, 3, 3), each with twice the area as its length; np.cross is slower for a few."""
    (ax, ay, az), (bx, by, bz) = (triangles[:, 1] - triangles[:, 0]).T, (triangles[:, 2] - triangles[:, 0]).T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def least_of(values: Floats, owner: Ints, count: int) -> Floats:
    """Find the least value of each owner, shape (count,); infinity for owners without values."""
    least = np.full(count, np.inf)
    np.minimum.at(least, owner, values)
    return least


def slices(total: int, most: int) -> Iterator[slice]:
    """Divide `total` rows into slices of at most `most` rows, or of one row if `most` is less than 1."""
    step = max(1, most)
    return (slice(first, first + step) for first in range(0, total, step))


def components(count: int, one: Ints, other: Ints) -> Ints:
    """Number the connected components of a graph of `count` nodes with edges between `one` and `other`."""
    # Imported late: SciPy's graph routines are needed for meshes only.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def power(x: Floats, exponent: int) -> Floats:
    """Raise numbers to a power by repeated products."""
    raised = np.ones_like(x)
    for _ in range(exponent):
        raised = raised * x
    return raised


def singular_values(A: Floats) -> Floats:
    """Compute the singular values of matrices, shape (N, 3, 3), largest first, by Jacobi's one-sided method.

    The singular values of a matrix do not depend on the other matrices in the call, since the operations on single
    numbers and on arrays are the same. For a few matrices, arithmetic on single numbers takes a tenth of the time.
    """
    exponent = np.frexp(np.abs(A).max(axis=(1, 2), initial=0.0))[1]
    scaled = np.ldexp(A, -exponent[:, None, None])  # exact: a diagonal matrix keeps its entries
    squares = np.empty((len(A), 3))
    if len(A) > FEW:
        columns: list[Column] = [tuple(np.ascontiguousarray(scaled[:, :, j].T)) for j in range(3)]
        for j, column in enumerate(_made_orthogonal(columns, _turn_of_each)):
            squares[:, j] = _dot(column, column)
    else:
        for row, M in zip(squares, scaled, strict=True):
            row[:] = [_dot(column, column) for column in _made_orthogonal(list(zip(*M.tolist(), strict=True)), _turn)]
    return np.asarray(np.ldexp(-np.sort(-np.sqrt(squares), axis=1), exponent[:, None]))


def principal_axes(points: Floats) -> Floats:
    """Find the principal axes of points, shape (n, 3), as rows, beginning with the axis of the largest extent."""
    off = points - points.mean(axis=0)
    x, y, z = np.ascontiguousarray((off / (float(np.abs(off).max()) or 1.0)).T)
    rows = [[float((a * b).sum()) for b in (x, y, z)] for a in (x, y, z)]
    columns = _made_orthogonal([(*row, *unit) for row, unit in zip(rows, np.eye(3).tolist(), strict=True)], _turn)
    columns.sort(key=lambda column: -_dot(column, column))
    return np.array([column[3:] for column in columns])


def cholesky(A: Floats) -> Floats:
    """Factor positive definite matrices, shape (N, 3, 3), into a lower triangular matrix and its transpose."""
    L = np.zeros(A.shape)
    for k in range(3):
        for i in range(k, 3):
            rest = A[:, i, k]
            for j in range(k):
                rest = rest - L[:, i, j] * L[:, k, j]
            L[:, i, k] = np.sqrt(rest) if i == k else rest / L[:, k, k]
    return L


def _made_orthogonal(columns: list[Column], turn_of: Callable[[Any, Any, Any], tuple[Any, Any] | None]) -> list[Column]:
    """Turn three columns until they are orthogonal; entries after the first three turn with them."""
    for _ in range(MOST_SWEEPS):
        still = True
        for i, j in ((0, 1), (0, 2), (1, 2)):
            a, b = columns[i], columns[j]
            turn = turn_of(_dot(a, a), _dot(b, b), _dot(a, b))
            if turn is not None:
                still, (c, s) = False, turn
                columns[i] = tuple([c * x - s * y for x, y in zip(a, b, strict=True)])
                columns[j] = tuple([s * x + c * y for x, y in zip(a, b, strict=True)])
        if still:
            break
    return columns


def _dot(a: Column, b: Column) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _turn(aa: float, bb: float, ab: float) -> tuple[float, float] | None:
    """Return the cosine and sine of the turn that makes two columns orthogonal; None if they already are."""
    if not abs(ab) > ORTHOGONAL * math.sqrt(aa) * math.sqrt(bb):
        return None
    apart, twice = bb - aa, 2.0 * ab
    tangent = twice / (apart + math.copysign(math.sqrt(apart * apart + twice * twice) + TINY, apart))
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    return cosine, cosine * tangent


def _turn_of_each(aa: Floats, bb: Floats, ab: Floats) -> tuple[Floats, Floats] | None:
    """Compute the turns of many pairs of columns, as `_turn` does; orthogonal pairs get the cosine 1 and the sine 0."""
    off = np.abs(ab) > ORTHOGONAL * np.sqrt(aa) * np.sqrt(bb)
    if not off.any():
        return None
    apart, twice = bb - aa, 2.0 * ab
    tangent = twice / (apart + np.copysign(np.sqrt(apart * apart + twice * twice) + TINY, apart))
    tangent = np.where(off, tangent, 0.0)
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    return cosine, cosine * tangent
