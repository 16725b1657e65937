"""Products fused with sums: which ones are, with which signs, and that no other thing decides it."""

from collections.abc import Callable
from fractions import Fraction

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loewner._kernels import _fused
from loewner._kernels._jit import njit
from loewner._kernels.simd.vectors import rounded_product

numbers = st.floats(-1e3, 1e3)


@njit()
def plus(x, y, z):
    return x * y + z


@njit()
def minus(x, y, z):
    return x * y - z


@njit()
def from_z(x, y, z):
    return z - x * y


@njit()
def twice(x, y, z):
    product = x * y
    return (product + z) * product


@njit()
def apart(x, y, z):
    return rounded_product(x, y) + z


def once(x: float, y: float, z: float, sign_of_product: int, sign_of_z: int) -> float:
    """The sum of a product and a number, rounded once."""
    return float(sign_of_product * Fraction(x) * Fraction(y) + sign_of_z * Fraction(z))


@pytest.mark.parametrize(("kernel", "signs"), [(plus, (1, 1)), (minus, (1, -1)), (from_z, (-1, 1))])
@given(x=numbers, y=numbers, z=numbers)
def test_a_product_and_a_sum_round_once(kernel: Callable, signs: tuple[int, int], x: float, y: float, z: float):
    """x y + z, x y - z and z - x y are the exact values, rounded; zeros aside, whose signs Fraction does not know."""
    assert kernel(x, y, z) == once(x, y, z, *signs)


@given(x=numbers, y=numbers, z=numbers)
def test_other_products_round(x: float, y: float, z: float):
    """A product with two uses is rounded for both, and one that may not be fused is rounded, too."""
    assert twice(x, y, z) == (x * y + z) * (x * y)
    assert apart(x, y, z) == x * y + z


def rewritten(body: str, can_fuse: bool = True) -> str:
    text = f"define <2 x double> @f(<2 x double> %a, <2 x double> %b, <2 x double> %c) {{\n{body}\n}}"
    module = _fused.fused(llvm.parse_assembly(text), can_fuse)
    module.verify()
    return str(module)


ONE = "%p = fmul contract <2 x double> %a, <double 1.5, double 2.5>\n"


def test_vectors_and_constants():
    """Vectors are fused as numbers are, with constants as factors and as summands."""
    text = rewritten(ONE + "%q = fadd contract <2 x double> <double 3.0, double 4.0>, %p\nret <2 x double> %q")
    assert "call <2 x double> @llvm.fma.v2f64(" in text
    assert "fmul" not in text


def test_both_summands_are_products():
    """The first product is fused; the other is rounded."""
    text = rewritten(
        ONE + "%r = fmul contract <2 x double> %b, %c\n%q = fsub contract <2 x double> %p, %r\nret <2 x double> %q"
    )
    assert text.count("llvm.fma") == 2  # the call and the declaration
    assert text.count("fmul") == 1


@pytest.mark.parametrize(
    "body",
    [
        ONE + "br label %next\nnext:\n%q = fadd contract <2 x double> %p, %c\nret <2 x double> %q",
        ONE + "%q = fadd <2 x double> %p, %c\nret <2 x double> %q",
        ONE + "%q = fadd contract <2 x double> %p, %p\nret <2 x double> %q",
        ONE.replace("contract ", "") + "%q = fadd contract <2 x double> %p, %c\nret <2 x double> %q",
    ],
    ids=["another block", "a sum without the flag", "used twice", "a product without the flag"],
)
def test_what_is_not_fused(body: str):
    """Nothing is fused across blocks, without both flags, or for several uses; and no flag is left for LLVM."""
    text = rewritten(body)
    assert "llvm.fma" not in text
    assert "contract" not in text


def test_a_processor_without_the_instruction():
    """Nothing is fused, by this module or by LLVM later."""
    text = rewritten(ONE + "%q = fadd contract <2 x double> %p, %c\nret <2 x double> %q", can_fuse=False)
    assert "llvm.fma" not in text
    assert "contract" not in text


@pytest.mark.skipif(not llvm.get_process_triple().startswith("x86_64"), reason="names of x86-64 processors")
def test_which_processors_have_the_instruction():
    """By name or by feature; the oldest x86-64 has none."""
    known = {
        ("x86-64", ""): False,
        ("x86-64", "+fma"): True,
        ("x86-64-v3", ""): True,
        ("x86-64-v4", "-prefer-256-bit"): True,
    }
    assert {key: _fused.can_fuse(*key) for key in known} == known


def test_random_order_of_operands(rng: np.random.Generator):
    """A kernel gives the same bits for numbers alone and in arrays."""
    x, y, z = rng.normal(size=(3, 50))

    @njit()
    def of_arrays(x, y, z, out):
        for n in range(len(x)):
            out[n] = x[n] * y[n] + z[n]

    out = np.empty(50)
    of_arrays(x, y, z, out)
    assert out.tolist() == [plus(*values) for values in zip(x.tolist(), y.tolist(), z.tolist(), strict=True)]
