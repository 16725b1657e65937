"""The 3-D page: what it shows is what the library answers, in Python and in a real browser; who may open it."""

import dataclasses
import http.server
import io
import itertools
import os
import re
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import loewner
from browsers import chromium, missing
from families import translation
from loewner import Body, CollisionChecker, InputError, Robot, Scene, Verdict, cli, planners, viewer
from loewner.viewer import drawing, framing, guard, playing
from loewner.viewer.page import length_text
from loewner.viewer.visuals import visual_meshes
from robot_oracle import robots_folder

# Chromium as root in a container, with no network and no graphics card.
FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]
# Names that a foreign site could have, made to point here.
FLAGS += ["--host-resolver-rules=MAP *.example 127.0.0.1"]
# Software draws the scenes; panels are drawn without its OpenGL, which saves a quarter of the time.
FLAGS += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
FLAGS += ["--disable-gpu-rasterization"]

# Software rendering on a busy machine takes seconds for what a graphics card does at once.
PATIENCE = 120_000

# Software draws small windows sooner; the panel must leave room for the bodies.
WINDOW = {"width": 1000, "height": 500}

ARM = """
<robot name="arm">
  <link name="base"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 0.6"/></geometry></collision></link>
  <link name="fore"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 0.6"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.9"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""


@pytest.fixture(autouse=True)
def viser():
    try:
        import viser
    except ImportError:
        missing("no viser: pip install -r requirements/dev.txt")
    return viser


@pytest.fixture(scope="module")
def browser():
    with chromium(args=FLAGS) as browser:
        yield browser


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    scene = Scene()
    scene.add("wall/left", Body.box([0.1, 1, 1]), translation(1.2))
    scene.add("<b>ball</b>", Body.sphere(0.2), translation(-1.2))
    return CollisionChecker(Robot.from_urdf(path), scene)


@pytest.fixture
def lonely(tmp_path):
    """A robot of one link."""
    path = tmp_path / "lonely.urdf"
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    path.write_text(f'<robot name="lonely"><link name="base">{box}</link></robot>')
    return Robot.from_urdf(path)


def eventually(condition, seconds=20.0):
    """Wait for the page's own thread."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the page did not follow"
        time.sleep(0.01)


# -- in Python --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "volume"),
    [
        (Body.box([1, 2, 3]), 6.0),
        (Body.sphere(0.4), 4 / 3 * np.pi * 0.4**3),
        (Body.ellipsoid([1, 2, 3]), 8 * np.pi),
        (Body.cylinder(0.3, 2.0), 0.18 * np.pi),
        (Body.cone(0.5, 1.2), 0.1 * np.pi),
        (Body.capsule(0.2, 1.0), 0.04 * np.pi + 4 / 3 * np.pi * 0.2**3),
    ],
    ids=lambda value: repr(value) if isinstance(value, Body) else "",
)
def test_what_is_drawn_is_the_piece(body, volume):
    """The triangles enclose the piece's volume, face outward, and lie where the piece does; also once it is moved."""
    T = translation(0.3, -0.2, 0.5)
    T[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    points, triangles = drawing.pieces(body)
    moved, same = drawing.pieces(body.transformed(T))
    corners = points[triangles]
    found = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert 0.97 * volume < found < 1.0001 * volume
    np.testing.assert_allclose(moved, points @ T[:3, :3].T + T[:3, 3], atol=1e-9)
    np.testing.assert_array_equal(same, triangles)


def test_ellipsoids_drawn_are_those_of_the_body(rng):
    """Every corner drawn lies on the surface of the ellipsoid it belongs to."""
    body = Body.from_pieces([rng.normal(size=(12, 3)), rng.normal(size=(9, 3)) + 3])
    for which, fitted in (("inner", body.inner), ("outer", body.outer)):
        points, _ = drawing.ellipsoids(body, which)
        for center, factor, corners in zip(fitted.center, fitted.factor, np.split(points, 2), strict=True):
            np.testing.assert_allclose(np.linalg.norm(np.linalg.solve(factor, (corners - center).T), axis=0), 1.0)


def test_pair_follows_python():
    """A pose set in Python is answered before the assignment returns."""
    a, b = Body.box([1, 1, 1]), Body.box([1, 1, 1])
    with viewer.show_pair(a, None, b, translation(2.5)) as page:
        for x in (2.5, 1.3, 0.6):
            page.T_world_b = translation(x)
            assert page.verdict == loewner.classify(a, None, b, translation(x))
            assert page.colliding == loewner.collide(a, None, b, translation(x))
            assert page.found.distance == loewner.distance(a, None, b, translation(x), exact=True).distance
            assert page.verdict.name in page._verdict.content
        assert page.verdict == Verdict.COLLIDING
        page.T_world_a = translation(-5)
        assert page.verdict == Verdict.FREE
        np.testing.assert_array_equal(page.T_world_a, translation(-5))


def test_numbers_typed_on_the_page_move_the_body():
    """What the page's number fields hold is where the body goes."""
    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5)) as page:
        page._inputs["B"].position.value = (0.6, 0.0, 0.0)
        page._inputs["B"].turn.value = (0.0, 0.0, 90.0)
        page._tell("type B")
        eventually(lambda: page.verdict == Verdict.COLLIDING)
        np.testing.assert_allclose(page.T_world_b[:3, :2], [[0, -1], [1, 0], [0, 0]], atol=1e-12)


def test_layers_switch_on_and_off():
    """At first only pieces are shown; a checkbox shows or hides its layer on both bodies, and nothing else."""
    with viewer.show_pair(Body.cone(1, 1), None, Body.box([1, 1, 1]), translation(2.5)) as page:
        nodes = [shown._nodes for shown in page._drawings.values()]
        assert all(set(n) == {"pieces"} for n in nodes)
        for on in (True, False):
            page._layers["outer"].value = on
            page._tell("layers")
            eventually(lambda on=on: all("outer" in n and n["outer"].visible == on for n in nodes))
            assert all(n["pieces"].visible and "inner" not in n for n in nodes)


def test_bodies_keep_their_colours():
    """Two bodies differ in colour, whatever the verdict; the bar has the colour and the name of the exact answer."""
    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5, 0.6)) as page:
        for x, exact in ((2.5, Verdict.FREE), (1.2, Verdict.FREE), (0.88, Verdict.COLLIDING), (0.4, Verdict.COLLIDING)):
            page.T_world_b = translation(x, 0.6)
            assert [drawn._nodes["pieces"].color for drawn in page._drawings.values()] == [*drawing.PAIR.values()]
            bar, _, rest = page._verdict.content.partition("<table>")
            assert f">{exact.name}<" in bar
            assert f"background:rgb{drawing.VERDICT_COLOURS[exact]}" in bar
            assert page.verdict.name in rest
        assert {page.verdict} == {Verdict.COLLIDING}


def test_marks_inside_bodies_are_seen():
    """While bodies overlap, and the near points are shown, the pieces are transparent."""
    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5)) as page:
        pieces = [drawn._nodes["pieces"] for drawn in page._drawings.values()]
        assert [node.opacity for node in pieces] == [None, None]
        page.T_world_b = translation(0.5)
        assert None not in [node.opacity for node in pieces]
        page._layers["near"].value = False
        page.refresh()
        assert [node.opacity for node in pieces] == [None, None]


def test_layers_are_sent_when_first_shown(arm):
    """What nobody looks at is not computed, nor sent."""
    with viewer.show_robot(arm) as page:
        drawn = [shown.drawing for shown in page._shown.values()]
        assert all(set(d._nodes) == {"pieces"} for d in drawn)
        page._layers["outer"].value = True
        page._tell("layers")
        eventually(lambda: all(set(d._nodes) == {"pieces", "outer"} for d in drawn))


def test_original_meshes_of_a_pair(tmp_path):
    """The mesh that a body was made from is a layer of its own; a body without one shows its pieces there."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.torus(1.0, 0.3)
    mesh.export(tmp_path / "ring.stl")
    ring = Body.from_mesh(mesh, decompose=False)
    with viewer.show_pair(ring, None, Body.sphere(0.2), translation(3), mesh_a=tmp_path / "ring.stl") as page:
        a, b = page._drawings.values()
        assert "meshes" not in a._nodes
        assert not page._layers["meshes"].value
        page._layers["meshes"].value, page._layers["pieces"].value = True, False
        page._tell("layers")
        eventually(lambda: a._nodes.get("meshes") is not None and not a._nodes["pieces"].visible)
        assert len(a._nodes["meshes"].faces) == len(mesh.faces)
        assert b._nodes["pieces"].visible
        page.T_world_b = translation(1.0)
        assert a._nodes["meshes"].color == drawing.PAIR["A"]
    with viewer.show_pair(ring, None, Body.sphere(0.2), translation(3)) as page:
        assert "meshes" not in page._layers


def test_a_mesh_that_cannot_be_read(tmp_path):
    """A broken mesh is refused before a page is opened."""
    (tmp_path / "broken.stl").write_bytes(b"solid nothing")
    with pytest.raises(loewner.LoewnerError, match=r"broken\.stl"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, mesh_b=tmp_path / "broken.stl")
    with pytest.raises(loewner.InputError, match="mesh: expected a path"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, mesh_b=3)


LOOKS = """
<robot name="looks">
  <link name="base">
    <visual><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><geometry><mesh filename="package://shapes/brick.stl"
      scale="1 -1 2"/></geometry></visual>
    <visual><geometry><cylinder radius="0.1" length="0.4"/></geometry></visual>
    <collision><geometry><box size="1 1 1"/></geometry></collision>
  </link>
  <link name="plain"><collision><origin xyz="3 0 0"/><geometry><box size="1 1 1"/></geometry></collision></link>
  <link name="lamp"><visual><geometry><sphere radius="0.1"/></geometry></visual></link>
  <link name="lost">
    <visual><geometry><mesh filename="package://shapes/gone.stl"/></geometry></visual>
    <visual><geometry><box size="0 0 0"/></geometry></visual>
    <collision><origin xyz="0 9 0"/><geometry><box size="1 1 1"/></geometry></collision>
  </link>
  <joint name="a" type="revolute"><parent link="base"/><child link="plain"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="b" type="fixed"><parent link="plain"/><child link="lamp"/></joint>
  <joint name="c" type="revolute"><parent link="plain"/><child link="lost"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.fixture
