"""Check a file that proves motions collision-free, in integers and fractions, without the rest of the library.

A file may also prove that pairs of bodies are free over ranges of the joints between them, or that two bodies collide.
The module needs only Python's standard library, and can be run on its own: ``python verify.py plan.proof``. The page
docs/proof-format.md describes the files, and shows why a file that passes is a proof.

Lengths, sines and matrices are integers in units of 2^-72. The following bounds on rounding errors are in these units.
They hold for the norms of vectors and matrices, that is, for the root of the sum of squares. Lengths that appear as
factors are in metres.

- A double, and each entry of a fixed rotation or of an axis, has a rounding error below 1. The error of a sine or
  cosine is below 2: a tenth for the angle, a thousandth for the series, and 1 for the result. A joint's rotation is c +
  s e + (1 - c) e e, with the cosine c, the sine s and the axis e. The errors of the three terms are below 2, 3 and 4 in
  each entry, and the sum adds 1. The matrix therefore has an error below 30. Including the products with the fixed
  rotation and with the parent's rotation, each link of the chain adds at most 41 to the error; ``TURN`` is larger.
- A link is at its parent's position plus a rotated step of length l. The step has an error below 3 l + 8. The parent's
  rotation adds its own error times l, and rounding adds 2. For a chain of k links with the total length L, the error is
  at most E (L + 1), where E = TURN (k + 1).
- A plane's normal n is exact, since any vector is a valid normal. In the other body's frame, the normal has an error of
  2 E |n| + 5. Let X be the size of the bodies. A gap has an error of at most (|n| + 1) E (2 X + 4 L + 3), plus |n|
  times the errors of both bodies' placed points. The error of a placed point is at most ``_Body.fuzz``.
"""

import argparse
import hashlib
import os
import struct
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, groupby, pairwise, product
from math import isqrt
from pathlib import Path
from typing import Any

__all__ = ["Refused", "Report", "main", "verify"]

BITS, ONE = 72, 1 << 72  # lengths, sines and entries of matrices are multiples of 2^-BITS
GUARD = BITS + 24  # angles and the series of their sines are multiples of 2^-GUARD
HALF_PI = 0x3243F6A8885A308D313198A2E03707344A4093822299F31D >> 189 - GUARD
TURN, DEEPEST = 64, 64  # error of a rotation for each link of its chain (derived: 41); the deepest nesting of a tree
MOST_LINKS, MOST_BYTES, MOST_DEGREE, MOST_STILL = 1000, 1 << 24, 31, 100  # MOST_STILL: links of a common point's model
MOST_SIDES = 8  # most sides of a box of values; each plane is checked at all corners of the box
MOST_WORK = 1 << 30  # steps, such as the product of a point and a normal; a step takes a third of a microsecond
Whole = tuple[int, ...]  # vectors have 3 entries, matrices 9, by rows
Pair = tuple[int, int]
Names = tuple[str, str]
Tightest = tuple[str, str, int, Fraction, Fraction, float, Fraction]
Contact = tuple[str, str, int, Fraction, Fraction, float]
Range = tuple[str, float, float, bool]
Pose = tuple[Whole, Whole]
Stretch = tuple[str, str, tuple[int, Fraction], tuple[int, Fraction], float]
Part = tuple[int, int, list[Whole], Whole]  # kind, radius, points or a center, and matrix of kinds 1 to 3
AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1))
EVERY = [(i, k) for i in range(3) for k in range(3)]
STILL: Pose = (ONE, 0, 0, 0, ONE, 0, 0, 0, ONE), (0, 0, 0)


class Refused(Exception):
    """The file is not a proof; the message gives the reason."""


