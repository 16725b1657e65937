"""GJK on many open pairs of small polytopes: sixteen pairs side by side in registers, whatever each of them meets.

First the plane across the contact normal of the outer ellipsoids: it separates four in ten open pairs. For the others a
walk by the signs of a few products, with no closest point: every round searches the vertices of both pieces once and
takes all cases of the simplex together, each pair choosing its own. Two or three rounds more settle most.

The walk is in single precision. What it finds is proven nonetheless, by a support plane clear of the origin or by a
tetrahedron of points of A - B that holds it, both clear of what that precision rounds (docs/certified.md). Pairs
nearer to contact, two in a thousand, have no proof here and are left to `pair_search`; so nothing a pair is told
depends on how it was reached or on the pairs beside it.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; Ericson, Real-Time Collision Detection (2005), section 5.1.
"""

import numpy as np

from loewner._kernels import blocks
from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.blocks import extent
from loewner._kernels.contact import POSITION_ROUNDINGS, cross, dot, turned, turned_back
from loewner._kernels.lanes import (
    PAIR,
    PIECE_A,
    PIECE_B,
    POSE_A,
    POSE_B,
    SINGLE_ROUNDOFF,
    rounded_size,
    single_pose_of,
    turns,
)
from loewner._kernels.pair_search import KEPT
from loewner._kernels.shapes import HOT, KIND, POINTS_FROM, POINTS_TO, POLYTOPE, REACH
from loewner._kernels.vectors import (
    SINGLE_ALL,
    SINGLE_LANES,
    bits,
    choose,
    larger,
    load_rounded,
    load_single,
    mark,
    root,
    single_column,
    single_columns,
    spread,
    store_apart,
)

# What `settle` says of a pair.
OPEN, APART, TOUCHING = 0, 1, 2

ROUNDS = 10  # five settle nine in ten pairs, eight all but one in a hundred

FEW = 4  # pairs that are sooner searched one by one

MOST = 64  # vertices of a piece: more and sixteen pairs leave the first-level cache

# Errors in units of the roundoff, each twice what docs/certified.md derives: of a product with a support point, all in
# single precision or only in what `plane` rounds, times the lengths; of a product of three points, times the third
# power of the largest, and of a sum of four such products; of three points together, times the lengths and the square.
PRODUCT_ERROR, WIDTH_ERROR, VOLUME_ERROR, SUM_ERROR, POINT_ERROR = 72.0, 16.0, 98.0, 632.0, 64.0

SHORT = 1e-30  # directions whose square is less are not trusted: it may be short of digits

VERTEX = 3 * SINGLE_LANES  # entries that one vertex of each of sixteen pieces takes

# After the rows of the list, PAIR .. POSE_B: first and last block of vertices of each piece, and the one to read.
FIRST_A, LAST_A, FIRST_B, LAST_B, HERE = 5, 6, 7, 8, 9


@njit()
def workspace():
    """Make the arrays that serve any number of walks in turn.

    Returns
    -------
    L : ndarray of int64
        Sixteen pairs, rows PAIR .. POSE_B, and more to write to.
    N : ndarray
        Their directions, rows x, y and z.
    W : ndarray of float32
        To write to.
    found : ndarray of int8, shape (16,)
        What `settle` says of them.
    """
    return (
        np.empty((HERE + 1) * SINGLE_LANES, np.int64),
        np.empty(3 * SINGLE_LANES),
        np.empty(2 * MOST * VERTEX, np.float32),
        np.empty(SINGLE_LANES, np.int8),
    )


@inline
def put(work, at, k, i, j, ka, kb, nx, ny, nz):
    """List a pair: its number, its pieces and their poses, a direction from a to b."""
    L, N = work[0], work[1]
    at = np.uint64(at)
    for row, value in ((PAIR, k), (PIECE_A, i), (PIECE_B, j), (POSE_A, ka), (POSE_B, kb)):
        L[np.uint64(row * SINGLE_LANES) + at] = value
    for row, part in ((0, nx), (1, ny), (2, nz)):
        N[np.uint64(row * SINGLE_LANES) + at] = part


@inline
def walks(layout, piece):
    """Tell whether a piece is one that the functions below take."""
    piece = np.uint64(piece)  # not from the end
    return (layout[piece, KIND] == POLYTOPE) & (layout[piece, POINTS_TO] - layout[piece, POINTS_FROM] <= MOST)


@inline
def _blocks(layout, L, pieces, first):
    """Write the first and the last block of vertices of each piece to L; how many blocks the largest one has."""
    most = np.int64(0)
    for lane in range(SINGLE_LANES):
        piece = L[pieces * SINGLE_LANES + lane]
        begin, end = layout[piece, POINTS_FROM] // blocks.BLOCK, layout[piece, POINTS_TO] // blocks.BLOCK - 1
        L[first * SINGLE_LANES + lane] = begin
        L[(first + 1) * SINGLE_LANES + lane] = end
        most = max(most, end - begin + 1)
    return most


