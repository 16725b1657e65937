"""Poses of bodies that follow motions in time: positions change linearly, and orientations turn at a constant rate."""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.simd.trig import sine_of

SMALL_ARC = 1e-6  # Angle [rad] below which an arc is replaced by its chord.


@njit()
def pose_values(start, times, rows, arcs, periods, t, out):
    """Write the positions and quaternions of all bodies at given times.

    Parameters
    ----------
    start : ndarray of int64, shape (bodies + 1,)
        First row of each body, followed by the number of all rows.
    times, rows, arcs : ndarray, shape (n,), (n, 7) and (n,)
        Times [s], positions [m] with quaternions, and angles from each quaternion to the next [rad].
    periods : ndarray, shape (bodies,)
        Time [s] after which a motion repeats; 0 if it does not repeat.
    t : ndarray, shape (N,)
        Times in seconds.
    out : ndarray, shape (N, bodies, 7)
    """
    for body in range(len(periods)):
        first, last, period = start[body], start[body + 1] - 1, periods[body]
        for n in range(len(t)):
            at = t[n]
            if period > 0.0:
                at = times[first] + np.mod(at - times[first], period)
            low, high = first, last
            while high - low > 1:
                middle = (low + high) // 2
                if times[middle] <= at:
                    low = middle
                else:
                    high = middle
            share = min(max((at - times[low]) / (times[high] - times[low]), 0.0), 1.0)
            of_p, of_q = 1.0 - share, share
            for k in range(3):
                out[n, body, k] = of_p * rows[low, k] + of_q * rows[high, k]
            arc = arcs[low]
            if arc >= SMALL_ARC:
                of_p, of_q = sine_of(of_p * arc) / sine_of(arc), sine_of(of_q * arc) / sine_of(arc)
            squares = 0.0
            for k in range(3, 7):
                out[n, body, k] = of_p * rows[low, k] + of_q * rows[high, k]
                squares += out[n, body, k] * out[n, body, k]
            for k in range(3, 7):
                out[n, body, k] /= np.sqrt(squares)
