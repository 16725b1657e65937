"""Memory by address: what Python owns, as arrays for kernels.

A call from Python costs 150 ns for every array it hands over and 20 ns for a number; and an array that a kernel makes
itself costs an allocation. So Python keeps the memory and hands over addresses. Whoever does must keep it alive.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from loewner._kernels._jit import inline
from loewner._kernels.columns import CACHE_LINE


def _pointer_to(kind: Any, entry: Any) -> Any:
    @intrinsic
    def pointer(typingctx, address):
        def generate(context, builder, sig, args):
            return builder.inttoptr(args[0], entry.as_pointer())

        return signature(types.CPointer(kind), types.int64), generate

    return pointer


_integers = _pointer_to(types.int64, ir.IntType(64))
_floats = _pointer_to(types.float64, ir.DoubleType())
_singles = _pointer_to(types.float32, ir.FloatType())
_bytes = _pointer_to(types.int8, ir.IntType(8))


@inline
def integers_at(address, shape):
    """Array of int64; `shape` is a tuple."""
    return carray(_integers(address), shape)


@inline
def floats_at(address, shape):
    """Array of float64."""
    return carray(_floats(address), shape)


@inline
def singles_at(address, shape):
    """Array of float32."""
    return carray(_singles(address), shape)


@inline
def bytes_at(address, shape):
    """Array of int8."""
    return carray(_bytes(address), shape)


@inline
def held(array):
    """Keep an array alive up to here, for what was given its address: Numba frees it after its last use."""
    return array.size


def whole_lines(size: int) -> int:
    """Bytes of whole cache lines that hold `size` bytes; for Python, and as `lines` for kernels."""
    return (size + (CACHE_LINE - 1)) // CACHE_LINE * CACHE_LINE


lines = inline(whole_lines)
