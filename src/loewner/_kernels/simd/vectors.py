"""Numba types for eight doubles, or for one, eight or sixteen floats, whose arithmetic is vector instructions.

A formula written once for scalars runs unchanged on many piece pairs. The operators +, -, *, / and the functions below
take both floats and vectors, and a float counts as the required number of copies. LLVM maps ``<8 x double>`` and ``<16
x float>`` to one AVX-512 register, two of AVX2 or four of SSE2 and NEON, so nothing depends on LLVM's vectorisation of
loops. Comparisons yield masks, because code for vectors cannot branch.

The third type is one lane of single precision, for a GPU thread. Unlike with Numba's float32, a literal combined with a
lane is rounded to single precision, as it is with vectors. `simd.scalars` reads and writes lanes in memory.

Contraction is the only freedom that the compiler has, as everywhere in this package.
"""

import operator

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model

from loewner._kernels._jit import inline
from loewner._kernels._numba import AbstractTemplate, cgutils, errors, infer_global, signature
from loewner._kernels.columns import CACHE_LINE

LANES, SINGLE_LANES = 8, 16
ALL, SINGLE_ALL = 2**LANES - 1, 2**SINGLE_LANES - 1  # The bits of a mask that is true in all lanes.

_CONTRACT = ("contract",)


class Lanes(types.Type):
    """Numba type of several values in a register; for LLVM, a single value is not a vector."""

    def __init__(self, name, entry, count):
        super().__init__(name)
        self.count = count
        self.llvm = ir.VectorType(entry, count) if count > 1 else entry


vector = Lanes("Vector8", ir.DoubleType(), LANES)
single = Lanes("Single16", ir.FloatType(), SINGLE_LANES)
mask = Lanes("Mask8", ir.IntType(1), LANES)
single_mask = Lanes("Mask16", ir.IntType(1), SINGLE_LANES)
eight_singles = Lanes("Single8", ir.FloatType(), LANES)
scalar = Lanes("Single1", ir.FloatType(), 1)
scalar_mask = Lanes("Mask1", ir.IntType(1), 1)
numbers = Lanes("Numbers8", ir.IntType(64), LANES)

_MASK_OF = {vector: mask, eight_singles: mask, single: single_mask, scalar: scalar_mask}
_VECTORS, _MASKS = tuple(_MASK_OF), tuple(dict.fromkeys(_MASK_OF.values()))


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, fe_type):
        super().__init__(manager, fe_type, fe_type.llvm)


def _repeat(builder, value, count):
    """Copies of a scalar side by side."""
    kind = ir.VectorType(value.type, count)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), _indices([0] * count))


def _indices(numbers):
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), numbers)


def _spread(builder, value, kind, wanted):
    """Copies of a float, or an unchanged vector."""
    if kind == wanted:
        return value
    if wanted != vector and value.type == ir.DoubleType():
        value = builder.fptrunc(value, ir.FloatType())
    return _repeat(builder, value, wanted.count) if wanted.count > 1 else value


def _joint(args):
    """The only vector type among the arguments, if all other arguments are floats; otherwise None."""
    kinds = {a for a in args if not isinstance(a, types.Float)}
    return kinds.pop() if len(kinds) == 1 and kinds <= set(_VECTORS) else None


def _operation(symbol, emit, compares=False):
    """Define one binary operator on vectors for Numba."""

    @infer_global(symbol)
    class _Typed(AbstractTemplate):
        def generic(self, args, kws):
            kind = _joint(args) if len(args) == 2 else None
            return kind and signature(_MASK_OF[kind] if compares else kind, *args)

    for kind in _VECTORS:
        for a, b in ((kind, kind), (kind, types.Float), (types.Float, kind)):

            @lower_builtin(symbol, a, b)
            def _lowered(context, builder, sig, args, kind=kind):
                x, y = (_spread(builder, v, t, kind) for v, t in zip(args, sig.args, strict=True))
                return emit(builder, x, y)


