"""Forward kinematics: the poses of a robot's links at eight configurations side by side.

A robot is a tree of links, each attached to its parent by one joint. Kernels receive it as a record of arrays, a
`records.Tree`, with one entry or row per link, parents first:

parent : ndarray of int64, shape (L,)
    The link from which this link's pose is computed; -1 for the world. Rigidly joined links form one moving group: the
    parent is the first link of the group to which the joint is attached.
kind : ndarray of int64, shape (L,)
    FIXED, REVOLUTE, PRISMATIC, PLANAR, FLOATING or BALL.
column : ndarray of int64, shape (L,)
    First column of the joint's values in a configuration; 0 for fixed joints, which read none.
multiplier, offset : ndarray, shape (L,)
    A joint with one value moves by multiplier * value + offset. Unless the joint mimics another joint, these are 1 and
    0.
constants : ndarray, shape (L, CONSTANTS)
    ROTATION (9 entries, by rows) and TRANSLATION [m] (3 entries) are the pose in `parent` of the link that the joint
    moves. The rotation of a turning joint is ROTATION + sin q SINE + cos q COSINE, with 9 entries each. ACROSS and
    ALONG (3 entries each) are unit vectors along which a planar joint slides by its first two values; a prismatic joint
    slides along ACROSS.

Eight poses are twelve vectors per link in a flat array W of float64: W[(12 link + r) * 8 + lane], where r = 0 .. 8 is
the rotation by rows, and r = 9 .. 11 the translation.
"""

from typing import Any

import numpy as np

from loewner._kernels._jit import apart, borrowed, inline, njit
from loewner._kernels.columns import (
    ACROSS,
    ALONG,
    BALL,
    COSINE,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    ROTATION,
    SINE,
    TRANSLATION,
)
from loewner._kernels.linalg3 import along, image, product, turned
from loewner._kernels.records import Tree
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.simd.vectors import LANES, broadcast, load, scatter_transpose, store

POSE = 12  # Number of vectors in W that hold a link's pose.


@inline
def quaternion_of(tree, link):
    """Return the first column of a joint's quaternion; -1 if the joint has none."""
    if tree.kind[link] == FLOATING:
        return tree.column[link] + 3
    return tree.column[link] if tree.kind[link] == BALL else -1


def link_entries(links: Any, dof: Any) -> Any:
    """Number of entries that `place_links` needs in W: the poses of all links, then eight configurations by columns."""
    return (links * POSE + dof) * LANES


workspace_size = inline(link_entries)


@inline
def triple_of(constants, link, k):
    """Three constants of a link, starting at column k."""
    return broadcast(constants[link, k]), broadcast(constants[link, k + 1]), broadcast(constants[link, k + 2])


@inline
def nine(constants, link, k):
    """Nine constants of a link, starting at column k."""
    return triple_of(constants, link, k) + triple_of(constants, link, k + 3) + triple_of(constants, link, k + 6)


@inline
def axis_of(constants, link):
    """Axis of a turning joint in the frame that it moves, from the derivative of its rotation at 0: ZᵀS is skew."""
    x = y = z = 0.0
    for r in range(3):
        at = 3 * r
        zero0 = constants[link, ROTATION + at] + constants[link, COSINE + at]
        zero1 = constants[link, ROTATION + at + 1] + constants[link, COSINE + at + 1]
        zero2 = constants[link, ROTATION + at + 2] + constants[link, COSINE + at + 2]
        x += zero2 * constants[link, SINE + at + 1]
        y += zero0 * constants[link, SINE + at + 2]
        z += zero1 * constants[link, SINE + at]
    return broadcast(x), broadcast(y), broadcast(z)


@inline
def turned_by(constants, link, angle):
    """Rotation of eight turning joints."""
    s, c = sine_cosine(angle)
    rest = nine(constants, link, ROTATION)
    return turned(rest, s, nine(constants, link, SINE), c, nine(constants, link, COSINE))


@inline
def by_quaternion(w, x, y, z):
    """Rotations for eight quaternions of any length except 0."""
    scale = 2.0 / (w * w + x * x + y * y + z * z)
    sx, sy, sz = scale * x, scale * y, scale * z
    wx, wy, wz, xx, xy, xz, yy, yz, zz = w * sx, w * sy, w * sz, x * sx, x * sy, x * sz, y * sy, y * sz, z * sz
    return 1.0 - (yy + zz), xy - wz, xz + wy, xy + wz, 1.0 - (xx + zz), yz - wx, xz - wy, yz + wx, 1.0 - (xx + yy)


@inline
def _store_pose(W, link, R, t):
    at = link * (POSE * LANES)
    store(W, at, R[0])
    store(W, at + LANES, R[1])
    store(W, at + 2 * LANES, R[2])
    store(W, at + 3 * LANES, R[3])
    store(W, at + 4 * LANES, R[4])
    store(W, at + 5 * LANES, R[5])
    store(W, at + 6 * LANES, R[6])
    store(W, at + 7 * LANES, R[7])
    store(W, at + 8 * LANES, R[8])
    store(W, at + 9 * LANES, t[0])
    store(W, at + 10 * LANES, t[1])
    store(W, at + 11 * LANES, t[2])


