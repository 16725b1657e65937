"""Near points of two 3-D ellipsoids, by pure functions of a pair.

An ellipsoid is {c + F u : |u| <= 1}. All computations are in a frame with its origin at the first center. They use only
r = c2 - c1, so ellipsoids far from the world's origin lose no digits. Vectors are tuples of three floats, and matrices
are tuples of nine in row order: nothing is allocated.

The methods are 0 Rimon-Boyd, 1 Lin-Han and 2 center line. The statuses are `SEPARATE`, `OVERLAP` (both points are one
common point, and the distance is 0) and `UNCONVERGED`.

Sources: the paper (section 4, appendix A); Lin and Han (2002), doi:10.1137/S1052623401396510;
Rimon and Boyd (1997), doi:10.1023/A:1007960531949; Moré and Sorensen (1983), doi:10.1137/0904038,
for the secular equation.
"""

import math

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import CENTER_LINE, LIN_HAN, OVERLAP, SEPARATE, UNCONVERGED
from loewner._kernels.elementary import arc_cosine, arc_tangent
from loewner._kernels.linalg3 import across, along, apply, apply_transposed, dot, matrix, minus
from loewner._kernels.simd.trig import sine_cosine

# Number of steps of Lin and Han's own iteration, after which Newton's method takes over. The iteration converges
# linearly, at a rate that depends on the square of the axis ratio. For fairly round ellipsoids, it takes 5 to 30 steps.
PLAIN_STEPS = 64
NEWTON_STEPS = 100
EPS = 2.0**-52


# -- small linear algebra --------------------------------------------------------------------------


@inline
def squared_norm(M):
    """Sum of the squared entries of a matrix."""
    return (
        M[0] * M[0]
        + M[1] * M[1]
        + M[2] * M[2]
        + M[3] * M[3]
        + M[4] * M[4]
        + M[5] * M[5]
        + M[6] * M[6]
        + M[7] * M[7]
        + M[8] * M[8]
    )


@inline
def inverse(F):
    """F⁻¹ by cofactors. The scales of F's columns do not matter; for thin ellipsoids, they differ widely."""
    s0 = max(abs(F[0]), abs(F[3]), abs(F[6]))
    s1 = max(abs(F[1]), abs(F[4]), abs(F[7]))
    s2 = max(abs(F[2]), abs(F[5]), abs(F[8]))
    a, d, g = F[0] / s0, F[3] / s0, F[6] / s0
    b, e, h = F[1] / s1, F[4] / s1, F[7] / s1
    c, f, i = F[2] / s2, F[5] / s2, F[8] / s2
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    k = a * A + b * B + c * C
    k0, k1, k2 = 1.0 / (k * s0), 1.0 / (k * s1), 1.0 / (k * s2)
    return (
        A * k0,
        (c * h - b * i) * k0,
        (b * f - c * e) * k0,
        B * k1,
        (a * i - c * g) * k1,
        (c * d - a * f) * k1,
        C * k2,
        (b * g - a * h) * k2,
        (a * e - b * d) * k2,
    )


