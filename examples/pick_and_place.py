"""A can is picked up from a table and put on a shelf, beside what a camera sees: every motion is proven.

python examples/pick_and_place.py [--seed 0] [--out TRAJECTORY.csv]

A can that stands on a table touches it. While it is carried, that contact may end where it began, and the contact with
the shelf may begin where the can is put down; at all other times touching is colliding.
"""

import argparse

import numpy as np

import loewner
from loewner import Body, Verdict, planners
from robot_meshes import panda_robot

FINGERS = ("panda_leftfinger", "panda_rightfinger")
HAND, TIPS = "panda_hand", "panda_hand_tcp"  # the tips are a frame between the fingers
FINGER = 7

RADIUS, LENGTH = 0.03, 0.12  # of the can, metres
OPEN, CLOSED = 0.04, 0.0305  # of the fingers; closed, half a millimetre is left, which the gripper's force closes
TABLE_TOP, BOARD_TOP = 0.1, 0.3


def main() -> None:
    """Approach, close the hand, carry the can from the table to the shelf, let it go and move away."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="write the trajectory with the can (.csv)")
    options = parser.parse_args()

    robot, scene = panda_robot(), world(options.seed)
    checker = loewner.CollisionChecker(robot, scene)
    home = robot.configuration("default")
    home[FINGER] = OPEN

    # To the can from above, and the fingers to its sides: they come within the margin of it.
    can = at(0.5, -0.25, TABLE_TOP + LENGTH / 2)
    grasp = reach(robot, from_above(can), home)
    above = reach(robot, from_above(at(0, 0, 0.12) @ can), grasp)
    closed = grasp.copy()
    closed[FINGER] = CLOSED
    approach = planners.plan(checker, home, above, joints="arm", seed=options.seed)
    report("approach", checker, np.concatenate([approach, [grasp]]))
    for finger in FINGERS:
        scene.reach("can", finger)
    report("close", checker, np.array([grasp, closed]))

    # The can moves with the hand from now on. It has to leave the table, and may reach the shelf.
    T_hand_can = np.linalg.inv(pose(robot, closed, HAND)) @ can
    scene.attach("can", HAND, T_hand_can, touch_links=FINGERS, leave=["table"], reach=["shelf"])
    deeper = reach(robot, from_above(at(0, 0, -0.001) @ can), closed)
    found = checker.certify_edges(closed, deeper)
    print(f"a millimetre into the table: {found.verdict.name}, {' and '.join(found.names)}")
    shelf = at(0.45, 0.4, BOARD_TOP + LENGTH / 2)
    place = reach(robot, from_above(shelf), closed)
    carry = planners.plan(checker, closed, place, joints="arm", seed=options.seed)
    report("carry", checker, carry)
    trajectory = planners.trajectory(robot, carry, acceleration=2.0, checker=checker)
    print(f"with times: {trajectory.duration:.2f} s")
    if options.out:
        trajectory.save(options.out)

    # Where the hand let it go, the can stands on the shelf. The fingers have to leave it.
    scene.detach("can", shelf)
    for finger in FINGERS:
        scene.leave("can", finger)
    opened = place.copy()
    opened[FINGER] = OPEN
    report("open", checker, np.array([place, opened]))
    away = reach(robot, from_above(at(0, 0, 0.12) @ shelf), opened)
    retreat = planners.plan(checker, away, home, joints="arm", seed=options.seed)
    report("retreat", checker, np.concatenate([[opened], retreat]))


def world(seed: int) -> loewner.Scene:
    """A table with a can on it, a shelf, and the points of something that a camera sees between them."""
    scene = loewner.Scene(margin=0.002)
    scene.add("table", Body.box([0.6, 0.5, 0.02]), at(0.5, -0.2, TABLE_TOP - 0.01))
    scene.add("can", Body.cylinder(RADIUS, LENGTH), at(0.5, -0.25, TABLE_TOP + LENGTH / 2))
    boards = [[0.45, 0.45, BOARD_TOP - 0.01, 0.3, 0.3, 0.02], [0.45, 0.61, 0.3, 0.3, 0.02, 0.6]]
    scene.add("shelf", Body.boxes(*np.split(np.array(boards), 2, axis=1)))
    points = np.random.default_rng(seed).uniform([0.4, 0.1, 0.1], [0.55, 0.16, 0.35], size=(2000, 3))
    scene.add("camera", Body.from_cloud(points, radius=0.01))
    return scene


def at(x: float, y: float, z: float) -> np.ndarray:
    """The pose of something that is upright."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def from_above(T_world_can: np.ndarray) -> np.ndarray:
    """Where the finger tips are to be: 4 cm above the can's middle, pointing down, the fingers along y."""
    T: np.ndarray = T_world_can @ at(0, 0, 0.04)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    return T


def reach(robot: loewner.Robot, T: np.ndarray, start: np.ndarray) -> np.ndarray:
    """A configuration near `start` with the finger tips at T; only the arm moves."""
    found = robot.reach(TIPS, T, joints="arm", start=start)
    if not found.reached:
        raise SystemExit(f"no configuration within the limits was found for {T[:3, 3]}")
    return found.configuration


def pose(robot: loewner.Robot, q: np.ndarray, link: str) -> np.ndarray:
    """Pose of a link in the world."""
    T: np.ndarray = robot.forward_kinematics(q)[robot.link_names.index(link)]
    return T


def report(what: str, checker: loewner.CollisionChecker, path: np.ndarray) -> None:
    """Print how many motions of a path are proven free."""
    proofs = checker.certify_edges(path[:-1], path[1:])
    free = proofs.verdict == Verdict.FREE
    print(f"{what}: {free.sum()} of {len(free)} motions proven free")
    if not free.all():
        k = int(free.argmin())
        print(f"    motion {k}: {Verdict(int(proofs.verdict[k])).name}, {' and '.join(proofs.names[k])}")


if __name__ == "__main__":
    main()
