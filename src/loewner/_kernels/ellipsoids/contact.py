"""The contact function of two ellipsoids by Perram and Wertheim, and its witnesses.

With shape matrices P and Q, r = b - a and K(s) = (1-s) P + s Q, the function

    F(s) = s (1-s) rᵀ K(s)⁻¹ r

is concave on [0, 1], and the ellipsoids overlap if and only if max F <= 1. In 3-D, F = s(1-s) q(s)/d(s) with a
quadratic q and a cubic d. Their coefficients are computed once, so a Newton step takes only a few scalar operations.
The proofs trust neither F nor s: n = K⁻¹ r and the points a + (1-s) P n = b - s Q n are checked separately (see
docs/certified.md).

P and Q are symmetric matrices, and r and n are vectors, as in `linalg3`. All functions are pure and branch-free, and
accept both floats and vectors of the `simd` package.

References
----------
Perram and Wertheim (1985), J. Comput. Phys. 58(3), doi:10.1016/0021-9991(85)90171-8.
"""

from loewner._kernels._jit import inline, njit
from loewner._kernels.linalg3 import adjugate, apply_symmetric, dot, mixed_adjugate, trace
from loewner._kernels.simd.vectors import absolute, maximum, minimum, sqrt
from loewner._kernels.tolerances import POSITION_ERROR, SHAPE_ROUNDINGS, UNIT_ROUNDOFF


@inline
def position_error(size, unit):
    """Bound on the rounding error of a position, or of its product with a unit vector, with roundoff `unit`.

    `size` is the sum of the lengths from which the position is computed. All proofs about positions take their slack
    from here, so a term added here is added everywhere.
    """
    return POSITION_ERROR * unit * size


@inline
def polynomials(P, Q, r):
    """Coefficients of F, and a first value of s for the search for its maximum.

    Returns
    -------
    d : tuple of 4
        Coefficients of d(s) = det K(s) in powers of s.
    q : tuple of 3
        Coefficients of q(s) = rᵀ adj K(s) r.
    s : float
    """
    A, B, M = adjugate(P), adjugate(Q), mixed_adjugate(P, Q)
    # First, compute coefficients in the Bernstein basis (1-s)^i s^j.
    d0 = P[0] * A[0] + P[1] * A[1] + P[2] * A[2]
    d1 = A[0] * Q[0] + A[3] * Q[3] + A[5] * Q[5] + 2.0 * (A[1] * Q[1] + A[2] * Q[2] + A[4] * Q[4])
    d2 = B[0] * P[0] + B[3] * P[3] + B[5] * P[5] + 2.0 * (B[1] * P[1] + B[2] * P[2] + B[4] * P[4])
    d3 = Q[0] * B[0] + Q[1] * B[1] + Q[2] * B[2]
    c0 = dot(apply_symmetric(A, r), r)
    c1 = dot(apply_symmetric(M, r), r)
    c2 = dot(apply_symmetric(B, r), r)
    # For two spheres, F is largest at s = (radius of a) / (sum of radii). For other ellipsoids, replace the radii by
    # the widths along r.
    hp = sqrt(maximum(dot(apply_symmetric(P, r), r), 0.0))
    hq = sqrt(maximum(dot(apply_symmetric(Q, r), r), 0.0))
    # The small terms avoid 0 / 0 for concentric ellipsoids (r = 0), for which F is 0 everywhere and any s is valid.
    s = (hp + 1e-300) / (hp + hq + 2e-300)
    # Convert the coefficients to powers of s, for Horner's rule.
    d = d0, d1 - 3.0 * d0, 3.0 * d0 - 2.0 * d1 + d2, d3 - d0 + d1 - d2
    return d, (c0, c1 - 2.0 * c0, c0 - c1 + c2), s


