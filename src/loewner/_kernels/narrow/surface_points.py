"""Points and surfaces: a surface's winding number around a point, its nearest point, and points in solids.

A solid also contains everything within its surface. If nothing meets this surface, the winding number of one point of
each connected part of the other body decides. The winding number counts, with signs, how often a ray from the point
crosses the surface.
"""

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import UNCOUNTED
from loewner._kernels.linalg3 import cross, dot, image, minus, negated, plus
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.surface_boxes import ROUNDINGS, box_at, is_solid, is_surface, singles, surface_of
from loewner._kernels.narrow.triangles import nearest_on
from loewner._kernels.pieces.shapes import placed_support, rotation_of
from loewner._kernels.simd.vectors import absolute, load, load_single, maximum, movemask, next_lane, store
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, ROWS, WIDE, leaf_of, size_of

# Where a point may lie relative to a solid, in order of increasing danger.
OUTSIDE, UNKNOWN, WITHIN = 0, 1, 2

# Slopes of the first ray, which runs near one axis, towards the other two axes. A ray exactly along an axis would meet
# many edges of typical meshes. From each of the six rays to the next, one slope grows by 0.1 and the other falls by
# 0.1; both stay positive.
LEAN_I, LEAN_J = 0.07391, 0.61803


@inline
def within_either(A, B, shift, size, memory):
    """Return whether a part of one of two pieces lies within the other piece, if that is a solid."""
    location = OUTSIDE
    if is_solid(A):
        location = _parts_within(A, B, shift, size, memory)
    if is_solid(B) and location != WITHIN:
        location = max(location, _parts_within(B, A, negated(shift), size, memory))
    return location


@apart
def _parts_within(A, B, shift, size, memory):
    """Return whether a part of B lies within the solid A, judged by one point of each connected part."""
    if not is_surface(B):
        return point_within(A, plus(placed_support(B, (1.0, 0.0, 0.0)), shift), size, memory)
    parts, R, left = surface_of(B).parts, rotation_of(B), walk.left_of(memory)
    location = OUTSIDE
    for at in range(0, len(parts), 3):
        if left[0] <= 0:
            return UNKNOWN
        left[0] -= 1
        x = image(R, shift, (parts[at], parts[at + 1], parts[at + 2]))
        location = max(location, point_within(A, x, size, memory))
        if location == WITHIN:
            break
    return location


@njit()
def point_within(A, x, size, memory):
    """Return whether a point, given in world axes from the translation of A, lies within the solid A."""
    R = rotation_of(A)
    # Use the inverse of the rotation, not its transpose, because a pose is only required to be rigid to within 1e-6.
    u, v, w = (R[0], R[3], R[6]), (R[1], R[4], R[7]), (R[2], R[5], R[8])
    volume = dot(cross(u, v), w)
    q = dot(cross(v, w), x) / volume, dot(cross(w, u), x) / volume, dot(cross(u, v), x) / volume
    number = winding_number(surface_of(A), q, size, memory)
    return UNKNOWN if number == UNCOUNTED else WITHIN if number != 0 else OUTSIDE


@inline
def _along_ray(boxes, node, ray):
    """Bits of the boxes of a node that a ray may meet; see `_windings`."""
    i, j, k, start, lean_i, lean_j, sign, slack = ray
    at, i, j, k = node * ROWS, i * WIDE, j * WIDE, k * WIDE
    far, deep = load_single(boxes, at + k) - start[2], load_single(boxes, at + 3 * WIDE + k)
    aside_i = load_single(boxes, at + i) - start[0] - far * lean_i
    aside_j = load_single(boxes, at + j) - start[1] - far * lean_j
    return movemask(
        (absolute(aside_i) <= load_single(boxes, at + 3 * WIDE + i) + (deep * lean_i + slack))
        & (absolute(aside_j) <= load_single(boxes, at + 3 * WIDE + j) + (deep * lean_j + slack))
        & (far * sign + deep >= -slack)
    )


_next_along_ray = walk.walking(_along_ray)


