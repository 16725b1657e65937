"""Verdicts for ranges of pairs: the ellipsoids of many piece pairs at once, then the rest one by one.

Piece pairs are queued in lanes, `LANES` at a time, as a structure of arrays in one flat scratch
array with compile-time row offsets; that is what lets the compiler prove the rows apart and use
vector instructions in `_outer_stage` and `_inner_stage`.

The k-th pair of a batch of shape (s0, s1, ...) uses row Σ index_d · stride_d of each operand
(two bodies, two pose arrays): broadcasting without copies.
"""

import numpy as np
from numba import prange

from loewner._kernels._jit import inline, njit
from loewner._kernels.contact import (
    POSITION_ROUNDINGS,
    UNIT_ROUNDOFF,
    maximize,
    nearness,
    rotated,
    separation,
)
from loewner._kernels.epa import CONTACT_ACCURACY, penetration, workspace
from loewner._kernels.gjk import APART, TOUCH_ROUNDINGS, TOUCHING, rounding_error, run, swollen_radii
from loewner._kernels.shapes import (
    INNER_CENTER,
    INNER_SHAPE,
    INNER_SIGMA,
    OUTER_CENTER,
    OUTER_RADIUS,
    OUTER_SHAPE,
    REACH,
    core_height,
    inside_by,
)

FREE, COLLIDING, AMBIGUOUS = 0, 1, 2
CERTIFY, EXACT, ESTIMATE = 0, 1, 2

# Who settled a piece pair.
BY_SPHERE, BY_OUTER, BY_INNER, BY_SUPPORT, BY_POINT, BY_SEARCH, OPEN = 0, 1, 2, 3, 4, 5, 6
TIERS = 7

LANES = 64
# A hull's face plane may miss its own vertices by 1e-11 of the piece (`hulls.FACE_WIDTH`), so a point
# must lie four times deeper than that to be surely inside; 6000 rounding errors are 4.3e-11.
FACE_ROUNDINGS = 6000.0

NEWTON_STEPS = 4  # guarded Newton steps a lane gets; enough for s to 1e-6, and the witness decides anyway

# Rows of the scratch array.
ROT_A, ROT_B, SHAPE_A, SHAPE_B, OFFSET = 0, 9, 18, 24, 30
SIZE, SIGMA_A, SIGMA_B = 33, 34, 35
OUT_BOUND, OUT_NORMAL, OUT_F, OUT_WIDTH = 36, 37, 40, 41
IN_LEVEL, IN_DISTANCE, IN_NORMAL, IN_POINT, IN_F = 42, 43, 44, 47, 50
ROWS = 51


@inline
def row_of(k, shape, strides):
    """Row an operand contributes to pair k."""
    if shape.shape[0] == 1:
        return k * strides[0]
    row = 0
    rest = k
    for d in range(shape.shape[0] - 1, -1, -1):
        above = rest // shape[d]
        row += (rest - above * shape[d]) * strides[d]
        rest = above
    return row


@inline
def _place(S, row, lane, table, piece, T, shape_column):
    """Copy rotation and shape matrix of one operand into a lane."""
    rotation = row * 9
    for a in range(3):
        for b in range(3):
            S[(rotation + 3 * a + b) * LANES + lane] = T[a, b]
    for c in range(6):
        S[(SHAPE_A + row * 6 + c) * LANES + lane] = table[piece, shape_column + c]


@inline
def _center_offset(ta, i, Ta, tb, j, Tb, column):
    """World vector from a's to b's ellipsoid center; the translations are subtracted first."""
    ax, ay, az = ta[i, column], ta[i, column + 1], ta[i, column + 2]
    bx, by, bz = tb[j, column], tb[j, column + 1], tb[j, column + 2]
    x = (Tb[0, 3] - Ta[0, 3]) + (
        (Tb[0, 0] * bx + Tb[0, 1] * by + Tb[0, 2] * bz) - (Ta[0, 0] * ax + Ta[0, 1] * ay + Ta[0, 2] * az)
    )
    y = (Tb[1, 3] - Ta[1, 3]) + (
        (Tb[1, 0] * bx + Tb[1, 1] * by + Tb[1, 2] * bz) - (Ta[1, 0] * ax + Ta[1, 1] * ay + Ta[1, 2] * az)
    )
    z = (Tb[2, 3] - Ta[2, 3]) + (
        (Tb[2, 0] * bx + Tb[2, 1] * by + Tb[2, 2] * bz) - (Ta[2, 0] * ax + Ta[2, 1] * ay + Ta[2, 2] * az)
    )
    return x, y, z


