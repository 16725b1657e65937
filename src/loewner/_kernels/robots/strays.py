"""How far, at most, a piece moves towards another body along a normal if joints deviate from a course.

The bound V of `motion_bounds` adds up the motions of all joints in all directions. To first order, only the motion
along the normal n counts: |n · (z × (x - o))| for a turn about the axis z through o. The motion along n is known
wherever a configuration has been placed. See docs/certified.md, "Joint errors along a normal".
"""

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import ACROSS, PLANAR, PRISMATIC, REVOLUTE
from loewner._kernels.ellipsoids.contact import outward_width
from loewner._kernels.linalg3 import apply, apply_transposed, cross, dot, minus, scaled
from loewner._kernels.robots.kinematics import axis_of, rotation_of_link, translation_of_link, triple_of
from loewner._kernels.robots.motion_bounds import shared_joints
from loewner._kernels.robots.planes import seen_by
from loewner._kernels.robots.sweeps import outer_center, outer_shape
from loewner._kernels.simd.vectors import LANES, absolute, broadcast, store

# Bound on the relative errors of the first-order terms. The errors come from rounding, and from rotations that are
# accepted as orthonormal although they are not exactly so.
TERMS = 1e-4  # certified.md B52


@inline
def longest_lever(tables, ways, astray):
    """Upper bound on the distances of a body's points from all joints between it and another body."""
    return 2.0 * tables.chain[1] + ways.travel + astray.travel


@inline
def error_of_strays(ways, astray, lever, width):
    """Bound the terms that `write_strays_along` omits in an interval of this width: second derivatives, rounding."""
    squares = ways.turn * ways.turn + ways.turning
    moved = astray.turn * lever + astray.speed
    between = moved * squares + astray.turn * (2.0 * ways.turn * ways.speed + ways.bend)
    return between * width * width / 8.0 + TERMS * moved


@njit()
def write_strays_along(tree, tables, hot, W, strays, lever, link, fixed, piece, n, planes):
    """Write how far a piece's points move along n, to first order, if joints deviate from eight configurations.

    The distance is a sum of absolute values, one for each joint that turns, plus a rest that is the same for all
    points. Each absolute value is of a function that is linear in the point.

    Parameters
    ----------
    tree : Tree
    tables : MotionTables
    hot : ndarray
        Outer ellipsoids of pieces, in the frames of their bodies.
    W : ndarray
        Poses of the links at eight configurations.
    strays : Rates
        Deviations of joints, see `motion_bounds.write_strays`.
    lever : float
        Result of `longest_lever`.
    link, fixed : int
        Links of the piece and of the other body; -1 if the other body is static.
    piece : int
    n : tuple of 3 float
        Unit normal in the other body's frame.
    planes : ndarray
        Receives vectors: first the rest, then a bound on the sum for all points of the outer ellipsoid, then the
        functions. Each function has three coefficients of a point in the frame of its body, and a constant.

    Returns
    -------
    int
        Number of functions.
    """
    n = seen_by(W, fixed, n)
    R, t, center = rotation_of_link(W, link), translation_of_link(W, link), outer_center(hot, piece)
    shape, rest, whole, count = outer_shape(hot, piece), broadcast(0.0), broadcast(0.0), 0
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    for side in range(2 if fixed >= 0 else 1):
        end = link if side == 0 else fixed
        for k in range(tables.path_start[end] + shared, tables.path_start[end + 1]):
            joint = tables.path_link[k]
            kind, turn, slide = tree.kind[joint], strays.turn[joint], strays.slide[joint]
            if kind == PRISMATIC:
                d, above = triple_of(tree.constants, joint, ACROSS), tree.parent[joint]
                if above >= 0:
                    d = apply(rotation_of_link(W, above), d)
                rest = rest + absolute(dot(n, d)) * slide
            elif kind in (REVOLUTE, PLANAR):
                rest = rest + slide
                if turn > 0.0:
                    m = cross(n, apply(rotation_of_link(W, joint), axis_of(tree.constants, joint)))
                    m = scaled(turn, m)
                    constant = dot(m, minus(t, translation_of_link(W, joint)))
                    v = apply_transposed(R, m)
                    width, _ = outward_width(shape, v, dot(v, v))
                    whole = whole + (absolute(dot(v, center) + constant) + width)
                    at = (2 + 4 * count) * LANES
                    store(planes, at, v[0])
                    store(planes, at + LANES, v[1])
                    store(planes, at + 2 * LANES, v[2])
                    store(planes, at + 3 * LANES, constant)
                    count += 1
            else:
                rest = rest + (turn * lever + slide)
    store(planes, 0, rest)
    store(planes, LANES, rest + whole)
    return count
