"""Convert curves in time to courses, one per segment: SciPy's piecewise polynomials, and types added to `form_of`."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loewner._base import _validate
from loewner._base._matrices import power
from loewner._base._pictures import pictured, verdicts
from loewner._base._validate import Floats, Ints, Pair
from loewner._kernels import codes
from loewner.errors import InputError
from loewner.queries.pairs import Verdict
from loewner.robots.checking.edges import checked_path
from loewner.robots.checking.problem import Problem
from loewner.robots.checking.verdicts import classified
from loewner.robots.description.robot import Robot
from loewner.robots.proofs import in_time
from loewner.robots.proofs.courses import CURVE_ROUNDINGS, configurations, elevated, straight
from loewner.robots.proofs.motions import CertifiedMotions, Found
from loewner.robots.proofs.proof_models import Model
from loewner.robots.proofs.proofs import ProofOptions, apply_rules, prove
from loewner.robots.proofs.written_proofs import proof_of
from loewner.scenes.scene import Scene

# Two segments of a curve join if their ends differ by at most the share JUMP of the curve's values.
JUMP = 1e-9

# Largest allowed difference between SciPy's values and the proven curve, in multiples of a bound on rounding.
AGREEMENT = 8.0

# Number of times at which distances along a curve are measured, in addition to the times of verdicts.
MEASURED = 401

# Least and largest allowed norm of a quaternion at the start of a segment.
NORMS = (0.5, 2.0)


class Curve(NamedTuple):
    """A curve whose segments are courses.

    Attributes
    ----------
    names : tuple of str or None
        Names of the columns; None if the curve does not name them.
    times : ndarray, shape (n + 1,)
        Times at which the segments begin and end [s].
    courses : ndarray, shape (n, degree + 1, dof)
    off : ndarray, shape (n, dof)
        Bounds on the rounding error of each value.
    carried : tuple of (str, str)
        Bodies that the robot either has to carry or must not carry, each with the link that has to carry it, or with an
        empty name if the robot must not carry the body.
    """

    names: tuple[str, ...] | None
    times: Floats
    courses: Floats
    off: Floats
    carried: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class CertifiedTrajectory(_validate.Brief):
    """Whether a curve is free of collisions at every instant.

    Attributes
    ----------
    verdict : Verdict
        FREE: every pair is proven to be farther apart than its margin at every instant, except for contact at the ends
        that `Scene.leave` or `Scene.reach` allows. COLLIDING: the robot collides at ``time``, which may be rounded.
        AMBIGUOUS: at ``time`` a pair comes within the tolerance of its margin, or arithmetic could not settle the pair;
        treat the curve as not free.
    time : float
        Seconds; NaN if FREE. If COLLIDING, the robot may also collide earlier.
    names : tuple of str
        The pair of bodies; empty strings if FREE.
    first : float
        Seconds; the curve is proven free at least until this time, which is inf if FREE.
    times : ndarray, shape (n + 1,)
        Times at which the segments begin and end.
    segments : CertifiedMotions
        Results for the n segments, with fractions of a segment instead of times.
    proof : Proof or None
        A proof that the curve is free, if a proof was requested and the curve is free; it has one motion for each
        segment.

    Examples
    --------
    >>> from loewner import CollisionChecker
    >>> from scipy.interpolate import CubicSpline
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"))
    >>> found = checker.certify_trajectory(CubicSpline([0.0, 1.0, 2.0], [[0.0, 0.0], [1.0, 0.5], [1.0, 1.0]]))
    >>> found.verdict, found.segments.verdict
    (<Verdict.FREE: 0>, array([0, 0], dtype=int8))
    """

    verdict: Verdict
    time: float
    names: tuple[str, str]
    times: Floats
    segments: CertifiedMotions
    proof: Any = None

    @pictured
    def _repr_html_(self) -> str:
        return verdicts(self.segments.verdict, self.times, "time, s")

    @property
    def first(self) -> float:
        """A time until which the curve is proven free: the start of its first segment that is not FREE.

        The time is inf if the curve is FREE. With bodies that follow motions, segments also begin where the bodies
        change their rates; `CollisionChecker.first_contact` is more precise.
        """
        at = np.flatnonzero(self.segments.verdict != codes.FREE)
        return float(self.times[at[0]]) if len(at) else np.inf


def certified(
    robot: Robot, ready: Problem, curves: list[Curve], options: ProofOptions, model: Model | None
) -> list[CertifiedTrajectory]:
    """Prove which curves are free; if `model` is given, also write proofs of the free curves."""
    error = np.zeros(robot.dof) if options.joint_error is None else options.joint_error
    curves = [curve._replace(off=curve.off + error) for curve in curves]
    curves = [cut_in_time(robot, ready, curve) for curve in curves]
    degrees = np.array([curve.courses.shape[1] for curve in curves])
    trajectories: list[CertifiedTrajectory | None] = [None] * len(curves)
    for degree in np.unique(degrees):
        at = np.flatnonzero(degrees == degree).tolist()
        courses = np.concatenate([curves[k].courses for k in at])
        off = np.concatenate([curves[k].off for k in at])
        firsts = np.cumsum([0, *(len(curves[k].courses) for k in at)])
        proven = prove(ready, courses, options.tolerance, off, options.limit(firsts))
        if not error.any():
            apply_rules(ready, courses, off, firsts, proven, options)
        for k, first, last in zip(at, firsts[:-1].tolist(), firsts[1:].tolist(), strict=True):
            expect_short(proven.verdicts[first:last], curves[k].times, k)
            part: Any = (array[first:last] for array in proven)
            one = of_segments(curves[k].times, Found(*part).of_shape((last - first,), ready))
            if model is not None and one.verdict == Verdict.FREE:
                deeper = None if error.any() else options.tolerance
                one = replace(one, proof=proof_of(model, ready, *_joined(curves[k]), deeper))
            trajectories[k] = one
    return [one for one in trajectories if one is not None]


def _joined(curve: Curve) -> tuple[Floats, Floats]:
    """Let each segment begin exactly where the previous one ends; return the courses and how far values may deviate."""
    courses = curve.courses.copy()
    courses[1:, 0] = courses[:-1, -1]
    return courses, curve.off.max(axis=0) + np.abs(courses - curve.courses).max(axis=(0, 1))


def expect_short(found: NDArray[np.int8], times: Floats, number: int) -> None:
    """Refuse a curve with a piece that would take too many intervals; the message gives the curve's index."""
    for n in np.flatnonzero(found == codes.TOO_LONG)[:1]:
        raise InputError(
            f"expected pieces short enough to be proven in {codes.MOST_INTERVALS} intervals, and on which no "
            f"orientation turns by more than about 80 degrees, found the piece from {times[n]:.15g} s to "
            f"{times[n + 1]:.15g} s of curve {number}; divide it, or lower joint_error"
        )


