"""``loewner judge --answers``: list the answers of another program that are proven wrong."""

from __future__ import annotations

import argparse
import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import judging
from loewner._base import _json, _tables
from loewner._base._files import read_regular, replacing, shown
from loewner._base._rotations import from_quaternion
from loewner._base._validate import Floats, short
from loewner.cli import inputs
from loewner.cli.output import COLLIDING, FREE, counted, print_answer, print_table
from loewner.errors import FileError, InputError, LoewnerError
from loewner.judging import PARTS, Finding, Judgement
from loewner.reproductions import reproduction

# The largest table that is read [bytes].
MOST_BYTES = 2**30

# Columns of a table: names of bodies, poses, and parts of answers with their counts of numbers.
NAMES, POSES = ("body_a", "body_b"), ("pose_a", "pose_b")
ANSWERS = {"colliding": 1, "distance": 1, "depth": 1, "witness_a": 3, "witness_b": 3, "normal": 3}
COLUMNS = (*NAMES, *POSES, *ANSWERS)
WORDS = {"true": 1.0, "false": 0.0, "yes": 1.0, "no": 0.0}

# Names of the two bodies of each row.
Pairs = Sequence[tuple[str, str]]

# Error that is allowed by default, in metres.
TOLERANCE = 1e-6

# Largest number of wrong answers that are printed.
SHOWN = 10

TABLE = """--answers: a .csv file with a header, or a .json file with a list of objects.
  body_a, body_b         names of the files without their endings; not needed for two bodies, A and B
  pose_a, pose_b         "x y z", "x y z qw qx qy qz", or the 16 numbers of a matrix, row by row; default: the origin
  colliding              true or false, 1 or 0
  distance, depth        in metres; a negative distance is a depth
  witness_a, witness_b   "x y z" in the world
  normal                 "x y z", from A to B
  At least one of the last six; an empty cell, null or NaN is no answer. In a .csv file, commas separate columns, and
  spaces the numbers in a cell. If a convention explains (nearly) all errors, such as reversed normals, millimetres or
  qx qy qz qw, a hint says so; the findings stay.
"""


def add_options(judge: Any) -> None:
    """Add the options that apply only to tables of answers."""
    judge.add_argument("--scale", type=float, help="factor for all lengths of meshes (1)")
    judge.add_argument("--program", type=Path, metavar="FILE", help="write the worst answer about hulls as a program")
    judge.add_argument("--row", type=int, metavar="N", help="with --program: the answer of this row instead")


def run(options: argparse.Namespace) -> int:
    """Judge a table of answers, and print the wrong ones."""
    tolerance = TOLERANCE if options.tolerance is None else options.tolerance
    if options.row is not None and not options.program:
        raise InputError("--row: expected it with --program, found it alone")
    bodies = _bodies(options)
    rows, poses, answers = table(options.answers)
    named = [_pair(row, bodies, f"{options.answers}, row {k}") for k, row in enumerate(rows, 1)]
    said = _judged(named, bodies, poses, answers, tolerance)
    reordered = _reordered(said, rows, poses)
    if reordered is not None:
        other = _judged(named, bodies, reordered, answers, tolerance)
        explained, spoilt = (said.wrong & ~other.wrong).sum(), (other.wrong & ~said.wrong).sum()
        counts = int(said.wrong.sum()), int(explained), int(spoilt)
        tried = judging.Convention("rows", "are right with quaternions in the order qx qy qz qw", *counts)
        said = replace(said, conventions=(*said.conventions, tried))
    written = _program(options, said, named, bodies, poses, answers, tolerance) if options.program else None
    print_answer(options, _for_json(said, named, bodies), lambda: _print(said, named, bodies, written))
    return COLLIDING if said.wrong.any() else FREE


