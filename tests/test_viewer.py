"""The 3-D page: what it shows is what the library answers, in Python and in a real browser."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import loewner
from loewner import Body, CollisionChecker, Robot, Scene, Verdict, cli, viewer
from loewner.viewer import drawing

REQUIRED = os.environ.get("LOEWNER_BROWSER") == "required"

# Chromium as root in a container, with no network and no graphics card.
FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]
FLAGS += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]

# Software rendering on a busy machine takes seconds for what a graphics card does at once.
PATIENCE = 120_000

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


def missing(what):
    if REQUIRED:
        pytest.fail(f"{what}; LOEWNER_BROWSER=required asks for it (.ci/run installs it where it can)")
    pytest.skip(what)


@pytest.fixture(autouse=True)
def viser():
    try:
        import viser
    except ImportError:
        missing("no viser: pip install -r requirements/dev.txt")
    return viser


@pytest.fixture(scope="module")
def browser():
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("no playwright: pip install -r requirements/dev.txt")
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        missing("no Chromium: apt-get install chromium")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, headless=True, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    scene = Scene()
    scene.add("wall/left", Body.box([0.1, 1, 1]), at(1.2))
    scene.add("<b>ball</b>", Body.sphere(0.2), at(-1.2))
    return CollisionChecker(Robot.from_urdf(path), scene)


def at(x, y=0.0, z=0.0):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


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
    T = at(0.3, -0.2, 0.5)
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
    with viewer.show_pair(a, None, b, at(2.5)) as page:
        for x in (2.5, 1.3, 0.6):
            page.T_world_b = at(x)
            assert page.verdict == loewner.classify(a, None, b, at(x))
            assert page.colliding == loewner.collide(a, None, b, at(x))
            assert page.found.distance == loewner.distance(a, None, b, at(x), exact=True).distance
            assert page.verdict.name in page._verdict.content
        assert page.verdict == Verdict.COLLIDING
        page.T_world_a = at(-5)
        assert page.verdict == Verdict.FREE
        np.testing.assert_array_equal(page.T_world_a, at(-5))


def test_numbers_typed_on_the_page_move_the_body():
    """What the page's number fields hold is where the body goes."""
    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), at(2.5)) as page:
        page._inputs["B"].position.value = (0.6, 0.0, 0.0)
        page._inputs["B"].turn.value = (0.0, 0.0, 90.0)
        page._tell("type B")
        eventually(lambda: page.verdict == Verdict.COLLIDING)
        np.testing.assert_allclose(page.T_world_b[:3, :2], [[0, -1], [1, 0], [0, 0]], atol=1e-12)


def test_layers_switch_on_and_off():
    """A checkbox shows or hides its layer on both bodies, and nothing else."""
    with viewer.show_pair(Body.cone(1, 1), None, Body.box([1, 1, 1]), at(2.5)) as page:
        page._layers["outer"].value = False
        page._tell("layers")
        nodes = [shown._nodes for shown in page._drawings.values()]
        eventually(lambda: not any(n["outer"].visible for n in nodes))
        assert all(n["pieces"].visible and n["inner"].visible for n in nodes)


def test_failed_query_leaves_no_verdict_standing(monkeypatch):
    """Where the exact search gives up, the page does not go on saying FREE."""

    def give_up(*_, **__):
        raise loewner.ConvergenceError("no answer")

    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), at(2.5)) as page:
        assert "FREE" in page._verdict.content
        monkeypatch.setattr(viewer.pair, "collide", give_up)
        page.refresh()
        assert "FREE" not in page._verdict.content
        assert "UNDECIDED" in page._verdict.content


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
        arm.scene.move("wall/left", at(5))
        eventually(lambda: not page.colliding)
        arm.scene.remove("wall/left")
        arm.scene.add("post", Body.cylinder(0.1, 2), at(0.9))
        arm.scene.attach("<b>ball</b>", "fore", at(0, 0, 1.0))
        eventually(lambda: page.colliding)
        assert set(page._shown) == {"base", "upper", "fore", "post", "<b>ball</b>"}
        page.move("post", at(-3))
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


def test_many_moves_are_answered_by_the_last():
    """Moves that wait are not answered one by one: the page never lags behind the mouse."""
    with viewer.show_pair(Body.box([1, 1, 1]), None, Body.box([1, 1, 1]), at(2.5)) as page:
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
    with pytest.raises(loewner.InputError, match="port: expected a whole number"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port)


def test_host_that_is_none():
    with pytest.raises(loewner.InputError, match="no such host"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, host="no such host")


def test_missing_extra_names_the_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(loewner.MissingExtraError, match=r'viser: pip install "loewner\[viewer\]"'):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None)


def test_operands_are_checked(arm):
    with pytest.raises(loewner.InputError, match=r"a: expected loewner\.Body, found str"):
        viewer.show_pair("a", None, Body.sphere(1), None)
    with pytest.raises(loewner.PoseError, match="T_world_b"):
        viewer.show_pair(Body.sphere(1), None, Body.sphere(1), np.zeros((4, 4)))
    with pytest.raises(loewner.InputError, match=r"checker: expected loewner\.CollisionChecker, found Robot"):
        viewer.show_robot(arm.robot)
    with pytest.raises(loewner.InputError, match="q: expected"):
        viewer.show_robot(arm, [0.0])


