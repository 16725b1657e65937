"""The certificate, many piece pairs at a time, in registers.

Sixteen pairs at a time are first certified in single precision, with matching error bounds. Single precision settles
almost every pair at half the cost and with half the memory. Pairs that the errors of single precision leave undecided
are certified in double precision, eight at a time.

Each of the three stages runs only if some pairs are still open:

near
    The bounding spheres of the outer ellipsoids are apart.
outer
    A direction separates the outer ellipsoids. The maximizer of the contact function is guessed from the widths along
    r: s = h_a / (h_a + h_b), which is exact for spheres. The direction K(s)⁻¹ r then separates 999 in 1,000 separable
    pairs of round pieces.
inner
    The inner ellipsoids have a common point, which the same kind of guess yields.

Each stage also determines whether a better s could still change the answer; only in this case is s improved. With a
margin, the near points matter, and they need the best s, so `certify_best` always iterates.

The checks compare squares, not square roots (docs/certified.md), because divisions and roots would take half of the
time.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import BY_INNER, BY_OUTER, BY_SPHERE, OPEN, UNSURE
from loewner._kernels.columns import HOT, INNER_CENTER, INNER_SHAPE, OUTER_CENTER, OUTER_RADIUS, OUTER_SHAPE, REACH
from loewner._kernels.ellipsoids.contact import (
    nearness,
    newton_step,
    normal_at,
    polynomials,
    position_error,
    separation,
)
from loewner._kernels.linalg3 import apply, apply_symmetric, dot, minus, one_norm, plus, rotated_shape, selected, trace
from loewner._kernels.pieces.rigid import is_rigid, is_rigid_single
from loewner._kernels.simd.scalars import eight_at, holds
from loewner._kernels.simd.vectors import (
    ALL,
    LANES,
    SINGLE_ALL,
    SINGLE_LANES,
    absolute,
    broadcast,
    gather_transpose,
    gather_transpose_single,
    masked_store,
    maximum,
    minimum,
    movemask,
    prefetch_rows,
    prefetch_rows_single,
    select,
    share_of_roots,
    spread_row,
    store,
)
from loewner._kernels.tolerances import SHAPE_ROUNDINGS, SINGLE_ROUNDOFF, UNIT_ROUNDOFF

BLOCK = 128  # Maximum number of piece pairs in a block; the pairs of a block are settled together.

NEWTON_STEPS = 12

# Bound on the errors that a shape matrix Q causes in a squared width nᵀQn, in units of the roundoff times trace(Q)
# |n|², and in a product Qn, in units of the roundoff times trace(Q) |n|. The bound holds for both precisions; the
# errors are larger in single precision.
SHAPE_ERROR = SHAPE_ROUNDINGS / UNIT_ROUNDOFF  # certified.md B4, B5

# Smallest difference between F and 1 at which the search for s may be given up, in double and in single precision. If F
# is nearer to 1, the search goes on; this costs little time, and leaves room for the rounding error of F (see
# `_doubt`). No proof depends on these numbers, because a pair whose search is given up is left OPEN.
SURE, SINGLE_SURE = 1e-6, 2e-3


class Pose(NamedTuple):
    """Poses of several bodies: rotations (nine entries in row order), translations, and whether all are rigid."""

    R: Any
    t: Any
    rigid: Any


class Bounds(NamedTuple):
    """Centers and sizes of several pieces in the frames of their bodies, from the first columns of the pieces' rows."""

    outer_center: Any
    outer_radius: Any
    inner_center: Any
    reach: Any


class Shape(NamedTuple):
    """Ellipsoids in world axes, from eight columns of their rows: the shape matrix and two bounds on semi-axes.

    For outer ellipsoids, `sigma` is a lower bound on the least semi-axis, and `inverse_sigma` is unused. For inner
    ellipsoids, `inverse_sigma` is an upper bound on the reciprocal of the least semi-axis, and `sigma` is unused.
    """

    Q: Any
    inverse_sigma: Any
    sigma: Any


