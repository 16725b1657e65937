"""Compute verdicts, collisions and distances of bodies, for one pair or for millions of pairs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import reduce
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._rotations import rotations_of
from loewner._base._threads import in_shares
from loewner._base._validate import BoolOrBools, Bools, FloatOrFloats, Floats, Ints, OneOrMany
from loewner._kernels import codes
from loewner._native import entries, singles
from loewner.bodies import Bodies, Body, Packed, packed_of
from loewner.errors import ConvergenceError, InputError, PoseError
from loewner.queries._measure import BOUND_BYTES, CHUNK, EXACT_BYTES, measure
from loewner.queries._settle import NO_ROWS, Operands, settle

if TYPE_CHECKING:  # defaults of type variables need Python 3.13 at runtime
    from typing_extensions import TypeVar

    Number = TypeVar("Number", default=FloatOrFloats, covariant=True)
    Exact = TypeVar("Exact", default=OneOrMany, covariant=True)
    Vector = TypeVar("Vector", default=OneOrMany, covariant=True)
else:
    from typing import TypeVar

    Number, Exact, Vector = TypeVar("Number"), TypeVar("Exact"), TypeVar("Vector")

# None, as the value of fields that were not requested; its type fits the fields' type variables.
NOTHING: Any = None

# Bytes per pair in `collide` (a verdict and two flags), and in a list of pairs (two numbers).
COLLIDE_BYTES, LIST_BYTES = 3, 16

# Poses of one or more bodies, as a caller passes them.
Poses = ArrayLike | None

# The row numbers of chosen pairs, as a caller passes them.
Rows = ArrayLike | None

# The shape of an array.
Lengths = tuple[int, ...]

Verdicts = NDArray[np.int8]

METHODS = ("exact", "estimate")


class Verdict(IntEnum):
    """The certified answer to a question such as whether two bodies collide.

    Examples
    --------
    >>> verdict = Verdict(2)
    >>> verdict, str(verdict), verdict == 2
    (<Verdict.AMBIGUOUS: 2>, 'AMBIGUOUS', True)
    """

    FREE = 0
    """Proven: the outer ellipsoids are apart, by more than the margin."""
    COLLIDING = 1
    """Proven: the inner ellipsoids touch, overlap, or come within the margin."""
    AMBIGUOUS = 2
    """Neither is proven; `collide` computes the exact answer, or an estimate."""

    def __str__(self) -> str:
        return self.name


VERDICTS = tuple(Verdict)

VerdictOrVerdicts = Verdict | Verdicts


@dataclass(frozen=True, eq=False, repr=False)
class Distance(_validate.Brief, Generic[Number, Exact, Vector]):
    """Signed distances of bodies, in metres, as arrays of the batch's shape; negative values are penetration depths.

    All values refer to the nearest two pieces or, if the bodies overlap, to the two pieces that overlap most deeply.
    For bodies with several pieces, a negative distance is therefore the depth of one pair of pieces. The bodies
    penetrate each other at least that deeply, but separating them may take a longer translation, since other pieces may
    be in the way.

    For two convex pieces, the depth is as accurate as an exact distance. For a surface, the depth is a strict lower
    bound. If the inner ellipsoids of a solid prove a greater depth than its triangles, `distance` is the greater depth,
    while the witnesses and the normal belong to the triangles.

    Attributes
    ----------
    lower, upper : float or ndarray
        Certified bounds from the ellipsoids: lower <= distance <= upper.
    estimate : float or ndarray
        A guess, clamped to the bounds. It is computed in O(1) from the product of two contact functions, one for the
        inner and one for the outer ellipsoids.
    distance : float or ndarray, or None
        With ``exact=True``: the distance of the bodies, or minus the depth of the two pieces that overlap most deeply.
        The depth is the length of the shortest translation that separates the two pieces.
    witness_a, witness_b : ndarray, shape (..., 3), or None
        Points of a and of b in world coordinates, such that witness_b - witness_a = distance * normal.
    normal : ndarray, shape (..., 3), or None
        Unit vector from a to b; moving b along it separates the two pieces fastest.

    Examples
    --------
    >>> from loewner import Body, distance
    >>> T = np.eye(4)
    >>> T[0, 3] = 3.0
    >>> found = distance(Body.sphere(1.0), None, Body.sphere(0.5), T, exact=True)
    >>> found.witness_a.round(9) + 0.0, found.normal.round(9) + 0.0
    (array([1., 0., 0.]), array([1., 0., 0.]))
    """

    lower: Number
    upper: Number
    estimate: Number
    distance: Exact = NOTHING
    witness_a: Vector = NOTHING
    witness_b: Vector = NOTHING
    normal: Vector = NOTHING

    @property
    def wrench(self) -> Vector:
        """Derivative of the distance with respect to the motion of b, shape (..., 6); None without ``exact=True``.

        The wrench consists of a unit force along the normal at the witness, and the moment of this force about the
        world's origin [m]. A twist consists of the velocity of the body's point at the world's origin, and the body's
        angular velocity. If b moves with a twist, the distance changes at the rate twist·wrench. If a moves with the
        twist instead, the distance changes at minus this rate. The witnesses are not unique for parallel faces or
        edges: the distance has a kink there, and the wrench is the derivative for one choice of witnesses.

        Examples
        --------
        >>> from loewner import Body, distance
        >>> T = np.eye(4)
        >>> T[:3, 3] = 3.0, 0.0, 1.0
        >>> found = distance(Body.box([1, 1, 4]), None, Body.sphere(0.5), T, exact=True)
        >>> found.wrench.round(9) + 0.0
        array([1., 0., 0., 0., 1., 0.])
        """
        normal: Any = self.normal
        witness: Any = self.witness_b
        wrench: Any = NOTHING if normal is None else np.concatenate([normal, np.cross(witness, normal)], axis=-1)
        return wrench  # type: ignore[no-any-return]


# The results without and with ``exact=True``.
Bounds = Distance[Number, None, None]
Measured = Distance[Number, Number, Floats]


def _prepare(
    a: Body | Bodies,
    T_world_a: ArrayLike | None,
    b: Body | Bodies,
    T_world_b: ArrayLike | None,
    *,
    check: bool,
    each: int = 1,
    chosen: ArrayLike | None = None,
) -> _Pairs:
    """Check the operands, and determine how they broadcast.

    If `check` is false, the kernel checks the entries of the poses.

    `each` is the number of bytes of results per pair; a call whose results do not fit into memory is refused. If
    `chosen` lists row numbers of pairs, these pairs replace broadcasting.
    """
    expect_bodies(a, b)
    Ta = _validate.poses(T_world_a, "T_world_a", check=check)
    Tb = _validate.poses(T_world_b, "T_world_b", check=check)
    plan = plan_of(a, Ta.shape, b, Tb.shape, each=each, chosen=chosen)
    return _Pairs(plan, (packed_of(a), packed_of(b)), (Ta.reshape(-1, 4, 4), Tb.reshape(-1, 4, 4)))


def expect_bodies(a: Any, b: Any) -> None:
    """Refuse operands that are not bodies."""
    for name, x in (("a", a), ("b", b)):
        if not isinstance(x, (Body, Bodies)):
            advice = "; Body.from_surface or Body.from_mesh makes a body of it" if hasattr(x, "faces") else ""
            raise InputError(f"{name}: expected loewner.Body or loewner.Bodies, found {type(x).__name__}{advice}")


class Plan(NamedTuple):
    """Determines which bodies and poses form the pairs of a batch.

    Attributes
    ----------
    shape : tuple of int
    total : int
    steps : ndarray of int64, shape (5, d)
        The merged shape of the batch, and the strides of a, Ta, b and Tb in rows; see `settle_range` in the kernels.
    rows : ndarray of int64, shape (2, total) or (2, 0)
        Rows of a and of b, if the pairs are listed by row numbers; otherwise empty.
    """

    shape: Lengths
    total: int
    steps: Ints
    rows: Ints = NO_ROWS

    def shaped(self, values: NDArray[Any]) -> Any:
        """Give the values of all pairs the shape of the batch; a single number becomes a Python number."""
        if self.shape == ():
            return values[0].item() if values.ndim == 1 else values[0]
        return values.reshape(self.shape + values.shape[1:])

    def verdicts(self, codes_of_pairs: Verdicts) -> VerdictOrVerdicts:
        """Give verdicts the shape of the batch."""
        return VERDICTS[codes_of_pairs[0]] if self.shape == () else np.asarray(self.shaped(codes_of_pairs))


class _Pairs(NamedTuple):
    """The operands of a query, in the form that the kernels take."""

    plan: Plan
    packs: tuple[Packed, Packed]
    poses: tuple[Floats, Floats]

    @property
    def operands(self) -> Operands:
        """The plan, the rows, and the packs and poses of a and of b, in the order in which the kernels take them."""
        (a, b), (Ta, Tb) = self.packs, self.poses
        return self.plan.steps, self.plan.rows, a.handle, Ta, b.handle, Tb


def plan_of(
    a: Body | Bodies,
    of_poses_a: Lengths,
    b: Body | Bodies,
    of_poses_b: Lengths,
    *,
    each: int = 1,
    chosen: ArrayLike | None = None,
) -> Plan:
    """Determine how bodies and poses broadcast or, for listed pairs, the shape of the batch; see `_prepare`."""
    if chosen is not None:
        return _listed(chosen, a, of_poses_a, b, of_poses_b, each)
    of_a = (len(a),) if isinstance(a, Bodies) else ()
    of_b = (len(b),) if isinstance(b, Bodies) else ()
    parts = {"a": of_a, "T_world_a": of_poses_a[:-2], "b": of_b, "T_world_b": of_poses_b[:-2]}
    shape = _validate.broadcast(parts, PoseError)
    _validate.fits_memory(each * math.prod(shape), f"{shape} pairs")
    strides = [_row_strides(part, len(shape)) for part in parts.values()]
    return Plan(shape, math.prod(shape), _collapse(shape, strides))


def _listed(
    chosen: ArrayLike, a: Body | Bodies, of_poses_a: Lengths, b: Body | Bodies, of_poses_b: Lengths, each: int
) -> Plan:
    """Check pairs that are given by row numbers."""
    rows = _validate.integer_array(chosen, "pairs")
    if rows.ndim == 0 or rows.shape[-1] != 2:
        shape = _validate.shape_text(rows.shape)
        raise InputError(f"pairs: expected row numbers of a and b, shape (..., 2) of integers, found {shape}")
    count = rows.size // 2
    _validate.fits_memory(count * (LIST_BYTES + each), f"{count} pairs")
    flat = np.ascontiguousarray(rows.reshape(-1, 2).T)
    plan = [[flat.shape[1]]]
    for side, (name, bodies, of_T) in enumerate((("a", a, of_poses_a), ("b", b, of_poses_b))):
        if len(of_T) > 3:
            raise PoseError(f"T_world_{name}: expected shape (4, 4) or (n, 4, 4) with pairs, found {of_T}")
        lengths = [len(bodies) if isinstance(bodies, Bodies) else 1, of_T[0] if len(of_T) == 3 else 1]
        n = max(lengths)
        if n != 1 and any(length not in (1, n) for length in lengths):
            raise PoseError(f"{name}: expected as many bodies as poses, or one, found {lengths[0]} and {lengths[1]}")
        wrong = (flat[side] < 0) | (flat[side] >= n) if n > 1 or isinstance(bodies, Bodies) else flat[side] != 0
        if wrong.any():
            raise InputError(
                f"pairs: expected rows of {name} from 0 to {n - 1}, found {flat[side][wrong][0]} in pair "
                f"{int(np.flatnonzero(wrong)[0])}"
            )
        plan += [[int(length > 1)] for length in lengths]
    return Plan(rows.shape[:-1], flat.shape[1], np.array(plan, dtype=np.int64), flat)


def _row_strides(part: Lengths, ndim: int) -> list[int]:
    """Compute an operand's stride, in rows, along each axis of the batch; 0 along axes where the operand repeats."""
    strides = [0] * ndim
    step = 1
    for axis in range(1, len(part) + 1):
        length = part[-axis]
        strides[-axis] = step if length != 1 else 0
        step *= length
    return strides


