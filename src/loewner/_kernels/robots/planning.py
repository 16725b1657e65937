"""RRT-Connect: two trees of free motions, from the start and from the goals, that grow until they meet.

A tree grows by a motion towards a drawn configuration; then its new node is led to the other tree as far as motions are
free [1]. Configurations that failed are extended only towards configurations near by: the dynamic domain [2]. Trees are
kept column by column, so that the search for the nearest configuration runs in lanes; they are small as a rule.

It differs from the papers in the following:

1. The smaller tree grows, where [1] takes the trees in turns.
2. Configurations are drawn from a sequence of low discrepancy, not at random.
3. The way to the other tree leads straight to one node of it, the nearest at first, in at most `MOST_STEPS` equal
   steps.
4. Before anything is drawn, the start is led to the nearest goal. The goals are roots of one tree.
5. The radius of a dynamic domain changes a little with every failure and success.
6. Whole turns are left out of the differences of joints without limits.
7. If a path must cost less than a bound, configurations are drawn from the ellipsoids of all paths that do [3], one for
   each goal.
8. If an axis of a link is kept near a direction, every new node is moved until it is.

[1] Kuffner, LaValle: RRT-Connect: An efficient approach to single-query path planning. ICRA 2000.
[2] Yershova, Jaillet, Siméon, LaValle: Dynamic-domain RRTs. ICRA 2005.
[3] Gammell, Srinivasa, Barfoot: Informed RRT*. IROS 2014.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import FULL, MET, SPENT
from loewner._kernels.columns import GOALS, ITERATION, MOTIONS, OF_START, POSES, STARTS
from loewner._kernels.robots.free_motions import is_free, judge_of, random, sample_memory
from loewner._kernels.robots.lines import bring_back
from loewner._kernels.simd.memory import held

# Of the dynamic domain, in ranges: what a configuration is first limited to when a motion from it fails, what it is
# limited to at least, and the share that a failure takes and a success gives.
FIRST_DOMAIN, LEAST_DOMAIN, CHANGE = 4.0, 1.0, 1e-4

# Steps that a tree is led on by, at most, before the next draw.
MOST_STEPS = 64

TURN = 2.0 * np.pi


class Trees(NamedTuple):
    """Two trees; row 0 is the start's, row 1 the goals'.

    Attributes
    ----------
    nodes : ndarray, shape (2, joints, capacity)
        Values of the joints that move.
    parents : ndarray of int64, shape (2, capacity)
        -1 for roots.
    domains : ndarray, shape (2, capacity)
        How near a configuration drawn must be for the node to be extended; infinite until a motion from it fails.
    """

    nodes: Any
    parents: Any
    domains: Any


class Space(NamedTuple):
    """The joints that move.

    Attributes
    ----------
    columns : ndarray of int64, shape (joints,)
        Their columns in configurations.
    lower, upper : ndarray, shape (joints,)
    turning : ndarray of int64, shape (joints,)
        1 where whole turns change nothing, and there are no limits.
    stride, shift : ndarray, shape (joints,)
        Of the sequence that configurations are drawn from, see `loewner.planners.compiled`.
    weights : ndarray, shape (joints,)
        Factors of their differences in distances.
    range : float
        How long a motion of a tree may be.
    bound : float
        Upper bound on the cost of a path; infinite for any path.
    """

    columns: Any
    lower: Any
    upper: Any
    turning: Any
    stride: Any
    shift: Any
    weights: Any
    range: Any
    bound: Any


class Search(NamedTuple):
    """All that a search reads and writes.

    Attributes
    ----------
    judge : free_motions.Judge
    space : Space
    trees : Trees
    state : ndarray of int64, shape (columns.STATE,)
        Where the search stands, see `columns`.
    gap : ndarray, shape (1,)
        How near to each other the trees came.
    ends : ndarray, shape (2, dof)
        A motion to test, in which joints that do not move keep their values.
    points : ndarray, shape (4, joints)
        Memory.
    squares : ndarray, shape (capacity,)
        Memory.
    """

    judge: Any
    space: Any
    trees: Any
    state: Any
    gap: Any
    ends: Any
    points: Any
    squares: Any


@inline
def _turns(space, c, way):
    """Whole turns to leave out of a way."""
    return np.rint(way / TURN) if space.turning[c] != 0 else 0.0


@njit()
def _nearest(space, nodes, count, q, squares):
    """Which of a tree's nodes is nearest to q, and how far it is."""
    for k in range(count):
        squares[k] = 0.0
    for c in range(nodes.shape[0]):
        row, value, weight = nodes[c], q[c], space.weights[c]
        if space.turning[c] != 0:
            for k in range(count):
                way = value - row[k]
                way = weight * (way - TURN * np.rint(way / TURN))
                squares[k] += way * way
        else:
            for k in range(count):
                way = weight * (value - row[k])
                squares[k] += way * way
    best = 0
    for k in range(1, count):
        if squares[k] < squares[best]:
            best = np.int64(k)
    return best, np.sqrt(squares[best])


