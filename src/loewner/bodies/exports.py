"""Write bodies for other programs, as MJCF, URDF and STL.

Spheres, cylinders, capsules, ellipsoids and boxes become shapes of the same type if the format has this type. Any other
polytope becomes a mesh whose convex hull is the polytope. A curved piece without a matching type is replaced with a
circumscribed polytope. An inner ellipsoid without a matching type is replaced with an inscribed polytope.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from loewner._base import _validate
from loewner._base._files import named_by_content, replacing
from loewner._base._matrices import dot, lengths, normals_of
from loewner._base._rotations import quaternions_of, to_rpy
from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies.kinds import CURVED, Mesh, ball, inradius
from loewner.bodies.pack import Packed
from loewner.bodies.triangulated import ellipsoids_of, of_pieces
from loewner.errors import InputError
from loewner.meshes.files.stl import FACETS

ELLIPSOIDS = ("inner", "outer")

# Kinds of curved pieces for which MJCF has a shape. Other curved pieces become meshes.
MJCF = ("sphere", "cylinder", "capsule", "ellipsoid")

# In a format without ellipsoids, an icosahedron that is subdivided DIVISIONS times replaces an ellipsoid. It has 320
# triangles, and deviates from the ellipsoid by at most 4 % of the semi-axes.
DIVISIONS = 2

# A polytope is written as a box if its corners deviate from the corners of a box by at most this relative distance,
# which is one or two roundings.
BOX_ROUNDING = 1e-13

# Area [m²] and volume [m³] below which MuJoCo may reject a mesh as too small; MuJoCo's limit is 1e-15.
SMALLEST = 1e-14

# Polytopes around curved shapes are enlarged by this factor, for the rounding of their corners.
OUTWARD = 1 + 1e-12


# Bound on MuJoCo's rounding of a mesh's corners, relative to the largest coordinate. MuJoCo stores the corners in
# single precision, in the frame of the mesh's axes of inertia.
SINGLE = 2.0**-20

# A mesh is convex if no corner is above a face by more than this share of the largest coordinate.
FLAT = 1e-9


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape and its pose in the body.

    Attributes
    ----------
    kind : str
        "sphere", "cylinder", "capsule", "ellipsoid", "box" or "mesh".
    sizes : tuple of float
        In metres: the radius of a sphere; the radius and the length of a cylinder; the radius and the length of the
        straight part of a capsule; the semi-axes of an ellipsoid; or the edge lengths of a box.
    rotation, center : ndarray, shapes (3, 3) and (3,)
        Pose of the shape; for a mesh, the identity and zero.
    mesh : tuple of ndarray, or None
        Vertices and triangles of a mesh, which is convex unless it is a solid.
    """

    kind: str
    sizes: tuple[float, ...]
    rotation: Floats
    center: Floats
    mesh: Mesh | None = None

    def wider(self, by: float) -> Shape:
        """Return the shape enlarged on each side; a solid or a sphere is returned unchanged.

        The corners of a convex mesh move slightly farther outward, to cover MuJoCo's rounding to single precision.
        """
        if not by or self.kind == "sphere":
            return self
        if self.mesh is not None:
            return replace(self, mesh=_wider_mesh(*self.mesh, by))
        sides = {"box": (2, 2, 2), "cylinder": (1, 2), "capsule": (1, 0)}.get(self.kind, (1, 1, 1))
        return replace(self, sizes=tuple(size + side * by for size, side in zip(self.sizes, sides, strict=True)))


def _wider_mesh(vertices: Floats, triangles: Any, by: float) -> Mesh:
    """Scale a convex mesh so that each face moves outward by at least `by`; return any other mesh unchanged."""
    middle = vertices.mean(axis=0)
    corners = vertices[triangles]
    normals = normals_of(corners)
    wide = lengths(normals) > 0.0
    normals, a = normals[wide] / lengths(normals)[wide, None], corners[wide, 0]
    heights = dot(normals, a - middle)
    size = float(np.abs(vertices).max())
    above = (vertices @ normals.T - dot(normals, a)).max()
    if not (heights.min() > 0.0 and above <= FLAT * size):
        return vertices, triangles
    share = (by + SINGLE * size) / float(heights.min())
    return middle + (1.0 + share) * (vertices - middle), triangles


