"""The exact answer for the few pairs that the fast searches leave open: a robust GJK, then the expanding polytope.

Apart from `batch`, so that it is compiled only when a pair needs it.
"""

import numpy as np

from loewner._kernels._jit import njit
from loewner._kernels.codes import AMBIGUOUS, COLLIDING, FREE
from loewner._kernels.ellipsoids.contact import POSITION_ROUNDINGS
from loewner._kernels.narrow.epa_robust import CONTACT_ACCURACY, FLAT, penetration, workspace
from loewner._kernels.narrow.gjk_robust import APART, TOUCH_ROUNDINGS, TOUCHING, run, swollen_radii
from loewner._kernels.pieces.shapes import REACH
from loewner._kernels.pipeline.verdicts import rows_of
from loewner._kernels.trees import piece_tree as trees

CHUNK = 64  # piece pairs taken from the trees at a time


@njit()
def settle_open(margin, plan, rows, a, Ta, b, Tb, out):
    """Settle the pairs left AMBIGUOUS in `out` from scratch; operands as in `batch`, poses known to be rigid."""
    shape, body_a, pose_a, body_b, pose_b = plan[0], plan[1], plan[2], plan[3], plan[4]
    steps = np.empty(trees.STEPS, np.int64)
    numbers = np.empty(trees.NUMBERS)
    found_a = np.empty(CHUNK, np.int64)
    found_b = np.empty(CHUNK, np.int64)
    work = workspace(True)
    for k in range(out.shape[0]):
        if out[k] != AMBIGUOUS:
            continue
        ia, ib, ka, kb = rows_of(k, shape, rows, body_a, body_b, pose_a, pose_b)
        out[k] = FREE
        trees.begin(a, ia, Ta, ka, b, ib, Tb, kb, steps, numbers)
        while out[k] != COLLIDING:
            found = trees.more(a, b, ib, margin, steps, numbers, found_a, found_b)
            if found == 0:
                break
            for c in range(found):
                verdict = _piece_pair(a, found_a[c], Ta, ka, b, found_b[c], Tb, kb, margin, work)
                if verdict != FREE:
                    out[k] = verdict
                if verdict == COLLIDING:
                    break


@njit()
def _piece_pair(a, i, Ta, ka, b, j, Tb, kb, margin, work):
    """Settle one piece pair; AMBIGUOUS if that is beyond what arithmetic allows."""
    ta, la, xa = a[0], a[1], a[2]
    tb, lb, xb = b[0], b[1], b[2]
    dx = Tb[kb, 0, 3] - Ta[ka, 0, 3]
    dy = Tb[kb, 1, 3] - Ta[ka, 1, 3]
    dz = Tb[kb, 2, 3] - Ta[ka, 2, 3]
    error = POSITION_ROUNDINGS * (ta[i, REACH] + tb[j, REACH] + abs(dx) + abs(dy) + abs(dz))
    swollen = swollen_radii(ta, i, Ta, ka, tb, j, Tb, kb)
    status, _, _, _ = run(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, 1.0, 0.0, 0.0, margin, True,
        np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3),
    )  # fmt: skip
    if status == APART:
        return FREE
    if status == TOUCHING:
        return COLLIDING
    # Curved pieces that barely overlap can make GJK creep. The expanding polytope sees the same contact from inside.
    shallow, deep = penetration(
        ta, la, xa, i, Ta, ka, tb, lb, xb, j, Tb, kb, dx, dy, dz, CONTACT_ACCURACY,
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], np.empty(9),
    )  # fmt: skip
    if deep == FLAT:  # a sentinel, not a depth: it must not pass for a separation
        return AMBIGUOUS
    if -deep - swollen - error > margin:
        return FREE
    if shallow + swollen >= -margin - TOUCH_ROUNDINGS * error:
        return COLLIDING
    return AMBIGUOUS
