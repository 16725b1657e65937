"""The command line: exit status, what it prints, one clear line for every error."""

import argparse
import ast
import csv
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import loewner
import made_parts
from families import translation
from gantry import LEFT, RADIUS, RIGHT, clearance, gantry
from loewner import cli, planners
from loewner._native import entries, library
from loewner.cli import jobs
from loewner.cli.info import MISSING
from loewner.cli.main import _parser, _with_option
from loewner.cli.output import covering_text, print_table
from loewner.robots.checking import verdicts
from sampling import quick


@pytest.fixture
def saved(tmp_path, monkeypatch):
    """A working folder with two saved boxes and two meshes."""
    monkeypatch.chdir(tmp_path)
    loewner.Body.box([1, 1, 1]).save("a.npz")
    loewner.Body.box([2, 1, 1]).save("b.npz")
    trimesh.creation.box((1, 1, 1)).export("cube.stl")
    trimesh.creation.icosphere(subdivisions=1).export("ball.obj")
    return tmp_path


def run(capsys, *arguments):
    """Exit status, standard output and standard error of a command."""
    status = cli.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


# -- check --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "method", "status", "word"),
    [
        ("5 0 0", "certified", 0, "FREE"),
        ("5 0 0", "exact", 0, "FREE"),
        ("1.6 0 0", "certified", 3, "AMBIGUOUS"),
        ("1.6 0 0", "exact", 0, "FREE"),
        ("1.5 0 0", "exact", 1, "COLLIDING"),
        ("0 0 0", "certified", 1, "COLLIDING"),
        ("0 0 0", "estimate", 1, "COLLIDING"),
    ],
)
def test_check_status(saved, capsys, x, method, status, word):
    """Exit status 0 free, 1 colliding (touching too), 3 ambiguous, and the word comes first."""
    found = run(capsys, "check", "a.npz", "b.npz", "--pose-b", x, "--method", method)
    assert found[0] == status
    assert found[1].startswith(word)
    assert found[2] == ""


def test_check_prints_the_exact_distance(saved, capsys):
    """Boxes with faces at 0.5 and 1.6 - 1: 0.1 m apart along x."""
    out = run(capsys, "check", "a.npz", "b.npz", "--pose-b", "1.6 0 0")[1]
    assert float(re.search(r"([-+0-9.e]+) m, exact", out)[1]) == pytest.approx(0.1)
    assert re.search(r"normal +1 -?0 -?0, from A to B", out)


def test_contact_is_0_m_apart(saved, capsys):
    """Two faces in contact are 0 m apart, without a sign, in both commands."""
    loewner.Body.box([1, 1, 1]).save("unit.npz")
    loewner.Body.box([1, 1, 1]).transformed([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).save("next.npz")
    assert "            0 m, exact" in run(capsys, "check", "unit.npz", "next.npz")[1]
    assert re.search(r"COLLIDING +│ 0 ", run(capsys, "clearance", "unit.npz", "next.npz")[1])


def test_check_json(saved, capsys):
    """--json prints one JSON object that agrees with the library."""
    status, out, _ = run(capsys, "check", "a.npz", "b.npz", "--pose-b", "0 1.25 0", "--json")
    answer = json.loads(out)
    assert (status, answer["verdict"], answer["method"]) == (0, "FREE", "exact")
    assert answer["distance"] == pytest.approx(0.25)
    assert answer["lower"] <= 0.25 <= answer["upper"]
    assert answer["normal"] == pytest.approx([0, 1, 0])
    assert np.subtract(answer["witness_b"], answer["witness_a"])[1] == pytest.approx(0.25)


@pytest.mark.parametrize(("margin", "status"), [("0.09", 0), ("0.11", 1)])
def test_check_margin(saved, capsys, margin, status):
    """A margin larger than the distance makes a collision."""
    assert run(capsys, "check", "a.npz", "b.npz", "--pose-b", "1.6 0 0", "--margin", margin)[0] == status


def test_check_meshes_without_saving(saved, capsys):
    """Meshes are taken as they are; a ball of radius 1 and a unit cube, one metre of air between."""
    status, out, _ = run(capsys, "check", "cube.stl", "ball.obj", "--pose-a", "-2.5 0 0", "--json")
    assert status == 0
    answer = json.loads(out)
    assert answer["distance"] == pytest.approx(1.0, abs=0.1)
    assert answer["a_exact"]
    assert answer["b_exact"]


def test_poses_in_every_form_agree(saved, capsys):
    """Numbers with a quaternion, a .npy and a .txt matrix give the same answer; -x comes first without trouble.

    So it does before a comma, and as an exponent.
    """
    c, s = np.cos(0.3), np.sin(0.3)
    T = np.array([[c, -s, 0, -1.9], [s, c, 0, 0.1], [0, 0, 1, 0.2], [0, 0, 0, 1]])
    np.save("pose.npy", T)
    np.savetxt("pose.txt", T)
    typed = f"-1.9 0.1 0.2 {np.cos(0.15)} 0 0 {np.sin(0.15)}"
    distances = [
        json.loads(run(capsys, "check", "a.npz", "b.npz", "--pose-b", pose, "--json")[1])["distance"]
        for pose in ("pose.npy", "pose.txt", typed, typed.replace(" ", ","), typed.replace("-1.9", "-19e-1"))
    ]
    expected = loewner.distance(loewner.Body.load("a.npz"), None, loewner.Body.load("b.npz"), T, exact=True).distance
    np.testing.assert_allclose(distances, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.npz", "b.npz"], "none.npz"),
        (["none.stl", "b.npz"], "none.stl: expected a mesh file, but there is no such file"),
        (["empty.stl", "b.npz"], "empty.stl: expected a mesh file, found an empty one"),
        (["text.npz", "b.npz"], "text.npz"),
        (["a.npz", "b.npz", "--pose-a", "1 2"], "--pose-a: expected"),
        (["a.npz", "b.npz", "--pose-a", "x y z"], "--pose-a: expected"),
        (["a.npz", "b.npz", "--pose-a", "nan 0 0"], "--pose-a: expected"),
        (
            ["a.npz", "b.npz", "--pose-b", "0,,1,2"],
            "found '0,,1,2' (expected a number in each cell, found",
        ),
        (["a.npz", "b.npz", "--pose-b", "0,1 2"], "found '0,1 2' (expected numbers divided by commas or by spaces"),
        (["a.npz", "b.npz", "--pose-b", "1_0 0 0"], "--pose-b: expected"),
        (["a.npz", "b.npz", "--pose-b", "0 0 0 1 1 0 0"], "--pose-b: expected a unit quaternion"),
        (["a.npz", "b.npz", "--pose-b", "0 0 0 0 0 0 0"], "--pose-b: expected a unit quaternion"),
        (["a.npz", "b.npz", "--pose-b", "none.npy"], "none.npy: expected a pose file"),
        (["a.npz", "b.npz", "--pose-b", "words.txt"], "words.txt: expected a 4x4 matrix"),
        (["a.npz", "b.npz", "--pose-b", "short.txt"], "short.txt: expected shape (4, 4), found (1, 3)"),
        (["a.npz", "b.npz", "--pose-b", "scaled.txt"], "expected a rotation"),
        (["a.npz", "b.npz", "--pose-b", "empty.npy"], "empty.npy: expected a 4x4 matrix"),
        (["a.npz", "b.npz", "--margin", "-1"], "margin: expected"),
        (["a.npz", "b.npz", "--margin", "-1e-3"], "margin: expected"),
        (["a.npz", "b.npz", "--margin", "nan"], "margin: expected"),
        (["cube.stl", "b.npz", "--threshold", "7"], "threshold: expected"),
        (
            ["a.npz", "b.npz", "--scale", "0.001"],
            "--scale: expected a mesh to make a body of, found saved bodies, a.npz",
        ),
        (["a.npz", "b.npz", "--hull"], "--hull: expected a mesh to make a body of, found saved bodies"),
        (["a.npz", "b.npz", "--max-pieces", "3"], "--max-pieces: expected a mesh to make a body of, found saved"),
    ],
)
def test_errors_are_one_line_with_status_2(saved, capsys, arguments, message):
    """Each error is one line on standard error, says what was found, and shows no traceback."""
    Path("empty.stl").touch()
    Path("empty.npy").touch()
    Path("text.npz").write_text("no arrays here")
    Path("words.txt").write_text("one two\nthree four\n")
    Path("short.txt").write_text("1 2 3\n")
    np.savetxt("scaled.txt", np.diag([2.0, 2.0, 2.0, 1.0]))
    status, out, err = run(capsys, "check", *arguments)
    assert status == 2
    assert out == ""
    assert err.startswith("loewner: error: ")
    assert message in err
    assert err.count("\n") == 1


# -- fit ----------------------------------------------------------------------------------------


def test_fit_saves_bodies_that_load(saved, fits_here, capsys):
    """Each mesh becomes DIR/name.npz; the table names it; the bodies answer."""
    status, out, _ = run(capsys, "fit", "cube.stl", "ball.obj", "-o", "made/here")
    assert status == 0
    assert "cube.npz" in out
    assert "convex, holds the mesh" in out
    body = loewner.Body.load("made/here/cube.npz")
    assert body.covering.exact
    np.testing.assert_allclose(body.outer.semi_axes, [[np.sqrt(3) / 2] * 3], rtol=1e-4)
    assert run(capsys, "check", "made/here/cube.npz", "made/here/ball.npz", "--pose-b", "3 0 0")[0] == 0


def test_fit_options_reach_the_fit(saved, fits_here, capsys):
    """--hull takes the hull of two boxes; without it they are two pieces; --tol is kept."""
    boxes = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1)).apply_translation([3, 0, 0])]
    trimesh.util.concatenate(boxes).export("two.stl")
    run(capsys, "fit", "two.stl", "-o", "parts", "--tol", "1e-7")
    run(capsys, "fit", "two.stl", "-o", "hulls", "--hull")
    parts = loewner.Body.load("parts/two.npz")
    assert len(parts.pieces) == 2
    assert parts.gaps.max() <= 1e-7
    assert len(loewner.Body.load("hulls/two.npz").pieces) == 1


@pytest.mark.parametrize("tolerance", quick(0.1, 0.05))
def test_fit_tells_how_far_pieces_stick_out(saved, fits_here, capsys, tolerance):
    """--tolerance is kept; the table says which model was made and how far it sticks out."""
    trimesh.creation.annulus(0.5, 1.0, 1.0, sections=8).export("ring.stl")
    status, out, _ = run(capsys, "fit", "ring.stl", "-o", "near", "--tolerance", str(tolerance))
    assert status == 0
    body = loewner.Body.load("near/ring.npz")
    assert body.covering.max_protrusion <= tolerance
    told = " ".join(out.split())
    assert "decomposition, holds the mesh" in told
    assert f"sticks out by up to {1e3 * body.covering.max_protrusion:.3g} mm" in told
    assert "convex, holds the mesh, +0.0 % volume, sticks out by up to 0 mm" in " ".join(
        run(capsys, "fit", "cube.stl", "-o", "near")[1].split()
    )
    status, _, err = run(capsys, "fit", "ring.stl", "-o", "near", "--tolerance", "0")
    assert status == 2
    assert "tolerance" in err


