"""RRT-Connect: two trees of free motions, from the start and from the goals, that grow until they meet.

A tree grows by a motion towards a drawn configuration. From its new node, it then continues towards the other tree, as
far as motions are free [1]. A node from which a motion failed is extended only towards nearby configurations, in its
dynamic domain [2]. Most trees are small. The search for the nearest configuration therefore compares all of a tree's
nodes, in lanes; trees are stored column by column for this search.

The method differs from the papers in these points:

1. The smaller tree grows, whereas [1] alternates between the trees.
2. Configurations are drawn from a sequence of low discrepancy, not at random.
3. The path to the other tree leads straight to one of its nodes, at first the nearest one, in at most `MOST_STEPS`
   equal steps.
4. Before the first draw, the straight path from the start to the nearest goal is tried. All goals are roots of one
   tree.
5. The radius of a dynamic domain changes a little with every failure and success.
6. Differences of joints without limits are taken modulo whole turns.
7. If a path must cost less than a bound, configurations are drawn from the ellipsoids of all such paths [3], with one
   ellipsoid for each goal.
8. If an axis of a link has to stay near a direction, every new node is moved until its axis is near the direction.

[1] Kuffner, LaValle: RRT-Connect: An efficient approach to single-query path planning. ICRA 2000.
[2] Yershova, Jaillet, Siméon, LaValle: Dynamic-domain RRTs. ICRA 2005.
[3] Gammell, Srinivasa, Barfoot: Informed RRT*. IROS 2014.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import FULL, MET, SPENT
from loewner._kernels.columns import BOUND, GAP, GOALS, ITERATION, MOTIONS, OF_START, POSES, RANDOM, ROWS, STARTS, STEP
from loewner._kernels.low_discrepancy import irrationals
from loewner._kernels.records import Search
from loewner._kernels.robots.free_motions import is_free, judge_of, random, sample_memory
from loewner._kernels.robots.lines import bring_back
from loewner._kernels.simd.memory import floats_at, held, integers_at, reader, record_kind
from loewner._kernels.simd.vectors import rounded_product

# Largest length of a motion in a tree (the range), as a fraction of the diagonal of the box of joint limits. For a
# typical arm, this is 1 rad.
SHARE = 1 / 12

# Radius of a node's dynamic domain after the first failure of a motion from the node, and the smallest radius, both in
# units of the range. Each later failure reduces the radius by the fraction CHANGE, and each success enlarges it by this
# fraction.
FIRST_DOMAIN, LEAST_DOMAIN, CHANGE = 4.0, 1.0, 1e-4

# Maximum number of steps by which a tree grows towards the other tree before the next configuration is drawn.
MOST_STEPS = 64

TURN = 2.0 * np.pi

_search_of = reader(record_kind(Search, "I1 F1 I1 I1 F1 F1 F1 F1 F1 F1 I1 F1 F2"))


class Trees(NamedTuple):
    """Two trees: row 0 is the tree of the start, and row 1 the tree of the goals.

    Attributes
    ----------
    nodes : ndarray, shape (2, joints, capacity)
        Values of the joints that move.
    domains : ndarray, shape (2, capacity)
        Largest distance of a drawn configuration at which the node is extended; infinite until a motion from the node
        fails.
    parents : ndarray of int64, shape (2, capacity)
        Parent of each node; -1 for roots.
    squares : ndarray, shape (capacity,)
        Scratch memory for squared distances.
    """

    nodes: Any
    domains: Any
    parents: Any
    squares: Any


class Work(NamedTuple):
    """All that an iteration reads and writes.

    Attributes
    ----------
    judge : free_motions.Judge
    search : records.Search
    trees : Trees
    ends : ndarray, shape (2, dof)
        A motion to test, in which joints that do not move keep their values.
    points : ndarray, shape (4, joints)
        Memory.
    """

    judge: Any
    search: Any
    trees: Any
    ends: Any
    points: Any


@inline
def _trees_of(search):
    """The trees in the memory of a search."""
    joints, capacity, at = len(search.columns), search.trees.shape[1], np.int64(search.trees.ctypes.data)
    row = 8 * capacity
    return Trees(
        floats_at(at, (2, joints, capacity)),
        floats_at(at + 2 * joints * row, (2, capacity)),
        integers_at(at + (2 * joints + 2) * row, (2, capacity)),
        floats_at(at + (2 * joints + 4) * row, (capacity,)),
    )


@inline
def _turns(search, c, way):
    """Number of whole turns to subtract from a difference."""
    return np.rint(way / TURN) if search.turning[c] != 0 else 0.0


@njit()
def _nearest(search, nodes, count, q, squares):
    """The node of a tree that is nearest to q, and its distance."""
    for k in range(count):
        squares[k] = 0.0
    for c in range(nodes.shape[0]):
        row, value, weight = nodes[c], q[c], search.weights[c]
        if search.turning[c] != 0:
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
def _free(work, a, b):
    """Return whether the motion between two settings of the moving joints is free."""
    columns, ends, state = work.search.columns, work.ends, work.search.state
    for c in range(len(a)):
        ends[0, columns[c]] = a[c]
        ends[1, columns[c]] = b[c]
    state[MOTIONS] += 1
    return is_free(work.judge, ends, state[POSES:])


@inline
def _brought_back(work, q):
    """Move q until it keeps the axis, if an axis must be kept; return whether this succeeded."""
    columns, row = work.search.columns, work.ends[1]
    if work.judge.kept == 0:
        return True
    for c in range(len(q)):
        row[columns[c]] = q[c]
    if not bring_back(work.judge.kept, row):
        return False
    for c in range(len(q)):
        q[c] = row[columns[c]]
    return True


@inline
def _add(trees, tree, count, q, parent):
    """Add q to a tree as a node."""
    for c in range(len(q)):
        trees.nodes[tree, c, count] = q[c]
    trees.parents[tree, count] = parent
    trees.domains[tree, count] = np.inf


@inline
def _way(search, nodes, goal, q, axis):
    """Write the straight path from the start to a goal to `axis`; return its length, and the length through q."""
    straight = before = after = 0.0
    for c in range(len(q)):
        weight, way = search.weights[c], nodes[1, c, goal] - nodes[0, c, 0]
        axis[c] = weight * (way - TURN * _turns(search, c, way))
        first = weight * (q[c] - nodes[0, c, 0])
        straight += axis[c] * axis[c]
        before += first * first
        after += (axis[c] - first) * (axis[c] - first)
    return np.sqrt(straight), np.sqrt(before) + np.sqrt(after)


@njit()
def _draw_within(search, nodes, roots, drawn, axis):
    """Draw from an ellipsoid about the start and a goal that contains all paths whose cost is below a bound.

    A configuration that already lies in one of the ellipsoids is kept. The coordinates of a direction are sums of four
    uniform numbers, which are nearly normal. The radius is the largest of several uniform numbers, one for each joint,
    so it is distributed as in a ball.
    """
    state, start, bound = search.state, nodes[0], search.reach[BOUND]
    for goal in range(roots):
        if _way(search, nodes, goal, drawn, axis)[1] < bound:
            return
    first, straight = np.int64(random(state) * roots), np.inf
    for k in range(roots):
        straight, _ = _way(search, nodes, (first + k) % roots, drawn, axis)
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
        drawn[c] = start[c, 0] + place / search.weights[c]
        if search.turning[c] == 0:
            drawn[c] = min(max(drawn[c], search.lower[c]), search.upper[c])


@inline
def _rows(trees, tree, node):
    """Number of nodes from a node to its root, including both."""
    count = 0
    while node >= 0:
        count += 1
        node = trees.parents[tree, node]
    return count


@njit()
def _iterate(work, roots):
    """Grow one tree and lead it to the other; return MET if the trees meet, otherwise SPENT."""
    search, trees, points = work.search, work.trees, work.points
    state, longest, joints = search.state, search.reach[STEP], len(search.columns)
    drawn, here, there = points[0], points[1], points[2]
    tree = 0 if state[STARTS] <= state[GOALS] else 1
    nodes, count = trees.nodes[tree], state[STARTS + tree]
    for c in range(joints):
        share = search.shift[c] + state[ITERATION] * search.stride[c]
        drawn[c] = search.lower[c] + (search.upper[c] - search.lower[c]) * (share - np.floor(share))
    if search.reach[BOUND] < np.inf:
        _draw_within(search, trees.nodes, roots, drawn, points[3])
    near, distance = _nearest(search, nodes, count, drawn, trees.squares)
    if distance == 0.0 or distance > trees.domains[tree, near]:
        return SPENT
    share = min(longest / distance, 1.0)
    for c in range(joints):
        here[c] = nodes[c, near]
        way = drawn[c] - here[c]
        there[c] = here[c] + share * (way - TURN * _turns(search, c, way))
        if search.turning[c] == 0:
            there[c] = min(max(there[c], search.lower[c]), search.upper[c])
    domain = trees.domains[tree, near]
    if not (_brought_back(work, there) and _free(work, here, there)):
        less = max(domain * (1.0 - CHANGE), LEAST_DOMAIN * longest)
        trees.domains[tree, near] = FIRST_DOMAIN * longest if domain == np.inf else less
        return SPENT
    if domain != np.inf:
        trees.domains[tree, near] = domain * (1.0 + CHANGE)
    _add(trees, tree, count, there, near)
    return _lead(work, tree, count)


@njit()
def _lead(work, tree, last):
    """Extend a tree from its last node straight to the other tree's nearest node, as far as motions are free."""
    search, trees, points = work.search, work.trees, work.points
    state, reach, joints = search.state, search.reach, len(search.columns)
    count, other = last + 1, 1 - tree
    first, here, there = points[0], points[1], points[2]
    for c in range(joints):
        first[c] = trees.nodes[tree, c, last]
        here[c] = first[c]
    aim, distance = _nearest(search, trees.nodes[other], state[STARTS + other], first, trees.squares)
    # If squares overflow, `share` is NaN, and the code below treats the trees as far apart, so they do not meet.
    share = distance / reach[STEP]
    steps = np.int64(np.ceil(max(share, 1.0))) if share <= MOST_STEPS else MOST_STEPS + 1
    met = steps <= MOST_STEPS
    for step in range(1, min(steps, MOST_STEPS) + 1):
        for c in range(joints):
            value = trees.nodes[other, c, aim]
            value -= TURN * _turns(search, c, value - first[c])
            there[c] = first[c] + (value - first[c]) * (step / steps) if step < steps else value
        if not ((step == steps or _brought_back(work, there)) and _free(work, here, there)):
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
        state[ROWS] = _rows(trees, 0, state[OF_START]) + _rows(trees, 1, state[OF_START + 1])
        reach[GAP] = 0.0
        return MET
    left = 0.0
    for c in range(joints):
        way = trees.nodes[other, c, aim] - here[c]
        way = search.weights[c] * (way - TURN * _turns(search, c, way))
        left += way * way
    reach[GAP] = min(reach[GAP], np.sqrt(left))
    return SPENT


