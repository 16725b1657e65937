"""Plan for mobile bases: search a lattice whose arcs are proven free, connect it to the goal, and shorten the path.

The search is A* over cells of position and heading (hybrid A*: Dolgov et al., IJRR 2010). The estimated cost of a pose
is its distance from the goal on a grid of the map. The grid lengthens distances in cells that are blocked at all tried
headings. Poses are taken from the queue in batches, because one kernel call has as much overhead as the proofs of forty
arcs.
"""

from __future__ import annotations

import heapq
import math
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import codes
from loewner.errors import ConvergenceError, InputError, PlanningError
from loewner.planners import steering
from loewner.planners.drives import Drive, arcs_of, base_columns
from loewner.planners.joint_limits import beyond
from loewner.planners.judge import TOLERANCE, Judge
from loewner.planners.pose_goals import PoseGoal
from loewner.planners.searches import Search, checked_search
from loewner.planners.space import Space, Task
from loewner.planners.steering import Ways, driven, moved
from loewner.queries.pairs import Verdict
from loewner.robots import CollisionChecker, Robot
from loewner.robots.checking import verdicts
from loewner.robots.description.robot import unlimited
from loewner.robots.proofs import curves, motions
from loewner.robots.proofs.proof_models import model_of
from loewner.robots.proofs.proofs import ProofOptions, refuse_starts

Kind = Literal["differential", "car"]

# Angle of the lattice's arcs and turns in place [rad], and length of the longest line, in steps.
STEP, LONG = math.pi / 8.0, 4.0

# Number of searches, and the factor by which each search refines the motions of the previous one. The next search
# begins when all poses of a search have been tried.
LEVELS, FINER = 3, 4.0

# Size of the lattice's cells: their edge, in steps, and the number of headings in a whole turn.
EDGE, HEADINGS = 0.8, 24

# Number of poses that are taken from the queue at a time, and number of ways to the goal that are tried from each pose.
BATCH, SHOTS = 16, 4

# Largest number of grid cells, number of headings that are tried in each cell, and the factor by which a blocked cell
# lengthens distances.
GRID, TRIED, BLOCKED = 2**13, 4, 5.0

# Weight of the estimate in the order of the queue. A larger weight makes searches faster and ways longer. Shortening
# removes most of the additional length.
GREED = 1.5

# Cost of a change between forwards and backwards, as a share of the cost of a step.
CHANGE = 1.0

# One batch in SHOOTING tries ways to the goal. It tries them from the first MOST_SHOOTING poses that need no large
# detour: their distance on the grid is at most DETOUR times the straight distance plus two radii.
MOST_SHOOTING, DETOUR, SHOOTING = 4, 1.15, 2

# Number of passes that shorten a way, and number of poses into which a pass divides the way.
PASSES, PLACES = 3, 32

# Largest allowed radius of turns, and largest allowed distance between a joint's limits [m].
LARGEST = 1e6

# Lengths and turns of at most NOTHING [m, rad] count as rounding errors of formulas.
NOTHING = 1e-10

# Shortening ends with the first pass that saves less than the share GAIN of the cost.
GAIN = 0.01


class Path(NamedTuple):
    """Poses of shape (k + 1, 3), and the lengths and turns of the motions between them, shape (k, 2)."""

    poses: Floats
    motions: Floats


