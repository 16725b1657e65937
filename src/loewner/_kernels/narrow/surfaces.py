"""Exact answers for surfaces: the walk through two trees of triangles, or through one for a convex piece.

Boxes settle most of it in single precision. Triangles are settled eight at a time by signs of determinants
(`triangles`), and what these leave by GJK. Signs that rounding could turn are never guessed: such pairs are *open*, and
`loewner._exact` settles them in whole numbers.

A solid also holds what lies within it. Where nothing meets its surface, one point of each connected part of the other
body tells: by the winding number, which counts how often the surface is met on a ray from there.
"""

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import AMBIGUOUS, APART, COLLIDING, FREE, OVERLAPPING, TOUCHING, UNCOUNTED, UNSETTLED
from loewner._kernels.columns import OUTER_CENTER, OUTER_SHAPE
from loewner._kernels.ellipsoids.contact import outward_width
from loewner._kernels.linalg3 import apply, apply_transposed, cross, dot, image, minus, negated, plus
from loewner._kernels.narrow.gjk_fast import ENTRIES as GJK_ENTRIES
from loewner._kernels.narrow.gjk_fast import decide, measure_along, place_piece
from loewner._kernels.narrow.gjk_robust import lengths, off_orthonormal, rounding_error
from loewner._kernels.narrow.surface_boxes import (
    ROUNDINGS,
    box_at,
    is_solid,
    is_surface,
    near_box,
    push_meeting,
    relation,
    surface_of,
    within_planes,
)
from loewner._kernels.narrow.triangles import doubt, length1, longest_edge, meet, same_side, sides, squared_distances
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import placed_support, rotation_of
from loewner._kernels.simd.memory import floats_at, integers_at
from loewner._kernels.simd.vectors import absolute, load, load_single, lowest_bit, maximum, minimum, movemask, store
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, LEVELS, ROWS, WIDE, leaf_of, size_of

# What a coordinate of a placed corner may be off by, in roundoffs of the lengths that it is made of.
CORNER_ERROR = 16.0 * UNIT_ROUNDOFF  # derived 5, certified.md B36
# derived 16, certified.md B42

# Memory: the stack of the walk (two entries a level, of both trees), triangles placed, and what GJK writes to.
STACK = 2 * 2 * LEVELS * WIDE
PLACED = 8 * STACK
GJK = PLACED + 8 * 2 * BLOCK
RESULT = GJK + 8 * GJK_ENTRIES
# Planes that separate a convex piece from triangles met on the way: the last few, each a normal and an offset.
PLANES, PLANE = 4, 4
SEPARATING = RESULT + 8 * 16
SIZE = SEPARATING + 8 * PLANES * PLANE  # bytes

# How a walk ended besides: open pairs, or a point that may lie on either side of a surface.
MEETING = -1
OUTSIDE, WITHIN, UNKNOWN = 0, 1, 2

# How much rays lean towards the two other axes: meshes have many edges that a ray along an axis would meet. Six rays
# change it by tenths, and both stay positive.
LEAN_I, LEAN_J = 0.07391, 0.61803


@apart
def surface_pair(A, B, near, far, memory, listed_at, room):
    """Settle two pieces, one at least a surface.

    Parameters
    ----------
    A, B : Placed
    near, far : float
        Cores that come this near collide, cores farther apart are free: the margin and the rounding radii, as they are
        and as the poses stretch them.
    memory : int
        Address of SIZE bytes to write to.
    listed_at, room : int
        Address of integers, two for each open pair that there is room to list: of two surfaces, the triangles, by
        block and lane; of a surface and a convex piece, the triangle and -1.

    Returns
    -------
    verdict : int
        AMBIGUOUS if pairs are open, or if it is open what lies within a solid.
    open_pairs : int
    """
    if not is_surface(A):
        return _with_piece(B, A, near, far, memory, listed_at, room)
    if not is_surface(B):
        return _with_piece(A, B, near, far, memory, listed_at, room)
    return _two_surfaces(A, B, near, far, memory, listed_at, room)


# The two searches, which are long, once for all that calls them here.
@apart
def decided(A, B, shift, W, ends, n, error):
    """`gjk_fast.decide`."""
    return decide(A, B, shift, W, ends, n, error)


