"""Certified bounds on the distance of two bodies, estimates of it, and the exact value.

All distances are signed: negative is the penetration depth. A body's distance is the least over its
piece pairs.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.batch import row_of
from loewner._kernels.contact import (
    SHAPE_ROUNDINGS,
    UNIT_ROUNDOFF,
    maximize,
    nearness,
    outward_width,
    rotated,
    separation,
)
from loewner._kernels.curved import is_round, round_distance
from loewner._kernels.epa import CONTACT_ACCURACY, DEPTH_ACCURACY, FLAT, penetration, workspace
from loewner._kernels.gjk import UNSETTLED, rounding_error, run
from loewner._kernels.near_points import estimate_f
from loewner._kernels.polytope_depth import SETTLED as DEPTH_SETTLED
from loewner._kernels.polytope_depth import UNSETTLED as DEPTH_UNSETTLED
from loewner._kernels.polytope_depth import overlap_depth
from loewner._kernels.polytope_depth import workspace as depth_workspace
from loewner._kernels.shapes import (
    INNER_CENTER,
    INNER_SHAPE,
    INNER_SIGMA,
    KIND,
    OUTER_CENTER,
    OUTER_SHAPE,
    POLYTOPE,
    REACH,
    ROUNDING,
)

CONTACT_PRODUCT = -1  # the other rules are those of `near_points`

BOUND_STEPS = 12  # Newton steps for the contact function of a single pair
POLISH_ROUNDS = 4  # rounds n <- (near point of b) - (near point of a) that tighten a bound

# A distance is settled when its bounds are this close, relative to the lengths involved.
SETTLED = 1e-9

# Curved pieces other than ellipsoids and balls may tie in every direction: the depth found is then right to rounding,
# but the 1,500 points of the expanding polytope prove it to 4e-4 only. Such a depth is returned: it is that of
# a plane and two witnesses, never less than the true one.
SETTLED_CURVED = 1e-3

SETTLED_DISTANCE, NOT_SETTLED = 0, 1


@njit()
def _world_shape(table, piece, column, T):
    row = table[piece]
    return rotated(
        T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2], T[2, 0], T[2, 1], T[2, 2],
        row[column], row[column + 1], row[column + 2], row[column + 3], row[column + 4], row[column + 5],
    )  # fmt: skip


@njit()
def world_center(table, piece, column, T):
    """Ellipsoid center in the world's axes, relative to the body's translation."""
    x, y, z = table[piece, column], table[piece, column + 1], table[piece, column + 2]
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z,
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z,
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z,
    )


@njit()
def _offset(ta, i, Ta, tb, j, Tb, column):
    ax, ay, az = world_center(ta, i, column, Ta)
    bx, by, bz = world_center(tb, j, column, Tb)
    return (Tb[0, 3] - Ta[0, 3]) + (bx - ax), (Tb[1, 3] - Ta[1, 3]) + (by - ay), (Tb[2, 3] - Ta[2, 3]) + (bz - az)


@njit()
def outer_bound(ta, i, Ta, tb, j, Tb, size):
    """Certified lower bound on the signed distance, with its normal, F, and the centers' offset along it."""
    p0, p1, p2, p3, p4, p5 = _world_shape(ta, i, OUTER_SHAPE, Ta)
    q0, q1, q2, q3, q4, q5 = _world_shape(tb, j, OUTER_SHAPE, Tb)
    x, y, z = _offset(ta, i, Ta, tb, j, Tb, OUTER_CENTER)
    F, _, nx, ny, nz = maximize(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, BOUND_STEPS)
    squared = nx * nx + ny * ny + nz * nz
    if not squared > 0.0:  # concentric: any direction gives a valid bound
        nx, ny, nz, squared = 1.0, 0.0, 0.0, 1.0
    width = (nx * x + ny * y + nz * z) / np.sqrt(squared)
    best = separation(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, size)
    bx, by, bz = nx, ny, nz
    for _ in range(POLISH_ROUNDS):
        if not best > 0.0:
            break
        squared = nx * nx + ny * ny + nz * nz
        hp, px, py, pz = outward_width(p0, p1, p2, p3, p4, p5, nx, ny, nz, squared)
        hq, qx, qy, qz = outward_width(q0, q1, q2, q3, q4, q5, nx, ny, nz, squared)
        nx = x - qx / hq - px / hp
        ny = y - qy / hq - py / hp
        nz = z - qz / hq - pz / hp
        bound = separation(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, size)
        if bound > best:
            best = bound
            bx, by, bz = nx, ny, nz
    return best, bx, by, bz, F, width


