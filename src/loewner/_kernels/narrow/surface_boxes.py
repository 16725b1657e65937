"""Records for two surfaces at two poses, and tests of whether boxes of their trees come near each other.

All tests are in the axes of the first body's frame, in single precision. All boxes of a tree are rotated alike, so one
rotation serves a whole query.

References
----------
Gottschalk, Lin and Manocha (1996), "OBBTree", doi:10.1145/237170.237244: fifteen axes decide whether two boxes meet.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.columns import KIND, OUTER_CENTER, OUTER_SHAPE, SOLID, SURFACE, SURFACE_AT
from loewner._kernels.ellipsoids.contact import outward_width
from loewner._kernels.linalg3 import apply, apply_transposed, dot, minus, plus, product, scaled
from loewner._kernels.narrow.gjk_robust import off_orthonormal
from loewner._kernels.pieces.shapes import placed_support, rotation_of
from loewner._kernels.simd.memory import reader, record_kind
from loewner._kernels.simd.vectors import absolute, load_single, maximum, minimum, movemask
from loewner._kernels.tolerances import SINGLE_ROUNDOFF
from loewner._kernels.trees.triangle_tree import CORNERS, DIAGONALS, ROWS, WIDE, WIDE_BITS

# Allowed error along each of the fifteen axes, relative to the lengths involved: BENDS times the sum of the deviations
# of both rotations from orthonormality, plus ROUNDINGS.
BENDS = 8.0  # certified.md B39
ROUNDINGS = 64.0 * SINGLE_ROUNDOFF  # certified.md B40


class Tree(NamedTuple):
    """A surface as the kernels use it: the arrays of `trees.triangle_tree`, and a point of each connected part."""

    boxes: Any
    children: Any
    blocks: Any
    parts: Any
    diagonals: Any


class Box(NamedTuple):
    """Middle and half widths of a box along a tree's axes, with slack for rounding, in double and single precision."""

    middle: Any
    half: Any
    single: Any
    wide: Any


class Relation(NamedTuple):
    """Pose of b in the axes of a's frame, in single precision.

    Attributes
    ----------
    turn : tuple of 9
        Product of a's transposed rotation and b's rotation.
    size : tuple of 9
        Absolute values of the entries of `turn`.
    shift : tuple of 3
    slack : float32
        Bound on the errors of sums of lengths, plus the distance at which boxes count as meeting.
    """

    turn: Any
    size: Any
    shift: Any
    slack: Any


@inline
def is_surface(P):
    """Return whether a piece is a surface."""
    return P.layout[P.piece, KIND] <= SURFACE


@inline
def is_solid(P):
    """Return whether a piece is a solid: a surface together with all that it winds around."""
    return P.layout[P.piece, KIND] == SOLID


# Function that reads the tree of a surface from a table of arrays, given the address of the table.
tree_at = reader(record_kind(Tree, "S1 I1 F1 F1 S1"))


@inline
def surface_of(P):
    """Tree of a piece that is a surface."""
    return tree_at(P.layout[P.piece, SURFACE_AT])


@inline
def singles(v):
    """Convert a vector to single precision."""
    f = np.float32
    return f(v[0]), f(v[1]), f(v[2])


@inline
def relation(A, B, shift, size, near):
    """`Relation` of B to the surface A: boxes within `near` count as meeting; `size` is a sum of lengths."""
    R, S = rotation_of(A), rotation_of(B)
    bend = off_orthonormal(R) + off_orthonormal(S) + 2e-15
    m = product((R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]), S)
    s = apply_transposed(R, shift)
    slack = near * (1.0 + bend) + (BENDS * bend + ROUNDINGS) * size
    f = np.float32
    return Relation(
        (f(m[0]), f(m[1]), f(m[2]), f(m[3]), f(m[4]), f(m[5]), f(m[6]), f(m[7]), f(m[8])),
        (
            f(abs(m[0])), f(abs(m[1])), f(abs(m[2])), f(abs(m[3])), f(abs(m[4])), f(abs(m[5])), f(abs(m[6])),
            f(abs(m[7])), f(abs(m[8])),
        ),
        singles(s),
        f(slack),
    )  # fmt: skip


@inline
def box_at(boxes, slot):
    """Middle and half widths of one box."""
    at = (slot >> WIDE_BITS) * ROWS + (slot & (WIDE - 1))
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
    """Vector from the middle of a box of a to the middle of a box of b, in a's axes."""
    m, s = relation.turn, relation.shift
    return (
        m[0] * middle_b[0] + m[1] * middle_b[1] + m[2] * middle_b[2] + (s[0] - middle_a[0]),
        m[3] * middle_b[0] + m[4] * middle_b[1] + m[5] * middle_b[2] + (s[1] - middle_a[1]),
        m[6] * middle_b[0] + m[7] * middle_b[1] + m[8] * middle_b[2] + (s[2] - middle_a[2]),
    )


