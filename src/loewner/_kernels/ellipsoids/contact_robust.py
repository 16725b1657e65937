"""The contact function of many ellipsoid pairs, with a careful path for thin or grazing ellipsoids."""

import math

from loewner._kernels._jit import inline, njit
from loewner._kernels.ellipsoids import near_points as near
from loewner._kernels.ellipsoids.contact import contact
from loewner._kernels.linalg3 import apply, dot, matrix, shape_matrix

# The polynomial coefficients of `contact` have errors of about tr(Q)³/det(Q) roundings. The value of F from `contact`
# is used if its relative error is at most TRUSTED_LOSS and it differs from 1 by more than GRAZING. Closer to 1, the
# error could change the answer.
TRUSTED_LOSS = 1e-10
GRAZING = 1e-8


@inline
def _loss(Q):
    """Relative error of the determinant of a shape matrix due to rounding."""
    trace = Q[0] + Q[3] + Q[5]
    a, b, c, d, e, f = Q[0] / trace, Q[1] / trace, Q[2] / trace, Q[3] / trace, Q[4] / trace, Q[5] / trace
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return 16.0 * near.EPS / max(det, near.EPS)


@njit()
def contact_of_pair(F1, F2, r):
    """Maximum of the contact function, and the s at which it is attained.

    F does not change under affine maps. The careful path maps E1 to the unit ball, and then turns the axes of E2 to the
    coordinate axes. In these coordinates, F(s) = s(1-s) Σ d_i² / ((1-s) + s q_i). The terms of this sum are positive,
    so it loses no digits.

    Parameters
    ----------
    F1, F2 : tuple of 9 float
    r : tuple of 3 float
        The vector c2 - c1.
    """
    P, Q = shape_matrix(F1), shape_matrix(F2)
    loss = max(_loss(P), _loss(Q))
    if loss <= TRUSTED_LOSS:
        # Measure lengths in units of E1's size, so that the cubes of the determinants stay within the range of doubles.
        k = 1.0 / (P[0] + P[3] + P[5])
        h = math.sqrt(k)
        value, s = contact(
            (k * P[0], k * P[1], k * P[2], k * P[3], k * P[4], k * P[5]),
            (k * Q[0], k * Q[1], k * Q[2], k * Q[3], k * Q[4], k * Q[5]),
            (h * r[0], h * r[1], h * r[2]),
        )
        if abs(value - 1.0) > GRAZING:
            return value, s
    G1 = near.inverse(F1)
    m0 = apply(G1, (F2[0], F2[3], F2[6]))
    m1 = apply(G1, (F2[1], F2[4], F2[7]))
    m2 = apply(G1, (F2[2], F2[5], F2[8]))
    d = apply(G1, r)
    m0, m1, m2 = near.orthogonal_columns(m0, m1, m2)
    q0, q1, q2 = dot(m0, m0), dot(m1, m1), dot(m2, m2)
    d0, d1, d2 = dot(m0, d) / math.sqrt(q0), dot(m1, d) / math.sqrt(q1), dot(m2, d) / math.sqrt(q2)
    return _aligned(q0, q1, q2, d0 * d0, d1 * d1, d2 * d2)


@njit()
def _aligned(q0, q1, q2, a0, a1, a2):
    """Maximum of s(1-s) Σ a_i / ((1-s) + s q_i) on [0, 1].

    With s = t/(1+t), F' = 0 becomes Σ a_i (1 - t² q_i) / (1 + t q_i)² = 0. The terms strictly decrease in t, so the
    only root lies between the smallest and the largest 1/sqrt(q_i). Bisection in log t takes 60 halvings.
    """
    if a0 + a1 + a2 == 0.0:
        return 0.0, 0.5
    low = 1.0 / math.sqrt(max(q0, q1, q2))
    high = 1.0 / math.sqrt(min(q0, q1, q2))
    for _ in range(60):
        t = math.sqrt(low * high)
        b0, b1, b2 = 1.0 + t * q0, 1.0 + t * q1, 1.0 + t * q2
        slope = (
            a0 * (1.0 - t * t * q0) / (b0 * b0)
            + a1 * (1.0 - t * t * q1) / (b1 * b1)
            + a2 * (1.0 - t * t * q2) / (b2 * b2)
        )
        if slope > 0.0:
            low = t
        else:
            high = t
    t = math.sqrt(low * high)
    value = t / (1.0 + t) * (a0 / (1.0 + t * q0) + a1 / (1.0 + t * q1) + a2 / (1.0 + t * q2))
    return value, t / (1.0 + t)


@njit()
def contact_of_pairs(offset, F1, F2, value):
    """Compute the contact function of n pairs: c2 - c1 (n, 3), factors (n, 3, 3), value (n,)."""
    for k in range(len(offset)):
        r = (offset[k, 0], offset[k, 1], offset[k, 2])
        value[k] = contact_of_pair(matrix(F1[k]), matrix(F2[k]), r)[0]
