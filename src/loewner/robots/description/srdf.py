"""Read SRDF files for a robot: groups, states and disabled pairs."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

from loewner._base._plausible import warn
from loewner._base._validate import LISTED, Pair
from loewner.errors import UnknownNameError
from loewner.robots.description.urdf import MOST_PAIRS, VALUES, Description
from loewner.robots.description.xml_elements import UNREAD, Element, by_name, cut, known, read_xml, settle, some

# pinocchio's name for the free base that it adds to a robot; SRDF files for pinocchio use this name without declaring
# such a joint.
UNDECLARED_BASE = "root_joint"

# Parts of SRDF files that do not affect groups, states or pairs, keyed by the element that contains them.
HARMLESS = {
    "robot": frozenset((
        "@version",
        "contact", "gripper", "handle", "position", "rotor_params", "specificities",  # additions of other programs
        "end_effector",  # names the group that is a hand, for interactive markers
        "link_sphere_approximation",  # the shapes of the URDF are used
    )),
    "disable_collisions": frozenset(("@reason",)),
    "enable_collisions": frozenset(("@reason",)),
    "virtual_joint": frozenset(("@parent_frame", "@type")),  # the base has no values: see `Robot.placed`, `add_base`
}  # fmt: skip

# Maximum total number of joints in all groups, which is far more than any robot has.
MOST_MEMBERS = 2**22

# If the robot has less than the share LEAST_IN_COMMON of the names in an SRDF, the SRDF is for another robot.
LEAST_IN_COMMON = 0.25

# The group of a state, and its values by joint. The group is "" for a state of the whole robot.
State = tuple[str, dict[str, float | tuple[float, ...]]]


@dataclass(frozen=True, eq=False)
class Semantics:
    """The contents of an SRDF.

    Attributes
    ----------
    groups : dict
        Maps group names to the names of the group's driven joints, in the order of the URDF.
    states : dict
        Maps state names to (group, {driven joint: value or tuple of values}).
    disabled_pairs : frozenset
        Sorted pairs of links that are exempt from checking.
    ruled : bool
        Whether there are rules about pairs. If so, adjacent pairs are checked unless a rule disables them.
    """

    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    states: dict[str, State] = field(default_factory=dict)
    disabled_pairs: frozenset[Pair] = frozenset()
    ruled: bool = False


class _Names:
    """Look names up in the URDF and count the hits, since few hits mean that the SRDF is for a different robot."""

    def __init__(self, robot: Description, without_values: Collection[str]) -> None:
        self.robot = robot
        self.without_values = without_values
        self.known: set[tuple[str, str]] = set()
        self.unknown: dict[tuple[str, str], Element] = {}

    def link(self, element: Element, attribute: str) -> str | None:
        return self._of("link", element, attribute, self.robot.shapes)

    def joint(self, element: Element) -> str | None:
        if element.text("name") in self.without_values:
            return None
        return self._of("joint", element, "name", self.robot.joints)

    def group(self, element: Element, attribute: str, groups: Collection[str]) -> str | None:
        """Return the name of a group if this file has such a group."""
        return self._of("group", element, attribute, groups)

    def _of(self, kind: str, element: Element, attribute: str, valid: Collection[str]) -> str | None:
        name = element.text(attribute)
        if name in valid:
            if kind != "group":
                self.known.add((kind, name))
            return name
        self.unknown.setdefault((kind, name), element)
        return None

    def settle(self, path: Path) -> None:
        """Refuse a different robot's SRDF; warn about ignored names, which a larger variant of this robot may have."""
        if not self.unknown:
            return
        foreign = [key for key in self.unknown if key[0] != "group"]
        could = min(len(self.known) + len(foreign), len(self.robot.shapes) + len(self.robot.joints))
        listing = some((f"{kind} {name!r} (line {e.line})" for (kind, name), e in self.unknown.items()), UNREAD)
        if len(self.known) < LEAST_IN_COMMON * could:
            raise UnknownNameError(
                f"{path}: expected an SRDF for {self.robot.name!r} ({self.robot.path}), found one for another robot, "
                f"with {listing}; links: {known(self.robot.shapes)}; joints: {known(self.robot.joints)}"
            )
        warn(f"{path}: entries are left out; neither this file nor {self.robot.path} has what they name: {listing}")


