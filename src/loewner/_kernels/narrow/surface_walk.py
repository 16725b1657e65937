"""The walk through trees of triangles, from leaf to leaf, and the parts that all queries about surfaces share.

A walk keeps on a stack the boxes that it has yet to open. Each function below goes on to the next leaf and returns it
with the height of the stack, so a query is a loop over leaves. The modules `surface_meets`, `surface_distance`,
`surface_depth`, `surface_points` and `mesh_points` have such loops, and use the same memory, which is declared here.
"""

import numpy as np

from loewner._kernels._jit import apart, inline
from loewner._kernels.codes import NO_LIMIT
from loewner._kernels.columns import COLUMNS, KIND, LAYOUT, POINTS_TO, POLYTOPE, REACH, ROUNDING
from loewner._kernels.linalg3 import apply_transposed, dot, image, negated, plus, scaled
from loewner._kernels.narrow import gjk_fast
from loewner._kernels.narrow import surface_boxes as boxes
from loewner._kernels.pieces.shapes import placed_support, reach, rotation_of
from loewner._kernels.records import Placed
from loewner._kernels.simd.memory import Arena, floats, integers
from loewner._kernels.simd.vectors import load, maximum, minimum, movemask, next_lane, store
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, LEVELS, WIDE, size_of

# Error of a coordinate of a placed corner, relative to the lengths involved.
CORNER_ERROR = 16.0 * UNIT_ROUNDOFF  # certified.md B36, B42

# Factor by which a squared lower bound is lowered, so that it stays valid although poses may stretch lengths by 1e-6,
# and although the bound was squared and rounded.
BELIEVED = 1.0 - 1e-5  # certified.md B41

# Weight in the key that orders the boxes of a search: the key is the squared lower bound, plus this weight times the
# squared distance between the centers.
MIDDLES = 0.1

STACK = 2 * LEVELS * WIDE  # Maximum number of entries of the stack: enough for two trees.
# PLANES: number of the most recent planes that a search keeps. PLANE: number of values of a plane (normal, offset).
PLANES, PLANE = 4, 4
PARTING = 14  # Number of values of a plane between triangles of two surfaces at two poses (`surface_swept`).
ORIGIN = (0.0, 0.0, 0.0)

TRIANGLE = Arena(layout=integers(1, LAYOUT), table=floats(1, COLUMNS), points=floats(3 * LEAF))
_layout_of, _table_of, _points_of = TRIANGLE.accessors("layout table points")

MEMORY = Arena(
    # Each entry of the stack holds a box of each tree; a walk through one tree uses only the first column.
    stack=integers(STACK, 2),
    placed=floats(3 * BLOCK),  # Corners of the triangles in two leaves; one leaf may have two poses.
    vertices=floats(gjk_fast.ENTRIES), result=floats(9),  # Memory for a GJK search.
    planes=floats(PLANES * PLANE), parting=floats(PLANES * PARTING),
    # For each entry of the stack: a squared lower bound on the distance, and the key by which entries are ordered.
    bounds=floats(STACK, 2),
    lanes=floats(2 * WIDE),
    first=TRIANGLE, second=TRIANGLE,
    left=integers(1),  # Number of steps that walks may still take.
)  # fmt: skip
stack_of, placed_of, vertices_of, result_of, planes_of, bounds_of, lanes_of, parting_of, left_of = MEMORY.accessors(
    "stack placed vertices result planes bounds lanes parting left"
)
first_of, second_of = MEMORY.addresses("first second")
SIZE = MEMORY.size()  # Size of the memory in bytes.


# -- walks ----------------------------------------------------------------------------------------


@inline
def begun(memory):
    """Put the root, or both roots, on the stack, and allow any number of steps; return the stack's height."""
    left_of(memory)[0] = NO_LIMIT
    return resumed(memory)


@inline
def resumed(memory):
    """Begin a walk with the steps that are left; a walk that needs more ends with boxes on the stack."""
    stack, bounds = stack_of(memory), bounds_of(memory)
    stack[0, 0], stack[0, 1], bounds[0, 0] = 0, 0, 0.0
    return 1


