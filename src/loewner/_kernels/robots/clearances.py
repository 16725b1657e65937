"""A smooth lower bound on a robot's distance from contact, and its gradient; gradients of the distances of pairs.

The bound is a soft minimum, -softness log Σ exp(-gap/softness), of the gaps between the outer ellipsoids of all pairs
of pieces, along their contact normals. It is less than the least gap. Eight configurations are processed side by side,
and pairs of pieces in runs. If a run has a new least gap, the previous sum is scaled. A pair whose gap exceeds the
least gap by more than FAR times the softness is ignored, because its term would be lost in rounding.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import OUTER_CENTER, OUTER_RADIUS, OUTER_SHAPE, OUTER_SIGMA, REACH
from loewner._kernels.elementary import decays, logarithm
from loewner._kernels.ellipsoids.contact_gap import contact_gap, contact_gap_wrench, contact_parameter
from loewner._kernels.linalg3 import (
    apply,
    apply_symmetric,
    cross,
    dot,
    minus,
    negated,
    plus,
    rotated_shape,
    scaled,
    selected,
)
from loewner._kernels.pieces.pack import pieces_of, problem_of
from loewner._kernels.robots.kinematics import link_entries, place_links, rotation_of_link, translation_of_link
from loewner._kernels.robots.placement import (
    DOF,
    LINKS,
    MOVING,
    MOVING_PIECES,
    STANDING,
    STANDING_PIECES,
    counts_of,
)
from loewner._kernels.robots.wrenches import WRENCH, clear, powers, push
from loewner._kernels.simd.memory import Arena, Place, floats, integers
from loewner._kernels.simd.vectors import (
    ALL,
    LANES,
    absolute,
    broadcast,
    load,
    minimum,
    movemask,
    select,
    sqrt,
    store,
)
from loewner._kernels.tolerances import UP

FAR = 40.0

# Allowance for rounding in the bounds that exclude pairs, relative to the bounds and to the lengths from which they are
# computed. The rounding errors are far smaller.
CAREFUL = 1e-9

RUN = 1024  # Maximum number of pairs of pieces in a run.

# Number of entries for an ellipsoid: its center, its shape matrix, and the sum of the lengths that determine both.
_ROW = 10
# Number of entries for a body: the mean of its ellipsoids' centers, the largest distance of a center from this mean,
# the largest and the smallest semi-axis, and the reach.
_BODY = 7
# Number of vectors for a body: the mean of the centers in the world, and the sum of the lengths that determine it.
_MIDDLE = 4
_ENTRY = 2  # Number of vectors for a pair of pieces in a run: the gap, and the s at the maximum of F.
_WHICH = 4  # Number of integers for a pair of pieces: the two bodies, and the two pieces.
_LEAST, _SUM, _TOTALS = 0, LANES, 2 * LANES


class _Memory(NamedTuple):
    """Scratch memory of a query."""

    links: Any
    rows: Any
    moving: Any
    standing: Any
    bodies: Any
    middles: Any
    wrenches: Any
    slopes: Any
    entries: Any
    which: Any
    totals: Any


MEMORY = Arena(
    _Memory,
    links=floats(link_entries(LINKS, DOF)),
    rows=integers(LANES),
    moving=floats(_ROW * LANES * MOVING_PIECES),
    standing=floats(_ROW * STANDING_PIECES),
    bodies=floats(_BODY * (MOVING + STANDING)),
    middles=floats(_MIDDLE * LANES * (MOVING + STANDING)),
    wrenches=floats(WRENCH * LANES * LINKS),
    slopes=floats(LANES * DOF),
    entries=floats(_ENTRY * LANES * RUN),
    which=integers(_WHICH * RUN),
    totals=floats(_TOTALS),
)
_memory_of, _size = MEMORY.whole(), MEMORY.sizing()


@njit()
def memory_of_clearances(pack, problem_handle, dof):
    """Number of scratch bytes for `clearances`."""
    return _size(counts_of(pieces_of(pack), problem_of(problem_handle), dof))


@inline
def _three_vectors(array, at):
    return load(array, at), load(array, at + LANES), load(array, at + 2 * LANES)


@inline
def _center_of(hot, piece):
    return hot[piece, OUTER_CENTER], hot[piece, OUTER_CENTER + 1], hot[piece, OUTER_CENTER + 2]


class _Ellipsoids(NamedTuple):
    """Ellipsoids of a piece at eight configurations, in the world; `size` is the sum of lengths for the center."""

    center: Any
    shape: Any
    size: Any


@inline
def _ellipsoids(to, piece, moving_pieces):
    """The ellipsoids of a piece."""
    if piece < moving_pieces:
        at = piece * (_ROW * LANES)
        return _Ellipsoids(
            _three_vectors(to.moving, at),
            _three_vectors(to.moving, at + 3 * LANES) + _three_vectors(to.moving, at + 6 * LANES),
            load(to.moving, at + 9 * LANES),
        )
    at, row = (piece - moving_pieces) * _ROW, to.standing
    return _Ellipsoids(
        (broadcast(row[at]), broadcast(row[at + 1]), broadcast(row[at + 2])),
        (
            broadcast(row[at + 3]), broadcast(row[at + 4]), broadcast(row[at + 5]),
            broadcast(row[at + 6]), broadcast(row[at + 7]), broadcast(row[at + 8]),
        ),
        broadcast(row[at + 9]),
    )  # fmt: skip


@inline
def _placed(hot, piece, R, t):
    """Ellipsoid of a piece in the world."""
    k = OUTER_SHAPE
    shape = hot[piece, k], hot[piece, k + 1], hot[piece, k + 2], hot[piece, k + 3], hot[piece, k + 4], hot[piece, k + 5]
    size = (absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + hot[piece, REACH]) * UP
    return _Ellipsoids(plus(apply(R, _center_of(hot, piece)), t), rotated_shape(R, shape), size)


@njit()
def _stand(pack, problem_handle, memory, dof):
    """Write the data for all configurations: ellipsoids of static bodies, and a ball about each body's centers."""
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    to = _memory_of(Place(memory, counts_of(pieces, problem, dof)))
    hot, piece_start, moving = pieces.hot, pieces.piece_start, problem.link.size
    for body in range(len(piece_start) - 1):
        first, last = piece_start[body], piece_start[body + 1]
        middle, away, widest, thinnest, reach = (0.0, 0.0, 0.0), 0.0, 0.0, np.inf, 0.0
        for piece in range(first, last):
            middle = plus(middle, scaled(1.0 / (last - first), _center_of(hot, piece)))
        for piece in range(first, last):
            r = minus(_center_of(hot, piece), middle)
            away, reach = max(away, math.sqrt(dot(r, r))), max(reach, hot[piece, REACH])
            widest, thinnest = max(widest, hot[piece, OUTER_RADIUS]), min(thinnest, hot[piece, OUTER_SIGMA])
        if body >= moving:
            T, k = problem.standing_poses, body - moving
            R = T[k, 0], T[k, 1], T[k, 2], T[k, 4], T[k, 5], T[k, 6], T[k, 8], T[k, 9], T[k, 10]
            t = T[k, 3], T[k, 7], T[k, 11]
            for piece in range(first, last):
                at = (piece - piece_start[moving]) * _ROW
                ellipsoid = _placed(hot, piece, R, t)
                for c in range(3):
                    to.standing[at + c] = ellipsoid.center[c]
                for c in range(6):
                    to.standing[at + 3 + c] = ellipsoid.shape[c]
                to.standing[at + 9] = ellipsoid.size
            middle = plus(apply(R, middle), t)
            for c in range(3):
                store(to.middles, (_MIDDLE * body + c) * LANES, broadcast(middle[c]))
            store(to.middles, (_MIDDLE * body + 3) * LANES, broadcast(abs(t[0]) + abs(t[1]) + abs(t[2]) + reach))
        at = body * _BODY
        for c in range(3):
            to.bodies[at + c] = middle[c]
        to.bodies[at + 3], to.bodies[at + 4], to.bodies[at + 5], to.bodies[at + 6] = away, widest, thinnest, reach


