"""Eight doubles side by side: a Numba type whose arithmetic is vector instructions by construction.

A formula written once on scalars runs unchanged on eight piece pairs: +, -, *, / and the functions
below take floats and vectors alike, a float standing for eight copies. LLVM maps ``<8 x double>`` to
one AVX-512 register, two of AVX2 or four of SSE2 and NEON; nothing hangs on whether it finds a loop
worth vectorising. Comparisons give masks; there are no branches on vectors.

As everywhere in this package the only freedom given to the compiler is contraction.
"""

import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 8

_DOUBLE = ir.DoubleType()
_VECTOR = ir.VectorType(_DOUBLE, LANES)
_MASK = ir.VectorType(ir.IntType(1), LANES)
_CONTRACT = ("contract",)


class _Lanes(types.Type):
    """Numba type of eight values in a register."""


vector = _Lanes("Vector8")
mask = _Lanes("Mask8")


@register_model(_Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, fe_type):
        super().__init__(manager, fe_type, _VECTOR if fe_type == vector else _MASK)


def _spread(builder, value, kind):
    """A float as eight copies; a vector as it is."""
    if kind in (vector, mask):
        return value
    lane = ir.Constant(ir.IntType(32), 0)
    one = builder.insert_element(ir.Constant(value_type := ir.VectorType(value.type, LANES), ir.Undefined), value, lane)
    return builder.shuffle_vector(one, ir.Constant(value_type, ir.Undefined), ir.Constant(_indices().type, [0] * LANES))


def _indices():
    return ir.Constant(ir.VectorType(ir.IntType(32), LANES), list(range(LANES)))


def _numbers(args):
    """Whether these are floats and vectors, at least one of them a vector."""
    return vector in args and all(a == vector or isinstance(a, types.Float) for a in args)


def _operation(symbol, emit, result=vector):
    """Teach Numba one binary operator on vectors."""

    @infer_global(symbol)
    class _Typed(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and _numbers(args):
                return signature(result, *args)
            return None

    for a, b in ((vector, vector), (vector, types.Float), (types.Float, vector)):

        @lower_builtin(symbol, a, b)
        def _lowered(context, builder, sig, args):
            x, y = (_spread(builder, v, t) for v, t in zip(args, sig.args, strict=True))
            return emit(builder, x, y)


_operation(operator.add, lambda b, x, y: b.fadd(x, y, flags=_CONTRACT))
_operation(operator.sub, lambda b, x, y: b.fsub(x, y, flags=_CONTRACT))
_operation(operator.mul, lambda b, x, y: b.fmul(x, y, flags=_CONTRACT))
_operation(operator.truediv, lambda b, x, y: b.fdiv(x, y))
for _symbol, _text in ((operator.gt, ">"), (operator.ge, ">="), (operator.lt, "<"), (operator.le, "<=")):
    _operation(_symbol, lambda b, x, y, text=_text: b.fcmp_ordered(text, x, y), mask)


@infer_global(operator.and_)
@infer_global(operator.or_)
class _MaskPair(AbstractTemplate):
    def generic(self, args, kws):
        return signature(mask, mask, mask) if tuple(args) == (mask, mask) else None


@infer_global(operator.invert)
class _MaskNot(AbstractTemplate):
    def generic(self, args, kws):
        return signature(mask, mask) if tuple(args) == (mask,) else None


@infer_global(operator.neg)
class _Negated(AbstractTemplate):
    def generic(self, args, kws):
        return signature(vector, vector) if tuple(args) == (vector,) else None


@lower_builtin(operator.and_, mask, mask)
def _and(context, builder, sig, args):
    return builder.and_(*args)


@lower_builtin(operator.or_, mask, mask)
def _or(context, builder, sig, args):
    return builder.or_(*args)


@lower_builtin(operator.invert, mask)
def _invert(context, builder, sig, args):
    return builder.not_(args[0])


@lower_builtin(operator.neg, vector)
def _neg(context, builder, sig, args):
    return builder.fneg(args[0])


def _call(builder, name, *args):
    """Call an LLVM intrinsic that is overloaded on the type of its arguments."""
    kind = args[0].type
    suffix = "v8f64" if kind == _VECTOR else "f64"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind] * len(args)), f"llvm.{name}.{suffix}"
    )
    return builder.call(function, args)


def _result(args):
    return vector if vector in args else types.float64


@intrinsic
def root(typingctx, x):
    """Square root."""

    def generate(context, builder, sig, args):
        return _call(builder, "sqrt", args[0])

    return signature(_result((x,)), x), generate


