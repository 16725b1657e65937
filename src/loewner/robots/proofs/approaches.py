"""Bound a robot's least distance from contact on each piece of a curve: from below by proofs, from above by samples.

First, each piece is sampled. A proof of the piece as a motion then tries to show that every pair keeps at least the
smallest sampled distance minus one hundredth of this distance, or minus 10 µm if that is more. If the proof fails, it
names a time at which a pair is nearer, and a descent from this time finds a smaller distance for the next proof. Where
the robot collides, no separating planes exist. Pieces with a collision are divided into parts until the movement of
points within each part is below the allowed difference between the two bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._matrices import lengths
from loewner._base._pictures import pictured, verdicts
from loewner._base._validate import Floats, Ints, Pair
from loewner._kernels import codes, columns
from loewner._kernels.records import Tree
from loewner.robots.checking.distances import expect_pairs, nearest_columns
from loewner.robots.checking.problem import Problem
from loewner.robots.description.reaching import links_above
from loewner.robots.description.robot import Robot
from loewner.robots.proofs import in_time, motions
from loewner.robots.proofs.courses import CURVE_ROUNDINGS, configurations, parts
from loewner.robots.proofs.curves import Curve, curves_of, cut_in_time, expect_short, hits, proven

# Allowed difference between the two bounds on a distance: the larger of the share SHARE of the distance and NEAR [m].
# The difference exceeds this value only if a search ends early.
SHARE, NEAR = 0.01, 1e-5

# Fractions of each piece at which distances are measured first; the last piece is also measured at its end.
FIRST = np.arange(4) / 4

# Search for a minimum around a time. WIDE is the first distance to both sides of the time, as a share of the piece.
# This distance shrinks by the factor NARROWER in each of the STEPS steps.
WIDE, NARROWER, STEPS = 0.125, 0.4, 12

# Fractions of pieces at which collisions are sought.
TICKS = np.arange(32) / 32

# Maximum number of rounds of proofs. Each failed proof names a time at which the distance is smaller.
MOST_ROUNDS = 30

# Number of parts into which a part is divided, and the maximum number of parts of one piece.
PARTS, MOST_PARTS = 4, 1 << 14

# Relative accuracy of exact distances, as a share of the lengths from which they are computed.
ROUNDINGS = 1e-9

# If a quaternion differs by δ <= NEAR_TURNS from a quaternion of norm 1, the angle between the two is at most arcsin δ,
# which is less than 1.05 δ. The body turns by twice this angle, so by less than TURNS * δ. No turn moves a point by
# more than MOST_TURN times its distance from the axis.
TURNS, NEAR_TURNS, MOST_TURN = 2.1, 0.5, 2.0


@dataclass(frozen=True, eq=False, repr=False)
class ClosestApproach(_validate.Brief):
    """A robot's closest approach to contact on each piece of a curve.

    Attributes
    ----------
    times : ndarray, shape (n + 1,)
        Times in seconds at which the pieces begin and end.
    lower : ndarray, shape (n,)
        Proven lower bounds in metres. At every instant of the piece, all pairs of bodies are at least this far apart. A
        negative value bounds the depth of all overlaps. The bounds refer to the bodies' given poses, without errors of
        the poses. The bound is -inf if surfaces overlap, since their depths have no upper bound.
    distance : ndarray, shape (n,)
        The least distance found: the exact distance at ``time``, or minus the depth. The distance exceeds `lower` by at
        most the larger of 10 µm and a hundredth of the distance, unless a search ended early.
    time : ndarray, shape (n,)
        Times of the least distances, in seconds.
    names : ndarray of str, shape (n, 2)
        The pair of bodies that is nearest at ``time``.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> from scipy.interpolate import CubicSpline
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 1.9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> found = checker.closest(CubicSpline([0.0, 1.0, 2.0], [[0.0, 0.0], [0.5, 0.0], [0.0, 0.0]]))
    >>> found.names[found.nearest].tolist(), round(float(found.distance[found.nearest]), 6)
    (['rail', 'post'], 0.35)
    """

    times: Floats
    lower: Floats
    distance: Floats
    time: Floats
    names: NDArray[np.str_]

    @property
    def nearest(self) -> int:
        """Index of the piece with the least distance."""
        return int(self.distance.argmin())

    @property
    def close(self) -> NDArray[np.bool_]:
        """Whether the two bounds of a piece differ by at most 10 µm or by at most a hundredth of the distance."""
        return np.asarray(self.distance - self.lower <= _allowed(self.distance) * (1 + 1e-9))

    @pictured
    def _repr_html_(self) -> str:
        hit = np.where(self.distance > 0, codes.FREE, codes.COLLIDING)
        return verdicts(hit, self.times, "time, s")


@overload
def closest(
    self: Any, curve: list[Any] | tuple[Any, ...], *, t0: float | None = ...
) -> tuple[ClosestApproach, ...]: ...
@overload
def closest(self: Any, curve: Any, *, t0: float | None = ...) -> ClosestApproach: ...
def closest(self: Any, curve: Any, *, t0: float | None = None) -> ClosestApproach | tuple[ClosestApproach, ...]:
    """Bound the robot's least distance from contact on each piece of a curve, from both sides; margins are ignored.

    Parameters
    ----------
    curve : PPoly, BPoly, BSpline, planners.Trajectory, planners.ControllerPoints, or a list of curves
        As for `certify_trajectory`. The curve's times are also the times of the motions that bodies follow; pieces also
        end where the velocity of such a body changes.
    t0 : float, optional
        Offset in seconds that is added to the curve's times, as for `certify_trajectory`.

    Returns
    -------
    ClosestApproach
        One result, or a tuple of results for a list of curves.

    Raises
    ------
    InputError
        As for `certify_trajectory`; also if there is no pair to check.
    ConvergenceError
        As for `distance`.

    See Also
    --------
    certify_trajectory : Proves only that pairs keep their margins, in less time.
    distance : Computes distances at single configurations.

    Notes
    -----
    Pairs that `Scene.leave` and `Scene.reach` name are measured like all other pairs. docs/certified.md, "Closest
    approach", derives the lower bounds.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> from scipy.interpolate import CubicSpline
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> found = checker.closest(CubicSpline([0.0, 1.0], [[0.0, 0.0], [0.2, 0.5]]))
    >>> bool(0.98 * found.distance[0] < found.lower[0] <= found.distance[0])
    True
    """
    ready: Problem = self._ready(timed=True)
    curves = curves_of(self.robot, self.scene, curve, t0)
    approaches = tuple(measured(ready, cut_in_time(self.robot, ready, one), k) for k, one in enumerate(curves))
    return approaches if isinstance(curve, (list, tuple)) else approaches[0]


def measured(ready: Problem, curve: Curve, number: int = 0) -> ClosestApproach:
    """Measure a curve whose courses include the poses of moving bodies; error messages give the curve's number."""
    expect_pairs(ready, "closest")
    ready, curve = ready.without_margins, curve._replace(off=curve.off[:, : curve.courses.shape[2]])
    search = Search(ready, curve)
    lower = np.full(len(search.distance), -np.inf)
    open_pieces = np.flatnonzero(search.distance > 0)
    for _ in range(MOST_ROUNDS):
        if len(open_pieces) == 0:
            break
        before = search.distance[open_pieces]
        clear = np.maximum(before - _allowed(before), 0.0)
        answers = motions.settle(ready, curve.courses[open_pieces], NEAR / 2, curve.off[open_pieces], clear)
        expect_short(answers.verdicts, curve.times, number)
        free = answers.verdicts == codes.FREE
        lower[open_pieces[free]] = clear[free]
        left, shares, before = open_pieces[~free], answers.fractions[~free], before[~free]
        search.look(left, shares)
        search.descend(left, shares)
        # The other pieces are measured by parts.
        open_pieces = left[(search.distance[left] < before - _allowed(before) / 4) & (search.distance[left] > 0)]
    rest = np.flatnonzero(lower == -np.inf)
    if len(rest):
        bounds = _Motion.of(ready, curve)
        for k in rest.tolist():
            lower[k] = _by_parts(search, bounds, k)
    times = curve.times[:-1] + search.share * np.diff(curve.times)
    names = np.array(ready.names)[search.bodies]
    return ClosestApproach(curve.times, np.minimum(lower, search.distance), search.distance, times, names)


