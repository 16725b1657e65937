"""A bottle in the gripper, carried over a wall: planned with what is held, and every motion proven.

python examples/plan_with_grasped_object.py [--seed 0]
"""

import argparse

import numpy as np

import loewner
from loewner import Verdict, planners
from robot_meshes import panda_robot

FINGERS = ("panda_leftfinger", "panda_rightfinger")


def main() -> None:
    """Plan for the empty hand, see what its path would do to a bottle, and plan for both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed

    robot = panda_robot()
    start = robot.configuration("default")
    start[-1] = 0.029  # each finger presses a millimetre into the bottle
    goal = start.copy()
    goal[0] = 1.5  # a quarter of a turn, with the wall halfway
    links = dict(zip(robot.link_names, robot.forward_kinematics(start), strict=True))
    T_world_tips = links["panda_hand_tcp"]  # between the finger tips, which point down

    scene = loewner.Scene(margin=0.01)
    scene.add("wall", loewner.Body.box([0.3, 0.04, 1.0]), wall(T_world_tips))
    checker = loewner.CollisionChecker(robot, scene)

    # Without the bottle the way is straight, over the wall, from which all keeps a centimetre.
    empty = planners.plan(checker, start, goal, joints="arm", seed=seed)
    report("planned for the empty hand", checker, empty)

    # Held near its top, the bottle reaches 22 cm below the finger tips.
    T_world_bottle = np.eye(4)
    T_world_bottle[:3, 3] = T_world_tips[:3, 3] - [0.0, 0.0, 0.1]
    T_hand_bottle = np.linalg.inv(links["panda_hand"]) @ T_world_bottle
    bottle = loewner.Body.cylinder(radius=0.03, length=0.24)
    scene.add("bottle", bottle, T_world_bottle)
    scene.attach("bottle", "panda_hand", T_hand_bottle)
    try:
        planners.plan(checker, start, goal, joints="arm", seed=seed)
    except loewner.PlanningError as error:
        print(f"attached without touch links: {error}")

    # The fingers may touch what they hold; nothing else may, and it moves along.
    scene.detach("bottle", T_world_bottle)
    scene.attach("bottle", "panda_hand", T_hand_bottle, touch_links=FINGERS)
    report("the empty hand's path, with the bottle", checker, empty)
    path = planners.plan(checker, start, goal, joints="arm", seed=seed)
    report("planned with the bottle", checker, path)


def wall(T_world_tips: np.ndarray) -> np.ndarray:
    """A place halfway, lengthwise under the hand's way, with the top 5 cm below the finger tips."""
    c, s = np.cos(0.75), np.sin(0.75)
    x, y, z = T_world_tips[:3, 3]
    T = np.eye(4)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = c * x - s * y, s * x + c * y, z - 0.05 - 0.5
    return T


def report(what: str, checker: loewner.CollisionChecker, path: np.ndarray) -> None:
    """Print how long a path is, how many of its motions are proven, and what collides on the first that is not."""
    robot = checker.robot
    proofs = checker.certify_edges(path[:-1], path[1:])
    free = proofs.verdict == Verdict.FREE
    length = robot.distances(path[:-1], path[1:]).sum()
    print(f"{what}: {free.sum()} of {len(free)} motions proven free, {length:.2f} rad in all")
    if free.all():
        on_path = robot.between(path[:-1, None], path[1:, None], np.linspace(0, 1, 50)).reshape(-1, robot.dof)
        measured = checker.distance(on_path, exact=True)
        least = measured.distance.argmin()
        a, b = measured.names[least]
        print(
            f"    nearest, of {len(on_path)} configurations: {a} and {b}, {1e3 * measured.distance[least]:.1f} mm apart"
        )
        return
    k = int(free.argmin())
    a, b = proofs.names[k]
    print(f"    {a} and {b} come nearer than a centimetre at {proofs.fraction[k]:.0%} of motion {k}")


if __name__ == "__main__":
    main()
