"""Prepare bodies for `configurations` and `motions`: balls about moving bodies, bounds and rows of static ones.

A static body is placed again only if its pose has changed.

For proofs of motions, a ball about each body is carried along the tree of joints, starting at the joint next to the
body. A joint that turns sweeps the ball around its axis, and a ball about the swept region is carried on to the next
joint. Sliding joints are at 0 here; `motion_bounds` adds their travel for each motion. docs/certified.md, "Motions",
derives the bounds.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import (
    BLOCK,
    CACHE_LINE,
    COSINE,
    FIXED,
    HOT,
    INNER_CENTER,
    INNER_SHAPE,
    INVERSE_INNER_SIGMA,
    KIND,
    MAPPED,
    OUTER_CENTER,
    OUTER_RADIUS,
    OUTER_SHAPE,
    PLANAR,
    POINTS_FROM,
    POINTS_TO,
    POLYTOPE,
    PRISMATIC,
    REACH,
    REVOLUTE,
    ROTATION,
    TRANSLATION,
)
from loewner._kernels.linalg3 import apply, apply_transposed, dot, image, minus, one_norm, plus, rotated_shape, scaled
from loewner._kernels.pieces.pack import motion_tables_of, pieces_of, problem_of
from loewner._kernels.records import ENTRIES, MOTIONS, TABLE
from loewner._kernels.simd.memory import held, integers_at
from loewner._kernels.simd.vectors import LANES, broadcast, highest, load, lowest, maximum, minimum
from loewner._kernels.tolerances import CHAIN_STRETCH, LEAST, OFF, ROTATION_TOLERANCE, SHAPE_ROUNDINGS, UP

# Factor that allows for rounding, and for poses that are accepted as rigid but may stretch lengths. The pose of a
# robot's base also stretches the reaches.
STRETCH = 1.0 + 4.0 * ROTATION_TOLERANCE

LINE = CACHE_LINE // 8  # Number of 8-byte words in a cache line.


class _Box(NamedTuple):
    """Corners of a box along the axes."""

    lower: Any
    upper: Any


@inline
def _three(array, row, at):
    return array[row, at], array[row, at + 1], array[row, at + 2]


@inline
def _six(array, row, at):
    return (
        array[row, at], array[row, at + 1], array[row, at + 2], array[row, at + 3], array[row, at + 4],
        array[row, at + 5],
    )  # fmt: skip


@inline
def _nine(array, row, at):
    return (
        array[row, at], array[row, at + 1], array[row, at + 2], array[row, at + 3], array[row, at + 4],
        array[row, at + 5], array[row, at + 6], array[row, at + 7], array[row, at + 8],
    )  # fmt: skip


@inline
def _write(array, row, at, values):
    for k in range(len(values)):
        array[row, at + k] = values[k]


@inline
def _is_polytope(pieces, piece):
    return pieces.layout[piece, KIND] == POLYTOPE or pieces.layout[piece, KIND] == MAPPED


@inline
def _placed_block(points, column, R, t):
    """Eight points of a piece, starting at a column, placed by a pose."""
    at = 3 * column
    return plus(apply(R, (load(points, at), load(points, at + BLOCK), load(points, at + 2 * BLOCK))), t)


@njit()
def _box_of_corners(pieces, piece, R, t):
    """The box about the corners of a placed polytope."""
    least = broadcast(np.inf), broadcast(np.inf), broadcast(np.inf)
    most = broadcast(-np.inf), broadcast(-np.inf), broadcast(-np.inf)
    for column in range(pieces.layout[piece, POINTS_FROM], pieces.layout[piece, POINTS_TO], BLOCK):
        p = _placed_block(pieces.points, column, R, t)
        least = minimum(least[0], p[0]), minimum(least[1], p[1]), minimum(least[2], p[2])
        most = maximum(most[0], p[0]), maximum(most[1], p[1]), maximum(most[2], p[2])
    return _Box(
        (lowest(least[0]), lowest(least[1]), lowest(least[2])), (highest(most[0]), highest(most[1]), highest(most[2]))
    )


@njit()
def _farthest(pieces, first, last, R, t, center):
    """Upper bound, up to rounding, on the distance from a point to the farthest point of placed pieces."""
    squared, reached = broadcast(0.0), 0.0
    for piece in range(first, last):
        if _is_polytope(pieces, piece):
            for column in range(pieces.layout[piece, POINTS_FROM], pieces.layout[piece, POINTS_TO], BLOCK):
                r = minus(_placed_block(pieces.points, column, R, t), center)
                squared = maximum(squared, dot(r, r))
        else:
            r = minus(image(R, t, _three(pieces.table, piece, OUTER_CENTER)), center)
            reached = max(reached, np.sqrt(dot(r, r)) + pieces.table[piece, OUTER_RADIUS])
    return max(reached, np.sqrt(highest(squared)))


@inline
def _joint(tree, link):
    """Rotation and translation of a joint at 0, and its unit axis in the frame that it moves (0 for any axis)."""
    fixed, cosine = _nine(tree.constants, link, ROTATION), _nine(tree.constants, link, COSINE)
    R = (
        fixed[0] + cosine[0], fixed[1] + cosine[1], fixed[2] + cosine[2], fixed[3] + cosine[3], fixed[4] + cosine[4],
        fixed[5] + cosine[5], fixed[6] + cosine[6], fixed[7] + cosine[7], fixed[8] + cosine[8],
    )  # fmt: skip
    axis = 0.0, 0.0, 0.0
    if tree.kind[link] == REVOLUTE or tree.kind[link] == PLANAR:
        largest = 0.0
        for row in range(3):  # The vector v is a row of R axis axisᵀ, a multiple of the axis.
            v = _three(tree.constants, link, ROTATION + 3 * row)
            if dot(v, v) > largest:
                largest, axis = dot(v, v), v
        axis = scaled(1.0 / np.sqrt(dot(axis, axis)), axis)
    return R, _three(tree.constants, link, TRANSLATION), axis


@inline
def _swept(kind, center, radius, axis):
    """Farthest reach of a ball from a joint's axis, and a ball about the region swept as the joint turns."""
    if kind in (FIXED, PRISMATIC):
        return 0.0, center, radius
    # For a floating or ball joint, `axis` is 0 here, because the joint may turn about any axis through its origin.
    onto = scaled(dot(axis, center), axis)
    r = minus(center, onto)
    far = np.sqrt(dot(r, r)) + radius
    return far, onto, far