@inline
def newton_step(d, q, s):
    """Take one guarded step towards the maximum of F; `polynomials` returns d and q."""
    value_d = d[0] + s * (d[1] + s * (d[2] + s * d[3]))
    slope_d = d[1] + s * (2.0 * d[2] + 3.0 * s * d[3])
    bend_d = 2.0 * d[2] + 6.0 * s * d[3]
    value_q = q[0] + s * (q[1] + s * q[2])
    slope_q = q[1] + 2.0 * s * q[2]
    w = s - s * s
    # Write F = f/d, and apply Newton's method to F' = g/d² = 0.
    f = w * value_q
    slope_f = (1.0 - 2.0 * s) * value_q + w * slope_q
    bend_f = 2.0 * ((1.0 - 2.0 * s) * slope_q - value_q + w * q[2])
    g = slope_f * value_d - f * slope_d
    slope_g = bend_f * value_d - f * bend_d
    t = s - g * value_d / (slope_g * value_d - 2.0 * g * slope_d)
    # Because F is concave, a step beyond `low` or `high` can simply be clamped. A NaN, which occurs if r = 0, becomes
    # `low`.
    low = 0.125 * s
    high = 0.875 + 0.125 * s
    return minimum(maximum(t, low), high)


@inline
def normal_at(P, Q, r, s):
    """F(s) and the vector K(s)⁻¹ r."""
    u = 1.0 - s
    K = (
        u * P[0] + s * Q[0],
        u * P[1] + s * Q[1],
        u * P[2] + s * Q[2],
        u * P[3] + s * Q[3],
        u * P[4] + s * Q[4],
        u * P[5] + s * Q[5],
    )
    A = adjugate(K)
    inverse = 1.0 / (K[0] * A[0] + K[1] * A[1] + K[2] * A[2])
    n = apply_symmetric(A, r)
    n = n[0] * inverse, n[1] * inverse, n[2] * inverse
    return s * u * dot(n, r), n


@inline
def maximize(P, Q, r, steps):
    """Maximize F by a fixed number of guarded Newton steps.

    Returns
    -------
    F, s : the maximum of F, and the s at which it lies
    n : K(s)⁻¹ r
    """
    d, q, s = polynomials(P, Q, r)
    for _ in range(steps):
        s = newton_step(d, q, s)
    F, n = normal_at(P, Q, r, s)
    return F, s, n


@inline
def outward_width(P, n, squared_length):
    """√(nᵀPn), rounded outward by the error of a rotated shape matrix, and P n."""
    Pn = apply_symmetric(P, n)
    square = maximum(0.0, dot(Pn, n)) + SHAPE_ROUNDINGS * trace(P) * squared_length
    return sqrt(square) * (1.0 + 4.0 * UNIT_ROUNDOFF), Pn


@inline
def separation(P, Q, r, n, size):
    """Certified lower bound on the signed distance of two ellipsoids along the direction n.

    `size` is the sum of the lengths from which r is computed. Any n gives a valid bound, which may be negative. If n is
    zero or contains NaN, the bound is NaN, and every comparison with NaN is false.
    """
    squared = dot(n, n)
    width_p, _ = outward_width(P, n, squared)
    width_q, _ = outward_width(Q, n, squared)
    return gap_bound(dot(n, r), width_p, width_q, sqrt(squared), size)


@inline
def gap_bound(offset, width_p, width_q, length, size):
    """Compute the bound of `separation` from n·r, the two outward widths and |n|."""
    bound = (offset - width_p - width_q) / length - position_error(size, UNIT_ROUNDOFF)
    # The division adds a rounding error, so the bound is lowered by more than this error.
    return bound - 8.0 * UNIT_ROUNDOFF * absolute(bound)


