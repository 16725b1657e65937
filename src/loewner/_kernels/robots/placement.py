"""Placement of a robot and its scene in a block of configurations: poses, ellipsoids, bounds.

A block has S configurations, where S is a multiple of sixteen and at most MOST. Row b S + s holds the pose of the
moving body b at configuration s, and row p S + s the ellipsoids of the piece p. Static bodies have one row each. Their
rows follow the rows that S = MOST would take, so that static bodies stay in place when S changes.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import (
    BOUNDS,
    HOT,
    INNER_CENTER,
    INNER_SHAPE,
    OUTER_CENTER,
    OUTER_RADIUS,
    OUTER_SHAPE,
    REACH,
)
from loewner._kernels.linalg3 import apply, dot, minus, plus, rotated_shape, trace
from loewner._kernels.pieces.pack import pieces_of, problem_of
from loewner._kernels.robots.kinematics import link_entries, place_links, rotation_of_link, translation_of_link
from loewner._kernels.simd.memory import Arena, Place, floats, integers, singles, sizes_of
from loewner._kernels.simd.scalars import holds, number_at
from loewner._kernels.simd.vectors import (
    LANES,
    absolute,
    broadcast,
    load_single,
    maximum,
    minimum,
    movemask,
    scatter_transpose,
    scatter_transpose_rounded,
    sqrt,
    store_rounded,
)
from loewner._kernels.tolerances import LEAST, OFF, SHAPE_ROUNDINGS, SINGLE_ROUNDOFF, UP

MOST = 64  # Maximum number of configurations in a block.

# Columns of a body's bounds: a center, the radius of a sphere around this center, and the half widths of a box around
# it.
X, Y, Z, WIDE, HALF_X, HALF_Y, HALF_Z = 0, 1, 2, 3, 4, 5, 6


class Placement(NamedTuple):
    """The output of `place` and `stand`.

    Attributes
    ----------
    poses : ndarray, shape (rows, 4, 4)
        Poses of all bodies.
    ellipsoids : ndarray of float32, shape (rows, HOT)
        Ellipsoids of all pieces, in world coordinates.
    bounds : ndarray of float32
        Bounds of the moving bodies: BOUNDS rows of S numbers for each.
    links : ndarray
        Output of the kinematics, see `kinematics`.
    numbers : ndarray of int64, shape (8,)
        Row numbers of the lanes of a vector.
    """

    poses: Any
    ellipsoids: Any
    bounds: Any
    links: Any
    numbers: Any


class Counts(NamedTuple):
    """Numbers of bodies, pieces, pairs and links, which determine the sizes of memory."""

    links: Any
    dof: Any
    moving: Any
    moving_pieces: Any
    standing: Any
    standing_pieces: Any
    pairs: Any


@inline
def counts_of(pieces, problem, dof):
    """The counts of a problem."""
    moving = problem.link.size
    return Counts(
        problem.tree.parent.size, dof, moving, pieces.piece_start[moving], len(problem.standing),
        len(problem.standing_rows), len(problem.pairs),
    )  # fmt: skip


LINKS, DOF, MOVING, MOVING_PIECES, STANDING, STANDING_PIECES, PAIRS = sizes_of(Counts)

PLACEMENT = Arena(
    Placement,
    poses=floats(MOVING * MOST + STANDING, 4, 4),
    ellipsoids=singles(MOVING_PIECES * MOST + STANDING_PIECES, HOT),
    bounds=singles(BOUNDS * MOST * MOVING),
    links=floats(link_entries(LINKS, DOF)),
    numbers=integers(LANES),
)
placement_of = PLACEMENT.whole()


class _Ellipsoids(NamedTuple):
    """The ellipsoids of a piece in world coordinates: centers, shapes, and the length that scales rounding errors."""

    outer: Any
    P: Any
    inner: Any
    Q: Any
    length: Any


@inline
def _ellipsoids(hot, p, R, t):
    """The ellipsoids of piece p, with its link at one pose, or at eight side by side."""
    outer = plus(apply(R, (hot[p, OUTER_CENTER], hot[p, OUTER_CENTER + 1], hot[p, OUTER_CENTER + 2])), t)
    inner = plus(apply(R, (hot[p, INNER_CENTER], hot[p, INNER_CENTER + 1], hot[p, INNER_CENTER + 2])), t)
    k = OUTER_SHAPE
    P = rotated_shape(R, (hot[p, k], hot[p, k + 1], hot[p, k + 2], hot[p, k + 3], hot[p, k + 4], hot[p, k + 5]))
    k = INNER_SHAPE
    Q = rotated_shape(R, (hot[p, k], hot[p, k + 1], hot[p, k + 2], hot[p, k + 3], hot[p, k + 4], hot[p, k + 5]))
    length = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + hot[p, REACH]) * UP
    return _Ellipsoids(outer, P, inner, Q, length)


@inline
def _write_eight(hot, p, found, S, at, to):
    """Write the ellipsoids of piece p at eight configurations."""
    numbers, rows = to.numbers, to.ellipsoids
    first, second = (*found.outer, broadcast(hot[p, OUTER_RADIUS] * UP), *found.inner, found.length), OUTER_SHAPE + 6
    third = INNER_SHAPE + 6
    for lane in range(LANES):
        numbers[lane] = p * S + at + lane
    zero = 0
    scatter_transpose_rounded(rows, HOT, numbers, zero, zero, first)
    scatter_transpose_rounded(
        rows, HOT, numbers, zero, OUTER_SHAPE, (*found.P, broadcast(hot[p, second]), broadcast(hot[p, second + 1]))
    )
    scatter_transpose_rounded(
        rows, HOT, numbers, zero, INNER_SHAPE, (*found.Q, broadcast(hot[p, third] * UP), broadcast(0.0))
    )


@inline
def _write_one(hot, p, found, S, at, to):
    """Write the ellipsoids of piece p at one configuration."""
    row, second, third = p * S + at, OUTER_SHAPE + 6, INNER_SHAPE + 6
    rows = to.ellipsoids
    for k in range(3):
        rows[row, OUTER_CENTER + k], rows[row, INNER_CENTER + k] = found.outer[k], found.inner[k]
    rows[row, OUTER_RADIUS], rows[row, REACH] = hot[p, OUTER_RADIUS] * UP, found.length
    for k in range(6):
        rows[row, OUTER_SHAPE + k], rows[row, INNER_SHAPE + k] = found.P[k], found.Q[k]
    rows[row, second], rows[row, second + 1] = hot[p, second], hot[p, second + 1]
    rows[row, third], rows[row, third + 1] = hot[p, third] * UP, 0.0


@inline
def place_joints(problem, Q, first, last, to):
    """Compute the links' poses at the configurations first .. last, at most eight, for `place_body`."""
    for lane in range(LANES):
        to.numbers[lane] = min(first + lane, last)  # If there are fewer than eight, repeat the last one.
    place_links(problem.tree, Q, to.numbers, 0, to.links)


