"""The same batch on one thread and on two."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np

import loewner
from clock import ALL_THREADS, Cost, race, threads_set_to, timed
from report import REQUIRED, Row
from samples import repeated_pairs

COUNT, QUICK = 200_000, 10_000
ROUNDS = 25  # a batch takes milliseconds, and is easily disturbed
# Steps of the control: plain arithmetic, which nothing but the machine keeps from running twice as fast on two threads.
STEPS, QUICK_STEPS = 60_000_000, 600_000


@numba.njit(nogil=True)
def _plain(steps):
    s = 0.0
    for i in range(steps):
        s += (i % 7) ** 0.5
    return s


def machine_allows(steps: int, rounds: int) -> float:
    """How many times as fast two threads do plain arithmetic here and now: 2 on an idle machine, 1 on a busy one."""

    def work(threads: int) -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(_plain, [steps // threads] * threads))

    cost = race({str(t): timed(partial(work, t), steps) for t in (1, 2)}, rounds)
    return cost["1"].wall / cost["2"].wall


def run(quick: bool, folder: Path) -> list[Row]:
    p = repeated_pairs(QUICK if quick else COUNT)
    if ALL_THREADS < 2:
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

    allowed = machine_allows(QUICK_STEPS if quick else STEPS, 2 if quick else 5)
    rows = []
    for name, (items, query) in queries.items():
        cost: dict[str, Cost] = race(
            {str(t): timed(partial(on, t, query), items) for t in (1, 2)}, 2 if quick else ROUNDS
        )
        differing = int((np.asarray(on(1, query)) != np.asarray(on(2, query))).sum())
        grown = cost["2"].cpu / cost["1"].cpu
        note = (
            f"{name}: processor time grows {grown:.2f} times; plain arithmetic gains {allowed:.2f} times by two threads"
        )
        rows.append(
            Row(f"{name}: two threads", "two threads", cost["2"], "one thread", cost["1"], items,
                REQUIRED["two threads"], differing, note, True)
        )  # fmt: skip
    return rows
