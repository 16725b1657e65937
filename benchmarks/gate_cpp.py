"""A gate in C++ in a control loop: what a new chunk of targets takes, and a tick that goes on, of a Panda.

The Panda stands among ten bodies. Needs a C++ compiler. Prints the median, the 99.9th percentile and the worst of many
ticks, in processor time of the thread and in steps of the proofs, with and without a budget.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import loewner
from loewner import CollisionChecker, Robot
from loewner._native import library
from robot_samples import obstacles, panda
from samples import Array

HERE = Path(__file__).parent
DT = 0.02
TARGETS, TICKS = 50, 20


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chunks", type=int, default=300)
    parser.add_argument("--steps", type=int, default=20_000, help="the budget")
    parser.add_argument("--histograms", action="store_true", help="counts between powers of two, too")
    options = parser.parse_args(arguments)
    how = "histograms" if options.histograms else "table"
    robot = panda().robot
    checker = CollisionChecker(robot, obstacles(0))
    with tempfile.TemporaryDirectory() as folder:
        cell, chunks, program = (Path(folder, name) for name in ("cell.lwn", "chunks", "gate"))
        checker.save(cell)
        made = random_chunks(robot, checker, options.chunks)
        made.tofile(chunks)
        include = Path(loewner.__file__).parent / "include"
        linked = [f"-L{library.HOME}", "-lloewner", "-Xlinker", "-rpath", "-Xlinker", str(library.HOME)]
        build = ["c++", "-std=c++17", "-O2", HERE / "gate_cpp.cpp", f"-I{include}", *linked, "-o", program]
        subprocess.run(build, check=True)
        print(f"{'':22} {'ticks':>8} {'median':>10} {'99.9 %':>10} {'worst':>10}", flush=True)
        for brake, jerk in (("path", "jumps"), ("joints", "jumps"), ("joints", "jerk")):
            for steps in (0, options.steps):
                words = [cell, chunks, robot.dof, made.shape[1], TARGETS, brake, jerk, steps, how]
                subprocess.run([program, *map(str, words)], check=True)
    return 0


def random_chunks(robot: Robot, checker: CollisionChecker, count: int) -> Array:
    """Chunks from rest at free configurations towards others, shape (count, rows, dof); no joint exceeds 1 rad/s."""
    Q = robot.random_configurations(12 * count + 1000, seed=1)
    Q = Q[~checker.collide(Q)]
    a, b = Q[:count], Q[count : 2 * count]
    t = DT * np.arange(TARGETS + TICKS + 1)
    way = np.where(t < 0.4, t * t / 0.8, t - 0.2)
    speed = np.random.default_rng(2).uniform(0.2, 1.0, count) / np.abs(b - a).max(axis=1)
    return a[:, None] + (speed[:, None] * way)[..., None] * (b - a)[:, None]


if __name__ == "__main__":
    sys.exit(main())
