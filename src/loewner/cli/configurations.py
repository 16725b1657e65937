"""Read configurations from .npy, .csv and .json files, and write paths to .csv and .json files."""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner._base import _archives, _json, _tables, _validate
from loewner._base._files import read_regular, replacing
from loewner._base._plausible import warn
from loewner._base._validate import Floats, some
from loewner.errors import FileError, InputError, LoewnerError

# Endings of files from which configurations are read, and of files to which paths are written.
READ = (".npy", ".csv", ".json")
WRITTEN = (".csv", ".json")

# The largest file of configurations that is read [bytes].
MOST_BYTES = 2**33


def read(path: Path, robot: loewner.Robot, *, named: bool = False) -> Floats:
    """Read the numbers of a file and put them in the order of the robot's columns. The caller checks their shape.

    If `named`, the file must name its columns, as files from `write` do. A .npy file cannot name columns.
    """
    suffix = path.suffix.lower()
    if suffix not in READ:
        raise FileError(f"{path}: expected a .npy, .csv or .json file, found {path.suffix or 'no suffix'}")
    data = read_regular(path, "configurations", MOST_BYTES)
    if suffix == ".npy":
        return _archives.numbers(data, str(path), "an array of numbers")
    try:
        text = data.decode("utf-8-sig")
        content: Any = _json.parsed(text, str(path)) if suffix == ".json" else rows_of(text)
    except (ValueError, OverflowError, MemoryError, RecursionError, csv.Error):
        raise FileError(f"{path}: expected an array of numbers, found something else") from None
    names = robot.configuration_names
    if named and not (isinstance(content, Mapping) if suffix == ".json" else _has_header(content, names)):
        raise FileError(f"{path}: expected names of the columns, found none")
    return _of_json(content, robot, path) if suffix == ".json" else of_rows(content, robot, path)


def path_of(path: Path, robot: loewner.Robot) -> Floats:
    """Read a path without times, as written by `write`, with shape (two or more, dof)."""
    hint = "; points with times have a first column time" if path.suffix.lower() == ".csv" else ""
    try:
        rows = np.atleast_2d(robot.checked(read(path, robot, named=True), str(path)))
    except LoewnerError as error:
        raise FileError(f"{error}{hint}") from None
    if len(rows) < 2:
        raise FileError(f"{path}: expected two configurations or more, found {len(rows)}{hint}")
    return rows


def is_path(path: Path, times: Sequence[str]) -> bool:
    """Return whether a file names its columns, as files from `write` do, and the first name is not in `times`."""
    if path.suffix.lower() not in WRITTEN:
        return False
    try:
        text = read_regular(path, "configurations", MOST_BYTES).decode("utf-8-sig")
        if path.suffix.lower() == ".json":
            document = _json.parsed(text, str(path))
            return isinstance(document, Mapping) and "configurations" in document
        rows = rows_of(_tables.start_of(text)[1])
    except (FileError, ValueError, RecursionError, csv.Error):
        return False
    return _has_header(rows) and rows[0][0] not in times


def write(path: Path, names: Sequence[str], rows: Floats) -> None:
    """Write a path and the names of its columns atomically. Reading the file returns the same numbers."""
    numbers = rows.tolist()
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        if path.suffix.lower() == ".csv":
            csv.writer(file, lineterminator="\n").writerows([names, *numbers])
        else:
            # Write one configuration on each line.
            listed = ",\n  ".join(map(json.dumps, numbers))
            file.write(f'{{\n "names": {json.dumps(names)},\n "configurations": [\n  {listed}\n ]\n}}\n')


def given(text: str, name: str, options: argparse.Namespace, robot: loewner.Robot, start: Floats | None) -> Floats:
    """Read one or more configurations from a state's name, a file, or numbers. The caller checks the shape.

    Joints that a state does not name keep their values in `start`.
    """
    if text in robot.states:
        kept = {} if start is None else dict(zip(robot.configuration_names, start, strict=True))
        return robot.configuration(kept | dict(robot.states[text][1]))
    if Path(text).suffix.lower() in READ:
        Q = robot.checked(read(Path(text), robot), text)
        return Q[0] if len(Q) == 1 else Q
    try:
        numbers = _tables.row(text)
    except ValueError as error:
        if options.srdf is not None and "," not in text:
            raise _validate.unknown_name(f"{name}, state", text, robot.states) from None
        raise InputError(
            f"{name}: expected numbers, a .npy, .csv or .json file, or with --srdf the name of a state; found {text!r} "
            f"({error})"
        ) from None
    return robot.checked(numbers, name)