class Measured(NamedTuple):
    """Distances along a curve.

    Attributes
    ----------
    near : ClosestApproach
        The approach of all pairs. On a proven piece, a pair that may be in contact at the beginning or the end does not
        count if it comes within its margin.
    allowed : dict of (str, str) to ClosestApproach
        The approach of each pair that may be in contact.
    contacts : ndarray, shape (m, 2)
        Times at which collisions on unproven pieces begin and end.
    """

    near: ClosestApproach
    allowed: dict[Pair, ClosestApproach]
    contacts: Floats


def along(checker: Any, curve: Curve, unproven: Ints) -> Measured:
    """Measure a curve from `curves.proven`; `unproven` lists the pieces that are not proven free."""
    ready: Problem = checker._ready(timed=bool(checker.scene.following)).as_given
    whole, allowed = cut_in_time(checker.robot, ready, curve), dict[Pair, ClosestApproach]()
    if len(ready.ruled) < len(ready.pairs):
        near = measured(ready.unruled, whole)
    else:
        far, no_names = np.full(len(whole.courses), np.inf), np.full((len(whole.courses), 2), "")
        near = ClosestApproach(whole.times, far, far, whole.times[:-1], no_names)
    for pair in ready.ruled.tolist():
        a, b = (ready.names[k] for k in ready.pairs[pair])
        own = allowed[a, b] = measured(ready.only(np.array([pair])), whole)
        apart = own.distance > ready.margins[pair]
        apart[unproven] = True
        nearer = apart & (own.distance < near.distance)
        near = ClosestApproach(
            near.times, np.where(apart, np.minimum(own.lower, near.lower), near.lower),
            np.where(nearer, own.distance, near.distance), np.where(nearer, own.time, near.time),
            np.where(nearer[:, None], own.names, near.names),
        )  # fmt: skip
    if not np.isfinite(near.distance).any():  # all contact is allowed
        near = measured(ready, whole)
    return Measured(near, allowed, contacts(ready, whole, unproven, near))


