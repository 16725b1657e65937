"""``loewner audit``: find the collisions in a trajectory from any program, with their times and depths."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import Verdict, planners, plots
from loewner._base import _validate
from loewner._base._files import shown
from loewner._base._nodes import some
from loewner._base._validate import Floats
from loewner.cli import configurations, inputs, output, trajectories
from loewner.planners import limit_use
from loewner.planners.controller_points import START_TOLERANCE
from loewner.planners.joint_limits import position_limits
from loewner.robots import ClosestApproach
from loewner.robots.proofs import approaches, curves

# Width of the picture in characters, along the axis of time.
COLUMNS = 60

# Largest number of lines of one kind that are printed.
SHOWN = 5

# Exit status for a trajectory that is free but exceeds a limit.
BEYOND = 4
MARKS = {Verdict.FREE: ".", Verdict.AMBIGUOUS: "?", Verdict.COLLIDING: "#"}

EXAMPLES = """examples:
  loewner audit panda.urdf moves.csv --srdf panda.srdf --scene shelf.yaml
  loewner audit panda.urdf moves.yaml --scene shelf.yaml --controller linear --joint-error 1e-3 -o moves.svg
  loewner audit panda.urdf path.csv --srdf panda.srdf --scene shelf.yaml       a path of loewner plan -o path.csv
  loewner audit panda.urdf solution.yaml --scene shelf.yaml --attach 2:can=panda_hand --attach 3:can=panda_hand

trajectory: a .json or .yaml file with a trajectory_msgs/JointTrajectory, by itself or within a message of MoveIt or of
  an action; or a .csv file with the columns time, the joints' names and optionally "NAME velocity" and "NAME
  acceleration" for each joint; or a path without times that loewner plan has written (.csv or .json), whose straight
  motions are checked. A message with several trajectories is proven part by part, in order; each part has its own
  start state. Bodies that follow motions move at the file's own times; messages count from their start, so give
  --start-time. Parts of a message follow each other without a pause.

attach: in the named part, or in all parts, the link carries the body of the scene. The link picks the body up where it
  is when the part begins, and puts it down where the part ends, but a body that the same link carries in the next part
  stays in the link's hold. Bodies that the message attaches have to be attached by this option or in the scene file.

controller: between two points a joint trajectory controller follows a straight line if there are only positions, a
  cubic polynomial if there are velocities as well, and a quintic one if there are accelerations too. The proof covers
  this curve at every real time.

nearest: the exact distance, or the depth, at the worst moment that was found, and a bound that is proven for every
  moment. If the two differ by more than 10 µm and by more than a hundredth of the distance, the output says so.

limits: the extreme positions, velocities, accelerations and jerk of the curve, at whichever time they are reached, are
  compared with the limits of the URDF or of --limits. Files without velocities have corners, which are named.

exit status: 0 proven free at every time, 1 collides (also on the way from --from), or a contact that rules allow is
  deeper than --overlap, 2 error, 3 no collision was found, but it is ambiguous, 4 free, but beyond a limit of the robot
