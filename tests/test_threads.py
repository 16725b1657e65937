"""Shares of a batch on several threads: every item once, errors raised, nobody left writing; how many threads."""

import gc
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

import driver
import loewner
from loewner import Bodies, Body, InputError, get_num_threads, set_num_threads
from loewner._base import _threads
from loewner._base._kept import kept
from loewner._base._threads import in_shares


@pytest.fixture(params=[1, 2])
def threads(request):
    before = get_num_threads()
    set_num_threads(request.param)
    yield request.param
    set_num_threads(before)


ARM = """<robot name="arm"><link name="base"/><link name="arm"><collision><origin xyz="0.5 0 0"/><geometry>
<box size="1 0.1 0.1"/></geometry></collision></link><joint name="turn" type="revolute"><parent link="base"/>
<child link="arm"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""

# How long a test waits for a thread that is sure to come, on however busy a machine [s].
HANG = 600


def all_there(threads):
    """What shares call so that each of so many threads has one, however late it comes; and the threads that were."""
    used, there = set(), threading.Barrier(threads)

    def wait():
        if threading.get_ident() not in used:
            used.add(threading.get_ident())
            there.wait(HANG)

    return wait, used


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
    wait, used = all_there(threads)
    in_shares(lambda first, last: wait(), 80, 10)
    assert len(used) == threads
    assert threading.get_ident() in used


@pytest.mark.parametrize("faulty", [0, 1, 7])
def test_an_error_is_raised_and_nobody_goes_on(threads, faulty, request):
    """After an error, which reaches the caller, no new share is started."""
    started = []
    # Whoever raises keeps the interpreter until the error is noted: others cannot overtake it on a busy machine.
    request.addfinalizer(partial(sys.setswitchinterval, sys.getswitchinterval()))
    sys.setswitchinterval(HANG)

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
    before = get_num_threads()
    set_num_threads(1)
    try:
        large = 10 * _threads.ALONE
        assert in_shares(lambda first, last: last - first, 50 + 2 * large + 5, 10) == [10, 40, large, large, 5]
    finally:
        set_num_threads(before)


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
    here = threading.get_ident()
    for total in (0, 5, 500):
        told, tellers, often = [], set(), threading.Event()

        def progress(done, of, told=told, tellers=tellers, often=often):
            told.append((done, of))
            tellers.add(threading.get_ident())
            if len(told) > 3:
                often.set()

        def run(first, last, often=often):
            if threading.get_ident() != here:
                often.wait(HANG)  # leaves shares for the caller

        in_shares(run, total, 10, most=40, progress=progress)
        assert told == sorted(told)
        assert told[-1] == (total, total)
        assert tellers == {threading.get_ident()}
        assert total < 500 or len(told) > 3


@pytest.mark.parametrize("threads", [2], indirect=True)
@pytest.mark.parametrize("moment", ["waiting", "working"])
def test_after_an_interrupt_nobody_runs(moment, threads):
    """Whether it comes while the main thread has a share or waits for another's: that one comes to its end first."""
    main, running, started = threading.get_ident(), [], []
    (wait, _), rest_is_done = all_there(threads), threading.Event()

    def run(first, last):
        mine = threading.get_ident() == main
        running.append(1)
        started.append(last - first)
        wait()
        if mine and moment == "working":
            signal.raise_signal(signal.SIGINT)
        if not mine:
            if moment == "waiting":
                rest_is_done.wait(HANG)
                time.sleep(0.05)
                os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
        running.pop()
        if sum(started) == 60:
            rest_is_done.set()

    with pytest.raises(KeyboardInterrupt):
        in_shares(run, 60, 20, most=20)
    assert len(running) == (moment == "working")  # the share that was interrupted did not come to its end
    then = len(started)
    time.sleep(0.15)
    assert len(started) == then


class Callers:
    """Stands for what the frames of callers hold."""


