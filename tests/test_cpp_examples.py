"""The examples in C++ that need other libraries: the skeletons against stubs, and OMPL where it is installed."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import loewner
from loewner import CollisionChecker
from loewner._native import library
from motion_oracle import example, ring

OFFERED = library.level() is not None or os.environ.get("LOEWNER_NATIVE") == "required"
pytestmark = [
    pytest.mark.skipif(not OFFERED, reason=f"no native library here: {library.why_not()}"),
    pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed"),
]

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
INCLUDE = Path(loewner.__file__).parent / "include"
LINK = [f"-I{INCLUDE}", f"-L{library.HOME}", "-lloewner", f"-Wl,-rpath,{library.HOME}"]
STRICT = ("-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


def built(program, source, *flags):
    made = subprocess.run(["g++", *STRICT, source, "-o", program, *flags, *LINK], capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    return program


@pytest.fixture
def cell(tmp_path, rng):
    robot = example("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf")
    checker = CollisionChecker(robot, ring(rng, 8, 0.5, 0.9, 0.2))
    checker.save(tmp_path / "cell.lwn")
    return checker, tmp_path / "cell.lwn"


def test_skeletons_compile_and_judge_as_python(cell, tmp_path):
    """MoveIt's and Tesseract's skeletons compile against stubs, and their verdicts are those of Python."""
    checker, path = cell
    stubs = EXAMPLES / "moveit_cpp"
    program = built(tmp_path / "skeletons", HERE / "cpp_skeletons.cpp", f"-I{stubs}", f"-I{stubs / 'stubs'}")
    robot, scene = checker.robot, checker.scene
    Q = robot.between(robot.configuration(), robot.random_configurations(60, 1), 0.5)
    numbers = [str(len(scene))]
    for name in scene.names:
        numbers += [name.replace(" ", "_"), *map(repr, scene.pose(name).ravel().tolist())]
    numbers += map(repr, Q.ravel().tolist())
    run = subprocess.run(
        [program, path], input=" ".join(numbers), capture_output=True, text=True, env={"LOEWNER_CELL": str(path)}
    )
    assert run.returncode == 0, run.stderr
    *found, last = ([int(word) for word in line.split()] for line in run.stdout.splitlines())
    links = set(robot.bodies)
    within = [pair for pair in checker.checked_pairs if links.issuperset(pair)]
    alone = CollisionChecker(robot)
    outside = CollisionChecker(robot, scene, allowed=within)
    assert set(alone.checked_pairs) == set(within)
    wanted = [
        alone.collide(Q[:-1]), outside.collide(Q[:-1]), outside.certify_edges(Q[:-1], Q[1:]).verdict != 0,
        np.zeros(len(Q) - 1), checker.collide(Q[:-1]), checker.certify_edges(Q[:-1], Q[1:]).verdict != 0,
    ]  # fmt: skip
    assert np.array_equal(found, np.array(wanted, dtype=int).T)
    assert 0 < np.sum(wanted[2]) < len(Q) - 1
    assert last == [0, 1]  # all pairs are allowed, but a body without a shape is in the world


def test_ompl_proves_every_motion(cell, tmp_path):
    """OMPL finds and shortens a path whose motions are all proven."""
    headers = Path("/usr/include/ompl-1.5"), Path("/usr/include/eigen3")
    if not all(folder.is_dir() for folder in headers):
        pytest.skip("OMPL for C++ is not installed: libompl-dev and libeigen3-dev of Debian")
    system = [word for folder in headers for word in ("-isystem", folder)]
    program = built(tmp_path / "plan", EXAMPLES / "ompl_cpp" / "plan.cpp", *system, "-lompl")
    said = subprocess.run([program, cell[1], "3"], capture_output=True, text=True)
    assert said.returncode == 0, said.stdout + said.stderr
    motions = re.fullmatch(
        r"a path of [\d.]+ rad, (\d+) of its (\d+) motions proven free", said.stdout.splitlines()[-1]
    )
    assert motions, said.stdout
    assert motions[1] == motions[2] != "0"
