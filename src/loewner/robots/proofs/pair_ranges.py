"""Decide which pairs of bodies can ever collide, at any configuration within the ranges of the joints between them.

Only the joints between two bodies matter, so the search space is small. A box of configurations, with one range for
each value, is proven by the kernel that proves motions: the longest side of the box is the motion, and the other sides
are deviations of values from the motion. Boxes that are not proven are halved. Depths prove that a pair collides in
every configuration: two convex pieces meet in a whole box if the depth of their overlap exceeds the distance that any
of their points moves within the box. See docs/certified.md, "Pairs over whole ranges".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _low_discrepancy, _validate
from loewner._base._guard import guarded
from loewner._base._plausible import FARTHEST_LIMIT, doubt_about_limits, warn
from loewner._base._validate import Floats, Ints, Pair, Progress
from loewner._kernels import codes
from loewner._kernels import columns as kernel_columns
from loewner._kernels.records import Tree
from loewner.bodies import Packed
from loewner.bodies.kinds import ROUND
from loewner.errors import InputError
from loewner.robots.checking import distances, verdicts
from loewner.robots.checking.checked_pairs import prepared
from loewner.robots.checking.pair_cache import keep, known_pairs
from loewner.robots.checking.problem import Problem
from loewner.robots.description import robot
from loewner.robots.description.pair_verdicts import PairVerdict, ProvenPair, ProvenPairs, Terms
from loewner.robots.description.reaching import links_above
from loewner.robots.description.robot import Robot
from loewner.robots.proofs import proofs
from loewner.robots.proofs.courses import straight
from loewner.robots.proofs.proof_models import model_of
from loewner.robots.proofs.range_proofs import Claim, proof_of_ranges
from loewner.scenes.scene import Scene

# Number of configurations that are tried first, and number of boxes that are examined at a time.
TRIED = 512
AT_ONCE = 4096

# Minimum number of boxes that each pair gets at a time.
FIRST_BOXES = 1000

# Minimum tolerance of a proof [m].
LEAST_TOLERANCE = 1e-12

# If joints follow a value without limits, the range of the value is a common period of the joints. The denominators of
# the joints' multipliers must not exceed MOST_TURNS.
MOST_TURNS = 64

# Accuracy of ranges of one value [rad or m], and number of bisections for boxes of several values.
FINEST, BISECTIONS = 1e-10, 20

# Factor that allows for rounding errors of bounds on motions.
UP = 1.0 + 1e-5

# Errors that are subtracted from distances and depths: shares of the distance or depth itself, of the lengths from
# which positions are computed, and of the size of curved pieces. The last share covers searches that stop near, but not
# at, the best direction. The largest measured error of such searches is 7.1e-6, for cylinders with a common axis.
OF_DEPTH, OF_LENGTHS, OF_CURVED = 1e-6, 1e-12, 1e-4

# Verdicts that may change if more boxes are examined.
UNDECIDED = (PairVerdict.CAN, PairVerdict.OPEN)

# Numbers of starts and of steps of a search for the least distance.
STARTS, STEPS = 4, 50


@dataclass(eq=False)
class _Question:
    """A pair of bodies, and everything known about the pair so far.

    Attributes
    ----------
    names, pair : names of the bodies, and their indices in `every`, which has all bodies
    columns : columns of the values between the bodies
    ready : the two bodies on a robot that has only the joints between them
    base : a configuration of the robot
    lower, upper, complete : the range, and whether it covers the hard limits
    reason : why boxes cannot be halved further; usually empty
    levers : how far a point moves at most, for each value [m per rad or m]
    waiting : boxes that are neither proven nor examined, in arrays of shape (n, 2, columns)
    always : whether contact everywhere is to be proven, instead of its absence
    colliding, free, nearest, distance, boxes, share : see `ProvenPair`
    """

    names: Pair
    pair: tuple[int, int]
    every: Problem
    columns: Ints
    ready: Problem
    base: Floats
    lower: Floats
    upper: Floats
    complete: bool
    reason: str = ""
    waiting: list[Floats] = field(default_factory=list)
    always: bool = False
    colliding: Floats | None = None
    free: Floats | None = None
    nearest: Floats | None = None
    distance: float = math.nan
    boxes: int = 0
    share: float = 0.0

    def __post_init__(self) -> None:
        self.measured = self.ready.without_margins
        self.margin = float(self.ready.margins[0])
        self.levers, travel = _levers(self.ready, 0, self.lower, self.upper)
        packed = self.ready.packed
        sizes = packed.kernel.table[:, kernel_columns.OUTER_RADIUS]
        kinds = packed.layout[:, kernel_columns.KIND]
        curved = (kinds > kernel_columns.POLYTOPE) & ~np.isin(kinds, ROUND)
        lengths = self.ready.tables.chain[1] + travel + packed.kernel.table[:, kernel_columns.REACH].max()
        self.rounding = OF_LENGTHS * float(lengths) + OF_CURVED * float(sizes[curved].max(initial=0.0))

    # -- single configurations -------------------------------------------------------------------

    @cached_property
    def whole(self) -> Problem:
        """The pair on the robot itself."""
        return self.every.with_pairs(np.array([self.pair]), np.array([self.margin]))

    def configuration(self, q: Floats) -> Floats:
        """Return the configuration of the robot with the given values between the bodies."""
        configuration = self.base.copy()
        configuration[self.columns] = q
        return configuration

    def try_some(self) -> None:
        """Search for configurations with and without contact: at corners, in the middle, and in between."""
        count = len(self.columns)
        corners = np.array(list(itertools.product((0.0, 1.0), repeat=min(count, 6))))
        corners = np.concatenate([corners, np.full((len(corners), count - corners.shape[1]), 0.5)], axis=1)
        shares = np.concatenate([np.full((1, count), 0.5), corners, _low_discrepancy.points(TRIED, count)])
        Q = self.lower + shares * (self.upper - self.lower)
        self.look_at(np.minimum(np.maximum(Q, self.lower), self.upper))
        self.always = self.free is None
        self.waiting = [np.stack([self.lower, self.upper])[None]]

    def look_at(self, Q: Floats) -> None:
        """Note a configuration with contact and a configuration without, if the robot's own kinematics confirm them."""
        row_verdicts = verdicts.classified(self.ready, codes.EXACT, Q).verdicts
        for verdict, name in ((codes.COLLIDING, "colliding"), (codes.FREE, "free")):
            if getattr(self, name) is not None:
                continue
            for k in np.flatnonzero(row_verdicts == verdict)[:STARTS].tolist():
                q = self.configuration(Q[k])
                if verdicts.classified(self.whole, codes.EXACT, q[None]).verdicts[0] == verdict:
                    setattr(self, name, q)
                    break

    def descend(self) -> None:
        """Search for the least distance, starting at the nearest of the configurations that are tried first."""
        Q = self.lower + _low_discrepancy.points(TRIED, len(self.columns)) * (self.upper - self.lower)
        if self.colliding is not None:
            Q = np.concatenate([Q, self.colliding[None, self.columns]])
        Q = np.clip(Q, self.lower, self.upper)
        values = self.signed(Q)
        best = np.argsort(values, kind="stable")[:STARTS]
        Q, values = Q[best], values[best]
        step = np.tile((self.upper - self.lower) / 8, (len(Q), 1))
        count = len(self.columns)
        ways = np.concatenate([np.eye(count), -np.eye(count)])
        for _ in range(STEPS):
            tried = np.clip(Q[:, None] + step[:, None] * ways, self.lower, self.upper)
            gaps = self.signed(tried.reshape(-1, count)).reshape(len(Q), -1)
            at, row = np.where(np.isnan(gaps), np.inf, gaps).argmin(axis=1), np.arange(len(Q))
            better = gaps[row, at] < values
            Q, values = np.where(better[:, None], tried[row, at], Q), np.where(better, gaps[row, at], values)
            step = np.where(better[:, None], step, step / 2)
        if np.isnan(values).all():
            return
        lowest = int(np.nanargmin(values))
        self.distance, self.nearest = float(values[lowest]), self.configuration(Q[lowest])
        if self.distance <= self.margin:
            self.look_at(Q[lowest : lowest + 1])

    def signed(self, Q: Floats) -> Floats:
        """Return signed distances of the bodies; NaN where fast searches find none."""
        return np.asarray(distances.nearest_columns(self.measured, np.ascontiguousarray(Q), True, care=False)[2])

    # -- boxes -----------------------------------------------------------------------------------

    @property
    def proven_free(self) -> bool:
        """Whether the whole range is proven free."""
        return not (self.waiting or self.always or self.reason)

    @property
    def settled(self) -> bool:
        """Whether nothing is left to do."""
        return bool(self.reason) or not self.waiting or (self.colliding is not None and self.free is not None)

    @property
    def to_go(self) -> float:
        """An estimate of the number of boxes that are still needed."""
        return self.boxes * (1.0 - self.share) / self.share if self.share > 0 else math.inf

    def proceed(self, most: int) -> int:
        """Examine at most `most` boxes, and return the number of examined boxes."""
        before = self.boxes
        while most > 0 and not self.settled:
            last = self.waiting.pop()
            boxes, rest = last[-min(AT_ONCE, most) :], last[: -min(AT_ONCE, most)]
            if len(rest):
                self.waiting.append(rest)
            most -= len(boxes)
            self.boxes += len(boxes)
            proven = self.collide_in(boxes) if self.always else self.free_in(boxes)
            width = self.upper - self.lower
            parts = np.where(width > 0, (boxes[:, 1] - boxes[:, 0]) / np.where(width > 0, width, 1.0), 1.0)
            self.share += float(parts.prod(axis=1)[proven].sum())
            left = boxes[~proven]
            if len(left):
                halves = _halved(left, self.levers)
                if len(halves) < 2 * len(left):
                    self.reason = "a box ends at two neighbouring floating-point numbers, and cannot be halved"
                self.waiting.append(halves)
        return self.boxes - before

    def free_in(self, boxes: Floats) -> Any:
        """Return which boxes are proven free, and note a contact that is found."""
        center, half = _center_and_half(boxes)
        moved = self.moved(half)
        row, long = np.arange(len(boxes)), (half * self.levers).argmax(axis=1)
        a, b = center.copy(), center.copy()
        a[row, long], b[row, long] = boxes[row, 0, long], boxes[row, 1, long]
        half[row, long] = 0.0
        courses = straight(self.ready.robot, a, b)
        proven = np.zeros(len(boxes), dtype=bool)
        for like in _of_like_size(moved):
            # With this tolerance, motions of such lengths are not halved, and their deviations do not count as
            # rounding.
            some, tolerance = courses[like], 2.0 * float(moved[like].max()) + LEAST_TOLERANCE
            answers = proofs.prove(self.ready, some, tolerance, proofs.deviations(some, half[like]))
            proven[like] = answers.verdicts == codes.FREE
            met = np.flatnonzero(answers.verdicts == codes.COLLIDING)[:STARTS]
            if len(met) and self.colliding is None:
                share = answers.fractions[met, None]
                self.look_at(np.where(share == 1, some[met, 1], some[met, 0] + share * (some[met, 1] - some[met, 0])))
        if (self.ready.packed.layout[:, kernel_columns.KIND] <= kernel_columns.SURFACE).any():
            open_ones = np.flatnonzero(~proven)
            near = self.signed(center[open_ones])
            proven[open_ones] = near - self.error_of(near) > self.margin + moved[open_ones]
        return proven

    def collide_in(self, boxes: Floats) -> Any:
        """Return which boxes are proven to be in contact everywhere, and note configurations without contact."""
        center, half = _center_and_half(boxes)
        near = self.signed(center)
        if (near > self.margin).any():
            self.look_at(center[near > self.margin])
        return near + self.error_of(near) < self.margin - self.moved(half)

    def error_of(self, near: Floats) -> Floats:
        """Return the error of computed distances and depths, rounded up."""
        return OF_DEPTH * np.abs(near) + self.rounding

    def moved(self, half: Floats) -> Floats:
        """Bound how far any point of one body, seen from the other body, is from its place at the centers of boxes."""
        return np.asarray((half * self.levers).sum(axis=1) * UP)

    def answer(self) -> ProvenPair:
        """Return the answer as far as it is known."""
        if self.colliding is not None and self.free is not None:
            verdict = PairVerdict.SOMETIMES
        elif not self.waiting and not self.reason and self.boxes:
            verdict = PairVerdict.ALWAYS if self.always else PairVerdict.NEVER
        else:
            verdict = PairVerdict.OPEN if self.colliding is None else PairVerdict.CAN
        reason = ""
        if verdict in UNDECIDED:
            count = len(self.columns)
            values = f"{count} values" if count > 1 else "one value"
            reason = self.reason or f"with {values} between the bodies, more boxes are needed"
        names = self.every.robot.configuration_names
        return ProvenPair(
            self.names, verdict, tuple(names[k] for k in self.columns), self.lower, self.upper, self.margin,
            self.distance, self.nearest, self.colliding, self.free, self.boxes, min(self.share, 1.0), self.complete,
            reason,
        )  # fmt: skip


