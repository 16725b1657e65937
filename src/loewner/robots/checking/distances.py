"""Compute a robot's distances from obstacles and itself, for the nearest pair or all close pairs, with gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._threads import in_shares
from loewner._base._validate import Floats, Ints, OneOrMany
from loewner._base._workspaces import workspace
from loewner._native import entries
from loewner.errors import ConvergenceError, InputError
from loewner.queries import pairs as queries
from loewner.queries.pairs import NOTHING, Exact, Vector
from loewner.robots.checking.edges import flat
from loewner.robots.checking.problem import LEAST_SHARE, Problem


@dataclass(frozen=True, eq=False, repr=False)
class StateDistance(_validate.Brief, Generic[Exact, Vector]):
    """Signed distance of a robot from contact, in metres, at one or many configurations; a negative value is a depth.

    Attributes
    ----------
    lower, upper : float or ndarray
        Certified bounds from the ellipsoids: over all checked pairs, the minimum of the lower bounds and the minimum of
        the upper bounds.
    distance : float or ndarray, or None
        With ``exact=True``: the distance of the nearest pair, or minus the depth of the deepest pair.
    names : tuple of str, or ndarray of str, shape (..., 2), or None
        Names of the two bodies of the nearest (or deepest) pair.
    witness_a, witness_b, normal : ndarray, shape (..., 3), or None
        Witnesses and normal of the same pair; see `Distance`.
    gradient : ndarray, shape (..., dof), or None
        With ``gradient=True``: the derivative of the distance with respect to the configuration.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> found = CollisionChecker(Robot.from_urdf("arm.urdf"), scene).distance([0.5, 0.0], exact=True)
    >>> found.names, round(found.distance, 9), found.lower <= found.distance <= found.upper
    (('rail', 'post'), 0.35, True)
    """

    lower: OneOrMany
    upper: OneOrMany
    distance: Exact = NOTHING
    names: Exact = NOTHING
    witness_a: Vector = NOTHING
    witness_b: Vector = NOTHING
    normal: Vector = NOTHING
    gradient: Vector = NOTHING


@dataclass(frozen=True, eq=False, repr=False)
class PairDistances(_validate.Brief):
    """Pairs of bodies that are close to each other, with one entry per pair and configuration.

    Attributes
    ----------
    configuration : ndarray of int64, shape (M,)
        Index of the configuration in the query.
    pair : ndarray of int64, shape (M,)
        Index of the pair in `CollisionChecker.checked_pairs`.
    names : ndarray of str, shape (M, 2)
    distance : ndarray, shape (M,)
        Distances in metres; a negative value is a depth: see `Distance`.
    witness_a, witness_b, normal : ndarray, shape (M, 3)
    gradient : ndarray, shape (M, dof), or None
        With ``gradient=True``: the derivative of the distance with respect to the configuration.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> near = CollisionChecker(Robot.from_urdf("arm.urdf"), scene).distance_by_pair([0.5, 0.0], within=0.4)
    >>> len(near), near.names, near.distance.round(6)
    (1, array([['rail', 'post']], dtype='<U7'), array([0.35]))
    """

    configuration: Ints
    pair: Ints
    names: NDArray[np.str_]
    distance: Floats
    witness_a: Floats
    witness_b: Floats
    normal: Floats
    gradient: Floats | None = None

    def __len__(self) -> int:
        return len(self.distance)


def nearest(ready: Problem, configurations: Floats, exact: bool, gradient: bool) -> StateDistance:
    """Compute the nearest pair and its distance at each configuration; see `CollisionChecker.distance`."""
    batch, Q = configurations.shape[:-1], flat(configurations)
    expect_pairs(ready, "distance")
    row = 16 + exact * (8 + 3 * 24 + 2 * 4 * max(map(len, ready.names))) + gradient * 8 * ready.robot.dof
    _validate.fits_memory(2 * len(Q) * row, f"distances of {len(Q)} configurations")
    columns = nearest_columns(ready, Q, exact)
    if ready.given is not None:  # the bounds are for all poses within the errors, the distance for the given poses
        bounds = [np.add(nearest_columns(one, Q, False), [[-error], [error]]) for error, one in ready.by_error]
        columns[0], columns[1] = np.min(bounds, axis=0)
    if gradient:
        columns.append(gradients(ready, Q, *(columns[k] for k in (3, 4, 6))))
    if exact:
        columns[3] = np.array(ready.names)[columns[3]]
    if batch:
        return StateDistance(*(c.reshape(batch + c.shape[1:]) for c in columns))
    return StateDistance(
        *(float(c[0]) if c.ndim == 1 else tuple(c[0].tolist()) if c.dtype.kind == "U" else c[0] for c in columns)
    )


def expect_pairs(ready: Problem, query: str) -> None:
    """Refuse a query if there are no pairs to check."""
    if len(ready.pairs) == 0:
        raise InputError(f"{query}: expected a robot and a scene with pairs to check, found none")


def _run(kernel: Any, needed: Any, options: tuple[float, ...], ready: Problem, Q: Floats, *out: Any) -> None:
    """Run a kernel on all configurations, in several threads; `needed` computes the size of each thread's memory."""
    memory = ready.memory(needed)

    def share(first: int, last: int) -> None:
        kernel(*options, first, last, Q, ready.packed.handle, ready.handle, workspace(memory), *out)

    in_shares(share, len(Q), LEAST_SHARE)


