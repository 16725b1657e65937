"""``loewner view``: show two bodies, or a robot, in the browser."""

from __future__ import annotations

import argparse
import sys
from contextlib import redirect_stdout
from typing import Any

import numpy as np

import loewner
from loewner._base import _tables
from loewner.cli import inputs, trajectories
from loewner.errors import InputError

# Names, in the code, of the options that apply only to trajectories.
OF_TRAJECTORIES = ("controller", "others", "attach", "start_time", "part", "at")

EXAMPLES = """examples:
  loewner view arm.npz table.stl --pose-b "0.5 0 0"
  loewner view --robot panda.urdf --srdf panda.srdf --scene kitchen.yaml --package-dir robots
  loewner view --robot panda.urdf --scene shelf.yaml --trajectory moves.csv --at worst --screenshot worst.png

trajectory: any file of loewner audit, with its options --controller, --others, --attach and --start-time; the page
  shows the verdict of the whole trajectory, and below it the answer for the position that is shown.

The page is served on this machine, at the address that is printed; Ctrl+C closes it.
"""


def add(commands: Any) -> None:
    """Add the command."""
    view = inputs.command(commands, "view", "two bodies, or a robot, in the browser", EXAMPLES, _run)
    option, file, length, flag = inputs.adders(view)
    file("a", metavar="A", nargs="?", help="a saved body (.npz) or a mesh")
    file("b", metavar="B", nargs="?", help="the other one")
    option("--pose-a", metavar="POSE", help="initial pose of A (the origin); as in loewner check")
    option("--pose-b", metavar="POSE", help="initial pose of B (next to A)")
    length("--margin", default=0.0, help="distance that A and B keep [m] (0)")
    robot = "a robot instead of two bodies; its meshes become hulls, or --model"
    file("--robot", dest="urdf", metavar="URDF", help=robot)
    inputs.add_robot_files(view, "scene around the robot (.yaml)")
    file("--trajectory", help="path of the robot to play, with or without times (.csv, .json, .yaml)")
    trajectories.add_options(view)
    option("--part", type=int, metavar="N", help="which trajectory of a message with several, from 1 on")
    at = 'where on the path the robot is at first: seconds since its start, or "worst", where it comes nearest (0)'
    option("--at", metavar="T", help=at)
    flag("--decompose", help="for the robot: the same as --model pieces")
    option("--port", type=int, default=0, help="default: any free port")
    flag("--no-browser", help="only print the address")
    file("--screenshot", metavar="PNG", help="write a picture of the page and exit, without a window")
    inputs.add_mesh_options(view, "pieces")


def _run(options: argparse.Namespace) -> int:
    import webbrowser

    answer = sys.stdout
    with redirect_stdout(sys.stderr):  # viser prints messages to standard output
        page = _view_robot(options) if options.urdf is not None else _view_pair(options)
        if options.screenshot is not None:
            from loewner import viewer

            try:
                viewer.save_screenshot(page, options.screenshot)
            finally:
                page.close()
            print(options.screenshot, file=answer)
            return 0
        print(f"{page.url}  (Ctrl+C closes it)", file=answer, flush=True)
        if not options.no_browser:
            webbrowser.open(page.url)
        page.wait()
    return 0


def _view_pair(options: argparse.Namespace) -> Any:
    from loewner import viewer

    if options.a is None or options.b is None:
        raise InputError("view: expected two bodies, A and B, or --robot URDF")
    of_robots = ("srdf", "scene", "trajectory", *OF_TRAJECTORIES, "package_dir", "decompose")
    inputs.refuse(options, of_robots, "view: expected {} with --robot only, found it with A and B")
    Ta, Tb = inputs.pose(options.pose_a, "--pose-a"), inputs.pose(options.pose_b, "--pose-b")
    a, b = inputs.bodies((options.a, options.b), options)
    if Tb is None:
        Tb = np.eye(4) if Ta is None else Ta.copy()
        Tb[0, 3] += a.outer.bounding_box()[1][:, 0].max() - b.outer.bounding_box()[0][:, 0].min()
    mesh_a, mesh_b = (None if path.suffix.lower() == ".npz" else path for path in (options.a, options.b))
    return viewer.show_pair(a, Ta, b, Tb, margin=options.margin, mesh_a=mesh_a, mesh_b=mesh_b, port=options.port)


def _view_robot(options: argparse.Namespace) -> Any:
    from loewner import planners, viewer

    if options.a is not None:
        raise InputError(f"view: expected no A and B with --robot, found {options.a}")
    only, of_pairs = "view: expected {} with A and B only, not --robot", ("pose_a", "pose_b", "hull", "scale")
    inputs.refuse(options, (*of_pairs, *inputs.OF_SURFACES, *inputs.OF_PIECES), only)
    inputs.refuse(options, ("margin",), f"{only}: margins of a robot are the scene's")
    scene = inputs.scene(options)
    if options.scene is not None and len(scene) == 0:
        raise InputError(
            f"{options.scene}: expected a scene with bodies, found none; for the robot alone, drop --scene"
        )
    robot = inputs.robot(options)
    if options.trajectory is None:
        inputs.refuse(options, OF_TRAJECTORIES, "view: expected {} with --trajectory only")
        return viewer.show_robot(loewner.CollisionChecker(robot, scene), port=options.port)
    at = options.at if options.at in (None, "worst") else _seconds(options.at)
    played = _played(options, scene, robot)
    kind = "trajectory" if isinstance(played, planners.ControllerPoints) else "path"
    shown: Any = {kind: played}
    page = viewer.show_robot(loewner.CollisionChecker(robot, scene), port=options.port, **shown)
    try:
        if at == "worst":
            page.go_to_worst()
        elif at is not None:
            page.time = at
    except BaseException:
        page.close()
        raise
    return page


def _seconds(text: str) -> float:
    try:
        return _tables.number(text)
    except ValueError:
        raise InputError(f'--at: expected seconds or "worst", found {text!r}') from None


def _played(options: argparse.Namespace, scene: loewner.Scene, robot: loewner.Robot) -> trajectories.Part:
    """Read the trajectory to play. Put bodies of the scene where earlier parts leave them, or attach them to links."""
    parts = trajectories.read(options, scene, robot)
    number = 1 if options.part is None and len(parts) == 1 else options.part
    if number is None or not 1 <= number <= len(parts):
        text = "none" if number is None else number
        raise InputError(f"--part: expected one of the {len(parts)} trajectories of the file, from 1 on, found {text}")
    carried = trajectories.carried(parts, scene, robot)
    return next(part for k, part in enumerate(carried, 1) if k == number)
