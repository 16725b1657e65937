"""How far apart a surface and another piece are, and at least how deep they are in each other.

The nearest boxes first, by lower bounds in single precision; triangles eight at a time; and the nearest pair at last by
GJK, as two pieces of their own, for the normal and the witnesses. Depth is that of the deepest pair of convex parts:
what has to be moved by so much to come apart is at least as deep. For solids a ball of one body, or a point, that lies
within the other says more: it has to come out.
"""

import numpy as np

from loewner._kernels._jit import apart, inline, njit
from loewner._kernels.codes import APART, COLLIDING, DEPTH_FOUND, FREE, NEAREST
from loewner._kernels.columns import (
    COLUMNS,
    FRAME_CENTER,
    FRAME_FACTOR,
    INNER_CENTER,
    INNER_SIGMA,
    KIND,
    LAYOUT,
    OUTER_CENTER,
    POINT,
    POINTS_TO,
    POLYTOPE,
    REACH,
    ROUNDING,
    SEGMENT,
)
from loewner._kernels.linalg3 import apply_transposed, cross, dot, image, minus, negated, plus, scaled
from loewner._kernels.narrow.epa_fast import overlap_depth
from loewner._kernels.narrow.epa_fast import proven_depth as proven_of_polytopes
from loewner._kernels.narrow.epa_robust import DEPTH_ACCURACY, penetration, proven_depth
from loewner._kernels.narrow.epa_robust import workspace as robust_workspace
from loewner._kernels.narrow.gjk_fast import ENTRIES as GJK_ENTRIES
from loewner._kernels.narrow.gjk_fast import begin, place_piece
from loewner._kernels.narrow.gjk_robust import lengths, rounding_error, run, write_simplex
from loewner._kernels.narrow.surface_boxes import (
    between,
    box_at,
    boxes_of,
    is_solid,
    is_surface,
    near_box,
    opens_first,
    plane_gaps,
    push_meeting,
    reach_at,
    reaches_of,
    relation,
    squared_gap,
    squared_gaps,
    surface_of,
    way_along,
)
from loewner._kernels.narrow.surfaces import (
    CORNER_ERROR,
    GJK,
    PLACED,
    PLANE,
    PLANES,
    RESULT,
    SEPARATING,
    STACK,
    WITHIN,
    box_in_frame,
    corners_at,
    gap_to_box,
    keep_plane,
    least,
    measured,
    measured_along,
    most,
    not_beyond,
    placed_corners,
    point_within,
    store_corners,
    surface_pair,
    write_triangle,
)
from loewner._kernels.narrow.surfaces import SIZE as WALK
from loewner._kernels.narrow.triangles import (
    doubt,
    length1,
    longest_edge,
    nearest_on,
    same_side,
    sides,
    squared_distances,
)
from loewner._kernels.pieces.pack import shift_between
from loewner._kernels.pieces.shapes import radius, reach, rotation_of
from loewner._kernels.records import Placed
from loewner._kernels.simd.memory import floats_at, integers_at
from loewner._kernels.simd.vectors import (
    highest,
    load,
    lowest_bit,
    maximum,
    movemask,
    store,
)
from loewner._kernels.trees.triangle_tree import BLOCK, LEAF, WIDE, leaf_of, size_of

# Poses may stretch lengths by 1e-6, and bounds are squared and rounded: so much of a squared lower bound is believed.
BELIEVED = 1.0 - 1e-5  # derived 4e-6, certified.md B41

# Bytes that a triangle takes as a piece of its own: layout, table, points.
PIECE = 8 * (LAYOUT + COLUMNS + 3 * LEAF)

# Memory: that of a walk, a lower bound for each entry of its stack, bounds of a node, and two triangles as pieces.
_BOUNDS = WALK
_LANES = _BOUNDS + 8 * STACK
_PIECES = _LANES + 8 * 2 * WIDE
SIZE = _PIECES + 2 * PIECE  # bytes

# How much the squared distance of middles counts beside a lower bound, for the order of the search.
MIDDLES = 0.1

# Sums of lengths [m] from which on squares of their single precision overflow.
FARTHEST = 1e18

# Inner ellipsoids are larger than this [m], if there is one.
NO_INSIDE = 1e-100

# Points of connected parts that are looked at for depth.
MOST_PARTS = 8


