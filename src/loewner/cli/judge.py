"""``loewner judge``: whether somebody's model of a robot contains its links, and how far it sticks out."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from loewner.cli import cover_tables, inputs
from loewner.cover_files import FORMATS
from loewner.errors import InputError
from loewner.robots import link_bodies

EXAMPLES = """examples:
  loewner judge --model spheres.yml panda.urdf
  loewner judge --model panda_spherized.urdf --format vamp --picture holes.png panda.urdf

--model: each row is about one link: the share of its surface that is outside of all shapes, how deep a part of it is
  outside and where, in the frame of the link, and how far shapes stick out of it. Two numbers are proven bounds.

outcomes: covered: each point of the link, inside included, is proven to be in a shape. uncovered: the point shown is
  proven to be outside. undecided: neither is proven.

exit status: 0 all links are covered, 1 one is not, 2 error, 3 one is undecided
"""


def add(commands: Any) -> None:
    """Add the command."""
    judge = inputs.command(commands, "judge", "whether a model contains a robot's links", EXAMPLES)
    judge.add_argument("files", nargs="*", type=Path, metavar="FILE", help="with --model: the robot, a URDF file")
    which = judge.add_mutually_exclusive_group(required=True)
    which.add_argument("--model", type=Path, metavar="FILE", help="spheres or other shapes that should contain links")
    of_model = judge.add_argument_group("options of --model")
    of_model.add_argument("--format", choices=FORMATS, help="the program that reads the model (by the suffix)")
    of_model.add_argument("--srdf", type=Path, metavar="FILE", help="groups, states, pairs that need no check")
    of_model.add_argument(
        "--package-dir", type=Path, metavar="DIR", action="append", default=[], help="folder of packages; repeatable"
    )
    of_model.add_argument(
        "--meshes", choices=link_bodies.MODELS, help=f"representation of the robot's meshes ({link_bodies.USUAL_MODEL})"
    )
    of_model.add_argument("--tolerance", type=float, metavar="M", help="size of the smallest cells of a proof [m]")
    of_model.add_argument("--picture", type=Path, metavar="FILE", help="draw the parts outside (.png or .svg)")
    judge.add_argument("--json", action="store_true", help="print JSON")
    judge.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    return _run_model(options)


def _run_model(options: argparse.Namespace) -> int:
    """Judge the shapes of each link."""
    cover_tables.refuse_other_pictures(options.picture)
    if len(options.files) != 1:
        raise InputError(f"FILE: expected one robot with --model, found {len(options.files)} files")
    of_robot = {"urdf": options.files[0], "model": options.meshes, "decompose": False}
    robot = inputs.robot(argparse.Namespace(**{**vars(options), **of_robot}))
    if not robot.bodies:
        raise InputError(f"{options.files[0]}: expected links with bodies, found none")
    model = robot.with_cover(options.model, options.format)
    reports = cover_tables.judged(robot, model, options.tolerance)
    if options.json:
        links = cover_tables.entries(model, reports)
        print(json.dumps({"robot": robot.name, "model": str(options.model), "links": links}, indent=2))
    else:
        cover_tables.print_reports(robot, model, reports)
    cover_tables.draw(robot, model, options.picture)
    return cover_tables.status(reports)
