"""Check a file that proves motions free of collisions, in whole numbers and fractions, without the rest of the library.

This file needs only Python's standard library, and runs by itself: ``python verify.py plan.proof``. The page
docs/proof-format.md describes the files and shows why a file that passes is a proof. Lengths, sines and matrices are
whole numbers of units of 2^-72. Here matrices are measured by the root of the sum of squares and vectors by their norm;
errors are in units, and the lengths that multiply them in metres.

- A double, a fixed rotation and an axis are rounded by less than 1 in each entry, a sine or cosine by less than 2: 1/10
  for the angle, 1/1000 for the series, 1 for the result. In a joint's rotation c + s e + (1 - c) e e the terms have
  errors below 2, 3 and 4 in each entry, and 1 for the sum, so the matrix has an error below 30. Products with the fixed
  rotation and with the parent's make this 41 for each link of the chain: ``TURN``.
- A link is at its parent's place plus a step of the length l, turned. The step has an error below 3 l + 8, the parent's
  rotation adds its error times l, and rounding adds 2. With E = TURN (links of the chain + 1) and the chain's length L
  the error is at most E (L + 1).
- A plane's normal n is exact, since any vector will do. In the other body's frame it has an error of 2 E |n| + 5. So a
  gap has an error of (|n| + 1) E (2 X + 4 L + 3) at most, where X is the size of the bodies, and |n| times the errors of
  the placed points of both bodies, which are ``_Body.fuzz`` at most.
"""

import argparse
import hashlib
import struct
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, pairwise
from math import isqrt
from pathlib import Path

__all__ = ["Refused", "Report", "main", "verify"]

BITS = 72  # lengths, sines and entries of matrices are multiples of 2^-BITS
ONE = 1 << BITS
GUARD = BITS + 24  # angles and the series of their sines are multiples of 2^-GUARD
HALF_PI = 0x3243F6A8885A308D313198A2E03707344A4093822299F31D >> 189 - GUARD
TURN = 64  # error of a rotation for each link of its chain; derived: 41
DEEPEST = 64  # a tree is nested this deep at most, so intervals end at multiples of 2^-DEEPEST
MOST_LINKS, MOST_BYTES = 1000, 1 << 26  # links above each other; bytes of a file
MOST_WORK = 1 << 30  # products of a point and a normal, and other steps of a third of a microsecond

Whole = tuple[int, ...]  # vectors have 3 entries, matrices 9, by rows
Exact = Sequence[float | Fraction]
Pair = tuple[int, int]
Part = tuple[int, int, list[Whole], Whole]  # of a piece: kind, radius, points or a center, and matrix of kinds 1 to 3
AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1))


class Refused(Exception):
    """A file that is not a proof, with the reason."""


@dataclass(frozen=True)
class Report:
    """Contents of a file that was verified.

    Attributes
    ----------
    model : str
        SHA-256 of the model.
    sizes : dict of str to int
        Numbers of links, values, bodies, pieces, pairs that are proven apart, planes, and intervals of pairs.
    left_out : tuple of (str, str)
        Pairs that the model exempts.
    uncovered : tuple of str
        Bodies with an interior that their pieces do not cover: the proof is about their surfaces.
    deviations : dict of str to float
        Values that may deviate from the motions, and by how much.
    motions : tuple of (int, bool, bool, int)
        For each motion its degree, whether it starts where the one before ends, whether its control points are within
        the limits of the values, and the number of its configurations at which planes were checked.
    tightest : (str, str, int, Fraction, Fraction, Fraction) or None
        The check with the least to spare: two bodies, a motion, an interval of it, and the length by which the gap
        exceeds what the margin, the interval and rounding require.
    common : (str, str) or None
        Two bodies with a common point, if this is what the file proves.
    """

    model: str
    sizes: dict[str, int]
    left_out: tuple[tuple[str, str], ...]
    uncovered: tuple[str, ...]
    deviations: dict[str, float]
    motions: tuple[tuple[int, bool, bool, int], ...]
    tightest: tuple[str, str, int, Fraction, Fraction, Fraction] | None
    common: tuple[str, str] | None


# Numbers. Doubles are only compared and converted.


def _down(x: float | Fraction, bits: int = BITS) -> int:
    """Multiply by 2^bits and round down."""
    n, d = x.as_integer_ratio()
    return (n << bits) // d


def _up(x: float | Fraction) -> int:
    return -_down(-x)


def _all_down(numbers: Iterable[float | Fraction]) -> Whole:
    return tuple(map(_down, numbers))


