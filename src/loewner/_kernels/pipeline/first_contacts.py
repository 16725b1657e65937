"""First contacts of pairs of bodies that move and turn: proven time steps, and the first time of contact.

A step is proven by planes at its two ends, see docs/certified.md, "First contact". The normal turns from one plane to
the other, and the gap lost in between is of second order in the step. Near contact, the steps therefore converge
quadratically. Times are fractions of the motion.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import AMBIGUOUS, APART, COLLIDING, FREE, NEAREST, OVERLAPPING, TOUCHING
from loewner._kernels.columns import OUTER_CENTER, OUTER_RADIUS, REACH
from loewner._kernels.elementary import arc_tangent
from loewner._kernels.ellipsoids.signed_distance import is_round, round_distance
from loewner._kernels.linalg3 import (
    apply,
    cross,
    dot,
    matrix,
    minus,
    negated,
    one_norm,
    plus,
    product,
    scaled,
    turned,
)
from loewner._kernels.narrow import epa_fast
from loewner._kernels.narrow.gjk_fast import MEMORY as SEARCH
from loewner._kernels.narrow.gjk_fast import begin, measure_along, result_of, vertices_of
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error, run, swollen_radii
from loewner._kernels.narrow.surface_boxes import is_surface
from loewner._kernels.narrow.surface_distance import surface_distance
from loewner._kernels.narrow.surface_meets import surface_pair
from loewner._kernels.narrow.surface_walk import SIZE as SURFACE_SIZE
from loewner._kernels.pieces.pack import pieces_of, placed, shift_between
from loewner._kernels.pieces.shapes import placed_support, radius, rotation_of
from loewner._kernels.pipeline.verdicts import row_of
from loewner._kernels.simd.memory import Arena, floats, integers, raw
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees import piece_tree

# The position of a placed point has two errors. The first is due to the rotation of the body, and is proportional to
# the distance of the point from the body's origin. The second is the error of the origin itself, and is proportional to
# the coordinates of the origin at the start and at the end.
TURN_ROUNDINGS = 256.0 * UNIT_ROUNDOFF  # certified.md B58
PLACE_ROUNDINGS = 16.0 * UNIT_ROUNDOFF  # certified.md B59

# Fraction by which bounds on rates are raised, to allow for a few dozen roundings, and for poses that are accepted as
# rigid although they stretch paths slightly.
STRETCH = 1e-5  # certified.md B60
UPWARD = 1.0 + STRETCH

# Limit on the cosine of half the angle of a turn. A turn with a smaller cosine is nearly half a turn and is rejected,
# because poses that were stored as float32 may not determine which way around is shorter.
NEARLY_HALF_TURN = 1e-6

ROUNDS = 256  # Maximum number of rounds. Hulls need seven; only motions that graze within the tolerance need all.

# The length of a step is chosen as if the curvature were SHARE times its bound. The exact share matters little: with
# 0.3 or 0.6, 2 % more rounds are needed. A step that is not proven is shortened: it is multiplied by at most REDUCED,
# and by at least LEAST unless the gap at its start requires an even shorter step, see `_reduced`.
SHARE, LEAST, REDUCED = 0.4, 0.3, 0.8
# If a step is not proven, the search goes back from the end of this step. It goes back by this fraction of the longest
# step that the plane at this end may prove, see `_reduced`.
REACHED = 0.5

# The last step but one ends so shortly before the expected contact that, at full speed, the bodies would approach each
# other by BEFORE times the tolerance until the contact. The last step is so short that, at full speed, they would
# approach each other by at most LAST times the tolerance between the two returned times.
BEFORE, LAST = 0.25, 0.9

SURFACE_SHARE = 0.95  # For surfaces: the length of a step, relative to the longest step that the speed allows.
NEAR = 1e-9  # Fraction of a surface's distance that is reserved for rounding; it is raised until the rest is proven.

# Columns of an array of motions, which has one row for each body. The rotation at time 0 is split into a constant part,
# a sine part and a cosine part. The further columns hold the origin at time 0 and its displacement, the angular
# velocity, the axis in the frame of the body, the angle, and the sum of the absolute coordinates of the origin at both
# ends.
REST, SINE, COSINE, START, WAY, SPIN, AXIS, ANGLE, SIZE, MOTION = 0, 9, 18, 27, 30, 33, 36, 39, 40, 41

FOUND = 64  # Maximum number of piece pairs that the trees return at a time.

MEMORY = Arena(
    poses=floats(2, 4, 4), motions=floats(2, MOTION), search=SEARCH, faces=floats(epa_fast.FLOATS),
    edges=integers(epa_fast.INTEGERS), surfaces=raw(SURFACE_SIZE), steps=integers(piece_tree.STEPS),
    numbers=floats(piece_tree.NUMBERS), found=integers(2, FOUND),
)  # fmt: skip
_BYTES = MEMORY.size()
(search_at, surfaces_at), (poses_of, motions_of, faces_of, edges_of, steps_of, numbers_of, found_of) = (
    MEMORY.addresses("search surfaces"),
    MEMORY.accessors("poses motions faces edges steps numbers found"),
)


@inline
def _three(row, at):
    return row[at], row[at + 1], row[at + 2]


@inline
def _nine(row, at):
    return (*_three(row, at), *_three(row, at + 3), *_three(row, at + 6))


@njit()
def write_motion(first, last, poses, row, motion):
    """Write the motion between two poses, and the pose at time 0; return False if neither way to turn is shorter."""
    R, S = matrix(first), matrix(last)
    for c in range(3):
        poses[row, 3, c] = 0.0
        motion[START + c], motion[WAY + c] = first[c, 3], last[c, 3] - first[c, 3]
    poses[row, 3, 3] = 1.0
    motion[SIZE] = one_norm(_three(motion, START)) + abs(last[0, 3]) + abs(last[1, 3]) + abs(last[2, 3])
    # Compute the quaternion of R'S, starting with its largest component (Shepperd's method).
    m = product((R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]), S)
    same = True
    for c in range(9):
        same = same and R[c] == S[c]
    traces = m[0] + m[4] + m[8], m[0] - m[4] - m[8], m[4] - m[0] - m[8], m[8] - m[0] - m[4]
    if traces[0] >= traces[1] and traces[0] >= traces[2] and traces[0] >= traces[3]:
        w, v = 1.0 + traces[0], (m[7] - m[5], m[2] - m[6], m[3] - m[1])
    elif traces[1] >= traces[2] and traces[1] >= traces[3]:
        w, v = m[7] - m[5], (1.0 + traces[1], m[1] + m[3], m[2] + m[6])
    elif traces[2] >= traces[3]:
        w, v = m[2] - m[6], (m[1] + m[3], 1.0 + traces[2], m[5] + m[7])
    else:
        w, v = m[3] - m[1], (m[2] + m[6], m[5] + m[7], 1.0 + traces[3])
    if w < 0.0:
        w, v = -w, negated(v)
    sine = np.sqrt(dot(v, v))
    if not w > NEARLY_HALF_TURN * np.sqrt(sine * sine + w * w):
        return False
    axis, angle = (0.0, 0.0, 1.0), 0.0
    if sine > 0.0 and not same:
        # Compute the angle from the tangent of a quarter of the angle.
        axis, angle = scaled(1.0 / sine, v), 4.0 * arc_tangent(sine, w + np.sqrt(sine * sine + w * w))
    # The rotation is R exp(a [k]) = R k k' + sin(a) R [k] + cos(a) (R - R k k').
    k, Rk = axis, apply(R, axis)
    rest = (
        Rk[0] * k[0], Rk[0] * k[1], Rk[0] * k[2], Rk[1] * k[0], Rk[1] * k[1], Rk[1] * k[2],
        Rk[2] * k[0], Rk[2] * k[1], Rk[2] * k[2],
    )  # fmt: skip
    across = product(R, (0.0, -k[2], k[1], k[2], 0.0, -k[0], -k[1], k[0], 0.0))
    for c in range(9):
        motion[REST + c], motion[SINE + c], motion[COSINE + c] = rest[c], across[c], R[c] - rest[c]
    for c in range(3):
        motion[SPIN + c], motion[AXIS + c] = angle * Rk[c], axis[c]
    motion[ANGLE] = angle
    for r in range(3):
        for c in range(3):
            poses[row, r, c] = first[r, c]
    return True


@njit()
def _place(motions, t, poses):
    """Write the poses of both bodies at time t."""
    for row in range(2):
        _place_one(motions[row], t, poses, row)


@inline
def _place_one(motion, t, poses, row):
    angle = t * motion[ANGLE]
    if motion[ANGLE] != 0.0:
        sine, cosine = sine_cosine(angle)
        R = turned(_nine(motion, REST), sine, _nine(motion, SINE), cosine, _nine(motion, COSINE))
        for c in range(3):
            poses[row, 0, c], poses[row, 1, c], poses[row, 2, c] = R[c], R[3 + c], R[6 + c]
    for c in range(3):
        poses[row, c, 3] = motion[START + c] + t * motion[WAY + c]


@inline
def arm_of(P, motion):
    """Upper bound on the distance between any point of a core and the axis about which its body turns."""
    table, p = P.table, P.piece
    r = radius(P)
    c = table[p, OUTER_CENTER], table[p, OUTER_CENTER + 1], table[p, OUTER_CENTER + 2]
    off = cross(_three(motion, AXIS), c)
    rounding = 8.0 * UNIT_ROUNDOFF * table[p, REACH]
    around = np.sqrt(dot(off, off)) + max(table[p, OUTER_RADIUS] - r, 0.0) + rounding
    return min(around, max(table[p, REACH] - r, 0.0) + rounding)


@inline
def rates_between(way_a, arm_a, way_b, arm_b):
    """Bounds on the velocity and acceleration of any point of one body relative to any point of the other body."""
    v = minus(_three(way_b, WAY), _three(way_a, WAY))
    speed = np.sqrt(dot(v, v)) + way_a[ANGLE] * arm_a + way_b[ANGLE] * arm_b
    bend = way_a[ANGLE] * way_a[ANGLE] * arm_a + way_b[ANGLE] * way_b[ANGLE] * arm_b
    return speed * UPWARD, bend * UPWARD


@inline
def _nearing_speed(A, way_a, B, way_b):
    """Bound on the rate at which the distance of two pieces changes.

    If both nearest points turned with one body, they would move alike along the line between them. Therefore, the point
    nearer to the axis counts. For example, points of a turning floor that are far from the other body do not count.
    """
    table_a, table_b = A.table, B.table
    reach_a, reach_b = table_a[A.piece, REACH], table_b[B.piece, REACH]
    between = minus(_three(way_b, START), _three(way_a, START))
    then = plus(between, minus(_three(way_b, WAY), _three(way_a, WAY)))
    apart = np.sqrt(max(dot(between, between), dot(then, then)))
    # Poses that are accepted as rigid may stretch lengths slightly. If a stretched frame turns, the two nearest points
    # do not move exactly alike.
    stretch = STRETCH * (apart + reach_a + reach_b)
    arm_a = min(arm_of(A, way_a), apart + reach_b + stretch)
    arm_b = min(arm_of(B, way_b), apart + reach_a + stretch)
    speed, _ = rates_between(way_a, arm_a, way_b, arm_b)
    return speed


@inline
def lost_between(speed, bend, change, w):
    """Largest loss of a gap during a step w between planes whose unit normals differ by `change`."""
    return (bend * w + 2.0 * change * speed) * w / 8.0


@inline
def _middle(P):
    """Center of the outer ellipsoid in world axes, relative to the translation of its body."""
    table, p = P.table, P.piece
    return apply(rotation_of(P), (table[p, OUTER_CENTER], table[p, OUTER_CENTER + 1], table[p, OUTER_CENTER + 2]))


@njit()
def _touch_with_care(A, B, shift, n, margin):
    """Return whether two convex pieces touch according to the robust search."""
    status, _, _, _ = run(A, B, shift, n, margin, True, np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3))
    return status == TOUCHING


@njit()
def _gap_along(A, B, shift, n, error):
    """Proven lower bound on the gap between two cores along a unit vector, and the points that attain it."""
    a, b = placed_support(A, n), placed_support(B, negated(n))
    return dot(n, minus(plus(b, shift), a)) - error, a, b


@njit()
def _look_at_surface(A, B, n, margin, far, memory):
    """Do the work of `_look` if one or both of the pieces are surfaces."""
    result, work = result_of(search_at(memory)), surfaces_at(memory)
    shift, radii = shift_between(A, B), radius(A) + radius(B)
    verdict, _ = surface_pair(A, B, margin + radii, far, work, work, 0)
    if verdict != FREE:
        return verdict == COLLIDING, n, -np.inf, np.inf, n, n
    size, error = lengths(A, B, shift), rounding_error(A, B, shift)
    value, _ = surface_distance(A, B, n, 2.0 * size, faces_of(memory), edges_of(memory), work, result)
    # A verdict FREE proves `keep`, which is slightly smaller than the distance. If faces are parallel, only a still
    # smaller distance can be proven.
    share, keep, verdict = NEAR, 0.0, AMBIGUOUS
    while verdict != FREE and share < 1.0:
        keep = min(value, 2.0 * size) * (1.0 - share) - 4.0 * error
        if not keep > far:
            return False, n, -np.inf, value - margin - radii, n, n
        verdict, _ = surface_pair(A, B, keep, keep, work, work, 0)
        share *= 1000.0
    b = minus((result[6], result[7], result[8]), shift)
    above = value - margin - radii
    return False, _three(result, 0), keep - far if verdict == FREE else -np.inf, above, _three(result, 3), b


@njit()
def _look(A, B, n, margin, far, memory):
    """Return whether two pieces come within the margin, and a plane between them.

    Parameters
    ----------
    A, B : Placed
    n : tuple of 3 float
        First direction, from A to B.
    margin, far : float
        The margin, and a distance: if cores are farther apart than `far`, the pieces are not within the margin.

    Returns
    -------
    meets : bool
    n : tuple of 3 float
        Unit normal of the plane.
    gap : float
        Proven lower bound on the distance of the cores, less `far`; for convex pieces, on the gap along n.
    above : float
        Upper bound on the distance of the pieces, less the margin.
    at_a, at_b : tuple of 3 float
        The nearest points, each relative to the translation of its body.
    """
    if is_surface(A) or is_surface(B):
        return _look_at_surface(A, B, n, margin, far, memory)
    shift = shift_between(A, B)
    error = rounding_error(A, B, shift)
    radii = radius(A) + radius(B)
    W, result = vertices_of(search_at(memory)), result_of(search_at(memory))
    meets, above = False, np.inf
    if is_round(A) and is_round(B) and radii == 0.0:
        value, gap = round_distance(A, B, n, lengths(A, B, shift), result)
        meets, above, n = value + gap <= margin, value + gap - margin, _three(result, 0)
    else:
        ends = begin(A, B, shift, W)
        status, _, length, n = measure_along(A, B, shift, W, ends, n, error, margin + radii, np.inf, result)
        meets, above = status in (TOUCHING, OVERLAPPING), length - radii - margin
        if status == NEAREST:
            gap, _, _ = _gap_along(A, B, shift, n, error)
            b = minus((result[6], result[7], result[8]), shift)
            return False, n, gap - far, above, _three(result, 3), b
        if not meets and status != APART:
            meets = _touch_with_care(A, B, shift, n, margin)
    gap, a, b = _gap_along(A, B, shift, n, error)
    return meets, n, gap - far, above, a, b


@inline
def _nearing(way_a, way_b, n, at_a, at_b):
    """Return the speed at which two points approach each other along n."""
    a = plus(_three(way_a, WAY), cross(_three(way_a, SPIN), at_a))
    b = plus(_three(way_b, WAY), cross(_three(way_b, SPIN), at_b))
    return dot(n, minus(a, b))


@inline
def _turned(n, m):
    """Bound on the difference of two unit normals."""
    off = minus(n, m)
    return np.sqrt(dot(off, off)) + 16.0 * UNIT_ROUNDOFF


@inline
def _reduced(w, gap, nearing, low, curve):
    """Shorten a step w that lost curve w² and is not proven, so that both parts of the step are likely to be proven.

    `low` is the gap at the end of the step. The plane there is likely to prove the last part of the step if the loss in
    that part, which is curve times the square of the part's length, is less than `low`.
    """
    most = min(REDUCED * w, 0.9 * _root(gap, nearing, curve))
    return min(max(w - REACHED * np.sqrt(max(low, 0.0) / curve), LEAST * w), most)


@inline
def _root(gap, nearing, curve):
    """Length of the step after which the gap, closing at the rate `nearing`, is curve times the step's square."""
    below = nearing + np.sqrt(nearing * nearing + 4.0 * curve * gap)
    return 2.0 * gap / below if below > 0.0 else np.inf


