"""Trees of planes that separate all pairs of bodies along a whole motion: see docs/proof-format.md.

A tree is searched depth first. A normal is fixed to one body of a pair, the lower body, and points to the other body,
the upper body. A plane is accepted if the gaps at both ends of its interval exceed the bound of the format. The gaps
are computed in double precision, and must exceed the bound by some room for rounding. The final decision is made by the
program that verifies the proof.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import OVERLAPPING, TOUCHING
from loewner._kernels.columns import ELLIPSOID, POLYTOPE
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.linalg3 import apply, apply_transposed, dot, image, minus, negated, plus, product, scaled
from loewner._kernels.narrow.gjk_fast import MEMORY, measuring, result_of, vertices_of
from loewner._kernels.pieces.pack import plane_model_of, tree_of
from loewner._kernels.pieces.shapes import unit_support
from loewner._kernels.robots.kinematics import POSE, place_links, workspace_size
from loewner._kernels.simd.memory import held
from loewner._kernels.simd.vectors import LANES, broadcast, entry_at_highest, load, numbers_from, select
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# The first line lists the columns of a cluster. The second line lists the columns of a piece at which its radius, its
# center and the nine numbers of its factor begin; column 0 contains its kind.
FIRST, LAST, LEFT_HALF, RIGHT_HALF, BEGIN, END, CURVED = 0, 1, 2, 3, 4, 5, 6
RADIUS, CENTER, FACTOR = 1, 2, 5

# Columns of a box at which its half-edges and a point inside the pieces begin; the first three columns are its center.
HALF, INSIDE = 3, 6

# Columns of a body: its link in the model, the link of the robot with the same pose, and the cluster of all its pieces.
LINK, PLACED_BY, ROOT = 0, 1, 2

# Value of the column MOVES for joints that turn. Columns of a joint: how it moves, the norm of its axis vector if it
# slides, its rotation, its translation and its unit axis. Integer columns of a link: the link above it, and the number
# of links above it. The last line lists the columns of a joint's `speeds` on a motion.
TURNS = 1.0
MOVES, LENGTH, TURN, SHIFT, AXIS = 0, 1, 2, 11, 14
ABOVE, DEPTH = 0, 1
RATE, BEND, OFF, FAR = 0, 1, 2, 3

# Tokens of the trees.
HALVED, FIRST_DIVIDED, SECOND_DIVIDED, SAME, AXES, NORMAL, DOUBLES = 0, 1, 2, 3, 4, 16, 18

# Largest depth of a tree, which limits the number of digits of an interval's ends. Checkers allow a depth of 64.
DEEPEST = 40

# Factor that enlarges the required gaps, to leave room for checkers that compute with intervals.
SHARE = 1.0 + 2e-9

# The entries of a normal are rounded to integers whose absolute values are at most LARGEST. Since rounding turns the
# normal, SCALES multiples of the normal are rounded, and the best result is kept. At depth DEEP and below, and for
# bodies that do not move, the normal is also tried in doubles, without rounding.
LARGEST, SCALES, DEEP = 32767.0, 3, 10

# Amount by which the gaps of boxes, which are compared first, must exceed the required gaps, relative to the size of
# the model. It allows for poses that are not exact rotations.
BOX_ROOM = 4e-6

# Amount by which gaps must exceed the required gaps before a search ends early, relative to the size of the model. This
# leaves room for the rounding of the normal.
ROUNDED = 4e-5

# Number of axes that are tried, best scores first, if the comparison of boxes proves nothing.
BEST_AXES = 3

# Poses of links at multiples of 1 / KEPT are kept for the whole motion. For all other times, the poses at the middle of
# only one interval are stored at each level. This is enough because the search is depth first: both halves of an
# interval are finished before another interval at the same level is halved.
LEVELS = 6
KEPT = 1 << LEVELS
SLOTS = KEPT + 1 + DEEPEST

# First columns in a pair's row of `state`: RECENT for the side and the normal of the last successful search, NAMED for
# the token and the normal that were written last, and GIVEN for the normals that the caller provides. Each normal from
# the caller takes EACH columns: for its side, and for the normal itself. These normals help where pieces touch or
# overlap, because GJK finds no normal there.
RECENT, NAMED, GIVEN, EACH = 0, 4, 8, 4


class _Sides(NamedTuple):
    """Poses of one body's link in the frame of the other body's link, at both ends of an interval, for each side.

    Attributes
    ----------
    turns, shifts : tuples
        By side and end: the second body in the frame of the first body, and vice versa.
    """

    turns: Any
    shifts: Any


class _Pair(NamedTuple):
    """A pair of bodies, with its margin, and with A and V of the proof format by side."""

    pair: Any
    bodies: Any
    margin: Any
    curvature: Any
    deviation: Any


class _Limits(NamedTuple):
    """Lengths that depend on the size of the model: room for rounding, for boxes and for rounded normals, and errors.

    A search cannot find planes between pieces that are nearer to each other than a few errors. For bodies that do not
    move, `pair_proofs` uses another method; for other bodies, the room for rounding is larger anyway.
    """

    room: Any
    of_boxes: Any
    of_normals: Any
    error: Any


@inline
def _three(array, row, at):
    return array[row, at], array[row, at + 1], array[row, at + 2]


@inline
def _nine(array, row, at):
    return _three(array, row, at) + _three(array, row, at + 3) + _three(array, row, at + 6)


@inline
def _transposed(M):
    return M[0], M[3], M[6], M[1], M[4], M[7], M[2], M[5], M[8]


# -- shapes -----------------------------------------------------------------------------------


@apart
def support(model, cluster, n):
    """The farthest point of a cluster of pieces along n, in the frame of its link; n is not zero."""
    points, length = model.points, np.sqrt(dot(n, n))
    begin, end = model.clusters[cluster, BEGIN], model.clusters[cluster, END]
    farthest, reached = (0.0, 0.0, 0.0), -np.inf
    if end > begin:
        best, at = broadcast(-np.inf), numbers_from(begin)
        for column in range(begin, end, LANES):
            k = 4 * column
            x = load(points, k), load(points, k + LANES), load(points, k + 2 * LANES)
            products = dot(x, n) + load(points, k + 3 * LANES) * length
            more = products > best
            best, at = select(more, products, best), select(more, numbers_from(column), at)
        column = entry_at_highest(best, at)
        k = 4 * (column & ~(LANES - 1)) + (column & (LANES - 1))
        grown = points[k + 3 * LANES] / length
        farthest = plus((points[k], points[k + LANES], points[k + 2 * LANES]), scaled(grown, n))
        reached = dot(farthest, n)
    if model.clusters[cluster, CURVED] > 0:
        for piece in range(model.clusters[cluster, FIRST], model.clusters[cluster, LAST]):
            kind = int(model.pieces[piece, 0])
            if kind > POLYTOPE:
                M = _nine(model.pieces, piece, FACTOR)
                v = apply_transposed(M, n)
                x = image(M, _three(model.pieces, piece, CENTER), unit_support(kind, v[0], v[1], v[2]))
                x = plus(x, scaled(model.pieces[piece, RADIUS] / length, n))
                if dot(x, n) > reached:
                    farthest, reached = x, dot(x, n)
    return farthest


@inline
def _supports(model, clusters, poses, W, ends, n):
    """Find points of the lower cluster, and of the upper one at one or two poses, whose difference is least along n."""
    turns, shifts = poses
    a = support(model, clusters[0], negated(n))
    b = image(turns[0], shifts[0], support(model, clusters[1], apply_transposed(turns[0], n)))
    c = image(turns[1], shifts[1], support(model, clusters[1], apply_transposed(turns[1], n))) if ends == 2 else b
    if dot(minus(c, b), n) > 0.0:
        b = c
    return a, b


_measure = measuring(_supports)
_WORDS = MEMORY.size() // 8


@apart
def _direction(model, clusters, poses, ends, n, least, far, error, memory):
    """Find a direction along which clusters are farther apart than `far`, or else as far as possible.

    Parameters
    ----------
    ends : int
        1 to use the upper cluster only at the first pose, or 2 to use it at both poses.

    Returns
    -------
    near : bool
        Whether the clusters are within `least` of each other; if so, no such plane exists.
    n : tuple of 3 float
    """
    W, result = vertices_of(memory), result_of(memory)
    status, _, _, n = _measure(model, clusters, poses, W, ends, n, error, least, far, result)
    return status in (TOUCHING, OVERLAPPING), n


# -- bounds -----------------------------------------------------------------------------------


@njit()
def _write_boxes(model):
    """Write the boxes around clusters, along the axes of their bodies, and a point inside each cluster."""
    for body in range(len(model.bodies)):
        M, first = _nine(model.turns, body, 0), model.bodies[body, ROOT]
        stop = model.bodies[body + 1, ROOT] if body + 1 < len(model.bodies) else len(model.clusters)
        for cluster in range(first, stop):
            center = inside = 0.0, 0.0, 0.0
            for k in range(3):
                n = M[k], M[3 + k], M[6 + k]
                square = dot(n, n)
                p, q = support(model, cluster, n), support(model, cluster, negated(n))
                most, least = dot(p, n), dot(q, n)
                center = plus(center, scaled((most + least) / (2.0 * square), n))
                model.boxes[cluster, HALF + k] = (most - least) / (2.0 * square)
                inside = plus(inside, scaled(1.0 / 6.0, plus(p, q)))
            for k in range(3):
                model.boxes[cluster, k], model.boxes[cluster, INSIDE + k] = center[k], inside[k]


@inline
def _ball_of(model, column, piece):
    """The ball that represents a corner, or a curved piece, in the ball around a body."""
    if column >= 0:
        k = 4 * (column & ~(LANES - 1)) + (column & (LANES - 1))
        return (model.points[k], model.points[k + LANES], model.points[k + 2 * LANES]), model.points[k + 3 * LANES]
    squares = 0.0
    for k in range(9):
        squares += model.pieces[piece, FACTOR + k] ** 2
    if int(model.pieces[piece, 0]) != ELLIPSOID:
        squares *= 2.0
    return _three(model.pieces, piece, CENTER), model.pieces[piece, RADIUS] + np.sqrt(squares)


@njit()
def _write_balls(model):
    """Write the balls around bodies, see docs/proof-format.md."""
    for body in range(len(model.bodies)):
        root = model.bodies[body, ROOT]
        begin, corners = model.clusters[root, BEGIN], model.clusters[root, END] - model.clusters[root, BEGIN]
        first, count = model.clusters[root, FIRST], model.clusters[root, LAST] - model.clusters[root, FIRST]
        low, high, center, reach = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf), (0.0, 0.0, 0.0), 0.0
        for turn in range(2):
            for k in range(corners + count):
                piece = first + max(k - corners, 0)
                if k >= corners and int(model.pieces[piece, 0]) <= POLYTOPE:
                    continue
                c, r = _ball_of(model, begin + k if k < corners else -1, piece)
                if turn == 0:
                    low = min(low[0], c[0] - r), min(low[1], c[1] - r), min(low[2], c[2] - r)
                    high = max(high[0], c[0] + r), max(high[1], c[1] + r), max(high[2], c[2] + r)
                else:
                    away = minus(c, center)
                    reach = max(reach, np.sqrt(dot(away, away)) + r)
            center = scaled(0.5, plus(low, high))
        model.balls[body, 0], model.balls[body, 1], model.balls[body, 2] = center
        model.balls[body, 3] = reach


@njit()
def _size(model, speeds):
    """The size of the model on a motion: a bound on all lengths from which positions are computed."""
    far, longest = np.empty(len(model.ways)), 0.0
    for link in range(len(far)):
        t, above = _three(model.joints, link, SHIFT), model.ways[link, ABOVE]
        far[link] = np.sqrt(dot(t, t)) + speeds[link, FAR] + (far[above] if above >= 0 else 0.0)
        longest = max(longest, far[link])
    reach = 0.0
    for body in range(len(model.balls)):
        c = _three(model.balls, body, 0)
        reach = max(reach, np.sqrt(dot(c, c)) + model.balls[body, 3])
    return max(1.0, 2.0 * (longest + reach))


@njit()
def _bends(model, speeds, lower, upper, chain, levers):
    """A and V of the proof format, for the motion of the upper body as seen from the lower body.

    `chain` and `levers` are scratch: the joints from the upper body to the lower body, and the distances R.
    """
    x, y = model.bodies[upper, LINK], model.bodies[lower, LINK]
    while x != y:
        if y < 0 or (x >= 0 and model.ways[x, DEPTH] >= model.ways[y, DEPTH]):
            x = model.ways[x, ABOVE]
        else:
            y = model.ways[y, ABOVE]
    common, up, x = x, 0, model.bodies[upper, LINK]
    while x != common:
        chain[up], x = x, model.ways[x, ABOVE]
        up += 1
    count, x = up, model.bodies[lower, LINK]
    while x != common:
        count, x = count + 1, model.ways[x, ABOVE]
    k, x = count, model.bodies[lower, LINK]
    while x != common:
        k -= 1
        chain[k], x = x, model.ways[x, ABOVE]
    c, radius = _three(model.balls, upper, 0), model.balls[upper, 3]
    for k in range(count):
        j = chain[k]
        F, t, moves = _nine(model.joints, j, TURN), _three(model.joints, j, SHIFT), model.joints[j, MOVES]
        if k >= up:
            c = apply_transposed(F, minus(c, t))
        if moves == TURNS:
            e = _three(model.joints, j, AXIS)
            onto = scaled(dot(c, e), e)
            off = minus(c, onto)
            c, radius = onto, radius + np.sqrt(dot(off, off))
            levers[k] = radius
        else:
            radius += speeds[j, FAR]
            levers[k] = model.joints[j, LENGTH]
        if k < up:
            c = image(F, t, c)
    curvature, deviation, turned = 0.0, 0.0, 0.0
    for k in range(count - 1, -1, -1):  # From the lower body to the upper body.
        j = chain[k]
        rate = speeds[j, RATE]
        squares = 2.0 * rate * turned + speeds[j, BEND]
        if model.joints[j, MOVES] == TURNS:
            squares += rate * rate
            turned += rate
        curvature += levers[k] * squares
        deviation += levers[k] * speeds[j, OFF]
    return curvature, deviation


# -- poses ------------------------------------------------------------------------------------


@njit()
def _place(tree, course, times, slots, count, frames, memory):
    """Write the poses of all links at `count` times, at most eight, to their slots."""
    links, dof = len(tree.parent), course.shape[1]
    if links == 0:
        return
    Q, W, rows = memory
    degree = len(course) - 1
    for lane in range(LANES):
        t = times[min(lane, count - 1)]
        for k in range(dof):
            value, share = 0.0, 1.0
            for p in range(degree + 1):  # In each round, `share` is the next binomial coefficient.
                value += share * t**p * (1.0 - t) ** (degree - p) * course[p, k]
                share = share * (degree - p) / (p + 1)
            Q[lane, k] = value
    place_links(tree, Q, rows, 0, W)
    for lane in range(count):
        for k in range(links):
            for r in range(POSE):
                frames[slots[lane], k, r] = W[(POSE * k + r) * LANES + lane]


@njit()
def _slot_between(low, high, level, tree, course, known, frames, memory):
    """Return the slot of the middle of an interval; poses that are not stored yet are written to it."""
    times, slots = np.empty(LANES), np.empty(LANES, dtype=np.int64)
    width = high - low
    if level >= LEVELS:
        times[0], slots[0] = (low + high) / 2.0, KEPT + 1 + level
        _place(tree, course, times, slots, 1, frames, memory)
        return slots[0]
    slot = int((low + high) / 2.0 * KEPT)
    if not known[slot]:
        first = int(low / width) // LANES * LANES
        count = 0
        while count < LANES and first + count < 1 << level:
            times[count] = (first + count + 0.5) * width
            slots[count] = int(times[count] * KEPT)
            known[slots[count]] = True
            count += 1
        _place(tree, course, times, slots, count, frames, memory)
    return slot


@njit()
def _between(frames, low, high, a, b):
    """The poses of two links in each other's frames at two slots."""
    R, t = _nine(frames[low], a, 0), _three(frames[low], a, 9)
    S, s = _nine(frames[low], b, 0), _three(frames[low], b, 9)
    first = product(_transposed(R), S)
    there, back = apply_transposed(R, minus(s, t)), apply_transposed(S, minus(t, s))
    R, t = _nine(frames[high], a, 0), _three(frames[high], a, 9)
    S, s = _nine(frames[high], b, 0), _three(frames[high], b, 9)
    last = product(_transposed(R), S)
    onward, backward = apply_transposed(R, minus(s, t)), apply_transposed(S, minus(t, s))
    return _Sides(
        ((first, last), (_transposed(first), _transposed(last))), ((there, onward), (back, backward))
    )  # fmt: skip


