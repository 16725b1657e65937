"""Ellipsoids inside the solid that a closed triangle mesh bounds, each proven to be inside.

A seed grows as in IRIS (Deits and Tedrake 2015, doi:10.1007/978-3-319-16595-0_7): planes between the ellipsoid and the
triangles nearest in its own metric cut out a polytope, and the largest ellipsoid of this polytope is the next one.
Planes are found with tolerances, since no proof depends on them: the result is shrunk until a proof holds.

The proof has two parts. No triangle meets the ellipsoid: each lies beyond a plane. The center is inside: the surface
winds around it. Points are inside if their winding number is not zero, whatever its sign, and it is the same for points
without a triangle between them, so all of the ellipsoid is inside.

All lengths are relative: coordinates are moved and scaled so that the mesh's box fits into [-1, 1]³.
"""

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.elementary import cube_root
from loewner._kernels.fits.dense import multiply_lower
from loewner._kernels.fits.mvie import solve_primal_dual
from loewner._kernels.linalg3 import along, cross, dot, minus, plus, scaled
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.tolerances import LEAST_SQUARE, UNIT_ROUNDOFF

# Number of triangles that share a box. They are near each other in space, and most queries concern few boxes.
BLOCK = 32

# Boxes are wider than their triangles by this, which is far more than rounding can move a crossing, and far less than
# any ellipsoid.
WIDER = 1e-14

# Number of chords through the solid tried for each requested ellipsoid, and its limits.
CHORDS = 16
FEWEST_CHORDS = 64
MOST_CHORDS = 512

# Positions of seeds on a chord.
PLACES = (0.5, 0.2, 0.8, 0.1, 0.9)

# Precision of the distances of seeds.
ROUGH = 0.8

# A ray that starts on a triangle leaves it before this length; a wall this thin gets no ellipsoid.
LEAST_CHORD = 1e-6

# The least semi-axis. Rounding grows with its inverse: see `proven`.
LEAST_AXIS = 1e-6

# An ellipsoid that adds less than this share of the largest one's volume is not worth a test.
LEAST_VOLUME = 1e-3

# Largest number of rounds of planes and fit for each seed; a round that grows the volume by less than GROWTH is the
# last.
ROUNDS = 4
GROWTH = 1.02

# Half size of the box, in the ellipsoid's metric, in which a round searches for triangles.
REACH = 6.0

# Limit on the planes of a round. A plane represents all triangles beyond it, and triangles before it by up to a share
# of its distance: CLOSE at first, doubled after every further STEP planes, so that their number stays bounded.
MOST_PLANES = 120
STEP = 30
CLOSE = 0.01

# A fit may meet triangles that a plane represents only nearly. They get their own planes, at most STEP, this many
# times.
REPAIRS = 3

# Approximate number of triangles that a round examines one by one; in a larger mesh, one for each group of neighbours.
NEAR = 4096

# From this size on a mesh gets fewer seeds and rounds.
LARGE = 200_000

# Number of seeds that grow as far as they can, since one large ellipsoid is worth most. Later seeds stay out of the
# existing ellipsoids, except BEYOND, in units of their semi-axes from their centers.
UNCUT = 3
BEYOND = 0.2

# Gap in log-volume of the fits: the loss is smaller than the volume that planes exclude.
FIT_TOLERANCE = 1e-3

# Point of an ellipsoid, in units of its semi-axes, at which the winding number is computed.
OFF_CENTER = 0.0271, 0.0317, 0.0123

# Number of points that measure the share of an ellipsoid that lies in others.
POINTS = 128


# -- triangles and boxes


@inline
def corners(soup, t):
    """Three corners of a triangle."""
    return (
        (soup[t, 0], soup[t, 1], soup[t, 2]),
        (soup[t, 3], soup[t, 4], soup[t, 5]),
        (soup[t, 6], soup[t, 7], soup[t, 8]),
    )


