"""The same batch on one thread and on two."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np

import loewner
from clock import Cost, race, threads_set_to, timed
from report import REQUIRED, Row
from samples import repeated_pairs

COUNT, QUICK = 200_000, 10_000
# Wall times of threads are to be believed only where a single thread gets this share of a core, at its best.
BUSY = 0.95


def run(quick: bool, folder: Path) -> list[Row]:
    p = repeated_pairs(QUICK if quick else COUNT)
    most = numba.config.NUMBA_NUM_THREADS
    if most < 2:
        return [Row(name, "", None, "", None, len(p), REQUIRED["two threads"], note="not run: one core") for name in
                ("classify: two threads", "collide: two threads", "distance: two threads")]  # fmt: skip
    half = p.part(slice(0, len(p) // 4))
    queries: dict[str, tuple[int, Callable[[], Any]]] = {
        "classify": (len(p), lambda: loewner.classify(*p.arguments())),
        "collide": (len(p), lambda: loewner.collide(*p.arguments())),
        "distance": (len(half), lambda: loewner.distance(*half.arguments(), exact=True).distance),
    }

    def on(threads: int, query: Callable[[], Any]) -> Any:
        with threads_set_to(threads):
            return query()

    rows = []
    for name, (items, query) in queries.items():
        cost: dict[str, Cost] = race(
            {str(t): timed(partial(on, t, query), items) for t in (1, 2)}, 2 if quick else 7
        )  # fmt: skip
        differing = int((np.asarray(on(1, query)) != np.asarray(on(2, query))).sum())
        grown = cost["2"].cpu / cost["1"].cpu
        note = f"{name}: processor time grows {grown:.2f} times"
        if cost["1"].cpu < BUSY * cost["1"].wall:
            note += (
                f"; BUSY MACHINE: one thread had {cost['1'].cpu / cost['1'].wall:.0%} of a core, so this says nothing"
            )
        rows.append(
            Row(f"{name}: two threads", "two threads", cost["2"], "one thread", cost["1"], items,
                REQUIRED["two threads"], differing, note, True)
        )  # fmt: skip
    return rows
