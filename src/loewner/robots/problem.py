"""Prepare the pairs of bodies to check, at one state of the scene, as arrays for the kernels.

Work that is the same for every query is done once, here: balls about moving bodies, bounds and ellipsoids of static
bodies in world coordinates, and the additional data for proofs of motions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner import _archives
from loewner._kept import kept
from loewner._kernels import columns, records, tolerances
from loewner._kernels.records import MotionTables
from loewner._native import entries, singles
from loewner._validate import Bools, Floats, Ints
from loewner.bodies import Bodies, Body, Packed, bodies_of, packed_of
from loewner.bodies.layout import arrays_of, starts
from loewner.bodies.pack import ranges
from loewner.bodies.parts import in_parts
from loewner.robots.motion_tables import motion_tables
from loewner.robots.robot import Robot, link_poses

# An allowance for rounding, and for lengths that a pose accepted as rigid may stretch.
STRETCH = 1 + 4 * tolerances.ROTATION_TOLERANCE

# Configurations a thread takes at a time, at least: about half a millisecond of work.
LEAST_SHARE = 512

# Configurations whose poses are made at a time: of a hundred bodies, they take 13 MB.
IN_TURN = 1024

# Poses of bodies at most, of all those configurations together: 100 MB.
POSES_AT_ONCE = 2**20 * 3 // 4

# Entries of a symmetric matrix in the order of the kernels, and back.
_UPPER = np.triu_indices(3)
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


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


@dataclass(frozen=True, eq=False)
class Problem:
    """The pairs to check, at one state of the scene, as arrays for the kernels; other data is derived when needed.

    Attributes
    ----------
    robot : Robot
    version, structure_version : int
        Versions of the scene's state.
    names : tuple of str
        Names of all bodies: first the bodies that move with links, then the static ones.
    bodies : Bodies
        The bodies in the same order, packed; moving bodies in the frame of their link.
    body : callable
        Maps an index to the body, packed by itself when it is first requested, since packing a cloud takes
        milliseconds.
    link, balls, pairs, margins, order, standing_bounds, standing_rows, standing_poses : ndarray
        See `records.Problem`.
    leaving, reaching : ndarray of bool, shape (pairs,)
        Whether a pair may be in contact at the start, or at the end, of a motion: see `Scene.leave` and `Scene.reach`.
    hits : ndarray of int64, shape (pairs,)
        Number of collisions found for each pair; no other array changes. Threads may lose each other's counts, but
        these affect only the order of the pairs.
    """

    robot: Robot
    version: int
    structure_version: int
    names: tuple[str, ...]
    bodies: Bodies
    body: Callable[[int], Body]
    link: Ints
    balls: Floats
    pairs: Ints
    margins: Floats
    leaving: Bools
    reaching: Bools
    order: Ints
    standing_bounds: NDArray[np.float32]
    standing_rows: NDArray[np.float32]
    standing_poses: Floats
    hits: Ints

    @classmethod
    def of(
        cls,
        robot: Robot,
        versions: tuple[int, int],
        names: tuple[str, ...],
        bodies: Bodies,
        link: Ints,
        pairs: Ints,
        margins: Floats,
        leaving: Bools,
        reaching: Bools,
    ) -> Problem:
        """Prepare pairs of bodies for a version and structure version of the scene; `with_poses` sets static poses."""
        packed = packed_of(bodies)
        start = packed.piece_start[len(link) :]
        return cls(
            robot, *versions, names, bodies, lru_cache(None)(bodies.__getitem__), link,
            balls=np.array([_ball(packed, k) for k in range(len(link))]).reshape(-1, 5),
            pairs=pairs,
            margins=margins,
            leaving=leaving,
            reaching=reaching,
            order=np.arange(len(pairs)),
            standing_bounds=np.zeros((len(start) - 1, columns.BOUNDS), dtype=np.float32),
            standing_rows=np.zeros((start[-1] - start[0], columns.HOT), dtype=np.float32),
            standing_poses=np.full((len(start) - 1, 16), np.nan),  # differs from every pose
            hits=np.zeros(len(pairs), dtype=np.int64),
        )  # fmt: skip

    # -- other problems with the same bodies --------------------------------------------------

    def only(self, pairs: Ints) -> Problem:
        """Select pairs by index."""
        chosen = replace(
            self, pairs=self.pairs[pairs], margins=self.margins[pairs], leaving=self.leaving[pairs],
            reaching=self.reaching[pairs], order=np.arange(len(pairs)), hits=np.zeros(len(pairs), dtype=np.int64),
        )  # fmt: skip
        Problem.cut.hand_on(self, chosen, lambda cut: cut and cut.only(pairs))
        return chosen

    def with_order(self, order: Ints) -> Problem:
        """Set the order in which configurations test the pairs; proofs of motions have an order of their own."""
        ordered = replace(self, order=order)
        Problem.cut.hand_on(self, ordered)
        Problem.motions.hand_on(self, ordered)
        return ordered

    def with_poses(self, poses: Floats, version: int) -> Problem:
        """Place the static bodies at the poses that they have in a version of the scene, shape (bodies, 4, 4)."""
        start = self.packed.piece_start[len(self.link) :]
        flat = np.ascontiguousarray(poses.reshape(-1, 16))
        # New arrays, since another thread may be reading the old ones; most of their entries still hold.
        bounds, rows = self.standing_bounds.copy(), self.standing_rows.copy()
        for k in np.flatnonzero((flat != self.standing_poses).any(axis=1)):
            placed = _placed_rows(self.packed.kernel.hot[start[k] : start[k + 1]], poses[k])
            rows[start[k] - start[0] : start[k + 1] - start[0]] = _single(placed)
            bounds[k, :7] = _single(_bounds(self.packed, start[k], placed, poses[k]))
        moved = replace(self, version=version, standing_bounds=bounds, standing_rows=rows, standing_poses=flat)
        Problem.cut.hand_on(self, moved, lambda cut: cut and cut.with_poses(poses, version))
        return moved

    # -- for kernels --------------------------------------------------------------------------

    @kept
    def packed(self) -> Packed:
        """The arrays of the bodies; its `handle` is their address."""
        return packed_of(self.bodies)

    @kept
    def arrays(self) -> tuple[Any, ...]:
        """The arrays in the order of `records.Problem`, and the table of their addresses."""
        arrays = (
            *self.robot.tree, self.link, self.balls, self.pairs, self.margins, self.order,
            self.standing_bounds, self.standing_rows, self.standing_poses,
        )  # fmt: skip
        return *arrays, records.table_of(arrays)

    @kept
    def handle(self) -> int:
        """Address of the table; valid as long as this object lives."""
        return int(self.arrays[-1].ctypes.data)

    @kept
    def names_of_pairs(self) -> NDArray[np.str_]:
        """Names of all pairs, shape (pairs + 1, 2); the last row is empty."""
        return np.array([*self.names, ""])[np.append(self.pairs, [[-1, -1]], axis=0)]

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
    def single(self) -> Any:
        """Fast queries of a single configuration or motion; see `loewner._native.singles`."""
        piece_pairs = int(np.diff(self.packed.piece_start)[self.pairs].prod(axis=1).sum())
        plain = self.robot._watch.range if self.robot.runs_straight else None
        held = self.arrays, self.packed
        return singles.configurations(self.packed.handle, self.handle, self.memory, piece_pairs, plain, self.hits, held)

    @kept
    def motions(self) -> PreparedMotions:
        """The additional data for certifying motions."""
        start = self.packed.piece_start[len(self.link) :]
        rows = [
            _placed_rows(self.packed.kernel.hot[start[k] : start[k + 1]], T)
            for k, T in enumerate(self.standing_poses.reshape(-1, 4, 4))
        ]
        tables = motion_tables(
            self.robot.tree, self.packed, self.link, self.balls, self.pairs, self.margins,
            self.standing_bounds.astype(np.float64), self.standing_poses,
            np.concatenate([np.empty((0, columns.HOT)), *rows]),
        )  # fmt: skip
        addresses = records.table_of(tables)
        memory = entries.motion_memory(self.packed.handle, self.handle, self.robot.dof)
        return PreparedMotions(tables, addresses, addresses.ctypes.data, memory)

    # -- parts and subsets --------------------------------------------------------------------

    @kept
    def cut(self) -> Problem | None:
        """The problem with its static surfaces cut into parts; None if there are no such surfaces.

        Static bodies are bodies in the world, or attached to links that are fixed to the root.
        """
        packed = in_parts(self.packed, self._stand)
        if packed is self.packed:
            return None
        first, bodies = packed.piece_start[len(self.link)], bodies_of(packed)
        unplaced = replace(
            self,
            bodies=bodies,
            body=lru_cache(None)(bodies.__getitem__),
            standing_bounds=np.zeros_like(self.standing_bounds),
            standing_rows=np.zeros((packed.piece_start[-1] - first, columns.HOT), dtype=np.float32),
            standing_poses=np.full_like(self.standing_poses, np.nan),
        )
        return unplaced.with_poses(self.standing_poses.reshape(-1, 4, 4), self.version)

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
        stand = np.ones(len(self.bodies), dtype=bool)
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
            "margins": self.margins, "standing_poses": self.standing_poses,
        }  # fmt: skip
        return _archives.digest(arrays)

    def poses(self, Q: Floats) -> Floats:
        """Compute the world poses of all bodies, shape (N, bodies, 4, 4), at checked configurations."""
        moving = link_poses(self.robot, Q)[:, self.link]
        standing = self.standing_poses.reshape(-1, 4, 4)
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


# -- bounds and rows --------------------------------------------------------------------------


def _ball(packed: Packed, k: int) -> tuple[float, ...]:
    """Compute the center and radius of a ball about a body, and the ball's largest distance from the origin."""
    first, last = packed.piece_start[k], packed.piece_start[k + 1]
    centers = packed.kernel.table[first:last, columns.OUTER_CENTER : columns.OUTER_CENTER + 3]
    # The kernel takes a single piece and its outer ellipsoid to have the same center.
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    radius = _farthest(packed, first, last, np.eye(4), middle) * STRETCH
    return (*middle, radius, (np.linalg.norm(middle) + radius) * STRETCH)