def _times_up(a: int, b: int) -> int:
    return -(-a * b >> BITS)


def _norm_up(entries: Whole) -> int:
    return isqrt(sum(x * x for x in entries)) + 1


def _apply(m: Whole, v: Whole) -> Whole:
    a, b, c, d, e, f, g, h, i = m
    x, y, z = v
    return a * x + b * y + c * z >> BITS, d * x + e * y + f * z >> BITS, g * x + h * y + i * z >> BITS


def _sum(v: Whole, w: Whole, sign: int = 1) -> Whole:
    return v[0] + sign * w[0], v[1] + sign * w[1], v[2] + sign * w[2]


def _transposed(m: Whole) -> Whole:
    return m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]


def _product(a: Whole, b: Whole) -> Whole:
    return _transposed(tuple(x for k in range(3) for x in _apply(a, b[k::3])))


def _rounding(c: Whole) -> int:
    """Bound twice the error of a turned or projected vector: 3 |c| for the matrix, 2 for rounding, 2 for a shift."""
    return 8 + (8 * _norm_up(c) >> BITS)


def _series(term: int, square: int, n: int) -> int:
    """Sum term (1 - square / ((n+1) (n+2)) + ...) to a term of 0; the rest is less, as terms alternate and decrease."""
    total, sign = 0, 1
    while term:
        total += sign * term
        term, sign, n = (term * square >> GUARD) // ((n + 1) * (n + 2)), -sign, n + 2
    return total >> GUARD - BITS


def _cos_sin(angle: int) -> Pair:
    """Cosine and sine, in units, of an angle in multiples of 2^-GUARD."""
    quarters = (2 * angle + HALF_PI) // (2 * HALF_PI)
    rest = angle - quarters * HALF_PI
    square = rest * rest >> GUARD
    c, s = _series(1 << GUARD, square, 0), _series(abs(rest), square, 1) * (-1 if rest < 0 else 1)
    return ((c, s), (-s, c), (-c, -s), (s, -c))[quarters % 4]


def _shown(*names: str) -> str:
    return " and ".join(name if name.isprintable() else ascii(name) for name in names)


class _Reader:
    """Numbers of a part of the file, each checked to be there."""

    def __init__(self, data: bytes, part: str) -> None:
        self.data, self.part, self.at = data, part, 0

    def bytes(self, size: int) -> bytes:
        self.at += size
        if self.at > len(self.data):
            raise Refused(f"The {self.part} ends too early.")
        return self.data[self.at - size : self.at]

    def take(self, form: str) -> Whole:
        return struct.unpack("<" + form, self.bytes(struct.calcsize("<" + form)))

    def count(self, size: int, what: str, least: int = 0) -> int:
        """Read how many things of at least `size` bytes follow."""
        (number,) = self.take("I")
        if number < least or number * size > len(self.data) - self.at:
            raise Refused(f"The {self.part} cannot have {number} {what} at byte {self.at - 4}.")
        return number

    def doubles(self, number: int, what: str = "") -> list[float]:
        """Read doubles that are finite and not huge, and not negative if they have a name."""
        found = struct.unpack(f"<{number}d", self.bytes(8 * number))
        if not all((0 if what else -(2**32)) <= x < 2**32 for x in found):
            raise Refused(f"A {what or 'number'} of the {self.part} is not finite, too large or negative.")
        return list(found)

    def name(self) -> str:
        try:
            return self.bytes(*self.take("H")).decode()
        except UnicodeDecodeError:
            raise Refused(f"A name before byte {self.at} of the {self.part} is not UTF-8.") from None

    def end(self) -> None:
        if self.at != len(self.data):
            raise Refused(f"The {self.part} has {len(self.data) - self.at} bytes too many.")