def dressed(tmp_path):
    """A robot with visual geometry: of meshes and primitives, missing, broken, and on a link that is not checked."""
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "shapes").mkdir()
    trimesh.creation.box((1, 2, 3)).apply_translation((1, 0, 0)).export(tmp_path / "shapes" / "brick.stl")
    (tmp_path / "looks.urdf").write_text(LOOKS)
    return Robot.from_urdf(tmp_path / "looks.urdf")


def test_looks_of_a_robot(dressed):
    """Visual geometry stands in the frame of its link, scaled and placed; what is missing is named, with its line."""
    looks, faults = visual_meshes(dressed)
    assert set(looks) == {"base", "lamp"}
    points, triangles = looks["base"]
    np.testing.assert_allclose(points.min(axis=0), [-1, -0.1, -2], atol=1e-6)
    np.testing.assert_allclose(points[:, :2].max(axis=0), [1, 1.5], atol=1e-6)
    np.testing.assert_allclose(points[:, 2].max(), 4, atol=1e-6)
    corners = points[triangles]
    volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(12 + 0.004 * np.pi, rel=1e-3)  # mirrored, and still not inside out
    assert len(faults) == 2
    assert "line 12: expected the mesh 'package://shapes/gone.stl' of link 'lost'" in faults[0] + faults[1]
    assert "line 13: expected sizes above 0 for a box" in faults[0] + faults[1]


def test_looks_are_shown_when_asked_for(dressed):
    """The layer draws what there is, notes on the page what is missing or not checked, and hides no checked body."""
    with viewer.show_robot(CollisionChecker(dressed)) as page:
        assert "_visuals" not in vars(page)  # not read yet
        page._layers["meshes"].value, page._layers["pieces"].value = True, False
        page._tell("layers")
        eventually(lambda: page._notes.visible)
        nodes = {name: shown.drawing._nodes for name, shown in page._shown.items()}
        assert nodes["base"]["meshes"].visible
        assert not nodes["base"]["pieces"].visible
        assert nodes["plain"]["pieces"].visible
        assert nodes["lost"]["pieces"].visible
        assert page._unchecked["lamp"].visible
        for words in ("gone.stl", "line 13", "lamp: drawn, but not checked"):
            assert words in page._notes.content
        page._layers["meshes"].value = False
        page._tell("layers")
        eventually(lambda: not page._notes.visible)
        assert not page._unchecked["lamp"].visible
        assert not nodes["base"]["meshes"].visible


def test_urdf_gone_since(dressed, arm):
    """A URDF that was moved since it was read gives a note, not an error; one without visual geometry says so."""
    dressed.urdf.unlink()
    looks, faults = visual_meshes(dressed)
    assert looks == {}
    assert len(faults) == 1
    assert "looks.urdf: expected a URDF, but there is no such file" in faults[0]
    with viewer.show_robot(arm) as page:
        page._layers["meshes"].value = True
        page._tell("layers")
        eventually(lambda: "no visual geometry" in page._notes.content)


def test_failed_query_leaves_no_verdict_standing(monkeypatch):
    """Where the exact search gives up, the page does not go on saying FREE."""

    def give_up(*_, **__):
        raise loewner.ConvergenceError("no answer")

    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5)) as page:
        assert "FREE" in page._verdict.content
        monkeypatch.setattr(viewer.pair, "collide", give_up)
        page.refresh()
        assert "FREE" not in page._verdict.content
        assert "UNDECIDED" in page._verdict.content
        assert page.verdict == Verdict.AMBIGUOUS
        assert page.colliding


def test_nothing_left_to_check(lonely):
    """When the last body leaves the scene, the page does not go on saying FREE."""
    scene = Scene()
    scene.add("ball", Body.sphere(0.2), translation(3))
    with viewer.show_robot(CollisionChecker(lonely, scene)) as page:
        assert page.verdict == Verdict.FREE
        scene.remove("ball")
        eventually(lambda: "UNDECIDED" in page._verdict.content)
        assert "expected a robot and a scene with pairs to check, found none" in page._verdict.content
        assert page.verdict == Verdict.AMBIGUOUS


def test_robot_follows_python_and_the_scene(arm):
    """Configuration, verdict and named pairs are the checker's; a scene changed behind the page's back shows too."""
    with viewer.show_robot(arm) as page:
        for q in ([0.0, 0.0], [1.2, 0.4], [0.3, 2.5], [-1.0, -0.7]):
            page.q = q
            assert page.verdict == arm.classify(q)
            assert page.colliding == arm.collide(q)
            assert [(c.name_a, c.name_b) for c in page.contacts] == [(c.name_a, c.name_b) for c in arm.pairs(q)]
        page.q = [1.5, 0.0]
        assert page.colliding
        assert "wall/left" in {c.name_b for c in page.contacts}
        arm.scene.move("wall/left", translation(5))
        eventually(lambda: not page.colliding)
        arm.scene.remove("wall/left")
        arm.scene.add("post", Body.cylinder(0.1, 2), translation(0.9))
        arm.scene.attach("<b>ball</b>", "fore", translation(0, 0, 1.0))
        eventually(lambda: page.colliding)
        assert set(page._shown) == {"base", "upper", "fore", "post", "<b>ball</b>"}
        page.move("post", translation(-3))
        assert not page.colliding


def test_names_cannot_add_to_the_page(arm):
    """Names come from files; on the page they are text."""
    with viewer.show_robot(arm, [-1.5, 0.0]) as page:
        assert "&lt;b&gt;ball&lt;/b&gt;" in page._verdict.content
        assert "<b>ball</b>" not in page._verdict.content


def test_sliders_move_the_robot(arm):
    """Sliders hold the limits, and their values are the configuration."""
    with viewer.show_robot(arm) as page:
        shoulder, elbow = page._sliders
        assert (shoulder.min, shoulder.max) == (-2.0, 2.0)
        assert (elbow.min, elbow.max) == (-np.pi, np.pi)
        shoulder.value = 1.5
        page._tell("joints")
        eventually(lambda: page.q[0] == 1.5)
        eventually(lambda: page.colliding == arm.collide([1.5, 0.0]))


STATES = """
<robot name="arm">
  <group name="shoulder"><joint name="shoulder"/></group>
  <group name="both"><joint name="shoulder"/><joint name="elbow"/></group>
  <group_state name="up" group="shoulder"><joint name="shoulder" value="0.1"/></group_state>
  <group_state name="bent" group="both">
    <joint name="shoulder" value="2.5"/><joint name="elbow" value="1"/>
  </group_state>
  <group_state name="low" group="both">
    <joint name="shoulder" value="1.5"/><joint name="elbow" value="0"/>
  </group_state>
</robot>
"""


def test_a_robot_starts_in_a_state_of_its_srdf(arm, tmp_path):
    """The first state that names the most joints, within the limits; a configuration or a path comes before it."""
    (tmp_path / "arm.srdf").write_text(STATES)
    checker = CollisionChecker(Robot.from_urdf(tmp_path / "arm.urdf", srdf=tmp_path / "arm.srdf"), arm.scene)
    for given, q, state in (({}, [2.0, 1.0], "bent"), ({"q": [0.3, 0.0]}, [0.3, 0.0], "(other)")):
        with viewer.show_robot(checker, **given) as page:
            assert page.q.tolist() == q
            assert page._state.value == state
    with viewer.show_robot(checker, path=[[0.5, 0.0], [1.0, 0.0]]) as page:
        assert page.q.tolist() == [0.5, 0.0]


def test_viser_prints_nothing(capsys):
    """Neither when a page opens nor when it closes; prints of others in the meantime are not lost."""
    import rich

    with viewer.show_pair(Body.sphere(1), None, Body.sphere(1), translation(3)), viewer.page._quiet():
        rich.print("of others")
    assert capsys.readouterr() == ("of others\n", "")


def test_a_script_that_forgets_its_page_prints_nothing():
    """A page that is still open when the program ends is closed without a message."""
    code = "from loewner import Body, viewer; page = viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("to", [[1, 2, 3], [-1, 0, 0], [1, 0, 0], [-1, 1e-9, 0], [0, 0, 0], [-1, -1e-2, 1e-2]])
