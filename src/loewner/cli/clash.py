"""``loewner clash``: which parts of a mechanism can ever collide, over the whole ranges of its joints."""

from __future__ import annotations

import argparse
import json
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import plots
from loewner._files import shown
from loewner._validate import Floats, Pair
from loewner.cli import configurations, inputs
from loewner.cli.output import AMBIGUOUS, COLLIDING, FREE, progress_bar, remove_older_proof
from loewner.cli.pair_tables import print_pairs
from loewner.errors import FileError, InputError
from loewner.robots.pair_verdicts import PairVerdict, ProvenPair, ProvenPairs

DRAWN = (".png", ".svg")

EXAMPLES = """examples:
  loewner clash mechanism.urdf
  loewner clash mechanism.urdf --between crank housing --margin 0.001 --limits "crank=-1.2,0.8" -o clash.png
  loewner clash panda.urdf --srdf panda.srdf --exempt --write-srdf panda.srdf
  loewner clash mechanism.urdf --largest crank --at "0.1,0,0"
  loewner clash mechanism.urdf --between crank housing --margin 0.001 --proof never.proof

pairs: those that are checked, unless --between, --exempt or --all chooses others. Adjacent links are exempt if there is
  no SRDF.

verdicts: NEVER and ALWAYS are proven for every configuration in the ranges of the joints between the two bodies.
  SOMETIMES: one configuration with contact and one without are known. CAN: one with contact is known. OPEN: no contact
  was found, and not all is proven.

--write-srdf adds what is proven, also if other pairs can collide.
proof: all pairs in question have to be NEVER; otherwise the first other one is named, with exit status 2. loewner
  verify checks the file, with --robot against a robot and a scene.

exit status: 0 all pairs are proven never to collide, 1 a pair can collide, 2 error, 3 no contact was found, but a pair
  is open; with --largest: 0 a range was found
"""


def add(commands: Any) -> None:
    """Add the command."""
    clash = inputs.command(commands, "clash", "which parts of a mechanism can ever collide", EXAMPLES)
    inputs.add_robot_options(clash)
    clash.add_argument("--scene", type=Path, metavar="FILE", help="bodies at rest, and attached ones (.yaml)")
    which = clash.add_mutually_exclusive_group()
    which.add_argument(
        "--between", nargs=2, metavar=("A", "B"), action="append", help="two links or bodies; repeatable"
    )
    which.add_argument("--exempt", action="store_true", help="the pairs that are exempt from checking")
    which.add_argument("--all", action="store_true", help="all pairs of links with bodies")
    clash.add_argument("--margin", type=float, default=0.0, metavar="M", help="distance that counts as contact [m] (0)")
    clash.add_argument(
        "--limits", action="append", default=[], metavar="J=LO,HI",
        help="a range [rad or m] instead of the limits in the URDF; repeatable",
    )  # fmt: skip
    clash.add_argument(
        "--boxes", type=int, default=1_000_000, metavar="N", help="boxes of configurations to examine (%(default)s)"
    )
    clash.add_argument(
        "--largest", action="append", metavar="J",
        help="the largest range of this joint about --at that is proven free; repeatable for a box of several",
    )  # fmt: skip
    clash.add_argument("--at", metavar="Q", help="a configuration for --largest: a state, a file or numbers (zero)")
    clash.add_argument(
        "-o", "--out", type=Path, metavar="FILE", help="draw the deepest contact, or the nearest pair (.png or .svg)"
    )
    clash.add_argument("--write-srdf", type=Path, metavar="FILE", help="add the pairs that are proven to this SRDF")
    clash.add_argument(
        "--narrower", action="store_true", help="with --write-srdf: also pairs proven for less than the hard limits"
    )
    clash.add_argument("--proof", type=Path, metavar="FILE", help="write a proof of all pairs, for loewner verify")
    clash.add_argument("--json", action="store_true", help="print JSON")
    clash.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    if options.out is not None and options.out.suffix.lower() not in DRAWN:
        raise FileError(f"--out: expected a .png or .svg file, found {options.out}")
    if options.at is not None and not options.largest:
        raise InputError("--at: expected --largest with it, found none")
    if options.largest and not options.out is options.write_srdf is options.proof is None:
        raise InputError("--largest: expected neither --out, --write-srdf nor --proof with it, found one of them")
    remove_older_proof(options.proof)
    scene = None if options.scene is None else loewner.load_scene(options.scene)
    robot = inputs.robot(options)
    limits = dict(_limits(text) for text in options.limits)
    if len(limits) < len(options.limits):
        raise InputError("--limits: expected each joint once, found one again")
    pairs = _pairs(robot, scene, options)
    if options.largest:
        about = None
        if options.at is not None:
            about = robot.checked_one(configurations.given(options.at, "--at", options, robot, None), "--at")
        ranges = robot.free_range(
            options.largest, about, pairs=pairs, margin=options.margin, limits=limits, scene=scene,
            boxes=options.boxes,
        )  # fmt: skip
        _print_ranges(ranges, options.json)
        return FREE
    with progress_bar() as progress:
        task = progress.add_task("pairs", total=len(pairs))
        found = robot.prove_pairs(
            pairs, margin=options.margin, limits=limits, scene=scene, boxes=options.boxes,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
            proof=options.proof is not None,
        )  # fmt: skip
    if found.proof is not None:
        found.proof.save(options.proof)
    if options.json:
        print(json.dumps({"robot": found.robot, "pairs": [_entry(row, robot) for row in found]}, indent=2))
    else:
        print_pairs(found, robot)
    if options.out is not None:
        _draw(found, robot, scene, options.out)
    if options.write_srdf is not None:
        written = found.to_srdf(options.write_srdf, narrower=options.narrower)
        print(f"{shown(options.write_srdf)}: {len(written)} pairs added")
    verdicts = {row.verdict for row in found}
    if verdicts & {PairVerdict.ALWAYS, PairVerdict.SOMETIMES, PairVerdict.CAN}:
        return COLLIDING
    return AMBIGUOUS if PairVerdict.OPEN in verdicts else FREE


