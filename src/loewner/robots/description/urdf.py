"""Read URDF files: links, joints and shapes, checked to form a tree.

Only the viewer uses visual geometry; see `read_visuals`.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np

from loewner._base._matrices import lengths
from loewner._base._memory import uncollected
from loewner._base._plausible import FARTHEST_LIMIT, doubt_about_limits, doubt_about_rpy, warn
from loewner._base._rotations import QUATERNION_TOLERANCE, from_quaternion, from_rpy
from loewner._base._validate import LISTED, Floats
from loewner.errors import GeometryError, InputError, LoewnerError, UnknownNameError
from loewner.robots.description import xml_elements
from loewner.robots.description.xml_elements import UNREAD, Element, by_name, cut, known, read_xml, settle, some

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

# Largest rates of joints with one value.
RATES = ("velocity", "acceleration", "jerk")

# For each shape that is not a mesh, the attributes with its sizes, and the number of sizes in each attribute.
SIZES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}

# An axis should be a unit vector. The direction of a far shorter vector is due to rounding or damage. Squares of
# lengths below 1e-154 vanish, so readers do not agree on the direction of such a vector.
SHORTEST_AXIS = 1e-9

# Parts of URDF files that affect neither shapes nor motions nor checks, keyed by the element that contains them. A part
# whose tag ends in "*" causes a warning if it contains links, joints or collision shapes, as an SDF model does.
HARMLESS = {
    "robot": frozenset((
        "gazebo*",  # plugins, friction and sensors of a simulator
        "material*",  # colours
        "ros2_control",  # hardware; `_warn_of_extensions` reports its limits and mimics
        "self_collision_checking", "drake:collision_filter_group",  # exempt pairs; without them, more pairs are checked
        "sensor*",  # cameras and other sensors
        "transmission",  # gears, which name joints
    )),
    "link": frozenset((
        "@type",  # has no meaning in any reader
        "self_filter",  # shapes with which ROS removes a robot from point clouds
        "contact*", "gravity*", "inertial*", "kinematic*", "surface*",  # dynamics
        "visual*",  # appearance; read by `read_visuals`
    )),
    "collision": frozenset((
        "@concave", "@enabled", "@group",  # exempt shapes, or make shapes larger; without them, more is checked
        "@name",
        "drake:proximity_properties",  # friction and stiffness
        "material", "verbose",  # appearance, and output of a simulator
        "surface",  # friction, as in SDF
    )),
    **dict.fromkeys(("geometry", "box", "sphere", "cylinder", "capsule"), frozenset(("@name",))),
    "mesh": frozenset(("@name", "drake:declare_convex")),  # every mesh may be made convex
    "joint": frozenset((
        "@dont_collapse",  # whether a simulator merges links
        "calibration*", "dynamics*",  # where encoders switch; friction
    )),
    "limit": frozenset(("@command_effort", "@current", "@effort", "@gear_velocity")),  # motors
    "safety_controller": frozenset(("@k_position", "@k_velocity")),  # gains
}  # fmt: skip

# The limits of mimicking joints must leave at least this share of a joint's range. A smaller share is a mistake, or
# means that the limits of the mimicking joints were never used, as in the grippers of the PR2.
LEAST_LEFT = 0.1

# If a limit of a mimicking joint would move an end of a range by less than LEAST_CUT [rad or m], the end stays
# unchanged, since such limits are rounded.
LEAST_CUT = 1e-9

# Limits in extensions may differ from the joints' limits by this share of the range without a warning, since they often
# are the joints' limits with fewer digits.
ROUNDED = 0.01

# The first URDF version with quaternions, the first with acceleration and jerk limits, and the first unknown one.
WITH_QUATERNIONS, WITH_ACCELERATIONS, UNKNOWN = (1, 1), (1, 2), (1, 3)

# Maximum number of pairs of links that SRDF rules or links without shapes may produce, which is far more than any robot
# has.
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


class Mimic(NamedTuple):
    """The rule of a joint that follows another joint: its value is multiplier * (value of the other joint) + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint. `kind` is URDF's type; the unit vector `axis` and the pose `origin` are in URDF's frames.

    A joint made in memory has the line 0. The `axis` of a joint whose kind has no axis is meaningless.

    `velocity` [rad/s or m/s], `acceleration` [rad/s² or m/s²] and `jerk` [rad/s³ or m/s³] are upper limits on the rates
    of the joint's value, or NaN if the URDF gives no positive limits. The child is at `origin` when the value is
    `reference`. `lower` and `upper` are the limits in the file; `soft` are narrower limits, from the joint's controller
    and from the joints that mimic it. `bounds` are the lower and upper limits of the first values of a joint with
    several values; URDF has no such limits.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Floats
    axis: Floats = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.nan
    mimic: Mimic | None = None
    line: int = 0
    reference: float = 0.0
    acceleration: float = math.nan
    jerk: float = math.nan
    soft: tuple[float, float] = (-math.inf, math.inf)
    bounds: tuple[Floats, Floats] | None = None

    @property
    def range(self) -> tuple[float, float]:
        """Limits for planning and sampling."""
        return max(self.lower, self.soft[0]), min(self.upper, self.soft[1])


