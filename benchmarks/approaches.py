"""The closest approach of curves beside their proof, and beside dense samples, for a Panda at a shelf.

    python benchmarks/approaches.py [--curves 40]

Prints processor times: the proof, `closest`, exact distances at 401 samples, and how far these are from the truth. The
last row is one curve of ten minutes.
"""

from __future__ import annotations

import argparse
import time
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import loewner
from loewner import Body, CollisionChecker, Robot

SAMPLES = 401


def cell() -> CollisionChecker:
    """A Panda before a shelf of five boards."""
    data = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data")))
    home = data / "robots" / "panda_description"
    robot = Robot.from_urdf(home / "urdf" / "panda.urdf", srdf=home / "srdf" / "panda.srdf", package_dirs=[data])
    scene = loewner.Scene()
    for number, (size, place) in enumerate(
        [
            ([0.3, 0.9, 0.02], [0.7, 0.0, 0.2]),
            ([0.3, 0.9, 0.02], [0.7, 0.0, 0.6]),
            ([0.3, 0.9, 0.02], [0.7, 0.0, 1.0]),
            ([0.3, 0.02, 0.9], [0.7, 0.45, 0.6]),
            ([0.3, 0.02, 0.9], [0.7, -0.45, 0.6]),
        ]
    ):
        T = np.eye(4)
        T[:3, 3] = place
        scene.add(f"board {number}", Body.box(size), T)
    return CollisionChecker(robot, scene)


def seconds(run, rounds: int = 3) -> float:
    """Best processor time of several rounds."""
    taken = []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        taken.append(time.process_time() - begin)
    return min(taken)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--curves", type=int, default=40, help="number of curves (40)")
    options = parser.parse_args()
    checker, rng = cell(), np.random.default_rng(0)
    rows = []
    for _ in range(options.curves):
        knots = checker.robot.random_configurations(400, int(rng.integers(2**31)))
        knots = knots[checker.collide(knots) == 0][:2]
        path = knots[0] + (knots[1] - knots[0]) * np.linspace(0, 1, 30)[:, None]
        curve = CubicSpline(np.linspace(0.0, 3.0, 30), path + 0.02 * rng.normal(size=path.shape))
        found = checker.closest(curve)
        least = checker.distance(curve(np.linspace(0, 3, SAMPLES)), exact=True).distance.min()
        rows.append(
            (
                checker.certify_trajectory(curve).verdict.name,
                seconds(lambda c=curve: checker.certify_trajectory(c)),
                seconds(lambda c=curve: checker.closest(c)),
                seconds(lambda c=curve: checker.distance(c(np.linspace(0, 3, SAMPLES)), exact=True)),
                float(least - found.distance.min()),
                float(found.close.mean()),
            )
        )
    for verdict in ("FREE", "COLLIDING"):
        some = np.array([row[1:] for row in rows if row[0] == verdict])
        if len(some) == 0:
            continue
        proof, closest, samples, off, close = some.T
        print(
            f"{verdict}, {len(some)} curves of 29 pieces: proof {1e3 * np.median(proof):.2f} ms, closest "
            f"{1e3 * np.median(closest):.2f} ms, {np.median(closest / proof):.1f} times the proof (at most "
            f"{(closest / proof).max():.1f}); {SAMPLES} samples {1e3 * np.median(samples):.2f} ms, off by "
            f"{1e3 * np.median(off):.3f} mm (at most {1e3 * off.max():.3f}); bounds near each other on "
            f"{100 * close.mean():.1f} % of the pieces"
        )
    long = checker.robot.random_configurations(601, 1)
    curve = CubicSpline(np.arange(601.0), checker.robot.configuration("default") + 0.2 * (long - long.mean(axis=0)))
    print(f"ten minutes, 600 pieces: {seconds(lambda: checker.closest(curve), 1):.2f} s of processor time")


if __name__ == "__main__":
    main()
