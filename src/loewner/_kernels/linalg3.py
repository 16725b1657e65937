"""Linear algebra in three dimensions, on tuples.

Vectors are tuples of three numbers, matrices are tuples of nine in row order, and symmetric matrices are tuples of six
in the order xx, xy, xz, yy, yz, zz. A number may be a float, or a vector of the `simd` package with one entry for each
of several pairs. Everything is inlined, so tuples cost nothing.
"""

from loewner._kernels._jit import inline
from loewner._kernels.simd.vectors import absolute, select, signed_one


@inline
def dot(a, b):
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def cross(a, b):
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline
def plus(a, b):
    """The sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline
def minus(a, b):
    """The difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline
def negated(a):
    """The vector -a."""
    return -a[0], -a[1], -a[2]


@inline
def scaled(t, a):
    """The vector t a."""
    return t * a[0], t * a[1], t * a[2]


@inline
def along(p, t, e):
    """The point p + t e."""
    return p[0] + t * e[0], p[1] + t * e[1], p[2] + t * e[2]


@inline
def one_norm(a):
    """The sum of the absolute values."""
    return absolute(a[0]) + absolute(a[1]) + absolute(a[2])


@inline
def turned(rest, s, with_sine, c, with_cosine):
    """The matrix rest + s with_sine + c with_cosine: the rotation of a joint, where s is the sine and c the cosine."""
    return (
        rest[0] + s * with_sine[0] + c * with_cosine[0],
        rest[1] + s * with_sine[1] + c * with_cosine[1],
        rest[2] + s * with_sine[2] + c * with_cosine[2],
        rest[3] + s * with_sine[3] + c * with_cosine[3],
        rest[4] + s * with_sine[4] + c * with_cosine[4],
        rest[5] + s * with_sine[5] + c * with_cosine[5],
        rest[6] + s * with_sine[6] + c * with_cosine[6],
        rest[7] + s * with_sine[7] + c * with_cosine[7],
        rest[8] + s * with_sine[8] + c * with_cosine[8],
    )


@inline
def image(M, t, v):
    """The point t + M v."""
    return (
        t[0] + M[0] * v[0] + M[1] * v[1] + M[2] * v[2],
        t[1] + M[3] * v[0] + M[4] * v[1] + M[5] * v[2],
        t[2] + M[6] * v[0] + M[7] * v[1] + M[8] * v[2],
    )


@inline
def product(M, N):
    """The product M N of two matrices."""
    return (
        M[0] * N[0] + M[1] * N[3] + M[2] * N[6],
        M[0] * N[1] + M[1] * N[4] + M[2] * N[7],
        M[0] * N[2] + M[1] * N[5] + M[2] * N[8],
        M[3] * N[0] + M[4] * N[3] + M[5] * N[6],
        M[3] * N[1] + M[4] * N[4] + M[5] * N[7],
        M[3] * N[2] + M[4] * N[5] + M[5] * N[8],
        M[6] * N[0] + M[7] * N[3] + M[8] * N[6],
        M[6] * N[1] + M[7] * N[4] + M[8] * N[7],
        M[6] * N[2] + M[7] * N[5] + M[8] * N[8],
    )


@inline
def matrix(F):
    """The nine floats of an array of shape (3, 3)."""
    return F[0, 0], F[0, 1], F[0, 2], F[1, 0], F[1, 1], F[1, 2], F[2, 0], F[2, 1], F[2, 2]


@inline
def apply(M, v):
    """The product M v; M may have further entries after its nine."""
    return (
        M[0] * v[0] + M[1] * v[1] + M[2] * v[2],
        M[3] * v[0] + M[4] * v[1] + M[5] * v[2],
        M[6] * v[0] + M[7] * v[1] + M[8] * v[2],
    )


