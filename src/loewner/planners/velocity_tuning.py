"""Follow a given path among moving bodies, within limits of velocity, acceleration and jerk.

First, the fastest trajectory along the path is computed. Next, the robot is slowed down and halted such that it hits no
moving body. The trajectory is divided by stations, which the robot passes at one of several shares of the highest
speed. Between stations, its acceleration is constant. A state consists of a station, a share and a time, and the states
are searched station by station. The search considers the bodies only at stations, so the resulting trajectory is then
proven as a whole. If the proof fails, the search is repeated with the place and time of the failure blocked. With
limited jerk, positions are averaged over a time window; the average keeps all limits. docs/design/moving.md gives the
reasons.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._guard import guarded
from loewner._base._validate import Bools, Floats, Ints
from loewner.errors import InputError, PlanningError
from loewner.planners.in_time import TimedJudge, horizon_of
from loewner.planners.jerk_limited import TO_ROUNDING, JerkLimited
from loewner.planners.joint_limits import JointLimits, limits_of
from loewner.planners.judge import Judge, checked_checker, refuse_unfree
from loewner.planners.straights import Straights
from loewner.planners.trajectories import Trajectory, blends_of, checked_blend, checked_rows, corners_of
from loewner.queries.pairs import Verdict
from loewner.robots import CertifiedTrajectory, CollisionChecker
from loewner.robots.checker import prepared_of, without_motions
from loewner.robots.checking import verdicts

# Number of stations along a trajectory, and the shares of its speed at stations. The squares of the shares are equally
# spaced, because under constant acceleration, the square of the speed changes linearly with distance.
STATIONS = 48
SHARES = np.sqrt(np.arange(13) / 12)

# Number of time bins in the duration of the fastest trajectory, and the largest number of bins at all stations
# together.
BINS, MOST_BINS = 64, 2**19

# The first horizon, in durations of the fastest trajectory.
FIRST = 3.0

# Number of trajectories that are proven before the search gives up.
ROUNDS = 64

# Accelerations may exceed their limits by the share ROUNDING, because of rounding.
ROUNDING = 1e-12

# Largest relative deviation of a given end velocity from the direction of the last motion.
ALONG = 1e-9

# With limited jerk, time windows that are longer than necessary are tried, in TRIED steps up to the share LONGER. A
# window is used if no phase of the result is so short that rounding affects the jerk.
LONGER, TRIED = 0.1, 50

# Number of configurations that are checked at a time.
MANY = 2**16


class _Stations(NamedTuple):
    """A trajectory that is divided into sections.

    Attributes
    ----------
    knots, rates : ndarray, shape (n + 1, dof)
        Positions and velocities at the stations.
    piece : ndarray of int64, shape (n,)
        The piece of the trajectory to which each section belongs.
    blended : ndarray of bool, shape (n,)
    seconds : ndarray, shape (n, shares, shares)
        Durations of sections that begin and end at given shares of the speed; inf if accelerations would be too large.
    """

    knots: Floats
    rates: Floats
    piece: Ints
    blended: Bools
    seconds: Floats

    @classmethod
    def of(cls, moved: Trajectory, strongest: Floats, dwell: float) -> _Stations:
        """Divide a trajectory into sections. The robot stays at each stop for `dwell` seconds."""
        whole = np.diff(moved.times)
        counts = np.ceil(whole / (moved.duration / STATIONS) * (1 - 1e-9)).astype(np.int64)
        piece = np.repeat(np.arange(len(whole)), counts)
        share = (np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[piece]
        at = np.append(moved.times[piece] + share * whole[piece], moved.times[-1])
        knots, rates, blended = moved.positions(at), moved.velocities(at), moved.blended[piece]
        steps = whole[piece] / counts[piece]
        if dwell:
            stops = np.searchsorted(at, moved.stops)
            knots, rates = (np.insert(rows, stops, rows[stops], axis=0) for rows in (knots, rates))
            piece, blended = np.insert(piece, stops, -1), np.insert(blended, stops, False)
            steps = np.insert(steps, stops, dwell)
        return cls(knots, rates, piece, blended, _seconds(steps, rates, blended, strongest))


def _seconds(steps: Floats, rates: Floats, blended: Bools, strongest: Floats) -> Floats:
    """Compute the durations of sections between shares of speeds; see `_Stations`."""
    # Along a straight motion, velocities are proportional to each other, so any norm may be used.
    first, last = np.abs(rates[:-1]).max(axis=1), np.abs(rates[1:]).max(axis=1)
    _validate.fits_memory(16 * len(SHARES) ** 2 * (rates.size + 2 * len(rates)), f"{len(rates)} stations")
    x, y = SHARES[:, None], SHARES
    a, b, T = (array[:, None, None] for array in (first, last, steps))
    with np.errstate(divide="ignore", invalid="ignore"):
        durations = np.where(blended[:, None, None], T / x, T * (a + b) / (x * a + y * b))
        change = np.abs(y[..., None] * rates[1:, None, None] - x[..., None] * rates[:-1, None, None])
        within = (change <= strongest * (durations * (1 + ROUNDING))[..., None]).all(axis=-1)
    resting = ~blended & (first == 0), ~blended & (last == 0)
    # At rest, only the share 0 is possible. In a section that begins or ends at rest, the share at the other end scales
    # the speed.
    before, after = (end[:, None, None] for end in resting)
    scaled = (x == y) | before | after
    good = np.where(blended[:, None, None], (x == y) & (x > 0), scaled | within)
    good &= ~((before & (x > 0)) | (after & (y > 0)))
    durations[~(good & np.isfinite(durations))] = np.inf
    durations[resting[0] & resting[1], 0, 0] = steps[resting[0] & resting[1]]
    return np.asarray(durations)


class _Visits(NamedTuple):
    """Successive states: indices of stations and of shares, and the times of arrival and departure [s]."""

    station: Ints
    share: Ints
    arrives: Floats
    departs: Floats


@guarded
def time_path(
    checker: CollisionChecker,
    path: ArrayLike,
    *,
    start_time: float,
    arrive_by: float | None = None,
    arrive_at: float | None = None,
    end_velocity: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    jerk: ArrayLike | None = None,
    limits: JointLimits | None = None,
    joint_error: ArrayLike = 0.0,
    blend: float = 0.4,
) -> Trajectory:
    """Assign times to a path, such that the robot stays within its limits and never hits a moving body.

    The robot slows down or waits while a moving body of the scene (`Scene.follow`) would be in the way.

    Parameters
    ----------
    checker : CollisionChecker
    path : array_like, shape (k, dof)
        Two or more configurations, for example from `plan` with a scene without the moving bodies. The motions of the
        path must be proven free when the moving bodies are ignored.
    start_time : float
        Time at which the robot is at rest at the first configuration [s], on the clock of the bodies' motions.
    arrive_by : float, optional
        The latest arrival [s]. The default, which is also the upper limit, is the end of all bodies' motions plus twice
        the duration of the path without moving bodies. A repeated motion counts as ended after two periods.
    arrive_at : float, optional
        The exact time of arrival [s]. Default: the earliest time that the search finds.
    end_velocity : array_like, shape (dof,), optional
        Velocities at the end [rad/s or m/s], in the direction of the path's last motion, for example to meet a part on
        a belt. Default: rest.
    velocity, acceleration, jerk, limits
        As for `trajectory`.
    joint_error : float or array_like, shape (dof,)
        Radians or metres by which each value may deviate from the trajectory at any time. The trajectory is proven for
        all such deviations.
    blend : float
        As for `trajectory`.

    Returns
    -------
    Trajectory
        The trajectory begins at its `start_time`, with a wait if necessary. Between its times, accelerations are
        constant or, if the jerk is limited, change linearly. `Trajectory.certify` with the same joint error also proves
        the trajectory FREE.

    Raises
    ------
    PlanningError
        If a motion of the path is not proven free even when the moving bodies are ignored. If the start collides at the
        start time, or the arrival time is too early. If no timing is found. The message names a pair of bodies, the
        place and the time.
    InputError
        As for `trajectory`. If the path has only one configuration. If the velocity at the end is not along the last
        motion, cannot be reached on the path, or is given together with jerk limits.

    See Also
    --------
    plan : Finds paths, and trajectories that also go around moving bodies.

    Notes
    -----
    `trajectory` assigns times to the path, and the speed is then tuned to the bodies' motions (Kant and Zucker,
    "path-velocity decomposition", IJRR 1986). The search has a finite resolution. It may fail although a timing exists,
    and the result may arrive later than necessary. If no body is in the way, the result is the trajectory that
    `trajectory` returns. Otherwise, with limited jerk, the robot follows the average of its positions over a time
    window, such as 0.2 s for limits of 10 rad/s² and 100 rad/s³. The average keeps the limits of velocity and
    acceleration. The averaged trajectory takes longer by the length of the window, and stays at each stop for this
    time.

    Examples
    --------
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("gate", Body.box([0.1, 3.0, 0.4]))
    >>> T = np.tile(np.eye(4), (2, 1, 1))
    >>> T[:, 0, 3], T[:, 1, 3] = 1.0, [0.0, 5.0]
    >>> scene.follow("gate", [1.0, 2.0], T)
    >>> robot = Robot.from_urdf("arm.urdf")
    >>> checker = CollisionChecker(robot, scene)
    >>> found = time_path(checker, [[0, 0], [2, 0]], start_time=0.0, velocity=1.0, acceleration=2.0)
    >>> found.certify(checker).verdict, round(found.duration, 2)  # without the gate, it takes 2.5 s
    (<Verdict.FREE: 0>, 3.16)
    """
    robot, still = checked_checker(checker).robot, without_motions(checker)
    rows, share = checked_rows(robot, path), checked_blend(blend)
    rows = rows[corners_of(rows)]
    if len(rows) < 2:
        raise InputError("path: expected two different configurations or more, found one")
    begin = _validate.real(start_time, "start_time")
    fastest, strongest, most = limits_of(robot, rows, limits, velocity, acceleration, jerk)
    judge = Judge.of(still, 0.0, joint_error)
    refuse_unfree(judge, rows, "path")
    window, smooth = 0.0, None
    if most is not None:
        limited = JerkLimited.of(rows, fastest, strongest, most)
        smooth = Trajectory(robot.configuration_names, *limited.timed(blends_of(limited, judge, share)))
        fastest, strongest = fastest * (1 - TO_ROUNDING), strongest * (1 - TO_ROUNDING)
        moves = np.isfinite(strongest)
        window = 2 * float((strongest[moves] / (most[moves] * (1 - TO_ROUNDING))).max()) * (1 + LONGER)
    motions = Straights.of(rows, fastest, strongest)
    last_speed = 0.0 if end_velocity is None else _last_speed(motions, end_velocity, window)
    timed = TimedJudge(robot, prepared_of(checker, timed=True), begin, np.inf, fastest, judge.errors)
    if smooth is not None:  # first try the fastest trajectory, without averages
        limit, exact = _times(begin, arrive_by, arrive_at, smooth.duration, np.inf)
        delayed = replace(_delayed(smooth, limit - smooth.duration if exact else 0.0), start_time=begin)
        if delayed.duration <= limit and delayed.certify(checker, joint_error=judge.errors).verdict == Verdict.FREE:
            return delayed._spaced(fastest, strongest, most)
    # Averages of blends may not be free. Without blends, the robot stays on the proven path.
    for size in [share] if most is None or share == 0 else [share, 0.0]:
        base = Trajectory(robot.configuration_names, *motions.timed(blends_of(motions, judge, size), last_speed))
        _expect_reached(base, last_speed * motions.full[-1])
        least = base.duration + window * (1 + len(base.stops))
        limit, exact = _times(begin, arrive_by, arrive_at, least, horizon_of(timed.ready, begin))
        stations = _Stations.of(base, strongest, window)
        ruled = ~verdicts.free(judge.ready, np.ascontiguousarray(stations.knots))
        search = _Search(checker, replace(timed, limit=limit), stations, base, window, most, least, ruled, [], [])
        trajectory = search.found(exact)
        if trajectory is not None:
            return trajectory._spaced(fastest, strongest, most)
    raise PlanningError(
        "path: expected one that is free without the moving bodies, with its blends and within the joint error, found "
        f"{search.blocking[-1]}"
    )


def _expect_reached(base: Trajectory, wanted: Floats) -> None:
    """Refuse a velocity at the end that is too high for the path."""
    reached, size = np.abs(base.rates[-1]).max(), np.abs(wanted).max()
    if reached < size * (1 - ALONG):
        raise InputError(
            f"end_velocity: expected one that is reached on the path, found one of which only {reached / size:.3g} is "
            "reached; make the last motion longer, or the velocity lower"
        )


def _times(
    begin: float, arrive_by: float | None, arrive_at: float | None, least: float, bodies: float
) -> tuple[float, bool]:
    """Check the times of arrival; return the latest arrival, counted from the start, and whether this time is exact."""
    if arrive_by is not None and arrive_at is not None:
        raise InputError("arrive_at: expected no arrive_by with it, found both")
    name, arrival = ("arrive_by", arrive_by) if arrive_at is None else ("arrive_at", arrive_at)
    if arrival is None:
        return bodies + 2 * least, False
    at = _validate.real(arrival, name)
    if not at - begin >= least:
        raise PlanningError(
            f"{name}: expected {begin + least:.6g} s or later, since the path takes {least:.6g} s within the limits; "
            f"found {at:g} s"
        )
    return (at - begin, True) if arrive_by is None else (min(at - begin, bodies + 2 * least), False)


def _last_speed(motions: Straights, given: ArrayLike, window: float) -> float:
    """Check a velocity at the end, and return it as a share of full speed along the last motion."""
    full = motions.full[-1]
    wanted = _validate.finite_array(given, "end_velocity", (len(full),))
    if window and wanted.any():
        raise InputError("end_velocity: expected no limit of jerk with it, found one; such ends are at rest")
    k = int(np.abs(full).argmax())
    share = float(wanted[k] / full[k])
    if share < 0 or np.abs(wanted - share * full).max() > ALONG * np.abs(full).max():
        raise InputError(
            f"end_velocity: expected a velocity along the last motion of the path, a multiple >= 0 of "
            f"{_validate.short(full.round(6).tolist())}, found {_validate.short(wanted.tolist())}"
        )
    if share > 1 + ALONG:
        raise InputError(f"end_velocity: expected one within the velocity limits, found {share:.6g} times as much")
    return min(share, 1.0)


class _Search(NamedTuple):
    """A search for times.

    Attributes
    ----------
    checker : CollisionChecker
    judge : TimedJudge
    stations : _Stations
    base : Trajectory
        The fastest trajectory, which the stations divide.
    window : float
        Seconds over which positions are averaged; 0 if the jerk is not limited.
    most : ndarray, shape (dof,), or None
        Limits of jerk.
    least : float
        The shortest duration.
    ruled : ndarray of bool, shape (stations,)
        Stations at which static bodies are in contacts that the scene allows. Only the proof considers these contacts.
    closed : list of (int, float, int)
        Sections and times that are not proven free, and the number of bins that are closed around each of them.
    blocking : list of str
        Descriptions of the closed sections, for messages.
    """

    checker: CollisionChecker
    judge: TimedJudge
    stations: _Stations
    base: Trajectory
    window: float
    most: Floats | None
    least: float
    ruled: Bools
    closed: list[tuple[int, float, int]]
    blocking: list[str]

    def found(self, exact: bool) -> Trajectory | None:
        """Return a proven trajectory that arrives by the limit or, if `exact`, exactly at the limit.

        Return None if the robot would meet a static body.
        """
        judge, start = self.judge, np.append(self.stations.knots[0], 0.0)
        if not (self.ruled[0] or judge.free_at(start[None])[0]):
            raise PlanningError(
                f"path: expected a start that is free at the start time {judge.begin:g} s, found a collision of "
                f"{judge.touching(start)}"
            )
        horizon, rounds = judge.limit if exact else min(FIRST * self.least, judge.limit), 0
        visits: _Visits | None = self._fastest(horizon - self.window if exact else 0.0)
        reason = ""
        while rounds < ROUNDS:
            if visits is not None:
                trajectory, rounds = self._made(visits), rounds + 1
                proof = trajectory.certify(self.checker, joint_error=judge.joint_error)
                if proof.verdict == Verdict.FREE:
                    return trajectory
                if not self._close(visits, proof, 1 + rounds // 4):
                    return None
            elif horizon == judge.limit:
                break
            else:
                horizon = min(2 * horizon, judge.limit)
            visits, reason = self._visits(horizon - self.window, exact)
        raise PlanningError(
            f"path: expected times between {judge.begin:g} s and {judge.begin + judge.limit:g} s at which the robot "
            f"can follow it, found none: {reason or self.blocking[-1]}. A later arrive_by, or another path, may help"
        )

    def _fastest(self, arrives: float) -> _Visits:
        """Return the visits at full speed, after a wait if the robot would arrive too early."""
        n = len(self.stations.seconds)
        share = np.where(self.stations.rates.any(axis=1), len(SHARES) - 1, 0)
        # Velocities are also zero in the middle of a blend that reverses, where the robot cannot rest.
        blended = ~np.isfinite(self.stations.seconds[np.arange(n), share[:-1], share[1:]])
        share[:-1][blended] = share[1:][blended] = len(SHARES) - 1
        at = np.append(0.0, np.cumsum(self.stations.seconds[np.arange(n), share[:-1], share[1:]]))
        departs = at + max(arrives - at[-1], 0.0)
        return _Visits(np.arange(n + 1), share, np.append(0.0, departs[1:]), departs)

    def _visits(self, horizon: float, exact: bool) -> tuple[_Visits | None, str]:
        """Search for times up to a horizon. If the search fails, describe the body in the way."""
        most = max(MOST_BINS // len(self.stations.knots), 2)
        count = int(np.clip(np.ceil(horizon / self.base.duration * BINS), 1, most))
        step = horizon / count
        free, seconds = self._free(count, step), self.stations.seconds
        resting = np.asarray(~self.stations.rates.any(axis=1))
        ends = 0, len(SHARES) - 1 if self.base.rates[-1].any() else 0
        if exact:  # backward from the end
            free, seconds = free[::-1, ::-1], seconds[::-1].transpose(0, 2, 1)
            ends, resting = ends[::-1], resting[::-1]
        visits, last, early = _searched(seconds, resting, free, step, *ends, exact)
        if visits is None:
            return None, self._blocked(free, last, early, step, exact)
        if exact:
            n = len(seconds)
            station, share, arrives, departs = visits
            visits = _Visits(n - station[::-1], share[::-1], horizon - departs[::-1], horizon - arrives[::-1])
            visits.arrives[0] = 0.0
        return visits, ""

    def _free(self, count: int, step: float) -> Bools:
        """Return when stations are free, shape (stations, count + 1). Sections in `closed` count as not free."""
        knots, at = self.stations.knots, step * np.arange(count + 1) + self.window / 2
        states = np.column_stack([np.repeat(knots, len(at), axis=0), np.tile(at, len(knots))])
        parts = [self.judge.free_at(states[k : k + MANY]) for k in range(0, len(states), MANY)]
        free = np.concatenate(parts).reshape(len(knots), len(at)) | self.ruled[:, None]
        for section, time, around in self.closed:
            bin = int(time / step)
            free[section : section + 2, max(bin + 1 - around, 0) : bin + 1 + around] = False
        return free

    def _blocked(self, free: Bools, last: int, early: float, step: float, exact: bool) -> str:
        """Describe where and when the search came to an end."""
        n = len(self.stations.seconds)
        station = n - 1 - last if exact else last + 1
        way = "backward from the end " if exact else ""
        share = self._fraction(station)
        for m in np.flatnonzero(~free[last + 1]):
            if m * step < early:
                continue
            at = (len(free[0]) - 1 - m if exact else m) * step + self.window / 2
            touching = self.judge.touching(np.append(self.stations.knots[station], at))
            if touching:
                return (
                    f"{way}the robot gets no further than to {share:.3g} of the path, where {touching} are in the way "
                    f"at {self.judge.begin + at:.6g} s"
                )
        return self.blocking[-1] if self.blocking else f"{way}no speeds lead past {share:.3g} of the path"

    def _fraction(self, station: int) -> float:
        ways = np.abs(np.diff(self.stations.knots, axis=0)).max(axis=1)
        return float(ways[:station].sum() / ways.sum())

    def _close(self, visits: _Visits, proof: CertifiedTrajectory, around: int) -> bool:
        """Close the unproven sections at their times; return whether each failed proof involves a moving body."""
        judge, segments, moving = self.judge, proof.segments, set(self.checker.scene.following)
        times = segments.fraction * np.diff(proof.times) + proof.times[:-1] - judge.begin - self.window / 2
        for k in np.flatnonzero(segments.verdict != Verdict.FREE):
            one, other = segments.names[k]
            passed = int(np.searchsorted(visits.arrives, times[k], side="right")) - 1
            section = int(visits.station[np.clip(passed, 0, len(self.stations.seconds) - 1)])
            self.closed.append((section, max(float(times[k]), 0.0), around))
            self.blocking.append(
                f"{one} and {other} come too near at {judge.begin + times[k] + self.window / 2:.6g} s, at "
                f"{self._fraction(section):.3g} of the path"
            )
            if not {one, other} & moving:
                return False
        return True

    def _made(self, visits: _Visits) -> Trajectory:
        """Make the trajectory, and average its positions if the jerk is limited."""
        names, begin = self.base.names, self.judge.begin
        trajectory = Trajectory(names, *_rows(self.stations, visits), start_time=begin)
        return trajectory if self.most is None else _averaged(trajectory, self.window, self.most)


def _searched(
    seconds: Floats, resting: Bools, free: Bools, step: float, first: int, last: int, exact: bool
) -> tuple[_Visits | None, int, float]:
    """Search for the earliest visits of all stations, station by station.

    Several ways may lead to a station with the same share and time bin. The way with the fewest changes of the share is
    kept.

    Parameters
    ----------
    seconds : ndarray, shape (n, shares, shares)
        See `_Stations`.
    resting : ndarray of bool, shape (n + 1,)
        Stations at which the robot is always at rest.
    free : ndarray of bool, shape (n + 1, bins + 1)
        Whether the robot may be at each station at each multiple of `step` [s].
    first, last : int
        Indices of the shares at the first and the last station.
    exact : bool
        End with a wait until the end of the last bin.

    Returns
    -------
    visits : _Visits or None
    reached : int
        The station before the first station that the search does not reach.
    early : float
        The earliest time at which the robot is at this station [s].
    """
    n, bins = len(seconds), free.shape[1] - 1
    states = (n + 1, len(SHARES), bins)
    met = np.concatenate([np.zeros((n + 1, 1), dtype=np.int64), np.cumsum(~free, axis=1)], axis=1)  # running sums
    best, changes = np.full(states, np.inf), np.full(states, MANY, dtype=np.int32)
    parents, waits = np.full(states, -1, dtype=np.int32), np.full((n + 1, bins), -1)
    if not free[0, :2].all():
        return None, -1, 0.0
    best[0, first, 0] = changes[0, first, 0] = 0
    for i in range(n):
        if i > 0 or first == 0:
            _wait(best[i, 0], changes[i, 0], waits[i], free[i], step)
        x, y = np.nonzero(np.isfinite(seconds[i]))
        changing = (x != y) & ~resting[i] & ~resting[i + 1]
        pair, bin = np.nonzero(np.isfinite(best[i, x]))
        at = best[i, x[pair], bin] + seconds[i, x[pair], y[pair]]
        to = np.floor(np.minimum(at / step, bins)).astype(np.int64)
        inside = np.flatnonzero(to < bins)
        pair, bin, at, to = pair[inside], bin[inside], at[inside], to[inside]
        middle = (bin + to) // 2
        hits = met[i, middle + 1] - met[i, bin] + met[i + 1, to + 2] - met[i + 1, middle]
        kept = np.flatnonzero(hits == 0)
        if len(kept) == 0:
            early = best[i][np.isfinite(best[i])]
            return None, i, float(early.min(initial=np.inf))
        change_counts = changes[i, x[pair], bin] + changing[pair]
        kept = kept[np.lexsort((at[kept], change_counts[kept]))[::-1]]  # the best of equal states is written last
        reached = y[pair[kept]], to[kept]
        best[i + 1][reached], changes[i + 1][reached] = at[kept], change_counts[kept]
        parents[i + 1][reached] = x[pair[kept]] * bins + bin[kept]
    if last == 0:
        _wait(best[n, 0], changes[n, 0], waits[n], free[n], step)
    arrived = np.isfinite(best[n, last])
    if exact:
        arrived[:-1] = False
    if not arrived.any():
        return None, n - 1, float(best[n - 1].min())
    return _traced(best, parents, waits, last, int(arrived.argmax()), step), n, np.inf


def _wait(best: Floats, changes: Ints, waits: Ints, free: Bools, step: float) -> None:
    """Let a robot at rest wait as long as its place is free, and write the bins of arrival to `waits`."""
    bins = np.arange(len(best))
    halts = np.cumsum(~(free[:-1] & free[1:]))
    # A halt is a bin at whose beginning or end the place is not free. Among the arrivals since the last halt that have
    # the fewest changes, the latest one is the best.
    keys = np.where(np.isfinite(best), changes.astype(np.int64) * 2 * MOST_BINS - bins, 2 * MANY * MOST_BINS)
    keys = np.minimum.accumulate(keys - halts * 4 * MANY * MOST_BINS) + halts * 4 * MANY * MOST_BINS
    fewest = -(-keys // (2 * MOST_BINS))
    waiting = (fewest < MANY) & (fewest + 1 < changes)
    waits[waiting] = (fewest * 2 * MOST_BINS - keys)[waiting]
    best[waiting], changes[waiting] = step * bins[waiting], fewest[waiting] + 1


def _traced(best: Floats, parents: Ints, waits: Ints, share: int, bin: int, step: float) -> _Visits:
    """List the visits that lead to a state of the last station."""
    visits = []
    for i in range(len(best) - 1, -1, -1):
        left = float(best[i, share, bin])
        came = int(waits[i, bin]) if share == 0 and waits[i, bin] >= 0 else bin
        visits.append((i, share, float(best[i, share, came]), left))
        share, bin = divmod(int(parents[i, share, came]), best.shape[2])
    station, shares, arrives, departs = (np.array(column) for column in zip(*visits[::-1], strict=True))
    return _Visits(station, shares, arrives, departs)


def _rows(stations: _Stations, visits: _Visits) -> tuple[Floats, Floats, Floats, Bools]:
    """Compute the arrays of a `Trajectory` from visits of all stations."""
    x, moving = SHARES[visits.share], np.asarray(stations.rates.any(axis=1))
    rates = x[:, None] * stations.rates
    rates[-1] = stations.rates[-1]
    # Successive sections of a piece are joined if the robot passes them at the same share of the piece's speed.
    first, last = np.where(moving[:-1], x[:-1], x[1:]), np.where(moving[1:], x[1:], x[:-1])
    waits = visits.departs > visits.arrives
    joined = (stations.piece[1:] == stations.piece[:-1]) & ~waits[1:-1] & (stations.piece[1:] >= 0)
    joined &= (first[1:] == last[1:]) & (first[:-1] == last[:-1]) & (first[1:] == first[:-1])
    kept = np.flatnonzero(~np.concatenate([[False], joined, [False]]))
    again = np.sort(np.concatenate([kept, kept[waits[kept]]]))
    twice = np.concatenate([[False], again[1:] == again[:-1]])
    times = np.where(twice, visits.departs[again], visits.arrives[again])
    blended = np.append(stations.blended, False)[again] & ~np.append(twice[1:], False)
    return times, stations.knots[again], rates[again], blended[:-1]


def _averaged(moved: Trajectory, longest: float, most: Floats) -> Trajectory:
    """Average positions over a window of time, so that accelerations change linearly.

    The start is delayed so that the result takes as long as with the longest window.
    """
    shortest = longest / (1 + LONGER)
    for window in np.linspace(shortest, longest, TRIED):
        trajectory = _averaged_over(moved, float(window), longest)
        T = np.diff(trajectory.times)[:, None]
        if T.min() <= 0:
            continue
        way, speed = np.diff(trajectory.knots, axis=0), trajectory.rates[1:] + trajectory.rates[:-1]
        if (np.abs(6 * speed / T**2 - 12 * way / T**3) <= most).all():
            return trajectory
    raise InputError(
        f"jerk: expected limits that leave no phases so short that rounding affects their jerk, found none in windows "
        f"of {shortest:.3g} s to {longest:.3g} s; give a lower or a higher one"
    )


def _averaged_over(moved: Trajectory, window: float, longest: float) -> Trajectory:
    """Average over one window. Accelerations are differences of velocities, and everything else is integrated."""
    ends = np.union1d(moved.times, moved.times + window)
    low, high = (np.clip(ends - shift, 0.0, moved.duration) for shift in (window, 0.0))
    bends = (moved.velocities(high) - moved.velocities(low)) / window
    bends[[0, -1]] = 0.0
    T = np.diff(ends)[:, None]
    rates = np.concatenate([moved.rates[:1], np.cumsum((bends[1:] + bends[:-1]) / 2 * T, axis=0)])
    steps = (rates[:-1] + (2 * bends[:-1] + bends[1:]) / 6 * T) * T
    knots = moved.knots[0] + np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    knots[-1], rates[-1] = moved.knots[-1], 0.0
    k = np.searchsorted(moved.times, low[:-1], side="right") - 1, np.searchsorted(moved.times, high[1:]) - 1
    cuts = np.concatenate([[0], np.cumsum(moved.blended)])
    blended = cuts[np.minimum(k[1] + 1, len(cuts) - 1)] > cuts[np.minimum(k[0], len(cuts) - 1)]
    trajectory = Trajectory(moved.names, ends, knots, rates, blended, bends, start_time=moved.start_time)
    return _delayed(trajectory, longest - window)


def _delayed(moved: Trajectory, wait: float) -> Trajectory:
    """Insert a wait [s] at the start of a trajectory with limited jerk."""
    if not wait > 0 or moved.bends is None:
        return moved
    knots, rates, bends = (np.concatenate([rows[:1], rows]) for rows in (moved.knots, moved.rates, moved.bends))
    times, blended = np.append(0.0, moved.times + wait), np.append(False, moved.blended)
    return replace(moved, times=times, knots=knots, rates=rates, blended=blended, bends=bends)
