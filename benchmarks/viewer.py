"""The 3-D page while somebody drags: a Panda among ten obstacles, in a real browser.

    python benchmarks/viewer.py [--sizes 1280x800 960x600 ...] [--seconds 6] [--pixel-ratio 1] [--mesh]

For each size of the browser's window a body of the scene is dragged by its gizmo, then a joint by its slider, with the
mouse, to and fro. Counted in the page: changes of the panel's answers (verdict, bounds, pairs), and pictures drawn.
Counted on the server: answers, and what one takes. The browser draws without a graphics card, so that this is the worst
case: a picture costs it many times what it costs on a desktop.
"""

from __future__ import annotations

import argparse
import asyncio
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from loewner import CollisionChecker, LoewnerError, Robot, Scene, viewer
from rivals import Missing
from robot_samples import obstacles, panda

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
SIZES = ("1280x800", "960x600", "800x500")
WANTED = 20.0
# The body that is dragged, and how far before the hand it is at first [m].
BODY, AHEAD = "box 0", 0.2
# The mouse goes to and fro in so many seconds, and moves so often a second at most.
PERIOD, MOVES = 2.0, 60
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
    """What one drag showed; per second of it, but for `cost`, the time of one answer [s]."""

    updates: float
    frames: float
    answers: float
    cost: float


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=SIZES, metavar="WxH", help="of the browser's window, in pixels")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each drag")
    parser.add_argument("--pixel-ratio", type=float, default=1.0, help="pixels of the picture to one of the window (1)")
    parser.add_argument("--mesh", action="store_true", help="with the original meshes shown instead of the pieces")
    options = parser.parse_args(arguments)
    try:
        asyncio.run(measure(options))
    except (Missing, LoewnerError) as missing:
        print(f"not run: {missing}", file=sys.stderr)
        return 1
    return 0


async def measure(options: argparse.Namespace) -> None:
    robot = panda().robot
    q = robot.configuration("default")
    checker = CollisionChecker(robot, in_the_way(robot, q))
    table = Table(
        "window", "dragged", "updates/s", "pictures/s", "answers/s", "ms an answer", title="the page, dragged"
    )
    async_playwright, path = browser()
    async with async_playwright() as driver:
        page = viewer.show_robot(checker, q)
        alone = {"body": body_alone(page), "joint": joint_alone(page, q)}
        if options.mesh:
            page._layers["meshes"].value, page._layers["pieces"].value = True, False
            page._tell("layers")
        chromium = await driver.chromium.launch(executable_path=path, headless=True, args=FLAGS)
        for size in options.sizes:
            width, height = map(int, size.split("x"))
            tab = await opened(chromium, page, width, height, options.pixel_ratio)
            for what, ends in (("body", await gizmo_ends(page, tab)), ("joint", await slider_ends(tab))):
                found = await drag(page, tab, *ends, options.seconds)
                updates = f"{found.updates:.1f}" + ("" if found.updates >= WANTED else " (fewer than 20)")
                table.add_row(
                    size, what, updates, f"{found.frames:.1f}", f"{found.answers:.1f}", f"{1e3 * found.cost:.2f}"
                )
            await tab.close()
        await chromium.close()
        page.close()
    for what, cost in alone.items():
        table.add_row("none", what, "-", "-", f"{1 / cost:.0f} possible", f"{1e3 * cost:.2f}")
    Console(width=110).print(table)


def browser() -> tuple[Any, str]:
    """What drives a browser, and the browser."""
    try:
        from playwright.async_api import async_playwright
    except ImportError:
        raise Missing("playwright is not installed: pip install playwright") from None
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        raise Missing(f"no browser, one of {', '.join(BROWSERS)}: apt-get install chromium")
    return async_playwright, path


async def opened(chromium: Any, page: Any, width: int, height: int, pixel_ratio: float) -> Any:
    """The page in a window of its own, drawn and settled."""
    tab = await chromium.new_page(viewport={"width": width, "height": height})
    tab.set_default_timeout(120_000)
    await tab.goto(f"{page.url}/?fixedDpr={pixel_ratio}")
    await tab.locator('[data-loewner="verdict"]').wait_for()
    await tab.evaluate(WATCH)
    while len(page.server.get_clients()) != 1:
        await asyncio.sleep(0.1)
    await asyncio.sleep(3)
    return tab