@inline
def _place_links(problem, to, Q, first, last):
    """Compute the poses of the links at the configurations first .. last, at most eight."""
    for lane in range(LANES):
        to.rows[lane] = min(first + lane, last)  # The last configuration fills unused lanes.
    place_links(problem.tree, Q, to.rows, 0, to.links)


@njit()
def _place(pack, problem_handle, memory, Q, first, last):
    """Place the moving bodies at the configurations first .. last, at most eight."""
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    to = _memory_of(Place(memory, counts_of(pieces, problem, Q.shape[1])))
    hot, piece_start = pieces.hot, pieces.piece_start
    _place_links(problem, to, Q, first, last)
    for body in range(problem.link.size):
        R, t = rotation_of_link(to.links, problem.link[body]), translation_of_link(to.links, problem.link[body])
        at = body * _BODY
        middle = plus(apply(R, (to.bodies[at], to.bodies[at + 1], to.bodies[at + 2])), t)
        lengths = absolute(t[0]) + absolute(t[1]) + absolute(t[2]) + to.bodies[at + 6]
        for c in range(3):
            store(to.middles, (_MIDDLE * body + c) * LANES, middle[c])
        store(to.middles, (_MIDDLE * body + 3) * LANES, lengths)
        for piece in range(piece_start[body], piece_start[body + 1]):
            at, ellipsoid = piece * (_ROW * LANES), _placed(hot, piece, R, t)
            for c in range(3):
                store(to.moving, at + c * LANES, ellipsoid.center[c])
            for c in range(6):
                store(to.moving, at + (3 + c) * LANES, ellipsoid.shape[c])
            store(to.moving, at + 9 * LANES, ellipsoid.size)