@inline
def rotation_of_link(W, link):
    """The rotations of a link by rows, as `place_links` wrote them."""
    at = link * (POSE * LANES)
    return (
        load(W, at),
        load(W, at + LANES),
        load(W, at + 2 * LANES),
        load(W, at + 3 * LANES),
        load(W, at + 4 * LANES),
        load(W, at + 5 * LANES),
        load(W, at + 6 * LANES),
        load(W, at + 7 * LANES),
        load(W, at + 8 * LANES),
    )


@inline
def translation_of_link(W, link):
    """The translations of a link, as `place_links` wrote them."""
    at = link * (POSE * LANES) + 9 * LANES
    return load(W, at), load(W, at + LANES), load(W, at + 2 * LANES)


@apart
def place_links(tree, Q, rows, at, W):
    """Write the world poses of all links of eight configurations to W, in the layout of this module.

    Parameters
    ----------
    tree : Tree
    Q : ndarray, shape (N, dof)
        Configurations in C order, validated by the caller (quaternions have norm 1). NaN leads to poses of NaN.
    rows : ndarray of int64
        Row numbers of Q, which may repeat; only the entries at .. at + 8 are used.
    at : int64
    W : ndarray, shape (workspace_size(links, dof),) or longer
        Receives the poses; the entries after the poses are scratch.
    """
    columns = columns_of(tree, W)
    for lane in range(LANES):
        row = rows[at + lane]
        for k in range(Q.shape[1]):
            columns[k * LANES + lane] = Q[row, k]
    place_columns(tree, W)


@inline
def columns_of(tree, W):
    """Return the part of W in which `place_columns` expects the values of eight configurations, by columns."""
    return borrowed(W)[tree.parent.size * (POSE * LANES) :]


@apart
def place_columns(tree, W):
    """Do the work of `place_links` for configurations that are already in W."""
    parent, kind, column = borrowed(tree.parent), borrowed(tree.kind), borrowed(tree.column)
    multiplier, offset, constants = borrowed(tree.multiplier), borrowed(tree.offset), borrowed(tree.constants)
    links = parent.size
    behind = links * (POSE * LANES)
    for link in range(links):
        what = kind[link]
        q = behind + column[link] * LANES
        R = nine(constants, link, ROTATION)
        t = triple_of(constants, link, TRANSLATION)
        if what == REVOLUTE:
            R = turned_by(constants, link, load(W, q) * multiplier[link] + offset[link])
        elif what == PRISMATIC:
            t = along(t, load(W, q) * multiplier[link] + offset[link], triple_of(constants, link, ACROSS))
        elif what == PLANAR:
            R = turned_by(constants, link, load(W, q + 2 * LANES))
            t = along(t, load(W, q), triple_of(constants, link, ACROSS))
            t = along(t, load(W, q + LANES), triple_of(constants, link, ALONG))
        elif what in (FLOATING, BALL):
            if what == FLOATING:
                t = image(R, t, (load(W, q), load(W, q + LANES), load(W, q + 2 * LANES)))
                q += 3 * LANES
            w, x, y, z = load(W, q), load(W, q + LANES), load(W, q + 2 * LANES), load(W, q + 3 * LANES)
            R = product(R, by_quaternion(w, x, y, z))
        above = parent[link]
        if above >= 0:
            A = rotation_of_link(W, above)
            t = image(A, translation_of_link(W, above), t)
            R = product(A, R)
        _store_pose(W, link, R, t)


@njit()
def link_poses(parent, kind, column, multiplier, offset, constants, Q, start, stop, out):
    """Write the poses of all links of the configurations start .. stop to out, shape (N, L, 4, 4).

    The tree is passed as its six arrays, because a record would cost each call from Python a microsecond.
    """
    tree = Tree(parent, kind, column, multiplier, offset, constants)
    links = parent.size
    W = np.empty(workspace_size(links, Q.shape[1]))
    rows = np.empty(LANES, dtype=np.int64)
    last = stop - 1
    zero, one = broadcast(0.0), broadcast(1.0)
    for first in range(start, stop, LANES):
        for lane in range(LANES):
            rows[lane] = min(first + lane, last)  # Repeats of the last configuration pad the last block.
        place_links(tree, Q, rows, 0, W)
        for link in range(links):
            R, t = rotation_of_link(W, link), translation_of_link(W, link)
            upper = (R[0], R[1], R[2], t[0], R[3], R[4], R[5], t[1])
            lower = (R[6], R[7], R[8], t[2], zero, zero, zero, one)
            scatter_transpose(out, links * 16, rows, 0, link * 16, upper)
            scatter_transpose(out, links * 16, rows, 0, link * 16 + 8, lower)
