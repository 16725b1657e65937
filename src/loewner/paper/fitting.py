"""Measure the reliability of the fits: fit each polyhedron of the experiment separately, and count failures.

The paper requires reliable fits (section 3), but prints no numbers about their reliability.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies import Bodies, packed_of
from loewner.ellipsoids.fits import Fit, mvce, mvie
from loewner.errors import LoewnerError
from loewner.paper.lifted_mvie import mvce_by_lifted_mvie

MOST_POLYHEDRA = 2000  # the polyhedra of the paper's 1000 pairs


@dataclass(frozen=True)
class Fitting:
    """The results of one kind of fit over many polyhedra, with one call per polyhedron, on one thread.

    Attributes
    ----------
    name : str
        A key of `FITS`.
    tried, failed : int
        Numbers of all fits and of failed fits. A fit failed if it raised a `LoewnerError` instead of returning an
        ellipsoid within the tolerance.
    largest_gap : float
        The largest certified gap in log-volume among the successful fits; NaN if no fit succeeded.
    microseconds : float
        Average time of one call.

    Examples
    --------
    >>> from loewner import paper
    >>> inner = paper.run(50).fittings[0]
    >>> inner.name, inner.tried, inner.failed, inner.largest_gap <= 1e-4
    ('inner (mvie)', 100, 0, True)
    """

    name: str
    tried: int
    failed: int
    largest_gap: float
    microseconds: float


FITS: dict[str, Callable[[Floats], Fit]] = {
    "inner (mvie)": mvie,
    "outer (mvce)": mvce,
    "outer (appendix B)": mvce_by_lifted_mvie,
}


def fit_one_by_one(bodies_1: Bodies, bodies_2: Bodies) -> tuple[Fitting, ...]:
    """Fit the polyhedra of the first pairs by every kind of fit, with the default tolerance (as in section 5)."""
    half = MOST_POLYHEDRA // 2
    packs = packed_of(bodies_1[:half]), packed_of(bodies_2[:half])
    polyhedra = [points for p in packs for points in np.split(p.points, p.layout[1:, columns.POINTS_FROM])]
    return tuple(_counted(name, fit, polyhedra) for name, fit in FITS.items())


def _counted(name: str, fit: Callable[[Floats], Fit], polyhedra: Sequence[Floats]) -> Fitting:
    gaps: list[float] = []
    begin = time.perf_counter()
    for polyhedron in polyhedra:
        with suppress(LoewnerError):
            gaps.append(fit(polyhedron).gap)
    microseconds = 1e6 * (time.perf_counter() - begin) / len(polyhedra)
    failed, largest = len(polyhedra) - len(gaps), max(gaps, default=float("nan"))
    return Fitting(name, len(polyhedra), failed, largest, microseconds)
