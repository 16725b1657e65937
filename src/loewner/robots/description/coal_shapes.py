"""Make bodies from Coal's shapes. Coal is not imported; only the given objects are used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from loewner.bodies import Body
from loewner.errors import InputError
from loewner.robots.description.link_meshes import mesh_body

# Minimum thickness of a terrain at its lowest points [m]. In Coal, the thickness may be zero.
LEAST_DEPTH = 1e-6

# Functions that make a body from a shape and the radius of its swept sphere.
PRIMITIVES: dict[str, Callable[[Any, float], Body]] = {
    "Box": lambda shape, _: Body.box(2 * shape.halfSide),
    "Sphere": lambda shape, swept: Body.sphere(shape.radius + swept),
    "Capsule": lambda shape, swept: Body.capsule(shape.radius + swept, 2 * shape.halfLength),
    "Cylinder": lambda shape, _: Body.cylinder(shape.radius, 2 * shape.halfLength),
    "Cone": lambda shape, _: Body.cone(shape.radius, 2 * shape.halfLength),
    "Ellipsoid": lambda shape, _: Body.ellipsoid(shape.radii),
    "Halfspace": lambda shape, _: Body.half_space(shape.n, shape.d),
}


def coal_body(shape: Any, meshes: str, tol: float) -> Body:
    """Make the body of a Coal shape; Coal stores half lengths.

    Parameters
    ----------
    shape : coal.CollisionGeometry
    meshes : str
        Representation of meshes, one of `link_bodies.MODELS`.
    tol : float
        As for `Body.from_mesh`.
    """
    kind = type(shape).__name__
    swept = float(shape.getSweptSphereRadius()) if hasattr(shape, "getSweptSphereRadius") else 0.0
    if swept and kind not in ("Sphere", "Capsule"):
        raise InputError(f"expected a {kind} without a swept sphere, found one of radius {swept:g}")
    if kind in PRIMITIVES:
        return PRIMITIVES[kind](shape, swept)
    if kind.startswith("Convex"):
        return Body.from_points(shape.points(), tol=tol)
    if kind.startswith("BVHModel"):
        corners = [[shape.tri_indices(k)[i] for i in range(3)] for k in range(shape.num_tris)]
        mesh = np.array(shape.vertices()), np.array(corners, dtype=np.int64).reshape(-1, 3)
        return mesh_body(mesh, meshes, tol)
    if kind.startswith("HeightField"):
        return _terrain(shape)
    if kind == "OcTree":
        boxes = np.array(shape.toBoxes())
        return Body.boxes(boxes[:, :3], np.repeat(boxes[:, 3:4], 3, axis=1))
    raise InputError(
        "expected a box, sphere, capsule, cylinder, cone, ellipsoid, half-space, convex, mesh, height field or octree, "
        f"found a {kind}"
    )


def _terrain(shape: Any) -> Body:
    """Make the body of a height field. In Coal, the row index increases along -y, and the column index along x."""
    x, y, heights = shape.getXGrid(), shape.getYGrid(), np.array(shape.getHeights())
    corner = np.eye(4)
    corner[:2, 3] = x[0], y[-1]
    base = min(float(shape.getMinHeight()), float(heights.min()) - LEAST_DEPTH)
    return Body.height_field(heights.T[:, ::-1], [x[1] - x[0], y[0] - y[1]], base=base).transformed(corner)
