"""Draw bodies on the page: original meshes, pieces and ellipsoids, each sent once, when it is first shown.

Most pieces are drawn as triangles, in one node per body. Point clouds are drawn as points. Large numbers of balls or
ellipsoids are drawn as copies of one ball, since ten thousand of them would need millions of triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from loewner._base import _pictures
from loewner._base._rotations import quaternions_of
from loewner._base._validate import Floats
from loewner._kernels import columns
from loewner.bodies import Body, packed_of
from loewner.bodies.kinds import BALLS, Mesh, ball
from loewner.bodies.pack import Packed
from loewner.bodies.triangulated import MANY_PIECES, ellipsoids_of, joined, of_ellipsoids, of_piece, of_pieces
from loewner.queries.pairs import VERDICTS, Verdict

Rgb = tuple[int, int, int]

# Colour-blind people can distinguish these colours, and the name of the verdict is always written next to its colour.
VERDICT_COLOURS: dict[Verdict, Rgb] = dict(zip(VERDICTS, _pictures.VERDICT_COLOURS, strict=True))
INNER, OUTER = (68, 119, 170), (119, 119, 119)

# Colours of the two bodies on a page. The colours differ from the verdicts' colours, and from each other for all kinds
# of colour vision.
PAIR: dict[str, Rgb] = {"A": (102, 153, 204), "B": (238, 153, 85)}

LABELS = {"meshes": "meshes", "pieces": "pieces", "inner": "inner ellipsoids", "outer": "outer ellipsoids"}

# Opacity of a piece while a layer inside it is shown, and of an outer ellipsoid.
PIECE_OPACITY, OUTER_OPACITY = 0.45, 0.22

# A copy of a ball has 320 triangles, or 80 if there are more than MANY_COPIES copies.
MANY_COPIES = 2000

# Colour of the near points, their line and the normal; visible on white and on black.
INK = (170, 51, 119)

# Layers whose colour shows contact, and how each layer is drawn. If triangles face outward, only triangles that face
# the camera are drawn. For an outer ellipsoid, only the far half is drawn, because the near half, although transparent,
# would hide objects that are drawn later. The triangles of files and surfaces may face either way.
COLOURED = ("meshes", "pieces")
LOOKS: dict[str, dict[str, Any]] = {
    "meshes": {"flat_shading": True, "side": "double"},
    "pieces": {"flat_shading": True, "side": "front"},
    "inner": {"color": INNER, "side": "front"},
    "outer": {"color": OUTER, "opacity": OUTER_OPACITY, "side": "back"},
}

# Light from everywhere, so that faces turned away from the lamps are not black.
AMBIENT = 1.2


def add_mesh(scene: Any, name: str, mesh: Mesh, **look: Any) -> Any:
    """Add triangles to the page's scene, without shadows, since shadows would require drawing everything twice."""
    vertices, triangles = mesh
    return scene.add_mesh_simple(
        name, vertices.astype(np.float32), triangles.astype(np.uint32), cast_shadow=False, receive_shadow=False, **look
    )


@dataclass(frozen=True)
class Triangles:
    """Triangles, as vertices (v, 3) [m] and indices of vertices (t, 3)."""

    vertices: Floats
    triangles: Any

    def add(self, scene: Any, name: str, look: dict[str, Any]) -> Any:
        """Add the triangles to the page's scene."""
        return add_mesh(scene, name, (self.vertices, self.triangles), **look)

    def box(self, T: Floats) -> Floats:
        """Return the bounding box at a pose: its lowest and highest corner, shape (2, 3), in metres."""
        return _box(self.vertices @ T[:3, :3].T + T[:3, 3], 0.0)


@dataclass(frozen=True)
class Points:
    """Balls of equal radius around points, shape (n, 3) [m]."""

    points: Floats
    radius: float

    def add(self, scene: Any, name: str, look: dict[str, Any]) -> Any:
        """Add the balls to the page's scene as points whose size is the radius."""
        return scene.add_point_cloud(
            name, self.points.astype(np.float32), look["color"], point_size=self.radius, point_shape="circle",
            precision="float32",
        )  # fmt: skip

    def box(self, T: Floats) -> Floats:
        """Return the bounding box at a pose: its lowest and highest corner, shape (2, 3), in metres."""
        return _box(self.points @ T[:3, :3].T + T[:3, 3], self.radius)