@dataclass(frozen=True, eq=False)
class Base:
    """A base, and the space in which it may drive.

    Attributes
    ----------
    radius : float
        Radius of the lattice's arcs, in metres; for a car, the minimum turning radius.
    step : float
        Length of the lattice's motions.
    """

    judge: Judge
    kind: Kind
    radius: float
    step: float
    reverse: bool
    columns: tuple[int, int, int]
    still: Floats
    lower: Floats
    upper: Floats

    def ways(self, a: Floats, b: Floats) -> Ways:
        """Return the ways from poses a to poses b that the base could drive if there were no obstacles."""
        if self.kind == "car":
            return steering.car(a, b, self.radius, self.reverse)
        return steering.differential(a, b, self.reverse)

    def lattice(self) -> Floats:
        """Return the lattice's motions, shape (motions, 2)."""
        turn, step = self.step / self.radius, self.step
        ahead = [[step, 0.0], [step, turn], [step, -turn], [LONG * step, 0.0]]
        back = [[-length, angle] for length, angle in ahead] if self.reverse else []
        return np.array(ahead + back + ([[0.0, STEP], [0.0, -STEP]] if self.kind == "differential" else []))

    def inside(self, poses: Floats) -> Bools:
        """Return which poses, shape (..., 3), are within the limits."""
        return np.asarray(~beyond(poses, self.lower, self.upper).any(axis=-1))

    def free_at(self, poses: Floats) -> Bools:
        """Return which poses, shape (N, 3), are within the limits and free."""
        free = self.inside(poses)
        Q = np.tile(self.still, (int(np.count_nonzero(free)), 1))
        Q[:, list(self.columns)] = poses[free]
        free[free] = verdicts.free(self.judge.ready, Q)
        return free

    def free(self, poses: Floats, ways: Floats) -> Bools:
        """Return which ways, shape (N, motions, 2), from poses, shape (N, 3), are proven free and within the limits.

        The midpoints and ends of motions are tried first: if such a pose collides, the way needs no proof.
        """
        places = driven(poses, ways[..., 0], ways[..., 1])
        begins, ends = places[:, :-1], places[:, 1:]
        needed, free = (ways != 0.0).any(axis=2), np.ones(len(ways), dtype=bool)
        for tried in (ends, moved(begins, ways[..., 0] / 2.0, ways[..., 1] / 2.0)):
            at = np.flatnonzero(free)
            free[at] = (self.free_at(tried[at].reshape(-1, 3)).reshape(needed[at].shape) | ~needed[at]).all(axis=1)
        at, motion = np.nonzero(needed & free[:, None])
        if len(at) == 0:
            return free
        lengths, turns = ways[at, motion].T
        arcs = arcs_of(begins[at, motion], lengths, turns, ends[at, motion], np.zeros((len(at), 3)))
        courses, off = arcs.of_robot(self.still, list(self.columns))
        off += self.judge.errors
        answers = motions.settle(self.judge.ready, courses, TOLERANCE, off)
        refuse_starts(self.judge.ready, courses[:, 0], answers)
        proven = (answers.verdicts == codes.FREE) & self.inside(arcs.courses).all(axis=1)
        np.logical_and.at(free, at[arcs.owner], proven)
        return free

    def best(self, a: Floats, b: Floats, count: int) -> tuple[Floats, Floats]:
        """Return the cheapest ways, shape (N, count, motions, 2), and their costs with direction changes."""
        ways = self.ways(a, b)
        costs, count = ways.costs, min(count, ways.lengths.shape[1])
        order = np.argpartition(costs, count - 1, axis=1)[:, :count]
        at = order[..., None]
        cheapest = np.stack([np.take_along_axis(part, at, axis=1) for part in ways], axis=-1)
        cheapest = np.nan_to_num(cheapest, nan=0.0)
        return cheapest, np.take_along_axis(costs, order, axis=1) + CHANGE * self.step * _changes(cheapest).sum(axis=-1)


