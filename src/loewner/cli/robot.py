"""``loewner robot``: describe a robot, and check whether its configurations are free."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import asdict
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner._base import _validate
from loewner._base._validate import Floats
from loewner.cli import configurations, inputs, output
from loewner.cli.pair_tables import print_pairs
from loewner.errors import InputError

# Configurations for each step of the progress bar, and the largest number of pairs that a table lists.
AT_ONCE = 50_000
LISTED = 20

# Verdicts, and the tests that settle them, by their names in `Settled`.
VERDICTS = ("free", "colliding")
TIERS = {
    "bounds": "bounding spheres and boxes",
    "ellipsoids": "ellipsoids",
    "planes": "planes about the pieces",
    "search": "exact search",
}

# Number of boxes of configurations that are examined for the exempt pairs, which takes several seconds. If links are
# solids, a box takes twenty times as long, and fewer boxes are examined.
BOXES, BOXES_OF_SOLIDS = 200_000, 10_000

# Number of random configurations. A pair that collides in all of them is reported.
TRIED = 64

# Shortest time from which rates are computed [s], because the first large batch takes about 10 ms longer to start.
LEAST_TIMED = 0.1

EXAMPLES = """examples:
  loewner robot info panda.urdf --srdf panda.srdf
  loewner robot check panda.urdf --srdf panda.srdf --scene shelf.yaml --random 10000
"""
INFO_EXAMPLES = """examples:
  loewner robot info panda.urdf
  loewner robot info ~/robots/panda.urdf --srdf panda.srdf --package-dir ~/robots --package-dir ~/meshes
"""
MARGIN_HELP = (
    "least distance [m] for each pair with a body of the scene; larger margins of the scene are kept; pairs of links "
    "have no margin unless the scene gives one"
)
CHECK_EXAMPLES = """examples:
  loewner robot check panda.urdf --srdf panda.srdf --state ready
  loewner robot check panda.urdf --srdf panda.srdf --scene shelf.yaml --random 100000 --seed 7
  loewner robot check panda.urdf --scene shelf.yaml --configs path.csv --margin 0.02 --json

configurations: a .npy file of shape (N, dof); a .csv file with one line each, whose first line may name the
  columns; or a .json file with a list of them, or with a path of loewner plan

