"""Time proofs of motions among bodies that move or grow, beside the same among bodies that stand, and beside samples.

python benchmarks/moving_bodies.py
"""

from __future__ import annotations

import numpy as np

from clock import race, threads_set_to, timed
from loewner import Body, CollisionChecker, Scene
from robot_samples import panda

MOTIONS, BODIES, SECONDS = 2000, 10, 5.0

# How fast bodies depart from their motions, and from places at which they stand [m/s]; the last one walks.
SPEED = 0.05
SPEEDS = (0.05, 0.2, 0.5, 1.6)


def main() -> None:
    """Print the time of one motion in each way."""
    rng, robot = np.random.default_rng(0), panda().robot
    moving, standing, uncertain, growing = Scene(), Scene(), Scene(), {speed: Scene() for speed in SPEEDS}
    for k in range(BODIES):
        T = np.tile(np.eye(4), (2, 1, 1))
        way = rng.normal(size=3)
        T[:, :3, 3] = way / np.linalg.norm(way) * rng.uniform(0.5, 1.3) + rng.normal(size=(2, 3)) * 0.3 + [0, 0, 0.3]
        for scene in (moving, standing):
            scene.add(f"box {k}", Body.box(rng.uniform(0.05, 0.3, 3)), T.mean(axis=0))
        moving.follow(f"box {k}", [0.0, SECONDS], T)
        uncertain.add(f"box {k}", moving[f"box {k}"])
        uncertain.follow(f"box {k}", [0.0, SECONDS], T, speed=SPEED)
        for speed, scene in growing.items():
            scene.add(f"box {k}", standing[f"box {k}"])
            scene.follow(f"box {k}", [0.0], standing.pose(f"box {k}")[None], speed=speed)
    a = robot.random_configurations(MOTIONS)
    b = np.clip(a + rng.normal(size=a.shape) * 0.3, robot.lower, robot.upper)
    t0 = rng.uniform(0.0, SECONDS - 1.5, MOTIONS)
    t1 = t0 + rng.uniform(0.0, 1.5, MOTIONS)
    checker, still = CollisionChecker(robot, moving), CollisionChecker(robot, standing)
    unsure = CollisionChecker(robot, uncertain)
    grows = {speed: CollisionChecker(robot, scene) for speed, scene in growing.items()}
    f = np.linspace(0.0, 1.0, 101)
    Q, t = robot.between(a[:, None], b[:, None], f), t0[:, None] + f * (t1 - t0)[:, None]
    print(f"{MOTIONS} motions of a Panda, {BODIES} boxes")
    ways = {
        "proven among moving boxes": lambda: checker.certify_edges(a, b, t0=t0, t1=t1),
        "proven among boxes that stand": lambda: still.certify_edges(a, b),
        "among moving boxes that grow": lambda: unsure.certify_edges(a, b, t0=t0, t1=t1),
        **{
            f"and grow by {speed} m/s": lambda one=one: one.certify_edges(a, b, t0=t0, t1=t1)
            for speed, one in grows.items()
        },
        "101 samples among moving boxes": lambda: checker.collide(Q, t),
    }
    with threads_set_to(1):
        costs = race({name: timed(ask, MOTIONS) for name, ask in ways.items()})
    for name, cost in costs.items():
        ratio = cost.cpu / costs["proven among boxes that stand"].cpu
        print(f"{name:32} {cost.cpu * 1e6:8.1f} µs a motion, {ratio:.2f} times")


if __name__ == "__main__":
    main()