@njit()
def inner_bound(ta, i, Ta, tb, j, Tb, size):
    """Certified upper bound on the signed distance, and F."""
    p0, p1, p2, p3, p4, p5 = _world_shape(ta, i, INNER_SHAPE, Ta)
    q0, q1, q2, q3, q4, q5 = _world_shape(tb, j, INNER_SHAPE, Tb)
    x, y, z = _offset(ta, i, Ta, tb, j, Tb, INNER_CENTER)
    F, s, nx, ny, nz = maximize(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, BOUND_STEPS)
    sigma_a, sigma_b = ta[i, INNER_SIGMA], tb[j, INNER_SIGMA]
    level, best, depth, _, _, _, _, _, _ = nearness(
        p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, s, sigma_a, sigma_b, size
    )
    if level <= 1.0:
        return -max(depth, 0.0), F
    if not best < np.inf:  # NaN: the centers are points of the ellipsoids too
        best = np.sqrt(x * x + y * y + z * z) * (1.0 + 8.0 * UNIT_ROUNDOFF) + SHAPE_ROUNDINGS * size
    for _ in range(POLISH_ROUNDS):
        squared = nx * nx + ny * ny + nz * nz
        length = np.sqrt(squared)
        hp, px, py, pz = outward_width(p0, p1, p2, p3, p4, p5, nx, ny, nz, squared)
        hq, qx, qy, qz = outward_width(q0, q1, q2, q3, q4, q5, nx, ny, nz, squared)
        # Divide by a little more than the width, so that rounding cannot push the points outside.
        la = hp + SHAPE_ROUNDINGS * (p0 + p3 + p5) * length / sigma_a
        lb = hq + SHAPE_ROUNDINGS * (q0 + q3 + q5) * length / sigma_b
        nx = x - qx / lb - px / la
        ny = y - qy / lb - py / la
        nz = z - qz / lb - pz / la
        distance = np.sqrt(nx * nx + ny * ny + nz * nz) * (1.0 + 8.0 * UNIT_ROUNDOFF) + SHAPE_ROUNDINGS * size
        if distance < best:
            best = distance
    return best, F


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
def exact_piece_distance(ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, nx, ny, nz, G, weights, v, d, work, W, K,
                         result):  # fmt: skip
    """Signed distance of two pieces, not both of them ellipsoids or balls.

    `result` (9,) receives the unit normal from a to b and the witnesses relative to a's translation.

    Returns
    -------
    distance, gap : float
        The signed distance of the witnesses, and how far the bounds on it are apart.
    """
    dx = Tb[kb, 0, 3] - Ta[ka, 0, 3]
    dy = Tb[kb, 1, 3] - Ta[ka, 1, 3]
    dz = Tb[kb, 2, 3] - Ta[ka, 2, 3]
    error = rounding_error(ta, i, tb, j, dx, dy, dz)
    if not nx * nx + ny * ny + nz * nz > 0.0:
        nx, ny, nz = 1.0, 0.0, 0.0
    status, lower, upper, k = run(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, nx, ny, nz, 0.0, False, G, weights, v, d
    )
    ra = ta[i, ROUNDING]
    rb = tb[j, ROUNDING]
    if k < 4 and upper + ra + rb > 4.0 * error and status != UNSETTLED:
        gap = upper - lower
        for c in range(3):
            result[c] = -d[c]
        for c in range(6):
            result[3 + c] = 0.0
            for row in range(k):
                result[3 + c] += weights[row] * G[row, 3 + c]
    else:
        if la[i, KIND] == POLYTOPE and lb[j, KIND] == POLYTOPE:
            searched, shallow, deep = overlap_depth(
                ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, nx, ny, nz, W, K, result
            )
            if searched == DEPTH_SETTLED:
                return -deep, deep - shallow
        S, corners, neighbors, normals, offsets, alive, free, horizon, stack = work
        # The depth sought is the upper bound: the support plane of the normal that comes with it.
        accuracy = DEPTH_ACCURACY if k == 4 else CONTACT_ACCURACY
        shallow, deep = penetration(
            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, accuracy,
            S, corners, neighbors, normals, offsets, alive, free, horizon, stack, result,
        )  # fmt: skip
        if deep == FLAT:
            for c in range(6):
                result[3 + c] = 0.0
                for row in range(k):
                    result[3 + c] += weights[row] * G[row, 3 + c]
        if deep == FLAT and upper + ra + rb > 4.0 * error:
            # Cores that are apart after all: what GJK has, with the gap it has.
            for c in range(3):
                result[c] = -d[c]
            gap = upper - lower
        else:
            if deep == FLAT:
                shallow = 0.0
                deep = 0.0
            upper = -deep - ra - rb
            gap = deep - shallow
    for c in range(3):
        result[3 + c] += ra * result[c]
        result[6 + c] -= rb * result[c]
    return upper, gap


