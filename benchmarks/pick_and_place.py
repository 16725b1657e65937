"""Pick-and-place tasks by poses: candidates for grasps, lines, a lift and a carry, every motion proven.

    python benchmarks/pick_and_place.py [--tasks 100]

A Panda takes a can from a table, between boxes, and puts it on a shelf. A grasp is one of eight turns of the hand about
the can; the hand comes down along a line, lifts along a line, and puts down along a line. Times are processor times on
one thread, from the finished scene to the last proof.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from clock import threads_set_to
from loewner import Body, CollisionChecker, PlanningError, Robot, Scene, Verdict, planners
from rivals import Missing
from robot_samples import panda
from samples import Array

HAND, FINGERS = "panda_hand", ("panda_leftfinger", "panda_rightfinger")
RADIUS, LENGTH = 0.03, 0.12  # of the can, metres
OPEN, CLOSED = 0.04, 0.0305
TIPS = 0.1034  # from the hand's origin to the middle between the finger tips
RISE, GRASPS, HIGHER = 0.1, 8, 0.04
TABLE, SHELF = 0.1, 0.3
TURNS = 2 * np.pi * np.arange(GRASPS) / GRASPS


def at(x: float, y: float, z: float) -> Array:
    """The pose of something that is upright."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def hands(can: Array) -> Array:
    """Poses of the hand that holds a can from above, shape (8, 4, 4)."""
    T = np.tile(can @ at(0, 0, HIGHER + TIPS), (GRASPS, 1, 1))
    c, s, zero, one = np.cos(TURNS), np.sin(TURNS), np.zeros(GRASPS), np.ones(GRASPS)
    T[:, :3, :3] = np.stack([c, s, zero, s, -c, zero, zero, zero, -one], axis=-1).reshape(-1, 3, 3)
    return T


def world(rng: np.random.Generator) -> tuple[Scene, Array, Array]:
    """A scene, where the can is, and where it is to be."""
    can = at(rng.uniform(0.4, 0.6), rng.uniform(-0.4, -0.1), TABLE + LENGTH / 2)
    shelf = at(rng.uniform(0.35, 0.5), rng.uniform(0.35, 0.45), SHELF + LENGTH / 2)
    scene = Scene(margin=0.002)
    scene.add("table", Body.box([0.6, 0.6, 0.02]), at(0.5, -0.2, TABLE - 0.01))
    scene.add("can", Body.cylinder(RADIUS, LENGTH), can)
    boards = np.array([[0.45, 0.45, SHELF - 0.01, 0.3, 0.3, 0.02], [0.45, 0.61, 0.3, 0.3, 0.02, 0.6]])
    scene.add("shelf", Body.boxes(*np.split(boards, 2, axis=1)))
    for k in range(4):
        place = np.append(rng.uniform([0.3, -0.45], [0.75, 0.05]), TABLE + 0.051)
        if np.hypot(*(place[:2] - can[:2, 3])) > 0.14:
            scene.add(f"box {k}", Body.box([0.06, 0.06, 0.1]), at(*place))
    return scene, can, shelf


def moved(hand: Array, up: float) -> Array:
    """The pose of a hand that is higher by so much."""
    return at(0, 0, up) @ hand


def by_a_line(checker: CollisionChecker, q: Array, ends: Array) -> tuple[Array, Array]:
    """A path to above one of several poses of the hand, and the line down to it."""
    goal = planners.PoseGoal(HAND, ends, approach=("world", [0.0, 0.0, -RISE]))
    found = planners.plan(checker, q, goal, joints="arm", full=True)
    return found.path[: found.approach + 1], found.path[found.approach :]


def solve(robot: Robot, scene: Scene, checker: CollisionChecker, can: Array, shelf: Array) -> list[Array]:
    """Plan all motions of a task, one after the other."""
    home = robot.configuration("default")
    home[-1] = OPEN
    path, down = by_a_line(checker, home, hands(can))
    closed = down[-1].copy()
    closed[-1] = CLOSED
    for finger in FINGERS:
        scene.reach("can", finger)
    close = np.stack([down[-1], closed])
    if checker.certify_edges(*close).verdict != Verdict.FREE:
        raise PlanningError("the hand cannot close")
    hand = robot.forward_kinematics(closed)[robot.link_names.index(HAND)]
    T_hand_can = np.linalg.inv(hand) @ can
    scene.attach("can", HAND, T_hand_can, touch_links=FINGERS, leave=["table"], reach=["shelf"])
    lift = planners.straight(checker, closed, HAND, moved(hand, RISE), joints="arm")
    turned = np.linalg.inv(hands(can)[0]) @ hands(can)  # the can may be turned about its axis
    carry, put = by_a_line(checker, lift[-1], shelf @ np.linalg.inv(can) @ hand @ turned)
    return [path, down, close, lift, carry, put]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=100)
    options = parser.parse_args(arguments)
    try:
        robot = panda().robot
    except Missing as missing:
        print(f"not run: {missing}")
        return 0
    seconds, motions, faults = [], 0, []
    with threads_set_to(1):
        for task in range(options.tasks):
            scene, can, shelf = world(np.random.default_rng(task))
            checker = CollisionChecker(robot, scene)
            began = time.process_time()
            try:
                solved = solve(robot, scene, checker, can, shelf)
            except PlanningError as error:
                faults.append(f"{task}: {error}")
                continue
            seconds.append(time.process_time() - began)
            motions += sum(len(path) - 1 for path in solved)
    print(f"{len(seconds)} of {options.tasks} tasks solved, {motions} motions, all proven")
    if seconds:
        low, middle, high = 1e3 * np.percentile(seconds, [50, 95, 100])
        print(f"ms for a task: median {low:.3g}, 95 % {middle:.3g}, most {high:.3g}")
    print("\n".join(faults))
    return 0


if __name__ == "__main__":
    sys.exit(main())
