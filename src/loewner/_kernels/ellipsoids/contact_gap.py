"""The gap between the support planes of two ellipsoids along the contact normal, and its derivative for a motion.

The contact normal is n = K(s)⁻¹ r at the s with the greatest contact function F. It depends smoothly on both
ellipsoids, apart or not, as long as their centers differ. The gap along the contact normal is smooth, too:

    g = (n·r - √(nᵀPn) - √(nᵀQn)) / |n| = n·r/|n| (1 - 1/√F),

This gap, like the gap along any direction, is a lower bound on the signed distance. `contact` explains the names.
"""

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.ellipsoids.contact import gap_bound, newton_step, outward_width, polynomials
from loewner._kernels.linalg3 import adjugate, along, apply_symmetric, cross, dot, minus, plus, scaled, selected
from loewner._kernels.simd.vectors import (
    ALL,
    absolute,
    broadcast,
    mask_of,
    movemask,
    select,
    sqrt,
)

# Maximum numbers of steps with polynomials (STEPS) and with the slope F′ (SLOPES). Four steps with polynomials and one
# with slopes are usually enough; for needles, each step with slopes halves the interval of s.
STEPS, SLOPES = 12, 60

# Newton's method ends when a step moves s by at most SETTLED (with slopes: SETTLED_SLOPE) times s (1 - s).
SETTLED, SETTLED_SLOPE = 1e-5, 1e-6


@inline
def _slope(P, Q, r, s):
    """Compute the quantities that follow from the contact normal at s.

    Returns
    -------
    A : adjugate of K(s)
    inverse : one over its determinant, which is positive
    n : K⁻¹ r
    Pn, Qn : vectors
    p, q : nᵀPn, nᵀQn
    w : 2 K⁻¹ ((1-s)² P - s² Q) n
    slope, bend : F′ and F″ (as F′ is (1-s)² nᵀPn - s² nᵀQn)
    """
    u = 1.0 - s
    K = (
        u * P[0] + s * Q[0], u * P[1] + s * Q[1], u * P[2] + s * Q[2],
        u * P[3] + s * Q[3], u * P[4] + s * Q[4], u * P[5] + s * Q[5],
    )  # fmt: skip
    A = adjugate(K)
    # For needles, the computed determinant has no correct digit, and even its sign may be wrong. The adjugate is
    # accurate, so the direction of n is correct.
    inverse = 1.0 / absolute(K[0] * A[0] + K[1] * A[1] + K[2] * A[2])
    n = scaled(inverse, apply_symmetric(A, r))
    Pn, Qn = apply_symmetric(P, n), apply_symmetric(Q, n)
    p, q = dot(Pn, n), dot(Qn, n)
    w = scaled(2.0 * inverse, apply_symmetric(A, minus(scaled(u * u, Pn), scaled(s * s, Qn))))
    bend = -2.0 * u * p - 2.0 * s * q - dot(w, minus(Qn, Pn))
    return A, inverse, n, Pn, Qn, p, q, w, u * u * p - s * s * q, bend


@inline
def contact_parameter(P, Q, r):
    """The s at which F is greatest, for eight pairs; the result of a pair does not depend on the other pairs."""
    d, q, s = polynomials(P, Q, r)
    live = ALL
    for _ in range(STEPS):
        t = newton_step(d, q, s)
        moves = absolute(t - s) > SETTLED * (t - t * t)
        s = select(mask_of(live), t, s)
        live &= movemask(moves)
        if live == 0:
            break
    # For thin ellipsoids, the coefficients of the polynomials have lost digits; for needles, they have no correct digit
    # at all. The search therefore continues with slopes.
    low, high, live = broadcast(0.0), broadcast(1.0), ALL
    for _ in range(SLOPES):
        _, _, _, _, _, _, _, _, slope, bend = _slope(P, Q, r, s)
        rises = slope > 0.0
        low, high = select(rises, s, low), select(rises, high, s)
        t = s - slope / bend
        t = select((t >= low) & (t <= high), t, 0.5 * (low + high))
        moves = absolute(t - s) > SETTLED_SLOPE * (t - t * t)
        s = select(mask_of(live), t, s)
        live &= movemask(moves)
        if live == 0:
            break
    return s


@inline
def contact_gap(P, Q, r, s, size):
    """Certified lower bounds on the signed distances of eight pairs of ellipsoids, smooth where the centers differ.

    `size` is the sum of the lengths from which r is computed. On overflow, the bound is -inf.
    """
    _, _, n, _, _, _, _, _, _, _ = _slope(P, Q, r, s)
    concentric = dot(r, r) <= 0.0  # For concentric ellipsoids, any direction gives a valid bound.
    n = selected(concentric, (broadcast(1.0), broadcast(0.0), broadcast(0.0)), n)
    squared = dot(n, n)
    width_p, _ = outward_width(P, n, squared)
    width_q, _ = outward_width(Q, n, squared)
    bound = gap_bound(dot(n, r), width_p, width_q, sqrt(squared), size)
    return select(bound < np.inf, bound, -np.inf)


@inline
def contact_gap_wrench(P, Q, r, s):
    """Gradient of g for a motion of b: a force, and its moment about b's center; for a motion of a, negate it.

    Let y = r - Pn/√(nᵀPn) - Qn/√(nᵀQn), u = K⁻¹(y - g n/|n|)/|n| and w = 2 K⁻¹((1-s)² P - s² Q) n. The derivative of s
    contributes k w, where k = u·(Q-P)n / F″ and F″ = -2(1-s) nᵀPn - 2s nᵀQn - w·(Q-P)n. The derivative with respect to
    r is n/|n| + u + k w. The derivative with respect to Q is the matrix D = -(1/(2 √(nᵀQn) |n|) + k s²) nnᵀ - s sym(u +
    k w, n), which contributes the moment 2 vee(Q D). If the centers coincide, no derivative exists, and the result may
    be NaN.
    """
    A, inverse, n, Pn, Qn, squared_p, squared_q, w, _, bend = _slope(P, Q, r, s)
    p, q, length = sqrt(squared_p), sqrt(squared_q), sqrt(dot(n, n))
    unit = scaled(1.0 / length, n)
    gap = (dot(n, r) - p - q) / length
    y = along(along(along(r, -1.0 / p, Pn), -1.0 / q, Qn), -gap, unit)
    by_normal = scaled(inverse / length, apply_symmetric(A, y))
    k = dot(by_normal, minus(Qn, Pn)) / bend
    v = along(by_normal, k, w)
    b = scaled(-s, v)
    half = along(b, -1.0 / (q * length) - 2.0 * k * (s * s), n)
    return plus(unit, v), plus(cross(Qn, half), cross(apply_symmetric(Q, b), n))