@inline
def _free(search, a, b):
    """Is the motion between two settings of the joints that move free?"""
    space, ends, state = search.space, search.ends, search.state
    for c in range(len(a)):
        ends[0, space.columns[c]] = a[c]
        ends[1, space.columns[c]] = b[c]
    state[MOTIONS] += 1
    return is_free(search.judge, ends, state[POSES:])


@inline
def _brought_back(search, q):
    """Move q until it keeps an axis, if one is to be kept; return whether that worked."""
    space, row = search.space, search.ends[1]
    if search.judge.kept == 0:
        return True
    for c in range(len(q)):
        row[space.columns[c]] = q[c]
    if not bring_back(search.judge.kept, row):
        return False
    for c in range(len(q)):
        q[c] = row[space.columns[c]]
    return True


@inline
def _add(trees, tree, count, q, parent):
    """Make q a node."""
    for c in range(len(q)):
        trees.nodes[tree, c, count] = q[c]
    trees.parents[tree, count] = parent
    trees.domains[tree, count] = np.inf


@inline
def _way(search, goal, q, axis):
    """Length of the straight way from the start to a goal, written to `axis`, and of the way by q."""
    space, nodes = search.space, search.trees.nodes
    straight = before = after = 0.0
    for c in range(len(q)):
        weight, way = space.weights[c], nodes[1, c, goal] - nodes[0, c, 0]
        axis[c] = weight * (way - TURN * _turns(space, c, way))
        first = weight * (q[c] - nodes[0, c, 0])
        straight += axis[c] * axis[c]
        before += first * first
        after += (axis[c] - first) * (axis[c] - first)
    return np.sqrt(straight), np.sqrt(before) + np.sqrt(after)


@njit()
def _draw_within(search, roots, drawn, axis):
    """Draw from the ellipsoid about the start and a goal, unless q lies in one: all ways that cost less than a bound.

    A direction has sums of four uniform numbers for coordinates, nearly normal; a radius is the largest of as many
    uniform numbers as there are joints, which is distributed as in a ball.
    """
    space, state, start, bound = search.space, search.state, search.trees.nodes[0], search.space.bound
    for goal in range(roots):
        if _way(search, goal, drawn, axis)[1] < bound:
            return
    first, straight = np.int64(random(state) * roots), np.inf
    for k in range(roots):
        straight, _ = _way(search, (first + k) % roots, drawn, axis)
        if straight < bound:
            break
    if not 0.0 < straight < bound:
        return
    square, along, radius = 0.0, 0.0, 0.0
    for c in range(len(drawn)):
        drawn[c] = random(state) + random(state) + random(state) + random(state) - 2.0
        square += drawn[c] * drawn[c]
        along += drawn[c] * axis[c]
        radius = max(radius, random(state))
    if square == 0.0:
        return
    thick, scale = 0.5 * np.sqrt((bound - straight) * (bound + straight)), radius / np.sqrt(square)
    along *= scale / straight
    for c in range(len(drawn)):
        place = (0.5 + (0.5 * bound - thick) * along / straight) * axis[c] + thick * scale * drawn[c]
        drawn[c] = start[c, 0] + place / space.weights[c]
        if space.turning[c] == 0:
            drawn[c] = min(max(drawn[c], space.lower[c]), space.upper[c])


