"""A straight line through obstacles, bent until it is free: SciPy with gradients of the exact distance.

python examples/bend_a_path.py [--seed 2] [--points 24]

The cost is the length of the path, and how far its points come nearer than two centimetres to anything. Then every
motion between the points is proven. bend_a_path_jax.py and bend_a_path_torch.py leave the gradient to JAX and PyTorch.
"""

import argparse
from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

import loewner
from robot_meshes import panda_robot

KEEP = 0.02  # metres from everything
SCALE = 0.01  # metres that a lack of distance is measured in
ARM = slice(0, 7)

# From a path and a checker, the bent path and how often its cost was evaluated.
Bend = Callable[[np.ndarray, loewner.CollisionChecker], tuple[np.ndarray, int]]


def main(bend: Bend) -> None:
    """Draw starts and goals until a straight line collides, bend it, and prove what came out."""
    parser = argparse.ArgumentParser(description="A straight line through obstacles, bent until it is free.")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--points", type=int, default=24)
    asked = parser.parse_args()

    robot = panda_robot()
    checker = loewner.CollisionChecker(robot, clutter(asked.seed))
    straight = colliding_line(robot, checker, asked.points, asked.seed)
    distances = checker.distance(straight, exact=True).distance
    print(f"straight: {length(straight):.2f} rad, nearest {1000 * distances.min():.1f} mm")

    bent, evaluations = bend(straight, checker)
    distances = checker.distance(bent, exact=True).distance
    print(f"bent:     {length(bent):.2f} rad, nearest {1000 * distances.min():.1f} mm, {evaluations} evaluations")
    verdicts = checker.certify_edges(bent[:-1], bent[1:]).verdict
    proven = sum(verdict == loewner.Verdict.FREE for verdict in verdicts)
    print(f"{proven} of {len(verdicts)} motions between its points are proven free")


def clutter(seed: int) -> loewner.Scene:
    """Boxes around an arm."""
    rng = np.random.default_rng(seed)
    scene = loewner.Scene()
    for k in range(8):
        angle, T = rng.uniform(0, 2 * np.pi), np.eye(4)
        T[:3, 3] = 0.55 * np.cos(angle), 0.55 * np.sin(angle), rng.uniform(0.2, 0.8)
        scene.add(f"box {k}", loewner.Body.box(rng.uniform(0.08, 0.2, 3)), T)
    return scene


def colliding_line(robot: loewner.Robot, checker: loewner.CollisionChecker, points: int, seed: int) -> np.ndarray:
    """A straight line of the arm between two free configurations that collides on its way."""
    middle = robot.configuration("default")
    rng = np.random.default_rng(seed)
    while True:
        ends = np.tile(middle, (2, 1))
        ends[:, ARM] += rng.uniform(-1.0, 1.0, size=(2, 7))
        line: np.ndarray = ends[0] + np.linspace(0, 1, points)[:, None] * (ends[1] - ends[0])
        hit = checker.collide(line)
        if not hit[[0, -1]].any() and 0 < hit.sum() <= points // 3:
            return line


def bend_with_scipy(straight: np.ndarray, checker: loewner.CollisionChecker) -> tuple[np.ndarray, int]:
    """The points between the ends moved by L-BFGS."""
    found = minimize(cost, straight[1:-1, ARM].ravel(), args=(straight, checker), jac=True, method="L-BFGS-B")
    return with_inner(straight, found.x), found.nfev


def with_inner(path: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """The path with other values of the arm between its ends."""
    path = path.copy()
    path[1:-1, ARM] = inner.reshape(len(path) - 2, -1)
    return path


def cost(inner: np.ndarray, straight: np.ndarray, checker: loewner.CollisionChecker) -> tuple[float, np.ndarray]:
    """Squared length of the path, what it lacks of distance, and the gradient of both."""
    path = with_inner(straight, inner)
    steps = np.diff(path, axis=0)
    gradient = np.zeros_like(path)
    gradient[:-1] -= 2 * steps
    gradient[1:] += 2 * steps
    found = checker.distance(path, exact=True, gradient=True)
    lacking = np.maximum(KEEP - found.distance, 0.0) / SCALE
    gradient -= (2 / SCALE) * lacking[:, None] * found.gradient
    return float((steps**2).sum() + (lacking**2).sum()), gradient[1:-1, ARM].ravel()


def length(path: np.ndarray) -> float:
    """Sum of the steps' lengths."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


if __name__ == "__main__":
    main(bend_with_scipy)