@inline
def largest_eigenvalue(G):
    """Largest eigenvalue of GᵀG, by the trigonometric formula, with a relative error of a few eps."""
    a = G[0] * G[0] + G[3] * G[3] + G[6] * G[6]
    b = G[1] * G[1] + G[4] * G[4] + G[7] * G[7]
    c = G[2] * G[2] + G[5] * G[5] + G[8] * G[8]
    d = G[0] * G[1] + G[3] * G[4] + G[6] * G[7]
    e = G[1] * G[2] + G[4] * G[5] + G[7] * G[8]
    f = G[0] * G[2] + G[3] * G[5] + G[6] * G[8]
    m = (a + b + c) / 3.0
    p = math.sqrt(((a - m) ** 2 + (b - m) ** 2 + (c - m) ** 2 + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p <= EPS * m:
        return m * (1.0 + 4.0 * EPS)
    a, b, c, d, e, f = (a - m) / p, (b - m) / p, (c - m) / p, d / p, e / p, f / p
    half = 0.5 * (a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f))
    angle = arc_cosine(min(1.0, max(-1.0, half))) / 3.0
    return m + 2.0 * p * sine_cosine(angle)[1]


@inline
def between(a, b):
    """Angle between two vectors in radians, also accurate near zero."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    return arc_tangent(math.sqrt(x * x + y * y + z * z), dot(a, b))


# -- rays ------------------------------------------------------------------------------------------


@inline
def exit_of_ray(G, p, e):
    """Largest t with p + t e in {x : |G x| <= 1}, for p inside; t is in units of |e|.

    If rounding has put p outside, p counts as a point of the surface, so a hit always exists.
    """
    v = apply(G, e)
    w = apply(G, p)
    a, b, c = dot(v, v), dot(v, w), min(dot(w, w) - 1.0, 0.0)
    root = math.sqrt(b * b - a * c)
    if b > 0.0:
        return -c / (b + root)  # This quotient equals the one below, but is free of cancellation.
    return (root - b) / a


# -- Rimon-Boyd: level surfaces --------------------------------------------------------------------


@inline
def _turn(m, n, f, g):
    """Make columns m and n orthogonal by one Jacobi rotation, and apply the rotation to columns f and g as well."""
    a, b, c = dot(m, m), dot(n, n), dot(m, n)
    if c * c <= 1e-30 * a * b:
        return m, n, f, g, False
    zeta = (b - a) / (2.0 * c)
    t = 1.0 / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
    if zeta < 0.0:
        t = -t
    cos = 1.0 / math.sqrt(1.0 + t * t)
    sin = cos * t
    return (
        (cos * m[0] - sin * n[0], cos * m[1] - sin * n[1], cos * m[2] - sin * n[2]),
        (sin * m[0] + cos * n[0], sin * m[1] + cos * n[1], sin * m[2] + cos * n[2]),
        (cos * f[0] - sin * g[0], cos * f[1] - sin * g[1], cos * f[2] - sin * g[2]),
        (sin * f[0] + cos * g[0], sin * f[1] + cos * g[1], sin * f[2] + cos * g[2]),
        True,
    )


@njit()
def orthogonal_columns(m0, m1, m2):
    """Columns of M V, where V is the rotation that makes them orthogonal (one-sided Jacobi)."""
    for _ in range(30):
        m0, m1, _, _, turned01 = _turn(m0, m1, m0, m1)
        m0, m2, _, _, turned02 = _turn(m0, m2, m0, m2)
        m1, m2, _, _, turned12 = _turn(m1, m2, m1, m2)
        if not (turned01 or turned02 or turned12):
            break
    return m0, m1, m2


@njit()
def touch(F1, G2, r):
    """Point of E1 that the growing level surfaces of E2 touch first, and the level there.

    The paper's appendix A computes this point from an eigenvector of a 6x6 matrix. The point also minimises |M u + d|
    over |u| <= 1 with M = F2⁻¹F1 and d = -F2⁻¹r. The minimisation takes one 3x3 symmetric eigenproblem (of MᵀM, by
    one-sided Jacobi, which never forms the product) and one scalar secular equation.

    Parameters
    ----------
    F1, G2 : tuple of 9 float
        Factor of E1 and inverse factor of E2.
    r : tuple of 3 float
        The vector c2 - c1.

    Returns
    -------
    x : tuple of 3 float
        The point relative to c1; r itself if c2 lies in E1.
    level : float
        The level |F2⁻¹(x - r)|, which is at most 1 exactly when the ellipsoids overlap.
    """
    f0, f1, f2 = (F1[0], F1[3], F1[6]), (F1[1], F1[4], F1[7]), (F1[2], F1[5], F1[8])
    m0, m1, m2 = apply(G2, f0), apply(G2, f1), apply(G2, f2)
    for _ in range(30):
        m0, m1, f0, f1, turned01 = _turn(m0, m1, f0, f1)
        m0, m2, f0, f2, turned02 = _turn(m0, m2, f0, f2)
        m1, m2, f1, f2, turned12 = _turn(m1, m2, f1, f2)
        if not (turned01 or turned02 or turned12):
            break
    d = apply(G2, r)
    s0, s1, s2 = dot(m0, m0), dot(m1, m1), dot(m2, m2)
    g0, g1, g2 = dot(m0, d), dot(m1, d), dot(m2, d)

    # The secular equation is |v(lam)| = 1 with v_i = g_i / (s_i + lam). From any lower bound, Newton's method for 1/|v|
    # increases monotonically to the root. The next two lines compute such bounds: the first line keeps only one term of
    # |v|², and the second line replaces every s_i by the largest one.
    lam = max(0.0, abs(g0) - s0, abs(g1) - s1, abs(g2) - s2)
    lam = max(lam, math.sqrt(g0 * g0 + g1 * g1 + g2 * g2) - max(s0, s1, s2))
    for _ in range(100):
        h0, h1, h2 = 1.0 / (s0 + lam), 1.0 / (s1 + lam), 1.0 / (s2 + lam)
        v0, v1, v2 = g0 * h0, g1 * h1, g2 * h2
        length = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
        if length <= 1.0:
            if lam == 0.0:
                return r, 0.0  # The center c2 lies in E1.
            break
        step = (length - 1.0) * length * length / (v0 * v0 * h0 + v1 * v1 * h1 + v2 * v2 * h2)
        lam += step
        if step <= EPS * lam:
            break
    v0, v1, v2 = g0 / (s0 + lam), g1 / (s1 + lam), g2 / (s2 + lam)
    k = 1.0 / math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v0, v1, v2 = k * v0, k * v1, k * v2
    x = (
        f0[0] * v0 + f1[0] * v1 + f2[0] * v2,
        f0[1] * v0 + f1[1] * v1 + f2[1] * v2,
        f0[2] * v0 + f1[2] * v1 + f2[2] * v2,
    )
    w = (
        m0[0] * v0 + m1[0] * v1 + m2[0] * v2 - d[0],
        m0[1] * v0 + m1[1] * v1 + m2[1] * v2 - d[1],
        m0[2] * v0 + m1[2] * v1 + m2[2] * v2 - d[2],
    )
    return x, math.sqrt(dot(w, w))


@njit()
def rimon_boyd(F1, G1, F2, G2, r):
    """Near points by level surfaces: on each ellipsoid, the point that the other's level surfaces touch first.

    Returns
    -------
    x1, x2 : tuple of 3 float
        Points relative to c1; they are one common point if the ellipsoids overlap.
    distance : float
        |x2 - x1|, an upper bound on the distance; 0 if the ellipsoids overlap.
    status : int
    """
    x1, level = touch(F1, G2, r)
    if level <= 1.0:
        return x1, x1, 0.0, OVERLAP
    y, _ = touch(F2, G1, (-r[0], -r[1], -r[2]))
    x2 = (r[0] + y[0], r[1] + y[1], r[2] + y[2])
    w = minus(x2, x1)
    return x1, x2, math.sqrt(dot(w, w)), SEPARATE


# -- the center line -------------------------------------------------------------------------------


@njit()
def center_line(G1, G2, r):
    """Points at which the segment between the centers leaves E1 and enters E2.

    Returns
    -------
    x1, x2 : tuple of 3 float
        Points relative to c1; they are one common point if the ellipsoids meet on that segment.
    distance : float
    status : int
        A common point proves `OVERLAP`; `SEPARATE` only means that no overlap was found on the line.
    """
    zero = (0.0, 0.0, 0.0)
    square = dot(r, r)
    if square == 0.0:
        return zero, zero, 0.0, OVERLAP
    t1 = exit_of_ray(G1, zero, r)
    t2 = 1.0 - exit_of_ray(G2, zero, r)
    if t1 >= t2:
        x = along(zero, 0.5 * (min(t1, 1.0) + max(t2, 0.0)), r)
        return x, x, 0.0, OVERLAP
    return along(zero, t1, r), along(zero, t2, r), (t2 - t1) * math.sqrt(square), SEPARATE


# -- Lin-Han: the true near points -----------------------------------------------------------------


@njit()
def lin_han(F1, G1, F2, G2, r, angle):
    """Near points by Lin and Han's moving balls, up to a given angle.

    A ball inside each ellipsoid touches its surface at the current point. The segment between the balls' centers gives
    the next two points. The iteration stops when, at both points, the outward normal and the direction to the other
    point differ by at most `angle`. A pair that has not converged after `PLAIN_STEPS` is finished by `_newton`.

    Parameters
    ----------
    F1, G1, F2, G2 : tuple of 9 float
        Factors and their inverses.
    r : tuple of 3 float
        The vector c2 - c1.
    angle : float
        Angle in radians.

    Returns
    -------
    x1, x2 : tuple of 3 float
        Points relative to c1; they are one common point if the ellipsoids were found to overlap.
    distance : float
        |x2 - x1|; 0 if the ellipsoids overlap.
    iterations : int
    status : int
    """
    # Let s be the smallest semi-axis of an ellipsoid, and A = GᵀG. The radius of curvature at x is at least s²|A x|, so
    # a ball of this radius that touches the surface at x from inside lies in the ellipsoid.
    k1 = 1.0 / largest_eigenvalue(G1)
    k2 = 1.0 / largest_eigenvalue(G2)
    p1, p2 = (0.0, 0.0, 0.0), r
    for iteration in range(1, PLAIN_STEPS + 1):
        e = minus(p2, p1)
        if e[0] == 0.0 and e[1] == 0.0 and e[2] == 0.0:
            return p1, p1, 0.0, iteration, OVERLAP
        t1 = exit_of_ray(G1, p1, e)
        t2 = 1.0 - exit_of_ray(G2, minus(p2, r), (-e[0], -e[1], -e[2]))
        if t1 >= t2:
            x = along(p1, 0.5 * (min(t1, 1.0) + max(t2, 0.0)), e)
            return x, x, 0.0, iteration, OVERLAP
        x1, x2 = along(p1, t1, e), along(p1, t2, e)
        w1 = apply_transposed(G1, apply(G1, x1))
        w2 = apply_transposed(G2, apply(G2, minus(x2, r)))
        if between(w1, e) <= angle and between(w2, (-e[0], -e[1], -e[2])) <= angle:
            return x1, x2, (t2 - t1) * math.sqrt(dot(e, e)), iteration, SEPARATE
        p1, p2 = along(x1, -k1, w1), along(x2, -k2, w2)
    return _newton(F1, G1, F2, G2, r, minus(p2, p1), angle)


@njit()
def _newton(F1, G1, F2, G2, r, last, angle):
    """Finish a slow Lin-Han pair: find an overlap by level surfaces, or else the best separating direction by Newton.

    For a unit vector n, g(n) = n·r - |F1ᵀn| - |F2ᵀn| is the gap between the supporting planes. Where g is positive, it
    proves separation and is quasi-concave; its maximum is the distance, and lies at the direction of x2 - x1. The near
    points for n are the two support points, whose normals are n and -n up to rounding. Derivatives are taken in the
    plane perpendicular to n. A gap of 1e-12 is therefore as well conditioned as a gap of 1.

    The method starts from the best of three directions: the last direction of Lin-Han, and the normals of the tangent
    planes at the two level-surface points. Both planes separate the ellipsoids.
    """
    x, level = touch(F1, G2, r)
    if level <= 1.0:
        return x, x, 0.0, PLAIN_STEPS, OVERLAP
    back = (-r[0], -r[1], -r[2])
    y, _ = touch(F2, G1, back)
    n = _unit(apply_transposed(G2, apply(G2, minus(r, x))))
    m = _unit(apply_transposed(G1, apply(G1, minus(y, back))))
    last = _unit(last)
    if not _gap(F1, F2, r, n) > _gap(F1, F2, r, m):
        n = m
    if not _gap(F1, F2, r, n) > _gap(F1, F2, r, last):
        n = last

    size = math.sqrt(dot(r, r))
    square1 = squared_norm(F1)
    square2 = squared_norm(F2)
    iteration = PLAIN_STEPS
    while True:
        iteration += 1
        u1, u2, h1, h2, x1, x2 = _supports(F1, F2, r, n)
        w = minus(x2, x1)
        gap = dot(n, r) - h1 - h2
        e1, e2 = across(n)
        a1, a2 = dot(e1, w), dot(e2, w)
        steepness = math.sqrt(a1 * a1 + a2 * a2)
        distance = math.sqrt(dot(w, w))
        # The rounding error of x2 - x1 has a part proportional to |r| and, because the direction of Fᵀn is rounded, a
        # part proportional to |F|²/h. This error limits how finely angles can be resolved.
        rounding = 8.0 * EPS * (size + square1 / h1 + square2 / h2)
        if steepness <= rounding or between(w, n) <= angle:
            if gap > 0.0:
                return x1, x2, distance, iteration, SEPARATE
            if gap >= -rounding:
                return x1, x1, 0.0, iteration, OVERLAP  # Ellipsoids that touch up to rounding count as overlapping.
            break
        if iteration >= PLAIN_STEPS + NEWTON_STEPS:
            break

        # Take a Newton step in the plane perpendicular to n, which the columns e1 and e2 of E span. In this plane,
        # -g'' = Σ (FᵀE)ᵀ(I - u uᵀ)(FᵀE)/h + gap I, where h = |Fᵀn| and u = Fᵀn/h.
        b11, b12, b22 = _curvature(F1, u1, h1, e1, e2)
        c11, c12, c22 = _curvature(F2, u2, h2, e1, e2)
        b11, b12, b22 = b11 + c11 + max(gap, 0.0), b12 + c12, b22 + c22 + max(gap, 0.0)
        det = b11 * b22 - b12 * b12
        if det <= 1e-14 * b11 * b22:
            det = b11 * b22
            b12 = 0.0
        q1, q2 = (b22 * a1 - b12 * a2) / det, (b11 * a2 - b12 * a1) / det
        slope = a1 * q1 + a2 * q2
        noise = 4.0 * EPS * (size + h1 + h2)
        t = 1.0
        moved = False
        for _ in range(60):
            m = _unit(along(along(n, t * q1, e1), t * q2, e2))
            u1, u2, k1, k2, x1, x2 = _supports(F1, F2, r, m)
            gain = dot(m, r) - k1 - k2 - gap
            if gain >= 1e-4 * t * slope:
                moved = True
            elif gain >= -noise:
                # Near the maximum, rounding hides the change in g itself, so accept a step that clearly reduces the
                # slope of g.
                w = minus(x2, x1)
                d1, d2 = across(m)
                moved = math.sqrt(dot(d1, w) ** 2 + dot(d2, w) ** 2) <= 0.7 * steepness
            if moved:
                break
            t *= 0.5
        if not moved:
            break
        n = m
    return x1, x2, distance, iteration, UNCONVERGED


@inline
def _unit(v):
    """Normalise v; scale it first, because normals of thin ellipsoids can have any size."""
    k = 1.0 / max(abs(v[0]), abs(v[1]), abs(v[2]))
    v = (k * v[0], k * v[1], k * v[2])
    k = 1.0 / math.sqrt(dot(v, v))
    return (k * v[0], k * v[1], k * v[2])


@inline
def _gap(F1, F2, r, n):
    """Gap between the supporting planes of direction n; at most 0 unless n separates."""
    u1, u2 = apply_transposed(F1, n), apply_transposed(F2, n)
    return dot(n, r) - math.sqrt(dot(u1, u1)) - math.sqrt(dot(u2, u2))


@inline
def _supports(F1, F2, r, n):
    """Unit vectors of Fᵀn, widths |Fᵀn|, and the supports of E1 along n and of E2 along -n."""
    u1, u2 = apply_transposed(F1, n), apply_transposed(F2, n)
    h1, h2 = math.sqrt(dot(u1, u1)), math.sqrt(dot(u2, u2))
    u1, u2 = (u1[0] / h1, u1[1] / h1, u1[2] / h1), (u2[0] / h2, u2[1] / h2, u2[2] / h2)
    return u1, u2, h1, h2, apply(F1, u1), minus(r, apply(F2, u2))


@inline
def _curvature(F, u, h, e1, e2):
    """Second derivatives of |Fᵀn| along e1 and e2, as a sum of squares that loses no digits."""
    v1, v2 = apply_transposed(F, e1), apply_transposed(F, e2)
    v1, v2 = along(v1, -dot(u, v1), u), along(v2, -dot(u, v2), u)
    return dot(v1, v1) / h, dot(v1, v2) / h, dot(v2, v2) / h


# -- common interface of all methods ----------------------------------------------------------------


@njit()
def near_points(method, F1, G1, F2, G2, r, angle):
    """Near points by the method with a given number.

    Returns
    -------
    x1, x2 : tuple of 3 float
        Points relative to c1.
    distance : float
    iterations : int
    status : int
    """
    if method == LIN_HAN:
        return lin_han(F1, G1, F2, G2, r, angle)
    if method == CENTER_LINE:
        x1, x2, distance, status = center_line(G1, G2, r)
    else:
        x1, x2, distance, status = rimon_boyd(F1, G1, F2, G2, r)
    return x1, x2, distance, 1, status


@njit()
def near_points_of_pairs(method, offset, F1, F2, angle, x1, x2, distance, iterations, status):
    """Fill x1, x2 (n, 3), distance, iterations and status (n,) for n pairs.

    `offset` (n, 3) is c2 - c1, the factors are (n, 3, 3), and the points are relative to c1.
    """
    for k in range(len(offset)):
        r = (offset[k, 0], offset[k, 1], offset[k, 2])
        A, B = matrix(F1[k]), matrix(F2[k])
        p, q, distance[k], iterations[k], status[k] = near_points(method, A, inverse(A), B, inverse(B), r, angle)
        for i in range(3):
            x1[k, i] = p[i]
            x2[k, i] = q[i]
