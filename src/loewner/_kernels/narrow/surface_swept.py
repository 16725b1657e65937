"""Decide whether a surface stays apart from another piece, or from the triangles of another surface, between two poses.

Proofs of motions replace a surface with convex parts. Parts may meet although the triangles do not. In this case, a
walk through the trees of triangles finds a plane for each near triangle, or for each pair of near triangles.
"""

import numpy as np

from loewner._kernels._jit import apart, inline
from loewner._kernels.codes import APART
from loewner._kernels.columns import KIND, ROUNDING, SURFACE
from loewner._kernels.linalg3 import apply_transposed, dot, minus, plus, scaled
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
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, WIDE, leaf_of, size_of

# Maximum numbers of searches and of steps of the walk for one interval; beyond these limits, it is faster to halve the
# interval. For short intervals, both limits are multiplied by a factor, because as many triangles may come near in each
# half of such an interval as in the whole interval.
MOST_SEARCHES, MOST_STEPS = 256, 4096

# An entry of the stack is the number of a box, shifted left by ENTRY bits, plus the number of a triangle in the box's
# leaf. If the entry represents the whole box, ALL replaces the number of the triangle.
ENTRY, ALL = 4, 15


@apart
def triangles_apart(A, first, last, keep, stretch, travel, times, steps, gjk, memory):
    """Return whether a surface and another piece are proven farther apart than `keep` between two poses of the latter.

    At both poses, a plane must part each triangle of the surface from the other piece, or from each of its triangles,
    as in `gjk_swept.separated`. The result is False if this takes too many searches.

    Parameters
    ----------
    A, first, last : Placed
        The surface, and the other piece at both poses.
    keep : float
        Distance to prove; at least 0.
    stretch : float
        Amount by which intermediate poses may stretch radii more than the two poses do.
    travel : float
        Upper bound on the distance between the first and the last place of any point.
    times : int
        Factor on the numbers of searches and steps that are allowed.
    steps : int
        Limit on the number of steps, including searches.
    gjk, memory : int
        Addresses of `gjk_fast.MEMORY` and `surface_walk.MEMORY`.

    Returns
    -------
    yes : bool
    taken : int
        Number of steps and searches.
    """
    # Borrow the arrays again: otherwise, this function would count references to the arrays of its arguments.
    A = placed(A, A.piece, A.poses, A.row)
    first, last = placed(first, first.piece, first.poses, first.row), placed(last, last.piece, last.poses, last.row)
    radii, far = radius(A) + radius(last), keep
    if radii > 0.0:
        far += max(swollen_radii(A, first), swollen_radii(A, last)) + radii * stretch
    if is_surface(first):
        return _two_surfaces(A, first, last, keep + radii, far, travel, times, steps, memory)
    walk.left_of(memory)[0] = steps
    proven = _surface_and_piece(A, first, last, keep, far, stretch, travel, times, gjk, memory)
    return proven, steps - walk.left_of(memory)[0]


