"""Every reader of files by its format: small valid files that the library wrote or that people have, and the call."""

from __future__ import annotations

import contextlib
import io
import re
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mesh_examples
import test_description_files as descriptions
from loewner import Body, CollisionChecker, Robot, Scene, cli, load_scene, planners, read_motion_bench_maker
from loewner.cli import configurations, judge_answers, report
from loewner.meshes import decomposition as meshes

SLIDER = """<robot name="slider"><link name="base"/>
<link name="cart"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"""
MJCF = """<mujoco model="m"><compiler angle="radian"/><default><geom margin="0.01"/><default class="g">
<geom size="0.1"/></default></default><asset><mesh name="t" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody>
<geom type="plane" size="1 1 1"/><body name="a" pos="0 0 1" euler="0 0 1">
<joint name="h" type="hinge" axis="0 1 0" range="-1 1"/>
<geom class="g" type="sphere"/><geom type="mesh" mesh="t"/><body name="b"><joint name="s" type="slide" range="0 1"/>
<geom type="capsule" fromto="0 0 0 0 0 1" size="0.05"/></body></body></worldbody>
<contact><exclude body1="a" body2="b"/></contact><keyframe><key name="home" qpos="0.1 0.2"/></keyframe></mujoco>"""


class Reader(NamedTuple):
    """Files of one format, the suffix that says so, and what reads one."""

    seeds: Callable[[], list[bytes]]
    suffix: str
    read: Callable[[Path], Any]


@cache
def slider() -> CollisionChecker:
    return CollisionChecker(Robot.from_urdf(text=SLIDER), Scene())


def _written(name: str, write: Callable[[Path], Any]) -> bytes:
    """What is in a file that is written under a name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        write(path)
        return path.read_bytes()


_examples = cache(mesh_examples.examples)


def _meshes(suffix: str) -> list[bytes]:
    return [next(iter(files.values())) for files, of in _examples().values() if of == suffix and len(files) == 1]


def _bodies() -> list[bytes]:
    ring = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    surface = Body.from_surface((ring, [[0, 1, 2], [0, 3, 1]]), solid=False)
    union = Body.union([Body.box([1, 1, 1]), Body.sphere(0.5), Body.cone(0.5, 1.0)])
    return [_written("b.npz", body.save) for body in (union, surface)]


def _arrays() -> list[bytes]:
    arrays = (np.eye(4)[:, :1], np.arange(3.0)[:, None], np.zeros((2, 3), "f4"), np.ones((2, 2, 2), bool))
    return [_written("a.npy", lambda path, array=array: np.save(path, array)) for array in arrays]


def _trajectory(suffix: str) -> list[bytes]:
    moved = [planners.trajectory(slider().robot, [[0.0], [0.5]], acceleration=1.0, jerk=jerk) for jerk in (None, 9.0)]
    return [_written("t" + suffix, each.save) for each in moved]


LIMITS = b"""default_velocity_scaling_factor: 0.1
joint_limits:
  rail: {has_velocity_limits: true, max_velocity: 2.5, has_jerk_limits: false, max_acceleration: 3, max_position: 1}
"""


MOVES = b'{"joint_names": ["rail"], "points": [{"positions": [0], "time_from_start": {"sec": 0, "nanosec": 0}}, \
{"positions": [0.5], "velocities": [], "time_from_start": {"sec": 1, "nanosec": 5}}]}'
EMPTY = b'{"joint_names": [], "points": []}'
STATE = b'{"joint_state": {"name": ["rail"], "position": [0]}, "multi_dof_joint_state": {"joint_names": ["b"], \
"transforms": [{"translation": {"x": 0, "y": 0, "z": 0}, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}]}, \
"attached_collision_objects": []}'
MESSAGES = [
    MOVES,
    b'{"trajectory": [{"joint_trajectory": %b, "multi_dof_joint_trajectory": %b}], "trajectory_start": %b}'
    % (MOVES, EMPTY, STATE),
    b'{"start_scene": {"robot_state": %b, "world": {"collision_objects": [{"id": "wall"}]}}, "sub_trajectory": \
[{"trajectory": {"joint_trajectory": %b}}, {"trajectory": {"joint_trajectory": %b}}]}'
    % (STATE, EMPTY, MOVES),
    b'{"joint_trajectory": %b, "attached": {"link_name": "cart", "object": {"id": "pole"}}}' % MOVES,
]


def _points(path: Path) -> Any:
    return planners.ControllerPoints.load(path, robot=slider().robot)


def _roadmap() -> list[bytes]:
    return [_written("r.npz", planners.roadmap(slider(), 4).save)]


def _octree() -> list[bytes]:
    import octomap

    tree = octomap.OcTree(0.1)
    tree.insertPointCloud(np.random.default_rng(0).uniform(size=(4, 3)), np.array([0.5, 0.5, 1.5]))
    return [_written("o.bt", lambda path: tree.writeBinary(str(path).encode()))]


def _beside(shape: str) -> Callable[[Path], Any]:
    """Read a scene in which a file is a shape."""

    def read(path: Path) -> Any:
        scene = path.with_name("scene.yaml")
        scene.write_text(f"bodies:\n  seen: {{{shape.format(file=path.name)}}}\n")
        return load_scene(scene)

    return read


def _report() -> list[bytes]:
    def write(path: Path) -> None:
        body = path.with_name("part.npz")
        Body.cone(0.5, 1.0).save(body)
        with contextlib.redirect_stdout(io.StringIO()):
            cli.main(["report", "check", str(body), str(body), "-o", str(path)])

    return [_written("r.zip", write)]


def _srdf(path: Path) -> Any:
    urdf = path.with_name("r.urdf")
    urdf.write_text(descriptions.URDF.replace('<mesh filename="part.stl" scale="1 -1 1"/>', '<sphere radius="0.1"/>'))
    return Robot.from_urdf(urdf, srdf=path)


def _configurations(path: Path) -> Any:
    return configurations.read(path, slider().robot)


def _cover(path: Path) -> Any:
    return slider().robot.with_cover(path)


CUROBO = b"""robot_cfg:
  kinematics:
    collision_link_names: [cart]
    collision_sphere_buffer: {cart: 0.005}
    collision_spheres:
      cart:
        - {center: [0, 0, 0.5], radius: 0.1}
        - "center": [0, 1e-3, 0]
          "radius": -1
    self_collision_ignore: {cart: [base]}
    self_collision_buffer: {cart: 0.0}
    cspace: {joint_names: [rail]}
