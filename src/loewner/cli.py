"""The command line: parse, call the public API, print.

Exit status: 0 done, or free; 1 colliding (of many configurations, one or more); 2 error; 3 ambiguous (only for
``loewner check --method certified``).
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import os
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import loewner
from loewner import _validate
from loewner._files import read_regular
from loewner._rotations import from_quaternion
from loewner._validate import Floats
from loewner.compilation import PARTS, compile_kernels
from loewner.errors import FileError, InputError, LoewnerError, PoseError

if TYPE_CHECKING:
    from rich.progress import Progress

    from loewner import paper

FREE, COLLIDING, ERROR, AMBIGUOUS = 0, 1, 2, 3

# By how much of the mesh's volume pieces may exceed it without a word.
WORTH_TELLING = 0.01

# Configurations between two steps of the progress bar, and pairs that a table lists at most.
AT_ONCE = 50_000

# The largest file of configurations that is read [bytes].
MOST_BYTES = 2**33

LISTED = 20

FIT_EXAMPLES = """examples:
  loewner fit upper_arm.stl forearm.dae -o bodies
  loewner fit gripper.obj -o bodies --threshold 0.02    more pieces, a closer fit
  loewner fit table.glb -o bodies --hull                one piece: the convex hull
"""
CHECK_EXAMPLES = """examples:
  loewner check arm.npz table.stl --pose-b "0.5 0 0"
  loewner check arm.npz table.npz --pose-b "0.5 0 0 0.924 0 0 0.383" --margin 0.01
  loewner check arm.npz table.npz --pose-a pose.npy --method certified --json

poses: "x y z" in metres, "x y z qw qx qy qz" (quaternion in the order wxyz), or a 4x4 matrix in a .npy or .txt file

exit status: 0 free, 1 colliding (touching is colliding), 2 error, 3 ambiguous (--method certified only)
"""
VIEW_EXAMPLES = """examples:
  loewner view arm.npz table.stl --pose-b "0.5 0 0"
  loewner view --robot panda.urdf --srdf panda.srdf --scene kitchen.yaml --package-dir robots

The page is served on this machine, at the address that is printed; Ctrl+C closes it.
"""
ROBOT_EXAMPLES = """examples:
  loewner robot info panda.urdf --srdf panda.srdf
  loewner robot check panda.urdf --srdf panda.srdf --scene shelf.yaml --random 10000
"""
INFO_EXAMPLES = """examples:
  loewner robot info panda.urdf
  loewner robot info ~/robots/panda.urdf --srdf panda.srdf --package-dir ~/robots --package-dir ~/meshes
"""
MARGIN_HELP = (
    "metres that each pair with a body of the scene keeps at least, whatever margins the scene gives; those that are "
    "larger stay; links keep none among each other unless the scene gives one"
)
ROBOT_CHECK_EXAMPLES = """examples:
  loewner robot check panda.urdf --srdf panda.srdf --state ready
  loewner robot check panda.urdf --srdf panda.srdf --scene shelf.yaml --random 100000 --seed 7
  loewner robot check panda.urdf --scene shelf.yaml --configs path.csv --margin 0.02 --json

configurations: a .npy file of shape (N, dof), or a .csv file with one line each, whose first line may name the columns

