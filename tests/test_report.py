"""``loewner report``: the file is enough to run a query again, holds nothing private, and damage to it is refused."""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

import loewner
from gantry import IN_WALL, LEFT, RIGHT, gantry, wall
from loewner import FileError, cli
from loewner.cli import report

SECRET = "/home/ada"


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """A folder with a report of two boxes and the files that it is about; each test has a copy."""
    folder = tmp_path_factory.mktemp("reported")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        trimesh.creation.box((1, 1, 1)).export("cup.stl")
        loewner.Body.box([2, 1, 1]).save("table.npz")
        assert cli.main(["report", "check", "cup.stl", "table.npz", "--pose-b", "1.6 0 0", "-o", "pair.zip"]) == 0
    return folder


@pytest.fixture
def pair(reported, tmp_path, monkeypatch):
    """The report of two boxes that are 0.1 m apart along x, one of them a mesh."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(reported, tmp_path, dirs_exist_ok=True)
    return Path("pair.zip")


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """The report of a robot with a mesh at an absolute path, in front of a wall."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(radius=0.1).export("ball.STL")
    urdf, srdf = gantry(tmp_path)
    mesh = f'<mesh filename="file://{tmp_path}/ball.STL"/>'
    text = urdf.read_text().replace('<sphere radius="0.1"/>', mesh)
    text = text.replace("</robot>", f'<!-- by {SECRET} --><gazebo f="{SECRET}"/></robot>')
    visual = f'<link name="base"><visual><geometry><mesh filename="{SECRET}/x.dae"/></geometry></visual></link>'
    urdf.write_text(text.replace('<link name="base"/>', visual))
    scene = wall()
    scene.add("cup", loewner.Body.from_surface("ball.STL"), np.diag([1.0, 1, 1, 1]) + np.eye(4, k=3) * 5)
    loewner.save_scene(scene, "wall.yaml")
    np.save("q.npy", [LEFT, RIGHT, IN_WALL])
    options = ["--srdf", str(srdf), "--scene", "wall.yaml", "--configs", "q.npy", "-o", "robot.zip"]
    assert cli.main(["report", "robot", str(urdf), *options]) == 0
    return Path("robot.zip")


def rewritten(path: Path, members: dict[str, bytes | None], out: str = "other.zip") -> Path:
    """A report with other members; None leaves one out."""
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()} | members
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in content.items():
            if data is not None:
                archive.writestr(name, data)
    return Path(out)


def document(path: Path) -> dict:
    with zipfile.ZipFile(path) as archive:
        return json.loads(archive.read(report.DOCUMENT))


def with_document(path: Path, **changes) -> Path:
    return rewritten(path, {report.DOCUMENT: json.dumps(document(path) | changes).encode()})


def test_a_pair_has_the_answers_of_all_tiers(pair):
    """The ellipsoids of these boxes cannot tell, the exact answers can; the numbers are the library's, all digits."""
    told = document(pair)["answers"]
    assert (told["certified"], told["exact"]) == ("AMBIGUOUS", "FREE")
    a, b = loewner.Body.from_surface("cup.stl"), loewner.Body.load("table.npz")
    T = np.eye(4)
    T[0, 3] = 1.6
    found = loewner.distance(a, None, b, T, exact=True)
    assert told["distance"]["distance"] == found.distance == pytest.approx(0.1)
    assert told["distance"]["witness_a"] == found.witness_a.tolist()
    assert told["bounds"] == [found.lower, found.upper]


def test_the_same_query_gives_the_same_file(pair):
    """A report has no date, and no name of a temporary file."""
    before = pair.read_bytes()
    assert cli.main(["report", "check", "cup.stl", "table.npz", "--pose-b", "1.6 0 0", "-o", "pair.zip"]) == 0
    assert pair.read_bytes() == before


@pytest.mark.parametrize("which", ["pair", "robot"])
def test_rerun_needs_the_report_alone(which, request, tmp_path, capsys):
    """In a folder where nothing else is left, all answers are the same."""
    path = request.getfixturevalue(which)
    for other in tmp_path.iterdir():
        if other.name != path.name:
            other.unlink()
    assert cli.main(["report", "rerun", str(path)]) == 0
    assert "THE SAME" in capsys.readouterr().out
    assert report.rerun(path)[1] == document(path)["answers"]


def test_a_robot_has_configurations_and_motions(robot):
    """Both sides of the wall are free, within it the arm collides, and so does the way through."""
    told = document(robot)["answers"]
    assert told["exact"] == told["exact, one by one"] == ["FREE", "FREE", "COLLIDING"]
    assert told["motions"]["verdict"] == ["COLLIDING", "COLLIDING"]
    assert set(told["bodies"]) == {"ball", "rod", "wall", "cup"}


@pytest.mark.parametrize("which", ["pair", "robot"])
def test_no_path_is_in_a_report(which, request, tmp_path):
    """Paths, comments, and elements that affect no answer stay at home."""
    with zipfile.ZipFile(request.getfixturevalue(which)) as archive:
        for name in archive.namelist():
            content = archive.read(name)
            assert str(tmp_path).encode() not in content, name
            assert SECRET.encode() not in content, name
            assert "/" not in name


