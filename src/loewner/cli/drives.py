"""``loewner plan --base``: find a drive of a mobile base, with or without a map in the format of ROS's map server."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import planners
from loewner._base import _tables
from loewner._base._files import replacing, shown
from loewner._base._validate import Floats, finite_array, positive_scalar
from loewner.cli import configurations, inputs, output
from loewner.errors import InputError
from loewner.planners.drives import base_columns
from loewner.scenes import maps

# Width in metres of the occupied space around a map, which is more than any robot's reach.
BEYOND = 10.0

# Options of other plans that drives do not use, and options that only drives use.
OF_OTHERS = (
    "goal_pose", "joints", "leave", "reach", "overlap", "sampled", "planner", "resolution", "improve_for", "weights",
    "clearance", "start_time", "arrive_by", "velocity",
)  # fmt: skip
OF_DRIVES = ("radius", "no_reverse", "map")


def add_options(plan: argparse.ArgumentParser) -> None:
    """Add the options of drives to `loewner plan`."""
    option, _, length, flag = inputs.adders(plan)
    option("--base", choices=("differential", "car"), help="plan for a mobile base that cannot drive sideways")
    length("--radius", metavar="R", help="with --base car: least radius of its turns in metres")
    flag("--no-reverse", help="with --base: do not drive backwards")
    of_map = "with --base: a map of ROS's map server, H metres high (.yaml)"
    option("--map", nargs=2, metavar=("FILE", "H"), help=of_map)


def refuse_unused(options: argparse.Namespace) -> None:
    """Refuse the options of drives if there is no base; if there is one, refuse options that drives do not use."""
    if options.base is None:
        inputs.refuse(options, OF_DRIVES, "{}: expected --base with it")
    else:
        inputs.refuse(options, OF_OTHERS, "{}: expected no --base with it; drives are proven, by their own search")


def run(options: argparse.Namespace) -> int:
    """Plan a drive, print it and write it to a file."""
    scene = inputs.scene(options)
    output.remove_older_proof(options.proof)
    robot = _on_a_base(inputs.robot(options), _add_map(scene, options))
    start = robot.checked_one(_end(options.start, "--start", options, robot, robot.configuration()), "--start")
    goal = _end(options.goal, "--goal", options, robot, start)
    checker = inputs.checker(options, robot, scene)
    with output.progress_of("searching"):
        drive = planners.plan(
            checker, start, goal, base=options.base, radius=options.radius, reverse=not options.no_reverse,
            joint_error=options.joint_error, timeout=options.timeout, simplify=not options.no_simplify,
            proof=options.proof is not None, seed=options.seed, **inputs.given(options, ("max_iterations",)),
        )  # fmt: skip
    if options.out is not None:
        _write(options.out, drive)
    if drive.proof is not None:
        drive.proof.save(options.proof)
    answer = _answer(checker, drive, options)
    output.print_answer(options, answer, lambda: _print_answer(answer))
    return output.FREE


def _add_map(scene: loewner.Scene, options: argparse.Namespace) -> Floats | None:
    """Add occupied and unknown cells of the map, and all space around it, to the scene; return the map's bounds."""
    if options.map is None:
        return None
    file, text = options.map
    try:
        height = positive_scalar(_tables.number(text), "--map, height")
    except ValueError:  # includes errors of this library
        raise InputError(f"--map, height: expected metres above 0, found {text!r}") from None
    grid = maps.read_map(file)
    body = maps.body_of(grid, height, unknown=True)
    if body is not None:
        scene.add("map", body, maps.corner(grid))
    bounds = maps.bounds_of(grid)
    width = BEYOND + float(np.ptp(bounds, axis=1).sum())
    scene.add("outside of the map", maps.around(grid, height, width), maps.corner(grid))
    return bounds


def _on_a_base(robot: loewner.Robot, bounds: Floats | None) -> loewner.Robot:
    """Return the robot if it has a planar base, or put it on a planar base that stays within the bounds of the map."""
    try:
        base_columns(robot)
    except InputError:
        if bounds is None:
            raise InputError(
                "--base: expected a robot whose root slides along x and y and turns, or --map, within which a base is "
                f"added, found the joints {', '.join(robot.joint_names) or 'none'} and no map"
            ) from None
        return robot.add_base("planar", bounds)
    return robot


def _end(text: str, name: str, options: argparse.Namespace, robot: loewner.Robot, others: Floats) -> Floats:
    """Read a configuration. Three numbers are a pose of the base; `others` then has the other joints' values."""
    try:
        pose = finite_array(_tables.row(text), name, (3,))
    except ValueError:  # not three numbers
        return configurations.given(text, name, options, robot, others)
    q = others.copy()
    q[list(base_columns(robot))] = pose
    return q


def _write(path: Path, drive: planners.Drive) -> None:
    """Write the configurations at which motions begin, with lengths and turns. The last row is the goal."""
    if path.suffix.lower() == ".csv":
        motions = np.concatenate([drive.motions, np.zeros((1, 2))])
        configurations.write(path, (*drive.names, "length", "turn"), np.column_stack([drive.path, motions]))
        return
    content = {"names": drive.names, "configurations": drive.path.tolist(), "motions": drive.motions.tolist()}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="")


def _answer(checker: loewner.CollisionChecker, drive: planners.Drive, options: argparse.Namespace) -> dict[str, Any]:
    """Make the full report on a drive."""
    shares = np.linspace(0.0, 1.0, output.MEASURED)
    t = drive.times[:-1, None] * (1.0 - shares) + drive.times[1:, None] * shares
    measured = checker.distance(drive.positions(np.clip(t, drive.times[0], drive.times[-1])), exact=True)
    motions = [
        {"length": length, "turn": turn, **near}
        for (length, turn), near in zip(drive.motions.tolist(), output.nearest_pairs(measured), strict=True)
    ]
    return {
        "robot": checker.robot.name,
        "verdict": "FREE",
        "base": options.base,
        "radius": options.radius,
        "joint_error": options.joint_error,
        "names": list(drive.names),
        "configurations": drive.path.tolist(),
        "motions": motions,
        "length": drive.length,
        "turn": drive.turn,
        "reversals": drive.reversals,
        "measured": output.MEASURED,
        **output.pairs_of(checker),
        "poses": drive.iterations,
        "seconds": drive.seconds,
        "out": None if options.out is None else str(options.out),
        "proof": None if drive.proof is None else str(options.proof),
    }


def _print_answer(answer: dict[str, Any]) -> None:
    motions = answer["motions"]
    error = f", with every value up to {answer['joint_error']:g} off" if answer["joint_error"] else ""
    print(f"FREE  {output.counted(len(motions), 'motion')} from start to goal, proven free as they are driven{error}")
    rows = [
        (
            str(k), f"{motion['length']:.4g}", f"{np.rad2deg(motion['turn']):.4g}", f"{1e3 * motion['nearest']:z.3f}",
            *motion["nearest_pair"],
        )
        for k, motion in enumerate(motions)
    ]  # fmt: skip
    columns = ("motion", "length, m", "turn, degrees", "nearest, mm", "body", "other body")
    output.print_table(columns, rows, output.heading(answer))
    changes, poses = output.counted(answer["reversals"], "change"), output.counted(answer["poses"], "pose")
    print(f"length    {answer['length']:.6g} m, {np.rad2deg(answer['turn']):.4g} degrees, {changes} of direction")
    print(f"found in  {output.lasting(answer['seconds'])}, from {poses}, this machine, this run")
    for name in ("out", "proof"):
        if answer[name] is not None:
            print(f"written   {shown(answer[name])}")
