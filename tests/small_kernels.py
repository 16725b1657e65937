"""Two kernels that call a third one, which is compiled apart: what the build does with them takes a moment."""

from loewner._kernels._jit import apart, njit


@apart
def add_up(x):
    total = 0.0
    for k in range(len(x)):
        total += x[k]
    return total


@njit()
def total_of(x):
    return add_up(x)


@njit()
def twice_of(x):
    return 2.0 * add_up(x)
