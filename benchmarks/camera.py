"""A camera beside a Panda: the robot's own points, unseen space, and plans into what was seen, frame by frame.

    python benchmarks/camera.py [--frames 200] [--points 50000]

Depth images are cast against the convex pieces of the robot and of boxes. Prints the processor time of each stage
beside a loop over the links, and counts points of the robot that stay, points of boxes that are lost although they are
farther than `clear` from the robot, and plans whose robot is in a cell that no ray has passed. One thread.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import loewner
from loewner import Body, CollisionChecker, Robot, Scene, planners
from loewner.depth import SeenSpace, points_of
from robot_samples import panda
from samples import Array

CLEAR, NOISE, VOXEL, CELL = 0.03, 0.002, 0.02, 0.04  # metres
LOW, CELLS = np.array([-0.9, -0.9, -0.1]), (45, 45, 32)
BOXES = [
    ([0.6, 0.0, -0.06], [1.0, 1.6, 0.04]),
    ([0.55, 0.3, 0.2], [0.15, 0.15, 0.4]),
    ([0.3, -0.6, 0.5], [0.3, 0.1, 0.3]),
]
STAGES = ("points", "off the robot", "by a loop over links", "voxels", "see", "unseen body", "first check", "plan")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--points", type=int, default=50_000)
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(0)
    robot = panda().robot
    world = [(Body.box(size), at(place)) for place, size in BOXES]
    width = round(np.sqrt(options.points * 4 / 3))
    focal = 0.9 * width
    K = np.array([[focal, 0, width / 2], [0, focal, width * 3 / 8], [0, 0, 1]])
    rays = rays_of((width * 3 // 4, width), K)
    spent: dict[str, list[float]] = {name: [] for name in STAGES}
    left = lost = entered = planned = 0
    scene = Scene(margin=0.005)
    for name in ("camera", "unknown"):
        scene.add(name, Body.box([0.01] * 3), at([9, 9, 9]))
        scene.allow(name, "panda_link0")
    checker, space = CollisionChecker(robot, scene), SeenSpace(LOW, CELLS, CELL)
    ground = CollisionChecker(robot, placed(world))
    Q = robot.random_configurations(60 * options.frames, seed=1)
    Q = Q[~ground.collide(Q)][: options.frames + 1]
    for k, q in enumerate(Q[:-1]):
        T = looking(np.array([1.6, rng.uniform(-1.2, 1.2), rng.uniform(0.6, 1.6)]), np.array([0.3, 0.0, 0.3]))
        mine, others = (cast(bodies, rays, T) for bodies in (links(robot, q), world))
        depth = np.minimum(mine, others) + rng.uniform(-NOISE, NOISE, mine.shape)
        depth[~np.isfinite(depth)] = 3.0  # a wall
        clock = Clock(spent)
        image = clock("points", points_of, depth, K, T)
        stays = clock("off the robot", checker.off_the_robot, image, q, clear=CLEAR, mask=True)
        naive = clock("by a loop over links", by_loop, robot, image.reshape(-1, 3), q)
        assert (stays.ravel() == naive).all()
        body = clock("voxels", Body.from_cloud, image[stays], voxel=VOXEL)
        left += int((stays & (mine < others)).sum())
        lost += int((~stays & (others < mine) & (beyond(robot, image, q, ~stays & (others < mine)) > CLEAR)).sum())
        clock("see", space.see, depth - NOISE, K, T)
        unseen = clock("unseen body", space.body, checker, q, clear=CLEAR)
        scene.replace("camera", body)
        scene.move("camera", np.eye(4))
        scene.replace("unknown", unseen)
        scene.move("unknown", np.eye(4))
        if clock("first check", checker.collide, q):
            continue
        goals = q + rng.uniform(-0.4, 0.4, (20, len(q)))
        goals = np.clip(goals, robot.lower, robot.upper)
        goals = goals[~checker.collide(goals)]
        if len(goals):
            path = clock("plan", plan, checker, q, goals[0], k)
            if path is not None:
                planned += 1
                entered += enters(robot, path, q, space)
    for name, times in spent.items():
        print(f"{name:22} {np.median(times):8.2f} ms  {np.max(times):8.2f} ms at most   ({len(times)})")
    print(f"points of the robot that stay: {left}; points of boxes lost beyond {CLEAR} m: {lost}")
    print(f"plans: {planned}; in a cell that no ray has passed: {entered}")
    return 0


class Clock:
    """Processor times of stages."""

    def __init__(self, spent: dict[str, list[float]]) -> None:
        self.spent = spent

    def __call__(self, stage: str, run: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        begin = time.process_time_ns()
        result = run(*arguments, **named)
        self.spent[stage].append((time.process_time_ns() - begin) / 1e6)
        return result


def plan(checker: CollisionChecker, start: Array, goal: Array, seed: int) -> Array | None:
    """A plan, if there is one."""
    try:
        return planners.plan(checker, start, goal, seed=seed, max_iterations=2000)
    except loewner.PlanningError:
        return None


def by_loop(robot: Robot, points: Array, q: Array) -> Array:
    """The points that stay, one link after another with all points."""
    poses, ball, stays = robot.forward_kinematics(q), Body.sphere(CLEAR), np.ones(len(points), bool)
    for name, body in robot.bodies.items():
        some = np.flatnonzero(stays)
        T = np.tile(np.eye(4), (len(some), 1, 1))
        T[:, :3, 3] = points[some]
        stays[some[loewner.collide(ball, T, body, poses[robot.link_names.index(name)])]] = False
    return stays


def beyond(robot: Robot, image: Array, q: Array, chosen: Array) -> Array:
    """Distances of chosen points from the robot."""
    poses, found = robot.forward_kinematics(q), np.full(image.shape[:-1], np.inf)
    T = np.tile(np.eye(4), (int(chosen.sum()), 1, 1))
    T[:, :3, 3] = image[chosen]
    for name, body in robot.bodies.items():
        some = loewner.distance(Body.sphere(1e-9), T, body, poses[robot.link_names.index(name)], exact=True).distance
        found[chosen] = np.minimum(found[chosen], some)
    return found


def enters(robot: Robot, path: Array, start: Array, space: SeenSpace) -> bool:
    """Whether a vertex of the robot is in an unseen cell along a path, other than those at its start."""
    Q = np.concatenate([a + (b - a) * np.linspace(0, 1, 40)[:, None] for a, b in zip(path[:-1], path[1:], strict=True)])
    cells = space.unknown.copy()
    where = np.nonzero(cells)
    checker = CollisionChecker(robot)
    cells[where] = checker.off_the_robot(space.centers[where], start, clear=CLEAR + CELL * 0.87, mask=True)
    for name, body in robot.bodies.items():
        if name == "panda_link0":
            continue
        poses = robot.forward_kinematics(Q)[:, robot.link_names.index(name)]
        corners = np.concatenate([p.vertices for p in body.pieces])
        places = corners @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        index = np.floor((places - LOW) / CELL).astype(int).reshape(-1, 3)
        index = index[((index >= 0) & (index < CELLS)).all(axis=1)]
        if cells[tuple(index.T)].any():
            return True
    return False


def links(robot: Robot, q: Array) -> list[tuple[Body, Array]]:
    poses = robot.forward_kinematics(q)
    return [(body, poses[robot.link_names.index(name)]) for name, body in robot.bodies.items()]


def placed(world: list[tuple[Body, Array]]) -> Scene:
    scene = Scene()
    for k, (body, T) in enumerate(world):
        scene.add(f"box {k}", body, T)
        scene.allow(f"box {k}", "panda_link0")
    return scene


def rays_of(shape: tuple[int, int], K: Array) -> Array:
    """Directions of the pixels, whose depth is 1."""
    v, u = np.indices(shape)
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(shape)], axis=-1)


def cast(bodies: list[tuple[Body, Array]], rays: Array, T_camera: Array) -> Array:
    """Depths of polytopes in an image, infinite where there is none."""
    depths = np.full(rays.shape[:2], np.inf)
    flat = rays.reshape(-1, 3)
    for body, T in bodies:
        local = np.linalg.inv(T) @ T_camera
        for piece in body.pieces:
            down = piece.normals @ local[:3, :3]
            center = local[:3, :3].T @ (piece.outer.center - local[:3, 3])
            reach = piece.outer.semi_axes.max()
            near = np.linalg.norm(np.cross(flat, center), axis=1) <= reach * np.linalg.norm(flat, axis=1)
            slopes = flat[near] @ down.T
            room = piece.offsets - piece.normals @ local[:3, 3]
            with np.errstate(divide="ignore", invalid="ignore"):
                t = room / slopes
            enter = np.where(slopes < 0, t, -np.inf).max(axis=1)
            leave = np.where(slopes > 0, t, np.inf).min(axis=1)
            hit = (enter < leave) & (enter > 0)
            depths.reshape(-1)[np.flatnonzero(near)[hit]] = np.minimum(
                depths.reshape(-1)[np.flatnonzero(near)[hit]], enter[hit]
            )
    return depths


def looking(place: Array, target: Array) -> Array:
    """A pose whose z axis points at a target, with y down."""
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), place
    return T


def at(place: list[float]) -> Array:
    T = np.eye(4)
    T[:3, 3] = place
    return T


if __name__ == "__main__":
    raise SystemExit(main())
