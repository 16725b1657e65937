"""Read a robot of the package robot_descriptions, by the name of its module, and check it at random configurations.

    pip install robot_descriptions "loewner[xacro,mujoco]"
    python examples/any_robot.py ur5_description
    python examples/any_robot.py panda_mj_description

The package clones the repository of a robot when its module is first imported. URDF, xacro and MJCF files are read, and
an SRDF if there is one.
"""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import loewner


def robot_of(described: ModuleType) -> loewner.Robot:
    """Read the robot of a module: its first file among URDF, xacro and MJCF."""
    has = vars(described)
    if "URDF_PATH" not in has and "XACRO_PATH" not in has:
        return loewner.Robot.from_mjcf(has["MJCF_PATH"])
    homes = [Path(has["PACKAGE_PATH"]), Path(has["REPOSITORY_PATH"])]
    return loewner.Robot.from_urdf(
        has.get("URDF_PATH") or has["XACRO_PATH"],
        xacro_args=None if "URDF_PATH" in has else has.get("XACRO_ARGS", {}),
        srdf=has.get("SRDF_PATH"),
        package_dirs=[*homes, *(home.parent for home in homes)],
        progress=lambda done, total: print(f"\rshape {done} of {total}", end="", file=sys.stderr),
    )


def main() -> None:
    """Read the robot that the command names, and print how often it collides with itself."""
    if len(sys.argv) != 2:
        sys.exit("usage: python examples/any_robot.py NAME_description")
    try:
        described = importlib.import_module(f"robot_descriptions.{sys.argv[1]}")
    except ImportError as error:
        sys.exit(f"{error}. Install the package with\n    pip install robot_descriptions")
    robot = robot_of(described)
    print(robot)
    checker = loewner.CollisionChecker(robot)
    found = checker.tiers(robot.random_configurations(1000))
    print(f"{len(checker.checked_pairs)} pairs are checked")
    print(f"of 1000 random configurations, {found.colliding} collide")


if __name__ == "__main__":
    main()