def _judged(named: Pairs, bodies: Any, poses: Any, answers: Any, tolerance: float) -> Judgement:
    """Judge all rows. Rows about the same two bodies are judged together."""
    places: dict[tuple[str, str], list[int]] = {}
    for k, pair in enumerate(named):
        places.setdefault(pair, []).append(k)
    parts = []
    for (a, b), chosen in places.items():
        Ta, Tb = (T[chosen] for T in poses)
        own = {name: x[chosen] for name, x in answers.items()}
        parts.append(judging.judge_answers(bodies[a], Ta, bodies[b], Tb, **own, tolerance=tolerance))
    order = np.argsort(np.concatenate(list(places.values())))
    fields = ("kinds", "excess", "lower", "upper")
    kinds, excess, lower, upper = (np.concatenate([getattr(part, name) for part in parts])[order] for name in fields)
    return Judgement(
        kinds, excess, lower, upper, conventions=tuple(tried for part in parts for tried in part.conventions)
    )


def _reordered(said: Judgement, rows: Sequence[dict[str, Any]], poses: Sequence[Floats]) -> list[Floats] | None:
    """Return the poses with quaternions read as qx qy qz qw; None if few rows are wrong, or no row has a quaternion."""
    if said.wrong.sum() < max(1, judging.TRIED * len(rows)):
        return None
    other, some = [T.copy() for T in poses], False
    for T, name in zip(other, POSES, strict=True):
        for k, row in enumerate(rows):
            numbers = _numbers(row.get(name), name)
            if len(numbers) == 7:
                T[k, :3, :3], some = from_quaternion([numbers[6], *numbers[3:6]], name), True
    return other if some else None


def _bodies(options: argparse.Namespace) -> dict[str, loewner.Body]:
    """Load the bodies, and return them keyed by the names of their files without endings."""
    if not options.files:
        raise InputError("FILE: expected one or more bodies with --answers, found none")
    names = [path.stem for path in options.files]
    for name in names:
        if names.count(name) > 1 and len(names) > 2:
            raise InputError(f"expected files with different names, found two of {name}")
    if all(path.suffix.lower() == ".npz" for path in options.files):
        inputs.refuse(options, ("scale", "meshes"), "{}: expected meshes to make bodies of, found saved bodies only")
    scale = 1.0 if options.scale is None else options.scale
    usual = dict.fromkeys((*inputs.OF_PIECES, *inputs.OF_SURFACES))
    taken = argparse.Namespace(model=options.meshes or "surface", hull=False, scale=scale, **usual)
    bodies = [
        loewner.Body.load(path) if path.suffix.lower() == ".npz" else inputs.from_mesh(path, taken)
        for path in options.files
    ]
    if len(bodies) == 2:
        return {"A": bodies[0], "B": bodies[1], **dict(zip(names, bodies, strict=True))}
    return dict(zip(names, bodies, strict=True))


def table(path: Path) -> tuple[list[dict[str, Any]], list[Floats], dict[str, Floats]]:
    """Read a table: its rows, the two poses of each row, and the answers."""
    rows = _rows(path)
    poses = [np.array([_pose(row, name, f"{path}, row {k}") for k, row in enumerate(rows, 1)]) for name in POSES]
    return rows, poses, _answers(rows, path)


def _rows(path: Path) -> list[dict[str, Any]]:
    """Read the rows of a table, which may have only known columns."""
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".json"):
        raise FileError(f"{path}: expected a .csv or .json file, found {path.suffix or 'no suffix'}")
    try:
        text = read_regular(path, "answers", MOST_BYTES).decode("utf-8-sig")
        rows = _of_csv(text, path) if suffix == ".csv" else _of_json(text, path)
    except (ValueError, RecursionError) as error:
        if isinstance(error, LoewnerError):
            raise
        raise FileError(f"{path}: expected a table of answers, found something else ({str(error)[:200]})") from None
    for row in rows:
        unknown = [name for name in row if name not in COLUMNS]
        if unknown:
            raise FileError(f"{path}: expected columns from {', '.join(COLUMNS)}; found {short(unknown[0])}")
    if not rows:
        raise FileError(f"{path}: expected answers, found none")
    return rows


def _of_csv(text: str, path: Path) -> list[dict[str, Any]]:
    try:
        header, *lines = [line for line in csv.reader(io.StringIO(text), strict=True) if line] or [[]]
    except csv.Error as error:
        raise FileError(f"{path}: expected a table with commas, found something else ({error})") from None
    names = [name.strip() for name in header]
    if len(set(names)) < len(names):
        raise FileError(f"{path}: expected each column once, found {', '.join(names)}")
    for number, line in enumerate(lines, 1):
        if len(line) != len(names):
            raise FileError(f"{path}, row {number}: expected {len(names)} cells as in the header, found {len(line)}")
    return [dict(zip(names, map(str.strip, line), strict=True)) for line in lines]


