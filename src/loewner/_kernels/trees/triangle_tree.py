"""Bounding hierarchies over the triangles of a surface: wide nodes of boxes, leaves that are blocks of triangles.

A node has sixteen boxes side by side, six rows of single precision: their middles, then their half widths, both along
x, y and z of the body's frame and rounded outward. Box s, counted over all nodes, leads to ``children[s]``: a node if
that is not negative, else a leaf, `leaf_of` of it and how many triangles it has. Node 0 has one box, around everything.
A leaf is a block of eight triangles, nine rows of double precision: x, y, z of the first corners, of the second and of
the third. The last triangle fills up a block.

Each box has an ellipsoid as well, around the same triangles: nine rows of single precision, its center and the root of
its shape matrix (xx, xy, xz, yy, yz, zz). Patches of a surface are flat and lie askew, where boxes are thick: the
ellipsoid is that of the corners' covariance, as thin as they are along any direction.

The tree is built from the top by the surface area heuristic.

References
----------
Wald, "On fast construction of SAH-based bounding volume hierarchies" (2007), doi:10.1109/RT.2007.4342588.
"""

import numpy as np

from loewner._kernels._jit import inline, njit

WIDE = 16  # boxes of a node
ROWS = 6 * WIDE  # numbers of a node
LEAF = 8  # triangles of a leaf at most
BLOCK = 9 * LEAF  # numbers of a leaf
OVAL = 9 * WIDE  # numbers of a node's ellipsoids

BINS, FEW_BINS, MANY = 16, 8, 256  # the fewer for so many triangles or less
DEEP = 40  # splits above a range from which on ranges are halved, so that no tree is deeper than LEVELS
LEVELS = DEEP + 28  # 2^31 triangles, halved down to leaves

FULL = 80  # triangles below a node whose boxes are all leaves, or nearly

# An ellipsoid is at least this thin, relative to its width, and this much wider than its corners; single precision can
# turn it by a part in ten million.
FLATTEST = 1e-6
WIDER = 1.0 + 1e-5

# No semi-axis is longer than this many times the radius of a ball around the same corners.
MOST_WIDE = 2.0

# Of Jacobi's rotations, which converge quadratically; and entries not worth one. The axes need not be exact.
SWEEPS, SMALL = 3, 1e-13

UP = 1.0 + 2.0**-22  # more than what rounding to single precision takes
_LEAST = 1e-37  # the same for numbers near zero


@inline
def leaf_of(child):
    """Which block a negative entry of `children` is."""
    return ~child >> 3


@inline
def size_of(child):
    """How many triangles it has."""
    return (~child & 7) + 1


@inline
def _low(x):
    return np.float32(x - abs(x) * 2.0**-23 - _LEAST)


@inline
def _high(x):
    return np.float32(x + abs(x) * 2.0**-23 + _LEAST)


