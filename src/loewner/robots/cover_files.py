"""Read and write models that represent a robot's links by spheres or other shapes, in the formats of planners.

A model is interpreted in the same way as in the program for which it was written. Numbers are rounded to float32 if the
program rounds them, buffers are added to radii, and shapes that the program ignores are left out. A warning lists
contents of the file that could matter but are not read.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from loewner._base import _validate
from loewner._base._files import read_regular, shown
from loewner._base._nodes import Node, read_json, read_yaml, some
from loewner._base._plausible import warn
from loewner._base._validate import Floats, Pair
from loewner._kernels import columns
from loewner.bodies import Body, packed_of
from loewner.bodies.kinds import KIND_NAMES
from loewner.errors import FileError, InputError
from loewner.robots import Robot
from loewner.robots.covers import with_bodies
from loewner.robots.description.robot import CoverFormat, answers, scene_of, skipped_with_bodies
from loewner.scenes.files import load_scene, save_scene

FORMATS: tuple[CoverFormat, ...] = get_args(CoverFormat)

# Formats with spheres only. Programs that use these formats compute in float32, so numbers are rounded to float32. When
# a file is written, they are rounded outwards.
OF_SPHERES = ("curobo", "vamp", "foam", "pyroki")

# Formats, keyed by the suffix of the file. If several formats have the same suffix, the keys in the file decide.
BY_SUFFIX = {".yml": "curobo", ".yaml": "curobo", ".xrdf": "curobo", ".json": "pyroki", ".urdf": "urdf"}
BY_SUFFIX |= {".xml": "mjcf", ".mjcf": "mjcf"}

# Suffixes of the files that are written, keyed by the format.
YAML = (".yml", ".yaml")
WRITTEN = {"curobo": YAML, "scene": YAML, "pyroki": (".json",), "mjcf": (".xml", ".mjcf")}
WRITTEN |= dict.fromkeys(("vamp", "foam", "urdf"), (".urdf",))

# Maximum size of a file [bytes]. Ten thousand spheres take one megabyte.
MOST_BYTES = 2**25

# Length by which shapes other than spheres are enlarged on each side when they are written [m]. In a robot whose parts
# are smaller than a kilometre, rounding errors of angles and sizes are far smaller.
WIDENED = 1e-9

# Keys that contain neither shapes nor rules about pairs, in cuRobo's files, Lula's robot descriptions and XRDF files.
OF_CUROBO = frozenset((
    "acceleration_limits", "add_object_link", "api_version", "asset_root_path", "base_link", "composite_task_spaces",
    "cspace", "cspace_to_urdf_rules", "debug", "default_joint_positions", "default_q", "dynamics", "ee_link",
    "external_asset_path", "external_robot_configs_path", "format", "format_version", "grasp_contact_link_names",
    "isaac_usd_path", "jerk_limits", "link_names", "load_dynamics", "load_link_names_with_mesh", "load_meshes",
    "load_tool_frames_with_mesh", "lock_joints", "mesh_link_names", "robot", "root_link", "tool_frames", "urdf_path",
    "usd_flip_joint_limits", "usd_flip_joints", "usd_path", "usd_robot_root", "use_external_assets", "use_global_cumul",
    "use_robot_segmentation", "use_usd_kinematics",
))  # fmt: skip
OF_FOAM = ("mean", "best", "worst", "spheres")

# Term that notes use for the spheres that are ignored in pyroki and foam files.
WITHOUT_SIZE = "spheres with a radius of 0 or less"


class _Balls(NamedTuple):
    """Spheres of one link: centers, shape (n, 3), and radii, shape (n,), in metres."""

    centers: Floats
    radii: Floats


@dataclass
class Model:
    """The contents of a file.

    Attributes
    ----------
    bodies : dict
        Bodies by link name, each in the frame of its link.
    ignored : frozenset of pairs of str, or None
        The pairs that the file's program does not check; None if the file has no rules about pairs.
    notes : list of str
        Contents of the file that neither its program nor this reader uses.
    """

    bodies: dict[str, Body] = field(default_factory=dict)
    ignored: frozenset[Pair] | None = None
    notes: list[str] = field(default_factory=list)

    def note(self, what: str, names: Iterable[str]) -> None:
        """Add a note that lists the given names, unless there are none."""
        if listed := list(names):
            self.notes.append(f"{what}: {some(listed)}")


def with_cover(self: Robot, path: str | os.PathLike[str], format: str | None = None) -> Robot:
    """Implement `Robot.with_cover`."""
    file = _validate.path(path, "path")
    try:
        model = read_model(file, format)
    except InputError as error:  # the file has a number that no sphere can have
        raise FileError(f"{shown(file)}: {error}") from error
    for link in model.bodies:
        _validate.known(link, f"{shown(file)}: link", self.link_names)
    unknown = sorted({link for pair in model.ignored or () for link in pair} - set(self.link_names))
    model.note("links of the robot that have no shapes", [link for link in self.bodies if link not in model.bodies])
    new = [link for link in model.bodies if link not in self.bodies]
    model.note("shapes of links that have none in the robot", new)
    model.note("ignored pairs of links that the robot does not have", unknown)
    if not model.bodies:
        raise FileError(f"{shown(file)}: expected shapes of links, found none{_told(model.notes)}")
    if model.notes:
        warn(f"{shown(file)}: found{_told(model.notes)}")
    ordered = {link: model.bodies[link] for link in self.link_names if link in model.bodies}
    ignored = None if model.ignored is None else frozenset(p for p in model.ignored if not {*p} & {*unknown})
    return with_bodies(self, ordered, ignored)


def _told(notes: list[str]) -> str:
    return (": " if notes else "") + "; ".join(notes)


def save_cover(self: Robot, path: str | os.PathLike[str], format: str | None = None) -> None:
    """Implement `Robot.save_cover`."""
    from loewner.bodies.exports import save_text
    from loewner.robots.description.exports import mjcf_text, save_urdf

    file = _validate.path(path, "path")
    chosen = written_format(file, format)
    if not self.bodies:
        raise InputError("expected a robot with bodies, found one without")
    if chosen in OF_SPHERES:
        balls = {link: _rounded(_spheres_of(body, link, chosen)) for link, body in self.bodies.items()}
    if chosen == "curobo":
        save_text(_curobo_text(self, balls), file)
    elif chosen == "pyroki":
        spheres = {link: {"centers": c.tolist(), "radii": r.tolist()} for link, (c, r) in balls.items()}
        save_text(json.dumps(skipped_with_bodies(self), indent=1) + "\n", _pairs_file(file))
        save_text(json.dumps(spheres, indent=1) + "\n", file)
    elif chosen in ("vamp", "foam"):
        with_bodies(self, {link: Body.spheres(*link_balls) for link, link_balls in balls.items()}).to_urdf(file)
    elif chosen == "scene":
        save_scene(scene_of(self, {}), file)
    elif chosen == "urdf":
        save_urdf(self, file, "", WIDENED)
    else:
        save_text(mjcf_text(self, WIDENED), file)


answers |= {"with_cover": with_cover, "save_cover": save_cover}


def read_model(file: Path, format: str | None = None) -> Model:
    """Read a model from a file.

    Parameters
    ----------
    file : Path
    format : str, optional
        One of `FORMATS`. By default the suffix and the keys of the file determine the format.

    Raises
    ------
    FileError
        If the file is missing or malformed, or a key occurs twice. The message names the place in the file.
    InputError
        If the format cannot be determined from the name.
    MissingExtraError
        If PyYAML or MuJoCo is needed but not installed.
    """
    chosen = format_of(file, format)
    if chosen in ("curobo", "pyroki") or (chosen == "foam" and file.suffix.lower() == ".json"):
        keys = _read(read_yaml if chosen == "curobo" else read_json, file, "a model of spheres").mapping(None)
        if format is None and "bodies" in keys:
            chosen = "scene"
        elif format is None and chosen == "pyroki" and any(map(_of_foam, keys.values())):
            chosen = "foam"
        if chosen != "scene":
            return {"curobo": _read_curobo, "pyroki": _read_pyroki, "foam": _read_foam}[chosen](keys, file)
    if chosen == "scene":
        scene = load_scene(file)
        bodies = {name: _moved(scene[name], scene.pose(name)) for name in scene.static_names}
        others = [name for name in scene.names if name not in bodies]
        notes = [f"bodies that move, which are not read: {some(others)}"] if others else []
        unread = {
            "margins": scene.margin or scene.margins, "errors of poses": scene.bounds,
            "rules of leave and reach": scene.leaving | scene.reaching,
        }  # fmt: skip
        notes += [f"{what}, which are not read" for what, is_there in unread.items() if is_there]
        return Model(bodies, scene.allowed or None, notes)
    if chosen == "mjcf":
        robot = Robot.from_mjcf(file)
        return Model(dict(robot.bodies), robot.disabled_pairs)
    semantics = file.with_suffix(".srdf")
    robot = Robot.from_urdf(file, srdf=semantics if semantics.is_file() else None)
    model = Model(dict(robot.bodies), robot.disabled_pairs if robot._lists_pairs else None)
    if chosen in OF_SPHERES:
        for link, body in model.bodies.items():
            model.bodies[link] = _body(*_spheres_of(body, link, chosen), link)
    return model


def _read(parse: Callable[[bytes, Path, str], Node], file: Path, what: str) -> Node:
    """Read the top-level node of a YAML or JSON file."""
    return parse(read_regular(file, what, MOST_BYTES), file, what)


def format_of(file: Path, format: str | None) -> str:
    """Return the given format or, if it is None, the format that the file's suffix determines; see `read_model`."""
    if format is not None:
        return _validate.choice(format, "format", FORMATS)
    if file.suffix.lower() not in BY_SUFFIX:
        raise InputError(
            f"format: expected one of {', '.join(FORMATS)} for a file with the suffix {file.suffix!r}, found none"
        )
    return BY_SUFFIX[file.suffix.lower()]