def _bounds(packed: Packed, first: int, placed: Floats, T: Floats) -> Floats:
    """Bound a placed body in the world: center and half sides of an axis-aligned box, and radius of a ball.

    The body's pieces begin at the index `first`; `placed` are their `_placed_rows` at the pose T.
    """
    last = first + len(placed)
    lower, upper = _box(packed, first, last, T, placed)
    reach = packed.kernel.table[first:last, columns.REACH].max(initial=0.0) + np.abs(T[:3, 3]).sum()
    off = 2 * tolerances.OFF * reach + tolerances.LEAST
    center, half = (lower + upper) / 2, (upper - lower) / 2 + off
    ball = _farthest(packed, first, last, T, center)
    wide = (min(ball, float(np.linalg.norm(half))) + off) * STRETCH
    return np.array((*center, wide, *(half * STRETCH)))


def _placed_rows(hot: Floats, T: Floats) -> Floats:
    """Express the ellipsoids of pieces in world coordinates, as rows for the certificate."""
    R, t = T[:3, :3], T[:3, 3]
    rows = hot.copy()
    for at in (columns.OUTER_CENTER, columns.INNER_CENTER):
        rows[:, at : at + 3] = hot[:, at : at + 3] @ R.T + t
    for at in (columns.OUTER_SHAPE, columns.INNER_SHAPE):
        rows[:, at : at + 6] = (R @ hot[:, at + _SYMMETRIC] @ R.T)[:, *_UPPER]
    rows[:, columns.REACH] += np.abs(t).sum()
    rows[:, [columns.OUTER_RADIUS, columns.REACH, columns.INVERSE_INNER_SIGMA]] *= tolerances.UP
    return rows