@inline
def turns(R):
    """Return the mask of rotations that are not exactly the identity."""
    off = absolute(R[1]) + absolute(R[2]) + absolute(R[3]) + absolute(R[5]) + absolute(R[6]) + absolute(R[7])
    on = absolute(R[0] - 1.0) + absolute(R[4] - 1.0) + absolute(R[8] - 1.0)
    return off + on > 0.0


@inline
def bounds_of(columns):
    """Make a `Bounds` record of the columns OUTER_CENTER .. REACH."""
    return Bounds(
        (columns[OUTER_CENTER], columns[OUTER_CENTER + 1], columns[OUTER_CENTER + 2]),
        columns[OUTER_RADIUS],
        (columns[INNER_CENTER], columns[INNER_CENTER + 1], columns[INNER_CENTER + 2]),
        columns[REACH],
    )


@inline
def shape_of(columns, R, rotated):
    """Make a `Shape` record of the columns that begin at OUTER_SHAPE or INNER_SHAPE."""
    Q = columns[0], columns[1], columns[2], columns[3], columns[4], columns[5]
    if rotated:
        Q = rotated_shape(R, Q)
    return Shape(Q, columns[6], columns[7])


@inline
def _selected_shape(condition, a, b):
    """Select the shapes `a` where the condition holds, otherwise the shapes `b`."""
    Q = (
        select(condition, a.Q[0], b.Q[0]),
        select(condition, a.Q[1], b.Q[1]),
        select(condition, a.Q[2], b.Q[2]),
        select(condition, a.Q[3], b.Q[3]),
        select(condition, a.Q[4], b.Q[4]),
        select(condition, a.Q[5], b.Q[5]),
    )
    return Shape(Q, select(condition, a.inverse_sigma, b.inverse_sigma), select(condition, a.sigma, b.sigma))


@inline
def offset_between(a, rotated_a, center_a, b, rotated_b, center_b):
    """World vector from a point of body a to a point of body b; the translations are subtracted first."""
    if rotated_a:
        center_a = apply(a.R, center_a)
    if rotated_b:
        center_b = apply(b.R, center_b)
    return plus(minus(b.t, a.t), minus(center_b, center_a))


@inline
def size_between(a, reach_a, b, reach_b):
    """Sum of the lengths from which the vector between two centers is computed."""
    return one_norm(minus(b.t, a.t)) + reach_a + reach_b


@inline
def rounded_size(a, reach_a, b, reach_b):
    """Sum of lengths as in `size_between`, for translations that were rounded before their subtraction."""
    t = absolute(a.t[0]) + absolute(a.t[1]) + absolute(a.t[2]) + absolute(b.t[0]) + absolute(b.t[1]) + absolute(b.t[2])
    return t + reach_a + reach_b


@inline
def _clear(r, radii, size, margin, unit):
    """Mask of pairs whose bounding spheres are certainly farther apart than the margin."""
    far = radii + position_error(size, unit) + margin
    # If squares overflow, the second comparison decides.
    widest = maximum(absolute(r[0]), maximum(absolute(r[1]), absolute(r[2])))
    return (dot(r, r) * (1.0 - 16.0 * unit) > far * far) | (widest * (1.0 - 8.0 * unit) > far)


@inline
def guess(P, Q, r, tiny):
    """Guess s; the guess is exact for spheres with the widths of the ellipsoids along r."""
    wide_p, wide_q = dot(apply_symmetric(P, r), r), dot(apply_symmetric(Q, r), r)
    return share_of_roots(maximum(wide_p, tiny), maximum(wide_q, tiny))


@njit()
def _best(P, Q, r):
    """Return s and n = K(s)⁻¹ r at the maximum of F; s is 0.5 for a point, since any s gives the same points."""
    d, q, s = polynomials(P, Q, r)
    for _ in range(NEWTON_STEPS):
        s = newton_step(d, q, s)
    # If an ellipsoid is a point, K is singular at the maximum.
    s = select((trace(P) <= 0.0) | (trace(Q) <= 0.0), 0.5, s)
    return s, normal_at(P, Q, r, s)[1]


