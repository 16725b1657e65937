"""The vectorised stages of the certificate: many piece pairs side by side.

A scratch array holds one row per quantity and one column per piece pair (lane), flat, with
compile-time row offsets: that is what lets the compiler prove the rows apart and use vector
instructions. Every loop here is branch-free over lanes; the queue around it is in `batch`.

Three stages, each for the lanes the one before left open:

near
    vector between the outer centers; bounding spheres.
outer
    a separating direction for the outer ellipsoids. The maximizer of the contact function is
    guessed from the widths along r, s = h_a / (h_a + h_b), which is exact for spheres; K(s)⁻¹ r is then
    a direction good enough for 999 in 1,000 separable pairs of round pieces.
inner
    a common point of the inner ellipsoids at the same kind of guess.

Each says besides whether a better s could still change the answer; only those few lanes iterate
(`_refined_outer`, `_refined_inner` in `batch`). The full stages, which iterate in every lane, serve queries with a
margin, which need near points.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.contact import (
    POSITION_ROUNDINGS,
    UNIT_ROUNDOFF,
    adjugate,
    maximize,
    nearness,
    rotated,
    separation,
    times,
)

LANES = 64
NEWTON_STEPS = 6  # of the full stages; s is then good to 1e-9 for round pieces, 1e-3 for plates of 1 : 0.05

ROT_A, ROT_B, SHAPE_A, SHAPE_B, CENTER_A, CENTER_B, SHIFT = 0, 9, 18, 24, 30, 33, 36
RADII, REACHES, SIZE, SIGMA_A, SIGMA_B, OFFSET = 39, 40, 41, 42, 43, 44
INPUTS = 47
NEAR = 47  # how much farther apart than their bounding spheres allow; positive means FREE
OUT_BOUND, OUT_NORMAL, OUT_DOUBT = 48, 49, 52
IN_LEVEL, IN_DISTANCE, IN_NORMAL, IN_POINT, IN_DOUBT = 53, 54, 55, 58, 61
ROWS = 62


@inline
def _rotation(S, lane, row):
    k = row * LANES + lane
    return (
        S[k], S[k + LANES], S[k + 2 * LANES], S[k + 3 * LANES], S[k + 4 * LANES], S[k + 5 * LANES],
        S[k + 6 * LANES], S[k + 7 * LANES], S[k + 8 * LANES],
    )  # fmt: skip


@inline
def _six(S, lane, row):
    k = row * LANES + lane
    return S[k], S[k + LANES], S[k + 2 * LANES], S[k + 3 * LANES], S[k + 4 * LANES], S[k + 5 * LANES]


@inline
def _three(S, lane, row):
    k = row * LANES + lane
    return S[k], S[k + LANES], S[k + 2 * LANES]


@inline
def _put_three(S, lane, row, x, y, z):
    k = row * LANES + lane
    S[k] = x
    S[k + LANES] = y
    S[k + 2 * LANES] = z


@inline
def _turned(r00, r01, r02, r10, r11, r12, r20, r21, r22, x, y, z):
    return r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z, r20 * x + r21 * y + r22 * z


@inline
def guess(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z):
    """Contact normal at the guessed s, without iterating.

    Returns
    -------
    s, nx, ny, nz : float
        n = K(s)⁻¹ r.
    F, most : float
        F(s), and what F cannot exceed anywhere.
    """
    px, py, pz = times(p0, p1, p2, p3, p4, p5, x, y, z)
    qx, qy, qz = times(q0, q1, q2, q3, q4, q5, x, y, z)
    hp = np.sqrt(max(px * x + py * y + pz * z, 0.0))
    hq = np.sqrt(max(qx * x + qy * y + qz * z, 0.0))
    s = (hp + 1e-300) / (hp + hq + 2e-300)
    u = 1.0 - s
    k0 = u * p0 + s * q0
    k1 = u * p1 + s * q1
    k2 = u * p2 + s * q2
    k3 = u * p3 + s * q3
    k4 = u * p4 + s * q4
    k5 = u * p5 + s * q5
    a0, a1, a2, a3, a4, a5 = adjugate(k0, k1, k2, k3, k4, k5)
    d = k0 * a0 + k1 * a1 + k2 * a2
    nx, ny, nz = times(a0, a1, a2, a3, a4, a5, x, y, z)
    nx /= d
    ny /= d
    nz /= d
    F = s * u * (nx * x + ny * y + nz * z)
    return s, nx, ny, nz, F, highest(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, s, F, nx, ny, nz)


@inline
def highest(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, s, F, nx, ny, nz):
    """What F cannot exceed anywhere: it is concave and its slope at s is (1-s)² nᵀPn - s² nᵀQn."""
    px, py, pz = times(p0, p1, p2, p3, p4, p5, nx, ny, nz)
    qx, qy, qz = times(q0, q1, q2, q3, q4, q5, nx, ny, nz)
    u = 1.0 - s
    slope = u * u * (px * nx + py * ny + pz * nz) - s * s * (qx * nx + qy * ny + qz * nz)
    return F + abs(slope) * max(s, u)


def _stages(posed):
    """Compile the stages for posed operands, or for operands whose rotations are all the identity."""

    @inline
    def shapes(S, lane):
        p = _six(S, lane, SHAPE_A)
        q = _six(S, lane, SHAPE_B)
        if posed:
            p = rotated(*_rotation(S, lane, ROT_A), *p)
            q = rotated(*_rotation(S, lane, ROT_B), *q)
        return p, q

    @inline
    def offset(S, lane):
        ax, ay, az = _three(S, lane, CENTER_A)
        bx, by, bz = _three(S, lane, CENTER_B)
        if posed:
            ax, ay, az = _turned(*_rotation(S, lane, ROT_A), ax, ay, az)
            bx, by, bz = _turned(*_rotation(S, lane, ROT_B), bx, by, bz)
        tx, ty, tz = _three(S, lane, SHIFT)
        return tx + (bx - ax), ty + (by - ay), tz + (bz - az)

    @njit()
    def near_stage(S, count):
        for lane in range(count):
            x, y, z = offset(S, lane)
            _put_three(S, lane, OFFSET, x, y, z)
            tx, ty, tz = _three(S, lane, SHIFT)
            size = abs(tx) + abs(ty) + abs(tz) + S[REACHES * LANES + lane]
            S[SIZE * LANES + lane] = size
            apart = np.sqrt(x * x + y * y + z * z) * (1.0 - 8.0 * UNIT_ROUNDOFF)
            S[NEAR * LANES + lane] = apart - S[RADII * LANES + lane] - POSITION_ROUNDINGS * size

    @njit()
    def outer_stage(S, count):
        for lane in range(count):
            p, q = shapes(S, lane)
            x, y, z = _three(S, lane, OFFSET)
            _, nx, ny, nz, _, most = guess(*p, *q, x, y, z)
            _put_three(S, lane, OUT_NORMAL, nx, ny, nz)
            S[OUT_BOUND * LANES + lane] = separation(*p, *q, x, y, z, nx, ny, nz, S[SIZE * LANES + lane])
            S[OUT_DOUBT * LANES + lane] = most

    @njit()
    def inner_stage(S, count):
        for lane in range(count):
            p, q = shapes(S, lane)
            x, y, z = offset(S, lane)
            s, nx, ny, nz, F, _ = guess(*p, *q, x, y, z)
            level, _, _, ax, ay, az, bx, by, bz = nearness(
                *p, *q, x, y, z, nx, ny, nz, s, S[SIGMA_A * LANES + lane], S[SIGMA_B * LANES + lane],
                S[SIZE * LANES + lane],
            )  # fmt: skip
            S[IN_LEVEL * LANES + lane] = level
            _put_three(S, lane, IN_NORMAL, nx, ny, nz)
            _put_three(S, lane, IN_POINT, 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
            S[IN_DOUBT * LANES + lane] = F

    @njit()
    def full_outer_stage(S, count):
        for lane in range(count):
            p, q = shapes(S, lane)
            x, y, z = _three(S, lane, OFFSET)
            F, s, nx, ny, nz = maximize(*p, *q, x, y, z, NEWTON_STEPS)
            _put_three(S, lane, OUT_NORMAL, nx, ny, nz)
            S[OUT_BOUND * LANES + lane] = separation(*p, *q, x, y, z, nx, ny, nz, S[SIZE * LANES + lane])
            S[OUT_DOUBT * LANES + lane] = highest(*p, *q, s, F, nx, ny, nz)

    @njit()
    def full_inner_stage(S, count):
        for lane in range(count):
            p, q = shapes(S, lane)
            x, y, z = offset(S, lane)
            F, s, nx, ny, nz = maximize(*p, *q, x, y, z, NEWTON_STEPS)
            level, distance, _, ax, ay, az, bx, by, bz = nearness(
                *p, *q, x, y, z, nx, ny, nz, s, S[SIGMA_A * LANES + lane], S[SIGMA_B * LANES + lane],
                S[SIZE * LANES + lane],
            )  # fmt: skip
            S[IN_LEVEL * LANES + lane] = level
            S[IN_DISTANCE * LANES + lane] = distance
            _put_three(S, lane, IN_NORMAL, nx, ny, nz)
            _put_three(S, lane, IN_POINT, 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
            S[IN_DOUBT * LANES + lane] = F

    return near_stage, outer_stage, inner_stage, full_outer_stage, full_inner_stage


posed_near, posed_outer, posed_inner, posed_full_outer, posed_full_inner = _stages(True)
plain_near, plain_outer, plain_inner, plain_full_outer, plain_full_inner = _stages(False)
