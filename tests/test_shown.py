"""Pictures in notebooks show what is there and never fail; texts are short; the logger is silent."""

import ast
import base64
import importlib
import inspect
import io
import json
import logging
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import ConvexHull

import loewner
from families import translation
from gantry import LEFT, RIGHT, beside_a_post
from loewner import Bodies, Body, Scene, planners
from loewner._base import _log, _pictures
from loewner._base._pictures import Shape

NOTEBOOK = Path(__file__).parents[1] / "examples" / "first_steps.ipynb"
RNG = np.random.default_rng(2)


def hull(count=20):
    return Body.from_points(RNG.normal(size=(count, 3)))


def cloud():
    return Body.from_cloud(RNG.normal(size=(500, 3)), radius=0.02)


@pytest.fixture
def shown(tmp_path):
    """Something of every kind that shows itself, by name."""
    checker = beside_a_post(tmp_path)
    Q = checker.robot.random_configurations(300)
    held = checker.scene
    held.add("tool <b>&</b>", Body.capsule(radius=0.02, length=0.1))
    held.attach("tool <b>&</b>", "rod")
    held.add("cart", Body.cone(radius=0.1, length=0.2))
    held.follow("cart", [0.0, 1.0], np.stack([translation(3.0), translation(2.0)]))
    moved = planners.trajectory(checker.robot, np.stack([LEFT, RIGHT]), velocity=1.0, acceleration=2.0)
    still = Scene()
    still.add("globe", Body.sphere(0.3), translation(1.0))
    fixed = loewner.CollisionChecker(checker.robot, still)
    points = planners.ControllerPoints([0.0, 1.0, 2.0], [LEFT, RIGHT, LEFT], np.zeros((3, 3)))
    return {
        "body": hull(), "cloud": cloud(), "union": Body.union([Body.cylinder(radius=0.1, length=1.0), hull()]),
        "surface": Body.from_surface(trimesh.creation.icosphere(1)), "robot": checker.robot, "scene": held,
        "checker": checker, "tiers": fixed.tiers(Q), "motions": fixed.certify_edges(Q[:-1], Q[1:]),
        "motion": fixed.certify_edges(LEFT, RIGHT), "trajectory": moved, "points": points,
        "certified": fixed.certify_trajectory(points),
    }  # fmt: skip


def svg_of(html):
    return ET.fromstring(re.search(r"<svg.*</svg>", html, flags=re.S)[0])


def image_of(html):
    """The drawing of bodies, as red, green, blue and opacity."""
    found = re.search(r"data:image/png;base64,([^\"]+)", html)[1]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found))).convert("RGBA"))


def test_pictures_are_complete_and_small(shown):
    """Each is valid, below 60 kB, without scripts or requests, in the colours of the page, and begins with the text."""
    for name, thing in shown.items():
        html = thing._repr_html_()
        assert len(html) < 60_000, name
        whole = ET.fromstring(html)
        svg_of(html)
        assert repr(thing) in "".join(whole.itertext()), name
        assert set(re.findall(r"\w+://[^\"' )]+", html)) <= {"http://www.w3.org/2000/svg"}, name
        assert not re.search(r"<script|javascript|\son\w+=|background", html), name


def test_names_are_text(shown):
    """The name of a body is not HTML."""
    html = shown["checker"]._repr_html_()
    assert "tool &lt;b&gt;&amp;&lt;/b&gt;" in html
    assert "<b>" not in html
    assert "1 of 3 bodies are not drawn" in shown["scene"]._repr_html_()


def test_failure_leaves_the_text(shown, monkeypatch, caplog):
    """If drawing fails, the text remains; the reason is in the log."""
    caplog.set_level(logging.DEBUG, "loewner")
    for name in ("_svg", "_png"):
        monkeypatch.setattr(_pictures, name, None)
    for thing in shown.values():
        html = thing._repr_html_()
        assert html.startswith("<pre")
        assert "".join(ET.fromstring(html).itertext()) == repr(thing)
    assert len(caplog.records) == len(shown)


