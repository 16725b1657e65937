"""Two ellipsoids: the contact function of Perram and Wertheim, and the witnesses it leads to.

With shape matrices P and Q, r = b - a and K(s) = (1-s) P + s Q, the function

    F(s) = s (1-s) rᵀ K(s)⁻¹ r

is concave on [0, 1] and the ellipsoids overlap exactly if max F <= 1. In 3-D F = s(1-s) q(s)/d(s)
with a quadratic q and a cubic d whose coefficients are formed once, so a Newton step is a few
scalar operations. Neither F nor s is trusted afterwards: n = K⁻¹ r and the points
a + (1-s) P n = b - s Q n are checked by themselves (see docs/certified.md).

Symmetric matrices are six numbers in the order xx, xy, xz, yy, yz, zz. All functions are pure and
branch-free; a number may be a float or a vector of eight (see `vectors`), one for each of eight pairs.

References
----------
Perram and Wertheim (1985), J. Comput. Phys. 58(3), doi:10.1016/0021-9991(85)90171-8.
"""

from loewner._kernels._jit import inline, njit
from loewner._kernels.vectors import larger, magnitude, root, smaller

UNIT_ROUNDOFF = 2.0**-53

# Bound on the relative rounding error of a shape matrix that was formed from its factor, rotated
# and applied to a vector, in units of trace(Q) |n|²: the derivation in docs/certified.md needs 52.
SHAPE_ROUNDINGS = 128.0 * UNIT_ROUNDOFF

# The same for positions (translation, rotated center, dot product), in units of the lengths that
# were added; docs/certified.md needs 20.
POSITION_ROUNDINGS = 64.0 * UNIT_ROUNDOFF


@inline
def adjugate(p0, p1, p2, p3, p4, p5):
    """Adjugate of a symmetric 3x3 matrix."""
    return (
        p3 * p5 - p4 * p4,
        p2 * p4 - p1 * p5,
        p1 * p4 - p2 * p3,
        p0 * p5 - p2 * p2,
        p1 * p2 - p0 * p4,
        p0 * p3 - p1 * p1,
    )


@inline
def times(p0, p1, p2, p3, p4, p5, x, y, z):
    """Symmetric matrix times vector."""
    return p0 * x + p1 * y + p2 * z, p1 * x + p3 * y + p4 * z, p2 * x + p4 * y + p5 * z


@inline
def mixed_adjugate(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5):
    """adj(P + Q) - adj(P) - adj(Q)."""
    return (
        p3 * q5 + p5 * q3 - 2.0 * p4 * q4,
        p2 * q4 + p4 * q2 - p1 * q5 - p5 * q1,
        p1 * q4 + p4 * q1 - p2 * q3 - p3 * q2,
        p0 * q5 + p5 * q0 - 2.0 * p2 * q2,
        p1 * q2 + p2 * q1 - p0 * q4 - p4 * q0,
        p0 * q3 + p3 * q0 - 2.0 * p1 * q1,
    )


@inline
def polynomials(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z):
    """Coefficients of F, and where to start to look for its maximum.

    Returns
    -------
    d0, e1, e2, e3 : float
        d(s) = det K(s) in powers of s.
    c0, k1, k2 : float
        q(s) = rᵀ adj K(s) r.
    s : float
    """
    a0, a1, a2, a3, a4, a5 = adjugate(p0, p1, p2, p3, p4, p5)
    b0, b1, b2, b3, b4, b5 = adjugate(q0, q1, q2, q3, q4, q5)
    m0, m1, m2, m3, m4, m5 = mixed_adjugate(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5)
    # First in the Bernstein basis (1-s)^i s^j ...
    d0 = p0 * a0 + p1 * a1 + p2 * a2
    d1 = a0 * q0 + a3 * q3 + a5 * q5 + 2.0 * (a1 * q1 + a2 * q2 + a4 * q4)
    d2 = b0 * p0 + b3 * p3 + b5 * p5 + 2.0 * (b1 * p1 + b2 * p2 + b4 * p4)
    d3 = q0 * b0 + q1 * b1 + q2 * b2
    ux, uy, uz = times(a0, a1, a2, a3, a4, a5, x, y, z)
    vx, vy, vz = times(m0, m1, m2, m3, m4, m5, x, y, z)
    wx, wy, wz = times(b0, b1, b2, b3, b4, b5, x, y, z)
    c0 = ux * x + uy * y + uz * z
    c1 = vx * x + vy * y + vz * z
    c2 = wx * x + wy * y + wz * z
    # Two spheres attain the maximum at s = radius of a / sum of radii; use the radii along r.
    tx, ty, tz = times(p0, p1, p2, p3, p4, p5, x, y, z)
    hp = root(larger(tx * x + ty * y + tz * z, 0.0))
    tx, ty, tz = times(q0, q1, q2, q3, q4, q5, x, y, z)
    hq = root(larger(tx * x + ty * y + tz * z, 0.0))
    # Concentric ellipsoids (r = 0) would divide zero by zero: F is 0 everywhere, any s will do.
    s = (hp + 1e-300) / (hp + hq + 2e-300)
    # ... then in powers of s, for Horner's rule.
    return d0, d1 - 3.0 * d0, 3.0 * d0 - 2.0 * d1 + d2, d3 - d0 + d1 - d2, c0, c1 - 2.0 * c0, c0 - c1 + c2, s


