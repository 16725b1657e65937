"""The paper's estimate f of the distance of two pieces, from their four ellipsoids (sections 2 and 4)."""

import math

from loewner._kernels._jit import inline, njit
from loewner._kernels.ellipsoids import near_points as near
from loewner._kernels.linalg3 import dot, matrix, minus
from loewner._kernels.tolerances import PAPER_ANGLE


@inline
def offset(x, k, y):
    """Row k of x minus row k of y."""
    return (x[k, 0] - y[k, 0], x[k, 1] - y[k, 1], x[k, 2] - y[k, 2])


@inline
def by_name(centers, factors):
    """Name the centers and factors of the inner and outer ellipsoids of body 1, then of body 2, for n pairs.

    Parameters
    ----------
    centers : ndarray, shape (4, n, 3)
        Centers in metres of the inner and the outer ellipsoid of body 1, then of body 2; all centers of a pair are in
        one frame.
    factors : ndarray, shape (4, n, 3, 3)

    Returns
    -------
    c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o : ndarray
    """
    return (
        centers[0], factors[0], centers[1], factors[1], centers[2], factors[2], centers[3], factors[3]
    )  # fmt: skip


@njit()
def f_from_near_points(v1, v2, distance, r, p1, G1, p2, G2):
    """The paper's f, from the near points of the inner ellipsoids and from the two outer ellipsoids.

    On the line from v1 (at 0) to v2 (at L), the outer ellipsoid of body 1 ends at beta and the outer ellipsoid of body
    2 begins at alpha. Both branches of the printed f are (L + alpha - beta)/2. If the near points are one point (L =
    0), the line through it runs along the centers, and f <= 0.

    Parameters
    ----------
    v1, v2 : tuple of 3 float
        Near points, relative to a common origin.
    distance : float
        L = |v2 - v1|, in metres.
    r : tuple of 3 float
        Direction of the line if L = 0.
    p1, p2 : tuple of 3 float
        Centers of the outer ellipsoids, relative to the same origin.
    G1, G2 : tuple of 9 float
        Inverses of the outer factors.
    """
    e = minus(v2, v1)
    if distance == 0.0 or dot(e, e) == 0.0:
        e = r
    square = dot(e, e)
    if square == 0.0:
        e, square = (1.0, 0.0, 0.0), 1.0
    k = 1.0 / math.sqrt(square)
    e = (k * e[0], k * e[1], k * e[2])
    beta = near.exit_of_ray(G1, minus(v1, p1), e)
    alpha = distance - near.exit_of_ray(G2, minus(v2, p2), (-e[0], -e[1], -e[2]))
    return 0.5 * (distance + alpha - beta)


@njit()
def estimates_of_pairs(method, centers, factors, f):
    """Fill f (n,) for n pairs, in metres; f <= 0 means collision.

    f is never NaN for finite input: a Lin-Han pair that does not converge takes the Rimon-Boyd points.

    Parameters
    ----------
    method : int
        Method of `near_points`; Lin-Han iterates to the angle `PAPER_ANGLE`.
    centers, factors
        Documented in `by_name`.
    """
    c1i, F1i, c1o, F1o, c2i, F2i, c2o, F2o = by_name(centers, factors)
    for k in range(len(f)):
        r = offset(c2i, k, c1i)
        F1, F2 = matrix(F1i[k]), matrix(F2i[k])
        G1, G2 = near.inverse(F1), near.inverse(F2)
        v1, v2, distance, _, status = near.near_points(method, F1, G1, F2, G2, r, PAPER_ANGLE)
        if status == near.UNCONVERGED:
            v1, v2, distance, status = near.rimon_boyd(F1, G1, F2, G2, r)
        p1, p2 = offset(c1o, k, c1i), offset(c2o, k, c1i)
        G1, G2 = near.inverse(matrix(F1o[k])), near.inverse(matrix(F2o[k]))
        f[k] = f_from_near_points(v1, v2, distance, r, p1, G1, p2, G2)
