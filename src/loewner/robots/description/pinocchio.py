"""Read robots from pinocchio's models. Neither pinocchio nor Coal is imported; only the given objects are used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from loewner._base import _validate
from loewner._base._matrices import in_frame
from loewner._base._plausible import warn
from loewner._base._validate import Floats
from loewner.errors import InputError
from loewner.robots.description.coal_shapes import coal_body
from loewner.robots.description.link_bodies import MODELS
from loewner.robots.description.link_meshes import described, warn_of_open_meshes
from loewner.robots.description.links import Joint, JointKind
from loewner.robots.description.other_models import Model, Move, Order, Shape, chained, expect, made_body, unique

X, Y, Z = np.eye(3)


def pinocchio_model(model: Any, geometry_model: Any, meshes: str, tol: float) -> Model:
    """Read a model and its collision geometry; see `Robot.from_pinocchio`."""
    expect(model, "Model", "model")
    expect(geometry_model, "GeometryModel", "geometry_model")
    _validate.choice(meshes, "meshes", MODELS)
    of_body, at_joint = _links(model)
    moves: list[Move] = []
    for k in range(1, model.njoints):
        ends, T = (at_joint[int(model.parents[k])], at_joint[k]), model.jointPlacements[k].homogeneous
        moves += chained(list(_moves(model, model.joints[k], model.names[k])), *ends, T, np.eye(4))
    joints, columns = [joint for joint, _ in moves], {joint.name: theirs for joint, theirs in moves if theirs}
    for k, name in of_body.items():
        frame = model.frames[k]
        on = at_joint[int(frame.parentJoint)]
        if on != name:
            joints.append(Joint(f"{name} fixed", "fixed", on, name, frame.placement.homogeneous))
    shapes = [_shape(model, shape, of_body, at_joint, meshes, tol) for shape in geometry_model.geometryObjects]
    if meshes == "auto":
        are_meshes = (type(shape.geometry).__name__.startswith("BVHModel") for shape in geometry_model.geometryObjects)
        told = [
            (shape.name, described(shape.body)) for shape, is_mesh in zip(shapes, are_meshes, strict=True) if is_mesh
        ]
        warn_of_open_meshes(model.name or "model", told, "meshes='surface'")
    checked = np.zeros((len(shapes), len(shapes)), dtype=bool)
    enabled = [not shape.disableCollision for shape in geometry_model.geometryObjects]
    for pair in geometry_model.collisionPairs:
        a, b = int(pair.first), int(pair.second)
        checked[a, b] = checked[b, a] = enabled[a] and enabled[b] and a != b
    if len(shapes) > 1 and not checked.any():
        warn(
            f"geometry_model: expected collisionPairs, found none for {len(shapes)} shapes, so none of them "
            "are checked against each other; addAllCollisionPairs() adds all pairs"
        )
    return Model(
        name=model.name or "model",
        links=tuple(dict.fromkeys([at_joint[0], *(joint.child for joint in joints)])),
        joints=tuple(joints),
        shapes=shapes,
        checked=checked,
        order=Order(model.nq, columns, {}),
    )


def _links(model: Any) -> tuple[dict[int, str], dict[int, str]]:
    """Return the names of the links of body frames, keyed by frame number, and of the links that joints move.

    A joint moves the first body whose frame is the joint's frame. If there is no such body, as for the world, the joint
    moves a link with the joint's name.
    """
    bodies = [k for k, frame in enumerate(model.frames) if frame.type.name == "BODY"]
    of_body = dict(zip(bodies, unique([model.frames[k].name for k in bodies], ["BODY"] * len(bodies)), strict=True))
    at_joint: dict[int, str] = {}
    for k, name in of_body.items():
        frame = model.frames[k]
        if frame.parentJoint and np.array_equal(frame.placement.homogeneous, np.eye(4)):
            at_joint.setdefault(int(frame.parentJoint), name)
    taken = list(of_body.values())
    for joint in range(model.njoints):
        if joint not in at_joint:
            at_joint[joint] = _validate.unused(model.names[joint], taken)
            taken.append(at_joint[joint])
    return of_body, at_joint


def _shape(
    model: Any, shape: Any, of_body: Mapping[int, str], at_joint: Mapping[int, str], meshes: str, tol: float
) -> Shape:
    """Read a collision shape, which is placed in the frame of its joint."""
    joint, frame = int(shape.parentJoint), int(shape.parentFrame)
    if joint >= model.njoints:
        raise InputError(f"geometry {shape.name!r}: expected a joint of the model, found joint {joint}")
    link, T = at_joint[joint], shape.placement.homogeneous
    if frame in of_body and int(model.frames[frame].parentJoint) == joint and of_body[frame] != link:
        link, T = of_body[frame], in_frame(model.frames[frame].placement.homogeneous, T)
    body = made_body(partial(coal_body, shape.geometry, meshes, tol), f"geometry {shape.name!r}")
    return Shape(link, shape.name, body, T)


# -- joints ---------------------------------------------------------------------------------------


def _moves(model: Any, joint: Any, name: str) -> Iterator[Move]:
    """List the joints that together represent a joint of pinocchio, and the columns of their values."""
    kind, q = joint.shortname(), int(joint.idx_q)
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit

    def single(suffix: str, kind: Any, axis: Floats, at: int, limited: bool = True, rated: bool = True) -> Move:
        low, high = (float(lower[q + at]), float(upper[q + at])) if limited else (-math.inf, math.inf)
        rate = float(model.velocityLimit[int(joint.idx_v) + at]) if rated else math.nan
        velocity = rate if 0 < rate < math.inf else None
        return Joint(name + suffix, kind, "", "", axis=axis, lower=low, upper=high, velocity=velocity), (q + at,)

    if kind == "JointModelMimic":
        yield _mimicking(model, joint, name), ()
    elif kind == "JointModelComposite":
        yield from _composite(model, joint.extract(), name)
    elif kind == "JointModelFreeFlyer":
        free_flyer = Joint(name, "floating", "", "", lower=lower[q : q + 3], upper=upper[q : q + 3])
        yield free_flyer, (q, q + 1, q + 2, q + 6, q + 3, q + 4, q + 5)
    elif kind == "JointModelSpherical":
        yield Joint(name, "ball", "", ""), (q + 3, q, q + 1, q + 2)
    elif kind == "JointModelSphericalZYX":
        yield from (single(f"/{'zyx'[k]}", "revolute", axis, k) for k, axis in enumerate((Z, Y, X)))
    elif kind == "JointModelTranslation":
        yield from (single(f"/{'xyz'[k]}", "prismatic", axis, k) for k, axis in enumerate((X, Y, Z)))
    elif kind == "JointModelPlanar":
        # A planar joint's velocity limits apply to axes that turn with the child.
        yield from (single(f"/{'xy'[k]}", "prismatic", axis, k, rated=False) for k, axis in enumerate((X, Y)))
        turn, _ = single("/theta", "revolute", Z, 2, limited=False)
        yield turn, (q + 2, q + 3)
    elif kind == "JointModelUniversal":
        both = joint.extract()
        yield from (single(f"/{k + 1}", "revolute", axis, k) for k, axis in enumerate((both.axis1, both.axis2)))
    elif joint.nv == 1:
        along, axis = _screw(model, joint)
        if not axis.any():
            yield single("", "prismatic", along, 0)
        elif joint.nq == 2:
            turn, _ = single("", "revolute", axis, 0, limited=False)
            yield turn, (q, q + 1)
        else:
            yield single("", "revolute", axis, 0)
            pitch = float(along @ axis)
            if along.any():
                yield Joint(f"{name}/slide", "prismatic", "", "", axis=axis, mimic=(name, pitch, 0.0)), ()
    else:
        raise InputError(f"joint {name!r}: expected a joint that a robot can have, found one of the kind {kind}")


def _screw(model: Any, joint: Any) -> tuple[Floats, Floats]:
    """Return the velocity and the angular velocity of a joint with one value, at a rate of 1."""
    data = joint.createData()
    joint.calc(data, np.eye(1, model.nq, joint.idx_q)[0])  # `calc` reads beyond the end of shorter arrays
    motion = np.asarray(data.S, dtype=np.float64).reshape(6)
    return motion[:3], motion[3:]


def _mimicking(model: Any, joint: Any, name: str) -> Joint:
    rule = joint.extract()
    followed = model.names[list(model.mimicked_joints)[list(model.mimicking_joints).index(joint.id)]]
    along, axis = (part / rule.scaling if rule.scaling else part for part in _screw(model, joint))
    turns = bool(axis.any())
    if turns and along.any() or not (turns or along.any()):
        raise InputError(f"joint {name!r}: expected a mimicking joint that turns or slides, found one of another kind")
    kind: JointKind = "revolute" if turns else "prismatic"
    return Joint(name, kind, "", "", axis=axis if turns else along, mimic=(followed, rule.scaling, rule.offset))


def _composite(model: Any, joint: Any, name: str) -> Iterator[Move]:
    for k, part in enumerate(joint.joints):
        for number, (move, theirs) in enumerate(_moves(model, part, f"{name}/{k}")):
            before = joint.jointPlacements[k].homogeneous if number == 0 else None
            yield replace(move, T_parent_joint=before), theirs
