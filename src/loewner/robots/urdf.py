"""Read URDF files: links, joints and shapes, checked to form a tree.

Only the viewer uses visual geometry; see `read_visuals`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loewner._matrices import lengths
from loewner._plausible import FARTHEST_LIMIT, doubt_about_limits, doubt_about_rpy, warn
from loewner._rotations import from_rpy
from loewner._validate import Floats
from loewner.errors import GeometryError, InputError, LoewnerError, UnknownNameError
from loewner.robots.xml_elements import LARGEST, LISTED, Element, by_name, known, read_xml, some

# Names of the values of a joint, by kind; a single value has the name of its joint. No URDF has a ball joint.
VALUES: dict[str, tuple[str, ...]] = {
    "fixed": (),
    "revolute": ("",),
    "continuous": ("",),
    "prismatic": ("",),
    "planar": ("x", "y", "theta"),
    "floating": ("x", "y", "z", "qw", "qx", "qy", "qz"),
    "ball": ("qw", "qx", "qy", "qz"),
}
URDF_KINDS = tuple(kind for kind in VALUES if kind != "ball")

# Number of sizes of the shapes that are not meshes, and the attributes that hold them.
SIZES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}

# An axis should be a unit vector. The direction of a far shorter one is due to rounding or damage, and squares of
# lengths below 1e-154 vanish, so readers do not agree on it.
SHORTEST_AXIS = 1e-9

# Limit on the number of pairs of links from rules of an SRDF or links without shapes: far more than any robot has.
MOST_PAIRS = 2**22


@dataclass(frozen=True, eq=False)
class Shape:
    """One collision or visual element of a link.

    Attributes
    ----------
    kind : str
        "mesh", "box", "sphere", "cylinder" or "capsule" (along z; its length is the length of the straight part).
    sizes : tuple of float
        In metres: the edge lengths of a box, the radius of a sphere, or the radius and length of a cylinder or capsule;
        empty for meshes.
    file_name : str
        The mesh file, as given in the URDF; empty for other kinds.
    scale : ndarray, shape (3,)
        Scale of a mesh along its own axes; negative entries mirror it.
    origin : ndarray, shape (4, 4)
        Pose in the link.
    line : int
        Line in the URDF.
    """

    kind: str
    sizes: tuple[float, ...]
    file_name: str
    scale: Floats
    origin: Floats
    line: int


@dataclass(frozen=True, eq=False)
class Mimic:
    """The rule of a joint that follows another: its value is multiplier * (value of the other joint) + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint: `kind` is URDF's type, and the unit vector `axis` and the pose `origin` are in URDF's frames.

    `velocity` is the largest rate of the joint's value [rad/s or m/s], or NaN if the URDF gives no positive one. The
    child is at `origin` when the value is `reference`.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Floats
    axis: Floats
    lower: float
    upper: float
    velocity: float
    mimic: Mimic | None
    line: int
    reference: float = 0.0


@dataclass(frozen=True, eq=False)
class Description:
    """The contents of a URDF, checked to be a tree.

    Attributes
    ----------
    name : str
    path : Path
    shapes : dict
        Maps every link name to the link's collision shapes; parents come before children, siblings are in the file's
        order.
    joints : dict
        Maps joint names to joints, in the file's order. No joint mimics another mimic joint: such chains are resolved.
    joint_above : dict
        Maps each link name except the root's to the joint above the link.
    only_visual : tuple of str
        Links with visual geometry and no collision shapes.
    """

    name: str
    path: Path
    shapes: dict[str, tuple[Shape, ...]]
    joints: dict[str, Joint]
    joint_above: dict[str, Joint]
    only_visual: tuple[str, ...]

    @property
    def driven(self) -> tuple[str, ...]:
        """Joints with values of their own: movable joints that do not mimic another."""
        return tuple(j.name for j in self.joints.values() if VALUES[j.kind] and j.mimic is None)