@njit()
def _between_pieces(A, B, horizon, margin, tolerance, memory):
    """Follow two pieces until the time `horizon`; if this is less than 1, the bodies are known to touch then.

    Returns
    -------
    verdict : int
    free_until : float
        The pieces are proven free before this time. If the verdict is FREE, this time is `horizon`, or slightly less.
    touching_at : float
        A time at which the pieces touch; inf if none is known.
    rounds : int
    """
    poses, motions = poses_of(memory), motions_of(memory)
    way_a, way_b = motions[0], motions[1]
    arm_a, arm_b = arm_of(A, way_a), arm_of(B, way_b)
    speed, bend = rates_between(way_a, arm_a, way_b, arm_b)
    reaches = A.table[A.piece, REACH] + B.table[B.piece, REACH]
    slack = TURN_ROUNDINGS * reaches + PLACE_ROUNDINGS * (way_a[SIZE] + way_b[SIZE])
    # An error in a rotation also stretches the rounding radii of the pieces.
    far = margin + swollen_radii(A, B) * (1.0 + TURN_ROUNDINGS) + slack
    surface = is_surface(A) or is_surface(B)
    if surface:  # For surfaces, only this speed can prove a step, see `_nearing_speed`.
        speed = _nearing_speed(A, way_a, B, way_b)
    t, at, hit, turning = 0.0, 0.0, np.inf, 0.0
    gap, above, nearing, normal = np.inf, np.inf, 0.0, (0.0, 0.0, 0.0)
    # Keep the plane at the end of the last step that was not proven. From a later t, this plane often proves the step
    # to the same end.
    later, later_gap, later_above, later_nearing, later_normal = np.inf, 0.0, np.inf, 0.0, normal
    _place(motions, 0.0, poses)
    n = minus(plus(shift_between(A, B), _middle(B)), _middle(A))
    for r in range(ROUNDS):
        w = at - t
        if r > 0:
            _place(motions, at, poses)
            if at >= horizon and not surface:  # The current plane often proves the rest of the motion.
                shift = shift_between(A, B)
                low, _, _ = _gap_along(A, B, shift, normal, rounding_error(A, B, shift))
                if min(gap, low - far) > lost_between(speed, bend, 0.0, w):
                    return FREE, horizon, np.inf, r
            n = normal
        meets, n, low, top, at_a, at_b = _look(A, B, n, margin, far, memory)
        proven, curve, rate = False, 0.0, _nearing(way_a, way_b, n, at_a, at_b)
        if meets:
            hit = at
        else:
            proven = min(gap, low) > 0.0 and gap + low > speed * w
            if not surface and r > 0:
                change = _turned(n, normal)
                lost = lost_between(speed, bend, change, w)
                proven = proven or min(gap, low) > lost
                # Curvature that explains two losses: the loss that the bounds allow during the step, and the amount by
                # which the gap at the end is smaller than predicted.
                curve = (lost + max(gap - nearing * w - low, 0.0)) / (w * w)
                if proven:
                    turning = change / w
                else:
                    later, later_gap, later_above, later_nearing, later_normal = at, low, top, rate, n
        if proven:
            t, gap, above, nearing, normal = at, low, top, rate, n
            if t < later < hit:
                change, w = _turned(later_normal, normal), later - t
                if min(gap, later_gap) > lost_between(speed, bend, change, w):
                    t, gap, above, nearing, normal = later, later_gap, later_above, later_nearing, later_normal
                    later, turning = np.inf, change / w
            if t >= horizon or gap > speed * (horizon - t):
                return FREE, horizon, np.inf, r
        elif r == 0:
            break
        # Even at full speed, the gap does not close before t + gap / speed.
        if (hit - t) * speed - gap <= tolerance:
            return COLLIDING, min(t + gap / speed, hit), hit, r
        # Even at full speed, the bodies approach each other by no more than the tolerance between t and the known
        # contact.
        if horizon < 1.0 and (horizon - t) * speed <= tolerance:
            return FREE, min(t + gap / speed, horizon), np.inf, r
        if proven:
            w = _root(gap, nearing, SHARE * (bend + 2.0 * turning * speed))
            if surface:
                w = SURFACE_SHARE * 2.0 * gap / (speed + nearing)
            if nearing > 0.0:
                due, before = gap / nearing, BEFORE * tolerance / speed
                last = (LAST * tolerance + gap) / speed
                # Step past the expected contact, but by no more than the time that remains until this contact. If a
                # search cannot settle a contact of such a small depth, it can settle a contact that is closer to
                # touching.
                w = min(0.5 * (due + last), 2.0 * due) if due + before <= last else min(w, due - before)
        else:
            w = _reduced(w, gap, nearing, low, curve) if curve > 0.0 else 0.5 * w
        at = min(t + w, horizon)
        if at >= hit:
            at = 0.5 * (t + hit)
        if not t < at < hit:
            break
    if hit == 0.0:
        return COLLIDING, 0.0, 0.0, 0
    if hit == np.inf and above <= tolerance:
        hit = t
    return AMBIGUOUS, t, hit, ROUNDS


