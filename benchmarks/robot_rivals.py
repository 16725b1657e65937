"""pinocchio with Coal as a robot's collision checker: the same shapes, the same pairs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from loewner import Body, CollisionChecker
from loewner.bodies import Piece
from loewner.robots.description.urdf import read_urdf
from rivals import Missing
from samples import Array

# What pinocchio calls its broad phases. The "naive" one compares all boxes, and is the fastest on an arm.
MANAGERS = {
    "AABB tree": "DynamicAABBTreeCollisionManager",
    "box by box": "NaiveCollisionManager",
    "sort and sweep": "SSaPCollisionManager",
}
# The one whose cost is asked about.
TREE = "AABB tree"


class Pinocchio:
    """pinocchio and Coal, told the robot, the scene and the pairs of a `CollisionChecker`.

    Pieces become Coal's convex hulls, boxes and cylinders; the time to make them is not counted. Coal stops at the
    first contact, and makes no contact points.

    Attributes
    ----------
    single : dict
        Name of a way to ask, to a function of one configuration, as `configurations` gives them, and True.
    ways : dict
        Name to a function of many configurations to answers.
    """

    def __init__(self, checker: CollisionChecker, urdf: Path) -> None:
        for package in ("pinocchio", "coal"):
            if find_spec(package) is None:
                raise Missing(f"package {package} is not installed")
        import pinocchio as pin

        self._pin = pin
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.geometry = _geometry(self.model, checker)
        self._columns = _columns(self.model, checker, urdf)
        self.prepare()

    def prepare(self) -> None:
        """Make what works on the geometry as it is now."""
        pin = self._pin
        self.data, self.geometry_data = self.model.createData(), self.geometry.createData()
        fixed = self.model, self.data
        self.single: dict[str, Callable[[Array, bool], bool]] = {
            "all pairs": partial(pin.computeCollisions, *fixed, self.geometry, self.geometry_data)
        }
        for name, manager in MANAGERS.items():
            made = getattr(pin, f"BroadPhaseManager_{manager}")(self.model, self.geometry, self.geometry_data)
            self.single[name] = partial(pin.computeCollisions, *fixed, made)
        self.ways: dict[str, Callable[[Array], Array]] = {
            name: partial(_in_turn, check) for name, check in self.single.items()
        }
        self.ways[f"{TREE}, one call"] = self._pooled()

    def configurations(self, Q: Array) -> Array:
        """The same as pinocchio writes them: mimicking joints too, unlimited ones as cosine and sine."""
        column, factor, offset, phase = self._columns
        values = Q[..., column] * factor + offset
        return np.ascontiguousarray(np.where(np.isnan(phase), values, np.sin(values + phase)))

    def distance(self, q: Array) -> float:
        """Coal's distance of the nearest pair, metres; negative is a depth."""
        self._pin.computeDistances(self.model, self.data, self.geometry, self.geometry_data, q)
        return min(result.min_distance for result in self.geometry_data.distanceResults)

    def _pooled(self) -> Callable[[Array], Array]:
        pin = self._pin
        pool = getattr(pin, f"BroadPhaseManagerPool_{MANAGERS[TREE]}")(self.model, self.geometry, 1)

        def collide(Q: Array) -> Array:
            return np.asarray(pin.computeCollisionsInParallel(1, pool, np.asfortranarray(Q.T), True, False), dtype=bool)

        return collide


def _in_turn(check: Callable[[Array, bool], bool], Q: Array) -> Array:
    return np.array([check(q, True) for q in Q])


def _geometry(model: Any, checker: CollisionChecker) -> Any:
    import pinocchio as pin

    geometry = pin.GeometryModel()
    numbers: dict[str, list[int]] = {}
    for name, body in checker.robot.bodies.items():
        frame = model.getFrameId(name, pin.FrameType.BODY)
        at = model.frames[frame]
        numbers[name] = [
            geometry.addGeometryObject(pin.GeometryObject(f"{name} {k}", at.parentJoint, frame, at.placement, shape))
            for k, shape in enumerate(_shapes(body))
        ]
    for name in checker.scene.static_names:
        T = pin.SE3(checker.scene.pose(name))
        numbers[name] = [
            geometry.addGeometryObject(pin.GeometryObject(f"{name} {k}", 0, 0, T, shape))
            for k, shape in enumerate(_shapes(checker.scene[name]))
        ]
    for a, b in checker.checked_pairs:
        for i in numbers[a]:
            for j in numbers[b]:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    return geometry


def _shapes(body: Body) -> list[Any]:
    return [_shape(piece) for piece in body.pieces]


def _shape(piece: Piece) -> Any:
    """Coal's shape of a piece. Round pieces are taken as `Body` makes them, about the origin along z."""
    import coal

    if piece.kind == "cylinder":
        radius, _, half = np.sqrt(np.diag(piece.inner.shape_matrix))
        return coal.Cylinder(radius, 2 * half)
    if piece.kind == "sphere":
        return coal.Sphere(float(piece.inner.semi_axes[0]))
    if piece.vertices is None:
        raise Missing(f"no shape of Coal's is taken for a {piece.kind}")
    half = piece.vertices.max(axis=0)
    if len(piece.vertices) == 8 and (np.abs(piece.vertices) == half).all():
        return coal.Box(*(2 * half))
    points = coal.StdVec_Vec3s()
    points.extend(piece.vertices)
    return coal.Convex.convexHull(points, True, None)


def _columns(model: Any, checker: CollisionChecker, urdf: Path) -> tuple[Array, Array, Array, Array]:
    """For each entry of pinocchio's: our column, factor, offset, and where it is a sine, what is added to the angle."""
    ours = {name: k for k, name in enumerate(checker.robot.configuration_names)}
    described = read_urdf(urdf).joints
    entries = []
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if described[name].kind in ("floating", "planar"):
            raise Missing(f"joint {name} is {described[name].kind}")
        mimic = described[name].mimic
        source = (ours[mimic.joint], mimic.multiplier, mimic.offset) if mimic else (ours[name], 1.0, 0.0)
        phases = (np.nan,) if joint.nq == 1 else (np.pi / 2, 0.0)
        entries += [(*source, phase) for phase in phases]
    column, factor, offset, phase = np.array(entries).T
    return column.astype(int), factor, offset, phase
