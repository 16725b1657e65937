"""Make the joint tree of a robot in the form that kernels take, and find pairs of adjacent links."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection
from itertools import accumulate, combinations

import numpy as np

from loewner._base._matrices import image, product
from loewner._base._validate import Floats, Pair
from loewner._kernels import columns
from loewner._kernels.records import Tree
from loewner.errors import InputError
from loewner.robots.description.urdf import MOST_PAIRS, VALUES, Description, Joint

# Kinds of joints: maps URDF's types to the kernels' kinds.
KINDS = {
    "fixed": columns.FIXED,
    "revolute": columns.REVOLUTE,
    "continuous": columns.REVOLUTE,
    "prismatic": columns.PRISMATIC,
    "planar": columns.PLANAR,
    "floating": columns.FLOATING,
    "ball": columns.BALL,
}


def columns_of(robot: Description) -> tuple[dict[str, slice], int]:
    """Return the columns of each driven joint, and the number of columns."""
    names = robot.driven
    ends = [0, *accumulate(len(VALUES[robot.joints[name].kind]) for name in names)]
    return dict(zip(names, map(slice, ends[:-1], ends[1:]), strict=True)), ends[-1]


def adjacent_pairs(robot: Description, bodies: Collection[str] | None = None) -> frozenset[Pair]:
    """Find adjacent links with bodies, which are connected by one joint or by a path over links without bodies.

    By default, links with shapes count as links with bodies. The path over links without bodies may have at most one
    moving joint. MoveIt's setup assistant allows any number of moving joints, but links separated by two moving joints
    may well collide, and a collision of an unchecked pair is never found.
    """
    # Rigidly joined links without bodies form one place, named after its topmost link. Fixed and moving joints lead
    # from each place to links with bodies.
    shaped = {link for link, shapes in robot.shapes.items() if shapes} if bodies is None else bodies
    place = {name: name for name in robot.shapes}
    fixed: defaultdict[str, set[str]] = defaultdict(set)
    moving: defaultdict[str, set[str]] = defaultdict(set)
    between: list[Pair] = []  # places that a moving joint connects
    pairs = set()
    for link in robot.shapes:
        if link not in robot.joint_above:
            continue
        joint = robot.joint_above[link]
        parent, around = joint.parent, fixed if joint.kind == "fixed" else moving
        if link in shaped and parent in shaped:
            pairs.add((min(link, parent), max(link, parent)))
        elif link in shaped:
            around[place[parent]].add(link)
        elif parent in shaped:
            around[link].add(parent)
        elif joint.kind == "fixed":
            place[link] = place[parent]
        else:
            between.append((place[parent], link))
    products = [(fixed[at], moving[at]) for at in fixed] + [(fixed[one], fixed[other]) for one, other in between]
    total = sum(math.comb(len(links), 2) for links in fixed.values()) + sum(len(a) * len(b) for a, b in products)
    if total > MOST_PAIRS:
        most = max(len(links) for links in (*fixed.values(), *moving.values()))
        raise InputError(
            f"{robot.path}: expected at most {MOST_PAIRS} pairs of links that are joined through links without bodies, "
            f"found more: {most} links around one place"
        )
    for links in fixed.values():
        pairs.update(combinations(sorted(links), 2))
    pairs.update((min(a, b), max(a, b)) for one, other in products for a in one for b in other if a != b)
    return frozenset(pairs)


def tree_of(robot: Description, slices: dict[str, slice]) -> Tree:
    """Flatten the robot into arrays for kernels."""
    count = len(robot.shapes)
    parent, kind, column = np.full(count, -1), np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    multiplier, offset = np.ones(count), np.zeros(count)
    constants = np.zeros((count, columns.CONSTANTS))
    # For each link, the first link of its rigid group, and the link's pose in the frame of that first link.
    frames: dict[str, tuple[int, Floats]] = {}
    for i, name in enumerate(robot.shapes):
        joint = robot.joint_above.get(name)
        if joint is None:
            above, T = -1, np.eye(4)
        else:
            above, T_above_parent = frames[joint.parent]
            T = product(T_above_parent, joint.origin)
        parent[i] = above
        if joint is None or joint.kind == "fixed":
            constants[i, : columns.SINE] = (*T[:3, :3].ravel(), *T[:3, 3])
            frames[name] = above, T
            continue
        mimic = joint.mimic
        kind[i] = KINDS[joint.kind]
        column[i] = slices[mimic.joint if mimic else joint.name].start
        if mimic:
            multiplier[i], offset[i] = mimic.multiplier, mimic.offset
        offset[i] -= joint.reference
        constants[i] = _joint_constants(joint, T)
        frames[name] = i, np.eye(4)
    return Tree(parent, kind, column, multiplier, offset, constants)


def constant_pose(constants: Floats) -> Floats:
    """Return the pose of a fixed link in the frame of its parent."""
    T = np.eye(4)
    T[:3, :3] = constants[columns.ROTATION : columns.ROTATION + 9].reshape(3, 3)
    T[:3, 3] = constants[columns.TRANSLATION : columns.TRANSLATION + 3]
    return T


def placed_tree(tree: Tree, T: Floats) -> Tree:
    """Place the root link of a tree at the pose T instead of the world's origin."""
    constants = tree.constants.copy()
    on_base = np.flatnonzero(tree.parent < 0)
    R, t = T[:3, :3], T[:3, 3]
    for first in (columns.ROTATION, columns.SINE, columns.COSINE):
        block = constants[on_base, first : first + 9].reshape(-1, 3, 3)
        constants[on_base, first : first + 9] = product(R, block).reshape(-1, 9)
    for first in (columns.TRANSLATION, columns.ACROSS, columns.ALONG):
        constants[on_base, first : first + 3] = image(R, constants[on_base, first : first + 3])
    constants[on_base, columns.TRANSLATION : columns.TRANSLATION + 3] += t
    return tree._replace(constants=constants)


def _joint_constants(joint: Joint, T: Floats) -> Floats:
    """Compute the constants of a movable joint whose own frame is at T."""
    R, axis = T[:3, :3], joint.axis
    rotation, sine, cosine, across, along = R, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    if joint.kind in ("revolute", "continuous", "planar"):  # Rodrigues: n nᵀ + sin q [n]× + cos q (1 - n nᵀ)
        x, y, z = axis
        onto = np.outer(axis, axis)
        rotation, cosine = product(R, onto), product(R, np.eye(3) - onto)
        sine = product(R, np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    if joint.kind == "prismatic":
        across = image(R, axis)
    if joint.kind == "planar":
        across, along = product(R, _from_z(axis))[:, :2].T
    return np.concatenate([rotation.ravel(), T[:3, 3], sine.ravel(), cosine.ravel(), across, along])


def _from_z(axis: Floats) -> Floats:
    """Compute the smallest rotation that takes the z axis to a unit vector."""
    x, y, z = axis
    across = x * x + y * y
    if z < 0 and across < 1e-24:  # half a turn about any perpendicular axis, such as x
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0, 0, x], [0, 0, y], [-x, -y, 0]])
    above = 1 + z if z >= 0 else across / (1 - z)  # 1 + z, without cancellation
    return np.asarray(np.eye(3) + cross + product(cross, cross) / above)
