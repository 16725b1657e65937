"""Brakes: the shortest stop of each joint in its own time, and stops on a path of straight motions.

Each brake is written as states at the times at which a rate of a joint jumps: positions, and the velocities and
accelerations from then on. From one state to the next, accelerations change linearly, so a piece follows from its first
state and from the position at its end.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# Times closer together than NEAR times a brake's duration are merged, since rounding would affect a piece of this
# length.
NEAR = 1e-9

# Largest number of Newton or bisection steps in the search for the time at which a distance is covered.
STEPS = 64

# Allowed error, relative to the values, of the deviation between a brake and a single course for the whole brake.
WHOLE_ROUNDINGS = 128.0 * UNIT_ROUNDOFF  # certified.md, "Gates", derives 63 roundings


@inline
def stop_phases(v, a, strongest, jerk):
    """Compute the shortest change from a velocity and an acceleration to rest, within limits.

    Parameters
    ----------
    v, a : float
    strongest, jerk : float
        Largest acceleration, and its largest rate; infinite if it may jump.

    Returns
    -------
    sign, peak : float
        During the second phase, the acceleration is -sign * peak.
    ramp, flat, back : float
        Durations of the three phases: the acceleration changes towards the peak, stays, and returns to zero.
    """
    if jerk == np.inf:
        return np.sign(v), strongest, 0.0, (abs(v) / strongest if v != 0.0 else 0.0), 0.0
    rest = v + a * abs(a) / (2.0 * jerk)  # the velocity at which the acceleration merely returns to zero
    sign = np.sign(rest) if rest != 0.0 else np.sign(a)
    v, a = sign * v, sign * a
    strongest = max(strongest, -a)
    peak, flat = np.sqrt(max(jerk * v + a * a / 2.0, 0.0)), 0.0
    if peak > strongest:
        peak = strongest
        flat = max((v + a * a / (2.0 * jerk)) / peak - peak / jerk, 0.0)
    return sign, peak, max((a + peak) / jerk, 0.0), flat, peak / jerk


@inline
def _moved(q, v, a, jerk, t):
    """Position, velocity and acceleration after a time with constant jerk."""
    return q + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0), a + t * jerk


@inline
def _joint_at(q, v, a, strongest, jerk, t):
    """State of a braking joint: position, velocity and acceleration from then on."""
    sign, peak, ramp, flat, back = stop_phases(v, a, strongest, jerk)
    steep = 0.0 if jerk == np.inf else sign * jerk
    near = NEAR * (ramp + flat + back)
    if t < ramp - near:
        return _moved(q, v, a, -steep, t)
    if jerk != np.inf:
        q, v, a = _moved(q, v, a, -steep, ramp)
    a = -sign * peak
    if t < ramp + flat - near:
        return _moved(q, v, a, 0.0, t - ramp)
    if flat > 0.0:
        q, v, _ = _moved(q, v, a, 0.0, flat)
    if jerk != np.inf and t < ramp + flat + back - near:
        return _moved(q, v, a, steep, t - ramp - flat)
    if jerk != np.inf:
        q, v, _ = _moved(q, v, a, steep, back)
    return q, 0.0, 0.0


@inline
def _distinct(times, count):
    """Sort times, merge times that are near to each other with the last one, and return their number."""
    for k in range(1, count):
        t, m = times[k], k
        while m > 0 and times[m - 1] > t:
            times[m] = times[m - 1]
            m -= 1
        times[m] = t
    kept, near = 1, NEAR * times[count - 1]
    for k in range(1, count):
        # A joint that comes to rest at once gets its own piece, however short; on a longer piece, it would move.
        if times[k] - times[kept - 1] > near or (kept == 1 and times[k] > 0.0):
            kept += 1
        if kept > 1:
            times[kept - 1] = times[k]
    return kept


@njit()
def brakes_by_joint(Q, V, A, strongest, jerk, times, states, counts):
    """Write brakes in which each joint stops as soon as its limits allow, and then rests.

    Parameters
    ----------
    Q, V, A : ndarray, shape (n, dof)
        Positions, velocities and accelerations where each brake begins; accelerations count only for joints whose jerk
        is limited.
    strongest, jerk : ndarray, shape (dof,)
        Limits; infinite jerk: none.
    times : ndarray, shape (n, 3 dof + 1)
        Seconds since a brake began, which are written; the first is 0.
    states : ndarray, shape (n, 3 dof + 1, 3, dof)
        Positions, velocities and accelerations from these times on, which are written.
    counts : ndarray of int64, shape (n,)
        Number of times of each brake, which is written: its pieces and one.
    """
    for n in range(len(Q)):
        count = 1
        times[n, 0] = 0.0
        for c in range(Q.shape[1]):
            _, _, ramp, flat, back = stop_phases(V[n, c], A[n, c], strongest[c], jerk[c])
            for t in (ramp, ramp + flat, ramp + flat + back):
                times[n, count] = t
                count += 1
        count = _distinct(times[n], count)
        for k in range(count):
            for c in range(Q.shape[1]):
                state = _joint_at(Q[n, c], V[n, c], A[n, c], strongest[c], jerk[c], times[n, k])
                states[n, k, 0, c], states[n, k, 1, c], states[n, k, 2, c] = state
        counts[n] = count


@inline
def _limits_on(rows, at, k, strongest, jerk):
    """Limits of the second and third derivative of the path's time, on one straight motion."""
    gain, steep = np.inf, np.inf
    for c in range(rows.shape[1]):
        rate = abs(rows[k + 1, c] - rows[k, c]) / (at[k + 1] - at[k])
        if rate > 0.0:
            gain, steep = min(gain, strongest[c] / rate), min(steep, jerk[c] / rate)
    return gain, steep


