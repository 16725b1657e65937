"""Compare positions, velocities, accelerations and jerk of a curve with a robot's limits at every instant.

A controller's curve is a polynomial on each piece. Its extreme values are therefore at the ends of pieces or at roots
of derivatives.
"""

from __future__ import annotations

from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.planners.joint_limits import JointLimits, position_limits
from loewner.robots import Robot
from loewner.robots.proofs.courses import at_fractions
from loewner.robots.proofs.curves import Curve

# Quantities, and the suffix that is appended to the unit of positions for each quantity.
QUANTITIES = ("position", "velocity", "acceleration", "jerk")
RATES = ("", "/s", "/s²", "/s³")

# Fractions of a piece at which values are compared first. Roots are computed only if a value there may be larger.
TRIED = np.arange(9) / 8

# Extremes and jumps below the share ROUNDED of the largest value count as rounding errors.
ROUNDED = 1e-9

# Times are doubtful if the velocities are too small by the factor of another unit of time: the largest velocity,
# multiplied by this factor, is a share of its limit within the range LIKELY.
UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
LIKELY = (0.05, 2.0)

# Velocity limit [rad/s or m/s] that the check of times assumes for a joint without a limit.
USUAL = 2.0

# Velocities at the ends of a monotone cubic are at most STEEPEST times its mean velocity. Velocities are doubtful if
# pieces that break this rule cover more than the share DOUBTED of the distance that a joint moves.
STEEPEST, DOUBTED = 3.0, 0.5


# The least and the greatest value of a joint, each with its time.
Ends = tuple[tuple[float, float], tuple[float, float]]


class Use(NamedTuple):
    """How much of a joint's limit a curve uses: the joint's value that comes closest to the limit, or exceeds it most.

    Attributes
    ----------
    quantity : str
        One of `QUANTITIES`.
    joint : str
    value, limit : float
        The value and its limit, in SI units. The limit is infinite if the joint has none.
    ratio : float
        For a position, its distance from the middle of the range, divided by half the length of the range. For other
        quantities, the absolute value divided by the limit. The ratio is 0 if there is no limit.
    time : float
        Time at which the value occurs, in seconds.
    unit : str
        Unit of the value, such as rad/s.
    """

    quantity: str
    joint: str
    value: float
    limit: float
    ratio: float
    time: float
    unit: str = "rad"


class Jump(NamedTuple):
    """The largest jump of a velocity or an acceleration between two pieces, and the number of such jumps."""

    quantity: str
    joint: str
    size: float
    time: float
    often: int
    unit: str


def used(robot: Robot, curve: Curve, limits: JointLimits | None, timed: bool) -> list[Use]:
    """Return how much of each joint's limits a curve uses; without times, only for limits of position.

    The curve has the robot's columns. Position limits are the hard limits, unless the file passed as `limits` changes
    them.
    """
    lower, upper = position_limits(robot, limits)
    uses: list[Use] = []
    for order, quantity in enumerate(QUANTITIES[: None if timed else 1]):
        points = curve.courses if order == 0 else _rates(curve, order)
        if points.shape[1] == 0:
            break
        for k, joint in enumerate(robot.configuration_names):
            ends = extremes(points[:, :, k], curve.times)
            low, high = (lower[k], upper[k]) if order == 0 else _both_signs(robot, limits, quantity, k)
            unit = _unit(robot, k, order)
            uses.append(_worst(quantity, joint, ends, float(low), float(high))._replace(unit=unit))
    return uses


def _unit(robot: Robot, column: int, order: int) -> str:
    """Return the unit of a derivative of a joint's value."""
    slides = (robot.tree.column == column) & (robot.tree.kind == columns.PRISMATIC)
    return ("m" if slides.any() else "rad") + RATES[order]


def jumps(robot: Robot, curve: Curve) -> list[Jump]:
    """Return the largest jumps of velocities and accelerations, if there are any."""
    largest_jumps = []
    for order in (1, 2):
        points = _rates(curve, order)
        if len(points) < 2 or points.shape[1] == 0:
            continue
        size = 64 * np.abs(curve.courses).max(axis=(0, 1)) * np.finfo(float).eps
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            sizes = np.abs(points[1:, 0] - points[:-1, -1])
            # Rounding errors of positions are divided by powers of the durations.
            jumping = sizes > ROUNDED * np.abs(points).max(axis=(0, 1)) + size / np.diff(curve.times).min() ** order
        if jumping.any():
            k, joint = (int(n) for n in np.unravel_index(np.where(jumping, sizes, 0.0).argmax(), sizes.shape))
            count = int(jumping.any(axis=1).sum())
            name, time = robot.configuration_names[joint], float(curve.times[k + 1])
            largest_jumps.append(
                Jump(QUANTITIES[order], name, float(sizes[k, joint]), time, count, _unit(robot, joint, order))
            )
    return largest_jumps


