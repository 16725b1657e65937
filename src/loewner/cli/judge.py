"""``loewner judge``: find whether a robot's model contains its links, or which answers of other programs are wrong."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from loewner._base import _validate
from loewner.cli import cover_tables, inputs, judge_answers, judge_configurations
from loewner.cli.output import print_answer
from loewner.errors import InputError
from loewner.robots.cover_files import FORMATS
from loewner.robots.description import link_bodies

EXAMPLES = f"""examples:
  loewner judge --answers said.csv cup.stl spoon.stl              another program's answers about two meshes
  loewner judge --answers said.csv parts/*.npz --tolerance 1e-4   many bodies, named in the table
  loewner judge --answers said.json a.npz b.npz --program wrong.py --row 7
  loewner judge --configurations said.csv panda.urdf --srdf panda.srdf --scene shelf.yaml
  loewner judge --model spheres.yml panda.urdf
  loewner judge --model panda_spherized.urdf --format vamp --picture holes.png panda.urdf

{judge_answers.TABLE}
{judge_configurations.TABLE}
--model: each row is about one link: the share of its surface that is outside of all shapes, how deep a part of it is
  outside and where, in the frame of the link, and how far shapes stick out of it. Two numbers are proven bounds.
  covered: each point of the link, inside included, is proven to be in a shape. uncovered: the point shown is proven to
  be outside. undecided: neither is proven.

exit status: 2 error; --answers, --configurations: 0 nothing is proven wrong, 1 an answer is; --model: 0 all links are
  covered, 1 one is not, 3 one is undecided
"""

# Options that apply to only some of the questions.
OPTIONS = {
    "answers": ("scale", "program", "row"),
    "configurations": ("srdf", "package_dir", "scene"),
    "model": ("format", "srdf", "package_dir", "picture"),
}


def add(commands: Any) -> None:
    """Add the command."""
    judge = inputs.command(
        commands, "judge", "other programs' answers about pairs, and models of robots", EXAMPLES, _run
    )
    option, file, length, flag = inputs.adders(judge)
    file("files", nargs="*", help="--answers: bodies (.npz) or meshes; else: a robot (URDF)")
    which = judge.add_mutually_exclusive_group(required=True)
    which.add_argument("--model", type=Path, metavar="FILE", help="spheres or other shapes that should contain links")
    which.add_argument("--answers", type=Path, metavar="TABLE", help="answers about pairs of bodies (.csv or .json)")
    which.add_argument("--configurations", type=Path, metavar="TABLE", help="verdicts about configurations (.csv)")
    of_robot = judge.add_argument_group("options of --model and --configurations")
    inputs.add_robot_files(of_robot, "--configurations: obstacles (.yaml)")
    of_model = judge.add_argument_group("options of --model")
    of_model.add_argument("--format", choices=FORMATS, help="the program that reads the model (by the suffix)")
    of_model.add_argument("--picture", type=Path, metavar="FILE", help="draw the parts outside (.png or .svg)")
    judge_answers.add_options(judge.add_argument_group("options of --answers"))
    usual = f"representation of meshes (robots: {link_bodies.USUAL_MODEL}; --answers: surface)"
    option("--meshes", choices=[*dict.fromkeys([*link_bodies.MODELS, *inputs.MODELS])], help=usual)
    tolerance = "error that is allowed (1e-6), or --model: size of the smallest cells of a proof [m]"
    length("--tolerance", help=tolerance)
    flag("--json", help="print JSON")


def _run(options: argparse.Namespace) -> int:
    mode = next(name for name in OPTIONS if getattr(options, name) is not None)
    others = (name for names in OPTIONS.values() for name in names if name not in OPTIONS[mode])
    inputs.refuse(options, others, f"{{}}: expected no such option with --{mode}, found one")
    if options.meshes is not None:
        allowed = inputs.MODELS if options.answers else link_bodies.MODELS
        _validate.choice(options.meshes, f"--meshes with --{mode}", allowed)
    if options.answers:
        return judge_answers.run(options)
    if len(options.files) != 1:
        raise InputError(f"FILE: expected one robot with --{mode}, found {len(options.files)} files")
    return judge_configurations.run(options) if options.configurations else _run_model(options)


def _run_model(options: argparse.Namespace) -> int:
    """Judge the shapes of each link."""
    inputs.expect_suffix(options.picture, "--picture", inputs.DRAWN)
    robot = judge_configurations.robot_of(options)
    if not robot.bodies:
        raise InputError(f"{options.files[0]}: expected links with bodies, found none")
    model = robot.with_cover(options.model, options.format)
    reports = cover_tables.judged(robot, model, options.tolerance)
    answer = {"robot": robot.name, "model": str(options.model), "links": cover_tables.entries(model, reports)}
    print_answer(options, answer, lambda: cover_tables.print_reports(robot, model, reports))
    cover_tables.draw(robot, model, options.picture)
    return cover_tables.status(reports)
