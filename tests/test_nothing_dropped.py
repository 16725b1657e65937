"""No part of a file is dropped without a word: each is used, is known to be harmless, or is told or refused.

The sample of a format has every word of it. Its mutants have one part renamed, doubled, or joined by a stranger; a
reader that picks what it knows, and does not account for the rest, reads some of them as if nothing had happened. The
parts where that is right are listed.
"""

import base64
import copy
import json
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from loewner import LoewnerError, Robot, load_scene, planners, read_motion_bench_maker
from loewner.meshes import decomposition as meshes
from loewner.robots.description.srdf import read_srdf
from loewner.robots.description.urdf import read_urdf as description
from robot_oracle import robots_folder
from sampling import quick


class Format(NamedTuple):
    """A format of files.

    Attributes
    ----------
    sample : str
    read : callable
        Reads a file, given by its path.
    mutants : callable
        Yields, for a sample: what was done, the path of the part to which it was done, and the text.
    harmless : tuple of str
        Parts whose contents may change without a word: paths, each of which stands for all that begin with it.
    repeated : tuple of str
        Parts that may occur several times.
    named : tuple of str
        Parts whose names are the user's.
    """

    sample: str
    read: Callable[[Path], object]
    mutants: Callable[[str], Iterator[tuple[str, str, str]]]
    harmless: tuple[str, ...]
    repeated: tuple[str, ...] = ()
    named: tuple[str, ...] = ()


def without_a_word(form: Format, path: Path, every: int) -> set[tuple[str, str]]:
    """What can be done to which parts of a sample, or to each n-th, without an error or a warning of the reader."""
    path.write_text(form.sample)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        form.read(path)
    quiet = set()
    for what, part, text in islice(form.mutants(form.sample), 0, None, every):
        path.write_text(text)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                form.read(path)
            except LoewnerError:
                continue
        if not told:
            quiet.add((what, part))
    return quiet


# -- XML ------------------------------------------------------------------------------------------


def xml_mutants(sample: str, *, once: bool = False) -> Iterator[tuple[str, str, str]]:
    """Rename and double each element, give it a child that no format has, and likewise with its attributes.

    With `once`, only the first part of a kind has mutants: large files have hundreds of it.
    """
    done = set()
    for number, (path, _, element) in enumerate(_elements(ElementTree.fromstring(sample))):
        changes = [("renamed", path, _rename), ("doubled", path, _double)]
        changes += [("joined", f"{path}/stranger", _join), ("joined", f"{path}@stranger", _join_attribute)]
        changes += [("joined", f"{path}/text", _join_text)]
        changes += [("renamed", f"{path}@{name}", partial(_rename_attribute, name)) for name in element.attrib]
        for what, part, change in changes:
            if once and (what, part) in done:
                continue
            done.add((what, part))
            root = ElementTree.fromstring(sample)
            change(*_elements(root)[number][1:])
            yield what, part, ElementTree.tostring(root, encoding="unicode")


def _elements(root: ElementTree.Element) -> list[tuple[str, ElementTree.Element, ElementTree.Element]]:
    """Each element but the root, with its path and the element that contains it, in the order of the file."""
    found, waiting = [], [("", root)]
    while waiting:
        path, above = waiting.pop(0)
        inside = [(f"{path}/{element.tag.rpartition('}')[2]}".lstrip("/"), element) for element in above]
        found += [(name, above, element) for name, element in inside]
        waiting += inside
    return found


def _rename(_: ElementTree.Element, element: ElementTree.Element) -> None:
    element.tag += "x"


def _rename_attribute(name: str, _: ElementTree.Element, element: ElementTree.Element) -> None:
    element.set(name + "x", element.attrib.pop(name))


def _join(_: ElementTree.Element, element: ElementTree.Element) -> None:
    ElementTree.SubElement(element, "stranger")


def _join_attribute(_: ElementTree.Element, element: ElementTree.Element) -> None:
    element.set("stranger", "1")