def in_the_way(robot: Robot, q: Any) -> Scene:
    """The ten obstacles, one of them before the hand: whatever it or the arm does then changes the answers."""
    scene, T = obstacles(0), np.eye(4)
    T[:3, 3] = robot.forward_kinematics(q)[robot.link_names.index("panda_hand"), :3, 3] + [AHEAD, 0, 0]
    scene.move(BODY, T)
    return scene


async def gizmo_ends(page: Any, tab: Any) -> tuple[Any, Any]:
    """From the tip of the gizmo's arrow that is most upright to half a length further, in pixels."""
    page._chosen.value = BODY
    page._tell("chosen")
    await asyncio.sleep(2)
    mover = page._mover(BODY)
    axis = mover.T[:3, np.abs(mover.T[2, :3]).argmax()]
    grip = mover.T[:3, 3] + 0.75 * mover.gizmo.scale * axis
    return pixel(page, tab, grip), pixel(page, tab, grip + 0.15 * axis)


async def slider_ends(tab: Any) -> tuple[Any, Any]:
    """From the thumb of the second joint's slider to the right; a mouse moves by whole pixels."""
    box = await tab.locator(".mantine-Slider-thumb").nth(1).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    return (x, y), (x + 60, y)


def pixel(page: Any, tab: Any, point: Any) -> tuple[float, float]:
    """Where a point of the world is in the window."""
    (client,) = page.server.get_clients().values()
    camera = client.camera
    toward = camera.look_at - camera.position
    toward = toward / np.linalg.norm(toward)
    right = np.cross(toward, camera.up_direction)
    right /= np.linalg.norm(right)
    seen = np.asarray(point) - camera.position
    width, height = tab.viewport_size["width"], tab.viewport_size["height"]
    scale = height / 2 / np.tan(camera.fov / 2) / (seen @ toward)
    down = -np.cross(right, toward)
    return width / 2 + scale * (seen @ right), height / 2 + scale * (seen @ down)


async def drag(page: Any, tab: Any, start: Any, end: Any, seconds: float) -> Dragged:
    """Drag with the mouse, to and fro."""
    start, end = np.asarray(start), np.asarray(end)
    await tab.mouse.move(*start)
    await asyncio.sleep(0.5)
    await tab.mouse.down()
    await tab.mouse.move(*(start + 0.1 * (end - start)))
    await asyncio.sleep(0.5)
    costs, moves, answered, before = [], [], page.answered, await tab.evaluate(COUNT)
    began = time.monotonic()
    while (passed := time.monotonic() - began) < seconds:
        at = start + (0.55 - 0.45 * np.cos(2 * np.pi * passed / PERIOD)) * (end - start)
        # Not waited for: a hand does not wait for the page either.
        moves.append(asyncio.create_task(tab.mouse.move(*at)))
        costs.append(page.seconds)
        await asyncio.sleep(1 / MOVES)
    after, answers = await tab.evaluate(COUNT), page.answered - answered
    await asyncio.gather(*moves)
    await tab.mouse.move(*start)
    await tab.mouse.up()
    await asyncio.sleep(1)
    if answers == 0:
        raise Missing("the mouse did not find what it was to drag")
    took = after[0] - before[0]
    rates = (after[1] - before[1]) / took, (after[2] - before[2]) / took, answers / took
    return Dragged(*rates, float(np.median(costs)))


def body_alone(page: Any) -> float:
    """Processor time of one update, sent to nobody, when a body moves [s]."""
    T = page.checker.scene.pose(BODY)

    def move(k: int) -> None:
        moved = T.copy()
        moved[2, 3] += 0.001 * (k % 50)
        page.move(BODY, moved)

    return cost_of(move)


def joint_alone(page: Any, q: Any) -> float:
    """Processor time of one update, sent to nobody, when a joint moves [s]."""

    def move(k: int) -> None:
        page.q = q + 0.002 * (k % 50) * (np.arange(len(q)) == 1)

    return cost_of(move)


def cost_of(move: Callable[[int], None]) -> float:
    move(1)
    started = time.process_time()
    for k in range(ALONE):
        move(k)
    move(0)
    return (time.process_time() - started) / (ALONE + 1)


if __name__ == "__main__":
    sys.exit(main())
