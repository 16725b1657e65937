"""Find which answers of another program about pairs of bodies are proven wrong, in what way, and by how much."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._matrices import lengths
from loewner._base._validate import Bools, Floats
from loewner._kernels import columns
from loewner.bodies import Bodies, Body, packed_of
from loewner.bodies.kinds import BALLS
from loewner.errors import InputError
from loewner.queries import pairs as queries
from loewner.queries.pairs import Distance, expect_bodies, plan_of

__all__ = ["Finding", "Judgement", "judge_answers"]

# Errors of exact distances, and of depths of curved pieces, as shares of the lengths involved (docs/certified.md,
# "Other programs' answers"). ACCURACY is a hundredth larger than `SETTLED` of the kernels, to allow for rounding.
ACCURACY, OF_CURVED = 1.01e-9, 1.01e-3

GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0

# Families of pieces: depths between two pieces of the same family are as accurate as distances. Curved pieces that are
# not balls belong to no family.
FLAT, BALL, UNLIKE = 0, 1, -1

# Corners of a regular icosahedron on the unit sphere, and a number slightly below the radius of its inscribed ball.
ICOSAHEDRON = np.array([np.roll([0.0, y, z], k) for y in (-1, 1) for z in (-GOLDEN, GOLDEN) for k in range(3)])
ICOSAHEDRON /= math.sqrt(1.0 + GOLDEN**2)
IN_ICOSAHEDRON = 0.7946

# Relative rounding error of a few operations on given coordinates.
FEW_ROUNDINGS = 16 * 2.0**-53

# Radius of the ball that represents a point, in metres.
POINT = 1e-9

# Bytes per pair: about forty arrays of numbers and a dozen poses.
BYTES = 2000

# Parts of an answer, in the order of the last axis of `Judgement.kinds`.
PARTS = ("colliding", "distance", "depth", "witness_a", "witness_b", "witnesses", "normal")

# Units in which other programs give lengths, with the number of units in a metre.
UNITS = {"millimetres": 1e3, "centimetres": 1e2, "inches": 1 / 0.0254}

# Another convention is tried if at least the share TRIED of the answers is wrong. It explains an error if at most the
# share LEFT of the error remains. It is named if it explains at least LEAST errors and the share EXPLAINED of all
# errors, and spoils at most SPOILT right answers for each error that it explains. For another unit, half of the
# converted answer must also be wrong by more than HALVED times the remaining error. Otherwise, any sufficiently large
# unit would explain errors where the truth is nearly zero, or far below the claim.
LEAST, EXPLAINED, SPOILT, TRIED, LEFT, HALVED = 3, 0.75, 0.1, 0.1, 1e-3, 10


class Finding(IntEnum):
    """The judgement of one part of an answer.

    Examples
    --------
    >>> Finding(4), str(Finding.WRONG_FREE)
    (<Finding.WRONG_COLLIDING: 4>, 'WRONG_FREE')
    """

    NOT_GIVEN = 0
    """There is no answer to judge."""
    OK = 1
    """Proven right within the tolerance."""
    UNDECIDED = 2
    """Neither proven right nor proven wrong by more than the tolerance."""
    WRONG_FREE = 3
    """Called free, but the bodies are proven to collide; the excess is a depth."""
    WRONG_COLLIDING = 4
    """Called colliding, but the bodies are proven to be apart; the excess is a distance."""
    DISTANCE_TOO_LARGE = 5
    """The bodies are proven to be nearer."""
    DISTANCE_TOO_SMALL = 6
    """The bodies are proven to be farther apart."""
    DEPTH_TOO_LARGE = 7
    """A shorter translation is proven to separate the bodies."""
    DEPTH_TOO_SMALL = 8
    """No translation of this length separates the bodies."""
    WITNESS_OFF_BODY = 9
    """The witness is proven to be outside its body; the excess is its distance from the body."""
    WITNESSES_DO_NOT_MATCH = 10
    """The witnesses are not as far from each other as the answer's own distance or depth."""
    NORMAL_WRONG = 11
    """The bodies are proven to be apart after b moves along the normal by their true distance, or to collide after b
    moves by their true depth; the excess is the remaining distance or depth.
    """

    def __str__(self) -> str:
        return self.name