"""


def add(commands: Any) -> None:
    """Add the command."""
    audit = inputs.command(commands, "audit", "collisions of a trajectory as a controller executes it", EXAMPLES, _run)
    inputs.add_robot_options(audit)
    option, file, length, flag = inputs.adders(audit)
    trajectories.add_input(audit)
    file("--limits", help="limits of joints, which replace the URDF's (joint_limits.yaml)")
    length("--overlap", default=output.OVERLAP, help=output.OVERLAP_HELP)
    present = "the robot's present state, as a state, a file or numbers: also prove the straight way to the first point"
    option("--from", dest="present", metavar="Q", help=present)
    file("-o", "--out", help="draw distances along the trajectory (.png or .svg)")
    file("--proof", help="if it is free: write a proof, for loewner verify")
    flag("--json", help="print JSON")


def _run(options: argparse.Namespace) -> int:
    inputs.expect_suffix(options.out, "--out", inputs.DRAWN)
    output.remove_older_proof(options.proof)
    scene, robot = inputs.scene(options), inputs.robot(options)
    checker = inputs.checker(options, robot, scene)
    limits = None if options.limits is None else planners.JointLimits.load(options.limits, robot)
    overlap = _validate.positive_scalar(options.overlap, "--overlap", zero=True)
    present = configurations.one(options.present, "--from", options, robot)
    parts, answers = trajectories.read(options, scene, robot, present), list[dict[str, Any]]()
    ways: list[dict[str, Any] | None] = []

    def arrive(number: int) -> None:
        # While the robot moves to the first point, the bodies that the part carries are still in their places.
        part, start, whence = parts[number][0], present, "--from"
        if number:
            start, whence = trajectories.end(robot, parts[number - 1][0], -1), f"the end of part {number}"
            waits = bool(scene.following) and isinstance(part, planners.ControllerPoints) and part.times[0] > 0
            if np.abs(trajectories.end(robot, part, 0) - start).max() <= trajectories.ROUNDED and not waits:
                start = None
        elif start is not None:
            trajectories.expect_grasps_in_place(robot, start, part, parts[0][1])
        ways.append(None if start is None else _way_to(checker, part, start, whence, options.joint_error, overlap))

    for number, part in enumerate(trajectories.carried(parts, scene, robot, arrive)):
        proof, picture = (_numbered(file, number, len(parts)) for file in (options.proof, options.out))
        output.remove_older_proof(proof)
        answer = _answer(checker, part, options, limits, proof) | {"before": ways[number]}
        deep = _deeper(answer["allowed"], overlap)
        answers.append(answer | {"overlap": overlap, "deep": deep})
        if picture is not None:
            plots.save(plots.trajectory(checker, part, joint_error=options.joint_error), picture)
        if not options.json:
            if len(parts) > 1:
                print(f"{chr(10) * bool(number)}part      {number + 1} of {len(parts)}, {answer['place']}")
            _print_answer(answers[-1])
            if picture is not None:
                print(f"written   {shown(picture)}")
            if proof is not None and answer["proof"] is None:
                print(f"no proof  {proof} is not written: there is no proof of this motion")
    befores = [way for way in ways if way is not None]
    verdicts = [answer["verdict"] for answer in [*answers, *befores]]
    worst = min(verdicts, key=output.WORST_FIRST.index)
    if options.json:
        print(json.dumps(answers[0] if len(answers) == 1 else {"verdict": worst, "parts": answers}, indent=2))
    elif len(answers) > 1:
        free = sum(answer["verdict"] == "FREE" for answer in answers)
        print(f"\n{worst}  {free} of {len(answers)} parts proven free")
    if worst == "FREE" and any(answer["deep"] for answer in [*answers, *befores]):
        return output.COLLIDING
    exceeded = any(answer["exceeded"] for answer in answers) or any(way["too_fast"] for way in befores)
    return BEYOND if exceeded and worst == "FREE" else output.STATUS[worst]


def _way_to(
    checker: loewner.CollisionChecker, part: trajectories.Part, present: Floats, whence: str, joint_error: float,
    overlap: float,
) -> dict[str, Any]:  # fmt: skip
    """Prove the straight motion from a state to the first point of a part, within the available time."""
    robot, first = checker.robot, trajectories.end(checker.robot, part, 0)
    timed = isinstance(part, planners.ControllerPoints)
    begin, due = (part.start_time, float(part.times[0])) if isinstance(part, planners.ControllerPoints) else (0.0, 0.0)
    t0, t1 = (begin, begin + due) if checker.scene.following else (None, None)
    answer = checker.certify_edges(present, first, joint_error=joint_error, t0=t0, t1=t1)
    deep = list[dict[str, Any]]()
    ruled = checker.scene.leaving | checker.scene.reaching
    if ruled and answer.verdict == Verdict.FREE and (t0 is None or due > 0):
        way = curves.of_path(robot, np.stack([present, first]))
        way = way._replace(times=way.times if t0 is None else np.array([t0, t1]))
        allowed = approaches.along(checker, way, np.arange(0)).allowed
        deep = _deeper([_allowed(checker, pair, each) for pair, each in allowed.items()], overlap)
    off = np.abs(first - present)
    most, fast = int(off.argmax()), False
    text = f"the straight way from {whence} to the first point is {answer.verdict.name}"
    if answer.verdict != Verdict.FREE:
        text += f": {' and '.join(answer.names)} at the fraction {answer.fraction:.4g}"
    if off[most] <= START_TOLERANCE:
        text += f"; the robot is within {off[most]:.3g} of the point"
    elif timed and due == 0:
        text += (
            f"; but the point is due at once, and {robot.configuration_names[most]} is off by {off[most]:.6g}, so most "
            "controllers refuse to start"
        )
    elif due > 0:
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = off / due / np.where(np.isnan(robot.velocity), np.inf, robot.velocity)
        k = int(np.nan_to_num(shares).argmax())
        fast = bool(shares[k] > 1 + limit_use.ROUNDED)
        text += f"; in {due:.6g} s it takes {shares[k]:.3g} of the velocity limit of {robot.configuration_names[k]}"
    numbers = {"fraction": float(answer.fraction), "off": float(off[most]), "too_fast": fast, "deep": deep}
    return _for_json({"verdict": answer.verdict.name, "pair": list(answer.names), **numbers, "text": text})


def _numbered(file: Path | None, number: int, count: int) -> Path | None:
    """Return the file of one part, whose name contains the part's number if there are several parts."""
    return file if file is None or count == 1 else file.with_stem(f"{file.stem}-{number + 1}")


