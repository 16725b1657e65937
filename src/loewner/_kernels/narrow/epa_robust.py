"""Penetration depth of two placed pieces by an expanding polytope inside A - B.

The depth is the smallest support value h(n) of the Minkowski difference A - B over all unit vectors n. A polytope of
support points grows inside A - B; its face with the smallest offset is pushed out to the support plane until the
offsets of face and plane agree. Offsets may be negative, so the polytope need not contain the origin at the start.

References
----------
van den Bergen (2001), "Proximity queries and penetration depth computation on 3D game objects".
"""

from typing import Any, NamedTuple

import numpy as np

from loewner._kernels._jit import inline, njit
from loewner._kernels.linalg3 import cross, dot, minus, negated, plus, scaled
from loewner._kernels.narrow.gjk_robust import minkowski_support, rounding_error
from loewner._kernels.tolerances import POSITION_ROUNDINGS

# Maximum number of support points. For two polytopes, the search ends at a true face of A - B after a few dozen faces,
# far below this limit. Only curved pieces may reach it: 1,500 support points resolve a sphere's depth to about 1e-6 of
# its radius in the worst case (all directions equally deep), and much better otherwise.
MAX_POINTS = 1500
MAX_FACES = 2 * MAX_POINTS
NO_VOLUME = -2e300  # Value in place of a depth if the Minkowski difference is only a point, a segment or a polygon.

# A face may supply the witnesses if its offset exceeds the smallest offset by at most this multiple of the rounding
# error (1.4e-10 of the lengths), or by at most the gap between the bounds on the depth.
WITNESS_WINDOW = 2e4

# Angle [rad] between the normal and the directions whose support points refine the witnesses. The relative error of the
# depth is the square of this angle.
HAIR = 1e-5

# A face is thin if the sine of the angle at its first corner is below this limit. The normal of a thin face is computed
# with more care.
THIN = 1e-4

DEPTH_ACCURACY = 1e-11  # Accuracy for distance queries.
CONTACT_ACCURACY = 1e-13  # Accuracy that is needed to distinguish touching from a small gap.


class Workspace(NamedTuple):
    """Arrays to which `penetration` writes: support points, faces, and the lists of the face search.

    `count` has one entry: the number of rows of the faces in use, or 0 if the live faces are not a closed surface.
    """

    S: Any
    corners: Any
    neighbors: Any
    normals: Any
    offsets: Any
    alive: Any
    free: Any
    horizon: Any
    stack: Any
    count: Any


@njit()
def _support(A, B, shift, n, S, k):
    """Call `minkowski_support` instead of inlining it, because it has many call sites, each rarely executed."""
    minkowski_support(A, B, shift, n, S, k)


@inline
def _point(S, k):
    return S[k, 0], S[k, 1], S[k, 2]


@njit()
def _face(S, corners, normals, offsets, f):
    """Compute the outward unit normal and offset of face f; return False if it has hardly any area."""
    a, b, c = _point(S, corners[f, 0]), _point(S, corners[f, 1]), _point(S, corners[f, 2])
    u, v, w = minus(b, a), minus(c, b), minus(a, c)
    x, y, z = dot(u, u), dot(v, v), dot(w, w)
    n = cross(w, u)
    area, longest = np.sqrt(dot(n, n)), np.sqrt(x * z)
    if area < THIN * longest:  # Only the two shorter sides give an accurate normal of a thin face.
        most = max(x, max(y, z))
        n = cross(v, w) if x == most else (cross(w, u) if y == most else cross(u, v))
        area, longest = np.sqrt(dot(n, n)), np.sqrt(x * y * z / most)
    if not area > 1e-14 * longest:
        normals[f, 0] = 0.0
        normals[f, 1] = 0.0
        normals[f, 2] = 0.0
        offsets[f] = np.inf
        return False
    n = scaled(1.0 / area, n)
    normals[f, 0], normals[f, 1], normals[f, 2] = n
    offsets[f] = dot(n, plus(a, plus(b, c))) / 3.0
    return True


