"""``loewner clearance``: report the distances of all pairs of many bodies."""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import loewner
from loewner._base import _validate
from loewner._base._files import replacing
from loewner._base._validate import Bools, Floats, Ints
from loewner.cli import inputs
from loewner.cli.output import COLLIDING, FREE, counted, is_surface, print_table, progress_bar
from loewner.errors import ConvergenceError, InputError

EXAMPLES = """examples:
  loewner clearance base.npz arm.npz cover.stl
  loewner clearance bodies/*.npz --within 0.005              pairs that are at most 5 mm apart
  loewner clearance bodies/*.npz --csv pairs.csv             all pairs, in a file

Each body is at the position in its file, like the parts of an assembly. Distances are exact, in metres, and negative
where two bodies overlap. For a pair that cannot be settled only the bounds are given, and it counts as colliding.

exit status: 0 all pairs are free, 1 one or more collide (touching is colliding), 2 error
"""

COLUMNS = ("a", "b", "verdict", "distance, m", "lower, m", "upper, m")


class _Found(NamedTuple):
    """The results for the reported pairs. The distance of an unsettled pair is NaN."""

    pairs: Ints
    colliding: Bools
    distance: Floats
    lower: Floats
    upper: Floats


def add(commands: Any) -> None:
    """Add the command."""
    clearance = inputs.command(commands, "clearance", "distances of all pairs of many bodies", EXAMPLES, _run)
    _, file, length, _ = inputs.adders(clearance)
    file("bodies", nargs="+", metavar="BODY", help="saved bodies (.npz) or meshes")
    length("--within", help="omit pairs that are farther apart [m]")
    file("--csv", help="write the pairs to a file instead of a table")
    inputs.add_mesh_options(clearance, "surface")


def _run(options: argparse.Namespace) -> int:
    if len(options.bodies) < 2:
        raise InputError(f"BODY: expected two bodies or more, found {len(options.bodies)}")
    within = None if options.within is None else _validate.positive_scalar(options.within, "--within", zero=True)
    with progress_bar() as progress:
        task = progress.add_task("bodies", total=len(options.bodies))
        bodies, loader = [], inputs.bodies(options.bodies, options)
        for path in options.bodies:
            progress.update(task, description=path.name)
            bodies.append(next(loader))
            progress.update(task, advance=1)
    clearances = _measured(loewner.Bodies(bodies), np.inf if within is None else within)
    _tell([str(path) for path in options.bodies], clearances, options.csv)
    many = len(bodies) * (len(bodies) - 1) // 2
    near = "" if within is None else f", {len(clearances.pairs)} at most {within:g} m apart"
    print(f"{counted(many, 'pair')}{near}, {int(clearances.colliding.sum())} colliding")
    if (clearances.distance < 0).any() and any(map(is_surface, bodies)):
        print("note: depths of surfaces are lower bounds; the way apart may be longer")
    return COLLIDING if clearances.colliding.any() else FREE


def _measured(bodies: loewner.Bodies, within: float) -> _Found:
    """Compute bounds for all pairs, and exact distances of the pairs that may be near."""
    pairs = np.stack(np.triu_indices(len(bodies), 1), axis=1)
    bounds = loewner.distance(bodies, None, bodies, None, pairs=pairs)
    near = np.flatnonzero(bounds.lower <= within)
    pairs, lower, upper = pairs[near], bounds.lower[near], bounds.upper[near]
    try:
        colliding = loewner.collide(bodies, None, bodies, None, pairs=pairs)
    except ConvergenceError as error:
        colliding = error.partial  # True for unsettled pairs
    try:
        distance = loewner.distance(bodies, None, bodies, None, pairs=pairs, exact=True).distance
    except ConvergenceError as error:
        distance = error.partial.distance  # NaN for unsettled pairs
    left = ~(distance > within) | colliding
    return _Found(pairs[left], colliding[left], distance[left], lower[left], upper[left])


def _tell(names: list[str], found: _Found, path: Path | None) -> None:
    """Write the pairs to a file, or print them."""
    if path is None:
        print_table(COLUMNS, _rows(names, found, "{:z.6g}"), "loewner clearance")
        return
    with (
        replacing(path) as temporary,
        temporary.open("w", encoding="utf-8", errors="surrogateescape", newline="") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(_rows(names, found, "{!r}"))


def _rows(names: list[str], found: _Found, shown: str) -> list[list[str]]:
    """Format the rows of the table, one for each pair."""
    columns = (array.tolist() for array in found)
    return [
        [
            names[a], names[b], "COLLIDING" if hit else "FREE",
            *("" if np.isnan(value) else shown.format(value) for value in values),
        ]
        for (a, b), hit, *values in zip(*columns, strict=True)
    ]  # fmt: skip
