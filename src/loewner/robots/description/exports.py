"""Write robots for other programs, as URDF with SRDF and as MJCF."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from loewner._base import _elementary, _validate
from loewner._base._files import replacing
from loewner._base._matrices import image, in_frame
from loewner._base._plausible import FARTHEST_LIMIT, told_to
from loewner._base._rotations import quaternions_of
from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies import packed_of
from loewner.bodies.exports import add_collisions, add_geoms, add_origin, enlarged, numbers, save_texts, text_of
from loewner.bodies.kinds import Mesh
from loewner.errors import InputError, LoewnerError
from loewner.robots.description.link_meshes import hull_or_solid
from loewner.robots.description.reaching import turning_axis
from loewner.robots.description.srdf import read_srdf
from loewner.robots.description.tree import KINDS, adjacent_pairs, constant_pose
from loewner.robots.description.urdf import LEAST_CUT, RATES, VALUES, Joint, Mimic, read_urdf
from loewner.robots.description.xacro_files import SUFFIX

# Kinds of joints, keyed by the kernels' numbers. Turning joints without limits become "continuous" later.
NAMES = {number: name for name, number in KINDS.items() if name not in ("continuous", "ball")}
ONE_VALUE = (columns.REVOLUTE, columns.PRISMATIC)


def save_urdf(robot: Any, path: Path, mesh_prefix: str, wider: float = 0.0) -> None:
    """Write a robot's URDF, its mesh files next to the URDF, and an SRDF with the same stem.

    Shapes other than spheres and meshes are enlarged by `wider` [m] on each side.
    """
    semantics = path.with_suffix(".srdf")
    if path.suffix.lower() in (".srdf", SUFFIX):
        raise InputError(f"path: expected the path of a URDF, found {path}, which is read as another format")
    _expect_plain_names(path.name, robot)
    listed = robot.disabled_pairs if robot._lists_pairs else robot.adjacent_pairs
    bare = [link for link in robot.link_names if link not in robot.bodies]
    top = _top(robot, needed=len(robot.bodies) > 1 and not listed and not bare)
    urdf, meshes = _description(robot, top, path, mesh_prefix, wider)
    try:
        with told_to([]):
            described = read_urdf(path, urdf)
            alike = not robot._lists_pairs and adjacent_pairs(described) == robot.adjacent_pairs
            if alike and (robot.groups or robot.states):  # an SRDF that names nothing would cause a warning
                srdf = _semantics(robot, (), "")
            else:
                # Without any rule, adjacent links would be exempt. Write a rule that exempts no pair that could
                # collide: a rule for a link without a body, or for the only link.
                srdf = _semantics(robot, listed, "" if listed else top or (*bare, *robot.link_names)[0])
            read_srdf(semantics, described, srdf)
    except LoewnerError as error:
        raise InputError(
            f"expected a robot that URDF and SRDF can express, found one that is refused: {error}"
        ) from None
    with replacing(path) as new_urdf, replacing(semantics) as new_srdf:
        save_texts(meshes)
        new_srdf.write_text(srdf, encoding="utf-8")
        new_urdf.write_text(urdf, encoding="utf-8")


def _expect_plain_names(stem: str, robot: Any) -> None:
    """Refuse names that readers would change, since readers strip spaces, and xacro evaluates expressions."""
    of_robot = (*robot.link_names, *robot.joint_names, *robot.mimics, *robot.groups, *robot.states)
    for name in (stem, robot.name, *of_robot):
        if not name.isprintable() or name != name.strip() or "$" in name:
            raise InputError(
                "expected names that can be printed, without '$' and without spaces at their ends, found "
                f"{_validate.short(name)}"
            )


def _description(
    robot: Any, top: str | None, path: Path, mesh_prefix: str, wider: float
) -> tuple[str, dict[Path, str]]:
    """Return the text of the URDF, with the root link `top` if it is not None, and the contents of its mesh files."""
    root = ElementTree.Element("robot", name=robot.name)
    meshes: dict[Path, str] = {}
    if top is not None:
        ElementTree.SubElement(root, "link", name=top)
    for name in robot.link_names:
        link = ElementTree.SubElement(root, "link", name=name)
        if name in robot.bodies:
            meshes |= _shapes(link, robot, path, mesh_prefix, wider)
    joints = list(_joints(robot, top))
    places = {name: k for k, name in enumerate(robot.joint_names)}
    for joint in sorted(joints, key=lambda joint: places.get(joint.name, len(places))):
        _add_joint(root, joint)
    if np.isfinite([(joint.acceleration, joint.jerk) for joint in joints]).any():
        root.set("version", "1.2")
    return text_of(root), meshes


def _top(robot: Any, *, needed: bool) -> str | None:
    """Return the name of a new root link that represents the world, or None if the robot's own root link suffices."""
    roots = [link for link in robot.link_names if robot._above.get(link, ("", None))[1] is None]
    if not needed and len(roots) == 1 and np.array_equal(constant_pose(robot.tree.constants[0]), np.eye(4)):
        return None
    return _validate.unused("world", robot.link_names)


