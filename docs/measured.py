"""The page of measurements: every CSV under benchmarks/results/<machine>/, as tables in Markdown."""

import csv
import json
from collections.abc import Iterable
from pathlib import Path

RESULTS = Path(__file__).parent.parent / "benchmarks" / "results"
RATIOS = RESULTS.with_name("ratios.csv")

TITLES = {
    "pairs": "Pairs, compared with Coal and python-fcl",
    "singles": "One pair per call, from Python",
    "threads": "Two threads, compared with one",
    "vertices": "Cost against the number of vertices",
    "batches": "Pairs, by size of the batch",
    "pieces": "Bodies of 500 pieces",
    "crowd": "Crowds, compared with trees of boxes",
    "robots": "Robots, compared with pinocchio and Coal",
    "robot-batches": "Robots, by size of the batch",
    "mbm-planning": "MotionBenchMaker: motions in OMPL's RRT-Connect",
    "mbm-tiers": "MotionBenchMaker: what settled a configuration",
    "mbm-validity": "MotionBenchMaker: problems whose start and goal are free",
    "reach": "Inverse kinematics, beside SciPy's least squares",
    "executed-curves": "MotionBenchMaker: curves that are executed in place of proven paths",
    "memory": "Memory of a batch",
    "fits": "Fits, compared with conic solvers",
    "accuracy": "The estimate on ambiguous pairs, by family of shapes",
}

# Whether a ratio reaches its target, as the files have it.
REACHED = {"yes": "reached", "no": "missed"}

INTRODUCTION = """# Measurements

This page is made from the files in `benchmarks/results` when the site is built. Times are for one item (a pair, a
body, a configuration), in nanoseconds of processor time. A ratio is the other library's time divided by loewner's,
from one run in which the two libraries took turns. Below 1, the other library is faster, and the row names it. A
target is a goal that loewner has set itself for a ratio. The page on [benchmarks](benchmarks.md) describes how the
comparison is kept fair, and its limits."""


RATIOS_TITLE = """## Ratios by commit

`benchmarks/ratios.py` appends a row to `benchmarks/ratios.csv` for each ratio that has a target. A load is the
average number of running processes in the minute before the run; if it is not small compared with the number of cores,
the ratio means little.
"""


def write(target: Path) -> None:
    """Write the page, unless it says the same already: Sphinx rebuilds what is new."""
    text = page(RESULTS)
    if not target.exists() or target.read_text() != text:
        target.write_text(text)


def page(results: Path) -> str:
    """All results of all machines."""
    parts = [INTRODUCTION, _ratios(RATIOS)]
    for machine in sorted(folder for folder in results.iterdir() if folder.is_dir()):
        parts.append(f"## Measured on {_name(machine)}")
        described = machine / "machine.json"
        if described.exists():
            parts.append(_machine(json.loads(described.read_text())))
        for path in sorted(machine.glob("*.csv"), key=_place):
            parts.append(_section(path))
    return "\n\n".join(parts) + "\n"


def _ratios(path: Path) -> str:
    """The latest ratio of each comparison, and the earlier ones."""
    with path.open(newline="") as stream:
        rows = sorted(csv.DictReader(stream), key=lambda row: row["date"])
    history: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        history.setdefault(tuple(row[name] for name in ("machine", "benchmark", "case", "us", "rival")), []).append(row)
    lines = [
        RATIOS_TITLE,
        _line(["case", "loewner", "compared with", "loewner's own target", "latest", "earlier"]),
        _line(["---"] * 6),
    ]
    several = len({key[0] for key in history}) > 1
    for (machine, benchmark, case, us, rival), of_one in sorted(history.items()):
        *earlier, latest = [
            f"{_cell(row['ratio'])} ({row['commit']}, {row['date'][:10]}{row['load'] and ', load ' + row['load']})"
            for row in of_one
        ]
        before = "; ".join(reversed(earlier))
        place = f"; {_name(RESULTS / machine)}" if several else ""
        told = (f"{benchmark}: {case}{place}", us, rival, _cell(of_one[-1]["required"]))
        lines.append(_line([*map(_cell, told), latest, before]))
    return "\n".join(lines)


def _place(path: Path) -> tuple[int, str]:
    """Files in the order of the titles, unknown ones last."""
    known = list(TITLES)
    return (known.index(path.stem) if path.stem in known else len(known)), path.stem


def _name(machine: Path) -> str:
    """Processor and cores, or the name of the folder."""
    try:
        facts = json.loads((machine / "machine.json").read_text())
        return f"{facts['processor']}, {facts['cores']} cores"
    except (FileNotFoundError, KeyError):
        return machine.name


def _machine(facts: dict) -> str:
    packages = ", ".join(f"{name} {number}" for name, number in facts.get("packages", {}).items())
    others = "; ".join(f"{name}: {value}" for name, value in facts.items() if name != "packages")
    return f"{others}; {packages}."


def _section(path: Path) -> str:
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    title = f"### {TITLES.get(path.stem, path.stem)}"
    if not rows:
        return f"{title}\n\nNothing was measured."
    shown = [_comparison(row) for row in rows] if "rival" in rows[0] else rows
    header = [name.replace("_", " ") for name in shown[0]]
    lines = [title, "", _line(header), _line(["---"] * len(header))]
    lines += [_line(_cell(text) for text in row.values()) for row in shown]
    if "commit" in rows[0]:
        origin = sorted({f"commit {row['commit']} ({row['date']})" for row in rows})
        lines += ["", f"From {', '.join(origin)}."]
    return "\n".join(lines)


def _comparison(row: dict[str, str]) -> dict[str, str]:
    """One line of loewner and of another library, without the columns that only programs need."""
    return {
        "case": row["case"],
        "items": row["items"],
        "loewner": f"{row['us']}: {_cell(row['us_ns_cpu'])} ns" if row["us_ns_cpu"] else row["us"],
        "compared with": f"{row['rival']}: {_cell(row['rival_ns_cpu'])} ns" if row["rival_ns_cpu"] else row["rival"],
        "ratio": f"{_cell(row['ratio'])}: {row['rival']} is faster" if _below_one(row["ratio"]) else row["ratio"],
        "by wall time": row["ratio_wall"],
        "loewner's own target": f"{_cell(row['required'])}: {REACHED[row['met'].lower()]}" if row["required"] else "",
        "answers that differ": row["differing"],
        "note": row["note"],
    }


def _below_one(ratio: str) -> bool:
    return bool(ratio) and float(ratio) < 1


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(text: str) -> str:
    """Plain text in a table; numbers in their usual form."""
    try:
        number = float(text)
    except ValueError:
        return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*").replace("_", "\\_")
    return f"{number:,.0f}" if abs(number) >= 1000 or number == int(number) else f"{number:.3g}"