class Convention(NamedTuple):
    """Another convention in which answers were interpreted, and its effect on the findings.

    Attributes
    ----------
    about, reading : str
        Two parts of a sentence: `about` names the parts of answers, in the plural, and `reading` names the convention.
    wrong, right, spoilt : int
        Numbers of parts. `wrong` counts the parts that are wrong as given. `right` counts the parts that are wrong as
        given but right in the convention. `spoilt` counts the parts that are right as given but wrong in the
        convention.
    """

    about: str
    reading: str
    wrong: int
    right: int
    spoilt: int


def hints(tried: Iterable[Convention]) -> tuple[str, ...]:
    """Name the conventions that explain (nearly) all wrong answers, with one sentence for each kind of part."""
    sums: dict[tuple[str, str], Any] = {}
    for one in tried:
        sums[one[:2]] = np.add(sums.get(one[:2], 0), one[2:])
    best: dict[str, tuple[int, str]] = {}
    for (about, reading), (wrong, right, spoilt) in sums.items():
        explains = right >= max(LEAST, EXPLAINED * wrong) and spoilt <= SPOILT * right
        if explains and right > best.get(about, (0, ""))[0]:
            count = f"All {right:,}" if right == wrong else f"{right:,} of {wrong:,}"
            best[about] = right, f"{count} wrong {about} {reading}."
    return tuple(sentence for _, sentence in best.values())


@dataclass(frozen=True, eq=False, repr=False)
class Judgement(_validate.Brief):
    """Proven findings about the answers of another program.

    Attributes
    ----------
    kinds : ndarray of int8, shape (..., 7)
        A `Finding` for each part of each answer. In order, the parts are named colliding, distance, depth, witness_a,
        witness_b, witnesses (their distance from each other) and normal.
    excess : ndarray, shape (..., 7)
        A lower bound on the error of each part that is proven wrong, in metres; 0 for all other parts.
    lower, upper : ndarray, shape (...)
        Proven bounds on the signed distance, in metres. A negative value is a depth: the length of the shortest
        translation that separates the bodies. The lower bound is minus infinity if no such translation is known.
    conventions : tuple
        Other conventions that were tried because many answers are wrong; see `hints`.

    Examples
    --------
    >>> from loewner import Body
    >>> T = np.eye(4)
    >>> T[0, 3] = 3.0
    >>> said = judge_answers(Body.sphere(1.0), None, Body.sphere(0.5), T, colliding=False, distance=0.0)
    >>> said.counts()
    {<Finding.OK: 1>: 1, <Finding.DISTANCE_TOO_SMALL: 6>: 1}
    >>> round(float(said.excess.max()), 6)
    1.5
    """

    kinds: Any
    excess: Floats
    lower: Floats
    upper: Floats
    conventions: tuple[Convention, ...] = field(default=(), repr=False)

    @property
    def hints(self) -> tuple[str, ...]:
        """Sentences about different conventions, such as reversed normals, that explain (nearly) all errors.

        The sentences are guesses based on counts, and do not change the findings.

        Examples
        --------
        >>> from loewner import Body
        >>> T = np.eye(4)
        >>> T[0, 3] = 3.0
        >>> said = judge_answers(Body.sphere(1.0), None, Body.sphere(1.0), T, distance=[1e3, 1e3, 1e3])
        >>> said.hints
        ('All 3 wrong distances are right in millimetres.',)
        """
        return hints(self.conventions)

    @property
    def wrong(self) -> Bools:
        """Whether any part of each answer is proven wrong, shape (...)."""
        return np.asarray((self.kinds > Finding.UNDECIDED).any(axis=-1))

    def counts(self) -> dict[Finding, int]:
        """Count the parts of answers with each finding, except the parts that are not given.

        Returns
        -------
        dict
            The number of parts with each `Finding`.

        Examples
        --------
        >>> from loewner import Body
        >>> judge_answers(Body.sphere(1.0), None, Body.sphere(1.0), None, colliding=[True, False]).counts()
        {<Finding.OK: 1>: 1, <Finding.WRONG_FREE: 3>: 1}
        """
        counts = np.bincount(self.kinds.ravel(), minlength=len(Finding))
        return {kind: int(counts[kind]) for kind in Finding if counts[kind] and kind != Finding.NOT_GIVEN}

    def worst(self, kind: Finding | None = None) -> Any:
        """List the answers with a finding, the largest error first.

        Parameters
        ----------
        kind : Finding, optional
            The finding to list; by default, all findings of proven errors.

        Returns
        -------
        ndarray of int64
            Flat indices of answers.

        Examples
        --------
        >>> from loewner import Body
        >>> said = judge_answers(Body.sphere(1.0), None, Body.sphere(1.0), None, distance=[0.1, 0.0, 0.3])
        >>> said.worst().tolist(), said.worst(Finding.OK).tolist()
        ([2, 0], [1])
        """
        if kind is not None and not isinstance(kind, Finding):
            raise InputError(f"kind: expected a Finding or None, found {_validate.short(kind)}")
        chosen = self.kinds > Finding.UNDECIDED if kind is None else self.kinds == kind
        chosen, excess = chosen.reshape(-1, len(PARTS)), self.excess.reshape(-1, len(PARTS))
        most = np.where(chosen, excess, -1.0).max(axis=1)
        order = np.argsort(-most, kind="stable")
        return order[most[order] >= 0.0]