def mjcf_text(packed: Packed, name: str, which: str | None) -> str:
    """Write an MJCF model of one body without joints."""
    if name == "world":
        raise InputError("name: expected another one than 'world', MuJoCo's name for its static body, found 'world'")
    root = ElementTree.Element("mujoco", model=name)
    asset = ElementTree.SubElement(root, "asset")
    body = ElementTree.SubElement(ElementTree.SubElement(root, "worldbody"), "body", name=name)
    add_geoms(body, asset, packed, which)
    return text_of(root)


def add_geoms(
    body: ElementTree.Element,
    asset: ElementTree.Element,
    packed: Packed,
    which: str | None = None,
    wider: float = 0.0,
) -> None:
    """Add a body's shapes to a body element of MJCF, and their meshes to the assets.

    The shapes are enlarged by `wider` [m] on each side.
    """
    name = body.attrib["name"]
    for number, shape in enumerate(each.wider(wider) for each in _listed(packed, which)):
        geom = ElementTree.SubElement(body, "geom", name=f"{name}_{number}", type=shape.kind)
        if shape.mesh is not None:
            vertices = numbers(shape.mesh[0].ravel())
            mesh = ElementTree.SubElement(asset, "mesh", name=f"{name}_{number}", vertex=vertices)
            if _is_small(*shape.mesh, number):
                mesh.set("inertia", "shell")  # for such a small volume, MuJoCo refuses any other inertia
            geom.set("mesh", f"{name}_{number}")
            continue
        half = {"box": [0.5] * 3, "cylinder": [1.0, 0.5], "capsule": [1.0, 0.5]}.get(shape.kind, 1.0)
        geom.set("size", numbers(np.multiply(shape.sizes, half)))
        geom.set("pos", numbers(shape.center))
        geom.set("quat", numbers(quaternions_of(shape.rotation)))


def _is_small(vertices: Floats, triangles: Any, number: int) -> bool:
    """Return whether MuJoCo could not compute the inertia of a mesh as a solid.

    Raises
    ------
    InputError
        If MuJoCo would also refuse the mesh as a surface.
    """
    corners = (vertices - vertices[0])[triangles]
    normals = normals_of(corners)
    area = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    if area < SMALLEST:
        raise InputError(
            f"expected pieces whose surface is at least {SMALLEST:g} m², since MuJoCo refuses smaller meshes, found "
            f"{area:.3g} m² in piece {number}; are the lengths in metres?"
        )
    return abs(float((corners[:, 0] * normals).sum())) / 6.0 < SMALLEST


