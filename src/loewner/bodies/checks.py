"""Check every property on which a verdict depends, before a kernel reads the arrays of a file.

A file is untrusted, even if its checksum is right: an attacker can compute checksums, too. A property is therefore
checked if its violation could let a kernel read past an array, loop forever, or return a wrong FREE. The tests have
tolerances for their own rounding (`DOUBT`, `ROUNDINGS`), so that a file written by any version of loewner passes.

One property cannot be tested without fitting again: whether the inner ellipsoids are the largest and the outer
ellipsoids the smallest. No verdict depends on this property. It affects only the tightness of the bounds and the last
digits of `gaps`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels import columns, tolerances
from loewner.bodies import surfaces
from loewner.bodies.kinds import CURVED, KIND_NAMES, ROUND
from loewner.bodies.layout import ARRAYS, LARGEST, Maps, PieceArrays, direction_maps, heights_of
from loewner.bodies.pack import Packed
from loewner.bodies.primitives import ellipsoids_in_frame
from loewner.errors import InputError

# The relative tolerance of the tests is DOUBT plus ROUNDINGS times the aspect ratio of the piece, but at most
# MOST_DOUBT. The second term is for thin pieces: relative to their thickness, their coordinates have fewer accurate
# digits.
DOUBT, ROUNDINGS, MOST_DOUBT = 1e-9, 64 * 2.0**-53, 0.05

# Largest aspect ratio of an ellipsoid that can be inverted in float64. Polytopes as flat as this cannot be made.
MOST_ASPECT = 1e15

# Vectors below this length, in units of an inner ellipsoid, have no reliable direction: their squares may underflow.
SHORTEST = 1e-100

# Share by which poses may have stretched the ellipsoids of capsules and spheres. The stored radius is not stretched.
BEND = 4 * tolerances.ROTATION_TOLERANCE

# BLOCK is the approximate number of points and planes in a block of polytopes. AT_ONCE is the approximate number of
# products computed at a time.
BLOCK, AT_ONCE = 1 << 14, 1 << 16

# Axes of curved pieces are orthogonal to this accuracy, even if the pieces were moved by a hundred poses that are
# barely accepted as rigid.
MOST_SKEW = 1e-4

# Limit on the average number of candidates per plane and vertex in the search for farthest vertices of large polytopes.
# The direction map leaves about forty candidates per plane. If the points of a file are not the vertices of a hull, the
# map could leave all points.
MOST_CANDIDATES = 512

# Expected shapes. P, n, V, F and T are the numbers of pieces, bodies, points, planes and triangles.
EXPECTED: dict[str, tuple[int | str, ...]] = {
    "layout": ("P", 5),
    "points": ("V", 3),
    "planes": ("F", 4),
    "piece_start": ("n + 1",),
    "frames": ("P", 13),
    "triangles": ("T", 3),
    "triangle_start": ("P + 1",),
    "inner_center": ("P", 3),
    "inner_factor": ("P", 3, 3),
    "outer_center": ("P", 3),
    "outer_factor": ("P", 3, 3),
    "gaps": ("P", 2),
}
INTEGERS = ("layout", "piece_start", "triangles", "triangle_start")
assert tuple(EXPECTED) == ARRAYS


def check_shapes(found: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays whose shapes do not match; this happens before the numbers are read."""
    P = found["layout"][0] if found["layout"] else -1
    counts = {"P": P, "P + 1": P + 1}
    for name, shape in EXPECTED.items():
        least = 1 if name.endswith("start") else 0
        fits = len(found[name]) == len(shape) and found[name][0] >= least
        for want, have in zip(shape, found[name], strict=False):
            fits = fits and have == (counts.setdefault(want, have) if isinstance(want, str) else want)
        if not fits:
            text = ", ".join(str(counts.get(s, s)) if isinstance(s, str) else str(s) for s in shape)
            raise InputError(f"{name}: expected shape ({text}), found {found[name]}")


