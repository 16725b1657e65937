"""``loewner clash`` for a body that moves past another one: verdicts, times and poses, files, and what is refused."""

import json

import numpy as np
import pytest
import trimesh

import loewner
from families import translation
from loewner import Body, cli

PEG, HOLE = 9.6, 10.0  # square, in millimetres: a play of 0.2 on each side


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A plate with a square hole along z, and a peg; in millimetres."""
    monkeypatch.chdir(tmp_path)
    walls = []
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        size = (5.0, 20.0, 4.0) if x else (20.0, 5.0, 4.0)
        walls.append(trimesh.creation.box(size))
        walls[-1].apply_translation([7.5 * x, 7.5 * y, 0])
    trimesh.util.concatenate(walls).export("plate.stl")
    trimesh.creation.box((PEG, PEG, 10)).export("peg.stl")


def clash(capsys, *words) -> tuple[int, str, str]:
    """Exit status and output; a list of numbers is one word."""
    status = cli.main(["clash", "plate.stl", "peg.stl", "--scale", "0.001", *map(str, words)])
    return status, *capsys.readouterr()


def test_a_peg_with_play_goes_in(capsys):
    """Free straight down and off by less than the play; a margin above the rest of it collides, one just below not."""
    down = ("--pose-b", "0.0001 0 0.02", "--to", "0.0001 0 0")
    status, out, _ = clash(capsys, *down)
    assert status == 0
    assert out.startswith("FREE  (plate.stl and peg.stl, times from 0 to 1)\n")
    for margin, expected in ((0.8e-4, {0}), (0.999e-4, {0, 3}), (1.01e-4, {1})):
        assert clash(capsys, *down, "--margin", margin)[0] in expected


def test_a_peg_that_is_off_stops_on_the_plate(capsys):
    """The peg's lower face is 5 mm below its origin, the plate's upper one at 2 mm: contact at 7 of 20 mm, in JSON."""
    status, out, _ = clash(capsys, "--pose-b", "0.0003 0 0.02", "--to", "0.0003 0 0", "--json")
    found = json.loads(out)
    assert (status, found["verdict"]) == (1, "COLLIDING")
    assert found["free_until"] <= 0.65 <= found["touching_at"] + 1e-6
    assert found["touching_at"] - found["free_until"] < 1e-4
    np.testing.assert_allclose(found["pose"], translation(0.0003, 0, 0.007), atol=2e-6)
    assert found["witness_a"][2] == pytest.approx(0.002, abs=2e-6)
    assert np.abs(found["normal"]) == pytest.approx([0, 0, 1], abs=1e-6)


@pytest.mark.parametrize("kind", ["csv", "txt", "npy"])
def test_a_motion_of_several_poses(capsys, kind):
    """Times count the poses of a file: the peg comes down beside the hole, moves over it and turns, and gets stuck."""
    half = np.sqrt(0.5)
    rows = [
        [0.03, 0, 0.03, 1, 0, 0, 0],
        [0.03, 0, 0.01, 1, 0, 0, 0],
        [0, 0, 0.01, half, 0, 0, half],
        [0, 0, 0.008, np.cos(0.1), 0, 0, np.sin(0.1)],
        [0, 0, 0.0, np.cos(0.1), 0, 0, np.sin(0.1)],
    ]
    if kind == "npy":
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        for T, row in zip(poses, rows, strict=True):
            T[:3, :3] = trimesh.transformations.quaternion_matrix(row[3:])[:3, :3]
            T[:3, 3] = row[:3]
        np.save("motion.npy", poses)
    else:
        separator = ", " if kind == "csv" else " "
        text = "\n".join(separator.join(map(repr, map(float, row))) for row in rows)
        with open(f"motion.{kind}", "w") as file:
            file.write(text)
    status, out, _ = clash(capsys, "--motion", f"motion.{kind}", "--json")
    found = json.loads(out)
    assert (status, found["times"]) == (1, [0, 4])
    assert found["free_until"] <= 3.125 <= found["touching_at"] + 1e-6
    np.testing.assert_allclose(found["touching_at"], 3.125, atol=1e-3)
    status, out, _ = clash(capsys, "--motion", f"motion.{kind}", "-o", "stuck.svg")
    assert "touching at 3.12" in out
    with open("stuck.svg") as file:
        assert "plate and peg: COLLIDING" in file.read()


def test_sampled_poses_agree(capsys):
    """Poses of both bodies are used: the time found is between samples that are free and samples that collide."""
    rng = np.random.default_rng(3)
    plate, peg = (Body.from_surface(name, scale=0.001) for name in ("plate.stl", "peg.stl"))
    for _ in range(8):
        a, b = rng.uniform(-0.002, 0.002, (2, 3))
        b[2] += 0.02
        end = b - [0, 0, 0.03]
        words = [" ".join(map(repr, x.tolist())) for x in (a, b, end)]
        status, out, _ = clash(capsys, f"--pose-a={words[0]}", f"--pose-b={words[1]}", f"--to={words[2]}", "--json")
        found = json.loads(out)
        t = np.linspace(0, 1, 500)[:, None]
        poses = np.tile(np.eye(4), (500, 1, 1))
        poses[:, :3, 3] = (1 - t) * b + t * end
        hits = loewner.collide(plate, translation(*a), peg, poses)
        assert status == int(hits.any())
        if status:
            assert not hits[t[:, 0] < found["free_until"]].any()
            assert abs(t[hits.argmax(), 0] - found["touching_at"]) < 0.005


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "expected --to or --motion with two bodies"),
        (["--to", "0 0"], '--to: expected "x y z"'),
        (["--to", "0 0 0", "--motion", "m.csv"], "not allowed with"),
        (["--motion", "m.csv"], "m.csv: expected a file of poses, but there is no such file"),
        (["--motion", "one.csv"], "one.csv: expected two lines"),
        (["--motion", "four.csv"], "found 2 of 4 numbers"),
        (["--motion", "flat.npy"], "flat.npy: expected shape (n, 4, 4)"),
        (["--motion", "two.csv", "--pose-b", "0 0 0"], "--pose-b: expected it with --to only"),
        (["--to", "0 0 0.02 0 1 0 0"], "less than half a turn"),
        (["--to", "0 0 0.02", "--model", "auto"], "--model: expected surface, pieces or hull"),
        (["--to", "0 0 0.02", "--all"], "--all: expected a robot alone with it, found two files"),
        (["--to", "0 0 0.02", "--srdf", "r.srdf"], "--srdf: expected a robot alone"),
        (["--to", "0 0 0.02", "--margin", "-1"], "margin"),
        (["--to", "0 0 0.02", "-o", "stuck.txt"], "--out: expected a .png or .svg"),
    ],
)
def test_refused(capsys, words, told):
    """Words that miss something or belong to robots, and files without a motion."""
    for name, text in (("one", "0 0 0"), ("four", "0 0 0 1\n0 0 0 1"), ("two", "0 0 0\n0 0 0.02")):
        with open(f"{name}.csv", "w") as file:
            file.write(text)
    np.save("flat.npy", np.eye(4))
    try:
        status, _, err = clash(capsys, *words)
    except SystemExit as error:  # the parser refuses two options of which only one is allowed
        status, err = error.code, capsys.readouterr().err
    assert status == 2
    assert told in err


def test_a_robot_alone_has_no_motion(capsys):
    """The options of two bodies are refused with one file, and a motion of which no contact is known draws nothing."""
    assert cli.main(["clash", "robot.urdf", "--to", "0 0 1"]) == 2
    assert "--to: expected two bodies with it, found one file" in capsys.readouterr().err
    status, _, err = clash(capsys, "--pose-b", "0 0 0.02", "--to", "0 0 0.01", "-o", "free.svg")
    assert status == 0
    assert "free.svg is not written, since no contact is known" in err
