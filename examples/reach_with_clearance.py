"""Inverse kinematics that keeps its distance: SciPy with Jacobians of the hand and gradients of the clearance.

python examples/reach_with_clearance.py [--seed 39]

The hand is to reach a pose among boxes. First nothing else is asked for; then, that the clearance, a certified lower
bound on the distance to everything, be two centimetres at least. Where the search stops short it starts anew elsewhere.
`Robot.reach` solves the first of these tasks in a line, in microseconds.
"""

import argparse

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import loewner
from bend_a_path import ARM, KEEP, clutter
from robot_meshes import panda_robot

HAND = "panda_hand_tcp"
RADIAN = 0.1  # metres that an error of a radian counts as


def main() -> None:
    """Reach the pose without looking at obstacles, then with."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=39)
    seed = parser.parse_args().seed

    robot = panda_robot()
    checker = loewner.CollisionChecker(robot, clutter(seed))
    starts = [robot.configuration("default"), *robot.random_configurations(30, seed)]
    goal = reachable_pose(robot, checker, seed)
    for name, kept in (("without looking", False), ("with clearance ", True)):
        q = reach(goal, starts, checker, kept)
        moved, turned = error(robot, q, goal)
        nearest = checker.distance(q, exact=True)
        print(
            f"{name}: hand {1000 * np.linalg.norm(moved):.2f} mm and {np.degrees(np.linalg.norm(turned)):.2f}° off, "
            f"clearance {1000 * checker.clearance(q):.1f} mm, distance {1000 * nearest.distance:.1f} mm "
            f"({' and '.join(nearest.names)})"
        )


def reachable_pose(robot: loewner.Robot, checker: loewner.CollisionChecker, seed: int) -> np.ndarray:
    """Where the hand is at a configuration that keeps its distance, by a hair."""
    Q = robot.random_configurations(1000, seed)
    clearance = checker.clearance(Q)
    return hand(robot, Q[np.where(clearance > KEEP, clearance, np.inf).argmin()])


def reach(goal: np.ndarray, starts: list[np.ndarray], checker: loewner.CollisionChecker, kept: bool) -> np.ndarray:
    """A configuration whose hand is at the goal, with clearance if it is to be kept."""
    for start in starts:
        q = reach_from(start, goal, checker, kept)
        there = np.linalg.norm(error(checker.robot, q, goal)) < 1e-3
        if there and (not kept or checker.clearance(q) > KEEP - 1e-6):
            break
    return q


def reach_from(start: np.ndarray, goal: np.ndarray, checker: loewner.CollisionChecker, kept: bool) -> np.ndarray:
    """What a local method finds from one start."""
    robot = checker.robot

    def whole(arm: np.ndarray) -> np.ndarray:
        return np.concatenate([arm, start[ARM.stop :]])

    def cost(arm: np.ndarray) -> tuple[float, np.ndarray]:
        """Half the squared error of the hand, in square centimetres, and its gradient."""
        moved, turned = error(robot, whole(arm), goal)
        J = robot.jacobian(whole(arm), HAND)[:, ARM]
        wrench = np.concatenate([moved, RADIAN**2 * turned])
        return 5e3 * float(moved @ moved + RADIAN**2 * turned @ turned), 1e4 * wrench @ J

    spare = {
        "type": "ineq",
        "fun": lambda arm: checker.clearance(whole(arm)) - KEEP,
        "jac": lambda arm: checker.clearance(whole(arm), gradient=True)[1][ARM],
    }
    found = minimize(
        cost,
        start[ARM],
        jac=True,
        method="SLSQP",
        bounds=list(zip(robot.lower[ARM], robot.upper[ARM], strict=True)),
        constraints=[spare] if kept else [],
        options={"maxiter": 500, "ftol": 1e-12},
    )
    return whole(found.x)


def error(robot: loewner.Robot, q: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far the hand is from the goal, and the rotation vector from the one to the other."""
    T = hand(robot, q)
    return T[:3, 3] - goal[:3, 3], Rotation.from_matrix(T[:3, :3] @ goal[:3, :3].T).as_rotvec()


def hand(robot: loewner.Robot, q: np.ndarray) -> np.ndarray:
    """Pose of the hand in the world."""
    pose: np.ndarray = robot.forward_kinematics(q)[robot.link_names.index(HAND)]
    return pose


if __name__ == "__main__":
    main()
