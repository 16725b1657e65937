"""Stops of chunks of joint targets, as controllers make them: how many leave the proven path, and how many collide.

    python benchmarks/stops.py [--chunks 300]

A Panda among ten boxes runs chunks of 50 targets at 50 Hz. At each target up to which its path is proven free, the
chunk is stopped in several ways; each stop is a curve, which is proven or collides. What is known of the programs:

- ros2_controllers' JointTrajectoryController holds the position at which it is cancelled (`set_hold_position`): the
  command stops at once. A drive that limits decelerations brakes joint by joint, at its limits at best, and returns.
- With `decelerate_on_cancel` (pull request 2163), each joint decelerates at its own constant rate: joint by joint.
- LeRobot's `max_relative_target` clips each joint's step by itself, so a chunk moves in other directions than its
  targets. Here the robot reaches every target that it is sent.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from loewner import Body, CollisionChecker, Robot, Scene, Verdict
from loewner.planners import Trajectory, brake
from robot_samples import panda
from samples import Array

PERIOD, TARGETS = 0.02, 50  # s
MARGIN = 0.01  # m
# The data sheet's limits of acceleration (rad/s², the finger m/s²), and jerk in units of them per second.
STATED, JERK = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0, 5.0]), 500.0
SHARES = {"joint by joint, at the limits": 1.0, "joint by joint, a half": 0.5, "joint by joint, a quarter": 0.25}
# Share of the largest step of a chunk at which steps are clipped.
CLIPS = (0.75, 0.5)
# A stop leaves the path if it is farther from it than this (rad).
OFF = 1e-3


def cell(seed: int = 4) -> tuple[CollisionChecker, CollisionChecker]:
    """A Panda among ten boxes: with the margin, and without."""
    robot, rng, checkers = panda().robot, np.random.default_rng(seed), []
    boxes = []
    for _ in range(10):
        angle, radius = rng.uniform(0, 2 * np.pi), rng.uniform(0.45, 0.9)
        T = np.eye(4)
        T[:3, 3] = radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0.1, 0.9)
        boxes.append((Body.box(rng.uniform(0.05, 0.25, 3)), T))
    for margin in (MARGIN, 0.0):
        scene = Scene(margin=margin)
        for k, (box, T) in enumerate(boxes):
            scene.add(f"box {k}", box, T)
        checkers.append(CollisionChecker(robot, scene))
    return checkers[0], checkers[1]


def chunks(checker: CollisionChecker, count: int, seed: int = 4) -> list[Array]:
    """Targets that begin at free configurations, with random velocities that change slowly."""
    robot, rng = checker.robot, np.random.default_rng(seed)
    Q = robot.random_configurations(8 * count, seed=2)
    t, found = PERIOD * np.arange(TARGETS + 1), []
    for q in Q[~checker.collide(Q)][:count]:
        v, w = 0.8 * rng.normal(size=robot.dof), 0.5 * rng.normal(size=robot.dof)
        v[-1] = w[-1] = 0.0  # the fingers rest
        found.append(np.clip(q + np.outer(t, v) + 0.5 * np.outer(np.sin(2 * t), w), robot.lower, robot.upper))
    return found


def off_path(path: Array, points: Array) -> float:
    """The largest distance of points from a path of straight motions, continued beyond its end [rad]."""
    a, ways = path[:-1], np.diff(path, axis=0)
    lengths = np.maximum((ways**2).sum(axis=1), 1e-300)
    shares = np.maximum(np.einsum("nmc,mc->nm", points[:, None] - a, ways) / lengths, 0.0)
    shares[:, :-1] = np.minimum(shares[:, :-1], 1.0)
    return float(np.linalg.norm(points[:, None] - a - shares[..., None] * ways, axis=2).min(axis=1).max())


def clipped(targets: Array, most: float) -> Array:
    """The configurations that a robot reaches if each joint's step is clipped."""
    rows = [targets[0]]
    for target in targets[1:]:
        rows.append(rows[-1] + np.clip(target - rows[-1], -most, most))
    return np.array(rows)