@njit()
def _first_tetrahedron(A, B, shift, n, S):
    """Write four support points that span a volume, the first two along n and -n, to rows 0..3 of S."""
    # The row numbers are entries of an array, so they are not literals, which Numba treats as types of their own.
    rows = np.arange(5)
    _support(A, B, shift, n, S, rows[0])
    _support(A, B, shift, negated(n), S, rows[1])
    # The third point lies off the line through the first two, and the fourth point off the plane through the first
    # three. Each is the farther of the support points in two opposite directions.
    ex = S[1, 0] - S[0, 0]
    ey = S[1, 1] - S[0, 1]
    ez = S[1, 2] - S[0, 2]
    if abs(ex) <= abs(ey) and abs(ex) <= abs(ez):
        px, py, pz = 0.0, -ez, ey
    elif abs(ey) <= abs(ez):
        px, py, pz = ez, 0.0, -ex
    else:
        px, py, pz = -ey, ex, 0.0
    _farther(A, B, shift, (px, py, pz), S, rows[2])
    ux = S[2, 0] - S[0, 0]
    uy = S[2, 1] - S[0, 1]
    uz = S[2, 2] - S[0, 2]
    _farther(A, B, shift, (ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux), S, rows[3])


@njit()
def _volume(S):
    """Six times the signed volume of the tetrahedron in rows 0..3."""
    ux = S[1, 0] - S[0, 0]
    uy = S[1, 1] - S[0, 1]
    uz = S[1, 2] - S[0, 2]
    vx = S[2, 0] - S[0, 0]
    vy = S[2, 1] - S[0, 1]
    vz = S[2, 2] - S[0, 2]
    return (
        (S[3, 0] - S[0, 0]) * (uy * vz - uz * vy)
        + (S[3, 1] - S[0, 1]) * (uz * vx - ux * vz)
        + (S[3, 2] - S[0, 2]) * (ux * vy - uy * vx)
    )


@njit()
def _flat_normal(S, error, result):
    """Return whether rows 0..3 span no volume; if so, write a unit normal of their plane or line to `result`."""
    ex, ey, ez = S[1, 0] - S[0, 0], S[1, 1] - S[0, 1], S[1, 2] - S[0, 2]
    ux, uy, uz = S[2, 0] - S[0, 0], S[2, 1] - S[0, 1], S[2, 2] - S[0, 2]
    nx, ny, nz = ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux
    long = np.sqrt(ex * ex + ey * ey + ez * ez)
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    if long <= 4.0 * error:
        nx, ny, nz = 1.0, 0.0, 0.0
    elif area <= 4.0 * error * long:
        # If the points lie on a line, take any direction perpendicular to this line.
        if abs(ex) <= abs(ey) and abs(ex) <= abs(ez):
            nx, ny, nz = 0.0, -ez, ey
        elif abs(ey) <= abs(ez):
            nx, ny, nz = ez, 0.0, -ex
        else:
            nx, ny, nz = -ey, ex, 0.0
    elif abs(_volume(S)) > 4.0 * error * area:
        return False
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    result[0] = nx / length
    result[1] = ny / length
    result[2] = nz / length
    return True


@njit()
def _farther(A, B, shift, n, S, k):
    nx, ny, nz = n
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        nx, ny, nz, length = 1.0, 0.0, 0.0, 1.0
    nx /= length
    ny /= length
    nz /= length
    _support(A, B, shift, (nx, ny, nz), S, k)
    one = nx * (S[k, 0] - S[0, 0]) + ny * (S[k, 1] - S[0, 1]) + nz * (S[k, 2] - S[0, 2])
    _support(A, B, shift, (-nx, -ny, -nz), S, k + 1)
    two = nx * (S[k + 1, 0] - S[0, 0]) + ny * (S[k + 1, 1] - S[0, 1]) + nz * (S[k + 1, 2] - S[0, 2])
    if abs(two) > abs(one):
        for c in range(9):
            S[k, c] = S[k + 1, c]


@njit()
def _visible(S, normals, offsets, f, w, error):
    """Return whether the new point w lies in front of face f; a face without area counts as visible."""
    if offsets[f] == np.inf:
        return True
    return normals[f, 0] * S[w, 0] + normals[f, 1] * S[w, 1] + normals[f, 2] * S[w, 2] > offsets[f] + error