def _center_and_half(boxes: Floats) -> tuple[Floats, Floats]:
    """Return the centers of boxes, and the largest distances of their ends from the centers."""
    low, high = boxes[:, 0], boxes[:, 1]
    center = low + (high - low) / 2
    return center, np.nextafter(np.maximum(high - center, center - low), np.inf)


def _of_like_size(sizes: Floats) -> Iterator[Ints]:
    """Group numbers that differ by less than a factor of eight."""
    exponents = np.frexp(sizes)[1] // 3
    for exponent in np.unique(exponents):
        yield np.flatnonzero(exponents == exponent)


def _halved(boxes: Floats, levers: Floats) -> Floats:
    """Halve boxes across the side along which points move most; boxes that have no middle are left out."""
    low, high = boxes[:, 0], boxes[:, 1]
    row, at = np.arange(len(boxes)), ((high - low) * levers).argmax(axis=1)
    middle = low[row, at] + (high[row, at] - low[row, at]) / 2
    one, other = boxes.copy(), boxes.copy()
    one[row, 1, at], other[row, 0, at] = middle, middle
    inside = (middle > low[row, at]) & (middle < high[row, at])
    return np.stack([one[inside], other[inside]], axis=1).reshape(-1, 2, boxes.shape[2])


# -- the joints between two bodies --------------------------------------------------------------


