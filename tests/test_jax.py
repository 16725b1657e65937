"""Clearances and distances in JAX: what the checker says to the bit, under every transformation, one call a batch."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loewner.jax
from loewner import Body, CollisionChecker, InputError, Scene
from sampling import quick_of
from test_clearance import cube_on_a_leash, expect_good_checkers, random_checker, told

os.environ.setdefault("JAX_PLATFORMS", "cpu")  # what other platforms lack is no matter here
jax = pytest.importorskip("jax")
jnp = jax.numpy

MEASURES = ("clearance", "distance")


@pytest.fixture(scope="module")
def checker(tmp_path_factory: pytest.TempPathFactory) -> CollisionChecker:
    """A robot of all kinds of joints among bodies."""
    return random_checker(np.random.default_rng(6), tmp_path_factory.mktemp("robot"))


@pytest.fixture
def Q(checker: CollisionChecker) -> np.ndarray:
    return checker.robot.random_configurations(6, seed=3).reshape(2, 3, -1)


@pytest.fixture
def wide() -> Iterator[None]:
    """JAX with its 64-bit numbers."""
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", MEASURES)
def test_values_are_the_checkers(name: str, checker: CollisionChecker, Q: np.ndarray, wide: None):
    """To the bit, in float64: of one configuration, of batches of every shape, of none; compiled and not."""
    function = getattr(loewner.jax, name)(checker)
    for ask in (function, jax.jit(function)):
        for some in (Q, Q[0], Q[1, 2], Q[:0], Q[:, :0]):
            found = ask(jnp.asarray(some))
            assert found.dtype == np.float64
            assert found.shape == some.shape[:-1]
            np.testing.assert_array_equal(found, told(checker, name, some)[0])
    np.testing.assert_array_equal(jax.vmap(jax.vmap(function))(Q), told(checker, name, Q)[0])
    np.testing.assert_array_equal(jax.vmap(function, in_axes=1)(Q), told(checker, name, Q.swapaxes(0, 1))[0])


@pytest.mark.parametrize("name", MEASURES)
@pytest.mark.parametrize("compiled", [pytest.param(False, marks=pytest.mark.verify), True])
def test_gradients_are_the_checkers(name: str, compiled: bool, checker: CollisionChecker, Q: np.ndarray, wide: None):
    """To the bit, forwards and backwards, by every transformation that makes one."""
    function, (value, gradient) = getattr(loewner.jax, name)(checker), told(checker, name, Q)

    def after(transformed: Callable[[Any], Any]) -> Any:
        return (jax.jit(transformed) if compiled else transformed)(jnp.asarray(Q))

    def each(transform: Callable[[Any], Any]) -> Callable[[Any], Any]:
        return jax.vmap(jax.vmap(transform(function)))

    for transform in (jax.grad, jax.jacrev, jax.jacfwd):
        np.testing.assert_array_equal(after(each(transform)), gradient)
    values, gradients = after(each(jax.value_and_grad))
    np.testing.assert_array_equal(values, value)
    np.testing.assert_array_equal(gradients, gradient)
    np.testing.assert_array_equal(after(jax.grad(lambda Q: function(Q).sum())), gradient)
    np.testing.assert_array_equal(after(jax.grad(lambda Q: jax.vmap(function)(Q).sum())), gradient)
    for jacobian in (jax.jacrev, jax.jacfwd):
        whole = after(jacobian(function))
        np.testing.assert_array_equal(np.einsum("abab...->ab...", whole), gradient)
        assert np.count_nonzero(whole) == np.count_nonzero(gradient)


@pytest.mark.parametrize("name", MEASURES)
def test_chains_of_derivatives(name: str, checker: CollisionChecker, Q: np.ndarray, wide: None):
    """Within a larger cost, in a loop, the gradient is what the chain rule makes of the checker's."""
    function, columns = getattr(loewner.jax, name)(checker), Q.shape[-1]
    value, gradient = told(checker, name, Q[0])
    scale = jnp.linspace(1, 2, columns)

    def cost(x: Any) -> Any:
        def step(total: Any, x: Any) -> Any:
            return total + jnp.sin(function(x * scale)), None

        return jax.lax.scan(step, 0.0, x)[0]

    found = jax.jit(jax.grad(cost))(jnp.asarray(Q[0]) / scale)
    nearly = told(checker, name, np.asarray(jnp.asarray(Q[0]) / scale * scale))
    np.testing.assert_allclose(found, np.cos(nearly[0])[:, None] * nearly[1] * scale, rtol=1e-13, atol=1e-15)