@njit()
def winding_number(a, q, size, memory):
    """Count how often a surface winds around a point of its frame; UNCOUNTED if no ray decides.

    The function follows a ray near an axis. If the ray comes too close to an edge or starts too close to a triangle,
    another ray is tried. `size` is a sum of lengths that bounds coordinates; the error of the point may be up to
    CORNER_ERROR times `size`.
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
        k = way >> 1
        i, j = (k + 1) % 3, (k + 2) % 3
        lean = LEAN_I + 0.1 * turn, LEAN_J - 0.1 * turn
        windings = _windings(a, (q[i], q[j], q[k]), i, j, k, way & 1, lean, size, memory)
        if windings != UNCOUNTED:
            return windings
    return UNCOUNTED


@njit()
def _windings(a, q, i, j, k, backward, lean, size, memory):
    """Count, with signs, how often a ray from a point along axis k, or against it, crosses a surface.

    The ray leans towards the axes i and j by `lean`: on the ray, the coordinates i and j, less their share of
    coordinate k, are constant.
    """
    lean_i, lean_j = lean
    sign = -1.0 if backward == 1 else 1.0
    f = np.float32
    ray = i, j, k, singles(q), f(lean_i), f(lean_j), f(sign), f(ROUNDINGS * size)
    error = walk.CORNER_ERROR * size
    height, windings = walk.resumed(memory), 0
    while True:
        child, height = _next_along_ray(a, memory, height, ray)
        if child >= 0:
            return UNCOUNTED if height > 0 else -windings if backward == 1 else windings
        at = leaf_of(child) * BLOCK
        u0, u1, u2 = _coordinates(a.blocks, at, i, q[0])
        v0, v1, v2 = _coordinates(a.blocks, at, j, q[1])
        w0, w1, w2 = _coordinates(a.blocks, at, k, q[2])
        ahead = _largest(w0, w1, w2)
        u0, u1, u2 = u0 - w0 * lean_i, u1 - w1 * lean_i, u2 - w2 * lean_i
        v0, v1, v2 = v0 - w0 * lean_j, v1 - w1 * lean_j, v2 - w2 * lean_j
        w0, w1, w2 = w0 * sign, w1 * sign, w2 * sign
        d0, d1, d2 = u0 * v1 - u1 * v0, u1 * v2 - u2 * v1, u2 * v0 - u0 * v2
        across = maximum(_largest(u0, u1, u2), _largest(v0, v1, v2))
        # Error of a coordinate perpendicular to the ray: twice the error of a point, plus the rounding error of the
        # slope times the distance from the point along the axis.
        off = 2.0 * error + ahead * (4.0 * UNIT_ROUNDOFF)
        limit = across * (8.0 * off) + across * across * (8.0 * UNIT_ROUNDOFF)
        left = (d0 > limit) & (d1 > limit) & (d2 > limit)
        right = (d0 < -limit) & (d1 < -limit) & (d2 < -limit)
        beside = ((d0 > limit) | (d1 > limit) | (d2 > limit)) & ((d0 < -limit) | (d1 < -limit) | (d2 < -limit))
        behind = (w0 < -error) & (w1 < -error) & (w2 < -error)
        # The sum of the corners' distances along the axis, weighted with d0, d1 and d2, is the distance at which the
        # ray's line meets the triangle's plane, times twice the area of the triangle seen along the ray.
        where = d0 * w2 + d1 * w0 + d2 * w1
        doubtful = (limit * ahead + across * across * error) * 8.0
        beyond = (left & (where < -doubtful)) | (right & (where > doubtful))
        lanes = (1 << size_of(child)) - 1
        forth, back = movemask(left & (where > doubtful)) & lanes, movemask(right & (where < -doubtful)) & lanes
        if (movemask(beside | behind | beyond) | forth | back) & lanes != lanes:
            return UNCOUNTED
        windings += _count(forth) - _count(back)


@inline
def _coordinates(blocks, at, axis, origin):
    """One coordinate of the corners of eight triangles, relative to a point."""
    i = at + axis * LEAF
    return load(blocks, i) - origin, load(blocks, i + 3 * LEAF) - origin, load(blocks, i + 6 * LEAF) - origin


@inline
def _largest(x, y, z):
    return walk.most(absolute(x), absolute(y), absolute(z))


@inline
def _count(bits):
    count = 0
    while bits != 0:
        bits &= bits - 1
        count += 1
    return count


@njit()
def nearest_point(A, x, size, memory):
    """Distance from surface A to a point (in world axes, relative to A's translation), and the nearest point of A."""
    a, R = surface_of(A), rotation_of(A)
    # Compute distances to boxes in A's axes, which may deviate from orthonormal axes by 1e-6, and distances to
    # triangles in world axes.
    single = singles((dot((R[0], R[3], R[6]), x), dot((R[1], R[4], R[7]), x), dot((R[2], R[5], R[8]), x)))
    slack = np.float32(1e-5 * size)
    lanes, placed = walk.lanes_of(memory), walk.placed_of(memory)
    best, near = np.inf, x
    height = walk.begun(memory)
    while True:
        child, height = walk.next_nearest(a, single, (slack, slack, slack), 0, best, memory, height)
        if child >= 0:
            return np.sqrt(best), near
        p = nearest_on(walk.placed_corners(A, a.blocks, leaf_of(child), walk.ORIGIN), x)
        d = minus(p, x)
        squared = dot(d, d)
        bits = walk.lanes_in(child, squared <= best)
        if bits == 0:
            continue
        store(lanes, 0, squared)
        store(placed, 0, p[0])
        store(placed, LEAF, p[1])
        store(placed, 2 * LEAF, p[2])
        while bits != 0:
            lane, bits = next_lane(bits)
            if lanes[lane] <= best:
                best, near = lanes[lane], (placed[lane], placed[LEAF + lane], placed[2 * LEAF + lane])