@apart
def surface_distance(A, B, n, limit, faces, edges, memory, result):
    """Signed distance of the cores of two pieces, one at least a surface.

    Parameters
    ----------
    A, B : Placed
    n : tuple of 3 float
        A direction from A to B.
    limit : float
        Distances of cores above this are of no interest.
    faces, edges : ndarray
        Workspace of `epa_fast`.
    memory : int
        Address of SIZE bytes to write to.
    result : ndarray, shape (9,)
        Receives the unit normal from A to B, and the witnesses relative to a's translation.

    Returns
    -------
    distance : float
        inf if it is above the limit. If negative, the depth is at least that, but for rounding (certified.md B49);
        it is that of a pair of convex parts.
    gap : float
        How far bounds on it are apart.
    """
    shift = shift_between(A, B)
    if not lengths(A, B, shift) < FARTHEST:
        return 0.0, np.inf
    verdict, _ = surface_pair(A, B, 0.0, 0.0, memory, memory, 0)
    if verdict != FREE:
        # Faces in one plane are open where all that is not flat is in each other for sure.
        depth = _depth(A, B, shift, n, faces, edges, memory, result)
        if depth > 0.0:
            return -depth, 0.0
    if is_surface(A) and is_surface(B):
        triangle_a, triangle_b = _nearest_triangles(A, B, shift, limit, memory)
        if triangle_a < 0:
            return np.inf, 0.0
        A = triangle_piece(A, triangle_a, 0.0, memory + _PIECES)
        B = triangle_piece(B, triangle_b, 0.0, memory + _PIECES + PIECE)
    elif is_surface(A):
        triangle = _nearest_to_piece(A, B, shift, limit, memory)
        if triangle < 0:
            return np.inf, 0.0
        A = triangle_piece(A, triangle, 0.0, memory + _PIECES)
    else:
        triangle = _nearest_to_piece(B, A, (-shift[0], -shift[1], -shift[2]), limit, memory)
        if triangle < 0:
            return np.inf, 0.0
        B = triangle_piece(B, triangle, 0.0, memory + _PIECES)
    distance, gap = _between_pieces(A, B, shift, n, memory, result)
    # Flat cores in one plane have no depth.
    return (min(distance, 0.0), 0.0) if verdict == COLLIDING else (distance, gap)


@inline
def triangle_piece(P, triangle, rounding, memory):
    """A triangle of a surface, by its block and lane, as a piece of its own, in PIECE bytes of memory.

    `rounding` is its radius: that of the surface, or 0 for the core alone.
    """
    layout = integers_at(memory, (1, LAYOUT))
    table = floats_at(memory + 8 * LAYOUT, (1, COLUMNS))
    points = floats_at(memory + 8 * (LAYOUT + COLUMNS), (3 * LEAF,))
    for c in range(LAYOUT):
        layout[0, c] = 0
    for c in range(COLUMNS):
        table[0, c] = 0.0
    layout[0, KIND], layout[0, POINTS_TO] = POLYTOPE, LEAF
    table[0, REACH], table[0, ROUNDING] = reach(P), rounding
    blocks, at = surface_of(P).blocks, triangle // LEAF * BLOCK + triangle % LEAF
    for axis in range(3):
        for lane in range(LEAF):
            points[axis * LEAF + lane] = blocks[at + (3 * min(lane, 2) + axis) * LEAF]
    return Placed(table, layout, points, 0, P.poses, P.row)


@njit()
def _between_pieces(A, B, shift, n, memory, result):
    """Distance of two convex cores that are apart or nearly touch, and the gap of its bounds."""
    error = rounding_error(A, B, shift)
    W = floats_at(memory + GJK, (GJK_ENTRIES,))
    ends = begin(A, B, shift, W)
    status, below, above = measured(A, B, shift, W, ends, n, error, -np.inf, np.inf, result)
    if status == NEAREST:
        return above, above - below
    G, weights, d = np.empty((4, 9)), np.empty(4), np.empty(3)
    _, below, above, k = run(A, B, shift, n, 0.0, False, G, weights, np.empty(3), d)
    radii = radius(A) + radius(B)  # which `run` takes off
    if k == 4:
        above = -radii
    below = max(below, -radii)  # cores that are in each other for sure do not come here
    write_simplex(G, k, weights, d, result)
    return above + radii, above - below


# -- the nearest triangles --------------------------------------------------------------------------


