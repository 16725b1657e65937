"""One pair per call from Python: what a call costs beside Coal's, and what no compiled call can go below."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

import loewner
from clock import race, timed
from loewner._native import entries
from report import Row
from rivals import CoalPython, Missing
from samples import repeated_pairs

CALLS, QUICK = 5_000, 500


@numba.njit
def _nothing(*arguments):
    return 0


def handed_over(call: tuple[Any, ...]) -> tuple[Any, ...]:
    """What one `classify` hands to its kernel."""
    caught: list[tuple[Any, ...]] = []
    kernel = entries.settle_range

    def catch(*arguments: Any) -> Any:
        caught.append(arguments)
        return kernel(*arguments)

    entries.settle_range = catch
    try:
        loewner.classify(*call)
    finally:
        entries.settle_range = kernel
    return caught[0]


def run(quick: bool, folder: Path) -> list[Row]:
    p = repeated_pairs(QUICK if quick else CALLS)
    alone = list(p.bodies)
    calls = [(alone[i], A, alone[j], B) for i, A, j, B in zip(p.a, p.Ta, p.b, p.Tb, strict=True)]
    same = handed_over(calls[0])

    def each(query: Callable[..., Any], **options: Any) -> Callable[[], Any]:
        return lambda: [query(*call, **options) for call in calls]

    contestants = {
        "classify": timed(each(loewner.classify), len(calls)),
        "collide": timed(each(loewner.collide), len(calls)),
        "distance": timed(each(loewner.distance, exact=True), len(calls)),
        "floor": timed(lambda: [_nothing(*same) for _ in calls], len(calls)),
    }
    note = ""
    try:
        coal = CoalPython(p)
        contestants |= {"coal": coal.measured("collide"), "coal distance": coal.measured("distance")}
        differing = int((np.array(each(loewner.collide)()) != np.array(coal.collide())).sum())
        apart = np.array([d.distance for d in each(loewner.distance, exact=True)()]) - np.array(coal.distance())
        differing_distance = int((np.abs(apart) > 1e-5).sum())
    except Missing as missing:
        note, differing, differing_distance = f"not run: {missing}", None, None
    cost = race(contestants, 2 if quick else 5)
    coal_cost, coal_distance, n = cost.get("coal"), cost.get("coal distance"), len(calls)
    floor = "a Numba call with as many arguments that does nothing"
    return [
        Row("one pair: verdict", "classify", cost["classify"], "Coal Python", coal_cost, n, note=note),
        Row("one pair: boolean", "collide", cost["collide"], "Coal Python", coal_cost, n, None, differing, note),
        Row("one pair: distance", "distance, exact", cost["distance"], "Coal Python", coal_distance, n, None,
            differing_distance, note or "Coal: signed distance"),
        Row("one pair: the floor", "classify", cost["classify"], "empty kernel", cost["floor"], n, note=floor),
    ]  # fmt: skip
