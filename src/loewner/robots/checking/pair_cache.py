"""Cache on disk which pairs of a robot's links can ever collide, keyed by all data on which the answers depend."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from loewner._base import _archives, _json
from loewner._base._validate import Pair
from loewner._kernels import _sealed, _sources
from loewner.bodies import packed_of
from loewner.bodies.layout import arrays_of
from loewner.robots.description.link_bodies import hash_of_code
from loewner.robots.description.pair_verdicts import PairVerdict, ProvenPair

FOLDER = _sources.cache_folder() / "pairs"

_ARRAYS = ("lower", "upper", "nearest", "colliding", "free")


def known_pairs(robot: Any) -> dict[Pair, tuple[ProvenPair, int]]:
    """Return the cached answers for a robot, each with the maximum number of boxes in its search."""
    answers, start = {}, _start(robot)
    with suppress(OSError, _sealed.DamagedFileError, ValueError, KeyError, TypeError):
        if any(path.name.startswith(start) for path in FOLDER.iterdir()):  # computing `_path` takes milliseconds
            for row in _json.loads(_sealed.read(_path(robot))):
                answers[tuple(row["names"])] = _row(row), int(row["allowed"])
    return answers


def keep(robot: Any, rows: Iterable[ProvenPair], allowed: int) -> None:
    """Add answers to the cache; if there is no writable folder, do nothing."""
    answers = known_pairs(robot) | {row.names: (row, allowed) for row in rows}
    content = json.dumps([_entry(row, allowed) for row, allowed in answers.values()]).encode()
    with suppress(OSError):
        FOLDER.mkdir(parents=True, exist_ok=True)
        _sealed.write(_path(robot), content)


def refuted(robot: Any) -> list[ProvenPair]:
    """Return cached answers about non-adjacent pairs of links that are exempt from checking but can collide."""
    if not robot.disabled_pairs:
        return []
    wrong = PairVerdict.SOMETIMES, PairVerdict.CAN
    exempt = robot.disabled_pairs - robot.adjacent_pairs
    return [row for names, (row, _) in sorted(known_pairs(robot).items()) if names in exempt and row.verdict in wrong]


def _start(robot: Any) -> str:
    """Return the beginning of a cache file's name; unlike the whole name, it is fast to compute."""
    names = robot.name, *robot.link_names, *robot.configuration_names
    return hashlib.sha256("\0".join(names).encode()).hexdigest()[:16]


@cache
def _code() -> str:
    """Return a hash of the code that computes the answers."""
    return hash_of_code([Path(__file__).parents[1]])


def _path(robot: Any) -> Path:
    arrays: dict[str, Any] = {**robot.tree._asdict(), "hard_lower": robot.hard_lower, "hard_upper": robot.hard_upper}
    for name, body in robot.bodies.items():
        arrays |= {f"{name}/{key}": array for key, array in arrays_of(packed_of(body)).items()}
    digest = _archives.digest(arrays | {"code": np.bytes_(_code())})
    return FOLDER / f"{_start(robot)}-{digest[:32]}.pairs"


def _entry(row: ProvenPair, allowed: int) -> dict[str, Any]:
    entry = {**vars(row), "verdict": str(row.verdict), "allowed": allowed}
    return entry | {key: None if entry[key] is None else entry[key].tolist() for key in _ARRAYS}


def _row(entry: Mapping[str, Any]) -> ProvenPair:
    fields = {key: value for key, value in entry.items() if key != "allowed"}
    fields |= {key: None if fields[key] is None else np.array(fields[key], dtype=float) for key in _ARRAYS}
    fields |= {"names": tuple(fields["names"]), "columns": tuple(fields["columns"])}
    return ProvenPair(**{**fields, "verdict": PairVerdict(fields["verdict"])})
