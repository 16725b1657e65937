"""Connect poses (x, y, heading) by drivable routes: Reeds-Shepp or Dubins paths, or straight lines with turns in place.

A way is a sequence of motions. Each motion has a length [m], negative for backwards, and a turn [rad]. The base drives
and turns at constant rates, so a motion is an arc of a circle, a straight line, or a turn in place.

References
----------
J. A. Reeds, L. A. Shepp, "Optimal paths for a car that goes both forwards and backwards", Pacific Journal of
Mathematics 145(2), 1990; numbers such as (8.7) refer to its formulas. L. E. Dubins, "On curves of minimal length
with a constraint on average curvature", American Journal of Mathematics 79(3), 1957.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from loewner._base._elementary import arccos, arcsin, arctan2, cos, sin
from loewner._base._validate import Floats

HALF, TURN = math.pi, 2.0 * math.pi

# Angles and lengths up to NO_TURN [rad, radii] count as 0; otherwise, a forward arc could become a whole circle.
NO_TURN = 1e-9

# Circles count as touching if the gap between them is at most TOUCH [radii].
TOUCH = 1e-12

# Signs of lengths and of turns to the left for four problems: the given problem, the problem driven backwards, the
# mirror image, and the mirror image driven backwards.
SIGNS = ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))


class Ways(NamedTuple):
    """Several ways from each of N poses to another pose.

    Attributes
    ----------
    lengths, turns : ndarray, shape (N, ways, motions)
        NaN if there is no way of this kind. Motions that a way does not need are 0.
    """

    lengths: Floats
    turns: Floats

    @property
    def costs(self) -> Floats:
        """Length of each way plus 1 m per radian of turns in place, shape (N, ways); infinite if there is no way."""
        costs = np.where(self.lengths == 0.0, np.abs(self.turns), np.abs(self.lengths)).sum(axis=2)
        return np.where(np.isfinite(costs), costs, np.inf)


class Polar(NamedTuple):
    """The center of the last circle relative to the center of the first one, which is on the left; the radius is 1."""

    x: Floats
    y: Floats
    distance: Floats
    angle: Floats

    @classmethod
    def of(cls, x: Floats, y: Floats) -> Polar:
        """Compute the lengths and angles of vectors."""
        return cls(x, y, np.sqrt(x * x + y * y), arctan2(y, x))


def moved(poses: Floats, lengths: Floats, turns: Floats) -> Floats:
    """Return the poses after motions: poses (..., 3), lengths and turns (...)."""
    return driven(poses, lengths[..., None], turns[..., None])[..., 1, :]


def driven(poses: Floats, lengths: Floats, turns: Floats) -> Floats:
    """Return all poses (..., k + 1, 3) along motions: poses (..., 3), lengths and turns (..., k)."""
    half, all_poses = turns / 2.0, np.empty((*lengths.shape[:-1], lengths.shape[-1] + 1, 3))
    all_poses[..., 0, :] = poses
    all_poses[..., 1:, 2] = turns
    all_poses[..., 2].cumsum(axis=-1, out=all_poses[..., 2])
    heading, chord = all_poses[..., :-1, 2] + half, lengths * _sinc(half)
    all_poses[..., 1:, 0], all_poses[..., 1:, 1] = chord * cos(heading), chord * sin(heading)
    all_poses[..., :2].cumsum(axis=-2, out=all_poses[..., :2])
    return all_poses


def car(a: Floats, b: Floats, radius: float, reverse: bool = True) -> Ways:
    """Return the ways of a car from poses a to poses b, shape (N, 3) each.

    With `reverse`, there are ways for all words of Reeds and Shepp, so the shortest path is among them. Otherwise, the
    ways follow Dubins's words.
    """
    x, y, turn = _seen_from(a, b)
    lengths, steered = _words(x / radius, y / radius, turn, reverse)
    return Ways(lengths * radius, lengths * steered)


def differential(a: Floats, b: Floats, reverse: bool = True) -> Ways:
    """Return the ways of a base that turns in place, drives straight (also backwards if allowed), and turns again."""
    x, y, turn = _seen_from(a, b)
    way = np.sqrt(x * x + y * y)
    bearing = np.where(way > 0.0, arctan2(y, x), 0.0)
    none = np.zeros_like(way)
    lengths = np.stack([np.stack([none, sign * way, none], axis=-1) for sign in (1.0, -1.0)[: 1 + reverse]], axis=1)
    first = np.stack([_wrapped(bearing), _wrapped(bearing + HALF)][: 1 + reverse], axis=1)
    last = _wrapped(turn[:, None] - first)
    return Ways(lengths, np.stack([first, np.zeros_like(first), last], axis=-1))


def _seen_from(a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """Return positions and headings of b in the frames of a."""
    cosine, sine = cos(a[:, 2]), sin(a[:, 2])
    x, y = (b - a)[:, 0], (b - a)[:, 1]
    return cosine * x + sine * y, cosine * y - sine * x, _wrapped(b[:, 2] - a[:, 2])


def _words(x: Floats, y: Floats, turn: Floats, reverse: bool) -> tuple[Floats, Floats]:
    """Return signed lengths (N, words, 5) and steering (words, 5) of the words, for circles of radius 1.

    Each formula is for a word that begins forwards and to the left. The formula is applied to four problems with
    different signs. If the word read backwards is a different word, the formula is also applied to the problem from the
    goal to the start.
    """
    signs = np.array(SIGNS if reverse else SIGNS[::2])
    X, Y, P = signs[:, :1] * x, signs[:, 1:] * y, signs.prod(axis=1)[:, None] * turn
    sine, cosine = sin(P), cos(P)
    words = _forwards(X, Y, P, sine, cosine) if reverse else _all_forward(X, Y, P, sine, cosine)
    if reverse:
        words += _from_the_goal(X * cosine + Y * sine, X * sine - Y * cosine, P, sine, cosine)
    zero = np.zeros_like(X)
    lengths = np.stack([np.stack([*parts, *[zero] * (5 - len(parts))], axis=-1) for _, parts in words])
    steered = np.array(
        [[*("RSL".index(letter) - 1.0 for letter in word), *[0.0] * (5 - len(word))] for word, _ in words]
    )
    lengths = (lengths * signs[:, 0, None, None]).reshape(-1, lengths.shape[2], 5)
    return np.moveaxis(lengths, 0, 1), (steered[:, None] * signs[:, 1, None]).reshape(-1, 5)


Word = tuple[str, tuple[Floats, ...]]


def _forwards(x: Floats, y: Floats, turn: Floats, sine: Floats, cosine: Floats) -> list[Word]:
    """Return the words that the formulas yield from the start to the goal."""
    same, other = Polar.of(x - sine, y - 1.0 + cosine), Polar.of(x + sine, y - 1.0 - cosine)
    quarter, words = np.full_like(x, -HALF / 2.0), _curves(same, other, turn)
    u = arccos(_inside((2.0 + other.distance) / 4.0))  # (8.7)
    t, v = _outer(u, -u, other, turn)
    words.append(("LRLR", (t, u, -u, v)))
    u = -arccos(_inside((20.0 - other.distance**2) / 16.0, least=0.0))  # (8.8)
    t, v = _outer(u, u, other, turn)
    words.append(("LRLR", (t, u, u, v)))
    words += _with_quarter(same, other, turn, quarter)
    straight = 4.0 - _root(other.distance**2 - 4.0)  # (8.11)
    t = arctan2((4.0 - straight) * other.x - 2.0 * other.y, -2.0 * other.x + (straight - 4.0) * other.y)
    words.append(("LRSLR", (t, quarter, straight, quarter, _wrapped(t - turn))))
    return words


def _from_the_goal(x: Floats, y: Floats, turn: Floats, sine: Floats, cosine: Floats) -> list[Word]:
    """Return the words that are read backwards."""
    same, other = Polar.of(x - sine, y - 1.0 + cosine), Polar.of(x + sine, y - 1.0 - cosine)
    words = [_curves(same, other, turn)[2], *_with_quarter(same, other, turn, np.full_like(x, -HALF / 2.0))]
    return [(word[::-1], parts[::-1]) for word, parts in words]


def _curves(same: Polar, other: Polar, turn: Floats) -> list[Word]:
    """Return the words of three motions: (8.1), (8.2), and (8.3) with (8.4)."""
    straight = _root(other.distance**2 - 4.0)
    t = _wrapped(other.angle + arctan2(2.0, straight))
    begin = np.where(same.distance > NO_TURN, same.angle, 0.0)
    u = -2.0 * arcsin(_inside(same.distance / 4.0))
    first = _wrapped(same.angle + u / 2.0 + HALF)
    return [
        ("LSL", (begin, same.distance, _wrapped(turn - begin))),
        ("LSR", (t, straight, _wrapped(t - turn))),
        ("LRL", (first, u, _wrapped(turn - first + u))),
    ]


def _with_quarter(same: Polar, other: Polar, turn: Floats, quarter: Floats) -> list[Word]:
    """Return the words of four motions whose second motion is a quarter of a circle: (8.9) and (8.10)."""
    far = _root(same.distance**2 - 4.0)
    t = _wrapped(same.angle + arctan2(far, -2.0))
    words: list[Word] = [("LRSL", (t, quarter, 2.0 - far, _wrapped(turn - HALF / 2.0 - t)))]
    t = _wrapped(other.angle + HALF / 2.0)
    far = np.where(other.distance >= 2.0, other.distance, np.nan)
    words.append(("LRSR", (t, quarter, 2.0 - far, _wrapped(t + HALF / 2.0 - turn))))
    return words


def _outer(u: Floats, v: Floats, other: Polar, turn: Floats) -> tuple[Floats, Floats]:
    """Return the arcs before and after two arcs u and v: (8.6)."""
    delta = _wrapped(u - v)
    a, b = sin(u) - sin(delta), cos(u) - cos(delta) - 1.0
    angle = arctan2(other.y * a - other.x * b, other.x * a + other.y * b)
    opposite = 2.0 * (cos(delta) - cos(v) - cos(u)) + 3.0 < 0.0
    t = _wrapped(angle + np.where(opposite, HALF, 0.0))
    return t, _wrapped(t - u + v - turn)


def _all_forward(x: Floats, y: Floats, turn: Floats, sine: Floats, cosine: Floats) -> list[Word]:
    """Return Dubins's words. Each backward arc is replaced with the rest of its circle, driven forwards."""
    same, other = Polar.of(x - sine, y - 1.0 + cosine), Polar.of(x + sine, y - 1.0 - cosine)
    words = _curves(same, other, turn)
    return [
        (word, tuple(part if letter == "S" else np.where(part < -NO_TURN, part + TURN, np.maximum(part, 0.0))
                     for letter, part in zip(word, parts, strict=True)))
        for word, parts in words
    ]  # fmt: skip


def _inside(x: Floats, least: float = -1.0) -> Floats:
    """Replace numbers outside a range that ends at 1 with NaN."""
    return np.where((x >= least) & (x <= 1.0 + TOUCH), np.minimum(x, 1.0), np.nan)


def _root(x: Floats) -> Floats:
    """Return square roots, and NaN for numbers below 0."""
    return np.where(x >= -TOUCH, np.sqrt(np.maximum(x, 0.0)), np.nan)


def _wrapped(angle: Floats) -> Floats:
    """Return angles within half a turn."""
    return angle - TURN * np.rint(angle / TURN)


def _sinc(x: Floats) -> Floats:
    """Return sin x / x."""
    small = np.abs(x) < 1e-4
    return np.where(small, 1.0 - x * x / 6.0, sin(x) / np.where(small, 1.0, x))
