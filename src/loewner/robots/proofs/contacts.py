"""Prove motions that begin or end in contact, as the rules of `Scene.leave` and `Scene.reach` allow.

Two convex pieces that touch are separated, or nearly separated, by the plane perpendicular to their contact normal. If
this plane is moved back by the depth and by the tolerance, one piece lies in front of the plane. As long as that piece
stays in front, the overlap deepens by at most the tolerance. The space behind the plane is treated as a body, so the
proof of motions also settles whether the piece stays in front; see docs/certified.md, "Contact that has to end".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loewner._base._matrices import lengths
from loewner._base._validate import Floats, Ints
from loewner._kernels import codes, columns
from loewner.bodies import Bodies, Body, bodies_of, packed_of
from loewner.bodies.layout import starts
from loewner.bodies.pack import some
from loewner.queries import pairs as queries
from loewner.robots.checking.problem import Problem
from loewner.robots.description.robot import Robot
from loewner.robots.proofs import motions
from loewner.robots.proofs.courses import CURVE_ROUNDINGS, between, configurations
from loewner.robots.proofs.motions import STEPS, Found, Limit

# Lengths that are tried for the last part of a stretch, as shares of a course. The longest part on which the contact
# recedes is used.
STRETCHES = 2.0 ** -np.arange(16)

# At the end of a stretch, values deviate from a straight motion by less than the share OFF, since `motion_path` rounds
# by at most 7 times 2^-53. On a course of a higher degree, they deviate by less than the share `CURVE_ROUNDINGS`.
OFF = 32 * 2.0**-53

# Distances below the share LEAST_SHARE of the robot's reach have no reliable normal.
LEAST_SHARE = 1e-6

# Relative error allowed for the distance to a wall: ten times the error that `distance` guarantees.
FAR_ROUNDINGS = 1e-8

# Share of the tolerance that remains for the proof; the plane is moved back by the rest.
FOR_PROOF = 0.25

# Pieces that are apart by less than the share TOUCHING of the robot's reach count as touching: `distance` is accurate
# to a thousandth of this share. Pieces farther apart must keep their margin.
TOUCHING = 1e-9

# Two bodies have parted if their distance exceeds the sum of their margin and the tolerance by the share PARTED of the
# robot's reach.
PARTED = 1e-4

# Number of places on each course at which the distance is measured first, and maximum total number of places.
SAMPLES, MOST_SAMPLES = 8, 2**17


class Settled(NamedTuple):
    """Verdicts of one pair on the n segments of a curve.

    Attributes
    ----------
    verdicts : ndarray of int8, shape (n,)
        FREE; COLLIDING if the two bodies overlap more deeply than allowed, or touch again after they have parted;
        otherwise AMBIGUOUS.
    fractions : ndarray, shape (n,)
        Fractions of the segments; NaN if FREE.
    """

    verdicts: NDArray[np.int8]
    fractions: Floats


class Run(NamedTuple):
    """Consecutive courses that are parts of a curve's segments, possibly traversed backward.

    Attributes
    ----------
    number : ndarray of int64, shape (n,)
        The segment of each course.
    low, high : ndarray, shape (n,)
        The fractions of the segments at which the courses begin and end.
    courses : ndarray, shape (n, degree + 1, dof)
    off : ndarray, shape (n, dof)
        How far values may deviate from the courses.
    """

    number: Ints
    low: Floats
    high: Floats
    courses: Floats
    off: Floats

    @classmethod
    def whole(cls, courses: Floats, off: Floats) -> Run:
        """Take whole segments; the deviations also cover the rounding of control points when courses are cut."""
        roundings = OFF if courses.shape[1] == 2 else CURVE_ROUNDINGS
        off = off + roundings * np.maximum(np.abs(courses).max(axis=1), 1.0)
        return cls(np.arange(len(courses)), np.zeros(len(courses)), np.ones(len(courses)), courses, off)

    def place(self, k: int, fraction: float) -> tuple[int, float]:
        """Return the segment that contains a fraction of a course, and the corresponding fraction of the segment."""
        return int(self.number[k]), float(self.low[k] + fraction * (self.high[k] - self.low[k]))

    def backwards(self) -> Run:
        """Traverse the courses from the last to the first, each from its end to its start."""
        courses, off = map(np.ascontiguousarray, (self.courses[::-1, ::-1], self.off[::-1]))
        return Run(self.number[::-1], self.high[::-1], self.low[::-1], courses, off)

    def rows(self, first: int, last: int) -> Run:
        """Take the courses from `first` up to, but not including, `last`."""
        rows = slice(first, last)
        return Run(self.number[rows], self.low[rows], self.high[rows], self.courses[rows], self.off[rows])

    def cut(self, robot: Robot, at: tuple[int, float]) -> tuple[Run, Run]:
        """Divide the courses at a fraction of one course."""
        k, fraction = at
        if fraction in (0.0, 1.0):
            return self.rows(0, k + int(fraction)), self.rows(k + int(fraction), len(self.number))
        two, ends = np.repeat(self.courses[k : k + 1], 2, axis=0), np.array([0.0, fraction, 1.0])
        first, second = np.split(between(robot, two, ends[:-1], ends[1:]), 2)
        _, middle = self.place(k, fraction)
        before, after = self.rows(0, k + 1), self.rows(k, len(self.number))
        earlier, later = np.concatenate([before.courses[:-1], first]), np.concatenate([second, after.courses[1:]])
        return (
            before._replace(high=np.append(before.high[:-1], middle), courses=earlier),
            after._replace(low=np.append(middle, after.low[1:]), courses=later),
        )


class Stage(NamedTuple):
    """A part of a curve, with the proof that a pair needs there.

    Attributes
    ----------
    problem : Problem
        The pair or, on a stretch of contact, its pieces and the planes behind which the pieces must not go.
    run : Run
    tolerance : float
        The proof may fail if the pair comes within this distance [m] of an allowed contact or of its margin.
    least : float or None
        On a stretch of contact, the signed distance at which the pair collides; None elsewhere.
    """

    problem: Problem
    run: Run
    tolerance: float
    least: float | None = None


@dataclass
class Work:
    """Limit on the steps of proofs (None for no limit), and the number of steps that they took."""

    most: int | None
    taken: int = 0


def settle(ready: Problem, pair: int, courses: Floats, off: Floats, tolerance: float, work: Work) -> Settled:
    """Settle a curve for one pair that may be in contact at the curve's start or end.

    Parameters
    ----------
    ready : Problem
    pair : int
        Index of the pair, for which `ready.leaving` or `ready.reaching` is true.
    courses : ndarray, shape (n, degree + 1, dof)
        The segments of the curve; a straight motion has one segment.
    off : ndarray, shape (n, dof)
        How far values may deviate from the courses.
    tolerance : float
        Distance in metres by which the contact may become deeper.
    work : Work
        Counts the steps.
    """
    verdicts, fractions = np.full(len(courses), codes.FREE, dtype=np.int8), np.full(len(courses), np.nan)
    for run, _, deepest in _runs(ready, pair, courses, off, tolerance):
        left = _leave(ready, pair, run, tolerance, deepest, work)
        if not left.doubts:
            continue
        numbers, places = map(np.array, zip(*(run.place(k, f) for k, f, _ in left.doubts), strict=True))
        distances = distances_at(ready, pair, configurations(ready.robot, courses[numbers], places))
        hit = distances <= [least for _, _, least in left.doubts]
        for k in np.unique(numbers):
            own = np.flatnonzero(numbers == k)
            worst = own[distances[own].argmin()]
            if verdicts[k] != codes.COLLIDING:
                verdicts[k] = codes.COLLIDING if hit[worst] else codes.AMBIGUOUS
                fractions[k] = places[worst]
    return Settled(verdicts, fractions)


def stages(ready: Problem, pair: int, courses: Floats, off: Floats, tolerance: float) -> list[Stage]:
    """Divide a curve, in order, into parts on which a pair may be in contact and parts on which it may not.

    See `settle` for the parameters. A contact at the end that is deeper than its rule allows does not count as an
    allowed contact.
    """
    parts, alone = [], ready.only(np.array([pair]))
    for run, leaving, deepest in _runs(ready, pair, courses, off, tolerance):
        left = _leave(ready, pair, run, tolerance, deepest, Work(None))
        if left.beside is None or (left.doubts and not leaving):
            parts.append(Stage(alone, run if leaving else run.backwards(), tolerance))
            continue
        stretch, rest = run.cut(ready.robot, left.until)
        if leaving:
            parts.append(Stage(left.beside, stretch, left.for_proof, left.least))
        parts.append(Stage(alone, rest if leaving else rest.backwards(), tolerance))
    return [stage for stage in parts if len(stage.run.number)]


def deeper_than_ends(ready: Problem, path: Floats, motions: Ints, tolerance: float) -> tuple[int, str, str] | None:
    """Find the first row at which a pair is in deeper contact than its rules allow, and the names of the pair.

    A contact may become deeper by the tolerance on each motion, but by no more than the tolerance along the whole path.
    Rows at the ends of the given motions are examined, except for the first and the last row of the path.
    """
    rows = np.setdiff1d(np.append(motions, motions + 1), [0, len(path) - 1])
    for pair in ready.ruled.tolist():
        allowed = float(ready.margins[pair])
        if ready.leaving[pair]:
            allowed = min(allowed, distance_at(ready, pair, path[0]))
        if ready.reaching[pair]:
            allowed = min(allowed, distance_at(ready, pair, path[-1]))
        for row in rows.tolist():
            if distance_at(ready, pair, path[row]) < allowed - tolerance:
                one, other = (ready.names[k] for k in ready.pairs[pair])
                return row, one, other
    return None


def farthest(ready: Problem, pair: int, run: Run) -> tuple[int, float]:
    """Find a course, and a fraction of it, at which a pair has the largest of the measured distances."""
    at, distances, _ = _samples(ready, pair, run)
    return _on_course(at[distances.argmax()])


class _Left(NamedTuple):
    """How a pair leaves the contact at the start of a run.

    Attributes
    ----------
    doubts : list of (int, float, float)
        Courses and fractions at which the run may not be free, each with a critical distance. If the signed distance at
        a fraction is at most the critical distance, the pair collides.
    until : tuple of (int, float)
        The course and the fraction at which the stretch of contact ends.
    beside : Problem or None
        The pieces, and the planes behind which the pieces must not go on the stretch; None without a stretch.
    for_proof : float
        The tolerance for the proof that the pieces stay in front of the planes.
    least : float
        The critical distance on the stretch.
    """

    doubts: list[tuple[int, float, float]]
    until: tuple[int, float] = (0, 0.0)
    beside: Problem | None = None
    for_proof: float = 0.0
    least: float = 0.0


def _runs(ready: Problem, pair: int, courses: Floats, off: Floats, tolerance: float) -> list[tuple[Run, bool, float]]:
    """For each end with allowed contact, return the run from it, whether it is the start, and the depth allowed.

    A contact at the start may have any depth, since a motion cannot change it. A contact at the end may be no deeper
    than the tolerance.
    """
    whole = Run.whole(courses, off)
    if not ready.reaching[pair]:
        return [(whole, True, np.inf)]
    if not ready.leaving[pair]:
        return [(whole.backwards(), False, tolerance)]
    # Cut between the two contacts, where the pair is apart; the proof is sound for any cut.
    before, after = whole.cut(ready.robot, farthest(ready, pair, whole))
    runs = [(before, True, np.inf), (after.backwards(), False, tolerance)]
    return [run for run in runs if len(run[0].number)]  # a run is empty if the cut is at an end


def _leave(ready: Problem, pair: int, run: Run, tolerance: float, deepest: float, work: Work) -> _Left:
    """Prove that a pair that may be in contact at the start of a run leaves the contact."""
    alone = ready.only(np.array([pair]))
    margin, at_start = float(ready.margins[pair]), distance_at(ready, pair, run.courses[0, 0])
    answers = _settled(alone, run.courses, FOR_PROOF * tolerance, run.off, work)
    unproven = np.flatnonzero(answers.verdicts != codes.FREE).tolist()
    apart = [(k, float(answers.fractions[k]), margin) for k in unproven]
    if not unproven or at_start > margin + tolerance:  # there is no contact to leave
        return _Left(apart)
    if at_start < -deepest:
        return _Left([(0, 0.0, -deepest)])
    reach = _reach(ready, pair, run)
    least = at_start - tolerance if at_start <= margin + TOUCHING * reach else margin
    end, most = _end_of_contact(ready, pair, run.rows(0, unproven[-1] + 1), margin + tolerance, PARTED * reach)
    beside, for_proof = _beside_planes(ready, pair, run, end + most, tolerance)
    before = _settled(beside, run.courses[:end], for_proof, run.off[:end], work)
    doubts = [(k, float(before.fractions[k]), least) for k in np.flatnonzero(before.verdicts != codes.FREE).tolist()]
    after, last, within = [doubt for doubt in apart if doubt[0] > end], run.rows(end, end + 1), []
    for share in (most * STRETCHES).tolist():
        first, rest = last.cut(ready.robot, (0, share))
        proven = _settled(beside, first.courses, for_proof, first.off, work)
        if proven.verdicts[0] == codes.FREE:
            break
        within.append((end, share * float(proven.fractions[0]), least))
    else:
        return _Left([*doubts, *within, *after], (end, most), beside, for_proof, least)
    if len(rest.number):
        proven = _settled(alone, rest.courses, FOR_PROOF * tolerance, rest.off, work)
    if proven.verdicts[0] == codes.FREE:
        return _Left([*doubts, *after], (end, share), beside, for_proof, least)
    within.append((end, share + (1.0 - share) * float(proven.fractions[0]), least if most == 1.0 else margin))
    return _Left([*doubts, *within, *after], (end, most), beside, for_proof, least)


def _settled(problem: Problem, courses: Floats, tolerance: float, off: Floats, work: Work) -> Found:
    """Let the kernel settle motions; a motion that is too long to be settled is doubtful from its start."""
    limit = None if work.most is None else Limit(work.most - work.taken, np.array([0, len(courses)]))
    answers = motions.settle(problem, courses, tolerance, off, limit=limit)
    work.taken += int(answers.work[:, STEPS].sum())
    return answers._replace(fractions=np.nan_to_num(answers.fractions))


def _end_of_contact(ready: Problem, pair: int, run: Run, near: float, parted: float) -> tuple[int, float]:
    """Return the course and fraction where a pair has first parted, or the run's end if it never comes near again.

    The distance is measured at places between which the pair moves too little to part and come near again.

    Parameters
    ----------
    ready : Problem
    pair : int
    run : Run
    near : float
        Largest distance in metres at which the pair counts as near.
    parted : float
        Distance in metres beyond `near` at which the pair counts as parted.
    """
    *center, radius, _ = ready.balls[ready.pairs[pair, 0]].tolist()
    at, distances, poses = _samples(ready, pair, run)
    while True:
        away = np.flatnonzero(distances > near + parted)[:1]
        again = away if not len(away) else away[0] + np.flatnonzero(distances[away[0] :] <= near)[:1]
        if len(again):
            return _on_course(at[away[0]])
        change = np.diff(poses, axis=0)
        turned = np.linalg.norm(change[..., :3], axis=(1, 2))
        moved = lengths(change[..., :3] @ center + change[..., 3]) + radius * turned
        # Between two places, the pair can part and come near again only if it moves farther than `needed`.
        far = near + parted
        low, high = np.minimum(distances[:-1], distances[1:]), np.maximum(distances[:-1], distances[1:])
        needed = high - low + 2.0 * np.where(high <= far, far - high, np.where(low >= far, low - near, parted))
        wide = np.flatnonzero(moved > needed)
        if len(wide) == 0:
            return _on_course(at[-1])
        if len(at) + len(wide) > MOST_SAMPLES:
            return 0, 1.0 / SAMPLES  # contact is allowed only as far as it was measured
        middle = _samples(ready, pair, run, (at[wide] + at[wide + 1]) / 2.0)
        at, distances, poses = (
            np.insert(old, wide + 1, new, axis=0) for old, new in zip((at, distances, poses), middle, strict=True)
        )


def _on_course(at: float) -> tuple[int, float]:
    """Return the course and the fraction of a place; a place between two courses is the end of the first one."""
    k = max(int(np.ceil(at)) - 1, 0)
    return k, float(at - k)


def _samples(ready: Problem, pair: int, run: Run, at: Floats | None = None) -> tuple[Floats, Floats, Floats]:
    """Return places on a run, a pair's distances there, and the poses of its first body in the second body's frame.

    A place is the index of a course plus a fraction; by default, places are spread evenly. Poses have the shape (N, 3,
    4).
    """
    i, j = (int(k) for k in ready.pairs[pair])
    if at is None:
        each = SAMPLES if SAMPLES * len(run.number) < MOST_SAMPLES else 1
        at = np.arange(each * len(run.number) + 1) / each
    k = np.minimum(at.astype(np.int64), len(run.number) - 1)
    distances, places = np.empty(len(at)), np.empty((len(at), 3, 4))
    for first, T in ready.poses_in_turn(configurations(ready.robot, run.courses[k], at - k)):
        now = slice(first, first + len(T))
        distances[now] = queries.distance(ready.body(i), T[:, i], ready.body(j), T[:, j], exact=True).distance
        away = T[:, i, :3] - np.pad(T[:, j, :3, 3:], ((0, 0), (0, 0), (3, 0)))
        places[now] = T[:, j, :3, :3].transpose(0, 2, 1) @ away
    return at, distances, places


def distances_at(ready: Problem, pair: int, Q: Floats) -> Floats:
    """Compute the signed distances of a pair of bodies at configurations, shape (N, dof)."""
    i, j = (int(k) for k in ready.pairs[pair])
    T = ready.poses(Q)
    return np.asarray(queries.distance(ready.body(i), T[:, i], ready.body(j), T[:, j], exact=True).distance)


def distance_at(ready: Problem, pair: int, q: Floats) -> float:
    """Compute the signed distance of a pair of bodies at a configuration."""
    return float(distances_at(ready, pair, q[None])[0])


def _reach(ready: Problem, pair: int, run: Run) -> float:
    """Bound how far points of the robot get from the second body of a pair during a run."""
    T, tree = ready.poses(run.courses[:1, 0])[0, ready.pairs[pair, 1]], ready.robot.tree
    values, moved = np.abs(run.courses).max(axis=(0, 1)), tree.kind != columns.FIXED
    # Several joints may follow one value, each by a multiple of the value.
    times = np.bincount(tree.column[moved], np.abs(tree.multiplier[moved]), len(values))
    far = (values * np.maximum(times, 1.0)).sum() + np.abs(tree.offset[moved]).sum()
    return float(ready.tables.chain[1] + far + np.abs(T[:3, 3]).sum())


class _Touched(NamedTuple):
    """The pieces of two bodies, the pairs of pieces that are apart or touch at a configuration, and contact normals.

    Attributes
    ----------
    ours, theirs : Bodies
        A body for each piece of the first body and of the second body.
    apart, planes : ndarray of int64, shape (pairs, 2)
        Pairs of pieces that are apart, and pairs that touch.
    distances : ndarray
        Signed distances of the pairs that touch.
    normals : ndarray, shape (planes, 3)
        Unit vectors in the frame of the second body, which point to the first body.
    """

    ours: Bodies
    theirs: Bodies
    apart: Ints
    planes: Ints
    distances: Floats
    normals: Floats


def contact_normals(ready: Problem, pair: int, Q: Floats, tolerance: float) -> Floats:
    """Find contact normals of the pieces that touch at `Q[0]`; the other rows of `Q` come later in the motion.

    Returns
    -------
    ndarray, shape (planes, 3)
        Unit vectors in the frame of the second body, which point to the first body.
    """
    run = Run.whole(np.stack([Q[0], Q[-1]])[None], np.zeros((1, Q.shape[1])))
    return _touched(ready, pair, ready.poses(Q), _reach(ready, pair, run), tolerance).normals


def _touched(ready: Problem, pair: int, T: Floats, reach: float, tolerance: float) -> _Touched:
    """Find the pieces that touch at the first of the bodies' given poses, and their normals at this or a later pose."""
    i, j = (int(k) for k in ready.pairs[pair])
    ours, theirs = _pieces(ready, i), _pieces(ready, j)
    every = np.moveaxis(np.indices((len(ours), len(theirs))), 0, -1).reshape(-1, 2)
    at_start = queries.distance(ours, T[0, i], theirs, T[0, j], exact=True, pairs=every).distance
    touching = at_start <= float(ready.margins[pair]) + tolerance
    apart, planes = every[~touching], every[touching]
    # The normal of two pieces that just touch cannot be computed. It can be computed slightly later on the motion, or
    # with the pieces slightly apart. Any normal is safe, since the proof fails with a bad normal.
    u, v = planes.T
    gaps = queries.distance(ours[u], T[:, None, i], theirs[v], T[:, None, j], exact=True)
    when, nth = (np.abs(gaps.distance) > LEAST_SHARE * reach).argmax(axis=0), np.arange(len(planes))
    moved = np.tile(T[0, i], (len(planes), 1, 1))
    moved[:, :3, 3] -= LEAST_SHARE * reach * gaps.normal[0]
    apart_by_little = queries.distance(ours[u], moved, theirs[v], T[0, j], exact=True).normal
    # Convert normals to the frame of the second body, which carries the planes.
    R = T[when, j, :3, :3]
    normals = -np.einsum("kri,kr->ki", R, np.where((when > 0)[:, None], gaps.normal[when, nth], apart_by_little))
    return _Touched(ours, theirs, apart, planes, at_start[touching], normals)