def test_fit_refuses_two_meshes_of_one_name(saved, capsys):
    """a/part.stl and b/part.obj would overwrite each other."""
    status, _, err = run(capsys, "fit", "a/part.stl", "b/part.obj", "-o", "out")
    assert status == 2
    assert "part.npz" in err
    assert not Path("out").exists()


@pytest.mark.parametrize("options", quick(("-j", "1"), (), ("-j", "2")))
def test_fit_goes_on_after_a_bad_mesh(saved, capsys, options):
    """The meshes before and after it are whole, it is listed with what is wrong, and nothing is left of it."""
    Path("bad.stl").write_bytes(Path("cube.stl").read_bytes()[:-10])
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export("flat.stl")
    status, out, err = run(capsys, "fit", "cube.stl", "bad.stl", "flat.stl", "ball.obj", "-o", "out", *options)
    assert status == 2
    assert "2 done, 2 failed" in out
    assert row(out.split("failed", 1)[1], "bad.stl", "expected")
    assert row(out.split("failed", 1)[1], "flat.stl", "points")
    assert "loewner: error: bad.stl: " in err
    assert "loewner: error: flat.stl: " in err
    assert sorted(p.name for p in Path("out").iterdir()) == ["ball.npz", "cube.npz"]
    loewner.Body.load("out/ball.npz")


def test_fit_loses_one_file_with_a_process(saved, capsys, monkeypatch):
    """A process that is killed over a mesh costs that mesh, and another one does the rest."""
    answers = jobs.answers
    monkeypatch.setattr(jobs, "answers", lambda _, *more: answers("dying", *more))
    folders = [Path(__file__).parent, *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, folders)))
    trimesh.creation.box((1, 1, 1)).export("deadly.stl")
    status, out, err = run(capsys, "fit", "cube.stl", "deadly.stl", "ball.obj", "-o", "out", "-j", "1")
    assert status == 2
    assert "2 done, 1 failed" in out
    assert "deadly.stl: the process that fitted it died" in err
    assert sorted(p.name for p in Path("out").iterdir()) == ["ball.npz", "cube.npz"]


