"""Brakes: the shortest stop of each joint in its own time, and stops on a path of straight motions.

A brake is a list of states, one for each time at which a velocity, an acceleration or its rate jumps. A state consists
of positions, velocities, and the accelerations from then on. Between two states, accelerations change linearly. A piece
is therefore determined by its first state and the position at its end.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# Largest difference, relative to a brake's duration, between times that are merged; rounding would distort the short
# piece between them.
NEAR = 1e-9

# Maximum number of Newton or bisection steps in the search for the time at which a distance has been covered.
STEPS = 64

# Allowed rounding error, relative to the values, of the computed deviation between a brake and a single course that
# represents the whole brake.
WHOLE_ROUNDINGS = 128.0 * UNIT_ROUNDOFF  # The section "Gates" of certified.md derives 63 roundings.


@inline
def stop_phases(v, a, strongest, jerk):
    """Compute the shortest change from a velocity and an acceleration to rest, within limits.

    Parameters
    ----------
    v, a : float
    strongest, jerk : float
        Largest acceleration, and its largest rate, which is infinite if accelerations may jump.

    Returns
    -------
    sign, peak : float
        During the second phase, the acceleration is -sign * peak.
    ramp, flat, back : float
        Durations of the three phases: the acceleration changes to its peak, stays there, and returns to zero.
    """
    if jerk == np.inf:
        return np.sign(v), strongest, 0.0, (abs(v) / strongest if v != 0.0 else 0.0), 0.0
    rest = v + a * abs(a) / (2.0 * jerk)  # Velocity after the acceleration has returned to zero as fast as possible.
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
    """Return position, velocity and acceleration after a time with constant jerk."""
    return q + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0), a + t * jerk


@inline
def _joint_at(q, v, a, strongest, jerk, t):
    """Return position and velocity of a braking joint at a time, and its acceleration from then on."""
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
    """Sort times, merge groups of near times into the last time of each group, and return the number of times left."""
    for k in range(1, count):
        t, m = times[k], k
        while m > 0 and times[m - 1] > t:
            times[m] = times[m - 1]
            m -= 1
        times[m] = t
    kept, near = 1, NEAR * times[count - 1]
    for k in range(1, count):
        # A joint that comes to rest almost immediately keeps its own piece, however short, because on a longer piece,
        # it would move farther.
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
        Positions, velocities and accelerations at the beginning of each brake. Accelerations count only for joints
        whose jerk is limited.
    strongest, jerk : ndarray, shape (dof,)
        Limits of the acceleration and its rate; an infinite rate means no limit.
    times : ndarray, shape (n, 3 dof + 1)
        Receives the seconds since a brake began; the first entry is 0.
    states : ndarray, shape (n, 3 dof + 1, 3, dof)
        Receives the positions and velocities at these times, and the accelerations from then on.
    counts : ndarray of int64, shape (n,)
        Receives the number of times of each brake, which is the number of its pieces plus one.
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
    """Limits on the second and third derivatives of the path's time on one straight motion."""
    gain, steep = np.inf, np.inf
    for c in range(rows.shape[1]):
        rate = abs(rows[k + 1, c] - rows[k, c]) / (at[k + 1] - at[k])
        if rate > 0.0:
            gain, steep = min(gain, strongest[c] / rate), min(steep, jerk[c] / rate)
    return gain, steep


@inline
def _time_to(way, v, a, jerk, T):
    """Time, at most T, after which a speed that does not rise has covered a distance."""
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
    """Write the state at time s of the path on motion k, given the rate v of the path's time and its derivative a."""
    step = at[k + 1] - at[k]
    share = max((s - at[k]) / step, 0.0)
    if k + 2 < len(at):
        share = min(share, 1.0)
    for c in range(rows.shape[1]):
        way = rows[k + 1, c] - rows[k, c]
        state[0, c], state[1, c], state[2, c] = rows[k, c] + share * way, v * (way / step), a * (way / step)


