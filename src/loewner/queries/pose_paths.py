"""Motions of bodies in time.

A motion consists of poses at several times. Between two times, the body moves along a straight line and turns at a
constant rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _elementary, _validate
from loewner._base._kept import kept
from loewner._base._matrices import product
from loewner._base._read_only import KeepsReadOnly, read_only
from loewner._base._rotations import quaternions_of, rotations_of
from loewner._base._validate import Floats, Ints
from loewner._kernels import tolerances
from loewner._native import entries
from loewner.errors import InputError

# A turn between two poses must be smaller than half a turn by at least this angle [rad]. For half a turn, neither
# direction is shorter.
NEARLY_HALF = 1e-3

# A motion with a twist is divided into turns of at most this angle [rad].
MOST_TURN = 3.0

# Cubic curves approximate the pieces of a motion. The quaternions at the ends of a piece differ by at most this angle
# [rad].
MOST_ARC = 0.05

# The first and the last pose of a motion that repeats may differ slightly: in orientation by the angle CLOSED_TURN
# [rad], and in position by CLOSED, relative to 1 m or to the largest coordinate if that is larger.
CLOSED, CLOSED_TURN = 1e-9, 1e-6

# Largest speed [m/s], and shortest time between two poses [s]. Within these limits, bounds on rounding are far from
# overflow.
FASTEST, SHORTEST = 1e12, 1e-12

# After this many repetitions, times within a motion are lost in rounding.
MOST_REPEATED = 2.0**40

# Largest number of knots of a query, including all repetitions and the parts into which turns are divided.
MOST_KNOTS = 2**22

# Allowance for rounding in a bound on deviations, relative to the bound's largest value on a piece of a motion.
OFF_ROUNDINGS = 16.0 * tolerances.UNIT_ROUNDOFF  # certified.md B69

# Largest deviation of a body [m]. With a larger deviation, no configuration counts as free of the body, because the
# kernels refuse lengths of this size.
MOST_OFF = 1e100


@dataclass(frozen=True)
class PoseBounds:
    """Bounds on how far a body may be from its stated pose; see `Scene.follow` and `Scene.move`.

    At time t, the body's origin deviates by at most metres + speed |t - since|, and its orientation by at most radians
    + turn |t - since|. A point at distance ρ from the origin deviates by no more than the first bound plus ρ times the
    second bound. The deviation therefore depends on where the origin of the body's frame is.

    Attributes
    ----------
    metres, radians : float
        Constant errors of position and orientation.
    speed, turn : float
        Rates at which the errors grow [m/s, rad/s].
    since : float
        Time from which the errors grow [s].
    reach : float
        The largest ρ [m]: an upper bound on the distance of the body's points from its origin. The radius of a surface
        or cloud does not count, since a rotation moves a ball no farther than its center.

    Examples
    --------
    >>> from loewner import Body, Scene
    >>> scene = Scene()
    >>> scene.add("box", Body.box([0.6, 0.8, 0.2]), error=(0.01, 0.1))
    >>> print(round(scene.bounds["box"].reach, 3), round(scene.bounds["box"].off(0.0), 3))
    0.51 0.061
    """

    metres: float
    radians: float
    speed: float
    turn: float
    since: float
    reach: float

    @property
    def rate(self) -> float:
        """Rate at which the bound on the deviation of the body's points grows [m/s]."""
        return self.speed + self.reach * self.turn

    def off(self, t: Any) -> Any:
        """Bound the deviation, in metres, of the body's points at times t, shape (...)."""
        with np.errstate(over="ignore", invalid="ignore"):
            deviation = (self.metres + self.reach * self.radians) + self.rate * np.abs(t - self.since)
            return np.fmin(deviation * (1.0 + OFF_ROUNDINGS), MOST_OFF)  # MOST_OFF replaces NaN as well