@pytest.mark.verify
@pytest.mark.skipif(sys.platform == "win32", reason="processes there have no such signal")
def test_an_interrupted_fit_leaves_whole_files(saved):
    """Ctrl+C ends all processes: there are bodies that load, and nothing else."""
    ring = trimesh.creation.annulus(0.5, 1.0, 1.0, sections=24)
    names = [f"ring{k}.stl" for k in range(40)]
    for name in names:
        ring.export(name)
    arguments = [sys.executable, "-m", "loewner", "fit", *names, "-o", "out", "-j", "2", "--tolerance", "0.05"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while not list(Path("out").glob("*.npz")) and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        err = process.communicate()[1]
    assert process.returncode == 2
    assert "loewner: interrupted" in err
    assert "Traceback" not in err
    made = list(Path("out").iterdir())
    assert 0 < len(made) < len(names)
    for path in made:
        loewner.Body.load(path)


def test_fit_refuses_options_once(saved, capsys):
    """What is wrong with an option is told once, before any mesh; processes are at least one, and not for a cluster."""
    for wrong, told in (
        (["--threshold", "7"], "threshold: expected"),
        (["-j", "0"], "--jobs: expected an integer >= 1, found 0"),
        (["-j", "2", "--scheduler", "tcp://localhost:1"], "--jobs: expected it without --scheduler"),
    ):
        status, out, err = run(capsys, "fit", "cube.stl", "ball.obj", "-o", "out", *wrong)
        assert (status, out) == (2, "")
        assert err.count("error") == 1
        assert told in err


@pytest.mark.verify
@pytest.mark.parametrize("whole", [2, 5])
def test_parts_of_every_kind_are_fitted(saved, capsys, whole):
    """Of a few parts, one of them open and one cut short, all that can be are fitted, and the other one is listed."""
    meshes, damaged = made_parts.write(saved / "parts", 11)
    meshes = [*meshes[:whole], meshes[10]]
    assert damaged == meshes[whole:]
    status, out, err = run(capsys, "fit", *meshes, "-o", "out", "-j", "2", "--tolerance", "0.002")
    assert status == 2
    assert f"{len(meshes) - len(damaged)} done, {len(damaged)} failed" in out
    assert {p.stem for p in Path("out").glob("*.npz")} == {p.stem for p in meshes} - {p.stem for p in damaged}
    assert "--model surface" in err


def test_fit_into_a_file_is_an_error(saved, capsys):
    """The output folder cannot be a file."""
    assert run(capsys, "fit", "cube.stl", "-o", "a.npz")[0] == 2


# -- clearance ----------------------------------------------------------------------------------


@pytest.fixture
def row_of_boxes(tmp_path, monkeypatch):
    """Unit boxes at x = 0, 1.25 and 5 as bodies, and one at 5.5 as a mesh."""
    monkeypatch.chdir(tmp_path)
    for name, x in (("a", 0.0), ("b", 1.25), ("c", 5.0)):
        T = np.eye(4)
        T[0, 3] = x
        loewner.Body.box([1, 1, 1]).transformed(T).save(f"{name}.npz")
    trimesh.creation.box((1, 1, 1)).apply_translation([5.5, 0, 0]).export("d.stl")
    return "a.npz", "b.npz", "c.npz", "d.stl"


def test_clearance_of_all_pairs(row_of_boxes, capsys):
    """Each pair has one row, with its exact distance between its bounds; a pair that collides makes the status 1."""
    status, out, _ = run(capsys, "clearance", *row_of_boxes, "--csv", "pairs.csv")
    assert status == 1
    assert "6 pairs, 1 colliding" in out
    head, *rows = csv.reader(Path("pairs.csv").read_text().splitlines())
    assert head == ["a", "b", "verdict", "distance, m", "lower, m", "upper, m"]
    assert [(a, b) for a, b, *_ in rows] == list(itertools.combinations(row_of_boxes, 2))
    found = {(a, b): (verdict, *map(float, numbers)) for a, b, verdict, *numbers in rows}
    for _, distance, lower, upper in found.values():
        assert lower <= distance <= upper
    assert found["a.npz", "b.npz"][0] == "FREE"
    assert found["a.npz", "b.npz"][1] == pytest.approx(0.25)
    assert found["a.npz", "d.stl"][1] == pytest.approx(4.5)
    assert found["c.npz", "d.stl"][0] == "COLLIDING"
    assert run(capsys, "clearance", *row_of_boxes[:3])[0] == 0


def test_clearance_within(row_of_boxes, capsys):
    """Pairs that are farther apart are left out, and no others."""
    status, out, _ = run(capsys, "clearance", *row_of_boxes[:3], "--within", "0.3")
    assert status == 0
    assert "3 pairs, 1 at most 0.3 m apart, 0 colliding" in out
    assert row(out, "a.npz", "b.npz", "FREE", "0.25")
    assert not row(out, "a.npz", "c.npz")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.npz"], "BODY: expected two bodies or more, found 1"),
        (["a.npz", "none.npz"], "none.npz: expected"),
        (["a.npz", "b.npz", "--within", "-1"], "--within: expected"),
        (["a.npz", "b.npz", "--csv", "none/pairs.csv"], "--csv: expected a file in a folder that exists"),
    ],
)
def test_clearance_errors(row_of_boxes, capsys, arguments, message):
    """Errors are one line with status 2."""
    status, out, err = run(capsys, "clearance", *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_clearance_of_what_cannot_be_settled(row_of_boxes, capsys, monkeypatch):
    """Such a pair counts as colliding, and has bounds but no distance."""

    def distance(*arguments, exact=False, **options):
        found = measured(*arguments, exact=exact, **options)
        if exact:
            found.distance[0] = np.nan
            raise loewner.ConvergenceError("not settled", [0], found)
        return found

    def collide(*arguments, **options):
        raise loewner.ConvergenceError("not settled", [0], np.array([True]))

    measured = loewner.distance
    monkeypatch.setattr(loewner, "distance", distance)
    monkeypatch.setattr(loewner, "collide", collide)
    assert run(capsys, "clearance", "a.npz", "b.npz", "--within", "1", "--csv", "pairs.csv")[0] == 1
    cells = Path("pairs.csv").read_text().splitlines()[1].split(",")
    assert cells[:4] == ["a.npz", "b.npz", "COLLIDING", ""]
    assert float(cells[4]) <= 0.25 <= float(cells[5])


# -- robot --------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with a robot, and a scene with a wall along y, 0.1 m thick."""
    monkeypatch.chdir(tmp_path)
    gantry(tmp_path)
    Path("wall.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1]}\n")
    return tmp_path


ROBOT = ("gantry.urdf", "--srdf", "gantry.srdf")
WITH_WALL = (*ROBOT, "--scene", "wall.yaml")


def row(out, *cells):
    """Whether a table has a row that starts with these cells."""
    return re.search(r"^\W*" + r"\W+".join(re.escape(c) for c in cells) + r"\b", out, flags=re.M) is not None


def test_robot_info(folder, capsys):
    """Links with pieces and vertices, joints with limits, pairs, groups and states."""
    status, out, err = run(capsys, "robot", "info", *ROBOT)
    assert (status, err) == (0, "")
    assert row(out, "rod", "1", "8")
    assert row(out, "ball", "1", "0")
    assert "│ x      │ -1    │ 1" in out
    assert "│ turn   │ -inf  │ inf" in out
    assert "pairs     1 of links with bodies, 0 checked\n          1 disabled by the SRDF, 1 adjacent" in out
    assert "groups    slide (2), nothing (0)\nstates    left, wall" in out


def test_robot_check_counts_what_the_checker_finds(folder, capsys):
    """The JSON agrees with the library, and with plane geometry for the ball."""
    status, out, _ = run(
        capsys, "robot", "check", *ROBOT, "--scene", "wall.yaml", "--random", 2000, "--seed", 3, "--json"
    )
    answer = json.loads(out)
    robot = loewner.Robot.from_urdf("gantry.urdf", srdf="gantry.srdf")
    Q = robot.random_configurations(2000, 3)
    expected = loewner.CollisionChecker(robot, loewner.load_scene("wall.yaml")).collide(Q)
    assert status == 1
    assert answer["colliding_rows"] == np.flatnonzero(expected).tolist()
    assert (answer["colliding"], answer["free"]) == (expected.sum(), 2000 - expected.sum())
    assert sum(answer["tiers"].values()) == answer["configurations"] == 2000
    counts = {(a, b): count for a, b, count in answer["pairs"]}
    assert counts["ball", "wall"] == (np.abs(Q[:, 0]) <= 0.05 + RADIUS).sum()
    assert expected.sum() < sum(counts.values())  # some by both
    assert list(counts.values()) == sorted(counts.values(), reverse=True)
    assert answer["outside_limits"] == []


def test_robot_check_settles_each_configuration_once(folder, capsys, monkeypatch):
    """Answers and tiers come of one search; one configuration more is for compiling, before the clock starts."""
    asked = []
    classified = verdicts.classified
    monkeypatch.setattr(
        verdicts, "classified", lambda ready, mode, Q: asked.append(len(Q)) or classified(ready, mode, Q)
    )
    run(capsys, "robot", "check", *ROBOT, "--scene", "wall.yaml", "--random", 500, "--json")
    assert asked == [1, 500]


def test_robot_check_prints_tables(folder, capsys):
    """`robot check` prints how many configurations collide, what settled each of them, and which pairs met."""
    status, out, err = run(capsys, "robot", "check", *ROBOT, "--scene", "wall.yaml", "--random", 500)
    assert (status, err) == (1, "")
    colliding = int(re.match(r"COLLIDING  (\d+) of 500 configurations in collision", out)[1])
    settled = [line for line in out.splitlines() if re.match(r"\W*(bounding|ellipsoids|planes|exact)", line)]
    assert sum(int(n) for line in settled for n in re.findall(r"\d+", line)) == 500
    assert 0 < colliding < 500
    assert row(out, "rod", "wall")


@pytest.mark.parametrize(("least", "told"), [(0.0, True), (60.0, False)])
def test_robot_check_tells_a_rate_only_of_what_took_a_while(folder, capsys, monkeypatch, least, told):
    """Of a short batch, most of the time is that of starting: no rate is printed, and in JSON it is null."""
    monkeypatch.setattr("loewner.cli.robot.LEAST_TIMED", least)
    check = ("robot", "check", *ROBOT, "--scene", "wall.yaml", "--random", 500)
    assert ("configurations a second" in run(capsys, *check)[1]) == told
    assert (json.loads(run(capsys, *check, "--json")[1])["per_second"] is not None) == told


@pytest.mark.parametrize(
    ("excess", "text"), [(-1e-16, "+0.0 %"), (0.0, "+0.0 %"), (0.013, "+1.3 %"), (-0.02, "-2.0 %")]
)
def test_excess_volume_is_never_minus_zero(excess, text):
    """Rounding can make the volume of the pieces a little less than that of the mesh."""
    assert text in covering_text(loewner.Covering("convex", True, 0.0, excess, 8))


def test_compile_tells_each_part_in_a_log(capsys, monkeypatch, tmp_path):
    """Where standard error is no terminal, each part that is done is a line there."""

    def compiled(parts, *, progress):
        for done in range(len(parts)):
            progress(done + 1, len(parts))
        return tmp_path

    monkeypatch.setattr("loewner.cli.compile.compile_kernels", compiled)
    monkeypatch.setattr(library, "level", lambda: None)
    status, out, err = run(capsys, "compile", "--only", "fits", "paper")
    assert (status, out) == (0, f"compiled into {tmp_path}\n")
    assert err.splitlines()[1:] == ["loewner: 1 of 2 parts compiled", "loewner: 2 of 2 parts compiled"]


def test_compile_has_nothing_to_do_beside_a_library(capsys, monkeypatch):
    """Where the native library is in use, the command says so, and compiles nothing."""
    monkeypatch.setattr(library, "level", lambda: "x86-64-v3")
    monkeypatch.setattr(entries, "missing", list)
    assert run(capsys, "compile")[:2] == (0, "nothing to compile: the native library is in use (x86-64-v3)\n")


@pytest.mark.parametrize(
    ("is_running", "told"), [(True, "of its 84 kernels are still"), (False, "run native/build.py")]
)
def test_compile_tells_what_a_library_lacks(capsys, monkeypatch, is_running, told):
    """While a build goes on, and after one that was stopped, nobody is told that there is nothing to compile."""
    monkeypatch.setattr(library, "level", lambda: "x86-64-v3")
    monkeypatch.setattr(library, "built_with", lambda: "1.2.3")
    monkeypatch.setattr(library, "is_being_built", lambda: is_running)
    monkeypatch.setattr(library, "_opened_list", {"entries": ["settle_range"]})
    status, out, _ = run(capsys, "compile")
    assert (status, told in out) == (0, True)
    assert "83 of its 84" in out
    assert "without 83 kernels" in run(capsys, "info")[1]


@pytest.mark.parametrize(
    ("opened", "told"),
    [
        ((object(), "x86-64-v3"), "native library, x86-64-v3, built with Numba 0.99"),
        ((None, "it was not built"), "compiled by Numba on this machine; no native library (it was not built)"),
    ],
)
def test_info_tells_how_the_kernels_run(capsys, monkeypatch, opened, told):
    """Version, library or compiler and why, threads, and what each extra needs."""
    monkeypatch.setattr(library, "_opened", lambda: opened)
    monkeypatch.setattr(library, "built_with", lambda: "0.99")
    status, out, _ = run(capsys, "info")
    lines = dict(line.split(":", 1) for line in out.splitlines())
    assert status == 0
    assert lines["loewner"].strip() == loewner.__version__
    assert lines["kernels"].strip() == told
    assert int(lines["threads"]) >= 1
    assert lines["[cli]"].strip().startswith("rich ")


def test_info_tells_what_is_missing(capsys, monkeypatch):
    """Without a library and without Numba it says what to install; an extra that is not there is named."""
    monkeypatch.setattr(library, "_opened", lambda: (None, "it was not built"))
    monkeypatch.setattr("loewner.cli.info.installed", lambda name: MISSING if name in ("numba", "ompl") else "1.0")
    _, out, _ = run(capsys, "info")
    assert "none: no library (it was not built), and no Numba; pip install 'loewner[jit]'" in out
    assert re.search(r"^\[planners\]: +ompl not installed$", out, flags=re.M)


@pytest.mark.parametrize(
    ("options", "status"),
    [(["left"], 0), (["wall"], 1), (["left", "--margin", "0.34"], 0), (["left", "--margin", "0.36"], 1)],
)
def test_robot_check_state(folder, capsys, options, status):
    """The ball at x = -0.5 is 0.35 m from the wall; the rod, along x, ends nearer, so it is turned away first."""
    Path("wall.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1]}\nallow: [[rod, wall]]\n")
    found = run(capsys, "robot", "check", *ROBOT, "--scene", "wall.yaml", "--state", *options)
    assert found[0] == status
    assert found[1].startswith(["FREE  0 of 1", "COLLIDING  1 of 1"][status])


@pytest.mark.parametrize(
    ("of_wall", "others"), [(True, ""), (False, "[ball, {}]"), (True, "[ball, {}]"), (False, "[ball, wall, {}]")]
)
def test_robot_check_margin_is_a_floor(folder, capsys, of_wall, others):
    """Smaller margins of bodies, links and pairs are raised; larger ones stay. The ball is 0.35 m from the wall."""

    def write(margin):
        own, listed = (
            f", margin: {margin}" if of_wall else "",
            f"margins: [{others.format(margin)}]\n" if others else "",
        )
        text = f"bodies:\n  wall: {{box: [0.1, 4, 1]{own}}}\nallow: [[rod, wall]]\n{listed}"
        Path("wall.yaml").write_text(text)

    write(0.01)
    check = ("robot", "check", *WITH_WALL, "--state", "left", "--margin")
    assert [run(capsys, *check, margin)[0] for margin in ("0.34", "0.36")] == [0, 1]
    write(0.36)
    assert run(capsys, *check, "0.1")[0] == 1


def test_robot_info_without_srdf(folder, capsys):
    """Says so, and gives no empty groups; a robot without bodies has no pairs."""
    Path("bare.urdf").write_text('<robot name="bare"><link name="a"/></robot>')
    for name, pairs, adjacent in (("gantry", 1, 1), ("bare", 0, 0)):
        status, out, err = run(capsys, "robot", "info", f"{name}.urdf")
        assert (status, err) == (0, "")
        assert f"pairs     {pairs} of links with bodies, 0 checked\n          no SRDF, {adjacent} adjacent" in out
        assert "groups" not in out


def test_robot_check_files(folder, capsys):
    """.npy and .csv, with and without names in another order, one and many; what is outside the limits is said."""
    Q = np.array([[-0.5, 0.0, 2.0], [0.0, 0.5, 0.0], [-1.5, 0.0, 2.0]])
    np.save("many.npy", Q)
    np.save("one.npy", Q[0])
    np.savetxt("plain.csv", Q, delimiter=",")
    np.savetxt("named.csv", Q[:, [2, 0, 1]], delimiter=", ", header="turn, x, y", comments="")
    for name in ("many.npy", "plain.csv", "named.csv"):
        status, out, _ = run(capsys, "robot", "check", *ROBOT, "--scene", "wall.yaml", "--configs", name, "--json")
        answer = json.loads(out)
        assert (status, answer["colliding_rows"], answer["outside_limits"]) == (1, [1], [2])
        assert answer["outside_limits_of"] == ["x"]
    assert run(capsys, "robot", "check", *ROBOT, "--scene", "wall.yaml", "--configs", "one.npy")[0] == 0
    out = run(capsys, "robot", "check", *WITH_WALL, "--configs", "many.npy")[1]
    assert "note: 1 configuration outside the limits, the first in row 3: x" in out


def test_an_error_names_the_option_that_was_given(folder, capsys):
    """Users of the command line do not know the arguments of Python."""
    for options, option in (
        (["--all", "--margin", "-1"], "--margin"),
        (["--between", "ball", "none"], "--between"),
        (["--all", "--largest", "none"], "--largest"),
        (["--all", "--write-srdf=none/a.srdf"], "--write-srdf"),
    ):
        status, _, err = run(capsys, "clash", *ROBOT, *options)
        assert (status, err.startswith(f"loewner: error: {option}: expected ")) == (2, True), err
    assert _with_option("format: expected", ["judge", "--format=vamp"]) == "--format: expected"
    assert _with_option("format: expected", ["cover", "--for", "vamp"]) == "--for: expected"
    assert _with_option("format: expected", ["cover"]) == "format: expected"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.urdf", "--random", "5"], "none.urdf"),
        ([*ROBOT, "--scene", "none.yaml", "--random", "5"], "none.yaml"),
        ([*ROBOT, "--random", "0"], "--random: expected an integer >= 1, found 0"),
        ([*ROBOT, "--random", "5", "--seed", "-1"], "--seed: expected an integer >= 0, found -1"),
        ([*ROBOT, "--configs", "q.npy", "--seed", "1"], "--seed: expected --random with it, found none"),
        ([*ROBOT, "--state", "lefd"], "state: expected one of left, wall; found 'lefd' (did you mean 'left'?)"),
        (["gantry.urdf", "--state", "left"], "no SRDF was given"),
        ([*ROBOT, "--state", "left"], "gantry.urdf: expected pairs to check, found none"),
        (["bare.urdf", "--random", "5"], "robot: expected a robot with collision geometry, found none in 'bare'"),
        ([*ROBOT, "--state", "left", "--margin", "0.1"], "--margin: expected --scene with it"),
        ([*ROBOT, "--scene", "wall.yaml", "--state", "left", "--margin", "-1"], "margin: expected"),
        ([*WITH_WALL, "--configs", "none.npy"], "none.npy: expected configurations, but there is no such file"),
        ([*WITH_WALL, "--configs", "gantry.urdf"], "gantry.urdf: expected a .npy, .csv or .json file, found .urdf"),
        ([*WITH_WALL, "--configs", "text.npy"], "text.npy: expected an array of numbers"),
        ([*WITH_WALL, "--configs", "narrow.npy"], "narrow.npy: expected shape (..., 3)"),
        ([*WITH_WALL, "--configs", "deep.npy"], "deep.npy: expected shape (n, 3), found (2, 2, 3)"),
        ([*WITH_WALL, "--configs", "nan.npy"], "nan.npy[1]: expected finite numbers, found nan for y"),
        (
            [*WITH_WALL, "--configs", "names.csv"],
            "names.csv, column: expected one of x, y, turn; found 'turm' (did you",
        ),
        ([*WITH_WALL, "--configs", "two.csv"], "two.csv: expected a column for each joint value, found none for turn"),
        ([*WITH_WALL, "--configs", "twice.csv"], "twice.csv: expected each column once, found x 2 times"),
        (
            [*WITH_WALL, "--configs", "half.csv"],
            "half.csv: expected 3 finite numbers in each row, found 1,2,a in row 1",
        ),
        ([*WITH_WALL, "--configs", "german.csv"], "german.csv: expected numbers separated by commas, found semicolons"),
        (
            [*WITH_WALL, "--configs", "spaces.csv"],
            "spaces.csv: expected numbers separated by commas, found spaces: 0.5 1 2",
        ),
        (
            [*WITH_WALL, "--configs", "below.csv"],
            "below.csv: expected numbers separated by commas, found spaces: 0.5 1 2",
        ),
        ([*WITH_WALL, "--configs", "hole.csv"], "hole.csv: expected 3 finite numbers in each row, found ,, in row 2"),
        (
            [*WITH_WALL, "--configs", "quoted.csv"],
            "quoted.csv: expected 3 finite numbers in each row, found 0,5,1,2 in row 1",
        ),
        (
            [*WITH_WALL, "--configs", "ragged.csv"],
            "ragged.csv: expected 3 finite numbers in each row, found 1,2 in row 2",
        ),
        ([*WITH_WALL, "--configs", "empty.csv"], "empty.csv: expected one configuration or more, found none"),
    ],
)
def test_robot_check_errors(folder, capsys, arguments, message):
    """One line on standard error, status 2."""
    Path("text.npy").write_text("words")
    np.save("narrow.npy", np.zeros((4, 2)))
    np.save("deep.npy", np.zeros((2, 2, 3)))
    np.save("nan.npy", [[0, 0, 0], [0, np.nan, 0]])
    Path("names.csv").write_text("x,y,turm\n1,2,3\n")
    Path("two.csv").write_text("y,x\n1,2\n")
    Path("twice.csv").write_text("x,y,x,turn\n1,2,1,0\n")
    Path("half.csv").write_text("1,2,a\n1,2,3\n")
    Path("hole.csv").write_text("1,2,3\n,,\n1,2,3\n")
    Path("quoted.csv").write_text('"0,5",1,2\n')
    Path("german.csv").write_text("0,5;1;2\n")
    Path("spaces.csv").write_text("0.5 1 2\n")
    Path("below.csv").write_text("x,y,turn\n0.5 1 2\n")
    Path("bare.urdf").write_text('<robot name="bare"><link name="a"/></robot>')
    Path("ragged.csv").write_text("1,2,3\n1,2\n")
    Path("empty.csv").touch()
    status, out, err = run(capsys, "robot", "check", *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("loewner: error: ")
    assert message in err
    assert err.count("\n") == 1


def test_robot_warnings_are_lines(folder, capsys):
    """An SRDF that names what the robot does not have is said once, without the place in the source."""
    text = Path("gantry.srdf").read_text()
    pair = '<disable_collisions link1="ball" link2="none"/></robot>'
    Path("gantry.srdf").write_text(text.replace("</robot>", pair))
    Path("wall.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1]}\nallow: [[rod, wall]]\n")
    status, _, err = run(capsys, "robot", "check", *WITH_WALL, "--state", "left")
    assert status == 0
    assert err.startswith("loewner: warning: ")
    assert "none" in err
    assert ".py" not in err


# -- plan ---------------------------------------------------------------------------------------

# The rod stands beside the ball, along y: the wall, which ends at y = 0.5, is between the two.
HERE, THERE = "-0.5 -0.5 1.5707963267948966", "0.5 -0.5 1.5707963267948966"
AROUND = ("plan", *ROBOT, "--scene", "end.yaml", "--start", HERE, "--goal", THERE)


@pytest.fixture
def with_end(folder):
    """The folder, with a wall that one can go around."""
    Path("end.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1], position: [0, -1.5, 0]}\n")
    return folder


def checker_of_folder():
    """The library's own view of the robot before that wall."""
    robot = loewner.Robot.from_urdf("gantry.urdf", srdf="gantry.srdf")
    return loewner.CollisionChecker(robot, loewner.load_scene("end.yaml"))


def test_plan_prints_what_is_proven(with_end, capsys):
    """The JSON holds the library's path and its proofs; distances to the wall are those of plane geometry."""
    status, out, err = run(capsys, *AROUND, "--joints", "slide", "--seed", 3, "--json")
    answer = json.loads(out)
    checker = checker_of_folder()
    path = planners.plan(checker, LEFT, RIGHT, joints="slide", seed=3)
    assert (status, err) == (0, "")
    np.testing.assert_array_equal(answer["configurations"], path)
    found = checker.certify_edges(path[:-1], path[1:])
    assert answer["verdict"] == "FREE"
    assert [motion["verdict"] for motion in answer["motions"]] == ["FREE"] * (len(path) - 1)
    assert [motion["poses"] for motion in answer["motions"]] == found.poses.tolist()
    assert [motion["searches"] for motion in answer["motions"]] == found.searches.tolist()
    assert sum(motion["length"] for motion in answer["motions"]) == pytest.approx(answer["length"])
    nearest = min(motion["nearest"] for motion in answer["motions"])
    assert clearance(path) - 1e-9 <= nearest <= clearance(path) + 0.02


def test_plan_prints_a_table(with_end, capsys):
    """The verdict comes first; a row for each motion names what is nearest; the length adds up."""
    status, out, err = run(capsys, *AROUND, "--joints", "slide")
    assert (status, err) == (0, "")
    count = int(re.match(r"FREE  (\d+) motions from start to goal, proven free at every configuration", out)[1])
    rows = re.findall(r"^│ (\d+) +│ ([0-9.]+) +│ FREE +│ ([0-9.]+) +│ (?:ball|rod) +│ wall ", out, flags=re.M)
    assert [int(k) for k, _, _ in rows] == list(range(count))
    length = float(re.search(r"^length +([0-9.]+)", out, flags=re.M)[1])
    assert sum(float(part) for _, part, _ in rows) == pytest.approx(length, rel=1e-3)
    nearest = float(
        re.search(r"^nearest +([0-9.]+) mm, on motion \d+: the least of the exact distances at 33", out, flags=re.M)[1]
    )
    assert nearest == min(float(part) for _, _, part in rows)


def test_a_path_can_be_viewed(with_end, capsys, monkeypatch, tmp_path):
    """`loewner view` plays the path that `loewner plan` wrote, and says what a path without times cannot have."""
    out = tmp_path / "path.csv"
    assert run(capsys, *AROUND, "--out", str(out))[0] == 0
    shown = []
    page = SimpleNamespace(url="http://here", wait=lambda: None)
    monkeypatch.setattr("loewner.viewer.show_robot", lambda *given, **more: shown.append(more) or page)
    robot = ["--robot", *ROBOT, "--scene", "end.yaml", "--trajectory", str(out), "--no-browser"]
    assert run(capsys, "view", *robot)[0] == 0
    assert len(shown[0]["path"]) > 2
    status, _, err = run(capsys, "view", *robot, "--start-time", "1")
    assert (status, "--start-time 1: expected points with times, found a path without" in err) == (2, True)


def test_a_plan_in_time_can_be_viewed_and_audited(with_end, capsys, monkeypatch):
    """`loewner view` and `loewner audit` read the start time before the header of a table that `loewner plan` wrote."""
    assert run(capsys, *AROUND, "--start-time", "3", "--velocity", "1", "-o", "plan.csv")[0] == 0
    assert Path("plan.csv").read_text().startswith("# start_time: 3.0\n")
    shown, page = [], SimpleNamespace(url="http://here", wait=lambda: None)
    monkeypatch.setattr("loewner.viewer.show_robot", lambda *given, **more: shown.append(more["trajectory"]) or page)
    robot = [*ROBOT, "--scene", "end.yaml"]
    for more, begins in (([], 3.0), (["--start-time", "5"], 5.0)):
        assert run(capsys, "view", "--robot", *robot, "--trajectory", "plan.csv", "--no-browser", *more)[0] == 0
        status, out, _ = run(capsys, "audit", robot[0], "plan.csv", *robot[1:], "--json", *more)
        assert (status, json.loads(out)["begins"], shown.pop().start_time) == (0, begins, begins)


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ("./b.npz", "--csv: expected a file of its own, found b.npz, also given as bodies"),
        ("nowhere/x.csv", "--csv: expected a file in a folder that exists, found nowhere/x.csv"),
    ],
)
def test_outputs_are_checked_before_the_work(saved, capsys, output, message):
    """No input is overwritten, and no result is computed that could not be written."""
    before = Path("b.npz").read_bytes()
    assert run(capsys, "clearance", "a.npz", "b.npz", "--csv", output) == (2, "", f"loewner: error: {message}\n")
    assert Path("b.npz").read_bytes() == before


