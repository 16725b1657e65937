"""What JAX and PyTorch add to a clearance: the checker itself, and the same asked through each of those that are there.

    python benchmarks/frameworks.py

Panda among ten obstacles, one thread: values alone, and values with gradients, of one configuration and of a thousand;
functions of JAX are compiled, in float64.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from clock import race, threads_set_to, timed
from loewner import CollisionChecker
from robot_samples import obstacles, panda
from samples import Array

# Configurations of a call, and calls that are timed together.
SIZES = {1: 200, 1000: 5}


def main(arguments: list[str] | None = None) -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args(arguments)
    sample = panda()
    checker = CollisionChecker(sample.robot, obstacles(0))
    Q = sample.robot.random_configurations(max(SIZES), 1)
    asks = {"checker": alone(checker)}
    if find_spec("jax"):
        asks["JAX"] = in_jax(checker)
    if find_spec("torch"):
        asks["PyTorch"] = in_torch(checker)
    with threads_set_to(1):
        for size, calls in SIZES.items():
            some = Q[:size] if size > 1 else Q[0]
            contestants = {
                (who, what): timed(repeated(ask, calls), calls)
                for who, make in asks.items()
                for what, ask in make(some).items()
            }
            for (who, what), cost in race(contestants, 7).items():
                print(f"{size:5d} a call, {what:20s} {who:8s} {1e6 * cost.wall:9.1f} us")


def repeated(ask: Callable[[], Any], calls: int) -> Callable[[], None]:
    def run() -> None:
        for _ in range(calls):
            ask()

    return run


Asks = Callable[[Array], dict[str, Callable[[], Any]]]


def alone(checker: CollisionChecker) -> Asks:
    return lambda Q: {
        "values": lambda: checker.clearance(Q),
        "values and gradients": lambda: checker.clearance(Q, gradient=True),
    }


def in_jax(checker: CollisionChecker) -> Asks:
    import jax

    import loewner.jax

    jax.config.update("jax_enable_x64", True)
    values = jax.jit(loewner.jax.clearance(checker))
    gradients = jax.jit(jax.value_and_grad(lambda Q: values(Q).sum()))

    def ask(Q: Array) -> dict[str, Callable[[], Any]]:
        X = jax.numpy.asarray(Q)
        np.testing.assert_array_equal(gradients(X)[1], checker.clearance(Q, gradient=True)[1])
        return {
            "values": lambda: values(X).block_until_ready(),
            "values and gradients": lambda: jax.block_until_ready(gradients(X)),
        }

    return ask


def in_torch(checker: CollisionChecker) -> Asks:
    import torch

    import loewner.torch

    values = loewner.torch.clearance(checker)

    def ask(Q: Array) -> dict[str, Callable[[], Any]]:
        X = torch.tensor(Q, requires_grad=True)

        def gradients() -> Any:
            X.grad = None
            values(X).sum().backward()
            return X.grad

        np.testing.assert_array_equal(gradients(), checker.clearance(Q, gradient=True)[1])
        return {"values": lambda: values(X.detach()), "values and gradients": gradients}

    return ask


if __name__ == "__main__":
    main()
