"""Read and write scenes in YAML; `docs/scenes.md` describes the format."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from loewner._base import _validate
from loewner._base._files import named_by_content, read_regular, replacing, shown
from loewner._base._guard import guarded
from loewner._base._nodes import MOST_ENTRIES, YamlNode, read_yaml, some, yaml_package
from loewner._base._plausible import doubt_about_rpy, warn
from loewner._base._rotations import from_quaternion, from_rpy
from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies import ARRAYS, CURVED, Body, body_of_file, checksum_of, packed_of
from loewner.errors import FileError
from loewner.queries.pose_paths import PoseBounds
from loewner.scenes.files.mjcf_scenes import MJCF_SUFFIXES, mjcf_scene
from loewner.scenes.files.schema import BODY, SCHEMA, keys_in, keys_of
from loewner.scenes.files.sensor_shapes import SENSOR_SHAPES, file_of
from loewner.scenes.scene import MarginKey, Scene

Maker = Callable[..., Body]

# Largest size of a file [bytes].
MOST_BYTES = 2**24

# The name of a body's file contains at most this many letters of the body's name.
LONGEST_NAME = 100

POSE_KEYS = ("position", "rpy", "quaternion_wxyz", "pose")
POSE_HINT = "a pose is a 4x4 matrix, in four rows of four; position with rpy or quaternion_wxyz may replace it"
SURFACE_KEYS = ("radius", "solid")

# Keys that are allowed only next to the shape `mesh` or `saved`.
KEYS_OF_SHAPES = {"mesh": ("scale", "decompose", "model", *SURFACE_KEYS), "saved": ("sha256",)}
MODELS = tuple(BODY["properties"]["model"]["enum"])
SHAPES = tuple(rule["required"][0] for rule in BODY["oneOf"])
BODY_KEYS = tuple(key for key in BODY["properties"] if key not in {*SHAPES, *sum(KEYS_OF_SHAPES.values(), ())})

# Shapes whose sizes are lengths along the axes, and shapes whose sizes are named lengths.
AXIS_SHAPES: dict[str, Maker] = {"box": Body.box} | {
    kind.name: getattr(Body, kind.name) for kind in CURVED.values() if not kind.size_names
}
ROUND_SHAPES: dict[str, tuple[Maker, tuple[str, ...]]] = {
    kind.name: (getattr(Body, kind.name), kind.size_names) for kind in CURVED.values() if kind.size_names
}


@guarded
def load_scene(path: str | PathLike[str]) -> Scene:
    """Read a scene from YAML (docs/scenes.md), or from MJCF (docs/howto/mujoco.md).

    Parameters
    ----------
    path : path
        Paths in the file are relative to the file's folder. A file with the extension ``.xml`` or ``.mjcf`` is read as
        a MuJoCo model: the scene contains all colliding geoms of the model, with its joints at their reference
        positions. Use `Robot.from_mjcf` for parts that move.

    Returns
    -------
    Scene

    Raises
    ------
    FileError
        If the file, or a file that it names, is missing or malformed. The message gives the line and the key.
    MissingExtraError
        If a required package is not installed: PyYAML, MuJoCo for a model, or a package that a mesh needs.
    InputError, GeometryError
        As for `Robot.from_mjcf`, if a colliding geom of a model cannot be read.

    Warns
    -----
    UserWarning
        If a body is probably not in metres, or an angle is probably not in radians.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("table.yaml").write_text("bodies: {table: {box: [1, 1, 0.1], position: [0, 0, 0.5]}}")
    >>> load_scene("table.yaml")
    Scene(1 body, 0 attached)
    """
    file = _validate.path(path, "path")
    if file.suffix.lower() in MJCF_SUFFIXES:
        return mjcf_scene(file)
    what = "a scene in YAML"
    top = read_yaml(read_regular(file, what, MOST_BYTES), file, what).mapping(*keys_in(SCHEMA))
    scene = Scene()
    if "margin" in top:
        scene.set_margin(top["margin"].length())
    bodies_by_recipe: dict[Any, Body] = {}
    for name, entry in top["bodies"].mapping(None).items():
        _add(scene, name, entry, bodies_by_recipe)
    for key, rule in (("allow", scene.allow), ("leave", scene.leave), ("reach", scene.reach)):
        for entry in top[key].items() if key in top else []:
            a, b = (item.text() for item in entry.items(2))
            with entry.blamed():
                rule(a, b)
    for entry in top["margins"].items() if "margins" in top else []:
        _set_margin(scene, entry)
    return scene


def _set_margin(scene: Scene, entry: YamlNode) -> None:
    """Set the margin of an entry: ``[a, 0.02]``, ``[a, b, 0.02]``, or a mapping with the options of `set_margin`."""
    options: dict[str, Any] = {}
    if entry.kind != "mapping":
        *items, last = entry.items(2, 3)
    else:
        keys = entry.mapping(*keys_in(SCHEMA["definitions"]["margin"]["oneOf"][-1]))
        items, last = keys["of"].items(1, 2) if "of" in keys else [], keys["margin"]
        if "against" in keys:
            options["against"] = keys["against"].choice(("links",), "links")
        elif not items:
            raise entry.error("expected the key of, or against: links, found neither")
        if "lower" in keys:
            options["lower"] = keys["lower"].flag()
    margin, names, before = last.length(), [item.text() for item in items], len(scene.margins)
    with entry.blamed():
        scene.set_margin(margin, *names, **options)
    if len(scene.margins) == before:
        raise entry.error("expected one margin for the same names, found a second one")


@guarded
def save_scene(scene: Scene, path: str | PathLike[str]) -> None:
    """Write a scene to YAML; `load_scene` then returns a scene with the same verdicts.

    For a box, sphere, cylinder, capsule, cone or ellipsoid, the file contains the sizes. Any other body is saved next
    to the file as ``STEM-NAME-DIGEST.npz``; a body that several names share is saved once. The scene file contains the
    SHA-256 of each saved body, and the reader refuses a body with another SHA-256. DIGEST is the beginning of the
    SHA-256.

    Parameters
    ----------
    scene : Scene
        The scene. Other threads may change it during the call; its state at one instant is written.
    path : path
        The files of the bodies are written first; then this file is written under a temporary name and renamed. A
        file with the same path is replaced. All other files of an older scene are neither changed nor removed.

    Raises
    ------
    FileError
        If a file could not be written, or would be too large for `load_scene`; an older scene file is then unchanged.
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
    yaml = yaml_package()
    _validate.instance(scene, "scene", Scene)
    file = _validate.path(path, "path")
    document, saved = _document(scene.snapshot(), file)
    # YAML reads U+0085 as a space or a line end, unless it is escaped.
    readable = "\\x85" not in repr(document)  # such characters can occur in names of bodies and links
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, allow_unicode=readable, width=120)
    data, count = text.encode(), _entries(document)
    if len(data) > MOST_BYTES or count > MOST_ENTRIES:
        most = f"{MOST_BYTES} bytes and {MOST_ENTRIES} entries"
        raise FileError(f"{shown(file)}: expected a scene of at most {most}, found {len(data)} and {count}")
    with replacing(file) as temporary:
        for name, body in saved.items():
            body.save(file.parent / name)
        temporary.write_bytes(data)