def test_the_line_joins_the_near_points(to):
    """Whatever its direction, it begins at one point and ends at the other."""
    with two_boxes() as page:
        near, a, b = page._near, np.array([0.5, 0.0, -1.0]), np.array([0.5, 0.0, -1.0]) + to
        near.show(a, b)
        w, *v = near._line.wxyz
        (start, end), v = near._line.points[0].astype(float), np.array(v)
        ends = [p + 2 * np.cross(v, np.cross(v, p) + w * p) + near._line.position for p in (start, end)]
        np.testing.assert_allclose(ends, [a, b], atol=2e-3)


def test_handles_are_not_in_pictures(arm):
    """While a picture is taken no body has handles; afterwards the same bodies have them as before."""

    def handles(movers):
        return [not mover.gizmo.disable_axes for mover in movers]

    with viewer.show_pair(Body.sphere(1), None, Body.sphere(1), translation(3)) as page:
        movers = page._movers.values()
        for _ in range(2):
            assert handles(movers) == [True, True]
            with page._without_gizmos():
                page.T_world_b = translation(2)
                assert handles(movers) == [False, False]
    with viewer.show_robot(arm) as page:
        page._tell("clicked", "wall/left")
        movers = [shown.mover for shown in page._shown.values() if shown.mover is not None]
        eventually(lambda: sum(handles(movers)) == 1)
        before = handles(movers)
        with page._without_gizmos():
            page.move("wall/left", translation(2))
            assert not any(handles(movers))
        assert handles(movers) == before


@pytest.fixture
def moved(arm):
    """From the middle into the wall, in two seconds."""
    return planners.trajectory(arm.robot, [[0.0, 0.0], [1.5, 0.0]], velocity=1.0, acceleration=2.0)


def test_a_trajectory_is_shown(arm, moved):
    """The robot is where the trajectory is at the time of the slider, set in Python or on the page."""
    with viewer.show_robot(arm, trajectory=moved) as page:
        assert page.time == 0.0
        for t in (0.7, moved.duration, 0.0):
            page.time = t
            assert page.q.tolist() == moved.positions(t).tolist()
            assert page.colliding == arm.collide(page.q)
            assert page._clock.value == t
        page._clock.value = 0.5
        page._tell("time")
        eventually(lambda: page.time == 0.5)
        assert page.q.tolist() == moved.positions(0.5).tolist()
        assert [slider.value for slider in page._sliders] == page.q.tolist()


def test_a_trajectory_is_played(arm, moved):
    """It runs at the pace of the clock to its end, pauses when asked to, and starts anew from the end."""
    with viewer.show_robot(arm, trajectory=moved) as page:
        began = time.monotonic()
        page.play()
        assert page.playing
        assert page._button.label == "pause"
        eventually(lambda: page.time > 0.3)
        page._tell("play")  # the button
        eventually(lambda: not page.playing)
        assert 0.3 < page.time <= time.monotonic() - began
        paused = page.time
        assert page._button.label == "play"
        assert page.q.tolist() == moved.positions(paused).tolist()
        page.play()
        eventually(lambda: not page.playing)
        assert page.time == moved.duration
        assert page.q.tolist() == [1.5, 0.0]
        assert time.monotonic() - began >= moved.duration
        page.play()
        assert page.time < moved.duration
        page.pause()
        assert not page.playing


def test_a_trajectory_is_played_faster_or_slower(arm, moved, monkeypatch):
    """The time on the page advances by the time of the clock, multiplied by the speed, also if the speed changes."""
    clock = [100.0]
    monkeypatch.setattr(viewer.robot, "monotonic", lambda: clock[0])
    with viewer.show_robot(arm, trajectory=moved) as page:
        page.play()
        reached = 0.0
        for speed in (1.0, 0.5, 2.0):
            page._pace.value = f"{speed:g} ×"
            page._tell("speed")
            eventually(lambda speed=speed: page._speed == speed)
            clock[0] += 0.25
            reached += 0.25 * speed
            page.refresh()
            assert page.time == pytest.approx(reached)
            assert page.playing


def test_what_is_proven_along_a_trajectory(arm, moved):
    """The page shows the library's proof, in parts; it is void as soon as the scene changes, and then made again."""
    with viewer.show_robot(arm, trajectory=moved) as page:
        eventually(lambda: page._proof is not None)
        found = moved.certify(arm)
        assert page._proof[0].tolist() == found.times.tolist()
        assert page._proof[1].tolist() == found.segments.verdict.tolist()
        assert set(page._proof[1]) == {0, 1}
        assert "proof: collides within" in page._proof_strip.content
        for t, words in ((0.0, "free throughout 0 .. "), (moved.duration, "collides within")):
            page.time = t
            row = re.search(r'data-loewner="proof"[^>]*>([^<]*)<', page._verdict.content)[1]
            assert words in row
            k = min(np.searchsorted(found.times, t, side="right"), len(found.times) - 1) - 1
            assert found.segments.verdict[k] == (0 if "free" in row else 1)
        page.q = [0.1, 0.2]  # not on the trajectory
        assert 'data-loewner="proof"' not in page._verdict.content
        page.move("wall/left", translation(9))
        assert page._proof is None
        assert page._proof_strip.content == ""
        eventually(lambda: page._proof is not None)
        assert "proof: free at every instant" in page._proof_strip.content


def test_what_is_proven_along_a_path(arm):
    """A path without times is proven in parts: all that are free, and none in which a sample collides."""
    rows = np.array([[0.0, 0.0], [0.5, 0.0], [1.5, 0.0], [1.5, 0.0], [0.5, 1.0]])
    with viewer.show_robot(arm, path=rows) as page:
        eventually(lambda: page._proof is not None)
        times, verdicts = page._proof
        assert set(page._way.times) <= set(times)
        samples = times[:-1, None] + np.diff(times)[:, None] * np.linspace(0.0, 1.0, 9)
        hits = arm.collide(page._way.positions(np.minimum(samples, page._way.duration))).any(axis=1)
        assert hits.any()
        assert not hits.all()
        np.testing.assert_array_equal(verdicts == Verdict.COLLIDING, hits)
        assert (verdicts[~hits] == Verdict.FREE).all()


def test_bodies_move_without_a_path(arm):
    """The slider moves bodies that follow motions, the robot is moved by hand meanwhile, and both are proven."""
    arm.scene.follow("wall/left", [1.0, 3.0], np.stack([translation(1.2, 5.0), translation(1.2)]))
    with viewer.show_robot(arm) as page:
        for t in (0.0, 0.5, 2.0):
            page.time = t
            np.testing.assert_allclose(
                page._shown["wall/left"].mover.T, arm.scene.following["wall/left"].poses(1.0 + t)
            )
            assert page.colliding == arm.collide(page.q, 1.0 + t)
        eventually(lambda: page._proof is not None)
        assert "proof: free at every instant" in page._proof_strip.content
        page.q = [1.5, 0.0]
        assert page.time == 2.0
        assert page.colliding
        assert "colliding" in page._strip.content
        eventually(lambda: page._proof is not None)
        assert page._proof[1].tolist() == sorted(page._proof[1].tolist())
        assert set(page._proof[1]) == {0, 1}
        page.play()
        page._sliders[0].value = 1.4
        page._tell("joints")
        eventually(lambda: page.q[0] == 1.4)


def test_hands_end_a_trajectory(arm, moved):
    """Whoever moves a joint, on the page or in Python, is not overruled by the trajectory."""
    with viewer.show_robot(arm, trajectory=moved) as page:
        page.play()
        page.q = [-1.0, 0.5]
        assert not page.playing
        page.play()
        page._sliders[0].value = 0.25
        page._tell("joints")
        eventually(lambda: not page.playing)
        page.refresh()
        assert page._clock.value == page.time


def test_trajectories_of_others(arm, moved, lonely):
    """What is no trajectory, or another robot's, is refused; a page without one cannot play."""
    with pytest.raises(loewner.InputError, match="planners.trajectory makes one"):
        viewer.show_robot(arm, trajectory=[[0.0, 0.0], [1.0, 0.0]])
    other = dataclasses.replace(moved, names=("shoulder", "wrist"))
    with pytest.raises(loewner.InputError, match="trajectory: expected one of 'arm', for shoulder, elbow"):
        viewer.show_robot(arm, trajectory=other)
    with viewer.show_robot(arm) as page:
        for act in (page.play, page.pause, lambda: setattr(page, "time", 0.0)):
            with pytest.raises(loewner.InputError, match="trajectory"):
                act()
    with viewer.show_robot(arm, trajectory=moved) as page:
        for bad in (-1.0, 100.0, np.nan, "now", None):
            with pytest.raises(loewner.InputError, match="t: expected|time: expected"):
                page.time = bad


def test_many_moves_are_answered_by_the_last():
    """Moves that wait are not answered one by one: the page never lags behind the mouse."""
    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5)) as page:
        before = page.answered
        with page.lock:
            for x in np.linspace(2.5, 0.5, 500):
                page._inputs["B"].position.value = (float(x), 0.0, 0.0)
                page._tell("type B")
        eventually(lambda: page.T_world_b[0, 3] == 0.5)
        assert page.verdict == Verdict.COLLIDING
        assert page.answered - before < 50


