"""A robot arm among 50,000 points, beside pinocchio with Coal's octree, in one run, on one thread.

    python benchmarks/clouds.py [points]

The points are on the faces of ten obstacles around the arm. The rival gets an octree of the cells that they are in, of
the same edge as our voxels, so that both answer the same question; building it is timed as well. Disagreements are
counted there, and of the balls with a loop over all points, body by body. Last, how many short motions are proven.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import coal
import numpy as np
import pinocchio as pin

import loewner
from loewner import Body, CollisionChecker, Robot, Scene, Verdict
from robot_rivals import Pinocchio
from robot_samples import obstacles, panda
from samples import Array

RADIUS, VOXEL = 0.01, 0.02  # metres
MANY, RIVALS, LOOPED = 100_000, 2_000, 60  # configurations
SHORT, MOTIONS = 0.1, 1000  # length in rad, and how many
ROUNDS = 3


def seen(count: int) -> Array:
    """Points on the faces of the obstacles, as many on each."""
    rng, scene, points = np.random.default_rng(0), obstacles(0), []
    for name in scene.names:
        (piece,), T = scene[name].pieces, scene.pose(name)
        corners = piece.vertices[piece.triangles]
        a, b, c = corners.transpose(1, 0, 2)
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        share = count // len(scene.names)
        k = rng.choice(len(area), share, p=area / area.sum())
        u, v = np.sqrt(rng.uniform(size=(share, 1))), rng.uniform(size=(share, 1))
        points.append(((1 - u) * a[k] + u * (1 - v) * b[k] + u * v * c[k]) @ T[:3, :3].T + T[:3, 3])
    return np.concatenate(points)


def best(run, rounds: int = ROUNDS) -> float:
    """Least processor seconds."""
    times = []
    for _ in range(rounds):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return min(times)


def once(run: Callable[[], object]) -> float:
    """Processor seconds, once."""
    start = time.process_time()
    run()
    return time.process_time() - start


def short_motions(robot: Robot, cloud: Body, Q: Array) -> tuple[Array, Array]:
    """Motions from some configurations to others near them, all free of a cloud."""
    scene = Scene()
    scene.add("seen", cloud)
    step = np.random.default_rng(2).normal(size=Q.shape)
    near = Q + SHORT * step / np.linalg.norm(step, axis=1, keepdims=True)
    near = np.clip(near, robot.lower, robot.upper)
    checker = CollisionChecker(robot, scene)
    free = np.flatnonzero(~(checker.collide(Q) | checker.collide(near)))[:MOTIONS]
    return Q[free], near[free]


def by_loop(robot: Robot, q: Array, points: Array) -> bool:
    """Whether a ball around any point meets any piece, one after another, without trees."""
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, 3] = points
    ball = Body.sphere(RADIUS)
    for name, body in robot.bodies.items():
        at = robot.forward_kinematics(q)[robot.link_names.index(name)]
        near = np.linalg.norm(points - (at[:3, :3] @ body.outer.center[0] + at[:3, 3]), axis=1) < 1.0
        if loewner.collide(body, at, ball, T[near]).any():
            return True
    return False


def octree_of(points: Array) -> coal.OcTree:
    """Coal's octree of the cells that points are in, by their middles."""
    cells = np.unique(np.floor(points / VOXEL), axis=0)
    return coal.makeOctree((cells + 0.5) * VOXEL, VOXEL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("points", nargs="?", type=int, default=50_000)
    count = parser.parse_args().points
    loewner.set_num_threads(1)
    points, arm = seen(count), panda()
    robot = arm.robot
    Q = robot.random_configurations(MANY, 1)
    balls = np.nan
    ends = short_motions(robot, Body.from_cloud(points, radius=RADIUS), Q)
    print(f"Panda among {count} points on ten obstacles, one thread, processor seconds, best of {ROUNDS}")
    for name, make in (
        (f"balls of {RADIUS} m", lambda: Body.from_cloud(points, radius=RADIUS)),
        (f"voxels of {VOXEL} m", lambda: Body.from_cloud(points, voxel=VOXEL)),
    ):
        body, scene = make(), Scene()
        scene.add("seen", body)
        checker = CollisionChecker(robot, scene)
        checker.collide(Q)

        def replace(scene: Scene = scene, body: Body = body, checker: CollisionChecker = checker) -> None:
            scene.replace("seen", body)
            checker.collide(Q[0])

        each = best(lambda checker=checker: checker.collide(Q)) / MANY
        hits = checker.collide(Q)
        print(f"{name}: {body}")
        first = once(lambda checker=checker: checker.certify_edges(ends[0][0], ends[1][0]))
        found = checker.certify_edges(*ends)
        proving = best(lambda checker=checker: checker.certify_edges(*ends)) / MOTIONS
        lower, exact = checker.clearance(ends[0]), checker.distance(ends[0], exact=True).distance
        print(f"  built {best(make) * 1e3:.1f} ms, replaced {best(replace) * 1e3:.1f} ms, {body.nbytes / 1e6:.1f} MB")
        print(f"  {each * 1e6:.2f} us a configuration, {1 / each:.0f} a second, {hits.mean():.1%} collide", flush=True)
        print(
            f"  of {MOTIONS} motions of {SHORT} rad between configurations free of the balls, "
            f"{(found.verdict == Verdict.FREE).mean():.1%} proven free, "
            f"{(found.verdict == Verdict.COLLIDING).mean():.1%} collide; {proving * 1e6:.0f} us each, the first call "
            f"{first * 1e3:.0f} ms; clearance {np.median(lower):.3f} m, exactly {np.median(exact):.3f} (medians)",
            flush=True,
        )
        if body.pieces[0].kind == "surface":
            balls = each
            differ = sum(by_loop(robot, q, points) != checker_hit for q, checker_hit in cloud_only(robot, body, Q))
            print(f"  against a loop over all points: {differ} of {LOOPED} differ", flush=True)
            continue
        rival = with_octree(robot, arm.urdf, points)
        P = rival.configurations(Q[:RIVALS])
        for way, check in rival.single.items():
            answers = np.array(in_turn(check, P))
            spent = best(partial(in_turn, check, P), 1) / RIVALS
            differ = int((answers != hits[:RIVALS]).sum())
            print(
                f"  pinocchio and Coal's octree, {way}: {spent * 1e6:.1f} us, {spent / each:.1f} times, and "
                f"{spent / balls:.1f} times the balls; {differ} of {RIVALS} differ",
                flush=True,
            )
        print(f"  Coal's octree built in {best(lambda: octree_of(points)) * 1e3:.1f} ms")


def in_turn(check: Callable[[Array, bool], bool], P: Array) -> list[bool]:
    return [check(q, True) for q in P]


def cloud_only(robot: Robot, body: Body, Q: Array) -> list[tuple[Array, bool]]:
    """Some configurations, half of them near the cloud, and whether links meet it; self-collisions are left out."""
    scene = Scene()
    scene.add("seen", body)
    skipped = [(a, b) for a in robot.bodies for b in robot.bodies if a < b]
    checker = CollisionChecker(robot, scene, allowed=skipped)
    hits = checker.collide(Q[: 20 * LOOPED])
    chosen = np.concatenate([np.flatnonzero(hits)[: LOOPED // 2], np.flatnonzero(~hits)[: LOOPED // 2]])
    return [(Q[k], bool(hits[k])) for k in chosen]


def with_octree(robot: Robot, urdf: object, points: Array) -> Pinocchio:
    """The rival with the arm alone, and then an octree that stands in the world."""
    checker = CollisionChecker(robot)
    rival = Pinocchio(checker, urdf)
    geometry = rival.geometry
    links = list(range(geometry.ngeoms))
    tree = geometry.addGeometryObject(pin.GeometryObject("seen", 0, 0, pin.SE3.Identity(), octree_of(points)))
    for link in links:
        geometry.addCollisionPair(pin.CollisionPair(link, tree))
    rival.prepare()
    return rival


if __name__ == "__main__":
    main()
