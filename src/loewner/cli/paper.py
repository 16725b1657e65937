"""``loewner paper``: the paper's experiment, its tables."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loewner.cli import inputs
from loewner.cli.output import new_table, print_table, progress_bar

if TYPE_CHECKING:
    from loewner import paper

EXAMPLES = """examples:
  loewner paper                                      the paper's 1,000 pairs
  loewner paper --pairs 100000 --out report --json counts.json
"""


def add(commands: Any) -> None:
    """Add the command."""
    paper = inputs.command(commands, "paper", "the paper's experiment, its tables", EXAMPLES)
    paper.add_argument("--pairs", type=int, default=1000, help="1000")
    paper.add_argument("--seed", type=int, default=0, help="0")
    paper.add_argument("--dataset", default="radius", help="radius (the paper's) or volume")
    paper.add_argument("--out", type=Path, metavar="DIR", help="folder for the report and figures")
    paper.add_argument("--json", type=Path, metavar="FILE", help="file for the counts")
    paper.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from loewner import paper

    with progress_bar() as progress:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=total)
            progress.update(tasks[stage], completed=done, total=total)

        found = paper.run(
            options.pairs, options.seed, options.dataset, out=options.out, json=options.json, progress=report
        )
    title = f"{len(found):,} pairs, {int(found.truth.sum()):,} colliding; in percent, +- 95 % / the paper"
    table = new_table("table", "detector", *paper.tables.CELLS, "right", "as the paper", "us", title=title)
    for row in paper.tables.tables(found):
        cells = (_cell_text(cell) for cell in row.cells)
        number, right = paper.tables.number(row.microseconds), paper.tables.percent(row.accuracy)
        table.add_row(row.title, row.detector, *cells, right, row.statement, number)
    print_table(table)
    for name, path in (("report", options.out), ("counts", options.json)):
        if path is not None:
            print(f"{name}: {path}")
    return 0


def _cell_text(cell: paper.tables.Cell) -> str:
    own = f"{100 * cell.share:.1f} +-{50 * (cell.high - cell.low):.1f}"
    return own if cell.paper_count is None else f"{own} / {100 * cell.paper_share:.1f}"