@guarded
def plan_drive(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike,
    base: Kind,
    *,
    radius: float | None = None,
    reverse: bool = True,
    joint_error: ArrayLike = 0.0,
    search: Search | None = None,
    proof: bool = False,
) -> Drive:
    """Plan a drive of a mobile base that has the joints x, y and theta, and cannot move sideways.

    Parameters
    ----------
    checker : CollisionChecker
        A checker whose robot has a base from `Robot.footprint` or `Robot.add_base`. At theta = 0, the base faces along
        x. The origin of the base follows arcs and lines. Put the origin midway between the driven wheels of a
        differential base, or in the middle of a car's rear axle.
    start, goal : array_like, shape (dof,)
        Only the base moves, so all other joints must have the same values at the start and the goal.
    base : {"differential", "car"}
    radius : float, optional
        Least radius of a car's turns, in metres; required for a car.
    reverse : bool
        Whether the base may drive backwards. If a car cannot reverse, a single arc may be longer than half a turn.
    joint_error
        As for `plan`.
    search : Search, optional
        The fields `max_iterations`, `timeout` and `simplify` apply. The field `planner` must not be set. Motions are
        always proven.
    proof : bool
        Also write a `Proof` of the drive, as `CollisionChecker.certify_trajectory` does.

    Returns
    -------
    Drive
        Arcs, straight lines and turns in place, proven FREE as a whole. The drive ends at the goal, except that its
        heading may differ by whole turns.

    Raises
    ------
    PlanningError, InputError
        As for `plan`.
    ConvergenceError
        As for `certify_trajectory`, if a proof is requested. The attribute `partial` of the error is the drive without
        a proof.

    Notes
    -----
    A* searches a lattice of arcs, lines and turns in place (hybrid A*: Dolgov et al., IJRR 2010) until one of its poses
    is connected to the goal. For a car, the connection is a Reeds-Shepp path, or a Dubins path if the car may not
    reverse. For a differential base, the connection is a turn, a line and another turn. Parts of the path are then
    replaced with shorter ways of the same kinds. A contact counts as a collision even if `Scene.leave` or `Scene.reach`
    permits it.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> corners = [[-0.2, -0.2], [0.4, -0.2], [0.4, 0.2], [-0.2, 0.2]]
    >>> cart = Robot.footprint(corners, height=0.3, bounds=[[-1, 3], [-1, 1]])
    >>> plan_drive(CollisionChecker(cart), [0, 0, 0], [2, 0, 0], "car", radius=0.5).motions
    array([[2., 0.]])
    """
    search = checked_search(search)
    search._refuse("base")
    proof = _validate.flag(proof, "proof")
    begin, task = time.monotonic(), Task.of(checker, start, goal)
    q, goals = task.start, task.goal
    radius, reverse = _checked_options(base, radius, reverse)
    columns = base_columns(checker.robot)
    if isinstance(goals, PoseGoal):
        raise InputError("goal: expected a configuration for a base, found a PoseGoal")
    if len(goals) != 1:
        raise InputError(f"goal: expected one configuration for a base, found {len(goals)}")
    judge = Judge.of(checker, 0.0, joint_error)
    model = model_of(judge.ready) if proof else None
    drives = _base(judge, base, radius, reverse, columns, q, goals)
    here, there = q[list(columns)], goals[0, list(columns)]
    path, iterations = _found(drives, here, there, search._most, begin + search.timeout)
    ways = [path]
    if search.simplify:
        better = _shortened(drives, path)
        ways = [_merged(better), better, path]
    options = ProofOptions(TOLERANCE, judge.errors)
    for way in ways:  # a way whose motions are proven one by one is nearly always proven as a whole
        drive = _drive(checker.robot, drives, way, there)
        drive = replace(drive, iterations=iterations, seconds=time.monotonic() - begin)
        curve = curves.curve_of(checker.robot, drive, "drive")
        try:
            answer = curves.certified(checker.robot, judge.ready, [curve], options, model)[0]
        except ConvergenceError as error:
            raise ConvergenceError(str(error), partial=drive) from None
        if answer.verdict == Verdict.FREE:
            return replace(drive, proof=answer.proof)
    raise PlanningError("expected a drive that is proven as a whole, found one that comes too near to contact")


def _checked_options(base: Kind, radius: float | None, reverse: bool) -> tuple[float | None, bool]:
    """Check the kind of a base; return the radius of a car, and whether it may reverse."""
    _validate.choice(base, "base", ("differential", "car"))
    reverse = _validate.flag(reverse, "reverse")
    if base == "car" and radius is None:
        raise InputError("radius: expected the least radius of a car's turns, found none")
    if base == "differential" and radius is not None:
        raise InputError("radius: expected none for a differential base, which turns in place")
    if radius is None:
        return None, reverse
    least = _validate.positive_scalar(radius, "radius")
    if not least <= LARGEST:
        raise InputError(f"radius: expected {LARGEST:g} m at most, found {least:g}")
    return least, reverse


