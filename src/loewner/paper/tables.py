"""Make tables 1 to 4, (a) and (b), next to the paper's own numbers, and test whether the numbers are consistent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from loewner._base import _validate
from loewner._base._proportions import wilson
from loewner.paper.detectors import Confusion
from loewner.paper.results import Experiment, Result

# The paper's numbers by table; a table has the number of its detector. Part (a) is about all pairs, and part (b) about
# ambiguous pairs. The last two numbers are the milliseconds per check for (a) and (b), which are in the table's caption
# (Pentium 4 at 1.8 GHz, MATLAB 6.5). A matrix is read row by row: tp is cell (1,1), fp (1,2), fn (2,1), tn (2,2).
PAPER = {
    1: (Confusion(375, 32, 167, 426), Confusion(50, 32, 5, 150), 100.0, 146.0),
    2: (Confusion(515, 23, 27, 435), Confusion(134, 23, 24, 136), 46.0, 75.0),
    3: (Confusion(524, 28, 18, 430), Confusion(128, 28, 18, 160), 10.0, 19.0),
    4: (Confusion(515, 23, 27, 435), Confusion(134, 23, 24, 136), 10.0, 15.0),
}
PAPER_PAIRS = PAPER[1][0].total
PAPER_COLLIDING = PAPER[1][0].tp + PAPER[1][0].fn  # equal in all four tables

# The four exact classes of pairs: the inner ellipsoids overlap; ambiguous and colliding; ambiguous and free; the outer
# ellipsoids are apart. CLASS_SOURCES lists the cells of Table 3 from which the paper's count of each class is computed.
CLASSES = ("inner overlap", "ambiguous, colliding", "ambiguous, free", "outer apart")
CLASS_SOURCES = ("(a) (1,1) - (b) (1,1)", "(b) (1,1) + (2,1)", "(b) (1,2) + (2,2)", "(a) (2,2) - (b) (2,2)")
_ALL, _HARD = PAPER[3][:2]
PAPER_CLASSES = (_ALL.tp - _HARD.tp, _HARD.tp + _HARD.fn, _HARD.fp + _HARD.tn, _ALL.tn - _HARD.tn)

CELLS = ("true collision", "false collision", "missed collision", "true free")
SIGNIFICANCE = 0.01  # with a smaller p-value, the numbers count as different


@dataclass(frozen=True)
class Cell:
    """One cell of a confusion matrix.

    Attributes
    ----------
    name : str
    count : int
    share, low, high : float
        Share of the table's total, and the ends of the share's 95 % Wilson interval.
    paper_count : int or None
    paper_share : float
    """

    name: str
    count: int
    share: float
    low: float
    high: float
    paper_count: int | None
    paper_share: float


@dataclass(frozen=True)
class Table:
    """One printed table.

    Attributes
    ----------
    title : str
        "Table 1 (a)", or "Estimate (a)" for the library's own rule, which is not in the paper.
    detector : str
    cells : tuple of Cell
        tp, fp, fn, tn.
    accuracy : float
        Share of answers that are right.
    p_value : float
        The p-value of a chi-square test of homogeneity, for the hypothesis that these counts and the paper's come from
        one distribution.
    statement : str
        The p-value in words.
    microseconds : float
        Time per check on this machine.
    paper_milliseconds : float
    """

    title: str
    detector: str
    cells: tuple[Cell, ...]
    accuracy: float
    p_value: float
    statement: str
    microseconds: float
    paper_milliseconds: float


def homogeneity(counts: Sequence[int], others: Sequence[int]) -> float:
    """Compute the p-value of Pearson's test that two rows of counts have one distribution; NaN for an empty row."""
    table = np.array([counts, others], dtype=float)
    table = table[:, table.sum(axis=0) > 0]
    rows, columns = table.sum(axis=1), table.sum(axis=0)
    if (rows == 0).any():
        return math.nan
    if len(columns) == 1:
        return 1.0
    expected = np.outer(rows, columns) / rows.sum()
    return float(chdtrc(len(columns) - 1, ((table - expected) ** 2 / expected).sum()))


