"""Ratios to other libraries, kept per commit: one row in ratios.csv for each ratio that has a target.

    python benchmarks/ratios.py                    run some benchmarks of run.py, and append their ratios
    python benchmarks/ratios.py --only robots      run these alone
    python benchmarks/ratios.py --read FOLDER      append the ratios in the CSV files of an earlier run instead

The column `load` is the average number of running processes in the minute before the benchmarks. If it is not small
beside the number of cores, the ratios say little. Rows are appended only; a row that the file has already is left out.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
from pathlib import Path

import report
import run
from clock import threads_set_to

HERE = Path(__file__).parent
KEPT = HERE / "ratios.csv"
COLUMNS = ("commit", "date", "machine", "load", "benchmark", "case", "us", "rival", "ratio", "required")
USUAL = ("pairs", "crowd", "robots", "motions")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--only", nargs="+", choices=list(run.BENCHMARKS), default=USUAL, help="run these alone")
    which.add_argument("--read", type=Path, metavar="FOLDER", help="read benchmarks/results/MACHINE instead")
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument("--build", type=Path, default=HERE.parent / "build" / "benchmarks", help="folder for coal_loop")
    parser.add_argument("--out", type=Path, default=KEPT, metavar="FILE", help="the file to append to")
    options = parser.parse_args(arguments)
    if options.read is not None:
        found = recorded(options.read, machine=options.read.name, load="")
    else:
        found = measured(options.only, options.quick, options.build)
    print(f"{append(options.out, found)} of {len(found)} ratios are new in {options.out}")
    return 0


def measured(names: tuple[str, ...], quick: bool, build: Path) -> list[dict[str, str]]:
    """Run benchmarks, and return their ratios."""
    facts = report.machine()
    load = f"{os.getloadavg()[0]:.1f} on {facts['cores']} cores" if hasattr(os, "getloadavg") else ""
    with tempfile.TemporaryDirectory() as folder, threads_set_to(1):
        for name in names:
            title, measure = run.BENCHMARKS[name]
            rows = measure(quick, build)
            report.show(f"{name}: {title}", rows)
            report.write(Path(folder, f"{name}.csv"), rows, facts)
        return recorded(Path(folder), machine=report.machine_name(facts), load=load)


def recorded(folder: Path, *, machine: str, load: str) -> list[dict[str, str]]:
    """Read the ratios with a target from the CSV files of a run; the smallest one if a rival ran in several ways."""
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for path in sorted(folder.glob("*.csv")):
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                if row.get("required") and row.get("ratio"):
                    told = row | {"benchmark": path.stem, "machine": machine, "load": load}
                    kept = {name: told[name] for name in COLUMNS}
                    same = found.setdefault((path.stem, row["case"], row["us"], row["rival"]), kept)
                    if float(kept["ratio"]) < float(same["ratio"]):
                        same.update(kept)
    return list(found.values())


def append(path: Path, rows: list[dict[str, str]]) -> int:
    """Append the rows that a file does not have yet; return their number."""
    known = [*csv.DictReader(path.read_text(encoding="utf-8").splitlines())] if path.exists() else []
    fresh = [row for row in rows if row not in known]
    with path.open("a", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        if not known:
            writer.writeheader()
        writer.writerows(fresh)
    return len(fresh)


if __name__ == "__main__":
    sys.exit(main())