def save_text(text: str, path: Path) -> None:
    """Write a file atomically: whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def save_urdf(packed: Packed, path: Path, which: str | None, mesh_prefix: str) -> None:
    """Write a robot with one link: first its mesh files, and then its URDF."""
    root = ElementTree.Element("robot", name=path.stem)
    link = ElementTree.SubElement(root, "link", name=path.stem)
    meshes = add_collisions(link, packed, path, which, mesh_prefix)
    with replacing(path) as temporary:  # a path that cannot be written raises an error before any mesh is written
        save_texts(meshes)
        temporary.write_text(text_of(root), encoding="utf-8")


def save_stl(packed: Packed, path: Path) -> None:
    """Write the triangles of all pieces, with corners rounded to single precision."""
    thick = (packed.layout[:, columns.KIND] < columns.POLYTOPE) & (packed.frames[:, 0] > 0.0)
    if thick.any():
        raise InputError(
            f"expected pieces bounded by triangles, found piece {int(thick.argmax())}, a surface or cloud with a radius"
        )
    corners = np.concatenate([vertices[triangles] for vertices, triangles in of_pieces(packed)])
    facets = np.zeros(len(corners), FACETS)
    facets["corners"] = corners
    corners = facets["corners"].astype(np.float64)
    normals = normals_of(corners)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, size, out=np.zeros_like(normals), where=size > 0)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(b"written by loewner".ljust(80) + struct.pack("<I", len(facets)))
        facets.tofile(file)


def add_collisions(
    link: ElementTree.Element,
    packed: Packed,
    path: Path,
    which: str | None,
    mesh_prefix: str,
    accepted: Callable[[Mesh], bool] | None = None,
    wider: float = 0.0,
) -> dict[Path, str]:
    """Add the shapes of a body to a link of the URDF at `path`, and return the contents of its mesh files.

    Shapes other than spheres and meshes are enlarged by `wider` [m] on each side. A solid becomes a mesh of its
    triangles if `accepted` returns true for this mesh. All other solids and all open surfaces are refused.
    """
    meshes: dict[Path, str] = {}
    listed = (shape.wider(wider) for shape in _listed(packed, which, accepted))
    for shape in (part for each in listed for part in _for_urdf(each, which)):
        collision = ElementTree.SubElement(link, "collision")
        add_origin(collision, shape.rotation, shape.center)
        geometry = ElementTree.SubElement(collision, "geometry")
        if shape.mesh is not None:
            text = _obj(*shape.mesh)
            file = path.with_name(named_by_content(path.stem, sha256(text.encode()).hexdigest(), ".obj"))
            meshes[file] = text
            ElementTree.SubElement(geometry, "mesh", filename=mesh_prefix + file.name)
        elif shape.kind == "box":
            ElementTree.SubElement(geometry, "box", size=numbers(shape.sizes))
        else:
            names = ("radius", "length")[: len(shape.sizes)]
            sizes = {size: numbers([value]) for size, value in zip(names, shape.sizes, strict=True)}
            ElementTree.SubElement(geometry, shape.kind, sizes)
    return meshes


def add_origin(element: ElementTree.Element, rotation: Floats, center: Floats) -> None:
    """Add a pose to an element of a URDF."""
    ElementTree.SubElement(element, "origin", xyz=numbers(center), rpy=numbers(to_rpy(rotation)))


def save_texts(texts: dict[Path, str]) -> None:
    """Write files, each atomically."""
    for file, text in texts.items():
        save_text(text, file)


def enlarged(packed: Packed) -> str | None:
    """Return the kind of the first piece that a larger polytope replaces because URDF lacks its shape, or None."""
    for row, frame in zip(packed.layout[:, columns.KIND].tolist(), packed.frames, strict=True):
        if row > columns.POLYTOPE:
            kind, semi_axes = CURVED[row], np.linalg.norm(frame[4:].reshape(3, 3), axis=0)
            if kind.name not in MJCF or (kind.name == "ellipsoid" and semi_axes.min() < semi_axes.max()):
                return kind.name
    return None


def plain_name(name: Any, what: str = "name") -> str:
    """Check that a name is accepted by all readers of the exported formats."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise InputError(f"{what}: expected letters, digits, '_', '.' and '-', found {_validate.short(name)}")
    return name


def prefix(text: Any) -> str:
    """Check the prefix of mesh file names, which may be any printable string."""
    if not isinstance(text, str) or not text.isprintable():
        raise InputError(f"mesh_prefix: expected printable text, found {_validate.short(text)}")
    return text


def numbers(values: Any) -> str:
    """Format numbers for an attribute, without rounding."""
    return " ".join(repr(value + 0.0) for value in np.asarray(values, dtype=np.float64).tolist())


