"""Read robots from Drake's MultibodyPlant and SceneGraph. Drake is not imported; only the given objects are used."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from loewner._base import _validate
from loewner._base._plausible import warn
from loewner._base._validate import Floats
from loewner.bodies import Body
from loewner.errors import InputError
from loewner.robots.description.links import Joint
from loewner.robots.description.other_models import Model, Move, Order, Shape, chained, expect, made_body, unique
from loewner.robots.description.xml_elements import some

X, Y, Z = np.eye(3)

PRIMITIVES: dict[str, Callable[[Any], Body]] = {
    "Box": lambda shape: Body.box(shape.size()),
    "Sphere": lambda shape: Body.sphere(shape.radius()),
    "Capsule": lambda shape: Body.capsule(shape.radius(), shape.length()),
    "Cylinder": lambda shape: Body.cylinder(shape.radius(), shape.length()),
    "Ellipsoid": lambda shape: Body.ellipsoid([shape.a(), shape.b(), shape.c()]),
    "HalfSpace": lambda shape: Body.half_space(Z, 0.0),
}


def drake_model(
    plant: Any, scene_graph: Any, context: Any, mimic: Mapping[str, tuple[str, float, float]], tol: float
) -> Model:
    """Read a plant and its collision geometry; see `Robot.from_drake`."""
    expect(plant, "MultibodyPlant", "plant")
    expect(scene_graph, "SceneGraph", "scene_graph")
    if not plant.is_finalized():
        raise InputError("plant: expected one that is finalized, found one that is not")
    mimic = _validate.mapping(mimic, "mimic", "from names of joints")
    inspector, state = scene_graph.model_inspector(), plant.CreateDefaultContext()
    if not plant.geometry_source_is_registered() or not inspector.SourceIsRegistered(plant.get_source_id()):
        raise InputError("scene_graph: expected the one with which the plant is registered, found another one")
    if context is not None:
        try:
            state = plant.GetMyContextFromRoot(context)
            query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
        except (RuntimeError, TypeError) as error:
            why = " ".join(str(error).split())[:200]
            raise InputError(f"context: expected the context of the whole diagram, found another ({why})") from None
        inspector = query.inspector()
    if plant.num_constraints() > len(mimic):
        warn(
            f"{plant.num_constraints()} constraints between bodies or joints are not read, since Drake's Python "
            "interface cannot read them; pass couplers as mimic={joint: (other, gear ratio, offset)}"
        )
    elements = [plant.get_joint(index) for index in plant.GetJointIndices()]
    ends = [body for element in elements for body in (element.parent_body(), element.child_body())]
    bodies = {int(body.index()): body for body in (plant.world_body(), *ends)}
    links = dict(zip(bodies, _names(plant, list(bodies.values())), strict=True))
    constants: dict[int, float] = {}
    moves = list(_joints(plant, state, elements, links, constants))
    columns = {joint.name: theirs for joint, theirs in moves if theirs}
    for name in mimic:
        _validate.known(name, "joint in mimic", columns)
    joints = [replace(joint, mimic=mimic[joint.name]) if joint.name in mimic else joint for joint, _ in moves]
    joints.sort(key=lambda joint: min(columns.get(joint.name, (plant.num_positions(),))))
    geometries, shapes = _shapes(plant, inspector, links, tol)
    checked = np.array([not inspector.CollisionFiltered(a, b) for a in geometries for b in geometries], dtype=bool)
    return Model(
        name=plant.get_name() or "plant",
        links=tuple(dict.fromkeys([*links.values(), *(joint.child for joint in joints)])),
        joints=tuple(joints),
        shapes=shapes,
        checked=checked.reshape(len(shapes), len(shapes)),
        order=Order(plant.num_positions(), columns, constants),
    )


def _joints(
    plant: Any, state: Any, elements: Sequence[Any], links: Mapping[int, str], constants: dict[int, float]
) -> Iterator[Move]:
    """List the joints with the columns of their values, and add the values of locked joints to `constants`."""
    q = plant.GetPositions(state)
    for element, name in zip(elements, _names(plant, elements), strict=True):
        parent, child = element.parent_body(), element.child_body()
        if child.index() == plant.world_body().index():
            raise InputError(f"joint {name!r}: expected the world as parent, found it as child; exchange the frames")
        above, below = element.frame_on_parent(), element.frame_on_child()
        before, behind = (frame.CalcPoseInBodyFrame(state) for frame in (above, below))
        start = element.position_start()
        if element.num_positions() == 0 or element.is_locked(state):
            before = before @ below.CalcPose(state, above)
            moves: list[Move] = [(Joint(name, "fixed", "", ""), ())]
            constants |= {start + k: float(q[start + k]) for k in range(element.num_positions())}
        else:
            moves = [(move, tuple(start + k for k in theirs)) for move, theirs in _moves(plant, element, name)]
        ends = links[int(parent.index())], links[int(child.index())]
        yield from chained(moves, *ends, before.GetAsMatrix4(), behind.inverse().GetAsMatrix4())


def _names(plant: Any, elements: Sequence[Any]) -> list[str]:
    """Return the names of bodies or joints; names that occur twice are prefixed with their model instances."""
    scopes = [plant.GetModelInstanceName(element.model_instance()) for element in elements]
    return unique([element.name() for element in elements], scopes)


def _moves(plant: Any, joint: Any, name: str) -> Iterator[Move]:
    """List one-value joints, or the floating joint, that represent a Drake joint, with the columns of their values."""
    kind = joint.type_name()
    lower, upper = joint.position_lower_limits(), joint.position_upper_limits()
    rates = (
        np.minimum(joint.velocity_upper_limits(), -joint.velocity_lower_limits()),
        np.minimum(joint.acceleration_upper_limits(), -joint.acceleration_lower_limits()),
    )

    def single(suffix: str, kind: Any, axis: Floats, at: int, *, rated: bool = True) -> Move:
        velocity, acceleration = (float(most[at]) if rated and 0 < most[at] < math.inf else None for most in rates)
        single_joint = Joint(
            name + suffix, kind, "", "", axis=axis, lower=lower[at], upper=upper[at], velocity=velocity,
            acceleration=acceleration,
        )  # fmt: skip
        return single_joint, (at,)

    if kind == "revolute":
        yield single("", "revolute", joint.revolute_axis(), 0)
    elif kind == "prismatic":
        yield single("", "prismatic", joint.translation_axis(), 0)
    elif kind == "screw":
        axis = _screw_axis(plant, joint)
        yield single("", "revolute", axis, 0)
        pitch = joint.screw_pitch() / (2 * math.pi)
        yield Joint(f"{name}/slide", "prismatic", "", "", axis=axis, mimic=(name, pitch, 0.0)), ()
    elif kind == "planar":
        yield from (single(f"/{'xy'[k]}", "prismatic", (X, Y)[k], k) for k in (0, 1))
        yield single("/theta", "revolute", Z, 2)
    elif kind == "universal":
        yield from (single("/qx", "revolute", X, 0), single("/qy", "revolute", Y, 1))
    elif kind in ("ball_rpy", "rpy_floating"):  # the rotation is Rz Ry Rx; rates are limits of the angular velocity
        if kind == "rpy_floating":
            yield from (single(f"/{'xyz'[k]}", "prismatic", axis, 3 + k) for k, axis in enumerate((X, Y, Z)))
        yield from (single(f"/q{'xyz'[k]}", "revolute", (X, Y, Z)[k], k, rated=False) for k in (2, 1, 0))
    elif kind == "quaternion_floating":
        yield Joint(name, "floating", "", "", lower=lower[4:], upper=upper[4:]), (4, 5, 6, 0, 1, 2, 3)
    else:
        raise InputError(f"joint {name!r}: expected a joint that a robot can have, found one of Drake's kind {kind!r}")


def _screw_axis(plant: Any, joint: Any) -> Floats:
    """Compute the axis of a screw joint from poses, since Drake's Python has no function that returns the axis."""
    state = plant.CreateDefaultContext()
    q = plant.GetPositions(state)
    q[joint.position_start()] = 1.0
    plant.SetPositions(state, q)
    R = joint.frame_on_child().CalcPose(state, joint.frame_on_parent()).rotation().matrix()
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])