@njit()
def _nearest_triangles(A, B, shift, limit, memory):
    """Triangles of two surfaces that are nearest to each other, by block and lane; -1 if none comes within `limit`.

    What is too far is told by boxes, and by how far things go along the normal of the nearest triangles so far.
    """
    a, b = surface_of(A), surface_of(B)
    size = lengths(A, B, shift)
    about = relation(A, B, shift, size, 0.0)
    stack, bounds = integers_at(memory, (STACK,)), floats_at(memory + _BOUNDS, (STACK,))
    lanes, placed = floats_at(memory + _LANES, (2 * WIDE,)), floats_at(memory + PLACED, (2 * BLOCK,))
    best = limit * limit
    found_a = found_b = -1
    n, way_a, way_b, away = _ways(A, B, shift, _between_middles(A, B, shift), about.slack)
    stack[0], stack[1], bounds[0] = 0, 0, 0.0
    height, old = 1, 1  # entries below `old` are from before the direction changed
    while height > 0:
        height -= 1
        if bounds[2 * height] * BELIEVED > best:
            continue
        slot_a, slot_b = stack[2 * height], stack[2 * height + 1]
        if height < old:
            old = height
            gap = away - reach_at(a, slot_a, way_a) - reach_at(b, slot_b, way_b)
            if gap > 0.0 and gap * gap * BELIEVED > best:
                continue
        child_a, child_b = a.children[slot_a], b.children[slot_b]
        if child_a < 0 and child_b < 0:
            leaf_a, leaf_b = leaf_of(child_a), leaf_of(child_b)
            reach_a, reach_b = _reaches(a.blocks, leaf_a, way_a.n), _reaches(b.blocks, leaf_b, way_b.n)
            rows = movemask(_near_along((away - highest(reach_b)) - reach_a, best)) & ((1 << size_of(child_a)) - 1)
            columns = movemask(_near_along((away - highest(reach_a)) - reach_b, best)) & ((1 << size_of(child_b)) - 1)
            if rows == 0 or columns == 0:
                continue
            store(lanes, WIDE, reach_a)
            store_corners(placed, 0, placed_corners(A, a.blocks, leaf_a, (0.0, 0.0, 0.0)))
            others = placed_corners(B, b.blocks, leaf_b, shift)
            before = best
            while rows != 0:
                lane = lowest_bit(rows)
                rows &= rows - 1
                corners = corners_at(placed, 0, lane)
                near = _near_along((away - lanes[WIDE + lane]) - reach_b, best)
                bits = movemask(near & (_box_gaps(corners, others) <= best)) & columns
                if bits != 0:
                    bits &= movemask(_middle_gaps(corners, others) <= best)
                if bits == 0:
                    continue
                store(lanes, 0, squared_distances(corners, others))
                while bits != 0:
                    other = lowest_bit(bits)
                    bits &= bits - 1
                    if lanes[other] <= best:
                        best = lanes[other]
                        found_a, found_b = leaf_a * LEAF + lane, leaf_b * LEAF + other
            if best < before:
                S = triangle_piece(A, found_a, 0.0, memory + _PIECES)
                T = triangle_piece(B, found_b, 0.0, memory + _PIECES + PIECE)
                result, W = floats_at(memory + RESULT, (9,)), floats_at(memory + GJK, (GJK_ENTRIES,))
                ends = begin(S, T, shift, W)
                status, _, _ = measured(S, T, shift, W, ends, n, rounding_error(S, T, shift), -np.inf, np.inf, result)
                if status == NEAREST:
                    n, way_a, way_b, away = _ways(A, B, shift, (result[0], result[1], result[2]), about.slack)
                    old = height
            continue
        if opens_first(a, b, slot_a, slot_b):
            along = (away - reach_at(b, slot_b, way_b)) - reaches_of(a, child_a, way_a)
            if movemask(_single_near(along, best)) == 0:
                continue
            middle, half = box_at(b.boxes, slot_b)
            middles, halves = boxes_of(a.boxes, child_a)
            t = between(about, middles, middle)
            gaps = _larger(squared_gaps(about, t, halves, half), along)
            height = push_near(stack, bounds, lanes, height, gaps, t, halves, best, child_a, slot_b, True)
        else:
            along = (away - reach_at(a, slot_a, way_a)) - reaches_of(b, child_b, way_b)
            if movemask(_single_near(along, best)) == 0:
                continue
            middle, half = box_at(a.boxes, slot_a)
            middles, halves = boxes_of(b.boxes, child_b)
            t = between(about, middle, middles)
            gaps = _larger(squared_gaps(about, t, half, halves), along)
            height = push_near(stack, bounds, lanes, height, gaps, t, halves, best, child_b, slot_a, False)
    return found_a, found_b