def test_a_batch_is_one_call(checker: CollisionChecker, Q: np.ndarray, calls: list[Any], wide: None):
    """Of the kernel, under vmap too; a value and its gradient are one, and a value alone asks for no gradient."""
    function = loewner.jax.clearance(checker)

    def asked(thing: Callable[[Any], Any]) -> list[Any]:
        calls.clear()
        jax.block_until_ready(thing(jnp.asarray(Q)))
        return list(calls)

    rows = jax.vmap(jax.vmap(function))
    for value in (function, rows, jax.jit(rows), lambda Q: rows(Q)):
        assert asked(value) == [(Q.shape, False)]
    both = jax.vmap(jax.vmap(jax.value_and_grad(function)))
    for gradient in (both, jax.jit(both), jax.grad(lambda Q: function(Q).sum()), jax.jacfwd(function)):
        assert asked(gradient) == [(Q.shape, True)]


def test_float32_is_still_a_bound(checker: CollisionChecker):
    """About exactly the float32 configuration; never above the float64 bound, and the next number is."""
    function = loewner.jax.clearance(checker)
    Q = checker.robot.random_configurations(500, seed=1).astype(np.float32)
    for ask in (function, jax.jit(function), jax.jit(jax.vmap(function))):
        found = np.asarray(ask(jnp.asarray(Q)))
        exact = checker.clearance(Q)
        assert found.dtype == np.float32
        assert (found <= exact).all()
        assert (np.nextafter(found, np.float32(np.inf)) > exact).all()
    gradients = jax.vmap(jax.grad(function))(jnp.asarray(Q))
    assert gradients.dtype == np.float32
    np.testing.assert_array_equal(gradients, checker.clearance(Q, gradient=True)[1].astype(np.float32))


def test_float64_while_it_is_off(checker: CollisionChecker, Q: np.ndarray):
    """JAX would round the configuration: refused, with what to do; also where a compiled function has it inside."""
    function = loewner.jax.clearance(checker)
    for ask in (function, jax.jit(lambda x: x + function(Q))):
        with pytest.raises(InputError, match=r"64-bit numbers are off.*jax_enable_x64"):
            ask(Q if ask is function else 0.0)
    assert function(Q.astype(np.float32)).dtype == np.float32
    with jax.enable_x64(True):
        assert function(Q).dtype == np.float64
        assert function(Q.astype(np.float32)).dtype == np.float32


def scene_with_post() -> Scene:
    scene = Scene()
    scene.add("post", Body.box([1, 1, 1]))
    return scene


def test_compiled_functions_see_the_scene_as_it_is(tmp_path: Path):
    """A body that moves between two calls has moved for the second, also for configurations that are constants."""
    scene = scene_with_post()
    checker = cube_on_a_leash(tmp_path, scene)
    function, q = loewner.jax.clearance(checker), np.array([3, 0, 0, 1, 0, 0, 0], dtype=np.float32)
    compiled = jax.jit(function)
    asks: list[Callable[[], Any]] = [lambda: compiled(q), jax.jit(lambda: function(q))]
    before = [float(ask()) for ask in asks]
    T = np.eye(4)
    T[0, 3] = -5.0
    scene.move("post", T)
    after = [float(ask()) for ask in asks]
    np.testing.assert_allclose(before, checker.clearance(q) - 5.0, atol=1e-6)
    np.testing.assert_allclose(after, checker.clearance(q), atol=1e-6)


