"""``loewner clash``: find which parts of a mechanism can ever collide, or whether a body collides on a given motion."""

from __future__ import annotations

import argparse
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import plots
from loewner._base._files import shown
from loewner._base._rotations import quaternions_of
from loewner._base._validate import Floats, Pair
from loewner.cli import configurations, inputs, output
from loewner.cli.pair_tables import print_pairs
from loewner.errors import InputError
from loewner.queries.pose_paths import path_of
from loewner.robots.description.pair_verdicts import PairVerdict, ProvenPair, ProvenPairs

# Names, in the parser, of the options that apply only to robots, and of the options that apply only to two bodies.
OF_ROBOTS = (
    "srdf", "package_dir", "decompose", "scene", "between", "exempt", "all", "limits", "boxes", "largest", "at",
    "write_srdf", "narrower", "proof",
)  # fmt: skip
OF_BODIES = ("to", "motion", "pose_a", "pose_b", "scale")

EXAMPLES = """examples:
  loewner clash mechanism.urdf
  loewner clash mechanism.urdf --between crank housing --margin 0.001 --limits "crank=-1.2,0.8" -o clash.png
  loewner clash panda.urdf --srdf panda.srdf --exempt --write-srdf panda.srdf
  loewner clash mechanism.urdf --largest crank --at "0.1,0,0"
  loewner clash mechanism.urdf --between crank housing --margin 0.001 --proof never.proof
  loewner clash housing.stl plug.stl --scale 0.001 --pose-b "0 0 0.05" --to "0 0 0.012" --margin 1e-5
  loewner clash housing.stl plug.stl --motion insertion.csv

bodies: with a second file, both are saved bodies (.npz) or meshes, and the second one moves: from --pose-b to --to, or
  through the poses of --motion, straight and turning at a constant rate between two poses. Times are the numbers of
  the poses, from 0 on. FREE: proven at all times. COLLIDING: they touch or come within the margin, and are proven free
  until just before. AMBIGUOUS: neither is proven. Meshes are taken as they are unless --model is given.

pairs: those that are checked, unless --between, --exempt or --all chooses others. Adjacent links are exempt if there is
  no SRDF.

verdicts: NEVER and ALWAYS are proven for every configuration in the ranges of the joints between the two bodies.
  SOMETIMES: one configuration with contact and one without are known. CAN: one with contact is known. OPEN: no contact
  was found, and not all is proven.

--write-srdf adds the proven pairs, even if other pairs can collide.
proof: all pairs in question have to be NEVER; otherwise the first other one is named, with exit status 2. loewner
  verify checks the file, with --robot against a robot and a scene.

exit status: 0 all pairs are proven never to collide, 1 a pair can collide, 2 error, 3 no contact was found, but a pair
  is open; with --largest: 0 a range was found; with two bodies: 0 free, 1 colliding, 2 error, 3 ambiguous
"""


def add(commands: Any) -> None:
    """Add the command."""
    clash = inputs.command(commands, "clash", "which parts of a mechanism can ever collide", EXAMPLES, _run)
    inputs.add_robot_options(clash, "bodies at rest, and attached ones (.yaml)")
    option, file, length, flag = inputs.adders(clash)
    file("moving", nargs="?", metavar="B", help="a body that moves past the first one")
    end = clash.add_mutually_exclusive_group()
    end.add_argument("--to", metavar="POSE", help=f"pose of B at the end: {inputs.POSE_HELP}")
    motion = "poses of B: a line for each, or a .npy file of shape (n, 4, 4)"
    end.add_argument("--motion", type=Path, metavar="FILE", help=motion)
    option("--pose-a", metavar="POSE", help="pose of the first body, which is at rest (the origin)")
    option("--pose-b", metavar="POSE", help="pose of B at the beginning (the origin)")
    option("--scale", type=float, default=1.0, help="factor for all lengths of two meshes (1)")
    which = clash.add_mutually_exclusive_group()
    which.add_argument(
        "--between", nargs=2, metavar=("A", "B"), action="append", help="two links or bodies; repeatable"
    )
    which.add_argument("--exempt", action="store_true", help="the pairs that are exempt from checking")
    which.add_argument("--all", action="store_true", help="all pairs of links with bodies")
    length("--margin", default=0.0, help="distance that counts as contact [m] (0)")
    limits = "a range [rad or m] instead of the limits in the URDF; repeatable"
    option("--limits", action="append", default=[], metavar="J=LO,HI", help=limits)
    option("--boxes", type=int, default=1_000_000, metavar="N", help="boxes of configurations to examine (%(default)s)")
    largest = "the largest range of this joint about --at that is proven free; repeatable for a box of several"
    option("--largest", action="append", metavar="J", help=largest)
    option("--at", metavar="Q", help="a configuration for --largest: a state, a file or numbers (zero)")
    file("-o", "--out", help="draw the deepest contact, or the nearest pair (.png or .svg)")
    file("--write-srdf", help="add the pairs that are proven to this SRDF")
    flag("--narrower", help="with --write-srdf: also pairs proven for less than the hard limits")
    file("--proof", help="write a proof of all pairs with a joint between their bodies, for loewner verify")
    flag("--json", help="print JSON")
    unused = dict.fromkeys((*inputs.OF_PIECES, *inputs.OF_SURFACES))
    clash.set_defaults(usual_model="surface", hull=False, **unused)


