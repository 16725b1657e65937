"""Robots of example-robot-data and the scene they are benchmarked in."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np

from loewner import Body, Robot, Scene
from rivals import Missing
from samples import Array, poses, rotations

# Of the obstacles: how many of each kind, metres.
KINDS, EDGES, HULL_POINTS, HULL_RADIUS = 5, (0.05, 0.25), 20, 0.12
RING, HEIGHTS = (0.45, 0.85), (0.0, 0.9)
# How far from its posture the humanoid is moved, as a share of the way to a random configuration.
SWAY = 0.3


@dataclass(frozen=True)
class Sample:
    """A robot and the file it came from."""

    robot: Robot
    urdf: Path


def robots_folder() -> Path:
    """The folder of the robots of example-robot-data."""
    try:
        files = distribution("example-robot-data")
    except PackageNotFoundError:
        raise Missing("package example-robot-data is not installed") from None
    return Path(str(files.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def example(urdf: str, srdf: str) -> Sample:
    """A robot of example-robot-data; paths relative to its folder of robots."""
    folder = robots_folder()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*states that place the base")  # the samples use its joints alone
        robot = Robot.from_urdf(folder / urdf, srdf=folder / srdf, package_dirs=[folder.parents[1]])
    return Sample(robot, folder / urdf)


def panda() -> Sample:
    return example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")


def panda_for(problems: Path) -> Sample | None:
    """The Panda, for a file of MotionBenchMaker problems; None, and why, if the file or the robot is missing."""
    try:
        if not problems.exists():
            raise Missing(f"there is no {problems}; docs/scenes.md says what it would be")
        return panda()
    except Missing as missing:
        print(f"not run: {missing}")
        return None


def talos() -> Sample:
    return example("talos_data/robots/talos_full_v2.urdf", "talos_data/srdf/talos.srdf")


def five() -> dict[str, Sample]:
    """Two arms, an arm of few joints, a humanoid, and a robot with four legs and an arm."""
    return {
        "panda": panda(),
        "ur5": example("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf"),
        "xarm7": example("xarm_description/urdf/xarm7.urdf", "xarm_description/srdf/xarm7.srdf"),
        "talos": talos(),
        "b1-z1": example("b1_description/urdf/b1-z1.urdf", "b1_description/srdf/b1-z1.srdf"),
    }


def obstacles(seed: int) -> Scene:
    """Boxes and hulls in a ring around the base, turned at random."""
    rng = np.random.default_rng(seed)
    count = 2 * KINDS
    reach, angle = rng.uniform(*RING, count), rng.uniform(-np.pi, np.pi, count)
    centers = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(*HEIGHTS, count)])
    T = poses(rotations(rng, count), centers)
    scene = Scene()
    for k in range(KINDS):
        scene.add(f"box {k}", Body.box(rng.uniform(*EDGES, 3)), T[k])
        directions = rng.normal(size=(HULL_POINTS, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        points = HULL_RADIUS * np.cbrt(rng.uniform(size=(HULL_POINTS, 1))) * directions
        scene.add(f"hull {k}", Body.from_points(points), T[KINDS + k])
    return scene


def around(robot: Robot, state: str, n: int, seed: int) -> Array:
    """Configurations near a state of the SRDF, most of which are free."""
    return robot.between(robot.configuration(state), robot.random_configurations(n, seed), SWAY)