@dataclass(frozen=True, eq=False)
class Description:
    """The contents of a URDF, checked to be a tree.

    Attributes
    ----------
    name : str
    path : Path
    shapes : dict
        Maps every link name to the link's collision shapes; parents come before children, and siblings are in the
        file's order.
    joints : dict
        Maps joint names to joints, in the file's order. No joint mimics a joint that itself mimics another joint: such
        chains are resolved.
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
        """Joints with values of their own: movable joints that do not mimic another joint."""
        return tuple(j.name for j in self.joints.values() if VALUES[j.kind] and j.mimic is None)


@uncollected()
def read_urdf(path: str | os.PathLike[str], text: str | None = None) -> Description:
    """Read a URDF file, or a string as if it were the contents of that file.

    Raises
    ------
    FileError
        If the file does not exist, is not XML, or is not a URDF.
    InputError
        If `path` is not a path, if the links and joints do not form a tree, or a joint is not well defined.
    GeometryError
        If a shape has no size or a negative size.
    UnknownNameError
        If a joint names a link that does not exist.

    Warns
    -----
    UserWarning
        If the file has parts that URDF does not define, or its version is newer than 1.2. If a joint mimics a joint
        that does not exist, or the limits of a mimicking joint would leave hardly any range to the joint that it
        mimics. If the angles of an origin, or limits, are probably in degrees.
    """
    root = read_xml(path, "a URDF", text)
    name, version = root.get("name"), _version(root)
    if version >= UNKNOWN:
        warn(
            f"{root.path}: expected URDF up to version 1.2, found {version[0]}.{version[1]}; its additions are unknown"
        )
    links = by_name(root.all("link"))
    if not links:
        root.fault("at least one <link>", "none")
    joints = {name: _joint(e, links, version) for name, e in by_name(root.all("joint")).items()}
    joints = narrowed(without_chains(_with_known_mimics(joints, root.path), root.path), root.path)
    joint_above: dict[str, Joint] = {}
    for joint in joints.values():
        before = joint_above.setdefault(joint.child, joint)
        if before is not joint:
            raise InputError(
                f"{root.path}, line {joint.line}: expected a tree, found link {joint.child!r} below two joints, "
                f"{before.name!r} and {joint.name!r}"
            )
    order = parents_first(root.fault, list(links), joint_above)
    shapes = {link: tuple(_shape(e, version) for e in links[link].all("collision")) for link in order}
    for link in links.values():
        if link.has("origin") and not np.array_equal(_origin(link, version), np.eye(4)):
            link.disown("origin")  # shapes have origins, but links do not; the identity does no harm
    _doubt_angles(root)
    doubt_limits(root.path, joints)
    _warn_of_extensions(root, joints)
    settle(root, "URDF", HARMLESS)
    only_visual = tuple(link for link in order if links[link].has("visual") and not shapes[link])
    name = root.path.stem if name is None else name
    return Description(name, root.path, shapes, joints, joint_above, only_visual)


def read_visuals(path: Path, text: str | None) -> tuple[dict[str, list[Shape]], list[str]]:
    """Read the visual geometry of a URDF's links, from a file or from its text.

    Returns
    -------
    shapes : dict
        Maps link names to visual shapes, for links that have any.
    faults : list of str
        Faults of the shapes that were omitted. A broken visual shape is not an error, since visual geometry affects no
        query.

    Raises
    ------
    FileError, InputError
        If the file does not exist, or is not a URDF.
    """
    shapes: dict[str, list[Shape]] = {}
    faults = []
    root = read_xml(path, "a URDF", text)
    version = _version(root)
    for name, link in by_name(root.all("link")).items():
        for element in link.all("visual"):
            try:
                shapes.setdefault(name, []).append(_shape(element, version))
            except LoewnerError as error:
                faults.append(str(error))
    return shapes, faults


def parents_first(
    fault: Callable[[str, str], NoReturn], links: list[str], joint_above: Mapping[str, Joint]
) -> list[str]:
    """Order links depth first from the root, which must be unique; if it is not, `fault` raises an error."""
    tops = [name for name in links if name not in joint_above]
    if len(tops) > 1:
        fault("a tree with one root", f"{len(tops)} links that are below no joint: {some(tops)}")
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
        fault("a tree", f"a cycle: {some(lost)} are not below a root")
    return order


def _version(root: Element) -> tuple[int, int]:
    """Read the version of URDF; a file without a version has the first version."""
    text = root.get("version")
    match = re.fullmatch(r"(\d{1,3})(?:\.(\d{1,3}))?", "1.0" if text is None else text.strip())
    if match is None or int(match[1]) != 1:
        root.fault("URDF of version 1.0, 1.1 or 1.2", f"version {cut(text or '')}")
    return 1, int(match[2] or 0)


def _joint(element: Element, links: Collection[str], version: tuple[int, int]) -> Joint:
    name, kind = element.text("name"), element.text("type")
    if kind not in URDF_KINDS:
        element.fault(f"a joint type among {', '.join(URDF_KINDS)}", f"{kind!r} of joint {name!r}")
    ends = []
    for end in ("parent", "child"):
        link = element.the(end).text("link")
        if link not in links:
            expected = f"a link of this robot as {end} of joint {name!r}"
            element.fault(expected, f"{link!r}; {known(links)}", UnknownNameError)
        ends.append(link)
    if kind == "fixed":  # a reduced model may keep these elements of joints that moved before
        element.drop("axis", "limit", "mimic", "safety_controller")
    return Joint(
        name=name,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        origin=_origin(element, version),
        axis=_axis(element, kind),
        mimic=_mimic(element, kind),
        line=element.line,
        **_limits(element, kind, version),
    )


def _axis(joint: Element, kind: str) -> Floats:
    """Read the axis of a joint, as a unit vector.

    The default is x, but z for a planar joint, as in MoveIt and pinocchio.
    """
    element = joint.one("axis")
    if element is None:
        return np.array([0.0, 0.0, 1.0] if kind == "planar" else [1.0, 0.0, 0.0])
    axis = np.array(element.finite("xyz", 3))
    if kind == "floating":
        return np.array([1.0, 0.0, 0.0])
    length = float(lengths(axis))
    if length < SHORTEST_AXIS:
        expected = f"an axis of length 1, and no less than {SHORTEST_AXIS:g}, for joint {joint.text('name')!r}"
        element.fault(expected, f"{' '.join(f'{x:g}' for x in axis)}, whose direction may be due to rounding")
    return np.asarray(axis / length)


def _limits(joint: Element, kind: str, version: tuple[int, int]) -> dict[str, Any]:
    """Read the limits of a joint [rad or m], and of its rates, as attributes of a `Joint`."""
    element, values = joint.one("limit"), VALUES[kind]
    if len(values) > 1 and element is not None:
        if not HARMLESS["limit"].issuperset("@" + name for name in element.attributes):
            warn(
                f"{joint.path}, line {element.line}: a <limit> of the {kind} joint {joint.text('name')!r} is ignored, "
                "since URDF does not define to which of its values it applies; Robot.add_base adds a base with bounds"
            )
        joint.drop("limit")
    if len(values) != 1:
        return {}
    if element is None and kind != "continuous":
        joint.fault(f"a <limit> of the {kind} joint {joint.text('name')!r}", "none (a joint without is continuous)")
    lower, upper = (-math.inf, math.inf) if element is None else _range(joint, element, kind)
    rates = {} if element is None else _rates(element, version)
    return {"lower": lower, "upper": upper, **rates, "soft": _soft(joint, kind, lower, upper)}


def _range(joint: Element, limit: Element, kind: str) -> tuple[float, float]:
    """Read the least and the largest value of a joint."""
    (lower,), (upper,) = limit.numbers("lower", 1, "0"), limit.numbers("upper", 1, "0")
    if kind == "continuous":
        if -FARTHEST_LIMIT < lower < upper < FARTHEST_LIMIT:
            limit.disown("@lower", "@upper")  # 0 .. 0 means that there is no range
        return -math.inf, math.inf
    if not {"lower", "upper"} & limit.attributes.keys() and joint.one("mimic") is None:
        warn(
            f"{joint.path}, line {limit.line}: joint {joint.text('name')!r} cannot move: expected 'lower' and 'upper' "
            "in its <limit>, found neither, and URDF's default for both is 0"
        )
    if lower > upper:
        limit.fault(f"lower <= upper for joint {joint.text('name')!r}", f"{lower:g} > {upper:g}")
    if lower > FARTHEST_LIMIT or upper < -FARTHEST_LIMIT:
        expected = f"limits that leave joint {joint.text('name')!r} values within ±{FARTHEST_LIMIT:g}"
        limit.fault(expected, f"{lower:g} .. {upper:g}")
    return lower, upper


def _rates(limit: Element, version: tuple[int, int]) -> dict[str, float]:
    """Read the largest velocity, acceleration and jerk of a joint with one value; NaN if there is none."""
    largest_rates = {}
    kinds = ("velocity",), ("acceleration", "deceleration"), ("jerk",)
    for names in kinds if version >= WITH_ACCELERATIONS else kinds[:1]:
        rates = {name: limit.numbers(name, 1, "0")[0] for name in names}
        # Many files write 0 for "no limit"; a rate below 0 is neither a limit nor a valid rate.
        limit.disown(*("@" + name for name, rate in rates.items() if rate < 0))
        largest_rates[names[0]] = min((rate for rate in rates.values() if 0 < rate < math.inf), default=math.nan)
    return largest_rates


def _soft(joint: Element, kind: str, lower: float, upper: float) -> tuple[float, float]:
    """Read the limits at which a joint's controller begins to slow down the joint; infinite without a controller."""
    none = -math.inf, math.inf
    element = joint.one("safety_controller")
    if element is None:
        return none
    (low,) = element.numbers("soft_lower_limit", 1, "-inf")
    (high,) = element.numbers("soft_upper_limit", 1, "inf")
    if kind != "continuous" and max(lower, low) < min(upper, high):
        return low, high
    if (low, high) not in (none, (0.0, 0.0)):  # 0 .. 0 means that there is no range
        element.disown("@soft_lower_limit", "@soft_upper_limit")
    return none


