"""The fast searches on two placed pieces: GJK with the simplex in registers.

The vertices of small polytopes are moved to the world once per pair; then a round is two searches through vectors of
points and some forty products. Both searches prove what they say the same way as `gjk.run`, by a support plane clear of
the origin or by points of the pieces; where they cannot, they say UNSETTLED and `gjk.run` goes on.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; Ericson, Real-Time Collision Detection (2005), section 5.1.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.linalg3 import UNIT_ROUNDOFF, cross
from loewner._kernels.narrow.gjk_robust import APART, DISTANCE_TOLERANCE, ERROR_SHARE, TOUCHING, UNSETTLED
from loewner._kernels.narrow.simplex import segment_weight, triangle_weights
from loewner._kernels.pieces.shapes import KIND, LARGE, POINTS_FROM, POINTS_TO, POLYTOPE, placed_support
from loewner._kernels.simd.support import BLOCK, aligned, entry_of, farthest, place_vertices

NEAREST, INSIDE = 3, 4  # further answers of `near`: the distance is final; the cores overlap for sure

QUICK_ROUNDS = 24
NEAR_ROUNDS = 64  # hulls need six, twelve at most; curved pieces converge linearly

# A support point that the simplex has already ends the search; its bounds must then agree to so many errors.
LAST_GAP = 16.0

# Triangles whose sine at a corner is below this (squared: 1e-2) get their normal squared off to the edges.
THIN = 1e-4

# Share of the first direction in the second, of unit vectors. 0.5 to 0.8 serve equally well.
KEPT = 0.7

# Columns of the scratch array: the placed vertices of both pieces, then six coordinates per round of `near`.
PLACED = 2 * LARGE
_PATH = 3 * PLACED


@njit()
def scratch():
    """Make the array that the searches write to; one serves any number of pairs in turn."""
    return aligned(_PATH + 6 * NEAR_ROUNDS)


@inline
def _put(layout, points, piece, T, t, x, y, z, W, at):
    """Place the vertices of a small polytope in W from column `at` on; returns the end, `at` for other pieces."""
    if layout[piece, KIND] != POLYTOPE:
        return at
    start, stop = layout[piece, POINTS_FROM], layout[piece, POINTS_TO]
    place_vertices(
        points, start, stop,
        T[t, 0, 0], T[t, 0, 1], T[t, 0, 2], T[t, 1, 0], T[t, 1, 1], T[t, 1, 2], T[t, 2, 0], T[t, 2, 1], T[t, 2, 2],
        x, y, z, W, at,
    )  # fmt: skip
    return at + (stop - start)


@inline
def put_pair(la, xa, i, Ta, ka, lb, xb, j, Tb, kb, dx, dy, dz, W):
    """Place what can be placed of two pieces; returns the columns where a's and b's vertices end."""
    ends_a = _put(la, xa, i, Ta, ka, 0.0, 0.0, 0.0, W, np.int64(0))
    return ends_a, _put(lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a)


@inline
def _supports(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz):
    """Points of A and of B whose difference lies least far along n."""
    if ends_a > 0:
        k = entry_of(farthest(W, np.int64(0), ends_a, -nx, -ny, -nz))
        ax, ay, az = W[k], W[k + BLOCK], W[k + 2 * BLOCK]
    else:
        ax, ay, az = placed_support(ta, la, xa, i, Ta, ka, -nx, -ny, -nz)
    if ends_b > ends_a:
        k = entry_of(farthest(W, ends_a, ends_b, nx, ny, nz))
        bx, by, bz = W[k], W[k + BLOCK], W[k + 2 * BLOCK]
    else:
        bx, by, bz = placed_support(tb, lb, xb, j, Tb, kb, nx, ny, nz)
        bx += dx
        by += dy
        bz += dz
    return ax, ay, az, bx, by, bz


@inline
def _edge(ax, ay, az, bx, by, bz):
    """Line case: how many points stay, and the direction from the feature away from the origin."""
    ux, uy, uz = bx - ax, by - ay, bz - az
    if ux * ax + uy * ay + uz * az < 0.0:
        px, py, pz = cross((ux, uy, uz), (ax, ay, az))
        nx, ny, nz = cross((px, py, pz), (ux, uy, uz))
        return 2, nx, ny, nz
    return 1, ax, ay, az


@inline
def quick(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error):
    """Decide most pairs of plain cores (no radii, no margin) in a few rounds, all in registers.

    The simplex is walked by the signs of a few products only, with no closest point. What it finds is proven
    the same way as in `gjk.run`: a support plane clear of the origin, or a tetrahedron that holds it clear
    of rounding. Everything else is UNSETTLED and goes to `gjk.run`.

    Returns
    -------
    status : int
    x, y, z : float
        The direction reached, from A to B.
    points : int
        Of the simplex; 0 if the first direction settled the pair.
    """
    px, py, pz = -nx, -ny, -nz
    k = 0
    # Newest point first. Rows b, c, d hold what is left of the older ones.
    bx = by = bz = cx = cy = cz = ex = ey = ez = 0.0
    largest = 0.0
    for _ in range(QUICK_ROUNDS):
        ux, uy, uz, vx, vy, vz = _supports(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, px, py, pz
        )
        ax, ay, az = ux - vx, uy - vy, uz - vz
        plane = px * ax + py * ay + pz * az
        length = np.sqrt(px * px + py * py + pz * pz)
        if plane > error * length:
            return APART, -px, -py, -pz, k
        largest = max(largest, abs(ax) + abs(ay) + abs(az))
        if k == 0:
            k = 1
            bx, by, bz = ax, ay, az
            # As in `near`: between the first direction and that of the first point.
            kept = KEPT / length
            rest = (1.0 - KEPT) / np.sqrt(ax * ax + ay * ay + az * az)
            px = kept * px + rest * ax
            py = kept * py + rest * ay
            pz = kept * pz + rest * az
            continue
        if k == 3:
            # Which of the three faces at the new point does the origin lie beyond? b, c, e run
            # counter-clockwise seen from the new point.
            doubt = 64.0 * UNIT_ROUNDOFF * largest * largest * largest
            b1x, b1y, b1z = bx - ax, by - ay, bz - az
            c1x, c1y, c1z = cx - ax, cy - ay, cz - az
            e1x, e1y, e1z = ex - ax, ey - ay, ez - az
            fx, fy, fz = cross((b1x, b1y, b1z), (c1x, c1y, c1z))
            gx, gy, gz = cross((c1x, c1y, c1z), (e1x, e1y, e1z))
            hx, hy, hz = cross((e1x, e1y, e1z), (b1x, b1y, b1z))
            f = -(fx * ax + fy * ay + fz * az)
            g = -(gx * ax + gy * ay + gz * az)
            h = -(hx * ax + hy * ay + hz * az)
            if f <= 0.0 and g <= 0.0 and h <= 0.0:
                volume = abs(fx * e1x + fy * e1y + fz * e1z)
                # The origin is inside if the three and the base, f + g + h + base = -volume, are all clear.
                if f < -doubt and g < -doubt and h < -doubt and volume + (f + g + h) > doubt:
                    return TOUCHING, -px, -py, -pz, k
                return UNSETTLED, -px, -py, -pz, k
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
            fx, fy, fz = cross((b1x, b1y, b1z), (c1x, c1y, c1z))
            qx, qy, qz = cross((fx, fy, fz), (c1x, c1y, c1z))
            rx, ry, rz = cross((b1x, b1y, b1z), (fx, fy, fz))
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
            return UNSETTLED, -nx, -ny, -nz, k
    return UNSETTLED, -px, -py, -pz, k


@inline
def _triangle(ax, ay, az, px, py, pz, qx, qy, qz):
    """Part of a triangle that is nearest to the origin, if the newest point a belongs to it.

    Returns
    -------
    part : int
        0: a, 1: the edge ap, 2: the edge aq, 3: the inside. -1: a part without a, or rounding.
    nx, ny, nz : float
        Normal of that part away from the origin, square to the part to full precision unless the triangle is thin.
    """
    ux, uy, uz = px - ax, py - ay, pz - az
    wx, wy, wz = qx - ax, qy - ay, qz - az
    along_p = ax * ux + ay * uy + az * uz
    along_q = ax * wx + ay * wy + az * wz
    nx, ny, nz = cross((ux, uy, uz), (wx, wy, wz))
    mx, my, mz = cross((ax, ay, az), (ux, uy, uz))
    lx, ly, lz = cross((ax, ay, az), (wx, wy, wz))
    # Barycentric coordinates of the origin's foot, times the squared area.
    of_q = nx * mx + ny * my + nz * mz
    of_p = -(nx * lx + ny * ly + nz * lz)
    if of_p > 0.0 and of_q > 0.0:
        if of_p + of_q > nx * nx + ny * ny + nz * nz:
            return -1, ax, ay, az
        sign = np.copysign(1.0, nx * ax + ny * ay + nz * az)
        return 3, sign * nx, sign * ny, sign * nz
    if along_p >= 0.0 and along_q >= 0.0:
        return 0, ax, ay, az
    if of_q <= 0.0 and along_p < 0.0:
        nx, ny, nz = cross((ux, uy, uz), (mx, my, mz))
        return 1 if px * ux + py * uy + pz * uz > 0.0 else -1, nx, ny, nz
    if of_p <= 0.0 and along_q < 0.0:
        nx, ny, nz = cross((wx, wy, wz), (lx, ly, lz))
        return 2 if qx * wx + qy * wy + qz * wz > 0.0 else -1, nx, ny, nz
    return -1, ax, ay, az


@njit()
def _squared_distance(ax, ay, az, px, py, pz, qx, qy, qz):
    """Squared distance of the origin from a triangle whose newest point a belongs to the nearest part."""
    part, nx, ny, nz = _triangle(ax, ay, az, px, py, pz, qx, qy, qz)
    if part < 0:
        return np.inf
    height = nx * ax + ny * ay + nz * az
    return height * height / (nx * nx + ny * ny + nz * nz)


@njit()
def _nearest_face(beyond_e, beyond_b, beyond_c, ax, ay, az, bx, by, bz, cx, cy, cz, ex, ey, ez):
    """Of the faces at the newest point a that the origin lies beyond, the nearest: 0 abc, 1 ace, 2 aeb."""
    d0 = _squared_distance(ax, ay, az, bx, by, bz, cx, cy, cz) if beyond_e > 0.0 else np.inf
    d1 = _squared_distance(ax, ay, az, cx, cy, cz, ex, ey, ez) if beyond_b > 0.0 else np.inf
    d2 = _squared_distance(ax, ay, az, ex, ey, ez, bx, by, bz) if beyond_c > 0.0 else np.inf
    if d0 <= d1 and d0 <= d2:
        return 0
    return 1 if d1 <= d2 else 2


@njit()
def _squared_off(nx, ny, nz, ux, uy, uz, wx, wy, wz):
    """Take out of n its parts along two edges, the longer one last; twice, for what the first pass rounded."""
    if ux * ux + uy * uy + uz * uz > wx * wx + wy * wy + wz * wz:
        ux, uy, uz, wx, wy, wz = wx, wy, wz, ux, uy, uz
    u = 1.0 / (ux * ux + uy * uy + uz * uz)
    w = 1.0 / (wx * wx + wy * wy + wz * wz)
    for _ in range(2):
        t = u * (nx * ux + ny * uy + nz * uz)
        nx, ny, nz = nx - t * ux, ny - t * uy, nz - t * uz
        t = w * (nx * wx + ny * wy + nz * wz)
        nx, ny, nz = nx - t * wx, ny - t * wy, nz - t * wz
    return nx, ny, nz


@inline
def near(
    ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, nx, ny, nz, error, reach, far, result
):
    """Distance of two cores, or on which side of a margin it is.

    A round keeps the part of the simplex nearest to the origin and searches along that part's own normal (see
    `simplex.direction`), as `gjk.run` does.

    Parameters
    ----------
    nx, ny, nz : float
        First direction, from A to B; not zero.
    error : float
        `gjk.rounding_error`.
    reach, far : float
        Stop as soon as the distance is known to be at most `reach`, or more than `far`; -inf and inf for the distance.
    result : ndarray, shape (9,)
        Receives for NEAREST the unit normal from A to B and the two nearest points.

    Returns
    -------
    status : int
        NEAREST, APART (more than `far`), TOUCHING (at most `reach`), INSIDE or UNSETTLED.
    lower, upper : float
        Bounds on the distance of the cores.
    """
    scale = -1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    px, py, pz = scale * nx, scale * ny, scale * nz
    first_x, first_y, first_z = px, py, pz
    k = 0
    # The simplex b, c, e, the newest first, and the rounds its points come from.
    bx = by = bz = cx = cy = cz = ex = ey = ez = 0.0
    from_b = from_c = from_e = 0
    largest = 0.0
    lower = -np.inf
    length = np.inf
    status = UNSETTLED
    for r in range(NEAR_ROUNDS):
        if r == 1:
            # The first direction is good already, that of the first point poor: between them lies what saves a round.
            ox = KEPT * first_x + (1.0 - KEPT) * px
            oy = KEPT * first_y + (1.0 - KEPT) * py
            oz = KEPT * first_z + (1.0 - KEPT) * pz
        else:
            ox, oy, oz = px, py, pz
        sx, sy, sz, tx, ty, tz = _supports(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, W, ends_a, ends_b, ox, oy, oz
        )
        m = _PATH + 6 * r
        W[m], W[m + 1], W[m + 2], W[m + 3], W[m + 4], W[m + 5] = sx, sy, sz, tx, ty, tz
        ax, ay, az = sx - tx, sy - ty, sz - tz
        plane = px * ax + py * ay + pz * az
        closed = length - plane <= DISTANCE_TOLERANCE * length + ERROR_SHARE * error
        if r == 1:
            if closed:
                continue  # no nearer to the origin; nor is the plane a bound, as it is square to another direction
        else:
            if plane - error > lower:
                lower = plane - error
            if lower > far:
                status = APART
                break
            if k > 0:
                if closed:
                    status = NEAREST
                    break
                if (
                    (ax == bx and ay == by and az == bz)
                    or (k > 1 and ax == cx and ay == cy and az == cz)
                    or (k > 2 and ax == ex and ay == ey and az == ez)
                ):
                    if length - lower <= LAST_GAP * error:
                        status = NEAREST
                    break
        largest = max(largest, abs(ax) + abs(ay) + abs(az))
        if k == 0:
            k = 1
            nx, ny, nz = ax, ay, az
        elif k == 1:
            k, nx, ny, nz = _edge(ax, ay, az, bx, by, bz)
            if k == 2:
                cx, cy, cz, from_c = bx, by, bz, from_b
        else:
            if k == 3:
                b1x, b1y, b1z = bx - ax, by - ay, bz - az
                c1x, c1y, c1z = cx - ax, cy - ay, cz - az
                e1x, e1y, e1z = ex - ax, ey - ay, ez - az
                fx, fy, fz = cross((b1x, b1y, b1z), (c1x, c1y, c1z))
                gx, gy, gz = cross((c1x, c1y, c1z), (e1x, e1y, e1z))
                hx, hy, hz = cross((e1x, e1y, e1z), (b1x, b1y, b1z))
                # Positive: the origin lies beyond the face opposite e, b, c.
                volume = fx * e1x + fy * e1y + fz * e1z
                sign = np.copysign(1.0, volume)
                beyond_e = sign * (fx * ax + fy * ay + fz * az)
                beyond_b = sign * (gx * ax + gy * ay + gz * az)
                beyond_c = sign * (hx * ax + hy * ay + hz * az)
                count = (beyond_e > 0.0) + (beyond_b > 0.0) + (beyond_c > 0.0)
                if count == 0:
                    doubt = 64.0 * UNIT_ROUNDOFF * largest * largest * largest
                    # The base, -|volume| less the other three, must be clear too: a flat tetrahedron's sign is noise.
                    base = -(abs(volume) + beyond_e + beyond_b + beyond_c)
                    if beyond_e < -doubt and beyond_b < -doubt and beyond_c < -doubt and base < -doubt:
                        status = INSIDE
                    break
                if count == 1:
                    face = (beyond_b > 0.0) + 2 * (beyond_c > 0.0)
                else:
                    face = _nearest_face(beyond_e, beyond_b, beyond_c, ax, ay, az, bx, by, bz, cx, cy, cz, ex, ey, ez)
                if face == 1:
                    bx, by, bz, from_b = ex, ey, ez, from_e
                elif face == 2:
                    cx, cy, cz, from_c = ex, ey, ez, from_e
            part, nx, ny, nz = _triangle(ax, ay, az, bx, by, bz, cx, cy, cz)
            if part < 0:
                break
            if part == 3:
                k = 3
                ux, uy, uz = bx - ax, by - ay, bz - az
                wx, wy, wz = cx - ax, cy - ay, cz - az
                edges = (ux * ux + uy * uy + uz * uz) * (wx * wx + wy * wy + wz * wz)
                if nx * nx + ny * ny + nz * nz < THIN * edges:
                    nx, ny, nz = _squared_off(nx, ny, nz, ux, uy, uz, wx, wy, wz)
                ex, ey, ez, from_e = cx, cy, cz, from_c
                cx, cy, cz, from_c = bx, by, bz, from_b
            elif part == 0:
                k = 1
            else:
                k = 2
                if part == 1:
                    cx, cy, cz, from_c = bx, by, bz, from_b
        bx, by, bz, from_b = ax, ay, az, r
        before = length
        scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
        px, py, pz = scale * nx, scale * ny, scale * nz
        length = px * bx + py * by + pz * bz
        if length <= reach:
            status = TOUCHING
            break
        # No progress, or too near to contact for these products: `gjk.run` is more careful.
        if not (4.0 * error < length < before):
            break
    if status == NEAREST:
        wb, wc, we = 1.0, 0.0, 0.0
        if k == 2:
            wc = segment_weight(bx, by, bz, cx, cy, cz)
            wb = 1.0 - wc
        elif k == 3:
            wb, wc, we = triangle_weights(bx, by, bz, cx, cy, cz, ex, ey, ez)
        result[0], result[1], result[2] = -px, -py, -pz
        for c in range(6):
            result[3 + c] = (
                wb * W[_PATH + 6 * from_b + c] + wc * W[_PATH + 6 * from_c + c] + we * W[_PATH + 6 * from_e + c]
            )
    return status, lower, length
