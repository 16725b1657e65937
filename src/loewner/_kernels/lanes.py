"""The certificate, many piece pairs at a time, in registers.

First sixteen at a time in single precision, with error bounds to match: proof enough for almost every pair, at half the
cost and half the memory. Pairs within that rounding of a decision are left to the same in double precision, eight at
a time.

Three stages, each only if some of them are still open:

near
    bounding spheres of the outer ellipsoids.
outer
    a separating direction for the outer ellipsoids. The maximizer of the contact function is
    guessed from the widths along r, s = h_a / (h_a + h_b), which is exact for spheres; K(s)⁻¹ r is then
    a direction good enough for 999 in 1,000 separable pairs of round pieces.
inner
    a common point of the inner ellipsoids at the same kind of guess.

Each tells besides whether a better s could still change the answer; only then is it improved. With a margin
the near points matter, and they need the best s: `certify_margin` iterates always.

The checks compare squares, not square roots (docs/certified.md): dividing and taking roots would be half the work.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.contact import (
    POSITION_ROUNDINGS,
    SHAPE_ROUNDINGS,
    UNIT_ROUNDOFF,
    dot,
    maximize,
    nearness,
    normal_at,
    rotated,
    separation,
    times,
    turned,
)
from loewner._kernels.rigid import is_rigid, is_rigid_single
from loewner._kernels.shapes import (
    HOT,
    INNER_CENTER,
    INNER_GRIP,
    INNER_SHAPE,
    OUTER_CENTER,
    OUTER_RADIUS,
    OUTER_SHAPE,
    OUTER_SIGMA,
    REACH,
)
from loewner._kernels.vectors import (
    ALL,
    LANES,
    SINGLE_ALL,
    SINGLE_LANES,
    ask,
    ask_single,
    bits,
    choose,
    columns,
    larger,
    magnitude,
    mark,
    share,
    single_columns,
    smaller,
    spread,
    store,
)
from loewner._kernels.verdicts import BY_INNER, BY_OUTER, BY_SPHERE, OPEN

BLOCK = 128  # piece pairs that are settled together

NEWTON_STEPS = 12

# Errors in units of the roundoff: of the shape matrices times trace |n|², and of the positions times the lengths.
SHAPE_ERROR, POSITION_ERROR = SHAPE_ROUNDINGS / UNIT_ROUNDOFF, POSITION_ROUNDINGS / UNIT_ROUNDOFF
SINGLE_ROUNDOFF = 2.0**-24

# How far F must be from 1, at least, before a pair is given up: a band that costs little and leaves room for what
# rounding does to F (see `_doubt`), in either precision.
SURE, SINGLE_SURE = 1e-6, 2e-3

# What `certify` says where a better s may settle a pair.
UNSURE = 7

# Rows of the lists: the pair a piece pair belongs to, its pieces and poses; and the pieces and poses that a later block
# will need, to be asked for while this one is computed.
PAIR, PIECE_A, PIECE_B, POSE_A, POSE_B = 0, 1, 2, 3, 4
LATER = 4  # from a row of the list to the one with what comes later
LISTS = 9

# Rows of the array in which open pairs leave what the exact tests start from.
OUT_NORMAL = 0
ROWS = 3


@inline
def turns(r):
    """Mask: rotations that are not exactly the identity."""
    off = magnitude(r[1]) + magnitude(r[2]) + magnitude(r[3]) + magnitude(r[5]) + magnitude(r[6]) + magnitude(r[7])
    on = magnitude(r[0] - 1.0) + magnitude(r[4] - 1.0) + magnitude(r[8] - 1.0)
    return off + on > 0.0


@inline
def _offset(a, turned_a, ax, ay, az, b, turned_b, bx, by, bz):
    """World vector from a's to b's point of their bodies; the translations are subtracted first."""
    if turned_a:
        ax, ay, az = turned(a, ax, ay, az)
    if turned_b:
        bx, by, bz = turned(b, bx, by, bz)
    return (b[9] - a[9]) + (bx - ax), (b[10] - a[10]) + (by - ay), (b[11] - a[11]) + (bz - az)


@inline
def _size(a, reach_a, b, reach_b):
    """Sum of the lengths that go into the vector between two centers."""
    return magnitude(b[9] - a[9]) + magnitude(b[10] - a[10]) + magnitude(b[11] - a[11]) + reach_a + reach_b


@inline
def rounded_size(a, reach_a, b, reach_b):
    """The same where the translations were rounded before they are subtracted."""
    t = magnitude(a[9]) + magnitude(a[10]) + magnitude(a[11]) + magnitude(b[9]) + magnitude(b[10]) + magnitude(b[11])
    return t + reach_a + reach_b


@inline
def _clear(x, y, z, radii, size, margin, unit):
    """Mask: bounding spheres surely farther apart than the margin."""
    far = radii + POSITION_ERROR * unit * size + margin
    # The second where squares overflow.
    widest = larger(magnitude(x), larger(magnitude(y), magnitude(z)))
    return ((x * x + y * y + z * z) * (1.0 - 16.0 * unit) > far * far) | (widest * (1.0 - 8.0 * unit) > far)


@inline
def _shape(c, r, moved):
    """World shape matrices, and the two entries of the table behind them."""
    q = c[0], c[1], c[2], c[3], c[4], c[5]
    if moved:
        q = rotated(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], q[0], q[1], q[2], q[3], q[4], q[5])
    return q[0], q[1], q[2], q[3], q[4], q[5], c[6], c[7]


@inline
def _guess(p, q, x, y, z, tiny):
    """s of two spheres as wide as the ellipsoids are along r."""
    px, py, pz = times(p[0], p[1], p[2], p[3], p[4], p[5], x, y, z)
    qx, qy, qz = times(q[0], q[1], q[2], q[3], q[4], q[5], x, y, z)
    return share(larger(dot(px, py, pz, x, y, z), tiny), larger(dot(qx, qy, qz, x, y, z), tiny))


@inline
def _normal(p, q, s, x, y, z):
    """n = K(s)⁻¹ r."""
    _, nx, ny, nz = normal_at(p[0], p[1], p[2], p[3], p[4], p[5], q[0], q[1], q[2], q[3], q[4], q[5], x, y, z, s)
    return nx, ny, nz


@njit()
def _best(p, q, x, y, z):
    """s and n = K(s)⁻¹ r at the maximum of F."""
    _, s, nx, ny, nz = maximize(
        p[0], p[1], p[2], p[3], p[4], p[5], q[0], q[1], q[2], q[3], q[4], q[5], x, y, z, NEWTON_STEPS
    )
    return s, nx, ny, nz


@inline
def _doubt(p, q, least, miss, s, size, unit, sure):
    """What rounding can do to F = s(1-s) rᵀK⁻¹r while that is about 1, times the least eigenvalue of K.

    √F is a norm of r: an error ε of r, that of the positions and that by which K n misses r, changes it by at most
    η = √(s(1-s)) ε / √λ, with λ the least eigenvalue of K. So F, computed from n·r, is on the side of 1 that it seems
    to be on if it is off by 3η + 2η² <= c + 4η²/c, for any small c. An error of K changes F by its share in λ.

    Parameters
    ----------
    least : vector
        Lower bound on λ.
    miss : vector
        1-norm of r - K n.
    sure : float
        c; also the least distance of F from 1 that is taken for real.
    """
    u = 1.0 - s
    off = POSITION_ERROR * unit * size + miss
    trace = u * (p[0] + p[3] + p[5]) + s * (q[0] + q[3] + q[5])
    return sure * least + 4.0 / sure * (s * u * off * off) + SHAPE_ERROR * unit * trace


@inline
def _miss(x, y, z, s, px, py, pz, qx, qy, qz):
    """1-norm of r - K(s) n, from P n and Q n."""
    u = 1.0 - s
    return magnitude(x - u * px - s * qx) + magnitude(y - u * py - s * qy) + magnitude(z - u * pz - s * qz)


@inline
def _apart(p, q, x, y, z, nx, ny, nz, s, size, unit, sure):
    """Mask: surely separated by n. And mask: surely no s whatever separates, because F < 1 everywhere.

    F is concave and its slope at s is (1-s)² nᵀPn - s² nᵀQn, which bounds it everywhere. Rounding changes the slope by
    at most what it does to F over s(1-s).
    """
    px, py, pz = times(p[0], p[1], p[2], p[3], p[4], p[5], nx, ny, nz)
    qx, qy, qz = times(q[0], q[1], q[2], q[3], q[4], q[5], nx, ny, nz)
    pn = dot(px, py, pz, nx, ny, nz)
    qn = dot(qx, qy, qz, nx, ny, nz)
    squared = dot(nx, ny, nz, nx, ny, nz)
    along = dot(nx, ny, nz, x, y, z)
    # n·r > √b + √c, with n·r rounded down and the squared widths b and c rounded up.
    a = along - POSITION_ERROR * unit * size * (magnitude(nx) + magnitude(ny) + magnitude(nz))
    b = pn + SHAPE_ERROR * unit * (p[0] + p[3] + p[5]) * squared
    c = qn + SHAPE_ERROR * unit * (q[0] + q[3] + q[5]) * squared
    t = a * a * (1.0 - 8.0 * unit) - (b + c)
    # Apart means F > 1 and n·r > 4 at the best s; asking for a half, and t clear of zero, keeps squares from
    # underflowing.
    separated = (a > 0.5) & (t > unit * (a * a)) & (t * t * (1.0 - 16.0 * unit) > 4.0 * (b * c))
    u = 1.0 - s
    most = s * u * along + magnitude(u * u * pn - s * s * qn) * larger(s, u)
    least = u * (p[OUTER_SIGMA - OUTER_SHAPE] * p[OUTER_SIGMA - OUTER_SHAPE])
    least = least + s * (q[OUTER_SIGMA - OUTER_SHAPE] * q[OUTER_SIGMA - OUTER_SHAPE])
    doubt = _doubt(p, q, least, _miss(x, y, z, s, px, py, pz, qx, qy, qz), s, size, unit, sure)
    end = smaller(s, u)
    return separated, (1.0 - most) * least * end > doubt * (1.0 + end)


@inline
def _common(p, q, grip_a, grip_b, x, y, z, nx, ny, nz, s, size, unit, sure):
    """Mask: surely a common point at (1-s) P n from a's center. And mask: surely F > 1, so that there is none."""
    px, py, pz = times(p[0], p[1], p[2], p[3], p[4], p[5], nx, ny, nz)
    qx, qy, qz = times(q[0], q[1], q[2], q[3], q[4], q[5], nx, ny, nz)
    pn = dot(px, py, pz, nx, ny, nz)
    qn = dot(qx, qy, qz, nx, ny, nz)
    squared = dot(nx, ny, nz, nx, ny, nz)
    length = magnitude(nx) + magnitude(ny) + magnitude(nz)
    u = 1.0 - s
    # The point seen from a, and how far the same point seen from b misses it: zero in exact arithmetic.
    ax, ay, az = u * px, u * py, u * pz
    miss = magnitude(x - ax - s * qx) + magnitude(y - ay - s * qy) + magnitude(z - az - s * qz)
    slack = miss + POSITION_ERROR * unit * size
    # Its level in each, (1-s)|Fᵀn| and s|Gᵀn|, must be at most 1 less what rounding does to it.
    error_p = SHAPE_ERROR * unit * (p[0] + p[3] + p[5])
    error_q = SHAPE_ERROR * unit * (q[0] + q[3] + q[5])
    free_a = 1.0 - 32.0 * unit - u * error_p * length * grip_a
    free_b = 1.0 - 32.0 * unit - (s * error_q * length + slack) * grip_b
    inside_a = (free_a > 0.0) & (u * u * (pn + error_p * squared) <= free_a * free_a)
    inside_b = (free_b > 0.0) & (s * s * (qn + error_q * squared) <= free_b * free_b)
    F = s * u * dot(nx, ny, nz, x, y, z)
    least = u / (grip_a * grip_a) + s / (grip_b * grip_b)
    doubt = _doubt(p, q, least, miss, s, size, unit, sure)
    return inside_a & inside_b, ((F - 1.0) * least > 1.25 * doubt) & (doubt < least)


