"""Compute how far bodies are from the joints that turn them, for the proofs of motions.

A ball about a body is carried along the tree of joints, starting at the joint next to the body. A joint that turns
sweeps the ball around its axis, and a ball about the swept region is carried on to the next joint. Sliding joints are
at 0 here; their travel is added for each motion (`loewner._kernels.robots.motion_bounds`). Derived in
docs/certified.md, "Motions".
"""

from __future__ import annotations

import numpy as np

from loewner._kernels import columns, tolerances
from loewner._kernels.records import MotionTables, Tree
from loewner._validate import Floats, Ints
from loewner.bodies import Packed

# An allowance for rounding, and for the stretching by poses of a base or a body that are accepted as rigid.
STRETCH = 1 + 8 * tolerances.ROTATION_TOLERANCE

# Pairs in a group, and numbers that describe one.
LANES = 8

# Angles at which a joint's rotation is compared with an orthonormal one. The difference is a sum of waves of up to
# twice the angle, and its maximum is less than twice the largest of eight samples.
ANGLES = np.arange(8) * (np.pi / 4)


def motion_tables(
    tree: Tree, packed: Packed, link: Ints, balls: Floats, pairs: Ints, margins: Floats, standing: Floats,
    poses: Floats, rows: Floats,
) -> MotionTables:  # fmt: skip
    """Prepare the input of `entries.certify_motions` in addition to the checked pairs.

    Parameters
    ----------
    tree : Tree
    packed : Packed
        Pieces of all bodies, moving bodies first.
    link, balls, pairs, margins
        As in `Problem`.
    standing : ndarray, shape (bodies, BOUNDS)
        Bounds of the static bodies.
    poses : ndarray, shape (bodies, 16)
        Poses of the static bodies.
    rows : ndarray, shape (pieces, HOT)
        Ellipsoids of the static bodies in world coordinates.
    """
    start, links = _paths(tree)
    moving = _reaches(tree, link, balls[:, :3], balls[:, 3])
    still = _reaches(tree, np.full(len(standing), -1), standing[:, :3], standing[:, 3])
    far = _farthest(packed)
    depth = np.diff(start)[link]
    sizes = far[len(link) :] + np.abs(poses.reshape(-1, 4, 4)[:, :3, 3]).sum(axis=1)
    group_start, group_pairs, groups = _groups(len(link), pairs, margins, standing, sizes)
    return MotionTables(
        path_start=start,
        path_link=links,
        reach=np.ascontiguousarray(np.concatenate([moving, still]) * STRETCH),
        standing_rows=np.ascontiguousarray(rows),
        sizes=sizes,
        # Bodies far out on the robot move most, and collide most often.
        order=np.argsort(-depth[pairs[:, 0]], kind="stable"),
        group_start=group_start,
        group_pairs=group_pairs,
        groups=groups,
        chain=np.array([1 + depth.max(initial=0), _longest(tree, link, far), _bend(tree)]),
    )


