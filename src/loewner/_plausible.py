"""Warn once about values that are allowed but usually a mistake: degrees for radians, millimetres for metres.

Thresholds are such that a warning is almost certainly right; if a value is intended, one line of text is the only
effect.
"""

from __future__ import annotations

import math
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from operator import le

import numpy as np

from loewner._validate import Floats

# Allowed excess of a joint value over its limits: an angle may have been wrapped by a turn [rad]; a length is compared
# with the range of the limits, plus a metre.
ANGLE_OUTSIDE = 2 * math.pi
LENGTH_OUTSIDE, SPANS_OUTSIDE = 1.0, 10.0

# For a joint that turns without limits, an angle beyond this is more likely in degrees: about eight turns [rad].
LARGEST_TURN = 50.0

# A rotation in a file is written within one turn; two turns leave a margin for any convention [rad].
LARGEST_RPY = 4 * math.pi

# Larger limits are programs' way to write none [rad or m]: 1e16, or the largest float.
FARTHEST_LIMIT = 1e6

# Larger values of joints are refused [rad or m]: times the largest factor of a description, and summed along the
# longest chain, this is still finite, so no pose is NaN.
LARGEST_VALUE = 1e200

# Sizes and distances that suggest another unit [m]: a hall in millimetres, a screw scaled twice by a thousandth.
LARGEST_RADIUS, SMALLEST_RADIUS, LARGEST_DISTANCE = 1000.0, 1e-5, 2000.0


class _Listener(threading.local):
    """The calling thread's list for warnings; Python's own way to catch them affects all threads."""

    texts: list[str] | None = None


_listener = _Listener()


@contextmanager
def told_to(texts: list[str]) -> Iterator[None]:
    """Collect this thread's warnings in a list, instead of issuing them, until the block ends."""
    before = _listener.texts
    _listener.texts = texts
    try:
        yield
    finally:
        _listener.texts = before


def warn(text: str) -> None:
    """Issue a warning at the line that called the library, not at the line within the library."""
    if _listener.texts is not None:
        _listener.texts.append(text)
        return
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "loewner":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, stacklevel=level)


def doubt_about_size(radius: float, distance: float) -> str:
    """Why a body of this radius [m] at this distance from the origin [m] may be in another unit; empty if plausible."""
    if radius > LARGEST_RADIUS:
        return f"lengths in metres, found a body {2 * radius:.3g} m across; is it in millimetres?"
    if 0 < radius < SMALLEST_RADIUS:
        return f"lengths in metres, found a body {2 * radius:.3g} m across; was it scaled twice?"
    if distance > LARGEST_DISTANCE:
        return f"lengths in metres, found a place {distance:.4g} m away; is it in millimetres?"
    return ""


def doubt_about_rpy(rpy: Sequence[float]) -> str:
    """Why roll, pitch and yaw may be in degrees; empty if plausible."""
    most = max(abs(angle) for angle in rpy)
    return f"roll, pitch and yaw in radians, found {most:g}; is it in degrees?" if most > LARGEST_RPY else ""


class Watch:
    """Checks configurations for values that are too large to compute with, or far outside the limits.

    Parameters
    ----------
    robot : str
        Name of the robot, for the warning.
    names : sequence of str
        Names of the entries of a configuration.
    lower, upper : ndarray, shape (dof,)
        Limits; infinite where there are none.
    turns : sequence of bool
        Which entries are angles.
    free : sequence of bool
        Which entries belong to joints without limits in any unit: planar and floating joints.

    Attributes
    ----------
    range : ndarray, shape (2, dof)
        Smallest and largest values that cause no warning; the array object stays the same, and its range may only grow.

    Notes
    -----
    It warns once, and afterwards only checks for values that are too large. Copies of a robot share it.
    """

    def __init__(
        self,
        robot: str,
        names: Sequence[str],
        lower: Floats,
        upper: Floats,
        turns: Sequence[bool],
        free: Sequence[bool],
    ) -> None:
        self._robot, self._names, self._turns = robot, tuple(names), tuple(turns)
        self._limits = lower, upper
        self.range = np.empty((2, len(lower)))
        from_below, from_above = lower > -FARTHEST_LIMIT, upper < FARTHEST_LIMIT
        span = np.where(from_below & from_above, upper.clip(max=FARTHEST_LIMIT) - lower.clip(min=-FARTHEST_LIMIT), 0.0)
        room = np.where(turns, ANGLE_OUTSIDE, LENGTH_OUTSIDE + SPANS_OUTSIDE * span)
        widest = np.where(turns, LARGEST_TURN, LARGEST_VALUE)
        # A single limit may lie outside the range allowed for a joint without limits.
        least = np.where(from_below, lower - room, np.where(from_above, upper, 0.0).clip(max=0.0) - widest)
        most = np.where(from_above, upper + room, np.where(from_below, lower, 0.0).clip(min=0.0) + widest)
        self._look_for(np.where(free, -LARGEST_VALUE, least), np.where(free, LARGEST_VALUE, most))

    def _look_for(self, least: Floats, most: Floats) -> None:
        self.range[:] = np.clip([least, most], -LARGEST_VALUE, LARGEST_VALUE)
        self._least, self._most = self.range.tolist()

    def passes_one(self, values: list[float]) -> bool:
        """Whether one configuration is within the range."""
        return all(map(le, self._least, values)) and all(map(le, values, self._most))  # neither holds for NaN

    def passes(self, Q: Floats) -> bool:
        """Whether all configurations, shape (..., dof), are within the range."""
        least, most = self.range
        return bool((least <= Q).all() and (most >= Q).all())

    def refused(self, Q: Floats) -> tuple[int, ...] | None:
        """Index of the first entry that is too large to compute with."""
        wrong = ~(np.abs(Q) <= LARGEST_VALUE)
        return tuple(int(i) for i in np.argwhere(wrong)[0]) if wrong.any() else None

    def tell(self, Q: Floats, name: str) -> None:
        """Warn about the configurations that did not pass, once and for all."""
        least, most = self.range
        *row, k = (int(i) for i in np.argwhere((least > Q) | (most < Q))[0])
        value, (lower, upper) = Q[(*row, k)], self._limits
        self._look_for(np.full(len(least), -np.inf), np.full(len(least), np.inf))
        where = f"{name}[{', '.join(map(str, row))}]" if row else name
        none = np.isinf(lower[k]) and np.isinf(upper[k])
        limits = "no limits" if none else f"the limits {lower[k]:.4g} .. {upper[k]:.4g}"
        unit, slip = ("rad", "degrees") if self._turns[k] else ("m", "millimetres")
        warn(
            f"{where}: expected a value near the limits, found {self._names[k]} = {value:.6g} {unit} with {limits}; "
            f"is it in {slip}? (told once for {self._robot!r})"
        )