@inline
def _reaches(blocks, leaf, n):
    """How far the triangles of a leaf go along a direction."""
    at = leaf * BLOCK
    return most(
        dot((load(blocks, at), load(blocks, at + LEAF), load(blocks, at + 2 * LEAF)), n),
        dot((load(blocks, at + 3 * LEAF), load(blocks, at + 4 * LEAF), load(blocks, at + 5 * LEAF)), n),
        dot((load(blocks, at + 6 * LEAF), load(blocks, at + 7 * LEAF), load(blocks, at + 8 * LEAF)), n),
    )


@inline
def _near_along(gap, best):
    """Where gaps along a direction let distances be among the best."""
    gap = maximum(gap, 0.0)
    return gap * gap * BELIEVED <= best


@inline
def _single_near(gap, best):
    """The same in single precision."""
    gap = maximum(gap, np.float32(0.0))
    return gap * gap <= rounded_up(best)


@inline
def rounded_up(best):
    """What a squared lower bound in single precision may be, to be believed and not above the best."""
    return np.float32(best * (1.0 + 2e-5) + 1e-37)


@inline
def _between_middles(A, B, shift):
    """Direction from the middle of one surface to that of the other."""
    t, u, c = A.table, B.table, OUTER_CENTER
    from_a = t[A.piece, c], t[A.piece, c + 1], t[A.piece, c + 2]
    from_b = u[B.piece, c], u[B.piece, c + 1], u[B.piece, c + 2]
    return minus(image(rotation_of(B), shift, from_b), image(rotation_of(A), (0.0, 0.0, 0.0), from_a))


@inline
def _ways(A, B, shift, n, slack):
    """A unit vector, the same along a's axes and its opposite along b's, and how far the frames are apart along it."""
    n = _unit(n)
    a, b = apply_transposed(rotation_of(A), n), apply_transposed(rotation_of(B), negated(n))
    f = np.float32
    way_a, way_b = way_along((f(a[0]), f(a[1]), f(a[2]))), way_along((f(b[0]), f(b[1]), f(b[2])))
    return n, way_a, way_b, f(dot(n, shift)) - slack


@inline
def _larger(squared, gap):
    """The larger of lower bounds on squared distances and on distances."""
    gap = maximum(gap, np.float32(0.0))
    return maximum(gap * gap, squared)


@inline
def push_near(stack, bounds, lanes, height, gaps, t, halves, best, child, other, first):
    """Put the boxes of a node that may be near enough on the stack, the most promising on top.

    Bounds of large boxes are 0 for many at a time; how far their middles are apart, t, still tells which to begin with.
    """
    bits = movemask((gaps <= rounded_up(best)) & (halves[0] >= np.float32(0.0)))
    if bits == 0:
        return height
    store(lanes, 0, gaps)
    store(lanes, WIDE, gaps + np.float32(MIDDLES) * dot(t, t))
    base = height
    while bits != 0:
        lane = lowest_bit(bits)
        bits &= bits - 1
        bound, order = lanes[lane], lanes[WIDE + lane]
        at = height
        while at > base and bounds[2 * at - 1] < order:
            stack[2 * at], stack[2 * at + 1] = stack[2 * at - 2], stack[2 * at - 1]
            bounds[2 * at], bounds[2 * at + 1] = bounds[2 * at - 2], bounds[2 * at - 1]
            at -= 1
        slot = child * WIDE + lane
        stack[2 * at], stack[2 * at + 1] = (slot, other) if first else (other, slot)
        bounds[2 * at], bounds[2 * at + 1] = bound, order
        height += 1
    return height


@inline
def _middle_gaps(a, b):
    """Lower bounds on the squared distances of a triangle from eight, along the lines of their middles."""
    n = minus(plus(plus(b[0], b[1]), b[2]), plus(plus(a[0], a[1]), a[2]))
    near = least(dot(b[0], n), dot(b[1], n), dot(b[2], n))
    gap = maximum(near - most(dot(a[0], n), dot(a[1], n), dot(a[2], n)), 0.0)
    return gap * gap * BELIEVED / (dot(n, n) + 1e-300)  # middles may be the same