def _limits(text: str) -> tuple[str, tuple[float, float]]:
    name, _, ends = text.rpartition("=")
    try:
        low, high = (float(end) for end in ends.split(","))
    except ValueError:
        raise InputError(f"--limits: expected JOINT=LOWER,UPPER, found {text!r}") from None
    return name, (low, high)


def _pairs(robot: loewner.Robot, scene: loewner.Scene | None, options: argparse.Namespace) -> list[Pair]:
    """Return the pairs in question; at least one."""
    if options.between:
        return [tuple(pair) for pair in options.between]
    if options.exempt:
        exempt = robot.disabled_pairs or robot.adjacent_pairs
        pairs = sorted(pair for pair in exempt if all(link in robot.bodies for link in pair))
    elif options.all:
        pairs = list(combinations(robot.bodies, 2))
    else:
        pairs = list(loewner.CollisionChecker(robot, scene).checked_pairs)
    if not pairs:
        raise InputError("expected pairs of bodies, found none; --between names a pair, --all takes all of them")
    return pairs


def _entry(row: ProvenPair, robot: loewner.Robot) -> dict[str, Any]:
    """A row as JSON has it."""

    def named(q: Floats | None) -> dict[str, float] | None:
        return None if q is None else dict(zip(robot.configuration_names, q.tolist(), strict=True))

    return {
        "names": list(row.names),
        "verdict": str(row.verdict),
        "range": {
            name: [low if np.isfinite(low) else None, high if np.isfinite(high) else None]
            for name, low, high in zip(row.columns, row.lower.tolist(), row.upper.tolist(), strict=True)
        },
        "whole_range": row.complete,
        "margin": row.margin,
        "distance": None if np.isnan(row.distance) else row.distance,
        "nearest": named(row.nearest),
        "colliding": named(row.colliding),
        "free": named(row.free),
        "boxes": row.boxes,
        "share": row.share,
        "reason": row.reason,
    }


def _print_ranges(ranges: dict[str, tuple[float, float]], as_json: bool) -> None:
    if as_json:
        print(json.dumps({name: list(ends) for name, ends in ranges.items()}, indent=2))
        return
    for name, (low, high) in ranges.items():
        print(f"FREE       {name} from {low:.13g} to {high:.13g}")


def _draw(found: ProvenPairs, robot: loewner.Robot, scene: loewner.Scene | None, path: Path) -> None:
    """Draw the two bodies with the least distance, where they have it."""
    row = min(found, key=lambda row: np.nan_to_num(row.distance, nan=np.inf))
    if row.nearest is None:
        print(f"note: {shown(path)} is not written, since no distance is known")
        return
    poses = dict(zip(robot.link_names, robot.forward_kinematics(row.nearest), strict=True))
    placed = []
    for name in row.names:
        if name in robot.bodies:
            placed += [robot.bodies[name], poses[name]]
        elif scene is not None:
            held = scene.attachments.get(name)
            placed += [scene[name], scene.pose(name) if held is None else poses[held.link] @ held.T_link_body]
    ax = plots.pair(*placed)
    ax.set_title(f"{row.names[0]} and {row.names[1]}: {row.verdict}, {1e3 * row.distance:.3f} mm")
    plots.save(ax.figure, path)