@njit()
def _expand(S, corners, neighbors, normals, offsets, alive, free, counts, first, w, error, horizon, stack):
    """Replace all faces visible from point w by a fan around it; return False if the rim does not close."""
    rim = 0
    alive[first] = False
    free[counts[1]] = first
    counts[1] += 1
    # A depth-first search that crosses the edges of each face in order reaches the edges of the rim in order.
    top = 0
    for e in range(2, -1, -1):
        stack[top, 0] = first
        stack[top, 1] = e
        top += 1
    while top > 0:
        top -= 1
        f = stack[top, 0]
        e = stack[top, 1]
        g = neighbors[f, e]
        if not alive[g]:
            continue
        back = 0
        for c in range(3):
            if neighbors[g, c] == f and corners[g, c] == corners[f, (e + 1) % 3]:
                back = c
        if _visible(S, normals, offsets, g, w, error):
            alive[g] = False
            free[counts[1]] = g
            counts[1] += 1
            if top + 2 > stack.shape[0]:
                return False
            stack[top, 0] = g
            stack[top, 1] = (back + 2) % 3
            stack[top + 1, 0] = g
            stack[top + 1, 1] = (back + 1) % 3
            top += 2
        else:
            if rim >= horizon.shape[0]:
                return False
            horizon[rim, 0] = g
            horizon[rim, 1] = back
            rim += 1
    if rim < 3:
        return False
    for r in range(rim):
        g = horizon[r, 0]
        e = horizon[r, 1]
        h = horizon[(r + 1) % rim, 0]
        e2 = horizon[(r + 1) % rim, 1]
        # Face g is not visible: it lies beyond the rim. In the visible face on the other side of the rim edge, this
        # edge runs from corner e+1 of g to corner e of g, where the next rim edge must begin.
        if corners[g, e] != corners[h, (e2 + 1) % 3]:
            return False
    if counts[1] + (MAX_FACES - counts[0]) < rim:
        return False
    made_first = -1
    previous = -1
    for r in range(rim):
        g = horizon[r, 0]
        e = horizon[r, 1]
        if counts[1] > 0:
            counts[1] -= 1
            f = free[counts[1]]
        else:
            f = counts[0]
            counts[0] += 1
        corners[f, 0] = corners[g, (e + 1) % 3]
        corners[f, 1] = corners[g, e]
        corners[f, 2] = w
        neighbors[f, 0] = g
        neighbors[g, e] = f
        alive[f] = True
        _face(S, corners, normals, offsets, f)
        if previous >= 0:
            neighbors[f, 2] = previous
            neighbors[previous, 1] = f
        else:
            made_first = f
        previous = f
    neighbors[made_first, 2] = previous
    neighbors[previous, 1] = made_first
    return True


@njit()
def penetration(A, B, shift, accuracy, work, result):
    """Compute the penetration depth of two cores.

    Parameters
    ----------
    accuracy : float
        Gap between the bounds, relative to the lengths involved, at which the search stops.
    work : Workspace
    result : ndarray, shape (9,)
        Receives the normal (from A to B) and the two deepest points.

    Returns
    -------
    lower, upper : float
        Bounds on the depth, to within `rounding_error`; `upper` is the depth along the returned normal. If the cores
        span no volume, both bounds are `NO_VOLUME`, and `result` holds only a normal.
    """
    lower, upper, astray = _expanded(A, B, shift, accuracy, (1.0, 0.0, 0.0), work, result)
    other = np.empty(9)
    for sign in (1.0, -1.0):
        if astray:
            lower, depth, astray = _expanded(A, B, shift, accuracy, (0.36, 0.48, sign * 0.8), work, other)
            if depth < upper:
                upper = depth
                for k in range(9):
                    result[k] = other[k]
    return lower, upper


@inline
def _known(S, count):
    """Return whether row `count` of the support points repeats an earlier row."""
    is_repeated = False
    for k in range(count):
        is_repeated |= S[k, 0] == S[count, 0] and S[k, 1] == S[count, 1] and S[k, 2] == S[count, 2]
    return is_repeated