def _joints(tree: Tree, link: int) -> list[int]:
    """Return the joints between the world and a link, identified by the links that they move."""
    return [k for k in reversed(links_above(tree, link)) if tree.kind[k] != kernel_columns.FIXED]


def _between(tree: Tree, one: int, other: int) -> list[int]:
    """Return the joints between two links; -1 is the world."""
    a, b = _joints(tree, one), _joints(tree, other)
    return [k for k in a if k not in b] + [k for k in b if k not in a]


def _chain(whole: Robot, links: list[int], joints: list[int], columns: Ints) -> tuple[Robot, Ints]:
    """Make a robot with only the given joints, links and columns; also return the numbers of the links in this robot.

    The link that carries the first joints is the new robot's world: neither the link's place nor other joints matter.
    """
    tree, kept = whole.tree, sorted({*links, *joints} - {-1})
    number = {link: k for k, link in enumerate(kept)}
    place = {int(column): k for k, column in enumerate(columns)}
    branch = Tree(*(np.ascontiguousarray(np.asarray(array)[kept]) for array in tree))
    for k, link in enumerate(kept):
        branch.parent[k] = number.get(int(tree.parent[link]), -1)
        if link in joints:
            branch.column[k] = place.get(int(tree.column[link]), 0)
        elif tree.kind[link] != kernel_columns.FIXED:  # it carries the first joints
            branch.parent[k], branch.kind[k], branch.column[k], branch.constants[k] = -1, kernel_columns.FIXED, 0, 0.0
            branch.constants[k, kernel_columns.ROTATION + np.array([0, 4, 8])] = 1.0
    names = tuple(whole.configuration_names[k] for k in columns)
    chain = replace(
        whole, tree=branch, link_names=tuple(whole.link_names[k] for k in kept), configuration_names=names,
        joint_names=names, lower=whole.hard_lower[columns], upper=whole.hard_upper[columns],
        hard_lower=whole.hard_lower[columns], hard_upper=whole.hard_upper[columns],
        _columns={name: slice(k, k + 1) for k, name in enumerate(names)},
    )  # fmt: skip
    return chain, np.array([number[link] for link in links if link >= 0], dtype=np.int64)