exit status: 0 all free, 1 one or more colliding, 2 error
"""
PAPER_EXAMPLES = """examples:
  loewner paper                                      the paper's 1,000 pairs
  loewner paper --pairs 100000 --out report --json counts.json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        What follows ``loewner``; default: those of the process.

    Returns
    -------
    int
        The exit status: 0 for free or done, 1 for colliding, 2 for an error, 3 for ambiguous.

    Examples
    --------
    >>> from loewner import Body, cli
    >>> Body.box([1, 1, 1]).save("box.npz")
    >>> cli.main(["check", "box.npz", "box.npz", "--pose-b", "3 0 0"])  # doctest: +ELLIPSIS
    FREE...
    0
    """
    try:
        options = _parser().parse_args(None if arguments is None else _words(arguments))
        with _any_name_printed(), _warnings_as_lines():
            status = int(options.run(options))
            sys.stdout.flush()
        return status
    except LoewnerError as error:
        print(f"loewner: error: {error}", file=sys.stderr)
    except BrokenPipeError:
        # The reader left (`| head`). Python would fail once more when it closes standard output.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        print("loewner: interrupted", file=sys.stderr)
    except Exception:
        # Python's own status for a crash is 1, which here says "colliding".
        traceback.print_exc()
    return ERROR


@contextmanager
def _any_name_printed() -> Iterator[None]:
    """Escape what standard output cannot encode, such as names of files that are not UTF-8, instead of failing."""
    out = sys.stdout
    if not isinstance(out, io.TextIOWrapper):
        yield
        return
    before = out.errors
    out.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        out.reconfigure(errors=before)


def _words(arguments: Any) -> list[str]:
    words = _validate.listed(arguments, "arguments")
    for word in words:
        if not isinstance(word, str):
            raise InputError(f"arguments: expected text only, found {_validate.short(word)}")
    return words


def _parser() -> argparse.ArgumentParser:
    raw: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter}
    parser = argparse.ArgumentParser(prog="loewner", description=loewner.__doc__)
    parser.add_argument("--version", action="version", version=f"loewner {loewner.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    fit = commands.add_parser("fit", help="meshes to bodies, saved as .npz", epilog=FIT_EXAMPLES, **raw)
    fit.add_argument(
        "meshes", nargs="+", type=Path, metavar="MESH", help="STL, OBJ, PLY, OFF, GLB, glTF or DAE, in metres"
    )
    fit.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="folder for the .npz files")
    _add_mesh_options(fit)
    fit.add_argument("--tol", type=float, default=1e-4, help="certified log-volume gap of the fits (1e-4)")
    fit.set_defaults(run=_fit)

    check = commands.add_parser("check", help="do two bodies touch, how far apart?", epilog=CHECK_EXAMPLES, **raw)
    check.add_argument("a", metavar="A", type=Path, help="a saved body (.npz) or a mesh")
    check.add_argument("b", metavar="B", type=Path)
    check.add_argument("--pose-a", metavar="POSE", help="where A is (the origin)")
    check.add_argument("--pose-b", metavar="POSE", help="where B is (the origin)")
    check.add_argument("--method", choices=("certified", "estimate", "exact"), default="exact", help="default: exact")
    check.add_argument("--margin", type=float, default=0.0, metavar="M", help="metres to keep (0)")
    check.add_argument("--json", action="store_true", help="print JSON")
    _add_mesh_options(check)
    check.set_defaults(run=_check)

    robot = commands.add_parser("robot", help="a robot: what it is, is it free?", epilog=ROBOT_EXAMPLES, **raw)
    _add_robot_commands(robot.add_subparsers(required=True, metavar="COMMAND"), raw)

    view = commands.add_parser("view", help="two bodies, or a robot, in the browser", epilog=VIEW_EXAMPLES, **raw)
    view.add_argument("a", metavar="A", type=Path, nargs="?", help="a saved body (.npz) or a mesh")
    view.add_argument("b", metavar="B", type=Path, nargs="?")
    view.add_argument("--pose-a", metavar="POSE", help="where A is at first (the origin); as in loewner check")
    view.add_argument("--pose-b", metavar="POSE", help="where B is at first (next to A)")
    view.add_argument("--margin", type=float, default=0.0, metavar="M", help="metres that A and B keep (0)")
    view.add_argument("--robot", dest="urdf", metavar="URDF", type=Path, help="a robot instead of two bodies")
    view.add_argument("--srdf", metavar="SRDF", type=Path, help="its states and disabled pairs")
    view.add_argument("--scene", metavar="YAML", type=Path, help="what stands around it (docs/scenes.md)")
    view.add_argument("--package-dir", metavar="DIR", type=Path, action="append", default=[], help="for package://")
    view.add_argument("--decompose", action="store_true", help="split meshes of the robot that are not convex")
    view.add_argument("--port", type=int, default=0, help="default: any that is free")
    view.add_argument("--no-browser", action="store_true", help="only print the address")
    _add_mesh_options(view)
    view.set_defaults(run=_view)

    compiling = commands.add_parser("compile", help="compile all kernels now, on all cores, instead of at first use")
    compiling.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="some of it (default: all)")
    compiling.set_defaults(run=_compile)

    paper = commands.add_parser("paper", help="the paper's experiment, its tables", epilog=PAPER_EXAMPLES, **raw)
    paper.add_argument("--pairs", type=int, default=1000, help="1000")
    paper.add_argument("--seed", type=int, default=0, help="0")
    paper.add_argument("--dataset", default="radius", help="radius (the paper's) or volume")
    paper.add_argument("--out", type=Path, metavar="DIR", help="folder for the report and figures")
    paper.add_argument("--json", type=Path, metavar="FILE", help="file for the counts")
    paper.set_defaults(run=_paper)
    return parser


def _add_mesh_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("--hull", action="store_true", help="take the convex hull of a mesh; do not decompose it")
    command.add_argument("--scale", type=float, default=1.0, help="factor for all lengths: 0.001 for millimetres (1)")
    command.add_argument("--threshold", type=float, default=0.05, help="concavity of a piece, 0.01 to 1 (0.05)")
    command.add_argument("--max-pieces", type=int, metavar="N", help="at most this many pieces")
    command.add_argument("--seed", type=int, default=0, help="seed of the decomposition (0)")


def _add_robot_commands(commands: Any, raw: dict[str, Any]) -> None:
    info = commands.add_parser("info", help="links, joints and pairs of a robot", epilog=INFO_EXAMPLES, **raw)
    info.set_defaults(run=_robot_info)
    check = commands.add_parser(
        "check", help="which configurations are in collision?", epilog=ROBOT_CHECK_EXAMPLES, **raw
    )
    check.set_defaults(run=_robot_check)
    for command in (info, check):
        command.add_argument("urdf", type=Path, metavar="URDF")
        command.add_argument("--srdf", type=Path, metavar="FILE", help="groups, states, pairs that need no check")
        command.add_argument(
            "--package-dir",
            type=Path,
            metavar="DIR",
            action="append",
            default=[],
            help="folder of packages; repeatable",
        )
        command.add_argument("--decompose", action="store_true", help="split meshes that are not convex")
    check.add_argument("--scene", type=Path, metavar="FILE", help="obstacles and attached bodies (.yaml)")
    which = check.add_mutually_exclusive_group(required=True)
    which.add_argument("--random", type=int, metavar="N", help="N random configurations within the limits")
    which.add_argument("--configs", type=Path, metavar="FILE", help="configurations (.npy or .csv)")
    which.add_argument("--state", metavar="NAME", help="a state of the SRDF")
    check.add_argument("--seed", type=int, default=0, help="seed of --random (0)")
    check.add_argument("--margin", type=float, metavar="M", help=MARGIN_HELP)
    check.add_argument("--json", action="store_true", help="print JSON")


# -- loewner view -------------------------------------------------------------------------------


def _view(options: argparse.Namespace) -> int:
    import webbrowser

    answer = sys.stdout
    with redirect_stdout(sys.stderr):  # where viser's greetings belong
        page = _view_robot(options) if options.urdf is not None else _view_pair(options)
        print(f"{page.url}  (Ctrl+C closes it)", file=answer, flush=True)
        if not options.no_browser:
            webbrowser.open(page.url)
        page.wait()
    return 0


def _view_pair(options: argparse.Namespace) -> Any:
    from loewner import viewer

    if options.a is None or options.b is None:
        raise InputError("view: expected two bodies, A and B, or --robot URDF")
    _refuse(options, ("srdf", "scene", "package_dir", "decompose"), "with --robot only, found it with A and B")
    Ta, Tb = _pose(options.pose_a, "--pose-a"), _pose(options.pose_b, "--pose-b")
    a, b = _body(options.a, options), _body(options.b, options)
    if Tb is None:
        Tb = np.eye(4) if Ta is None else Ta.copy()
        Tb[0, 3] += a.outer.bounding_box()[1][:, 0].max() - b.outer.bounding_box()[0][:, 0].min()
    mesh_a, mesh_b = (None if path.suffix.lower() == ".npz" else path for path in (options.a, options.b))
    return viewer.show_pair(a, Ta, b, Tb, margin=options.margin, mesh_a=mesh_a, mesh_b=mesh_b, port=options.port)


def _view_robot(options: argparse.Namespace) -> Any:
    from loewner import viewer

    if options.a is not None:
        raise InputError(f"view: expected no A and B with --robot, found {options.a}")
    _refuse(options, ("pose_a", "pose_b", "hull", "threshold", "max_pieces", "seed"), "with A and B only, not --robot")
    _refuse(options, ("margin",), "with A and B only, not --robot: margins of a robot are the scene's")
    scene = None if options.scene is None else loewner.load_scene(options.scene)
    if scene is not None and len(scene) == 0:
        raise InputError(
            f"{options.scene}: expected a scene with bodies, found none; for the robot alone, drop --scene"
        )
    return viewer.show_robot(loewner.CollisionChecker(_robot(options), scene), port=options.port)


def _refuse(options: argparse.Namespace, names: Sequence[str], where: str) -> None:
    """Refuse what would be passed over in silence."""
    defaults = _parser().parse_args(["view"])
    for name in names:
        if getattr(options, name) != getattr(defaults, name):
            raise InputError(f"view: expected --{name.replace('_', '-')} {where}")


# -- loewner compile ----------------------------------------------------------------------------


def _compile(options: argparse.Namespace) -> int:
    if not sys.stderr.isatty():  # where no bar shows
        print(f"loewner: compiling {', '.join(options.only)}; takes a minute or two", file=sys.stderr, flush=True)
    with _progress() as bar:
        task = bar.add_task("compiling", total=None)
        folder = compile_kernels(
            options.only, progress=lambda done, total: bar.update(task, completed=done, total=total)
        )
    print(f"compiled into {folder}")
    return 0


# -- loewner fit --------------------------------------------------------------------------------


def _fit(options: argparse.Namespace) -> int:
    from rich.table import Table

    targets = [options.out / f"{mesh.stem}.npz" for mesh in options.meshes]
    twice = {t.name for t in targets if targets.count(t) > 1}
    if twice:
        raise InputError(f"MESH: expected meshes with different names, found two for {', '.join(sorted(twice))}")
    table = Table(
        "body", "pieces", "vertices", "inner, litres", "outer, litres", "gap", "covering", title="loewner fit"
    )
    with _progress() as progress:
        task = progress.add_task("", total=len(targets))
        for mesh, target in zip(options.meshes, targets, strict=True):
            progress.update(task, description=mesh.name)
            body = _from_mesh(mesh, options, tol=options.tol)
            _make_folder(options.out)
            body.save(target)
            table.add_row(*_fit_row(target, body))
            progress.advance(task)
    _print(table)
    return 0


def _fit_row(target: Path, body: loewner.Body) -> tuple[str, ...]:
    vertices = sum(len(p.vertices) for p in body.pieces if p.vertices is not None)
    inner, outer = body.inner.volume.sum() * 1e3, body.outer.volume.sum() * 1e3
    return (
        str(target), str(len(body.pieces)), str(vertices), f"{inner:.4g}", f"{outer:.4g}",
        f"{body.gaps.max():.1e}", _covering_text(body.covering),
    )  # fmt: skip


def _covering_text(covering: loewner.Covering | None) -> str:
    if covering is None:
        return "-"
    excess = f", {100 * covering.excess_volume:+.1f} % volume"
    if np.isnan(covering.excess_volume):
        excess = ", volume of the mesh unknown"
    if covering.exact:
        return f"{covering.kind}, holds the mesh{excess}"
    return f"{covering.kind}, leaves up to {1e3 * covering.max_uncovered:.3g} mm uncovered{excess}"


def _make_folder(folder: Path) -> None:
    _validate.path(folder, "--out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: expected a folder, could not make it ({error.strerror or error})") from None


# -- loewner check ------------------------------------------------------------------------------


def _check(options: argparse.Namespace) -> int:
    Ta, Tb = _pose(options.pose_a, "--pose-a"), _pose(options.pose_b, "--pose-b")
    a, b = _body(options.a, options), _body(options.b, options)
    certified = loewner.classify(a, Ta, b, Tb, margin=options.margin)
    found = loewner.distance(a, Ta, b, Tb, exact=options.method == "exact")
    verdict = certified
    if options.method != "certified" and certified == loewner.Verdict.AMBIGUOUS:
        colliding = loewner.collide(a, Ta, b, Tb, method=options.method, margin=options.margin)
        verdict = loewner.Verdict.COLLIDING if colliding else loewner.Verdict.FREE
    if options.json:
        print(json.dumps(_answer(options, a, b, certified, verdict, found), indent=2))
    else:
        _print_answer(options, a, b, certified, verdict, found)
    return {"FREE": FREE, "COLLIDING": COLLIDING, "AMBIGUOUS": AMBIGUOUS}[verdict.name]


def _answer(
    options: argparse.Namespace, a: Any, b: Any, certified: Any, verdict: Any, found: loewner.Distance
) -> dict[str, Any]:
    answer: dict[str, Any] = {
        "verdict": verdict.name,
        "method": options.method,
        "margin": options.margin,
        "certified": certified.name,
        "lower": found.lower,
        "upper": found.upper,
        "estimate": found.estimate,
    }
    if found.distance is not None:
        answer["distance"] = found.distance
        answer |= {name: getattr(found, name).tolist() for name in ("witness_a", "witness_b", "normal")}
    answer |= {f"{name}_exact": None if c is None else c.exact for name, c in (("a", a.covering), ("b", b.covering))}
    return answer


def _print_answer(
    options: argparse.Namespace, a: Any, b: Any, certified: Any, verdict: Any, found: loewner.Distance
) -> None:
    how = {"certified": "the ellipsoids cannot tell", "estimate": "estimated", "exact": "exact"}[options.method]
    if certified == verdict != loewner.Verdict.AMBIGUOUS:
        how = "certified by the ellipsoids"
    relation = {loewner.Verdict.FREE: "by more than", loewner.Verdict.COLLIDING: "or closer than"}
    keep = f" {relation.get(verdict, 'with a margin of')} {options.margin:g} m" if options.margin else ""
    print(f"{verdict.name}{keep}  ({how})")
    print(f"distance    {found.lower:.6g} .. {found.upper:.6g} m, from the ellipsoids")
    if found.distance is not None:
        several = len(a.pieces) > 1 or len(b.pieces) > 1
        depth = f" (penetration depth{' of the deepest two pieces' if several else ''})" if found.distance < 0 else ""
        print(f"            {found.distance:.9g} m, exact{depth}")
        print(f"on A        {_numbers(found.witness_a)}")
        print(f"on B        {_numbers(found.witness_b)}")
        print(f"normal      {_numbers(found.normal)}, from A to B")
    if verdict == loewner.Verdict.AMBIGUOUS:
        print("            --method exact decides it")
    for name, body in ((options.a, a), (options.b, b)):
        # NaN, of a mesh that is not closed, is told as well.
        if body.covering is not None and not (body.covering.exact and body.covering.excess_volume < WORTH_TELLING):
            print(f"note: {name}: {_covering_text(body.covering)}; the answer is about the pieces")


def _numbers(vector: Floats) -> str:
    return " ".join(f"{round(x, 12) + 0.0:.6g}" for x in vector)


def _body(path: Path, options: argparse.Namespace) -> loewner.Body:
    return loewner.Body.load(path) if path.suffix.lower() == ".npz" else _from_mesh(path, options)


def _from_mesh(path: Path, options: argparse.Namespace, **more: Any) -> loewner.Body:
    return loewner.Body.from_mesh(
        path,
        decompose=not options.hull,
        scale=options.scale,
        threshold=options.threshold,
        max_pieces=options.max_pieces,
        seed=options.seed,
        **more,
    )


def _pose(text: str | None, name: str) -> Floats | None:
    """Read a pose: numbers, or a matrix in a file."""
    if text is None:
        return None
    if Path(text).suffix.lower() in (".npy", ".txt"):
        return _pose_file(Path(text))
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (3, 7) or not np.isfinite(numbers).all():
        raise PoseError(
            f'{name}: expected "x y z", "x y z qw qx qy qz", or a .npy or .txt file with a 4x4 matrix, found {text!r}'
        )
    T = np.eye(4)
    T[:3, 3] = numbers[:3]
    if len(numbers) == 7:
        T[:3, :3] = from_quaternion(numbers[3:], name)
    return T


def _pose_file(path: Path) -> Floats:
    try:
        if path.suffix.lower() == ".npy":
            T = np.load(path, allow_pickle=False)
        else:
            lines = path.read_text(encoding="utf-8-sig").splitlines()
            T = np.array([line.split() for line in lines if line.strip()], dtype=np.float64)
    except OSError as error:
        raise FileError(f"{path}: expected a pose file, found {(error.strerror or str(error)).lower()}") from None
    except (ValueError, EOFError):
        raise FileError(f"{path}: expected a 4x4 matrix of numbers, found something else") from None
    if np.shape(T) != (4, 4):
        raise PoseError(f"{path}: expected shape (4, 4), found {np.shape(T)}")
    return np.asarray(T)


# -- loewner robot ------------------------------------------------------------------------------


def _robot(options: argparse.Namespace) -> loewner.Robot:
    """Read the robot, with progress."""
    with _progress() as progress:
        task = progress.add_task(options.urdf.name, total=None)
        robot = loewner.Robot.from_urdf(
            options.urdf,
            srdf=options.srdf,
            package_dirs=options.package_dir,
            decompose=options.decompose,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
        )
    return robot


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print each warning as a line of its own, at once: the work it is about may take minutes."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print(f"loewner: warning: {message}", file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


def _robot_info(options: argparse.Namespace) -> int:
    from rich.table import Table

    robot = _robot(options)
    links = Table("link", "pieces", "vertices", "gap", "mesh", title=f"{robot.name}: {len(robot.link_names)} links")
    for name in robot.link_names:
        links.add_row(name, *(_link_row(robot.bodies[name]) if name in robot.bodies else ("-",) * 4))
    columns = Table("column", "lower", "upper", title=f"{len(robot.joint_names)} joints, dof {robot.dof}")
    for name, lower, upper in zip(robot.configuration_names, robot.lower, robot.upper, strict=True):
        columns.add_row(name, f"{lower:.6g}", f"{upper:.6g}")
    _print(links)
    _print(columns)
    count = len(robot.bodies)
    checked = len(loewner.CollisionChecker(robot).checked_pairs) if count else 0
    print(f"pairs     {count * (count - 1) // 2} of links with bodies, {checked} checked")
    disabled = f"{len(robot.disabled_pairs)} disabled by the SRDF" if options.srdf is not None else "no SRDF"
    print(f"          {disabled}, {len(robot.adjacent_pairs)} adjacent")
    if options.srdf is not None:
        print(f"groups    {', '.join(f'{name} ({len(joints)})' for name, joints in robot.groups.items()) or '-'}")
        print(f"states    {', '.join(robot.states) or '-'}")
    return 0


def _link_row(body: loewner.Body) -> tuple[str, ...]:
    vertices = sum(len(p.vertices) for p in body.pieces if p.vertices is not None)
    return str(len(body.pieces)), str(vertices), f"{body.gaps.max():.1e}", _covering_text(body.covering)


def _robot_check(options: argparse.Namespace) -> int:
    if options.margin is not None and options.scene is None:
        raise InputError("--margin: expected --scene with it, found none: it is kept from the bodies of the scene")
    if options.state is not None and options.srdf is None:
        raise InputError(
            f"--state: expected --srdf with it, which has the states; no SRDF was given for {options.state!r}"
        )
    scene = None if options.scene is None else loewner.load_scene(options.scene)
    if options.margin is not None and scene is not None:
        _widen(scene, options.margin)
    robot = _robot(options)
    checker = loewner.CollisionChecker(robot, scene)
    Q = _configurations(robot, options)
    if not checker.checked_pairs:
        raise InputError(
            f"{options.urdf}: expected pairs to check, found none: links are rigidly joined, adjacent or disabled, and "
            "there is nothing of a scene to meet; any configuration would count as free"
        )
    answer = _checked_configurations(checker, Q)
    if options.json:
        print(json.dumps(answer, indent=2))
    else:
        _print_checked(answer)
    return COLLIDING if answer["colliding"] else FREE


def _widen(scene: loewner.Scene, least: float) -> None:
    """Let every pair with a body of the scene keep at least `least` metres, and leave pairs of links as they are."""
    least = _validate.positive_scalar(least, "--margin", zero=True)
    own = scene.margins
    for names, margin in own.items():
        if margin >= least:
            continue
        if any(name in scene for name in names):
            scene.set_margin(least, *names)
        elif len(names) == 1:  # a link's own goes before the scene's, but holds for other links as well
            for body in scene:
                if (body,) not in own and tuple(sorted((body, *names))) not in own:
                    scene.set_margin(least, body, *names)
    scene.set_margin(max(least, scene.margin))


def _configurations(robot: loewner.Robot, options: argparse.Namespace) -> Floats:
    """The configurations asked for, shape (N, dof)."""
    if options.state is not None:
        return robot.configuration(options.state)[None]
    if options.configs is not None:
        Q = np.atleast_2d(robot.checked(_configuration_file(options.configs, robot), str(options.configs)))
        return _validate.finite_array(Q, str(options.configs), (None, robot.dof))
    if options.random < 1 or options.seed < 0:
        what, least, found = ("random", 1, options.random) if options.random < 1 else ("seed", 0, options.seed)
        raise InputError(f"--{what}: expected an integer >= {least}, found {found}")
    return robot.random_configurations(options.random, options.seed)


def _configuration_file(path: Path, robot: loewner.Robot) -> Floats:
    """Numbers of a .npy or .csv file, in the order of the robot's columns."""
    if path.suffix.lower() not in (".npy", ".csv"):
        raise FileError(f"{path}: expected a .npy or .csv file, found {path.suffix or 'no suffix'}")
    data = read_regular(path, "configurations", MOST_BYTES)
    try:
        if path.suffix.lower() == ".npy":
            return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))
        rows = [[cell.strip() for cell in row] for row in csv.reader(data.decode("utf-8-sig").splitlines()) if any(row)]
    except (ValueError, EOFError, SyntaxError, OverflowError, MemoryError, csv.Error):
        raise FileError(f"{path}: expected an array of numbers, found something else") from None
    names = list(robot.configuration_names)
    if rows and any(";" in cell for cell in rows[0]):
        raise FileError(f"{path}: expected numbers divided by commas, found semicolons: {','.join(rows[0])}")
    order = names
    if rows and not any(_are_numbers([cell]) for cell in rows[0]):
        order = rows.pop(0)
        _check_columns(order, names, path)
    for k, row in enumerate(rows):
        if len(row) != len(names) or not _are_numbers(row):
            raise FileError(f"{path}: expected {len(names)} numbers in each row, found {','.join(row)} in row {k + 1}")
    numbers = np.array(rows, dtype=np.float64).reshape(-1, len(names))
    return np.asarray(numbers[:, [order.index(name) for name in names]])


