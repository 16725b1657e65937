"""Prepare the pairs of bodies to check, at one state of the scene, as arrays for the kernels.

Work that is the same for every query is done once, here: balls about moving bodies, bounds and ellipsoids of static
bodies in world coordinates, and the additional data for proofs of motions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner import _archives
from loewner._kept import kept
from loewner._kernels import columns, records
from loewner._kernels.records import MotionTables
from loewner._native import entries, singles
from loewner._validate import Bools, Floats, Ints
from loewner.bodies import Bodies, Body, Packed, bodies_of
from loewner.bodies.layout import arrays_of
from loewner.bodies.pack import join
from loewner.bodies.parts import in_parts
from loewner.pose_paths import PackedPaths, PosePath
from loewner.robots.motion_tables import LANES, chains_of, pairs_in_groups
from loewner.robots.robot import Robot, link_poses

# Configurations a thread takes at a time, at least: about half a millisecond of work.
LEAST_SHARE = 512

# Configurations whose poses are made at a time: of a hundred bodies, they take 13 MB.
IN_TURN = 1024

# Poses of bodies at most, of all those configurations together: 100 MB.
POSES_AT_ONCE = 2**20 * 3 // 4

# Rows of the table of arrays: where the arrays of `records.MotionTables` begin, the order of the pairs, and the arrays
# that kernels write.
_MOTIONS, _ORDER, _WRITTEN = 14, 10, [11, 12, 13, 16, 17, 18, 22]


class PreparedMotions(NamedTuple):
    """The additional input of the kernel that proves motions."""

    tables: MotionTables
    addresses: Ints  # where these arrays are
    handle: int  # where the addresses are; valid as long as this object lives
    memory: int  # scratch bytes


class OfMargin(NamedTuple):
    """Pairs with the same margin, in the form that `loewner._settle.settle` takes."""

    margin: float
    at: Ints  # their places among all
    plan: Ints
    rows: Ints


class Standing(NamedTuple):
    """What kernels write about bodies for their present poses: all in one block of memory, which is copied as a whole.

    Attributes
    ----------
    memory : ndarray
        The block.
    reach, exact_rows, sizes, groups : ndarray
        `reach`, `standing_rows`, `sizes` and `groups` of `records.MotionTables`.
    bounds, rows, poses : ndarray
        `standing`, `standing_rows` and `standing_poses` of `records.Problem`.
    """

    memory: Floats
    reach: Floats
    exact_rows: Floats
    sizes: Floats
    groups: Floats
    bounds: NDArray[np.float32]
    rows: NDArray[np.float32]
    poses: Floats

    @classmethod
    def of(cls, packed: Packed, moving: int, links: int, groups: int) -> Standing:
        """Allocate memory; the poses differ from all others."""
        bodies, pieces = len(packed.piece_start) - 1, int(packed.piece_start[-1] - packed.piece_start[moving])
        static, f = bodies - moving, np.float32
        shapes = (
            ((bodies, links), float), ((pieces, columns.HOT), float), ((static,), float), ((groups,), float),
            ((static, columns.BOUNDS), f),
            ((pieces, columns.HOT), f), ((static, 16), float),
        )  # fmt: skip
        sizes = [math.prod(shape) * np.dtype(kind).itemsize // 8 for shape, kind in shapes]
        memory, begin = records.aligned(sum(sizes)), np.cumsum([0, *sizes]).tolist()
        memory[:] = 0.0
        parts = (memory[first:last] for first, last in zip(begin[:-1], begin[1:], strict=True))
        made = cls(memory, *(p.view(kind).reshape(shape) for p, (shape, kind) in zip(parts, shapes, strict=True)))
        made.poses[:] = np.nan
        return made

    def copy(self) -> Standing:
        """Copy the block."""
        memory = records.aligned(len(self.memory))
        memory[:] = self.memory
        first, made = self.memory.ctypes.data, [memory]
        for array in self[1:]:
            at = (array.ctypes.data - first) // 8
            made.append(memory[at : at + array.nbytes // 8].view(array.dtype).reshape(array.shape))
        return Standing(*made)


@dataclass(frozen=True, eq=False)
class Problem:
    """The pairs to check, at one state of the scene, as arrays for the kernels; other data is derived when needed.

    Attributes
    ----------
    robot : Robot
        Behind its own joints, a floating one for each body that follows a motion.
    version, structure_version : int
        Versions of the scene's state.
    names : tuple of str
        Names of all bodies: first the bodies that move with links, then the static ones.
    packs : tuple of Packed
        The bodies in the same order; moving bodies in the frame of their link.
    moving, packed : Packed
        The moving bodies together, and all bodies together.
    link, balls, pairs, margins, order
        See `records.Problem`.
    leaving, reaching : ndarray of bool, shape (pairs,)
        Whether a pair may be in contact at the start, or at the end, of a motion: see `Scene.leave` and `Scene.reach`.
    `standing` : `Standing`
        Arrays that kernels write for the present poses.
    hits : ndarray of int64, shape (pairs,)
        Number of collisions found for each pair; no other array changes. Threads may lose each other's counts, but
        these affect only the order of the pairs.
    motion_order, group_start, group_pairs, chain : ndarray
        `order`, `group_start`, `group_pairs` and `chain` of `records.MotionTables`.
    table : ndarray of int64
        Addresses of the arrays of `records.Problem`, and then of `records.MotionTables`.
    paths : PackedPaths or None
        The motions that bodies of the scene follow; None if there are none.
    """

    robot: Robot
    version: int
    structure_version: int
    names: tuple[str, ...]
    packs: tuple[Packed, ...]
    moving: Packed
    packed: Packed
    link: Ints
    balls: Floats
    pairs: Ints
    margins: Floats
    leaving: Bools
    reaching: Bools
    order: Ints
    standing: Standing
    hits: Ints
    motion_order: Ints
    group_start: Ints
    group_pairs: Ints
    chain: Floats
    table: Ints
    paths: PackedPaths | None = None

    @classmethod
    def of(
        cls,
        robot: Robot,
        versions: tuple[int, int],
        names: tuple[str, ...],
        packs: Sequence[Packed],
        link: Ints,
        pairs: Ints,
        margins: Floats,
        leaving: Bools,
        reaching: Bools,
        moving: Packed | None = None,
        packed: Packed | None = None,
    ) -> Problem:
        """Prepare pairs of bodies for a version and structure version of the scene; `with_poses` sets static poses.

        Bodies that are joined already can be given so.
        """
        moving = join(packs[: len(link)]) if moving is None else moving
        packed = join([moving, *packs[len(link) :]]) if packed is None else packed
        chains, balls = chains_of(robot), np.empty((len(link), 5))
        group_start, group_pairs = pairs_in_groups(len(link), pairs)
        standing = Standing.of(packed, len(link), len(robot.tree.parent), LANES * len(group_pairs))
        order, chain = np.arange(len(pairs)), chains.chain(packed, link)
        # Bodies far out on the robot move most, and collide most often.
        motion_order = np.argsort(-chains.depth(link)[pairs[:, 0]], kind="stable")
        arrays = (
            *robot.tree, link, balls, pairs, margins, order, standing.bounds, standing.rows, standing.poses,
            chains.path_start, chains.path_link, standing.reach, standing.exact_rows, standing.sizes, motion_order,
            group_start, group_pairs, standing.groups, chain,
        )  # fmt: skip
        made = cls(
            robot, *versions, names, tuple(packs), moving, packed, link, balls, pairs, margins, leaving, reaching,
            order, standing, np.zeros(len(pairs), dtype=np.int64), motion_order, group_start, group_pairs, chain,
            records.table_of(arrays),
        )  # fmt: skip
        entries.measure_moving(packed.handle, made.handle, made.handle_of_motions)
        return made

    # -- other problems with the same bodies --------------------------------------------------

    def only(self, pairs: Ints) -> Problem:
        """Select pairs by index."""
        chosen = Problem.of(
            self.robot, (self.version, self.structure_version), self.names, self.packs, self.link, self.pairs[pairs],
            self.margins[pairs], self.leaving[pairs], self.reaching[pairs], self.moving, self.packed,
        ).with_poses(self.standing.poses, self.version)  # fmt: skip
        Problem.cut.hand_on(self, chosen, lambda cut: cut and cut.only(pairs))
        return chosen

    def with_order(self, order: Ints) -> Problem:
        """Set the order in which configurations test the pairs; proofs of motions have an order of their own."""
        table = self.table.copy()
        table[_ORDER, 0] = order.ctypes.data
        ordered = replace(self, order=order, table=table)
        for value in (*_OF_COUNTS, Problem.cut, Problem.motions):
            value.hand_on(self, ordered)
        return ordered

    def with_paths(self, paths: tuple[PosePath, ...]) -> Problem:
        """Set the motions that bodies follow; all other data stays valid."""
        made = replace(self, paths=PackedPaths.of(paths))
        for value in (*_OF_COUNTS, Problem.cut, Problem.motions):
            value.hand_on(self, made)
        return made

    def with_poses(self, poses: Floats, version: int) -> Problem:
        """Place the static bodies at the poses that they have in a version of the scene, shape (bodies, 4, 4)."""
        # New memory, since another thread may be reading the old one; most of its entries still hold.
        standing, table = self.standing.copy(), self.table.copy()
        table[_WRITTEN, 0] += standing.memory.ctypes.data - self.standing.memory.ctypes.data
        moved = replace(self, version=version, standing=standing, table=table)
        entries.place_static(self.packed.handle, moved.handle, moved.handle_of_motions, poses.reshape(-1, 16))
        for value in _OF_COUNTS:
            value.hand_on(self, moved)
        Problem.cut.hand_on(self, moved, lambda cut: cut and cut.with_poses(poses, version))
        return moved

    # -- for kernels --------------------------------------------------------------------------

    @kept
    def bodies(self) -> Bodies:
        """All bodies, packed."""
        return bodies_of(self.packed)

    def body(self, k: int) -> Body:
        """Return one of the bodies."""
        return Body(self.packs[k])

    @property
    def arrays(self) -> tuple[Any, ...]:
        """The arrays of `records.Problem`, in order."""
        return (
            *self.robot.tree, self.link, self.balls, self.pairs, self.margins, self.order, self.standing.bounds,
            self.standing.rows, self.standing.poses,
        )  # fmt: skip

    @kept
    def handle(self) -> int:
        """Address of their table; valid as long as this object lives."""
        return int(self.table.ctypes.data)

    @property
    def handle_of_motions(self) -> int:
        """Address of the table of `records.MotionTables`, likewise."""
        return self.handle + 8 * records.ENTRIES * _MOTIONS

    @kept
    def names_of_pairs(self) -> NDArray[np.str_]:
        """Names of all pairs, shape (pairs + 1, 2); the last row is empty."""
        return np.asarray(np.array([*self.names, ""])[np.append(self.pairs, [[-1, -1]], axis=0)])

    @kept
    def memory(self) -> int:
        """Scratch memory for verdicts."""
        return int(entries.memory_size(self.packed.handle, self.handle, self.robot.dof))

    @kept
    def memory_of_nearest(self) -> int:
        """Scratch memory for distances."""
        return int(entries.memory_of_nearest(self.packed.handle, self.handle, self.robot.dof))

    @kept
    def memory_of_clearances(self) -> int:
        """Scratch memory for smooth clearances."""
        return int(entries.memory_of_clearances(self.packed.handle, self.handle, self.robot.dof))

    @kept
    def memory_of_motions(self) -> int:
        """Scratch memory for proofs of motions."""
        return int(entries.motion_memory(self.packed.handle, self.handle, self.robot.dof))

    @kept
    def piece_pairs(self) -> int:
        """Number of pairs of pieces to check."""
        return int(np.diff(self.packed.piece_start)[self.pairs].prod(axis=1).sum())

    @kept
    def single(self) -> Any:
        """Fast queries of a single configuration or motion; see `loewner._native.singles`."""
        plain = self.robot._watch.range if self.robot.runs_straight else None
        return singles.configurations(
            self.packed.handle, self.handle, self.memory, self.piece_pairs, plain, self.hits,
            (self.arrays, self.table, self.packed),
        )  # fmt: skip

    @kept
    def motions(self) -> PreparedMotions:
        """The additional data for certifying motions."""
        chains, standing = chains_of(self.robot), self.standing
        tables = MotionTables(
            chains.path_start, chains.path_link, standing.reach, standing.exact_rows, standing.sizes, self.motion_order,
            self.group_start, self.group_pairs, standing.groups, self.chain,
        )  # fmt: skip
        return PreparedMotions(tables, self.table, self.handle_of_motions, self.memory_of_motions)

    # -- parts and subsets --------------------------------------------------------------------

    @kept
    def cut(self) -> Problem | None:
        """The problem with its static surfaces cut into parts; None if there are no such surfaces.

        Static bodies are bodies in the world, or attached to links that are fixed to the root.
        """
        packs = in_parts(self.packs, self._stand)
        if all(one is other for one, other in zip(packs, self.packs, strict=True)):
            return None
        count = len(self.link)
        same = all(one is other for one, other in zip(packs[:count], self.packs[:count], strict=True))
        return Problem.of(
            self.robot, (self.version, self.structure_version), self.names, packs, self.link, self.pairs, self.margins,
            self.leaving, self.reaching, self.moving if same else None,
        ).with_poses(self.standing.poses, self.version)  # fmt: skip

    @property
    def in_parts(self) -> Problem:
        """The problem for proofs of motions, with any static surfaces cut into parts.

        Parts of a solid cover only its surface. A motion that is free of them is free if its start is free, since a
        body outside can only enter through the surface. `starts_matter` is true if there are such parts.
        """
        return self.cut or self

    @kept
    def starts_matter(self) -> bool:
        """Whether a motion that is free of all parts is proven free only if its start is free as well."""
        solid = self.packed.layout[:, columns.KIND] == columns.SOLID
        stands = np.repeat(self._stand, np.diff(self.packed.piece_start))
        return self.cut is not None and bool((solid & stands).any())

    @property
    def _stand(self) -> Bools:
        """Mark the bodies that have the same pose at all configurations."""
        stand = np.ones(len(self.packs), dtype=bool)
        rigid = rigid_with(self.robot)
        stand[: len(self.link)] = rigid[self.link] == rigid[0]
        return stand

    @kept
    def by_margin(self) -> list[OfMargin]:
        """All pairs, grouped by margin."""
        found = []
        for margin in np.unique(self.margins).tolist():
            at = np.flatnonzero(self.margins == margin)
            plan = np.array([[len(at)], [1], [1], [1], [1]], dtype=np.int64)
            found.append(OfMargin(margin, at, plan, np.ascontiguousarray(self.pairs[at].T)))
        return found

    @kept
    def ruled(self) -> Ints:
        """Indices of the pairs that may be in contact at the start or the end of a motion."""
        return np.flatnonzero(self.leaving | self.reaching)

    @kept
    def unruled(self) -> Problem:
        """The problem without these pairs."""
        return self.only(np.flatnonzero(~(self.leaving | self.reaching)))

    # -- poses --------------------------------------------------------------------------------

    def fingerprint(self) -> str:
        """A checksum of everything on which a verdict depends: the joint tree, bodies, pairs, margins and poses."""
        arrays = {
            **self.robot.tree._asdict(), **arrays_of(self.packed), "link": self.link, "pairs": self.pairs,
            "margins": self.margins, "standing_poses": self.standing.poses,
        }  # fmt: skip
        return _archives.digest(arrays)

    def poses(self, Q: Floats) -> Floats:
        """Compute the world poses of all bodies, shape (N, bodies, 4, 4), at checked configurations."""
        moving = link_poses(self.robot, Q)[:, self.link]
        standing = self.standing.poses.reshape(-1, 4, 4)
        # In C order, which the kernels take for granted; NumPy may choose another.
        return np.ascontiguousarray(
            np.concatenate([moving, np.broadcast_to(standing, (len(Q), *standing.shape))], axis=1)
        )

    def poses_in_turn(self, Q: Floats) -> Iterator[tuple[int, Floats]]:
        """Yield the poses of all bodies for one block of configurations after another, and each block's first index."""
        each = max(1, min(IN_TURN, POSES_AT_ONCE // max(1, len(self.names))))
        for first in range(0, len(Q), each):
            yield first, self.poses(Q[first : first + each])


def rigid_with(robot: Robot) -> Ints:
    """Return for each link the first link with which it is rigidly joined."""
    parent, kind = robot.tree.parent, robot.tree.kind
    return np.asarray(np.where(kind == columns.FIXED, parent, np.arange(len(parent))))


# What depends only on the numbers of bodies, pieces, pairs and links.
_OF_COUNTS = (
    Problem.memory, Problem.memory_of_nearest, Problem.memory_of_clearances, Problem.memory_of_motions,
    Problem.piece_pairs,
)  # fmt: skip