def _run(options: argparse.Namespace) -> int:
    if options.moving is not None:
        return _run_motion(options)
    inputs.refuse(options, OF_BODIES, "{}: expected two bodies with it, found one file")
    inputs.expect_suffix(options.out, "--out", inputs.DRAWN)
    if options.at is not None and not options.largest:
        raise InputError("--at: expected --largest with it, found none")
    if options.largest and not options.out is options.write_srdf is options.proof is None:
        raise InputError("--largest: expected neither --out, --write-srdf nor --proof with it, found one of them")
    output.remove_older_proof(options.proof)
    scene = None if options.scene is None else loewner.load_scene(options.scene)
    robot = inputs.robot(options)
    limits = dict(_limits(text) for text in options.limits)
    if len(limits) < len(options.limits):
        raise InputError("--limits: expected each joint once, found one again")
    pairs = _pairs(robot, scene, options)
    arguments: Any = {"margin": options.margin, "limits": limits, "scene": scene, "boxes": options.boxes}
    if options.largest:
        about = configurations.one(options.at, "--at", options, robot)
        ranges = robot.free_range(options.largest, about, pairs=pairs, **arguments)
        output.print_answer(options, {name: list(ends) for name, ends in ranges.items()}, lambda: _print_ranges(ranges))
        return output.STATUS["FREE"]
    with output.progress_of("pairs", len(pairs)) as progress:
        proven_pairs = robot.prove_pairs(pairs, progress=progress, proof=options.proof is not None, **arguments)
    if proven_pairs.proof is not None:
        proven_pairs.proof.save(options.proof)
    answer = {
        "robot": proven_pairs.robot, "pairs": [_entry(row, robot) for row in proven_pairs],
        "never_checked": [list(pair) for pair in proven_pairs.rigid],
    }  # fmt: skip
    files = []
    if options.out is not None:
        _draw(proven_pairs, robot, scene, options.out)
        files.append(shown(options.out))
    if options.write_srdf is not None:
        added = proven_pairs.to_srdf(options.write_srdf, narrower=options.narrower)
        files.append(f"{shown(options.write_srdf)}, with {output.counted(len(added), 'pair')} added")

    def print_text() -> None:
        print_pairs(proven_pairs, robot)
        for file in files:
            print(f"written   {file}")

    output.print_answer(options, answer, print_text)
    verdicts = {row.verdict for row in proven_pairs}
    if verdicts & {PairVerdict.ALWAYS, PairVerdict.SOMETIMES, PairVerdict.CAN}:
        return output.STATUS["COLLIDING"]
    return output.STATUS["FREE" if verdicts == {PairVerdict.NEVER} else "AMBIGUOUS"]


def _run_motion(options: argparse.Namespace) -> int:
    """Find the first contact of a body at rest and a second body that moves."""
    inputs.refuse(options, OF_ROBOTS, "{}: expected a robot alone with it, found two files")
    inputs.expect_suffix(options.out, "--out", inputs.DRAWN)
    if options.model == "auto":
        raise InputError("--model: expected surface, pieces or hull for bodies, found auto, which is for robots")
    poses = _motion(options)
    path = path_of(np.arange(float(len(poses))), poses, False)
    Ta = inputs.pose(options.pose_a, "--pose-a")
    a, b = inputs.bodies((options.urdf, options.moving), options)
    contact = loewner.first_contact(a, Ta, b, (poses[:-1], poses[1:]), margin=options.margin)
    verdict, free_until, at = _first(*map(np.asarray, (contact.verdict, contact.free_until, contact.touching_at)))
    answer: dict[str, Any] = {"verdict": verdict.name, "margin": options.margin, "times": [0, len(poses) - 1]}
    answer |= {"free_until": free_until, "touching_at": at}
    if at is not None:
        answer["pose"] = path.poses(at).tolist()
        near = loewner.distance(a, Ta, b, answer["pose"], exact=True)
        answer["distance"] = near.distance
        answer |= {name: np.asarray(getattr(near, name)).tolist() for name in ("witness_a", "witness_b", "normal")}
    answer |= {"a_model": output.model_text(a), "b_model": output.model_text(b)}
    output.print_answer(options, answer, lambda: _print_contact(answer, options.urdf, options.moving))
    if options.out is not None and at is not None:
        ax = plots.pair(a, Ta, b, answer["pose"])
        ax.set_title(f"{options.urdf.stem} and {options.moving.stem}: {verdict.name} at {at:.6g}")
        plots.save(ax.figure, options.out)
    elif options.out is not None:
        print(f"note: {shown(options.out)} is not written, since no contact is known", file=sys.stderr)
    return output.STATUS[verdict.name]