# -- one interval -----------------------------------------------------------------------------


@njit()
def _compare_boxes(model, bodies, a, b, sides, need, scores):
    """Write by how much gaps of boxes along twelve axes, in the order of tokens, exceed the need; return the best."""
    M, N = _nine(model.turns, bodies[0], 0), _nine(model.turns, bodies[1], 0)
    c, d = _three(model.boxes, a, 0), _three(model.boxes, b, 0)
    for k in range(12):
        scores[k] = np.inf
    for end in range(2):
        R, t = (sides.turns[0][0], sides.shifts[0][0]) if end == 0 else (sides.turns[0][1], sides.shifts[0][1])
        axes = product(R, N)
        apart_ = minus(image(R, t, d), c)
        along, across = apply_transposed(M, apart_), apply_transposed(axes, apart_)
        cosines = product(_transposed(M), axes)
        for i in range(3):
            wide = tall = 0.0
            for j in range(3):
                wide += abs(cosines[3 * i + j]) * model.boxes[b, HALF + j]
                tall += abs(cosines[3 * j + i]) * model.boxes[a, HALF + j]
            wide, tall = wide + model.boxes[a, HALF + i] + need[0], tall + model.boxes[b, HALF + i] + need[1]
            scores[i], scores[3 + i] = min(scores[i], along[i] - wide), min(scores[3 + i], -along[i] - wide)
            scores[6 + i], scores[9 + i] = min(scores[6 + i], -across[i] - tall), min(scores[9 + i], across[i] - tall)
    return scores.argmax()