def _base(
    judge: Judge, kind: Kind, radius: float | None, reverse: bool, columns: tuple[int, int, int], q: Floats,
    goals: Floats,
) -> Base:  # fmt: skip
    """Check the ends, and return the base."""
    robot, at = judge.checker.robot, np.array(columns)
    lower, upper = robot.lower[at], robot.upper[at]
    below, above, _ = unlimited(robot)
    if (below | above)[at[:2]].any() or not (upper - lower)[:2].max() <= LARGEST:
        raise InputError(
            f"base: expected limits of x and y, at most {LARGEST:g} m apart, found others; give bounds to "
            "Robot.footprint or Robot.add_base"
        )
    if not (below & above)[at[2]]:
        raise InputError("base: expected a base that turns without limits, found one with limits")
    lower[2], upper[2] = -np.inf, np.inf
    space = Space(judge.checker, at, q, lower, upper, np.array([False, False, True]))
    space.checked_goals(q, goals, judge, ["goal[0]"])
    if (np.abs((goals[0] - q)[at[:2]]) <= NOTHING).all() and abs(math.sin((goals[0] - q)[at[2]] / 2.0)) <= NOTHING:
        raise InputError("goal: expected a pose of the base that differs from the start, found the same")
    around = _reach(robot, columns, q) if radius is None else radius
    return Base(judge, kind, around, STEP * around, reverse, columns, q, lower, upper)


def _reach(robot: Robot, columns: tuple[int, int, int], q: Floats) -> float:
    """Return the robot's largest distance from the point about which it turns in place, in metres."""
    rest = q.copy()
    rest[list(columns)] = 0.0
    poses, reach = robot.forward_kinematics(rest), 0.0
    for link, body in robot.bodies.items():
        T, outer = poses[robot.link_names.index(link)], body.outer
        centers = np.atleast_2d(outer.center) @ T[:3, :3].T + T[:3, 3]
        sizes = np.atleast_2d(outer.semi_axes).max(axis=1)
        reach = max(reach, float((np.hypot(centers[:, 0], centers[:, 1]) + sizes).max()))
    return reach if reach > 0.0 else 1.0


# -- search -------------------------------------------------------------------------------------


def _found(base: Base, start: Floats, goal: Floats, most: int, until: float) -> tuple[Path, int]:
    """Search for a way, with finer motions if necessary. A base that may reverse begins at the end with less room."""
    steps, ends = base.lattice(), np.stack([start, goal])
    room = base.free(np.repeat(ends, len(steps), axis=0), np.tile(steps, (2, 1))[:, None]).reshape(2, -1).sum(axis=1)
    swapped = base.reverse and bool(room[1] < room[0])
    begin, end = (goal, start) if swapped else (start, goal)
    spent, nearest, grid = 0, (math.inf, math.inf, math.inf), Grid.of(base, end)
    for finest in range(LEVELS):
        path, taken, gap = _search(base, grid, begin, end, finest, most - spent, until)
        spent, nearest = spent + taken, min(nearest, gap)
        if path is not None:
            return (_along(start, -path.motions[::-1]) if swapped else path), spent
        if spent >= most or time.monotonic() > until:
            break
    why = (
        "in time" if time.monotonic() > until else f"from {spent} poses" + ("" if spent >= most else ", which are all")
    )
    here, there = ("goal", "start") if swapped else ("start", "goal")
    raise PlanningError(
        f"expected a way of the base from start to goal, found none {why}; from the {here}, the search came within "
        f"{nearest[1]:.3g} m and {math.degrees(nearest[2]):.3g} degrees of the {there}"
    )