def _collapse(shape: Lengths, strides: list[list[int]]) -> Ints:
    """Merge neighbouring axes across which every operand has one constant stride; usually one axis remains.

    The first row of the result is the merged shape; a row of strides for each operand follows.
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


def _settle(mode: int, margin: float, pairs: _Pairs, estimate: bool = False) -> tuple[NDArray[np.int8], Ints]:
    """Compute the verdicts of all pairs, and count the pairs of pieces that each tier settled.

    With `estimate`, the product of two contact functions decides the pairs that would otherwise be AMBIGUOUS.
    """
    out = np.empty(pairs.plan.total, dtype=np.int8)

    def run(first: int, last: int) -> Ints:
        tally = settle(mode, margin, first, last, pairs.operands, out)
        if tally is not None:
            if estimate:
                entries.estimate_range(margin, first, last, *pairs.operands, out)
            return tally
        for T, name in zip(pairs.poses, ("T_world_a", "T_world_b"), strict=True):
            _validate.rigid_motions(T, name)
        raise PoseError("expected rigid motions, found poses that changed during the call")

    return out, reduce(np.add, in_shares(run, pairs.plan.total, CHUNK))


# fmt: off
@overload
def classify(
    a: Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *, margin: float = ..., pairs: Rows = ...,
) -> Verdicts: ...
@overload
def classify(
    a: Body, T_world_a: Poses, b: Bodies, T_world_b: Poses, *, margin: float = ..., pairs: Rows = ...,
) -> Verdicts: ...
@overload
def classify(
    a: Body, T_world_a: None, b: Body, T_world_b: None, *, margin: float = ..., pairs: None = ...,
) -> Verdict: ...
@overload
def classify(
    a: Body | Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *, margin: float = ..., pairs: ArrayLike,
) -> Verdicts: ...
@overload
def classify(
    a: Body, T_world_a: Poses, b: Body, T_world_b: Poses, *, margin: float = ..., pairs: Rows = ...,
) -> VerdictOrVerdicts: ...
# fmt: on
def classify(
    a: Body | Bodies,
    T_world_a: Poses,
    b: Body | Bodies,
    T_world_b: Poses,
    *,
    margin: float = 0.0,
    pairs: Rows = None,
) -> VerdictOrVerdicts:
    """Compute the certified verdict for two bodies from their ellipsoids alone.

    Parameters
    ----------
    a, b : Body or Bodies
        A `Bodies` of length n broadcasts with the last batch axis of the poses.
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity.
    margin : float
        Distance in metres that the bodies have to keep. FREE means that the distance of the bodies exceeds `margin`,
        and COLLIDING means that it does not.
    pairs : array_like of int, shape (..., 2), optional
        Pairs to compare, each as a row of a and a row of b; without this argument, bodies and poses broadcast. Row i of
        a is body i at pose i; a single body or a single pose serves all rows. Bodies and poses are not copied. To
        compare each of n bodies with each of m bodies, pass ``np.indices((n, m)).T``; the result has shape (m, n).

    Returns
    -------
    Verdict, or ndarray of int8, shape (...)
        FREE and COLLIDING are proven, with all rounding errors accounted for (docs/certified.md). Two bodies are FREE
        only if all pairs of their pieces are FREE, and COLLIDING if any pair of pieces is COLLIDING.

    Raises
    ------
    PoseError
        If the shape of a pose does not end in (4, 4), a pose is not a rigid motion, or batches do not broadcast.
    InputError
        If an operand is not a body, or the margin is negative or not finite.

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
    code: int | None = singles.classify(Body, a, T_world_a, b, T_world_b, margin, pairs)
    if code is not None:
        return VERDICTS[code]
    keep = _validate.positive_scalar(margin, "margin", zero=True)
    return _classified(keep, a, T_world_a, b, T_world_b, pairs)