# -- bad input --------------------------------------------------------------------------------


def test_port_in_use():
    """A port that another program has is refused by name, not silently changed."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(loewner.InputError, match=f"port: expected a free port .* {port}"):
            viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port)


@pytest.mark.parametrize("port", [-1, 65536, 80.5, "8080", True])
def test_port_that_is_none(port):
    """A port has to be a whole number from 0 to 65535."""
    with pytest.raises(loewner.InputError, match="port: expected a whole number"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port)


def test_host_that_is_none():
    """A host that does not exist is refused by its name."""
    with pytest.raises(loewner.InputError, match="no such host"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, host="no such host")


def test_missing_extra_names_the_install(monkeypatch):
    """Without viser the error names the extra to install."""
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(loewner.MissingExtraError, match=r'viser: pip install "loewner\[viewer\]"'):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None)


def test_operands_are_checked(arm):
    """Bodies, poses, checkers and configurations of a page are checked by name."""
    with pytest.raises(loewner.InputError, match=r"a: expected loewner\.Body, found str"):
        viewer.show_pair("a", None, Body.sphere(1), None)
    with pytest.raises(loewner.PoseError, match="T_world_b"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), np.zeros((4, 4)))
    with pytest.raises(loewner.InputError, match=r"checker: expected loewner\.CollisionChecker, found Robot"):
        viewer.show_robot(arm.robot)
    with pytest.raises(loewner.InputError, match="q: expected"):
        viewer.show_robot(arm, [0.0])


def test_nothing_to_check(lonely):
    """A robot of one body in an empty scene is refused, for there is nothing to check."""
    with pytest.raises(loewner.InputError, match="checker: expected pairs to check, found none"):
        viewer.show_robot(CollisionChecker(lonely))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["part.npz"], "view: expected two bodies, A and B, or --robot URDF"),
        (
            ["part.npz", "part.npz", "--scene", "empty.yaml"],
            "expected --scene with --robot only, found it with A and B",
        ),
        (["part.npz", "--robot", "arm.urdf"], "expected no A and B with --robot"),
        (["--robot", "arm.urdf", "--scene", "empty.yaml"], "empty.yaml: expected a scene with bodies, found none"),
        (["--robot", "broken.urdf"], "broken.urdf, line 1: expected a URDF"),
        (["--robot", "none.urdf"], "none.urdf: expected"),
        (["part.npz", "part.npz", "--trajectory", "a.csv"], "expected --trajectory with --robot only"),
        (
            ["--robot", "arm.urdf", "--trajectory", "none.csv"],
            "none.csv: expected a trajectory, but there is no such file",
        ),
        (["--robot", "arm.urdf", "--trajectory", "other.csv"], "trajectory: expected one of 'arm'"),
        (["part.npz", "part.npz", "--port", "70000"], "port: expected a whole number"),
        (["part.npz", "nothing.npz"], "nothing.npz: expected a saved file"),
        (["part.npz", "broken.stl"], "broken.stl: expected a whole text STL"),
        (["part.npz", "part.npz", "--decompose"], "expected --decompose with --robot only"),
        (["part.npz", "part.npz", "--package-dir", "x"], "expected --package-dir with --robot only"),
        (["--robot", "arm.urdf", "--margin", "0.1"], "expected --margin with A and B only, not --robot"),
        (["--robot", "arm.urdf", "--radius", "0.1"], "expected --radius with A and B only, not --robot"),
        (["--robot", "arm.urdf", "--threshold", "0.1"], "expected --threshold with A and B only, not --robot"),
        (["--robot", "arm.urdf", "--decompose", "--model", "hull"], "--decompose: expected no other model with it"),
        (["part.npz", "broken.stl", "--hull", "--radius", "1"], "--radius: expected it with --model surface only"),
        (["--robot", "arm.urdf", "--scale", "0.001"], "expected --scale with A and B only, not --robot"),
        (["--robot", "arm.urdf", "--pose-b", "1 0 0"], "expected --pose-b with A and B only, not --robot"),
        (["--robot", "bare.urdf"], "expected a robot with collision geometry, found none"),
    ],
    ids=lambda value: value[:24] if isinstance(value, str) else "",
)
def test_command_line_says_what_is_wrong(arguments, expected, arm, tmp_path, monkeypatch, capsys):
    """Bad input ends with status 2 and one line, before any page is opened."""
    monkeypatch.chdir(tmp_path)
    Body.box([1, 1, 1]).save("part.npz")
    Path("empty.yaml").write_text("bodies: {}\n")
    Path("broken.urdf").write_text("<robot")
    Path("bare.urdf").write_text('<robot name="bare"><link name="base"/></robot>')
    Path("broken.stl").write_text("solid part\nfacet")
    planners.Trajectory(("a",), np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(0, bool)).save("other.csv")
    assert cli.main(["view", *arguments, "--no-browser"]) == 2
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.out == ""


def test_closed_page(arm):
    """What a closed page can no longer do is refused before anything is changed; its last answers can be read."""
    page = viewer.show_robot(arm)
    page.close()
    pair = viewer.show_pair(Body.sphere(1), None, Body.sphere(1), translation(3))
    pair.close()
    uses = [
        page.refresh,
        lambda: page.url,
        lambda: page.move("wall/left", translation(9)),
        lambda: setattr(page, "q", [0.1, 0.1]),
        lambda: setattr(pair, "T_world_b", translation(0.5)),
        pair.__enter__,
    ]
    for use in uses:
        with pytest.raises(loewner.InputError, match="page: expected an open page, found a closed one"):
            use()
    np.testing.assert_array_equal(arm.scene.pose("wall/left"), translation(1.2))
    np.testing.assert_array_equal(pair.T_world_b, translation(3))
    assert pair.verdict == Verdict.FREE


def test_close_twice_and_free_the_port():
    """Closing a page twice is harmless, and its port is free afterwards."""
    page = viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None)
    port = page.server.get_port()
    page.close()
    page.close()
    with viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port) as again:
        assert again.url == f"http://localhost:{port}"
        assert repr(again) == f"PairViewer({again.url})"
    assert repr(again) == "PairViewer(closed)"


# -- who may open it --------------------------------------------------------------------------

UPGRADE = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13")
UPGRADE += ("Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",)

SERVED = {False: 200, True: 101}


def two_boxes(**options):
    return viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), translation(2.5), **options)


def ask(page, *lines, websocket=False, path="/", address="127.0.0.1"):
    """Send a request of exactly these header lines; its status, and the head of the answer."""
    import viser

    port = page.server.get_port()
    lines = [line.format(port=port, next=port + 1) for line in lines]
    if websocket:
        lines += [*UPGRADE, f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]
    with socket.create_connection((address, port), timeout=30) as connection:
        connection.sendall("\r\n".join([f"GET {path} HTTP/1.1", *lines, "", ""]).encode("latin-1"))
        head = b""
        while b"\r\n\r\n" not in head:
            part = connection.recv(65536)
            assert part, head
            head += part
    return int(head.split()[1]), head.partition(b"\r\n\r\n")[0].decode("latin-1")


@pytest.fixture(scope="module")
def open_page():
    with two_boxes() as page:
        yield page


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    "host",
    [
        "evil.example:{port}",
        "evil.example",
        "localhost",
        "localhost:{next}",
        "localhost:{port}.evil.example",
        "localhost.evil.example:{port}",
        "127.0.0.1.evil.example:{port}",
        "localhost.:{port}",
        "localhost:{port}@evil.example:{port}",
        "evil.example/localhost:{port}",
        "evil.example,localhost:{port}",
        "0.0.0.0:{port}",
        "192.168.1.2:{port}",
        "[::2]:{port}",
        "[::1:{port}",
        "::1:{port}",
        "2130706433:{port}",
        ":{port}",
        "",
        "\xff\xfe:{port}",
    ],
)
def test_foreign_host_is_refused(open_page, host, websocket):
    """A name of somebody else's that was made to point here opens neither page nor websocket."""
    assert ask(open_page, f"Host: {host}", websocket=websocket)[0] == 403
    assert ask(open_page, "Host: localhost:{port}", f"Host: {host}", websocket=websocket)[0] == 403


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://evil.example:{port}",
        "null",
        "",
        "file://",
        "http://localhost",
        "http://localhost:{next}",
        "https://localhost:{port}",
        "http://localhost:{port}.evil.example",
        "http://localhost:{port}/",
        "http://localhost:{port}, http://evil.example",
        "http://127.0.0.1:{port}",
        "localhost:{port}",
    ],
)
def test_foreign_origin_is_refused(open_page, origin, websocket):
    """A page of another site opens nothing, though it names the right host; nor does one of another port."""
    assert ask(open_page, "Host: localhost:{port}", f"Origin: {origin}", websocket=websocket)[0] == 403
    own = "Origin: http://localhost:{port}"
    assert ask(open_page, "Host: localhost:{port}", own, f"Origin: {origin}", websocket=websocket)[0] == 403


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
def test_no_host_is_refused(open_page, websocket):
    """A request without a Host header is refused with status 403."""
    assert ask(open_page, "Accept: */*", websocket=websocket)[0] == 403