@intrinsic
def magnitude(typingctx, x):
    """Absolute value."""

    def generate(context, builder, sig, args):
        return _call(builder, "fabs", args[0])

    return signature(_result((x,)), x), generate


def _choice(builder, comparison, x, y):
    return builder.select(builder.fcmp_ordered(comparison, x, y), x, y)


def _both(builder, sig, args):
    if sig.return_type == vector:
        return [_spread(builder, v, t) for v, t in zip(args, sig.args, strict=True)]
    return args


@intrinsic
def larger(typingctx, x, y):
    """x if x > y, else y: a NaN in x gives y."""

    def generate(context, builder, sig, args):
        return _choice(builder, ">", *_both(builder, sig, args))

    return signature(_result((x, y)), x, y), generate


@intrinsic
def smaller(typingctx, x, y):
    """x if x < y, else y: a NaN in x gives y."""

    def generate(context, builder, sig, args):
        return _choice(builder, "<", *_both(builder, sig, args))

    return signature(_result((x, y)), x, y), generate


@intrinsic
def choose(typingctx, condition, x, y):
    """x where the condition holds, else y."""

    def generate(context, builder, sig, args):
        a, b = _both(builder, signature(sig.return_type, *sig.args[1:]), args[1:])
        return builder.select(args[0], a, b)

    result = vector if condition == mask else _result((x, y))
    return signature(result, condition, x, y), generate


@intrinsic
def bits(typingctx, m):
    """Lanes of a mask as the low eight bits of an integer."""

    def generate(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return signature(types.int64, mask), generate


def _address(context, builder, array_type, array, offset):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [offset])


@intrinsic
def store(typingctx, array, offset, x):
    """Write eight doubles to a flat array from `offset` on."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        builder.store(args[2], builder.bitcast(address, _VECTOR.as_pointer()), align=8)
        return context.get_dummy_value()

    return signature(types.void, array, types.int64, vector), generate


@intrinsic
def load(typingctx, array, offset):
    """Read eight doubles from a flat array from `offset` on."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        return builder.load(builder.bitcast(address, _VECTOR.as_pointer()), align=8)

    return signature(vector, array, types.int64), generate


def _columns_of(builder, rows):
    """Transpose eight rows of eight by three rounds of pairwise exchanges."""
    for step in (1, 2, 4):
        low = [i // step % 2 * LANES + i - i // step % 2 * step for i in range(LANES)]
        high = [x + step for x in low]
        after = list(rows)
        for r in range(LANES):
            if r & step == 0:
                pair = rows[r], rows[r + step]
                after[r] = builder.shuffle_vector(*pair, ir.Constant(_indices().type, low))
                after[r + step] = builder.shuffle_vector(*pair, ir.Constant(_indices().type, high))
        rows = after
    return rows


@intrinsic
def columns(typingctx, table, width, rows, at, column):
    """Eight consecutive columns of eight rows of a flat row-major table, as eight vectors.

    Parameters
    ----------
    table : ndarray, flat
    width : int
        Entries a row.
    rows : ndarray of int64
        Row numbers; entries at .. at + 8 are used.
    at, column : int
    """

    def generate(context, builder, sig, args):
        array, wide, numbers, at, column = args
        loaded = []
        for lane in range(LANES):
            place = builder.add(at, ir.Constant(at.type, lane))
            row = builder.load(_address(context, builder, sig.args[2], numbers, place))
            first = builder.add(builder.mul(row, wide), column)
            address = builder.bitcast(_address(context, builder, sig.args[0], array, first), _VECTOR.as_pointer())
            loaded.append(builder.load(address, align=8))
        return context.make_tuple(builder, sig.return_type, _columns_of(builder, loaded))

    integer = types.int64
    return signature(types.UniTuple(vector, LANES), table, integer, rows, integer, integer), generate


@intrinsic
def prefetch(typingctx, array, offset):
    """Ask for the cache line that holds one entry of a flat array; never a fault, whatever the offset."""

    def generate(context, builder, sig, args):
        address = _address(context, builder, sig.args[0], args[0], args[1])
        byte = ir.IntType(8).as_pointer()
        i32 = ir.IntType(32)
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [byte, i32, i32, i32]), "llvm.prefetch.p0"
        )
        hint = [ir.Constant(i32, x) for x in (0, 3, 1)]  # read, keep in every cache, data
        builder.call(function, [builder.bitcast(address, byte), *hint])
        return context.get_dummy_value()

    return signature(types.void, array, types.int64), generate