@inline
def _doubt(P, Q, least, miss, s, size, unit, sure):
    """Bound on the rounding error of F = s(1-s) rᵀK⁻¹r for F near 1, times the least eigenvalue of K.

    √F is a norm of r. Let ε be the error of r, which comes from the positions and from the difference between K n and
    r. Let λ be the least eigenvalue of K. Then √F changes by at most η = √(s(1-s)) ε / √λ. If the computed F differs
    from 1 by more than 3η + 2η², the exact F is on the same side of 1. This sum is at most c + 4η²/c for any small c.
    Here, F is computed from n·r. An error of K changes F by at most the error divided by λ.

    Parameters
    ----------
    least : vector
        Lower bound on λ.
    miss : vector
        1-norm of r - K n.
    sure : float
        The number c, which is also the least distance of F from 1 that is accepted.
    """
    u = 1.0 - s
    off = position_error(size, unit) + miss
    trace_of_K = u * trace(P) + s * trace(Q)
    return sure * least + 4.0 / sure * (s * u * off * off) + SHAPE_ERROR * unit * trace_of_K


@inline
def _miss(r, s, Pn, Qn):
    """1-norm of r - K(s) n, the vector from (1-s) P n to r - s Q n, from a's center; zero in exact arithmetic."""
    u = 1.0 - s
    return (
        absolute(r[0] - u * Pn[0] - s * Qn[0])
        + absolute(r[1] - u * Pn[1] - s * Qn[1])
        + absolute(r[2] - u * Pn[2] - s * Qn[2])
    )


@inline
def _apart(a, b, r, n, s, size, unit, sure):
    """Masks of pairs that n certainly separates, and of pairs that no s can separate, because F < 1 everywhere.

    F is concave, so its value and its slope at s, (1-s)² nᵀPn - s² nᵀQn, bound F everywhere. Rounding changes the slope
    by at most the change of F divided by s(1-s).
    """
    Pn, Qn = apply_symmetric(a.Q, n), apply_symmetric(b.Q, n)
    nPn, nQn = dot(Pn, n), dot(Qn, n)
    squared = dot(n, n)
    along = dot(n, r)
    # Test n·r > √v + √w, where n·r is rounded down and the squared widths v and w are rounded up.
    low = along - position_error(size, unit) * one_norm(n)
    v = nPn + SHAPE_ERROR * unit * trace(a.Q) * squared
    w = nQn + SHAPE_ERROR * unit * trace(b.Q) * squared
    t = low * low * (1.0 - 8.0 * unit) - (v + w)
    # If the ellipsoids are apart, F > 1 and n·r > 4 at the best s. The conditions that n·r exceeds 1/2, and that t is
    # well above zero, prevent squares from underflowing.
    separated = (low > 0.5) & (t > unit * (low * low)) & (t * t * (1.0 - 16.0 * unit) > 4.0 * (v * w))
    u = 1.0 - s
    most = s * u * along + absolute(u * u * nPn - s * s * nQn) * maximum(s, u)
    least = u * (a.sigma * a.sigma)
    least = least + s * (b.sigma * b.sigma)
    doubt = _doubt(a.Q, b.Q, least, _miss(r, s, Pn, Qn), s, size, unit, sure)
    end = minimum(s, u)
    return separated, (1.0 - most) * least * end > doubt * (1.0 + end)


