"""Let several robots follow given paths without ever meeting: decide which robot waits, and when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from heapq import heappop, heappush
from itertools import product
from operator import add, le
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Floats
from loewner.errors import InputError, PlanningError
from loewner.planners.judge import Judge, checked_checker
from loewner.queries.pairs import Verdict
from loewner.robots import CollisionChecker
from loewner.robots.description.assembly import parts_of
from loewner.robots.description.robot import interpolated

# Largest number of states of all robots together. The proofs for 2^20 states take several minutes.
MOST_STATES = 2**20

# Two motions whose directions differ by less than the share STRAIGHT are parts of one straight motion.
STRAIGHT = 1e-9

# Speed of a value without a limit [rad/s or m/s].
USUAL_SPEED = 1.0

# For each path, the index of a row.
State = tuple[int, ...]


class _Way(NamedTuple):
    """A path in short steps.

    Attributes
    ----------
    columns : slice
        Columns of the path's values in a configuration of all robots.
    rows : ndarray, shape (n, width)
    times : ndarray, shape (n,)
        The times at which the robot reaches the rows if it never waits.
    """

    columns: slice
    rows: Floats
    times: Floats


@guarded
def coordinate(
    checker: CollisionChecker,
    paths: Mapping[str, ArrayLike],
    *,
    steps: int = 50,
    joint_error: ArrayLike = 0.0,
) -> Floats:
    """Combine the given paths of several robots into a single path for all of them, on which no two robots meet.

    Parameters
    ----------
    checker : CollisionChecker
        A checker whose robot was made by `Robot.join`.
    paths : mapping from str to array_like, shape (k, dof of the part) or (dof of the part,)
        For each part (`Robot.part`), the configurations of its path, or the single configuration at which it waits.
        Motions between configurations are straight.
    steps : int
        Number of steps into which the path with the longest duration is divided. At each step, a robot may wait.
    joint_error : float or array_like, shape (dof,)
        As for `CollisionChecker.certify_edges`, for the values of all robots.

    Returns
    -------
    ndarray, shape (k, dof)
        Configurations of all robots together. All straight motions between successive configurations are proven free.
        With these steps and the joints' maximum velocities, no other path is faster; a value without a limit moves at 1
        rad/s or 1 m/s. `planners.trajectory` assigns times to the path.

    Raises
    ------
    InputError
        If a path is missing or has the wrong shape, or there would be more than 2^20 states of all robots together.
    UnknownNameError
        If the robot has no part of this name.
    PlanningError
        If the starts or the ends are not free, or the robots cannot pass each other on these paths. The message names
        the two bodies that meet at the farthest point that the search reached.

    Notes
    -----
    The states of all robots form a grid. Along an edge of the grid, one robot takes a step; along a diagonal, several
    robots take a step. An A* search finds the fastest way through the grid, and proves the edges that it encounters. No
    robot moves backwards along its path.

    References
    ----------
    O'Donnell and Lozano-Pérez (1989), "Deadlock-free and collision-free coordination of two robot manipulators".

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot, planners
    >>> arm = Robot.from_urdf("arm.urdf")
    >>> far = [[1, 0, 0, 0], [0, 1, 0, 5], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> checker = CollisionChecker(Robot.join({"left": arm, "right": arm}, {"right": far}))
    >>> planners.coordinate(checker, {"left": [[0, 1], [1, 1]], "right": [[1, 1], [0, 1]]})
    array([[0., 1., 1., 1.],
           [1., 1., 0., 1.]])
    """
    checked_checker(checker)
    ways = _ways(checker, paths, _validate.whole_number(steps, "steps", 1))
    judge = Judge.of(checker, 0.0, joint_error)
    for place, state in (("starts", (0,) * len(ways)), ("ends", tuple(len(way.rows) - 1 for way in ways))):
        q = _configuration(ways, state)
        answer = judge.certified(q, q)
        if answer.verdict != Verdict.FREE:
            a, b = answer.names
            raise PlanningError(f"paths: expected {place} that are free together, found {a} and {b} too close")
    rows = np.array([_configuration(ways, state) for state in _fastest(judge, ways)])
    return _merged(judge, rows)


def _ways(checker: CollisionChecker, paths: Mapping[str, ArrayLike], steps: int) -> list[_Way]:
    """Check the paths and divide them into steps that take about the same time."""
    _validate.mapping(paths, "paths", "from names of parts to paths", 1)
    covered, checked_paths = np.zeros(checker.robot.dof, dtype=bool), []
    for name, path in paths.items():
        part = checker.robot.part(name)
        rows = np.atleast_2d(part.robot.checked(path, f"path of {name!r}"))
        if rows.ndim != 2 or len(rows) == 0:
            raise InputError(f"path of {name!r}: expected shape (k, {part.robot.dof}), found {rows.shape}")
        if covered[part.columns].any():
            raise InputError(f"paths: expected one path for each part, found another one for values of {name!r}")
        covered[part.columns] = True
        speed = np.where(part.robot.velocity > 0, part.robot.velocity, USUAL_SPEED)
        lengths = (np.abs(np.diff(rows, axis=0)) / speed).max(axis=1, initial=0.0)
        checked_paths.append((part.columns, part.robot, rows, lengths))
    if not covered.all():
        wanted = [name for name, part in parts_of(checker.robot).items() if not covered[part.columns].any()]
        values = [checker.robot.configuration_names[k] for k in np.flatnonzero(~covered)]
        raise InputError(f"paths: expected one for each part, found none for {', '.join(wanted or values)}")
    if not any(len(lengths) and lengths.any() for *_, lengths in checked_paths):
        raise InputError("paths: expected a robot that moves, found none")
    longest = max(float(lengths.sum()) for *_, lengths in checked_paths)
    numbers = [np.maximum(np.ceil(lengths / longest * steps - 1e-9), lengths > 0) for *_, lengths in checked_paths]
    total = math.prod(float(counts.sum()) + 1.0 for counts in numbers)
    if total > MOST_STATES:
        raise InputError(f"steps: expected at most {MOST_STATES} states of all robots together, found {total:.0f}")
    ways = []
    for (columns, robot, rows, lengths), of_motions in zip(checked_paths, numbers, strict=True):
        counts = of_motions.astype(np.int64)
        at = np.repeat(np.arange(len(counts)), counts)
        share = (np.arange(len(at)) - np.repeat(np.cumsum(counts) - counts, counts) + 1) / counts[at]
        way_rows = np.concatenate([rows[:1], interpolated(robot, rows[at], rows[at + 1], share[:, None])])
        way_rows[1:][share == 1.0] = rows[at[share == 1.0] + 1]  # exact copies, quaternions included
        times = (np.cumsum(lengths) - lengths)[at] + share * lengths[at]
        ways.append(_Way(columns, way_rows, np.append(0.0, times)))
    return ways


def _configuration(ways: list[_Way], state: State) -> Floats:
    q = np.empty(sum(way.rows.shape[1] for way in ways))
    for way, k in zip(ways, state, strict=True):
        q[way.columns] = way.rows[k]
    return q


def _fastest(judge: Judge, ways: list[_Way]) -> list[State]:
    """Find the states of the fastest way from the first rows of all paths to the last rows, by A*."""
    ends = tuple(len(way.rows) - 1 for way in ways)
    moves = [move for move in product((0, 1), repeat=len(ways)) if any(move)]

    def left(state: State) -> float:
        return max(float(way.times[-1] - way.times[k]) for way, k in zip(ways, state, strict=True))

    start: State = (0,) * len(ways)
    waiting, costs, above, done = [(left(start), 0, start)], {start: 0.0}, {start: start}, set()
    while waiting:
        _, _, state = heappop(waiting)
        if state == ends:
            states = [state]
            while states[-1] != start:
                states.append(above[states[-1]])
            return states[::-1]
        if state in done:
            continue
        done.add(state)
        nexts = [tuple(map(add, state, move)) for move in moves]
        nexts = [new for new in nexts if new not in done and all(map(le, new, ends))]
        if not nexts:
            continue
        b = np.array([_configuration(ways, new) for new in nexts])
        free = judge.free(np.repeat(_configuration(ways, state)[None], len(b), axis=0), b)
        for new, is_free in zip(nexts, free.tolist(), strict=True):
            took = max(float(way.times[n] - way.times[k]) for way, k, n in zip(ways, state, new, strict=True))
            cost = costs[state] + took
            if is_free and cost < costs.get(new, math.inf):
                costs[new], above[new] = cost, state
                heappush(waiting, (cost + left(new), -sum(new), new))
    raise PlanningError(_why(judge, ways, done, ends))


def _why(judge: Judge, ways: list[_Way], done: set[State], ends: State) -> str:
    """Make the error message: how far the robots got, and which bodies meet if all robots take the next step."""
    farthest = max(done, key=sum)
    ahead = tuple(min(k + 1, end) for k, end in zip(farthest, ends, strict=True))
    answer = judge.certified(_configuration(ways, farthest), _configuration(ways, ahead))
    shares = ", ".join(
        f"{way.times[k] / max(way.times[-1], 1e-300):.0%}" for way, k in zip(ways, farthest, strict=True)
    )
    between = f": there {answer.names[0]} and {answer.names[1]} meet" if any(answer.names) else ""
    same = {name.split("/")[0] for name in answer.names}
    if any(answer.names) and len(same) == 1:
        between += f" (two bodies of {same.pop()!r} itself)"
    return (
        f"expected paths on which the robots can pass each other, found none among {len(done)} states, beyond {shares} "
        f"of the paths{between}; give other paths, or more steps"
    )


def _merged(judge: Judge, rows: Floats) -> Floats:
    """Remove rows within straight motions, if the resulting longer motions are also proven."""
    steps = np.diff(rows, axis=0)
    sizes, turns = (np.abs(ways).max(axis=1, initial=0.0) for ways in (steps[1:], np.diff(steps, axis=0)))
    corners = np.concatenate([[0], np.flatnonzero(turns > STRAIGHT * sizes) + 1, [len(rows) - 1]])
    free = judge.free(rows[corners[:-1]], rows[corners[1:]])
    ends = zip(corners[:-1], corners[1:], free.tolist(), strict=True)
    kept = [np.arange(last if is_free else first + 1, last + 1) for first, last, is_free in ends]
    return np.asarray(rows[np.concatenate([corners[:1], *kept])])