def written_format(file: Path, format: str | None) -> str:
    """Return the format in which a file is written, and refuse a file whose suffix belongs to another format."""
    chosen = format_of(file, format)
    if file.suffix.lower() not in WRITTEN[chosen]:
        raise FileError(f"{file}: expected a {' or '.join(WRITTEN[chosen])} file for {chosen}")
    return chosen


def _of_foam(node: Node) -> bool:
    return node.kind == "sequence" or (node.kind == "mapping" and not {"centers", "radii"} & {*_keys(node)})


def _keys(node: Node) -> Iterable[str]:
    return node.mapping(None) if node.kind == "mapping" else ()


def _moved(body: Body, T: Floats) -> Body:
    return body if np.array_equal(T, np.eye(4)) else body.transformed(T)


# -- spheres --------------------------------------------------------------------------------------


def _body(centers: Floats, radii: Floats, link: str) -> Body:
    """Make a body of spheres, rounded to float32 as in the program of the file."""
    with np.errstate(over="ignore", under="ignore"):
        single = [np.float32(values).astype(float) for values in (centers, radii)]
    if not (np.isfinite(single[0]).all() and np.isfinite(single[1]).all() and (single[1] > 0.0).all()):
        raise InputError(f"link {link!r}: expected spheres that float32 can express, found others")
    return Body.spheres(*single)