@guarded
def _classified(margin: float, a: Any, T_world_a: Any, b: Any, T_world_b: Any, chosen: Any) -> VerdictOrVerdicts:
    pairs = _prepare(a, T_world_a, b, T_world_b, check=False, chosen=chosen)
    out, _ = _settle(codes.CERTIFY, margin, pairs)
    return pairs.plan.verdicts(out)


# fmt: off
@overload
def collide(
    a: Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *,
    method: str = ..., margin: float = ..., pairs: Rows = ...,
) -> Bools: ...
@overload
def collide(
    a: Body, T_world_a: Poses, b: Bodies, T_world_b: Poses, *,
    method: str = ..., margin: float = ..., pairs: Rows = ...,
) -> Bools: ...
@overload
def collide(
    a: Body, T_world_a: None, b: Body, T_world_b: None, *, method: str = ..., margin: float = ..., pairs: None = ...,
) -> bool: ...
@overload
def collide(
    a: Body | Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *,
    method: str = ..., margin: float = ..., pairs: ArrayLike,
) -> Bools: ...
@overload
def collide(
    a: Body, T_world_a: Poses, b: Body, T_world_b: Poses, *, method: str = ..., margin: float = ..., pairs: Rows = ...,
) -> BoolOrBools: ...
# fmt: on
def collide(
    a: Body | Bodies,
    T_world_a: Poses,
    b: Body | Bodies,
    T_world_b: Poses,
    *,
    method: str = "exact",
    margin: float = 0.0,
    pairs: Rows = None,
) -> BoolOrBools:
    """Decide whether two bodies touch, overlap, or come within `margin` of each other.

    Parameters
    ----------
    a, b : Body or Bodies
        A `Bodies` of length n broadcasts with the last batch axis of the poses.
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity.
    method : {"exact", "estimate"}
        Both methods first use the certificate. For ambiguous pairs, "exact" then searches on the pieces themselves.
        Instead of this search, "estimate" guesses the answer in O(1), from the product of two contact functions, one
        for the inner and one for the outer ellipsoids. The guess is wrong for some pairs (docs/theory/estimate.md).
    margin : float
        Distance in metres up to which pairs count as colliding.
    pairs : array_like of int, shape (..., 2), optional
        As for `classify`.

    Returns
    -------
    bool, or ndarray of bool, shape (...)
        Touching counts as colliding. With "exact", False is proven. True is proven up to rounding (docs/certified.md):
        bodies that are apart by less than about 1e-12 of the lengths involved may count as touching, possibly only if
        they are passed in one of the two orders.

    Raises
    ------
    PoseError, InputError
        As for `classify`.
    UnknownNameError
        If `method` is not one of the names above.
    ConvergenceError
        If the exact search could not settle a pair; such a pair is never reported as free.

    References
    ----------
    The paper, section 4; Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083.

    Examples
    --------
    >>> from loewner import Body, collide
    >>> collide(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), None)
    True
    """
    is_colliding: bool | None = singles.collide(Body, a, T_world_a, b, T_world_b, method, margin, pairs)
    if is_colliding is not None:
        return is_colliding
    exact = _validate.choice(method, "method", METHODS) == "exact"
    keep = _validate.positive_scalar(margin, "margin", zero=True)
    collisions, unsettled = decided(exact, keep, a, T_world_a, b, T_world_b, pairs)
    _expect_settled(unsettled, "collide", collisions)
    return collisions