@njit()
def _stop_motion_by_motion(rows, at, begin, first, strongest, beyond, times, states):
    """Write a brake without jerk limits: on each motion, the path's time slows down as fast as the limits allow.

    Returns
    -------
    count : int
    needed : int
        The entries of `counts` and `needed`, see `brakes_on_path`.
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
    """Write a brake with jerk limits: the limits of every motion that it enters hold for the whole brake.

    Returns
    -------
    count : int
    needed : int
        The entries of `counts` and `needed`, see `brakes_on_path`.
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
            if cut - gone <= near:  # Drop the part on the previous motion, which takes almost no time.
                count -= 1
            if T - cut <= near:  # The next phase begins on the next motion.
                break
            gone = cut
        s, v, begun = end[0], end[1], begun + T
    times[count] = begun
    _write_state(states[count], rows, at, k, min(begin + total / 2.0, at[k + 1]) if ends else s, 0.0, 0.0)
    return count + 1, last + 1 if ends else len(at)


@njit()
def brakes_on_path(rows, at, begins, strongest, jerk, beyond, times, states, counts, needed):
    """Write brakes on a path of straight motions, one brake for each start: the path's time slows down and stops.

    The time s of the path begins at the rate 1. On each motion, the most restrictive joint limits the second and third
    derivatives of s. Accelerations within the motion, and their rates, are therefore within the limits of all joints.
    Velocities jump at rows, because the path has corners there.

    Parameters
    ----------
    rows : ndarray, shape (k, dof)
    at : ndarray, shape (k,)
        Times at which the robot passes each row without a brake; increasing.
    begins : ndarray, shape (n,)
        Times of the path at which a brake begins, between the first and the last entry of `at`.
    strongest, jerk : ndarray, shape (dof,)
        Documented in `brakes_by_joint`; without jerk limits, all entries of `jerk` are infinite.
    beyond : bool
        Whether a brake may continue beyond the last row, along the last motion.
    times, states, counts : ndarray, shape (n, k + 4), (n, k + 4, 3, dof) and (n,)
        Receive the arrays that `brakes_by_joint` writes. The count is 0 if a brake does not end by the last row.
    needed : ndarray of int64, shape (n,)
        Receives the index of the row by which each brake ends, or k if it does not end by the last row. Later rows do
        not affect the brake.
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
        The arrays that `brakes_by_joint` writes.
    courses : ndarray, shape (m, degree + 1, dof)
        Receives control points: of degree 2 if accelerations are constant on each piece, otherwise of degree 3.
    seconds : ndarray, shape (m,)

    Returns
    -------
    int
        Number of pieces.
    """
    piece_count, degree = 0, courses.shape[1] - 1
    for n in range(len(counts)):
        for k in range(counts[n] - 1):
            T = times[n, k + 1] - times[n, k]
            for c in range(courses.shape[2]):
                q, v, a = states[n, k, 0, c], states[n, k, 1, c], states[n, k, 2, c]
                courses[piece_count, 0, c] = q
                courses[piece_count, 1, c] = q + v * (T / degree)
                if degree == 3:
                    courses[piece_count, 2, c] = q + 2.0 * v * (T / 3.0) + a * (T * T / 6.0)
                courses[piece_count, degree, c] = states[n, k + 1, 0, c]
            seconds[piece_count] = T
            piece_count += 1
    return piece_count


@inline
def _between(p, q, x):
    return p + x * (q - p)


@inline
def _blossom(p, q, r, x, y):
    """Blossom of the curve with three control points: its symmetric form at two fractions."""
    return _between(_between(p, q, x), _between(q, r, x), y)


@inline
def _part(course, first, last, c):
    """Control points of one value of a course between two fractions; for quadratics, the third does not count."""
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
    """Write one course for each whole brake, and bounds on the brake's deviation from the course at the same fraction.

    Parameters
    ----------
    times, states, counts : ndarray
        The arrays that `brakes_by_joint` writes.
    until : ndarray, shape (n,)
        Times, in seconds since each brake began, until which the robot rests after the brake; a time before the end of
        the brake has no effect.
    courses : ndarray, shape (n, degree + 1, dof)
        Receives control points, with the degrees of `courses_of_brakes`.
    off : ndarray, shape (n, dof)
        Receives bounds on the deviation of each value.
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
