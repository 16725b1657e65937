"""A million poses in one call.

python examples/batch.py [--poses 1000000]
"""

import argparse
import time

import numpy as np

import loewner
from loewner import Verdict


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Rotations of unit quaternions drawn evenly, shape (count, 3, 3)."""
    q = rng.normal(size=(count, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def main() -> None:
    """Classify one body against another at many poses, then one body against many."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=1_000_000)
    count = parser.parse_args().poses
    rng = np.random.default_rng(0)

    a, b = (loewner.Body.from_points(rng.normal(size=(20, 3))) for _ in range(2))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = random_rotations(rng, count)
    poses[:, :3, 3] = rng.uniform(-6, 6, (count, 3))
    loewner.collide(a, None, b, poses[:10_000])  # compiles on the first run on a machine; starts the threads

    started = time.perf_counter()
    verdicts = loewner.classify(a, None, b, poses)
    middle = time.perf_counter()
    colliding = loewner.collide(a, None, b, poses)
    ended = time.perf_counter()
    for verdict in Verdict:
        print(f"{verdict.name:9} {np.mean(verdicts == verdict):6.1%}")
    print(f"{'exactly: colliding':18} {np.mean(colliding):6.1%}")
    certified, exact = (1e9 * seconds / count for seconds in (middle - started, ended - middle))
    print(f"classify {certified:.0f} ns a pair, collide {exact:.0f} ns a pair, on this machine in this run")

    # n bodies broadcast with the last axis of the poses: each obstacle against the body at each of 3 poses.
    obstacles = loewner.Bodies.from_points(list(rng.normal(size=(100, 12, 3)) * 0.5 + rng.normal(size=(100, 1, 3)) * 3))
    answers = loewner.collide(a, poses[:3, None], obstacles, None)
    print(
        f"a at 3 poses against {len(obstacles)} obstacles: answers of shape {answers.shape}, {answers.sum()} colliding"
    )


if __name__ == "__main__":
    main()
