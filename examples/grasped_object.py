"""A can in the gripper: once it is attached to the hand, it collides where the empty hand would not.

python examples/grasped_object.py
"""

import numpy as np

import loewner
from robot_meshes import panda_robot

FINGERS = ("panda_leftfinger", "panda_rightfinger")


def main() -> None:
    """Grasp a can, swing it into a post that the empty hand passes above, put it down."""
    robot = panda_robot()
    open_hand = robot.configuration("default")
    open_hand[robot.configuration_names.index("panda_finger_joint1")] = 0.04
    links = dict(zip(robot.link_names, robot.forward_kinematics(open_hand), strict=True))
    T_world_can = np.eye(4)
    T_world_can[:3, 3] = links["panda_hand_tcp"][:3, 3]  # between the finger tips, which point down

    scene = loewner.Scene()
    scene.add("can", loewner.Body.cylinder(radius=0.03, length=0.06), T_world_can)
    scene.add("post", loewner.Body.box([0.05, 0.05, 0.3]), post(T_world_can))
    checker = loewner.CollisionChecker(robot, scene)
    grasp = open_hand.copy()
    grasp[-1] = 0.029  # each finger presses a millimetre into the can
    report("hand open around the can", checker, open_hand)
    report("hand closed on it", checker, grasp)

    # From now on the can is part of the robot, and the fingers may touch it.
    T_hand_can = np.linalg.inv(links["panda_hand"]) @ T_world_can
    scene.attach("can", "panda_hand", T_hand_can, touch_links=FINGERS)
    report("can attached to the hand", checker, grasp)
    swing = grasp + np.linspace(0, 1.5, 300)[:, None] * np.eye(robot.dof)[0]
    hit = checker.collide(swing)
    print(f"swinging with the can: {hit.sum()} of {len(swing)} configurations collide")
    report("    the first of them", checker, swing[hit.argmax()])

    # Put down at the end of the swing, the can stands in the way of the hand; taken away, it does not.
    T_world_hand = robot.forward_kinematics(swing[-1])[robot.link_names.index("panda_hand")]
    scene.detach("can", T_world_hand @ T_hand_can)
    back = swing[::-1].copy()
    back[:, -1] = 0.04
    print(f"swinging back, the can put down: {checker.collide(back).sum()} collide")
    scene.remove("can")
    print(f"swinging back, the can taken away: {checker.collide(back).sum()} collide")


def post(T_world_can: np.ndarray) -> np.ndarray:
    """A place at the hand's height, a turn of 0.8 rad away, that reaches to 2.5 cm below the can's middle."""
    c, s = np.cos(0.8), np.sin(0.8)
    x, y, z = T_world_can[:3, 3]
    T = np.eye(4)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = c * x - s * y, s * x + c * y, z - 0.025 - 0.15
    return T


def report(what: str, checker: loewner.CollisionChecker, q: np.ndarray) -> None:
    """Print what touches."""
    touching = ", ".join(f"{contact.name_a} and {contact.name_b}" for contact in checker.pairs(q))
    print(f"{what}: {touching or 'free'}")


if __name__ == "__main__":
    main()
