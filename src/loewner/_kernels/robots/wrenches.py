"""How wrenches on a robot's links act on its joints, at eight configurations side by side.

A wrench is a force and its moment about the world's origin, both in world axes. A wrench is the gradient of a quantity
with respect to the motion of a link. A value of the configuration moves some links with a twist. The gradient with
respect to the value is the power of the wrenches on these links along this twist. The powers of unit wrenches on one
link form its Jacobian.

References
----------
Lynch and Park, Modern Robotics (2017), chapter 5: space Jacobians and wrenches.
"""

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.columns import (
    ACROSS,
    ALONG,
    BALL,
    FIXED,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    ROTATION,
)
from loewner._kernels.linalg3 import along, apply, apply_transposed, cross, dot, image, minus, product, scaled
from loewner._kernels.records import Tree
from loewner._kernels.robots.kinematics import (
    POSE,
    axis_of,
    place_links,
    rotation_of_link,
    translation_of_link,
    triple_of,
    workspace_size,
)
from loewner._kernels.simd.vectors import LANES, broadcast, load, store

WRENCH = 6  # Number of vectors per link: three for the force, and three for the moment.


@inline
def clear(vectors, count):
    """Write zeros."""
    for k in range(count):
        store(vectors, k * LANES, broadcast(0.0))


@inline
def _add(vectors, at, x):
    store(vectors, at, load(vectors, at) + x)


@inline
def push(wrenches, link, force, moment):
    """Add a wrench to the wrench on a link."""
    at = link * (WRENCH * LANES)
    for k in range(3):
        _add(wrenches, at + k * LANES, force[k])
        _add(wrenches, at + (3 + k) * LANES, moment[k])


@inline
def _three(array, at):
    return load(array, at), load(array, at + LANES), load(array, at + 2 * LANES)


@inline
def powers(tree, W, wrenches, dof, slopes):
    """Gradients with respect to the values of eight configurations.

    Parameters
    ----------
    tree : Tree
    W : ndarray
        Poses of the links, followed by the configurations: the output of `kinematics.place_links`.
    wrenches : ndarray
        WRENCH vectors per link. The wrenches on the links below a link are added to the link's own wrench.
    slopes : ndarray
        Receives a vector for each of the `dof` values of a configuration.
    """
    parent, kind, column = borrowed(tree.parent), borrowed(tree.kind), borrowed(tree.column)
    multiplier, constants = borrowed(tree.multiplier), borrowed(tree.constants)
    links = parent.size
    clear(slopes, dof)
    for back in range(links):
        link = links - 1 - back
        at = link * (WRENCH * LANES)
        force, moment = _three(wrenches, at), _three(wrenches, at + 3 * LANES)
        what, above = kind[link], parent[link]
        if what != FIXED:
            q = column[link] * LANES
            # The torque is the moment about the link's own origin, which does not move when the link turns.
            torque = minus(moment, cross(translation_of_link(W, link), force))
            seen = force
            if above >= 0:
                seen = apply_transposed(rotation_of_link(W, above), force)
            if what == REVOLUTE:
                axis = apply(rotation_of_link(W, link), axis_of(constants, link))
                _add(slopes, q, multiplier[link] * dot(axis, torque))
            elif what == PRISMATIC:
                _add(slopes, q, multiplier[link] * dot(triple_of(constants, link, ACROSS), seen))
            elif what == PLANAR:
                _add(slopes, q, dot(triple_of(constants, link, ACROSS), seen))
                _add(slopes, q + LANES, dot(triple_of(constants, link, ALONG), seen))
                axis = apply(rotation_of_link(W, link), axis_of(constants, link))
                _add(slopes, q + 2 * LANES, dot(axis, torque))
            elif what in (FLOATING, BALL):
                frame = (
                    triple_of(constants, link, ROTATION) + triple_of(constants, link, ROTATION + 3)
                    + triple_of(constants, link, ROTATION + 6)
                )  # fmt: skip
                if above >= 0:
                    frame = product(rotation_of_link(W, above), frame)
                if what == FLOATING:
                    shift = apply_transposed(frame, force)
                    for k in range(3):
                        _add(slopes, q + k * LANES, shift[k])
                    q += 3 * LANES
                _by_quaternion(slopes, q, apply_transposed(frame, torque), W, links * (POSE * LANES) + q)
        if above >= 0:
            push(wrenches, above, force, moment)


@inline
def _by_quaternion(slopes, q, turn, W, at):
    """Gradient with respect to a quaternion, which turns by 2 vec(dq q*) / |q|²."""
    w, x, y, z = load(W, at), load(W, at + LANES), load(W, at + 2 * LANES), load(W, at + 3 * LANES)
    v = x, y, z
    scale = 2.0 / (w * w + dot(v, v))
    turned = cross(turn, v)
    for k in range(3):
        _add(slopes, q + (1 + k) * LANES, scale * (w * turn[k] + turned[k]))
    _add(slopes, q, -scale * dot(v, turn))


@njit()
def link_jacobians(parent, kind, column, multiplier, offset, constants, Q, start, stop, link, point, out):
    """Write the Jacobians of a point of a link at the configurations start .. stop to out, shape (N, 6, dof).

    The tree is passed as its six arrays, as in `kinematics.link_poses`. The rows are the velocity of the point and the
    angular velocity of the link: the powers of unit forces at the point, and of unit moments.
    """
    tree = Tree(parent, kind, column, multiplier, offset, constants)
    links, dof = parent.size, Q.shape[1]
    W, rows = np.empty(workspace_size(links, dof)), np.empty(LANES, np.int64)
    wrenches, slopes = np.empty(WRENCH * LANES * links), np.empty(LANES * dof)
    for first in range(start, stop, LANES):
        for lane in range(LANES):
            rows[lane] = min(first + lane, stop - 1)  # The last configuration fills all remaining rows.
        place_links(tree, Q, rows, 0, W)
        at = image(rotation_of_link(W, link), translation_of_link(W, link), (point[0], point[1], point[2]))
        for row in range(6):
            unit = broadcast(1.0 * (row % 3 == 0)), broadcast(1.0 * (row % 3 == 1)), broadcast(1.0 * (row % 3 == 2))
            pushed = 1.0 * (row < 3)
            clear(wrenches, WRENCH * links)
            push(wrenches, link, scaled(pushed, unit), along(scaled(1.0 - pushed, unit), pushed, cross(at, unit)))
            powers(tree, W, wrenches, dof, slopes)
            for lane in range(min(LANES, stop - first)):
                for k in range(dof):
                    out[first + lane, row, k] = slopes[k * LANES + lane]