@inline
def _world_shapes(S, lane):
    """The two shape matrices of a lane, rotated into the world's axes."""
    p = rotated(
        S[0 * LANES + lane], S[1 * LANES + lane], S[2 * LANES + lane], S[3 * LANES + lane],
        S[4 * LANES + lane], S[5 * LANES + lane], S[6 * LANES + lane], S[7 * LANES + lane],
        S[8 * LANES + lane], S[18 * LANES + lane], S[19 * LANES + lane], S[20 * LANES + lane],
        S[21 * LANES + lane], S[22 * LANES + lane], S[23 * LANES + lane],
    )  # fmt: skip
    q = rotated(
        S[9 * LANES + lane], S[10 * LANES + lane], S[11 * LANES + lane], S[12 * LANES + lane],
        S[13 * LANES + lane], S[14 * LANES + lane], S[15 * LANES + lane], S[16 * LANES + lane],
        S[17 * LANES + lane], S[24 * LANES + lane], S[25 * LANES + lane], S[26 * LANES + lane],
        S[27 * LANES + lane], S[28 * LANES + lane], S[29 * LANES + lane],
    )  # fmt: skip
    return p, q


@njit()
def _outer_stage(S, count):
    """Certified lower bound on the distance of the outer ellipsoids, for each lane."""
    for lane in range(count):
        (p0, p1, p2, p3, p4, p5), (q0, q1, q2, q3, q4, q5) = _world_shapes(S, lane)
        x = S[OFFSET * LANES + lane]
        y = S[(OFFSET + 1) * LANES + lane]
        z = S[(OFFSET + 2) * LANES + lane]
        F, _, nx, ny, nz = maximize(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, NEWTON_STEPS)
        S[OUT_BOUND * LANES + lane] = separation(
            p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, S[SIZE * LANES + lane]
        )
        S[OUT_NORMAL * LANES + lane] = nx
        S[(OUT_NORMAL + 1) * LANES + lane] = ny
        S[(OUT_NORMAL + 2) * LANES + lane] = nz
        S[OUT_F * LANES + lane] = F
        S[OUT_WIDTH * LANES + lane] = (nx * x + ny * y + nz * z) / np.sqrt(nx * nx + ny * ny + nz * nz)


@njit()
def _inner_stage(S, count):
    """Certified nearness of the inner ellipsoids, for each lane."""
    for lane in range(count):
        (p0, p1, p2, p3, p4, p5), (q0, q1, q2, q3, q4, q5) = _world_shapes(S, lane)
        x = S[OFFSET * LANES + lane]
        y = S[(OFFSET + 1) * LANES + lane]
        z = S[(OFFSET + 2) * LANES + lane]
        F, s, nx, ny, nz = maximize(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, NEWTON_STEPS)
        level, distance, _, ax, ay, az, bx, by, bz = nearness(
            p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, s,
            S[SIGMA_A * LANES + lane], S[SIGMA_B * LANES + lane], S[SIZE * LANES + lane],
        )  # fmt: skip
        S[IN_LEVEL * LANES + lane] = level
        S[IN_DISTANCE * LANES + lane] = distance
        S[IN_NORMAL * LANES + lane] = nx
        S[(IN_NORMAL + 1) * LANES + lane] = ny
        S[(IN_NORMAL + 2) * LANES + lane] = nz
        S[IN_POINT * LANES + lane] = 0.5 * (ax + bx)
        S[(IN_POINT + 1) * LANES + lane] = 0.5 * (ay + by)
        S[(IN_POINT + 2) * LANES + lane] = 0.5 * (az + bz)
        S[IN_F * LANES + lane] = F


@inline
def _padded(count):
    """Round up to whole vectors, so that the compiler's remainder loop has nothing to do."""
    return (count + 7) // 8 * 8


@njit()
def support_gap(a, i, Ta, b, j, Tb, dx, dy, dz, nx, ny, nz):
    """Certified lower bound on the distance of two pieces along a direction from a to b."""
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not (0.0 < length < np.inf):
        return -np.inf
    nx /= length
    ny /= length
    nz /= length
    ahead = core_height(a[0], a[1], a[2], i, Ta, nx, ny, nz)
    behind = core_height(b[0], b[1], b[2], j, Tb, -nx, -ny, -nz)
    gap = (nx * dx + ny * dy + nz * dz) - ahead - behind - swollen_radii(a[0], i, Ta, b[0], j, Tb)
    return gap - rounding_error(a[0], i, b[0], j, dx, dy, dz)


