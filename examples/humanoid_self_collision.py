"""Self-collision of a humanoid: which pairs of links need a check is found by sampling, without an SRDF.

python examples/humanoid_self_collision.py [--samples 2000]
"""

import argparse
import time
from collections import Counter
from dataclasses import replace

import loewner
from robot_meshes import talos_robot


def main() -> None:
    """Sort out the pairs of Talos, and check it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=2000)
    samples = parser.parse_args().samples

    described = talos_robot()
    standing = described.configuration("half_sitting")
    bare = replace(described, disabled_pairs=frozenset())  # as if it came without an SRDF
    print(f"{bare.name}: {len(bare.bodies)} links with bodies, dof {bare.dof}")

    started = time.perf_counter()
    found = loewner.pairs_by_sampling(bare, samples, known_free=standing)
    print(f"pairs that need no check, by {samples} samples in {time.perf_counter() - started:.1f} s:")
    for why, count in sorted(Counter(found.values()).items()):
        print(f"    {why:10} {count}")
    robot = bare.disabling(found)
    checker = loewner.CollisionChecker(robot)
    by_hand = loewner.CollisionChecker(described)
    print(f"checked: {len(checker.checked_pairs)} pairs; with the SRDF {len(by_hand.checked_pairs)}")
    print(f"half sitting: {'colliding' if checker.collide(standing) else 'free'}")

    Q = robot.random_configurations(10_000, seed=1)
    checker.collide(Q[:1000])
    started = time.perf_counter()
    colliding = checker.collide(Q)
    seconds = time.perf_counter() - started
    print(f"{len(Q):,} random configurations: {colliding.sum():,} collide; {1e6 * seconds / len(Q):.1f} us each")
    hits = checker.collide_by_pair(Q[:500]).mean(axis=0)
    for p in (-hits).argsort()[:5]:
        a, b = checker.checked_pairs[p]
        print(f"    {a} and {b}: {100 * hits[p]:.0f} %")


if __name__ == "__main__":
    main()