@inline
def _time_to(way, v, a, jerk, T):
    """The time, up to T, at which a speed that does not rise has covered a distance."""
    low, high, t = 0.0, T, min(way / v, T)
    for _ in range(STEPS):
        off, speed, _ = _moved(-way, v, a, jerk, t)
        if off > 0.0:
            high = t
        else:
            low = t
        after = t - off / speed if speed > 0.0 else high
        if not (low < after < high):
            after = (low + high) / 2.0
        if after == t:
            break
        t = after
    return t


@inline
def _write_state(state, rows, at, k, s, v, a):
    """Write the state at a time of the path, with its rate and the rate's rate, from motion k on."""
    step = at[k + 1] - at[k]
    share = max((s - at[k]) / step, 0.0)
    if k + 2 < len(at):
        share = min(share, 1.0)
    for c in range(rows.shape[1]):
        way = rows[k + 1, c] - rows[k, c]
        state[0, c], state[1, c], state[2, c] = rows[k, c] + share * way, v * (way / step), a * (way / step)


@njit()
def _stop_motion_by_motion(rows, at, begin, first, strongest, beyond, times, states):
    """Write a brake without limits of jerk: on each motion, the rate falls as fast as the limits allow.

    Returns
    -------
    count : int
    needed : int
        As `brakes_on_path` writes them.
    """
    count, begun, s, v = 0, 0.0, begin, 1.0
    for k in range(first, len(at) - 1):
        gain, _ = _limits_on(rows, at, k, strongest, strongest)
        left, whole = at[k + 1] - s, v * v / (2.0 * gain)
        times[count] = begun
        _write_state(states[count], rows, at, k, s, v, -gain if gain < np.inf else 0.0)
        ends = whole <= left * (1.0 + NEAR)
        if ends or (beyond and k + 2 == len(at)):
            if begun + v / gain > begun:
                count, begun = count + 1, begun + v / gain
            times[count] = begun
            _write_state(states[count], rows, at, k, min(s + whole, at[k + 1]) if ends else s + whole, 0.0, 0.0)
            return count + 1, k + 1 if ends else len(at)
        after = np.sqrt(v * v - 2.0 * gain * left)
        T = 2.0 * left / (v + after)
        if begun + T > begun:
            count += 1
        begun, s, v = begun + T, at[k + 1], after
    return 0, len(at)


