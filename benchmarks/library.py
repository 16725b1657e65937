"""The native library beside what Numba compiles on this machine: the same calls, in processes that take turns.

    python benchmarks/library.py                       the best level that is built
    python benchmarks/library.py --level x86-64-v3     another one; Numba is told of the same processor

Each row is the least time of many short bursts in any of the processes, and the ratio of the two: above 1 the library
is quicker. Numba compiles first, which takes some minutes once.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "native"))
from build import LEVELS, architecture, told

BURST = 0.03  # seconds


def calls() -> dict[str, tuple[Callable[[], object], int]]:
    """What is timed: a call, and how many pairs, configurations or fits it is about."""
    import loewner

    sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
    from families import pieces, random_poses

    rng = np.random.default_rng(0)
    n = 20_000
    hulls = [loewner.Bodies.from_points(pieces("ball 20", 100, seed)) for seed in (1, 2)]
    rows = rng.integers(100, size=(2, n))
    a, b = hulls[0][rows[0]], hulls[1][rows[1]]
    T = random_poses(rng, n, 1.5)
    few = a[:2000], b[:2000], T[:2000]
    curved = loewner.Bodies([loewner.Body.cylinder(0.5, 1.0), loewner.Body.capsule(0.4, 1.0)] * 50)[rows[0]]
    grains = loewner.Bodies.ellipsoids(rng.uniform(0.5, 1.0, size=(5000, 3)))
    strewn = random_poses(rng, 5000, 20.0)
    points = list(pieces("ball 20", 50, 3))
    return {
        "classify": (lambda: loewner.classify(a, None, b, T), n),
        "collide": (lambda: loewner.collide(a, None, b, T), n),
        "collide, curved": (lambda: loewner.collide(curved, None, b, T), n),
        "distance, bounds": (lambda: loewner.distance(few[0], None, few[1], few[2]), 2000),
        "distance, exact": (lambda: loewner.distance(few[0], None, few[1], few[2], exact=True), 2000),
        "overlapping pairs": (lambda: loewner.overlapping_pairs(grains, strewn), 5000),
        "fits of hulls": (lambda: loewner.Bodies.from_points(points), 50),
    }


def child(seconds: float) -> None:
    """Print the least time of each call [ns]."""
    import loewner

    loewner.set_num_threads(1)
    found = {}
    for name, (call, count) in calls().items():
        call()
        least, until = np.inf, time.perf_counter() + seconds
        while time.perf_counter() < until:
            start, times = time.perf_counter(), 0
            while (took := time.perf_counter() - start) < BURST:
                call()
                times += 1
            least = min(least, took / times / count)
        found[name] = 1e9 * least
    print(json.dumps(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--level", choices=LEVELS[architecture()])
    parser.add_argument("--turns", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=0.5, help="for each call and turn")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        return child(options.seconds)

    from loewner._native import library

    level = options.level or library.level()
    if level is None:
        sys.exit(f"no native library here: {library.why_not()}")
    processor = told(level) if options.level else {}
    environments = {"library": {"LOEWNER_LEVEL": level}, "numba": {"LOEWNER_JIT": "1", **processor}}
    least: dict[str, dict[str, float]] = {path: {} for path in environments}
    for turn in range(options.turns + 1):
        for path, environment in environments.items():
            command = [sys.executable, __file__, "--child", "--seconds", str(options.seconds if turn else 0.0)]
            done = subprocess.run(command, env=os.environ | environment, stdout=subprocess.PIPE, check=True, text=True)
            for name, value in json.loads(done.stdout).items():
                if turn:  # the first is for compiling
                    least[path][name] = min(value, least[path].get(name, np.inf))
    compared = "Numba on this processor" if options.level is None else f"Numba for {level}"
    print(f"library of {level}, beside {compared}; ns a pair, body or hull")
    for name, value in least["library"].items():
        print(f"{name:20} {value:10.1f} {least['numba'][name]:10.1f}   ratio {least['numba'][name] / value:.3f}")


if __name__ == "__main__":
    main()
