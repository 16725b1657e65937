"""Algorithms for hulls with many vertices; their time does not grow with vertices times faces.

For every face, the farthest vertices along its normal are needed. A map of directions (`pieces.directions`) leaves a
few dozen candidates. The map is made in coordinates of unit size, y = F⁻¹ (v - o), where no hull is thin: n·(v - w) =
e·(y_v - y_w) with e = Fᵀ n.

The vertices that the map omits must not matter to any face. The slack of the map therefore covers two amounts: the
difference between the computed heights n·(v - c) and e·y, and the window of heights that count as lying in the face.
Let u be the unit roundoff, R the largest |y|, and B = ‖|F⁻¹||F|‖ >= √3:

- |n|ᵀ|v - c| = |F⁻ᵀ e|ᵀ|F (y_v - y_c)| <= 2 B R |e|, so two computed heights err by 2 · 5 u · 2 B R |e| together;
- the error of the computed e is 3 u |F|ᵀ|n|, and the error of a y is 4 u |F⁻¹||F||y|: 14 u B R |e| for two vertices;
- the window is `FACE_WIDTH` of a width of at most 2 R |e|, and `FACE_ROUNDING` roundings of at most 2 √3 B R |e|;
- |e| is at most √3 times the largest entry of e, to which the slack refers; the map's own clearance is 34 u R.

The sum is at most R (3.5 FACE_WIDTH + 464 u B).
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.columns import DEEPEST
from loewner._kernels.elementary import exponential
from loewner._kernels.fits.dense import invert_lower
from loewner._kernels.fits.mvce import ROUNDING, condition, to_frame
from loewner._kernels.fits.mvie import solve_primal_dual
from loewner._kernels.pieces.directions import candidates, map_within, place
from loewner._kernels.tolerances import FACE_WIDTH

# Largest number of vertices for which every vertex is tried for each face. For more vertices, a map is faster (measured
# in docs/design/many_points.md).
MANY = 256

# Number of cells along each edge of a cube; each face of the cube is divided into SIDE² cells. The directions through a
# cell form a sector. In each round, at most one face of the polytope per sector joins the working set.
SIDE = 4
SECTORS = 6 * SIDE * SIDE
# Maximum number of rounds; six are typical. If these rounds are not enough, the problem is solved with all faces.
MAX_ROUNDS = 40


@njit()
def frame_map(vertices, origin, frame):
    """Make the map of the vertices in the coordinates of a frame, see `face_map`."""
    m, n = vertices.shape
    y = np.empty((m, n))
    for i in range(m):
        to_frame(vertices[i], origin, frame, y[i], n)
    return face_map(y, frame)


@njit()
def face_map(y, frame):
    """Make a map of vertices with the coordinates y (m, 3): the leaves' vertices, and the nodes as a flat array."""
    inverse = np.empty((3, 3))
    invert_lower(frame, inverse, 3)
    largest = 0.0
    for i in range(len(y)):
        largest = max(largest, y[i, 0] * y[i, 0] + y[i, 1] * y[i, 1] + y[i, 2] * y[i, 2])
    slack = np.sqrt(largest) * (4.0 * FACE_WIDTH + 512.0 * ROUNDING * condition(frame, inverse, 3))
    columns, table = map_within(y, slack)
    nodes = np.empty(2 * len(table))
    for i in range(len(table)):
        nodes[2 * i], nodes[2 * i + 1] = table[i, 0], table[i, 1]
    return columns, nodes


@inline
def leaf(frame, nodes, normal, sign):
    """First and last+1 column of the vertices that can be the farthest along sign times the normal of a face."""
    x = frame[0, 0] * normal[0] + frame[1, 0] * normal[1] + frame[2, 0] * normal[2]
    y = frame[1, 1] * normal[1] + frame[2, 1] * normal[2]
    z = frame[2, 2] * normal[2]
    return candidates(nodes, 0, 0, sign * x, sign * y, sign * z)


@inline
def height(vertices, i, normal, reference):
    """n·(v - reference) for vertex i."""
    return (
        normal[0] * (vertices[i, 0] - reference[0])
        + normal[1] * (vertices[i, 1] - reference[1])
        + normal[2] * (vertices[i, 2] - reference[2])
    )


@inline
def highest(vertices, frame, columns, nodes, normal, reference):
    """Largest n·(v - reference) over all vertices."""
    top = -np.inf
    first, last = leaf(frame, nodes, normal, 1.0)
    for a in range(first, last):
        top = max(top, height(vertices, columns[a], normal, reference))
    return top


@inline
def lowest(vertices, frame, columns, nodes, normal, reference):
    """Smallest n·(v - reference) over all vertices."""
    bottom = np.inf
    first, last = leaf(frame, nodes, normal, -1.0)
    for a in range(first, last):
        bottom = min(bottom, height(vertices, columns[a], normal, reference))
    return bottom