@njit()
def _between_bodies(a, ia, b, ib, margin, tolerance, memory):
    """Follow two bodies, whose motions are in memory, as `_between_pieces` follows two pieces."""
    poses, motions = poses_of(memory), motions_of(memory)
    first_a, first_b = a.piece_start[ia], b.piece_start[ib]
    if a.piece_start[ia + 1] - first_a == 1 and b.piece_start[ib + 1] - first_b == 1:
        A, B = placed(a, first_a, poses, 0), placed(b, first_b, poses, 1)
        return _between_pieces(A, B, 1.0, margin, tolerance, memory)
    steps, numbers, pieces = steps_of(memory), numbers_of(memory), found_of(memory)
    far_a = far_b = 0.0
    for i in range(first_a, a.piece_start[ia + 1]):
        far_a = max(far_a, a.table[i, REACH])
    for j in range(first_b, b.piece_start[ib + 1]):
        far_b = max(far_b, b.table[j, REACH])
    speed, _ = rates_between(motions[0], far_a, motions[1], far_b)
    slack = TURN_ROUNDINGS * (far_a + far_b) + PLACE_ROUNDINGS * (motions[0, SIZE] + motions[1, SIZE])
    # Start with the pieces that are near each other halfway through the motion, because these are likely to meet.
    _place(motions, 0.5, poses)
    piece_tree.begin(a, ia, poses, 0, b, ib, poses, 1, steps, numbers)
    verdict, free, touching, horizon, rounds = FREE, np.inf, np.inf, 1.0, 0
    while horizon > 0.0:
        count = piece_tree.more(a, b, ib, margin + 0.5 * speed + slack, steps, numbers, pieces[0], pieces[1])
        if count == 0:
            break
        for c in range(count):
            A, B = placed(a, pieces[0, c], poses, 0), placed(b, pieces[1, c], poses, 1)
            result, until, hit, r = _between_pieces(A, B, horizon, margin, tolerance, memory)
            free, rounds = min(free, until), rounds + r
            if result != FREE:
                verdict, touching = result, min(touching, hit)
                horizon = min(horizon, hit if result == COLLIDING else until)
    return verdict, free, touching, rounds