def test_nothing_to_draw():
    """A scene without bodies is only its text."""
    assert "<svg" not in Scene()._repr_html_()


@pytest.mark.parametrize("made", [hull, lambda: Body.box([1, 2, 3]), lambda: Body.cone(radius=1.0, length=3.0)])
def test_silhouette(made):
    """A convex body covers the area of its projection, within a pixel along the border; around it nothing is drawn."""
    body = made()
    html = body._repr_html_()
    corners = loewner.bodies.for_pictures(loewner.bodies.packed_of(body)).corners.reshape(-1, 3)
    flat = ConvexHull(corners @ _pictures._VIEW[:2].T)
    image = image_of(html)
    rows, columns = np.nonzero(image[..., 3])
    scale = np.ptp(rows) / np.ptp(flat.points[:, 1])
    assert scale == pytest.approx(np.ptp(columns) / np.ptp(flat.points[:, 0]), rel=0.02)
    assert len(rows) == pytest.approx(flat.volume * scale**2, abs=1.5 * flat.area * scale)
    assert set(np.unique(image[..., 3])) == {0, 255}


def test_nearest_body_is_seen():
    """Of two balls in the line of sight the nearer one is seen, in whichever order they are."""
    ball = loewner.bodies.for_pictures(loewner.bodies.packed_of(Body.sphere(1.0)))
    near, far = np.eye(4), np.eye(4)
    near[:3, 3] = 3 * _pictures._TOWARDS
    shapes = [ball.at(near, "#ff0000"), ball.at(far, "#0000ff")]
    for order in (shapes, shapes[::-1]):
        drawn = image_of(_pictures.bodies(order))
        assert drawn[..., 0].any()
        assert not drawn[..., 2].any()


def test_half_spaces_are_left_out():
    """A floor of a kilometre does not make a point of everything else."""
    scene = Scene()
    scene.add("floor", Body.half_space([0, 0, 1], -1.0))
    scene.add("box", Body.box([1, 2, 3]))
    assert "1 × 2 × 3 m; bodies of 1000 m are not drawn" in scene._repr_html_()
    scene.remove("box")
    assert "<svg" in scene._repr_html_()