@inline
def lower(L, v):
    """Product of a lower triangular matrix, six numbers in row order, and a vector."""
    return L[0] * v[0], L[1] * v[0] + L[2] * v[1], L[3] * v[0] + L[4] * v[1] + L[5] * v[2]


@inline
def inverse(F):
    """Inverse of a lower triangular matrix, an array, as six numbers in row order."""
    a = 1.0 / F[0, 0]
    c = 1.0 / F[1, 1]
    f = 1.0 / F[2, 2]
    b = -F[1, 0] * a * c
    return a, b, c, -(F[2, 0] * a + F[2, 1] * b) * f, -F[2, 1] * c * f, f


@inline
def six(F):
    """Six numbers of a lower triangular matrix, an array, in row order."""
    return F[0, 0], F[1, 0], F[1, 1], F[2, 0], F[2, 1], F[2, 2]


@njit()
def curve_place(x, y, z, bits):
    """Position of a point of [-1, 1]³ on Morton's curve."""
    cells = 1 << bits
    i = min(max(int((x + 1.0) * 0.5 * cells), 0), cells - 1)
    j = min(max(int((y + 1.0) * 0.5 * cells), 0), cells - 1)
    k = min(max(int((z + 1.0) * 0.5 * cells), 0), cells - 1)
    place = 0
    for bit in range(bits):
        place |= ((i >> bit) & 1) << (3 * bit)
        place |= ((j >> bit) & 1) << (3 * bit + 1)
        place |= ((k >> bit) & 1) << (3 * bit + 2)
    return place


@njit()
def lay_out(vertices, triangles, origin, scale, soup, boxes):
    """Corners of the triangles, moved, scaled and in the order of Morton's curve, and the boxes of blocks of them."""
    total = len(triangles)
    points = np.empty((len(vertices), 3))
    for i in range(len(vertices)):
        for k in range(3):
            points[i, k] = (vertices[i, k] - origin[k]) * scale
    bits = 1
    while bits < 6 and 1 << (3 * bits) < total // 4:
        bits += 1
    places = np.empty(total, np.int32)
    starts = np.zeros((1 << (3 * bits)) + 1, np.int64)
    for t in range(total):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        places[t] = curve_place(
            (points[a, 0] + points[b, 0] + points[c, 0]) / 3.0,
            (points[a, 1] + points[b, 1] + points[c, 1]) / 3.0,
            (points[a, 2] + points[b, 2] + points[c, 2]) / 3.0,
            bits,
        )
        starts[places[t] + 1] += 1
    for i in range(len(starts) - 1):
        starts[i + 1] += starts[i]
    for t in range(total):
        row = starts[places[t]]
        starts[places[t]] += 1
        for corner in range(3):
            v = triangles[t, corner]
            for k in range(3):
                soup[row, 3 * corner + k] = points[v, k]
    for block in range(len(boxes)):
        for k in range(3):
            low = np.inf
            high = -np.inf
            for t in range(block * BLOCK, min(total, (block + 1) * BLOCK)):
                for corner in range(3):
                    low = min(low, soup[t, 3 * corner + k])
                    high = max(high, soup[t, 3 * corner + k])
            boxes[block, k] = 0.5 * (low + high)
            boxes[block, 3 + k] = 0.5 * (high - low) + WIDER


# -- queries of the mesh


@inline
def beyond(direction, a, b, c):
    """Extent of a triangle beyond the origin along a direction, a lower bound on its distance; -inf if none."""
    length2 = dot(direction, direction)
    if not LEAST_SQUARE < length2 < np.inf:
        return -np.inf
    return min(dot(direction, a), dot(direction, b), dot(direction, c)) / np.sqrt(length2)


@inline
def clears(a, b, c, distance):
    """Whether a triangle lies beyond the origin by `distance` along the direction to its middle, a quick test."""
    m = plus(a, plus(b, c))
    ahead = min(dot(m, a), dot(m, b), dot(m, c))
    return ahead > 0.0 and ahead * ahead >= max(distance * distance * dot(m, m), LEAST_SQUARE)


