"""Compute how a robot brakes: each joint separately, leaving the path, or all joints along the path.

The kernels in `_kernels.robots.brakes` compute many brakes at a time, either joint by joint or on paths of straight
motions. On a trajectory with blends, the robot brakes on straight lines, and passes blends at the reduced speed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._validate import Bools, Floats, Ints
from loewner._native import entries
from loewner.errors import InputError, PlanningError
from loewner.planners.joint_limits import JointLimits, limits_by_name

# A piece is straight if its velocities point along the segment between its ends. The tolerance is the share STRAIGHT of
# the segment and of the distance covered at these velocities.
STRAIGHT = 1e-9

# If a line is too short for a stop by at most the share ROUNDED, it counts as long enough, because the trajectory
# itself may stop at the end of the line.
ROUNDED = 1e-9

# Limits count as equal to the trajectory's own limits if they are lower by at most the share EQUAL.
EQUAL = 1e-6

# On a line that is too short for a stop, the robot keeps at least the share SLOWEST of its speed, so that it does not
# creep on the next blend.
SLOWEST = 0.5

# Number of times that the range of possible speeds at the end of a line is halved to find the lowest one.
HALVINGS = 64


class Brakes(NamedTuple):
    """Brakes, described by states at the times at which the acceleration (or the jerk, if limited) of a joint jumps.

    Attributes
    ----------
    times : ndarray, shape (n, most)
        Seconds since each brake began.
    states : ndarray, shape (n, most, 3, dof)
        The position at each time, and the velocity and acceleration just after it.
    counts : ndarray of int64, shape (n,)
        Number of times that describe each brake; 0 if the brake does not end on the path.
    needed : ndarray of int64, shape (n,)
        For each brake, the index of the first row of the path at or after the end of the brake, or the number of rows
        if the brake ends after all rows. 0 for brakes that leave the path.
    """

    times: Floats
    states: Floats
    counts: Ints
    needed: Ints

    @classmethod
    def by_joint(cls, Q: Floats, V: Floats, A: Floats, strongest: Floats, jerk: Floats | None) -> Brakes:
        """Stop each joint as soon as its limits allow, from states of shape (n, dof)."""
        brakes, steep = cls._empty(len(Q), 3 * Q.shape[1] + 1, Q.shape[1]), _steep(strongest, jerk)
        entries.brakes_by_joint(*(np.array(x) for x in (Q, V, A, strongest, steep)), *brakes[:3])
        return brakes

    @classmethod
    def on_path(
        cls, rows: Floats, at: Floats, begins: Floats, strongest: Floats, jerk: Floats | None, *, beyond: bool
    ) -> Brakes:
        """Stop on motions between rows, shape (k, dof); `at` are the times of the rows. Brakes begin at `begins`."""
        brakes, steep = cls._empty(len(begins), len(rows) + 4, rows.shape[1]), _steep(strongest, jerk)
        entries.brakes_on_path(*(np.array(x) for x in (rows, at, begins, strongest, steep)), beyond, *brakes)
        return brakes

    @classmethod
    def _empty(cls, n: int, most: int, dof: int) -> Brakes:
        _validate.fits_memory(8 * n * most * (3 * dof + 1), f"{n} brakes")
        return cls(np.empty((n, most)), np.empty((n, most, 3, dof)), *np.zeros((2, n), dtype=np.int64))

    @property
    def durations(self) -> Floats:
        """Durations in seconds, shape (n,)."""
        return np.asarray(self.times[np.arange(len(self.times)), np.maximum(self.counts - 1, 0)])

    def only(self, chosen: Ints) -> Brakes:
        """Return the chosen brakes."""
        return Brakes(self.times[chosen], self.states[chosen], self.counts[chosen], self.needed[chosen])

    def courses(self, cubic: bool) -> tuple[Floats, Floats, Ints]:
        """Return the pieces in the form that proofs of motions use, and the index at which each brake begins.

        Returns
        -------
        courses : ndarray, shape (m, degree + 1, dof)
            The degree is 3 if `cubic`, that is, with jerk limits, and otherwise 2.
        seconds : ndarray, shape (m,)
        first : ndarray of int64, shape (n + 1,)
        """
        first = np.append(0, np.cumsum(np.maximum(self.counts - 1, 0)))
        courses, seconds = np.empty((first[-1], 4 if cubic else 3, self.states.shape[3])), np.empty(first[-1])
        entries.courses_of_brakes(*self[:3], courses, seconds)
        return courses, seconds, first

    def whole(self, cubic: bool, until: Floats) -> tuple[Floats, Floats]:
        """Return one course per brake, including the rest after the stop, and each brake's distance from its course.

        Parameters
        ----------
        cubic : bool
            As for `courses`.
        until : ndarray, shape (n,)
            Shortest duration of each course, in seconds. If the brake is shorter, the robot rests afterwards.

        Returns
        -------
        courses : ndarray, shape (n, degree + 1, dof)
        off : ndarray, shape (n, dof)
        """
        n, dof = len(self.counts), self.states.shape[3]
        courses, off = np.empty((n, 4 if cubic else 3, dof)), np.empty((n, dof))
        entries.whole_brakes(*self[:3], until, courses, off)
        return courses, off

    def one(self) -> Timed:
        """Return the first brake as the arrays of a `Trajectory`.

        Raises
        ------
        InputError
            If the duration of the brake overflows.
        """
        times, states = self.times[0, : self.counts[0]].copy(), self.states[0, : self.counts[0]]
        if not (np.isfinite(times).all() and np.isfinite(states).all()):
            raise InputError("expected a state and limits with a brake of finite length and time, found an overflow")
        knots, rates, bends = np.moveaxis(states, 1, 0).copy()
        return Timed(times, knots, rates, np.zeros(len(times) - 1, dtype=bool), bends)


def _steep(strongest: Floats, jerk: Floats | None) -> Floats:
    """Return jerk limits for kernels; an infinite value means no limit."""
    return np.full(len(strongest), np.inf) if jerk is None else jerk


class Timed(NamedTuple):
    """The arrays of a `Trajectory`; `bends` is None if accelerations are constant on each piece."""

    times: Floats
    knots: Floats
    rates: Floats
    blended: Bools
    bends: Floats | None


def braked(names: tuple[str, ...], q: Floats, dq: Floats, ddq: Floats, strongest: Floats, jerk: Floats | None) -> Timed:
    """Stop each joint as soon as its limits allow.

    Raises
    ------
    InputError
        If the jerk is limited, and an acceleration is above its limit.
    """
    for k in np.flatnonzero(np.abs(ddq) > strongest * (1 + EQUAL))[: jerk is not None]:
        raise InputError(
            f"acceleration: expected a limit of {names[k]} that is no lower than its acceleration at the start, "
            f"{abs(ddq[k]):g}, found {strongest[k]:g}"
        )
    stops = Brakes.by_joint(q[None], dq[None], ddq[None], strongest, jerk).one()
    return stops if jerk is not None else stops._replace(bends=None)


def braked_on_motions(
    rows: Floats, at: Floats, begin: float, strongest: Floats, jerk: Floats | None, beyond: bool
) -> Timed:
    """Stop on straight motions, beginning at a given time; velocities jump at rows.

    Raises
    ------
    PlanningError
        If the robot cannot stop on these motions.
    """
    brakes = Brakes.on_path(rows, at, np.array([begin]), strongest, jerk, beyond=beyond)
    if brakes.counts[0] == 0:
        raise PlanningError(_too_late(at[-1] - begin))
    return brakes.one()


def braked_on_curve(rest: Timed, strongest: Floats, jerk: Floats | None, beyond: bool) -> Timed:
    """Stop on the rest of a trajectory: brake as fast as possible on lines, and pass blends at the reduced speed.

    Raises
    ------
    PlanningError
        If the robot cannot stop on this trajectory.
    """
    bends = None if rest.bends is None else rest.bends[:1]
    parts = [Timed(np.zeros(1), rest.knots[:1], rest.rates[:1], rest.blended[:0], bends)]
    k, rate, pieces = 0, float(rest.rates[0].any()), len(rest.blended)
    while k < pieces and rate > 0:
        last = _end_of_line(rest, k)
        on_line = None if last == k else _braked_on_line(rest, k, last, rate, strongest, jerk)
        last = max(last, k + 1)
        if on_line is None:
            on_line = _slower(rest, k, last, rate, strongest, jerk), rate * rest.rates[last].any()
        parts.append(on_line[0])
        k, rate = last, on_line[1]
    if rate > 0:
        if not beyond or (rest.bends is not None and rest.bends[-1].any()):
            raise PlanningError(_too_late(rest.times[-1] - rest.times[0]))
        gain, steep = _shares(rest.rates[-1], strongest, jerk)
        parts.append(_on_line(rest.knots[-1], rest.rates[-1], *_slowed(rate, 0.0, 0.0, gain, steep), jerk is not None))
    begun = np.cumsum([0.0, *(part.times[-1] for part in parts)])
    times = np.concatenate([part.times + begin for part, begin in zip(parts, begun[:-1], strict=True)])
    # Leave out pieces whose duration is lost in the rounding of the times.
    kept = np.append(np.diff(times) > 0, True)
    knots, rates = (np.concatenate(rows)[kept] for rows in ([p.knots for p in parts], [p.rates for p in parts]))
    blended = np.concatenate([part.blended for part in parts])[kept[:-1]]
    bends = None if rest.bends is None else np.concatenate([part.bends for part in parts if part.bends is not None])
    return Timed(times[kept], knots, rates, blended, None if bends is None else bends[kept])


# -- lines and blends ---------------------------------------------------------------------------


def _too_late(left: float) -> str:
    """Return the message about a trajectory that ends before the brake does."""
    return (
        "t: expected a time from which the robot stops on the path before its end, found one that is "
        f"{left:.6g} s before the end; begin earlier, or pass beyond=True"
    )


def _shares(way: Floats, strongest: Floats, jerk: Floats | None) -> tuple[float, float]:
    """Return limits of the acceleration and of the jerk along a way, in ways per s² and per s³."""
    moves = way != 0
    steep = np.inf if jerk is None else float((jerk[moves] / np.abs(way[moves])).min())
    return float((strongest[moves] / np.abs(way[moves])).min()), steep


def _slowed(v: float, a: float, low: float, gain: float, steep: float) -> tuple[Floats, Floats]:
    """Return the fastest change to a lower speed, at which the acceleration is zero.

    Returns
    -------
    times : ndarray, shape (n,)
    states : ndarray, shape (n, 3)
        Distances, speeds and accelerations at these times.
    """
    q, dq, ddq, gains, steeps = (np.array([[x]]) for x in (0.0, v - low, a, gain, steep))
    one: Any = Brakes.by_joint(q, dq, ddq, gains[0], steeps[0]).one()
    states = np.stack([low * one.times, np.full(len(one.times), low), np.zeros(len(one.times))], axis=1)
    return one.times, np.concatenate([one.knots, one.rates, one.bends], axis=1) + states


def _end_of_line(rest: Timed, k: int) -> int:
    """Return the last knot of the straight line that begins at a knot, or the knot itself if a curve begins there."""
    last, way = k, rest.knots[k + 1] - rest.knots[k]
    j, size = int(np.abs(way).argmax()), 0.0
    while last < len(rest.blended) and not rest.blended[last] and way[j] != 0:
        T, step = rest.times[last + 1] - rest.times[last], rest.knots[last + 1] - rest.knots[last]
        rows = np.stack([step, rest.rates[last] * T, rest.rates[last + 1] * T])
        size = max(size, float(np.abs(rows).max()))
        off = np.abs(rows - rows[:, [j]] / way[j] * way).max()
        if off > STRAIGHT * size or (rows[:, j] / way[j] < 0).any() or (last > k and not rest.rates[last].any()):
            break
        last += 1
    return last


def _braked_on_line(
    rest: Timed, k: int, last: int, rate: float, strongest: Floats, jerk: Floats | None
) -> tuple[Timed, float] | None:
    """Stop on a straight line, or slow down to at least `SLOWEST`; None if the line is too short even for this.

    Returns
    -------
    part : Timed
        States after the first one; times begin at 0.
    rate : float
        The speed at the end as a share of the trajectory's speed there; 0 after a stop.
    """
    way = rest.knots[last] - rest.knots[k]
    j = int(np.abs(way).argmax())
    gain, steep = _shares(way, strongest, jerk)
    v, full = rate * rest.rates[k, j] / way[j], rest.rates[last, j] / way[j]
    a = 0.0 if rest.bends is None else rate * rate * rest.bends[k, j] / way[j]
    times, states = _slowed(v, a, 0.0, gain, steep)
    if states[:, 1].min() < -ROUNDED * v:
        return None
    if states[-1, 0] <= 1 + ROUNDED:
        states = np.minimum(states, [1.0, np.inf, np.inf])
        return _on_line(rest.knots[k], way, times, states, rest.bends is not None), 0.0
    if full == 0 or (rest.bends is not None and rest.bends[last].any()):
        return None
    low, high = SLOWEST * rate * full, v if jerk is None else v + a * abs(a) / (2 * steep)
    if not high > low or _slowed(v, a, high, gain, steep)[1][-1, 0] > 1:
        return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if _slowed(v, a, middle, gain, steep)[1][-1, 0] <= 1 else (middle, high)
    if high > full:
        return None
    times, states = _slowed(v, a, high, gain, steep)
    if states[-1, 0] < 1 - ROUNDED:  # the robot goes on at the lowest speed
        times = np.append(times, times[-1] + (1 - states[-1, 0]) / high)
        states = np.vstack([states, [1.0, high, 0.0]])
    part = _on_line(rest.knots[k], way, times, states, rest.bends is not None)
    part.knots[-1] = rest.knots[last]
    return part, high / full


def _on_line(q: Floats, way: Floats, times: Floats, states: Floats, bent: bool) -> Timed:
    """Return states along a way as states of all joints, without the first state."""
    knots, rates, bends = q + states[1:, :1] * way, states[1:, 1:2] * way, states[1:, 2:] * way
    return Timed(times[1:], knots, rates, np.zeros(len(times) - 1, dtype=bool), bends if bent else None)


def _slower(rest: Timed, k: int, last: int, rate: float, strongest: Floats, jerk: Floats | None) -> Timed:
    """Return pieces of the trajectory, passed at a lower rate, without the first state."""
    T, after = np.diff(rest.times[k : last + 1])[:, None], slice(k + 1, last + 1)
    if rest.bends is None or jerk is None:
        pushes, bends, steep = np.diff(rest.rates[k : last + 1], axis=0) / T, None, False
    else:
        pushes, bends = rest.bends[k : last + 1], rate**2 * rest.bends[after]
        steep = bool((np.abs(np.diff(pushes, axis=0) / T) * rate**3 > jerk * (1 + EQUAL)).any())
    if steep or (np.abs(pushes) * rate**2 > strongest * (1 + EQUAL)).any():
        raise PlanningError(
            f"limits: expected limits with which the robot stays on the trajectory, found lower ones than it needs "
            f"{rest.times[k] - rest.times[0]:.6g} s after the brake begins"
        )
    times = (rest.times[after] - rest.times[k]) / rate
    return Timed(times, rest.knots[after], rate * rest.rates[after], rest.blended[k:last], bends)


def brake_limits(
    names: tuple[str, ...],
    moves: Bools,
    known: Any,
    limits: JointLimits | None,
    acceleration: ArrayLike | None,
    jerk: ArrayLike | None,
) -> tuple[Floats, Floats | None]:
    """Return acceleration limits, and jerk limits or None, shape (dof,) each; infinite for joints that do not move.

    Parameters
    ----------
    moves : ndarray of bool, shape (dof,)
    known : Robot or None
        A robot whose acceleration and jerk limits are used for joints without other limits.
    """
    if limits is not None and not (isinstance(limits, JointLimits) and limits.names == names):
        actual = ", ".join(limits.names) if isinstance(limits, JointLimits) else type(limits).__name__
        raise InputError(f"limits: expected planners.JointLimits of {', '.join(names)}, found {actual}")
    none = np.full(len(names), np.inf)
    most = {
        name: np.where(moves, limits_by_name(name, limit, (known, limits), none), np.inf)
        for name, limit in (("acceleration", acceleration), ("jerk", jerk))
    }
    some = jerk is not None or np.isfinite(most["jerk"][moves]).any()
    for name in ("acceleration", "jerk") if some else ("acceleration",):
        for k in np.flatnonzero(moves & ~np.isfinite(most[name]))[:1]:
            other = "" if name == "acceleration" else " or of none"
            raise InputError(
                f"{name}: expected limits of all joints that move{other}, found none for {names[k]}; give {name}=, one "
                f"number or {len(names)}"
            )
    return most["acceleration"], most["jerk"] if some else None
