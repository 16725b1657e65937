"""``loewner audit``: find the collisions of a trajectory from any program, with times and depths."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import Verdict, _validate, planners, plots
from loewner._validate import Floats
from loewner.cli import configurations, inputs
from loewner.cli.output import AMBIGUOUS, COLLIDING, FREE, new_table, print_table, remove_older_proof
from loewner.errors import FileError, InputError, LoewnerError
from loewner.planners.controller_points import TIMES
from loewner.robots import curves

# Width of the picture along time, in characters.
COLUMNS = 60
MARKS = {Verdict.FREE: ".", Verdict.AMBIGUOUS: "?", Verdict.COLLIDING: "#"}

# Distances within which a piece's pair is sought, one after the other [m].
WITHIN = np.geomspace(1e-3, 1e9, 13)

DRAWN = (".png", ".svg")
CONTROLLERS = ("linear", "cubic", "quintic")

EXAMPLES = """examples:
  loewner audit panda.urdf moves.csv --srdf panda.srdf --scene shelf.yaml
  loewner audit panda.urdf moves.yaml --scene shelf.yaml --controller linear --joint-error 1e-3 -o moves.svg
  loewner audit panda.urdf path.csv --srdf panda.srdf --scene shelf.yaml       a path of loewner plan -o path.csv

trajectory: a .json or .yaml file with a trajectory_msgs/JointTrajectory, by itself or within another message; or a .csv
  file with the columns time, the joints' names and optionally "NAME velocity" and "NAME acceleration" for each joint;
  or a path without times that loewner plan has written (.csv or .json), whose straight motions are checked.
  Bodies that follow motions move at the file's own times; messages count from their start, so give --start-time.

controller: between two points a joint trajectory controller follows a straight line if there are only positions, a
  cubic polynomial if there are velocities as well, and a quintic one if there are accelerations too. The proof covers
  this curve at every real time.

