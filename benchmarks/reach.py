"""Inverse kinematics beside SciPy's least squares, in one run; and poses among obstacles.

    python benchmarks/reach.py [--quick] [--out FOLDER]

Poses come from forward kinematics at random configurations, so all can be reached. SciPy minimises the
differences of the poses' entries, by our forward kinematics, and gets the same number of starts, one after the other,
until one succeeds. Times are processor times on one thread, ours the best of several rounds.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import report
from clock import threads_set_to
from loewner import CollisionChecker, Robot
from loewner.robots.description.robot import chain_to
from rivals import Missing
from robot_samples import example, obstacles, panda, robots_folder, talos
from samples import Array

HERE = Path(__file__).parent

# A pose is reached to this, in metres and radians.
PRECISE = 1e-9
POSES, RIVALS_POSES, ROUNDS, SEEDS = 1000, 20, 5, 64
AMONG_OBSTACLES = 100

DRIVE = (
    '<link name="ground"/><joint name="drive" type="planar"><parent link="ground"/><child link="world"/>'
    '<axis xyz="0 0 1"/></joint></robot>'
)


def cases() -> dict[str, tuple[Robot, str, list[str] | None]]:
    """Robots, the link that is to be placed, and the joints that may move."""
    folder = robots_folder()
    ur5 = example("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf")
    baxter = Robot.from_urdf(folder / "baxter_description/urdf/baxter.urdf", package_dirs=[folder.parents[1]])
    mobile = Robot.from_urdf(
        text=ur5.urdf.read_text().replace("</robot>", DRIVE), package_dirs=[folder.parents[1]]
    )  # fmt: skip
    humanoid = talos().robot
    return {
        "panda": (panda().robot, "panda_hand", None),
        "ur5": (ur5.robot, "tool0", None),
        "talos, left arm": (humanoid, "arm_left_7_link", [f"arm_left_{k}_joint" for k in range(1, 8)]),
        "baxter, left arm": (baxter, "left_gripper", [f"left_{k}" for k in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]),
        "ur5 on wheels": (mobile, "tool0", None),
    }


def targets(robot: Robot, link: str, joints: list[str] | None, count: int) -> Array:
    """Poses of a link where only these joints are moved at random."""
    Q = robot.random_configurations(count, 1)
    if joints is not None:
        still = [k for k, name in enumerate(robot.configuration_names) if name not in joints]
        Q[:, still] = robot.configuration().clip(robot.lower, robot.upper)[still]
    return np.ascontiguousarray(robot.forward_kinematics(Q)[:, robot.link_names.index(link)])


def best(run: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time of a call, the best of some, and its result."""
    least, found = np.inf, run()
    for _ in range(ROUNDS):
        began = time.process_time()
        found = run()
        least = min(least, time.process_time() - began)
    return least, found


def missed(robot: Robot, link: str, Q: Array, T: Array) -> Array:
    """Largest difference of an entry of each pose from its target."""
    return np.abs(robot.forward_kinematics(Q)[:, robot.link_names.index(link)] - T).max(axis=(1, 2))


def by_scipy(robot: Robot, link: str, joints: list[str] | None, T: Array) -> tuple[float, float]:
    """Seconds for a pose, and the share that was reached."""
    chain = chain_to(robot, link, joints)
    columns = chain.columns[chain.moving]
    start, number = robot.configuration().clip(robot.lower, robot.upper), robot.link_names.index(link)
    drawn = robot.random_configurations(SEEDS, 2)
    began, reached = time.process_time(), 0
    for target in T:

        def residual(x: Array, target: Array = target) -> Array:
            q = start.copy()
            q[columns] = x
            D = robot.forward_kinematics(q)[number]
            return np.concatenate([D[:3, 3] - target[:3, 3], (D[:3, :3] - target[:3, :3]).ravel()])

        for seed in drawn:
            found = least_squares(
                residual, seed[columns], bounds=(robot.lower[columns], robot.upper[columns]), xtol=1e-14, ftol=1e-14,
                gtol=1e-14,
            )  # fmt: skip
            if np.abs(found.fun).max() < PRECISE:
                reached += 1
                break
    return (time.process_time() - began) / len(T), reached / len(T)


