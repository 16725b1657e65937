"""Surfaces cut into parts, with a box and an ellipsoid around each part: proofs of motions use the parts.

The part whose box has the most empty space is cut next. The cut is across an axis of the box, at the place that makes
the boxes of both halves smallest. At most about a thousand items of the part determine the place. These items are
sorted into bins along each axis, and only the items next to the best boundary are sorted one by one. The cut is halfway
between the two items on either side of the place, for example between two walls.

Corners are stored by coordinate, and all corners of a part are consecutive, so that eight are processed at a time.

An item is a triangle if its part is a single flat face, and otherwise a face. An item has a row of eight numbers: the
lower corner of its box along the axes, the negated upper corner, and two zeros.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.linalg3 import across, adjugate, apply_symmetric, cross, dot, minus, plus, rotated_shape, scaled
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.simd.vectors import LANES, broadcast, highest, load, lowest, maximum, minimum, movemask, store
from loewner._kernels.trees.triangle_tree import principal, put_range

# THICKNESS is the assumed thickness of a flat part, relative to the longest side of a box around all triangles.
# FLAT_BOX is the thickness that is added to each side of a box, relative to its longest side, so that the shorter of
# two flat boxes with equal areas is chosen. FLAT_OVAL and DIGITS are the least half widths of a part's box in the
# search for its ellipsoid, relative to the longest half width and to the largest coordinate.
THICKNESS, FLAT_BOX, FLAT_OVAL, DIGITS = 0.01, 0.01, 1e-4, 1e-8

# Inverse of the least fraction of the sampled items on either side of a cut. If a cut between bins is refined among the
# items of two bins, half of this fraction suffices. With 16 instead of 4, each cut would often leave three quarters of
# a part on one side, and no more would be proven.
LEAST_SHARE = 4

# MOST_ASKED is the maximum number of triangles from which the axes of a box are computed. LOOKS is the number of
# directions in which points of a hull are sought. MOST_EDGES is the maximum number of edges of this hull, the longest
# ones, along which a box is tried.
MOST_ASKED, LOOKS, MOST_EDGES = 128, 64, 8

# BINS is the number of bins along each axis. Up to FEW items are sorted without bins. The place of a cut is determined
# from at most twice MANY items.
BINS, FEW, MANY = 128, 32, 512

# Bound on the rounding error of a point that is rotated, and rotated back, by a matrix that is orthonormal up to a few
# roundings; relative to the largest coordinate.
TURN_ROUNDINGS = 128 * 2.0**-53

# ROUNDS is the number of rounds in the search for a small ellipsoid, and LEAST_AXIS is the least semi-axis of this
# ellipsoid, relative to the box. WIDER is a factor on the semi-axes that allows for rounding: coordinates relative to
# the box are off by at most 1e-7.
ROUNDS, LEAST_AXIS, WIDER = 24, 1e-2, 1.0 + 1e-3

# Least factor by which the shape matrix of an ellipsoid is scaled. It is needed for parts whose points all coincide.
LEAST_OVAL = 1e-3

# Directions whose extreme points determine the ellipsoid.
_WAYS = np.array([(x, y, z) for x in (0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)], float)

ROW = 8
NUMBERS = 16  # Number of entries for a part: turn, lower and upper corners of the box, and empty space.


@njit()
def cut_up(corners, faces, radius, most, order, start, boxes, centers, shapes):
    """Cut triangles into parts.

    Parameters
    ----------
    corners : ndarray, shape (3 n,) or (9 n,)
        All x of n points, then all y, then all z; for triangles, the coordinates of the first corners, then the
        coordinates of the second and third corners. On entry, they are sorted by face; the array receives them in the
        order of the parts.
    faces : ndarray of int64, shape (n,)
        Face of each triangle. A face is cut only if it is alone in its part.
    radius : float
        Radius around the triangles, in metres.
    most : int
        Largest number of parts.
    order : ndarray of int64, shape (n,)
        The triangles, sorted by face; receives the triangles in the order of the parts.
    start : ndarray of int64, shape (most + 1,)
        Receives the starts of the parts in that order, and the end.
    boxes : ndarray, shape (most, 24)
        Receives the corners of boxes around the parts: eight x, eight y, eight z.
    centers, shapes : ndarray, shapes (most, 3) and (most, 3, 3)
        Receive centers and shape matrices of ellipsoids around the parts, without the radius.

    Returns
    -------
    int
        Number of parts.
    """
    n = len(order)
    same = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    low, high = _box(corners, n, 0, n, same)
    thick = THICKNESS * max(high[0] - low[0], max(high[1] - low[1], high[2] - low[2]))
    grown = 2.0 * radius + thick
    numbers, ranges, count = np.empty((most, NUMBERS)), np.empty((most, 3), np.int64), 1
    rest, lists, begin = np.empty(n), np.empty((2, n), np.int64), np.empty(n + 1, np.int64)
    rows, listed = np.empty(2 * ROW * MANY), np.empty(2 * MANY, np.int64)
    bins, held = np.empty(3 * BINS * ROW), np.empty(3 * BINS, np.int64)
    put_range(ranges, 0, 0, n, 0)
    _measure(corners, n, ranges[0], thick, grown, numbers[0])
    age = 1
    while count < most:
        emptiest = 0
        for k in range(1, count):
            more, same_space = numbers[k, 15] > numbers[emptiest, 15], numbers[k, 15] == numbers[emptiest, 15]
            if more or (same_space and ranges[k, 2] < ranges[emptiest, 2]):
                emptiest = k
        if not numbers[emptiest, 15] > 0.0:
            break
        first, last = ranges[emptiest, 0], ranges[emptiest, 1]
        items = _items(faces, order, first, last, begin)
        turn = numbers[emptiest]
        axis, key = _place_of_cut(corners, n, begin, items, turn, grown, rows, listed, bins, held)
        along = turn[axis], turn[3 + axis], turn[6 + axis]
        middle = _divided(corners, n, order, begin, items, along, key, rest, lists)
        put_range(ranges, emptiest, first, middle, age)
        put_range(ranges, count, middle, last, age + 1)
        _measure(corners, n, ranges[emptiest], thick, grown, numbers[emptiest])
        _measure(corners, n, ranges[count], thick, grown, numbers[count])
        count, age = count + 1, age + 2
    at = 0
    for part in range(count):
        start[part] = at
        k = 0
        while ranges[k, 0] != at:
            k += 1
        _enclose(corners, n, ranges[k], numbers[k], boxes[part], centers[part], shapes[part])
        at = ranges[k, 1]
    start[count] = n
    return count


# -- boxes -------------------------------------------------------------------------------------


@inline
def _corner(corners, n, triangle, corner):
    at = 3 * n * corner + triangle
    return corners[at], corners[at + n], corners[at + 2 * n]


@inline
def _eight(corners, n, triangle, first, last, corner):
    """Load a corner of eight triangles of a part: from one triangle on, or the last eight; repeats if it has fewer."""
    if last - first < LANES:
        x, y, z = _corner(corners, n, triangle, corner)
        return broadcast(x), broadcast(y), broadcast(z)
    at = 3 * n * corner + min(triangle, last - LANES)
    return load(corners, at), load(corners, at + n), load(corners, at + 2 * n)


@inline
def _turned(turn, p):
    """Coordinates of a point along three axes, the columns of a turn."""
    return (
        turn[0] * p[0] + turn[3] * p[1] + turn[6] * p[2],
        turn[1] * p[0] + turn[4] * p[1] + turn[7] * p[2],
        turn[2] * p[0] + turn[5] * p[1] + turn[8] * p[2],
    )


@inline
def _frame(a, b):
    """Orthonormal axes, as the columns of a turn, along a and nearly along b."""
    a = scaled(1.0 / np.sqrt(dot(a, a)), a)
    for _ in range(2):
        b = minus(b, scaled(dot(a, b), a))
        b = scaled(1.0 / np.sqrt(dot(b, b)), b)
    c = cross(a, b)
    return a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]


@njit()
def _box(corners, n, first, last, turn):
    """Corners of the box around triangles, along the axes of a turn."""
    least = broadcast(np.inf), broadcast(np.inf), broadcast(np.inf)
    most = broadcast(-np.inf), broadcast(-np.inf), broadcast(-np.inf)
    each = len(corners) // (3 * n)
    for corner in range(each):
        for k in range(first, last, LANES if last - first >= LANES else 1):
            p = _turned(turn, _eight(corners, n, k, first, last, corner))
            least = minimum(least[0], p[0]), minimum(least[1], p[1]), minimum(least[2], p[2])
            most = maximum(most[0], p[0]), maximum(most[1], p[1]), maximum(most[2], p[2])
    return (
        (lowest(least[0]), lowest(least[1]), lowest(least[2])), (highest(most[0]), highest(most[1]), highest(most[2]))
    )  # fmt: skip


@njit()
def _area(some, count, turn):
    """Half the surface area of a box around triangles, along the axes of a turn."""
    low, high = _box(some, count, 0, count, turn)
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    flat = FLAT_BOX * max(x, max(y, z))
    x, y, z = x + flat, y + flat, z + flat
    return x * y + y * z + z * x


@njit()
def _measure(corners, n, part, thick, grown, numbers):
    """Find a box with little area around a part; write its axes, its corners, and its empty space."""
    first, last, width = part[0], part[1], len(corners) // n
    step = (last - first + MOST_ASKED - 1) // MOST_ASKED
    count = (last - first + step - 1) // step
    some = np.empty(width * count)
    for c in range(width):
        for k in range(count):
            some[c * count + k] = corners[c * n + first + step * k]
    best = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    least = _area(some, count, best)
    middle = 0.0, 0.0, 0.0
    for corner in range(width // 3):
        for k in range(count):
            middle = plus(middle, _corner(some, count, k, corner))
    middle = scaled(3.0 / len(some), middle)
    xx = xy = xz = yy = yz = zz = 0.0
    for corner in range(width // 3):
        for k in range(count):
            r = minus(_corner(some, count, k, corner), middle)
            xx, xy, xz = xx + r[0] * r[0], xy + r[0] * r[1], xz + r[0] * r[2]
            yy, yz, zz = yy + r[1] * r[1], yz + r[1] * r[2], zz + r[2] * r[2]
    U, _ = principal(xx, xy, xz, yy, yz, zz, np.empty((2, 3, 3)))
    turn = _frame((U[0], U[3], U[6]), (U[1], U[4], U[7]))
    area = _area(some, count, turn)
    if area < least:
        least, best = area, turn
    filled = 0.0
    if width == 9:
        best = _along_faces(some, count, middle, least, best)
        for k in range(first, last):
            v = _normal(corners, n, k)
            # Count triangles as thin slabs, so that even a flat box has a volume, and triangles that are far apart do
            # not fill their box.
            filled += thick * 0.5 * np.sqrt(dot(v, v))
    low, high = _box(corners, n, first, last, best)
    for c in range(9):
        numbers[c] = best[c]
    numbers[9], numbers[10], numbers[11] = low
    numbers[12], numbers[13], numbers[14] = high
    box = (high[0] - low[0] + grown) * (high[1] - low[1] + grown) * (high[2] - low[2] + grown)
    numbers[15] = box - filled if last - first > 1 else 0.0


@inline
def _normal(corners, n, triangle):
    a = _corner(corners, n, triangle, 0)
    return cross(minus(_corner(corners, n, triangle, 1), a), minus(_corner(corners, n, triangle, 2), a))


@njit()
def _along_faces(some, count, middle, least, best):
    """Axes of a box with less area, along the largest triangle and an edge of the outline seen along its normal.

    The smallest rectangle around points in a plane has a side along an edge of their hull (Freeman and Shapira:
    Determining the minimum-area encasing rectangle for an arbitrary closed curve, 1975). The farthest points in several
    directions approximate the hull.
    """
    normal, squared = (0.0, 0.0, 0.0), 0.0
    for k in range(count):
        v = _normal(some, count, k)
        if dot(v, v) > squared:
            normal, squared = v, dot(v, v)
    if not squared > 0.0:
        return best
    normal = scaled(1.0 / np.sqrt(squared), normal)
    u, v = across(normal)
    rim = np.empty((LOOKS + 1, 2))
    for look in range(LOOKS):
        angle = look * (2.0 * np.pi / LOOKS)
        (y, x), farthest = sine_cosine(angle), -np.inf
        for k in range(count):
            for corner in range(3):
                r = minus(_corner(some, count, k, corner), middle)
                s, t = dot(r, u), dot(r, v)
                if s * x + t * y > farthest:
                    farthest, rim[look, 0], rim[look, 1] = s * x + t * y, s, t
    rim[LOOKS, 0], rim[LOOKS, 1] = rim[0, 0], rim[0, 1]
    squares = np.empty(LOOKS)
    for look in range(LOOKS):
        s, t = rim[look + 1, 0] - rim[look, 0], rim[look + 1, 1] - rim[look, 1]
        squares[look] = s * s + t * t
    for _ in range(MOST_EDGES):
        at = 0
        for look in range(LOOKS):
            at = look if squares[look] > squares[at] else at
        if not squares[at] > 0.0:
            break
        squares[at] = 0.0
        s, t = rim[at + 1, 0] - rim[at, 0], rim[at + 1, 1] - rim[at, 1]
        turn = _frame(normal, (s * u[0] + t * v[0], s * u[1] + t * v[1], s * u[2] + t * v[2]))
        area = _area(some, count, turn)
        if area < least:
            least, best = area, turn
    return best


# -- cuts --------------------------------------------------------------------------------------


@inline
def _volume(box, grown):
    """Volume of the box of a row, grown along each axis."""
    return (grown - box[3] - box[0]) * (grown - box[4] - box[1]) * (grown - box[5] - box[2])


@inline
def _middle(rows, item, axis):
    """Twice a coordinate of the middle of an item."""
    return rows[ROW * item + axis] - rows[ROW * item + 3 + axis]


@njit()
def _items(faces, order, first, last, begin):
    """Write the beginnings of a part's items, and the end; return the number of items."""
    if faces[order[first]] == faces[order[last - 1]]:
        for k in range(first, last + 1):
            begin[k - first] = k
        return last - first
    items = 0
    for k in range(first, last):
        if k == first or faces[order[k]] != faces[order[k - 1]]:
            begin[items] = k
            items += 1
    begin[items] = last
    return items