@inline
def _place_pieces(pieces, ball, body, R, t, S, at, to, write):
    """Place the pieces of a body whose link is at the pose R, t, and bound them: center, radius and half widths."""
    piece_start, hot = pieces.piece_start, pieces.hot
    p = piece_start[body]
    ellipsoids = _ellipsoids(hot, p, R, t)
    write(hot, p, ellipsoids, S, at, to)
    center, half = ellipsoids.outer, _half_widths(ellipsoids)
    wide = (OFF * ellipsoids.length + LEAST) + ball[body, 3] * UP
    if piece_start[body + 1] - p > 1:
        # The box has its center at the ball's center. If there are few pieces, the box contains the boxes of all
        # pieces; otherwise, it contains the ball.
        center = plus(apply(R, (ball[body, 0], ball[body, 1], ball[body, 2])), t)
        length = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + ball[body, 4]) * UP
        wide = wide + OFF * length
        few = pieces.roots[body] < 0
        half = _around(center, ellipsoids.outer, half) if few else (wide, wide, wide)
        for other in range(p + 1, piece_start[body + 1]):
            ellipsoids = _ellipsoids(hot, other, R, t)
            write(hot, other, ellipsoids, S, at, to)
            if few:
                reach = _around(center, ellipsoids.outer, _half_widths(ellipsoids))
                half = _wider(reach[0], half[0]), _wider(reach[1], half[1]), _wider(reach[2], half[2])
        slack = OFF * length
        half = minimum(half[0] + slack, wide), minimum(half[1] + slack, wide), minimum(half[2] + slack, wide)
    return center, wide, half