@inline
def _two_surfaces(A, first, last, near, far, travel, times, most, memory):
    """Part the triangles of two surfaces: cores that come within `near` meet, and cores `far` apart are proven apart.

    A plane that parts two triangles usually parts nearby triangles, too. The last few planes are therefore tried on
    boxes and leaves.
    """
    shift, shift_last = shift_between(A, first), shift_between(A, last)
    size = max(lengths(A, first, shift), lengths(A, last, shift_last))
    error = max(rounding_error(A, first, shift), rounding_error(A, last, shift_last))
    a, b = surface_of(A), surface_of(first)
    relations = (
        relation(A, first, shift, size, far + travel), relation(A, first, shift, size, far),
        relation(A, last, shift_last, size, far),
    )  # fmt: skip
    W, result, places = walk.vertices_of(memory), walk.result_of(memory), walk.placed_of(memory)
    stack, planes, n = walk.stack_of(memory), walk.parting_of(memory), walk.ORIGIN
    height, searches, steps, beyond = 1, 0, 0, far + 4.0 * walk.CORNER_ERROR * size
    stack[0, 0], stack[0, 1], slack = ALL, ALL, far + boxes.ROUNDINGS * size
    while True:
        count, limit = min(searches, PLANES), min(times * MOST_STEPS, most - searches)
        child_a, child_b, left, lanes_b, height, steps = _next_pair(
            relations, a, b, planes, count, slack, stack, height, steps, limit
        )
        if child_a >= 0:
            return steps < limit, steps + searches
        leaf_b, is_swept = leaf_of(child_b), False
        of_a = walk.placed_corners(A, a.blocks, leaf_of(child_a), walk.ORIGIN)
        b_first = walk.placed_corners(first, b.blocks, leaf_b, shift)
        b_last = b_first
        walk.store_corners(places, 0, of_a)
        while left != 0:
            lane_a, left = next_lane(left)
            one = walk.corners_at(places, 0, lane_a)
            bits = movemask(_near(one, b_first, b_first, beyond + travel)) & lanes_b
            if bits == 0:
                continue
            if not is_swept:
                is_swept, b_last = True, walk.placed_corners(last, b.blocks, leaf_b, shift_last)
                walk.store_corners(places, BLOCK, b_first)
                walk.store_corners(places, 2 * BLOCK, b_last)
                out = 0
                for k in range(min(searches, PLANES)):
                    n = planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2]
                    out |= _beyond(of_a, b_first, b_last, n, beyond)
                left &= ~out
                if (out >> lane_a) & 1 != 0:
                    continue
            bits &= movemask(_near(one, b_first, b_last, beyond))
            while bits != 0:
                lane_b, bits = next_lane(bits)
                begin, end = walk.corners_at(places, BLOCK, lane_b), walk.corners_at(places, 2 * BLOCK, lane_b)
                walk.write_triangle(W, 0, one)
                _write_two(W, 3 * LEAF, begin, end)
                n = walk.nonzero(minus(plus(plus(begin[0], begin[1]), begin[2]), plus(plus(one[0], one[1]), one[2])))
                status, _, _, n = walk.measured(A, first, shift, W, (LEAF, 2 * LEAF), n, error, near, far, result)
                if status != APART or searches >= times * MOST_SEARCHES:
                    return False, steps + searches + 1
                _keep_parting(A, first, last, shift, shift_last, n, planes, searches % PLANES)
                searches += 1
                beyond_it = _beyond(of_a, b_first, b_last, n, beyond)
                left &= ~beyond_it
                if (beyond_it >> lane_a) & 1 != 0:
                    break


@inline
def _next_pair(relations, a, b, planes, count, slack, stack, height, steps, most):
    """Find the next two leaves that may be near; also return their triangles as bits, the height, and all steps so far.

    At the end of the walk, or after too many steps, zeros replace the leaves.

    Compare `surface_walk.next_meeting`. An entry of the stack is a box or one triangle of a leaf. Large triangles next
    to small ones are taken one by one, because a leaf of large triangles takes up much space.
    """
    while height > 0 and steps < most:
        height -= 1
        steps += 1
        one, other = stack[height, 0], stack[height, 1]
        if _parted(a, b, one, other, planes, count, slack):
            continue
        child_a, child_b = a.children[one >> ENTRY], b.children[other >> ENTRY]
        opens_a, opens_b = child_a >= 0, child_b >= 0
        if not (opens_a or opens_b):
            return child_a, child_b, _lanes(child_a, one), _lanes(child_b, other), height, steps
        middle_a, half_a = _box(a, one)
        middle_b, half_b = _box(b, other)
        a_is_larger = max(half_a[0], max(half_a[1], half_a[2])) >= max(half_b[0], max(half_b[1], half_b[2]))
        if a_is_larger and not opens_a and one & ALL == ALL:
            for lane in range(size_of(child_a)):
                stack[height, 0], stack[height, 1] = one - ALL + lane, other
                height += 1
        elif not (a_is_larger or opens_b) and other & ALL == ALL:
            for lane in range(size_of(child_b)):
                stack[height, 0], stack[height, 1] = one, other - ALL + lane
                height += 1
        elif opens_a and (a_is_larger or not opens_b):
            middles, halves = boxes.boxes_of(a.boxes, child_a)
            bits = _meeting(relations, middles, middle_b, halves, half_b)
            for k in range(count if bits != 0 else 0):
                bits &= ~_parted_from_b(b, other, planes, PLANE * k, slack, middles, halves)
            while bits != 0:
                lane, bits = next_lane(bits)
                stack[height, 0], stack[height, 1] = (child_a * WIDE + lane << ENTRY) + ALL, other
                height += 1
        else:
            middles, halves = boxes.boxes_of(b.boxes, child_b)
            bits = _meeting(relations, middle_a, middles, half_a, halves)
            for k in range(count if bits != 0 else 0):
                bits &= ~_parted_from_a(a, one, planes, PLANE * k, slack, middles, halves)
            while bits != 0:
                lane, bits = next_lane(bits)
                stack[height, 0], stack[height, 1] = one, (child_b * WIDE + lane << ENTRY) + ALL
                height += 1
    return 0, 0, 0, 0, 0, steps


