"""Repeat the paper's experiment: data set, detectors, tables and figures, and the paper's methods for comparison.

`run` performs the experiment and returns an `Experiment`; `tables.rows` formats its tables as text. The modules follow
the paper's order: `dataset`, `fitting`, `detectors`, `results`, `tables`, `sheets`, `figures`, `report`, `experiment`.
The methods of the library itself differ from the paper's. For comparison, the paper's methods are in `estimates` (f,
section 4), `overlap` (appendix A) and `lifted_mvie` (appendix B).
"""

from loewner.paper import tables
from loewner.paper.dataset import DataSet, sample
from loewner.paper.detectors import Answers, Confusion, Pairs, detect, estimate
from loewner.paper.estimates import distance_estimate
from loewner.paper.experiment import run
from loewner.paper.fitting import Fitting
from loewner.paper.lifted_mvie import mvce_by_lifted_mvie
from loewner.paper.overlap import overlap_by_eigenvalue
from loewner.paper.results import Experiment, Result

__all__ = [
    "Answers",
    "Confusion",
    "DataSet",
    "Experiment",
    "Fitting",
    "Pairs",
    "Result",
    "detect",
    "distance_estimate",
    "estimate",
    "mvce_by_lifted_mvie",
    "overlap_by_eigenvalue",
    "run",
    "sample",
    "tables",
]