@njit()
def holds_point(a, i, T, x, y, z, error):
    """Tell whether a point, relative to the body's translation, is surely inside a placed piece."""
    # Rᵀ maps the point back; it inverts R only as far as R is orthonormal, hence a check of the
    # way forth: the point tested is R y, within `error` of the point meant.
    u = T[0, 0] * x + T[1, 0] * y + T[2, 0] * z
    v = T[0, 1] * x + T[1, 1] * y + T[2, 1] * z
    w = T[0, 2] * x + T[1, 2] * y + T[2, 2] * z
    rx = T[0, 0] * u + T[0, 1] * v + T[0, 2] * w - x
    ry = T[1, 0] * u + T[1, 1] * v + T[1, 2] * w - y
    rz = T[2, 0] * u + T[2, 1] * v + T[2, 2] * w - z
    away = np.sqrt(rx * rx + ry * ry + rz * rz)
    return inside_by(a[0], a[1], a[3], i, u, v, w) > error + 2.0 * away


@njit()
def exact_piece_pair(a, i, Ta, b, j, Tb, margin, ox, oy, oz, ix, iy, iz, px, py, pz, S, weights, v, d):
    """Settle one piece pair that the ellipsoids left ambiguous.

    Parameters
    ----------
    ox, oy, oz, ix, iy, iz : float
        Contact normals of the outer and of the inner ellipsoids.
    px, py, pz : float
        Point of both inner ellipsoids' neighbourhood, relative to a's inner center (world axes).

    Returns
    -------
    verdict, tier : int
        AMBIGUOUS with tier OPEN if the search could not settle it.
    """
    dx = Tb[0, 3] - Ta[0, 3]
    dy = Tb[1, 3] - Ta[1, 3]
    dz = Tb[2, 3] - Ta[2, 3]
    outer_gap = support_gap(a, i, Ta, b, j, Tb, dx, dy, dz, ox, oy, oz)
    if outer_gap > margin:
        return FREE, BY_SUPPORT
    inner_gap = support_gap(a, i, Ta, b, j, Tb, dx, dy, dz, ix, iy, iz)
    if inner_gap > margin:
        return FREE, BY_SUPPORT
    error = rounding_error(a[0], i, b[0], j, dx, dy, dz)
    c = INNER_CENTER
    table = a[0]
    x = px + Ta[0, 0] * table[i, c] + Ta[0, 1] * table[i, c + 1] + Ta[0, 2] * table[i, c + 2]
    y = py + Ta[1, 0] * table[i, c] + Ta[1, 1] * table[i, c + 1] + Ta[1, 2] * table[i, c + 2]
    z = pz + Ta[2, 0] * table[i, c] + Ta[2, 1] * table[i, c + 1] + Ta[2, 2] * table[i, c + 2]
    depth = error * FACE_ROUNDINGS
    if holds_point(a, i, Ta, x, y, z, depth) and holds_point(b, j, Tb, x - dx, y - dy, z - dz, depth):
        return COLLIDING, BY_POINT
    if inner_gap > outer_gap:
        ox, oy, oz = ix, iy, iz
    if not ox * ox + oy * oy + oz * oz > 0.0:
        ox, oy, oz = 1.0, 0.0, 0.0
    status, _, _, _ = run(
        a[0], a[1], a[2], i, Ta, b[0], b[1], b[2], j, Tb, dx, dy, dz, ox, oy, oz, margin, True, S, weights, v, d
    )
    if status == APART:
        return FREE, BY_SEARCH
    if status == TOUCHING:
        return COLLIDING, BY_SEARCH
    # Curved pieces that barely overlap can make GJK creep. The expanding polytope sees the same
    # contact from inside; its work space is made only here, where hardly any pair ever comes.
    work = workspace(True)
    shallow, deep = penetration(
        a[0], a[1], a[2], i, Ta, b[0], b[1], b[2], j, Tb, dx, dy, dz, CONTACT_ACCURACY,
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], np.empty(9),
    )  # fmt: skip
    radii = swollen_radii(a[0], i, Ta, b[0], j, Tb)
    if -deep - radii - error > margin:
        return FREE, BY_SEARCH
    if shallow + radii >= -margin - TOUCH_ROUNDINGS * error:
        return COLLIDING, BY_SEARCH
    return AMBIGUOUS, OPEN