def _shapes(plant: Any, inspector: Any, links: Mapping[int, str], tol: float) -> tuple[list[Any], list[Shape]]:
    """Read all collision geometry."""
    geometries, shapes, unread = [], [], []
    for frame in inspector.GetAllFrameIds():
        body = plant.GetBodyFromFrameId(frame)
        for geometry in sorted(inspector.GetGeometries(frame), key=lambda geometry: geometry.get_value()):
            if inspector.GetProximityProperties(geometry) is None:
                continue
            name = inspector.GetName(geometry)
            if body is None or inspector.IsDeformableGeometry(geometry):
                unread.append(repr(name))
                continue
            T = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            shape_body = made_body(partial(_body, inspector, geometry, tol), f"geometry {name!r}")
            geometries.append(geometry)
            shapes.append(Shape(links[int(body.index())], name, shape_body, T))
    if unread:
        warn(f"not read, although Drake checks it: geometry that is deformable or outside the plant: {some(unread)}")
    return geometries, shapes


def _body(inspector: Any, geometry: Any, tol: float) -> Body:
    """Make the body of one geometry. Drake replaces meshes with their convex hulls."""
    shape, hull = inspector.GetShape(geometry), inspector.GetConvexHull(geometry)
    kind = type(shape).__name__
    if kind in PRIMITIVES:
        return PRIMITIVES[kind](shape)
    if hull is None:
        raise InputError(f"expected a box, sphere, capsule, cylinder, ellipsoid, half-space or mesh, found a {kind}")
    return Body.from_points([hull.vertex(k) for k in range(hull.num_vertices())], tol=tol)
