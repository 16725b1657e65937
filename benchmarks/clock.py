"""Timing on a machine that others use too: processor time beside wall time, contestants taking turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import loewner

# Threads that a call uses unless it is told otherwise.
ALL_THREADS = loewner.get_num_threads()


@dataclass(frozen=True)
class Cost:
    """Seconds per item: on the wall's clock, and of processor time summed over threads."""

    wall: float
    cpu: float


Measure = Callable[[], Cost]


def timed(run: Callable[[], Any], items: int) -> Measure:
    """Measure of a Python call that works through `items` items."""

    def measure() -> Cost:
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        return Cost(wall / items, cpu / items)

    return measure


def race(contestants: Mapping[str, Measure], rounds: int = 5) -> dict[str, Cost]:
    """Let all run in turn, A B A B, after one round that does not count; the best of each clock.

    The machine's speed drifts by tens of percent over minutes. Taking turns, all meet the same drift, and their ratios
    mean something.
    """
    for measure in contestants.values():
        measure()
    seen: dict[str, list[Cost]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, measure in contestants.items():
            seen[name].append(measure())
    return {name: Cost(min(c.wall for c in costs), min(c.cpu for c in costs)) for name, costs in seen.items()}


@contextmanager
def threads_set_to(count: int | None) -> Iterator[None]:
    """So many threads for loewner inside the block; None for as many as it uses by itself."""
    before = loewner.get_num_threads()
    loewner.set_num_threads(ALL_THREADS if count is None else count)
    try:
        yield
    finally:
        loewner.set_num_threads(before)
