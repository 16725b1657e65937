"""The examples in C++ that need other libraries: the skeletons against stubs, and OMPL where it is installed."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import loewner
from loewner import CollisionChecker, Verdict
from loewner._native import library
from motion_oracle import example, ring
from native_files import needs_library
from test_gates import DT, Q0, along_the_rail, arm, wall

pytestmark = [
    needs_library,
    pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed"),
]

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
INCLUDE = Path(loewner.__file__).parent / "include"
LINK = [f"-I{INCLUDE}", f"-L{library.HOME}", "-lloewner", "-Xlinker", "-rpath", "-Xlinker", str(library.HOME)]
STRICT = ("-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")


def built(program, *sources_and_flags):
    made = subprocess.run(["g++", *STRICT, *sources_and_flags, "-o", program, *LINK], capture_output=True, text=True)
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


LATE = np.full(3, np.nan)
EVENTS = {  # what happens at the 20th cycle: another reference, or a state off the command
    "nothing": (None, None),
    "late": (LATE, None),
    "partly late": ([0.4, np.nan, 0.0], None),
    "infinite": ([0.4, np.inf, 0.0], None),
    "beyond the limits": ([2.1, np.pi / 2, 0.0], None),
    "too fast": ([0.9, np.pi / 2, 0.0], None),
    "state is NaN": (None, [0.0, 0.0, np.nan]),
    "state jumped": (None, [0.0, 2e-3, 0.0]),
}


@pytest.fixture(scope="module")
def control(tmp_path_factory):
    """The controller of ros2_control in its program, and a cell whose wall begins 1.1 m along the rail."""
    home, example = tmp_path_factory.mktemp("control"), EXAMPLES / "ros2_control"
    checker = CollisionChecker(arm(), wall(1.1 + 0.05))
    checker.save(home / "cell.lwn")
    sources = HERE / "cpp_control.cpp", example / "gate_controller.cpp"
    program = built(home / "control", sources[0], sources[1], f"-I{example / 'stubs'}")

    def run(references, offsets):
        """Commands of a loop; no update may have allocated memory."""
        given = np.hstack([references, offsets]).ravel().tolist()
        told = " ".join(map(repr, [*Q0.tolist(), *given]))
        said = subprocess.run([program, home / "cell.lwn", "3"], input=told, capture_output=True, text=True)
        assert said.returncode == 0, said.stderr
        assert "acceleration: expected a number for each joint" in said.stderr
        *rows, allocations = said.stdout.splitlines()
        assert allocations == "0"
        return np.array([[float(word) for word in row.split()] for row in rows])

    return checker, run


@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("lasts", [80, pytest.param(1, marks=pytest.mark.verify)])
def test_what_a_controller_commands_is_proven(control, event, lasts, rng):
    """References into a wall: whatever happens on the way, the robot comes to rest in front of it."""
    checker, run = control
    references, offsets = along_the_rail(1.0, 120), rng.uniform(-1e-3, 1e-3, (120, 3))
    other, off = EVENTS[event]
    if other is not None:
        references[20 : 20 + lasts] = other
    if off is not None:
        offsets[20 : 20 + lasts] = off
    commands = run(references, offsets)
    path = np.vstack([Q0, commands])
    assert (checker.certify_edges(path[:-1], path[1:]).verdict == Verdict.FREE).all()
    assert np.abs(np.diff(path[20:], 2, axis=0)).max() <= 4.0 * DT * DT * 1.001  # brakes as strong as allowed
    passed = references[0, 0] * np.arange(1, 21)
    np.testing.assert_allclose(commands[:20, 0], passed, atol=1e-12)
    if event == "nothing":  # the last command from which 0.125 m and a radius of 0.05 m are left: see test_gates.py
        assert commands[-1, 0] == pytest.approx(0.92 + 0.125)
    elif lasts > 1:
        assert commands[20, 0] == pytest.approx(passed[-1] + DT - 2.0 * DT * DT)
        assert commands[-1, 0] == pytest.approx(passed[-1] + 0.125)


NARROW = """#include <loewner.hpp>
#include <iostream>
int main(int, char **words)
{
    const loewner::Checker checker(words[1]);
    const std::vector<double> most(8, 1.0), row(8), less(7), other(9);
    loewner_gate_options options{};
    options.velocity = options.acceleration = most.data();
    loewner::Gate gate(checker, options, 2);
    try {
        gate.check(row, less, other, 0.1);
    } catch (const loewner::Error &error) {
        std::cout << error.what();
    }
}
"""


@pytest.mark.verify
def test_a_gate_names_how_many_numbers_it_was_given(cell, tmp_path):
    """Rows of another length are refused with the lengths of all."""
    checker, path = cell
    assert checker.robot.dof == 8
    (tmp_path / "narrow.cpp").write_text(NARROW)
    run = subprocess.run([built(tmp_path / "narrow", tmp_path / "narrow.cpp"), path], capture_output=True, text=True)
    assert run.stdout.endswith("expected 8, 8 and a multiple of 8 numbers, found 8, 7 and 9"), run.stderr
