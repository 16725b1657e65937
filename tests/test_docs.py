"""The documents tell the truth: their code runs, their links lead somewhere, the examples work."""

import contextlib
import io
import os
import re
import runpy
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import test_pages
from gantry import gantry
from loewner import CollisionChecker, Scene, load_scene
from loewner.cli import main
from robot_oracle import robots_folder
from site_pages import MADE_BY_THE_BUILD, pages

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted([*ROOT.glob("*.md"), *pages(ROOT / "docs")], key=str)


def blocks(document: Path) -> str:
    """All Python blocks of a document, as one program."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", document.read_text(), flags=re.M | re.S))


@pytest.fixture
def folder_with_meshes(tmp_path, monkeypatch):
    """A working folder that holds the mesh files that the documents name."""
    mesh = trimesh.creation.box((0.1, 0.2, 0.3))
    for name in ("part.stl", "link.stl"):
        mesh.export(tmp_path / name)
    for path in gantry(tmp_path):
        path.rename(tmp_path / f"arm{path.suffix}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def folder_with_robot(folder_with_meshes):
    """The same with the Panda arm, where the packages of its meshes are, and a shelf."""
    robots = robots_folder()
    for kind in ("urdf", "srdf"):
        Path(f"panda.{kind}").symlink_to(robots / f"panda_description/{kind}/panda.{kind}")
    Path("packages").symlink_to(robots.parent)
    Path("shelf.yaml").write_text("margin: 0.01\nbodies:\n  board: {box: [0.3, 0.8, 0.02], position: [0.65, 0, 0.5]}\n")


@pytest.mark.parametrize(
    "name",
    [
        "docs/meshes.md",
        "docs/scenes.md",
        "docs/pairs.md",
        "docs/robots.md",
        "docs/motions.md",
        "docs/proofs.md",
        "docs/viewer.md",
    ],
)
def test_code_blocks_run(name, folder_with_robot, capsys):
    """Every Python block of the document runs, in order, from a fresh start."""
    program = blocks(ROOT / name)
    assert program
    exec(compile(program, name, "exec"), {})


def test_the_pick_takes_sixty_lines(folder_with_robot, capsys):
    """The page has at most 60 lines of code, and its commands prove the files that this code has written."""
    page = ROOT / "docs/tutorial/pick.md"
    assert sum(line.strip() != "" for line in blocks(page).splitlines()) <= 60
    test_pages.run(page)
    commands = re.findall(r"^    loewner (audit .+)$", page.read_text(), flags=re.M)
    capsys.readouterr()
    for name, command in zip(("pick", "carry", "back"), commands, strict=True):
        assert f" {name}.yaml " in command
        assert main([*shlex.split(command), "--package-dir", "packages"]) == 0
        assert capsys.readouterr().out.startswith("FREE ")
    # It is a proof of the carried can: with the can on the table, the same motion meets it.
    assert main([*shlex.split(commands[1].replace("carry-scene", "pick-scene")), "--package-dir", "packages"]) == 1


def test_readme_prints_what_it_says(folder_with_meshes, capsys):
    """All of its Python blocks run, in order, from a fresh start, and print the answers in their comments."""
    exec(compile(blocks(ROOT / "README.md"), "README.md", "exec"), {})
    out = capsys.readouterr().out.splitlines()
    assert out[:2] == ["False", "<Verdict.FREE: 0>"]


def test_the_scene_on_the_page_of_commands_loads(tmp_path):
    """The page shows a complete file."""
    (text,) = re.findall(r"^```yaml\n(.*?)^```$", (ROOT / "docs/howto/command-line.md").read_text(), flags=re.M | re.S)
    (tmp_path / "shelf.yaml").write_text(text)
    assert load_scene(tmp_path / "shelf.yaml").names == ("board",)


@pytest.mark.light
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(document):
    """Relative links in documents name files that exist, or pages that the build of the site makes."""
    made = {ROOT / "docs" / f"{name}.md" for name in MADE_BY_THE_BUILD}
    links = re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", document.read_text())
    missing = [link for link in links if not (document.parent / link).exists()]
    missing = [link for link in missing if (document.parent / link).resolve() not in made]
    assert missing == []


@pytest.mark.light
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_rows_of_a_table_have_as_many_cells_as_its_head(document):
    """Two rows on one line would be rendered as one: the cells beyond the head's are dropped."""
    text = re.sub(r"^```.*?^```", "", document.read_text(), flags=re.M | re.S)
    for table in re.findall(r"(?:^\|.*\n?)+", text, flags=re.M):
        bars = [len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()]
        odd = [row for row, count in zip(table.splitlines(), bars, strict=True) if count != bars[0]]
        assert odd == []


