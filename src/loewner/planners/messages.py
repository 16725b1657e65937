"""Read and write ROS messages with trajectories. Each field is used, ignored, mentioned in a warning, or refused.

A message is read according to the types of its fields. A key that a message's type does not have is an error. Thus,
nothing that affects a motion (such as the joints' start state, bodies that the robot carries, or the motion of a base)
is overlooked.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np

from loewner._base import _tables
from loewner._base._nodes import JsonNode, Node, some
from loewner._base._validate import Floats
from loewner.errors import FileError, InputError

# Treatments of fields that are not messages of a type below. USED: the code for the message's type reads the field.
# HARMLESS: the field has no effect on the joints and the bodies of a robot. WARNED: a warning mentions the field unless
# it is empty. ANY: the field is a message of any type that has no ANY field itself.
USED, HARMLESS, WARNED, ANY = "used", "harmless", "warned", "any"


def _harmless(*keys: str) -> dict[str, str]:
    return dict.fromkeys(keys, HARMLESS)


# The fields of each type. Fields that are not harmless are listed in the order in which they take effect. If a field is
# a list, its type is the type of the entries.
TYPES: dict[str, dict[str, str]] = {
    "JointTrajectory": {"header": HARMLESS, "joint_names": USED, "points": USED},
    "MultiDOFJointTrajectory": {"header": HARMLESS, "joint_names": USED, "points": USED},
    "RobotTrajectory": {
        "joint_trajectory": "JointTrajectory", "multi_dof_joint_trajectory": "MultiDOFJointTrajectory"
    },
    "RobotState": dict.fromkeys(
        ("is_diff", "joint_state", "multi_dof_joint_state", "attached_collision_objects"), USED
    ),
    "PlanningSceneWorld": {"collision_objects": USED, "octomap": USED},
    "PlanningScene": {
        "robot_state": "RobotState", "robot_model_name": USED, "link_padding": WARNED, "link_scale": WARNED,
        "world": "PlanningSceneWorld",
        # The frames belong to bodies in the message's world, which is not read. The matrix lists fewer pairs than are
        # checked here. This is_diff refers to the world; a state has a separate is_diff.
        **_harmless("name", "fixed_frame_transforms", "allowed_collision_matrix", "object_colors", "is_diff"),
    },
    "DisplayTrajectory": {"model_id": USED, "trajectory_start": "RobotState", "trajectory": "RobotTrajectory"},
    "MotionPlanResponse": {
        "trajectory_start": "RobotState", "trajectory": "RobotTrajectory",
        **_harmless("group_name", "planning_time", "error_code"),
    },
    "MotionPlanDetailedResponse": {
        "trajectory_start": "RobotState", "trajectory": "RobotTrajectory",
        **_harmless("group_name", "description", "processing_time", "error_code"),
    },
    "MotionSequenceResponse": {
        "sequence_start": "RobotState", "planned_trajectories": "RobotTrajectory",
        **_harmless("error_code", "planning_time"),
    },
    "GetCartesianPath": {
        "start_state": "RobotState", "solution": "RobotTrajectory", **_harmless("fraction", "error_code"),
    },
    "MoveGroupResult": {
        "trajectory_start": "RobotState", "planned_trajectory": "RobotTrajectory", "executed_trajectory": WARNED,
        **_harmless("error_code", "planning_time"),
    },
    "ExecuteTrajectoryGoal": {"trajectory": "RobotTrajectory", "controller_names": HARMLESS},
    "FollowJointTrajectoryGoal": {
        "trajectory": "JointTrajectory", "multi_dof_trajectory": "MultiDOFJointTrajectory",
        "path_tolerance": USED, "component_path_tolerance": USED,
        **_harmless("goal_tolerance", "component_goal_tolerance", "goal_time_tolerance"),  # tolerances at the end only
    },
    "SubTrajectory": {
        "trajectory": "RobotTrajectory", "scene_diff": "PlanningScene", **_harmless("info", "execution_info"),
    },
    "Solution": {  # sub_solution lists which parts belong together; the parts are in sub_trajectory
        "start_scene": "PlanningScene", "sub_trajectory": "SubTrajectory", **_harmless("task_id", "sub_solution"),
    },
    "ExecuteTaskSolutionGoal": {"solution": "Solution"},
    "GetMotionPlanResponse": {"motion_plan_response": "MotionPlanResponse"},
    "GetMotionSequenceResponse": {"response": "MotionSequenceResponse"},
    "Goal": {"header": HARMLESS, "goal_id": HARMLESS, "goal": ANY},
    "Result": {"header": HARMLESS, "status": HARMLESS, "result": ANY},
}  # fmt: skip
WRAPPED = [name for name, fields in TYPES.items() if ANY not in fields.values()]

# Keys of other types. Some of them do not affect the robot's place: headers, efforts, the velocities, twists and
# wrenches of a state, the posture of a gripper, and the weight of a body.
RATES = ("positions", "velocities", "accelerations")
POINT = (*RATES, "effort", "time_from_start")
PLACED_POINT = ("transforms", "velocities", "accelerations", "time_from_start")
JOINT_STATE = ("header", "name", "position", "velocity", "effort")
PLACED_STATE = ("header", "joint_names", "transforms", "twist", "wrench")
CARRIED = ("link_name", "object", "touch_links", "detach_posture", "weight")
TREE = ("header", "origin", "octomap", "binary", "id", "resolution", "data")
TOLERANCE = ("name", "joint_name", "component", "position", "velocity", "acceleration")

# How the source of a value begins with which an earlier part of the message ended.
END = "the end of "

# Keys of a duration's seconds and nanoseconds, in ROS 2 and in ROS 1. A number of seconds that exceeds a day is
# probably in nanoseconds.
HALVES = (("sec", "nanosec"), ("secs", "nsecs"))
DAY = 86400.0

# The longest duration that a message can contain, because its seconds are a 32-bit integer.
LONGEST = 2.0**31

# The operation that removes a body, in moveit_msgs/CollisionObject.
REMOVE = 1
OPERATIONS = range(4)


@dataclass(eq=False)
class State:
    """State of the robot at one time of a message.

    Attributes
    ----------
    joints : dict
        Values by joint [rad or m].
    places : dict
        For each joint with several values, an array of 7 numbers: position [m] and quaternion x, y, z, w.
    carried : dict
        For each carried body, by name: the link that carries it, and the links that it may touch.
    sources : dict
        For each joint, the keys of the state or of the earlier trajectory from which its values come.
    """

    joints: dict[str, float] = field(default_factory=dict)
    places: dict[str, Floats] = field(default_factory=dict)
    carried: dict[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)


@dataclass(eq=False)
class Motion:
    """Timed values of joints.

    Attributes
    ----------
    names : list of str
    times : ndarray, shape (n,)
        In seconds.
    rows : dict
        Arrays of shape (n, joints) for "positions" and, if the points contain such values, for "velocities" and
        "accelerations". Alternatively, an array of shape (n, joints, 7) for "transforms": positions and quaternions x,
        y, z, w.
    """

    names: list[str]
    times: Floats
    rows: dict[str, Floats]


@dataclass(eq=False)
class Part:
    """A trajectory in a message: for joints with one value, for joints with several values, or for both kinds."""

    place: str
    joints: Motion | None
    placed: Motion | None
    start: State


@dataclass(eq=False)
class Message:
    """All trajectories of a message in order, and its other contents.

    Attributes
    ----------
    parts : list of Part
    robots : list of str
        Names of robots in the message.
    around : list of str
        Names of the bodies in the message's world.
    bodies : set of str
        Names of bodies that the robot carries at some time, or that are detached from the robot.
    warnings : list of str
        Sentences for warnings about parts of the message that are not read.
    """

    parts: list[Part] = field(default_factory=list)
    robots: list[str] = field(default_factory=list)
    around: list[str] = field(default_factory=list)
    bodies: set[str] = field(default_factory=set)
    warnings: list[str] = field(default_factory=list)


def read(root: Node) -> Message:
    """Read a message.

    Raises
    ------
    FileError
        If the message is not of a known type, has a key that its type does not have, or has a value of the wrong kind.
    """
    message, state = Message(), State()
    for each in _listed(root):
        _walk(each, _type_of(each, tuple(TYPES)), message, state)
    return message


def _type_of(node: Node, among: Collection[str]) -> str:
    """Return the type that fits a message best, judged by the keys of the message and its parts."""
    keys = set(node.mapping(None))

    def fits(name: str) -> tuple[bool, int, int]:
        return _fits(node, name), len(keys & TYPES[name].keys()), -len(TYPES[name])

    return max(among, key=fits)


def _fits(node: Node, name: str) -> bool:
    """Return whether a message may be of a type: the message and its parts have only keys of their types."""
    if node.kind != "mapping":
        return False
    fields = TYPES[name]
    keys = node.mapping(None)
    if not keys.keys() <= fields.keys():
        return False
    if name in ("JointTrajectory", "MultiDOFJointTrajectory") and "points" in keys:
        return _is_placed(keys["points"]) == (name == "MultiDOFJointTrajectory")
    parts = ((held, fields[key]) for key, held in keys.items() if fields[key] in TYPES and not held.empty)
    return all(_fits(each, of) for held, of in parts for each in _listed(held))


def _is_placed(points: Node) -> bool:
    """Return whether points have transforms."""
    first = points.first() if points.kind == "sequence" and not points.empty else None
    return first is not None and first.kind == "mapping" and "transforms" in first.mapping(None)


def _walk(node: Node, name: str, found: Message, state: State) -> None:
    """Read a message of a known type, and change `state` accordingly."""
    fields = TYPES[name]
    keys = node.mapping(fields)
    if name in ("JointTrajectory", "MultiDOFJointTrajectory"):
        _add_part(node, {name: node}, found, state)
    elif name in ("RobotTrajectory", "FollowJointTrajectoryGoal"):
        nodes_by_type = {fields[key]: held for key, held in keys.items() if fields[key] in TYPES and not held.empty}
        _add_part(node, nodes_by_type, found, state)
        found.warnings += _tolerated(keys)
    elif name == "RobotState":
        _read_state(keys, state, found)
    elif name == "PlanningSceneWorld":
        found.around += _around(keys)
    else:
        for key, of in fields.items():
            if key not in keys or keys[key].empty or of == HARMLESS:
                continue
            if of == USED:
                found.robots.append(keys[key].text())
            elif of == WARNED:
                found.warnings.append(f"{keys[key].key} is not read")
            else:
                listed = _listed(keys[key])
                if name == "MotionPlanDetailedResponse" and of == "RobotTrajectory" and len(listed) > 1:
                    found.warnings.append(f"{keys[key].key} has {len(listed)} stages of one plan; the last one is read")
                    listed = listed[-1:]
                for each in listed:
                    _walk(each, _type_of(each, WRAPPED) if of == ANY else of, found, state)


def _add_part(node: Node, given: dict[str, Node], found: Message, state: State) -> None:
    """Add the motion of a message; afterwards the joints have the values of its last points."""
    joints, placed = (_motion(given.get(name), name) for name in ("JointTrajectory", "MultiDOFJointTrajectory"))
    if joints is None and placed is None:
        return
    found.parts.append(
        Part(node.key or "the message itself", joints, placed, State(*(dict(held) for held in vars(state).values())))
    )
    if joints is not None:
        state.joints.update(zip(joints.names, joints.rows["positions"][-1].tolist(), strict=True))
        state.sources.update(dict.fromkeys(joints.names, f"{END}{found.parts[-1].place}"))
    if placed is not None:
        state.places.update(zip(placed.names, placed.rows["transforms"][-1], strict=True))
        state.sources.update(dict.fromkeys(placed.names, f"{END}{found.parts[-1].place}"))


def _motion(node: Node | None, name: str) -> Motion | None:
    """Read a JointTrajectory or a MultiDOFJointTrajectory, as `name` states; return None if it has no points."""
    keys = {} if node is None else node.mapping(TYPES[name])
    if node is None or "points" not in keys or keys["points"].empty:
        return None
    if "joint_names" not in keys:
        raise node.error("expected the key joint_names, found none")
    names = [joint.text() for joint in keys["joint_names"].items()]
    _expect_once(names, keys["joint_names"])
    if name == "MultiDOFJointTrajectory":
        return _placed_motion(names, keys["points"])
    return _plain_motion(names, keys["points"]) or _joint_motion(names, keys["points"])


def _joint_motion(names: list[str], node: Node) -> Motion:
    """Read the points of a JointTrajectory."""
    points = [point.mapping(POINT, required=("time_from_start",)) for point in node.items()]
    rows = {}
    for kind in RATES:
        is_present = [kind in point and not point[kind].empty for point in points]
        if not any(is_present):
            continue
        if not all(is_present):
            raise node.items()[is_present.index(False)].error(f"expected {kind} of all points or of none, found none")
        rows[kind] = np.array([point[kind].numbers(len(names)) for point in points])
    if "positions" not in rows:
        raise node.error("expected positions of the points, found none")
    return Motion(names, np.array([_seconds(point["time_from_start"]) for point in points]), rows)


def _plain_motion(names: list[str], points: Node) -> Motion | None:
    """Read JSON points that have only the usual contents, which is several times as fast; otherwise return None."""
    raw = points.raw
    if not isinstance(points, JsonNode) or not all(type(point) is dict and point.keys() <= set(POINT) for point in raw):
        return None
    times = [point.get("time_from_start") for point in raw]
    halves = [[time.get(half) for time in times if type(time) is dict and len(time) == 2] for half in HALVES[0]]
    if len(halves[0]) < len(raw) or any({*map(type, half)} != {int} for half in halves):
        return None
    rows = {}
    try:
        for kind in RATES:
            listed = [[] if point.get(kind) is None else point[kind] for point in raw]
            if any(type(row) is not list for row in listed):
                return None
            if not any(listed):
                continue
            types = {*map(type, itertools.chain.from_iterable(listed))}
            if {*map(len, listed)} != {len(names)} or not types <= {int, float}:
                return None
            rows[kind] = np.array(listed, dtype=np.float64)
        seconds = np.array(halves[0], dtype=np.float64) + 1e-9 * np.array(halves[1], dtype=np.float64)
    except OverflowError:
        return None
    plain = "positions" in rows and all(np.isfinite(array).all() for array in rows.values())
    return Motion(names, seconds, rows) if plain else None


def _placed_motion(names: list[str], node: Node) -> Motion:
    """Read the points of a MultiDOFJointTrajectory."""
    points = [point.mapping(PLACED_POINT, required=("transforms", "time_from_start")) for point in node.items()]
    rows = []
    for point in points:
        for kind in ("velocities", "accelerations"):
            if kind in point and not point[kind].empty and True in [_moves(each) for each in point[kind].items()]:
                raise point[kind].error(f"expected transforms alone, between which a base moves straight, found {kind}")
        rows.append([x for each in point["transforms"].items(len(names)) for x in _transform(each)])
    transforms = np.array(rows).reshape(len(points), len(names), 7)
    return Motion(names, np.array([_seconds(point["time_from_start"]) for point in points]), {"transforms": transforms})


def _expect_once(names: list[str], node: Node) -> None:
    if len(set(names)) < len(names):
        twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
        raise node.error(f"expected each joint once, found {some(twice)} again")


def _read_state(keys: dict[str, Node], state: State, found: Message) -> None:
    """Apply a RobotState to a state. If the RobotState is not a difference, it replaces the carried bodies."""
    differs = "is_diff" in keys and not keys["is_diff"].empty and keys["is_diff"].flag()
    empty = True
    for key, state_fields, of_names, of_values, what in (
        ("joint_state", JOINT_STATE, "name", "position", "positions"),
        ("multi_dof_joint_state", PLACED_STATE, "joint_names", "transforms", "transforms"),
    ):
        if key not in keys or keys[key].empty:
            continue
        held = keys[key].mapping(state_fields)
        names, values = _list(held, of_names), _list(held, of_values)
        if len(values) != len(names) and (values or key != "joint_state"):  # joints may have only velocities
            raise keys[key].error(f"expected as many {what} as names, found {len(values)} and {len(names)}")
        joint_names = [name.text() for name in names[: len(values)]]
        if key == "joint_state":
            state.joints.update(zip(joint_names, (value.number() for value in values), strict=True))
        else:
            state.places.update(zip(joint_names, (np.array(_transform(T)) for T in values), strict=True))
        _expect_once(joint_names, keys[key])
        state.sources.update(dict.fromkeys(joint_names, keys[key].key))
        empty = empty and not joint_names
    if "attached_collision_objects" in keys:
        listed = keys["attached_collision_objects"]
        # MoveIt ignores a state in which nothing is set.
        if not differs and not (empty and listed.empty):
            state.carried.clear()
        _carry(listed, state, found)


def _carry(node: Node, state: State, found: Message) -> None:
    """Change the bodies that the robot carries in a state."""
    for entry in _listed(node) if not node.empty else []:
        held = entry.mapping(CARRIED, required=("link_name", "object"))
        body = held["object"].mapping(None)
        name = body["id"].text() if "id" in body and not body["id"].empty else ""
        link = held["link_name"].text()
        operation = _operation(body["operation"]) if "operation" in body else 0
        if operation == REMOVE:
            on_link = [one for one, (carrier, _) in state.carried.items() if carrier == link]
            for one in [name] if name else on_link:
                state.carried.pop(one, None)
        else:
            state.carried[name] = link, tuple(each.text() for each in _list(held, "touch_links"))
        found.bodies |= {name} if name else set()


def _operation(node: Node) -> int:
    """Read a byte: a number, or the character that some programs write instead."""
    try:
        code = node.number()
    except FileError:
        text = node.text()
        code = ord(text) if len(text) == 1 else -1
    if code not in OPERATIONS:
        raise node.error(f"expected 0 to 3, found {node.described()}")
    return int(code)


def _around(keys: dict[str, Node]) -> Iterator[str]:
    """Return the names of the bodies in a message's world."""
    for entry in _list(keys, "collision_objects"):
        held = entry.mapping(None)
        yield held["id"].text() if "id" in held and not held["id"].empty else "a body without a name"
    tree = keys["octomap"].mapping(TREE) if "octomap" in keys and not keys["octomap"].empty else {}
    inner = tree["octomap"].mapping(TREE) if "octomap" in tree and not tree["octomap"].empty else tree
    if "data" in inner and not inner["data"].empty:
        yield "an octree"


