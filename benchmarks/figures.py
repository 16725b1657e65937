"""Figures of the growth benchmarks, drawn from their rows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from report import Row

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#555555"
# The fields of `loewner.checkers.Settled`: free in blue, colliding in orange, the darker the dearer.
TIERS = {
    "free_by_bounds": {"color": "#d6e9f5", "label": "free: bounds"},
    "free_by_ellipsoids": {"color": "#8fc3e3", "label": "outer ellipsoids"},
    "free_by_planes": {"color": "#3a94cb", "label": "planes"},
    "free_by_search": {"color": "#004c78", "label": "search"},
    "colliding_by_ellipsoids": {"color": "#f3b58a", "label": "colliding: inner ellipsoids"},
    "colliding_by_search": {"color": "#b04a00", "label": "search"},
}
SOURCES = {
    "uniform": "drawn uniformly",
    "straight line": "straight from start to goal",
    "planner": "motions that RRT-Connect asked about",
}


def vertices(rows: Sequence[Row], path: Path) -> None:
    """Cost of a pair against the number of vertices of its hulls."""
    powers = sorted({re.search(r"power (\S+)", r.case).group(1) for r in rows})
    figure, axes = plt.subplots(1, len(powers), figsize=(5 * len(powers), 3.8), sharey=True, squeeze=False)
    titles = {"2": "points on a sphere", "4": "points on $x^4+y^4+z^4=1$"}
    for ax, power in zip(axes[0], powers, strict=True):
        mine = [r for r in rows if r.case.endswith(f"power {power}")]
        for query, color in (("classify", BLUE), ("collide", ORANGE)):
            _line(ax, [r for r in mine if r.us == query], color, f"loewner {query}")
        coal = [r for r in mine if r.us == "collide" and r.theirs]
        x, y = [_number(r) for r in coal], [1e9 * r.theirs.cpu for r in coal]
        ax.plot(x, y, "s--", color=GREY, label="Coal C++, boolean")
        ax.set(xscale="log", yscale="log", xlabel="vertices per hull", title=titles.get(power, f"power {power}"))
        ax.grid(alpha=0.3)
    axes[0][0].set_ylabel("processor time per pair (ns)")
    axes[0][0].legend(frameon=False)
    _save(figure, path)


def batches(rows: Sequence[Row], path: Path) -> None:
    """Cost of a pair against the size of the batch."""
    _against_size(rows, path, "pair", "Coal from Python, boolean")


def robot_batches(rows: Sequence[Row], path: Path) -> None:
    """Cost of a configuration of a robot against the size of the batch."""
    _against_size(rows, path, "configuration", f"{rows[0].rival}, boolean")


def _against_size(rows: Sequence[Row], path: Path, item: str, rival: str) -> None:
    figure, ax = plt.subplots(figsize=(5.5, 3.8))
    for query, color in (("classify", BLUE), ("collide", ORANGE)):
        _line(ax, [r for r in rows if r.us == query and r.ours], color, f"loewner {query}")
    theirs = next((r.theirs for r in rows if r.theirs), None)
    if theirs:
        ax.axhline(1e9 * theirs.cpu, color=GREY, linestyle="--", label=rival)
    ax.set(xscale="log", yscale="log", xlabel=f"{item}s per call", ylabel=f"processor time per {item} (ns)")
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    _save(figure, path)


def tiers(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """What settled the configurations: a bar for each group of problems, a panel for each kind of configurations."""
    sources = list(dict.fromkeys(row["states"] for row in rows))
    names = [name for name in rows[0] if name in TIERS]
    figure, axes = plt.subplots(1, len(sources), figsize=(4.2 * len(sources), 3.6), sharey=True, squeeze=False)
    for ax, source in zip(axes[0], sources, strict=True):
        mine = [row for row in rows if row["states"] == source]
        left = np.zeros(len(mine))
        for name in names:
            share = np.array([100 * row[name] / row["configurations"] for row in mine])
            ax.barh([row["group"].replace("_", " ") for row in mine], share, left=left, **TIERS[name])
            left += share
        ax.set(title=SOURCES[source], xlabel="% of configurations", xlim=(0, 100))
    axes[0][0].invert_yaxis()
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(names), frameon=False, fontsize="small")
    _save(figure, path, bottom=0.08)


def _number(row: Row) -> int:
    return int(re.search(r"\d+", row.case).group())


def _line(ax: plt.Axes, rows: Sequence[Row], color: str, label: str) -> None:
    ax.plot([_number(r) for r in rows], [1e9 * r.ours.cpu for r in rows], "o-", color=color, label=label)


def _save(figure: plt.Figure, path: Path, bottom: float = 0.0) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout(rect=(0, bottom, 1, 1))
    figure.savefig(path, dpi=120)
    plt.close(figure)