@inline
def _put_three(V, row, at, x, y, z):
    store(V, row * BLOCK + at, x)
    store(V, (row + 1) * BLOCK + at, y)
    store(V, (row + 2) * BLOCK + at, z)


@inline
def _put_tiers(tier, at, far, free, overlap):
    mark(tier, at, far | ~far, OPEN)
    mark(tier, at, overlap, BY_INNER)
    mark(tier, at, free, BY_OUTER)
    mark(tier, at, far, BY_SPHERE)


def _poses(fetch, everything, rigid_poses, one):
    """The function below, for vectors like those that `fetch` returns."""

    @inline
    def pose(T, rows, at, moved):
        """Rotation (row by row), translation, and whether all are rigid.

        A pose array that is the identity alone is not even read.
        """
        if moved:
            p = fetch(T, 16, rows, at, 0)
            q = fetch(T, 16, rows, at, 8)
            good = bits(rigid_poses(p, q)) == everything
            return p[0], p[1], p[2], p[4], p[5], p[6], q[0], q[1], q[2], p[3], p[7], q[3], good
        on = spread(one)
        off = on - on
        return on, off, off, off, on, off, off, off, on, off, off, off, True

    return pose


def _stages(fetch, ask, lanes, pose, size_of, unit, tiny, sure):
    """The two compiled functions below, in one of the two precisions.

    Parameters
    ----------
    fetch : callable
        Reads eight columns of as many rows as a vector has lanes.
    ask : callable
        Asks for such rows ahead of their use.
    lanes : int
    pose, size_of : callable
    unit, tiny : float
        Unit roundoff, and a number that no product of four lengths falls below.
    sure : float
        How far F must be from 1, at least, to say that no s whatever settles a pair.
    """
    everything = 2**lanes - 1

    @njit()
    def spheres(count, margin, asking, hot_a, Ta, moved_a, hot_b, Tb, moved_b, L, tier):
        """Write BY_SPHERE or OPEN to `tier` for each listed piece pair: the first stage by itself.

        Returns False where `certify` does.
        """
        for at in range(0, count, lanes):
            if asking:
                ask(hot_a, HOT, L, (LATER + PIECE_A) * BLOCK + at)
                ask(hot_b, HOT, L, (LATER + PIECE_B) * BLOCK + at)
            if asking and moved_a:
                ask(Ta, 16, L, (LATER + POSE_A) * BLOCK + at)
            if asking and moved_b:
                ask(Tb, 16, L, (LATER + POSE_B) * BLOCK + at)
            a = pose(Ta, L, POSE_A * BLOCK + at, moved_a)
            b = pose(Tb, L, POSE_B * BLOCK + at, moved_b)
            if not (a[12] and b[12]):
                return False
            p = fetch(hot_a, HOT, L, PIECE_A * BLOCK + at, OUTER_CENTER)
            q = fetch(hot_b, HOT, L, PIECE_B * BLOCK + at, OUTER_CENTER)
            x, y, z = _offset(a, moved_a, p[0], p[1], p[2], b, moved_b, q[0], q[1], q[2])
            size = size_of(a, p[REACH], b, q[REACH])
            far = _clear(x, y, z, p[OUTER_RADIUS] + q[OUTER_RADIUS], size, margin, unit)
            mark(tier, at, far, BY_SPHERE)
            mark(tier, at, ~far, OPEN)
        return True

    @njit()
    def better(p, q, x, y, z, nx, ny, nz):
        """Another s and its normal: that of spheres as wide as the ellipsoids are along n."""
        s = _guess(p, q, nx, ny, nz, tiny)
        nx, ny, nz = _normal(p, q, s, x, y, z)
        return s, nx, ny, nz

    @njit()
    def certify(count, asking, hot_a, Ta, moved_a, hot_b, Tb, moved_b, L, tier, V):
        """Certify the listed piece pairs, margin 0.

        Parameters
        ----------
        count : int
            Piece pairs; the lists are filled with repeats up to whole vectors.
        asking : bool
            Ask for what comes later; in portions between the computations, which a burst of it would hold up.
        hot_a, hot_b : ndarray, shape (P, HOT)
        Ta, Tb : ndarray, shape (N, 4, 4)
        moved_a, moved_b : bool
            False if the operand's only pose is the identity.
        L : ndarray of int64, shape (LISTS * BLOCK,)
            Pieces and poses of each pair.
        tier : ndarray of int8
            Receives BY_SPHERE, BY_OUTER, BY_INNER, OPEN (no s settles the pair) or UNSURE.
        V : ndarray, shape (ROWS * BLOCK,)
            Receives the contact normals of the outer ellipsoids.

        Returns
        -------
        bool
            False if a pose is no rigid motion (in single precision: may be none); the rest is then not done.
        """
        for at in range(0, count, lanes):
            if asking:
                ask(hot_a, HOT, L, (LATER + PIECE_A) * BLOCK + at)
            a = pose(Ta, L, POSE_A * BLOCK + at, moved_a)
            b = pose(Tb, L, POSE_B * BLOCK + at, moved_b)
            if not (a[12] and b[12]):
                return False
            turned_a = moved_a and bits(turns(a)) != 0
            turned_b = moved_b and bits(turns(b)) != 0
            near_a = fetch(hot_a, HOT, L, PIECE_A * BLOCK + at, OUTER_CENTER)
            near_b = fetch(hot_b, HOT, L, PIECE_B * BLOCK + at, OUTER_CENTER)
            size = size_of(a, near_a[REACH], b, near_b[REACH])

            x, y, z = _offset(
                a, turned_a, near_a[0], near_a[1], near_a[2], b, turned_b, near_b[0], near_b[1], near_b[2]
            )
            far = _clear(x, y, z, near_a[OUTER_RADIUS] + near_b[OUTER_RADIUS], size, 0.0, unit)
            free = far
            inseparable = ~(far | ~far)
            if asking:
                ask(hot_b, HOT, L, (LATER + PIECE_B) * BLOCK + at)
            if bits(free) != everything:
                p = _shape(fetch(hot_a, HOT, L, PIECE_A * BLOCK + at, OUTER_SHAPE), a, turned_a)
                q = _shape(fetch(hot_b, HOT, L, PIECE_B * BLOCK + at, OUTER_SHAPE), b, turned_b)
                s = _guess(p, q, x, y, z, tiny)
                nx, ny, nz = _normal(p, q, s, x, y, z)
                separated, inseparable = _apart(p, q, x, y, z, nx, ny, nz, s, size, unit, sure)
                free = free | separated
                if bits(free | inseparable) != everything:
                    s, mx, my, mz = better(p, q, x, y, z, nx, ny, nz)
                    separated, none = _apart(p, q, x, y, z, mx, my, mz, s, size, unit, sure)
                    nx = choose(inseparable, nx, mx)
                    ny = choose(inseparable, ny, my)
                    nz = choose(inseparable, nz, mz)
                    free = free | separated
                    inseparable = inseparable | none
                _put_three(V, OUT_NORMAL, at, nx, ny, nz)

            if asking and moved_b:
                ask(Tb, 16, L, (LATER + POSE_B) * BLOCK + at)
            overlap = free
            distinct = free
            if bits(free) != everything:
                p = _shape(fetch(hot_a, HOT, L, PIECE_A * BLOCK + at, INNER_SHAPE), a, turned_a)
                q = _shape(fetch(hot_b, HOT, L, PIECE_B * BLOCK + at, INNER_SHAPE), b, turned_b)
                c = INNER_CENTER
                x, y, z = _offset(
                    a, turned_a, near_a[c], near_a[c + 1], near_a[c + 2], b, turned_b, near_b[c], near_b[c + 1],
                    near_b[c + 2],
                )  # fmt: skip
                grip_a, grip_b = p[INNER_GRIP - INNER_SHAPE], q[INNER_GRIP - INNER_SHAPE]
                s = _guess(p, q, x, y, z, tiny)
                nx, ny, nz = _normal(p, q, s, x, y, z)
                overlap, distinct = _common(p, q, grip_a, grip_b, x, y, z, nx, ny, nz, s, size, unit, sure)
                settled = overlap | distinct
                if bits(free | settled) != everything:
                    s, mx, my, mz = better(p, q, x, y, z, nx, ny, nz)
                    found, none = _common(p, q, grip_a, grip_b, x, y, z, mx, my, mz, s, size, unit, sure)
                    overlap = overlap | found
                    distinct = distinct | none
            if asking and moved_a:
                ask(Ta, 16, L, (LATER + POSE_A) * BLOCK + at)
            mark(tier, at, far | ~far, UNSURE)
            mark(tier, at, inseparable & distinct, OPEN)
            mark(tier, at, overlap, BY_INNER)
            mark(tier, at, free, BY_OUTER)
            mark(tier, at, far, BY_SPHERE)
        return True

    return spheres, certify


