"""Robot descriptions, read and checked: URDF (links, joints, shapes) and SRDF (groups, states, disabled pairs).

The reader is the standard library's: it knows the line of every element, which the errors here name, and reads nothing
that is not asked for (materials, sensors and transmissions are left alone, broken or not; visual geometry is for the
viewer only, see `read_visuals`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn
from xml.parsers import expat

import numpy as np

from loewner import _validate
from loewner._files import read_regular
from loewner._plausible import FARTHEST_LIMIT, doubt_about_rpy, warn
from loewner._rotations import from_rpy
from loewner._validate import Floats, Pair
from loewner.errors import FileError, GeometryError, InputError, LoewnerError, UnknownNameError

# Names of the values of a joint, by kind; a joint of one value gives it its own name.
VALUES: dict[str, tuple[str, ...]] = {
    "fixed": (),
    "revolute": ("",),
    "continuous": ("",),
    "prismatic": ("",),
    "planar": ("x", "y", "theta"),
    "floating": ("x", "y", "z", "qw", "qx", "qy", "qz"),
}

# Number of sizes of the shapes that are not meshes, and the attributes that hold them.
SIZES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}

# What pinocchio calls the free base that it puts under a robot; its SRDF files name it without declaring it.
UNDECLARED_BASE = "root_joint"

# Elements of SRDF files that are known, to us or to programs that add their own; any other is most likely a slip.
SRDF_TAGS = frozenset((
    "group", "group_state", "disable_collisions", "enable_collisions", "disable_default_collisions", "virtual_joint",
    "end_effector", "passive_joint", "joint_property", "link_sphere_approximation",
    "gripper", "handle", "contact", "position", "rotor_params", "specificities",
))  # fmt: skip

# What a description may have at most: the largest robots known have a hundredth of it. Bytes of a file; elements, and
# how deep they are nested; pairs of links that the rules of an SRDF, or links without shapes, may make; joints in all
# groups together.
MOST_BYTES = 2**25
MOST_ELEMENTS = 250_000
DEEPEST = 100
MOST_PAIRS = 2**22
MOST_MEMBERS = 2**22

# A number in a description that is larger is none: lengths, factors and offsets [m, rad, 1]. What is made of some
# thousands of them is still finite.
LARGEST = 1e12

# Names that a message lists at most.
LISTED = 30

# An SRDF that knows less than this share of the names it could know was written for another robot.
LEAST_IN_COMMON = 0.25


@dataclass(frozen=True, eq=False)
class Shape:
    """One collision or visual element of a link.

    Attributes
    ----------
    kind : str
        "mesh", "box", "sphere", "cylinder" or "capsule" (along z; its length is that of the straight part).
    sizes : tuple of float
        Edge lengths of a box; radius; radius and length. In metres; empty for meshes.
    file_name : str
        As the URDF gives it; empty for the others.
    scale : ndarray, shape (3,)
        Of a mesh, along its own axes; negative entries mirror.
    origin : ndarray, shape (4, 4)
        Pose in the link.
    line : int
        Of the URDF.
    """

    kind: str
    sizes: tuple[float, ...]
    file_name: str
    scale: Floats
    origin: Floats
    line: int


@dataclass(frozen=True, eq=False)
class Mimic:
    """A joint moves by multiplier * (value of another joint) + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint; `kind` is URDF's type, `axis` (unit vector) and `origin` (4, 4) are in the frames of URDF."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Floats
    axis: Floats
    lower: float
    upper: float
    mimic: Mimic | None
    line: int


