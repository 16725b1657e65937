"""Bounding hierarchies over the triangles of a surface: wide nodes of boxes, and leaves that are blocks of triangles.

A node has sixteen boxes side by side, in six rows of single precision: their middles, then their half widths, along x,
y and z of the body's frame. Both are rounded outward. Box s, counted over all nodes, leads to ``children[s]``, which is
a node if it is not negative. A negative entry encodes a leaf, `leaf_of`, and the leaf's number of triangles, `size_of`.
Node 0 has one box, around everything. A leaf is a block of eight triangles, in nine rows of double precision: x, y, z
of the first, the second and the third corners. Repeats of the last triangle fill a block.

Each box has twenty additional rows of single precision, the diagonals: the extents of its triangles along x + y, x - y,
-x + y and -x - y, likewise for x and z and for y and z, and along x + y + z, x + y - z and so on to -x - y - z.
Together with the box, the diagonals bound the extent along any direction. Any direction is a sum of multiples of an
axis and two diagonals; the order of its coordinates decides which. The support function of a sum is at most the sum of
the support functions.

The boxes of the top node also have ellipsoids around the same triangles, computed from the covariance of the corners.
They take nine rows of single precision: their centers, and the roots of their shape matrices (xx, xy, xz, yy, yz, zz).

The tree is built from the top by the surface area heuristic.

References
----------
Klosowski and others, "Efficient collision detection using bounding volume hierarchies of k-DOPs" (1998),
doi:10.1109/2945.675649. Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007),
doi:10.1109/RT.2007.4342588.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import NODE_BITS
from loewner._kernels.linalg3 import minus, negated, plus
from loewner._kernels.simd.vectors import broadcast, highest, load, lowest, maximum, minimum, store

WIDE_BITS, LEAF_BITS = NODE_BITS, 3
WIDE = 1 << WIDE_BITS  # Number of boxes in a node.
ROWS = 6 * WIDE  # Number of entries of `boxes` for each node.
LEAF = 1 << LEAF_BITS  # Maximum number of triangles in a leaf.
BLOCK = 9 * LEAF  # Number of entries of `blocks` for each leaf.
DIAGONALS = 20 * WIDE  # Number of entries of `diagonals` for each node.
CORNERS = 12  # Number of the row for x + y + z among the diagonals.
OVAL = 9 * WIDE  # Number of entries of `ellipsoids`.

# Number of entries for a box while the tree is built: its lower corner, its negated upper corner, and two zeros.
BOX = 8

BINS, FEW_BINS, MANY = 16, 8, 256  # Numbers of bins: BINS for ranges of more than MANY triangles, otherwise FEW_BINS.
DEEP = 40  # Number of splits after which ranges are only halved, so that no tree is deeper than LEVELS.
LEVELS = DEEP + 28  # Maximum depth of a tree. The last 28 levels are enough to halve 2^31 triangles down to leaves.

MOST_BELOW = 80  # Maximum number of triangles below a node for which all or nearly all boxes of the node are leaves.

# FLATTEST is the least thickness of an ellipsoid, relative to its length. WIDER is the factor by which an ellipsoid is
# larger than the enclosed corners require, because rounding to single precision can turn the ellipsoid by about 1e-7
# rad.
FLATTEST = 1e-6
WIDER = 1.0 + 1e-5

# Largest allowed semi-axis of an ellipsoid, relative to the radius of the ball around the same corners. If a semi-axis
# is longer, the ball replaces the ellipsoid.
MOST_WIDE = 2.0

# SWEEPS is the number of sweeps of Jacobi's method, which converges quadratically. SMALL is the size, relative to the
# diagonal, up to which other entries are ignored, because the axes need not be exact.
SWEEPS, SMALL = 3, 1e-13

UP = 1.0 + 2.0**-22  # Factor that is large enough to cover the error of rounding to single precision.
_LEAST = 1e-37  # Summand that is large enough to cover the error of rounding numbers near zero.


@inline
def leaf_of(child):
    """Number of the block that a negative entry of `children` encodes."""
    return ~child >> LEAF_BITS


@inline
def size_of(child):
    """Number of triangles that a negative entry of `children` encodes."""
    return (~child & (LEAF - 1)) + 1


@inline
def _high(x):
    return np.float32(x + abs(x) * 2.0**-23 + _LEAST)


@njit()
def triangle_tree(vertices, triangles):
    """Build the tree.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Vertices in metres.
    triangles : ndarray of int64, shape (T, 3)
        At least one triangle.

    Returns
    -------
    boxes : ndarray
        ROWS numbers for each node; every number is exact in single precision.
    children : ndarray of int64
        WIDE entries for each node.
    blocks : ndarray
        BLOCK numbers for each leaf.
    diagonals : ndarray
        DIAGONALS numbers for each node, also exact in single precision.
    ellipsoids : ndarray
        OVAL numbers, also exact in single precision.
    numbers : ndarray of int64
        LEAF entries for each leaf: the triangles in its block.
    """
    count = triangles.shape[0]
    box, order = np.empty(BOX * count), np.arange(count)
    for t in range(count):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for axis in range(3):
            x, y, z = vertices[a, axis], vertices[b, axis], vertices[c, axis]
            box[BOX * t + axis] = min(x, min(y, z))
            box[BOX * t + 3 + axis] = -max(x, max(y, z))
        box[BOX * t + 6] = box[BOX * t + 7] = 0.0
    bins = np.empty(2 * 3 * BINS * BOX), np.empty(3 * BINS, np.int64)
    # Each row describes a range: the first triangle, the end, and the number of splits above.
    ranges = np.empty((WIDE, 3), np.int64)
    hull = np.empty(WIDE * BOX)
    room = 4 + count // 24
    boxes, children = np.zeros(room * ROWS), np.zeros(room * WIDE, np.int64)
    ellipsoids = np.zeros(OVAL)
    leaf_from = np.empty(4 + count // 4, np.int64)
    nodes, leaves = 1, 0
    # Each row describes a range as in `ranges`, followed by the index of the range's entry in `children`.
    waiting = np.empty((LEVELS * WIDE, 4), np.int64)
    _clear(boxes, 0)
    _hull(box, 0, count, hull, 0)
    _write(boxes, 0, hull, 0)
    turns = np.empty((2, 3, 3))
    _enclose(vertices, triangles, order, 0, count, turns, ellipsoids, 0)
    put_range(waiting, 0, 0, count, 0)
    waiting[0, 3] = 0
    left = 1
    while left > 0:
        left -= 1
        first, last, splits, slot = waiting[left, 0], waiting[left, 1], waiting[left, 2], waiting[left, 3]
        if last - first <= LEAF:
            if leaves == len(leaf_from):
                leaf_from = longer(leaf_from)
            children[slot] = ~(leaves << LEAF_BITS | (last - first - 1))
            leaf_from[leaves] = first
            leaves += 1
            continue
        if (nodes + 1) * WIDE > len(children):
            boxes, children = longer(boxes), longer(children)
        children[slot] = nodes
        enough = _enough(last - first)
        put_range(ranges, 0, first, last, splits)
        _hull(box, first, last, hull, 0)
        used = 1
        while used < WIDE:
            widest = -1
            area = -1.0
            for k in range(used):
                if ranges[k, 1] - ranges[k, 0] > enough and _area(hull, k) > area:
                    widest, area = k, _area(hull, k)
            if widest < 0:
                break
            begin, end, above = ranges[widest, 0], ranges[widest, 1], ranges[widest, 2]
            middle = _split(box, order, begin, end, above >= DEEP, bins)
            put_range(ranges, widest, begin, middle, above + 1)
            put_range(ranges, used, middle, end, above + 1)
            _hull(box, begin, middle, hull, widest)
            _hull(box, middle, end, hull, used)
            used += 1
        _clear(boxes, nodes)
        for k in range(used):
            _write(boxes, nodes * ROWS + k, hull, k)
            if nodes == 1:
                _enclose(vertices, triangles, order, ranges[k, 0], ranges[k, 1], turns, ellipsoids, k)
            put_range(waiting, left, ranges[k, 0], ranges[k, 1], ranges[k, 2])
            waiting[left, 3] = nodes * WIDE + k
            left += 1
        nodes += 1
    blocks, numbers = np.empty(leaves * BLOCK), np.empty(leaves * LEAF, np.int64)
    for slot in range(nodes * WIDE):
        child = children[slot]
        if child >= 0:
            continue
        leaf, size = leaf_of(child), size_of(child)
        for lane in range(LEAF):
            t = order[leaf_from[leaf] + min(lane, size - 1)]
            numbers[leaf * LEAF + lane] = t
            for corner in range(3):
                for axis in range(3):
                    at = leaf * BLOCK + (3 * corner + axis) * LEAF + lane
                    blocks[at] = vertices[triangles[t, corner], axis]
    boxes, children = boxes[: nodes * ROWS].copy(), children[: nodes * WIDE].copy()
    return boxes, children, blocks, _diagonals(boxes, children, blocks), ellipsoids, numbers


@njit()
def _diagonals(boxes, children, blocks):
    """Compute the diagonals of all boxes, from the last node to the first: children come after parents."""
    diagonals = np.empty(len(boxes) // ROWS * DIAGONALS)
    for n in range(len(diagonals)):
        diagonals[n] = 0.0
    for slot in range(len(children) - 1, -1, -1):
        if not boxes[(slot >> WIDE_BITS) * ROWS + 3 * WIDE + (slot & (WIDE - 1))] >= 0.0:
            continue  # The box is empty.
        at, child = (slot >> WIDE_BITS) * DIAGONALS + (slot & (WIDE - 1)), children[slot]
        if child >= 0:
            for row in range(0, DIAGONALS, WIDE):
                most = -np.inf
                for lane in range(WIDE):
                    if boxes[child * ROWS + 3 * WIDE + lane] >= 0.0:
                        most = max(most, diagonals[child * DIAGONALS + row + lane])
                diagonals[at + row] = most
            continue
        leaf = leaf_of(child) * BLOCK
        x = load(blocks, leaf), load(blocks, leaf + 3 * LEAF), load(blocks, leaf + 6 * LEAF)
        y = load(blocks, leaf + LEAF), load(blocks, leaf + 4 * LEAF), load(blocks, leaf + 7 * LEAF)
        z = load(blocks, leaf + 2 * LEAF), load(blocks, leaf + 5 * LEAF), load(blocks, leaf + 8 * LEAF)
        back = negated(z)
        sums, differences = plus(x, y), minus(x, y)
        _write_diagonal(diagonals, at, 0, 3, sums)
        _write_diagonal(diagonals, at, 1, 2, differences)
        _write_diagonal(diagonals, at, 4, 7, plus(x, z))
        _write_diagonal(diagonals, at, 5, 6, plus(x, back))
        _write_diagonal(diagonals, at, 8, 11, plus(y, z))
        _write_diagonal(diagonals, at, 9, 10, plus(y, back))
        _write_diagonal(diagonals, at, 12, 19, plus(sums, z))
        _write_diagonal(diagonals, at, 13, 18, plus(sums, back))
        _write_diagonal(diagonals, at, 14, 17, plus(differences, z))
        _write_diagonal(diagonals, at, 15, 16, plus(differences, back))
    return diagonals


@inline
def _write_diagonal(diagonals, at, row, opposite, sums):
    """Write the extents of three corners of eight triangles along a diagonal, and in the opposite direction."""
    most = highest(maximum(maximum(sums[0], sums[1]), sums[2]))
    least = lowest(minimum(minimum(sums[0], sums[1]), sums[2]))
    diagonals[at + row * WIDE], diagonals[at + opposite * WIDE] = float(_high(most)), float(_high(-least))


@njit()
def _enough(count):
    """Number of triangles to put in each box of a node, so that all levels below are filled evenly."""
    levels = 0
    held = float(MOST_BELOW)
    while held < count:
        held *= WIDE
        levels += 1
    if levels == 0:
        return LEAF
    parts = max(2.0, np.ceil((count / MOST_BELOW) ** (1.0 / levels)))
    return int(np.ceil(count / parts))


@njit()
def longer(array):
    """Return a copy of the array with twice the room."""
    more = np.zeros(2 * len(array), array.dtype)
    for n in range(len(array)):
        more[n] = array[n]
    return more


@njit()
def _clear(boxes, node):
    """Make the boxes of a node empty, so that they meet nothing."""
    for n in range(3 * WIDE):
        boxes[node * ROWS + n] = 0.0
        boxes[node * ROWS + 3 * WIDE + n] = -np.inf


@njit()
def _write(boxes, at, hull, k):
    """Write row k of `hull` as the box at an entry of `boxes`, rounded outward."""
    for axis in range(3):
        low, high = hull[BOX * k + axis], -hull[BOX * k + 3 + axis]
        middle = float(np.float32(0.5 * low + 0.5 * high))
        boxes[at + axis * WIDE] = middle
        boxes[at + (3 + axis) * WIDE] = float(np.float32(max(high - middle, middle - low) * UP + _LEAST))


@njit()
def _enclose(vertices, triangles, order, first, last, turns, ellipsoids, at):
    """Write the ellipsoid of the covariance of given triangles' corners, scaled to contain all the corners."""
    count = 3.0 * (last - first)
    x = y = z = 0.0
    for n in range(first, last):
        for corner in range(3):
            v = triangles[order[n], corner]
            x, y, z = x + vertices[v, 0], y + vertices[v, 1], z + vertices[v, 2]
    # Use the center as it is stored, so that its rounding has no effect.
    x, y, z = float(np.float32(x / count)), float(np.float32(y / count)), float(np.float32(z / count))
    xx = xy = xz = yy = yz = zz = radius = 0.0
    for n in range(first, last):
        for corner in range(3):
            v = triangles[order[n], corner]
            p, q, r = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
            radius = max(radius, p * p + q * q + r * r)
            xx, xy, xz, yy, yz, zz = xx + p * p, xy + p * q, xz + p * r, yy + q * q, yz + q * r, zz + r * r
    radius = np.sqrt(radius) + _LEAST
    U, spread = principal(xx / count, xy / count, xz / count, yy / count, yz / count, zz / count, turns)
    # The half widths along the axes need not be accurate, because they are scaled below. Even a direction in which the
    # corners have no width gets the least thickness.
    least = FLATTEST * np.sqrt(max(spread[0], max(spread[1], spread[2]))) + _LEAST
    a, b, c = (
        np.sqrt(max(spread[0], 0.0)) + least, np.sqrt(max(spread[1], 0.0)) + least, np.sqrt(max(spread[2], 0.0)) + least
    )  # fmt: skip
    farthest = 0.0
    for n in range(first, last):
        for corner in range(3):
            v = triangles[order[n], corner]
            p, q, r = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
            s = (U[0] * p + U[3] * q + U[6] * r) / a
            t = (U[1] * p + U[4] * q + U[7] * r) / b
            u = (U[2] * p + U[5] * q + U[8] * r) / c
            farthest = max(farthest, s * s + t * t + u * u)
    scale = np.sqrt(farthest) * WIDER
    a, b, c = a * scale, b * scale, c * scale
    if not max(a, max(b, c)) <= MOST_WIDE * radius:
        # This happens if a few corners are far from all other corners.
        a = b = c = radius * WIDER
    ellipsoids[at], ellipsoids[at + WIDE], ellipsoids[at + 2 * WIDE] = x, y, z
    row = 3
    for i in range(3):
        for j in range(i, 3):
            entry = U[3 * i] * U[3 * j] * a + U[3 * i + 1] * U[3 * j + 1] * b + U[3 * i + 2] * U[3 * j + 2] * c
            ellipsoids[at + row * WIDE] = float(np.float32(entry))
            row += 1


