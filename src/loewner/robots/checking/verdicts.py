"""Compute verdicts for configurations and sampled motions.

The checker, not this module, raises an error for AMBIGUOUS.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._pictures import pictured, shares
from loewner._base._threads import in_shares
from loewner._base._validate import Bools, Floats, Ints, OneOrMany
from loewner._base._workspaces import workspace
from loewner._kernels import codes
from loewner._native import entries
from loewner.errors import ConvergenceError
from loewner.queries import pairs as queries
from loewner.queries._settle import settle
from loewner.robots.checking import edges
from loewner.robots.checking.problem import LEAST_SHARE, Problem
from loewner.robots.description.robot import interpolated
from loewner.scenes.scene import Contact


@dataclass(frozen=True)
class Settled:
    """Numbers of configurations, by the kind of test that settled them.

    Attributes
    ----------
    free_by_bounds, free_by_ellipsoids, free_by_planes, free_by_search : int
        Numbers of free configurations, by the costliest test that any pair needed. The tests are, in order: bounding
        spheres and boxes; outer ellipsoids; planes between the pieces themselves, perpendicular to the contact normal
        of the ellipsoids; and the exact search.
    colliding_by_ellipsoids, colliding_by_search : int
        Numbers of colliding configurations, found by inner ellipsoids or by the exact search.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> settled = CollisionChecker(robot).tiers(robot.random_configurations(100))
    >>> settled.total, settled.colliding
    (100, 0)
    """

    free_by_bounds: int
    free_by_ellipsoids: int
    free_by_planes: int
    free_by_search: int
    colliding_by_ellipsoids: int
    colliding_by_search: int

    @pictured
    def _repr_html_(self) -> str:
        return shares(asdict(self))

    @property
    def total(self) -> int:
        """Total number of configurations."""
        return self.free + self.colliding

    @property
    def free(self) -> int:
        """Number of configurations without contact."""
        return self.free_by_bounds + self.free_by_ellipsoids + self.free_by_planes + self.free_by_search

    @property
    def colliding(self) -> int:
        """Number of configurations with contact."""
        return self.colliding_by_ellipsoids + self.colliding_by_search


class Verdicts(NamedTuple):
    """Verdicts of N configurations.

    Attributes
    ----------
    verdicts : ndarray of int8, shape (N,)
        AMBIGUOUS if nothing could be proven. In mode EXACT, a verdict is AMBIGUOUS only if arithmetic could not settle
        the configuration.
    tiers : ndarray of int8, shape (N,)
        The costliest test that each configuration needed, as numbered in `codes`.
    """

    verdicts: NDArray[np.int8]
    tiers: NDArray[np.int8]

    def counted(self) -> Settled:
        """Count the settled configurations by tier."""
        free = np.bincount(self.tiers[self.verdicts == codes.FREE], minlength=codes.TIERS).tolist()
        hit = np.bincount(self.tiers[self.verdicts == codes.COLLIDING], minlength=codes.TIERS).tolist()
        return Settled(
            free_by_bounds=free[codes.BY_SPHERE],
            free_by_ellipsoids=free[codes.BY_OUTER],
            free_by_planes=free[codes.BY_PLANE],
            free_by_search=free[codes.BY_SEARCH],
            colliding_by_ellipsoids=hit[codes.BY_INNER],
            colliding_by_search=hit[codes.BY_SEARCH],
        )


def classified(ready: Problem, mode: int, Q: Floats) -> Verdicts:
    """Compute verdicts of configurations, shape (N, dof), in mode `codes.CERTIFY` or `codes.EXACT`."""
    total = len(Q)
    if total > LEAST_SHARE:
        _validate.fits_memory(2 * total, f"{total} configurations")
    out, tiers = np.empty(total, dtype=np.int8), np.empty(total, dtype=np.int8)

    memory = ready.memory(entries.memory_size)

    def run(first: int, last: int, hits: Ints) -> None:
        entries.check_configurations(
            mode, first, last, Q, ready.packed.handle, ready.handle, out, tiers, hits, workspace(memory)
        )

    def share(first: int, last: int) -> None:
        # Each call has its own counts, since threads that write to the same memory slow each other down.
        hits = np.zeros_like(ready.hits)
        run(first, last, hits)
        np.add(ready.hits, hits, out=ready.hits)

    if total <= LEAST_SHARE:
        run(0, total, ready.hits)
    else:
        in_shares(share, total, LEAST_SHARE)
    if mode == codes.EXACT:
        for k in _ambiguous(out):
            of_pairs = verdicts_at(ready, Q[k])
            worst = (verdict for verdict in (codes.COLLIDING, codes.AMBIGUOUS) if verdict in of_pairs)
            out[k], tiers[k] = next(worst, codes.FREE), codes.BY_SEARCH
    return Verdicts(out, tiers)


def free(ready: Problem, Q: Floats) -> Bools:
    """Return which configurations, shape (N, dof), are proven free; unsettled configurations do not count as free."""
    return np.asarray(classified(ready, codes.EXACT, Q).verdicts == codes.FREE)


def is_free(ready: Problem, q: Floats) -> bool:
    """Return, in the fastest way, whether one configuration, shape (dof,), is proven free."""
    collides = ready.single.collide(q)
    return bool(free(ready, q[None].copy())[0]) if collides is None else not collides


def is_sampled_free(ready: Problem, a: Floats, b: Floats, step: float) -> bool:
    """Return whether one motion is proven free at samples at most `step` apart; False if a sample is unsettled."""
    settled = ready.single.motion(a, b, step, edges.coarse_first)
    if settled is None:
        return bool(sampled(ready, a[None], b[None], step)[0][0] == codes.FREE)
    return bool(settled > 0)


def expect_settled(ready: Problem, Q: Floats, verdicts: NDArray[np.int8]) -> None:
    """Raise an error if any verdict is AMBIGUOUS.

    Raises
    ------
    ConvergenceError
        The message names the pair and the configuration.
    """
    for k in _ambiguous(verdicts)[:1]:
        expect_pairs_settled(ready, Q[k], verdicts_at(ready, Q[k]))


def sampled(ready: Problem, a: Floats, b: Floats, step: float) -> tuple[NDArray[np.int8], Floats]:
    """Compute verdicts of motions between configurations a and b, shape (N, dof) each, at samples at most `step` apart.

    Returns
    -------
    verdicts : ndarray of int8, shape (N,)
        FREE if all samples are free.
    fractions : ndarray, shape (N,)
        Fraction of the motion at which a sample is not free; NaN if FREE.

    Raises
    ------
    InputError
        If a motion is divided into more than `edges.MOST_STEPS` steps.
    """
    parts = edges.steps(lengths(ready, a, b, step), step)
    verdicts, fractions = np.full(len(a), codes.FREE, dtype=np.int8), np.full(len(a), np.nan)
    free = np.ones(len(a), dtype=bool)
    for edge, at in edges.rounds(parts, free):
        out = classified(ready, codes.EXACT, interpolated(ready.robot, a[edge], b[edge], at[:, None])).verdicts
        for verdict in (codes.AMBIGUOUS, codes.COLLIDING):  # a collision takes precedence
            rows = np.flatnonzero(out == verdict)
            verdicts[edge[rows]], fractions[edge[rows]] = verdict, at[rows]
        free[:] = verdicts == codes.FREE
    return verdicts, fractions


def verdicts_at(ready: Problem, q: Floats) -> NDArray[np.int8]:
    """Compute the verdict of every pair at a configuration, shape (dof,); see `pair_verdicts`."""
    return pair_verdicts(ready, ready.poses(q[None])[0])


def pair_verdicts(ready: Problem, T: Floats, off: Floats | None = None) -> NDArray[np.int8]:
    """Compute the verdict of every pair at the poses T: AMBIGUOUS if it is unsettled, or if overflow distorts T.

    Margins are increased by `off`, shape (pairs,).
    """
    groups = ready.grouped(ready.margins + off) if off is not None and off.any() else ready.by_margin
    pack, verdicts = ready.packed.handle, np.full(len(ready.pairs), codes.AMBIGUOUS, dtype=np.int8)
    for margin, at, plan, rows in groups:
        group_verdicts = np.empty(len(at), dtype=np.int8)
        if settle(codes.EXACT, margin, 0, len(at), (plan, rows, pack, T, pack, T), group_verdicts) is not None:
            verdicts[at] = group_verdicts
    return verdicts


def collisions_by_pair(ready: Problem, Q: Floats, t: Floats | None = None) -> Bools:
    """Return whether each pair collides at each configuration, shape (N, pairs), or raise a ConvergenceError.

    Bodies that follow motions may deviate from their poses by the bounds for the times t, shape (N,).
    """
    _validate.fits_memory(len(Q) * len(ready.pairs), f"{len(Q)} configurations of {len(ready.pairs)} pairs of bodies")
    out = np.empty((len(Q), len(ready.pairs)), dtype=bool)
    for first, poses in ready.poses_in_turn(Q):
        for at, T in enumerate(poses, first):
            verdicts = pair_verdicts(ready, T, None if t is None else ready.off_at(float(t[at])))
            expect_pairs_settled(ready, Q[at], verdicts)
            out[at] = verdicts == codes.COLLIDING
    return out


def always(ready: Problem, Q: Floats) -> Bools:
    """Return which pairs collide at every given configuration, shape (pairs,); unsettled pairs do not count."""
    colliding = np.ones(len(ready.pairs), dtype=bool)
    for _, poses in ready.poses_in_turn(Q):
        for T in poses:
            colliding &= pair_verdicts(ready, T) == codes.COLLIDING
    return colliding


def expect_pairs_settled(ready: Problem, q: Floats, verdicts: NDArray[np.int8]) -> None:
    """Raise an error if any pair's verdict at a configuration is AMBIGUOUS.

    Raises
    ------
    ConvergenceError
        The message names the pair and the configuration.
    """
    for pair in _ambiguous(verdicts)[:1]:
        raise ConvergenceError(unsettled(ready, int(pair), q))


def unsettled(ready: Problem, pair: int, q: Floats) -> str:
    """Return the message for a pair that could not be settled at a configuration."""
    a, b = (ready.names[k] for k in ready.pairs[pair])
    return (
        f"collide: {a} and {b} could not be settled at configuration {np.array2string(q, precision=17)}; treat it "
        "as colliding or change it slightly"
    )


def contacts(ready: Problem, q: Floats, t: float | None = None) -> tuple[tuple[Contact, ...], str]:
    """Return the pairs that collide at a configuration and a time, and a message if any pair could not be settled."""
    T = ready.poses(q[None])[0]
    verdicts = pair_verdicts(ready, T, None if t is None else ready.off_at(t))
    a, b = ready.pairs[verdicts == codes.COLLIDING].T
    distances = queries.distance(ready.bodies[a], T[a], ready.bodies[b], T[b], exact=True)
    names = ((ready.names[i], ready.names[j]) for i, j in zip(a, b, strict=True))
    doubt = "".join(unsettled(ready, int(pair), q) for pair in _ambiguous(verdicts)[:1])
    return Contact.from_distances(names, distances), doubt


def lengths(ready: Problem, a: Floats, b: Floats, step: float) -> Floats:
    """Compute the lengths of motions; a length whose last bit may change the number of steps is computed separately."""
    motion_lengths = np.asarray(ready.robot._distances(a, b))
    if ready.robot.runs_straight:
        with np.errstate(over="ignore"):
            quotients = motion_lengths / step
        for k in edges.nearly_whole(quotients):
            motion_lengths[k] = ready.robot._distances(a[k], b[k])
    return motion_lengths


def _ambiguous(verdicts: NDArray[np.int8]) -> Ints:
    """Return the indices of AMBIGUOUS verdicts; there is a fast path for a single verdict."""
    if len(verdicts) == 1 and verdicts[0] != codes.AMBIGUOUS:
        return _NOWHERE
    return np.flatnonzero(verdicts == codes.AMBIGUOUS)


_NOWHERE = np.empty(0, dtype=np.int64)


def collisions(out: NDArray[np.int8], Q: Floats) -> OneOrMany:
    """Convert verdicts of configurations to booleans that are true for collisions."""
    return bool(out[0]) if Q.ndim == 1 else (out == codes.COLLIDING).reshape(Q.shape[:-1])