def _tolerated(keys: dict[str, Node]) -> Iterator[str]:
    """Describe how far a goal lets a controller deviate from the path."""
    for key in ("path_tolerance", "component_path_tolerance"):
        for entry in _list(keys, key):
            held = entry.mapping(TOLERANCE)
            allowed = held["position"].number() if "position" in held and not held["position"].empty else 0.0
            if allowed:  # 0 means the controller's default, and a negative number means no limit
                named = [held[name].text() for name in ("name", "joint_name") if name in held]
                joint = named[0] if named else "a joint"
                far = f"by {allowed:g}" if allowed > 0 else "without a limit"
                yield f"{entry.key} lets {joint} deviate {far} on the way; joint_error= covers deviations"


def _seconds(node: Node) -> float:
    """Read a duration: seconds and nanoseconds as in ROS 1 or ROS 2, or a number of seconds."""
    if node.kind == "scalar":
        try:
            seconds = node.number()
        except FileError:
            seconds = _text_of_seconds(node)
        if seconds > DAY:
            raise node.error(f"expected seconds, at most a day, found {seconds:g}; is it in nanoseconds?")
        return seconds
    held = node.mapping(tuple(key for pair in HALVES for key in pair))
    for pair in HALVES:
        if held.keys() == set(pair):
            return held[pair[0]].number() + 1e-9 * held[pair[1]].number()
    raise node.error(f"expected sec and nanosec, or secs and nsecs, found {some(held) or 'neither'}")