@inline
def newton_step(d0, e1, e2, e3, c0, k1, k2, s):
    """One guarded step towards the maximum of F."""
    d = d0 + s * (e1 + s * (e2 + s * e3))
    dd = e1 + s * (2.0 * e2 + 3.0 * s * e3)
    ddd = 2.0 * e2 + 6.0 * s * e3
    q = c0 + s * (k1 + s * k2)
    qq = k1 + 2.0 * s * k2
    w = s - s * s
    # F = f/d; Newton for F' = g/d² = 0
    f = w * q
    ff = (1.0 - 2.0 * s) * q + w * qq
    fff = 2.0 * ((1.0 - 2.0 * s) * qq - q + w * k2)
    g = ff * d - f * dd
    gg = fff * d - f * ddd
    t = s - g * d / (gg * d - 2.0 * g * dd)
    # F is concave, so a step past the end only means "far that way"; NaN (r = 0) falls to the lower guard.
    low = 0.125 * s
    high = 0.875 + 0.125 * s
    return smaller(larger(t, low), high)


@inline
def normal_at(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, s):
    """F(s) and K(s)⁻¹ r."""
    u = 1.0 - s
    k0 = u * p0 + s * q0
    k1 = u * p1 + s * q1
    k2 = u * p2 + s * q2
    k3 = u * p3 + s * q3
    k4 = u * p4 + s * q4
    k5 = u * p5 + s * q5
    a0, a1, a2, a3, a4, a5 = adjugate(k0, k1, k2, k3, k4, k5)
    inverse = 1.0 / (k0 * a0 + k1 * a1 + k2 * a2)
    nx, ny, nz = times(a0, a1, a2, a3, a4, a5, x, y, z)
    nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
    return s * u * (nx * x + ny * y + nz * z), nx, ny, nz


@inline
def maximize(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, steps):
    """Maximize F by a fixed number of guarded Newton steps.

    Returns
    -------
    F, s : the value and where it is taken
    nx, ny, nz : K(s)⁻¹ r
    """
    d0, e1, e2, e3, c0, k1, k2, s = polynomials(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z)
    for _ in range(steps):
        s = newton_step(d0, e1, e2, e3, c0, k1, k2, s)
    F, nx, ny, nz = normal_at(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, s)
    return F, s, nx, ny, nz


@inline
def outward_width(p0, p1, p2, p3, p4, p5, x, y, z, squared_length):
    """√(nᵀPn), P n, with the square root rounded outward by the error of a rotated shape matrix."""
    px, py, pz = times(p0, p1, p2, p3, p4, p5, x, y, z)
    square = px * x + py * y + pz * z
    square = larger(0.0, square) + SHAPE_ROUNDINGS * (p0 + p3 + p5) * squared_length
    return root(square) * (1.0 + 4.0 * UNIT_ROUNDOFF), px, py, pz


@inline
def separation(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, size):
    """Certified lower bound on the signed distance of two ellipsoids, by the direction n.

    `size` is the sum of the lengths that went into r. Any n gives a valid bound, of either sign;
    NaN or a vanishing n give NaN, which compares false with everything.
    """
    squared = nx * nx + ny * ny + nz * nz
    hp, _, _, _ = outward_width(p0, p1, p2, p3, p4, p5, nx, ny, nz, squared)
    hq, _, _, _ = outward_width(q0, q1, q2, q3, q4, q5, nx, ny, nz, squared)
    return gap_bound(nx * x + ny * y + nz * z, hp, hq, root(squared), size)


@inline
def gap_bound(offset, hp, hq, length, size):
    """The bound of `separation` from n·r, the two outward widths and |n|."""
    bound = (offset - hp - hq) / length - POSITION_ROUNDINGS * size
    # The quotient itself rounds; step away from it in the safe direction.
    return bound - 8.0 * UNIT_ROUNDOFF * magnitude(bound)