_operation(operator.add, lambda b, x, y: b.fadd(x, y, flags=_CONTRACT))
_operation(operator.sub, lambda b, x, y: b.fsub(x, y, flags=_CONTRACT))
_operation(operator.mul, lambda b, x, y: b.fmul(x, y, flags=_CONTRACT))
_operation(operator.truediv, lambda b, x, y: b.fdiv(x, y))
for _symbol, _text in ((operator.gt, ">"), (operator.ge, ">="), (operator.lt, "<"), (operator.le, "<=")):
    _operation(_symbol, lambda b, x, y, text=_text: b.fcmp_ordered(text, x, y), True)


@infer_global(operator.and_)
@infer_global(operator.or_)
class _MaskPair(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], *args) if len(set(args)) == 1 and args[0] in _MASKS else None


@infer_global(operator.invert)
class _MaskNot(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], *args) if args[0] in _MASKS else None


@infer_global(operator.neg)
class _Negated(AbstractTemplate):
    def generic(self, args, kws):
        return signature(args[0], *args) if args[0] in _VECTORS else None


for _kind in _MASKS:
    lower_builtin(operator.and_, _kind, _kind)(lambda context, builder, sig, args: builder.and_(*args))
    lower_builtin(operator.or_, _kind, _kind)(lambda context, builder, sig, args: builder.or_(*args))
    lower_builtin(operator.invert, _kind)(lambda context, builder, sig, args: builder.not_(args[0]))
for _kind in _VECTORS:
    lower_builtin(operator.neg, _kind)(lambda context, builder, sig, args: builder.fneg(args[0]))


def _call(builder, name, *args):
    """Call an LLVM intrinsic that is overloaded on the type of its arguments."""
    kind = args[0].type
    entry = kind.element if isinstance(kind, ir.VectorType) else kind
    suffix = (
        ("f64" if entry == ir.DoubleType() else "f32")
        if entry is kind
        else (f"v{kind.count}" + ("f64" if entry == ir.DoubleType() else "f32"))
    )
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind] * len(args)), f"llvm.{name}.{suffix}"
    )
    return builder.call(function, args)


def _ones(kind):
    """Make a constant of ones for a type."""
    return [1.0] * kind.count if isinstance(kind, ir.VectorType) else 1.0


def _result(args):
    return _joint(args) or (types.float32 if set(args) == {types.float32} else types.float64)


