"""Distances of many points from a mesh, winding numbers around the points, and orientations of nearby triangles.

The tree is in the frame of the points. Boxes are tested in single precision, with slack for rounding. Triangles are
tested eight at a time. The error of a returned distance is a few roundoffs of the coordinates, however thin the nearest
triangle is (certified.md B44).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import NO_LIMIT
from loewner._kernels.linalg3 import along, dot, minus, plus, scaled
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.surface_boxes import ROUNDINGS, boxes_of, singles, squared_gap, tree_at
from loewner._kernels.narrow.surface_points import winding_number
from loewner._kernels.narrow.triangles import nearest_on
from loewner._kernels.simd.vectors import LANES, broadcast, highest, load, maximum, movemask, next_lane, store
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, leaf_of


@njit()
def points_memory():
    """Number of bytes that the functions below need."""
    return walk.SIZE


@njit()
def squared_distances_of(points, triangles, squared):
    """Squared distance of each point from its own triangle.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
    triangles : ndarray, shape (n, 3, 3)
    squared : ndarray, shape (n,)
        Receives the result.
    """
    for n in range(len(points)):
        x, t = _point(points, n), triangles[n]
        d = minus(nearest_on((_point(t, 0), _point(t, 1), _point(t, 2)), x), x)
        squared[n] = dot(d, d)


@njit()
def heights_above(planes, points, enough, heights):
    """Compute how far points are above the highest of several planes, for the boundary of a convex piece.

    Parameters
    ----------
    planes : ndarray, shape (4 n,)
        The x of n normals (n is a multiple of eight), then their y, their z, and the offsets of the planes.
    points : ndarray, shape (m, 3)
    enough : ndarray, shape (m,)
        A height for each point: once the point is this far above a plane, its search may end.
    heights : ndarray, shape (m,)
        Receives the heights.
    """
    count = len(planes) // 4
    for p in range(len(points)):
        x, y, z = _point(points, p)
        above, at = broadcast(-np.inf), 0
        while at < count and movemask(above >= enough[p]) == 0:
            along = x * load(planes, at) + y * load(planes, count + at) + z * load(planes, 2 * count + at)
            above = maximum(above, along - load(planes, 3 * count + at))
            at += LANES
        heights[p] = highest(above)


@njit()
def nearest_triangles(table, size, points, distances, places, memory):
    """Find the distances of points from a mesh, and the nearest triangles.

    Parameters
    ----------
    table : int
        Address of the table of a tree.
    size : float
        A sum of lengths that bounds all coordinates of the mesh and of the points.
    points : ndarray, shape (n, 3)
    distances : ndarray, shape (n,)
        Receives the distances.
    places : ndarray of int64, shape (n,)
        Receives the places of the nearest triangles in the tree's blocks.
    memory : int
        Address of `points_memory` bytes.
    """
    tree, lanes = tree_at(table), walk.lanes_of(memory)
    slack = np.float32(ROUNDINGS * size)
    for n in range(len(points)):
        x = _point(points, n)
        single = singles(x)
        best, place, height = np.inf, 0, walk.begun(memory)
        while True:
            child, height = walk.next_nearest(tree, single, (slack, slack, slack), 0, best, memory, height)
            if child >= 0:
                break
            leaf = leaf_of(child)
            squared = _squared_distances(tree.blocks, leaf, x)
            bits = walk.lanes_in(child, squared < best)
            if bits == 0:
                continue
            store(lanes, 0, squared)
            while bits != 0:
                lane, bits = next_lane(bits)
                if lanes[lane] < best:
                    best, place = lanes[lane], leaf * LEAF + lane
        distances[n], places[n] = np.sqrt(best), place


@njit()
def winding_numbers(table, size, points, numbers, memory):
    """Compute the winding numbers of a mesh around points from the crossings of rays; UNCOUNTED if no ray decides.

    The parameters are documented in `nearest_triangles`.
    """
    tree = tree_at(table)
    for n in range(len(points)):
        walk.left_of(memory)[0] = NO_LIMIT
        numbers[n] = winding_number(tree, _point(points, n), size, memory)


@inline
def _in_ball(boxes, node, ball):
    """Bits of the boxes of a node that come near a point."""
    middle, slack, far = ball
    middles, halves = boxes_of(boxes, node)
    gaps = squared_gap(minus(middles, middle), halves, (slack, slack, slack))
    return movemask((gaps <= far) & (halves[0] >= np.float32(0.0)))


_next_in_ball = walk.walking(_in_ball)


@njit()
def facing_one_way(table, size, points, reach, normals, two_sided, least, steps, answers, near, memory):
    """For each point, write whether the outer sides of all triangles within its reach face one half-space.

    Parameters
    ----------
    table, size, points, memory
        Documented in `nearest_triangles`.
    reach : ndarray, shape (n,)
    normals : ndarray, shape (places, 3)
        Normals of the triangles, in the order of the tree's blocks; triangles without a normal do not count.
    two_sided : bool
        Whether the outer side of a triangle is the side on which the point lies.
    least : float
        A normal faces along a direction if their product is more than this value.
    steps : int
        Number of steps of the search for such a direction.
    answers : ndarray of bool, shape (n,)
        Receives the answers; the answer is False for a point without a triangle in reach.
    near : ndarray, shape (triangles, 3)
        Scratch memory.
    """
    tree = tree_at(table)
    slack = np.float32(ROUNDINGS * size)
    for n in range(len(points)):
        x, far, count, height = _point(points, n), reach[n] * reach[n], 0, walk.begun(memory)
        ball = singles(x), slack, walk.rounded_up(far)
        while True:
            child, height = _next_in_ball(tree, memory, height, ball)
            if child >= 0:
                break
            leaf = leaf_of(child)
            bits = walk.lanes_in(child, _squared_distances(tree.blocks, leaf, x) <= far)
            while bits != 0:
                lane, bits = next_lane(bits)
                normal = _point(normals, leaf * LEAF + lane)
                if not dot(normal, normal) > 0.0:
                    continue
                if two_sided:
                    at = leaf * BLOCK + lane
                    corner = tree.blocks[at], tree.blocks[at + LEAF], tree.blocks[at + 2 * LEAF]
                    side = dot(minus(x, corner), normal)
                    normal = scaled(1.0 if side > 0.0 else -1.0 if side < 0.0 else 0.0, normal)
                near[count, 0], near[count, 1], near[count, 2] = normal
                count += 1
        answers[n] = count > 0 and _face_one_way(near, count, least, steps)


@njit()
def _face_one_way(normals, count, least, steps):
    """Return whether a direction is found along which all `count` normals face."""
    direction = 0.0, 0.0, 0.0
    for k in range(count):
        direction = plus(direction, _point(normals, k))
    for _ in range(steps):
        direction = scaled(1.0 / max(np.sqrt(dot(direction, direction)), 1e-300), direction)
        worst, lowest = 0, np.inf
        for k in range(count):
            common = dot(_point(normals, k), direction)
            if common < lowest:
                worst, lowest = k, common
        if lowest > least:
            return True
        direction = along(direction, 1.0, _point(normals, worst))
    return False


@inline
def _point(points, n):
    return points[n, 0], points[n, 1], points[n, 2]


@inline
def _squared_distances(blocks, leaf, x):
    """Squared distances of a point from the eight triangles of a leaf."""
    d = minus(nearest_on(walk.corners_of(blocks, leaf), x), x)
    return dot(d, d)
