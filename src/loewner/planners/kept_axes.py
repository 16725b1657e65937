"""Check an axis of a link that must stay within an angle of a direction, and prepare the axis for kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from loewner._base import _elementary, _validate
from loewner._base._validate import Bools, Floats, Ints
from loewner._kernels.records import KeptAxis as Record
from loewner._kernels.records import table_of
from loewner._native import entries
from loewner.errors import InputError, PlanningError
from loewner.robots import Robot
from loewner.robots.description.reaching import Chain, refuse_unsteady

# Smallest angle [rad]: smaller angles are close to the rounding errors of cosines.
LEAST_ANGLE = 1e-6

# New configurations keep the axis within this share of the angle, so that the axis may deviate further between them.
SHARE = 0.5

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class KeptAxis:
    """An axis of a link that stays within an angle of a direction in the world.

    Attributes
    ----------
    axis, direction : ndarray, shape (3,)
        Unit vectors.
    angle : float
        In radians, at most half a turn.
    link : str
    record : Record, optional
        The kernels' arrays, for the chain of joints that leads to the link.
    table : ndarray of int64, optional
        The table of the kernels' arrays.
    """

    axis: Floats
    direction: Floats
    angle: float
    link: str = ""
    record: Record | None = None
    table: Ints | None = None

    @classmethod
    def of(cls, axis: Any, direction: Any, angle: Any) -> KeptAxis:
        """Check the parts of an argument `keep`."""
        if isinstance(axis, str):
            axis = AXES[_validate.choice(axis, "keep, axis", AXES)]
        units = []
        for vector, name in ((axis, "keep, axis"), (direction, "keep, direction")):
            checked = _validate.finite_array(vector, name, (3,))
            length = float(np.linalg.norm(checked))
            if not 0 < length < np.inf:
                raise InputError(f"{name}: expected a vector with a length, found {_validate.short(vector)}")
            units.append(checked / length)
        size = _validate.positive_scalar(angle, "keep, angle")
        if size < LEAST_ANGLE:
            raise InputError(f"keep, angle: expected at least {LEAST_ANGLE:g}, which rounding allows, found {size:g}")
        if size > np.pi:
            raise InputError(f"keep, angle: expected radians, at most π, found {size:g}; is it in degrees?")
        return cls(units[0], units[1], size)

    def along(self, chain: Chain, link: str) -> KeptAxis:
        """Prepare the axis for a chain of joints that leads to the link."""
        refuse_unsteady(chain, link)
        numbers = np.zeros((3, 9))
        numbers[0, :8] = (
            _elementary.cos(self.angle), *self.axis, *self.direction,
            np.sqrt(2) * _elementary.sin(SHARE * self.angle / 2),
        )  # fmt: skip
        numbers[1] = _completed(self.axis).T.ravel()
        numbers[2] = _completed(self.direction).ravel()
        record = Record(chain.links, chain.constants, chain.ranges, chain.columns, numbers)
        return KeptAxis(self.axis, self.direction, self.angle, link, record, table_of(record))

    @property
    def handle(self) -> int:
        """Address for kernels, which is valid as long as this object exists."""
        assert self.table is not None
        return int(self.table.ctypes.data)

    def on(self, Q0: Floats, Q1: Floats) -> Bools:
        """Return which motions in a batch provably keep the axis."""
        kept = np.zeros(len(Q0), dtype=bool)
        entries.keep_axis(self.handle, np.array(Q0, order="C"), np.array(Q1, order="C"), kept)
        return kept

    def checked(self, robot: Robot, q: Floats, goals: Floats) -> Floats:
        """Check the start, and return the goals that keep the axis.

        Raises
        ------
        PlanningError
            If the start or all goals do not keep the axis.
        """
        for name, Q in (("start", q[None]), ("goal", goals)):
            good = self.on(Q, Q)
            if not good.any():
                R = robot.forward_kinematics(Q)[:, robot.link_names.index(self.link), :3, :3]
                tilt = np.arccos(np.clip((R @ self.axis) @ self.direction, -1, 1)).min()
                raise PlanningError(
                    f"{name}: expected {self.link} to keep within {self.angle:g} rad of the direction, found {tilt:.6g}"
                )
        return goals[good]


def parts_of(keep: Any, wanted: str) -> list[Any]:
    """Return the parts of an argument `keep`; refuse an argument with more or fewer parts than `wanted`."""
    listed = _validate.listed(keep, "keep", wanted=wanted)
    if len(listed) != len(wanted.split(",")):
        raise InputError(f"keep: expected {wanted}, found {_validate.short(keep)}")
    return listed


def _completed(z: Floats) -> Floats:
    """Return a rotation whose third row is a unit vector."""
    x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