def cut_in_time(robot: Robot, ready: Problem, curve: Curve) -> Curve:
    """Cut a curve where bodies of the scene change their rates, and append the bodies' values."""
    if ready.paths is None:
        return curve
    cut = in_time.pieces(robot, ready.paths, curve.courses, curve.off, curve.times[:-1], curve.times[1:])
    return Curve(None, np.append(cut.times[:, 0], curve.times[-1]), cut.courses, cut.off)


def configurations_at(ready: Problem, curve: Curve, times: Floats) -> Floats:
    """Return the configurations at times of a curve, with the moving bodies at their poses at these times."""
    k = np.clip(np.searchsorted(curve.times, times, side="right") - 1, 0, len(curve.courses) - 1)
    shares = (times - curve.times[k]) / (curve.times[k + 1] - curve.times[k])
    return in_time.with_bodies(ready, configurations(ready.robot, curve.courses[k], np.clip(shares, 0.0, 1.0)), times)


def hits(ready: Problem, curve: Curve, times: Floats) -> Ints:
    """Return the indices of the times at which the robot collides."""
    Q = configurations_at(ready, curve, times)
    return np.flatnonzero(classified(ready, codes.EXACT, Q).verdicts == codes.COLLIDING)


def of_segments(times: Floats, segments: CertifiedMotions) -> CertifiedTrajectory:
    """Make the result of a curve from its first COLLIDING segment or, if there is none, its first AMBIGUOUS segment."""
    for verdict in (Verdict.COLLIDING, Verdict.AMBIGUOUS):
        for k in np.flatnonzero(segments.verdict == verdict)[:1]:
            time = times[k] + segments.fraction[k] * (times[k + 1] - times[k])
            a, b = segments.names[k].tolist()
            return CertifiedTrajectory(verdict, float(time), (a, b), times, segments)
    return CertifiedTrajectory(Verdict.FREE, np.nan, ("", ""), times, segments, segments.proof)


