"""Read the inputs of commands: bodies, meshes, poses and robots, and the options for reading them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import loewner
from loewner._base import _archives, _rotations, _tables
from loewner._base._files import read_regular
from loewner._base._validate import Floats, Progress
from loewner.cli.output import progress_of
from loewner.ellipsoids.fits import DEFAULT_TOLERANCE
from loewner.errors import FileError, InputError, PoseError
from loewner.robots.description import link_bodies

# Largest size in bytes of a file with a pose; a matrix in text takes a few hundred bytes.
MOST_POSE_BYTES = 2**20


# Formats of pictures.
DRAWN = (".png", ".svg")


def expect_suffix(path: Path | None, option: str, endings: Sequence[str]) -> None:
    """Refuse a file without one of the endings before any work is done."""
    if path is not None and path.suffix.lower() not in endings:
        raise FileError(f"{option}: expected a {' or '.join(endings)} file, found {path}")


def refuse(options: argparse.Namespace, names: Iterable[str], message: str) -> None:
    """Refuse options that would silently be ignored. The message has a placeholder for the option."""
    for name in names:
        if getattr(options, name) != options.default(name):
            raise InputError(message.replace("{}", f"--{name.replace('_', '-')}", 1))


def command(
    commands: Any, name: str, what: str, examples: str, run: Callable[[argparse.Namespace], int] | None = None
) -> argparse.ArgumentParser:
    """Add a command whose help ends with examples. Unless the command has subcommands, `run` runs it."""
    raw = argparse.RawDescriptionHelpFormatter
    added: argparse.ArgumentParser = commands.add_parser(name, help=what, epilog=examples, formatter_class=raw)
    added.set_defaults(default=added.get_default, run=run, makes_folder=False)
    return added


class Adders(NamedTuple):
    """Functions that add options to a parser or a group: options of any kind, files, lengths in metres, and flags."""

    option: Callable[..., Any]
    file: Callable[..., Any]
    length: Callable[..., Any]
    flag: Callable[..., Any]


def adders(parser: Any) -> Adders:
    """Return the functions that add options to a parser or to a group."""
    add = parser.add_argument
    file, length = partial(add, type=Path, metavar="FILE"), partial(add, type=float, metavar="M")
    return Adders(add, file, length, partial(add, action="store_true"))


# Models of a mesh: its triangles, convex pieces, or its convex hull.
MODELS = ("surface", "pieces", "hull")

# The names that options for pieces, and options for surfaces, have in the library.
OF_PIECES = ("tolerance", "threshold", "max_pieces", "seed")
OF_SURFACES = ("radius", "solid")

SCENE_HELP = "obstacles and attached bodies (.yaml)"
POSE_HELP = '"x y z", "x y z qw qx qy qz" (metres; the quaternion\'s scalar first), or a file'


def add_mesh_options(command: argparse.ArgumentParser, default: str) -> None:
    """Add the options of commands that take meshes; `default` is the default model."""
    option, _, length, flag = adders(command)
    models = f"the triangles as they are, convex pieces, or the convex hull ({default}; pieces with their options)"
    option("--model", choices=MODELS, help=models)
    flag("--hull", help="the same as --model hull")
    option("--scale", type=float, default=1.0, help="factor for all lengths: 0.001 for millimetres (1)")
    length("--radius", help="for surfaces: radius of a ball around each point [m] (0)")
    solid = "for surfaces: with or without the enclosed space (with, if closed)"
    option("--solid", action=argparse.BooleanOptionalAction, help=solid)
    length("--tolerance", help="largest distance by which the pieces may stick out [m]")
    option("--threshold", type=float, help="concavity of a piece, 0.01 to 1 (0.05)")
    option("--max-pieces", type=int, metavar="N", help="at most this many pieces")
    option("--seed", type=int, help="seed of the decomposition (0)")
    command.set_defaults(usual_model=default)


def add_pair_options(command: argparse.ArgumentParser) -> None:
    """Add the options of commands that take two bodies at poses."""
    option, file, length, _ = adders(command)
    for name in ("a", "b"):
        file(name, metavar=name.upper(), help="a saved body (.npz) or a mesh")
        option(f"--pose-{name}", metavar="POSE", help=f"pose of {name.upper()}: {POSE_HELP} (the origin)")
    length("--margin", default=0.0, help="distance to keep [m] (0)")
    add_mesh_options(command, "surface")


def add_rule_options(command: argparse.ArgumentParser, start: str, end: str) -> None:
    """Add the options that allow contact at the ends of motions."""
    for rule, where in (("leave", start), ("reach", end)):
        what = f"two bodies or links that may be in contact at the {where} only; repeatable"
        command.add_argument(f"--{rule}", nargs=2, metavar=("A", "B"), action="append", default=[], help=what)


def apply_rules(scene: loewner.Scene, options: argparse.Namespace) -> None:
    """Apply the options of `add_rule_options` to a scene."""
    for rule, pairs in ((scene.leave, options.leave), (scene.reach, options.reach)):
        for pair in pairs:
            rule(*pair)


def add_robot_options(command: argparse.ArgumentParser, scene: str | None = SCENE_HELP) -> None:
    """Add the robot, and the options of commands that take a robot."""
    command.add_argument("urdf", type=Path, metavar="URDF", help="the robot: a URDF file")
    add_reading_options(command, scene)


def add_reading_options(command: argparse.ArgumentParser, scene: str | None = SCENE_HELP) -> None:
    """Add the options for reading a robot, and --scene unless its help is None."""
    option, _, _, flag = adders(command)
    add_robot_files(command, scene)
    option("--model", choices=link_bodies.MODELS, help=f"representation of meshes ({link_bodies.USUAL_MODEL})")
    flag("--decompose", help="the same as --model pieces")


def add_robot_files(parser: Any, scene: str | None = SCENE_HELP) -> None:
    """Add the options that name further files of a robot, and --scene unless its help is None."""
    file = adders(parser).file
    file("--srdf", help="groups, states, pairs that need no check")
    file("--package-dir", metavar="DIR", action="append", default=[], help="folder of packages; repeatable")
    if scene is not None:
        file("--scene", help=scene)


def bodies(paths: Sequence[Path], options: argparse.Namespace) -> Iterator[loewner.Body]:
    """Yield saved bodies and the bodies of meshes, in the given order. Mesh options require at least one mesh."""
    if all(path.suffix.lower() == ".npz" for path in paths):
        file_names = ", ".join(path.name for path in paths)
        of_meshes = ("model", *OF_SURFACES, *OF_PIECES, "scale", "hull")
        refuse(options, of_meshes, f"{{}}: expected a mesh to make a body of, found saved bodies, {file_names}")
    return (body(path, options) for path in paths)


def body(path: Path, options: argparse.Namespace) -> loewner.Body:
    """Load a saved body, or make the body of a mesh."""
    if path.suffix.lower() != ".npz":
        return from_mesh(path, options)
    model(options)  # refuses incompatible options
    for name in ("model", "radius", "solid", "tolerance"):
        if getattr(options, name, None) is not None:
            raise InputError(f"--{name}: expected a mesh to make a body of, found a saved body, {path.name}")
    return loewner.Body.load(path)


def from_mesh(
    path: Any, options: argparse.Namespace, *, tol: float = DEFAULT_TOLERANCE, progress: Progress | None = None
) -> loewner.Body:
    """Make the body of a mesh, and show a progress bar unless the caller already shows one."""
    chosen = model(options)
    if chosen == "surface":
        return loewner.Body.from_surface(path, scale=options.scale, **given(options, OF_SURFACES))
    if progress is None:
        with progress_of(path.name) as shown:
            return from_mesh(path, options, tol=tol, progress=shown)
    made_of, decompose = given(options, OF_PIECES), chosen == "pieces"
    return loewner.Body.from_mesh(path, decompose=decompose, scale=options.scale, tol=tol, progress=progress, **made_of)


def model(options: argparse.Namespace) -> str:
    """Return the model that the options select for a mesh."""
    if options.hull and options.model not in (None, "hull"):
        raise InputError(f"--hull: expected no other model with it, found --model {options.model}")
    of_pieces, of_surfaces = given(options, OF_PIECES), given(options, OF_SURFACES)
    chosen = "hull" if options.hull else options.model
    if chosen is None:
        chosen = "surface" if of_surfaces else "pieces" if of_pieces else options.usual_model
    for only, alien in (("pieces", of_pieces), ("surface", of_surfaces)):
        if alien and chosen != only:
            name = next(iter(alien)).replace("_", "-")
            raise InputError(f"--{name}: expected it with --model {only} only, found it with --model {chosen}")
    return str(chosen)


def given(options: argparse.Namespace, names: Sequence[str]) -> dict[str, Any]:
    """Return the options that were given, keyed by name."""
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}


def pose(text: str | None, name: str) -> Floats | None:
    """Read a pose from numbers, or from a matrix in a file."""
    if text is None:
        return None
    if Path(text).suffix.lower() in (".npy", ".txt"):
        return _pose_file(Path(text))
    wanted = f'{name}: expected "x y z", "x y z qw qx qy qz", or a .npy or .txt file with a 4x4 matrix'
    numbers = row(text, wanted, PoseError)
    if len(numbers) not in (3, 7) or not np.isfinite(numbers).all():
        raise PoseError(f"{wanted}, found {text!r}")
    return pose_of(numbers, name)


def pose_of(numbers: Sequence[float], name: str) -> Floats:
    """Make a pose from a position and, if there are seven numbers, a quaternion."""
    rotation = _rotations.from_quaternion(numbers[3:], name) if len(numbers) == 7 else np.eye(3)
    return _rotations.pose_of(rotation, numbers[:3])


def poses(path: Path) -> Floats:
    """Read the poses of a motion from a file with a line of numbers for each pose, or with matrices."""
    data = read_regular(path, "a file of poses", MOST_POSE_BYTES)
    if path.suffix.lower() == ".npy":
        Ts = _archives.numbers(data, str(path), "4x4 matrices of numbers")
        if np.ndim(Ts) != 3 or Ts.shape[1:] != (4, 4) or len(Ts) < 2:
            raise PoseError(f"{path}: expected shape (n, 4, 4) with n of 2 or more, found {np.shape(Ts)}")
        return np.asarray(Ts)
    rows = _tables.table(data, str(path))
    if rows.shape[1] not in (3, 7) or len(rows) < 2:
        raise PoseError(
            f'{path}: expected two lines "x y z" or "x y z qw qx qy qz" or more, found {rows.shape[0]} of '
            f"{rows.shape[1]} numbers"
        )
    return np.array([pose_of(row, f"{path}, pose {k}") for k, row in enumerate(rows.tolist())])


def _pose_file(path: Path) -> Floats:
    data = read_regular(path, "a pose file", MOST_POSE_BYTES)
    if path.suffix.lower() == ".npy":
        T = _archives.numbers(data, str(path), "a 4x4 matrix of numbers")
    else:
        try:
            lines = data.decode("utf-8-sig").splitlines()
            T = np.array([_tables.row(line, commas=False) for line in lines if line.strip()])
        except ValueError as error:
            raise FileError(f"{path}: expected a 4x4 matrix of numbers, found something else ({error})") from None
    if np.shape(T) != (4, 4):
        raise PoseError(f"{path}: expected shape (4, 4), found {np.shape(T)}")
    return np.asarray(T)


def robot(options: argparse.Namespace) -> loewner.Robot:
    """Read the robot while a progress bar is shown."""
    if options.decompose and options.model not in (None, "pieces"):
        raise InputError(f"--decompose: expected no other model with it, found --model {options.model}")
    meshes: Any = "pieces" if options.decompose else options.model or link_bodies.USUAL_MODEL
    with progress_of(options.urdf.name) as progress:
        return loewner.Robot.from_urdf(
            options.urdf, srdf=options.srdf, package_dirs=options.package_dir, meshes=meshes, progress=progress
        )


def scene(options: argparse.Namespace) -> loewner.Scene:
    """Read the scene, which is empty without --scene."""
    return loewner.Scene() if options.scene is None else loewner.load_scene(options.scene)


def largest_margin(scene: loewner.Scene) -> float:
    """Return the largest margin of a scene [m]."""
    return max(scene.margin, *scene.margins.values(), 0.0)


def checker(options: argparse.Namespace, robot: loewner.Robot, scene: loewner.Scene) -> loewner.CollisionChecker:
    """Make a checker. Refuse a robot without pairs to check, for which every configuration would count as free."""
    new_checker = loewner.CollisionChecker(robot, scene)
    if not new_checker.checked_pairs:
        raise InputError(
            f"{options.urdf}: expected pairs to check, found none: links are rigidly joined, adjacent or disabled, and "
            "no body of a scene can touch them; any configuration would count as free"
        )
    return new_checker


def row(text: str, wanted: str, kind: type[InputError] = InputError) -> list[float]:
    """Read numbers from a text. If this fails, the error message begins with `wanted`."""
    try:
        return _tables.row(text)
    except ValueError as error:
        raise kind(f"{wanted}, found {text!r} ({error})") from None
