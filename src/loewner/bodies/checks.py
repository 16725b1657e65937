"""Are arrays from a file bodies? Everything that a verdict rests on is looked at before a kernel sees it.

A file is data: whoever writes one can give it a checksum too. So nothing is taken on trust that would let a kernel read
past an array, loop for ever, or call FREE what is not. Every law that `save` keeps is tested, with tolerances for the
rounding of the test itself (`DOUBT`, `ROUNDINGS`): a file that a version of loewner wrote passes.

What cannot be tested without fitting again: that an ellipsoid is the largest or the smallest, and so the last digits
of `gaps`. These say how sharp the bounds are; no verdict rests on them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._check import Floats
from loewner._kernels import directions, rigid, shapes
from loewner.bodies.layout import LARGEST, Ints, Maps, direction_maps
from loewner.bodies.pack import ARRAYS, KIND_NAMES, Packed
from loewner.bodies.primitives import ellipsoids_in_frame
from loewner.errors import InputError

# Relative allowances of the tests: for what rounding cannot explain, and in roundings times the aspect of the piece,
# the digits that coordinates of a thin piece lack. However thin, no more than MOST_DOUBT.
DOUBT, ROUNDINGS, MOST_DOUBT = 1e-9, 64 * 2.0**-53, 0.05

# Flatter ellipsoids than this cannot be inverted in float64; polytopes as flat as this are refused when they are made.
MOST_ASPECT = 1e15

# Capsules and spheres move by poses that may stretch by this; their radius then stays, the ellipsoids stretch along.
BEND = 4 * rigid.ROTATION_TOLERANCE

# Candidates looked at per plane and vertex, on average, to find the farthest vertex of large polytopes: the direction
# map leaves some forty. Points that are no vertices of a hull could leave all, for every plane.
MOST_CANDIDATES = 512

# Letters stand for counts: pieces, bodies, points, planes, triangles.
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
    """Refuse arrays whose shapes do not belong together; shapes are known before any number is."""
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
    """Make a pack of arrays that come from outside.

    Parameters
    ----------
    arrays : dict
        Those of `ARRAYS`: int64 or float64, of shapes that `check_shapes` accepts.

    Raises
    ------
    InputError
        If they break a law; the message names array and piece.
    """
    with np.errstate(all="ignore"):  # what overflows is found and refused
        _check_numbers(arrays)
        _check_ranges(arrays)
        _check_curved(arrays)
        maps = _check_polytopes(arrays)
        return Packed(**arrays, maps=maps)


def _refuse(bad: NDArray[np.bool_], what: str, found: NDArray[Any] | None = None, rows: Ints | None = None) -> None:
    """Raise about the first row that is bad; `rows` are the numbers to call them by."""
    if bad.any():
        i = int(np.argmax(bad))
        value = "another" if found is None else found[i]
        raise InputError(f"{what}, found {value} at {i if rows is None else rows[i]}")


def _check_numbers(arrays: dict[str, Any]) -> None:
    """All numbers are finite, and small enough that no product of three overflows."""
    for name in ARRAYS:
        if name not in INTEGERS:
            most = np.inf if name == "gaps" else 10 * LARGEST
            array = arrays[name]
            largest = np.abs(array).max(axis=tuple(range(1, array.ndim)), initial=0.0)
            _refuse(~(largest < most), f"{name}: expected finite numbers below {most:g}", largest)


def _rises(name: str, x: Ints, total: int, least: int) -> None:
    """Refuse starts of ranges that do not lead from 0 to the total, each range at least so long."""
    # Compared rather than subtracted: the difference of absurd numbers may overflow.
    bad = np.concatenate([[x[0] != 0], (x[1:] < x[:-1]) | (x[1:] > total)])
    _refuse(bad, f"{name}: expected numbers that rise from 0 to {total}", x)
    if x[-1] != total:
        raise InputError(f"{name}: expected numbers that rise from 0 to {total}, found {x[-1]} at the end")
    lengths = np.diff(x)
    _refuse(lengths < least, f"{name}: expected at least {least} in each", lengths)


def _check_ranges(arrays: dict[str, Any]) -> None:
    """Every index leads where it should: nothing overlaps, nothing is left over, nothing is outside."""
    layout, triangles, triangle_start = arrays["layout"], arrays["triangles"], arrays["triangle_start"]
    kind = layout[:, shapes.KIND]
    _refuse((kind < 0) | (kind >= len(KIND_NAMES)), f"layout: expected kinds 0 to {len(KIND_NAMES) - 1}", kind)
    _rises("piece_start", arrays["piece_start"], len(layout), 1)
    _rises("triangle_start", triangle_start, len(triangles), 0)
    counts = {"triangles": np.diff(triangle_start)}
    for what, first in (("points", shapes.POINTS_FROM), ("planes", shapes.PLANES_FROM)):
        start, stop = layout[:, first], layout[:, first + 1]
        ends = np.concatenate([start[:1], stop]) if len(layout) else np.zeros(1, dtype=np.int64)
        _rises(f"layout, {what}", ends, len(arrays[what]), 0)
        _refuse(start[1:] != stop[:-1], f"layout, {what}: expected each piece's where the last one's end", start[1:])
        counts[what] = stop - start
    polytope = kind == shapes.POLYTOPE
    for what, count in counts.items():
        _refuse(polytope & (count < 4), f"layout: expected at least four {what} of a polytope", count)
        _refuse(~polytope & (count != 0), f"layout: expected no {what} of a curved piece", count)
    points = np.repeat(counts["points"], counts["triangles"])[:, None]
    _refuse(
        ((triangles < 0) | (triangles >= points)).any(axis=1), "triangles: expected the piece's own points", triangles
    )


def _inverses(factors: Floats, name: str, rows: Ints) -> tuple[Floats, Floats]:
    """Inverses of factors, and the doubt that their aspects leave."""
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


def _check_polytopes(arrays: dict[str, Any]) -> Maps:
    """Inner ellipsoid in the hull of the points, that in the outer one; triangles and planes are the hull's."""
    layout, points = arrays["layout"], arrays["points"]
    rows = np.flatnonzero(layout[:, shapes.KIND] == shapes.POLYTOPE)
    _refuse(arrays["frames"][rows].any(axis=1), "frames: expected zeros for a polytope", rows=rows)
    if len(rows) == 0:
        return {}
    owner = np.repeat(np.arange(len(rows)), (layout[:, shapes.POINTS_TO] - layout[:, shapes.POINTS_FROM])[rows])
    start = layout[rows, shapes.POINTS_FROM]

    inverse, doubt = _inverses(arrays["outer_factor"][rows], "outer_factor", rows)
    local = _apply(inverse[owner], points - arrays["outer_center"][rows][owner])
    farthest = np.maximum.reduceat(np.linalg.norm(local, axis=1), start)
    _refuse(~(farthest <= 1 + doubt), "outer ellipsoid: expected the piece inside", farthest, rows)

    inverse, doubt = _inverses(arrays["inner_factor"][rows], "inner_factor", rows)
    # In the inner ellipsoid's coordinates it is the unit ball, and the piece is a few units large.
    local = _apply(inverse[owner], points - arrays["inner_center"][rows][owner])
    size = np.maximum.reduceat(np.linalg.norm(local, axis=1), start)
    _check_surface(arrays, rows, local, size, doubt)

    # The optimal ones differ by no more than 27 in volume (John).
    volumes = np.log(np.abs(np.linalg.det(inverse @ arrays["outer_factor"][rows])))
    gaps = arrays["gaps"][rows]
    _refuse(~(gaps >= -DOUBT).all(axis=1), "gaps: expected numbers >= 0", gaps, rows)
    least = volumes - np.log(27.0)
    _refuse(~(gaps.sum(axis=1) >= least - 100 * doubt), "gaps: expected what the volumes allow", gaps, rows)

    _check_planes(arrays, rows, local, doubt)
    return direction_maps(layout, points)


