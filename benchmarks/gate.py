"""What a check of a gate takes from Python: time of the thread, and steps.

    python benchmarks/gate.py [--chunks 300]

The Panda among ten boxes and the chunks of `stops.py`: 50 targets at 50 Hz, 10 mm margin, brakes with half of the data
sheet's limits, without errors. Times are processor times of the thread, which include arrays and objects of Python.
Nothing is proven before about a new chunk; a tick that continues has a window of 25 targets, one of them new. If a
chunk does not pass as a whole, the gate also tries three slower ones. `certify_edges` proves the motions of the same
chunks, without brakes.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from loewner.planners import Gate, GateAnswer, GateState
from samples import Array
from stops import JERK, PERIOD, STATED, cell, chunks

WINDOW = 25
BRAKES = {
    "joint by joint": ("joints", None),
    "joint by joint, with jerk": ("joints", 0.5 * JERK * STATED),
    "on the path": ("path", None),
    "on the path, with jerk": ("path", 0.5 * JERK * STATED),
}

Answer = TypeVar("Answer")


def timed(work: Callable[[], Answer]) -> tuple[float, Answer]:
    """Processor microseconds of the thread without Python's collection of garbage, and the answer."""
    gc.disable()
    before = time.thread_time_ns()
    answer = work()
    taken = (time.thread_time_ns() - before) / 1e3
    gc.enable()
    return taken, answer


def checked(gate: Gate, rows: Array, k: int = 0) -> GateAnswer:
    """Check all targets behind row k, with the velocity of the motion that ends there, or of the first one."""
    before = max(k, 1)
    return gate.check(rows[k], (rows[before] - rows[before - 1]) / PERIOD, rows[k + 1 :], PERIOD)


def ticks(gate: Gate, rows: Array) -> list[tuple[float, GateAnswer]]:
    """A window of targets that moves along a chunk, as far as all of it passes: times and answers after the first."""
    found: list[tuple[float, GateAnswer]] = []
    for k in range(len(rows) - WINDOW):
        taken, answer = timed(lambda k=k: checked(gate, rows[: k + WINDOW + 1], k))
        if answer.state != GateState.GO:
            break
        found.append((taken, answer))
    return found[1:]


def line(name: str, times: list[float], steps: list[int]) -> str:
    """A row of the table."""
    cells = [f"{name:52}", f"{len(times):7,}"]
    for values, digits in ((times, 1), (steps, 0)):
        if values:
            middle, most = np.percentile(values, [50, 99.9])
            cells += [f"{x:11,.{digits}f}" for x in (middle, most, max(values))]
    return " ".join(cells)


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chunks", type=int, default=300, help="number of chunks (300)")
    checker, _ = cell()
    given = chunks(checker, parser.parse_args(arguments).chunks)
    checker.certify_edges(given[0][:-1], given[0][1:])
    print(f"{'':52} {'count':>7} " + " ".join(f"{x:>11}" for x in ("us, median", "us, 99.9 %", "us, most",
                                                              "steps", "99.9 %", "most")))  # fmt: skip
    times, steps = [], []
    for rows in given:
        taken, found = timed(lambda rows=rows: checker.certify_edges(rows[:-1], rows[1:]))
        times.append(taken)
        steps.append(int(found.steps.sum()))
    print(line("certify_edges of 50", times, steps), flush=True)
    for name, (brake, jerk) in BRAKES.items():
        gate = Gate(checker, brake=brake, acceleration=0.5 * STATED, jerk=jerk)
        checked(gate, given[0][:3])
        fresh = [timed(lambda rows=rows, gate=gate: checked(gate, rows)) for rows in given]
        going = [(taken, answer) for taken, answer in fresh if answer.state == GateState.GO]
        other = [(taken, answer) for taken, answer in fresh if answer.state != GateState.GO]
        tail = [found for rows in given for found in ticks(gate, rows)]
        for what, rows in (("new, passes", going), ("new, does not pass", other), ("continues", tail)):
            print(line(f"{name}: {what}", [t for t, _ in rows], [a.work for _, a in rows]), flush=True)


if __name__ == "__main__":
    main()
