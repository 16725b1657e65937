"""Print how shapes cover a robot's links, and return the exit status."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from loewner import plots
from loewner.bodies import packed_of
from loewner.bodies.triangulated import of_pieces
from loewner.cli.output import AMBIGUOUS, COLLIDING, FREE, coordinates, counted, print_table, progress_of
from loewner.meshes.coverage import CoverReport

# Reports by the names of links.
Reports = Mapping[str, CoverReport]

STATUS = {"covered": FREE, "undecided": AMBIGUOUS, "uncovered": COLLIDING}


def judged(robot: loewner.Robot, model: loewner.Robot, tolerance: float | None = None) -> Reports:
    """Judge a model while a progress bar is shown."""
    with progress_of("proofs", len(robot.bodies)) as progress:
        return robot.covered_by(model, tolerance=tolerance, progress=progress)


def print_reports(
    robot: loewner.Robot, model: loewner.Robot, reports: Reports, more: Mapping[str, Sequence[str]] = {}
) -> None:
    """Print a row for each link, with additional columns if they are given."""
    where = any(report.witness is not None for report in reports.values())
    columns = ["link", "shapes", "outcome", "uncovered", "up to", *["at, m"] * where, "sticks out", *more]
    rows = [
        (
            link, str(_shapes(model, link)), report.outcome, _interval(report.uncovered_share, 100.0, "%"),
            _interval(report.depth, 1e3, "mm"),
            *["-" if report.witness is None else coordinates(report.witness)] * where,
            _interval(report.excess, 1e3, "mm"), *(column[number] for column in more.values()),
        )
        for number, (link, report) in enumerate(reports.items())
    ]  # fmt: skip
    print_table(columns, rows, f"{robot.name}: {counted(len(robot.bodies), 'link')} with bodies")
    counts = {name: sum(report.outcome == name for report in reports.values()) for name in STATUS}
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    largest = max(report.excess[1] for report in reports.values())
    if any(report.outcome == "uncovered" for report in reports.values()):
        area = {link: _area(body) for link, body in robot.bodies.items()}
        ends = [
            sum(reports[link].uncovered_share[k] * area[link] for link in area) / sum(area.values()) for k in (0, 1)
        ]
        print(f"{_interval(ends, 100.0, '%')} of the surface of all links is outside")
    print(
        f"{told} of {counted(len(reports), 'link')}; "
        f"{counted(sum(len(body.pieces) for body in model.bodies.values()), 'shape')}, "
        f"which stick out by up to {_number(1e3 * largest, np.ceil)} mm"
    )


def _area(body: loewner.Body) -> float:
    """Return the total surface area of all pieces."""
    corners = np.concatenate([vertices[triangles] for vertices, triangles in of_pieces(packed_of(body))])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(normals, axis=1).sum()) / 2


def _interval(ends: Sequence[float], factor: float, unit: str) -> str:
    """Write bounds with three digits, rounded outwards, or one number if both bounds are written alike."""
    low, high = _number(factor * ends[0], np.floor), _number(factor * ends[1], np.ceil)
    return f"{low} {unit}" if low == high else f"{low} .. {high} {unit}"


def _number(x: float, rounded: Callable[[float], float]) -> str:
    if x == 0 or not np.isfinite(x):
        return f"{x:g}"
    step = 10.0 ** (np.floor(np.log10(abs(x))) - 2)
    return f"{rounded(x / step) * step:.4g}"


def entries(model: loewner.Robot, reports: Reports) -> dict[str, dict[str, Any]]:
    """Convert all reports to values that JSON can hold. Infinite distances become null."""

    def ends(pair: tuple[float, float]) -> list[float | None]:
        return [end if np.isfinite(end) else None for end in pair]

    return {
        link: {
            "shapes": _shapes(model, link),
            "outcome": report.outcome,
            "uncovered_share": ends(report.uncovered_share),
            "depth": ends(report.depth),
            "witness": None if report.witness is None else report.witness.tolist(),
            "excess": ends(report.excess),
        }
        for link, report in reports.items()
    }


def _shapes(model: loewner.Robot, link: str) -> int:
    """Return the number of shapes that a model has for a link."""
    return len(model.bodies[link].pieces) if link in model.bodies else 0


def draw(robot: loewner.Robot, model: loewner.Robot, picture: Path | None) -> None:
    """Draw a picture if one was requested."""
    if picture is not None:
        plots.save(plots.cover(robot, model), picture)


def status(reports: Reports) -> int:
    """Return the exit status: 0 if all links are covered, 1 if a link is not covered, 3 if a link is undecided."""
    outcomes = {report.outcome for report in reports.values()}
    return next(STATUS[name] for name in ("uncovered", "undecided", "covered") if name in outcomes)
