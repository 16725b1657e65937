"""``loewner judge --configurations``: list the verdicts of another collision checker that are proven wrong."""

from __future__ import annotations

import argparse
import csv
from typing import Any

import numpy as np

import loewner
from loewner._base._files import read_regular
from loewner._base._validate import Bools, Floats, short
from loewner.cli import configurations, inputs
from loewner.cli.judge_answers import SHOWN, TOLERANCE, WORDS
from loewner.cli.output import COLLIDING, FREE, counted, print_answer
from loewner.errors import FileError

TABLE = """--configurations: a .csv file whose header names the joint values, in any order, and a column colliding.
  A verdict, true or false, 1 or 0, is wrong if bodies overlap, or all are apart, by more than the tolerance; depths of
  curved shapes are accurate to a thousandth of their size. --scene has the obstacles, whose margins do not count; pairs
  that the SRDF exempts are not checked.
"""

ANSWER = "colliding"


def run(options: argparse.Namespace) -> int:
    """Judge a table of configurations, and print the wrong verdicts."""
    tolerance = TOLERANCE if options.tolerance is None else options.tolerance
    robot = robot_of(options)
    checker = loewner.CollisionChecker(robot, inputs.scene(options))
    Q, said = table(options.configurations, robot)
    # Verdicts are about contact, so a body within a margin may be called free or colliding.
    rows = np.flatnonzero((checker.collide(Q) != said) | (said & (inputs.largest_margin(checker.scene) > 0)))
    wrong: list[dict[str, Any]] = []
    if len(rows):
        distances = checker.distance(Q[rows], exact=True)
        error = np.where(said[rows], distances.distance, -distances.distance)
        for k in np.argsort(-error, kind="stable").tolist():
            if error[k] > tolerance:
                finding = "WRONG_COLLIDING" if said[rows[k]] else "WRONG_FREE"
                row = {"row": int(rows[k]) + 1, "finding": finding, "bodies": distances.names[k].tolist()}
                wrong.append(row | {"distance": float(distances.distance[k])})
    print_answer(options, {"configurations": len(Q), "wrong": wrong}, lambda: _print(wrong, len(Q)))
    return COLLIDING if wrong else FREE


def _print(wrong: list[dict[str, Any]], count: int) -> None:
    print(f"{len(wrong)} of {counted(count, 'verdict')} proven wrong")
    for kind, text in (("WRONG_FREE", "collisions missed"), ("WRONG_COLLIDING", "false alarms")):
        print(f"{text:<18} {sum(row['finding'] == kind for row in wrong)}")
    for row in wrong[:SHOWN]:
        what = f"{'apart' if row['distance'] > 0 else 'deep'} by {abs(row['distance']):.6g} m"
        print(f"row {row['row']}: {row['finding']}; {' and '.join(row['bodies'])} {what}")
    if len(wrong) > SHOWN:
        print(f"and {len(wrong) - SHOWN} more (--json)")


def robot_of(options: argparse.Namespace) -> loewner.Robot:
    """Read the robot of a command whose first file is a URDF."""
    of_robot = {"urdf": options.files[0], "model": options.meshes, "decompose": False}
    return inputs.robot(argparse.Namespace(**{**vars(options), **of_robot}))


def table(path: Any, robot: loewner.Robot) -> tuple[Floats, Bools]:
    """Read configurations, shape (n, dof), with columns in the robot's order, and the verdicts about them."""
    data = read_regular(path, "configurations", configurations.MOST_BYTES)
    try:
        rows = configurations.rows_of(data.decode("utf-8-sig"))
    except (ValueError, csv.Error):
        raise FileError(f"{path}: expected a table with commas, found something else") from None
    header = rows[0] if rows else []
    if header.count(ANSWER) != 1:
        raise FileError(f"{path}: expected one column {ANSWER} in the header, found {', '.join(header) or 'none'}")
    at, said = header.index(ANSWER), []
    for k, row in enumerate(rows[1:], 1):
        word = row[at].lower() if len(row) == len(header) else "too few or too many cells"
        value = WORDS.get(word, {"1": 1.0, "0": 0.0}.get(word))
        if value is None:
            raise FileError(f"{path}, row {k}: expected true or false as {ANSWER}, found {short(word)}")
        said.append(value == 1.0)
    if not said:
        raise FileError(f"{path}: expected configurations, found none")
    return configurations.of_rows([row[:at] + row[at + 1 :] for row in rows], robot, path), np.array(said)
