"""Swept volumes: make a body that provably contains links along a whole curve, and bound how far it sticks out.

The curve is evaluated at knots. The knots are so close together that each point of a link stays near the chords between
its positions at successive knots. Consider the hull of a convex piece's positions at two knots. Grown by the largest
distance of points from their chords, this hull contains the piece everywhere between the two knots. docs/certified.md,
"Swept volumes", derives this containment and the bound on the excess.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._matrices import dot, image, lengths, principal_axes, product
from loewner._base._threads import in_shares
from loewner._base._validate import Floats, Ints, Progress
from loewner._kernels import columns
from loewner._kernels.tolerances import STRETCH
from loewner._native import entries
from loewner.bodies import CURVED, Body, Packed, body_of_polytopes, packed_of
from loewner.bodies.kinds import ball, inradius
from loewner.bodies.surface_trees import SurfaceTree
from loewner.ellipsoids.polytopes import Polytope, heights_about_mean
from loewner.errors import GeometryError, InputError
from loewner.meshes import decomposition as meshes
from loewner.meshes.closed_parts import closed_parts
from loewner.meshes.coverage import Covering, distances_from
from loewner.meshes.plane_cuts import WORK, pieces_within
from loewner.meshes.protrusion import Solid, protrusions
from loewner.robots.checker import CollisionChecker
from loewner.robots.checking.edges import checked_path
from loewner.robots.checking.problem import Problem
from loewner.robots.description.robot import Robot, answers, link_poses
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.curves import Curve, curves_of, joint_errors, of_path
from loewner.scenes.scene import Scene

# Shares of the tolerance. PIECES is for replacing solids and curved shapes with convex pieces, VERTICES for leaving out
# vertices, CHORDS for the distance of points from the chords between knots, and TURNS for the turn between two knots.
PIECES, VERTICES, CHORDS, TURNS = 0.4, 0.05, 1 / 32, 0.25

# Edge length of a cloud's cells, as a share of the excess that a hull is allowed (`room`). With this share, the hull of
# the points in a cell sticks out by at most half of `room`.
CELLS = 0.45

# If a piece has more than FEW vertices, some of them are left out.
FEW = 26

# Maximum number of poses of links.
MOST_PLACES = 2**21

# Minimum growth of a hull, as a share of the tolerance. With less growth, neighbouring corners would coincide.
LEAST_GROWTH = 1e-4

# A ball of radius 1 lies in the octahedron with these corners.
OCTAHEDRON = math.sqrt(3.0) * (1 + 1e-15) * np.concatenate([np.eye(3), -np.eye(3)])

# Relative error of a coordinate that is rounded to single precision.
SINGLE = 2.0**-24

# Relative slack for rounding errors of lengths in double precision, a thousand times larger than needed.
ROUNDINGS = 2.0**-53 * 2**20

# Certified log-volume gap of the ellipsoids.
TOL = 1e-2

# Cache of the convex pieces of meshes, keyed by tree and by `room`, since cutting a mesh takes seconds.
_known: WeakKeyDictionary[SurfaceTree, dict[float, list[tuple[Floats, float]]]] = WeakKeyDictionary()

# Directions in which the first vertices are chosen: towards the corners, edges and faces of a cube.
_WAYS = np.indices((3, 3, 3)).reshape(3, -1).T[np.arange(27) != 13] - 1.0
_CORNERS = np.indices((2, 2, 2)).reshape(3, 8).T


class _Part(NamedTuple):
    """A convex piece of a body.

    Attributes
    ----------
    body : int
        Index of the moving body.
    vertices : ndarray, shape (n, 3)
        In the frame of the body's link.
    corners : ndarray, shape (8, 3)
        Corners of a box around the vertices.
    near, out : float
        Distances in metres. The body's points in the piece are within `near` of the hull of the vertices, and all
        points of the hull are within `out` of the body.
    """

    body: int
    vertices: Floats
    corners: Floats
    near: float
    out: float


class _Knots(NamedTuple):
    """Poses of the moving bodies at the knots of a curve, and bounds on their motions between two knots.

    Attributes
    ----------
    poses : ndarray, shape (bodies, N, 4, 4)
    sag, astray, error : ndarray, shape (bodies, N - 1)
        Bounds in metres. `sag` bounds how far points are from their chords, `astray` how far joint errors move points,
        and `error` the errors of the poses.
    """

    poses: Floats
    sag: Floats
    astray: Floats
    error: Floats


class _Element(NamedTuple):
    """The hull of a part's places at two knots.

    Attributes
    ----------
    part, first, last : int
    growth, grown : float
        `growth` is the growth that the hull needs, and `grown` is its actual growth [m]. The difference allows for
        rounding the vertices to single precision.
    excess : float
        Bound on how far the grown hull sticks out of the body's swept volume [m].
    """

    part: int
    first: int
    last: int
    growth: float
    grown: float
    excess: float


def swept(
    self: Robot,
    curve: Any,
    links: str | Iterable[str] | None,
    tolerance: float,
    joint_error: ArrayLike,
    scene: Scene | None,
    progress: Progress | None,
) -> Body:
    """Implement `Robot.swept`."""
    limit = _validate.positive_scalar(tolerance, "tolerance")
    _validate.callback(progress, "progress")
    errors = joint_errors(self, joint_error)
    ready: Problem = CollisionChecker(self, scene)._ready(timed=True)
    checked_curve = _curve(self, Scene() if scene is None else scene, curve)
    chosen = _chosen(self, ready, links)
    parts = [part for k, n in enumerate(chosen) for part in _parts(k, ready.packs[n], limit)]
    knots = _knots(self, checked_curve._replace(off=checked_curve.off + errors), parts, ready.link[chosen], limit)
    elements = [element for number in range(len(parts)) for element in _elements(parts, number, knots, limit)]

    def run(first: int, last: int) -> list[Polytope]:
        return [_hull(parts[one.part], knots, one) for one in elements[first:last]]

    hulls = [hull for share in in_shares(run, len(elements), 16, most=64, progress=progress) for hull in share]
    excess = max(one.excess for one in elements)
    return body_of_polytopes(hulls, Covering("swept", True, 0.0, math.nan, 0, excess), TOL)


answers["swept"] = swept


def united(bodies: list[Body]) -> tuple[Body, float]:
    """Join bodies from `swept` into one body with a covering; return the body and its excess [m]."""
    excess = max(body.covering.max_protrusion for body in bodies if body.covering is not None)
    return Body(packed_of(Body.union(bodies)), Covering("swept", True, 0.0, math.nan, 0, excess)), excess


# -- links and curves -------------------------------------------------------------------------


def _curve(robot: Robot, scene: Scene, given: Any) -> Curve:
    """Return the courses of a curve or a path."""
    if isinstance(given, (np.ndarray, list, tuple)):
        return of_path(robot, checked_path(robot, given))
    return curves_of(robot, scene, given)[0]


def _chosen(robot: Robot, ready: Problem, links: str | Iterable[str] | None) -> Ints:
    """Return the indices of the bodies that are swept."""
    own = [k for k, link in enumerate(ready.link.tolist()) if link < len(robot.link_names)]
    if links is None:
        return np.array(own)
    names = [links] if isinstance(links, str) else _validate.listed(links, "links")
    if not names:
        raise InputError("links: expected at least one link, found none")
    numbers = {ready.names[k]: k for k in own}
    for name in names:
        if not isinstance(name, str):
            raise InputError(f"links: expected names of links, found {_validate.short(name)}")
        _validate.known(name, "links: link with a body, or attached body", numbers)
    return np.array([numbers[name] for name in dict.fromkeys(names)])


def _parts(body: int, packed: Packed, tolerance: float) -> Iterator[_Part]:
    """Divide a body into convex pieces with few vertices."""
    for i in range(len(packed.layout)):
        for points, out in _convex(packed, i, PIECES * tolerance):
            vertices, near = _thinned(points, VERTICES * tolerance)
            axes = principal_axes(vertices)
            sides = image(axes, vertices)
            ends = np.stack([sides.min(axis=0), sides.max(axis=0)]) + ROUNDINGS * np.abs(sides).max() * _SIGNS
            corners = image(axes.T, ends[_CORNERS, np.arange(3)])
            yield _Part(body, vertices, corners, (1.0 + STRETCH) * near, (1.0 + STRETCH) * out)


_SIGNS = np.array([[-1.0], [1.0]])


def _convex(packed: Packed, i: int, room: float) -> list[tuple[Floats, float]]:
    """Return points whose hulls together contain a piece of a body, and a bound on how far each hull sticks out of it.

    The hull of a curved shape is a polytope around the shape, and a cloud has one hull for each cell of a grid. A solid
    or a surface is replaced with its hull or, if this hull sticks out farther than `room`, cut along planes.
    """
    kind, frame = int(packed.layout[i, columns.KIND]), packed.frames[i]
    radius = float(frame[0])
    if kind == columns.POLYTOPE:
        return [(packed.points_of(i), 0.0)]
    if kind > columns.POLYTOPE:
        return [_around(kind, radius, frame[1:4], frame[4:].reshape(3, 3), room)]
    triangles, vertices = packed.triangles_of(i), packed.points_of(i)
    if (triangles == triangles[:, :1]).all():
        return _of_cloud(vertices[triangles[:, 0]], radius, room)
    cuts = _known.setdefault(packed.trees[i], {})
    if room not in cuts:
        cuts[room] = _cut(vertices, triangles, kind == columns.SOLID, room)
    grown, further = _grown_ball(radius, room) if radius > 0 else (np.zeros((1, 3)), 0.0)
    return [((points[:, None] + grown).reshape(-1, 3), out + further) for points, out in cuts[room]]


def _of_cloud(points: Floats, radius: float, room: float) -> list[tuple[Floats, float]]:
    """Return points whose hulls contain the balls of a cloud, cell by cell, and how far each hull sticks out.

    If all distances between points are at most d, each point of their hull is within √(3/8) d of one of the points.
    """
    grown, further = _grown_ball(radius, room / 2)
    cell = np.unique(np.floor(points / (CELLS * room)), axis=0, return_inverse=True)[1].ravel()
    order, hulls = np.argsort(cell, kind="stable"), []
    for some in np.split(points[order], np.flatnonzero(np.diff(cell[order])) + 1):
        wide = math.sqrt(3 / 8) * float(lengths(np.ptp(some, axis=0))) * (1 + ROUNDINGS)
        hulls.append(((some[:, None] + grown).reshape(-1, 3), wide + further))
    return hulls


def _cut(vertices: Floats, triangles: Ints, solid: bool, room: float) -> list[tuple[Floats, float]]:
    """Return the vertices of hulls that together contain a surface or a solid, and how far each hull sticks out.

    The hull of a solid's surface contains the solid. Likewise, the hull of a closed part contains this part of the
    solid, and the hull of the surface on one side of a plane contains the solid on that side.
    """
    vertices, triangles = meshes.welded(vertices, triangles)
    closed = closed_parts(vertices, triangles) if solid else None
    parts = [vertices[part.triangles] for part in closed] if closed else [vertices[triangles]]
    mesh, hull = Solid(np.concatenate(parts), closed=solid), Polytope.from_points(vertices)
    out = float(protrusions([hull], mesh, floor=room, relative=1.0).bounds[0])
    if out <= room or (solid and not closed):
        return [(hull.vertices, out)]
    return [(cell.hull.vertices, cell.bound) for cell in pieces_within(parts, mesh, room, None, None, WORK)]


def _grown_ball(radius: float, room: float) -> tuple[Floats, float]:
    """Return the corners of a polytope around a ball about the origin, and how far the polytope sticks out."""
    for level in range(4):
        unit, inside = ball(level)[0], inradius(level) * (1 - ROUNDINGS)
        out = radius * (1 / inside - 1)
        if out <= room:
            break
    return unit * (radius / inside), out


def _around(kind: int, radius: float, center: Floats, factor: Floats, room: float) -> tuple[Floats, float]:
    """Return points whose hull contains a curved piece, and how far the hull sticks out."""
    shape, up = CURVED[kind], 1 + ROUNDINGS
    if shape.core is not None:  # a ball along a segment
        ends = np.array([[shape.core], [-shape.core]]) * factor[:, 2]
        corners, out = _grown_ball(radius * up, room)
        return (corners + ends[:, None] + center).reshape(-1, 3), out + radius * ROUNDINGS
    size = float(lengths(factor.T).max())
    if shape.is_ball:
        corners, out = _grown_ball(1.0, room / size)
        return image(factor, corners * up) + center, (out + ROUNDINGS) * size
    unit, _ = shape.mesh()
    wider = up * unit / (shape.inradii or inradius())
    return image(factor, wider) + center, size * (float(lengths(wider - unit).max()) + ROUNDINGS)


def _thinned(points: Floats, room: float) -> tuple[Floats, float]:
    """Choose vertices of the points' hull. Return them, and a bound on the distance of any point from their hull."""
    vertices = Polytope.from_points(points).vertices
    size = float(np.abs(vertices).max())
    if len(vertices) <= FEW:
        return vertices, ROUNDINGS * size  # points that rounding cannot distinguish from faces may be outside the hull
    chosen = np.unique(product(vertices, (_WAYS / np.ptp(vertices, axis=0)).T).argmax(axis=0)).tolist()
    middle = vertices[chosen].mean(axis=0)
    _, _, axes = np.linalg.svd(vertices[chosen] - middle)
    across = np.abs((vertices - middle) @ axes[2])  # the chosen vertices may lie in a plane, like the rim of a lid
    chosen = sorted({*chosen, int(across.argmax())})
    while True:
        away = distances_from(vertices, Polytope.from_points(vertices[chosen]), ROUNDINGS * size)
        farthest = int(away.argmax())
        if away[farthest] <= room or farthest in chosen:
            return vertices[chosen], float(away[farthest]) + 2 * ROUNDINGS * size
        chosen.append(farthest)