def _check_columns(order: Sequence[str], names: Sequence[str], path: Path) -> None:
    """Check that each column is named once."""
    for name in order:
        if name not in names:
            raise _validate.unknown_name(f"{path}, column", name, names)
        if order.count(name) > 1:
            raise FileError(f"{path}: expected each column once, found {name} {order.count(name)} times")
    missing = [name for name in names if name not in order]
    if missing:
        raise FileError(f"{path}: expected a column for each joint value, found none for {', '.join(missing)}")


def _are_numbers(cells: Sequence[str]) -> bool:
    try:
        return all(np.isfinite(float(cell)) for cell in cells)
    except ValueError:
        return False


def _checked_configurations(checker: loewner.CollisionChecker, Q: Floats) -> dict[str, Any]:
    """All that is told about configurations."""
    robot = checker.robot
    if len(Q) == 0:
        raise InputError("--configs: expected one configuration or more, found none")
    checker.tiers(Q[:1])  # compiles, if this machine has not before
    tiers: Counter[str] = Counter()
    hits = np.zeros(len(checker.checked_pairs), dtype=np.int64)
    colliding, seconds = [], 0.0
    with _progress() as progress:
        task = progress.add_task("configurations", total=len(Q))
        for first in range(0, len(Q), AT_ONCE):
            part = Q[first : first + AT_ONCE]
            started = time.perf_counter()
            found = np.flatnonzero(checker.collide(part))
            seconds += time.perf_counter() - started
            tiers.update(asdict(checker.tiers(part)))
            hits += checker.collide_by_pair(part[found]).sum(axis=0)
            colliding += (found + first).tolist()
            progress.advance(task, len(part))
    outside = (robot.lower > Q) | (robot.upper < Q)
    often = np.argsort(-hits, kind="stable")
    return {
        "robot": robot.name,
        "configurations": len(Q),
        "free": len(Q) - len(colliding),
        "colliding": len(colliding),
        "colliding_rows": colliding,
        "tiers": dict(tiers),
        "checked_pairs": len(hits),
        "pairs": [[*checker.checked_pairs[p], int(hits[p])] for p in often if hits[p]],
        "outside_limits": np.flatnonzero(outside.any(axis=1)).tolist(),
        "outside_limits_of": [robot.configuration_names[k] for k in np.flatnonzero(outside.any(axis=0))],
        "per_second": len(Q) / seconds,
    }