def test_two_outputs_have_two_files(with_end, capsys):
    """The second would replace the first."""
    status, out, err = run(capsys, *AROUND, "-o", "path.csv", "--proof", "path.csv")
    assert (status, out) == (2, "")
    assert "expected a file of its own, found path.csv, also given as" in err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_an_error():
    """The status is 2, as for every error, and there is one line."""
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "loewner", "--help"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    message = "standard output: expected room for the output, found: No space left on device"
    assert (done.returncode, done.stderr) == (2, f"loewner: error: {message}\n")


@pytest.mark.parametrize("kind", ["no path", "ambiguous", "audit", "bad goal"])
def test_an_older_proof_does_not_pass_for_the_new_one(with_end, capsys, kind):
    """Where no proof can be written, none of that name is left, and a file that is no proof is left alone."""
    asked = {
        "no path": [*AROUND, "--joints", "turn", "--proof", "p.proof"],
        "ambiguous": [*AROUND, "--max-iterations", "1", "--timeout", "1e-9", "--proof", "p.proof"],
        "audit": ["audit", ROBOT[0], "hit.csv", *ROBOT[1:], "--scene", "end.yaml", "--proof", "p.proof"],
        "bad goal": [*AROUND[: AROUND.index("--goal")], "--goal", "nowhere", "--proof", "p.proof"],
    }[kind]
    Path("hit.csv").write_text("x,y,turn\n-0.5,-0.5,1.57\n0.5,-0.5,1.57\n")
    assert run(capsys, *AROUND, "--proof", "p.proof")[0] == 0
    assert run(capsys, "verify", "p.proof")[0] == 0
    assert run(capsys, *asked)[0] in (1, 2)
    assert not Path("p.proof").exists()
    Path("p.proof").write_text("mine")
    run(capsys, *asked)
    assert Path("p.proof").read_text() == "mine"
    status, out, err = run(capsys, *asked[:-1], "nowhere/p.proof")
    assert (status, out) == (2, "")
    assert "--proof: expected a file in a folder that exists, found nowhere/p.proof" in err
    status, out, err = run(capsys, *asked[:-1], 5000 * "x")
    assert (status, out) == (2, "")
    assert "--proof: expected a file that can be written, found xxx" in err