def proven(
    checker: Any, given: Any, joint_error: ArrayLike, name: str = "curve", proof: bool = False
) -> tuple[Curve, CertifiedTrajectory]:
    """Return the courses of a curve, and whether it is free.

    An ndarray of shape (k, dof) is a path of straight motions; the indices of its configurations serve as times.
    """
    if not isinstance(given, np.ndarray):
        curve = cut_in_time(checker.robot, checker._ready(timed=True), started(checker.robot, given, name))
        dof = checker.robot.dof
        own = curve._replace(courses=np.ascontiguousarray(curve.courses[..., :dof]), off=curve.off[:, :dof])
        return own, checker.certify_trajectory(given, joint_error=joint_error, proof=proof)
    rows = checked_path(checker.robot, given)
    curve = of_path(checker.robot, rows)
    motions = checker.certify_edges(rows[:-1], rows[1:], joint_error=joint_error, proof=proof)
    return curve, of_segments(curve.times, motions)


def of_path(robot: Robot, rows: Floats) -> Curve:
    """Return the straight motions between the rows of a path as a curve, with one second for each motion."""
    courses = straight(robot, rows[:-1], rows[1:])
    return Curve(None, np.arange(len(rows), dtype=np.float64), courses, np.zeros_like(rows[1:]))


def sampled(robot: Robot, curve: Curve, found: CertifiedTrajectory) -> tuple[Floats, Ints, Floats]:
    """Sample a curve at `MEASURED` equally spaced times, then at the verdict's time of each segment that is not FREE.

    Returns
    -------
    times : ndarray, shape (n,)
    numbers : ndarray of int, shape (n,)
        The segments in which these times lie.
    Q : ndarray, shape (n, dof)
    """
    unproven = np.flatnonzero(found.segments.verdict != codes.FREE)
    ticks, lengths = np.linspace(curve.times[0], curve.times[-1], MEASURED), np.diff(curve.times)
    numbers = np.clip(np.searchsorted(curve.times, ticks, side="right") - 1, 0, len(lengths) - 1)
    shares = np.clip((ticks - curve.times[numbers]) / lengths[numbers], 0.0, 1.0)
    numbers, shares = np.append(numbers, unproven), np.append(shares, found.segments.fraction[unproven])
    ticks = np.append(ticks, (curve.times[:-1] + found.segments.fraction * lengths)[unproven])
    return ticks, numbers, configurations(robot, curve.courses[numbers], shares)


# -- forms of curves ----------------------------------------------------------------------------


def curves_of(robot: Robot, scene: Scene, given: Any, t0: float | None = None) -> list[Curve]:
    """Return the courses of one curve, or of each curve in a list; errors as for `curve_of`.

    Bodies that the robot carries on a curve must be attached in the scene.
    """
    if isinstance(given, (list, tuple)):
        curves = [started(robot, one, f"curve {k}", t0) for k, one in enumerate(given)]
    else:
        curves = [started(robot, given, "curve", t0)]
    held = {body: attachment.link for body, attachment in scene.attachments.items()}
    expect_carried(held, [pair for curve in curves for pair in curve.carried])
    return curves


def expect_carried(held: Mapping[str, str], carried: Iterable[Pair]) -> None:
    """Raise an error unless `held` maps the bodies in `carried` to the links that have to carry them."""
    for body, link in carried:
        if not link and body in held:
            raise InputError(
                f"expected {body!r} attached to no link on this trajectory, since the robot carries it on others of "
                f"its message only, found it on {held[body]!r}"
            )
        if link and held.get(body) != link:
            carrier = f"it on {held[body]!r}" if body in held else "none"
            raise InputError(
                f"expected a body {body!r} attached to the link {link!r}, which carries it on this trajectory, found "
                f"{carrier}; attach it in the scene (Scene.attach, or --attach on the command line)"
            )