@njit()
def _iterate(search, roots):
    """Grow one tree and lead it to the other; MET if they meet, else SPENT."""
    space, trees, state, points = search.space, search.trees, search.state, search.points
    joints = len(space.columns)
    drawn, here, there = points[0], points[1], points[2]
    tree = 0 if state[STARTS] <= state[GOALS] else 1
    nodes, count = trees.nodes[tree], state[STARTS + tree]
    for c in range(joints):
        share = space.shift[c] + state[ITERATION] * space.stride[c]
        drawn[c] = space.lower[c] + (space.upper[c] - space.lower[c]) * (share - np.floor(share))
    if space.bound < np.inf:
        _draw_within(search, roots, drawn, points[3])
    near, distance = _nearest(space, nodes, count, drawn, search.squares)
    if distance == 0.0 or distance > trees.domains[tree, near]:
        return SPENT
    share = min(space.range / distance, 1.0)
    for c in range(joints):
        here[c] = nodes[c, near]
        way = drawn[c] - here[c]
        there[c] = here[c] + share * (way - TURN * _turns(space, c, way))
        if space.turning[c] == 0:
            there[c] = min(max(there[c], space.lower[c]), space.upper[c])
    domain = trees.domains[tree, near]
    if not (_brought_back(search, there) and _free(search, here, there)):
        less = max(domain * (1.0 - CHANGE), LEAST_DOMAIN * space.range)
        trees.domains[tree, near] = FIRST_DOMAIN * space.range if domain == np.inf else less
        return SPENT
    if domain != np.inf:
        trees.domains[tree, near] = domain * (1.0 + CHANGE)
    _add(trees, tree, count, there, near)
    return _lead(search, tree, count)


@njit()
def _lead(search, tree, last):
    """Lead the last node of a tree straight to the nearest one of the other, as far as motions are free."""
    space, trees, state, gap, points = search.space, search.trees, search.state, search.gap, search.points
    joints, count, other = len(space.columns), last + 1, 1 - tree
    first, here, there = points[0], points[1], points[2]
    for c in range(joints):
        first[c] = trees.nodes[tree, c, last]
        here[c] = first[c]
    aim, distance = _nearest(space, trees.nodes[other], state[STARTS + other], first, search.squares)
    steps = np.int64(min(max(np.ceil(distance / space.range), 1.0), MOST_STEPS + 1.0))
    met = steps <= MOST_STEPS
    for step in range(1, min(steps, MOST_STEPS) + 1):
        for c in range(joints):
            value = trees.nodes[other, c, aim]
            value -= TURN * _turns(space, c, value - first[c])
            there[c] = first[c] + (value - first[c]) * (step / steps) if step < steps else value
        if not ((step == steps or _brought_back(search, there)) and _free(search, here, there)):
            met = False
            break
        if step == steps:
            break
        _add(trees, tree, count, there, count - 1)
        count += 1
        for c in range(joints):
            here[c] = there[c]
    state[STARTS + tree] = count
    if met:
        state[OF_START + tree], state[OF_START + other] = count - 1, aim
        gap[0] = 0.0
        return MET
    left = 0.0
    for c in range(joints):
        way = trees.nodes[other, c, aim] - here[c]
        way = space.weights[c] * (way - TURN * _turns(space, c, way))
        left += way * way
    gap[0] = min(gap[0], np.sqrt(left))
    return SPENT


@njit()
def connect_trees(
    most, reach, handles, lengths, joints, limits, nodes, parents, domains, state, gap, ends, points, squares
):  # fmt: skip
    """Let the trees grow, for at most so many iterations.

    Parameters
    ----------
    most : int
        Iterations in all, those of earlier calls included.
    reach : ndarray, shape (2,)
        `Space.range` and `Space.bound`.
    handles, lengths
        See `free_motions.judge_of`.
    joints : ndarray of int64, shape (2, joints)
        Columns and which turn, see `Space`.
    limits : ndarray, shape (5, joints)
        The rest of it: lower, upper, stride, shift, weights.
    nodes, parents, domains
        See `Trees`: roots are in their places.
    state, gap, ends, points, squares
        See `Search`, which goes on from there.

    Returns
    -------
    int
        MET; SPENT: all iterations are done; or FULL: the trees need more memory to go on.
    """
    space = Space(joints[0], limits[0], limits[1], joints[1], limits[2], limits[3], limits[4], reach[0], reach[1])
    samples = sample_memory(handles)
    judge = judge_of(handles, lengths, ends.shape[1], samples.ctypes.data)
    outcome = _grow(Search(judge, space, Trees(nodes, parents, domains), state, gap, ends, points, squares), most)
    held(samples)
    return outcome


@njit()
def _grow(search, most):
    """Let the trees grow as `connect_trees` does."""
    state, capacity, roots = search.state, search.trees.nodes.shape[2], 0
    while roots < state[GOALS] and search.trees.parents[1, roots] < 0:
        roots += 1
    while state[ITERATION] < most:
        if max(state[STARTS], state[GOALS]) + MOST_STEPS + 1 > capacity:
            return FULL
        state[ITERATION] += 1
        # Straight to the nearest goal, before anything is drawn.
        outcome = _lead(search, 0, 0) if state[ITERATION] == 1 else _iterate(search, roots)
        if outcome == MET:
            return MET
    return SPENT
