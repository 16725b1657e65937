"""What a page of the viewer shows is what the library answers; it follows Python, sliders, paths and scenes."""

import dataclasses
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import loewner
from families import translation
from loewner import Body, CollisionChecker, InputError, Robot, Scene, Verdict, cli, planners, viewer
from loewner.viewer import drawing, framing, playing
from loewner.viewer.visuals import visual_meshes
from viewer_pages import eventually, two_boxes


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
        page._marks["near"].value = False
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


@pytest.mark.verify
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
        eventually(lambda: "proof: collides within" in page._proof_strip.content)  # drawn after the proof is kept
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
        eventually(lambda: "proof: free at every instant" in page._proof_strip.content)


def test_what_is_proven_along_a_path(arm):
    """A path without times is proven in parts: all that are free, and none in which a sample collides."""
    rows = np.array([[0.0, 0.0], [0.5, 0.0], [1.5, 0.0], [1.5, 0.0], [0.5, 1.0]])
    with viewer.show_robot(arm, path=rows) as page:
        eventually(lambda: page._proof is not None)
        times, verdicts, _ = page._proof
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
            "none.csv: expected points of a trajectory, but there is no such file",
        ),
        (
            ["--robot", "arm.urdf", "--trajectory", "other.csv"],
            "trajectory: expected the joints shoulder, elbow, found the unknown a",
        ),
        (["part.npz", "part.npz", "--port", "70000"], "port: expected an integer"),
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
    Path("other.csv").write_text("time,a\n0,0\n1,1\n")
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
    assert (found == np.where(looked, Verdict.COLLIDING, Verdict.FREE)).all()
    assert "201 samples" in playing.sampled_strip(found, way.duration)
    with viewer.show_robot(checker, path=rows) as page:
        page.time = way.duration / 2
        np.testing.assert_allclose(page.q, way.positions(way.duration / 2), atol=1e-9)
    with pytest.raises(InputError, match="found both"):
        viewer.show_robot(checker, path=rows, trajectory=rows)


def test_the_verdict_on_the_page_is_the_paths(arm) -> None:
    """Green means that every moment is proven free: not before the proof, and not for a path that collides later."""

    def shown(page):
        return re.search(r'data-loewner="verdict"[^>]*>([^<]*)<', page._verdict.content)[1]

    rows = [[0.0, 0.0], [0.5, 0.0], [1.5, 0.0]]
    with viewer.show_robot(arm, path=rows) as page:
        assert (page.colliding, page.path_verdict, shown(page)) == (False, Verdict.COLLIDING, "COLLIDING")
        assert re.search(r'data-loewner="here"[^>]*>FREE<', page._verdict.content)
        t = page.go_to_worst()
        assert page.colliding
        assert page.time == t
        distances = arm.distance(page._way.positions(np.linspace(0.0, page._way.duration, 999)), exact=True).distance
        assert page.bounds.distance <= distances.min() + 1e-3
        page.q = [0.1, 0.2]  # not on the path
        assert (page.path_verdict, shown(page)) == (None, "FREE")
    with viewer.show_robot(arm, path=rows[:2]) as page:
        with page.lock:
            if page._proof is None:
                assert (page.path_verdict, shown(page)) == (Verdict.AMBIGUOUS, "AMBIGUOUS")
        with page._without_gizmos():  # as for a picture
            assert (page.path_verdict, shown(page)) == (Verdict.FREE, "FREE")
    with viewer.show_robot(arm) as page:
        assert (page.path_verdict, shown(page)) == (None, "FREE")
        with pytest.raises(InputError, match="page: expected one with a path"):
            page.go_to_worst()