def _beside_planes(ready: Problem, pair: int, run: Run, end: float, tolerance: float) -> tuple[Problem, float]:
    """Replace touched pieces of the second body with planes, each paired with the piece that begins in front of it.

    Also return the tolerance for the proof that the pieces stay in front. The plane of touching pieces is moved back by
    most of the tolerance; the plane of separate pieces is moved back until only their margin is left. Normals are
    sought from the start of the run up to `end`, the index of a course plus a fraction.
    """
    i, j = (int(k) for k in ready.pairs[pair])
    places = np.append(0.0, end * STRETCHES[::-1])
    k = np.minimum(places.astype(np.int64), len(run.number) - 1)
    margin, T = float(ready.margins[pair]), ready.poses(configurations(ready.robot, run.courses[k], places - k))
    reach = _reach(ready, pair, run)
    ours, theirs, apart, planes, distances, normals = _touched(ready, pair, T, reach, tolerance)
    # Compute how far the second body's piece reaches along each normal, from its distance to a wall beyond it.
    far = 2 * float(packed_of(theirs).kernel.table[:, columns.REACH].max())
    walls = Bodies([Body.half_space(-n, -far, extent=8 * far) for n in normals])
    reached = far * (1 + FAR_ROUNDINGS) - queries.distance(theirs[planes[:, 1]], None, walls, None, exact=True).distance
    gap = distances - margin
    back = np.where(gap > TOUCHING * reach, gap, (1 - FOR_PROOF) * tolerance)
    offsets = reached + distances - back
    # The space behind a plane is represented by a cube that reaches farther than the robot.
    behind = [Body.half_space(n, offset, extent=8 * reach) for n, offset in zip(normals, offsets, strict=True)]
    bodies = [*(ours[k] for k in range(len(ours))), *(theirs[k] for k in range(len(theirs))), *behind]
    first = len(ours)
    second = np.concatenate([first + apart[:, 1], first + len(theirs) + np.arange(len(planes))])
    pairs = np.column_stack([np.concatenate([apart[:, 0], planes[:, 0]]), second]).astype(np.int64)
    count = len(bodies) - first
    moves = j < len(ready.link)
    link = np.concatenate([np.full(first, ready.link[i]), np.full(count * moves, ready.link[j if moves else i])])
    problem = Problem.of(
        ready.robot, (ready.version, ready.structure_version), tuple(map(str, range(len(bodies)))),
        [packed_of(body) for body in bodies], link.astype(np.int64), pairs,
        np.where(np.arange(len(pairs)) < len(apart), margin, 0.0),
    )  # fmt: skip
    for_proof = float(back.min(initial=tolerance)) * FOR_PROOF / (1 - FOR_PROOF)
    return problem.with_poses(np.tile(T[0, j], (0 if moves else count, 1, 1)), ready.version), for_proof


def _pieces(ready: Problem, body: int) -> Bodies:
    """Make one body from each piece of a body."""
    packed = ready.packed
    at: Ints = np.arange(packed.piece_start[body], packed.piece_start[body + 1])
    return bodies_of(some(packed, at, starts(np.ones(len(at), dtype=np.int64))).packed())