def nearest_columns(ready: Problem, Q: Floats, exact: bool, *, care: bool = True) -> list[Any]:
    """Compute the columns of `nearest` without the gradient, with indices of bodies instead of names.

    Without `care`, distances that the fast searches cannot determine are NaN.
    """
    n, m, pack = len(Q), len(Q) * exact, ready.packed
    numbers, vectors = np.empty((2 + exact, n)), np.empty((3, m, 3))
    pieces, status = np.empty((m, 2), dtype=np.int64), np.empty(m, dtype=np.int8)

    _run(entries.nearest_pairs, entries.memory_of_nearest, (exact,), ready, Q, numbers, vectors, pieces, status)
    if not exact:
        return list(numbers)
    lower, upper, distance = numbers
    # The bounds are proven, but the value has rounding errors, so clamp the value to the bounds.
    np.maximum(lower, np.minimum(distance, upper, out=distance), out=distance)
    bodies = np.searchsorted(pack.piece_start, pieces, side="right") - 1
    if not care:
        distance[status != 0] = np.nan
        return [lower, upper, distance, bodies, *vectors]
    for k in np.flatnonzero(status):
        distance[k], bodies[k], *vectors[:, k] = _nearest_with_care(ready, Q[k])
    return [lower, upper, distance, bodies, *vectors]


def near_pairs(ready: Problem, Q: Floats, within: float) -> Ints:
    """List (configuration, pair), except for pairs that balls and boxes prove to be more than `within` apart."""
    listed = np.empty((max(64, 4 * len(Q)), 2), dtype=np.int64)
    memory = workspace(ready.memory(entries.memory_of_nearest))
    while True:
        operands = within, 0, len(Q), Q, ready.packed.handle, ready.handle, memory
        count = entries.near_pairs(*operands, listed, 0)
        if count <= len(listed):
            rows = listed[:count]
            return rows[np.lexsort((rows[:, 1], rows[:, 0]))]
        _validate.fits_memory(16 * count, f"{count} pairs")
        listed = np.empty((count, 2), dtype=np.int64)


def gradients(ready: Problem, Q: Floats, bodies: Ints, witness: Floats, normal: Floats) -> Floats:
    """Differentiate the exact distances of pairs of bodies with respect to the configuration, one gradient per pair."""
    slopes = np.empty((len(Q), ready.robot.dof))
    _run(entries.pair_gradients, entries.memory_of_clearances, (), ready, Q, bodies, normal, witness, slopes)
    return slopes