@dataclass(frozen=True)
class Copies:
    """Images c + F u of the unit ball, as centers (n, 3) and factors (n, 3, 3) [m]."""

    centers: Floats
    factors: Floats

    def add(self, scene: Any, name: str, look: dict[str, Any]) -> Any:
        """Add the copies to the page's scene."""
        turns, lengths, _ = np.linalg.svd(self.factors)
        turns[..., 0] *= np.sign(np.linalg.det(turns))[:, None]
        vertices, triangles = ball(1 if len(self.centers) > MANY_COPIES else 2)
        return scene.add_batched_meshes_simple(
            name, vertices.astype(np.float32), triangles.astype(np.uint32), quaternions_of(turns).astype(np.float32),
            self.centers.astype(np.float32), batched_scales=lengths.astype(np.float32), batched_colors=look["color"],
            opacity=look.get("opacity"), side=look["side"], lod="off", cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def box(self, T: Floats) -> Floats:
        """Return the bounding box at a pose: its lowest and highest corner, shape (2, 3), in metres."""
        return _box(self.centers @ T[:3, :3].T + T[:3, 3], np.linalg.norm(T[:3, :3] @ self.factors, axis=-1))


Part = Triangles | Points | Copies


class Drawing:
    """The nodes that show one body, below a given node of the page's scene.

    Parameters
    ----------
    scene
        The scene of viser's server.
    parent : str
        Name of the node that has the body's pose.
    body : Body
    colour : tuple of int
        Colour of pieces and mesh.
    shown : dict
        Visibility of each layer, by name.
    mesh : callable, optional
        Returns the triangles from which the body was made, in its frame, or None if there are none. The function is
        called when the mesh is first shown. A body without a mesh shows its pieces instead, so that it does not vanish
        from the page.
    """

    def __init__(
        self,
        scene: Any,
        parent: str,
        body: Body,
        colour: Rgb,
        shown: dict[str, bool],
        mesh: Callable[[], Mesh | None] = lambda: None,
    ) -> None:
        self._scene, self._parent, self._body = scene, parent, body
        self._colour = colour
        self._mesh = mesh
        self._nodes: dict[str, Any] = {}
        self._layers: dict[str, list[str]] = {}
        self._callback: Any = None
        self._clear = self._covering = False
        self.show(shown)

    @property
    def colour(self) -> Rgb:
        """Colour of pieces and mesh."""
        return self._colour

    @colour.setter
    def colour(self, colour: Rgb) -> None:
        if colour != self._colour:
            self._colour = colour
            for layer in COLOURED:
                for name in self._layers.get(layer, ()):
                    _paint(self._nodes[name], colour)

    def box(self, T: Floats) -> Floats:
        """Return the bounding box of the pieces at a pose: its lowest and highest corner, shape (2, 3), in metres."""
        return spanned(part.box(T) for part in self._pieces)

    def show(self, shown: dict[str, bool]) -> None:
        """Switch layers on and off. Pieces become transparent if layers inside them are shown."""
        wanted = {layer for layer in LABELS if shown.get(layer, False)}
        if "meshes" in wanted and not self._made("meshes"):
            wanted = wanted - {"meshes"} | {"pieces"}
        for layer in LABELS:
            for name in self._made(layer) if layer in wanted else self._layers.get(layer, ()):
                self._nodes[name].visible = layer in wanted
        self._covering = bool(wanted & {"meshes", "inner"})
        self.see_through(self._clear)

    def see_through(self, clear: bool) -> None:
        """Make the pieces transparent, or opaque again. They stay transparent while layers inside them are shown."""
        self._clear = clear
        for name in self._layers.get("pieces", ()):
            if hasattr(self._nodes[name], "opacity"):  # points have no opacity
                self._nodes[name].opacity = PIECE_OPACITY if clear or self._covering else None

    def on_click(self, callback: Any) -> None:
        """Register a callback for clicks on the body."""
        self._callback = callback
        for node in self._nodes.values():
            self._listen(node)

    @cached_property
    def _pieces(self) -> list[Part]:
        return parts(self._body)

    def _parts(self, layer: str) -> list[Part]:
        if layer == "pieces":
            return self._pieces
        if layer != "meshes":
            return outlines(self._body, layer)
        mesh = self._mesh()
        return [] if mesh is None or not len(mesh[1]) else [Triangles(*mesh)]

    def _made(self, layer: str) -> list[str]:
        """Return the names of a layer's nodes, which are made when they are first needed. An empty layer has none."""
        if layer not in self._layers:
            look = {**LOOKS[layer], "color": self._colour} if layer in COLOURED else LOOKS[layer]
            if layer == "pieces" and any(piece.kind in ("surface", "solid") for piece in self._body.pieces):
                look = {**look, "side": "double"}
            shapes = self._parts(layer)
            if not shapes:
                self._nodes[layer] = None
            self._layers[layer] = [layer, *(f"{layer} {k}" for k in range(1, len(shapes)))][: len(shapes)]
            for name, part in zip(self._layers[layer], shapes, strict=True):
                self._nodes[name] = part.add(self._scene, f"{self._parent}/{name}", look)
                self._listen(self._nodes[name])
        return self._layers[layer]

    def _listen(self, node: Any) -> None:
        if self._callback is not None and hasattr(node, "on_click"):  # points have no clicks
            node.on_click(self._callback)


class NearPoints:
    """Marks at the two points where bodies are nearest, or deepest in each other, and the line between the points."""

    def __init__(self, scene: Any, size: float) -> None:
        dot = size / 120
        self._dots = [scene.add_icosphere(f"/near/{k}", dot, INK, subdivisions=2, visible=False) for k in "ab"]
        ends = np.zeros((1, 2, 3), dtype=np.float32)
        self._line = scene.add_line_segments("/near/line", ends, INK, thickness=dot / 2, visible=False)

    def show(self, a: Floats, b: Floats) -> None:
        """Show the marks at two points of the world."""
        for dot, at in zip(self._dots, (a, b), strict=True):
            dot.position, dot.visible = at, True
        # The line gets a new pose, not new ends, because a slow browser would draw new ends later than it moves the
        # dots.
        length = float(np.linalg.norm(b - a))
        x, y, z = (b - a) / length if length > 0 else (1.0, 0.0, 0.0)
        wxyz = np.array([1.0 + x, 0.0, -z, y]) if x > -0.999999 else np.array([0.0, 0.0, 0.0, 1.0])
        self._line.wxyz, self._line.position = wxyz / np.linalg.norm(wxyz), a
        self._line.points = np.array([[[0.0, 0.0, 0.0], [length, 0.0, 0.0]]], dtype=np.float32)
        self._line.visible = True

    def hide(self) -> None:
        """Hide the marks."""
        for node in (*self._dots, self._line):
            node.visible = False


def _paint(node: Any, colour: Rgb) -> None:
    """Set the colour of a node, which may consist of triangles, points or copies."""
    for name in ("color", "colors", "batched_colors"):
        if hasattr(node, name):
            setattr(node, name, colour if name == "color" else np.array(colour, dtype=np.uint8))
            return


def spanned(boxes: Iterable[Floats]) -> Floats:
    """Return the lowest and highest corner of several boxes together, shape (2, 3)."""
    corners = np.array(list(boxes))
    return np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def _box(points: Floats, around: Floats | float) -> Floats:
    return np.array([(points - around).min(axis=0), (points + around).max(axis=0)])


def parts(body: Body) -> list[Part]:
    """Make the shapes for a body's pieces: one for all triangles, one per point cloud, and one for many balls."""
    packed = packed_of(body)
    kinds = packed.layout[:, columns.KIND]
    clouds = [number for number in np.flatnonzero(kinds == columns.SURFACE).tolist() if _is_cloud(packed, number)]
    round_ones = np.isin(kinds, BALLS)
    copied = np.flatnonzero(round_ones) if round_ones.sum() > MANY_PIECES else np.array([], dtype=np.int64)
    others = np.setdiff1d(np.arange(len(kinds)), [*clouds, *copied])
    shapes: list[Part] = []
    if len(others):
        shapes.append(Triangles(*joined(of_piece(packed, number) for number in others.tolist())))
    if len(copied):
        frames = packed.frames[copied]
        radii = frames[:, 0]  # radius of a ball around a point, or 0 for an ellipsoid
        balls = radii[:, None, None] * np.eye(3)
        factors = np.where((radii > 0)[:, None, None], balls, frames[:, 4:].reshape(-1, 3, 3))
        shapes.append(Copies(frames[:, 1:4], factors))
    for number in clouds:
        row, radius = packed.layout[number], float(packed.frames[number, 0])
        shapes.append(Points(packed.points[row[columns.POINTS_FROM] : row[columns.POINTS_TO]], radius))
    return shapes


def _is_cloud(packed: Packed, number: int) -> bool:
    """Return whether all triangles of a surface are single points, with balls around them."""
    corners = packed.triangles[packed.triangle_start[number] : packed.triangle_start[number + 1]]
    return bool(packed.frames[number, 0] > 0 and (corners == corners[:, :1]).all())


def outlines(body: Body, which: str) -> list[Part]:
    """Make the shapes for all inner, or all outer, ellipsoids of a body, omitting inner ellipsoids that are points."""
    centers, factors = ellipsoids_of(packed_of(body), which)
    if len(centers) > MANY_PIECES:
        drawn = factors.any(axis=(1, 2))
        return [Copies(centers[drawn], factors[drawn])] if drawn.any() else []
    mesh = ellipsoids(body, which)
    return [Triangles(*mesh)] if len(mesh[1]) else []


def pieces(body: Body) -> Mesh:
    """Return the surface triangles of all pieces of a body, in its frame."""
    return joined(of_pieces(packed_of(body)))


def ellipsoids(body: Body, which: str) -> Mesh:
    """Return the triangles of all inner, or all outer, ellipsoids of a body, in its frame. Points are omitted."""
    return joined(of_ellipsoids(packed_of(body), which).values())


def place(node: Any, T: Floats) -> None:
    """Put a node of the page's scene at a pose."""
    node.wxyz, node.position = quaternions_of(T[:3, :3]), T[:3, 3]


def light(scene: Any) -> None:
    """Light the scene only with lamps, since reflections of the surroundings would double the cost of drawing."""
    scene.configure_environment_map(None)
    scene.configure_default_lights(cast_shadow=False)
    scene.add_light_ambient("/light", intensity=AMBIENT)
