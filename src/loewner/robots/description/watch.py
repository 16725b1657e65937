"""Detect entries of configurations whose values cannot be used in computations, or are probably mistakes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import le

import numpy as np

from loewner._base._plausible import FARTHEST_LIMIT, warn
from loewner._base._read_only import KeepsReadOnly
from loewner._base._validate import Floats
from loewner.errors import InputError

# A joint's value may be outside its limits by these amounts without a warning. An angle may be off by ANGLE_OUTSIDE
# [rad], a whole turn, since it may have been wrapped. A length may be off by LENGTH_OUTSIDE [m] plus SPANS_OUTSIDE
# times the distance between the limits.
ANGLE_OUTSIDE = 2 * math.pi
LENGTH_OUTSIDE, SPANS_OUTSIDE = 1.0, 10.0

# Larger angles of joints without limits are probably in degrees. The number is about eight turns [rad].
LARGEST_TURN = 50.0

# Larger values of joints are refused [rad or m], so that no pose is NaN. Accepted values stay finite when they are
# multiplied by a description's largest factor and added up along its longest chain.
LARGEST_VALUE = 1e200


class Watch(KeepsReadOnly):
    """In configurations, find values that cannot be used in computations, and values far outside the limits.

    Parameters
    ----------
    robot : str
        The robot's name, for the warning.
    names : sequence of str
        Names of the entries of a configuration.
    lower, upper : ndarray, shape (dof,)
        Limits; infinite where there are none.
    turns : sequence of bool
        Which entries are angles.
    free : sequence of bool
        Which entries belong to planar and floating joints. Such entries never cause a warning.

    Attributes
    ----------
    turns, free : tuple of bool
        As given.
    range : ndarray, shape (2, dof)
        Least and largest values that need no warning. The array object is never replaced, but its entries may change to
        a wider range.

    Notes
    -----
    After one warning, only values that cannot be used in computations are detected. Copies of a robot share one watch.
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
        self._robot, self._names = robot, tuple(names)
        self.turns, self.free = tuple(turns), tuple(free)
        self._limits = lower, upper
        self.range = np.empty((2, len(lower)))
        from_below, from_above = lower > -FARTHEST_LIMIT, upper < FARTHEST_LIMIT
        span = np.where(from_below & from_above, upper.clip(max=FARTHEST_LIMIT) - lower.clip(min=-FARTHEST_LIMIT), 0.0)
        room = np.where(self.turns, ANGLE_OUTSIDE, LENGTH_OUTSIDE + SPANS_OUTSIDE * span)
        widest = np.where(self.turns, LARGEST_TURN, LARGEST_VALUE)
        # A single limit may lie beyond the values at which a joint without limits would cause a warning.
        least = np.where(from_below, lower - room, np.where(from_above, upper, 0.0).clip(max=0.0) - widest)
        most = np.where(from_above, upper + room, np.where(from_below, lower, 0.0).clip(min=0.0) + widest)
        self._look_for(np.where(self.free, -LARGEST_VALUE, least), np.where(self.free, LARGEST_VALUE, most))

    def _look_for(self, least: Floats, most: Floats) -> None:
        self.range[:] = np.clip([least, most], -LARGEST_VALUE, LARGEST_VALUE)
        self._least, self._most = self.range.tolist()

    def passes_one(self, values: list[float]) -> bool:
        """Return whether one configuration needs no warning."""
        return all(map(le, self._least, values)) and all(map(le, values, self._most))  # no comparison holds for NaN

    def passes(self, Q: Floats) -> bool:
        """Return True if no configuration in a batch, shape (..., dof), needs a warning."""
        least, most = self.range
        return bool((least <= Q).all() and (most >= Q).all())

    def expect_usable(self, Q: Floats, name: str) -> None:
        """Refuse a batch with an entry that cannot be used in computations; the error names the first such entry."""
        for *row, k in np.argwhere(~(np.abs(Q) <= LARGEST_VALUE))[:1].tolist():
            value = Q[(*row, k)]
            wanted = f"numbers within ±{LARGEST_VALUE:g}" if np.isfinite(value) else "finite numbers"
            raise InputError(f"{_where(name, row)}: expected {wanted}, found {value} for {self._names[k]}")

    def tell(self, Q: Floats, name: str) -> None:
        """Warn about the first configuration that did not pass, and never warn again."""
        least, most = self.range
        far = np.argwhere((least > Q) | (most < Q))
        if not len(far):
            return  # another thread wrote to the array meanwhile
        *row, k = far[0].tolist()
        value, (lower, upper) = Q[(*row, k)], self._limits
        self._look_for(np.full(len(least), -np.inf), np.full(len(least), np.inf))
        where, none = _where(name, row), np.isinf(lower[k]) and np.isinf(upper[k])
        limits = "no limits" if none else f"the limits {lower[k]:.4g} .. {upper[k]:.4g}"
        unit, slip = ("rad", "degrees") if self.turns[k] else ("m", "millimetres")
        warn(
            f"{where}: expected a value near the limits, found {self._names[k]} = {value:.6g} {unit} with {limits}; "
            f"is it in {slip}? (this warning is given once for robot {self._robot!r})"
        )


def _where(name: str, row: list[int]) -> str:
    return f"{name}[{', '.join(map(str, row))}]" if row else name