def _levers(ready: Problem, body: int, lower: Floats, upper: Floats) -> tuple[Floats, float]:
    """Bound how far any point of a body, seen from the other body, moves for each value [m per rad or m].

    Also return the sum of the largest travels of all joints that slide [m].
    """
    tree, reach = ready.robot.tree, ready.tables.reach[body]
    slides, turns = [], []  # link, column, and multiplier
    for k in np.flatnonzero(tree.kind != kernel_columns.FIXED).tolist():
        at, by = int(tree.column[k]), abs(float(tree.multiplier[k]))
        if tree.kind[k] == kernel_columns.PLANAR:
            slides += [(k, at, 1.0), (k, at + 1, 1.0)]
            turns.append((k, at + 2, 1.0))
        else:
            (slides if tree.kind[k] == kernel_columns.PRISMATIC else turns).append((k, at, by))
    # Reaches are measured with sliding joints at 0, so add the joints' distances from 0.
    travel = sum(max(abs(lower[at]), abs(upper[at])) * by + abs(float(tree.offset[k])) for k, at, by in slides)
    levers = np.zeros(len(lower))
    for _, at, by in slides:
        levers[at] += by * UP
    for k, at, by in turns:
        levers[at] += by * (float(reach[k]) + travel) * UP
    return levers, float(travel)


