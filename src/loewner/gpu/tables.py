"""Copy the kernels' data about a robot and its scene to a GPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner._base._validate import Floats, Ints
from loewner._kernels import columns, tolerances
from loewner.gpu.driver import Device, Memory
from loewner.gpu.pairs import single_rows
from loewner.robots.checking.problem import Problem

# If a static pose deviates from a rotation by more than this, it would distort the balls that are added to cores. The
# CPU then decides about such pieces.
ROUND = 1e-9

GROUP = 4  # vertices that a search reads at a time


class Tables(NamedTuple):
    """The kernels' input for a robot and its scene; `loewner._kernels.threads.configurations` describes the fields."""

    version: int
    moving: int
    pair_count: int
    piece_pairs: int
    links: int
    chains: int
    joints: Memory
    constants: Memory
    bodies: Memory
    balls: Memory
    rows: Memory
    pairs: Memory
    margins: Memory
    standing: Memory
    cell: Memory
    others: tuple[Memory, ...]  # `cell` has pointers to these


def tables_of(gpu: Device, ready: Problem) -> Tables:
    """Copy the kernels' input for a robot and its scene to the GPU."""
    tree, packed, moving = ready.robot.tree, ready.packed, len(ready.link)
    start = packed.piece_start
    rows = single_rows(packed).copy()
    rows[start[moving] :] = ready.standing.rows

    joints = np.zeros((len(tree.parent), columns.LINK_INTEGERS), dtype=np.int32)
    joints[:, columns.PARENT_OF_LINK], joints[:, columns.KIND_OF_LINK] = tree.parent, tree.kind
    joints[:, columns.COLUMN_OF_LINK] = tree.column
    constants = np.zeros((len(tree.parent), columns.LINK_CONSTANTS))
    constants[:, : columns.CONSTANTS] = tree.constants
    constants[:, columns.MULTIPLIER], constants[:, columns.OFFSET] = tree.multiplier, tree.offset
    constants[tree.parent < 0, columns.BENT] = ready.tables.chain[2] / tolerances.SINGLE_ROUNDOFF * tolerances.UP

    bodies = np.zeros((len(start) - 1, columns.BODY_INTEGERS), dtype=np.int32)
    bodies[:moving, columns.LINK_OF_BODY] = ready.link
    bodies[:, columns.FIRST_PIECE], bodies[:, columns.LAST_PIECE] = start[:-1], start[1:]
    balls = np.zeros((moving, columns.BALL_NUMBERS))
    balls[:, :5] = ready.balls
    balls[:, [columns.BALL_RADIUS, columns.BALL_REACH]] *= tolerances.UP
    with np.errstate(over="ignore"):  # infinite numbers are left to the CPU
        floats = [x.astype(np.float32) for x in (constants, balls, ready.margins * tolerances.UP)]
    at = {
        "bodies": gpu.upload(bodies), "balls": gpu.upload(floats[1]), "pairs": gpu.upload(ready.pairs.astype(np.int32)),
        "margins": gpu.upload(floats[2]), "rows": gpu.upload(rows),
    }  # fmt: skip
    chains = _Chains(ready)
    others = tuple(gpu.upload(array) for array in (*_cores(ready), *chains.arrays()))
    # The fields are in the order of `threads.configurations.Cell`.
    cell = np.array([moving, *(memory.address for memory in (*at.values(), *others))], dtype=np.int64)
    return Tables(
        version=ready.version, moving=moving, pair_count=len(ready.pairs), piece_pairs=ready.piece_pairs,
        links=len(tree.parent), chains=len(chains.joints), joints=gpu.upload(joints), constants=gpu.upload(floats[0]),
        standing=gpu.upload(ready.standing.bounds), cell=gpu.upload(cell), others=others, **at,
    )  # fmt: skip


