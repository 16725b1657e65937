"""``loewner swept``: write a body that provably contains links of a robot along a whole trajectory."""

from __future__ import annotations

import argparse
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from loewner.bodies import for_pictures, packed_of
from loewner.cli import inputs, trajectories
from loewner.cli.output import FREE, counted, progress_of
from loewner.errors import FileError, InputError
from loewner.meshes import decomposition as meshes
from loewner.planners.controller_points import START_TOLERANCE
from loewner.robots.swept import united

EXAMPLES = """examples:
  loewner swept panda.urdf moves.csv -o fence.stl
  loewner swept panda.urdf moves.csv --links panda_hand panda_link7 --tolerance 0.005 -o hand.npz
  loewner swept panda.urdf path.csv --scene shelf.yaml --attach can=panda_hand -o fence.stl

Every point of the links is in the body at every real time of the trajectory, as a controller executes it. No point of
the body is farther from what the links sweep than the number that is printed, which is at most the tolerance.

trajectory, controller, attach: see loewner audit --help. Links without --links: all of them, and carried bodies.

An .stl file is in metres and has a closed mesh for each convex piece; the pieces overlap. It is read again and compared
with the body. An .npz file is for further checks (loewner check, loewner clearance, Body.load).

exit status: 0 written, 2 error
"""


def add(commands: Any) -> None:
    """Add the command."""
    swept = inputs.command(commands, "swept", "a body that contains links along a whole trajectory", EXAMPLES, _run)
    inputs.add_robot_options(swept, "attached bodies (.yaml)")
    option, file, length, _ = inputs.adders(swept)
    trajectories.add_input(swept)
    file("-o", "--out", required=True, help="the body (.stl or .npz)")
    option("--links", nargs="+", metavar="NAME", help="links, or bodies that are carried (all)")
    length("--tolerance", default=0.01, help="largest distance by which the body may stick out [m] (%(default)s)")


def _run(options: argparse.Namespace) -> int:
    inputs.expect_suffix(options.out, "--out", (".stl", ".npz"))
    scene, robot, bodies = inputs.scene(options), inputs.robot(options), []
    parts = trajectories.read(options, scene, robot)
    gaps = [
        np.stack([trajectories.end(robot, part, -1), trajectories.end(robot, after, 0)])
        for (part, _), (after, _) in pairwise(parts)
    ]
    if any(np.abs(there - here).max() > START_TOLERANCE for here, there in gaps):
        raise InputError(
            f"{options.trajectory}: expected parts that begin where the part before them ends, found a gap, whose "
            "way the body would not contain; split the file there"
        )
    sweep = partial(
        robot.swept, links=options.links, tolerance=options.tolerance, joint_error=options.joint_error, scene=scene
    )
    for number, part in enumerate(trajectories.carried(parts, scene, robot)):
        with progress_of(f"part {number + 1}" if gaps else options.trajectory.name) as progress:
            bodies.append(sweep(part, progress=progress))
        if number and np.ptp(gaps[number - 1], axis=0).any():
            bodies.append(sweep(gaps[number - 1]))
    body, excess = united(bodies)
    if options.out.suffix.lower() == ".npz":
        body.save(options.out)
    else:
        body.to_stl(options.out)
        vertices, triangles = meshes.load(options.out)
        if not np.array_equal(vertices[triangles], for_pictures(packed_of(body)).corners):
            raise FileError(f"{options.out}: expected the body that was written, found another one when reading it")
    print(f"{options.out}  {counted(len(body.pieces), 'piece')}")
    print(f"contains  the links at every time; sticks out by {1e3 * excess:.3g} mm at most")
    for part, _ in parts:
        controller = trajectories.controller_of(part)
        how = f"{controller} between the points" if controller else "straight between the configurations"
        print(f"curve     {how} of the file")
        for column, value in trajectories.assumed(part).items():
            print(f"assumed   {column} = {value:.9g}: the file has no values of it (--others)")
    return FREE