@njit()
def begin_search(search, goals, seed):
    """Begin a new search: trees that have only roots, the range, and the sequence of draws.

    Parameters
    ----------
    search : int
        Handle of a `records.Search`.
    goals : ndarray, shape (goals, dof)
    seed : int
    """
    begun = _search_of(search)
    trees, state, reach = _trees_of(begun), begun.state, begun.reach
    irrationals(begun.stride, begun.shift)
    squares = 0.0
    for c in range(len(begun.columns)):
        column, weight = begun.columns[c], begun.weights[c]
        root = begun.start[column]
        if begun.turning[c] != 0:
            begun.lower[c], begun.upper[c] = root - np.pi, root + np.pi
        way = rounded_product(weight, begun.upper[c]) - rounded_product(weight, begun.lower[c])
        squares += rounded_product(way, way)
        share = 0.5 + rounded_product(np.float64(seed), begun.shift[c])
        begun.shift[c] = share - np.floor(share)
        trees.nodes[0, c, 0] = root
        for goal in range(len(goals)):
            trees.nodes[1, c, goal] = goals[goal, column]
    trees.domains[0, 0], trees.parents[0, 0] = np.inf, -1
    for goal in range(len(goals)):
        trees.domains[1, goal], trees.parents[1, goal] = np.inf, -1
    reach[STEP], reach[BOUND], reach[GAP] = SHARE * np.sqrt(squares), np.inf, np.inf
    for k in range(len(state)):
        state[k] = 0
    state[STARTS], state[GOALS], state[RANDOM] = 1, len(goals), seed