def _mimic(joint: Element, kind: str) -> Mimic | None:
    element = joint.one("mimic")
    if element is None:
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


def without_chains(joints: dict[str, Joint], path: Path) -> dict[str, Joint]:
    """Let each mimicking joint follow the joint at the end of its chain."""
    settled = {name: joint for name, joint in joints.items() if joint.mimic is None}
    for start in joints.values():
        chain: dict[str, Joint] = {}  # from the start up to a settled joint, in order
        at = start
        while at.name not in settled:
            if at.name in chain:
                raise InputError(
                    f"{place(path, start)}: expected {start.name!r} to mimic a joint with a value of its own, "
                    f"found a ring: {some(chain)}"
                )
            chain[at.name] = at
            at = joints[at.mimic.joint if at.mimic else at.name]
        for joint in reversed(chain.values()):
            settled[joint.name] = _mimicking(joint, settled[joint.mimic.joint if joint.mimic else joint.name], path)
    return {name: settled[name] for name in joints}


def _mimicking(joint: Joint, followed: Joint, path: Path) -> Joint:
    """If the followed joint itself mimics a third joint, let this joint follow the third."""
    own = joint.mimic
    assert own is not None
    if VALUES[followed.kind] != ("",):
        raise InputError(
            f"{place(path, joint)}: expected a joint of one value for {joint.name!r} to mimic, "
            f"found {followed.name!r}, which is {followed.kind}"
        )
    if followed.mimic is None:
        return joint
    end = followed.mimic
    mimic = Mimic(end.joint, own.multiplier * end.multiplier, own.multiplier * end.offset + own.offset)
    if not (abs(mimic.multiplier) <= xml_elements.LARGEST and abs(mimic.offset) <= xml_elements.LARGEST):
        raise InputError(
            f"{place(path, joint)}: expected {joint.name!r}, which mimics {followed.name!r}, which mimics "
            f"{end.joint!r}, to move by a finite multiple of it, found the multiplier {mimic.multiplier:g} and the "
            f"offset {mimic.offset:g} (the largest allowed is {xml_elements.LARGEST:g})"
        )
    return replace(joint, mimic=mimic)


