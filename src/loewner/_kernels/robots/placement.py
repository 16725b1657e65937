"""Placement of a robot and its scene in a block of configurations: poses, ellipsoids, bounds.

In a block of S configurations, with S a multiple of sixteen and at most MOST, a moving body b has its pose at
configuration s in row b S + s, and a piece p its ellipsoids in row p S + s. Static bodies have one row each, after as
many rows as S = MOST takes, so they stay in place when S changes.
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

MOST = 64  # configurations in a block

# Columns of a body's bounds: center, radius of a sphere about it, half widths.
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
        Bounds of the moving bodies: BOUNDS rows of S numbers each.
    links : ndarray
        Output of the kinematics, see `kinematics`.
    numbers : ndarray of int64, shape (8,)
        Row numbers of a vector's lanes.
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


@inline
def _place_piece(hot, p, R, t, S, at, numbers, rows):
    """Write the ellipsoids of piece p at eight configurations; return center, length and squared half widths."""
    outer = plus(apply(R, (hot[p, OUTER_CENTER], hot[p, OUTER_CENTER + 1], hot[p, OUTER_CENTER + 2])), t)
    inner = plus(apply(R, (hot[p, INNER_CENTER], hot[p, INNER_CENTER + 1], hot[p, INNER_CENTER + 2])), t)
    k = OUTER_SHAPE
    P = rotated_shape(R, (hot[p, k], hot[p, k + 1], hot[p, k + 2], hot[p, k + 3], hot[p, k + 4], hot[p, k + 5]))
    k = INNER_SHAPE
    Q = rotated_shape(R, (hot[p, k], hot[p, k + 1], hot[p, k + 2], hot[p, k + 3], hot[p, k + 4], hot[p, k + 5]))
    length = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + hot[p, REACH]) * UP
    radius = hot[p, OUTER_RADIUS] * UP
    first, second = (*outer, broadcast(radius), *inner, length), OUTER_SHAPE + 6
    third = INNER_SHAPE + 6
    for lane in range(LANES):
        numbers[lane] = p * S + at + lane
    zero = 0
    scatter_transpose_rounded(rows, HOT, numbers, zero, zero, first)
    scatter_transpose_rounded(
        rows, HOT, numbers, zero, OUTER_SHAPE, (*P, broadcast(hot[p, second]), broadcast(hot[p, second + 1]))
    )
    scatter_transpose_rounded(
        rows, HOT, numbers, zero, INNER_SHAPE, (*Q, broadcast(hot[p, third] * UP), broadcast(0.0))
    )
    slack = SHAPE_ROUNDINGS * trace(P)
    return outer, length, (P[0] + slack, P[3] + slack, P[5] + slack)


@inline
def place_joints(problem, Q, first, last, to):
    """Compute the links' poses at the configurations first .. last, at most eight, for `place_body`."""
    for lane in range(LANES):
        to.numbers[lane] = min(first + lane, last)  # filled up with repeats of the last
    place_links(problem.tree, Q, to.numbers, 0, to.links)


@njit()
def place_body(pack, problem_handle, address, counts, body, S, at):
    """Place a moving body at the configurations at .. at + 8 of a block, from the last output of `place_joints`.

    It takes handles, since it is compiled separately from its callers and a record's arrays would be copied for each
    call.
    """
    pieces, problem, to = pieces_of(pack), problem_of(problem_handle), placement_of(Place(address, counts))
    link, ball, piece_start, hot = problem.link, problem.ball, pieces.piece_start, pieces.hot
    W, numbers, bounds = to.links, to.numbers, to.bounds
    zero, one = broadcast(0.0), broadcast(1.0)
    nought = 0
    R, t = rotation_of_link(W, link[body]), translation_of_link(W, link[body])
    for lane in range(LANES):
        numbers[lane] = body * S + at + lane
    scatter_transpose(to.poses, 16, numbers, nought, nought, (R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1]))
    scatter_transpose(to.poses, 16, numbers, nought, 8, (R[6], R[7], R[8], t[2], zero, zero, zero, one))
    p = piece_start[body]
    center, length, squares = _place_piece(hot, p, R, t, S, at, numbers, to.ellipsoids)
    off = OFF * length + LEAST
    wide = off + ball[body, 3] * UP
    half = off + UP * sqrt(squares[0]), off + UP * sqrt(squares[1]), off + UP * sqrt(squares[2])
    if piece_start[body + 1] - p > 1:
        # A box about the ball's center that contains the boxes of the pieces, if there are few, and otherwise the ball.
        middle = plus(apply(R, (ball[body, 0], ball[body, 1], ball[body, 2])), t)
        length = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + ball[body, 4]) * UP
        wide = wide + OFF * length
        few = pieces.roots[body] < 0
        half = _around(middle, center, half) if few else (wide, wide, wide)
        for other in range(p + 1, piece_start[body + 1]):
            center, length_of_piece, squares = _place_piece(hot, other, R, t, S, at, numbers, to.ellipsoids)
            if few:
                off = OFF * length_of_piece + LEAST
                reach = off + UP * sqrt(squares[0]), off + UP * sqrt(squares[1]), off + UP * sqrt(squares[2])
                reach = _around(middle, center, reach)
                half = _wider(reach[0], half[0]), _wider(reach[1], half[1]), _wider(reach[2], half[2])
        slack = OFF * length
        half = minimum(half[0] + slack, wide), minimum(half[1] + slack, wide), minimum(half[2] + slack, wide)
        center = middle
    k = body * BOUNDS * S + at
    store_rounded(bounds, k + X * S, center[0])
    store_rounded(bounds, k + Y * S, center[1])
    store_rounded(bounds, k + Z * S, center[2])
    store_rounded(bounds, k + WIDE * S, wide * UP)
    store_rounded(bounds, k + HALF_X * S, half[0] * UP)
    store_rounded(bounds, k + HALF_Y * S, half[1] * UP)
    store_rounded(bounds, k + HALF_Z * S, half[2] * UP)


@inline
def _around(middle, center, half):
    """Half widths of the box about `middle` that contains the box about `center`."""
    r = minus(center, middle)
    return absolute(r[0]) + half[0], absolute(r[1]) + half[1], absolute(r[2]) + half[2]


@inline
def _wider(x, y):
    """The larger width; NaN if either is NaN, or if x overflowed: such a box bounds nothing."""
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
    """Bounds of one body at sixteen configurations: center of a ball and a box about it, radius, half widths."""

    center: Any
    radius: Any
    half: Any


@inline
def near(a, b, keep, live):
    """The configurations among `live`, as bits, at which the bounds of two bodies are not apart by `keep`.

    Balls and boxes are always both computed: a branch between them would be mispredicted.
    """
    r, up = minus(b.center, a.center), np.float32(UP)
    far = ((a.radius + b.radius) + keep) * up
    clear = dot(r, r) * np.float32(1.0 - 16.0 * SINGLE_ROUNDOFF) > far * far
    clear = clear | (absolute(r[0]) > ((a.half[0] + b.half[0]) + keep) * up)
    clear = clear | (absolute(r[1]) > ((a.half[1] + b.half[1]) + keep) * up)
    clear = clear | (absolute(r[2]) > ((a.half[2] + b.half[2]) + keep) * up)
    return live & ~movemask(clear)


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
    """Bounds of a static body, at all configurations."""
    return Bounds(
        (broadcast(standing[k, X]), broadcast(standing[k, Y]), broadcast(standing[k, Z])),
        broadcast(standing[k, WIDE]),
        (broadcast(standing[k, HALF_X]), broadcast(standing[k, HALF_Y]), broadcast(standing[k, HALF_Z])),
    )
