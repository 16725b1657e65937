"""Read the appearance of a robot's links: the visual geometry in its URDF, which no query uses."""

from __future__ import annotations

from loewner.bodies.kinds import Mesh
from loewner.bodies.triangulated import joined
from loewner.errors import LoewnerError
from loewner.robots import Robot
from loewner.robots.description.assembly import Source
from loewner.robots.description.link_bodies import mesh_file, placed_mesh, primitive
from loewner.robots.description.robot import sources_of
from loewner.robots.description.urdf import Shape, read_visuals
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
        Reasons why meshes are missing. A picture without these meshes is still worth showing.
    """
    meshes: dict[str, Mesh] = {}
    faults: list[str] = []
    for source in sources_of(robot):
        if source.format == "links":
            continue
        if source.format != "URDF":
            faults.append(f"{source.path}: of an MJCF file, what looks only is not read")
            continue
        try:
            shapes, more = read_visuals(source.path, source.text)
        except LoewnerError as error:  # the file was moved or overwritten after the robot was read
            shapes, more = {}, [str(error)]
        faults += more
        for link, looks in shapes.items():
            parts = []
            for shape in looks:
                try:
                    parts.append(_triangles(shape, link, source))
                except LoewnerError as error:
                    faults.append(str(error))
            if parts and source.prefix + link in robot.link_names:
                meshes[source.prefix + link] = joined(parts)
    return meshes, faults


def _triangles(shape: Shape, link: str, source: Source) -> Mesh:
    if shape.kind != "mesh":
        return pieces(primitive(shape))
    return placed_mesh(mesh_file(shape, link, source.path, source.package_dirs), shape)