@njit()
def _expanded(A, B, shift, accuracy, first, work, result):
    """Do the work of `penetration` with a polytope about `first`; also return whether the search went astray.

    Rounding can leave a dent between thin faces. A point that is already a corner then lies in front of a face, and
    adding this point again and again would never end.
    """
    S, corners, neighbors, normals, offsets, alive, free, horizon, stack, count = work
    count[0] = 0
    error = rounding_error(A, B, shift)
    tolerance = error * (accuracy / POSITION_ROUNDINGS)
    _first_tetrahedron(A, B, shift, first, S)
    for f in range(4):
        alive[f] = True
    if _flat_normal(S, error, result):
        # If the Minkowski difference of the cores has no volume (as for two points or two parallel segments), the depth
        # is zero, because any shift perpendicular to the plane or line of the difference separates the cores. The
        # caller takes the deepest points from GJK.
        return NO_VOLUME, NO_VOLUME, False
    # Each face of the first tetrahedron has the number of the opposite corner. Once the tetrahedron is oriented, the
    # corners of each face run counter-clockwise when seen from outside.
    if _volume(S) < 0.0:  # Swap two corners, so that the faces in the fixed table below point outward.
        for c in range(9):
            S[0, c], S[1, c] = S[1, c], S[0, c]
    table = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
    for f in range(4):
        for c in range(3):
            corners[f, c] = table[f][c]
    for f in range(4):
        for e in range(3):
            a = corners[f, e]
            b = corners[f, (e + 1) % 3]
            for g in range(4):
                for c in range(3):
                    if corners[g, c] == b and corners[g, (c + 1) % 3] == a:
                        neighbors[f, e] = g
        _face(S, corners, normals, offsets, f)
    counts = np.zeros(2, np.int64)
    counts[0] = 4
    used = 4
    upper = np.inf
    lower = -np.inf
    last = -1
    closed, astray = True, False
    while used < MAX_POINTS:
        nearest = -1
        least = np.inf
        for f in range(counts[0]):
            if alive[f] and offsets[f] < least:
                least = offsets[f]
                nearest = f
        if nearest < 0:
            break
        lower = least
        nx = normals[nearest, 0]
        ny = normals[nearest, 1]
        nz = normals[nearest, 2]
        # `minkowski_support` finds the point that is lowest along its argument; for -n, this is the point farthest
        # along n.
        _support(A, B, shift, (-nx, -ny, -nz), S, used)
        height = nx * S[used, 0] + ny * S[used, 1] + nz * S[used, 2]
        if height < upper:
            upper = height
            result[0], result[1], result[2] = nx, ny, nz
        last = nearest
        if upper - least <= tolerance or height - least <= 4.0 * error:
            break
        if _known(S, used):
            # A thin face may be folded over a true face of A - B. Its normal is then opposite to the normal of the true
            # face.
            _support(A, B, shift, (nx, ny, nz), S, used)
            height = -(nx * S[used, 0] + ny * S[used, 1] + nz * S[used, 2])
            astray = height + least > 4.0 * error
            if astray:
                break
            normals[nearest, 0], normals[nearest, 1], normals[nearest, 2] = -nx, -ny, -nz
            offsets[nearest] = -least
            continue
        if not _expand(
            S, corners, neighbors, normals, offsets, alive, free, counts, nearest, used, error, horizon, stack
        ):
            closed, astray = False, True
            break
        used += 1
    count[0] = counts[0] if closed else 0
    if last < 0:
        return -np.inf, np.inf, False
    # If the depth is nearly the same in many directions, the search ends while the faces are still coarse. The support
    # points in directions very close to the best normal span a much finer face.
    if upper - lower > WITNESS_WINDOW * error and _fine_foot(A, B, shift, S, used, result):
        return lower, upper, astray
    # Several faces may lie in the nearest plane; on curved pieces, thin faces may lie in it up to rounding. The face
    # that contains the foot of the origin determines the witnesses.
    window = lower + max(upper - lower, WITNESS_WINDOW * error)
    best = -np.inf
    for f in range(counts[0]):
        if (alive[f] or f == last) and offsets[f] <= window:
            wa, wb, wc = _foot(S, corners, normals, f)
            inside = min(0.0, min(wa, min(wb, wc)))
            if inside > best or (inside == best and offsets[f] < offsets[last]):
                best = inside
                last = f
    _witness(S, corners, normals, last, result)
    return lower, upper, astray


@njit()
def proven_depth(error, work):
    """Lower bound, up to `error`, on the depth that `penetration` has just found; 0 if no depth is proven.

    The faces form a closed surface of points of A - B. If this surface winds around the origin at some distance, a ball
    about the origin lies in A - B (certified.md B49).
    """
    proven = np.inf if work.count[0] > 0 else 0.0
    for f in range(work.count[0]):
        if work.alive[f]:
            a, b, c = work.corners[f, 0], work.corners[f, 1], work.corners[f, 2]
            behind, nearest, _ = plane_with_care(_point(work.S, a), _point(work.S, b), _point(work.S, c), error)
            if not behind:
                return 0.0
            proven = min(proven, nearest)
    return proven


@inline
def plane_with_care(one, two, three, error):
    """Compute the plane of a face from its two shorter sides; the origin should lie behind it.

    Returns
    -------
    behind : bool
        Whether the origin is behind the face by more than rounding. If so, the face winds around the origin in the
        right direction.
    nearest : float
        Least product of the normal with a corner: up to `error`, no point of the face is nearer to the origin.
    n : tuple of 3 float
        The unit normal.
    """
    a, b, c = minus(two, one), minus(three, two), minus(one, three)
    x, y, z = dot(a, a), dot(b, b), dot(c, c)
    longest = max(x, max(y, z))
    n = cross(b, c) if x == longest else (cross(c, a) if y == longest else cross(a, b))
    area = np.sqrt(dot(n, n))
    n = n[0] / area, n[1] / area, n[2] / area
    nearest = min(dot(n, one), min(dot(n, two), dot(n, three)))
    return (nearest - error) * area > error * np.sqrt(x * y * z / longest), nearest, n


