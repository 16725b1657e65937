"""Format the tables as text, at most 80 columns wide, with our numbers next to the paper's.

Numbers from the paper are shown with the table and the cells that they come from. All other numbers are counted or
measured in this run.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from loewner.ellipsoids.fits import DEFAULT_TOLERANCE
from loewner.paper import tables
from loewner.paper.detectors import Confusion
from loewner.paper.fitting import MOST_POLYHEDRA
from loewner.paper.results import Experiment, Result
from loewner.paper.tables import PAPER, PAPER_PAIRS, SIGNIFICANCE, Table, number, percent, statement

SAID = ("collision", "free")  # rows of a confusion matrix
ESTIMATE = (
    "Collision where the contact functions F of the inner ellipsoids and of the outer ones have a product of at most 1."
)
NUMBER = re.compile(r"-|[\d.,]+(e[+-]\d+)?( [\[(].*[\])])?")  # a number, with the next cell in brackets


@dataclass(frozen=True)
class Sheet:
    """A table as text.

    Attributes
    ----------
    title : str
    head : tuple of str
    rows : tuple of tuple of str
    note : str
        Explanation of the table, including the place in the paper from which its numbers are quoted.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Return which columns contain numbers; such columns are right-aligned."""
        return tuple(all(NUMBER.fullmatch(cell) for cell in column) for column in zip(*self.rows, strict=True))

    @property
    def aligned(self) -> tuple[tuple[str, ...], ...]:
        """Pad the cells of each column, its header included, to the same width."""
        padded = []
        for column, right in zip(zip(self.head, *self.rows, strict=True), self.numeric, strict=True):
            width = max(map(len, column))
            padded.append([cell.rjust(width) if right else cell.ljust(width) for cell in column])
        return tuple(zip(*padded, strict=True))


def pairs(experiment: Experiment) -> Sheet:
    """Tabulate the four exact classes of the pairs."""
    counts, p_value = tables.classes(experiment)
    rows = [
        (name, *_counted(count, len(experiment)), *_counted(printed, PAPER_PAIRS), source)
        for name, count, printed, source in zip(
            tables.CLASSES, counts, tables.PAPER_CLASSES, tables.CLASS_SOURCES, strict=True
        )
    ]
    return Sheet(
        "The pairs, by exact overlap of their ellipsoids",
        ("class", "pairs", "%", "paper", "%", "paper's cells"),
        tuple(rows),
        "The paper prints no classes; its numbers are computed from the named cells of its Table 3. "
        f"Consistent with ours: {statement(p_value)}.",
    )


def counts(experiment: Experiment) -> tuple[Sheet, ...]:
    """Tabulate the confusion matrices (a) and (b) of each detector, next to the paper's, and of the estimate."""
    all_tables = tables.tables(experiment)
    return tuple(_matrices(whole, part) for whole, part in zip(all_tables[::2], all_tables[1::2], strict=True))


def shares(experiment: Experiment) -> tuple[Sheet, ...]:
    """Tabulate the counts in percent, with the confidence interval of each share."""
    all_tables = tables.tables(experiment)
    return tuple(_shares(whole, part) for whole, part in zip(all_tables[::2], all_tables[1::2], strict=True))


def right(experiment: Experiment) -> Sheet:
    """Tabulate how often each detector is right, and whether its counts are consistent with the paper's."""
    rows = []
    for result in (*experiment.detectors, experiment.estimate):
        printed = PAPER[result.id][:2] if result.id in PAPER else (None, None)
        # The paper printed detector 4's numbers in Table 2 (docs/design/paper.md), so compare with both detectors.
        compared = (result, experiment.detectors[3]) if result.id == 2 else (result,)
        for part, letter in enumerate(("(a)", "(b)")):
            table = f"{result.id} {letter}" if result.id else letter
            rows += [_right(table, own, part, printed[part]) for own in compared]
    return Sheet(
        "Right answers in percent, and are the counts consistent with the paper's?",
        ("table", "detector", "right", "paper", "consistent"),
        tuple(rows),
        "The paper's: cells (1,1) + (2,2) of the table named. Table 2 appears twice, since the paper printed detector "
        "4's numbers there. Consistent: Pearson's chi-square test finds no difference at the level "
        f"{SIGNIFICANCE:g}; the fewer the pairs, the less it can find.",
    )


def outside(experiment: Experiment) -> Sheet:
    """Tabulate errors among the pairs that a detector's overlap checks decided; there should be none."""
    rows = []
    for result in (*experiment.detectors, experiment.estimate):
        own = tables.errors_outside(*result.parts)
        printed = tables.errors_outside(*PAPER[result.id][:2]) if result.id in PAPER else ("-", "-")
        missed, false = zip(own, printed, strict=True)
        rows.append((result.label, *map(str, (*missed, *false))))
    return Sheet(
        f"Errors outside the ambiguous pairs, of {len(experiment):,} (the paper: of {PAPER_PAIRS:,})",
        ("detector", "missed", "paper", "false", "paper"),
        tuple(rows),
        "Counts. Collisions missed and false alarms among the pairs that a detector's own overlap checks decided. The "
        "paper's: cells (2,1) and (1,2) of Tables 1 to 4 (a), less those of (b). Its section 5 attributes the three of "
        "Table 2 to the finite precision of the overlap check, and those of Table 1 to a wrong check of the outer "
        "ellipsoids.",
    )