def narrowed(joints: dict[str, Joint], path: Path) -> dict[str, Joint]:
    """Narrow the ranges of joints to values at which the joints that mimic them are within their limits."""
    ranges: dict[str, tuple[float, float]] = {}  # of joints whose ranges are narrowed
    faults = []
    for joint in joints.values():
        mimic = joint.mimic
        if mimic is None or mimic.multiplier == 0:
            continue
        low, high = ranges.get(mimic.joint, joints[mimic.joint].range)
        least, most = sorted((end - mimic.offset) / mimic.multiplier for end in joint.range)
        new = least if least > low + LEAST_CUT else low, most if most < high - LEAST_CUT else high
        if new == (low, high):
            continue
        if new[0] >= new[1] or new[1] - new[0] < LEAST_LEFT * (high - low) < math.inf:
            faults.append(
                f"{place(path, joint)}: expected limits of {joint.name!r} that leave {mimic.joint!r}, which it mimics, "
                f"a range, found that {least:zg} .. {most:zg} is left of {low:zg} .. {high:zg}"
            )
            continue
        ranges[mimic.joint] = new
    if faults:
        more = f" ({len(faults) - 1} more like it)" if len(faults) > 1 else ""
        warn(f"{faults[0]}; its limits are not used{more}")
    return joints | {name: replace(joints[name], soft=soft) for name, soft in ranges.items()}


