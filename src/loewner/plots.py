"""Figures of bodies, of pairs, and of robots in scenes, with matplotlib."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loewner import _check
from loewner._check import Floats
from loewner._files import replacing
from loewner.bodies import Body
from loewner.checkers import CollisionChecker
from loewner.errors import FileError, InputError, MissingExtraError
from loewner.queries import Verdict, classify, collide

COLOURS = ("#4477aa", "#cc6677")
INNER, OUTER = "#228833", "#777777"
SCENE, COLLIDING = "#bbbbbb", "#cc3311"


def body(
    body: Body,
    T_world_body: ArrayLike | None = None,
    *,
    ax: Any = None,
    colour: str = COLOURS[0],
    ellipsoids: bool = True,
) -> Any:
    """Draw a body: its pieces, and the inner and outer ellipsoid of each as wire frames.

    Parameters
    ----------
    body : Body
        Curved pieces (cylinder, cone, capsule ...) are shown by their ellipsoids.
    T_world_body : array_like, shape (4, 4), optional
    ax : matplotlib 3-D axes, optional
        To draw into; a new figure by default.
    colour : str
    ellipsoids : bool
        Draw the ellipsoids too.

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    if not isinstance(body, Body):
        raise InputError(f"body: expected loewner.Body, found {type(body).__name__}")
    T = _one_pose(T_world_body, "T_world_body")
    ax = _axes() if ax is None else ax
    _draw(ax, body, T, colour, ellipsoids)
    _frame(ax, _corners(body, T))
    return ax