@pytest.mark.parametrize("websocket", [False, True], ids=["page", "websocket"])
@pytest.mark.parametrize(
    "host", ["localhost:{port}", "LocalHost:{port}", "127.0.0.1:{port}", "127.0.0.9:{port}", "[::1]:{port}"]
)
def test_own_names_are_served(open_page, host, websocket):
    """This machine's names open page and websocket, with the Origin that a browser sends, or as a program with none."""
    assert ask(open_page, f"Host: {host}", websocket=websocket)[0] == SERVED[websocket]
    status, _ = ask(open_page, f"Host: {host}", f"Origin: http://{host}", websocket=websocket)
    assert status == SERVED[websocket]


def test_refused_websocket_sees_nothing(viser):
    """A websocket client of a foreign Origin or Host gets no byte of the scene; one of the page's own gets it."""
    websockets = pytest.importorskip("websockets.sync.client")
    from websockets.exceptions import InvalidStatus

    def first_message(page, host, origin):
        port = page.server.get_port()
        with (
            socket.create_connection(("127.0.0.1", port)) as here,
            websockets.connect(
                f"ws://{host}:{port}", sock=here, origin=origin, subprotocols=[f"viser-v{viser.__version__}"],
                max_size=None, proxy=None,
            ) as client,
        ):  # fmt: skip
            return client.recv(timeout=30)

    with two_boxes() as page:
        assert len(first_message(page, "localhost", page.url)) > 1000
        assert len(first_message(page, "localhost", None)) > 1000
        for host, origin in (("localhost", "http://evil.example"), ("evil.example", None), ("localhost", "null")):
            with pytest.raises(InvalidStatus) as refused:
                first_message(page, host, origin)
            assert refused.value.response.status_code == 403


def test_token_for_others(capsys):
    """Where others can connect, nothing is served without the token; it is printed once, and new for each page."""
    with two_boxes(host="0.0.0.0") as page, two_boxes(host="0.0.0.0") as other:
        printed = capsys.readouterr().out
        address, token = re.fullmatch(r"(http://localhost:\d+)/\?token=([\w-]{32})", page.url).groups()
        assert printed.count(token) == 1
        (line,) = [line for line in printed.splitlines() if token in line]
        assert "any of this machine's addresses" in line
        assert "may see and move what is shown" in line
        cookie, host = f"Cookie: a=b; loewner-token-{page.server.get_port()}={{}}; c", "Host: 127.0.0.1:{port}"
        strange = other.url.partition("token=")[2]
        assert strange != token
        for websocket in (False, True):
            wrong = ["/?token=" + said for said in ("", token[:-1], token + "x", strange, "%00", "%ff")]
            for path in ("/", "/index.html", "//[", "/" + token, "/?Token=" + token, *wrong):
                assert ask(page, host, websocket=websocket, path=path)[0] == 403, path
            for said in ("", token[1:], strange, "\xff", '"'):
                assert ask(page, host, cookie.format(said), websocket=websocket)[0] == 403, said
            assert ask(page, host, f"Cookie: loewner-token-1={token}", websocket=websocket)[0] == 403
            assert ask(page, host, cookie.format(token), websocket=websocket)[0] == SERVED[websocket]
            for own in (
                host,
                "Host: localhost:{port}",
                "Host: 192.168.1.2:{port}",
                f"Host: {socket.gethostname()}:{{port}}",
            ):
                assert ask(page, own, websocket=websocket, path=f"/?token={token}")[0] == SERVED[websocket], own
            # The token alone does not let a page of another site in.
            for foreign in (
                ["Host: evil.example:{port}"],
                [host, "Origin: null"],
                [host, "Origin: http://evil.example"],
            ):
                assert ask(page, *foreign, cookie.format(token), websocket=websocket, path=f"/?token={token}")[0] == 403
        _, head = ask(page, host, path=f"/?x=1&token={token}")
        assert f"Set-Cookie: loewner-token-{page.server.get_port()}={token}; Path=/; HttpOnly; SameSite=Strict" in head
        assert address == f"http://localhost:{page.server.get_port()}"


def test_no_token_for_this_machine(capsys):
    """The page for this machine alone has a plain address, and sets no cookie."""
    with two_boxes(host="localhost") as page:
        assert page.url == f"http://localhost:{page.server.get_port()}"
        assert "Set-Cookie" not in ask(page, "Host: localhost:{port}")[1]
    assert "token" not in capsys.readouterr().out


def test_page_reaches_this_server_alone(open_page):
    """viser's page follows addresses in its own: the policy sent with it keeps it, and foreign frames, out."""
    head = ask(open_page, "Host: localhost:{port}")[1]
    policy = re.search(r"Content-Security-Policy: (.*)", head)[1]
    assert f"connect-src 'self' ws://localhost:{open_page.server.get_port()} data: blob:;" in policy
    assert "frame-ancestors 'self' http://localhost:* http://127.0.0.1:*" in policy


def test_ipv6():
    """A page at ::1 has an address that opens it."""
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("no IPv6 here")
    with two_boxes(host="::1") as page:
        assert page.url == f"http://[::1]:{page.server.get_port()}"
        for websocket in (False, True):
            asked = {"websocket": websocket, "address": "::1"}
            assert ask(page, "Host: [::1]:{port}", "Origin: " + page.url, **asked)[0] == SERVED[websocket]
            assert ask(page, "Host: evil.example:{port}", **asked)[0] == 403


def test_page_cannot_be_published(viser, open_page):
    """A client of viser's can ask the server to publish itself at an address of the internet; ours does not listen."""
    assert viser._messages.ShareUrlRequest not in open_page.server._websock_server._incoming_handlers


async def do_nothing(*_):
    pass


@pytest.mark.parametrize("change", ["guard is not asked", "viser is built otherwise", "websockets is built otherwise"])
def test_viser_that_cannot_be_guarded(viser, change, monkeypatch):
    """A viser in which the guard has no effect, or no place, is refused by its version, and its server is stopped."""
    if change == "guard is not asked":
        monkeypatch.setattr(guard, "_put", do_nothing)
    elif change == "viser is built otherwise":
        monkeypatch.delattr(viser.infra.WebsockMessageHandler, "unregister_handler")
    else:
        from websockets.asyncio.server import Server

        # Read when a connection is made, and not to be set from outside.
        monkeypatch.setattr(Server, "process_request", property(lambda _: None, lambda *_: None), raising=False)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    expected = rf"a viser that it can guard .*: expected one built like 1\.1, found {re.escape(viser.__version__)}"
    with pytest.raises(loewner.MissingExtraError, match=expected):
        two_boxes(port=port)
    socket.create_server(("127.0.0.1", port)).close()


@pytest.mark.parametrize(
    "host", [None, 3, True, b"127.0.0.1", ["127.0.0.1"], 10**400, "", "a\0b", "\ud800", "x" * 300, "[::1]", " "]
)
def test_host_that_is_no_address(host):
    """A host has to be text that can be an address or a name."""
    with pytest.raises(loewner.InputError, match="host: expected an address or the name of a host"):
        two_boxes(host=host)


@pytest.mark.parametrize(
    "port", [None, b"80", 10**400, 10**5000, -(10**5000), float("nan"), np.nan, [80], np.bool_(True), 1j], ids=type
)
def test_port_that_is_no_number(port):
    """A port that is no whole number, or far out of range, is refused."""
    with pytest.raises(loewner.InputError, match="port: expected a whole number"):
        two_boxes(port=port)


def test_host_of_another_machine():
    """An address that is none of this machine's is refused, not listened at for ever."""
    with pytest.raises(loewner.InputError, match=r"at 192\.0\.2\.1, could not have 0"):
        two_boxes(host="192.0.2.1")


# -- in a browser -----------------------------------------------------------------------------


@pytest.fixture
def tab(browser):
    """An empty page of the browser that notes where it asks for anything."""
    tab = browser.new_page(viewport=WINDOW)
    tab.set_default_timeout(PATIENCE)
    tab.asked = []
    tab.on("request", lambda request: tab.asked.append(request.url))
    yield tab
    tab.close()


def shown(tab, name):
    """Wait until the page's bar says so."""
    tab.locator('[data-loewner="verdict"]', has_text=name).wait_for()
    return tab.locator('[data-loewner="verdict"]').inner_text()


def pixel(tab, page, point):
    """Where a point of the world is in the browser's window."""
    (client,) = page.server.get_clients().values()
    camera = client.camera
    w, x, y, z = camera.wxyz
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    seen = R.T @ (np.asarray(point) - camera.position)
    # Not the camera's own size: the browser draws fewer pixels than its window has when it is slow.
    width, height = tab.viewport_size["width"], tab.viewport_size["height"]
    focal = height / 2 / np.tan(camera.fov / 2)
    return width / 2 + focal * seen[0] / seen[2], height / 2 + focal * seen[1] / seen[2]


def drag(tab, page, start, end):
    """Drag with the mouse from one point of the world to another."""
    tab.mouse.move(*pixel(tab, page, start))
    tab.mouse.down()
    tab.mouse.move(*pixel(tab, page, end), steps=8)
    tab.mouse.up()