@apart
def measured_along(A, B, shift, W, ends, n, error, near, far, result):
    """`gjk_fast.measure_along`."""
    return measure_along(A, B, shift, W, ends, n, error, near, far, result)


@inline
def measured(A, B, shift, W, ends, n, error, near, far, result):
    """The same without the last direction."""
    status, lower, upper, _ = measured_along(A, B, shift, W, ends, n, error, near, far, result)
    return status, lower, upper


@njit()
def _two_surfaces(A, B, near, far, memory, listed_at, room):
    """Walk through two trees, the larger box first."""
    a, b = surface_of(A), surface_of(B)
    shift = shift_between(A, B)
    size = lengths(A, B, shift)
    about = relation(A, B, shift, size, far)
    stack = integers_at(memory, (STACK,))
    stack[0], stack[1] = 0, 0
    height = 2
    open_pairs = 0
    while height > 0:
        height -= 2
        slot_a, slot_b = stack[height], stack[height + 1]
        child_a, child_b = a.children[slot_a], b.children[slot_b]
        if child_a < 0 and child_b < 0:
            found = _leaves(A, B, child_a, child_b, shift, size, near, far, memory, listed_at, room, open_pairs)
            if found == MEETING:
                return COLLIDING, open_pairs
            open_pairs = found
            continue
        height = push_meeting(about, a, b, slot_a, slot_b, stack, height)
    within = OUTSIDE
    if is_solid(A):
        within = parts_within(A, B, shift, size, memory)
    if is_solid(B) and within != WITHIN:
        other = parts_within(B, A, (-shift[0], -shift[1], -shift[2]), size, memory)
        within = max(within, other) if other != WITHIN else WITHIN
    if within == WITHIN:
        return COLLIDING, open_pairs
    return FREE if within == OUTSIDE and open_pairs == 0 else AMBIGUOUS, open_pairs


@inline
def placed_corners(P, blocks, leaf, shift):
    """Corners of the eight triangles of a leaf in the world's axes."""
    R = rotation_of(P)
    at = leaf * BLOCK
    return (
        image(R, shift, (load(blocks, at), load(blocks, at + LEAF), load(blocks, at + 2 * LEAF))),
        image(R, shift, (load(blocks, at + 3 * LEAF), load(blocks, at + 4 * LEAF), load(blocks, at + 5 * LEAF))),
        image(R, shift, (load(blocks, at + 6 * LEAF), load(blocks, at + 7 * LEAF), load(blocks, at + 8 * LEAF))),
    )


@inline
def store_corners(placed, at, corners):
    for k in range(3):
        store(placed, at + 3 * k * LEAF, corners[k][0])
        store(placed, at + (3 * k + 1) * LEAF, corners[k][1])
        store(placed, at + (3 * k + 2) * LEAF, corners[k][2])


@inline
def corners_at(placed, at, lane):
    """Corners of one triangle of those stored."""
    i = at + lane
    return (
        (placed[i], placed[i + LEAF], placed[i + 2 * LEAF]),
        (placed[i + 3 * LEAF], placed[i + 4 * LEAF], placed[i + 5 * LEAF]),
        (placed[i + 6 * LEAF], placed[i + 7 * LEAF], placed[i + 8 * LEAF]),
    )


@inline
def least(x, y, z):
    return minimum(minimum(x, y), z)


@inline
def most(x, y, z):
    return maximum(maximum(x, y), z)


@inline
def _boxes_touch(a, b, reach):
    """Where the boxes of a triangle and of eight come within `reach` of each other along all axes."""
    return (
        (least(b[0][0], b[1][0], b[2][0]) <= most(a[0][0], a[1][0], a[2][0]) + reach)
        & (most(b[0][0], b[1][0], b[2][0]) >= least(a[0][0], a[1][0], a[2][0]) - reach)
        & (least(b[0][1], b[1][1], b[2][1]) <= most(a[0][1], a[1][1], a[2][1]) + reach)
        & (most(b[0][1], b[1][1], b[2][1]) >= least(a[0][1], a[1][1], a[2][1]) - reach)
        & (least(b[0][2], b[1][2], b[2][2]) <= most(a[0][2], a[1][2], a[2][2]) + reach)
        & (most(b[0][2], b[1][2], b[2][2]) >= least(a[0][2], a[1][2], a[2][2]) - reach)
    )


