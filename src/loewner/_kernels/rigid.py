"""Is a 4x4 matrix a rigid motion? One pass over a batch, without temporaries."""

from loewner._kernels._jit import njit

RIGID, NOT_FINITE, LAST_ROW, NOT_ORTHONORMAL, REFLECTION = 0, 1, 2, 3, 4


@njit()
def fault(T, tolerance):
    """What is wrong with one pose, and by how much."""
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
    # Infinity minus itself is NaN, and so is NaN minus itself.
    if total - total != 0.0:
        return NOT_FINITE, total
    if T[3, 0] != 0.0 or T[3, 1] != 0.0 or T[3, 2] != 0.0 or T[3, 3] != 1.0:
        return LAST_ROW, 0.0
    if worst > tolerance:
        return NOT_ORTHONORMAL, worst
    determinant = (
        T[0, 0] * (T[1, 1] * T[2, 2] - T[1, 2] * T[2, 1])
        - T[0, 1] * (T[1, 0] * T[2, 2] - T[1, 2] * T[2, 0])
        + T[0, 2] * (T[1, 0] * T[2, 1] - T[1, 1] * T[2, 0])
    )
    if determinant < 0.0:
        return REFLECTION, determinant
    return RIGID, worst


@njit()
def first_fault(Ts, tolerance):
    """Index, kind and size of the first fault in a batch (N, 4, 4); index N if all are rigid."""
    for k in range(Ts.shape[0]):
        kind, size = fault(Ts[k], tolerance)
        if kind != RIGID:
            return k, kind, size
    return Ts.shape[0], RIGID, 0.0
