"""Read the appearance of a robot's links, that is, the visual geometry of its URDF, which no query uses."""

from __future__ import annotations

from loewner.bodies.kinds import Mesh
from loewner.bodies.triangulated import joined
from loewner.errors import LoewnerError
from loewner.robots import Robot
from loewner.robots.link_bodies import mesh_file, placed_mesh, primitive
from loewner.robots.robot import source_of
from loewner.robots.urdf import Shape, read_visuals
from loewner.viewer.drawing import pieces


def visual_meshes(robot: Robot) -> tuple[dict[str, Mesh], list[str]]:
    """Read the visual geometry of a robot's links.

    Parameters
    ----------
    robot : Robot

    Returns
    -------
    meshes : dict
        Maps link names to vertices (v, 3) [m] and triangles (t, 3), in the frame of the link.
    faults : list of str
        Reasons why meshes are missing, since a picture without them is still worth showing.
    """
    format, text = source_of(robot)
    if format != "URDF":
        return {}, [f"{robot.urdf}: of an MJCF file, what looks only is not read"]
    try:
        shapes, faults = read_visuals(robot.urdf, text)
    except LoewnerError as error:  # moved or overwritten since the robot was read
        return {}, [str(error)]
    meshes = {}
    for link, looks in shapes.items():
        parts = []
        for shape in looks:
            try:
                parts.append(_triangles(shape, link, robot))
            except LoewnerError as error:
                faults.append(str(error))
        if parts and link in robot.link_names:
            meshes[link] = joined(parts)
    return meshes, faults


def _triangles(shape: Shape, link: str, robot: Robot) -> Mesh:
    if shape.kind != "mesh":
        return pieces(primitive(shape))
    return placed_mesh(mesh_file(shape, link, robot.urdf, robot.package_dirs), shape)