@guarded
def judge_answers(
    a: Body | Bodies,
    T_world_a: ArrayLike | None,
    b: Body | Bodies,
    T_world_b: ArrayLike | None,
    *,
    colliding: ArrayLike | None = None,
    distance: ArrayLike | None = None,
    depth: ArrayLike | None = None,
    witness_a: ArrayLike | None = None,
    witness_b: ArrayLike | None = None,
    normal: ArrayLike | None = None,
    tolerance: float = 1e-6,
) -> Judgement:
    """Judge another program's answers about pairs of bodies.

    Each part of an answer is judged separately. A part that is called wrong is proven wrong, with all rounding taken
    into account. Neither an answer of NaN nor a zero normal is judged.

    Parameters
    ----------
    a, b : Body or Bodies
        The bodies as the other program represents them. A `Bodies` of length n broadcasts with the last batch axis of
        the poses.
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, which broadcast together and with the answers; translation in metres. None is the identity.
    colliding : array_like, shape (...), optional
        Whether the bodies collide: True or 1, False or 0, NaN for no answer.
    distance : array_like, shape (...), optional
        Distances in metres. A negative value is a depth. A distance of 0 counts as right for all bodies that collide,
        since many programs do not compute depths.
    depth : array_like, shape (...), optional
        Lengths of the shortest translations that separate the bodies, in metres; 0 for bodies that are apart.
    witness_a, witness_b : array_like, shape (..., 3), optional
        The points of a and of b, in world coordinates, that realise the distance or depth.
    normal : array_like, shape (..., 3), optional
        Vectors of any length along which b moves away from a.
    tolerance : float
        Allowed error in metres.

    Returns
    -------
    Judgement

    Raises
    ------
    PoseError, InputError
        As for `distance`. InputError is also raised if the shapes of answers do not broadcast with the poses, an answer
        is infinite, a depth is negative, or no answer is given.

    Notes
    -----
    Depths and normals of overlapping bodies have a single meaning only for two convex pieces. For other bodies, a depth
    is called too small only if it is less than the depth of two of their pieces. It is called too large only if a
    shorter translation separates the bodies. For bodies with several pieces, normals and the distances between
    witnesses are never called wrong.

    Examples
    --------
    >>> import numpy as np
    >>> from loewner import Body
    >>> T = np.eye(4)
    >>> T[0, 3] = 0.9
    >>> said = judge_answers(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), T, depth=0.2, normal=[0, 1, 0])
    >>> said.counts()
    {<Finding.DEPTH_TOO_LARGE: 7>: 1, <Finding.NORMAL_WRONG: 11>: 1}
    >>> round(float(said.excess[2]), 6)
    0.1
    """
    allowed = _validate.positive_scalar(tolerance, "tolerance", zero=True)
    expect_bodies(a, b)
    poses = [_validate.poses(T, name) for T, name in ((T_world_a, "T_world_a"), (T_world_b, "T_world_b"))]
    answers = {
        "colliding": _flags(colliding),
        "distance": _answers(distance, "distance"),
        "depth": _answers(depth, "depth", least=0.0),
        "witness_a": _answers(witness_a, "witness_a", (3,)),
        "witness_b": _answers(witness_b, "witness_b", (3,)),
        "normal": _answers(normal, "normal", (3,)),
    }
    said = {name: array for name, array in answers.items() if array is not None}
    if not said:
        raise InputError(f"expected an answer to judge, one of {', '.join(answers)}, found none")
    plan = plan_of(a, poses[0].shape, b, poses[1].shape)
    batches = {name: x.shape[:-1] if name in VECTORS else x.shape for name, x in said.items()}
    shape = _validate.broadcast({"pairs": plan.shape, **batches})
    _validate.fits_memory(BYTES * int(np.prod(shape)), f"{_validate.shape_text(shape)} pairs")
    Ta, Tb = (np.broadcast_to(T, (*shape, 4, 4)) for T in poses)
    pairs = _Pairs(a, Ta, b, Tb)
    parts = {name: np.broadcast_to(x, shape + (x.shape[-1:] if name in VECTORS else ())) for name, x in said.items()}
    with np.errstate(over="ignore", invalid="ignore"):  # an overflow proves nothing
        return _judged(pairs, parts, allowed)


