"""Signed distance of two ellipsoids, or of an ellipsoid and a ball; for depths, the global minimum is proven.

With the factors F_A and F_B and the vector c between the centers, h(n) = |F_Aᵀn| + |F_Bᵀn| - n·c is the support
function of A - B. The least value of h over unit vectors n is the penetration depth if positive, and minus the distance
if negative. Newton's method on the sphere finds a local minimum to rounding. The method uses the factors themselves,
never their squares, so thin ellipsoids keep their digits.

A negative minimum is the only minimum, because A - B is convex. Most other minima are proven to be global by an
ellipsoid within A - B. Let n be the direction of the minimum h. For every orthogonal O, G = F_A + F_B O has |Gᵀm| <=
|F_Aᵀm| + |F_Bᵀm| for all m, with equality for m = n if F_Aᵀn and OᵀF_Bᵀn have the same direction. Let M = G Gᵀ and s =
|Gᵀn|. Then c is (M - h s) n / s. If M - h s is positive definite, no direction m gives a lower value than h: if m is
scaled such that mᵀMm = s²,

    0 <= (m - n)ᵀ (M - h s) (m - n) = 2 s² - 2 s m·c - h s (|m|² + 1),   so   |Gᵀm| - m·c >= h (|m|² + 1) / 2 >= h |m|.

If this proof fails, lower minima must be ruled out. By the Cauchy-Schwarz inequality, (√x + √y)² is the minimum of (1 +
1/r) x + (1 + r) y over r > 0, so that

    min h = min over r of D(1 + 1/r, 1 + r),   D(p, q) = min over n of √(nᵀ(p P + q Q) n) - n·c,

where D(p, q) is the signed distance of the point c from the boundary of one ellipsoid, which follows from the only root
of a secular equation. Only r is left to search.

D is concave in (p, q), because it is a minimum of concave functions. The arc of the hyperbola (p - 1)(q - 1) = 1
between r1 and r2 lies in the triangle formed by the arc's ends and the point where the tangents at these ends meet.
Hence D on the arc is at least its linear interpolation in the triangle. The gap shrinks with the square of the
interval, and branch and bound over r settles the rest.

References
----------
Kurzhanski and Vályi (1997), "Ellipsoidal Calculus for Estimation and Control" (ellipsoids within and around a sum).
Moré and Sorensen (1983), doi:10.1137/0904038 (the secular equation and its hard case).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import ELLIPSOID, FRAME_CENTER, FRAME_FACTOR, KIND, POINT, ROUNDING
from loewner._kernels.elementary import exponential
from loewner._kernels.linalg3 import across, along, apply, dot, minus, plus, scaled, selected, shape_matrix, trace
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import rotation_of
from loewner._kernels.simd.vectors import maximum, movemask, select, sqrt
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# Maximum number of steps of a descent. A descent usually takes 5 steps, or 25 if the second derivative vanishes at the
# minimum.
MAX_STEPS = 80
DAMPING_LIMIT = 1e3  # Largest damping, relative to the size; with more damping, a step no longer moves the normal.

MAX_SWEEPS = 12  # Maximum number of sweeps of Jacobi's method, which needs 3 or 4.
MAX_SECULAR = 60  # Maximum number of Newton steps for the secular equation, which usually takes 4 or 5.

# Largest relative gap that the proof of a global minimum may leave, and largest number of intervals that the proof may
# examine. For comparison, the rounding error of D itself is about 1e-15. The two constants are choices, not bounds;
# they affect the reported gap.
PROOF_GAP = 1e-11
MAX_INTERVALS = 600
GROWTH = 16.0  # Ratio of the distances, in log r, of successive intervals' far ends from the minimum.
_STACK = 160

# The proof by an inner ellipsoid requires that M - h s is positive definite even after a margin is subtracted. The
# margin is SPARE times h s, plus PIVOT_ROUNDINGS times the unit roundoff times the trace of M. The second term is about
# twice the rounding error of the entries and pivots of M. Both constants are choices, not bounds; no verdict depends on
# them.
SPARE = 1e-3
PIVOT_ROUNDINGS = 64.0

MAX_PLAIN = 12  # Maximum number of Newton steps for eight pairs; the slowest of them usually needs 6 or 7.

STEEP = 1e-12  # Largest slope, relative to the size, of a descent that has not stalled.
MAX_RESTARTS = 20


@inline
def _image(P):
    """Factor of a placed ellipsoid, row by row (zero for a ball's core), and its center relative to the body."""
    row, R, f, c = P.table[P.piece], rotation_of(P), FRAME_FACTOR, FRAME_CENTER
    center = apply(R, (row[c], row[c + 1], row[c + 2]))
    if P.layout[P.piece, KIND] == POINT:
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), center
    one = apply(R, (row[f], row[f + 3], row[f + 6]))
    two = apply(R, (row[f + 1], row[f + 4], row[f + 7]))
    three = apply(R, (row[f + 2], row[f + 5], row[f + 8]))
    return (one[0], two[0], three[0], one[1], two[1], three[1], one[2], two[2], three[2]), center