def started(robot: Robot, given: Any, name: str, t0: float | None = None) -> Curve:
    """Return the courses of a curve, shifted by `t0` seconds or, by default, by the curve's own start time."""
    curve = curve_of(robot, given, name)
    own = t0 is None
    later = _validate.real(getattr(given, "start_time", 0.0) if own else t0, "start_time" if own else "t0")
    curve = curve._replace(times=curve.times + later)
    if later and not (np.diff(curve.times) > 0).all():
        raise InputError(f"t0: expected a time to which a curve's times can be added, found {later:.15g}")
    return curve


def curve_of(robot: Robot, given: Any, name: str) -> Curve:
    """Check a user's curve and return its courses.

    Raises
    ------
    InputError
        If the curve has the wrong type, its columns do not match the robot, or it is not continuous. If a number is not
        finite, times do not increase, or the degree is above 7. If the values of a SciPy curve differ from the values
        that its coefficients define.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # refused below
        curve = form_of(given, name)
    if curve is None:
        raise InputError(
            f"{name}: expected a PPoly, BPoly or BSpline of scipy.interpolate, a planners.Trajectory, "
            f"planners.ControllerPoints or planners.Drive, found {type(given).__name__}"
        )
    curve = _in_order(robot, curve, name)
    _refuse_faults(robot, curve, name)
    if _is_of_scipy(given):
        _refuse_other_values(robot, given, curve, name)
    points = curve.courses
    ends = np.concatenate([points[:, 0], points[-1:, -1]])
    if not robot._watch.passes(ends):
        robot._watch.tell(ends, name)
    if points.shape[1] == 1 or (points.shape[1] == 2 and not robot.runs_straight):
        # Raise the degree of polynomials, since orientations on a course of degree 1 turn at a constant rate.
        points = elevated(points, 3 - points.shape[1])
    points, off = points.copy(), curve.off.copy()
    for columns in robot._quaternions.values():
        # Scale quaternions to norm 1, since bounds on deviations refer to turns of such quaternions.
        with np.errstate(over="ignore"):
            norms = np.linalg.norm(points[:, 0, columns], axis=1)
        for k in np.flatnonzero(~((norms >= NORMS[0]) & (norms <= NORMS[1])))[:1]:
            raise InputError(
                f"{name}: expected quaternions of norm 1 or near it, found the norm {norms[k]:g} at the time "
                f"{curve.times[k]:.15g}"
            )
        points[..., columns] /= norms[:, None, None]
        off[..., columns] /= norms[:, None]
    return curve._replace(courses=points, off=off)


@singledispatch
def form_of(given: Any, name: str) -> Curve | None:
    """Return the courses of a curve as its type defines them, unchecked; None if the object is not a curve.

    The planners' types register themselves here, because this module must not import the planner modules.
    """
    if not _is_of_scipy(given):
        return None
    _refuse_other_evaluation(given, name)
    try:
        return _of_scipy(given, name)
    except (ValueError, IndexError, TypeError, OverflowError) as error:  # attributes have been damaged
        if isinstance(error, InputError):
            raise
        raise InputError(f"{name}: expected a curve that SciPy can evaluate, found {error}") from error


def _of_scipy(given: Any, name: str) -> Curve:
    """Return the courses that the coefficients of a SciPy curve define."""
    c = np.asarray(given.c)
    if np.iscomplexobj(c):
        raise InputError(f"{name}: expected real coefficients, found {c.dtype}")
    # SciPy has moved the axis of the pieces to the front, for any value of `axis`.
    c = c.astype(np.float64)
    interpolate = sys.modules["scipy.interpolate"]
    if isinstance(given, interpolate.BSpline):
        return _of_b_spline(np.asarray(given.t, dtype=np.float64), c[:, None] if c.ndim == 1 else c, int(given.k), name)
    times, c = np.asarray(given.x, dtype=np.float64), c[..., None] if c.ndim == 2 else c
    if isinstance(given, interpolate.BPoly):
        points = np.moveaxis(c, 0, 1)
        return Curve(None, times, points, CURVE_ROUNDINGS * np.abs(points).max(axis=1))
    return _of_powers(times, c[::-1])


def _is_of_scipy(given: Any) -> bool:
    """Return whether an object is a SciPy curve, without importing SciPy's module for curves."""
    interpolate = sys.modules.get("scipy.interpolate")  # loaded if an object of its types exists
    types = () if interpolate is None else (interpolate.PPoly, interpolate.BPoly, interpolate.BSpline)
    return isinstance(given, types)


