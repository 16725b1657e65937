"""Motions of a robot among bodies that follow their own motions, combined into motions of one robot.

A body that follows a motion is a link on a floating joint (`assembly.with_moving_bodies`). Between two successive times
of its motion, the body moves straight and turns at a constant rate, like a floating joint on a straight motion. A
motion of the robot is therefore cut at the times of the bodies' motions, and each piece is proven as usual. The ends of
pieces are rounded; docs/certified.md, "Motions in time", derives the bounds below.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loewner._base import _elementary, _validate
from loewner._base._matrices import power
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import codes, tolerances
from loewner.queries.pose_paths import PackedPaths
from loewner.robots.checking import verdicts
from loewner.robots.checking.problem import Problem
from loewner.robots.description.robot import Robot, interpolated
from loewner.robots.proofs import motions
from loewner.robots.proofs.courses import CURVE_ROUNDINGS, between, elevated, straight
from loewner.robots.proofs.motions import Found
from loewner.robots.proofs.proofs import ProofOptions, apply_rules, deviations, refuse_starts

# Number of values of a floating joint.
WIDTH = 7

# Bounds on rounding errors. VALUE_ROUNDINGS is for positions and quaternions, relative to their largest numbers, and
# TIME_ROUNDINGS is for times.
VALUE_ROUNDINGS = 128.0 * tolerances.UNIT_ROUNDOFF  # certified.md B56
TIME_ROUNDINGS = 16.0 * tolerances.UNIT_ROUNDOFF  # certified.md B57

# A cubic curve with the ends and end tangents of an arc of angle φ on a unit circle misses the arc by at most φ⁴ / 384.
ARC_ERROR = 1.0 / 384.0


# Tolerance [m] for proofs about a robot at rest; these proofs halve no intervals.
STILL = 1e-9


class Pieces(NamedTuple):
    """Motions that are cut where bodies change their rates.

    Attributes
    ----------
    owner : ndarray of int64, shape (M,)
        The motion to which each piece belongs.
    low, high : ndarray, shape (M,)
        The fractions of the motion at which each piece begins and ends.
    times : ndarray, shape (M, 2)
        The times at which each piece begins and ends, in seconds.
    courses : ndarray, shape (M, degree + 1, dof + 7 bodies)
    off : ndarray, shape (M, dof + 7 bodies + 3 growing)
        How far values may deviate from the courses, and how far points of bodies may deviate (`PackedPaths.off`).
    """

    owner: Ints
    low: Floats
    high: Floats
    times: Floats
    courses: Floats
    off: Floats


def with_bodies(ready: Problem, Q: Floats, t: Floats) -> Floats:
    """Append the values of all moving bodies at times, shape (N,), to the robot's own values.

    `Q` has a row for each time. If the rows already have values of moving bodies, these values are replaced.
    """
    if ready.paths is None:
        return Q
    values = ready.paths.values(t).reshape(len(Q), WIDTH * len(ready.paths.far))
    return np.concatenate([Q[:, : ready.robot.dof - values.shape[1]], values], axis=1)


def free_at(ready: Problem, Q: Floats, t: Floats) -> Bools:
    """Return which rows of `with_bodies`, at times t, shape (N,), are proven free for all possible poses of bodies."""
    paths = ready.paths
    if paths is None or not paths.bounds:
        return verdicts.free(ready, Q)
    off = np.concatenate([np.zeros_like(Q), paths.off(t, t)], axis=1)
    answers = motions.settle(ready, np.stack([Q, Q], axis=1), STILL, off)
    refuse_starts(ready.as_given, Q, answers)
    return np.asarray(answers.verdicts == codes.FREE)


def pieces(robot: Robot, paths: PackedPaths, courses: Floats, off: Floats, t0: Floats, t1: Floats) -> Pieces:
    """Cut a robot's courses from t0 to t1 where moving bodies change their rates, and append the bodies' courses.

    Parameters
    ----------
    robot : Robot
        A robot without moving bodies.
    paths : PackedPaths
        The motions of the bodies.
    courses : ndarray, shape (N, degree + 1, dof)
    off : ndarray, shape (N, dof)
        How far values may deviate from the courses.
    t0, t1 : ndarray, shape (N,)
        Times at which the courses begin and end.

    Raises
    ------
    InputError
        If there are more than `pose_paths.MOST_KNOTS` knots, or the pieces do not fit into memory.
    """
    curved = courses.shape[1] > 2
    if curved and paths.turns.any():
        courses = elevated(courses, max(0, 4 - courses.shape[1]))
    knots = paths.knots(t0, t1, curved)
    first, last = np.searchsorted(knots, t0, side="right"), np.searchsorted(knots, t1, side="left")
    counts = np.maximum(last - first, 0) + 1
    if counts.max(initial=1) == 1:
        uncut = np.arange(len(t0)), np.zeros(len(t0)), np.ones(len(t0)), np.stack([t0, t1], axis=1)
        return Pieces(*uncut, *_joined(paths, t0, t1, courses, off))
    total, width = int(counts.sum()), courses.shape[2] + WIDTH * len(paths.far)
    _validate.fits_memory(8 * total * width * (2 * courses.shape[1] + 2), f"{total} pieces of motions")
    owner = np.repeat(np.arange(len(courses)), counts)
    number = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
    behind = number == counts[owner] - 1
    padded = np.concatenate([knots, [np.nan]])
    begin = np.where(number == 0, t0[owner], padded[np.minimum(first[owner] + number - 1, len(knots))])
    end = np.where(behind, t1[owner], padded[np.minimum(first[owner] + number, len(knots))])
    length = (t1 - t0)[owner]
    length = np.where(length > 0.0, length, 1.0)
    starts = np.where(number == 0, 0.0, (begin - t0[owner]) / length)
    ends = np.where(behind, 1.0, (end - t0[owner]) / length)
    of_robot, strays = courses[owner], off[owner]
    cut = np.flatnonzero(counts[owner] > 1)
    if len(cut):
        whole = of_robot[cut]
        of_robot[cut] = between(robot, whole, starts[cut], ends[cut])
        strays[cut] += CURVE_ROUNDINGS * np.abs(whole).max(axis=1)
    times = np.stack([begin, end], axis=1)
    return Pieces(owner, starts, ends, times, *_joined(paths, begin, end, of_robot, strays))


def _joined(paths: PackedPaths, begin: Floats, end: Floats, courses: Floats, off: Floats) -> tuple[Floats, Floats]:
    """Append the courses of all bodies between times, and how far values may deviate from the courses."""
    M, points, dof = courses.shape
    width = dof + WIDTH * len(paths.far)
    all_courses, allowed = np.empty((M, points, width)), np.empty((M, width + 3 * len(paths.bounds)))
    all_courses[..., :dof], allowed[:, :dof] = courses, off
    write_bodies(paths, begin, end, all_courses[..., dof:], allowed[:, dof:])
    return all_courses, allowed


def write_bodies(paths: PackedPaths, begin: Floats, end: Floats, courses: Floats, off: Floats) -> None:
    """Write courses of all bodies between times, shape (M,) each; between these times, no body changes its rates.

    Parameters
    ----------
    courses : ndarray, shape (M, points, 7 bodies)
        Receives the courses.
    off : ndarray, shape (M, 7 bodies + 3 growing)
        Output: how far values may deviate from the courses, and how far points of bodies may deviate from their
        positions, as in `Pieces`.
    """
    values, farthest = WIDTH * len(paths.far), np.maximum(np.abs(begin), np.abs(end))
    off[:, values:] = paths.off(begin, end, TIME_ROUNDINGS * (farthest + paths.spans.max(initial=0.0)))
    if values == 0:
        return
    body_courses, errors = (x.reshape(*x.shape[:-1], len(paths.far), WIDTH) for x in (courses, off[:, :values]))
    bent = _write_courses(paths.values(begin), paths.values(end), body_courses)
    ticks = TIME_ROUNDINGS * (farthest[:, None] + paths.spans)  # (M, bodies)
    errors[..., :3] = (VALUE_ROUNDINGS * paths.far + paths.speeds * ticks)[..., None]
    errors[..., 3:] = (VALUE_ROUNDINGS + paths.turns * ticks + bent)[..., None]


def _write_courses(a: Floats, b: Floats, out: Floats) -> Floats | float:
    """Write courses of bodies between their values a and b, shape (M, bodies, 7), to shape (M, points, bodies, 7).

    Return how far the quaternions deviate from a turn at a constant rate, shape (M, bodies), or 0.
    """
    points = out.shape[1]
    p, q = a[..., 3:], b[..., 3:]
    q *= np.where(np.einsum("mbk,mbk->mb", p, q) < 0.0, -1.0, 1.0)[..., None]
    out[:, 0], out[:, -1] = a, b
    for k in range(1, points - 1):
        share = k / (points - 1)
        out[:, k, :, :3] = (1.0 - share) * a[..., :3] + share * b[..., :3]
    if points <= 3:  # degree 1 turns at a constant rate; with degree 2, no body turns
        out[:, 1:-1, :, 3:] = q[:, None]
        return 0.0
    arc = 2.0 * _elementary.arcsin(np.minimum(np.linalg.norm(q - p, axis=-1, keepdims=True) / 2.0, 1.0))
    cosine, third = _elementary.cos(arc), np.where(arc < 1e-6, 1.0, arc / np.maximum(_elementary.sin(arc), 1e-12)) / 3.0
    cubic = np.stack([p, p + third * (q - cosine * p), q + third * (p - cosine * q), q], axis=1)
    out[..., 3:] = elevated(cubic.reshape(len(a), 4, 4 * a.shape[1]), points - 4).reshape(len(a), points, *p.shape[1:])
    error: Floats = ARC_ERROR * (1.0 + 1e-9) * power(arc[..., 0], 4)
    return error


def prove_edges(
    robot: Robot, ready: Problem, paths: PackedPaths, ends: tuple[Floats, Floats],
    times: tuple[Floats, Floats], options: ProofOptions,
) -> Found:  # fmt: skip
    """Prove which straight motions are free; the robot is at `ends`, shape (N, dof) each, at `times`, shape (N,) each.

    COLLIDING is confirmed at the configuration and the time that a user computes from the fraction.
    """
    (a, b), (t0, t1) = ends, times
    courses = straight(robot, a, b)
    off = deviations(courses, options.joint_error)
    cut = pieces(robot, paths, courses, np.zeros_like(a) if off is None else off, t0, t1)
    first = np.searchsorted(cut.owner, np.arange(len(a) + 1))
    limit = options.limit(first)
    piece_answers = motions.settle(ready, cut.courses, options.tolerance, cut.off, limit=limit, as_given=True)
    refuse_starts(ready.as_given, cut.courses[:, 0], piece_answers)
    if off is None:
        apply_rules(ready, cut.courses, cut.off, first, piece_answers, options)
    # All collisions are confirmed below.
    piece_answers.verdicts[piece_answers.verdicts == codes.BY_CARE] = codes.COLLIDING
    answers = piece_answers if len(cut.owner) == len(a) else _gathered(cut, piece_answers, len(a))
    at = (answers.verdicts == codes.COLLIDING).nonzero()[0]
    if len(at):
        fractions = answers.fractions[at]
        Q = interpolated(robot, a[at], b[at], fractions[:, None])
        Q = with_bodies(ready, Q, t0[at] + fractions * (t1 - t0)[at])
        hit = verdicts.classified(ready.as_given, codes.EXACT, Q).verdicts == codes.COLLIDING
        answers.verdicts[at] = np.where(hit, codes.COLLIDING, codes.AMBIGUOUS)
    return answers


def _gathered(cut: Pieces, found: Found, total: int) -> Found:
    """Combine the answers about pieces into answers about motions: the worst answer, where it first occurs."""
    work = np.add.reduceat(found.work, np.flatnonzero(np.diff(cut.owner, prepend=-1)))
    answers = Found(np.full(total, codes.FREE, dtype=np.int8), np.full(total, np.nan), np.full(total, -1), work)
    for verdict in (codes.AMBIGUOUS, codes.COLLIDING, codes.TOO_LONG):  # a later verdict overrides an earlier one
        at = np.flatnonzero(found.verdicts == verdict)[::-1]  # the first piece of a motion is written last
        at_owner = cut.owner[at]
        answers.verdicts[at_owner], answers.pairs[at_owner] = verdict, found.pairs[at]
        answers.fractions[at_owner] = cut.low[at] + found.fractions[at] * (cut.high[at] - cut.low[at])
    return answers
