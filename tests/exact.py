"""Containment, and the gap of two ellipsoids, in rational arithmetic: doubles are rationals, so nothing here rounds."""

from fractions import Fraction
from itertools import combinations
from math import isqrt

import numpy as np


def rational(array: np.ndarray) -> np.ndarray:
    """The same numbers as exact fractions, in an object array."""
    array = np.asarray(array, dtype=float)
    return np.array([Fraction(float(x)) for x in array.ravel()], dtype=object).reshape(array.shape)


def points_outside(points: np.ndarray, center: np.ndarray, factor: np.ndarray) -> int:
    """How many points lie outside {c + L u : |u| <= 1}, L lower triangular, exactly."""
    L, c = rational(factor), rational(center)
    assert not np.triu(factor, 1).any()
    outside = 0
    for x in rational(points):
        y: list[Fraction] = []
        for i, row in enumerate(L):
            y.append((x[i] - c[i] - sum(row[k] * y[k] for k in range(i))) / row[i])
        outside += sum(v * v for v in y) > 1
    return outside


def halfspaces_crossed(A: np.ndarray, b: np.ndarray, center: np.ndarray, factor: np.ndarray) -> int:
    """How many half-spaces A x <= b the ellipsoid {c + F u : |u| <= 1} leaves, exactly (rationals allowed)."""
    A = A if A.dtype == object else rational(A)
    b = b if b.dtype == object else rational(b)
    F, c = rational(factor), rational(center)
    crossed = 0
    for row, bound in zip(A, b, strict=True):
        slack = bound - sum(row * c)
        reach = row @ F
        crossed += slack < 0 or sum(reach * reach) > slack * slack
    return crossed


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack(
        [
            u[..., 1] * v[..., 2] - u[..., 2] * v[..., 1],
            u[..., 2] * v[..., 0] - u[..., 0] * v[..., 2],
            u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0],
        ],
        axis=-1,
    )


def hull_planes(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every plane through three vertices with all others on one side, exactly: A x <= b in rationals.

    Floating point only throws out triples whose two sides are beyond doubt; fractions decide the rest.
    """
    V = np.asarray(vertices, dtype=float)
    triples = np.array(list(combinations(range(len(V)), 3)))
    a, b, c = (V[triples[:, k]] for k in range(3))
    n = _cross(b - a, c - a)
    side = np.einsum("tk,tvk->tv", n, V[None] - a[:, None])
    # Far above the rounding of a 3 x 3 determinant of the coordinates as they stand.
    doubt = 1e-13 * np.abs(V - V[0]).max() ** 3 + 1e-15 * np.abs(V).max() * np.abs(V - V[0]).max() ** 2
    maybe = ~((side.max(axis=1) > doubt) & (side.min(axis=1) < -doubt))
    R = rational(V)
    planes, bounds = [], []
    for i, j, k in triples[maybe]:
        normal = _cross(R[j] - R[i], R[k] - R[i])
        if not any(normal):
            continue
        value = R @ normal
        offset = value[i]
        if all(value <= offset):
            planes.append(normal)
            bounds.append(offset)
        elif all(value >= offset):
            planes.append(-normal)
            bounds.append(-offset)
    return np.array(planes, dtype=object), np.array(bounds, dtype=object)


class ExactEllipsoid:
    """The image {M (c + F u) + t : |u| <= 1} of an ellipsoid under the affine map that the doubles of a pose say.

    Everything asked of it is answered without rounding, but for the square root in `reach`, which comes as two bounds.
    """

    # Roots are enclosed to this many binary places relative to a unit far below any length in the tests.
    PLACES = 400

    def __init__(self, center: np.ndarray, factor: np.ndarray, T: np.ndarray) -> None:
        M, t = rational(T[:3, :3]), rational(T[:3, 3])
        self.center = M @ rational(center) + t
        self.factor = M @ rational(factor)

    def reach(self, n: np.ndarray) -> tuple[Fraction, Fraction]:
        """Bounds, next to each other, on how far the ellipsoid reaches from its center along n, times |n|."""
        return root_bounds(sum(w * w for w in n @ self.factor))

    def contains(self, x: np.ndarray) -> bool:
        """Whether it holds the point x of rationals: |F⁻¹ (x - c)| <= 1 by Cramer's rule."""
        f, r = self.factor, x - self.center
        cofactors = np.stack([_cross(f[:, 1], f[:, 2]), _cross(f[:, 2], f[:, 0]), _cross(f[:, 0], f[:, 1])])
        determinant = sum(f[:, 0] * cofactors[0])
        return bool(sum(v * v for v in cofactors @ r) <= determinant * determinant)


def root_bounds(square: Fraction) -> tuple[Fraction, Fraction]:
    """Two rationals 2**-PLACES apart with the square root between them."""
    unit = 1 << ExactEllipsoid.PLACES
    low = isqrt(square.numerator * unit * unit // square.denominator)
    return Fraction(low, unit), Fraction(low + 1, unit)


def gap_bounds(a: ExactEllipsoid, b: ExactEllipsoid, n: np.ndarray) -> tuple[Fraction, Fraction]:
    """Bounds, next to each other, on the gap from a to b between planes square to the doubles n.

    The distance of the two is at least the first; it is the largest such gap over all n.
    """
    n = rational(n)
    (low_a, high_a), (low_b, high_b), (low_n, high_n) = a.reach(n), b.reach(n), root_bounds(sum(n * n))
    along = sum(n * (b.center - a.center))
    low, high = along - high_a - high_b, along - low_a - low_b
    return low / (high_n if low > 0 else low_n), high / (low_n if high > 0 else high_n)