def _refuse_other_evaluation(given: Any, name: str) -> None:
    """Refuse a curve whose values are computed by code other than SciPy's.

    Such values may differ from the polynomials of the coefficients at any time, and samples cannot rule this out.
    """
    for method in ("__call__", "_evaluate"):
        function = getattr(type(given), method, None)  # some types have only one of the methods
        if method in vars(given) or not getattr(function, "__module__", "scipy.").startswith("scipy."):
            raise InputError(
                f"{name}: expected a curve that SciPy evaluates, found {type(given).__name__} with its own {method}; "
                "fit a curve of SciPy to its values"
            )


def _refuse_other_values(robot: Robot, given: Any, curve: Curve, name: str) -> None:
    """Refuse a SciPy curve whose values, as the curve itself computes them, are not on the courses.

    An attribute may have been changed since the curve was made. In each segment, enough values are compared to
    determine a polynomial of the curve's degree.
    """
    courses, begin, end = curve.courses, curve.times[:-1, None], curve.times[1:, None]
    degree = courses.shape[1] - 1
    t = begin + (end - begin) * (np.arange(1, degree + 2) / (degree + 2))
    segments, samples = np.nonzero((begin < t) & (t < end))  # some segments are too short for a time in between
    t = t[segments, samples]
    try:
        values = np.asarray(given(t)).astype(np.float64, casting="safe")
        actual = np.moveaxis(values, given.axis, 0).reshape(len(t), robot.dof)
    except Exception as error:
        raise InputError(
            f"{name}: expected {robot.dof} values at each of {len(t)} times, found {type(error).__name__}: {error}"
        ) from error
    share = (t - begin[segments, 0]) / (end - begin)[segments, 0]
    weights = [comb(degree, k) * power(share, k) * power(1 - share, degree - k) for k in range(degree + 1)]
    wanted = np.einsum("kn,nkc->nc", np.array(weights), courses[segments])
    rates = degree * np.abs(np.diff(courses, axis=1)).max(axis=1, initial=0.0) / (end - begin)
    # A periodic curve subtracts whole periods from the times, and the subtraction rounds.
    allowed = AGREEMENT * (curve.off + rates * np.spacing(np.abs(curve.times).max())) + np.finfo(np.float64).tiny
    for k, joint in np.argwhere(~(np.abs(actual - wanted) <= allowed[segments]))[:1].tolist():
        raise InputError(
            f"{name}: expected the values that its coefficients define, such as {wanted[k, joint]:g} for "
            f"{robot.configuration_names[joint]} at the time {t[k]:.15g}, found {actual[k, joint]:g} when it is called"
        )


def _of_powers(times: Floats, powers: Floats) -> Curve:
    """Make a curve from coefficients, shape (degree + 1, n, ...), of powers of the time since each segment began."""
    degree = len(powers) - 1
    steps = np.diff(times).reshape(-1, *[1] * (powers.ndim - 2))
    terms = np.stack([powers[k] * power(steps, k) for k in range(degree + 1)])
    points = [sum(comb(i, j) / comb(degree, j) * terms[j] for j in range(i + 1)) for i in range(degree + 1)]
    return Curve(None, times, np.stack(points, axis=1), CURVE_ROUNDINGS * np.abs(terms).sum(axis=0))