exit status: 0 proven free at every time, 1 collides, 2 error, 3 no collision was found, but it is ambiguous
"""


def add(commands: Any) -> None:
    """Add the command."""
    audit = inputs.command(commands, "audit", "collisions of a trajectory as a controller executes it", EXAMPLES)
    inputs.add_robot_options(audit)
    audit.add_argument(
        "trajectory", type=Path, metavar="FILE", help="points with times, or a path (.csv, .json, .yaml)"
    )
    audit.add_argument("--scene", type=Path, metavar="FILE", help="obstacles and attached bodies (.yaml)")
    audit.add_argument(
        "--controller",
        choices=CONTROLLERS,
        help="interpolation between points (default: from the contents of the file)",
    )
    audit.add_argument(
        "--others", metavar="Q", help="values of joints that the file does not name: a state, a file, or numbers (0)"
    )
    audit.add_argument(
        "--joint-error", type=float, default=0.0, metavar="E", help="largest deviation of every value [rad or m] (0)"
    )
    audit.add_argument(
        "--start-time",
        type=float,
        metavar="T",
        help="when the trajectory starts, on the clock of bodies that move (what the file says, or 0)",
    )
    audit.add_argument(
        "-o", "--out", type=Path, metavar="FILE", help="draw the unproven pairs along the trajectory (.png or .svg)"
    )
    audit.add_argument("--proof", type=Path, metavar="FILE", help="if it is free: write a proof, for loewner verify")
    audit.add_argument("--json", action="store_true", help="print JSON")
    audit.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    if options.out is not None and options.out.suffix.lower() not in DRAWN:
        raise FileError(f"--out: expected a .png or .svg file, found {options.out}")
    remove_older_proof(options.proof)
    scene = loewner.Scene() if options.scene is None else loewner.load_scene(options.scene)
    robot = inputs.robot(options)
    checker = loewner.CollisionChecker(robot, scene)
    inputs.refuse_no_pairs(checker, options.urdf)
    others = None
    if options.others is not None:
        others = robot.checked_one(configurations.given(options.others, "--others", options, robot, None), "--others")
    given = _read(options.trajectory, robot, others)
    if isinstance(given, planners.ControllerPoints):
        given = _executed(given, options.controller)
        if options.start_time is not None:
            given.start_time = _validate.real(options.start_time, "--start-time")
    elif options.start_time is not None:
        raise InputError(f"--start-time {options.start_time:g}: expected points with times, found a path without")
    elif options.controller not in (None, "linear"):
        raise InputError(f"--controller {options.controller}: expected points with times, found a path without")
    answer = _answer(checker, given, options)
    if options.out is not None:
        plots.save(plots.trajectory(checker, given, joint_error=options.joint_error), options.out)
    if options.json:
        print(json.dumps(answer, indent=2))
    else:
        _print_answer(answer)
        if options.proof is not None and answer["proof"] is None:
            print(f"no proof  {options.proof} is not written: there is no proof of this motion")
    return {"FREE": FREE, "COLLIDING": COLLIDING, "AMBIGUOUS": AMBIGUOUS}[answer["verdict"]]


def _read(path: Path, robot: loewner.Robot, others: Floats | None) -> planners.ControllerPoints | Floats:
    """Read points with times, or a path without times, as `loewner plan` writes it, of shape (two or more, dof)."""
    try:
        return planners.ControllerPoints.load(path, robot=robot, others=others)
    except LoewnerError:
        if not configurations.is_path(path, TIMES):
            raise
    return configurations.path_of(path, robot)


def _derivatives(points: planners.ControllerPoints) -> int:
    """Return the number of derivatives that the points have: 1 with velocities, 2 with accelerations as well."""
    return sum(one is not None for one in (points.velocities, points.accelerations))


def _executed(points: planners.ControllerPoints, controller: str | None) -> planners.ControllerPoints:
    """Return the points with as many derivatives as a controller uses."""
    held = [points.velocities, points.accelerations]
    used = _derivatives(points) if controller is None else CONTROLLERS.index(controller)
    if any(one is None for one in held[:used]):
        wanted = ("velocities", "accelerations")[_derivatives(points)]
        raise InputError(f"--controller {controller}: expected points with {wanted}, found none in the file")
    kept = [one if k < used else None for k, one in enumerate(held)]
    return planners.ControllerPoints(
        points.times, points.positions, *kept, names=points.names, start_time=points.start_time
    )


def _answer(
    checker: loewner.CollisionChecker, given: planners.ControllerPoints | Floats, options: argparse.Namespace
) -> dict[str, Any]:
    """Return the verdicts and distances of a trajectory or path and of its pieces, for printing."""
    prove = options.proof is not None
    curve, found = curves.proven(checker, given, options.joint_error, str(options.trajectory), prove)
    if found.proof is not None:
        found.proof.save(options.proof)
    times, unproven = found.times, np.flatnonzero(found.segments.verdict != Verdict.FREE)
    ticks, piece, Q = curves.sampled(checker.robot, curve, found)
    measured = checker.distance(Q, ticks, exact=True)
    nearest = measured.distance.argmin()
    names = found.segments.names
    least = _nearest_of(checker, names, piece, Q, ticks)
    pieces = [
        {
            "number": int(k),
            "begins": float(times[k]),
            "ends": float(times[k + 1]),
            "verdict": Verdict(int(found.segments.verdict[k])).name,
            "time": float(time),
            "pair": names[k].tolist(),
            "margin": checker.scene.margin_of(*names[k].tolist()),
            "nearest": least[k][0],
            "nearest_time": float(ticks[least[k][1]]),
        }
        for k, time in zip(unproven.tolist(), ticks[curves.MEASURED :], strict=True)
    ]
    free = found.verdict == Verdict.FREE
    controller = CONTROLLERS[_derivatives(given)] if isinstance(given, planners.ControllerPoints) else None
    return {
        "robot": checker.robot.name,
        "verdict": found.verdict.name,
        "time": None if free else float(found.time),
        "pair": None if free else list(found.names),
        "timed": controller is not None,
        "controller": controller,
        "joint_error": options.joint_error,
        "begins": float(times[0]),
        "ends": float(times[-1]),
        "pieces": len(times) - 1,
        "unproven": pieces,
        "nearest": float(measured.distance[nearest]),
        "nearest_time": float(ticks[nearest]),
        "nearest_pair": measured.names[nearest].tolist(),
        "picture": _picture(times, found.segments.verdict),
        "checked_pairs": len(checker.checked_pairs),
        "proof": str(options.proof) if found.proof is not None else None,
        "moving": list(checker.scene.following),
    }


def _nearest_of(
    checker: loewner.CollisionChecker, names: Any, piece: Any, Q: Floats, t: Floats
) -> dict[int, tuple[float, int]]:
    """Return the least distance of each unproven piece's pair at the samples of the piece, and that sample."""
    least: dict[int, tuple[float, int]] = {}
    for within in WITHIN:  # nearer pairs are found first
        rows = np.flatnonzero(names.any(axis=1)[piece] & ~np.isin(piece, list(least)))
        if len(rows) == 0:
            break
        near = checker.distance_by_pair(Q[rows], t[rows], within=within)
        samples = rows[near.configuration]
        own = np.flatnonzero((near.names == names[piece[samples]]).all(axis=1))
        for n in own[np.argsort(near.distance[own], kind="stable")]:
            least.setdefault(int(piece[samples[n]]), (float(near.distance[n]), int(samples[n])))
    return least