@inline
def meeting(relation, t, g, h):
    """Bits of the lanes whose boxes are not proven apart; `t` connects the middles, `g` and `h` are half widths."""
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
def meeting_between(first, last, middle_a, middle_b, g, h):
    """Bits of the lanes in which a's axes do not prove the boxes apart on the straight path of b between two places.

    Parameters
    ----------
    first, last : Relation
        Relations of a to b at both places.
    middle_a, middle_b, g, h
        Middles and half widths of the boxes.
    """
    t, s, y, z = between(first, middle_a, middle_b), between(last, middle_a, middle_b), first.size, last.size
    e = max(first.slack, last.slack)
    return movemask(
        _touching(t[0], s[0], (g[0] + e) + (y[0] * h[0] + y[1] * h[1] + y[2] * h[2]),
                  (g[0] + e) + (z[0] * h[0] + z[1] * h[1] + z[2] * h[2]))
        & _touching(t[1], s[1], (g[1] + e) + (y[3] * h[0] + y[4] * h[1] + y[5] * h[2]),
                    (g[1] + e) + (z[3] * h[0] + z[4] * h[1] + z[5] * h[2]))
        & _touching(t[2], s[2], (g[2] + e) + (y[6] * h[0] + y[7] * h[1] + y[8] * h[2]),
                    (g[2] + e) + (z[6] * h[0] + z[7] * h[1] + z[8] * h[2]))
    )  # fmt: skip


@inline
def _touching(first, last, reach_first, reach_last):
    """Mask of lanes in which two intervals, about `first` and `last`, do not lie on the same side of 0."""
    above = minimum(first - reach_first, last - reach_last)
    return (above <= np.float32(0.0)) & (maximum(first + reach_first, last + reach_last) >= np.float32(0.0))


@inline
def opens_first(a, b, slot_a, slot_b):
    """Return whether to open a's box instead of b's box: the larger box, unless it is a leaf; at most one is a leaf."""
    if a.children[slot_a] < 0 or b.children[slot_b] < 0:
        return b.children[slot_b] < 0
    (_, g), (_, h) = box_at(a.boxes, slot_a), box_at(b.boxes, slot_b)
    return max(g[0], max(g[1], g[2])) >= max(h[0], max(h[1], h[2]))


@inline
def in_box(boxes, node, query):
    """Bits of the boxes of a node that meet a box, and that come within `far` of planes m x = limit from below.

    The query consists of the `Box`, an array of planes (rows of four numbers), the number of planes to use, and `far`.
    """
    box, planes, count, far = query
    middles, halves = boxes_of(boxes, node)
    bits = movemask(
        (absolute(middles[0] - box.single[0]) <= halves[0] + box.wide[0])
        & (absolute(middles[1] - box.single[1]) <= halves[1] + box.wide[1])
        & (absolute(middles[2] - box.single[2]) <= halves[2] + box.wide[2])
    )
    for k in range(count):
        if bits == 0:
            break
        bits &= ~movemask(farthest(middles, halves, planes, 4 * k, 1.0) <= np.float32(planes[4 * k + 3] - far))
    return bits


@inline
def plane_gaps(middles, halves, planes, count, gaps):
    """Raise the squared lower bounds in `gaps` to the squared distances of the boxes from the far sides of planes."""
    for k in range(count):
        gap = np.float32(planes[4 * k + 3]) - farthest(middles, halves, planes, 4 * k, 1.0)
        gap = maximum(gap, np.float32(0.0))
        gaps = maximum(gaps, gap * gap)
    return gaps


@inline
def farthest(middles, halves, planes, at, sign):
    """Extent of boxes along the normal at entry `at` of `planes`, or along its opposite, in single precision."""
    f = np.float32
    x, y, z = f(sign * planes[at]), f(sign * planes[at + 1]), f(sign * planes[at + 2])
    return (middles[0] * x + middles[1] * y + middles[2] * z) + (
        halves[0] * abs(x) + halves[1] * abs(y) + halves[2] * abs(z)
    )