@inline
def estimated_distance(F_outer, F_inner, width):
    """Distance that the two contact functions suggest; negative exactly if F_outer F_inner < 1.

    √F is the factor by which both ellipsoids must grow to touch. The geometric mean g of the outer
    and the inner factor is taken for the pieces' own; pieces whose width along the normal times g
    equals the centers' offset along it are apart by offset (1 - 1/g).
    """
    g = np.sqrt(np.sqrt(max(F_outer * F_inner, 0.0)))
    return width * (1.0 - 1.0 / g) if g > 0.0 else -np.inf


@njit()
def _flush(mode, margin, a, Ta, b, Tb, count, lane_pair, lane_i, lane_j, lane_ka, lane_kb, keep, S, G, weights, v, d,
           out, tally):  # fmt: skip
    """Settle the queued lanes and merge them into the verdicts of their pairs."""
    ta = a[0]
    tb = b[0]
    for lane in range(count):
        i, j = lane_i[lane], lane_j[lane]
        _place(S, 0, lane, ta, i, Ta[lane_ka[lane]], OUTER_SHAPE)
        _place(S, 1, lane, tb, j, Tb[lane_kb[lane]], OUTER_SHAPE)
    padded = _padded(count)
    for lane in range(count, padded):
        for row in range(SIGMA_B + 1):
            S[row * LANES + lane] = S[row * LANES]
    _outer_stage(S, padded)
    # Survivors move up to the front; what the later stages need of the outer stage moves along.
    left = 0
    for lane in range(count):
        if S[OUT_BOUND * LANES + lane] > margin:
            tally[BY_OUTER] += 1
            continue
        if out[lane_pair[lane]] == COLLIDING:
            continue
        keep[left] = lane
        for row in range(OUT_BOUND, OUT_WIDTH + 1):
            S[row * LANES + left] = S[row * LANES + lane]
        i, j = lane_i[lane], lane_j[lane]
        A = Ta[lane_ka[lane]]
        B = Tb[lane_kb[lane]]
        _place(S, 0, left, ta, i, A, INNER_SHAPE)
        _place(S, 1, left, tb, j, B, INNER_SHAPE)
        x, y, z = _center_offset(ta, i, A, tb, j, B, INNER_CENTER)
        S[OFFSET * LANES + left] = x
        S[(OFFSET + 1) * LANES + left] = y
        S[(OFFSET + 2) * LANES + left] = z
        S[SIZE * LANES + left] = S[SIZE * LANES + lane]
        S[SIGMA_A * LANES + left] = ta[i, INNER_SIGMA]
        S[SIGMA_B * LANES + left] = tb[j, INNER_SIGMA]
        left += 1
    if left == 0:
        return
    padded = _padded(left)
    for lane in range(left, padded):
        for row in range(SIGMA_B + 1):
            S[row * LANES + lane] = S[row * LANES]
    _inner_stage(S, padded)
    for m in range(left):
        lane = keep[m]
        pair = lane_pair[lane]
        if out[pair] == COLLIDING:
            continue
        if S[IN_LEVEL * LANES + m] <= 1.0 or S[IN_DISTANCE * LANES + m] <= margin:
            out[pair] = COLLIDING
            tally[BY_INNER] += 1
        elif mode == EXACT:
            verdict, tier = exact_piece_pair(
                a, lane_i[lane], Ta[lane_ka[lane]], b, lane_j[lane], Tb[lane_kb[lane]], margin,
                S[OUT_NORMAL * LANES + m], S[(OUT_NORMAL + 1) * LANES + m], S[(OUT_NORMAL + 2) * LANES + m],
                S[IN_NORMAL * LANES + m], S[(IN_NORMAL + 1) * LANES + m], S[(IN_NORMAL + 2) * LANES + m],
                S[IN_POINT * LANES + m], S[(IN_POINT + 1) * LANES + m], S[(IN_POINT + 2) * LANES + m],
                G, weights, v, d,
            )  # fmt: skip
            tally[tier] += 1
            if verdict != FREE:
                out[pair] = verdict
        elif mode == ESTIMATE:
            tally[OPEN] += 1
            # Written so that NaN, which only a broken input could bring this far, counts as colliding.
            if not estimated_distance(S[OUT_F * LANES + m], S[IN_F * LANES + m], S[OUT_WIDTH * LANES + m]) > margin:
                out[pair] = COLLIDING
        else:
            tally[OPEN] += 1
            out[pair] = AMBIGUOUS


