"""``loewner plan``: find a robot's path from start to goal, and print the verdict on each motion."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import Verdict, planners
from loewner._base import _archives, _validate
from loewner._base._files import read_regular, shown
from loewner._base._validate import Floats
from loewner.cli import configurations, drives, inputs, output
from loewner.errors import ConvergenceError, InputError, PlanningError

# A path, or the trajectory of a plan in time.
Planned = planners.Plan | planners.Trajectory

# Options that request a plan in time.
IN_TIME = ("start_time", "arrive_by", "velocity")

EXAMPLES = """examples:
  loewner plan panda.urdf --srdf panda.srdf --scene shelf.yaml --start ready --goal goals.csv -o path.csv
  loewner plan panda.urdf --srdf panda.srdf --scene shelf.yaml --start ready --goal above --joints panda_arm
  loewner plan panda.urdf --srdf panda.srdf --start ready --goal-pose panda_hand "0.4 0.2 0.5 0 1 0 0"
  loewner plan panda.urdf --srdf panda.srdf --start ready --goal above --proof plan.proof
  loewner plan panda.urdf --srdf panda.srdf --scene belt.yaml --start ready --goal above --arrive-by 4 -o plan.csv
  loewner plan gantry.urdf --scene wall.yaml --start "-0.5 -0.5 1.57" --goal "0.5 -0.5 1.57" --seed 7 --json
  loewner plan cart.urdf --base car --radius 0.8 --map map.yaml 1.0 --start "1 0.5 0" --goal "3 2.5 3.14" -o drive.csv

configurations: the name of a state of the SRDF; a .npy, .csv or .json file, as for loewner robot check; or the
  numbers themselves, in quotes: --start "0 0.5 -0.7". A file may contain several goals, and reaching any one is
  enough. A named goal keeps the start's values for joints that its state does not name; in a named start these are 0.

poses: "x y z qw qx qy qz" in metres, with a unit quaternion; "x y z" for the position alone; or a .npy file with
  T_world_link, shape (4, 4) or (poses, 4, 4).

bodies that follow motions: the plan is in time then, from --start-time on. Each motion has its own time and is proven
  among the moving bodies; velocities are constant on a motion, and within the limits. --out writes the trajectory,
  whose times count from --start-time. --planner, --sampled and --improve-for have no plans in time,
  and --proof, --leave and --reach are refused.

bases: with --base, the plan is a drive of arcs, lines and turns in place, proven free as a whole. A robot without a
  planar base gets one that stays within the map; its configurations begin with x, y and theta. Three numbers are a
  pose of the base, while all other joints keep their values. --out writes where each motion begins, its length and its
  turn; do not join these poses by straight motions.

Every motion of the path is proven free at every one of its configurations. With --sampled, motions are sampled
in steps while the planner searches; the path is certified afterwards, and printed and written in any case.

exit status: 0 every motion proven free, 1 no path: start or goal is not free, or none was found, or one or more of
  its motions collide (--sampled only), or contacts that --leave and --reach allow are deeper than --overlap, 2 error,
  3 none collides, but one or more are ambiguous