def rows(quick: bool) -> list[dict[str, Any]]:
    """Measure all robots."""
    count, few = (50, 1) if quick else (POSES, RIVALS_POSES)
    made = []
    for name, (robot, link, joints) in cases().items():
        T = targets(robot, link, joints, count)
        seconds, found = best(lambda T=T, robot=robot, link=link, joints=joints: robot.reach(link, T, joints=joints))
        off = missed(robot, link, found.configuration, T)
        theirs, share = by_scipy(robot, link, joints, T[:few])
        made.append({
            "robot": name, "poses": count, "reached": float((off < PRECISE).mean()), "us": 1e6 * seconds / count,
            "scipy_poses": few, "scipy_reached": share, "scipy_us": 1e6 * theirs, "ratio": theirs * count / seconds,
        })  # fmt: skip
        print(
            f"{name:18} {made[-1]['reached']:8.2%} of {count} reached, {made[-1]['us']:6.2f} us a pose; SciPy "
            f"{share:6.1%} of {few}, {1e6 * theirs:9.0f} us: ratio {made[-1]['ratio']:,.0f}", flush=True,
        )  # fmt: skip
    return made


def among_obstacles(quick: bool) -> dict[str, Any]:
    """Free solutions for a Panda among ten obstacles, confirmed by `collide`."""
    robot = panda().robot
    checker = CollisionChecker(robot, obstacles(0))
    Q = robot.random_configurations(2000, 3)
    hand = robot.link_names.index("panda_hand")
    count = 20 if quick else AMONG_OBSTACLES
    T = np.ascontiguousarray(robot.forward_kinematics(Q[~checker.collide(Q)][:count])[:, hand])
    seconds, found = best(lambda: robot.reach("panda_hand", T, checker=checker))
    free = found.reached & ~checker.collide(found.configuration)
    print(f"among obstacles: {free.mean():.1%} of {count} free, {1e3 * seconds:.3g} ms in all")
    return {"robot": "panda among ten obstacles", "poses": count, "reached": float(free.mean()),
            "us": 1e6 * seconds / count}  # fmt: skip


def all_of_ur5(quick: bool) -> dict[str, Any]:
    """All solutions of a UR5 from 256 seeds, whose number is even and at most eight."""
    robot, link, _ = cases()["ur5"]
    count = 10 if quick else 200
    T = targets(robot, link, None, count)
    seconds, found = best(lambda: robot.reach(link, T, all=True, seeds=256))
    numbers = np.bincount([len(solutions) for solutions in found.solutions], minlength=9)
    print(f"all solutions of a UR5: {1e6 * seconds / count:.0f} us a pose; poses by number {numbers.tolist()}")
    return {"robot": "ur5, all solutions", "poses": count, "reached": float((numbers[::2].sum()) / count),
            "us": 1e6 * seconds / count}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few poses")
    parser.add_argument("--out", type=Path, help="folder for results")
    options = parser.parse_args(arguments)
    facts = report.machine()
    with threads_set_to(1):
        try:
            made = [*rows(options.quick), among_obstacles(options.quick), all_of_ur5(options.quick)]
        except Missing as missing:
            print(f"not run: {missing}")
            return 0
    path = (options.out or HERE / "results" / report.machine_name(facts)) / "reach.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, [*made[0], "commit", "date"], lineterminator="\n")
        writer.writeheader()
        for row in made:
            numbers = {key: f"{x:.4g}" if isinstance(x, float) else x for key, x in row.items()}
            writer.writerow(numbers | {"commit": facts["commit"], "date": facts["date"]})
    return 0


if __name__ == "__main__":
    sys.exit(main())
