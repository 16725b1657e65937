"""Coal's three variants of GJK in a C++ loop, and ours, on the same hulls: time per pair and differing answers.

    python benchmarks/gjk_variants.py [--quick]

The other settings are Coal's defaults. Hulls of 20 points from the paper's data, turned at random; all on one thread,
in turn. Answers are compared with ours: booleans, and distances of separated pairs beyond 1e-6 m.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import loewner
from clock import race, threads_set_to, timed
from rivals import CoalLoop, Settings, build_loop
from samples import paper_pairs

VARIANTS = ("default", "Polyak", "Nesterov")
COUNT, QUICK, LEAST = 20_000, 500, 1e-6


def rows(count: int, folder: Path) -> list[tuple[str, str, int, float, int]]:
    """Question, way, number of pairs, nanoseconds of processor time per pair, and differing answers."""
    found, every = [], paper_pairs(count)
    hits = loewner.collide(every.first, every.Ta, every.second, every.Tb)
    for question, p in (("collide", every), ("distance", every.part(np.flatnonzero(~hits)))):
        with CoalLoop(build_loop(folder), p, folder) as loop, threads_set_to(1):
            exact = {"exact": True} if question == "distance" else {}
            call = partial(getattr(loewner, question), p.first, p.Ta, p.second, p.Tb, **exact)
            ours = call().distance if exact else call()
            asked = {f"Coal, {name} GJK": Settings(f"hull-{question}", variant=k) for k, name in enumerate(VARIANTS)}
            costs = race({way: loop.measured(one) for way, one in asked.items()} | {"loewner": timed(call, len(p))})
            others = {way: loop.answers(one) for way, one in asked.items()}
            differ = {way: np.abs(x[:, 0] - ours) > LEAST if exact else x != ours for way, x in others.items()}
            found += [
                (question, way, len(p), 1e9 * cost.cpu, int(differ[way].sum()) if way in differ else 0)
                for way, cost in costs.items()
            ]
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few pairs: shows that it works")
    count = QUICK if parser.parse_args().quick else COUNT
    print(f"{'question':<10} {'way':<20} {'pairs':>8} {'ns a pair':>10} {'other answers':>14}")
    with TemporaryDirectory() as folder:
        for question, way, pairs, spent, others in rows(count, Path(folder)):
            print(f"{question:<10} {way:<20} {pairs:8d} {spent:10.0f} {others:14d}")


if __name__ == "__main__":
    main()