def _answer(
    checker: loewner.CollisionChecker,
    given: trajectories.Part,
    options: argparse.Namespace,
    limits: planners.JointLimits | None,
    written: Path | None,
) -> dict[str, Any]:
    """Return the verdicts and distances of a trajectory or path and of its pieces, for printing."""
    curve, certified = curves.proven(checker, given, options.joint_error, str(options.trajectory), written is not None)
    if certified.proof is not None:
        certified.proof.save(written)
    robot, times, unproven = checker.robot, certified.times, np.flatnonzero(certified.segments.verdict != Verdict.FREE)
    controller = trajectories.controller_of(given)
    timed = controller is not None
    near, allowed, contacts = approaches.along(checker, curve, unproven)
    names = certified.segments.names
    pieces = [
        {
            "number": k,
            "begins": float(times[k]),
            "ends": float(times[k + 1]),
            "verdict": Verdict(int(certified.segments.verdict[k])).name,
            "time": float(times[k] + certified.segments.fraction[k] * (times[k + 1] - times[k])),
            "pair": names[k].tolist(),
            "margin": checker.scene.margin_of(*names[k].tolist()),
            **_nearest(near, k),
        }
        for k in unproven.tolist()
    ]
    free = certified.verdict == Verdict.FREE
    unproven_pairs = [piece["pair"] for piece in pieces]
    uses = limit_use.used(robot, curve, limits, timed)
    return {
        "robot": robot.name,
        "verdict": certified.verdict.name,
        "time": None if free else float(certified.time),
        "pair": None if free else list(certified.names),
        "timed": timed,
        "controller": controller,
        "joint_error": options.joint_error,
        "begins": float(times[0]),
        "ends": float(times[-1]),
        "pieces": len(times) - 1,
        "unproven": pieces,
        "contacts": contacts.tolist(),
        **_nearest(near, near.nearest),
        "allowed": [
            _allowed(checker, pair, each) for pair, each in allowed.items() if list(pair) not in unproven_pairs
        ],
        "picture": _picture(times, certified.segments.verdict),
        **output.pairs_of(checker),
        "proof": str(written) if certified.proof is not None else None,
        "moving": list(checker.scene.following),
        "limits": [_for_json(use._asdict()) for use in uses if np.isfinite(use.limit)],
        "exceeded": [_for_json(use._asdict()) for use in uses if use.ratio > 1 + limit_use.ROUNDED],
        "beyond_limits": _beyond_limits(robot, curve, limits),
        "jumps": [jump._asdict() for jump in limit_use.jumps(robot, curve)] if timed else [],
        "doubts": limit_use.doubts(robot, curve, uses, getattr(given, "velocities", None) is not None),
        **_told_by_a_message(given),
    }


def _allowed(checker: loewner.CollisionChecker, pair: tuple[str, str], near: ClosestApproach) -> dict[str, Any]:
    """Return the end of the trajectory at which two bodies may touch, and how near the bodies come to each other."""
    both = tuple(sorted(pair))
    ends = ("the beginning",) * (both in checker.scene.leaving) + ("the end",) * (both in checker.scene.reaching)
    margin = checker.scene.margin_of(*pair)
    return {"pair": list(pair), "at": " or ".join(ends), "margin": margin} | _nearest(near, near.nearest)


def _deeper(allowed: list[dict[str, Any]], overlap: float) -> list[dict[str, Any]]:
    """Return the contacts that are allowed by rules, but deeper than --overlap."""
    return [each for each in allowed if each["nearest"] < -overlap]


def _for_json(numbers: dict[str, Any]) -> dict[str, Any]:
    return {key: None if isinstance(x, float) and not np.isfinite(x) else x for key, x in numbers.items()}


def _nearest(near: ClosestApproach, k: int) -> dict[str, Any]:
    """Return how near bodies come on a piece: the least distance that was measured, and the proven bound."""
    numbers = {
        "nearest": float(near.distance[k]),
        "nearest_time": float(near.time[k]),
        "nearest_pair": near.names[k].tolist(),
        "nearest_lower": float(near.lower[k]),
        "nearest_close": bool(near.close[k]),
    }
    return _for_json(numbers)