@dataclass(frozen=True, eq=False, repr=False)
class PosePath(_validate.Brief, KeepsReadOnly):
    """A body's motion over time; see `Scene.follow`.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Seconds, increasing.
    positions : ndarray, shape (n, 3)
        Metres. Between two times, the position changes linearly.
    quaternions : ndarray, shape (n, 4)
        The real part comes first. Between two times, the body turns the shorter way, at a constant rate.
    repeat : bool
        Whether the motion starts again when it ends. If false, the body stays at the first pose before the motion, and
        at the last pose after the motion.

    Examples
    --------
    >>> from loewner import Body, Scene
    >>> scene = Scene()
    >>> scene.add("box", Body.box([0.2, 0.2, 0.2]))
    >>> T = np.tile(np.eye(4), (2, 1, 1))
    >>> T[1, 0, 3] = 2.0
    >>> scene.follow("box", [0.0, 10.0], T)
    >>> scene.following["box"].poses(2.5)[:3, 3]
    array([0.5, 0. , 0. ])
    """

    times: Floats
    positions: Floats
    quaternions: Floats
    repeat: bool

    @kept
    def rests(self) -> bool:
        """Whether the body always has the same pose."""
        return bool((self.positions == self.positions[0]).all() and (self.quaternions == self.quaternions[0]).all())

    def poses(self, t: ArrayLike) -> Floats:
        """Compute the poses at given times.

        Parameters
        ----------
        t : array_like, shape (...)
            Seconds.

        Returns
        -------
        ndarray, shape (..., 4, 4)
            T_world_body; translation in metres.
        """
        at = _validate.finite_array(t, "t", ("...",))
        values = PackedPaths.of((self,)).values(at.ravel())[:, 0]
        T = np.zeros((len(values), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rotations_of(values[:, 3:]), values[:, :3], 1.0
        return T.reshape(*at.shape, 4, 4)

    @kept
    def period(self) -> float:
        """Time from the first pose to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @kept
    def arcs(self) -> Floats:
        """Angles between successive quaternions [rad]; the body turns by twice these angles."""
        chords = np.linalg.norm(np.diff(self.quaternions, axis=0), axis=1)
        return np.asarray(2.0 * _elementary.arcsin(np.minimum(chords / 2.0, 1.0)))

    @kept
    def _fine(self) -> Floats:
        """The times of the motion, with additional times so that angles between quaternions are at most `MOST_ARC`."""
        parts: Ints = np.maximum(np.ceil(self.arcs / MOST_ARC), 1).astype(np.int64)
        first = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(len(first)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[first]
        steps = np.diff(self.times)
        return np.append(self.times[first] + share * steps[first], self.times[-1])


def path_of(times: ArrayLike, poses: ArrayLike, repeat: bool) -> PosePath:
    """Check a motion's times and poses.

    Raises
    ------
    InputError
        If there are fewer than two times, or times do not increase; if the numbers of poses and times differ; if two
        successive poses differ by half a turn; or if a motion that repeats does not end at its first pose.
    PoseError
        If a pose is not a rigid motion.
    """
    at = _validate.finite_array(times, "times", (None,)).copy()
    T = _validate.poses(poses, "poses")
    repeat = _validate.flag(repeat, "repeat")
    if len(at) < 2 or T.shape != (len(at), 4, 4):
        raise InputError(
            f"expected two times or more and a pose for each, shape (n, 4, 4), found {len(at)} and poses of shape "
            f"{_validate.shape_text(T.shape)}"
        )
    with np.errstate(over="ignore"):
        _validate.increasing(at, "times")
        if not np.isfinite(at[-1] - at[0]):
            raise InputError(f"times: expected a finite duration, found {at[0]:.15g} .. {at[-1]:.15g}")
    positions, quaternions = T[:, :3, 3].copy(), quaternions_of(T[:, :3, :3])
    if repeat:
        cosine = float(quaternions[0] @ quaternions[-1])
        jump, turn = float(np.linalg.norm(positions[-1] - positions[0])), 2.0 * np.arccos(min(abs(cosine), 1.0))
        if jump > CLOSED * max(1.0, float(np.abs(positions).max())) or turn > CLOSED_TURN:
            raise InputError(
                f"poses: expected a motion that ends where it begins, since it repeats, found a jump of {jump:g} m and "
                f"{turn:g} rad"
            )
        positions[-1], quaternions[-1] = positions[0], quaternions[0]
    signs = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(signs)[:, None]
    read_only(at, positions, quaternions)  # so that no change in place goes unnoticed
    path = PosePath(at, positions, quaternions, repeat)
    for k in np.flatnonzero(path.arcs > (np.pi - NEARLY_HALF) / 2)[:1]:
        raise InputError(
            f"poses: expected turns of less than half a turn, whose direction is clear, found one of "
            f"{2 * path.arcs[k]:.4f} rad between the times {at[k]:.15g} and {at[k + 1]:.15g}; add poses in between"
        )
    with np.errstate(over="ignore"):
        fast = np.flatnonzero(~(np.abs(np.diff(positions, axis=0)).max(axis=1) / np.diff(at) <= FASTEST))[:1]
    for k in np.append(fast, np.flatnonzero(np.diff(at) < SHORTEST))[:1]:
        raise InputError(
            f"times: expected speeds below {FASTEST:g} m/s and times at least {SHORTEST:g} s apart, found "
            f"{np.diff(at)[k]:g} s from {at[k]:.15g} s on"
        )
    return path


def with_twist(times: ArrayLike, pose: ArrayLike, twist: ArrayLike) -> tuple[Floats, Floats]:
    """Make the times and poses of a body that moves with a twist.

    The body's origin moves along a straight line while the body turns about its origin, both at constant rates.

    Raises
    ------
    InputError
        If the times are not two increasing numbers, if there is more than one pose, or if there are too many turns.
    """
    at, rates = _validate.finite_array(times, "times", (None,)), _validate.finite_array(twist, "twist", (6,))
    first = _validate.poses(pose, "poses")
    if len(at) != 2 or first.shape != (4, 4) or not at[1] > at[0]:
        raise InputError(
            f"twist: expected two times that increase and one pose with it, found {len(at)} times and poses of shape "
            f"{_validate.shape_text(first.shape)}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        speed = float(np.linalg.norm(rates[3:]))
        turns = speed * (at[1] - at[0]) / MOST_TURN
        if not turns <= MOST_KNOTS:
            raise InputError(f"twist: expected at most {MOST_KNOTS} turns of {MOST_TURN:g} rad, found {turns:g}")
        knot_times = np.linspace(at[0], at[1], max(math.ceil(turns), 1) + 1)
        half, T = (knot_times - at[0])[:, None] * (speed / 2.0), np.tile(first, (len(knot_times), 1, 1))
        axis = rates[3:] / speed if speed else np.zeros(3)
        T[:, :3, :3] = product(
            rotations_of(np.concatenate([_elementary.cos(half), _elementary.sin(half) * axis], axis=1)), first[:3, :3]
        )
        T[:, :3, 3] += (knot_times - at[0])[:, None] * rates[:3]
    return knot_times, T


def _knots(path: PosePath, low: Floats, high: Floats, fine: bool) -> Floats:
    """List at least the times of a repeating motion between each `low` and `high`; `fine` adds times to divide turns.

    Raises
    ------
    InputError
        If there are more than `MOST_KNOTS` times, or if the motion has repeated so often that its times are lost in
        rounding.
    """
    at = path._fine if fine else path.times
    with np.errstate(over="ignore"):
        first, last = (np.floor((t - at[0]) / path.period) for t in (low, high))
    if not (np.abs([first, last]) < MOST_REPEATED).all():
        raise InputError(
            f"expected times within {MOST_REPEATED:g} repetitions of a motion of {path.period:g} s, found "
            f"{low.min():.15g} .. {high.max():.15g} s"
        )
    counts = (last - first).astype(np.int64) + 1
    total = int(counts.sum())
    if total * len(at) > MOST_KNOTS:
        raise InputError(
            f"expected at most {MOST_KNOTS} knots of moving bodies, found {total * len(at)} between the times "
            f"{low.min():.15g} and {high.max():.15g}; divide the query into shorter times"
        )
    number = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
    return np.asarray(at[:-1] + path.period * number[:, None]).ravel()


class PackedPaths(NamedTuple):
    """The motions of several bodies, as arrays for the kernel `pose_values`.

    Attributes
    ----------
    paths : tuple of PosePath
    start, times, rows, arcs, periods
        See `loewner._kernels.robots.pose_paths`.
    far, speeds, turns : ndarray, shape (bodies,)
        Bounds on the entries of positions [m], on speeds [m/s] and on rates of quaternions [1/s].
    spans : ndarray, shape (bodies,)
        For each body, the largest number that is added to a time when the time is located in the body's motion [s].
    once : tuple of 2 ndarray
        The times of all motions that do not repeat, in order; and the same list, with additional times that divide
        turns.
    bounds : tuple of PoseBounds
        Bounds on how far bodies may deviate from their motions or poses.
    numbers : ndarray, shape (len(bounds),)
        For each entry of `bounds`, the index of the body among all bodies; negative for a body without pieces.
    """

    paths: tuple[PosePath, ...]
    start: Ints
    times: Floats
    rows: Floats
    arcs: Floats
    periods: Floats
    far: Floats
    speeds: Floats
    turns: Floats
    spans: Floats
    once: tuple[Floats, Floats]
    bounds: tuple[PoseBounds, ...]
    numbers: Ints

    @classmethod
    def of(
        cls, paths: tuple[PosePath, ...], bounds: tuple[PoseBounds, ...] = (), numbers: Ints | None = None
    ) -> PackedPaths:
        """Pack motions, and bounds on the deviations of the bodies with the indices `numbers`."""
        kinks = [one.since for one in bounds]
        steps = [np.linalg.norm(np.diff(path.positions, axis=0), axis=1) for path in paths]
        lengths = [np.diff(path.times) for path in paths]
        return cls(
            paths, np.cumsum([0, *(len(path.times) for path in paths)]),
            np.concatenate([[], *(path.times for path in paths)]),
            np.concatenate(
                [np.empty((0, 7)), *(np.concatenate([path.positions, path.quaternions], axis=1) for path in paths)]
            ),
            np.concatenate([[], *(np.append(path.arcs, 0.0) for path in paths)]),
            np.array([path.period * path.repeat for path in paths]),
            np.array([np.abs(path.positions).max() for path in paths]),
            np.array([(step / length).max() for step, length in zip(steps, lengths, strict=True)]),
            np.array([(path.arcs / length).max() for path, length in zip(paths, lengths, strict=True)]),
            np.array([abs(path.times[0]) + path.period for path in paths]),
            (
                np.unique(np.concatenate([kinks, *(path.times for path in paths if not path.repeat)])),
                np.unique(np.concatenate([kinks, *(path._fine for path in paths if not path.repeat)])),
            ),
            bounds, np.arange(len(bounds)) if numbers is None else numbers,
        )  # fmt: skip

    def values(self, t: Floats) -> Floats:
        """Compute positions and quaternions at times t, shape (N, bodies, 7); the quaternions' signs are arbitrary."""
        out = np.empty((len(t), len(self.paths), 7))
        if self.paths:
            entries.pose_values(self.start, self.times, self.rows, self.arcs, self.periods, np.array(t), out)
        return out

    def off(self, begin: Floats, end: Floats, ticks: Floats | float = 0.0) -> Floats:
        """Bound the deviations of bodies' points from time `begin` to time `end`, shape (N,) each.

        The times are rounded by up to `ticks`. The bound is linear between the two times.

        Returns
        -------
        ndarray, shape (N, 3 len(bounds))
            For each body, its index and the bounds in metres at both times, in the form that `motions.settle` takes.
        """
        deviations = np.empty((len(begin), len(self.bounds), 3))
        for k, one in enumerate(self.bounds):
            at_begin, at_end = (one.off(t) + one.rate * ticks for t in (begin, end))
            more = OFF_ROUNDINGS * np.maximum(at_begin, at_end)
            deviations[:, k] = np.stack([np.full(len(begin), self.numbers[k]), at_begin + more, at_end + more], axis=1)
        return deviations.reshape(len(begin), 3 * len(self.bounds))

    def knots(self, t0: Floats, t1: Floats, fine: bool) -> Floats:
        """List, in order, all times between t0 and t1, shape (N,) each, at which bodies change their rates.

        The list may contain other times, too. See `_knots` for `fine` and for errors.
        """
        if len(t0) == 0 or not self.periods.any():
            return self.once[fine]
        order = np.argsort(t0)
        low, until = t0[order], np.maximum.accumulate(t1[order])
        apart = np.flatnonzero(low[1:] > until[:-1])  # intervals that no earlier interval reaches
        low, high = low[np.append(0, apart + 1)], until[np.append(apart, len(t0) - 1)]
        again = [_knots(path, low, high, fine) for path in self.paths if path.repeat]
        return np.unique(np.concatenate([self.once[fine], *again]))