@inline
def _half_widths(found):
    """Half widths of the box around an outer ellipsoid."""
    P, off = found.P, OFF * found.length + LEAST
    slack = SHAPE_ROUNDINGS * trace(P)
    return off + UP * sqrt(P[0] + slack), off + UP * sqrt(P[3] + slack), off + UP * sqrt(P[5] + slack)


@njit()
def place_body(pack, problem_handle, address, counts, body, S, at):
    """Place a moving body at the configurations at .. at + 8 of a block, from the last output of `place_joints`.

    The function takes handles, because it is compiled separately from its callers, and each call would copy the arrays
    of a record.
    """
    pieces, problem, to = pieces_of(pack), problem_of(problem_handle), placement_of(Place(address, counts))
    W, numbers, bounds = to.links, to.numbers, to.bounds
    zero, one = broadcast(0.0), broadcast(1.0)
    nought = 0
    R, t = rotation_of_link(W, problem.link[body]), translation_of_link(W, problem.link[body])
    for lane in range(LANES):
        numbers[lane] = body * S + at + lane
    scatter_transpose(to.poses, 16, numbers, nought, nought, (R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1]))
    scatter_transpose(to.poses, 16, numbers, nought, 8, (R[6], R[7], R[8], t[2], zero, zero, zero, one))
    center, wide, half = _place_pieces(pieces, problem.ball, body, R, t, S, at, to, _write_eight)
    k = body * BOUNDS * S + at
    store_rounded(bounds, k + X * S, center[0])
    store_rounded(bounds, k + Y * S, center[1])
    store_rounded(bounds, k + Z * S, center[2])
    store_rounded(bounds, k + WIDE * S, wide * UP)
    store_rounded(bounds, k + HALF_X * S, half[0] * UP)
    store_rounded(bounds, k + HALF_Y * S, half[1] * UP)
    store_rounded(bounds, k + HALF_Z * S, half[2] * UP)


@njit()
def place_body_once(pack, problem_handle, address, counts, body, S):
    """Place a moving body only at a block's first configuration, in a quarter of the time that `place_body` takes."""
    pieces, problem, to = pieces_of(pack), problem_of(problem_handle), placement_of(Place(address, counts))
    W, bounds, pose = to.links, to.bounds, to.poses[body * S]
    first = problem.link[body] * (12 * LANES)
    R = (
        W[first], W[first + LANES], W[first + 2 * LANES], W[first + 3 * LANES], W[first + 4 * LANES],
        W[first + 5 * LANES], W[first + 6 * LANES], W[first + 7 * LANES], W[first + 8 * LANES],
    )  # fmt: skip
    t = W[first + 9 * LANES], W[first + 10 * LANES], W[first + 11 * LANES]
    for row in range(3):
        pose[row, 0], pose[row, 1], pose[row, 2], pose[row, 3] = R[3 * row], R[3 * row + 1], R[3 * row + 2], t[row]
        pose[3, row] = 0.0
    pose[3, 3] = 1.0
    center, wide, half = _place_pieces(pieces, problem.ball, body, R, t, S, 0, to, _write_one)
    k = body * BOUNDS * S
    for axis in range(3):
        bounds[k + (X + axis) * S], bounds[k + (HALF_X + axis) * S] = center[axis], half[axis] * UP
    bounds[k + WIDE * S] = wide * UP


@inline
def _around(middle, center, half):
    """Half widths of the box about `middle` that contains the box about `center`."""
    r = minus(center, middle)
    return absolute(r[0]) + half[0], absolute(r[1]) + half[1], absolute(r[2]) + half[2]


