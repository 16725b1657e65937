"""Shares of a batch on several threads: every item once, errors raised, nobody left writing."""

import os
import signal
import sys
import threading
import time

import numba
import numpy as np
import pytest

import loewner
from loewner import Bodies, Body, _threads
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
    """Every item is done exactly once, and results come in the order of the shares."""
    done = np.zeros(total, dtype=int)

    def run(first, last):
        done[first:last] += 1
        return first

    found = in_shares(run, total, 10)
    assert (done == 1).all()
    assert found == sorted(found)
    assert found[0] == 0


def test_both_threads_take_part(threads):
    """The caller and every further thread do a part of the work."""
    used = set()

    def run(first, last):
        used.add(threading.get_ident())
        time.sleep(0.02)  # as in a kernel: the interpreter is free for the other

    in_shares(run, 80, 10)
    assert len(used) == threads
    assert threading.get_ident() in used


@pytest.mark.parametrize("faulty", [0, 1, 7])
def test_an_error_is_raised_and_nobody_goes_on(threads, faulty):
    """After an error, which reaches the caller, no new share is started."""
    started = []

    def run(first, last):
        started.append(first)
        if len(started) == faulty + 1:
            raise ValueError(f"share {faulty}")
        time.sleep(0.01)

    with pytest.raises(ValueError, match=f"share {faulty}"):
        in_shares(run, 8 * 160, 10)
    then = len(started)
    time.sleep(0.05)
    assert len(started) == then <= faulty + threads + 1


def test_shares_within_shares_do_not_wait_for_each_other(threads):
    """A share may divide its own work into shares without a deadlock."""

    def inner(first, last):
        return last - first

    def outer(first, last):
        return sum(in_shares(inner, 100, 10))

    assert in_shares(outer, 80, 10) == [100] * len(in_shares(inner, 80, 10))


def test_callers_on_threads_of_their_own(threads):
    """Several callers at once get their own complete results."""
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
    """With one thread shares grow to a fixed multiple after the first two."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        large = 10 * _threads.ALONE
        assert in_shares(lambda first, last: last - first, 50 + 2 * large + 5, 10) == [10, 40, large, large, 5]
    finally:
        numba.set_num_threads(before)


def test_shares_become_small_where_items_take_long(threads, monkeypatch):
    """An interrupt waits for one share: none takes much longer than it should, but the first."""
    monkeypatch.setattr(_threads, "LONG", 0.02)
    sizes = in_shares(lambda first, last: time.sleep(0.005 * (last - first)) or last - first, 60, 10)
    assert sum(sizes) == 60
    assert max(sizes[threads:]) <= 4


def test_of_several_errors_the_first_by_number_is_raised(threads):
    """Whichever thread is faster: the same error on any number of threads."""

    def run(first, last):
        time.sleep(0.01 if first == 0 else 0.0)
        raise ValueError(f"share {first}")

    for _ in range(5):
        with pytest.raises(ValueError, match="share 0$"):
            in_shares(run, 1000, 10)


def test_progress_rises_to_the_total(threads):
    """On the caller's thread, between shares; also where one share is all."""
    for total in (0, 5, 500):
        told, tellers = [], set()

        def progress(done, of, told=told, tellers=tellers):
            told.append((done, of))
            tellers.add(threading.get_ident())

        in_shares(lambda first, last: time.sleep(0.001), total, 10, most=40, progress=progress)
        assert told == sorted(told)
        assert told[-1] == (total, total)
        assert tellers == {threading.get_ident()}
        assert total < 500 or len(told) > 3


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
@pytest.mark.parametrize("moment", ["waiting", "working"])
def test_after_an_interrupt_nobody_runs(moment):
    """Whether it comes while the main thread has a share or waits for another's: that one comes to its end first."""
    main, running, started = threading.get_ident(), [], []

    def run(first, last):
        mine = threading.get_ident() == main
        running.append(1)
        started.append(first)
        if mine == (moment == "working") and len(started) < 4:
            time.sleep(0.05)
            signal.raise_signal(signal.SIGINT) if mine else os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1 if not mine else 0.0 if moment == "waiting" else 0.02)
        running.pop()

    with pytest.raises(KeyboardInterrupt):
        in_shares(run, 60, 20, most=20)
    assert len(running) == (moment == "working")  # the share that was interrupted did not come to its end
    then = len(started)
    time.sleep(0.15)
    assert len(started) == then


def test_a_thread_that_cannot_start_is_not_missed(monkeypatch):
    """No room for its stack: the threads that there are do its work."""

    def full(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(_threads, "_helpers", _threads._Helpers())
    monkeypatch.setattr(threading.Thread, "start", full)
    assert sum(in_shares(lambda first, last: last - first, 1000, 10)) == 1000


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

    def of_several_arrays(first, last):
        try:
            run(first, last)
        except SystemError as error:
            raise SystemError("returned a result with an exception set") from error

    with pytest.raises(KeyboardInterrupt):
        in_shares(of_several_arrays, 100, 10)
    with pytest.raises(KeyboardInterrupt):
        in_shares(of_several_arrays, 1, 10)

    def fault(first, last):
        raise SystemError("another")

    with pytest.raises(SystemError, match="another"):
        in_shares(fault, 1, 10)


def test_the_main_thread_takes_no_lock_that_others_wait_for():
    """An interrupt just when Numba's lock has been taken would keep it for good: the main thread does not take it."""

    def locks_taken(call) -> int:
        taken = []

        def trace(frame, event, argument):
            if frame.f_code.co_name == "__enter__" and frame.f_code.co_filename.endswith("synchronize.py"):
                taken.append(frame)

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            call()
        finally:
            sys.settrace(before)
        return len(taken)

    box, T = Body.box([1, 1, 1]), np.tile(np.eye(4), (20_000, 1, 1))
    assert locks_taken(numba.get_num_threads) > 0, "or this test sees nothing"
    assert locks_taken(lambda: loewner.collide(box, None, box, T)) == 0
    assert locks_taken(lambda: loewner.overlapping_pairs(Bodies.spheres(np.ones(3000)), T[:3000])) == 0


def test_threads_are_those_that_numba_is_set_to():
    """As `numba.set_num_threads` says, for the thread that calls it."""
    before = numba.get_num_threads()
    try:
        for count in {1, before}:
            numba.set_num_threads(count)
            assert _threads.usable() == count
    finally:
        numba.set_num_threads(before)