@njit()
def distance_range(exact, rule, start, stop, plan, a, Ta, b, Tb, factors, lower, upper, estimate, distance,
                   witness_a, witness_b, normal, status):  # fmt: skip
    """Distances of pairs start .. stop, operands as in `batch`; the last five arrays are written only if `exact`."""
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    ta, la, xa = a[0], a[1], a[2]
    tb, lb, xb = b[0], b[1], b[2]
    G = np.empty((4, 9))
    weights = np.empty(4)
    v = np.empty(3)
    d = np.empty(3)
    result = np.empty(9)
    work = workspace(exact)
    W, K = depth_workspace(exact)
    ai, ao, bi, bo = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    Fai, Fao, Fbi, Fbo = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(start, stop):
        ia = row_of(k, shape, body_a)
        ib = row_of(k, shape, body_b)
        ka = row_of(k, shape, pose_a)
        kb = row_of(k, shape, pose_b)
        A = Ta[ka]
        B = Tb[kb]
        lower[k] = np.inf
        upper[k] = np.inf
        estimate[k] = np.inf
        if exact:
            distance[k] = np.inf
            status[k] = SETTLED_DISTANCE
        apart = abs(B[0, 3] - A[0, 3]) + abs(B[1, 3] - A[1, 3]) + abs(B[2, 3] - A[2, 3])
        for i in range(a[4][ia], a[4][ia + 1]):
            for j in range(b[4][ib], b[4][ib + 1]):
                size = apart + ta[i, REACH] + tb[j, REACH]
                below, nx, ny, nz, F_outer, width = outer_bound(ta, i, A, tb, j, B, size)
                above, F_inner = inner_bound(ta, i, A, tb, j, B, size)
                if not below > -np.inf:  # NaN from an overflow: the weakest bound is still a bound
                    below = -2.0 * size
                lower[k] = min(lower[k], below)
                upper[k] = min(upper[k], above)
                if rule == CONTACT_PRODUCT:
                    guess = estimated_distance(F_outer, F_inner, width)
                else:
                    _world_ellipsoid(ta, factors[0], i, A, B, INNER_CENTER, ai, Fai, False)
                    _world_ellipsoid(ta, factors[1], i, A, B, OUTER_CENTER, ao, Fao, False)
                    _world_ellipsoid(tb, factors[2], j, B, A, INNER_CENTER, bi, Fbi, True)
                    _world_ellipsoid(tb, factors[3], j, B, A, OUTER_CENTER, bo, Fbo, True)
                    guess = estimate_f(rule, ai, Fai, ao, Fao, bi, Fbi, bo, Fbo)
                estimate[k] = min(estimate[k], max(below, min(above, guess)))
                if exact and below < distance[k]:
                    curved = la[i, KIND] != POLYTOPE or lb[j, KIND] != POLYTOPE
                    proven = is_round(la, i) and is_round(lb, j)
                    searched = DEPTH_UNSETTLED
                    if proven:
                        value, gap = round_distance(ta, la, i, Ta, ka, tb, lb, j, Tb, kb, nx, ny, nz, size, result)
                    elif not curved and F_outer * F_inner < 1.0:  # they overlap, by the look of it
                        searched, shallow, deep = overlap_depth(
                            ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, nx, ny, nz, W, K, result
                        )
                        value, gap = -deep, deep - shallow
                    if not proven and searched != DEPTH_SETTLED:
                        value, gap = exact_piece_distance(
                            ta,
                            la,
                            xa,
                            i,
                            Ta,
                            ka,
                            tb,
                            lb,
                            xb,
                            j,
                            Tb,
                            kb,
                            nx,
                            ny,
                            nz,
                            G,
                            weights,
                            v,
                            d,
                            work,
                            W,
                            K,
                            result,
                        )
                    gap = min(gap, value - below)  # the ellipsoids' own bound may be the better one
                    if not gap <= (SETTLED_CURVED if curved and value < 0.0 and not proven else SETTLED) * size:
                        status[k] = NOT_SETTLED
                    if value < distance[k]:
                        distance[k] = value
                        for c in range(3):
                            normal[k, c] = result[c]
                            witness_a[k, c] = result[3 + c] + A[c, 3]
                            witness_b[k, c] = result[6 + c] + A[c, 3]
        if exact:
            # The bounds are proven, the value is computed: where rounding puts it outside, they know better.
            distance[k] = max(lower[k], min(upper[k], distance[k]))


