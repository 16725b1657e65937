"""Do two bodies collide, how far apart are they: verdicts and results for one pair or a million."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner import _check
from loewner._check import Floats
from loewner._kernels import batch, careful, distances, verdicts
from loewner._threads import over_blocks, share
from loewner.bodies import Bodies, Body, Packed
from loewner.errors import ConvergenceError, InputError, PoseError, UnknownNameError

# The smallest share of a batch that is worth handing to a thread.
CHUNK = 4096

# The same for exact distances that need care, each of which takes microseconds.
CAREFUL_CHUNK = 64

# What `distance` returns for a pair, in bytes: three numbers; and with one more, three vectors and a status.
BOUND_BYTES, EXACT_BYTES = 24, 105

RULES = {"contact-product": -1, "rimon-boyd": 0, "lin-han": 1, "center-line": 2}
METHODS = ("exact", "estimate")


class Verdict(IntEnum):
    """Certified answer about a pair of bodies."""

    FREE = 0
    """The outer ellipsoids are apart, by more than the margin: proven."""
    COLLIDING = 1
    """The inner ellipsoids touch or overlap, or come within the margin: proven."""
    AMBIGUOUS = 2
    """Neither; ask `collide` for an estimate or the exact answer."""


_VERDICTS = tuple(Verdict)


@dataclass(frozen=True, eq=False)
class Distance:
    """Distances in metres, each of the batch's shape; negative is a penetration depth.

    Everything here is about the nearest, or else the deepest, two pieces. For bodies of several pieces a
    negative distance is therefore the depth of that pair alone: the bodies are at least that deep in each
    other, and parting them can take more, since another pair may then be in the way.

    Attributes
    ----------
    lower, upper : float or ndarray
        Certified bounds from the ellipsoids: lower <= distance <= upper.
    estimate : float or ndarray
        The O(1) guess of the rule asked for, clipped to the bounds.
    distance : float or ndarray, or None
        With ``exact=True``: the distance of the bodies, or minus the depth of the deepest two
        pieces: the shortest translation that separates those two.
    witness_a, witness_b : ndarray, shape (..., 3), or None
        Points of a and of b, in world coordinates, with witness_b - witness_a = distance * normal.
    normal : ndarray, shape (..., 3), or None
        Unit vector from a to b; moving b along it parts those two pieces fastest.
    """

    lower: Any
    upper: Any
    estimate: Any
    distance: Any = None
    witness_a: Any = None
    witness_b: Any = None
    normal: Any = None


# The plan of one pair, and the rows of pairs that are not listed by number: see `batch.settle_range`.
_ONE_PAIR = np.array([[1], [0], [0], [0], [0]], dtype=np.int64)
NO_ROWS = np.empty((2, 0), dtype=np.int64)


class _Pairs(NamedTuple):
    """Operands of a query, broadcast: what the kernels take."""

    shape: tuple[int, ...]
    total: int
    plan: NDArray[np.int64]
    packs: tuple[Packed, Packed]
    poses: tuple[Floats, Floats]

    @property
    def operands(self) -> tuple[Any, ...]:
        """Plan, pack and poses of a, pack and poses of b, as the kernels of distances take them."""
        (a, b), (Ta, Tb) = self.packs, self.poses
        return self.plan, a.kernel, Ta, b.kernel, Tb

    @property
    def handles(self) -> tuple[Any, ...]:
        """The same by handles, as `batch.settle_range` takes them."""
        (a, b), (Ta, Tb) = self.packs, self.poses
        return self.plan, NO_ROWS, a.handle, Ta, b.handle, Tb


def _prepare(
    a: Body | Bodies,
    T_world_a: ArrayLike | None,
    b: Body | Bodies,
    T_world_b: ArrayLike | None,
    *,
    check: bool,
    each: int = 1,
) -> _Pairs:
    """Check the operands and work out how they broadcast; the poses are left to the kernel unless `check`.

    `each` is how many bytes of results a pair takes: what does not fit into memory is refused.
    """
    if not isinstance(a, (Body, Bodies)):
        raise InputError(f"a: expected loewner.Body or loewner.Bodies, found {type(a).__name__}")
    if not isinstance(b, (Body, Bodies)):
        raise InputError(f"b: expected loewner.Body or loewner.Bodies, found {type(b).__name__}")
    Ta = _check.poses(T_world_a, "T_world_a", check=check)
    Tb = _check.poses(T_world_b, "T_world_b", check=check)
    packs = a._packed, b._packed
    if Ta.ndim == 2 and Tb.ndim == 2 and isinstance(a, Body) and isinstance(b, Body):
        return _Pairs((), 1, _ONE_PAIR, packs, (Ta.reshape(1, 4, 4), Tb.reshape(1, 4, 4)))

    of_a = (len(a),) if isinstance(a, Bodies) else ()
    of_b = (len(b),) if isinstance(b, Bodies) else ()
    parts = (of_a, Ta.shape[:-2], of_b, Tb.shape[:-2])
    try:
        shape = np.broadcast_shapes(*parts)
    except ValueError:
        texts = [_check.shape_text(p) for p in parts]
        raise PoseError(
            "expected bodies and poses whose batch shapes broadcast, found "
            f"a: {texts[0]}, T_world_a: {texts[1]}, b: {texts[2]}, T_world_b: {texts[3]}"
        ) from None
    _check.fits_memory(each * math.prod(shape), f"{_check.shape_text(shape)} pairs")
    plan = _collapse(shape, [_row_strides(p, len(shape)) for p in parts])
    return _Pairs(shape, math.prod(shape), plan, packs, (Ta.reshape(-1, 4, 4), Tb.reshape(-1, 4, 4)))


def _row_strides(part: tuple[int, ...], ndim: int) -> list[int]:
    """Rows to step along each axis of the batch; 0 where the operand repeats."""
    strides = [0] * ndim
    step = 1
    for axis in range(1, len(part) + 1):
        length = part[-axis]
        strides[-axis] = step if length != 1 else 0
        step *= length
    return strides


def _collapse(shape: tuple[int, ...], strides: list[list[int]]) -> NDArray[np.int64]:
    """Merge neighbouring axes that every operand walks through evenly; mostly one axis is left.

    Returns the plan: the shape that is left, then the strides of each operand, one row each.
    """
    axes: list[list[int]] = []
    for d, length in enumerate(shape):
        steps = [s[d] for s in strides]
        if axes and all(outer == step * length for outer, step in zip(axes[-1][1:], steps, strict=True)):
            axes[-1] = [axes[-1][0] * length, *steps]
        else:
            axes.append([length, *steps])
    axes = [axis for axis in axes if axis[0] != 1] or [[1, *([0] * len(strides))]]
    return np.ascontiguousarray(np.array(axes, dtype=np.int64).T)


def _settle_one(mode: int, margin: float, a: Any, T_world_a: Any, b: Any, T_world_b: Any) -> int:
    """Verdict of two single bodies by the shortest way; -1 if they have to go the long one."""
    if type(a) is Body and type(b) is Body:
        Ta, Tb = _check.one_pose(T_world_a), _check.one_pose(T_world_b)
        if Ta is not None and Tb is not None:
            out = np.empty(1, dtype=np.int8)
            tally = np.zeros(verdicts.TIERS, dtype=np.int64)
            handles = a._packed.handle, Ta[None], b._packed.handle, Tb[None]
            if batch.settle_range(mode, margin, 0, 1, _ONE_PAIR, NO_ROWS, *handles, out, tally):
                return int(out[0])
    return -1


def _settle(mode: int, margin: float, pairs: _Pairs) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """Verdict of every pair, and how many piece pairs each tier settled."""
    out = np.empty(pairs.total, dtype=np.int8)

    def run(first: int, last: int) -> NDArray[np.int64]:
        tally = np.zeros(verdicts.TIERS, dtype=np.int64)
        if not batch.settle_range(mode, margin, first, last, *pairs.handles, out, tally):
            for T, name in zip(pairs.poses, ("T_world_a", "T_world_b"), strict=True):
                _check.rigid_motions(T, name)
        return tally

    if pairs.total <= CHUNK:
        tally = run(0, pairs.total)
    else:
        tally = np.sum(list(over_blocks(run, pairs.total, share(pairs.total, CHUNK))), axis=0)
    if mode == verdicts.EXACT and tally[verdicts.OPEN]:
        careful.settle_open(margin, pairs.plan, NO_ROWS, *pairs.operands[1:], out)
    return out, tally


def classify(
    a: Body | Bodies,
    T_world_a: ArrayLike | None,
    b: Body | Bodies,
    T_world_b: ArrayLike | None,
    *,
    margin: float = 0.0,
) -> Any:
    """Certified verdict from the ellipsoids alone.

    Parameters
    ----------
    a, b : Body or Bodies
        A `Bodies` of n broadcasts with the last batch axis of the poses.
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity.
    margin : float
        Metres that the bodies must keep: FREE then means farther apart than `margin`, COLLIDING
        within it.

    Returns
    -------
    Verdict, or ndarray of int8, shape (...)
        FREE and COLLIDING are proven, in floating point too (docs/certified.md). A union of pieces
        is FREE only if every piece pair is, COLLIDING if any is.

    Raises
    ------
    PoseError
        If a pose does not end in (4, 4), is not a rigid motion, or batches do not broadcast.
    InputError
        If an operand is no body, or the margin is negative or not finite.

    References
    ----------
    The paper, section 4; Perram and Wertheim (1985), doi:10.1016/0021-9991(85)90171-8.

    Examples
    --------
    >>> from loewner import Body, classify
    >>> T = np.eye(4)
    >>> T[0, 3] = 3.0
    >>> classify(Body.sphere(1.0), None, Body.box([1, 1, 1]), T)
    <Verdict.FREE: 0>
    """
    keep = _check.positive_scalar(margin, "margin", zero=True)
    one = _settle_one(verdicts.CERTIFY, keep, a, T_world_a, b, T_world_b)
    if one >= 0:
        return _VERDICTS[one]
    pairs = _prepare(a, T_world_a, b, T_world_b, check=False, each=1)
    out, _ = _settle(verdicts.CERTIFY, keep, pairs)
    return Verdict(int(out[0])) if pairs.shape == () else out.reshape(pairs.shape)


def collide(
    a: Body | Bodies,
    T_world_a: ArrayLike | None,
    b: Body | Bodies,
    T_world_b: ArrayLike | None,
    *,
    method: str = "exact",
    rule: str = "contact-product",
    margin: float = 0.0,
) -> Any:
    """Decide whether two bodies touch, overlap, or come within `margin` of each other.

    Parameters
    ----------
    a, b : Body or Bodies
        A `Bodies` of n broadcasts with the last batch axis of the poses.
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity.
    method : {"exact", "estimate"}
        "exact": the certificate, then a search on the pieces themselves. "estimate": the
        certificate, then an O(1) rule that sees the four ellipsoids only and errs on some
        ambiguous pairs.
    rule : {"contact-product", "rimon-boyd", "lin-han", "center-line"}
        For the estimate. The product of the two contact functions; or the sign of the paper's f
        between the near points of its detectors 3, 2 and 4. "center-line" misses many collisions
        of thin pieces.
    margin : float
        Metres; pairs this close count as colliding.

    Returns
    -------
    bool, or ndarray of bool, shape (...)
        Touching counts as colliding. False from "exact" is proven; True is proven up to rounding:
        pairs apart by less than about 1e-14 of the lengths involved count as touching.

    Raises
    ------
    PoseError, InputError
        As for `classify`.
    UnknownNameError
        If `method` or `rule` is not one of the names above.
    ConvergenceError
        If the exact search could not settle a pair. It never answers "free" instead.

    References
    ----------
    The paper, section 4; Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083.

    Examples
    --------
    >>> from loewner import Body, collide
    >>> collide(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), None)
    True
    """
    if method not in METHODS:
        raise UnknownNameError(f"method: expected one of {', '.join(METHODS)}, found {method!r}")
    code = _rule_code(rule)
    keep = _check.positive_scalar(margin, "margin", zero=True)
    if method == "exact":
        one = _settle_one(verdicts.EXACT, keep, a, T_world_a, b, T_world_b)
        if one in (verdicts.FREE, verdicts.COLLIDING):
            return one == verdicts.COLLIDING
    pairs = _prepare(a, T_world_a, b, T_world_b, check=False, each=1)
    if method == "exact":
        out, _ = _settle(verdicts.EXACT, keep, pairs)
        _refuse_unsettled(out == Verdict.AMBIGUOUS, "collide")
    else:
        out, _ = _settle(verdicts.CERTIFY, keep, pairs)

        factors = a._packed.factors + b._packed.factors

        def run(first: int, last: int) -> None:
            distances.rule_range(code, keep, first, last, *pairs.operands, factors, out)

        for _ in over_blocks(run, pairs.total, share(pairs.total, CHUNK)):
            pass
    colliding = out == Verdict.COLLIDING
    return bool(colliding[0]) if pairs.shape == () else colliding.reshape(pairs.shape)


def distance(
    a: Body | Bodies,
    T_world_a: ArrayLike | None,
    b: Body | Bodies,
    T_world_b: ArrayLike | None,
    *,
    exact: bool = False,
    rule: str = "contact-product",
) -> Distance:
    """Certified bounds on the signed distance of two bodies, and on request its exact value.

    Parameters
    ----------
    a, b : Body or Bodies
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity.
    exact : bool
        Also compute the distance or penetration depth, witnesses and normal.
    rule : {"contact-product", "rimon-boyd", "lin-han", "center-line"}
        What `estimate` is; see `collide`.

    Returns
    -------
    Distance
        Separation is positive, penetration negative, touching zero. The signed distance of two
        bodies is the least over their piece pairs; see `Distance` for what that means for depths.

    Raises
    ------
    PoseError, InputError, UnknownNameError
        As for `collide`.
    ConvergenceError
        If an exact distance could not be computed to 1e-9 of the lengths involved. (The penetration depth of
        cylinders, cones and capsules is never less than the true one, and proven to 1e-3 where many directions tie.)

    Examples
    --------
    >>> from loewner import Body, distance
    >>> T = np.eye(4)
    >>> T[0, 3] = 3.0
    >>> round(distance(Body.sphere(1.0), None, Body.sphere(0.5), T, exact=True).distance, 12)
    1.5
    """
    code = _rule_code(rule)
    pairs = _prepare(a, T_world_a, b, T_world_b, check=True, each=EXACT_BYTES if exact else BOUND_BYTES)
    n, m = pairs.total, pairs.total if exact else 0
    numbers = [np.empty(n), np.empty(n), np.empty(n), np.empty(m)]
    vectors = [np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3))]
    status = np.zeros(m, dtype=np.int8)
    factors = a._packed.factors + b._packed.factors
    operands = (np.empty(0, dtype=np.int64), *pairs.operands, factors, *numbers, *vectors, status)

    def run(first: int, last: int) -> None:
        distances.distance_range(exact, code, first, last, *operands)

    for _ in over_blocks(run, n, share(n, CHUNK)):
        pass
    operands = (np.flatnonzero(status == distances.PUT_OFF), *operands[1:])

    def run_again(first: int, last: int) -> None:
        distances.careful_range(exact, code, first, last, *operands)

    for _ in over_blocks(run_again, len(operands[0]), share(len(operands[0]), CAREFUL_CHUNK)):
        pass
    _refuse_unsettled(status != 0, "distance")

    def shaped(x: Floats) -> Any:
        if len(x) != n:
            return None
        if pairs.shape == ():
            return float(x[0]) if x.ndim == 1 else x[0]
        return x.reshape(pairs.shape + x.shape[1:])

    return Distance(*(shaped(x) for x in (*numbers, *vectors))) if exact else Distance(*map(shaped, numbers[:3]))


def _rule_code(rule: str) -> int:
    if not isinstance(rule, str) or rule not in RULES:
        raise UnknownNameError(f"rule: expected one of {', '.join(RULES)}, found {rule!r}")
    return RULES[rule]


def _refuse_unsettled(unsettled: NDArray[np.bool_], query: str) -> None:
    """An answer that arithmetic could not settle is an exception, never a guess."""
    if unsettled.any():
        first = int(np.flatnonzero(unsettled)[0])
        raise ConvergenceError(
            f"{query}: {int(unsettled.sum())} of {unsettled.size} pairs could not be settled, the first at flat "
            f"index {first}; treat them as colliding or change their poses by a hair"
        )