def checked(arrays: dict[str, Any]) -> Packed:
    """Make a pack from untrusted arrays.

    Parameters
    ----------
    arrays : dict
        The arrays named in `ARRAYS`: int64 or float64, of shapes that `check_shapes` accepts.

    Raises
    ------
    InputError
        If the arrays violate a required property; the message names the array and the piece.
    """
    with np.errstate(all="ignore"):  # overflowing values are found and refused
        _check_numbers(arrays)
        pieces = PieceArrays(**arrays)
        _check_ranges(pieces)
        _check_curved(pieces)
        _check_surfaces(pieces)
        return Packed.of(pieces, _check_polytopes(pieces))


def _refuse(bad: Bools | np.bool_, what: str, found: NDArray[Any] | None = None, rows: Ints | None = None) -> None:
    """Raise an error about the first bad row; `rows` are the row numbers for its message."""
    if bad.any():
        i = int(np.argmax(bad))
        value = "another" if found is None else found[i]
        raise InputError(f"{what}, found {value} at {i if rows is None else rows[i]}")


def _check_numbers(arrays: dict[str, Any]) -> None:
    """Check that all numbers are finite, and so small that no product of three of them overflows."""
    for name in ARRAYS:
        array, most = arrays[name], np.inf if name == "gaps" else 10 * LARGEST
        # If any number is NaN, the largest and the smallest number are NaN as well, and both comparisons fail.
        if name not in INTEGERS and array.size and not (array.max() < most and array.min() > -most):
            largest = np.abs(array).reshape(len(array), -1).max(axis=1)
            _refuse(~(largest < most), f"{name}: expected finite numbers below {most:g}", largest)
    gaps = arrays["gaps"]
    if gaps.size and gaps.min() < -DOUBT:
        _refuse((gaps < -DOUBT).any(axis=1), "gaps: expected numbers >= 0", gaps)


def _rises(name: str, x: Ints, total: int, least: int) -> None:
    """Check that the starts of ranges rise from 0 to `total`, and that no range is shorter than `least`."""
    # The starts are compared, not subtracted, because the difference of extreme numbers may overflow.
    bad = np.concatenate([[x[0] != 0], (x[1:] < x[:-1]) | (x[1:] > total)])
    _refuse(bad, f"{name}: expected numbers that rise from 0 to {total}", x)
    if x[-1] != total:
        raise InputError(f"{name}: expected numbers that rise from 0 to {total}, found {x[-1]} at the end")
    lengths = np.diff(x)
    _refuse(lengths < least, f"{name}: expected at least {least} in each", lengths)


def _check_ranges(p: PieceArrays) -> None:
    """Check that index ranges do not overlap, leave no gaps, and stay inside their arrays."""
    layout, triangles, kind = p.layout, p.triangles, p.layout[:, columns.KIND]
    _refuse(~np.isin(kind, list(KIND_NAMES)), f"layout: expected kinds among {sorted(KIND_NAMES)}", kind)
    _rises("piece_start", p.piece_start, len(layout), 1)
    _rises("triangle_start", p.triangle_start, len(triangles), 0)
    counts = {"triangles": np.diff(p.triangle_start)}
    for what, first in (("points", columns.POINTS_FROM), ("planes", columns.PLANES_FROM)):
        start, stop = layout[:, first], layout[:, first + 1]
        ends = np.concatenate([start[:1], stop]) if len(layout) else np.zeros(1, dtype=np.int64)
        _rises(f"layout, {what}", ends, len(getattr(p, what)), 0)
        _refuse(start[1:] != stop[:-1], f"layout, {what}: expected each range where the last one ends", start[1:])
        counts[what] = stop - start
    polytope, surface = kind == columns.POLYTOPE, kind <= columns.SURFACE
    for what, count in counts.items():
        _refuse(polytope & (count < 4), f"layout: expected at least four {what} of a polytope", count)
        _refuse((kind > columns.POLYTOPE) & (count != 0), f"layout: expected no {what} of a curved piece", count)
    for what in ("points", "triangles"):
        _refuse(surface & (counts[what] < 1), f"layout: expected {what} of a surface", counts[what])
    _refuse(surface & (counts["planes"] != 0), "layout: expected no planes of a surface", counts["planes"])
    points = np.repeat(counts["points"], counts["triangles"])[:, None]
    foreign = ((triangles < 0) | (triangles >= points)).any(axis=1)
    _refuse(foreign, "triangles: expected the piece's own points", triangles)


