"""An obstacle that moves while the robot does: the scene is changed and asked again, over and over.

python examples/moving_obstacle.py [--steps 2000]
"""

import argparse
import time

import numpy as np

import loewner
from robot_meshes import panda_robot


def main() -> None:
    """Let a ball circle around a moving arm."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=2000)
    steps = parser.parse_args().steps

    robot = panda_robot()
    scene = loewner.Scene(margin=0.02)
    scene.add("ball", loewner.Body.sphere(0.1))
    scene.add("table", loewner.Body.box([1.6, 1.6, 0.02]), at(0.0, 0.0, -0.02))
    scene.allow("table", "panda_link0")
    checker = loewner.CollisionChecker(robot, scene)

    turns = np.linspace(0, 4 * np.pi, steps)
    Q = robot.configuration("default") + np.zeros((steps, robot.dof))
    Q[:, 0] = 0.5 * np.sin(turns)
    places = np.stack([0.4 * np.cos(turns / 2), 0.4 * np.sin(turns / 2), 0.5 + 0.2 * np.sin(3 * turns)], axis=1)

    checker.collide(Q[0])  # compiles, if this machine has not before
    near = np.zeros(steps, dtype=bool)
    started = time.perf_counter()
    for k in range(steps):
        scene.move("ball", at(*places[k]))
        near[k] = checker.collide(Q[k])
    seconds = time.perf_counter() - started
    print(f"{steps} moves and checks, {1e6 * seconds / steps:.0f} us each: {steps / seconds:,.0f} a second")
    print(f"too near at {near.sum()} of {steps} steps")
    if near.any():
        first = int(near.argmax())
        scene.move("ball", at(*places[first]))
        for contact in checker.pairs(Q[first]):
            print(f"step {first}: {contact.name_a} and {contact.name_b}, {1e3 * contact.distance:.1f} mm apart")


def at(x: float, y: float, z: float) -> np.ndarray:
    """A place without a turn."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


if __name__ == "__main__":
    main()
