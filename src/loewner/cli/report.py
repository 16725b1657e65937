"""``loewner report``: pack one query and its answers into a file, or rerun the query in such a file.

The file is a zip archive. Bodies, meshes, poses, configurations, robots and scenes are stored as members of the
archive, in the formats that other commands read; `report.json` holds the options, the versions and the answers.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import platform
import re
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

import loewner
from loewner import Verdict
from loewner._base import _archives, _json, _validate
from loewner._base._files import read_regular, replacing, shown
from loewner._native import library
from loewner.bodies import arrays_of, packed_of
from loewner.cli import configurations, inputs
from loewner.cli.info import installed
from loewner.cli.output import COLLIDING, FREE, print_table
from loewner.errors import ConvergenceError, FileError, InputError, LoewnerError, MissingExtraError
from loewner.robots.description import link_bodies
from loewner.robots.description.urdf import read_urdf
from loewner.robots.description.xml_elements import Element, read_xml

EXAMPLES = """examples:
  loewner report check cup.stl spoon.stl --pose-b "0 0 0.02" -o wrong.zip
  loewner report robot panda.urdf --srdf panda.srdf --scene shelf.yaml --configs q.npy -o wrong.zip
  loewner report rerun wrong.zip

exit status of rerun: 0 the answers here are the same to the last bit, 1 some differ, 2 error
"""

# Options of a query that a report holds, with their types.
OPTIONS: dict[str, dict[str, type]] = {
    "check": dict.fromkeys(("margin", "scale", "radius", "tolerance", "threshold"), float)
    | {"model": str, "hull": bool, "solid": bool, "max_pieces": int, "seed": int},
    "robot": {"model": str, "decompose": bool},
}
USUAL: dict[str, Any] = {"margin": 0.0, "scale": 1.0, "hull": False, "decompose": False, "usual_model": "surface"}

# The member with the options, the versions and the answers. The names of all members match `PLAIN`.
DOCUMENT, FORMAT, VERSION = "report.json", "loewner-report", 1
PLAIN = re.compile(r"\w[\w.-]*", re.ASCII)

# Limits on a report. MOST_BYTES applies to the archive, and to the sum of its members.
MOST_BYTES, MOST_MEMBERS = 2**30, 10_000

# Largest number of characters of an answer that a table shows.
SHOWN = 70


def add(commands: Any) -> None:
    """Add the command."""
    report = inputs.command(commands, "report", "pack one query and its answers into a file", EXAMPLES)
    inner = report.add_subparsers(required=True, metavar="COMMAND")
    pair = inputs.command(inner, "check", "a query of two bodies", EXAMPLES, _write)
    inputs.add_pair_options(pair)
    robot = inputs.command(
        inner, "robot", "configurations of a robot, and the straight motions between them", EXAMPLES, _write
    )
    inputs.add_robot_options(robot)
    inputs.adders(robot).file("--configs", required=True, help="configurations, or a path (.npy, .csv or .json)")
    for command, query, pack in ((pair, "check", _pack_pair), (robot, "robot", _pack_robot)):
        inputs.adders(command).file("-o", "--out", required=True, help="the report to write (.zip)")
        command.set_defaults(query=query, pack=pack)
    again = inputs.command(inner, "rerun", "run the query of a report again, and compare the answers", EXAMPLES, _rerun)
    inputs.adders(again).file("file", help="a report (.zip)")


def _write(options: argparse.Namespace) -> int:
    if options.out.suffix.lower() != ".zip":
        raise InputError(f"--out: expected a name that ends in .zip, found {options.out.name!r}")
    kept = inputs.given(options, [*OPTIONS[options.query]])
    with tempfile.TemporaryDirectory() as folder:
        options.pack(options, Path(folder))
        answers = _answered(options.query, Path(folder), kept)
        document = {"format": FORMAT, "version": VERSION, "query": options.query, "options": kept}
        document |= {"versions": _versions(), "answers": answers}
        Path(folder, DOCUMENT).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        members = sorted(Path(folder).iterdir())
        if (size := sum(member.stat().st_size for member in members)) > MOST_BYTES or len(members) > MOST_MEMBERS:
            raise InputError(f"expected inputs of at most {MOST_BYTES} bytes, found {size} in {len(members)} files")
        with replacing(options.out) as target, zipfile.ZipFile(target, "x") as archive:
            for member in members:  # dates are omitted, so that the same query gives the same file
                archive.writestr(zipfile.ZipInfo(member.name), member.read_bytes(), zipfile.ZIP_DEFLATED)
    rows = [(name, _shown(value)) for name, value in answers.items()]
    print_table(("answer", "here"), rows, f"loewner report {options.query}")
    print(f"{shown(options.out)} contains {', '.join(member.name for member in members)}")
    return FREE


def _rerun(options: argparse.Namespace) -> int:
    document, here = rerun(options.file)
    there = document["answers"]
    different = [name for name in here if json.dumps(there.get(name)) != json.dumps(here[name])]
    rows = [(name, _shown(document["versions"].get(name)), _shown(x), "") for name, x in _versions().items()]
    rows += [(name, *_both(there.get(name), x), "differs" * (name in different)) for name, x in here.items()]
    print_table(("answer", "in the report", "here", "result"), rows, f"loewner report {document['query']}")
    print(f"DIFFERENT: {', '.join(different)}" if different else "THE SAME: all answers, to the last bit")
    return COLLIDING if different else FREE


def rerun(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read a report and rerun its query. Return the document of the report, and the answers on this machine.

    Raises
    ------
    FileError
        If the file is not a report, is damaged, or contains inputs that cannot be read.
    MissingExtraError
        If a package that the inputs need is not installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        document = _unpacked(path, Path(folder))
        try:
            return document, _answered(document["query"], Path(folder), document["options"])
        except MissingExtraError:
            raise
        except LoewnerError as error:
            raise FileError(f"{path}: {error}") from None


# -- inputs -----------------------------------------------------------------------------------


def _pack_pair(options: argparse.Namespace, folder: Path) -> None:
    for name, path, pose in (("a", options.a, options.pose_a), ("b", options.b, options.pose_b)):
        _copy(path, folder / name, "a saved body or a mesh")
        T = inputs.pose(pose, f"--pose-{name}")
        np.save(folder / f"pose_{name}.npy", np.eye(4) if T is None else T)


def _pack_robot(options: argparse.Namespace, folder: Path) -> None:
    """Pack a robot without paths, comments and elements that affect no answer."""
    names: dict[str, str] = {}  # maps the names of meshes in the URDF to members
    for link, shapes in read_urdf(options.urdf).shapes.items():
        for shape in (shape for shape in shapes if shape.kind == "mesh" and shape.file_name not in names):
            file = link_bodies.mesh_file(shape, link, options.urdf, options.package_dir)
            names[shape.file_name] = _copy(file, folder / f"mesh_{len(names)}", "a mesh file")
    root = read_xml(options.urdf, "a URDF")
    root.children = [child for child in root.children if child.tag in ("link", "joint")]
    for element in root.all("link"):
        element.children = list(element.all("collision"))
    _write_xml(root, folder / "robot.urdf", names)
    if options.srdf is not None:
        _write_xml(read_xml(options.srdf, "an SRDF"), folder / "robot.srdf", {})
    if options.scene is not None:
        loewner.save_scene(loewner.load_scene(options.scene), folder / "scene.yaml")
    _copy(options.configs, folder / "configs", "configurations")


def _copy(path: Path, stem: Path, what: str) -> str:
    """Copy a file to `stem` with the file's own suffix; return the new name."""
    target = stem.with_name(stem.name + path.suffix.lower())
    target.write_bytes(read_regular(path, what, MOST_BYTES))
    return target.name