# Parts of answers that are vectors.
VECTORS = ("witness_a", "witness_b", "normal")


def _answers(x: Any, name: str, tail: tuple[int, ...] = (), *, least: float = -np.inf) -> Floats | None:
    """Check numbers of an answer, in which NaN means no answer."""
    if x is None:
        return None
    array = _validate.float_array(x, name)
    if tail and array.shape[-1:] != tail:
        raise InputError(f"{name}: expected shape (..., 3), found {_validate.shape_text(array.shape)}")
    if np.isinf(array).any() or (array < least).any():
        wanted = "finite numbers" if np.isinf(least) else f"finite numbers of {least:g} or more"
        number = array[np.isinf(array) | (array < least)].flat[0]
        raise InputError(f"{name}: expected {wanted}, or NaN for no answer, found {number}")
    return array


def _flags(x: Any) -> Floats | None:
    """Check answers of yes and no."""
    if x is None:
        return None
    plain = _validate.plain_array(x, "colliding")
    array = plain.astype(float) if plain.dtype == bool else _validate.float_array(x, "colliding")
    wrong = ~(np.isnan(array) | (array == 0) | (array == 1))
    if wrong.any():
        raise InputError(f"colliding: expected True or False, or NaN for no answer, found {array[wrong].flat[0]}")
    return array


