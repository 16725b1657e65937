"""What a change of the scene costs: the first query after it, beside the second, on one thread.

    python benchmarks/changed_scenes.py [points]

A Panda among ten obstacles: bodies move, then it is checked or a plan is made. Then the loop of a camera: obstacles are
seen as points, which are replaced as balls or as voxels, checked, and planned around. Times of the processor,
medians.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from statistics import median

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import loewner
from clouds import seen
from loewner import Body, CollisionChecker, Robot, Scene, planners
from loewner.errors import PlanningError
from robot_samples import obstacles, panda
from samples import Array

RADIUS, VOXEL = 0.01, 0.02  # metres
SHIFT = 0.01  # metres by which bodies move, at most
ROUNDS, FRAMES = 60, 12


def spent(run: Callable[[], object]) -> float:
    """Milliseconds of the processor."""
    start = time.process_time_ns()
    run()
    return (time.process_time_ns() - start) / 1e6


def shifted(T: Array, rng: np.random.Generator) -> Array:
    moved = T.copy()
    moved[:3, 3] += rng.uniform(-SHIFT, SHIFT, 3)
    return moved


def planned(checker: CollisionChecker, start: Array, goal: Array) -> Callable[[], object]:
    """A plan between two configurations, which may fail while obstacles move."""

    def plan() -> object:
        try:
            return planners.plan(checker, start, goal, max_iterations=2000)
        except PlanningError:
            return None

    return plan


def ends(robot: Robot, checker: CollisionChecker) -> tuple[Array, Array]:
    """Two configurations that are free with room around them, and joined by a plan."""
    Q = robot.random_configurations(4000, 1)
    clear = checker.distance(Q, exact=True).distance
    start, *goals = Q[np.argsort(-clear)[:20]]
    return next((start, goal) for goal in goals if planned(checker, start, goal)() is not None)


def moved_bodies(robot: Robot) -> None:
    """Bodies that move, before a check and before a plan."""
    scene, rng = obstacles(0), np.random.default_rng(3)
    scene.add("table", Body.box([0.2, 0.2, 0.1]), [[1, 0, 0, 0.9], [0, 1, 0, 0], [0, 0, 1, 0.0], [0, 0, 0, 1]])
    checker, at = CollisionChecker(robot, scene), {name: scene.pose(name) for name in scene.names}
    q = robot.random_configurations(1, 5)[0]
    for count in (1, 5, 11):
        times: list[tuple[float, ...]] = []
        for _ in range(ROUNDS):
            names = scene.names[:count]
            Ts = np.array([shifted(at[name], rng) for name in names])
            times.append((
                spent(lambda names=names, Ts=Ts: scene.move_all(names, Ts)),
                spent(lambda: checker.collide(q)), spent(lambda: checker.collide(q)),
            ))  # fmt: skip
        move, first, second = (median(column) for column in zip(*times, strict=True))
        print(
            f"{count} of 11 bodies moved: moving {move * 1e3:.1f} us, first check {first * 1e3:.1f} us, second "
            f"{second * 1e3:.1f} us; {(first - second) * 1e3 / count:.1f} us a body", flush=True,
        )  # fmt: skip
    scene.move(at)
    scene.remove("table")
    start, goal = ends(robot, checker)
    plan, times = planned(checker, start, goal), []
    for k in range(ROUNDS):
        name = scene.names[k % len(scene)]
        scene.move(name, shifted(at[name], rng))
        first = spent(plan)
        second = min(spent(plan), spent(plan))
        times.append((first, second, first - second))
    first, second, more = (median(column) for column in zip(*times, strict=True))
    print(f"one of ten bodies moved: first plan {first:.2f} ms, second {second:.2f} ms; difference {more:.3f} ms")
    times = []
    for k in range(ROUNDS):
        name = scene.names[k % len(scene)]
        body = scene[name]
        scene.replace(name, Body.box([0.1, 0.1, 0.1]) if k % 20 < 10 else body)
        first = spent(plan)
        second = min(spent(plan), spent(plan))
        times.append((first, second, first - second))
    first, second, more = (median(column) for column in zip(*times, strict=True))
    print(f"one of ten bodies replaced: first plan {first:.2f} ms, second {second:.2f} ms; difference {more:.3f} ms")


def camera(robot: Robot, count: int) -> None:
    """New points in each frame: built, replaced, checked, planned around."""
    points, rng = seen(count), np.random.default_rng(4)
    makers = {
        f"balls of {RADIUS} m": lambda P: Body.from_cloud(P, radius=RADIUS),
        f"voxels of {VOXEL} m": lambda P: Body.from_cloud(P, voxel=VOXEL),
    }
    for name, make in makers.items():
        scene = Scene()
        scene.add("seen", make(points))
        checker = CollisionChecker(robot, scene)
        start, goal = ends(robot, checker)
        plan, times = planned(checker, start, goal), []
        for _ in range(FRAMES):
            new, made = points + rng.normal(size=points.shape) * 1e-4, []
            times.append((
                spent(lambda make=make, new=new, made=made: made.append(make(new))),
                spent(lambda scene=scene, made=made: scene.replace("seen", made[0])),
                spent(lambda checker=checker, start=start: checker.collide(start)),
                spent(lambda checker=checker, start=start: checker.collide(start)),
                spent(plan), min(spent(plan), spent(plan)),
            ))  # fmt: skip
        build, replace, check, again, first, second = (median(column) for column in zip(*times, strict=True))
        print(
            f"{count} points as {name}: built in {build:.1f} ms, replaced {replace:.3f} ms, first check {check:.2f} "
            f"ms, second {again:.3f} ms, first plan {first:.1f} ms, second {second:.2f} ms", flush=True,
        )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("points", nargs="?", type=int, default=50_000)
    count = parser.parse_args().points
    loewner.set_num_threads(1)
    robot = panda().robot
    moved_bodies(robot)
    camera(robot, count)


if __name__ == "__main__":
    main()