@inline
def _pulled(F, x, y, z):
    """The product Fᵀ (x, y, z)."""
    return F[0] * x + F[3] * y + F[6] * z, F[1] * x + F[4] * y + F[7] * z, F[2] * x + F[5] * y + F[8] * z


@inline
def support(F, n):
    """Support point of F·ball along n."""
    u, v, w = _pulled(F, n[0], n[1], n[2])
    h = sqrt(u * u + v * v + w * w)
    scale = select(h > 0.0, 1.0 / h, 0.0)
    return apply(F, (u * scale, v * scale, w * scale))


@inline
def _bend(F, n, e, g):
    """Slope and second derivatives of |Fᵀn| along unit vectors e and g, perpendicular to n and to each other."""
    u, v, w = _pulled(F, n[0], n[1], n[2])
    h = sqrt(u * u + v * v + w * w)
    scale = select(h > 0.0, 1.0 / h, 0.0)
    u, v, w = u * scale, v * scale, w * scale
    ax, ay, az = _pulled(F, e[0], e[1], e[2])
    bx, by, bz = _pulled(F, g[0], g[1], g[2])
    one = ax * u + ay * v + az * w
    two = bx * u + by * v + bz * w
    ax, ay, az = ax - one * u, ay - one * v, az - one * w
    bx, by, bz = bx - two * u, by - two * v, bz - two * w
    return (
        h,
        one,
        two,
        (ax * ax + ay * ay + az * az) * scale,
        (ax * bx + ay * by + az * bz) * scale,
        (bx * bx + by * by + bz * bz) * scale,
    )


@inline
def _model(FA, FB, c, n):
    """h at n, its slopes along two directions perpendicular to n, its second derivatives there, and the directions."""
    e, g = across(n)
    ha, a1, a2, a11, a12, a22 = _bend(FA, n, e, g)
    hb, b1, b2, b11, b12, b22 = _bend(FB, n, e, g)
    h = ha + hb - (n[0] * c[0] + n[1] * c[1] + n[2] * c[2])
    s1 = a1 + b1 - (e[0] * c[0] + e[1] * c[1] + e[2] * c[2])
    s2 = a2 + b2 - (g[0] * c[0] + g[1] * c[1] + g[2] * c[2])
    return h, s1, s2, a11 + b11 - h, a12 + b12, a22 + b22 - h, e, g