@inline
def _common(a, b, r, n, s, size, unit, sure):
    """Masks of pairs that certainly share the point (1-s) P n from a's center, and of pairs that share none (F > 1)."""
    Pn, Qn = apply_symmetric(a.Q, n), apply_symmetric(b.Q, n)
    nPn, nQn = dot(Pn, n), dot(Qn, n)
    squared = dot(n, n)
    length = one_norm(n)
    u = 1.0 - s
    miss = _miss(r, s, Pn, Qn)
    slack = miss + position_error(size, unit)
    # The level of the point is (1-s) √(nᵀPn) in a and s √(nᵀQn) in b. Each level must be at most 1 minus a bound on its
    # rounding error.
    error_a = SHAPE_ERROR * unit * trace(a.Q)
    error_b = SHAPE_ERROR * unit * trace(b.Q)
    free_a = 1.0 - 32.0 * unit - u * error_a * length * a.inverse_sigma
    free_b = 1.0 - 32.0 * unit - (s * error_b * length + slack) * b.inverse_sigma
    inside_a = (free_a > 0.0) & (u * u * (nPn + error_a * squared) <= free_a * free_a)
    inside_b = (free_b > 0.0) & (s * s * (nQn + error_b * squared) <= free_b * free_b)
    F = s * u * dot(n, r)
    least = u / (a.inverse_sigma * a.inverse_sigma) + s / (b.inverse_sigma * b.inverse_sigma)
    doubt = _doubt(a.Q, b.Q, least, miss, s, size, unit, sure)
    return inside_a & inside_b, ((F - 1.0) * least > 1.25 * doubt) & (doubt < least)


@inline
def _put_normal(V, at, n):
    store(V, at, n[0])
    store(V, BLOCK + at, n[1])
    store(V, 2 * BLOCK + at, n[2])


def _poses(fetch, everything, rigid_poses, one):
    """Make a function that reads poses into vectors of the kind that `fetch` returns."""

    @inline
    def pose(T, rows, at, moved):
        """Read the poses of the listed rows; a pose array that holds only the identity is not read."""
        if moved:
            p = fetch(T, 16, rows, at, 0)
            q = fetch(T, 16, rows, at, 8)
            rigid = movemask(rigid_poses(p, q)) == everything
            return Pose((p[0], p[1], p[2], p[4], p[5], p[6], q[0], q[1], q[2]), (p[3], p[7], q[3]), rigid)
        on = broadcast(one)
        off = on - on
        return Pose((on, off, off, off, on, off, off, off, on), (off, off, off), True)

    return pose