@njit()
def _stop_at_one_rate(rows, at, begin, first, strongest, jerk, beyond, times, states):
    """Write a brake with limits of jerk: the limits of all motions that it enters hold on all of them.

    Returns
    -------
    count : int
    needed : int
        As `brakes_on_path` writes them.
    """
    motions = len(at) - 1
    gain, steep = _limits_on(rows, at, first, strongest, jerk)
    last = first
    _, peak, ramp, flat, back = stop_phases(1.0, 0.0, gain, steep)
    total = ramp + flat + back
    while total / 2.0 > (at[last + 1] - begin) * (1.0 + NEAR) and last + 1 < motions:
        last += 1
        one, other = _limits_on(rows, at, last, strongest, jerk)
        gain, steep = min(gain, one), min(steep, other)
        _, peak, ramp, flat, back = stop_phases(1.0, 0.0, gain, steep)
        total = ramp + flat + back
    ends = total / 2.0 <= (at[last + 1] - begin) * (1.0 + NEAR)
    if not (ends or beyond):
        return 0, len(at)
    count, begun, k, s, v, a = 0, 0.0, first, begin, 1.0, 0.0
    near = NEAR * total
    for phase in range(3):
        T = ramp if phase == 0 else flat if phase == 1 else back
        if not near < T:
            continue
        a = 0.0 if phase == 0 else -peak
        push = -steep if phase == 0 else 0.0 if phase == 1 else steep
        end, gone = _moved(s, v, a, push, T), 0.0
        while True:
            here = _moved(s, v, a, push, gone)
            times[count] = begun + gone
            _write_state(states[count], rows, at, k, here[0], here[1], here[2])
            count += 1
            if k == last or end[0] <= at[k + 1]:
                break
            cut = _time_to(at[k + 1] - s, v, a, push, T)
            k += 1
            if cut - gone <= near:  # the part on the previous motion takes no time
                count -= 1
            if T - cut <= near:  # the next phase begins on the next motion
                break
            gone = cut
        s, v, begun = end[0], end[1], begun + T
    times[count] = begun
    _write_state(states[count], rows, at, k, min(begin + total / 2.0, at[k + 1]) if ends else s, 0.0, 0.0)
    return count + 1, last + 1 if ends else len(at)


@njit()
def brakes_on_path(rows, at, begins, strongest, jerk, beyond, times, states, counts, needed):
    """Write brakes on a path of straight motions, from each of some times on: the path's time runs slower, and stops.

    The time s of the path begins at the rate 1. Its second and third derivatives are limited by the joint that allows
    least on a motion, so that accelerations within each motion, and their rates, are within the limits of all joints.
    Velocities jump at rows, where the path has corners.

    Parameters
    ----------
    rows : ndarray, shape (k, dof)
    at : ndarray, shape (k,)
        When the robot is at each row without a brake; increasing.
    begins : ndarray, shape (n,)
        Times of the path when a brake begins; from the first of `at` to the last.
    strongest, jerk : ndarray, shape (dof,)
        As for `brakes_by_joint`; without limits of jerk, all are infinite.
    beyond : bool
        Whether brakes may go on along the last motion after the last row.
    times, states, counts : ndarray, shape (n, k + 4), (n, k + 4, 3, dof) and (n,)
        Written as by `brakes_by_joint`. The count is 0 if a brake does not end by the last row.
    needed : ndarray of int64, shape (n,)
        Index of the row by which each brake ends, k if there is none. Later rows change nothing.
    """
    limited = False
    for c in range(len(jerk)):
        limited = limited or jerk[c] < np.inf
    for n in range(len(counts)):
        begin, first = begins[n], min(max(np.searchsorted(at, begins[n], side="right") - 1, 0), len(at) - 2)
        if limited:
            counts[n], needed[n] = _stop_at_one_rate(
                rows, at, begin, first, strongest, jerk, beyond, times[n], states[n]
            )
        else:
            counts[n], needed[n] = _stop_motion_by_motion(
                rows, at, begin, first, strongest, beyond, times[n], states[n]
            )