@njit()
def _write_reaches(tree, link, center, radius, reach, body, balls):
    """Write the largest distances of a ball's points from the axes of all joints.

    Parameters
    ----------
    link : int
        Link in whose frame the ball is given; -1 is the world.
    balls : ndarray, shape (L + 1, 4)
        Scratch: the ball in the frame of each link; the world comes last.
    """
    links = len(tree.parent)
    for k in range(links + 1):
        balls[k, 3] = np.nan
    for k in range(links):
        reach[body, k] = 0.0
    at = link if link >= 0 else links
    _write(balls, at, 0, center)
    balls[at, 3] = radius
    while at < links:  # Go up, from each link to its parent.
        R, t, axis = _joint(tree, at)
        far, c, r = _swept(tree.kind[at], _three(balls, at, 0), balls[at, 3], axis)
        reach[body, at] = far * CHAIN_STRETCH
        at = tree.parent[at] if tree.parent[at] >= 0 else links
        _write(balls, at, 0, image(R, t, c))
        balls[at, 3] = r
    for k in range(links):  # Go down, from each link to its children.
        above = tree.parent[k] if tree.parent[k] >= 0 else links
        if balls[k, 3] == balls[k, 3] or balls[above, 3] != balls[above, 3]:
            continue
        R, t, axis = _joint(tree, k)
        far, c, r = _swept(tree.kind[k], apply_transposed(R, minus(_three(balls, above, 0), t)), balls[above, 3], axis)
        reach[body, k] = far * CHAIN_STRETCH
        _write(balls, k, 0, c)
        balls[k, 3] = r


@njit()
def measure_moving(pack, problem_handle, tables_handle):
    """Write the balls about all moving bodies, and their reaches."""
    pieces, problem, tables = pieces_of(pack), problem_of(problem_handle), motion_tables_of(tables_handle)
    balls = np.empty((len(problem.tree.parent) + 1, 4))
    same, zero = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    for body in range(len(problem.link)):
        first, last = pieces.piece_start[body], pieces.piece_start[body + 1]
        least = most = _three(pieces.table, first, OUTER_CENTER)
        for piece in range(first + 1, last):
            c = _three(pieces.table, piece, OUTER_CENTER)
            least = min(least[0], c[0]), min(least[1], c[1]), min(least[2], c[2])
            most = max(most[0], c[0]), max(most[1], c[1]), max(most[2], c[2])
        # For a body with a single piece, the kernels assume that this point is also the center of the outer ellipsoid.
        middle = scaled(0.5, plus(least, most))
        radius = _farthest(pieces, first, last, same, zero, middle) * STRETCH
        _write(problem.ball, body, 0, middle)
        problem.ball[body, 3] = radius
        problem.ball[body, 4] = (np.sqrt(dot(middle, middle)) + radius) * STRETCH
        _write_reaches(problem.tree, problem.link[body], middle, radius, tables.reach, body, balls)


