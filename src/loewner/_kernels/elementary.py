"""Elementary functions of numbers, within three units in the last place, with the same bits on every machine.

The C libraries of two systems may differ in the last bits of a sine or a logarithm. Results that must agree on two
machines are therefore computed here. Integers, signs and exponents are exact; everything else is a polynomial in a
small argument, whose operations are rounded as usual. NaN gives NaN.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from loewner._kernels._jit import inline, njit
from loewner._kernels._numba import signature
from loewner._kernels.codes import (
    ARC_COSINE,
    ARC_SINE,
    ARC_TANGENT,
    COSINE_OF,
    CUBE_ROOT,
    EXPONENTIAL,
    LOGARITHM,
    SINE_OF,
)
from loewner._kernels.simd.trig import sine_cosine
from loewner._kernels.simd.vectors import absolute, power_of_two, round_to_even, select, signed_one, sqrt

# The natural logarithm of 2, as a sum of two doubles. The first double has only 32 significant bits, so its product
# with an exponent is exact.
LOG_2 = float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33")

# The number π, as a sum of two doubles.
PI = float.fromhex("0x1.921fb54442d18p+1"), float.fromhex("0x1.1a62633145c07p-53")

# Arc tangents of 0, 1/8, ..., 1. Each is the sum of an entry of ARCS and an entry of RESTS.
ARCS = np.array(
    [
        float.fromhex(text)
        for text in (
            "0x0p+0", "0x1.fd5ba9aac2f6ep-4", "0x1.f5b75f92c80ddp-3", "0x1.6f61941e4def1p-2", "0x1.dac670561bb4fp-2",
            "0x1.1e00babdefeb4p-1", "0x1.4978fa3269ee1p-1", "0x1.700a7c5784634p-1", "0x1.921fb54442d18p-1",
        )
    ]
)  # fmt: skip
RESTS = np.array(
    [
        float.fromhex(text)
        for text in (
            "0x0p+0", "-0x1.cd37686760c17p-59", "0x1.8ab6e3cf7afbdp-57", "-0x1.c63aae6f6e918p-56",
            "0x1.a2b7f222f65e2p-56", "-0x1.928df287a668fp-58", "0x1.2419a87f2a458p-56", "-0x1.8c34d25aadef6p-56",
            "0x1.1a62633145c07p-55",
        )
    ]
)  # fmt: skip

PER_LOG_2 = 1.4426950408889634

MANTISSA = 52  # Number of stored bits of the mantissa of a double.
BIAS = 1023  # Number that is added to the exponent of a double when it is stored.
SMALLEST = 2.0**-1022  # The smallest normal number.
SQRT_2 = float(np.sqrt(2.0))
# `exponential` returns infinity for arguments of at least OVERFLOW, and 0 for arguments of at most UNDERFLOW.
OVERFLOW, UNDERFLOW = 709.782712893384, -745.2


@intrinsic
def bits_of(typingctx, x):
    """Return the bits of a float64 as an integer."""

    def generate(context, builder, sig, args):
        return builder.bitcast(args[0], ir.IntType(64))

    return signature(types.int64, types.float64), generate


@intrinsic
def number_of(typingctx, bits):
    """Return the float64 that has the bits of an integer."""

    def generate(context, builder, sig, args):
        return builder.bitcast(args[0], ir.DoubleType())

    return signature(types.float64, types.int64), generate


@inline
def _reduced_exponential(x, k):
    """e^x / 2^k for one number or for eight, where k is the integer nearest to x / log 2."""
    r = (x - k * LOG_2[0]) - k * LOG_2[1]
    p = 1.0 / 6227020800.0 * r + 1.0 / 479001600.0  # The coefficients are 1/n! from n = 13 down to n = 2.
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    return 1.0 + (r + r * r * p)


@njit()
def exponential(x):
    """e to the power of a number."""
    if not UNDERFLOW < x < OVERFLOW:
        return 0.0 if x <= UNDERFLOW else x if x != x else np.inf
    k = round_to_even(x * PER_LOG_2)
    half = round_to_even(0.5 * k)
    # Multiply by 2^k in two steps, because 2^k itself may overflow or underflow.
    return _reduced_exponential(x, k) * power_of_two(half) * power_of_two(k - half)


@inline
def decays(x):
    """e to the powers of eight numbers that are not positive; 0 below -700, where the power is less than 1e-304."""
    k = round_to_even(x * PER_LOG_2)
    return select(x < -700.0, 0.0, _reduced_exponential(x, k) * power_of_two(k))


@njit()
def logarithm(x):
    """Natural logarithm; minus infinity for zero, and NaN for negative numbers."""
    if not 0.0 < x < np.inf:
        return -np.inf if x == 0.0 else x if x > 0.0 else np.nan
    exponent = 0
    if x < SMALLEST:
        x, exponent = x * 2.0**54, -54
    bits = bits_of(x)
    exponent += (bits >> MANTISSA) - BIAS
    m = number_of((bits & ((1 << MANTISSA) - 1)) | (BIAS << MANTISSA))
    if m > SQRT_2:
        m, exponent = 0.5 * m, exponent + 1
    # log m = log (1 + f) = f - f²/2 + s (f²/2 + R), with s = f / (2 + f) and R = Σ 2 s²ʲ / (2j + 1).
    f, e = m - 1.0, float(exponent)
    s = f / (2.0 + f)
    z = s * s
    p = 2.0 / 25.0 * z + 2.0 / 23.0
    p = p * z + 2.0 / 21.0
    p = p * z + 2.0 / 19.0
    p = p * z + 2.0 / 17.0
    p = p * z + 2.0 / 15.0
    p = p * z + 2.0 / 13.0
    p = p * z + 2.0 / 11.0
    p = p * z + 2.0 / 9.0
    p = p * z + 2.0 / 7.0
    p = p * z + 2.0 / 5.0
    p = p * z + 2.0 / 3.0
    square = 0.5 * f * f
    return e * LOG_2[0] - ((square - (s * (square + z * p) + e * LOG_2[1])) - f)


@inline
def _arc_of(ratio):
    """Arc tangent of a number from 0 to 1: a table entry for the nearest eighth, plus a series for the rest."""
    nearest = int(8.0 * ratio + 0.5)
    c = 0.125 * nearest
    t = (ratio - c) / (1.0 + ratio * c)
    z = t * t
    p = 1.0 / 15.0 * z - 1.0 / 13.0
    p = 1.0 / 11.0 + p * z
    p = p * z - 1.0 / 9.0
    p = p * z + 1.0 / 7.0
    p = p * z - 1.0 / 5.0
    p = p * z + 1.0 / 3.0
    return ARCS[nearest] + (RESTS[nearest] + (t - t * z * p))


@njit()
def arc_tangent(y, x):
    """Angle of the vector (x, y) to the x-axis, from -π to π [rad]; the signs of zeros count, as in C's ``atan2``."""
    if x != x or y != y:
        return np.nan
    wide, high = absolute(x), absolute(y)
    small, large = min(wide, high), max(wide, high)
    angle = 0.0
    if small == np.inf:
        angle = 0.25 * PI[0]
    elif small > 0.0:
        angle = _arc_of(small / large)
    if high > wide:
        angle = 0.5 * PI[0] - (angle - 0.5 * PI[1])
    if signed_one(x) < 0.0:
        angle = PI[0] - (angle - PI[1])
    return signed_one(y) * angle