@njit()
def _leaves(A, B, child_a, child_b, shift, size, near, far, memory, listed_at, room, open_pairs):
    """Settle the triangles of two leaves; MEETING, or how many pairs are open by now."""
    leaf_a, leaf_b = leaf_of(child_a), leaf_of(child_b)
    error = CORNER_ERROR * size
    placed = floats_at(memory + PLACED, (2 * BLOCK,))
    store_corners(placed, 0, placed_corners(A, surface_of(A).blocks, leaf_a, (0.0, 0.0, 0.0)))
    b = placed_corners(B, surface_of(B).blocks, leaf_b, shift)
    store_corners(placed, BLOCK, b)
    long_b = longest_edge(b[0], b[1], b[2])
    all_b = (1 << size_of(child_b)) - 1
    for lane_a in range(size_of(child_a)):
        a = corners_at(placed, 0, lane_a)
        bits = movemask(_boxes_touch(a, b, far + 4.0 * error)) & all_b
        if bits == 0:
            continue
        long_a = longest_edge(a[0], a[1], a[2])
        between_corners = length1(minus(b[0], a[0])) + long_a + long_b
        side_a = doubt(long_a, long_a, between_corners, error)
        on_a = sides(cross(minus(a[1], a[0]), minus(a[2], a[1])), a[0], b)
        beside = movemask(same_side(on_a[0], on_a[1], on_a[2], side_a))
        if far == 0.0:
            bits &= ~beside
            if bits == 0:
                continue
        else:
            # What rounds more than the corners themselves are off by is left to the search.
            squared = squared_distances(a, b)
            within = max(near - 8.0 * error, 0.0)
            beyond = far + 8.0 * error
            if movemask(squared < within * within) & bits != 0:
                return MEETING
            apart_bits = movemask(squared > beyond * beyond)
            bits &= ~(apart_bits & beside)
            if bits == 0:
                continue
            left = bits & ~apart_bits
            bits &= apart_bits  # apart, unless they pierce each other
            open_pairs = _search(
                A, B, leaf_a, lane_a, leaf_b, left, shift, near, far, memory, listed_at, room, open_pairs
            )
            if open_pairs == MEETING:
                return MEETING
            if bits == 0:
                continue
        meets, misses = meet(a, b, on_a, side_a, error, long_a, long_b, between_corners)
        if movemask(meets) & bits != 0:
            return MEETING
        bits &= ~movemask(misses)
        open_pairs = _search(A, B, leaf_a, lane_a, leaf_b, bits, shift, near, far, memory, listed_at, room, open_pairs)
        if open_pairs == MEETING:
            return MEETING
    return open_pairs


@njit()
def _search(A, B, leaf_a, lane_a, leaf_b, bits, shift, near, far, memory, listed_at, room, open_pairs):
    """Settle a triangle and some of eight one by one; MEETING, or how many pairs are open by now."""
    placed, W = floats_at(memory + PLACED, (2 * BLOCK,)), floats_at(memory + GJK, (GJK_ENTRIES,))
    result, listed = floats_at(memory + RESULT, (9,)), integers_at(listed_at, (2 * room,))
    error = rounding_error(A, B, shift)
    while bits != 0:
        lane_b = lowest_bit(bits)
        bits &= bits - 1
        a, b = corners_at(placed, 0, lane_a), corners_at(placed, BLOCK, lane_b)
        write_triangle(W, 0, a)
        write_triangle(W, 3 * LEAF, b)
        n = minus(plus(plus(b[0], b[1]), b[2]), plus(plus(a[0], a[1]), a[2]))
        if not dot(n, n) > 0.0:
            n = (1.0, 0.0, 0.0)
        if far == 0.0:
            status, _, _ = decided(A, B, shift, W, (LEAF, 2 * LEAF), n, error)
        else:
            status, _, _ = measured(A, B, shift, W, (LEAF, 2 * LEAF), n, error, near - error, far, result)
        # What the search finds in contact is so but for rounding: that has to be less than the distance allowed.
        if status in (TOUCHING, OVERLAPPING) and near > error:
            return MEETING
        if status != APART:
            if open_pairs < room:
                listed[2 * open_pairs] = leaf_a * LEAF + lane_a
                listed[2 * open_pairs + 1] = leaf_b * LEAF + lane_b
            open_pairs += 1
    return open_pairs