@njit(forceinline=False)
def descend(FA, FB, c, n, size):
    """Find a local minimum of h by damped Newton steps, starting at the unit vector n.

    Returns
    -------
    n : tuple of float
    h, slope : float
        The value, and the length of the remaining gradient, which is the distance by which the witnesses disagree.
    """
    rounding = 8.0 * UNIT_ROUNDOFF * size
    damping = 0.0
    h, s1, s2, h11, h12, h22, e, g = _model(FA, FB, c, n)
    slope = np.sqrt(s1 * s1 + s2 * s2)
    for _ in range(MAX_STEPS):
        if slope <= rounding:
            break
        # Raise the least eigenvalue of the Hessian if necessary: the step is sure to lead downward only if this
        # eigenvalue is positive.
        mean = 0.5 * (h11 + h22)
        half = 0.5 * (h11 - h22)
        spread = np.sqrt(half * half + h12 * h12)
        lift = damping
        if mean - spread + lift < 1e-3 * slope:
            lift = 1e-3 * slope - (mean - spread) + damping
        k11, k22 = h11 + lift, h22 + lift
        det = k11 * k22 - h12 * h12
        t1 = (h12 * s2 - k22 * s1) / det
        t2 = (h12 * s1 - k11 * s2) / det
        step = np.sqrt(t1 * t1 + t2 * t2)
        if not step > 0.0:
            break
        if step > 1.0:
            t1, t2 = t1 / step, t2 / step
        x = n[0] + t1 * e[0] + t2 * g[0]
        y = n[1] + t1 * e[1] + t2 * g[1]
        z = n[2] + t1 * e[2] + t2 * g[2]
        length = np.sqrt(x * x + y * y + z * z)
        tried = (x / length, y / length, z / length)
        value, w1, w2, w11, w12, w22, we, wg = _model(FA, FB, c, tried)
        left = np.sqrt(w1 * w1 + w2 * w2)
        if value < h - rounding or (value <= h + rounding and left < slope):
            n, h, s1, s2, h11, h12, h22, e, g, slope = tried, value, w1, w2, w11, w12, w22, we, wg, left
            damping = 0.0 if damping < 1e-6 * size else 0.1 * damping
        else:
            damping = max(8.0 * damping, 0.5 * lift, slope, 1e-12 * size)
            if damping > DAMPING_LIMIT * size:
                break
    return n, h, slope


@inline
def _inner_shape(FA, FB, n):
    """Shape matrix of an ellipsoid within A - B that touches the boundary where its normal is n; and |Gᵀn|."""
    u, v = _pulled(FA, n[0], n[1], n[2]), _pulled(FB, n[0], n[1], n[2])
    ha, hb = sqrt(dot(u, u)), sqrt(dot(v, v))
    u, v = scaled(1.0 / ha, u), scaled(1.0 / hb, v)
    e, g = across(u)
    a0, a1, a2 = apply(FA, u), apply(FA, e), apply(FA, g)
    e, g = across(v)
    b0, b1, b2 = apply(FB, v), apply(FB, e), apply(FB, g)
    # In O, a rotation or reflection of b1 and b2 within their plane is still free. Choose the one that maximises
    # a1 · b1 + a2 · b2.
    one, two = dot(a1, b1) + dot(a2, b2), dot(a1, b2) - dot(a2, b1)
    three, four = dot(a1, b1) - dot(a2, b2), dot(a1, b2) + dot(a2, b1)
    mirrored = three * three + four * four > one * one + two * two
    x, y = select(mirrored, three, one), select(mirrored, four, two)
    length = sqrt(x * x + y * y)
    cosine, sine = select(length > 0.0, x / length, 1.0), select(length > 0.0, y / length, 0.0)
    g0 = plus(a0, b0)
    g1 = along(along(a1, cosine, b1), sine, b2)
    g2 = along(along(a2, select(mirrored, sine, -sine), b1), select(mirrored, -cosine, cosine), b2)
    return shape_matrix((g0[0], g1[0], g2[0], g0[1], g1[1], g2[1], g0[2], g1[2], g2[2])), ha + hb


@inline
def is_least(FA, FB, n, h):
    """Return whether an ellipsoid within A - B proves that h, the local minimum at n, is the global minimum."""
    M, s = _inner_shape(FA, FB, n)
    cut = (1.0 + SPARE) * h * s + PIVOT_ROUNDINGS * UNIT_ROUNDOFF * trace(M)
    one = M[0] - cut
    two = M[3] - cut - M[1] * M[1] / one
    off = M[4] - M[1] * M[2] / one
    three = M[5] - cut - M[2] * M[2] / one - off * off / two
    return (h <= 0.0) | ((one > 0.0) & (two > 0.0) & (three > 0.0))


