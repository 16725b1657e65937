"""Two surfaces at two poses: their records, and which boxes of their trees come near each other.

Everything is seen in the axes of the first body's frame, in single precision. All boxes of a tree are turned alike, so
one rotation serves a whole query.

References
----------
Gottschalk, Lin and Manocha (1996), "OBBTree", doi:10.1145/237170.237244: fifteen axes tell whether two boxes meet.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.columns import KIND, SOLID, SURFACE, SURFACE_AT
from loewner._kernels.linalg3 import apply_symmetric, apply_transposed, dot
from loewner._kernels.records import ENTRIES
from loewner._kernels.simd.memory import floats_at, integers_at, singles_at
from loewner._kernels.simd.vectors import absolute, load_single, maximum, movemask, sqrt
from loewner._kernels.tolerances import SINGLE_ROUNDOFF
from loewner._kernels.trees.triangle_tree import OVAL, ROWS, WIDE

# What fifteen axes may be off by: so many times by how much both rotations fail to be orthonormal, and so many
# roundoffs of single precision, of the lengths that places are made of.
BENDS = 8.0  # derived 4, certified.md B39
ROUNDINGS = 64.0 * SINGLE_ROUNDOFF  # derived 33, certified.md B40


class Tree(NamedTuple):
    """A surface as kernels see it: the arrays of `trees.triangle_tree`, and a point of each connected part."""

    boxes: Any
    children: Any
    blocks: Any
    parts: Any
    ellipsoids: Any


class Relation(NamedTuple):
    """How b lies in the axes of a's frame, in single precision.

    Attributes
    ----------
    turn : tuple of 9
        The product of a's transposed rotation and b's.
    size : tuple of 9
        Its absolute values.
    shift : tuple of 3
    slack : float32
        What sums of lengths may be off by, and the distance that counts as meeting.
    """

    turn: Any
    size: Any
    shift: Any
    slack: Any


@inline
def is_surface(P):
    """Whether a piece is one."""
    return P.layout[P.piece, KIND] <= SURFACE


@inline
def is_solid(P):
    """Whether it holds what it winds around."""
    return P.layout[P.piece, KIND] == SOLID


@inline
def surface_of(P):
    """Tree of a surface that is a piece."""
    t = integers_at(P.layout[P.piece, SURFACE_AT], (5, ENTRIES))
    return Tree(
        singles_at(t[0, 0], (t[0, 1],)),
        integers_at(t[1, 0], (t[1, 1],)),
        floats_at(t[2, 0], (t[2, 1],)),
        floats_at(t[3, 0], (t[3, 1],)),
        singles_at(t[4, 0], (t[4, 1],)),
    )


@inline
def _off_orthonormal(T, t):
    """Bound on ‖RᵀR - 1‖ of a pose."""
    squares = 0.0
    for a in range(3):
        for b in range(3):
            entry = T[t, 0, a] * T[t, 0, b] + T[t, 1, a] * T[t, 1, b] + T[t, 2, a] * T[t, 2, b]
            entry -= 1.0 if a == b else 0.0
            squares += entry * entry
    return np.sqrt(squares) + 1e-15


@inline
def relation(A, B, shift, size, near):
    """How a placed surface lies to another one: what is `near` counts as meeting; `size` is a sum of lengths."""
    Ta, a, Tb, b = A.poses, A.row, B.poses, B.row
    bend = _off_orthonormal(Ta, a) + _off_orthonormal(Tb, b)
    m = (
        _column_product(Ta, a, Tb, b, 0, 0), _column_product(Ta, a, Tb, b, 0, 1), _column_product(Ta, a, Tb, b, 0, 2),
        _column_product(Ta, a, Tb, b, 1, 0), _column_product(Ta, a, Tb, b, 1, 1), _column_product(Ta, a, Tb, b, 1, 2),
        _column_product(Ta, a, Tb, b, 2, 0), _column_product(Ta, a, Tb, b, 2, 1), _column_product(Ta, a, Tb, b, 2, 2),
    )  # fmt: skip
    R = (
        Ta[a, 0, 0], Ta[a, 0, 1], Ta[a, 0, 2], Ta[a, 1, 0], Ta[a, 1, 1], Ta[a, 1, 2], Ta[a, 2, 0], Ta[a, 2, 1],
        Ta[a, 2, 2],
    )  # fmt: skip
    s = apply_transposed(R, shift)
    slack = near * (1.0 + bend) + (BENDS * bend + ROUNDINGS) * size
    f = np.float32
    return Relation(
        (f(m[0]), f(m[1]), f(m[2]), f(m[3]), f(m[4]), f(m[5]), f(m[6]), f(m[7]), f(m[8])),
        (
            f(abs(m[0])), f(abs(m[1])), f(abs(m[2])), f(abs(m[3])), f(abs(m[4])), f(abs(m[5])), f(abs(m[6])),
            f(abs(m[7])), f(abs(m[8])),
        ),
        (f(s[0]), f(s[1]), f(s[2])),
        f(slack),
    )  # fmt: skip


@inline
def _column_product(Ta, a, Tb, b, i, j):
    return Ta[a, 0, i] * Tb[b, 0, j] + Ta[a, 1, i] * Tb[b, 1, j] + Ta[a, 2, i] * Tb[b, 2, j]


@inline
def box_at(boxes, slot):
    """Middle and half widths of one box."""
    at = (slot >> 4) * ROWS + (slot & 15)
    return (
        (boxes[at], boxes[at + WIDE], boxes[at + 2 * WIDE]),
        (boxes[at + 3 * WIDE], boxes[at + 4 * WIDE], boxes[at + 5 * WIDE]),
    )


@inline
def boxes_of(boxes, node):
    """Middles and half widths of the boxes of a node, as vectors."""
    at = node * ROWS
    return (
        (load_single(boxes, at), load_single(boxes, at + WIDE), load_single(boxes, at + 2 * WIDE)),
        (load_single(boxes, at + 3 * WIDE), load_single(boxes, at + 4 * WIDE), load_single(boxes, at + 5 * WIDE)),
    )


@inline
def between(relation, middle_a, middle_b):
    """From the middle of a box of a to that of one of b, in a's axes."""
    m, s = relation.turn, relation.shift
    return (
        m[0] * middle_b[0] + m[1] * middle_b[1] + m[2] * middle_b[2] + (s[0] - middle_a[0]),
        m[3] * middle_b[0] + m[4] * middle_b[1] + m[5] * middle_b[2] + (s[1] - middle_a[1]),
        m[6] * middle_b[0] + m[7] * middle_b[1] + m[8] * middle_b[2] + (s[2] - middle_a[2]),
    )