@njit()
def _fine_foot(A, B, shift, S, used, result):
    """Compute witnesses for the normal in `result` from the support points of five directions around it.

    Seen along the normal, the foot of the origin must lie in a triangle of three points; if it lies in none, the
    function returns False.
    """
    nx, ny, nz = result[0], result[1], result[2]
    if abs(nx) <= abs(ny) and abs(nx) <= abs(nz):
        ux, uy, uz = 0.0, -nz, ny
    elif abs(ny) <= abs(nz):
        ux, uy, uz = nz, 0.0, -nx
    else:
        ux, uy, uz = -ny, nx, 0.0
    length = np.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    wx, wy, wz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    for r in range(5):
        a = HAIR * ((r == 1) - (r == 2))
        b = HAIR * ((r == 3) - (r == 4))
        _support(A, B, shift, (-(nx + a * ux + b * wx), -(ny + a * uy + b * wy), -(nz + a * uz + b * wz)), S, used + r)
    for p in range(used, used + 5):
        for q in range(p + 1, used + 5):
            for r in range(q + 1, used + 5):
                ap = S[p, 0] * ux + S[p, 1] * uy + S[p, 2] * uz
                aq = S[q, 0] * ux + S[q, 1] * uy + S[q, 2] * uz
                ar = S[r, 0] * ux + S[r, 1] * uy + S[r, 2] * uz
                bp = S[p, 0] * wx + S[p, 1] * wy + S[p, 2] * wz
                bq = S[q, 0] * wx + S[q, 1] * wy + S[q, 2] * wz
                br = S[r, 0] * wx + S[r, 1] * wy + S[r, 2] * wz
                wp = aq * br - ar * bq
                wq = ar * bp - ap * br
                wr = ap * bq - aq * bp
                total = wp + wq + wr
                if total == 0.0:
                    continue
                if wp / total >= -1e-9 and wq / total >= -1e-9 and wr / total >= -1e-9:
                    for c in range(3, 9):
                        result[c] = (wp * S[p, c] + wq * S[q, c] + wr * S[r, c]) / total
                    return True
    return False


@njit()
def _foot(S, corners, normals, f):
    """Barycentric coordinates of the foot of the origin on face f; a negative one means that the foot lies outside."""
    a = corners[f, 0]
    b = corners[f, 1]
    c = corners[f, 2]
    wa = _area(S, normals, f, b, c)
    wb = _area(S, normals, f, c, a)
    wc = _area(S, normals, f, a, b)
    total = wa + wb + wc
    if not total > 0.0:
        return -np.inf, -np.inf, -np.inf
    return wa / total, wb / total, wc / total


@njit()
def _area(S, normals, f, b, c):
    """Twice the area of the triangle (origin, b, c) seen along the normal of face f."""
    ex = S[c, 0] - S[b, 0]
    ey = S[c, 1] - S[b, 1]
    ez = S[c, 2] - S[b, 2]
    return (
        normals[f, 0] * (S[b, 1] * ez - S[b, 2] * ey)
        + normals[f, 1] * (S[b, 2] * ex - S[b, 0] * ez)
        + normals[f, 2] * (S[b, 0] * ey - S[b, 1] * ex)
    )


@njit()
def _witness(S, corners, normals, f, result):
    """Write the normal of face f, and the points of A and B that the foot of the origin on the face represents."""
    wa, wb, wc = _foot(S, corners, normals, f)
    wa = max(wa, 0.0)
    wb = max(wb, 0.0)
    wc = max(wc, 0.0)
    total = wa + wb + wc
    if not total > 0.0:
        wa, wb, wc, total = 1.0, 1.0, 1.0, 3.0
    for m in range(3):
        result[m] = normals[f, m]
    for m in range(3, 9):
        result[m] = (wa * S[corners[f, 0], m] + wb * S[corners[f, 1], m] + wc * S[corners[f, 2], m]) / total


@njit()
def workspace(wanted):
    """Return arrays to which `penetration` writes; further calls can reuse the arrays."""
    points = MAX_POINTS + 8 if wanted else 1
    faces = MAX_FACES if wanted else 1
    return Workspace(
        S=np.empty((points, 9)),
        corners=np.empty((faces, 3), np.int64),
        neighbors=np.empty((faces, 3), np.int64),
        normals=np.empty((faces, 3)),
        offsets=np.empty(faces),
        alive=np.zeros(faces, np.bool_),
        free=np.empty(faces, np.int64),
        horizon=np.empty((faces, 2), np.int64),
        stack=np.empty((faces, 2), np.int64),
        count=np.zeros(1, np.int64),
    )