def test_plan_improves_the_path(with_end, capsys):
    """More seconds never cost more, and the cost is not below its bound; weights and times that are bad are refused."""
    plain = json.loads(run(capsys, *AROUND, "--json")[1])
    status, out, _ = run(capsys, *AROUND, "--json", "--improve-for", "0.03", "--weights", "1 1 0.5")
    better = json.loads(out)
    assert status == 0
    assert plain["cost"] == pytest.approx(plain["length"])
    assert plain["improvements"] == 0
    assert plain["cost_bound"] == pytest.approx(1.0)
    assert better["cost_bound"] <= better["cost"] <= plain["cost"]
    wide = json.loads(run(capsys, *AROUND, "--json", "--improve-for", "0.3", "--clearance", "0.1")[1])
    assert wide["length"] > 1.0
    assert wide["cost"] > wide["length"]
    for options, message in (
        (["--weights", "1 1 1"], "--weights: expected --improve-for"),
        (["--improve-for", "1", "--weights", "1 1"], r"weights: expected shape (3,)"),
        (["--improve-for", "1", "--weights", "one"], "--weights: expected numbers, found 'one'"),
        (["--clearance", "0.1"], "--clearance: expected --improve-for"),
        (["--improve-for", "1", "--clearance", "0"], "clearance: expected a finite number > 0"),
        (["--improve-for", "-1"], "improve_for: expected a finite number >= 0"),
    ):
        status, out, err = run(capsys, *AROUND, *options)
        assert (status, out) == (2, "")
        assert message in err


def test_plan_in_time(with_end, capsys):
    """Bodies that follow motions make the plan one in time, which is printed and written with its times."""
    Path("gate.yaml").write_text(
        "bodies:\n  gate:\n    box: [0.1, 6, 1]\n    follow:\n      poses: [{time: 5, position: [0, -1.5, 0]}, "
        "{time: 6, position: [0, -4.5, 0]}]\n"
    )
    ask = [*AROUND, "--scene", "gate.yaml", "--velocity", "1", "--start-time", "3"]
    status, out, err = run(capsys, *ask, "--json", "-o", "moved.csv")
    answer = json.loads(out)
    assert (status, err) == (0, "")
    assert answer["verdict"] == "FREE"
    assert answer["times"][0] == 3.0
    assert 5.0 < answer["times"][-1] < 7.0
    written = planners.Trajectory.load("moved.csv")
    np.testing.assert_array_equal(written.knots, answer["configurations"])
    np.testing.assert_array_equal(3.0 + written.times, answer["times"])
    robot = loewner.Robot.from_urdf("gantry.urdf", srdf="gantry.srdf")
    checker = loewner.CollisionChecker(robot, loewner.load_scene("gate.yaml"))
    assert written.start_time == 3.0
    assert checker.certify_trajectory(written).verdict == loewner.Verdict.FREE
    for name, wanted in (("moved.csv", (0, 1, 0)), ("moved.yaml", (1, 1, 0))):
        written.save(name)
        for more, status in zip(([], ["--start-time", "0"], ["--start-time", "3"]), wanted, strict=True):
            audit = run(capsys, "audit", *ROBOT, name, "--scene", "gate.yaml", "--json", *more)
            assert audit[0] == status, audit
    status, out, _ = run(capsys, *ask, "--arrive-by", "7")
    assert status == 0
    assert "each proven free at every instant\n" in out
    assert re.search(r"^time +[0-9.]+ s, from 3 s to [56]\.[0-9]+ s$", out, flags=re.M)
    for more, wanted, message in (
        (["--arrive-by", "3.5"], 1, "no path: arrive_by: expected 4 s or later"),
        (["--arrive-by", "2"], 2, "--arrive-by: expected a time after start_time, 3, found 2"),
        (["--velocity", "fast"], 2, "--velocity: expected numbers, found 'fast'"),
        (["--improve-for", "1"], 2, "--improve-for: expected a plan that is not in time"),
        (
            ["--proof", "in_time.proof"],
            2,
            "--proof: plans in time have no proofs yet, and this is one by --start-time and --vel",
        ),
        (["--leave", "ball", "gate"], 2, "--leave: expected a plan that is not in time, found --start-time and --vel"),
        (["--reach", "ball", "gate"], 2, "--reach: expected a plan that is not in time, found --start-time and --vel"),
        (["--overlap", "0.5"], 2, "--overlap: expected a plan that is not in time, found --start-time and --vel"),
    ):
        status, out, err = run(capsys, *ask, *more)
        assert (status, out) == (wanted, "")
        assert message in err
    for more, found in (
        (["--scene", "gate.yaml"], r"bodies that follow motions (gate)"),
        (["--scene", "end.yaml", "--arrive-by", "9"], "--arrive-by"),
        (["--scene", "end.yaml", "--velocity", "1"], "--velocity"),
    ):
        status, out, err = run(capsys, *AROUND, *more, "--proof", "in_time.proof", "-o", "no.csv")
        assert (status, out) == (2, "")
        assert (
            f"--proof: plans in time have no proofs yet, and this is one by {found}; write the trajectory by --out"
            in err
        )
    assert not Path("in_time.proof").exists()
    assert not Path("no.csv").exists()


def test_a_plan_from_a_deep_contact_is_no_success(with_end, capsys):
    """`leave` allows contact, not a wrong pose: the ball is 5 mm deep in the wall that it leaves."""
    ask = ["plan", *ROBOT, "--scene", "end.yaml", "--start", "-0.145 0 1.57", "--goal", HERE, "--leave", "ball", "wall"]
    status, out, _ = run(capsys, *ask)
    assert status == 1
    assert "deep      ball and wall overlap by 5.000 mm on motion 0, and --overlap allows 1 mm" in out
    status, out, _ = run(capsys, *ask, "--overlap", "0.01", "--json")
    assert (status, json.loads(out)["deep"]) == (0, [])
    status, _, err = run(capsys, *ask, "--overlap", "-1")
    assert (status, "--overlap: expected a finite number >= 0" in err) == (2, True), err


@pytest.mark.parametrize("name", ["path.csv", "path.json"])
def test_plan_writes_what_can_be_read(with_end, capsys, name):
    """To the last bit, with the columns' names, under no other name; other commands read the file."""
    status, out, _ = run(capsys, *AROUND, "-o", name, "--json")
    answer = json.loads(out)
    written = Path(name).read_text()
    if name.endswith("csv"):
        head, *rows = written.splitlines()
        assert (head, answer["out"]) == ("x,y,turn", name)
        assert [[float(cell) for cell in row.split(",")] for row in rows] == answer["configurations"]
    else:
        assert json.loads(written) == {"names": ["x", "y", "turn"], "configurations": answer["configurations"]}
    assert status == 0
    assert [p.name for p in Path().iterdir() if "path" in p.name] == [name]
    check = ("robot", "check", *ROBOT, "--scene", "end.yaml", "--configs", name, "--json")
    checked = json.loads(run(capsys, *check)[1])
    assert (checked["configurations"], checked["colliding"]) == (len(answer["configurations"]), 0)


def test_plan_takes_states_files_and_numbers(with_end, capsys):
    """A goal by name keeps the start's values of what its state does not name; a file may hold several goals."""
    Path("end.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1], position: [0, -1.5, 0]}\nallow: [[rod, wall]]\n")
    plan = ("plan", *ROBOT, "--scene", "end.yaml", "--json")
    np.save("goals.npy", [[0.0, -0.5, 0.5], [0.5, -0.5, 0.5]])  # the first is in the wall
    Path("start.json").write_text("[0.5, -0.5, 0.5]")
    for start, goal, first, last in (
        ("left", "goals.npy", [-0.5, -0.5, 0.0], [0.5, -0.5, 0.5]),
        ("start.json", "left", [0.5, -0.5, 0.5], [-0.5, -0.5, 0.5]),
        ("-0.5,-0.5, 1", "left", [-0.5, -0.5, 1.0], [-0.5, -0.5, 1.0]),
        ("-0.5,-0.5,1", "-.5,-5e-1,0.5", [-0.5, -0.5, 1.0], [-0.5, -0.5, 0.5]),
    ):
        status, out, _ = run(capsys, *plan, "--start", start, "--goal", goal)
        rows = json.loads(out)["configurations"]
        assert (status, rows[0], rows[-1]) == (0, first, last)


@pytest.mark.parametrize("simplify", [[], ["--no-simplify"]])
def test_plan_options_reach_the_planner(with_end, capsys, simplify):
    """Seed, joints, simplification and sampling are the library's."""
    sampled = ("--sampled", "--resolution", 0.01, "--timeout", 30, "--max-iterations", 5000)
    answer = json.loads(
        run(capsys, *AROUND, "--seed", 5, *sampled, *simplify, "--json", "--joints", "x", "--joints", "y")[1]
    )
    path = planners.plan(
        checker_of_folder(), LEFT, RIGHT, joints=["x", "y"], certified=False, resolution=0.01, timeout=30.0,
        max_iterations=5000, seed=5, simplify=not simplify,
    )  # fmt: skip
    np.testing.assert_array_equal(answer["configurations"], path)
    assert answer["sampled"]


def test_plan_with_a_joint_error(with_end, capsys):
    """The path is the library's, the ball keeps the distance, and the verdict states the error."""
    around = (*AROUND, "--joints", "slide", "--joint-error", 0.02)
    answer = json.loads(run(capsys, *around, "--json")[1])
    path = planners.plan(checker_of_folder(), LEFT, RIGHT, joints="slide", joint_error=0.02)
    np.testing.assert_array_equal(answer["configurations"], path)
    assert (answer["verdict"], answer["joint_error"]) == ("FREE", 0.02)
    assert clearance(path) > 0.02
    assert "on the way, with every value up to 0.02 off\n" in run(capsys, *around)[1]


def test_plan_tells_what_sampling_missed(with_end, capsys):
    """Steps of 0.9 m pass through the wall: the certificate finds it, names the pair, and the status is 1."""
    steps = ("--sampled", "--resolution", 0.9, "--joints", "slide")
    status, out, _ = run(capsys, *AROUND, *steps, "-o", "path.json")
    assert status == 1
    assert re.match(r"COLLIDING  \d of \d motions from start to goal not proven free\n", out)
    k, pair, fraction = re.search(r"motion (\d+): (\w+ and wall) collide at the fraction ([0-9.]+)\n", out).groups()
    path = np.array(json.loads(Path("path.json").read_text())["configurations"])
    checker = checker_of_folder()
    q = checker.robot.between(path[int(k)], path[int(k) + 1], float(fraction))
    assert pair in {f"{contact.name_a} and {contact.name_b}" for contact in checker.pairs(q)}
    answer = json.loads(run(capsys, *AROUND, *steps, "--json")[1])
    assert answer["verdict"] == answer["motions"][int(k)]["verdict"] == "COLLIDING"
    assert " and ".join(answer["motions"][int(k)]["pair"]) == pair