def _motion(options: argparse.Namespace) -> Floats:
    """Return the poses of the second body, shape (n, 4, 4)."""
    if options.to is None and options.motion is None:
        raise InputError("expected --to or --motion with two bodies, found none; loewner check is for bodies at rest")
    if options.to is not None:
        start = inputs.pose(options.pose_b, "--pose-b")
        return np.array([np.eye(4) if start is None else start, inputs.pose(options.to, "--to")])
    if options.pose_b is not None:
        raise InputError("--pose-b: expected it with --to only, found --motion, whose first pose is the beginning")
    return inputs.poses(options.motion)


def _first(verdicts: Any, free_until: Floats, touching: Floats) -> tuple[loewner.Verdict, float | None, float | None]:
    """Combine the answers for successive motions. Motion k lasts from time k to time k + 1."""
    for first in np.flatnonzero(verdicts != loewner.Verdict.FREE)[:1]:
        # Contact in a later motion is certain, even if an earlier motion is AMBIGUOUS.
        hit = next(iter(np.flatnonzero(verdicts == loewner.Verdict.COLLIDING)), first)
        at = float(hit + touching[hit])
        contact_time = None if np.isinf(at) else at
        return loewner.Verdict(int(verdicts[hit])), float(first + free_until[first]), contact_time
    return loewner.Verdict.FREE, None, None


def _print_contact(answer: dict[str, Any], a: Path, b: Path) -> None:
    keep = f" with a margin of {answer['margin']:g} m" if answer["margin"] else ""
    print(f"{answer['verdict']}{keep}  ({a.name} and {b.name}, times from 0 to {answer['times'][1]})")
    if answer["free_until"] is not None:
        print(f"free until  {answer['free_until']:.9g}, proven")
    if answer["touching_at"] is not None:
        T = np.array(answer["pose"])
        turn = " ".join(f"{x:.9g}" for x in quaternions_of(T[None, :3, :3])[0] + 0.0)
        print(f"touching at {answer['touching_at']:.9g}, with a distance of {answer['distance']:z.3g} m")
        print(f"pose of B   {output.coordinates(T[:3, 3])} {turn}")
        output.print_contact_points(answer)
    for path, model in ((a, answer["a_model"]), (b, answer["b_model"])):
        print(f"model       {path.name}: {model}")


def _limits(text: str) -> tuple[str, tuple[float, float]]:
    name, _, ends = text.rpartition("=")
    try:
        low, high = (float(end) for end in ends.split(","))
    except ValueError:
        raise InputError(f"--limits: expected JOINT=LOWER,UPPER, found {text!r}") from None
    return name, (low, high)


def _pairs(robot: loewner.Robot, scene: loewner.Scene | None, options: argparse.Namespace) -> list[Pair]:
    """Return the pairs in question. An empty list is an error."""
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
    """Convert a row to the form of JSON."""

    def named(q: Floats | None) -> dict[str, float] | None:
        return None if q is None else dict(zip(robot.configuration_names, q.tolist(), strict=True))

    ends = zip(row.lower.tolist(), row.upper.tolist(), strict=True)
    finite = [[end if np.isfinite(end) else None for end in pair] for pair in ends]
    return {
        "names": list(row.names),
        "verdict": str(row.verdict),
        "range": dict(zip(row.columns, finite, strict=True)),
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


def _print_ranges(ranges: dict[str, tuple[float, float]]) -> None:
    for name, (low, high) in ranges.items():
        print(f"FREE       {name} from {low:.13g} to {high:.13g}")


def _draw(found: ProvenPairs, robot: loewner.Robot, scene: loewner.Scene | None, path: Path) -> None:
    """Draw the nearest two bodies at the configuration at which they are nearest."""
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