"""
XRDF = b"""format: xrdf
collision: {geometry: a, buffer_distance: {cart: 0.5}}
self_collision: {geometry: a, ignore: {cart: [base]}}
geometry: {a: {spheres: {cart: [{center: [0, 0, 0], radius: 0.5}]}}}
"""
BALLS = [
    b'{"cart": {"centers": [[0, 0, 0], [0.5, 0, 1]], "radii": [0.5, 0.25]}}',
    b'{"cart::a.stl": {"8": {"1": {"mean": 0, "best": 0, "worst": 0, \
"spheres": [{"origin": [0, 0, 1], "radius": 1}]}}}}',
]
CLOUD, HEIGHTS = "cloud: {{file: {file}, radius: 0.1}}", "height_field: {{file: {file}, spacing: [0.1, 0.1]}}"
TABLES = [b"0.5,0.0,1\n1,2,3\n", b"# x y z\n1 2 3\n4e-1 -5 6\n", b"rail\n0.5\n-1\n", b"0.5\n"]
URDF = descriptions.URDF.replace('<mesh filename="part.stl" scale="1 -1 1"/>', '<box size="1 1 1"/>').encode()
SCENE = re.sub(r".*(mesh|saved):.*\n", "", descriptions.YAML).encode()

READERS: dict[str, Reader] = {
    **{
        suffix[1:]: Reader(lambda suffix=suffix: _meshes(suffix), suffix, meshes.load)
        for suffix in (".stl", ".obj", ".ply", ".off", ".gltf", ".glb", ".dae")
    },
    "body": Reader(_bodies, ".npz", Body.load),
    "npy-cloud": Reader(_arrays, ".npy", _beside(CLOUD)),
    "npy-voxels": Reader(_arrays, ".npy", _beside("voxels: {{file: {file}, size: 0.1}}")),
    "npy-configurations": Reader(_arrays, ".npy", _configurations),
    "csv-cloud": Reader(lambda: TABLES, ".csv", _beside(CLOUD)),
    "csv-heights": Reader(lambda: TABLES, ".csv", _beside(HEIGHTS)),
    "csv-configurations": Reader(lambda: TABLES, ".csv", _configurations),
    "json-configurations": Reader(
        lambda: [b"[[0.5], [1]]", b'{"names": ["rail"], "configurations": [[0.5]]}'], ".json", _configurations
    ),
    "csv-answers": Reader(
        lambda: [b"body_a,pose_b,distance,normal\nA,1 2 3,0.5,1 0 0\nB,,nan,\n"], ".csv", judge_answers.table
    ),
    "json-answers": Reader(
        lambda: [b'[{"pose_b": [1, 2, 3], "colliding": true, "depth": null}]'], ".json", judge_answers.table
    ),
    "yaml": Reader(lambda: [SCENE], ".yaml", load_scene),
    "urdf": Reader(lambda: [URDF, SLIDER.encode()], ".urdf", Robot.from_urdf),
    "srdf": Reader(lambda: [descriptions.SRDF.encode()], ".srdf", _srdf),
    "mjcf": Reader(lambda: [MJCF.encode()], ".xml", Robot.from_mjcf),
    "mjcf-scene": Reader(lambda: [MJCF.encode()], ".xml", load_scene),
    "problems": Reader(lambda: [descriptions.JSON.encode()], ".json", read_motion_bench_maker),
    "spheres-yaml": Reader(lambda: [CUROBO, XRDF], ".yml", _cover),
    "spheres-json": Reader(lambda: BALLS, ".json", _cover),
    "octree": Reader(_octree, ".bt", Body.from_octree),
    "report": Reader(_report, ".zip", report.rerun),
    "roadmap": Reader(_roadmap, ".npz", lambda path: planners.Roadmap.load(path, slider())),
    "trajectory-csv": Reader(lambda: _trajectory(".csv"), ".csv", planners.Trajectory.load),
    "joint-limits": Reader(lambda: [LIMITS], ".yaml", lambda path: planners.JointLimits.load(path, slider().robot)),
    "message-json": Reader(lambda: MESSAGES, ".json", _points),
    "message-yaml": Reader(lambda: MESSAGES, ".yaml", _points),
    "trajectory-json": Reader(lambda: _trajectory(".json"), ".json", planners.Trajectory.load),
}
