"""The parts of a ROS message that bear on a trajectory, however they are wrapped: nothing of them may be dropped.

Parts are recognised by their fields, since the names that lead to them depend on the message. All parts are collected;
the caller decides which it uses, and refuses the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

# Limit on the depth of nested entries; an entry of a YAML file may contain itself.
DEEPEST = 50

# Number of places or names that a message lists.
LISTED = 8

# A key of MoveIt's messages; the states below it describe the end of a motion.
LATER = "scene_diff"

# Keys with bodies around the robot and on it; their contents have no further parts.
AROUND, CARRIED = "collision_objects", "attached_collision_objects"


@dataclass(eq=False)
class Message:
    """The parts of a message, each with the keys that lead to it.

    Attributes
    ----------
    trajectories : list of (str, mapping)
        Trajectories of joints that have points.
    multi_dof : list of (str, mapping)
        Trajectories of joints with several values, which have points with transforms.
    states : list of (str, mapping)
        Values of joints, ``sensor_msgs/JointState``.
    multi_dof_states : list of (str, mapping)
        Transforms of joints with several values, ``sensor_msgs/MultiDOFJointState``.
    attached : list of (str, mapping)
        Bodies that the robot carries, ``moveit_msgs/AttachedCollisionObject``.
    around : list of (str, str)
        Bodies of the message's world, by their names.
    """

    trajectories: list[tuple[str, dict[Any, Any]]] = field(default_factory=list)
    multi_dof: list[tuple[str, dict[Any, Any]]] = field(default_factory=list)
    states: list[tuple[str, dict[Any, Any]]] = field(default_factory=list)
    multi_dof_states: list[tuple[str, dict[Any, Any]]] = field(default_factory=list)
    attached: list[tuple[str, Any]] = field(default_factory=list)
    around: list[tuple[str, str]] = field(default_factory=list)

    def values(self, *, before: bool = False) -> list[tuple[str, float]]:
        """Return the joints and values of all states, or only of states before the motion, each pair once."""
        states = [held for key, held in self.states if not (before and LATER in key)]
        return list(dict.fromkeys(pair for held in states for pair in _values(held)))

    def placed(self) -> list[str]:
        """Return the joints with several values that a state moves away from the identity."""
        found = (name for _, held in self.multi_dof_states for name in _away(held))
        return list(dict.fromkeys(found))


def parts(message: Any) -> Message:
    """Collect the parts of a message.

    Raises
    ------
    ValueError
        If entries are nested too deeply.
    """
    found = Message()
    _collect(message, "", found, 0)
    return found


def places(found: Sequence[tuple[str, Any]]) -> str:
    """List the places of parts, for messages."""
    more = f" and {len(found) - LISTED} more" if len(found) > LISTED else ""
    return ", ".join(key or "the message itself" for key, _ in found[:LISTED]) + more


def carried(attached: Sequence[tuple[str, Any]]) -> str:
    """List the bodies that a robot carries, and their links, for messages."""
    return _some(
        f"{_field(_field(held, 'object'), 'id')!r} on link {_field(held, 'link_name')!r}" for _, held in attached
    )


def around(found: Sequence[tuple[str, str]]) -> str:
    """List the bodies of a message's world, for messages."""
    return _some(name for _, name in found)


def _collect(held: Any, key: str, found: Message, depth: int) -> None:
    """Add the parts of an entry and of the entries within it."""
    if depth > DEEPEST:
        raise ValueError(f"more than {DEEPEST} entries inside each other")
    if isinstance(held, (tuple, set)):  # of YAML's tags !!omap, !!pairs and !!set, which no message has
        raise ValueError(f"entries in another form than mappings and lists at {key!r}")
    if isinstance(held, list):
        for k, each in enumerate(held):
            if isinstance(each, (dict, list, tuple, set)):
                _collect(each, f"{key}[{k}]", found, depth + 1)
    elif isinstance(held, dict):
        whole = _note(held, key, found)
        for name, each in held.items():
            if name not in whole and isinstance(each, (dict, list, tuple, set)):
                _collect(each, f"{key}/{name}" if key else str(name), found, depth + 1)


def _note(held: dict[Any, Any], key: str, found: Message) -> list[str]:
    """Add a mapping to the parts of its kind, and return the keys whose contents this has settled."""
    settled = [CARRIED, AROUND]
    if _has_points(held):
        kind = found.multi_dof if _has_transforms(held["points"]) else found.trajectories
        kind.append((key, held))
        settled.append("points")
    if isinstance(held.get("name"), list) and "position" in held:
        found.states.append((key, held))
    if held.get("transforms") and "joint_names" in held:
        found.multi_dof_states.append((key, held))
    if "link_name" in held and "object" in held:
        found.attached.append((key, held))
        settled.append("object")
    if "resolution" in held and held.get("data"):
        found.around.append((key, "an octree"))
    found.attached += [(key, each) for each in _listed(held.get(CARRIED))]
    found.around += [(key, str(_field(each, "id"))) for each in _listed(held.get(AROUND))]
    return settled


def _has_points(held: dict[Any, Any]) -> bool:
    """Return whether a mapping is a trajectory with at least one point; polygons and clouds have points, too."""
    points = held.get("points")
    if not points:
        return False
    return "joint_names" in held or (isinstance(points, list) and "time_from_start" in _mapping(points[0]))


def _has_transforms(points: Any) -> bool:
    return isinstance(points, list) and any("transforms" in point for point in points if isinstance(point, dict))


def _values(state: dict[Any, Any]) -> Iterator[tuple[str, float]]:
    """Return the joints and values of a JointState, which may also have velocities alone."""
    names, positions = state["name"], state["position"] or []
    if not isinstance(positions, list) or len(positions) not in (0, len(names)):
        count = len(positions) if isinstance(positions, list) else type(positions).__name__
        raise ValueError(f"a state of {len(names)} joints with the positions {count}")
    return ((str(name), float(value)) for name, value in zip(names, positions, strict=False))


def _away(state: dict[Any, Any]) -> Iterator[str]:
    """Return the joints of a MultiDOFJointState whose transforms are not the identity."""
    names, transforms = state["joint_names"], state["transforms"]
    if not isinstance(transforms, list) or not isinstance(names, list) or len(names) != len(transforms):
        raise ValueError("a state of joints with several values whose names and transforms differ in number")
    for name, transform in zip(names, transforms, strict=True):
        numbers = [*_xyz(_field(transform, "translation")), *_xyz(_field(transform, "rotation"))]
        if any(number != 0 for number in numbers):
            yield str(name)


def _xyz(held: Any) -> list[Any]:
    """Return three components of a vector or a quaternion; a quaternion that turns nothing has zeros here."""
    return [_mapping(held).get(axis) for axis in "xyz"]


def _listed(held: Any) -> list[Any]:
    """Return the entries of a list; one that is not in a list counts as well, and nothing is an empty list."""
    return held if isinstance(held, list) else [held] if held else []


def _mapping(held: Any) -> dict[Any, Any]:
    return held if isinstance(held, dict) else {}


def _field(held: Any, name: str) -> Any:
    return _mapping(held).get(name, "")


def _some(names: Iterator[str]) -> str:
    """Format names for messages, limited to a readable number."""
    listed = list(names)
    more = f" and {len(listed) - LISTED} more" if len(listed) > LISTED else ""
    return ", ".join(listed[:LISTED]) + more
