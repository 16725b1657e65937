"""The careful GJK on two placed pieces: a proof of separation, a common point, or the distance.

`gjk_fast` answers nearly all pairs faster and leaves the remaining pairs to this module.

The search works in world axes, with the origin at the translation of the first body. Only the difference of the
translations is used, so a pair far from the world's origin loses no accuracy.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; van den Bergen (1999),
doi:10.1080/10867651.1999.10487502 (termination by the support plane).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import APART, TOUCHING, UNSETTLED
from loewner._kernels.columns import ROUNDING
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.linalg3 import dot, minus, negated, plus
from loewner._kernels.narrow.simplex import closest, direction
from loewner._kernels.pieces.shapes import placed_support, reach, rotation_of
from loewner._kernels.tolerances import LEAST_SQUARE, UNIT_ROUNDOFF

# Maximum number of rounds of a search, which only prevents an endless loop. Pairs of polytopes need only a few rounds,
# because they have finitely many vertices; for curved pieces, the search converges at least linearly.
MAX_ROUNDS = 512

# The search for a distance ends when its computed upper and lower bounds differ by at most DISTANCE_TOLERANCE times the
# distance, plus ERROR_SHARE times the proven bound on rounding errors. The actual errors are usually far smaller than
# the proven bound.
DISTANCE_TOLERANCE = 2e-15
ERROR_SHARE = 0.125

# Distance at which pairs still count as touching, in rounding errors; it is about 1e-12 of the lengths involved. The
# number is a choice, not an error bound: it only has to exceed the errors of the points themselves.
TOUCH_ROUNDINGS = 128.0


@inline
def minkowski_support(A, B, shift, n, S, k):
    """Write the point of A - B that is least along n, and its points of A and B, to row k of S."""
    a = placed_support(A, negated(n))
    b = plus(placed_support(B, n), shift)
    S[k, 0], S[k, 1], S[k, 2] = minus(a, b)
    S[k, 3], S[k, 4], S[k, 5] = a
    S[k, 6], S[k, 7], S[k, 8] = b


@inline
def rounding_error(A, B, shift):
    """Bound on the error of any computed dot product of a unit vector with a point of A - B: certified.md B14."""
    return position_error(lengths(A, B, shift), UNIT_ROUNDOFF)


@inline
def lengths(A, B, shift):
    """Sum of the lengths from which the points of A - B are computed."""
    return reach(A) + reach(B) + abs(shift[0]) + abs(shift[1]) + abs(shift[2])


@inline
def off_orthonormal(R):
    """Bound on ‖RᵀR - 1‖ for the nine numbers of R in row order: the square root of the sum of squared entries."""
    squares = 0.0
    for i in range(3):
        for j in range(3):
            entry = R[i] * R[j] + R[3 + i] * R[3 + j] + R[6 + i] * R[6 + j] - (1.0 if i == j else 0.0)
            squares += entry * entry
    return np.sqrt(squares)


@njit()
def stretch(P):
    """Bound on the factor by which a pose accepted as rigid can lengthen a vector: √(1 + ‖RᵀR - 1‖)."""
    return np.sqrt(1.0 + off_orthonormal(rotation_of(P)) + 16.0 * UNIT_ROUNDOFF)


@inline
def swollen_radii(A, B):
    """Sum of the rounding radii, enlarged by the largest stretch of the two poses."""
    if A.table[A.piece, ROUNDING] == 0.0 and B.table[B.piece, ROUNDING] == 0.0:
        return 0.0
    return A.table[A.piece, ROUNDING] * stretch(A) + B.table[B.piece, ROUNDING] * stretch(B)


@njit(forceinline=False)
def run(A, B, shift, n, limit, settle, S, weights, v, d):
    """Run GJK from the separating direction n (from A to B; any direction is valid).

    Parameters
    ----------
    limit : float
        Margin that the pieces must keep; the rounding radii of the pieces are added here.
    settle : bool
        If True, stop as soon as "apart" or "touching" is proven; if False, continue to the distance.

    Returns
    -------
    status : int
        APART: proven farther apart than `limit`. TOUCHING: the upper bound is within `limit`, or within rounding error
        of it. UNSETTLED: the arithmetic is not accurate enough to prove either.
    lower, upper : float
        Bounds on the distance of the cores, minus the rounding radii. Both bounds may be negative for cores that are
        apart by less than the radii; `upper` is -inf if the cores intersect.
    k : int
        Number of rows of the simplex that remain. `weights` holds their weights, `v` the vector from B's near point to
        A's near point, and `d` its direction.
    """
    radii = A.table[A.piece, ROUNDING] + B.table[B.piece, ROUNDING]
    near = limit + radii
    far = limit + swollen_radii(A, B)
    error = rounding_error(A, B, shift)
    lower = -np.inf
    if not LEAST_SQUARE < dot(n, n) < np.inf:
        n = (1.0, 0.0, 0.0)
    norm = np.sqrt(dot(n, n))
    d[0], d[1], d[2] = -n[0] / norm, -n[1] / norm, -n[2] / norm
    k = 0
    length = np.inf
    stalls = 0
    for _ in range(MAX_ROUNDS):
        minkowski_support(A, B, shift, (d[0], d[1], d[2]), S, k)
        plane = d[0] * S[k, 0] + d[1] * S[k, 1] + d[2] * S[k, 2]
        if plane - error > lower:
            lower = plane - error
        if settle and lower > far:
            return APART, lower - radii, length - radii, k
        if k > 0:
            if length - plane <= DISTANCE_TOLERANCE * length + ERROR_SHARE * error:
                break
            repeated = False
            for row in range(k):
                if S[row, 0] == S[k, 0] and S[row, 1] == S[k, 1] and S[row, 2] == S[k, 2]:
                    repeated = True
            if repeated:
                break
        before = length
        k = closest(S, k + 1, weights, v)
        if k == 4:
            return TOUCHING, -np.inf, -np.inf, k
        length = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if settle and length <= near:
            return TOUCHING, lower - radii, length - radii, k
        if length <= error or not direction(S, k, v, d) > 0.0:
            break
        # Because of rounding, a round may fail to shorten the distance. After three such rounds in a row, no more
        # progress is expected.
        if length >= before * (1.0 - UNIT_ROUNDOFF):
            stalls += 1
            if stalls > 2:
                break
        else:
            stalls = 0
    if lower > far:
        status = APART
    elif length <= near + 2.0 * error or length - lower <= TOUCH_ROUNDINGS * error:
        status = TOUCHING
    else:
        status = UNSETTLED
    return status, lower - radii, length - radii, k


@njit(forceinline=False)
def write_simplex(G, k, weights, d, result):
    """Write the normal and the witnesses of the simplex with which `run` ended."""
    for c in range(3):
        result[c] = -d[c]
    for c in range(6):
        result[3 + c] = 0.0
        for row in range(k):
            result[3 + c] += weights[row] * G[row, 3 + c]
