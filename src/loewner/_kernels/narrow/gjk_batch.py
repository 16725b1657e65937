"""GJK for many open pairs of small polytopes: sixteen pairs side by side in registers, without branches.

The plane perpendicular to the contact normal of the outer ellipsoids is tried first; it separates four in ten open
pairs. For the other pairs, the signs of a few products decide how the simplex moves; no closest point is computed.
Every round searches the vertices of both pieces once and computes all cases of the simplex together, and each pair
selects its own case. Two or three more rounds settle most pairs.

The walk is in single precision. The results are nonetheless proven: a support plane is clear of the origin, or a
tetrahedron of points of A - B contains the origin, by more than the rounding of single precision (docs/certified.md).
Pairs closer to contact (two in a thousand) are not settled here, but left to `gjk_fast`. A pair's result therefore
depends neither on the path of the walk nor on the other pairs in the registers.

References
----------
Gilbert, Johnson and Keerthi (1988), doi:10.1109/56.2083; Ericson, Real-Time Collision Detection (2005), section 5.1.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import APART, TOUCHING, UNSETTLED
from loewner._kernels.columns import BLOCK, HOT, KIND, POINTS_FROM, POINTS_TO, POLYTOPE, REACH
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.linalg3 import apply, apply_transposed, cross, dot, minus, negated, plus, selected
from loewner._kernels.narrow import pair_list
from loewner._kernels.narrow.certificate import rounded_size, single_pose_of, turns
from loewner._kernels.narrow.gjk_fast import KEPT
from loewner._kernels.narrow.pair_list import fill
from loewner._kernels.pieces.support import extent
from loewner._kernels.simd.memory import Arena, floats, integers, singles, small_integers
from loewner._kernels.simd.vectors import (
    SINGLE_ALL,
    SINGLE_LANES,
    broadcast,
    gather_single,
    gather_transpose_single,
    load_rounded,
    load_single,
    masked_store,
    maximum,
    movemask,
    select,
    sqrt,
    store_strided,
)
from loewner._kernels.tolerances import SINGLE_ROUNDOFF, UNIT_ROUNDOFF

ROUNDS = 10  # Maximum number of rounds. Five rounds settle nine in ten pairs, and eight rounds settle 99 in 100.

FEW = 4  # Minimum number of pairs for the search side by side. Fewer pairs are searched one by one, which is faster.

MOST = 64  # Maximum number of vertices of a piece. With more, sixteen pairs would not fit into the first-level cache.

# Allowed errors of a width that `plane` computes, and of a product with a support point, in roundoffs of single
# precision times the lengths. All errors allowed in this module are at least twice the derived values.
WIDTH_ERROR = 16.0  # certified.md B9
PRODUCT_ERROR = 72.0  # certified.md B10
# Allowed errors of a determinant of three points, and of the sum of four determinants, in roundoffs times the cube of
# the farthest point's distance from the origin.
VOLUME_ERROR = 98.0  # certified.md B11
SUM_ERROR = 632.0  # certified.md B12
# Allowed error of a determinant that is caused by the errors of its points, in roundoffs times the lengths times the
# squared distance of the farthest point from the origin.
POINT_ERROR = 64.0  # certified.md B13

SHORT = 1e-30  # A direction is trusted only if its squared length exceeds this; smaller squares may have lost digits.

VERTEX = 3 * SINGLE_LANES  # Number of entries that hold one vertex from each of sixteen pieces.


class Workspace(NamedTuple):
    """Memory of a walk; further walks can reuse it.

    Attributes
    ----------
    listed : PairList
        The sixteen pairs of the walk.
    first_a, last_a, first_b, last_b : ndarray of int64, shape (16,)
        First and last block of vertices of each piece.
    here : ndarray of int64, shape (16,)
        The current block of each piece.
    directions : ndarray, shape (48,)
        Directions from a to b: all x, all y, all z.
    vertices : ndarray of float32
        Vertices of all sixteen pairs, side by side.
    found : ndarray of int8, shape (16,)
        Results of `settle`.
    """

    listed: Any
    first_a: Any
    last_a: Any
    first_b: Any
    last_b: Any
    here: Any
    directions: Any
    vertices: Any
    found: Any


WORKSPACE = Arena(
    Workspace, listed=pair_list.arena(SINGLE_LANES),
    first_a=integers(SINGLE_LANES), last_a=integers(SINGLE_LANES),
    first_b=integers(SINGLE_LANES), last_b=integers(SINGLE_LANES), here=integers(SINGLE_LANES),
    directions=floats(3 * SINGLE_LANES), vertices=singles(2 * MOST * VERTEX), found=small_integers(SINGLE_LANES),
)  # fmt: skip
workspace_at = WORKSPACE.whole()


@inline
def put(memory, at, k, i, j, ka, kb, n):
    """List a pair: its number, its pieces and their poses, and a direction from a to b."""
    work = workspace_at(memory)
    pair_list.put(work.listed, at, k, i, j, ka, kb)
    at = np.uint64(at)
    work.directions[at] = n[0]
    work.directions[np.uint64(SINGLE_LANES) + at] = n[1]
    work.directions[np.uint64(2 * SINGLE_LANES) + at] = n[2]


@inline
def takes(layout, piece):
    """Return whether the functions below accept a piece."""
    piece = np.uint64(piece)  # With a signed index, Numba would also generate code for negative values.
    return (layout[piece, KIND] == POLYTOPE) & (layout[piece, POINTS_TO] - layout[piece, POINTS_FROM] <= MOST)


@inline
def _blocks(layout, pieces, first, last):
    """Write the first and the last block of vertices of each piece; return the largest number of blocks."""
    most = 0
    for lane in range(SINGLE_LANES):
        piece = pieces[lane]
        begin, end = layout[piece, POINTS_FROM] // BLOCK, layout[piece, POINTS_TO] // BLOCK - 1
        first[lane] = begin
        last[lane] = end
        most = max(most, end - begin + 1)
    return most


@inline
def _block(points, first, last, here, b):
    """Load block b of the vertices of each piece, or its last block if it has fewer: eight x, eight y and eight z."""
    for lane in range(SINGLE_LANES):
        here[lane] = min(first[lane] + b, last[lane])
    width = 3 * BLOCK
    return (
        gather_transpose_single(points, width, here, 0, 0),
        gather_transpose_single(points, width, here, 0, BLOCK),
        gather_transpose_single(points, width, here, 0, 2 * BLOCK),
    )


@inline
def _lay(points, first, last, here, most, W, at):
    """Write the vertices of sixteen pieces side by side, starting at W[at]; return the end of the written entries."""
    for b in range(most):
        px, py, pz = _block(points, first, last, here, b)
        store_strided(W, at, VERTEX, px)
        store_strided(W, at + SINGLE_LANES, VERTEX, py)
        store_strided(W, at + 2 * SINGLE_LANES, VERTEX, pz)
        at += BLOCK * VERTEX
    return at


@inline
def _farthest(W, start, stop, x, y, z):
    """For each piece, find the vertex in W that has the largest product with the piece's direction."""
    # Two searches, through every other vertex each, are interleaved, because each step of a search has to wait for the
    # previous step of the same search.
    ax, ay, az = load_single(W, start), load_single(W, start + SINGLE_LANES), load_single(W, start + 2 * SINGLE_LANES)
    bx, by, bz = (
        load_single(W, start + VERTEX),
        load_single(W, start + VERTEX + SINGLE_LANES),
        load_single(W, start + VERTEX + 2 * SINGLE_LANES),
    )
    a = ax * x + ay * y + az * z
    b = bx * x + by * y + bz * z
    for at in range(start + 2 * VERTEX, stop, 2 * VERTEX):
        px, py, pz = load_single(W, at), load_single(W, at + SINGLE_LANES), load_single(W, at + 2 * SINGLE_LANES)
        product = px * x + py * y + pz * z
        more = product > a
        a, ax, ay, az = select(more, product, a), select(more, px, ax), select(more, py, ay), select(more, pz, az)
        px, py, pz = (
            load_single(W, at + VERTEX),
            load_single(W, at + VERTEX + SINGLE_LANES),
            load_single(W, at + VERTEX + 2 * SINGLE_LANES),
        )
        product = px * x + py * y + pz * z
        more = product > b
        b, bx, by, bz = select(more, product, b), select(more, px, bx), select(more, py, by), select(more, pz, bz)
    more = b > a
    return select(more, bx, ax), select(more, by, ay), select(more, bz, az)