def _shapes(link: ElementTree.Element, robot: Any, path: Path, mesh_prefix: str, wider: float) -> dict[Path, str]:
    """Add the shapes of a link; return the contents of mesh files."""
    name = link.attrib["name"]
    packed = packed_of(robot.bodies[name])
    kind = enlarged(packed)
    if kind is not None:
        raise InputError(
            f"link {name!r}: expected shapes that URDF has, found a piece of kind {kind!r}; Body.to_urdf writes "
            "polytopes around such pieces"
        )
    try:
        return add_collisions(link, packed, path, None, mesh_prefix, _stays_solid, wider)
    except InputError as error:
        raise InputError(f"link {name!r}: {error}") from None


def _stays_solid(mesh: Mesh) -> bool:
    """Return whether `from_urdf` would turn a mesh into a solid again, not into its hull."""
    return hull_or_solid(*mesh)[0] == "solid"


# -- joints ---------------------------------------------------------------------------------------


def _joints(robot: Any, top: str | None) -> Iterator[Joint]:
    """List the joints as in a URDF, in the order of their child links."""
    tree, number = robot.tree, {name: k for k, name in enumerate(robot.link_names)}
    driven = {at.start: name for name, at in robot._columns.items()}
    taken = {*robot.joint_names, *robot.mimics}
    for child, k in number.items():
        name, parent = robot._above.get(child, ("", None))
        if parent is None and top is None:
            continue
        kind = int(tree.kind[k])
        if kind == columns.FIXED:  # a fixed joint's name may be missing or taken
            name = _validate.unused(name or child, taken)
            taken.add(name)
        if kind not in NAMES:
            raise InputError(f"expected joints that URDF has, found the ball joint {name!r}")
        offset, mimic = float(tree.offset[k]), None
        if name in robot.mimics:
            mimic = Mimic(driven[int(tree.column[k])], float(tree.multiplier[k]), offset)
        pose, axis = _pose_and_axis(tree.constants[k], kind, 0.0 if mimic else offset)
        if parent is not None and tree.kind[number[parent]] == columns.FIXED:  # the parent is a frame of a rigid group
            pose = in_frame(constant_pose(tree.constants[number[parent]]), pose)
        if kind not in (*ONE_VALUE, columns.FIXED):
            _refuse_bounds(robot, name)
        limits = _limits(robot, int(tree.column[k]), mimic) if kind in ONE_VALUE else {}
        joint = Joint(name, NAMES[kind], parent or top or "", child, pose, axis, mimic=mimic, **limits)
        endless = kind == columns.REVOLUTE and joint.range == (-math.inf, math.inf)
        yield replace(joint, kind="continuous") if endless else joint