def _text_of_seconds(node: Node) -> float:
    """Read a number of seconds in quotes. Faults are reported as for a number without quotes."""
    try:
        return _tables.number(node.text())
    except (ValueError, FileError):
        return node.number()


def _transform(node: Node) -> list[float]:
    """Read the position and the quaternion x, y, z, w of a Transform. A missing or zero rotation is the identity."""
    keys = node.mapping(("translation", "rotation"))
    position, quaternion = _vector(keys, "translation", "xyz"), _vector(keys, "rotation", "xyzw")
    if not any(quaternion):
        quaternion[3] = 1.0
    return [*position, *quaternion]


def _vector(keys: dict[str, Node], key: str, axes: str) -> list[float]:
    """Read the coordinates of a vector or a quaternion; missing ones are 0."""
    held = keys[key].mapping(tuple(axes)) if key in keys and not keys[key].empty else {}
    return [held[axis].number() if axis in held else 0.0 for axis in axes]


def _moves(node: Node) -> bool:
    """Return whether a geometry_msgs/Twist has a number other than 0."""
    parts = [part.mapping(("x", "y", "z")) for part in node.mapping(("linear", "angular")).values()]
    return True in [number.number() != 0 for part in parts for number in part.values()]


def _list(keys: dict[str, Node], key: str) -> list[Node]:
    """Return the entries of a list, which may be missing."""
    return [] if key not in keys or keys[key].empty else keys[key].items()