def times(experiment: Experiment) -> Sheet:
    """Tabulate the time of a check."""
    rows = []
    for result in experiment.detectors:
        own = (result.microseconds, result.ambiguous_microseconds)
        rows.append((result.label, *map(number, (*own, *PAPER[result.id][2:]))))
    return Sheet(
        "Time of a check: microseconds here, milliseconds in the paper",
        ("detector", "us (a)", "us (b)", "ms (a)", "ms (b)"),
        tuple(rows),
        "(a) over all pairs, (b) over the ambiguous ones; here one thread, compiled. The paper's: captions of Tables 1 "
        "to 4, MATLAB on a Pentium 4 at 1.8 GHz.",
    )


def fits(experiment: Experiment) -> Sheet:
    """Tabulate the reliability of the fits."""
    rows = [
        (f.name, f"{f.tried:,}", f"{f.failed:,}", _gap(f.largest_gap), number(f.microseconds))
        for f in experiment.fittings
    ]
    gaps = [bodies.gaps.max(axis=0) for bodies in (experiment.bodies_1, experiment.bodies_2)]
    inner, outer = (max(side) for side in zip(*gaps, strict=True))
    return Sheet(
        "How reliable the fits are",
        ("fit", "polyhedra", "failed", "largest gap", "us each"),
        tuple(rows),
        f"Each polyhedron (at most the first {MOST_POLYHEDRA:,}) fitted on its own, one thread. Failed: no ellipsoid "
        f"certified to be within {DEFAULT_TOLERANCE:g} of the best in log-volume (the paper's section 5: e^-0.0001 of "
        "the volume). Largest gap: certified, in log-volume. Time: that of mvie includes finding the faces. The fits "
        "that the detectors used are made in one batch, where a failure would have ended the run; their largest gaps "
        f"are {_gap(inner)} (inner) and {_gap(outer)} (outer). The paper prints no numbers about its fits.",
    )


def in_order(experiment: Experiment) -> tuple[Sheet, ...]:
    """Return the tables that the terminal shows: all except the confidence intervals."""
    return pairs(experiment), *counts(experiment), *(sheet(experiment) for sheet in (right, outside, times, fits))


# -- rows ------------------------------------------------------------------------------------------


def _head(table: Table) -> tuple[str, str, bool]:
    """Return the subject of a table, as a title and as the head of a column, and whether the paper has the table."""
    if table.cells[0].paper_count is None:
        return f"{table.detector} (not in the paper)", "estimate", False
    return f"detector {table.detector}", f"detector {table.detector.partition(':')[0]}", True


def _counted(count: int, total: int) -> tuple[str, str]:
    return str(count), percent(count / total if total else math.nan)


def _matrices(whole: Table, part: Table) -> Sheet:
    title, head, printed = _head(whole)
    rows = []
    for letter, table in (("(a)", whole), ("(b)", part)):
        own = [f"{cell.count} ({percent(cell.share)})" for cell in table.cells]
        paper = [f"{cell.paper_count} ({percent(cell.paper_share)})" for cell in table.cells] if printed else []
        for k, said in enumerate(SAID):
            line = slice(2 * k, 2 * k + 2)
            rows.append((f"{letter} {said}", *own[line], *paper[line]))
    source = f"The paper's: the same cells of its {whole.title[:-4]}." if printed else ESTIMATE
    if head == "detector 2":
        source += " They are detector 4's, which the paper printed here as well."
    return Sheet(
        f"{whole.title} and {part.title}, {title}",
        (head, "collide", "free", *(("paper: collide", "paper: free") if printed else ())),
        tuple(rows),
        "(a) counts all pairs, (b) those that this detector's own overlap checks leave open. Rows: what the detector "
        f"says; columns: the truth. In brackets: percent. {source}",
    )


def _shares(whole: Table, part: Table) -> Sheet:
    title, head, printed = _head(whole)
    rows = []
    for k, name in enumerate(tables.CELLS):
        cells = (whole.cells[k], part.cells[k])
        texts = [(f"{percent(c.share)} [{percent(c.low)}, {percent(c.high)}]", percent(c.paper_share)) for c in cells]
        rows.append((name, *(text for own, paper in texts for text in ((own, paper) if printed else (own,)))))
    heads = ("(a)", "paper", "(b)", "paper") if printed else ("(a)", "(b)")
    return Sheet(f"In percent, with 95 % intervals: {title}", (head, *heads), tuple(rows), "")


def _right(table: str, result: Result, part: int, paper: Confusion | None) -> tuple[str, ...]:
    own = result.parts[part]
    if paper is None:
        return table, result.label, percent(own.accuracy), "-", "-"
    consistent = statement(tables.homogeneity(own.counts, paper.counts))
    return table, result.label, percent(own.accuracy), percent(paper.accuracy), consistent


def _gap(gap: float) -> str:
    return "-" if math.isnan(gap) else f"{gap:.1e}"


def colliding(experiment: Experiment) -> str:
    """Describe the number of colliding pairs, next to the paper's."""
    own, total, printed = int(experiment.truth.sum()), len(experiment), tables.PAPER_COLLIDING
    return (
        f"{own:,} of {total:,} pairs collide, {percent(own / total)} % (the paper: {printed} of {PAPER_PAIRS:,}, "
        f"{percent(printed / PAPER_PAIRS)} %; Table 1 (a), cells (1,1) + (2,1))"
    )
