"""Figures of the benchmarks, drawn from their rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from loewner import plots
from report import Row

SOURCES = {
    "uniform": "drawn uniformly",
    "straight line": "straight from start to goal",
    "planner": "motions that RRT-Connect asked about",
}
POWERS = {"2": "points on a sphere", "4": "points on $x^4+y^4+z^4=1$"}


def vertices(rows: Sequence[Row], path: Path) -> None:
    """Cost of a pair against the number of vertices of its hulls."""
    powers = sorted({re.search(r"power (\S+)", r.case).group(1) for r in rows})
    figure = Figure(figsize=(5 * len(powers), 3.8), layout="constrained")
    axes = figure.subplots(1, len(powers), sharey=True, squeeze=False)[0]
    for ax, power in zip(axes, powers, strict=True):
        mine = [r for r in rows if r.case.endswith(f"power {power}")]
        curves = _ours(mine)
        if any(r.theirs for r in mine):
            curves["Coal C++, boolean"] = [r.theirs.cpu if r.theirs else np.nan for r in mine if r.us == "collide"]
        plots.costs(_sizes(mine), curves, size="vertices per hull", ax=ax)
        ax.set_title(POWERS.get(power, f"power {power}"))
        ax.label_outer()
    _save(figure, path)


def batches(rows: Sequence[Row], path: Path) -> None:
    """Cost of a pair against the size of the batch."""
    _against_size(rows, path, "pair", "Coal from Python, boolean")


def robot_batches(rows: Sequence[Row], path: Path) -> None:
    """Cost of a configuration of a robot against the size of the batch."""
    _against_size(rows, path, "configuration", f"{rows[0].rival}, boolean")


def _against_size(rows: Sequence[Row], path: Path, item: str, rival: str) -> None:
    measured = [r for r in rows if r.ours]
    if not measured:
        return  # the table says why
    curves: dict[str, Any] = _ours(measured)
    theirs = next((r.theirs for r in rows if r.theirs), None)
    if theirs:
        curves[rival] = theirs.cpu
    figure = Figure(figsize=(5.5, 3.8), layout="constrained")
    plots.costs(_sizes(measured), curves, size=f"{item}s per call", item=item, ax=figure.add_subplot())
    _save(figure, path)


def tiers(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """What settled the configurations: a bar for each group of problems, a panel for each kind of configurations."""
    sources = list(dict.fromkeys(row["states"] for row in rows))
    figure = Figure(figsize=(4.2 * len(sources), 3.6), layout="constrained")
    axes = figure.subplots(1, len(sources), sharey=True, squeeze=False)[0]
    for ax, source in zip(axes, sources, strict=True):
        groups = {row["group"].replace("_", " "): row for row in rows if row["states"] == source}
        plots.tiers({name: {k: row[k] for k in row if k in plots.TIERS} for name, row in groups.items()}, ax=ax)
        ax.set(title=SOURCES[source], xlabel="% of configurations")
        ax.get_legend().remove()
    _legend(figure, axes[0], 3)
    _save(figure, path)


def accuracy(counts: Mapping[str, Mapping[str, tuple[int, int]]], path: Path) -> None:
    """How often each rule was right about ambiguous pairs of each family of shapes."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    ax = plots.accuracy(counts, ax=figure.add_subplot())
    ax.set_xlabel("ambiguous pairs decided rightly, % (lines: 95 % intervals)")
    ax.get_legend().remove()
    _legend(figure, ax, len(counts))
    _save(figure, path)


def _sizes(rows: Sequence[Row]) -> list[int]:
    return [int(re.search(r"\d+", r.case).group()) for r in rows if r.us == "collide"]


def _ours(rows: Sequence[Row]) -> dict[str, list[float]]:
    return {f"loewner {us}": [r.ours.cpu for r in rows if r.us == us] for us in ("classify", "collide")}


def _legend(figure: Figure, ax: Any, columns: int) -> None:
    """One legend for all panels, below them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize="small")


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    plots.save(figure, path)