def test_plan_that_is_ambiguous_exits_with_3(with_end, capsys, monkeypatch):
    """What cannot be told free is not called free."""
    certify = loewner.CollisionChecker.certify_edges

    def unsure(self, Q0, Q1, **options):
        found = certify(self, Q0, Q1, **options)
        found.verdict[0], found.fraction[0], found.names[0] = loewner.Verdict.AMBIGUOUS, 0.25, ("ball", "wall")
        return found

    monkeypatch.setattr(loewner.CollisionChecker, "certify_edges", unsure)
    status, out, _ = run(capsys, *AROUND)
    assert status == 3
    assert out.startswith("AMBIGUOUS  1 of ")
    assert "motion 0: ball and wall come too near to tell at the fraction 0.25\n" in out


def test_plan_with_a_planner_of_ompl(with_end, capsys):
    """By name; its path is proven like any other."""
    answer = json.loads(run(capsys, *AROUND, "--joints", "slide", "--planner", "RRTConnect", "--json")[1])
    assert answer["verdict"] == "FREE"
    assert clearance(np.array(answer["configurations"])) > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--start", "lefd", "--goal", THERE],
            "--start, state: expected one of left, wall; found 'lefd' (did you mean",
        ),
        (["--start", HERE, "--goal", "1 2"], "--goal: expected shape (..., 3), one column each for x, y, turn"),
        (["--start", HERE, "--goal", "nan 0 0"], "--goal: expected finite numbers, found nan for x"),
        (["--start", HERE, "--goal", "0,,1,2"], "--goal: expected numbers, a .npy, .csv or .json file, or with --srdf"),
        (["--start", HERE, "--goal", "0,5 1 2"], "not by both, and no decimal commas, found '5 1 2'"),
        (["--start", "two.csv", "--goal", THERE], "--start: expected one configuration, shape (3,), found (2, 3)"),
        (["--start", HERE, "--goal", "none.npy"], "none.npy: expected configurations, but there is no such file"),
        (["--start", HERE, "--goal", "empty.csv"], "goal: expected shape (3,) or (goals, 3), found (0, 3)"),
        (["--start", HERE, "--goal", "text.json"], "text.json: expected an array of numbers, found something else"),
        (["--start", HERE, "--goal", "keys.json"], "\"names\" and \"configurations\", found 'names', 'values'"),
        (["--start", HERE, "--goal", "names.json"], "names.json, column: expected one of x, y, turn; found 'turm'"),
        (["--start", HERE, "--goal", "narrow.json"], "narrow.json: expected 3 numbers for each configuration, found"),
        (["--start", HERE, "--goal", "words.json"], "words.json: expected"),
        (["--start", HERE, "--goal", THERE, "--max-iterations", "0"], "--max-iterations: expected an integer >= 1"),
        (["--start", HERE, "--goal", THERE, "--timeout", "nan"], "timeout: expected a finite number > 0"),
        (["--start", HERE, "--goal", THERE, "--seed", "-1"], "seed: expected an integer >= 0, found -1"),
        (["--start", HERE, "--goal", THERE, "--joints", "slid"], "joints: expected one of slide, nothing, x, y, turn"),
        (["--start", HERE, "--goal", THERE, "--planner", "RRTStar"], "(did you mean 'RRTstar'?)"),
        (["--start", HERE, "--goal", THERE, "--planner", "PRM", "--max-iterations", "9"], "expected no --planner with"),
        (
            ["--start", HERE, "--goal", THERE, "--joint-error", "-1"],
            "--joint-error: expected one number >= 0 or 3 of them",
        ),
        (["--start", HERE, "--goal", THERE, "--joint-error", "1", "--sampled"], "--joint-error: expected no --sampled"),
        (["--start", HERE, "--goal", THERE, "--resolution", "0.1"], "--resolution: expected --sampled or --planner"),
        (["--start", HERE, "--goal", THERE, "--sampled", "--resolution", "0"], "resolution: expected a finite number"),
        (["--start", HERE, "--goal", THERE, "-o", "path.txt"], "--out: expected a .csv or .json file, found path.txt"),
        (["--start", HERE, "--goal", THERE, "-o", "none/path.csv"], "--out: expected a file in a folder that exists"),
        (["--start", HERE, "--goal", THERE, "--scene", "none.yaml"], "none.yaml"),
    ],
)
def test_plan_errors(with_end, capsys, arguments, message):
    """One line on standard error, status 2, and no file."""
    Path("two.csv").write_text("0,0,0\n1,1,1\n")
    Path("empty.csv").touch()
    Path("text.json").write_text("[1, 2")
    Path("keys.json").write_text('{"names": [], "values": []}')
    Path("names.json").write_text('{"names": ["x", "y", "turm"], "configurations": [[0, 0, 0]]}')
    Path("narrow.json").write_text('{"names": ["x", "y", "turn"], "configurations": [[0, 0]]}')
    Path("words.json").write_text('["one", "two", "three"]')
    status, out, err = run(capsys, "plan", *ROBOT, "--scene", "end.yaml", *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("loewner: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert not list(Path().glob("*path*"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--start", "left", "--goal", THERE], "start: expected a free configuration within the limits, found a coll"),
        (["--start", HERE, "--goal", "9 0 0"], "goal: expected a free configuration within the limits, found x = 9"),
        (["--start", HERE, "--goal", THERE, "--joints", "x", "--timeout", "0.2"], "expected a path from start to goal"),
        (["--start", HERE, "--goal", THERE, "--max-iterations", "1"], "none within 1 iterations"),
        (
            ["--start", HERE, "--goal", THERE, "--joint-error", "0.5"],
            "start: expected a free configuration within the limits",
        ),
    ],
)
def test_plan_without_a_path_exits_with_1(with_end, capsys, arguments, message):
    """That there is no path is an answer, not an error: status 1, one line on standard error, and no file."""
    status, out, err = run(capsys, "plan", *ROBOT, "--scene", "end.yaml", *arguments, "-o", "path.csv")
    assert (status, out) == (1, "")
    assert err.startswith("loewner: no path: ")
    assert message in err
    assert err.count("\n") == 1
    assert not list(Path().glob("*path*"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gantry.urdf", "--scene", "end.yaml", "--start", "left"], "--start: expected numbers, a .npy, .csv or .json"),
        ([*ROBOT, "--start", "left"], "gantry.urdf: expected pairs to check, found none"),
    ],
)
def test_plan_needs_states_and_pairs(with_end, capsys, arguments, message):
    """A state needs an SRDF; where nothing can collide, nothing is called free."""
    status, out, err = run(capsys, "plan", *arguments, "--goal", THERE)
    assert (status, out) == (2, "")
    assert message in err


# -- paper --------------------------------------------------------------------------------------


def test_paper_prints_tables_and_writes_counts(saved, capsys):
    """All tables are printed, within 80 columns, and the counts add up."""
    status, out, _ = run(capsys, "paper", "--pairs", "40", "--seed", "3", "--json", "counts.json")
    assert status == 0
    assert max(map(len, out.splitlines())) <= 80
    for k in "1234":
        assert f"Table {k} (a)" in out
    counts = json.loads(Path("counts.json").read_text())
    assert counts["pairs"] == 40
    for detector in counts["detectors"]:
        assert sum(detector["all"].values()) == 40


@pytest.mark.parametrize("arguments", [["--pairs", "0"], ["--pairs", "-3"], ["--dataset", "cube"]])
def test_paper_refuses(saved, capsys, arguments):
    """Bad numbers and names are one clear line."""
    status, _, err = run(capsys, "paper", *arguments)
    assert status == 2
    assert err.count("\n") == 1


# -- the program --------------------------------------------------------------------------------


# -- audit --------------------------------------------------------------------------------------

AUDIT = ("audit", *ROBOT, "moves.csv", "--scene", "end.yaml")
AROUND_END = "time,x,y,turn\n0,-0.5,0.7,1.5\n1,0,0.7,1.5\n2,0.5,0.7,1.5\n"
THROUGH = "time,x,y,turn\n0,-0.5,0.7,1.5\n1,0,0.7,1.5\n2,0,-0.5,1.5\n3,0.5,0.7,1.5\n"


def test_audit_of_a_free_trajectory(with_end, capsys):
    """The ball passes 0.1 m above the wall's end; the nearest distance is that of plane geometry."""
    Path("moves.csv").write_text(AROUND_END)
    status, out, err = run(capsys, *AUDIT)
    assert (status, err) == (0, "")
    assert out.startswith("FREE  2 pieces, proven free at every time\n")
    assert re.search(r"^time +0 s \.{60} 2 s$", out, flags=re.M)
    assert float(re.search(r"^nearest +([0-9.]+) mm", out, flags=re.M)[1]) == pytest.approx(100, abs=1e-3)


def test_audit_of_a_collision(with_end, capsys):
    """Each piece that collides has a time, a pair and a depth, as in the library; the picture shows it."""
    Path("moves.csv").write_text(THROUGH)
    status, out, _ = run(capsys, *AUDIT, "--json")
    answer = json.loads(out)
    found = checker_of_folder().certify_trajectory(planners.ControllerPoints.load("moves.csv"))
    assert (status, answer["verdict"], answer["time"]) == (1, "COLLIDING", found.time)
    assert [piece["number"] for piece in answer["unproven"]] == [1, 2]
    # In the middle of the wall the ball is as deep as half the wall and its own radius.
    assert answer["nearest"] == pytest.approx(-0.15, abs=1e-6)
    assert answer["nearest_pair"] == ["ball", "wall"]
    assert answer["picture"] == "." * 20 + "#" * 40
    status, out, _ = run(capsys, *AUDIT)
    assert status == 1
    assert out.startswith("COLLIDING  2 of 3 pieces not proven free, ")
    assert len(re.findall(r"^│ [12] +│ ", out, flags=re.M)) == 2


@pytest.mark.parametrize("name", ["path.csv", "path.json"])
def test_audit_of_a_path_that_plan_has_written(with_end, capsys, name):
    """The audit proves the same motions as the plan, by number, and says that there are no times."""
    planned = json.loads(run(capsys, *AROUND, "-o", name, "--json")[1])
    audit = ("audit", *ROBOT, name, "--scene", "end.yaml")
    status, out, err = run(capsys, *audit, "--json")
    answer = json.loads(out)
    assert (status, err, answer["verdict"], answer["timed"]) == (0, "", "FREE", False)
    assert (answer["begins"], answer["ends"]) == (0, len(planned["motions"]))
    out = run(capsys, *audit)[1]
    assert out.startswith(f"FREE  {len(planned['motions'])} pieces, proven free at every configuration on the way\n")
    assert "; it has no times\n" in out
    assert " s\n" not in out
    status, _, err = run(capsys, *audit, "--controller", "cubic")
    assert (status, err) == (
        2,
        "loewner: error: --controller cubic: expected points with times, found a path without\n",
    )