# -- places -----------------------------------------------------------------------------------


def _knots(robot: Robot, curve: Curve, parts: list[_Part], link: Ints, tolerance: float) -> _Knots:
    """Place the bodies at enough knots to keep chords and turns within their shares of the tolerance."""
    packs = [
        packed_of(Body.from_pieces([part.vertices for part in parts if part.body == k], tol=TOL))
        for k in range(len(link))
    ]
    problem = Problem.of(robot, (0, 0), ("",) * len(link), packs, link, np.zeros((0, 2), np.int64), np.zeros(0))
    count, bounds = len(curve.courses), np.empty((len(curve.courses), len(link), 4))
    entries.course_bounds(
        problem.handle, problem.handle_of_motions, np.ascontiguousarray(curve.courses),
        np.ascontiguousarray(curve.off), bounds,
    )  # fmt: skip
    bend, turn, astray, error = np.moveaxis(bounds, 2, 0)
    for k in np.flatnonzero(~np.isfinite(bounds).all(axis=(1, 2)))[:1]:
        raise InputError(
            f"curve: expected pieces on which no orientation turns by more than about 80 degrees, found the piece from "
            f"{curve.times[k]:.15g} s to {curve.times[k + 1]:.15g} s; divide it"
        )
    wide = np.array([max(_diameter(part.corners) for part in parts if part.body == k) for k in range(len(link))])
    each = np.maximum(np.sqrt(bend / (8 * CHORDS * tolerance)), turn * wide / (4 * TURNS * tolerance)).max(axis=1)
    if not (each.sum() + 2 * count) * len(link) <= MOST_PLACES:
        raise InputError(
            f"tolerance: expected at most {MOST_PLACES} places of links, found {each.sum() * len(link):.3g}; divide "
            f"the curve, or raise the tolerance of {tolerance:g} m"
        )
    steps = np.maximum(np.ceil(each), 1).astype(np.int64)
    at = np.repeat(np.arange(count), steps + 1)
    first = np.cumsum(steps + 1) - (steps + 1)
    number = np.arange(len(at)) - first[at]
    shares = np.where(number == steps[at], 1.0, number / steps[at])
    poses = np.empty((len(link), len(at), 4, 4))
    for begin in range(0, len(at), 4096):
        some = slice(begin, begin + 4096)
        Q = configurations(robot, curve.courses[at[some]], shares[some])
        poses[:, some] = link_poses(robot, Q)[:, link].swapaxes(0, 1)
    sag = (bend / (8 * steps[:, None].astype(float) ** 2))[at[:-1]].T.copy()
    # Where one course ends and the next one begins, points do not move, except for rounding.
    for k in range(len(link)):
        corners = np.concatenate([part.corners for part in parts if part.body == k])
        for knot in first[1:].tolist():
            sag[k, knot - 1] = lengths(_placed(poses[k, knot], corners) - _placed(poses[k, knot - 1], corners)).max()
    return _Knots(poses, sag, astray[at[:-1]].T.copy(), error[at[:-1]].T.copy())


