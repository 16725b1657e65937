"""The 3-D page while somebody drags: a Panda among ten obstacles, in a real browser.

    python benchmarks/viewer.py [--sizes 1280x800 960x600 ...] [--seconds 6] [--mesh]

For each size of the browser's window a body of the scene is dragged by its gizmo, then a joint by its slider, with the
mouse, to and fro. Counted in the page: changes of the panel's answers (verdict, bounds, pairs), and pictures drawn.
Counted on the server: answers, and the processor time of one, with all that is done to send it. The browser draws without a
graphics card, so that this is the worst case: frames cost it many times what they cost on a desktop.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from loewner import CollisionChecker, LoewnerError, viewer
from rivals import Missing
from robot_samples import obstacles, panda

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
SIZES = ("1280x800", "960x600", "640x480")
WANTED = 20.0
# The mouse goes to and fro in so many seconds, and moves so often a second at most.
PERIOD, MOVES = 4.0, 120
# Updates of the server that are timed without a browser.
ALONE = 200

# Notes each change of the panel's answers.
WATCH = """() => {
  const panel = document.querySelector('[data-loewner="verdict"]').parentElement.parentElement;
  window.panelChanges = 0;
  let last = panel.innerHTML;
  new MutationObserver(() => {
    if (panel.innerHTML !== last) { last = panel.innerHTML; window.panelChanges += 1; }
  }).observe(panel, {childList: true, subtree: true, characterData: true});
}"""
COUNT = "() => [performance.now() / 1000, window.panelChanges, window.__viserTestpoints.rendererInfo.render.frame]"


@dataclass(frozen=True)
class Dragged:
    """What one drag showed; per second of it, but for `cost` [s of processor time for one answer]."""

    updates: float
    frames: float
    answers: float
    cost: float


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="WxH", help="of the browser's window, in pixels")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drag")
    parser.add_argument("--mesh", action="store_true", help="with the original meshes shown instead of the pieces")
    options = parser.parse_args(arguments)
    try:
        measure(options)
    except (Missing, LoewnerError) as missing:
        print(f"not run: {missing}", file=sys.stderr)
        return 1
    return 0


def measure(options: argparse.Namespace) -> None:
    robot = panda().robot
    checker = CollisionChecker(robot, obstacles(0))
    q = robot.configuration(next(iter(robot.states)))
    table = Table("window", "dragged", "updates/s", "pictures/s", "answers/s", "ms an answer", title="the page, dragged")
    sync_playwright, path = browser()
    with viewer.show_robot(checker, q) as page, sync_playwright() as driver:
        name = nearest(checker, q)
        alone = {"body": body_alone(page, name), "joint": joint_alone(page, q)}
        if options.mesh:
            page._layers["meshes"].value, page._layers["pieces"].value = True, False
            page._tell("layers")
        chromium = driver.chromium.launch(executable_path=path, headless=True, args=FLAGS)
        for size in options.sizes:
            width, height = map(int, size.split("x"))
            tab = opened(chromium, page, width, height)
            for what, ends in (("body", gizmo_ends(page, tab, name)), ("joint", slider_ends(tab))):
                found = drag(page, tab, *ends, options.seconds)
                updates = f"{found.updates:.1f}" + ("" if found.updates >= WANTED else " (fewer than 20)")
                table.add_row(
                    size, what, updates, f"{found.frames:.1f}", f"{found.answers:.1f}", f"{1e3 * found.cost:.2f}"
                )
            tab.close()
        chromium.close()
    for what, cost in alone.items():
        table.add_row("none", what, "-", "-", f"{1 / cost:.0f} possible", f"{1e3 * cost:.2f}")
    Console(width=110).print(table)


def browser() -> tuple[Any, str]:
    """What drives a browser, and the browser."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise Missing("playwright is not installed: pip install playwright") from None
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        raise Missing(f"no browser, one of {', '.join(BROWSERS)}: apt-get install chromium")
    return sync_playwright, path


def opened(chromium: Any, page: Any, width: int, height: int) -> Any:
    """The page in a window of its own, drawn and settled."""
    tab = chromium.new_page(viewport={"width": width, "height": height})
    tab.set_default_timeout(120_000)
    tab.goto(page.url)
    tab.locator('[data-loewner="verdict"]').wait_for()
    tab.evaluate(WATCH)
    while len(page.server.get_clients()) != 1:
        time.sleep(0.1)
    time.sleep(3)
    return tab


def nearest(checker: CollisionChecker, q: Any) -> str:
    """The body of the scene whose moves change the answers: the one in the nearest pair with one."""
    scene = checker.scene
    reach = {}
    for name in scene.static_names:
        T = scene.pose(name)
        scene.move(name, np.diag([1.0, 1, 1, 1]) + [[0, 0, 0, 50], [0] * 4, [0] * 4, [0] * 4])
        reach[name] = checker.distance(q).lower
        scene.move(name, T)
    return max(reach, key=lambda name: reach[name])


def gizmo_ends(page: Any, tab: Any, name: str) -> tuple[Any, Any]:
    """From the tip of the gizmo's arrow that is most upright to half a length further, in pixels."""
    page._chosen.value = name
    page._tell("chosen")
    time.sleep(2)
    mover = page._mover(name)
    axis = mover.T[:3, np.abs(mover.T[2, :3]).argmax()]
    grip = mover.T[:3, 3] + 0.75 * mover.gizmo.scale * axis
    return pixel(page, grip), pixel(page, grip + 0.15 * axis)


def slider_ends(tab: Any) -> tuple[Any, Any]:
    """From the thumb of the second joint's slider to nearby."""
    box = tab.locator(".mantine-Slider-thumb").nth(1).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    return (x, y), (x + 30, y)


def pixel(page: Any, point: Any) -> tuple[float, float]:
    """Where a point of the world is in the window."""
    (client,) = page.server.get_clients().values()
    camera = client.camera
    toward = camera.look_at - camera.position
    toward = toward / np.linalg.norm(toward)
    right = np.cross(toward, camera.up_direction)
    right /= np.linalg.norm(right)
    seen = np.asarray(point) - camera.position
    scale = camera.image_height / 2 / np.tan(camera.fov / 2) / (seen @ toward)
    down = -np.cross(right, toward)
    return camera.image_width / 2 + scale * (seen @ right), camera.image_height / 2 + scale * (seen @ down)


def drag(page: Any, tab: Any, start: Any, end: Any, seconds: float) -> Dragged:
    """Drag with the mouse, to and fro."""
    start, end = np.asarray(start), np.asarray(end)
    tab.mouse.move(*start)
    time.sleep(0.5)
    tab.mouse.down()
    tab.mouse.move(*(start + 0.1 * (end - start)))
    time.sleep(0.5)
    before, answered, spent = tab.evaluate(COUNT), page.answered, page.cpu_seconds
    began = time.monotonic()
    while (passed := time.monotonic() - began) < seconds:
        tab.mouse.move(*(start + (0.55 - 0.45 * np.cos(2 * np.pi * passed / PERIOD)) * (end - start)))
        time.sleep(1 / MOVES)
    after, answers = tab.evaluate(COUNT), page.answered - answered
    tab.mouse.move(*start)
    tab.mouse.up()
    time.sleep(1)
    took = after[0] - before[0]
    if answers == 0:
        raise Missing("the mouse did not find what it was to drag")
    return Dragged(
        (after[1] - before[1]) / took, (after[2] - before[2]) / took, answers / took,
        (page.cpu_seconds - spent) / answers,
    )  # fmt: skip