def _document(scene: Scene, file: Path) -> tuple[dict[str, Any], dict[str, Body]]:
    """Make the contents of the file for a scene; also return the bodies that YAML cannot express, keyed by file name.

    No other thread may change the scene during the call.
    """
    saved: dict[int, dict[str, str]] = {}
    files: dict[str, Body] = {}
    bodies = {}
    for name in scene:
        body = scene[name]
        shape = _primitive_of(body) or saved.get(id(body))
        if shape is None:
            digest = checksum_of(body)
            plain = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:LONGEST_NAME]
            file_name = named_by_content(f"{file.stem}-{plain}", digest, ".npz")
            shape = saved[id(body)] = {"saved": file_name, "sha256": digest}
            files[file_name] = body
        bodies[name] = {**shape, **_place_of(scene, name)}
        if (name,) in scene.margins and (name,) not in scene.lowered:
            bodies[name]["margin"] = scene.margins[(name,)]
    document: dict[str, Any] = {"margin": scene.margin, "bodies": bodies}
    for key, pairs in (("allow", scene.allowed), ("leave", scene.leaving), ("reach", scene.reaching)):
        if pairs:
            document[key] = [list(pair) for pair in sorted(pairs)]
    margins = [
        _margin_entry(key, margin, key in scene.lowered)
        for key, margin in scene.margins.items()
        if len(key) == 2 or key[0] not in scene or key in scene.lowered
    ]
    if margins:
        document["margins"] = margins
    return document, files