def _told_by_a_message(given: trajectories.Part) -> dict[str, Any]:
    """Return the contents of a message other than its points, and the time of its first point."""
    if not isinstance(given, planners.ControllerPoints):
        return {}
    origin = given.origin
    sources = {column: origin.sources[column] for column in origin.stated}
    more = {"stated": origin.stated, "stated_in": sources, "assumed": trajectories.assumed(given)}
    more = {name: told for name, told in (more | {"carried": given.carried}).items() if told}
    return {"place": origin.place, "first_point_due": float(given.times[0]), **more}


def _beyond_limits(
    robot: loewner.Robot, curve: curves.Curve, limits: planners.JointLimits | None
) -> list[dict[str, Any]]:
    """Return the joint values that are outside a soft or hard limit of the robot, or of --limits, at some time."""
    ends = [limit_use.extremes(curve.courses[:, :, k], curve.times) for k in range(robot.dof)]
    least, most = np.array([[low[0], high[0]] for low, high in ends]).reshape(-1, 2).T
    (hard_lower, hard_upper), soft = position_limits(robot, limits), limits or robot
    hard = (least < hard_lower - trajectories.ROUNDED) | (most > hard_upper + trajectories.ROUNDED)
    outside = hard | (least < soft.lower - trajectories.ROUNDED) | (most > soft.upper + trajectories.ROUNDED)
    lower, upper = np.where(hard, hard_lower, soft.lower), np.where(hard, hard_upper, soft.upper)
    return [
        {
            "value": robot.configuration_names[k],
            "range": [float(least[k]), float(most[k])],
            "limits": [float(end) if np.isfinite(end) else None for end in (lower[k], upper[k])],  # for JSON
            "hard": bool(hard[k]),
        }
        for k in np.flatnonzero(outside).tolist()
    ]


def _picture(times: Floats, verdicts: Any) -> str:
    """Draw the worst verdict of the pieces in each of several equal parts of the time."""
    edges = np.linspace(times[0], times[-1], COLUMNS + 1)
    first = np.searchsorted(times, edges[:-1], side="right") - 1
    last = np.maximum(np.searchsorted(times, edges[1:], side="left"), first + 1)
    worst = ("".join(MARKS[Verdict(int(one))] for one in verdicts[i:j]) for i, j in zip(first, last, strict=True))
    return "".join(next(mark for mark in "#?." if mark in part) for part in worst)


def _print_answer(answer: dict[str, Any]) -> None:
    unit, comma_unit = (" s", ", s") if answer["timed"] else ("", "")
    count = output.counted(answer["pieces"], "piece")
    if answer["before"] and answer["before"]["verdict"] != "FREE":
        pair = " and ".join(answer["before"]["pair"])
        print(f"{answer['before']['verdict']}  before the first point: {pair}; the trajectory itself:")
    if answer["verdict"] == "FREE":
        print(f"FREE  {count}, proven free at every {'time' if answer['timed'] else 'configuration on the way'}")
    else:
        print(
            f"{answer['verdict']}  {len(answer['unproven'])} of {count} not proven free, "
            f"{' and '.join(answer['pair'])} at {answer['time']:.6g}{unit}"
        )
        _print_unproven(answer, comma_unit)
    what = "time " if answer["timed"] else "point"
    print(f"{what}     {answer['begins']:.6g}{unit} {answer['picture']} {answer['ends']:.6g}{unit}")
    print("          . proven free   ? ambiguous   # collides, by pieces")
    for begin, end in answer["contacts"][:SHOWN]:
        print(f"contact   from {begin:.9g}{unit} to {end:.9g}{unit}")
    if len(answer["contacts"]) > SHOWN:
        print(f"          and {len(answer['contacts']) - SHOWN} more times")
    _print_nearest(answer, unit)
    for one in answer["allowed"]:
        if one["nearest"] <= one["margin"]:
            print(
                f"allowed   contact of {' and '.join(one['pair'])} at {one['at']}, down to "
                f"{1e3 * one['nearest']:z.3f} mm at {one['nearest_time']:.6g}{unit}"
            )
    for one, where in [
        *((one, "in this contact") for one in answer["deep"]),
        *((one, "before the first point") for one in (answer["before"] or {"deep": []})["deep"]),
    ]:
        print(output.deep_line(one["pair"], one["nearest"], where, answer["overlap"]))
    error = f", every value up to {answer['joint_error']:g} off" if answer["joint_error"] else ""
    if answer["timed"]:
        print(f"curve     {answer['controller']} between points{error}")
    else:
        print(f"curve     straight between the configurations of the file, numbered from 0; it has no times{error}")
    for column, value in answer.get("stated", {}).items():
        print(f"state     {column} = {value:.9g}, from {answer['stated_in'][column]}; the points do not name it")
    if answer.get("assumed"):
        named = [f"{name} = {value:.9g}" for name, value in answer["assumed"].items()]
        print(f"assumed   {some(named)}: the file has no values of these, which keep the robot's defaults (--others)")
    _print_limits(answer, unit)
    for doubt in answer["doubts"]:
        print(f"doubt     {doubt}")
    if answer.get("before"):
        print(f"before    {answer['before']['text']}")
    elif answer.get("first_point_due", 0.0) > 0:
        print(
            f"before    the first point is due at {answer['first_point_due']:.6g} s; the way there from the "
            "robot's present state is not in the file and is not checked (--from)"
        )
    if answer["moving"]:
        print(
            f"clock     the trajectory begins at {answer['begins']:.6g} s on the clock of the bodies that move "
            f"({', '.join(answer['moving'])}); --start-time sets when"
        )
    if answer["proof"] is not None:
        print(f"written   {answer['proof']}, for loewner verify")