@inline
def nearness(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, nx, ny, nz, s, sigma_a, sigma_b, size):
    """Two points, one surely in each ellipsoid, and the certified level of their common point.

    Returns
    -------
    level : float
        The point a + (1-s) P n lies in both ellipsoids if this is at most 1.
    distance : float
        Certified upper bound on the distance of the two points (one in each ellipsoid).
    depth : float
        If level <= 1, the ellipsoids penetrate each other by at least this much.
    ax, ay, az, bx, by, bz : float
        The two points, relative to the center of a.
    """
    squared = nx * nx + ny * ny + nz * nz
    length = root(squared)
    hp, px, py, pz = outward_width(p0, p1, p2, p3, p4, p5, nx, ny, nz, squared)
    hq, qx, qy, qz = outward_width(q0, q1, q2, q3, q4, q5, nx, ny, nz, squared)
    u = 1.0 - s
    # Level of each point in its own ellipsoid: the width, plus what rounding of P n does to it.
    la = u * (hp + SHAPE_ROUNDINGS * (p0 + p3 + p5) * length / sigma_a)
    lb = s * (hq + SHAPE_ROUNDINGS * (q0 + q3 + q5) * length / sigma_b)
    # What separates the two points: zero in exact arithmetic, r - K n here.
    gx = x - u * px - s * qx
    gy = y - u * py - s * qy
    gz = z - u * pz - s * qz
    slack = root(gx * gx + gy * gy + gz * gz) + POSITION_ROUNDINGS * size
    lc = lb + slack / sigma_b
    # A NaN in either must stay one: `larger` passes on that of its second argument.
    level = (larger(la, lc) + 0.0 * la) * (1.0 + 8.0 * UNIT_ROUNDOFF)
    # A ball of radius (1 - level) σ about the common point is inside each.
    depth = ((1.0 - la) * sigma_a + (1.0 - lc) * sigma_b) * (1.0 - 16.0 * UNIT_ROUNDOFF)
    # Pull each point back into its own ellipsoid where it sticks out.
    fa = u / larger(1.0, la * (1.0 + 8.0 * UNIT_ROUNDOFF))
    fb = s / larger(1.0, lb * (1.0 + 8.0 * UNIT_ROUNDOFF))
    ax = fa * px
    ay = fa * py
    az = fa * pz
    bx = x - fb * qx
    by = y - fb * qy
    bz = z - fb * qz
    dx = bx - ax
    dy = by - ay
    dz = bz - az
    distance = root(dx * dx + dy * dy + dz * dz) * (1.0 + 8.0 * UNIT_ROUNDOFF) + POSITION_ROUNDINGS * size
    return level, distance, depth, ax, ay, az, bx, by, bz


@inline
def shape_matrix(F):
    """F Fᵀ of a factor, row by row."""
    return (
        F[0] * F[0] + F[1] * F[1] + F[2] * F[2],
        F[0] * F[3] + F[1] * F[4] + F[2] * F[5],
        F[0] * F[6] + F[1] * F[7] + F[2] * F[8],
        F[3] * F[3] + F[4] * F[4] + F[5] * F[5],
        F[3] * F[6] + F[4] * F[7] + F[5] * F[8],
        F[6] * F[6] + F[7] * F[7] + F[8] * F[8],
    )


@inline
def turned(r, x, y, z):
    """R times a vector; R row by row, of which more may follow."""
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


@inline
def turned_back(r, x, y, z):
    """Rᵀ times a vector; R row by row, of which more may follow."""
    return r[0] * x + r[3] * y + r[6] * z, r[1] * x + r[4] * y + r[7] * z, r[2] * x + r[5] * y + r[8] * z


@inline
def dot(ax, ay, az, bx, by, bz):
    """a · b."""
    return ax * bx + ay * by + az * bz


@inline
def cross(ax, ay, az, bx, by, bz):
    """a × b."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inline
def rotated(r00, r01, r02, r10, r11, r12, r20, r21, r22, q0, q1, q2, q3, q4, q5):
    """R Q Rᵀ of a symmetric matrix."""
    t00, t01, t02 = times(q0, q1, q2, q3, q4, q5, r00, r01, r02)
    t10, t11, t12 = times(q0, q1, q2, q3, q4, q5, r10, r11, r12)
    t20, t21, t22 = times(q0, q1, q2, q3, q4, q5, r20, r21, r22)
    return (
        r00 * t00 + r01 * t01 + r02 * t02,
        r00 * t10 + r01 * t11 + r02 * t12,
        r00 * t20 + r01 * t21 + r02 * t22,
        r10 * t10 + r11 * t11 + r12 * t12,
        r10 * t20 + r11 * t21 + r12 * t22,
        r20 * t20 + r21 * t21 + r22 * t22,
    )


@njit()
def contact(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z):
    """Maximum of the contact function and where it is taken, iterated to convergence.

    Returns
    -------
    F, s : float
        The ellipsoids overlap (touching included) exactly if F <= 1.
    """
    F, s, _, _, _ = maximize(p0, p1, p2, p3, p4, p5, q0, q1, q2, q3, q4, q5, x, y, z, 12)
    return F, s