def _stages(fetch, prefetch, lanes, pose, size_of, unit, tiny, sure):
    """Make the compiled functions `spheres` and `certify` in one of the two precisions.

    Parameters
    ----------
    fetch : callable
        Reads eight columns from as many rows as a vector has lanes.
    prefetch : callable
        Prefetches these rows.
    lanes : int
    pose, size_of : callable
    unit, tiny : float
        Unit roundoff, and a least value for products of four lengths.
    sure : float
        Least distance of F from 1 at which the search for an s that settles the pair is given up.
    """
    everything = 2**lanes - 1

    @njit()
    def spheres(count, margin, asking, hot_a, Ta, moved_a, hot_b, Tb, moved_b, listed, ahead, tier):
        """Run only the first stage: write BY_SPHERE or OPEN to `tier` for each listed piece pair.

        Returns False in the cases in which `certify` does.
        """
        for at in range(0, count, lanes):
            if asking:
                prefetch(hot_a, HOT, ahead.piece_a, at)
                prefetch(hot_b, HOT, ahead.piece_b, at)
            if asking and moved_a:
                prefetch(Ta, 16, ahead.pose_a, at)
            if asking and moved_b:
                prefetch(Tb, 16, ahead.pose_b, at)
            a = pose(Ta, listed.pose_a, at, moved_a)
            b = pose(Tb, listed.pose_b, at, moved_b)
            if not (a.rigid and b.rigid):
                return False
            near_a = bounds_of(fetch(hot_a, HOT, listed.piece_a, at, OUTER_CENTER))
            near_b = bounds_of(fetch(hot_b, HOT, listed.piece_b, at, OUTER_CENTER))
            r = offset_between(a, moved_a, near_a.outer_center, b, moved_b, near_b.outer_center)
            size = size_of(a, near_a.reach, b, near_b.reach)
            far = _clear(r, near_a.outer_radius + near_b.outer_radius, size, margin, unit)
            masked_store(tier, at, far, BY_SPHERE)
            masked_store(tier, at, ~far, OPEN)
        return True

    @njit()
    def better(P, Q, r, n):
        """Return another s and its normal, from spheres with the widths of the ellipsoids along n."""
        s = guess(P, Q, n, tiny)
        _, m = normal_at(P, Q, r, s)
        return s, m

    @njit()
    def certify(count, asking, hot_a, Ta, moved_a, hot_b, Tb, moved_b, listed, ahead, tier, V):
        """Certify the listed piece pairs for margin 0.

        Parameters
        ----------
        count : int
            Number of piece pairs; repeated entries fill the list up to whole vectors.
        asking : bool
            Whether to prefetch data of later blocks. Prefetches are spread among the computations, because a burst of
            prefetches would delay them.
        hot_a, hot_b : ndarray, shape (P, HOT)
        Ta, Tb : ndarray, shape (N, 4, 4)
        moved_a, moved_b : bool
            False if the identity is the only pose of the operand.
        listed : PairList
            Pieces and poses of each pair.
        ahead : PairList
            Pieces and poses that a later block will need.
        tier : ndarray of int8
            Receives BY_SPHERE, BY_OUTER, BY_INNER, OPEN (no s settles the pair) or UNSURE.
        V : ndarray, shape (3 * BLOCK,)
            Receives the contact normals of the outer ellipsoids: all x, then all y, then all z.

        Returns
        -------
        bool
            False if a pose is not a rigid motion (in single precision: may not be one); the remaining pairs are then
            skipped.
        """
        for at in range(0, count, lanes):
            if asking:
                prefetch(hot_a, HOT, ahead.piece_a, at)
            a = pose(Ta, listed.pose_a, at, moved_a)
            b = pose(Tb, listed.pose_b, at, moved_b)
            if not (a.rigid and b.rigid):
                return False
            rotated_a = moved_a and movemask(turns(a.R)) != 0
            rotated_b = moved_b and movemask(turns(b.R)) != 0
            near_a = bounds_of(fetch(hot_a, HOT, listed.piece_a, at, OUTER_CENTER))
            near_b = bounds_of(fetch(hot_b, HOT, listed.piece_b, at, OUTER_CENTER))
            size = size_of(a, near_a.reach, b, near_b.reach)

            r = offset_between(a, rotated_a, near_a.outer_center, b, rotated_b, near_b.outer_center)
            far = _clear(r, near_a.outer_radius + near_b.outer_radius, size, 0.0, unit)
            free = far
            inseparable = ~(far | ~far)
            if asking:
                prefetch(hot_b, HOT, ahead.piece_b, at)
            if movemask(free) != everything:
                p = shape_of(fetch(hot_a, HOT, listed.piece_a, at, OUTER_SHAPE), a.R, rotated_a)
                q = shape_of(fetch(hot_b, HOT, listed.piece_b, at, OUTER_SHAPE), b.R, rotated_b)
                s = guess(p.Q, q.Q, r, tiny)
                _, n = normal_at(p.Q, q.Q, r, s)
                separated, inseparable = _apart(p, q, r, n, s, size, unit, sure)
                free = free | separated
                if movemask(free | inseparable) != everything:
                    s, m = better(p.Q, q.Q, r, n)
                    separated, none = _apart(p, q, r, m, s, size, unit, sure)
                    n = selected(inseparable, n, m)
                    free = free | separated
                    inseparable = inseparable | none
                _put_normal(V, at, n)

            if asking and moved_b:
                prefetch(Tb, 16, ahead.pose_b, at)
            overlap = free
            distinct = free
            if movemask(free) != everything:
                p = shape_of(fetch(hot_a, HOT, listed.piece_a, at, INNER_SHAPE), a.R, rotated_a)
                q = shape_of(fetch(hot_b, HOT, listed.piece_b, at, INNER_SHAPE), b.R, rotated_b)
                r = offset_between(a, rotated_a, near_a.inner_center, b, rotated_b, near_b.inner_center)
                s = guess(p.Q, q.Q, r, tiny)
                _, n = normal_at(p.Q, q.Q, r, s)
                overlap, distinct = _common(p, q, r, n, s, size, unit, sure)
                settled = overlap | distinct
                if movemask(free | settled) != everything:
                    s, m = better(p.Q, q.Q, r, n)
                    common, none = _common(p, q, r, m, s, size, unit, sure)
                    overlap = overlap | common
                    distinct = distinct | none
            if asking and moved_a:
                prefetch(Ta, 16, ahead.pose_a, at)
            masked_store(tier, at, far | ~far, UNSURE)
            masked_store(tier, at, inseparable & distinct, OPEN)
            masked_store(tier, at, overlap, BY_INNER)
            masked_store(tier, at, free, BY_OUTER)
            masked_store(tier, at, far, BY_SPHERE)
        return True

    return spheres, certify


