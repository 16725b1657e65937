"""Make JAX functions that compute a checker's clearances and distances.

JAX can differentiate, compile and vectorise these functions.

Install JAX with ``pip install "loewner[jax]"``; it is imported only when a function here is called. Import this module
by its full name, ``import loewner.jax``, because ``from loewner import jax`` would hide JAX's own name.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from loewner._base import _validate
from loewner.errors import InputError, imported
from loewner.robots import CollisionChecker
from loewner.robots import gradients as _gradients
from loewner.robots.gradients import Measure

__all__ = ["clearance", "distance"]


def clearance(checker: CollisionChecker, *, softness: float = 0.005) -> Callable[[Any], Any]:
    """Make a JAX function that computes `CollisionChecker.clearance`, a smooth certified lower bound on distance.

    Parameters
    ----------
    checker : CollisionChecker
        The checker. Its scene may change between calls; each call uses the scene's current state, even if the function
        is compiled.
    softness : float
        Softness in metres; see `CollisionChecker.clearance`.

    Returns
    -------
    function
        A function that maps configurations, a JAX or NumPy array of shape (..., dof), to clearances in metres, an array
        of shape (...).

    Raises
    ------
    InputError
        If `checker` is not a checker, or the softness is not positive and finite. The returned function raises this
        error if its argument is not an array of float32 or float64, if the width is not dof, or if an entry is not
        finite; also if there is no pair to check, or if a second derivative is requested.
    MissingExtraError
        If JAX is not installed.

    Notes
    -----
    The function supports ``jit``, ``vmap``, ``grad``, ``value_and_grad``, ``jacfwd`` and ``jacrev``; it uses
    ``pure_callback``. A batch takes one kernel call, even under ``vmap``. A value and its gradient together also take
    one call. The kernel runs on the CPU: JAX copies configurations from other devices to the CPU, and copies the
    results back. Second derivatives are not supported: ``hessian`` raises an error.

    Results have the same type as the configurations. In float32, the bound holds for exactly these float32
    configurations, and is rounded down so that it remains a lower bound.

    By default, 64-bit numbers are disabled in JAX, and JAX converts float64 arrays to float32. The answer would then
    hold for slightly different configurations. The function therefore refuses float64 arrays while 64-bit numbers are
    disabled. It cannot detect arrays that ``jit`` or ``grad`` has already converted; for such arrays, the answers hold
    for the float32 configurations.

    Inside ``jit`` and ``vmap``, an error about a value, such as an entry that is not finite, becomes a JAX error: a
    ValueError or a RuntimeError that contains the message.

    Examples
    --------
    >>> import jax, jax.numpy as jnp
    >>> import loewner.jax
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("ball", Body.sphere(0.1), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> checker = CollisionChecker(Robot.from_urdf("arm.urdf"), scene)
    >>> near = loewner.jax.clearance(checker)
    >>> q = jnp.array([1.9, 3.0])
    >>> value, gradient = jax.jit(jax.value_and_grad(near))(q)
    >>> bool(value <= checker.clearance(q)), gradient.shape
    (True, (2,))
    """
    return _differentiable(_gradients.clearance(checker, softness))


def distance(checker: CollisionChecker) -> Callable[[Any], Any]:
    """Make a JAX function that computes the exact `CollisionChecker.distance`, which has kinks.

    Parameters
    ----------
    checker : CollisionChecker

    Returns
    -------
    function
        A function that maps configurations, a JAX or NumPy array of shape (..., dof), to distances in metres, an array
        of shape (...). A negative value is a depth.

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
    >>> import jax, jax.numpy as jnp
    >>> import loewner.jax
    >>> from loewner import Body, CollisionChecker, Robot, Scene
    >>> scene = Scene()
    >>> scene.add("post", Body.box([0.2, 0.2, 0.2]), [[1, 0, 0, 2.6], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    >>> distance = loewner.jax.distance(CollisionChecker(Robot.from_urdf("arm.urdf"), scene))
    >>> jax.grad(distance)(jnp.array([2.0, 3.0])).round(6).tolist()
    [-1.0, 0.0]
    """
    return _differentiable(_gradients.distance(checker))


def _differentiable(measure: Measure) -> Callable[[Any], Any]:
    """Make a JAX function from a measure; one callback returns the values, or the values with their gradients."""
    jax = _jax()

    @jax.custom_jvp
    def values(Q: Any) -> Any:
        return _called(measure, Q, False)[0]

    @jax.custom_jvp
    def with_gradients(Q: Any) -> Any:
        return _called(measure, Q, True)

    @values.defjvp
    def once(primals: Any, tangents: Any) -> Any:
        primal_out, gradients = with_gradients(*primals)
        return primal_out, (gradients * tangents[0]).sum(axis=-1)  # linear in the tangent, as JAX requires

    @with_gradients.defjvp
    def twice(primals: Any, tangents: Any) -> Any:
        raise measure.no_second_derivatives()

    return measure.named(lambda Q: values(_checked(Q, measure)))


def _checked(Q: Any, measure: Measure) -> Any:
    """Convert configurations to a JAX array without changing any number."""
    jax = _jax()
    if not isinstance(Q, (jax.Array, np.ndarray)):
        raise InputError(f"Q: expected an array of JAX or NumPy, found {_validate.short(Q)}")
    if isinstance(Q, np.ndarray):
        Q = _validate.plain_array(Q, "Q")
    if Q.dtype not in (np.float32, np.float64):
        raise InputError(f"Q: expected float32 or float64, found {Q.dtype}")
    if jax.dtypes.canonicalize_dtype(Q.dtype) != Q.dtype:
        raise InputError(
            "Q: expected float32 while JAX's 64-bit numbers are off, found float64: JAX would round the configuration, "
            'and the answer would be about another one; call jax.config.update("jax_enable_x64", True) first, or ask '
            "about Q.astype(numpy.float32)"
        )
    measure.expect_width(Q.shape)
    return jax.numpy.asarray(Q)


def _called(measure: Measure, Q: Any, gradient: bool) -> Any:
    """Compute values and, on request, gradients: immediately if Q has concrete values, otherwise in a callback."""
    jax = _jax()

    def call(Q: Any) -> Any:
        return measure(np.asarray(Q), gradient)

    if not isinstance(Q, jax.core.Tracer):
        return tuple(map(jax.numpy.asarray, call(Q)))
    results = tuple(jax.ShapeDtypeStruct(shape, Q.dtype) for shape in (Q.shape[:-1], Q.shape)[: 1 + gradient])
    return jax.pure_callback(call, results, Q, vmap_method="expand_dims")


_jax = partial(imported, "jax", "functions for JAX need JAX", "jax")
