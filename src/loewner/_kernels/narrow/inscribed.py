"""Ellipsoids inside the solid that a closed triangle mesh bounds; each is proven to be inside.

A seed grows as in IRIS (Deits and Tedrake 2015, doi:10.1007/978-3-319-16595-0_7). Planes separate the ellipsoid from
the triangles that are nearest to it in its own metric. These planes bound a polytope, and the next ellipsoid is the
largest one in this polytope. The planes are found with tolerances, because no proof depends on them: the result is
shrunk until a proof succeeds.

The proof has two parts. First, no triangle meets the ellipsoid: in the ellipsoid's metric, every triangle is farther
from the center than 1. Second, the center is inside, because the surface winds around it. A point is inside if its
winding number, of either sign, is not zero. Two points with no triangle between them have the same winding number.
Therefore, the whole ellipsoid is inside.
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.codes import NO_LIMIT, UNCOUNTED
from loewner._kernels.elementary import cube_root
from loewner._kernels.fits.dense import multiply_lower
from loewner._kernels.fits.mvie import solve_primal_dual
from loewner._kernels.linalg3 import along, cross, dot, minus, plus, scaled
from loewner._kernels.narrow import surface_boxes as boxes
from loewner._kernels.narrow import surface_walk as walk
from loewner._kernels.narrow.surface_points import winding_number
from loewner._kernels.narrow.triangles import nearest_on
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.simd.vectors import absolute, maximum, movemask, next_lane, select, store
from loewner._kernels.tolerances import UNIT_ROUNDOFF
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, WIDE, leaf_of, longer, size_of

# Number of surface points that are tried for each requested ellipsoid, and the smallest and the largest total number of
# points.
POINTS_ON = 16
FEWEST_ON = 64
MOST_ON = 512

# The search for a ball in the solid, next to a surface point: ROUGH is the factor by which squared distances from the
# center of the ball may be underestimated, which saves most of the search. PLACES are the heights of seeds above the
# surface, relative to the height of the center. A ball is small enough if no triangle is nearer to the center than
# OFF_SURFACE times the radius. SHRINKS is the maximum number of attempts to find such a ball.
ROUGH = 0.8
PLACES = (1.0, 0.3)
OFF_SURFACE = 0.87
SHRINKS = 12

# Smallest allowed semi-axis, relative to the mesh's size. Rounding errors grow with the inverse of the semi-axis; see
# `prove`.
LEAST_AXIS = 1e-6

# Smallest volume that an ellipsoid must add to the ellipsoids chosen before, relative to the volume of the largest one.
# An ellipsoid that adds less is not worth a test.
LEAST_VOLUME = 1e-3

# Maximum number of rounds in which a seed grows. Each round chooses planes and fits an ellipsoid between them. A round
# that enlarges the volume by less than the factor GROWTH is the last.
ROUNDS = 4
GROWTH = 1.02

# Half the edge length, in the ellipsoid's metric, of the box in which a round fits the next ellipsoid. The round
# searches for triangles in the ball around this box.
REACH = 6.0

# Maximum number of planes that a round adds before the first fit. A plane represents all triangles beyond it, and also
# triangles in front of it whose distance from it is at most a certain fraction of the plane's distance from the center.
# This fraction begins at CLOSE and doubles after every STEP planes, so this number of planes is enough.
MOST_PLANES = 120
STEP = 20
CLOSE = 0.01

# Maximum number of repairs of a fit in a round. A fitted ellipsoid may meet triangles that a plane represents only
# approximately. A repair adds planes for up to STEP such triangles, and repeats the fit.
REPAIRS = 3

# Number of seeds that grow as far as they can, because one large ellipsoid is worth the most. Later seeds are kept out
# of most of each existing ellipsoid by a plane. BEYOND is the distance between this plane and the center of the
# existing ellipsoid, in units of this ellipsoid's semi-axes.
UNCUT = 5
BEYOND = 0.2

# Allowed optimality gap of a fit, in the logarithm of the volume. This gap costs less volume than the planes exclude.
FIT_TOLERANCE = 1e-3

# Point of an ellipsoid at which the winding number is computed, in units of the semi-axes.
OFF_CENTER = 0.0271, 0.0317, 0.0123

# Number of points used to estimate what fraction of an ellipsoid lies in other ellipsoids.
POINTS = 128

# Allowed rounding error of a distance from the center, relative to the mesh's size in the ellipsoid's metric; see
# `prove`.
ROUNDINGS = 512.0 * UNIT_ROUNDOFF  # certified.md B71

IDENTITY = (1.0, 0.0, 1.0, 0.0, 0.0, 1.0)


class Mesh(NamedTuple):
    """A mesh, and memory for searches.

    Attributes
    ----------
    tree : surface_boxes.Tree
        Tree over the triangles, whose coordinates are moved and scaled from the mesh's own coordinates.
    size, far : float
        Half the longest edge of the box around the mesh, and a bound on coordinates.
    memory : int
        Address of `surface_walk.SIZE` bytes.
    planes : ndarray
        Planes {x : n x = offset}, each given by four numbers: n and the offset.
    edges : ndarray
        For each plane, the least value of n (x - c) at which a point x counts as beyond the plane; c is the center of
        the current search.
    """

    tree: Any
    size: Any
    far: Any
    memory: Any
    planes: Any
    edges: Any


# -- matrices


@inline
def lower(L, v):
    """Product of a lower triangular matrix (six numbers in row order) and a vector."""
    return L[0] * v[0], L[1] * v[0] + L[2] * v[1], L[3] * v[0] + L[4] * v[1] + L[5] * v[2]


@inline
def upper(L, v):
    """Product of the transpose of a lower triangular matrix (six numbers in row order) and a vector."""
    return L[0] * v[0] + L[1] * v[1] + L[3] * v[2], L[2] * v[1] + L[4] * v[2], L[5] * v[2]


@inline
def inverse(F):
    """Six numbers, in row order, of the inverse of a lower triangular matrix that is given as an array."""
    a = 1.0 / F[0, 0]
    c = 1.0 / F[1, 1]
    f = 1.0 / F[2, 2]
    b = -F[1, 0] * a * c
    return a, b, c, -(F[2, 0] * a + F[2, 1] * b) * f, -F[2, 1] * c * f, f


@inline
def six(F):
    """Six numbers, in row order, of a lower triangular matrix that is given as an array."""
    return F[0, 0], F[1, 0], F[1, 1], F[2, 0], F[2, 1], F[2, 2]


# -- planes


@inline
def normal(mesh, k):
    """Normal of plane k."""
    return mesh.planes[4 * k], mesh.planes[4 * k + 1], mesh.planes[4 * k + 2]


@inline
def slack(mesh, k, center):
    """Distance from a center to plane k, times the length of the plane's normal."""
    return mesh.planes[4 * k + 3] - dot(normal(mesh, k), center)