def test_outlines_are_those_of_ellipsoids():
    """Points on an ellipsoid are within its outline, and some are on it."""
    body = hull()
    html = body._repr_html_()
    ellipses = [e.attrib for e in svg_of(html).iter() if e.tag.endswith("ellipse")]
    assert len(ellipses) == 2
    u = RNG.normal(size=(5000, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    outer = (body.outer.center[0] + u @ body.outer.factor[0].T) @ _pictures._VIEW[:2].T
    x, y, turn = map(float, re.findall(r"-?[\d.]+", ellipses[0]["transform"]))
    a, b = float(ellipses[0]["rx"]), float(ellipses[0]["ry"])
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    size = np.array([np.hypot(a * c, b * s), np.hypot(a * s, b * c)])  # half of its box
    points = (outer - outer.min(axis=0)) / np.ptp(outer, axis=0) * 2 * size - size
    local = points @ np.array([[c, -s], [s, c]]) / [a, b]
    assert np.linalg.norm(local, axis=1).max() == pytest.approx(1.0, abs=0.03)
    assert (x - size[0], y - size[1]) > (0, 0)


def test_large_meshes():
    """Of many triangles some are drawn, without holes."""
    mesh = trimesh.creation.icosphere(7)
    html = _pictures.bodies([Shape(mesh.triangles, np.zeros(len(mesh.triangles)), "#4477aa")])
    assert len(html) < 60_000
    opaque = image_of(html)[..., 3] > 0
    rows, columns = (np.arange(n) - (n - 1) / 2 for n in opaque.shape)
    inside = np.hypot(rows[:, None], columns) < 0.45 * min(opaque.shape)
    assert opaque[inside].mean() > 0.97


def test_many_colours():
    """A crowd in all colours, which compresses badly, is also small."""
    crowd = RNG.normal(size=(8, 5000, 1, 3)) + 0.05 * RNG.normal(size=(8, 5000, 3, 3))
    html = _pictures.bodies([Shape(x, np.zeros(5000), c) for x, c in zip(crowd, _pictures.COLOURS, strict=True)])
    assert 20_000 < len(html) < 60_000


def test_points_and_segments_have_the_width_of_their_balls():
    """A point is as wide as its ball, and a segment as long as it is, plus a ball."""
    ends = np.stack([-2 * _pictures._RIGHT, 2 * _pictures._RIGHT, 2 * _pictures._RIGHT])
    drawn = image_of(_pictures.bodies([Shape(ends[None], np.ones(1), "#4477aa")]))[..., 3] > 0
    height, width = drawn.any(axis=1).sum(), drawn.any(axis=0).sum()
    assert width / height == pytest.approx(3.0, rel=0.02)


def test_rows_of_verdicts_show_the_worst():
    """Of more verdicts than bars each bar shows the worst; the counts are those of all."""
    codes = np.zeros(5000, dtype=np.int8)
    codes[1234], codes[1235] = 2, 1
    html = _pictures.verdicts(codes, np.arange(5001.0), "number")
    assert html.count("rgb(204, 51, 68)") == 2  # one bar and one entry of the legend
    assert "FREE 4998" in html
    assert "COLLIDING 1" in html
    assert "AMBIGUOUS 1" in html


# -- texts ----------------------------------------------------------------------------------------

MODULES = ("", ".cluster", ".gpu", ".paper", ".planners", ".verify", ".viewer")


@pytest.mark.parametrize("module", MODULES)
def test_public_objects_have_a_text(module):
    """No public class has the text of `object`, which shows an address."""
    home = importlib.import_module(f"loewner{module}")
    public = getattr(home, "__all__", [name for name in vars(home) if not name.startswith("_")])
    classes = [thing for thing in (getattr(home, name) for name in public) if inspect.isclass(thing)]
    assert classes
    assert [kind for kind in classes if kind.__repr__ is object.__repr__] == []


def test_texts_are_short():
    """A piece, and an experiment's data, are shown by the shapes of their arrays."""
    assert "vertices=<(" in repr(hull(40).pieces[0])
    assert "points_1=<(10, 20, 3) float64>" in repr(loewner.paper.sample(10))


# -- log ------------------------------------------------------------------------------------------


def test_log_is_silent():
    """The library configures nothing but that nothing is printed."""
    assert [type(handler) for handler in logging.getLogger("loewner").handlers] == [logging.NullHandler]
    assert logging.getLogger("loewner").level == logging.NOTSET


def test_long_work_is_logged(caplog, monkeypatch, tmp_path):
    """Large meshes, many fits, decompositions and improvements are logged; small ones are not."""
    caplog.set_level(logging.INFO, "loewner")
    Bodies.from_points([RNG.normal(size=(6, 3)) for _ in range(5)])
    Body.from_surface(trimesh.creation.box())
    assert caplog.messages == []
    Bodies.from_points([RNG.normal(size=(6, 3)) for _ in range(_log.MANY_PIECES)])
    ring = trimesh.creation.annulus(0.5, 1.0, 0.4, sections=6)
    Body.from_mesh(ring, tolerance=0.3)
    monkeypatch.setattr("loewner.bodies.body.MANY_TRIANGLES", 12)
    monkeypatch.setattr("loewner.meshes.decomposition.MANY_TRIANGLES", 12)
    trimesh.creation.box().export(tmp_path / "box.stl")
    Body.from_surface(tmp_path / "box.stl")
    checker = beside_a_post(tmp_path)
    checker.scene.move("post", translation(0.0, -0.5))
    planners.plan(checker, LEFT, RIGHT, improve_iterations=20)
    for text in (
        r"fitting the ellipsoids of 100 pieces: [\d.e-]+ s", r"mesh: cutting 48 triangles \.\.\.", r"mesh: \d+ pieces",
        r"box\.stl: read, 12 triangles", r"box\.stl: preparing a surface of 12 triangles: ",
        r"round \d+ of improvement: cost [\d.]+, at least [\d.]+",
    ):  # fmt: skip
        assert any(re.search(text, message) for message in caplog.messages), text


# -- the notebook ---------------------------------------------------------------------------------


def test_notebook_runs():
    """It holds no outputs; its cells run in order, and what they end with has a picture or a short text."""
    cells = [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    names, pictures = {}, []
    for cell in cells:
        *body, last = ast.parse("".join(cell["source"])).body
        if not isinstance(last, ast.Expr):
            body.append(last)
        exec(compile(ast.Module(body, []), NOTEBOOK.name, "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), NOTEBOOK.name, "eval"), names)
            assert len(repr(value)) < 500
            pictures += [value._repr_html_()] if hasattr(value, "_repr_html_") else []
    assert len(pictures) == 8
    assert all("<svg" in picture for picture in pictures)
    assert "COLLIDING" in pictures[-3]
    assert "FREE" in pictures[-1]


# -- steps along wrenches -------------------------------------------------------------------------


def test_push_increases_a_distance_as_predicted():
    """The derivative of the distance along a push is |force|² + |moment about the body's origin|² / radius²."""
    for _ in range(10):
        a, b, T = hull(8), hull(8), translation(*RNG.uniform(2, 5, 3))
        found = loewner.distance(a, None, b, T, exact=True)
        moment = found.wrench[3:] - np.cross(T[:3, 3], found.wrench[:3])
        expected = 1.0 + moment @ moment / 0.7**2
        step = 1e-7
        ends = [
            loewner.distance(a, None, b, loewner.push(T, s * found.wrench, radius=0.7), exact=True).distance
            for s in (-step, step)
        ]
        assert (ends[1] - ends[0]) / (2 * step) == pytest.approx(expected, rel=1e-4)


def test_push_is_exact():
    """A moment turns about the body's origin by its length over the square of the radius; a force only moves."""
    T = translation(1.0, 2.0, 3.0)
    turned = loewner.push(T, [0, 0, 0, 0, 0, 0.25 * np.pi / 2], radius=0.5)
    np.testing.assert_allclose(turned[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    np.testing.assert_array_equal(turned[:3, 3], T[:3, 3])
    force = np.array([0.1, -0.2, 0.3])
    moved = loewner.push(T, np.append(force, np.cross(T[:3, 3], force)), radius=0.5)
    np.testing.assert_allclose(moved, translation(*(T[:3, 3] + force)), atol=1e-15)
    assert loewner.push(None, np.zeros((4, 1, 6)), radius=1.0).shape == (4, 1, 4, 4)
    many = loewner.push(np.tile(T, (5, 1, 1)), RNG.normal(size=(3, 5, 6)), radius=0.1)
    assert np.abs(many[..., :3, :3] @ many[..., :3, :3].swapaxes(-1, -2) - np.eye(3)).max() < 1e-14


def test_push_refuses():
    """Shapes that do not broadcast, and steps that lead nowhere."""
    with pytest.raises(loewner.InputError, match="broadcast"):
        loewner.push(np.tile(np.eye(4), (2, 1, 1)), np.zeros((3, 6)), radius=1.0)
    with pytest.raises(loewner.InputError, match="radius"):
        loewner.push(None, np.zeros(6), radius=0.0)
    with pytest.raises(loewner.InputError, match="overflow"):
        loewner.push(None, [0, 0, 0, 0, 0, 1e308], radius=1e-3)