@njit()
def place_static(pack, handle, block, poses):
    """Copy a problem's block of memory, and place the static bodies whose poses differ from the poses in the block.

    Parameters
    ----------
    pack, handle : int
        Handles of the bodies and of the problem. The handle of the problem is the start of a block: the tables of
        `records.Problem` and `records.MotionTables`, followed by all arrays that depend on poses.
    block : ndarray
        Receives the new block, starting at the first cache line. If the old block begins there, it is changed in place.
        Bodies that stay where they are take no time.
    poses : ndarray, shape (static bodies, 16)

    Returns
    -------
    int
        Handle of the new problem.
    """
    words, new_handle = len(block) - LINE, np.int64(block.ctypes.data)
    new_handle += -new_handle % CACHE_LINE
    old, new = integers_at(handle, (words,)), integers_at(new_handle, (words,))
    for k in range(words if new_handle != handle else 0):
        new[k] = old[k]
    for at in range(0, TABLE, ENTRIES):
        if handle <= new[at] < handle + 8 * words:
            new[at] += new_handle - handle
    pieces, problem, tables = pieces_of(pack), problem_of(new_handle), motion_tables_of(new_handle + MOTIONS)
    balls = np.empty((len(problem.tree.parent) + 1, 4))
    moving, anything = len(problem.link), False
    for k in range(len(poses)):
        moved = False
        for entry in range(16):
            # The stored pose of a body that has not been placed yet is NaN.
            moved |= poses[k, entry] != problem.standing_poses[k, entry]
        if moved:
            for entry in range(16):
                problem.standing_poses[k, entry] = poses[k, entry]
            _place(pieces, problem, tables, moving, k, balls)
        anything |= moved
    if anything:
        _write_groups(problem, tables, moving)
    held(block)
    return new_handle


@njit()
def _place(pieces, problem, tables, moving, k, balls):
    """Write the rows, bounds and reaches of one static body."""
    T, rows, hot = problem.standing_poses, tables.standing_rows, pieces.hot
    R = T[k, 0], T[k, 1], T[k, 2], T[k, 4], T[k, 5], T[k, 6], T[k, 8], T[k, 9], T[k, 10]
    t = T[k, 3], T[k, 7], T[k, 11]
    first, last, behind = pieces.piece_start[moving + k], pieces.piece_start[moving + k + 1], pieces.piece_start[moving]
    x = y = z = np.inf
    far_x = far_y = far_z = -np.inf
    size, away = 0.0, one_norm(t)
    for piece in range(first, last):
        row = piece - behind
        for column in range(HOT):
            rows[row, column] = hot[piece, column]
        size = max(size, hot[piece, REACH])
        center, shape = image(R, t, _three(hot, piece, OUTER_CENTER)), rotated_shape(R, _six(hot, piece, OUTER_SHAPE))
        _write(rows, row, OUTER_CENTER, center)
        _write(rows, row, OUTER_SHAPE, shape)
        _write(rows, row, INNER_CENTER, image(R, t, _three(hot, piece, INNER_CENTER)))
        _write(rows, row, INNER_SHAPE, rotated_shape(R, _six(hot, piece, INNER_SHAPE)))
        rows[row, REACH] = (hot[piece, REACH] + away) * UP
        rows[row, OUTER_RADIUS] *= UP
        rows[row, INVERSE_INNER_SIGMA] *= UP
        # Numbers that are too large for single precision become infinite, and then certify nothing.
        for column in range(HOT):
            problem.standing_rows[row, column] = rows[row, column]
        # A piece lies in the box of its ellipsoid and, if it is a polytope, in the box of its corners.
        more = SHAPE_ROUNDINGS * (shape[0] + shape[3] + shape[5])
        half = np.sqrt(shape[0] + more), np.sqrt(shape[3] + more), np.sqrt(shape[5] + more)
        low, high = minus(center, half), plus(center, half)
        if _is_polytope(pieces, piece):
            box = _box_of_corners(pieces, piece, R, t)
            low = max(low[0], box.lower[0]), max(low[1], box.lower[1]), max(low[2], box.lower[2])
            high = min(high[0], box.upper[0]), min(high[1], box.upper[1]), min(high[2], box.upper[2])
        x, y, z = min(x, low[0]), min(y, low[1]), min(z, low[2])
        far_x, far_y, far_z = max(far_x, high[0]), max(far_y, high[1]), max(far_z, high[2])
    off = 2.0 * OFF * (size + away) + LEAST
    center = (x + far_x) / 2.0, (y + far_y) / 2.0, (z + far_z) / 2.0
    half = (far_x - x) / 2.0 + off, (far_y - y) / 2.0 + off, (far_z - z) / 2.0 + off
    ball = _farthest(pieces, first, last, R, t, center)
    wide = (min(ball, np.sqrt(dot(half, half))) + off) * STRETCH
    _write(problem.standing, k, 0, center)
    problem.standing[k, 3] = wide
    _write(problem.standing, k, 4, scaled(STRETCH, half))
    tables.sizes[k] = size + away
    if first < last:
        _write_reaches(problem.tree, -1, center, wide, tables.reach, moving + k, balls)


@njit()
def _write_groups(problem, tables, moving):
    """Write the vectors of the groups of static bodies."""
    for n in range(len(tables.group_pairs)):
        pair = tables.group_pairs[n]
        k = problem.pairs[pair, 1] - moving
        at = n // LANES * LANES * LANES + n % LANES
        for column in range(3):
            tables.groups[at + LANES * column] = problem.standing[k, column]
            tables.groups[at + LANES * (column + 3)] = problem.standing[k, column + 4]
        tables.groups[at + LANES * 6] = problem.margins[pair]
        tables.groups[at + LANES * 7] = tables.sizes[k]