def stops_of(robot: Robot, targets: Array, ticks: range) -> dict[str, list[Trajectory]]:
    """The brakes of a chunk from some of its targets on, in several ways."""
    chunk = Trajectory.of_targets(robot, targets, PERIOD)
    velocities = np.diff(targets, axis=0) / PERIOD
    found = {
        f"on the path, {name}": [
            chunk.stop_at(chunk.times[k], beyond=True, acceleration=share * STATED, jerk=jerk) for k in ticks
        ]
        for name, share, jerk in (("a half", 0.5, None), ("a half, with jerk", 0.5, 0.5 * JERK * STATED))
    }
    for name, share in SHARES.items():
        # Until a target is reached, the robot has the velocity of the motion towards it.
        found[name] = [brake(robot, targets[k], velocities[k - 1], acceleration=share * STATED) for k in ticks]
    found["joint by joint, a half, with jerk"] = [
        brake(robot, targets[k], velocities[k - 1], acceleration=0.5 * STATED, jerk=0.5 * JERK * STATED) for k in ticks
    ]
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chunks", type=int, default=300, help="number of chunks (300)")
    count = parser.parse_args().chunks
    wide, narrow = cell()
    robot, tallies, farthest = wide.robot, Counter[tuple[str, str]](), dict[str, float]()
    clips = Counter[tuple[float, str]]()
    for targets in chunks(wide, count):
        free = wide.certify_edges(targets[:-1], targets[1:]).verdict == Verdict.FREE
        proven = int(np.argmin(np.append(free, False)))
        ticks = range(1, proven + 1)
        found = stops_of(robot, targets, ticks)
        # The path on which the robot comes to rest is proven, too, unless it goes on beyond the proven targets.
        kept = [one.certify(wide).verdict == Verdict.FREE for one in found["on the path, a half"]]
        for name, stops in found.items():
            within, touching = wide.certify_trajectory(stops), narrow.certify_trajectory(stops)
            for k, stop, margin, contact, free_on_path in zip(ticks, stops, within, touching, kept, strict=True):
                off = off_path(targets[k - 1 :], stop.positions(np.linspace(0.0, stop.duration, 21)))
                farthest[name] = max(farthest.get(name, 0.0), off)
                hits = contact.verdict == Verdict.COLLIDING
                near = margin.verdict == Verdict.COLLIDING
                tallies.update(
                    (name, key)
                    for key, counts in (
                        ("stops", True), ("leave", off > OFF), ("within", near), ("hit", hits),
                        ("beside", free_on_path),
                        ("beside leave", free_on_path and off > OFF), ("beside within", free_on_path and near),
                        ("beside hit", free_on_path and hits),
                    )
                    if counts
                )  # fmt: skip
        if free.all():
            for share in CLIPS:
                rows = clipped(targets, share * float(np.abs(np.diff(targets, axis=0)).max()))
                verdicts = [c.certify_edges(rows[:-1], rows[1:]).verdict == Verdict.COLLIDING for c in (wide, narrow)]
                left = off_path(targets, rows) > OFF
                clips.update((share, key) for key, counts in
                             (("chunks", True), ("leave", left), ("within", verdicts[0].any()),
                              ("hit", verdicts[1].any())) if counts)  # fmt: skip
    print(f"{count} chunks; stops at targets up to which the chunk is proven free with {1000 * MARGIN:g} mm\n")
    columns = ("stops", "leave", "within", "hit", "beside", "beside leave", "beside within", "beside hit")
    print(f"{'stop':42}" + "".join(f"{name:>15}" for name in columns) + f"{'off, rad':>10}")
    for name, off in farthest.items():
        print(f"{name:42}" + "".join(f"{tallies[name, key]:15}" for key in columns) + f"{off:10.3f}")
    print("\nbeside: those for which the stop on the path with half of the limits is proven free\n")
    for share in CLIPS:
        keys = ("chunks", "leave", "within", "hit")
        print(f"steps clipped at {share:g} of the largest: " + ", ".join(f"{key} {clips[share, key]}" for key in keys))


if __name__ == "__main__":
    main()
