"""Memory by address: arrays for kernels in memory that Python owns.

A call from Python takes 150 ns for every array that it passes, but only 20 ns for a number. An array that a kernel
makes itself has to be allocated. Therefore, Python owns the memory, passes its address, and keeps it alive.

An `Arena` divides such memory into named fields. The accessors of an arena write LLVM's code themselves, which takes
almost no time; Python functions would take Numba 5 ms per line.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from math import prod
from operator import attrgetter
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from loewner._kernels._jit import inline
from loewner._kernels._numba import cgutils, populate_array, signature
from loewner._kernels.columns import CACHE_LINE
from loewner._kernels.records import ENTRIES

_INT64 = ir.IntType(64)


# -- single arrays ------------------------------------------------------------------------------


def _array(context: Any, builder: Any, kind: Any, address: Any, shape: Any) -> Any:
    """Make Numba's array over memory that it does not own; the address and the lengths of the axes are int64."""
    strides = [_INT64(kind.dtype.bitwidth // 8)]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    array = context.make_array(kind)(context, builder)
    data = builder.inttoptr(address, context.get_data_type(kind.dtype).as_pointer())
    populate_array(array, data, shape, strides, strides[-1], meminfo=None)
    return array._getvalue()


def _arrays_of(entry: Any) -> Any:
    @intrinsic
    def array_at(typingctx, address, shape):
        """Array in C order at an address; `shape` is a tuple."""
        kind = types.Array(entry, len(shape), "C")

        def generate(context, builder, sig, args):
            return _array(context, builder, kind, args[0], cgutils.unpack_tuple(builder, args[1]))

        return signature(kind, types.int64, types.UniTuple(types.int64, len(shape))), generate

    return array_at


integers_at, floats_at = _arrays_of(types.int64), _arrays_of(types.float64)


@inline
def held(array):
    """Keep an array alive until this call, for a callee with its address: Numba frees an array after its last use."""
    return array.size


# -- records by handle --------------------------------------------------------------------------

_ENTRIES = {"F": types.float64, "I": types.int64, "S": types.float32}


def record_kind(record: Any, *parts: Any) -> Any:
    """Numba's type of a record of arrays.

    Parts are the types of inner records, or words for arrays as in `entries`: a letter (here also S for float32), and
    the number of axes.
    """
    kinds = []
    for part in parts:
        words = part.split() if isinstance(part, str) else []
        kinds += [types.Array(_ENTRIES[word[0]], int(word[1:]), "C") for word in words] or [part]
    return types.BaseTuple.from_types(kinds, record)


def reader(kind: Any) -> Any:
    """Make the function for kernels that reads a record of this type from its handle, see `records`."""

    @intrinsic
    def record_of(typingctx, handle):
        def generate(context, builder, sig, args):
            table = builder.inttoptr(args[0], _INT64.as_pointer())
            rows = (builder.gep(table, [_INT64(ENTRIES * row)]) for row in count())
            return _record(context, builder, kind, rows)

        return signature(kind, types.int64), generate

    return record_of


def _record(context: Any, builder: Any, kind: Any, rows: Iterator[Any]) -> Any:
    """Read a record, or an array of it, from the next rows of a table."""
    if isinstance(kind, types.Array):
        row = next(rows)
        address, *shape = [builder.load(builder.gep(row, [_INT64(at)])) for at in range(1 + kind.ndim)]
        return _array(context, builder, kind, address, shape)
    return context.make_tuple(builder, kind, [_record(context, builder, part, rows) for part in kind.types])


# -- arenas -------------------------------------------------------------------------------------


class _Size:
    """A size that depends on a record of counts: a field of the record, or a sum or product of sizes."""

    def __init__(self, of: Callable[[Any], Any]) -> None:
        self.of = of

    def __add__(self, other: Any) -> "_Size":
        return _Size(lambda counts: self.of(counts) + _size_of(other, counts))

    def __mul__(self, other: Any) -> "_Size":
        return _Size(lambda counts: self.of(counts) * _size_of(other, counts))

    __radd__, __rmul__ = __add__, __mul__


def _size_of(size: Any, counts: Any) -> Any:
    return size.of(counts) if isinstance(size, _Size) else size


def sizes_of(record: Any) -> Any:
    """The fields of a record of counts, as sizes for the fields of an `Arena`."""
    return record(*[_Size(attrgetter(name)) for name in record._fields])


class _Number:
    """An int64 of compiled code, with the arithmetic of sizes."""

    def __init__(self, builder: Any, value: Any) -> None:
        self._builder, self.value = builder, value

    def __add__(self, other: Any) -> "_Number":
        return _Number(self._builder, self._builder.add(self.value, _value(other)))

    def __mul__(self, other: Any) -> "_Number":
        return _Number(self._builder, self._builder.mul(self.value, _value(other)))

    def __and__(self, other: int) -> "_Number":
        return _Number(self._builder, self._builder.and_(self.value, _value(other)))

    __radd__, __rmul__ = __add__, __mul__


def _value(number: Any) -> Any:
    return number.value if isinstance(number, _Number) else _INT64(number)


class _Field:
    """An array in C order."""

    def __init__(self, entry: Any, *shape: Any) -> None:
        self.kind, self._shape = types.Array(entry, len(shape), "C"), shape

    def size(self, counts: Any = None) -> Any:
        return prod([_size_of(length, counts) for length in self._shape], start=self.kind.dtype.bitwidth // 8)

    def read(self, context: Any, builder: Any, address: Any, counts: Any) -> Any:
        shape = [_value(_size_of(length, counts)) for length in self._shape]
        return _array(context, builder, self.kind, address.value, shape)


integers, floats = partial(_Field, types.int64), partial(_Field, types.float64)
singles, small_integers = partial(_Field, types.float32), partial(_Field, types.int8)


class Arena:
    """Memory of named fields; each field begins at a cache line.

    Sizes are numbers, or come from `sizes_of` a record of counts. An arena can be a field of another arena.

    Parameters
    ----------
    record : named tuple class, optional
        The type that the whole arena has in kernels, with its fields; without a type, kernels get the address.
    fields : by name, in the order of memory
        Arrays with their shapes, such as `floats(2, DOF)`, other arenas, or a number of bytes, `raw(size)`.
    """

    def __init__(self, record: Any = None, **fields: Any) -> None:
        self._record, self._fields = record, fields
        self.kind: Any = types.int64
        if record:
            self.kind = types.BaseTuple.from_types([fields[name].kind for name in record._fields], record)

    def _starts(self, counts: Any) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields and their offsets, then None and the end of the last field."""
        end = 0
        for name, field in self._fields.items():
            start = _whole_lines(end)
            yield name, start
            end = start + field.size(counts)
        yield None, end

    def _start(self, name: str | None, counts: Any) -> Any:
        return next(start for other, start in self._starts(counts) if other == name)

    def size(self, counts: Any = None) -> Any:
        """Number of bytes of the arena."""
        return self._start(None, counts)

    def read(self, context: Any, builder: Any, address: Any, counts: Any) -> Any:
        """Write the code that makes the record, or the address."""
        if not self._record:
            return address.value
        starts = dict(self._starts(counts))
        elements = [
            self._fields[name].read(context, builder, address + starts[name], counts) for name in self._record._fields
        ]
        return context.make_tuple(builder, self.kind, elements)

    def accessors(self, names: str) -> Any:
        """Make functions for kernels that return the named fields; the names are words of one string.

        Each function takes the address of the arena. If sizes depend on counts, it takes a record that has the address
        as `work` and the counts as `counts`.
        """
        return [_accessor(self._fields[name], partial(self._start, name)) for name in names.split()]

    def addresses(self, names: str) -> Any:
        """Make functions for kernels that return the addresses of the named fields."""
        return [_accessor(Arena(), partial(self._start, name)) for name in names.split()]

    def whole(self) -> Any:
        """Make the function for kernels that returns the whole arena."""
        return _accessor(self, lambda counts: 0)

    def sizing(self) -> Any:
        """Make the function for kernels that computes the number of bytes of the arena from counts."""

        @intrinsic
        def size(typingctx, counts):
            def generate(context, builder, sig, args):
                return _value(self.size(_numbers(builder, counts, args[0])))

            return signature(types.int64, counts), generate

        return size


def raw(size: Any) -> Any:
    """Bytes that kernels receive as an address."""
    return Arena(bytes=small_integers(size))


class Place(NamedTuple):
    """Address of an arena whose sizes depend on counts, and these counts."""

    work: Any
    counts: Any


def _accessor(field: Any, start: Any) -> Any:
    @intrinsic
    def accessor(typingctx, where):
        def generate(context, builder, sig, args):
            work, counts = args[0], None
            if isinstance(where, types.BaseNamedTuple):
                kind = where.types[where.fields.index("counts")]
                counts = _numbers(builder, kind, builder.extract_value(work, where.fields.index("counts")))
                work = builder.extract_value(work, where.fields.index("work"))
            return field.read(context, builder, _Number(builder, work) + start(counts), counts)

        return signature(field.kind, where), generate

    return accessor


def _numbers(builder: Any, kind: Any, record: Any) -> Any:
    """Read a record of int64 counts."""
    return kind.instance_class(*[_Number(builder, builder.extract_value(record, at)) for at in range(len(kind))])


def _whole_lines(size: Any) -> Any:
    """Number of bytes of the whole cache lines that hold `size` bytes."""
    return (size + (CACHE_LINE - 1)) & -CACHE_LINE
