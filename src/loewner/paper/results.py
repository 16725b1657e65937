"""Hold the results of the experiment, and convert them to the form that is written to JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from loewner._base._validate import Bools
from loewner.bodies import Bodies
from loewner.paper.dataset import DataSet
from loewner.paper.detectors import Answers, Confusion, Pairs
from loewner.paper.fitting import Fitting


@dataclass(frozen=True)
class Result:
    """One detector's results over all pairs.

    Attributes
    ----------
    id : int
        Number of the detector, from 1 to 4 as in the paper; 0 for the library's own estimate.
    name : str
    answers : Answers
    all, ambiguous : Confusion
        Counts over all pairs, and counts over the pairs that are ambiguous for this detector.
    microseconds, ambiguous_microseconds : float
        Average time of one check on one thread, over all pairs and over the ambiguous pairs; NaN if the time was not
        measured, or no pair is ambiguous.

    Examples
    --------
    >>> from loewner import paper
    >>> result = paper.run(50).detectors[2]
    >>> result.id, result.name, result.all.total
    (3, 'level-surface near points', 50)
    """

    id: int
    name: str
    answers: Answers
    all: Confusion
    ambiguous: Confusion
    microseconds: float = float("nan")
    ambiguous_microseconds: float = float("nan")

    @property
    def parts(self) -> tuple[Confusion, Confusion]:
        """The counts for part (a) of a table, over all pairs, and for part (b), over the ambiguous pairs."""
        return self.all, self.ambiguous

    @property
    def label(self) -> str:
        """The name, preceded by the detector's number if there is one."""
        return f"{self.id}: {self.name}" if self.id else self.name


@dataclass(frozen=True)
class Experiment:
    """The results of `run`.

    Attributes
    ----------
    data : DataSet
    bodies_1, bodies_2 : Bodies
        Hulls and fits of the pairs.
    pairs : Pairs
        The pairs, in the form that the detectors take.
    truth : ndarray of bool, shape (pairs,)
        Exact answers.
    detectors : tuple of Result
        Detectors 1 to 4.
    estimate : Result
        Results of the rule F_in F_out <= 1; a pair is ambiguous if its outer ellipsoids overlap but its inner
        ellipsoids do not.
    fittings : tuple of Fitting
        Reliability of each kind of fit, measured on at most the first 2000 polyhedra.

    Examples
    --------
    >>> from loewner import paper
    >>> found = paper.run(50)
    >>> len(found), len(found.detectors), found.estimate.all.total
    (50, 4, 50)
    """

    data: DataSet
    bodies_1: Bodies
    bodies_2: Bodies
    pairs: Pairs
    truth: Bools
    detectors: tuple[Result, ...]
    estimate: Result
    fittings: tuple[Fitting, ...] = ()

    def __len__(self) -> int:
        return len(self.truth)

    def as_dict(self) -> dict[str, Any]:
        """Return counts and times (in microseconds) as plain numbers, in the form that is written to JSON.

        Returns
        -------
        dict
        """
        return {
            "pairs": len(self),
            "seed": self.data.seed,
            "dataset": self.data.name,
            "truth": {"colliding": int(self.truth.sum())},
            "detectors": [
                {
                    "id": result.id,
                    "all": asdict(result.all),
                    "ambiguous": asdict(result.ambiguous),
                    "microseconds_per_check": result.microseconds,
                }
                for result in self.detectors
            ],
            "estimate": {"all": asdict(self.estimate.all), "ambiguous": asdict(self.estimate.ambiguous)},
        }