@inline
def write_triangle(W, at, corners):
    """Write a triangle as a block of eight points, see `simd.support`."""
    for axis in range(3):
        W[at + axis * LEAF], W[at + axis * LEAF + 1] = corners[0][axis], corners[1][axis]
        for lane in range(2, LEAF):
            W[at + axis * LEAF + lane] = corners[2][axis]


# -- what lies within a solid -----------------------------------------------------------------------


@njit()
def parts_within(A, B, shift, size, memory):
    """Whether a part of B lies within the solid A, as far as one point of each connected part tells."""
    if not is_surface(B):
        return point_within(A, plus(placed_support(B, (1.0, 0.0, 0.0)), shift), size, memory)
    parts = surface_of(B).parts
    found = OUTSIDE
    R = rotation_of(B)
    for at in range(0, len(parts), 3):
        within = point_within(A, image(R, shift, (parts[at], parts[at + 1], parts[at + 2])), size, memory)
        if within == WITHIN:
            return WITHIN
        found = max(found, within)
    return found


@njit()
def point_within(A, x, size, memory):
    """Whether a point, in the world's axes from the translation of A, lies within the solid A.

    A ray near an axis of A's frame is followed; where it comes too close to an edge or starts too close to a triangle,
    another one.
    """
    a = surface_of(A)
    R = rotation_of(A)
    # By the inverse, not the transpose: a pose need be rigid to 1e-6 only.
    u, v, w = (R[0], R[3], R[6]), (R[1], R[4], R[7]), (R[2], R[5], R[8])
    volume = dot(cross(u, v), w)
    q = dot(cross(v, w), x) / volume, dot(cross(w, u), x) / volume, dot(cross(u, v), x) / volume
    number = winding_number(a, q, size, memory)
    return UNKNOWN if number == UNCOUNTED else WITHIN if number != 0 else OUTSIDE


@njit()
def winding_number(a, q, size, memory):
    """How often a surface goes around a point of its frame; UNCOUNTED if no ray tells.

    `size` is a sum of lengths that bounds coordinates; the point may be off by CORNER_ERROR of it.
    """
    slack = ROUNDINGS * size
    middle, half = box_at(a.boxes, 0)
    nearest, first = np.inf, 0
    for axis in range(3):
        gap = float(half[axis]) - abs(q[axis] - float(middle[axis]))
        if gap < -slack:
            return 0
        if gap < nearest:
            nearest, first = gap, 2 * axis + (q[axis] < float(middle[axis]))
    for turn in range(6):
        way = (first + turn) % 6
        axis, lean = way >> 1, (LEAN_I + 0.1 * turn, LEAN_J - 0.1 * turn)
        if axis == 0:
            found = _windings(a, (q[1], q[2], q[0]), 1, 2, 0, way & 1, lean, size, memory)
        elif axis == 1:
            found = _windings(a, (q[2], q[0], q[1]), 2, 0, 1, way & 1, lean, size, memory)
        else:
            found = _windings(a, (q[0], q[1], q[2]), 0, 1, 2, way & 1, lean, size, memory)
        if found != UNCOUNTED:
            return found
    return UNCOUNTED


