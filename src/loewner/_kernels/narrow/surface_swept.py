"""Are the triangles of a surface apart from a piece, or from another surface's triangles, between two poses?

Proofs of motions replace a surface by convex parts. Where the parts meet although the triangles do not, this walk
through the trees of triangles finds a plane for each triangle, or each pair of triangles, that comes near.
"""

from loewner._kernels._jit import apart, inline
from loewner._kernels.codes import APART
from loewner._kernels.columns import KIND, ROUNDING, SURFACE
from loewner._kernels.linalg3 import minus, plus
from loewner._kernels.narrow import gjk_swept
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error, swollen_radii
from loewner._kernels.narrow.surface_boxes import box_in_frame, is_surface, relation, surface_of
from loewner._kernels.pieces.pack import placed, shift_between
from loewner._kernels.pieces.shapes import radius, rotation_of
from loewner._kernels.simd.vectors import maximum, minimum, next_lane
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, leaf_of, size_of

# Searches for one interval, at most: more take longer than halving the interval.
MOST_SEARCHES = 256


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
    """Part the triangles of two surfaces; cores that come within `near` meet, and are to be proven `far` apart."""
    shift, shift_last = shift_between(A, first), shift_between(A, last)
    size = max(lengths(A, first, shift), lengths(A, last, shift_last))
    error = max(rounding_error(A, first, shift), rounding_error(A, last, shift_last))
    a, b, about = surface_of(A), surface_of(first), relation(A, first, shift, size, far + travel)
    W, result, places = walk.vertices_of(memory), walk.result_of(memory), walk.placed_of(memory)
    height, searches, n, beyond = walk.begun(memory), 0, walk.ORIGIN, far + 4.0 * walk.CORNER_ERROR * size
    while True:
        child_a, child_b, height = walk.next_meeting(about, a, b, memory, height)
        if child_a >= 0:
            return True
        leaf_b = leaf_of(child_b)
        b_first = walk.placed_corners(first, b.blocks, leaf_b, shift)
        b_last = walk.placed_corners(last, b.blocks, leaf_b, shift_last)
        walk.store_corners(places, 0, walk.placed_corners(A, a.blocks, leaf_of(child_a), walk.ORIGIN))
        walk.store_corners(places, BLOCK, b_first)
        walk.store_corners(places, 2 * BLOCK, b_last)
        for lane_a in range(size_of(child_a)):
            one = walk.corners_at(places, 0, lane_a)
            near_it = _near_along(one, b_first, b_last, beyond, 0) & _near_along(one, b_first, b_last, beyond, 1)
            bits = walk.lanes_in(child_b, near_it & _near_along(one, b_first, b_last, beyond, 2))
            while bits != 0:
                lane_b, bits = next_lane(bits)
                searches += 1
                begin, end = walk.corners_at(places, BLOCK, lane_b), walk.corners_at(places, 2 * BLOCK, lane_b)
                walk.write_triangle(W, 0, one)
                _write_two(W, 3 * LEAF, begin, end)
                n = walk.nonzero(minus(plus(plus(begin[0], begin[1]), begin[2]), plus(plus(one[0], one[1]), one[2])))
                status, _, _, n = walk.measured(A, first, shift, W, (LEAF, 2 * LEAF), n, error, near, far, result)
                if status != APART or searches == MOST_SEARCHES:
                    return False


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
