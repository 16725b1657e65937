"""``loewner audit``: find the collisions of a trajectory from any program, with times and depths."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import Verdict, _validate, planners, plots
from loewner._matrices import in_frame, product
from loewner._nodes import some
from loewner._validate import Floats
from loewner.cli import configurations, inputs
from loewner.cli.output import AMBIGUOUS, COLLIDING, FREE, new_table, print_table, remove_older_proof
from loewner.errors import FileError, InputError, LoewnerError
from loewner.planners.controller_points import executed
from loewner.planners.controllers import TIMES
from loewner.robots import curves

# Width of the picture along time, in characters.
COLUMNS = 60
MARKS = {Verdict.FREE: ".", Verdict.AMBIGUOUS: "?", Verdict.COLLIDING: "#"}

# Distances within which a piece's pair is sought, one after the other [m].
WITHIN = np.geomspace(1e-3, 1e9, 13)

# How far outside its limits a value is reported: above the rounding of decimals in files.
ROUNDED = 1e-9

DRAWN = (".png", ".svg")
CONTROLLERS = ("linear", "cubic", "quintic")
WORST_FIRST = ("COLLIDING", "AMBIGUOUS", "FREE")

EXAMPLES = """examples:
  loewner audit panda.urdf moves.csv --srdf panda.srdf --scene shelf.yaml
  loewner audit panda.urdf moves.yaml --scene shelf.yaml --controller linear --joint-error 1e-3 -o moves.svg
  loewner audit panda.urdf path.csv --srdf panda.srdf --scene shelf.yaml       a path of loewner plan -o path.csv
  loewner audit panda.urdf solution.yaml --scene shelf.yaml --attach 2:can=panda_hand --attach 3:can=panda_hand

trajectory: a .json or .yaml file with a trajectory_msgs/JointTrajectory, by itself or within a message of MoveIt or of
  an action; or a .csv file with the columns time, the joints' names and optionally "NAME velocity" and "NAME
  acceleration" for each joint; or a path without times that loewner plan has written (.csv or .json), whose straight
  motions are checked. A message with several trajectories is proven part by part, in order, each in its own state.
  Bodies that follow motions move at the file's own times; messages count from their start, so give --start-time.
  Parts of a message follow each other without a pause.

attach: in the parts that are named, or in all, the body of the scene is carried by the link. It is taken from where it
  stands when the part begins, and stays where it is put down. Bodies that the message attaches have to be attached by
  this option or in the scene file.

controller: between two points a joint trajectory controller follows a straight line if there are only positions, a
  cubic polynomial if there are velocities as well, and a quintic one if there are accelerations too. The proof covers
  this curve at every real time.