@njit()
def _windings(a, q, i, j, k, backward, lean, size, memory):
    """How often a ray from a point, given by its coordinates i, j and k, along axis k or against it, meets a surface.

    It leans towards axes i and j by so much: the coordinates along these, less that share of the third, stay the same.
    """
    lean_i, lean_j = lean
    single_i, single_j = np.float32(lean_i), np.float32(lean_j)
    stack = integers_at(memory, (STACK,))
    slack = np.float32(ROUNDINGS * size)
    sign = -1.0 if backward == 1 else 1.0
    x, y, z, along = np.float32(q[0]), np.float32(q[1]), np.float32(q[2]), np.float32(sign)
    error = CORNER_ERROR * size
    stack[0] = 0
    height, windings = 1, 0
    while height > 0:
        height -= 1
        child = a.children[stack[height]]
        if child >= 0:
            at = child * ROWS
            far, deep = load_single(a.boxes, at + k * WIDE) - z, load_single(a.boxes, at + (3 + k) * WIDE)
            aside_i = load_single(a.boxes, at + i * WIDE) - x - far * single_i
            aside_j = load_single(a.boxes, at + j * WIDE) - y - far * single_j
            bits = movemask(
                (absolute(aside_i) <= load_single(a.boxes, at + (3 + i) * WIDE) + (deep * single_i + slack))
                & (absolute(aside_j) <= load_single(a.boxes, at + (3 + j) * WIDE) + (deep * single_j + slack))
                & (far * along + deep >= -slack)
            )
            while bits != 0:
                stack[height] = child * WIDE + lowest_bit(bits)
                height += 1
                bits &= bits - 1
            continue
        at = leaf_of(child) * BLOCK
        u0, u1, u2 = _coordinates(a.blocks, at, i, q[0])
        v0, v1, v2 = _coordinates(a.blocks, at, j, q[1])
        w0, w1, w2 = _coordinates(a.blocks, at, k, q[2])
        ahead = most(absolute(w0), absolute(w1), absolute(w2))
        u0, u1, u2 = u0 - w0 * lean_i, u1 - w1 * lean_i, u2 - w2 * lean_i
        v0, v1, v2 = v0 - w0 * lean_j, v1 - w1 * lean_j, v2 - w2 * lean_j
        w0, w1, w2 = w0 * sign, w1 * sign, w2 * sign
        d0, d1, d2 = u0 * v1 - u1 * v0, u1 * v2 - u2 * v1, u2 * v0 - u0 * v2
        across = maximum(most(absolute(u0), absolute(u1), absolute(u2)), most(absolute(v0), absolute(v1), absolute(v2)))
        # What a coordinate across is off by: the place of the point, and what leaning takes from lengths along the ray.
        off = 2.0 * error + ahead * (4.0 * UNIT_ROUNDOFF)
        limit = across * (8.0 * off) + across * across * (8.0 * UNIT_ROUNDOFF)
        left = (d0 > limit) & (d1 > limit) & (d2 > limit)
        right = (d0 < -limit) & (d1 < -limit) & (d2 < -limit)
        beside = ((d0 > limit) | (d1 > limit) | (d2 > limit)) & ((d0 < -limit) | (d1 < -limit) | (d2 < -limit))
        behind = (w0 < -error) & (w1 < -error) & (w2 < -error)
        # Where the ray's line meets the plane, times the area: the distances weighted by the parts of it.
        where = d0 * w2 + d1 * w0 + d2 * w1
        doubtful = (limit * ahead + across * across * error) * 8.0
        beyond = (left & (where < -doubtful)) | (right & (where > doubtful))
        lanes = (1 << size_of(child)) - 1
        forth, back = movemask(left & (where > doubtful)) & lanes, movemask(right & (where < -doubtful)) & lanes
        if (movemask(beside | behind | beyond) | forth | back) & lanes != lanes:
            return UNCOUNTED
        windings += _count(forth) - _count(back)
    return -windings if backward == 1 else windings


@inline
def _coordinates(blocks, at, axis, origin):
    """One coordinate of the corners of eight triangles, from a point."""
    i = at + axis * LEAF
    return load(blocks, i) - origin, load(blocks, i + 3 * LEAF) - origin, load(blocks, i + 6 * LEAF) - origin


@inline
def _count(bits):
    count = 0
    while bits != 0:
        bits &= bits - 1
        count += 1
    return count


# -- a surface and a convex piece -------------------------------------------------------------------


