"""Records of arrays that kernels take as one number, and the tables behind these numbers.

A call from Python takes 150 ns for every array that it passes, and 20 ns for a number. A handle is the address of a
small table that holds the address and the shape of each array of a record.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels.columns import CACHE_LINE

ENTRIES = 3  # Number of entries of a table for each array: address, rows and columns (1 column for a flat array).


def table_of(arrays: Any) -> Any:
    """Return the table to which a handle points; arrays and table must outlive the handle."""
    rows = [(array.ctypes.data, array.shape[0], array.shape[1] if array.ndim == 2 else 1) for array in arrays]
    return np.array(rows, dtype=np.int64)


def aligned(count: int, kind: Any = np.float64) -> Any:
    """Make an uninitialised flat array that starts at a cache line."""
    raw = np.empty(count + CACHE_LINE, kind)
    skip = -raw.ctypes.data % CACHE_LINE // raw.itemsize
    return raw[skip : skip + count]


class Pieces(NamedTuple):
    """Packed pieces of a set of bodies; the arrays are described in `shapes`."""

    table: Any
    layout: Any
    points: Any
    piece_start: Any
    hot: Any
    single: Any
    groups: Any
    children: Any
    roots: Any
    vertices: Any
    parts: Any
    part_start: Any


class Placed(NamedTuple):
    """Row `piece` of packed pieces at pose `row` of an array of poses, shape (N, 4, 4)."""

    table: Any
    layout: Any
    points: Any
    piece: Any
    poses: Any
    row: Any


class Tree(NamedTuple):
    """A robot for kernels: six arrays, described in `robots.kinematics`."""

    parent: Any
    kind: Any
    column: Any
    multiplier: Any
    offset: Any
    constants: Any


class Problem(NamedTuple):
    """The input of `robots.configurations`.

    Attributes
    ----------
    tree : Tree
    link : ndarray of int64, shape (moving bodies,)
    ball : ndarray, shape (moving bodies, 5)
        Center and radius of a ball about each body, in the body's frame, and the reach of the body: its largest
        distance from the origin.
    pairs : ndarray of int64, shape (pairs, 2)
        Indices of two bodies; the first body moves.
    margins : ndarray, shape (pairs,)
    order : ndarray of int64, shape (pairs,)
        The order in which pairs are taken.
    standing : ndarray of float32, shape (static bodies, BOUNDS)
    standing_rows : ndarray of float32, shape (their pieces, HOT)
        Ellipsoids in world coordinates.
    standing_poses : ndarray, shape (static bodies, 16)
    """

    tree: Any
    link: Any
    ball: Any
    pairs: Any
    margins: Any
    order: Any
    standing: Any
    standing_rows: Any
    standing_poses: Any


class KeptAxis(NamedTuple):
    """An axis of a link that must stay within an angle of a direction in the world, for `robots.lines`.

    Attributes
    ----------
    chain, constants, ranges : ndarray
        Documented in `robots.reach`.
    columns : ndarray of int64, shape (K,)
        Columns of the values in a configuration of the robot.
    numbers : ndarray, shape (3, 9)
        The first row holds the least cosine, the axis and the direction, then the tolerance of `bring_back`. The other
        rows hold two rotations, each by rows: first a rotation whose third column is the axis, then a rotation whose
        third row is the direction.
    """

    chain: Any
    constants: Any
    ranges: Any
    columns: Any
    numbers: Any


class Search(NamedTuple):
    """A search for a path by two trees, for `robots.planning`, with `joints` values that move.

    Attributes
    ----------
    handles, lengths : ndarray
        Documented in `free_motions.judge_of`.
    columns : ndarray of int64, shape (joints,)
        Columns of the values in a configuration of the robot.
    turning : ndarray of int64, shape (joints,)
        1 for a value without limits that whole turns do not change, otherwise 0.
    lower, upper : ndarray, shape (joints,)
        Range from which values are drawn. For turning values, the kernels write half a turn to either side of `start`.
    stride, shift : ndarray, shape (joints,)
        The k-th draw consists of the fractional parts of shift + k stride. The kernels write both arrays.
    weights : ndarray, shape (joints,)
        Factors by which differences count in distances.
    reach : ndarray, shape (3,)
        The longest motion of a tree; an upper bound on the cost of a path, infinite if any cost is allowed; and how
        close the trees came to each other. The kernels write these entries, and a caller may change the first two.
    state : ndarray of int64, shape (columns.STATE,)
        Counts and results of the search, see `columns`.
    start : ndarray, shape (dof,)
        The root of the first tree, including the values that do not move.
    trees : ndarray, shape (2 joints + columns.TREE_ROWS, capacity)
        Memory, see `robots.planning.Trees`. When columns are added, the old columns keep their rows.
    """

    handles: Any
    lengths: Any
    columns: Any
    turning: Any
    lower: Any
    upper: Any
    stride: Any
    shift: Any
    weights: Any
    reach: Any
    state: Any
    start: Any
    trees: Any


class MotionTables(NamedTuple):
    """The input of `robots.motions` in addition to a `Problem`.

    Attributes
    ----------
    path_start : ndarray of int64, shape (L + 1,)
    path_link : ndarray of int64
        Joints between the world and link l, beginning next to the world: entries path_start[l] .. path_start[l + 1].
        The number of a joint is the number of the link that it moves.
    reach : ndarray, shape (bodies, L)
        Largest distance of a body from the axis of a turning joint, for any angles of the joints between them, with
        sliding joints at 0. The distance is measured in the frame on the other side of the joint.
    standing_rows : ndarray, shape (pieces of static bodies, HOT)
        Ellipsoids in world coordinates, in double precision.
    sizes : ndarray, shape (static bodies,)
        Sum of the lengths from which positions of each body's points are computed.
    order : ndarray of int64, shape (pairs,)
        The order in which pairs are taken.
    group_start : ndarray of int64, shape (moving bodies + 1,)
    group_pairs : ndarray of int64, shape (8 groups,)
    groups : ndarray, shape (64 groups,)
        Static bodies against which moving body b is checked, in groups of eight: groups group_start[b] .. group_start[b
        + 1]; repeats fill the last group. `group_pairs` holds the numbers of the pairs. `groups` holds eight vectors
        for each group: the centers and half widths of boxes, margins and sizes.
    chain : ndarray, shape (3,)
        For the longest chain of joints: the number of joints plus one, and the sum of its lengths with sliding joints
        at 0. The last entry bounds the sum of the deviations of all links' rotations from orthonormality.
    """

    path_start: Any
    path_link: Any
    reach: Any
    standing_rows: Any
    sizes: Any
    order: Any
    group_start: Any
    group_pairs: Any
    groups: Any
    chain: Any


# Types of the arrays of `MotionTables`, in the notation of `entries`.
MOTION_WORDS = "I1 I1 F2 F2 F1 I1 I1 I1 F1 F1"

# The table of a `Problem` is followed by the table of its `MotionTables`. PROBLEM_ROWS and MOTION_ROWS map the name of
# an array to its row, counted from the start of the first table. MOTIONS is the number of bytes before the second
# table. TABLE is the number of words in both tables together, which fill whole cache lines.
PROBLEM_ROWS = {name: row for row, name in enumerate((*Tree._fields, *Problem._fields[1:]))}
MOTION_ROWS = {name: row for row, name in enumerate(MotionTables._fields, len(PROBLEM_ROWS))}
MOTIONS = 8 * ENTRIES * len(PROBLEM_ROWS)
TABLE = ENTRIES * (len(PROBLEM_ROWS) + len(MOTION_ROWS))


class PlaneModel(NamedTuple):
    """The input of `robots.plane_trees`: bodies with their pieces, and joints, numbered as in a proof's model.

    Attributes
    ----------
    points : ndarray
        Corners of hulls in the frame of the link, and the radius about each corner, in blocks of eight columns with
        four rows.
    pieces : ndarray, shape (P, 14)
        Kind, radius, center and factor of each piece in the frame of its link; only curved pieces have a center and a
        factor.
    clusters : ndarray of int64, shape (C, 7)
        Consecutive pieces of a body: the first piece, and the number after the last one; the two halves, or -1 for a
        single piece; the columns of `points` where corners begin and end; and the number of curved pieces. The clusters
        of a body are consecutive.
    boxes : ndarray, shape (C, 9)
        A box about each cluster along the axes of the body: its center in the frame of the link, and half its edges;
        then a point inside the pieces. The kernel writes this array.
    bodies : ndarray of int64, shape (B, 3)
        Link, -1 for the world; the robot's link with the same pose; and the cluster of all pieces of the body.
    turns : ndarray, shape (B, 9)
        Rotation from the frame of the body to the frame of its link.
    balls : ndarray, shape (B, 4)
        Center and radius of a ball about each body. The kernel writes this array.
    pairs : ndarray of int64, shape (N, 2)
    margins : ndarray, shape (N,)
    ways : ndarray of int64, shape (L, 2)
        The link above each link, -1 for the world, and the number of links above it.
    joints : ndarray, shape (L, 17)
        How each link moves; the norm of the axis vector along which it slides; the rotation and translation of the
        joint; and its unit axis.
    """

    points: Any
    pieces: Any
    clusters: Any
    boxes: Any
    bodies: Any
    turns: Any
    balls: Any
    pairs: Any
    margins: Any
    ways: Any
    joints: Any
