"""Divide work among several threads, for code that runs outside the interpreter lock: kernels and Qhull.

This module has its own threads instead of Numba's, for two reasons. A parallel loop takes several times as long to
compile as a plain loop. Numba's default threading layer aborts the process when two of a caller's threads enter it at
the same time. Each calling thread also has its own setting for the number of threads.

Only the main thread is interrupted, possibly at any line, so it keeps no counts on which other threads depend.
"""

import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from queue import SimpleQueue
from typing import Generic, TypeVar

from loewner._base._guard import guarded, meant
from loewner._base._validate import whole_number

T = TypeVar("T")

# A single thread takes shares of ALONE times `least` items. Larger shares would delay interrupts, which are noticed
# between shares; smaller shares would start with cold caches more often.
ALONE = 16

# Target duration of a share [s]: interrupts are noticed between shares, and the wait for the last share must be short.
LONG = 0.1


# Largest number of threads for one call; a larger number is probably a mistake, and each thread's stack takes memory.
MOST_THREADS = 1024


class _Setting(threading.local):
    """The calling thread's setting, which is read without a lock, so that an interrupt cannot leave a lock held."""

    count: int | None = None


_setting = _Setting()


@guarded
def set_num_threads(n: int) -> None:
    """Set how many threads the calls of this thread may use; the settings of other threads do not change.

    A batch is divided among at most `n` threads, including the calling thread; small batches stay on the calling
    thread. Answers do not depend on the number of threads.

    Parameters
    ----------
    n : int
        Number of threads, from 1 to 1024; it may exceed the number of processors.

    Raises
    ------
    InputError
        If `n` is not an integer from 1 to 1024.

    See Also
    --------
    get_num_threads : Returns the number in use, and describes the default.

    Examples
    --------
    >>> import loewner
    >>> before = loewner.get_num_threads()
    >>> loewner.set_num_threads(1)
    >>> loewner.get_num_threads()
    1
    >>> loewner.set_num_threads(before)
    """
    _setting.count = whole_number(n, "n", 1, MOST_THREADS)


@guarded
def get_num_threads() -> int:
    """Return the number of threads that calls of this thread may use.

    A number that `set_num_threads` has set on this thread comes first, then the environment variable
    ``LOEWNER_NUM_THREADS``, and then ``NUMBA_NUM_THREADS`` if it is valid. The default is the number of processors that
    this process may use. The environment is read once, at the first call that needs the number.

    Returns
    -------
    int
        The number of threads, at least 1.

    Raises
    ------
    InputError
        If ``LOEWNER_NUM_THREADS`` is needed, and is not an integer from 1 to 1024.

    Examples
    --------
    >>> import loewner
    >>> loewner.get_num_threads() >= 1
    True
    """
    count = _setting.count
    return _of_process() if count is None else count


@contextmanager
def at_most(n: int) -> Iterator[None]:
    """Limit the number of threads that calls of this thread may use, until the block ends."""
    before = _setting.count
    _setting.count = min(n, get_num_threads())
    try:
        yield
    finally:
        _setting.count = before


@cache
def _of_process() -> int:
    """Return the number of threads for calling threads that have set no number."""
    ours = os.environ.get("LOEWNER_NUM_THREADS")
    if ours is not None:
        return whole_number(_integer(ours), "LOEWNER_NUM_THREADS", 1, MOST_THREADS)
    numbas = _integer(os.environ.get("NUMBA_NUM_THREADS", ""))
    count = numbas if isinstance(numbas, int) and numbas >= 1 else processors()
    return min(count, MOST_THREADS)


def _integer(text: str) -> int | str:
    """Return the integer in a text, or the text itself if it is not an integer."""
    return int(text) if re.fullmatch(r"\s*\d{1,18}\s*", text, re.ASCII) else text


