"""Scenes in files: our own format in YAML, and the planning problems of MotionBenchMaker in JSON.

A file is read whole or refused: an obstacle that is skipped is one that a robot drives into. So every key must be
known, and every fault is named with file, line and key. `docs/scenes.md` describes both formats.
"""

from __future__ import annotations

import functools
import json
import math
import re
import reprlib
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from loewner import _validate
from loewner._files import read_regular, replacing
from loewner._guard import guarded
from loewner._plausible import doubt_about_rpy, warn
from loewner._rotations import from_quaternion, from_rpy
from loewner._validate import Floats
from loewner.bodies import ARRAYS, Body
from loewner.errors import FileError, InputError, MissingExtraError, installing
from loewner.scenes import Scene

Maker = Callable[..., Body]

# What a file may have at most: bytes; entries, those that an alias stands for counted each time; and how deep they are
# nested. A scene of a hundred thousand boxes has half of it. YAML is read at some seconds a megabyte.
MOST_YAML_BYTES = 2**24
MOST_JSON_BYTES = 2**28
MOST_ENTRIES = 2_000_000
DEEPEST = 50

# Keys that a message lists at most.
LISTED = 30

TOP_KEYS = ("margin", "bodies", "allow", "margins")
POSE_KEYS = ("position", "rpy", "quaternion_wxyz", "pose")
BODY_KEYS = (*POSE_KEYS, "attach", "margin")
MESH_KEYS = ("scale", "decompose")

# Shapes given by lengths along the axes, and shapes given by named lengths.
AXIS_SHAPES: dict[str, Maker] = {"box": Body.box, "ellipsoid": Body.ellipsoid}
ROUND_SHAPES: dict[str, tuple[Maker, tuple[str, ...]]] = {
    "sphere": (Body.sphere, ("radius",)),
    "cylinder": (Body.cylinder, ("radius", "length")),
    "capsule": (Body.capsule, ("radius", "length")),
    "cone": (Body.cone, ("radius", "length")),
}
SHAPES = (*AXIS_SHAPES, *ROUND_SHAPES, "points", "mesh", "saved")

# What YAML calls the plain values; another tag asks for something that a scene has no place for.
YAML_TAGS = tuple(
    f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp")
)


@guarded
def load_scene(path: str | PathLike[str]) -> Scene:
    """Read a scene from YAML (docs/scenes.md).

    Parameters
    ----------
    path : path
        Files that it names are looked for relative to its folder.

    Returns
    -------
    Scene

    Raises
    ------
    FileError
        If the file, or one that it names, is missing or malformed. The message gives line and key.
    MissingExtraError
        If PyYAML is not installed, or what a mesh needs.

    Warns
    -----
    UserWarning
        If a body seems not to be in metres, or an angle not in radians.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("table.yaml").write_text("bodies: {table: {box: [1, 1, 0.1], position: [0, 0, 0.5]}}")
    >>> load_scene("table.yaml")
    Scene(1 bodies, 0 of them attached)
    """
    file = _validate.path(path, "path")
    root = _Entry(file, "", _composed(file))
    top = root.mapping(TOP_KEYS, required=("bodies",))
    scene = Scene()
    if "margin" in top:
        scene.set_margin(top["margin"].length())
    made: dict[Any, Body] = {}
    for name, entry in top["bodies"].mapping(None).items():
        _add(scene, name, entry, made)
    for entry in top["allow"].items() if "allow" in top else []:
        with entry.blamed():
            scene.allow(*(item.text() for item in entry.items(2)))
    for entry in top["margins"].items() if "margins" in top else []:
        *names, margin = entry.items(2, 3)
        with entry.blamed():
            scene.set_margin(margin.length(), *(item.text() for item in names))
    return scene