limits: values outside the limits of the robot, or of its file, at the sampled times are listed; neither they nor
  velocities change the verdict.

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
        "--others",
        metavar="Q",
        help="values of joints that the file does not name: a state, a file, or numbers (those of the message's start "
        "state, or 0)",
    )
    audit.add_argument(
        "--attach",
        action="append",
        default=[],
        metavar="[PART:]BODY=LINK",
        help="let a link carry a body of the scene, in all parts of a message or in one (may be repeated)",
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
    parts = _read(options.trajectory, robot, others)
    carrying = _carrying(options.attach, scene, robot, len(parts))
    for number, given in enumerate(parts):
        if isinstance(given, planners.ControllerPoints):
            parts[number] = _executed(given, options.controller)
        elif options.start_time is not None:
            raise InputError(f"--start-time {options.start_time:g}: expected points with times, found a path without")
        elif options.controller not in (None, "linear"):
            raise InputError(f"--controller {options.controller}: expected points with times, found a path without")
    for given, held in zip(parts, carrying, strict=True):
        _expect_carried(scene, given, held)
    _set_clock(parts, options.start_time)
    answers = []
    for number, given in enumerate(parts):
        _carry(scene, robot, given, carrying[number])
        proof, picture = (_numbered(file, number, len(parts)) for file in (options.proof, options.out))
        remove_older_proof(proof)
        answers.append(_answer(checker, given, options, proof))
        if picture is not None:
            plots.save(plots.trajectory(checker, given, joint_error=options.joint_error), picture)
        _put_down(scene, robot, given, carrying[number])
        if not options.json:
            if len(parts) > 1:
                print(f"{chr(10) * bool(number)}part      {number + 1} of {len(parts)}, {answers[-1]['place']}")
            _print_answer(answers[-1])
            if proof is not None and answers[-1]["proof"] is None:
                print(f"no proof  {proof} is not written: there is no proof of this motion")
    worst = min((answer["verdict"] for answer in answers), key=WORST_FIRST.index)
    if options.json:
        print(json.dumps(answers[0] if len(answers) == 1 else {"verdict": worst, "parts": answers}, indent=2))
    elif len(answers) > 1:
        free = sum(answer["verdict"] == "FREE" for answer in answers)
        print(f"\n{worst}  {free} of {len(answers)} parts proven free")
    return {"FREE": FREE, "COLLIDING": COLLIDING, "AMBIGUOUS": AMBIGUOUS}[worst]


def _read(path: Path, robot: loewner.Robot, others: Floats | None) -> list[planners.ControllerPoints | Floats]:
    """Read points with times, or a path without times, as `loewner plan` writes it, of shape (two or more, dof)."""
    try:
        return list(planners.ControllerPoints.load_all(path, robot=robot, others=others))
    except LoewnerError:
        if not configurations.is_path(path, TIMES):
            raise
    return [configurations.path_of(path, robot)]


def _carrying(given: list[str], scene: loewner.Scene, robot: loewner.Robot, count: int) -> list[dict[str, str]]:
    """Return, for each part, the links by the bodies that they carry, from --attach."""
    found: list[dict[str, str]] = [{} for _ in range(count)]
    for text in given:
        where, _, what = text.rpartition(":")
        body, equals, link = what.partition("=")
        whole = where.isascii() and where.isdigit() and 1 <= int(where) <= count
        if not (equals and body and link) or (where and not whole):
            parts = f", with a PART from 1 to {count}" if where else ""
            raise InputError(f"--attach {text}: expected [PART:]BODY=LINK{parts}")
        if body not in scene:
            raise _validate.unknown_name(f"--attach {text}: body", body, scene.names)
        if link not in robot.link_names:
            raise _validate.unknown_name(f"--attach {text}: link", link, robot.link_names)
        for part in found if not where else [found[int(where) - 1]]:
            if part.setdefault(body, link) != link:
                raise InputError(f"--attach {text}: expected one link for {body}, found {part[body]} as well")
    return found


def _expect_carried(scene: loewner.Scene, given: planners.ControllerPoints | Floats, carrying: dict[str, str]) -> None:
    """Refuse a part on which the robot carries bodies that neither the scene nor --attach lets it carry."""
    if isinstance(given, planners.ControllerPoints):
        held = {body: each.link for body, each in scene.attachments.items()} | carrying
        curves.expect_carried(held, [*given.carried.items(), *((body, "") for body in given.origin.free)])


def _set_clock(parts: list[planners.ControllerPoints | Floats], start_time: float | None) -> None:
    """Let the parts begin one after the other, the first at `start_time`."""
    end = None if start_time is None else _validate.real(start_time, "--start-time")
    for given in parts:
        if isinstance(given, planners.ControllerPoints):
            given.start_time = given.start_time if end is None else end
            end = given.start_time + float(given.times[-1])


def _carry(
    scene: loewner.Scene, robot: loewner.Robot, part: planners.ControllerPoints | Floats, carrying: dict[str, str]
) -> None:
    """Let links carry bodies from the beginning of a part, each from its present pose."""
    if not carrying:
        return
    touching = part.origin.touching if isinstance(part, planners.ControllerPoints) else {}
    links = robot.forward_kinematics(_end(robot, part, 0))
    for body, link in carrying.items():
        if body in scene.attachments or body in scene.following:
            raise InputError(f"--attach {body}={link}: expected a body that stands in the scene, found one that moves")
        T_link_body = in_frame(links[robot.link_names.index(link)], scene.pose(body))
        scene.attach(body, link, T_link_body, touch_links=touching.get(body, ()))


def _put_down(
    scene: loewner.Scene, robot: loewner.Robot, part: planners.ControllerPoints | Floats, carrying: dict[str, str]
) -> None:
    """Leave bodies where a part ends."""
    if not carrying:
        return
    links = robot.forward_kinematics(_end(robot, part, -1))
    for body, link in carrying.items():
        T_link_body = scene.attachments[body].T_link_body
        scene.detach(body, product(links[robot.link_names.index(link)], T_link_body))


def _end(robot: loewner.Robot, part: planners.ControllerPoints | Floats, row: int) -> Floats:
    """Return a configuration of a part, with the robot's columns."""
    if not isinstance(part, planners.ControllerPoints) or part.names is None:
        rows = part if isinstance(part, np.ndarray) else part.positions
        return np.asarray(rows[row])
    return robot.configuration(dict(zip(part.names, part.positions[row], strict=True)))


def _numbered(file: Path | None, number: int, count: int) -> Path | None:
    """Return the file of one part, which has the part's number in its name if there are several."""
    return file if file is None or count == 1 else file.with_stem(f"{file.stem}-{number + 1}")


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
    return executed(points, used)


def _answer(
    checker: loewner.CollisionChecker,
    given: planners.ControllerPoints | Floats,
    options: argparse.Namespace,
    written: Path | None,
) -> dict[str, Any]:
    """Return the verdicts and distances of a trajectory or path and of its pieces, for printing."""
    prove = written is not None
    curve, found = curves.proven(checker, given, options.joint_error, str(options.trajectory), prove)
    if found.proof is not None:
        found.proof.save(written)
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
        "proof": str(written) if found.proof is not None else None,
        "moving": list(checker.scene.following),
        "beyond_limits": _beyond_limits(checker.robot, Q),
        **_told_by_a_message(given),
    }