def drag_to(tab, page, x):
    """Drag B by its arrow to x, again if a busy browser drew the arrow late and the mouse missed it."""
    end = time.monotonic() + PATIENCE / 1000
    while abs(page.T_world_b[0, 3] - x) >= 0.05:
        assert time.monotonic() < end, "the body did not follow the mouse"
        eventually(
            lambda: np.allclose(position(tab, "/B"), page.T_world_b[:3, 3], rtol=1e-7, atol=1e-9), PATIENCE / 1000
        )
        before, y = page.T_world_b[0, 3], page.T_world_b[1, 3]
        grip = np.array([before + 0.75 * page._movers["B"].gizmo.scale, y, 0.0])
        drag(tab, page, grip, grip + [x - before, 0.0, 0.0])
        arrived = time.monotonic() + 3.0
        while abs(page.T_world_b[0, 3] - x) >= 0.05 and time.monotonic() < arrived:
            time.sleep(0.01)


def panel(tab):
    """What the page's block of answers says, by row."""
    rows = "() => [...document.querySelectorAll('[data-loewner]')].map(e => [e.dataset.loewner, e.innerText])"
    return dict(tab.evaluate(rows))


def colours(tab):
    """Of the page's bar and of the bodies, as the browser has them; a bar that was replaced meanwhile has none."""
    bar = tab.locator('[data-loewner="verdict"]').evaluate("e => getComputedStyle(e).backgroundColor")
    tree = "name => window.__viserSceneTree.getState()[name].message.props.color"
    return tuple(int(c) for c in bar[4:-1].split(",") if c), *(tuple(tab.evaluate(tree, f"/{n}/pieces")) for n in "AB")


def position(tab, node):
    """Where the browser draws a node."""
    return tab.evaluate("name => window.__viserMutable.nodePoseData[name].position", node)


def says_what_the_library_says(tab, a, b, T):
    """Whether all numbers and words of the page are the library's, for b at T."""
    found, rows = loewner.distance(a, None, b, T, exact=True), panel(tab)
    if ("depth" if found.distance < 0 else "distance") not in rows:
        return False
    exact = "COLLIDING" if loewner.collide(a, None, b, T) else "FREE"
    numbers = [rows.get("distance", rows.get("depth")), *rows["bounds"].split(".. "), rows["estimate"]]
    expected = [abs(found.distance), found.lower, found.upper, found.estimate]
    points = [[float(x) for x in rows[key].split()] for key in ("on A", "on B", "normal")]
    return (
        rows["verdict"] == exact
        and rows["ellipsoids"].startswith(loewner.classify(a, None, b, T).name)
        and np.allclose([float(text.split()[0]) for text in numbers], expected, rtol=1e-5, atol=1e-9)
        and np.allclose(points, [found.witness_a, found.witness_b, found.normal], atol=1e-4)
    )


def test_dragging_a_body_in_the_browser(tab, tmp_path):
    """Dragged by its arrow from free over touching to colliding, and back.

    At each stop the page says what the library answers for the place where the browser draws the body: verdict, exact
    answer, distance, bounds, estimate, points and normal; the bar has the colour of the exact answer.
    """
    a, b, y = Body.box([1, 1, 1]), Body.box([1, 1, 1]), 0.6
    with viewer.show_pair(a, None, b, translation(2.2, y)) as page:
        tab.goto(page.url)
        assert shown(tab, "FREE") == "FREE"
        eventually(lambda: len(page.server.get_clients()) == 1, PATIENCE / 1000)
        # Faces touch at x = 1. With B to the side, the inner balls meet at 0.8 only and the outer ones at 1.62.
        for x, verdict, exact in (
            (1.2, "AMBIGUOUS", "FREE"),
            (0.88, "AMBIGUOUS", "COLLIDING"),
            (0.4, "COLLIDING", "COLLIDING"),
            (2.2, "FREE", "FREE"),
        ):
            drag_to(tab, page, x)
            eventually(lambda: says_what_the_library_says(tab, a, b, page.T_world_b), PATIENCE / 1000)
            assert (panel(tab)["ellipsoids"].partition(",")[0], panel(tab)["verdict"]) == (verdict, exact)
            np.testing.assert_allclose(page.T_world_b, translation(page.T_world_b[0, 3], y), atol=1e-9)
            eventually(
                lambda: np.allclose(position(tab, "/B"), page.T_world_b[:3, 3], rtol=1e-7, atol=1e-9), PATIENCE / 1000
            )
            wanted = (drawing.VERDICT_COLOURS[Verdict[exact]], *drawing.PAIR.values())
            eventually(lambda wanted=wanted: colours(tab) == wanted, PATIENCE / 1000)
        picture = tab.screenshot(path=tmp_path / "page.png", timeout=PATIENCE)
        assert len(picture) > 10_000
        assert all(url.startswith((page.url, "blob:" + page.url)) for url in tab.asked), tab.asked


def test_robot_in_the_browser(tab, arm):
    """The slider's number field turns the arm into the wall, and the page names the pair."""
    with viewer.show_robot(arm) as page:
        tab.goto(page.url)
        assert shown(tab, "FREE") == "FREE"
        field = tab.locator("input.mantine-NumberInput-input").first
        field.fill("1.5")
        field.press("Enter")
        shown(tab, "COLLIDING")
        assert arm.collide([1.5, 0.0])
        tab.locator('[data-loewner="note"]', has_text="wall/left").first.wait_for()
        assert page.q.tolist() == [1.5, 0.0]
        tab.get_by_text("random configuration").click()
        eventually(lambda: page.q.tolist() != [1.5, 0.0], PATIENCE / 1000)
        shown(tab, "COLLIDING" if arm.collide(page.q) else "FREE")


def test_trajectory_in_the_browser(tab, arm):
    """The button plays it to its end, where the page names the pair that collides."""
    moved = planners.trajectory(arm.robot, [[0.0, 0.0], [1.5, 0.0]], velocity=4.0, acceleration=16.0)
    with viewer.show_robot(arm, trajectory=moved) as page:
        tab.goto(page.url)
        assert shown(tab, "FREE") == "FREE"
        tab.get_by_role("button", name="play").click()
        eventually(lambda: page.time == moved.duration, PATIENCE / 1000)
        tab.locator('[data-loewner="note"]', has_text="wall/left").first.wait_for()
        assert page.q.tolist() == [1.5, 0.0]


def drawn(tab):
    """What the window shows once it has drawn all that it was sent, shape (height, width, 3)."""
    before = None
    for _ in range(20):
        tab.wait_for_timeout(500)
        now = tab.screenshot(timeout=PATIENCE)
        if now == before:
            break
        before = now
    return np.asarray(Image.open(io.BytesIO(now)).convert("RGB")).astype(int)


def where_pieces_are(tab, page):
    """Lowest and highest column and row of the pixels that change when the page's pieces are hidden.

    The grid stays as it is; so does the panel, but for the tick of the check box.
    """
    before = drawn(tab)
    tab.get_by_label(drawing.LABELS["pieces"], exact=True).uncheck()
    eventually(lambda: not page._layers["pieces"].value, PATIENCE / 1000)
    changed = np.abs(before - drawn(tab)).max(axis=2) > 24
    changed[:, panel_left(tab) :] = False
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    return columns[0], columns[-1], rows[0], rows[-1]


def panel_left(tab):
    """Where the page's panel begins, in pixels."""
    box = tab.locator('[data-loewner="verdict"]').bounding_box()
    return int(box["x"]) - 20


def fills_the_window(tab, page):
    """Whether nothing is cut off or behind the panel, and what is shown is not lost in the window either."""
    left, right, top, bottom = where_pieces_are(tab, page)
    height = tab.viewport_size["height"]
    assert 0 < left < right < panel_left(tab) - 1, (left, right, panel_left(tab))
    assert 0 < top < bottom < height - 1, (top, bottom, height)
    assert max(bottom - top, right - left) > 0.3 * height, (left, right, top, bottom)


@pytest.mark.parametrize("size", [0.01, pytest.param(30.0, marks=pytest.mark.verify)])
def test_the_browser_opens_with_two_bodies_in_the_frame(tab, size):
    """Whatever their size: all their pixels are in the window, left of the panel."""
    with viewer.show_pair(
        Body.box([size] * 3), None, Body.box([size] * 3), translation(2.2 * size, 0.6 * size)
    ) as page:
        tab.goto(page.url)
        shown(tab, "FREE")
        fills_the_window(tab, page)


def test_the_browser_opens_with_the_robot_in_the_frame(tab, arm):
    """And with what stands near it; a floor of a hundred metres is left out."""
    arm.scene.add("floor", Body.box([100.0, 100.0, 0.1]), translation(0.0, 0.0, -0.2))
    with viewer.show_robot(arm) as page:
        arm.scene.remove("floor")
        page.refresh()
        tab.goto(page.url)
        shown(tab, "FREE")
        fills_the_window(tab, page)