def worst(checker: Any, given: Any) -> ClosestApproach:
    """Measure a curve in any form; a pair that may touch counts only where it keeps its margin or is unproven."""
    curve, trajectory = proven(checker, given, 0.0)
    return along(checker, curve, np.flatnonzero(trajectory.segments.verdict != codes.FREE)).near


def contacts(ready: Problem, curve: Curve, pieces: Ints, approach: ClosestApproach) -> Floats:
    """Find when collisions on given pieces begin and end, as far as samples show; a pair within its margin collides.

    Returns
    -------
    ndarray, shape (m, 2)
        Times in seconds. The robot collides at both times of a row. These times are as close to the ends of the
        collision as floating-point numbers allow. A collision ends no later than the pieces.
    """
    intervals: list[tuple[float, float]] = []
    for group in np.split(pieces, np.flatnonzero(np.diff(pieces) > 1) + 1) if len(pieces) else []:
        begin, end = curve.times[group], curve.times[group + 1]
        times = np.unique(np.append(begin + (end - begin) * TICKS[:, None], [*end, *approach.time[group]]))
        hit = np.zeros(len(times) + 2, dtype=bool)
        hit[1 + hits(ready, curve, times)] = True
        first, last = np.flatnonzero(hit[1:] & ~hit[:-1]), np.flatnonzero(hit[:-1] & ~hit[1:]) - 1
        first, last = first[first < len(times)], last[last >= 0]
        inside = [times[first], times[last]]
        for side, free in enumerate((times[np.maximum(first - 1, 0)], times[np.minimum(last + 1, len(times) - 1)])):
            while True:
                middle = (inside[side] + free) / 2
                if not ((middle != inside[side]) & (middle != free)).any():
                    break
                at = np.zeros(len(middle), dtype=bool)
                at[hits(ready, curve, middle)] = True
                inside[side], free = np.where(at, middle, inside[side]), np.where(at, free, middle)
        intervals += zip(*(side.tolist() for side in inside), strict=True)
    return np.array(intervals).reshape(-1, 2)


def _allowed(distance: Floats) -> Floats:
    """Return how far the bounds on a distance may be apart."""
    return np.maximum(SHARE * np.abs(distance), NEAR)