def _entries(value: Any) -> int:
    """Count entries as the reader does: each mapping, sequence, key and value."""
    if isinstance(value, dict):
        return 1 + len(value) + sum(map(_entries, value.values()))
    return 1 + sum(map(_entries, value)) if isinstance(value, list) else 1


def _margin_entry(key: MarginKey, margin: float, lower: bool) -> list[Any] | dict[str, Any]:
    """Make the entry of a margin, as `_set_margin` reads it."""
    names = [name for name in key if name is not None]
    if len(names) == len(key) and not lower:
        return [*names, margin]
    against = {"against": "links"} if len(names) < len(key) else {}
    return {**({"of": names} if names else {}), "margin": margin, **against, **({"lower": True} if lower else {})}


# -- reading YAML -----------------------------------------------------------------------------


def _add(scene: Scene, name: str, entry: YamlNode, made: dict[Any, Body]) -> None:
    """Add one body of a file to the scene; `made` holds the bodies made so far, keyed by recipe."""
    keys = entry.mapping(None)
    shapes = [key for key in keys if key in SHAPES]
    if len(shapes) != 1:
        listing = " and ".join(shapes) or some(keys) or "nothing"
        raise entry.error(f"expected one shape among {', '.join(SHAPES)}; found {listing}")
    keys = entry.mapping((*shapes, *BODY_KEYS, *KEYS_OF_SHAPES.get(shapes[0], ())))
    recipe, make = _recipe(shapes[0], keys)
    with keys[shapes[0]].blamed():
        if recipe not in made:
            made[recipe] = make()
    T = _pose(entry, keys)
    margin = keys["margin"].length() if "margin" in keys else None
    if "follow" in keys:
        for key in (*POSE_KEYS, "attach", "error"):
            if key in keys:
                raise keys[key].error(f"expected poses and errors in follow alone, found {key} next to it")
        _add_moving(scene, name, made[recipe], margin, keys["follow"])
        return
    error = keys["error"].numbers(2) if "error" in keys else None
    if "attach" not in keys:
        with entry.blamed():
            scene.add(name, made[recipe], T, margin=margin, error=error)
        return
    if error is not None:
        raise keys["error"].error("expected no error with attach, since an error bounds a pose in the world, found one")
    attach = keys["attach"].mapping(*keys_of("attach"))
    link = attach["link"].text()
    touch, leave, reach = (
        [item.text() for item in attach[key].items()] if key in attach else [] for key in ("touch", "leave", "reach")
    )
    with entry.blamed():
        scene.add(name, made[recipe], margin=margin)
        scene.attach(name, link, T, touch_links=touch, leave=leave, reach=reach)


def _add_moving(scene: Scene, name: str, body: Body, margin: float | None, entry: YamlNode) -> None:
    """Add a body that follows a motion."""
    keys = entry.mapping(*keys_of("follow"))
    of_row = keys_in(BODY["properties"]["follow"]["properties"]["poses"]["items"])
    rows = [(row, row.mapping(*of_row)) for row in keys["poses"].items()]
    if not rows:
        raise keys["poses"].error("expected one row or more, found none")
    times, poses = [row_keys["time"].number() for _, row_keys in rows], [_pose(row, row_keys) for row, row_keys in rows]
    for (_, before), (row, after) in pairwise(rows):
        if "rpy" in before and "rpy" in after:
            angles = np.array([before["rpy"].numbers(3), after["rpy"].numbers(3)])
            # Angles within pi cause no warning: they may have been wrapped, and then their difference is not the turn.
            if min(np.abs(angles).max() / 2, np.ptp(angles / 2, axis=0).max()) > np.pi / 2:
                warn(
                    f"{row.file}, line {row.line}: expected roll, pitch and yaw within pi of those in the row before, "
                    f"found {angles[1].tolist()}; the body turns through the smaller angle; add a row between"
                )
    repeat = "repeat" in keys and keys["repeat"].flag()
    bounds: dict[str, Any] = {key: keys[key].number() for key in ("speed", "turn", "since") if key in keys}
    if "error" in keys:
        bounds["error"] = keys["error"].numbers(2)
    with entry.blamed():
        scene.add(name, body, poses[0], margin=margin)
        scene.follow(name, times, poses, repeat=repeat, **bounds)