@njit()
def descend_eight(FA, FB, c, n, size, wanted):
    """Take the Newton steps of `descend`, but without damping, for eight pairs of ellipsoids at a time.

    Parameters
    ----------
    FA, FB, c, n, size : tuple of Vector8, or Vector8
        Documented in `global_minimum`.
    wanted : Mask8
        Pairs that matter; the iteration does not wait for other pairs.

    Returns
    -------
    n : tuple of Vector8
    h, slope : Vector8
        As returned by `descend`.
    proven : Mask8
        Pairs for which h is the least value, to rounding; for other pairs, h need not even be a minimum.
    """
    rounding = 8.0 * UNIT_ROUNDOFF * size
    h, s1, s2, h11, h12, h22, e, g = _model(FA, FB, c, n)
    slope = sqrt(s1 * s1 + s2 * s2)
    going = wanted & (slope > rounding)
    for _ in range(MAX_PLAIN):
        if movemask(going) == 0:
            break
        # Raise the least eigenvalue of the Hessian if necessary: the step is sure to lead downward only if this
        # eigenvalue is positive.
        half = 0.5 * (h11 - h22)
        lowest = 0.5 * (h11 + h22) - sqrt(half * half + h12 * h12)
        lift = maximum(1e-3 * slope - lowest, 0.0)
        k11, k22 = h11 + lift, h22 + lift
        det = k11 * k22 - h12 * h12
        t1 = (h12 * s2 - k22 * s1) / det
        t2 = (h12 * s1 - k11 * s2) / det
        shorter = 1.0 / maximum(sqrt(t1 * t1 + t2 * t2), 1.0)
        tried = along(along(n, t1 * shorter, e), t2 * shorter, g)
        tried = scaled(1.0 / sqrt(dot(tried, tried)), tried)
        value, w1, w2, w11, w12, w22, we, wg = _model(FA, FB, c, tried)
        left = sqrt(w1 * w1 + w2 * w2)
        better = going & ((value < h - rounding) | ((value <= h + rounding) & (left < slope)))
        n, e, g = selected(better, tried, n), selected(better, we, e), selected(better, wg, g)
        h, slope = select(better, value, h), select(better, left, slope)
        s1, s2 = select(better, w1, s1), select(better, w2, s2)
        h11, h12, h22 = select(better, w11, h11), select(better, w12, h12), select(better, w22, h22)
        going = better & (slope > rounding)
    return n, h, slope, wanted & (slope <= STEEP * size) & is_least(FA, FB, n, h)


@inline
def _turn(a, b, off):
    """Tangent, cosine and sine of the Jacobi rotation that clears the off-diagonal entry between a and b."""
    theta = 0.5 * (b - a)
    t = off / (theta + np.copysign(np.sqrt(theta * theta + off * off), theta))
    cosine = 1.0 / np.sqrt(t * t + 1.0)
    return t, cosine, t * cosine


@inline
def _form(M, V, j, k):
    """One entry of Vᵀ M V, for M given by its upper triangle."""
    x, y, z = V[0, k], V[1, k], V[2, k]
    return (
        V[0, j] * (M[0] * x + M[1] * y + M[2] * z)
        + V[1, j] * (M[1] * x + M[3] * y + M[4] * z)
        + V[2, j] * (M[2] * x + M[4] * y + M[5] * z)
    )


@njit(forceinline=False)
def eigen(M, V):
    """Eigenvalues of a symmetric matrix, unordered, by Jacobi's method.

    V must be orthogonal at the start; the eigenvectors of a similar matrix save work. The columns of V become the
    eigenvectors.
    """
    m00, m01, m02 = _form(M, V, 0, 0), _form(M, V, 0, 1), _form(M, V, 0, 2)
    m11, m12, m22 = _form(M, V, 1, 1), _form(M, V, 1, 2), _form(M, V, 2, 2)
    for _ in range(MAX_SWEEPS):
        small = 0.25 * UNIT_ROUNDOFF * (abs(m00) + abs(m11) + abs(m22))
        if abs(m01) + abs(m02) + abs(m12) <= small:
            break
        if m01 != 0.0:
            t, p, s = _turn(m00, m11, m01)
            m00, m11 = m00 - t * m01, m11 + t * m01
            m02, m12 = p * m02 - s * m12, s * m02 + p * m12
            m01 = 0.0
            for r in range(3):
                V[r, 0], V[r, 1] = p * V[r, 0] - s * V[r, 1], s * V[r, 0] + p * V[r, 1]
        if m02 != 0.0:
            t, p, s = _turn(m00, m22, m02)
            m00, m22 = m00 - t * m02, m22 + t * m02
            m01, m12 = p * m01 - s * m12, s * m01 + p * m12
            m02 = 0.0
            for r in range(3):
                V[r, 0], V[r, 2] = p * V[r, 0] - s * V[r, 2], s * V[r, 0] + p * V[r, 2]
        if m12 != 0.0:
            t, p, s = _turn(m11, m22, m12)
            m11, m22 = m11 - t * m12, m22 + t * m12
            m01, m02 = p * m01 - s * m02, s * m01 + p * m02
            m12 = 0.0
            for r in range(3):
                V[r, 1], V[r, 2] = p * V[r, 1] - s * V[r, 2], s * V[r, 1] + p * V[r, 2]
    return m00, m11, m22