def _print_checked(answer: dict[str, Any]) -> None:
    from rich.table import Table

    count, colliding = answer["configurations"], answer["colliding"]
    print(f"{'COLLIDING' if colliding else 'FREE'}  {colliding:,} of {count:,} configurations collide")
    table = Table(
        "settled by", "free", "colliding", title=f"{answer['robot']}, {answer['checked_pairs']} pairs checked"
    )
    for name, title in (
        ("bounds", "bounding spheres and boxes"),
        ("ellipsoids", "ellipsoids"),
        ("planes", "planes about the pieces"),
        ("search", "exact search"),
    ):
        cells = (answer["tiers"].get(f"{kind}_by_{name}") for kind in ("free", "colliding"))
        table.add_row(title, *("-" if cell is None else f"{cell:,}" for cell in cells))
    _print(table)
    if answer["pairs"]:
        table = Table("pair", "", "collides", "of all")
        for a, b, hits in answer["pairs"][:LISTED]:
            table.add_row(a, b, f"{hits:,}", f"{100 * hits / count:.1f} %")
        if len(answer["pairs"]) > LISTED:
            table.add_row(f"and {len(answer['pairs']) - LISTED} more")
        _print(table)
    if answer["outside_limits"]:
        rows, names = answer["outside_limits"], ", ".join(answer["outside_limits_of"])
        print(f"note: {len(rows):,} configurations are outside the limits, the first in row {rows[0]}: {names}")
    if count > 1:
        print(f"{answer['per_second']:,.0f} configurations a second, this machine, this run")


