"""Reads and writes of a GPU thread: numbers at addresses, one lane at a time.

The same functions compile for the CPU, where a loop over the threads' numbers replaces the GPU's parallel threads. An
address and the index of an entry specify memory, because a Numba array would add its shape and reference count.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from loewner._kernels._numba import signature
from loewner._kernels.simd.vectors import scalar

_WORD, _HALF, _BYTE = ir.IntType(64), ir.IntType(32), ir.IntType(8)


def _place(builder, entry, address, at):
    """Pointer to an entry of memory at an address."""
    return builder.gep(builder.inttoptr(address, entry.as_pointer()), [at])


def _reader(entry, result, widened, what):
    """Make a function that reads an entry of the given type."""

    @intrinsic
    def read(typingctx, address, at):
        def generate(context, builder, sig, args):
            value = builder.load(_place(builder, entry, *args))
            return builder.sext(value, _WORD) if widened else value

        return signature(result, types.int64, types.int64), generate

    read.__doc__ = f"The {what} that is the entry `at` of the memory at an address."
    return read


number_at = _reader(ir.FloatType(), scalar, False, "float32")
integer_at = _reader(_HALF, types.int64, True, "int32")
word_at = _reader(_WORD, types.int64, False, "int64")


@intrinsic
def eight_at(typingctx, address, at):
    """Read eight float32 that start at entry `at`, which must be aligned to sixteen bytes."""

    def generate(context, builder, sig, args):
        four, elements = ir.VectorType(ir.FloatType(), 4), []
        first = builder.bitcast(_place(builder, ir.FloatType(), *args), four.as_pointer())
        for half in range(2):
            both = builder.load(builder.gep(first, [ir.Constant(_HALF, half)]), align=16)
            elements += [builder.extract_element(both, ir.Constant(_HALF, lane)) for lane in range(4)]
        return context.make_tuple(builder, sig.return_type, elements)

    return signature(types.UniTuple(scalar, 8), types.int64, types.int64), generate


@intrinsic
def put_number(typingctx, address, at, x):
    """Write a float32."""

    def generate(context, builder, sig, args):
        builder.store(args[2], _place(builder, ir.FloatType(), *args[:2]))
        return context.get_dummy_value()

    return signature(types.void, types.int64, types.int64, scalar), generate


def _writer(entry, what):
    @intrinsic
    def write(typingctx, address, at, value):
        def generate(context, builder, sig, args):
            builder.store(builder.trunc(args[2], entry), _place(builder, entry, *args[:2]))
            return context.get_dummy_value()

        return signature(types.void, types.int64, types.int64, types.int64), generate

    write.__doc__ = f"Write the low bits of an integer as an {what}."
    return write


put_integer, put_byte = _writer(_HALF, "int32"), _writer(_BYTE, "int8")


def _atomic(operation, what):
    @intrinsic
    def change(typingctx, address, at, value):
        def generate(context, builder, sig, args):
            place = _place(builder, _HALF, *args[:2])
            before = builder.atomic_rmw(operation, place, builder.trunc(args[2], _HALF), "monotonic")
            return builder.sext(before, _WORD)

        return signature(types.int64, types.int64, types.int64, types.int64), generate

    change.__doc__ = f"{what} an int32 that other threads change too, in one step; returns what it was."
    return change


add_to, raise_to = _atomic("add", "Add to"), _atomic("max", "Raise to at least a value")


@intrinsic
def lane_of(typingctx, x):
    """Convert a float to one lane, rounded to single precision."""

    def generate(context, builder, sig, args):
        return builder.fptrunc(args[0], ir.FloatType())

    return signature(scalar, types.float64), generate


@intrinsic
def lane_of_integer(typingctx, x):
    """Convert an integer below 2^24 to one lane."""

    def generate(context, builder, sig, args):
        return builder.sitofp(builder.trunc(args[0], _HALF), ir.FloatType())

    return signature(scalar, types.int64), generate


@intrinsic
def holds(typingctx, condition):
    """Return whether a comparison of single lanes holds."""

    def generate(context, builder, sig, args):
        return args[0]

    return signature(types.boolean, condition), generate
