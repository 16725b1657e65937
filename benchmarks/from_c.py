"""Ask a Panda among ten obstacles from C and from Python, in turns in one process: verdicts, motions, paths.

Calls of the library go through ctypes; where a call takes a microsecond, its own cost is measured and named.
"""

from __future__ import annotations

import argparse
import ctypes
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clock import threads_set_to
from loewner import CollisionChecker, planners
from loewner.errors import PlanningError
from robot_samples import obstacles, panda

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import capi


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--configurations", type=int, default=1_000_000)
    parser.add_argument("--motions", type=int, default=100_000)
    parser.add_argument("--plans", type=int, default=200)
    options = parser.parse_args(arguments)
    robot = panda().robot
    checker = CollisionChecker(robot, obstacles(0))
    with tempfile.TemporaryDirectory() as folder, threads_set_to(1):
        path = Path(folder, "cell.lwn")
        checker.save(path)
        opened = min(seconds(lambda: capi.Checker(path)) for _ in range(20))
        print(f"file of {path.stat().st_size:,} bytes, opened in {1e3 * opened:.2f} ms")
        mine = capi.Checker(path)
        Q = robot.random_configurations(options.configurations, seed=1)
        verdicts(checker, mine, Q)
        motions(checker, mine, Q[: options.motions], Q[-options.motions :])
        single(mine, Q)
        plans(checker, mine, Q, options.plans)
    return 0


def seconds(call: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def in_turns(ours: Callable[[], Any], python: Callable[[], Any], times: int = 3) -> tuple[float, float]:
    found = [(seconds(ours), seconds(python)) for _ in range(times)]
    return min(a for a, _ in found), min(b for _, b in found)


def verdicts(checker: CollisionChecker, mine: capi.Checker, Q: np.ndarray) -> None:
    same = np.array_equal(mine.verdicts("collide", Q) == 1, checker.collide(Q))
    ours, python = in_turns(lambda: mine.verdicts("collide", Q), lambda: checker.collide(Q))
    print(f"{len(Q):,} configurations: C {ours:.3f} s, Python {python:.3f} s, ratio {python / ours:.2f}; same: {same}")


def motions(checker: CollisionChecker, mine: capi.Checker, a: np.ndarray, b: np.ndarray) -> None:
    b = a + 0.1 * (b - a)
    found, at, _ = mine.certify(a, b)
    certified = checker.certify_edges(a, b)
    same = np.array_equal(found, certified.verdict) and np.array_equal(at, certified.fraction, equal_nan=True)
    ours, python = in_turns(lambda: mine.certify(a, b), lambda: checker.certify_edges(a, b))
    print(f"{len(a):,} motions: C {ours:.3f} s, Python {python:.3f} s, ratio {python / ours:.2f}; same: {same}")


def single(mine: capi.Checker, Q: np.ndarray, count: int = 20_000) -> None:
    """One configuration and one motion a call, with what an empty call through ctypes costs taken off."""
    library = capi.functions()
    one, out = ctypes.c_size_t(1), np.empty(1, dtype=np.int8)
    address, width = Q.ctypes.data, Q.itemsize * Q.shape[1]
    rows = [ctypes.c_void_p(address + width * k) for k in range(count)]
    to, checker, workspace = ctypes.c_void_p(out.ctypes.data), mine._as_parameter_, mine.workspace._as_parameter_
    none = ctypes.c_size_t(0)
    collide, certify = library.loewner_checker_collide, library.loewner_checker_certify_edges
    B = np.ascontiguousarray(Q[:count] + 0.1 * (Q[count : 2 * count] - Q[:count]))
    ends = [ctypes.c_void_p(B.ctypes.data + width * k) for k in range(count)]
    calls = {
        "configuration": (collide, lambda k, n: (checker, workspace, rows[k], n, to)),
        "motion": (certify, lambda k, n: (checker, workspace, rows[k], ends[k], n, None, to, None, None)),
    }
    for name, (function, given) in calls.items():
        times = []
        for n in (none, one):
            found = []
            for _ in range(3):
                listed = [given(k, n) for k in range(count)]
                begin = time.perf_counter()
                for arguments in listed:
                    function(*arguments)
                found.append((time.perf_counter() - begin) / count)
            times.append(min(found))
        print(f"one {name} a call: {1e6 * (times[1] - times[0]):.2f} us ({1e6 * times[0]:.2f} us of ctypes taken off)")


def plans(checker: CollisionChecker, mine: capi.Checker, Q: np.ndarray, count: int) -> None:
    free = Q[mine.verdicts("collide", Q[: 20 * count]).argsort(kind="stable")[: 2 * count]]
    ours, python, same = [], [], 0
    for start, goal in zip(free[::2], free[1::2], strict=True):
        try:
            path = planners.plan(checker, start, goal)
        except PlanningError:
            continue
        python.append(min(seconds(lambda s=start, g=goal: planners.plan(checker, s, g)) for _ in range(2)))
        same += np.array_equal(mine.plan(start, goal), path)
        ours.append(min(seconds(lambda s=start, g=goal: mine.plan(s, g)) for _ in range(2)))
    a, b = 1e3 * np.median(ours), 1e3 * np.median(python)
    print(f"{len(ours)} plans: C {a:.3f} ms at the median, Python {b:.3f} ms; {same} the same")


if __name__ == "__main__":
    raise SystemExit(main())