def walking(near):
    """Make a walk through one tree, into the boxes that a function like `surface_boxes.in_box` chooses."""

    @inline
    def next_leaf(tree, memory, height, query):
        """Return the next leaf, a negative entry of `children` (0 at the end), and the height of the stack."""
        stack, left = stack_of(memory), left_of(memory)
        while height > 0 and left[0] > 0:
            height -= 1
            left[0] -= 1
            child = tree.children[stack[height, 0]]
            if child < 0:
                return child, height
            bits = near(tree.boxes, child, query)
            while bits != 0:
                lane, bits = next_lane(bits)
                stack[height, 0] = child * WIDE + lane
                height += 1
        return 0, height

    return next_leaf


_next_in_box = walking(boxes.in_box)


@inline
def next_in_box(tree, box, kept, far, memory, height):
    """Find the next leaf that meets a box and comes within `far` of the first `kept` planes from below."""
    return _next_in_box(tree, memory, height, (box, planes_of(memory), kept, far))


def nearing(gaps_of):
    """Make a walk through one tree from near boxes to far ones.

    `gaps_of` is a function like `surface_boxes.gaps_from_box`. For a node's boxes, it returns squared lower bounds on
    the distances, the middles, and the half widths.
    """

    @inline
    def next_leaf(tree, memory, height, best, query):
        """Return the next leaf whose squared distance may be at most `best` (0 at the end), and the stack's height."""
        stack, bounds = stack_of(memory), bounds_of(memory)
        while height > 0:
            height -= 1
            if bounds[height, 0] * BELIEVED > best:
                continue
            child = tree.children[stack[height, 0]]
            if child < 0:
                return child, height
            gaps, t, halves = gaps_of(tree.boxes, child, query)
            height = push_near(memory, height, gaps, t, halves, best, child, 0, True)
        return 0, 0

    return next_leaf


_next_nearest = nearing(boxes.gaps_from_box)


@inline
def next_nearest(tree, middle, half, kept, best, memory, height):
    """Find the next leaf whose squared distance from a box, and from the far sides of planes, may be at most `best`."""
    return _next_nearest(tree, memory, height, best, (middle, half, planes_of(memory), kept))


@inline
def next_meeting(about, a, b, memory, height):
    """Find the next leaves of two trees whose boxes are not proven apart (0 and 0 at the end), and the height."""
    stack, left = stack_of(memory), left_of(memory)
    while height > 0 and left[0] > 0:
        height -= 1
        left[0] -= 1
        slot_a, slot_b = stack[height, 0], stack[height, 1]
        child_a, child_b = a.children[slot_a], b.children[slot_b]
        if child_a < 0 and child_b < 0:
            return child_a, child_b, height
        if boxes.opens_first(a, b, slot_a, slot_b):
            middle, half = boxes.box_at(b.boxes, slot_b)
            middles, halves = boxes.boxes_of(a.boxes, child_a)
            bits = boxes.meeting(about, boxes.between(about, middles, middle), halves, half)
            while bits != 0:
                lane, bits = next_lane(bits)
                stack[height, 0], stack[height, 1] = child_a * WIDE + lane, slot_b
                height += 1
        else:
            middle, half = boxes.box_at(a.boxes, slot_a)
            middles, halves = boxes.boxes_of(b.boxes, child_b)
            bits = boxes.meeting(about, boxes.between(about, middle, middles), half, halves)
            while bits != 0:
                lane, bits = next_lane(bits)
                stack[height, 0], stack[height, 1] = slot_a, child_b * WIDE + lane
                height += 1
    return 0, 0, height


@inline
def push_near(memory, height, gaps, t, halves, best, child, other, first):
    """Push onto the stack the boxes of a node that may be near enough, the most promising box on top.

    The bounds of many large boxes are 0; the distance between middles, the length of t, still orders these boxes.
    """
    bits = movemask((gaps <= rounded_up(best)) & (halves[0] >= np.float32(0.0)))
    if bits == 0:
        return height
    stack, bounds, lanes = stack_of(memory), bounds_of(memory), lanes_of(memory)
    store(lanes, 0, gaps)
    store(lanes, WIDE, gaps + np.float32(MIDDLES) * dot(t, t))
    base = height
    while bits != 0:
        lane, bits = next_lane(bits)
        bound, order = lanes[lane], lanes[WIDE + lane]
        at = height
        while at > base and bounds[at - 1, 1] < order:
            stack[at, 0], stack[at, 1] = stack[at - 1, 0], stack[at - 1, 1]
            bounds[at, 0], bounds[at, 1] = bounds[at - 1, 0], bounds[at - 1, 1]
            at -= 1
        slot = child * WIDE + lane
        stack[at, 0], stack[at, 1] = (slot, other) if first else (other, slot)
        bounds[at, 0], bounds[at, 1] = bound, order
        height += 1
    return height


