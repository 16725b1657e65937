"""Draws the pictures of pages: an arm and its ellipsoids, a path that collides, and an arm among what a camera sees.

python docs/images/pages.py [FOLDER]     needs the packages of requirements/dev.txt and data.txt, Pillow, and a browser

The tests draw them, too, and compare them with those here.
"""

import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
from PIL import Image

import loewner
from loewner import Body, viewer

WIDTH, HEIGHT, COLOURS = 1100, 560, 48

POSTURE = {"panda_joint1": -0.1, "panda_joint4": -2.0, "panda_joint6": 1.7, "panda_joint7": 0.7}
FURNITURE = {
    "table": ([0.5, 0.7, 0.04], [0.62, 0.0, 0.2]),
    "box": ([0.12, 0.12, 0.2], [0.55, 0.2, 0.32]),
    "post": ([0.08, 0.08, 0.8], [0.2, -0.45, 0.4]),
}

# What the camera sees: points on the sides of the furniture, so many, each a ball of this radius [m].
POINTS, RADIUS = 5_000, 0.006


def panda() -> loewner.Robot:
    """The arm of example-robot-data."""
    folder = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
    urdf, srdf = (folder / f"panda_description/{name}" for name in ("urdf/panda.urdf", "srdf/panda.srdf"))
    return loewner.Robot.from_urdf(urdf, srdf=srdf, package_dirs=[folder.parents[1]])


def furnished() -> loewner.Scene:
    """A table, a box on it, and a post."""
    scene = loewner.Scene()
    for name, (size, at) in FURNITURE.items():
        T = np.eye(4)
        T[:3, 3] = at
        scene.add(name, Body.box(size), T)
    return scene


def sides(size: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Points on the sides of a box, as many on each as its area has."""
    areas = np.repeat(np.prod(size) / size, 2)
    side = rng.choice(6, count, p=areas / areas.sum())
    points = rng.uniform(-0.5, 0.5, (count, 3))
    points[np.arange(count), side // 2] = side % 2 - 0.5
    return points * size


def arm() -> viewer.RobotViewer:
    """The arm among three bodies, with all ellipsoids, and its exact clearance."""
    robot = panda()
    page = viewer.show_robot(loewner.CollisionChecker(robot, furnished()), robot.configuration(POSTURE))
    with page.lock:
        for layer in ("inner", "outer"):
            page._layers[layer].value = True
        page._show_layers()
    return page


def path() -> viewer.RobotViewer:
    """A path through the box, in the middle of it: the pairs that touch, and a bar of where it collides."""
    robot = panda()
    ends = [robot.configuration({**POSTURE, "panda_joint1": angle}) for angle in (-0.6, 0.9)]
    page = viewer.show_robot(loewner.CollisionChecker(robot, furnished()), path=ends)
    page.time = 0.6 * page._way.duration
    return page


def cloud() -> viewer.RobotViewer:
    """The arm among points, and how far it is from the nearest."""
    rng, scene, areas = np.random.default_rng(0), loewner.Scene(), []
    for size, _ in FURNITURE.values():
        a, b, c = size
        areas.append(a * b + b * c + c * a)
    counts = (POINTS * np.array(areas) / sum(areas)).astype(int)
    seen = [sides(np.array(size), rng, n) + at for (size, at), n in zip(FURNITURE.values(), counts, strict=True)]
    scene.add("camera", Body.from_cloud(np.concatenate(seen), radius=RADIUS))
    robot = panda()
    return viewer.show_robot(loewner.CollisionChecker(robot, scene), robot.configuration(POSTURE))


# Pictures by name, and where the camera is: what it looks at, and from where.
PAGES: dict[str, tuple[Callable[[], viewer.RobotViewer], tuple[float, float, float], tuple[float, float, float]]] = {
    "arm": (arm, (0.3, 0.12, 0.42), (1.25, -1.15, 0.85)),
    "viewer": (path, (0.45, 0.12, 0.42), (1.5, -1.0, 0.95)),
    "cloud": (cloud, (0.45, 0.12, 0.4), (1.5, -1.0, 0.95)),
}


def draw(name: str) -> Image.Image:
    """One of the pictures."""
    make, look_at, position = PAGES[name]
    with make() as page, tempfile.TemporaryDirectory() as folder:
        camera = page.server.initial_camera
        camera.look_at, camera.position = look_at, position
        made = Path(folder) / "page.png"
        viewer.save_screenshot(page, made, width=WIDTH, height=HEIGHT)
        return Image.open(made).convert("RGB").quantize(COLOURS)


def main(folder: Path) -> None:
    """Write all pictures into a folder."""
    for name in PAGES:
        draw(name).save(folder / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