def _range(whole: Robot, joints: list[int], column: int, turns: bool) -> tuple[float, float, str]:
    """Return a value's hard limits, or a full turn of all joints that follow it, and a reason if there is no range."""
    low, high = float(whole.hard_lower[column]), float(whole.hard_upper[column])
    name, tree = whole.configuration_names[column], whole.tree
    if low > -FARTHEST_LIMIT and high < FARTHEST_LIMIT:
        return low, high, ""
    if low > -FARTHEST_LIMIT or high < FARTHEST_LIMIT:
        return low, high, f"{name} has a limit on one side only"
    if not turns:
        return low, high, f"{name} slides without limits"
    period = 1
    for by in (float(tree.multiplier[k]) for k in joints if tree.column[k] == column):
        share = Fraction(by).limit_denominator(MOST_TURNS)
        if float(share) != by:
            return low, high, f"a joint follows {name} by the factor {by:.17g}, and they have no common period"
        period = math.lcm(period, share.denominator)
    end = math.nextafter(period * math.pi, math.inf)  # π is rounded
    return -end, end, ""


def _values(whole: Robot, joints: list[int]) -> tuple[dict[int, bool], str]:
    """Return the columns on which joints depend, whether each is only an angle, and a reason if there is no range."""
    tree, is_angle = whole.tree, dict[int, bool]()
    for k in joints:
        kind, at = int(tree.kind[k]), int(tree.column[k])
        if kind in (kernel_columns.FLOATING, kernel_columns.BALL):
            return {}, f"the joint above {whole.link_names[k]} turns about any axis, and has no range"
        if kind == kernel_columns.PLANAR:
            is_angle |= {at: False, at + 1: False, at + 2: True}
        elif tree.multiplier[k] != 0.0:
            is_angle[at] = is_angle.get(at, True) and kind == kernel_columns.REVOLUTE
    return dict(sorted(is_angle.items())), ""


# -- the questions ------------------------------------------------------------------------------