def read_urdf(path: str | os.PathLike[str], text: str | None = None) -> Description:
    """Read a URDF file, or a string as if it were the contents of that file.

    Raises
    ------
    FileError
        If the file does not exist, or is not XML or not a URDF.
    InputError
        If `path` is not a path, if the links and joints do not form a tree, or a joint is not well defined.
    GeometryError
        If a shape has no size, or a negative one.
    UnknownNameError
        If a joint names a link that does not exist.

    Warns
    -----
    UserWarning
        If a joint mimics a joint that does not exist, or the angles of an origin are probably in degrees.
    """
    root = read_xml(path, "a URDF", text)
    links = by_name(root.all("link"))
    if not links:
        root.fault("at least one <link>", "none")
    joints = {name: _joint(e, links) for name, e in by_name(root.all("joint")).items()}
    joints = _without_chains(_with_known_mimics(joints, root.path), root.path)
    joint_above: dict[str, Joint] = {}
    for joint in joints.values():
        before = joint_above.setdefault(joint.child, joint)
        if before is not joint:
            raise InputError(
                f"{root.path}, line {joint.line}: expected a tree, found link {joint.child!r} below two joints, "
                f"{before.name!r} and {joint.name!r}"
            )
    order = _parents_first(root, list(links), joint_above)
    _doubt_angles(root)
    _doubt_limits(root.path, joints)
    return Description(
        name=root.attributes.get("name", root.path.stem),
        path=root.path,
        shapes={name: tuple(_shape(e) for e in links[name].all("collision")) for name in order},
        joints=joints,
        joint_above=joint_above,
        only_visual=tuple(name for name in order if links[name].first("visual") and not links[name].first("collision")),
    )


def read_visuals(path: Path, text: str | None) -> tuple[dict[str, list[Shape]], list[str]]:
    """Read the visual geometry of a URDF's links, from a file or from its text.

    Returns
    -------
    shapes : dict
        Maps link names to visual shapes, for links that have any.
    faults : list of str
        Faults of the shapes that were omitted: visual geometry affects no query, so a broken shape is not an error.

    Raises
    ------
    FileError, InputError
        If the file does not exist, or is not a URDF.
    """
    shapes: dict[str, list[Shape]] = {}
    faults = []
    for name, link in by_name(read_xml(path, "a URDF", text).all("link")).items():
        for element in link.all("visual"):
            try:
                shapes.setdefault(name, []).append(_shape(element))
            except LoewnerError as error:
                faults.append(str(error))
    return shapes, faults


def _parents_first(root: Element, links: list[str], joint_above: dict[str, Joint]) -> list[str]:
    """Order links depth first from the root, which must be unique."""
    tops = [name for name in links if name not in joint_above]
    if len(tops) > 1:
        root.fault("a tree with one root", f"{len(tops)} links that hang on no joint: {some(tops)}")
    below: dict[str, list[str]] = {name: [] for name in links}
    for name in links:
        if name in joint_above:
            below[joint_above[name].parent].append(name)
    order, waiting = [], tops
    while waiting:
        name = waiting.pop()
        order.append(name)
        waiting.extend(reversed(below[name]))
    if len(order) < len(links):
        reached = set(order)
        lost = [name for name in links if name not in reached]
        root.fault("a tree", f"a cycle: {some(lost)} do not hang on a root")
    return order


def _joint(element: Element, links: Collection[str]) -> Joint:
    name, kind = element.text("name"), element.text("type")
    if kind not in URDF_KINDS:
        element.fault(f"a joint type among {', '.join(URDF_KINDS)}", f"{kind!r} of joint {name!r}")
    ends = []
    for end in ("parent", "child"):
        link = element.the(end).text("link")
        if link not in links:
            element.fault(
                f"a link of this robot as {end} of joint {name!r}", f"{link!r}; {known(links)}", UnknownNameError
            )
        ends.append(link)
    lower, upper = _limits(element, kind)
    return Joint(
        name=name,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        origin=_origin(element),
        axis=_axis(element, kind),
        lower=lower,
        upper=upper,
        velocity=_velocity(element, kind),
        mimic=_mimic(element, kind),
        line=element.line,
    )


