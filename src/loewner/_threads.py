"""Work in blocks on several threads, for code that runs outside the interpreter lock: kernels and Qhull.

A pool of ordinary threads rather than Numba's own: compiling a parallel loop takes several times as long
as the loop itself, and Numba's default threading layer aborts the process when two of a caller's
threads enter it at once.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numba

T = TypeVar("T")

_pools: dict[int, ThreadPoolExecutor] = {}  # by number of threads; starting one costs as much as 1,000 pairs


def _pool(threads: int) -> ThreadPoolExecutor:
    if threads not in _pools:
        _pools[threads] = ThreadPoolExecutor(threads, thread_name_prefix="loewner")
    return _pools[threads]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)  # a child process inherits the pool, but not its threads


# Shares of `least` items that one thread alone takes at a time: each starts with cold caches, but the user must be able
# to interrupt.
ALONE = 16


def share(total: int, least: int) -> int:
    """Items a thread takes at a time, `least` or more: a few shares each, so that the last one is not waited for."""
    threads = numba.get_num_threads()
    return ALONE * least if threads == 1 else max(least, -(-total // (4 * threads)))


def in_shares(run: Callable[[int, int], T], total: int, least: int) -> list[T]:
    """What run(first, last) returns over shares of 0..total, of `least` or more; if that is one, on this thread.

    This thread takes shares like the others: to wait for one to wake up costs as much as 1,000 pairs.
    """
    if total <= least:
        return [_uninterrupted(run, 0, total)]
    size = share(total, least)
    starts = range(0, total, size)
    todo = deque(enumerate(starts))
    results: list[Any] = [None] * len(starts)

    def work() -> None:
        try:
            while todo:
                try:
                    n, start = todo.popleft()
                except IndexError:  # another thread took the last one
                    return
                results[n] = _uninterrupted(run, start, min(start + size, total))
        except BaseException:
            todo.clear()
            raise

    threads = min(numba.get_num_threads(), len(starts))
    others = [_pool(threads).submit(work) for _ in range(threads - 1)] if threads > 1 else []
    try:
        work()
    finally:
        # Whatever happened here, nobody may go on writing to the caller's arrays.
        errors = [other.exception() for other in others if not other.cancel()]
    for error in filter(None, errors):
        raise error
    return results


def _uninterrupted(run: Callable[[int, int], T], first: int, last: int) -> T:
    """run(first, last); an interrupt while a kernel hands back its arrays is one, not a fault of Numba's."""
    try:
        return run(first, last)
    except SystemError as error:
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise


def over_blocks(
    run: Callable[[int, int], T], total: int, block: int, progress: Callable[[int, int], None] | None = None
) -> Iterator[T]:
    """Yield run(first, last) over blocks of 0..total in order, on as many threads as Numba is set to use.

    The first error ends it.
    """
    starts = range(0, total, block)
    threads = min(numba.get_num_threads(), len(starts))
    each = _pool(threads).map if threads > 1 else map
    for start, result in zip(starts, each(lambda i: run(i, min(i + block, total)), starts), strict=True):
        yield result
        if progress is not None:
            progress(min(start + block, total), total)
