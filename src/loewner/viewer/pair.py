"""Define the page for two bodies, on which users drag the bodies and see the verdict change."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner._base import _validate
from loewner._base._validate import Floats
from loewner.bodies import Body
from loewner.bodies.kinds import Mesh
from loewner.errors import InputError
from loewner.meshes import decomposition as meshes
from loewner.queries.pairs import Distance, Verdict, classify, collide, distance
from loewner.viewer.drawing import INK, LABELS, PAIR, VERDICT_COLOURS, Drawing
from loewner.viewer.framing import diagonal, framed
from loewner.viewer.page import Mover, PoseInputs, Viewer, certified_words

# The first view shows only the smaller body if a view of both bodies would be more than WIDEST times as wide.
WIDEST = 12.0


def show_pair(
    a: Body,
    T_world_a: ArrayLike | None,
    b: Body,
    T_world_b: ArrayLike | None,
    *,
    margin: float = 0.0,
    mesh_a: meshes.Source | None = None,
    mesh_b: meshes.Source | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    block: bool = False,
) -> PairViewer:
    """Open a page that shows two movable bodies and their verdict.

    Parameters
    ----------
    a, b : Body
    T_world_a, T_world_b : array_like, shape (4, 4), or None
        Initial poses, with translations in metres. None is the identity.
    margin : float
        Distance in metres that the bodies must keep.
    mesh_a, mesh_b : path, trimesh.Trimesh or trimesh.Scene, optional
        The meshes from which the bodies were made, in the frames of the bodies. The meshes form a separate layer, which
        is hidden at first, because the pieces are checked, not the meshes. A body without a mesh shows its pieces in
        this layer.
    host : str
        Address on which the server listens. The default, "::1" and "localhost" restrict the page to this machine. With
        any other host, anyone who has the page's address can open the page and move the bodies. The address ends in a
        random token and is printed once. "0.0.0.0" stands for all addresses of this machine.
    port : int
        The port on which the server listens; 0 means any free port.
    block : bool
        Whether to return only after the page is closed or a keyboard interrupt.

    Returns
    -------
    PairViewer

    Raises
    ------
    MissingExtraError
        If viser is not installed, or its version cannot be made to refuse requests from other sites.
    InputError
        If an operand is not a body, the margin is negative, the host does not belong to this machine, or the port is
        taken.
    PoseError
        If a pose is not a rigid motion.
    FileError, GeometryError
        If a mesh cannot be read.

    Examples
    --------
    >>> from loewner import viewer
    >>> T = [[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> page = viewer.show_pair(Body.box([1, 1, 1]), None, Body.sphere(0.5), T)
    >>> page.url.startswith("http://localhost:"), page.verdict.name  # to be opened in a browser
    (True, 'FREE')
    >>> page.close()
    """
    waits = _validate.flag(block, "block")
    for body, name in ((a, "a"), (b, "b")):
        _validate.instance(body, name, Body)
        if not body.pieces:
            raise InputError(f"{name}: expected a body with pieces, found an empty one")
    least = _validate.positive_scalar(margin, "margin", zero=True)
    looks = {name: meshes.load(mesh) for name, mesh in (("A", mesh_a), ("B", mesh_b)) if mesh is not None}
    first = {"A": _validate.pose(T_world_a, "T_world_a"), "B": _validate.pose(T_world_b, "T_world_b")}
    viewer = PairViewer(a, b, first, looks, least, host, port)
    if waits:
        viewer.wait()
    return viewer


class PairViewer(Viewer):
    """A page for two bodies, which `show_pair` made.

    Attributes
    ----------
    verdict : Verdict
        The certified answer that the page shows; AMBIGUOUS if no answer could be computed.
    colliding : bool
        The exact answer; True if no answer could be computed.
    found : Distance
        The bounds, the estimate, the exact distance, the near points and the normal.

    Examples
    --------
    >>> from loewner import viewer
    >>> with viewer.show_pair(Body.box([1, 1, 1]), None, Body.sphere(0.5), None) as page:
    ...     page.T_world_b = [[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]  # moves it on the page
    ...     page.verdict.name, round(page.found.distance, 9)
    ('FREE', 1.0)
    """

    found: Distance

    def __init__(
        self, a: Body, b: Body, first: dict[str, Floats], looks: dict[str, Mesh], margin: float, host: str, port: int
    ) -> None:
        self.a, self.b, self._first, self._meshes, self._margin = a, b, first, looks, margin
        super().__init__("loewner: two bodies", host, port)

    @property
    def T_world_a(self) -> Floats:
        """Pose of a, shape (4, 4). Set it to move the body on the page."""
        return self._movers["A"].T.copy()

    @T_world_a.setter
    def T_world_a(self, T: ArrayLike | None) -> None:
        self._move("A", _validate.pose(T, "T_world_a"))

    @property
    def T_world_b(self) -> Floats:
        """Pose of b, shape (4, 4). Set it to move the body on the page."""
        return self._movers["B"].T.copy()

    @T_world_b.setter
    def T_world_b(self, T: ArrayLike | None) -> None:
        self._move("B", _validate.pose(T, "T_world_b"))

    def _move(self, name: str, T: Floats) -> None:
        with self._changing():
            self._movers[name].move(T)
            self._inputs[name].show(T)

    # -- the page ---------------------------------------------------------------------------------

    def _build(self) -> None:
        gui, scene, poses = self.server.gui, self.server.scene, self._first
        with gui.add_folder("Show"):
            self._add_layers(k for k in LABELS if k != "meshes" or self._meshes)
        self._movers, self._inputs, self._drawings = {}, {}, {}
        for (name, T), body in zip(poses.items(), (self.a, self.b), strict=True):
            self._movers[name] = Mover(self, f"/{name}", name, T)
            self._drawings[name] = Drawing(
                scene, f"/{name}", body, PAIR[name], self._which(), partial(self._meshes.get, name)
            )
        boxes = {name: self._drawings[name].box(T) for name, T in poses.items()}
        small, large = sorted(boxes.values(), key=diagonal)
        self._frame_view(framed(small, [large], WIDEST))
        for name, mover in self._movers.items():
            mover.fit(boxes[name], self._size)
            with gui.add_folder(f"Body {name}"):
                self._inputs[name] = PoseInputs(self, name, self._size)
                self._inputs[name].show(mover.T)
        dot = self._size / 120
        ends = np.zeros((1, 2, 3), dtype=np.float32)
        self._normal = scene.add_arrows(
            "/near/normal", ends, INK, shaft_radius=dot / 2, head_radius=1.5 * dot, head_length=3 * dot
        )

    def _show_gizmos(self) -> None:
        for mover in self._movers.values():
            mover.show(not self._pictured)

    def _take(self, done: dict[str, Any]) -> None:
        for name, mover in self._movers.items():
            if f"drag {name}" in done:
                self._inputs[name].show(mover.take())
            elif f"type {name}" in done:
                mover.move(self._inputs[name].take())
        if "layers" in done:
            for drawing in self._drawings.values():
                drawing.show(self._which())

    def _answer(self) -> None:
        operands: tuple[Any, ...] = self.a, self._movers["A"].T, self.b, self._movers["B"].T
        self.verdict = classify(*operands, margin=self._margin)
        self.colliding = collide(*operands, margin=self._margin)
        self.found = distance(*operands, exact=True)
        exactly = Verdict.COLLIDING if self.colliding else Verdict.FREE
        swatches = {f"on {name}": colour for name, colour in PAIR.items()}
        self._show_verdict(exactly.name, VERDICT_COLOURS[exactly], self._rows(), [], swatches)
        self._show_near()

    def _show_failure(self, error: Exception) -> None:
        super()._show_failure(error)
        self._normal.visible = False

    def _rows(self) -> list[tuple[str, str]]:
        gap = self.found
        kind = "depth" if gap.distance < 0 else "distance"
        rows = [
            (kind, f"{abs(gap.distance):.6g} m"),
            ("ellipsoids", certified_words(self.verdict)),
            ("bounds", f"{gap.lower:z.6g} .. {gap.upper:z.6g} m"),
            ("estimate", f"{gap.estimate:z.6g} m"),
            ("on A", _numbers(gap.witness_a)),
            ("on B", _numbers(gap.witness_b)),
            ("normal", _numbers(gap.normal)),
        ]
        return rows + ([("margin", f"{self._margin:g} m")] if self._margin else [])

    def _show_near(self) -> None:
        # If the bodies overlap, the near points are inside them.
        for drawing in self._drawings.values():
            drawing.see_through(self._marks["near"].value and self.found.distance < 0)
        if not self._marks["near"].value:
            self._near.hide()
            self._normal.visible = False
            return
        gap = self.found
        self._near.show(gap.witness_a, gap.witness_b)
        tip = gap.witness_b + self._size / 12 * gap.normal
        self._normal.points = np.array([[gap.witness_b, tip]], dtype=np.float32)
        self._normal.visible = True


def _numbers(vector: Floats) -> str:
    return "  ".join(f"{round(x, 4) + 0.0:.4f}" for x in vector)
