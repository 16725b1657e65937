"""Clearances and distances in PyTorch: what the checker says to the bit, with its gradients, one call a batch."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loewner.torch
from loewner import Body, CollisionChecker, InputError, Scene
from test_clearance import cube_on_a_leash, expect_good_checkers, random_checker, told

torch = pytest.importorskip("torch")

MEASURES = ("clearance", "distance")
# PyTorch compiles some functions of its own by what it calls deprecated, when forward mode is first used.
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script:FutureWarning")


@pytest.fixture
def checker(tmp_path: Path) -> CollisionChecker:
    """A robot of all kinds of joints among bodies."""
    return random_checker(np.random.default_rng(6), tmp_path)


@pytest.fixture
def Q(checker: CollisionChecker) -> np.ndarray:
    return checker.robot.random_configurations(6, seed=3).reshape(2, 3, -1)


def leaf(Q: np.ndarray) -> Any:
    """A tensor that gradients are collected in."""
    return torch.tensor(Q, requires_grad=True)


def backward(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The gradient of the sum of a function's values, by `backward`."""

    def gradient(Q: Any) -> Any:
        Q = Q.clone().requires_grad_()
        function(Q).sum().backward()
        return Q.grad

    return gradient


@pytest.mark.parametrize("name", MEASURES)
def test_values_are_the_checkers(name: str, checker: CollisionChecker, Q: np.ndarray):
    """To the bit, in float64: of one configuration, of batches of every shape, of none; with and without gradients."""
    function = getattr(loewner.torch, name)(checker)
    for some in (Q, Q[0], Q[1, 2], Q[:0], Q[:, :0]):
        for tensor in (torch.tensor(some), leaf(some)):
            found = function(tensor)
            assert found.dtype == torch.float64
            assert found.shape == some.shape[:-1]
            np.testing.assert_array_equal(found.detach(), told(checker, name, some)[0])
    rows = torch.vmap(torch.vmap(function))(torch.tensor(Q))
    np.testing.assert_array_equal(rows, told(checker, name, Q)[0])
    columns = torch.vmap(function, in_dims=1)(torch.tensor(Q))
    np.testing.assert_array_equal(columns, told(checker, name, Q.swapaxes(0, 1))[0])
    strided = torch.tensor(Q).transpose(0, 1)
    np.testing.assert_array_equal(function(strided), told(checker, name, Q.swapaxes(0, 1))[0])


@pytest.mark.parametrize("name", MEASURES)
def test_gradients_are_the_checkers(name: str, checker: CollisionChecker, Q: np.ndarray):
    """To the bit, forwards and backwards, by every transformation that makes one."""
    function, tensor = getattr(loewner.torch, name)(checker), torch.tensor(Q)
    value, gradient = told(checker, name, Q)
    vmap, func = torch.vmap, torch.func

    def rows(Q: Any) -> Any:
        return vmap(vmap(function))(Q)

    for transformed in (
        backward(function),
        backward(rows),
        vmap(vmap(func.grad(function))),
        vmap(vmap(func.jacrev(function))),
        vmap(vmap(func.jacfwd(function))),
        func.grad(lambda Q: function(Q).sum()),
        func.grad(lambda Q: rows(Q).sum()),
    ):
        np.testing.assert_array_equal(transformed(tensor), gradient)
    gradients, values = vmap(vmap(func.grad_and_value(function)))(tensor)
    np.testing.assert_array_equal(values, value)
    np.testing.assert_array_equal(gradients, gradient)
    for jacobian in (func.jacrev(function), func.jacfwd(function), func.jacrev(rows), func.jacfwd(rows)):
        whole = jacobian(tensor)
        np.testing.assert_array_equal(np.einsum("abab...->ab...", whole), gradient)
        assert np.count_nonzero(whole) == np.count_nonzero(gradient)
    for along in (function, rows):
        value_and_slope = func.jvp(along, (tensor,), (torch.ones_like(tensor),))
        np.testing.assert_array_equal(value_and_slope[0], value)
        np.testing.assert_array_equal(value_and_slope[1], torch.tensor(gradient).sum(dim=-1))


