"""Prepare the pairs of bodies to check, for one state of the scene, as arrays for the kernels.

Data that are the same for every query are computed only once: balls about moving bodies, bounds and ellipsoids of
static bodies in world coordinates, and additional data for proofs of motions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import is_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner._base import _archives
from loewner._base._kept import kept
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns, records
from loewner._kernels.records import MOTION_ROWS, MOTION_WORDS, PROBLEM_ROWS, MotionTables
from loewner._native import entries, singles
from loewner.bodies import Bodies, Body, Packed, bodies_of
from loewner.bodies.layout import array_in, arrays_of
from loewner.bodies.pack import join
from loewner.bodies.parts import in_open_parts, in_parts, in_small_parts
from loewner.queries.pose_paths import OFF_ROUNDINGS, PackedPaths, PoseBounds, PosePath
from loewner.robots.description.robot import Robot, link_poses

# Minimum number of configurations that a thread takes at a time: about half a millisecond of work.
LEAST_SHARE = 512

# Number of configurations whose poses are computed at a time: with a hundred bodies, the poses take 13 MB.
IN_TURN = 1024

# Maximum number of body poses that are computed at a time: 100 MB.
POSES_AT_ONCE = 2**20 * 3 // 4

_NONE = np.zeros(0)


class OfMargin(NamedTuple):
    """Pairs with the same margin, in the form that `loewner.queries._settle.settle` takes."""

    margin: float
    at: Ints  # indices of the pairs
    plan: Ints
    rows: Ints


class Standing(NamedTuple):
    """The arrays that kernels write for the bodies' present poses: `standing`, `standing_rows` and `standing_poses`."""

    bounds: NDArray[np.float32]
    rows: NDArray[np.float32]
    poses: Floats


