"""The paper's experiment: its data set, four detectors, tables and figures.

`run` does it all and returns an `Experiment`; `tables.rows` gives its tables as text. The modules read in
the paper's order: `dataset`, `detectors`, `experiment`, `tables`, `figures`, `report`.
"""

from loewner.paper import tables
from loewner.paper.dataset import DataSet, sample
from loewner.paper.detectors import Answers, Confusion, Pairs, detect, estimate
from loewner.paper.experiment import Experiment, Result, run

__all__ = [
    "Answers",
    "Confusion",
    "DataSet",
    "Experiment",
    "Pairs",
    "Result",
    "detect",
    "estimate",
    "run",
    "sample",
    "tables",
]