@inline
def farther_normal(P, Q, y, Pn, Qn, width_p, width_q, length, gap):
    """Find, by a Newton step on the sphere, a direction along which ellipsoids are farther apart than along n.

    The gap along n is (n·r - √(nᵀPn) - √(nᵀQn)) / |n|. The gradient of the gap is (y - gap n/|n|) / |n|, where y is the
    vector between the near points of n. The matrix H, the sum of the second derivatives of both widths, maps n to 0. A
    step therefore leads to (|n| H + gap)⁻¹ y, whose length does not matter. The method converges where the gap is
    positive.
    """
    p, q = length / width_p, length / width_q
    pp, qq = p / (width_p * width_p), q / (width_q * width_q)
    A = (
        p * P[0] + q * Q[0] - pp * Pn[0] * Pn[0] - qq * Qn[0] * Qn[0] + gap,
        p * P[1] + q * Q[1] - pp * Pn[0] * Pn[1] - qq * Qn[0] * Qn[1],
        p * P[2] + q * Q[2] - pp * Pn[0] * Pn[2] - qq * Qn[0] * Qn[2],
        p * P[3] + q * Q[3] - pp * Pn[1] * Pn[1] - qq * Qn[1] * Qn[1] + gap,
        p * P[4] + q * Q[4] - pp * Pn[1] * Pn[2] - qq * Qn[1] * Qn[2],
        p * P[5] + q * Q[5] - pp * Pn[2] * Pn[2] - qq * Qn[2] * Qn[2] + gap,
    )
    return apply_symmetric(adjugate(A), y)


@inline
def nearness(P, Q, r, n, s, sigma_a, sigma_b, size):
    """Two points, one certainly in each ellipsoid, and the certified level of their common point.

    Returns
    -------
    level : float
        The point a + (1-s) P n lies in both ellipsoids if the level is at most 1.
    distance : float
        Certified upper bound on the distance between the two points.
    depth : float
        If level <= 1, the ellipsoids penetrate each other by at least this depth.
    """
    squared = dot(n, n)
    length = sqrt(squared)
    width_p, Pn = outward_width(P, n, squared)
    width_q, Qn = outward_width(Q, n, squared)
    u = 1.0 - s
    # The level of each point in its own ellipsoid is the width times 1-s or s, plus a bound on the effect of the
    # rounding of P n or Q n.
    level_a = u * (width_p + SHAPE_ROUNDINGS * trace(P) * length / sigma_a)
    level_b = s * (width_q + SHAPE_ROUNDINGS * trace(Q) * length / sigma_b)
    # The difference between the two points, computed as r - K n, is zero in exact arithmetic.
    gap = r[0] - u * Pn[0] - s * Qn[0], r[1] - u * Pn[1] - s * Qn[1], r[2] - u * Pn[2] - s * Qn[2]
    slack = sqrt(dot(gap, gap)) + position_error(size, UNIT_ROUNDOFF)
    common = level_b + slack / sigma_b
    # If either value is NaN, the level must be NaN, too, but `maximum` passes on a NaN only from its second argument.
    level = (maximum(level_a, common) + 0.0 * level_a) * (1.0 + 8.0 * UNIT_ROUNDOFF)
    # For each ellipsoid with its own level and σ, the ball of radius (1 - level) σ around the common point lies inside
    # the ellipsoid.
    depth = ((1.0 - level_a) * sigma_a + (1.0 - common) * sigma_b) * (1.0 - 16.0 * UNIT_ROUNDOFF)
    # Pull each point back into its own ellipsoid if it lies outside.
    fa = u / maximum(1.0, level_a * (1.0 + 8.0 * UNIT_ROUNDOFF))
    fb = s / maximum(1.0, level_b * (1.0 + 8.0 * UNIT_ROUNDOFF))
    between = (
        r[0] - fb * Qn[0] - fa * Pn[0],
        r[1] - fb * Qn[1] - fa * Pn[1],
        r[2] - fb * Qn[2] - fa * Pn[2],
    )
    distance = sqrt(dot(between, between)) * (1.0 + 8.0 * UNIT_ROUNDOFF) + position_error(size, UNIT_ROUNDOFF)
    return level, distance, depth


@njit()
def contact(P, Q, r):
    """Maximum of the contact function and the s at which it lies, iterated to convergence.

    Returns
    -------
    F, s : float
        The ellipsoids overlap (touching included) if and only if F <= 1.
    """
    F, s, _ = maximize(P, Q, r, 12)
    return F, s