@intrinsic
def sqrt(typingctx, x):
    """Square root."""

    def generate(context, builder, sig, args):
        return _call(builder, "sqrt", args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def absolute(typingctx, x):
    """Absolute value."""

    def generate(context, builder, sig, args):
        return _call(builder, "fabs", args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def signed_one(typingctx, x):
    """1 with the sign of x, including the sign of a zero."""

    def generate(context, builder, sig, args):
        return _call(builder, "copysign", ir.Constant(args[0].type, _ones(args[0].type)), args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def round_to_even(typingctx, x):
    """Nearest integer, with halves rounded to even."""

    def generate(context, builder, sig, args):
        return _call(builder, "rint", args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def floor(typingctx, x):
    """Largest integer that is at most x."""

    def generate(context, builder, sig, args):
        return _call(builder, "floor", args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def sines(typingctx, x):
    """Sine [rad], lane by lane from the mathematics library."""

    def generate(context, builder, sig, args):
        return _call(builder, "sin", args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def cosines(typingctx, x):
    """Cosine [rad], lane by lane from the mathematics library."""

    def generate(context, builder, sig, args):
        return _call(builder, "cos", args[0])

    return signature(_result((x,)), x), generate


def _choice(builder, comparison, x, y):
    return builder.select(builder.fcmp_ordered(comparison, x, y), x, y)


def _both(builder, sig, args):
    if sig.return_type in _VECTORS:
        return [_spread(builder, v, t, sig.return_type) for v, t in zip(args, sig.args, strict=True)]
    return args


@intrinsic
def rounded_product(typingctx, x, y):
    """x * y, rounded separately and never fused with an addition, so that it equals NumPy's product.

    Numba marks all products of a function as ones that may be fused; the fence hides this product from the sum.
    """

    def generate(context, builder, sig, args):
        return _call(builder, "arithmetic.fence", builder.fmul(*_both(builder, sig, args)))

    return signature(_result((x, y)), x, y), generate


@intrinsic
def maximum(typingctx, x, y):
    """x if x > y, otherwise y: a NaN in x gives y, and a NaN in y stays."""

    def generate(context, builder, sig, args):
        return _choice(builder, ">", *_both(builder, sig, args))

    return signature(_result((x, y)), x, y), generate


@intrinsic
def minimum(typingctx, x, y):
    """x if x < y, otherwise y: a NaN in x gives y, and a NaN in y stays."""

    def generate(context, builder, sig, args):
        return _choice(builder, "<", *_both(builder, sig, args))

    return signature(_result((x, y)), x, y), generate


def _halves(count):
    """Half of a number of lanes, a quarter, and so on down to one."""
    return [1 << bit for bit in reversed(range(count.bit_length() - 1))]


def _split(builder, x, half):
    """The two halves of a vector."""
    return [builder.shuffle_vector(x, x, _indices(list(range(at, at + half)))) for at in (0, half)]


def _reduction(name, comparison, what):
    @intrinsic
    def reduction(typingctx, x):
        def generate(context, builder, sig, args):
            lanes = args[0]
            for half in _halves(x.llvm.count):
                lanes = _choice(builder, comparison, *_split(builder, lanes, half))
            return builder.extract_element(lanes, ir.Constant(ir.IntType(32), 0))

        return signature(types.float64 if x == vector else types.float32, x), generate

    reduction.__name__, reduction.__doc__ = name, f"The {what} of the lanes of a vector, none of them NaN."
    return reduction


lowest, highest = _reduction("lowest", "<", "least"), _reduction("highest", ">", "largest")


@intrinsic
def entry_at_highest(typingctx, x, y):
    """Entry of y, a vector of `numbers`, in the lane where x is largest; x has no NaN. Equal values of x always give
    the same entry.
    """

    def generate(context, builder, sig, args):
        x, y = args
        for half in _halves(LANES):
            (x, more), (y, at_more) = _split(builder, x, half), _split(builder, y, half)
            larger = builder.fcmp_ordered(">", more, x)
            x, y = builder.select(larger, more, x), builder.select(larger, at_more, y)
        return builder.extract_element(y, ir.Constant(ir.IntType(32), 0))

    return signature(types.int64, vector, numbers), generate


@intrinsic
def halves_swapped(typingctx, x):
    """The last four lanes of a vector, followed by its first four lanes."""

    def generate(context, builder, sig, args):
        return builder.shuffle_vector(args[0], args[0], _indices([lane ^ 4 for lane in range(LANES)]))

    return signature(vector, vector), generate


@intrinsic
def next_lanes(typingctx, x):
    """The lanes of a vector from the second lane on; the last lane appears twice."""

    def generate(context, builder, sig, args):
        return builder.shuffle_vector(args[0], args[0], _indices([min(lane + 1, LANES - 1) for lane in range(LANES)]))

    return signature(vector, vector), generate


@intrinsic
def numbers_from(typingctx, first):
    """An integer and the seven integers after it, as `numbers`."""

    def generate(context, builder, sig, args):
        return builder.add(_repeat(builder, args[0], LANES), ir.Constant(numbers.llvm, list(range(LANES))))

    return signature(numbers, types.int64), generate


@intrinsic
def select(typingctx, condition, x, y):
    """x where the condition holds, otherwise y."""

    def generate(context, builder, sig, args):
        a, b = args[1:] if x == numbers else _both(builder, signature(sig.return_type, *sig.args[1:]), args[1:])
        return builder.select(args[0], a, b)

    return signature(x if x == y == numbers else _result((x, y)), condition, x, y), generate


@intrinsic
def broadcast(typingctx, x):
    """Eight copies of a float64, or sixteen of a float32."""
    kind = single if x == types.float32 else vector

    def generate(context, builder, sig, args):
        return _spread(builder, args[0], x, kind)

    return signature(kind, x), generate


@intrinsic
def share_of_roots(typingctx, x, y):
    """√x / (√x + √y) of two numbers > 0, as 1 / (1 + √(y/x)): a guess, with its root in single precision.

    Single precision computes eight square roots in the time of two in double precision. Beyond the range of single
    precision, the guess is 0 or 1.
    """

    def generate(context, builder, sig, args):
        ratio = builder.fdiv(args[1], args[0])
        if x in (single, scalar):
            apart = _call(builder, "sqrt", ratio)
        else:
            small = builder.fptrunc(ratio, ir.VectorType(ir.FloatType(), x.llvm.count))
            apart = builder.fpext(_call(builder, "sqrt", small), x.llvm)
        one = ir.Constant(x.llvm, _ones(x.llvm))
        return builder.fdiv(one, builder.fadd(one, apart))

    return signature(x, x, y), generate


# If this number is added to an integer, the lowest bits of the sum hold the integer plus the bias of exponents.
_TO_EXPONENT = 1.5 * 2.0**52 + 1023.0


@intrinsic
def power_of_two(typingctx, k):
    """2 to the power of a float64, or of eight, that is an integer from -1022 to 1023."""

    def generate(context, builder, sig, args):
        number = args[0].type
        word = ir.VectorType(ir.IntType(64), LANES) if k == vector else ir.IntType(64)
        several = isinstance(number, ir.VectorType)
        shifted = builder.fadd(args[0], ir.Constant(number, [_TO_EXPONENT] * LANES if several else _TO_EXPONENT))
        places = ir.Constant(word, [52] * LANES if several else 52)
        return builder.bitcast(builder.shl(builder.bitcast(shifted, word), places), number)

    return signature(_result((k,)), k), generate


@intrinsic
def everywhere(typingctx, m):
    """Return whether a comparison holds; for vectors, in all lanes."""

    def generate(context, builder, sig, args):
        if m == types.boolean:
            return args[0]
        bits = ir.IntType(m.count)
        return builder.icmp_unsigned("==", builder.bitcast(args[0], bits), ir.Constant(bits, -1))

    return signature(types.boolean, m), generate


@intrinsic
def movemask(typingctx, m):
    """Lanes of a mask as the low bits of an integer."""

    def generate(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(m.count)), ir.IntType(64))

    return signature(types.int64, m), generate


@intrinsic
def mask_of(typingctx, x):
    """Mask of eight lanes from the low eight bits of an integer."""

    def generate(context, builder, sig, args):
        return builder.bitcast(builder.trunc(args[0], ir.IntType(8)), ir.VectorType(ir.IntType(1), 8))

    return signature(mask, types.int64), generate


@intrinsic
def masked_store(typingctx, array, at, m, code):
    """Among consecutive bytes, write a code to the bytes whose bits are set in a mask."""

    def generate(context, builder, sig, args):
        array, at, where, code = args
        count = m.llvm.count
        several = ir.VectorType(ir.IntType(8), count)
        place = builder.bitcast(_address(context, builder, sig.args[0], array, at), several.as_pointer())
        codes = _repeat(builder, builder.trunc(code, ir.IntType(8)), count)
        builder.store(builder.select(where, codes, builder.load(place, align=1)), place, align=1)
        return context.get_dummy_value()

    return signature(types.void, array, types.int64, m, types.int64), generate


def _address(context, builder, array_type, array, offset):
    if array_type.layout != "C":  # The address ignores strides, so another layout would lead to wrong entries.
        raise errors.LoweringError(f"expected an array in C order, found {array_type}")
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [offset])


@intrinsic
def store(typingctx, array, offset, x):
    """Write a vector to a flat array of float64, starting at `offset`."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        value = args[2]
        if x == single:
            value = builder.fpext(value, ir.VectorType(ir.DoubleType(), SINGLE_LANES))
        builder.store(value, builder.bitcast(address, value.type.as_pointer()), align=8)
        return context.get_dummy_value()

    return signature(types.void, array, types.int64, x), generate


@intrinsic
def load(typingctx, array, offset):
    """Read eight numbers from a flat array of float64 or float32, starting at `offset`."""
    kind = eight_singles if array.dtype == types.float32 else vector

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        return builder.load(builder.bitcast(address, kind.llvm.as_pointer()), align=4 if kind == eight_singles else 8)

    return signature(kind, array, types.int64), generate


def _columns_of(builder, rows):
    """Transpose rows of eight, or of twice eight side by side, by three rounds of pairwise exchanges."""
    width = rows[0].type.count
    for step in (1, 2, 4):
        low = [i // step % 2 * width + i - i // step % 2 * step for i in range(width)]
        high = [x + step for x in low]
        after = list(rows)
        for r in range(8):
            if r & step == 0:
                pair = rows[r], rows[r + step]
                after[r] = builder.shuffle_vector(*pair, _indices(low))
                after[r + step] = builder.shuffle_vector(*pair, _indices(high))
        rows = after
    return rows


def _load_rows(context, builder, sig, args, count):
    """Load eight entries of each of `count` rows."""
    array, wide, numbers, at, column = args
    entry = ir.FloatType() if sig.args[0].dtype == types.float32 else ir.DoubleType()
    eight = ir.VectorType(entry, 8)
    loaded = []
    for lane in range(count):
        place = builder.add(at, ir.Constant(at.type, lane))
        row = builder.load(_address(context, builder, sig.args[2], numbers, place))
        first = builder.add(builder.mul(row, wide), column)
        address = builder.bitcast(_address(context, builder, sig.args[0], array, first), eight.as_pointer())
        loaded.append(builder.load(address, align=4 if entry == ir.FloatType() else 8))
    return loaded


@intrinsic
def gather_transpose(typingctx, table, width, rows, at, column):
    """Eight consecutive columns of eight rows of a row-major table of float64, as eight vectors.

    Parameters
    ----------
    table : ndarray
    width : int
        Number of entries per row.
    rows : ndarray of int64
        Row numbers; only the entries at .. at + 8 are used.
    at, column : int
    """

    def generate(context, builder, sig, args):
        rows = _load_rows(context, builder, sig, args, LANES)
        return context.make_tuple(builder, sig.return_type, _columns_of(builder, rows))

    integer = types.int64
    return signature(types.UniTuple(vector, 8), table, integer, rows, integer, integer), generate


@intrinsic
def spread_row(typingctx, table, width, rows, at, column):
    """The vectors of `gather_transpose` if all eight rows are the row at `at`."""

    def generate(context, builder, sig, args):
        (row,) = _load_rows(context, builder, sig, args, 1)
        lanes = [builder.shuffle_vector(row, row, _indices([lane] * LANES)) for lane in range(LANES)]
        return context.make_tuple(builder, sig.return_type, lanes)

    integer = types.int64
    return signature(types.UniTuple(vector, 8), table, integer, rows, integer, integer), generate


@intrinsic
def scatter_transpose(typingctx, table, width, rows, at, column, eight):
    """Write eight vectors to eight consecutive columns of eight rows: the reverse of `gather_transpose`."""

    def generate(context, builder, sig, args):
        table, width, rows, at, column, eight = args
        for lane, row in enumerate(_columns_of(builder, cgutils.unpack_tuple(builder, eight, LANES))):
            place = builder.add(at, ir.Constant(at.type, lane))
            number = builder.load(_address(context, builder, sig.args[2], rows, place))
            first = builder.add(builder.mul(number, width), column)
            address = _address(context, builder, sig.args[0], table, first)
            builder.store(row, builder.bitcast(address, vector.llvm.as_pointer()), align=8)
        return context.get_dummy_value()

    integer = types.int64
    return signature(types.void, table, integer, rows, integer, integer, types.UniTuple(vector, LANES)), generate


@intrinsic
def gather_transpose_single(typingctx, table, width, rows, at, column):
    """`gather_transpose` for sixteen rows, in single precision; the table may have either precision."""

    def generate(context, builder, sig, args):
        rows = _load_rows(context, builder, sig, args, SINGLE_LANES)
        if rows[0].type.element == ir.DoubleType():
            rows = [builder.fptrunc(row, ir.VectorType(ir.FloatType(), 8)) for row in rows]
        both = [builder.shuffle_vector(rows[r], rows[r + 8], _indices(list(range(16)))) for r in range(8)]
        return context.make_tuple(builder, sig.return_type, _columns_of(builder, both))

    integer = types.int64
    return signature(types.UniTuple(single, 8), table, integer, rows, integer, integer), generate


# LLVM's codes for the first-level cache and for the second-level cache. Only two dozen prefetched lines can be pending
# in the first-level cache, but more can be pending in the second-level cache.
_FIRST_LEVEL, _SECOND_LEVEL = 3, 2


def _prefetch(builder, address, level):
    """Prefetch a cache line, which never faults and never waits."""
    byte, half = ir.IntType(8).as_pointer(), ir.IntType(32)
    function = builder.module.declare_intrinsic(
        "llvm.prefetch", [byte], ir.FunctionType(ir.VoidType(), [byte, half, half, half])
    )
    read, near, data = (ir.Constant(half, code) for code in (0, level, 1))
    builder.call(function, [builder.bitcast(address, byte), read, near, data])


def _prefetching_line(level):
    @intrinsic
    def prefetch(typingctx, array, index):
        """Prefetch the cache line of an entry of an array."""

        def generate(context, builder, sig, args):
            _prefetch(builder, _address(context, builder, sig.args[0], *args), level)
            return context.get_dummy_value()

        return signature(types.void, array, types.int64), generate

    return prefetch


# `prefetch` loads data that is needed soon into the first-level cache. `prefetch_far` loads data that is needed about a
# thousand instructions later into the second-level cache.
prefetch, prefetch_far = _prefetching_line(_FIRST_LEVEL), _prefetching_line(_SECOND_LEVEL)


def _prefetching_rows(count):
    @intrinsic
    def prefetch_rows(typingctx, table, width, rows, at):
        """Prefetch the first two cache lines of as many rows as a vector has lanes, a thousand instructions ahead.

        At the pace of the certificate, too few lines can be pending in the first-level cache for all rows and poses.
        """

        def generate(context, builder, sig, args):
            array, wide, numbers, at = args
            for lane in range(count):
                place = builder.add(at, ir.Constant(at.type, lane))
                row = builder.load(_address(context, builder, sig.args[2], numbers, place))
                address = _address(context, builder, sig.args[0], array, builder.mul(row, wide))
                first = builder.bitcast(address, ir.IntType(8).as_pointer())
                for offset in (0, CACHE_LINE):
                    _prefetch(builder, builder.gep(first, [ir.Constant(ir.IntType(64), offset)]), _SECOND_LEVEL)
            return context.get_dummy_value()

        integer = types.int64
        return signature(types.void, table, integer, rows, integer), generate

    return prefetch_rows


prefetch_rows, prefetch_rows_single = _prefetching_rows(LANES), _prefetching_rows(SINGLE_LANES)


@intrinsic
def load_single(typingctx, array, offset):
    """Read sixteen floats from a flat array of float32, starting at `offset`."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        return builder.load(builder.bitcast(address, single.llvm.as_pointer()), align=4)

    return signature(single, array, types.int64), generate


@intrinsic
def store_strided(typingctx, array, offset, step, eight):
    """Write eight vectors to a flat array of their precision, at `offset` and at steps of `step` from there."""

    def generate(context, builder, sig, args):
        array, at, step, eight = args
        for x in cgutils.unpack_tuple(builder, eight, 8):
            address = _address(context, builder, sig.args[0], array, at)
            builder.store(x, builder.bitcast(address, x.type.as_pointer()), align=4)
            at = builder.add(at, step)
        return context.get_dummy_value()

    integer = types.int64
    return signature(types.void, array, integer, integer, eight), generate


@intrinsic
def load_rounded(typingctx, array, offset):
    """Read sixteen doubles from a flat array, starting at `offset`, in single precision."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        wide = ir.VectorType(ir.DoubleType(), SINGLE_LANES)
        return builder.fptrunc(builder.load(builder.bitcast(address, wide.as_pointer()), align=8), single.llvm)

    return signature(single, array, types.int64), generate


@intrinsic
def gather_single(typingctx, table, width, rows, at, column):
    """One column of sixteen rows of a table of float32; the parameters are documented in `gather_transpose`."""

    def generate(context, builder, sig, args):
        array, wide, numbers, at, column = args
        result = ir.Constant(single.llvm, ir.Undefined)
        for lane in range(SINGLE_LANES):
            place = builder.add(at, ir.Constant(at.type, lane))
            row = builder.load(_address(context, builder, sig.args[2], numbers, place))
            first = builder.add(builder.mul(row, wide), column)
            value = builder.load(_address(context, builder, sig.args[0], array, first))
            result = builder.insert_element(result, value, ir.Constant(ir.IntType(32), lane))
        return result

    integer = types.int64
    return signature(single, table, integer, rows, integer, integer), generate


@intrinsic
def store_rounded(typingctx, array, offset, x):
    """Write eight doubles to a flat array of float32, starting at `offset`."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        value = builder.fptrunc(args[2], ir.VectorType(ir.FloatType(), LANES))
        builder.store(value, builder.bitcast(address, value.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature(types.void, array, types.int64, x), generate


@intrinsic
def scatter_transpose_rounded(typingctx, table, width, rows, at, column, eight):
    """Write eight vectors to eight consecutive columns of eight rows of a table of float32."""

    def generate(context, builder, sig, args):
        table, width, rows, at, column, eight = args
        small = ir.VectorType(ir.FloatType(), LANES)
        vectors = [builder.fptrunc(x, small) for x in cgutils.unpack_tuple(builder, eight, LANES)]
        for lane, row in enumerate(_columns_of(builder, vectors)):
            place = builder.add(at, ir.Constant(at.type, lane))
            number = builder.load(_address(context, builder, sig.args[2], rows, place))
            first = builder.add(builder.mul(number, width), column)
            address = _address(context, builder, sig.args[0], table, first)
            builder.store(row, builder.bitcast(address, small.as_pointer()), align=4)
        return context.get_dummy_value()

    integer = types.int64
    return signature(types.void, table, integer, rows, integer, integer, types.UniTuple(vector, LANES)), generate


@intrinsic
def highest_bit(typingctx, x):
    """Number of the highest bit set of an integer other than 0."""

    def generate(context, builder, sig, args):
        zeros = builder.ctlz(args[0], ir.Constant(ir.IntType(1), 1))
        return builder.sub(ir.Constant(ir.IntType(64), 63), zeros)

    return signature(types.int64, types.int64), generate


@intrinsic
def lowest_bit(typingctx, x):
    """Number of the lowest bit set of an integer other than 0."""

    def generate(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return signature(types.int64, types.int64), generate


@intrinsic
def bits_set(typingctx, x):
    """Number of bits that are set in an integer."""

    def generate(context, builder, sig, args):
        return builder.ctpop(args[0])

    return signature(types.int64, types.int64), generate


@inline
def next_lane(bits):
    """The lowest bit set of an integer other than 0, and the remaining bits: one round of a loop over lanes."""
    return lowest_bit(bits), bits & (bits - 1)