@inline
def _box_gaps(a, b):
    """Squared distances of the box of a triangle from those of eight."""
    return _gap(a, b, 0) + _gap(a, b, 1) + _gap(a, b, 2)


@inline
def _gap(a, b, axis):
    low, high = least(a[0][axis], a[1][axis], a[2][axis]), most(a[0][axis], a[1][axis], a[2][axis])
    below = least(b[0][axis], b[1][axis], b[2][axis]) - high
    above = low - most(b[0][axis], b[1][axis], b[2][axis])
    gap = maximum(maximum(below, above), 0.0)
    return gap * gap


@njit()
def _nearest_to_piece(A, B, shift, limit, memory):
    """Triangle of surface A that is nearest to the convex piece B; -1 if none comes within `limit`.

    Each search ends with a plane, and the last few are kept: what lies far beyond one of them is not looked at.
    """
    a = surface_of(A)
    size = lengths(A, B, shift)
    error = rounding_error(A, B, shift)
    W, result = floats_at(memory + GJK, (GJK_ENTRIES,)), floats_at(memory + RESULT, (9,))
    ends = LEAF, place_piece(B, shift, W, LEAF)
    middle, half, single, wide = box_in_frame(A, B, shift, 0.0, size)
    center = image(rotation_of(A), (0.0, 0.0, 0.0), middle)
    stack, bounds = integers_at(memory, (STACK,)), floats_at(memory + _BOUNDS, (STACK,))
    lanes = floats_at(memory + _LANES, (2 * WIDE,))
    placed, planes = floats_at(memory + PLACED, (2 * BLOCK,)), floats_at(memory + SEPARATING, (PLANES * PLANE,))
    R = rotation_of(A)
    best, found, searches = limit, -1, 0
    stack[0], stack[1], bounds[0] = 0, 0, 0.0
    height = 1
    while height > 0:
        height -= 1
        if bounds[2 * height] * BELIEVED > best * best:
            continue
        child = a.children[stack[2 * height]]
        if child >= 0:
            middles, halves = boxes_of(a.boxes, child)
            t = minus(middles, single)
            gaps = squared_gap(t, halves, wide)
            gaps = plane_gaps(middles, halves, planes, min(searches, PLANES), gaps)
            none = 0
            height = push_near(stack, bounds, lanes, height, gaps, t, halves, best * best, child, none, True)
            continue
        leaf = leaf_of(child)
        near = gap_to_box(a.blocks, leaf, middle, half) * BELIEVED <= best * best
        bits = movemask(near) & ((1 << size_of(child)) - 1)
        for k in range(min(searches, PLANES)):
            if bits != 0:
                bits &= not_beyond(a.blocks, leaf, planes, k, best)
        if bits == 0:
            continue
        store_corners(placed, BLOCK, placed_corners(A, a.blocks, leaf, (0.0, 0.0, 0.0)))
        while bits != 0:
            lane = lowest_bit(bits)
            bits &= bits - 1
            corners = corners_at(placed, BLOCK, lane)
            write_triangle(W, 0, corners)
            n = minus(center, corners[0])
            if not dot(n, n) > 0.0:
                n = (1.0, 0.0, 0.0)
            status, _, above, n = measured_along(A, B, shift, W, ends, n, error, -np.inf, best, result)
            k = searches % PLANES
            searches += 1
            keep_plane(B, shift, R, n, size, planes, k)
            if status == APART:
                bits &= not_beyond(a.blocks, leaf, planes, k, best)
                continue
            if status != NEAREST:  # so near to contact that it takes more care
                piece = triangle_piece(A, leaf * LEAF + lane, 0.0, memory + _PIECES)
                above, _ = _between_pieces(piece, B, shift, n, memory, result)
            if above <= best:
                best, found = max(above, 0.0), leaf * LEAF + lane
            bits &= not_beyond(a.blocks, leaf, planes, k, best)
    return found


# -- depth ------------------------------------------------------------------------------------------