def _groups(moving: int, pairs: Ints, margins: Floats, standing: Floats, sizes: Floats) -> tuple[Ints, Ints, Floats]:
    """Arrange the pairs with static bodies in groups of eight, in the form of `records.MotionTables`."""
    at = np.flatnonzero(pairs[:, 1] >= moving)
    at = at[np.argsort(pairs[at, 0], kind="stable")]
    counts = np.bincount(pairs[at, 0], minlength=moving)
    ends, groups = np.cumsum(counts), -(-counts // LANES)
    start = np.cumsum([0, *groups])
    body = np.repeat(np.arange(moving), LANES * groups)
    number = np.arange(LANES * start[-1]) - LANES * start[body] + (ends - counts)[body]
    listed = at[np.minimum(number, ends[body] - 1)]
    still = pairs[listed, 1] - moving
    rows = np.stack([*standing[still][:, [0, 1, 2, 4, 5, 6]].T, margins[listed], sizes[still]])
    return start, listed, np.ascontiguousarray(rows.reshape(LANES, start[-1], LANES).swapaxes(0, 1)).ravel()


def _farthest(packed: Packed) -> Floats:
    """Compute the largest distance of each body's points from the body's origin."""
    table, start = packed.kernel.table, packed.piece_start
    far = [table[i:j, columns.REACH].max(initial=0.0) for i, j in zip(start[:-1], start[1:], strict=True)]
    return np.array(far, dtype=np.float64)


def _paths(tree: Tree) -> tuple[Ints, Ints]:
    """List the joints between the world and each link, in the form of `records.MotionTables`."""
    paths: list[list[int]] = []
    for link, (above, kind) in enumerate(zip(tree.parent.tolist(), tree.kind.tolist(), strict=True)):
        paths.append((paths[above] if above >= 0 else []) + ([link] if kind != columns.FIXED else []))
    start = np.cumsum([0, *map(len, paths)])
    return start.astype(np.int64), np.array([k for path in paths for k in path], dtype=np.int64)


def _reaches(tree: Tree, link: Ints, centers: Floats, radii: Floats) -> Floats:
    """Compute the largest distances of balls from the joints, shape (balls, links); static bodies have the link -1."""
    count, links = len(link), len(tree.parent)
    reach = np.zeros((count, links))
    # The ball in the frame of each link, with the world's frame last; filled in as it becomes known.
    center, radius = np.full((links + 1, count, 3), np.nan), np.full((links + 1, count), np.nan)
    for k in np.unique(link):
        center[k, link == k], radius[k, link == k] = centers[link == k], radii[link == k]
    joints = [_joint(tree, k) for k in range(links)]
    for k in range(links - 1, -1, -1):  # up: from each link to its parent
        at = np.flatnonzero(~np.isnan(radius[k]))
        if len(at) == 0:
            continue
        R, t, axis = joints[k]
        far, c, r = _swept(center[k, at], radius[k, at], axis, int(tree.kind[k]))
        reach[at, k] = far
        center[tree.parent[k], at], radius[tree.parent[k], at] = c @ R.T + t, r
    for k in range(links):  # down: from each link to its children
        at = np.flatnonzero(np.isnan(radius[k]) & ~np.isnan(radius[tree.parent[k]]))
        if len(at) == 0:
            continue
        R, t, axis = joints[k]
        above = tree.parent[k]
        far, c, r = _swept((center[above, at] - t) @ R, radius[above, at], axis, int(tree.kind[k]))
        reach[at, k] = far
        center[k, at], radius[k, at] = c, r
    return reach


def _swept(center: Floats, radius: Floats, axis: Floats, kind: int) -> tuple[Floats, Floats, Floats]:
    """Compute the farthest reach of balls from a joint's axis, and balls about the regions swept as the joint turns."""
    if kind in (columns.FIXED, columns.PRISMATIC):
        return np.zeros(len(radius)), center, radius
    # A floating or ball joint may turn about any axis through its origin: its own is 0.
    onto = center @ np.outer(axis, axis)
    far = np.linalg.norm(center - onto, axis=1) + radius
    return far, onto, far


def _joint(tree: Tree, link: int) -> tuple[Floats, Floats, Floats]:
    """Return the rotation and translation of a joint at 0, and its unit axis in the frame that the joint moves."""
    row = tree.constants[link]
    fixed = row[columns.ROTATION : columns.ROTATION + 9].reshape(3, 3)
    R = fixed + row[columns.COSINE : columns.COSINE + 9].reshape(3, 3)
    axis = np.zeros(3)
    if tree.kind[link] in (columns.REVOLUTE, columns.PLANAR):
        longest = fixed[np.argmax(np.linalg.norm(fixed, axis=1))]  # rows of R axis axisᵀ: along the axis
        axis = longest / np.linalg.norm(longest)
    return R, row[columns.TRANSLATION : columns.TRANSLATION + 3], axis


def _longest(tree: Tree, link: Ints, far: Floats) -> float:
    """Compute the length of the longest chain of links, from the world's origin to a body's farthest point."""
    lengths = np.linalg.norm(tree.constants[:, columns.TRANSLATION : columns.TRANSLATION + 3], axis=1)
    for k, above in enumerate(tree.parent):
        lengths[k] += lengths[above] if above >= 0 else 0.0
    return float((lengths[link] + far[: len(link)]).max(initial=0.0)) * STRETCH


def _bend(tree: Tree) -> float:
    """Bound, from the joints' constants, how far the product of all rotations departs from orthonormality."""
    total = 0.0
    for row, kind in zip(tree.constants, tree.kind, strict=True):
        fixed, sine, cosine = (
            row[first : first + 9].reshape(3, 3) for first in (columns.ROTATION, columns.SINE, columns.COSINE)
        )
        turns = kind in (columns.REVOLUTE, columns.PLANAR)
        angles = ANGLES if turns else ANGLES[:1] * 0
        R = fixed + np.sin(angles)[:, None, None] * sine + np.cos(angles)[:, None, None] * cosine
        total += 2 * float(np.linalg.norm(R.transpose(0, 2, 1) @ R - np.eye(3), axis=(1, 2)).max())
    return total
