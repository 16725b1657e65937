"""``loewner verify``: check the proof of a plan or of ranges, and compare the proven model with a robot and a scene."""

from __future__ import annotations

import argparse
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import loewner
from loewner import verify
from loewner._base import _validate
from loewner._base._files import read_regular
from loewner.cli import configurations, inputs
from loewner.cli.output import COLLIDING, FREE, OVERLAP, print_answer

EXAMPLES = """examples:
  loewner verify plan.proof
  loewner verify plan.proof --path path.csv
  loewner verify plan.proof --robot panda.urdf --srdf panda.srdf --scene shelf.yaml
  loewner verify lift.proof --overlap 0.00002

The proof is checked by loewner.verify, which computes in whole numbers and shares no code with the planner. It is about
the model and the motions in the file. With --robot, the model must be identical, bit for bit, to that of this robot and
scene. With --path, the motions must be the straight ones between the configurations of the path, in order and bit for
bit. Where a scene has rules of contact (leave:, reach:), each contact is printed with its motion, its interval, and the
overlap that it allows; an overlap deeper than --overlap is refused. The proof of loewner clash is about pairs: each is
printed with its margin and the ranges of the joints between the two bodies.

exit status: 0 verified to be free, and the same model and path; 1 verified to collide (a proof by loewner.prove),
refused, too deep a contact, or a different model or path; 2 error
"""

# Largest number of differences between two models that are printed.
MOST_SHOWN = 10


def add(commands: Any) -> None:
    """Add the command."""
    command = inputs.command(commands, "verify", "check the proof of a plan", EXAMPLES, _run)
    _, file, length, flag = inputs.adders(command)
    file("file", help="a proof, as loewner plan --proof, loewner clash --proof or loewner.prove writes it")
    file("--robot", dest="urdf", metavar="URDF", help="the robot that the proof must be about")
    inputs.add_reading_options(command)
    inputs.add_rule_options(command, "start of motions", "end of motions")
    file("--path", help="a path, as loewner plan -o writes it")
    length("--overlap", default=OVERLAP, help="deepest overlap that contacts may allow [m] (%(default)s)")
    flag("--json", help="print JSON")


def _run(options: argparse.Namespace) -> int:
    overlap = _validate.positive_scalar(options.overlap, "--overlap", zero=True)
    if options.urdf is None:
        of_robot = ("srdf", "scene", "model", "decompose", "package_dir", "leave", "reach")
        inputs.refuse(options, of_robot, "{}: expected --robot with it; without it there is no model")
    data = read_regular(options.file, "a proof", 2 * verify.MOST_BYTES)  # larger proofs are refused below
    try:
        report = verify.verify(data)
    except verify.Refused as error:
        print(f"refused: {error}", file=sys.stderr)
        print_answer(options, {"verified": False, "refused": str(error)}, lambda: None)
        return COLLIDING
    lines, faults, differences = [str(report)], list[str](), list[str]()
    if options.urdf is not None:
        scene = inputs.scene(options)
        inputs.apply_rules(scene, options)
        made_for = ", ".join(file.name for file in (options.urdf, options.srdf, options.scene) if file is not None)
        differences = loewner.Proof(data).differences(loewner.CollisionChecker(inputs.robot(options), scene))
        lines += [f"different    {words}" for words in differences[:MOST_SHOWN]]
        lines += [f"             and {len(differences) - MOST_SHOWN} more"] if len(differences) > MOST_SHOWN else []
        if differences:
            faults.append(f"DIFFERENT MODEL: not made for {made_for}")
        else:
            lines.append(f"the model matches {made_for}")
    if options.path is not None:
        if words := _difference(report, options.path):
            faults.append(f"DIFFERENT PATH: {words}")
        else:
            lines.append(f"the motions are those of {options.path.name}")
    for *pair, motion, _, _, least in [row for row in report.contacts if -row[-1] > overlap][:1]:
        words = f"{verify._shown(*pair)} may overlap by {-1000 * least:.12g} mm in motion {motion}"
        faults.append(f"DEEP CONTACT: {words}, and --overlap allows {1000 * overlap:.12g} mm")
    text = "\n".join([*lines, *(faults or [f"verified: {_claim(report)}"])])
    print_answer(options, _entry(report, faults) | {"different": differences}, lambda: print(text))
    return COLLIDING if faults or report.common else FREE


def _claim(report: verify.Report) -> str:
    if report.common:
        return f"COLLIDING, {' and '.join(report.common)} have a common point"
    if report.ranges:
        return "FREE, the pairs above are farther apart than their margins, at all values in the ranges above"
    inside = " and ".join(verify._shown(name) for name in report.uncovered)
    starts = f" if nothing begins inside {inside}" if inside else ""
    contacts = f" except in {len(report.stretches)} contacts, which are listed above" if report.contacts else ""
    return f"FREE{starts}, all pairs of the proof are farther apart than their margins, at every time{contacts}"


def _entry(report: verify.Report, faults: list[str]) -> dict[str, Any]:
    """Convert a report to the form of JSON."""
    return {
        "verified": not faults,
        "claim": _claim(report),
        "faults": faults,
        "model": report.model,
        "sizes": report.sizes,
        "pairs": [
            {
                "names": [a, b],
                "margin": margin,
                "range": {name: [low, high] for name, low, high, _ in extents},
                "whole_range": all(whole for *_, whole in extents),
            }
            for a, b, margin, extents in report.ranges
        ],
        "motions": len(report.motions),
        "contacts": [
            {"names": [a, b], "motion": motion, "from": float(since), "to": float(until), "least_distance": least}
            for a, b, motion, since, until, least in report.contacts
        ],
        "left_out": [list(pair) for pair in report.left_out],
        "not_covered": list(report.uncovered),
    }


def _difference(report: verify.Report, path: Path) -> str:
    """Describe the first difference between the motions and a path, or return ""."""
    if report.ranges:
        return "the proof is about ranges, not motions"
    if not report.deviations:
        return "the proof is about two bodies that do not move"
    names = [name for name, _ in report.deviations]
    named: Any = SimpleNamespace(configuration_names=names)
    numbers = np.atleast_2d(configurations.read(path, named, named=True))
    if numbers.ndim != 2 or len(numbers) < 2 or numbers.shape[1] != len(names):
        shape = _validate.shape_text(numbers.shape)
        return f"expected shape (k, {len(names)}) with k >= 2 in {path.name}, found {shape}"
    rows = numbers.tolist()
    if len(report.points) != len(rows) - 1:
        return f"the proof has {len(report.points)} motions, and {path.name} has {len(rows)} configurations"
    for k, (points, ends) in enumerate(zip(report.points, pairwise(rows), strict=True)):
        if len(points) != 2:
            return f"motion {k} has the degree {len(points) - 1}, and is not straight"
        if list(map(list, points)) != list(ends):
            return f"motion {k} is not from configuration {k} of {path.name} to configuration {k + 1}"
    return ""