def _of_json(text: str, path: Path) -> list[dict[str, Any]]:
    rows = _json.parsed(text, str(path))
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise FileError(f"{path}: expected a list of objects, one for each pair, found {short(rows)}")
    return rows


def _pair(row: dict[str, Any], bodies: dict[str, loewner.Body], where: str) -> tuple[str, str]:
    """Return the names of both bodies of a row."""
    names = []
    for column, usual in zip(NAMES, "AB", strict=True):
        name = row.get(column, usual if usual in bodies else None)
        if name is None:
            raise InputError(f"{where}: expected {column}, or two files of bodies, found neither")
        if name not in bodies:
            raise InputError(f"{where}: {column}: expected one of {', '.join(bodies)}, found {short(name)}")
        names.append(str(name))
    return names[0], names[1]


def _numbers(value: Any, where: str) -> list[float]:
    """Return the numbers in a cell. An empty cell has no numbers."""
    if isinstance(value, str):
        words = value.split()
        try:
            return [WORDS[word.lower()] if word.lower() in WORDS else _tables.number(word) for word in words]
        except ValueError as error:
            raise FileError(f"{where}: {error}") from None
    cells = value if isinstance(value, list) else [] if value is None else [value]
    flat = [x for cell in cells for x in (cell if isinstance(cell, list) else [cell])]
    if any(not isinstance(x, (int, float)) for x in flat):
        raise FileError(f"{where}: expected numbers, found {short(value)}")
    try:
        return [float(x) for x in flat]
    except OverflowError:
        raise FileError(f"{where}: expected numbers in the range of floats, found {short(value)}") from None


def _pose(row: dict[str, Any], column: str, where: str) -> Floats:
    """Return a pose of a row: a translation, a translation with a quaternion, or a matrix."""
    numbers = _numbers(row.get(column), f"{where}, {column}")
    if len(numbers) == 16:
        return np.array(numbers).reshape(4, 4)
    if len(numbers) not in (0, 3, 7):
        raise FileError(f"{where}, {column}: expected 3, 7 or 16 numbers, found {len(numbers)}")
    return inputs.pose_of(numbers or [0.0] * 3, f"{where}, {column}")


def _answers(rows: Sequence[dict[str, Any]], path: Path) -> dict[str, Floats]:
    """Return the columns with answers, which are NaN in rows without an answer."""
    columns = {}
    for name, count in ANSWERS.items():
        if not any(name in row for row in rows):
            continue
        column = np.full((len(rows), count), np.nan)
        for k, row in enumerate(rows):
            numbers = _numbers(row.get(name), f"{path}, row {k + 1}, {name}")
            if len(numbers) not in (0, count):
                raise FileError(f"{path}, row {k + 1}, {name}: expected {count} numbers, found {len(numbers)}")
            if numbers:
                column[k] = numbers
        columns[name] = column if count > 1 else column[:, 0]
    if not columns:
        raise FileError(f"{path}: expected a column of answers, one of {', '.join(ANSWERS)}, found none")
    return columns


def _program(options: Any, said: Judgement, named: Any, bodies: Any, poses: Any, answers: Any, tolerance: float) -> str:
    """Write a program about the worst answer for two hulls, or about the answer in the given row. Describe it."""
    path, rows = options.program, said.worst().tolist()
    if options.row is not None:
        if options.row - 1 not in rows:
            wrong_rows = short([k + 1 for k in sorted(rows)]) if rows else "none"
            raise InputError(f"--row: expected a row that is proven wrong ({wrong_rows}), found {options.row}")
        rows = [options.row - 1]
    for k in rows:
        answer = {name: x[k] for name, x in answers.items() if not np.isnan(x[k]).any()}
        a, b = (bodies[name] for name in named[k])
        try:
            code = reproduction(a, poses[0][k], b, poses[1][k], **answer, tolerance=tolerance)
        except LoewnerError as error:
            if options.row is not None:
                raise InputError(f"--row: expected a row whose errors can be proven in fractions: {error}") from error
            continue
        with replacing(path) as file:
            file.write_text(code, encoding="utf-8")
        return f"{shown(path)} proves row {k + 1} wrong in fractions"
    return f"{shown(path)} is not written: no wrong answer is about two convex hulls" if rows else ""