# -- loewner paper ------------------------------------------------------------------------------


def _paper(options: argparse.Namespace) -> int:
    from rich.table import Table

    from loewner import paper

    with _progress() as progress:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=total)
            progress.update(tasks[stage], completed=done, total=total)

        found = paper.run(
            options.pairs, options.seed, options.dataset, out=options.out, json=options.json, progress=report
        )
    title = f"{len(found):,} pairs, {int(found.truth.sum()):,} colliding; in percent, +- 95 % / the paper"
    table = Table("table", "detector", *paper.tables.CELLS, "right", "as the paper", "us", title=title)
    for row in paper.tables.tables(found):
        cells = (_cell_text(cell) for cell in row.cells)
        number, right = paper.tables.number(row.microseconds), paper.tables.percent(row.accuracy)
        table.add_row(row.title, row.detector, *cells, right, row.statement, number)
    _print(table)
    for name, path in (("report", options.out), ("counts", options.json)):
        if path is not None:
            print(f"{name}: {path}")
    return 0


def _cell_text(cell: paper.tables.Cell) -> str:
    own = f"{100 * cell.share:.1f} +-{50 * (cell.high - cell.low):.1f}"
    return own if cell.paper_count is None else f"{own} / {100 * cell.paper_share:.1f}"


# -- printing -----------------------------------------------------------------------------------


def _progress() -> Progress:
    """Progress on standard error, so that standard output stays the answer."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def _print(table: Any) -> None:
    from rich.console import Console

    console = Console()
    # A pipe has no width; there a table is not cut to 80 columns.
    Console(width=None if console.is_terminal else 200).print(table)


if __name__ == "__main__":
    sys.exit(main())