@pytest.mark.parametrize("threads", [2], indirect=True)
@pytest.mark.parametrize("moment", ["own share", "another share", "wait for the others", "results"])
def test_an_error_leaves_nothing_to_the_garbage_collector(moment, threads, monkeypatch):
    """Its traceback and the callers' variables are freed with it: a finalizer in the collector drops interrupts."""
    main, (wait, _) = threading.get_ident(), all_there(threads)

    def run(first, last):
        wait()
        own = threading.get_ident() == main
        if moment == ("own share" if own else "another share"):
            raise KeyboardInterrupt
        if moment == "results" and own:
            raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    def interrupted():
        held = Callers()
        with pytest.raises(KeyboardInterrupt):
            in_shares(run, 60, 20, most=20)
        return weakref.ref(held)

    close = _threads._Work.close
    closings = []

    def interrupted_once(work):
        closings.append(None)
        if len(closings) == 1:
            raise KeyboardInterrupt
        close(work)

    if moment == "wait for the others":
        monkeypatch.setattr(_threads._Work, "close", interrupted_once)
    gc.disable()
    try:
        assert interrupted()() is None
        while _threads._helpers.tasks.qsize():  # helpers that come too late only find that all is done
            time.sleep(0.001)
    finally:
        gc.enable()


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
    """A lock of several processes, such as Numba's, would stay taken after an interrupt: queries take none."""

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

    def take_one():
        with multiprocessing.RLock():
            pass

    box, T = Body.box([1, 1, 1]), np.tile(np.eye(4), (20_000, 1, 1))
    assert locks_taken(take_one) > 0, "or this test sees nothing"
    assert locks_taken(lambda: loewner.collide(box, None, box, T)) == 0
    assert locks_taken(lambda: loewner.overlapping_pairs(Bodies.spheres(np.ones(1000)), T[:1000])) == 0


def interrupted_at(step: int, call: Callable[[], object]) -> bool:
    """Whether the call had so many steps of the interpreter, and was interrupted at the last of them."""
    seen = 0

    def trace(frame, event, argument):
        nonlocal seen
        frame.f_trace_opcodes = True
        seen += 1
        if seen > step:
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def test_an_interrupt_while_the_number_is_asked_leaves_nobody_waiting():
    """At whichever step of the interpreter it comes, also the first time: this thread and others get the number."""
    before, usual = get_num_threads(), _threads._of_process()

    def ask_anew():
        _threads._of_process.cache_clear()
        set_num_threads(usual + 1)
        _threads._setting.count = None
        return get_num_threads()

    try:
        step = 0
        while interrupted_at(step, ask_anew):
            told = []
            asking = threading.Thread(target=lambda told=told: told.append(get_num_threads()))
            asking.start()
            asking.join(timeout=30)
            assert told == [usual]
            assert get_num_threads() in (before, usual, usual + 1)
            step += 1
        assert step > 50
    finally:
        set_num_threads(before)


# -- how many threads --------------------------------------------------------------------------------------------------


def test_the_number_is_each_threads_own():
    """What one thread sets holds for its calls alone; a new thread starts with the number of the process."""
    before, told = get_num_threads(), []

    def another():
        told.append(get_num_threads())
        set_num_threads(5)
        told.append(get_num_threads())

    try:
        set_num_threads(3)
        thread = threading.Thread(target=another)
        thread.start()
        thread.join()
        assert told == [_threads._of_process(), 5]
        assert get_num_threads() == 3
    finally:
        set_num_threads(before)


@pytest.mark.parametrize("threads", [1, 3], indirect=True)
def test_calls_use_so_many_threads(threads):
    """All of them and no more, also where there are fewer processors."""
    wait, used = all_there(threads)
    in_shares(lambda first, last: wait(), 240, 10)
    assert len(used) == threads


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_child_has_the_number_of_its_parent(threads):
    """It starts threads of its own up to that number, and may set another, which its parent does not see."""

    def shares_of(n):
        wait, used = all_there(threads + n)
        set_num_threads(get_num_threads() + n)
        in_shares(lambda first, last: wait(), 240, 10)
        return None if len(used) == threads + n else f"{len(used)} threads, {get_num_threads()} set"

    in_shares(lambda first, last: time.sleep(0.01), 80, 10)  # the parent's threads wait, and are not the child's
    for n in (0, 1):
        assert not driver.faults(driver.run(shares_of, [n]))
    assert get_num_threads() == threads