@dataclass(frozen=True)
class _Pairs:
    """Bodies at poses of the full batch shape."""

    a: Body | Bodies
    Ta: Floats
    b: Body | Bodies
    Tb: Floats

    def moved(self, step: Floats) -> _Pairs:
        """Move b; where a step is not finite, b stays where it is."""
        T = np.array(self.Tb)
        T[..., :3, 3] += np.where(np.isfinite(step).all(axis=-1, keepdims=True), step, 0.0)
        return _Pairs(self.a, self.Ta, self.b, T)

    def kinds(self) -> tuple[Bools, Bools]:
        """Return where both bodies are single convex pieces, and where depths are as accurate as distances."""
        single, families = np.ones(self.Ta.shape[:-2], dtype=bool), []
        for body in (self.a, self.b):
            kind = packed_of(body).layout[:, columns.KIND]
            convex = _of_each(body, np.minimum, kind) >= columns.MAPPED
            single = single & convex & (_of_each(body, np.add, np.ones(len(kind))) == 1)
            family = np.where(kind <= columns.POLYTOPE, FLAT, np.where(np.isin(kind, BALLS), BALL, UNLIKE))
            first, last = (_of_each(body, which, family) for which in (np.minimum, np.maximum))
            families.append(np.where(first == last, first, UNLIKE))
        return single, (families[0] == families[1]) & (families[0] != UNLIKE)

    def size(self) -> Floats:
        """Bound the lengths involved, in metres: the distance between the origins, and the reaches of both bodies."""
        size = np.abs(self.Tb[..., :3, 3] - self.Ta[..., :3, 3]).sum(axis=-1)
        for body in (self.a, self.b):
            size = size + _of_each(body, np.maximum, packed_of(body).kernel.table[:, columns.REACH])
        return np.asarray(size)

    def rounding(self) -> Floats:
        """Bound the error of a translation of b by a step, in metres."""
        return FEW_ROUNDINGS * np.asarray(np.abs(self.Tb[..., :3, 3]).sum(axis=-1) + self.size())

    def measured(self) -> tuple[Distance, Floats, Floats, Floats]:
        """Return signed distances, with bounds and their accuracy; unsettled distances are NaN.

        The lower bound of a negative distance is minus infinity here, unless ellipsoids prove that there is no depth.
        """
        distances, _ = queries.measured(self.a, self.Ta, self.b, self.Tb, True)
        value, slack = np.asarray(distances.distance), ACCURACY * self.size()
        lower, upper = np.asarray(distances.lower), np.asarray(distances.upper)
        lower = np.where(value >= 0.0, np.fmax(lower, value - slack), np.where(lower > 0.0, lower, -np.inf))
        single, tight = self.kinds()
        loose = (value < 0.0) & ~tight
        upper = np.fmin(upper, value + np.where(loose, OF_CURVED / ACCURACY, 1.0) * slack)
        if loose.any():  # the exact test proves at least that bodies meet, and still meet after moves
            upper = np.where(loose & self.verdicts()[1], np.minimum(upper, slack), upper)
            reach = np.where(loose & single, (1.0 - 1e-6) * -value, 0.0)
            still = loose & single
            for corner in ICOSAHEDRON:
                still &= self.moved(reach[..., None] * corner).verdicts()[1]
            upper = np.where(still, np.minimum(upper, slack + self.rounding() - IN_ICOSAHEDRON * reach), upper)
        return distances, lower, upper, slack

    def verdicts(self) -> tuple[Bools, Bools]:
        """Return where the bodies are proven to be apart, and where they meet, up to rounding."""
        colliding, unsettled = queries.decided(True, 0.0, self.a, self.Ta, self.b, self.Tb)
        free = ~np.asarray(colliding)
        return free, ~free & ~unsettled.reshape(free.shape)


def _of_each(body: Body | Bodies, reduced: np.ufunc, values: Any) -> Any:
    """Reduce values of pieces to one value per body: an array for `Bodies`, and a number for a `Body`."""
    body_values = reduced.reduceat(values, packed_of(body).piece_start[:-1])
    return body_values[0] if isinstance(body, Body) else body_values


def _judged(pairs: _Pairs, said: dict[str, Floats], allowed: float) -> Judgement:
    """Bound the signed distances, and compare each part of the answers with the bounds."""
    distances, lower, upper, slack = pairs.measured()
    value, normal = np.asarray(distances.distance), np.asarray(distances.normal)
    # A move along the normal by slightly more than the depth separates overlapping bodies; otherwise, no depth is
    # known.
    way = np.where(value < 0.0, 3.0 * slack - value, 0.0)
    apart = (value < 0.0) & pairs.moved(way[..., None] * normal).verdicts()[0]
    lower = np.where(apart, np.maximum(lower, -way - pairs.rounding()), lower)
    court = _Court(pairs, lower, upper, allowed)
    kinds, excess = court.findings(said)
    return Judgement(kinds, excess, lower, upper, tuple(_conventions(court, said, kinds, excess)))


def _conventions(court: _Court, said: dict[str, Floats], kinds: Any, excess: Floats) -> Iterator[Convention]:
    """Count the errors that other conventions explain, if many answers are wrong."""
    for about, reading, answers, is_unit in _readings(court.pairs, said):
        at, right, spoilt = [PARTS.index(name) for name in answers], 0, 0
        wrong = kinds[..., at] > Finding.UNDECIDED
        if wrong.any() and wrong.sum() >= TRIED * (kinds[..., at] != Finding.NOT_GIVEN).sum():
            other_kinds, other_excess = (findings[..., at] for findings in court.findings(answers))
            explained = wrong & (other_excess <= LEFT * excess[..., at])
            if is_unit:
                _, of_half = court.findings({name: x / 2 for name, x in answers.items()})
                explained &= of_half[..., at] > HALVED * other_excess
            right = int(explained.sum())
            spoilt = int(((kinds[..., at] == Finding.OK) & (other_kinds > Finding.UNDECIDED)).sum())
        if wrong.any():
            yield Convention(about, reading, int(wrong.sum()), right, spoilt)


