"""Decide whether a surface and another piece meet: walk through two trees of triangles, or through one tree.

Boxes settle most pairs in single precision. Signs of determinants settle triangles eight at a time (`triangles`), and
GJK settles the rest. Signs that rounding could change are never guessed: such pairs are *open*, and
`loewner.queries._exact` settles them in integers. Where no triangles meet, `surface_points` decides whether one body
lies within the other.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline
from loewner._kernels.codes import AMBIGUOUS, APART, COLLIDING, FREE, NO_LIMIT, OVERLAPPING, TOUCHING, UNSETTLED
from loewner._kernels.linalg3 import apply, cross, minus, plus
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.gjk_fast import place_piece
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error
from loewner._kernels.narrow.surface_boxes import box_in_frame, is_surface, oval_in_frame, relation, surface_of
from loewner._kernels.narrow.surface_points import OUTSIDE, WITHIN, within_either
from loewner._kernels.narrow.triangles import doubt, length1, longest_edge, meet, same_side, sides, squared_distances
from loewner._kernels.pieces.pack import placed, shift_between
from loewner._kernels.pieces.shapes import rotation_of
from loewner._kernels.simd.memory import integers_at
from loewner._kernels.simd.vectors import movemask, next_lane
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, leaf_of, size_of

MEETING = -1  # Number that is returned for two pieces that collide, in place of the number of open pairs.


class Asked(NamedTuple):
    """Arguments of `surface_pair` other than the pieces: distances, memory, and room for open pairs."""

    near: Any
    far: Any
    memory: Any
    listed_at: Any
    room: Any


@inline
def surface_pair(A, B, near, far, memory, listed_at, room, steps=NO_LIMIT):
    """Settle two pieces, at least one of them a surface.

    Parameters
    ----------
    A, B : Placed
    near, far : float
        Cores that come within `near` collide; cores farther apart than `far` are free. Both distances are the margin
        plus the rounding radii, which for `far` are stretched like the poses.
    memory : int
        Address of `surface_walk.MEMORY`.
    listed_at, room : int
        Address of an array of integers, and the number of open pairs for which it has room. Each open pair takes two
        integers. For two surfaces, they are the triangles, by block and lane; for a surface and a convex piece, they
        are the triangle and -1.
    steps : int
        Limit on the number of boxes, triangles and points to examine; beyond it, the verdict is AMBIGUOUS. The number
        of steps left can be read from the memory.

    Returns
    -------
    verdict : int
        AMBIGUOUS if pairs are open, or if it is not known whether a part lies within a solid.
    open_pairs : int
    """
    # For Numba, addresses of NumPy arrays have another integer type. Without the conversion to int64, all functions
    # that receive the addresses would be compiled again for this type.
    query = Asked(near, far, np.int64(memory), np.int64(listed_at), room)
    walk.left_of(query.memory)[0] = steps
    return _settled(A, B, query) if is_surface(A) else _settled(B, A, query)


# If a function that receives both pieces is not inlined, the records of the pieces are copied through memory (76
# words), and the function counts references to arrays again. Therefore, `_settled` is the only such function that every
# pair needs, and it begins by borrowing the arrays.
@apart
def _settled(A, B, asked):
    """Settle two pieces as `surface_pair` does, where A is a surface."""
    A, B = placed(A, A.piece, A.poses, A.row), placed(B, B.piece, B.poses, B.row)
    shift = shift_between(A, B)
    size = lengths(A, B, shift)
    open_pairs = _two_surfaces(A, B, shift, size, asked) if is_surface(B) else _with_piece(A, B, shift, size, asked)
    if open_pairs == MEETING:
        return COLLIDING, 0
    within = within_either(A, B, shift, size, asked.memory)
    if within == WITHIN:
        return COLLIDING, open_pairs
    return FREE if within == OUTSIDE and open_pairs == 0 else AMBIGUOUS, open_pairs


@inline
def _list(asked, open_pairs, first, second):
    """List an open pair if there is room; return the number of open pairs so far."""
    if open_pairs < asked.room:
        listed = integers_at(asked.listed_at, (asked.room, 2))
        listed[open_pairs, 0], listed[open_pairs, 1] = first, second
    return open_pairs + 1


@inline
def _two_surfaces(A, B, shift, size, asked):
    """Settle the triangles of two surfaces; return MEETING or the number of open pairs."""
    a, b = surface_of(A), surface_of(B)
    about = relation(A, B, shift, size, asked.far)
    height, open_pairs = walk.resumed(asked.memory), 0
    while open_pairs != MEETING:
        child_a, child_b, height = walk.next_meeting(about, a, b, asked.memory, height)
        if child_a >= 0:
            return open_pairs + (height > 0)
        open_pairs = _leaves(A, B, child_a, child_b, shift, size, asked, open_pairs)
    return open_pairs


@inline
def _boxes_touch(a, b, reach):
    """Mask of lanes in which the box of a triangle comes within `reach` of one of eight boxes along all axes."""
    return _touch_along(a, b, reach, 0) & _touch_along(a, b, reach, 1) & _touch_along(a, b, reach, 2)


@inline
def _touch_along(a, b, reach, axis):
    return (walk.low(b, axis) <= walk.high(a, axis) + reach) & (walk.high(b, axis) >= walk.low(a, axis) - reach)


@inline
def _leaves(A, B, child_a, child_b, shift, size, asked, open_pairs):
    """Settle the triangles of two leaves; return MEETING or the number of open pairs so far."""
    leaf_a, leaf_b = leaf_of(child_a), leaf_of(child_b)
    near, far, error = asked.near, asked.far, walk.CORNER_ERROR * size
    placed = walk.placed_of(asked.memory)
    walk.store_corners(placed, 0, walk.placed_corners(A, surface_of(A).blocks, leaf_a, walk.ORIGIN))
    b = walk.placed_corners(B, surface_of(B).blocks, leaf_b, shift)
    walk.store_corners(placed, BLOCK, b)
    long_b = longest_edge(b[0], b[1], b[2])
    for lane_a in range(size_of(child_a)):
        a = walk.corners_at(placed, 0, lane_a)
        bits = walk.lanes_in(child_b, _boxes_touch(a, b, far + 4.0 * error))
        if bits == 0:
            continue
        long_a = longest_edge(a[0], a[1], a[2])
        between_corners = length1(minus(b[0], a[0])) + long_a + long_b
        side_a = doubt(long_a, long_a, between_corners, error)
        on_a = sides(cross(minus(a[1], a[0]), minus(a[2], a[1])), a[0], b)
        beside = movemask(same_side(on_a[0], on_a[1], on_a[2], side_a))
        if far == 0.0:
            bits &= ~beside
        else:
            # Pairs are left to the search unless their distance is below `near` or above `far` by more than eight
            # corner errors.
            squared = squared_distances(a, b)
            within = max(near - 8.0 * error, 0.0)
            beyond = far + 8.0 * error
            if movemask(squared < within * within) & bits != 0:
                return MEETING
            apart_bits = movemask(squared > beyond * beyond)
            bits &= ~(apart_bits & beside)
            if bits == 0:
                continue
            open_pairs = _search(A, B, leaf_a, lane_a, leaf_b, bits & ~apart_bits, shift, asked, open_pairs)
            if open_pairs == MEETING:
                return MEETING
            bits &= apart_bits  # These triangles are apart unless they pierce each other.
        if bits == 0:
            continue
        meets, misses = meet(a, b, on_a, side_a, error, long_a, long_b, between_corners)
        if movemask(meets) & bits != 0:
            return MEETING
        bits &= ~movemask(misses)
        open_pairs = _search(A, B, leaf_a, lane_a, leaf_b, bits, shift, asked, open_pairs)
        if open_pairs == MEETING:
            return MEETING
    return open_pairs


@inline
def _search(A, B, leaf_a, lane_a, leaf_b, bits, shift, asked, open_pairs):
    """Settle a triangle with the selected triangles of a leaf; return MEETING or the number of open pairs so far."""
    near, far, memory = asked.near, asked.far, asked.memory
    placed, W, result = walk.placed_of(memory), walk.vertices_of(memory), walk.result_of(memory)
    error, left = rounding_error(A, B, shift), walk.left_of(memory)
    while bits != 0:
        left[0] -= 1
        lane_b, bits = next_lane(bits)
        a, b = walk.corners_at(placed, 0, lane_a), walk.corners_at(placed, BLOCK, lane_b)
        walk.write_triangle(W, 0, a)
        walk.write_triangle(W, 3 * LEAF, b)
        n = walk.nonzero(minus(plus(plus(b[0], b[1]), b[2]), plus(plus(a[0], a[1]), a[2])))
        if far == 0.0:
            status, _, _ = walk.decided(A, B, shift, W, (LEAF, 2 * LEAF), n, error)
        else:
            status, _, _, _ = walk.measured(A, B, shift, W, (LEAF, 2 * LEAF), n, error, near - error, far, result)
        # The search finds contact only up to rounding errors, so these must be less than the distance that counts as
        # contact.
        if status in (TOUCHING, OVERLAPPING) and near > error:
            return MEETING
        if status != APART:
            open_pairs = _list(asked, open_pairs, leaf_a * LEAF + lane_a, leaf_b * LEAF + lane_b)
    return open_pairs


@inline
def _with_piece(A, B, shift, size, asked):
    """Settle the triangles of a surface A and a convex piece B; return MEETING or the number of open pairs.

    The walk starts with the box around B's outer ellipsoid. The box around B itself takes six searches, and is computed
    only when triangles come near. If GJK separates a triangle from B, its plane usually separates nearby triangles,
    too. The last few planes are therefore kept, and triangles beyond one of them are skipped.
    """
    near, far, memory = asked.near, asked.far, asked.memory
    a, R, error = surface_of(A), rotation_of(A), rounding_error(A, B, shift)
    W, result = walk.vertices_of(memory), walk.result_of(memory)
    placed, planes = walk.placed_of(memory), walk.planes_of(memory)
    box, ends = oval_in_frame(A, B, shift, far, size), (LEAF, LEAF)
    center, closer = walk.ORIGIN, False
    height, open_pairs, plane_count, left = walk.resumed(memory), 0, 0, walk.left_of(memory)
    while True:
        kept = min(plane_count, walk.PLANES)
        child, height = walk.next_in_box(a, box, kept, far, memory, height)
        if child >= 0:
            return open_pairs + (height > 0)
        leaf = leaf_of(child)
        bits = walk.lanes_in(child, walk.gap_to_box(a.blocks, leaf, box) <= 0.0)
        if bits != 0 and not closer:
            closer = True
            ends = LEAF, place_piece(B, shift, W, LEAF)
            box = box_in_frame(A, B, shift, far, size)
            center = apply(R, box.middle)
            bits &= movemask(walk.gap_to_box(a.blocks, leaf, box) <= 0.0)
        bits = walk.not_beyond_any(a.blocks, leaf, planes, kept, far, bits)
        if bits == 0:
            continue
        walk.store_corners(placed, BLOCK, walk.placed_corners(A, a.blocks, leaf, walk.ORIGIN))
        while bits != 0:
            left[0] -= 1
            lane, bits = next_lane(bits)
            corners = walk.corners_at(placed, BLOCK, lane)
            walk.write_triangle(W, 0, corners)
            n = walk.nonzero(minus(center, corners[0]))
            status = UNSETTLED
            if far == 0.0:
                status, n, _ = walk.decided(A, B, shift, W, ends, n, error)
            if status == UNSETTLED:
                status, _, _, n = walk.measured(A, B, shift, W, ends, n, error, near, far, result)
            if status in (TOUCHING, OVERLAPPING):
                return MEETING
            if status != APART:
                open_pairs = _list(asked, open_pairs, leaf * LEAF + lane, -1)
                continue
            k = plane_count % walk.PLANES
            plane_count += 1
            walk.keep_plane(B, shift, R, n, size, planes, k)
            bits &= walk.not_beyond(a.blocks, leaf, planes, k, far)