def place(path: Path, joint: Joint) -> str:
    """Return where a joint is described, for messages; a joint in memory has no line."""
    return f"{path}, line {joint.line}" if joint.line else str(path)


def _warn_of_extensions(root: Element, joints: dict[str, Joint]) -> None:
    """Warn once about limits and mimics that only extensions of other programs contain."""
    told = [*_controlled(root, joints), *_simulated(root, joints)]
    if told:
        why = "limits and mimics in extensions are ignored, unless the <joint> has them"
        warn(f"{root.path}: {why}: {some(told, UNREAD)}")


def _controlled(root: Element, joints: dict[str, Joint]) -> Iterator[str]:
    """List limits in <ros2_control> that are narrower than the joints' limits, and mimics that the joints lack."""
    listed = (child for control in root.children if control.tag == "ros2_control" for child in control.children)
    for element in listed:
        joint = joints.get(element.attributes.get("name", ""))
        if element.tag != "joint" or joint is None or VALUES[joint.kind] != ("",):
            continue
        if "mimic" in _params(element) and joint.mimic is None:
            yield f"mimic of {joint.name!r} in <ros2_control> (line {element.line})"
        fastest = math.inf if math.isnan(joint.velocity) else joint.velocity
        limits = {"position": joint.range, "velocity": (-fastest, fastest)}
        for interface in (child for child in element.children if child.tag == "command_interface"):
            kind, params = interface.attributes.get("name", ""), _params(interface)
            if kind in limits and _is_narrower(params.get("min"), params.get("max"), *limits[kind]):
                yield f"{kind} of {joint.name!r} in <ros2_control> (line {interface.line})"


def _simulated(root: Element, joints: dict[str, Joint]) -> Iterator[str]:
    """List mimics of Gazebo's plugins that the joints lack."""
    waiting = [child for child in root.children if child.tag == "gazebo"]
    while waiting:
        element = waiting.pop()
        joint = joints.get("".join(element.texts).strip()) if element.tag == "mimicJoint" else None
        if joint is not None and joint.mimic is None and VALUES[joint.kind] == ("",):
            yield f"mimic of {joint.name!r} in <gazebo> (line {element.line})"
        waiting.extend(element.children)


def _params(element: Element) -> dict[str, str]:
    """Return the texts of <param> elements by their names."""
    params = (child for child in element.children if child.tag == "param")
    return {param.attributes.get("name", ""): "".join(param.texts).strip() for param in params}