@njit(forceinline=False)
def boundary_depth(m0, m1, m2, x, y, z):
    """Minimum of √(nᵀMn) - n·c over unit n, for M = diag(m) and c = (x, y, z): the depth of c in the ellipsoid M.

    Let M w be the nearest boundary point and w its normal. Then c = (M + t) w for the one t > -min m with wᵀMw = 1. The
    unknown is t + min m, which keeps its digits when t is close to its bound.

    Returns
    -------
    depth : float
        Depth of c; negative outside.
    n : tuple of float
    """
    least = max(min(m0, min(m1, m2)), 0.0)
    m0, m1, m2 = max(m0, least), max(m1, least), max(m2, least)
    g0, g1, g2 = m0 - least, m1 - least, m2 - least
    a0, a1, a2 = np.sqrt(m0) * abs(x), np.sqrt(m1) * abs(y), np.sqrt(m2) * abs(z)
    t = max(0.0, max(a0 - g0, max(a1 - g1, a2 - g2)))  # Start where the largest q is 1; this is not beyond the root.
    for _ in range(MAX_SECULAR):
        q0 = a0 / (g0 + t) if a0 > 0.0 else 0.0
        q1 = a1 / (g1 + t) if a1 > 0.0 else 0.0
        q2 = a2 / (g2 + t) if a2 > 0.0 else 0.0
        total = q0 * q0 + q1 * q1 + q2 * q2
        if not total > 1.0:
            break
        # Take a Newton step for 1/√total = 1. The step never passes the root, because 1/√total is concave in t.
        falling = (
            (q0 * q0 / (g0 + t) if a0 > 0.0 else 0.0)
            + (q1 * q1 / (g1 + t) if a1 > 0.0 else 0.0)
            + (q2 * q2 / (g2 + t) if a2 > 0.0 else 0.0)
        )
        step = total * (np.sqrt(total) - 1.0) / falling
        t += step
        if step <= 2.0 * UNIT_ROUNDOFF * t:
            break
    w0 = x / (g0 + t) if a0 > 0.0 else 0.0
    w1 = y / (g1 + t) if a1 > 0.0 else 0.0
    w2 = z / (g2 + t) if a2 > 0.0 else 0.0
    level = m0 * w0 * w0 + m1 * w1 * w1 + m2 * w2 * w2
    if t == 0.0 and level < 1.0:
        # In the hard case, c has no component along the shortest axis, so the normal may lean to either side of this
        # axis.
        lean = np.sqrt((1.0 - level) / least) if least > 0.0 else 1.0
        if g0 == 0.0:
            w0 = lean
        elif g1 == 0.0:
            w1 = lean
        else:
            w2 = lean
    length = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    return (least - t) * length, (w0 / length, w1 / length, w2 / length)


@njit(forceinline=False)
def enclosing_depth(p, q, P, Q, c, V):
    """D(p, q), the depth of c in the ellipsoid with shape matrix p P + q Q, and the normal there."""
    m0, m1, m2 = eigen(
        (
            p * P[0] + q * Q[0], p * P[1] + q * Q[1], p * P[2] + q * Q[2],
            p * P[3] + q * Q[3], p * P[4] + q * Q[4], p * P[5] + q * Q[5],
        ), V,
    )  # fmt: skip
    depth, w = boundary_depth(
        m0, m1, m2,
        V[0, 0] * c[0] + V[1, 0] * c[1] + V[2, 0] * c[2],
        V[0, 1] * c[0] + V[1, 1] * c[1] + V[2, 1] * c[2],
        V[0, 2] * c[0] + V[1, 2] * c[1] + V[2, 2] * c[2],
    )  # fmt: skip
    return depth, (
        V[0, 0] * w[0] + V[0, 1] * w[1] + V[0, 2] * w[2],
        V[1, 0] * w[0] + V[1, 1] * w[1] + V[1, 2] * w[2],
        V[2, 0] * w[0] + V[2, 1] * w[1] + V[2, 2] * w[2],
    )


