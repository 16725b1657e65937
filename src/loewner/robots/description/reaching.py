"""Find configurations at which a link has a given pose: prepare the kernel's tables, and wrap the kernel's answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _elementary, _validate
from loewner._base._low_discrepancy import points
from loewner._base._matrices import product
from loewner._base._threads import in_shares
from loewner._base._validate import Bools, Floats, Ints, OneOrMany
from loewner._kernels import columns
from loewner._kernels.records import Tree
from loewner._native import entries
from loewner.errors import InputError

# Poses are divided into chains. After the first pose of a chain, each search also starts from the previous answer. A
# chain has at most CHAINED poses. With many seeds, it has fewer poses, so that an interrupt does not wait long.
CHAINED, SEEDS_OF_A_CHAIN = 64, 2**14

# Maximum number of seeds, and maximum number of seeds in a table that is cached.
MOST_SEEDS, KEPT = 2**16, 1024

# Largest length or value. The square of the product of two such numbers does not overflow. If errors were infinite, the
# kernel's search would not end.
LARGEST = 1e50

# If the first solution is not free, FEW solutions are tried; if they are not free either, all seeds are tried.
FEW = 4

IDENTITY = np.eye(3)

# Number of columns of a configuration that a joint reads.
WIDTHS = {
    columns.FIXED: 0, columns.REVOLUTE: 1, columns.PRISMATIC: 1, columns.PLANAR: 3, columns.FLOATING: 7, columns.BALL: 4
}  # fmt: skip


class Collides(Protocol):
    """A collision checker."""

    def collide(self, Q: ArrayLike) -> OneOrMany:
        """Decide which configurations are in collision."""


@dataclass(frozen=True, eq=False, repr=False)
class Reached(_validate.Brief):
    """Configurations at which a link has given poses, as found by `Robot.reach`.

    Attributes
    ----------
    configuration : ndarray, shape (..., dof)
        A solution or, if none was found, the nearest configuration. With a checker, the solution is free if any of the
        solutions found is free.
    reached : bool or ndarray, shape (...)
        Whether the configuration is a solution; with a checker, only a free configuration counts.
    residual : ndarray, shape (..., 2)
        Distance [m] and angle [rad] by which the configuration exceeds the tolerance. If both are at most 1e-9 although
        `reached` is False, the pose can be reached, but the solutions found collide.
    solutions : ndarray, shape (k, dof), or tuple of such arrays, or None
        With ``all=True``: all distinct solutions found, free solutions first and then in order of distance from the
        start. For many poses, a tuple with one array for each pose in C order.
    free : int or ndarray, shape (...), or None
        With ``all=True`` and a checker: the number of solutions that are free.

    Examples
    --------
    >>> from loewner import Robot
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> found = robot.reach("forearm", robot.forward_kinematics([[0.5, 1.0], [1.5, 0.0]])[:, 2])
    >>> found.configuration.round(9), found.reached, bool((found.residual < 1e-9).all())
    (array([[0.5, 1. ],
           [1.5, 0. ]]), array([ True,  True]), True)
    """

    configuration: Floats
    reached: Any
    residual: Floats
    solutions: Any = None
    free: Any = None


class Chain(NamedTuple):
    """The joints from the root to a link, in the form that the kernel takes (`_kernels/robots/reach.py`).

    Attributes
    ----------
    links : ndarray of int64, shape (L, 3)
    constants : ndarray, shape (L, CHAIN_CONSTANTS)
    ranges : ndarray, shape (3, K)
    columns : ndarray of int64, shape (K,)
        Columns of the values in a configuration of the robot.
    path : ndarray of int64, shape (L,)
        The links of the robot's tree that the joints move.
    usual : ndarray, shape (2, K)
        Finite limits within which seeds are sampled.
    kept : dict
        Cached tables of seeds, keyed by the number of seeds.
    """

    links: Ints
    constants: Floats
    ranges: Floats
    columns: Ints
    path: Ints
    usual: Floats
    kept: dict[int, Floats]

    @property
    def moving(self) -> Bools:
        """Mark the values that the search may change."""
        return np.asarray(self.ranges[columns.HOW] != columns.HELD)


def chain(tree: Tree, link: int, moves: Bools, limits: Floats, usual: Floats) -> Chain:
    """Make the chain to a link.

    Parameters
    ----------
    tree : Tree
    link : int
    moves : ndarray of bool, shape (dof,)
        Columns of the joints that may move.
    limits, usual : ndarray, shape (2, dof)
        `limits` are the limits of the values, infinite for values without limits; `usual` are finite limits for seeds.
    """
    path = links_above(tree, link)[::-1]
    kinds, firsts = tree.kind[path], tree.column[path]
    widths = [WIDTHS[int(kind)] for kind in kinds]
    used = np.unique(np.concatenate([np.arange(at, at + wide) for at, wide in zip(firsts, widths, strict=True)]))
    used = used.astype(np.int64)
    links = np.zeros((len(path), columns.LINK_OF_CHAIN), dtype=np.int64)
    links[:, columns.KIND_OF_LINK] = kinds
    constants = np.zeros((len(path), columns.CHAIN_CONSTANTS))
    constants[:, : columns.CONSTANTS] = tree.constants[path]
    constants[:, columns.MULTIPLIER], constants[:, columns.OFFSET] = tree.multiplier[path], tree.offset[path]
    ranges = np.zeros((columns.RANGE, len(used)))
    ranges[columns.LEAST], ranges[columns.MOST] = -np.inf, np.inf
    ranges[columns.HOW] = columns.HELD
    wraps = wrapping(tree, len(moves))
    for row, (kind, first, wide) in enumerate(zip(kinds, firsts, widths, strict=True)):
        if wide == 0:
            continue
        at = int(np.searchsorted(used, first))
        links[row, columns.COLUMN_OF_LINK], links[row, columns.MOVES_OF_LINK] = at, moves[first]
        if kind in (columns.REVOLUTE, columns.PLANAR):
            constants[row, columns.AXIS :] = turning_axis(tree.constants[path[row]])
        if moves[first]:
            _set_ranges(ranges[:, at : at + wide], kind, limits[:, first : first + wide], wraps[first : first + wide])
    return Chain(links, constants, ranges, used, np.array(path), usual[:, used], {})


def links_above(tree: Tree, link: int) -> list[int]:
    """List a link and all links above it, from the link upwards; the list is empty for the world, which is -1."""
    links = []
    while link >= 0:
        links.append(link)
        link = int(tree.parent[link])
    return links


def wrapping(tree: Tree, dof: int) -> Bools:
    """Mark angles for which a whole turn returns every link to its place."""
    wraps = np.zeros(dof, dtype=bool)
    single = (tree.kind == columns.REVOLUTE) | (tree.kind == columns.PRISMATIC)
    turns = (tree.kind == columns.REVOLUTE) & (tree.multiplier == np.rint(tree.multiplier))
    wraps[tree.column[turns]] = True
    wraps[tree.column[single & ~turns]] = False
    wraps[tree.column[tree.kind == columns.PLANAR] + 2] = True
    return wraps


def _set_ranges(ranges: Floats, kind: int, limits: Floats, wraps: Bools) -> None:
    """Fill the columns of `ranges` for a joint that moves."""
    quaternion = {columns.FLOATING: 3, columns.BALL: 0}.get(kind, WIDTHS[kind])
    lengths = {columns.PRISMATIC: 1, columns.PLANAR: 2, columns.FLOATING: 3}.get(kind, 0)
    how, numbers = ranges[columns.HOW], slice(0, quaternion)
    ranges[columns.LEAST, numbers], ranges[columns.MOST, numbers] = limits[:, numbers]
    how[numbers] = np.where(wraps & (limits[1] - limits[0] >= 2 * np.pi), columns.WRAPS, columns.PLAIN)[numbers]
    how[:lengths][~np.isfinite(limits[:, :lengths]).all(axis=0)] = columns.FAR
    how[quaternion : quaternion + 1], how[quaternion + 1 :] = columns.TURNS, columns.REST


def turning_axis(constants: Floats) -> Floats:
    """Compute the axis of a turning joint in the frame that it moves, from the derivative of its rotation at 0."""
    blocks = [constants[k : k + 9].reshape(3, 3) for k in (columns.ROTATION, columns.COSINE, columns.SINE)]
    skew = product((blocks[0] + blocks[1]).T, blocks[2])
    return np.asarray(skew[[2, 0, 1], [1, 2, 0]])


def seeded(chain: Chain, count: int) -> Floats:
    """Make the table of seeds, shape (count, K), or return an existing one."""
    if count in chain.kept:
        return chain.kept[count]
    how, moving = chain.ranges[columns.HOW], np.flatnonzero(chain.moving)
    drawn = np.zeros((count, len(how)))
    drawn[:, moving] = points(count, len(moving))
    lower, upper = chain.usual
    seeds: Floats = lower + drawn * (upper - lower)
    seeds[:, how == columns.WRAPS] = (2 * np.pi * (drawn - 0.5))[:, how == columns.WRAPS]
    seeds[:, how == columns.FAR] = (2 * drawn - 1)[:, how == columns.FAR]
    for first in np.flatnonzero(how == columns.TURNS):  # Shoemake: Uniform random rotations, 1992
        u, v, w = drawn[:, first : first + 3].T * np.array([[1.0], [2 * np.pi], [2 * np.pi]])
        a, b = np.sqrt(1 - u), np.sqrt(u)
        seeds[:, first : first + 4] = np.stack(
            [a * _elementary.sin(v), a * _elementary.cos(v), b * _elementary.sin(w), b * _elementary.cos(w)], axis=-1
        )
    if count <= KEPT:
        chain.kept[count] = seeds
    return seeds


def checked_tolerance(tolerance: ArrayLike) -> Floats:
    """Check the tolerances of six coordinates, and convert angles to 2 sin(angle / 2), which the kernel takes."""
    tolerances = _validate.float_array(tolerance, "tolerance")
    if tolerances.shape != (6,) or not (tolerances >= 0).all():
        raise InputError(
            "tolerance: expected six numbers >= 0 or infinity (x, y, z [m], tilt about x and y, spin about z [rad]), "
            f"found {_validate.short(tolerance)}"
        )
    checked = np.where(tolerances >= np.pi, np.inf, 2 * _elementary.sin(np.minimum(tolerances, np.pi) / 2))
    checked[:3] = tolerances[:3]
    return checked


def targets_of(T: Floats) -> Floats:
    """Make the rotations of poses, which may be off by `ROTATION_TOLERANCE`, orthonormal up to rounding."""
    for _ in range(3):
        R = T[..., :3, :3]
        square = product(R.swapaxes(-1, -2), R)
        if np.abs(square - IDENTITY).max(initial=0.0) < 1e-14:
            return T
        T = T.copy()
        T[..., :3, :3] = 1.5 * R - product(0.5 * R, square)
    return T


def refuse_far(chain: Chain, T: Floats, starts: Floats) -> None:
    """Refuse poses, starts and robots whose numbers may overflow in the kernel."""
    own = np.concatenate([chain.constants.ravel(), chain.usual.ravel()])
    for name, numbers in (("robot", own), ("T", T[..., :3, 3]), ("start", starts[..., chain.columns])):
        largest = float(np.abs(numbers).max(initial=0.0))
        if largest > LARGEST:
            raise InputError(f"{name}: expected lengths and values within ±{LARGEST:g}, found {largest:g}")


def refuse_unsteady(chain: Chain, link: str) -> None:
    """Refuse moving joints with a quaternion, since quaternions do not change along straight lines."""
    moves, kinds = chain.links[:, columns.MOVES_OF_LINK], chain.links[:, columns.KIND_OF_LINK]
    if moves[kinds >= columns.FLOATING].any():
        raise InputError(
            f"joints: expected joints that turn or slide before {link!r}, found a floating or ball joint; name the "
            "joints that are to move"
        )


class Answers(NamedTuple):
    """The kernel's results for each pose: distinct solutions, their number, and the first solution or best attempt."""

    solutions: Floats
    counts: Ints
    nearest: Floats

    def residual(self, values: int) -> Floats:
        """Return the metres and radians by which the nearest configurations miss the tolerance, shape (n, 2)."""
        tilt, spin = np.minimum((0.5 * self.nearest[:, values + 1 :]) ** 2, 1.0).T
        # The axes of tilt and spin are perpendicular, so cos(angle / 2) is the product of the half angles' cosines.
        angles = 2.0 * _elementary.arcsin(np.sqrt(tilt + spin * (1.0 - tilt)))
        return np.stack([self.nearest[:, values], angles], axis=-1)