exit status: 0 all free, 1 one or more colliding, 2 error
"""


def add(commands: Any) -> None:
    """Add the commands."""
    robot = inputs.command(commands, "robot", "a robot: its description, and whether it is free", EXAMPLES)
    inner = robot.add_subparsers(required=True, metavar="COMMAND")
    info = inputs.command(inner, "info", "links, joints and pairs of a robot", INFO_EXAMPLES, _info)
    inputs.add_robot_options(info, None)
    check = inputs.command(inner, "check", "which configurations are in collision", CHECK_EXAMPLES, _check)
    inputs.add_robot_options(check)
    which = check.add_mutually_exclusive_group(required=True)
    which.add_argument("--random", type=int, metavar="N", help="N random configurations within the limits")
    which.add_argument("--configs", type=Path, metavar="FILE", help="configurations (.npy, .csv or .json)")
    which.add_argument("--state", metavar="NAME", help="a state of the SRDF")
    check.add_argument("--seed", type=int, help="seed of --random (0)")
    check.add_argument("--margin", type=float, metavar="M", help=MARGIN_HELP)
    check.add_argument("--json", action="store_true", help="print JSON")


def _info(options: argparse.Namespace) -> int:
    robot = inputs.robot(options)
    shapes = {name: _link_row(body, robot.shapes[name]) for name, body in robot.bodies.items()}
    limits, heads = [robot.lower, robot.upper], ["lower", "upper"]
    if (robot.lower != robot.hard_lower).any() or (robot.upper != robot.hard_upper).any():
        limits, heads = [*limits, robot.hard_lower, robot.hard_upper], [*heads, "hard lower", "hard upper"]
    output.print_table(
        ("link", "pieces", "vertices", "gap", "shapes"),
        ((name, *shapes.get(name, ("-",) * 4)) for name in robot.link_names),
        f"{robot.name}: {output.counted(len(robot.link_names), 'link')}",
    )
    columns = zip(robot.configuration_names, *limits, strict=True)
    rows = [(name, *(f"{end:.6g}" for end in ends)) for name, *ends in columns]
    output.print_table(("column", *heads), rows, f"{output.counted(len(robot.joint_names), 'joint')}, dof {robot.dof}")
    count = len(robot.bodies)
    checker = loewner.CollisionChecker(robot) if count else None
    checked = checker.checked_pairs if checker is not None else ()
    print(f"pairs     {count * (count - 1) // 2} of links with bodies, {len(checked)} checked")
    disabled = f"{len(robot.disabled_pairs)} disabled by the SRDF" if options.srdf is not None else "no SRDF"
    print(f"          {disabled}, {len(robot.adjacent_pairs)} adjacent")
    exempt = robot.disabled_pairs or robot.adjacent_pairs
    if count and exempt:
        print("exempt pairs, over the whole ranges of the joints between them:")
        body_pairs = [pair for pair in exempt if all(link in robot.bodies for link in pair)]
        solid = any(output.is_surface(robot.bodies[link]) for pair in body_pairs for link in pair)
        print_pairs(robot.prove_pairs(body_pairs, boxes=BOXES_OF_SOLIDS if solid else BOXES), robot)
    if checker is not None and checked:
        always = np.all(checker.collide_by_pair(robot.random_configurations(TRIED)), axis=0)
        for a, b in compress(checked, always.tolist()):
            print(
                f"note: {a} and {b} collide in each of {TRIED} random configurations; if their shapes above are larger "
                "than the links: --model auto"
            )
    if options.srdf is not None:
        print(f"groups    {', '.join(f'{name} ({len(joints)})' for name, joints in robot.groups.items()) or '-'}")
        print(f"states    {', '.join(robot.states) or '-'}")
    return 0


def _link_row(body: loewner.Body, shapes: tuple[str, ...]) -> tuple[str, ...]:
    vertices = sum(len(p.vertices) for p in body.pieces if p.vertices is not None)
    return str(len(body.pieces)), str(vertices), f"{body.gaps.max():.1e}", "; ".join(shapes)


def _check(options: argparse.Namespace) -> int:
    if options.margin is not None and options.scene is None:
        raise InputError("--margin: expected --scene with it, found none: it is kept from the bodies of the scene")
    if options.seed is not None and options.random is None:
        raise InputError("--seed: expected --random with it, found none: only random configurations have a seed")
    if options.state is not None and options.srdf is None:
        wanted = "expected --srdf with it, which has the states"
        raise InputError(f"--state: {wanted}; no SRDF was given for {options.state!r}")
    scene = inputs.scene(options)
    if options.margin is not None:
        scene.widen(_validate.positive_scalar(options.margin, "--margin", zero=True))
    robot = inputs.robot(options)
    Q = _configurations(robot, options)
    answer = _checked_configurations(inputs.checker(options, robot, scene), Q)
    output.print_answer(options, answer, lambda: _print_checked(answer))
    return output.COLLIDING if answer["colliding"] else output.FREE


def _configurations(robot: loewner.Robot, options: argparse.Namespace) -> Floats:
    """Return the requested configurations, shape (N, dof)."""
    if options.state is not None:
        return robot.configuration(options.state)[None]
    if options.configs is not None:
        Q = np.atleast_2d(robot.checked(configurations.read(options.configs, robot), str(options.configs)))
        if len(Q) == 0:
            raise InputError(f"{options.configs}: expected one configuration or more, found none")
        return _validate.finite_array(Q, str(options.configs), (None, robot.dof))
    count = _validate.whole_number(options.random, "--random", 1)
    return robot.random_configurations(count, _validate.whole_number(options.seed or 0, "--seed", 0))


def _checked_configurations(checker: loewner.CollisionChecker, Q: Floats) -> dict[str, Any]:
    """Make the full report on configurations."""
    robot = checker.robot
    checker.tiers(Q[:1])  # compiles the kernels if they are not compiled yet
    tiers: Counter[str] = Counter()
    hits = np.zeros(len(checker.checked_pairs), dtype=np.int64)
    colliding, seconds = [], 0.0
    with output.progress_of("configurations", len(Q)) as progress:
        for first in range(0, len(Q), AT_ONCE):
            part = Q[first : first + AT_ONCE]
            started = time.perf_counter()
            collides, settled = checker.settle(part)
            seconds += time.perf_counter() - started
            rows = np.flatnonzero(collides)
            tiers.update(asdict(settled))
            hits += checker.collide_by_pair(part[rows]).sum(axis=0)
            colliding += (rows + first).tolist()
            progress(first + len(part), len(Q))
    outside = (robot.hard_lower > Q) | (robot.hard_upper < Q)
    often = np.argsort(-hits, kind="stable")
    return {
        "robot": robot.name,
        "configurations": len(Q),
        "free": len(Q) - len(colliding),
        "colliding": len(colliding),
        "colliding_rows": colliding,
        "tiers": dict(tiers),
        **output.pairs_of(checker),
        "margin": inputs.largest_margin(checker.scene),
        "pairs": [[*checker.checked_pairs[p], int(hits[p])] for p in often if hits[p]],
        "outside_limits": np.flatnonzero(outside.any(axis=1)).tolist(),
        "outside_limits_of": [robot.configuration_names[k] for k in np.flatnonzero(outside.any(axis=0))],
        "per_second": len(Q) / seconds if seconds >= LEAST_TIMED else None,
    }


def _print_checked(answer: dict[str, Any]) -> None:
    count, colliding = answer["configurations"], answer["colliding"]
    near = f", or closer than a margin of up to {answer['margin']:g} m" if answer["margin"] else ""
    of_all = f"{colliding:,} of {output.counted(count, 'configuration')}"
    print(f"{'COLLIDING' if colliding else 'FREE'}  {of_all} in collision{near}")
    settled = [(text, [answer["tiers"].get(f"{kind}_by_{name}") for kind in VERDICTS]) for name, text in TIERS.items()]
    rows = [(text, *("-" if cell is None else f"{cell:,}" for cell in cells)) for text, cells in settled]
    output.print_table(("settled by", *VERDICTS), rows, output.heading(answer))
    if pairs := answer["pairs"]:
        often = [(a, b, f"{hits:,}", f"{100 * hits / count:.1f} %") for a, b, hits in pairs[:LISTED]]
        more = [(f"and {len(pairs) - LISTED} more",)] if len(pairs) > LISTED else []
        output.print_table(("body", "other body", "collides", "of all"), [*often, *more])
    if answer["outside_limits"]:
        rows, names = answer["outside_limits"], ", ".join(answer["outside_limits_of"])
        outside = output.counted(len(rows), "configuration")
        print(f"note: {outside} outside the limits, the first in row {rows[0] + 1}: {names}")
    if answer["per_second"] is not None:
        print(f"{answer['per_second']:,.0f} configurations a second, this machine, this run")
