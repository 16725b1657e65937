"""Points of a trajectory as controllers receive them, and the curve that they execute between the points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from loewner import _validate
from loewner.errors import InputError
from loewner.robots.curves import CURVE_ROUNDINGS, Curve


class ControllerPoints:
    """Points with times that a joint trajectory controller interpolates, as ros2_control's does.

    Straight lines where there are positions only, cubic polynomials where there are velocities as well, and quintic
    ones where there are accelerations too.

    Parameters
    ----------
    times : array_like, shape (n,)
        Seconds; they increase.
    positions : array_like, shape (n, dof)
        Radians or metres.
    velocities, accelerations : array_like, shape (n, dof), optional
        At the same times; accelerations only with velocities.
    names : sequence of str, optional
        The columns. Without names they are taken in the order of `Robot.configuration_names`.

    Raises
    ------
    InputError
        If shapes differ, a number is not finite, there are fewer than two points, or times do not increase.

    Examples
    --------
    >>> from loewner import CollisionChecker, Robot
    >>> points = ControllerPoints([0.0, 1.0], [[0.0, 0.0], [1.0, 0.5]], velocities=np.zeros((2, 2)))
    >>> CollisionChecker(Robot.from_urdf("arm.urdf")).certify_trajectory(points).verdict
    <Verdict.FREE: 0>
    """

    def __init__(
        self,
        times: ArrayLike,
        positions: ArrayLike,
        velocities: ArrayLike | None = None,
        accelerations: ArrayLike | None = None,
        *,
        names: Sequence[str] | None = None,
    ) -> None:
        self.times = _validate.finite_array(times, "times", ("n",))
        if len(self.times) < 2 or not (np.diff(self.times) > 0).all():
            raise InputError(
                f"times: expected two or more that increase, found {_validate.shape_text(self.times.shape)}"
            )
        if accelerations is not None and velocities is None:
            raise InputError("accelerations: expected velocities with them, found none")
        texts = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        if names is not None and not texts:
            raise InputError(f"names: expected a list of texts, found {type(names).__name__}")
        self.names = None if names is None else tuple(names)
        self.positions = _validate.finite_array(positions, "positions", ("n", "dof"))
        dof = self.positions.shape[1] if self.names is None else len(self.names)
        self.velocities = None if velocities is None else _validate.finite_array(velocities, "velocities", ("n", "dof"))
        self.accelerations = (
            None if accelerations is None else _validate.finite_array(accelerations, "accelerations", ("n", "dof"))
        )
        for name in ("positions", "velocities", "accelerations"):
            array = getattr(self, name)
            if array is not None and array.shape != (len(self.times), dof):
                found = _validate.shape_text(array.shape)
                raise InputError(f"{name}: expected shape ({len(self.times)}, {dof}), found {found}")

    def _courses(self) -> Curve:
        """The curve that the controller executes; see `CollisionChecker.certify_trajectory`."""
        T = np.diff(self.times)[:, None]
        q0, q1 = self.positions[:-1], self.positions[1:]
        points, size = [q0, q1], np.maximum(np.abs(q0), np.abs(q1))
        if self.velocities is not None:
            v0, v1 = self.velocities[:-1] * T, self.velocities[1:] * T
            size = size + np.maximum(np.abs(v0), np.abs(v1))
            points = [q0, q0 + v0 / 3, q1 - v1 / 3, q1]
            if self.accelerations is not None:
                a0, a1 = self.accelerations[:-1] * T**2, self.accelerations[1:] * T**2
                size = size + np.maximum(np.abs(a0), np.abs(a1))
                points = [
                    q0, q0 + v0 / 5, q0 + 2 * v0 / 5 + a0 / 20, q1 - 2 * v1 / 5 + a1 / 20, q1 - v1 / 5, q1,
                ]  # fmt: skip
        return Curve(self.names, self.times, np.stack(points, axis=1), CURVE_ROUNDINGS * size)

    def __repr__(self) -> str:
        kind = "positions" if self.velocities is None else "cubic" if self.accelerations is None else "quintic"
        return f"ControllerPoints({len(self.times)} points, {self.positions.shape[1]} joints, {kind})"