def test_gradients_are_differences(tmp_path: Path):
    """By PyTorch's own check, forwards, backwards and in batches."""
    checker = cube_on_a_leash(tmp_path, scene_with_post())
    function = loewner.torch.clearance(checker, softness=0.05)
    # The quaternion stays as it is: differences would take its norm off 1.
    turned = torch.tensor([[1.0, 0, 0, 0], [0.6, 0, 0.8, 0]], dtype=torch.float64)

    def of_positions(x: Any) -> Any:
        return function(torch.cat([x, turned], dim=-1))

    x = leaf(np.array([[1.5, 0.4, 0.2], [-0.3, 2.0, 1.0]]))
    assert torch.autograd.gradcheck(
        of_positions, (x,), check_forward_ad=True, check_batched_grad=True, check_batched_forward_grad=True
    )


def test_a_batch_is_one_call(checker: CollisionChecker, Q: np.ndarray, calls: list[Any]):
    """Of the kernel, under vmap too; a value and its gradient are one, and a value alone asks for no gradient."""
    function = loewner.torch.clearance(checker)

    def asked(thing: Callable[[Any], Any], tensor: Any) -> list[Any]:
        calls.clear()
        thing(tensor)
        return list(calls)

    rows = torch.vmap(torch.vmap(function))
    for value in (function, rows, torch.no_grad()(function)):
        assert asked(value, torch.tensor(Q)) == [(Q.shape, False)]
    assert asked(torch.no_grad()(function), leaf(Q)) == [(Q.shape, False)]
    func = torch.func
    for gradient in (
        backward(function),
        backward(rows),
        torch.vmap(torch.vmap(func.grad(function))),
        func.grad(lambda Q: rows(Q).sum()),
        func.jacfwd(function),
        lambda Q: func.jvp(rows, (Q,), (torch.ones_like(Q),)),
    ):
        assert asked(gradient, torch.tensor(Q)) == [(Q.shape, True)]


def test_float32_is_still_a_bound(checker: CollisionChecker):
    """About exactly the float32 configuration; never above the float64 bound, and the next number is."""
    function = loewner.torch.clearance(checker)
    Q = checker.robot.random_configurations(500, seed=1).astype(np.float32)
    exact, gradient = checker.clearance(Q, gradient=True)
    found = function(torch.tensor(Q)).numpy()
    assert found.dtype == np.float32
    assert (found <= exact).all()
    assert (np.nextafter(found, np.float32(np.inf)) > exact).all()
    np.testing.assert_array_equal(backward(function)(torch.tensor(Q)), gradient.astype(np.float32))


def scene_with_post() -> Scene:
    scene = Scene()
    scene.add("post", Body.box([1, 1, 1]))
    return scene


@pytest.mark.parametrize("name", MEASURES)
def test_second_derivatives_are_refused(name: str, checker: CollisionChecker, Q: np.ndarray):
    """With an error that says so, never zeros, in a cost that has other terms too."""
    function, func, q = getattr(loewner.torch, name)(checker), torch.func, torch.tensor(Q[0, 0])

    def cost(q: Any) -> Any:
        return function(q) + (q**2).sum()

    def twice(q: Any) -> Any:
        q = q.clone().requires_grad_()
        (slope,) = torch.autograd.grad(cost(q), q, create_graph=True)
        (slope.sum() + q.sum()).backward()

    for transformed in (
        twice,
        func.hessian(cost),
        func.jacfwd(func.jacfwd(cost)),
        func.jacrev(func.jacrev(cost)),
        func.jacrev(func.jacfwd(cost)),
        lambda q: torch.vmap(func.hessian(cost))(q[None]),
    ):
        with pytest.raises(InputError, match=f"{name}: expected to be differentiated once, found a second derivative"):
            transformed(q)


