"""The exact answer for the few pairs that the fast searches leave open: a robust GJK, then the expanding polytope.

This module is separate from `verdicts`, so that it is compiled only when a pair needs it. Two triangles of surfaces
that rounding leaves unsettled are decided in integers, see `loewner.queries._exact`.
"""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.codes import AMBIGUOUS, APART, COLLIDING, FREE, INEXACT, TOUCHING
from loewner._kernels.columns import KIND
from loewner._kernels.narrow.epa_robust import CONTACT_ACCURACY, NO_VOLUME, penetration, proven_depth, workspace
from loewner._kernels.narrow.gjk_robust import TOUCH_ROUNDINGS, rounding_error, run, swollen_radii
from loewner._kernels.narrow.surface_boxes import is_surface, surface_of
from loewner._kernels.narrow.surface_meets import surface_pair
from loewner._kernels.narrow.surface_walk import SIZE as SURFACE_SIZE
from loewner._kernels.narrow.surface_walk import TRIANGLE, triangle_piece
from loewner._kernels.pieces.pack import pieces_of, placed, shift_between
from loewner._kernels.pieces.shapes import core_support, radius
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.simd.memory import held
from loewner._kernels.trees import piece_tree
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, leaf_of, size_of

CHUNK = 64  # Maximum number of piece pairs that the trees yield at a time.

TRIANGLE_SIZE = TRIANGLE.size()  # Size [bytes] of the memory for a triangle as a piece.

ROOM = 4096  # Maximum number of listed triangles of a surface that a convex piece touches or nearly touches.


@njit()
def settle_open(margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out):
    """Settle from scratch all pairs among start .. stop that are AMBIGUOUS in `out`; poses must be rigid.

    The operands are documented in `verdicts`. A pair becomes INEXACT if it depends on triangles of surfaces, or points,
    that rounding cannot separate.
    """
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    found_a = np.empty(CHUNK, np.int64)
    found_b = np.empty(CHUNK, np.int64)
    work = workspace(True)
    for k in range(start, stop):
        if out[k] != AMBIGUOUS:
            continue
        ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
        out[k] = FREE
        piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
        while out[k] != COLLIDING:
            count = piece_tree.more(a, b, ib, margin, steps, numbers, found_a, found_b)
            if count == 0:
                break
            for c in range(count):
                A, B = placed(a, found_a[c], Ta, ka), placed(b, found_b[c], Tb, kb)
                surfaces = is_surface(A) or is_surface(B)
                verdict = _with_surface(A, B, margin, work) if surfaces else _piece_pair(A, B, margin, work)
                if verdict == COLLIDING or (verdict != FREE and out[k] != AMBIGUOUS):
                    out[k] = verdict
                if verdict == COLLIDING:
                    break