@inline
def plane(sa, la, xa, i, Ta, r, sb, lb, xb, j, Tb, q, n):
    """Return whether the plane perpendicular to a direction from a to b certainly separates two pieces, for margin 0.

    Parameters
    ----------
    sa, la, xa, i, Ta, r : ndarray, ndarray, ndarray, int, ndarray, int
        For a: hot columns, vertices in single precision, layout (see `shapes`) and piece; then the poses and the row of
        the pose. The other arguments are the same for b. `takes` must hold for both pieces.
    """
    x, y, z = n
    # The indices are unsigned, so that Numba generates no code for negative values.
    i, r, j, q = np.uint64(i), np.uint64(r), np.uint64(j), np.uint64(q)
    tx, ty, tz = Tb[q, 0, 3] - Ta[r, 0, 3], Tb[q, 1, 3] - Ta[r, 1, 3], Tb[q, 2, 3] - Ta[r, 2, 3]
    along_a = (
        np.float32(Ta[r, 0, 0] * x + Ta[r, 1, 0] * y + Ta[r, 2, 0] * z),
        np.float32(Ta[r, 0, 1] * x + Ta[r, 1, 1] * y + Ta[r, 2, 1] * z),
        np.float32(Ta[r, 0, 2] * x + Ta[r, 1, 2] * y + Ta[r, 2, 2] * z),
    )
    along_b = (
        np.float32(-(Tb[q, 0, 0] * x + Tb[q, 1, 0] * y + Tb[q, 2, 0] * z)),
        np.float32(-(Tb[q, 0, 1] * x + Tb[q, 1, 1] * y + Tb[q, 2, 1] * z)),
        np.float32(-(Tb[q, 0, 2] * x + Tb[q, 1, 2] * y + Tb[q, 2, 2] * z)),
    )
    width_a = extent(xa, la[i, POINTS_FROM], la[i, POINTS_TO], along_a)
    width_b = extent(xb, lb[j, POINTS_FROM], lb[j, POINTS_TO], along_b)
    gap = x * tx + y * ty + z * tz - (np.float64(width_a) + np.float64(width_b))
    error = WIDTH_ERROR * SINGLE_ROUNDOFF * (np.float64(sa[i, REACH]) + np.float64(sb[j, REACH]))
    error += position_error(abs(tx) + abs(ty) + abs(tz), UNIT_ROUNDOFF)
    squared = x * x + y * y + z * z
    # Computations with a direction whose square is above 1 / SHORT may overflow in single precision.
    return (gap > error * np.sqrt(squared)) & (squared > SHORT) & (squared < 1.0 / SHORT)