class _Link:
    """A link: its exact fixed pose, and in units this pose and the axis of the joint that moves it."""

    def __init__(self, reader: _Reader, links: "list[_Link]") -> None:
        name = _shown(reader.name())
        self.above, self.kind, self.value = reader.take("iBi")
        self.by, self.off, w, x, y, z, *place = map(Fraction, reader.doubles(12))
        self.place, self.axis = place[:3], place[3:]
        self.square, size = sum(n * n for n in self.axis), w * w + x * x + y * y + z * z
        if not -1 <= self.above < len(links):
            raise Refused(f"Link {name} must be below the world or an earlier link, found {self.above}.")
        if self.kind > 2 or (self.value != -1 if self.kind == 0 else self.value < 0):
            raise Refused(f"Link {name} has kind {self.kind} and value {self.value}, which do not go together.")
        if size == 0 or (self.kind == 1 and self.square == 0):
            raise Refused(f"Link {name} has the quaternion 0, or turns about the axis 0.")
        base = links[self.above] if self.above >= 0 else None
        self.depth: int = base.depth + 1 if base else 1
        if self.depth > MOST_LINKS:
            raise Refused(f"More than {MOST_LINKS} links are above each other.")
        self.group: int = base.group if base and not self.kind else len(links)
        rows = [size - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
        rows += [2 * (x * y + w * z), size - 2 * (x * x + z * z), 2 * (y * z - w * x)]
        rows += [2 * (x * z - w * y), 2 * (y * z + w * x), size - 2 * (x * x + y * y)]
        self.rotation = [x / size for x in rows]
        self.turn, self.shift = _all_down(self.rotation), _all_down(self.place)
        self.reach, self.axis_norm = _norm_up(self.shift) + 2, _norm_up(_all_down(self.axis)) + 2
        self.unit, self.outer = [], ()
        if self.kind == 1:
            self.unit = [isqrt(_down(n * n / self.square, 2 * BITS)) * (-1 if n < 0 else 1) for n in self.axis]
            self.outer = _all_down(m * n / self.square for m in self.axis for n in self.axis)

    def pose(self, values: list[Fraction]) -> tuple[Whole, Whole]:
        """Pose in the frame of the link above."""
        if not self.kind:
            return self.turn, self.shift
        v = self.by * values[self.value] + self.off
        if self.kind == 2:
            return self.turn, _sum(self.shift, _apply(self.turn, _all_down(v * n for n in self.axis)))
        c, s = _cos_sin(_down(v, GUARD))
        x, y, z = (s * n for n in self.unit)
        cross = (c << BITS, -z, y, z, c << BITS, -x, -y, x, c << BITS)
        turned = tuple((ONE - c) * m + n >> BITS for m, n in zip(self.outer, cross, strict=True))
        return _product(self.turn, turned), self.shift

    def pass_ball(self, c: Whole, radius: int, upward: bool) -> tuple[Whole, int, int]:
        """Carry a ball past the joint; return its center, its radius, and the radius about the axis."""
        if not upward:
            c = _apply(_transposed(self.turn), _sum(c, self.shift, -1))
            radius += _rounding(c)
        if self.kind == 1:
            foot = _apply(self.outer, c)
            radius += _norm_up(_sum(c, foot, -1)) + _rounding(c)
            c = foot
        if not upward:
            return c, radius, radius
        return _sum(self.shift, _apply(self.turn, c)), radius + _rounding(c), radius


class _Body:
    """A body: what the file has, and its pieces in units in the frame of its link.

    The error of a placed point, and of a matrix times its radius, is at most `fuzz`. The ball contains the body.
    """

    def __init__(self, reader: _Reader, links: int) -> None:
        self.name, (self.link, self.inside) = reader.name(), reader.take("iB")
        if not -1 <= self.link < links or self.inside > 1:
            raise Refused(f"Body {_shown(self.name)} has the link {self.link} and the mark {self.inside}.")
        self.turn, self.place = reader.doubles(9), reader.doubles(3)
        self.matrix, self.shift, self.largest = _all_down(self.turn), _all_down(self.place), ONE
        self.kinds: list[tuple[int, float, list[float]]] = []
        self.pieces: list[list[Part]] = []
        self.counts = [0]
        for _ in range(reader.count(37, "pieces", 1)):
            (kind,), (radius,) = reader.take("B"), reader.doubles(1, "radius")
            if kind > 4:
                raise Refused(f"Kinds of pieces are 0 to 4, found {kind}.")
            width = (3, 12, 12, 12, 4)[kind]
            self.kinds.append(
                (kind, radius, reader.doubles(width * (reader.count(8 * width, "points", 1) if width < 12 else 1)))
            )
            self.pieces.append(self.placed(*self.kinds[-1], width))
            self.counts.append(self.counts[-1] + len(self.kinds[-1][2]) // width + 5)
        # Matrices and points are rounded by 1 in each entry: 3 |y| + 2 |M| + 4 for M y + s, and as much for M G.
        self.fuzz = (10 * (self.largest + _norm_up(self.matrix)) >> BITS) + 1
        # A ball has the norm of the matrix as its radius, √2 times this for kinds 2 and 3.
        parts = (part for piece in self.pieces for part in piece)
        balls = [(r + (_norm_up(g * min(kind, 2)) if g else 0), points) for kind, r, points, g in parts]
        low = [min(min(point[k] for point in points) - r for r, points in balls) for k in range(3)]
        high = [max(max(point[k] for point in points) + r for r, points in balls) for k in range(3)]
        self.center = x, y, z = tuple((a + b) // 2 for a, b in zip(low, high, strict=True))
        squares = ((r, max((a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2 for a, b, c in points)) for r, points in balls)
        self.radius = self.fuzz + max(isqrt(square) + 1 + r for r, square in squares)
        self.size = _norm_up(self.center) + self.radius

    def placed(self, kind: int, radius: float, numbers: list[float], width: int) -> list[Part]:
        """Place a piece; points with the same radius are one part."""
        found: dict[int, list[Whole]] = {}
        for k in range(0, len(numbers), width):
            if kind == 4 and numbers[k + 3] < 0:
                raise Refused("A ball has a negative radius.")
            y = _all_down(numbers[k : k + 3])
            r = _up(radius) + (_up(numbers[k + 3]) if kind == 4 else 0)
            found.setdefault(r, []).append(_sum(self.shift, _apply(self.matrix, y)))
            self.largest = max(self.largest, abs(y[0]) + abs(y[1]) + abs(y[2]) + ONE)
        g = _all_down(numbers[3:]) if width == 12 else ()
        self.largest = max(self.largest, _norm_up(g) + ONE)
        return [(kind, r, points, _product(self.matrix, g) if g else g) for r, points in found.items()]

    def support(self, part: Pair, n: Whole, norm: int) -> int:
        """Largest product of n, which is not longer than `norm`, with a point of some pieces, rounded up."""
        (a, b, c), found = n, []
        for piece in self.pieces[part[0] : part[1]]:
            for kind, radius, points, g in piece:
                found.append(max([a * x + b * y + c * z for x, y, z in points]) + norm * radius)
                if g:
                    u, v, w = (g[k] * a + g[k + 3] * b + g[k + 6] * c for k in range(3))
                    rim = isqrt(u * u + v * v) + 1
                    found[-1] += _norm_up((u, v, w)) if kind == 1 else rim + abs(w) if kind == 2 else max(w, rim - w)
        return max(found)


class _Model:
    """The model of a file."""

    def __init__(self, data: bytes) -> None:
        reader, self.links, self.values = _Reader(data, "model"), list[_Link](), list[tuple[str, float, float]]()
        for _ in range(reader.count(107, "links")):
            self.links.append(_Link(reader, self.links))
        for _ in range(reader.count(18, "values")):
            name, (low, high) = reader.name(), struct.unpack("<2d", reader.bytes(16))
            if low != low or high != high:
                raise Refused(f"A limit of value {_shown(name)} is not a number.")
            self.values.append((name, low, high))
        if any(link.value >= len(self.values) for link in self.links):
            raise Refused(f"A link follows a value that is not one of the {len(self.values)} of the model.")
        self.bodies = [_Body(reader, len(self.links)) for _ in range(reader.count(132, "bodies"))]
        self.apart = self.pairs(reader, 8, "pairs not to be checked")
        self.margin = reader.doubles(1, "margin")[0]
        self.margins = self.pairs(reader, 16, "margins")
        reader.end()
        self.groups = [self.links[body.link].group if body.link >= 0 else -1 for body in self.bodies]

    def pairs(self, reader: _Reader, size: int, what: str) -> dict[Pair, float]:
        """Read pairs of bodies, and a margin of each if this belongs to the list."""
        found: dict[Pair, float] = {}
        for _ in range(reader.count(size, what)):
            i, j = reader.take("2I")
            if not i < j < len(self.bodies) or (i, j) in found:
                raise Refused(f"The pair {i}, {j} of bodies is out of order, does not exist or is named twice.")
            found[i, j] = reader.doubles(1, "margin")[0] if size > 8 else 0
        return found

    def named(self, pair: Pair) -> tuple[str, str]:
        return self.bodies[pair[0]].name, self.bodies[pair[1]].name


class _Motion:
    """A motion: its control points, and bounds for each link."""

    def __init__(self, number: int, points: list[list[float]], model: _Model, deviations: list[float]) -> None:
        self.number, self.points, degree = number, points, len(points) - 1
        self.columns = [list(map(Fraction, column)) for column in zip(*points, strict=True)]
        self.poses: dict[int, list[tuple[Whole, Whole]]] = {}
        self.bounds: dict[Pair, Pair] = {}
        self.rates: list[Whole] = []  # w, w', |m| times the deviation, and the largest value
        self.lengths: list[int] = []  # of the chain of each link, with slides; at the end, as number -1, of the world
        for link in model.links:
            rate = bend = stray = far = Fraction(0)
            if link.kind:
                first = [b - a for a, b in pairwise(self.columns[link.value])]
                second = max((abs(b - a) for a, b in pairwise(first)), default=Fraction(0))
                rate, bend = (abs(link.by) * x * degree for x in (max(map(abs, first)), second * (degree - 1)))
                stray = abs(link.by) * Fraction(deviations[link.value])
                far = max(abs(link.by * x + link.off) for x in self.columns[link.value])
                if link.kind == 1 and far > 10**6:
                    raise Refused(f"Motion {number} turns a joint beyond 1e6 rad.")
            self.rates.append((_up(rate), _up(bend), _up(stray), _up(far + stray)))
            slide = _times_up(link.axis_norm, self.rates[-1][3]) if link.kind == 2 else 0
            self.lengths.append((self.lengths[link.above] if link.above >= 0 else 0) + link.reach + slide)
        self.lengths.append(0)


class _Checker:
    """The proof of a model's motions."""

    def __init__(self, model: _Model, data: bytes) -> None:
        self.model, self.reader = model, _Reader(data, "proof")
        self.deviations = self.reader.doubles(len(model.values), "deviation")
        self.work = self.planes = self.intervals = 0
        self.last: dict[Pair, tuple[bool, Whole]] = {}
        self.balls: dict[Pair, list[Pair]] = {}
        self.tightest: tuple[int, Pair, int, Pair] | None = None

    def spend(self, steps: int) -> None:
        self.work += steps
        if self.work > MOST_WORK:
            raise Refused("The proof takes more than 2^30 steps to check.")

    def run(self) -> tuple[int, tuple[tuple[int, bool, bool, int], ...]]:
        """Check the whole proof; return the number of pairs, and a report for each motion."""
        model, motions, reports = self.model, list[_Motion](), []
        for number in range(self.reader.count(1, "motions")):
            (degree,) = self.reader.take("B")
            if degree == 0:
                raise Refused(f"Motion {number} has the degree 0.")
            points = [self.reader.doubles(len(model.values)) for _ in range(degree + 1)]
            motions.append(_Motion(number, points, model, self.deviations))
        self.spend(len(model.bodies) ** 2 // 8)
        every = combinations(range(len(model.bodies)), 2)
        pairs = [(i, j) for i, j in every if model.groups[i] != model.groups[j] and (i, j) not in model.apart]
        for motion in motions:
            for pair in pairs:
                self.tree(motion, pair)
            points = motion.points
            joined = not motion.number or points[0] == motions[motion.number - 1].points[-1]
            inside = all(a <= x <= b for row in points for x, (_, a, b) in zip(row, model.values, strict=True))
            reports.append((len(points) - 1, joined, inside, len(motion.poses)))
            motion.poses.clear()
        self.reader.end()
        return len(pairs), tuple(reports)

    def tree(self, motion: _Motion, pair: Pair) -> None:
        """Check that a tree proves two bodies apart. Its parts cover the interval and all pieces by construction."""
        rest = [([(0, 1 << DEEPEST), *((0, len(self.model.bodies[k].pieces)) for k in pair)], 0)]
        while rest:
            spans, depth = rest.pop()
            (token,) = self.reader.take("B")
            if token > 2:
                self.leaf(motion, pair, self.plane(token, pair), spans)
                continue
            low, high = spans[token]
            half = low + (high - low) // 2
            if depth == DEEPEST or half == low:
                raise Refused(f"{_shown(*self.model.named(pair))}: a tree divides one piece, or is nested too deep.")
            rest += [([*spans[:token], part, *spans[token + 1 :]], depth + 1) for part in ((half, high), (low, half))]

    def plane(self, token: int, pair: Pair) -> tuple[bool, Whole]:
        """Read a plane: whether it is in the frame of the first body, and its normal N."""
        if 3 < token < 18:
            self.planes += 1
            normal = self.reader.take("3h") if token > 15 else AXES[(token - 4) % 6]
            self.last[pair] = token < 10 or token == 16, normal
        if token > 17 or pair not in self.last or not any(self.last[pair][1]):
            raise Refused(f"{_shown(*self.model.named(pair))}: token {token} does not name a plane.")
        return self.last[pair]

    def leaf(self, motion: _Motion, pair: Pair, plane: tuple[bool, Whole], spans: list[Pair]) -> None:
        """Check that a plane proves some pieces of two bodies apart in an interval."""
        model, (start, end), order = self.model, spans[0], (0, 1) if plane[0] else (1, 0)
        below, above = (model.bodies[pair[k]] for k in order)
        some, others = (spans[1 + k] for k in order)
        n = _apply(below.matrix, tuple(x << BITS for x in plane[1]))
        norm = _norm_up(n)
        least = min(self.least(motion, t, below.link, above, others, n, norm) for t in (start, end))
        bend, stray = self.bound(motion, below.link, pair[order[1]])
        depth = 1 + max((model.links[k].depth for k in (below.link, above.link) if k >= 0), default=0)
        length = max(motion.lengths[below.link], motion.lengths[above.link])
        size = 2 * max(below.size, above.size) + 4 * length + 3 * ONE
        slack = (TURN * depth * size >> BITS) + 1 + below.fuzz + above.fuzz
        needed = _up(model.margins.get(pair, model.margin)) + stray - (-bend * (end - start) ** 2 >> 2 * DEEPEST + 3)
        spare = least - below.support(some, n, norm) - (norm + ONE) * slack - norm * needed
        if spare <= 0:
            where = f"motion {motion.number} from {Fraction(start, 1 << DEEPEST)} to {Fraction(end, 1 << DEEPEST)}"
            lack = -(spare * 10**6 // norm >> BITS)
            raise Refused(f"{_shown(*model.named(pair))}: the gap of a plane for {where} is {lack} micrometres short.")
        if self.tightest is None or spare // norm < self.tightest[0]:
            self.tightest = spare // norm, pair, motion.number, spans[0]
        self.intervals += 1
        self.spend(100 + sum(b.counts[part[1]] - b.counts[part[0]] for b, part in ((below, some), (above, others))))

    def least(self, motion: _Motion, t: int, link: int, above: _Body, part: Pair, n: Whole, norm: int) -> int:
        """Least product of a normal in a link's frame with a point of another body's pieces, relative to the link."""
        if t not in motion.poses:
            motion.poses[t] = self.place(motion, t)
        (turn, place), (other, there) = motion.poses[t][link], motion.poses[t][above.link]
        a, b, c = n if link < 0 else _apply(turn, n)
        away = (-a, -b, -c) if above.link < 0 else _apply(_transposed(other), (-a, -b, -c))
        x, y, z = _sum(there, place, -1)
        return a * x + b * y + c * z - above.support(part, away, norm)

    def place(self, motion: _Motion, t: int) -> list[tuple[Whole, Whole]]:
        """Poses of all links, and at the end, as number -1, of the world. Values come from de Casteljau's scheme."""
        share, values, found, count = Fraction(t, 1 << DEEPEST), [], list[tuple[Whole, Whole]](), len(motion.points)
        self.spend(2000 * len(self.model.links) + len(motion.columns) * count**2 * (8 + count))
        for column in motion.columns:
            while len(column) > 1:
                column = [a + share * (b - a) for a, b in pairwise(column)]
            values.append(column[0])
        for link in self.model.links:
            turn, shift = link.pose(values)
            if link.above >= 0:
                base, place = found[link.above]
                turn, shift = _product(base, turn), _sum(place, _apply(base, shift))
            found.append((turn, shift))
        return [*found, ((ONE, 0, 0, 0, ONE, 0, 0, 0, ONE), (0, 0, 0))]

    def bound(self, motion: _Motion, link: int, high: int) -> Pair:
        """A and V of a body seen from a link, rounded up."""
        if (link, high) not in motion.bounds:
            slides, moving = 0, list[Whole]()
            if (link, high) not in self.balls:
                self.balls[link, high] = self.passed(self.model.bodies[high], link)
            for k, reach in self.balls[link, high]:
                (rate, *rest, far), kind, axis = (
                    motion.rates[k],
                    self.model.links[k].kind,
                    self.model.links[k].axis_norm,
                )
                if kind:
                    moving.append((reach + slides, rate, rate, *rest) if kind == 1 else (axis, 0, rate, *rest))
                slides += _times_up(axis, far) if kind == 2 else 0
            before = a = v = 0
            for reach, turn, rate, bend, stray in reversed(moving):
                a += _times_up(reach, _times_up(rate, 2 * before + turn) + bend)
                v += _times_up(reach, stray)
                before += turn
            motion.bounds[link, high] = a, v
        return motion.bounds[link, high]

    def passed(self, body: _Body, below: int) -> list[Pair]:
        """Links between a body and another link, from the body on, and the body's reach about them without slides."""
        links, above, center, radius = self.model.links, body.link, body.center, body.radius
        up, down, found = list[tuple[int, bool]](), list[tuple[int, bool]](), []
        while above != below:  # a link comes after the one above it, so the later of two is not the common one
            if above > below:
                up.append((above, True))
                above = links[above].above
            else:
                down.append((below, False))
                below = links[below].above
        self.spend(100 * len(up + down))
        for k, upward in up + down[::-1]:
            center, radius, reach = links[k].pass_ball(center, radius, upward)
            found.append((k, reach))
        return found


# A common point, in fractions.


def _moved(m: Exact, v: Exact, shift: Exact) -> list[Fraction]:
    return [sum((Fraction(m[3 * i + k]) * Fraction(v[k]) for k in range(3)), Fraction(shift[i])) for i in range(3)]


def _less(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _solved(columns: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """Solve a system of equations if it has exactly one solution; otherwise return nothing."""
    rows, done = [list(row) for row in zip(*columns, right, strict=True)], list[list[Fraction]]()
    for k in range(len(columns)):
        pivot = next((row for row in rows if row[k]), None)
        if pivot is None:
            return []
        rows.remove(pivot)
        pivot = [x / pivot[k] for x in pivot]
        rows, done = (
            [[x - row[k] * y for x, y in zip(row, pivot, strict=True)] for row in some] for some in (rows, done)
        )
        done.append(pivot)
    return [] if any(row[-1] for row in rows) else [row[-1] for row in done]


def _contains(model: _Model, body: _Body, piece: int, four: Whole, point: list[Fraction]) -> bool:
    """Whether a point in the frame of the world belongs to a piece, as four numbers show."""
    link, chain = body.link, []
    while link >= 0:
        chain.append(model.links[link])
        link = chain[-1].above
    for step in reversed(chain):
        point = _moved([step.rotation[k] for k in (0, 3, 6, 1, 4, 7, 2, 5, 8)], _less(point, step.place), (0, 0, 0))
    (kind, radius, numbers), one = body.kinds[piece], Fraction(1)
    if kind in (1, 2, 3):
        columns = [_moved(body.turn, numbers[k::3], (0, 0, 0)) for k in (3, 4, 5)]
        u = _solved(columns, _less(point, _moved(body.turn, numbers[:3], body.place)))
        if radius or any(four) or not u:
            return False
        allowed = (one - u[2] ** 2, one, ((1 - u[2]) / 2) ** 2)[kind - 1]
        return abs(u[2]) <= 1 and u[0] ** 2 + u[1] ** 2 <= allowed
    width = 3 if kind == 0 else 4
    if max(four) >= len(numbers) // width:
        return False
    corners = [_moved(body.turn, numbers[width * k : width * k + 3], body.place) for k in four]
    for some in (some for count in range(1, 5) for some in combinations(corners, count) if kind == 0):
        weights = _solved([[*corner, one] for corner in some], [*point, one])
        if weights and min(weights) >= 0:
            return True
    far, along = _less(point, corners[0]), _less(corners[1], corners[0])
    share = _dot(far, along) / (_dot(along, along) or 1) if kind == 0 else Fraction(0)
    far = [a - min(max(share, 0), 1) * b for a, b in zip(far, along, strict=True)]
    reach = Fraction(radius) + (Fraction(numbers[4 * four[0] + 3]) if kind == 4 else 0)
    return _dot(far, far) <= reach**2


def _common_point(model: _Model, data: bytes) -> tuple[str, str]:
    """Check that two bodies have a common point; return their names."""
    reader = _Reader(data, "proof")
    places = [(reader.take("2I"), reader.take("4I")) for _ in range(2)]
    point = list(map(Fraction, reader.doubles(3)))
    reader.end()
    pair = places[0][0][0], places[1][0][0]
    if pair[0] == pair[1] or any(link.kind for link in model.links):
        raise Refused("A common point is proven for two different bodies of a model that does not move.")
    for (k, piece), four in places:
        if k >= len(model.bodies) or piece >= len(model.bodies[k].pieces):
            raise Refused(f"There is no piece {piece} of a body {k}.")
        if not _contains(model, model.bodies[k], piece, four, point):
            raise Refused(f"The point is not shown to belong to {_shown(model.bodies[k].name)}.")
    return model.named(pair)


def verify(data: bytes) -> Report:
    """Check a proof.

    Parameters
    ----------
    data : bytes
        Content of the file.

    Returns
    -------
    Report

    Raises
    ------
    Refused
        If the file is damaged, or is not a proof.

    Examples
    --------
    >>> from loewner.verify import Refused, verify
    >>> try:
    ...     verify(b"nothing")
    ... except Refused as reason:
    ...     print(reason)
    The file has 7 bytes; a proof has 56 to 67108864.
    """
    if not 56 <= len(data) <= MOST_BYTES:
        raise Refused(f"The file has {len(data)} bytes; a proof has 56 to {MOST_BYTES}.")
    magic, version, claim, size, rest = struct.unpack_from("<8s4I", data)
    if magic != b"LOEWNERP" or version != 1 or claim not in (1, 2) or len(data) != 56 + size + rest:
        raise Refused("The file is no proof of version 1, or does not have the length that it names.")
    if hashlib.sha256(data[:-32]).digest() != data[-32:]:
        raise Refused("The file is damaged: its hash is wrong.")
    block, proof, tightest = data[24 : 24 + size], data[24 + size : -32], None
    model = _Model(block)
    sizes = {"links": len(model.links), "values": len(model.values), "bodies": len(model.bodies)}
    report = Report(
        model=hashlib.sha256(block).hexdigest(),
        sizes=sizes | {"pieces": sum(len(body.pieces) for body in model.bodies)},
        left_out=tuple(map(model.named, model.apart)),
        uncovered=tuple(body.name for body in model.bodies if body.inside),
        deviations={},
        motions=(),
        tightest=None,
        common=None,
    )
    if claim == 2:
        return replace(report, common=_common_point(model, proof))
    checker = _Checker(model, proof)
    pairs, motions = checker.run()
    if checker.tightest:
        spare, pair, number, ends = checker.tightest
        start, end = (Fraction(t, 1 << DEEPEST) for t in ends)
        tightest = *model.named(pair), number, start, end, Fraction(spare, ONE)
    deviations = {name: x for (name, *_), x in zip(model.values, checker.deviations, strict=True) if x}
    sizes = report.sizes | {"pairs": pairs, "planes": checker.planes, "intervals": checker.intervals}
    return replace(report, sizes=sizes, deviations=deviations, motions=motions, tightest=tightest)


def main(argv: Sequence[str] | None = None) -> int:
    """Check a file and print what it proves; return 0 if it is verified, 1 if it is refused, 2 if it cannot be read.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments of the command line.
    """
    parser = argparse.ArgumentParser(description="Check a file that proves motions free of collisions.")
    parser.add_argument("file", type=Path)
    path = parser.parse_args(argv).file
    try:
        with path.open("rb") as file:
            report = verify(file.read(MOST_BYTES + 1))
    except (OSError, Refused) as error:
        print(f"refused: {error}" if isinstance(error, Refused) else f"cannot read {path}: {error}", file=sys.stderr)
        return 1 if isinstance(error, Refused) else 2
    print(f"model        {report.model}")
    print(f"             {', '.join(f'{count} {what}' for what, count in report.sizes.items())}")
    for number, (degree, joined, inside, configurations) in enumerate(report.motions):
        start = "starts where the last one ends" if joined and number else "starts anew" if number else "the first"
        limits = "within limits" if inside else "NOT WITHIN LIMITS"
        print(f"motion {number:<5} degree {degree}, {start}, {limits}, {configurations} configurations")
    if report.tightest:
        first, second, number, since, until, spare = report.tightest
        length = f"{_down(1000 * spare) >> BITS}.{_down(10**6 * spare) // ONE % 1000:03d} mm"
        print(f"tightest     {length} to spare, motion {number} from {since} to {until}: {_shown(first, second)}")
    print(
        f"left out     {len(report.left_out)} pairs"
        + "".join(f"\n             {_shown(*pair)}" for pair in report.left_out)
    )
    for name, deviation in report.deviations.items():
        print(f"deviation    {_shown(name)}: {deviation!r}")
    for name in report.uncovered:
        print(f"not covered  the interior of {_shown(name)}")
    if report.common:
        print(f"common point {_shown(*report.common)}")
    print("verified")
    return 0


if __name__ == "__main__":
    sys.exit(main())