@guarded
def prove_pairs(
    self: Robot, pairs: Iterable[Pair] | None, terms: Terms, cache: bool, progress: Progress | None, proof: bool
) -> ProvenPairs:
    """Implement `Robot.prove_pairs`, whose signature has the defaults."""
    cache, report = _validate.flag(cache, "cache"), _validate.reporter(progress)
    margin, boxes, scene, ranges = _checked(self, terms)
    stated = None
    if _validate.flag(proof, "proof"):
        ready = prepared(self, scene, self._usually_skipped, scene.version, None)
        stated = model_of(ready), ready  # raises an error if there is no model
    every = prepared(self, scene, (), scene.version, None)
    body_pairs = _asked(self, every, pairs)
    kept = cache and not ranges and margin == 0.0 and not scene.names and not scene.margins
    cached_answers = known_pairs(self) if kept else {}
    answers: dict[Pair, Any] = {}
    for pair in body_pairs:
        names = _sorted(every, pair)
        row, allowed = cached_answers.get(names, (None, 0))
        if row is not None and (row.verdict not in UNDECIDED or allowed >= boxes / len(body_pairs)):
            answers[names] = row
        else:
            answers[names] = _question(self, every, pair, max(margin, scene.margin_of(*names)), ranges)
    questions = {names: one for names, one in answers.items() if isinstance(one, _Question)}
    _settle(list(questions.values()), boxes, report, only_free=terms.only_free)
    answers |= {names: question.answer() for names, question in questions.items()}
    if kept and questions and not terms.only_free:
        keep(self, (answers[names] for names in questions), boxes // len(body_pairs))
    checked = {_sorted(every, (int(a), int(b))) for a, b in every.pairs}
    for names in [names for names, one in answers.items() if one is None and names in checked]:
        answers[names] = _constant(self, every, names, max(margin, scene.margin_of(*names)))
    rigid = tuple(names for names, one in answers.items() if one is None)
    rows = tuple(one for one in answers.values() if one is not None)
    range_proof = None if stated is None else proof_of_ranges(*stated, _claims(self, every, rows))
    return ProvenPairs(self.name, rows, rigid, range_proof)


@guarded
def free_range(
    self: Robot, joints: str | Iterable[str], about: ArrayLike | None, pairs: Iterable[Pair] | None, terms: Terms
) -> dict[str, tuple[float, float]]:
    """Implement `Robot.free_range`, whose signature has the defaults."""
    names = [joints] if isinstance(joints, str) else _validate.listed(joints, "joints", wanted="a name or several")
    for name in names:
        _expect_value(self, name, "joints")
    if not names or len(set(names)) < len(names):
        raise InputError(f"joints: expected one name or several different ones, found {_validate.short(joints)}")
    margin, boxes, scene, ranges = _checked(self, terms)
    q = self.configuration() if about is None else self.checked_one(about, "about")
    every = prepared(self, scene, self._usually_skipped if pairs is None else (), scene.version, None)
    body_pairs = [(int(a), int(b)) for a, b in every.pairs] if pairs is None else _asked(self, every, pairs)
    if not body_pairs:
        raise InputError("pairs: expected at least one, found none: any range would count as free")
    kept = np.array([max(margin, scene.margin_of(every.names[a], every.names[b])) for a, b in body_pairs])
    ready = every.with_pairs(np.array(body_pairs), kept)
    columns = [_column(self, name, q, ranges) for name in names]
    if not verdicts.free(ready, q[None])[0]:
        pair_verdicts = verdicts.verdicts_at(ready, q)
        a, b = body_pairs[int((pair_verdicts != codes.FREE).argmax())]
        raise InputError(
            f"about: expected a free configuration, found contact of {every.names[a]} and {every.names[b]}"
        )
    if len(columns) == 1:
        ((at, low, high),) = columns
        return {names[0]: (_end(ready, q, at, low), _end(ready, q, at, high))}

    def proven(share: float) -> bool:
        ends = {k: (float(value), float(value)) for k, value in enumerate(q)}
        ends |= {at: (q[at] - share * (q[at] - low), q[at] + share * (high - q[at])) for at, low, high in columns}
        asked_now = [_question(self, every, pair, keeps, ends) for pair, keeps in zip(body_pairs, kept, strict=True)]
        for one in asked_now:
            if isinstance(one, ProvenPair):  # a box of size 0 would silently be the answer
                raise InputError(f"pairs: expected ranges, found none for {' and '.join(one.names)}: {one.reason}")
        questions = [one for one in asked_now if isinstance(one, _Question)]
        _settle(questions, boxes, _validate.silent, search=False)
        return all(question.proven_free for question in questions)

    share = _largest_share(proven)
    return {
        name: (float(q[at] - share * (q[at] - low)), float(q[at] + share * (high - q[at])))
        for name, (at, low, high) in zip(names, columns, strict=True)
    }


robot.answers |= {"prove_pairs": prove_pairs, "free_range": free_range}


def _claims(whole: Robot, every: Problem, rows: tuple[ProvenPair, ...]) -> list[Claim]:
    """Convert the rows with joints to claims of a proof; all rows must be NEVER."""
    if not any(row.columns for row in rows):
        raise InputError("proof: expected pairs with joints between them, found none; there is nothing to prove")
    place, claims = {name: k for k, name in enumerate(every.names)}, list[Claim]()
    for row in rows:
        if row.verdict is not PairVerdict.NEVER:
            why = f" ({row.reason})" if row.reason else ""
            raise InputError(
                f"proof: expected pairs that are NEVER nearer than their margins, found {row.verdict} for "
                f"{' and '.join(row.names)}{why}; leave it out"
            )
        if not row.columns:  # no range to divide into boxes
            continue
        a, b = sorted(place[name] for name in row.names)
        columns = np.array([whole.configuration_names.index(name) for name in row.columns], dtype=np.int64)
        claims.append(Claim((a, b), row.margin, columns, row.lower, row.upper))
    return claims


def _checked(whole: Robot, terms: Terms) -> tuple[float, int, Scene, dict[int, tuple[float, float]]]:
    """Check a robot and terms; return the margin, the number of boxes, a copy of the scene, and ranges by column."""
    margin = _validate.positive_scalar(terms.margin, "margin", zero=True)
    boxes = _validate.whole_number(terms.boxes, "boxes", 1)
    if not whole.bodies:
        raise InputError(f"robot: expected a robot with collision geometry, found none in {whole.name!r}")
    scene = Scene() if terms.scene is None else _validate.instance(terms.scene, "scene", Scene).snapshot()
    if scene.following:
        raise InputError(
            f"scene: expected bodies at rest or attached, found {next(iter(scene.following))!r}, which follows a motion"
        )
    for name in scene.bounds:
        raise InputError(f"scene: expected bodies at known poses, found {name!r}, whose pose has an error")
    return margin, boxes, scene, _checked_limits(whole, terms.limits)


def _column(whole: Robot, name: Any, q: Floats, given: Mapping[int, tuple[float, float]]) -> tuple[int, float, float]:
    """Return the column of a value, and the value's range, which must contain its present value."""
    _expect_value(whole, name, "joints")
    at, tree = whole.configuration_names.index(name), whole.tree
    if at not in given:
        moved = [k for k in np.flatnonzero(tree.kind != kernel_columns.FIXED).tolist() if tree.column[k] == at]
        low, high, reason = _range(whole, moved, at, all(tree.kind[k] == kernel_columns.REVOLUTE for k in moved))
        if reason or not moved:
            raise InputError(f"joints: expected a joint with a range, found {name!r}: {reason or 'part of a position'}")
        if whole.hard_lower[at] <= -FARTHEST_LIMIT:  # a full turn may begin anywhere
            low, high = q[at] + low, q[at] + high
    else:
        low, high = given[at]
    if not low <= q[at] <= high:
        raise InputError(f"about: expected {name!r} between {low:g} and {high:g}, found {q[at]:g}")
    return at, float(low), float(high)


def _end(ready: Problem, q: Floats, column: int, end: float) -> float:
    """Find how far one value is proven free in the direction of one end of its range."""
    free_end, step = float(q[column]), end - float(q[column])
    a, b = q.copy(), q.copy()
    while free_end != end and abs(step) > FINEST:
        a[column] = free_end
        b[column] = end if abs(step) >= abs(end - free_end) else free_end + step
        if b[column] == free_end:  # no number is left between the two
            break
        if proofs.prove(ready, straight(ready.robot, a[None], b[None]), FINEST).verdicts[0] == codes.FREE:
            free_end, step = float(b[column]), 2.0 * step
        else:
            step = 0.5 * (float(b[column]) - free_end)
    return free_end


def _largest_share(proven: Callable[[float], bool]) -> float:
    """Find, by bisection, the largest share of the way to all ends for which a box of values is proven free."""
    low, high = 0.0, 1.0
    if proven(high):
        return high
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if proven(middle) else (low, middle)
    return low


def _checked_limits(whole: Robot, limits: Mapping[str, tuple[float, float]] | None) -> dict[int, tuple[float, float]]:
    """Return the given ranges, keyed by column."""
    ranges = {}
    for name, ends in _validate.mapping(limits, "limits", "from joints to (lower, upper)").items():
        _expect_value(whole, name, "limits")
        low, high = _validate.finite_array(ends, f"limits of {name}", (2,)).tolist()
        if low > high:
            raise InputError(f"limits of {name}: expected (lower, upper), found {low:g} above {high:g}")
        column = whole.configuration_names.index(name)
        kinds = whole.tree.kind[(whole.tree.column == column) & (whole.tree.kind != kernel_columns.FIXED)]
        if (kinds == kernel_columns.REVOLUTE).all() and (doubt := doubt_about_limits(low, high)):
            warn(f"limits of {name}: expected {doubt}")
        ranges[column] = low, high
    return ranges


def _expect_value(whole: Robot, name: Any, argument: str) -> None:
    """Refuse a name that is not the name of a value of a configuration."""
    if isinstance(name, str) and name in whole.mimics:
        other, _ = whole.mimics[name]
        raise InputError(
            f"{argument}: expected joints with values of their own, found {name!r}, which follows {other!r}"
        )
    _validate.known(name, argument, whole.configuration_names)


def _asked(whole: Robot, every: Problem, pairs: Iterable[Pair] | None) -> list[tuple[int, int]]:
    """Return the pairs in question, as indices of bodies; the first body of each pair moves."""
    place = {name: k for k, name in enumerate(every.names)}
    if pairs is None:
        listed = whole.disabled_pairs if whole._lists_pairs else itertools.combinations(whole.bodies, 2)
        names: Iterable[Pair] = ((a, b) for a, b in listed if a in place and b in place)
    else:
        names = []
        for pair in _validate.listed(pairs, "pairs", wanted="pairs of names"):
            both = tuple(_validate.listed(pair, "pairs, one of them", wanted="a pair of names"))
            if len(both) != 2 or both[0] == both[1]:
                raise InputError(f"pairs: expected pairs of two different names, found {_validate.short(pair)}")
            for name in both:
                if isinstance(name, str) and name in whole.link_names and name not in place:
                    raise InputError(f"pairs: expected links with bodies, found {name!r}, which has none")
                _validate.known(name, "pairs", place)
            if min(place[name] for name in both) >= len(every.link):
                raise InputError(
                    f"pairs: expected one body that moves with a link at least, found {both[0]!r}, {both[1]!r}"
                )
            names.append(both)
    unique_pairs = {frozenset(pair): pair for pair in names}
    return [tuple(sorted(place[name] for name in unique_pairs[key])) for key in sorted(unique_pairs, key=sorted)]  # type: ignore[misc]


def _sorted(every: Problem, pair: tuple[int, int]) -> Pair:
    one, other = (every.names[k] for k in pair)
    return min(one, other), max(one, other)


def _question(
    whole: Robot, every: Problem, pair: tuple[int, int], margin: float, given: Mapping[int, tuple[float, float]]
) -> _Question | ProvenPair | None:
    """Prepare the question about a pair. If there is no range, return the answer; if there is no joint, return None."""
    moving, (a, b), names = len(every.link), pair, _sorted(every, pair)
    links = [int(every.link[a]), int(every.link[b]) if b < moving else -1]
    joints = _between(whole.tree, *links)
    values, reason = _values(whole, joints)
    if not values and not reason:
        return None
    columns = np.array(list(values), dtype=np.int64)
    ranges = [_range(whole, joints, k, turns) for k, turns in values.items()]
    ends = [given.get(k, span[:2]) for k, span in zip(values, ranges, strict=True)]
    reasons = [reason, *(span[2] for k, span in zip(values, ranges, strict=True) if k not in given)]
    lower, upper = np.array(ends).reshape(-1, 2).T.copy()
    complete = all(end[0] <= span[0] and end[1] >= span[1] for end, span in zip(ends, ranges, strict=True))
    labels = tuple(whole.configuration_names[k] for k in columns)
    for why in filter(None, reasons):
        return ProvenPair(names, PairVerdict.OPEN, labels, lower, upper, margin, complete=complete, reason=why)
    chain, numbers = _chain(whole, links, joints, columns)
    packs: list[Packed] = [every.packs[a], every.packs[b]]
    standing = every.standing.poses.reshape(-1, 16)[b - moving :][:1] if b >= moving else np.empty((0, 16))
    ready = _pair_problem(chain, packs, numbers, margin, standing)
    if b < moving:
        # Proofs move the first body, so let the first body be the body that moves less as seen from the other one.
        first, second = (((upper - lower) * _levers(ready, body, lower, upper)[0]).sum() for body in (0, 1))
        if second < first:
            ready = _pair_problem(chain, packs[::-1], numbers[::-1], margin, standing)
    base = np.clip(whole.configuration(), whole.hard_lower, whole.hard_upper)
    return _Question(names, pair, every, columns, ready, base, lower, upper, complete)


def _constant(whole: Robot, every: Problem, names: Pair, margin: float) -> ProvenPair:
    """Answer the question about a body of the scene and a link that does not move relative to this body."""
    pair = sorted(every.names.index(name) for name in names)
    q, ready = whole.configuration(), every.with_pairs(np.array([pair]), np.array([margin]))
    verdict = verdicts.classified(ready, codes.EXACT, q[None]).verdicts[0]
    distance = float(distances.nearest_columns(ready.without_margins, q[None], True, care=False)[2][0])
    kinds = {codes.FREE: PairVerdict.NEVER, codes.COLLIDING: PairVerdict.ALWAYS}
    return ProvenPair(
        names, kinds.get(verdict, PairVerdict.OPEN), (), np.empty(0), np.empty(0), margin, distance, q,
        q if verdict == codes.COLLIDING else None, q if verdict == codes.FREE else None, 1,
        float(verdict in kinds), reason="" if verdict in kinds else "the exact test did not settle the pair",
    )  # fmt: skip


def _pair_problem(chain: Robot, packs: list[Packed], numbers: Ints, margin: float, standing: Floats) -> Problem:
    """Prepare two bodies, the first on a link of a chain, the second on another link or in the world."""
    return Problem.of(
        chain, (0, 0), ("one", "other"), packs, np.ascontiguousarray(numbers), np.array([[0, 1]]), np.array([margin])
    ).with_poses(standing, 0)  # fmt: skip


def _settle(
    questions: list[_Question], boxes: int, progress: Progress, *, search: bool = True, only_free: bool = False
) -> None:
    """Work on all questions, beginning with the shortest, until they are settled or the boxes are used up."""
    order = sorted(questions, key=lambda question: len(question.columns))
    for question in order:
        question.try_some()
    left = [question for question in order if not question.settled]
    for question in left:
        boxes -= question.proceed(min(FIRST_BOXES, boxes))
    while boxes > 0 and (left := [question for question in left if not question.settled]):
        progress(len(order) - len(left), len(order))
        # Continue with the question that probably needs the fewest boxes.
        question = min(left, key=lambda question: question.to_go)
        boxes -= question.proceed(min(max(FIRST_BOXES, math.ceil(min(2 * question.to_go, boxes))), boxes))
    if search:
        for question in order:
            if question.proven_free or not only_free:
                question.descend()  # also for proven pairs, where contact would be a contradiction
    progress(len(order), len(order))
