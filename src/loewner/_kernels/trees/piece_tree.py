"""Trees over the pieces of a body, and the walk through two trees to find piece pairs that could meet.

A tree is built as in `boxes`, over the boxes of the outer ellipsoids in the body's own frame, but with explicit links.
Child c of group g is ``children[8 g + c]``: a group if this number is not negative, otherwise ~piece. ``roots`` holds
the top group of each body, or -1 for a body with few pieces. Such a body has no tree: all its pieces are tried.

The walk takes the pieces of a that come near the box of b, in a's frame. For each such piece, it searches b's tree, in
b's frame, with the box of the piece's own ellipsoid in that frame. All roundings are outward. The rotation R of a pose
need not be orthonormal to the last bit. In the frame of its own axes, a body's point y then lies at RᵀR y instead of y,
and lengths are world lengths times at most the norm of R. `BEND` allows for both effects.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import FEW, OUTER_CENTER, OUTER_SHAPE, REACH, WIDE
from loewner._kernels.ellipsoids.contact import outward_width, position_error
from loewner._kernels.simd.vectors import next_lane
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees.boxes import LEVELS, ROWS, box_tree, curve_order, lowered, raised, within

# Bound on the effects of rotations that are not exactly orthonormal: each entry of RᵀR - 1 may be up to 1e-6
# (`rigid.ROTATION_TOLERANCE`). This deviation moves each coordinate of a point by less than BEND times the distance of
# the point from the body's origin, and stretches lengths by less than the fraction BEND. BEND exceeds these effects by
# far more than the rounding errors of distances.
BEND = 4e-6  # certified.md B21

# Indices of the integers of a walk.
PIECE, A_NEXT, A_END, B_NEXT, B_END, A_HEIGHT, B_HEIGHT = 0, 1, 2, 3, 4, 5, 6
A_STACK = 7
B_STACK = A_STACK + LEVELS * WIDE
STEPS = B_STACK + LEVELS * WIDE
# Indices of the floats of a walk: the box (lower, upper) of b in a's frame, the box of the piece in b's frame, the
# amounts by which the boxes are widened, the map from points of a to b's frame (rotation, shift), and the sum of the
# lengths, which determines the rounding errors.
B_BOX, PIECE_BOX, A_SLACK, B_SLACK, TURN, SHIFT, SIZE = 0, 6, 12, 13, 14, 23, 26
NUMBERS = 27


@njit()
def piece_trees(piece_start, lower, upper):
    """Build the trees of all bodies.

    Parameters
    ----------
    piece_start : ndarray of int64, shape (n + 1,)
    lower, upper : ndarray, shape (P, 3)
        Boxes of the pieces in the frames of their bodies, in metres.

    Returns
    -------
    groups : ndarray
        Groups in the layout of `boxes.box_tree`, with the groups of all bodies one after another.
    children : ndarray of int64
        Eight entries for each group.
    roots : ndarray of int64, shape (n,)
    """
    n = piece_start.shape[0] - 1
    roots = np.full(n, -1, np.int64)
    total = 0
    for body in range(n):
        level = piece_start[body + 1] - piece_start[body]
        if level < FEW:
            continue
        while level > 1:
            level = (level + WIDE - 1) // WIDE
            total += level
        roots[body] = total - 1
    groups = np.empty(total * ROWS)
    children = np.full(total * WIDE, -1, np.int64)
    first = 0
    for body in range(n):
        if roots[body] < 0:
            continue
        start, stop = piece_start[body], piece_start[body + 1]
        order = curve_order(lower[start:stop], upper[start:stop])
        boxes, level_start = box_tree(lower[start:stop], upper[start:stop], order)
        for entry in range(boxes.shape[0]):
            groups[first * ROWS + entry] = boxes[entry]
        for place in range(stop - start):
            children[first * WIDE + place] = ~(start + order[place])
        for level in range(1, level_start.shape[0]):
            below = level_start[level - 1]
            for node in range(level_start[level] - below):
                children[(first + level_start[level]) * WIDE + node] = first + below + node
        first = roots[body] + 1
    return groups, children, roots


@njit()
def begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers):
    """Start the walk over the piece pairs of two placed bodies.

    Parameters
    ----------
    a, b : tuple of ndarray
        Packed pieces, see `shapes`.
    ia, ib, ka, kb : int
        Rows of the bodies and of their poses.
    steps : ndarray of int64, shape (STEPS,)
    numbers : ndarray, shape (NUMBERS,)
        Receive the state of the walk.
    """
    steps[PIECE] = -1
    steps[B_NEXT], steps[B_END], steps[B_HEIGHT] = 0, 0, 0
    steps[A_NEXT], steps[A_END], steps[A_HEIGHT] = a.piece_start[ia], a.piece_start[ia + 1], 0
    root = a.roots[ia]
    size = 0.0
    for row in range(3):
        size += abs(Tb[kb, row, 3] - Ta[ka, row, 3])
        shift = 0.0
        for c in range(3):
            turn = 0.0
            for m in range(3):
                turn += Tb[kb, m, row] * Ta[ka, m, c]
            numbers[TURN + 3 * row + c] = turn
            shift += Tb[kb, c, row] * (Ta[ka, c, 3] - Tb[kb, c, 3])
        numbers[SHIFT + row] = shift
    reach_a = reach_of(a, ia)
    reach_b = reach_of(b, ib)
    numbers[SIZE] = size + reach_a + reach_b
    numbers[A_SLACK] = BEND * reach_a
    numbers[B_SLACK] = BEND * reach_b
    if root >= 0:
        _place_all(b, ib, Ta, ka, Tb, kb, numbers)
        steps[A_NEXT] = steps[A_END]
        steps[A_STACK] = root
        steps[A_HEIGHT] = 1


@njit()
def more(a, b, ib, margin, steps, numbers, pieces_a, pieces_b):
    """Continue a walk: find the next piece pairs that are not proven farther apart than `margin`.

    The margin may shrink from call to call.

    Parameters
    ----------
    a, b, ib, steps, numbers : see `begin`
    margin : float
        Margin in metres; at least 0.
    pieces_a, pieces_b : ndarray of int64
        Receive the pairs; the arrays' length limits their number.

    Returns
    -------
    int
        Number of pairs written; 0 at the end of the walk.
    """
    hot_a, groups_a, children_a = a.hot, a.groups, a.children
    groups_b, children_b, root = b.groups, b.children, b.roots[ib]
    reach = margin * (1.0 + BEND)
    count = 0
    while count < pieces_a.shape[0]:
        if steps[B_NEXT] < steps[B_END]:
            pieces_a[count] = steps[PIECE]
            pieces_b[count] = steps[B_NEXT]
            steps[B_NEXT] += 1
            count += 1
        elif steps[B_HEIGHT] > 0:
            steps[B_HEIGHT] -= 1
            node = steps[B_STACK + steps[B_HEIGHT]]
            if node < 0:
                pieces_a[count] = steps[PIECE]
                pieces_b[count] = ~node
                count += 1
            else:
                _open(groups_b, children_b, node, numbers, PIECE_BOX, B_SLACK, reach, steps, B_STACK, B_HEIGHT)
        else:
            if steps[A_NEXT] < steps[A_END]:
                piece = steps[A_NEXT]
                steps[A_NEXT] += 1
            elif steps[A_HEIGHT] > 0:
                steps[A_HEIGHT] -= 1
                node = steps[A_STACK + steps[A_HEIGHT]]
                if node >= 0:
                    _open(groups_a, children_a, node, numbers, B_BOX, A_SLACK, reach, steps, A_STACK, A_HEIGHT)
                    continue
                piece = ~node
            else:
                return count
            steps[PIECE] = piece
            if root < 0:
                steps[B_NEXT], steps[B_END] = b.piece_start[ib], b.piece_start[ib + 1]
            else:
                _place(hot_a, piece, numbers)
                steps[B_STACK] = root
                steps[B_HEIGHT] = 1
    return count


@njit()
def nearest_centers(a, ia, b, ib, numbers, rounds):
    """Find two pieces with close centers, by `rounds` of alternating nearest-center searches.

    The pieces are a starting guess; `begin` must have written `numbers`.
    """
    hot_a, hot_b = a.hot, b.hot
    c = OUTER_CENTER
    j = b.piece_start[ib]
    i = a.piece_start[ia]
    for _ in range(rounds):
        best = np.inf
        # Find the piece of body a whose center is nearest to the center of piece j; the centers are compared in b's
        # frame.
        for piece in range(a.piece_start[ia], a.piece_start[ia + 1]):
            squared = 0.0
            for row in range(3):
                squared += (_placed_center(hot_a, piece, numbers, row) - hot_b[j, c + row]) ** 2
            if squared < best:
                best = squared
                i = piece
        best = np.inf
        x = _placed_center(hot_a, i, numbers, 0)
        y = _placed_center(hot_a, i, numbers, 1)
        z = _placed_center(hot_a, i, numbers, 2)
        for piece in range(b.piece_start[ib], b.piece_start[ib + 1]):
            squared = (x - hot_b[piece, c]) ** 2 + (y - hot_b[piece, c + 1]) ** 2 + (z - hot_b[piece, c + 2]) ** 2
            if squared < best:
                best = squared
                j = piece
    return i, j


@inline
def _open(groups, children, group, numbers, box, slack, reach, steps, stack, height):
    """Push onto a stack the children of a group that come within `reach` of a box of the walk."""
    by = numbers[slack]
    mask = within(
        groups, group,
        lowered(numbers[box], by), lowered(numbers[box + 1], by), lowered(numbers[box + 2], by),
        raised(numbers[box + 3], by), raised(numbers[box + 4], by), raised(numbers[box + 5], by),
        reach * reach,
    )  # fmt: skip
    steps[height] = _push(children, group, mask, steps, stack + steps[height]) - stack


@inline
def open_group(a, group, box, reach, stack, height):
    """Push onto a stack the children of a group that come within `reach` of a box; return the height of the stack."""
    mask = within(a.groups, group, box[0], box[1], box[2], box[3], box[4], box[5], reach * reach)
    return _push(a.children, group, mask, stack, height)


@inline
def _push(children, group, mask, stack, height):
    while mask != 0:
        lane, mask = next_lane(mask)
        stack[height] = children[group * WIDE + lane]
        height += 1
    return height


@inline
def _shape(hot, piece):
    """Shape matrix of a piece's outer ellipsoid, in the frame of its body."""
    q = OUTER_SHAPE
    return (
        hot[piece, q], hot[piece, q + 1], hot[piece, q + 2], hot[piece, q + 3], hot[piece, q + 4], hot[piece, q + 5],
    )  # fmt: skip


