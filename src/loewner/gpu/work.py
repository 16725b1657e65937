"""Shared code of queries about pairs and configurations: fallbacks, lists of work for the CPU, and rows of tables."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from loewner._base import _validate
from loewner._base._validate import Floats, Ints
from loewner.errors import GpuError, InputError
from loewner.gpu import driver
from loewner.gpu.driver import Device, Memory

FALLBACKS = ("error", "cpu")

# Largest number of entries; the number of a thread has 31 bits.
MOST = 2**31 - 1

Answer = TypeVar("Answer")

_warned = False


def why_not(device: int = 0) -> str:
    """Return the reason why a GPU cannot be used.

    Parameters
    ----------
    device : int
        Index of the GPU among those visible to the driver.

    Returns
    -------
    str
        The reason; empty if the GPU can be used.

    Raises
    ------
    InputError
        If `device` is not an integer of at least 0.

    Examples
    --------
    >>> from loewner import gpu
    >>> bool(gpu.why_not(1000))  # no machine has that many GPUs
    True
    """
    try:
        driver.opened(number_of(device))
    except GpuError as error:
        return str(error)
    return ""


def number_of(device: int) -> int:
    """Check the index of a GPU."""
    return _validate.whole_number(device, "device", 0, MOST)


def attempted(on_gpu: Callable[[], Answer], on_cpu: Callable[[], Answer] | None) -> Answer:
    """Return the GPU's answer or, if the GPU fails, the CPU's answer.

    A failure causes a warning, once per process.
    """
    global _warned
    try:
        return on_gpu()
    except GpuError as error:
        if on_cpu is None:
            raise
        if not _warned:
            _warned = True
            warnings.warn(f"loewner.gpu: the CPU answers instead: {error}", UserWarning, stacklevel=4)
    return on_cpu()


def expect_few(count: int, what: str) -> None:
    """Refuse more entries than an index can address."""
    if count > MOST:
        raise InputError(f"expected at most {MOST} {what} a call, found {count}; pass fewer at a time")


class Left:
    """The work that a kernel leaves to the CPU.

    The work is a list on the GPU, to which threads append. The first entry of the list is its length.

    Parameters
    ----------
    device : Device
    most : int
        Capacity of the list.
    """

    def __init__(self, device: Device, most: int) -> None:
        self._device, self.list = device, device.memory(4 * (1 + most))
        device.clear(self.list.address, 4)

    def numbers(self) -> Ints:
        """Wait until all work is done, and return the list in ascending order."""
        numbers = np.empty(length_of(self._device, self.list), dtype=np.int32)
        self._device.download(self.list.address + 4, numbers)
        return np.sort(numbers).astype(np.int64)


def length_of(device: Device, listed: Memory) -> int:
    """Wait until all work is done, and read the length of a list, which may exceed the list's capacity."""
    count = np.empty(1, dtype=np.int32)
    device.download(listed.address, count)
    return int(count[0])


def gathered(device: Device, address: int, width: int, rows: Ints) -> Floats:
    """Copy rows of a float32 table from the GPU to the CPU, shape (len(rows), width)."""
    listed, memory = device.upload(rows.astype(np.int32)), device.memory(4 * width * len(rows))
    device.launch("gather_rows", width * len(rows), width, listed, address, memory)
    here = np.empty((len(rows), width), dtype=np.float32)
    device.download(memory.address, here)
    return here.astype(np.float64)


def scattered(device: Device, rows: Ints, values: NDArray[Any], target: Memory) -> None:
    """Write small values to GPU memory, one byte for each of the given rows."""
    listed, device_values = device.upload(rows.astype(np.int32)), device.upload(values.astype(np.int32))
    device.launch("scatter_bytes", len(rows), listed, device_values, target)
    device.wait()  # the lists must exist until the work is done
