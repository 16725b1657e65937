"""``loewner paper``: print the tables of the paper's experiment."""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path
from typing import Any

from loewner._base._files import shown
from loewner.cli import inputs
from loewner.cli.output import print_table, progress_bar

TEXT_COLUMNS = 80  # width of the text, and largest width of a table

EXAMPLES = """examples:
  loewner paper                                      the paper's 1,000 pairs
  loewner paper --pairs 100000 --out report --json counts.json
"""


def add(commands: Any) -> None:
    """Add the command."""
    paper = inputs.command(commands, "paper", "the tables of the paper's experiment", EXAMPLES, _run)
    paper.add_argument("--pairs", type=int, default=1000, help="1000")
    paper.add_argument("--seed", type=int, default=0, help="0")
    paper.add_argument("--dataset", default="radius", help="radius (the paper's) or volume")
    paper.add_argument("--out", type=Path, metavar="DIR", help="folder for the report and figures")
    paper.add_argument("--json", type=Path, metavar="FILE", help="file for the counts")
    paper.set_defaults(makes_folder=True)


def _run(options: argparse.Namespace) -> int:
    from loewner import paper
    from loewner.paper import sheets

    with progress_bar() as progress:
        tasks: dict[str, Any] = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=total)
            progress.update(tasks[stage], completed=done, total=total)

        experiment = paper.run(
            options.pairs, options.seed, options.dataset, out=options.out, json=options.json, progress=report
        )
    print(_wrapped(f"{sheets.colliding(experiment)}."))
    for sheet in sheets.in_order(experiment):
        print(f"\n{sheet.title}")
        head, *rows = sheet.aligned
        print_table(head, rows)
        print(_wrapped(sheet.note))
    for name, path in (("report", options.out), ("counts", options.json)):
        if path is not None:
            print(f"{name}: {shown(path)}")
    return 0


def _wrapped(text: str) -> str:
    return textwrap.fill(text, TEXT_COLUMNS, break_on_hyphens=False)