@inline
def _block(points, L, first, b):
    """The b-th block of vertices of each piece: eight x, eight y and eight z. The last one stands for those beyond."""
    for lane in range(SINGLE_LANES):
        here = min(L[first * SINGLE_LANES + lane] + b, L[(first + 1) * SINGLE_LANES + lane])
        L[HERE * SINGLE_LANES + lane] = here
    width, at = 3 * blocks.BLOCK, HERE * SINGLE_LANES
    return (
        single_columns(points, width, L, at, 0),
        single_columns(points, width, L, at, blocks.BLOCK),
        single_columns(points, width, L, at, 2 * blocks.BLOCK),
    )


@inline
def _lay(points, L, first, most, W, at):
    """Write the vertices of sixteen pieces side by side from W[at] on; returns where they end."""
    for b in range(most):
        px, py, pz = _block(points, L, first, b)
        store_apart(W, at, VERTEX, px)
        store_apart(W, at + SINGLE_LANES, VERTEX, py)
        store_apart(W, at + 2 * SINGLE_LANES, VERTEX, pz)
        at += blocks.BLOCK * VERTEX
    return at


@inline
def _farthest(W, start, stop, x, y, z):
    """Of each piece's vertices in W the one with the largest product with its direction."""
    # Two searches that take turns: each step of one waits for its step before.
    ax, ay, az = load_single(W, start), load_single(W, start + SINGLE_LANES), load_single(W, start + 2 * SINGLE_LANES)
    bx, by, bz = (
        load_single(W, start + VERTEX),
        load_single(W, start + VERTEX + SINGLE_LANES),
        load_single(W, start + VERTEX + 2 * SINGLE_LANES),
    )
    a = ax * x + ay * y + az * z
    b = bx * x + by * y + bz * z
    for at in range(start + 2 * VERTEX, stop, 2 * VERTEX):
        px, py, pz = load_single(W, at), load_single(W, at + SINGLE_LANES), load_single(W, at + 2 * SINGLE_LANES)
        product = px * x + py * y + pz * z
        more = product > a
        a, ax, ay, az = choose(more, product, a), choose(more, px, ax), choose(more, py, ay), choose(more, pz, az)
        px, py, pz = (
            load_single(W, at + VERTEX),
            load_single(W, at + VERTEX + SINGLE_LANES),
            load_single(W, at + VERTEX + 2 * SINGLE_LANES),
        )
        product = px * x + py * y + pz * z
        more = product > b
        b, bx, by, bz = choose(more, product, b), choose(more, px, bx), choose(more, py, by), choose(more, pz, bz)
    more = b > a
    return choose(more, bx, ax), choose(more, by, ay), choose(more, bz, az)


@inline
def plane(sa, la, xa, i, Ta, r, sb, lb, xb, j, Tb, q, x, y, z):
    """Tell whether the plane across a direction from a to b surely separates two pieces, margin 0.

    Parameters
    ----------
    sa, la, xa, i, Ta, r : ndarray, ndarray, ndarray, int, ndarray, int
        Of a: hot columns and vertices in single precision and layout (see `shapes`), piece; poses, and which. Of b the
        same. The pieces are such that `walks`.
    """
    i, r, j, q = np.uint64(i), np.uint64(r), np.uint64(j), np.uint64(q)  # not from the end
    tx, ty, tz = Tb[q, 0, 3] - Ta[r, 0, 3], Tb[q, 1, 3] - Ta[r, 1, 3], Tb[q, 2, 3] - Ta[r, 2, 3]
    width_a = extent(
        xa, la[i, POINTS_FROM], la[i, POINTS_TO],
        np.float32(Ta[r, 0, 0] * x + Ta[r, 1, 0] * y + Ta[r, 2, 0] * z),
        np.float32(Ta[r, 0, 1] * x + Ta[r, 1, 1] * y + Ta[r, 2, 1] * z),
        np.float32(Ta[r, 0, 2] * x + Ta[r, 1, 2] * y + Ta[r, 2, 2] * z),
    )  # fmt: skip
    width_b = extent(
        xb, lb[j, POINTS_FROM], lb[j, POINTS_TO],
        np.float32(-(Tb[q, 0, 0] * x + Tb[q, 1, 0] * y + Tb[q, 2, 0] * z)),
        np.float32(-(Tb[q, 0, 1] * x + Tb[q, 1, 1] * y + Tb[q, 2, 1] * z)),
        np.float32(-(Tb[q, 0, 2] * x + Tb[q, 1, 2] * y + Tb[q, 2, 2] * z)),
    )  # fmt: skip
    gap = x * tx + y * ty + z * tz - (np.float64(width_a) + np.float64(width_b))
    error = WIDTH_ERROR * SINGLE_ROUNDOFF * (np.float64(sa[i, REACH]) + np.float64(sb[j, REACH]))
    error += POSITION_ROUNDINGS * (abs(tx) + abs(ty) + abs(tz))
    squared = x * x + y * y + z * z
    # What is longer may overflow single precision.
    return (gap > error * np.sqrt(squared)) & (squared > SHORT) & (squared < 1.0 / SHORT)


