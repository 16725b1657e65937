"""The careful GJK on two placed pieces: a proof of separation, a common point, or the distance.

`pair_search` answers nearly all pairs faster; what it leaves comes here.

Works in the world's axes with the origin at the first body's translation, so that a pair far from
the world's origin loses nothing: only the difference of the translations enters.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; van den Bergen (1999),
doi:10.1080/10867651.1999.10487502 (termination by the support plane).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.ellipsoids.contact import POSITION_ROUNDINGS
from loewner._kernels.linalg3 import UNIT_ROUNDOFF
from loewner._kernels.narrow.simplex import closest, direction
from loewner._kernels.pieces.shapes import REACH, ROUNDING, placed_support

APART, TOUCHING, UNSETTLED = 0, 1, 2

# Pairs of polytopes stop after a handful of rounds because they have finitely many vertices;
# curved ones converge at least linearly. The cap is only there to make a hang impossible.
MAX_ROUNDS = 512

# Gap of upper and lower bound at which a distance is final: relative to the distance, plus what the
# evaluation of the bounds rounds (an eighth of the proven error bound, which is generous).
DISTANCE_TOLERANCE = 2e-15
ERROR_SHARE = 0.125

# What cannot be told from touching within 128 rounding errors, about 1e-12 of the lengths involved,
# is touching.
TOUCH_ROUNDINGS = 128.0


@inline
def minkowski_support(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, nx, ny, nz, S, k):
    """Write to row k of S the point of A - B that lies least far along n, and where it came from."""
    ax, ay, az = placed_support(ta, la, xa, i, Ta, ka, -nx, -ny, -nz)
    bx, by, bz = placed_support(tb, lb, xb, j, Tb, kb, nx, ny, nz)
    bx += dx
    by += dy
    bz += dz
    S[k, 0] = ax - bx
    S[k, 1] = ay - by
    S[k, 2] = az - bz
    S[k, 3] = ax
    S[k, 4] = ay
    S[k, 5] = az
    S[k, 6] = bx
    S[k, 7] = by
    S[k, 8] = bz


@inline
def rounding_error(ta, i, tb, j, dx, dy, dz):
    """Bound on the error of any computed dot product of a unit vector with a point of A - B."""
    return POSITION_ROUNDINGS * (ta[i, REACH] + tb[j, REACH] + abs(dx) + abs(dy) + abs(dz))


@njit()
def stretch(T, t):
    """Bound on how much a pose accepted as rigid can lengthen a vector: √(1 + ‖RᵀR - 1‖)."""
    squares = 0.0
    for a in range(3):
        for b in range(3):
            entry = (
                T[t, 0, a] * T[t, 0, b] + T[t, 1, a] * T[t, 1, b] + T[t, 2, a] * T[t, 2, b] - (1.0 if a == b else 0.0)
            )
            squares += entry * entry
    return np.sqrt(1.0 + np.sqrt(squares) + 16.0 * UNIT_ROUNDOFF)


@inline
def swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb):
    """Sum of the rounding radii, as large as the two poses can make them."""
    if ta[i, ROUNDING] == 0.0 and tb[j, ROUNDING] == 0.0:
        return 0.0
    return ta[i, ROUNDING] * stretch(Ta, ka) + tb[j, ROUNDING] * stretch(Tb, kb)


@njit()
def run(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, nx, ny, nz, limit, settle, S, weights, v, d):
    """Run GJK from the separating direction n (from A to B; any non-zero vector will do).

    Parameters
    ----------
    limit : float
        Margin the pieces must keep; the rounding radii of the pieces are added here.
    settle : bool
        True: stop as soon as "apart" or "touching" is proven. False: go on to the distance.

    Returns
    -------
    status : int
        APART: proven farther apart than `limit`. TOUCHING: the upper bound is within `limit`, or
        within rounding error of it. UNSETTLED: neither, after all that arithmetic allows.
    lower, upper : float
        Bounds on the distance of the cores less the rounding radii; both may be negative for
        cores that are apart by less than the radii; upper is -inf if the cores intersect.
    k : int
        Rows of the simplex left, with `weights`, `v` (from B's near point to A's) and its direction `d`.
    """
    radii = ta[i, ROUNDING] + tb[j, ROUNDING]
    reach = limit + radii
    far = limit + swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb)
    error = rounding_error(ta, i, tb, j, dx, dy, dz)
    lower = -np.inf
    norm = np.sqrt(nx * nx + ny * ny + nz * nz)
    d[0] = -nx / norm
    d[1] = -ny / norm
    d[2] = -nz / norm
    k = 0
    length = np.inf
    stalls = 0
    for _ in range(MAX_ROUNDS):
        minkowski_support(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, d[0], d[1], d[2], S, k)
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
        if settle and length <= reach:
            return TOUCHING, lower - radii, length - radii, k
        if length <= error or not direction(S, k, v, d) > 0.0:
            break
        # Rounding can make a round useless; a few in a row mean that no more is to be had.
        if length >= before * (1.0 - UNIT_ROUNDOFF):
            stalls += 1
            if stalls > 2:
                break
        else:
            stalls = 0
    if lower > far:
        status = APART
    elif length <= reach + 2.0 * error or length - lower <= TOUCH_ROUNDINGS * error:
        status = TOUCHING
    else:
        status = UNSETTLED
    return status, lower - radii, length - radii, k