def read_srdf(path: str | os.PathLike[str], robot: Description, text: str | None = None) -> Semantics:
    """Read an SRDF file for a robot, or a string as if it were the contents of such a file.

    This function reads groups, group states and the rules about pairs: ``disable_collisions``, ``enable_collisions``
    and ``disable_default_collisions``. Virtual joints have no values here (`Robot.placed` places the base), and
    elements that other programs add (grippers, rotors, ...) are ignored.

    Raises
    ------
    FileError, InputError
        As for `read_urdf`.
    UnknownNameError
        If hardly any of the links and joints that the SRDF names belong to this robot.

    Warns
    -----
    UserWarning
        If some of the links and joints in the SRDF do not belong to this robot (an SRDF is often shared with a larger
        variant). If the SRDF does not name any link or joint of this robot, or refers to a group that it does not
        contain. If the SRDF is for a robot with a different name, or has parts that the format does not define. If
        joints are passive, the base moves, a state places the base, or a state has a value for a joint outside the
        state's group.
    """
    root = read_xml(path, "an SRDF", text)
    urdf = next((c for c in root.children if c.tag in ("link", "joint")), None)
    if urdf is not None:
        urdf.fault("an SRDF, with groups, states and rules on pairs", f"a URDF, with a <{urdf.tag}>")
    virtual = {UNDECLARED_BASE, *(e.text("name") for e in root.all("virtual_joint"))}
    names = _Names(robot, virtual - robot.joints.keys())
    disabled = _disabled_pairs(root, names)
    groups = _groups(root, names)
    states, doubts = _states(root, names, groups)
    lines = {names.joint(element): element.line for element in root.all("passive_joint")}
    passive = [joint for joint in lines if joint in set(robot.driven)]
    left_out = "passive joints are left out of groups, but plans that name no joints move them"
    names.settle(root.path)
    for fault in (*_oddities(root, names), *_of_bases(root, robot)):
        warn(f"{root.path}: {fault}")
    for doubt, places in ({left_out: [f"{joint!r} (line {lines[joint]})" for joint in passive]} | doubts).items():
        if places:
            warn(f"{root.path}: {doubt}: {some(places, UNREAD)}")
    settle(root, "SRDF", HARMLESS)
    groups = {name: tuple(joint for joint in joints if joint not in passive) for name, joints in groups.items()}
    ruled = any(root.all(tag) for tag in ("disable_collisions", "enable_collisions", "disable_default_collisions"))
    return Semantics(groups, states, disabled, ruled)


def _oddities(root: Element, names: _Names) -> Iterator[str]:
    """Collect warnings about contents of an SRDF that are allowed but probably mistakes."""
    robot, name = names.robot, root.get("name") or ""
    if name and name != robot.name:
        yield f"expected an SRDF for {robot.name!r}, as {robot.path} calls it, found one for {name!r}"
    if not names.known:
        yield f"expected groups, states or pairs of {robot.name!r}, found none of its links and joints named"


def _of_bases(root: Element, robot: Description) -> Iterator[str]:
    """Collect warnings about moving bases: the robot's base does not move, or moves differently."""
    top = next(iter(robot.shapes))
    for element in root.all("virtual_joint"):
        link = element.get("child_link")
        if link not in (None, top):
            name = element.text("name")
            yield f"line {element.line}: expected {top!r}, the root, below the virtual joint {name!r}, found {link!r}"
    for element in root.all("joint_property"):
        joint, of, value = (element.text(name) for name in ("joint_name", "property_name", "value"))
        if of == "motion_model" and value != "holonomic":
            yield (
                f"line {element.line}: the motion model {cut(value)} of {joint!r} is not used: motions are straight "
                "lines here, sideways as well"
            )


def _disabled_pairs(root: Element, names: _Names) -> frozenset[Pair]:
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


def _groups(root: Element, names: _Names) -> dict[str, tuple[str, ...]]:
    """List the driven joints of each group, in the order of the URDF."""
    elements = by_name(root.all("group"))
    place = {joint: k for k, joint in enumerate(names.robot.driven)}
    depth: dict[str, int] = {}
    for link in names.robot.shapes:
        above = names.robot.joint_above.get(link)
        depth[link] = 0 if above is None else depth[above.parent] + 1
    own: dict[str, frozenset[str]] = {}
    inner: dict[str, list[str]] = {}
    total = 0

    def count(more: int, element: Element) -> None:
        nonlocal total
        total += more
        if total > MOST_MEMBERS:
            element.fault(f"groups of at most {MOST_MEMBERS} joints, all together", "more")

    for name, element in elements.items():
        listed: list[str] = []
        for e in (e for tag in ("joint", "link", "chain") for e in element.all(tag)):
            joints = _named_joints(e, names, depth)
            count(len(joints), e)
            listed += joints
        own[name] = frozenset(listed)
        inside = (names.group(e, "name", elements) for e in element.all("group"))
        inner[name] = [group for group in dict.fromkeys(inside) if group is not None]
    members: dict[str, frozenset[str]] = {}
    for name in _innermost_first(elements, inner):
        members[name] = own.pop(name).union(*(members[group] for group in inner[name])) & place.keys()
        count(len(members[name]), elements[name])
    return {name: tuple(sorted(members[name], key=place.__getitem__)) for name in elements}