@njit()
def memory_of_first_contacts():
    """Number of bytes of memory for `first_contacts`."""
    return _BYTES


@njit()
def first_contacts(start, stop, plan, pack_a, Ta0, Ta1, pack_b, Tb0, Tb1, margin, tolerance, memory, times, verdicts):
    """Find the first contacts of pairs start .. stop.

    Parameters
    ----------
    plan, pack_a, pack_b
        The operands are documented in `verdicts`.
    Ta0, Ta1, Tb0, Tb1 : ndarray, shape (n, 4, 4)
        Poses at the beginning and at the end of each motion; they must be rigid.
    margin, tolerance : float
    memory : int
        Address of memory with the layout `MEMORY`, to write to; only one thread may use it at a time.
    times : ndarray, shape (2, n)
        Receives the times until which the pairs are proven free, and the times at which they touch (inf for free
        pairs).
    verdicts : ndarray of int8, shape (n,)

    Returns
    -------
    fault : int
        2 k if neither way to turn is shorter for body a of pair k, and 2 k + 1 if this holds for body b; a fault ends
        the work. Without a fault, -1.
    rounds : int
        Number of searches.
    """
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    poses, motions = poses_of(memory), motions_of(memory)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    rounds = 0
    for k in range(start, stop):
        ka, kb = row_of(k, shape, pose_a), row_of(k, shape, pose_b)
        if not write_motion(Ta0[ka], Ta1[ka], poses, 0, motions[0]):
            return 2 * k, rounds
        if not write_motion(Tb0[kb], Tb1[kb], poses, 1, motions[1]):
            return 2 * k + 1, rounds
        ia, ib = row_of(k, shape, body_a), row_of(k, shape, body_b)
        verdict, free, touching, r = _between_bodies(a, ia, b, ib, margin, tolerance, memory)
        rounds += r + 1
        verdicts[k] = verdict
        times[0, k], times[1, k] = (np.inf, np.inf) if verdict == FREE else (free, touching)
    return -1, rounds