def example(name: str, *arguments: str, cwd: Path) -> str:
    """Run an example, in this process, which has loaded the library already, and return what it printed.

    Whether a robot's exempt pairs were proven before depends on what else ran on this machine.
    """
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings(), contextlib.redirect_stdout(out):
        warnings.filterwarnings("ignore", "pairs that are exempt from checking")
        patch.setattr(sys, "argv", [name, *arguments])
        patch.syspath_prepend(str(ROOT / "examples"))
        patch.setenv("LOEWNER_QUIET", "1")
        patch.chdir(cwd)
        runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
    return out.getvalue()


def example_apart(name: str, *arguments: str, cwd: Path, **variables: str) -> str:
    """Run an example as a user would, in a process of its own."""
    filters = "error,ignore:pairs that are exempt from checking"
    environment = os.environ | {"PYTHONWARNINGS": filters, "LOEWNER_QUIET": "1"} | variables
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / name), *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_example_two_meshes(folder_with_meshes):
    """A box of 0.1 x 0.2 x 0.3 m and itself: exact distances along x are x - 0.1."""
    out = example("two_meshes.py", "part.stl", "link.stl", cwd=folder_with_meshes)
    found = [float(x) for x in re.findall(r"exact distance ([-+0-9.]+)", out)]
    np.testing.assert_allclose(found, [-0.1, 0.0, 0.1, 0.2], atol=1e-4)


def test_example_any_robot(tmp_path):
    """A module as robot_descriptions has them, which would clone a repository: here of a robot that is installed."""
    (tmp_path / "robot_descriptions").mkdir()
    home = robots_folder()
    (tmp_path / "robot_descriptions" / "panda_description.py").write_text(
        f"REPOSITORY_PATH = {str(home.parent)!r}\nPACKAGE_PATH = {str(home / 'panda_description')!r}\n"
        "URDF_PATH = PACKAGE_PATH + '/urdf/panda.urdf'\nSRDF_PATH = PACKAGE_PATH + '/srdf/panda.srdf'\n"
    )
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    out = example_apart("any_robot.py", "panda_description", cwd=tmp_path, PYTHONPATH=path)
    assert "Robot('panda', 13 links, 11 with bodies, 8 joints, dof 8)" in out
    assert 10 < int(re.search(r"of 1000 random configurations, (\d+) collide", out)[1]) < 100


def test_example_batch(tmp_path):
    """Shares add up to one, and the exact share lies between the certified ones."""
    out = example("batch.py", "--poses", "3000", cwd=tmp_path)
    free, colliding, ambiguous, exact = (float(x) for x in re.findall(r"([0-9.]+)%", out))
    assert abs(free + colliding + ambiguous - 100) <= 0.2
    assert colliding - 0.1 <= exact <= colliding + ambiguous + 0.1


def test_example_relax_crowd(tmp_path):
    """The crowd overlaps at the start and nowhere at the end, by its own count and by another query."""
    out = example("relax_crowd.py", "--count", "400", cwd=tmp_path)
    lines = re.findall(r"round +(\d+): +(\d+) pairs overlap, the deepest by +([0-9.]+) mm", out)
    assert int(lines[0][1]) > 400
    assert float(lines[0][2]) > 1000
    assert [float(x) for x in lines[-1][1:]] == [0, 0]
    assert "pairs that overlap at the end: 0" in out


def test_example_camera_loop(tmp_path):
    """Each frame has a plan into seen space, and the arm's shadow closes as it moves."""
    out = example("camera_loop.py", "2", cwd=tmp_path)
    rows = re.findall(r"frame \d: (\d+) boxes seen, (\d+) cells unknown, (\d+) stops", out)
    (_, before, _), (_, after, _) = ([int(number) for number in row] for row in rows)
    assert after < before < 45 * 45 * 32 / 4


