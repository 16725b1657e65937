"""Draws arm.png: the Panda among obstacles, with its ellipsoids and its exact clearance, as the viewer shows it.

python docs/images/arm.py     needs the packages of requirements/dev.txt, Pillow, and a browser
"""

import tempfile
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
from PIL import Image

import loewner
from loewner import Body, viewer

POSTURE = {"panda_joint2": -0.4, "panda_joint4": -2.0, "panda_joint6": 1.7, "panda_joint7": 0.7}
WIDTH, HEIGHT, COLOURS = 1100, 560, 48


def main() -> None:
    """Write the picture beside this file."""
    folder = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
    urdf, srdf = (folder / f"panda_description/{name}" for name in ("urdf/panda.urdf", "srdf/panda.srdf"))
    robot = loewner.Robot.from_urdf(urdf, srdf=srdf, package_dirs=[folder.parents[1]])
    scene = loewner.Scene()
    for name, size, at in (
        ("table", [0.5, 0.7, 0.04], [0.62, 0.0, 0.2]),
        ("box", [0.12, 0.12, 0.2], [0.55, 0.2, 0.32]),
        ("post", [0.08, 0.08, 0.8], [0.2, -0.45, 0.4]),
    ):
        T = np.eye(4)
        T[:3, 3] = at
        scene.add(name, Body.box(size), T)
    checker = loewner.CollisionChecker(robot, scene)
    page = viewer.show_robot(checker, robot.configuration(POSTURE), block=False)
    camera = page.server.initial_camera
    camera.look_at, camera.position = (0.3, 0.12, 0.42), (1.25, -1.15, 0.85)
    with page.lock:
        for layer in ("inner", "outer"):
            page._layers[layer].value = True
        page._show_layers()
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "arm.png"
        viewer.save_screenshot(page, made, width=WIDTH, height=HEIGHT)
        page.close()
        Image.open(made).convert("RGB").quantize(COLOURS).save(Path(__file__).with_suffix(".png"), optimize=True)


if __name__ == "__main__":
    main()
