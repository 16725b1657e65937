"""For large hulls, find the vertices that can be the farthest along a direction.

Directions are points on the surface of a cube. Each of its six faces is a square of cells, which are halved both ways
until few vertices can be the farthest along any direction of the cell. Such a cell is a leaf, which keeps copies of its
vertices as blocks (see `pieces.support`). A search descends a few levels and reads a few blocks, however many vertices
the hull has.

A vertex v is omitted from a cell only if one other vertex w beats it at all four corners. Then w beats v in the whole
cell, because (w - v)·n is linear in n. `CLEARANCE` keeps this true in floating point, both for the corner products and
for a direction that rounding puts into the neighbouring cell. The farthest vertex found is therefore the same as in a
search through all vertices.

The map of a hull is a flat array: the leaves' blocks, then the *nodes*, with two numbers each. For a leaf, these
numbers are its first and last+1 column; for an inner node, they are the number of its first child and -1. Nodes 0 .. 5
are the cube's faces +x, -x, +y, -y, +z, -z. The four children of a node are adjacent, with the first coordinate
changing fastest.
"""

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.columns import BLOCK, DEEPEST, GRID
from loewner._kernels.tolerances import UNIT_ROUNDOFF

LEAF = 32  # A cell with at most this number of vertices (four blocks) is not divided further.

# Division stops when the leaves hold more than this number of copies of each vertex on average; two or three copies are
# usual.
MOST_COPIES = 8

# Margin, as a share of the largest coordinate, by which another vertex must be farther before a cell omits a vertex. In
# units of this coordinate, the product of a vertex and a direction (with entries of at most 1) has an error of 9u.
# Rounding that moves a direction into a neighbouring cell changes two entries by 4u, and thus the difference between
# the products of two vertices by 16u.
CLEARANCE = 64.0 * UNIT_ROUNDOFF  # certified.md B18


@inline
def _direction(face, s, t):
    """Direction at the place (s, t) of a cube face, with s and t in -1 .. 1."""
    sign = 1.0 if face % 2 == 0 else -1.0
    if face < 2:
        return sign, s, t
    if face < 4:
        return s, sign, t
    return s, t, sign