@inline
def meeting(relation, t, g, h):
    """Bits of the lanes whose boxes are not proven apart: `t` between middles, half widths `g` of a and `h` of b."""
    m, z, e = relation.turn, relation.size, relation.slack
    mask = (
        (absolute(t[0]) <= (g[0] + e) + (z[0] * h[0] + z[1] * h[1] + z[2] * h[2]))
        & (absolute(t[1]) <= (g[1] + e) + (z[3] * h[0] + z[4] * h[1] + z[5] * h[2]))
        & (absolute(t[2]) <= (g[2] + e) + (z[6] * h[0] + z[7] * h[1] + z[8] * h[2]))
        & (absolute(t[0] * m[0] + t[1] * m[3] + t[2] * m[6]) <= (h[0] + e) + (z[0] * g[0] + z[3] * g[1] + z[6] * g[2]))
        & (absolute(t[0] * m[1] + t[1] * m[4] + t[2] * m[7]) <= (h[1] + e) + (z[1] * g[0] + z[4] * g[1] + z[7] * g[2]))
        & (absolute(t[0] * m[2] + t[1] * m[5] + t[2] * m[8]) <= (h[2] + e) + (z[2] * g[0] + z[5] * g[1] + z[8] * g[2]))
    )
    bits = movemask(mask)
    if bits == 0:
        return bits
    mask = (
        (absolute(t[2] * m[3] - t[1] * m[6]) <= (g[1] * z[6] + g[2] * z[3] + e) + (h[1] * z[2] + h[2] * z[1]))
        & (absolute(t[2] * m[4] - t[1] * m[7]) <= (g[1] * z[7] + g[2] * z[4] + e) + (h[0] * z[2] + h[2] * z[0]))
        & (absolute(t[2] * m[5] - t[1] * m[8]) <= (g[1] * z[8] + g[2] * z[5] + e) + (h[0] * z[1] + h[1] * z[0]))
        & (absolute(t[0] * m[6] - t[2] * m[0]) <= (g[0] * z[6] + g[2] * z[0] + e) + (h[1] * z[5] + h[2] * z[4]))
        & (absolute(t[0] * m[7] - t[2] * m[1]) <= (g[0] * z[7] + g[2] * z[1] + e) + (h[0] * z[5] + h[2] * z[3]))
        & (absolute(t[0] * m[8] - t[2] * m[2]) <= (g[0] * z[8] + g[2] * z[2] + e) + (h[0] * z[4] + h[1] * z[3]))
        & (absolute(t[1] * m[0] - t[0] * m[3]) <= (g[0] * z[3] + g[1] * z[0] + e) + (h[1] * z[8] + h[2] * z[7]))
        & (absolute(t[1] * m[1] - t[0] * m[4]) <= (g[0] * z[4] + g[1] * z[1] + e) + (h[0] * z[8] + h[2] * z[6]))
        & (absolute(t[1] * m[2] - t[0] * m[5]) <= (g[0] * z[5] + g[1] * z[2] + e) + (h[0] * z[7] + h[1] * z[6]))
    )
    return bits & movemask(mask)