@inline
def apply_transposed(M, v):
    """The product Mᵀ v; M may have further entries after its nine."""
    return (
        M[0] * v[0] + M[3] * v[1] + M[6] * v[2],
        M[1] * v[0] + M[4] * v[1] + M[7] * v[2],
        M[2] * v[0] + M[5] * v[1] + M[8] * v[2],
    )


@inline
def apply_symmetric(Q, v):
    """The product Q v of a symmetric matrix and a vector."""
    return (
        Q[0] * v[0] + Q[1] * v[1] + Q[2] * v[2],
        Q[1] * v[0] + Q[3] * v[1] + Q[4] * v[2],
        Q[2] * v[0] + Q[4] * v[1] + Q[5] * v[2],
    )


@inline
def across(n):
    """Two unit vectors perpendicular to a unit vector and to each other.

    Duff and others (2017), "Building an orthonormal basis, revisited", J. Comput. Graph. Tech. 6(1).
    """
    x, y, z = n
    sign = signed_one(z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@inline
def trace(Q):
    """Sum of the diagonal of a symmetric matrix."""
    return Q[0] + Q[3] + Q[5]


@inline
def adjugate(Q):
    """Adjugate of a symmetric matrix."""
    return (
        Q[3] * Q[5] - Q[4] * Q[4],
        Q[2] * Q[4] - Q[1] * Q[5],
        Q[1] * Q[4] - Q[2] * Q[3],
        Q[0] * Q[5] - Q[2] * Q[2],
        Q[1] * Q[2] - Q[0] * Q[4],
        Q[0] * Q[3] - Q[1] * Q[1],
    )


@inline
def mixed_adjugate(P, Q):
    """adj(P + Q) - adj(P) - adj(Q) for symmetric matrices."""
    return (
        P[3] * Q[5] + P[5] * Q[3] - 2.0 * P[4] * Q[4],
        P[2] * Q[4] + P[4] * Q[2] - P[1] * Q[5] - P[5] * Q[1],
        P[1] * Q[4] + P[4] * Q[1] - P[2] * Q[3] - P[3] * Q[2],
        P[0] * Q[5] + P[5] * Q[0] - 2.0 * P[2] * Q[2],
        P[1] * Q[2] + P[2] * Q[1] - P[0] * Q[4] - P[4] * Q[0],
        P[0] * Q[3] + P[3] * Q[0] - 2.0 * P[1] * Q[1],
    )


@inline
def shape_matrix(F):
    """The shape matrix F Fᵀ of a factor."""
    return (
        F[0] * F[0] + F[1] * F[1] + F[2] * F[2],
        F[0] * F[3] + F[1] * F[4] + F[2] * F[5],
        F[0] * F[6] + F[1] * F[7] + F[2] * F[8],
        F[3] * F[3] + F[4] * F[4] + F[5] * F[5],
        F[3] * F[6] + F[4] * F[7] + F[5] * F[8],
        F[6] * F[6] + F[7] * F[7] + F[8] * F[8],
    )


@inline
def rotated_shape(R, Q):
    """The product R Q Rᵀ for a symmetric matrix Q."""
    a = apply_symmetric(Q, (R[0], R[1], R[2]))
    b = apply_symmetric(Q, (R[3], R[4], R[5]))
    c = apply_symmetric(Q, (R[6], R[7], R[8]))
    return (
        R[0] * a[0] + R[1] * a[1] + R[2] * a[2],
        R[0] * b[0] + R[1] * b[1] + R[2] * b[2],
        R[0] * c[0] + R[1] * c[1] + R[2] * c[2],
        R[3] * b[0] + R[4] * b[1] + R[5] * b[2],
        R[3] * c[0] + R[4] * c[1] + R[5] * c[2],
        R[6] * c[0] + R[7] * c[1] + R[8] * c[2],
    )


@inline
def selected(condition, a, b):
    """The vector a where the condition holds, otherwise the vector b."""
    return select(condition, a[0], b[0]), select(condition, a[1], b[1]), select(condition, a[2], b[2])
