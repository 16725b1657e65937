"""20,000 overlapping ellipsoids, pushed apart until no two overlap: each pair along its normal, each body by half.

python examples/relax_crowd.py [--count 20000] [--density 0.68] [--seed 1]

Rounds 0, 1, 2, 4, 8, ... are printed, and the last.
"""

import argparse
import time

import numpy as np

import loewner

KEEP = 0.01  # metres between two bodies that were pushed: touching counts as overlapping
ROUNDS = 5000


def main() -> None:
    """Strew ellipsoids in a cube, push them apart round by round, and ask at the end who still overlaps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--density", type=float, default=0.68, help="volume of all of them, overlaps counted twice")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()

    grains, T = strewn(asked.count, asked.density, asked.seed)
    start = time.perf_counter()
    for k in range(ROUNDS):
        found = loewner.overlapping_pairs(grains, T, depth=True)
        if len(found) == 0 or k & (k - 1) == 0:
            report(k, found)
        if len(found) == 0:
            break
        T[:, :3, 3] += pushes(found, asked.count)
    print(f"{time.perf_counter() - start:.1f} s")
    print(f"pairs that overlap at the end: {len(loewner.overlapping_pairs(grains, T))}")


def strewn(count: int, density: float, seed: int) -> tuple[loewner.Bodies, np.ndarray]:
    """Ellipsoids of semi-axes from 0.3 to 1 m, turned at random, in a cube."""
    rng = np.random.default_rng(seed)
    axes = rng.uniform(0.3, 1.0, size=(count, 3))
    side = np.cbrt(4 / 3 * np.pi * axes.prod(axis=1).sum() / density)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = np.linalg.qr(rng.normal(size=(count, 3, 3))).Q
    T[:, :3, 0] *= np.sign(np.linalg.det(T[:, :3, :3]))[:, None]  # a rotation, not a reflection
    T[:, :3, 3] = rng.uniform(0.0, side, size=(count, 3))
    return loewner.Bodies.ellipsoids(axes), T


def pushes(found: loewner.Overlaps, count: int) -> np.ndarray:
    """How far each body moves: half of what each of its pairs lacks, away from the other body."""
    half = 0.5 * (KEEP - found.distance)[:, None] * found.normal
    i, j = found.pairs.T
    return np.stack([np.bincount(j, x, count) - np.bincount(i, x, count) for x in half.T], axis=1)


def report(k: int, found: loewner.Overlaps) -> None:
    """One line about a round."""
    deepest = 1000 * max(0.0, -found.distance.min(initial=0.0))
    print(f"round {k:4}: {len(found):6} pairs overlap, the deepest by {deepest:7.2f} mm")


if __name__ == "__main__":
    main()