@njit()
def connect_trees(search, most):
    """Let the trees grow until they meet, or for a number of iterations.

    Parameters
    ----------
    search : int
        Handle of a `records.Search` that has begun. A later call continues where the previous call ended.
    most : int
        Limit on the number of iterations, including the iterations of earlier calls.

    Returns
    -------
    int
        MET; SPENT if all iterations are done; or FULL if the trees need more memory to continue.
    """
    begun = _search_of(search)
    samples, state, trees = sample_memory(begun.handles), begun.state, _trees_of(begun)
    judge = judge_of(begun.handles, begun.lengths, len(begun.start), samples.ctypes.data)
    ends, points = np.empty((2, len(begun.start))), np.empty((4, len(begun.columns)))
    for c in range(len(begun.start)):
        ends[0, c] = ends[1, c] = begun.start[c]
    work, roots, outcome = Work(judge, begun, trees, ends, points), 0, SPENT
    while roots < state[GOALS] and trees.parents[1, roots] < 0:
        roots += 1
    while outcome == SPENT and state[ITERATION] < most:
        if max(state[STARTS], state[GOALS]) + MOST_STEPS + 1 > trees.nodes.shape[2]:
            outcome = FULL
        else:
            state[ITERATION] += 1
            # Before the first configuration is drawn, try the straight path to the nearest goal.
            outcome = _lead(work, 0, 0) if state[ITERATION] == 1 else _iterate(work, roots)
    held(samples)
    return outcome


@njit()
def path_through(search, path):
    """Write the path through both trees, once they have met.

    Parameters
    ----------
    search : int
        Handle of a `records.Search`.
    path : ndarray, shape (state[ROWS], dof)
        Receives the path.

    Returns
    -------
    int
        1 if values were shifted by whole turns; the path then differs slightly from the motions that were judged.
    """
    met = _search_of(search)
    trees, state, turned = _trees_of(met), met.state, 0
    first = _rows(trees, 0, state[OF_START])
    for tree in range(2):
        node = state[OF_START + tree]
        for step in range(len(path) - first if tree == 1 else first):
            row = path[first + step if tree == 1 else first - 1 - step]
            for c in range(len(row)):
                row[c] = met.start[c]
            for c in range(len(met.columns)):
                row[met.columns[c]] = trees.nodes[tree, c, node]
            node = trees.parents[tree, node]
    for c in range(len(met.columns)):
        column = met.columns[c]
        turns = _turns(met, c, path[first, column] - path[first - 1, column])
        if turns != 0.0:
            turned = 1
            for k in range(first, len(path)):
                path[k, column] -= rounded_product(TURN, turns)
    return turned
