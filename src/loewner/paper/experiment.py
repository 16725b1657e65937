"""Run the experiment of section 5: the data set, the exact answers, four detectors and the library's estimate."""

from __future__ import annotations

import json as _json
import os
from collections.abc import Callable
from functools import partial

import numpy as np

from loewner._base import _validate
from loewner._base._files import folder_exists, write_atomically
from loewner._base._validate import Bools
from loewner.bodies import Bodies
from loewner.errors import FileError
from loewner.paper import detectors, report
from loewner.paper.dataset import sample
from loewner.paper.detectors import Answers, Confusion, Pairs
from loewner.paper.fitting import fit_one_by_one
from loewner.paper.results import Experiment, Result
from loewner.queries.pairs import collide

Progress = Callable[[str, int, int], None]
Path_ = str | os.PathLike[str]


def run(
    pairs: int = 1000,
    seed: int = 0,
    dataset: str = "radius",
    out: Path_ | None = None,
    json: Path_ | None = None,
    progress: Progress | None = None,
) -> Experiment:
    """Run the paper's experiment.

    Parameters
    ----------
    pairs : int
        Number of pairs; the paper uses 1000.
    seed : int
        The same seed gives the same pairs; the first k pairs do not depend on the total number.
    dataset : {"radius", "volume"}
        Distribution of the points in the unit ball, as for `sample`; "radius" matches the paper's numbers.
    out : path, optional
        Folder for the report (report.md, report.html) and the figures (PNG, SVG); created if missing.
    json : path, optional
        File for the counts and times.
    progress : callable, optional
        Called from time to time as ``progress(stage, done, total)``, where `stage` is a name.

    Returns
    -------
    Experiment

    Raises
    ------
    InputError, UnknownNameError
        If `pairs`, `seed` or `dataset` is not as described above.
    MissingExtraError
        If `out` is given and matplotlib is not installed.
    FileError
        If a file cannot be written; each file is written completely or not at all.

    Examples
    --------
    >>> from loewner import paper
    >>> found = paper.run(50, seed=1)
    >>> found.truth.shape
    (50,)
    >>> len(paper.tables.rows(found))  # tables 1 to 4 and the estimate's, (a) and (b)
    10
    """
    _validate.callback(progress, "progress")
    counts = None if json is None else _validate.path(json, "json")
    data = sample(pairs, seed, dataset)
    # Check before the work, not after it, that the results can be written.
    if counts is not None and not folder_exists(counts.parent):
        raise FileError(f"{counts}: expected a name in an existing folder, found no folder {counts.parent}")
    if counts is not None and folder_exists(counts):
        raise FileError(f"{counts}: expected the name of a file, found a folder")
    if out is not None:
        report.prepare(out)
    tell = progress or (lambda stage, done, total: None)
    n = len(data)

    # Fit all hulls at once, then separate the first and the second body of each pair.
    points, fitted = np.concatenate([data.points_1, data.points_2]), partial(tell, "hulls and fits")
    bodies = Bodies.from_points(points, progress=fitted)
    bodies_1, bodies_2 = bodies[:n], bodies[n:]
    model = Pairs.from_bodies(bodies_1, bodies_2)
    tell("exact answers", 0, n)
    truth = np.asarray(collide(bodies_1, None, bodies_2, None, method="exact"))
    tell("exact answers", n, n)
    results: list[Result] = []
    for k in detectors.DETECTORS:
        tell("detectors", len(results), len(detectors.DETECTORS))
        results.append(_detected(k, model, truth))
    tell("detectors", len(results), len(results))
    estimate = _counted(0, "F_in F_out <= 1", detectors.estimate(model), truth)
    fittings = fit_one_by_one(bodies_1, bodies_2)
    experiment = Experiment(data, bodies_1, bodies_2, model, truth, tuple(results), estimate, fittings)
    if counts is not None:
        write_atomically(counts, (_json.dumps(experiment.as_dict(), indent=2) + "\n").encode())
    if out is not None:
        tell("report", 0, 1)
        report.write(experiment, out)
        tell("report", 1, 1)
    return experiment


def _detected(detector: int, pairs: Pairs, truth: Bools) -> Result:
    """Compute the answers, counts and times of one detector."""
    answers = detectors.detect(detector, pairs)
    hard = pairs.take(np.flatnonzero(answers.ambiguous))
    microseconds = detectors.time_per_check(detector, pairs), detectors.time_per_check(detector, hard)
    return _counted(detector, detectors.DETECTORS[detector], answers, truth, *microseconds)


def _counted(number: int, name: str, answers: Answers, truth: Bools, *microseconds: float) -> Result:
    chosen = answers.ambiguous
    every, hard = Confusion.of(answers.collides, truth), Confusion.of(answers.collides[chosen], truth[chosen])
    return Result(number, name, answers, every, hard, *microseconds)
