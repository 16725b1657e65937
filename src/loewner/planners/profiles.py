"""Compute speed profiles with limited jerk: phases of constant jerk from one speed to another over a distance.

Speeds are shares of full speed, and distances are seconds at full speed. At both ends, the acceleration is zero. No
phase is shorter than a given duration, because in shorter phases, the rounding of positions would affect the jerk.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

from loewner._base._validate import Floats

# Accuracy of computed speeds, which are never larger than allowed. The phases cover the exact distance despite this
# error.
ACCURACY = 1e-13

# Number of profiles in the cache. While blends are chosen, most profiles are needed repeatedly.
KEPT = 2**14


class Limits(NamedTuple):
    """Limits on a change of speed.

    Attributes
    ----------
    gain : float
        Largest rate of change of the speed [1/s].
    jerk : float
        Largest second derivative of the speed [1/s²]; may be infinite.
    least : float
        Shortest duration of a phase [s].
    """

    gain: float
    jerk: float
    least: float


class Phase(NamedTuple):
    """A phase of constant jerk: its duration and distance, and the speed and the acceleration at its end."""

    seconds: float
    way: float
    speed: float
    acceleration: float


def duration(halves: Floats, speeds: Sequence[float], profiles: Iterable[Iterable[Phase]]) -> float:
    """Add up the durations [s] of all phases and blends.

    A blend takes 2 h / v, where h is its half, in seconds at full speed from its beginning to its corner, and v is the
    speed at the corner, as a share of full speed.
    """
    blends = sum(2 * half / speed for half, speed in zip(halves.tolist(), speeds[1:-1], strict=True) if half)
    return float(blends + sum(phase.seconds for profile in profiles for phase in profile))


def ramp(change: float, limits: Limits) -> tuple[float, float]:
    """For a change of speed, return the duration of each phase with jerk, and of the phase without jerk between them.

    The change is the fastest within the limits, except that no phase is shorter than the least duration.
    """
    if change == 0:
        return 0.0, 0.0
    gain, jerk, least = limits
    alone = max(math.sqrt(change / jerk), change / gain, least)
    edge = max(gain / jerk, least)
    flat = max(change / gain - edge, least)
    return (alone, 0.0) if 2 * alone <= 2 * edge + flat else (edge, flat)


def ramp_way(low: float, high: float, limits: Limits) -> float:
    """Return the distance covered while the speed changes: the duration of the change times the mean speed."""
    edge, flat = ramp(high - low, limits)
    return (low + high) / 2 * (2 * edge + flat)


@lru_cache(KEPT)
def reached(length: float, limits: Limits, speed: float) -> float:
    """Return the highest speed, up to 1, that can be reached from `speed` within a distance."""
    return _largest(lambda high: ramp_way(speed, high, limits), speed, 1.0, length)


@lru_cache(KEPT)
def turned(half: float, limits: Limits) -> float:
    """Return the highest speed, up to 1, for a blend that begins and ends at a given distance from its corner."""
    return _largest(lambda speed: ramp_way(0.0, speed, limits), 0.0, 1.0, half)


@lru_cache(KEPT)
def phases(length: float, limits: Limits, first: float, last: float) -> tuple[Phase, ...]:
    """Return the fastest phases between two speeds on a straight line.

    Each speed must be reachable from the other one (`reached`). At either speed, covering the length must take at
    least the shortest duration of a phase.
    """

    def needed(peak: float) -> float:
        return ramp_way(first, peak, limits) + ramp_way(last, peak, limits)

    peak = _largest(needed, max(first, last), 1.0, length)
    ramps, level, slower = needed(peak), length - needed(peak), 1.0
    if ramps > 0 and level < limits.least * peak:  # the ramps are stretched to cover the whole length
        level, slower = 0.0, length / ramps
    cruise = [Phase(level / peak, level, peak, 0.0)] if level > 0 else []
    up, down = _ramped(first, peak, slower, limits), _ramped(peak, last, slower, limits)
    return (*up, *cruise, *down)


def _ramped(first: float, last: float, slower: float, limits: Limits) -> list[Phase]:
    """Return the phases of a change of speed, stretched in time by a factor."""
    if first == last:
        return []
    edge, flat = (slower * seconds for seconds in ramp(abs(last - first), limits))
    strength = (last - first) / (edge + flat)
    low, bend = strength * edge / 2, strength * edge * edge / 6
    ramp_phases = [Phase(edge, first * edge + bend, first + low, strength)]
    if flat > 0:
        ramp_phases.append(Phase(flat, (first + last) / 2 * flat, last - low, strength))
    return [*ramp_phases, Phase(edge, last * edge - bend, last, 0.0)]


def _largest(needed: Callable[[float], float], low: float, high: float, length: float) -> float:
    """Return the largest speed between `low` and `high`, up to `ACCURACY`, for which a length suffices."""
    if length <= 0 or low >= high:
        return low
    if needed(high) <= length:
        return high
    while high - low > ACCURACY * high and low < (middle := (low + high) / 2) < high:
        if needed(middle) <= length:
            low = middle
        else:
            high = middle
    return low