def _described(bodies: dict[str, loewner.Body]) -> dict[str, str]:
    """Describe the body that was made from each file. Add a note if the hull would be the same body."""
    descriptions = {}
    for name, body in {id(body): (name, body) for name, body in bodies.items()}.values():
        descriptions[name] = repr(body)[len("Body(") : -1]
        piece = body.pieces[0]
        if len(body.pieces) == 1 and piece.kind == "solid" and _is_convex(piece.vertices, piece.triangles):
            descriptions[name] += " (convex: with --meshes hull, its depths are proven, too)"
    return descriptions


def _is_convex(vertices: Any, triangles: Any) -> bool:
    """Return whether a closed mesh is its own hull. The result informs the reader; no finding depends on it."""
    from scipy.spatial import ConvexHull  # not needed by other commands, which start faster without it

    corners = (vertices - vertices.mean(axis=0))[triangles]
    volume = abs(float(np.linalg.det(corners).sum())) / 6
    return math.isclose(volume, float(ConvexHull(vertices).volume), rel_tol=1e-6)


def _for_json(said: Judgement, named: Pairs, bodies: dict[str, loewner.Body]) -> dict[str, Any]:
    rows = [
        {
            "row": k + 1,
            "bodies": list(named[k]),
            "wrong": {part: {"finding": kind.name, "at_least": error} for part, kind, error in _wrong_parts(said, k)},
            "lower": None if np.isinf(said.lower[k]) else float(said.lower[k]),
            "upper": float(said.upper[k]),
        }
        for k in said.worst().tolist()
    ]
    counts = {str(kind): n for kind, n in said.counts().items()}
    return {
        "pairs": len(named), "bodies": _described(bodies), "counts": counts, "hints": list(said.hints), "wrong": rows,
    }  # fmt: skip


def _print(said: Judgement, named: Pairs, bodies: dict[str, loewner.Body], written: str | None) -> None:
    worst = said.worst().tolist()
    print(f"{len(worst) or 'none'} of {counted(len(named), 'answer')} proven wrong")
    rows = []
    for kind, number in said.counts().items():
        first, wrong = said.worst(kind)[0], kind > Finding.UNDECIDED
        error = float(said.excess[first][said.kinds[first] == kind].max())
        rows.append((str(kind), f"{number}", f"at least {error:.6g}" * wrong, f"{first + 1}" * wrong))
    print_table(("finding", "parts of answers", "largest error, m", "row"), rows)
    for hint in said.hints:
        print(f"hint      {hint}")
    judged = [f"{name}: {text}" for name, text in _described(bodies).items()]
    more = f"; and {len(judged) - SHOWN} more (--json)" if len(judged) > SHOWN else ""
    print(f"judged    {'; '.join(judged[:SHOWN])}{more}")
    for k in worst[:SHOWN]:
        parts = [f"{part} {kind} by {error:.6g} m" for part, kind, error in _wrong_parts(said, k)]
        print(f"row {k + 1}, {' and '.join(named[k])}: {', '.join(parts)}; proven {_interval(said, k)}")
    if len(worst) > SHOWN:
        print(f"and {len(worst) - SHOWN} more (--json)")
    if written:
        print(f"program   {written}")


def _wrong_parts(said: Judgement, k: int) -> list[tuple[str, Finding, float]]:
    """Return the wrong parts of the answer in a row, each with its finding and error."""
    parts = zip(PARTS, map(Finding, said.kinds[k].tolist()), said.excess[k].tolist(), strict=True)
    return [part for part in parts if part[1] > Finding.UNDECIDED]


def _interval(said: Judgement, k: int) -> str:
    """Format the proven signed distance of the bodies in a row."""
    lower, upper = float(said.lower[k]), float(said.upper[k])
    if np.isinf(lower):
        return f"depth at least {max(-upper, 0.0):.9g} m"
    return f"signed distance from {lower:.9g} to {upper:.9g} m"
