"""Robots of the package example-robot-data, wherever it is on this machine."""

import sys
import warnings
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import loewner


def robots() -> Path:
    """Folder with one folder per robot; ends the program with advice if the package is missing."""
    try:
        folder = Path(
            str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots"))
        )
    except PackageNotFoundError:
        folder = Path()
    if not (folder / "panda_description").is_dir():
        sys.exit("The robot meshes are missing. Install them with\n    pip install --no-deps example-robot-data")
    return folder


def panda(name: str) -> Path:
    """A mesh of the Panda arm, such as "visual/link5.dae" or "collision/hand.stl"."""
    return robots() / "panda_description" / "meshes" / name


def panda_robot() -> loewner.Robot:
    """The Panda arm with its hand; eight joints."""
    folder = robots() / "panda_description"
    return loewner.Robot.from_urdf(
        folder / "urdf/panda.urdf", srdf=folder / "srdf/panda.srdf", package_dirs=robots().parent
    )


def talos_robot() -> loewner.Robot:
    """The humanoid Talos; 32 joints."""
    folder = robots() / "talos_data"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*states that place the base")  # the examples use its joints alone
        return loewner.Robot.from_urdf(
            folder / "robots/talos_reduced.urdf", srdf=folder / "srdf/talos.srdf", package_dirs=robots().parent
        )