@inline
def arc_cosine(x):
    """Angle from 0 to π [rad] whose cosine is x; NaN beyond ±1."""
    return 2.0 * arc_tangent(sqrt(1.0 - x), sqrt(1.0 + x))


@inline
def arc_sine(x):
    """Angle from -π/2 to π/2 [rad] whose sine is x; NaN beyond ±1."""
    return arc_tangent(x, sqrt((1.0 - x) * (1.0 + x)))


@njit()
def cube_root(x):
    """Cube root: a power, corrected by a step of Newton's method."""
    size = absolute(x)
    if not 0.0 < size < np.inf:
        return x
    root = exponential(logarithm(size) / 3.0)
    return signed_one(x) * (root - (root - size / (root * root)) / 3.0)


@njit()
def elementary(function, x, y, result):
    """Compute an elementary function, one of `codes`, of each number.

    Parameters
    ----------
    function : int
    x : ndarray, shape (n,)
    y : ndarray, shape (n,)
        Second arguments of `ARC_TANGENT`, which takes the ordinate first; other functions ignore `y`.
    result : ndarray, shape (n,)
    """
    for n in range(len(x)):
        if function == SINE_OF:
            result[n] = sine_cosine(x[n])[0]
        elif function == COSINE_OF:
            result[n] = sine_cosine(x[n])[1]
        elif function == ARC_TANGENT:
            result[n] = arc_tangent(x[n], y[n])
        elif function == ARC_COSINE:
            result[n] = arc_cosine(x[n])
        elif function == ARC_SINE:
            result[n] = arc_sine(x[n])
        elif function == EXPONENTIAL:
            result[n] = exponential(x[n])
        elif function == LOGARITHM:
            result[n] = logarithm(x[n])
        elif function == CUBE_ROOT:
            result[n] = cube_root(x[n])