@njit()
def _depth(A, B, shift, n, faces, edges, memory, result):
    """At least how deep two pieces that meet are in each other."""
    found = 0.0
    result[0], result[1], result[2] = _unit(n)
    for c in range(6):
        result[3 + c] = 0.0
    own = np.empty(9)
    if is_surface(A) and is_surface(B):
        found = _deepest_triangles(A, B, shift, found, faces, edges, memory, own, result)
    elif is_surface(A):
        found = _deepest_to_piece(A, B, shift, found, 1.0, faces, edges, memory, own, result)
    else:
        found = _deepest_to_piece(
            B, A, (-shift[0], -shift[1], -shift[2]), found, -1.0, faces, edges, memory, own, result
        )
    found = _depth_of_balls(A, B, shift, found, result)
    if is_solid(A):
        found = _deepest_point(A, B, shift, found, 1.0, memory, result)
    if is_solid(B):
        found = _deepest_point(B, A, (-shift[0], -shift[1], -shift[2]), found, -1.0, memory, result)
    return found


@njit()
def _depth_of_balls(A, B, shift, found, result):
    """Depth of the balls about the middles of the inner ellipsoids, if they overlap by more than what was found."""
    a, ball_a = _inner_ball(A, (0.0, 0.0, 0.0))
    b, ball_b = _inner_ball(B, shift)
    way = minus(b, a)
    apart_by = np.sqrt(dot(way, way))
    if not ball_a + ball_b - apart_by > found:
        return found
    n = _unit(way)
    for c in range(3):
        result[c], result[3 + c], result[6 + c] = n[c], a[c] + ball_a * n[c], b[c] - ball_b * n[c]
    return ball_a + ball_b - apart_by


@inline
def _inner_ball(P, shift):
    """Center and radius of a ball inside the core of a piece; the radius is 0 if the piece has no inside."""
    t, c = P.table, INNER_CENTER
    center = image(rotation_of(P), shift, (t[P.piece, c], t[P.piece, c + 1], t[P.piece, c + 2]))
    size = t[P.piece, INNER_SIGMA] * (1.0 - 1e-9) - radius(P)
    return center, size if size > NO_INSIDE else 0.0


@inline
def _unit(n):
    squared = dot(n, n)
    if not 0.0 < squared < np.inf:
        return 0.0, 0.0, 1.0
    return scaled(1.0 / np.sqrt(squared), n)


@njit()
def _deepest_triangles(A, B, shift, found, faces, edges, memory, own, result):
    """Depth of the deepest pair of triangles, if it is more than what was found."""
    a, b = surface_of(A), surface_of(B)
    size = lengths(A, B, shift)
    error, rounding = CORNER_ERROR * size, rounding_error(A, B, shift)
    about = relation(A, B, shift, size, 0.0)
    stack, placed = integers_at(memory, (STACK,)), floats_at(memory + PLACED, (2 * BLOCK,))
    stack[0], stack[1] = 0, 0
    height = 2
    while height > 0:
        height -= 2
        slot_a, slot_b = stack[height], stack[height + 1]
        child_a, child_b = a.children[slot_a], b.children[slot_b]
        if child_a < 0 and child_b < 0:
            leaf_a, leaf_b = leaf_of(child_a), leaf_of(child_b)
            store_corners(placed, 0, placed_corners(A, a.blocks, leaf_a, (0.0, 0.0, 0.0)))
            others = placed_corners(B, b.blocks, leaf_b, shift)
            store_corners(placed, BLOCK, others)
            long_b = longest_edge(others[0], others[1], others[2])
            for lane in range(size_of(child_a)):
                corners = corners_at(placed, 0, lane)
                bits = movemask(_box_gaps(corners, others) <= 0.0) & ((1 << size_of(child_b)) - 1)
                if bits == 0:
                    continue
                long_a = longest_edge(corners[0], corners[1], corners[2])
                side = doubt(long_a, long_a, length1(minus(others[0], corners[0])) + long_a + long_b, error)
                on_a = sides(cross(minus(corners[1], corners[0]), minus(corners[2], corners[1])), corners[0], others)
                bits &= ~movemask(same_side(on_a[0], on_a[1], on_a[2], side))
                while bits != 0:
                    other = lowest_bit(bits)
                    bits &= bits - 1
                    if _most_depth(corners, corners_at(placed, BLOCK, other)) <= found:
                        continue
                    S = triangle_piece(A, leaf_a * LEAF + lane, 0.0, memory + _PIECES)
                    T = triangle_piece(B, leaf_b * LEAF + other, 0.0, memory + _PIECES + PIECE)
                    n = minus(corners_at(placed, BLOCK, other)[0], corners[0])
                    status, _, deep = overlap_depth(S, T, n, faces, edges, own)
                    settled = status == DEPTH_FOUND and deep > found
                    deep = proven_of_polytopes(rounding, faces, edges, own) if settled else 0.0
                    if deep > found:
                        found = deep
                        for c in range(9):
                            result[c] = own[c]
            continue
        height = push_meeting(about, a, b, slot_a, slot_b, stack, height)
    return found


