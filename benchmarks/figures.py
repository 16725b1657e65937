"""Figures of the growth benchmarks, drawn from their rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from report import Row

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#555555"


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


def _number(row: Row) -> int:
    return int(re.search(r"\d+", row.case).group())


def _line(ax: plt.Axes, rows: Sequence[Row], color: str, label: str) -> None:
    ax.plot([_number(r) for r in rows], [1e9 * r.ours.cpu for r in rows], "o-", color=color, label=label)


def _save(figure: plt.Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)
