"""Memory to which kernels write: each thread has its own memory, and reuses it for the next query."""

import threading

import numpy as np

from loewner._kernels.columns import CACHE_LINE


class Memory:
    """A block of memory to which kernels write, aligned to a cache line; one thread uses it at a time."""

    def __init__(self, size: int) -> None:
        self._raw = np.empty(size + CACHE_LINE, dtype=np.uint8)
        self.size = size
        self.address = -(-self._raw.ctypes.data // CACHE_LINE) * CACHE_LINE


class _Own(threading.local):
    def __init__(self) -> None:
        # All blocks so far, the largest last. No block is freed before the thread ends, since a signal handler may
        # request a larger block while a query uses its own. All blocks together are at most twice as large as the
        # largest.
        self.made = [Memory(0)]


_own = _Own()


def workspace(size: int) -> int:
    """Return the address of at least `size` bytes of this thread's memory, which the next query overwrites."""
    memory = _own.made[-1]
    if memory.size < size:
        memory = Memory(max(size, 2 * memory.size))
        _own.made.append(memory)
    return memory.address