def _apply(matrices: Floats, vectors: Floats) -> Floats:
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _check_surface(arrays: dict[str, Any], rows: Ints, local: Floats, size: Floats, doubt: Floats) -> None:
    """The triangles are the surface of a convex polytope with the inner ellipsoid, here the unit ball, inside.

    They close up, run once around the origin, fold outward at every edge and use every point; so they are the boundary
    of the points' hull, and the planes that they span are what the ball must stay inside of.
    """
    layout, triangle_start = arrays["layout"], arrays["triangle_start"]
    counts = np.diff(triangle_start)[rows]
    piece = np.repeat(np.arange(len(rows)), counts)
    corner = arrays["triangles"] + layout[rows, shapes.POINTS_FROM][piece][:, None]

    used = np.zeros(len(local), dtype=bool)
    used[corner.ravel()] = True
    _refuse(~used, "triangles: expected every point in one", used)
    tail, head, apex = (np.concatenate([corner[:, (k + j) % 3] for k in range(3)]) for j in range(3))
    _refuse(tail == head, "triangles: expected three different corners", tail)
    forward = tail * len(local) + head
    backward = head * len(local) + tail
    order, reverse = np.argsort(forward, kind="stable"), np.argsort(backward, kind="stable")
    open_edge = forward[order] != backward[reverse]
    _refuse(open_edge, "triangles: expected a closed surface, each edge run both ways", tail[order])

    a, b, c = (local[corner[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    height = np.einsum("ij,ij->i", normal, a)
    length = np.linalg.norm(normal, axis=1)
    edge = np.sqrt(np.maximum(((b - a) ** 2).sum(axis=1), ((c - a) ** 2).sum(axis=1)))
    # The face that a triangle is cut from is flat to some 1e-11 of its width (`hulls.FACE_WIDTH`), and a normal of a
    # short triangle turns by that over its length.
    slack = (doubt * size**2)[piece] * np.maximum(edge, 1e-6)
    outside = (length - height - slack) / np.maximum(length, 1e-300)
    first = triangle_start[rows]
    worst = np.maximum.reduceat(outside, first)
    _refuse(~(worst <= doubt), "inner ellipsoid: expected it inside the piece", worst, rows)

    lengths = [np.linalg.norm(x, axis=1) for x in (a, b, c)]
    dots = [np.einsum("ij,ij->i", x, y) for x, y in ((b, c), (c, a), (a, b))]
    across = lengths[0] * lengths[1] * lengths[2] + sum(d * n for d, n in zip(dots, lengths, strict=True))
    angle = 2 * np.arctan2(height, across)  # solid angle (Van Oosterom and Strackee 1983)
    turns = np.bincount(piece, angle, len(rows)) / (4 * np.pi)
    _refuse(~(np.abs(turns - 1) < 0.1), "triangles: expected a surface once around the piece", turns, rows)

    # Edge `order[i]` of one triangle is edge `reverse[i]` of its neighbour, whose apex must not be above the first.
    here = order % len(corner)
    above = np.empty(3 * len(corner))
    above[order] = np.einsum("ij,ij->i", normal[here], local[apex[reverse]] - a[here])
    bent = (above.reshape(3, -1).max(axis=0) - slack * size[piece]) / np.maximum(length, 1e-300)
    worst = np.maximum.reduceat(bent, first)
    _refuse(~(worst <= doubt * size), "triangles: expected a convex surface", worst, rows)


def _check_planes(arrays: dict[str, Any], rows: Ints, local: Floats, doubt: Floats) -> None:
    """Normals are of unit length, and each offset is that of the farthest vertex."""
    layout, points, planes = arrays["layout"], arrays["points"], arrays["planes"]
    centers, factors = arrays["inner_center"][rows], arrays["inner_factor"][rows]
    length = np.linalg.norm(planes[:, :3], axis=1)
    _refuse(~(np.abs(length - 1) <= DOUBT), "planes: expected unit normals", length)
    off = np.empty(len(planes))
    left = MOST_CANDIDATES * (len(points) + len(planes))
    for i, (first, last, from_plane, to_plane) in enumerate(layout[rows, 1:].tolist()):
        vertices, normals = points[first:last], planes[from_plane:to_plane, :3]
        if last - first > shapes.LARGE:
            farthest, looked = _farthest(local[first:last], normals @ factors[i], left)
            farthest += normals @ centers[i]
            left -= looked
        else:
            farthest = (normals @ vertices.T).max(axis=1)
        away = np.abs(planes[from_plane:to_plane, 3] - farthest)
        off[from_plane:to_plane] = away / (np.abs(vertices).max() * (1 + doubt[i] / DOUBT))
    _refuse(~(off <= DOUBT), "planes: expected each to touch its piece", off)


def _farthest(vertices: Floats, normals: Floats, most: int) -> tuple[Floats, int]:
    """Largest normal·vertex for each normal, and how many were looked at.

    By a direction map, in coordinates where the piece is round: there it leaves few candidates, whatever the piece.
    """
    chosen, nodes = directions.direction_map(np.ascontiguousarray(vertices))
    node, s, t = _cells(normals)
    for bit in reversed(range(directions.DEEPEST)):
        inner = nodes[node, 1] < 0
        child = nodes[node, 0].astype(np.int64) + ((s >> bit) & 1) + 2 * ((t >> bit) & 1)
        node = np.where(inner, child, node)
    first, last = nodes[node].astype(np.int64).T
    total = int((last - first).sum())
    if total > most:
        raise InputError("points: expected the vertices of convex pieces, found too many that are none")
    farthest = np.empty(len(normals))
    order = np.argsort(node, kind="stable")
    for same in np.split(order, np.flatnonzero(np.diff(node[order])) + 1):
        leaf = vertices[chosen[first[same[0]] : last[same[0]]]]
        step = max(1, 1_000_000 // len(leaf))
        for k in range(0, len(same), step):
            farthest[same[k : k + step]] = (normals[same[k : k + step]] @ leaf.T).max(axis=1)
    return farthest, total


def _cells(normals: Floats) -> tuple[Ints, Ints, Ints]:
    """Face of the cube and grid cell that each direction goes through, as `directions` numbers them."""
    axis = np.argmax(np.abs(normals), axis=1)
    one, two = np.array([1, 0, 0])[axis], np.array([2, 2, 1])[axis]
    each = np.arange(len(normals))
    major = normals[each, axis]
    grid = directions.GRID
    cells = [
        np.clip(normals[each, k] / np.abs(major) * (grid / 2) + grid / 2, 0, grid - 1).astype(np.int64)
        for k in (one, two)
    ]
    return 2 * axis + (major < 0), cells[0], cells[1]


# -- curved pieces ----------------------------------------------------------------------------


def _check_curved(arrays: dict[str, Any]) -> None:
    """Curved pieces are what their kind says, and their ellipsoids are the closed forms or on the safe side of them."""
    kind = arrays["layout"][:, shapes.KIND]
    rows = np.flatnonzero(kind != shapes.POLYTOPE)
    if len(rows) == 0:
        return
    kind, frames = kind[rows], arrays["frames"][rows]
    rounding, center, image = frames[:, 0], frames[:, 1:4], frames[:, 4:].reshape(-1, 3, 3)
    round_kind = kind >= shapes.SEGMENT
    _refuse((rounding > 0) != round_kind, "frames: expected a radius of capsules and spheres only", rounding, rows)
    _refuse(rounding < 0, "frames: expected a radius >= 0", rounding, rows)

    # Directions and lengths of the axes; scaled first, so that no square over- or underflows.
    largest = np.abs(image).max(axis=1)
    _refuse(~(largest[:, :2] > 0).all(axis=1), "frames: expected axes of some length", largest, rows)
    _refuse(~(largest[:, 2] > 0), "frames: expected axes of some length", largest, rows)
    scaled = image / largest[:, None, :]
    norms = np.linalg.norm(scaled, axis=1)
    axes, lengths = scaled / norms[:, None, :], norms * largest
    skew = np.abs(axes.transpose(0, 2, 1) @ axes - np.eye(3)).max(axis=(1, 2))
    _refuse(~(skew <= 1e-3), "frames: expected axes at right angles", skew, rows)
    _refuse(~(np.linalg.det(axes) > 0), "frames: expected right-handed axes", rows=rows)
    equal = np.abs(lengths - rounding[:, None]) <= 10 * BEND * rounding[:, None]
    _refuse(~equal[:, :2].all(axis=1) & round_kind, "frames: expected axes as long as the radius", lengths, rows)
    _refuse(~equal[:, 2] & (kind == shapes.POINT), "frames: expected axes as long as the radius", lengths, rows)

    inner, outer, lift = ellipsoids_in_frame(kind, rounding, lengths)
    back = np.linalg.inv(axes)
    doubt = _doubt(np.maximum(outer.max(axis=1) / outer.min(axis=1), 1.0)) + BEND * round_kind
    for name, semi_axes in (("inner", inner), ("outer", outer)):
        moved = _apply(back, arrays[f"{name}_center"][rows] - center)
        moved[:, 2] -= lift
        away = np.linalg.norm(moved / semi_axes, axis=1)
        # The factor in the coordinates where the closed form is the identity: a multiple of it.
        factor = (back @ arrays[f"{name}_factor"][rows]) / semi_axes[:, :, None]
        scale = np.trace(factor, axis1=1, axis2=2) / 3
        rest = np.linalg.norm(factor - scale[:, None, None] * np.eye(3), axis=(1, 2))
        if name == "inner":
            _refuse(~(scale + rest + away <= 1 + doubt), "inner ellipsoid: expected it inside the piece", scale, rows)
            _refuse(~(scale - rest > 0), "inner ellipsoid: expected one with an interior", scale, rows)
        else:
            _refuse(~(scale - rest - away >= 1 - doubt), "outer ellipsoid: expected the piece inside", scale, rows)
    gaps = arrays["gaps"][rows]
    _refuse(~(gaps >= -DOUBT).all(axis=1), "gaps: expected numbers >= 0", gaps, rows)
