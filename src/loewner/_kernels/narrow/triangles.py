"""Intersection tests and distances between one triangle and eight other triangles.

Corners are tuples of three coordinates: floats for the single triangle, and vectors with a lane for each of the eight.
Results are proven for the given errors of the corners; undecided cases are left to the caller.

References
----------
Segura and Feito (2001), "Algorithms to test ray-triangle intersection", J. WSCG 9(3); Guigue and Devillers (2003),
doi:10.1080/10867651.2003.10487580: signs of determinants alone decide. Eberly, Geometric Tools: "Robust computation of
distance between line segments" (2018).
"""

from loewner._kernels._jit import inline
from loewner._kernels.linalg3 import along, cross, dot, minus, scaled
from loewner._kernels.simd.vectors import absolute, maximum, minimum, select
from loewner._kernels.tolerances import UNIT_ROUNDOFF

# The error of a determinant of three differences of corners has two parts. One is at most CORNER_ERRORS times the error
# of a corner times the sum of the three products of two lengths. The other is at most PRODUCT_ROUNDINGS times the
# product of all three lengths. The length of a difference is the sum of its absolute coordinates.
CORNER_ERRORS = 8.0  # certified.md B37
PRODUCT_ROUNDINGS = 16.0 * UNIT_ROUNDOFF  # certified.md B38
_LEAST = 1e-290  # Upper bound on the error from products that underflow.


@inline
def length1(v):
    """Sum of the absolute values of a vector's coordinates."""
    return absolute(v[0]) + absolute(v[1]) + absolute(v[2])


@inline
def longest_edge(a, b, c):
    """Length of the longest edge of a triangle, as the sum of its absolute coordinates."""
    return maximum(length1(minus(b, a)), maximum(length1(minus(c, b)), length1(minus(a, c))))


@inline
def doubt(x, y, z, error):
    """Bound on the error of a determinant of three differences of at most these lengths."""
    return CORNER_ERRORS * error * (x * y + y * z + z * x) + PRODUCT_ROUNDINGS * (x * y * z) + _LEAST


@inline
def same_side(x, y, z, limit):
    """Mask of lanes whose three determinants all have the same sign beyond rounding."""
    return ((x > limit) & (y > limit) & (z > limit)) | ((x < -limit) & (y < -limit) & (z < -limit))


@inline
def _edge_misses(x, y, u, v, w, side, limit):
    """Mask of edges that miss a triangle: both ends lie on one side of the plane, or the line passes outside."""
    beside = ((x > side) & (y > side)) | ((x < -side) & (y < -side))
    above = (u > limit) | (v > limit) | (w > limit)
    below = (u < -limit) | (v < -limit) | (w < -limit)
    return beside | (above & below)


@inline
def _edge_pierces(x, y, u, v, w, side, limit):
    """Mask of edges that pierce a triangle: the ends lie on opposite sides of the plane, and the line passes inside."""
    through = ((x > side) & (y < -side)) | ((x < -side) & (y > side))
    return through & same_side(u, v, w, limit)


@inline
def sides(normal, corner, others):
    """Determinants whose signs decide on which sides of a triangle's plane three corners lie."""
    return (
        dot(normal, minus(others[0], corner)),
        dot(normal, minus(others[1], corner)),
        dot(normal, minus(others[2], corner)),
    )


