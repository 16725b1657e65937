"""``loewner cover``: write shapes that provably contain a robot's links, in the file format of a planner."""

from __future__ import annotations

import argparse
import time
from typing import Any

from loewner._base._files import shown
from loewner.cli import cover_tables, inputs
from loewner.cli.output import print_answer, progress_of
from loewner.errors import InputError
from loewner.robots.cover_files import FORMATS, OF_SPHERES, written_format
from loewner.robots.covers import KINDS, exempt_pairs, new_contacts

EXAMPLES = """examples:
  loewner cover panda.urdf --srdf panda.srdf -o spheres.yml
  loewner cover panda.urdf -o panda_spheres.urdf --for vamp --protrusion 0.02 --picture cover.png
  loewner cover panda.urdf -o spheres.json --for pyroki --number 60
  loewner cover panda.urdf -o capsules.xml --kind capsules --protrusion 0.03

The file is read again, and the shapes that were read are proven to contain each link, inside included.

formats: curobo (.yml: the keys of a configuration for spheres and pairs), vamp and foam (a URDF of spheres, and an SRDF
  of the same stem), pyroki (.json, and ignored pairs in STEM.ignored.json), urdf (.urdf: a capsule becomes a cylinder
  and two spheres), mjcf (.xml), scene (with --for scene). cuRobo, VAMP, foam and pyroki have spheres only.

pairs: shapes that stick out can meet where the links never do. Pairs of links that are proven never to collide are
  written as ignored, like the pairs that the SRDF exempts; all others stay checked.

exit status: 0 all links are proven to be covered, 1 one is not, 2 error, 3 one is undecided
"""


def add(commands: Any) -> None:
    """Add the command."""
    cover = inputs.command(commands, "cover", "shapes that are proven to contain a robot's links", EXAMPLES, _run)
    inputs.add_robot_options(cover, None)
    option, file, _, flag = inputs.adders(cover)
    file("-o", "--out", required=True, help="the file to write")
    option("--for", dest="format", choices=FORMATS, help="the program that reads it (by the suffix)")
    option("--kind", choices=KINDS, default=KINDS[0], help="shapes (%(default)s)")
    how = cover.add_mutually_exclusive_group()
    how.add_argument("--protrusion", type=float, metavar="M", help="how far shapes may stick out of a link [m] (0.02)")
    how.add_argument("--number", type=int, metavar="N", help="the largest number of shapes of the robot")
    file("--picture", help="draw the robot and the shapes (.png or .svg)")
    flag("--json", help="print JSON")


def _run(options: argparse.Namespace) -> int:
    inputs.expect_suffix(options.picture, "--picture", inputs.DRAWN)
    chosen = written_format(options.out, options.format)
    if chosen in OF_SPHERES and options.kind != "spheres":
        raise InputError(f"--kind: expected spheres for {chosen}, which has nothing else, found {options.kind}")
    robot = inputs.robot(options)
    count = len(robot.bodies)
    if not count:
        raise InputError(f"{options.urdf}: expected links with bodies, found none")
    seconds, last = [0.0] * count, time.perf_counter()
    with progress_of("links", count) as progress:

        def report(done: int, total: int) -> None:
            nonlocal last
            now = time.perf_counter()
            seconds[(done - 1) % count] += now - last
            last = now
            progress(done, total)

        covered = robot.cover(options.kind, n=options.number, protrusion=options.protrusion, progress=report)
    covered.save_cover(options.out, options.format)
    written = robot.with_cover(options.out, options.format)
    reports = cover_tables.judged(robot, written)
    ignored = sorted(covered.disabled_pairs - exempt_pairs(robot))
    left = [(pair, share) for pair, share, _ in new_contacts(robot, written) if pair not in covered.disabled_pairs]

    def print_text() -> None:
        cover_tables.print_reports(robot, written, reports, {"seconds": [f"{s:.2f}" for s in seconds]})
        for a, b in ignored:
            print(f"ignored   {a} and {b}, which never collide: proven; their shapes do")
        for (a, b), share in left:
            print(f"checked   {a} and {b}, whose shapes alone meet in {100 * share:.3g} % of random configurations")
        print(f"written   {shown(options.out)}")

    answer = {
        "robot": robot.name,
        "file": str(options.out),
        "links": cover_tables.entries(written, reports),
        "seconds": dict(zip(robot.bodies, seconds, strict=True)),
        "ignored": [list(pair) for pair in ignored],
        "nearer": [[*pair, share] for pair, share in left],
    }
    print_answer(options, answer, print_text)
    cover_tables.draw(robot, written, options.picture)
    return cover_tables.status(reports)