pose_of = _poses(columns, ALL, is_rigid, 1.0)
single_pose_of = _poses(single_columns, SINGLE_ALL, is_rigid_single, np.float32(1.0))

spheres, certify = _stages(columns, ask, LANES, pose_of, _size, UNIT_ROUNDOFF, 1e-300, SURE)
single_spheres, single_certify = _stages(
    single_columns, ask_single, SINGLE_LANES, single_pose_of, rounded_size, SINGLE_ROUNDOFF, 1e-30, SINGLE_SURE
)


@inline
def _ordered(turn, p, q, x, y, z):
    """The two ellipsoids and the vector from one center to the other's; the other way round where `turn` says so."""
    return (
        (
            choose(turn, q[0], p[0]), choose(turn, q[1], p[1]), choose(turn, q[2], p[2]), choose(turn, q[3], p[3]),
            choose(turn, q[4], p[4]), choose(turn, q[5], p[5]), choose(turn, q[6], p[6]), choose(turn, q[7], p[7]),
        ),
        (
            choose(turn, p[0], q[0]), choose(turn, p[1], q[1]), choose(turn, p[2], q[2]), choose(turn, p[3], q[3]),
            choose(turn, p[4], q[4]), choose(turn, p[5], q[5]), choose(turn, p[6], q[6]), choose(turn, p[7], q[7]),
        ),
        choose(turn, 0.0 - x, x), choose(turn, 0.0 - y, y), choose(turn, 0.0 - z, z),
    )  # fmt: skip