@dataclass(frozen=True, eq=False)
class Description:
    """What a URDF says, checked to be a tree.

    Attributes
    ----------
    name : str
    path : Path
    shapes : dict
        Link name to its collision shapes, for all links; parents before children, siblings as in the file.
    joints : dict
        Joint name to joint, as in the file. No joint mimics one that mimics another: such chains are resolved.
    joint_above : dict
        Link name to the joint it hangs on, for all links but the root.
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
        """Joints that have values of their own: movable, and not mimicking."""
        return tuple(j.name for j in self.joints.values() if VALUES[j.kind] and j.mimic is None)


@dataclass(frozen=True, eq=False)
class Semantics:
    """What an SRDF adds.

    Attributes
    ----------
    groups : dict
        Group name to the names of its driven joints, in the order of the URDF.
    states : dict
        State name to (group, {driven joint: value or tuple of values}).
    disabled_pairs : frozenset
        Sorted pairs of links that are not to be checked.
    """

    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    states: dict[str, tuple[str, dict[str, float | tuple[float, ...]]]] = field(default_factory=dict)
    disabled_pairs: frozenset[Pair] = frozenset()


# -- XML ----------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Element:
    tag: str
    attributes: dict[str, str]
    line: int
    path: Path
    children: list[_Element] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[_Element]:
        return (c for c in self.children if c.tag == tag)

    def first(self, tag: str) -> _Element | None:
        return next(self.all(tag), None)

    def the(self, tag: str) -> _Element:
        found = self.first(tag)
        if found is None:
            self.fault(f"a <{tag}> in <{self.tag}>", "none")
        return found

    def text(self, attribute: str) -> str:
        found = self.attributes.get(attribute, "").strip()
        if not found:
            self.fault(f"an attribute {attribute!r} of <{self.tag}>", "none")
        return found

    def numbers(self, attribute: str, count: int, default: str | None = None) -> list[float]:
        text = self.attributes.get(attribute, default)
        if text is None:
            self.fault(f"an attribute {attribute!r} of <{self.tag}>", "none")
        try:  # Python would take "1_0" for ten, and digits of all the world's scripts
            values = [float(word) for word in text.split()] if text.isascii() and "_" not in text else []
        except ValueError:
            values = []
        if len(values) != count or any(math.isnan(v) for v in values):
            self.fault(f"{count} number{'s' * (count > 1)} as {attribute!r} of <{self.tag}>", _cut(text))
        return values

    def finite(self, attribute: str, count: int, default: str | None = None) -> list[float]:
        values = self.numbers(attribute, count, default)
        if not all(abs(v) <= LARGEST for v in values):
            found = _cut(self.attributes[attribute])
            self.fault(f"finite numbers as {attribute!r} of <{self.tag}>, none beyond {LARGEST:g}", found)
        return values

    def fault(self, expected: str, found: str, kind: type[Exception] = InputError) -> NoReturn:
        raise kind(f"{self.path}, line {self.line}: expected {expected}, found {found}")


def _read_xml(path: str | os.PathLike[str], what: str) -> _Element:
    """Root element of a robot description."""
    if isinstance(path, str) and path.lstrip().startswith("<"):
        raise InputError(f"expected a path to {what}, found XML text; write it to a file first")
    path = _validate.path(path, "path", wanted=f"a path to {what}")
    data = read_regular(path, what, MOST_BYTES)
    parser = expat.ParserCreate()
    document = _Element("", {}, 1, path)
    open_elements = [document]
    count = 0

    def refuse(found: str) -> NoReturn:
        raise FileError(f"{path}, line {parser.CurrentLineNumber}: expected {what}, found {found}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS or len(open_elements) > DEEPEST:
            most = f"{MOST_ELEMENTS} elements" if count > MOST_ELEMENTS else f"{DEEPEST} elements inside each other"
            refuse(f"more than {most}")
        element = _Element(tag, attributes, parser.CurrentLineNumber, path)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    # Entities can stand for more text than memory holds, or for other files; no description needs one of its own.
    parser.EntityDeclHandler = lambda name, *rest: refuse(f"the declaration of an entity, {_cut(name)}")
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_elements.pop()
    try:
        parser.Parse(data, True)
    except FileError:
        raise
    except (expat.ExpatError, ValueError, LookupError, MemoryError) as error:  # an encoding that nobody knows, or large
        line = getattr(error, "lineno", 1)
        raise FileError(f"{path}, line {line}: expected {what}, found broken XML ({error})") from None
    root = document.children[0]
    if root.tag != "robot":
        root.fault(f"{what} with the root element <robot>", f"<{root.tag}>", FileError)
    macro = next((c for c in root.children if c.tag.startswith("xacro:")), None)
    if macro is not None:
        macro.fault(f"{what}", f"the macro <{macro.tag}>; run xacro on the file first", FileError)
    return root


def _by_name(elements: Iterable[_Element]) -> dict[str, _Element]:
    named: dict[str, _Element] = {}
    for element in elements:
        name = element.text("name")
        if name in named:
            element.fault(f"each name of a {element.tag} once", f"{name!r} again, first in line {named[name].line}")
        named[name] = element
    return named


# -- URDF ---------------------------------------------------------------------------------------


def read_urdf(path: str | os.PathLike[str]) -> Description:
    """Read a URDF file.

    Raises
    ------
    FileError
        If there is no such file, or it is no XML or no URDF.
    InputError
        If `path` is no path, if the links and joints are no tree, or a joint is not well defined.
    GeometryError
        If a shape has no size, or a negative one.
    UnknownNameError
        If a joint names a link that does not exist.

    Warns
    -----
    UserWarning
        If a joint mimics one that does not exist, or the angles of an origin seem to be in degrees.
    """
    root = _read_xml(path, "a URDF")
    links = _by_name(root.all("link"))
    if not links:
        root.fault("at least one <link>", "none")
    joints = {name: _joint(e, links) for name, e in _by_name(root.all("joint")).items()}
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
    return Description(
        name=root.attributes.get("name", root.path.stem),
        path=root.path,
        shapes={name: tuple(_shape(e) for e in links[name].all("collision")) for name in order},
        joints=joints,
        joint_above=joint_above,
        only_visual=tuple(name for name in order if links[name].first("visual") and not links[name].first("collision")),
    )


def read_visuals(path: str | os.PathLike[str]) -> tuple[dict[str, list[Shape]], list[str]]:
    """Read what the links of a URDF look like.

    Returns
    -------
    shapes : dict
        Link name to its visual shapes, for links that have any.
    faults : list of str
        What is wrong with those that are left out: a look decides nothing, so that a broken one is no error.

    Raises
    ------
    FileError, InputError
        If there is no such file, or it is no URDF.
    """
    shapes: dict[str, list[Shape]] = {}
    faults = []
    for name, link in _by_name(_read_xml(path, "a URDF").all("link")).items():
        for element in link.all("visual"):
            try:
                shapes.setdefault(name, []).append(_shape(element))
            except LoewnerError as error:
                faults.append(str(error))
    return shapes, faults


def _parents_first(root: _Element, links: list[str], joint_above: dict[str, Joint]) -> list[str]:
    """Order links depth first from the one root."""
    tops = [name for name in links if name not in joint_above]
    if len(tops) > 1:
        root.fault("a tree with one root", f"{len(tops)} links that hang on no joint: {_some(tops)}")
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
        root.fault("a tree", f"a cycle: {_some(lost)} do not hang on a root")
    return order


def _joint(element: _Element, links: Collection[str]) -> Joint:
    name, kind = element.text("name"), element.text("type")
    if kind not in VALUES:
        element.fault(f"a joint type among {', '.join(VALUES)}", f"{kind!r} of joint {name!r}")
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
        mimic=_mimic(element, kind),
        line=element.line,
    )


def _axis(joint: _Element, kind: str) -> Floats:
    """Axis of a joint, as a unit vector.

    Where a URDF gives none it is x, but z for a planar joint: so do MoveIt and pinocchio.
    """
    element = joint.first("axis")
    if kind in ("fixed", "floating"):
        return np.array([1.0, 0.0, 0.0])
    if element is None:
        return np.array([0.0, 0.0, 1.0] if kind == "planar" else [1.0, 0.0, 0.0])
    axis = np.array(element.finite("xyz", 3))
    largest = np.abs(axis).max()
    if largest == 0:
        element.fault(f"an axis of length above 0 for joint {joint.text('name')!r}", "0 0 0")
    axis /= largest
    return np.asarray(axis / np.linalg.norm(axis))


def _limits(joint: _Element, kind: str) -> tuple[float, float]:
    """Limits of the values [rad or m]."""
    if kind not in ("revolute", "prismatic"):
        return -math.inf, math.inf
    element = joint.first("limit")
    if element is None:
        joint.fault(f"a <limit> of the {kind} joint {joint.text('name')!r}", "none (a joint without is continuous)")
    (lower,), (upper,) = element.numbers("lower", 1, "0"), element.numbers("upper", 1, "0")
    if lower > upper:
        element.fault(f"lower <= upper for joint {joint.text('name')!r}", f"{lower:g} > {upper:g}")
    if lower > FARTHEST_LIMIT or upper < -FARTHEST_LIMIT:
        expected = f"limits that leave joint {joint.text('name')!r} values within ±{FARTHEST_LIMIT:g}"
        element.fault(expected, f"{lower:g} .. {upper:g}")
    return lower, upper


def _mimic(joint: _Element, kind: str) -> Mimic | None:
    element = joint.first("mimic")
    if element is None or kind == "fixed":  # a gripper welded shut in a reduced model may keep its <mimic>
        return None
    if VALUES[kind] != ("",):
        element.fault("a <mimic> in a joint of one value only", f"one in the {kind} joint {joint.text('name')!r}")
    return Mimic(element.text("joint"), element.finite("multiplier", 1, "1")[0], element.finite("offset", 1, "0")[0])


def _with_known_mimics(joints: dict[str, Joint], path: Path) -> dict[str, Joint]:
    """Give joints that mimic one which does not exist a value of their own, as MoveIt and pinocchio do, and say so."""
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
    """Let each joint that mimics another mimic the one at the end of its chain."""
    found = {name: joint for name, joint in joints.items() if joint.mimic is None}
    for start in joints.values():
        chain: dict[str, Joint] = {}  # from the start up to one that is settled, in order
        at = start
        while at.name not in found:
            if at.name in chain:
                raise InputError(
                    f"{path}, line {start.line}: expected {start.name!r} to mimic a joint with a value of its own, "
                    f"found a ring: {_some(chain)}"
                )
            chain[at.name] = at
            at = joints[at.mimic.joint if at.mimic else at.name]
        for joint in reversed(chain.values()):
            found[joint.name] = _mimicking(joint, found[joint.mimic.joint if joint.mimic else joint.name], path)
    return {name: found[name] for name in joints}


def _mimicking(joint: Joint, followed: Joint, path: Path) -> Joint:
    """Let a joint mimic the one that the joint which it follows mimics, if that does."""
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


def _doubt_angles(root: _Element) -> None:
    """Say so if the origins of a URDF seem to be in degrees: once, for all of them are then."""
    for owner in (*root.all("joint"), *(e for link in root.all("link") for e in link.all("collision"))):
        origin = owner.first("origin")
        doubt = "" if origin is None else doubt_about_rpy(origin.finite("rpy", 3, "0 0 0"))
        if origin is not None and doubt:
            warn(f"{root.path}, line {origin.line}: expected {doubt}")
            return


def _origin(element: _Element) -> Floats:
    """Pose of an <origin>: fixed-axis roll, pitch, yaw [rad], then translation [m]."""
    T = np.eye(4)
    origin = element.first("origin")
    if origin is None:
        return T
    T[:3, 3] = origin.finite("xyz", 3, "0 0 0")
    T[:3, :3] = from_rpy(*origin.finite("rpy", 3, "0 0 0"))
    return T


def _shape(owner: _Element) -> Shape:
    """Shape of a <collision> or <visual>."""
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


# -- SRDF ---------------------------------------------------------------------------------------


class _Names:
    """Looks names up in the URDF, and keeps count: an SRDF of another robot finds few."""

    def __init__(self, robot: Description, without_values: Collection[str]) -> None:
        self.robot = robot
        self.without_values = without_values
        self.known: set[tuple[str, str]] = set()
        self.unknown: dict[tuple[str, str], _Element] = {}

    def link(self, element: _Element, attribute: str) -> str | None:
        return self._of("link", element, attribute, self.robot.shapes)

    def joint(self, element: _Element) -> str | None:
        if element.text("name") in self.without_values:
            return None
        return self._of("joint", element, "name", self.robot.joints)

    def group(self, element: _Element, attribute: str, groups: Collection[str]) -> str | None:
        """Name of a group, if there is such a one in this file."""
        name = element.text(attribute)
        if name in groups:
            return name
        self.unknown.setdefault(("group", name), element)
        return None

    def _of(self, kind: str, element: _Element, attribute: str, valid: Collection[str]) -> str | None:
        name = element.text(attribute)
        if name in valid:
            self.known.add((kind, name))
            return name
        self.unknown.setdefault((kind, name), element)
        return None

    def settle(self, path: Path) -> None:
        """Refuse the SRDF of another robot; say which names of a bigger variant of this one are left out."""
        if not self.unknown:
            return
        foreign = [key for key in self.unknown if key[0] != "group"]
        could = min(len(self.known) + len(foreign), len(self.robot.shapes) + len(self.robot.joints))
        found = ", ".join(f"{kind} {name!r} (line {e.line})" for (kind, name), e in list(self.unknown.items())[:8])
        if len(self.unknown) > 8:
            found += f" and {len(self.unknown) - 8} more"
        if len(self.known) < LEAST_IN_COMMON * could:
            raise UnknownNameError(
                f"{path}: expected an SRDF for {self.robot.name!r} ({self.robot.path}), found one for another robot, "
                f"with {found}; links: {known(self.robot.shapes)}; joints: {known(self.robot.joints)}"
            )
        warn(f"{path}: left out what names things that neither it nor {self.robot.path} has: {found}")


def read_srdf(path: str | os.PathLike[str], robot: Description) -> Semantics:
    """Read an SRDF file for a robot.

    Read are groups, group states and the rules on pairs: ``disable_collisions``, ``enable_collisions`` and
    ``disable_default_collisions``. Virtual joints have no values here (`Robot.placed` puts the base somewhere), and
    what programs add of their own (grippers, rotors, ...) is left alone.

    Raises
    ------
    FileError, InputError
        As `read_urdf`.
    UnknownNameError
        If next to none of the links and joints that it names are this robot's.

    Warns
    -----
    UserWarning
        If some are not (an SRDF is often shared with a bigger variant of the robot), or a group is named that is
        nowhere in the file; if it names nothing of this robot at all, if it is said to be for a robot of another name,
        or if it has elements that no SRDF has.
    """
    root = _read_xml(path, "an SRDF")
    urdf = next((c for c in root.children if c.tag in ("link", "joint")), None)
    if urdf is not None:
        urdf.fault("an SRDF, with groups, states and rules on pairs", f"a URDF, with a <{urdf.tag}>")
    names = _Names(robot, {UNDECLARED_BASE, *(e.text("name") for e in root.all("virtual_joint"))})
    disabled = _disabled_pairs(root, names)
    groups = _groups(root, names)
    states = _states(root, names, groups)
    names.settle(root.path)
    for fault in _oddities(root, names):
        warn(f"{root.path}: {fault}")
    return Semantics(groups, states, disabled)


def _oddities(root: _Element, names: _Names) -> Iterator[str]:
    """What is no error in an SRDF, but mostly a slip."""
    robot, name = names.robot, root.attributes.get("name", "")
    if name and name != robot.name:
        yield f"expected an SRDF for {robot.name!r}, as {robot.path} calls it, found one for {name!r}"
    odd = [e for e in root.children if e.tag not in SRDF_TAGS]
    if odd:
        found = _some(f"<{e.tag}>" for e in odd)
        yield f"left out elements that an SRDF does not have: {found}, first in line {odd[0].line}"
    if not names.known:
        yield f"expected groups, states or pairs of {robot.name!r}, found none of its links and joints named"


def _disabled_pairs(root: _Element, names: _Names) -> frozenset[Pair]:
    disabled: set[Pair] = set()
    alone = list(dict.fromkeys(names.link(e, "link") for e in root.all("disable_default_collisions")))
    if len(alone) * len(names.robot.shapes) > MOST_PAIRS:
        root.fault(
            f"<disable_default_collisions> of at most {MOST_PAIRS} pairs",
            f"{len(alone)} links with {len(names.robot.shapes)} others each",
        )
    for link in alone:
        if link is not None:
            disabled |= {_sorted_pair(link, other) for other in names.robot.shapes if other != link}
    for tag, change in (("enable_collisions", disabled.discard), ("disable_collisions", disabled.add)):
        for element in root.all(tag):
            a, b = names.link(element, "link1"), names.link(element, "link2")
            if a is not None and b is not None and a != b:
                change(_sorted_pair(a, b))
    return frozenset(disabled)


def _sorted_pair(a: str, b: str) -> Pair:
    return (a, b) if a < b else (b, a)


def _groups(root: _Element, names: _Names) -> dict[str, tuple[str, ...]]:
    """Driven joints of each group, in the order of the URDF."""
    elements = _by_name(root.all("group"))
    place = {joint: k for k, joint in enumerate(names.robot.driven)}
    depth: dict[str, int] = {}
    for link in names.robot.shapes:
        above = names.robot.joint_above.get(link)
        depth[link] = 0 if above is None else depth[above.parent] + 1
    own: dict[str, frozenset[str]] = {}
    inner: dict[str, list[str]] = {}
    total = 0

    def count(more: int, element: _Element) -> None:
        nonlocal total
        total += more
        if total > MOST_MEMBERS:
            element.fault(f"groups of at most {MOST_MEMBERS} joints, all together", "more")

    for name, element in elements.items():
        listed: list[str] = []
        for e in element.children:
            found = _named_joints(e, names, depth)
            count(len(found), e)
            listed += found
        own[name] = frozenset(listed)
        inside = (names.group(e, "name", elements) for e in element.all("group"))
        inner[name] = [group for group in dict.fromkeys(inside) if group is not None]
    members: dict[str, frozenset[str]] = {}
    for name in _innermost_first(elements, inner):
        members[name] = own.pop(name).union(*(members[group] for group in inner[name])) & place.keys()
        count(len(members[name]), elements[name])
    return {name: tuple(sorted(members[name], key=place.__getitem__)) for name in elements}


def _named_joints(element: _Element, names: _Names, depth: dict[str, int]) -> list[str]:
    """Joints that an entry of a group means: one, the one above a link, or those between links."""
    if element.tag == "joint":
        joint = names.joint(element)
        return [] if joint is None else [joint]
    if element.tag == "link":
        above = names.robot.joint_above.get(names.link(element, "name") or "")
        return [] if above is None else [above.name]
    if element.tag == "chain":
        return _chain(names.robot, depth, names.link(element, "base_link"), names.link(element, "tip_link"))
    return []


def _innermost_first(elements: dict[str, _Element], inner: dict[str, list[str]]) -> list[str]:
    """Order groups such that each comes after those inside it."""
    order: list[str] = []
    done: set[str] = set()
    for start in elements:
        within: dict[str, Iterator[str]] = {} if start in done else {start: iter(inner[start])}  # from outside inwards
        while within:
            name = next(reversed(within))
            group = next(within[name], None)
            if group is None:
                del within[name]
                done.add(name)
                order.append(name)
            elif group in within:
                names = list(within)
                ring = [*names[names.index(group) :], group]
                more = f" ... and {len(ring) - LISTED} more" if len(ring) > LISTED else ""
                elements[group].fault("groups that do not contain themselves", " in ".join(ring[:LISTED]) + more)
            elif group not in done:
                within[group] = iter(inner[group])
    return order


def _chain(robot: Description, depth: dict[str, int], base: str | None, tip: str | None) -> list[str]:
    """Joints between two links."""
    found: list[str] = []
    if base is None or tip is None:
        return found
    while base != tip:
        if depth[base] < depth[tip]:
            base, tip = tip, base
        above = robot.joint_above[base]
        found.append(above.name)
        base = above.parent
    return found


def _states(
    root: _Element, names: _Names, groups: dict[str, Any]
) -> dict[str, tuple[str, dict[str, float | tuple[float, ...]]]]:
    states: dict[str, tuple[str, dict[str, float | tuple[float, ...]]]] = {}
    driven = set(names.robot.driven)
    for element in root.all("group_state"):
        # A state outside all groups is a state of the whole robot to some programs.
        name = element.text("name")
        group = (names.group(element, "group", groups) or "") if "group" in element.attributes else ""
        values: dict[str, float | tuple[float, ...]] = {}
        for e in element.all("joint"):
            joint = names.joint(e)
            if joint not in driven:  # unknown, or without a value of its own: fixed, mimicking, virtual
                continue
            kind = names.robot.joints[joint].kind
            numbers = e.finite("value", len(VALUES[kind]))
            if kind == "floating":  # x, y, z, then the quaternion as x, y, z, w
                numbers = [*numbers[:3], numbers[6], *numbers[3:6]]
            values[joint] = numbers[0] if len(numbers) == 1 else tuple(numbers)
        # The name of a state is its own within its group only.
        states[f"{group}/{name}" if name in states else name] = (group, values)
    return states


def known(names: Iterable[str]) -> str:
    """Names for people."""
    listed = _some(sorted(names))
    return f"known are {listed}" if listed else "there are none"


def _some(names: Iterable[str]) -> str:
    """Names for people, each once, as many as one would read."""
    once = list(dict.fromkeys(names))
    more = f", and {len(once) - LISTED} more" if len(once) > LISTED else ""
    return ", ".join(once[:LISTED]) + more


def _cut(text: str) -> str:
    """A text of a file for a message."""
    return repr(text) if len(text) <= 80 else f"{text[:80]!r} and more"