@dataclass(frozen=True)
class Report:
    """Contents of a verified file; `str` returns them as a table.

    Attributes
    ----------
    model, sizes : str, and dict of str to int
        ``model`` is the SHA-256 of the model. ``sizes`` gives the numbers of links, values, bodies, pieces, pairs
        proven apart, planes, and intervals of pairs.
    margins, deviations : (float, int), and tuple of (str, float)
        ``margins`` contains the usual margin, and the number of pairs with a different margin. ``deviations`` gives the
        name of each value, and how far the value may deviate.
    left_out, uncovered : tuple of (str, str), and of str
        ``left_out`` lists the pairs that the model exempts. ``uncovered`` lists the bodies whose interior is not
        covered by their pieces; the planes prove nothing about such an interior.
    points, motions : tuple of tuple of tuple of float, and tuple of (int, bool, bool, int)
        ``points`` contains the control points of each motion. ``motions`` contains four entries for each motion: its
        degree, whether it starts where the previous motion ends, whether its control points are within the limits of
        the values, and the number of configurations at which planes were checked.
    tightest, common : (str, str, int, Fraction, Fraction, float, Fraction) or None, and (str, str) or None
        ``tightest`` is the check that passes most narrowly: two bodies, a motion, the two ends of an interval, the
        margin, and the distance by which the check passes. If the file claims a common point, ``common`` names the two
        bodies that share it.
    rules, contacts : tuple of (str, str, int), and of (str, str, int, Fraction, Fraction, float)
        ``rules`` lists the pairs that may be in contact at the start (1) or at the end (2) of motions, or at both (3).
        Each entry of ``contacts`` contains two bodies, a motion, the two ends of an interval, and the least distance
        between the bodies in metres, which is negative for an overlap.
    ranges : tuple of (str, str, float, tuple of (str, float, float, bool))
        Each entry of ``ranges`` contains two bodies, their margin in metres, and the values of the joints between the
        bodies; there are no entries unless the file claims ranges. Each value has a name, the two ends of the range
        over which the bodies are farther apart than the margin, and a flag. The flag is true if the range covers all
        numbers that the value can have. With ``ranges``, the last five entries of ``tightest`` are the index of the
        pair, 0, 1, the margin, and the distance by which the check passes.
    """

    model: str
    sizes: dict[str, int]
    margins: tuple[float, int]
    left_out: tuple[Names, ...]
    uncovered: tuple[str, ...]
    deviations: tuple[tuple[str, float], ...]
    points: tuple[tuple[tuple[float, ...], ...], ...]
    motions: tuple[tuple[int, bool, bool, int], ...]
    tightest: Tightest | None
    common: Names | None
    rules: tuple[tuple[str, str, int], ...] = ()
    contacts: tuple[Contact, ...] = ()
    ranges: tuple[tuple[str, str, float, tuple[Range, ...]], ...] = ()

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """Contacts, joined across motions: two bodies, motion and parameter t at both ends, and the least distance."""
        stretches, last = list[Stretch](), dict[tuple[str, str, float], int]()
        for a, b, number, since, until, least in self.contacts:
            k = last.get((a, b, least), -1)
            if k >= 0 and since == 0 and stretches[k][3] == (number - 1, Fraction(1)):
                stretches[k] = a, b, stretches[k][2], (number, until), least
            else:
                last[a, b, least] = len(stretches)
                stretches.append((a, b, (number, since), (number, until), least))
        return tuple(stretches)

    def __str__(self) -> str:
        lines = [("model", self.model), ("", ", ".join(f"{count} {what}" for what, count in self.sizes.items()))]
        for number, (degree, joined, inside, places) in enumerate(self.motions if self.deviations else ()):
            start = ("starts elsewhere", "starts where the last one ends", "the first")[joined + (number == 0)]
            text = f"degree {degree}, {start}, {'' if inside else 'NOT '}within limits, planes at {places} places"
            lines.append((f"motion {number}", text))
        ends = (self.points[0][0], self.points[-1][-1]) if self.points and self.deviations else ()
        for what, q in zip(("begins at", "ends at"), ends, strict=False):
            lines.append((what, ", ".join(f"{_shown(x)} {v!r}" for (x, _), v in zip(self.deviations, q, strict=True))))
        if self.tightest:
            *pair, number, since, until, margin, spare = self.tightest
            least = f"with the margin of {1000 * margin:.12g} mm, holds by {int(10**12 * spare) / 10**9:.6g} mm"
            where = f"motion {number}, t in [{since}, {until}]" if self.deviations else "which do not move"
            where = "" if self.ranges else f", {where}"
            lines.append(("tightest", f"plane: its condition, {least} ({_shown(*pair)}{where})"))
        for a, b, margin, extents in self.ranges:
            lines.append(("pair", f"{_shown(a, b)} are farther apart than {1000 * margin:.12g} mm"))
            for name, low, high, whole in extents:
                extent = f"{'' if whole else 'NOT '}all of its range"
                lines.append(("", f"for {_shown(name)} from {low!r} to {high!r}, {extent}"))
        if not self.ranges:
            lines.append(("margin", f"{1000 * self.margins[0]:.12g} mm; {self.margins[1]} pairs have another one"))
            off = [(f"{_shown(name)}: ", x) for name, x in self.deviations if x] or [("", 0)]
            lines += [("joint error", f"{name}{x!r}") for name, x in off]
        for name, pairs in groupby(() if self.ranges else self.left_out, lambda pair: pair[0]):
            lines.append(("left out", f"{_shown(name)} and {', '.join(_shown(other) for _, other in pairs)}"))
        lines += [("not covered", f"the interior of {_shown(name)}") for name in self.uncovered]
        for a, b, which in () if self.ranges else self.rules:
            when = ("at the start", "at the end", "at the start and at the end")[which - 1]
            lines.append(("rule", f"{_shown(a, b)} may be in contact {when} of motions"))
        for a, b, (number, since), (last, until), room in self.stretches:
            near = f"overlap by {-1000 * room:.12g} mm" if room < 0 else f"come as near as {1000 * room:.12g} mm"
            when = f"until t = {until}" if since == 0 else f"from t = {since} on"
            when = f"all along motion {number}" if until - since == 1 else f"in motion {number} {when}"
            if last > number:
                when = f"from t = {since} in motion {number} until t = {until} in motion {last}"
            lines.append(("contact", f"{_shown(a, b)} may {near} {when}"))
        free = "FREE, except for the contacts above" if self.contacts else "FREE"
        free = "FREE, the pairs above in the ranges above" if self.ranges else free
        lines.append(("claim", f"COLLIDING: {_shown(*self.common)} have a common point" if self.common else free))
        return "\n".join(f"{what:12} {text}" for what, text in lines)


def _down(x: float | Fraction, bits: int = BITS) -> int:
    """Multiply a number by 2^bits and round down, without arithmetic on doubles."""
    n, d = x.as_integer_ratio()
    return (n << bits) // d


def _up(x: float | Fraction) -> int:
    return -_down(-x)


def _vector(numbers: Iterable[float | Fraction]) -> Whole:
    return tuple(map(_down, numbers))