@inline
def _ratio(FA, FB, n):
    """Ratio of the extents of A and B along n."""
    ax, ay, az = _pulled(FA, n[0], n[1], n[2])
    bx, by, bz = _pulled(FB, n[0], n[1], n[2])
    return np.sqrt((ax * ax + ay * ay + az * az) / (bx * bx + by * by + bz * bz))


@njit(forceinline=False)
def _refined(FA, FB, P, Q, c, n, h, slope, size, V):
    """Continue from a direction at which a descent ended with a remaining slope.

    Newton's steps may stall on the sharp ends of thin ellipsoids. There, the enclosing ellipsoid that touches at n
    makes progress: its own nearest point is never worse.
    """
    for _ in range(MAX_RESTARTS):
        if slope <= STEEP * size:
            break
        ratio = _ratio(FA, FB, n)
        _, other = enclosing_depth(1.0 + 1.0 / ratio, 1.0 + ratio, P, Q, c, V)
        other, value, left = descend(FA, FB, c, other, size)
        if value < h or left < slope:
            n, h, slope = other, value, left
    return n, h, slope


@njit(forceinline=False)
def _axes(P, V):
    """Smallest and largest semi-axis of an ellipsoid with shape matrix P."""
    m0, m1, m2 = eigen(P, V)
    most = max(m0, max(m1, m2))
    return np.sqrt(max(min(m0, min(m1, m2)), UNIT_ROUNDOFF * UNIT_ROUNDOFF * most)), np.sqrt(most)


@njit(forceinline=False)
def global_minimum(FA, FB, c, n, size):
    """Least value of h over all unit vectors.

    Parameters
    ----------
    FA, FB : tuple of 9 float
        Factors of the placed ellipsoids, row by row.
    c : tuple of 3 float
        Vector from the center of A to the center of B.
    n : tuple of 3 float
        Unit vector to start from.
    size : float
        Upper bound on the lengths involved.

    Returns
    -------
    n : tuple of float
        Direction of the least value found.
    h, lower, slope : float
        The least value found, a lower bound on all values, and the distance by which the witnesses at n disagree.
    """
    n, h, slope = descend(FA, FB, c, n, size)
    if h <= 0.0 and slope <= STEEP * size:
        return n, h, h, slope
    V = np.eye(3)
    P, Q = shape_matrix(FA), shape_matrix(FB)
    n, h, slope = _refined(FA, FB, P, Q, c, n, h, slope, size, V)
    if is_least(FA, FB, n, h):
        return n, h, h, slope

    # Branch and bound over r. The bound has to be tightest near the known minimum, so the intervals are smallest there.
    small_a, large_a = _axes(P, V)
    small_b, large_b = _axes(Q, V)
    first, last = 0.5 * small_a / large_b, 2.0 * large_a / small_b
    middle = min(max(_ratio(FA, FB, n), first), last)
    stack = np.empty((_STACK, 4))
    top = 0
    for side in (-1.0, 1.0):
        end = first if side < 0.0 else last
        near = middle
        near_depth, other = enclosing_depth(1.0 + 1.0 / near, 1.0 + near, P, Q, c, V)
        away = np.sqrt(8.0 * PROOF_GAP)
        while near != end and top < _STACK // 2:
            far = middle * exponential(side * away)
            if side * (far - end) >= 0.0 or top == _STACK // 2 - 1:
                far = end
            far_depth, other = enclosing_depth(1.0 + 1.0 / far, 1.0 + far, P, Q, c, V)
            if far_depth < h - 0.5 * PROOF_GAP * size:
                n, h, slope = _better(FA, FB, P, Q, c, other, size, V, n, h, slope)
            stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = near, near_depth, far, far_depth
            top += 1
            near, near_depth = far, far_depth
            away *= GROWTH
    lower = h
    looked = 0
    while top > 0:
        top -= 1
        looked += 1
        one, one_depth, two, two_depth = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        tip, _ = enclosing_depth(1.0 + 2.0 / (one + two), 1.0 + 2.0 * one * two / (one + two), P, Q, c, V)
        half = np.sqrt(one * two)
        bound = min(one_depth, two_depth)
        if tip < bound:
            # For any point of the arc, the barycentric weight of the tip is at most weight / (1 + weight).
            weight = 0.5 * (one + two) / half
            bound += weight / (1.0 + weight) * (tip - bound)
        if bound >= h - PROOF_GAP * size - _rounding(one, two, P, Q, h) or top + 2 > _STACK or looked >= MAX_INTERVALS:
            lower = min(lower, bound)
            continue
        half_depth, other = enclosing_depth(1.0 + 1.0 / half, 1.0 + half, P, Q, c, V)
        if half_depth < h - 0.5 * PROOF_GAP * size:
            n, h, slope = _better(FA, FB, P, Q, c, other, size, V, n, h, slope)
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = one, one_depth, half, half_depth
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = half, half_depth, two, two_depth
        top += 1
    return n, h, min(lower, h), slope