@pytest.mark.parametrize("name", MEASURES)
@pytest.mark.parametrize("twice", quick_of(["hessian", "jacfwd", "jacrev"], ["jacfwd", "jacrev"]))
def test_second_derivatives_are_refused(name: str, twice: str, checker: CollisionChecker, Q: np.ndarray):
    """With an error that says so, never zeros; compiled and not, and in a cost that has other terms."""
    function = getattr(loewner.jax, name)(checker)

    def cost(q: Any) -> Any:
        return function(q) ** 2 + (q**2).sum()

    transform = jax.hessian(cost) if twice == "hessian" else getattr(jax, twice)(getattr(jax, twice)(cost))
    for ask in (transform, jax.jit(transform)):
        with pytest.raises(InputError, match=f"{name}: expected to be differentiated once, found a second derivative"):
            ask(jnp.asarray(Q[0, 0], jnp.float32))


@pytest.mark.parametrize("name", MEASURES)
def test_bad_configurations(name: str, checker: CollisionChecker, Q: np.ndarray):
    """What is no array, of another type or width, or not finite is refused by name; compiled functions say so too."""
    function, good = getattr(loewner.jax, name)(checker), jnp.asarray(Q, jnp.float32)
    dof = checker.robot.dof
    for bad in (None, "x", 1.5, [0.0] * dof, Q.astype(object), good.astype(jnp.int32)):
        with pytest.raises(InputError, match="Q: expected"):
            function(bad)
    for narrow in (jnp.float16, jnp.bfloat16):
        for ask in (function, jax.jit(function), jax.vmap(function), jax.grad(lambda Q: function(Q).sum())):
            with pytest.raises(InputError, match="expected float32 or float64, found b?float16"):
                ask(good.astype(narrow))
    for ask in (function, jax.jit(function)):
        for shape in ((), (dof + 1,), (2, dof - 1)):
            with pytest.raises(InputError, match=rf"Q: expected shape \(..., {dof}\)"):
                ask(jnp.zeros(shape))
    masked = np.ma.MaskedArray(np.asarray(good), mask=True)
    with pytest.raises(InputError, match="masked"):
        function(masked)
    broken = good.at[1, 2, 0].set(jnp.nan)
    with pytest.raises(InputError, match=r"Q\[1, 2\]: expected finite numbers, found nan"):
        function(broken)
    for ask in (jax.jit(function), jax.vmap(function)):
        with pytest.raises(
            (ValueError, RuntimeError), match=r"InputError: Q\[1, 2\]: expected finite numbers, found nan"
        ):
            jax.block_until_ready(ask(broken))


@pytest.mark.parametrize("name", MEASURES)
def test_bad_checkers(name: str, tmp_path: Path):
    """What is no checker is refused at once, one without pairs when it is asked: its scene may be filled by then."""
    expect_good_checkers(getattr(loewner.jax, name), jnp.array([3.0, 0, 0, 1, 0, 0, 0]), tmp_path)


def test_bad_softness(checker: CollisionChecker):
    """Refused when the function is made."""
    for bad in (0, -1.0, np.nan, np.inf, "soft", True, None):
        with pytest.raises(InputError, match="softness"):
            loewner.jax.clearance(checker, softness=bad)


def test_softness_is_the_checkers(checker: CollisionChecker, Q: np.ndarray, wide: None):
    """What is asked for is what the checker gets."""
    found = loewner.jax.clearance(checker, softness=0.3)(Q)
    np.testing.assert_array_equal(found, checker.clearance(Q, softness=0.3))
    assert (found < loewner.jax.clearance(checker)(Q)).all()


def test_large_batches(checker: CollisionChecker):
    """Many configurations, computed by JAX before they are asked about: nobody waits for the other."""
    Q = checker.robot.random_configurations(20_000, seed=2).astype(np.float32)
    total = jax.jit(lambda x: loewner.jax.clearance(checker)(x * 1.0).sum())(jnp.asarray(Q))
    assert np.isclose(total, checker.clearance(Q).sum(), rtol=1e-3)