def _named_joints(element: Element, names: _Names, depth: dict[str, int]) -> list[str]:
    """List the joints of an entry of a group: one joint, the joint above a link, or the joints between two links."""
    if element.tag == "joint":
        joint = names.joint(element)
        return [] if joint is None else [joint]
    if element.tag == "link":
        above = names.robot.joint_above.get(names.link(element, "name") or "")
        return [] if above is None else [above.name]
    return _chain(names.robot, depth, names.link(element, "base_link"), names.link(element, "tip_link"))


def _innermost_first(elements: dict[str, Element], inner: dict[str, list[str]]) -> list[str]:
    """Order groups so that each follows the groups that it contains."""
    try:
        return list(TopologicalSorter(inner).static_order())
    except CycleError as error:
        ring = error.args[1][::-1]  # from outside inwards
        more = f" ... and {len(ring) - LISTED} more" if len(ring) > LISTED else ""
        elements[ring[0]].fault("groups that do not contain themselves", " in ".join(ring[:LISTED]) + more)


def _chain(robot: Description, depth: dict[str, int], base: str | None, tip: str | None) -> list[str]:
    """List the joints between two links."""
    joints: list[str] = []
    if base is None or tip is None:
        return joints
    while base != tip:
        if depth[base] < depth[tip]:
            base, tip = tip, base
        above = robot.joint_above[base]
        joints.append(above.name)
        base = above.parent
    return joints


def _states(
    root: Element, names: _Names, groups: Mapping[str, tuple[str, ...]]
) -> tuple[dict[str, State], dict[str, list[str]]]:
    """Read the states; also return warnings, each with the values that have no effect or are for other joints."""
    states: dict[str, State] = {}
    driven = set(names.robot.driven)
    first: dict[tuple[str, str], Element] = {}
    bases, outside, followers = [], [], []
    for element in root.all("group_state"):
        # Some programs write a state of the whole robot without naming a group.
        name = element.text("name")
        group = (names.group(element, "group", groups) or "") if "group" in element.attributes else ""
        before = first.setdefault((element.get("group") or "", name), element)
        if before is not element:
            element.fault("each state of a group once", f"{name!r} again, first in line {before.line}")
        values: dict[str, float | tuple[float, ...]] = {}
        for e in by_name(element.all("joint")).values():
            joint, text = names.joint(e), e.get("value")
            if e.text("name") in names.without_values and _is_away(text or ""):
                bases.append(f"{name!r} (line {e.line})")
            if joint not in driven:  # unknown, or without a value of its own: fixed, mimicking, virtual
                continue
            if group and groups[group] and joint not in groups[group]:
                outside.append(f"{joint!r} in {name!r} (line {e.line})")
            kind = names.robot.joints[joint].kind
            numbers = e.finite("value", len(VALUES[kind]))
            if kind == "floating":  # x, y, z, then the quaternion as x, y, z, w
                numbers = [*numbers[:3], numbers[6], *numbers[3:6]]
            values[joint] = numbers[0] if len(numbers) == 1 else tuple(numbers)
        followers += [f"{joint!r} in {name!r} (line {line})" for joint, line in _lost(element, names, values)]
        # The name of a state is unique only within its group.
        key = f"{group}/{name}" if name in states else name
        if key in states:
            element.fault("states whose names differ", f"{key!r} twice: as a name, and as a group and a name")
        states[key] = (group, values)
    return states, {
        "states that place the base leave it where it is (Robot.placed, add_base)": bases,
        "expected values of the joints of a state's group, found others, which are used": outside,
        "values of joints that follow others are not used, and differ from the values that the joints take": followers,
    }


def _lost(element: Element, names: _Names, values: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Yield the joints of a state whose values contradict the joints that they follow, with the values' lines."""
    for e in element.all("joint"):
        joint = names.joint(e)
        follows = None if joint is None else names.robot.joints[joint].mimic
        if joint is not None and follows is not None:
            (value,), leading = e.finite("value", 1), values.get(follows.joint, math.nan)
            if not math.isclose(follows.multiplier * leading + follows.offset, value, rel_tol=1e-6, abs_tol=1e-6):
                yield joint, e.line


def _is_away(text: str) -> bool:
    """Return whether the value of a base, in the order x, y, z, qx, qy, qz, qw, differs from the identity."""
    words = text.split()
    try:
        return any(float(word) != 0 for word in words[:6])
    except ValueError:
        return True