def _told_by_a_message(given: planners.ControllerPoints | Floats) -> dict[str, Any]:
    """Return the other contents of a message, and the time of its first point."""
    if not isinstance(given, planners.ControllerPoints):
        return {}
    origin = given.origin
    sources = {column: origin.sources[column] for column in origin.stated}
    stated = {"stated": origin.stated, "stated_in": sources} if origin.stated else {}
    carried = {"carried": given.carried} if given.carried else {}
    assumed = {"assumed": list(origin.assumed)} if origin.assumed else {}
    return {"place": origin.place, "first_point_due": float(given.times[0]), **stated, **assumed, **carried}


def _beyond_limits(robot: loewner.Robot, Q: Floats) -> list[dict[str, Any]]:
    """Return the values that are outside the limits of the robot, or of its file, at some of the sampled times."""
    least, most = Q.min(axis=0), Q.max(axis=0)
    hard = (least < robot.hard_lower - ROUNDED) | (most > robot.hard_upper + ROUNDED)
    outside = hard | (least < robot.lower - ROUNDED) | (most > robot.upper + ROUNDED)
    lower, upper = np.where(hard, robot.hard_lower, robot.lower), np.where(hard, robot.hard_upper, robot.upper)
    return [
        {
            "value": robot.configuration_names[k],
            "range": [float(least[k]), float(most[k])],
            "limits": [float(end) if np.isfinite(end) else None for end in (lower[k], upper[k])],  # for JSON
            "hard": bool(hard[k]),
        }
        for k in np.flatnonzero(outside).tolist()
    ]


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
    for column, value in answer.get("stated", {}).items():
        print(f"state     {column} = {value:.9g}, from {answer['stated_in'][column]}; the points do not name it")
    if answer.get("assumed"):
        print(
            f"assumed   {some(answer['assumed'])}: the file has no values of these, which keep the robot's defaults, "
            "mostly 0 (--others)"
        )
    for one in answer["beyond_limits"]:
        kind = "limits" if one["hard"] else "limits for planning"
        (least, most), ends = one["range"], ["none" if end is None else f"{end:.6g}" for end in one["limits"]]
        print(f"limits    {one['value']} is {least:.6g} .. {most:.6g}, outside its {kind} {' .. '.join(ends)}")
    if answer.get("first_point_due", 0.0) > 0:
        print(
            f"before    the first point is due at {answer['first_point_due']:.6g} s; the way there from where the "
            "robot stands is not in the file and not checked"
        )
    if answer["moving"]:
        print(
            f"clock     the trajectory begins at {answer['begins']:.6g} s on the clock of the bodies that move "
            f"({', '.join(answer['moving'])}); --start-time sets when"
        )
    if answer["proof"] is not None:
        print(f"written   {answer['proof']}, for loewner verify")