@inline
def squared_gaps(relation, t, g, h):
    """Lower bounds on the squared distances of boxes: the larger of the bounds along a's axes and along b's axes.

    The parameters are documented in `meeting`; lengths are in a's axes, which a pose may stretch by 1e-6.
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


class Way(NamedTuple):
    """A direction in the axes of a tree, split into an axis and two diagonals: where their rows are, and their shares.

    Attributes
    ----------
    n : tuple of 3 float
        The direction.
    axis, edge, corner : int
        Places of the axis in the rows of boxes, and of the two diagonals in the rows of diagonals.
    lean, share, edge_share, corner_share : float32
        The share of the axis, with and without its sign, and the shares of the diagonals.
    """

    n: Any
    axis: Any
    edge: Any
    corner: Any
    lean: Any
    share: Any
    edge_share: Any
    corner_share: Any


@inline
def squared_gap(t, halves, half):
    """Squared distances of boxes along common axes, in single precision; t is the vector between their middles."""
    x = maximum(absolute(t[0]) - (halves[0] + half[0]), np.float32(0.0))
    y = maximum(absolute(t[1]) - (halves[1] + half[1]), np.float32(0.0))
    z = maximum(absolute(t[2]) - (halves[2] + half[2]), np.float32(0.0))
    return x * x + y * y + z * z


@inline
def gaps_from_box(boxes, node, query):
    """Squared lower bounds on the distances of a node's boxes from a box and from the far sides of planes.

    Also returns the vectors from the middle of the box to the middles of the node's boxes, and their half widths.
    """
    middle, half, planes, count = query
    middles, halves = boxes_of(boxes, node)
    t = minus(middles, middle)
    return plane_gaps(middles, halves, planes, count, squared_gap(t, halves, half)), t, halves


@inline
def way_along(n):
    """Split a direction, in single precision, by the order of its coordinates: see `trees.triangle_tree`."""
    x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
    left, behind, below = n[0] < 0.0, n[1] < 0.0, n[2] < 0.0
    high, low = max(x, max(y, z)), min(x, min(y, z))
    middle = max(min(x, y), min(max(x, y), z))
    axis = 0 if x == high else 1 if y == high else 2
    if axis != 2 and z == low:
        edge = 2 * left + behind
    elif axis != 1 and y == low:
        edge = 4 + 2 * left + below
    else:
        edge = 8 + 2 * behind + below
    corner = CORNERS + 4 * left + 2 * behind + below
    share = high - middle
    lean = -share if n[axis] < 0.0 else share
    n = np.float64(n[0]), np.float64(n[1]), np.float64(n[2])
    return Way(n, axis * WIDE, edge * WIDE, corner * WIDE, lean, share, middle - low, low)


@inline
def reaches_of(tree, node, way):
    """Upper bounds on how far the triangles in each box of a node extend along a direction."""
    at, more = node * ROWS + way.axis, node * DIAGONALS
    middle, half = load_single(tree.boxes, at), load_single(tree.boxes, at + 3 * WIDE)
    edge, corner = load_single(tree.diagonals, more + way.edge), load_single(tree.diagonals, more + way.corner)
    return (middle * way.lean + half * way.share) + (edge * way.edge_share + corner * way.corner_share)


@inline
def reach_at(tree, slot, way):
    """Upper bound on how far the triangles in one box extend along a direction."""
    lane = slot & (WIDE - 1)
    at, more = (slot >> WIDE_BITS) * ROWS + way.axis + lane, (slot >> WIDE_BITS) * DIAGONALS + lane
    middle, half = tree.boxes[at], tree.boxes[at + 3 * WIDE]
    edge, corner = tree.diagonals[more + way.edge], tree.diagonals[more + way.corner]
    return (middle * way.lean + half * way.share) + (edge * way.edge_share + corner * way.corner_share)


@inline
def box_in_frame(A, B, shift, far, size):
    """`Box` around a convex piece B, widened by `far`, in the axes of A's frame."""
    R = rotation_of(A)
    slack = _slack(R, far, size)
    m = h = (0.0, 0.0, 0.0)
    # The loops here and below keep the code small, because the large support function is inlined wherever it is called.
    for axis in range(3):
        middle, half = _extent(B, shift, (R[axis], R[axis + 3], R[axis + 6]), slack)
        m, h = (m[1], m[2], middle), (h[1], h[2], half)
    return Box(m, h, singles(m), singles(h))


@inline
def oval_in_frame(A, B, shift, far, size):
    """`Box` around the outer ellipsoid of a convex piece B, widened by `far`, in the axes of A's frame."""
    R, S = rotation_of(A), rotation_of(B)
    slack = _slack(R, far, size)
    t, p, q = B.table, B.piece, OUTER_SHAPE
    c = plus(apply(S, (t[p, OUTER_CENTER], t[p, OUTER_CENTER + 1], t[p, OUTER_CENTER + 2])), shift)
    Q = t[p, q], t[p, q + 1], t[p, q + 2], t[p, q + 3], t[p, q + 4], t[p, q + 5]
    h0 = _half_width(Q, apply_transposed(S, (R[0], R[3], R[6]))) + slack
    h1 = _half_width(Q, apply_transposed(S, (R[1], R[4], R[7]))) + slack
    h2 = _half_width(Q, apply_transposed(S, (R[2], R[5], R[8]))) + slack
    m, h = apply_transposed(R, c), (h0, h1, h2)
    return Box(m, h, singles(m), singles(h))


@inline
def _slack(R, far, size):
    """Widening of a box along the axes of R: the distance `far`, the bend of not quite rigid poses, and rounding."""
    bend = off_orthonormal(R) + 1e-15
    return far * (1.0 + bend) + (4.0 * bend + ROUNDINGS) * size


@inline
def _half_width(Q, n):
    """Extent of an ellipsoid with shape matrix Q along n from its center, rounded outward."""
    width, _ = outward_width(Q, n, dot(n, n))
    return width


@inline
def _extent(B, shift, n, slack):
    """Position of a piece's middle along a direction, and the piece's half width."""
    below = above = 0.0
    for side in range(2):
        way = scaled(2.0 * side - 1.0, n)
        below, above = above, dot(way, plus(placed_support(B, way), shift)) + slack
    middle = 0.5 * (above - below)
    return middle, above - middle