def _write_xml(root: Element, path: Path, names: Mapping[str, str]) -> None:
    """Write elements with their attributes, and replace the names of meshes."""

    def copied(element: Element) -> ElementTree.Element:
        copy = ElementTree.Element(element.tag, element.attributes)
        if element.tag == "mesh":
            copy.set("filename", names.get(element.attributes.get("filename", "").strip(), ""))
        copy.extend(map(copied, element.children))
        return copy

    path.write_bytes(ElementTree.tostring(copied(root), encoding="utf-8"))


def _unpacked(path: Path, folder: Path) -> dict[str, Any]:
    """Write the members of a report into a folder, and return its document after checking it."""
    data = read_regular(path, "a report", MOST_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            infos = archive.infolist()
            size = sum(info.file_size for info in infos)
            if size > MOST_BYTES or len(infos) > MOST_MEMBERS:
                raise InputError(f"more than {MOST_BYTES} bytes or {MOST_MEMBERS} members")
            # Not all file systems distinguish case.
            if len({info.filename.lower() for info in infos if PLAIN.fullmatch(info.filename)}) != len(infos):
                raise InputError("members whose names are not plain, or occur twice")
            for info in infos:
                (folder / info.filename).write_bytes(archive.read(info))
        document = _json.parsed((folder / DOCUMENT).read_bytes(), DOCUMENT)
    except MemoryError:  # not a fault of the file
        raise
    except Exception as error:  # a damaged zip raises any of a dozen exceptions, including zlib's
        reason = f"no member {DOCUMENT}" if isinstance(error, FileNotFoundError) else error
        raise FileError(f"{path}: expected a file by loewner report, found something else ({reason})") from None
    if fault := _fault(document):
        raise FileError(f"{path}: {DOCUMENT}: {fault}")
    return dict(document)


def _fault(document: Any) -> str:
    """Describe the first fault of a document, or return ""."""
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        return f'expected "format": "{FORMAT}", found another kind of file'
    texts = {key: _validate.short(document.get(key)) for key in ("version", "query", "options", "versions", "answers")}
    if document.get("version") != VERSION:
        return f"expected version {VERSION}, found {texts['version']}; a newer loewner may have written it"
    query = document.get("query")
    if query not in list(OPTIONS):
        return f"expected a query among {', '.join(OPTIONS)}, found {texts['query']}"
    for key in ("options", "versions", "answers"):
        if not isinstance(document.get(key), dict):
            return f"{key}: expected an object, found {texts[key]}"
    models = link_bodies.MODELS if query == "robot" else inputs.MODELS
    for name, value in document["options"].items():
        if type(value) is not OPTIONS[query].get(name) or (name == "model" and value not in models):
            return f"expected the options of loewner report {query}, found {name[:40]!r}: {_validate.short(value)}"
    return ""


# -- answers ----------------------------------------------------------------------------------


def _answered(query: str, folder: Path, kept: Mapping[str, Any]) -> dict[str, Any]:
    """Run a query on the inputs in a folder. Error messages do not name the folder."""
    options = argparse.Namespace(**(dict.fromkeys(OPTIONS["check"]) | USUAL | dict(kept)))
    try:
        return {"check": _of_pair, "robot": _of_robot}[query](options, folder)
    except LoewnerError as error:
        raise type(error)(str(error).replace(f"{folder}{os.sep}", "")) from None


def _of_pair(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    Ta, Tb = (inputs.pose(str(folder / f"pose_{name}.npy"), "pose") for name in "ab")
    a, b = (inputs.body(_found(folder, name), options) for name in "ab")
    margin = options.margin
    bounds = loewner.distance(a, Ta, b, Tb)
    return {
        "bodies": {"a": _checksum(a), "b": _checksum(b)},
        "certified": _names(loewner.classify(a, Ta, b, Tb, margin=margin)),
        "estimate": _tried(lambda: _names(loewner.collide(a, Ta, b, Tb, method="estimate", margin=margin))),
        "exact": _tried(lambda: _names(loewner.collide(a, Ta, b, Tb, margin=margin))),
        "bounds": [bounds.lower, bounds.upper],
        "distance": _tried(lambda: _measured(loewner.distance(a, Ta, b, Tb, exact=True))),
    }


def _of_robot(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    options.urdf, options.package_dir = folder / "robot.urdf", []
    files = (folder / "robot.srdf", folder / "scene.yaml")
    options.srdf, options.scene = (file if file.exists() else None for file in files)
    robot, file = inputs.robot(options), _found(folder, "configs")
    checker = inputs.checker(options, robot, inputs.scene(options))
    Q = np.atleast_2d(robot.checked(configurations.read(file, robot), file.name))
    Q = _validate.finite_array(Q, file.name, (None, robot.dof))
    bounds = checker.distance(Q)
    bodies = {**robot.bodies, **{name: checker.scene[name] for name in checker.scene}}
    answers = {
        "bodies": {name: _checksum(body) for name, body in bodies.items()},
        "certified": _names(checker.classify(Q)),
        "exact": _tried(lambda: _names(checker.collide(Q))),
        "exact, one by one": _tried(lambda: [_names(checker.collide(q)) for q in Q]),
        "bounds": np.stack([bounds.lower, bounds.upper], axis=-1).tolist(),
        "distance": _tried(lambda: _measured(checker.distance(Q, exact=True))),
    }
    if len(Q) > 1:
        edges = checker.certify_edges(Q[:-1], Q[1:])
        fractions = [None if np.isnan(fraction) else fraction for fraction in edges.fraction.tolist()]
        answers["motions"] = {"verdict": _names(edges.verdict), "fraction": fractions}
    return answers


def _found(folder: Path, stem: str) -> Path:
    """Return the path of an input, whose suffix depends on its format."""
    files = list(folder.glob(f"{stem}.*"))
    if len(files) != 1:
        raise FileError(f"expected one input called {stem}, found {len(files)}")
    return files[0]


def _measured(found: Any) -> dict[str, Any]:
    fields = ("distance", "witness_a", "witness_b", "normal", "names")
    return {name: np.asarray(getattr(found, name)).tolist() for name in fields if hasattr(found, name)}


def _names(verdicts: Any) -> Any:
    """Return the names of verdicts. An exact answer is a boolean."""
    return [_names(each) for each in verdicts] if np.ndim(verdicts) else Verdict(int(verdicts)).name


def _tried(answer: Callable[[], Any]) -> Any:
    """Return an answer, or the error that prevented it."""
    try:
        return answer()
    except ConvergenceError as error:
        return f"error: {error}"


def _checksum(body: loewner.Body) -> str:
    """Compute the checksum of a body's numbers, which shows whether the same mesh became another body."""
    return _archives.digest(arrays_of(packed_of(body)))[:16]


def _versions() -> dict[str, str]:
    """Return the versions on which answers may depend. The result does not identify a machine or a user."""
    level = library.level()
    return {
        "loewner": loewner.__version__,
        "kernels": f"Numba {installed('numba')}" if level is None else f"native library, {level}",
        "processor": f"{platform.machine()}, {', '.join(library.levels()) or 'levels not known'}",
        "system": platform.system(),
        "python": f"{platform.python_version()}, numpy {installed('numpy')}, scipy {installed('scipy')}",
    }


# -- tables -----------------------------------------------------------------------------------


def _shown(value: Any) -> str:
    text = json.dumps(value)  # escapes all characters that control a terminal
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def _both(there: Any, here: Any) -> tuple[str, str]:
    """Format two answers. For lists and objects, format the first entries that differ."""
    if isinstance(there, dict) and isinstance(here, dict):
        there, here = list(there.items()), list(here.items())
    if isinstance(there, list) and isinstance(here, list):
        for k, (one, other) in enumerate(zip(there, here, strict=False)):
            if json.dumps(one) != json.dumps(other):
                return f"[{k}]: {_shown(one)}", f"[{k}]: {_shown(other)}"
    return _shown(there), _shown(here)