@inline
def rounded_up(best):
    """Round a squared distance up to single precision, so that any valid bound above the result is above `best`."""
    return np.float32(best * (1.0 + 2e-5) + 1e-37)


# -- triangles ------------------------------------------------------------------------------------


@inline
def least(x, y, z):
    return minimum(minimum(x, y), z)


@inline
def most(x, y, z):
    return maximum(maximum(x, y), z)


@inline
def low(corners, axis):
    """Lower ends of the boxes of triangles along an axis."""
    return least(corners[0][axis], corners[1][axis], corners[2][axis])


@inline
def high(corners, axis):
    """Upper ends of the boxes of triangles along an axis."""
    return most(corners[0][axis], corners[1][axis], corners[2][axis])


@inline
def lanes_in(child, mask):
    """Bits of a mask for the triangles that a leaf has."""
    return movemask(mask) & ((1 << size_of(child)) - 1)


@inline
def corners_of(blocks, leaf):
    """Corners of the eight triangles of a leaf in the axes of the surface's frame."""
    at = leaf * BLOCK
    return (
        (load(blocks, at), load(blocks, at + LEAF), load(blocks, at + 2 * LEAF)),
        (load(blocks, at + 3 * LEAF), load(blocks, at + 4 * LEAF), load(blocks, at + 5 * LEAF)),
        (load(blocks, at + 6 * LEAF), load(blocks, at + 7 * LEAF), load(blocks, at + 8 * LEAF)),
    )


@inline
def placed_corners(P, blocks, leaf, shift):
    """Corners of the eight triangles of a leaf in world axes."""
    R = rotation_of(P)
    p, q, r = corners_of(blocks, leaf)
    return image(R, shift, p), image(R, shift, q), image(R, shift, r)


@inline
def store_corners(placed, at, corners):
    for k in range(3):
        store(placed, at + 3 * k * LEAF, corners[k][0])
        store(placed, at + (3 * k + 1) * LEAF, corners[k][1])
        store(placed, at + (3 * k + 2) * LEAF, corners[k][2])


@inline
def corners_at(placed, at, lane):
    """Corners of one of the stored triangles."""
    i = at + lane
    return (
        (placed[i], placed[i + LEAF], placed[i + 2 * LEAF]),
        (placed[i + 3 * LEAF], placed[i + 4 * LEAF], placed[i + 5 * LEAF]),
        (placed[i + 6 * LEAF], placed[i + 7 * LEAF], placed[i + 8 * LEAF]),
    )


@inline
def box_gaps(a, b):
    """Squared distances of the box of a triangle from the boxes of eight triangles."""
    return _gap(a, b, 0) + _gap(a, b, 1) + _gap(a, b, 2)


@inline
def _gap(a, b, axis):
    below, above = low(b, axis) - high(a, axis), low(a, axis) - high(b, axis)
    gap = maximum(maximum(below, above), 0.0)
    return gap * gap


@inline
def gap_to_box(blocks, leaf, box):
    """Squared distances of the boxes of eight triangles from a box along the same axes."""
    corners = corners_of(blocks, leaf)
    x, y, z = _gap_along(corners, box, 0), _gap_along(corners, box, 1), _gap_along(corners, box, 2)
    return x * x + y * y + z * z


@inline
def _gap_along(corners, box, axis):
    middle, half = box.middle[axis], box.half[axis]
    above, below = low(corners, axis) - middle - half, -half - (high(corners, axis) - middle)
    return maximum(maximum(above, below), 0.0)


