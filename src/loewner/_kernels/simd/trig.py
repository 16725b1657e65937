"""Sine and cosine of one number or of eight, within two units in the last place, and of a float on one lane."""

from loewner._kernels._jit import inline
from loewner._kernels.simd.vectors import absolute, cosines, everywhere, floor, round_to_even, select, sines

# A quarter turn (π/2) as a sum of three doubles (Cody and Waite). The first two doubles have 33 significant bits, so
# their products with an integer below 2^20 are exact. The error of the sum is below 2^-119.
QUARTER_TURN = (
    float.fromhex("0x1.921fb544p+0"),
    float.fromhex("0x1.0b4611a6p-34"),
    float.fromhex("0x1.3198a2e037073p-69"),
)
# Number of quarter turns per radian (2/π). Rounding this number only moves the borders between quadrants.
TURNS_PER_RADIAN = 0.6366197723675814

# Largest angle [rad] for the formulas below. The number of quarter turns in this angle has at most 20 bits.
LARGEST = 1e6


@inline
def sine_cosine(x):
    """Sine and cosine of an angle, or of eight side by side.

    The argument of the Taylor series is the remainder after whole quarter turns, which is within ±π/4. The series ends
    where the next term is below 2^-56 of the result. NaN and infinity give NaN.

    Parameters
    ----------
    x : float or vector
        Angles [rad]. Beyond ±1e6, the C library computes the results, whose last bits differ between systems.

    Returns
    -------
    sine, cosine : float or vector
    """
    if not everywhere(absolute(x) <= LARGEST):
        return sines(x), cosines(x)
    k = round_to_even(x * TURNS_PER_RADIAN)
    # Each step before the last sum is exact, or has an error that is tiny compared with r.
    most, second = x - k * QUARTER_TURN[0], k * QUARTER_TURN[1]
    r = most - second
    r = r + (((most - r) - second) - k * QUARTER_TURN[2])
    z = r * r
    p = 1.0 / 355687428096000.0 * z - 1.0 / 1307674368000.0  # The coefficients are 1/17!, 1/15!, and so on.
    p = p * z + 1.0 / 6227020800.0
    p = p * z - 1.0 / 39916800.0
    p = p * z + 1.0 / 362880.0
    p = p * z - 1.0 / 5040.0
    p = p * z + 1.0 / 120.0
    p = p * z - 1.0 / 6.0
    s = r + r * z * p
    p = 1.0 / 20922789888000.0 * z - 1.0 / 87178291200.0  # The coefficients are 1/16!, 1/14!, and so on.
    p = p * z + 1.0 / 479001600.0
    p = p * z - 1.0 / 3628800.0
    p = p * z + 1.0 / 40320.0
    p = p * z - 1.0 / 720.0
    p = p * z + 1.0 / 24.0
    half = 0.5 * z
    rough = 1.0 - half
    c = rough + (((1.0 - rough) - half) + z * z * p)
    quadrant = k - 4.0 * floor(0.25 * k)
    crossed = absolute(absolute(quadrant - 2.0) - 1.0) < 0.5  # Whether the angle is in quadrant 1 or 3.
    sine, cosine = select(crossed, c, s), select(crossed, s, c)
    sine = select(quadrant > 1.5, -sine, sine)
    return sine, select(absolute(quadrant - 1.5) < 1.0, -cosine, cosine)


@inline
def sine_of(x):
    """Sine of an angle [rad], or of eight."""
    return sine_cosine(x)[0]


# A quarter turn (π/2) as a sum of three floats. The first two floats have twelve significant bits, so their products
# with an integer below 2^12 are exact. The error of the sum is below 2^-57.
SINGLE_QUARTER_TURN = float.fromhex("0x1.922p+0"), float.fromhex("-0x1.2aep-18"), float.fromhex("-0x1.de973ep-31")

SINGLE_LARGEST = 1000.0  # Largest angle [rad] in single precision. It contains fewer than 2^10 quarter turns.


@inline
def sine_cosine_single(x):
    """Sine and cosine of a float on one lane, within 5 · 2^-24 of the exact values (docs/certified.md).

    Beyond ±1000 rad, the results are meaningless; the caller has to check this.

    Parameters
    ----------
    x : scalar
        Angle [rad].

    Returns
    -------
    sine, cosine : scalar
    """
    k = round_to_even(x * TURNS_PER_RADIAN)
    r = ((x - k * SINGLE_QUARTER_TURN[0]) - k * SINGLE_QUARTER_TURN[1]) - k * SINGLE_QUARTER_TURN[2]
    z = r * r
    p = 1.0 / 362880.0 * z - 1.0 / 5040.0  # The coefficients are 1/9!, 1/7!, and so on.
    p = p * z + 1.0 / 120.0
    p = p * z - 1.0 / 6.0
    s = r + (r * z) * p
    p = 1.0 / 40320.0 - 1.0 / 3628800.0 * z  # The coefficients are 1/8!, 1/10!, and so on.
    p = p * z - 1.0 / 720.0
    p = p * z + 1.0 / 24.0
    c = (1.0 - 0.5 * z) + (z * z) * p
    quadrant = k - 4.0 * floor(0.25 * k)
    crossed = absolute(absolute(quadrant - 2.0) - 1.0) < 0.5  # Whether the angle is in quadrant 1 or 3.
    sine, cosine = select(crossed, c, s), select(crossed, s, c)
    sine = select(quadrant > 1.5, -sine, sine)
    return sine, select(absolute(quadrant - 1.5) < 1.0, -cosine, cosine)
