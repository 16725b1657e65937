"""Stones are packed into a smaller and smaller box: overlaps push them, and turn them, out of each other and the walls.

python examples/pack_box.py [--count 40] [--seed 1] [--rounds 300]

Each overlap is a force along its normal at the point of contact. The sum of these forces and of their moments moves
each stone by `loewner.push`, which is a step along the gradient of all depths.
"""

import argparse

import numpy as np
from scipy.spatial import ConvexHull

import loewner
from loewner import Body

KEEP = 1e-3  # metres between two stones that were pushed: touching counts as overlapping
SHRINK = 0.97
WALLS = 6


def main() -> None:
    """Shrink the box until the stones in it are no longer separated after the given number of rounds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=300)
    options = parser.parse_args()

    rng = np.random.default_rng(options.seed)
    stones = [Body.from_points(rng.normal(size=(12, 3)) * rng.uniform(0.2, 0.5, size=3)) for _ in range(options.count)]
    volume = sum(ConvexHull(stone.pieces[0].vertices).volume for stone in stones)
    side = 1.6 * np.cbrt(volume)
    T = np.tile(np.eye(4), (options.count, 1, 1))
    T[:, :3, 3] = rng.uniform(-0.4 * side, 0.4 * side, size=(options.count, 3))

    while (moved := separated(boxed(stones, side), T, options.rounds)) is not None:
        T, box = moved, side
        print(f"box of {side:.3f} m: {volume / side**3:.1%} full")
        side *= SHRINK
    print(f"box of {side:.3f} m: no room found in {options.rounds} rounds")
    print(f"pairs that overlap in the box of {box:.3f} m: {len(overlaps(boxed(stones, box), T)[0])}")


def boxed(stones: list[Body], side: float) -> loewner.Bodies:
    """Half-spaces outside of a box, and the stones."""
    walls = [Body.half_space(sign * axis, -side / 2) for axis in np.eye(3) for sign in (1.0, -1.0)]
    return loewner.Bodies([*walls, *stones])


def overlaps(bodies: loewner.Bodies, T: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pairs that overlap, their distances, normals and points, without the pairs of two walls, which always overlap."""
    found = loewner.overlapping_pairs(bodies, np.concatenate([np.tile(np.eye(4), (WALLS, 1, 1)), T]), depth=True)
    kept = found.pairs.max(axis=1) >= WALLS
    return found.pairs[kept], found.distance[kept], found.normal[kept], found.witness_b[kept]


def separated(bodies: loewner.Bodies, T: np.ndarray, rounds: int) -> np.ndarray | None:
    """Poses at which no two bodies overlap; None if so many rounds do not suffice."""
    for _ in range(rounds):
        pairs, distance, normal, point = overlaps(bodies, T)
        if len(pairs) == 0:
            return T
        share = np.where(pairs.min(axis=1) < WALLS, 1.0, 0.5)  # walls do not give way
        force = (share * (KEEP - distance))[:, None] * normal
        wrench, pushes = np.zeros((len(bodies), 6)), np.concatenate([force, np.cross(point, force)], axis=1)
        np.subtract.at(wrench, pairs[:, 0], pushes)
        np.add.at(wrench, pairs[:, 1], pushes)
        T = loewner.push(T, wrench[WALLS:], radius=0.5)
    return None


if __name__ == "__main__":
    main()