@inline
def nearest_on_edge(a, b):
    """Point of an edge that is nearest to the origin."""
    e = minus(b, a)
    length2 = dot(e, e)
    t = min(max(-dot(a, e) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return along(a, t, e)


@njit()
def separation(a, b, c):
    """Distance of a triangle from the origin, and a direction along which it lies this far beyond the origin.

    The direction is to the nearest point (Ericson, Real-Time Collision Detection, 2005, 5.1.5). In any case the
    triangle lies beyond the origin by the returned value, which is less than its distance if digits are lost.
    """
    ab = minus(b, a)
    ac = minus(c, a)
    d1, d2 = -dot(ab, a), -dot(ac, a)
    d3, d4 = -dot(ab, b), -dot(ac, b)
    d5, d6 = -dot(ab, c), -dot(ac, c)
    if d1 <= 0.0 and d2 <= 0.0:
        q = a
    elif d3 >= 0.0 and d4 <= d3:
        q = b
    elif d6 >= 0.0 and d5 <= d6:
        q = c
    elif d1 * d4 - d3 * d2 <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        q = along(a, d1 / (d1 - d3), ab)
    elif d5 * d2 - d1 * d6 <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        q = along(a, d2 / (d2 - d6), ac)
    elif d3 * d6 - d5 * d4 <= 0.0 and d4 >= d3 and d5 >= d6:
        q = along(b, (d4 - d3) / ((d4 - d3) + (d5 - d6)), minus(c, b))
    else:
        n = cross(ab, ac)
        q = scaled(dot(n, a) / dot(n, n), n)
    distance = beyond(q, a, b, c)
    if distance >= (1.0 - 1e-9) * np.sqrt(dot(q, q)):
        return distance, q
    # Digits were lost, or the origin is on the triangle: take the best of all candidates for the nearest point.
    n = cross(ab, ac)
    if dot(n, a) < 0.0:
        n = scaled(-1.0, n)
    for guess in (n, nearest_on_edge(a, b), nearest_on_edge(b, c), nearest_on_edge(c, a)):
        value = beyond(guess, a, b, c)
        if value > distance:
            distance = value
            q = guess
    return distance, q


@njit()
def clearance(soup, boxes, center, G, limit, precision):
    """Least distance of the triangles to `center`, in the metric that G maps to the Euclidean one; at most `limit`.

    The result is a lower bound; with a `precision` below 1 it may be smaller by this factor, which saves most of the
    search.
    """
    best = limit
    enough = precision * best
    for block in range(len(boxes)):
        y = lower(G, minus((boxes[block, 0], boxes[block, 1], boxes[block, 2]), center))
        hx, hy, hz = boxes[block, 3], boxes[block, 4], boxes[block, 5]
        x = max(abs(y[0]) - abs(G[0]) * hx, 0.0)
        w = max(abs(y[1]) - abs(G[1]) * hx - abs(G[2]) * hy, 0.0)
        z = max(abs(y[2]) - abs(G[3]) * hx - abs(G[4]) * hy - abs(G[5]) * hz, 0.0)
        if x * x + w * w + z * z >= enough * enough:
            continue
        for t in range(block * BLOCK, min(len(soup), (block + 1) * BLOCK)):
            p, q, r = corners(soup, t)
            a = lower(G, minus(p, center))
            b = lower(G, minus(q, center))
            c = lower(G, minus(r, center))
            if clears(a, b, c, enough):
                continue
            distance, _ = separation(a, b, c)
            if distance < best:
                best = distance
                enough = precision * best
                if not best > 0.0:
                    return 0.0
    return enough


@njit()
def winding(soup, boxes, p):
    """Winding number of the surface around a point that is not on it.

    The plane y = p_y cuts the mesh in closed polygons, and their crossings of the ray from the point towards +z are
    counted. Each corner of a polygon is computed from one edge of the mesh, from its lower end to its upper one, so it
    is the same in both triangles of the edge. Rounding therefore moves the polygons, but does not open them: the count
    is exact for a point farther from the mesh than rounding (a few units in 1e16).
    """
    count = 0
    for block in range(len(boxes)):
        if abs(boxes[block, 1] - p[1]) > boxes[block, 4] or abs(boxes[block, 0] - p[0]) > boxes[block, 3]:
            continue
        if boxes[block, 2] + boxes[block, 5] < p[2]:
            continue
        for t in range(block * BLOCK, min(len(soup), (block + 1) * BLOCK)):
            above_a, above_b, above_c = soup[t, 1] > p[1], soup[t, 4] > p[1], soup[t, 7] > p[1]
            if above_a == above_b and above_b == above_c:
                continue
            up_x = up_z = down_x = down_z = 0.0
            for corner in range(3):
                i = 3 * corner
                j = 3 * ((corner + 1) % 3)
                rises = soup[t, j + 1] > p[1]
                if rises == (soup[t, i + 1] > p[1]):
                    continue
                if not rises:
                    i, j = j, i
                share = (p[1] - soup[t, i + 1]) / (soup[t, j + 1] - soup[t, i + 1])
                x = soup[t, i] + share * (soup[t, j] - soup[t, i])
                z = soup[t, i + 2] + share * (soup[t, j + 2] - soup[t, i + 2])
                if rises:
                    up_x, up_z = x, z
                else:
                    down_x, down_z = x, z
            if (up_x > p[0]) == (down_x > p[0]):
                continue
            if up_z + (p[0] - up_x) / (down_x - up_x) * (down_z - up_z) > p[2]:
                count += 1 if up_x > p[0] else -1
    return count


@njit()
def first_hit(soup, boxes, p, u):
    """Length of the ray from `p` along the unit vector `u` to the first triangle after LEAST_CHORD; infinite if none.

    Möller and Trumbore (1997), doi:10.1080/10867651.1997.10487468.
    """
    best = np.inf
    for block in range(len(boxes)):
        w = minus((boxes[block, 0], boxes[block, 1], boxes[block, 2]), p)
        h = boxes[block, 3], boxes[block, 4], boxes[block, 5]
        radius2 = dot(h, h)
        t = dot(w, u)
        if dot(w, w) - t * t > radius2:
            continue
        radius = np.sqrt(radius2)
        if t + radius < 0.0 or t - radius > best:
            continue
        for triangle in range(block * BLOCK, min(len(soup), (block + 1) * BLOCK)):
            a, b, c = corners(soup, triangle)
            ab, ac = minus(b, a), minus(c, a)
            n = cross(u, ac)
            det = dot(ab, n)
            if det == 0.0:
                continue
            s = minus(p, a)
            x = dot(s, n) / det
            if not 0.0 <= x <= 1.0:
                continue
            m = cross(s, ab)
            y = dot(u, m) / det
            if y < 0.0 or x + y > 1.0:
                continue
            t = dot(ac, m) / det
            if LEAST_CHORD < t < best:
                best = t
    return best


# -- growing


@njit()
def collect(soup, boxes, center, G, group, near, ways, distances):
    """Triangles within REACH in the metric of G: their corners, directions to their nearest points, and distances.

    Among `group` neighbours only the nearest is used. Returns their number; 0 if one is at the center.
    """
    found = 0
    least = np.inf
    for block in range(len(boxes)):
        first = block * BLOCK
        last = min(len(soup), first + BLOCK)
        y = lower(G, minus((boxes[block, 0], boxes[block, 1], boxes[block, 2]), center))
        hx, hy, hz = boxes[block, 3], boxes[block, 4], boxes[block, 5]
        if (
            abs(y[0]) - abs(G[0]) * hx > REACH
            or abs(y[1]) - abs(G[1]) * hx - abs(G[2]) * hy > REACH
            or abs(y[2]) - abs(G[3]) * hx - abs(G[4]) * hy - abs(G[5]) * hz > REACH
        ):
            last = first
        for t in range(first, last):
            if t % group == 0 and least < np.inf:
                found += 1
                least = np.inf
            p, q, r = corners(soup, t)
            a = lower(G, minus(p, center))
            b = lower(G, minus(q, center))
            c = lower(G, minus(r, center))
            limit = min(least, 2.0 * REACH)
            if clears(a, b, c, limit):
                continue
            distance, way = separation(a, b, c)
            if not distance > 0.0:
                return 0
            if distance >= limit:
                continue
            least = distance
            distances[found] = distance
            size = np.sqrt(dot(way, way))
            for k in range(3):
                ways[found, k] = way[k] / size
                near[found, k] = a[k]
                near[found, 3 + k] = b[k]
                near[found, 6 + k] = c[k]
        if (first + BLOCK) % group == 0 and least < np.inf:
            found += 1
            least = np.inf
    return found + 1 if least < np.inf else found


@njit()
def choose_planes(near, ways, distances, order, left, count, rows, planes, most):
    """Planes between the unit ball and the triangles `left`, in the given `order`, until no triangle is left.

    They become rows of {y : rows y <= 1}, at most `most`, after the existing `planes`. Returns their number.
    """
    first = planes
    count, nearest = keep_before(near, order, left, count, -1, rows[0], np.inf)  # all of them
    while count > 0 and planes < first + most:
        for k in range(3):
            rows[planes, k] = ways[nearest, k] / distances[nearest]
        close = min(0.5, CLOSE * 2.0 ** ((planes - first) // STEP))
        count, nearest = keep_before(near, order, left, count, nearest, rows[planes], 1.0 - close)
        planes += 1
    return planes


@njit()
def keep_before(near, order, left, count, done, row, edge):
    """Keep the triangles `left` that are not beyond {y : row y = edge} and not `done`; their number, and the first."""
    row = row[0], row[1], row[2]
    kept = 0
    nearest = -1
    least = np.inf
    for j in range(count):
        t = left[j]
        a, b, c = corners(near, t)
        if t == done or (dot(row, a) >= edge and dot(row, b) >= edge and dot(row, c) >= edge):
            continue
        left[kept] = t
        kept += 1
        if order[t] < least:
            least = order[t]
            nearest = t
    return kept, nearest


@njit()
def met(near, found, shift, low, order, left):
    """List in `left` the triangles that an ellipsoid meets by more than FIT_TOLERANCE, with distances; their number."""
    G = inverse(low)
    count = 0
    for t in range(found):
        a, b, c = corners(near, t)
        a, b, c = lower(G, minus(a, shift)), lower(G, minus(b, shift)), lower(G, minus(c, shift))
        if clears(a, b, c, 1.0):
            continue
        distance, _ = separation(a, b, c)
        if distance < 1.0 - FIT_TOLERANCE:
            order[t] = distance
            left[count] = t
            count += 1
    return count


@njit()
def volume(F):
    """Volume of an ellipsoid divided by the volume of the unit ball."""
    return F[0, 0] * F[1, 1] * F[2, 2]


@njit()
def given_rows(cuts, count, center, F, rows):
    """Rows for the box of half size REACH, and for half-spaces {x : n x >= offset} around the center; their number."""
    rows[:6] = 0.0
    for k in range(3):
        rows[2 * k, k] = 1.0 / REACH
        rows[2 * k + 1, k] = -1.0 / REACH
    for i in range(count):
        n = cuts[i, 0], cuts[i, 1], cuts[i, 2]
        slack = dot(n, center) - cuts[i, 3]
        rows[6 + i, 0] = -(F[0] * n[0] + F[1] * n[1] + F[3] * n[2]) / slack
        rows[6 + i, 1] = -(F[2] * n[1] + F[4] * n[2]) / slack
        rows[6 + i, 2] = -F[5] * n[2] / slack
    return 6 + count


@njit()
def grow(soup, boxes, rounds, cuts, count, center, factor):
    """Grow an ellipsoid that no triangle meets, within the first `count` cuts; `factor` is lower triangular."""
    group = 1
    while group * NEAR < len(soup):
        group *= 2
    most = max(len(soup) // group, len(boxes) * BLOCK // group) + 1
    near = np.empty((most, 9))
    ways = np.empty((most, 3))
    distances = np.empty(most)
    order = np.empty(most)
    left = np.empty(most, np.int64)
    rows = np.empty((6 + count + MOST_PLANES + REPAIRS * STEP, 3))
    lam = np.empty(len(rows))
    shift = np.empty(3)
    low = np.zeros((3, 3))
    larger = np.zeros((3, 3))
    for _ in range(rounds):
        middle = center[0], center[1], center[2]
        found = collect(soup, boxes, middle, inverse(factor), group, near, ways, distances)
        if found == 0:
            return
        planes = given_rows(cuts, count, middle, six(factor), rows)
        open_triangles = found
        for i in range(found):
            left[i] = i
            order[i] = distances[i]
        for i in range(6, planes):
            open_triangles, _ = keep_before(near, order, left, open_triangles, -1, rows[i], 1.0)
        planes = choose_planes(near, ways, distances, order, left, open_triangles, rows, planes, MOST_PLANES)
        gap, _ = solve_primal_dual(rows[:planes], planes, 3, FIT_TOLERANCE, shift, low, lam)
        for _ in range(REPAIRS):
            moved = shift[0], shift[1], shift[2]
            open_triangles = met(near, found, moved, low, order, left) if gap < 1.0 else 0
            if open_triangles == 0:
                break
            planes = choose_planes(near, ways, distances, order, left, open_triangles, rows, planes, STEP)
            gap, _ = solve_primal_dual(rows[:planes], planes, 3, FIT_TOLERANCE, shift, low, lam)
        if not gap < 1.0:
            return
        multiply_lower(factor, low, larger, 3)
        moved = plus(middle, lower(six(factor), (shift[0], shift[1], shift[2])))
        share = clearance(soup, boxes, moved, inverse(larger), 1.0, 1.0)
        before = volume(factor)
        after = share**3 * volume(larger)
        if not after > before:
            return
        for j in range(3):
            center[j] = moved[j]
            for k in range(j + 1):
                factor[j, k] = share * larger[j, k]
        if after < GROWTH * before:
            return


# -- seeds


@njit()
def find_seeds(soup, boxes, wanted, seeds, radii):
    """Points on chords perpendicular to the surface, from all over it, and balls around them that it does not meet.

    Returns their number.
    """
    total = len(soup)
    cumulated = np.empty(total)
    area = 0.0
    volume6 = 0.0
    for t in range(total):
        a, b, c = corners(soup, t)
        n = cross(minus(b, a), minus(c, a))
        area += np.sqrt(dot(n, n))
        cumulated[t] = area
        volume6 += dot(n, a)
    found = 0
    if not area > 0.0:
        return 0
    outward = 1.0 if volume6 > 0.0 else -1.0
    for i in range(wanted):
        t = min(np.searchsorted(cumulated, (i + 0.5) / wanted * area), total - 1)
        a, b, c = corners(soup, t)
        # Points in the triangle follow a sequence that leaves no gaps, since one triangle may be a whole side.
        x = (0.5 + 0.7548776662466927 * i) % 1.0
        y = (0.5 + 0.5698402909980532 * i) % 1.0
        if x + y > 1.0:
            x, y = 1.0 - x, 1.0 - y
        start = along(along(a, x, minus(b, a)), y, minus(c, a))
        n = cross(minus(b, a), minus(c, a))
        size = np.sqrt(dot(n, n))
        if not size > 0.0:
            continue
        for side in range(2):
            u = scaled((-outward if side == 0 else outward) / size, n)
            half = 0.5 * first_hit(soup, boxes, start, u)
            if not half < np.inf:
                continue
            if winding(soup, boxes, along(start, half, u)) == 0:
                continue
            for place in PLACES:
                seed = along(start, 2.0 * place * half, u)
                limit = 2.0 * min(place, 1.0 - place) * half
                radius = clearance(soup, boxes, seed, (1.0, 0.0, 1.0, 0.0, 0.0, 1.0), limit, ROUGH)
                if radius > LEAST_AXIS:
                    for k in range(3):
                        seeds[found, k] = seed[k]
                    radii[found] = radius
                    found += 1
            break
    return found


@njit()
def discount(seeds, radii, scores, found, center, factor):
    """Lower the scores of seeds in an ellipsoid to 0, and reduce scores of seeds near it; a score is a length."""
    G = inverse(factor)
    for i in range(found):
        y = lower(G, minus((seeds[i, 0], seeds[i, 1], seeds[i, 2]), (center[0], center[1], center[2])))
        scores[i] = min(scores[i], max(radii[i] * (np.sqrt(dot(y, y)) - 1.0), 0.0))


@njit()
def cut_off(seed, centers, factors, count, cuts):
    """Half-spaces {x : n x >= offset} that keep an ellipsoid grown from a seed out of most of the existing ellipsoids.

    Without them all seeds of a convex solid would grow to the same ellipsoid.
    """
    for i in range(count):
        center = centers[i, 0], centers[i, 1], centers[i, 2]
        G = inverse(factors[i])
        w = lower(G, minus((seed[0], seed[1], seed[2]), center))
        w = scaled(1.0 / np.sqrt(dot(w, w)), w)
        n = G[0] * w[0] + G[1] * w[1] + G[3] * w[2], G[2] * w[1] + G[4] * w[2], G[5] * w[2]
        for k in range(3):
            cuts[i, k] = n[k]
        cuts[i, 3] = dot(n, center) + BEYOND


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
    found = 0
    while found < count:
        best = 0.0
        choice = -1
        for i in range(total):
            share = volume(factors[i]) * left[i] / POINTS
            if share > best:
                best = share
                choice = i
        if choice < 0 or best < LEAST_VOLUME * largest:
            return found
        largest = max(largest, best)
        chosen[found] = choice
        found += 1
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
    return found


@njit()
def prove(soup, boxes, origin, scale, center, factor):
    """Shrink an ellipsoid, in the mesh's own coordinates, until it is proven to be inside; return False if it is not.

    In relative coordinates, where no number is above 1, let G be the computed inverse of the factor F as stored. A
    point z of the unit ball goes to c + F z, which y = G (x - c) takes to G F z, at most 1 + e from the origin with e
    >= |G F - 1|, computed with a bound on its rounding. So no triangle meets the ellipsoid if all of them, mapped by G,
    are farther from the origin.

    Rounding, in units of u: corners and center move by 1 each when they become relative, their difference is rounded by
    2, and the three products and sums of a row of G by another 6, times the row's sum g_k of |G_kj|: 10 g in all for a
    corner, where g is the length of (g_1, g_2, g_3). A corner is at most 2 g from the origin. Whether a triangle lies
    beyond the origin along a direction is tested with its corners: 6 g for the product, 8 g for the direction's length.
    Boxes are WIDER by more than the rounding of their centers. The derivation gives 24 g, and 64 g are used.
    """
    middle = (center[0] - origin[0]) * scale, (center[1] - origin[1]) * scale, (center[2] - origin[2]) * scale
    F = np.empty((3, 3))
    for attempt in range(4):
        for j in range(3):
            for k in range(3):
                F[j, k] = factor[j, k] * scale
        G = inverse(F)
        x, y, z = abs(G[0]), abs(G[1]) + abs(G[2]), abs(G[3]) + abs(G[4]) + abs(G[5])
        g = np.sqrt(x * x + y * y + z * z)
        if not g * LEAST_AXIS <= 1.0:
            return False
        low = six(F)
        error = off_inverse(G, low)
        doubt = 64.0 * UNIT_ROUNDOFF * g
        need = 1.0 + error + doubt
        share = clearance(soup, boxes, middle, G, 2.0 * need - 1.0, 1.0)
        if share >= need:
            # Any point of the ellipsoid is valid; off its center, no ray runs along an edge of a symmetric mesh.
            return winding(soup, boxes, plus(middle, lower(low, OFF_CENTER))) != 0
        shrink = (share - 2.0 * doubt) / (1.0 + 2.0 * error) * (1.0 - attempt * 1e-9)
        if not shrink > 0.0:
            return False
        for j in range(3):
            for k in range(3):
                factor[j, k] *= shrink
    return False


@inline
def off_inverse(G, F):
    """Upper bound on |G F - 1| of two lower triangular matrices, including rounding."""
    a, b = G[1] * F[0], G[2] * F[1]
    c, d, e = G[3] * F[0], G[4] * F[1], G[5] * F[3]
    f, g = G[4] * F[2], G[5] * F[4]
    diagonal = abs(G[0] * F[0] - 1.0) + abs(G[2] * F[2] - 1.0) + abs(G[5] * F[5] - 1.0)
    rounded = 8.0 * UNIT_ROUNDOFF * (3.0 + abs(a) + abs(b) + abs(c) + abs(d) + abs(e) + abs(f) + abs(g))
    return diagonal + abs(a + b) + abs(c + d + e) + abs(f + g) + rounded


@njit()
def inscribed_ellipsoids(vertices, triangles, centers, factors):
    """Write ellipsoids inside a closed mesh to `centers` and `factors`, as many as fit; return their number.

    More are grown than requested. The largest is first.
    """
    count = len(centers)
    origin = np.empty(3)
    size = 0.0
    for k in range(3):
        least = np.inf
        most = -np.inf
        for t in range(len(triangles)):
            for corner in range(3):
                x = vertices[triangles[t, corner], k]
                least = min(least, x)
                most = max(most, x)
        origin[k] = least + 0.5 * (most - least)
        size = max(size, 0.5 * (most - least))
    if not 1e-150 < size < 1e150:
        return 0
    scale = 1.0
    while scale * size > 1.0:
        scale *= 0.5
    while scale * size <= 0.5:
        scale *= 2.0
    total = len(triangles)
    soup = np.empty((total, 9))
    boxes = np.empty(((total + BLOCK - 1) // BLOCK, 6))
    lay_out(vertices, triangles, origin, scale, soup, boxes)

    chords = min(max(CHORDS * count, FEWEST_CHORDS), MOST_CHORDS)
    seeds = np.empty((chords * len(PLACES), 3))
    radii = np.empty(len(seeds))
    found = find_seeds(soup, boxes, chords, seeds, radii)
    tries = min(count + UNCUT - 1 + (0 if total >= LARGE else (count + 1) // 2), len(seeds))
    rounds = ROUNDS - 1 if total >= LARGE else ROUNDS
    grown_centers = np.empty((tries, 3))
    grown_factors = np.zeros((tries, 3, 3))
    cuts = np.empty((tries, 4))
    scores = radii.copy()
    grown = 0
    while found > 0 and grown < tries:
        seed = np.argmax(scores[:found])
        if not scores[seed] > 0.0:
            break
        center, factor = grown_centers[grown], grown_factors[grown]
        for k in range(3):
            center[k] = seeds[seed, k]
            factor[k, k] = radii[seed]
        cut_off(center, grown_centers, grown_factors, grown, cuts)
        grow(soup, boxes, rounds, cuts, grown if grown >= UNCUT else 0, center, factor)
        discount(seeds, radii, scores, found, center, factor)
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
        if prove(soup, boxes, origin, scale, centers[kept], factors[kept]):
            kept += 1
    for i in range(1, kept):  # by insertion, since they are few
        j = i
        while j > 0 and volume(factors[j]) > volume(factors[j - 1]):
            for k in range(3):
                centers[j, k], centers[j - 1, k] = centers[j - 1, k], centers[j, k]
                for m in range(3):
                    factors[j, k, m], factors[j - 1, k, m] = factors[j - 1, k, m], factors[j, k, m]
            j -= 1
    return kept
