"""Memory of kernels: where the fields of an arena lie, and what kernels get for them."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from loewner._kernels import records
from loewner._kernels._jit import njit
from loewner._kernels.columns import CACHE_LINE
from loewner._kernels.simd.memory import (
    Arena,
    Place,
    floats,
    integers,
    raw,
    reader,
    record_kind,
    singles,
    sizes_of,
    small_integers,
)


class Counts(NamedTuple):
    links: Any
    dof: Any


class Inner(NamedTuple):
    first: Any
    second: Any


LINKS, DOF = sizes_of(Counts)
FIXED = Arena(times=floats(3), codes=small_integers(5, 2), rest=raw(9))
ARENA = Arena(
    fixed=FIXED,
    ends=floats(2, DOF),
    inner=Arena(Inner, second=integers(DOF * LINKS + 1), first=singles(LINKS, 4, 4)),
    last=integers(3 * LINKS + DOF),
)
_fixed_of, _ends_of, _inner_of, _last_of = ARENA.accessors("fixed ends inner last")
(_inner_at,) = ARENA.addresses("inner")
_times_of, _codes_of, _rest_of = FIXED.accessors("times codes rest")
_size = ARENA.sizing()
_read = reader(record_kind(Inner, record_kind(Inner, "F2 I1"), "S2"))


@njit()
def _fields(work, links, dof):
    place = Place(work, Counts(links, dof))
    fixed, inner = _fixed_of(work), _inner_of(place)
    return _times_of(fixed), _codes_of(fixed), _ends_of(place), inner.second, inner.first, _last_of(place)


@njit()
def _addresses(work, links, dof):
    return _rest_of(work), _inner_at(Place(work, Counts(links, dof)))


@njit()
def _bytes(links, dof):
    return _size(Counts(links, dof))


@njit()
def _arrays(handle):
    found = _read(handle)
    return found.first.first, found.first.second, found.second


@pytest.mark.parametrize(("links", "dof"), [(0, 0), (1, 1), (3, 7), (9, 8)])
def test_fields_are_apart_and_begin_at_cache_lines(links, dof):
    """Fields have their shapes and kinds in a kernel, begin at cache lines and are apart; the last ends the arena."""
    memory = records.aligned(ARENA.size(Counts(links, dof)), np.int8)
    found = _fields(memory.ctypes.data, links, dof)
    shapes = [(3,), (5, 2), (2, dof), (dof * links + 1,), (links, 4, 4), (3 * links + dof,)]
    kinds = [np.float64, np.int8, np.float64, np.int64, np.float32, np.int64]
    assert [array.shape for array in found] == shapes
    assert [array.dtype for array in found] == kinds
    starts = [array.ctypes.data for array in found]
    ends = [start + array.nbytes for start, array in zip(starts, found, strict=True)]
    assert all(start % CACHE_LINE == 0 for start in starts)
    assert all(end <= start for end, start in zip(ends[:-1], starts[1:], strict=True))
    assert starts[0] == memory.ctypes.data
    assert ends[-1] == memory.ctypes.data + len(memory)


def test_sizes_are_the_same_in_python_and_kernels():
    """A kernel computes the bytes that Python does, from any counts."""
    for links, dof in np.random.default_rng(0).integers(0, 100, size=(20, 2)):
        assert _bytes(links, dof) == ARENA.size(Counts(int(links), int(dof)))


def test_raw_bytes_and_whole_arenas_are_addresses():
    """A kernel gets addresses of raw bytes, and of an arena where it asks for the address."""
    memory = records.aligned(ARENA.size(Counts(3, 7)), np.int8)
    rest, inner = _addresses(memory.ctypes.data, 3, 7)
    assert rest == memory.ctypes.data + 2 * CACHE_LINE
    assert inner == _fields(memory.ctypes.data, 3, 7)[3].ctypes.data


def test_kernels_write_where_python_reads():
    """An array of an arena is the memory itself, not a copy."""
    memory = records.aligned(ARENA.size(Counts(2, 2)), np.int8)
    _fields(memory.ctypes.data, 2, 2)[0][:] = 1.0, 2.0, 3.0
    assert (memory[: 3 * 8].view(np.float64) == (1.0, 2.0, 3.0)).all()


def test_a_record_has_the_arrays_behind_its_handle():
    """A record from a handle has the arrays of the table, in order, also in records within it."""
    rng = np.random.default_rng(0)
    arrays = rng.normal(size=(3, 4)), np.arange(5), rng.normal(size=(2, 6)).astype(np.float32)
    table = records.table_of(arrays)
    for found, array in zip(_arrays(table.ctypes.data), arrays, strict=True):
        assert found.dtype == array.dtype
        assert (found == array).all()
