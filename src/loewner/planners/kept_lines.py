"""Prove that a link stays close to a straight line along curves of configurations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from loewner._base import _elementary, _validate
from loewner._base._matrices import dot, lengths, product
from loewner._base._rotations import quaternions_of
from loewner._base._validate import Bools, Floats
from loewner._kernels import columns, tolerances
from loewner.errors import InputError
from loewner.robots import Robot
from loewner.robots.description.reaching import Chain, refuse_far
from loewner.robots.description.robot import chain_to
from loewner.robots.proofs.courses import at_fractions

# Default values of the largest deviations from a line [m, rad].
POSITION, ROTATION = 1e-4, 1e-3

# Smallest tolerance [m, rad]. Smaller tolerances would be close to the rounding errors of poses.
LEAST_TOLERANCE = 1e-9

# Largest angle of a line [rad]. At half a turn, rounding would decide which direction of rotation is shorter.
LARGEST_ANGLE = np.pi - 1e-6

# Rounding error per joint of a curve's deviation from a line, relative to the lengths and the largest value.
ROUNDINGS = 128.0 * tolerances.UNIT_ROUNDOFF  # certified.md B68

# Numbers of equal parts into which a course is divided, tried in order until the bound is within the tolerance, and the
# largest number of configurations that are computed at a time.
PARTS, MOST_CONFIGURATIONS = (4, 16, 64, 256, 1024), 2**14


@dataclass(frozen=True)
class Line:
    """A straight line on which `trajectory` keeps a link between two rows of a path.

    The line leads from the pose of the link at the first row to its pose at the last row. The origin of the link moves
    along a straight line, and the link turns about a fixed axis in the shorter direction, as for `straight`.

    Parameters
    ----------
    link : str
    first, last : int
        Rows of the path at which the line begins and ends; negative rows count from the end. Default: the whole path.
    position, rotation : float
        Largest allowed deviations of the link from the line, in metres and radians, at least 1e-9 each. At every
        instant, the link's pose differs from some pose of the line by at most these deviations.

    Raises
    ------
    InputError
        If an argument has the wrong type or value.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, planners
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> path = [[0.0, 0.5], [0.5, 0.5], [1.0, 0.5], [1.0, 1.0]]
    >>> planners.trajectory(robot, path, velocity=1.0, acceleration=1.0, line=planners.Line("forearm", last=2))
    Trajectory(3.414 s, 2 joints, stops at 1 corner, 0 blends)
    """

    link: str
    first: int = 0
    last: int = -1
    position: float = POSITION
    rotation: float = ROTATION

    def __post_init__(self) -> None:
        _validate.expect_name(self.link, "link: expected the name of a link")
        for name in ("first", "last"):
            _validate.whole_number(getattr(self, name), name, -_validate.LARGEST_INTEGER)
        for name in ("position", "rotation"):
            object.__setattr__(self, name, checked_tolerance(getattr(self, name), name))


def checked_tolerance(x: Any, name: str) -> float:
    """Check a maximum deviation. A rotation cannot deviate by more than half a turn."""
    value = _validate.positive_scalar(x, name)
    if value < LEAST_TOLERANCE:
        raise InputError(f"{name}: expected at least {LEAST_TOLERANCE:g}, which rounding allows, found {value:g}")
    if name == "rotation" and value > np.pi:
        raise InputError(f"rotation: expected radians, at most π, found {value:g}; is it in degrees?")
    return value


class Step(NamedTuple):
    """The length of a vector that is fixed in a frame, and the joint at its tip: a slide, a turn, or none."""

    length: float
    kind: str
    column: int
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class KeptLine:
    """A line of poses, and the chain of joints to the link that must keep the line.

    At the fraction u, the position is `start` + u `way`, and the rotation is `rotation` + sin(u `angle`) `sine` +
    (1 - cos(u `angle`)) `cosine`.

    Attributes
    ----------
    robot : Robot
    line : Line
        The line, whose `first` and `last` are at least 0.
    steps : list of Step
    joints : int
        Number of links of the chain plus one.
    fractions : ndarray, shape (last - first + 1,)
        For each row, the fraction of the line whose pose is nearest to the row's pose.
    """

    robot: Robot
    line: Line
    steps: list[Step]
    joints: int
    start: Floats
    way: Floats
    rotation: Floats
    sine: Floats
    cosine: Floats
    angle: float
    fractions: Floats

    @classmethod
    def of(cls, robot: Robot, line: Line, rows: Floats) -> KeptLine:
        """Make the line from the link's pose at the first of several rows of a path to its pose at the last row."""
        chain = chain_to(robot, line.link)
        refuse_far(chain, np.eye(4), rows)
        poses = robot.forward_kinematics(rows)[:, robot.link_names.index(line.link)]
        R, start, way = poses[:, :3, :3], poses[0, :3, 3], poses[-1, :3, 3] - poses[0, :3, 3]
        turns = quaternions_of(product(R, R[0].T))
        turns *= np.where(turns[:, :1] < 0, -1.0, 1.0)  # the shorter direction
        half_sine = float(lengths(turns[-1, 1:]))
        axis = turns[-1, 1:] / half_sine if half_sine > 0 else np.zeros(3)
        angles = 2 * _elementary.arctan2(dot(turns[:, 1:], axis), turns[:, 0])
        angle = float(angles[-1])
        if angle > LARGEST_ANGLE:
            raise InputError("line: expected a turn of less than half a turn, found half a turn; divide the line")
        # The nearest pose has the least sum of squared deviations, in units of the tolerances.
        ways = np.column_stack([(poses[:, :3, 3] - start) / line.position, angles / line.rotation])
        size = float(dot(ways[-1], ways[-1]))
        u = dot(ways, ways[-1]) / size if size > 0 else np.zeros(len(rows))
        x, y, z = axis
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        sine = product(skew, R[0])
        return cls(
            robot, line, _steps(chain), len(chain.links) + 1, start, way, R[0], sine, product(skew, sine), angle,
            np.clip(u, 0.0, 1.0),
        )  # fmt: skip

    def keeps(self, courses: Floats, off: Floats) -> tuple[Bools, Floats]:
        """Return on which courses the link provably keeps the line, and bounds on the link's deviations.

        Parameters
        ----------
        courses : ndarray, shape (N, degree + 1, dof + 1)
            The last column is the fraction of the line.
        off : ndarray, shape (N, dof)
            The largest deviations of joint values from the courses.

        Returns
        -------
        ndarray of bool, shape (N,)
        ndarray, shape (N, 2)
            Bounds in metres, and in the Frobenius norm of rotation matrices.
        """
        most = np.array([self.line.position, chord_of(self.line.rotation)])
        kept, deviations = np.zeros(len(courses), dtype=bool), np.full((len(courses), 2), np.inf)
        bent, astray = self._bounds(courses, off)
        left = np.arange(len(courses))
        for parts in PARTS:
            gaps = self._gaps(courses[left], parts) + astray[left]
            deviations[left] = gaps + bent[left] / (8 * parts**2)
            kept[left] = (deviations[left] <= most).all(axis=1)
            left = left[~kept[left] & (gaps <= most).all(axis=1)]
        return kept, deviations

    # -- inside -------------------------------------------------------------------------------

    def _gaps(self, courses: Floats, parts: int) -> Floats:
        """Measure the largest deviations at the ends of equal parts of courses, shape (N, 2)."""
        at_a_time = max(1, MOST_CONFIGURATIONS // (parts + 1))
        if len(courses) > at_a_time:
            blocks = range(0, len(courses), at_a_time)
            return np.concatenate([self._gaps(courses[k : k + at_a_time], parts) for k in blocks])
        points = at_fractions(courses, np.arange(parts + 1) / parts)
        Q, u = points[..., :-1], points[..., -1]
        poses = self.robot.forward_kinematics(Q)[..., self.robot.link_names.index(self.line.link), :, :]
        half_sine = _elementary.sin(u * (self.angle / 2))[..., None, None]
        sine, cosine = _elementary.sin(u * self.angle)[..., None, None], 2 * half_sine * half_sine
        off = poses[..., :3, 3] - (self.start + u[..., None] * self.way)
        turned = poses[..., :3, :3] - (self.rotation + sine * self.sine + cosine * self.cosine)
        both = np.stack([lengths(off), lengths(turned.reshape(*turned.shape[:-2], 9))], axis=-1)
        return np.asarray(both.max(axis=1))

    def _bounds(self, courses: Floats, off: Floats) -> tuple[Floats, Floats]:
        """Bound the second derivatives of deviations, and the effects of joint errors and rounding (B68)."""
        degree, steps = courses.shape[1] - 1, np.diff(courses, axis=1)
        rates = degree * np.abs(steps).max(axis=1)
        bends = degree * (degree - 1) * np.abs(np.diff(steps, axis=1)).max(axis=1, initial=0.0)
        values, largest = np.abs(courses).max(axis=1), np.ones(len(courses))
        turn, turn_bend, turn_off, pull, length, slid = (np.zeros(len(courses)) for _ in range(6))
        for step in self.steps:
            size: Any = step.length
            if step.kind:
                value, rate, bend = (abs(step.multiplier) * each[:, step.column] for each in (values, rates, bends))
                error, value = abs(step.multiplier) * off[:, step.column], value + abs(step.offset)
                largest = np.maximum(largest, value)
            if step.kind == "slide":
                pull, slid, size = pull + 2 * rate * turn + bend, slid + error, size + value
            pull, length = pull + size * (turn * turn + turn_bend), length + size
            if step.kind == "turn":
                turn, turn_bend, turn_off = turn + rate, turn_bend + bend, turn_off + error
        u, u_bend = rates[:, -1], bends[:, -1]
        line_bend = (self.angle * u) ** 2 + self.angle * u_bend
        bent = np.stack([pull + lengths(self.way) * u_bend, np.sqrt(2) * (turn * turn + turn_bend + line_bend)], axis=1)
        reach = length + lengths(self.start) + lengths(self.way)
        rounding = ROUNDINGS * self.joints * largest
        astray = np.stack([turn_off * length + slid + rounding * reach, np.sqrt(2) * turn_off + rounding], axis=1)
        stretch = tolerances.CHAIN_STRETCH
        return stretch * bent, stretch * astray


def kept_lines(line: Any, rows: Floats) -> list[Line]:
    """Check an argument `line`. In the result, row numbers are counted from the start of the path."""
    if line is None:
        return []
    arguments = [line] if isinstance(line, str | Line) else _validate.listed(line, "line", wanted="a link or Lines")
    lines = [Line(each) if isinstance(each, str) else each for each in arguments]
    for k, each in enumerate(lines):
        if not isinstance(each, Line):
            raise InputError(f"line: expected the name of a link or planners.Line, found {_validate.short(each)}")
        first, last = (at + len(rows) * (at < 0) for at in (each.first, each.last))
        if not 0 <= first < last < len(rows):
            raise InputError(
                f"line: expected two of the {len(rows)} rows of the path, the first before the last, found "
                f"first={each.first}, last={each.last}"
            )
        lines[k] = Line(each.link, first, last, each.position, each.rotation)
    return lines


def chord_of(angle: float) -> float:
    """Return how far a rotation by the given angle is from the identity, in the Frobenius norm."""
    return float(2 * np.sqrt(2) * _elementary.sin(angle / 2))


def angle_of(chord: float) -> float:
    """Return the angle of a rotation at a given distance from the identity; `chord_of` is the inverse function."""
    return float(2 * _elementary.arcsin(min(chord / (2 * np.sqrt(2)), 1.0)))


def _steps(chain: Chain) -> list[Step]:
    """List the vectors and the joints of a chain, see `robots.reaching`."""
    steps = []
    for link, constants in zip(chain.links.tolist(), chain.constants, strict=True):
        kind, at = link[columns.KIND_OF_LINK], link[columns.COLUMN_OF_LINK]
        length = float(lengths(constants[columns.TRANSLATION : columns.TRANSLATION + 3]))
        how, offset = constants[columns.MULTIPLIER], constants[columns.OFFSET]
        first = int(chain.columns[at]) if kind != columns.FIXED else 0
        if kind == columns.PLANAR:
            steps += [Step(length, "slide", first, 1.0, 0.0), Step(0.0, "slide", first + 1, 1.0, 0.0)]
            steps.append(Step(0.0, "turn", first + 2, 1.0, 0.0))
        else:
            name = {columns.REVOLUTE: "turn", columns.PRISMATIC: "slide"}.get(kind, "")
            steps.append(Step(length, name, first, float(how), float(offset)))
    return steps