FAULTS = """() => {
  const faults = [], shown = e => { const r = e.getBoundingClientRect(); return r.width > 0 && r.height > 0; };
  const panel = document.querySelector('[data-loewner="verdict"]').closest('.mantine-Paper-root');
  const all = 'input:not([type=hidden]), button, label, th, [data-loewner], '
    + '.mantine-Slider-root, .mantine-Slider-thumb, .mantine-Slider-markLabel';
  const parts = [...panel.querySelectorAll(all)].filter(shown).map(e => [e, e.getBoundingClientRect()]);
  const named = e => `${e.tagName} ${e.dataset.loewner ?? e.value ?? ''} ${e.innerText ?? ''}`;
  const frame = panel.getBoundingClientRect();
  for (const [k, [e, r]] of parts.entries()) {
    const inline = getComputedStyle(e).display === 'inline' || e.matches('.mantine-Slider-root, .mantine-Slider-thumb');
    if (!inline && e.scrollWidth > e.clientWidth + 1)
      faults.push(`cut off: ${named(e)}`);
    if (r.left < frame.left - 1 || r.right > frame.right + 1) faults.push(`outside the panel: ${named(e)}`);
    for (const [f, s] of parts.slice(k + 1))
      if (!e.contains(f) && !f.contains(e) && Math.min(r.right, s.right) - Math.max(r.left, s.left) > 1
          && Math.min(r.bottom, s.bottom) - Math.max(r.top, s.top) > 1)
        faults.push(`over each other: ${named(e)}, ${named(f)}`);
  }
  const fields = panel.querySelectorAll('input.mantine-NumberInput-input').length;
  const bar = document.querySelector('[data-loewner="verdict"]'), b = bar.getBoundingClientRect();
  if (document.elementFromPoint((b.left + b.right) / 2, (b.top + b.bottom) / 2) !== bar) faults.push('hidden verdict');
  const c = document.querySelector('canvas[data-engine]').getBoundingClientRect();
  const free = (innerWidth <= 576 ? frame.top - c.top : c.height) * (innerWidth <= 576 ? c.width : frame.left - c.left);
  if (free < 0.45 * innerWidth * innerHeight || (innerWidth <= 576 && c.bottom > frame.top + 1))
    faults.push('too little of the scene is seen');
  if (document.documentElement.scrollWidth > innerWidth) faults.push('the window scrolls sideways');
  return [fields, faults];
}"""


def of_two_pieces(arm):
    """Two convex bodies at positions with many digits."""
    pieces = Body.from_points(np.random.default_rng(3).normal(size=(30, 3)) * [0.3, 0.2, 0.2])
    return viewer.show_pair(pieces, None, Body.capsule(0.12, 0.5), translation(-1.6543, 0.2078, -0.33042)), "FREE"


def of_two_surfaces(arm):
    """Surfaces in collision that their ellipsoids leave open."""
    trimesh = pytest.importorskip("trimesh")
    ring, ball = trimesh.creation.torus(1.0, 0.3), trimesh.creation.icosphere(2, 0.3)
    T = translation(1.4, 0.2078, 0.4)
    page = viewer.show_pair(Body.from_surface(ring), None, Body.from_surface(ball), T, mesh_a=ring)
    assert page.verdict == Verdict.AMBIGUOUS
    return page, "COLLIDING"


def of_a_panda(arm):
    """A Panda in its state, with long names and values, among obstacles."""
    robots_folder()
    script = runpy.run_path(str(Path(__file__).parents[1] / "docs/images/pages.py"))
    return viewer.show_robot(CollisionChecker(script["panda"](), script["furnished"]())), "FREE"


def of_a_moving_arm(arm):
    """A trajectory in the middle of its way, past a body that moves."""
    arm.scene.follow("<b>ball</b>", [0.0, 5.0], np.stack([translation(-1.2), translation(-1.2, 2.0)]))
    page = viewer.show_robot(
        arm, trajectory=planners.trajectory(arm.robot, [[0.1, -1.5], [-0.2, 1.23456]], velocity=0.5)
    )
    page.time = 0.543
    eventually(lambda: page._proof is not None)
    return page, "FREE"


@pytest.mark.parametrize("scene", [of_two_pieces, of_two_surfaces, of_a_panda, of_a_moving_arm])
def test_everything_on_the_page_can_be_read(tab, arm, scene, tmp_path):
    """In wide and narrow windows, light and dark, nothing is cut off, covers something or loads from elsewhere.

    The verdict and most of the scene are seen at once. Pictures are in the test's folder.
    """
    page, verdict = scene(arm)
    with page:
        for width, height, mode in ((1280, 800, "light"), (400, 720, "light"), (400, 720, "dark")):
            tab.set_viewport_size({"width": width, "height": height})
            if tab.url == "about:blank" or mode == "dark":
                tab.emulate_media(color_scheme=mode)
                tab.goto(page.url)
            assert shown(tab, verdict) == verdict
            for _ in range(20):  # viser folds its settings away when the page has been loaded
                tab.wait_for_timeout(500)
                fields, faults = tab.evaluate(FAULTS)
                if fields >= 2 and not faults:
                    break
            assert fields >= 2
            assert faults == []
            scheme = tab.evaluate("document.documentElement.dataset.mantineColorScheme")
            assert scheme == mode
            picture = tab.screenshot(path=tmp_path / f"{scene.__name__}_{width}_{mode}.png", timeout=PATIENCE)
            assert len(picture) > 10_000
        assert all(url.startswith((page.url, "blob:" + page.url, "data:")) for url in tab.asked), tab.asked


def test_without_the_style_numbers_are_cut_off(tab, arm, monkeypatch):
    """The test above finds the faults of viser's own panel: cut numbers, and no room for the scene."""
    monkeypatch.setattr(guard, "HEAD", "")
    page, verdict = of_two_pieces(arm)
    with page:
        tab.set_viewport_size({"width": 400, "height": 720})
        tab.goto(page.url)
        shown(tab, verdict)
        faults = tab.evaluate(FAULTS)[1]
        assert any(fault.startswith("cut off: INPUT -1.6543") for fault in faults), faults
        assert "too little of the scene is seen" in faults


def test_accessibility(tab, arm):
    """axe finds no fault in contrast, names and structure, but that viser's page has no heading of the first level."""
    try:
        from axe_playwright_python.sync_playwright import Axe
    except ImportError:
        missing("no axe: pip install -r requirements/dev.txt")
    page, verdict = of_a_moving_arm(arm)
    with page:
        for mode in ("light", "dark"):
            tab.emulate_media(color_scheme=mode)
            tab.goto(page.url)
            shown(tab, verdict)
            tab.wait_for_timeout(1000)
            found = Axe().run(tab).response["violations"]
            assert {fault["id"] for fault in found} <= {"page-has-heading-one"}, found


def test_the_slider_of_a_path_in_the_browser(tab, arm):
    """With each press of a key the robot is farther along, and the page says what the library does for it there."""
    rows = [[0.0, 0.0], [1.5, 0.0]]
    with viewer.show_robot(arm, path=rows) as page:
        tab.goto(page.url)
        assert shown(tab, "FREE") == "FREE"
        assert "colliding" in panel(tab)["along"]
        thumb = tab.get_by_role("slider").first
        thumb.focus()
        for key, low in (("ArrowRight", 0.0), ("End", 1.5)):
            thumb.press(key)
            eventually(lambda low=low: page.time > 0 and page.q[0] >= low, PATIENCE / 1000)
            np.testing.assert_allclose(page.q, page._way.positions(page.time))
            expected = arm.robot.forward_kinematics(page.q)[arm.robot.link_names.index("fore"), :3, 3]
            node = f"/robot/{arm.robot.link_names.index('fore')}"
            eventually(lambda node=node, at=expected: np.allclose(position(tab, node), at), PATIENCE / 1000)
            value = arm.distance(page.q, exact=True).distance
            word = "depth" if value < 0 else "clearance"
            tab.locator(f'[data-loewner="{word}"]', has_text=length_text(abs(value))).wait_for()
        assert shown(tab, "COLLIDING") == "COLLIDING"
        assert page.time == page._way.duration


def test_a_cloud_in_the_browser(tab, rng):
    """Its points are drawn where they are, in the colour of the verdict, and a ball in the middle of them is found."""
    points = rng.uniform(-0.5, 0.5, size=(3000, 3))
    points = points[np.abs(points).max(axis=1) > 0.4]  # the faces of a cube
    cloud = Body.from_cloud(points, radius=0.02)
    with viewer.show_pair(cloud, None, Body.sphere(0.2), None) as page:
        tab.goto(page.url)
        shown(tab, "FREE")
        left, right, top, bottom = where_pieces_are(tab, page)
        for corner in np.array(list(itertools.product((-0.4, 0.4), repeat=3))):
            x, y = pixel(tab, page, corner)
            assert left < x < right, (corner, x, left, right)
            assert top < y < bottom, (corner, y, top, bottom)
        page.T_world_b = translation(0.45, 0.0)
        shown(tab, "COLLIDING")


def test_command_line_serves_a_page(tab, tmp_path):
    """`loewner view A B` prints an address and nothing else, and the browser finds the verdict there."""
    paths = [tmp_path / "a.npz", tmp_path / "b.npz"]
    for path in paths:
        Body.box([1, 1, 1]).save(path)
    command = [sys.executable, "-m", "loewner", "view", *paths, "--pose-b", "1.3 0 0", "--no-browser"]
    source = Path(loewner.__file__).parents[1]
    # A program that was started in the background ignores Ctrl+C, and so would those that it starts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(source)},
    ) as process:
        signal.signal(signal.SIGINT, before)
        try:
            url = process.stdout.readline().split()[0]
            tab.goto(url)
            assert shown(tab, "FREE") == "FREE"
            assert panel(tab)["ellipsoids"].startswith("AMBIGUOUS")
            tab.close()
            process.send_signal(signal.SIGINT)
            assert process.communicate(timeout=60) == ("", "")
        finally:
            process.terminate()