@inline
def _directions(N):
    """Load the directions to start from; a direction that is zero is replaced with an arbitrary one."""
    n = load_rounded(N, 0), load_rounded(N, SINGLE_LANES), load_rounded(N, 2 * SINGLE_LANES)
    return selected(dot(n, n) > SHORT, n, (1.0, 0.0, 0.0))


@inline
def faces(A, B, C, E):
    """Heights of the origin over a tetrahedron's faces, times twice the faces' areas; negative on the inner side.

    Parameters
    ----------
    A, B, C, E : tuple of 3
        The newest point A, and the other points, which run counter-clockwise seen from A.

    Returns
    -------
    f, g, h, base : float
        Heights over the faces A B C, A C E, A E B and B E C.
    normals : tuple of 3 tuples of 3
        Normals of the first three faces; the length of each is twice the area of its face.
    """
    AB, AC, AE = minus(B, A), minus(C, A), minus(E, A)
    normals = cross(AB, AC), cross(AC, AE), cross(AE, AB)
    f, g, h = -dot(normals[0], A), -dot(normals[1], A), -dot(normals[2], A)
    # The four heights, times twice the areas of the faces, add up to minus six times the volume of the tetrahedron.
    return f, g, h, dot(normals[0], AE) - (f + g + h), normals


@inline
def advance(A, B, C, E, two, three, f, g, h):
    """For a simplex with the newest point A, select the part that the walk keeps, and the direction to this part.

    Parameters
    ----------
    A, B, C, E, f, g, h
        Documented in `faces`; C and E are ignored if the simplex has fewer points.
    two, three : mask
        Whether the simplex has two points, or three, besides A.

    Returns
    -------
    n, B, C, E : tuple of 3
    two, three : mask
    """
    # If the simplex is a tetrahedron, keep the face with the largest of f, g and h, as the triangle A B C.
    second = three & (g > f) & (g >= h)
    third = three & (h > f) & (h > g)
    B, C = selected(second, C, selected(third, E, B)), selected(second, E, selected(third, B, C))
    plane = two | three

    # Determine whether the origin projects onto the triangle A B C, or lies beyond the edge A B or A C.
    AB, AC = minus(B, A), minus(C, A)
    normal = cross(AB, AC)
    beyond_c = plane & (dot(cross(normal, AC), A) < 0.0)
    beyond_b = dot(cross(AB, normal), A) < 0.0
    line = beyond_b | beyond_c | ~plane
    swap = beyond_c & (dot(AC, A) < 0.0)
    B = selected(swap, C, B)

    # Determine whether the origin projects onto the segment A B, or lies beyond A.
    AB = minus(B, A)
    beside = dot(AB, A) < 0.0
    across = cross(cross(AB, A), AB)
    # Order the corners of the triangle so that A, B, C run counter-clockwise as seen from the origin.
    other = dot(normal, A) <= 0.0
    n = selected(line, selected(beside, across, A), selected(other, negated(normal), normal))
    return n, A, selected(line | other, B, C), selected(other, C, B), line & beside, ~line