def _axis(joint: Element, kind: str) -> Floats:
    """Read the axis of a joint, as a unit vector.

    The default is x, but z for a planar joint, as in MoveIt and pinocchio.
    """
    element = joint.first("axis")
    if kind in ("fixed", "floating"):
        return np.array([1.0, 0.0, 0.0])
    if element is None:
        return np.array([0.0, 0.0, 1.0] if kind == "planar" else [1.0, 0.0, 0.0])
    axis = np.array(element.finite("xyz", 3))
    length = float(lengths(axis))
    if length < SHORTEST_AXIS:
        expected = f"an axis of length 1, and no less than {SHORTEST_AXIS:g}, for joint {joint.text('name')!r}"
        element.fault(expected, f"{' '.join(f'{x:g}' for x in axis)}, whose direction rounding may have made")
    return np.asarray(axis / length)


def _limits(joint: Element, kind: str) -> tuple[float, float]:
    """Read the limits of a joint's values [rad or m]."""
    element = joint.first("limit")
    if kind not in ("revolute", "prismatic"):
        dropped = {"lower", "upper", "velocity"} & (set() if element is None else element.attributes.keys())
        if kind in ("planar", "floating") and element is not None and dropped:
            warn(
                f"{joint.path}, line {element.line}: a <limit> of the {kind} joint {joint.text('name')!r} is ignored, "
                "since URDF does not define to which of its values it applies; Robot.add_base adds a base with bounds"
            )
        return -math.inf, math.inf
    if element is None:
        joint.fault(f"a <limit> of the {kind} joint {joint.text('name')!r}", "none (a joint without is continuous)")
    (lower,), (upper,) = element.numbers("lower", 1, "0"), element.numbers("upper", 1, "0")
    if lower > upper:
        element.fault(f"lower <= upper for joint {joint.text('name')!r}", f"{lower:g} > {upper:g}")
    if lower > FARTHEST_LIMIT or upper < -FARTHEST_LIMIT:
        expected = f"limits that leave joint {joint.text('name')!r} values within ±{FARTHEST_LIMIT:g}"
        element.fault(expected, f"{lower:g} .. {upper:g}")
    return lower, upper


def _velocity(joint: Element, kind: str) -> float:
    """Read the velocity limit of a joint with one value; many files write 0 for "no limit"."""
    element = joint.first("limit")
    if element is None or VALUES[kind] != ("",):
        return math.nan
    (velocity,) = element.numbers("velocity", 1, "0")
    return velocity if 0 < velocity < math.inf else math.nan


def _mimic(joint: Element, kind: str) -> Mimic | None:
    element = joint.first("mimic")
    if element is None or kind == "fixed":  # a gripper that is fixed in a reduced model may keep its <mimic>
        return None
    if VALUES[kind] != ("",):
        element.fault("a <mimic> in a joint of one value only", f"one in the {kind} joint {joint.text('name')!r}")
    return Mimic(element.text("joint"), element.finite("multiplier", 1, "1")[0], element.finite("offset", 1, "0")[0])


def _with_known_mimics(joints: dict[str, Joint], path: Path) -> dict[str, Joint]:
    """Give each joint that mimics a missing joint a value of its own, with a warning, as MoveIt and pinocchio do."""
    lost = {j.name: j for j in joints.values() if j.mimic is not None and j.mimic.joint not in joints}
    for count, joint in enumerate(lost.values()):
        if count == LISTED:
            warn(f"{path}: {len(lost) - LISTED} more joints mimic one that does not exist")
            break
        warn(
            f"{path}, line {joint.line}: expected a joint of this robot for {joint.name!r} to mimic, found "
            f"{joint.mimic.joint if joint.mimic else None!r}; it gets a value of its own. {known(joints)}"
        )
    return {name: replace(joint, mimic=None) if name in lost else joint for name, joint in joints.items()}


def _without_chains(joints: dict[str, Joint], path: Path) -> dict[str, Joint]:
    """Let each mimicking joint follow the joint at the end of its chain."""
    found = {name: joint for name, joint in joints.items() if joint.mimic is None}
    for start in joints.values():
        chain: dict[str, Joint] = {}  # from the start up to a settled joint, in order
        at = start
        while at.name not in found:
            if at.name in chain:
                raise InputError(
                    f"{path}, line {start.line}: expected {start.name!r} to mimic a joint with a value of its own, "
                    f"found a ring: {some(chain)}"
                )
            chain[at.name] = at
            at = joints[at.mimic.joint if at.mimic else at.name]
        for joint in reversed(chain.values()):
            found[joint.name] = _mimicking(joint, found[joint.mimic.joint if joint.mimic else joint.name], path)
    return {name: found[name] for name in joints}