def _rounded(balls: _Balls) -> _Balls:
    """Round spheres to float32. Each rounded sphere contains its original; spheres in float32 do not change."""
    with np.errstate(over="ignore"):
        centers = np.float32(balls.centers).astype(float)
        moved = np.linalg.norm(centers - balls.centers, axis=1)
        # The factor allows for rounding errors of the norm, and `nextafter` for the rounding error of the sum.
        needed = np.where(moved > 0, np.nextafter(balls.radii + moved * (1 + 1e-12), np.inf), balls.radii)
        single = needed.astype(np.float32)
        radii = np.where(single < needed, np.nextafter(single, np.float32(np.inf)), single).astype(float)
    if not np.isfinite(radii).all():  # a non-finite center gives a non-finite radius
        raise InputError(f"expected spheres that float32 can express, found a radius of {balls.radii.max():g} m")
    return _Balls(centers, radii)


def _spheres_of(body: Body, link: str, format: str) -> _Balls:
    """Return the spheres of a body; other pieces are refused."""
    packed = packed_of(body)
    kinds = packed.layout[:, columns.KIND]
    for kind in kinds[kinds != columns.POINT][:1].tolist():
        raise InputError(
            f"link {link!r}: expected spheres only, which is all that {format} has, found a piece of kind "
            f"{KIND_NAMES[kind]!r}"
        )
    return _Balls(packed.frames[:, 1:4], packed.frames[:, 0])


def _balls(spheres: Node, center: str, grow: float = 0.0) -> list[tuple[list[float], float]]:
    """Read spheres: their centers, under the key `center`, and their radii, which are enlarged by `grow`."""
    each = (entry.mapping((center, "radius"), required=(center, "radius")) for entry in spheres.items())
    return [(keys[center].numbers(3), keys["radius"].number() + grow) for keys in each]


def _of_positive(balls: list[tuple[list[float], float]], name: str, others: str, model: Model) -> Body | None:
    """Make a body of the spheres with positive radii, or return None if there are none. A note counts the others."""
    solid = [ball for ball in balls if ball[1] > 0]
    if len(solid) < len(balls):
        model.notes.append(f"{len(balls) - len(solid)} {others} of {name!r}")
    centers, radii = (np.array([ball[k] for ball in solid]) for k in (0, 1))
    return _body(centers, radii, name) if solid else None