@inline
def _all_far(growth, thinnest, lengths, cut):
    """Return whether gaps exceed the cut at all eight configurations, given the growth at which ellipsoids touch.

    A gap is the sum of both widths along the normal, times the growth minus one, and no width is below a semi-axis. For
    ellipsoids that may overlap, the growth decides nothing.
    """
    gap = (growth - 1.0) * (thinnest * (1.0 - CAREFUL))
    return movemask((gap > cut + CAREFUL * lengths) & (gap > CAREFUL * lengths)) == ALL


@inline
def _bodies_far(to, a, b, cut):
    """Return whether all gaps between the pieces of two bodies exceed the cut at all eight configurations."""
    at, of = a * (_MIDDLE * LANES), b * (_MIDDLE * LANES)
    r = minus(_three_vectors(to.middles, of), _three_vectors(to.middles, at))
    lengths = load(to.middles, at + 3 * LANES) + load(to.middles, of + 3 * LANES)
    at, of = a * _BODY, b * _BODY
    growth = (sqrt(dot(r, r)) - (to.bodies[at + 3] + to.bodies[of + 3])) * (
        1.0 / (to.bodies[at + 4] + to.bodies[of + 4])
    )
    return _all_far(growth, to.bodies[at + 5] + to.bodies[of + 5], lengths, cut)


@inline
def _pieces_far(a, b, r, thinnest, cut):
    """Return whether the gaps of two pieces exceed the cut at all eight configurations.

    Two ellipsoids touch at a growth of at least |r| divided by the sum of their widths along r (Cauchy-Schwarz).
    """
    widths = sqrt(dot(apply_symmetric(a.shape, r), r)) + sqrt(dot(apply_symmetric(b.shape, r), r))
    return _all_far(dot(r, r) / widths, thinnest, a.size + b.size, cut)


@njit()
def _sum_up(count, gradient, softness, pack, problem_handle, memory, dof):
    """Add a run of pairs of pieces to the previous sum."""
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    to = _memory_of(Place(memory, counts_of(pieces, problem, dof)))
    moving, moving_pieces = problem.link.size, pieces.piece_start[problem.link.size]
    before = load(to.totals, _LEAST)
    least = before
    for k in range(count):
        least = minimum(load(to.entries, k * (_ENTRY * LANES)), least)
    store(to.totals, _LEAST, least)
    scale = decays((least - before) / softness)  # The previous sum was relative to the previous least gap.
    total = load(to.totals, _SUM) * scale
    if gradient:
        for k in range(WRENCH * problem.tree.parent.size):
            store(to.wrenches, k * LANES, load(to.wrenches, k * LANES) * scale)
    for k in range(count):
        above = (load(to.entries, k * (_ENTRY * LANES)) - least) / softness
        counts = above < FAR
        if movemask(counts) == 0:
            continue
        weight = select(counts, decays(-above), 0.0)
        total = total + weight
        if gradient:
            body_a, body_b = to.which[_WHICH * k], to.which[_WHICH * k + 1]
            a = _ellipsoids(to, to.which[_WHICH * k + 2], moving_pieces)
            b = _ellipsoids(to, to.which[_WHICH * k + 3], moving_pieces)
            s = load(to.entries, k * (_ENTRY * LANES) + LANES)
            force, torque = contact_gap_wrench(a.shape, b.shape, minus(b.center, a.center), s)
            defined = counts & (dot(force, force) < np.inf)
            none = broadcast(0.0), broadcast(0.0), broadcast(0.0)
            force = selected(defined, scaled(weight, force), none)
            moment = selected(defined, plus(cross(b.center, force), scaled(weight, torque)), none)
            push(to.wrenches, problem.link[body_a], negated(force), negated(moment))
            if body_b < moving:
                push(to.wrenches, problem.link[body_b], force, moment)
    store(to.totals, _SUM, total)