def _join_text(_: ElementTree.Element, element: ElementTree.Element) -> None:
    element.text = (element.text or "") + " 1 2 3 "


def _double(above: ElementTree.Element, element: ElementTree.Element) -> None:
    """Add a copy with other numbers, so that it matters which of the two counts."""
    twin = copy.deepcopy(element)
    for one in twin.iter():
        for name, value in one.attrib.items():
            if re.fullmatch(r"[-+.\d\s]+", value):
                one.set(name, " ".join(str(1.25 * float(word)) for word in value.split()))
    above.insert(list(above).index(element) + 1, twin)


# -- JSON, and YAML, which contains it ----------------------------------------------------------------


class Pairs(list):
    """A mapping as a list of keys and values, in which a key may occur twice."""


def json_mutants(sample: str) -> Iterator[tuple[str, str, str]]:
    """Rename each key, double it with another value, and add a key that no format has to each mapping."""
    places = [part for part, _, _ in _entries(json.loads(sample, object_pairs_hook=Pairs))]
    for number, part in enumerate(places):
        for what in ("renamed", "doubled", "joined"):
            root = json.loads(sample, object_pairs_hook=Pairs)
            _, holder, at = _entries(root)[number]
            key, value = holder[at]
            if what == "renamed":
                holder[at] = (key + "x", value)
            elif what == "doubled":
                holder.insert(at, (key, 7))
            else:
                holder.append(("stranger", 7))
            yield what, f"{part.rpartition('/')[0]}/stranger".lstrip("/") if what == "joined" else part, _text(root)


def _entries(tree: object, path: str = "") -> list[tuple[str, Pairs, int]]:
    """Each key of a tree: its path, without places in lists, the mapping, and the place in the mapping."""
    found = []
    if isinstance(tree, Pairs):
        for at, (key, value) in enumerate(tree):
            part = f"{path}/{key}".lstrip("/")
            found += [(part, tree, at), *_entries(value, part)]
    elif isinstance(tree, list):
        for value in tree:
            found += _entries(value, path)
    return found


def _text(tree: object) -> str:
    if isinstance(tree, Pairs):
        return "{" + ", ".join(f"{json.dumps(key)}: {_text(value)}" for key, value in tree) + "}"
    return "[" + ", ".join(map(_text, tree)) + "]" if isinstance(tree, list) else json.dumps(tree)


# -- robots ---------------------------------------------------------------------------------------

URDF = """<robot name="r" version="1.2">
<material name="m"><color rgba="1 0 0 1"/></material><transmission name="t"><joint name="j"><x/></joint></transmission>
<sensor name="s"><parent link="a"/></sensor><gazebo reference="a"><mu1>1</mu1></gazebo>
<ros2_control name="c" type="system"><joint name="j"><state_interface name="position"/></joint></ros2_control>
<link name="a" type="x"><inertial><mass value="1"/></inertial>
  <visual><geometry><box size="1 1 1"/></geometry><material name="m"/></visual>
  <collision name="c"><origin xyz="0.1 0 0" rpy="0 0 0.1"/><geometry><box size="1 1 1"/></geometry></collision></link>
<link name="b"><collision><origin quat_xyzw="0 0 0.6 0.8"/>
  <geometry><cylinder radius="0.1" length="0.5"/></geometry></collision></link>
<link name="d"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="e"><collision><geometry><capsule radius="0.1" length="0.5"/></geometry></collision></link>
<link name="f"><collision><geometry><mesh filename="m.obj" scale="1 1 2"/></geometry></collision></link>
<joint name="j" type="revolute"><origin xyz="0 0 1" rpy="0.1 0 0"/><parent link="a"/><child link="b"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1.5" effort="1" velocity="2" acceleration="3" deceleration="2" jerk="9"/>
  <dynamics damping="1"/><calibration rising="0"/>
  <safety_controller soft_lower_limit="-0.5" soft_upper_limit="0.5" k_position="1" k_velocity="1"/></joint>
<joint name="k" type="prismatic"><origin xyz="0 0 0.5"/><parent link="b"/><child link="d"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1" velocity="1"/><mimic joint="j" multiplier="0.5" offset="0.01"/></joint>
<joint name="l" type="continuous"><parent link="d"/><child link="e"/><axis xyz="1 0 0"/><limit velocity="1"/></joint>
<joint name="n" type="fixed"><origin xyz="0 0 1"/><parent link="d"/><child link="f"/></joint></robot>"""