def _pairs(ignored: Mapping[str, Node]) -> frozenset[Pair]:
    """Read pairs that are listed under their first link."""
    return frozenset(
        (min(a, b), max(a, b))
        for a, others in ignored.items()
        for b in (item.text() for item in others.items())
        if a != b
    )


# -- cuRobo ---------------------------------------------------------------------------------------


def _read_curobo(keys: dict[str, Any], file: Path) -> Model:
    """Read a cuRobo configuration or its spheres, a Lula robot description, or an XRDF file."""
    model, unread = Model(), []
    for outer in ("robot_cfg", "kinematics"):
        if outer in keys:
            unread += [key for key in keys if key != outer]
            keys = keys[outer].mapping(None)
    if "geometry" in keys and "collision_spheres" not in keys:
        keys = _of_xrdf(keys, model)
    if keys.get("collision_spheres") is None:
        raise FileError(f"{shown(file)}: expected the key collision_spheres, found {some(keys) or 'none'}")
    spheres, buffer = keys.pop("collision_spheres"), keys.pop("collision_sphere_buffer", None)
    if spheres.kind == "scalar":  # the name of a file next to this file, or in cuRobo's folder of configurations
        named = file.parent / spheres.text()
        inner = _read(read_yaml, named, "a file of spheres").mapping(None)
        spheres = inner.pop("collision_spheres", None)
        if spheres is None:
            raise FileError(f"{shown(named)}: expected the key collision_spheres, found {some(inner) or 'none'}")
        unread += list(inner)
    if spheres.kind == "sequence":  # Lula lists one mapping per link
        links = [entry for item in spheres.items() for entry in item.mapping(None).items()]
    else:
        links = list(spheres.mapping(None).items())
    each = dict(buffer.mapping(None)) if buffer is not None and buffer.kind == "mapping" else {}
    grow = 0.0 if buffer is None or each or buffer.empty else buffer.number()
    listed = keys.pop("collision_link_names", None)
    used = None if listed is None or listed.empty else [item.text() for item in listed.items()]
    replaced = _names(keys.pop("extra_collision_spheres", None))
    extra = _names(keys.pop("extra_links", None))
    model.note("buffers of links without spheres", sorted(each.keys() - {link for link, _ in links}))
    for link, entries in links:
        if link in model.bodies:
            raise entries.error(f"expected each link once, found {link!r} again")
        balls = _balls(entries, "center", each[link].number() if link in each else grow)
        body = _of_positive(balls, link, "disabled spheres (radius of 0 or less)", model)
        if body is None:
            continue
        if used is not None and link not in used:
            model.notes.append(f"spheres of {link!r}, which is not among collision_link_names")
        elif link in replaced:
            model.notes.append(f"spheres of {link!r} that extra_collision_spheres replaces by disabled ones")
        elif link in extra:
            model.notes.append(f"spheres of {link!r}, which is an extra link")
        else:
            model.bodies[link] = body
    ignored = keys.pop("self_collision_ignore", None)
    if ignored is not None:  # an empty list is a rule, too: all pairs are checked
        model.ignored = frozenset() if ignored.empty else _pairs(ignored.mapping(None))
    margins = keys.pop("self_collision_buffer", None)
    if margins is not None and not margins.empty and any(each.number() for each in margins.mapping(None).values()):
        model.notes.append("self_collision_buffer, which enlarges spheres only where links are checked with each other")
    if "load_collision_spheres" in keys and not keys.pop("load_collision_spheres").flag():
        model.notes.append("load_collision_spheres: false, with which no spheres are used")
    model.note("keys that are not read", (key for key in (*unread, *keys) if key not in OF_CUROBO))
    return model


def _of_xrdf(keys: dict[str, Any], model: Model) -> dict[str, Any]:
    """Convert the keys of an XRDF file to cuRobo's own keys; use the geometry for collisions with the world."""
    keys = dict(keys)
    geometry, world = keys.pop("geometry").mapping(None), keys.pop("collision", None)
    selves = keys.pop("self_collision", None)
    if world is None:
        return keys
    chosen = world.mapping(("geometry", "buffer_distance"), required=("geometry",))
    name = chosen["geometry"].choice(geometry)
    model.note("geometries that are not used", (key for key in geometry if key != name))
    shapes = geometry[name].mapping(("spheres", "clone"), required=("spheres",))
    if "clone" in shapes:
        model.notes.append("key that is not read: clone")
    keys["collision_spheres"] = shapes["spheres"]
    if "buffer_distance" in chosen:
        keys["collision_sphere_buffer"] = chosen["buffer_distance"]
    if selves is not None:
        entries = selves.mapping(("geometry", "buffer_distance", "ignore"))
        if "geometry" in entries and entries["geometry"].text() != name:
            model.notes.append("another geometry for checks of links with each other")
        for key, own in (("ignore", "self_collision_ignore"), ("buffer_distance", "self_collision_buffer")):
            if key in entries:
                keys[own] = entries[key]
    return {key: node for key, node in keys.items() if key != "modifiers"}


