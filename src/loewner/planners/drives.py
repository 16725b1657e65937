"""Define `Drive`, a sequence of arcs, straight lines and turns in place, for mobile bases.

Proofs of motions apply to polynomials, but an arc is not a polynomial. Each piece of an arc is replaced with the
polynomial of degree 7 that agrees with the piece at both ends in position and three derivatives. The proof covers all
configurations that deviate from the polynomial by no more than the arc does; docs/certified.md derives the bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._elementary import cos, sin
from loewner._base._guard import guarded
from loewner._base._pictures import POINTS, curves, pictured
from loewner._base._read_only import KeepsReadOnly, protected
from loewner._base._validate import Floats, Ints
from loewner._kernels import columns as kernel_columns
from loewner._kernels import tolerances
from loewner.errors import InputError
from loewner.planners.steering import driven, moved
from loewner.robots import Proof, Robot
from loewner.robots.proofs.curves import Curve, form_of

# Largest distance between an arc and the polynomial that represents it [m], and the largest turn of one piece [rad].
DEVIATION, LARGEST_TURN = 1e-6, math.pi / 2.0

# Largest number of pieces of a drive: a turn by millions of radians must not exhaust the memory.
MOST_PIECES = 100_000

# An arc's polynomial has an error of at most the arc's eighth derivative divided by 8! 2^8.
REMAINDER = 40320.0 * 256.0

# Bound on rounding errors of courses and of positions on arcs, relative to the positions plus length * (1 + turn).
ARC_ROUNDINGS = 64.0 * tolerances.UNIT_ROUNDOFF  # certified.md B70

# Largest deviation of the motion of the base's link from a plane [m, or a cosine].
PLANAR = 1e-9


class Arcs(NamedTuple):
    """The courses of N motions.

    Attributes
    ----------
    courses : ndarray, shape (pieces, 8, 3)
        Control points of x, y and theta.
    off : ndarray, shape (pieces, 3)
        How far the values may deviate from the courses.
    owner : ndarray of int, shape (pieces,)
        Index of the motion to which each piece belongs, in order.
    begin : ndarray, shape (pieces,)
        The fraction of the motion at which each piece begins.
    """

    courses: Floats
    off: Floats
    owner: Ints
    begin: Floats

    def of_robot(self, q: Floats, columns: list[int]) -> tuple[Floats, Floats]:
        """Return the courses of all joints, and their deviations; joints outside of `columns` keep the values of q."""
        courses, off = np.tile(q, (len(self.owner), 8, 1)), np.zeros((len(self.owner), len(q)))
        courses[..., columns], off[:, columns] = self.courses, self.off
        return courses, off


@dataclass(frozen=True, eq=False, repr=False)
class Drive(KeepsReadOnly):
    """A sequence of arcs, straight lines and turns in place of a mobile base; made by `plan` with `base`, or by `of`.

    `CollisionChecker.certify_trajectory` accepts a drive as a curve, and proves the arcs themselves.

    Attributes
    ----------
    names : tuple of str
        Names of the columns, as in `Robot.configuration_names`.
    path : ndarray, shape (k + 1, dof)
        Configurations at which motions begin, and the last configuration. The base does not move straight between two
        configurations, so use `positions` to interpolate.
    motions : ndarray, shape (k, 2)
        Length of each motion [m], negative for driving backwards, and its turn [rad], positive to the left. An arc has
        a length and a turn; a straight line has no turn, and a turn in place has no length.
    columns : tuple of int
        The columns of x, y and theta.
    times : ndarray, shape (k + 1,)
        Times at which motions begin, and the time at which the last motion ends, in seconds. Within a motion, the base
        drives and turns at constant rates. Drives from `plan` and `of` are as fast as possible without exceeding 1 m/s
        and 1 rad/s. The drive ``dataclasses.replace(drive, times=drive.times / 0.5)`` is half as fast.
    iterations : int
        Number of poses from which the search continued.
    seconds : float
        Duration of the search.
    proof : Proof or None
        A proof that the drive is free, if one was requested.

    Examples
    --------
    >>> base = Robot.footprint([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]], height=0.5)
    >>> drive = Drive.of(base, [0, 0, 0], [[1.0, 0.0], [0.5, 1.0]])
    >>> drive
    Drive(1.5 m, 2 motions, 0 changes of direction)
    >>> drive.positions(1.0)
    array([1., 0., 0.])
    """

    names: tuple[str, ...]
    path: Floats
    motions: Floats
    columns: tuple[int, int, int]
    times: Floats
    iterations: int = 0
    seconds: float = 0.0
    proof: Proof | None = None

    @classmethod
    @guarded
    def of(cls, robot: Robot, start: ArrayLike, motions: ArrayLike) -> Drive:
        """Make a drive from given motions.

        Parameters
        ----------
        robot : Robot
            A robot with a planar base (see `Robot.footprint` and `Robot.add_base`); all other joints keep their values.
        start : array_like, shape (dof,)
        motions : array_like, shape (k, 2)
            As for the attribute `motions`.

        Returns
        -------
        Drive

        Raises
        ------
        InputError
            If an argument has the wrong shape or value, a motion neither drives nor turns, or the robot has no planar
            base.
        """
        _validate.instance(robot, "robot", Robot)
        q, checked_motions = robot.checked_one(start, "start"), _validate.finite_array(motions, "motions", ("k", 2))
        if len(checked_motions) == 0 or not (checked_motions != 0.0).any(axis=1).all():
            raise InputError("motions: expected one or more, each with a length or a turn, found others")
        columns = base_columns(robot)
        with np.errstate(over="ignore", invalid="ignore"):  # refused below
            poses = driven(q[list(columns)], checked_motions[:, 0], checked_motions[:, 1])
        if not np.isfinite(poses).all():
            raise InputError("motions: expected lengths and turns that add up to finite poses, found others")
        return cls._through(robot, q, poses, checked_motions, columns)

    @classmethod
    def _through(cls, robot: Robot, q: Floats, poses: Floats, motions: Floats, columns: tuple[int, int, int]) -> Drive:
        """Make a drive of poses, shape (k + 1, 3), and the motions between them, with the other joints as in q."""
        path = np.tile(q, (len(poses), 1))
        path[:, list(columns)] = poses
        times = np.append(0.0, np.abs(motions).max(axis=1).cumsum())
        return protected(cls(robot.configuration_names, path, motions.copy(), columns, times))

    def __repr__(self) -> str:
        count = len(self.motions)
        return (
            f"Drive({self.length:.4g} m, {count} motion{'s' * (count != 1)}, {self.reversals} "
            f"change{'s' * (self.reversals != 1)} of direction)"
        )

    @pictured
    def _repr_html_(self) -> str:
        t = np.linspace(self.times[0], self.times[-1], POINTS)
        return curves(self.names, t, self.positions(t))

    @property
    def length(self) -> float:
        """Length of the drive, in metres."""
        return float(np.abs(self.motions[:, 0]).sum())

    @property
    def turn(self) -> float:
        """Sum of the sizes of all turns, to the left and to the right, in radians."""
        return float(np.abs(self.motions[:, 1]).sum())

    @property
    def reversals(self) -> int:
        """Number of changes between driving forwards and driving backwards."""
        signs = np.sign(self.motions[:, 0])
        return int(np.count_nonzero(np.diff(signs[signs != 0.0])))

    def positions(self, t: ArrayLike) -> Floats:
        """Compute the configurations at given times.

        Parameters
        ----------
        t : array_like, shape (...)
            Times in seconds, from the first to the last of `times`.

        Returns
        -------
        ndarray, shape (..., dof)

        Raises
        ------
        InputError
            If a time is not a number, or is outside the drive.

        Examples
        --------
        >>> base = Robot.footprint([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]], height=0.5)
        >>> Drive.of(base, [0, 0, 0], [[2.0, 0.0]]).positions([0.5, 2.0])
        array([[0.5, 0. , 0. ],
               [2. , 0. , 0. ]])
        """
        ticks = _validate.finite_array(t, "t", ("...",))
        if not ((ticks >= self.times[0]) & (ticks <= self.times[-1])).all():
            raise InputError(f"t: expected times from {self.times[0]:g} to {self.times[-1]:g}, found others")
        k = np.clip(np.searchsorted(self.times, ticks, side="right") - 1, 0, len(self.motions) - 1)
        shares = (ticks - self.times[k]) / (self.times[k + 1] - self.times[k])
        Q, columns = self.path[k].copy(), list(self.columns)
        Q[..., columns] = moved(Q[..., columns], shares * self.motions[k, 0], shares * self.motions[k, 1])
        return np.where((shares == 1.0)[..., None], self.path[k + 1], Q)


@form_of.register(Drive)
def _form(given: Drive, name: str) -> Curve:
    """Make the curve of polynomials that represent arcs; see `CollisionChecker.certify_trajectory`."""
    columns = list(given.columns)
    if (np.delete(given.path, columns, axis=1) != np.delete(given.path[:1], columns, axis=1)).any():
        raise InputError(f"{name}: expected a drive whose other joints keep their values, found one that moves them")
    poses, (lengths, turns) = given.path[:, columns], given.motions.T
    gaps = np.abs(moved(poses[:-1], lengths, turns) - poses[1:])
    arcs = arcs_of(poses[:-1], lengths, turns, poses[1:], gaps)
    courses, off = arcs.of_robot(given.path[0], columns)
    times = given.times[arcs.owner] + np.diff(given.times)[arcs.owner] * arcs.begin
    return Curve(given.names, np.append(times, given.times[-1]), courses, off)


def arcs_of(poses: Floats, lengths: Floats, turns: Floats, ends: Floats, gaps: Floats) -> Arcs:
    """Return the courses of N motions.

    Parameters
    ----------
    poses, ends : ndarray, shape (N, 3)
        The pose at which each motion begins, and the pose at which its course ends.
    lengths, turns : ndarray, shape (N,)
    gaps : ndarray, shape (N, 3)
        How far the end of each course is from the end of its motion.
    """
    ways, angles = np.abs(lengths), np.abs(turns)
    with np.errstate(over="ignore", invalid="ignore"):  # refused below
        count = np.ceil((ways * angles**7 / (REMAINDER * DEVIATION)) ** 0.125)
        count = np.maximum(count, np.ceil(angles / LARGEST_TURN))
    if not count.sum() <= MOST_PIECES:
        raise InputError(
            f"motions: expected at most {MOST_PIECES:,} pieces of arcs, which turn by up to 90 degrees each, found "
            f"{count.sum():.3g}"
        )
    count = np.maximum(count, 1.0).astype(np.int64)
    owner = np.repeat(np.arange(len(poses)), count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    n, last = count[owner], place + 1 == count[owner]
    first, length, turn = poses[owner], lengths[owner], turns[owner]
    a = np.where((place == 0)[:, None], first, moved(first, length * (place / n), turn * (place / n)))
    b = np.where(last[:, None], ends[owner], moved(first, length * ((place + 1) / n), turn * ((place + 1) / n)))
    length, turn = length / n, turn / n
    courses = np.empty((len(owner), 8, 3))
    courses[..., 2] = a[:, 2, None] + (b - a)[:, 2, None] * (np.arange(8) / 7.0)
    courses[:, -1, 2] = b[:, 2]
    for pose, sign, points in ((a, 1.0, courses), (b, -1.0, courses[:, ::-1])):
        along = np.stack([cos(pose[:, 2]), sin(pose[:, 2])], axis=1) * length[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1) * turn[:, None]
        third = along * (turn * turn)[:, None]
        points[:, 0, :2] = pose[:, :2]
        points[:, 1, :2] = pose[:, :2] + sign * along / 7.0
        points[:, 2, :2] = pose[:, :2] + (sign * (2.0 / 7.0) * along + across / 42.0)
        points[:, 3, :2] = pose[:, :2] + (sign * (3.0 / 7.0) * along + across / 14.0 - sign * third / 210.0)
    turned = np.abs(courses[..., 2]).max(axis=1) + 2.0 * angles[owner]
    size = np.abs(courses[..., :2]).max(axis=(1, 2)) + ways[owner] * (1.0 + turned)
    off = gaps[owner] + ARC_ROUNDINGS * np.stack([size, size, turned], axis=1)
    remainder = np.abs(length) * np.abs(turn) ** 7 / REMAINDER * (1.0 + 1e-9)
    off[:, :2] += (remainder + gaps[owner, 2] * ways[owner])[:, None]
    return Arcs(courses, off, owner, place / n)


def base_columns(robot: Robot) -> tuple[int, int, int]:
    """Find the columns of a planar base: x, y and an angle at the robot's root. No other joint may follow these values.

    Raises
    ------
    InputError
        If the robot has no such base.
    """
    tree = robot.tree
    moving = tree.kind != kernel_columns.FIXED
    for link in np.flatnonzero(moving).tolist():
        if tree.kind[link] == kernel_columns.PLANAR:
            chain, first = [int(tree.column[link])], link
            columns = [chain[0] + k for k in range(3)]
        else:
            second = int(tree.parent[link])
            first = int(tree.parent[second]) if second >= 0 else -1
            columns = chain = [int(tree.column[k]) for k in (first, second, link)]
        alone = all(np.count_nonzero(moving & (tree.column == column)) == 1 for column in chain)
        if first >= 0 and tree.parent[first] < 0 and alone and _is_planar(robot, link, columns):
            return columns[0], columns[1], columns[2]
    raise InputError(
        "base: expected a robot whose root slides along x and y and turns, as Robot.footprint or "
        f"add_base('planar') makes it, found the joints {_validate.short(', '.join(robot.joint_names))}"
    )


def _is_planar(robot: Robot, link: int, columns: list[int]) -> bool:
    """Return whether three values are a position in a plane and a turn from its first axis to its second."""
    if len(set(columns)) < 3:
        return False
    Q = np.tile(robot.configuration(), (4, 1))
    Q[:, columns] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, math.pi / 2.0]]
    rest, *others = robot.forward_kinematics(Q)[:, link]
    x, y = (one[:3, 3] - rest[:3, 3] for one in others[:2])
    turned = others[2][:3, :3] @ rest[:3, :3].T
    wanted = np.array([x @ x - 1.0, y @ y - 1.0, x @ y, *(turned @ x - y), *(turned @ y + x)])
    still = [(one - rest)[:3, :3].ravel() for one in others[:2]] + [(others[2] - rest)[:3, 3]]
    return bool((np.abs(np.concatenate([wanted, *still])) <= PLANAR).all())