def processors() -> int:
    """Return the number of processors that this process may use."""
    process_cpu_count: Callable[[], int | None] | None = getattr(os, "process_cpu_count", None)  # from Python 3.13
    if process_cpu_count is not None:
        return process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def share(total: int, least: int) -> int:
    """Return the largest size of a share, at least `least`; each thread gets several shares, so the last is short."""
    threads = get_num_threads()
    return ALONE * least if threads == 1 else max(least, -(-total // (4 * threads)))


@guarded
def in_shares(
    run: Callable[[int, int], T],
    total: int,
    least: int,
    *,
    most: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[T]:
    """Return the results of run(first, last) over shares of 0..total, in order; few items stay on the calling thread.

    Up to `least` items count as few. The calling thread also takes shares, since waiting for a thread to wake up costs
    as much as 1,000 pairs. The first share has `least` items. Later shares grow to at most `most` items (see `share`),
    or shrink, until a share takes about `LONG`. ``progress(done, total)`` receives the count of items. When the call
    returns or raises, no thread is running.
    """
    if total <= least:
        results = [run(0, total)]
    else:
        work = _Work(run, total, least, min(share(total, least), total if most is None else most))
        try:
            try:
                _lend_a_hand(work.help, min(get_num_threads(), -(-total // least)) - 1)
                work.take(progress)
            finally:
                interrupts: list[BaseException] = []
                while True:
                    try:  # no call may precede this, since an interrupt must not leave a thread running
                        work.close()
                        break
                    except BaseException as error:
                        interrupts = [error]
                if interrupts:
                    raise interrupts.pop()
            results = work.in_order()
        finally:
            work.forget_errors()
    if progress is not None:
        progress(total, total)
    return results


class _Work(Generic[T]):
    """Items that several threads divide among themselves."""

    def __init__(self, run: Callable[[int, int], T], total: int, size: int, largest: int) -> None:
        self._run, self._total, self._size, self._largest = run, total, size, largest
        self._results: dict[int, T] = {}  # keyed by the first item of the share
        self._lock = threading.Lock()
        self._next = 0
        self._closed = False
        self._helping = 0
        self._left: SimpleQueue[None] = SimpleQueue()  # one entry for each helper that has finished
        self._errors: dict[int, BaseException] = {}  # keyed by the first item of the share

    def take(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Run shares until none are left."""
        while True:
            with self._lock:
                first, last = self._next, min(self._next + self._size, self._total)
                if first == last or self._closed or self._errors:
                    return
                self._next = last
            start = time.perf_counter()
            try:
                self._results[first] = self._run(first, last)
            except BaseException as error:
                self._errors[first] = error
                return
            pace = (last - first) / (time.perf_counter() - start + 1e-9)
            self._size = max(1, min(self._largest, 4 * (last - first), int(LONG * pace)))
            if progress is not None and last < self._total:
                progress(last, self._total)

    def help(self) -> None:
        """Run shares on a helper thread."""
        with self._lock:
            if self._closed:
                return
            self._helping += 1
        self.take()
        with self._lock:
            self._helping -= 1
        self._left.put(None)

    def close(self) -> None:
        """Start no more shares, and wait for the helpers that are running one."""
        with self._lock:
            self._closed = True
        while self._helping:
            self._left.get()

    def in_order(self) -> list[T]:
        """Return all results, or raise the interrupt if one occurred, or else the error with the lowest item number."""
        if self._errors:
            # All shares before the first failed share were begun earlier and are done, so that this error does not
            # depend on how the threads took shares.
            errors = [self._errors[first] for first in sorted(self._errors)]
            chosen = next((k for k, error in enumerate(errors) if not isinstance(meant(error), Exception)), 0)
            raise errors.pop(chosen)
        return [self._results[first] for first in sorted(self._results)]

    def forget_errors(self) -> None:
        """Break the cycle of an error and its traceback, which contains frames that refer to this object.

        In such a cycle, the frames of all callers, with their arrays, would live until the next garbage collection.
        Python drops an interrupt that occurs in a finalizer, so the collector should find little to finalize.
        """
        self._errors.clear()


class _Helpers:
    """Threads that wait for work and end with the process; `in_shares` does not return before all are idle."""

    def __init__(self) -> None:
        self.started: list[threading.Thread] = []
        self.tasks: SimpleQueue[Callable[[], None]] = SimpleQueue()

    def serve(self) -> None:
        while True:
            self.tasks.get()()


_helpers = _Helpers()


def _forget_helpers() -> None:
    global _helpers
    _helpers = _Helpers()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_helpers)  # a child process does not have its parent's threads


def _lend_a_hand(task: Callable[[], None], times: int) -> None:
    """Run a task on the given number of other threads, or on fewer if no more can be started."""
    helpers = _helpers
    # Use no lock, since a signal handler that requests threads while this thread holds the lock would wait forever. Two
    # simultaneous callers may start more threads than needed; the surplus threads are idle.
    while len(helpers.started) < times:
        thread = threading.Thread(target=helpers.serve, name="loewner", daemon=True)
        try:
            thread.start()
        except RuntimeError:  # no memory for its stack; the existing threads suffice
            times = len(helpers.started)
            break
        helpers.started.append(thread)
    for _ in range(times):
        helpers.tasks.put(task)