def test_audit_of_a_path_with_a_key_twice(with_end, capsys):
    """Only the second of two paths in a file would be audited."""
    Path("path.json").write_text('{"names": ["x", "y", "turn"],\n"configurations": [],\n"configurations": [[0, 0, 0]]}')
    status, out, err = run(capsys, "audit", *ROBOT, "path.json", "--scene", "end.yaml")
    told = "loewner: error: path.json, line 3: expected each key once in a mapping, found 'configurations' again\n"
    assert (status, out, err) == (2, "", told)
    assert run(capsys, "robot", "check", *ROBOT, "--configs", "path.json") == (2, "", told)


def test_audit_of_a_message_with_a_start_state(with_end, capsys):
    """Joints that the points do not name stand where the message says, unless --others gives other values."""
    points = [{"positions": [x], "time_from_start": {"sec": x, "nanosec": 0}} for x in (0, 1)]
    held = {"trajectory": {"joint_trajectory": {"joint_names": ["turn"], "points": points}}}
    start = {"joint_state": {"name": ["turn", "x", "y"], "position": [0.0, -0.5, 0.7]}}
    Path("moves.json").write_text(json.dumps(held | {"trajectory_start": start}))
    audit = ("audit", *ROBOT, "moves.json", "--scene", "end.yaml")
    status, out, _ = run(capsys, *audit)
    assert status == 0
    assert "x = -0.5, from trajectory_start/joint_state;" in out
    assert json.loads(run(capsys, *audit, "--json")[1])["stated"] == {"x": -0.5, "y": 0.7}
    given = [json.loads(run(capsys, *audit, "--others", q, "--json")[1]) for q in ("-0.5,0.7,0", "0,0,0")]
    assert [one["verdict"] for one in given] == ["FREE", "COLLIDING"]


def test_audit_of_a_path_that_collides(with_end, capsys):
    """A motion of a path collides where `certify_edges` finds it; columns may be in any order."""
    Path("path.csv").write_text("turn,x,y\n1.5,-0.5,0.7\n1.5,0,0.7\n1.5,0,-0.5\n1.5,0.5,0.7\n")
    status, out, _ = run(capsys, "audit", *ROBOT, "path.csv", "--scene", "end.yaml", "--json")
    answer = json.loads(out)
    path = np.array([[-0.5, 0.7, 1.5], [0, 0.7, 1.5], [0, -0.5, 1.5], [0.5, 0.7, 1.5]])
    found = checker_of_folder().certify_edges(path[:-1], path[1:])
    assert (status, answer["verdict"], answer["time"]) == (1, "COLLIDING", 1 + found.fraction[1])
    assert [piece["number"] for piece in answer["unproven"]] == [1, 2]
    assert answer["nearest"] == pytest.approx(-0.15, abs=1e-6)
    assert run(capsys, "audit", *ROBOT, "path.csv", "--scene", "end.yaml", "-o", "path.svg")[0] == 1
    drawn = Path("path.svg").read_text()
    for text in ("COLLIDING", "ball and wall", "number of the configuration", "collides in this piece"):
        assert f"<!-- {text} -->" in drawn


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("0,0.7,1.5\n1,0.7,1.5\n", "expected a header that names the time and different joints"),
        ("x,y,tool\n0,0.7,1.5\n1,0.7,1.5\n", "found 'tool'"),
        ("x,y\n0,0.7\n1,0.7\n", "found none for turn"),
        ("x,y,turn\n0,0.7,1.5\n1,nan,1.5\n", "expected 3 finite numbers in each row, found 1,nan,1.5 in row 2"),
        ("x,y,turn\n0,0.7,1.5\n", "expected two configurations or more, found 1"),
        ("time,x,y,turn\n0,0,0.7,1.5\n1,0,nan,1.5\n", "positions: expected finite numbers, found nan at index (1, 1)"),
        ("time,x,tool,x velocity\n0,0,0,0\n1,1,1,0\n", "found no column 'tool velocity'"),
        ("time,x,x velocity,tool velocity\n0,0,0,0\n1,1,1,0\n", "found no joint for the column 'tool velocity'"),
        ("time,x,tool\n0,0,0\n1,1,1\n", "found the unknown tool"),
    ],
)
def test_audit_says_what_is_wrong_with_a_table(with_end, capsys, text, told):
    """The number, joint or column at fault is named; a first column without a name is never read as a joint."""
    Path("moves.csv").write_text(text)
    status, out, err = run(capsys, *AUDIT)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert told in err


def test_audit_of_a_missing_file(with_end, capsys):
    """A file that does not exist is no path either."""
    status, _, err = run(capsys, *AUDIT)
    assert (status, err) == (
        2,
        "loewner: error: moves.csv: expected points of a trajectory, but there is no such file\n",
    )


def test_audit_says_what_is_wrong_with_a_path_in_json(with_end, capsys):
    """A joint that the robot does not have is named."""
    Path("path.json").write_text(json.dumps({"names": ["x", "y", "tool"], "configurations": [[0, 0, 0], [1, 1, 1]]}))
    status, _, err = run(capsys, "audit", *ROBOT, "path.json", "--scene", "end.yaml")
    assert status == 2
    assert "found 'tool'" in err


def test_audit_measures_the_nearest_pair_of_each_row(with_end, capsys):
    """Two walls are passed at different depths on one piece: its row has the deeper one, beside the verdict's pair."""
    Path("moves.csv").write_text("time,x,y,turn\n0,-0.5,0.7,1.5\n1,0,0.7,1.5\n2,0,-0.5,1.5\n")
    Path("two.yaml").write_text(Path("end.yaml").read_text() + "  inner: {box: [1, 1, 1], position: [0, -0.8, 0]}\n")
    answer = json.loads(run(capsys, "audit", *ROBOT, "moves.csv", "--scene", "two.yaml", "--json")[1])
    checker = loewner.CollisionChecker(checker_of_folder().robot, loewner.load_scene("two.yaml"))
    points = planners.ControllerPoints.load("moves.csv")
    assert answer["nearest_pair"] == ["ball", "inner"]
    (piece,) = answer["unproven"]
    assert piece["nearest_pair"] == ["ball", "inner"]
    shares = np.append(np.linspace(0, 1, 1001), piece["nearest_time"] - piece["begins"])[:, None]
    k = piece["number"]
    depths = checker.distance(
        (1 - shares) * points.positions[k] + shares * points.positions[k + 1], exact=True
    ).distance
    assert piece["nearest"] == pytest.approx(depths[-1], abs=1e-9)
    assert piece["nearest_lower"] <= depths.min() <= piece["nearest"] <= piece["nearest_lower"] + 0.01 * 0.3
    assert piece["begins"] <= piece["nearest_time"] <= piece["ends"]


def test_audit_explains_positive_distances(with_end, capsys):
    """A pair within its margin, or near it by a joint error, is not in contact; the output says why it is not free."""
    Path("moves.csv").write_text(AROUND_END)
    status, out, _ = run(capsys, *AUDIT)
    assert "margins and errors are not subtracted" in out
    assert "have to keep" not in out
    Path("kept.yaml").write_text("margin: 0.15\n" + Path("end.yaml").read_text())
    kept = ("audit", *ROBOT, "moves.csv", "--scene", "kept.yaml")
    status, out, _ = run(capsys, *kept)
    assert status == 1
    assert "margin    150 mm, which ball and wall have to keep\n" in out
    pieces = json.loads(run(capsys, *kept, "--json")[1])["unproven"]
    assert {(piece["margin"], *piece["pair"]) for piece in pieces} == {(0.15, "ball", "wall")}
    assert min(piece["nearest"] for piece in pieces) == pytest.approx(0.1, abs=1e-6)
    status, out, _ = run(capsys, *AUDIT, "--joint-error", 0.2)
    assert status == 3
    assert "error     the verdicts are for values up to 0.2 off" in out


def test_audit_follows_the_controller(with_end, capsys):
    """Between the same points the straight line is free, and the cubic with these velocities is not."""
    Path("moves.csv").write_text(
        "time,x,y,turn,x velocity,y velocity,turn velocity\n0,-0.5,0.7,1.5,0,-4,0\n1,0.5,0.7,1.5,0,4,0\n"
    )
    assert run(capsys, *AUDIT, "--controller", "linear")[0] == 0
    for arguments in ([], ["--controller", "cubic"]):
        status, out, _ = run(capsys, *AUDIT, *arguments)
        assert status == 1
        assert out.endswith("curve     cubic between points\n")
    status, _, err = run(capsys, *AUDIT, "--controller", "quintic")
    assert status == 2
    assert "accelerations" in err


def test_audit_with_joints_that_stay(with_end, capsys):
    """What the file does not name stays at 0, or where --others says; an unknown joint is an error."""
    Path("moves.csv").write_text("time,x,turn\n0,-0.5,1.5\n1,0.5,1.5\n")
    assert run(capsys, *AUDIT)[0] == 1
    assert run(capsys, *AUDIT, "--others", "0 0.7 0")[0] == 0
    Path("moves.csv").write_text("time,x,tool\n0,-0.5,1.5\n1,0.5,1.5\n")
    status, _, err = run(capsys, *AUDIT)
    assert status == 2
    assert "tool" in err


def test_audit_with_a_joint_error(with_end, capsys):
    """The ball keeps 0.1 m: with less error the curve is proven, with more it is ambiguous, since no point collides."""
    Path("moves.csv").write_text(AROUND_END)
    assert run(capsys, *AUDIT, "--joint-error", 0.03)[0] == 0
    status, out, _ = run(capsys, *AUDIT, "--joint-error", 0.2)
    assert status == 3
    assert out.startswith("AMBIGUOUS  ")
    assert "every value up to 0.2 off" in out
    assert run(capsys, *AUDIT, "--joint-error", -1)[0] == 2


def test_audit_draws_a_picture(with_end, capsys, monkeypatch):
    """The picture names the pair and the verdict, beside the usual output; other formats are refused at once."""
    Path("moves.csv").write_text(THROUGH)
    status, out, _ = run(capsys, *AUDIT)
    assert run(capsys, *AUDIT, "-o", "moves.svg") == (status, out + "written   moves.svg\n", "")
    assert status == 1
    assert run(capsys, *AUDIT, "--out", "moves.png")[0] == 1
    assert Path("moves.png").read_bytes().startswith(b"\x89PNG")
    drawn = Path("moves.svg").read_text()
    for text in ("COLLIDING", "ball and wall", "time, s", "collides in this piece"):
        assert f"<!-- {text} -->" in drawn
    status, _, err = run(capsys, *AUDIT, "-o", "moves.txt")
    assert status == 2
    assert "--out: expected a .png or .svg file, found moves.txt" in err
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    status, out, err = run(capsys, *AUDIT, "-o", "more.svg")
    assert (status, out) == (2, "")
    assert "loewner[plots]" in err
    assert not Path("more.svg").exists()


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["fit"],
        ["check"],
        ["clearance"],
        ["paper"],
        ["robot"],
        ["robot", "info"],
        ["robot", "check"],
        ["plan"],
        ["audit"],
    ],
)
def test_help_has_examples(command, capsys):
    """--help works everywhere; each command shows examples, and `check` its exit status."""
    with pytest.raises(SystemExit) as caught:
        cli.main([*command, "--help"])
    assert caught.value.code == 0
    out = capsys.readouterr().out
    if command:
        assert f"loewner {' '.join(command)} " in out.split("examples:")[1]
    if command == ["check"]:
        assert "exit status: 0 free, 1 colliding" in out