@guarded
def decided(
    exact: bool, margin: float, a: Any, T_world_a: Any, b: Any, T_world_b: Any, chosen: Any = None
) -> tuple[BoolOrBools, Bools]:
    """Decide whether bodies collide; unsettled pairs count as colliding, and a flat array marks them."""
    pairs = _prepare(a, T_world_a, b, T_world_b, check=False, each=COLLIDE_BYTES, chosen=chosen)
    out, _ = _settle(codes.EXACT if exact else codes.CERTIFY, margin, pairs, estimate=not exact)
    # Compare with a plain number. With a `Verdict`, NumPy would call the enumeration's Python code, and drop an
    # interrupt that occurs in this code.
    unsettled = out == codes.AMBIGUOUS
    return pairs.plan.shaped((out == codes.COLLIDING) | unsettled), unsettled


# fmt: off
@overload
def distance(
    a: Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *, exact: Literal[False] = ..., pairs: Rows = ...,
) -> Bounds[Floats]: ...
@overload
def distance(
    a: Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *, exact: Literal[True], pairs: Rows = ...,
) -> Measured[Floats]: ...
@overload
def distance(
    a: Body, T_world_a: Poses, b: Bodies, T_world_b: Poses, *, exact: Literal[False] = ..., pairs: Rows = ...,
) -> Bounds[Floats]: ...
@overload
def distance(
    a: Body, T_world_a: Poses, b: Bodies, T_world_b: Poses, *, exact: Literal[True], pairs: Rows = ...,
) -> Measured[Floats]: ...
@overload
def distance(
    a: Body, T_world_a: None, b: Body, T_world_b: None, *, exact: Literal[False] = ..., pairs: None = ...,
) -> Bounds[float]: ...
@overload
def distance(
    a: Body, T_world_a: None, b: Body, T_world_b: None, *, exact: Literal[True], pairs: None = ...,
) -> Measured[float]: ...
@overload
def distance(
    a: Body | Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *,
    exact: Literal[False] = ..., pairs: ArrayLike,
) -> Bounds[Floats]: ...
@overload
def distance(
    a: Body | Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *, exact: Literal[True], pairs: ArrayLike,
) -> Measured[Floats]: ...
@overload
def distance(
    a: Body, T_world_a: Poses, b: Body, T_world_b: Poses, *, exact: Literal[False] = ..., pairs: Rows = ...,
) -> Bounds[FloatOrFloats]: ...
@overload
def distance(
    a: Body, T_world_a: Poses, b: Body, T_world_b: Poses, *, exact: Literal[True], pairs: Rows = ...,
) -> Measured[FloatOrFloats]: ...
@overload
def distance(
    a: Body | Bodies, T_world_a: Poses, b: Body | Bodies, T_world_b: Poses, *, exact: bool, pairs: Rows = ...,
) -> Distance: ...
# fmt: on
def distance(
    a: Body | Bodies,
    T_world_a: Poses,
    b: Body | Bodies,
    T_world_b: Poses,
    *,
    exact: bool = False,
    pairs: Rows = None,
) -> Distance:
    """Compute proven bounds on the signed distance of two bodies and, with ``exact=True``, the distance itself.

    Parameters
    ----------
    a, b : Body or Bodies
    T_world_a, T_world_b : array_like, shape (..., 4, 4), or None
        Poses, broadcast together; translation in metres. None is the identity.
    exact : bool
        Whether to compute the distance or penetration depth, witnesses and normal as well.
    pairs : array_like of int, shape (..., 2), optional
        As for `classify`.

    Returns
    -------
    Distance
        The distance is positive for separate bodies, zero for touching bodies, and negative for overlapping bodies. The
        signed distance of two bodies is the least signed distance of any two pieces; `Distance` explains what a depth
        means.

    Raises
    ------
    PoseError, InputError
        As for `classify`, and if `exact` is neither True nor False.
    ConvergenceError
        If an exact distance could not be computed to within 1e-9 of the lengths involved. For ellipsoids with axis
        ratios beyond about 5e7, this happens for one pair in twenty. (The penetration depth of cylinders, cones and
        capsules is never less than the true depth. If many directions tie, the depth is only proven to within 1e-3.)

    Examples
    --------
    >>> from loewner import Body, distance
    >>> T = np.eye(4)
    >>> T[0, 3] = 3.0
    >>> round(distance(Body.sphere(1.0), None, Body.sphere(0.5), T, exact=True).distance, 12)
    1.5
    """
    measurement: Distance | None = singles.distance(Body, Distance, a, T_world_a, b, T_world_b, exact, pairs)
    if measurement is not None:
        return measurement
    distances, unsettled = measured(a, T_world_a, b, T_world_b, _validate.flag(exact, "exact"), pairs)
    _expect_settled(unsettled, "distance", distances)
    return distances