@njit()
def courses_of_brakes(times, states, counts, courses, seconds):
    """Write the pieces of brakes as courses, one after another, and their durations.

    Parameters
    ----------
    times, states, counts : ndarray
        As `brakes_by_joint` writes them.
    courses : ndarray, shape (m, degree + 1, dof)
        Control points: of degree 2 if accelerations are constant on each piece, otherwise of degree 3.
    seconds : ndarray, shape (m,)

    Returns
    -------
    int
        The number of pieces.
    """
    made, degree = 0, courses.shape[1] - 1
    for n in range(len(counts)):
        for k in range(counts[n] - 1):
            T = times[n, k + 1] - times[n, k]
            for c in range(courses.shape[2]):
                q, v, a = states[n, k, 0, c], states[n, k, 1, c], states[n, k, 2, c]
                courses[made, 0, c] = q
                courses[made, 1, c] = q + v * (T / degree)
                if degree == 3:
                    courses[made, 2, c] = q + 2.0 * v * (T / 3.0) + a * (T * T / 6.0)
                courses[made, degree, c] = states[n, k + 1, 0, c]
            seconds[made] = T
            made += 1
    return made


@inline
def _between(p, q, x):
    return p + x * (q - p)


@inline
def _blossom(p, q, r, x, y):
    """The quadratic form of three control points at two fractions."""
    return _between(_between(p, q, x), _between(q, r, x), y)


@inline
def _part(course, first, last, c):
    """The control points of one value of a course between two fractions; the third one counts for a cubic only."""
    p, q, r = course[0, c], course[1, c], course[2, c]
    if len(course) == 3:
        ahead = _blossom(p, q, r, first, last)
        return _blossom(p, q, r, first, first), ahead, ahead, _blossom(p, q, r, last, last)
    s = course[3, c]
    early = _between(p, q, first), _between(q, r, first), _between(r, s, first)
    late = _between(p, q, last), _between(q, r, last), _between(r, s, last)
    return (
        _blossom(early[0], early[1], early[2], first, first), _blossom(early[0], early[1], early[2], first, last),
        _blossom(late[0], late[1], late[2], first, last), _blossom(late[0], late[1], late[2], last, last),
    )  # fmt: skip


@njit()
def whole_brakes(times, states, counts, until, courses, off):
    """Write one course for each brake, and by how much the brake deviates from it at the same fraction.

    Parameters
    ----------
    times, states, counts : ndarray
        As `brakes_by_joint` writes them.
    until : ndarray, shape (n,)
        Seconds since each brake began until which it rests, if they are more than it takes.
    courses : ndarray, shape (n, degree + 1, dof)
        Control points, which are written; of degrees as in `courses_of_brakes`.
    off : ndarray, shape (n, dof)
        Bounds on the deviation of each value, which are written.
    """
    degree = courses.shape[1] - 1
    for n in range(len(counts)):
        last, course = counts[n] - 1, courses[n]
        T = max(times[n, last], until[n])
        for c in range(courses.shape[2]):
            q, v, end = states[n, 0, 0, c], states[n, 0, 1, c], states[n, last, 0, c]
            ahead = min(max(q + v * (T / degree), min(q, end)), max(q, end))
            course[0, c], course[1, c], course[2, c], course[degree, c] = q, ahead, end, end
            low, high, most = np.inf, -np.inf, max(abs(q), abs(end))
            for k in range(last + 1):
                q, v, a = states[n, k, 0, c], states[n, k, 1, c], states[n, k, 2, c]
                stop = times[n, k + 1] if k < last else T
                t, after = stop - times[n, k], states[n, min(k + 1, last), 0, c]
                one = q + v * (t / degree)
                two = q + 2.0 * v * (t / 3.0) + a * (t * t / 6.0) if degree == 3 else one
                start, early, late, beyond = _part(course, times[n, k] / T, stop / T, c)
                low = min(low, q - start, one - early, two - late, after - beyond)
                high = max(high, q - start, one - early, two - late, after - beyond)
                most = max(most, abs(q), abs(one), abs(two), abs(after))
            for p in range(degree + 1):
                course[p, c] += (low + high) / 2.0
            off[n, c] = (high - low) / 2.0 + WHOLE_ROUNDINGS * most