def text_of(root: ElementTree.Element) -> str:
    """Write an element and its children as text, one line for each element."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _obj(vertices: Floats, triangles: Any) -> str:
    corners = (f"v {numbers(vertex)}\n" for vertex in vertices)
    faces = (f"f {a} {b} {c}\n" for a, b, c in (triangles + 1).tolist())
    return "".join(corners) + "".join(faces)


# -- shapes ----------------------------------------------------------------------------------------


def _listed(packed: Packed, which: str | None, accepted: Callable[[Mesh], bool] | None = None) -> list[Shape]:
    """Convert all pieces to shapes; with `which`, convert their inner or outer ellipsoids instead."""
    if which is not None:
        _validate.choice(which, "ellipsoids", ELLIPSOIDS)
        fitted = zip(*ellipsoids_of(packed, which), strict=True)
        shapes = [_ellipsoid(center, factor) for center, factor in fitted if factor.any()]
        if not shapes:
            raise InputError("expected a body with inner ellipsoids, found surfaces whose inner ellipsoids are points")
        return shapes
    surface, meshes = packed.layout[:, columns.KIND] < columns.POLYTOPE, of_pieces(packed)
    if accepted is not None:
        for number in np.flatnonzero(packed.layout[:, columns.KIND] == columns.SOLID):
            surface[number] = packed.frames[number, 0] > 0.0 or not accepted(meshes[number])
    if surface.any():
        raise InputError(
            f"expected convex pieces, found that piece {int(surface.argmax())} is a surface, a height field or a cloud "
            "of points, which these formats would replace with its convex hull; pass ellipsoids='outer', or make the "
            "body from convex pieces (Body.from_mesh, or voxel= for a cloud)"
        )
    return [_piece(packed, number, mesh) for number, mesh in enumerate(meshes)]


def _ellipsoid(center: Floats, factor: Floats) -> Shape:
    axes, lengths, _ = np.linalg.svd(factor)
    return Shape("ellipsoid", tuple(lengths.tolist()), _proper(axes), center)


def _piece(packed: Packed, number: int, mesh: Mesh) -> Shape:
    if packed.layout[number, columns.KIND] == columns.SOLID:
        return _mesh(mesh)
    if packed.layout[number, columns.KIND] == columns.POLYTOPE:
        return _box(mesh[0]) or _mesh(mesh)
    kind, frame = CURVED[int(packed.layout[number, columns.KIND])], packed.frames[number]
    radius, center, factor = float(frame[0]), frame[1:4], frame[4:].reshape(3, 3)
    lengths = np.linalg.norm(factor, axis=0)
    rotation = _proper(factor / lengths)
    if kind.name not in MJCF:
        unit = np.linalg.solve(factor, (mesh[0] - center).T).T * (OUTWARD / np.array(kind.inradii or inradius()))
        return _mesh((unit @ factor.T + center, mesh[1]))
    return Shape(kind.name, tuple(kind.sizes(radius, lengths.tolist())), rotation, center)


def _proper(axes: Floats) -> Floats:
    """Make axes right-handed; the first axis may be flipped, since every shape here is symmetric along it."""
    return axes if np.linalg.det(axes) > 0 else axes * [-1.0, 1.0, 1.0]


def _mesh(mesh: Mesh) -> Shape:
    """Make the shape of a mesh, without corners that no triangle uses."""
    used, triangles = np.unique(mesh[1], return_inverse=True)
    return Shape("mesh", (), np.eye(3), np.zeros(3), (mesh[0][used], triangles.reshape(-1, 3)))


def _box(vertices: Floats) -> Shape | None:
    """Find the box whose corners are the given points; None if there is no such box."""
    if len(vertices) != 8:
        return None
    from_first = vertices - vertices[0]
    order = np.argsort(np.linalg.norm(from_first, axis=1))
    # Edges lead from the first corner to the two corners nearest to it. The three edges add up to the diagonal.
    a, b, opposite = from_first[order[[1, 2, 7]]]
    edges = np.array([a, b, opposite - a - b])
    size = np.linalg.norm(edges, axis=1)
    if not size.all() or np.abs((edges @ edges.T) / np.outer(size, size) - np.eye(3)).max() > BOX_ROUNDING:
        return None
    corners = vertices[0] + np.array(list(product((0, 1), repeat=3))) @ edges
    apart = np.linalg.norm(corners[:, None] - vertices[None], axis=2).min(axis=0)
    if apart.max() > BOX_ROUNDING * (size.max() + np.abs(vertices).max()):
        return None
    return Shape("box", tuple(size.tolist()), _proper((edges / size[:, None]).T), vertices.mean(axis=0))


def _for_urdf(shape: Shape, which: str | None) -> Iterable[Shape]:
    """Convert a shape to shapes that every URDF reader supports: spheres, cylinders, boxes and meshes."""
    if shape.kind == "capsule":
        radius, length = shape.sizes
        tip = shape.rotation[:, 2] * (length / 2)
        ends = (Shape("sphere", (radius,), np.eye(3), shape.center + sign * tip) for sign in (-1, 1))
        return Shape("cylinder", shape.sizes, shape.rotation, shape.center), *ends
    if shape.kind != "ellipsoid":
        return (shape,)
    if min(shape.sizes) == max(shape.sizes):
        return (Shape("sphere", shape.sizes[:1], np.eye(3), shape.center),)
    unit, triangles = ball(DIVISIONS)
    if which != "inner":
        unit = unit * (OUTWARD / inradius(DIVISIONS))
    return (_mesh((unit * shape.sizes @ shape.rotation.T + shape.center, triangles)),)
