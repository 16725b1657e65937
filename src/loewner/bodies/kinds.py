"""Kinds of pieces; one row holds all properties of a curved kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from loewner._kernels import columns


class Kind(NamedTuple):
    """A kind of curved piece: the image of a unit shape, with a ball added (see `_kernels.pieces.shapes`).

    The `Body` constructor called `name` takes `sizes`, computed from the ball's radius and the image's semi-axes. Scene
    files give them as separate fields, named by `size_names`, or as one vector. A row states how the unit shape is
    meshed: `is_ball`, a cylinder or cone with the radius `top` at its upper end, or a segment of half length `core`
    with a ball added. `fitted` are the semi-axes of the inner and the outer ellipsoid in the coordinates of the unit
    shape, and the height of their center; None for kinds with a ball added. The semi-axes have yet to be divided by
    `divisors`.
    """

    name: str
    sizes: Callable[[float, Sequence[float]], Sequence[float]]
    size_names: tuple[str, ...] = ("radius", "length")
    top: float | None = None
    core: float | None = None
    fitted: tuple[tuple[float, float, float], tuple[float, float, float], float] | None = None
    divisors: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    in_mjcf: bool = True
    is_ball: bool = False


def _upright(_: float, axes: Sequence[float]) -> Sequence[float]:
    return axes[0], 2 * axes[2]


_BALL = (1.0, 1.0, 1.0), (1.0, 1.0, 1.0), 0.0
_CYLINDER = (1.0, 1.0, 1.0), (1.5**0.5, 1.5**0.5, 3.0**0.5), 0.0
_CONE = (1.0, 1.0, 0.5), (3.0, 3.0, 1.5), -0.5  # after division by _OF_CONE: 1 / √2 and 3 / √8 times the radius
_OF_CONE = (2.0**0.5, 2.0**0.5, 1.0), (8.0**0.5, 8.0**0.5, 1.0)

# Indexed by the numbers used in kernels and files.
CURVED = {
    columns.ELLIPSOID: Kind("ellipsoid", lambda _, axes: axes, (), fitted=_BALL, is_ball=True),
    columns.CYLINDER: Kind("cylinder", _upright, top=1.0, fitted=_CYLINDER),
    columns.CONE: Kind("cone", _upright, top=0.0, fitted=_CONE, divisors=_OF_CONE, in_mjcf=False),
    columns.SEGMENT: Kind("capsule", lambda radius, axes: (radius, 2 * axes[2]), core=1.0),
    columns.POINT: Kind("sphere", lambda radius, _: (radius,), ("radius",), core=0.0, is_ball=True),
}
FLAT = {columns.SOLID: "solid", columns.SURFACE: "surface", columns.POLYTOPE: "polytope"}
KIND_NAMES = FLAT | {number: kind.name for number, kind in CURVED.items()}