@njit()
def settle(count, sa, la, xa, Ta, moved_a, sb, lb, xb, Tb, moved_b, memory):
    """Walk the simplex of each of the listed pairs, for margin 0.

    Parameters
    ----------
    count : int
        Number of pairs in the list; at least 1.
    sa, la, xa, Ta : ndarray
        For a: hot columns, vertices in single precision, layout (see `shapes`), and poses. The other arguments are the
        same for b.
    moved_a, moved_b : bool
        False if the identity is the only pose of the operand.
    memory : int
        Address of a `Workspace`, whose `found` receives APART, TOUCHING or UNSETTLED. `takes` must hold for the pieces.
    """
    work = workspace_at(memory)
    listed, N, W, statuses = work.listed, work.directions, work.vertices, work.found
    fill(listed, count)
    for lane in range(count, SINGLE_LANES):
        for row in range(3):
            N[row * SINGLE_LANES + lane] = N[row * SINGLE_LANES + count - 1]
    a = single_pose_of(Ta, listed.pose_a, 0, moved_a)
    b = single_pose_of(Tb, listed.pose_b, 0, moved_b)
    rotated_a = moved_a and movemask(turns(a.R)) != 0
    rotated_b = moved_b and movemask(turns(b.R)) != 0
    reach_a = gather_single(sa, HOT, listed.piece_a, 0, REACH)
    reach_b = gather_single(sb, HOT, listed.piece_b, 0, REACH)
    size = rounded_size(a, reach_a, b, reach_b)
    error = PRODUCT_ERROR * SINGLE_ROUNDOFF * size
    shift = minus(b.t, a.t)
    most_a = _blocks(la, listed.piece_a, work.first_a, work.last_a)
    most_b = _blocks(lb, listed.piece_b, work.first_b, work.last_b)
    ends_a = _lay(xa, work.first_a, work.last_a, work.here, most_a, W, 0)
    ends_b = _lay(xb, work.first_b, work.last_b, work.here, most_b, W, ends_a)

    # The simplex has one, two or three points of the Minkowski difference: B, C and E, the newest first. The direction
    # n points from the origin towards the part of the simplex that is kept.
    n = negated(_directions(N))
    B, C, E = n, n, n
    none = ~((n[0] > 0.0) | ~(n[0] > 0.0))
    two, three = none, none
    apart, touching = none, none
    largest = broadcast(np.float32(0.0))
    for r in range(ROUNDS):
        along_a, along_b = negated(n), n
        if rotated_a:
            along_a = apply_transposed(a.R, along_a)
        if rotated_b:
            along_b = apply_transposed(b.R, along_b)
        u = _farthest(W, 0, ends_a, along_a[0], along_a[1], along_a[2])
        v = _farthest(W, ends_a, ends_b, along_b[0], along_b[1], along_b[2])
        if rotated_a:
            u = apply(a.R, u)
        if rotated_b:
            v = apply(b.R, v)
        A = minus(u, plus(v, shift))
        squared = dot(n, n)
        length = sqrt(squared)
        apart = apart | ((dot(n, A) > error * length) & (squared > SHORT))
        if movemask(apart | touching) == SINGLE_ALL:
            break
        largest = maximum(largest, dot(A, A))
        if r == 0:
            # A second direction between the first direction and the direction of the first point saves a round.
            kept = np.float32(KEPT) / length
            rest = np.float32(1.0 - KEPT) / sqrt(dot(A, A))
            n = kept * n[0] + rest * A[0], kept * n[1] + rest * A[1], kept * n[2] + rest * A[2]
            B = A
            continue

        f, g, h, base, _ = faces(A, B, C, E)
        # The origin is certainly inside the tetrahedron if all four products are negative by more than their rounding
        # errors.
        reach = sqrt(largest)
        slack = SINGLE_ROUNDOFF * largest * (VOLUME_ERROR * reach + POINT_ERROR * size)
        inside = (f < -slack) & (g < -slack) & (h < -slack)
        inside = inside & (base < -SINGLE_ROUNDOFF * largest * (SUM_ERROR * reach + POINT_ERROR * size))
        touching = touching | (three & inside)
        if movemask(apart | touching) == SINGLE_ALL:
            break
        n, B, C, E, two, three = advance(A, B, C, E, two, three, f, g, h)
    masked_store(statuses, 0, apart | ~apart, UNSETTLED)
    masked_store(statuses, 0, touching, TOUCHING)
    masked_store(statuses, 0, apart, APART)