def one(text: str | None, name: str, options: argparse.Namespace, robot: loewner.Robot) -> Floats | None:
    """Read one configuration as `given` does; return None if `text` is None.

    A state that does not name all joints causes a warning, since the other joints may not be at the assumed value 0.
    """
    if text in robot.states:
        named = robot.states[text][1]
        unnamed = [value for value in robot.configuration_names if not {value, value.rpartition("/")[0]} & named.keys()]
        if unnamed:
            warn(f"{name} {text}: expected values of all joints, found none of {some(unnamed)}, so 0 is assumed")
    return None if text is None else robot.checked_one(given(text, name, options, robot, None), name)


def rows_of(text: str) -> list[list[str]]:
    """Return the cells of a table, without empty rows."""
    return [[cell.strip() for cell in row] for row in csv.reader(text.splitlines()) if row]


def _has_header(rows: list[list[str]], names: Sequence[str] = ()) -> bool:
    """Return whether the first row of a table names the columns. The name of a joint may be a number."""
    return bool(rows) and (sorted(rows[0]) == sorted(names) or not any(_are_numbers([cell]) for cell in rows[0]))


def of_rows(rows: list[list[str]], robot: loewner.Robot, path: Path) -> Floats:
    """Read the numbers of a table, whose first row may name the columns."""
    names = list(robot.configuration_names)
    for row in rows:
        for cell in row:
            if ";" in cell or (len(cell.split()) > 1 and _are_numbers(cell.split())):
                separators = "semicolons" if ";" in cell else "spaces"
                raise FileError(f"{path}: expected numbers separated by commas, found {separators}: {','.join(row)}")
    order = names
    if _has_header(rows, names):
        order = rows.pop(0)
        _check_columns(order, names, path)
    for k, row in enumerate(rows):
        if len(row) != len(names) or not _are_numbers(row):
            raise FileError(
                f"{path}: expected {len(names)} finite numbers in each row, found {','.join(row)} in row {k + 1}"
            )
    return _ordered(np.array(rows, dtype=np.float64).reshape(-1, len(names)), order, names)


def _of_json(found: Any, robot: loewner.Robot, path: Path) -> Floats:
    """Read the numbers of a JSON list, or of a file that `write` has written."""
    if not isinstance(found, Mapping):
        return _validate.float_array(found, str(path))
    if set(found) != {"names", "configurations"}:
        raise FileError(
            f'{path}: expected a list of numbers, or "names" and "configurations", '
            f"found {', '.join(map(repr, found)) or 'neither'}"
        )
    names, order = list(robot.configuration_names), _validate.listed(found["names"], f"{path}, names")
    _check_columns(order, names, path)
    numbers = _validate.float_array(found["configurations"], f"{path}, configurations")
    if numbers.ndim == 0 or numbers.shape[-1] != len(names):
        raise FileError(
            f"{path}: expected {len(names)} numbers for each configuration, "
            f"found shape {_validate.shape_text(numbers.shape)}"
        )
    return _ordered(numbers, order, names)


def _ordered(numbers: Floats, order: Sequence[str], names: Sequence[str]) -> Floats:
    """Put columns in the robot's order."""
    return np.asarray(numbers[..., [order.index(name) for name in names]])


def _check_columns(order: Sequence[str], names: Sequence[str], path: Path) -> None:
    """Check that each column is named once."""
    for name in order:
        _validate.known(name, f"{path}, column", names)
        if order.count(name) > 1:
            raise FileError(f"{path}: expected each column once, found {name} {order.count(name)} times")
    missing = [name for name in names if name not in order]
    if missing:
        raise FileError(f"{path}: expected a column for each joint value, found none for {', '.join(missing)}")


def _are_numbers(cells: Sequence[str]) -> bool:
    try:
        return all(math.isfinite(_tables.number(cell)) for cell in cells)
    except ValueError:
        return False
