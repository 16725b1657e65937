"""Distances of many points from a mesh, winding numbers around them, and orientations of nearby triangles.

The tree is in the frame of the points. Boxes are tested in single precision, with a slack for its rounding, and
triangles eight at a time. A distance belongs to the nearest point of the triangle up to rounding, however thin the
triangle is: its error is a few roundoffs of the coordinates (certified.md B44).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.linalg3 import along, dot, minus, plus, scaled
from loewner._kernels.narrow.surface_boxes import ROUNDINGS, boxes_of, squared_gap, tree_at
from loewner._kernels.narrow.surface_distance import BELIEVED, push_near, rounded_up
from loewner._kernels.narrow.surfaces import STACK, winding_number
from loewner._kernels.narrow.triangles import nearest_on
from loewner._kernels.simd.memory import floats_at, integers_at
from loewner._kernels.simd.vectors import load, lowest_bit, movemask, store
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, WIDE, leaf_of, size_of

# Memory: a stack, a lower bound for each of its entries, and bounds of a node.
_BOUNDS = 8 * STACK
_LANES = _BOUNDS + 8 * STACK
SIZE = _LANES + 8 * 2 * WIDE  # bytes


@njit()
def points_memory():
    """Number of bytes that the functions below need."""
    return SIZE


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
        p = nearest_on(
            ((t[0, 0], t[0, 1], t[0, 2]), (t[1, 0], t[1, 1], t[1, 2]), (t[2, 0], t[2, 1], t[2, 2])),
            x,
        )
        d = minus(p, x)
        squared[n] = dot(d, d)


@njit()
def nearest_triangles(table, size, points, distances, places, memory):
    """Distances of points from a mesh, and the nearest triangles.

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
    tree = tree_at(table)
    slack = np.float32(ROUNDINGS * size)
    stack, bounds = integers_at(memory, (STACK,)), floats_at(memory + _BOUNDS, (STACK,))
    lanes = floats_at(memory + _LANES, (2 * WIDE,))
    for n in range(len(points)):
        x = _point(points, n)
        single = np.float32(x[0]), np.float32(x[1]), np.float32(x[2])
        best, place = np.inf, 0
        stack[0], stack[1], bounds[0] = 0, 0, 0.0
        height = 1
        while height > 0:
            height -= 1
            if bounds[2 * height] * BELIEVED > best:
                continue
            child = tree.children[stack[2 * height]]
            if child >= 0:
                middles, halves = boxes_of(tree.boxes, child)
                t = minus(middles, single)
                gaps, none = squared_gap(t, halves, (slack, slack, slack)), 0
                height = push_near(stack, bounds, lanes, height, gaps, t, halves, best, child, none, True)
                continue
            leaf = leaf_of(child)
            squared = _squared_distances(tree.blocks, leaf, x)
            bits = movemask(squared < best) & ((1 << size_of(child)) - 1)
            if bits == 0:
                continue
            store(lanes, 0, squared)
            while bits != 0:
                lane = lowest_bit(bits)
                bits &= bits - 1
                if lanes[lane] < best:
                    best, place = lanes[lane], leaf * LEAF + lane
        distances[n], places[n] = np.sqrt(best), place


@njit()
def winding_numbers(table, size, points, numbers, memory):
    """Winding numbers of a mesh around points, from the crossings of rays; UNCOUNTED if no ray gives an answer.

    Parameters are as for `nearest_triangles`.
    """
    tree = tree_at(table)
    for n in range(len(points)):
        numbers[n] = winding_number(tree, _point(points, n), size, memory)


@njit()
def facing_one_way(table, size, points, reach, normals, two_sided, least, steps, answers, near, memory):
    """Whether the outer sides of all triangles within reach of a point face one half-space.

    Parameters
    ----------
    table, size, points, memory
        As for `nearest_triangles`.
    reach : ndarray, shape (n,)
    normals : ndarray, shape (places, 3)
        Normals of the triangles, in the order of the tree's blocks; triangles without one do not count.
    two_sided : bool
        Whether the outer side of a triangle is the point's side.
    least : float
        Least product of a normal with a direction for the normal to face along it.
    steps : int
        Number of steps of the search for this direction.
    answers : ndarray of bool, shape (n,)
        Receives the answers, which are false for a point without a triangle in reach.
    near : ndarray, shape (triangles, 3)
        Scratch memory.
    """
    tree = tree_at(table)
    slack = np.float32(ROUNDINGS * size)
    stack = integers_at(memory, (STACK,))
    for n in range(len(points)):
        x, far = _point(points, n), reach[n] * reach[n]
        single, far_single = (np.float32(x[0]), np.float32(x[1]), np.float32(x[2])), rounded_up(far)
        found, height = 0, 1
        stack[0] = 0
        while height > 0:
            height -= 1
            child = tree.children[stack[height]]
            if child >= 0:
                middles, halves = boxes_of(tree.boxes, child)
                gaps = squared_gap(minus(middles, single), halves, (slack, slack, slack))
                bits = movemask((gaps <= far_single) & (halves[0] >= np.float32(0.0)))
                while bits != 0:
                    stack[height] = child * WIDE + lowest_bit(bits)
                    height += 1
                    bits &= bits - 1
                continue
            leaf = leaf_of(child)
            bits = movemask(_squared_distances(tree.blocks, leaf, x) <= far) & ((1 << size_of(child)) - 1)
            while bits != 0:
                lane = lowest_bit(bits)
                bits &= bits - 1
                normal = _point(normals, leaf * LEAF + lane)
                if not dot(normal, normal) > 0.0:
                    continue
                if two_sided:
                    at = leaf * BLOCK + lane
                    corner = tree.blocks[at], tree.blocks[at + LEAF], tree.blocks[at + 2 * LEAF]
                    side = dot(minus(x, corner), normal)
                    normal = scaled(1.0 if side > 0.0 else -1.0 if side < 0.0 else 0.0, normal)
                near[found, 0], near[found, 1], near[found, 2] = normal
                found += 1
        answers[n] = found > 0 and _face_one_way(near, found, least, steps)


@njit()
def _face_one_way(normals, count, least, steps):
    """Whether a direction is found along which all of some normals face."""
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
    at = leaf * BLOCK
    p = nearest_on(
        (
            (load(blocks, at), load(blocks, at + LEAF), load(blocks, at + 2 * LEAF)),
            (load(blocks, at + 3 * LEAF), load(blocks, at + 4 * LEAF), load(blocks, at + 5 * LEAF)),
            (load(blocks, at + 6 * LEAF), load(blocks, at + 7 * LEAF), load(blocks, at + 8 * LEAF)),
        ),
        x,
    )
    d = minus(p, x)
    return dot(d, d)