@inline
def lowest_above(vertices, frame, columns, nodes, normal, reference, edge):
    """Smallest n·(v - reference) at `edge` or above; `edge` must not be below the window under the largest value."""
    low = np.inf
    first, last = leaf(frame, nodes, normal, 1.0)
    for a in range(first, last):
        value = height(vertices, columns[a], normal, reference)
        if value >= edge:
            low = min(low, value)
    return low


@njit()
def reaches(vertices, reference, out):
    """Largest |v - reference| along each axis."""
    m, n = vertices.shape
    for k in range(n):
        out[k] = 0.0
        for i in range(m):
            out[k] = max(out[k], abs(vertices[i, k] - reference[k]))


@njit()
def solve_with_few(A, tol, x, low, lam):
    """Solve as `mvie.solve_primal_dual` does, for many faces in 3-D, with a working set.

    The set begins with the nearest face of each sector. A round solves for the set, and adds the face of each sector
    that cuts farthest into the ellipsoid. Faces that cost less than a quarter of the tolerance stay out, with
    multipliers of zero; the caller scales the ellipsoid until it is inside all faces.

    Returns (gap, iterations), with the gap for the faces of the set.
    """
    m, n = A.shape
    capacity = min(m, (MAX_ROUNDS + 1) * SECTORS)
    index = np.empty(capacity, np.int64)
    X = np.empty((capacity, n))
    weights = np.empty(capacity)
    best = np.empty(SECTORS)
    best_at = np.empty(SECTORS, np.int64)
    count = 0
    iterations = 0
    _nearest(A, best, best_at)
    for _ in range(MAX_ROUNDS):
        fresh = 0
        for s in range(SECTORS):
            is_listed = best_at[s] < 0
            for a in range(count):
                is_listed = is_listed or index[a] == best_at[s]
            if not is_listed and count < capacity:
                index[count] = best_at[s]
                for k in range(n):
                    X[count, k] = A[best_at[s], k]
                count += 1
                fresh += 1
        if fresh == 0:
            break
        gap, steps = solve_primal_dual(X[:count], count, n, 0.25 * tol, x, low, weights)
        iterations += steps
        if not gap < np.inf:
            break
        if _sticking_in(A, x, low, exponential(0.25 * tol / n), best, best_at) == 0:
            for i in range(m):
                lam[i] = 0.0
            for a in range(count):
                lam[index[a]] = weights[a]
            return gap, iterations
    gap, steps = solve_primal_dual(A, m, n, 0.25 * tol, x, low, lam)
    return gap, iterations + steps


@inline
def _sector(x, y, z):
    face, s, t = place(x, y, z)
    shift = DEEPEST - 2  # SIDE is 2².
    return SIDE * (SIDE * face + (s >> shift)) + (t >> shift)


@njit()
def _nearest(A, best, best_at):
    """Find, in each sector, the face {a·x <= 1} that is nearest to the origin."""
    for s in range(SECTORS):
        best[s] = 0.0
        best_at[s] = -1
    for i in range(len(A)):
        s = _sector(A[i, 0], A[i, 1], A[i, 2])
        norm2 = A[i, 0] * A[i, 0] + A[i, 1] * A[i, 1] + A[i, 2] * A[i, 2]
        if norm2 > best[s]:
            best[s] = norm2
            best_at[s] = i


@njit()
def _sticking_in(A, x, low, limit, best, best_at):
    """In each sector, find the face that the ellipsoid exceeds most, if by more than `limit`.

    Return how many faces the ellipsoid exceeds by more than `limit`, in all sectors together.
    """
    for s in range(SECTORS):
        best[s] = limit
        best_at[s] = -1
    count = 0
    for i in range(len(A)):
        a, b, c = A[i, 0], A[i, 1], A[i, 2]
        p = low[0, 0] * a + low[1, 0] * b + low[2, 0] * c
        q = low[1, 1] * b + low[2, 1] * c
        r = low[2, 2] * c
        slack = 1.0 - (a * x[0] + b * x[1] + c * x[2])
        reach = np.sqrt(p * p + q * q + r * r)
        if reach > limit * slack:
            ratio = reach / slack if slack > 0.0 else np.inf
            s = _sector(p, q, r)
            if ratio > best[s]:
                best[s] = ratio
                best_at[s] = i
            count += 1
    return count


@njit()
def mark_beyond(first, last, points, center, rows, nodes, limit, beyond):
    """Mark the points among first..last-1 for which some row·(point - center) is at least `limit`.

    `rows` and `nodes` are the leaves and the nodes of a map of the rows.
    """
    for i in range(first, last):
        x, y, z = points[i, 0] - center[0], points[i, 1] - center[1], points[i, 2] - center[2]
        start, stop = candidates(nodes, 0, 0, x, y, z)
        top = -np.inf
        for a in range(start, stop):
            top = max(top, rows[a, 0] * x + rows[a, 1] * y + rows[a, 2] * z)
        beyond[i] = not top < limit
