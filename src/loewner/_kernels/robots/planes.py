"""Gaps between a plane and a moving piece at eight configurations side by side.

The plane is fixed to another body. A plane that parts two pieces in one interval of a motion often parts them in
neighbouring intervals as well, and testing it takes less time than a search.
"""

import numpy as np

from loewner._kernels._jit import inline
from loewner._kernels.columns import BLOCK, KIND, POINTS_FROM, POINTS_TO, POLYTOPE, REACH, SURFACE
from loewner._kernels.ellipsoids.contact import position_error
from loewner._kernels.linalg3 import apply, apply_transposed, dot, minus, negated, one_norm
from loewner._kernels.pieces.pack import placed
from loewner._kernels.pieces.shapes import core_support, placed_support, radius
from loewner._kernels.pieces.support import entry_of
from loewner._kernels.robots.kinematics import rotation_of_link, translation_of_link
from loewner._kernels.robots.sweeps import WIDER
from loewner._kernels.simd.vectors import LANES, absolute, broadcast, load, minimum, store
from loewner._kernels.tolerances import UNIT_ROUNDOFF


@inline
def seen_by(W, fixed, n):
    """A direction, given in the frame of a link or of the world, in world axes."""
    n = broadcast(n[0]), broadcast(n[1]), broadcast(n[2])
    return apply(rotation_of_link(W, fixed), n) if fixed >= 0 else n


@inline
def _strayed(strays, count, x):
    """How far a point may stray because of joints that turn."""
    far = broadcast(0.0)
    for k in range(count):
        at = (2 + 4 * k) * LANES
        v = load(strays, at), load(strays, at + LANES), load(strays, at + 2 * LANES)
        far = far + absolute(dot(x, v) + load(strays, at + 3 * LANES))
    return far


@inline
def _lows(A, m, out):
    """Least products of a piece's core, in the frame of its body, with eight directions."""
    for k in range(3):
        store(out, (1 + k) * LANES, m[k])
    for lane in range(LANES):
        n = out[LANES + lane], out[2 * LANES + lane], out[3 * LANES + lane]
        out[lane] = dot(core_support(A, negated(n)), n)
    return load(out, 0)


@inline
def write_gaps(pieces, W, link, fixed, poses, row, i, j, n, strays, count, out):
    """Write lower bounds on the gaps between two pieces along n at eight configurations, less the strays of joints.

    Parameters
    ----------
    pieces : Pieces
    W : ndarray
        Poses of the links.
    link, fixed : int
        Links of pieces i and j; `fixed` is -1 if j is static.
    poses, row :
        Poses of static bodies, and the row of j's body if it is static.
    i, j : int
        The pieces.
    n : tuple of 3 float
        Unit direction from j to i, in the frame of j's link or of the world.
    strays : ndarray
        Output of `strays.write_strays_along`.
    count : int
        Result of `strays.write_strays_along`; -1 if joints do not stray.
    out : ndarray, shape (32,)
        Receives the bounds in its first eight entries.
    """
    A, B = placed(pieces, i, poses, 0), placed(pieces, j, poses, row)
    R, t = rotation_of_link(W, link), translation_of_link(W, link)
    normal = seen_by(W, fixed, n)
    if fixed >= 0:
        below = dot(core_support(B, n), n)
        shift = minus(t, translation_of_link(W, fixed))
    else:
        below = dot(placed_support(B, n), n)
        shift = minus(t, (poses[row, 0, 3], poses[row, 1, 3], poses[row, 2, 3]))
    m = apply_transposed(R, normal)
    start, stop = pieces.layout[i, POINTS_FROM], pieces.layout[i, POINTS_TO]
    if pieces.layout[i, KIND] == POLYTOPE or pieces.layout[i, KIND] <= SURFACE:
        low, points = broadcast(np.inf), pieces.points
        for column in range(start, stop):
            k = entry_of(column)
            x = points[k], points[k + BLOCK], points[k + 2 * BLOCK]
            low = minimum(low, dot(x, m) - _strayed(strays, count, x))
        if count >= 0:
            low = low - load(strays, 0)
    else:
        low = _lows(A, m, out)
        if count >= 0:
            low = low - load(strays, LANES)
    size = one_norm(shift) + (pieces.table[i, REACH] + pieces.table[j, REACH])
    radii = (radius(A) + radius(B)) * WIDER
    store(out, 0, dot(normal, shift) + low - (below + radii) - position_error(size, UNIT_ROUNDOFF))
