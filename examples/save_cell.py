"""Save an arm in a small scene for programs in C and C++: python examples/save_cell.py cell.lwn, then query.c."""

import sys

import numpy as np

from loewner import Body, CollisionChecker, Scene
from robot_meshes import panda_robot

scene = Scene(margin=0.005)
for k, place in enumerate([(0.5, 0.0, 0.2), (0.4, 0.4, 0.5), (-0.3, 0.5, 0.4)]):
    T = np.eye(4)
    T[:3, 3] = place
    scene.add(f"box {k}", Body.box([0.15, 0.15, 0.15]), T)
robot = panda_robot()
path = sys.argv[1] if len(sys.argv) > 1 else "cell.lwn"
CollisionChecker(robot, scene).save(path)
Body.box([0.04, 0.04, 0.1]).save("parts.lwn")
print(f"{path}: {robot} among {len(scene)} bodies")
