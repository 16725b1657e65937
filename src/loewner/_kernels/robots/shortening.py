"""Shorten paths: skip corners, then cut between random points, wherever the straight motion is free.

Geraerts, Overmars: Creating high-quality paths for motion planning. Int. Journal of Robotics Research 26, 2007.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import ITERATION, MOTIONS, POSES
from loewner._kernels.pieces.pack import problem_of
from loewner._kernels.robots.free_motions import is_free, judge_of, random, sample_memory, turns_clearly
from loewner._kernels.robots.motion_path import configuration_at
from loewner._kernels.simd.memory import held


@inline
def motion_is_free(judge, ends, a, b, state):
    """Return whether the motion between two configurations is free."""
    for c in range(len(a)):
        ends[0, c], ends[1, c] = a[c], b[c]
    state[MOTIONS] += 1
    return is_free(judge, ends, state[POSES:])


@inline
def _move(path, first, count, by):
    """Move the rows first .. count of a path by a number of rows."""
    if by < 0:
        for k in range(first, count):
            for c in range(path.shape[1]):
                path[k + by, c] = path[k, c]
    else:
        for k in range(count - 1, first - 1, -1):
            for c in range(path.shape[1]):
                path[k + by, c] = path[k, c]


@njit()
def skip_corners(judge, path, count, ends, state):
    """Skip rows between two rows joined by a free motion; try the farthest rows first, then rows half as far away."""
    k = 0
    while k < count - 2:
        ahead = count - 1 - k
        while ahead >= 2:
            if motion_is_free(judge, ends, path[k], path[k + ahead], state):
                _move(path, k + ahead, count, 1 - ahead)
                count -= ahead - 1
                break
            ahead = ahead - 1 if ahead <= 4 else ahead // 2
        k += 1
    return count


@inline
def _length(path, k):
    """Length of the motion after row k."""
    squares = 0.0
    for c in range(path.shape[1]):
        squares += (path[k + 1, c] - path[k, c]) * (path[k + 1, c] - path[k, c])
    return np.sqrt(squares)


@inline
def _at(path, count, way):
    """Find the motion of a path that contains the point at a distance along the path, and the fraction there."""
    k, length = 0, _length(path, 0)
    while k < count - 2 and way > length:
        way -= length
        k += 1
        length = _length(path, k)
    return k, min(max(way / length, 0.0), 1.0) if length > 0.0 else 0.0


@inline
def _point(judge, path, k, t, ends, points, row):
    """Write a point on motion k of a path."""
    for c in range(path.shape[1]):
        ends[0, c], ends[1, c] = path[k, c], path[k + 1, c]
    tree = problem_of(judge.problem).tree
    turns_clearly(tree, ends)
    configuration_at(tree, ends, t, points, row)


@njit()
def cut(judge, path, count, ends, points, state):
    """Cut from one random point of a path to another, if the straight motion and the rest of both motions are free.

    The rest of both motions is checked again, because rounded points are not exactly on their motions.
    """
    whole = 0.0
    for k in range(count - 1):
        whole += _length(path, k)
    one, other = random(state) * whole, random(state) * whole
    i, s = _at(path, count, min(one, other))
    j, t = _at(path, count, max(one, other))
    if i == j or count + 1 > len(path):
        return count
    _point(judge, path, i, s, ends, points, 0)
    _point(judge, path, j, t, ends, points, 1)
    free = motion_is_free(judge, ends, points[0], points[1], state)
    free = free and motion_is_free(judge, ends, path[i], points[0], state)
    free = free and motion_is_free(judge, ends, points[1], path[j + 1], state)
    if not free:
        return count
    _move(path, j + 1, count, i + 2 - j)
    for c in range(path.shape[1]):
        path[i + 1, c], path[i + 2, c] = points[0, c], points[1, c]
    return count + i + 2 - j


@njit()
def shorten_path(count, most, handles, lengths, path, state, ends, points):
    """Shorten a path by a limited number of cuts; corners are skipped before the first cut and after the last.

    Parameters
    ----------
    count : int
        Number of configurations of the path.
    most : int
        Limit on the cuts to try, including the cuts of earlier calls.
    handles, lengths
        See `free_motions.judge_of`.
    path : ndarray, shape (capacity, dof)
        The path is in the first rows, which are changed; the ends stay. Cuts for which no room is left are not made.
    state : ndarray of int64, shape (columns.STATE,)
        State of the work, see `columns`; the work continues from it.
    ends : ndarray, shape (2, dof)
        Scratch memory.
    points : ndarray, shape (2, dof)
        Scratch memory.

    Returns
    -------
    int
        New number of configurations of the path.
    """
    samples = sample_memory(handles)
    judge = judge_of(handles, lengths, path.shape[1], samples.ctypes.data)
    count = skip_corners(judge, path, count, ends, state)
    while state[ITERATION] < most and count > 2:
        state[ITERATION] += 1
        count = cut(judge, path, count, ends, points, state)
    count = skip_corners(judge, path, count, ends, state)
    held(samples)
    return count