def _single(rows: Floats) -> NDArray[np.float32]:
    """Convert rows to single precision; numbers that are too large become infinite and certify nothing."""
    with np.errstate(over="ignore"):
        return rows.astype(np.float32)


def _box(packed: Packed, first: int, last: int, T: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Compute the corners of a world-aligned box about placed pieces, up to rounding.

    The box of a piece is no larger than the box of its ellipsoid or the box of its corners.
    """
    center = rows[:, columns.OUTER_CENTER : columns.OUTER_CENTER + 3]
    Q = rows[:, [columns.OUTER_SHAPE, columns.OUTER_SHAPE + 3, columns.OUTER_SHAPE + 5]]
    half = np.sqrt(Q + tolerances.SHAPE_ROUNDINGS * Q.sum(axis=1, keepdims=True))
    least, most = center - half, center + half
    corners, start, polytopes = _corners(packed, first, last, T)
    if len(start):
        least[polytopes] = np.maximum(least[polytopes], np.minimum.reduceat(corners, start))
        most[polytopes] = np.minimum(most[polytopes], np.maximum.reduceat(corners, start))
    return least.min(axis=0, initial=np.inf), most.max(axis=0, initial=-np.inf)


def _farthest(packed: Packed, first: int, last: int, T: Floats, center: Floats) -> float:
    """Bound from above, up to rounding, the distance from a point to the farthest point of placed pieces."""
    corners, _, polytopes = _corners(packed, first, last, T)
    others = packed.kernel.table[first:last][~polytopes]
    middles = others[:, columns.OUTER_CENTER : columns.OUTER_CENTER + 3] @ T[:3, :3].T + T[:3, 3]
    reach = np.linalg.norm(middles - center, axis=1) + others[:, columns.OUTER_RADIUS]
    return float(max(np.linalg.norm(corners - center, axis=1).max(initial=0.0), reach.max(initial=0.0)))


def _corners(packed: Packed, first: int, last: int, T: Floats) -> tuple[Floats, Ints, NDArray[np.bool_]]:
    """Place the corners of all polytopes among the pieces; also return their first rows, and which pieces they are."""
    layout = packed.layout[first:last]
    polytopes = layout[:, columns.KIND] == columns.POLYTOPE
    begin, end = layout[polytopes, columns.POINTS_FROM], layout[polytopes, columns.POINTS_TO]
    points = packed.points[ranges(begin, end)]
    return points @ T[:3, :3].T + T[:3, 3], starts(end - begin)[:-1], polytopes