def test_curves_of_controllers_are_played(arm) -> None:
    """Points with velocities are joined by cubic polynomials, which the page plays and proves at their own times."""
    t, x, v = np.array([1.0, 2.0, 4.0]), np.array([[0.0, 0.0], [0.5, 0.4], [0.2, 1.0]]), np.full((3, 2), 0.1)
    points = planners.ControllerPoints(t, x, v, names=arm.robot.configuration_names, start_time=5.0)
    way = playing.Executed(arm.robot, points)
    spline = CubicHermiteSpline(t, x, v)
    assert (way.start_time, way.duration) == (6.0, 3.0)
    at = np.linspace(0.0, 3.0, 40).reshape(4, 10)
    np.testing.assert_allclose(way.positions(at), spline(1.0 + at), atol=1e-12)
    np.testing.assert_allclose(way.positions(3.0), x[-1], atol=1e-12)
    with pytest.raises(InputError, match="t: expected seconds from 0 to 3"):
        way.positions(3.1)
    proof = playing.proven_along(arm, way)
    found = arm.certify_trajectory(points)
    np.testing.assert_array_equal(proof.times, found.times - 6.0)
    np.testing.assert_array_equal(proof.verdicts, found.segments.verdict)
    with viewer.show_robot(arm, trajectory=points) as page:
        page.time = 1.5
        np.testing.assert_allclose(page.q, spline(2.5), atol=1e-12)


def test_the_command_line_plays_all_files_of_audit(arm, tmp_path, monkeypatch) -> None:
    """Points of a table and of messages, in parts and with bodies that the robot carries and puts down."""
    monkeypatch.chdir(tmp_path)
    seen = {}

    class Page:
        url, time = "", None

        def go_to_worst(self):
            seen["worst"] = True

        def wait(self):
            pass

    def show(checker, *, port, **given):
        seen.update(checker=checker, page=Page(), **given)
        return seen["page"]

    monkeypatch.setattr(viewer, "show_robot", show)
    scene = Scene()
    scene.add("cup", Body.sphere(0.05), translation(5.0))
    scene.add("post", Body.sphere(0.05), translation(9.0))
    loewner.save_scene(scene, "scene.yaml")
    names = arm.robot.configuration_names
    Path("moves.csv").write_text(f"# start_time: 2\ntime,{','.join(names)}\n0,0,0\n1,0.5,0.2\n")
    rows = [[0.0, 0.0], [0.5, 0.0]]
    parts = [
        {"joint_names": list(names), "points": [{"positions": q, "time_from_start": t} for t, q in enumerate(ends)]}
        for ends in (rows, rows[::-1])
    ]
    message = {"trajectory": [{"joint_trajectory": part} for part in parts]}
    Path("moves.json").write_text(json.dumps(message))
    view = ["view", "--robot", "arm.urdf", "--no-browser", "--scene", "scene.yaml", "--trajectory"]

    assert cli.main([*view, "moves.csv", "--at", "0.5"]) == 0
    assert seen["trajectory"].start_time == 2.0
    assert seen["page"].time == 0.5
    assert cli.main([*view, "moves.csv", "--start-time", "7", "--at", "worst"]) == 0
    assert seen["trajectory"].start_time == 7.0
    assert seen["worst"]

    link = arm.robot.link_names[-1]
    assert cli.main([*view, "moves.json"]) == 2
    assert cli.main([*view, "moves.json", "--part", "2", "--attach", f"1:cup={link}"]) == 0
    assert not seen["checker"].scene.attachments
    moved = arm.robot.forward_kinematics(rows)[:, -1]
    wanted = moved[1] @ np.linalg.inv(moved[0]) @ translation(5.0)
    np.testing.assert_allclose(seen["checker"].scene.pose("cup"), wanted, atol=1e-12)
    assert seen["trajectory"].start_time == 1.0
    assert cli.main([*view, "moves.json", "--part", "2", "--attach", f"2:cup={link}"]) == 0
    assert seen["checker"].scene.attachments["cup"].link == link


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--trajectory", "moves.csv", "--at", "best"], "--at: expected seconds or \"worst\", found 'best'"),
        (["--trajectory", "moves.csv", "--at", "9"], "t: expected seconds from 0 to 1"),
        (["--trajectory", "moves.csv", "--part", "2"], "--part: expected one of the 1 trajectories"),
        (["--at", "worst"], "expected --at with --trajectory only"),
        (["--attach", "cup=hand"], "expected --attach with --trajectory only"),
    ],
)
def test_options_of_trajectories(arguments, expected, arm, tmp_path, monkeypatch, capsys) -> None:
    """An option without an effect, and a time beside the path, are refused."""
    monkeypatch.chdir(tmp_path)
    Path("moves.csv").write_text(f"time,{','.join(arm.robot.configuration_names)}\n0,0,0\n1,0.5,0.2\n")
    assert cli.main(["view", "--robot", "arm.urdf", "--no-browser", *arguments]) == 2
    assert expected in capsys.readouterr().err