EVIL = """
<!doctype html><iframe src="{url}"></iframe><script>
  const found = {{}};
  const socket = new WebSocket("{ws}", ["viser-v{version}"]);
  socket.onopen = () => found.websocket = "open";
  socket.onclose = () => found.websocket ??= "refused";
  fetch("{url}").then(r => r.text()).then(t => found.page = "read", () => found.page = "refused");
</script>
"""


@contextmanager
def site(html):
    """Serve a page of another site; gives its port and the list of what was asked of it."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append((self.path, self.headers.get("Upgrade")))
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(html.encode())

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_port, asked
        finally:
            server.shutdown()


def test_another_site_in_the_browser(tab, viser):
    """A page of another site, in the same browser, gets no websocket, cannot read the page and cannot frame it.

    Nor does it when its own name is made to point to the page's server.
    """
    with two_boxes() as page:
        ws = page.url.replace("http", "ws")
        with site(EVIL.format(url=page.url, ws=ws, version=viser.__version__)) as (port, asked):
            tab.goto(f"http://evil.example:{port}/")
            tab.wait_for_function("() => found.websocket && found.page", timeout=PATIENCE)
            assert tab.evaluate("found") == {"websocket": "refused", "page": "refused"}
            assert asked
            assert tab.frames[1].url.startswith("chrome-error:")
        rebound = tab.goto(f"http://evil.example:{page.server.get_port()}/")
        assert rebound.status == 403
        assert "expected a Host of this server" in tab.content()
        time.sleep(0.5)
        assert len(page.server.get_clients()) == 0
        tab.close()  # with its spare connections, which the server would wait for


@pytest.mark.parametrize("end", ["websocket=ws://localhost:{}", "playbackPath=http://localhost:{}/x.viser"])
def test_link_cannot_lead_the_page_astray(tab, end, monkeypatch):
    """viser's page connects to what its address names, and shows what it finds there as its own; ours does not.

    Left to itself it connects within some time; with the policy sent with it, it has not after twice that time.
    """
    with two_boxes() as page, site("") as (port, asked):
        took = []
        for policy in (False, True):
            with monkeypatch.context() as patch:
                if not policy:
                    patch.setattr(guard.Guard, "admit", lambda *_: None)
                started = time.monotonic()
                tab.goto(f"{page.url}/?{end.format(port)}")
                while not asked and time.monotonic() < started + (2 * took[0] + 1 if policy else PATIENCE / 1000):
                    tab.wait_for_timeout(50)
                took.append(time.monotonic() - started)
            assert bool(asked) != policy, asked
            tab.goto("about:blank")
            tab.wait_for_timeout(300)
            asked.clear()


@pytest.mark.parametrize("host", ["0.0.0.0", pytest.param("::1", marks=pytest.mark.verify)])
def test_page_with_token_in_the_browser(browser, host):
    """The browser shows the page at the address given, again without its token, and not to who never had it."""
    context, stranger = browser.new_context(viewport=WINDOW), browser.new_context(viewport=WINDOW)
    try:
        with two_boxes(host=host) as page:
            tab = context.new_page()
            tab.goto(page.url, timeout=PATIENCE)
            tab.locator('[data-loewner="verdict"]', has_text="FREE").wait_for(timeout=PATIENCE)
            assert tab.get_by_text("Share").count() == 0
            bare = page.url.partition("/?")[0]
            tab.goto(bare + "/", timeout=PATIENCE)
            tab.locator('[data-loewner="verdict"]', has_text="FREE").wait_for(timeout=PATIENCE)
            met = stranger.new_page().goto(bare + "/", timeout=PATIENCE)
            assert met.status == (403 if "token" in page.url else 200)
    finally:
        context.close()
        stranger.close()


# -- what the page starts with ------------------------------------------------------------------------


def test_the_camera_starts_with_what_is_shown() -> None:
    """At a distance in proportion to the bodies, and on a grid whose cells are round numbers."""
    for size in (0.01, 1.0, 30.0):
        T = translation(2.2 * size, 0.6 * size)
        with viewer.show_pair(Body.box([size] * 3), None, Body.box([size] * 3), T) as page:
            camera = page.server.initial_camera
            away = np.linalg.norm(np.subtract(camera.position, camera.look_at))
            assert 1.5 * size < away < 10 * size
            assert page._movers["B"].gizmo.scale == pytest.approx(0.7 * size, rel=0.5)
    assert [framing.round_length(x) for x in (0.9, 1.0, 4.9, 60.0, 0.0021)] == pytest.approx([0.5, 1, 2, 50, 0.002])


def test_clouds_are_drawn_as_points(rng) -> None:
    """Not as triangles that have no area; unions of many balls as copies of one."""
    points = rng.uniform(size=(1000, 3))
    (cloud,) = drawing.parts(Body.from_cloud(points, radius=0.02))
    assert isinstance(cloud, drawing.Points)
    assert (len(cloud.points), cloud.radius) == (1000, 0.02)
    np.testing.assert_allclose(cloud.box(np.eye(4)), [points.min(axis=0) - 0.02, points.max(axis=0) + 0.02])
    balls = drawing.parts(Body.union([Body.spheres(points, 0.01), Body.box([1, 1, 1])]))
    assert sorted(type(part).__name__ for part in balls) == ["Copies", "Triangles"]


def test_a_path_is_played_at_an_even_pace(arm) -> None:
    """From its first row to its last; with a bar that says where it collides, looked at many times."""
    robot = arm.robot
    rows = robot.random_configurations(4, 0)
    way = playing.Path(robot, rows)
    np.testing.assert_allclose(way.positions(0.0), rows[0])
    np.testing.assert_allclose(way.positions(way.duration), rows[-1])
    times = np.linspace(0.0, way.duration, 50)
    steps = robot.distances(way.positions(times[:-1]), way.positions(times[1:]))
    assert (steps <= way.duration / 49 * (1 + 1e-9)).all()
    with pytest.raises(InputError, match="expected seconds"):
        way.positions(-1.0)
    checker = CollisionChecker(robot, Scene())
    found = playing.found_along(checker, way)
    looked = checker.collide(way.positions(np.linspace(0.0, way.duration, len(found))))
    assert (found == np.where(looked, playing.COLLIDING, playing.FREE)).all()
    assert "201 samples" in playing.sampled_strip(found, way.duration)
    with viewer.show_robot(checker, path=rows) as page:
        page.time = way.duration / 2
        np.testing.assert_allclose(page.q, way.positions(way.duration / 2), atol=1e-9)
    with pytest.raises(InputError, match="found both"):
        viewer.show_robot(checker, path=rows, trajectory=rows)


def test_a_screenshot_without_a_window(browser, tmp_path, capsys) -> None:
    """Of the command line, with a cloud in the picture; and names that are none."""
    rng = np.random.default_rng(0)
    Body.from_cloud(rng.uniform(size=(2000, 3)), radius=0.01).save(tmp_path / "cloud.npz")
    Body.box([0.2, 0.2, 0.2]).save(tmp_path / "box.npz")
    names = [str(tmp_path / name) for name in ("cloud.npz", "box.npz", "out.png")]
    done = subprocess.run(
        [sys.executable, "-m", "loewner", "view", *names[:2], "--screenshot", names[2]],
        capture_output=True, text=True, timeout=180,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    picture = (tmp_path / "out.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 20_000
    red, green, blue = np.moveaxis(np.asarray(Image.open(tmp_path / "out.png").convert("RGB")).astype(int), -1, 0)
    handles = (red > 220) & (green < 90) & (blue < 150)
    assert not handles[:600].any()  # below is the logo
    with viewer.show_pair(Body.sphere(1.0), None, Body.sphere(1.0), translation(3.0, 0.0)) as page:
        for bad in ({"path": "out.jpg"}, {"path": tmp_path / "a.png", "width": 10}):
            with pytest.raises(InputError, match="path|width"):
                viewer.save_screenshot(page, **bad)
    with pytest.raises(InputError, match="expected an open page"):
        viewer.save_screenshot("page", tmp_path / "a.png")


@pytest.mark.parametrize("name", ["arm", *(pytest.param(k, marks=pytest.mark.verify) for k in ("viewer", "cloud"))])
def test_the_pictures_of_the_docs_are_what_the_page_shows(browser, name) -> None:
    """Made again by their script: at a twentieth of the size hardly any pixel differs, whatever the fonts."""
    robots_folder()
    script = runpy.run_path(str(Path(__file__).parents[1] / "docs/images/pages.py"))
    kept = Image.open(Path(script["__file__"]).with_name(f"{name}.png"))
    made = script["draw"](name)
    assert made.size == kept.size
    small = [
        np.asarray(p.convert("RGB").resize((p.width // 20, p.height // 20), Image.Resampling.BOX)).astype(int)
        for p in (made, kept)
    ]
    differ = np.abs(small[0] - small[1]).max(axis=2)
    assert np.mean(differ > 24) < 0.01, differ.mean()