@njit()
def settle_range(mode, margin, start, stop, shape, a, body_a, Ta, pose_a, b, body_b, Tb, pose_b, out, tally):
    """Settle pairs start .. stop.

    Parameters
    ----------
    mode : int
        CERTIFY, EXACT or ESTIMATE.
    margin : float
        Distance that pairs must keep, >= 0.
    shape : ndarray of int64, shape (d,)
        Batch shape; `body_a` ... `pose_b` are the strides of the four operands, in rows.
    a, b : tuple of ndarray
        Packed pieces, see `shapes`.
    Ta, Tb : ndarray, shape (..., 4, 4), one batch axis
    out : ndarray of int8
        Receives the verdicts; AMBIGUOUS in mode EXACT means that the search did not settle the pair.
    tally : ndarray of int64, shape (TIERS,)
        Piece pairs settled by each tier are added here.
    """
    S = np.empty(ROWS * LANES)
    G = np.empty((4, 9))
    weights = np.empty(4)
    v = np.empty(3)
    d = np.empty(3)
    lane_pair = np.empty(LANES, np.int64)
    lane_i = np.empty(LANES, np.int64)
    lane_j = np.empty(LANES, np.int64)
    lane_ka = np.empty(LANES, np.int64)
    lane_kb = np.empty(LANES, np.int64)
    keep = np.empty(LANES, np.int64)
    ta = a[0]
    tb = b[0]
    count = 0
    for k in range(start, stop):
        out[k] = FREE
        ia = row_of(k, shape, body_a)
        ib = row_of(k, shape, body_b)
        ka = row_of(k, shape, pose_a)
        kb = row_of(k, shape, pose_b)
        A = Ta[ka]
        B = Tb[kb]
        apart = abs(B[0, 3] - A[0, 3]) + abs(B[1, 3] - A[1, 3]) + abs(B[2, 3] - A[2, 3])
        for i in range(a[4][ia], a[4][ia + 1]):
            for j in range(b[4][ib], b[4][ib + 1]):
                if out[k] == COLLIDING:
                    break
                x, y, z = _center_offset(ta, i, A, tb, j, B, OUTER_CENTER)
                size = apart + ta[i, REACH] + tb[j, REACH]
                radii = ta[i, OUTER_RADIUS] + tb[j, OUTER_RADIUS] + margin
                if np.sqrt(x * x + y * y + z * z) * (1.0 - 8.0 * UNIT_ROUNDOFF) > radii + POSITION_ROUNDINGS * size:
                    tally[BY_SPHERE] += 1
                    continue
                S[OFFSET * LANES + count] = x
                S[(OFFSET + 1) * LANES + count] = y
                S[(OFFSET + 2) * LANES + count] = z
                S[SIZE * LANES + count] = size
                # The outer stage asks for no smallest semi-axis; the rows are filled for the padding's sake.
                S[SIGMA_A * LANES + count] = 1.0
                S[SIGMA_B * LANES + count] = 1.0
                lane_pair[count] = k
                lane_i[count] = i
                lane_j[count] = j
                lane_ka[count] = ka
                lane_kb[count] = kb
                count += 1
                if count == LANES:
                    _flush(mode, margin, a, Ta, b, Tb, count, lane_pair, lane_i, lane_j, lane_ka, lane_kb, keep, S,
                           G, weights, v, d, out, tally)  # fmt: skip
                    count = 0
    if count > 0:
        _flush(mode, margin, a, Ta, b, Tb, count, lane_pair, lane_i, lane_j, lane_ka, lane_kb, keep, S, G, weights,
               v, d, out, tally)  # fmt: skip


@njit(parallel=True)
def settle_parallel(mode, margin, chunk, shape, a, body_a, Ta, pose_a, b, body_b, Tb, pose_b, out, tallies):
    """`settle_range` over chunks of pairs on all threads; each chunk has its own tally row."""
    n = out.shape[0]
    for c in prange(tallies.shape[0]):
        settle_range(
            mode, margin, c * chunk, min(n, (c + 1) * chunk), shape, a, body_a, Ta, pose_a, b, body_b, Tb, pose_b,
            out, tallies[c],
        )  # fmt: skip