def _placed(T: Floats, points: Floats) -> Floats:
    """Place points, shape (n, 3), at poses of shape (..., 4, 4)."""
    return product(points, T[..., :3, :3].swapaxes(-1, -2)) + T[..., None, :3, 3]


def _diameter(points: Floats) -> float:
    return float(lengths(points[:, None] - points).max())


def _off_chords(ways: Floats) -> float:
    """Bound the distance of any point in the hull of a part's two places from the chords of the part's points [m].

    Parameters
    ----------
    ways : ndarray, shape (8, 3)
        Vectors from one place to the other, for the corners of a box around the part.
    """
    off, middle = _diameter(ways) / 4, np.add.reduce(ways, axis=0)
    size = float(lengths(middle))
    if size > 0:
        along = np.maximum(dot(ways, middle / size), 0.0)
        least, most = float(along.min()), float(along.max())
        across = float(lengths(ways - along[:, None] * (middle / size)).max())
        if most > 0:
            off = min(off, across * (least + most) / (math.sqrt(least) + math.sqrt(most)) ** 2)
    return off * (1 + ROUNDINGS)


def _elements(parts: list[_Part], number: int, knots: _Knots, tolerance: float) -> Iterator[_Element]:
    """Divide the knots into the longest steps over which the hull of a part sticks out by at most `tolerance`."""
    part = parts[number]
    places = _placed(knots.poses[part.body], part.corners)
    sag, astray, error = (bound[part.body] for bound in knots[1:])
    size = np.abs(places).max(axis=(1, 2))

    def between(i: int, j: int) -> _Element:
        ways = places[i : j + 1] - places[i]
        whole = ways[-1]
        square = float((whole * whole).sum())
        shares = np.clip((ways * whole).sum(axis=(1, 2)) / square, 0.0, 1.0) if square > 0 else np.zeros(len(ways))
        off = float(lengths(ways - shares[:, None, None] * whole).max()) + float(sag[i:j].max())
        lost = float(error[i:j].max()) + ROUNDINGS * float(size[i : j + 1].max())
        growth = part.near + off + float(astray[i:j].max()) + lost
        rounded = 2 * SINGLE * (float(size[i : j + 1].max()) + 2 * tolerance)
        grown = max(growth, LEAST_GROWTH * tolerance) + rounded
        sides = math.sqrt(3.0) * grown * (1 + ROUNDINGS) + rounded
        return _Element(number, i, j, growth, grown, part.out + sides + off + lost + _off_chords(whole))

    i, last, step = 0, len(places) - 1, 1
    while i < last:
        # Find the farthest knot that fits: first in growing steps, then by bisection.
        best, farthest, beyond = None, i, last + 1
        while beyond - farthest > 1:
            j = min(i + step, last) if beyond > last else (farthest + beyond) // 2
            element = between(i, j)
            if element.excess <= tolerance:
                best, farthest, step = element, j, 2 * step
            else:
                beyond = j
        if best is None:
            raise InputError(
                f"tolerance: expected more than {between(i, i + 1).excess:.3g} m, found {tolerance:g}: joint errors "
                f"move points by up to {astray[i]:.3g} m, convex pieces stick out of the link by {part.out:.3g} m, and "
                f"coordinates are rounded by {SINGLE * size[i]:.1g} m"
            )
        yield best
        i, step = farthest, max(1, farthest - i)


# -- hulls ------------------------------------------------------------------------------------


def _hull(part: _Part, knots: _Knots, one: _Element) -> Polytope:
    """Make the grown hull of a part's places at two knots, with vertices in single precision.

    Raises
    ------
    GeometryError
        If the hull of the stored vertices is not proven to reach far enough.
    """
    ends = _placed(knots.poses[part.body, [one.first, one.last]], part.vertices).reshape(-1, 3)
    corners = (np.unique(ends, axis=0)[:, None] + one.grown * OCTAHEDRON).reshape(-1, 3)
    hull = Polytope.from_points(corners.astype(np.float32).astype(np.float64))
    # Check containment with the lemma of docs/containment.md, which holds for any normals.
    center, heights = heights_about_mean(hull)
    reached = product(hull.normals, (ends - center).T).max(axis=1) + one.growth * (1 + ROUNDINGS)
    if not (reached < heights).all():
        raise GeometryError(
            f"expected hulls that reach {one.growth:.3g} m beyond a link, found one that falls short by "
            f"{(reached - heights).max():.3g} m; raise the tolerance"
        )
    return hull