def pair(
    a: Body,
    T_world_a: ArrayLike | None,
    b: Body,
    T_world_b: ArrayLike | None,
    *,
    ax: Any = None,
    ellipsoids: bool = True,
) -> Any:
    """Draw two bodies with their ellipsoids; the title is the certified verdict, and the exact one if ambiguous.

    Parameters
    ----------
    a, b : Body
    T_world_a, T_world_b : array_like, shape (4, 4), or None
    ax : matplotlib 3-D axes, optional
    ellipsoids : bool

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    for operand, name in ((a, "a"), (b, "b")):
        if not isinstance(operand, Body):
            raise InputError(f"{name}: expected loewner.Body, found {type(operand).__name__}")
    Ta, Tb = _one_pose(T_world_a, "T_world_a"), _one_pose(T_world_b, "T_world_b")
    ax = _axes() if ax is None else ax
    _draw(ax, a, Ta, COLOURS[0], ellipsoids)
    _draw(ax, b, Tb, COLOURS[1], ellipsoids)
    _frame(ax, np.concatenate([_corners(a, Ta), _corners(b, Tb)]))
    # Look across the line between the two, so that neither hides the other.
    way = _corners(b, Tb).mean(axis=0) - _corners(a, Ta).mean(axis=0)
    ax.view_init(elev=15, azim=np.degrees(np.arctan2(way[1], way[0])) - 90)
    verdict = classify(a, Ta, b, Tb)
    title = str(verdict.name)
    if verdict == Verdict.AMBIGUOUS:
        title += ", exact: " + ("colliding" if collide(a, Ta, b, Tb) else "free")
    ax.set_title(title)
    _legend(ax, [("a", COLOURS[0]), ("b", COLOURS[1])] + ([("inner", INNER), ("outer", OUTER)] if ellipsoids else []))
    return ax


def configuration(checker: CollisionChecker, q: ArrayLike, *, ax: Any = None) -> Any:
    """Draw a robot in its scene; what collides is red, the title says how many pairs do.

    Parameters
    ----------
    checker : CollisionChecker
    q : array_like, shape (dof,)
    ax : matplotlib 3-D axes, optional

    Returns
    -------
    matplotlib 3-D axes

    Raises
    ------
    InputError
        As `CollisionChecker.pairs`.
    MissingExtraError
        If matplotlib is not installed.
    """
    robot, scene = checker.robot, checker.scene
    contacts = checker.pairs(q)
    touching = {name for contact in contacts for name in (contact.name_a, contact.name_b)}
    poses = dict(zip(robot.link_names, robot.forward_kinematics(q), strict=True))
    drawn = [(name, body, poses[name], COLOURS[0]) for name, body in robot.bodies.items()]
    drawn += [
        (name, scene[name], poses[held.link] @ held.T_link_body, COLOURS[0]) for name, held in scene.attachments.items()
    ]
    drawn += [(name, scene[name], scene.pose(name), SCENE) for name in scene.static_names]
    ax = _axes() if ax is None else ax
    for name, body, T, colour in drawn:
        curved = any(piece.triangles is None for piece in body.pieces)
        _draw(ax, body, T, COLLIDING if name in touching else colour, curved)
    _frame(ax, np.concatenate([_corners(body, T) for _, body, T, _ in drawn]))
    pairs = "1 pair" if len(contacts) == 1 else f"{len(contacts)} pairs"
    ax.set_title(f"colliding, {pairs}" if contacts else "free")
    return ax


def save(figure: Any, path: str | os.PathLike[str]) -> Path:
    """Write a matplotlib figure (or the figure of axes), whole or not at all; the suffix gives the format.

    Raises
    ------
    FileError
        If it cannot be written.
    """
    target = Path(path)
    figure = getattr(figure, "figure", figure)
    with replacing(target) as temporary:
        try:
            figure.savefig(temporary, dpi=120, bbox_inches="tight")
        except ValueError as error:  # a suffix that matplotlib does not know
            raise FileError(f"{target}: could not be written ({error})") from None
    return target


def _axes() -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError('figures need matplotlib: pip install "loewner[plots]"') from None
    # Not through pyplot: that would keep every figure alive and choose a window system.
    return Figure(figsize=(6, 6)).add_subplot(projection="3d")


def _one_pose(T: ArrayLike | None, name: str) -> Floats:
    P = _check.poses(T, name)
    if P.shape != (4, 4):
        raise InputError(f"{name}: expected shape (4, 4), found {_check.shape_text(P.shape)}")
    return P


def _draw(ax: Any, body: Body, T: Floats, colour: str, ellipsoids: bool) -> None:
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    for piece in body.pieces:
        if piece.vertices is not None and piece.triangles is not None:
            corners = (piece.vertices @ T[:3, :3].T + T[:3, 3])[piece.triangles]
            ax.add_collection3d(Poly3DCollection(corners, facecolors=colour, linewidths=0, alpha=0.55, shade=True))
    if ellipsoids:
        for fitted, line, width in ((body.outer, OUTER, 0.4), (body.inner, INNER, 0.6)):
            moved = fitted.transformed(T)
            for center, factor in zip(moved.center, moved.factor, strict=True):
                ax.add_collection3d(Line3DCollection(center + _WIRES @ factor.T, colors=line, linewidths=width))


def _legend(ax: Any, entries: list[tuple[str, str]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, linewidth=4, label=label) for label, colour in entries]
    ax.legend(handles=handles, loc="upper left", fontsize="small", frameon=False)


def _wires() -> Floats:
    """Six meridians and five parallels of the unit sphere, shape (11, 49, 3)."""
    turn = np.linspace(0, 2 * np.pi, 49)
    lines = []
    for angle in np.arange(6) * np.pi / 6:
        lines.append([np.cos(angle) * np.sin(turn), np.sin(angle) * np.sin(turn), np.cos(turn)])
    for height in np.linspace(-np.pi / 3, np.pi / 3, 5):
        lines.append([np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.full(49, np.sin(height))])
    return np.array(lines).transpose(0, 2, 1)


_WIRES = _wires()


def _corners(body: Body, T: Floats) -> Floats:
    low, high = body.outer.transformed(T).bounding_box()
    return np.concatenate([low, high])


def _frame(ax: Any, corners: Floats) -> None:
    """Show all corners, at one scale along all axes."""
    middle, half = (corners.max(axis=0) + corners.min(axis=0)) / 2, np.ptp(corners, axis=0).max() / 2
    ax.set(
        xlim=(middle[0] - half, middle[0] + half),
        ylim=(middle[1] - half, middle[1] + half),
        zlim=(middle[2] - half, middle[2] + half),
        xlabel="x, m",
        ylabel="y, m",
        zlabel="z, m",
    )
    ax.set_box_aspect((1, 1, 1))
    ax.locator_params(nbins=3)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.labelpad = 12  # clear of the ticks' numbers