def _recipe(shape: str, keys: dict[str, YamlNode]) -> tuple[Any, Callable[[], Body]]:
    """Return a key that identifies equal bodies, and a function that makes the body."""
    entry = keys[shape]
    if shape in AXIS_SHAPES:
        axes = entry.numbers(3)
        return (shape, *axes), functools.partial(AXIS_SHAPES[shape], axes)
    if shape in ROUND_SHAPES:
        make, names = ROUND_SHAPES[shape]
        shape_keys = entry.mapping(*keys_of(shape))
        lengths = [shape_keys[name].number() for name in names]
        return (shape, *lengths), functools.partial(make, *lengths)
    if shape == "points":
        points = entry.rows(3)
        return (shape, *map(tuple, points)), functools.partial(Body.from_points, np.array(points).reshape(-1, 3))
    if shape in SENSOR_SHAPES:
        recipe, make_sensed = SENSOR_SHAPES[shape](entry)
        return (shape, *recipe), make_sensed
    file = file_of(entry)
    if shape == "saved":
        digest = _digest(keys["sha256"]) if "sha256" in keys else None
        return (shape, file, digest), functools.partial(body_of_file, file, digest)
    scale = _scale(keys["scale"]) if "scale" in keys else [1.0, 1.0, 1.0]
    model = _model(keys)
    if model != "surface":
        make_mesh = functools.partial(Body.from_mesh, file, scale=scale, decompose=model == "pieces")
        return (shape, file, *scale, model), make_mesh
    radius = keys["radius"].length() if "radius" in keys else 0.0
    solid = keys["solid"].flag() if "solid" in keys else None
    make_surface = functools.partial(Body.from_surface, file, scale=scale, radius=radius, solid=solid)
    return (shape, file, *scale, model, radius, solid), make_surface


def _digest(entry: YamlNode) -> str:
    digest = entry.text()
    if not re.fullmatch(r"[0-9a-f]{64}", digest):
        raise entry.error(f"expected 64 hexadecimal digits, found {entry.described()}")
    return digest


def _model(keys: dict[str, YamlNode]) -> str:
    """Return the model that the keys select for a mesh; refuse keys of surfaces for other models."""
    if "decompose" in keys and "model" in keys:
        raise keys["model"].error("expected either model or decompose, found both")
    model = "pieces" if "decompose" not in keys or keys["decompose"].flag() else "hull"
    if "model" in keys:
        model = keys["model"].choice(MODELS)
    for key in SURFACE_KEYS:
        if key in keys and model != "surface":
            raise keys[key].error(f"expected {key} only with model: surface, found model: {model}")
    return model


def _scale(entry: YamlNode) -> list[float]:
    scale = [entry.number()] * 3 if entry.kind == "scalar" else entry.numbers(3)
    if 0.0 in scale:
        raise entry.error(f"expected factors other than 0, found {scale}")
    return scale