@inline
def _most_depth(a, b):
    """Upper bound on the depth of two triangles: how far they have to go along either normal; 0 if they are apart."""
    n, m = cross(minus(a[1], a[0]), minus(a[2], a[0])), cross(minus(b[1], b[0]), minus(b[2], b[0]))
    return max(min(_overlap(n, a, b), _overlap(m, a, b)), 0.0)


@inline
def _overlap(n, a, b):
    squared = dot(n, n)
    if not squared > 0.0:
        return np.inf
    p, q, r = dot(n, a[0]), dot(n, a[1]), dot(n, a[2])
    s, t, u = dot(n, b[0]), dot(n, b[1]), dot(n, b[2])
    return min(max(p, max(q, r)) - min(s, min(t, u)), max(s, max(t, u)) - min(p, min(q, r))) / np.sqrt(squared)


@njit()
def _deepest_to_piece(A, B, shift, found, sign, faces, edges, memory, own, result):
    """Depth of the triangle of A that is deepest in the convex piece B; the result is turned round if sign is -1."""
    a = surface_of(A)
    middle, half, single, wide = box_in_frame(A, B, shift, 0.0, lengths(A, B, shift))
    stack, rounding = integers_at(memory, (STACK,)), rounding_error(A, B, shift)
    curved = B.layout[B.piece, KIND] != POLYTOPE
    work = robust_workspace(curved)
    G, weights, v, d = np.empty((4, 9)), np.empty(4), np.empty(3), np.empty(3)
    stack[0] = 0
    height = 1
    while height > 0:
        height -= 1
        child = a.children[stack[height]]
        if child >= 0:
            bits = near_box(a.boxes, child, single, wide)
            while bits != 0:
                stack[height] = child * WIDE + lowest_bit(bits)
                height += 1
                bits &= bits - 1
            continue
        leaf = leaf_of(child)
        bits = movemask(gap_to_box(a.blocks, leaf, middle, half) <= 0.0) & ((1 << size_of(child)) - 1)
        while bits != 0:
            S = triangle_piece(A, leaf * LEAF + lowest_bit(bits), 0.0, memory + _PIECES)
            bits &= bits - 1
            if curved:
                _narrow(S)
                status, _, above, k = run(S, B, shift, (0.0, 0.0, 1.0), 0.0, False, G, weights, v, d)
                if k < 4 and above + radius(S) + radius(B) > 0.0:
                    continue
                _, deep = penetration(S, B, shift, DEPTH_ACCURACY, work, own)
                # Of a point or a segment in its plane a triangle is flat: then this proves nothing.
                deep = proven_depth(rounding, work) if deep > found else 0.0
            else:
                status, _, deep = overlap_depth(S, B, (0.0, 0.0, 1.0), faces, edges, own)
                settled = status == DEPTH_FOUND and deep > found
                deep = proven_of_polytopes(rounding, faces, edges, own) if settled else 0.0
            if deep > found:
                found = deep
                _write_turned(own, shift, sign, result)
    return found


@njit()
def _narrow(S):
    """Make a triangle without area, as a piece of its own, the segment or point that it is: EPA knows these cores."""
    p, table = S.points, S.table
    a, b, c = (p[0], p[8], p[16]), (p[1], p[9], p[17]), (p[2], p[10], p[18])
    n = cross(minus(b, a), minus(c, a))
    if dot(n, n) > 0.0:
        return
    ab, bc, ca = minus(b, a), minus(c, b), minus(a, c)
    longest = max(dot(ab, ab), max(dot(bc, bc), dot(ca, ca)))
    start, way = (a, ab) if dot(ab, ab) == longest else ((b, bc) if dot(bc, bc) == longest else (c, ca))
    S.layout[0, KIND], S.layout[0, POINTS_TO] = SEGMENT if longest > 0.0 else POINT, 0
    for k in range(3):
        table[0, FRAME_CENTER + k] = start[k] + 0.5 * way[k]
        table[0, FRAME_FACTOR + 3 * k + 2] = 0.5 * way[k]