@pytest.mark.parametrize("name", MEASURES)
def test_graphs_of_gradients_do_no_harm(name: str, checker: CollisionChecker, Q: np.ndarray):
    """Who keeps the graph of a first derivative, and differentiates by something else, gets that derivative."""
    function, factor = getattr(loewner.torch, name)(checker), torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    q = leaf(Q)
    (slope,) = torch.autograd.grad(function(q).sum(), q, create_graph=True)
    (factor * slope.detach()).sum().backward()
    np.testing.assert_allclose(factor.grad, told(checker, name, Q)[1].sum(), rtol=1e-12)


@pytest.mark.parametrize("name", MEASURES)
def test_derivatives_within_derivatives_by_something_else(name: str, checker: CollisionChecker, Q: np.ndarray):
    """Once by the configurations and once by a factor, one within the other: both as they should be."""
    function, func, tensor = getattr(loewner.torch, name)(checker), torch.func, torch.tensor(Q)
    slope, one = torch.tensor(told(checker, name, Q)[1]).sum(dim=-1).sum(), torch.tensor(1.0, dtype=torch.float64)

    def by_factor(Q: Any) -> Any:
        return func.jvp(lambda factor: factor * function(Q).sum(), (one,), (one,))[1]

    def rows_by_factor(Q: Any) -> Any:
        return func.jvp(lambda factor: factor * torch.vmap(function)(Q).sum(), (one,), (one,))[1]

    for inner in (by_factor, rows_by_factor):
        _, forwards = func.jvp(inner, (tensor,), (torch.ones_like(tensor),))
        np.testing.assert_allclose(forwards, slope, rtol=1e-12)
        np.testing.assert_allclose(func.grad(inner)(tensor).sum(), slope, rtol=1e-12)


@pytest.mark.parametrize("name", MEASURES)
def test_bad_configurations(name: str, checker: CollisionChecker, Q: np.ndarray):
    """What is no tensor, of another type, width or place, or not finite is refused by name."""
    function, good = getattr(loewner.torch, name)(checker), torch.tensor(Q)
    dof = checker.robot.dof
    for bad in (None, "x", 1.5, [0.0] * dof, Q):
        with pytest.raises(InputError, match="Q: expected a tensor of PyTorch, found"):
            function(bad)
    for dtype in (torch.float16, torch.bfloat16, torch.int64, torch.complex128, torch.bool):
        with pytest.raises(InputError, match=f"Q: expected float32 or float64, found {dtype}"):
            function(good.to(dtype))
    for shape in ((), (dof + 1,), (2, dof - 1)):
        with pytest.raises(InputError, match=rf"Q: expected shape \(..., {dof}\)"):
            function(torch.zeros(shape))
    with pytest.raises(InputError, match="Q: expected a tensor on the CPU, found one on meta"):
        function(good.to("meta"))
    with pytest.raises(InputError, match=r"Q: expected a dense tensor, found torch\.sparse_coo"):
        function(good.to_sparse())
    broken = good.clone()
    broken[1, 2, 0] = torch.nan
    for ask in (function, torch.vmap(function), backward(function)):
        with pytest.raises(InputError, match=r"Q\[1, 2\]: expected finite numbers, found nan"):
            ask(broken)


@pytest.mark.parametrize("name", MEASURES)
def test_bad_checkers(name: str, tmp_path: Path):
    """What is no checker is refused at once, one without pairs when it is asked: its scene may be filled by then."""
    expect_good_checkers(getattr(loewner.torch, name), torch.tensor([3.0, 0, 0, 1, 0, 0, 0]), tmp_path)


def test_softness(checker: CollisionChecker, Q: np.ndarray):
    """What is asked for is what the checker gets; what is none is refused when the function is made."""
    found = loewner.torch.clearance(checker, softness=0.3)(torch.tensor(Q))
    np.testing.assert_array_equal(found, checker.clearance(Q, softness=0.3))
    assert (found < loewner.torch.clearance(checker)(torch.tensor(Q))).all()
    for bad in (0, -1.0, np.nan, np.inf, "soft", True, None):
        with pytest.raises(InputError, match="softness"):
            loewner.torch.clearance(checker, softness=bad)
