"""Mobile bases on five maps: trips of a car and of a differential base, beside OMPL's Reeds-Shepp and Dubins.

    python benchmarks/bases.py [--trips 100] [--rival-trips 20] [--samples 1000000]

The maps (a maze, an office, a parking lot, clutter and a warehouse) are written as ROS's map server writes them and
read by `Scene.from_map`; cells are compared with the scene, so a mirrored map would be noticed. Each drive is proven
again by `certify_trajectory`, and samples of it are compared with the courses of the proof and with `collide`. OMPL's
RRT-Connect plans the same trips of the car with the same collision check, at samples every 0.05 m. Prints the processor
time of each plan; one thread.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import loewner
from loewner import Body, CollisionChecker, PlanningError, Robot, Scene, Verdict, planners
from loewner.robots.proofs.courses import configurations
from loewner.robots.proofs.curves import form_of
from samples import Array

CELL, RADIUS, WALL = 0.05, 0.8, 0.2  # metres
LONGEST = 5.0  # seconds of wall time in comparisons
FOOTPRINT = [[0.6, 0.25], [-0.2, 0.25], [-0.2, -0.25], [0.6, -0.25]]
KINDS: tuple[dict[str, Any], ...] = ({"base": "car", "radius": RADIUS}, {"base": "differential"})


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trips", type=int, default=100)
    parser.add_argument("--rival-trips", type=int, default=20)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--maps", nargs="*", default=list(MAPS), choices=list(MAPS))
    options, threads = parser.parse_args(arguments), loewner.get_num_threads()
    loewner.set_num_threads(1)
    try:
        return compare(options)
    finally:
        loewner.set_num_threads(threads)


def compare(options: argparse.Namespace) -> int:
    """Plan all trips, print the tables, and return the exit status."""
    share = options.samples // (len(options.maps) * len(KINDS) * max(options.trips, 1)) + 1
    print(
        f"{'map':12} {'base':12} {'solved':>8} {'ms: median':>11} {'mean':>6} {'95 %':>6} {'length':>7} {'changes':>8}"
    )
    samples, off, hits, unproven, worst = 0, 0, 0, 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for name in options.maps:
            cells = MAPS[name]()
            checker = CollisionChecker(base(cells), read(Path(folder) / "map", cells))
            ends = free_poses(checker, cells, 2 * options.trips).reshape(-1, 2, 3)
            for kind in KINDS:
                drives, spent = planned(checker, ends, kind)
                row(name, kind["base"], spent, drives)
                for drive in drives:
                    unproven += checker.certify_trajectory(drive).verdict != Verdict.FREE
                    far, found = compared(checker, drive, share)
                    samples, off, worst = samples + len(far), off + int((far > 1.0).sum()), max(worst, far.max())
                    hits += found
            for space, reverse in (
                () if options.rival_trips == 0 else (("ReedsSheppStateSpace", True), ("DubinsStateSpace", False))
            ):
                rivals(name, checker, ends[: options.rival_trips], space, reverse)
    print(
        f"not proven: {unproven}; of {samples} samples {off} off the proven curve (the farthest at {worst:.2f} of what "
        f"the proof covers), {hits} in collision"
    )
    return int(bool(unproven or off or hits))


def row(name: str, kind: str, spent: Array, drives: list[Any]) -> None:
    milliseconds = 1e3 * np.array(spent)
    length = np.mean([drive.length for drive in drives]) if drives else math.nan
    changes = np.mean([drive.reversals for drive in drives]) if drives else math.nan
    print(
        f"{name:12} {kind:12} {len(drives):>4}/{len(spent):<3} {np.median(milliseconds):>11.1f} "
        f"{milliseconds.mean():>6.0f} {np.quantile(milliseconds, 0.95):>6.0f} {length:>7.2f} {changes:>8.2f}",
        flush=True,
    )


def planned(checker: CollisionChecker, ends: Array, kind: dict[str, Any]) -> tuple[list[Any], Array]:
    drives, spent = [], []
    for start, goal in ends:
        begin = time.process_time()
        try:
            drives.append(planners.plan(checker, start, goal, **{"timeout": 60.0, **kind}))
        except PlanningError as error:
            print(f"  not found: {start.round(2).tolist()} to {goal.round(2).tolist()}: {error}")
        spent.append(time.process_time() - begin)
    return drives, np.array(spent)


def compared(checker: CollisionChecker, drive: Any, count: int) -> tuple[Array, int]:
    """Deviations of samples from the proven courses, in units of what the proof covers, and samples that collide."""
    curve = form_of(drive, "drive")
    t = np.random.default_rng(0).uniform(0.0, drive.times[-1], count)
    k = np.searchsorted(curve.times, t, side="right") - 1
    shares = (t - curve.times[k]) / (curve.times[k + 1] - curve.times[k])
    driven = drive.positions(t)
    gaps = np.abs(configurations(checker.robot, curve.courses[k], shares) - driven)
    rounding = 64 * np.finfo(float).eps * (1 + drive.times[-1])  # of the times
    return (gaps / (curve.off[k] + rounding)).max(axis=1), int(checker.collide(driven).sum())


def rivals(name: str, checker: CollisionChecker, ends: Array, space_name: str, reverse: bool) -> None:
    """Plan by OMPL's RRT-Connect, simplified, and by ours, the same trips of the car."""
    try:
        from ompl import base as ob
        from ompl import geometric, util
    except ImportError:
        return
    util.setLogLevel(util.LogLevel.LOG_NONE)
    spent, solved, lengths, own_lengths = [], 0, [], []
    for start, goal in ends:
        begin = time.process_time()
        space = getattr(ob, space_name)(RADIUS)
        bounds = ob.RealVectorBounds(2)
        for axis in range(2):
            bounds.setLow(axis, float(checker.robot.lower[axis]))
            bounds.setHigh(axis, float(checker.robot.upper[axis]))
        space.setBounds(bounds)
        information = ob.SpaceInformation(space)

        def valid(state: Any) -> bool:
            return not checker.collide([state.getX(), state.getY(), state.getYaw()])

        information.setStateValidityChecker(valid)
        information.setStateValidityCheckingResolution(CELL / space.getMaximumExtent())
        information.setup()
        problem = ob.ProblemDefinition(information)
        states = []
        for pose in (start, goal):
            state = space.allocState()
            state.setX(float(pose[0]))
            state.setY(float(pose[1]))
            state.setYaw(float(pose[2]))
            states.append(state)
        problem.setStartAndGoalStates(*states)
        planner = geometric.RRTConnect(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        done = planner.solve(LONGEST)
        if done and problem.hasExactSolution():
            path = problem.getSolutionPath()
            geometric.PathSimplifier(information).reduceVertices(path)
            solved += 1
            lengths.append(path.length())
        spent.append(time.process_time() - begin)
    drives, own = planned(checker, ends, {"base": "car", "radius": RADIUS, "reverse": reverse, "timeout": LONGEST})
    own_lengths = [drive.length for drive in drives] or [math.nan]
    theirs = 1e3 * np.array(spent)
    print(
        f"{name:12} {space_name[:-10]:12} {solved:>4}/{len(ends):<3} {np.median(theirs):>11.1f} {theirs.mean():>6.0f} "
        f"{np.quantile(theirs, 0.95):>6.0f} {np.mean(lengths) if lengths else math.nan:>7.2f}  ours, the same trips: "
        f"{len(drives)}, median {1e3 * np.median(own):.1f} ms, mean {1e3 * np.mean(own):.0f}, "
        f"length {np.mean(own_lengths):.2f}; mean time {np.mean(spent) / np.mean(own):.1f} times ours",
        flush=True,
    )


def base(cells: Array) -> Robot:
    width, depth = (CELL * count for count in cells.shape)
    return Robot.footprint(FOOTPRINT, height=0.5, bounds=[[0.0, width], [0.0, depth]])


def free_poses(checker: CollisionChecker, cells: Array, count: int) -> Array:
    poses = np.random.default_rng(0).uniform([0, 0, -np.pi], [*(CELL * np.array(cells.shape)), np.pi], (20_000, 3))
    return poses[~checker.collide(poses)][:count]


def read(path: Path, cells: Array) -> Scene:
    """Write a map as map_server does, read it, and compare cells with the scene: it is not mirrored."""
    pixels = np.where(cells, 0, 254).astype("u1").T[::-1]
    path.with_suffix(".pgm").write_bytes(b"P5 %d %d 255\n" % pixels.shape[::-1] + pixels.tobytes())
    path.with_suffix(".yaml").write_text(
        f"{{image: {path.name}.pgm, resolution: {CELL}, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, "
        "free_thresh: 0.196}"
    )
    scene = Scene.from_map(path.with_suffix(".yaml"), height=1.0)
    places = np.random.default_rng(1).integers(0, cells.shape, (1000, 2))
    T = np.tile(np.eye(4), (len(places), 1, 1))
    T[:, :2, 3], T[:, 2, 3] = (places + 0.5) * CELL, 0.5
    found = loewner.collide(Body.sphere(CELL / 4), T, scene["map"], None)
    if not (found == cells[tuple(places.T)]).all():
        raise SystemExit("the map was read mirrored or turned")
    return scene


# -- maps: arrays of occupied cells --------------------------------------------------------------


def filled(cells: Array, x0: float, y0: float, x1: float, y1: float, value: bool = True) -> None:
    i0, j0, i1, j1 = (max(round(v / CELL), 0) for v in (x0, y0, x1, y1))
    cells[i0:i1, j0:j1] = value


def walled(width: float, depth: float) -> Array:
    cells = np.ones((round(width / CELL), round(depth / CELL)), dtype=bool)
    filled(cells, WALL, WALL, width - WALL, depth - WALL, False)
    return cells


def maze(columns: int = 8, rows: int = 6, pitch: float = 2.0) -> Array:
    """A spanning tree of rooms, with a seventh of the other walls open."""
    rng, cells = np.random.default_rng(1), walled(columns * pitch + WALL, rows * pitch + WALL)
    open_walls, seen, stack = set(), {(0, 0)}, [(0, 0)]
    while stack:
        x, y = stack[-1]
        near = [(x + a, y + b) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        near = [(i, j) for i, j in near if 0 <= i < columns and 0 <= j < rows and (i, j) not in seen]
        if not near:
            stack.pop()
            continue
        chosen = near[rng.integers(len(near))]
        seen.add(chosen)
        open_walls.add(frozenset([(x, y), chosen]))
        stack.append(chosen)
    for x in range(columns):
        for y in range(rows):
            right, above = frozenset([(x, y), (x + 1, y)]), frozenset([(x, y), (x, y + 1)])
            if x + 1 < columns and right not in open_walls and rng.random() > 0.15:
                filled(cells, (x + 1) * pitch, y * pitch, (x + 1) * pitch + WALL, (y + 1) * pitch + WALL)
            if y + 1 < rows and above not in open_walls and rng.random() > 0.15:
                filled(cells, x * pitch, (y + 1) * pitch, (x + 1) * pitch + WALL, (y + 1) * pitch + WALL)
    return cells


def office() -> Array:
    """Twelve rooms with doors of 1.3 m and tables, along a corridor."""
    rng, cells = np.random.default_rng(2), walled(24.0, 16.0)
    for low, high, front in ((0.0, 6.5, 6.5), (9.5, 16.0, 9.35)):
        filled(cells, 0.0, front, 24.0, front + 0.15)
        for x in range(0, 24, 4):
            filled(cells, x, low, x + 0.15, high)
            filled(cells, x + 1.4, front, x + 2.7, front + 0.15, False)
    for x in range(0, 24, 4):
        for y in (2.0, 13.0):
            filled(cells, x + 0.8 + rng.random(), y, x + 2.0 + rng.random(), y + 0.8)
    return cells


def parking_lot() -> Array:
    """Four rows of cars, with gaps between them."""
    rng, cells = np.random.default_rng(3), walled(20.0, 14.0)
    for y in (0.6, 4.6, 7.2, 11.2):
        for k in range(11):
            if rng.random() < 0.7:
                filled(cells, 1.4 + 1.6 * k, y, 2.4 + 1.6 * k, y + 1.8)
    return cells


def clutter() -> Array:
    rng, cells = np.random.default_rng(4), walled(16.0, 12.0)
    for _ in range(45):
        x, y = rng.uniform(0.5, 15.2), rng.uniform(0.5, 11.2)
        width, depth = rng.uniform(0.15, 0.8, 2)
        filled(cells, x, y, x + width, y + depth)
    return cells


def warehouse() -> Array:
    cells = walled(30.0, 20.0)
    for k in range(6):
        for m in range(3):
            filled(cells, 3 + 4.4 * k, 2.5 + 5.4 * m, 5.2 + 4.4 * k, 6.5 + 5.4 * m)
    return cells


MAPS = {"maze": maze, "office": office, "parking lot": parking_lot, "clutter": clutter, "warehouse": warehouse}

if __name__ == "__main__":
    raise SystemExit(main())