@inline
def _write_turned(own, shift, sign, result):
    """Copy a normal and two witnesses; with sign -1 seen from the other body, whose translation is at `shift`."""
    for c in range(3):
        result[c] = sign * own[c]
        if sign > 0.0:
            result[3 + c], result[6 + c] = own[3 + c], own[6 + c]
        else:
            result[3 + c], result[6 + c] = own[6 + c] - shift[c], own[3 + c] - shift[c]


@njit()
def _deepest_point(A, B, shift, found, sign, memory, result):
    """Depth of a ball of B, or of points of its parts, that lies within the solid A."""
    size = lengths(A, B, shift)
    R, own = rotation_of(B), np.empty(9)
    center, ball = _inner_ball(B, shift)
    found = _deeper_point(A, center, ball, size, found, shift, sign, memory, own, result)
    if is_surface(B):
        parts = surface_of(B).parts
        for at in range(0, min(len(parts), 3 * MOST_PARTS), 3):
            x = image(R, shift, (parts[at], parts[at + 1], parts[at + 2]))
            found = _deeper_point(A, x, 0.0, size, found, shift, sign, memory, own, result)
    return found


@njit()
def _deeper_point(A, x, ball, size, found, shift, sign, memory, own, result):
    """Depth of a ball about a point within the solid A, if it is more than what was found."""
    if point_within(A, x, size, memory) != WITHIN:
        return found
    depth, near = nearest_point(A, x, np.inf, size, memory)
    if not depth > 0.0 or not depth + ball > found:
        return found
    n = scaled(1.0 / depth, minus(near, x))
    for c in range(3):
        own[c], own[3 + c], own[6 + c] = n[c], near[c], x[c] - ball * n[c]
    _write_turned(own, shift, sign, result)
    return depth + ball


# -- points -----------------------------------------------------------------------------------------


@njit()
def nearest_point(A, x, limit, size, memory):
    """Distance of a point, in the world's axes from the translation of A, from surface A, and its nearest point.

    inf if it is above `limit`.
    """
    a = surface_of(A)
    R = rotation_of(A)
    # In A's axes, which may be 1e-6 off; the triangles are placed.
    q = dot((R[0], R[3], R[6]), x), dot((R[1], R[4], R[7]), x), dot((R[2], R[5], R[8]), x)
    f = np.float32
    single, slack = (f(q[0]), f(q[1]), f(q[2])), f(1e-5 * size)
    stack, bounds = integers_at(memory, (STACK,)), floats_at(memory + _BOUNDS, (STACK,))
    lanes = floats_at(memory + _LANES, (2 * WIDE,))
    placed = floats_at(memory + PLACED, (2 * BLOCK,))
    best, near = limit * limit, x
    found = -1
    stack[0], stack[1], bounds[0] = 0, 0, 0.0
    height = 1
    while height > 0:
        height -= 1
        if bounds[2 * height] * BELIEVED > best:
            continue
        child = a.children[stack[2 * height]]
        if child >= 0:
            middles, halves = boxes_of(a.boxes, child)
            t = minus(middles, single)
            gaps, none = squared_gap(t, halves, (slack, slack, slack)), 0
            height = push_near(stack, bounds, lanes, height, gaps, t, halves, best, child, none, True)
            continue
        corners = placed_corners(A, a.blocks, leaf_of(child), (0.0, 0.0, 0.0))
        u, v, w = nearest_on(corners, x)
        squared = (u - x[0]) * (u - x[0]) + (v - x[1]) * (v - x[1]) + (w - x[2]) * (w - x[2])
        bits = movemask(squared <= best) & ((1 << size_of(child)) - 1)
        if bits == 0:
            continue
        store(lanes, 0, squared)
        store(placed, 0, u)
        store(placed, LEAF, v)
        store(placed, 2 * LEAF, w)
        while bits != 0:
            lane = lowest_bit(bits)
            bits &= bits - 1
            if lanes[lane] <= best:
                best, found = lanes[lane], lane
                near = placed[lane], placed[LEAF + lane], placed[2 * LEAF + lane]
    return (np.sqrt(best) if found >= 0 else np.inf), near