@inline
def _placed_center(hot, piece, numbers, row):
    """Coordinate of the center of an outer ellipsoid of a in b's frame."""
    c = OUTER_CENTER
    turn = TURN + 3 * row
    return numbers[SHIFT + row] + (
        numbers[turn] * hot[piece, c] + numbers[turn + 1] * hot[piece, c + 1] + numbers[turn + 2] * hot[piece, c + 2]
    )


@njit()
def _place(hot, piece, numbers):
    """Compute the box of a piece of a in b's frame, and store it in the state of the walk."""
    for row in range(3):
        x, y, z = numbers[TURN + 3 * row], numbers[TURN + 3 * row + 1], numbers[TURN + 3 * row + 2]
        width, _ = outward_width(_shape(hot, piece), (x, y, z), x * x + y * y + z * z)
        width += position_error(numbers[SIZE], UNIT_ROUNDOFF)
        middle = _placed_center(hot, piece, numbers, row)
        numbers[PIECE_BOX + row] = middle - width
        numbers[PIECE_BOX + 3 + row] = middle + width


@njit()
def _place_all(b, ib, Ta, ka, Tb, kb, numbers):
    """Compute a box around all of b in a's frame, and store it in the state of the walk."""
    hot = b.hot
    root = b.roots[ib]
    c = OUTER_CENTER
    for row in range(3):
        shift = 0.0
        for m in range(3):
            shift += Ta[ka, m, row] * (Tb[kb, m, 3] - Ta[ka, m, 3])
        x, y, z = numbers[TURN + row], numbers[TURN + 3 + row], numbers[TURN + 6 + row]
        low = np.inf
        high = -np.inf
        if root < 0:
            for piece in range(b.piece_start[ib], b.piece_start[ib + 1]):
                width, _ = outward_width(_shape(hot, piece), (x, y, z), x * x + y * y + z * z)
                middle = x * hot[piece, c] + y * hot[piece, c + 1] + z * hot[piece, c + 2]
                low = min(low, middle - width)
                high = max(high, middle + width)
        else:
            low = 0.0
            high = 0.0
            for axis, along in enumerate((x, y, z)):
                near, far = _root_interval(b.groups, root, axis)
                low += min(along * near, along * far)
                high += max(along * near, along * far)
        error = position_error(numbers[SIZE], UNIT_ROUNDOFF)
        numbers[B_BOX + row] = shift + low - error
        numbers[B_BOX + 3 + row] = shift + high + error


@inline
def _root_interval(groups, root, axis):
    """Extent of a whole tree along an axis."""
    low = np.inf
    high = -np.inf
    for lane in range(WIDE):
        low = min(low, groups[root * ROWS + axis * WIDE + lane])
        high = max(high, groups[root * ROWS + (3 + axis) * WIDE + lane])
    return low, high


@njit()
def reach_of(a, ia):
    """Upper bound on the distance of any point of a body from the body's origin."""
    root = a.roots[ia]
    reach = 0.0
    if root < 0:
        for piece in range(a.piece_start[ia], a.piece_start[ia + 1]):
            reach = max(reach, a.hot[piece, REACH])
        return reach
    for axis in range(3):
        low, high = _root_interval(a.groups, root, axis)
        reach += max(-low, high)
    return reach