@inline
def _rounding(one, two, P, Q, h):
    """Bound on the error of a depth around h due to rounding in the entries of p P + q Q, for r from `one` to `two`.

    The entries are off by at most 7u of `most` (3u from P and Q, 2u from p and q, product and sum). Half of this error,
    divided by h, bounds the error of √(nᵀKn), which is at least h. No verdict depends on this bound.
    """
    most = (1.0 + 1.0 / min(one, two)) * (P[0] + P[3] + P[5]) + (1.0 + max(one, two)) * (Q[0] + Q[3] + Q[5])
    return 4.0 * UNIT_ROUNDOFF * most / h


@njit(forceinline=False)
def _better(FA, FB, P, Q, c, other, size, V, n, h, slope):
    """Return the lower of the known minimum and the minimum reached from another vector."""
    other, value, left = descend(FA, FB, c, other, size)
    other, value, left = _refined(FA, FB, P, Q, c, other, value, left, size, V)
    if value < h:
        return other, value, left
    return n, h, slope


@njit(forceinline=False)
def least_height(wide_a, FA, wide_b, FB, c, n, size):
    """Apply `global_minimum` to ellipsoids, or to cores of balls, which are points: not `wide`, with zero factors."""
    if wide_a and wide_b:
        return global_minimum(FA, FB, c, n, size)
    if wide_a or wide_b:
        # For a ball and an ellipsoid, there is one minimum, or there are two that are mirror images of each other.
        P = shape_matrix(FA if wide_a else FB)
        _, n = enclosing_depth(1.0, 0.0, P, P, c, np.eye(3))
        n, h, slope = descend(FA, FB, c, n, size)
        return n, h, h, slope
    away = np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    if away > 0.0:
        n = (c[0] / away, c[1] / away, c[2] / away)
    return n, -away, -away, 0.0


@inline
def is_round(P):
    """Return whether the piece is an ellipsoid or a ball."""
    kind = P.layout[P.piece, KIND]
    return kind in (ELLIPSOID, POINT)


@inline
def round_distance(A, B, n, size, result):
    """Signed distance of two pieces that are ellipsoids or balls.

    Parameters
    ----------
    A, B : Placed
    n : tuple of 3 float
        Direction to try first: a normal from A to B, of any length.
    size : float
        Upper bound on the lengths involved.
    result : ndarray, shape (9,)
        Receives the unit normal from A to B, and the witnesses relative to a's translation.

    Returns
    -------
    distance, gap : float
        `gap` is the larger of two lengths: the remaining gap in the proof of the global minimum, and the distance by
        which the witnesses disagree across the normal.
    """
    FA, a = _image(A)
    FB, b = _image(B)
    b = plus(b, shift_between(A, B))
    length = np.sqrt(dot(n, n))
    n = (n[0] / length, n[1] / length, n[2] / length) if 0.0 < length < np.inf else (0.0, 0.0, 1.0)
    wide_a, wide_b = A.layout[A.piece, KIND] == ELLIPSOID, B.layout[B.piece, KIND] == ELLIPSOID
    n, h, lower, slope = least_height(wide_a, FA, wide_b, FB, minus(b, a), n, size)
    ra, rb = A.table[A.piece, ROUNDING], B.table[B.piece, ROUNDING]
    result[0], result[1], result[2] = n
    result[3], result[4], result[5] = along(plus(a, support(FA, n)), ra, n)
    result[6], result[7], result[8] = along(minus(b, support(FB, n)), -rb, n)
    return -h - ra - rb, max(h - lower, slope)
