"""Convert MuJoCo models to trees of links and joints."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import accumulate, pairwise

import numpy as np

from loewner._base._matrices import product
from loewner._base._plausible import warn
from loewner._base._validate import Floats, unused
from loewner.bodies import Body
from loewner.robots.description.srdf import Semantics, State
from loewner.robots.description.urdf import VALUES, Description, Joint, Mimic, narrowed, without_chains
from loewner.robots.description.xml_elements import some
from loewner.scenes.mjcf_models import MjcfBody, MjcfJoint, MjcfModel

# Largest deviation of a joint's value in a keyframe from the value that couplings determine [rad or m].
UNCOUPLED = 1e-6

KINDS = {"slide": "prismatic", "ball": "ball", "free": "floating"}


def description_of(model: MjcfModel) -> tuple[Description, dict[str, Body]]:
    """Read the links and joints of a model, and the bodies of the links.

    Each body of the model is a link in its own frame. If a body has several joints, or the anchor of its joint is not
    at its origin, a chain of links without collision geometry is inserted above it. Each additional part of a body is a
    link that is fixed to the body's own link.
    """
    above: dict[str, Joint] = {}
    links = {name for body in model.bodies for name in (body.name, *body.parts)}
    for number, body in enumerate(model.bodies):
        if number:  # body 0 is the world
            above |= {joint.child: joint for joint in _joints_of(body, model.bodies[body.parent].name, links)}
        others = (name for name in body.parts if name != body.name)
        above |= {name: Joint(name, "fixed", body.name, name, np.eye(4)) for name in others}
    joints = {joint.name: joint for joint in above.values() if joint.kind != "fixed"}
    joints = narrowed(without_chains(joints, model.path), model.path)
    above |= {joint.child: joint for joint in joints.values()}
    order = [model.bodies[0].name, *above]
    bodies = {name: part for body in model.bodies for name, part in body.parts.items()}
    return Description(model.name, model.path, dict.fromkeys(order, ()), joints, above, ()), bodies


def semantics_of(model: MjcfModel, robot: Description) -> Semantics:
    """Return the keyframes as states; the pairs of links that MuJoCo skips become disabled pairs."""
    states, theirs = {}, qpos_columns(robot)
    uncoupled = []
    for name, qpos in model.keyframes.items():
        state: State = ("", {})
        for joint, columns in theirs.items():
            values = tuple(qpos[list(columns)].tolist())
            rule = robot.joints[joint].mimic
            if rule is None:
                state[1][joint] = values[0] if len(values) == 1 else values
            elif abs(rule.multiplier * qpos[theirs[rule.joint][0]] + rule.offset - values[0]) > UNCOUPLED:
                uncoupled.append(f"{joint!r} in {name!r}")
        states[name] = state
    if uncoupled:
        warn(f"{model.path}: keyframes have values of joints that follow others, which are not used: {some(uncoupled)}")
    return Semantics(states=states, disabled_pairs=model.related_pairs | model.excluded_pairs, ruled=True)


def qpos_columns(robot: Description) -> dict[str, tuple[int, ...]]:
    """Return the columns of each joint in MuJoCo's qpos."""
    ends = [0, *accumulate(len(VALUES[joint.kind]) for joint in robot.joints.values())]
    return {name: tuple(range(*span)) for name, span in zip(robot.joints, pairwise(ends), strict=True)}


def _joints_of(body: MjcfBody, parent: str, links: set[str]) -> Iterator[Joint]:
    """List the joints between a body and its parent, starting at the parent.

    Hinges and balls turn about their anchors. The link below such a joint therefore has its origin at the anchor, and
    the next frame is shifted back.
    """
    T_above_body = body.T_parent_body  # the body's frame so far, relative to the last link
    if body.joints and body.joints[0].kind == "free":  # the joint's values are the pose in the world
        T_above_body = np.eye(4)
    last = len(body.joints) - 1
    for number, joint in enumerate(body.joints):
        turns = joint.kind in ("hinge", "ball")
        anchor = joint.anchor if turns else np.zeros(3)
        ends = number == last and not anchor.any()
        child = body.name if ends else unused(f"{body.name}/{joint.name}", links)
        links.add(child)
        yield _moving(joint, parent, child, product(T_above_body, _shift(anchor)))
        parent, T_above_body = child, _shift(-anchor)
    if parent != body.name:
        yield Joint(body.name, "fixed", parent, body.name, T_above_body)


def _shift(by: Floats) -> Floats:
    T = np.eye(4)
    T[:3, 3] = by
    return T


def _moving(joint: MjcfJoint, parent: str, child: str, origin: Floats) -> Joint:
    limits = joint.lower, joint.upper
    kind = KINDS.get(joint.kind, "revolute" if any(map(math.isfinite, limits)) else "continuous")
    mimic = None if joint.mimic is None else Mimic(*joint.mimic)
    return Joint(joint.name, kind, parent, child, origin, joint.axis, *limits, mimic=mimic, reference=joint.reference)
