"""Define the kinds of pieces; each row of `CURVED` contains all properties of one curved kind."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np

from loewner._base import _elementary
from loewner._base._matrices import dot, lengths, normals_of
from loewner._base._read_only import read_only
from loewner._base._validate import Floats, Ints
from loewner._kernels import columns
from loewner.errors import InputError

Mesh = tuple[Floats, Ints]
# A function that fits ellipsoids to k pieces, in the frames of the pieces. The arguments are the radii of the added
# balls, shape (k,), and the semi-axes of the unit shape's images, shape (k, 3). The results are the ellipsoids'
# semi-axes, and the heights of their centers along the third axis.
Fit = Callable[[Floats, Floats], tuple[Floats, Floats | float]]
# A function of points or directions, shape (k, 3).
Function = Callable[[Floats], Floats]

# Number of corners of the polygons that replace the circles of cylinders and cones.
SEGMENTS = 48

# A unit icosahedron: the corners of three golden rectangles, and triangles counter-clockwise from outside.
_GOLDEN = (1 + math.sqrt(5.0)) / 2
_CORNERS = np.array([[-1, _GOLDEN, 0], [1, _GOLDEN, 0], [-1, -_GOLDEN, 0], [1, -_GOLDEN, 0]]) / math.sqrt(
    1.0 + _GOLDEN * _GOLDEN
)
_ICOSAHEDRON = np.vstack([_CORNERS, np.roll(_CORNERS, 1, axis=1), np.roll(_CORNERS, 2, axis=1)])


def _missing(_: Floats) -> Floats:
    raise InputError("cover: expected pieces of kinds with a gauge and a support function, found another kind")


class Kind(NamedTuple):
    """A kind of curved piece: the image of a unit shape, with a ball added (see `_kernels.pieces.shapes`).

    `name` is the name of a `Body` constructor; `sizes` computes the constructor's arguments from the ball's radius and
    the image's semi-axes. In scene files, the sizes are separate fields, named by `size_names`, or one vector if there
    are no names. `is_ball` marks kinds whose pieces equal their inner and outer ellipsoids.

    `mesh` triangulates the unit shape, with all corners on its surface. If its coordinates are divided by `inradii`,
    the mesh contains the unit shape; `inradii` is None if the mesh is `ball`. `inner` and `outer` fit the optimal
    ellipsoids. `gauge` is a convex function of points whose gradient is nowhere longer than 1. The gauge is at most 1
    in the unit shape, less than 1 at the origin, and greater than 1 outside the unit shape. `support` is the support
    function of the unit shape. Covers refuse kinds without `gauge` or `support`.

    For a kind with an added ball, `gauge` and `support` are not needed, and `mesh` triangulates the unit ball. The ball
    is added to the image of a segment or of a point. `core` is half the length of this segment, or 0 for a point.
    """

    name: str
    sizes: Callable[[float, Sequence[float]], Sequence[float]]
    mesh: Callable[[], Mesh]
    inner: Fit
    outer: Fit
    gauge: Function = _missing
    support: Function = _missing
    size_names: tuple[str, ...] = ("radius", "length")
    inradii: tuple[float, float, float] | None = None
    core: float | None = None
    is_ball: bool = False

    def share(self, points: Floats) -> Floats:
        """Compute a factor for each point such that the point, multiplied by the factor, is in the unit shape.

        The factor follows from the gauge at the origin, the gauge at the point, and the convexity of the gauge.
        """
        center = 1.0 - float(self.gauge(np.zeros((1, 3)))[0])
        return np.asarray(center / (center + np.maximum(self.gauge(points) - 1.0, 0.0)))


@lru_cache(maxsize=4)
def ball(subdivisions: int = 3) -> Mesh:
    """Triangulate the unit ball: the triangles of an icosahedron, repeatedly divided into four."""
    vertices, triangles = _ICOSAHEDRON, _faces(_ICOSAHEDRON)
    for _ in range(subdivisions):
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        ends, which = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
        middles = vertices[ends].sum(axis=1)
        ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
        a, b, c = triangles.T
        vertices = np.vstack([vertices, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
        triangles = np.concatenate([np.column_stack(t) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    read_only(vertices, triangles)
    return vertices, triangles


def inradius(subdivisions: int = 3) -> float:
    """Compute the radius of the largest ball about the origin inside the triangles of `ball`."""
    vertices, triangles = ball(subdivisions)
    corners = vertices[triangles]
    across = normals_of(corners)
    return float((dot(across, corners[:, 0]) / lengths(across)).min())


def _faces(corners: Floats) -> Ints:
    """List the triangles of an icosahedron: all triples of neighbouring corners, counter-clockwise from outside."""
    near = corners @ corners.T > 0.4  # neighbours have 1/sqrt(5), all others less than 0
    all_near = (three for three in combinations(range(12), 3) if near[np.ix_(three, three)].all())
    threes = [three if np.linalg.det(corners[list(three)]) > 0 else three[::-1] for three in all_near]
    return np.array(threes, dtype=np.int64)


def revolved(*profile: tuple[float, float]) -> Mesh:
    """Triangulate a solid of revolution about the third axis; `profile` lists radii and heights from bottom to top."""
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    circle = np.column_stack([_elementary.cos(angle), _elementary.sin(angle)])
    rings = [np.column_stack([r * circle, np.full(SEGMENTS, float(z))]) for r, z in profile]
    at = np.arange(SEGMENTS * (len(profile) - 1))
    after = at - at % SEGMENTS + (at + 1) % SEGMENTS
    above, top = at + SEGMENTS, after + SEGMENTS
    bottom, lid = (np.full(SEGMENTS, len(at) + SEGMENTS + k) for k in (0, 1))
    triangles = [(at, after, above), (after, top, above),
                 (bottom, after[:SEGMENTS], at[:SEGMENTS]), (lid, above[-SEGMENTS:], top[-SEGMENTS:])]  # fmt: skip
    ends = [[0, 0, profile[0][1]], [0, 0, profile[-1][1]]]
    return np.vstack([*rings, ends]), np.concatenate([np.column_stack(t) for t in triangles])


def _around_axis(function: Callable[[Floats, Floats], Floats]) -> Function:
    """Turn a function of the distance from the third axis and the height into a function of points or directions."""
    return lambda x: np.asarray(function(np.hypot(x[:, 0], x[:, 1]), x[:, 2]))


def _upright(_: float, axes: Sequence[float]) -> Sequence[float]:
    return axes[0], 2 * axes[2]


def _image(semi_axes: Sequence[float], height: float = 0.0, divisors: Sequence[float] = (1.0, 1.0, 1.0)) -> Fit:
    """Make a `Fit` from the ellipsoid of the unit shape; `divisors` divide its semi-axes."""
    return lambda _, lengths: (lengths * semi_axes / divisors, lengths[:, 2] * height)


def _same(radius: Floats, _: Floats) -> tuple[Floats, float]:
    return radius[:, None], 0.0


def _in_capsules(radius: Floats, lengths: Floats) -> tuple[Floats, float]:
    return np.column_stack([radius, radius, lengths[:, 2] + radius]), 0.0


def _around_capsules(radius: Floats, lengths: Floats) -> tuple[Floats, float]:
    """Compute the smallest ellipsoids, with semi-axes a, a, b, around capsules whose straight part has half length h.

    Let r be the radius of the capsule. The support function of the ellipsoid must be at least h|c| + r, where c is the
    cosine of the direction's angle with the axis. With k = b² - a² - h², this means that a² - r² - 2hr c + k c² >= 0
    for all c in [0, 1]. The volume is least where k² - 2h²k - 3h²r² = 0.
    """
    # The unit is the greater of the two lengths, so that no square over- or underflows.
    half = lengths[:, 2]
    unit = np.maximum(radius, half)
    x, y = radius / unit, half / unit
    k = y * (y + np.sqrt(y * y + 3.0 * x * x))
    grow = np.sqrt(1 + y * y / k)
    a, b = radius * grow, unit * grow * np.sqrt(x * x + k)
    return np.column_stack([a, a, b]), 0.0


_UNIT = _image((1.0, 1.0, 1.0))
_AROUND_CYLINDER = _image((math.sqrt(1.5), math.sqrt(1.5), math.sqrt(3.0)))
# Across the cone, the semi-axes are 1/√2 times the radius inside, and 3/√8 times the radius outside.
_IN_CONE = _image((1.0, 1.0, 0.5), -0.5, (math.sqrt(2.0), math.sqrt(2.0), 1.0))
_AROUND_CONE = _image((3.0, 3.0, 1.5), -0.5, (math.sqrt(8.0), math.sqrt(8.0), 1.0))
# Inradius of a regular polygon with 48 corners on the unit circle: the cosine of π / 48, computed by halving π / 3 four
# times.
_POLYGON = 0.5
for _ in range(4):
    _POLYGON = math.sqrt((1.0 + _POLYGON) / 2.0)

# Curved kinds, keyed by their numbers in kernels and files.
CURVED = {
    columns.ELLIPSOID: Kind("ellipsoid", lambda _, axes: axes, ball, _UNIT, _UNIT, lengths, lengths, (), is_ball=True),
    columns.CYLINDER: Kind(
        "cylinder", _upright, lambda: revolved((1, -1), (1, 1)), _UNIT, _AROUND_CYLINDER,
        _around_axis(lambda r, z: np.maximum(r, np.abs(z))), _around_axis(lambda r, z: r + np.abs(z)),
        inradii=(_POLYGON, _POLYGON, 1.0),
    ),
    columns.CONE: Kind(  # the apex is at height 1, and the base of radius 1 at height -1
        "cone", _upright, lambda: revolved((1, -1), (0, 1)), _IN_CONE, _AROUND_CONE,
        _around_axis(lambda r, z: 1.0 + np.maximum(-1.0 - z, (2.0 * r + z - 1.0) / np.sqrt(5.0))),
        _around_axis(lambda r, z: np.maximum(r - z, z)), inradii=(_POLYGON, _POLYGON, 1.0),
    ),
    columns.SEGMENT: Kind(
        "capsule", lambda radius, axes: (radius, 2 * axes[2]), ball, _in_capsules, _around_capsules, core=1.0
    ),
    columns.POINT: Kind(
        "sphere", lambda radius, _: (radius,), ball, _same, _same, size_names=("radius",), core=0.0, is_ball=True
    ),
}  # fmt: skip
# BALLS lists the numbers of kinds whose pieces equal their ellipsoids, and ROUND the numbers of kinds with an added
# ball.
BALLS = [number for number, kind in CURVED.items() if kind.is_ball]
ROUND = [number for number, kind in CURVED.items() if kind.core is not None]
FLAT = {columns.SOLID: "solid", columns.SURFACE: "surface", columns.POLYTOPE: "polytope"}
KIND_NAMES = FLAT | {number: kind.name for number, kind in CURVED.items()}