def _print_unproven(answer: dict[str, Any], comma_unit: str) -> None:
    """Print a row for each piece that is not proven free, and the margins that apply."""
    columns = (
        "piece", f"from{comma_unit}", f"to{comma_unit}", "verdict", "pair of the verdict", "nearest pair",
        f"at{comma_unit}", "nearest, mm",
    )  # fmt: skip
    rows = []
    for piece in answer["unproven"]:
        same = sorted(piece["pair"]) == sorted(piece["nearest_pair"])
        rows.append((
            str(piece["number"]), f"{piece['begins']:.6g}", f"{piece['ends']:.6g}", piece["verdict"],
            " and ".join(piece["pair"]), "the same" if same else " and ".join(piece["nearest_pair"]),
            f"{piece['nearest_time']:.6g}", f"{1e3 * piece['nearest']:z.3f}",
        ))  # fmt: skip
    output.print_table(columns, rows, output.heading(answer))
    for pair, margin in {tuple(piece["pair"]): piece["margin"] for piece in answer["unproven"]}.items():
        if margin:
            print(f"margin    {1e3 * margin:.6g} mm, which {' and '.join(pair)} have to keep")
    if answer["joint_error"]:
        off = f"values up to {answer['joint_error']:g} off"
        print(f"error     the verdicts are for {off}, and the distances for the values of the file")


def _print_nearest(answer: dict[str, Any], unit: str) -> None:
    """Print the least distance of the whole trajectory, with its proven bound."""
    distance, lower = 1e3 * answer["nearest"], answer["nearest_lower"]
    if lower is None:
        bound = "a surface may be deeper at another time"
    else:
        proven = f"at least {1e3 * lower:.3f} mm" if lower >= 0 else f"nowhere deeper than {-1e3 * lower:.3f} mm"
        bound = f"proven {proven}" + ("" if answer["nearest_close"] else ", far from the distance found")
    print(
        f"nearest   {distance:z.3f} mm at {answer['nearest_time']:.6g}{unit}, {' and '.join(answer['nearest_pair'])}; "
        f"{bound}; negative is a depth; margins and errors are not subtracted"
    )


def _print_limits(answer: dict[str, Any], unit: str) -> None:
    """Print the limits that are exceeded, the largest use of each quantity, and the corners."""
    for one in answer["beyond_limits"]:
        kind = "limits" if one["hard"] else "limits for planning"
        (least, most), ends = one["range"], ["none" if end is None else f"{end:.6g}" for end in one["limits"]]
        print(f"limits    {one['value']} is {least:.6g} .. {most:.6g}, outside its {kind} {' .. '.join(ends)}")
    for quantity in limit_use.QUANTITIES[1:]:
        uses = [use for use in answer["limits"] if use["quantity"] == quantity]
        worst = sorted(uses, key=lambda use: -use["ratio"])
        for use in [each for each in worst if each["ratio"] > 1 + limit_use.ROUNDED][:SHOWN] or worst[:1]:
            print(
                f"limits    {quantity} of {use['joint']} reaches {use['value']:.6g} {use['unit']} at "
                f"{use['time']:.6g}{unit}, {use['ratio']:.4g} times its limit of {abs(use['limit']):.6g}"
            )
    for jump in answer["jumps"]:
        times = "once" if jump["often"] == 1 else f"at {jump['often']} times"
        size, time = f"{jump['size']:.6g} {jump['unit']}", f"{jump['time']:.6g}{unit}"
        print(f"corner    {jump['quantity']} jumps {times}, most in {jump['joint']}: by {size} at {time}")
