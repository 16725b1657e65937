"""A page of the viewer in a real browser: hands move bodies, and everything on it can be seen and read."""

import io
import itertools
import os
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import loewner
from browsers import missing
from families import translation
from loewner import Body, CollisionChecker, InputError, Verdict, planners, viewer
from loewner.viewer import drawing, guard
from loewner.viewer.page import length_text
from robot_oracle import robots_folder
from sampling import quick
from viewer_pages import PATIENCE, eventually, panel, shown


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


# Where B stops, the verdict of the ellipsoids, and the exact answer. Faces touch at x = 1. With B to the side, the
# inner balls meet at 0.8 only and the outer ones at 1.62.
STOPS = [
    (1.2, "AMBIGUOUS", "FREE"),
    (0.88, "AMBIGUOUS", "COLLIDING"),
    (0.4, "COLLIDING", "COLLIDING"),
    (2.2, "FREE", "FREE"),
]


@pytest.mark.verify
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
        for x, verdict, exact in STOPS:
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


@pytest.mark.verify
def test_trajectory_in_the_browser(tab, arm):
    """The button plays it to its end, where the page names the pair that collides."""
    moved = planners.trajectory(arm.robot, [[0.0, 0.0], [1.5, 0.0]], velocity=4.0, acceleration=16.0)
    with viewer.show_robot(arm, trajectory=moved) as page:
        tab.goto(page.url)
        assert shown(tab, "COLLIDING") == "COLLIDING"  # the trajectory does, later
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


@pytest.mark.verify
@pytest.mark.parametrize("size", [0.01, 30.0])
def test_the_browser_opens_with_two_bodies_in_the_frame(tab, size):
    """Whatever their size: all their pixels are in the window, left of the panel."""
    with viewer.show_pair(
        Body.box([size] * 3), None, Body.box([size] * 3), translation(2.2 * size, 0.6 * size)
    ) as page:
        tab.goto(page.url)
        shown(tab, "FREE")
        fills_the_window(tab, page)


@pytest.mark.verify
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
    script = runpy.run_path(str(Path(__file__).parents[2] / "docs/images/pages.py"))
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


def found_by_axe(tab):
    """Names of the faults that axe finds."""
    try:
        from axe_playwright_python.sync_playwright import Axe
    except ImportError:
        missing("no axe: pip install -r requirements/dev.txt")
    return {fault["id"] for fault in Axe().run(tab).response["violations"]}


@pytest.mark.parametrize(
    "scene",
    [
        of_two_pieces,
        *(pytest.param(k, marks=pytest.mark.verify) for k in (of_a_moving_arm, of_two_surfaces, of_a_panda)),
    ],
)
@pytest.mark.parametrize("every", quick(2, 1))
def test_everything_on_the_page_can_be_read(tab, arm, scene, every, tmp_path):
    """In wide and narrow windows, light and dark, nothing is cut off, covers something or loads from elsewhere.

    The verdict and most of the scene are seen at once. Pictures are in the test's folder. On the page that has most on
    it, axe finds no fault in contrast, names and structure, but that viser's page has no heading of the first level.
    """
    page, verdict = scene(arm)
    with page:
        for width, height, mode in ((1280, 800, "light"), (400, 720, "light"), (400, 720, "dark"))[::every]:
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
            assert scene is not of_a_moving_arm or found_by_axe(tab) <= {"page-has-heading-one"}
            scheme = tab.evaluate("document.documentElement.dataset.mantineColorScheme")
            assert scheme == mode
            picture = tab.screenshot(path=tmp_path / f"{scene.__name__}_{width}_{mode}.png", timeout=PATIENCE)
            assert len(picture) > 10_000
        assert all(url.startswith((page.url, "blob:" + page.url, "data:")) for url in tab.asked), tab.asked


@pytest.mark.verify
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


@pytest.mark.verify
def test_the_slider_of_a_path_in_the_browser(tab, arm):
    """With each press of a key the robot is farther along, and the page says what the library does for it there."""
    rows = [[0.0, 0.0], [1.5, 0.0]]
    with viewer.show_robot(arm, path=rows) as page:
        tab.goto(page.url)
        assert shown(tab, "COLLIDING") == "COLLIDING"  # the path does, later
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


@pytest.mark.verify
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


@pytest.mark.verify
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


@pytest.mark.verify
def test_a_screenshot_without_a_window(browser, tmp_path, capsys) -> None:
    """Of the command line, with a cloud in the picture."""
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


def test_a_screenshot_that_cannot_be(tmp_path) -> None:
    """Names that are none, windows without room, and what is no page are refused by name."""
    with viewer.show_pair(Body.sphere(1.0), None, Body.sphere(1.0), translation(3.0, 0.0)) as page:
        for bad in ({"path": "out.jpg"}, {"path": tmp_path / "a.png", "width": 10}):
            with pytest.raises(InputError, match="path|width"):
                viewer.save_screenshot(page, **bad)
    with pytest.raises(InputError, match="expected an open page"):
        viewer.save_screenshot("page", tmp_path / "a.png")


@pytest.mark.verify
@pytest.mark.parametrize("name", ["arm", "viewer", "cloud"])
def test_the_pictures_of_the_docs_are_what_the_page_shows(browser, name) -> None:
    """Made again by their script: at a twentieth of the size hardly any pixel differs, whatever the fonts."""
    robots_folder()
    script = runpy.run_path(str(Path(__file__).parents[2] / "docs/images/pages.py"))
    kept = Image.open(Path(script["__file__"]).with_name(f"{name}.png"))
    made = script["draw"](name)
    assert made.size == kept.size
    small = [
        np.asarray(p.convert("RGB").resize((p.width // 20, p.height // 20), Image.Resampling.BOX)).astype(int)
        for p in (made, kept)
    ]
    differ = np.abs(small[0] - small[1]).max(axis=2)
    assert np.mean(differ > 24) < 0.01, differ.mean()
