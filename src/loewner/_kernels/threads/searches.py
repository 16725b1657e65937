"""The GJK search of one thread: a piece at one or two poses, and a static piece.

`narrow.gjk_batch` has the formulas of the walk. Besides polytopes, this module handles curved cores, and balls about
cores, which are added to the points of the difference. Pairs that the walk does not settle stay
UNSETTLED, which claims nothing.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.codes import APART, TOUCHING, UNSETTLED
from loewner._kernels.columns import (
    CONE,
    CORE_CENTER,
    CORE_FACTOR,
    CORE_INTEGERS,
    CORE_KIND,
    CORE_NUMBERS,
    CORE_RADIUS,
    CORE_REACH,
    CORE_START,
    CORE_STOP,
    CYLINDER,
    ELLIPSOID,
    POINT,
    POLYTOPE,
    SEGMENT,
    SURFACE,
)
from loewner._kernels.linalg3 import (
    apply,
    apply_transposed,
    cross,
    dot,
    image,
    minus,
    negated,
    one_norm,
    product,
    scaled,
    selected,
)
from loewner._kernels.narrow.gjk_batch import SHORT, SUM_ERROR, VOLUME_ERROR, advance, faces
from loewner._kernels.narrow.gjk_fast import KEPT
from loewner._kernels.simd.scalars import eight_at, holds, integer_at, lane_of, number_at
from loewner._kernels.simd.vectors import maximum, select, signed_one, sqrt
from loewner._kernels.tolerances import SINGLE_ROUNDOFF

ROUNDS = 12  # Maximum number of rounds; nine in ten pairs need at most six, and 99 in 100 at most ten.

# Bounds on the errors of the height of a support plane and of a point of the Minkowski difference, in units of the
# roundoff times the lengths involved.
PLANE_ERROR = 128.0  # certified.md B61
POINT_ERROR = 32.0  # certified.md B62


class Core(NamedTuple):
    """A piece in its frame: its kind, and the places of its vertices or numbers."""

    kind: Any
    start: Any
    stop: Any
    numbers: Any
    vertices: Any


@inline
def core_at(integers, numbers, vertices, piece):
    """Read the record of a piece.

    Parameters
    ----------
    integers : int32, shape (pieces, CORE_INTEGERS)
        Kind, first vertex, and the vertex after the last.
    numbers : float32, shape (pieces, CORE_NUMBERS)
        Center and factor of a curved core, radius of the added ball, and reach, rounded up.
    vertices : float32, shape (vertices, 4)
        Vertices; the fourth number of each row is unused, and each piece has a multiple of four rows.
    """
    at = CORE_INTEGERS * piece
    return Core(
        integer_at(integers, at + CORE_KIND), integer_at(integers, at + CORE_START),
        integer_at(integers, at + CORE_STOP), numbers + 4 * CORE_NUMBERS * piece, vertices,
    )  # fmt: skip


@inline
def _better(product, number, best, at):
    more = holds(product > best)
    return select(product > best, product, best), number if more else at


@inline
def _farthest_vertex(core, n):
    """Find the farthest vertex by four searches side by side, because each step depends on its previous step."""
    least = lane_of(-np.inf)
    b0, b1, b2, b3 = least, least, least, least
    k0 = k1 = k2 = k3 = core.start
    at = core.start
    while at < core.stop:
        v, w = eight_at(core.vertices, 4 * at), eight_at(core.vertices, 4 * at + 8)
        b0, k0 = _better(v[0] * n[0] + v[1] * n[1] + v[2] * n[2], at, b0, k0)
        b1, k1 = _better(v[4] * n[0] + v[5] * n[1] + v[6] * n[2], at + 1, b1, k1)
        b2, k2 = _better(w[0] * n[0] + w[1] * n[1] + w[2] * n[2], at + 2, b2, k2)
        b3, k3 = _better(w[4] * n[0] + w[5] * n[1] + w[6] * n[2], at + 3, b3, k3)
        at += 4
    b0, k0 = _better(b1, k1, b0, k0)
    b2, k2 = _better(b3, k3, b2, k2)
    b0, k0 = _better(b2, k2, b0, k0)
    return number_at(core.vertices, 4 * k0), number_at(core.vertices, 4 * k0 + 1), number_at(core.vertices, 4 * k0 + 2)


@inline
def _farthest_of_curve(core, n):
    """Find the farthest point of a curved core, as `shapes.core_support` does."""
    x = core.numbers
    center = (
        number_at(x, CORE_CENTER), number_at(x, CORE_CENTER + 1), number_at(x, CORE_CENTER + 2)
    )  # fmt: skip
    if core.kind == POINT:
        return center
    f = CORE_FACTOR
    F = (
        number_at(x, f), number_at(x, f + 1), number_at(x, f + 2), number_at(x, f + 3), number_at(x, f + 4),
        number_at(x, f + 5), number_at(x, f + 6), number_at(x, f + 7), number_at(x, f + 8),
    )  # fmt: skip
    m = apply_transposed(F, n)
    nought, tiny = lane_of(0.0), 1e-30
    around, along = nought, signed_one(m[2])
    if core.kind == ELLIPSOID:
        around = 1.0 / sqrt(maximum(dot(m, m), tiny))
        along = around * m[2]
    elif core.kind == CYLINDER or core.kind == CONE:
        length = sqrt(maximum(m[0] * m[0] + m[1] * m[1], tiny))
        around = 1.0 / length
        if core.kind == CONE:  # Compare the support of the base circle, |xy| - z, with the support of the apex, z.
            apex = m[2] > length - m[2]
            around, along = select(apex, nought, around), select(apex, lane_of(1.0), lane_of(-1.0))
    elif core.kind != SEGMENT:
        # There is no branch for this kind. With NaN, the search proves nothing, and the CPU settles the pair.
        along = lane_of(np.nan)
    return image(F, center, (around * m[0], around * m[1], along))


@inline
def _farthest(core, n):
    """Farthest point of a core along a direction, in its frame."""
    if core.kind <= POLYTOPE:
        return _farthest_vertex(core, n)
    return _farthest_of_curve(core, n)


@inline
def _slack(normal, off, rounding):
    """How far the volume below a face with this normal must be from zero if points are off by up to `off`."""
    return off * sqrt(dot(normal, normal)) + rounding


@inline
def search(upper, first, last, swept, lower, n, keep, off):
    """Walk towards the origin in the difference of two pieces; docs/certified.md, "On a GPU", derives the proofs.

    Parameters
    ----------
    upper, lower : Core
    first, last : tuple
        Rotation and translation of the upper piece in the frame of the lower piece, at both ends.
    swept : bool
        Whether `last` counts. If it does, the upper piece is the convex hull of itself at both ends.
    n : tuple of 3
        First direction, from the lower piece to the upper piece; any direction is valid.
    keep : float
        The distance within which pieces count as touching, rounded up.
    off : float
        Bound on the errors of the upper piece's points that its poses cause, in metres.

    Returns
    -------
    int
        APART, TOUCHING or UNSETTLED.
    """
    if upper.kind <= SURFACE or lower.kind <= SURFACE:
        return UNSETTLED
    radius = number_at(upper.numbers, CORE_RADIUS) + number_at(lower.numbers, CORE_RADIUS) + keep
    lengths = number_at(upper.numbers, CORE_REACH) + number_at(lower.numbers, CORE_REACH) + radius
    size = lengths + one_norm(first[1])
    if swept:
        size = maximum(size, lengths + one_norm(last[1]))
    error = PLANE_ERROR * SINGLE_ROUNDOFF * size + off
    point_off = POINT_ERROR * SINGLE_ROUNDOFF * size + off

    B, C, E = n, n, n
    two = n[0] < n[0]
    three = two
    largest = lane_of(0.0)
    r = 0
    while r < ROUNDS:
        squared = dot(n, n)
        if not holds(squared > SHORT):  # The square may have lost some or all digits.
            return UNSETTLED
        n = scaled(1.0 / sqrt(squared), n)
        back = negated(n)
        u = image(first[0], first[1], _farthest(upper, apply_transposed(first[0], back)))
        if swept:
            other = image(last[0], last[1], _farthest(upper, apply_transposed(last[0], back)))
            u = selected(dot(other, back) > dot(u, back), other, u)
        A = minus(minus(u, _farthest(lower, n)), scaled(radius, n))
        if holds(dot(n, A) > error):
            return APART
        largest = maximum(largest, dot(A, A))
        if r == 0:
            # As in `gjk_fast.measure`, take a weighted mean of the initial direction and the direction of the first
            # point.
            rest = (1.0 - KEPT) / sqrt(dot(A, A))
            n = KEPT * n[0] + rest * A[0], KEPT * n[1] + rest * A[1], KEPT * n[2] + rest * A[2]
            B = A
        else:
            f, g, h, base, normals = faces(A, B, C, E)
            # The origin is certainly inside if it is behind every face, by more than the error of a point.
            cube = SINGLE_ROUNDOFF * largest * sqrt(largest)
            last_normal = cross(minus(E, B), minus(C, B))
            inside = (f < -_slack(normals[0], point_off, VOLUME_ERROR * cube)) & three
            inside = inside & (g < -_slack(normals[1], point_off, VOLUME_ERROR * cube))
            inside = inside & (h < -_slack(normals[2], point_off, VOLUME_ERROR * cube))
            if holds(inside & (base < -_slack(last_normal, point_off, SUM_ERROR * cube))):
                return TOUCHING
            n, B, C, E, two, three = advance(A, B, C, E, two, three, f, g, h)
        r += 1
    return UNSETTLED


@inline
def relative(R, t, S, s):
    """Pose (R, t) in the frame of a pose (S, s), whose rotation S may be inexact by rounding."""
    back = S[0], S[3], S[6], S[1], S[4], S[7], S[2], S[5], S[8]
    return product(back, R), apply(back, minus(t, s))
