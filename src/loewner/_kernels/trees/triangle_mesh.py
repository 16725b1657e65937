"""Equal vertices and connected parts of a mesh."""

import numpy as np

from loewner._kernels._jit import inline, njit


@njit()
def equal_vertices(vertices):
    """Number the distinct points among vertices, in order of first appearance.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Vertices without negative zeros.

    Returns
    -------
    count : int
    number : ndarray of int64, shape (V,)
    """
    room = 16
    while room < 2 * len(vertices):
        room *= 2
    bits = vertices.view(np.int64)
    table = np.full(room, -1, np.int64)
    number = np.empty(len(vertices), np.int64)
    count = 0
    for v in range(len(vertices)):
        key = _mixed(bits[v, 0], _mixed(bits[v, 1], _mixed(bits[v, 2], np.uint64(0))))
        place = np.int64(key & np.uint64(room - 1))
        while True:
            other = table[place]
            if other < 0:
                table[place] = v
                number[v] = count
                count += 1
                break
            if bits[other, 0] == bits[v, 0] and bits[other, 1] == bits[v, 1] and bits[other, 2] == bits[v, 2]:
                number[v] = number[other]
                break
            place = (place + 1) & (room - 1)
    return count, number


@inline
def _mixed(word, key):
    """Mix 64 bits into a hash (the finaliser of SplitMix64)."""
    key = np.uint64(word) ^ (key * np.uint64(0x9E3779B97F4A7C15))
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return key ^ (key >> np.uint64(31))


@njit()
def part_vertices(count, triangles):
    """Return one vertex of each connected part.

    Parameters
    ----------
    count : int
        Number of vertices; vertices without a triangle are in no part.
    triangles : ndarray of int64, shape (T, 3)

    Returns
    -------
    ndarray of int64, shape (parts,)
    """
    parent = np.arange(count)
    for t in range(len(triangles)):
        a = _root(parent, triangles[t, 0])
        for corner in range(1, 3):
            b = _root(parent, triangles[t, corner])
            if a != b:
                parent[max(a, b)] = min(a, b)
                a = min(a, b)
    seen = np.zeros(count, np.bool_)
    vertices = np.empty(count, np.int64)
    parts = 0
    for t in range(len(triangles)):
        root = _root(parent, triangles[t, 0])
        if not seen[root]:
            seen[root] = True
            vertices[parts] = root
            parts += 1
    return vertices[:parts].copy()


@inline
def _root(parent, v):
    while parent[v] != v:
        parent[v] = parent[parent[v]]
        v = parent[v]
    return v
