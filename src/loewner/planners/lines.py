"""Define `straight`: motions of the joints along which a link provably follows a straight line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner import _validate
from loewner._guard import guarded
from loewner._kernels import columns
from loewner._validate import Floats
from loewner.errors import InputError, PlanningError
from loewner.planners.joint_limits import ON_LIMIT
from loewner.planners.judge import TOLERANCE, Judge, checked_checker
from loewner.planners.line_bounds import Line, Strays, Turns, strays
from loewner.queries import Verdict
from loewner.robots import CollisionChecker, Robot
from loewner.robots.contacts import deeper_than_ends
from loewner.robots.proofs import prove_by_rules
from loewner.robots.reaching import Chain, near, refuse_far, targets_of
from loewner.robots.robot import chain_to, link_poses

# The first steps along a line, in metres and radians; from one to the next, Newton's method finds the same branch.
FIRST_STEPS = 0.15, 0.5

# A joint that turns by more than this in a first step [rad] may have jumped to another branch; the step is halved.
LEAP = 0.75

# Shortest step and shortest motion, as fractions of the line.
LEAST_STEP, LEAST_MOTION = 2.0**-12, 2.0**-16

# Tolerances below this [m, rad] are near the rounding of poses; an axis is kept by cosines, whose rounding counts more.
LEAST_TOLERANCE, LEAST_ANGLE = 1e-9, 1e-6

# Parts into which a motion is divided at a time at most, and the share of the tolerance that they may take.
MOST_PARTS, SHARE = 16, 0.75

# The longest line [m]; motions along a longer one would be shorter than LEAST_MOTION.
LONGEST = FIRST_STEPS[0] / LEAST_MOTION

# The largest angle of a line [rad]: at half a turn, rounding decides which way around is the shorter one.
LARGEST_ANGLE = np.pi - 1e-6

# Singular values of the Jacobian [m, rad] below this count as singular in messages.
SINGULAR = 0.02

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Kept(NamedTuple):
    """An axis of the link that stays within an angle of a direction of the world."""

    axis: Floats
    direction: Floats
    angle: float


@guarded
def straight(
    checker: CollisionChecker,
    start: ArrayLike,
    link: str,
    T: ArrayLike,
    *,
    position: float = 1e-4,
    rotation: float = 1e-3,
    joints: str | Iterable[str] | None = None,
    keep: tuple[str | ArrayLike, ArrayLike, float] | None = None,
) -> Floats:
    """Move a link along a straight line to a pose, provably at every instant and free of collisions.

    The line leads from the pose of the link at `start` to `T`: the origin of the link moves along a straight line, and
    its rotation at a constant rate about a fixed axis, by the shorter way around.

    Parameters
    ----------
    checker : CollisionChecker
    start : array_like, shape (dof,)
    link : str
    T : array_like, shape (4, 4)
        T_world_link at the end, in metres.
    position, rotation : float
        Largest deviations of the link from the pose that belongs to the same fraction of the line, in metres and
        radians, at least 1e-9.
    joints : str or iterable of str, optional
        A group, or names of joints: only these joints move. Default: all that move the link.
    keep : (axis, direction, angle), optional
        Additionally, an axis of the link ("x", "y", "z" or a vector) must stay within an angle [rad] of a direction of
        the world, as of a cup that must not be spilt. It holds at every instant, including the deviations.

    Returns
    -------
    ndarray, shape (k, dof)
        Configurations, beginning with `start`. Each joint value changes linearly from one to the next.

    Raises
    ------
    PlanningError
        If the link cannot follow the line, because of a limit or a singularity; if a motion is not proven free; or if
        the axis does not keep its direction. The message states the fraction of the line, and names joints or bodies.
    InputError
        If an argument has the wrong shape or value, if the line turns the link by half a turn, or if a floating or ball
        joint would have to move.
    UnknownNameError
        If there is no such link, joint or group.

    See Also
    --------
    Robot.reach : Finds a start. plan : Finds a path to any configuration that reaches a pose.

    Notes
    -----
    Each motion is divided until a bound on its deviation, derived in docs/certified.md, is within the tolerances. The
    motions are proven by `CollisionChecker.certify_edges`, so `Scene.leave` and `Scene.reach` apply.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> pose = robot.forward_kinematics([0.5, 1.0])[1]
    >>> straight(CollisionChecker(robot), [0.0, 1.0], "cart", pose).round(9)
    array([[0. , 1. ],
           [0.5, 1. ]])
    """
    robot = checked_checker(checker).robot
    position = _at_least(LEAST_TOLERANCE, position, "position")
    rotation = min(_at_least(LEAST_TOLERANCE, rotation, "rotation"), np.pi)
    q, kept = robot.checked_one(start, "start"), None if keep is None else _kept(keep)
    target = targets_of(_validate.pose(T, "T")[None])[0]
    chain = chain_to(robot, link, joints)
    number = robot.link_names.index(link)
    if "turns" not in chain.kept:
        chain.kept["turns"] = Turns.of(chain, link)
    turns = chain.kept["turns"]
    refuse_far(chain, target, q)
    line = Line.between(link_poses(robot, q[None])[0, number], target)
    if line.angle > LARGEST_ANGLE:
        raise InputError("T: expected a turn of less than half a turn, found half a turn; go by a pose in between")
    if (length := float(np.linalg.norm(line.way))) > LONGEST:
        raise InputError(f"T: expected a line of at most {LONGEST:g} m, found {length:g} m; go by a pose in between")
    judge = Judge.of(checker, 0.0)
    u, Q = _followed(robot, chain, line, q, link)
    if not turns.turning.any():  # joints that slide follow a line in one motion
        u, Q = u[[0, -1]], Q[[0, -1]]
    limits = np.array([position, 2 * np.sqrt(2) * np.sin(rotation / 2)])
    while True:
        found = strays(robot, chain, turns, line, u, Q, number, None if kept is None else kept[:2])
        if kept is not None:
            _refuse_tilt(found, u, kept, link)
        parts = _parts(found, limits, kept)
        if (parts == 1).all():
            break
        u, Q = _divided(robot, chain, line, u, Q, parts, link)
    _refuse_collisions(judge, u, Q, link)
    return Q


def _at_least(least: float, x: Any, name: str) -> float:
    """Check a tolerance."""
    value = _validate.positive_scalar(x, name)
    if value < least:
        raise InputError(f"{name}: expected at least {least:g}, which rounding allows, found {value:g}")
    return value


def _kept(keep: Any) -> Kept:
    """Check an axis that is to be kept."""
    listed = _validate.listed(keep, "keep", wanted="(axis, direction, angle)")
    if len(listed) != 3:
        raise InputError(f"keep: expected (axis, direction, angle), found {_validate.short(keep)}")
    axis = AXES[_validate.choice(listed[0], "keep, axis", AXES)] if isinstance(listed[0], str) else listed[0]
    units = []
    for vector, name in ((axis, "keep, axis"), (listed[1], "keep, direction")):
        checked = _validate.finite_array(vector, name, (3,))
        length = float(np.linalg.norm(checked))
        if not 0 < length < np.inf:
            raise InputError(f"{name}: expected a vector with a length, found {_validate.short(vector)}")
        units.append(checked / length)
    return Kept(units[0], units[1], min(_at_least(LEAST_ANGLE, listed[2], "keep, angle"), np.pi))


def _followed(robot: Robot, chain: Chain, line: Line, q: Floats, link: str) -> tuple[Floats, Floats]:
    """Follow a line in steps, shorter where they fail; return the fractions and configurations."""
    fractions, rows = [0.0], [q]
    outside = (q[chain.columns] < chain.ranges[columns.LEAST] - ON_LIMIT) | (
        q[chain.columns] > chain.ranges[columns.MOST] + ON_LIMIT
    )
    if outside.any():
        raise PlanningError(
            f"start: expected a configuration within the limits, found {_named(robot, chain, outside, q)} outside"
        )
    if not line.way.any() and line.angle == 0:
        return np.array([0.0, 1.0]), np.stack([q, q])
    first = 1.0 / max(
        1.0, np.ceil(float(np.linalg.norm(line.way)) / FIRST_STEPS[0]), np.ceil(line.angle / FIRST_STEPS[1])
    )
    step, turning = first, np.isin(chain.ranges[columns.HOW], (columns.PLAIN, columns.WRAPS))
    rate = np.zeros(len(chain.columns))
    while fractions[-1] < 1.0:
        u = min(fractions[-1] + step, 1.0)
        u = 1.0 if 1.0 - u < LEAST_STEP else u
        here = rows[-1][chain.columns]
        guess = (here + (u - fractions[-1]) * rate).clip(chain.ranges[columns.LEAST], chain.ranges[columns.MOST])
        values, reached = near(chain, line.poses(np.array([u])), guess[None])
        if reached[0] and np.abs(values[0] - here)[turning].max(initial=0.0) <= LEAP:
            rate = (values[0] - here) / (u - fractions[-1])
            row = rows[-1].copy()
            row[chain.columns] = values[0]
            rows.append(row)
            fractions.append(u)
            step = min(2 * step, first)
        elif step > LEAST_STEP:
            step, rate = 0.5 * step, 0.0 * rate
        else:
            raise _stopped(robot, chain, fractions[-1], rows[-1], link)
    return np.array(fractions), np.array(rows)


def _parts(found: Strays, limits: Floats, kept: Kept | None) -> Floats:
    """Return into how many parts to divide each motion, 1 for motions that are proven to be near enough to the line."""
    good = (found.positions <= limits[0]) & (found.rotations <= limits[1])
    if kept is not None:
        good &= found.leasts >= np.cos(kept.angle)
    # The number m with bends / m² + twists / m³ equal to the tolerance.
    bends, twists = (part / (SHARE * limits[:, None]) + 1e-9 for part in (found.bends, found.twists))
    wanted = 1.0 + np.sqrt(bends)
    for _ in range(4):
        wanted = np.sqrt(bends + twists / wanted)
    return np.where(good, 1.0, np.clip(np.ceil(wanted.max(axis=0)), 2, MOST_PARTS))


def _refuse_tilt(found: Strays, u: Floats, kept: Kept, link: str) -> None:
    """Raise an error where the line itself does not keep the axis."""
    tilted = found.cosines < np.cos(kept.angle)
    short = (found.leasts < np.cos(kept.angle)) & (np.diff(u) < LEAST_MOTION * MOST_PARTS)
    if tilted.any() or short.any():
        k = int(tilted.argmax()) if tilted.any() else int(short.argmax())
        raise PlanningError(
            f"line: expected {link} to keep within {kept.angle:g} rad of the direction on the whole line, found "
            f"{np.arccos(np.clip(found.cosines[k], -1, 1)):.6g} rad at the fraction {u[k]:.4g}"
        )


def _divided(
    robot: Robot, chain: Chain, line: Line, u: Floats, Q: Floats, parts: Floats, link: str
) -> tuple[Floats, Floats]:
    """Divide motions into parts, with configurations on the line between them."""
    counts = parts.astype(np.int64)
    which = np.repeat(np.arange(len(counts)), counts)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)) / parts[which]
    new = share > 0
    at = u[which] + share * (u[which + 1] - u[which])
    rows = Q[which] + share[:, None] * (Q[which + 1] - Q[which])
    values, reached = near(chain, line.poses(at[new]), rows[new][:, chain.columns])
    if not reached.all():
        k = int(np.flatnonzero(new)[reached.argmin()])
        raise _stopped(robot, chain, at[k - 1], Q[which[k]], link)
    whole = rows[new]
    whole[:, chain.columns] = values
    rows[new] = whole
    u, Q = np.append(at, u[-1]), np.concatenate([rows, Q[-1:]])
    short = np.diff(u) < LEAST_MOTION
    if short.any():
        k = int(short.argmax())
        raise _stopped(robot, chain, u[k], Q[k], link)
    return u, Q


def _named(robot: Robot, chain: Chain, which: Floats, q: Floats) -> str:
    """List values of a chain, for messages."""
    places = chain.columns[np.flatnonzero(which)].tolist()
    return ", ".join(f"{robot.configuration_names[k]} = {q[k]:.6g}" for k in places)


def _stopped(robot: Robot, chain: Chain, u: float, q: Floats, link: str) -> PlanningError:
    """Make the error for a line that cannot be followed beyond a fraction."""
    values, (least, most) = q[chain.columns], chain.ranges[[columns.LEAST, columns.MOST]]
    room = np.minimum(1e-2, 0.01 * (most - least))
    limited = (values - least < room) | (most - values < room)
    J = robot.jacobian(q, link)[:, chain.columns[chain.moving]]
    smallest = float(np.linalg.svd(J, compute_uv=False)[min(J.shape) - 1]) if min(J.shape) == 6 else 0.0
    reasons = [f"at or near limits: {_named(robot, chain, limited, q)}"] if limited.any() else []
    if smallest < SINGULAR:
        reasons.append(
            "fewer than six joints move it" if min(J.shape) < 6 else f"singular, or the end of its reach (smallest "
            f"singular value of the Jacobian {smallest:.2g})"
        )  # fmt: skip
    why = "; ".join(reasons) or "the joints would have to jump"
    return PlanningError(
        f"line: expected {link} to follow the line to its end, found that it cannot go on beyond the fraction {u:.4g}: "
        f"{why}"
    )


def _refuse_collisions(judge: Judge, u: Floats, Q: Floats, link: str) -> None:
    """Raise an error unless all motions are proven free, by the scene's rules on contact at the ends where needed."""
    left = np.flatnonzero(~judge.free(Q[:-1], Q[1:]))
    if len(left) == 0:
        return
    found = prove_by_rules(judge.ready, Q[left], Q[left + 1], TOLERANCE)
    if (found.verdicts == Verdict.FREE).all():
        rows = np.setdiff1d(np.append(left, left + 1), [0, len(Q) - 1])
        if (deeper := deeper_than_ends(judge.ready, Q, rows, TOLERANCE)) is not None:
            row, pair = deeper
            a, b = (judge.ready.names[k] for k in judge.ready.pairs[pair])
            raise PlanningError(
                f"line: expected contacts that get no deeper than at its ends, found {a} and {b} deeper "
                f"at the fraction {u[row]:.4g}"
            )
        return
    found.expect_short(Q[left], Q[left + 1])
    worst, told = int((found.verdicts != Verdict.FREE).argmax()), found.of_shape((len(left),), judge.ready)
    k, (a, b) = left[worst], told.names[worst]
    how = "collide" if told.verdict[worst] == Verdict.COLLIDING else f"come within {TOLERANCE:g} m of their margin"
    raise PlanningError(
        f"line: expected a free line of {link}, found that {a} and {b} {how} at the fraction "
        f"{u[k] + told.fraction[worst] * (u[k + 1] - u[k]):.4g}{judge.how_surfaces_are_seen(told.names[worst])}"
    )