@njit()
def _place_of_cut(corners, n, begin, items, numbers, grown, rows, listed, bins, held):
    """Find the axis across which a part is cut, and twice the place: items with smaller middles come first.

    Parameters
    ----------
    numbers : ndarray
        Numbers of the part.
    rows, listed, bins, held : ndarray
        Scratch memory.
    """
    nothing, step = broadcast(np.inf), max(items // MANY, 1)
    sample_count = (items + step - 1) // step
    for item in range(sample_count):
        low, high = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf)
        for k in range(begin[step * item], begin[step * item + 1]):
            for corner in range(len(corners) // (3 * n)):
                p = _turned(numbers, _corner(corners, n, k, corner))
                low = min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2])
                high = max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2])
        at = ROW * item
        rows[at], rows[at + 1], rows[at + 2] = low
        rows[at + 3], rows[at + 4], rows[at + 5] = -high[0], -high[1], -high[2]
        rows[at + 6] = rows[at + 7] = 0.0
    least = max(sample_count // LEAST_SHARE, 1)
    axis, slot, start, scale = -1, 0, 0.0, 0.0
    if sample_count > FEW:
        axis, slot, start, scale = _boundary(rows, sample_count, least, grown, bins, held)
    if axis >= 0:
        # List the items in the two bins next to the boundary, and find boxes around the items in all bins before and
        # after these two bins.
        count, before, ahead, behind = 0, 0, nothing, nothing
        left, right = -np.inf, np.inf
        for item in range(sample_count):
            middle = _middle(rows, item, axis)
            own = int((middle - start) * scale)
            if own < slot - 1:
                before, left = before + 1, max(left, middle)
                ahead = minimum(ahead, load(rows, ROW * item))
            elif own > slot:
                right = min(right, middle)
                behind = minimum(behind, load(rows, ROW * item))
            else:
                listed[count] = item
                count += 1
        store(bins, 0, ahead)
        store(bins, ROW, behind)
        _sort(rows, axis, listed, count)
        _, rank = _sweep(rows, listed, count, before, sample_count, max(least // 2, 1), grown, bins, 0, 1)
        if rank > 0:
            return axis, _between(rows, listed, rank - before, count, axis, left, right)
    store(bins, 0, nothing)
    smallest, best, key = np.inf, 0, 0.0
    for axis in range(3):
        for item in range(sample_count):
            listed[item] = item
        _sort(rows, axis, listed, sample_count)
        volume, rank = _sweep(rows, listed, sample_count, 0, sample_count, least, grown, bins, 0, 0)
        if axis == 0 or volume < smallest:
            smallest, best, key = volume, axis, _between(rows, listed, rank, sample_count, axis, 0.0, 0.0)
    return best, key


@inline
def _between(rows, listed, rank, count, axis, left, right):
    """Twice the place halfway between a listed item and the previous one; `left` and `right` replace missing items."""
    left = _middle(rows, listed[rank - 1], axis) if rank > 0 else left
    right = _middle(rows, listed[rank], axis) if rank < count else right
    return 0.5 * (left + right)


@njit()
def _divided(corners, n, order, begin, items, along, key, rest, lists):
    """Reorder a part's triangles: items before a place along an axis come first; return where the others begin.

    Parameters
    ----------
    begin : ndarray
        Beginnings of items; overwritten.
    key : float
        Twice the place along the axis.
    rest, lists : ndarray
        Scratch memory.
    """
    first, middle, last = begin[0], begin[items // 2], begin[items]
    ahead, behind = lists[0], lists[1]
    kept, count, one, start, n = np.uint64(0), np.uint64(0), np.uint64(1), np.uint64(first), np.uint64(n)
    if len(corners) == 3 * n:
        for k in range(start, np.uint64(last)):  # Write to both lists, because a branch would be unpredictable.
            ahead[kept] = behind[count] = np.int64(k)
            is_first = np.uint64(dot(along, (corners[k], corners[k + n], corners[k + n + n])) < 0.5 * key)
            kept, count = kept + is_first, count + one - is_first
    else:
        for item in range(items):
            low, high = np.inf, -np.inf
            for k in range(begin[item], begin[item + 1]):
                for corner in range(3):
                    p = dot(along, _corner(corners, len(order), k, corner))
                    low, high = min(low, p), max(high, p)
            is_first = np.uint64(low + high < key)
            for k in range(begin[item], begin[item + 1]):
                ahead[kept] = behind[count] = k
                kept, count = kept + is_first, count + one - is_first
    for c in range(len(corners) // len(order)):
        at = np.uint64(c) * n
        for k in range(count):
            rest[k] = corners[at + np.uint64(behind[k])]
        for k in range(kept):
            corners[at + start + k] = corners[at + np.uint64(ahead[k])]
        for k in range(count):
            corners[at + start + kept + k] = rest[k]
    for k in range(count):
        begin[k] = order[np.uint64(behind[k])]
    for k in range(kept):
        order[start + k] = order[np.uint64(ahead[k])]
    for k in range(count):
        order[start + kept + k] = begin[k]
    # If items are equal, or their centers differ only by rounding, all items may end up on one side. In this case, all
    # cuts are equally good.
    return first + np.int64(kept) if kept > 0 and count > 0 else middle


@njit()
def _boundary(rows, items, least, grown, bins, held):
    """Find the cut with the smallest boxes: its axis (-1 if there is none), the bin after it, and the axis's bins."""
    low, scale = np.empty(3), np.empty(3)
    for axis in range(3):
        least_middle = most_middle = _middle(rows, 0, axis)
        for item in range(1, items):
            middle = _middle(rows, item, axis)
            least_middle, most_middle = min(least_middle, middle), max(most_middle, middle)
        low[axis] = least_middle
        scale[axis] = BINS / (most_middle - least_middle)
        if not scale[axis] < np.inf:
            scale[axis] = 0.0
    nothing = broadcast(np.inf)
    for row in range(3 * BINS):
        store(bins, ROW * row, nothing)
        held[row] = 0
    for item in range(items):
        own = load(rows, ROW * item)
        for axis in range(3):
            row = axis * BINS + min(BINS - 1, int((_middle(rows, item, axis) - low[axis]) * scale[axis]))
            store(bins, ROW * row, minimum(own, load(bins, ROW * row)))
            held[row] += 1
    best_axis, best_slot, smallest = -1, 0, np.inf
    volumes, around = np.empty(BINS), np.empty(ROW)
    for axis in range(3):
        box = nothing
        for slot in range(BINS - 1, 0, -1):
            box = minimum(box, load(bins, ROW * (axis * BINS + slot)))
            store(around, 0, box)
            volumes[slot] = _volume(around, grown)
        box, below = nothing, 0
        for slot in range(1, BINS):
            box, below = minimum(box, load(bins, ROW * (axis * BINS + slot - 1))), below + held[axis * BINS + slot - 1]
            store(around, 0, box)
            if least <= below <= items - least:
                volume = _volume(around, grown) + volumes[slot]
                if volume < smallest:
                    best_axis, best_slot, smallest = axis, slot, volume
    return best_axis, best_slot, low[best_axis], scale[best_axis]


@njit()
def _sort(rows, axis, listed, count):
    """Sort items by their middles along an axis, and equal items by number (Shell's sort)."""
    gap = 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for n in range(gap, count):
            item, m = listed[n], n
            key = _middle(rows, item, axis)
            while m >= gap:
                other = listed[m - gap]
                middle = _middle(rows, other, axis)
                if middle < key or (middle == key and other < item):
                    break
                listed[m] = other
                m -= gap
            listed[m] = item
        gap //= 3


@njit()
def _sweep(rows, listed, count, before, items, least, grown, bins, ahead, behind):
    """Find the cut with the smallest boxes among sorted, listed items: their volume, and the items before it, or 0.

    `before` items come before the listed items; the box around them is in row `ahead` of `bins`. The box around the
    remaining items is in row `behind`.
    """
    volumes, around = np.empty(count + 1), np.empty(ROW)
    box = load(bins, ROW * behind)
    for k in range(count, -1, -1):
        store(around, 0, box)
        volumes[k] = _volume(around, grown)
        if k > 0:
            box = minimum(box, load(rows, ROW * listed[k - 1]))
    box, smallest, rank = load(bins, ROW * ahead), np.inf, 0
    for k in range(count + 1):
        if k > 0:
            box = minimum(box, load(rows, ROW * listed[k - 1]))
        if least <= before + k <= items - least:
            store(around, 0, box)
            volume = _volume(around, grown) + volumes[k]
            if volume < smallest:
                smallest, rank = volume, before + k
    return smallest, rank


# -- bounds ------------------------------------------------------------------------------------


@njit()
def _enclose(corners, n, part, numbers, box, center, shape):
    """Write the corners of the box around a part, and an ellipsoid around the part."""
    first, last, each = part[0], part[1], len(corners) // (3 * n)
    low, high = _box(corners, n, first, last, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    largest = max(max(-low[0], high[0]), max(max(-low[1], high[1]), max(-low[2], high[2])))
    same = True
    for c in range(9):
        same &= numbers[c] == (1.0 if c % 4 == 0 else 0.0)
    slack = 0.0 if same else TURN_ROUNDINGS * largest
    low = numbers[9] - slack, numbers[10] - slack, numbers[11] - slack
    high = numbers[12] + slack, numbers[13] + slack, numbers[14] + slack
    for corner in range(8):
        p = (
            high[0] if corner & 4 else low[0], high[1] if corner & 2 else low[1], high[2] if corner & 1 else low[2]
        )  # fmt: skip
        for row in range(3):
            box[8 * row + corner] = numbers[3 * row] * p[0] + numbers[3 * row + 1] * p[1] + numbers[3 * row + 2] * p[2]
    # Find the ellipsoid in coordinates in which the box is a cube.
    half = 0.5 * (high[0] - low[0]), 0.5 * (high[1] - low[1]), 0.5 * (high[2] - low[2])
    thin = max(FLAT_OVAL * max(half[0], max(half[1], half[2])), max(DIGITS * largest, 1e-12))
    half = max(half[0], thin), max(half[1], thin), max(half[2], thin)
    per = 1.0 / half[0], 1.0 / half[1], 1.0 / half[2]
    middle = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])
    ways = len(_WAYS)
    points, ends = np.empty((2 * ways, 3)), np.empty((ways, 2 * LANES))
    ends[:, :LANES], ends[:, LANES:] = np.inf, -np.inf
    step = LANES if last - first >= LANES else 1
    for corner in range(each):
        for k in range(first, last, step):
            p = _relative(numbers, _eight(corners, n, k, first, last, corner), middle, per)
            for way in range(ways):
                along = _along(way, p)
                # This branch is rarely taken.
                if movemask((along < load(ends[way], 0)) | (along > load(ends[way], LANES))) > 0:
                    _extend(corners, n, min(k, last - step), step, corner, numbers, middle, per, way, points, ends)
    c, Q, inverse = _around(points)
    farthest = broadcast(0.0)
    for corner in range(each):
        for k in range(first, last, step):
            r = minus(_relative(numbers, _eight(corners, n, k, first, last, corner), middle, per), c)
            farthest = maximum(farthest, _form(inverse, r))
    most = max(highest(farthest), LEAST_OVAL) * WIDER * WIDER
    F = (
        numbers[0] * half[0], numbers[1] * half[1], numbers[2] * half[2], numbers[3] * half[0], numbers[4] * half[1],
        numbers[5] * half[2], numbers[6] * half[0], numbers[7] * half[1], numbers[8] * half[2],
    )  # fmt: skip
    xx, xy, xz, yy, yz, zz = rotated_shape(F, Q)
    shape[0, 0], shape[0, 1], shape[0, 2] = xx * most, xy * most, xz * most
    shape[1, 0], shape[1, 1], shape[1, 2] = xy * most, yy * most, yz * most
    shape[2, 0], shape[2, 1], shape[2, 2] = xz * most, yz * most, zz * most
    for row in range(3):
        center[row] = F[3 * row] * c[0] + F[3 * row + 1] * c[1] + F[3 * row + 2] * c[2]
        for axis in range(3):
            center[row] += numbers[3 * row + axis] * middle[axis]


@inline
def _along(way, p):
    return _WAYS[way, 0] * p[0] + _WAYS[way, 1] * p[1] + _WAYS[way, 2] * p[2]


@njit()
def _extend(corners, n, first, count, corner, numbers, middle, per, way, points, ends):
    """Store the farthest of eight corners in a direction and its opposite, if they are farther than the stored ones."""
    for k in range(first, first + count):
        p = _relative(numbers, _corner(corners, n, k, corner), middle, per)
        along = _along(way, p)
        for end in range(2):
            if along < ends[way, 0] if end == 0 else along > ends[way, LANES]:
                store(ends[way], LANES * end, broadcast(along))
                points[2 * way + end, 0], points[2 * way + end, 1], points[2 * way + end, 2] = p


@inline
def _relative(numbers, p, middle, per):
    """Coordinates of a point in a frame in which the box of its part is a cube."""
    x, y, z = minus(_turned(numbers, p), middle)
    return x * per[0], y * per[1], z * per[2]


@inline
def _form(Q, r):
    """The form r · Q r for a symmetric matrix Q."""
    return dot(r, apply_symmetric(Q, r))


@njit()
def _around(points):
    """Mean and covariance of weighted points: center and shape, up to a factor, of a small ellipsoid around them.

    Each weight is multiplied by its share in the optimality condition; Titterington, Some aspects of D-optimal design
    for estimation (1976). Returns the mean, the covariance and its inverse.
    """
    n = len(points)
    weights = np.full(n, 1.0 / n)
    c, Q = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
    inverse = Q
    for _ in range(ROUNDS):
        x = y = z = 0.0
        for k in range(n):
            x, y, z = x + weights[k] * points[k, 0], y + weights[k] * points[k, 1], z + weights[k] * points[k, 2]
        c = x, y, z
        xx = yy = zz = LEAST_AXIS * LEAST_AXIS
        xy = xz = yz = 0.0
        for k in range(n):
            r, u = (points[k, 0] - x, points[k, 1] - y, points[k, 2] - z), weights[k]
            xx, xy, xz = xx + u * r[0] * r[0], xy + u * r[0] * r[1], xz + u * r[0] * r[2]
            yy, yz, zz = yy + u * r[1] * r[1], yz + u * r[1] * r[2], zz + u * r[2] * r[2]
        Q = xx, xy, xz, yy, yz, zz
        A = adjugate(Q)
        s = 1.0 / (xx * A[0] + xy * A[1] + xz * A[2])
        inverse = A[0] * s, A[1] * s, A[2] * s, A[3] * s, A[4] * s, A[5] * s
        total = 0.0
        for k in range(n):
            weights[k] *= 1.0 + _form(inverse, (points[k, 0] - x, points[k, 1] - y, points[k, 2] - z))
            total += weights[k]
        for k in range(n):
            weights[k] /= total
    return c, Q, inverse