@guarded
def save_scene(scene: Scene, path: str | PathLike[str]) -> None:
    """Write a scene to YAML, such that `load_scene` gives the same verdicts.

    Boxes, spheres, cylinders, capsules, cones and ellipsoids are written by their sizes. Any other body is saved
    next to the file, as ``STEM-NAME.npz``; a body that several names share is saved once.

    Parameters
    ----------
    scene : Scene
    path : path
        Written under a temporary name first, then renamed, after the files of its bodies.

    Raises
    ------
    FileError
        If a file could not be written.
    MissingExtraError
        If PyYAML is not installed.

    Examples
    --------
    >>> from loewner import Body
    >>> scene = Scene(margin=0.01)
    >>> scene.add("ball", Body.sphere(0.1))
    >>> save_scene(scene, "ball.yaml")
    >>> load_scene("ball.yaml").margin
    0.01
    """
    yaml = _yaml()
    if not isinstance(scene, Scene):
        raise InputError(f"scene: expected loewner.Scene, found {type(scene).__name__}")
    file = _validate.path(path, "path")
    saved: dict[int, str] = {}
    bodies = {}
    for name in scene:
        bodies[name] = {**_shape_of(scene[name], name, file, saved), **_place_of(scene, name)}
        if (name,) in scene.margins:
            bodies[name]["margin"] = scene.margins[(name,)]
    document: dict[str, Any] = {"margin": scene.margin, "bodies": bodies}
    if scene.allowed:
        document["allow"] = [list(pair) for pair in sorted(scene.allowed)]
    margins = [[*names, margin] for names, margin in scene.margins.items() if names[0] not in scene or len(names) == 2]
    if margins:
        document["margins"] = margins
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    with replacing(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


# -- reading YAML -----------------------------------------------------------------------------


def _yaml() -> Any:
    try:
        import yaml
    except ImportError:
        raise MissingExtraError(f"scene files need PyYAML: {installing('robots')}") from None
    return yaml


def _composed(file: Path) -> Any:
    """Root node of a YAML file; nodes know their lines, and nothing in the file is run or built."""
    yaml = _yaml()
    data = read_regular(file, "a scene in YAML", MOST_YAML_BYTES)
    try:
        root = yaml.compose(data, Loader=_loader())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise FileError(f"{file}, line {mark.line + 1}: expected YAML, found a fault in it ({error.problem})") from None
    except (
        yaml.YAMLError,
        ValueError,
        OverflowError,
        RecursionError,
    ) as error:  # the last three from escapes and depth
        what = " ".join(str(error).split())[:200]
        raise FileError(f"{file}: expected YAML, found something else ({what})") from None
    if root is None:
        raise FileError(f"{file}: expected a scene in YAML, found an empty file")
    return root


@functools.cache
def _loader() -> Any:
    """The class that reads YAML, made when PyYAML is needed for the first time."""
    yaml = _yaml()
    parent: Any = yaml.SafeLoader

    class Loader(parent):  # type: ignore[misc]
        """Counts what it composes, so that neither depth nor aliases of aliases make more than a file may hold."""

        def __init__(self, data: bytes) -> None:
            super().__init__(data)
            self.depth = self.entries = 0
            self.entries_of: dict[str, int] = {}

        def compose_node(self, above: Any, index: Any) -> Any:
            event = self.peek_event()
            before = self.entries
            self.depth += 1
            self.entries += 1
            if self.depth > DEEPEST:
                self.refuse(f"more than {DEEPEST} entries inside each other", event)
            node = super().compose_node(above, index)
            self.depth -= 1
            if isinstance(event, yaml.AliasEvent):
                # Inside what it stands for, an alias is one entry: no part of a scene is read any deeper.
                self.entries = before + self.entries_of.get(event.anchor, 1)
            elif event.anchor is not None:
                self.entries_of[event.anchor] = self.entries - before
            if self.entries > MOST_ENTRIES:
                self.refuse(f"more than {MOST_ENTRIES} entries, aliases counted each time", event)
            return node

        def refuse(self, what: str, event: Any) -> None:
            raise yaml.composer.ComposerError(None, None, what, event.start_mark)

    return Loader


@dataclass(frozen=True)
class _Entry:
    """A place in a YAML file: what it holds, and how to speak of it.

    Attributes
    ----------
    file : Path
    key : str
        The keys that lead here, joined by "/"; empty at the top.
    node : yaml.Node
    """

    file: Path
    key: str
    node: Any

    def error(self, text: str) -> FileError:
        where = f" {self.key}:" if self.key else ""
        return FileError(f"{self.file}, line {self.node.start_mark.line + 1}:{where} {text}")

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Say where in the file it is that something is wrong with what it says."""
        try:
            yield
        except (InputError, FileError) as error:
            if str(error).startswith(f"{self.file}, line"):
                raise
            raise self.error(str(error)) from None

    def expect(self, kind: str, wanted: str) -> Any:
        """Value of the node if it is of that kind."""
        if self.node.tag not in YAML_TAGS:
            raise self.error(f"expected {wanted}, found the tag {self.node.tag}")
        if self.node.id != kind:
            raise self.error(f"expected {wanted}, found {self.described()}")
        return self.node.value

    def described(self) -> str:
        if self.node.id == "scalar":
            return _cut(repr(self.node.value)) if self.node.value else "nothing"
        return f"a {self.node.id} of {len(self.node.value)}"

    def mapping(self, known: tuple[str, ...] | None, required: tuple[str, ...] = ()) -> dict[str, _Entry]:
        """Entries by key; keys that are not known (None: all are), missing or there twice are errors."""
        found: dict[str, _Entry] = {}
        for key_node, node in self.expect("mapping", "a mapping"):
            at_key = _Entry(self.file, self.key, key_node)
            key = at_key.expect("scalar", "a name as key")
            if known is not None and key not in known:
                raise at_key.error(f"expected keys among {', '.join(known)}, found {_cut(repr(key))}")
            if key in found:
                raise at_key.error(f"expected each key once, found {_cut(repr(key))} again")
            found[key] = _Entry(self.file, f"{self.key}/{key}" if self.key else key, node)
        for key in required:
            if key not in found:
                raise self.error(f"expected the key {key}, found {_some(found) or 'none'}")
        return found

    def items(self, *lengths: int) -> list[_Entry]:
        """Entries of a sequence of one of these lengths (none given: any)."""
        wanted = f"a sequence of {' or '.join(map(str, lengths))}" if lengths else "a sequence"
        nodes = self.expect("sequence", wanted)
        if lengths and len(nodes) not in lengths:
            raise self.error(f"expected {wanted}, found {self.described()}")
        return [_Entry(self.file, f"{self.key}[{i}]", node) for i, node in enumerate(nodes)]

    def text(self) -> str:
        value: str = self.expect("scalar", "a name")
        if not value:
            raise self.error("expected a name, found nothing")
        return value

    def number(self) -> float:
        """A finite number. YAML 1.1 takes 1e-3 for text; here the text decides, unless it is quoted."""
        value = self.expect("scalar", "a number")
        try:
            plain = self.node.style is None and value.isascii() and "_" not in value
            number = float(value) if plain else math.nan
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise self.error(f"expected a finite number, found {self.described()}")
        return number

    def length(self) -> float:
        """A number of metres, not negative."""
        number = self.number()
        if number < 0:
            raise self.error(f"expected a number of metres >= 0, found {number:g}")
        return number

    def flag(self) -> bool:
        value = str(self.expect("scalar", "true or false")).lower()
        if value not in ("true", "false"):
            raise self.error(f"expected true or false, found {self.described()}")
        return value == "true"

    def numbers(self, length: int) -> list[float]:
        return [item.number() for item in self.items(length)]

    def rows(self, length: int) -> list[list[float]]:
        return [row.numbers(length) for row in self.items()]


def _add(scene: Scene, name: str, entry: _Entry, made: dict[Any, Body]) -> None:
    """Add one body of a file to the scene; `made` keeps those that were made already, by their recipe."""
    keys = entry.mapping(None)
    shapes = [key for key in keys if key in SHAPES]
    if len(shapes) != 1:
        found = " and ".join(shapes) or _some(keys) or "nothing"
        raise entry.error(f"expected one shape among {', '.join(SHAPES)}; found {found}")
    known = (*shapes, *BODY_KEYS, *(MESH_KEYS if shapes == ["mesh"] else ()))
    keys = entry.mapping(known)
    recipe, make = _recipe(shapes[0], keys)
    with keys[shapes[0]].blamed():
        if recipe not in made:
            made[recipe] = make()
    T = _pose(entry, keys)
    margin = keys["margin"].length() if "margin" in keys else None
    with entry.blamed():
        scene.add(name, made[recipe], None if "attach" in keys else T, margin=margin)
        if "attach" in keys:
            attach = keys["attach"].mapping(("link", "touch"), required=("link",))
            touch = [item.text() for item in attach["touch"].items()] if "touch" in attach else []
            scene.attach(name, attach["link"].text(), T, touch_links=touch)


def _recipe(shape: str, keys: dict[str, _Entry]) -> tuple[Any, Callable[[], Body]]:
    """What tells the body apart from others, and how to make it."""
    entry = keys[shape]
    if shape in AXIS_SHAPES:
        axes = entry.numbers(3)
        return (shape, *axes), functools.partial(AXIS_SHAPES[shape], axes)
    if shape in ROUND_SHAPES:
        make, names = ROUND_SHAPES[shape]
        given = entry.mapping(names, required=names)
        lengths = [given[name].number() for name in names]
        return (shape, *lengths), functools.partial(make, *lengths)
    if shape == "points":
        points = entry.rows(3)
        return (shape, *map(tuple, points)), functools.partial(Body.from_points, np.array(points).reshape(-1, 3))
    with entry.blamed():
        file = entry.file.parent / _validate.path(entry.text(), shape)
    if shape == "saved":
        return (shape, file), functools.partial(Body.load, file)
    scale = _scale(keys["scale"]) if "scale" in keys else [1.0, 1.0, 1.0]
    decompose = keys["decompose"].flag() if "decompose" in keys else True
    make_mesh = functools.partial(Body.from_mesh, file, scale=scale, decompose=decompose)
    return (shape, file, *scale, decompose), make_mesh


def _scale(entry: _Entry) -> list[float]:
    scale = [entry.number()] * 3 if entry.node.id == "scalar" else entry.numbers(3)
    if 0.0 in scale:
        raise entry.error(f"expected factors other than 0, found {scale}")
    return scale


def _pose(entry: _Entry, keys: dict[str, _Entry]) -> Floats:
    """Pose of a body, of the identity and what is given of it."""
    given = [key for key in POSE_KEYS if key in keys]
    if "pose" in given and len(given) > 1:
        raise entry.error(f"expected either pose or position and a rotation, found {' and '.join(given)}")
    if "rpy" in given and "quaternion_wxyz" in given:
        raise entry.error("expected one rotation, found rpy and quaternion_wxyz")
    T = np.eye(4)
    if "pose" in given:
        with keys["pose"].blamed():
            T = _validate.poses([row.numbers(4) for row in keys["pose"].items(4)], "matrix")
    if "position" in given:
        T[:3, 3] = keys["position"].numbers(3)
    if "rpy" in given:
        rpy = keys["rpy"].numbers(3)
        doubt = doubt_about_rpy(rpy)
        if doubt:
            warn(f"{entry.file}, line {keys['rpy'].node.start_mark.line + 1}: expected {doubt}")
        T[:3, :3] = from_rpy(*rpy)
    if "quaternion_wxyz" in given:
        with keys["quaternion_wxyz"].blamed():
            T[:3, :3] = from_quaternion(keys["quaternion_wxyz"].numbers(4), "rotation")
    return T


# -- writing YAML -----------------------------------------------------------------------------


def _shape_of(body: Body, name: str, file: Path, saved: dict[int, str]) -> dict[str, Any]:
    """How a body is written; one that no shape makes is saved next to the file, unless `saved` has it already."""
    shape = _primitive_of(body)
    if shape is not None:
        return shape
    if id(body) not in saved:
        plain = f"{file.stem}-{re.sub(r'[^A-Za-z0-9_.-]', '_', name)}"
        taken = {other.lower() for other in saved.values()}  # not all file systems tell cases apart
        tries = (f"{plain}{mark}.npz" for mark in ("", *(f"-{k}" for k in range(2, len(saved) + 3))))
        saved[id(body)] = next(free for free in tries if free.lower() not in taken)
        body.save(file.parent / saved[id(body)])
    return {"saved": saved[id(body)]}


def _primitive_of(body: Body) -> dict[str, Any] | None:
    """The shape and sizes that make exactly this body, if there are any."""
    if len(body.pieces) != 1 or body.covering is not None:
        return None
    kind, vertices = body.pieces[0].kind, body.pieces[0].vertices
    # Rounding radius and axes of the unit shape's image are the sizes, unrounded.
    rounding, frame = float(body._packed.frames[0, 0]), body._packed.frames[0, 4::4].tolist()
    guesses: dict[str, tuple[str, Any]] = {
        "ellipsoid": ("ellipsoid", frame),
        "sphere": ("sphere", [rounding]),
        "cylinder": ("cylinder", [frame[0], 2 * frame[2]]),
        "cone": ("cone", [frame[0], 2 * frame[2]]),
        "capsule": ("capsule", [rounding, 2 * frame[2]]),
    }
    if vertices is not None:
        guesses["polytope"] = "box", (2 * vertices.max(axis=0)).tolist()
    shape, sizes = guesses[kind]
    if not min(sizes) > 0:
        return None
    if shape in AXIS_SHAPES:
        return {shape: sizes} if _same(AXIS_SHAPES[shape](sizes), body) else None
    make, names = ROUND_SHAPES[shape]
    return {shape: dict(zip(names, sizes, strict=True))} if _same(make(*sizes), body) else None


def _same(a: Body, b: Body) -> bool:
    """Whether two bodies are the same to the last bit."""
    return all(np.array_equal(getattr(a._packed, name), getattr(b._packed, name)) for name in ARRAYS)


def _place_of(scene: Scene, name: str) -> dict[str, Any]:
    """Pose and attachment; a pose is written as position if that is all it is, else as matrix: nothing is rounded."""
    held = scene.attachments.get(name)
    T = scene.pose(name) if held is None else held.T_link_body
    place: dict[str, Any] = {}
    if not np.array_equal(T[:3, :3], np.eye(3)) or not np.array_equal(T[3], np.eye(4)[3]):
        place["pose"] = T.tolist()
    elif T[:3, 3].any():
        place["position"] = T[:3, 3].tolist()
    if held is not None:
        place["attach"] = {"link": held.link}
        touch = [link for link in held.touch_links if link != held.link]
        if touch:
            place["attach"]["touch"] = touch
    return place


# -- MotionBenchMaker -------------------------------------------------------------------------


@guarded
@dataclass(frozen=True, eq=False)
class Problem:
    """A motion planning problem: a scene, and from where to where.

    Attributes
    ----------
    group : str
        The family that it belongs to, such as "bookshelf_thin".
    index : int
        Its number in the family, as the file counts.
    robot : str
        Name of the robot.
    joint_names : tuple of str
        What the columns of `start` and `goals` are.
    start : ndarray, shape (dof,)
        Configuration to start from, in radians or metres.
    goals : ndarray, shape (k, dof)
        Configurations of which any one is to be reached.
    scene : Scene
        Obstacles, in the frame of the robot's base.
    valid : bool or None
        The file's own word on whether the problem is sound, not checked here; None if it says nothing.

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


PROBLEM_KEYS = ("sphere", "box", "cylinder", "index", "problem", "start", "goals", "valid")
OBSTACLE_KEYS = {
    "sphere": ("radius",),
    "box": ("half_extents",),
    "cylinder": ("radius", "length"),
}
PLACE_KEYS = ("position", "orientation_quat_xyzw", "orientation_euler_xyz")


@guarded
def read_motion_bench_maker(path: str | PathLike[str]) -> tuple[Problem, ...]:
    """Read planning problems in the JSON form of MotionBenchMaker's data (docs/scenes.md).

    Parameters
    ----------
    path : path
        A file with ``robot``, ``joints``, and ``problems``: lists of problems by group.

    Returns
    -------
    tuple of Problem
        In the order of the file. Obstacles of equal sizes share one `Body`.

    Raises
    ------
    FileError
        If the file is missing or malformed, or has obstacles of a kind unknown here. The message says which problem
        and which key.

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
    try:
        content = json.loads(_json_text(file), object_pairs_hook=functools.partial(_once, file))
    except json.JSONDecodeError as error:
        raise FileError(f"{file}, line {error.lineno}: expected JSON, found a fault in it ({error.msg})") from None
    except (ValueError, RecursionError) as error:
        raise FileError(f"{file}: expected JSON, found something else ({error})") from None
    top = _Place(str(file), content)
    robot, joints, groups = (top.at(key) for key in ("robot", "joints", "problems"))
    names = tuple(joint.of(str, "a name") for joint in joints.items())
    for name, count in Counter(names).most_common(1):
        if count > 1:
            raise FileError(f"{joints.where}: expected each joint once, found {_cut(repr(name))} again")
    make = functools.cache(_obstacle)
    return tuple(
        _problem(place, group, robot.of(str, "a name"), names, make)
        for group in groups.of(dict, "lists of problems by group")
        for place in groups.at(group).items()
    )


def _json_text(file: Path) -> str:
    """Text of a JSON file that is not nested too deep."""
    data = read_regular(file, "problems in JSON", MOST_JSON_BYTES)
    text = data.decode(json.detect_encoding(data))
    if text.startswith("\ufeff"):
        text = text[1:]
    # What opens minus what closes; brackets in names can only make it too large, in files that nobody writes.
    depth = deepest = 0
    for bracket in re.finditer(r"[\[{\]}]", text):
        depth += 1 if bracket[0] in "[{" else -1
        deepest = max(deepest, depth)
    if deepest > DEEPEST:
        raise FileError(f"{file}: expected problems in JSON, found more than {DEEPEST} entries inside each other")
    return text


def _once(file: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make a mapping of its pairs. JSON lets a key come twice, and the first value would be lost."""
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise FileError(f"{file}: expected each key once in a mapping, found {_cut(repr(twice))} again")
    return mapping


def _some(names: Any) -> str:
    """Names for people, as many as one would read."""
    listed = list(names)
    more = f", and {len(listed) - LISTED} more" if len(listed) > LISTED else ""
    return ", ".join(map(_cut, listed[:LISTED])) + more


def _cut(text: str) -> str:
    """A text of a file for a message."""
    return text if len(text) <= 80 else f"{text[:77]}..."


@dataclass(frozen=True)
class _Place:
    """A place in a JSON file: how to speak of it, and what it holds."""

    where: str
    value: Any

    def of(self, kind: Any, wanted: str) -> Any:
        # To Python a bool is an int; to a file it is not.
        if not isinstance(self.value, kind) or (isinstance(self.value, bool) and kind is not bool):
            raise FileError(f"{self.where}: expected {wanted}, found {_cut(self._text())!r}")
        return self.value

    def _text(self) -> str:
        return self.value if isinstance(self.value, str) else reprlib.repr(self.value)

    def at(self, key: str) -> _Place:
        mapping = self.of(dict, "a mapping")
        if key not in mapping:
            raise FileError(f"{self.where}: expected the key {key}, found {_some(mapping) or 'none'}")
        return _Place(f"{self.where}, {_cut(key)}", mapping[key])

    def has(self, key: str) -> bool:
        return key in self.of(dict, "a mapping")

    def items(self) -> list[_Place]:
        return [_Place(f"{self.where}[{i}]", value) for i, value in enumerate(self.of(list, "a list"))]

    def known(self, keys: tuple[str, ...]) -> None:
        for key in self.of(dict, "a mapping"):
            if key not in keys:
                raise FileError(f"{self.where}: expected keys among {', '.join(keys)}; found {_cut(repr(key))}")

    def number(self) -> float:
        value = self.of((int, float), "a number")
        if not abs(value) <= sys.float_info.max:  # whole numbers may be larger, too
            raise FileError(f"{self.where}: expected a finite number, found {str(value)[:80]}")
        return float(value)

    def numbers(self, length: int) -> tuple[float, ...]:
        items = self.items()
        if len(items) != length:
            raise FileError(f"{self.where}: expected {length} numbers, found {len(items)}")
        return tuple(item.number() for item in items)


def _problem(place: _Place, group: str, robot: str, joints: tuple[str, ...], make: Maker) -> Problem:
    place.known(PROBLEM_KEYS)
    scene = Scene()
    for kind in OBSTACLE_KEYS:
        for obstacle in place.at(kind).items() if place.has(kind) else []:
            obstacle.known(("name", *OBSTACLE_KEYS[kind], *PLACE_KEYS))
            sizes = [obstacle.at(key) for key in OBSTACLE_KEYS[kind]]
            given = sizes[0].numbers(3) if kind == "box" else tuple(size.number() for size in sizes)
            name = obstacle.at("name").of(str, "a name")
            try:
                scene.add(name, make(kind, *given), _obstacle_pose(obstacle))
            except InputError as error:
                raise FileError(f"{obstacle.where}: {error}") from None
    goals = [goal.numbers(len(joints)) for goal in place.at("goals").items()]
    return Problem(
        group=group,
        index=place.at("index").of(int, "a whole number"),
        robot=robot,
        joint_names=joints,
        start=np.array(place.at("start").numbers(len(joints))),
        goals=np.array(goals).reshape(-1, len(joints)),
        scene=scene,
        valid=place.at("valid").of(bool, "true or false") if place.has("valid") else None,
    )


def _obstacle(kind: str, *sizes: float) -> Body:
    if kind == "box":
        return Body.box([2 * half for half in sizes])
    return ROUND_SHAPES[kind][0](*sizes)


def _obstacle_pose(obstacle: _Place) -> Floats:
    T = np.eye(4)
    T[:3, 3] = obstacle.at("position").numbers(3)
    if obstacle.has("orientation_quat_xyzw"):
        *xyz, w = obstacle.at("orientation_quat_xyzw").numbers(4)
        T[:3, :3] = from_quaternion([w, *xyz], "orientation_quat_xyzw")
    elif obstacle.has("orientation_euler_xyz"):
        T[:3, :3] = from_rpy(*obstacle.at("orientation_euler_xyz").numbers(3))
    return T
