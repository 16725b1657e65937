"""Benchmarks beside rival libraries, in one run.

    python benchmarks/run.py [--quick] [--only NAME ...] [--out FOLDER]

Each benchmark prints a table: ours, the rival's, their ratio, and the ratio asked for where one is. Times are processor
time per item, best of several rounds in which all take turns. A full run writes CSV and figures to
benchmarks/results/<machine>/; a quick one only shows that everything works and writes to FOLDER.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import crowd
import figures
import growth
import memory
import motions
import pairs
import pieces
import report
import robots
import singles
import threads
from clock import threads_set_to

HERE = Path(__file__).parent
# Name, what it says, what it runs.
BENCHMARKS = {
    "pairs": ("pairs in one batch, one thread", pairs.run),
    "singles": ("one pair per call", singles.run),
    "threads": ("two threads", threads.run),
    "vertices": ("cost against the number of vertices, one thread", growth.vertices),
    "batches": ("cost against the size of the batch, one thread", growth.batches),
    "pieces": ("two bodies of many pieces, one thread", pieces.run),
    "crowd": ("all overlapping pairs among many ellipsoids, one thread", crowd.run),
    "robots": ("robots in scenes, per configuration, one thread", robots.run),
    "motions": ("motions proven free, beside samples, per motion, one thread", motions.run),
    "robot-batches": ("cost of a configuration against the size of the batch, one thread", robots.batches),
}
FIGURES = {"vertices": figures.vertices, "batches": figures.batches, "robot-batches": figures.robot_batches}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, measures little")
    parser.add_argument("--only", nargs="+", choices=[*BENCHMARKS, "memory"], help="run these alone")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"), help="folder for what a quick run writes")
    parser.add_argument("--build", type=Path, default=HERE.parent / "build" / "benchmarks", help="folder for coal_loop")
    options = parser.parse_args(arguments)

    facts = report.machine()
    results = options.out if options.quick else HERE / "results" / report.machine_name(facts)
    for name, value in facts.items():
        print(f"{name:10} {value}")
    print(flush=True)
    asked: list[report.Row] = []
    with threads_set_to(1):
        for name, (title, run) in BENCHMARKS.items():
            if options.only and name not in options.only:
                continue
            rows = run(options.quick, options.build)
            report.show(f"{name}: {title}", rows)
            report.write(results / f"{name}.csv", rows, facts)
            if name in FIGURES:
                FIGURES[name](rows, results / f"{name}.svg")
            asked += [r for r in rows if r.required is not None]
        if not options.only or "memory" in options.only:
            write_memory(memory.run(options.quick, options.build), results / "memory.csv")
    report.write_machine(results / "machine.json", facts)
    if asked:
        print(f"Ratios asked for: {len(asked)}, reached: {sum(r.met == 'yes' for r in asked)}")
    for r in asked:
        print(f"  {r.met:8}{r.case}, {r.us} beside {r.rival}: {r.ratio or float('nan'):.3g} of {r.required:g}")
    return 0


def write_memory(found: list[memory.Held], path: Path) -> None:
    print("memory: peak bytes per pair of a batch, results included")
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(["query", "pairs", "traced_bytes", "resident_bytes"])
        for h in found:
            resident = "" if h.resident is None else f"{h.resident:.1f}"
            writer.writerow([h.query, h.pairs, f"{h.traced:.1f}", resident])
            print(f"  {h.query:18}{h.traced:9.1f} (NumPy's)   {resident or '-':>9} (resident)   {h.pairs} pairs")
    print()


if __name__ == "__main__":
    sys.exit(main())