def test_nothing_to_check(tmp_path):
    """A robot of one body in an empty scene is refused, for there is nothing to check."""
    path = tmp_path / "lonely.urdf"
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    path.write_text(f'<robot name="lonely"><link name="base">{box}</link></robot>')
    with pytest.raises(loewner.InputError, match="checker: expected pairs to check, found none"):
        viewer.show_robot(CollisionChecker(Robot.from_urdf(path)))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["part.npz"], "view: expected two bodies, A and B, or --robot URDF"),
        (["part.npz", "part.npz", "--scene", "empty.yaml"], "expected --srdf and --scene beside --robot"),
        (["part.npz", "--robot", "arm.urdf"], "expected no A and B beside --robot"),
        (["--robot", "arm.urdf", "--scene", "empty.yaml"], "empty.yaml: expected a scene with bodies, found none"),
        (["--robot", "broken.urdf"], "broken.urdf, line 1: expected a URDF"),
        (["--robot", "none.urdf"], "none.urdf: expected"),
        (["part.npz", "part.npz", "--port", "70000"], "port: expected a whole number"),
        (["part.npz", "nothing.npz"], "nothing.npz: expected a file"),
    ],
    ids=lambda value: value[:24] if isinstance(value, str) else "",
)
def test_command_line_says_what_is_wrong(arguments, expected, arm, tmp_path, monkeypatch, capsys):
    """Bad input ends with status 2 and one line, before any page is opened."""
    monkeypatch.chdir(tmp_path)
    Body.box([1, 1, 1]).save("part.npz")
    Path("empty.yaml").write_text("bodies: {}\n")
    Path("broken.urdf").write_text("<robot")
    assert cli.main(["view", *arguments, "--no-browser"]) == cli.ERROR
    captured = capsys.readouterr()
    assert expected in captured.err
    assert captured.out == ""


def test_close_twice_and_free_the_port():
    page = viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None)
    port = page.server.get_port()
    page.close()
    page.close()
    with viewer.show_pair(Body.sphere(1), None, Body.sphere(1), None, port=port) as again:
        assert again.url == f"http://localhost:{port}"


# -- in a browser -----------------------------------------------------------------------------


@pytest.fixture
def tab(browser):
    """An empty page of the browser that notes where it asks for anything."""
    tab = browser.new_page(viewport={"width": 1000, "height": 600})
    tab.set_default_timeout(PATIENCE)
    tab.asked = []
    tab.on("request", lambda request: tab.asked.append(request.url))
    yield tab
    tab.close()


def shown(tab, name):
    """Wait until the page's bar says so."""
    tab.locator('[data-loewner="verdict"]', has_text=name).wait_for()
    return tab.locator('[data-loewner="verdict"]').inner_text()


def pixel(page, point):
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
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    return camera.image_width / 2 + focal * seen[0] / seen[2], camera.image_height / 2 + focal * seen[1] / seen[2]


def drag(tab, page, start, end):
    """Drag with the mouse from one point of the world to another."""
    tab.mouse.move(*pixel(page, start))
    tab.mouse.down()
    tab.mouse.move(*pixel(page, end), steps=8)
    tab.mouse.up()


def test_dragging_a_body_in_the_browser(tab, tmp_path):
    """Dragged by its arrow from free to touching to colliding: the page says at each what the library answers."""
    a, b = Body.box([1, 1, 1]), Body.box([1, 1, 1])
    with viewer.show_pair(a, None, b, at(2.2)) as page:
        tab.goto(page.url)
        assert shown(tab, "FREE") == "FREE"
        eventually(lambda: len(page.server.get_clients()) == 1, PATIENCE / 1000)
        for x, expected in ((1.3, "AMBIGUOUS"), (0.6, "COLLIDING"), (2.2, "FREE")):
            before = page.T_world_b[0, 3]
            grip = np.array([before + 0.75 * page._movers["B"].gizmo.scale, 0.0, 0.0])
            drag(tab, page, grip, grip + [x - before, 0.0, 0.0])
            eventually(lambda x=x: abs(page.T_world_b[0, 3] - x) < 0.05, PATIENCE / 1000)
            assert shown(tab, expected) == expected
            T = page.T_world_b
            np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-9)
            assert loewner.classify(a, None, b, T).name == expected
            exact = tab.locator('[data-loewner="exact"]').inner_text()
            assert exact == ("COLLIDING" if loewner.collide(a, None, b, T) else "FREE")
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
        shown(tab, arm.classify([1.5, 0.0]).name)
        assert arm.collide([1.5, 0.0])
        tab.locator('[data-loewner="note"]', has_text="wall/left").first.wait_for()
        assert page.q.tolist() == [1.5, 0.0]
        tab.get_by_text("random configuration").click()
        eventually(lambda: page.q.tolist() != [1.5, 0.0], PATIENCE / 1000)
        assert shown(tab, arm.classify(page.q).name) == page.verdict.name


def test_command_line_serves_a_page(tab, tmp_path):
    """`loewner view A B` prints an address, and the browser finds the verdict there."""
    paths = [tmp_path / "a.npz", tmp_path / "b.npz"]
    for path in paths:
        Body.box([1, 1, 1]).save(path)
    command = [sys.executable, "-m", "loewner", "view", *paths, "--pose-b", "1.3 0 0", "--no-browser"]
    source = Path(loewner.__file__).parents[1]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": str(source)},
    ) as process:
        try:
            url = process.stdout.readline().split()[0]
            tab.goto(url)
            assert shown(tab, "AMBIGUOUS") == "AMBIGUOUS"
        finally:
            process.terminate()
