"""``loewner verify``: check the proof of a plan, and compare its model with a robot and a scene."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import loewner
from loewner import verify
from loewner._files import read_regular
from loewner.cli import inputs
from loewner.cli.output import COLLIDING
from loewner.errors import InputError

EXAMPLES = """examples:
  loewner verify plan.proof
  loewner verify plan.proof --robot panda.urdf --srdf panda.srdf --scene shelf.yaml

The proof is checked by loewner.verify, which computes in whole numbers and shares no code with the planner. It is about
the model in the file; with --robot, this model has to be the robot's and the scene's own, to the last bit.

exit status: 0 verified, and the same model; 1 refused, or another model; 2 error
"""


# Largest file that is read, to be refused if it is too large for a proof.
MOST_BYTES = 2**30


def add(commands: Any) -> None:
    """Add the command."""
    command = inputs.command(commands, "verify", "check the proof of a plan", EXAMPLES)
    command.add_argument("file", type=Path, metavar="FILE", help="a proof, as loewner plan --proof writes it")
    inputs.add_robot_options(command, required=False)
    command.add_argument("--scene", type=Path, metavar="FILE", help="obstacles and attached bodies (.yaml)")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    if options.urdf is None:
        for name in ("srdf", "scene", "model", "decompose", "package_dir"):
            if getattr(options, name):
                raise InputError(f"--{name.replace('_', '-')}: expected --robot with it; without it there is no model")
    read_regular(options.file, "a proof", MOST_BYTES)  # errors as in other commands
    status = verify.main(["--", str(options.file)])
    if status or options.urdf is None:
        return status
    scene = loewner.Scene() if options.scene is None else loewner.load_scene(options.scene)
    expected = loewner.CollisionChecker(inputs.robot(options), scene).model_hash
    found = loewner.Proof.load(options.file).model_hash
    if found == expected:
        print("the model is the robot's and the scene's own")
        return status
    print(f"ANOTHER MODEL  the hash of {options.urdf.name} and its scene is {expected}")
    return COLLIDING
