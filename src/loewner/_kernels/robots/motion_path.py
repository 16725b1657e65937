"""The configurations on a motion: what `Robot.between` computes, bit for bit but for orientations."""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.robots.kinematics import quaternion_of
from loewner._kernels.simd.vectors import rounded_product

SMALL_ANGLE = 1e-6  # rad; below it the chord is the arc
SMALLEST_SINE = 1e-12


@inline
def _slerp(ends, at, t, Q, row):
    """Write the quaternion on the arc between two, which are at most a right angle apart."""
    cosine = 0.0
    for k in range(at, at + 4):
        cosine += ends[0, k] * ends[1, k]
    angle = np.arccos(min(cosine, 1.0))
    sine = max(np.sin(angle), SMALLEST_SINE)
    of_p, of_q = 1.0 - t, t
    if angle >= SMALL_ANGLE:
        of_p, of_q = np.sin((1.0 - t) * angle) / sine, np.sin(t * angle) / sine
    squares = 0.0
    for k in range(at, at + 4):
        Q[row, k] = of_p * ends[0, k] + of_q * ends[1, k]
        squares += Q[row, k] * Q[row, k]
    norm = np.sqrt(squares)
    for k in range(at, at + 4):
        Q[row, k] /= norm


@njit()
def configuration_at(tree, ends, t, Q, row):
    """Write the configuration at a fraction of a motion to a row of Q.

    Parameters
    ----------
    tree : Tree
    ends : ndarray, shape (2, dof)
        Of q and -q, which are the same orientation, quaternions have the one that is nearer to the other end's.
    t : float
        From 0 to 1.
    Q : ndarray, shape (N, dof)
    row : int
    """
    for c in range(ends.shape[1]):
        a, b = ends[0, c], ends[1, c]
        Q[row, c] = a + rounded_product(t, b - a) if t != 1.0 else b
    for link in range(tree.kind.size):
        at = quaternion_of(tree, link)
        if at >= 0:
            _slerp(ends, at, t, Q, row)