def _mimicking(joint: Joint, followed: Joint, path: Path) -> Joint:
    """If the followed joint itself mimics a third joint, let this joint follow the third."""
    own = joint.mimic
    assert own is not None
    if VALUES[followed.kind] != ("",):
        raise InputError(
            f"{path}, line {joint.line}: expected a joint of one value for {joint.name!r} to mimic, "
            f"found {followed.name!r}, which is {followed.kind}"
        )
    if followed.mimic is None:
        return joint
    end = followed.mimic
    mimic = Mimic(end.joint, own.multiplier * end.multiplier, own.multiplier * end.offset + own.offset)
    if not (abs(mimic.multiplier) <= LARGEST and abs(mimic.offset) <= LARGEST):
        raise InputError(
            f"{path}, line {joint.line}: expected {joint.name!r}, which mimics {followed.name!r}, which mimics "
            f"{end.joint!r}, to move by a finite multiple of it, found the multiplier {mimic.multiplier:g} and the "
            f"offset {mimic.offset:g} (the largest allowed is {LARGEST:g})"
        )
    return replace(joint, mimic=mimic)


def _doubt_angles(root: Element) -> None:
    """Warn, once for all origins, if their angles seem to be in degrees."""
    for owner in (*root.all("joint"), *(e for link in root.all("link") for e in link.all("collision"))):
        origin = owner.first("origin")
        doubt = "" if origin is None else doubt_about_rpy(origin.finite("rpy", 3, "0 0 0"))
        if origin is not None and doubt:
            warn(f"{root.path}, line {origin.line}: expected {doubt}")
            return


def _doubt_limits(path: Path, joints: dict[str, Joint]) -> None:
    """Warn, once for all revolute joints, if their limits seem to be in degrees."""
    doubts = {j: doubt_about_limits(j.lower, j.upper) for j in joints.values() if j.kind == "revolute"}
    doubtful = [joint for joint, doubt in doubts.items() if doubt]
    if doubtful:
        joint, more = doubtful[0], f" ({len(doubtful) - 1} more like it)" if len(doubtful) > 1 else ""
        warn(f"{path}, line {joint.line}: joint {joint.name!r}: expected {doubts[joint]}{more}")


def _origin(element: Element) -> Floats:
    """Read the pose of an <origin>: fixed-axis roll, pitch, yaw [rad], then translation [m]."""
    T = np.eye(4)
    origin = element.first("origin")
    if origin is None:
        return T
    unknown = next((name for name in origin.attributes if name not in ("xyz", "rpy")), None)
    if unknown is not None:
        origin.fault("only xyz and rpy as attributes of <origin>", f"{unknown!r}; write a rotation as rpy")
    T[:3, 3] = origin.finite("xyz", 3, "0 0 0")
    T[:3, :3] = from_rpy(*origin.finite("rpy", 3, "0 0 0"))
    return T


def _shape(owner: Element) -> Shape:
    """Read the shape of a <collision> or <visual> element."""
    geometry = owner.the("geometry")
    known = [c for c in geometry.children if c.tag == "mesh" or c.tag in SIZES]
    if len(known) != 1 or len(geometry.children) != 1:
        found = ", ".join(f"<{c.tag}>" for c in geometry.children) or "none"
        geometry.fault(f"one shape among mesh, {', '.join(SIZES)} in <geometry>", found)
    element = known[0]
    origin = _origin(owner)
    if element.tag == "mesh":
        text = element.attributes.get("scale", "1 1 1")
        count = 1 if len(text.split()) == 1 else 3
        scale = np.broadcast_to(element.finite("scale", count, text), 3)
        if not scale.all():
            element.fault("a scale without a 0", repr(text), GeometryError)
        return Shape("mesh", (), element.text("filename"), scale, origin, element.line)
    sizes = [size for attribute, count in SIZES[element.tag] for size in element.finite(attribute, count)]
    if min(sizes) <= 0:
        element.fault(f"sizes above 0 for a {element.tag}", " ".join(f"{s:g}" for s in sizes), GeometryError)
    return Shape(element.tag, tuple(sizes), "", np.ones(3), origin, element.line)