@inline
def squared_gaps(relation, t, g, h):
    """Lower bounds on the squared distance of boxes, along the axes of a's and along those of b's, whichever says more.

    Parameters as for `meeting`; lengths in a's axes, which a pose may stretch by 1e-6.
    """
    m, z, e = relation.turn, relation.size, relation.slack
    x = absolute(t[0]) - ((g[0] + e) + (z[0] * h[0] + z[1] * h[1] + z[2] * h[2]))
    y = absolute(t[1]) - ((g[1] + e) + (z[3] * h[0] + z[4] * h[1] + z[5] * h[2]))
    w = absolute(t[2]) - ((g[2] + e) + (z[6] * h[0] + z[7] * h[1] + z[8] * h[2]))
    x, y, w = maximum(x, np.float32(0.0)), maximum(y, np.float32(0.0)), maximum(w, np.float32(0.0))
    in_a = x * x + y * y + w * w
    x = absolute(t[0] * m[0] + t[1] * m[3] + t[2] * m[6]) - ((h[0] + e) + (z[0] * g[0] + z[3] * g[1] + z[6] * g[2]))
    y = absolute(t[0] * m[1] + t[1] * m[4] + t[2] * m[7]) - ((h[1] + e) + (z[1] * g[0] + z[4] * g[1] + z[7] * g[2]))
    w = absolute(t[0] * m[2] + t[1] * m[5] + t[2] * m[8]) - ((h[2] + e) + (z[2] * g[0] + z[5] * g[1] + z[8] * g[2]))
    x, y, w = maximum(x, np.float32(0.0)), maximum(y, np.float32(0.0)), maximum(w, np.float32(0.0))
    return maximum(in_a, x * x + y * y + w * w)


@inline
def ellipsoids_of(ellipsoids, node):
    """Centers of the ellipsoids of a node, and the roots of their shape matrices, as vectors."""
    at = node * OVAL
    return (
        (load_single(ellipsoids, at), load_single(ellipsoids, at + WIDE), load_single(ellipsoids, at + 2 * WIDE)),
        (
            load_single(ellipsoids, at + 3 * WIDE),
            load_single(ellipsoids, at + 4 * WIDE),
            load_single(ellipsoids, at + 5 * WIDE),
            load_single(ellipsoids, at + 6 * WIDE),
            load_single(ellipsoids, at + 7 * WIDE),
            load_single(ellipsoids, at + 8 * WIDE),
        ),
    )


@inline
def ellipsoid_at(ellipsoids, slot):
    """The same of one ellipsoid."""
    at = (slot >> 4) * OVAL + (slot & 15)
    return (
        (ellipsoids[at], ellipsoids[at + WIDE], ellipsoids[at + 2 * WIDE]),
        (
            ellipsoids[at + 3 * WIDE],
            ellipsoids[at + 4 * WIDE],
            ellipsoids[at + 5 * WIDE],
            ellipsoids[at + 6 * WIDE],
            ellipsoids[at + 7 * WIDE],
            ellipsoids[at + 8 * WIDE],
        ),
    )


@inline
def _width(root, n):
    v = apply_symmetric(root, n)
    return sqrt(dot(v, v))


@inline
def gaps_along(a, b, n_a, n_b, offset):
    """Lower bounds on the distance of ellipsoids: how far they are apart along a unit vector, in the axes of both."""
    return (dot(b[0], n_b) - _width(b[1], n_b)) - (dot(a[0], n_a) + _width(a[1], n_a)) + offset


@inline
def gaps_between_centers(relation, a, b):
    """Lower bounds on the distance of ellipsoids, along the line of their centers; negative if that says nothing."""
    t = between(relation, a[0], b[0])
    m = relation.turn
    u = (
        m[0] * t[0] + m[3] * t[1] + m[6] * t[2],
        m[1] * t[0] + m[4] * t[1] + m[7] * t[2],
        m[2] * t[0] + m[5] * t[1] + m[8] * t[2],
    )
    squared = dot(t, t)
    return (squared - _width(a[1], t) - _width(b[1], u)) / sqrt(squared + np.float32(1e-35)) - relation.slack