"""


def add(commands: Any) -> None:
    """Add the command."""
    plan = inputs.command(commands, "plan", "a path from start to goal with proven motions", EXAMPLES, _run)
    inputs.add_robot_options(plan)
    option, file, number, flag = inputs.adders(plan)
    inputs.add_rule_options(plan, "start", "goal")
    option("--start", required=True, metavar="Q", help='start: a state, a file, or numbers in quotes, "0 0.5 -0.7"')
    ends = plan.add_mutually_exclusive_group(required=True)
    ends.add_argument("--goal", metavar="Q", help="goal: a state, a file, or numbers in quotes")
    pose = "or a pose of a link as the goal: numbers, or a file"
    ends.add_argument("--goal-pose", nargs=2, metavar=("LINK", "POSE"), help=pose)
    joints = "a group of the SRDF, or a joint: these move, all others stay; joints are repeatable (all)"
    option("--joints", metavar="NAME", action="append", help=joints)
    file("-o", "--out", help="write the path (.csv or .json)")
    file("--proof", help="write a proof of the path, for loewner verify")
    option("--seed", type=int, default=0, help="equal seeds give equal paths (0)")
    option("--max-iterations", type=int, metavar="N", help="configurations to draw before giving up (no limit)")
    number("--timeout", default=10.0, metavar="S", help="seconds to search (10)")
    number("--joint-error", default=0.0, metavar="E", help="largest deviation of every value [rad or m] (0)")
    number("--improve-for", default=0.0, metavar="S", help="improve the path until S seconds have passed (0)")
    weights = "with --improve-for: factors of the joint values in the cost of a path, one for each value (1)"
    option("--weights", metavar="W", help=weights)
    number("--clearance", metavar="D", help="with --improve-for: distance to keep from the scene where possible [m]")
    number("--start-time", metavar="T", help="plan in time, from T seconds on (0, if bodies follow motions)")
    number("--arrive-by", metavar="T", help="in time: the latest arrival, on the same clock")
    option("--velocity", metavar="V", help="in time: largest velocities, one number or one for each value (the URDF's)")
    flag("--sampled", help="sample motions in steps instead of proving them")
    resolution = "for --sampled, and for OMPL's planners: the longest step, in the units of the joints (0.05)"
    number("--resolution", metavar="R", help=resolution)
    flag("--no-simplify", help="do not shorten the path")
    option("--planner", metavar="NAME", help="a planner of OMPL, such as BITstar (RRT-Connect, compiled, without OMPL)")
    number("--overlap", default=output.OVERLAP, help=output.OVERLAP_HELP)
    drives.add_options(plan)
    flag("--json", help="print JSON")


def _run(options: argparse.Namespace) -> int:
    _refuse_unused(options)
    drives.refuse_unused(options)
    try:
        return _plan(options) if options.base is None else drives.run(options)
    except PlanningError as error:
        print(f"loewner: no path: {error}", file=sys.stderr)
        return output.NO_PATH


def _plan(options: argparse.Namespace) -> int:
    """Plan a path or a trajectory, print it and write it to a file."""
    scene = inputs.scene(options)
    _begin_in_time(options, scene)
    output.remove_older_proof(options.proof)
    inputs.apply_rules(scene, options)
    robot = inputs.robot(options)
    start = robot.checked_one(configurations.given(options.start, "--start", options, robot, None), "--start")
    goal: Floats | planners.PoseGoal
    if options.goal_pose is None:
        goal = configurations.given(options.goal, "--goal", options, robot, start)
    else:
        goal = _pose_goal(*options.goal_pose)
    checker = inputs.checker(options, robot, scene)
    began = time.perf_counter()
    try:
        planned = _found(checker, start, goal, options)
    except ConvergenceError as error:
        if options.out is not None and isinstance(error.partial, planners.Plan):
            configurations.write(options.out, robot.configuration_names, error.partial.path)
            raise ConvergenceError(f"{options.out} is written, and its motions are free; {error}") from None
        raise
    seconds = time.perf_counter() - began
    if options.out is not None:
        if isinstance(planned, planners.Trajectory):
            planned.save(options.out)
        else:
            configurations.write(options.out, robot.configuration_names, planned.path)
    if options.proof is not None and isinstance(planned, planners.Plan) and planned.proof is not None:
        planned.proof.save(options.proof)
    answer = _answer(checker, planned, seconds, options)
    output.print_answer(options, answer, lambda: _print_answer(answer))
    return output.COLLIDING if answer["verdict"] == "FREE" and answer["deep"] else output.STATUS[answer["verdict"]]


def _pose_goal(link: str, text: str) -> planners.PoseGoal:
    """Read a goal that is given as the pose of a link."""
    if Path(text).suffix.lower() == ".npy":
        data = read_regular(Path(text), "poses", configurations.MOST_BYTES)
        return planners.PoseGoal(link, _archives.numbers(data, text, "an array of numbers"))
    numbers = inputs.row(text, "--goal-pose: expected numbers or a .npy file")
    if len(numbers) not in (3, 7):
        raise InputError(f"--goal-pose: expected x y z qw qx qy qz, or x y z, found {len(numbers)} numbers")
    T = inputs.pose_of(numbers, "--goal-pose")
    return planners.PoseGoal(link, T, tolerance=None if len(numbers) == 7 else [0, 0, 0, np.inf, np.inf, np.inf])


def _refuse_unused(options: argparse.Namespace) -> None:
    """Refuse options that would silently be ignored, and a path that cannot be written, before the work begins."""
    if options.resolution is not None and not options.sampled and options.planner is None:
        raise InputError("--resolution: expected --sampled or --planner with it; without them no motion is sampled")
    if options.joint_error and options.sampled:
        raise InputError("--joint-error: expected no --sampled with it; samples do not cover deviations")
    if options.proof is not None and options.sampled:
        raise InputError("--proof: expected no --sampled with it; sampled motions have no proof")
    if not options.improve_for:
        of_improving = "{}: expected --improve-for with it; without that no path is improved"
        inputs.refuse(options, ("weights", "clearance"), of_improving)
    if options.max_iterations is not None and options.planner is not None:
        raise InputError("--max-iterations: expected no --planner with it; OMPL's planners end by --timeout")
    _validate.positive_scalar(options.overlap, "--overlap", zero=True)
    inputs.expect_suffix(options.out, "--out", configurations.WRITTEN)


def _begin_in_time(options: argparse.Namespace, scene: loewner.Scene) -> None:
    """Give a plan in time its start time, and refuse options that only other plans take."""
    reasons = [f"--{name.replace('_', '-')}" for name in IN_TIME if getattr(options, name) is not None]
    if scene.following:
        reasons.append(f"bodies that follow motions ({', '.join(scene.following)})")
    if not reasons:
        return
    if options.start_time is None:
        options.start_time = 0.0
    listing = " and ".join(reasons)
    if options.proof is not None:
        raise InputError(
            f"--proof: plans in time have no proofs yet, and this is one by {listing}; write the trajectory by --out, "
            "which loewner audit without --proof proves again"
        )
    wanted = f"{{}}: expected a plan that is not in time, found {listing}; "
    inputs.refuse(options, ["improve_for"], wanted + "no trajectory is improved")
    inputs.refuse(options, ["leave", "reach", "overlap"], wanted + "among moving bodies, all contact is a collision")


def _found(
    checker: loewner.CollisionChecker, start: Floats, goal: Floats | planners.PoseGoal, options: argparse.Namespace
) -> Planned:
    """Return the path with its cost and planning time in seconds, or the trajectory of a plan in time."""
    limits = inputs.given(options, ("planner", "max_iterations", "timeout", "resolution"))
    search = planners.Search(certified=not options.sampled, simplify=not options.no_simplify, **limits)
    joints = options.joints[0] if options.joints is not None and len(options.joints) == 1 else options.joints
    arguments: Any = {"joint_error": options.joint_error, "search": search, "seed": options.seed, "joints": joints}
    with output.progress_of("searching"):
        if options.start_time is None:
            weights = options.weights and _numbers("--weights", options.weights)
            improve = planners.Improve(options.improve_for, weights=weights, clearance=options.clearance)
            return planners.plan_full(checker, start, goal, improve, proof=options.proof is not None, **arguments)
        velocity = options.velocity and _numbers("--velocity", options.velocity)
        return planners.plan_in_time(
            checker, start, goal, options.start_time, velocity=velocity, arrive_by=options.arrive_by, **arguments
        )


def _numbers(name: str, text: str) -> list[float] | float:
    """Read the numbers of an option. A single --velocity applies to all joints."""
    numbers = inputs.row(text, f"{name}: expected numbers")
    return numbers[0] if len(numbers) == 1 and name == "--velocity" else numbers


def _answer(
    checker: loewner.CollisionChecker, plan: Planned, seconds: float, options: argparse.Namespace
) -> dict[str, Any]:
    """Make the full report on a path or a trajectory."""
    if isinstance(plan, planners.Trajectory):
        path, times = plan.knots, plan.start_time + plan.times
        t0, t1, own = times[:-1], times[1:], {"times": times.tolist(), "seconds": seconds}
    else:
        path, times, t0, t1 = plan.path, None, None, None
        own = {"cost": plan.cost, "cost_bound": plan.bound, "improvements": plan.iterations, "seconds": plan.seconds}
    proof = plan.proof if isinstance(plan, planners.Plan) else None
    proof_bytes = proof and {"file": len(proof.data), "model": len(proof.model), "proof": proof.size}
    robot, a, b = checker.robot, path[:-1], path[1:]
    started = time.perf_counter()
    edges = checker.certify_edges(a, b, joint_error=options.joint_error, t0=t0, t1=t1)
    proof_seconds = time.perf_counter() - started
    lengths, shares = robot.distances(a, b), np.linspace(0, 1, output.MEASURED)
    at = None if times is None else times[:-1, None] + np.diff(times)[:, None] * shares
    measured = checker.distance(robot.between(a[:, None], b[:, None], shares), at, exact=True)
    free = edges.verdict == Verdict.FREE
    motions = [
        {
            "length": float(lengths[k]),
            "verdict": Verdict(int(edges.verdict[k])).name,
            "fraction": None if free[k] else float(edges.fraction[k]),
            "pair": None if free[k] else edges.names[k].tolist(),
            **near,
            "poses": int(edges.poses[k]),
            "searches": int(edges.searches[k]),
        }
        for k, near in enumerate(output.nearest_pairs(measured))
    ]
    return {
        "robot": robot.name,
        "verdict": min((motion["verdict"] for motion in motions), key=output.WORST_FIRST.index, default="FREE"),
        "overlap": options.overlap,
        "deep": [k for k, motion in enumerate(motions) if free[k] and motion["nearest"] < -options.overlap],
        "sampled": options.sampled,
        "joint_error": options.joint_error,
        "names": list(robot.configuration_names),
        "configurations": path.tolist(),
        "motions": motions,
        "length": float(lengths.sum()),
        "measured": output.MEASURED,
        **output.pairs_of(checker),
        **own,
        "proof_seconds": proof_seconds,
        "out": None if options.out is None else str(options.out),
        "proof": None if proof is None else str(options.proof),
        "proof_bytes": proof_bytes,
    }


def _print_answer(answer: dict[str, Any]) -> None:
    motions = answer["motions"]
    _print_verdict(answer)
    rows = [
        (
            str(k), f"{motion['length']:.4g}", motion["verdict"], f"{1e3 * motion['nearest']:z.3f}",
            *motion["nearest_pair"], f"{motion['poses']:,}", f"{motion['searches']:,}",
        )
        for k, motion in enumerate(motions)
    ]  # fmt: skip
    columns = ("motion", "length", "verdict", "nearest, mm", "body", "other body", "poses", "searches")
    output.print_table(columns, rows, output.heading(answer))
    if motions:
        k = min(range(len(motions)), key=lambda k: motions[k]["nearest"])
        print(
            f"nearest   {1e3 * motions[k]['nearest']:z.3f} mm, on motion {k}: the least of the exact distances at "
            f"{answer['measured']} configurations of each motion; margins are not subtracted"
        )
    for k in answer["deep"]:
        print(output.deep_line(motions[k]["nearest_pair"], motions[k]["nearest"], f"on motion {k}", answer["overlap"]))
    poses, searches = (sum(motion[kind] for motion in motions) for kind in ("poses", "searches"))
    print(f"length    {answer['length']:.6g}, in the units of the joints")
    if "times" in answer:
        begin, end = answer["times"][0], answer["times"][-1]
        print(f"time      {end - begin:.6g} s, from {begin:.15g} s to {end:.15g} s")
    else:
        print(
            f"cost      {answer['cost']:.6g}, weighted length; every path from start to goal costs at least "
            f"{answer['cost_bound']:.6g}; {output.counted(answer['improvements'], 'round')} of improvement"
        )
    seconds = output.lasting(answer["proof_seconds"])
    print(f"proof     {poses:,} poses, {searches:,} searches on pairs of pieces, {seconds}")
    print(f"found in  {output.lasting(answer['seconds'])}, this machine, this run")
    if answer["out"] is not None:
        print(f"written   {shown(answer['out'])}")
    if answer["proof"] is not None:
        size = answer["proof_bytes"]
        written = shown(answer["proof"])
        print(f"written   {written}, {size['file']:,} bytes: model {size['model']:,}, proof {size['proof']:,}")


def _print_verdict(answer: dict[str, Any]) -> None:
    """Print the verdict on the whole path, and the places where the path is not free."""
    motions = answer["motions"]
    count = output.counted(len(motions), "motion")
    if answer["verdict"] == "FREE":
        error = f", with every value up to {answer['joint_error']:g} off" if answer["joint_error"] else ""
        where = "instant" if "times" in answer else "configuration on the way"
        each = "each " if "times" in answer and len(motions) > 1 else ""
        print(f"FREE  {count} from start to goal, {each}proven free at every {where}{error}")
        return
    unproven = [k for k, motion in enumerate(motions) if motion["verdict"] != "FREE"]
    print(f"{answer['verdict']}  {len(unproven)} of {count} from start to goal not proven free")
    for k in unproven:
        motion = motions[k]
        how = "collide" if motion["verdict"] == "COLLIDING" else "come too near to tell"
        print(f"          motion {k}: {' and '.join(motion['pair'])} {how} at the fraction {motion['fraction']:.6g}")
