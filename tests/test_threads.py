"""Shares of a batch on several threads: every item once, errors raised, nobody left writing."""

import threading
import time

import numba
import numpy as np
import pytest

from loewner import _threads
from loewner._threads import in_shares


@pytest.fixture(params=[1, 2])
def threads(request):
    if request.param > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one core")
    before = numba.get_num_threads()
    numba.set_num_threads(request.param)
    yield request.param
    numba.set_num_threads(before)


@pytest.mark.parametrize("total", [0, 1, 9, 10, 11, 100, 163, 1000])
def test_every_item_is_done_once_and_results_come_in_order(threads, total):
    done = np.zeros(total, dtype=int)

    def run(first, last):
        done[first:last] += 1
        return first

    found = in_shares(run, total, 10)
    assert (done == 1).all()
    assert found == sorted(found)
    assert found[0] == 0


def test_both_threads_take_part(threads):
    used = set()

    def run(first, last):
        used.add(threading.get_ident())
        time.sleep(0.02)  # as in a kernel: the interpreter is free for the other

    in_shares(run, 80, 10)
    assert len(used) == threads
    assert threading.get_ident() in used


@pytest.mark.parametrize("faulty", [0, 1, 7])
def test_an_error_is_raised_and_nobody_goes_on(threads, faulty):
    started, size = [], 160

    def run(first, last):
        started.append(first)
        if first == faulty * size:
            raise ValueError(f"share {faulty}")
        time.sleep(0.01)

    with pytest.raises(ValueError, match=f"share {faulty}"):
        in_shares(run, 8 * size, 10)
    then = len(started)
    time.sleep(0.05)
    assert len(started) == then <= faulty + threads + 1


def test_shares_within_shares_do_not_wait_for_each_other(threads):
    def inner(first, last):
        return last - first

    def outer(first, last):
        return sum(in_shares(inner, 100, 10))

    assert in_shares(outer, 80, 10) == [100] * len(in_shares(inner, 80, 10))


def test_callers_on_threads_of_their_own(threads):
    results = {}

    def call(name):
        results[name] = sum(in_shares(lambda first, last: last - first, 1000, 10))

    callers = [threading.Thread(target=call, args=(n,)) for n in range(8)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(timeout=30)
    assert results == dict.fromkeys(range(8), 1000)


def test_one_thread_alone_takes_large_shares():
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert in_shares(lambda first, last: last - first, 10 * _threads.ALONE + 5, 10) == [10 * _threads.ALONE, 5]
    finally:
        numba.set_num_threads(before)


def test_an_interrupt_while_arrays_are_handed_back_is_one(threads):
    """Numba says SystemError if Ctrl-C comes while a kernel's results become Python's."""

    def run(first, last):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("returned a result with an exception set") from error

    with pytest.raises(KeyboardInterrupt):
        in_shares(run, 100, 10)
    with pytest.raises(KeyboardInterrupt):
        in_shares(run, 1, 10)

    def fault(first, last):
        raise SystemError("another")

    with pytest.raises(SystemError, match="another"):
        in_shares(fault, 1, 10)
