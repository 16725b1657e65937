"""Assign times to the straight motions of a path and to the blends between them, with limited acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from loewner._base._validate import Bools, Floats
from loewner._kernels import tolerances
from loewner.errors import InputError
from loewner.planners.profiles import Phase, duration

# Bound on the error of computed blends, relative to the sum of the largest value and the distance covered at full speed
# in the total duration.
BLEND_ROUNDINGS = 32.0 * tolerances.UNIT_ROUNDOFF  # certified.md B35

# If a change of speed, or a distance at constant speed, is below the share SHORTEST, it is merged into the neighbouring
# phase. A blend below this share becomes a stop. In shorter phases, rounding would affect the acceleration.
SHORTEST = 1e-7

# Limit on the seconds of a motion at full speed, on the seconds to reach full speed, and on the reciprocals of both
# durations. Within this limit, their squares do not overflow.
LARGEST_RATIO = 1e100

# A row of a trajectory: the seconds since the previous row, the position, the velocity, the acceleration, and whether
# the piece before the row is a blend.
Row = tuple[float, Floats, Floats, Floats, bool]


class Straights(NamedTuple):
    """The motions of a path.

    Attributes
    ----------
    rows : ndarray, shape (k + 1, dof)
        The ends of the motions.
    lengths : ndarray, shape (k,)
        Durations of the motions at full speed, in seconds.
    full : ndarray, shape (k, dof)
        Velocities at full speed, that is, with one joint at its limit.
    gains : ndarray, shape (k,)
        Fractions of full speed by which the speed can change in a second.
    strongest : ndarray, shape (dof,)
        Limits of acceleration.
    """

    rows: Floats
    lengths: Floats
    full: Floats
    gains: Floats
    strongest: Floats

    @classmethod
    def of(cls, rows: Floats, fastest: Floats, strongest: Floats) -> Straights:
        """Make the motions between rows, within limits."""
        with np.errstate(all="ignore"):
            ways = np.diff(rows, axis=0)
            lengths = np.abs(ways / fastest).max(axis=1, initial=0.0)
            full = ways / lengths[:, None]
            gains = smallest(strongest / np.abs(full))
        ratios = np.concatenate([lengths, gains])
        if not ((ratios > 1 / LARGEST_RATIO) & (ratios < LARGEST_RATIO)).all():
            raise InputError(
                f"expected a path and limits with ratios up to {LARGEST_RATIO:g}, found motions of "
                f"{lengths.min():g} to {lengths.max():g} s at full speed, of which a second adds a share of "
                f"{gains.min():g} to {gains.max():g}"
            )
        return cls(rows, lengths, full, gains, strongest)

    @property
    def straights(self) -> Straights:
        """This object itself, for a common interface with `JerkLimited`."""
        return self

    @property
    def wanted(self) -> Floats:
        """For each corner, the size of the blend that is passed at full speed."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1 / (2 * self._room()))

    def part(self, first: int, last: int) -> Straights:
        """Select the motions at the corners from `first` up to but not including `last`."""
        motions = slice(first, last + 1)
        return Straights(
            self.rows[first : last + 2], self.lengths[motions], self.full[motions], self.gains[motions], self.strongest
        )

    def extended(self, column: Floats) -> Straights:
        """Append a column without limits to the configurations."""
        rates = np.diff(column) / self.lengths
        return self._replace(rows=np.column_stack([self.rows, column]), full=np.column_stack([self.full, rates]))

    def courses(self, halves: Floats) -> Floats:
        """Return the blends of given sizes as courses of parabolas, shape (corners, 1, 3, columns)."""
        return np.stack(self.corners(halves), axis=1)[:, None]

    def at(self, k: Any, share: Floats) -> Floats:
        """Return the configurations at fractions of motions."""
        a, b = self.rows[k], self.rows[k + 1]
        return np.asarray(np.where(share[:, None] == 1, b, a + share[:, None] * (b - a)))

    def corners(self, halves: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the points where blends begin, the corners, and the points where blends end; see `_profiles`."""
        k = np.arange(len(halves))
        return self.at(k, 1 - halves / self.lengths[:-1]), self.rows[1:-1], self.at(k + 1, halves / self.lengths[1:])

    def duration(self, halves: Floats) -> float:
        """Compute the total duration in seconds."""
        return duration(halves, *self._profiles(halves))

    def timed(self, halves: Floats, last_speed: float = 0.0) -> tuple[Floats, Floats, Floats, Bools, None]:
        """Compute the arrays of a `Trajectory` that runs through all phases.

        The robot ends the path at `last_speed`, a share of full speed, or at the highest possible speed below it.
        """
        speeds, profiles = self._profiles(halves, last_speed)
        last, still = self.corners(halves)[2], np.zeros_like(self.rows[0])
        blends: list[list[Row]] = [
            [(2 * half / speeds[k], last[k - 1], speeds[k] * self.full[k], still, True)] if half > 0 else []
            for k, half in enumerate(halves.tolist(), 1)
        ]
        times, knots, rates, blended, _ = self.joined(halves, profiles, blends)
        # Remove phases whose duration is lost in the rounding of the times.
        kept = np.append(np.diff(times) > 0, True)
        return times[kept], knots[kept], rates[kept], np.append(blended, False)[kept][:-1], None

    def joined(
        self, halves: Floats, profiles: Sequence[Sequence[Phase]], blends: list[list[Row]]
    ) -> tuple[Floats, Floats, Floats, Bools, Floats]:
        """Compute the arrays of a `Trajectory` from the phases of each motion and the rows of each blend, if any."""
        first, still = self.corners(halves)[0], np.zeros_like(self.rows[0])
        taken, ends = [0.0, *halves.tolist()], [*first, self.rows[-1]]
        rows: list[Row] = [(0.0, self.rows[0], still, still, False)]
        for k, (profile, blend, full) in enumerate(zip(profiles, [*blends, []], self.full, strict=False)):
            gone = np.cumsum([taken[k], *(phase.way for phase in profile)])[1:]
            at = [*self.at(np.full(len(gone) - 1, k), gone[:-1] / self.lengths[k]), ends[k]]
            for phase, knot in zip(profile, at, strict=True):
                rows.append((phase.seconds, knot, phase.speed * full, phase.acceleration * full, False))
            rows += blend
        seconds, knots, rates, bends, blended = (np.array(column) for column in zip(*rows, strict=True))
        return np.cumsum(seconds), knots, rates, blended[1:], bends

    def _room(self) -> Floats:
        """For each corner, compute the share of full speed by which the direction can change in a second."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return smallest(self.strongest / np.abs(np.diff(self.full, axis=0)))

    def _profiles(self, halves: Floats, last_speed: float = 0.0) -> tuple[list[float], list[list[Phase]]]:
        """Compute speeds at the rows, as shares of full speed, and the phases between the blends.

        Parameters
        ----------
        halves : ndarray, shape (corners,)
            Seconds at full speed from the beginning of a blend to its corner, and from the corner to the blend's end; 0
            for a stop.
        """
        with np.errstate(invalid="ignore"):
            limits = np.sqrt(np.where(halves > 0, 2 * halves * self._room(), 0.0))
        taken = np.concatenate([[0.0], halves, [0.0]])
        left = np.maximum(self.lengths - taken[:-1] - taken[1:], 0.0).tolist()
        gains = self.gains.tolist()
        speeds = [0.0, *np.minimum(limits, 1.0).tolist(), last_speed]
        for k in range(len(left)):
            speeds[k + 1] = min(speeds[k + 1], math.sqrt(speeds[k] * speeds[k] + 2 * gains[k] * left[k]))
        for k in range(len(left) - 1, -1, -1):
            speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] * speeds[k + 1] + 2 * gains[k] * left[k]))
        return speeds, [_phases(left[k], gains[k], speeds[k], speeds[k + 1]) for k in range(len(left))]


def smallest(ratios: Floats) -> Floats:
    """Return the smallest ratio in each row, ignoring 0 / 0."""
    return np.asarray(np.nanmin(np.where(np.isnan(ratios), np.inf, ratios), axis=1, initial=np.inf))


def _phases(length: float, gain: float, low: float, high: float) -> list[Phase]:
    """Return the phases between two speeds on a straight line, without their constant accelerations."""
    peak = min(1.0, math.sqrt((2 * gain * length + low * low + high * high) / 2))
    top = max(low, high)
    if peak - top <= SHORTEST * peak:
        peak = top
    up, down = (peak * peak - low * low) / (2 * gain), (peak * peak - high * high) / (2 * gain)
    level = length - up - down
    if abs(high - low) <= SHORTEST * peak and peak == top:
        return [Phase(2 * length / (low + high), length, high, 0.0)]
    if level <= SHORTEST * length:  # without this phase, the other phases still cover the whole distance
        up, down, level = up * length / (up + down), down * length / (up + down), 0.0
    parts = ((up, low, peak), (level, peak, peak), (down, peak, high))
    return [Phase(2 * way / (begin + end), way, end, 0.0) for way, begin, end in parts if way > 0]