@njit(forceinline=False)
def _gaps(model, pair, clusters, sides, side, N):
    """Gaps at both ends along a normal N in the frame of the lower body."""
    n = apply(_nine(model.turns, pair.bodies[side], 0), N)
    length = np.sqrt(dot(n, n))
    if not length > 0.0:
        return -np.inf, -np.inf
    turns, shifts = sides.turns[side], sides.shifts[side]
    below = dot(support(model, clusters[side], n), n)
    m, k = negated(apply_transposed(turns[0], n)), negated(apply_transposed(turns[1], n))
    first = dot(shifts[0], n) - dot(support(model, clusters[1 - side], m), m) - below
    last = dot(shifts[1], n) - dot(support(model, clusters[1 - side], k), k) - below
    return first / length, last / length


@inline
def _axis(k):
    """Return the normal of token AXES + k."""
    sign = 1.0 if k % 6 < 3 else -1.0
    return sign * (k % 3 == 0), sign * (k % 3 == 1), sign * (k % 3 == 2)


@njit()
def rounded(n):
    """Round a direction to integers: among several multiples, choose the one that rounding turns least."""
    most = max(abs(n[0]), abs(n[1]), abs(n[2]))
    n = scaled(1.0 / max(most, 1e-300), n)
    unit = scaled(1.0 / max(np.sqrt(dot(n, n)), 1e-300), n)
    best, least = (0.0, 0.0, 0.0), np.inf
    for k in range(SCALES):
        scale = LARGEST * (1.0 - 0.5 * k / (SCALES - 1))
        whole = np.rint(scale * n[0]), np.rint(scale * n[1]), np.rint(scale * n[2])
        length = dot(whole, unit)
        off = minus(whole, scaled(length, unit))
        turned = dot(off, off) / max(length * length, 1e-300)
        if turned < least:
            best, least = whole, turned
    return best