@inline
def write_plane(mesh, k, n, offset):
    mesh.planes[4 * k], mesh.planes[4 * k + 1], mesh.planes[4 * k + 2] = n
    mesh.planes[4 * k + 3] = offset


# -- the nearest triangle


@inline
def _row_lengths(G):
    """Length of the vector of row sums of a lower triangular matrix, where the sums are of absolute values."""
    x, y, z = abs(G[0]), abs(G[1]) + abs(G[2]), abs(G[3]) + abs(G[4]) + abs(G[5])
    return np.sqrt(x * x + y * y + z * z)


@inline
def _gaps(node_boxes, node, query):
    """Squared lower bounds on the distances of boxes from a center in a metric; infinite beyond one of the planes."""
    (center, rest, G, wider), planes, edges, first, last = query
    middles, halves = boxes.boxes_of(node_boxes, node)
    d = minus(minus(middles, center), rest)
    t = lower(G, d)
    reach = lower((abs(G[0]), abs(G[1]), abs(G[2]), abs(G[3]), abs(G[4]), abs(G[5])), halves)
    x = maximum(absolute(t[0]) - (reach[0] + wider), np.float32(0.0))
    y = maximum(absolute(t[1]) - (reach[1] + wider), np.float32(0.0))
    z = maximum(absolute(t[2]) - (reach[2] + wider), np.float32(0.0))
    gaps = x * x + y * y + z * z
    for k in range(first, last):
        beyond = boxes.farthest(d, halves, planes, 4 * k, -1.0) <= np.float32(-edges[k])
        gaps = select(beyond, np.float32(np.inf), gaps)
    return gaps, t, halves