@guarded
def push(T_world_body: Poses, wrench: ArrayLike, *, radius: float) -> Floats:
    """Move bodies along wrenches: a step of gradient ascent on distances, or on functions of distances.

    Each body is translated by the force of its wrench. It also turns about its own origin; the rotation vector is the
    moment about this origin, divided by the squared radius. To first order, a distance with this wrench grows by f² +
    m² / r², where f is the force, m the moment, and r the radius.

    Parameters
    ----------
    T_world_body : array_like, shape (..., 4, 4), or None
        Poses; translation in metres. None is the identity.
    wrench : array_like, shape (..., 6)
        A `Distance.wrench`, or sums and multiples of such wrenches: a force [m], and a moment about the world's origin
        [m²]. For the first body of a distance, use the negative wrench.
    radius : float
        Typical distance, in metres, of a body's points from its origin. At this distance, rotations count as much as
        translations.

    Returns
    -------
    ndarray, shape (..., 4, 4)
        The new poses.

    Raises
    ------
    PoseError
        If a pose is not a rigid motion.
    InputError
        If a wrench is not finite, the shapes do not broadcast, or a step overflows.

    Examples
    --------
    >>> from loewner import Body, distance, push
    >>> floor, brick, T = Body.box([4, 4, 1]), Body.box([1, 0.5, 0.25]), np.eye(4)
    >>> for _ in range(60):
    ...     found = distance(floor, None, brick, T, exact=True)
    ...     T = push(T, 0.3 * max(0.01 - found.distance, 0.0) * found.wrench, radius=0.5)
    >>> round(distance(floor, None, brick, T, exact=True).distance, 3)
    0.01
    """
    T = _validate.poses(T_world_body, "T_world_body")
    w, length = _validate.finite_array(wrench, "wrench", ("...", 6)), _validate.positive_scalar(radius, "radius")
    shape = _validate.broadcast({"T_world_body": T.shape[:-2], "wrench": w.shape[:-1]})
    moved = np.array(np.broadcast_to(T, (*shape, 4, 4)))
    with np.errstate(over="ignore", invalid="ignore"):
        half = (w[..., 3:] - np.cross(T[..., :3, 3], w[..., :3])) / length / length / 2
        angle = np.linalg.norm(half, axis=-1, keepdims=True)
        share = np.divide(np.sin(angle), angle, out=np.ones_like(angle), where=angle > 0)
        turn = np.concatenate([np.cos(angle), share * half], axis=-1)
        moved[..., :3, 3] += w[..., :3]
        moved[..., :3, :3] = rotations_of(turn) @ moved[..., :3, :3]
    if not np.isfinite(moved).all():
        raise InputError("wrench: expected forces and moments that lead to finite poses, found an overflow")
    return moved


@guarded
def measured(a: Any, T_world_a: Any, b: Any, T_world_b: Any, exact: bool, chosen: Any = None) -> tuple[Distance, Bools]:
    """Compute bounds on distances and, with `exact`, the distances.

    A flat array marks unsettled pairs, whose distances are NaN.
    """
    pairs = _prepare(a, T_world_a, b, T_world_b, check=True, each=EXACT_BYTES if exact else BOUND_BYTES, chosen=chosen)
    *answers, unsettled = measure(exact, pairs.plan.total, pairs.operands)
    return Distance(*map(pairs.plan.shaped, answers if exact else answers[:3])), unsettled


@guarded
def _expect_settled(unsettled: Bools, query: str, partial: Any) -> None:
    """Raise an error, instead of guessing, if arithmetic could not settle some pairs."""
    indices = np.flatnonzero(unsettled)
    if len(indices):
        raise ConvergenceError(
            f"{query}: {len(indices)} of {unsettled.size} pairs could not be settled, the first at flat index "
            f"{indices[0]}; treat them as colliding, or change their poses slightly (the error's `indices` name them, "
            "and its `partial` has the answers for all other pairs)",
            indices,
            partial,
        )