def _cores(ready: Problem) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
    """Describe the pieces for `threads.searches.core_at`: static pieces in the world, others in frames of links."""
    packed, moving = ready.packed, len(ready.link)
    table, first_static = packed.kernel.table, int(packed.piece_start[moving])
    integers = np.zeros((len(packed.layout), columns.CORE_INTEGERS), dtype=np.int32)
    integers[:, columns.CORE_KIND] = packed.layout[:, columns.KIND]
    numbers = np.zeros((len(packed.layout), columns.CORE_NUMBERS))
    center, factor = columns.FRAME_CENTER, columns.FRAME_FACTOR
    reach, radius = table[:, columns.REACH].copy(), table[:, columns.ROUNDING]
    poses = np.tile(np.eye(4), (len(reach), 1, 1))
    counts = np.diff(packed.piece_start[moving:])
    poses[first_static:] = np.repeat(ready.standing.poses.reshape(-1, 4, 4), counts, axis=0)
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    reach += np.abs(t).sum(axis=1)
    centers = (R @ table[:, center : center + 3, None])[:, :, 0] + t
    factors = (R @ table[:, factor : factor + 9].reshape(-1, 3, 3)).reshape(-1, 9)
    numbers[:, columns.CORE_CENTER : columns.CORE_CENTER + 3] = centers
    numbers[:, columns.CORE_FACTOR : columns.CORE_FACTOR + 9] = factors
    numbers[:, columns.CORE_RADIUS] = radius * tolerances.UP
    numbers[:, columns.CORE_REACH] = reach * (1.0 + 4.0 * tolerances.ROTATION_TOLERANCE)
    bent = np.linalg.norm(R.transpose(0, 2, 1) @ R - np.eye(3), axis=(1, 2)) > ROUND
    integers[bent & (radius > 0.0), columns.CORE_KIND] = columns.SURFACE  # these are left to the CPU
    placed: list[Floats] = [np.zeros((0, 3))]
    count = 0
    for k, (kind, begin, end) in enumerate(packed.layout[:, :3].tolist()):
        integers[k, columns.CORE_START] = count
        if columns.MAPPED <= kind <= columns.POLYTOPE:
            points = packed.points[begin:end] @ R[k].T + t[k]
            placed.append(np.append(points, np.tile(points[-1:], (-len(points) % GROUP, 1)), axis=0))
            count += len(placed[-1])
        integers[k, columns.CORE_STOP] = count
    vertices = np.zeros((max(GROUP, count), 4), dtype=np.float32)
    vertices[:count, :3] = np.concatenate(placed)
    with np.errstate(over="ignore"):
        return integers, numbers.astype(np.float32), vertices


class _Chains:
    """The chains of joints between each moving body and the world, and between the moving bodies of each pair."""

    def __init__(self, ready: Problem) -> None:
        self._ready, self.joints = ready, [_joints_between(ready, body, -1) for body in range(len(ready.link))]
        self.roles = np.zeros((len(ready.pairs), columns.ROLES), dtype=np.int32)
        self.levers = [self._levers(body, chain) for body, chain in enumerate(self.joints)]
        for pair, (one, other) in enumerate(ready.pairs.tolist()):
            upper, lower, chain = one, other, one
            if other < len(ready.link):
                upper, lower = min(((one, other), (other, one)), key=lambda roles: self._length(*roles))
                chain = len(self.joints)
                self.joints.append(_joints_between(ready, upper, int(ready.link[lower])))
                self.levers.append(self._levers(upper, self.joints[-1]))
            self.roles[pair, [columns.UPPER, columns.LOWER, columns.CHAIN]] = upper, lower, chain

    def _length(self, upper: int, lower: int) -> float:
        """Sum the levers of a chain."""
        return float(self._levers(upper, _joints_between(self._ready, upper, int(self._ready.link[lower]))).sum())

    def _levers(self, body: int, joints: Ints) -> Floats:
        return np.asarray(self._ready.tables.reach[body, joints])

    def arrays(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
        """Return roles, chain_start, joints and levers, as defined in `threads.configurations.Cell`."""
        tree = self._ready.robot.tree
        start = np.cumsum([0, *map(len, self.joints)]).astype(np.int32)
        joints = np.concatenate([*self.joints, np.zeros(0, dtype=np.int64)]).astype(np.int64)
        integers = np.zeros((len(joints), columns.CHAIN_INTEGERS), dtype=np.int32)
        integers[:, 0] = tree.column[joints]
        integers[:, columns.TURNING_JOINT] = tree.kind[joints] == columns.REVOLUTE
        numbers = np.zeros((len(joints), columns.CHAIN_NUMBERS))
        numbers[:, 0], numbers[:, 1] = tree.multiplier[joints], tree.offset[joints]
        numbers[:, columns.LEVER] = np.concatenate([*self.levers, np.zeros(0)]) * tolerances.UP
        return self.roles, start, integers, numbers.astype(np.float32)


def _joints_between(ready: Problem, body: int, lower: int) -> Ints:
    """List the joints from a moving body to a link or to the world (-1); the number of a joint is its link's number."""
    paths = ready.tables
    up, down = (
        paths.path_link[slice(*paths.path_start[link : link + 2])] if link >= 0 else paths.path_link[:0]
        for link in (int(ready.link[body]), lower)
    )
    return np.concatenate([up[~np.isin(up, down)][::-1], down[~np.isin(down, up)]])
