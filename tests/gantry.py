"""A small robot whose collisions can be told by plane geometry."""

from pathlib import Path

import numpy as np

from families import translation
from loewner import Body, CollisionChecker, Robot, Scene

RADIUS = 0.1

# A ball of radius 0.1 that slides along x and y, with a rod of 0.3 m to its side that turns about z.
GANTRY = """<robot name="gantry">
<link name="base"/><link name="rail"/>
<link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="rod"><collision><origin xyz="0.3 0 0"/><geometry><box size="0.3 0.02 0.02"/></geometry></collision></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="rail"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1"/></joint>
<joint name="y" type="prismatic"><parent link="rail"/><child link="ball"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>
<joint name="turn" type="continuous"><parent link="ball"/><child link="rod"/><axis xyz="0 0 1"/></joint>
</robot>"""
GROUPS = """<robot name="gantry">
<group name="slide"><joint name="x"/><joint name="y"/></group><group name="nothing"/>
<group_state name="left" group="slide"><joint name="x" value="-0.5"/><joint name="y" value="-0.5"/></group_state>
<group_state name="wall" group="slide"><joint name="x" value="0.02"/><joint name="y" value="-0.5"/></group_state>
<disable_collisions link1="ball" link2="rod"/></robot>"""


def gantry(folder: Path) -> tuple[Path, Path]:
    """Write the robot's URDF and SRDF."""
    paths = folder / "gantry.urdf", folder / "gantry.srdf"
    for path, text in zip(paths, (GANTRY, GROUPS), strict=True):
        path.write_text(text)
    return paths


def gantry_robot(folder: Path) -> Robot:
    """Read the robot from files in this folder."""
    urdf, srdf = gantry(folder)
    return Robot.from_urdf(urdf, srdf=srdf)


def beside_a_post(folder: Path) -> CollisionChecker:
    """The robot beside a post at x = 0.5."""
    scene = Scene()
    scene.add("post", Body.box([0.2, 0.2, 2.0]), translation(0.5))
    return CollisionChecker(gantry_robot(folder), scene)


UP = np.pi / 2  # the rod beside the ball, along y
LEFT, RIGHT = np.array([-0.5, -0.5, UP]), np.array([0.5, -0.5, UP])
IN_WALL = np.array([0.0, -0.5, UP])


def wall() -> Scene:
    """A wall along y, 0.1 m thick, that ends at y = 0.5."""
    scene = Scene()
    scene.add("wall", Body.box([0.1, 4.0, 1.0]), translation(y=-1.5))
    return scene


def clearance(path: np.ndarray, until: float = 0.5) -> float:
    """Least distance of the ball to the wall, by geometry in the plane, on the path in steps of 1 mm or less."""
    steps = [np.linspace(a, b, 2000) for a, b in zip(path[:-1], path[1:], strict=True)]
    x, y = np.concatenate(steps)[:, :2].T
    return np.hypot(np.maximum(np.abs(x) - 0.05, 0), np.maximum(y - until, 0)).min() - RADIUS