@njit()
def clearances(gradient, softness, start, stop, Q, pack, problem_handle, memory, lower, slopes):
    """Write the soft minimum of the gaps at the configurations start .. stop, and its gradient.

    Parameters
    ----------
    gradient : bool
        Whether `slopes` is written.
    softness : float
        Softness in metres; positive.
    Q : ndarray, shape (N, dof)
    pack, problem_handle : int
        Documented in `configurations.check_configurations`; at least one pair is required.
    memory : int
        Address of `memory_of_clearances()` scratch bytes; only one thread may use them at a time.
    lower : ndarray, shape (N,)
        Receives the bounds, which are not finite where positions overflow.
    slopes : ndarray, shape (N, dof)
    """
    dof = Q.shape[1]
    pieces, problem = pieces_of(pack), problem_of(problem_handle)
    to = _memory_of(Place(memory, counts_of(pieces, problem, dof)))
    hot, piece_start, links = pieces.hot, pieces.piece_start, problem.tree.parent.size
    moving_pieces = piece_start[problem.link.size]
    _stand(pack, problem_handle, memory, dof)
    for first in range(start, stop, LANES):
        last = min(first + LANES, stop) - 1
        _place(pack, problem_handle, memory, Q, first, last)
        near = broadcast(np.inf)
        store(to.totals, _LEAST, near)
        store(to.totals, _SUM, broadcast(0.0))
        clear(to.wrenches, WRENCH * links)
        count = run = passed = 0
        for p in range(len(problem.pairs)):
            one, other = problem.pairs[p, 0], problem.pairs[p, 1]
            if _bodies_far(to, one, other, near + FAR * softness):
                passed += (piece_start[one + 1] - piece_start[one]) * (piece_start[other + 1] - piece_start[other])
                continue
            for i in range(piece_start[one], piece_start[one + 1]):
                for j in range(piece_start[other], piece_start[other + 1]):
                    # Pairs that are excluded also count towards the RUN pairs of a run. Where a run ends therefore does
                    # not depend on the configurations of a group, which together determine the excluded pairs.
                    if passed // RUN > run:
                        _sum_up(count, gradient, softness, pack, problem_handle, memory, dof)
                        count, run = 0, passed // RUN
                    passed += 1
                    a, b = _ellipsoids(to, i, moving_pieces), _ellipsoids(to, j, moving_pieces)
                    r = minus(b.center, a.center)
                    if _pieces_far(a, b, r, hot[i, OUTER_SIGMA] + hot[j, OUTER_SIGMA], near + FAR * softness):
                        continue
                    s = contact_parameter(a.shape, b.shape, r)
                    gap = contact_gap(a.shape, b.shape, r, s, a.size + b.size)
                    near = minimum(gap, near)
                    store(to.entries, count * (_ENTRY * LANES), gap)
                    store(to.entries, count * (_ENTRY * LANES) + LANES, s)
                    at = _WHICH * count
                    to.which[at], to.which[at + 1], to.which[at + 2], to.which[at + 3] = one, other, i, j
                    count += 1
        if count > 0:
            _sum_up(count, gradient, softness, pack, problem_handle, memory, dof)
        if gradient:
            powers(problem.tree, to.links, to.wrenches, dof, to.slopes)
        for lane in range(last + 1 - first):
            total = to.totals[_SUM + lane]
            # The bound is at most the least gap: a term of the sum is 1, so the logarithm of the sum is not negative.
            lower[first + lane] = to.totals[_LEAST + lane] - softness * logarithm(total)
            if gradient:
                for k in range(dof):
                    slopes[first + lane, k] = to.slopes[k * LANES + lane] / total


@njit()
def pair_gradients(start, stop, Q, pack, problem_handle, memory, bodies, force, point, slopes):
    """Write the gradients of one pair's distance at each of the configurations start .. stop.

    Parameters
    ----------
    Q : ndarray, shape (N, dof)
    pack, problem_handle, memory : int
        Documented in `clearances`.
    bodies : ndarray of int64, shape (N, 2)
        Indices of the pair's bodies.
    force, point : ndarray, shape (N, 3)
        The gradient for a motion of the second body, as a force at a point in the world.
    slopes : ndarray, shape (N, dof)
    """
    dof, problem = Q.shape[1], problem_of(problem_handle)
    to = _memory_of(Place(memory, counts_of(pieces_of(pack), problem, dof)))
    for first in range(start, stop, LANES):
        last = min(first + LANES, stop) - 1
        _place_links(problem, to, Q, first, last)
        clear(to.wrenches, WRENCH * problem.tree.parent.size)
        for k in range(first, last + 1):
            f = force[k, 0], force[k, 1], force[k, 2]
            m = cross((point[k, 0], point[k, 1], point[k, 2]), f)
            for side in range(2):
                if bodies[k, side] < problem.link.size:
                    at = problem.link[bodies[k, side]] * (WRENCH * LANES) + k - first
                    sign = 2.0 * side - 1.0
                    for c in range(3):
                        to.wrenches[at + c * LANES] += sign * f[c]
                        to.wrenches[at + (3 + c) * LANES] += sign * m[c]
        powers(problem.tree, to.links, to.wrenches, dof, to.slopes)
        for lane in range(last + 1 - first):
            for k in range(dof):
                slopes[first + lane, k] = to.slopes[k * LANES + lane]
