"""Describe robots in memory: links and joints as plain data, checked to form a tree."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._matrices import lengths, product
from loewner._base._validate import Floats
from loewner.bodies import Body
from loewner.errors import InputError
from loewner.robots.description import urdf
from loewner.robots.description.urdf import RATES, SHORTEST_AXIS, VALUES, Description, Mimic
from loewner.robots.description.xml_elements import LARGEST

JointKind = Literal["fixed", "revolute", "continuous", "prismatic", "planar", "floating", "ball"]

# For joints with several values, the number of values that have limits: x, y and the angle of a planar joint, and the
# position of a floating joint.
LIMITED_VALUES = {"planar": 3, "floating": 3}


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links, for `Robot.from_links`.

    The pose of the child in the frame of the parent is ``T_parent_joint @ motion @ T_joint_child``, where the motion
    is, for example, a turn about the axis or a shift along it.

    Attributes
    ----------
    name : str
    kind : {"fixed", "revolute", "continuous", "prismatic", "planar", "floating", "ball"}
        "planar": x, y and an angle about the axis, which is the z axis unless another axis is given. "floating": a
        position and a quaternion (wxyz). "ball": a quaternion.
    parent, child : str
        Names of links.
    T_parent_joint : array_like, shape (4, 4), optional
        Pose of the joint in the frame of the parent; translation in metres. Default: the identity.
    T_joint_child : array_like, shape (4, 4), optional
        Pose of the child in the frame that the joint moves. If this pose is given for a joint that moves, the frame
        that the joint moves becomes a link without a body, with the name CHILD/NAME. Default: the identity.
    axis : array_like, shape (3,)
        Axis in the frame of the joint; its length does not matter.
    lower, upper : float or array_like, shape (3,)
        Limits [rad or m]; for planar joints, the limits of x, y and the angle; for floating joints, the limits of the
        position. A "revolute" joint without limits is "continuous".
    velocity, acceleration, jerk : float, optional
        Largest velocity [rad/s or m/s], acceleration [rad/s² or m/s²] and jerk [rad/s³ or m/s³] of a joint with one
        value, above 0. By default they are unknown.
    mimic : (str, float, float), optional
        The name of another joint that this joint follows, a multiplier and an offset; only for a joint with one value.
    reference : float
        The value [rad or m] at which the motion of a revolute or prismatic joint is the identity.

    Examples
    --------
    >>> from loewner import Body, Joint, Robot
    >>> out = [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> robot = Robot.from_links(
    ...     {"base": None, "arm": [(Body.capsule(0.05, 0.4), out)], "hand": Body.sphere(0.1)},
    ...     [
    ...         Joint("shoulder", "revolute", "base", "arm", axis=[0, 1, 0], lower=-2, upper=2, velocity=3),
    ...         Joint("wrist", "continuous", "arm", "hand", T_parent_joint=out, mimic=("shoulder", -1.0, 0.0)),
    ...     ],
    ... )
    >>> robot
    Robot('robot', 3 links, 2 with bodies, 1 joints, dof 1)
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    T_parent_joint: ArrayLike | None = None
    T_joint_child: ArrayLike | None = None
    axis: ArrayLike = (0.0, 0.0, 1.0)
    lower: ArrayLike = -math.inf
    upper: ArrayLike = math.inf
    velocity: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    mimic: tuple[str, float, float] | None = None
    reference: float = 0.0


def described(
    links: Mapping[str, Body | None | Iterable[tuple[Body, ArrayLike | None]]], joints: Iterable[Joint], name: str
) -> tuple[Description, dict[str, Body]]:
    """Check links and joints in memory; see `Robot.from_links`.

    Returns
    -------
    description : Description
    bodies : dict
        Maps link names to bodies.
    """
    _validate.expect_name(name)
    _validate.mapping(links, "links", "from names to bodies", 1)
    bodies = {link: body for link, shapes in links.items() if (body := _body(link, shapes)) is not None}
    listed = _validate.listed(joints, "joints", wanted="a list of loewner.Joint")
    names = dict.fromkeys(links)  # in order; links for frames of joints are appended
    joints_by_name: dict[str, urdf.Joint] = {}
    above: dict[str, urdf.Joint] = {}
    for joint in listed:
        _validate.instance(joint, "joints", Joint)
        if _validate.expect_name(joint.name, "expected a name of a joint") in joints_by_name:
            raise InputError(f"joints: expected names that differ, found {joint.name!r} twice")
        for end in (joint.parent, joint.child):
            _validate.known(end, f"link of joint {joint.name!r}", links)
        if joint.child in above:
            raise InputError(
                f"joints: expected a tree, found link {joint.child!r} below two joints, {above[joint.child].name!r} "
                f"and {joint.name!r}"
            )
        checked, behind = checked_joint(joint, f" of joint {joint.name!r}")
        if behind is not None:
            frame = _validate.unused(f"{joint.child}/{joint.name}", names)
            names[frame] = None
            checked = replace(checked, child=frame)
            above[joint.child] = urdf.Joint(joint.child, "fixed", frame, joint.child, behind)
        above[checked.child] = joints_by_name[joint.name] = checked
    path = Path(name)
    for checked in joints_by_name.values():
        if checked.mimic is not None:
            _validate.known(checked.mimic.joint, f"joint that {checked.name!r} mimics", joints_by_name)
    joints_by_name = urdf.narrowed(urdf.without_chains(joints_by_name, path), path)
    above |= {joint.child: joint for joint in joints_by_name.values()}
    order = urdf.parents_first(_fault, list(names), above)
    return Description(name, path, dict.fromkeys(order, ()), joints_by_name, above, ()), bodies


def _fault(expected: str, found: str) -> NoReturn:
    raise InputError(f"joints: expected {expected}, found {found}")


def _body(link: Any, shapes: Any) -> Body | None:
    """Make the body of a link from one body, or from several bodies at their poses."""
    _validate.expect_name(link, "expected a name of a link")
    if shapes is None or isinstance(shapes, Body):
        return shapes
    wanted = "a body, None, or a list of pairs [(body, pose), ...]"
    parts = []
    for entry in _validate.listed(shapes, f"link {link!r}", wanted=wanted):
        if not isinstance(entry, (tuple, list)) or len(entry) != 2 or not isinstance(entry[0], Body):
            raise InputError(f"link {link!r}: expected {wanted}, found {_validate.short(entry)}")
        body, T = entry
        parts.append(body if T is None else body.transformed(_validate.pose(T, f"a pose in link {link!r}")))
    return None if not parts else parts[0] if len(parts) == 1 else Body.union(parts)


def checked_joint(joint: Joint, of: str) -> tuple[urdf.Joint, Floats | None]:
    """Check one joint; return it, and the pose of its child in the joint's frame (None for the identity).

    In messages, `of` follows the name of an attribute.
    """
    kind = _validate.choice(joint.kind, f"kind{of}", VALUES)
    origin = _pose(joint.T_parent_joint, f"T_parent_joint{of}")
    behind = _pose(joint.T_joint_child, f"T_joint_child{of}")
    if kind == "fixed":
        origin, behind = product(origin, behind), np.eye(4)
    single = len(VALUES[kind]) == 1
    lower, upper = _limits(joint, kind, of)
    stated = {key: getattr(joint, key) for key in (*RATES, "mimic") if getattr(joint, key) is not None}
    for key, value in () if single else stated.items():
        raise InputError(f"{key}{of}: expected None for a {kind} joint, found {_validate.short(value)}")
    mimic = checked_mimic(stated.pop("mimic"), f"mimic{of}") if "mimic" in stated else None
    rates: dict[str, Any] = {rate: _validate.positive_scalar(most, f"{rate}{of}") for rate, most in stated.items()}
    reference = _validate.real(joint.reference, f"reference{of}")
    if reference and not single:
        raise InputError(f"reference{of}: expected 0 for a {kind} joint, found {reference:g}")
    axis = unit_axis(joint.axis, f"axis{of}")
    ends = (float(lower[0]), float(upper[0])) if single else (-math.inf, math.inf)
    if kind == "revolute" and ends == (-math.inf, math.inf):
        kind = "continuous"
    urdf_joint = urdf.Joint(
        joint.name, kind, joint.parent, joint.child, origin, axis, *ends, mimic=mimic, reference=reference,
        bounds=(lower, upper) if not single and np.isfinite([lower, upper]).any() else None, **rates,
    )  # fmt: skip
    return urdf_joint, None if np.array_equal(behind, np.eye(4)) else behind


def _pose(T: ArrayLike | None, name: str) -> Floats:
    """Check a pose, and refuse numbers so large that products of poses could overflow."""
    pose = _validate.pose(T, name)
    if np.abs(pose).max() > LARGEST:
        raise InputError(f"{name}: expected numbers within ±{LARGEST:g}, found {np.abs(pose).max():g}")
    return pose


def _limits(joint: Joint, kind: str, of: str) -> tuple[Floats, Floats]:
    """Check the limits of a joint; return one number for each value that may have limits."""
    count = 1 if len(VALUES[kind]) == 1 else LIMITED_VALUES.get(kind, 0)
    ends = []
    for name in ("lower", "upper"):
        bounds = _validate.float_array(getattr(joint, name), f"{name}{of}")
        if bounds.ndim and bounds.shape != (count,):
            expected = f"shape {_validate.shape_text((count,))}" if count else "a number"
            raise InputError(f"{name}{of}: expected {expected}, found {_validate.shape_text(bounds.shape)}")
        ends.append(np.broadcast_to(bounds, (max(count, 1),)))
    lower, upper = ends
    if not (lower <= upper).all() or (lower == math.inf).any() or (upper == -math.inf).any():
        raise InputError(f"limits{of}: expected lower ones up to upper ones, found {lower} and {upper}")
    if (kind == "continuous" or not count) and np.isfinite([lower, upper]).any():
        raise InputError(f"limits{of}: expected none for a {kind} joint, found {lower[0]:g} .. {upper[0]:g}")
    return lower, upper


def unit_axis(axis: ArrayLike, name: str) -> Floats:
    """Check a direction of any length, and return it with length 1."""
    direction = _validate.finite_array(axis, name, (3,))
    longest = float(np.abs(direction).max())
    if longest < SHORTEST_AXIS:
        raise InputError(f"{name}: expected a direction, found {direction.tolist()}")
    direction = direction / longest  # so that squares do not overflow
    return np.asarray(direction / lengths(direction))


def checked_mimic(mimic: Any, what: str) -> Mimic:
    """Check the rule of a joint that follows another joint: the other joint's name, a multiplier and an offset."""
    if not isinstance(mimic, (tuple, list)) or len(mimic) != 3 or not isinstance(mimic[0], str):
        raise InputError(
            f"{what}: expected the name of a joint, a multiplier and an offset, found {_validate.short(mimic)}"
        )
    multiplier, offset = (_validate.real(number, what) for number in mimic[1:])
    if max(abs(multiplier), abs(offset)) > LARGEST:
        raise InputError(f"{what}: expected numbers within ±{LARGEST:g}, found {multiplier:g} and {offset:g}")
    return Mimic(mimic[0], multiplier, offset)
