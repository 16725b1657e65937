"""The straight motions of a path, with limits as shares of full speed."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from loewner._validate import Floats
from loewner.errors import InputError

# Limit on the seconds of a motion at full speed, on the seconds to reach it, and on their reciprocals: squares stay in
# range.
LARGEST_RATIO = 1e100


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
        Fractions of full speed by which the speed can change per second.
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

    def part(self, first: int, last: int) -> Straights:
        """Select the motions at the corners from `first` up to, but without, `last`."""
        motions = slice(first, last + 1)
        return Straights(
            self.rows[first : last + 2], self.lengths[motions], self.full[motions], self.gains[motions], self.strongest
        )

    def extended(self, column: Floats) -> Straights:
        """Append a column to the configurations, which has no limits."""
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
        """Return the points where blends begin, the corners, and the points where blends end; see `_passed`."""
        k = np.arange(len(halves))
        return self.at(k, 1 - halves / self.lengths[:-1]), self.rows[1:-1], self.at(k + 1, halves / self.lengths[1:])


def smallest(ratios: Floats) -> Floats:
    """Return the smallest ratio in each row, ignoring 0 / 0."""
    return np.asarray(np.nanmin(np.where(np.isnan(ratios), np.inf, ratios), axis=1, initial=np.inf))