def _readings(pairs: _Pairs, said: dict[str, Floats]) -> Iterator[tuple[str, str, dict[str, Floats], bool]]:
    """Yield other conventions: kind of parts, description, converted answers, and whether the convention is a unit."""
    if "normal" in said:
        yield "normals", "point the other way, from b to a", {"normal": -said["normal"]}, False
    points = {name: said[name] for name in VECTORS[:2] if name in said}
    for about, parts in (("distances", ("distance",)), ("depths", ("depth",)), ("witnesses", VECTORS[:2])):
        answers = {name: said[name] for name in parts if name in said}
        for unit, many in UNITS.items() if answers else ():
            yield about, f"are right in {unit}", {name: x / many for name, x in answers.items()}, True
    if len(points) == 2:
        a, b = points.values()
        yield "witnesses", "are right with a and b exchanged", {"witness_a": b, "witness_b": a}, False
    Ta, Tb = pairs.Ta, pairs.Tb
    frames = {"a": (Ta, Ta), "b": (Tb, Tb), "their own bodies": (Ta, Tb), "the other bodies": (Tb, Ta)}
    for whose, poses in frames.items() if points else ():
        T = dict(zip(VECTORS, poses, strict=False))
        world = {n: (T[n][..., :3, :3] @ x[..., None])[..., 0] + T[n][..., :3, 3] for n, x in points.items()}
        yield "witnesses", f"are right in the frame{'s' * (len(whose) > 1)} of {whose}", world, False


# For one part of the answers: where it is given, lower and upper bounds on its error, and the finding if the error is
# too large.
_Error: TypeAlias = tuple[Bools, Floats, Floats, Any]


