"""Hashes of answers: print them before and after a change that must not alter a bit, and compare.

    python tests/answers.py >before.txt

One line for each kind of question. Answers differ between levels of processors, whose arithmetic is fused differently.
"""

import hashlib
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from checker_oracle import composed_bodies, random_robot, random_scene, simple_bodies
from families import FAMILIES, pieces, random_poses
from loewner import (
    Bodies,
    Body,
    CollisionChecker,
    LoewnerError,
    classify,
    collide,
    distance,
    overlapping_pairs,
    planners,
)

PAIRS, CONFIGURATIONS, MOTIONS = 4000, 2000, 600
HULLS, ROBOTS, PATHS = 40, 6, 20  # of each family; and paths of each robot


def answers() -> Iterator[tuple[str, list[np.ndarray]]]:
    """Yield each kind of question, and arrays that hold its answers."""
    for family in FAMILIES:
        hulls = Bodies([Body.from_points(points) for points in pieces(family, HULLS)])
        yield f"pairs of {family}", of_pairs(hulls, near=0.8)
    rng = np.random.default_rng(1)
    yield "curved pairs", of_pairs(Bodies(simple_bodies(rng)), near=1.0)
    yield "unions", of_pairs(Bodies(composed_bodies(rng)), near=1.0)
    yield "surfaces", of_pairs(Bodies([surface(rng) for _ in range(6)]), near=0.8, count=300)
    clouds = [Body.from_cloud(rng.normal(size=(200, 3)), radius=0.05) for _ in range(3)]
    yield "clouds", of_pairs(Bodies(clouds), near=1.5, count=300)
    yield "crowds", of_crowds(rng)
    for seed in range(ROBOTS):
        yield f"robot {seed}", of_robot(seed)


def of_pairs(bodies: Bodies, near: float, count: int | None = None) -> list[np.ndarray]:
    """Verdicts, exact verdicts and distances of random pairs at random poses."""
    rng, count = np.random.default_rng(len(bodies)), PAIRS if count is None else count
    chosen = rng.integers(len(bodies), size=(count, 2))
    Ta, Tb = (random_poses(rng, count, near) for _ in range(2))
    a, b = bodies[chosen[:, 0]], bodies[chosen[:, 1]]
    found = distance(a, Ta, b, Tb, exact=True)
    columns = found.lower, found.upper, found.distance, found.witness_a, found.witness_b, found.normal
    shapes = [array for fit in (bodies[0].outer, bodies[0].inner) for array in (fit.center, fit.factor)]
    return [classify(a, Ta, b, Tb), collide(a, Ta, b, Tb), collide(a, Ta, b, Tb, margin=0.01), *columns, *shapes]


def surface(rng: np.random.Generator) -> Body:
    """A closed surface of a few hundred triangles."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.vertices *= rng.uniform(0.3, 1, size=(len(ball.vertices), 1))
    return Body.from_surface(ball)


def of_crowds(rng: np.random.Generator) -> list[np.ndarray]:
    """Pairs of a crowd that meet."""
    bodies = Bodies(simple_bodies(rng)[:1] * 300)
    return [overlapping_pairs(bodies, random_poses(rng, 300, 1.0))]


def of_robot(seed: int) -> list[np.ndarray]:
    """Configurations, motions, distances, clearances and paths of a random robot in a random scene."""
    rng = np.random.default_rng(seed)
    pool = [*simple_bodies(rng), *composed_bodies(rng)]
    with tempfile.TemporaryDirectory() as folder:
        robot = random_robot(rng, Path(folder), 3 + seed, pool)
    checker = CollisionChecker(robot, random_scene(rng, robot, 4, pool))
    Q = robot.random_configurations(CONFIGURATIONS, seed)
    start, end = Q[:MOTIONS], Q[1 : MOTIONS + 1]
    proven = checker.certify_edges(start, robot.between(start, end, 0.3))
    measured = []
    if checker.checked_pairs:
        found = checker.distance(Q[:300], exact=True, gradient=True)
        measured = [found.lower, found.distance, found.gradient, *checker.clearance(Q[:300], gradient=True)]
    return [
        checker.classify(Q), checker.collide(Q), checker.valid_edges(start, end, 0.05),
        proven.verdict, proven.fraction, proven.names, proven.poses, proven.searches,
        *measured, *(path(checker, a, b) for a, b in zip(Q[:PATHS], Q[PATHS : 2 * PATHS], strict=True)),
    ]  # fmt: skip


def path(checker: CollisionChecker, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """A planned path, or nothing."""
    try:
        return np.asarray(planners.plan(checker, start, goal, max_iterations=500))
    except LoewnerError:
        return np.empty(0)


def main() -> None:
    """Print a hash of each."""
    for name, arrays in answers():
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
        print(f"{digest.hexdigest()[:16]}  {name}", flush=True)


if __name__ == "__main__":
    main()