def solve(chain: Chain, T: Floats, starts: Floats, seeds: Floats, most: int, tolerance: Floats) -> Answers:
    """Find up to `most` solutions for each of n poses, shape (n, 4, 4), with starts of shape (n, K).

    The search begins at the point within the limits that is nearest to the start.
    """
    # The kernel keeps its steps within the limits, but does not move the start into the limits. A held value has no
    # limits.
    starts = starts.clip(chain.ranges[columns.LEAST], chain.ranges[columns.MOST])
    count, values = len(T), len(chain.columns)
    _validate.fits_memory(8 * count * (most + 1) * (values + 3), f"{most} solutions for each of {count} poses")
    solutions, counts = np.empty((count, most, values)), np.zeros(count, dtype=np.int64)
    nearest = np.empty((count, values + 3))
    chained = max(1, min(CHAINED, SEEDS_OF_A_CHAIN // len(seeds)))

    def run(first: int, last: int) -> None:
        entries.reach_poses(
            *chain[:3], tolerance, T, starts, seeds, chained, chained * first, min(chained * last, count),
            solutions, counts, nearest,
        )  # fmt: skip

    in_shares(run, -(-count // chained), 1)
    return Answers(solutions, counts, nearest)


class Solutions(NamedTuple):
    """All solutions in the order of `Reached.solutions`, each with the index of its pose and whether it is free."""

    Q: Floats
    poses: Ints
    free: Bools

    @classmethod
    def of(cls, answers: Answers, chain: Chain, starts: Floats, checker: Collides | None) -> Solutions:
        """Sort the solutions of poses with the given starts, shape (n, dof)."""
        poses = np.repeat(np.arange(len(starts)), answers.counts)
        Q = starts[poses]
        Q[:, chain.columns] = answers.solutions[np.arange(answers.solutions.shape[1]) < answers.counts[:, None]]
        free = np.ones(len(Q), dtype=bool) if checker is None or len(Q) == 0 else ~np.asarray(checker.collide(Q))
        order = np.lexsort((np.linalg.norm(Q - starts[poses], axis=1), ~free, poses))
        return cls(Q[order], poses, free[order])

    def choose(self, Q: Floats, reached: Bools) -> None:
        """For each pose that has solutions, write the first one into Q, and whether it is free into `reached`."""
        having, first = np.unique(self.poses, return_index=True)
        Q[having], reached[having] = self.Q[first], self.free[first]


def reach(
    chain: Chain,
    T: Floats,
    starts: Floats,
    *,
    seeds: int,
    checker: Collides | None,
    every: bool,
    tolerance: Floats,
) -> Reached:
    """Reach poses, shape (..., 4, 4), from starts that broadcast with them; all arguments have been checked."""
    refuse_far(chain, T, starts)
    shape = _validate.broadcast({"T": T.shape[:-2], "start": starts.shape[:-1]})
    count, values = math.prod(shape), len(chain.columns)
    # Copy the arrays, because kernels do not accept read-only arrays.
    targets = np.array(np.broadcast_to(targets_of(T), (*shape, 4, 4)), order="C").reshape(count, 4, 4)
    starts = np.array(np.broadcast_to(starts, (*shape, starts.shape[-1]))).reshape(count, starts.shape[-1])
    table, begins = seeded(chain, seeds), np.array(starts[:, chain.columns], order="C")
    answers = solve(chain, targets, begins, table, seeds + 2 if every else 1, tolerance)
    Q, reached = starts.copy(), answers.counts > 0
    Q[:, chain.columns] = answers.nearest[:, :values]
    lists, numbers = None, None
    if every or checker is not None:
        solutions = Solutions.of(answers, chain, starts, checker)
        solutions.choose(Q, reached)
    if every:
        lists = tuple(np.split(solutions.Q, np.cumsum(answers.counts)))[:count]
        numbers = (
            None if checker is None else np.bincount(solutions.poses[solutions.free], minlength=count).reshape(shape)
        )
    for most in () if every or checker is None else (FEW, seeds + 2):
        left = np.flatnonzero(~reached & (answers.counts > 0))
        if len(left):
            more = solve(chain, targets[left], begins[left], table, most, tolerance)
            chosen, freed = Q[left], reached[left]
            Solutions.of(more, chain, starts[left], checker).choose(chosen, freed)
            Q[left], reached[left] = chosen, freed
    residual = answers.residual(values)
    if not shape:
        number = None if numbers is None else int(numbers)
        return Reached(Q[0], bool(reached[0]), residual[0], None if lists is None else lists[0], number)
    return Reached(Q.reshape(*shape, Q.shape[-1]), reached.reshape(shape), residual.reshape(*shape, 2), lists, numbers)
