"""Elementary functions: accurate to three units in the last place, right at the ends, the same for all callers."""

from collections.abc import Callable

import numpy as np
import pytest

from loewner._base import _elementary
from loewner._kernels._jit import njit
from loewner._kernels.elementary import decays, exponential
from loewner._kernels.simd.vectors import load, store

COUNT = 20_000
EXTENDED = np.finfo(np.longdouble).nmant > 60
SPECIAL = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 5e-324, -5e-324, 1e308])


def angles(rng: np.random.Generator) -> np.ndarray:
    near = np.arange(-2000, 2000) * (np.pi / 4)
    small = rng.normal(size=COUNT) * 10.0 ** rng.integers(-300, 0, COUNT)
    return np.concatenate([rng.uniform(-10, 10, COUNT), rng.uniform(-1e6, 1e6, COUNT), small, near])


def ratios(rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([rng.uniform(-1, 1, COUNT), 1 - rng.uniform(0, 1e-6, COUNT), 1e-4 * rng.normal(size=COUNT)])


def sizes(rng: np.random.Generator) -> np.ndarray:
    near = 1 + 10.0 ** rng.uniform(-15, -1, COUNT) * rng.choice([-1, 1], COUNT)
    return np.concatenate([np.exp(rng.uniform(-744, 709, COUNT)), near, np.arange(1.0, 100.0) * 5e-324])


CASES: dict[str, tuple[Callable, Callable, Callable]] = {
    "sin": (_elementary.sin, np.sin, angles),
    "cos": (_elementary.cos, np.cos, angles),
    "arccos": (_elementary.arccos, np.arccos, ratios),
    "arcsin": (_elementary.arcsin, np.arcsin, ratios),
    "log": (_elementary.log, np.log, sizes),
    "cbrt": (_elementary.cbrt, np.cbrt, lambda rng: sizes(rng) * rng.choice([-1, 1])),
}


@pytest.mark.skipif(not EXTENDED, reason="no floats with more bits to compare with")
@pytest.mark.parametrize("name", CASES)
def test_three_units_in_the_last_place(name: str, rng: np.random.Generator):
    """Beside the mathematics library in extended precision, over all sizes and near multiples of a quarter turn."""
    own, reference, draw = CASES[name]
    x = draw(rng)
    exact = reference(x.astype(np.longdouble))
    assert (np.abs(own(x) - exact) <= 3 * np.spacing(np.abs(exact.astype(float)))).all()


@pytest.mark.skipif(not EXTENDED, reason="no floats with more bits to compare with")
def test_the_angle_of_a_vector(rng: np.random.Generator):
    """In all quadrants, and with components of very different sizes."""
    y, x = (rng.choice([-1, 1], COUNT) * np.exp(rng.uniform(-300, 300, COUNT)) for _ in range(2))
    y, x = np.concatenate([y, rng.normal(size=COUNT)]), np.concatenate([x, rng.normal(size=COUNT)])
    exact = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    found = _elementary.arctan2(y, x)
    assert (np.abs(found - exact) <= 3 * np.spacing(np.abs(exact.astype(float)))).all()


@pytest.mark.parametrize("name", CASES)
def test_special_numbers(name: str):
    """Zeros with signs, infinities, NaN and the smallest numbers give what IEEE 754 asks, a NaN among others alone."""
    own, reference, _ = CASES[name]
    with np.errstate(all="ignore"):
        expected = reference(SPECIAL)
    found = own(SPECIAL)
    huge = np.abs(SPECIAL) > 1e6 if name in ("sin", "cos") else np.zeros(len(SPECIAL), bool)
    np.testing.assert_allclose(found[~huge], expected[~huge], rtol=1e-15, atol=0)
    signed = ~np.isnan(expected) & ~huge & (name != "sin")  # the sine of -0 is 0
    np.testing.assert_array_equal(np.signbit(found[signed]), np.signbit(expected[signed]))


def test_special_vectors():
    """All pairs of special components have the angle that C's atan2 gives, signs of zeros included."""
    y, x = map(np.ravel, np.meshgrid(SPECIAL, SPECIAL))
    found, expected = _elementary.arctan2(y, x), np.arctan2(y, x)
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0)
    known = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(expected[known]))


def test_numbers_and_arrays_have_the_same_bits(rng: np.random.Generator):
    """A number gives a float, an array keeps its shape, and read-only and strided arrays are taken."""
    x = rng.uniform(-9, 9, (4, 5))
    x.setflags(write=False)
    found = _elementary.sin(x)
    assert found.shape == (4, 5)
    assert [_elementary.sin(value) for value in x.ravel().tolist()] == found.ravel().tolist()
    np.testing.assert_array_equal(_elementary.sin(x[::2, ::2]), found[::2, ::2])
    assert isinstance(_elementary.cos(1.0), float)
    assert _elementary.log(np.empty(0)).shape == (0,)


@njit()
def _exponentials(x, alone, eight):
    for i in range(0, x.size, 8):
        store(eight, i, decays(load(x, i)))
        for k in range(i, i + 8):
            alone[k] = exponential(x[k])


@pytest.mark.skipif(not EXTENDED, reason="no floats with more bits to compare with")
def test_exponentials_of_numbers_and_of_eight(rng: np.random.Generator):
    """Numbers over their whole range, and eight that are not positive, down to the limit below which they give zero."""
    parts = rng.uniform(-745, 709, COUNT), rng.normal(size=COUNT), rng.uniform(-700, 0, COUNT), np.zeros(8)
    x = np.concatenate(parts)
    alone, eight = np.empty(len(x)), np.empty(len(x))
    _exponentials(x, alone, eight)
    exact = np.exp(x.astype(np.longdouble))
    assert (np.abs(alone - exact) <= 3 * np.spacing(exact.astype(float))).all()
    falls = (x <= 0) & (x >= -700)
    assert (np.abs(eight - exact)[falls] <= 3 * np.spacing(exact.astype(float))[falls]).all()
    assert (eight[x < -700] == 0).all()


def test_exponentials_of_special_numbers():
    """Infinities, NaN and numbers beyond the range."""
    x = np.array([-np.inf, np.inf, np.nan, 710.0, -746.0, 0.0, -0.0, 5e-324])
    alone, eight = np.empty(8), np.empty(8)
    _exponentials(x, alone, eight)
    np.testing.assert_array_equal(alone, [0, np.inf, np.nan, np.inf, 0, 1, 1, 1])
    np.testing.assert_array_equal(eight[[0, 2, 4, 5, 6]], [0, np.nan, 0, 1, 1])
