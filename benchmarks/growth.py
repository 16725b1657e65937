"""How the cost grows with the number of vertices and falls with the size of the batch."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import loewner
from clock import race, timed
from loewner import Body
from report import Row, differences
from rivals import CoalLoop, CoalPython, Missing, Settings, all_settings, build_loop
from samples import Array, Pairs, many_vertices, repeated_pairs

VERTICES, QUICK_VERTICES = (8, 20, 50, 125, 320, 800, 2_000, 8_000), (8, 50)
POWERS = (2.0, 4.0)
HULLS, PAIRS = 16, 4_000
BATCHES, QUICK_BATCHES = tuple(10**k for k in range(7)), (1, 10, 100)
# A batch is repeated until it has gone through so many pairs, so that short ones can be timed.
LEAST_PAIRS = 2_000
QUERIES = {"classify": loewner.classify, "collide": loewner.collide}


def vertices(quick: bool, folder: Path) -> list[Row]:
    rows = []
    for power in POWERS:
        for v in QUICK_VERTICES if quick else VERTICES:
            rows += _at(v, power, quick, folder)
    return rows


def _at(v: int, power: float, quick: bool, folder: Path) -> list[Row]:
    p = many_vertices(v, power, HULLS, PAIRS // 10 if quick else PAIRS)
    n, rounds = len(p), 2 if quick else 3
    calls = _calls(p)
    ours = {name: timed(partial(_answers, query, calls), n) for name, query in QUERIES.items()}
    colliding = _answers(loewner.collide, calls)
    note = f"{(_answers(loewner.classify, calls) == loewner.Verdict.AMBIGUOUS).mean():.0%} ambiguous"
    try:
        with CoalLoop(build_loop(folder), p, folder) as loop:
            # The shape of the hull decides which settings are the fastest; wrong ones are out of the race.
            trial = loop.select(np.arange(min(500, n)))
            ways = [
                s
                for s in all_settings("hull-solver", early=(1,))
                if not differences(colliding[:500], loop.answers(s, trial))
            ]
            way: Settings = min(ways, key=lambda s: loop.measure(s, trial).cpu)
            cost = race(ours | {"coal": loop.measured(way)}, rounds)
            differing = differences(colliding, loop.answers(way))
            note += f"; {way}"
    except Missing as missing:
        cost, differing = race(ours, rounds), None
        note += f"; not run: {missing}"
    return [
        Row(p.name, name, cost[name], "Coal C++ hulls", cost.get("coal"), n, None, differing, note)
        for name in ("classify", "collide")
    ]


def batches(quick: bool, folder: Path) -> list[Row]:
    sizes = QUICK_BATCHES if quick else BATCHES
    whole = repeated_pairs(max(sizes))
    cost_coal, note = None, "Coal: its cost per pair, which no batch changes"
    try:
        some = whole.part(slice(0, 2_000))
        cost_coal = race({"coal": CoalPython(some).measured("collide")}, 3)["coal"]
    except Missing as missing:
        note = f"not run: {missing}"
    rows = []
    for size in sizes:
        p = whole.part(slice(0, size))
        again = max(1, LEAST_PAIRS // size) if not quick else 10
        rounds = 2 if quick or size >= 10**6 else 5
        cost = race(
            {name: timed(partial(_repeat, query, p, again), size * again) for name, query in QUERIES.items()}, rounds
        )
        rows += [Row(f"batch of {size}", k, c, "Coal Python", cost_coal, size, note=note) for k, c in cost.items()]
    return rows


def _repeat(query: Callable[..., Any], p: Pairs, times: int) -> None:
    for _ in range(times):
        query(*p.arguments())


def _calls(p: Pairs) -> list[tuple[Body, Array, Body, Array]]:
    """One call for each two hulls, in all their poses."""
    alone = list(p.bodies)
    changes = np.flatnonzero(np.diff(p.a, prepend=-1))
    parts = [slice(i, j) for i, j in zip(changes, [*changes[1:], len(p)], strict=True)]
    return [(alone[p.a[s.start]], p.Ta[s], alone[p.b[s.start]], p.Tb[s]) for s in parts]


def _answers(query: Callable[..., Any], calls: list[tuple[Body, Array, Body, Array]]) -> Array:
    return np.concatenate([query(*call) for call in calls])