@njit()
def triangle_tree(vertices, triangles):
    """Build the tree.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        In metres.
    triangles : ndarray of int64, shape (T, 3)
        At least one.

    Returns
    -------
    boxes : ndarray
        ROWS for each node; every number is one of single precision.
    children : ndarray of int64
        WIDE for each node.
    blocks : ndarray
        BLOCK for each leaf.
    ellipsoids : ndarray
        OVAL for each node, of single precision likewise.
    """
    count = triangles.shape[0]
    box, order = np.empty((count, 6), np.float32), np.arange(count)
    for t in range(count):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for axis in range(3):
            x, y, z = vertices[a, axis], vertices[b, axis], vertices[c, axis]
            box[t, axis] = _low(min(x, min(y, z)))
            box[t, 3 + axis] = _high(max(x, max(y, z)))
    scratch = np.empty((2 * 3 * BINS, 7), np.float32)
    ranges = np.empty((WIDE, 4), np.int64)  # from, to, splits above, whether the node is done with it
    hull = np.empty((WIDE, 6), np.float32)
    room = 4 + count // 24
    boxes, children = np.zeros(room * ROWS), np.zeros(room * WIDE, np.int64)
    ellipsoids = np.zeros(room * OVAL)
    leaf_from = np.empty(4 + count // 4, np.int64)
    nodes, leaves = 1, 0
    waiting = np.empty((LEVELS * WIDE, 4), np.int64)  # from, to, splits above, where the child is to be written
    _clear(boxes, 0)
    _hull(box, 0, count, hull, 0)
    _write(boxes, 0, hull, 0)
    turns = np.empty((2, 3, 3))
    _enclose(vertices, triangles, order, 0, count, turns, ellipsoids, 0)
    waiting[0] = (0, count, 0, 0)
    left = 1
    while left > 0:
        left -= 1
        first, last, splits, slot = waiting[left, 0], waiting[left, 1], waiting[left, 2], waiting[left, 3]
        if last - first <= LEAF:
            if leaves == len(leaf_from):
                leaf_from = _longer(leaf_from)
            children[slot] = ~(leaves << 3 | (last - first - 1))
            leaf_from[leaves] = first
            leaves += 1
            continue
        if (nodes + 1) * WIDE > len(children):
            boxes, children, ellipsoids = _longer(boxes), _longer(children), _longer(ellipsoids)
        children[slot] = nodes
        enough = _enough(last - first)
        ranges[0] = (first, last, splits, 0)
        _hull(box, first, last, hull, 0)
        used = 1
        while used < WIDE:
            widest = -1
            area = np.float32(-1.0)
            for k in range(used):
                if ranges[k, 1] - ranges[k, 0] > enough and _area(hull, k) > area:
                    widest, area = k, _area(hull, k)
            if widest < 0:
                break
            begin, end, above = ranges[widest, 0], ranges[widest, 1], ranges[widest, 2]
            middle = _split(box, order, begin, end, above >= DEEP, scratch)
            ranges[widest] = (begin, middle, above + 1, 0)
            ranges[used] = (middle, end, above + 1, 0)
            _hull(box, begin, middle, hull, widest)
            _hull(box, middle, end, hull, used)
            used += 1
        _clear(boxes, nodes)
        for k in range(used):
            _write(boxes, nodes * ROWS + k, hull, k)
            _enclose(vertices, triangles, order, ranges[k, 0], ranges[k, 1], turns, ellipsoids, nodes * OVAL + k)
            waiting[left] = (ranges[k, 0], ranges[k, 1], ranges[k, 2], nodes * WIDE + k)
            left += 1
        nodes += 1
    blocks = np.empty(leaves * BLOCK)
    for slot in range(nodes * WIDE):
        child = children[slot]
        if child >= 0:
            continue
        leaf, size = leaf_of(child), size_of(child)
        for lane in range(LEAF):
            t = order[leaf_from[leaf] + min(lane, size - 1)]
            for corner in range(3):
                for axis in range(3):
                    at = leaf * BLOCK + (3 * corner + axis) * LEAF + lane
                    blocks[at] = vertices[triangles[t, corner], axis]
    return boxes[: nodes * ROWS].copy(), children[: nodes * WIDE].copy(), blocks, ellipsoids[: nodes * OVAL].copy()


@njit()
def _enough(count):
    """How many triangles the boxes of a node are to hold, so that all levels below it are filled alike."""
    levels = 0
    held = float(FULL)
    while held < count:
        held *= WIDE
        levels += 1
    if levels == 0:
        return LEAF
    parts = max(2.0, np.ceil((count / FULL) ** (1.0 / levels)))
    return int(np.ceil(count / parts))


@njit()
def _longer(array):
    """The array with as much room again."""
    more = np.zeros(2 * len(array), array.dtype)
    for n in range(len(array)):
        more[n] = array[n]
    return more


@njit()
def _clear(boxes, node):
    """Make the boxes of a node empty: they meet nothing."""
    for n in range(3 * WIDE):
        boxes[node * ROWS + n] = 0.0
        boxes[node * ROWS + 3 * WIDE + n] = -np.inf


@njit()
def _write(boxes, at, hull, k):
    """Write row k of `hull` as the box at an entry of `boxes`, rounded outward."""
    for axis in range(3):
        low, high = float(hull[k, axis]), float(hull[k, 3 + axis])
        middle = float(np.float32(0.5 * low + 0.5 * high))
        boxes[at + axis * WIDE] = middle
        boxes[at + (3 + axis) * WIDE] = float(np.float32(max(high - middle, middle - low) * UP + _LEAST))


@njit()
def _enclose(vertices, triangles, order, first, last, turns, ellipsoids, at):
    """Write the ellipsoid of the covariance of the corners of some triangles, scaled to hold them all."""
    count = 3.0 * (last - first)
    x = y = z = 0.0
    for n in range(first, last):
        for corner in range(3):
            v = triangles[order[n], corner]
            x, y, z = x + vertices[v, 0], y + vertices[v, 1], z + vertices[v, 2]
    # The center as it is kept, so that nothing is off by its rounding.
    x, y, z = float(np.float32(x / count)), float(np.float32(y / count)), float(np.float32(z / count))
    xx = xy = xz = yy = yz = zz = radius = 0.0
    for n in range(first, last):
        for corner in range(3):
            v = triangles[order[n], corner]
            p, q, r = vertices[v, 0] - x, vertices[v, 1] - y, vertices[v, 2] - z
            radius = max(radius, p * p + q * q + r * r)
            xx, xy, xz, yy, yz, zz = xx + p * p, xy + p * q, xz + p * r, yy + q * q, yz + q * r, zz + r * r
    radius = np.sqrt(radius) + _LEAST
    U, spread = _principal(xx / count, xy / count, xz / count, yy / count, yz / count, zz / count, turns)
    # Half widths along the axes found, however well: directions with none still get what rounding may hide there.
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
        # A few corners far from all others; bounds of rounding count on what is no larger than the triangles.
        a = b = c = radius * WIDER
    ellipsoids[at], ellipsoids[at + WIDE], ellipsoids[at + 2 * WIDE] = x, y, z
    row = 3
    for i in range(3):
        for j in range(i, 3):
            entry = U[3 * i] * U[3 * j] * a + U[3 * i + 1] * U[3 * j + 1] * b + U[3 * i + 2] * U[3 * j + 2] * c
            ellipsoids[at + row * WIDE] = float(np.float32(entry))
            row += 1


@njit()
def _principal(xx, xy, xz, yy, yz, zz, turns):
    """Principal axes of a symmetric matrix, as the columns of nine numbers in row order, and its values along them.

    Jacobi's rotations; Golub and Van Loan, Matrix Computations (2013), section 8.5.
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


@njit()
def _hull(box, first, last, hull, k):
    """Write the box around boxes first .. last to row k."""
    for axis in range(3):
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for n in range(first, last):
            low = min(low, box[n, axis])
            high = max(high, box[n, 3 + axis])
        hull[k, axis], hull[k, 3 + axis] = low, high


@inline
def _area(hull, k):
    x, y, z = hull[k, 3] - hull[k, 0], hull[k, 4] - hull[k, 1], hull[k, 5] - hull[k, 2]
    return x * y + y * z + z * x


@inline
def _swap(box, order, i, j):
    order[i], order[j] = order[j], order[i]
    for c in range(6):
        box[i, c], box[j, c] = box[j, c], box[i, c]


@njit()
def _split(box, order, first, last, halve, scratch):
    """Part boxes first .. last in two, at the least cost by the surface area heuristic; where the second part begins.

    With `halve` both parts are equally large.
    """
    low, wide = np.empty(3, np.float32), np.empty(3, np.float32)
    for axis in range(3):
        least, most = np.float32(np.inf), np.float32(-np.inf)
        for n in range(first, last):
            middle = box[n, axis] + box[n, 3 + axis]
            least, most = min(least, middle), max(most, middle)
        low[axis], wide[axis] = least, most - least
    longest = 0
    for axis in range(1, 3):
        if wide[axis] > wide[longest]:
            longest = axis
    if not wide[longest] > np.float32(0.0):
        return (first + last) // 2
    if halve or last - first <= 2 * LEAF:
        return _split_by_rank(box, order, first, last, longest, halve)
    bins, used = scratch[: 3 * BINS], BINS if last - first > MANY else FEW_BINS
    for row in range(3 * BINS):
        for axis in range(3):
            bins[row, axis], bins[row, 3 + axis] = np.float32(np.inf), np.float32(-np.inf)
        bins[row, 6] = np.float32(0.0)
    for axis in range(3):
        if not wide[axis] > np.float32(0.0):
            continue
        scale = np.float32(used) / wide[axis]
        for n in range(first, last):
            row = axis * BINS + _bin(box, n, axis, low[axis], scale, used)
            for c in range(3):
                bins[row, c] = min(bins[row, c], box[n, c])
                bins[row, 3 + c] = max(bins[row, 3 + c], box[n, 3 + c])
            bins[row, 6] += np.float32(1.0)
    best_cost = np.float32(np.inf)
    best_axis, best_bin = longest, used // 2
    sums = scratch[3 * BINS :]
    for axis in range(3):
        if not wide[axis] > np.float32(0.0):
            continue
        for k in range(used - 1, 0, -1):  # what lies in bins k and above
            for c in range(7):
                sums[k, c] = bins[axis * BINS + k, c]
            if k < used - 1:
                for c in range(3):
                    sums[k, c] = min(sums[k, c], sums[k + 1, c])
                    sums[k, 3 + c] = max(sums[k, 3 + c], sums[k + 1, 3 + c])
                sums[k, 6] += sums[k + 1, 6]
        for k in range(1, used):
            for c in range(7):
                value = bins[axis * BINS + k - 1, c]
                if k == 1:
                    sums[0, c] = value
                elif c < 3:
                    sums[0, c] = min(sums[0, c], value)
                elif c < 6:
                    sums[0, c] = max(sums[0, c], value)
                else:
                    sums[0, c] += value
            if sums[0, 6] == np.float32(0.0) or sums[k, 6] == np.float32(0.0):
                continue
            cost = _area(sums, 0) * sums[0, 6] + _area(sums, k) * sums[k, 6]
            if cost < best_cost:
                best_cost, best_axis, best_bin = cost, axis, k
    scale = np.float32(used) / wide[best_axis]
    i, j = first, last
    while i < j:
        if _bin(box, i, best_axis, low[best_axis], scale, used) < best_bin:
            i += 1
        else:
            j -= 1
            _swap(box, order, i, j)
    if i in (first, last):  # costs that overflow
        return _split_by_rank(box, order, first, last, longest, True)
    return i


@inline
def _bin(box, n, axis, low, scale, used):
    return min(used - 1, int((box[n, axis] + box[n, 3 + axis] - low) * scale))


@njit()
def _split_by_rank(box, order, first, last, axis, halve):
    """Part boxes in two by their middles along an axis: in equal parts, or in two leaves at least cost."""
    # Shell's sort: short of all else, and ranges to halve are either short or pathological.
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
    hull = np.empty((2, 6), np.float32)
    best, best_cost = (first + last) // 2, np.float32(np.inf)
    for middle in range(max(first + 1, last - LEAF), min(last - 1, first + LEAF) + 1):
        _hull(box, first, middle, hull, 0)
        _hull(box, middle, last, hull, 1)
        cost = _area(hull, 0) * np.float32(middle - first) + _area(hull, 1) * np.float32(last - middle)
        if cost < best_cost:
            best, best_cost = middle, cost
    return best


@inline
def _middle(box, n, axis):
    return box[n, axis] + box[n, 3 + axis]