@dataclass(frozen=True, eq=False)
class Problem:
    """The pairs to check, for one state of the scene, as arrays for the kernels; other data is derived when needed.

    Attributes
    ----------
    robot : Robot
        The robot. After its own joints, it has a floating joint for each body that follows a motion.
    version, structure_version : int
        Versions of the scene's state.
    names : tuple of str
        Names of all bodies: first the bodies that move with links, then the static bodies.
    packs : tuple of Packed
        The bodies in the same order, each moving body in the frame of its link.
    moving, packed : Packed
        The moving bodies joined into one object, and all bodies joined into one object.
    link, pairs, margins, order
        See `records.Problem`.
    leaving, reaching : ndarray of bool, shape (pairs,)
        Whether a pair may be in contact at the start or at the end of a motion: see `Scene.leave` and `Scene.reach`.
    hits : ndarray of int64, shape (pairs,)
        Number of collisions found for each pair; this is the only array that changes. Threads may lose each other's
        counts, but the counts affect only the order of the pairs.
    lasting : ndarray
        Memory for the other arrays of `records.Problem` and `records.MotionTables` that do not depend on poses (see
        `lay_out`).
    block : ndarray
        A table of array addresses, first for `records.Problem` and then for `records.MotionTables`, followed by the
        arrays of `standing`. Each state of the scene has its own block (see `place_static`).
    handle : int
        Address of the table; valid as long as this object lives.
    paths : PackedPaths or None
        The motions that bodies follow; None if no body follows a motion.
    given : ndarray, shape (pairs,), or None
        The margins without the errors of static bodies' poses (`margins` include the errors); None if there are no
        errors.
    off : ndarray or None
        The errors of static bodies' poses, as `motions.settle` takes them; None if there are no errors.
    """

    robot: Robot
    version: int
    structure_version: int
    names: tuple[str, ...]
    packs: tuple[Packed, ...]
    moving: Packed
    packed: Packed
    link: Ints
    pairs: Ints
    margins: Floats
    leaving: Bools
    reaching: Bools
    order: Ints
    hits: Ints
    lasting: Floats
    block: Floats
    handle: int
    paths: PackedPaths | None = None
    given: Floats | None = None
    off: Floats | None = None

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
        leaving: Bools | None = None,
        reaching: Bools | None = None,
        before: Problem | None = None,
    ) -> Problem:
        """Prepare pairs of bodies; `versions` are `version` and `structure_version`. `with_poses` sets static poses.

        By default, no pair may be in contact at the ends of motions. If the problem `before` has packed the same bodies
        into one array, that array is used again.
        """
        never = np.zeros(len(pairs), dtype=bool)
        if before is None or not _equal(packs[: len(link)], before.packs[: len(before.link)]):
            moving = join(packs[: len(link)])
            packed = join([moving, *packs[len(link) :]])
        else:
            moving = before.moving
            packed = before.packed if _equal(packs, before.packs) else join([moving, *packs[len(link) :]])
        order, hits = np.arange(len(pairs)), np.zeros(len(pairs), dtype=np.int64)
        table = records.table_of((*robot.tree, link, _NONE, pairs, margins, order, _NONE, _NONE, _NONE))
        sizes = entries.lay_out(packed.handle, table.ctypes.data, _NONE, _NONE)
        lasting, block = records.aligned(sizes[0]), np.empty(sizes[1])
        handle = entries.lay_out(packed.handle, table.ctypes.data, lasting, block)[2]
        return cls(
            robot, *versions, names, tuple(packs), moving, packed, link, pairs, margins,
            never if leaving is None else leaving, never if reaching is None else reaching, order, hits,
            lasting, block, handle,
        )  # fmt: skip

    # -- other problems with the same bodies --------------------------------------------------

    def with_pairs(
        self, pairs: Ints, margins: Floats, leaving: Bools | None = None, reaching: Bools | None = None, **changes: Any
    ) -> Problem:
        """Return the problem with other pairs and, on request, other attributes."""
        problem = Problem.of(
            self.robot, (self.version, self.structure_version), self.names, self.packs, self.link, pairs, margins,
            leaving, reaching, self,
        )  # fmt: skip
        return problem._placed(self.standing.poses, version=self.version, paths=self.paths, **changes)

    def only(self, pairs: Ints) -> Problem:
        """Select pairs by index."""
        scene_margins = None if self.given is None else self.given[pairs]
        rules = self.leaving[pairs], self.reaching[pairs]
        chosen = self.with_pairs(self.pairs[pairs], self.margins[pairs], *rules, given=scene_margins, off=self.off)
        for value in (Problem.cut, Problem.open_cut):
            value.hand_on(self, chosen, lambda cut: cut and cut.only(pairs))
        return chosen

    def with_order(self, order: Ints) -> Problem:
        """Set the order in which configurations test the pairs; proofs of motions order the pairs themselves."""
        ordered = self._placed(self.standing.poses, order=order)
        ordered._table[PROBLEM_ROWS["order"], 0] = order.ctypes.data
        for value in (Problem.cut, Problem.open_cut):
            value.hand_on(self, ordered)
        return ordered

    def with_paths(self, paths: tuple[PosePath, ...], bounds: dict[str, PoseBounds]) -> Problem:
        """Set the motions that bodies follow, and bounds on their poses over time; all other data stays valid."""
        place = {name: k for k, name in enumerate(self.names) if name in bounds}
        numbers = np.array([place.get(name, -1) for name in bounds], dtype=np.int64)
        return self._changed(paths=PackedPaths.of(paths, tuple(bounds.values()), numbers))

    def with_errors(self, given: Floats, errors: Floats) -> Problem:
        """Set the margins without pose errors, and the pose errors of all bodies [m]."""
        at, raised = np.flatnonzero(errors), errors[errors > 0.0] * (1.0 + OFF_ROUNDINGS)
        return self._changed(given=given, off=np.stack([at, raised, raised], axis=1).ravel())

    def _changed(self, **changes: Any) -> Problem:
        problem = object.__new__(Problem)
        vars(problem).update(vars(self), **changes)
        vars(problem).pop("_without_errors", None)
        return problem

    def with_poses(self, poses: Floats, version: int) -> Problem:
        """Place the static bodies at their poses, shape (bodies, 4, 4), for a version of the scene."""
        moved = self._placed(poses, version=version)
        if self.given is not None:
            Problem._without_errors.hand_on(self, moved, lambda known: known.with_poses(poses, version))
        for value in (Problem.cut, Problem.open_cut):
            value.hand_on(self, moved, lambda cut: cut and cut.with_poses(poses, version))
        return moved

    def _placed(self, poses: Floats, **changes: Any) -> Problem:
        """Return a copy with the static bodies at other poses and some attributes changed."""
        # Use new memory, since another thread may be reading the old block. Most entries of the old block stay valid.
        block = np.empty(len(self.block))
        handle = entries.place_static(self.packed.handle, self.handle, block, poses.reshape(-1, 16))
        # `dataclasses.replace` would take a fifth of the total time.
        fields, problem = vars(self), object.__new__(Problem)
        lasting = {name: fields[name] for name in _LASTING if name in fields}
        vars(problem).update(lasting, block=block, handle=handle, **changes)
        return problem

    # -- for kernels --------------------------------------------------------------------------

    @kept
    def bodies(self) -> Bodies:
        """All bodies, packed."""
        return bodies_of(self.packed)

    def body(self, k: int) -> Body:
        """Return the body with the given index."""
        return Body(self.packs[k])

    @property
    def handle_of_motions(self) -> int:
        """Address of the table of `records.MotionTables`; valid as long as this object lives."""
        return self.handle + records.MOTIONS

    @property
    def _table(self) -> Ints:
        """Addresses, rows and columns of all arrays, in the order of `records`."""
        shape = records.TABLE // records.ENTRIES, records.ENTRIES
        return np.ndarray(shape, np.int64, self.block, self.handle - self.block.ctypes.data)

    def _view(self, row: int, word: str) -> Any:
        """Return the array that a row of the table describes."""
        entry = self._table[row].tolist()
        is_placed = 0 <= entry[0] - self.block.ctypes.data < self.block.nbytes
        return array_in(self.block if is_placed else self.lasting, entry, word)

    @kept
    def balls(self) -> Floats:
        """The balls about moving bodies."""
        return np.asarray(self._view(PROBLEM_ROWS["ball"], "F2"))

    @kept
    def standing(self) -> Standing:
        """The arrays that kernels wrote for the present poses."""
        return Standing(*map(self._view, list(PROBLEM_ROWS.values())[-3:], ("S2", "S2", "F2")))

    @kept
    def tables(self) -> MotionTables:
        """The additional input of the kernel that proves motions."""
        return MotionTables(*map(self._view, MOTION_ROWS.values(), MOTION_WORDS.split()))

    @kept
    def names_of_pairs(self) -> NDArray[np.str_]:
        """Names of all pairs, shape (pairs + 1, 2); the last row is empty."""
        return np.asarray(np.array([*self.names, ""])[np.append(self.pairs, [[-1, -1]], axis=0)])

    def memory(self, needed_by: Callable[[int, int, int], int]) -> int:
        """Return the number of scratch bytes for a kernel; `needed_by` is the kernel that computes this number."""
        size = self._memory.get(needed_by)
        if size is None:
            size = self._memory[needed_by] = int(needed_by(self.packed.handle, self.handle, self.robot.dof))
        return size

    @kept
    def _memory(self) -> dict[Callable[[int, int, int], int], int]:
        """The numbers that `memory` has computed."""
        return {}

    @kept
    def piece_pairs(self) -> int:
        """Number of pairs of pieces to check."""
        return int(np.diff(self.packed.piece_start)[self.pairs].prod(axis=1).sum())

    @kept
    def single(self) -> Any:
        """Fast queries of a single configuration or motion; see `loewner._native.singles`."""
        plain = self.robot._watch.range if self.robot.runs_straight else None
        return singles.configurations(
            self.packed.handle, self.handle, self.memory(entries.memory_size), self.piece_pairs, plain, self.hits,
            (self.robot, self.link, self.lasting, self.pairs, self.margins, self.order, self.block, self.packed),
        )  # fmt: skip

    # -- parts and subsets --------------------------------------------------------------------

    @kept
    def cut(self) -> Problem | None:
        """The problem with its surfaces cut into parts; None if no surface can be cut."""
        return self._of_parts(in_parts(self.packs))

    @property
    def in_parts(self) -> Problem:
        """The problem for proofs of motions, with any surfaces cut into parts.

        The parts of a solid cover only its surface, and a body can enter a solid only through the surface. A motion on
        which no parts meet is therefore free if its start is free. `starts_matter` is true if there are solids.
        """
        return self.cut or self

    @kept
    def open_cut(self) -> Problem | None:
        """The problem with the open surfaces of static bodies cut into small parts; None without such surfaces."""
        return self._of_parts(in_open_parts(self.packs, self._stand))

    @property
    def _stand(self) -> Bools:
        """Mark the bodies that have the same pose at all configurations."""
        stand = np.ones(len(self.packs), dtype=bool)
        tree = self.robot.tree
        rigid = np.where(tree.kind == columns.FIXED, tree.parent, np.arange(len(tree.parent)))
        stand[: len(self.link)] = rigid[self.link] == rigid[0]
        return stand

    @property
    def in_open_parts(self) -> Problem:
        """The problem for bounds on distances; these bounds are negative inside a solid."""
        return self.open_cut or self

    @kept
    def in_small_parts(self) -> Problem:
        """The problem for proofs that use only planes between parts, with surfaces cut into small parts."""
        return self._of_parts(in_small_parts(self.packs)) or self

    def _of_parts(self, packs: list[Packed]) -> Problem | None:
        if _equal(packs, self.packs):
            return None
        return Problem.of(
            self.robot, (self.version, self.structure_version), self.names, packs, self.link, self.pairs, self.margins,
            self.leaving, self.reaching, self,
        ).with_poses(self.standing.poses, self.version)  # fmt: skip

    @kept
    def starts_matter(self) -> bool:
        """Whether the kernel's proof that a motion is free is valid only if the motion's start is free."""
        return bool((self.packed.layout[:, columns.KIND] == columns.SOLID).any())

    @kept
    def by_margin(self) -> list[OfMargin]:
        """All pairs, grouped by margin."""
        return self.grouped(self.margins)

    def grouped(self, margins: Floats) -> list[OfMargin]:
        """Group all pairs by the given margins."""
        groups = []
        for margin in np.unique(margins).tolist():
            at = np.flatnonzero(margins == margin)
            plan = np.array([[len(at)], [1], [1], [1], [1]], dtype=np.int64)
            groups.append(OfMargin(margin, at, plan, np.ascontiguousarray(self.pairs[at].T)))
        return groups

    @kept
    def ruled(self) -> Ints:
        """Indices of the pairs that may be in contact at the start or the end of a motion."""
        return np.flatnonzero(self.leaving | self.reaching)

    @kept
    def unruled(self) -> Problem:
        """The problem without the pairs that may be in contact at the start or the end of a motion."""
        return self.only(np.flatnonzero(~(self.leaving | self.reaching)))

    @kept
    def without_margins(self) -> Problem:
        """The problem with no margins, for distances."""
        return self._with_margins(np.zeros(len(self.pairs))) if self.margins.any() else self

    @property
    def as_given(self) -> Problem:
        """The problem with all bodies exactly at their given poses."""
        return self if self.given is None else self._without_errors

    @kept
    def by_error(self) -> list[tuple[float, Problem]]:
        """The pairs, grouped by the rounded-up error of static bodies' poses [m]."""
        if self.given is None:
            return [(0.0, self)]
        errors = (self.margins - self.given) * (1.0 + 2.0**-48) + 2.0**-48 * self.margins * (self.margins > self.given)
        return [(float(error), self.only(np.flatnonzero(errors == error))) for error in np.unique(errors)]

    @kept
    def _without_errors(self) -> Problem:
        return self._with_margins(self.margins if self.given is None else self.given)

    def _with_margins(self, margins: Floats) -> Problem:
        return self.with_pairs(self.pairs, margins, self.leaving, self.reaching)

    def off_at(self, t: float) -> Floats:
        """Bound the sum [m] of the position errors of each pair's moving bodies at a time, shape (pairs,)."""
        if self.paths is None or not self.paths.bounds:
            return np.zeros(len(self.pairs))
        at = np.array([t])
        return self.off_at_start(self.paths.off(at, at)[0])

    def off_at_start(self, off: Floats) -> Floats:
        """Compute the result of `off_at` for the start of a motion, from the entries of `in_time.Pieces.off`."""
        of_bodies = np.zeros(len(self.names) + 1)
        of_bodies[off[::3].astype(np.int64)] = off[1::3]
        of_bodies[-1] = 0.0
        return np.asarray(of_bodies[self.pairs].sum(axis=1))

    # -- poses --------------------------------------------------------------------------------

    def fingerprint(self) -> str:
        """Compute a checksum of all data on which verdicts depend: joint tree, bodies, pairs, margins and poses."""
        arrays = {
            **self.robot.tree._asdict(), **arrays_of(self.packed), "link": self.link, "pairs": self.pairs,
            "margins": self.margins, "standing_poses": self.standing.poses,
        }  # fmt: skip
        return _archives.digest(arrays)

    def poses(self, Q: Floats) -> Floats:
        """Compute the world poses of all bodies, shape (N, bodies, 4, 4), at checked configurations."""
        moving = link_poses(self.robot, Q)[:, self.link]
        standing = self.standing.poses.reshape(-1, 4, 4)
        standing = np.broadcast_to(standing, (len(Q), *standing.shape))
        # The kernels assume C order, but NumPy may choose another order.
        return np.ascontiguousarray(np.concatenate([moving, standing], axis=1))

    def poses_in_turn(self, Q: Floats) -> Iterator[tuple[int, Floats]]:
        """Yield blocks of configurations: the index of a block's first configuration, and the poses of all bodies."""
        each = max(1, min(IN_TURN, POSES_AT_ONCE // max(1, len(self.names))))
        for first in range(0, len(Q), each):
            yield first, self.poses(Q[first : first + each])


def _equal(packs: Sequence[Packed], others: Sequence[Packed]) -> bool:
    """Return whether two lists hold the same objects."""
    return len(packs) == len(others) and all(map(is_, packs, others))


# Attributes that depend neither on poses nor on the order of the pairs.
_LASTING = (*Problem.__dataclass_fields__, "bodies", "names_of_pairs", "_memory", "piece_pairs", "by_margin", "ruled")