def number_in(environment: dict[str, str]) -> str:
    """What a new process says its number of threads is, or the error; and that the import raised none."""
    code = """
import loewner, threading
print("imported")
try:
    print(loewner.get_num_threads())
except loewner.InputError as error:
    print(error)
    try:
        loewner.collide(loewner.Body.sphere(1.0), None, loewner.Body.sphere(1.0), [[[1, 0, 0, 0], [0, 1, 0, 0],
            [0, 0, 1, 0], [0, 0, 0, 1]]] * 20_000)
    except loewner.InputError as again:
        assert str(again) == str(error)
    else:
        raise AssertionError("a batch was answered") from None
    loewner.set_num_threads(2)
    assert loewner.get_num_threads() == 2
"""
    others = {k: v for k, v in os.environ.items() if k not in ("LOEWNER_NUM_THREADS", "NUMBA_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=others | environment)
    assert done.returncode == 0, done.stderr
    imported, told = done.stdout.splitlines()
    assert imported == "imported"
    return told


def test_the_environment_sets_the_number_of_the_process(monkeypatch):
    """Ours before Numba's, and Numba's before the processors; a new process reads them as this one does."""
    assert number_in({"LOEWNER_NUM_THREADS": " 7 ", "NUMBA_NUM_THREADS": "3"}) == "7"
    monkeypatch.setattr(_threads, "_setting", _threads._Setting())
    monkeypatch.delenv("LOEWNER_NUM_THREADS", raising=False)
    try:
        for variable, number in (("3", 3), (None, len(os.sched_getaffinity(0)) if sys.platform == "linux" else None)):
            monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
            if variable:
                monkeypatch.setenv("NUMBA_NUM_THREADS", variable)
            _threads._of_process.cache_clear()
            assert number in (get_num_threads(), None)
    finally:
        _threads._of_process.cache_clear()


@pytest.mark.parametrize("text", ["", "0", "-1", "1.5", "two", "1025", "9" * 5000, "²", "1_0"])
def test_a_variable_that_is_no_number_of_threads_is_told_when_it_is_needed(text, monkeypatch):
    """An error with the variable's name, at each use; Numba's variable, which is not ours, is left alone then."""
    _threads._of_process.cache_clear()
    monkeypatch.setattr(_threads, "_setting", _threads._Setting())
    try:
        monkeypatch.setenv("LOEWNER_NUM_THREADS", text)
        for _ in range(2):
            with pytest.raises(InputError, match="^LOEWNER_NUM_THREADS: expected an integer (>= 1|<= 1024), found "):
                get_num_threads()
        monkeypatch.delenv("LOEWNER_NUM_THREADS")
        monkeypatch.setenv("NUMBA_NUM_THREADS", text)
        assert get_num_threads() == (1024 if text == "1025" else _threads.processors())
    finally:
        _threads._of_process.cache_clear()


def test_a_bad_variable_does_not_stop_the_import():
    """It is told at the first batch, and to whoever asks for the number; who sets one does not need it."""
    assert number_in({"LOEWNER_NUM_THREADS": "all"}) == "LOEWNER_NUM_THREADS: expected an integer >= 1, found 'all'"


@pytest.mark.parametrize("n", [0, -1, 1025, 2.0, "2", True, None])
def test_what_is_no_number_of_threads_is_refused(n):
    """And changes nothing."""
    before = get_num_threads()
    with pytest.raises(InputError, match="n: expected an integer"):
        set_num_threads(n)
    assert get_num_threads() == before


def test_processors_are_counted_by_what_this_python_has(monkeypatch):
    """By what Python itself may use, else by what the process may use, else all; at least one."""
    monkeypatch.setattr(os, "process_cpu_count", lambda: 5, raising=False)
    assert _threads.processors() == 5
    monkeypatch.setattr(os, "process_cpu_count", lambda: None, raising=False)
    assert _threads.processors() == 1
    monkeypatch.delattr(os, "process_cpu_count")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {1, 4, 6}, raising=False)
    assert _threads.processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert _threads.processors() == 1


@pytest.mark.verify
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers that send signals here")
@pytest.mark.parametrize("delays", [("0.0005", "0.002"), pytest.param(("0.001", "0.004"), marks=pytest.mark.verify)])
def test_a_handler_may_ask_while_threads_start(delays):
    """A signal's handler that asks a batch does not wait for the thread that it interrupted."""
    code = """
import faulthandler, signal, sys
import numpy as np
import loewner
faulthandler.dump_traceback_later(60, exit=True)
ball, T = loewner.Body.sphere(0.5), np.tile(np.eye(4), (100_000, 1, 1))
T[:, 0, 3] = np.linspace(0, 3, len(T))
loewner.set_num_threads(1)
expected = loewner.collide(ball, None, ball, T)
handled = []
signal.signal(signal.SIGALRM, lambda *_: handled.append(loewner.collide(ball, None, ball, T[:10_000]).sum()))
loewner.set_num_threads(64)
signal.setitimer(signal.ITIMER_REAL, float(sys.argv[1]))
assert (loewner.collide(ball, None, ball, T) == expected).all()
signal.setitimer(signal.ITIMER_REAL, 0)
"""
    for delay in delays:
        done = subprocess.run([sys.executable, "-c", code, delay], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_what_is_kept_is_the_same_for_all_threads():
    """Of several that meet in it, each gets what the first one kept, though all of them computed."""
    together, computed = threading.Barrier(4), []

    class Owner:
        @kept
        def value(self):
            """What it is."""
            together.wait(HANG)
            computed.append(object())
            return computed[-1]

    owner, found = Owner(), []
    threads = [threading.Thread(target=lambda: found.append(owner.value)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(computed) == 4
    assert len({id(value) for value in found}) == 1
    assert owner.value is found[0]
    assert Owner.value.__doc__ == "What it is."


def test_eight_callers_get_the_answers_of_one():
    """1,000 queries of a pair, of a batch and of a robot, on each of eight threads, are those of one thread.

    Python without a global lock would run this test as it is.
    """
    rng = np.random.default_rng(7)
    a, b = Body.from_points(rng.normal(size=(20, 3))), Body.box([1.0, 2.0, 0.5])
    T = np.tile(np.eye(4), (1000, 1, 1))
    T[:, :3, 3] = rng.uniform(-2, 2, (1000, 3))
    scene = loewner.Scene()
    scene.add("box", b, [[1, 0, 0, 0.8], [0, 1, 0, 0.3], [0, 0, 1, 0], [0, 0, 0, 1]])
    robot = loewner.Robot.from_urdf(text=ARM)
    checker, Q = loewner.CollisionChecker(robot, scene), rng.uniform(-3, 3, (1000, 1))

    def answers():
        pairs = [loewner.collide(a, None, b, T[k]) for k in range(1000)]
        return [pairs, [bool(checker.collide(q)) for q in Q], loewner.distance(a, None, b, T, exact=True).distance]

    wanted, found = answers(), []
    callers = [threading.Thread(target=lambda: found.append(answers())) for _ in range(8)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(found) == 8
    for pairs, configurations, distances in found:
        assert (pairs, configurations) == (wanted[0], wanted[1])
        assert (distances == wanted[2]).all()
    assert 0 < sum(wanted[0]) < 1000
    assert 0 < sum(wanted[1]) < 1000