def _pose_and_axis(constants: Floats, kind: int, offset: float) -> tuple[Floats, Floats]:
    """Return the pose of a joint, and its axis in its own frame; see `tree.tree_of`.

    In MJCF, the value of a joint at its origin may differ from 0; `offset` is minus this value.
    """
    pose, axis = constant_pose(constants), np.array([1.0, 0.0, 0.0])
    if kind == columns.PRISMATIC:
        across = constants[columns.ACROSS : columns.ACROSS + 3]
        axis = image(pose[:3, :3].T, across)
        pose[:3, 3] += offset * across
    if kind in (columns.REVOLUTE, columns.PLANAR):
        sine, cosine = (constants[at : at + 9].reshape(3, 3) for at in (columns.SINE, columns.COSINE))
        axis = turning_axis(constants)
        pose[:3, :3] += _elementary.sin(offset) * sine + _elementary.cos(offset) * cosine
    return pose, axis


def _limits(robot: Any, column: int, mimic: Mimic | None) -> dict[str, Any]:
    """Return limits and rates of a joint with one value, and the limits for planning if they are narrower."""
    hard = float(robot.hard_lower[column]), float(robot.hard_upper[column])
    if mimic is not None:
        _, multiplier, offset = mimic
        lower, upper = sorted(multiplier * end + offset for end in hard) if multiplier else (offset, offset)
        # If rounding would make these limits narrow the followed joint's limits, leave them out: the followed joint's
        # limits already imply them.
        back = sorted((end - offset) / multiplier for end in (lower, upper)) if multiplier else hard
        rounded = abs(back[0] - hard[0]) > LEAST_CUT / 2 or abs(back[1] - hard[1]) > LEAST_CUT / 2
        if rounded or max(-lower, upper) > FARTHEST_LIMIT:
            lower, upper = -math.inf, math.inf
        return {"lower": lower, "upper": upper}
    soft = float(robot.lower[column]), float(robot.upper[column])
    rates = {name: float(getattr(robot, name)[column]) for name in RATES}
    return {"lower": hard[0], "upper": hard[1], **rates} | ({} if soft == hard else {"soft": soft})


def _refuse_bounds(robot: Any, name: str) -> None:
    """Refuse limits of a planar or floating joint, since URDF cannot express them."""
    values = robot._columns[name]
    first = slice(values.start, values.start + 3)  # the quaternion of a floating joint follows
    if np.isfinite([robot.lower[first], robot.upper[first]]).any():
        raise InputError(f"expected limits that URDF has, found bounds of {name!r}, which has several values")


def _add_joint(root: ElementTree.Element, joint: Joint) -> None:
    element = ElementTree.SubElement(root, "joint", name=joint.name, type=joint.kind)
    add = partial(ElementTree.SubElement, element)
    add("parent", link=joint.parent)
    add("child", link=joint.child)
    add_origin(element, joint.origin[:3, :3], joint.origin[:3, 3])
    if joint.kind not in ("fixed", "floating"):
        add("axis", xyz=numbers(joint.axis))
    if VALUES[joint.kind] == ("",):
        # Readers expect an effort and a velocity; 0 means that there is no limit.
        limits = {"effort": 0.0, "velocity": 0.0}
        if joint.kind != "continuous":
            limits |= {"lower": joint.lower, "upper": joint.upper}
        limits |= {rate: value for rate in RATES if math.isfinite(value := getattr(joint, rate))}
        add("limit", {name: numbers([value]) for name, value in limits.items()})
    if joint.soft != (-math.inf, math.inf):
        lower, upper = (numbers([end]) for end in joint.soft)
        add("safety_controller", soft_lower_limit=lower, soft_upper_limit=upper, k_velocity="0")
    if joint.mimic is not None:
        other, multiplier, offset = joint.mimic
        add("mimic", joint=other, multiplier=numbers([multiplier]), offset=numbers([offset]))


# -- MJCF -----------------------------------------------------------------------------------------


