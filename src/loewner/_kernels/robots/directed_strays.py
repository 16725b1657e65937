"""How far a piece moves towards another body along a normal, at most, if joints deviate from a course.

The bound V of `motion_bounds` adds up what all joints do in all directions. To first order only what a joint moves along
the normal n counts: |n · (z × (x - o))| for a turn about the axis z through o. It is known wherever a configuration has
been placed. See docs/certified.md, "Strays along a normal".
"""

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import ACROSS, PLANAR, PRISMATIC, REVOLUTE
from loewner._kernels.ellipsoids.contact import outward_width
from loewner._kernels.linalg3 import apply, apply_transposed, cross, dot, image, minus
from loewner._kernels.robots.kinematics import axis_of, direction_of, rotation_of_link, translation_of_link
from loewner._kernels.robots.motion_bounds import shared_joints
from loewner._kernels.robots.planes import seen_by
from loewner._kernels.robots.sweeps import outer_center, outer_shape
from loewner._kernels.simd.vectors import absolute, broadcast, store

# Relative errors of the terms, from rounding and from rotations that are accepted as orthonormal.
TERMS = 1e-4  # derived 1.1e-5, certified.md B52


@inline
def longest_lever(tables, ways, astray):
    """Bound the distances of a body's points from all joints between it and another body."""
    return 2.0 * tables.chain[1] + ways.travel + astray.travel


@inline
def error_of_strays(ways, astray, lever, width):
    """Bound what `directed_strays` leaves out within an interval of this width: its second derivative, and rounding."""
    squares = ways.turn * ways.turn + ways.turning
    moved = astray.turn * lever + astray.speed
    between = moved * squares + astray.turn * (2.0 * ways.turn * ways.speed + ways.bend)
    return between * width * width / 8.0 + TERMS * moved


@njit()
def directed_strays(tree, tables, hot, W, strays, lever, link, fixed, piece, n, out):
    """Bound how far a piece's points move along n, to first order, if joints deviate from eight configurations.

    Parameters
    ----------
    tree : Tree
    tables : MotionTables
    hot : ndarray
        Outer ellipsoids of pieces, in the frames of their bodies.
    W : ndarray
        Poses of the links at eight configurations.
    lever : float
        `longest_lever`.
    link, fixed : int
        The piece's link and that of the other body, -1 if it stands.
    piece : int
    n : tuple of 3 float
        Unit normal in the other body's frame.
    strays : Rates
        Deviations of joints, see `motion_bounds.write_strays`.
    out : ndarray, shape (8,)
        Receives the bounds [m].
    """
    n = seen_by(W, fixed, n)
    R, center = rotation_of_link(W, link), outer_center(hot, piece)
    center = broadcast(center[0]), broadcast(center[1]), broadcast(center[2])
    x = image(R, translation_of_link(W, link), center)
    shape, total = outer_shape(hot, piece), broadcast(0.0)
    shared = shared_joints(tables, link, fixed) if fixed >= 0 else 0
    for side in range(2 if fixed >= 0 else 1):
        end = link if side == 0 else fixed
        for k in range(tables.path_start[end] + shared, tables.path_start[end + 1]):
            joint = tables.path_link[k]
            kind, turn, slide = tree.kind[joint], strays.turn[joint], strays.slide[joint]
            if kind == PRISMATIC:
                d, above = direction_of(tree.constants, joint, ACROSS), tree.parent[joint]
                if above >= 0:
                    d = apply(rotation_of_link(W, above), d)
                total = total + absolute(dot(n, d)) * slide
            elif turn > 0.0 and kind in (REVOLUTE, PLANAR):
                m = cross(n, apply(rotation_of_link(W, joint), axis_of(tree.constants, joint)))
                width, _ = outward_width(shape, apply_transposed(R, m), dot(m, m))
                total = total + (absolute(dot(m, minus(x, translation_of_link(W, joint)))) + width) * turn
                total = total + slide
            else:
                total = total + (turn * lever + slide)
    store(out, 0, total)
