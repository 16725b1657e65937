"""Use cubic polynomials to assign times, with limited jerk, to the motions of a path and to the blends between them.

Along a motion, the speed follows a profile of phases with constant jerk. Across a corner, the velocity changes to the
direction of the next motion in up to three phases: the acceleration grows, stays constant, and falls. The acceleration
is zero at both ends of every motion and every blend. docs/howto/trajectories.md and docs/design/trajectories.md
describe these pieces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner._base import _elementary
from loewner._base._validate import Bools, FloatOrFloats, Floats
from loewner._kernels import tolerances
from loewner.errors import InputError
from loewner.planners.profiles import Limits, Phase, duration, phases, ramp, reached, turned
from loewner.planners.straights import LARGEST_RATIO, Row, Straights, smallest

# Share of each limit that is reserved for rounding. The shortest phase is chosen so that rounding stays within this
# share.
TO_ROUNDING = 1e-6

# The error of a velocity, an acceleration or a jerk on one phase is at most NOISE times a length, divided by a power of
# the phase's duration. The length is the largest position plus the distance covered at the highest speed in the total
# duration; see docs/certified.md.
NOISE = 1024.0 * tolerances.UNIT_ROUNDOFF

# Bound on the error of computed cubic blends, relative to the sum of the largest value and the distance covered at full
# speed in the total duration.
CUBIC_ROUNDINGS = 64.0 * tolerances.UNIT_ROUNDOFF  # certified.md B54


def shortest(size: Floats, fastest: Floats, strongest: FloatOrFloats, jerk: FloatOrFloats) -> float:
    """Return the shortest duration of a piece for which rounding errors of all values stay within `TO_ROUNDING`.

    Parameters
    ----------
    size : ndarray, shape (dof,)
        The largest position plus the distance covered at the highest speed in the total duration.
    fastest, strongest, jerk : ndarray, shape (dof,), or infinite
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        noise = NOISE / TO_ROUNDING * size
        leasts = [noise / fastest, np.sqrt(noise / strongest), _elementary.cbrt(noise / jerk)]
    return float(np.max(leasts))