class Search:
    """The least distance found on each piece of a curve, and its location; initially from a few samples per piece.

    Attributes
    ----------
    distance, share : ndarray, shape (n,)
        The distance in metres, and the fraction of the piece at which it was found.
    bodies : ndarray of int64, shape (n, 2)
        The nearest pair at this fraction.
    """

    def __init__(self, ready: Problem, curve: Curve) -> None:
        n = len(curve.courses)
        self.ready, self.curve = ready, curve
        self.distance, self.share, self.bodies = np.full(n, np.inf), np.zeros(n), np.zeros((n, 2), dtype=np.int64)
        pieces, shares = np.repeat(np.arange(n), len(FIRST)), np.tile(FIRST, n)
        distances = self.look(np.append(pieces, n - 1), np.append(shares, 1.0))
        # A piece ends where the next piece begins, so reuse the distance there.
        lower_at_end = np.flatnonzero(distances[len(FIRST) :: len(FIRST)] < self.distance)
        self.look(lower_at_end, np.ones(len(lower_at_end)))

    def look(self, pieces: Ints, shares: Floats) -> Floats:
        """Measure the distances at fractions of pieces, shape (N,) each, and keep the least distances."""
        curve, ready = self.curve, self.ready
        begin, end = curve.times[pieces], curve.times[pieces + 1]
        Q = configurations(ready.robot, curve.courses[pieces], shares)
        Q = in_time.with_bodies(ready, Q, np.where(shares == 1.0, end, begin + shares * (end - begin)))
        _, _, distance, bodies, *_ = nearest_columns(ready, Q, True)
        order = np.lexsort((distance, pieces))
        least = order[np.diff(pieces[order], prepend=-1) > 0]
        least = least[distance[least] < self.distance[pieces[least]]]
        at = pieces[least]
        self.distance[at], self.share[at], self.bodies[at] = distance[least], shares[least], bodies[least]
        return np.asarray(distance)

    def descend(self, pieces: Ints, shares: Floats) -> None:
        """Search for smaller distances around the given fractions of pieces."""
        half, middle = WIDE, shares.copy()
        for _ in range(STEPS):
            if len(pieces) == 0:
                return
            tried = np.clip(middle + half * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])[:, None], 0.0, 1.0)
            distances = self.look(np.tile(pieces, len(tried)), tried.ravel()).reshape(tried.shape)
            middle = tried[distances.argmin(axis=0), np.arange(len(pieces))]
            half *= NARROWER


class _Motion(NamedTuple):
    """Bounds on how far points of bodies move when values change.

    Attributes
    ----------
    far : ndarray, shape (links, bodies)
        Largest distance of each body from the axis of the joint above each link; 0 if the joint does not move the body.
    moved : ndarray, shape (links, bodies)
        1 where the joint moves the body.
    pairs : ndarray of int64, shape (2, pairs)
        Indices of bodies; all bodies that do not move have the same index, which is the last one.
    slack : float
        Error of exact distances in metres.
    """

    ready: Problem
    far: Floats
    moved: Floats
    pairs: Ints
    slack: float

    @classmethod
    def of(cls, ready: Problem, curve: Curve) -> _Motion:
        tree, tables, moving = ready.robot.tree, ready.tables, len(ready.link)
        most = np.abs(curve.courses).max(axis=(0, 1)) + curve.off.max(axis=0)
        far, moved = np.zeros((2, len(tree.kind), moving + 1))
        slides = _travel(tree, most)[0] + np.where(tree.kind == columns.PRISMATIC, np.abs(tree.offset), 0.0)
        for body, link in enumerate(ready.link.tolist()):
            travel = 0.0
            for joint in links_above(tree, link):  # the body's own joint first
                far[joint, body] = tables.reach[body, joint] + travel
                moved[joint, body] = 1.0
                travel += slides[joint]
        longest = float(tables.chain[1]) + float(slides.sum())
        spread = longest + float(np.abs(ready.standing.poses.reshape(-1, 4, 4)[:, :3, 3]).sum(axis=1).max(initial=0.0))
        return cls(ready, far, moved, np.minimum(ready.pairs, moving).T, ROUNDINGS * spread)

    def approach(self, off: Floats) -> Floats:
        """Bound how much nearer two bodies can come if values change by `off`, shape (N, dof)."""
        slides, turns = _travel(self.ready.robot.tree, off)
        way = turns @ self.far + slides @ self.moved
        return np.asarray((way[:, self.pairs[0]] + way[:, self.pairs[1]]).max(axis=1) * (1 + 1e-9))


