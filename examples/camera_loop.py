"""Two cameras beside an arm: in each frame, what they see without the arm, what they have not seen, and a new plan.

python examples/camera_loop.py [FRAMES]

The function `main` is the loop of real cameras. `image_of` stands for them: it casts rays against convex pieces.
"""

import sys
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from loewner import Body, CollisionChecker, PlanningError, Robot, Scene, planners
from loewner.depth import SeenSpace

SHARE = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data")))
PANDA = SHARE / "robots" / "panda_description"
NOISE, VOXEL, CELL, CLEAR = 0.002, 0.02, 0.04, 0.04  # metres
K = np.array([[144.0, 0, 79.5], [0, 144.0, 59.5], [0, 0, 1]])
# On both sides of the arm, looking along (0, 0.8, -0.6) and (0, -0.8, -0.6).
CAMERAS = np.array(
    [
        [[1.0, 0, 0, 0.3], [0, -0.6, 0.8, -1.9], [0, -0.8, -0.6, 1.5], [0, 0, 0, 1]],
        [[-1.0, 0, 0, 0.3], [0, 0.6, -0.8, 1.9], [0, -0.8, -0.6, 1.5], [0, 0, 0, 1]],
    ]
)


def main(frames: int = 5) -> None:
    """Plan in each frame, and follow a quarter of the first motion, while a post moves through the cell."""
    robot = Robot.from_urdf(PANDA / "urdf/panda.urdf", srdf=PANDA / "srdf/panda.srdf", package_dirs=[SHARE])
    scene = Scene(margin=0.005)
    for name in ("seen", "unknown"):
        scene.add(name, Body.boxes([[9, 9, 9]], [[0.1, 0.1, 0.1]]))  # until the first image comes
        scene.allow(name, "panda_link0")
    checker, space = CollisionChecker(robot, scene), SeenSpace([-0.9, -0.9, -0.1], (45, 45, 32), CELL)
    q = robot.configuration("default")
    goal = q + [0.8, 0.2, 0, 0.3, 0, 0, 0, 0]
    for k in range(frames):
        seen = []
        for T in CAMERAS:
            image = image_of(T, robot, q, post=[0.7 - 0.01 * k, 0.3, 0.2])
            seen.append(Body.from_depth(image, K, T, voxel=VOXEL, checker=checker, q=q, clear=CLEAR))
            space.see(image - NOISE, K, T, time=0.1 * k)
        scene.replace("seen", body := Body.union(seen))
        scene.replace("unknown", space.body(checker, q, clear=CLEAR))
        try:
            path = planners.plan(checker, q, goal, seed=k)
        except PlanningError as error:
            print(f"frame {k}: {error}")
            continue
        print(f"frame {k}: {len(body.pieces)} boxes seen, {int(space.unknown.sum())} cells unknown, {len(path)} stops")
        q = q + (path[1] - q) / 4


def image_of(T_world_camera: np.ndarray, robot: Robot, q: np.ndarray, post: list[float]) -> np.ndarray:
    """Depths of the arm, a table, a post and a wall, with noise."""
    v, u = np.indices((120, 160))
    rays = np.stack([u, v, np.ones(u.shape)], axis=-1).reshape(-1, 3) @ np.linalg.inv(K).T
    placed = list(zip(robot.bodies.values(), poses_of(robot, q), strict=True))
    placed.append((Body.boxes([[0.6, 0, -0.05], post], [[1.0, 1.6, 0.04], [0.1, 0.1, 0.4]]), np.eye(4)))
    depths = np.full(len(rays), 3.0)
    for body, T in placed:
        local = np.linalg.inv(T) @ T_world_camera
        for piece in body.pieces:
            assert piece.normals is not None  # as for all polytopes
            slopes, room = rays @ local[:3, :3].T @ piece.normals.T, piece.offsets - piece.normals @ local[:3, 3]
            with np.errstate(divide="ignore", invalid="ignore"):
                t = room / slopes
            enter, leave = (np.where(slopes < 0, t, -np.inf).max(axis=1), np.where(slopes > 0, t, np.inf).min(axis=1))
            hit = (enter > 0) & (enter < leave)
            depths[hit] = np.minimum(depths[hit], enter[hit])
    return (depths + np.random.default_rng(0).uniform(-NOISE, NOISE, len(depths))).reshape(u.shape)


def poses_of(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Poses of the links that have bodies."""
    return robot.forward_kinematics(q)[[robot.link_names.index(name) for name in robot.bodies]]


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