@njit()
def _with_piece(A, B, near, far, memory, listed_at, room):
    """Walk through the tree of a surface A for a convex piece B.

    It starts with the box around B's outer ellipsoid: the one around B itself takes six searches, and is for those that
    come near. Where GJK separates a triangle from B, the plane that it found mostly separates those around it, too. So
    the last few planes are kept, and what lies beyond one of them is not looked at.
    """
    a = surface_of(A)
    shift = shift_between(A, B)
    size = lengths(A, B, shift)
    error = rounding_error(A, B, shift)
    W, result = floats_at(memory + GJK, (GJK_ENTRIES,)), floats_at(memory + RESULT, (9,))
    planes = floats_at(memory + SEPARATING, (PLANES * PLANE,))
    listed = integers_at(listed_at, (2 * room,))
    ends = LEAF, LEAF
    middle, half, single, wide = oval_in_frame(A, B, shift, far, size)
    R = rotation_of(A)
    center, closer = (0.0, 0.0, 0.0), False
    stack = integers_at(memory, (STACK,))
    stack[0] = 0
    height, open_pairs, found = 1, 0, 0
    while height > 0:
        height -= 1
        child = a.children[stack[height]]
        if child >= 0:
            bits = near_box(a.boxes, child, single, wide)
            bits = within_planes(a.boxes, child, planes, min(found, PLANES), far, bits)
            while bits != 0:
                stack[height] = child * WIDE + lowest_bit(bits)
                height += 1
                bits &= bits - 1
            continue
        leaf = leaf_of(child)
        placed = floats_at(memory + PLACED, (2 * BLOCK,))
        bits = movemask(gap_to_box(a.blocks, leaf, middle, half) <= 0.0) & ((1 << size_of(child)) - 1)
        if bits != 0 and not closer:
            closer = True
            ends = LEAF, place_piece(B, shift, W, LEAF)
            middle, half, single, wide = box_in_frame(A, B, shift, far, size)
            center = apply(R, middle)
            bits &= movemask(gap_to_box(a.blocks, leaf, middle, half) <= 0.0)
        for k in range(min(found, PLANES)):
            if bits != 0:
                bits &= not_beyond(a.blocks, leaf, planes, k, far)
        if bits == 0:
            continue
        store_corners(placed, BLOCK, placed_corners(A, a.blocks, leaf, (0.0, 0.0, 0.0)))
        while bits != 0:
            lane = lowest_bit(bits)
            bits &= bits - 1
            corners = corners_at(placed, BLOCK, lane)
            write_triangle(W, 0, corners)
            n = minus(center, corners[0])
            if not dot(n, n) > 0.0:
                n = (1.0, 0.0, 0.0)
            status = UNSETTLED
            if far == 0.0:
                status, n, _ = decided(A, B, shift, W, ends, n, error)
            if status == UNSETTLED:
                status, _, _, n = measured_along(A, B, shift, W, ends, n, error, near, far, result)
            if status in (TOUCHING, OVERLAPPING):
                return COLLIDING, open_pairs
            if status != APART:
                if open_pairs < room:
                    listed[2 * open_pairs], listed[2 * open_pairs + 1] = leaf * LEAF + lane, -1
                open_pairs += 1
                continue
            k = found % PLANES
            found += 1
            keep_plane(B, shift, R, n, size, planes, k)
            bits &= not_beyond(a.blocks, leaf, planes, k, far)
    within = OUTSIDE
    if is_solid(A):
        within = parts_within(A, B, shift, size, memory)
    if within == WITHIN:
        return COLLIDING, open_pairs
    return FREE if within == OUTSIDE and open_pairs == 0 else AMBIGUOUS, open_pairs


@inline
def keep_plane(B, shift, R, n, size, planes, k):
    """Keep as plane k, in the axes of a surface's frame, that all of B lies no nearer along n than it says."""
    length = np.sqrt(dot(n, n))
    if not 0.0 < length < np.inf:  # a plane that nothing lies beyond
        planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2] = 0.0, 0.0, 0.0
        planes[PLANE * k + 3] = -np.inf
        return
    n = n[0] / length, n[1] / length, n[2] / length
    m = apply_transposed(R, n)
    low = dot(n, plus(placed_support(B, negated(n)), shift))
    planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2] = m
    planes[PLANE * k + 3] = low - ROUNDINGS * size


