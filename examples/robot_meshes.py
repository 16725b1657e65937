"""Where the meshes of the package example-robot-data are on this machine."""

import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path


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
