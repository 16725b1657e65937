"""Clearances and distances of a checker with their gradients, in the caller's number type.

This module is the common part of `loewner.jax` and `loewner.torch`: its functions take NumPy arrays of float32 or
float64 and return arrays of the same type. The checker computes in float64, and every float32 number is also a float64
number, so the answer is for exactly the given configuration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner.errors import InputError
from loewner.robots.checker import CollisionChecker
from loewner.robots.description.robot import expect_width

# A function of configurations and of a flag that requests gradients. It returns values and gradients. Without the flag,
# the gradients are arbitrary.
Ask = Callable[[NDArray[Any], bool], tuple[Any, Any]]


@dataclass(frozen=True, eq=False)
class Measure:
    """The distance of a robot from contact as a function of the configuration, with its gradient."""

    name: str
    checker: CollisionChecker
    ask: Ask

    def __call__(self, Q: NDArray[Any], gradient: bool) -> tuple[NDArray[Any], ...]:
        """Return the values [m], shape (...), at configurations, shape (..., dof); on request, also the derivatives."""
        values, gradients = self.ask(Q, gradient)
        with np.errstate(over="ignore"):  # overflow of float32 gives infinity
            down = rounded_down(values, Q.dtype)
            return (down, gradients.astype(Q.dtype, copy=False)) if gradient else (down,)

    def expect_width(self, shape: tuple[int, ...]) -> None:
        """Refuse configurations whose width does not match the robot; the check needs only their shape."""
        expect_width(self.checker.robot, shape, "Q")

    def named(self, function: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Name and describe a function that computes this measure."""
        function.__name__ = function.__qualname__ = self.name
        function.__doc__ = f"The {self.name} of configurations Q, shape (..., dof), in metres, shape (...)."
        return function

    def no_second_derivatives(self) -> InputError:
        """Return the error for second derivatives: returning zeros instead would hide the caller's mistake."""
        return InputError(
            f"{self.name}: expected to be differentiated once, found a second derivative, which it does not have; "
            "use a method that needs gradients alone (L-BFGS, Gauss-Newton), or stop the gradient here"
        )


def clearance(checker: Any, softness: Any) -> Measure:
    """Return `CollisionChecker.clearance` with the given softness as a measure."""
    checked: Any = _validate.instance(checker, "checker", CollisionChecker)
    soft = _validate.positive_scalar(softness, "softness")

    def ask(Q: NDArray[Any], gradient: bool) -> tuple[Any, Any]:
        values = checked.clearance(Q, softness=soft, gradient=gradient)
        return values if gradient else (values, None)

    return Measure("clearance", checked, ask)


def distance(checker: Any) -> Measure:
    """Return the exact distance of `CollisionChecker.distance` as a measure."""
    checked = _validate.instance(checker, "checker", CollisionChecker)

    def ask(Q: NDArray[Any], gradient: bool) -> tuple[Any, Any]:
        nearest = checked.distance(Q, exact=True, gradient=gradient)
        return nearest.distance, nearest.gradient

    return Measure("distance", checked, ask)


def rounded_down(values: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Convert values to another type and round them down, so that a lower bound remains a lower bound."""
    exact = np.asarray(values, dtype=np.float64)
    rounded = exact.astype(dtype)
    return np.where(rounded > exact, np.nextafter(rounded, np.array(-np.inf, dtype)), rounded)
