"""A lower bound on how deep a surface and another piece penetrate each other.

The bound is the depth of the deepest pair of convex parts, because two bodies are apart only if all pairs of their
parts are apart. For solids, a ball or a point of one body that lies within the other body may prove more, because it
has to leave the other body.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import DEPTH_FOUND, NO_LIMIT
from loewner._kernels.columns import (
    FRAME_CENTER,
    FRAME_FACTOR,
    INNER_CENTER,
    INNER_SIGMA,
    KIND,
    POINT,
    POINTS_TO,
    POLYTOPE,
    SEGMENT,
)
from loewner._kernels.linalg3 import cross, dot, image, minus, negated, scaled
from loewner._kernels.narrow import epa_fast, epa_robust
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error, run
from loewner._kernels.narrow.surface_boxes import box_in_frame, is_solid, is_surface, relation, surface_of
from loewner._kernels.narrow.surface_points import WITHIN, nearest_point, point_within
from loewner._kernels.narrow.triangles import doubt, length1, longest_edge, same_side, sides
from loewner._kernels.pieces.shapes import radius, rotation_of
from loewner._kernels.simd.vectors import movemask, next_lane
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, leaf_of, size_of

# An inner ellipsoid counts as absent if its least semi-axis is at most this length [m].
NO_INSIDE = 1e-100


@njit()
def surface_depth(A, B, shift, n, faces, edges, memory, result):
    """Lower bound on the depth of two pieces that meet; the operands are documented in `surface_distance`."""
    depth, back, own = 0.0, negated(shift), np.empty(9)
    result[0], result[1], result[2] = walk.unit(n)
    for c in range(6):
        result[3 + c] = 0.0
    if is_surface(A) and is_surface(B):
        depth = _deepest_triangles(A, B, shift, depth, faces, edges, memory, own, result)
    elif is_surface(A):
        depth = _deepest_to_piece(A, B, shift, depth, 1.0, faces, edges, memory, own, result)
    else:
        depth = _deepest_to_piece(B, A, back, depth, -1.0, faces, edges, memory, own, result)
    depth = _depth_of_balls(A, B, shift, depth, result)
    if is_solid(A):
        depth = _deepest_point(A, B, shift, depth, 1.0, memory, own, result)
    if is_solid(B):
        depth = _deepest_point(B, A, back, depth, -1.0, memory, own, result)
    return depth


@inline
def _write_turned(own, shift, sign, result):
    """Copy a normal and two witnesses; with sign -1, exchange the two bodies, whose translations differ by `shift`."""
    for c in range(3):
        result[c] = sign * own[c]
        if sign > 0.0:
            result[3 + c], result[6 + c] = own[3 + c], own[6 + c]
        else:
            result[3 + c], result[6 + c] = own[6 + c] - shift[c], own[3 + c] - shift[c]


@njit()
def _deepest_triangles(A, B, shift, found, faces, edges, memory, own, result):
    """Depth of the deepest pair of triangles, if it is more than `found`."""
    a, b, size = surface_of(A), surface_of(B), lengths(A, B, shift)
    error, rounding = walk.CORNER_ERROR * size, rounding_error(A, B, shift)
    about, placed = relation(A, B, shift, size, 0.0), walk.placed_of(memory)
    height = walk.begun(memory)
    while True:
        child_a, child_b, height = walk.next_meeting(about, a, b, memory, height)
        if child_a >= 0:
            return found
        leaf_a, leaf_b = leaf_of(child_a), leaf_of(child_b)
        walk.store_corners(placed, 0, walk.placed_corners(A, a.blocks, leaf_a, walk.ORIGIN))
        others = walk.placed_corners(B, b.blocks, leaf_b, shift)
        walk.store_corners(placed, BLOCK, others)
        long_b = longest_edge(others[0], others[1], others[2])
        for lane in range(size_of(child_a)):
            corners = walk.corners_at(placed, 0, lane)
            bits = walk.lanes_in(child_b, walk.box_gaps(corners, others) <= 0.0)
            if bits == 0:
                continue
            long_a = longest_edge(corners[0], corners[1], corners[2])
            side = doubt(long_a, long_a, length1(minus(others[0], corners[0])) + long_a + long_b, error)
            on_a = sides(cross(minus(corners[1], corners[0]), minus(corners[2], corners[1])), corners[0], others)
            bits &= ~movemask(same_side(on_a[0], on_a[1], on_a[2], side))
            while bits != 0:
                lane_b, bits = next_lane(bits)
                other = walk.corners_at(placed, BLOCK, lane_b)
                if _most_depth(corners, other) <= found:
                    continue
                S = walk.triangle_piece(A, leaf_a * LEAF + lane, 0.0, walk.first_of(memory))
                T = walk.triangle_piece(B, leaf_b * LEAF + lane_b, 0.0, walk.second_of(memory))
                n = minus(other[0], corners[0])
                status, _, deep = epa_fast.overlap_depth(S, T, n, faces, edges, own)
                settled = status == DEPTH_FOUND and deep > found
                deep = epa_fast.proven_depth(rounding, faces, edges, own) if settled else 0.0
                if deep > found:
                    found = deep
                    _write_turned(own, shift, 1.0, result)


@inline
def _most_depth(a, b):
    """Upper bound on the depth of two triangles: the shift along either normal that parts them; 0 if they are apart."""
    n, m = cross(minus(a[1], a[0]), minus(a[2], a[0])), cross(minus(b[1], b[0]), minus(b[2], b[0]))
    return max(min(_overlap(n, a, b), _overlap(m, a, b)), 0.0)


@inline
def _overlap(n, a, b):
    squared = dot(n, n)
    if not squared > 0.0:
        return np.inf
    p, q, r = dot(n, a[0]), dot(n, a[1]), dot(n, a[2])
    s, t, u = dot(n, b[0]), dot(n, b[1]), dot(n, b[2])
    return min(max(p, max(q, r)) - min(s, min(t, u)), max(s, max(t, u)) - min(p, min(q, r))) / np.sqrt(squared)


@njit()
def _deepest_to_piece(A, B, shift, found, sign, faces, edges, memory, own, result):
    """Depth of the triangle of A deepest in the convex piece B; with sign -1, the result is for exchanged bodies."""
    a, box = surface_of(A), box_in_frame(A, B, shift, 0.0, lengths(A, B, shift))
    rounding, curved = rounding_error(A, B, shift), B.layout[B.piece, KIND] != POLYTOPE
    work, n = epa_robust.workspace(curved), (0.0, 0.0, 1.0)
    G, weights, v, d = np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3)
    height = walk.begun(memory)
    while True:
        child, height = walk.next_in_box(a, box, 0, 0.0, memory, height)
        if child >= 0:
            return found
        leaf = leaf_of(child)
        bits = walk.lanes_in(child, walk.gap_to_box(a.blocks, leaf, box) <= 0.0)
        while bits != 0:
            lane, bits = next_lane(bits)
            S = walk.triangle_piece(A, leaf * LEAF + lane, 0.0, walk.first_of(memory))
            if curved:
                _narrow(S)
                _, _, above, k = run(S, B, shift, n, 0.0, False, G, weights, v, d)
                if k < 4 and above + radius(S) + radius(B) > 0.0:
                    continue
                _, deep = epa_robust.penetration(S, B, shift, epa_robust.DEPTH_ACCURACY, work, own)
                # If B's core is a point, or a segment parallel to the plane of the triangle, the Minkowski difference
                # is flat, and no depth is proven.
                deep = epa_robust.proven_depth(rounding, work) if deep > found else 0.0
            else:
                status, _, deep = epa_fast.overlap_depth(S, B, n, faces, edges, own)
                settled = status == DEPTH_FOUND and deep > found
                deep = epa_fast.proven_depth(rounding, faces, edges, own) if settled else 0.0
            if deep > found:
                found = deep
                _write_turned(own, shift, sign, result)


@njit()
def _narrow(S):
    """Turn a triangle piece without area into a segment or a point, because EPA accepts these as cores."""
    p, table = S.points, S.table
    a, b, c = (p[0], p[8], p[16]), (p[1], p[9], p[17]), (p[2], p[10], p[18])
    n = cross(minus(b, a), minus(c, a))
    if dot(n, n) > 0.0:
        return
    ab, bc, ca = minus(b, a), minus(c, b), minus(a, c)
    longest = max(dot(ab, ab), max(dot(bc, bc), dot(ca, ca)))
    start, way = (a, ab) if dot(ab, ab) == longest else ((b, bc) if dot(bc, bc) == longest else (c, ca))
    S.layout[0, KIND], S.layout[0, POINTS_TO] = SEGMENT if longest > 0.0 else POINT, 0
    for k in range(3):
        table[0, FRAME_CENTER + k] = start[k] + 0.5 * way[k]
        table[0, FRAME_FACTOR + 3 * k + 2] = 0.5 * way[k]


@njit()
def _depth_of_balls(A, B, shift, found, result):
    """Depth of the balls about the middles of the inner ellipsoids, if it is more than `found`."""
    a, ball_a = _inner_ball(A, walk.ORIGIN)
    b, ball_b = _inner_ball(B, shift)
    way = minus(b, a)
    apart_by = np.sqrt(dot(way, way))
    if not ball_a + ball_b - apart_by > found:
        return found
    n = walk.unit(way)
    for c in range(3):
        result[c], result[3 + c], result[6 + c] = n[c], a[c] + ball_a * n[c], b[c] - ball_b * n[c]
    return ball_a + ball_b - apart_by


@inline
def _inner_ball(P, shift):
    """Center and radius of a ball inside the core of a piece; the radius is 0 if the piece has no inside."""
    t, c = P.table, INNER_CENTER
    center = image(rotation_of(P), shift, (t[P.piece, c], t[P.piece, c + 1], t[P.piece, c + 2]))
    size = t[P.piece, INNER_SIGMA] * (1.0 - 1e-9) - radius(P)
    return center, size if size > NO_INSIDE else 0.0


@njit()
def _deepest_point(A, B, shift, found, sign, memory, own, result):
    """Depth of the deepest among B's ball and the points of B's parts within the solid A."""
    R, size = rotation_of(B), lengths(A, B, shift)
    center, ball = _inner_ball(B, shift)
    found = _deeper_point(A, center, ball, size, found, shift, sign, memory, own, result)
    if is_surface(B):
        parts = surface_of(B).parts
        for at in range(0, len(parts), 3):
            x = image(R, shift, (parts[at], parts[at + 1], parts[at + 2]))
            found = _deeper_point(A, x, 0.0, size, found, shift, sign, memory, own, result)
    return found


@njit()
def _deeper_point(A, x, ball, size, found, shift, sign, memory, own, result):
    """Depth of a ball about a point within the solid A, if it is more than `found`."""
    walk.left_of(memory)[0] = NO_LIMIT
    if point_within(A, x, size, memory) != WITHIN:
        return found
    depth, near = nearest_point(A, x, size, memory)
    if not depth > 0.0 or not depth + ball > found:
        return found
    n = scaled(1.0 / depth, minus(near, x))
    for c in range(3):
        own[c], own[3 + c], own[6 + c] = n[c], near[c], x[c] - ball * n[c]
    _write_turned(own, shift, sign, result)
    return depth + ball