def _whole(numbers: Sequence[float]) -> Whole:  # multiplied by a power of two that makes all of them integers
    ratios = [x.as_integer_ratio() for x in numbers]
    return tuple(n * (max(d for _, d in ratios) // d) for n, d in ratios)


def _norm_up(entries: Whole) -> int:
    return isqrt(sum(x * x for x in entries)) + 1


def _sum(v: Sequence[Any], w: Sequence[Any], by: int | Fraction = 1) -> tuple[Any, ...]:
    return tuple([a + by * b for a, b in zip(v, w, strict=True)])


def _apply(m: Whole, v: Whole) -> Whole:
    a, b, c, d, e, f, g, h, i = m
    x, y, z = v
    return a * x + b * y + c * z >> BITS, d * x + e * y + f * z >> BITS, g * x + h * y + i * z >> BITS


def _transposed(m: Whole) -> Whole:
    return m[::3] + m[1::3] + m[2::3]


def _product(a: Whole, b: Whole) -> Whole:
    return _transposed(_apply(a, b[::3]) + _apply(a, b[1::3]) + _apply(a, b[2::3]))


def _cos_sin(angle: int) -> Pair:
    """Return cosine and sine, in units of 2^-BITS, of an angle in units of 2^-GUARD."""
    quarters = (2 * angle + HALF_PI) // (2 * HALF_PI)
    rest, sums = angle - quarters * HALF_PI, []
    square = rest * rest >> GUARD
    for n, term in ((0, 1 << GUARD), (1, abs(rest))):
        total, sign = 0, 1
        while term:  # the terms alternate and decrease, so the error is less than the next term
            total += sign * term
            term, sign, n = (term * square >> GUARD) // ((n + 1) * (n + 2)), -sign, n + 2
        sums.append(total >> GUARD - BITS)
    c, s = sums[0], sums[1] if rest > 0 else -sums[1]
    return ((c, s), (-s, c), (-c, -s), (s, -c))[quarters % 4]


def _shown(*names: str) -> str:
    return " and ".join(name if name.isprintable() else ascii(name) for name in names)


class _Reader:
    def __init__(self, data: bytes, part: str) -> None:
        self.data, self.part, self.at = data, part, 0

    def take(self, form: str) -> tuple[Any, ...]:
        start, self.at = self.at, self.at + struct.calcsize("<" + form)
        if self.at > len(self.data):
            raise Refused(f"The {self.part} ends too early.")
        return struct.unpack_from("<" + form, self.data, start)

    def count(self, size: int, what: str, least: int = 0, most: int = MOST_BYTES) -> int:
        # Each item has `size` bytes or more.
        number = int(*self.take("I"))
        if not least <= number <= most or number * size > len(self.data) - self.at:
            raise Refused(f"The {self.part} cannot have {number} {what} at byte {self.at - 4}.")
        return number

    def doubles(self, number: int, what: str = "") -> list[float]:  # checked: finite, not huge, not negative if named
        start, doubles = self.at, self.take(f"{number}d")
        for k, x in enumerate(doubles):
            if not (abs(x) < 2**32 and (x >= 0 or not what)):
                raise Refused(f"Byte {start + 8 * k} of the {self.part}: {x!r} is not finite, too large or negative.")
        return list(doubles)

    def name(self) -> str:
        return bytes(*self.take(f"{self.take('H')[0]}s")).decode(errors="backslashreplace")

    def end(self) -> None:
        if self.at != len(self.data):
            raise Refused(f"The {self.part} has {len(self.data) - self.at} bytes too many.")


class _Link:
    """A link: its fixed pose, exactly and in units of 2^-BITS, and the axis of the joint that moves it."""

    def __init__(self, reader: _Reader, links: "list[_Link]") -> None:
        name = _shown(reader.name())
        self.above, self.kind, self.value = reader.take("iBi")
        self.by, self.off, w, *numbers = map(Fraction, reader.doubles(12))
        v, self.place, self.axis = numbers[:3], numbers[3:6], numbers[6:]
        square, size = sum(n * n for n in self.axis), w * w + sum(n * n for n in v)
        wrong = self.kind > 2 or ((self.value != -1) if self.kind == 0 else self.value < 0)
        if wrong or not -1 <= self.above < len(links) or size == 0 or (self.kind == 1 and square == 0):
            raise Refused(f"Link {name}: the link above it, the kind, value, quaternion or axis is impossible.")
        base = links[self.above] if self.above >= 0 else None
        self.chain: tuple[_Link, ...] = (*base.chain, self) if base else (self,)
        self.group: int = base.group if base and not self.kind else len(links)
        cross, rest = (0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0), 2 * w * w - size
        self.rotation = [(2 * v[i] * v[k] + 2 * w * cross[3 * i + k] + rest * (i == k)) / size for i, k in EVERY]
        self.turn, self.shift = _vector(self.rotation), _vector(self.place)
        self.reach, self.axis_norm = _norm_up(self.shift) + 2, _norm_up(_vector(self.axis)) + 2
        if self.kind == 1:
            self.unit = [isqrt(_down(n * n / square, 2 * BITS)) * (-1 if n < 0 else 1) for n in self.axis]
            self.outer: Whole = _vector(self.axis[i] * self.axis[k] / square for i, k in EVERY)

    def pose(self, value: Fraction) -> Pose:  # in the frame of the link above
        if not self.kind:
            return self.turn, self.shift
        v = self.by * value + self.off
        if self.kind == 2:
            return self.turn, _sum(self.shift, _apply(self.turn, _vector(v * n for n in self.axis)))
        c, s = _cos_sin(_down(v, GUARD))
        x, y, z = (s * n for n in self.unit)
        cross = (c << BITS, -z, y, z, c << BITS, -x, -y, x, c << BITS)
        turned = tuple((ONE - c) * m + n >> BITS for m, n in zip(self.outer, cross, strict=True))
        return _product(self.turn, turned), self.shift

    def pass_ball(self, c: Whole, radius: int, upward: bool) -> tuple[Whole, int]:
        """Carry a ball past the joint; if the joint turns, the ball's reach about the axis becomes the radius."""
        # The error of a turned or projected center is at most 3 |c| for the matrix, 2 for rounding, and 2 for the
        # shift.
        off = 8 + (8 * (_norm_up(c) + self.reach) >> BITS)
        if not upward:
            c = _apply(_transposed(self.turn), _sum(c, self.shift, -1))
        if self.kind == 1:
            foot = _apply(self.outer, c)
            c, radius = foot, radius + off + _norm_up(_sum(c, foot, -1))
        return (_sum(self.shift, _apply(self.turn, c)) if upward else c), radius + off


class _Body:
    """A body: its numbers in the file, a ball around it, and its pieces in units of 2^-BITS, in its link's frame."""

    def __init__(self, reader: _Reader, links: list[_Link]) -> None:
        self.name, (self.link, self.inside) = reader.name(), reader.take("iB")
        if not -1 <= self.link < len(links) or self.inside > 1:
            raise Refused(f"Body {_shown(self.name)} has the link {self.link} and the mark {self.inside}.")
        self.group = links[self.link].group if self.link >= 0 else -1
        self.turn, self.place = reader.doubles(9), reader.doubles(3)
        self.matrix, self.shift, self.largest = _vector(self.turn), _vector(self.place), ONE
        self.whole = _whole(self.turn)
        self.kinds, self.pieces, self.counts = list[tuple[int, float, list[float]]](), list[list[Part]](), [0]
        for _ in range(reader.count(37, "pieces", 1)):
            (kind,), (radius,) = reader.take("B"), reader.doubles(1, "radius")
            if kind > 4:
                raise Refused(f"Kinds of pieces are 0 to 4, found {kind}.")
            width = (3, 12, 12, 12, 4)[kind]
            numbers = reader.doubles(width * (1 if width == 12 else reader.count(8 * width, "points", 1)))
            self.kinds.append((kind, radius, numbers))
            self.counts.append(self.counts[-1] + len(numbers) // width + 5)
            if kind == 4 and min(numbers[3::4]) < 0:
                raise Refused("A ball has a negative radius.")
            points, g = dict[int, list[Whole]](), _vector(numbers[3:] if width == 12 else ())
            for k in range(0, len(numbers), width):
                at, own = _vector(numbers[k : k + 3]), _up(numbers[k + 3]) if kind == 4 else 0
                points.setdefault(_up(radius) + own, []).append(_sum(self.shift, _apply(self.matrix, at)))
                self.largest = max(self.largest, _norm_up(at) + ONE, _norm_up(g) + ONE)
            self.pieces.append([(kind, r, some, g and _product(self.matrix, g)) for r, some in points.items()])
        # Entries of matrices and points are rounded by 1. The error is 3 |y| + 2 |M| + 4 for M y + s, and the same for
        # M G.
        self.fuzz = (10 * (self.largest + _norm_up(self.matrix)) >> BITS) + 1  # error of a placed point, and of M G
        # The radius of a ball around a piece of kind 1 is the norm of its matrix; for kinds 2 and 3, it is √2 times
        # this norm.
        parts = [part for piece in self.pieces for part in piece]
        balls = [(r + (_norm_up(g * min(kind, 2)) if g else 0), points) for kind, r, points, g in parts]
        low = [min(min(point[k] for point in points) - r for r, points in balls) for k in range(3)]
        high = [max(max(point[k] for point in points) + r for r, points in balls) for k in range(3)]
        x, y, z = ((a + b) // 2 for a, b in zip(low, high, strict=True))
        squares = ((r, max((a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2 for a, b, c in points)) for r, points in balls)
        radius = self.fuzz + max(isqrt(square) + 1 + r for r, square in squares)
        self.center: Whole = (x, y, z)
        self.radius, self.size = radius, _norm_up(self.center) + radius

    def support(self, part: Pair, n: Whole, norm: int) -> int:
        """Return the largest product of n, whose length is at most `norm`, with a point of some pieces, rounded up."""
        (a, b, c), products = n, []
        for piece in self.pieces[part[0] : part[1]]:
            for kind, radius, points, g in piece:
                products.append(max([a * x + b * y + c * z for x, y, z in points]) + norm * radius)
                if g:
                    u, v, w = (g[k] * a + g[k + 3] * b + g[k + 6] * c for k in range(3))
                    rim = isqrt(u * u + v * v) + 1
                    products[-1] += _norm_up((u, v, w)) if kind == 1 else rim + abs(w) if kind == 2 else max(w, rim - w)
        return max(products)

    def contains(self, piece: int, four: Whole, point: list[Fraction]) -> bool:
        """Return whether four numbers of the file show that a point, exact in the frame of the link, is in a piece."""
        (kind, radius, numbers), one = self.kinds[piece], Fraction(1)
        if kind in (1, 2, 3):
            columns = [_moved(self.turn, numbers[k::3], (0, 0, 0)) for k in (3, 4, 5)]
            rest = _sum(point, _moved(self.turn, numbers[:3], self.place), -1)
            u = _solved([list(row) for row in zip(*columns, rest, strict=True)]) or [2 * one] * 3
            allowed = (one - u[2] ** 2, one, ((1 - u[2]) / 2) ** 2)[kind - 1]
            return not radius and not any(four) and abs(u[2]) <= 1 and u[0] ** 2 + u[1] ** 2 <= allowed
        width = 3 if kind == 0 else 4
        if max(four) >= len(numbers) // width:
            return False
        corners = [_moved(self.turn, numbers[width * k : width * k + 3], self.place) for k in four]
        for some in (some for count in range(4, 0, -1) for some in combinations(corners, count) if kind == 0):
            weights = _solved([list(row) for row in zip(*some, point, strict=True)] + [[one] * (len(some) + 1)])
            if weights and min(weights) >= 0:
                return True
        away, along = _sum(point, corners[0], -1), _sum(corners[1], corners[0], -1)
        share = _dot(away, along) / (_dot(along, along) or 1) if kind == 0 else Fraction(0)
        away = _sum(away, along, -min(max(share, Fraction(0)), one))
        reach = Fraction(radius) + (Fraction(numbers[4 * four[0] + 3]) if kind == 4 else 0)
        return _dot(away, away) <= reach**2


def _moved(m: Sequence[Any], v: Sequence[Any], shift: Sequence[Any]) -> list[Fraction]:
    return [sum((Fraction(m[3 * i + k]) * Fraction(v[k]) for k in range(3)), Fraction(shift[i])) for i in range(3)]


def _dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _solved(rows: Sequence[Sequence[Fraction]]) -> list[Fraction] | None:
    """Solve linear equations, whose rows end with the right-hand side; None unless exactly one solution exists."""
    if not rows or len(rows[0]) == 1:
        return None if any(row[0] for row in rows) else []
    pivot = next((row for row in rows if row[0]), rows[0])
    rest = [_sum(row, pivot, -row[0] / pivot[0])[1:] for row in rows if row is not pivot and pivot[0]]
    solution = _solved(rest) if pivot[0] else None
    return None if solution is None else [(pivot[-1] - _dot(pivot[1:-1], solution)) / pivot[0], *solution]


class _Motion:
    """A motion: its control points and, for each link, rates and the length of the chain, including slides."""

    def __init__(self, number: int, points: list[list[float]], links: list[_Link], deviations: list[float]) -> None:
        self.number, self.points, self.rates, self.lengths = number, points, list[Whole](), list[int]()
        self.columns = [list(map(Fraction, column)) for column in zip(*points, strict=True)]
        self.poses, self.bounds = dict[int, list[Pose]](), dict[Pair, Pair]()
        for link in links:
            rate = bend = stray = far = Fraction(0)
            if link.kind:
                column, by, degree = self.columns[link.value], abs(link.by), len(points) - 1
                first = [b - a for a, b in pairwise(column)]
                rate, stray = by * degree * max(map(abs, first)), by * Fraction(deviations[link.value])
                bend = by * degree * (degree - 1) * max((abs(b - a) for a, b in pairwise(first)), default=0)
                far = max(abs(link.by * x + link.off) for x in column)
            if link.kind == 1 and far > 10**6:
                raise Refused(f"Motion or pair {number} turns a joint beyond 1e6 rad.")
            self.rates.append((_up(rate), _up(bend), _up(stray), _up(far + stray)))
            slide = -(-link.axis_norm * self.rates[-1][3] >> BITS) if link.kind == 2 else 0
            self.lengths.append((self.lengths[link.above] if link.above >= 0 else 0) + link.reach + slide)
        self.lengths.append(0)  # number -1 is the world


class _Box(_Motion):
    """A pair with ranges of the values between its bodies, as a motion from the lower to the upper ends.

    `paths` lists, for each body, the links up to the common link, without the common link. `sides` lists the values,
    with the start and the width of each range.
    """

    def __init__(
        self, number: int, margin: float, paths: Sequence[list[int]], ends: dict[int, list[float]],
        links: list[_Link], count: int,
    ) -> None:  # fmt: skip
        rows: list[list[float]] = [[0] * count for _ in range(3)]
        for value, (low, high) in ends.items():
            rows[0][value], rows[1][value] = low, high
        super().__init__(number, rows[:2], links, rows[2])
        self.margin, self.paths, self.links, self.local = margin, paths, links, dict[Pair, Pose]()
        self.sides = [(k, Fraction(low), Fraction(high) - Fraction(low)) for k, (low, high) in ends.items()]
        self.bends = dict[Pair, list[int]]()  # the bounds B_c

    def at(self, shares: Sequence[int]) -> dict[int, Pose]:
        """Return the links' poses in the frame of the common link (-1 for the world), at shares of the ranges."""
        share, poses = {side[0]: t for side, t in zip(self.sides, shares, strict=True)}, dict[int, Pose]()
        for path in self.paths:
            for k in reversed(path):
                link = self.links[k]
                t = share.get(link.value, 0)
                if (k, t) not in self.local:
                    ends = (low + width * t / (1 << DEEPEST) for v, low, width in self.sides if v == link.value)
                    self.local[k, t] = link.pose(next(ends, Fraction(0)))
                turn, shift = self.local[k, t]
                if k != path[-1]:
                    base, place = poses[link.above]
                    turn, shift = _product(base, turn), _sum(place, _apply(base, shift))
                poses[k] = turn, shift
        return poses


class _Checker:
    def __init__(self, model: bytes, proof: bytes, version: int = 1, claim: int = 1) -> None:
        reader, self.reader = _Reader(model, "model"), _Reader(proof, "proof")
        self.links, self.values = list[_Link](), list[tuple[str, float, float]]()
        for _ in range(reader.count(107, "links", most=MOST_LINKS)):
            self.links.append(_Link(reader, self.links))
        for _ in range(reader.count(18, "values")):
            self.values.append((reader.name(), *reader.take("2d")))
        if any(a != a or b != b for _, a, b in self.values) or any(x.value >= len(self.values) for x in self.links):
            raise Refused("A limit is not a number, or a link follows a value that does not exist.")
        self.bodies = [_Body(reader, self.links) for _ in range(reader.count(132, "bodies"))]
        self.apart, (self.margin,) = self.read_pairs(reader, 8, "pairs left out"), reader.doubles(1, "margin")
        self.margins = self.read_pairs(reader, 16, "margins")
        ruled = version > 1 and (claim != 3 or reader.at < len(model))
        rules = self.read_pairs(reader, 9, "rules") if ruled else {}
        self.version, self.rules = version, {pair: int(ends) for pair, ends in rules.items()}
        for pair, ends in self.rules.items():
            if not 0 < ends < 4 or not self.checked(pair):
                raise Refused(f"{_shown(*self.named(pair))}: a rule has the ends {ends}, or the pair is not checked.")
        reader.end()
        self.sizes = {"links": len(self.links), "values": len(self.values), "bodies": len(self.bodies)}
        self.sizes |= {"pieces": sum(len(x.pieces) for x in self.bodies), "pairs": 0, "planes": 0, "intervals": 0}
        self.work, self.motions = 0, list[tuple[int, bool, bool, int]]()
        self.points, self.deviations = list[list[list[float]]](), list[float]()
        self.last, self.balls = dict[Pair, tuple[bool, Whole]](), dict[Pair, list[Pair]]()
        self.tightest: Tightest | None = None
        self.common: Names | None = None
        self.contacts, self.told = dict[tuple[int, Pair], list[tuple[int, int, float]]](), list[Contact]()
        self.ranges = list[tuple[str, str, float, tuple[Range, ...]]]()

    def read_pairs(self, reader: _Reader, size: int, what: str) -> dict[Pair, float]:
        """Read pairs of bodies, each with its margin, or with the ends at which a rule allows contact."""
        pairs: dict[Pair, float] = {}
        for _ in range(reader.count(size, what)):
            i, j = reader.take("2I")
            if not i < j < len(self.bodies) or (i, j) in pairs:
                raise Refused(f"The pair {i}, {j} of bodies is out of order, does not exist or is named twice.")
            pairs[i, j] = reader.doubles(1, "margin")[0] if size > 9 else reader.take("B")[0] if size > 8 else 0
        return pairs

    def checked(self, pair: Pair) -> bool:
        return self.bodies[pair[0]].group != self.bodies[pair[1]].group and pair not in self.apart

    def read_contacts(self) -> None:
        """Read where pairs may be in contact; check that rules allow the contacts, and that joined motions agree."""
        before, listed, whole = (-1, 0, 0, 0), dict[tuple[int, Pair, int, int, float], None](), 1 << DEEPEST
        for _ in range(self.reader.count(22, "contacts")):
            (number, i, j, end, k), (least,) = self.reader.take("3I2B"), self.reader.doubles(1)
            key, pair = (number, i, j, end), (i, j)
            if key <= before or number >= len(self.points) or not self.rules.get(pair, 0) & end + 1:
                raise Refused(f"No rule allows bodies {i} and {j} a contact in motion {number}, or it is out of order.")
            if end > 1 or k >= DEEPEST or not least < self.margins.get(pair, self.margin):
                raise Refused(f"{_shown(*self.named(pair))}: a contact has the end {end}, 2^-{k} and {least!r} m.")
            contacts, before = self.contacts.setdefault((number, pair), []), key
            contacts.append((whole - (whole >> k), whole, least) if end else (0, whole >> k, least))
            listed[number, pair, end, k, least] = None
            if len(contacts) == 2 and contacts[0][1] > contacts[1][0]:
                raise Refused(f"{_shown(*self.named(pair))}: contacts in motion {number} overlap.")
            low, high = (Fraction(t, whole) for t in contacts[-1][:2])
            self.told.append((*self.named(pair), number, low, high, least))
        for number, pair, end, _, least in listed:  # if a motion joins, the contact must continue all along it
            other = number + 1 if end else number - 1
            first, last = sorted((number, other))
            joined = first >= 0 and last < len(self.points) and self.points[first][-1] == self.points[last][0]
            if joined and (other, pair, end, 0, least) not in listed:
                raise Refused(f"{_shown(*self.named(pair))}: contact does not go on in motion {other}.")

    def named(self, pair: Pair) -> Names:
        return self.bodies[pair[0]].name, self.bodies[pair[1]].name

    def spend(self, steps: int) -> None:
        self.work += steps
        if self.work > MOST_WORK:
            raise Refused("The proof takes more than 2^30 steps to check.")

    def common_point(self) -> None:
        places = [self.reader.take("6I") for _ in range(2)]
        terms = list(map(Fraction, self.reader.doubles(6)))
        world, pair = list(_sum(terms[:3], terms[3:])), (places[0][0], places[1][0])
        still = len(self.links) <= MOST_STILL and not any(link.kind for link in self.links)
        if pair[0] == pair[1] or max(pair) >= len(self.bodies) or not still:
            raise Refused("A common point needs two different bodies and a model of up to 100 links without joints.")
        for k, piece, *four in places:
            point, own = world, self.bodies[k].link
            for link in self.links[own].chain if own >= 0 else ():
                back = [link.rotation[3 * i + m] for m, i in EVERY]
                point = _moved(back, _sum(point, link.place, -1), (0, 0, 0))
            if piece >= len(self.bodies[k].pieces) or not self.bodies[k].contains(piece, tuple(four), point):
                raise Refused(f"The point is not shown to belong to {_shown(self.bodies[k].name)}.")
        self.common = self.named(pair)

    def run(self) -> None:
        motions, self.deviations = self.points, self.reader.doubles(len(self.values), "deviation")
        for number in range(self.reader.count(1, "motions", 1)):
            (degree,) = self.reader.take("B")
            if not 0 < degree <= MOST_DEGREE:
                raise Refused(f"Motion {number} has the degree {degree}.")
            self.spend(1000 * (degree + 1) + 100 * len(self.links) + len(self.bodies) ** 2 // 8)
            motions.append([self.reader.doubles(len(self.values)) for _ in range(degree + 1)])
        if self.version > 1:
            self.read_contacts()
        for number, points in enumerate(motions):
            motion, self.sizes["pairs"] = _Motion(number, points, self.links, self.deviations), 0
            for i, j in combinations(range(len(self.bodies)), 2):
                if self.checked((i, j)):
                    self.sizes["pairs"] += 1
                    self.tree(motion, (i, j))
            joined = number == 0 or points[0] == motions[number - 1][-1]
            inside = all(a <= x <= b for row in points for x, (_, a, b) in zip(row, self.values, strict=True))
            self.motions.append((len(points) - 1, joined, inside, len(motion.poses)))

    def run_ranges(self) -> None:
        before = (-1, -1)
        for number in range(self.reader.count(17, "pairs", 1)):
            pair, (margin,) = self.reader.take("2I"), self.reader.doubles(1, "margin")
            if not before < pair or not pair[0] < pair[1] < len(self.bodies):
                raise Refused(f"The pair {pair[0]}, {pair[1]} of bodies is out of order, or does not exist.")
            self.spend(2000 + 100 * len(self.links))
            paths, names = self.paths(*(self.bodies[k].link for k in pair)), _shown(*self.named(pair))
            between = [self.links[k] for path in paths for k in path if self.links[k].kind and self.links[k].by]
            ends = {value: self.reader.doubles(2) for value in sorted({link.value for link in between})}
            if any(low > high for low, high in ends.values()) or sum(a < b for a, b in ends.values()) > MOST_SIDES:
                raise Refused(f"{names}: a range ends before it begins, or more than {MOST_SIDES} ranges have a width.")
            self.tree(_Box(number, margin, paths, ends, self.links, len(self.values)), pair)
            before, ranges = pair, list[Range]()
            for value, (low, high) in ends.items():
                name, least, most = self.values[value]
                joints = [link for link in between if link.value == value]
                turn = max(link.by.denominator for link in joints) * 4 * (HALF_PI + 1)  # powers of two
                whole = all(link.kind == 1 for link in joints) and _down(Fraction(high) - Fraction(low), GUARD) >= turn
                ranges.append((name, low, high, whole or (low <= least and most <= high)))
            self.ranges.append((*self.named(pair), margin, tuple(ranges)))
        self.sizes |= {"pairs": len(self.ranges), "boxes": self.sizes.pop("intervals")}

    def paths(self, a: int, b: int) -> tuple[list[int], list[int]]:
        """Return the links from each of two links up to the common link, without the common link."""
        ups: tuple[list[int], list[int]] = ([], [])
        while a != b:  # a link comes after the link above it, so the later link is not the common link
            ups[a < b].append(max(a, b))
            a, b = (self.links[k].above if k == max(a, b) else k for k in (a, b))
        return ups

    def tree(self, motion: _Motion, pair: Pair) -> None:
        """Check that a tree proves two bodies apart; its leaves must cover all pieces and the whole interval or box."""
        sides = len(motion.sides) if isinstance(motion, _Box) else 0
        spans = [(0, 1 << DEEPEST), *((0, len(self.bodies[k].pieces)) for k in pair), *[(0, 1 << DEEPEST)] * sides]
        rest = [(spans, 0)]
        while rest:
            (spans, depth), (token,) = rest.pop(), self.reader.take("B")
            if token < 3:
                at = 3 + self.reader.take("B")[0] if token == 0 and isinstance(motion, _Box) else token
                if at >= len(spans):
                    raise Refused(f"{_shown(*self.named(pair))}: a box has no value {at - 3}.")
                low, high = spans[at]
                half = low + (high - low) // 2
                if depth == DEEPEST or half == low:
                    raise Refused(f"{_shown(*self.named(pair))}: a tree divides one piece, or is nested too deep.")
                rest += [([*spans[:at], x, *spans[at + 1 :]], depth + 1) for x in ((half, high), (low, half))]
                continue
            if 3 < token < 20:
                self.sizes["planes"] += 1
                normal = AXES[(token - 4) % 6] if token < 16 else self.reader.take("3h") if token < 18 else None
                self.last[pair] = token < 10 or token in (16, 18), _whole(normal or self.reader.doubles(3))
            if token > 19 or pair not in self.last or not any(self.last[pair][1]):
                raise Refused(f"{_shown(*self.named(pair))}: token {token} does not name a plane.")
            self.leaf(motion, pair, spans)

    def leaf(self, motion: _Motion, pair: Pair, spans: list[Pair]) -> None:
        """Check that the last plane of a pair proves some pieces apart in an interval or in a box."""
        (first, normal), (start, end) = self.last[pair], spans[0]
        (low, high), (some, others) = (pair, spans[1:3]) if first else (pair[::-1], spans[2:0:-1])
        below, above = self.bodies[low], self.bodies[high]
        exact = [sum(a * b for a, b in zip(below.whole[k : k + 3], normal, strict=True)) for k in (0, 3, 6)]
        shift = BITS + 16 - max(map(abs, exact)).bit_length()  # M N may be scaled and rounded
        n = tuple(x << shift if shift > 0 else x >> -shift for x in exact)
        count = 100 + sum(b.counts[k[1]] - b.counts[k[0]] for b, k in ((below, some), (above, others)))
        self.spend(count)
        places: Iterable[tuple[Pose, Pose]]
        if isinstance(motion, _Box):
            places = self.corners(motion, spans[3:], below.link, above.link, count)
        else:
            places = [(self.poses(motion, t)[below.link], self.poses(motion, t)[above.link]) for t in (start, end)]
        gaps, norm = list[int](), _norm_up(n)
        for (turn, place), (other, there) in places:
            a, b, c = n if below.link < 0 else _apply(turn, n)
            away = (-a, -b, -c) if above.link < 0 else _apply(_transposed(other), (-a, -b, -c))
            x, y, z = _sum(there, place, -1)
            gaps.append(a * x + b * y + c * z - above.support(others, away, norm))
        depth = 1 + max((len(self.links[k].chain) for k in (below.link, above.link) if k >= 0), default=0)
        length = max(motion.lengths[below.link], motion.lengths[above.link])
        size = 2 * max(below.size, above.size) + 4 * length + 3 * ONE
        slack = (TURN * depth * size >> BITS) + 1 + below.fuzz + above.fuzz
        margin = motion.margin if isinstance(motion, _Box) else self.margins.get(pair, self.margin)
        for opens, closes, least in self.contacts.get((motion.number, pair), ()):
            margin = least if opens <= start and end <= closes else margin
        if isinstance(motion, _Box):
            needed = _up(margin) + self.bent(motion, spans[3:], below.link, high)
        else:
            bend, stray = self.bound(motion, below.link, high)
            needed = _up(margin) + stray - (-bend * (end - start) ** 2 >> 2 * DEEPEST + 3)
        gap = min(gaps) - below.support(some, n, norm) - (norm + ONE) * slack  # |n| times the gap, and |n| > norm - 2
        spare = gap // (norm if gap > 0 else norm - 2) - needed
        since, until = (Fraction(t, 1 << DEEPEST) for t in spans[0])
        if spare <= 0:
            where = f"for motion {motion.number}, t in [{since}, {until}], fails by"
            if isinstance(motion, _Box):
                ends = [f"[{a / 2**DEEPEST:.6g}, {b / 2**DEEPEST:.6g}]" for a, b in spans[3:]]
                where = f"for the shares {' x '.join(ends)} of the ranges fails by"
            raise Refused(f"{_shown(*self.named(pair))}: the plane {where} {(-spare * 10**6 >> BITS) / 1000:.3f} mm.")
        if self.tightest is None or self.tightest[-1] > Fraction(spare, ONE):
            self.tightest = *self.named(pair), motion.number, since, until, margin, Fraction(spare, ONE)
        self.sizes["intervals"] += 1

    def corners(self, box: _Box, sides: list[Pair], low: int, high: int, steps: int) -> Iterable[tuple[Pose, Pose]]:
        """Yield the poses of two links, in the frame of the common link, at all corners of a part of a box."""
        ends = [side if width else side[:1] for side, (_, _, width) in zip(sides, box.sides, strict=True)]
        for shares in product(*ends):
            old_count = len(box.local)
            poses = box.at(shares)
            self.spend(steps + 50 * sum(map(len, box.paths)) + 2000 * (len(box.local) - old_count))
            yield poses.get(low, STILL), poses.get(high, STILL)

    def bent(self, box: _Box, sides: list[Pair], below: int, high: int) -> int:
        """Return the sum of B_c (2 h_c)^2 / 8 over a part's sides, for a body seen from a link, rounded up."""
        if (below, high) not in box.bends:
            joints, bends = self.moving(box, below, high), list[int]()
            for value, _, _ in box.sides:
                bend = before = 0
                for k, turns, reach in joints:
                    if self.links[k].value == value:
                        by = _up(abs(self.links[k].by))
                        bend -= -reach * -(-by * (2 * before + turns * by) >> BITS) >> BITS
                        before += turns * by
                bends.append(bend)
            box.bends[below, high] = bends
        total = 0
        for bend, (start, end), (_, _, width) in zip(box.bends[below, high], sides, box.sides, strict=True):
            total -= -bend * _up(width) ** 2 * (end - start) ** 2 >> 2 * BITS + 2 * DEEPEST + 3
        return total

    def poses(self, motion: _Motion, t: int) -> list[Pose]:
        """Return the poses of all links and, last, of the world (number -1); de Casteljau's scheme gives the values."""
        if t in motion.poses:
            return motion.poses[t]
        share, values, poses, count = Fraction(t, 1 << DEEPEST), [], list[Pose](), len(motion.points)
        self.spend(2000 * len(self.links) + len(motion.columns) * count**2 * (8 + count))
        for column in motion.columns:
            while len(column) > 1:
                column = [a + share * (b - a) for a, b in pairwise(column)]
            values.append(column[0])
        for link in self.links:
            turn, shift = link.pose(values[link.value] if link.kind else Fraction(0))
            if link.above >= 0:
                base, place = poses[link.above]
                turn, shift = _product(base, turn), _sum(place, _apply(base, shift))
            poses.append((turn, shift))
        motion.poses[t] = [*poses, STILL]
        return motion.poses[t]

    def moving(self, motion: _Motion, below: int, high: int) -> list[tuple[int, bool, int]]:
        """Return the joints between a link and a body: link, whether it turns, and R_j or the length of the axis."""
        key, above, center = (below, high), self.bodies[high].link, self.bodies[high].center
        if key not in self.balls:  # links in between, body first, and the body's reach about each, without slides
            up, down = self.paths(above, below)
            self.balls[key], radius = [], self.bodies[high].radius
            self.spend(100 * len(up + down))
            for k, upward in [*((k, True) for k in up), *((k, False) for k in reversed(down))]:
                center, radius = self.links[k].pass_ball(center, radius, upward)
                self.balls[key].append((k, radius))
        joints, slides = list[tuple[int, bool, int]](), 0
        for k, reach in self.balls[key]:
            kind, norm = self.links[k].kind, self.links[k].axis_norm
            if kind:
                joints.append((k, kind == 1, reach + slides if kind == 1 else norm))
            slides += -(-norm * motion.rates[k][3] >> BITS) if kind == 2 else 0
        return joints[::-1]

    def bound(self, motion: _Motion, below: int, high: int) -> Pair:  # the bounds A and V for a body seen from a link
        key = (below, high)
        if key not in motion.bounds:
            before, a, v = 0, 0, 0
            for k, turns, reach in self.moving(motion, below, high):
                rate, bend, stray, _ = motion.rates[k]
                a -= -reach * (bend - (-rate * (2 * before + turns * rate) >> BITS)) >> BITS
                v -= -reach * stray >> BITS
                before += turns * rate
            motion.bounds[key] = a, v
        return motion.bounds[key]


def verify(data: bytes) -> Report:
    """Check a proof; raise `Refused` if the file is not a proof.

    Parameters
    ----------
    data : bytes
        The contents of the file.

    Returns
    -------
    Report

    Examples
    --------
    >>> from loewner.verify import verify
    >>> verify(b"nothing")
    Traceback (most recent call last):
    loewner.verify.Refused: This is not a proof file: it does not start with LOEWNERP.
    """
    if not isinstance(data, (bytes, bytearray)):
        raise TypeError(f"data: expected the bytes of a file, found {type(data).__name__}")
    if data[:8] != b"LOEWNERP":
        raise Refused("This is not a proof file: it does not start with LOEWNERP.")
    if not 56 <= len(data) <= MOST_BYTES:
        raise Refused(f"The file has {len(data)} bytes; a proof has 56 to {MOST_BYTES}.")
    version, claim, size, rest = struct.unpack_from("<4I", data, 8)
    if (version, claim) not in ((1, 1), (1, 2), (2, 1), (2, 3)):
        raise Refused(
            f"The file has version {version}, claim {claim}; this program reads version 1, claims 1 and 2, and "
            "version 2, claims 1 and 3."
        )
    if len(data) != 56 + size + rest:
        raise Refused(f"The file is truncated or extended: it has {len(data)} bytes instead of {56 + size + rest}.")
    if hashlib.sha256(data[:-32]).digest() != data[-32:]:
        raise Refused("The file is damaged: its hash is wrong.")
    checker = _Checker(data[24 : 24 + size], data[24 + size : -32], version, claim)
    (checker.run, checker.common_point, checker.run_ranges)[claim - 1]()
    checker.reader.end()
    return Report(
        hashlib.sha256(data[24 : 24 + size]).hexdigest(), checker.sizes, (checker.margin, len(checker.margins)),
        tuple(map(checker.named, checker.apart)), tuple(body.name for body in checker.bodies if body.inside),
        tuple((name, x) for (name, *_), x in zip(checker.values, checker.deviations, strict=False)),
        tuple(tuple(map(tuple, x)) for x in checker.points), tuple(checker.motions), checker.tightest, checker.common,
        tuple((*checker.named(pair), ends) for pair, ends in checker.rules.items()), tuple(checker.told),
        tuple(checker.ranges),
    )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Check a file and print its claim; return 0 if bodies are proven free, 2 if the file is unreadable, else 1."""
    parser = argparse.ArgumentParser(description="Check a proof: motions, ranges or bodies are free, or two collide.")
    parser.add_argument("file", type=Path)
    path = parser.parse_args(argv).file
    try:
        with path.open("rb") as file:
            report = verify(file.read(MOST_BYTES + 1))
    except (OSError, Refused) as error:
        print(f"refused: {error}" if isinstance(error, Refused) else f"cannot read {path}: {error}", file=sys.stderr)
        return 1 if isinstance(error, Refused) else 2
    try:
        code = sys.stdout.encoding or "utf-8"
        print(f"{report}\nverified".encode(code, "backslashreplace").decode(code), flush=True)
    except BrokenPipeError:  # the reader is gone, and Python would fail again when it closes standard output
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1 if report.common else 0


if __name__ == "__main__":
    sys.exit(main())