@inline
def _directions(N):
    """The directions to start from; any, where there is none."""
    x, y, z = load_rounded(N, 0), load_rounded(N, SINGLE_LANES), load_rounded(N, 2 * SINGLE_LANES)
    given = dot(x, y, z, x, y, z) > SHORT
    return choose(given, x, 1.0), choose(given, y, 0.0), choose(given, z, 0.0)


@njit()
def settle(count, sa, la, xa, Ta, moved_a, sb, lb, xb, Tb, moved_b, work):
    """Walk the simplex of each of the listed pairs, margin 0.

    Parameters
    ----------
    count : int
        Pairs in the list, at least 1.
    sa, la, xa, Ta : ndarray
        Of a: hot columns and vertices in single precision and layout (see `shapes`), and poses; of b the same.
    moved_a, moved_b : bool
        False if the operand's only pose is the identity.
    work : tuple of ndarray
        See `workspace`. The pieces are such that `walks`; `found` receives APART, TOUCHING or OPEN.
    """
    L, N, W, found = work
    L, N, W, found = borrowed(L), borrowed(N), borrowed(W), borrowed(found)
    for lane in range(count, SINGLE_LANES):
        for row in range(PIECE_A, POSE_B + 1):
            L[row * SINGLE_LANES + lane] = L[row * SINGLE_LANES + count - 1]
        for row in range(3):
            N[row * SINGLE_LANES + lane] = N[row * SINGLE_LANES + count - 1]
    a = single_pose_of(Ta, L, POSE_A * SINGLE_LANES, moved_a)
    b = single_pose_of(Tb, L, POSE_B * SINGLE_LANES, moved_b)
    turned_a = moved_a and bits(turns(a)) != 0
    turned_b = moved_b and bits(turns(b)) != 0
    reach_a = single_column(sa, HOT, L, PIECE_A * SINGLE_LANES, REACH)
    reach_b = single_column(sb, HOT, L, PIECE_B * SINGLE_LANES, REACH)
    size = rounded_size(a, reach_a, b, reach_b)
    error = PRODUCT_ERROR * SINGLE_ROUNDOFF * size
    tx, ty, tz = b[9] - a[9], b[10] - a[10], b[11] - a[11]
    ends_a = _lay(xa, L, FIRST_A, _blocks(la, L, PIECE_A, FIRST_A), W, np.int64(0))
    ends_b = _lay(xb, L, FIRST_B, _blocks(lb, L, PIECE_B, FIRST_B), W, ends_a)

    # The simplex, newest point first: one, two or three points of A - B. The direction p leads from the origin
    # to the part of it that is kept.
    px, py, pz = _directions(N)
    px, py, pz = -px, -py, -pz
    bx, by, bz = px, py, pz
    cx, cy, cz = px, py, pz
    ex, ey, ez = px, py, pz
    none = ~((px > 0.0) | ~(px > 0.0))
    two, three = none, none
    apart, touching = none, none
    largest = spread(np.float32(0.0))
    for r in range(ROUNDS):
        ux, uy, uz = -px, -py, -pz
        vx, vy, vz = px, py, pz
        if turned_a:
            ux, uy, uz = turned_back(a, ux, uy, uz)
        if turned_b:
            vx, vy, vz = turned_back(b, vx, vy, vz)
        ux, uy, uz = _farthest(W, np.int64(0), ends_a, ux, uy, uz)
        vx, vy, vz = _farthest(W, ends_a, ends_b, vx, vy, vz)
        if turned_a:
            ux, uy, uz = turned(a, ux, uy, uz)
        if turned_b:
            vx, vy, vz = turned(b, vx, vy, vz)
        ax, ay, az = ux - (vx + tx), uy - (vy + ty), uz - (vz + tz)
        squared = dot(px, py, pz, px, py, pz)
        length = root(squared)
        apart = apart | ((dot(px, py, pz, ax, ay, az) > error * length) & (squared > SHORT))
        if bits(apart | touching) == SINGLE_ALL:
            break
        largest = larger(largest, dot(ax, ay, az, ax, ay, az))
        if r == 0:
            # Between the first direction and that of the first point lies what saves a round.
            kept = np.float32(KEPT) / length
            rest = np.float32(1.0 - KEPT) / root(dot(ax, ay, az, ax, ay, az))
            px, py, pz = kept * px + rest * ax, kept * py + rest * ay, kept * pz + rest * az
            bx, by, bz = ax, ay, az
            continue

        # Of a tetrahedron the origin is inside, or beyond some face at the new point; b, c, e run
        # counter-clockwise seen from there.
        b1x, b1y, b1z = bx - ax, by - ay, bz - az
        c1x, c1y, c1z = cx - ax, cy - ay, cz - az
        e1x, e1y, e1z = ex - ax, ey - ay, ez - az
        fx, fy, fz = cross(b1x, b1y, b1z, c1x, c1y, c1z)
        gx, gy, gz = cross(c1x, c1y, c1z, e1x, e1y, e1z)
        hx, hy, hz = cross(e1x, e1y, e1z, b1x, b1y, b1z)
        f = -dot(fx, fy, fz, ax, ay, az)
        g = -dot(gx, gy, gz, ax, ay, az)
        h = -dot(hx, hy, hz, ax, ay, az)
        # The origin is inside if the three and the base, volume - f - g - h, are all negative, clear of rounding.
        reach = root(largest)
        slack = SINGLE_ROUNDOFF * largest * (VOLUME_ERROR * reach + POINT_ERROR * size)
        base = dot(fx, fy, fz, e1x, e1y, e1z) - (f + g + h)
        inside = (f < -slack) & (g < -slack) & (h < -slack)
        inside = inside & (base < -SINGLE_ROUNDOFF * largest * (SUM_ERROR * reach + POINT_ERROR * size))
        touching = touching | (three & inside)
        if bits(apart | touching) == SINGLE_ALL:
            break
        # The face to go on with, as the triangle a, b, c.
        second = three & (g > f) & (g >= h)
        third = three & (h > f) & (h > g)
        bx, by, bz, cx, cy, cz = (
            choose(second, cx, choose(third, ex, bx)),
            choose(second, cy, choose(third, ey, by)),
            choose(second, cz, choose(third, ez, bz)),
            choose(second, ex, choose(third, bx, cx)),
            choose(second, ey, choose(third, by, cy)),
            choose(second, ez, choose(third, bz, cz)),
        )
        plane = two | three

        # Of a triangle the origin is over the inside, or beyond the edge a b or a c.
        b1x, b1y, b1z = bx - ax, by - ay, bz - az
        c1x, c1y, c1z = cx - ax, cy - ay, cz - az
        fx, fy, fz = cross(b1x, b1y, b1z, c1x, c1y, c1z)
        qx, qy, qz = cross(fx, fy, fz, c1x, c1y, c1z)
        rx, ry, rz = cross(b1x, b1y, b1z, fx, fy, fz)
        beyond_c = plane & (dot(qx, qy, qz, ax, ay, az) < 0.0)
        beyond_b = dot(rx, ry, rz, ax, ay, az) < 0.0
        line = beyond_b | beyond_c | ~plane
        swap = beyond_c & (dot(c1x, c1y, c1z, ax, ay, az) < 0.0)
        bx, by, bz = choose(swap, cx, bx), choose(swap, cy, by), choose(swap, cz, bz)

        # Of a line the origin is beside the inside, or beyond a.
        ux, uy, uz = bx - ax, by - ay, bz - az
        beside = dot(ux, uy, uz, ax, ay, az) < 0.0
        qx, qy, qz = cross(ux, uy, uz, ax, ay, az)
        qx, qy, qz = cross(qx, qy, qz, ux, uy, uz)
        two = line & beside
        three = ~line
        # Turned so that a, b, c runs counter-clockwise seen from the origin.
        other = dot(fx, fy, fz, ax, ay, az) <= 0.0
        px = choose(three, choose(other, -fx, fx), choose(beside, qx, ax))
        py = choose(three, choose(other, -fy, fy), choose(beside, qy, ay))
        pz = choose(three, choose(other, -fz, fz), choose(beside, qz, az))
        ex, ey, ez = choose(other, cx, bx), choose(other, cy, by), choose(other, cz, bz)
        shift = line | other
        cx, cy, cz = choose(shift, bx, cx), choose(shift, by, cy), choose(shift, bz, cz)
        bx, by, bz = ax, ay, az
    mark(found, 0, apart | ~apart, OPEN)
    mark(found, 0, touching, TOUCHING)
    mark(found, 0, apart, APART)