@inline
def _is_short(N):
    """Return whether a normal is written with 16 bits per coordinate."""
    most = max(abs(N[0]), abs(N[1]), abs(N[2]))
    return most <= LARGEST and N[0] == np.rint(N[0]) and N[1] == np.rint(N[1]) and N[2] == np.rint(N[2])


@njit()
def _by_axes(model, pair, clusters, sides, need, room, scores):
    """Try the best axes; return the token, or -1, and by how much gaps exceeded margins and deviations."""
    spare = -np.inf, -np.inf
    for _ in range(BEST_AXES):
        k = scores.argmax()
        scores[k] = -np.inf
        side = k // 6
        first, last = _gaps(model, pair, clusters, sides, side, _axis(k))
        if min(first, last) > need[side] + room:
            return AXES + k, spare
        keep = pair.margin + pair.deviation[side]
        spare = max(spare[0], first - keep), max(spare[1], last - keep)
    return -1, spare


@inline
def _several(model, clusters):
    """Return whether one of two clusters has several pieces."""
    return model.clusters[clusters[0], LEFT_HALF] >= 0 or model.clusters[clusters[1], LEFT_HALF] >= 0


@njit()
def _search(model, pair, clusters, sides, need, limits, deep, state, spare, memory):
    """Search for a plane where boxes and axes have failed.

    Returns
    -------
    token : int
        Token of the plane; -1 if no plane was found.
    N : tuple of 3 float
    spare : tuple of 2 float
        The largest amounts by which the gaps at both ends exceeded margins and deviations.
    near : bool
        Whether no plane can separate these pieces at one of the ends.
    """
    row = pair.pair
    recent, old = int(state[row, RECENT]), _three(state, row, RECENT + 1)
    if dot(old, old) > 0.0:
        first, last = _gaps(model, pair, clusters, sides, recent, old)
        if min(first, last) > need[recent] + limits.room:
            return (NORMAL if _is_short(old) else DOUBLES) + recent, old, spare, False
    for at in range(GIVEN, state.shape[1], EACH):
        side, N = int(state[row, at]), _three(state, row, at + 1)
        keep = pair.margin + pair.deviation[side]
        first, last = _gaps(model, pair, clusters, sides, side, N)
        if min(first, last) > need[side] + limits.room:
            return (NORMAL if _is_short(N) else DOUBLES) + side, N, spare, False
        spare = max(spare[0], first - keep), max(spare[1], last - keep)
    favoured = 0 if need[0] <= need[1] else 1
    for turn in range(2):
        side = favoured if turn == 0 else 1 - favoured
        M, keep = _nine(model.turns, pair.bodies[side], 0), pair.margin + pair.deviation[side]
        lower_upper = clusters[side], clusters[1 - side]
        poses = sides.turns[side], sides.shifts[side]
        n = apply(M, old) if recent == side and dot(old, old) > 0.0 else poses[1][0]
        near, n = _direction(
            model, lower_upper, poses, 2, n, need[side], need[side] + limits.of_normals, limits.error, memory
        )
        if near:
            continue
        exact = apply_transposed(M, n)
        for doubles in range(2 if deep else 1):
            N = exact if doubles else rounded(exact)
            first, last = _gaps(model, pair, clusters, sides, side, N)
            if min(first, last) > need[side] + limits.room:
                for c in range(3):
                    state[row, RECENT + 1 + c] = N[c]
                state[row, RECENT] = side
                return (DOUBLES if doubles else NORMAL) + side, N, spare, False
            spare = max(spare[0], first - keep), max(spare[1], last - keep)
    # No plane was found for the interval, but a plane may exist at each end. For two single pieces, which cannot be
    # divided, this matters only at depth DEEP and below, or if the bodies do not move.
    if not (deep or _several(model, clusters)):
        return -1, old, spare, False
    side = 0 if pair.deviation[0] <= pair.deviation[1] else 1
    M, keep = _nine(model.turns, pair.bodies[side], 0), pair.margin + pair.deviation[side]
    turns, shifts = sides.turns[side], sides.shifts[side]
    for end in range(2):
        if spare[end] > limits.room:
            continue
        # Both poses are the pose at this end; `_direction` uses only the first one.
        poses = ((turns[end], turns[end]), (shifts[end], shifts[end]))
        near, n = _direction(
            model, (clusters[side], clusters[1 - side]), poses, 1, shifts[end], keep - limits.of_boxes,
            keep + limits.of_normals, limits.error, memory,
        )  # fmt: skip
        if near:
            return -1, old, spare, True
        first, last = _gaps(model, pair, clusters, sides, side, apply_transposed(M, n))
        spare = max(spare[0], first - keep), max(spare[1], last - keep)
    return -1, old, spare, False


