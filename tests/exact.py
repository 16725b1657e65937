"""Containment decided in rational arithmetic: doubles are rationals, so nothing here rounds."""

from fractions import Fraction
from itertools import combinations

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