@dataclass(frozen=True)
class _Court:
    """Pairs of bodies with proven bounds on their signed distances; the bounds are used to judge answers."""

    pairs: _Pairs
    lower: Floats
    upper: Floats
    allowed: float

    def findings(self, said: dict[str, Floats]) -> tuple[Any, Floats]:
        """Judge the parts that are given: return the findings, and lower bounds on the errors of wrong parts."""
        errors = {part: _JUDGES[part](self, part, claim) for part, claim in said.items()}
        if "witness_a" in said and "witness_b" in said:
            errors["witnesses"] = self._of_witnesses(said)
        shape = (*self.lower.shape, len(PARTS))
        kinds, excess = np.zeros(shape, dtype=np.int8), np.zeros(shape)
        for part, (is_given, least, most, wrong) in errors.items():
            at = PARTS.index(part)
            undecided = np.where(most <= self.allowed, Finding.OK, Finding.UNDECIDED)
            kind = np.where(least > self.allowed, wrong, undecided)
            kinds[..., at] = np.where(is_given, kind, Finding.NOT_GIVEN)
            excess[..., at] = np.where(kinds[..., at] > Finding.UNDECIDED, least, 0.0)
        return kinds, excess

    def _of_flags(self, _: str, flags: Floats) -> _Error:
        """Bound the distance of bodies that are called colliding, and the depth of bodies that are called free."""
        yes = flags == 1.0
        least, most = np.where(yes, self.lower, -self.upper), np.where(yes, self.upper, -self.lower)
        return ~np.isnan(flags), least, most, np.where(yes, Finding.WRONG_COLLIDING, Finding.WRONG_FREE)

    def _of_lengths(self, part: str, length: Floats) -> _Error:
        """Compare a distance or a depth with the interval of the signed distance."""
        signed = -length if part == "depth" else length
        as_depth = (part == "depth") | ((signed < 0.0) & (self.lower <= 0.0))
        length = np.where(as_depth, -signed, signed)
        low = np.maximum(np.where(as_depth, -self.upper, self.lower), 0.0)
        high = np.maximum(np.where(as_depth, -self.lower, self.upper), 0.0)
        rounding = FEW_ROUNDINGS * np.abs(length)
        above, below = length - high - rounding, low - length - rounding
        large = np.where(as_depth, Finding.DEPTH_TOO_LARGE, Finding.DISTANCE_TOO_LARGE)
        small = np.where(as_depth, Finding.DEPTH_TOO_SMALL, Finding.DISTANCE_TOO_SMALL)
        most = np.maximum(length - low, high - length) + rounding
        return ~np.isnan(length), np.maximum(above, below), most, np.where(above > below, large, small)

    def _of_witness(self, part: str, point: Floats) -> _Error:
        """Bound how far a point is from its body; any point inside the body counts as right."""
        body, T = (self.pairs.a, self.pairs.Ta) if part == "witness_a" else (self.pairs.b, self.pairs.Tb)
        is_given = np.asarray(~np.isnan(point).any(axis=-1))
        place = np.broadcast_to(np.eye(4), T.shape).copy()
        place[..., :3, 3] = np.where(is_given[..., None], point, T[..., :3, 3])
        _, lower, upper, _ = _Pairs(body, T, Body.sphere(POINT), place).measured()
        return is_given, lower, upper + POINT, Finding.WITNESS_OFF_BODY

    def _of_witnesses(self, said: dict[str, Floats]) -> _Error:
        """Compare the distance between two witnesses with the distance, or with the depth if it has a single meaning.

        A distance of 0 for overlapping bodies has no witnesses.
        """
        missing = np.full(self.lower.shape, np.nan)
        claim, depth = np.abs(said.get("distance", missing)), said.get("depth", missing)
        length = np.where(np.isnan(claim) | ((claim == 0.0) & ~np.isnan(depth)), depth, claim)
        a, b = said["witness_a"], said["witness_b"]
        rounding = FEW_ROUNDINGS * (lengths(a) + lengths(b) + length)
        error = np.abs(lengths(b - a) - length)
        is_given = ~(np.isnan(error) | ((length == 0.0) & (self.upper < 0.0)))
        least = np.where(self.pairs.kinds()[0] | (self.lower > 0.0), error - rounding, 0.0)
        return is_given, least, error + rounding, Finding.WITNESSES_DO_NOT_MATCH

    def _of_normal(self, _: str, normal: Floats) -> _Error:
        """Move b along the answer's normal, into or out of contact, and bound the remaining distance or depth."""
        lower, upper = self.lower, self.upper
        scale = np.abs(normal).max(axis=-1, keepdims=True)
        unit = np.divide(normal, scale, out=np.full(normal.shape, np.nan), where=scale > 0.0)
        unit = unit / lengths(unit)[..., None]
        overlapping = upper < 0.0
        # If the bodies are apart, the right move leaves a distance of at most the width of the interval.
        way = np.where(overlapping, np.maximum(-lower, 0.0), -np.maximum(lower, 0.0))
        is_known = np.isfinite(way) & (self.pairs.kinds()[0] | ~overlapping)
        moved = self.pairs.moved(np.where(is_known, way, 0.0)[..., None] * unit)
        left_lower, left_upper = moved.measured()[1:3]
        width = np.where(overlapping, 0.0, np.maximum(upper, 0.0) - np.maximum(lower, 0.0)) + moved.rounding()
        # For bodies that still overlap, `left_lower` is unknown and not needed: only depths beyond a bound prove an
        # error.
        least = np.where(is_known, np.where(overlapping, -left_upper, left_lower) - width, 0.0)
        most = np.where(overlapping, -left_lower, left_upper)
        most = np.where(overlapping & moved.verdicts()[0], 0.0, most)
        is_given = np.asarray(~np.isnan(unit).any(axis=-1))
        return is_given, least, np.where(is_known, most, np.inf), Finding.NORMAL_WRONG


_JUDGES = {
    "colliding": _Court._of_flags, "distance": _Court._of_lengths, "depth": _Court._of_lengths,
    "witness_a": _Court._of_witness, "witness_b": _Court._of_witness, "normal": _Court._of_normal,
}  # fmt: skip
