"""Rows of results: a table on the terminal, one CSV per benchmark and machine."""

from __future__ import annotations

import csv
import json
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from clock import Cost

# How many times as fast as the rival we must be (the last: two threads against one).
REQUIRED = {
    "classify vs Coal C++ ellipsoids": 20.0,
    "collide vs Coal C++": 10.0,
    "collide vs Coal Python": 30.0,
    "distance vs Coal C++": 3.0,
    "penetration vs Coal C++": 3.0,
    "two threads": 1.8,
    "crowd": 5.0,
    "robot vs AABB tree": 10.0,
    "planner": 5.0,
    "motions vs samples": 1.0,
    "plan vs OMPL": 10.0,
    "plan vs pinocchio": 25.0,
}

PACKAGES = (
    "loewner", "numpy", "numba", "coal", "cmeel-eigen", "python-fcl", "ellipsoid-tree", "pin", "ompl", "toppra",
    "ruckig",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One comparison. Costs are seconds per item; `rival` is None where it could not run, and `note` says why."""

    case: str
    us: str
    ours: Cost | None
    rival: str
    theirs: Cost | None
    items: int
    required: float | None = None
    differing: int | None = None
    note: str = ""
    by_wall: bool = False

    @property
    def ratio(self) -> float | None:
        """Rival's time over ours, in processor time; in wall time where threads are compared."""
        if self.ours is None or self.theirs is None:
            return None
        return self.theirs.wall / self.ours.wall if self.by_wall else self.theirs.cpu / self.ours.cpu

    @property
    def wall_ratio(self) -> float | None:
        return None if self.ours is None or self.theirs is None else self.theirs.wall / self.ours.wall

    @property
    def met(self) -> str:
        if self.required is None:
            return ""
        return "not run" if self.ratio is None else "yes" if self.ratio >= self.required else "NO"


def nanoseconds(seconds: float | None) -> str:
    """Three significant digits, or whole numbers above."""
    if seconds is None:
        return "-"
    x = 1e9 * seconds
    return f"{x:,.0f}" if x >= 100 else f"{x:.3g}"


def show(title: str, rows: Iterable[Row], console: Console | None = None) -> None:
    """Print a table and its notes. Times are processor time per item in nanoseconds."""
    table = Table(title=title, title_justify="left", title_style="bold", header_style="bold", box=SIMPLE_HEAD)
    right = ("ns", "ratio", "by wall", "needed", "differing")
    for name in ("case", "us", "ns", "rival", "ns", "ratio", "by wall", "needed", "met", "differing", ""):
        table.add_column(name, justify="right" if name in right else "left", no_wrap=True)
    notes: dict[str, int] = {}
    for r in rows:
        mark = f"[{notes.setdefault(r.note, len(notes) + 1)}]" if r.note else ""
        table.add_row(
            r.case,
            r.us,
            nanoseconds(r.ours and r.ours.cpu),
            r.rival,
            nanoseconds(r.theirs and r.theirs.cpu),
            "-" if r.ratio is None else f"{r.ratio:.3g}",
            "-" if r.wall_ratio is None else f"{r.wall_ratio:.3g}",
            "" if r.required is None else f"{r.required:g}",
            f"[red]{r.met}[/]" if r.met == "NO" else r.met,
            "" if r.differing is None else f"{r.differing} of {r.items}",
            escape(mark),
        )
    console = console or Console(width=max(Console().width, 160))
    console.print(table)
    for note, number in notes.items():
        console.print(f"  [{number}] {note}", markup=False, highlight=False)
    console.print()


# -- files -------------------------------------------------------------------------------------

COLUMNS = (
    "case",
    "items",
    "us",
    "us_ns_cpu",
    "us_ns_wall",
    "rival",
    "rival_ns_cpu",
    "rival_ns_wall",
    "ratio",
    "ratio_wall",
    "required",
    "met",
    "differing",
    "note",
    "commit",
    "date",
)


def write(path: Path, rows: Sequence[Row], facts: dict[str, object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(COLUMNS)
        for r in rows:
            times = [[f"{1e9 * t:.4g}" for t in (c.cpu, c.wall)] if c else ["", ""] for c in (r.ours, r.theirs)]
            ratios = ["" if x is None else f"{x:.4g}" for x in (r.ratio, r.wall_ratio)]
            rest = ["" if x is None else x for x in (r.required, r.met, r.differing, r.note)]
            writer.writerow(
                [r.case, r.items, r.us, *times[0], r.rival, *times[1], *ratios, *rest, facts["commit"], facts["date"]]
            )


def machine() -> dict[str, object]:
    """What a reader needs to judge the numbers."""
    model = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text())
        model = found.group(1) if found else model
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "compiler": _first_line([os.environ.get("CXX", "g++"), "--version"]),
        "packages": {name: version_of(name) for name in PACKAGES},
        "commit": _first_line(["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "load": [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
    }


def machine_name(facts: dict[str, object]) -> str:
    """Name of its folder under results/."""
    return re.sub(r"[^a-z0-9]+", "-", f"{facts['processor']} {facts['cores']} cores".lower()).strip("-")


def write_machine(path: Path, facts: dict[str, object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


def version_of(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _first_line(command: list[str]) -> str | None:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[0]
    except (OSError, subprocess.CalledProcessError, IndexError):
        return None


def differences(ours: np.ndarray, theirs: np.ndarray) -> int:
    return int((np.asarray(ours) != np.asarray(theirs)).sum())