def doubts(robot: Robot, curve: Curve, uses: list[Use], velocities: bool) -> list[str]:
    """Describe implausible times and, if the file contains velocities, implausible velocities."""
    descriptions = []
    fastest = [use for use in uses if use.quantity == "velocity"]
    shares = [use.ratio if np.isfinite(use.limit) else abs(use.value) / USUAL for use in fastest]
    most = max(shares, default=0.0)
    for factor, unit in UNITS.items():
        if LIKELY[0] <= most * factor <= LIKELY[1]:
            descriptions.append(
                f"times may be in {unit}: the highest velocity is {most:.3g} of its limit, and the file takes "
                f"{curve.times[-1] - curve.times[0]:.6g} s"
            )
    courses, T = curve.courses, np.diff(curve.times)[:, None]
    if not velocities or courses.shape[1] < 3:
        return descriptions
    way, degree = courses[:, -1] - courses[:, 0], courses.shape[1] - 1
    rates = [degree * (courses[:, 1] - courses[:, 0]), degree * (courses[:, -1] - courses[:, -2])]
    odd = np.zeros(way.shape, dtype=bool)
    for rate in rates:
        share = np.divide(rate, way, out=np.zeros_like(way), where=way != 0)
        odd |= (share < -ROUNDED) | (share > STEEPEST * (1 + 1e-3))
    ways = np.abs(way)
    # The mean velocity of a parabola, which may turn back within a piece, is the mean of the velocities at its ends.
    odd &= np.abs((rates[0] + rates[1]) / 2 - way) > DOUBTED * ways
    astray = (ways * odd).sum(axis=0) > DOUBTED * ways.sum(axis=0)
    astray &= ways.sum(axis=0) > ROUNDED
    for k in np.flatnonzero(astray)[:1].tolist():
        n = int(np.where(odd[:, k], ways[:, k], 0.0).argmax())
        descriptions.append(
            f"velocities disagree with positions: {robot.configuration_names[k]} moves at a mean of "
            f"{way[n, k] / T[n, 0]:.4g} from {curve.times[n]:.6g} s to {curve.times[n + 1]:.6g} s, where the file has "
            f"the velocities {rates[0][n, k] / T[n, 0]:.4g} and {rates[1][n, k] / T[n, 0]:.4g}"
            + (f" ({int(astray.sum()) - 1} more joints)" if astray.sum() > 1 else "")
        )
    return descriptions


def _rates(curve: Curve, order: int) -> Floats:
    """Return the control points of a derivative in time, shape (n, points, dof)."""
    points, T = curve.courses, np.diff(curve.times)[:, None, None]
    for _ in range(order):
        with np.errstate(over="ignore", invalid="ignore"):  # pieces may be extremely short
            points = (points.shape[1] - 1) * np.diff(points, axis=1) / T
    return np.asarray(points)


def _both_signs(robot: Robot, limits: JointLimits | None, quantity: str, k: int) -> tuple[float, float]:
    """Return the limits of a rate. If a file does not limit accelerations or jerk, the robot's limits apply."""
    sources: Any = (robot,) if limits is None else (limits,) if quantity == "velocity" else (limits, robot)
    of_joint = [float(getattr(each, quantity)[k]) for each in sources]
    most = next((one for one in of_joint if np.isfinite(one)), np.inf)
    return -most, most


def _worst(quantity: str, joint: str, ends: Ends, low: float, high: float) -> Use:
    """Compare the least and the greatest value, each with its time, with limits."""
    (least, when_least), (greatest, when_greatest) = ends
    if np.isfinite(low) and np.isfinite(high):
        middle, half = (low + high) / 2, (high - low) / 2
        below, above = (_share(middle - least, half), _share(greatest - middle, half))
    else:  # with a single limit, a value is either within it or beyond it
        below, above = (np.inf if beyond > ROUNDED else 0.0 for beyond in (low - least, greatest - high))
    if below > above or (below == above == 0.0 and np.isfinite(low)):
        return Use(quantity, joint, least, low, below, when_least)
    return Use(quantity, joint, greatest, high, above, when_greatest)


def _share(way: float, half: float) -> float:
    """Return a distance from the middle of a range as a share of half the range, which may be 0."""
    if not way < np.inf:  # an overflow is beyond every limit
        return np.inf
    return way / half if half > 0 else (np.inf if way > ROUNDED else 1.0)


def extremes(points: Floats, times: Floats) -> Ends:
    """Return the least and the greatest value of polynomials, each with its time; `points` are control points."""
    (low, when_low), (high, when_high) = _greatest(-points, times), _greatest(points, times)
    return (-low, when_low), (high, when_high)


def _greatest(points: Floats, times: Floats) -> tuple[float, float]:
    degree = points.shape[1] - 1
    with np.errstate(over="ignore", invalid="ignore"):  # overflow is detected below as a result that is not finite
        values = at_fractions(points[..., None], TRIED)[..., 0]
    n, at = np.unravel_index(values.argmax(), values.shape)
    best, piece, share = float(values[n, at]), int(n), float(TRIED[at])
    bounds = points.max(axis=1)
    for n in np.argsort(-bounds, kind="stable").tolist():
        if degree < 2 or not np.isfinite(best) or bounds[n] <= best + ROUNDED * abs(best):
            break
        slopes = _powers(degree * np.diff(points[n]))
        # Leading coefficients that are only rounding errors would hide the other roots. Removing these coefficients
        # hardly changes values.
        shares = np.real(Polynomial(slopes).trim(ROUNDED * np.abs(slopes).max()).roots())
        shares = shares[(shares > 0) & (shares < 1)]
        if len(shares):
            tried = at_fractions(points[n : n + 1, :, None], shares)[0, :, 0]
            if tried.max() > best:
                best, piece, share = float(tried.max()), n, float(shares[tried.argmax()])
    return best, float(times[piece] + share * (times[piece + 1] - times[piece]))


def _powers(points: Floats) -> Floats:
    """Return the power-basis coefficients of polynomials with given control points."""
    degree = len(points) - 1
    return np.array([comb(degree, k) * np.diff(points, k)[0] for k in range(degree + 1)])