class JerkLimited(NamedTuple):
    """The motions of a path, with the limits on changes of speed and direction.

    Attributes
    ----------
    straights : Straights
    along : list of Limits
        For each motion, limits on changes of the speed along it, as shares of full speed.
    across : list of Limits
        For each corner, limits on the change from one motion's velocity to the next motion's velocity, as shares of
        full speed.
    """

    straights: Straights
    along: list[Limits]
    across: list[Limits]

    @classmethod
    def of(cls, rows: Floats, fastest: Floats, strongest: Floats, jerk: Floats) -> JerkLimited:
        """Make the motions between rows; each of the limits has shape (dof,)."""
        fastest, strongest, jerk = (limit * (1 - TO_ROUNDING) for limit in (fastest, strongest, jerk))
        straights = Straights.of(rows, fastest, strongest)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ways = np.abs(straights.full), np.abs(np.diff(straights.full, axis=0))
            gains, jerks = ([smallest(limit / way) for way in ways] for limit in (strongest, jerk))
            lengths = straights.lengths
            stopping = lengths + 2 * np.sqrt(lengths / gains[0]) + _elementary.cbrt(32 * lengths / jerks[0])
            # Neither a corner, nor a motion between two corners, can be passed at a higher share of full speed.
            shorter = np.minimum(lengths[:-1], lengths[1:])
            at = np.minimum(np.sqrt(gains[1] * shorter), _elementary.cbrt(jerks[1] * shorter**2))
            at = np.minimum(np.maximum(np.append(0.0, at), np.append(at, 0.0)), 1.0)[: len(lengths)]
            top = np.sqrt(at**2 + 2 * gains[0] * lengths)
            top = np.minimum(top, _elementary.cbrt(at * at * at + jerks[0] * lengths**2))
            speeds = np.minimum(top, 1.0)[:, None] * ways[0]
            covered = speeds.max(axis=0, initial=0.0) * stopping.sum()
            least = shortest(np.abs(rows).max(axis=0) + covered, fastest, strongest, jerk)
        lowest = float(np.concatenate(jerks).min(initial=np.inf))
        if not (lowest > 1 / LARGEST_RATIO and least < LARGEST_RATIO):
            raise InputError(
                f"jerk: expected a path and limits with ratios up to {LARGEST_RATIO:g}, found a jerk of {lowest:g} of "
                f"full speed per second squared, and phases of at least {least:g} s"
            )
        along, across = (
            [Limits(*each, least) for each in zip(gain.tolist(), most.tolist(), strict=True)]
            for gain, most in zip(gains, jerks, strict=True)
        )
        return cls(straights, along, across)

    def part(self, first: int, last: int) -> JerkLimited:
        """Select the motions at the corners from `first` up to but not including `last`."""
        return JerkLimited(self.straights.part(first, last), self.along[first : last + 1], self.across[first:last])

    @property
    def wanted(self) -> Floats:
        """For each corner, the size of the blend that can be passed at full speed."""
        edges = [ramp(1.0, limits) for limits in self.across]
        return np.array([edge + flat / 2 for edge, flat in edges])

    def extended(self, column: Floats) -> JerkLimited:
        """Append a column without limits to the configurations."""
        return self._replace(straights=self.straights.extended(column))

    def courses(self, halves: Floats) -> Floats:
        """Return the blends of given sizes as courses of cubics, shape (corners, 3, 4, columns)."""
        knots, ways, shares = self._bends(halves)
        before, after = ways[:, :-1] * shares / 3, ways[:, 1:] * shares / 3
        return np.stack([knots[:, :-1], knots[:, :-1] + before, knots[:, 1:] - after, knots[:, 1:]], axis=2)

    def duration(self, halves: Floats) -> float:
        """Compute the total duration in seconds."""
        return duration(halves, *self._profiles(halves))

    def timed(self, halves: Floats, last_speed: float = 0.0) -> tuple[Floats, Floats, Floats, Bools, Floats]:
        """Compute the arrays of a `Trajectory` that runs through all phases; the robot stops at the end."""
        on, (speeds, profiles) = self.straights, self._profiles(halves)
        (knots, ways, shares), still = self._bends(halves), np.zeros_like(on.rows[0])
        blends: list[list[Row]] = [[] for _ in halves]
        for k in np.flatnonzero(halves > 0):
            seconds = 2 * float(halves[k]) / speeds[k + 1]
            edge = shares[k, 0, 0] * seconds
            push = speeds[k + 1] * (on.full[k + 1] - on.full[k]) / (seconds - edge)
            for m, bend in enumerate((push, push, still)):
                if shares[k, m, 0] > 0:
                    blends[k].append((shares[k, m, 0] * seconds, knots[k, m + 1], ways[k, m + 1] / seconds, bend, True))
        return on.joined(halves, profiles, blends)

    # -- inside -------------------------------------------------------------------------------

    def _profiles(self, halves: Floats) -> tuple[list[float], list[tuple[Phase, ...]]]:
        """Compute speeds at the rows, as shares of full speed, and the phases between the blends."""
        taken = np.concatenate([[0.0], halves, [0.0]])
        left = np.maximum(self.straights.lengths - taken[:-1] - taken[1:], 0.0).tolist()
        speeds = [0.0, *(turned(half, limits) for half, limits in zip(halves.tolist(), self.across, strict=True)), 0.0]
        # No motion between two blends may be shorter than the shortest phase.
        for k, (length, limits) in enumerate(zip(left, self.along, strict=True)):
            speeds[k], speeds[k + 1] = (min(speed, length / limits.least) for speed in speeds[k : k + 2])
        for k, (length, limits) in enumerate(zip(left, self.along, strict=True)):
            speeds[k + 1] = min(speeds[k + 1], reached(length, limits, speeds[k]))
        for k in range(len(left) - 1, -1, -1):
            speeds[k] = min(speeds[k], reached(left[k], self.along[k], speeds[k + 1]))
        return speeds, [phases(left[k], self.along[k], speeds[k], speeds[k + 1]) for k in range(len(left))]

    def _bends(self, halves: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute three cubic pieces of each blend. The duration of the second piece may be zero.

        The first array contains the ends of the pieces, shape (corners, 4, dof). The second array contains the
        velocities at these ends, multiplied by the duration of the blend. The third array contains the durations of the
        pieces as shares of the blend's duration, shape (corners, 3, 1).
        """
        first, _, last = self.straights.corners(halves)
        sized = zip(halves.tolist(), self.across, strict=True)
        ramps = [ramp(turned(half, limits) or 1.0, limits) for half, limits in sized]
        edge = np.array([edge / (2 * edge + flat) for edge, flat in ramps]).reshape(-1, 1)
        full, twice = self.straights.full, 2 * halves[:, None]
        before, after = twice * full[:-1], twice * full[1:]
        turn = after - before
        low = edge / (2 * (1 - edge)) * turn
        shift = edge / 3 * low
        knots = np.stack([first, first + edge * before + shift, last - edge * after + shift, last], axis=1)
        ways = np.stack([before, before + low, after - low, after], axis=1)
        return knots, ways, np.stack([edge, 1 - 2 * edge, edge], axis=1)
