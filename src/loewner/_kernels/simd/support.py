"""Explicit vector code: points eight at a time, in LLVM's own vectors.

LLVM's vectoriser turns neither a search for the largest entry nor short loops of unknown length into good code. These
functions spell the vectors out; LLVM splits them up for a processor whose vectors are shorter. The arithmetic is plain
IEEE: nothing is reordered, and a product and a sum may be contracted, as everywhere in the kernels.

Points come in *blocks* of eight: eight x, eight y, eight z in a row of a flat array. Column i is the point at
``3 * (i - i % 8) + i % 8`` and 8 and 16 entries further; ranges of columns start and end at multiples of eight.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from loewner._kernels._jit import inline
from loewner._kernels.columns import BLOCK, CACHE_LINE

LINE = CACHE_LINE // 8  # the same in float64

_HALF = ir.IntType(32)
_WORD = ir.IntType(64)
_REALS = ir.VectorType(ir.DoubleType(), BLOCK)
_WORDS = ir.VectorType(_WORD, BLOCK)


@inline
def entry_of(column):
    """Where the x of a column is in its flat array; y and z follow at distances of `BLOCK`."""
    return 3 * (column & ~(BLOCK - 1)) + (column & (BLOCK - 1))


def _data(context, builder, array_type, array):
    return context.make_array(array_type)(context, builder, array).data


def _plus(builder, index, offset):
    return builder.add(index, ir.Constant(_WORD, offset))


def _pick(builder, vector, first, count):
    """Entries first .. first + count of a vector."""
    mask = ir.Constant(ir.VectorType(_HALF, count), list(range(first, first + count)))
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), mask)


def _splat(builder, value, vector):
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(_HALF, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(_HALF, BLOCK), [0] * BLOCK))


def _block_pointer(builder, data, index):
    return builder.bitcast(builder.gep(data, [index]), _REALS.as_pointer())


def _load(builder, data, index):
    return builder.load(_block_pointer(builder, data, index), align=8)


def _dot(builder, a, b):
    total = builder.fmul(a[0], b[0])
    for x, y in zip(a[1:], b[1:], strict=True):
        total = builder.fadd(total, builder.fmul(x, y))
    return total


def _larger(builder, value, at, other, other_at):
    """The larger of two values and its place; of equal ones the first, of a number and NaN the first as well."""
    more = builder.fcmp_ordered(">", other, value)
    return builder.select(more, other, value), builder.select(more, other_at, at)


@intrinsic
def farthest(typingctx, points, start, stop, x, y, z):
    """farthest(points, start, stop, x, y, z): column of the point with the largest dot product.

    Columns start .. stop, at least one block. Ties go the same way every time. If all products are NaN or -inf the
    answer is still one of the columns.
    """
    real = types.float64
    signature = types.int64(points, types.int64, types.int64, real, real, real)

    def codegen(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        start, stop = args[1], args[2]
        direction = [_splat(builder, value, _REALS) for value in args[3:]]
        numbers = builder.add(ir.Constant(_WORDS, list(range(BLOCK))), _splat(builder, start, _WORDS))
        before = builder.block
        loop = builder.append_basic_block("farthest.loop")
        done = builder.append_basic_block("farthest.done")
        builder.branch(loop)

        builder.position_at_end(loop)
        i, best, at, here = (builder.phi(kind) for kind in (_WORD, _REALS, _WORDS, _WORDS))
        first = builder.mul(i, ir.Constant(_WORD, 3))
        block = [_load(builder, data, _plus(builder, first, BLOCK * c)) for c in range(3)]
        next_best, next_at = _larger(builder, best, at, _dot(builder, block, direction), here)
        next_i = _plus(builder, i, BLOCK)
        next_here = builder.add(here, ir.Constant(_WORDS, [BLOCK] * BLOCK))
        lowest = ir.Constant(_REALS, [-np.inf] * BLOCK)
        for phi, at_first, then in (
            (i, start, next_i),
            (best, lowest, next_best),
            (at, numbers, next_at),
            (here, numbers, next_here),
        ):
            phi.add_incoming(at_first, before)
            phi.add_incoming(then, loop)
        builder.cbranch(builder.icmp_signed("<", next_i, stop), loop, done)

        builder.position_at_end(done)
        value, place_of = next_best, next_at
        for half in (4, 2):
            value, place_of = _larger(
                builder,
                _pick(builder, value, 0, half),
                _pick(builder, place_of, 0, half),
                _pick(builder, value, half, half),
                _pick(builder, place_of, half, half),
            )
        ends = [builder.extract_element(v, ir.Constant(_HALF, c)) for c in (0, 1) for v in (value, place_of)]
        return _larger(builder, *ends)[1]

    return signature, codegen


def _dots(builder, data, index, direction, kind):
    """Products of one block with a direction."""
    places = [builder.gep(data, [_plus(builder, index, BLOCK * c)]) for c in range(3)]
    align = 4 if kind.element == ir.FloatType() else 8
    block = [builder.load(builder.bitcast(place_vertices, kind.as_pointer()), align=align) for place_vertices in places]
    return _dot(builder, block, direction)


def _largest(builder, a, b):
    """The larger ones of two vectors; b where they do not compare."""
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


@intrinsic
def extent(typingctx, points, start, stop, x, y, z):
    """extent(points, start, stop, x, y, z): the largest dot product of columns start .. stop, in single precision.

    At least one block. Up to three are read without a branch, the last one again where there are fewer: how many there
    are is hard to predict.
    """
    real = types.float32
    signature = real(points, types.int64, types.int64, real, real, real)
    kind = ir.VectorType(ir.FloatType(), BLOCK)

    def codegen(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        start, stop = args[1], args[2]
        direction = [_splat(builder, value, kind) for value in args[3:]]
        three = ir.Constant(_WORD, 3)
        last = _plus(builder, stop, -BLOCK)
        best = None
        for b in range(3):
            at = _plus(builder, start, BLOCK * b)
            at = builder.select(builder.icmp_signed("<", at, last), at, last)
            product = _dots(builder, data, builder.mul(at, three), direction, kind)
            best = product if best is None else _largest(builder, best, product)
        before = builder.block
        loop = builder.append_basic_block("extent.loop")
        done = builder.append_basic_block("extent.done")
        rest = _plus(builder, start, 3 * BLOCK)
        builder.cbranch(builder.icmp_signed("<", rest, stop), loop, done)

        builder.position_at_end(loop)
        i, so_far = builder.phi(_WORD), builder.phi(kind)
        next_best = _largest(builder, so_far, _dots(builder, data, builder.mul(i, three), direction, kind))
        next_i = _plus(builder, i, BLOCK)
        i.add_incoming(rest, before)
        i.add_incoming(next_i, loop)
        so_far.add_incoming(best, before)
        so_far.add_incoming(next_best, loop)
        builder.cbranch(builder.icmp_signed("<", next_i, stop), loop, done)

        builder.position_at_end(done)
        value = builder.phi(kind)
        value.add_incoming(best, before)
        value.add_incoming(next_best, loop)
        for half in (4, 2, 1):
            value = _largest(builder, _pick(builder, value, 0, half), _pick(builder, value, half, half))
        return builder.extract_element(value, ir.Constant(_HALF, 0))

    return signature, codegen


@intrinsic
def place_vertices(typingctx, points, start, stop, r00, r01, r02, r10, r11, r12, r20, r21, r22, x, y, z, placed, to):
    """place(points, start, stop, r00 ... r22, x, y, z, placed, to): write R p + (x, y, z) for a range of columns.

    The results go to `placed` from column `to` on. At least one block.
    """
    real, word = types.float64, types.int64
    signature = types.void(points, word, word, *[real] * 12, placed, word)

    def codegen(context, builder, signature, args):
        data = _data(context, builder, signature.args[0], args[0])
        target = _data(context, builder, signature.args[15], args[15])
        start, stop = args[1], args[2]
        entries = [_splat(builder, value, _REALS) for value in args[3:12]]
        shift = [_splat(builder, value, _REALS) for value in args[12:15]]
        before = builder.block
        loop = builder.append_basic_block("place.loop")
        done = builder.append_basic_block("place.done")
        ahead = builder.sub(args[16], start)
        builder.branch(loop)

        builder.position_at_end(loop)
        i = builder.phi(_WORD)
        first = builder.mul(i, ir.Constant(_WORD, 3))
        out = builder.mul(builder.add(i, ahead), ir.Constant(_WORD, 3))
        block = [_load(builder, data, _plus(builder, first, BLOCK * c)) for c in range(3)]
        for r in range(3):
            moved = builder.fadd(_dot(builder, block, entries[3 * r : 3 * r + 3]), shift[r])
            builder.store(moved, _block_pointer(builder, target, _plus(builder, out, BLOCK * r)), align=8)
        next_i = _plus(builder, i, BLOCK)
        i.add_incoming(start, before)
        i.add_incoming(next_i, loop)
        builder.cbranch(builder.icmp_signed("<", next_i, stop), loop, done)

        builder.position_at_end(done)
        return context.get_dummy_value()

    return signature, codegen


def _prefetching(locality):
    """The functions below; `locality` is LLVM's: 3 for the first-level cache, 2 for the second."""

    @intrinsic
    def prefetch(typingctx, array, index):
        """prefetch(array, index): ask for the cache line of an entry of an array; never faults, never waits."""
        signature = types.void(array, types.int64)

        def codegen(context, builder, signature, args):
            data = _data(context, builder, signature.args[0], args[0])
            pointer = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
            function = builder.module.declare_intrinsic(
                "llvm.prefetch", [pointer.type], ir.FunctionType(ir.VoidType(), [pointer.type, _HALF, _HALF, _HALF])
            )
            read, near, data_cache = (ir.Constant(_HALF, code) for code in (0, locality, 1))
            builder.call(function, [pointer, read, near, data_cache])
            return context.get_dummy_value()

        return signature, codegen

    return prefetch


# The first-level cache can wait for two dozen lines at a time only; the second for more, so ask there for what is
# needed some thousand instructions later.
prefetch, ask_line = _prefetching(3), _prefetching(2)
