"""Read and write trajectories as .csv, with a row for each knot, or as .json. All numbers are restored exactly."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from loewner._base import _tables, _validate
from loewner._base._files import read_regular, shown
from loewner._base._nodes import Node, read_json
from loewner._base._validate import Bools, Floats
from loewner.errors import FileError, InputError
from loewner.planners.controllers import ACCELERATION, BLEND, TIMES, VELOCITY, expect_in_table

LARGEST_FILE = 2**28  # bytes

ENDINGS = (".csv", ".json")
WRITTEN = (*ENDINGS, ".yaml")

# Keys of a .json file that is not a message.
RATES = ("velocities", "accelerations")
SAVED_KEYS = ("names", "times", "positions", *RATES, "blended", "jumps", "start_time")
OTHERS = "; planners.ControllerPoints.load reads messages and points of other programs"


class Rows(NamedTuple):
    """The contents of a file.

    Attributes
    ----------
    names, times, knots, rates, blended, bends, start_time
        As for `Trajectory`. Without `rates` and `blended`, velocities are constant between the times, and jump at the
        times.
    """

    names: tuple[str, ...]
    times: Floats
    knots: Floats
    rates: Floats | None
    blended: Bools | None
    bends: Floats | None
    start_time: float


def with_ending(path: str | os.PathLike[str], endings: tuple[str, ...], hint: str = "") -> Path:
    """Check the extension of a path."""
    checked = _validate.path(path, "path")
    if checked.suffix.lower() not in endings:
        raise InputError(f"path: expected a name that ends in {' or '.join(endings)}, found {shown(checked)}{hint}")
    return checked


def written(rows: Rows, suffix: str) -> str:
    """Return the text of a file with the extension `suffix`, one of `ENDINGS`."""
    if suffix != ".csv":
        return json.dumps(_held(rows))
    parts = [part for part in (rows.knots, rows.rates, rows.bends) if part is not None]
    flags = None if rows.blended is None else np.append(rows.blended, False).astype(int).tolist()
    return table_of(rows.names, rows.times, parts, rows.start_time, flags)


def table_of(
    names: Sequence[str], times: Floats, parts: Sequence[Floats], start_time: float, flags: list[int] | None = None
) -> str:
    """Return the text of a table with times and positions, optionally with velocities, or velocities and accelerations.

    With `flags`, the last column marks rows after which the robot cuts a corner.
    """
    expect_in_table(names)
    kinds = ("", VELOCITY, ACCELERATION)[: len(parts)]
    header = [TIMES[0], *(name + kind for kind in kinds for name in names), *([] if flags is None else [BLEND])]
    return _tables.written(header, np.column_stack([times, *parts]), start_time, flags)


def read(source: Path) -> Rows:
    """Read a file without checking that its numbers form a trajectory.

    Raises
    ------
    FileError
        If the file does not exist, or does not contain rows of a trajectory.
    """
    data = read_regular(source, "a trajectory", LARGEST_FILE)
    try:
        if source.suffix.lower() == ".json":
            rows = saved_rows(read_json(data, source, "a trajectory in JSON"))
        else:
            rows = rows_of_table(data.decode())
        if (rows.rates is None) != (rows.blended is None):
            raise InputError("expected both velocities and blends, or neither, found only one of them")
        if rows.rates is None and rows.bends is not None:
            raise InputError("expected accelerations beside velocities and blends, found them alone")
        if rows.rates is None and (not len(rows.times) or not (np.diff(rows.times) > 0).all()):
            raise InputError("expected times that increase, found others")  # velocities need steps above 0
        if rows.rates is None and len(rows.times) != len(rows.knots):
            raise InputError(f"expected a time for each position, found {len(rows.times)} and {len(rows.knots)}")
        return rows
    except FileError as error:
        raise FileError(f"{error}{OTHERS}") from None
    except InputError as error:
        raise FileError(f"{shown(source)}: {error}{OTHERS}") from None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, csv.Error) as error:
        why = f"no {error}" if isinstance(error, KeyError) else _validate.short(str(error))
        raise FileError(f"{shown(source)}: expected a trajectory, found {why}{OTHERS}") from None


def _held(rows: Rows) -> dict[str, Any]:
    held = {"names": rows.names, "times": rows.times.tolist(), "positions": rows.knots.tolist()}
    if rows.rates is None or rows.blended is None:
        return held | {"jumps": True, "start_time": rows.start_time}
    held |= {"velocities": rows.rates.tolist(), "blended": rows.blended.tolist()}
    if rows.start_time:
        held["start_time"] = rows.start_time
    return held if rows.bends is None else held | {"accelerations": rows.bends.tolist()}


def rows_of_table(text: str) -> Rows:
    """Read a table whose header names, in any order, the time, the joints, and the rates of all joints or none."""
    start_time, text = _tables.start_of(text)
    rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), strict=True) if row]
    header = rows[0] if rows else []
    if set(header) <= {*TIMES, BLEND} or header[0] not in TIMES or len(set(header)) < len(header):
        raise InputError(
            f"expected a header that names the time and different joints, found {_validate.short(','.join(header))}"
        )
    table = _tables.below(header, rows[1:])
    names = [name for name in header[1:] if name != BLEND and not name.endswith((VELOCITY, ACCELERATION))]
    held, used = set(header), [VELOCITY, ACCELERATION]
    wanted = [name + kind for kind in used if any(name + kind in held for name in names) for name in names]
    odd = [name for name in wanted if name not in held] + sorted(held - {header[0], BLEND, *names, *wanted})
    if odd:
        what = "no column" if odd[0] not in held else "no joint for the column"
        raise InputError(f"expected a velocity or acceleration for all joints or none, found {what} {odd[0]!r}")

    def columns(kind: str) -> Floats:
        return np.asarray(table[:, [header.index(name + kind) for name in names]])

    rates, bends = (columns(kind) if names and names[0] + kind in held else None for kind in used)
    flags = table[:, header.index(BLEND)] if BLEND in held else None
    if flags is not None and not np.isin(flags, (0, 1)).all():
        raise InputError(f"column {BLEND!r}: expected 0 or 1, found {flags[~np.isin(flags, (0, 1))][0]:g}")
    blended = None if flags is None else flags[:-1] != 0
    return Rows(tuple(names), table[:, 0], columns(""), rates, blended, bends, start_time)


def saved_rows(root: Node) -> Rows:
    """Read a .json file that `Trajectory.save` has written."""
    keys = root.mapping(SAVED_KEYS, required=("names", "times", "positions"))
    names = tuple(name.text() for name in keys["names"].items())
    start_time = keys["start_time"].number() if "start_time" in keys else 0.0
    times, knots = np.array(keys["times"].numbers()), np.array(keys["positions"].rows(len(names)))
    rates, bends = (np.array(keys[kind].rows(len(names))) if kind in keys else None for kind in RATES)
    if "jumps" in keys:
        if not keys["jumps"].flag() or {"blended", *RATES} & keys.keys():
            raise root.error("expected jumps: true with times and positions alone")
        return Rows(names, times, knots, None, None, None, start_time)
    if "blended" not in keys or rates is None:
        present = ", ".join(key for key in ("velocities", "blended") if key in keys) or "neither"
        raise root.error(f"expected the keys velocities and blended, or jumps, found {present}")
    blended = np.array([each.flag() for each in keys["blended"].items()], dtype=bool)
    return Rows(names, times, knots, rates, blended, bends, start_time)
