"""Polish paths: move corners and single joints wherever this lowers the cost and all new motions are free.

The cost of a path is its length, with a weight for each joint. A step does one of three things:

cut
    Cut from one point of the path to another, see `shortening`.
move
    Move a corner towards the straight path between its neighbours, and also by a random amount; the size of moves
    adapts to the share of moves that succeed [1].
straighten
    Let one joint run evenly from one row to another, while all other joints keep their values [2].

[1] Rechenberg: Evolutionsstrategie. Frommann-Holzboog 1973 (the rule of one success in five).
[2] Geraerts, Overmars: Creating high-quality paths for motion planning. Int. Journal of Robotics Research 26, 2007.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import ITERATION
from loewner._kernels.robots.free_motions import judge_of, random, sample_memory
from loewner._kernels.robots.shortening import cut, motion_is_free, skip_corners
from loewner._kernels.simd.memory import held

# Fractions of the steps that cut from one point of the path to another (CUTS) and that move a corner (MOVES); all other
# steps straighten the motion of a joint.
CUTS, MOVES = 0.2, 0.6

# Number of steps from one attempt to skip corners to the next.
SKIP_EVERY = 32

# Limits on the size of a move, as a fraction of the distance of the corner from the straight motion between its
# neighbors. A move that is free multiplies the size by LARGER, and a move that is not free by SMALLER; the two balance
# if about one move in five is free.
LEAST_SIZE, MOST_SIZE = 1e-4, 1.0
LARGER, SMALLER = 1.5, 0.9

# Minimum relative gain of a step that moves a corner or straightens a joint: it must lower the cost of the motions that
# it changes by more than this fraction.
GAIN = 1e-9


class Work(NamedTuple):
    """All that a step reads and writes.

    Attributes
    ----------
    judge : free_motions.Judge
    path : ndarray, shape (capacity, dof)
    box : ndarray, shape (3, dof)
        Lower and upper limits, and weights, which are 0 for joints that do not move.
    state : ndarray of int64, shape (columns.STATE,)
    size : ndarray, shape (1,)
        Size of the moves.
    ends : ndarray, shape (2, dof)
        Scratch memory.
    points : ndarray, shape (capacity, dof)
        Scratch memory.
    """

    judge: Any
    path: Any
    box: Any
    state: Any
    size: Any
    ends: Any
    points: Any


@inline
def _cost(box, a, b):
    """Cost of a motion."""
    squares = 0.0
    for c in range(len(a)):
        way = box[2, c] * (b[c] - a[c])
        squares += way * way
    return np.sqrt(squares)


@njit()
def _move_corner(work, count):
    """Move one corner of the path."""
    path, box, state, size, new = work.path, work.box, work.state, work.size, work.points[0]
    k = 1 + np.int64(random(state) * (count - 2))
    before, after = _cost(box, path[k - 1], path[k]), _cost(box, path[k], path[k + 1])
    share = before / (before + after) if before + after > 0.0 else 0.5
    height, weighted = 0.0, 0
    for c in range(path.shape[1]):
        new[c] = path[k - 1, c] + share * (path[k + 1, c] - path[k - 1, c])
        way = box[2, c] * (new[c] - path[k, c])
        height += way * way
        weighted += 1 if box[2, c] > 0.0 else 0
    height = np.sqrt(height)
    inwards, aside = size[0] * random(state), size[0] * height * np.sqrt(3.0 / weighted)
    for c in range(path.shape[1]):
        value = path[k, c]
        if box[2, c] > 0.0:
            astray = aside * (random(state) + random(state) - 1.0) / box[2, c]
            value = min(max(value + inwards * (new[c] - value) + astray, box[0, c]), box[1, c])
        new[c] = value
    if not _cost(box, path[k - 1], new) + _cost(box, new, path[k + 1]) < (before + after) * (1.0 - GAIN):
        return
    free = motion_is_free(work.judge, work.ends, path[k - 1], new, state)
    free = free and motion_is_free(work.judge, work.ends, new, path[k + 1], state)
    if free:
        for c in range(path.shape[1]):
            path[k, c] = new[c]
    size[0] = min(max(size[0] * (LARGER if free else SMALLER), LEAST_SIZE), MOST_SIZE)


@njit()
def _straighten(work, count):
    """Let one joint run evenly between two rows of the path."""
    path, box, state, new = work.path, work.box, work.state, work.points
    i, j = np.int64(random(state) * count), np.int64(random(state) * count)
    i, j = min(i, j), max(i, j)
    joint = np.int64(random(state) * path.shape[1])
    if j - i < 2 or box[2, joint] == 0.0:
        return
    whole, old = 0.0, 0.0
    for k in range(i, j):
        old += _cost(box, path[k], path[k + 1])
    for k in range(i, j + 1):
        whole += _cost(box, path[k - 1], path[k]) if k > i else 0.0
        for c in range(path.shape[1]):
            new[k, c] = path[k, c]
        if i < k < j:
            new[k, joint] += (whole / old) * (path[j, joint] - path[i, joint]) - (path[k, joint] - path[i, joint])
    cost = 0.0
    for k in range(i, j):
        cost += _cost(box, new[k], new[k + 1])
    if not cost < old * (1.0 - GAIN):
        return
    for k in range(i, j):
        if not motion_is_free(work.judge, work.ends, new[k], new[k + 1], state):
            return
    for k in range(i + 1, j):
        path[k, joint] = new[k, joint]


@njit()
def polish_path(count, most, handles, lengths, path, box, state, size, ends, points):
    """Polish a path in a limited number of steps.

    Parameters
    ----------
    count : int
        Number of configurations of the path.
    most : int
        Limit on the steps, including the steps of earlier calls.
    handles, lengths
        See `free_motions.judge_of`.
    path : ndarray, shape (capacity, dof)
        The path is in the first rows, which are changed; the ends stay.
    box, state, size, ends, points
        See `Work`.

    Returns
    -------
    int
        New number of configurations of the path.
    """
    samples = sample_memory(handles)
    judge = judge_of(handles, lengths, path.shape[1], samples.ctypes.data)
    work = Work(judge, path, box, state, size, ends, points)
    while state[ITERATION] < most and count > 2:
        if state[ITERATION] % SKIP_EVERY == 0:
            count = skip_corners(judge, path, count, ends, state)
            if count == 2:
                break
        state[ITERATION] += 1
        kind = random(state)
        if kind < CUTS:
            count = cut(judge, path, count, ends, points, state)
        elif kind < CUTS + MOVES:
            _move_corner(work, count)
        else:
            _straighten(work, count)
    held(samples)
    return count