@njit()
def certify_best(count, margin, hot_a, Ta, moved_a, hot_b, Tb, moved_b, L, tier, V):
    """Certify the listed piece pairs at the best s, in double precision, with any margin.

    Parameters and result as for `certify`, but that every pair left is OPEN.
    """
    for at in range(0, count, LANES):
        a = pose_of(Ta, L, POSE_A * BLOCK + at, moved_a)
        b = pose_of(Tb, L, POSE_B * BLOCK + at, moved_b)
        if not (a[12] and b[12]):
            return False
        near_a = columns(hot_a, HOT, L, PIECE_A * BLOCK + at, OUTER_CENTER)
        near_b = columns(hot_b, HOT, L, PIECE_B * BLOCK + at, OUTER_CENTER)
        size = _size(a, near_a[REACH], b, near_b[REACH])
        x, y, z = _offset(a, moved_a, near_a[0], near_a[1], near_a[2], b, moved_b, near_b[0], near_b[1], near_b[2])
        far = _clear(x, y, z, near_a[OUTER_RADIUS] + near_b[OUTER_RADIUS], size, margin, UNIT_ROUNDOFF)
        p = _shape(columns(hot_a, HOT, L, PIECE_A * BLOCK + at, OUTER_SHAPE), a, moved_a)
        q = _shape(columns(hot_b, HOT, L, PIECE_B * BLOCK + at, OUTER_SHAPE), b, moved_b)
        # The larger second: s is then small, and keeps its digits where the sizes are far apart.
        turn = near_a[OUTER_RADIUS] > near_b[OUTER_RADIUS]
        p, q, x, y, z = _ordered(turn, p, q, x, y, z)
        s, nx, ny, nz = _best(p, q, x, y, z)
        _put_three(
            V, OUT_NORMAL, at, choose(turn, 0.0 - nx, nx), choose(turn, 0.0 - ny, ny), choose(turn, 0.0 - nz, nz)
        )
        gap = separation(
            p[0], p[1], p[2], p[3], p[4], p[5], q[0], q[1], q[2], q[3], q[4], q[5], x, y, z, nx, ny, nz, size
        )
        free = far | (gap > margin)

        p = _shape(columns(hot_a, HOT, L, PIECE_A * BLOCK + at, INNER_SHAPE), a, moved_a)
        q = _shape(columns(hot_b, HOT, L, PIECE_B * BLOCK + at, INNER_SHAPE), b, moved_b)
        c = INNER_CENTER
        x, y, z = _offset(
            a, moved_a, near_a[c], near_a[c + 1], near_a[c + 2], b, moved_b, near_b[c], near_b[c + 1], near_b[c + 2]
        )
        p, q, x, y, z = _ordered(turn, p, q, x, y, z)
        s, nx, ny, nz = _best(p, q, x, y, z)
        level, distance, _, _, _, _, _, _, _ = nearness(
            p[0], p[1], p[2], p[3], p[4], p[5], q[0], q[1], q[2], q[3], q[4], q[5], x, y, z, nx, ny, nz, s,
            1.0 / p[INNER_GRIP - INNER_SHAPE], 1.0 / q[INNER_GRIP - INNER_SHAPE], size,
        )  # fmt: skip
        mark(tier, at, far | ~far, OPEN)
        mark(tier, at, (level <= 1.0) | ((distance <= margin) & (spread(margin) > 0.0)), BY_INNER)
        mark(tier, at, free, BY_OUTER)
        mark(tier, at, far, BY_SPHERE)
    return True
