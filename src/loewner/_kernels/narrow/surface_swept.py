"""Are the triangles of a surface apart from a piece, or from another surface's triangles, between two poses?

Proofs of motions replace a surface by convex parts. Where the parts meet although the triangles do not, this walk
through the trees of triangles finds a plane for each triangle, or each pair of triangles, that comes near.
"""

from loewner._kernels._jit import apart, inline
from loewner._kernels.codes import APART
from loewner._kernels.columns import KIND, ROUNDING, SURFACE
from loewner._kernels.linalg3 import apply_transposed, dot, minus, plus
from loewner._kernels.narrow import gjk_swept
from loewner._kernels.narrow import surface_boxes as boxes
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error, swollen_radii
from loewner._kernels.narrow.surface_boxes import box_in_frame, is_surface, relation, surface_of
from loewner._kernels.narrow.surface_walk import PARTING as PLANE
from loewner._kernels.narrow.surface_walk import PLANES
from loewner._kernels.pieces.pack import placed, shift_between
from loewner._kernels.pieces.shapes import radius, rotation_of
from loewner._kernels.simd.vectors import lowest, maximum, minimum, movemask, next_lane
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, leaf_of, size_of

# Searches for one interval, and pairs of leaves, at most: more take longer than halving the interval.
MOST_SEARCHES, MOST_LEAVES = 256, 512


@apart
def triangles_apart(A, first, last, keep, stretch, travel, gjk, memory):
    """Whether a surface and another piece are proven farther apart than `keep` between two poses of the latter.

    Each triangle of the surface is parted at both poses by a plane from the other piece, or from each of its triangles,
    as `gjk_swept.separated` does. False if that takes too many searches.

    Parameters
    ----------
    A, first, last : Placed
        The surface, and the other piece at both poses.
    keep : float
        Distance, >= 0.
    stretch : float
        Amount by which poses between the two may stretch radii more than these poses do.
    travel : float
        Upper bound on the distance of any point's second place from its first one.
    gjk, memory : int
        Addresses of `gjk_fast.MEMORY` and `surface_walk.MEMORY`.
    """
    # The callee counts references again unless it begins by borrowing.
    A = placed(A, A.piece, A.poses, A.row)
    first, last = placed(first, first.piece, first.poses, first.row), placed(last, last.piece, last.poses, last.row)
    radii, far = radius(A) + radius(last), keep
    if radii > 0.0:
        far += max(swollen_radii(A, first), swollen_radii(A, last)) + radii * stretch
    if is_surface(first):
        return _two_surfaces(A, first, last, keep + radii, far, travel, memory)
    return _surface_and_piece(A, first, last, keep, far, stretch, travel, gjk, memory)


@inline
def _two_surfaces(A, first, last, near, far, travel, memory):
    """Part the triangles of two surfaces; cores that come within `near` meet, and are to be proven `far` apart.

    A plane that parts two triangles mostly parts those around them, too, so the last few are tried on boxes and leaves.
    """
    shift, shift_last = shift_between(A, first), shift_between(A, last)
    size = max(lengths(A, first, shift), lengths(A, last, shift_last))
    error = max(rounding_error(A, first, shift), rounding_error(A, last, shift_last))
    a, b, about = surface_of(A), surface_of(first), relation(A, first, shift, size, far + travel)
    W, result, places = walk.vertices_of(memory), walk.result_of(memory), walk.placed_of(memory)
    stack, planes, n = walk.stack_of(memory), walk.parting_of(memory), walk.ORIGIN
    height, searches, leaves, beyond = walk.begun(memory), 0, 0, far + 4.0 * walk.CORNER_ERROR * size
    slack = far + boxes.ROUNDINGS * size
    while True:
        child_a, child_b, height = _next_pair(about, a, b, planes, min(searches, PLANES), slack, stack, height)
        if child_a >= 0:
            return True
        leaves += 1
        if leaves > MOST_LEAVES:
            return False
        leaf_b = leaf_of(child_b)
        b_first = walk.placed_corners(first, b.blocks, leaf_b, shift)
        b_last = walk.placed_corners(last, b.blocks, leaf_b, shift_last)
        of_a = walk.placed_corners(A, a.blocks, leaf_of(child_a), walk.ORIGIN)
        walk.store_corners(places, 0, of_a)
        walk.store_corners(places, BLOCK, b_first)
        walk.store_corners(places, 2 * BLOCK, b_last)
        left = (1 << size_of(child_a)) - 1
        for k in range(min(searches, PLANES)):
            n = planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2]
            left &= ~_beyond(of_a, b_first, b_last, n, beyond)
        while left != 0:
            lane_a, left = next_lane(left)
            one = walk.corners_at(places, 0, lane_a)
            near_it = _near_along(one, b_first, b_last, beyond, 0) & _near_along(one, b_first, b_last, beyond, 1)
            bits = walk.lanes_in(child_b, near_it & _near_along(one, b_first, b_last, beyond, 2))
            while bits != 0:
                lane_b, bits = next_lane(bits)
                begin, end = walk.corners_at(places, BLOCK, lane_b), walk.corners_at(places, 2 * BLOCK, lane_b)
                walk.write_triangle(W, 0, one)
                _write_two(W, 3 * LEAF, begin, end)
                n = walk.nonzero(minus(plus(plus(begin[0], begin[1]), begin[2]), plus(plus(one[0], one[1]), one[2])))
                status, _, _, n = walk.measured(A, first, shift, W, (LEAF, 2 * LEAF), n, error, near, far, result)
                if status != APART or searches == MOST_SEARCHES:
                    return False
                _keep_parting(A, first, last, shift, shift_last, n, planes, searches % PLANES)
                searches += 1
                beyond_it = _beyond(of_a, b_first, b_last, n, beyond)
                left &= ~beyond_it
                if (beyond_it >> lane_a) & 1 != 0:
                    break