@inline
def not_beyond(blocks, leaf, planes, k, reach):
    """Bits of the triangles of a leaf that come within `reach` of plane k from below; of what is no number as well."""
    m = planes[PLANE * k], planes[PLANE * k + 1], planes[PLANE * k + 2]
    at = leaf * BLOCK
    p = load(blocks, at) * m[0] + load(blocks, at + LEAF) * m[1] + load(blocks, at + 2 * LEAF) * m[2]
    q = load(blocks, at + 3 * LEAF) * m[0] + load(blocks, at + 4 * LEAF) * m[1] + load(blocks, at + 5 * LEAF) * m[2]
    r = load(blocks, at + 6 * LEAF) * m[0] + load(blocks, at + 7 * LEAF) * m[1] + load(blocks, at + 8 * LEAF) * m[2]
    limit = planes[PLANE * k + 3] - reach
    return ~movemask((p <= limit) & (q <= limit) & (r <= limit))


@inline
def gap_to_box(blocks, leaf, middle, half):
    """Squared distance of the boxes of eight triangles from a box along the same axes."""
    x = _gap_along(blocks, leaf, 0, middle, half)
    y = _gap_along(blocks, leaf, 1, middle, half)
    z = _gap_along(blocks, leaf, 2, middle, half)
    return x * x + y * y + z * z


@inline
def _gap_along(blocks, leaf, axis, middle, half):
    p, q, r = _coordinates(blocks, leaf * BLOCK, axis, middle[axis])
    return maximum(maximum(least(p, q, r) - half[axis], -half[axis] - most(p, q, r)), 0.0)


@njit()
def box_in_frame(A, B, shift, far, size):
    """Middle and half widths of the box around a piece in the axes of A's frame, with all that rounds.

    Both twice: in double precision, and in single, where `ROUNDINGS` covers their rounding.
    """
    R = rotation_of(A)
    slack = _slack(R, far, size)
    m0, h0 = _extent(B, shift, (R[0], R[3], R[6]), slack)
    m1, h1 = _extent(B, shift, (R[1], R[4], R[7]), slack)
    m2, h2 = _extent(B, shift, (R[2], R[5], R[8]), slack)
    f = np.float32
    return (m0, m1, m2), (h0, h1, h2), (f(m0), f(m1), f(m2)), (f(h0), f(h1), f(h2))


@inline
def _slack(R, far, size):
    """What a box along the axes of R is widened by: the distance, what poses bend, and what rounds."""
    bend = off_orthonormal(R) + 1e-15
    return far * (1.0 + bend) + (4.0 * bend + ROUNDINGS) * size


@njit()
def oval_in_frame(A, B, shift, far, size):
    """As `box_in_frame`, around the outer ellipsoid of a convex piece."""
    R, S = rotation_of(A), rotation_of(B)
    slack = _slack(R, far, size)
    t, p = B.table, B.piece
    c = plus(apply(S, (t[p, OUTER_CENTER], t[p, OUTER_CENTER + 1], t[p, OUTER_CENTER + 2])), shift)
    q = OUTER_SHAPE
    Q = t[p, q], t[p, q + 1], t[p, q + 2], t[p, q + 3], t[p, q + 4], t[p, q + 5]
    h0 = _half_width(Q, apply_transposed(S, (R[0], R[3], R[6]))) + slack
    h1 = _half_width(Q, apply_transposed(S, (R[1], R[4], R[7]))) + slack
    h2 = _half_width(Q, apply_transposed(S, (R[2], R[5], R[8]))) + slack
    m = apply_transposed(R, c)
    f = np.float32
    return m, (h0, h1, h2), (f(m[0]), f(m[1]), f(m[2])), (f(h0), f(h1), f(h2))


@inline
def _half_width(Q, n):
    """How far an ellipsoid with shape matrix Q goes along n from its center; rounded outward."""
    width, _ = outward_width(Q, n, dot(n, n))
    return width


@inline
def _extent(B, shift, n, slack):
    """Where the middle of a piece is along a direction, and how far it goes from there."""
    low = dot(n, plus(placed_support(B, negated(n)), shift)) - slack
    high = dot(n, plus(placed_support(B, n), shift)) + slack
    middle = 0.5 * (low + high)
    return middle, high - middle