def mjcf_text(robot: Any, wider: float) -> str:
    """Write a robot as MJCF: its shapes, its joints with one value, and its exempt pairs as excluded pairs.

    Shapes other than spheres and meshes are enlarged by `wider` [m] on each side.
    """
    root = ElementTree.Element("mujoco", model=robot.name)
    # Links without shapes need some mass, since MuJoCo refuses moving bodies without mass.
    ElementTree.SubElement(root, "compiler", angle="radian", boundmass="1e-3", boundinertia="1e-6")
    # Parents and children are checked as well, unless they are among the excluded pairs.
    ElementTree.SubElement(ElementTree.SubElement(root, "option"), "flag", filterparent="disable")
    asset, world = ElementTree.SubElement(root, "asset"), ElementTree.SubElement(root, "worldbody")
    contact, equality = (ElementTree.SubElement(root, name) for name in ("contact", "equality"))
    above = {joint.child: joint for joint in _joints(robot, None)}
    elements: dict[str, ElementTree.Element] = {}
    for name in robot.link_names:
        joint = above.get(name)
        if name == "world":  # MuJoCo's own name for the world, which no other body may have
            if joint is not None or name in robot.bodies:
                fault = f"below the joint {joint.name!r}" if joint is not None else "with shapes"
                raise InputError(f"expected a link 'world' only as a root without shapes, found one {fault}")
            elements[name] = world
            continue
        body = elements[name] = ElementTree.SubElement(elements[joint.parent] if joint else world, "body", name=name)
        T = joint.origin if joint else constant_pose(robot.tree.constants[robot.link_names.index(name)])
        body.set("pos", numbers(T[:3, 3]))
        body.set("quat", numbers(quaternions_of(T[None, :3, :3])[0]))
        if joint is not None and joint.kind != "fixed":
            _add_mjcf_joint(body, equality, joint)
        if name in robot.bodies:
            add_geoms(body, asset, packed_of(robot.bodies[name]), wider=wider)
    for a, b in sorted(robot._usually_skipped):
        ElementTree.SubElement(contact, "exclude", body1=a, body2=b)
    return text_of(root)


def _add_mjcf_joint(body: ElementTree.Element, equality: ElementTree.Element, joint: Joint) -> None:
    if joint.kind in ("planar", "floating"):
        raise InputError(f"expected joints of one value, found the {joint.kind} joint {joint.name!r}")
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    element = ElementTree.SubElement(body, "joint", name=joint.name, type=kind, axis=numbers(joint.axis))
    ends = joint.lower, joint.upper
    if joint.lower == joint.upper:
        raise InputError(f"expected joints with a range, which MuJoCo needs, found equal limits of {joint.name!r}")
    if all(map(math.isfinite, ends)):
        element.set("range", numbers(ends))
        element.set("limited", "true")
    if joint.mimic is not None:
        other, multiplier, offset = joint.mimic
        follows = numbers([offset, multiplier, 0.0, 0.0, 0.0])
        ElementTree.SubElement(equality, "joint", joint1=joint.name, joint2=other, polycoef=follows)


# -- SRDF -----------------------------------------------------------------------------------------


def _semantics(robot: Any, exempt: Any, alone: str) -> str:
    """Write the groups, the states, the exempt pairs, and a rule for the link `alone`, unless this name is empty."""
    root = ElementTree.Element("robot", name=robot.name)
    for name, joints in robot.groups.items():
        group = ElementTree.SubElement(root, "group", name=name)
        for joint in joints:
            ElementTree.SubElement(group, "joint", name=joint)
    for name, (of, values) in robot.states.items():
        state = ElementTree.SubElement(root, "group_state", {"name": name} | ({"group": of} if of else {}))
        for joint, value in values.items():
            entries = np.atleast_1d(value)
            if len(entries) == len(VALUES["floating"]):  # SRDF writes the real part of a quaternion last
                entries = np.concatenate([entries[:3], entries[4:], entries[3:4]])
            ElementTree.SubElement(state, "joint", name=joint, value=numbers(entries))
    for a, b in sorted(exempt):
        ElementTree.SubElement(root, "disable_collisions", link1=a, link2=b)
    if alone:
        ElementTree.SubElement(root, "disable_default_collisions", link=alone)
    return text_of(root)