def _listed(node: Node) -> list[Node]:
    """Return the entries of a list. A message that is not in a list counts as the only entry."""
    return list(node.items()) if node.kind == "sequence" else [node]


# -- writing ------------------------------------------------------------------------------------


def nanoseconds(times: Floats) -> Floats:
    """Round times to nanoseconds, and return the numbers that are read back from a message; see `written`."""
    for time in times[~((times >= 0) & (times < LONGEST))][:1].tolist():
        raise InputError(f"times: expected 0 to {LONGEST:.0f} s in a message, found {time:.9g}")
    return np.array([seconds + 1e-9 * rest for seconds, rest in map(_halves, times.tolist())])


def written(names: Collection[str], times: Floats, rows: dict[str, Floats], suffix: str) -> str:
    """Write a JointTrajectory in JSON or YAML. Times are rounded to nanoseconds; other numbers have full precision.

    Parameters
    ----------
    names : collection of str
    times : ndarray, shape (n,)
        In seconds.
    rows : dict
        As in `Motion`.
    suffix : {".json", ".yaml"}

    Raises
    ------
    InputError
        If two times are the same after rounding, or a time is negative or too long for a message.
    """
    rounded = nanoseconds(times)
    for k in np.flatnonzero(~(np.diff(rounded) > 0))[:1].tolist():
        before, after = times[k : k + 2].tolist()
        raise InputError(
            f"times: expected times at least a nanosecond apart in a message, found {before!r} and {after!r}"
        )
    halves, columns = list(map(_halves, times.tolist())), {kind: array.tolist() for kind, array in rows.items()}
    if suffix == ".json":
        points = [
            {**{kind: held[k] for kind, held in columns.items()}, "time_from_start": {"sec": sec, "nanosec": nanosec}}
            for k, (sec, nanosec) in enumerate(halves)
        ]
        return json.dumps({"joint_names": list(names), "points": points})
    listed = json.dumps(list(names), ensure_ascii=not "".join(names).isprintable())
    lines = [f"joint_names: {listed}", "points:"]
    for k, (sec, nanosec) in enumerate(halves):
        lines.append("- " + "\n  ".join(f"{kind}: {_in_yaml(held[k])}" for kind, held in columns.items()))
        lines.append(f"  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")
    return "\n".join(lines) + "\n"


def _halves(time: float) -> tuple[int, int]:
    """Return whole seconds, and nanoseconds."""
    return divmod(round(time * 1e9), 10**9)


def _in_yaml(numbers: list[float]) -> str:
    """Format a list in YAML, where a number with an exponent needs a decimal point."""
    texts = (repr(number) for number in numbers)
    return f"[{', '.join(text if '.' in text else text.replace('e', '.0e') for text in texts)}]"