@inline
def _lanes(child, entry):
    """Bits of the triangles of a leaf that an entry represents."""
    return (1 << size_of(child)) - 1 if entry & ALL == ALL else 1 << (entry & ALL)


@inline
def _triangle(tree, entry):
    return walk.corners_at(tree.blocks, leaf_of(tree.children[entry >> ENTRY]) * BLOCK, entry & ALL)


@inline
def _box(tree, entry):
    """Middle and half widths of the box of an entry, in single precision."""
    if entry & ALL == ALL:
        return boxes.box_at(tree.boxes, entry >> ENTRY)
    p, q, r = _triangle(tree, entry)
    low = min(p[0], min(q[0], r[0])), min(p[1], min(q[1], r[1])), min(p[2], min(q[2], r[2]))
    high = max(p[0], max(q[0], r[0])), max(p[1], max(q[1], r[1])), max(p[2], max(q[2], r[2]))
    return boxes.singles(scaled(0.5, plus(low, high))), boxes.singles(scaled(0.5, minus(high, low)))


@inline
def _meeting(relations, middle_a, middle_b, half_a, half_b):
    """Bits of the boxes that are near at the first pose, and near on the way from there to the last pose."""
    near, first, last = relations
    bits = boxes.meeting_between(first, last, middle_a, middle_b, half_a, half_b)
    if bits != 0:
        bits &= boxes.meeting(near, boxes.between(near, middle_a, middle_b), half_a, half_b)
    return bits


@inline
def _parted_from_b(b, other, planes, at, slack, middles, halves):
    """Bits of the boxes of a node of A's tree that a plane parts from an entry of B's tree at both poses."""
    low = planes[at + 12] - _reach(b, other, planes, at + 6, -1.0)
    low = min(low, planes[at + 13] - _reach(b, other, planes, at + 9, -1.0)) - slack
    return movemask(boxes.farthest(middles, halves, planes, at + 3, 1.0) < np.float32(low))


@inline
def _parted_from_a(a, one, planes, at, slack, middles, halves):
    """Bits of the boxes of a node of B's tree that a plane parts from an entry of A's tree at both poses."""
    high = _reach(a, one, planes, at + 3, 1.0) + slack
    return movemask(
        (boxes.farthest(middles, halves, planes, at + 6, -1.0) < np.float32(planes[at + 12] - high))
        & (boxes.farthest(middles, halves, planes, at + 9, -1.0) < np.float32(planes[at + 13] - high))
    )


@inline
def _parted(a, b, one, other, planes, count, slack):
    """Return whether one of the planes parts two entries, the second of them at both poses."""
    for k in range(count):
        at = PLANE * k
        above = _reach(a, one, planes, at + 3, 1.0) + slack
        low = planes[at + 12] - _reach(b, other, planes, at + 6, -1.0)
        if above < low and above < planes[at + 13] - _reach(b, other, planes, at + 9, -1.0):
            return True
    return False