@inline
def meet(a, b, on_a, side_a, error, long_a, long_b, apart):
    """Masks of the eight triangles `b` that certainly meet triangle `a`, and of the triangles that certainly do not.

    Two triangles meet if an edge of one meets the other triangle. An edge pierces a triangle if its ends lie strictly
    on opposite sides of the plane and its line passes all three edges on the same side. An edge misses a triangle if it
    lies strictly on one side of the plane, or if its line passes edges on different sides. The signs of fifteen
    determinants decide this, if they exceed rounding.

    Parameters
    ----------
    a : tuple of 3 corners, floats
    b : tuple of 3 corners, vectors
    on_a : tuple of 3 vectors
        Result of `sides` for a's plane and the corners of b.
    side_a : vector
        Bounds on the errors of `on_a`.
    error : float
        Bound on the error of a corner's coordinate.
    long_a : float
    long_b, apart : vector
        Lengths of the longest edges, and of the largest difference of corners, as sums of absolute coordinates.

    Returns
    -------
    meeting, missing : mask
    """
    edge_a = minus(a[1], a[0]), minus(a[2], a[1]), minus(a[0], a[2])
    edge_b = minus(b[1], b[0]), minus(b[2], b[1]), minus(b[0], b[2])
    normal_b = cross(edge_b[0], edge_b[1])
    side_b = doubt(long_b, long_b, apart, error)
    limit = doubt(long_a, long_b, apart, error)
    on_b = sides(normal_b, b[0], a)
    d00, d01, d02 = _lines(edge_a[0], a[0], edge_b, b)
    d10, d11, d12 = _lines(edge_a[1], a[1], edge_b, b)
    d20, d21, d22 = _lines(edge_a[2], a[2], edge_b, b)
    meeting = (
        _edge_pierces(on_b[0], on_b[1], d00, d01, d02, side_b, limit)
        | _edge_pierces(on_b[1], on_b[2], d10, d11, d12, side_b, limit)
        | _edge_pierces(on_b[2], on_b[0], d20, d21, d22, side_b, limit)
        | _edge_pierces(on_a[0], on_a[1], d00, d10, d20, side_a, limit)
        | _edge_pierces(on_a[1], on_a[2], d01, d11, d21, side_a, limit)
        | _edge_pierces(on_a[2], on_a[0], d02, d12, d22, side_a, limit)
    )
    missing = same_side(on_b[0], on_b[1], on_b[2], side_b) | (
        _edge_misses(on_b[0], on_b[1], d00, d01, d02, side_b, limit)
        & _edge_misses(on_b[1], on_b[2], d10, d11, d12, side_b, limit)
        & _edge_misses(on_b[2], on_b[0], d20, d21, d22, side_b, limit)
        & _edge_misses(on_a[0], on_a[1], d00, d10, d20, side_a, limit)
        & _edge_misses(on_a[1], on_a[2], d01, d11, d21, side_a, limit)
        & _edge_misses(on_a[2], on_a[0], d02, d12, d22, side_a, limit)
    )
    return meeting, missing


@inline
def _lines(edge, start, edge_b, b):
    """Determinants whose signs decide on which side an edge passes each of the three edges of a triangle."""
    return (
        dot(cross(edge, edge_b[0]), minus(b[0], start)),
        dot(cross(edge, edge_b[1]), minus(b[1], start)),
        dot(cross(edge, edge_b[2]), minus(b[2], start)),
    )


@inline
def _clamped(x):
    """Clamp x to 0 .. 1; NaN becomes 0."""
    return minimum(maximum(x, 0.0), 1.0)


@inline
def _between_edges(start_a, edge_a, over_a, start_b, edge_b, over_b):
    """Squared distances of an edge from eight edges, between points that are nearest up to rounding.

    `over_a` and `over_b` are the reciprocals of the squared lengths. The first guess is the foot of the common normal,
    computed from products of the normal itself. For nearly parallel edges, the usual difference of squares would be
    noise.
    """
    r = minus(start_a, start_b)
    normal = cross(edge_a, edge_b)
    b = dot(edge_b, edge_a)
    f = dot(edge_b, r)
    s = _clamped(dot(cross(edge_b, r), normal) / dot(normal, normal))
    t = _clamped((b * s + f) * over_b)
    s = _clamped((b * t - dot(edge_a, r)) * over_a)
    t = _clamped((b * s + f) * over_b)
    d = minus(along(r, s, edge_a), scaled(t, edge_b))
    return dot(d, d)


@inline
def _pick(second, third, values):
    """Select one of three vectors: the second, the third, or otherwise the first."""
    a, b, c = values
    return (
        select(third, c[0], select(second, b[0], a[0])),
        select(third, c[1], select(second, b[1], a[1])),
        select(third, c[2], select(second, b[2], a[2])),
    )


@inline
def upright(corners, edges):
    """Describe a triangle by its longest edge: the start, the edge, the place of the apex's foot, and the altitude.

    Also returns the reciprocals of the squared lengths of the edge and the altitude.
    """
    first, other, last = dot(edges[0], edges[0]), dot(edges[1], edges[1]), dot(edges[2], edges[2])
    second, third = other > first, last > maximum(first, other)
    start, edge = _pick(second, third, corners), _pick(second, third, edges)
    apex = minus(_pick(second, third, (corners[2], corners[0], corners[1])), start)
    over = 1.0 / maximum(maximum(first, other), last)
    share = dot(apex, edge) * over
    altitude = along(apex, -share, edge)
    return start, edge, share, altitude, over, 1.0 / dot(altitude, altitude)


