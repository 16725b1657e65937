"""Bodies as triangles: original mesh, pieces and ellipsoids, each sent to the page once, when it is first shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from loewner._validate import Floats
from loewner.bodies import Body
from loewner.bodies.triangulated import Mesh, joined, of_ellipsoids, of_pieces
from loewner.queries import Verdict

Rgb = tuple[int, int, int]

# Told apart by the colour-blind too; the name of the verdict is always written next to its colour.
VERDICT_COLOURS: dict[Verdict, Rgb] = {
    Verdict.FREE: (34, 136, 51),
    Verdict.AMBIGUOUS: (221, 170, 51),
    Verdict.COLLIDING: (204, 51, 68),
}
INNER, OUTER = (68, 119, 170), (119, 119, 119)

LABELS = {"meshes": "meshes", "pieces": "pieces", "inner": "inner ellipsoids", "outer": "outer ellipsoids"}

# How much hides what is behind: a piece with something inside it on, and an outer ellipsoid.
PIECE_OPACITY, OUTER_OPACITY = 0.45, 0.22

# Layers in the colour that tells what touches, and how each layer is drawn. Where triangles face outward only those
# that face the camera are drawn: half as many. Of an outer ellipsoid it is those that do not, for the near side would
# hide what is drawn after it, though it can be seen through. The triangles of a file face anywhere, and so do those of
# surfaces.
COLOURED = ("meshes", "pieces")
LOOKS: dict[str, dict[str, Any]] = {
    "meshes": {"flat_shading": True, "side": "double"},
    "pieces": {"flat_shading": True, "side": "front"},
    "inner": {"color": INNER, "side": "front"},
    "outer": {"color": OUTER, "opacity": OUTER_OPACITY, "side": "back"},
}

# Light from everywhere, so that faces turned away from the lamps are not black.
AMBIENT = 1.2


class Drawing:
    """The nodes that show one body below a node of the page's scene.

    Parameters
    ----------
    scene
        The scene of viser's server.
    parent : str
        Name of the node that carries the body's pose.
    body : Body
    colour : tuple of int
        Of pieces and mesh.
    shown : dict
        Which layers show, by their names.
    mesh : callable, optional
        Gives the triangles that the body was made from, in its frame, or None where there are none; asked when they
        are first to be shown. A body without a mesh shows its pieces instead: it must not vanish from the page.
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
        self._scene, self._parent = scene, parent
        self._colour = colour
        self._any_surface = any(piece.kind in ("surface", "solid") for piece in body.pieces)
        self._makers: dict[str, Callable[[], Mesh | None]] = {
            "meshes": mesh,
            "pieces": lambda: pieces(body),
            "inner": lambda: ellipsoids(body, "inner"),
            "outer": lambda: ellipsoids(body, "outer"),
        }
        self._nodes: dict[str, Any] = {}
        self._callback: Any = None
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
                if self._nodes.get(layer) is not None:
                    self._nodes[layer].color = colour

    def show(self, shown: dict[str, bool]) -> None:
        """Switch layers on and off; pieces let what is inside them shine through."""
        wanted = {layer for layer in LABELS if shown.get(layer, False)}
        if "meshes" in wanted and self._node("meshes") is None:
            wanted = wanted - {"meshes"} | {"pieces"}
        for layer in LABELS:
            node = self._node(layer) if layer in wanted else self._nodes.get(layer)
            if node is not None:
                node.visible = layer in wanted
        if self._nodes.get("pieces") is not None:
            self._nodes["pieces"].opacity = PIECE_OPACITY if wanted & {"meshes", "inner"} else None

    def on_click(self, callback: Any) -> None:
        """Call back when the body is clicked."""
        self._callback = callback
        for node in self._nodes.values():
            if node is not None:
                node.on_click(callback)

    def _node(self, layer: str) -> Any:
        """Node of a layer, made when it is first asked for; None if there is nothing to draw."""
        if layer not in self._nodes:
            made = self._makers[layer]()
            self._nodes[layer] = None
            if made is not None and len(made[1]):
                look = {**LOOKS[layer], "color": self._colour} if layer in COLOURED else LOOKS[layer]
                if layer == "pieces" and self._any_surface:
                    look = {**look, "side": "double"}
                self._nodes[layer] = add_mesh(self._scene, f"{self._parent}/{layer}", made, **look)
                if self._callback is not None:
                    self._nodes[layer].on_click(self._callback)
        return self._nodes[layer]


def add_mesh(scene: Any, name: str, mesh: Mesh, **look: Any) -> Any:
    """Add triangles to the page's scene, with no shadows: they would cost a second drawing of everything."""
    vertices, triangles = mesh
    return scene.add_mesh_simple(
        name, vertices.astype(np.float32), triangles.astype(np.uint32), cast_shadow=False, receive_shadow=False, **look
    )


def pieces(body: Body) -> Mesh:
    """Surface triangles of all pieces of a body, in its frame."""
    return joined(of_pieces(body._packed))


def ellipsoids(body: Body, which: str) -> Mesh:
    """Triangles of all inner, or all outer, ellipsoids of a body, in its frame; none of inner ones that are points."""
    return joined(of_ellipsoids(body._packed, which).values())


def quaternions(rotations: Floats) -> Floats:
    """Unit quaternions wxyz of rotation matrices, shape (..., 3, 3) to (..., 4)."""
    xyzw = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat()
    return np.asarray(np.roll(xyzw, 1, axis=-1).reshape(*rotations.shape[:-2], 4))


def place(node: Any, T: Floats) -> None:
    """Put a node of the page's scene at a pose."""
    node.wxyz, node.position = quaternions(T[:3, :3]), T[:3, 3]


def light(scene: Any) -> None:
    """Light the scene by lamps alone: surroundings mirrored in all surfaces would double the cost of drawing."""
    scene.configure_environment_map(None)
    scene.configure_default_lights(cast_shadow=False)
    scene.add_light_ambient("/light", intensity=AMBIENT)