def by_pair(ready: Problem, Q: Floats, within: float, gradient: bool) -> PairDistances:
    """Compute the exact distances of all pairs that are close enough; see `CollisionChecker.distance_by_pair`."""
    listed = near_pairs(ready, Q, within)
    _validate.fits_memory(len(listed) * 256, f"distances of {len(listed)} pairs")
    distance, vectors = np.empty(len(listed)), [np.empty((len(listed), 3)) for _ in range(3)]
    for first, T in ready.poses_in_turn(Q):
        start, stop = np.searchsorted(listed[:, 0], [first, first + len(T)])
        for p in np.unique(listed[start:stop, 1]):
            rows = start + np.flatnonzero(listed[start:stop, 1] == p)
            at, (a, b) = listed[rows, 0] - first, (int(body) for body in ready.pairs[p])
            gaps = queries.distance(ready.body(a), T[at, a], ready.body(b), T[at, b], exact=True)
            distance[rows] = gaps.distance
            for column, values in zip(vectors, (gaps.witness_a, gaps.witness_b, gaps.normal), strict=True):
                column[rows] = values
    near = distance <= within
    listed, distance, vectors = listed[near], distance[near], [column[near] for column in vectors]
    bodies = ready.pairs[listed[:, 1]]
    slopes = gradients(ready, Q[listed[:, 0]], bodies, vectors[0], vectors[2]) if gradient else None
    names = np.array(ready.names)[bodies]
    return PairDistances(listed[:, 0], listed[:, 1], names, distance, vectors[0], vectors[1], vectors[2], slopes)


def clearances(ready: Problem, Q: Floats, softness: float, gradient: bool) -> tuple[Floats, Floats]:
    """Compute smooth lower bounds on distances, and their gradients; see `CollisionChecker.clearance`.

    Raises
    ------
    ConvergenceError
        If squares of positions overflow.
    """
    expect_pairs(ready, "clearance")
    if ready.given is not None:
        return _for_all_errors(ready, Q, softness, gradient)
    ready = ready.in_open_parts
    n, dof = Q.shape
    _validate.fits_memory(8 * n * (1 + gradient * dof), f"clearances of {n} configurations")
    lower, slopes = np.empty(n), np.empty((n * gradient, dof))
    _run(entries.clearances, entries.memory_of_clearances, (gradient, softness), ready, Q, lower, slopes)
    if not np.isfinite(lower).all():
        q = np.array2string(Q[np.argmin(np.isfinite(lower))], precision=17)
        raise ConvergenceError(f"clearance: positions overflow at configuration {q}")
    return lower, slopes


def _for_all_errors(ready: Problem, Q: Floats, softness: float, gradient: bool) -> tuple[Floats, Floats]:
    """Compute `clearances` for all poses within the errors: subtract from each group's clearance the group's error."""
    parts = [(error, clearances(one.as_given, Q, softness, gradient)) for error, one in ready.by_error]
    each = np.array([lower - error for error, (lower, _) in parts])
    least = each.min(axis=0)
    shares = np.exp((least - each) / softness)
    total = shares.sum(axis=0)
    lower = least - softness * np.log(total)
    slopes = sum(
        share[:, None] * slope for share, (_, (_, slope)) in zip(shares / total, parts, strict=True) if gradient
    )
    roundings = 2.0**-48 * (np.abs(each).max(axis=0) + softness * (1.0 + np.log(len(parts))))
    return lower - roundings, np.asarray(slopes) if gradient else np.empty((0, Q.shape[1]))


def _nearest_with_care(ready: Problem, q: Floats) -> tuple[Any, ...]:
    """Find the nearest pair, one pair at a time, at a configuration where the fast searches failed."""
    T = ready.poses(q[None])[0]
    a, b = ready.pairs.T
    bounds = queries.distance(ready.bodies[a], T[a], ready.bodies[b], T[b])
    best, nearest, gap = np.inf, 0, None
    for p in np.argsort(bounds.lower, kind="stable"):
        if bounds.lower[p] > min(best, bounds.upper.min()):
            break
        i, j = (int(body) for body in ready.pairs[p])
        one = queries.distance(ready.body(i), T[i], ready.body(j), T[j], exact=True)
        if one.distance < best:
            best, nearest, gap = one.distance, int(p), one
    assert gap is not None  # the first lower bound is below all upper bounds
    return best, ready.pairs[nearest], gap.witness_a, gap.witness_b, gap.normal