@inline
def _wider(x, y):
    """The larger width; NaN if either is NaN, or if x overflowed, because such a box bounds nothing."""
    return maximum(x, y) + 0.0 * x


@inline
def stand(problem, counts, to):
    """Write the static bodies, for blocks of any number of configurations."""
    behind = counts.moving * MOST
    for k in range(counts.standing):
        for row in range(4):
            for column in range(4):
                to.poses[behind + k, row, column] = problem.standing_poses[k, 4 * row + column]
    behind = counts.moving_pieces * MOST
    for k in range(counts.standing_pieces):
        for entry in range(HOT):
            to.ellipsoids[behind + k, entry] = problem.standing_rows[k, entry]


class Bounds(NamedTuple):
    """Bounds of one body at sixteen configurations: common center of a ball and a box, radius, half widths."""

    center: Any
    radius: Any
    half: Any


@inline
def _balls_apart(r, radius_a, radius_b, keep):
    """Mask of lanes in which balls whose centers differ by r are apart by `keep`."""
    far = ((radius_a + radius_b) + keep) * np.float32(UP)
    return dot(r, r) * np.float32(1.0 - 16.0 * SINGLE_ROUNDOFF) > far * far


@inline
def _boxes_apart(r, a, b, keep):
    """Mask of lanes in which boxes with half widths a and b, whose centers differ by r, are apart by `keep`."""
    up = np.float32(UP)
    clear = absolute(r[0]) > ((a[0] + b[0]) + keep) * up
    clear = clear | (absolute(r[1]) > ((a[1] + b[1]) + keep) * up)
    return clear | (absolute(r[2]) > ((a[2] + b[2]) + keep) * up)


@inline
def near(a, b, keep, live):
    """Bits of the configurations among `live` at which the bounds of two bodies are not apart by `keep`.

    Balls and boxes are always both compared, because a branch between them would be mispredicted.
    """
    r = minus(b.center, a.center)
    clear = _balls_apart(r, a.radius, b.radius, keep) | _boxes_apart(r, a.half, b.half, keep)
    return live & ~movemask(clear)


@inline
def near_once(bounds, body, S, others, other, other_S, keep):
    """Do the work of `near` at a block's first configuration, for rows of two tables; static bodies are a block of one.

    Most pairs of bodies are far apart, so the branch after the balls is usually predicted.
    """
    a, b = bounds.ctypes.data, others.ctypes.data
    i, j = body * BOUNDS * S, other * BOUNDS * other_S
    r = (
        number_at(b, j + X * other_S) - number_at(a, i + X * S),
        number_at(b, j + Y * other_S) - number_at(a, i + Y * S),
        number_at(b, j + Z * other_S) - number_at(a, i + Z * S),
    )
    if holds(_balls_apart(r, number_at(a, i + WIDE * S), number_at(b, j + WIDE * other_S), keep)):
        return False
    half_a = number_at(a, i + HALF_X * S), number_at(a, i + HALF_Y * S), number_at(a, i + HALF_Z * S)
    half_b = (
        number_at(b, j + HALF_X * other_S), number_at(b, j + HALF_Y * other_S), number_at(b, j + HALF_Z * other_S),
    )  # fmt: skip
    return not holds(_boxes_apart(r, half_a, half_b, keep))


@inline
def bounds_at(bounds, at, S):
    """Bounds of a moving body."""
    return Bounds(
        (load_single(bounds, at + X * S), load_single(bounds, at + Y * S), load_single(bounds, at + Z * S)),
        load_single(bounds, at + WIDE * S),
        (
            load_single(bounds, at + HALF_X * S),
            load_single(bounds, at + HALF_Y * S),
            load_single(bounds, at + HALF_Z * S),
        ),
    )


@inline
def bounds_standing(standing, k):
    """Bounds of a static body, repeated for all configurations."""
    return Bounds(
        (broadcast(standing[k, X]), broadcast(standing[k, Y]), broadcast(standing[k, Z])),
        broadcast(standing[k, WIDE]),
        (broadcast(standing[k, HALF_X]), broadcast(standing[k, HALF_Y]), broadcast(standing[k, HALF_Z])),
    )