@inline
def _divided(model, clusters, limits, deep, still, spare, near):
    """Return how to divide an interval without a plane; -1 if that would not help."""
    counts = (
        model.clusters[clusters[0], LAST] - model.clusters[clusters[0], FIRST],
        model.clusters[clusters[1], LAST] - model.clusters[clusters[1], FIRST],
    )
    stuck = near or min(spare[0], spare[1]) <= limits.room
    if _several(model, clusters):
        if stuck or deep:
            return FIRST_DIVIDED if counts[0] >= counts[1] else SECOND_DIVIDED
    elif near or still or (stuck and deep):
        return -1
    return HALVED


@njit()
def _settled(model, pair, clusters, sides, width, limits, deep, still, state, scores, memory):
    """Find a plane for an interval, or decide how to divide it: return the token, or -1, and the normal."""
    square = width * width / 8.0
    need = (
        SHARE * (pair.margin + pair.deviation[0] + pair.curvature[0] * square),
        SHARE * (pair.margin + pair.deviation[1] + pair.curvature[1] * square),
    )
    if not deep:
        # No gap is larger than the distance between any point of one cluster and any point of the other cluster.
        p, q = _three(model.boxes, clusters[0], INSIDE), _three(model.boxes, clusters[1], INSIDE)
        first = minus(image(sides.turns[0][0], sides.shifts[0][0], q), p)
        last = minus(image(sides.turns[0][1], sides.shifts[0][1], q), p)
        least, keep = min(need[0], need[1]), max(0.0, pair.margin + min(pair.deviation[0], pair.deviation[1]))
        if min(dot(first, first), dot(last, last)) < least * least and least > 2.0 * keep:
            return HALVED, (0.0, 0.0, 0.0)
    best = _compare_boxes(model, pair.bodies, clusters[0], clusters[1], sides, need, scores)
    if scores[best] > limits.of_boxes:
        return AXES + best, _axis(best)
    token, spare = _by_axes(model, pair, clusters, sides, need, limits.room, scores)
    if token >= 0:
        return token, _axis(token - AXES)
    token, N, spare, near = _search(model, pair, clusters, sides, need, limits, deep, state, spare, memory)
    if token < 0:
        token = _divided(model, clusters, limits, deep, still, spare, near)
    return token, N