_next_nearest = walk.nearing(_gaps)


@inline
def _metric(mesh, center, G):
    """Center and metric in single precision, for `_gaps`."""
    c = boxes.singles(center)
    f = np.float32
    wider = f(boxes.ROUNDINGS * mesh.size * _row_lengths(G))
    return c, boxes.singles(minus(center, c)), (f(G[0]), f(G[1]), f(G[2]), f(G[3]), f(G[4]), f(G[5])), wider


@njit()
def least_in(mesh, child, center, G, first, last):
    """Squared distance, and nearest point, of a leaf's nearest triangle not beyond a plane; infinite if all are beyond.

    Distances are from `center`, in the metric of G. The point is relative to the center, in the same metric.
    """
    a, b, c = walk.corners_of(mesh.tree.blocks, leaf_of(child))
    a, b, c = minus(a, center), minus(b, center), minus(c, center)
    bits = (1 << size_of(child)) - 1
    # Try the newest planes first, because only new planes can exclude a leaf that has been examined before.
    for k in range(last - 1, first - 1, -1):
        n, edge = normal(mesh, k), mesh.edges[k]
        bits &= ~movemask((dot(a, n) >= edge) & (dot(b, n) >= edge) & (dot(c, n) >= edge))
        if bits == 0:
            return np.inf, walk.ORIGIN
    p = nearest_on((lower(G, a), lower(G, b), lower(G, c)), walk.ORIGIN)
    placed = walk.placed_of(mesh.memory)
    for k in range(3):
        store(placed, k * LEAF, p[k])
    store(placed, 3 * LEAF, dot(p, p))
    best, at = np.inf, 0
    while bits != 0:
        lane, bits = next_lane(bits)
        if placed[3 * LEAF + lane] < best:
            best, at = placed[3 * LEAF + lane], lane
    return best, (placed[at], placed[LEAF + at], placed[2 * LEAF + at])


@njit()
def nearest(mesh, center, G, limit, share):
    """Lower bound, at most `limit`, on the nearest triangle's distance from a center in G's metric; a near point.

    The square of the bound may be less than the squared distance by the factor `share`.
    """
    query = _metric(mesh, center, G), mesh.planes, mesh.edges, 0, 0
    best, point, height = limit * limit, walk.ORIGIN, walk.begun(mesh.memory)
    while True:
        child, height = _next_nearest(mesh.tree, mesh.memory, height, share * best, query)
        if child >= 0:
            return np.sqrt(share * best), point
        squared, p = least_in(mesh, child, center, G, 0, 0)
        if squared < best:
            best, point = squared, p


@inline
def winds_around(mesh, p):
    """Return whether the surface winds around a point; False if no ray decides."""
    walk.left_of(mesh.memory)[0] = NO_LIMIT
    number = winding_number(mesh.tree, p, 3.0 * mesh.far, mesh.memory)
    return number != 0 and number != UNCOUNTED


# -- a heap with the least key first


