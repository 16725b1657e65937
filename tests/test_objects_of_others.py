"""Objects of other libraries: an attribute that changes what their numbers mean is used, or refused by name.

Curves of SciPy are in `test_trajectories.py`, tables with columns in another order in `test_robots.py`, masked arrays
in `test_bad_input.py`, tensors in `test_torch.py`, and what MuJoCo computes with and is not read in `test_mjcf.py`.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import loewner
from loewner import Body, GeometryError, InputError, Robot
from loewner.meshes import decomposition as meshes

SLIDE = """<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="prismatic"><parent link="a"/>
<child link="b"/><limit lower="-1" upper="1" velocity="1"/></joint></robot>"""


class Quantity(np.ndarray):
    """An array with a unit of length or angle, as of astropy or pint: NumPy converts it to its bare numbers."""

    unit = "mm"


def box(units: str | None, size: float = 1.0) -> trimesh.Trimesh:
    """A cube that states its unit."""
    mesh = trimesh.creation.box([size] * 3)
    mesh.units = units
    return mesh


def scene_of(*parts: trimesh.Trimesh) -> trimesh.Scene:
    """Meshes beside each other, by transforms of the scene."""
    scene = trimesh.Scene()
    for k, mesh in enumerate(parts):
        T = np.eye(4)
        T[0, 3] = 500.0 * k
        scene.add_geometry(mesh, transform=T)
    return scene


def test_the_unit_and_the_transforms_of_a_scene_count():
    """Two cubes of 100 mm, 500 mm apart."""
    vertices, _ = meshes.load(scene_of(box("mm", 100.0), box("mm", 100.0)))
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.6, 0.1, 0.1], atol=1e-12)


@pytest.mark.parametrize("units", [("mm", "m"), ("m", "mm"), ("mm", None)])
def test_a_scene_of_several_units_is_refused(units):
    """Trimesh would join the meshes with the numbers of each: a mesh of metres would be a thousandth as large."""
    with pytest.raises(GeometryError, match="one unit of length, found .*mm.*convert_units|known unit of length"):
        Body.from_surface(scene_of(*map(box, units)))


def test_polygons_that_are_no_triangles_are_refused():
    """Other libraries have the same names for faces of four corners, and for counts and corners in one row."""
    mesh = box(None)
    for faces in (np.zeros((6, 4), dtype=int), np.array([3, 0, 1, 2, 3, 0, 2, 3])):
        with pytest.raises(GeometryError, match="mesh.faces: expected shape"):
            meshes.load(SimpleNamespace(vertices=mesh.vertices, faces=faces))


@pytest.mark.parametrize(
    "ask",
    [
        lambda x: Body.box(x),
        lambda x: Body.from_points(np.stack([x, 2 * x, 3 * x, x[::-1] ** 2]).view(Quantity)),
        lambda x: Robot.from_urdf(text=SLIDE).forward_kinematics(x[:1]),
        lambda x: loewner.Ellipsoids.from_semi_axes(np.zeros(3), x),
        lambda x: Body.from_points([x, 2 * x, 3 * x, (x[::-1] ** 2)]),
        lambda x: Body.sphere(x[0:1].reshape(())),
        lambda x: Robot.from_urdf(text=SLIDE).forward_kinematics([x[0:1].reshape(())]),
        lambda x: loewner.Scene().add("a", Body.sphere(1.0), np.eye(4).view(Quantity)),
    ],
)
def test_quantities_with_units_are_refused(ask):
    """Their numbers would be taken for metres and radians."""
    with pytest.raises(InputError, match="expected plain numbers in metres or radians, found a quantity in 'mm'"):
        ask(np.array([1.0, 2.0, 3.0]).view(Quantity))


def test_numbers_without_a_unit_are_numbers():
    """A subclass of arrays whose unit is None."""

    class Plain(np.ndarray):
        unit = None

    assert Body.box(np.ones(3).view(Plain)).outer.volume[0] > 1


def test_a_column_of_that_name_is_no_unit():
    """A table of pandas has its columns as attributes."""

    class Table(np.ndarray):
        unit = property(lambda self: np.zeros(3))

    assert Body.box(np.ones(3).view(Table)).outer.volume[0] > 1