def _search(
    base: Base, grid: Grid, start: Floats, goal: Floats, finest: int, most: int, until: float
) -> tuple[Path | None, int, tuple[float, float, float]]:
    """Search the lattice from the start until a way from one of its poses to the goal is proven.

    Motions that are finer by a power of `FINER` lead to cells that are finer by the same factor. A finer motion costs
    as much as the coarse motion that it is a part of. The result has three parts: the way, the number of poses from
    which the search continued, and the gap between the goal and the nearest pose. The gap consists of a cost, a
    distance and a turn.
    """
    fine, coarse = FINER ** np.arange(finest + 1.0), base.lattice()
    steps, costs = np.concatenate([coarse / scale for scale in fine]), np.tile(_costs(coarse), finest + 1)
    fine = np.repeat(fine, len(coarse))
    poses, reached, parents, taken = [start], [0.0], [-1], [-1]
    cheapest, closed = {0: 0.0}, set[int]()
    keys = [0]
    queue, iterations, batches = [(0.0, 0)], 0, 0
    while queue:
        batch: list[int] = []
        while queue and len(batch) < BATCH:
            node = heapq.heappop(queue)[1]
            if keys[node] not in closed and cheapest[keys[node]] >= reached[node]:
                batch.append(node)
                closed.add(keys[node])
        if not batch:
            break
        iterations += len(batch)
        a = np.array([poses[node] for node in batch])
        batches += 1
        shot = None
        if batches % SHOOTING == 1 or not queue:
            shot = _shot(base, grid, a, goal, np.array([reached[node] for node in batch]))
        if shot is not None:
            return _path(poses, parents, taken, steps, batch[shot[0]], shot[1]), iterations, (0.0, 0.0, 0.0)
        if iterations >= most or time.monotonic() > until:
            break
        count = len(steps)
        begins, ways = np.repeat(a, count, axis=0), np.tile(steps, (len(a), 1))
        ends = moved(begins, ways[:, 0], ways[:, 1])
        scale = np.tile(fine, len(a))
        i, j = np.floor((ends[:, :2] - base.lower[:2]).T * (scale / (EDGE * base.step))).astype(np.int64)
        turned = np.rint(ends[:, 2] * scale * (HEADINGS / (2.0 * math.pi))) % (HEADINGS * scale)
        end_keys = ((((i << 22) + j << 14) + turned.astype(np.int64) << 5) + scale.astype(np.int64)).tolist()
        wanted, gs = [], []
        for k, key in enumerate(end_keys):
            node, j = batch[k // count], k % count
            if key in closed:
                continue
            g = reached[node] + costs[j]
            if taken[node] >= 0 and steps[taken[node], 0] * steps[j, 0] < 0.0:
                g += CHANGE * base.step
            if g < cheapest.get(key, math.inf):
                wanted.append(k)
                gs.append(g)
        if not wanted:
            continue
        at = np.array(wanted)
        free = base.free(begins[at], ways[at, None]).tolist()
        estimates = grid.distance(ends[at]).tolist()
        for k, g, is_free, estimate in zip(wanted, gs, free, estimates, strict=True):
            if is_free and g < cheapest.get(end_keys[k], math.inf):
                cheapest[end_keys[k]] = g
                poses.append(ends[k])
                reached.append(g)
                parents.append(batch[k // count])
                taken.append(k % count)
                keys.append(end_keys[k])
                heapq.heappush(queue, (g + GREED * estimate, len(poses) - 1))
    offsets = np.array(poses) - goal
    gaps = np.hypot(offsets[:, 0], offsets[:, 1])
    turns = np.abs(np.remainder(offsets[:, 2] + math.pi, 2.0 * math.pi) - math.pi)
    sums = gaps + base.radius * turns
    k = int(sums.argmin())
    return None, iterations, (float(sums[k]), float(gaps[k]), float(turns[k]))


def _shot(base: Base, grid: Grid, a: Floats, goal: Floats, reached: Floats) -> tuple[int, Floats] | None:
    """Return the index of a pose and its cheapest proven way to the goal; None if no way is proven."""
    straight = np.sqrt(np.square(goal[:2] - a[:, :2]).sum(axis=1))
    at = np.flatnonzero(grid.distance(a) <= DETOUR * straight + 2.0 * base.radius)[:MOST_SHOOTING]
    if len(at) == 0:
        return None
    ways, costs = base.best(a[at], np.tile(goal, (len(at), 1)), SHOTS)
    which, way = np.nonzero(np.isfinite(costs))
    if len(which) == 0:
        return None
    free = base.free(a[at[which]], ways[which, way])
    total = np.where(free, reached[at[which]] + costs[which, way], np.inf)
    best = int(total.argmin())
    return (int(at[which[best]]), ways[which[best], way[best]]) if free[best] else None


def _path(poses: list[Floats], parents: list[int], taken: list[int], steps: Floats, node: int, shot: Floats) -> Path:
    """Return the way from the start to a node, and on to the goal."""
    ways = []
    while parents[node] >= 0:
        ways.append(steps[taken[node]])
        node = parents[node]
    return _along(poses[0], _needed(np.array([*ways[::-1], *shot])))


def _costs(ways: Floats) -> Floats:
    """Return the costs of motions, shape (..., 2): a length in metres or, for a turn in place, its angle in radians."""
    return np.where(ways[..., 0] == 0.0, np.abs(ways[..., 1]), np.abs(ways[..., 0]))


def _changes(ways: Floats) -> Floats:
    """Mark the motions, shape (..., k, 2), that reverse the direction of the last line or arc before them."""
    signs = np.sign(ways[..., 0])
    for k in range(1, signs.shape[-1]):
        signs[..., k] = np.where(signs[..., k] == 0.0, signs[..., k - 1], signs[..., k])
    changes = np.zeros(signs.shape)
    changes[..., 1:] = signs[..., 1:] * signs[..., :-1] < 0.0
    return changes


def _needed(ways: Floats) -> Floats:
    """Remove motions that are no larger than rounding errors."""
    return np.asarray(ways[np.abs(ways).max(axis=1) > NOTHING])


def _along(start: Floats, ways: Floats) -> Path:
    """Return the path that results from driving motions, shape (k, 2)."""
    return Path(driven(start, ways[:, 0], ways[:, 1]), ways)


@dataclass(frozen=True, eq=False)
class Grid:
    """Distances to the goal on a grid of positions.

    Attributes
    ----------
    corner, edge : ndarray, shape (2,)
    distances : ndarray, shape (p, q)
    """

    corner: Floats
    edge: Floats
    distances: Floats

    @classmethod
    def of(cls, base: Base, goal: Floats) -> Grid:
        """Compute distances over the eight neighbours of each cell; `BLOCKED` multiplies distances in blocked cells."""
        from scipy.sparse import csr_matrix  # not needed to plan for arms, nor to build the library
        from scipy.sparse.csgraph import dijkstra

        size = base.upper[:2] - base.lower[:2]
        edge = max(math.sqrt(float(size.prod()) / GRID), float(size.max()) / GRID, 1e-9)
        shape = np.maximum(np.ceil(size / edge), 1.0).astype(np.int64)
        edges = np.maximum(size / shape, 1e-9)
        i, j = np.divmod(np.arange(int(shape.prod())), shape[1])
        places = base.lower[:2] + (np.stack([i, j], axis=1) + 0.5) * edges
        blocked = np.ones(len(places), dtype=bool)
        for k in range(TRIED):
            at = np.flatnonzero(blocked)
            turned = np.full(len(at), k * math.pi / TRIED)
            blocked[at] = ~base.free_at(np.column_stack([places[at], turned]))
        weight = np.where(blocked, BLOCKED, 1.0).reshape(shape)
        numbers = np.arange(len(places)).reshape(shape)
        rows, columns, lengths = [], [], []
        for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
            one = slice(0, shape[0] - di), slice(max(0, -dj), shape[1] - max(0, dj))
            other = slice(di, shape[0]), slice(max(0, dj), shape[1] - max(0, -dj))
            rows.append(numbers[one].ravel())
            columns.append(numbers[other].ravel())
            way = math.hypot(di * edges[0], dj * edges[1])
            lengths.append((way * np.maximum(weight[one], weight[other])).ravel())
        data = np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))
        graph = csr_matrix(data, shape=(len(places), len(places)))
        grid = cls(base.lower[:2], edges, weight)
        first = int(np.ravel_multi_index(grid._cells(goal[None]), tuple(shape))[0])
        return replace(grid, distances=dijkstra(graph, directed=False, indices=first).reshape(shape))

    def _cells(self, poses: Floats) -> tuple[Ints, Ints]:
        cells = np.floor((poses[:, :2] - self.corner) / self.edge).astype(np.int64)
        i, j = np.clip(cells, 0, np.array(self.distances.shape) - 1).T
        return i, j

    def distance(self, poses: Floats) -> Floats:
        """Return the distances of poses to the goal."""
        return np.asarray(self.distances[self._cells(poses)])


# -- shortening ---------------------------------------------------------------------------------


def _shortened(base: Base, path: Path) -> Path:
    """Replace parts of a way with direct ways between its poses, until a pass hardly shortens the way."""
    for _ in range(PASSES):
        better, before, after = _pass(base, path)
        path = better if after < before else path
        if after > (1.0 - GAIN) * before:
            break
    return path


def _pass(base: Base, path: Path) -> tuple[Path, float, float]:
    """Combine the path's motions and proven ways between its poses as cheaply as possible. Also return both costs."""
    path = _cut(path)
    n, ways = len(path.poses), path.motions[:, None]
    plain = _costs(path.motions) + CHANGE * base.step * _changes(path.motions)
    along = np.append(0.0, plain.cumsum())
    i, j = np.triu_indices(n, 1)
    shortcuts, costs = (part[:, 0] for part in base.best(path.poses[i], path.poses[j], 1))
    at = np.flatnonzero(costs < along[j] - along[i])
    at = at[base.free(path.poses[i[at]], shortcuts[at])]
    cost, number = np.full((n, n), np.inf), np.full((n, n), -1)
    cost[np.arange(n - 1), np.arange(1, n)] = plain
    cost[i[at], j[at]], number[i[at], j[at]] = costs[at], at
    nodes = _cheapest(cost)
    parts = [ways[a] if number[a, b] < 0 else shortcuts[number[a, b]] for a, b in pairwise(nodes)]
    better = _along(path.poses[0], _needed(np.concatenate(parts)))
    return better, float(along[-1]), float(cost[nodes[:-1], nodes[1:]].sum())


def _cheapest(cost: Floats) -> list[int]:
    """Return the nodes of the cheapest way from the first node to the last one. Edges only lead to later nodes."""
    n = len(cost)
    least, before = np.full(n, np.inf), np.zeros(n, dtype=np.int64)
    least[0] = 0.0
    for j in range(1, n):
        sums = least[:j] + cost[:j, j]
        before[j] = sums.argmin()
        least[j] = sums[before[j]]
    nodes = [n - 1]
    while nodes[-1]:
        nodes.append(int(before[nodes[-1]]))
    return nodes[::-1]


def _cut(path: Path) -> Path:
    """Cut the motions of a path into equal parts, so that the path has about `PLACES` poses."""
    path = _merged(path)
    sizes = np.abs(path.motions).max(axis=1)
    counts = np.maximum(np.ceil(sizes / (sizes.sum() / PLACES)), 1.0).astype(np.int64)
    return _along(path.poses[0], np.repeat(path.motions / counts[:, None], counts, axis=0))


def _merged(path: Path) -> Path:
    """Join successive motions on one circle, on one line or in one place, if their turns sum to at most half a turn."""
    ways = [path.motions[0]]
    for way in path.motions[1:]:
        (length, turn), sums = ways[-1], ways[-1] + way
        same = abs(length * way[1] - turn * way[0]) <= 1e-12 * (abs(length) + abs(turn)) * (abs(way[0]) + abs(way[1]))
        ahead = length * way[0] >= 0.0 and turn * way[1] >= 0.0
        if same and ahead and abs(sums[1]) <= math.pi:
            ways[-1] = sums
        else:
            ways.append(way)
    return _along(path.poses[0], np.array(ways))


def _drive(robot: Robot, base: Base, path: Path, goal: Floats) -> Drive:
    """Make a drive that ends exactly at the goal, up to whole turns."""
    poses = path.poses.copy()
    turns = np.rint((poses[-1, 2] - goal[2]) / (2.0 * math.pi))
    poses[-1] = goal + [0.0, 0.0, 2.0 * math.pi * turns]
    return Drive._through(robot, base.still, poses, path.motions, base.columns)