pose_of = _poses(gather_transpose, ALL, is_rigid, 1.0)
pose_of_one = _poses(spread_row, ALL, is_rigid, 1.0)
single_pose_of = _poses(gather_transpose_single, SINGLE_ALL, is_rigid_single, np.float32(1.0))

spheres, certify = _stages(gather_transpose, prefetch_rows, LANES, pose_of, size_between, UNIT_ROUNDOFF, 1e-300, SURE)
single_spheres, single_certify = _stages(
    gather_transpose_single,
    prefetch_rows_single,
    SINGLE_LANES,
    single_pose_of,
    rounded_size,
    SINGLE_ROUNDOFF,
    1e-30,
    SINGLE_SURE,
)  # fmt: skip


@inline
def tier_of_one(a, row_a, b, row_b, more):
    """Tier of one piece pair for margin 0, computed on one lane of single precision, for a GPU thread.

    The formulas are the same as in the stages, and settle the same pairs. Unlike the stages, this function branches,
    because no other pair waits for this one.

    Parameters
    ----------
    a, b : Pose
        Poses that are rigid motions, or affine maps that deviate from them by `more`.
    row_a, row_b : int
        Addresses of the float32 rows of the pieces.
    more : scalar
        Length [m] to add to the lengths from which positions are computed, to allow for other errors of the poses.

    Returns
    -------
    int
        BY_SPHERE, BY_OUTER, BY_INNER, OPEN or UNSURE.
    """
    unit, sure, tiny = SINGLE_ROUNDOFF, SINGLE_SURE, 1e-30
    near_a, near_b = bounds_of(eight_at(row_a, OUTER_CENTER)), bounds_of(eight_at(row_b, OUTER_CENTER))
    size = rounded_size(a, near_a.reach, b, near_b.reach) + more

    r = offset_between(a, True, near_a.outer_center, b, True, near_b.outer_center)
    if holds(_clear(r, near_a.outer_radius + near_b.outer_radius, size, 0.0, unit)):
        return BY_SPHERE

    p = shape_of(eight_at(row_a, OUTER_SHAPE), a.R, True)
    q = shape_of(eight_at(row_b, OUTER_SHAPE), b.R, True)
    s = guess(p.Q, q.Q, r, tiny)
    _, n = normal_at(p.Q, q.Q, r, s)
    separated, inseparable = _apart(p, q, r, n, s, size, unit, sure)
    if not holds(separated | inseparable):
        s = guess(p.Q, q.Q, n, tiny)
        _, n = normal_at(p.Q, q.Q, r, s)
        separated, inseparable = _apart(p, q, r, n, s, size, unit, sure)
    if holds(separated):
        return BY_OUTER

    p = shape_of(eight_at(row_a, INNER_SHAPE), a.R, True)
    q = shape_of(eight_at(row_b, INNER_SHAPE), b.R, True)
    r = offset_between(a, True, near_a.inner_center, b, True, near_b.inner_center)
    s = guess(p.Q, q.Q, r, tiny)
    _, n = normal_at(p.Q, q.Q, r, s)
    overlap, distinct = _common(p, q, r, n, s, size, unit, sure)
    if not holds(overlap | distinct):
        s = guess(p.Q, q.Q, n, tiny)
        _, n = normal_at(p.Q, q.Q, r, s)
        overlap, distinct = _common(p, q, r, n, s, size, unit, sure)
    if holds(overlap):
        return BY_INNER
    return OPEN if holds(inseparable & distinct) else UNSURE


