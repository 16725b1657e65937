"""Read MotionBenchMaker planning problems from JSON; `docs/scenes.md` describes the format."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike

import numpy as np

from loewner._base import _validate
from loewner._base._files import read_regular
from loewner._base._guard import guarded
from loewner._base._nodes import JsonNode, cut, read_json
from loewner._base._plausible import doubt_about_rpy, warn
from loewner._base._rotations import from_quaternion, from_rpy
from loewner._base._validate import Floats
from loewner.bodies import Body
from loewner.scenes.scene import Scene

# Largest size of a file that is read [bytes].
MOST_BYTES = 2**28

# If an obstacle has both a quaternion and angles, the entries of the two rotation matrices may differ by this much,
# because numbers in files have few digits.
SAME_ROTATION = 1e-2

TOP_KEYS = ("robot", "joints", "problems")
PROBLEM_KEYS = ("sphere", "box", "cylinder", "index", "problem", "start", "goals", "valid")
NEEDED_KEYS = ("index", "start", "goals")
OBSTACLE_KEYS = {"sphere": ("radius",), "box": ("half_extents",), "cylinder": ("radius", "length")}
PLACE_KEYS = ("position", "orientation_quat_xyzw", "orientation_euler_xyz")


@guarded
@dataclass(frozen=True, eq=False)
class Problem:
    """A motion planning problem: a scene, a start and goals.

    Attributes
    ----------
    group : str
        The group to which the problem belongs, such as "bookshelf_thin".
    index : int
        Index of the problem within its group, as in the file.
    robot : str
        Name of the robot.
    joint_names : tuple of str
        Names of the columns of `start` and `goals`.
    start : ndarray, shape (dof,)
        Start configuration, in radians or metres.
    goals : ndarray, shape (k, dof)
        Goal configurations; a solution has to reach any one of them.
    scene : Scene
        Obstacles, in the frame of the robot's base.
    valid : bool or None
        Whether the file calls the problem valid; None if the file has no such entry. The entry is not checked.

    Examples
    --------
    >>> (problem,) = read_motion_bench_maker("problems.json")
    >>> problem.group, problem.start, problem.scene.names
    ('shelf', array([0., 0.]), ('board',))
    """

    group: str
    index: int
    robot: str
    joint_names: tuple[str, ...]
    start: Floats
    goals: Floats
    scene: Scene
    valid: bool | None


@guarded
def read_motion_bench_maker(path: str | PathLike[str]) -> tuple[Problem, ...]:
    """Read planning problems from MotionBenchMaker's data in JSON (docs/scenes.md).

    Parameters
    ----------
    path : path
        A file with the keys ``robot``, ``joints`` and ``problems``; ``problems`` maps each group to a list of problems.

    Returns
    -------
    tuple of Problem
        The problems, in the order of the file. Obstacles of the same kind and size share one `Body`.

    Raises
    ------
    FileError
        If the file is missing or malformed, or contains obstacles of an unknown kind. The message names the problem and
        the key.

    References
    ----------
    Chamzas, Quintero-Peña, Kingston, Orthey, Rakita, Gleicher, Toussaint and Kavraki (2022), "MotionBenchMaker: a
    tool to generate and benchmark motion planning datasets", IEEE Robot. Autom. Lett. 7(2),
    doi:10.1109/LRA.2021.3133603.

    Examples
    --------
    >>> [(problem.group, problem.index) for problem in read_motion_bench_maker("problems.json")]
    [('shelf', 1)]
    """
    file = _validate.path(path, "path")
    what = "problems in JSON"
    top = read_json(read_regular(file, what, MOST_BYTES), file, what).mapping(TOP_KEYS, required=TOP_KEYS)
    robot, joints, groups = (top[key] for key in ("robot", "joints", "problems"))
    name, names = robot.text(), tuple(joint.text() for joint in joints.items())
    for joint, count in Counter(names).most_common(1):
        if count > 1:
            raise joints.error(f"expected each joint once, found {cut(repr(joint))} again")
    make = functools.cache(_obstacle)
    return tuple(
        _problem(node, group, name, names, make)
        for group, listed in groups.mapping(None).items()
        for node in listed.items()
    )


def _problem(node: JsonNode, group: str, robot: str, joints: tuple[str, ...], make: Callable[..., Body]) -> Problem:
    keys = node.mapping(PROBLEM_KEYS, required=NEEDED_KEYS)
    scene = Scene()
    for kind in OBSTACLE_KEYS:
        for obstacle in keys[kind].items() if kind in keys else []:
            _add(scene, kind, obstacle, make)
    goals = [goal.numbers(len(joints)) for goal in keys["goals"].items()]
    return Problem(
        group=group,
        index=keys["index"].whole(),
        robot=robot,
        joint_names=joints,
        start=np.array(keys["start"].numbers(len(joints))),
        goals=np.array(goals).reshape(-1, len(joints)),
        scene=scene,
        valid=keys["valid"].flag() if "valid" in keys else None,
    )


def _add(scene: Scene, kind: str, node: JsonNode, make: Callable[..., Body]) -> None:
    """Add one obstacle of a file to the scene."""
    sizes = OBSTACLE_KEYS[kind]
    keys = node.mapping(("name", *sizes, *PLACE_KEYS), required=("name", "position", *sizes))
    lengths = keys["half_extents"].numbers(3) if kind == "box" else [keys[size].number() for size in sizes]
    name, T = keys["name"].text(), _pose(keys)
    with node.blamed():
        scene.add(name, make(kind, *lengths), T)


def _obstacle(kind: str, *sizes: float) -> Body:
    if kind == "box":
        return Body.box([2 * half for half in sizes])
    return Body.sphere(*sizes) if kind == "sphere" else Body.cylinder(*sizes)


def _pose(keys: dict[str, JsonNode]) -> Floats:
    """Read the pose of an obstacle; if both a quaternion and angles are given, the quaternion is used."""
    T = np.eye(4)
    T[:3, 3] = keys["position"].numbers(3)
    angles = keys.get("orientation_euler_xyz")
    if angles is not None:
        rpy = angles.numbers(3)
        T[:3, :3] = from_rpy(*rpy)
        doubt = doubt_about_rpy(rpy)
        if doubt:
            warn(f"{angles.file}: {angles.key}: expected {doubt}")
    if "orientation_quat_xyzw" in keys:
        node = keys["orientation_quat_xyzw"]
        *xyz, w = node.numbers(4)
        with node.blamed():
            R = from_quaternion([w, *xyz], "quaternion")
        if angles is not None and np.abs(R - T[:3, :3]).max() > SAME_ROTATION:
            raise angles.error(f"expected the rotation of the quaternion {[*xyz, w]}, found {angles.numbers(3)}")
        T[:3, :3] = R
    return T