@njit()
def _with_surface(A, B, margin, work):
    """Settle a piece pair with a surface; return INEXACT if the pair needs integers."""
    memory = np.empty(SURFACE_SIZE // 8)
    listed = np.empty((ROOM, 2), np.int64)
    near, far = margin + (radius(A) + radius(B)), margin + swollen_radii(A, B)
    verdict, count = surface_pair(A, B, near, far, memory.ctypes.data, listed.ctypes.data, ROOM)
    held(memory)
    if verdict != AMBIGUOUS:
        return verdict
    if is_surface(A) and is_surface(B):
        return INEXACT
    if not is_surface(A):
        A, B = B, A
    own = np.empty(TRIANGLE_SIZE // 8)
    for n in range(min(count, ROOM)):
        verdict = _piece_pair(triangle_piece(A, listed[n, 0], radius(A), own.ctypes.data), B, margin, work)
        held(own)
        if verdict != FREE:
            return verdict
    return INEXACT if count <= ROOM else AMBIGUOUS


@njit()
def open_triangles(margin, k, plan, rows, pack_a, Ta, pack_b, Tb, listed):
    """List the triangles that keep a pair INEXACT; the operands are documented in `verdicts`.

    Parameters
    ----------
    listed : ndarray of int64, shape (room, 6)
        Receives in each row: the rows of two pieces and of their poses, then two triangles, by block and lane. A row
        with -1 for both triangles means that one piece may lie within the other.

    Returns
    -------
    count : int
        Number of rows found; only the first `room` rows are listed.
    """
    a, b = pieces_of(pack_a), pieces_of(pack_b)
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    steps = np.empty(piece_tree.STEPS, np.int64)
    numbers = np.empty(piece_tree.NUMBERS)
    found_a = np.empty(CHUNK, np.int64)
    found_b = np.empty(CHUNK, np.int64)
    memory = np.empty(SURFACE_SIZE // 8)
    pairs = np.empty((len(listed), 2), np.int64)
    ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
    piece_tree.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
    count = 0
    while True:
        pair_count = piece_tree.more(a, b, ib, margin, steps, numbers, found_a, found_b)
        if pair_count == 0:
            return count
        for c in range(pair_count):
            A, B = placed(a, found_a[c], Ta, ka), placed(b, found_b[c], Tb, kb)
            if not (is_surface(A) or is_surface(B)):
                continue
            near, far = margin + (radius(A) + radius(B)), margin + swollen_radii(A, B)
            verdict, more = surface_pair(A, B, near, far, memory.ctypes.data, pairs.ctypes.data, len(pairs))
            held(memory)
            if verdict != AMBIGUOUS:
                continue
            for n in range(-1, more if is_surface(A) and is_surface(B) else 0):
                if count < len(listed):
                    listed[count, 0], listed[count, 1] = found_a[c], found_b[c]
                    listed[count, 2], listed[count, 3] = ka, kb
                    listed[count, 4] = pairs[n, 0] if n >= 0 and n < len(pairs) else -1
                    listed[count, 5] = pairs[n, 1] if n >= 0 and n < len(pairs) else -1
                count += 1


@njit()
def exact_parts(pack, piece):
    """The parts of a piece that are converted to integers.

    Returns
    -------
    kind : int
    radius : float
    triangles : ndarray, shape (n, 9)
        Triangles of a surface, by block and lane; the padding of a block is NaN.
    points : ndarray, shape (m, 3)
        One point of each connected part of a surface, or one point of the core of a convex piece.
    """
    pieces = pieces_of(pack)
    poses = np.zeros((1, 4, 4))  # The results do not depend on the pose.
    P = placed(pieces, piece, poses, 0)
    if not is_surface(P):
        point = np.empty((1, 3))
        point[0, 0], point[0, 1], point[0, 2] = core_support(P, (1.0, 0.0, 0.0))
        return P.layout[piece, KIND], radius(P), np.empty((0, 9)), point
    tree = surface_of(P)
    triangles = np.full((len(tree.blocks) // BLOCK * LEAF, 9), np.nan)
    for child in tree.children:
        if child < 0:
            for lane in range(size_of(child)):
                for c in range(9):
                    triangles[leaf_of(child) * LEAF + lane, c] = tree.blocks[leaf_of(child) * BLOCK + c * LEAF + lane]
    points = np.empty((len(tree.parts) // 3, 3))
    for n in range(len(tree.parts)):
        points[n // 3, n % 3] = tree.parts[n]
    return P.layout[piece, KIND], radius(P), triangles, points


@njit()
def _piece_pair(A, B, margin, work):
    """Settle one piece pair; return AMBIGUOUS if rounding errors prevent a decision."""
    shift = shift_between(A, B)
    error = rounding_error(A, B, shift)
    swollen = swollen_radii(A, B)
    simplex, weights, nearest, direction = np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3)
    status, _, _, _ = run(A, B, shift, (1.0, 0.0, 0.0), margin, True, simplex, weights, nearest, direction)
    if status == APART:
        return FREE
    if status == TOUCHING:
        return COLLIDING
    # If curved pieces barely overlap, GJK can be slow. In this case, the expanding polytope finds the same contact from
    # inside.
    shallow, deep = penetration(A, B, shift, CONTACT_ACCURACY, work, np.empty(9))
    if deep == NO_VOLUME:  # NO_VOLUME is a special value, not a depth, and must not count as a gap.
        return AMBIGUOUS
    if -deep - swollen - error > margin:
        return FREE
    if shallow + swollen >= -margin - TOUCH_ROUNDINGS * error or proven_depth(error, work) > 0.0:
        return COLLIDING
    return AMBIGUOUS