def tables(experiment: Experiment) -> tuple[Table, ...]:
    """Make all tables: 1 (a), 1 (b) ... 4 (b), then (a) and (b) for the library's estimate."""
    _validate.instance(experiment, "experiment", Experiment, "loewner.paper")
    results, fourth = (*experiment.detectors, experiment.estimate), experiment.detectors[3]
    return tuple(_table(result, part, fourth) for result in results for part in (0, 1))


def classes(experiment: Experiment) -> tuple[tuple[int, ...], float]:
    """Count the four exact classes of the pairs, and compute the p-value against the counts implied by Table 3.

    Returns
    -------
    counts : tuple of int
        Counts in the order of `CLASSES`. The checks of the estimate, which are exact, determine the classes.
    p_value : float
    """
    _validate.instance(experiment, "experiment", Experiment, "loewner.paper")
    hard, truth = experiment.estimate.answers.ambiguous, experiment.truth
    inner = experiment.estimate.answers.collides & ~hard
    counts = tuple(int(c.sum()) for c in (inner, hard & truth, hard & ~truth, ~hard & ~inner))
    return counts, homogeneity(counts, PAPER_CLASSES)


def errors_outside(every: Confusion, ambiguous: Confusion) -> tuple[int, int]:
    """Count missed collisions and false alarms among the pairs that a detector's overlap checks decided.

    Parameters
    ----------
    every, ambiguous : Confusion
        Parts (a) and (b) of one table.

    Examples
    --------
    The three errors mentioned in section 5 of the paper:

    >>> from loewner.paper import tables
    >>> tables.errors_outside(*tables.PAPER[2][:2])
    (3, 0)
    """
    return every.fn - ambiguous.fn, every.fp - ambiguous.fp


COLUMNS = ("table", "detector", *CELLS, "right", "consistent with the paper", "us per check", "paper, ms")


def rows(experiment: Experiment) -> list[tuple[str, ...]]:
    """Format rows of text under `COLUMNS`: each cell's share, its 95 % interval and the paper's share, in percent."""
    return [
        (
            table.title,
            table.detector,
            *(_cell_text(cell) for cell in table.cells),
            percent(table.accuracy),
            table.statement,
            number(table.microseconds),
            number(table.paper_milliseconds),
        )
        for table in tables(experiment)
    ]


def percent(share: float) -> str:
    """Format a share in percent with one decimal, or as a dash."""
    return "-" if math.isnan(share) else f"{100 * share:.1f}"


def number(x: float) -> str:
    """Format a number with three digits, or as a dash."""
    return "-" if math.isnan(x) else f"{x:.3g}"


def _cell_text(cell: Cell) -> str:
    text = f"{percent(cell.share)} [{percent(cell.low)}, {percent(cell.high)}]"
    return text if cell.paper_count is None else f"{text} / {percent(cell.paper_share)}"


def _table(result: Result, part: int, fourth: Result) -> Table:
    """Make part 0, that is (a), or part 1, that is (b), of the table of a detector or of the estimate."""
    own, printed = result.parts[part], PAPER.get(result.id)
    paper, milliseconds = (None, math.nan) if printed is None else (printed[:2][part], printed[2:][part])
    cells = []
    for k, (name, count) in enumerate(zip(CELLS, own.counts, strict=True)):
        share = count / own.total if own.total else math.nan
        theirs = (None, math.nan) if paper is None else (paper.counts[k], paper.counts[k] / paper.total)
        cells.append(Cell(name, count, share, *wilson(count, own.total), *theirs))
    p = math.nan if paper is None else homogeneity(own.counts, paper.counts)
    text = statement(p)
    if paper is not None and result.id == 2:
        # The paper printed detector 4's numbers here (docs/design/paper.md), so compare with those results as well.
        text += f"; printed is detector 4: {statement(homogeneity(fourth.parts[part].counts, paper.counts))}"
    title = f"{f'Table {result.id}' if result.id else 'Estimate'} ({'ab'[part]})"
    microseconds = (result.microseconds, result.ambiguous_microseconds)[part]
    return Table(title, result.label, tuple(cells), own.accuracy, p, text, microseconds, milliseconds)


def statement(p: float) -> str:
    """State in words whether two rows of counts are consistent with one distribution, given their p-value."""
    if math.isnan(p):
        return "-"
    verdict = "yes" if p >= SIGNIFICANCE else "no"
    return f"{verdict} (p = {p:.2g})"