@inline
def from_face(x, face):
    """Mask of triangles that contain the foot of a point on their planes, and the vectors from the feet to the point.

    The foot on the longest edge comes first, followed by the step from there along the altitude. The remaining vector
    is short, so the error of the altitude's direction, which is large for a sliver, has little effect.
    """
    start, edge, share, altitude, over, over_altitude = face
    r = minus(x, start)
    t = dot(r, edge) * over
    r = along(r, -t, edge)
    s = dot(r, altitude) * over_altitude
    inside = (s >= 0.0) & (t >= s * share) & (t <= 1.0 - s * (1.0 - share))
    return inside, along(r, -s, altitude)


@inline
def _to_face(x, face, least):
    """Squared distance of a point from a face if the foot is inside and the result is below `least`; else `least`."""
    inside, d = from_face(x, face)
    return select(inside, minimum(dot(d, d), least), least)


@inline
def squared_distances(a, b):
    """Squared distances of triangle `a` from the eight triangles `b`, as if no triangle pierced another.

    Each result is the squared distance of two points of the triangles that are nearest up to rounding.

    Parameters
    ----------
    a : tuple of 3 corners, floats
    b : tuple of 3 corners, vectors
    """
    edge_a = minus(a[1], a[0]), minus(a[2], a[1]), minus(a[0], a[2])
    edge_b = minus(b[1], b[0]), minus(b[2], b[1]), minus(b[0], b[2])
    over_a = 1.0 / dot(edge_a[0], edge_a[0]), 1.0 / dot(edge_a[1], edge_a[1]), 1.0 / dot(edge_a[2], edge_a[2])
    over_b = 1.0 / dot(edge_b[0], edge_b[0]), 1.0 / dot(edge_b[1], edge_b[1]), 1.0 / dot(edge_b[2], edge_b[2])
    least = _between_edges(a[0], edge_a[0], over_a[0], b[0], edge_b[0], over_b[0])
    least = minimum(_between_edges(a[0], edge_a[0], over_a[0], b[1], edge_b[1], over_b[1]), least)
    least = minimum(_between_edges(a[0], edge_a[0], over_a[0], b[2], edge_b[2], over_b[2]), least)
    least = minimum(_between_edges(a[1], edge_a[1], over_a[1], b[0], edge_b[0], over_b[0]), least)
    least = minimum(_between_edges(a[1], edge_a[1], over_a[1], b[1], edge_b[1], over_b[1]), least)
    least = minimum(_between_edges(a[1], edge_a[1], over_a[1], b[2], edge_b[2], over_b[2]), least)
    least = minimum(_between_edges(a[2], edge_a[2], over_a[2], b[0], edge_b[0], over_b[0]), least)
    least = minimum(_between_edges(a[2], edge_a[2], over_a[2], b[1], edge_b[1], over_b[1]), least)
    least = minimum(_between_edges(a[2], edge_a[2], over_a[2], b[2], edge_b[2], over_b[2]), least)

    upright_a, upright_b = upright(a, edge_a), upright(b, edge_b)
    for k in range(3):
        least = _to_face(b[k], upright_a, least)
        least = _to_face(a[k], upright_b, least)
    return least


@inline
def nearest_on(corners, x):
    """Points of triangles nearest to a point: on an edge, or the foot on the plane if the foot lies inside.

    Up to rounding, each result is a point of the triangle and the nearest one, however thin the triangle is.
    """
    a, b, c = corners
    edges = minus(b, a), minus(c, b), minus(a, c)
    p, squared = _nearest_on_edge(a, edges[0], x)
    other, less = _nearest_on_edge(b, edges[1], x)
    p, squared = _nearer(p, squared, other, less)
    other, less = _nearest_on_edge(c, edges[2], x)
    p, squared = _nearer(p, squared, other, less)
    inside, d = from_face(x, upright(corners, edges))
    nearer = inside & (dot(d, d) < squared)
    return select(nearer, x[0] - d[0], p[0]), select(nearer, x[1] - d[1], p[1]), select(nearer, x[2] - d[2], p[2])


@inline
def _nearest_on_edge(a, edge, x):
    t = minimum(maximum(dot(minus(x, a), edge) / dot(edge, edge), 0.0), 1.0)
    p = a[0] + t * edge[0], a[1] + t * edge[1], a[2] + t * edge[2]
    d = minus(p, x)
    return p, dot(d, d)


@inline
def _nearer(p, squared, q, other):
    less = other < squared
    return (
        (select(less, q[0], p[0]), select(less, q[1], p[1]), select(less, q[2], p[2])),
        select(less, other, squared),
    )