def _picture(times: Floats, verdicts: Any) -> str:
    """Draw, for equal parts of the time, the worst verdict of the pieces in each."""
    edges = np.linspace(times[0], times[-1], COLUMNS + 1)
    first = np.searchsorted(times, edges[:-1], side="right") - 1
    last = np.maximum(np.searchsorted(times, edges[1:], side="left"), first + 1)
    worst = ("".join(MARKS[Verdict(int(one))] for one in verdicts[i:j]) for i, j in zip(first, last, strict=True))
    return "".join(next(mark for mark in "#?." if mark in part) for part in worst)


def _print_answer(answer: dict[str, Any]) -> None:
    unit, comma_unit = (" s", ", s") if answer["timed"] else ("", "")
    count = "1 piece" if answer["pieces"] == 1 else f"{answer['pieces']} pieces"
    if answer["verdict"] == "FREE":
        print(f"FREE  {count}, proven free at every {'time' if answer['timed'] else 'configuration on the way'}")
    else:
        print(
            f"{answer['verdict']}  {len(answer['unproven'])} of {count} not proven free, "
            f"{' and '.join(answer['pair'])} at {answer['time']:.6g}{unit}"
        )
        table = new_table(
            "piece", f"from{comma_unit}", f"to{comma_unit}", "verdict", f"at{comma_unit}", "body", "other body",
            "nearest, mm", title=f"{answer['robot']}, {answer['checked_pairs']} pairs checked",
        )  # fmt: skip
        for piece in answer["unproven"]:
            table.add_row(
                str(piece["number"]), f"{piece['begins']:.6g}", f"{piece['ends']:.6g}", piece["verdict"],
                f"{piece['time']:.6g}", *piece["pair"], f"{1e3 * piece['nearest']:z.3f}",
            )  # fmt: skip
        print_table(table)
        for pair, margin in {tuple(piece["pair"]): piece["margin"] for piece in answer["unproven"]}.items():
            if margin:
                print(f"margin    {1e3 * margin:.6g} mm, which {' and '.join(pair)} have to keep")
        if answer["joint_error"]:
            print(
                f"error     the verdicts are for values up to {answer['joint_error']:g} off, the distances for values "
                "that are not"
            )
    what = "time " if answer["timed"] else "point"
    print(f"{what}     {answer['begins']:.6g}{unit} {answer['picture']} {answer['ends']:.6g}{unit}")
    print("          . proven free   ? ambiguous   # collides, by pieces")
    print(
        f"nearest   {1e3 * answer['nearest']:z.3f} mm at {answer['nearest_time']:.6g}{unit}, "
        f"{' and '.join(answer['nearest_pair'])}: the least of the exact distances at {curves.MEASURED} places; "
        "negative is a depth; margins are not subtracted"
    )
    error = f", every value up to {answer['joint_error']:g} off" if answer["joint_error"] else ""
    if answer["timed"]:
        print(f"curve     {answer['controller']} between points{error}")
    else:
        print(f"curve     straight between the configurations of the file, numbered from 0; it has no times{error}")
    if answer["moving"]:
        print(
            f"clock     the trajectory begins at {answer['begins']:.6g} s on the clock of the bodies that move "
            f"({', '.join(answer['moving'])}); --start-time sets when"
        )
    if answer["proof"] is not None:
        print(f"written   {answer['proof']}, for loewner verify")