@inline
def put_range(ranges, k, first, last, number):
    """Write a range of triangles and a number into row k.

    An assignment to the whole row would take Numba a second, because Numba would compile the text of an error for rows
    of another length.
    """
    ranges[k, 0], ranges[k, 1], ranges[k, 2] = first, last, number


@njit()
def principal(xx, xy, xz, yy, yz, zz, turns):
    """Principal axes of a symmetric matrix, as the columns of nine numbers in row order, and its values along them.

    The method uses Jacobi rotations; Golub and Van Loan, Matrix Computations (2013), section 8.5.
    """
    A, U = turns[0], turns[1]
    A[0, 0], A[1, 1], A[2, 2] = xx, yy, zz
    A[0, 1], A[0, 2], A[1, 2] = xy, xz, yz
    A[1, 0], A[2, 0], A[2, 1] = xy, xz, yz
    for i in range(3):
        for j in range(3):
            U[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        for turn in range(3):
            i, j = (0, 1) if turn == 0 else (0, 2) if turn == 1 else (1, 2)
            if abs(A[i, j]) <= SMALL * (A[i, i] + A[j, j]):
                continue
            slope = (A[j, j] - A[i, i]) / (2.0 * A[i, j])
            t = np.copysign(1.0, slope) / (abs(slope) + np.sqrt(1.0 + slope * slope))
            c = 1.0 / np.sqrt(1.0 + t * t)
            s = t * c
            for k in range(3):
                A[k, i], A[k, j] = c * A[k, i] - s * A[k, j], s * A[k, i] + c * A[k, j]
            for k in range(3):
                A[i, k], A[j, k] = c * A[i, k] - s * A[j, k], s * A[i, k] + c * A[j, k]
            for k in range(3):
                U[k, i], U[k, j] = c * U[k, i] - s * U[k, j], s * U[k, i] + c * U[k, j]
    return (
        (U[0, 0], U[0, 1], U[0, 2], U[1, 0], U[1, 1], U[1, 2], U[2, 0], U[2, 1], U[2, 2]),
        (A[0, 0], A[1, 1], A[2, 2]),
    )


@inline
def _hull(box, first, last, hull, k):
    """Write the box around boxes first .. last to row k."""
    around = load(box, BOX * first)
    for n in range(first + 1, last):
        around = minimum(around, load(box, BOX * n))
    store(hull, BOX * k, around)


@inline
def _area(hull, k):
    """Half the surface area of a box."""
    at = BOX * k
    x, y, z = -hull[at + 3] - hull[at], -hull[at + 4] - hull[at + 1], -hull[at + 5] - hull[at + 2]
    return x * y + y * z + z * x


@inline
def _swap(box, order, i, j):
    order[i], order[j] = order[j], order[i]
    one, other = load(box, BOX * i), load(box, BOX * j)
    store(box, BOX * i, other)
    store(box, BOX * j, one)


@inline
def _middle(box, n, axis):
    """Twice a coordinate of the middle of a box."""
    return box[BOX * n + axis] - box[BOX * n + 3 + axis]


@njit()
def _split(box, order, first, last, halve, bins):
    """Split boxes first .. last at least cost by the surface area heuristic; return the start of the second part.

    With `halve`, both parts are equally large.
    """
    low, high = np.empty(3), np.empty(3)
    for axis in range(3):
        low[axis] = high[axis] = _middle(box, first, axis)
    for n in range(first + 1, last):
        for axis in range(3):
            middle = _middle(box, n, axis)
            low[axis], high[axis] = min(low[axis], middle), max(high[axis], middle)
    longest = 0
    for axis in range(1, 3):
        if high[axis] - low[axis] > high[longest] - low[longest]:
            longest = axis
    if not high[longest] > low[longest]:
        return (first + last) // 2
    if halve or last - first <= 2 * LEAF:
        return _split_by_rank(box, order, first, last, longest, halve)
    used = BINS if last - first > MANY else FEW_BINS
    scale = np.empty(3)
    for axis in range(3):
        scale[axis] = used / (high[axis] - low[axis])
        if not scale[axis] < np.inf:
            scale[axis] = 0.0  # If the middles coincide, or the quotient overflows, all boxes go to one bin.
    axis, best = _best_split(box, first, last, low, scale, used, bins)
    if axis < 0:  # All boxes are in one bin, or an overflow occurred.
        return _split_by_rank(box, order, first, last, longest, True)
    i, j = first, last
    while True:
        while i < j and _bin(box, i, axis, low, scale, used) < best:
            i += 1
        while i < j and _bin(box, j - 1, axis, low, scale, used) >= best:
            j -= 1
        if i >= j:
            return i
        _swap(box, order, i, j - 1)


@njit()
def _best_split(box, first, last, low, scale, used, bins):
    """Axis and bin at which splitting the boxes costs least; -1 if no split is possible."""
    boxes, held = bins
    nothing = broadcast(np.inf)
    for axis in range(3):
        for row in range(axis * BINS, axis * BINS + used):
            store(boxes, BOX * row, nothing)
            held[row] = 0
    for n in range(first, last):
        own = load(box, BOX * n)
        for axis in range(3):
            row = axis * BINS + _bin(box, n, axis, low, scale, used)
            store(boxes, BOX * row, minimum(own, load(boxes, BOX * row)))
            held[row] += 1
    best_axis, best_bin, least = -1, 0, np.inf
    above = 3 * BINS  # If k > 0, row above + k holds the box around the contents of bins k and higher.
    for axis in range(3):
        around = nothing
        for k in range(used - 1, 0, -1):
            around = minimum(around, load(boxes, BOX * (axis * BINS + k)))
            store(boxes, BOX * (above + k), around)
        around, below = nothing, 0
        for k in range(1, used):
            row = axis * BINS + k - 1
            around, below = minimum(around, load(boxes, BOX * row)), below + held[row]
            store(boxes, BOX * above, around)
            if below == 0 or below == last - first:
                continue
            cost = _area(boxes, above) * below + _area(boxes, above + k) * (last - first - below)
            if cost < least:
                best_axis, best_bin, least = axis, k, cost
    return best_axis, best_bin


@inline
def _bin(box, n, axis, low, scale, used):
    return min(used - 1, int((_middle(box, n, axis) - low[axis]) * scale[axis]))


@njit()
def _split_by_rank(box, order, first, last, axis, halve):
    """Split boxes by their middles along an axis: into equal parts, or into two leaves at least cost."""
    # Shell's sort needs the least code; the ranges that are sorted here are either short or pathological.
    gap = 1
    while gap < (last - first) // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for n in range(first + gap, last):
            m = n
            while m - gap >= first and _middle(box, m - gap, axis) > _middle(box, m, axis):
                _swap(box, order, m - gap, m)
                m -= gap
        gap //= 3
    if halve:
        return (first + last) // 2
    hull = np.empty(2 * BOX)
    best, least = (first + last) // 2, np.inf
    for middle in range(max(first + 1, last - LEAF), min(last - 1, first + LEAF) + 1):
        _hull(box, first, middle, hull, 0)
        _hull(box, middle, last, hull, 1)
        cost = _area(hull, 0) * (middle - first) + _area(hull, 1) * (last - middle)
        if cost < least:
            best, least = middle, cost
    return best