# -- trees ------------------------------------------------------------------------------------


@njit()
def measure_model(handle):
    """Write the boxes around clusters, and the balls around bodies."""
    model = plane_model_of(handle)
    _write_boxes(model)
    _write_balls(model)


@njit()
def plane_trees(handle, tree_handle, course, speeds, room, state, tokens, normals):
    """Write the trees of all pairs for one motion.

    Parameters
    ----------
    handle, tree_handle : int
        Handles of a `records.PlaneModel` and of a `records.Tree`, which has no links if nothing moves.
    course : ndarray, shape (degree + 1, dof)
        Control points.
    speeds : ndarray, shape (joints, 4)
        Bounds on the joints' first and second derivatives, on their deviations, and on how far they slide.
    room : float
        Room by which gaps must exceed the required gaps, as a share of the size of the model.
    state : ndarray, shape (pairs, 8 + 4 k)
        For each pair: first the last normal and the plane that was written last, both kept from motion to motion; then
        k normals to try. Each normal comes after the side of the body in whose frame it is given. Margins may be
        negative; a negative margin allows overlaps that are less deep.
    tokens : ndarray of uint8
    normals : ndarray, shape (N, 3)
        `tokens` and `normals` receive the tokens, and the normals of all planes whose token is NORMAL or higher.

    Returns
    -------
    nodes, planes : int
        Numbers of tokens and normals that were written.
    pair : int
        A pair for which no tree was found, from the fraction `low` to `high` of the motion; -1 if all trees were found.
    low, high : float
    """
    model, tree = plane_model_of(handle), tree_of(tree_handle)
    links, still = len(tree.parent), len(tree.parent) == 0
    memory = np.empty(_WORDS)
    at = np.int64(memory.ctypes.data)
    frames, placed_slots = np.zeros((SLOTS, links + 1, POSE)), np.zeros(KEPT + 1, dtype=np.bool_)
    for slot in range(SLOTS):
        frames[slot, links, 0] = frames[slot, links, 4] = frames[slot, links, 8] = 1.0
    rows = np.empty(LANES, dtype=np.int64)
    for lane in range(LANES):
        rows[lane] = lane
    dof = course.shape[1]
    scratch = np.zeros((LANES, dof)), np.empty(workspace_size(links, dof)), rows
    times, slots = np.empty(LANES), np.empty(LANES, dtype=np.int64)
    times[0], times[1], slots[0], slots[1] = 0.0, 1.0, 0, KEPT
    _place(tree, course, times, slots, 2, frames, scratch)
    stack, ends = np.empty((2 * DEEPEST, 6), dtype=np.int64), np.empty((2 * DEEPEST, 2))
    scores, nodes, planes = np.empty(12), 0, 0
    size = _size(model, speeds)
    chain, levers = np.empty(len(model.ways), dtype=np.int64), np.empty(len(model.ways))
    limits = _Limits(room * size, BOX_ROOM * size, ROUNDED * size, position_error(size, UNIT_ROUNDOFF))
    for p in range(len(model.pairs)):
        a, b = model.pairs[p, 0], model.pairs[p, 1]
        A, V = _bends(model, speeds, a, b, chain, levers)
        B, U = _bends(model, speeds, b, a, chain, levers)
        pair = _Pair(p, (a, b), model.margins[p], (A, B), (V, U))
        count, low, high = 1, 0.0, 1.0
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = model.bodies[a, ROOT], model.bodies[b, ROOT], 0, KEPT
        stack[0, 4] = stack[0, 5] = 0
        ends[0, 0], ends[0, 1] = low, high
        while count > 0:
            count -= 1
            clusters, first, last = (stack[count, 0], stack[count, 1]), stack[count, 2], stack[count, 3]
            level, depth, low, high = stack[count, 4], stack[count, 5], ends[count, 0], ends[count, 1]
            sides = _between(frames, first, last, model.bodies[a, PLACED_BY], model.bodies[b, PLACED_BY])
            deep = still or depth >= DEEP
            token, N = _settled(model, pair, clusters, sides, high - low, limits, deep, still, state, scores, at)
            if token < 0 or depth == DEEPEST or nodes == len(tokens) or planes == len(normals):
                held(memory)
                return nodes, planes, p, low, high
            if token >= SAME:
                same = token >= NORMAL and state[p, NAMED] == token
                for c in range(3):
                    same = same and state[p, NAMED + 1 + c] == N[c]
                    state[p, NAMED + 1 + c] = N[c]
                    if token >= NORMAL:
                        normals[planes, c] = N[c]
                state[p, NAMED] = token
                planes += token >= NORMAL and not same
                token = SAME if same else token
            else:
                middle = first
                if token == HALVED:
                    middle = _slot_between(low, high, level, tree, course, placed_slots, frames, scratch)
                for part in range(1, -1, -1):  # The first part is pushed last, so that it is processed first.
                    ends[count, 0], ends[count, 1] = low, high
                    stack[count, 0], stack[count, 1] = clusters
                    stack[count, 2], stack[count, 3] = first, last
                    stack[count, 4], stack[count, 5] = level, depth + 1
                    if token == HALVED:
                        stack[count, 3 - part], ends[count, 1 - part] = middle, (low + high) / 2.0
                        stack[count, 4] = level + 1
                    else:
                        which = token - FIRST_DIVIDED
                        stack[count, which] = model.clusters[clusters[which], LEFT_HALF + part]
                    count += 1
            tokens[nodes] = token
            nodes += 1
    held(memory)
    return nodes, planes, -1, 0.0, 1.0