@inline
def place(x, y, z):
    """Face of the cube through which a direction passes, and the grid cell there; any cell for a zero or NaN."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, major, s, t = 0, x, y, z
    elif ay >= az:
        face, major, s, t = 2, y, x, z
    else:
        face, major, s, t = 4, z, x, y
    if major < 0.0:
        face += 1
    scale = 0.5 * GRID / abs(major)
    s = s * scale + 0.5 * GRID
    t = t * scale + 0.5 * GRID
    # These comparisons turn a NaN into 0.
    s = s if s > 0.0 else 0.0
    t = t if t > 0.0 else 0.0
    return face, np.int64(min(s, GRID - 1.0)), np.int64(min(t, GRID - 1.0))


@inline
def candidates(points, first, nodes, x, y, z):
    """First and last+1 column of the vertices that can be the farthest along a direction.

    `first` is the first column of the hull's blocks, and `nodes` the entry at which its nodes start.
    """
    node, s, t = place(x, y, z)
    bit = DEEPEST
    while True:
        at = nodes + 2 * node
        if points[at + 1] >= 0.0:
            return first + np.int64(points[at]), first + np.int64(points[at + 1])
        bit -= 1
        node = np.int64(points[at]) + ((s >> bit) & 1) + 2 * ((t >> bit) & 1)


@njit()
def _corner(face, level, s, t, d, row):
    """Write the direction at a grid corner to a row of d."""
    cells = 1 << level
    d[row, 0], d[row, 1], d[row, 2] = _direction(face, 2.0 * s / cells - 1.0, 2.0 * t / cells - 1.0)


@njit()
def _filter(vertices, pool, start, stop, face, level, s, t, slack, d, heights, rivals):
    """Append to the pool all entries among start .. stop that may win in a cell; return the new end."""
    for c in range(4):
        _corner(face, level, s + c % 2, t + c // 2, d, c)
    for c in range(3):
        d[4, c] = 0.25 * (d[0, c] + d[1, c] + d[2, c] + d[3, c])
    rivals[:] = 0
    for m in range(stop - start):
        v = pool[start + m]
        for c in range(5):
            height = d[c, 0] * vertices[v, 0] + d[c, 1] * vertices[v, 1] + d[c, 2] * vertices[v, 2]
            heights[m, c] = height
            if height > heights[rivals[c], c]:
                rivals[c] = m
    end = stop
    for m in range(stop - start):
        beaten = False
        for r in range(5):
            w = rivals[r]
            beaten = beaten or (
                heights[w, 0] - heights[m, 0] > slack
                and heights[w, 1] - heights[m, 1] > slack
                and heights[w, 2] - heights[m, 2] > slack
                and heights[w, 3] - heights[m, 3] > slack
            )
        if not beaten:
            pool[end] = pool[start + m]
            end += 1
    return end


@njit()
def _grown(array, count):
    if count <= len(array):
        return array
    longer = np.empty(2 * count, array.dtype)
    for n in range(len(array)):
        longer[n] = array[n]
    return longer


@njit()
def direction_map(vertices):
    """Build the map of a hull's vertices, shape (v, 3).

    Returns
    -------
    columns : ndarray of int64, shape (c,)
        Vertices of the leaves in order; repeats of a leaf's last vertex fill its last block.
    nodes : ndarray, shape (n, 2)
    """
    largest = 0.0
    for v in range(len(vertices)):
        for axis in range(3):
            largest = max(largest, abs(vertices[v, axis]))
    return map_within(vertices, CLEARANCE * largest)


@apart
def map_within(vertices, slack):
    """Build the map, omitting from a cell the vertices that are beaten by more than `slack` [m] in the whole cell.

    The map is for directions whose largest entry is 1.
    """
    count = len(vertices)
    # The pool holds, one after another, the lists of vertices of the cells on the current path from the root.
    pool = np.empty((DEEPEST + 2) * count, np.int64)
    for v in range(count):
        pool[v] = v
    heights = np.empty((count, 5))
    d = np.empty((5, 3))
    rivals = np.empty(5, np.int64)
    columns = np.empty(4 * count, np.int64)
    used = 0
    nodes = np.empty(4 * count)
    node_count = 6
    # Each level of the current path has a row: number of the first child node; number of children already processed;
    # face; level, s and t of the first child; and in the pool, index of the first entry of the parent's list, and index
    # after its last entry.
    path = np.zeros((DEEPEST + 2, 8), np.int64)
    path[0, 7] = count
    depth = 0
    while depth >= 0:
        first, done, face, level, s, t, start, stop = path[depth]
        if done == (6 if depth == 0 else 4):
            depth -= 1
            continue
        path[depth, 1] += 1
        node = first + done
        if depth == 0:
            face = done
        else:
            s += done % 2
            t += done // 2
        end = _filter(vertices, pool, start, stop, face, level, s, t, slack, d, heights, rivals)
        if end - stop <= LEAF or level == DEEPEST or used > MOST_COPIES * count:
            blocks = (end - stop + BLOCK - 1) // BLOCK
            columns = _grown(columns, used + blocks * BLOCK)
            for m in range(blocks * BLOCK):
                columns[used + m] = pool[min(stop + m, end - 1)]
            nodes[2 * node] = used
            used += blocks * BLOCK
            nodes[2 * node + 1] = used
            continue
        nodes = _grown(nodes, 2 * (node_count + 4))
        nodes[2 * node] = node_count
        nodes[2 * node + 1] = -1.0
        depth += 1
        path[depth, 0], path[depth, 1], path[depth, 2], path[depth, 3] = node_count, 0, face, level + 1
        path[depth, 4], path[depth, 5], path[depth, 6], path[depth, 7] = 2 * s, 2 * t, stop, end
        node_count += 4
    table = np.empty((node_count, 2))
    for node in range(node_count):
        table[node, 0], table[node, 1] = nodes[2 * node], nodes[2 * node + 1]
    return columns[:used].copy(), table