def test_example_pack_box(tmp_path):
    """Each box is fuller than the one before, and nothing overlaps in the last."""
    out = example("pack_box.py", "--count", "8", "--rounds", "60", cwd=tmp_path)
    full = [float(x) for x in re.findall(r"([0-9.]+)% full", out)]
    assert full == sorted(full)
    assert full[-1] > 25
    assert re.search(r"pairs that overlap in the box of [0-9.]+ m: 0\n$", out)


def test_example_ellipsoid_of_points(tmp_path):
    """All points are inside; the ellipsoid in the cube is the unit ball."""
    out = example("ellipsoid_of_points.py", "--points", "500", "--dimension", "4", cwd=tmp_path)
    assert "all points inside: True" in out
    assert "[1. 1. 1. 1.]" in out


@pytest.mark.verify
def test_demo(tmp_path):
    """The demo runs, small, and leaves bodies, picture and report; no verdict is contradicted."""
    out = example("demo.py", "--hull", "--poses", "60", "--pairs", "60", "--configurations", "500", cwd=tmp_path)
    assert "exact answer contradicts: 0" in out
    free, colliding = (int(n) for n in re.search(r"in all\W+(\d+)\W+(\d+)", out).groups())
    assert free + colliding == 500
    assert min(free, colliding) > 0
    told = " ".join(out.split())  # the console breaks lines
    motions, proven = re.search(r"by (\d+) motions, planned in [0-9.]+ ms\. (\d+) of them are proven", told).groups()
    assert motions == proven
    paths, broken, nearest = re.search(
        r"Of (\d+) such paths .*, (\d+) are not free between two looks; the worst comes within ([-0-9.]+) mm", told
    ).groups()
    assert 0 < int(broken) < int(paths)
    assert float(nearest) < 10
    made = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    wanted = {
        "link7.npz",
        "hand.npz",
        "verdicts.png",
        "shelf.png",
        "path.png",
        "paper/report.html",
        "paper/report.md",
        "paper.json",
    }
    assert {f"demo-out/{name}" for name in wanted} <= made


def test_example_panda_in_clutter(tmp_path):
    """A path that touches nowhere, and keeps its margin."""
    out = example("panda_in_clutter.py", cwd=tmp_path)
    length, straight = (float(x) for x in re.search(r"length ([0-9.]+), .* blocked, ([0-9.]+)", out).groups())
    assert length > straight
    assert re.search(r"of \d+ configurations on it, 0 touch, 0 come nearer than the margin", out)


def test_example_moving_obstacle(tmp_path):
    """The ball comes near at some steps and not at others; what is too near is named."""
    out = example("moving_obstacle.py", "--steps", "200", cwd=tmp_path)
    near = int(re.search(r"too near at (\d+) of 200 steps", out)[1])
    assert 0 < near < 200
    assert re.search(r"step \d+: panda_\w+ and ball", out)


def test_example_grasped_object(tmp_path):
    """The can, not the hand, hits the post; the fingers may touch it only while it is attached."""
    out = example("grasped_object.py", cwd=tmp_path)
    assert "hand closed on it: panda_leftfinger and can, panda_rightfinger and can" in out
    assert "can attached to the hand: free" in out
    assert "the first of them: can and post" in out
    counts = [int(n) for n in re.findall(r": (\d+) (?:of|collide)", out)]
    assert counts[0] > 0
    assert counts[1] > 0
    assert counts[2] == 0


def test_example_plan_with_grasped_object(tmp_path):
    """The way of the empty hand is free for it and not for the bottle; that planned with the bottle is, all of it."""
    out = example("plan_with_grasped_object.py", cwd=tmp_path)
    assert "planned for the empty hand: 1 of 1 motions proven free" in out
    assert re.search(r"without touch links: start: .* a collision of .*finger and bottle", out)
    assert "the empty hand's path, with the bottle: 0 of 1 motions proven free" in out
    assert re.search(r"(bottle and wall|wall and bottle) come nearer than a centimetre at \d+% of motion 0", out)
    proven, motions = re.search(r"planned with the bottle: (\d+) of (\d+) motions proven free", out).groups()
    assert int(proven) == int(motions) > 1
    apart = [float(x) for x in re.findall(r"([0-9.]+) mm apart", out)]
    assert min(apart) >= 10