def _of_b_spline(knots: Floats, c: Floats, degree: int, name: str) -> Curve:
    """Compute the control points of each span, by de Boor's scheme with the span's ends as arguments."""
    if not (np.diff(knots) >= 0).all():
        raise InputError(f"{name}: expected knots that increase, found others")
    spans = degree + np.flatnonzero(np.diff(knots[degree : len(knots) - degree]) > 0)
    low, high = knots[spans], knots[spans + 1]
    points = []
    for k in range(degree + 1):
        D = [c[spans - degree + i] for i in range(degree + 1)]
        for level in range(1, degree + 1):
            u = high if level <= k else low
            for i in range(degree, level - 1, -1):
                left, right = knots[spans - degree + i], knots[spans + 1 + i - level]
                share = ((u - left) / (right - left)).reshape(-1, *[1] * (c.ndim - 1))
                D[i] = (1 - share) * D[i - 1] + share * D[i]
        points.append(D[degree])
    around = np.abs(np.stack([c[spans - degree + i] for i in range(degree + 1)])).max(axis=0)
    return Curve(None, np.append(low, high[-1:]), np.stack(points, axis=1), CURVE_ROUNDINGS * around)


def _in_order(robot: Robot, curve: Curve, name: str) -> Curve:
    """Put the curve's columns in the robot's order, matched by name if the curve names them."""
    wanted = robot.configuration_names
    if curve.names is None or curve.names == wanted:
        return curve
    if sorted(curve.names) != sorted(wanted):
        faults = {
            "none for": [joint for joint in wanted if joint not in curve.names],
            "the unknown": [joint for joint in curve.names if joint not in wanted],
            "more than one for": sorted({joint for joint in curve.names if curve.names.count(joint) > 1}),
        }
        mismatch = ", and ".join(f"{what} {', '.join(joints)}" for what, joints in faults.items() if joints)
        raise InputError(f"{name}: expected the joints {', '.join(wanted)}, found {mismatch}")
    order = [curve.names.index(joint) for joint in wanted]
    return curve._replace(names=wanted, courses=curve.courses[..., order], off=curve.off[..., order])


def _refuse_faults(robot: Robot, curve: Curve, name: str) -> None:
    times, courses = curve.times, curve.courses
    if courses.ndim != 3 or courses.shape[2] != robot.dof:
        width = courses.shape[2] if courses.ndim == 3 else f"values of shape {courses.shape[2:]}"
        raise InputError(f"{name}: expected {robot.dof} values at each time, found {width}")
    if len(courses) == 0 or times.shape != (len(courses) + 1,):
        raise InputError(f"{name}: expected one segment or more, found {len(courses)}")
    if not (np.isfinite(times).all() and np.isfinite(courses).all()):
        raise InputError(f"{name}: expected finite numbers, found others")
    _validate.increasing(times, name)
    if courses.shape[1] > codes.MOST_POINTS:
        raise InputError(
            f"{name}: expected polynomials of degree {codes.MOST_POINTS - 1} at most, found degree "
            f"{courses.shape[1] - 1}"
        )
    jumps = np.abs(courses[1:, 0] - courses[:-1, -1])
    bad = jumps > JUMP * np.maximum(np.abs(courses).max(axis=(0, 1)), 1e-3)
    if bad.any():
        k, joint = (int(n) for n in np.argwhere(bad)[0])
        raise InputError(
            f"{name}: expected a curve without jumps, found one of {jumps[k, joint]:g} in "
            f"{robot.configuration_names[joint]} at the time {times[k + 1]:.15g}"
        )


def joint_errors(robot: Robot, given: ArrayLike, name: str = "joint_error") -> Floats:
    """Expand a joint error, one number or one per value, to the allowed deviation of each value, shape (dof,)."""
    if isinstance(given, float) and 0.0 <= given < np.inf:
        return np.full(robot.dof, given)  # checks would take as long as the proof of a motion
    array = _validate.finite_array(given, name, ("...",))
    wanted = f"{name}: expected one number >= 0 or {robot.dof} of them, found"
    if array.shape not in ((), (robot.dof,)):
        raise InputError(f"{wanted} {_validate.shape_text(array.shape)}")
    for k in np.flatnonzero(array < 0)[:1]:
        raise InputError(f"{wanted} {array.flat[k]:g}{f' for {robot.configuration_names[k]}' if array.ndim else ''}")
    return np.full(robot.dof, array)
