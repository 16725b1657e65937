"""Check that 4x4 matrices are rigid motions, in one pass over a batch, without temporaries."""

import numpy as np

from loewner._kernels._jit import borrowed, inline, njit
from loewner._kernels.codes import LAST_ROW, NOT_FINITE, NOT_ORTHONORMAL, REFLECTION, RIGID
from loewner._kernels.simd.vectors import ALL, LANES, absolute, gather_transpose, movemask
from loewner._kernels.tolerances import ROTATION_TOLERANCE

# Relative change of the tolerance in the check of eight poses at a time, which rounds differently from the check of a
# single pose. The certificate uses a slightly larger tolerance, so that every pose that fails also has a fault when it
# is checked alone. The search for faults uses a slightly smaller tolerance, so that it misses no fault.
HAIR = 1e-9


@njit()
def fault(T):
    """Kind and size of the fault of one pose."""
    worst = 0.0
    total = 0.0
    for a in range(3):
        total += abs(T[a, 3])
        for b in range(a, 3):
            entry = T[0, a] * T[0, b] + T[1, a] * T[1, b] + T[2, a] * T[2, b]
            if a == b:
                entry -= 1.0
            worst = max(worst, abs(entry))
            total += abs(entry)
    total += abs(T[3, 0]) + abs(T[3, 1]) + abs(T[3, 2]) + abs(T[3, 3])
    # If an entry is infinite or NaN, the total minus itself is NaN.
    if total - total != 0.0:
        return NOT_FINITE, total
    if T[3, 0] != 0.0 or T[3, 1] != 0.0 or T[3, 2] != 0.0 or T[3, 3] != 1.0:
        return LAST_ROW, 0.0
    if worst > ROTATION_TOLERANCE:
        return NOT_ORTHONORMAL, worst
    determinant = (
        T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1])
        - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
        + T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    )
    if determinant < 0.0:
        return REFLECTION, determinant
    return RIGID, worst


def _rigid(tolerance, largest):
    @inline
    def is_rigid(p, q):
        """Mask of poses without faults; p and q hold the entries of the poses in row order."""
        a = absolute(p[0] * p[0] + p[4] * p[4] + q[0] * q[0] - 1.0)
        b = absolute(p[1] * p[1] + p[5] * p[5] + q[1] * q[1] - 1.0)
        c = absolute(p[2] * p[2] + p[6] * p[6] + q[2] * q[2] - 1.0)
        d = absolute(p[0] * p[1] + p[4] * p[5] + q[0] * q[1])
        e = absolute(p[0] * p[2] + p[4] * p[6] + q[0] * q[2])
        f = absolute(p[1] * p[2] + p[5] * p[6] + q[1] * q[2])
        worst = (a <= tolerance) & (b <= tolerance) & (c <= tolerance)
        worst = worst & (d <= tolerance) & (e <= tolerance) & (f <= tolerance)
        # The determinant is +1 or -1 if R is orthonormal.
        x, y, z = p[5] * q[2] - p[6] * q[1], p[6] * q[0] - p[4] * q[2], p[4] * q[1] - p[5] * q[0]
        last_row = absolute(q[4]) + absolute(q[5]) + absolute(q[6]) + absolute(q[7] - 1.0)
        finite = absolute(p[3]) + absolute(p[7]) + absolute(q[3]) <= largest
        return worst & (p[0] * x + p[1] * y + p[2] * z > 0.0) & (last_row <= 0.0) & finite

    return is_rigid


is_rigid = _rigid(ROTATION_TOLERANCE * (1 + HAIR), np.finfo(np.float64).max)
_is_surely_rigid = _rigid(ROTATION_TOLERANCE * (1 - HAIR), np.finfo(np.float64).max)

# Amount by which the tolerance is reduced in single precision, to cover the errors of rounding the entries and of
# multiplying them. A pose that passes is therefore rigid, except perhaps for its last row: this row may be (0, 0, 0, 1)
# only after rounding, but no certificate reads it.
SINGLE_ROOM = 0.4 * ROTATION_TOLERANCE  # certified.md B20
is_rigid_single = _rigid(ROTATION_TOLERANCE - SINGLE_ROOM, 1e30)


@inline
def _fault_among(Ts, start, stop):
    """Index, kind and size of the first fault of a range; the index is `stop` if all poses are rigid."""
    for k in range(start, stop):
        kind, size = fault(Ts[k])
        if kind != RIGID:
            return k, kind, size
    return stop, RIGID, 0.0


@njit()
def first_fault(Ts):
    """Index, kind and size of the first fault in a batch (N, 4, 4); the index is N if all poses are rigid."""
    total = Ts.shape[0]
    if total < LANES:
        return _fault_among(borrowed(Ts), 0, total)
    rows = np.arange(LANES)
    for start in range(0, total, LANES):
        stop = min(start + LANES, total)
        if stop == start + LANES:
            p, q = gather_transpose(Ts, 16, rows, 0, 0), gather_transpose(Ts, 16, rows, 0, 8)
            if movemask(_is_surely_rigid(p, q)) == ALL:
                rows += LANES
                continue
        k, kind, size = _fault_among(Ts, start, stop)
        if kind != RIGID:
            return k, kind, size
        rows += LANES
    return total, RIGID, 0.0