def test_example_conveyor(tmp_path):
    """Most starts are free, and one touches a part."""
    out = example("conveyor.py", "--out", "late.svg", cwd=tmp_path)
    assert "proven free if started at 0, 1, 2" in out
    assert re.search(r"started at 7 s: .* touch at 8\.1090\d+ s, free until 8\.1090\d+ s", out)
    assert re.search(r"planned among the parts from 7 s on: Trajectory\(.*\), FREE", out)
    assert (tmp_path / "late.svg").is_file()


def test_example_teleoperation(tmp_path):
    """Without the gate the arm meets the person; with it, it works on, and touches nothing while it moves."""
    out = example("teleoperation.py", cwd=tmp_path)
    moving, hit = zip(*re.findall(r"in motion at (\d+) of 400 ticks, in contact at (\d+)", out), strict=True)
    assert int(hit[0]) > 0
    assert int(hit[1]) == 0
    assert int(moving[1]) > 300
    passed, brakes, unproven = re.search(r"(\d+) targets let through, (\d+) brakes, (\d+) not proven", out).groups()
    assert int(passed) > 300
    assert int(brakes) > 0
    assert unproven == "0"
    assert "braked for: may be hit, panda_hand and person" in out


def test_example_lerobot_gate(tmp_path):
    """Some chunks of the policy meet the post, and none behind the gate, which lets most of them through as a whole."""
    out = example("lerobot_gate.py", cwd=tmp_path)
    raw, gated = re.search(r"nearer than 5 mm: (\d+) of 12 as the policy has them, (\d+) gated", out).groups()
    assert int(raw) > 0
    assert gated == "0"
    states = re.findall(r"chunk +\d+: (\w+), (\d+) of 50 actions", out)
    assert len(states) == 12
    assert all((state == "GO") == (steps == "50") for state, steps in states)
    assert sum(state == "GO" for state, _ in states) >= 6


def test_example_lerobot_gate_needs_a_map(tmp_path, monkeypatch):
    """Units of joints are never guessed: a joint that the map lacks, or a scale below zero, is refused."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import lerobot_gate

    checker = CollisionChecker(lerobot_gate.arm(), Scene())
    options = {"acceleration": 4.0, "tracking": 0.0, "velocity_error": 0.0}
    unit = lerobot_gate.Unit(1, 1.0, 0.0)
    units = dict.fromkeys(checker.robot.configuration_names, unit)
    step = lerobot_gate.GateStep(checker, units | {"elbow_flex": unit._replace(sign=-1, offset=0.5)}, 0.1, **options)
    q = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(step.to_radians(q), [0.1, 0.2, 0.2])
    np.testing.assert_allclose(step.from_radians(step.to_radians(q)), q)
    for bad in ({"elbow_flex": unit}, units | {"elbow_flex": unit._replace(scale=-1.0)}):
        with pytest.raises(ValueError, match="map: expected"):
            lerobot_gate.GateStep(checker, bad, 0.1, **options)


def test_example_belt_pick(tmp_path):
    """The three curves are proven, only fingers touch, and joints keep their limits of velocity and acceleration."""
    out = example("belt_pick.py", "--out", "belt.png", cwd=tmp_path)
    assert re.findall(r"^(.+): FREE", out, flags=re.M) == ["meet", "down and close", "up"]
    assert "then in contact: panda_leftfinger and box, panda_rightfinger and box\n" in out
    shares = re.search(r"largest velocity ([0-9.]+), largest acceleration ([0-9.]+) of the limits", out).groups()
    assert max(float(share) for share in shares) <= 1
    assert (tmp_path / "belt.png").stat().st_size > 0


def test_example_pick_and_place(tmp_path):
    """Every motion from the table to the shelf and back is proven; a millimetre into the table is a collision."""
    out = example("pick_and_place.py", "--out", "carry.csv", cwd=tmp_path)
    proven = re.findall(r"(\w+): (\d+) of (\d+) motions proven free", out)
    assert [name for name, _, _ in proven] == ["approach", "close", "carry", "open", "retreat"]
    assert all(0 < int(free) == int(motions) for _, free, motions in proven)
    assert "a millimetre into the table: COLLIDING, can and table" in out
    assert (tmp_path / "carry.csv").stat().st_size > 0


def test_example_audit_trajectory(tmp_path):
    """A smooth curve through a free path's corners collides; a trajectory made for the proof has one that verifies."""
    out = example("audit_trajectory.py", "--out", "theirs.svg", cwd=tmp_path)
    theirs, ours = re.findall(r"(\w+), (\d+) of (\d+) pieces proven free", out)
    assert theirs[0] == "COLLIDING"
    assert 0 < int(theirs[1]) < int(theirs[2])
    assert "s: panda_leftfinger and post" in out
    assert ours[0] == "FREE"
    assert ours[1] == ours[2] == re.search(r"verified by a second program: (\d+) pieces", out)[1]
    assert (tmp_path / "theirs.svg").is_file()
    again = example("audit_trajectory.py", "theirs.json", cwd=tmp_path)
    assert again == out


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("bend_a_path.py", "scipy"),
        pytest.param("bend_a_path_jax.py", "jax", marks=pytest.mark.verify),
        ("bend_a_path_torch.py", "torch"),
    ],
)
def test_example_bend_a_path(name, package, tmp_path):
    """A line that collides becomes a path that keeps two centimetres, every motion of it proven."""
    pytest.importorskip(package)
    out = example(name, cwd=tmp_path)
    straight, bent = (float(x) for x in re.findall(r"nearest ([-0-9.]+) mm", out))
    assert straight < -10
    assert bent >= 19.9
    proven, motions = re.search(r"(\d+) of (\d+) motions between its points are proven free", out).groups()
    assert proven == motions == "23"


