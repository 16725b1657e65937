"""GJK on two placed pieces: a proof of separation, a common point, or the distance.

Works in the world's axes with the origin at the first body's translation, so that a pair far from
the world's origin loses nothing: only the difference of the translations enters.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; van den Bergen (1999),
doi:10.1080/10867651.1999.10487502 (termination by the support plane).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.contact import POSITION_ROUNDINGS, UNIT_ROUNDOFF
from loewner._kernels.shapes import REACH, ROUNDING, placed_support
from loewner._kernels.simplex import closest, direction

APART, TOUCHING, UNSETTLED = 0, 1, 2

# Pairs of polytopes stop after a handful of rounds because they have finitely many vertices;
# curved ones converge at least linearly. The cap is only there to make a hang impossible.
MAX_ROUNDS = 512

# Gap of upper and lower bound at which a distance is final: relative to the distance, plus what the
# evaluation of the bounds rounds (an eighth of the proven error bound, which is generous).
DISTANCE_TOLERANCE = 2e-15
ERROR_SHARE = 0.125

QUICK_ROUNDS = 24

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


@inline
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inline
def _edge(ax, ay, az, bx, by, bz):
    """Line case: how many points stay, and the direction from the feature away from the origin."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    if ux * ax + uy * ay + uz * az < 0.0:
        px, py, pz = _cross(ux, uy, uz, ax, ay, az)
        nx, ny, nz = _cross(px, py, pz, ux, uy, uz)
        return 2, nx, ny, nz
    return 1, ax, ay, az


@njit()
def quick(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, nx, ny, nz, error):
    """Decide most pairs of plain cores (no radii, no margin) in a few rounds, all in registers.

    The simplex is walked by the signs of a few products only, with no closest point. What it finds is proven
    the same way as in `run`: a support plane clear of the origin, or a tetrahedron that holds it clear
    of rounding. Everything else is UNSETTLED and goes to `run`.

    Returns
    -------
    status : int
    x, y, z : float
        The direction reached, from A to B.
    """
    px, py, pz = -nx, -ny, -nz
    k = 0
    # Newest point first. Rows b, c, d hold what is left of the older ones.
    bx = by = bz = cx = cy = cz = ex = ey = ez = 0.0
    largest = 0.0
    for _ in range(QUICK_ROUNDS):
        ux, uy, uz = placed_support(ta, la, xa, i, Ta, ka, -px, -py, -pz)
        vx, vy, vz = placed_support(tb, lb, xb, j, Tb, kb, px, py, pz)
        ax = ux - (vx + dx)
        ay = uy - (vy + dy)
        az = uz - (vz + dz)
        plane = px * ax + py * ay + pz * az
        length = np.sqrt(px * px + py * py + pz * pz)
        if plane > error * length:
            return APART, -px, -py, -pz
        largest = max(largest, abs(ax) + abs(ay) + abs(az))
        if k == 0:
            k = 1
            bx, by, bz = ax, ay, az
            px, py, pz = ax, ay, az
            continue
        if k == 3:
            # Which of the three faces at the new point does the origin lie beyond? b, c, e run
            # counter-clockwise seen from the new point.
            doubt = 64.0 * UNIT_ROUNDOFF * largest * largest * largest
            b1x, b1y, b1z = bx - ax, by - ay, bz - az
            c1x, c1y, c1z = cx - ax, cy - ay, cz - az
            e1x, e1y, e1z = ex - ax, ey - ay, ez - az
            fx, fy, fz = _cross(b1x, b1y, b1z, c1x, c1y, c1z)
            gx, gy, gz = _cross(c1x, c1y, c1z, e1x, e1y, e1z)
            hx, hy, hz = _cross(e1x, e1y, e1z, b1x, b1y, b1z)
            f = -(fx * ax + fy * ay + fz * az)
            g = -(gx * ax + gy * ay + gz * az)
            h = -(hx * ax + hy * ay + hz * az)
            if f <= 0.0 and g <= 0.0 and h <= 0.0:
                volume = abs(fx * e1x + fy * e1y + fz * e1z)
                # The origin is inside if the three and the base, f + g + h + base = -volume, are all clear.
                if f < -doubt and g < -doubt and h < -doubt and volume + (f + g + h) > doubt:
                    return TOUCHING, -px, -py, -pz
                return UNSETTLED, -px, -py, -pz
            if f >= g and f >= h:
                pass
            elif g >= h:
                bx, by, bz = cx, cy, cz
                cx, cy, cz = ex, ey, ez
            else:
                cx, cy, cz = bx, by, bz
                bx, by, bz = ex, ey, ez
            k = 2
        if k == 1:
            k, px, py, pz = _edge(ax, ay, az, bx, by, bz)
            if k == 2:
                cx, cy, cz = bx, by, bz
            bx, by, bz = ax, ay, az
        else:
            b1x, b1y, b1z = bx - ax, by - ay, bz - az
            c1x, c1y, c1z = cx - ax, cy - ay, cz - az
            fx, fy, fz = _cross(b1x, b1y, b1z, c1x, c1y, c1z)
            qx, qy, qz = _cross(fx, fy, fz, c1x, c1y, c1z)
            rx, ry, rz = _cross(b1x, b1y, b1z, fx, fy, fz)
            if qx * ax + qy * ay + qz * az < 0.0:
                if c1x * ax + c1y * ay + c1z * az < 0.0:
                    bx, by, bz = cx, cy, cz
                    k, px, py, pz = _edge(ax, ay, az, bx, by, bz)
                else:
                    k, px, py, pz = _edge(ax, ay, az, bx, by, bz)
                if k == 2:
                    cx, cy, cz = bx, by, bz
                bx, by, bz = ax, ay, az
            elif rx * ax + ry * ay + rz * az < 0.0:
                k, px, py, pz = _edge(ax, ay, az, bx, by, bz)
                if k == 2:
                    cx, cy, cz = bx, by, bz
                bx, by, bz = ax, ay, az
            else:
                # Inside the prism over the triangle: keep it, turned so that a, b, c runs counter-clockwise
                # seen from the origin.
                k = 3
                if fx * ax + fy * ay + fz * az <= 0.0:
                    px, py, pz = -fx, -fy, -fz
                    ex, ey, ez = cx, cy, cz
                    cx, cy, cz = bx, by, bz
                else:
                    px, py, pz = fx, fy, fz
                    ex, ey, ez = bx, by, bz
                bx, by, bz = ax, ay, az
        if not px * px + py * py + pz * pz > 0.0:
            return UNSETTLED, -nx, -ny, -nz
    return UNSETTLED, -px, -py, -pz


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