def _inverses(factors: Floats, name: str, rows: Ints) -> tuple[Floats, Floats]:
    """Invert factors of ellipsoids, and derive the tolerance that their aspect ratios require."""
    try:
        inverse = np.linalg.inv(factors)
    except np.linalg.LinAlgError:
        raise InputError(f"{name}: expected ellipsoids with an interior, found a flat one") from None
    aspect = np.linalg.norm(factors, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2))
    _refuse(~(aspect < MOST_ASPECT), f"{name}: expected ellipsoids with an interior", aspect, rows)
    return np.asarray(inverse), _doubt(aspect)


def _doubt(aspect: Floats) -> Floats:
    return np.minimum(DOUBT + ROUNDINGS * aspect, MOST_DOUBT)


# -- polytopes --------------------------------------------------------------------------------


def _check_polytopes(p: PieceArrays) -> Maps:
    """Check that polytopes lie between their inner and outer ellipsoids, and match their triangles and planes."""
    layout = p.layout
    rows = np.flatnonzero(layout[:, columns.KIND] == columns.POLYTOPE)
    _refuse(p.frames[rows].any(axis=1), "frames: expected zeros for a polytope", rows=rows)
    if len(rows) == 0:
        return {}
    # The polytopes are checked in blocks, so that intermediate arrays stay in the processor's caches.
    size = layout[rows, columns.POINTS_TO] + layout[rows, columns.PLANES_TO]
    # The points of a block's polytopes are adjacent in the arrays, without points of a surface in between.
    apart = layout[rows[1:], columns.POINTS_FROM] != layout[rows[:-1], columns.POINTS_TO]
    blocks = np.split(rows, np.flatnonzero(apart | (size[1:] // BLOCK != size[:-1] // BLOCK)) + 1)
    doubt = np.concatenate([_check_ellipsoids(p, block) for block in blocks])
    _check_planes(p, rows, doubt)
    return direction_maps(layout, p.points)


def _check_ellipsoids(p: PieceArrays, rows: Ints) -> Floats:
    """Check the ellipsoids of consecutive polytopes for `_check_polytopes`, and return the tolerances of the tests."""
    start, stop = p.layout[rows, columns.POINTS_FROM], p.layout[rows, columns.POINTS_TO]
    points = p.points[start[0] : stop[-1]]
    owner, start = np.repeat(np.arange(len(rows)), stop - start), start - start[0]

    outer = p.outer_factor[rows]
    inverse, doubt = _inverses(outer, "outer_factor", rows)
    local = _local(inverse, p.outer_center[rows], points, owner)
    farthest = np.sqrt(np.maximum.reduceat(_dot(local, local), start))
    _refuse(~(farthest <= 1 + doubt), "outer ellipsoid: expected the piece inside", farthest, rows)

    inverse, doubt = _inverses(p.inner_factor[rows], "inner_factor", rows)
    # In the inner ellipsoid's coordinates, the ellipsoid is the unit ball, and the piece is a few units large.
    local = _local(inverse, p.inner_center[rows], points, owner)
    size = np.sqrt(np.maximum.reduceat(_dot(local, local), start))
    _check_surface(p, rows, start, local, size, doubt)

    # The volumes of the optimal ellipsoids differ by a factor of at most 27 (John).
    volumes = np.log(np.abs(np.linalg.det(inverse @ outer)))
    gaps, least = p.gaps[rows], volumes - np.log(27.0)
    _refuse(~(gaps[:, 0] + gaps[:, 1] >= least - 100 * doubt), "gaps: expected gaps that the volumes allow", gaps, rows)
    return doubt


def _local(inverse: Floats, center: Floats, points: Floats, owner: Ints) -> Floats:
    """Map points to the coordinates of their piece's ellipsoid; the shape is (3, V), with which NumPy is fastest."""
    away = np.ascontiguousarray((points - center[owner]).T)
    rows = np.ascontiguousarray(inverse.transpose(1, 2, 0))
    return np.stack([_dot(rows[k].take(owner, axis=1), away) for k in range(3)])


def _dot(a: Floats, b: Floats) -> Floats:
    """Compute dot products of corresponding columns."""
    total = a[0] * b[0]
    total += a[1] * b[1]
    total += a[2] * b[2]
    return np.asarray(total)


def _cross(a: Floats, b: Floats) -> Floats:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _check_surface(p: PieceArrays, rows: Ints, start: Ints, local: Floats, size: Floats, doubt: Floats) -> None:
    """Check that the triangles use all points and enclose the inner ellipsoid, here the unit ball.

    A closed surface that winds once around the origin encloses every point that can be reached from the origin without
    crossing the surface. If no triangle is nearer to the origin than the radius of the ball, the surface therefore
    encloses the ball, and the hull of the corners contains the ball. The test uses the distances of the triangles, not
    the distances of their planes, because the corners of a sliver do not determine a plane.
    """
    first, last = p.triangle_start[rows], p.triangle_start[rows + 1]
    triangles = p.triangles[first[0] : last[-1]]
    piece, first = np.repeat(np.arange(len(rows)), last - first), first - first[0]
    corners = np.ascontiguousarray((triangles + start[piece][:, None]).T)

    used = np.zeros(local.shape[1], dtype=bool)
    used[corners.ravel()] = True
    _refuse(~used, "triangles: expected every point in one", used)
    # On a closed surface, each edge of a triangle cancels against the same edge of the neighbour, which runs the other
    # way. Random numbers represent the ends of the edges, so that the sum for an open surface is zero only once in
    # 2**60 cases.
    tails, heads = np.random.default_rng().integers(0, 2**64, size=(2, local.shape[1]), dtype=np.uint64)
    rest = sum(tails[corners[k]] * heads[corners[k - 2]] - heads[corners[k]] * tails[corners[k - 2]] for k in range(3))
    is_open = np.add.reduceat(rest, first) != 0
    _refuse(is_open, "triangles: expected a closed surface, with each edge in both directions", rows=rows)

    a, b, c = (local.take(corner, axis=1) for corner in corners)
    normal = _cross(b - a, c - a)
    height = _dot(normal, a)
    distance = _least_height(normal, a, b, c)
    allowed = np.minimum(doubt * np.maximum(size, 1.0), MOST_DOUBT)
    near = np.flatnonzero(~(distance >= (1 - allowed)[piece]))
    if len(near):  # slivers, whose corners do not determine a normal
        distance[near] = np.maximum(distance[near], _least_distance(a[:, near], b[:, near], c[:, near]))
    worst = np.maximum.reduceat(1 - distance, first)
    _refuse(~(worst <= allowed), "inner ellipsoid: expected it inside the piece", worst, rows)

    ra, rb, rc = (np.sqrt(_dot(x, x)) for x in (a, b, c))
    across = ra * rb * rc + _dot(b, c) * ra + _dot(c, a) * rb + _dot(a, b) * rc
    angle = 2 * np.arctan2(height, across)  # solid angle (Van Oosterom and Strackee 1983)
    turns = np.add.reduceat(angle, first) / (4 * np.pi)
    _refuse(~(np.abs(turns - 1) < 0.1), "triangles: expected a surface once around the piece", turns, rows)


def _least_height(normal: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Find the least height of each triangle's corners along a vector of any length; -inf for a vector of zero length.

    For any vector, no point of a triangle is nearer to the origin than this height. An inaccurate normal, as for a
    sliver, therefore makes the bound smaller, but never too large.
    """
    length = np.sqrt(_dot(normal, normal))
    least = np.minimum(np.minimum(_dot(normal, a), _dot(normal, b)), _dot(normal, c))
    return np.where(length > SHORTEST, least / length, -np.inf)


def _least_distance(a: Floats, b: Floats, c: Floats) -> Floats:
    """Compute lower bounds on the distances of triangles from the origin, without their normals.

    Heights are taken along the vectors to the nearest points of the edges. If the triangle's nearest point is on an
    edge, the bound equals the distance. Otherwise, the bound is too small by about the square of the triangle's width;
    for a sliver, this is far below the tolerance. An error in the corners changes the distance by no more than the
    error itself.
    """
    bound = np.full(a.shape[1], -np.inf)
    for tail, head in ((a, b), (b, c), (c, a)):
        along = head - tail
        squared = _dot(along, along)
        at = np.where(squared > 0, np.clip(-_dot(tail, along) / squared, 0.0, 1.0), 0.0)
        bound = np.maximum(bound, _least_height(tail + at * along, a, b, c))
    return bound


def _check_planes(p: PieceArrays, rows: Ints, doubt: Floats) -> None:
    """Check that normals have unit length, and that each plane goes through the vertex farthest along its normal."""
    layout, points, planes = p.layout[rows], p.points, p.planes
    normals = planes[:, :3]
    squared = _dot(normals.T, normals.T)
    _refuse(~(np.abs(squared - 1) <= DOUBT), "planes: expected unit normals", normals)
    farthest = np.empty(len(planes))
    from_point, from_plane = layout[:, columns.POINTS_FROM], layout[:, columns.PLANES_FROM]
    counts = np.column_stack([layout[:, columns.POINTS_TO] - from_point, layout[:, columns.PLANES_TO] - from_plane])
    small = np.flatnonzero(counts[:, 0] <= columns.LARGE)
    # Pieces with equal numbers of points and planes are checked together.
    code = counts[small, 0] * (len(planes) + 1) + counts[small, 1]
    order = small[np.argsort(code, kind="stable")]
    for group in np.split(order, np.flatnonzero(np.diff(counts[order], axis=0).any(axis=1)) + 1) if len(order) else []:
        vertices, faces = counts[group[0]]
        step = max(1, AT_ONCE // int(vertices * faces))
        for some in np.split(group, range(step, len(group), step)):
            of_faces = from_plane[some, None] + np.arange(faces)
            of_points = from_point[some, None] + np.arange(vertices)
            heights = points[of_points] @ normals[of_faces].transpose(0, 2, 1)
            farthest[of_faces] = heights.max(axis=1)
    left = MOST_CANDIDATES * (len(points) + len(planes))
    for i in np.flatnonzero(counts[:, 0] > columns.LARGE):
        piece, faces = rows[i], slice(from_plane[i], from_plane[i] + counts[i, 1])
        center, factor = p.inner_center[piece], p.inner_factor[piece]
        farthest[faces], looked = heights_of(p.points_of(piece), normals[faces], center, factor, left)
        left -= looked
    x, y, z = np.abs(points.T)
    largest = np.append(np.maximum(np.maximum(x, y), z), 0.0)
    reach = np.maximum.reduceat(largest, np.column_stack([from_point, from_point + counts[:, 0]]).ravel())[::2]
    allowed = np.repeat(np.where(counts[:, 0] > columns.LARGE, doubt, DOUBT) * reach, counts[:, 1])
    off = np.abs(planes[:, 3] - farthest)
    _refuse(~(off <= allowed), "planes: expected each to touch its piece", off)


# -- surfaces ---------------------------------------------------------------------------------


def _check_surfaces(p: PieceArrays) -> None:
    """Check that surfaces use all their points and lie in their outer ellipsoids, and that solids are closed."""
    frames, gaps = p.frames, p.gaps
    rows = np.flatnonzero(p.layout[:, columns.KIND] <= columns.SURFACE)
    _refuse(frames[rows, 0] < 0, "frames: expected a radius >= 0", frames[rows, 0], rows)
    _refuse(frames[rows, 1:].any(axis=1), "frames: expected a radius alone of a surface", rows=rows)
    _refuse(~(gaps[rows, 1] < np.inf), "gaps: expected finite numbers", gaps[rows], rows)
    for i in rows.tolist():
        try:
            _check_one_surface(p, i)
        except InputError as error:
            raise InputError(f"{error}, in piece {i}") from None


def _check_one_surface(p: PieceArrays, i: int) -> None:
    """Check a single surface for `_check_surfaces`."""
    points, triangles, radius = p.points_of(i), p.triangles_of(i), p.frames[i, 0]
    used = np.zeros(len(points), dtype=bool)
    used[triangles.ravel()] = True
    _refuse(~used, "triangles: expected every point in one", used)
    _refuse((np.signbit(points) & (points == 0)).any(axis=1), "points: expected no negative zeros", points)
    surfaces.expect_sizes(points)
    surfaces.expect_radius(radius)
    if p.layout[i, columns.KIND] == columns.SOLID:
        surfaces.expect_closed("mesh", points, triangles)
    core, doubt = _core(p.outer_factor[i], radius, np.array([i]))
    away = (points - p.outer_center[i]) @ np.linalg.inv(core).T
    farthest = np.sqrt((away * away).sum(axis=1).max())
    _refuse(np.array([not farthest <= 1 + doubt]), "outer ellipsoid: expected the surface inside", rows=np.array([i]))
    if p.layout[i, columns.KIND] == columns.SOLID:
        return  # the inner ellipsoid in the file is recomputed, not used
    # The inner ellipsoid is, or lies within, a ball about a point of the surface.
    center, inner = p.inner_center[i], p.inner_factor[i]
    to_vertex = np.sqrt(((points - center) ** 2).sum(axis=1).min())
    size = np.linalg.norm(inner, axis=(0, 1), ord=2)
    inside = to_vertex + size <= radius * (1 + DOUBT) + DOUBT * np.abs(points).max()
    inside = inside and (np.linalg.det(inner / radius) != 0 if radius > 0 else not inner.any())
    _refuse(np.array([not inside]), "inner ellipsoid: expected it inside the surface", rows=np.array([i]))


def _core(factor: Floats, radius: float, rows: Ints) -> tuple[Floats, float]:
    """Find an ellipsoid whose sum with a ball lies inside the given ellipsoid, and the tolerance for rounding.

    Let Q be the shape matrix of the ellipsoid to be found, and r the radius of the ball. For any p > 0, the sum lies
    inside the ellipsoid with the shape matrix (1 + 1/p) Q + (1 + p) r² (see `surface_trees.around_sums`). Q follows
    from setting this matrix equal to the given ellipsoid's shape matrix.
    """
    _, doubt = _inverses(factor[None], "outer_factor", rows)
    if radius == 0:
        return factor, float(doubt[0])
    shape = (1 + 2 * DOUBT) * factor @ factor.T
    size = np.sqrt(np.trace(shape) / 3) - radius
    if not size > 0:
        raise InputError("outer ellipsoid: expected the surface inside, found one smaller than the radius")
    core = (shape - (radius + size) * radius * np.eye(3)) * (size / (radius + size))
    try:
        root = np.linalg.cholesky(core)
    except np.linalg.LinAlgError:
        raise InputError("outer ellipsoid: expected the surface inside, found a thinner one") from None
    aspect = np.linalg.cond(root)
    return root, float(min(DOUBT + ROUNDINGS * aspect**2, MOST_DOUBT))


# -- curved pieces ----------------------------------------------------------------------------


def _check_curved(p: PieceArrays) -> None:
    """Check that curved pieces match their kind.

    Their ellipsoids must match the closed forms, or err on the safe side.
    """
    rows = np.flatnonzero(p.layout[:, columns.KIND] > columns.POLYTOPE)
    if len(rows) == 0:
        return
    kind, frames = p.layout[rows, columns.KIND], p.frames[rows]
    rounding, center, image = frames[:, 0], frames[:, 1:4], frames[:, 4:].reshape(-1, 3, 3)
    round_kind = np.isin(kind, ROUND)
    _refuse((rounding > 0) != round_kind, "frames: expected a radius for capsules and spheres only", rounding, rows)
    _refuse(rounding < 0, "frames: expected a radius >= 0", rounding, rows)

    # Compute the directions and lengths of the axes. The axes are scaled first, so that no square over- or underflows.
    # The first index of `image` is the coordinate, and the second is the axis.
    image = np.ascontiguousarray(image.transpose(1, 2, 0))
    largest = np.maximum(np.maximum(np.abs(image[0]), np.abs(image[1])), np.abs(image[2]))
    _refuse(~((largest[0] > 0) & (largest[1] > 0) & (largest[2] > 0)), "frames: expected three axes", rows=rows)
    scaled = image / largest
    norms = np.sqrt(_dot(scaled, scaled))
    axes, lengths = scaled / norms, norms * largest
    skew = np.maximum.reduce([np.abs(_dot(axes[:, j], axes[:, k])) for j, k in ((0, 1), (1, 2), (2, 0))])
    _refuse(~(skew <= MOST_SKEW), "frames: expected axes at right angles", skew, rows)
    inverse = np.stack([_cross(axes[:, j], axes[:, k]) for j, k in ((1, 2), (2, 0), (0, 1))])
    volume = _dot(inverse[0], axes[:, 0])
    _refuse(~(volume > 0), "frames: expected right-handed axes", volume, rows)
    inverse /= volume
    equal = np.abs(lengths - rounding) <= 10 * BEND * rounding
    _refuse(~(equal[0] & equal[1]) & round_kind, "frames: expected axes as long as the radius", lengths.T, rows)
    balls = np.isin(kind, [number for number, curved in CURVED.items() if curved.core == 0])
    _refuse(~equal[2] & balls, "frames: expected axes as long as the radius", lengths.T, rows)

    fitted, lifts = ellipsoids_in_frame(kind, rounding, lengths.T)
    aspect = np.maximum.reduce(fitted[1].T) / np.minimum.reduce(fitted[1].T)
    doubt = _doubt(np.maximum(aspect, 1.0)) + BEND * round_kind
    for name, semi_axes, lift in zip(("inner", "outer"), fitted.transpose(0, 2, 1), lifts, strict=True):
        away = (getattr(p, f"{name}_center")[rows] - center).T
        factor = np.ascontiguousarray(getattr(p, f"{name}_factor")[rows].transpose(1, 2, 0))
        # Express center and factor in the coordinates in which the closed form is the unit ball. In these coordinates,
        # a correct factor is a multiple of the identity.
        moved = np.stack([_dot(inverse[j], away) - (lift if j == 2 else 0.0) for j in range(3)]) / semi_axes
        local = np.stack([_dot(inverse[j][:, None], factor) / semi_axes[j] for j in range(3)])
        scale = (local[0, 0] + local[1, 1] + local[2, 2]) / 3
        for j in range(3):
            local[j, j] -= scale
        rest = np.sqrt((local * local).sum(axis=(0, 1))) + np.sqrt(_dot(moved, moved))
        if name == "inner":
            _refuse(~(scale + rest <= 1 + doubt), "inner ellipsoid: expected it inside the piece", scale, rows)
            _refuse(~(scale - rest > 0), "inner ellipsoid: expected one with an interior", scale, rows)
        else:
            _refuse(~(scale - rest >= 1 - doubt), "outer ellipsoid: expected the piece inside", scale, rows)