def test_example_reach_with_clearance(tmp_path):
    """The hand is where it is to be both times; without looking the arm collides, with clearance it keeps that."""
    without, kept = example("reach_with_clearance.py", cwd=tmp_path).splitlines()
    for line in (without, kept):
        off = [float(x) for x in re.search(r"hand ([0-9.]+) mm and ([0-9.]+)° off", line).groups()]
        assert max(off) < 0.1
    assert float(re.search(r"distance ([-0-9.]+) mm", without)[1]) < 0
    clearance, distance = (float(x) for x in re.findall(r"(?:clearance|distance) ([-0-9.]+) mm", kept))
    assert 19.9 <= clearance <= distance


def test_example_humanoid_self_collision(tmp_path):
    """The humanoid is free where it stands, and fewer pairs are checked than without sampling."""
    out = example("humanoid_self_collision.py", "--samples", "300", cwd=tmp_path)
    assert "half sitting: free" in out
    kinds = {why: int(count) for why, count in re.findall(r"(adjacent|always|default|never) +(\d+)", out)}
    assert kinds["adjacent"] > 20
    assert kinds["never"] > 400
    checked = int(re.search(r"checked: (\d+) pairs", out)[1])
    assert 0 < checked < kinds["never"] + 1000


def test_ratios_are_drawn_from_their_table(tmp_path):
    """docs/images/ratios.svg is what its script makes of the table as it is now."""
    source = ROOT / "docs/images/ratios.py"
    (tmp_path / "ratios.py").write_text(source.read_text())
    table = str(ROOT / "docs/benchmarks.md")
    subprocess.run([sys.executable, str(tmp_path / "ratios.py"), table], check=True, cwd=tmp_path)
    assert (tmp_path / "ratios.svg").read_text() == source.with_suffix(".svg").read_text()


@pytest.mark.parametrize(
    "name", ["assumptions", *(pytest.param(k, marks=pytest.mark.verify) for k in ("verdicts", "planes"))]
)
def test_picture_is_what_its_script_draws(tmp_path, name):
    """Each picture is made of ellipses, or planes, that the library finds now, to the drawing's rounding."""
    source = ROOT / f"docs/images/{name}.py"
    (tmp_path / source.name).write_text(source.read_text())
    subprocess.run([sys.executable, str(tmp_path / source.name)], check=True, cwd=tmp_path)
    number = re.compile(r"-?\d+\.?\d*")
    old, new = ((folder / f"{name}.svg").read_text() for folder in (source.parent, tmp_path))
    assert number.sub("#", old) == number.sub("#", new)
    np.testing.assert_allclose(*([float(x) for x in number.findall(text)] for text in (old, new)), atol=0.25)