@inline
def _reach(tree, entry, planes, at, sign):
    """Extent of an entry along a plane's normal; with sign -1, in the opposite direction."""
    if entry & ALL == ALL:
        middle, half = boxes.box_at(tree.boxes, entry >> ENTRY)
        return sign * _along(planes, at, middle) + _across(planes, at, half)
    p, q, r = _triangle(tree, entry)
    return max(
        sign * _along(planes, at, p), max(sign * _along(planes, at, q), sign * _along(planes, at, r))
    )  # fmt: skip


@inline
def _along(planes, at, v):
    return planes[at] * v[0] + planes[at + 1] * v[1] + planes[at + 2] * v[2]


@inline
def _across(planes, at, v):
    return abs(planes[at]) * v[0] + abs(planes[at + 1]) * v[1] + abs(planes[at + 2]) * v[2]


@inline
def _keep_parting(A, first, last, shift, shift_last, n, planes, k):
    """Store a unit normal from A to the other surface, in the frames of both, and the offsets of the other surface."""
    at = PLANE * k
    of_a, of_b = apply_transposed(rotation_of(A), n), apply_transposed(rotation_of(first), n)
    of_last = apply_transposed(rotation_of(last), n)
    for axis in range(3):
        planes[at + axis], planes[at + 3 + axis] = n[axis], of_a[axis]
        planes[at + 6 + axis], planes[at + 9 + axis] = of_b[axis], of_last[axis]
    planes[at + 12], planes[at + 13] = dot(n, shift), dot(n, shift_last)


@inline
def _beyond(of_a, first, last, n, far):
    """Bits of the triangles of a leaf of A that a plane parts from all triangles of another leaf at both poses."""
    low = minimum(_lowest(first, n), _lowest(last, n))
    high = maximum(maximum(dot(of_a[0], n), dot(of_a[1], n)), dot(of_a[2], n))
    return movemask(high + far < lowest(low))


@inline
def _lowest(corners, n):
    return minimum(minimum(dot(corners[0], n), dot(corners[1], n)), dot(corners[2], n))


@inline
def _near(one, first, last, reach):
    """Lanes in which a triangle's box comes within `reach` of the box around one of eight triangles at two poses."""
    return (
        _near_along(one, first, last, reach, 0)
        & _near_along(one, first, last, reach, 1)
        & _near_along(one, first, last, reach, 2)
    )


@inline
def _near_along(one, first, last, reach, axis):
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
def _surface_and_piece(A, first, last, keep, far, stretch, travel, times, gjk, memory):
    """Part the triangles of a surface A from a convex piece; each plane that is found is tried on other triangles."""
    shift, shift_last = shift_between(A, first), shift_between(A, last)
    size = max(lengths(A, first, shift), lengths(A, last, shift_last))
    tree, planes, R = surface_of(A), walk.planes_of(memory), rotation_of(A)
    box = box_in_frame(A, first, shift, far + travel, size)
    height, searches, n, left = walk.resumed(memory), 0, walk.ORIGIN, walk.left_of(memory)
    while True:
        kept = min(searches, walk.PLANES)
        child, height = walk.next_in_box(tree, box, kept, far, memory, height)
        if child >= 0:
            return height == 0
        leaf = leaf_of(child)
        bits = walk.lanes_in(child, walk.gap_to_box(tree.blocks, leaf, box) <= 0.0)
        bits = walk.not_beyond_any(tree.blocks, leaf, planes, kept, far, bits)
        while bits != 0:
            left[0] -= 1
            lane, bits = next_lane(bits)
            piece = walk.triangle_piece(A, leaf * LEAF + lane, A.table[A.piece, ROUNDING], walk.first_of(memory))
            piece.layout[0, KIND] = SURFACE  # The piece must count as a surface, because a polytope has no radius.
            proven, n, _ = gjk_swept.separated(piece, first, last, walk.nonzero(n), keep, keep, stretch, gjk)
            if not proven or searches >= times * MOST_SEARCHES:
                return False
            k = searches % walk.PLANES
            searches += 1
            walk.keep_plane(first, shift, R, n, size, planes, k)
            walk.lower_plane(last, shift_last, n, size, planes, k)
            bits &= walk.not_beyond(tree.blocks, leaf, planes, k, far)