SRDF = """<robot name="r"><group name="arm"><joint name="j"/></group><group name="all"><group name="arm"/>
<link name="d"/></group><group name="way"><chain base_link="a" tip_link="d"/></group>
<group_state name="home" group="arm"><joint name="j" value="0.3"/></group_state>
<group_state name="rest"><joint name="j" value="0.2"/></group_state>
<disable_collisions link1="a" link2="b" reason="Adjacent"/><enable_collisions link1="d" link2="b" reason="x"/>
<disable_default_collisions link="d"/><end_effector name="e" parent_link="b" group="arm"/>
<joint_property joint_name="j" property_name="p" value="1"/><gripper name="g"><link name="d"/></gripper>
<virtual_joint name="v" type="fixed" parent_frame="w" child_link="a"/></robot>"""

ROBOT = description("URDF text", URDF)

# -- messages -------------------------------------------------------------------------------------

CART = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/>
<joint name="base" type="planar"><parent link="a"/><child link="b"/></joint>
<joint name="j" type="prismatic"><parent link="b"/><child link="c"/><limit lower="-1" upper="1" velocity="1"/></joint>
</robot>"""
STAMP = {"frame_id": "", "stamp": {"sec": 5, "nanosec": 0}}
UNMOVED = {"translation": {"x": 0.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
TWIST = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
JOINTS = {
    "header": STAMP,
    "joint_names": ["j"],
    "points": [
        {
            "positions": [0.5 * t],
            "velocities": [0.1],
            "accelerations": [0.2],
            "effort": [1.0],
            "time_from_start": {"sec": t, "nanosec": 500},
        }
        for t in range(2)
    ],
}
BASE = {
    "header": STAMP,
    "joint_names": ["base"],
    "points": [
        {
            "transforms": [UNMOVED],
            "velocities": [TWIST],
            "accelerations": [TWIST],
            "time_from_start": {"sec": t, "nanosec": 500},
        }
        for t in range(2)
    ],
}
BOTH = {"joint_trajectory": JOINTS, "multi_dof_joint_trajectory": BASE}
STATE = {
    "joint_state": {"header": STAMP, "name": ["j"], "position": [0.0], "velocity": [0.0], "effort": [0.0]},
    "multi_dof_joint_state": {
        "header": STAMP,
        "joint_names": ["base"],
        "transforms": [UNMOVED],
        "twist": [TWIST],
        "wrench": [],
    },
    "attached_collision_objects": [],
    "is_diff": False,
}
DISPLAY = {"model_id": "r", "trajectory_start": STATE, "trajectory": [BOTH]}
GOAL = {
    "goal_id": {"uuid": [1]},
    "goal": {
        "trajectory": JOINTS,
        "multi_dof_trajectory": BASE,
        "path_tolerance": [{"name": "j", "position": 0.0, "velocity": 0.0, "acceleration": 0.0}],
        "component_path_tolerance": [],
        "goal_tolerance": [],
        "component_goal_tolerance": [],
        "goal_time_tolerance": {"sec": 1, "nanosec": 0},
    },
}
SCENE_STATE = {
    "name": "s",
    "robot_state": STATE,
    "robot_model_name": "r",
    "fixed_frame_transforms": [],
    "allowed_collision_matrix": {"entry_names": []},
    "link_padding": [],
    "link_scale": [],
    "object_colors": [],
    "world": {"collision_objects": [], "octomap": {"octomap": {"resolution": 0.0, "data": []}}},
    "is_diff": False,
}
SOLUTION = {
    "task_id": "t",
    "start_scene": SCENE_STATE,
    "sub_solution": [{"info": {"id": 1}}],
    "sub_trajectory": [{"info": {"id": 1}, "execution_info": {}, "trajectory": BOTH, "scene_diff": SCENE_STATE}],
}
LIMITS = {
    "default_velocity_scaling_factor": 0.5,
    "default_acceleration_scaling_factor": 0.5,
    "joint_limits": {
        "j": {
            **{f"has_{kind}_limits": True for kind in ("velocity", "acceleration", "deceleration", "jerk", "position")},
            **{f"max_{kind}": 1.0 for kind in ("velocity", "acceleration", "deceleration", "jerk", "position")},
            "min_position": -0.5,
            "has_soft_limits": True,
            "soft_lower_limit": -0.2,
            "soft_upper_limit": 0.2,
            "has_effort_limits": True,
            "max_effort": 3.0,
            "k_position": 1.0,
            "k_velocity": 1.0,
            "angle_wraparound": False,
        }
    },
}
PLACE = {
    "name": "b",
    "position": [0.0, 0.0, 0.0],
    "orientation_quat_xyzw": [0.0, 0.0, 0.6, 0.8],
    "orientation_euler_xyz": [0.0, 0.0, 1.287],
}
PROBLEMS = {
    "robot": "r",
    "joints": ["j"],
    "problems": {
        "g": [
            {
                "index": 1,
                "problem": "g",
                "start": [0.0],
                "goals": [[1.0]],
                "valid": True,
                "box": [{**PLACE, "half_extents": [1.0, 1.0, 1.0]}],
                "sphere": [{**PLACE, "name": "s", "radius": 1.0}],
                "cylinder": [{**PLACE, "name": "c", "radius": 1.0, "length": 1.0}],
            }
        ]
    },
}
SCENE = {
    "margin": 0.01,
    "bodies": {
        "t": {"box": [1.0, 1.0, 1.0], "position": [1.0, 0.0, 0.0], "rpy": [0.0, 0.0, 0.1], "margin": 0.02},
        "c": {"cylinder": {"radius": 0.1, "length": 0.2}, "quaternion_wxyz": [0.8, 0.0, 0.0, 0.6]},
        "h": {"sphere": {"radius": 0.1}, "attach": {"link": "l", "touch": ["m"], "leave": ["t"], "reach": ["c"]}},
        "f": {"sphere": {"radius": 0.1}, "follow": {"poses": [{"time": 0.0}, {"time": 1.0}], "repeat": False}},
        "u": {"half_space": {"normal": [0.0, 0.0, 1.0], "offset": -9.0, "extent": 5.0}},
    },
    "allow": [["t", "c"]],
    "margins": [["t", "c", 0.05], {"of": ["t"], "margin": 0.1, "against": "links", "lower": True}],
}


DATA = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4").tobytes()
DATA += np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], "<u2").tobytes()
GLTF = {
    "asset": {"version": "2.0", "generator": "x"},
    "scene": 0,
    "scenes": [{"name": "s", "nodes": [0]}],
    "nodes": [
        {"name": "n", "translation": [1, 0, 0], "rotation": [0, 0, 0.6, 0.8], "scale": [1, 2, 1], "children": [1]},
        {"mesh": 0, "extras": {"x": 1}},
    ],
    "meshes": [{"name": "m", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4, "material": 0}]}],
    "materials": [{"name": "red"}],
    "accessors": [
        {"bufferView": 0, "byteOffset": 0, "componentType": 5126, "count": 4, "type": "VEC3", "normalized": False},
        {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
    ],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 48, "byteStride": 12},
        {"buffer": 0, "byteOffset": 48, "byteLength": 24},
    ],
    "buffers": [{"byteLength": 72, "uri": f"data:application/octet-stream;base64,{base64.b64encode(DATA).decode()}"}],
}


def as_named(name: str, read: Callable[[Path], object]) -> Callable[[Path], object]:
    """Give a file another name, with the ending that its format has, and read it."""
    return lambda path: read(path.replace(path.with_name(name)))


def points(path: Path) -> object:
    return planners.ControllerPoints.load_all(path, robot=Robot.from_urdf(text=CART))


def limits(path: Path) -> object:
    return planners.JointLimits.load(path, Robot.from_urdf(text=CART))


def of_messages(sample: object, *harmless: str) -> dict[str, Format]:
    """Formats of a message in JSON and in YAML."""
    return {
        ending: Format(json.dumps(sample), as_named(f"m.{ending}", points), json_mutants, harmless)
        for ending in ("json", "yaml")
    }


HEADERS = r"(.*/)?header"
MESSAGES = {
    f"{name}, {ending}": form
    for name, sample, harmless in (
        ("DisplayTrajectory", DISPLAY, (HEADERS, r".*/multi_dof_joint_state/twist")),
        ("a goal", GOAL, (HEADERS, "goal_id", "goal/goal_time_tolerance")),
        ("Solution", SOLUTION, (HEADERS, r".*/multi_dof_joint_state/twist", "sub_solution",
                                "sub_trajectory/(execution_)?info",
                                "(start_scene|sub_trajectory/scene_diff)/allowed_collision_matrix")),
    )
    for ending, form in of_messages(sample, *harmless).items()
}  # fmt: skip

FORMATS = MESSAGES | {
    "joint_limits.yaml": Format(json.dumps(LIMITS), as_named("l.yaml", limits), json_mutants, ()),
    "MotionBenchMaker": Format(
        json.dumps(PROBLEMS), read_motion_bench_maker, json_mutants, (), named=("problems/g",)
    ),
    "scene": Format(
        json.dumps(SCENE), as_named("s.yaml", load_scene), json_mutants, (),
        named=("bodies/t", "bodies/c", "bodies/h", "bodies/f", "bodies/u"),
    ),
    "glTF": Format(
        json.dumps(GLTF), as_named("m.gltf", meshes.load), json_mutants,
        ("materials", "nodes/extras", "meshes/primitives/attributes/stranger"),
    ),
    "URDF": Format(
        URDF, description, xml_mutants,
        ("material", "transmission", "sensor", "gazebo", "ros2_control", "link/inertial", "link/visual",
         "joint/dynamics", "joint/calibration"),
        ("link/collision",),
    ),
    "SRDF": Format(
        SRDF, lambda path: read_srdf(path, ROBOT), xml_mutants,
        ("end_effector", "gripper"),
        ("group/joint", "group/link", "group/chain", "group/group", "disable_collisions", "enable_collisions",
         "disable_default_collisions", "joint_property", "virtual_joint"),
    ),
}  # fmt: skip


# Further samples: files in ROS's parameters, problems of several groups, shapes from files, strips without indices.
LIMITS_OF_ROS = {
    "/**": {
        "ros__parameters": {
            "robot_description_planning": {"joint_limits": {"j": {"has_velocity_limits": False, "max_velocity": 2.0}}}
        }
    }
}
SPHERE = {"name": "s", "position": [1.0, 0.0, 0.0], "radius": 0.5}
MORE_PROBLEMS = {
    "robot": "r",
    "joints": ["j", "k"],
    "problems": {
        "g": [{"index": 2, "start": [0.0, 1.0], "goals": [[1.0, 0.0], [2.0, 0.0]], "sphere": [SPHERE]}],
        "h": [{"index": 1, "start": [0.0, 1.0], "goals": [], "cylinder": []}],
    },
}
SCENE_OF_FILES = {
    "bodies": {
        "a": {"cloud": {"file": "points.npy", "radius": 0.1}},
        "b": {"voxels": {"file": "voxels.npy", "size": 0.1, "origin": [0.0, 1.0, 0.0]}, "pose": np.eye(4).tolist()},
        "c": {"height_field": {"file": "heights.npy", "spacing": [0.1, 0.2], "base": -1.0}},
        "d": {"mesh": "part.obj", "scale": [1.0, 1.0, 2.0], "model": "surface", "radius": 0.01, "solid": False},
        "e": {"mesh": "part.obj", "decompose": False},
        "f": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]},
        "g": {"spheres": [[0, 0, 0, 1]]},
        "h": {"boxes": [[0, 0, 0, 1, 1, 1]]},
        "i": {"ellipsoid": [1.0, 2.0, 3.0]},
        "k": {"cone": {"radius": 0.1, "length": 0.2}},
        "l": {"capsule": {"radius": 0.1, "length": 0.2}},
    },
    "leave": [["a", "e"]],
    "reach": [["b", "e"]],
}
STRIPS = {
    "asset": {"version": "2.0"},
    "extensionsUsed": ["KHR_materials_unlit"],
    "scenes": [{"nodes": [0]}],
    "nodes": [{"matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 0, 0, 1], "mesh": 0}],
    "meshes": [
        {"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}, {"attributes": {"POSITION": 0}, "mode": 6}]}
    ],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]}
    ],
    "bufferViews": [{"buffer": 0, "byteLength": 48}],
    "buffers": [{"byteLength": 72, "uri": f"data:application/octet-stream;base64,{base64.b64encode(DATA).decode()}"}],
}


def scene_with_files(path: Path) -> object:
    """Read a scene beside the files that it names."""
    part = path.with_name("part.obj")
    if not part.exists():
        np.save(path.with_name("points.npy"), np.eye(3))
        np.save(path.with_name("voxels.npy"), np.ones((1, 1, 2), dtype=bool))
        np.save(path.with_name("heights.npy"), np.zeros((2, 2)))
        part.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return as_named("s.yaml", load_scene)(path)


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<contributor><author>a</author></contributor><created>c</created><unit name="cm" meter="0.01"/><up_axis>Z_UP</up_axis>
</asset><library_materials><material id="m"/></library_materials>
<library_geometries><geometry id="g" name="g"><mesh>
<source id="p"><float_array id="f" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#f" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="2" material="m"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3</p></triangles>
<polylist count="2"><input semantic="VERTEX" source="#v" offset="0"/><vcount>3 3</vcount><p>0 3 2 1 2 3</p></polylist>
</mesh></geometry></library_geometries>
<library_nodes><node id="o"><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="s"><node id="n" name="n"><translate>1 0 0</translate><rotate>0 0 1 30</rotate>
<scale>1 2 1</scale><matrix>1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#g"/>
<node><instance_node url="#o"/></node></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""

MJCF = """<mujoco model="m"><compiler angle="radian"/><option gravity="0 0 -1"/>
<default><geom friction="1 1 1"/><default class="c"><geom size="0.2"/></default></default>
<asset><mesh name="t" vertex="0 0 0 1 0 0 0 1 0 0 0 1" scale="1 1 2"/><material name="red"/></asset>
<worldbody><light/><camera/><site/><geom type="plane" size="1 1 1" pos="0 0 -1"/>
<body name="a" pos="1 0 0" quat="0.8 0 0 0.6"><joint name="j" axis="0 1 0" range="-1 1" ref="0.1" pos="0 0 0.1"/>
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<geom class="c" pos="0.1 0 0" euler="0 0 1"/><geom type="mesh" mesh="t"/>
<body name="b"><joint name="k" type="slide"/><geom type="box" size="0.1 0.1 0.1" contype="2" conaffinity="2"/></body>
</body></worldbody><contact><exclude body1="a" body2="b"/></contact>
<keyframe><key name="home" qpos="0.5 0.1"/></keyframe></mujoco>"""

FORMATS |= {
    "joint_limits.yaml of ROS": Format(
        json.dumps(LIMITS_OF_ROS), as_named("l.yaml", limits), json_mutants,
        (), named=("**", "**/ros__parameters", "**/ros__parameters/robot_description_planning"),
    ),
    "MotionBenchMaker of two groups": Format(
        json.dumps(MORE_PROBLEMS), read_motion_bench_maker, json_mutants, (), named=("problems/g", "problems/h")
    ),
    "scene of files": Format(
        json.dumps(SCENE_OF_FILES), scene_with_files, json_mutants, (),
        named=tuple(f"bodies/{name}" for name in SCENE_OF_FILES["bodies"]),
    ),
    "glTF of strips": Format(
        json.dumps(STRIPS), as_named("m.gltf", meshes.load), json_mutants, ("meshes/primitives/attributes/stranger",)
    ),
    "Collada": Format(
        COLLADA, as_named("m.dae", meshes.load), xml_mutants,
        # Objects are found by their identifiers, in whatever library.
        ("asset/contributor", "asset/created", "asset/up_axis", "library_materials",
         r"library_\w+(/text|/stranger|@stranger)?$", r"library_geometries/geometry/mesh(/text|@stranger)"),
        tuple(f"library_visual_scenes/visual_scene/node{part}" for part in (
            "", "/instance_geometry", "/matrix", "/rotate", "/scale", "/translate", "/node", "/node/instance_node",
        )) + ("library_nodes/node/instance_geometry",),
    ),
    # MuJoCo refuses elements and attributes that it does not know, and passes over text, which no element has.
    "MJCF": Format(
        MJCF, as_named("m.xml", Robot.from_mjcf), xml_mutants, (r".*/text$",),
        ("compiler", "option", "contact", "contact/exclude", "worldbody/body/geom", "worldbody/geom",
         "worldbody/camera", "worldbody/light", "worldbody/site"),
    ),
}  # fmt: skip

BALL, FLAT = {"center": [0, 0, 1], "radius": 0.5}, {"mean": 0, "best": 0, "worst": 0}
CUROBO = {
    "robot_cfg": {
        "kinematics": {
            "urdf_path": "cart.urdf",
            "cspace": {"joint_names": ["rail"]},
            "collision_link_names": ["cart", "wheel"],
            "collision_sphere_buffer": {"cart": 0.5},
            "collision_spheres": {"cart": [BALL, BALL]},
            "self_collision_ignore": {"cart": ["wheel"]},
            "self_collision_buffer": {"cart": 0},
        }
    }
}
XRDF = {
    "format": "xrdf",
    "collision": {"geometry": "a", "buffer_distance": {"cart": 0.5}},
    "self_collision": {"geometry": "a", "ignore": {"cart": ["wheel"]}, "buffer_distance": {"cart": 0}},
    "geometry": {"a": {"spheres": {"cart": [BALL]}}},
}
PYROKI = {"cart": {"centers": [[0, 0, 1], [0, 1, 0]], "radii": [0.5, 0.25]}}
FOAM = {"cart::a.stl": {"8": {"1": FLAT | {"spheres": [{"origin": [0, 0, 1], "radius": 0.5}]}}}}
COVERED = """<robot name="r"><link name="base"/>
<link name="cart"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="wheel"/>
<joint name="rail" type="fixed"><parent link="base"/><child link="cart"/></joint>
<joint name="hub" type="fixed"><parent link="cart"/><child link="wheel"/></joint></robot>"""


def spheres(path: Path) -> object:
    return Robot.from_urdf(text=COVERED).with_cover(path)


FORMATS |= {
    "cuRobo": Format(
        json.dumps(CUROBO),
        as_named("c.yml", spheres),
        json_mutants,
        ("robot_cfg/kinematics/cspace", "robot_cfg/kinematics/self_collision_buffer"),
    ),
    "XRDF": Format(json.dumps(XRDF), as_named("c.xrdf", spheres), json_mutants, ("self_collision/buffer_distance",)),
    "pyroki": Format(json.dumps(PYROKI), as_named("c.json", spheres), json_mutants, ()),
    "foam": Format(json.dumps(FOAM), as_named("c.json", spheres), json_mutants, (), named=("cart::a.stl",)),
}

# YAML is read much more slowly than JSON; the others of these are the longest.
LONG = {"DisplayTrajectory, yaml", "Solution, yaml", "a goal, yaml", "a goal, json", "Solution, json", "scene of files"}


@pytest.mark.parametrize(
    "form",
    [pytest.param(form, id=name, marks=[pytest.mark.verify] * (name in LONG)) for name, form in FORMATS.items()],
)
@pytest.mark.parametrize("every", quick(7, 1))
def test_no_part_of_a_file_is_dropped_without_a_word(form, every, tmp_path):
    """Only what is listed may be renamed, doubled or joined by a stranger: the list is complete, and no longer."""
    if form.sample == MJCF:
        pytest.importorskip("mujoco")
    quiet = without_a_word(form, tmp_path / "file", every)
    harmless = {(what, part) for what, part in quiet if any(re.match(rf"{name}\b", part) for name in form.harmless)}
    repeated = {(what, part) for what, part in quiet if what == "doubled" and part in form.repeated}
    named = {(what, part) for what, part in quiet if what == "renamed" and part in form.named}
    assert quiet - harmless - repeated - named == set()
    if every > 1:
        return  # others are in the list for parts that were not tried
    assert {part for _, part in repeated} == set(form.repeated)
    assert {part for _, part in named} == set(form.named)
    assert all(any(re.match(rf"{name}\b", part) for _, part in harmless) for name in form.harmless)


# Files of example-robot-data, by format: three of several authors each. A mutant of each kind of part is tried.
OF_OTHERS = {
    "URDF": ("panda_description/urdf/panda", "so_arm_description/urdf/so100", "z1_description/urdf/z1",
             "laikago_description/urdf/laikago"),
    "SRDF": ("panda_description/srdf/panda", "centauro_description/srdf/centauro", "ur_description/srdf/ur5_gripper"),
    "Collada": ("anymal_c_simple_description/meshes/battery", "romeo_description/meshes/V1/collision/LWristYaw",
                "hyq_description/meshes/leg/lowerleg"),
}  # fmt: skip
ENDINGS = {"URDF": ".urdf", "SRDF": ".srdf", "Collada": ".dae"}
ALSO_HARMLESS = {
    "URDF": (),
    "SRDF": (),
    "Collada": ("library_(effects|images|lights|cameras|animations)", "asset/(modified|revision|title|keywords)",
                r".*/bind_material", r".*/extra"),
}  # fmt: skip
LARGE = ("so_arm_description/urdf/so100", "z1_description/urdf/z1", "laikago_description/urdf/laikago",
         "anymal_c_simple_description/meshes/battery", "romeo_description/meshes/V1/collision/LWristYaw",
         "hyq_description/meshes/leg/lowerleg")  # fmt: skip


@pytest.mark.parametrize(
    ("format", "name"),
    [
        pytest.param(key, name, marks=[pytest.mark.verify] * (name in LARGE))
        for key, names in OF_OTHERS.items()
        for name in names
    ],
)
@pytest.mark.parametrize("every", quick(7, 1))
def test_files_of_other_projects_are_read_in_whole(format, name, every, tmp_path):
    """Nothing but the harmless parts, and parts that may occur several times, changes without a word."""
    path = robots_folder() / f"{name}{ENDINGS[format]}"
    form = FORMATS[format]._replace(
        sample=path.read_text(encoding="utf-8"),
        mutants=partial(xml_mutants, once=True),
    )
    if format == "SRDF":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the URDF alone
            robot = description(next((path.parents[1]).rglob(f"{path.stem}.urdf")))
        form = form._replace(read=lambda file: read_srdf(file, robot))
    quiet = without_a_word(form, tmp_path / "file", every)
    listed = (*form.harmless, *ALSO_HARMLESS[format])
    assert {
        (what, part)
        for what, part in quiet
        if not any(re.match(rf"{name}\b", part) for name in listed) and (what != "doubled" or part not in form.repeated)
    } == set()