def _is_narrower(least: str | None, most: str | None, lower: float, upper: float) -> bool:
    """Return whether limits in a text are narrower than other limits by more than rounding."""
    try:
        low, high = float(least or "-inf"), float(most or "inf")
    except ValueError:
        return False
    slack = ROUNDED * (upper - lower) if math.isfinite(upper - lower) else 0.0
    return low > lower + slack or high < upper - slack


def _doubt_angles(root: Element) -> None:
    """Warn, once for all origins, if angles of origins seem to be in degrees."""
    for owner in (*root.all("joint"), *(e for link in root.all("link") for e in link.all("collision"))):
        origin = owner.one("origin")
        doubt = "" if origin is None else doubt_about_rpy(origin.finite("rpy", 3, "0 0 0"))
        if origin is not None and doubt:
            warn(f"{root.path}, line {origin.line}: expected {doubt}")
            return


def doubt_limits(path: Path, joints: dict[str, Joint]) -> None:
    """Warn, once for all revolute joints, if limits seem to be in degrees."""
    doubts = {j: doubt_about_limits(j.lower, j.upper) for j in joints.values() if j.kind == "revolute"}
    doubtful = [joint for joint, doubt in doubts.items() if doubt]
    if doubtful:
        joint, more = doubtful[0], f" ({len(doubtful) - 1} more like it)" if len(doubtful) > 1 else ""
        warn(f"{place(path, joint)}: joint {joint.name!r}: expected {doubts[joint]}{more}")


def _origin(element: Element, version: tuple[int, int]) -> Floats:
    """Read the pose of an <origin>: fixed-axis roll, pitch, yaw [rad], or a quaternion, then translation [m]."""
    T = np.eye(4)
    origin = element.one("origin")
    if origin is None:
        return T
    allowed_names = ("xyz", "rpy") if version < WITH_QUATERNIONS else ("xyz", "rpy", "quat_xyzw")
    unknown = next((name for name in origin.attributes if name not in allowed_names), None)
    if unknown is not None:
        advice = "write a rotation as rpy" + (', or version="1.1" in <robot>' if unknown == "quat_xyzw" else "")
        expected = f"only {', '.join(allowed_names[:-1])} and {allowed_names[-1]} as attributes of <origin>"
        origin.fault(expected, f"{unknown!r}; {advice}")
    T[:3, 3] = origin.finite("xyz", 3, "0 0 0")
    T[:3, :3] = from_rpy(*origin.finite("rpy", 3, "0 0 0"))
    if "quat_xyzw" in origin.attributes:
        if "rpy" in origin.attributes:
            origin.fault("one rotation of an <origin>", "two, rpy and quat_xyzw")
        x, y, z, w = origin.finite("quat_xyzw", 4)
        length = math.hypot(x, y, z, w)
        if abs(length - 1) > QUATERNION_TOLERANCE:
            origin.fault("a unit quaternion as 'quat_xyzw' of <origin>", f"one of length {length:.4g}")
        T[:3, :3] = from_quaternion((w, x, y, z), "quat_xyzw")
    return T


def _shape(owner: Element, version: tuple[int, int]) -> Shape:
    """Read the shape of a <collision> or <visual> element."""
    geometry = owner.the("geometry")
    kinds = ("mesh", *SIZES)
    shapes = [child for kind in kinds for child in geometry.all(kind)]
    if len(shapes) != 1 or len(geometry.children) != 1:
        tags = ", ".join(f"<{c.tag}>" for c in geometry.children) or "none"
        geometry.fault(f"one shape among {', '.join(kinds)} in <geometry>", tags)
    element, origin = shapes[0], _origin(owner, version)
    if element.tag == "mesh":
        text = element.get("scale") or "1 1 1"
        count = 1 if len(text.split()) == 1 else 3
        scale = np.broadcast_to(element.finite("scale", count, text), 3)
        if not scale.all():
            element.fault("a scale without a 0", repr(text), GeometryError)
        return Shape("mesh", (), element.text("filename"), scale, origin, element.line)
    sizes = [size for attribute, count in SIZES[element.tag] for size in element.finite(attribute, count)]
    if min(sizes) <= 0:
        element.fault(f"sizes above 0 for a {element.tag}", " ".join(f"{s:g}" for s in sizes), GeometryError)
    return Shape(element.tag, tuple(sizes), "", np.ones(3), origin, element.line)
