"""A straight line through obstacles, bent until it is free: JAX differentiates the cost, SciPy follows.

python examples/bend_a_path_jax.py [--seed 2] [--points 24]

The cost is that of bend_a_path.py, of smooth clearances instead of exact distances: those of all points are one call of
the checker. JAX compiles it with its gradient.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

import loewner
import loewner.jax
from bend_a_path import ARM, KEEP, SCALE, main, with_inner


def bend_with_jax(straight: np.ndarray, checker: loewner.CollisionChecker) -> tuple[np.ndarray, int]:
    """The points between the ends moved by L-BFGS."""
    clearance = loewner.jax.clearance(checker)

    @jax.jit
    @jax.value_and_grad
    def cost(inner: jax.Array) -> jax.Array:
        path = jnp.asarray(straight).at[1:-1, ARM].set(inner.reshape(len(straight) - 2, -1))
        lacking = jnp.maximum(KEEP - clearance(path), 0.0) / SCALE
        return (jnp.diff(path, axis=0) ** 2).sum() + (lacking**2).sum()

    with jax.enable_x64(True):
        found = minimize(cost, straight[1:-1, ARM].ravel(), jac=True, method="L-BFGS-B")
    return with_inner(straight, found.x), found.nfev


if __name__ == "__main__":
    main(bend_with_jax)