@njit()
def pushed(heap, count, key, code):
    """Add an entry to the `count` entries of a heap; return the heap, which is moved if it was full."""
    keys, codes = heap
    if count == len(keys):
        keys, codes = longer(keys), longer(codes)
    at = count
    while at > 0 and keys[(at - 1) // 2] > key:
        keys[at], codes[at] = keys[(at - 1) // 2], codes[(at - 1) // 2]
        at = (at - 1) // 2
    keys[at], codes[at] = key, code
    return keys, codes


@njit()
def popped(heap, count):
    """Remove and return the first entry; `count` entries remain."""
    keys, codes = heap
    first, at, below = (keys[0], codes[0]), 0, 1
    while below < count:
        if below + 1 < count and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= keys[count]:
            break
        keys[at], codes[at] = keys[below], codes[below]
        at, below = below, 2 * below + 1
    keys[at], codes[at] = keys[count], codes[count]
    return first


# -- growing


@njit()
def copy(source, target):
    """Copy a matrix."""
    for j in range(3):
        for k in range(3):
            target[j, k] = source[j, k]


@njit()
def volume(F):
    """Volume of an ellipsoid divided by the volume of the unit ball."""
    return F[0, 0] * F[1, 1] * F[2, 2]


@njit()
def add_planes(mesh, center, G, limit, first, count, most):
    """Add planes between an ellipsoid and its nearest triangles, until all triangles within `limit` are beyond one.

    Triangles beyond one of the planes first .. count need no new plane. At most `most` planes are added. Returns the
    new number of planes; -1 if a triangle passes through the center.
    """
    metric, lanes = _metric(mesh, center, G), walk.lanes_of(mesh.memory)
    # The heap orders boxes by lower bounds on their squared distances, and examined leaves by the squared distances of
    # their nearest triangles.
    heap, held, start = (np.zeros(256), np.zeros(256, np.int64)), 1, count
    while held > 0 and count < start + most:
        held -= 1
        key, slot = popped(heap, held)
        child = mesh.tree.children[slot]
        if child >= 0:
            gaps, _, halves = _gaps(mesh.tree.boxes, child, (metric, mesh.planes, mesh.edges, first, count))
            bits = movemask((gaps <= np.float32(limit * limit)) & (halves[0] >= np.float32(0.0)))
            store(lanes, 0, gaps)
            while bits != 0:
                lane, bits = next_lane(bits)
                heap = pushed(heap, held, lanes[lane], child * WIDE + lane)
                held += 1
            continue
        squared, q = least_in(mesh, child, center, G, first, count)
        if not squared > 0.0:
            return -1
        if squared == key:
            n = upper(G, scaled(1.0 / squared, q))
            write_plane(mesh, count, n, dot(n, center) + 1.0)
            mesh.edges[count] = 1.0 - min(0.5, CLOSE * 2.0 ** ((count - start) // STEP))
            count += 1
        if squared < limit * limit:
            heap = pushed(heap, held, squared, slot)
            held += 1
    return count


@njit()
def write_rows(mesh, count, center, F, rows):
    """Write the rows of the constraints rows y <= 1, for the box of half size REACH and for the planes around a center;
    return the number of rows.
    """
    for side in range(6):
        for k in range(3):
            rows[side, k] = 0.0
        rows[side, side // 2] = (1.0 if side % 2 == 0 else -1.0) / REACH
    for i in range(count):
        row = scaled(1.0 / slack(mesh, i, center), upper(F, normal(mesh, i)))
        rows[6 + i, 0], rows[6 + i, 1], rows[6 + i, 2] = row
    return 6 + count


@njit()
def grow(mesh, count, center, factor):
    """Grow an ellipsoid that no triangle meets, within the first `count` planes; `factor` is lower triangular."""
    rows = np.empty((6 + len(mesh.edges), 3))
    lam = np.empty(len(rows))
    shift = np.empty(3)
    low = np.zeros((3, 3))
    larger = np.zeros((3, 3))
    before = np.empty((3, 3))
    for _ in range(ROUNDS):
        middle = center[0], center[1], center[2]
        copy(factor, larger)
        for k in range(count):
            mesh.edges[k] = slack(mesh, k, middle)
        total = add_planes(mesh, middle, inverse(factor), np.sqrt(3.0) * REACH, 0, count, MOST_PLANES)
        for _ in range(1 + REPAIRS):
            if total < 0:
                return
            used = write_rows(mesh, total, middle, six(larger), rows)
            gap, _ = solve_primal_dual(rows[:used], used, 3, FIT_TOLERANCE, shift, low, lam)
            if not gap < 1.0:
                return
            middle = plus(middle, lower(six(larger), (shift[0], shift[1], shift[2])))
            copy(larger, before)
            multiply_lower(before, low, larger, 3)
            fitted = total
            total = add_planes(mesh, middle, inverse(larger), 1.0 - FIT_TOLERANCE, fitted, fitted, STEP)
            if total == fitted:
                break
        if not winds_around(mesh, middle):
            return
        share, _ = nearest(mesh, middle, inverse(larger), 1.0, 1.0)
        former, latter = volume(factor), share**3 * volume(larger)
        if not latter > former:
            return
        for j in range(3):
            center[j] = middle[j]
            for k in range(j + 1):
                factor[j, k] = share * larger[j, k]
        if latter < GROWTH * former:
            return


# -- seeds


@njit()
def ball_at(mesh, start, n):
    """Find a ball in the solid above a surface point, along its normal n; return the center's height, and the radius.

    The ball shrinks until no triangle is much nearer to its center than the surface point; the radius is 0 if no ball
    is found. See Ma, Bae and Choi (2012), "3D medial axis point approximation using nearest neighbors and the normal
    field", doi:10.1007/s00371-011-0594-7.
    """
    radius = mesh.size  # No ball inside the mesh is larger than the mesh.
    for _ in range(SHRINKS):
        center = along(start, radius, n)
        distance, q = nearest(mesh, center, IDENTITY, radius, ROUGH)
        if distance >= OFF_SURFACE * radius:
            if winds_around(mesh, center):
                return radius, distance
            limit = (1.0 - LEAST_AXIS) * radius  # The center may be outside the solid, behind a thin wall.
            distance, q = nearest(mesh, center, IDENTITY, limit, 1.0)
            if not distance < limit:
                break
        w = along(q, radius, n)
        radius = dot(w, w) / (2.0 * dot(w, n))
    return radius, 0.0


@njit()
def find_seeds(mesh, wanted, seeds, radii):
    """Find balls that no triangle meets, near points all over the surface; return the number of balls."""
    tree = mesh.tree
    cumulated = np.zeros(len(tree.blocks) // BLOCK * LEAF)
    volume6 = 0.0
    for child in tree.children:
        for lane in range(size_of(child) if child < 0 else 0):
            a, b, c = walk.corners_at(tree.blocks, leaf_of(child) * BLOCK, lane)
            n = cross(minus(b, a), minus(c, a))
            cumulated[leaf_of(child) * LEAF + lane] = np.sqrt(dot(n, n))
            volume6 += dot(n, a)
    for t in range(1, len(cumulated)):
        cumulated[t] += cumulated[t - 1]
    area = cumulated[-1]
    seed_count = 0
    if not area > 0.0:
        return 0
    outward = 1.0 if volume6 > 0.0 else -1.0
    for i in range(wanted):
        t = min(np.searchsorted(cumulated, (i + 0.5) / wanted * area), len(cumulated) - 1)
        a, b, c = walk.corners_at(tree.blocks, t // LEAF * BLOCK, t % LEAF)
        # The points in a triangle follow a low-discrepancy sequence, because one triangle may be a whole side of the
        # mesh.
        x = (0.5 + 0.7548776662466927 * i) % 1.0
        y = (0.5 + 0.5698402909980532 * i) % 1.0
        if x + y > 1.0:
            x, y = 1.0 - x, 1.0 - y
        start = along(along(a, x, minus(b, a)), y, minus(c, a))
        n = cross(minus(b, a), minus(c, a))
        length = np.sqrt(dot(n, n))
        if not length > 0.0:
            continue
        for side in range(2):
            way = scaled((-outward if side == 0 else outward) / length, n)
            height, radius = ball_at(mesh, start, way)
            for place in PLACES:
                if radius - (1.0 - place) * height > LEAST_AXIS * mesh.size:
                    seeds[seed_count, 0], seeds[seed_count, 1], seeds[seed_count, 2] = along(start, place * height, way)
                    radii[seed_count] = radius - (1.0 - place) * height
                    seed_count += 1
            if radius > 0.0:
                break
    return seed_count


@njit()
def discount(seeds, radii, scores, found, center, factor):
    """Set the scores of seeds in an ellipsoid to 0, and reduce the scores of seeds near it; a score is a length."""
    G = inverse(factor)
    for i in range(found):
        y = lower(G, minus((seeds[i, 0], seeds[i, 1], seeds[i, 2]), (center[0], center[1], center[2])))
        scores[i] = min(scores[i], max(radii[i] * (np.sqrt(dot(y, y)) - 1.0), 0.0))


@njit()
def cut_off(mesh, seed, centers, factors, count):
    """Write planes that keep the ellipsoid grown from a seed out of most of each existing ellipsoid.

    Without these planes, all seeds in a convex solid would grow to the same ellipsoid.
    """
    for i in range(count):
        center = centers[i, 0], centers[i, 1], centers[i, 2]
        G = inverse(factors[i])
        w = lower(G, minus(center, (seed[0], seed[1], seed[2])))
        n = upper(G, scaled(1.0 / np.sqrt(dot(w, w)), w))
        write_plane(mesh, i, n, dot(n, center) - BEYOND)


# -- choice and proof


@njit()
def spread(centers, factors, total, count, chosen):
    """Choose at most `count` ellipsoids, each adding the most volume to the previous ones; return their number."""
    points = np.empty((POINTS, 3))
    for i in range(POINTS):
        z = 2.0 * (i + 0.5) / POINTS - 1.0
        turn = 2.0 * np.pi * ((0.6180339887498949 * i) % 1.0)
        r = cube_root((0.5 + 0.7548776662466927 * i) % 1.0)
        sine, cosine = sine_cosine(turn)
        points[i, 0] = r * np.sqrt(1.0 - z * z) * cosine
        points[i, 1] = r * np.sqrt(1.0 - z * z) * sine
        points[i, 2] = r * z
    free = np.ones((total, POINTS), np.bool_)
    left = np.full(total, POINTS)
    largest = 0.0
    chosen_count = 0
    while chosen_count < count:
        best = 0.0
        choice = -1
        for i in range(total):
            share = volume(factors[i]) * left[i] / POINTS
            if share > best:
                best = share
                choice = i
        if choice < 0 or best < LEAST_VOLUME * largest:
            return chosen_count
        largest = max(largest, best)
        chosen[chosen_count] = choice
        chosen_count += 1
        G = inverse(factors[choice])
        center = centers[choice, 0], centers[choice, 1], centers[choice, 2]
        for i in range(total):
            F = factors[i]
            shift = minus((centers[i, 0], centers[i, 1], centers[i, 2]), center)
            for p in range(POINTS):
                if free[i, p]:
                    v = points[p, 0], points[p, 1], points[p, 2]
                    x = lower(six(F), v)
                    y = lower(G, plus(shift, x))
                    if i == choice or dot(y, y) < 1.0:
                        free[i, p] = False
                        left[i] -= 1
    return chosen_count


@njit()
def prove(mesh, origin, scale, center, factor):
    """Shrink an ellipsoid, in the mesh's own coordinates, until it is proven inside; return False if no proof succeeds.

    Let F be the stored factor in the tree's coordinates, and G its computed inverse. For a point z of the unit ball,
    the map y = G (x - c) takes the point c + F z of the ellipsoid to G F z. The image G F z is at most 1 + e from the
    origin, where e >= |G F - 1| is computed with a bound on its rounding. If all triangles, mapped by G, are farther
    from the origin, none meets the ellipsoid. docs/certified.md (B71) derives how much rounding may add to the computed
    distance.
    """
    (x, y, z), _ = boxes.box_at(mesh.tree.boxes, 0)
    middle = (center[0] - origin[0]) * scale, (center[1] - origin[1]) * scale, (center[2] - origin[2]) * scale
    if not max(abs(middle[0] - x), abs(middle[1] - y), abs(middle[2] - z)) <= mesh.size:
        return False
    F = np.empty((3, 3))
    for attempt in range(4):
        for j in range(3):
            for k in range(3):
                F[j, k] = factor[j, k] * scale
        G = inverse(F)
        low = six(F)
        g = _row_lengths(G) * mesh.size
        if not g * LEAST_AXIS <= 1.0:
            return False
        error = off_inverse(G, low)
        doubt = ROUNDINGS * g
        need = 1.0 + error + doubt
        share, _ = nearest(mesh, middle, G, 2.0 * need - 1.0, 1.0)
        if share >= need:
            # Any point of the ellipsoid would do, but from the center of a symmetric mesh, a ray could run along an
            # edge.
            return winds_around(mesh, plus(middle, lower(low, OFF_CENTER)))
        shrink = (share - 2.0 * doubt) / (1.0 + 2.0 * error) * (1.0 - attempt * 1e-9)
        if not shrink > 0.0:
            return False
        for j in range(3):
            for k in range(3):
                factor[j, k] *= shrink
    return False


@inline
def off_inverse(G, F):
    """Upper bound on |G F - 1| for two lower triangular matrices, including rounding."""
    a, b = G[1] * F[0], G[2] * F[1]
    c, d, e = G[3] * F[0], G[4] * F[1], G[5] * F[3]
    f, g = G[4] * F[2], G[5] * F[4]
    diagonal = abs(G[0] * F[0] - 1.0) + abs(G[2] * F[2] - 1.0) + abs(G[5] * F[5] - 1.0)
    rounded = 8.0 * UNIT_ROUNDOFF * (3.0 + abs(a) + abs(b) + abs(c) + abs(d) + abs(e) + abs(f) + abs(g))
    return diagonal + abs(a + b) + abs(c + d + e) + abs(f + g) + rounded


@njit()
def inscribed_ellipsoids(table, size, far, origin, scale, centers, factors, memory):
    """Find at most as many ellipsoids inside a closed mesh as `centers` and `factors` can hold; return their number.

    More ellipsoids are grown than requested. The largest ellipsoid comes first.

    Parameters
    ----------
    table : int
        Address of the table of a tree over the mesh's triangles; a coordinate of the tree is the mesh's coordinate less
        `origin`, times `scale`.
    size, far : float
        Half the longest edge of the box around the tree, and a bound on the tree's coordinates.
    origin : ndarray, shape (3,)
    scale : float
        A power of two.
    centers : ndarray, shape (n, 3)
    factors : ndarray, shape (n, 3, 3)
    memory : int
        Address of `mesh_points.points_memory()` bytes.
    """
    count = len(centers)
    wanted = min(max(POINTS_ON * count, FEWEST_ON), MOST_ON)
    seeds = np.empty((wanted * len(PLACES), 3))
    radii = np.empty(len(seeds))
    tries = min(count + UNCUT - 1 + count // 4, len(seeds))
    capacity = tries + MOST_PLANES + REPAIRS * STEP + STEP
    mesh = Mesh(boxes.tree_at(table), size, far, memory, np.empty(4 * capacity), np.empty(capacity))
    seed_count = find_seeds(mesh, wanted, seeds, radii)
    grown_centers = np.empty((tries, 3))
    grown_factors = np.zeros((tries, 3, 3))
    scores = radii.copy()
    grown = 0
    while seed_count > 0 and grown < tries:
        seed = np.argmax(scores[:seed_count])
        if not scores[seed] > 0.0:
            break
        center, factor = grown_centers[grown], grown_factors[grown]
        for k in range(3):
            center[k] = seeds[seed, k]
            factor[k, k] = radii[seed]
        cut_off(mesh, center, grown_centers, grown_factors, grown)
        grow(mesh, grown if grown >= UNCUT else 0, center, factor)
        discount(seeds, radii, scores, seed_count, center, factor)
        scores[seed] = 0.0
        grown += 1

    chosen = np.empty(count, np.int64)
    picked = spread(grown_centers, grown_factors, grown, count, chosen)
    kept = 0
    for i in range(picked):
        for j in range(3):
            centers[kept, j] = grown_centers[chosen[i], j] / scale + origin[j]
            for k in range(3):
                factors[kept, j, k] = grown_factors[chosen[i], j, k] / scale
        if prove(mesh, origin, scale, centers[kept], factors[kept]):
            kept += 1
    for i in range(1, kept):  # Insertion sort is fast enough, because there are few ellipsoids.
        j = i
        while j > 0 and volume(factors[j]) > volume(factors[j - 1]):
            for k in range(3):
                centers[j, k], centers[j - 1, k] = centers[j - 1, k], centers[j, k]
                for m in range(3):
                    factors[j, k, m], factors[j - 1, k, m] = factors[j - 1, k, m], factors[j, k, m]
            j -= 1
    return kept
