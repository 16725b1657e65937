"""Find when a robot on a curve first touches something: a time until which it is proven free, and a time of contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from loewner._base import _validate
from loewner._base._validate import Floats, Ints
from loewner._kernels import codes
from loewner.queries.pairs import Verdict
from loewner.robots.checking import verdicts
from loewner.robots.checking.problem import Problem
from loewner.robots.proofs import in_time
from loewner.robots.proofs.contacts import distance_at, distances_at, stages
from loewner.robots.proofs.courses import CURVE_ROUNDINGS, elevated, parts
from loewner.robots.proofs.curves import MEASURED, Curve, configurations_at, curves_of, cut_in_time, expect_short
from loewner.robots.proofs.proofs import prove

# Number of parts into which an unproven piece is cut, and the largest number of successive cuts.
PARTS = 8
MOST_CUTS = 17  # after more cuts, two fractions of a piece may be equal

# Share of the tolerance that is left to the proof.
FOR_PROOF = 0.25


@dataclass(frozen=True, eq=False, repr=False)
class TrajectoryContact(_validate.Brief):
    """When a robot on a curve first touches something.

    Attributes
    ----------
    verdict : Verdict
        FREE: proven free at every instant of the curve. COLLIDING: the robot collides at `touching_at`, which may be
        rounded. AMBIGUOUS: the robot comes within the tolerance of contact at `free_until`, and no collision is known.
    free_until : float
        Seconds; inf if FREE. At every real time from the start of the curve until this time, every pair is proven to be
        farther apart than its margin, or in contact as `Scene.leave` or `Scene.reach` allows. At `free_until`, the pair
        is within the tolerance of its margin, or of the depth that the rule allows.
    touching_at : float
        Seconds; the earliest time of a known collision, or inf if no collision is known. This time exceeds `free_until`
        by the time that the pair needs to cross the tolerance, unless the pair grazes before it collides.
    names : tuple of str
        The pair that comes into contact; empty strings if FREE.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> from scipy.interpolate import CubicSpline
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> contact = checker.first_contact(CubicSpline([0.0, 1.0], [[0.0, 1.57], [1.0, 1.57]]))
    >>> contact.names, round(contact.touching_at, 5)
    (('cart', 'post'), 0.7)
    """

    verdict: Verdict
    free_until: float
    touching_at: float
    names: tuple[str, str]


@overload
def first_contact(
    self: Any, curve: list[Any] | tuple[Any, ...], *, tolerance: float = ..., t0: float | None = ...
) -> tuple[TrajectoryContact, ...]: ...
@overload
def first_contact(self: Any, curve: Any, *, tolerance: float = ..., t0: float | None = ...) -> TrajectoryContact: ...
def first_contact(
    self: Any, curve: Any, *, tolerance: float = 1e-6, t0: float | None = None
) -> TrajectoryContact | tuple[TrajectoryContact, ...]:
    """Find when a robot on a curve first touches something, and prove that the robot is free until then.

    Parameters
    ----------
    curve : PPoly, BPoly, BSpline, planners.Trajectory, planners.ControllerPoints, or a list of curves
        As for `certify_trajectory`. Bodies that follow motions move at the same times.
    tolerance : float
        Distance in metres. Where the proof ends, a pair is within this distance of its margin.
    t0 : float, optional
        Offset in seconds that is added to the curve's times, as for `certify_trajectory`.

    Returns
    -------
    TrajectoryContact
        One result, or a tuple of results for a list of curves. `free_until` is never later than the first contact.

    Raises
    ------
    InputError
        As for `certify_trajectory`.

    See Also
    --------
    certify_trajectory : Proves only that the curve is free, in less time.
    loewner.first_contact : Finds the first contact of two bodies.

    Notes
    -----
    The first piece that is not proven free is cut into eight parts, repeatedly, until the pair is within the tolerance
    where the proof ends. The proof ends earlier if many triangles of two surfaces come close to each other at the same
    time, or if rounding matters. Rounding errors are about 1e-11 of the lengths involved and 2e-14 of the times.

    Contact that `Scene.leave` or `Scene.reach` allows on this curve is not reported. A contact at the end that becomes
    deeper than its rule allows is reported from the time at which the contact begins.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> from scipy.interpolate import CubicSpline
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> checker.first_contact(CubicSpline([0.0, 1.0], [[0.0, 0.0], [1.0, 0.5]])).verdict
    <Verdict.FREE: 0>
    """
    tolerance = _validate.positive_scalar(tolerance, "tolerance")
    ready: Problem = self._ready(timed=True)
    contacts = []
    for k, one in enumerate(curves_of(self.robot, self.scene, curve, t0)):
        # Raise the degree to 3, since on courses of degree 1, a body's turn would have to be cut in another way.
        cubic = one._replace(courses=elevated(one.courses, max(0, 4 - one.courses.shape[1])))
        contacts.append(_by_rules(ready, cut_in_time(self.robot, ready, cubic), tolerance, k))
    return tuple(contacts) if isinstance(curve, (list, tuple)) else contacts[0]


def _by_rules(ready: Problem, curve: Curve, tolerance: float, number: int) -> TrajectoryContact:
    """Find the first contact on one curve that no rule allows, among pairs without rules and each pair with a rule."""
    if not len(ready.ruled):
        return _first(ready, ready, curve, tolerance, number)
    candidates, lengths = [_first(ready, ready.unruled, curve, tolerance, number)], np.diff(curve.times)
    off = curve.off[:, : curve.courses.shape[2]]
    for pair in ready.ruled.tolist():
        a, b = (ready.names[n] for n in ready.pairs[pair])
        for problem, run, allowed, least in stages(ready, pair, curve.courses, off, tolerance):
            k = run.number
            ends = np.where(run.high == 1.0, curve.times[k + 1], curve.times[k] + run.high * lengths[k])
            times = np.append(curve.times[k[0]] + run.low[0] * lengths[k[0]], ends)
            one = _first(ready, problem, Curve(None, times, run.courses, run.off), allowed, number)
            if one.verdict == Verdict.FREE:
                continue
            if least is not None:
                one = replace(one, touching_at=_deeper(ready, pair, curve, (one.free_until, times[-1]), least))
            candidates.append(replace(one, names=(a, b)))
    first, touching = min(candidates, key=lambda one: one.free_until), min(one.touching_at for one in candidates)
    ambiguous = first.verdict == Verdict.FREE or touching == np.inf
    return replace(first, verdict=first.verdict if ambiguous else Verdict.COLLIDING, touching_at=touching)


def _first(ready: Problem, problem: Problem, curve: Curve, tolerance: float, number: int) -> TrajectoryContact:
    """Find the first contact of a problem's pairs on one curve, whose courses include the moving bodies.

    `ready` has the motions that these bodies follow.
    """
    waiting = [(curve, 0)]  # unproven pieces and their numbers of cuts, with the earliest piece last
    touching, doubt = np.inf, None  # the earliest collision, and the first place that is too close
    while waiting:
        piece, cuts = waiting.pop()
        proven = prove(problem, piece.courses, FOR_PROOF * tolerance, piece.off)
        expect_short(proven.verdicts, piece.times, number)
        hit = np.flatnonzero(proven.verdicts == codes.COLLIDING)[:1]
        if len(hit):
            k = int(hit[0])
            touching = min(touching, piece.times[k] + proven.fractions[k] * (piece.times[k + 1] - piece.times[k]))
        unproven = np.flatnonzero(proven.verdicts != codes.FREE).tolist()
        if not unproven:
            continue
        # The other unproven pieces are examined only if the first one turns out to be free.
        first, pair = unproven[0], int(proven.pairs[unproven[0]])
        gap = distance_at(problem, pair, piece.courses[first, 0]) - problem.margins[pair]
        gap -= problem.off_at_start(piece.off[first, piece.courses.shape[2] :])[pair]
        if cuts == MOST_CUTS or gap <= tolerance:
            doubt = float(piece.times[first]), pair
            break
        waiting += [(_cut(ready, piece, k), cuts + 1) for k in reversed(unproven)]
    if doubt is None:
        return TrajectoryContact(Verdict.FREE, np.inf, np.inf, ("", ""))
    a, b = (problem.names[n] for n in problem.pairs[doubt[1]])
    # Allow for the rounding of the times of parts.
    free = max(doubt[0] - CURVE_ROUNDINGS * float(np.abs(curve.times).max()), float(curve.times[0]))

    def colliding(times: Floats) -> Ints:
        hit = verdicts.classified(problem.as_given, codes.EXACT, configurations_at(ready, curve, times)).verdicts
        return np.flatnonzero(hit == codes.COLLIDING)

    # A collision that is known only up to rounding may not exist.
    is_confirmed = touching < np.inf and len(colliding(np.array([touching]))) > 0
    touching = _earlier(colliding, free, touching) if is_confirmed else np.inf
    verdict = Verdict.COLLIDING if is_confirmed else Verdict.AMBIGUOUS
    return TrajectoryContact(verdict, free, touching, (a, b))


def _deeper(ready: Problem, pair: int, curve: Curve, between: tuple[float, float], least: float) -> float:
    """Return a time at which a pair is at most `least` apart, just after a time at which it is farther apart.

    The result is inf if `MEASURED` samples contain no such time.
    """

    def deep(times: Floats) -> Ints:
        return np.flatnonzero(distances_at(ready, pair, configurations_at(ready, curve, times)) <= least)

    times = np.linspace(*between, MEASURED)
    hit = deep(times)[:1]
    return _earlier(deep, between[0], float(times[hit[0]])) if len(hit) else np.inf


def _cut(ready: Problem, curve: Curve, k: int) -> Curve:
    """Cut segment k of a curve into parts.

    Moving bodies get new courses, since a shorter turn is approximated more closely.
    """
    shares = np.arange(PARTS + 1) / PARTS
    courses = parts(np.repeat(curve.courses[k : k + 1], PARTS, axis=0), shares[:-1], shares[1:])
    off = np.repeat(curve.off[k : k + 1], PARTS, axis=0)
    off[:, : courses.shape[2]] += CURVE_ROUNDINGS * np.abs(curve.courses[k]).max(axis=0)
    begin, end = curve.times[k : k + 2]
    times = np.where(shares == 1.0, end, begin + shares * (end - begin))
    if ready.paths is not None:
        own = courses.shape[2] - in_time.WIDTH * len(ready.paths.far)
        in_time.write_bodies(ready.paths, times[:-1], times[1:], courses[..., own:], off[..., own:])
    return Curve(None, times, courses, off)


def _earlier(hits: Callable[[Floats], Ints], free: float, touching: float) -> float:
    """Return a hit from `free` to `touching` that follows a time without a hit; `free` itself if it is a hit."""
    if len(hits(np.array([free]))):
        return free
    while True:
        times = np.linspace(free, touching, 2 * PARTS + 1)[1:-1]
        times = times[(times > free) & (times < touching)]
        if len(times) == 0:
            return touching
        hit = hits(times)
        at = int(hit[0]) if len(hit) else len(times)
        free, touching = float(times[at - 1]) if at else free, float(times[at]) if at < len(times) else touching
