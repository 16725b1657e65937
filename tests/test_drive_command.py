"""`loewner plan --base`: drives on maps, with the library's numbers, and none is read as a straight path."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from loewner import CollisionChecker, Robot, Scene, planners
from loewner.cli import main

CART = """<robot name='cart'><link name='cart'><collision><origin xyz='0.1 0 0.25'/><geometry><box size='0.4 0.3 0.5'/>
</geometry></collision></link>{more}</robot>"""
ARM = """<link name='arm'><collision><geometry><sphere radius='0.1'/></geometry></collision></link>
<joint name='lift' type='prismatic'><parent link='cart'/><child link='arm'/><origin xyz='0.1 0 0.7'/><axis xyz='0 0 1'/>
<limit lower='0' upper='1' effort='1' velocity='1'/></joint>"""
MAP = "{image: map.pgm, resolution: 0.1, origin: [-1, -1, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.196}"
TRIP = ("--start", "0 -0.5 0", "--goal", "2 1.5 3.1")


@pytest.fixture
def room(tmp_path, monkeypatch):
    """A map of 4 m x 3 m with a wall and a door, a cart, and a cart with a lift."""
    monkeypatch.chdir(tmp_path)
    pixels = np.full((30, 40), 254, "u1")
    pixels[:, 20] = 0
    pixels[12:18, 20] = 254
    Path("map.pgm").write_bytes(b"P5 40 30 255\n" + pixels.tobytes())
    Path("map.yaml").write_text(MAP)
    Path("cart.urdf").write_text(CART.format(more=""))
    Path("lift.urdf").write_text(CART.format(more=ARM))


def plan(capsys, *arguments, robot="cart.urdf"):
    """Status, output and errors of the command."""
    status = main(["plan", robot, "--map", "map.yaml", "1.0", *arguments])
    return status, *capsys.readouterr()


@pytest.mark.parametrize("options", [("car", "--radius", "0.4"), ("differential", "--no-reverse")])
def test_drives_are_those_of_the_library(room, capsys, options):
    """The command puts the robot on a base within the map, and prints the drive that the library finds."""
    status, out, err = plan(capsys, *TRIP, "--base", *options, "--json")
    assert (status, err) == (0, "")
    answer = json.loads(out)
    base = Robot.from_urdf("cart.urdf").add_base("planar", [[-1, 3], [-1, 2]])
    checker = CollisionChecker(base, Scene.from_map("map.yaml", height=1.0))
    car = options[0] == "car"
    drive = planners.plan(
        checker, [0, -0.5, 0], [2, 1.5, 3.1], base=options[0], radius=0.4 if car else None, reverse=car
    )
    assert answer["configurations"] == drive.path.tolist()
    assert [[motion["length"], motion["turn"]] for motion in answer["motions"]] == drive.motions.tolist()
    assert (answer["length"], answer["reversals"], answer["verdict"]) == (drive.length, drive.reversals, "FREE")
    nearest = min(motion["nearest"] for motion in answer["motions"])
    assert 0.0 < nearest <= checker.distance(drive.positions(drive.times), exact=True).distance.min()


@pytest.mark.parametrize("name", ["drive.csv", "drive.json"])
def test_written_drives_are_no_straight_paths(room, capsys, name):
    """`Drive.of` drives again what a file holds: configurations, lengths and turns; `loewner audit` refuses it."""
    status, out, _ = plan(capsys, *TRIP, "--base", "differential", "-o", name, "--proof", "drive.proof")
    assert status == 0
    assert out.startswith("FREE  ")
    assert f"written   {name}\nwritten   drive.proof\n" in out
    if name.endswith("csv"):
        head, *rows = csv.reader(Path(name).read_text().splitlines())
        assert head == ["base/x", "base/y", "base/theta", "length", "turn"]
        path, motions = np.split(np.array(rows, float), [3], axis=1)
        assert (motions[-1] == 0.0).all()
        motions = motions[:-1]
    else:
        content = json.loads(Path(name).read_text())
        path, motions = np.array(content["configurations"]), np.array(content["motions"])
    base = Robot.from_urdf("cart.urdf").add_base("planar", [[-1, 3], [-1, 2]])
    again = planners.Drive.of(base, path[0], motions)
    assert np.abs(again.path - path)[:, :2].max() < 1e-9
    assert main(["verify", "drive.proof"]) == 0
    capsys.readouterr()
    Path("wall.yaml").write_text("bodies:\n  wall: {box: [0.1, 4, 1], position: [9, 0, 0]}\n")
    assert main(["audit", "cart.urdf", name, "--scene", "wall.yaml"]) == 2
    assert name in capsys.readouterr().err


def test_three_numbers_are_a_pose_of_the_base(room, capsys):
    """All other joints stay; four numbers give each value."""
    for start in ("0 -0.5 0", "0 -0.5 0 0.0"):
        status, out, _ = plan(
            capsys, "--base", "differential", "--start", start, "--goal", "2 1.5 3.1", "--json", robot="lift.urdf"
        )
        answer = json.loads(out)
        assert (status, answer["names"][3]) == (0, "lift")
        assert {row[3] for row in answer["configurations"]} == {0.0}


@pytest.mark.parametrize(("arguments", "status", "message"), [
    ((*TRIP, "--base", "car"), 2, "radius: expected the least radius of a car's turns, found none"),
    ((*TRIP,), 2, "--map: expected --base with it"),
    ((*TRIP, "--radius", "1"), 2, "--radius: expected --base with it"),
    ((*TRIP, "--no-reverse"), 2, "--no-reverse: expected --base with it"),
    ((*TRIP, "--base", "differential", "--planner", "PRM"), 2, "--planner: expected no --base with it"),
    ((*TRIP, "--base", "differential", "--leave", "cart", "map"), 2, "--leave: expected no --base with it"),
    ((*TRIP, "--base", "differential", "--velocity", "1"), 2, "--velocity: expected no --base with it"),
    ((*TRIP, "--base", "differential", "--map", "map.yaml", "high"), 2, "--map, height: expected metres above 0"),
    ((*TRIP, "--base", "differential", "--map", "map.yaml", "-1"), 2, "--map, height: expected metres above 0"),
    ((*TRIP, "--base", "differential", "--map", "none.yaml", "1"), 2, "none.yaml"),
    ((*TRIP[:3], "2 nan 0", "--base", "differential"), 2, "--goal: expected finite numbers, found nan for base/y"),
    ((*TRIP[:3], "1.05 1.5 0", "--base", "differential"), 1, "no path: goal: expected a free configuration"),
    ((*TRIP, "--base", "differential", "--joint-error", "0.9"), 1, "no path: start: expected"),
    ((*TRIP, "--base", "differential", "--max-iterations", "1"), 1, "expected a way of the base from start to goal"),
    ((*TRIP, "--base", "differential", "-o", "drive.txt"), 2, "--out: expected a .csv or .json file"),
    ((*TRIP, "--base", "differential", "--scene", "belt.yaml"), 2, "follow"),
])  # fmt: skip
def test_what_is_refused(room, capsys, arguments, status, message):
    """One line on standard error; that there is no way is an answer, with status 1."""
    Path("belt.yaml").write_text(
        "bodies:\n  box: {box: [0.1, 0.1, 0.1], motion: {times: [0, 1], positions: [[0, 0, 3], [1, 0, 3]]}}\n"
    )
    found, out, err = plan(capsys, *arguments)
    assert (found, out) == (status, ""), err
    assert message in err
    assert err.count("\n") == 1
    assert not list(Path().glob("drive*"))


def test_a_robot_needs_a_base_or_a_map(room, capsys):
    """Without a map, a robot that stands is refused; one that slides and turns by its own joints needs none."""
    assert main(["plan", "cart.urdf", "--base", "differential", *TRIP]) == 2
    assert "or --map, within which a base is added, found the joints none" in capsys.readouterr().err


@pytest.mark.parametrize(("origin", "goal"), [("-1, -1, 0", "2.9 1 0"), ("-1, -1, 0.7", "-2 -0.5 0")])
def test_nothing_is_free_where_the_map_ends(room, capsys, origin, goal):
    """Neither for a part of the base that reaches over the edge, nor in the box around a turned map."""
    Path("map.yaml").write_text(MAP.replace("-1, -1, 0", origin))
    status, _, err = plan(capsys, "--start", "0 0 0", "--goal", goal, "--base", "differential")
    assert status == 1
    assert "outside of the map" in err
