"""The exact answer for the few pairs that the fast searches leave open: a robust GJK, then the expanding polytope.

Apart from `verdicts`, so that it is compiled only when a pair needs it.
"""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.codes import AMBIGUOUS, COLLIDING, FREE
from loewner._kernels.narrow.epa_robust import CONTACT_ACCURACY, FLAT, penetration, workspace
from loewner._kernels.narrow.gjk_robust import APART, TOUCH_ROUNDINGS, TOUCHING, rounding_error, run, swollen_radii
from loewner._kernels.pieces.pack import pieces_of, placed, shift_between
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.trees import piece_tree

CHUNK = 64  # piece pairs taken from the trees at a time


@njit()
def settle_open(margin, start, stop, plan, rows, pack_a, Ta, pack_b, Tb, out):
    """Settle the pairs start .. stop left AMBIGUOUS in `out` from scratch; operands as in `verdicts`, poses rigid."""
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
            found = piece_tree.more(a, b, ib, margin, steps, numbers, found_a, found_b)
            if found == 0:
                break
            for c in range(found):
                verdict = _piece_pair(placed(a, found_a[c], Ta, ka), placed(b, found_b[c], Tb, kb), margin, work)
                if verdict != FREE:
                    out[k] = verdict
                if verdict == COLLIDING:
                    break


@njit()
def _piece_pair(A, B, margin, work):
    """Settle one piece pair; AMBIGUOUS if that is beyond what arithmetic allows."""
    shift = shift_between(A, B)
    error = rounding_error(A, B, shift)
    swollen = swollen_radii(A, B)
    simplex, weights, nearest, direction = np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3)
    status, _, _, _ = run(A, B, shift, (1.0, 0.0, 0.0), margin, True, simplex, weights, nearest, direction)
    if status == APART:
        return FREE
    if status == TOUCHING:
        return COLLIDING
    # Curved pieces that barely overlap can make GJK creep. The expanding polytope sees the same contact from inside.
    shallow, deep = penetration(A, B, shift, CONTACT_ACCURACY, work, np.empty(9))
    if deep == FLAT:  # a sentinel, not a depth: it must not pass for a separation
        return AMBIGUOUS
    if -deep - swollen - error > margin:
        return FREE
    if shallow + swollen >= -margin - TOUCH_ROUNDINGS * error:
        return COLLIDING
    return AMBIGUOUS