def _travel(tree: Tree, off: Floats) -> tuple[Floats, Floats]:
    """Bound how far joints move points if values change by `off`, shape (..., dof).

    Returns
    -------
    slides, turns : ndarray, shape (..., links)
        How far joints slide, and how far they turn points, relative to the points' distance from the axes.
    """
    slides, turns = np.zeros((2, *off.shape[:-1], len(tree.kind)))
    for link, (kind, at, by) in enumerate(zip(tree.kind, tree.column, tree.multiplier, strict=True)):
        if kind in (columns.PRISMATIC, columns.REVOLUTE):
            (slides if kind == columns.PRISMATIC else turns)[..., link] = abs(by) * off[..., at]
        elif kind == columns.PLANAR:
            slides[..., link], turns[..., link] = off[..., at : at + 2].sum(axis=-1), off[..., at + 2]
        elif kind in (columns.FLOATING, columns.BALL):
            first = at + 3 * (kind == columns.FLOATING)
            far = np.sqrt((off[..., first : first + 4] ** 2).sum(axis=-1))
            slides[..., link] = off[..., at:first].sum(axis=-1)
            turns[..., link] = np.where(far <= NEAR_TURNS, TURNS * far, MOST_TURN)
    return slides, np.minimum(turns, MOST_TURN)


def _changes(robot: Robot, courses: Floats, low: Floats, high: Floats) -> Floats:
    """Bound how far values, shape (N, dof), on a part of a course differ from their values in the part's middle."""
    quaternions = robot._quaternions.values()
    if courses.shape[1] == 2:
        center, *ends = (configurations(robot, courses, share) for share in ((low + high) / 2, low, high))
        changes = np.maximum(*(np.abs(end - center) for end in ends))
        for at in quaternions:  # the ends of a steady turn are farthest; the norm bounds each column
            changes[:, at] = lengths(changes[:, at])[:, None] / 2
        return np.asarray(changes)
    points = center = parts(courses, low, high)
    while center.shape[1] > 1:
        center = (center[:, :-1] + center[:, 1:]) / 2
    changes = np.abs(points - center).max(axis=1)
    for at in quaternions:  # scale the quaternion in the middle to norm 1
        changes[:, at] /= lengths(center[:, 0, at])[:, None]
    return np.asarray(changes)


def _by_parts(search: Search, bounds: _Motion, piece: int) -> float:
    """Bound the distance on a piece from below, by distances in the middle of parts and the travel of points."""
    curve = search.curve
    course, off = curve.courses[piece], curve.off[piece] + CURVE_ROUNDINGS * np.abs(curve.courses[piece]).max(axis=0)
    low, width, lower, spent = np.zeros(1), 1.0, np.inf, 0
    with_surfaces = np.isin(search.ready.packed.layout[:, columns.KIND], (columns.SOLID, columns.SURFACE)).any()
    while True:
        count = len(low)
        distance = search.look(np.full(count, piece), low + width / 2)
        change = _changes(search.ready.robot, np.repeat(course[None], count, axis=0), low, low + width) + off
        least = distance - bounds.approach(change) - bounds.slack
        least[np.isnan(least)] = -np.inf  # an overflow gives no bound
        spent += count
        wanted = search.distance[piece] - _allowed(search.distance[piece : piece + 1])[0]
        left = least < wanted
        lower = min(lower, float(least[~left].min(initial=np.inf)))
        if not left.any():
            break
        if spent + PARTS * left.sum() > MOST_PARTS or low[left][0] + width / PARTS == low[left][0]:
            lower = min(lower, float(least[left].min()))
            break
        width /= PARTS
        low = (low[left][:, None] + width * np.arange(PARTS)).ravel()
    return -np.inf if with_surfaces and search.distance[piece] <= 0 else lower
