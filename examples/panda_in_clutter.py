"""A motion of the Panda arm through clutter, proven free at every one of its configurations.

python examples/panda_in_clutter.py [--seed 0] [--planner BITstar]
"""

import argparse
import time

import numpy as np

import loewner
from loewner import planners
from robot_meshes import panda_robot


def clutter(rng: np.random.Generator, count: int) -> loewner.Scene:
    """Boxes and cylinders around the arm, from which it keeps a centimetre."""
    scene = loewner.Scene(margin=0.01)
    for k in range(count):
        T = np.eye(4)
        angle, radius = rng.uniform(-np.pi, np.pi), rng.uniform(0.45, 0.8)
        T[:3, 3] = radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.1, 0.9)
        body = loewner.Body.box(rng.uniform(0.05, 0.25, 3)) if k % 2 else loewner.Body.cylinder(0.06, 0.3)
        scene.add(f"obstacle {k}", body, T)
    return scene


def main() -> None:
    """Draw a start and a goal, plan, and say what came out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--planner", help="a planner of ompl.geometric; needs the extra planners")
    options = parser.parse_args()

    robot, scene = panda_robot(), clutter(np.random.default_rng(options.seed), 12)
    checker = loewner.CollisionChecker(robot, scene)
    # The checker takes a whole batch at once: this is all that a sampling planner of your own needs.
    Q = robot.random_configurations(1000, options.seed)
    free = Q[~checker.collide(Q)]
    print(f"{len(free)} of {len(Q)} random configurations are free")
    # The two that are farthest apart, of those that the straight way between is blocked for.
    a, b = np.triu_indices(40, 1)
    blocked = checker.certify_edges(free[a], free[b]).verdict != loewner.Verdict.FREE
    worst = np.flatnonzero(blocked)[robot.distances(free[a[blocked]], free[b[blocked]]).argmax()]
    start, goal = free[a[worst]], free[b[worst]]

    started = time.perf_counter()
    search = planners.Search(planner=options.planner, timeout=20.0)
    path = planners.plan(checker, start, goal, search=search, seed=options.seed)
    seconds = time.perf_counter() - started
    length = robot.distances(path[:-1], path[1:]).sum()
    print(f"a path of {len(path)} configurations in {1e3 * seconds:.1f} ms")
    print(f"length {length:.2f}, the straight way, which is blocked, {robot.distances(start, goal):.2f}")

    # A proven motion keeps the margin everywhere; looking is only for show.
    on_path = robot.between(path[:-1, None], path[1:, None], np.linspace(0, 1, 500)).reshape(-1, robot.dof)
    nearer = checker.collide(on_path).sum()
    scene.set_margin(0.0)
    touching = checker.collide(on_path).sum()
    print(f"of {len(on_path)} configurations on it, {touching} touch, {nearer} come nearer than the margin")


if __name__ == "__main__":
    main()
