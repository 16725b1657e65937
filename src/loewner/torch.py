"""Make PyTorch functions of a checker's clearances and distances, which PyTorch can differentiate.

Install PyTorch with ``pip install "loewner[torch]"``; it is imported only when a function here is called. Import this
module by its full name, ``import loewner.torch``, because ``from loewner import torch`` would hide PyTorch's own name.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from loewner._base import _validate
from loewner.errors import InputError, imported
from loewner.robots import CollisionChecker
from loewner.robots import gradients as _gradients
from loewner.robots.gradients import Measure

__all__ = ["clearance", "distance"]


def clearance(checker: CollisionChecker, *, softness: float = 0.005) -> Callable[[Any], Any]:
    """Make a PyTorch function that computes `CollisionChecker.clearance`, a smooth certified lower bound on distance.

    Parameters
    ----------
    checker : CollisionChecker
        The checker. Its scene may change between calls; each call uses the scene's current state.
    softness : float
        Softness in metres; see `CollisionChecker.clearance`.

    Returns
    -------
    function
        A function that maps configurations, a tensor of shape (..., dof), to clearances in metres, a tensor of shape
        (...).

    Raises
    ------
    InputError
        If `checker` is not a checker, or the softness is not positive and finite. The returned function raises this
        error if its argument is not a dense tensor of float32 or float64 on the CPU, if the width is not dof, or if an
        entry is not finite; also if there is no pair to check, or if a second derivative is requested.
    MissingExtraError
        If PyTorch is not installed.

    Notes
    -----
    The function is based on ``torch.autograd.Function``. It supports ``backward``, and ``vmap``, ``grad``, ``jacrev``,
    ``jvp`` and ``jacfwd`` of ``torch.func``. A batch takes one kernel call, even under ``vmap``. If gradients may be
    needed, they are computed together with the values. Second derivatives are not supported: differentiating twice
    raises an error.

    Results have the same type as the configurations. In float32, the bound holds for exactly these float32
    configurations, and is rounded down so that it remains a lower bound.

    Examples
    --------
    >>> import torch
    >>> import loewner.torch
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("ball", Body.sphere(0.1), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> near = loewner.torch.clearance(checker)
    >>> q = torch.tensor([1.9, 3.0], dtype=torch.float64, requires_grad=True)
    >>> near(q).backward()
    >>> near(q).item() == checker.clearance([1.9, 3.0]), q.grad.shape
    (True, torch.Size([2]))
    """
    return _differentiable(_gradients.clearance(checker, softness))


def distance(checker: CollisionChecker) -> Callable[[Any], Any]:
    """Make a PyTorch function that computes the exact `CollisionChecker.distance`, which has kinks.

    Parameters
    ----------
    checker : CollisionChecker

    Returns
    -------
    function
        A function that maps configurations, a tensor of shape (..., dof), to distances in metres, a tensor of shape
        (...). A negative value is a depth.

    Raises
    ------
    InputError, MissingExtraError
        As for `clearance`.
    ConvergenceError
        The returned function raises this error if an exact distance does not converge, as for `loewner.distance`.

    Notes
    -----
    The notes on `clearance` apply, and float32 distances are also rounded down. For gradients, see
    `CollisionChecker.distance`.

    Examples
    --------
    >>> import torch
    >>> import loewner.torch
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> distance = loewner.torch.distance(CollisionChecker(Robot.from_urdf("arm.urdf"), scene))
    >>> torch.func.grad(distance)(torch.tensor([2.0, 3.0])).round(decimals=6).abs().tolist()
    [1.0, 0.0]
    """
    return _differentiable(_gradients.distance(checker))


def _differentiable(measure: Measure) -> Callable[[Any], Any]:
    """Make a PyTorch function from a measure."""
    function_class = _function_class()

    def function(Q: Any) -> Any:
        _expect_configurations(Q, measure)
        return function_class.apply(Q, measure, _is_differentiated(Q))[0]

    return measure.named(function)


def _expect_configurations(Q: Any, measure: Measure) -> None:
    torch = _torch()
    if not isinstance(Q, torch.Tensor):
        raise InputError(f"Q: expected a tensor of PyTorch, found {_validate.short(Q)}")
    if Q.device.type != "cpu":
        raise InputError(f"Q: expected a tensor on the CPU, found one on {Q.device}: pass Q.cpu()")
    if Q.dtype not in (torch.float32, torch.float64):
        raise InputError(f"Q: expected float32 or float64, found {Q.dtype}")
    if Q.layout != torch.strided:
        raise InputError(f"Q: expected a dense tensor, found {Q.layout}")
    measure.expect_width(tuple(Q.shape))


def _is_differentiated(Q: Any) -> bool:
    """Return whether derivatives with respect to these configurations are likely to be requested."""
    torch = _torch()
    if torch.is_grad_enabled() and Q.requires_grad:
        return True
    try:
        return torch.autograd.forward_ad.unpack_dual(Q).tangent is not None
    except RuntimeError:  # PyTorch cannot determine this for a jvp inside vmap
        return True


@cache
def _function_class() -> Any:
    """Define the class of functions that PyTorch differentiates; this requires PyTorch and happens once."""
    torch = _torch()
    Function: Any = torch.autograd.Function

    class Asked(Function):  # type: ignore[misc]
        """Compute the values of a measure and their gradients; gradients that are not needed have no columns."""

        @staticmethod
        def forward(Q: Any, measure: Measure, gradient: bool) -> Any:
            values, *gradients = measure(Q.numpy(force=True), gradient)
            return torch.from_numpy(values), torch.from_numpy(*gradients or [np.empty((*Q.shape[:-1], 0))])

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            Q, ctx.measure, _ = inputs
            ctx.mark_non_differentiable(output[1])
            ctx.save_for_backward(Q, output[1])
            ctx.save_for_forward(Q, output[1])

        @staticmethod
        def backward(ctx: Any, up: Any, _: Any) -> Any:
            return Times.apply(up[..., None], *kept(ctx), ctx.measure), None, None

        @staticmethod
        def jvp(ctx: Any, tangent: Any, *_: Any) -> Any:
            return Times.apply(tangent, *kept(ctx), ctx.measure).sum(dim=-1), None

        @staticmethod
        def vmap(info: Any, in_dims: Any, Q: Any, measure: Measure, gradient: bool) -> Any:
            Q = Q.movedim(in_dims[0], 0)
            # Q may need derivatives outside vmap even if its rows inside vmap need none.
            return Asked.apply(Q, measure, gradient or _is_differentiated(Q)), (0, 0)

    def kept(ctx: Any) -> tuple[Any, Any]:
        """Return configurations and gradients; compute the gradients unless they are already there."""
        Q, gradients = ctx.saved_tensors
        if gradients.shape != Q.shape:
            _, gradients = Asked.apply(Q, ctx.measure, True)
        return Q, gradients

    class Times(Function):  # type: ignore[misc]
        """Multiply a factor by the gradients.

        Since Q is an argument, a second derivative raises an error.
        """

        generate_vmap_rule = True

        @staticmethod
        def forward(factor: Any, Q: Any, gradients: Any, measure: Measure) -> Any:
            return factor * gradients

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            ctx.measure = inputs[-1]

        @staticmethod
        def backward(ctx: Any, *_: Any) -> Any:
            raise ctx.measure.no_second_derivatives()

        @staticmethod
        def jvp(ctx: Any, *_: Any) -> Any:
            raise ctx.measure.no_second_derivatives()

    return Asked


_torch = partial(imported, "torch", "functions for PyTorch need PyTorch", "torch")
