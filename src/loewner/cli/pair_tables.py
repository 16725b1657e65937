"""Print which pairs of bodies can ever collide."""

from __future__ import annotations

import numpy as np

import loewner
from loewner.cli.output import counted, print_table
from loewner.robots.description.pair_verdicts import PairVerdict, ProvenPair, ProvenPairs

# Verdicts in the order in which they are printed.
ORDER = (PairVerdict.SOMETIMES, PairVerdict.CAN, PairVerdict.OPEN, PairVerdict.ALWAYS, PairVerdict.NEVER)


def print_pairs(found: ProvenPairs, robot: loewner.Robot) -> None:
    """Print a line for each verdict, and a table of pairs, in which pairs that can collide come first."""
    for verdict in ORDER:
        those = found.with_verdict(verdict)
        if those:
            print(f"{verdict:<9}  {counted(len(those), 'pair')}")
    rows = list[tuple[str, ...]]()
    for row in sorted(found, key=lambda row: (ORDER.index(row.verdict), row.distance)):
        nearest = "" if np.isnan(row.distance) else f"{1e3 * row.distance:.3f} mm"
        over = (", ".join(row.columns) or "no joint") if row.complete else row.range_text
        over += row.reason and f": {row.reason}"
        rows.append((*row.names, str(row.verdict), nearest, _at(row, robot), over))
    if rows:
        print_table(("body", "other body", "verdict", "least distance", "at", "over"), rows)
    if found.rigid:
        print(f"note: on one rigid part, and never checked: {'; '.join(' and '.join(pair) for pair in found.rigid)}")


def _at(row: ProvenPair, robot: loewner.Robot) -> str:
    """Format the values of the joints between the bodies at the least distance."""
    if row.nearest is None:
        return ""
    values = dict(zip(robot.configuration_names, row.nearest.tolist(), strict=True))
    return ", ".join(f"{name} {values[name]:.4f}" for name in row.columns)