def _names(node: Any) -> Collection[str]:
    return () if node is None or node.empty else node.mapping(None).keys()


def _curobo_text(robot: Robot, balls: Mapping[str, _Balls]) -> str:
    """Write the part of a cuRobo configuration that describes spheres and pairs. cuRobo can read this part alone."""
    quoted = {link: json.dumps(link, ensure_ascii="\x85" in link) for link in robot.link_names}
    lines = ["collision_link_names:", *(f"- {quoted[link]}" for link in balls), "collision_sphere_buffer: 0.0"]
    lines.append("collision_spheres:")
    for link, spheres in balls.items():
        lines.append(f"  {quoted[link]}:")
        for center, radius in zip(spheres.centers, spheres.radii, strict=True):
            lines += [f"  - center: [{', '.join(map(_decimal, center))}]", f"    radius: {_decimal(radius)}"]
    lines += ["self_collision_buffer:", *(f"  {quoted[link]}: 0.0" for link in balls)]
    after: dict[str, list[str]] = {}
    for a, b in skipped_with_bodies(robot):
        after.setdefault(a, []).append(quoted[b])
    lines.append("self_collision_ignore:" if after else "self_collision_ignore: {}")
    lines += [f"  {quoted[a]}: [{', '.join(others)}]" for a, others in after.items()]
    return "\n".join(lines) + "\n"


def _decimal(x: Any) -> str:
    """Write a number without an exponent, since YAML 1.1 reads a number such as 1e-5 as text."""
    return np.format_float_positional(x + 0.0, trim="0")


# -- pyroki and foam ------------------------------------------------------------------------------


def _read_pyroki(keys: dict[str, Any], file: Path) -> Model:
    """Read the spheres that pyroki's `RobotCollision.from_sphere_decomposition` takes."""
    model = Model()
    for link, entry in keys.items():
        shapes = entry.mapping(("centers", "radii"), required=("centers", "radii"))
        centers, radii = shapes["centers"].rows(3), shapes["radii"].numbers()
        if len(centers) != len(radii):
            raise entry.error(f"expected as many radii as centers, found {len(radii)} and {len(centers)}")
        body = _of_positive(list(zip(centers, radii, strict=True)), link, WITHOUT_SIZE, model)
        if body is not None:
            model.bodies[link] = body
    beside = _pairs_file(file)
    if beside.is_file():
        listed = _read(read_json, beside, "pairs of links").items()
        named = [[name.text() for name in pair.items(2)] for pair in listed]
        model.ignored = frozenset((min(a, b), max(a, b)) for a, b in named)
    return model


def _pairs_file(file: Path) -> Path:
    """Return the file of pairs that belongs to a file of pyroki's spheres, whose format cannot express pairs."""
    return file.with_name(f"{file.stem}.ignored.json")


def _read_foam(keys: dict[str, Any], file: Path) -> Model:
    """Read foam's database, which lists each ``LINK::MESH``'s spheres by branching factor and depth, finest last."""
    parts: dict[str, list[Body]] = {}
    model = Model()
    if set(keys) == set(OF_FOAM):
        raise FileError(f"{shown(file)}: expected spheres by the names of links, found the spheres of one mesh")
    for name, entry in keys.items():
        link, node = name.partition("::")[0], entry
        while "spheres" not in set(_keys(node)):
            levels = node.mapping(None) if node.kind == "mapping" else dict(enumerate(node.items()))
            if not levels:
                raise node.error("expected spheres, found none")
            last = max(levels, key=lambda key: _level(key, node))
            if len(levels) > 1:
                model.notes.append(f"{len(levels) - 1} coarser levels of {name!r}")
            node = levels[last]
        balls = _balls(node.mapping(OF_FOAM, required=("spheres",))["spheres"], "origin")
        body = _of_positive(balls, name, WITHOUT_SIZE, model)
        if body is not None:
            parts.setdefault(link, []).append(body)
    model.bodies |= {link: bodies[0] if len(bodies) == 1 else Body.union(bodies) for link, bodies in parts.items()}
    return model


def _level(key: Any, node: Node) -> int:
    if not re.fullmatch(r"\d+", str(key), re.ASCII):
        raise node.error(f"expected numbers of branches and levels as keys, or spheres, found {key!r}")
    return int(key)