def _pose(entry: YamlNode, keys: dict[str, YamlNode]) -> Floats:
    """Read the pose of a body; a missing position or rotation is the identity."""
    present_keys = [key for key in POSE_KEYS if key in keys]
    if "pose" in present_keys and len(present_keys) > 1:
        raise entry.error(f"expected either pose or position and a rotation, found {' and '.join(present_keys)}")
    if "rpy" in present_keys and "quaternion_wxyz" in present_keys:
        raise entry.error("expected one rotation, found rpy and quaternion_wxyz")
    T = np.eye(4)
    if "pose" in present_keys:
        try:
            rows = [row.numbers(4) for row in keys["pose"].items(4)]
            with keys["pose"].blamed():
                T = _validate.poses(rows, "matrix")
        except FileError as error:
            raise FileError(f"{error}; {POSE_HINT}") from None
    if "position" in present_keys:
        T[:3, 3] = keys["position"].numbers(3, "x, y, z")
    if "rpy" in present_keys:
        rpy = keys["rpy"].numbers(3, "roll, pitch, yaw")
        doubt = doubt_about_rpy(rpy)
        if doubt:
            warn(f"{entry.file}, line {keys['rpy'].line}: expected {doubt}")
        T[:3, :3] = from_rpy(*rpy)
    if "quaternion_wxyz" in present_keys:
        wxyz = keys["quaternion_wxyz"].numbers(4, "w, x, y, z")
        with keys["quaternion_wxyz"].blamed():
            T[:3, :3] = from_quaternion(wxyz, "rotation")
    return T


# -- writing YAML -----------------------------------------------------------------------------


def _primitive_of(body: Body) -> dict[str, Any] | None:
    """Find the shape and sizes that make exactly this body, if there are any."""
    number = int(packed_of(body).layout[0, columns.KIND])
    if len(packed_of(body).layout) != 1 or body.covering is not None or number < columns.POLYTOPE:
        return None
    if number == columns.POLYTOPE:
        shape, sizes = "box", (2 * packed_of(body).points.max(axis=0)).tolist()
    else:  # the sizes follow, unrounded, from the ball's radius and the axes of the unit shape's image
        kind, frame = CURVED[number], packed_of(body).frames[0]
        shape, sizes = kind.name, list(kind.sizes(float(frame[0]), frame[4::4].tolist()))
    if not min(sizes) > 0:
        return None
    if shape in AXIS_SHAPES:
        return {shape: sizes} if _same(AXIS_SHAPES[shape](sizes), body) else None
    make, names = ROUND_SHAPES[shape]
    return {shape: dict(zip(names, sizes, strict=True))} if _same(make(*sizes), body) else None


def _same(a: Body, b: Body) -> bool:
    """Return whether two bodies are the same to the last bit."""
    return all(np.array_equal(getattr(packed_of(a), name), getattr(packed_of(b), name)) for name in ARRAYS)


def _place_of(scene: Scene, name: str) -> dict[str, Any]:
    """Express pose and attachment, or motion, without rounding.

    A pure translation is written as a position, and any other pose as a matrix.

    Quaternions of a motion are written to the last digit, and are normalised when they are read.
    """
    bounds = scene.bounds.get(name) or PoseBounds(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    error = {"error": [bounds.metres, bounds.radians]} if bounds.metres or bounds.radians else {}
    if name in scene.following:
        path = scene.following[name]
        rows = zip(path.times.tolist(), path.positions.tolist(), path.quaternions.tolist(), strict=True)
        poses = [
            {"time": t, "position": position} | ({} if wxyz == [1.0, 0.0, 0.0, 0.0] else {"quaternion_wxyz": wxyz})
            for t, position, wxyz in rows
        ]
        follow: dict[str, Any] = {"poses": poses, "repeat": True} if path.repeat else {"poses": poses}
        if bounds.speed or bounds.turn:
            follow |= {"speed": bounds.speed, "turn": bounds.turn, "since": bounds.since}
        return {"follow": follow | error}
    held = scene.attachments.get(name)
    T = scene.pose(name) if held is None else held.T_link_body
    place: dict[str, Any] = {**error}
    if not np.array_equal(T[:3, :3], np.eye(3)) or not np.array_equal(T[3], np.eye(4)[3]):
        place["pose"] = T.tolist()
    elif T[:3, 3].any():
        place["position"] = T[:3, 3].tolist()
    if held is not None:
        touch = [link for link in held.touch_links if link != held.link]
        place["attach"] = {"link": held.link} | ({"touch": touch} if touch else {})
    return place