@inline
def _next_pair(about, a, b, planes, count, slack, stack, height):
    """`surface_walk.next_meeting`, without pairs of boxes that one of the planes parts."""
    while height > 0:
        height -= 1
        slot_a, slot_b = stack[height, 0], stack[height, 1]
        if _parted(a, b, slot_a, slot_b, planes, count, slack):
            continue
        child_a, child_b = a.children[slot_a], b.children[slot_b]
        if child_a < 0 and child_b < 0:
            return child_a, child_b, height
        height = walk.push_meeting(about, a, b, slot_a, slot_b, stack, height)
    return 0, 0, 0


@inline
def _parted(a, b, slot_a, slot_b, planes, count, slack):
    """Whether one of the planes parts two boxes, the second one at both poses."""
    middle_a, half_a = boxes.box_at(a.boxes, slot_a)
    middle_b, half_b = boxes.box_at(b.boxes, slot_b)
    for k in range(count):
        at = PLANE * k
        above = _along(planes, at + 3, middle_a) + _across(planes, at + 3, half_a) + slack
        low = _along(planes, at + 6, middle_b) - _across(planes, at + 6, half_b) + planes[at + 12]
        low_last = _along(planes, at + 9, middle_b) - _across(planes, at + 9, half_b) + planes[at + 13]
        if above < min(low, low_last):
            return True
    return False


@inline
def _along(planes, at, v):
    return planes[at] * v[0] + planes[at + 1] * v[1] + planes[at + 2] * v[2]


@inline
def _across(planes, at, v):
    return abs(planes[at]) * v[0] + abs(planes[at + 1]) * v[1] + abs(planes[at + 2]) * v[2]


@inline
def _keep_parting(A, first, last, shift, shift_last, n, planes, k):
    """Keep a unit normal from A to the other surface, in the frames of both, and offsets of the latter."""
    at = PLANE * k
    of_a, of_b = apply_transposed(rotation_of(A), n), apply_transposed(rotation_of(first), n)
    of_last = apply_transposed(rotation_of(last), n)
    for axis in range(3):
        planes[at + axis], planes[at + 3 + axis] = n[axis], of_a[axis]
        planes[at + 6 + axis], planes[at + 9 + axis] = of_b[axis], of_last[axis]
    planes[at + 12], planes[at + 13] = dot(n, shift), dot(n, shift_last)


@inline
def _beyond(of_a, first, last, n, far):
    """The triangles of a leaf of A, as bits, that a plane parts from all triangles of another leaf at both poses."""
    low = minimum(_lowest(first, n), _lowest(last, n))
    high = maximum(maximum(dot(of_a[0], n), dot(of_a[1], n)), dot(of_a[2], n))
    return movemask(high + far < lowest(low))


@inline
def _lowest(corners, n):
    return minimum(minimum(dot(corners[0], n), dot(corners[1], n)), dot(corners[2], n))


@inline
def _near_along(one, first, last, reach, axis):
    """Where the box of a triangle and the boxes around eight at two poses come within `reach` along an axis."""
    low = minimum(walk.low(first, axis), walk.low(last, axis))
    high = maximum(walk.high(first, axis), walk.high(last, axis))
    return (low <= walk.high(one, axis) + reach) & (high >= walk.low(one, axis) - reach)


@inline
def _write_two(W, at, first, last):
    """Write a triangle at two poses as a block of eight points."""
    for axis in range(3):
        for lane in range(LEAF):
            corner = min(lane, 5)
            W[at + axis * LEAF + lane] = first[corner][axis] if corner < 3 else last[corner - 3][axis]


@inline
def _surface_and_piece(A, first, last, keep, far, stretch, travel, gjk, memory):
    """Part the triangles of a surface A from a convex piece; planes that were found are tried on other triangles."""
    shift, shift_last = shift_between(A, first), shift_between(A, last)
    size = max(lengths(A, first, shift), lengths(A, last, shift_last))
    tree, planes, R = surface_of(A), walk.planes_of(memory), rotation_of(A)
    box = box_in_frame(A, first, shift, far + travel, size)
    height, searches, n = walk.begun(memory), 0, walk.ORIGIN
    while True:
        kept = min(searches, walk.PLANES)
        child, height = walk.next_in_box(tree, box, kept, far, memory, height)
        if child >= 0:
            return True
        leaf = leaf_of(child)
        bits = walk.lanes_in(child, walk.gap_to_box(tree.blocks, leaf, box) <= 0.0)
        bits = walk.not_beyond_any(tree.blocks, leaf, planes, kept, far, bits)
        while bits != 0:
            lane, bits = next_lane(bits)
            piece = walk.triangle_piece(A, leaf * LEAF + lane, A.table[A.piece, ROUNDING], walk.first_of(memory))
            piece.layout[0, KIND] = SURFACE  # a polytope has no radius
            proven, n, _ = gjk_swept.separated(piece, first, last, walk.nonzero(n), keep, keep, stretch, gjk)
            if not proven or searches == MOST_SEARCHES:
                return False
            k = searches % walk.PLANES
            searches += 1
            walk.keep_plane(first, shift, R, n, size, planes, k)
            walk.lower_plane(last, shift_last, n, size, planes, k)
            bits &= walk.not_beyond(tree.blocks, leaf, planes, k, far)
