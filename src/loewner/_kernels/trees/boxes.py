"""Find the boxes of a crowd that meet, by a tree of axis-aligned boxes in groups of eight.

Bodies are ordered along a space-filling curve, large bodies before small ones. The tree is then implicit: node q of a
level has the nodes 8q .. 8q+7 of the level below, without pointers. A group of eight boxes is contiguous in memory, as
six rows of eight numbers: lower x, y, z, then upper x, y, z. Six vector comparisons therefore compare one box with
eight.

Every rounding is outward: if the search finds boxes apart, their bodies are apart by more than the margin.

References
----------
Lauterbach et al. (2009), doi:10.1111/j.1467-8659.2009.01377.x, for the order along the curve.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import OUTER_CENTER, OUTER_SHAPE, REACH, WIDE
from loewner._kernels.ellipsoids.contact import outward_width, position_error
from loewner._kernels.pieces.pack import pieces_of
from loewner._kernels.simd.vectors import next_lane
from loewner._kernels.tolerances import UNIT_ROUNDOFF

ROWS = 6 * WIDE  # Number of entries of a group.
LEVELS = 22  # Largest number of levels; no index needs more, because 8^22 > 2^63.

# Binary logarithm of the number of steps of the curve along each axis. In a key, the size class takes the four bits
# above the bits of all three axes.
STEPS = np.uint64(20)
SIZE_CLASSES = 16
SIZE_RATIO = 0.25  # Ratio of the size limits of successive size classes.

DIGIT = np.uint64(11)  # Number of bits that the radix sort takes in each pass.
PASSES = 6

# Lower bounds of a box are at least -MOST, and upper bounds are at most MOST. The boxes that pad a group start at
# infinity, so that they meet no box.
MOST = 1.7e308


# -- vectors -----------------------------------------------------------------------------------


_VECTOR = ir.VectorType(ir.DoubleType(), WIDE)


def _everywhere(builder, value):
    """Eight copies of a number."""
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    lanes = ir.Constant(ir.VectorType(ir.IntType(32), WIDE), [0] * WIDE)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), lanes)


def _rows(context, builder, boxes_type, boxes, group):
    """Lower x, y, z and upper x, y, z of the eight boxes of a group."""
    data = context.make_array(boxes_type)(context, builder, boxes).data
    first = builder.mul(group, ir.Constant(ir.IntType(64), ROWS))
    rows = []
    for row in range(6):
        at = builder.gep(data, [builder.add(first, ir.Constant(ir.IntType(64), row * WIDE))])
        rows.append(builder.load(builder.bitcast(at, _VECTOR.as_pointer()), align=8))
    return rows


def _bits(builder, mask):
    return builder.zext(builder.bitcast(mask, ir.IntType(WIDE)), ir.IntType(64))


@intrinsic
def meeting(typingctx, boxes, group, lx, ly, lz, ux, uy, uz):
    """Bit mask of the boxes of a group that meet the box (lx, ly, lz) .. (ux, uy, uz)."""

    def generate(context, builder, signature, arguments):
        rows = _rows(context, builder, signature.args[0], *arguments[:2])
        bounds = [_everywhere(builder, x) for x in arguments[2:]]
        mask = None
        for axis in range(3):
            for meets in (
                builder.fcmp_ordered("<=", rows[axis], bounds[3 + axis]),
                builder.fcmp_ordered(">=", rows[3 + axis], bounds[axis]),
            ):
                mask = meets if mask is None else builder.and_(mask, meets)
        return _bits(builder, mask)

    return types.int64(boxes, types.int64, *[types.float64] * 6), generate


@intrinsic
def within(typingctx, boxes, group, lx, ly, lz, ux, uy, uz, squared):
    """Bit mask of the boxes of a group whose squared distance from a box is at most `squared`."""

    def generate(context, builder, signature, arguments):
        rows = _rows(context, builder, signature.args[0], *arguments[:2])
        bounds = [_everywhere(builder, x) for x in arguments[2:8]]
        zero = ir.Constant(_VECTOR, [0.0] * WIDE)
        total = None
        for axis in range(3):
            gap = zero
            for side in (
                builder.fsub(rows[axis], bounds[3 + axis]),
                builder.fsub(bounds[axis], rows[3 + axis]),
            ):
                gap = builder.select(builder.fcmp_ordered(">", side, gap), side, gap)
            square = builder.fmul(gap, gap)
            total = square if total is None else builder.fadd(total, square)
        return _bits(builder, builder.fcmp_ordered("<=", total, _everywhere(builder, arguments[8])))

    return types.int64(boxes, types.int64, *[types.float64] * 7), generate


# -- boxes -------------------------------------------------------------------------------------


@inline
def lowered(bound, by):
    """Move a lower bound outward, including the rounding of the move; a bound that is NaN excludes nothing."""
    moved = (bound - by) - 4.0 * UNIT_ROUNDOFF * (abs(bound) + by)
    return moved if moved > -MOST else -MOST


@inline
def raised(bound, by):
    """Move an upper bound outward, as `lowered` moves a lower bound."""
    moved = (bound + by) + 4.0 * UNIT_ROUNDOFF * (abs(bound) + by)
    return moved if moved < MOST else MOST


@njit()
def body_boxes(first, last, body_step, pose_step, pack, T, lower, upper):
    """Write boxes around the outer ellipsoids of the bodies first .. last, in world coordinates.

    Parameters
    ----------
    body_step, pose_step : int
        1 if each body has its own pieces, or its own pose; 0 if all bodies share one.
    pack : int
        Handle of packed pieces, see `pieces.pack`.
    T : ndarray, shape (..., 4, 4), one batch axis
    lower, upper : ndarray, shape (n, 3)
        Receive the corners in metres.
    """
    pieces = pieces_of(pack)
    hot, start = pieces.hot, pieces.piece_start
    for body in range(first, last):
        k = body * pose_step
        row = body * body_step
        for axis in range(3):
            low = np.inf
            high = -np.inf
            x, y, z, t = T[k, axis, 0], T[k, axis, 1], T[k, axis, 2], T[k, axis, 3]
            squared = x * x + y * y + z * z
            for i in range(start[row], start[row + 1]):
                c, q = OUTER_CENTER, OUTER_SHAPE
                shape = hot[i, q], hot[i, q + 1], hot[i, q + 2], hot[i, q + 3], hot[i, q + 4], hot[i, q + 5]
                width, _ = outward_width(shape, (x, y, z), squared)
                middle = t + (x * hot[i, c] + y * hot[i, c + 1] + z * hot[i, c + 2])
                width += position_error(abs(t) + hot[i, REACH], UNIT_ROUNDOFF)
                low = min(low, middle - width)
                high = max(high, middle + width)
            lower[body, axis] = low if low > -MOST else -MOST
            upper[body, axis] = high if high < MOST else MOST


# -- order -------------------------------------------------------------------------------------


@inline
def _spread(x):
    """Spread the bits of a number of `STEPS` bits to every third place."""
    x = (x | x << np.uint64(32)) & np.uint64(0x1F00000000FFFF)
    x = (x | x << np.uint64(16)) & np.uint64(0x1F0000FF0000FF)
    x = (x | x << np.uint64(8)) & np.uint64(0x100F00F00F00F00F)
    x = (x | x << np.uint64(4)) & np.uint64(0x10C30C30C30C30C3)
    return (x | x << np.uint64(2)) & np.uint64(0x1249249249249249)


@inline
def _middle(lower, upper, i, axis):
    return 0.5 * lower[i, axis] + 0.5 * upper[i, axis]


@inline
def _extent(lower, upper, i):
    return max(upper[i, 0] - lower[i, 0], max(upper[i, 1] - lower[i, 1], upper[i, 2] - lower[i, 2]))


@njit()
def curve_order(lower, upper):
    """Order the boxes of the tree by size class, large boxes first, then along a Morton curve through their middles.

    Large boxes among small ones would widen every group that contains them. The order affects only the speed of the
    search.
    """
    n = lower.shape[0]
    corner = np.full(3, np.inf)
    width = 0.0
    largest = 0.0
    for axis in range(3):
        end = -np.inf
        for i in range(n):
            middle = _middle(lower, upper, i, axis)
            corner[axis] = min(corner[axis], middle)
            end = max(end, middle)
        width = max(width, end - corner[axis])
    for i in range(n):
        largest = max(largest, _extent(lower, upper, i))
    top = float((1 << STEPS) - 1)
    scale = top / width if width > 0.0 else 0.0
    keys = np.empty(n, np.uint64)
    for i in range(n):
        size_class = 0
        size = _extent(lower, upper, i)
        bar = largest * SIZE_RATIO
        while size < bar and size_class < SIZE_CLASSES - 1:
            bar *= SIZE_RATIO
            size_class += 1
        key = np.uint64(size_class)
        code = np.uint64(0)
        for axis in range(3):
            step = (_middle(lower, upper, i, axis) - corner[axis]) * scale
            # If an overflow causes a NaN, this comparison is false, and the box counts as at the end of the axis.
            code |= _spread(np.uint64(step if step < top else top)) << np.uint64(axis)
        keys[i] = key << (np.uint64(3) * STEPS) | code
    return _sorted_by(keys)


@njit()
def _sorted_by(keys):
    """Stable order of 64-bit keys, by radix sort; digits in which no two keys differ take no time."""
    n = keys.shape[0]
    buckets = 1 << DIGIT
    last = np.uint64(buckets - 1)
    counts = np.zeros((PASSES, buckets), np.int64)
    for key in keys:
        for p in range(PASSES):
            counts[p, (key >> (DIGIT * np.uint64(p))) & last] += 1
    order = np.arange(n)
    other = np.empty(n, np.int64)
    for p in range(PASSES):
        places = counts[p]
        fullest = 0
        for b in range(buckets):
            fullest = max(fullest, places[b])
        if fullest == n:
            continue
        total = 0
        for b in range(buckets):
            total, places[b] = total + places[b], total
        for i in order:
            digit = (keys[i] >> (DIGIT * np.uint64(p))) & last
            other[places[digit]] = i
            places[digit] += 1
        order, other = other, order
    return order


# -- tree --------------------------------------------------------------------------------------


@njit()
def box_tree(lower, upper, order):
    """Build the tree over the boxes in their order.

    Returns
    -------
    boxes : ndarray
        Groups of all levels, leaves first, with `ROWS` numbers each.
    level_start : ndarray of int64
        First group of each level; the last level is a single group.
    """
    n = order.shape[0]
    level_start = np.zeros(LEVELS, np.int64)
    groups = (n + WIDE - 1) // WIDE
    levels = 1
    total = groups
    while groups > 1:
        groups = (groups + WIDE - 1) // WIDE
        level_start[levels] = total
        total += groups
        levels += 1
    boxes = np.empty(total * ROWS)
    # The boxes that pad the last group of a level meet no box.
    for at in range(0, total * ROWS, ROWS):
        for c in range(3 * WIDE):
            boxes[at + c] = np.inf
            boxes[at + 3 * WIDE + c] = -np.inf
    for place in range(n):
        at = place // WIDE * ROWS + place % WIDE
        for axis in range(3):
            boxes[at + axis * WIDE] = lower[order[place], axis]
            boxes[at + (3 + axis) * WIDE] = upper[order[place], axis]
    for level in range(1, levels):
        below = level_start[level - 1]
        for node in range(level_start[level] - below):
            at = (level_start[level] + node // WIDE) * ROWS + node % WIDE
            source = (below + node) * ROWS
            for row in range(3):
                low = boxes[source + row * WIDE]
                high = boxes[source + (3 + row) * WIDE]
                for c in range(1, WIDE):
                    low = min(low, boxes[source + row * WIDE + c])
                    high = max(high, boxes[source + (3 + row) * WIDE + c])
                boxes[at + row * WIDE] = low
                boxes[at + (3 + row) * WIDE] = high
    return boxes, level_start[:levels].copy()


@inline
def _query(boxes, group, lane, margin):
    """Box of a lane, widened by `margin` on every side."""
    at = group * ROWS + lane
    return (
        lowered(boxes[at], margin),
        lowered(boxes[at + WIDE], margin),
        lowered(boxes[at + 2 * WIDE], margin),
        raised(boxes[at + 3 * WIDE], margin),
        raised(boxes[at + 4 * WIDE], margin),
        raised(boxes[at + 5 * WIDE], margin),
    )


@njit()
def _later_leaves(leaf, margin, boxes, level_start, stack, depth, near, numbers):
    """Collect the leaf groups after `leaf` whose boxes are within `margin` of the box of `leaf`.

    The boxes of the groups are written to `near`, in groups as in `boxes`, and their numbers to `numbers`; returns the
    count of the groups.
    """
    count = 0
    if level_start.shape[0] == 1:
        return count
    lx, ly, lz, ux, uy, uz = _query(boxes, level_start[1] + leaf // WIDE, leaf % WIDE, margin)
    node = leaf
    # Each later leaf descends from a node that, on one of the levels, follows `node` in the same group.
    for level in range(1, level_start.shape[0]):
        group = node // WIDE
        mask = meeting(boxes, level_start[level] + group, lx, ly, lz, ux, uy, uz) & (-2 << node % WIDE)
        above = 0
        while mask != 0:
            lane, mask = next_lane(mask)
            stack[above], depth[above] = group * WIDE + lane, level
            above += 1
        while above > 0:
            above -= 1
            descendant = stack[above]
            below = depth[above] - 1
            if below > 0:
                mask = meeting(boxes, level_start[below] + descendant, lx, ly, lz, ux, uy, uz)
                while mask != 0:
                    lane, mask = next_lane(mask)
                    stack[above], depth[above] = descendant * WIDE + lane, below
                    above += 1
                continue
            numbers[count] = descendant
            source = (level_start[1] + descendant // WIDE) * ROWS + descendant % WIDE
            target = count // WIDE * ROWS + count % WIDE
            for row in range(6):
                near[target + row * WIDE] = boxes[source + row * WIDE]
            count += 1
        node = group
    for lane in range(count, (count + WIDE - 1) // WIDE * WIDE):
        target = lane // WIDE * ROWS + lane % WIDE
        for row in range(3):
            near[target + row * WIDE] = np.inf
            near[target + (3 + row) * WIDE] = -np.inf
    return count


@inline
def _note(body, leaf, mask, order, rows_a, rows_b, count):
    """Write the pairs that a body forms with the bodies of a leaf group whose bits are set in a mask."""
    while mask != 0:
        lane, mask = next_lane(mask)
        other = order[leaf * WIDE + lane]
        rows_a[count], rows_b[count] = min(body, other), max(body, other)
        count += 1
    return count


@njit()
def meeting_boxes(first, last, margin, boxes, level_start, order, rows_a, rows_b):
    """Find pairs of boxes within `margin` of each other: one box from leaf groups first .. last, and a later box.

    The tree is searched once for all eight boxes of a leaf group, and each box is then compared with the results.

    Parameters
    ----------
    first, last : int
        Leaf groups.
    boxes, level_start : see `box_tree`
    rows_a, rows_b : ndarray of int64
        Receive the pairs, with the smaller number in `rows_a`. The arrays must be at least `WIDE` times as long as
        `order`.

    Returns
    -------
    leaf, count : int
        The leaf at which to continue (the buffers may be full before `last`), and the number of pairs written.
    """
    n = order.shape[0]
    leaves = (n + WIDE - 1) // WIDE
    stack = np.empty(LEVELS * WIDE, np.int64)
    depth = np.empty(LEVELS * WIDE, np.int64)
    near = np.empty((leaves + WIDE) * 6)
    numbers = np.empty(leaves, np.int64)
    count = 0
    for leaf in range(first, last):
        if count + WIDE * (n - leaf * WIDE) > rows_a.shape[0]:
            return leaf, count
        behind = _later_leaves(leaf, margin, boxes, level_start, stack, depth, near, numbers)
        for lane in range(min(WIDE, n - leaf * WIDE)):
            lx, ly, lz, ux, uy, uz = _query(boxes, leaf, lane, margin)
            body = order[leaf * WIDE + lane]
            mask = meeting(boxes, leaf, lx, ly, lz, ux, uy, uz) & (-2 << lane)
            count = _note(body, leaf, mask, order, rows_a, rows_b, count)
            for group in range((behind + WIDE - 1) // WIDE):
                met = meeting(near, group, lx, ly, lz, ux, uy, uz)
                while met != 0:
                    lane, met = next_lane(met)
                    other = numbers[group * WIDE + lane]
                    mask = meeting(boxes, other, lx, ly, lz, ux, uy, uz)
                    count = _note(body, other, mask, order, rows_a, rows_b, count)
    return last, count