@njit()
def _world_ellipsoid(table, factors, piece, T, other, column, center, factor, second):
    """Center (relative to the first body's translation) and factor in the world's axes."""
    x, y, z = world_center(table, piece, column, T)
    center[0], center[1], center[2] = x, y, z
    if second:
        for c in range(3):
            center[c] += T[c, 3] - other[c, 3]
    for r in range(3):
        for c in range(3):
            factor[r, c] = 0.0
            for m in range(3):
                factor[r, c] += T[r, m] * factors[piece, m, c]


@njit()
def rule_range(rule, margin, start, stop, plan, a, Ta, b, Tb, factors, out):
    """Decide the pairs left AMBIGUOUS in `out` by a rule: the product of the contact functions, or the paper's f."""
    ai, ao, bi, bo = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    Fai, Fao, Fbi, Fbo = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    ta = a[0]
    tb = b[0]
    for k in range(start, stop):
        if out[k] != 2:
            continue
        out[k] = 0
        ia = row_of(k, shape, body_a)
        ib = row_of(k, shape, body_b)
        A = Ta[row_of(k, shape, pose_a)]
        B = Tb[row_of(k, shape, pose_b)]
        apart = abs(B[0, 3] - A[0, 3]) + abs(B[1, 3] - A[1, 3]) + abs(B[2, 3] - A[2, 3])
        for i in range(a[4][ia], a[4][ia + 1]):
            for j in range(b[4][ib], b[4][ib + 1]):
                size = apart + ta[i, REACH] + tb[j, REACH]
                below, _, _, _, F_outer, width = outer_bound(ta, i, A, tb, j, B, size)
                if below > margin:
                    continue
                if rule == CONTACT_PRODUCT:
                    _, F_inner = inner_bound(ta, i, A, tb, j, B, size)
                    if not estimated_distance(F_outer, F_inner, width) > margin:
                        out[k] = 1
                    continue
                _world_ellipsoid(ta, factors[0], i, A, B, INNER_CENTER, ai, Fai, False)
                _world_ellipsoid(ta, factors[1], i, A, B, OUTER_CENTER, ao, Fao, False)
                _world_ellipsoid(tb, factors[2], j, B, A, INNER_CENTER, bi, Fbi, True)
                _world_ellipsoid(tb, factors[3], j, B, A, OUTER_CENTER, bo, Fbo, True)
                # NaN counts as colliding, as it should never arise and must not free anybody.
                if not estimate_f(rule, ai, Fai, ao, Fao, bi, Fbi, bo, Fbo) > margin:
                    out[k] = 1