@inline
def _ordered(swap, p, q, r):
    """Exchange the two ellipsoids, and reverse the vector between their centers, where `swap` holds."""
    return _selected_shape(swap, q, p), _selected_shape(swap, p, q), selected(swap, _reversed(r), r)


@inline
def _reversed(v):
    return 0.0 - v[0], 0.0 - v[1], 0.0 - v[2]


@njit()
def certify_best(count, margin, hot_a, Ta, moved_a, hot_b, Tb, moved_b, listed, tier, V):
    """Certify the listed piece pairs at the best s, in double precision, with any margin.

    `certify` documents the parameters and the result; here, however, every remaining pair is OPEN.
    """
    for at in range(0, count, LANES):
        a = pose_of(Ta, listed.pose_a, at, moved_a)
        b = pose_of(Tb, listed.pose_b, at, moved_b)
        if not (a.rigid and b.rigid):
            return False
        near_a = bounds_of(gather_transpose(hot_a, HOT, listed.piece_a, at, OUTER_CENTER))
        near_b = bounds_of(gather_transpose(hot_b, HOT, listed.piece_b, at, OUTER_CENTER))
        size = size_between(a, near_a.reach, b, near_b.reach)
        r = offset_between(a, moved_a, near_a.outer_center, b, moved_b, near_b.outer_center)
        far = _clear(r, near_a.outer_radius + near_b.outer_radius, size, margin, UNIT_ROUNDOFF)
        p = shape_of(gather_transpose(hot_a, HOT, listed.piece_a, at, OUTER_SHAPE), a.R, moved_a)
        q = shape_of(gather_transpose(hot_b, HOT, listed.piece_b, at, OUTER_SHAPE), b.R, moved_b)
        # Put the larger ellipsoid second, so that s is small and loses no digits even if the sizes are very different.
        swap = near_a.outer_radius > near_b.outer_radius
        p, q, r = _ordered(swap, p, q, r)
        s, n = _best(p.Q, q.Q, r)
        _put_normal(V, at, selected(swap, _reversed(n), n))
        free = far | (separation(p.Q, q.Q, r, n, size) > margin)

        p = shape_of(gather_transpose(hot_a, HOT, listed.piece_a, at, INNER_SHAPE), a.R, moved_a)
        q = shape_of(gather_transpose(hot_b, HOT, listed.piece_b, at, INNER_SHAPE), b.R, moved_b)
        r = offset_between(a, moved_a, near_a.inner_center, b, moved_b, near_b.inner_center)
        # Put an ellipsoid that is a single point first, because the common point is computed from the first center.
        swap = (swap & (trace(p.Q) > 0.0)) | (trace(q.Q) <= 0.0)
        p, q, r = _ordered(swap, p, q, r)
        s, n = _best(p.Q, q.Q, r)
        level, distance, _ = nearness(p.Q, q.Q, r, n, s, 1.0 / p.inverse_sigma, 1.0 / q.inverse_sigma, size)
        masked_store(tier, at, far | ~far, OPEN)
        masked_store(tier, at, (level <= 1.0) | ((distance <= margin) & (broadcast(margin) > 0.0)), BY_INNER)
        masked_store(tier, at, free, BY_OUTER)
        masked_store(tier, at, far, BY_SPHERE)
    return True