def test_version(capsys):
    """--version prints the package's."""
    with pytest.raises(SystemExit):
        cli.main(["--version"])
    assert capsys.readouterr().out == f"loewner {loewner.__version__}\n"


def test_folders_are_printed_on_one_line(tmp_path):
    """A pipe receives the bytes of the folder's name and one end of line, whatever the name, width and encoding."""
    place = tmp_path / ("hyphens-" * 12) / ("blanks " * 12 + ".") / "umlaut \u00e4"
    place.mkdir(parents=True)
    (place / "loewner").symlink_to(Path(loewner.__file__).parent, target_is_directory=True)
    script = """
from loewner import cli
for option in ("--include", "--cmake-dir", "--pkg-config-dir"):
    try:
        cli.main([option])
    except SystemExit as ended:
        assert ended.code == 0
"""
    environment = os.environ | {"PYTHONPATH": str(place), "COLUMNS": "40", "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, env=environment)
    folders = [place / "loewner" / folder for folder in ("include", "share/cmake", "share/pkgconfig")]
    assert done.stdout == b"".join(os.fsencode(folder) + b"\n" for folder in folders), done.stderr


def test_tables_in_a_pipe_are_not_broken(capsys, monkeypatch):
    """A name of 300 characters and a path of 300 stand whole on the line of their row, at any width of the terminal."""
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("FORCE_COLOR", "1")
    name, path = "a-long-name-" * 25, "/a folder" * 33
    print_table(("name", "number", "path"), [(name, "0.123456789", path)], "a table")
    lines = [line for line in capsys.readouterr().out.splitlines() if name in line]
    assert len(lines) == 1
    assert path in lines[0]
    assert "0.123456789" in lines[0]


@pytest.mark.parametrize(
    ("command", "status"),
    [
        (("robot", "check", *WITH_WALL, "--random", "2"), 1),
        (("clearance", "a.npz", "b.npz"), 1),
        (("clearance", "a.npz", "far.npz"), 0),
    ],
)
@pytest.mark.parametrize("rich", [True, False])
def test_a_reader_that_left_changes_no_verdict(folder, capsys, monkeypatch, command, status, rich):
    """The status is the verdict's although the answer is not read to its end, whichever program prints the tables."""
    for name, x in (("a.npz", 0.0), ("b.npz", 0.0), ("far.npz", 3.0)):
        loewner.Body.sphere(1.0).transformed(translation(x)).save(name)
    if not rich:
        monkeypatch.setitem(sys.modules, "rich.table", None)
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert cli.main(list(command)) == status
    assert capsys.readouterr().err == ""


def test_every_argument_has_a_help():
    """No line of a help text names an argument without a word about it."""

    def without(parser):
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                for command in action.choices.values():
                    yield from without(command)
            elif not action.help:
                yield parser.prog, action.metavar or action.dest

    assert list(without(_parser())) == []


def test_wrong_usage_exits_with_2(capsys):
    """argparse's own errors have the status of all errors."""
    with pytest.raises(SystemExit) as caught:
        cli.main(["check", "only-one"])
    assert caught.value.code == 2


@pytest.mark.parametrize(
    ("arguments", "command", "message"),
    [
        (
            ["audit", "arm.urdf", "a.csv", "--srfd", "arm.srdf"],
            "loewner audit",
            "--srfd arm.srdf; did you mean --srdf?",
        ),
        (["robot", "check", "arm.urdf", "--random", "9", "--zz"], "loewner robot check", "--zz"),
    ],
)
def test_an_unknown_option_is_reported_with_the_usage_of_its_command(capsys, arguments, command, message):
    """The options that the command has are then on the screen, and one with nearly the same name is proposed."""
    with pytest.raises(SystemExit):
        cli.main(arguments)
    error = capsys.readouterr().err
    assert error.startswith(f"usage: {command} ")
    assert error.endswith(f"{command}: error: unrecognized arguments: {message}\n")


def test_numbers_without_quotes_are_asked_for_in_quotes(capsys):
    """The shell takes the numbers of a configuration apart; an option that does not exist has no such hint."""
    for arguments, hint in ((["-0.7", "0.9"], True), (["0", "--wrong"], False)):
        with pytest.raises(SystemExit):
            cli.main(["plan", "arm.urdf", "--goal", "home", "--start", *arguments])
        assert ("write numbers that belong together in quotes" in capsys.readouterr().err) == hint


def test_a_crash_is_not_a_collision(saved, capsys, monkeypatch):
    """A bug in the library shows its traceback, and its status is that of errors."""

    def broken(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(loewner, "classify", broken)
    status, _, err = run(capsys, "check", "a.npz", "b.npz")
    assert status == 2
    assert "ZeroDivisionError: a bug" in err


def test_a_reader_that_leaves_changes_no_verdict(saved):
    """With standard output closed at the other end, the status is the verdict's, without a traceback."""
    program = Path(sys.executable).with_name("loewner")
    arguments = [program, "check", "a.npz", "b.npz", "--pose-b", "9 0 0"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        err = process.stderr.read()
    assert process.returncode == 0
    assert "Traceback" not in err


def test_installed_program(saved):
    """The program is installed, and returns its status to the shell."""
    program = Path(sys.executable).with_name("loewner")
    done = subprocess.run([program, "check", "a.npz", "b.npz", "--pose-b", "9 0 0"], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.startswith("FREE")


def test_every_column_has_a_heading():
    """No table of a command has a column without a name."""
    nodes = [node for file in Path(cli.__file__).parent.glob("*.py") for node in ast.walk(ast.parse(file.read_text()))]
    calls = [node for node in nodes if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print_table"]
    named = {call.args[0].id for call in calls if isinstance(call.args[0], ast.Name)}
    assigned = [node for node in nodes if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in named]
    headings = [
        [cell.value for cell in columns.elts if isinstance(cell, ast.Constant)]
        for columns in [*(call.args[0] for call in calls), *(node.value for node in assigned)]
        if isinstance(columns, ast.Tuple | ast.List)
    ]
    assert len(headings) > 8
    assert all("" not in cells for cells in headings)


def test_without_rich_tables_are_plain(saved, fits_here, capsys, monkeypatch):
    """Status and cells are those with Rich; there are no lines about them, and no progress."""
    gantry(saved)
    (saved / "wall.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1]}\n")
    (saved / "end.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1], position: [0, -1.5, 0]}\n")
    cases = [
        (["fit", "cube.stl", "-o", "out"], 0, r"loewner fit\nbody +pieces +vertices .*\nout/cube.npz +1 +8 "),
        (["robot", "info", "gantry.urdf"], 0, r"(?m)^turn +-?inf +inf$|^turn "),
        (
            ["robot", "check", "gantry.urdf", "--random", "5", "--scene", "wall.yaml"],
            1,
            r"(?m)^settled by +free +colliding$",
        ),
        (
            ["plan", "gantry.urdf", "--scene", "end.yaml", "--start", HERE, "--goal", THERE],
            0,
            r"(?m)^motion +length +verdict +nearest, mm +body +other body +poses +searches$",
        ),
        (["paper", "--pairs", "5"], 0, r"(?m)^table +detector "),
    ]
    for name in ("rich", *(name for name in sys.modules if name.startswith("rich."))):
        monkeypatch.setitem(sys.modules, name, None)
    for arguments, status, told in cases:
        ended, out, err = run(capsys, *arguments)
        assert (ended in (status, 0), err) == (True, ""), out
        assert re.search(told, out), out


def test_a_setting_that_is_wrong_is_told_by_info():
    """The other lines are printed all the same; variables of this package are listed."""
    env = os.environ | {"LOEWNER_JIT": "yes", "LOEWNER_NUM_THREADS": "many"}
    done = subprocess.run([sys.executable, "-m", "loewner", "info"], capture_output=True, text=True, env=env)
    assert done.returncode == 0
    lines = dict(line.split(":", 1) for line in done.stdout.splitlines())
    assert lines["kernels"].strip().startswith("error: LOEWNER_JIT: expected 0 or 1, found 'yes'")
    assert lines["threads"].strip().startswith("error: LOEWNER_NUM_THREADS: expected an integer")
    assert lines["LOEWNER_JIT"].strip() == "yes"


def test_an_empty_setting_is_none():
    """As files of settings for containers leave them."""
    env = os.environ | {"LOEWNER_JIT": "", "LOEWNER_LEVEL": ""}
    done = subprocess.run([sys.executable, "-m", "loewner", "info"], capture_output=True, text=True, env=env)
    assert "error" not in done.stdout


def test_what_prints_no_table_needs_no_rich(saved, capsys):
    """Status and output are those with Rich."""
    code = """
from loewner import cli
for arguments in (["check", "a.npz", "b.npz"], ["check", "cube.stl", "a.npz"], ["--help"]):
    try:
        print(cli.main(arguments), end="\\0")
    except SystemExit as ended:  # after the help
        print(ended.code, end="\\0")
"""
    without = f"import sys\nsys.modules['rich'] = None{code}"
    done = subprocess.run([sys.executable, "-c", without], capture_output=True, text=True, check=True)
    exec(code, {})
    assert done.stdout == capsys.readouterr().out
    assert [text[-2:] for text in done.stdout.split("\0")] == ["\n1", "\n1", "\n0", ""]


def test_an_interrupt_is_told_in_a_line(monkeypatch, capsys):
    """Ctrl+C ends a command with the status of an error and without a traceback."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(loewner.Body, "load", interrupted)
    assert cli.main(["check", "a.npz", "b.npz"]) == 2
    assert capsys.readouterr().err == "loewner: interrupted\n"


def test_a_mesh_in_millimetres(tmp_path, fits_here, capsys):
    """The command line can do what its warning advises, and prints the warning in its own form."""
    trimesh.creation.box((2000, 300, 400)).export(tmp_path / "part.stl")
    assert cli.main(["fit", str(tmp_path / "part.stl"), "-o", str(tmp_path)]) == 0
    assert "loewner: warning: " in capsys.readouterr().err
    assert cli.main(["fit", str(tmp_path / "part.stl"), "-o", str(tmp_path), "--scale", "0.001"]) == 0
    assert capsys.readouterr().err == ""
    largest = loewner.Body.load(tmp_path / "part.npz").outer[0].semi_axes.max()
    np.testing.assert_allclose(largest, np.sqrt(3), rtol=1e-3)


def test_files_with_a_byte_order_mark(tmp_path, capsys):
    """As some programs write text: it is not part of the first number."""
    for name in ("a", "b"):
        loewner.Body.sphere(1.0).save(tmp_path / f"{name}.npz")
    rows = "\n".join(" ".join(map(str, row)) for row in np.eye(4) + 5 * np.eye(4, k=3))
    (tmp_path / "pose.txt").write_text(rows, encoding="utf-8-sig")
    said = cli.main(
        ["check", *(str(tmp_path / f"{name}.npz") for name in "ab"), "--pose-b", str(tmp_path / "pose.txt")]
    )
    assert (said, capsys.readouterr().err) == (0, "")