def test_another_answer_is_told(pair, capsys):
    """A report whose verdict or body differs from the one here: status 1, with the names of both."""
    answers = document(pair)["answers"]
    assert cli.main(["report", "rerun", str(with_document(pair, answers=answers | {"exact": "COLLIDING"}))]) == 1
    assert "DIFFERENT: exact" in capsys.readouterr().out
    loewner.Body.box([2, 1, 1.5]).save("other.npz")
    other = rewritten(pair, {"b.npz": Path("other.npz").read_bytes()})
    assert cli.main(["report", "rerun", str(other)]) == 1
    assert "DIFFERENT: bodies" in capsys.readouterr().out


def test_an_error_is_an_answer(pair, monkeypatch):
    """A search that does not converge is reported as such, and the other answers are there."""

    def fails(*arguments, **options):
        raise loewner.ConvergenceError("no end")

    monkeypatch.setattr(loewner, "collide", fails)
    assert report.rerun(pair)[1] | {"estimate": 0, "exact": 0} == document(pair)["answers"] | {
        "estimate": 0,
        "exact": 0,
    }
    assert report.rerun(pair)[1]["exact"] == "error: no end"


def test_a_report_that_fails_leaves_the_older_one(pair, capsys):
    """Whole or not at all, and one line."""
    before = pair.read_bytes()
    Path("cup.stl").write_text("solid no")
    assert cli.main(["report", "check", "cup.stl", "table.npz", "-o", "pair.zip"]) == 2
    assert pair.read_bytes() == before
    assert sorted(path.name for path in Path().iterdir()) == ["cup.stl", "pair.zip", "table.npz"]
    assert capsys.readouterr().err.count("\n") == 1


def test_the_name_ends_in_zip(pair, capsys):
    """Anything else could be one of the inputs."""
    assert cli.main(["report", "check", "cup.stl", "table.npz", "-o", "report.npz"]) == 2
    assert "ends in .zip, found 'report.npz'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": "x"}, "another kind of file"),
        ({"version": 2}, "expected version 1, found 2"),
        ({"query": "plan"}, "among check, robot, found 'plan'"),
        ({"query": []}, "among check, robot"),
        ({"answers": 3}, "answers: expected an object, found 3"),
        ({"versions": None}, "versions: expected an object, found None"),
        ({"options": {"urdf": "/etc/passwd"}}, "expected the options of loewner report check, found 'urdf'"),
        ({"options": {"margin": "0"}}, "found 'margin': '0'"),
        ({"options": {"margin": True}}, "found 'margin': True"),
        ({"options": {"margin": -1.0}}, "margin"),
        ({"options": {"model": "x"}}, "found 'model': 'x'"),
    ],
)
def test_a_forged_document_is_refused(pair, changes, words):
    """The message names the file, the expected content and what is there instead."""
    with pytest.raises(FileError, match=words) as caught:
        report.rerun(with_document(pair, **changes))
    assert str(caught.value).startswith("other.zip: ")


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({report.DOCUMENT: None}, "no member report.json"),
        ({report.DOCUMENT: b"{"}, "found something else"),
        ({report.DOCUMENT: b"[" * 100_000}, "found something else"),
        ({"../escaped": b"x"}, "names are not plain"),
        ({"/tmp/escaped": b"x"}, "names are not plain"),
        ({"A.STL": b"x"}, "or occur twice"),
        ({"a.stl": None}, "one input called a, found 0"),
        ({"a.obj": b"x"}, "one input called a, found 2"),
        ({"a.stl": b"x"}, "a.stl: expected"),
        ({"pose_a.npy": b"x"}, "pose_a.npy: expected"),
    ],
)
def test_forged_members_are_refused(pair, tmp_path, members, words):
    """Nothing is written outside of a temporary folder, and messages do not name that."""
    with pytest.raises(FileError, match=words) as caught:
        report.rerun(rewritten(pair, members))
    assert not (tmp_path.parent / "escaped").exists()
    assert "/tmp" not in str(caught.value)


def test_large_reports_are_refused_before_they_are_unpacked(pair, monkeypatch):
    """The sizes that the archive states are limited, and so is their number."""
    large = rewritten(pair, {"x": bytes(10_000)})
    monkeypatch.setattr(report, "MOST_MEMBERS", 5)
    with pytest.raises(FileError, match="5 members"):
        report.rerun(large)
    monkeypatch.setattr(report, "MOST_BYTES", 9_000)
    with pytest.raises(FileError, match="9000 bytes"):
        report.rerun(rewritten(pair, {"x": bytes(8_000)}))


def test_no_file_and_other_files(pair):
    """A missing file, a file that is no zip, and a part of one."""
    Path("part.zip").write_bytes(pair.read_bytes()[:-30])
    for name, words in (("none.zip", "no such file"), ("cup.stl", "not a zip"), ("part.zip", "not a zip")):
        with pytest.raises(FileError, match=words):
            report.rerun(Path(name))
