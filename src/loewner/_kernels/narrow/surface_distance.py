"""Signed distance of a surface and another piece.

Boxes are taken in the order of their lower bounds in single precision, nearest first. Their triangles are measured
eight at a time. Finally, GJK measures the nearest two triangles, as separate pieces, for the normal and the witnesses.
Pieces that meet have a depth, see `surface_depth`.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import APART, COLLIDING, FREE, NEAREST
from loewner._kernels.columns import OUTER_CENTER
from loewner._kernels.linalg3 import apply_transposed, dot, image, minus, negated, plus
from loewner._kernels.narrow import surface_boxes as boxes
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.gjk_fast import begin, place_piece
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error, run, write_simplex
from loewner._kernels.narrow.simplex import weigh_inside
from loewner._kernels.narrow.surface_depth import surface_depth
from loewner._kernels.narrow.surface_meets import surface_pair
from loewner._kernels.narrow.surface_walk import BELIEVED
from loewner._kernels.narrow.triangles import squared_distances
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import radius, rotation_of
from loewner._kernels.simd.vectors import highest, maximum, movemask, next_lane, store
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, WIDE, leaf_of

# Limit on the sum of the lengths [m] that enter a distance. With larger sums, squares overflow in single precision.
FARTHEST = 1e18


@apart
def surface_distance(A, B, n, limit, faces, edges, memory, result):
    """Signed distance of the cores of two pieces, at least one of them a surface.

    Parameters
    ----------
    A, B : Placed
    n : tuple of 3 float
        A direction from A to B.
    limit : float
        Distances of cores above this limit are not computed.
    faces, edges : ndarray
        Workspace of `epa_fast`.
    memory : int
        Address of `surface_walk.MEMORY`.
    result : ndarray, shape (9,)
        Receives the unit normal from A to B, and the witnesses relative to a's translation.

    Returns
    -------
    distance : float
        The distance; inf if it is above the limit. If it is negative, its absolute value is the depth of a pair of
        convex parts. The depth of the pieces is at least this value, up to rounding (certified.md B49).
    gap : float
        Difference between the bounds on the distance.
    """
    shift = shift_between(A, B)
    if not lengths(A, B, shift) < FARTHEST:
        return 0.0, np.inf
    verdict, _ = surface_pair(A, B, 0.0, 0.0, memory, memory, 0)
    if verdict != FREE:
        # If faces are coplanar, the verdict remains open even if other parts certainly overlap.
        depth = surface_depth(A, B, shift, n, faces, edges, memory, result)
        if depth > 0.0:
            return -depth, 0.0
    triangle_a = triangle_b = -1
    if boxes.is_surface(A) and boxes.is_surface(B):
        triangle_a, triangle_b = _nearest_triangles(A, B, shift, limit, memory)
    elif boxes.is_surface(A):
        triangle_a = _nearest_to_piece(A, B, shift, limit, memory)
    else:
        triangle_b = _nearest_to_piece(B, A, negated(shift), limit, memory)
    if triangle_a < 0 and triangle_b < 0:
        return np.inf, 0.0
    if triangle_a >= 0:
        A = walk.triangle_piece(A, triangle_a, 0.0, walk.first_of(memory))
    if triangle_b >= 0:
        B = walk.triangle_piece(B, triangle_b, 0.0, walk.second_of(memory))
    distance, gap = _between_pieces(A, B, shift, n, memory, result)
    # Flat cores that lie in the same plane have depth 0.
    return (min(distance, 0.0), 0.0) if verdict == COLLIDING else (distance, gap)


@njit()
def _between_pieces(A, B, shift, n, memory, result):
    """Distance of two convex cores that are apart or nearly touch, and the gap of its bounds."""
    error = rounding_error(A, B, shift)
    W = walk.vertices_of(memory)
    ends = begin(A, B, shift, W)
    status, below, above, _ = walk.measured(A, B, shift, W, ends, n, error, -np.inf, np.inf, result)
    if status == NEAREST:
        return above, above - below
    G, weights, v, d = np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3)
    _, below, above, k = run(A, B, shift, n, 0.0, False, G, weights, v, d)
    radii = radius(A) + radius(B)  # The bounds that `run` returns are reduced by these radii.
    if k == 4:  # The cores have a point in common, whose weights `run` has not written.
        above = -radii
        weigh_inside(G, weights, v)
    below = max(below, -radii)  # The distance is at least 0: cores that certainly intersect were settled before.
    write_simplex(G, k, weights, d, result)
    return above + radii, above - below


class Ways(NamedTuple):
    """A unit vector n as a `Way` in tree a, its opposite as a `Way` in tree b, and the shift of the frames along n."""

    n: Any
    a: Any
    b: Any
    away: Any


@njit()
def _nearest_triangles(A, B, shift, limit, memory):
    """Find the nearest triangles of two surfaces, by block and lane; -1 if none comes within `limit`.

    The distances of boxes exclude most pairs; the extents of boxes along the normal of the nearest triangles found so
    far exclude more.
    """
    a, b = boxes.surface_of(A), boxes.surface_of(B)
    about = boxes.relation(A, B, shift, lengths(A, B, shift), 0.0)
    lanes, placed = walk.lanes_of(memory), walk.placed_of(memory)
    best, found_a, found_b = limit * limit, -1, -1
    ways = _ways(A, B, shift, _between_middles(A, B, shift), about.slack)
    height = old = walk.begun(memory)
    while True:
        child_a, child_b, height, old = _next_near(about, ways, a, b, memory, height, old, best)
        if child_a >= 0:
            return found_a, found_b
        leaf_a, leaf_b = leaf_of(child_a), leaf_of(child_b)
        reach_a, reach_b = _reaches(a.blocks, leaf_a, ways.a.n), _reaches(b.blocks, leaf_b, ways.b.n)
        rows = walk.lanes_in(child_a, _near_along((ways.away - highest(reach_b)) - reach_a, best))
        columns = walk.lanes_in(child_b, _near_along((ways.away - highest(reach_a)) - reach_b, best))
        if rows == 0 or columns == 0:
            continue
        store(lanes, WIDE, reach_a)
        walk.store_corners(placed, 0, walk.placed_corners(A, a.blocks, leaf_a, walk.ORIGIN))
        others = walk.placed_corners(B, b.blocks, leaf_b, shift)
        before = best
        while rows != 0:
            lane, rows = next_lane(rows)
            corners = walk.corners_at(placed, 0, lane)
            near = _near_along((ways.away - lanes[WIDE + lane]) - reach_b, best)
            bits = movemask(near & (walk.box_gaps(corners, others) <= best)) & columns
            if bits != 0:
                bits &= movemask(_middle_gaps(corners, others) <= best)
            if bits == 0:
                continue
            store(lanes, 0, squared_distances(corners, others))
            while bits != 0:
                other, bits = next_lane(bits)
                if lanes[other] <= best:
                    best = lanes[other]
                    found_a, found_b = leaf_a * LEAF + lane, leaf_b * LEAF + other
        if best < before:
            S = walk.triangle_piece(A, found_a, 0.0, walk.first_of(memory))
            T = walk.triangle_piece(B, found_b, 0.0, walk.second_of(memory))
            W, result, error = walk.vertices_of(memory), walk.result_of(memory), rounding_error(S, T, shift)
            ends = begin(S, T, shift, W)
            status, _, _, _ = walk.measured(S, T, shift, W, ends, ways.n, error, -np.inf, np.inf, result)
            if status == NEAREST:
                ways = _ways(A, B, shift, (result[0], result[1], result[2]), about.slack)
                old = height


@inline
def _next_near(about, ways, a, b, memory, height, old, best):
    """Find the next leaves whose squared distance may be at most `best`; also return the height and the new `old`.

    Entries of the stack below `old` were pushed before the direction last changed.
    """
    stack, bounds = walk.stack_of(memory), walk.bounds_of(memory)
    while height > 0:
        height -= 1
        if bounds[height, 0] * BELIEVED > best:
            continue
        slot_a, slot_b = stack[height, 0], stack[height, 1]
        if height < old:
            old = height
            gap = ways.away - boxes.reach_at(a, slot_a, ways.a) - boxes.reach_at(b, slot_b, ways.b)
            if gap > 0.0 and gap * gap * BELIEVED > best:
                continue
        child_a, child_b = a.children[slot_a], b.children[slot_b]
        if child_a < 0 and child_b < 0:
            return child_a, child_b, height, old
        if boxes.opens_first(a, b, slot_a, slot_b):
            along = (ways.away - boxes.reach_at(b, slot_b, ways.b)) - boxes.reaches_of(a, child_a, ways.a)
            if movemask(_single_near(along, best)) == 0:
                continue
            middle, half = boxes.box_at(b.boxes, slot_b)
            middles, halves = boxes.boxes_of(a.boxes, child_a)
            t = boxes.between(about, middles, middle)
            gaps = _larger(boxes.squared_gaps(about, t, halves, half), along)
            height = walk.push_near(memory, height, gaps, t, halves, best, child_a, slot_b, True)
        else:
            along = (ways.away - boxes.reach_at(a, slot_a, ways.a)) - boxes.reaches_of(b, child_b, ways.b)
            if movemask(_single_near(along, best)) == 0:
                continue
            middle, half = boxes.box_at(a.boxes, slot_a)
            middles, halves = boxes.boxes_of(b.boxes, child_b)
            t = boxes.between(about, middle, middles)
            gaps = _larger(boxes.squared_gaps(about, t, half, halves), along)
            height = walk.push_near(memory, height, gaps, t, halves, best, child_b, slot_a, False)
    return 0, 0, 0, old


@inline
def _reaches(blocks, leaf, n):
    """How far the triangles of a leaf extend along a direction."""
    p, q, r = walk.corners_of(blocks, leaf)
    return walk.most(dot(p, n), dot(q, n), dot(r, n))


@inline
def _near_along(gap, best):
    """Mask of gaps along a direction for which the squared distance may be at most `best`."""
    gap = maximum(gap, 0.0)
    return gap * gap * BELIEVED <= best


@inline
def _single_near(gap, best):
    """Compute `_near_along` in single precision."""
    gap = maximum(gap, np.float32(0.0))
    return gap * gap <= walk.rounded_up(best)


@inline
def _larger(squared, gap):
    """The larger of squared lower bounds and the squares of gaps."""
    gap = maximum(gap, np.float32(0.0))
    return maximum(gap * gap, squared)


@inline
def _between_middles(A, B, shift):
    """Direction from the middle of one surface to the middle of the other."""
    t, u, c = A.table, B.table, OUTER_CENTER
    from_a = t[A.piece, c], t[A.piece, c + 1], t[A.piece, c + 2]
    from_b = u[B.piece, c], u[B.piece, c + 1], u[B.piece, c + 2]
    return minus(image(rotation_of(B), shift, from_b), image(rotation_of(A), walk.ORIGIN, from_a))


@inline
def _ways(A, B, shift, n, slack):
    """Make the `Ways` along a vector n."""
    n = walk.unit(n)
    a, b = apply_transposed(rotation_of(A), n), apply_transposed(rotation_of(B), negated(n))
    return Ways(
        n, boxes.way_along(boxes.singles(a)), boxes.way_along(boxes.singles(b)), np.float32(dot(n, shift)) - slack
    )


@inline
def _middle_gaps(a, b):
    """Lower bounds on the squared distances of a triangle from eight triangles, along the lines between middles."""
    n = minus(plus(plus(b[0], b[1]), b[2]), plus(plus(a[0], a[1]), a[2]))
    near = walk.least(dot(b[0], n), dot(b[1], n), dot(b[2], n))
    gap = maximum(near - walk.most(dot(a[0], n), dot(a[1], n), dot(a[2], n)), 0.0)
    return gap * gap * BELIEVED / (dot(n, n) + 1e-300)  # The term 1e-300 avoids 0 / 0 if the centers coincide.


@njit()
def _nearest_to_piece(A, B, shift, limit, memory):
    """Find the triangle of surface A that is nearest to the convex piece B; -1 if none comes within `limit`.

    Each search ends with a plane. The last few planes are kept, and triangles far beyond one of them are skipped.
    """
    a, R, size = boxes.surface_of(A), rotation_of(A), lengths(A, B, shift)
    error = rounding_error(A, B, shift)
    W, result = walk.vertices_of(memory), walk.result_of(memory)
    placed, planes = walk.placed_of(memory), walk.planes_of(memory)
    ends, box = (LEAF, place_piece(B, shift, W, LEAF)), boxes.box_in_frame(A, B, shift, 0.0, size)
    center = image(R, walk.ORIGIN, box.middle)
    best, nearest, searches, height = limit, -1, 0, walk.begun(memory)
    while True:
        kept = min(searches, walk.PLANES)
        child, height = walk.next_nearest(a, box.single, box.wide, kept, best * best, memory, height)
        if child >= 0:
            return nearest
        leaf = leaf_of(child)
        bits = walk.lanes_in(child, walk.gap_to_box(a.blocks, leaf, box) * BELIEVED <= best * best)
        bits = walk.not_beyond_any(a.blocks, leaf, planes, kept, best, bits)
        if bits == 0:
            continue
        walk.store_corners(placed, BLOCK, walk.placed_corners(A, a.blocks, leaf, walk.ORIGIN))
        while bits != 0:
            lane, bits = next_lane(bits)
            corners = walk.corners_at(placed, BLOCK, lane)
            walk.write_triangle(W, 0, corners)
            n = walk.nonzero(minus(center, corners[0]))
            status, _, above, n = walk.measured(A, B, shift, W, ends, n, error, -np.inf, best, result)
            k = searches % walk.PLANES
            searches += 1
            walk.keep_plane(B, shift, R, n, size, planes, k)
            if status != APART:
                if status != NEAREST:  # The pieces are so close to contact that the fast search finds no distance.
                    piece = walk.triangle_piece(A, leaf * LEAF + lane, 0.0, walk.first_of(memory))
                    above, _ = _between_pieces(piece, B, shift, n, memory, result)
                if above <= best:
                    best, nearest = max(above, 0.0), leaf * LEAF + lane
            bits &= walk.not_beyond(a.blocks, leaf, planes, k, best)