@inline
def triangle_piece(P, triangle, rounding, memory):
    """Make a piece of one triangle of a surface, given by its block and lane, in memory with the layout `TRIANGLE`.

    `rounding` is the radius of the piece: the radius of the surface, or 0 for the core alone.
    """
    layout, table, points = _layout_of(memory), _table_of(memory), _points_of(memory)
    for c in range(LAYOUT):
        layout[0, c] = 0
    for c in range(COLUMNS):
        table[0, c] = 0.0
    layout[0, KIND], layout[0, POINTS_TO] = POLYTOPE, LEAF
    table[0, REACH], table[0, ROUNDING] = reach(P), rounding
    blocks, at = boxes.surface_of(P).blocks, triangle // LEAF * BLOCK + triangle % LEAF
    for axis in range(3):
        for lane in range(LEAF):
            points[axis * LEAF + lane] = blocks[at + (3 * min(lane, 2) + axis) * LEAF]
    return Placed(table, layout, points, 0, P.poses, P.row)


# -- searches of triangles, which end with a plane ------------------------------------------------


# The code of the two searches is long, so all callers share one copy of each.
@apart
def decided(A, B, shift, W, ends, n, error):
    """Call `gjk_fast.decide`."""
    return gjk_fast.decide(A, B, shift, W, ends, n, error)


@apart
def measured(A, B, shift, W, ends, n, error, near, far, result):
    """Call `gjk_fast.measure_along`."""
    return gjk_fast.measure_along(A, B, shift, W, ends, n, error, near, far, result)


@inline
def write_triangle(W, at, corners):
    """Write a triangle as a block of eight points, see `pieces.support`."""
    for axis in range(3):
        W[at + axis * LEAF], W[at + axis * LEAF + 1] = corners[0][axis], corners[1][axis]
        for lane in range(2, LEAF):
            W[at + axis * LEAF + lane] = corners[2][axis]


@inline
def nonzero(n):
    """Return a first direction for a search: n, or an arbitrary direction if n is zero."""
    return n if dot(n, n) > 0.0 else (1.0, 0.0, 0.0)


@inline
def unit(n):
    """Return the unit vector along n, or an arbitrary unit vector if n has no direction."""
    squared = dot(n, n)
    if not 0.0 < squared < np.inf:
        return 0.0, 0.0, 1.0
    return scaled(1.0 / np.sqrt(squared), n)


@inline
def keep_plane(B, shift, R, n, size, planes, k):
    """Write plane k, in the axes R of a surface's frame: the direction n, and a lower bound on B along n."""
    length = np.sqrt(dot(n, n))
    if not 0.0 < length < np.inf:  # If n has no direction, write a plane that excludes no triangle.
        planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2] = ORIGIN
        planes[PLANE * k + 3] = -np.inf
        return
    n = n[0] / length, n[1] / length, n[2] / length
    m = apply_transposed(R, n)
    lowest = dot(n, plus(placed_support(B, negated(n)), shift))
    planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2] = m
    planes[PLANE * k + 3] = lowest - boxes.ROUNDINGS * size


@inline
def lower_plane(B, shift, n, size, planes, k):
    """Lower plane k, which `keep_plane` wrote for the direction n, to the coordinates of B at another pose."""
    length = np.sqrt(dot(n, n))
    if 0.0 < length < np.inf:
        n = n[0] / length, n[1] / length, n[2] / length
        lowest = dot(n, plus(placed_support(B, negated(n)), shift))
        planes[PLANE * k + 3] = min(planes[PLANE * k + 3], lowest - boxes.ROUNDINGS * size)


@inline
def not_beyond(blocks, leaf, planes, k, far):
    """Bits of the triangles of a leaf that come within `far` of plane k from below; NaN corners count."""
    m = planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2]
    p, q, r = corners_of(blocks, leaf)
    limit = planes[PLANE * k + 3] - far
    return ~movemask((dot(p, m) <= limit) & (dot(q, m) <= limit) & (dot(r, m) <= limit))


@inline
def not_beyond_any(blocks, leaf, planes, kept, far, bits):
    """Clear, in `bits`, the triangles of a leaf that stay more than `far` below one of the first `kept` planes."""
    for k in range(kept):
        if bits != 0:
            bits &= not_beyond(blocks, leaf, planes, k, far)
    return bits
